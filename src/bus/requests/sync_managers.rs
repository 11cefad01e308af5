//! Sync managers and FMMUs of the process data (ETG.1000.4), written from the mapping that was read back, and the
//! process-data watchdog.

use std::time::Duration;

use ethercrab::{Command, MainDevice, error::Error};

use crate::{
    bus::{
        error::{RegisterError, SyncManagerError, WatchdogState},
        requests::registers::Registers,
    },
    esc,
    sii::{FmmuUsage, Sii, SyncManager, SyncManagerUsage},
};

const ACTIVATE: u16 = 6;
/// The first address of the process-data memory; below it are registers.
const MEMORY: u16 = 0x1000;
const NO_LRW: u16 = 1 << 9;

/// Control bytes of mailboxes: one buffer, written or read by the master, with an interrupt for the device.
const MAILBOX_OUT: u8 = 0x26;
const MAILBOX_IN: u8 = 0x22;
/// Control byte, bit 6: writes trigger the watchdog.
const WATCHDOG_TRIGGER: u8 = 0x40;
/// 0400h for ticks of 100 µs: (2498 + 2) · 40 ns.
const DIVIDER: u16 = 2498;
const TICK: Duration = Duration::from_micros(100);

/// Where a drive's process data lie, in its memory and in the logical address space.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Area {
    /// The sync manager's number.
    number: u8,
    /// The FMMU's number.
    fmmu: u8,
    start: u16,
    control: u8,
    pub length: u16,
    /// The logical address.
    pub logical: u32,
}

/// Sets up the mailbox's sync managers, where there is a mailbox.
pub(in crate::bus) async fn set_mailbox(
    registers: &Registers,
    station: u16,
    sii: &Sii,
) -> Result<(), RegisterError> {
    let Some(mailbox) = sii.mailbox else {
        return Ok(());
    };
    let control = |usage, default| {
        let manager = sii.sync_managers.iter().find(|m| m.usage == usage);
        manager.map_or(default, |manager| manager.control)
    };
    let managers = [
        (
            mailbox.receive_offset,
            mailbox.receive_length,
            control(SyncManagerUsage::MailboxOut, MAILBOX_OUT),
        ),
        (
            mailbox.send_offset,
            mailbox.send_length,
            control(SyncManagerUsage::MailboxIn, MAILBOX_IN),
        ),
    ];
    for (number, (start, length, control)) in (0..).zip(managers) {
        let [s0, s1] = start.to_le_bytes();
        let [l0, l1] = length.to_le_bytes();
        let register = esc::SYNC_MANAGER + 8 * number;
        registers
            .write(station, register, &[s0, s1, l0, l1, control, 0, 1, 0])
            .await?;
    }
    Ok(())
}

/// Finds an FMMU for this use: one that the SII means for it, or else any that is not taken.
pub(in crate::bus) fn fmmu(sii: &Sii, usage: FmmuUsage, taken: &mut Vec<u8>) -> u8 {
    let meant = (0..).zip(&sii.fmmu_usage);
    let meant = meant
        .filter(|(_, of)| **of == usage)
        .map(|(number, _)| number);
    let fmmu = meant
        .chain(0..u8::MAX)
        .find(|number| !taken.contains(number))
        .unwrap_or(u8::MAX);
    taken.push(fmmu);
    fmmu
}

/// Finds the sync manager and FMMU for the outputs or inputs of a drive.
pub(in crate::bus) fn area(
    sii: &Sii,
    usage: SyncManagerUsage,
    taken: &mut Vec<u8>,
    length: usize,
    logical: u32,
) -> Result<Area, SyncManagerError> {
    let (what, wanted) = match usage {
        SyncManagerUsage::Outputs => ("outputs", FmmuUsage::Outputs),
        _ => ("inputs", FmmuUsage::Inputs),
    };
    let managers = (0..).zip(&sii.sync_managers);
    let (number, _) = managers
        .into_iter()
        .find(|(_, manager)| manager.usage == usage)
        .ok_or(SyncManagerError::Missing(what))?;
    let fmmu = fmmu(sii, wanted, taken);
    Area::of_manager(sii, number, fmmu, length, logical, what)
}

