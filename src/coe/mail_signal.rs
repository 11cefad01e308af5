//! What the bus loop sees of a device's mailbox within its cycles, for the client of that mailbox.

use alloc::sync::Arc;
use core::{
    future::poll_fn,
    sync::atomic::{AtomicBool, AtomicU8, Ordering},
    task::Poll,
};

use atomic_waker::AtomicWaker;

/// Nobody else looks at the mailbox: the client does.
const UNWATCHED: u8 = 0;
/// No message waited when the mailbox was looked at last.
const EMPTY: u8 = 1;
/// A message waits.
const FULL: u8 = 2;

/// Wakes a mailbox client when a message waits, so that it asks for nothing while there is none. Clones are the same signal.
///
/// It follows the level of the mailbox's state: a message that is not read away is seen again. Observing neither allocates
/// nor locks.
#[derive(Debug, Clone, Default)]
pub(crate) struct MailSignal(Arc<Signal>);

#[derive(Debug, Default)]
struct Signal {
    seen: AtomicU8,
    /// The device has been in INIT since the client was at its mailbox.
    begins_anew: AtomicBool,
    client: AtomicWaker,
}

impl MailSignal {
    /// The mailbox was looked at. Frames that were sent before a message was read must have been observed before the client
    /// is polled after that reading.
    pub(crate) fn observe(&self, mail_waits: bool) {
        let seen = if mail_waits { FULL } else { EMPTY };
        if self.0.seen.swap(seen, Ordering::AcqRel) != seen && mail_waits {
            self.0.client.wake();
        }
    }

    /// The mailbox will not be looked at any more: the client does it from now on.
    pub(crate) fn end(&self) {
        self.0.seen.store(UNWATCHED, Ordering::Release);
        self.0.client.wake();
    }

    /// The device is in INIT: it has forgotten what it was to answer, and counts its messages from the beginning.
    pub(crate) fn begin_anew(&self) {
        self.0.begins_anew.store(true, Ordering::Release);
    }

    /// Whether it began anew since this was asked last.
    pub(super) fn has_begun_anew(&self) -> bool {
        self.0.begins_anew.swap(false, Ordering::AcqRel)
    }

    pub(super) fn is_watched(&self) -> bool {
        self.0.seen.load(Ordering::Acquire) != UNWATCHED
    }

    /// Forgets a message that was seen: the client has been at the mailbox since.
    pub(super) fn forget(&self) {
        // Fails where none was seen.
        let _ = self
            .0
            .seen
            .compare_exchange(FULL, EMPTY, Ordering::AcqRel, Ordering::Acquire);
    }

    /// Resolves when a message waits (true), or nobody looks any more (false).
    pub(super) async fn mail_waits(&self) -> bool {
        poll_fn(|context| {
            self.0.client.register(context.waker());
            match self.0.seen.load(Ordering::Acquire) {
                FULL => Poll::Ready(true),
                UNWATCHED => Poll::Ready(false),
                _ => Poll::Pending,
            }
        })
        .await
    }
}
