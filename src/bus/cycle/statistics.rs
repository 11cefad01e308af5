//! What the bus loop counts.

use std::{
    ops::RangeInclusive,
    sync::{
        OnceLock,
        atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU64, Ordering},
    },
    time::Duration,
};

use histogram::{AtomicHistogram, Histogram};

use crate::{
    bus::{cable::CableLoad, cycle::reference_clock::Measured, error::ReferenceClock},
    coe::DriveId,
    wakes::WakeStatistics,
};

/// What the bus loop has counted since it started.
///
/// ```
/// use servocrab::bus::Statistics;
/// let nothing_yet = Statistics::default();
/// assert_eq!(nothing_yet.cycles, 0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct Statistics {
    /// Cycles of process data.
    pub cycles: u64,
    /// Frames of process data that were sent and did not come back within their cycle.
    pub lost: u64,
    /// Frames that came back after their time, or twice; they were used for nothing.
    pub late: u64,
    /// How long the process-data frame was away that came back latest after its cycle; `None` where none did.
    pub latest: Option<Duration>,
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
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
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

const SILENT: u8 = ReferenceClock::Silent as u8;
const JUMPED: u8 = ReferenceClock::Jumped as u8;

/// The same as it is being written.
#[derive(Debug, Default)]
pub(in crate::bus) struct ClockGauge {
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
    pub fn begin(&self, bound: Duration) {
        let bound = u64::try_from(bound.as_nanos()).unwrap_or(u64::MAX);
        self.bound_ns.store(bound, Ordering::Relaxed);
    }

