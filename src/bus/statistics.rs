//! What the bus loop counts.

use std::sync::atomic::{AtomicU64, Ordering};

/// What the bus loop has counted since it started.
///
/// ```
/// use servocrab::bus::Statistics;
/// let nothing_yet = Statistics::default();
/// assert_eq!(nothing_yet.cycles, 0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Statistics {
    /// Cycles of process data.
    pub cycles: u64,
    /// Frames of process data that did not come back within their cycle.
    pub lost: u64,
    /// Frames that came back after their time, or twice; they were used for nothing.
    pub late: u64,
    /// Frames that were cut or changed on their way.
    pub damaged: u64,
    /// Frames that are not ours.
    pub foreign: u64,
    /// Datagrams of process data with another working counter than expected.
    pub wrong_working_counters: u64,
    /// Cycles that began more than half a cycle late.
    pub late_cycles: u64,
    /// Frames that the link did not take.
    pub not_sent: u64,
}

#[derive(Debug, Default)]
pub(super) struct Count(AtomicU64);

impl Count {
    pub(super) fn add(&self) {
        self.add_many(1);
    }

    pub(super) fn add_many(&self, n: u64) {
        self.0.fetch_add(n, Ordering::Relaxed);
    }

    fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// The counters themselves: written by the loop, read from anywhere.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) cycles: Count,
    pub(super) lost: Count,
    pub(super) late: Count,
    pub(super) damaged: Count,
    pub(super) foreign: Count,
    pub(super) wrong_working_counters: Count,
    pub(super) late_cycles: Count,
    pub(super) not_sent: Count,
}

impl Counters {
    pub(super) fn read(&self) -> Statistics {
        Statistics {
            cycles: self.cycles.get(),
            lost: self.lost.get(),
            late: self.late.get(),
            damaged: self.damaged.get(),
            foreign: self.foreign.get(),
            wrong_working_counters: self.wrong_working_counters.get(),
            late_cycles: self.late_cycles.get(),
            not_sent: self.not_sent.get(),
        }
    }
}
