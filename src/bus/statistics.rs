//! What the bus loop counts.

use std::{
    sync::{
        OnceLock,
        atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU64, Ordering},
    },
    time::Duration,
};

use super::cable::CableLoad;
use super::dc::Measured;
use super::histogram::{Durations, Recorder};
use crate::{coe::DriveId, wakes::WakeStatistics};

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
    /// Frames of process data that were sent and did not come back within their cycle.
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
    /// Cycles that were left out, because the one before had not ended or the bus thread was not awake in time.
    pub overruns: u64,
    /// Frames that the link did not take: its interface is down, or takes only shorter ones.
    pub not_sent: u64,
    /// Acyclic frames that came back when the next cycle had begun: they may have held its frames up.
    pub acyclic_in_cycle: u64,
    /// How the cycles keep step with the reference clock, where there is one.
    pub clock: Option<ClockStatistics>,
    /// What the program's wakers did.
    pub wakes: WakeStatistics,
}

/// How the cycles keep step with the reference clock of the network's distributed clocks. The phase error is by how much later
/// than wanted a cycle's frames passed it: at a multiple of the cycle in its time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ClockStatistics {
    /// The phase error of the last cycle, in nanoseconds; negative when it was early.
    pub phase_error_ns: i64,
    /// The largest magnitude since the phase was locked first, in nanoseconds.
    pub worst_ns: i64,
    /// What a locked phase keeps to: a fiftieth of the cycle.
    pub bound: Duration,
    /// Whether the phase is locked.
    pub locked: bool,
    /// Cycles beyond the bound since the phase was locked first.
    pub beyond: u64,
    /// What the reference clock does.
    pub reference: ReferenceClock,
}

/// What the reference clock does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ReferenceClock {
    /// It gives its time.
    #[default]
    Heard,
    /// It has not given its time for 64 cycles: these go on at the speed that it had, and all other clocks follow them.
    Silent,
    /// It has shown a time that it cannot have: all clocks follow the cycles from then on, and all axes are stopped and disabled.
    Jumped,
}

const SILENT: u8 = ReferenceClock::Silent as u8;
const JUMPED: u8 = ReferenceClock::Jumped as u8;

/// The same as it is being written.
#[derive(Debug, Default)]
pub(super) struct ClockGauge {
    bound_ns: AtomicU64,
    error_ns: AtomicI64,
    worst_ns: AtomicI64,
    locked: AtomicBool,
    reference: AtomicU8,
    ever_locked: AtomicBool,
    beyond: Count,
    errors: Recorder,
}

impl ClockGauge {
    /// There is a reference clock from now on, and this bound.
    pub(super) fn begin(&self, bound: Duration) {
        let bound = u64::try_from(bound.as_nanos()).unwrap_or(u64::MAX);
        self.bound_ns.store(bound, Ordering::Relaxed);
    }

    /// A cycle.
    pub(super) fn record(&self, measured: &Measured) {
        self.error_ns.store(measured.error, Ordering::Relaxed);
        self.hold(measured.locked, measured.reference);
        if measured.locked {
            self.ever_locked.store(true, Ordering::Relaxed);
        }
        if self.ever_locked.load(Ordering::Relaxed) {
            let magnitude = measured.error.unsigned_abs();
            self.errors.record(Duration::from_nanos(magnitude));
            self.worst_ns
                .fetch_max(measured.error.saturating_abs(), Ordering::Relaxed);
            if !measured.within {
                self.beyond.add();
            }
        }
    }

    /// A cycle without the reference's time.
    pub(super) fn hold(&self, locked: bool, reference: ReferenceClock) {
        self.locked.store(locked, Ordering::Relaxed);
        self.reference.store(reference as u8, Ordering::Relaxed);
    }

    pub(super) fn read(&self) -> Option<ClockStatistics> {
        let bound = self.bound_ns.load(Ordering::Relaxed);
        (bound != 0).then(|| ClockStatistics {
            phase_error_ns: self.error_ns.load(Ordering::Relaxed),
            worst_ns: self.worst_ns.load(Ordering::Relaxed),
            bound: Duration::from_nanos(bound),
            locked: self.locked.load(Ordering::Relaxed),
            beyond: self.beyond.get(),
            reference: match self.reference.load(Ordering::Relaxed) {
                SILENT => ReferenceClock::Silent,
                JUMPED => ReferenceClock::Jumped,
                _ => ReferenceClock::Heard,
            },
        })
    }
}

/// How steady the cycles were since the bus loop started.
///
/// ```
/// use servocrab::bus::Timing;
/// let nothing_yet = Timing::default();
/// assert_eq!(nothing_yet.round_trip.count(), 0);
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Timing {
    /// How late each cycle began.
    pub lateness: Durations,
    /// From the sending of a cycle's first frame to the receiving of its last; of cycles of which all frames came back.
    pub round_trip: Durations,
    /// How far the cycles' frames were from their phase at the reference clock, either way, since the phase was locked first;
    /// nothing without distributed clocks.
    pub phase_error: Durations,
}

/// What has been counted of one drive since the cycles started.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriveStatistics {
    /// The drive.
    pub drive: DriveId,
    /// Cycles in which nothing came back from it.
    pub stale_cycles: u64,
    /// Cycles in which its inputs came back, and it is not known whether its outputs were delivered.
    pub undelivered_cycles: u64,
}

/// The counters of one drive.
#[derive(Debug, Default)]
pub(super) struct DriveCounters {
    pub(super) stale: Count,
    pub(super) undelivered: Count,
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

    pub(super) fn get(&self) -> u64 {
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
    pub(super) overruns: Count,
    pub(super) not_sent: Count,
    pub(super) acyclic_in_cycle: Count,
    pub(super) clock: ClockGauge,
    pub(super) lateness: Recorder,
    pub(super) round_trip: Recorder,
    /// What a cycle takes on the cable, once there is one.
    pub(super) cable: OnceLock<CableLoad>,
    /// In the order of the exchange, once there is one.
    pub(super) drives: OnceLock<Box<[DriveCounters]>>,
}

impl Counters {
    /// Makes room for this many drives.
    pub(super) fn count_drives(&self, drives: usize) {
        // A second exchange of the same loop has the same drives.
        let _ = self
            .drives
            .set((0..drives).map(|_| DriveCounters::default()).collect());
    }

    pub(super) fn drive(&self, place: usize) -> Option<&DriveCounters> {
        self.drives.get()?.get(place)
    }

    pub(super) fn timing(&self) -> Timing {
        Timing {
            lateness: self.lateness.read(),
            round_trip: self.round_trip.read(),
            phase_error: self.clock.errors.read(),
        }
    }

    pub(super) fn read(&self) -> Statistics {
        Statistics {
            cycles: self.cycles.get(),
            lost: self.lost.get(),
            late: self.late.get(),
            damaged: self.damaged.get(),
            foreign: self.foreign.get(),
            wrong_working_counters: self.wrong_working_counters.get(),
            late_cycles: self.late_cycles.get(),
            overruns: self.overruns.get(),
            not_sent: self.not_sent.get(),
            acyclic_in_cycle: self.acyclic_in_cycle.get(),
            clock: self.clock.read(),
            wakes: WakeStatistics::default(),
        }
    }
}