fn no_overlap(
    all: &[SyncManager],
    manager: &SyncManager,
    length: u16,
    what: &'static str,
) -> Result<(), SyncManagerError> {
    let start = manager.start;
    if start < MEMORY {
        // A register of a digital output terminal: it has no buffers.
        return Ok(());
    }
    let next = all
        .iter()
        .map(|other| other.start)
        .filter(|other| *other > start)
        .min();
    match next {
        Some(next) if u32::from(start) + 3 * u32::from(length) > u32::from(next) => {
            Err(SyncManagerError::Overlap {
                what,
                start,
                length,
                next,
            })
        }
        _ => Ok(()),
    }
}

impl Area {
    /// The area of the sync manager with this number.
    pub fn of_manager(
        sii: &Sii,
        number: u8,
        fmmu: u8,
        length: usize,
        logical: u32,
        what: &'static str,
    ) -> Result<Self, SyncManagerError> {
        let length = u16::try_from(length).map_err(|_| SyncManagerError::TooLong(length))?;
        let manager = sii
            .sync_managers
            .get(usize::from(number))
            .ok_or(SyncManagerError::Missing(what))?;
        no_overlap(&sii.sync_managers, manager, length, what)?;
        Ok(Self {
            number,
            fmmu,
            start: manager.start,
            control: manager.control,
            length,
            logical,
        })
    }

    /// Writes sync manager and FMMU; empty process data leave both switched off.
    pub async fn write(
        &self,
        registers: &Registers,
        station: u16,
        direction: AreaDirection,
    ) -> Result<(), RegisterError> {
        registers.note_area(station, *self, direction);
        let (manager, fmmu) = self.registers();
        // A sync manager may only be changed while it is switched off.
        registers.write(station, manager + ACTIVATE, &[0]).await?;
        registers.write(station, fmmu + 12, &[0]).await?;
        if self.length == 0 {
            return Ok(());
        }
        let setting = self.manager_setting(direction);
        registers.write(station, manager, &setting).await?;
        registers.write(station, manager + ACTIVATE, &[1]).await?;
        let setting = self.fmmu_setting(direction);
        registers.write(station, fmmu, &setting).await
    }

    pub const fn number(&self) -> u8 {
        self.number
    }

    pub const fn fmmu(&self) -> u8 {
        self.fmmu
    }

    /// Whether the device's sync manager is as it was written.
    pub async fn is_managed(
        &self,
        registers: &Registers,
        station: u16,
        direction: AreaDirection,
    ) -> Result<bool, RegisterError> {
        let [s0, s1, l0, l1, control, _, activate, _] =
            registers.read(station, self.registers().0).await?;
        let is_on = activate & 1 != 0;
        if self.length == 0 {
            return Ok(!is_on);
        }
        let setting = self.manager_setting(direction);
        Ok(is_on && [s0, s1, l0, l1, control] == setting)
    }

    /// Whether the device's FMMU is as it was written.
    pub async fn is_mapped(
        &self,
        registers: &Registers,
        station: u16,
        direction: AreaDirection,
    ) -> Result<bool, RegisterError> {
        let found: [u8; 16] = registers.read(station, self.registers().1).await?;
        if self.length == 0 {
            return Ok(found[12] & 1 == 0);
        }
        let setting = self.fmmu_setting(direction);
        Ok(found[12] & 1 != 0 && found[..12] == setting[..12])
    }

    /// Of its sync manager and of its FMMU.
    const fn registers(&self) -> (u16, u16) {
        (
            esc::SYNC_MANAGER + 8 * self.number as u16,
            esc::FMMU + 16 * self.fmmu as u16,
        )
    }

