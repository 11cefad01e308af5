//! What all axes of a network share with the bus thread: that one of them was asked for anything, the time, and who wakes their futures.

use core::{
    sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    time::Duration,
};
use std::sync::Arc;

use crate::wakes::{End, Waiters, Wakes};

use super::Groups;

/// The channel of all futures that sleep.
const TIME: u32 = 0;

#[derive(Debug)]
pub(super) struct NetworkSignals {
    /// Whether the program has stored anything for the bus thread, with any of the axes, since it looked last.
    asked: AtomicBool,
    /// How many futures wait for a change of any of the axes.
    watchers: AtomicUsize,
    /// How many cycles there were, where all axes are stepped together.
    cycles: AtomicU64,
    /// The time of the last cycle, and when the next sleeper is to be woken, in nanoseconds.
    now: AtomicU64,
    due: AtomicU64,
    sleepers: Arc<Waiters>,
    /// Who wakes the futures of all axes.
    wakes: Wakes,
    /// None where somebody else ends it.
    _end: Option<End>,
}

impl NetworkSignals {
    pub fn new(wakes: Wakes, end: Option<End>) -> Self {
        Self {
            sleepers: wakes.waiters(),
            wakes,
            _end: end,
            asked: AtomicBool::new(false),
            watchers: AtomicUsize::new(0),
            cycles: AtomicU64::new(0),
            now: AtomicU64::new(0),
            due: AtomicU64::new(u64::MAX),
        }
    }

    /// Call this after an axis has got a request.
    pub fn ask(&self) {
        // An exchange and no store: so the bus thread sees what every thread has stored before it asked, and not only the last one.
        self.asked.swap(true, Ordering::Release);
    }

    /// A task holds this while it waits for a change of any of the axes.
    pub fn watch(&self) -> Watch<'_> {
        self.watchers.fetch_add(1, Ordering::AcqRel);
        Watch(self)
    }

    /// Where the futures of an axis wait.
    pub fn waiters(&self) -> Arc<Waiters> {
        self.wakes.waiters()
    }

    /// Has those futures woken for which there is something new.
    pub fn hand_over(&self) {
        self.wakes.hand_over();
    }

    /// How many cycles there were in which all axes were stepped, or left at rest.
    pub fn cycles(&self) -> u64 {
        self.cycles.load(Ordering::Acquire)
    }

    /// The network's time: that of its last cycle.
    pub fn now(&self) -> Duration {
        Duration::from_nanos(self.now.load(Ordering::Acquire))
    }

    /// Sleeps until this moment of the network's time. It does not come once the network has ended.
    pub async fn sleep_until(&self, until: Duration) {
        let is_over = || {
            if self.now() >= until {
                return Some(());
            }
            self.due.fetch_min(nanoseconds(until), Ordering::SeqCst);
            None
        };
        self.sleepers.until(TIME, is_over).await;
    }

    /// Says what time it is. Call this once a cycle.
    #[inline]
    pub fn note_time(&self, now: Duration) {
        let now = nanoseconds(now);
        self.now.store(now, Ordering::Release);
        if now >= self.due.load(Ordering::Relaxed) {
            self.wake_sleepers();
        }
    }

    #[cold]
    fn wake_sleepers(&self) {
        // A future that sleeps on sets it again.
        self.due.store(u64::MAX, Ordering::SeqCst);
        self.sleepers.announce(TIME);
    }
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// A task waits for a change.
pub(super) struct Watch<'a>(&'a NetworkSignals);

impl Drop for Watch<'_> {
    fn drop(&mut self) {
        self.0.watchers.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Groups {
    /// Whether any of the axes was asked for anything since the last call. If not, no port has anything to take in.
    pub(crate) fn take_asked(&self) -> bool {
        self.signals.asked.swap(false, Ordering::AcqRel)
    }

    /// Whether a task waits for a change of any of the axes. Call [`stored`](crate::wakes::stored) before.
    pub(crate) fn are_watched(&self) -> bool {
        self.signals.watchers.load(Ordering::Relaxed) != 0
    }

    /// Says how many cycles there were. Call this when every axis was stepped, or left at rest.
    pub(crate) fn count_to(&self, cycles: u64) {
        self.signals.cycles.store(cycles, Ordering::Release);
    }
}
