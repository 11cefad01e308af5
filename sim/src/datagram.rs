//! What one device does with one datagram that passes it.

use core::time::Duration;

use crate::esc::Esc;
use crate::frame::{DATAGRAM_HEADER, WORKING_COUNTER, read_u16, read_u32};

/// Datagram commands (ETG.1000.4).
mod command {
    pub(super) const APRD: u8 = 1;
    pub(super) const APWR: u8 = 2;
    pub(super) const APRW: u8 = 3;
    pub(super) const FPRD: u8 = 4;
    pub(super) const FPWR: u8 = 5;
    pub(super) const FPRW: u8 = 6;
    pub(super) const BRD: u8 = 7;
    pub(super) const BWR: u8 = 8;
    pub(super) const BRW: u8 = 9;
    pub(super) const LRD: u8 = 10;
    pub(super) const LWR: u8 = 11;
    pub(super) const LRW: u8 = 12;
    pub(super) const ARMW: u8 = 13;
    pub(super) const FRMW: u8 = 14;
}

/// What one device does with one datagram.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Action {
    Read,
    Write,
    ReadWrite,
    /// Broadcast reads combine the devices' bytes by OR.
    ReadOr,
    ReadWriteOr,
}

/// Executes one datagram on one device; `true` when the device was meant.
pub(crate) fn execute(esc: &mut Esc, datagram: &mut [u8], now: Duration) -> bool {
    let (Some(command), Some(address), Some(offset), Some(logical)) = (
        datagram.first().copied(),
        read_u16(datagram, 2),
        read_u16(datagram, 4),
        read_u32(datagram, 2),
    ) else {
        return false;
    };
    if matches!(command, command::LRD | command::LWR | command::LRW) {
        return execute_logical(esc, command, logical, datagram, now);
    }
    let is_auto_increment = matches!(
        command,
        command::APRD | command::APWR | command::APRW | command::ARMW
    );
    let is_broadcast = matches!(command, command::BRD | command::BWR | command::BRW);
    if is_auto_increment || is_broadcast {
        let next = address.wrapping_add(1).to_le_bytes();
        if let Some(field) = datagram.get_mut(2..4) {
            field.copy_from_slice(&next);
        }
    }
    let meant = if is_auto_increment {
        address == 0
    } else {
        is_broadcast || esc.has_address(address)
    };
    let action = match command {
        command::APRD | command::FPRD if meant => Action::Read,
        command::APWR | command::FPWR if meant => Action::Write,
        command::APRW | command::FPRW if meant => Action::ReadWrite,
        command::BRD => Action::ReadOr,
        command::BWR => Action::Write,
        command::BRW => Action::ReadWriteOr,
        // The device that is meant gives its value, all others take what passes.
        command::ARMW | command::FRMW => {
            if meant {
                Action::Read
            } else {
                Action::Write
            }
        }
        _ => return false,
    };
    let Some((data, counter)) = data_and_counter(datagram) else {
        return false;
    };
    let address = usize::from(offset);
    let incoming = data.to_vec();
    let mut done = 0;
    if action != Action::Write {
        let mut bytes = incoming.clone();
        if esc.read(address, &mut bytes, now) {
            done += 1;
            let or = matches!(action, Action::ReadOr | Action::ReadWriteOr);
            data.iter_mut()
                .zip(bytes)
                .for_each(|(target, byte)| *target = if or { *target | byte } else { byte });
        }
    }
    if matches!(
        action,
        Action::Write | Action::ReadWrite | Action::ReadWriteOr
    ) && esc.write(address, &incoming, None, now)
    {
        done += if action == Action::Write { 1 } else { 2 };
    }
    finish(esc, datagram, counter, done)
}

fn execute_logical(
    esc: &mut Esc,
    command: u8,
    logical: u32,
    datagram: &mut [u8],
    now: Duration,
) -> bool {
    if command == command::LRW && !esc.supports_lrw() {
        return false;
    }
    let Some((data, counter)) = data_and_counter(datagram) else {
        return false;
    };
    let incoming = data.to_vec();
    let mut done = 0;
    if command != command::LWR && esc.logical_read(logical, data, now) {
        done += 1;
    }
    if command != command::LRD && esc.logical_write(logical, &incoming, now) {
        done += if command == command::LRW { 2 } else { 1 };
    }
    if done == 0 {
        return false;
    }
    finish(esc, datagram, counter, done)
}

/// Splits a datagram into its data and the working counter that came in.
fn data_and_counter(datagram: &mut [u8]) -> Option<(&mut [u8], u16)> {
    let at = datagram.len().checked_sub(WORKING_COUNTER)?;
    let counter = read_u16(datagram, at)?;
    Some((datagram.get_mut(DATAGRAM_HEADER..at)?, counter))
}

/// Adds to the working counter and sets the interrupt bits.
fn finish(esc: &mut Esc, datagram: &mut [u8], counter: u16, done: u16) -> bool {
    let at = datagram.len() - WORKING_COUNTER;
    let interrupt = esc.interrupt();
    let shown = read_u16(datagram, 8).unwrap_or(0) | interrupt;
    if let Some(field) = datagram.get_mut(8..10) {
        field.copy_from_slice(&shown.to_le_bytes());
    }
    if let Some(field) = datagram.get_mut(at..) {
        field.copy_from_slice(&counter.wrapping_add(done).to_le_bytes());
    }
    true
}
