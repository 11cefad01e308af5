//! Histograms of times: written by the bus thread at the price of two stores, read from anywhere.

use std::{
    ops::RangeInclusive,
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};

use histogram::{AtomicHistogram, Histogram};

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
pub(super) struct Recorder {
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
    pub(super) fn record(&self, time: Duration) {
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

    pub(super) fn read(&self) -> Durations {
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