    /// Start, length and control byte of the sync manager.
    fn manager_setting(&self, direction: AreaDirection) -> [u8; 5] {
        let [s0, s1] = self.start.to_le_bytes();
        let [l0, l1] = self.length.to_le_bytes();
        [s0, s1, l0, l1, self.control(direction)]
    }

    /// The whole FMMU.
    fn fmmu_setting(&self, direction: AreaDirection) -> [u8; 16] {
        let [s0, s1] = self.start.to_le_bytes();
        let [l0, l1] = self.length.to_le_bytes();
        let [a0, a1, a2, a3] = self.logical.to_le_bytes();
        let kind = match direction {
            AreaDirection::Outputs { .. } => 2,
            AreaDirection::Inputs => 1,
        };
        [a0, a1, a2, a3, l0, l1, 0, 7, s0, s1, 0, kind, 1, 0, 0, 0]
    }

    /// Whether the sync manager really triggers the watchdog.
    async fn triggers(&self, registers: &Registers, station: u16) -> Result<bool, RegisterError> {
        let manager = esc::SYNC_MANAGER + 8 * u16::from(self.number);
        let [control] = registers.read(station, manager + 4).await?;
        Ok(control & WATCHDOG_TRIGGER != 0)
    }

    /// Three buffers, written by the master (outputs) or by the device (inputs); bits 4 and 5 as the SII has them.
    const fn control(&self, direction: AreaDirection) -> u8 {
        match direction {
            AreaDirection::Outputs { watchdog } => {
                let trigger = if watchdog { WATCHDOG_TRIGGER } else { 0 };
                self.control & 0x30 | 0x04 | trigger
            }
            AreaDirection::Inputs => self.control & 0x30,
        }
    }
}

/// Who writes an area.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) enum AreaDirection {
    Outputs { watchdog: bool },
    Inputs,
}

/// The ticks of 0420h for this time; `None` if it has no room there.
pub(in crate::bus) fn watchdog_ticks(time: Duration) -> Option<u16> {
    let ticks = u16::try_from(time.as_micros().div_ceil(TICK.as_micros())).ok()?;
    (ticks != 0).then_some(ticks)
}

/// What is written to which register to set the process-data watchdog, 0 for off, in order.
fn watchdog_writes(ticks: u16) -> impl Iterator<Item = (u16, u16)> {
    let writes = [
        (esc::WATCHDOG_DIVIDER, DIVIDER),
        (esc::WATCHDOG_TIME, ticks),
    ];
    writes.into_iter().skip(usize::from(ticks == 0))
}

/// Sets the process-data watchdog, 0 for off, and gives what the SubDevice holds then.
pub(in crate::bus) async fn set_watchdog(
    registers: &Registers,
    station: u16,
    outputs: &Area,
    ticks: u16,
) -> Result<WatchdogState, RegisterError> {
    for (register, value) in watchdog_writes(ticks) {
        registers
            .write(station, register, &value.to_le_bytes())
            .await?;
    }
    Ok(WatchdogState {
        triggered: outputs.triggers(registers, station).await?,
        divider: u16::from_le_bytes(registers.read(station, esc::WATCHDOG_DIVIDER).await?),
        ticks: u16::from_le_bytes(registers.read(station, esc::WATCHDOG_TIME).await?),
    })
}

impl WatchdogState {
    pub(in crate::bus) const fn is_armed_with(self, ticks: u16) -> bool {
        self.triggered && self.divider == DIVIDER && self.ticks == ticks && ticks != 0
    }
}

/// Whether the SubDevice takes LRW.
pub(in crate::bus) async fn takes_lrw(
    registers: &Registers,
    station: u16,
) -> Result<bool, RegisterError> {
    let features = u16::from_le_bytes(registers.read(station, esc::FEATURES).await?);
    Ok(features & NO_LRW == 0)
}

