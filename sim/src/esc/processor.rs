//! The ESC as the device's processor sees it: AL registers, mailboxes, process-data buffers, watchdog.

use core::time::Duration;

use super::registers as reg;
use super::registers::{CHANNELS, RAM_END, RAM_START};
use super::{Esc, sync_manager_register};

impl Esc {
    /// The newest AL control that the MainDevice wrote, once.
    pub(crate) fn take_al_control(&mut self) -> Option<u16> {
        core::mem::take(&mut self.al_control_written).then(|| self.word(reg::AL_CONTROL))
    }

    /// Whether the MainDevice wrote to the sync managers' registers since this was last asked.
    pub(crate) fn take_sync_manager_change(&mut self) -> bool {
        core::mem::take(&mut self.sync_managers_written)
    }

    /// Publishes AL status and status code.
    pub(crate) fn set_al_status(&mut self, status: u16, code: u16) {
        self.set_word(reg::AL_STATUS, status);
        self.set_word(reg::AL_STATUS_CODE, code);
    }

    /// Puts a word into registers or memory.
    pub(crate) fn show_word(&mut self, address: u16, value: u16) {
        self.set_word(address, value);
    }

    /// How many buffers the MainDevice has completed in a sync manager since that was enabled.
    pub(crate) fn completed_buffers(&self, index: usize) -> u32 {
        self.sync_managers.get(index).map_or(0, |sm| sm.completed)
    }

    /// The newest whole buffer of an output sync manager.
    pub(crate) fn buffer(&self, index: usize) -> &[u8] {
        self.sync_managers.get(index).map_or(&[], |sm| &sm.buffer)
    }

    /// The processor writes a whole input buffer.
    pub(crate) fn set_buffer(&mut self, index: usize, bytes: &[u8]) {
        if let Some(sm) = self.sync_managers.get_mut(index) {
            bytes.clone_into(&mut sm.buffer);
        }
    }

    /// The processor takes the message that the MainDevice wrote.
    pub(crate) fn take_message(&mut self, index: usize) -> Option<Vec<u8>> {
        let settings = self.sync_manager(index);
        let sm = self.sync_managers.get_mut(index)?;
        if !(settings.enabled && sm.full) {
            return None;
        }
        sm.full = false;
        self.messages_taken += 1;
        let start = usize::from(settings.start);
        self.memory
            .get(start..start + usize::from(settings.length))
            .map(<[u8]>::to_vec)
    }

    /// The processor puts a message; `false` when the mailbox is off, still full or too small for it.
    pub(crate) fn put_message(&mut self, index: usize, mail: &[u8]) -> bool {
        if !self.message_fits(index, mail.len()) {
            return false;
        }
        let settings = self.sync_manager(index);
        let start = usize::from(settings.start);
        let Some(target) = self
            .memory
            .get_mut(start..start + usize::from(settings.length))
        else {
            return false;
        };
        target.fill(0);
        target
            .iter_mut()
            .zip(mail)
            .for_each(|(target, byte)| *target = *byte);
        if let Some(sm) = self.sync_managers.get_mut(index) {
            sm.full = true;
        }
        true
    }

    /// Whether a message of this length could be put now.
    fn message_fits(&self, index: usize, length: usize) -> bool {
        let settings = self.sync_manager(index);
        settings.enabled && !self.message_waits(index) && length <= usize::from(settings.length)
    }

    /// Whether a message lies in the mailbox.
    pub(crate) fn message_waits(&self, index: usize) -> bool {
        self.sync_managers.get(index).is_some_and(|sm| sm.full)
    }

    /// The processor takes back a message that was not read.
    pub(crate) fn withdraw_message(&mut self, index: usize) {
        if let Some(sm) = self.sync_managers.get_mut(index) {
            sm.full = false;
        }
    }

    /// Whether a sync manager's memory, all buffers of it, is inside the RAM and no other enabled one's.
    pub(crate) fn is_clear_of_others(&self, index: usize) -> bool {
        let own = self.sync_manager(index).occupied();
        let overlaps = |other: usize| {
            let settings = self.sync_manager(other);
            let range = settings.occupied();
            other != index && settings.enabled && range.start < own.end && own.start < range.end
        };
        own.start >= RAM_START && own.end <= RAM_END && !(0..CHANNELS).any(overlaps)
    }

    /// Whether the MainDevice has toggled the repeat request of this mailbox and the processor has not answered it.
    pub(crate) fn repeat_is_requested(&self, index: usize) -> bool {
        let acknowledged = self.byte(sync_manager_register(index) + 7) & 0x02 != 0;
        self.sync_manager(index).repeat_request != acknowledged
    }

    /// The processor answers a repeat request by copying its toggle.
    pub(crate) fn acknowledge_repeat(&mut self, index: usize) {
        let ack = if self.sync_manager(index).repeat_request {
            0x02
        } else {
            0
        };
        let at = sync_manager_register(index) + 7;
        self.set_byte(at, self.byte(at) & !0x02 | ack);
    }

    /// Whether outputs come in time, as far as the watchdog can tell (0440h bit 0).
    pub(crate) fn watchdog_is_running(&self) -> bool {
        self.watchdog.is_running()
    }

    /// Whether the process-data watchdog watches at all: time not zero and the sync manager triggers it.
    pub(crate) fn watchdog_is_armed(&self, outputs: usize) -> bool {
        self.watchdog_has_time() && self.sync_manager(outputs).triggers_watchdog()
    }

    /// Whether the process-data watchdog's time is not zero.
    pub(crate) fn watchdog_has_time(&self) -> bool {
        self.watchdog_timeout().is_some()
    }

    /// When the watchdog expires if nothing comes.
    pub(crate) fn watchdog_deadline(&self) -> Option<Duration> {
        self.watchdog.deadline(self.watchdog_timeout())
    }

    /// Looks at the watchdog; `true` at the moment of expiry, which is also counted.
    pub(crate) fn check_watchdog(&mut self, now: Duration) -> bool {
        let expired = self.watchdog.check(self.watchdog_timeout(), now);
        if expired {
            let count = self.byte(reg::WATCHDOG_COUNTER).saturating_add(1);
            self.set_byte(reg::WATCHDOG_COUNTER, count);
        }
        expired
    }
}