    /// A cycle.
    pub fn record(&self, measured: &Measured) {
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
    pub fn hold(&self, locked: bool, reference: ReferenceClock) {
        self.locked.store(locked, Ordering::Relaxed);
        self.reference.store(reference as u8, Ordering::Relaxed);
    }

    pub fn read(&self) -> Option<ClockStatistics> {
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
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
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
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub struct DriveStatistics {
    /// The drive.
    pub drive: DriveId,
    /// Cycles in which nothing came back from it.
    pub stale_cycles: u64,
    /// Cycles in which its inputs came back, and it is not known whether its outputs were delivered.
    pub undelivered_cycles: u64,
    /// Its emergencies by code, from the bring-up on: as [`Emergencies::counted`](crate::coe::Emergencies::counted).
    pub emergencies: Vec<(Option<u16>, u64)>,
}

/// The counters of one drive.
#[derive(Debug, Default)]
pub(in crate::bus) struct DriveCounters {
    pub stale: Count,
    pub undelivered: Count,
}

#[derive(Debug, Default)]
pub(in crate::bus) struct Count(AtomicU64);

impl Count {
    pub fn add(&self) {
        self.add_many(1);
    }

    pub fn add_many(&self, n: u64) {
        self.0.fetch_add(n, Ordering::Relaxed);
    }

    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// The counters themselves: written by the loop, read from anywhere.
#[derive(Debug, Default)]
pub(in crate::bus) struct Counters {
    pub cycles: Count,
    pub lost: Count,
    pub late: Count,
    /// Nanoseconds; 0 for none.
    latest: AtomicU64,
    pub damaged: Count,
    pub foreign: Count,
    pub wrong_working_counters: Count,
    pub late_cycles: Count,
    pub overruns: Count,
    pub not_sent: Count,
    pub acyclic_in_cycle: Count,
    pub clock: ClockGauge,
    pub lateness: Recorder,
    pub round_trip: Recorder,
    /// What a cycle takes on the cable, once there is one.
    pub cable: OnceLock<CableLoad>,
    /// In the order of the exchange, once there is one.
    pub drives: OnceLock<Box<[DriveCounters]>>,
}

impl Counters {
    /// Makes room for this many drives.
    pub fn count_drives(&self, drives: usize) {
        // A second exchange of the same loop has the same drives.
        let _ = self
            .drives
            .set((0..drives).map(|_| DriveCounters::default()).collect());
    }

    /// A frame of process data came back after its cycle, and was away for so long.
    pub fn came_late(&self, away: Duration) {
        let away = u64::try_from(away.as_nanos()).unwrap_or(u64::MAX);
        self.latest.fetch_max(away, Ordering::Relaxed);
    }

    /// How long the latest of them was away.
    pub fn latest(&self) -> Option<Duration> {
        match self.latest.load(Ordering::Relaxed) {
            0 => None,
            nanoseconds => Some(Duration::from_nanos(nanoseconds)),
        }
    }

    pub fn drive(&self, place: usize) -> Option<&DriveCounters> {
        self.drives.get()?.get(place)
    }

    pub fn timing(&self) -> Timing {
        Timing {
            lateness: self.lateness.read(),
            round_trip: self.round_trip.read(),
            phase_error: self.clock.errors.read(),
        }
    }

    pub fn read(&self) -> Statistics {
        Statistics {
            cycles: self.cycles.get(),
            lost: self.lost.get(),
            late: self.late.get(),
            latest: self.latest(),
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

// Histograms of times: written by the bus thread at the price of two stores, read from anywhere.

/// Below 2⁵ nanoseconds each bucket is one; above, each doubling has 2⁵ buckets, so that none is wider than 3.2 % of its times.
const GROUPING_POWER: u8 = 5;
/// The longest time: 2³⁴ nanoseconds are 17 seconds. Longer ones count as this long, and are in the largest.
const MAX_POWER: u8 = 34;
/// Where the last bucket ends.
const LAST: u64 = (1 << MAX_POWER) - 1;

/// Times, as many as were recorded of each length (to 3.2 %), with the shortest and the longest exactly.
///
/// ```
/// use servocrab::bus::Durations;
/// let nothing_yet = Durations::default();
/// assert_eq!((nothing_yet.count(), nothing_yet.quantile(0.99)), (0, None));
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Durations {
    buckets: Histogram,
    least: u64,
    most: u64,
}

impl Default for Durations {
    fn default() -> Self {
        Recorder::default().read()
    }
}

/// How many, the extremes and the quantiles 0.5, 0.99 and 0.999, and each bucket that is not empty. Times are in nanoseconds.
#[cfg(feature = "serde")]
impl serde::Serialize for Durations {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeStruct;
        let nanoseconds = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        let buckets: Vec<(u64, u64, u64)> = self
            .buckets()
            .map(|(times, count)| {
                (
                    nanoseconds(*times.start()),
                    nanoseconds(*times.end()),
                    count,
                )
            })
            .collect();
        let quantile = |share| self.quantile(share).map(nanoseconds);
        let mut durations = serializer.serialize_struct("Durations", 7)?;
        durations.serialize_field("count", &self.count())?;
        durations.serialize_field("least_ns", &self.least().map(nanoseconds))?;
        durations.serialize_field("most_ns", &self.most().map(nanoseconds))?;
        durations.serialize_field("p50_ns", &quantile(0.5))?;
        durations.serialize_field("p99_ns", &quantile(0.99))?;
        durations.serialize_field("p999_ns", &quantile(0.999))?;
        durations.serialize_field("buckets", &buckets)?;
        durations.end()
    }
}

impl Durations {
    /// How many were recorded.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.buckets.as_slice().iter().sum()
    }

    /// The shortest; `None` before the first.
    #[must_use]
    pub fn least(&self) -> Option<Duration> {
        (self.most >= self.least).then(|| Duration::from_nanos(self.least))
    }

    /// The longest; `None` before the first.
    #[must_use]
    pub fn most(&self) -> Option<Duration> {
        (self.most >= self.least).then(|| Duration::from_nanos(self.most))
    }

    /// The time below or at which this share of them lies (0.5 is the median, 1 the longest), to 3.2 %; `None` before the
    /// first, and for what is no share.
    #[must_use]
    pub fn quantile(&self, share: f64) -> Option<Duration> {
        let bucket = self.buckets.quantile_bucket(share).ok()??;
        Some(Duration::from_nanos(self.end_of(bucket.end())))
    }

    /// The longest time of the bucket that ends here: those beyond all buckets are in the last one.
    fn end_of(&self, end: u64) -> u64 {
        if end >= LAST {
            self.most
        } else {
            end.min(self.most)
        }
    }

    /// The buckets that are not empty, the shortest times first: from and to, and how many.
    pub fn buckets(&self) -> impl Iterator<Item = (RangeInclusive<Duration>, u64)> + '_ {
        self.buckets
            .iter()
            .filter(|bucket| bucket.count() > 0)
            .map(|bucket| {
                let (from, to) = (bucket.start(), bucket.end());
                (
                    Duration::from_nanos(from)..=Duration::from_nanos(to),
                    bucket.count(),
                )
            })
    }

    /// What was recorded after `before`, which was read earlier of the same. Its shortest and longest are those of its buckets.
    #[must_use]
    pub fn since(&self, before: &Self) -> Self {
        let buckets = self.buckets.wrapping_sub(&before.buckets);
        // All are of one shape.
        let buckets = buckets.unwrap_or_else(|_| self.buckets.clone());
        let mut filled = buckets.iter().filter(|bucket| bucket.count() > 0);
        let first = filled.next();
        let least = first
            .as_ref()
            .map_or(u64::MAX, |bucket| bucket.start().max(self.least));
        let most = filled
            .last()
            .or(first)
            .map_or(0, |bucket| self.end_of(bucket.end()));
        Self {
            buckets,
            least,
            most,
        }
    }
}

/// Where the bus thread puts times.
#[derive(Debug)]
pub(in crate::bus) struct Recorder {
    buckets: AtomicHistogram,
    least: AtomicU64,
    most: AtomicU64,
}

impl Default for Recorder {
    fn default() -> Self {
        #[expect(
            clippy::expect_used,
            reason = "the powers are constants that the histogram takes, by the test below"
        )]
        let buckets = AtomicHistogram::new(GROUPING_POWER, MAX_POWER).expect("it takes the powers");
        Self {
            buckets,
            least: AtomicU64::new(u64::MAX),
            most: AtomicU64::new(0),
        }
    }
}

impl Recorder {
    /// Only one thread records.
    pub fn record(&self, time: Duration) {
        let nanoseconds = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        if nanoseconds < self.least.load(Ordering::Relaxed) {
            self.least.store(nanoseconds, Ordering::Relaxed);
        }
        if nanoseconds > self.most.load(Ordering::Relaxed) {
            self.most.store(nanoseconds, Ordering::Relaxed);
        }
        // It fails only beyond its longest time.
        let _ = self.buckets.increment(nanoseconds.min(LAST));
    }

    pub fn read(&self) -> Durations {
        Durations {
            buckets: self.buckets.load(),
            least: self.least.load(Ordering::Relaxed),
            most: self.most.load(Ordering::Relaxed),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use proptest::prelude::*;

    use super::{Durations, Recorder};

    #[test]
    fn nothing_recorded_is_no_time_at_all() {
        let nothing = Durations::default();
        assert_eq!((nothing.least(), nothing.most()), (None, None));
        assert_eq!(nothing.buckets().count(), 0);
    }

    #[test]
    fn times_beyond_the_longest_count_and_the_longest_is_exact() {
        let recorder = Recorder::default();
        recorder.record(Duration::from_nanos(7));
        recorder.record(Duration::from_secs(100));
        let read = recorder.read();
        assert_eq!(read.count(), 2);
        assert_eq!(read.least(), Some(Duration::from_nanos(7)));
        assert_eq!(read.most(), Some(Duration::from_secs(100)));
        assert_eq!(read.quantile(0.5), Some(Duration::from_nanos(7)));
        assert_eq!(read.quantile(1.0), Some(Duration::from_secs(100)));
        assert_eq!(read.quantile(1.5), None);
        let later = read.since(&Durations::default());
        assert_eq!(later.most(), Some(Duration::from_secs(100)));
    }

    proptest! {
        #[test]
        fn a_quantile_is_that_of_the_sorted_times_to_a_bucket(
            mut times in prop::collection::vec(0u64..3_000_000, 1..200),
            share in 0.0..=1.0f64,
        ) {
            let recorder = Recorder::default();
            for time in &times {
                recorder.record(Duration::from_nanos(*time));
            }
            times.sort_unstable();
            let place = ((share * times.len() as f64).ceil() as usize).max(1) - 1;
            let exact = times[place];
            let told = recorder.read().quantile(share).unwrap().as_nanos() as u64;
            prop_assert!(told >= exact && told - exact <= exact / 32 + 1, "{told} for {exact}");
        }

        #[test]
        fn what_came_after_is_what_is_told_of_it(
            before in prop::collection::vec(0u64..1_000_000, 0..50),
            after in prop::collection::vec(0u64..1_000_000, 0..50),
        ) {
            let (recorder, only) = (Recorder::default(), Recorder::default());
            for time in &before {
                recorder.record(Duration::from_nanos(*time));
            }
            let earlier = recorder.read();
            for time in &after {
                recorder.record(Duration::from_nanos(*time));
                only.record(Duration::from_nanos(*time));
            }
            let (told, only) = (recorder.read().since(&earlier), only.read());
            prop_assert_eq!(told.buckets().collect::<Vec<_>>(), only.buckets().collect::<Vec<_>>());
            prop_assert!(told.most() >= only.most() && told.least() <= only.least());
        }
    }
}
