//! One sync manager: the gate between the MainDevice and the drive's processor for a piece of memory.
//! Mailboxes hand over one message at a time; process data is exchanged through three buffers, always the newest whole one.

/// What the eight registers of a sync manager say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Settings {
    pub(crate) start: u16,
    pub(crate) length: u16,
    pub(crate) control: u8,
    pub(crate) enabled: bool,
    pub(crate) repeat_request: bool,
}

impl Settings {
    /// Decodes start, length, control, status, activation and PDI control.
    pub(crate) fn from_registers(registers: &[u8]) -> Self {
        let byte = |at: usize| registers.get(at).copied().unwrap_or(0);
        Self {
            start: u16::from_le_bytes([byte(0), byte(1)]),
            length: u16::from_le_bytes([byte(2), byte(3)]),
            control: byte(4),
            enabled: byte(6) & 0x01 != 0 && byte(7) & 0x01 == 0,
            repeat_request: byte(6) & 0x02 != 0,
        }
    }

    /// Control bits 1–0: 10b is the mailbox mode.
    pub(crate) fn is_mailbox(self) -> bool {
        self.control & 0x03 == 0x02
    }

    /// Control bits 3–2: 01b lets the MainDevice write.
    pub(crate) fn master_writes(self) -> bool {
        self.control & 0x0C == 0x04
    }

    /// Control bit 6: a completed write triggers the process-data watchdog.
    pub(crate) fn triggers_watchdog(self) -> bool {
        self.control & 0x40 != 0
    }

    /// Bytes of memory that it takes: three buffers for process data, one for a mailbox.
    pub(crate) fn occupied(self) -> core::ops::Range<usize> {
        let start = usize::from(self.start);
        let buffers = if self.is_mailbox() { 1 } else { 3 };
        start..start + buffers * usize::from(self.length)
    }
}

/// What a sync manager remembers between accesses.
#[derive(Clone, Debug, Default)]
pub(crate) struct SyncManager {
    /// The mailbox holds a message that was not taken yet.
    pub(crate) full: bool,
    /// An access to the first byte has opened the buffer.
    opened: bool,
    /// Outputs: the newest whole buffer that the MainDevice wrote. Inputs: the newest one that the processor wrote.
    pub(crate) buffer: Vec<u8>,
    /// Number of buffers completed since it was enabled.
    pub(crate) completed: u32,
}

/// What an access to a part of the sync manager's memory led to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    /// The gate is closed: no byte is read or written, nothing is counted.
    Refused,
    /// Bytes pass, the buffer goes on.
    Passes {
        /// The access begins at the first byte: a new buffer.
        first: bool,
        /// The access includes the last byte: the buffer changes hands.
        last: bool,
    },
}

impl SyncManager {
    /// Decides about an access of the MainDevice to `offset..offset + length` inside the buffer.
    pub(crate) fn access(
        &mut self,
        settings: Settings,
        write: bool,
        offset: usize,
        length: usize,
    ) -> Access {
        if write != settings.master_writes() {
            return Access::Refused;
        }
        let first = offset == 0;
        let last = offset + length >= usize::from(settings.length);
        if settings.is_mailbox() {
            // A mailbox that is to be written must be empty, one that is to be read must be full.
            if self.full == write {
                return Access::Refused;
            }
            if !first && !self.opened {
                return Access::Refused;
            }
            self.opened = !last;
            if last {
                self.full = write;
            }
        }
        Access::Passes { first, last }
    }

    /// Status byte (+5): bit 3 mailbox full, bits 5–4 the buffer last written, 11b before the first.
    pub(crate) fn status(&self, settings: Settings) -> u8 {
        if settings.is_mailbox() {
            u8::from(self.full) << 3
        } else if self.completed == 0 {
            0x30
        } else {
            // The remainder of a division by three fits a byte.
            (((self.completed - 1) % 3) as u8) << 4
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAILBOX_OUT: Settings = Settings {
        start: 0x1800,
        length: 16,
        control: 0x26,
        enabled: true,
        repeat_request: false,
    };
    const MAILBOX_IN: Settings = Settings {
        start: 0x1C00,
        length: 16,
        control: 0x22,
        enabled: true,
        repeat_request: false,
    };
    const OUTPUTS: Settings = Settings {
        start: 0x1100,
        length: 4,
        control: 0x24,
        enabled: true,
        repeat_request: false,
    };

    #[test]
    fn a_full_mailbox_refuses_a_write() {
        let mut sm = SyncManager::default();
        assert_eq!(
            sm.access(MAILBOX_OUT, true, 0, 16),
            Access::Passes {
                first: true,
                last: true
            }
        );
        assert!(sm.full);
        assert_eq!(sm.access(MAILBOX_OUT, true, 0, 16), Access::Refused);
    }

    #[test]
    fn an_empty_mailbox_refuses_a_read() {
        let mut sm = SyncManager::default();
        assert_eq!(sm.access(MAILBOX_IN, false, 0, 16), Access::Refused);
        sm.full = true;
        assert_eq!(
            sm.access(MAILBOX_IN, false, 0, 16),
            Access::Passes {
                first: true,
                last: true
            }
        );
        assert!(!sm.full);
    }

    #[test]
    fn a_message_counts_only_with_its_last_byte() {
        let mut sm = SyncManager::default();
        assert_eq!(
            sm.access(MAILBOX_OUT, true, 0, 15),
            Access::Passes {
                first: true,
                last: false
            }
        );
        assert!(!sm.full);
        assert_eq!(
            sm.access(MAILBOX_OUT, true, 15, 1),
            Access::Passes {
                first: false,
                last: true
            }
        );
        assert!(sm.full);
    }

    #[test]
    fn a_mailbox_that_was_not_opened_at_its_first_byte_refuses_the_rest() {
        let mut sm = SyncManager::default();
        assert_eq!(sm.access(MAILBOX_OUT, true, 15, 1), Access::Refused);
        assert!(!sm.full);
    }

    #[test]
    fn outputs_cannot_be_read_by_the_main_device() {
        let mut sm = SyncManager::default();
        assert_eq!(sm.access(OUTPUTS, false, 0, 4), Access::Refused);
        assert_eq!(
            sm.access(OUTPUTS, true, 0, 4),
            Access::Passes {
                first: true,
                last: true
            }
        );
    }

    #[test]
    fn the_settings_of_an_akd_decode_to_a_mailbox_that_the_main_device_writes() {
        // SM0 of a Kollmorgen AKD as a master enables it: 1800h, 1024 bytes, 26h.
        let settings = Settings::from_registers(&[0x00, 0x18, 0x00, 0x04, 0x26, 0x00, 0x01, 0x00]);
        assert!(settings.is_mailbox() && settings.master_writes() && settings.enabled);
        assert_eq!((settings.start, settings.length), (0x1800, 1024));
    }
}
