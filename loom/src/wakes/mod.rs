//! Where futures wait.

pub(crate) use crate::sync;

#[path = "../../../src/wakes/waiters.rs"]
mod waiters;

use std::task::Waker;

use sync::{Arc, AtomicBool, Ordering, fence};
pub(crate) use waiters::Waiters;
use waiters::WakeSignal;

/// Waiters, and who wakes.
#[derive(Clone)]
pub(crate) struct Shared {
    pub(crate) waiters: Arc<Waiters>,
    signal: Arc<WakeSignal>,
}

impl Shared {
    pub(crate) fn new() -> Self {
        let signal = Arc::new(WakeSignal {
            change: AtomicBool::new(false),
            over: AtomicBool::new(false),
        });
        Self {
            waiters: Arc::new(Waiters::new(Arc::clone(&signal))),
            signal,
        }
    }

    /// What the thread that wakes does when there is news.
    pub(crate) fn wake_rung(&self) {
        let mut wakers = Vec::new();
        self.waiters.take_rung(&mut wakers);
        wakers.into_iter().for_each(Waker::wake);
    }

    /// The end: whoever rings after it wakes.
    pub(crate) fn end(&self) {
        self.signal.end();
        self.wake_rung();
    }
}
