//! Whether an axis stands: its position has stayed within the window for the settle time, in time and in samples.

use core::time::Duration;

use crate::timer::{Due, Elapsed, Timer};

use super::{Bounds, Unrest};

/// Follows the position from sample to sample.
#[derive(Debug, Clone, Copy, Hash, Default)]
pub(crate) struct Standstill {
    /// Where the axis was when its time began. None: it begins with the next sample.
    from: Option<i32>,
    left: Timer,
}

impl Standstill {
    /// Takes in a sample; where the axis stands, if it does. `blind`: samples before it are missing.
    #[inline]
    pub fn update(
        &mut self,
        position: i32,
        elapsed: Elapsed,
        blind: bool,
        bounds: &Bounds,
    ) -> Option<i32> {
        match self.from {
            Some(from) if bounds.is_within_window(from, position) => {
                if !self.left.is_over() {
                    self.count(position, elapsed, blind, bounds);
                }
            }
            _ => self.begin(position, bounds),
        }
        self.place()
    }

    fn count(&mut self, position: i32, elapsed: Elapsed, blind: bool, bounds: &Bounds) {
        // An axis that swings may have left and come back meanwhile.
        if blind {
            self.begin(position, bounds);
            return;
        }
        self.left.pass(elapsed.of_samples(bounds.settle));
    }

    fn begin(&mut self, position: i32, bounds: &Bounds) {
        self.from = Some(position);
        self.left = Timer::new(bounds.settle);
    }

    /// Where the axis stands, if it does.
    pub const fn place(&self) -> Option<i32> {
        if self.is_standing() { self.from } else { None }
    }

    /// Whether the axis stood in the last cycle with inputs. Without any it is not known to stand.
    #[inline]
    pub const fn is_standing(&self) -> bool {
        self.from.is_some() && self.left.is_over()
    }

    /// The time begins anew with the next sample: where the axis sets off, and where its drive stops it, the time for which it had stayed
    /// before says nothing.
    pub const fn begin_anew(&mut self) {
        self.from = None;
    }

    pub const fn due(&self) -> Due {
        Due::next_if(!self.is_standing())
    }
}

/// What was seen of an axis lately, for whoever waits for its standstill in vain.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LastSeen(Option<Extremes>);

/// Least and greatest position of the settle time that is not over, and of the one before.
#[derive(Debug, Clone, Copy)]
struct Extremes {
    since: Duration,
    now: (i32, i32),
    before: (i32, i32),
}

impl LastSeen {
    pub fn update(&mut self, now: Duration, position: i32, bounds: &Bounds) {
        match &mut self.0 {
            Some(seen) if now.saturating_sub(seen.since) < bounds.settle => {
                seen.now = with(seen.now, (position, position));
            }
            last => {
                let only = (position, position);
                *last = Some(Extremes {
                    since: now,
                    now: only,
                    before: last.map_or(only, |seen| seen.now),
                });
            }
        }
    }

    pub fn unrest(&self, bounds: &Bounds) -> Unrest {
        Unrest {
            positions: self.0.map_or((0, 0), |seen| with(seen.now, seen.before)),
            window: bounds.position,
            settle_ms: u32::try_from(bounds.settle.as_millis()).unwrap_or(u32::MAX),
        }
    }
}

fn with(a: (i32, i32), b: (i32, i32)) -> (i32, i32) {
    (a.0.min(b.0), a.1.max(b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn bounds() -> Bounds {
        let settle = Duration::from_millis(100);
        Bounds::new(10, settle, Duration::from_millis(1), None)
    }

    /// Shows these positions, one a millisecond; the rest of the last.
    fn after(standstill: &mut Standstill, positions: impl IntoIterator<Item = i32>) -> Option<i32> {
        let mut rest = None;
        for position in positions {
            rest = standstill.update(position, Elapsed(MS), false, &bounds());
        }
        rest
    }

    #[test]
    fn an_axis_stands_when_it_has_stayed_within_the_window_for_the_settle_time() {
        let mut standstill = Standstill::default();
        assert_eq!(after(&mut standstill, [0; 100]), None);
        assert_eq!(after(&mut standstill, [10]), Some(0));
        assert_eq!(after(&mut standstill, [-10]), Some(0));
        assert_eq!(after(&mut standstill, [11]), None);
        assert_eq!(after(&mut standstill, [11]), None);
    }

    #[test]
    fn an_axis_that_goes_on_slowly_stands_by_the_window_alone() {
        let stands = |slowness: i32| {
            let mut standstill = Standstill::default();
            (0..1_000).any(|ms| after(&mut standstill, [ms / slowness]).is_some())
        };
        assert!(!stands(9));
        assert!(stands(11));
    }

    #[test]
    fn a_stall_of_the_host_is_no_proof_of_rest() {
        let mut standstill = Standstill::default();
        let mut show = |millis| {
            standstill.update(0, Elapsed(millis * MS), false, &bounds());
            standstill.is_standing()
        };
        assert!(!show(1) && !show(10_000) && !show(10_000) && !show(10_000));
        assert!(show(10_000), "five samples are needed");
    }

    #[test]
    fn samples_that_are_missing_for_long_take_the_time_before() {
        let stands = |blind| {
            let mut standstill = Standstill::default();
            after(&mut standstill, [0; 99]);
            standstill.update(0, Elapsed(37 * MS), blind, &bounds());
            standstill.is_standing()
        };
        assert!(stands(false) && !stands(true));
    }

    #[test]
    fn rest_counts_from_where_the_axis_sets_off() {
        let mut standstill = Standstill::default();
        after(&mut standstill, [0; 200]);
        standstill.begin_anew();
        assert!(!standstill.is_standing());
        assert_eq!(after(&mut standstill, [0; 100]), None);
        assert_eq!(after(&mut standstill, [0]), Some(0));
    }

    #[test]
    fn who_waits_in_vain_is_told_what_was_seen_in_the_last_two_settle_times() {
        let mut seen = LastSeen::default();
        for ms in 0..350 {
            let position = if ms < 50 { 500 } else { ms };
            seen.update(Duration::from_millis(ms as u64), position, &bounds());
        }
        assert_eq!(seen.unrest(&bounds()).positions, (200, 349));
        assert_eq!(seen.unrest(&bounds()).window, 10);
    }
}
