//! The SII interface of an ESC (0500h–050Fh): the MainDevice reads the EEPROM word by word through it.

use std::time::Duration;

use super::{Esc, registers as reg};

/// Control bit 0: writing is enabled for this access.
const WRITE_ENABLE: u16 = 0x0001;
/// Status bit 5: the device's processor serves the EEPROM.
const EMULATED: u16 = 0x0020;
/// Status bit 6: a read gives eight bytes.
const READS_EIGHT_BYTES: u16 = 0x0040;
/// Status bit 7: the EEPROM has two-byte addresses, as those above 16 kbit have.
const TWO_BYTE_ADDRESS: u16 = 0x0080;
/// Commands in bits 10–8.
const COMMAND_READ: u16 = 0x0100;
const COMMAND_WRITE: u16 = 0x0200;
const COMMAND_RELOAD: u16 = 0x0400;
/// Status bit 15: a command is under way.
const BUSY: u16 = 0x8000;
/// Status bit 13: the command was not executed.
const COMMAND_ERROR: u16 = 0x2000;
/// Status bit 14: write command without write enable.
const WRITE_ENABLE_ERROR: u16 = 0x4000;

impl Esc {
    /// Whether the EEPROM is given to the device's processor, not to the MainDevice.
    pub(crate) fn sii_is_with_the_device(&self) -> bool {
        self.byte(reg::SII_OWNER) & 0x01 != 0
    }

    /// The processor has access (0501h, bit 0), and keeps it until it is taken by force.
    pub(crate) fn hold_sii(&mut self) {
        self.set_byte(reg::SII_ACCESS, 0x01);
    }

    /// Value of the control/status register when no command is under way.
    pub(super) fn sii_idle_status(&self) -> u16 {
        let width = if self.sii_reads_eight_bytes {
            READS_EIGHT_BYTES
        } else {
            0
        };
        let emulated = if self.emulates_sii { EMULATED } else { 0 };
        width | TWO_BYTE_ADDRESS | emulated
    }

    /// A write to the owner register: bit 0 gives the EEPROM to the device, bit 1 takes it back by force.
    pub(super) fn write_sii_owner(&mut self, value: u8) {
        let owner = if value & 0x02 != 0 {
            self.set_byte(reg::SII_ACCESS, 0);
            0
        } else {
            value & 0x01
        };
        self.set_byte(reg::SII_OWNER, owner);
    }

    /// A write to the control register executes its command, which takes the EEPROM its time.
    pub(super) fn sii_command(&mut self, control: u16, now: Duration) {
        if self.sii_busy_until.is_some_and(|until| now < until) {
            return;
        }
        if control & 0x0700 != 0 {
            self.sii_accesses += 1;
            let takes_time = !self.sii_delay.is_zero();
            self.sii_busy_until = takes_time.then(|| now.saturating_add(self.sii_delay));
        }
        let idle = self.sii_idle_status();
        if self.sii_is_with_the_device() || self.byte(reg::SII_ACCESS) & 0x01 != 0 {
            self.set_word(reg::SII_CONTROL, idle | COMMAND_ERROR);
            return;
        }
        let word = usize::try_from(self.double_word(reg::SII_ADDRESS)).unwrap_or(usize::MAX);
        let status = match control & 0x0700 {
            0 => idle,
            COMMAND_READ => {
                self.sii_read(word);
                idle
            }
            COMMAND_WRITE if control & WRITE_ENABLE == 0 => idle | WRITE_ENABLE_ERROR,
            COMMAND_WRITE => {
                self.sii_write(word);
                idle
            }
            COMMAND_RELOAD => {
                self.load_configuration();
                idle
            }
            _ => idle | COMMAND_ERROR,
        };
        self.set_word(reg::SII_CONTROL, status);
    }

    /// Shows whether a command is under way.
    pub(super) fn refresh_sii(&mut self, now: Duration) {
        let busy = self.sii_busy_until.is_some_and(|until| now < until);
        let status = self.word(reg::SII_CONTROL) & !BUSY;
        self.set_word(reg::SII_CONTROL, status | if busy { BUSY } else { 0 });
    }

    /// Copies words into the data register; behind the end the EEPROM reads as FFh.
    fn sii_read(&mut self, word: usize) {
        let count: u16 = if self.sii_reads_eight_bytes { 8 } else { 4 };
        for at in 0..count {
            let from = word
                .checked_mul(2)
                .and_then(|first| first.checked_add(usize::from(at)));
            let value = from
                .and_then(|from| self.sii.get(from))
                .copied()
                .unwrap_or(0xFF);
            self.set_byte(reg::SII_DATA + at, value);
        }
    }

    /// Writes one word; outside of the EEPROM nothing happens.
    fn sii_write(&mut self, word: usize) {
        let value = self.word(reg::SII_DATA).to_le_bytes();
        let target = word
            .checked_mul(2)
            .and_then(|first| self.sii.get_mut(first..first.checked_add(2)?));
        if let Some(target) = target {
            target.copy_from_slice(&value);
        }
    }

    /// What an ESC takes over from the EEPROM at power-up: the station alias (word 4).
    pub(super) fn load_configuration(&mut self) {
        let alias = crate::frame::read_u16(&self.sii, 8).unwrap_or(0);
        self.set_word(reg::STATION_ALIAS, alias);
    }
}
