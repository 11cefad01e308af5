//! Which mailboxes hold a mail, seen within the cycle's frames: a few datagrams that read the state of one mailbox each, and
//! go round over the drives.

use super::frame::{self, DATAGRAM_OVERHEAD};
use super::packing::{Frame, StatusSlot};
use crate::coe::MailSignal;

/// Status of sync manager 1, the mailbox that the MainDevice reads (ETG.1000.4).
pub(super) const STATUS: u16 = 0x080D;
/// Bit 3 of the status: the mailbox is full.
const MAIL_WAITS: u8 = 0x08;
/// Bytes of such a datagram's data.
pub(super) const STATUS_BYTES: usize = 1;
/// Each mailbox is looked at once in this many cycles, as long as there are no more than this many times [`MOST_PER_FRAME`]
/// for each frame.
const LOOK_EVERY: usize = 8;
/// Datagrams of a frame that read such a state.
const MOST_PER_FRAME: usize = 4;
/// What they may take of each frame.
pub(super) const RESERVED: usize = MOST_PER_FRAME * (DATAGRAM_OVERHEAD + STATUS_BYTES);

/// A mailbox that is looked at.
#[derive(Debug, Clone)]
pub(super) struct Watched {
    /// The drive's station address.
    pub(super) station: u16,
    /// Tells its client.
    pub(super) signal: MailSignal,
}

/// How many datagrams read mailbox states, in this many frames.
pub(super) fn status_slots(mailboxes: usize, frames: usize) -> usize {
    mailboxes
        .div_ceil(LOOK_EVERY)
        .min(frames.saturating_mul(MOST_PER_FRAME))
}

/// The mailboxes, and whose turn it is.
#[derive(Debug)]
pub(super) struct MailboxStates {
    mailboxes: Vec<Watched>,
    /// Whose turn it is in the first datagram; the following ones are of those behind it.
    turn: usize,
}

impl MailboxStates {
    pub(super) const fn new(mailboxes: Vec<Watched>) -> Self {
        Self { mailboxes, turn: 0 }
    }

    /// Addresses the datagrams to those whose turn it is.
    pub(super) fn address(&mut self, slots: &[StatusSlot], frames: &mut [Frame]) {
        let Some(count) = core::num::NonZeroUsize::new(self.mailboxes.len()) else {
            return;
        };
        self.turn = (self.turn + slots.len()) % count;
        for (slot, watched) in slots.iter().zip(self.in_turn()) {
            let address = frames
                .get_mut(slot.frame)
                .and_then(|frame| frame::station_mut(&mut frame.request, slot.data));
            if let Some(address) = address {
                *address = watched.station.to_le_bytes();
            }
        }
    }

    /// Tells the clients what was seen in the frames that came back.
    pub(super) fn judge(&self, slots: &[StatusSlot], frames: &[Frame]) {
        for (slot, watched) in slots.iter().zip(self.in_turn()) {
            let answer = frames
                .get(slot.frame)
                .filter(|frame| frame.back)
                .and_then(|frame| frame.answer.get(slot.data..slot.data + STATUS_BYTES + 2));
            // One that does not answer has not been seen.
            if let Some(&[status, 1, 0]) = answer {
                watched.signal.observe(status & MAIL_WAITS != 0);
            }
        }
    }

    fn in_turn(&self) -> impl Iterator<Item = &Watched> {
        let (before, from) = self
            .mailboxes
            .split_at_checked(self.turn)
            .unwrap_or_default();
        from.iter().chain(before)
    }
}

impl Drop for MailboxStates {
    /// The clients look themselves again.
    fn drop(&mut self) {
        for watched in &self.mailboxes {
            watched.signal.end();
        }
    }
}
