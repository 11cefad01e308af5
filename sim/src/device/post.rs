//! The mailbox's way through the sync managers.

use crate::esc::Esc;
use crate::mailbox::Post;

/// The mailbox's two sync managers.
pub(super) struct SyncManagers<'a> {
    pub(super) esc: &'a mut Esc,
    pub(super) out: usize,
    pub(super) input: usize,
}

impl Post for SyncManagers<'_> {
    fn take(&mut self) -> Option<Vec<u8>> {
        self.esc.take_message(self.out)
    }

    fn waits(&self) -> bool {
        self.esc.message_waits(self.input)
    }

    fn put(&mut self, mail: &[u8]) -> bool {
        self.esc.put_message(self.input, mail)
    }

    fn withdraw(&mut self) {
        self.esc.withdraw_message(self.input);
    }

    fn repeat_is_requested(&self) -> bool {
        self.esc.repeat_is_requested(self.input)
    }

    fn acknowledge_repeat(&mut self) {
        self.esc.acknowledge_repeat(self.input);
    }
}
