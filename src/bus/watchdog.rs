//! For programs with an ethercrab loop of their own: the check that a dead program leaves no moving axis.

use std::time::Duration;

use ethercrab::{Command, MainDevice, error::Error};

use super::sync_managers::{
    ACTIVATE, DIVIDER, SYNC_MANAGER, WATCHDOG_DIVIDER, WATCHDOG_TIME, WATCHDOG_TRIGGER,
    WatchdogState, watchdog_ticks, watchdog_writes,
};

/// Why a SubDevice's process-data watchdog is not armed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WatchdogError {
    /// The SubDevice did not answer.
    #[error("SubDevice {station:04X}h did not answer while its watchdog was set: {error}")]
    NotAnswered {
        /// Its station address.
        station: u16,
        /// What ethercrab says.
        error: Error,
    },
    /// It has no sync manager for outputs: configure its process data first.
    #[error(
        "SubDevice {station:04X}h has no active sync manager for outputs: configure its process data first"
    )]
    NoOutputs {
        /// Its station address.
        station: u16,
    },
    /// The time is zero or more than 6.5 s.
    #[error("a watchdog time of {0:?} has no place in register 0420h (100 µs to 6.5 s)")]
    Time(Duration),
    /// The registers read back hold something else.
    #[error(
        "SubDevice {station:04X}h does not keep its watchdog: control byte {control:02X}h, divider {divider}, \
         {ticks} ticks; expected bit 6 set, {DIVIDER}, {expected} ticks"
    )]
    NotArmed {
        /// Its station address.
        station: u16,
        /// Control byte of the outputs' sync manager; bit 6 triggers the watchdog.
        control: u8,
        /// Register 0400h.
        divider: u16,
        /// Register 0420h.
        ticks: u16,
        /// What was written to 0420h.
        expected: u16,
    },
}

/// Arms the process-data watchdog of a SubDevice and reads it back. Call it in PREOP, when the sync managers have been
/// configured (ethercrab: after `into_pre_op_pdi`, before `into_op`): many drives, the AKD2G among them, come without.
///
/// Besides, set 6007h (6807h) of each axis to a value that stops it.
///
/// # Errors
/// [`WatchdogError`] if the SubDevice does not answer, has no outputs, or does not keep what was written.
pub async fn arm_watchdog(
    main: &MainDevice<'_>,
    station: u16,
    time: Duration,
) -> Result<(), WatchdogError> {
    let expected = watchdog_ticks(time).ok_or(WatchdogError::Time(time))?;
    let device = Device { main, station };
    let mut outputs = None;
    for number in 0..8 {
        let at = SYNC_MANAGER + 8 * number;
        let [_, _, _, _, control, _, activate, _] = device.read::<8>(at).await?;
        // Three buffers, written by the MainDevice, switched on.
        if control & 0x0F == 0x04 && activate & 1 == 1 {
            outputs = Some((at, control));
            break;
        }
    }
    let (manager, control) = outputs.ok_or(WatchdogError::NoOutputs { station })?;
    // A sync manager may only be changed while it is switched off.
    device.write(manager + ACTIVATE, &[0]).await?;
    device
        .write(manager + 4, &[control | WATCHDOG_TRIGGER])
        .await?;
    device.write(manager + ACTIVATE, &[1]).await?;
    for (register, value) in watchdog_writes(expected) {
        device.write(register, &value.to_le_bytes()).await?;
    }
    let [control] = device.read(manager + 4).await?;
    let held = WatchdogState {
        triggered: control & WATCHDOG_TRIGGER != 0,
        divider: u16::from_le_bytes(device.read(WATCHDOG_DIVIDER).await?),
        ticks: u16::from_le_bytes(device.read(WATCHDOG_TIME).await?),
    };
    if !held.is_armed_with(expected) {
        return Err(WatchdogError::NotArmed {
            station,
            control,
            divider: held.divider,
            ticks: held.ticks,
            expected,
        });
    }
    Ok(())
}

struct Device<'a> {
    main: &'a MainDevice<'a>,
    station: u16,
}

impl Device<'_> {
    async fn read<const N: usize>(&self, register: u16) -> Result<[u8; N], WatchdogError> {
        let answer = Command::fprd(self.station, register)
            .receive_slice(self.main, N as u16)
            .await;
        let answer = answer.map_err(|error| WatchdogError::NotAnswered {
            station: self.station,
            error,
        })?;
        let mut bytes = [0; N];
        for (to, from) in bytes.iter_mut().zip(answer.iter()) {
            *to = *from;
        }
        Ok(bytes)
    }

    async fn write(&self, register: u16, bytes: &[u8]) -> Result<(), WatchdogError> {
        let answer = Command::fpwr(self.station, register)
            .send_receive_slice(self.main, bytes)
            .await;
        answer
            .map(|_| ())
            .map_err(|error| WatchdogError::NotAnswered {
                station: self.station,
                error,
            })
    }
}
