//! The registers of an ESC, the EtherCAT slave controller of a SubDevice (ETG.1000.4; ESC data sheet, section II).
//!
//! Each is the address of its first byte. What the bits of a register mean stands where they are used.

/// Features: distributed clocks, their width, and whether the ESC understands LRW.
pub const FEATURES: u16 = 0x0008;
/// The configured station address.
pub const STATION_ADDRESS: u16 = 0x0010;
/// The configured station alias.
pub const STATION_ALIAS: u16 = 0x0012;
/// DL control, second byte: the loop control of the ports, 0 for automatic.
pub const PORTS: u16 = 0x0101;
/// Written there: ports 1 to 3 close when they lose their link, and open when that is written again.
pub const AUTO_CLOSE: u8 = 0x54;
/// DL control, fourth byte: whether the alias is an address.
pub const ALIAS_ADDRESSING: u16 = 0x0103;
/// DL status: in pairs from bit 8 of each port whether it is closed, and whether it has communication.
pub const DL_STATUS: u16 = 0x0110;
/// AL control: the requested state.
pub const AL_CONTROL: u16 = 0x0120;
/// AL status: the state; two bytes reserved; the AL status code.
pub const AL_STATUS: u16 = 0x0130;
/// Which events of the ESC raise an ECAT interrupt.
pub const EVENT_MASK: u16 = 0x0200;
/// RX error counters, forwarded RX errors, processing unit and PDI errors, lost links: 0300h to 0313h.
pub const ERROR_COUNTERS: u16 = 0x0300;
/// The divider of the watchdogs' clock.
pub const WATCHDOG_DIVIDER: u16 = 0x0400;
/// The time of the process data's watchdog.
pub const WATCHDOG_TIME: u16 = 0x0420;
/// Whose the EEPROM is.
pub const EEPROM_CONFIGURATION: u16 = 0x0500;
/// Control and status of the EEPROM; its address follows at 0504h.
pub const EEPROM_CONTROL: u16 = 0x0502;
/// What was read of the EEPROM.
pub const EEPROM_DATA: u16 = 0x0508;
/// The first FMMU, of 16 bytes; the others follow.
pub const FMMU: u16 = 0x0600;
/// The first sync manager, of eight bytes; the others follow.
pub const SYNC_MANAGER: u16 = 0x0800;
/// The status of sync manager 1, the mailbox that the MainDevice reads.
pub const MAILBOX_IN_STATUS: u16 = 0x080D;
/// When a latched frame came in at each port.
pub const RECEIVE_TIMES: u16 = 0x0900;
/// The system time.
pub const SYSTEM_TIME: u16 = 0x0910;
/// When a latched frame came to the processing unit.
pub const RECEIVE_TIME_UNIT: u16 = 0x0918;
/// From the local time to the system time.
pub const SYSTEM_TIME_OFFSET: u16 = 0x0920;
/// How long a frame takes from the reference clock to here.
pub const SYSTEM_TIME_DELAY: u16 = 0x0928;
/// Bits 0 to 30 are how far the clock is from the reference; bit 31 says on which side.
pub const SYSTEM_TIME_DIFFERENCE: u16 = 0x092C;
/// A write resets the filters of a clock's control loop.
pub const SPEED_COUNTER_START: u16 = 0x0930;
/// Control of the SYNC unit.
pub const SYNC_CONTROL: u16 = 0x0980;
/// Activation of the SYNC unit: the upper byte of an assign-activate word.
pub const SYNC_ACTIVATION: u16 = 0x0981;
/// When SYNC0 comes first.
pub const SYNC0_START: u16 = 0x0990;
/// The cycle of SYNC0.
pub const SYNC0_CYCLE: u16 = 0x09A0;
/// From SYNC0 to SYNC1.
pub const SYNC1_CYCLE: u16 = 0x09A4;
