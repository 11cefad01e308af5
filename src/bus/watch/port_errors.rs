//! The error counters of the devices' ports: which cable, plug or device damages frames.

use crate::bus::{
    error::RegisterError,
    requests::{Context, SLOTS, registers::Registers},
    watch::al_monitor::at_once,
};

/// RX error counters, forwarded RX errors, processing unit and PDI errors, lost links (ETG.1000.4, 0300h to 0313h).
const ERROR_COUNTERS: u16 = 0x0300;
/// So many devices are asked at once: half of the slots, so that everybody else's requests find one.
const AT_ONCE: usize = SLOTS / 2;

/// The error counters of one SubDevice. Each stops at 255, and stays until the device is switched off.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DevicePorts {
    /// Its place in the line, from 0.
    pub position: u16,
    /// The counters of its ports 0 to 3. Frames come in from the MainDevice at port 0.
    pub ports: [PortErrors; 4],
    /// Frames in which the processing unit found an error of format (030Ch); `None` where the device does not count them.
    pub processing_unit: Option<u8>,
    /// Errors of the interface to the device's own processor (030Dh); `None` where the device does not count them.
    pub process_data_interface: Option<u8>,
}

/// The error counters of one port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PortErrors {
    /// Frames with a wrong checksum or length that came in here first (0300h, 0302h and so on).
    pub invalid_frames: u8,
    /// Damaged symbols that came in here (0301h, 0303h and so on): the cable to this port, its plugs, or the device at its
    /// other end.
    pub physical: u8,
    /// Frames that came in here damaged, and that a device before had found out already (0308h to 030Bh): not this cable.
    pub forwarded: u8,
    /// How often the link was lost (0310h to 0313h).
    pub lost_links: u8,
}

impl PortErrors {
    /// Whether nothing was counted.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        *self == Self::default()
    }
}

impl DevicePorts {
    /// By the registers from 0300h on: all 20, or the first 8.
    fn of(position: u16, registers: &[u8]) -> Self {
        let at = |register: usize| registers.get(register).copied();
        Self {
            position,
            ports: core::array::from_fn(|port| PortErrors {
                invalid_frames: at(2 * port).unwrap_or(0),
                physical: at(2 * port + 1).unwrap_or(0),
                forwarded: at(0x08 + port).unwrap_or(0),
                lost_links: at(0x10 + port).unwrap_or(0),
            }),
            processing_unit: at(0x0C),
            process_data_interface: at(0x0D),
        }
    }
}

/// Reads the counters of all SubDevices that answer, in the order of the line.
pub(in crate::bus) async fn read(context: &Context) -> Result<Vec<DevicePorts>, RegisterError> {
    let positions: Vec<_> = (0..context.registers.count().await?).collect();
    let mut devices = Vec::with_capacity(positions.len());
    for positions in positions.chunks(AT_ONCE) {
        let asked = positions.iter().map(|position| {
            let (registers, position) = (context.registers.clone(), *position);
            async move { read_one(&registers, position).await }
        });
        for device in at_once(context, asked).await {
            devices.extend(device?);
        }
    }
    Ok(devices)
}

/// Reads the counters of the SubDevice at this place; `None` if none answers there.
async fn read_one(
    registers: &Registers,
    position: u16,
) -> Result<Option<DevicePorts>, RegisterError> {
    match registers.read_at::<20>(position, ERROR_COUNTERS).await {
        Ok(all) => return Ok(Some(DevicePorts::of(position, &all))),
        Err(RegisterError::NotAnswered) => {}
        Err(error) => return Err(error),
    }
    // Only the first eight are in every ESC.
    match registers.read_at::<8>(position, ERROR_COUNTERS).await {
        Ok(first) => Ok(Some(DevicePorts::of(position, &first))),
        Err(RegisterError::NotAnswered) => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::{DevicePorts, PortErrors};

    #[test]
    fn the_registers_are_told_apart_by_port() {
        // ETG.1000.4, 0300h: invalid frames and RX errors in turns, then forwarded, 030Ch, 030Dh, two reserved, lost links.
        let registers = [
            1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 0, 0, 15, 16, 17, 18,
        ];
        let ports = DevicePorts::of(2, &registers);
        let second = PortErrors {
            invalid_frames: 3,
            physical: 4,
            forwarded: 10,
            lost_links: 16,
        };
        assert_eq!((ports.position, ports.ports[1]), (2, second));
        assert_eq!(ports.ports[3].lost_links, 18);
        assert_eq!(ports.processing_unit, Some(13));
        assert_eq!(ports.process_data_interface, Some(14));
        let few = DevicePorts::of(0, &registers[..8]);
        assert_eq!((few.ports[3].physical, few.processing_unit), (8, None));
        assert!(!few.ports[0].is_clean());
    }
}
