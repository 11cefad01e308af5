//! The SII interface of an ESC (0500h–050Fh): the MainDevice reads and writes the EEPROM word by word through it
//! (ETG.1000.4; data sheet of the ET1100, section I, SII EEPROM).

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
/// Status bits 11 and 12: the checksum of words 0 to 6 is wrong; they were not loaded.
const NOT_LOADED: u16 = 0x1800;
/// With this in word 7 the checksum counts for nothing.
const CHECKSUM_OFF: u16 = 0x88A4;
/// Status bit 15: a command is under way.
const BUSY: u16 = 0x8000;
/// Status bit 13: the command was not executed.
const COMMAND_ERROR: u16 = 0x2000;
/// Status bit 14: write command without write enable.
const WRITE_ENABLE_ERROR: u16 = 0x4000;

/// What a reload of the EEPROM (0502h, command 4) does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum EepromReload {
    /// It is no command that the device knows.
    Refused,
    /// Words 0 to 6 are taken over, but for the station alias, which counts from the next power-up: an ET1100.
    #[default]
    WithoutAlias,
    /// The station alias (0012h) is taken over, too.
    WithAlias,
}

/// A word that the EEPROM is at work on: erased, and not written yet.
#[derive(Clone, Copy, Debug)]
pub(super) struct WrittenWord {
    at: usize,
    value: [u8; 2],
    done: Duration,
}

impl Esc {
    /// What is in the EEPROM.
    pub(crate) fn sii(&self) -> &[u8] {
        &self.sii
    }

    /// Whether words 0 to 6 were loaded at power-up. Without them the ESC does not know how its processor is connected.
    pub(crate) fn is_sii_loaded(&self) -> bool {
        self.sii_loaded
    }

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
        width | TWO_BYTE_ADDRESS | emulated | self.sii_load_status
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
        self.finish_sii_write(now);
        let command = control & 0x0700;
        if command != 0 {
            self.sii_accesses += 1;
            let until = match command {
                _ if self.emulates_sii && !self.processor_runs() => Duration::MAX,
                COMMAND_WRITE if self.emulates_sii => self.sii_delay + self.sii_write_delay,
                _ => self.sii_delay,
            };
            self.sii_busy_until = (!until.is_zero()).then(|| now.saturating_add(until));
        }
        let idle = self.sii_idle_status();
        let is_with_the_device =
            self.sii_is_with_the_device() || self.byte(reg::SII_ACCESS) & 0x01 != 0;
        // An EEPROM that is at work on a word acknowledges nothing.
        if is_with_the_device || command != 0 && self.sii_written.is_some() {
            self.set_word(reg::SII_CONTROL, idle | COMMAND_ERROR);
            return;
        }
        let word = usize::try_from(self.double_word(reg::SII_ADDRESS)).unwrap_or(usize::MAX);
        let status = match command {
            0 => idle,
            COMMAND_READ => {
                self.sii_read(word);
                idle
            }
            COMMAND_WRITE if control & WRITE_ENABLE == 0 => idle | WRITE_ENABLE_ERROR,
            COMMAND_WRITE => {
                self.sii_write(word, now);
                idle
            }
            COMMAND_RELOAD if self.sii_reload != EepromReload::Refused => {
                self.load_configuration();
                if self.sii_reload == EepromReload::WithAlias {
                    self.load_alias();
                }
                self.sii_idle_status()
            }
            _ => idle | COMMAND_ERROR,
        };
        self.set_word(reg::SII_CONTROL, status);
    }

    /// Shows whether a command is under way.
    pub(super) fn refresh_sii(&mut self, now: Duration) {
        self.finish_sii_write(now);
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

    /// Writes one word: first it is erased. Outside of the EEPROM nothing happens.
    fn sii_write(&mut self, word: usize, now: Duration) {
        let value = self.word(reg::SII_DATA).to_le_bytes();
        let Some(at) = word.checked_mul(2) else {
            return;
        };
        self.put_sii(at, [0xFF; 2]);
        let takes = self.sii_delay + self.sii_write_delay;
        let done = now.saturating_add(takes);
        self.sii_written = Some(WrittenWord { at, value, done });
        self.finish_sii_write(now);
    }

    /// Without power before this the word stays erased.
    fn finish_sii_write(&mut self, now: Duration) {
        if let Some(WrittenWord { at, value, .. }) =
            self.sii_written.take_if(|written| now >= written.done)
        {
            self.put_sii(at, value);
        }
    }

    fn put_sii(&mut self, at: usize, value: [u8; 2]) {
        if let Some(target) = at.checked_add(2).and_then(|end| self.sii.get_mut(at..end)) {
            target.copy_from_slice(&value);
        }
    }

    /// What an ESC takes over from the EEPROM at power-up. The station alias is 0 until words 0 to 6 are right for the first time.
    pub(super) fn power_up_sii(&mut self) {
        self.load_configuration();
        self.sii_loaded = self.sii_load_status == 0;
        self.load_alias();
        self.set_word(reg::SII_CONTROL, self.sii_idle_status());
    }

    /// Words 0 to 6, if their checksum is right.
    fn load_configuration(&mut self) {
        let word = crate::frame::read_u16(&self.sii, 14).unwrap_or(0);
        let expected = crate::sii::checksum(self.sii.get(..14).unwrap_or(&[]));
        let is_right = word == CHECKSUM_OFF || word.to_le_bytes()[0] == expected;
        self.sii_load_status = if is_right { 0 } else { NOT_LOADED };
    }

    /// Puts a station alias into the EEPROM, with the checksum of words 0 to 6, and takes it over.
    pub(crate) fn set_alias(&mut self, alias: u16) {
        self.put_sii(8, alias.to_le_bytes());
        let checksum = crate::sii::checksum(self.sii.get(..14).unwrap_or(&[]));
        self.put_sii(14, [checksum, 0]);
        self.load_alias();
    }

    fn load_alias(&mut self) {
        if self.sii_load_status == 0 {
            let alias = crate::frame::read_u16(&self.sii, 8).unwrap_or(0);
            self.set_word(reg::STATION_ALIAS, alias);
        }
    }
}
