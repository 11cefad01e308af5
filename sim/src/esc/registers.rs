//! Addresses of the ESC registers that this simulation has, and which of them the MainDevice may write.
//! Source: the register list in the ESC data sheets (ETG.1000.4), as far as masters use them.

use core::ops::Range;

pub(crate) const TYPE: u16 = 0x0000;
pub(crate) const FMMU_COUNT: u16 = 0x0004;
pub(crate) const PORT_KINDS: u16 = 0x0007;
pub(crate) const FEATURES: u16 = 0x0008;
pub(crate) const STATION_ADDRESS: u16 = 0x0010;
pub(crate) const STATION_ALIAS: u16 = 0x0012;
pub(crate) const DL_CONTROL: u16 = 0x0100;
/// Second byte of DL control: two bits for each port.
pub(crate) const LOOP_CONTROL: u16 = 0x0101;
pub(crate) const DL_STATUS: u16 = 0x0110;
pub(crate) const AL_CONTROL: u16 = 0x0120;
pub(crate) const AL_STATUS: u16 = 0x0130;
pub(crate) const AL_STATUS_CODE: u16 = 0x0134;
pub(crate) const ECAT_EVENT_MASK: u16 = 0x0200;
pub(crate) const ECAT_EVENT: u16 = 0x0210;
pub(crate) const AL_EVENT: u16 = 0x0220;
pub(crate) const WATCHDOG_DIVIDER: u16 = 0x0400;
pub(crate) const WATCHDOG_PDI: u16 = 0x0410;
pub(crate) const WATCHDOG_PROCESS_DATA: u16 = 0x0420;
pub(crate) const WATCHDOG_STATUS: u16 = 0x0440;
pub(crate) const WATCHDOG_COUNTER: u16 = 0x0442;
pub(crate) const SII_OWNER: u16 = 0x0500;
pub(crate) const SII_ACCESS: u16 = 0x0501;
pub(crate) const SII_CONTROL: u16 = 0x0502;
pub(crate) const SII_ADDRESS: u16 = 0x0504;
pub(crate) const SII_DATA: u16 = 0x0508;
pub(crate) const FMMU: u16 = 0x0600;
pub(crate) const SYNC_MANAGER: u16 = 0x0800;
pub(crate) const DC_RECEIVE_TIMES: u16 = 0x0900;
pub(crate) const DC_SYSTEM_TIME: u16 = 0x0910;
pub(crate) const DC_RECEIVE_TIME_UNIT: u16 = 0x0918;
pub(crate) const DC_OFFSET: u16 = 0x0920;
pub(crate) const DC_DELAY: u16 = 0x0928;
pub(crate) const DC_DIFFERENCE: u16 = 0x092C;
pub(crate) const DC_SPEED_COUNTER: u16 = 0x0930;
pub(crate) const DC_SPEED_DIFFERENCE: u16 = 0x0932;
pub(crate) const DC_FILTER: u16 = 0x0934;
/// First address behind the registers of the distributed clock.
pub(crate) const DC_END: u16 = 0x0A00;
pub(crate) const SYNC_ACTIVATION: u16 = 0x0981;
pub(crate) const SYNC0_START: u16 = 0x0990;
pub(crate) const SYNC0_CYCLE: u16 = 0x09A0;

/// FMMUs and sync managers of the simulated ESC, as many as an ET1100 has.
pub(crate) const CHANNELS: usize = 8;
/// First address of the process-data memory.
pub(crate) const RAM_START: usize = 0x1000;
/// First address behind the process-data memory: 8 KiB, as an ET1100 has.
pub(crate) const RAM_END: usize = 0x3000;

/// Registers that a write from the MainDevice changes as bytes. What has a rule of its own (sync managers, SII, error
/// counters, system time) is not in this list.
const PLAIN_WRITABLE: [Range<u16>; 18] = [
    STATION_ADDRESS..STATION_ADDRESS + 2,
    DL_CONTROL..DL_CONTROL + 4,
    AL_CONTROL..AL_CONTROL + 2,
    ECAT_EVENT_MASK..ECAT_EVENT_MASK + 2,
    WATCHDOG_DIVIDER..WATCHDOG_DIVIDER + 2,
    WATCHDOG_PDI..WATCHDOG_PDI + 2,
    WATCHDOG_PROCESS_DATA..WATCHDOG_PROCESS_DATA + 2,
    SII_ADDRESS..SII_ADDRESS + 4,
    SII_DATA..SII_DATA + 8,
    FMMU..FMMU + 16 * CHANNELS as u16,
    DC_OFFSET..DC_OFFSET + 8,
    DC_DELAY..DC_DELAY + 4,
    DC_SPEED_COUNTER..DC_SPEED_COUNTER + 2,
    DC_FILTER..DC_FILTER + 2,
    0x0980..0x0982,
    // Latch control.
    0x09A8..0x09AA,
    // Start time and cycles; locked while the SYNC unit is on.
    SYNC0_START..SYNC0_START + 8,
    SYNC0_CYCLE..SYNC0_CYCLE + 8,
];

/// Registers that any write sets to zero: receive error counters and the watchdog's expiry counters.
const CLEARED_BY_WRITE: [Range<u16>; 2] = [0x0300..0x0314, WATCHDOG_COUNTER..WATCHDOG_COUNTER + 2];

/// What a write to one register byte does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WriteRule {
    /// The byte takes the value.
    Plain,
    /// The byte becomes zero.
    Clear,
    /// Nothing happens.
    Ignored,
}

/// The rule for a register without a rule of its own.
pub(crate) fn write_rule(address: u16) -> WriteRule {
    if PLAIN_WRITABLE.iter().any(|range| range.contains(&address)) {
        WriteRule::Plain
    } else if CLEARED_BY_WRITE
        .iter()
        .any(|range| range.contains(&address))
    {
        WriteRule::Clear
    } else {
        WriteRule::Ignored
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn status_registers_are_read_only() {
        for address in [
            TYPE,
            STATION_ALIAS,
            DL_STATUS,
            AL_STATUS,
            AL_STATUS_CODE,
            AL_EVENT,
            WATCHDOG_STATUS,
        ] {
            assert_eq!(write_rule(address), WriteRule::Ignored, "{address:04X}h");
        }
    }

    #[test]
    fn a_write_to_the_expiry_counter_clears_it() {
        assert_eq!(write_rule(WATCHDOG_COUNTER), WriteRule::Clear);
    }
}