// For programs with an ethercrab loop of their own: the check that a dead program leaves no moving axis.

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
    let device = DeviceRegisters { main, station };
    let mut outputs = None;
    for number in 0..8 {
        let at = esc::SYNC_MANAGER + 8 * number;
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
        divider: u16::from_le_bytes(device.read(esc::WATCHDOG_DIVIDER).await?),
        ticks: u16::from_le_bytes(device.read(esc::WATCHDOG_TIME).await?),
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

struct DeviceRegisters<'a> {
    main: &'a MainDevice<'a>,
    station: u16,
}

impl DeviceRegisters<'_> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sii::Identity;

    fn akd() -> Sii {
        // The sync managers of a real AKD (public ethercrab repository, dumps/eeprom/akd.hex).
        let manager = |start, length, control, usage| SyncManager {
            start,
            length,
            control,
            enable: 1,
            usage,
        };
        Sii {
            identity: Identity::default(),
            mailbox: None,
            strings: vec![],
            general: None,
            fmmu_usage: vec![
                FmmuUsage::Outputs,
                FmmuUsage::Inputs,
                FmmuUsage::MailboxStatus,
            ],
            sync_managers: vec![
                manager(0x1800, 1024, 0x26, SyncManagerUsage::MailboxOut),
                manager(0x1C00, 1024, 0x22, SyncManagerUsage::MailboxIn),
                manager(0x1100, 0, 0x24, SyncManagerUsage::Outputs),
                manager(0x1140, 0, 0x20, SyncManagerUsage::Inputs),
            ],
            tx_pdos: vec![],
            rx_pdos: vec![],
            clock_modes: vec![],
        }
    }

    #[test]
    fn the_watchdog_trigger_is_set_even_where_the_sii_leaves_it_out() {
        let outputs = area(&akd(), SyncManagerUsage::Outputs, &mut vec![], 19, 0).unwrap();
        assert_eq!(
            outputs.control(AreaDirection::Outputs { watchdog: true }),
            0x64
        );
        assert_eq!(
            outputs.control(AreaDirection::Outputs { watchdog: false }),
            0x24
        );
    }

    /// Category 40 is wrong, or says nothing of one direction.
    #[test]
    fn outputs_and_inputs_never_share_an_fmmu() {
        let (mailbox, unused) = (FmmuUsage::MailboxStatus, FmmuUsage::Unused);
        let (outputs, inputs) = (FmmuUsage::Outputs, FmmuUsage::Inputs);
        for (usages, expected) in [
            (vec![], [0, 1]),
            (vec![outputs, inputs, mailbox], [0, 1]),
            (vec![inputs, outputs], [1, 0]),
            (vec![outputs, unused], [0, 1]),
            (vec![mailbox, outputs], [1, 0]),
            (vec![inputs, unused], [0, 1]),
            (vec![unused, outputs], [1, 0]),
        ] {
            let sii = Sii {
                fmmu_usage: usages,
                ..akd()
            };
            let mut taken = vec![];
            let chosen = [SyncManagerUsage::Outputs, SyncManagerUsage::Inputs]
                .map(|usage| area(&sii, usage, &mut taken, 8, 0).unwrap().fmmu);
            assert_eq!(chosen, expected, "{:?}", sii.fmmu_usage);
        }
    }

    #[test]
    fn three_buffers_must_not_run_into_the_next_sync_manager() {
        assert!(area(&akd(), SyncManagerUsage::Outputs, &mut vec![], 21, 0).is_ok());
        assert_eq!(
            area(&akd(), SyncManagerUsage::Outputs, &mut vec![], 22, 0),
            Err(SyncManagerError::Overlap {
                what: "outputs",
                start: 0x1100,
                length: 22,
                next: 0x1140
            })
        );
    }

    #[test]
    fn a_watchdog_time_is_rounded_up_to_ticks_and_must_fit() {
        assert_eq!(watchdog_ticks(Duration::from_millis(100)), Some(1000));
        assert_eq!(watchdog_ticks(Duration::from_micros(101)), Some(2));
        assert_eq!(watchdog_ticks(Duration::ZERO), None);
        assert_eq!(watchdog_ticks(Duration::from_secs(7)), None);
    }
}
