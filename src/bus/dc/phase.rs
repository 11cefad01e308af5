//! Keeps the cycles in step with the reference clock: the frames of the process data pass it when its time is a multiple of
//! the cycle.
//!
//! A proportional-integral controller moves the start of the next cycle by a sixteenth of the phase error, and by an
//! integral that takes up the difference of the two crystals (a gain of 1/1024, critically damped). Its bandwidth (−3 dB) is
//! 1/80 of the cycle's frequency: 12 Hz at 1 ms. How late this thread woke up is known, and left out of the error: the
//! schedule follows the clock, not the operating system.

use std::time::Duration;

/// Binary places of the integral: it is a gain of 1/1024.
const PLACES: u32 = 10;
/// The proportional gain of 1/16, in these places.
const PROPORTIONAL: i64 = 1 << (PLACES - 4);
/// Crystals that differ by more than this many parts per million are not followed. Two of 100 ppm differ by 200.
const MOST_PPM: i64 = 500;
/// Cycles in a row within the bound that make a lock; and so many without the reference's time end it.
const LOCK_CYCLES: u32 = 64;
/// What a cycle beyond the bound takes from a lock: some of them end it.
const BEYOND: u32 = 16;

/// The phase error that a lock keeps: a fiftieth of the cycle.
pub(in crate::bus) fn bound(period: Duration) -> Duration {
    period / 50
}

/// The controller alone: errors in, corrections out, both in nanoseconds.
#[derive(Debug, Clone, Copy, Default)]
struct Controller {
    /// In parts of 1/1024 ns.
    integral: i64,
    /// What has been left over by whole nanoseconds, in the same parts.
    rest: i64,
}

impl Controller {
    /// By how much the next cycle is to start sooner, from how much later than wanted this one was.
    fn step(&mut self, error: i64, most: i64) -> i64 {
        self.integral = (self.integral + error).clamp(-most, most);
        let wanted = error * PROPORTIONAL + self.integral + self.rest;
        let correction = wanted >> PLACES;
        self.rest = wanted - (correction << PLACES);
        correction
    }
}

/// The phase of the cycles against the reference clock.
#[derive(Debug, Clone)]
pub(in crate::bus) struct Phase {
    period: i64,
    /// The system time at which the frames of the next cycle are to pass the reference clock; a multiple of the period.
    next: u64,
    /// The same of this cycle, and how much later it began than was planned.
    now: (u64, i64),
    controller: Controller,
    bound: i64,
    /// Whether the first error has been taken away.
    has_begun: bool,
    /// Up to twice as many cycles as make a lock.
    within: u32,
}

/// What one cycle has shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Measured {
    /// By how much later than wanted the frames passed the reference clock, in nanoseconds.
    pub(in crate::bus) error: i64,
    /// Whether the phase is locked.
    pub(in crate::bus) locked: bool,
    /// Whether the error is within the bound.
    pub(in crate::bus) within: bool,
}

impl Phase {
    /// Cycles of this period, the first of which is to pass the reference clock at the system time `first`, rounded up to a
    /// multiple of the period: the phase, and by how much later than `first` that is.
    pub(in crate::bus) fn starting_at(first: u64, period: Duration) -> (Self, Duration) {
        let length = nanoseconds(period).max(1);
        let ahead = to_multiple(first, length.cast_unsigned());
        let next = first.wrapping_add(ahead);
        let phase = Self {
            period: length,
            next,
            now: (next, 0),
            controller: Controller::default(),
            bound: nanoseconds(bound(period)),
            has_begun: false,
            within: 0,
        };
        (phase, Duration::from_nanos(ahead))
    }

    /// A cycle begins, so much later than planned, and with the next one the plan goes on after `periods` periods. The
    /// system time at which its frames pass the reference clock, as far as is known.
    pub(in crate::bus) fn begin(&mut self, late: Duration, periods: u32) -> u64 {
        let late = nanoseconds(late);
        self.now = (self.next, late);
        let periods = self.period.saturating_mul(periods.into());
        self.next = self.next.wrapping_add_signed(periods);
        self.now.0.wrapping_add_signed(late)
    }

    /// Whether the cycles are in step.
    pub(in crate::bus) const fn is_locked(&self) -> bool {
        self.within >= LOCK_CYCLES
    }

    /// The frames of the cycle are back, with the low half of the reference clock's time. By how much sooner than planned the
    /// next cycle is to start, in nanoseconds, and what was seen. Without a time the crystals are held as they were.
    pub(in crate::bus) fn end(&mut self, time: Option<u32>) -> (i64, Option<Measured>) {
        let most = (self.period * MOST_PPM / 1_000_000) << PLACES;
        let Some(time) = time else {
            self.within = self.within.saturating_sub(1);
            return (self.controller.step(0, most), None);
        };
        let (wanted, late) = self.now;
        // Of the plan, without what was late in this cycle alone: that may be longer than 32 bits of nanoseconds.
        let passes = wanted.wrapping_add_signed(late);
        let of_plan = i64::from(time.wrapping_sub(passes as u32).cast_signed());
        let error = of_plan.saturating_add(late);
        let is_within = of_plan.abs() <= self.bound;
        self.within = match is_within {
            true => (self.within + 1).min(2 * LOCK_CYCLES),
            false if self.is_locked() => self.within.saturating_sub(BEYOND),
            false => 0,
        };
        let measured = Measured {
            error,
            locked: self.is_locked(),
            within: error.abs() <= self.bound,
        };
        if !self.has_begun {
            // The first plan was made from a time that was read by another frame.
            self.has_begun = true;
            return (of_plan, Some(measured));
        }
        // A single wild value must not throw the phase about.
        let limit = self.period / 16;
        let correction = self.controller.step(of_plan.clamp(-limit, limit), most);
        (correction, Some(measured))
    }
}

/// From a time to the next multiple of `length`, which is not 0.
pub(super) const fn to_multiple(time: u64, length: u64) -> u64 {
    (length - time % length) % length
}

/// The time whose low half this is, nearest to an estimate.
pub(in crate::bus) fn extend(estimate: u64, low: u32) -> u64 {
    let difference = low.wrapping_sub(estimate as u32).cast_signed();
    estimate.wrapping_add_signed(difference.into())
}

fn nanoseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(1);

    /// Cycles against a reference clock that is so much too fast: the error of each, in nanoseconds.
    struct Run {
        phase: Phase,
        /// The master's time of the next start.
        start: f64,
        /// What the reference clock shows beside the master's time.
        reference: Box<dyn Fn(f64) -> f64>,
    }

    impl Run {
        fn new(reference: impl Fn(f64) -> f64 + 'static) -> Self {
            let first = reference(0.0) as u64;
            let (phase, ahead) = Phase::starting_at(first, PERIOD);
            Self {
                phase,
                start: ahead.as_nanos() as f64,
                reference: Box::new(reference),
            }
        }

        /// A cycle that wakes so late.
        fn cycle(&mut self, late_ns: f64) -> Measured {
            self.phase.begin(Duration::from_nanos(late_ns as u64), 1);
            let time = (self.reference)(self.start + late_ns) as u64;
            let (sooner, measured) = self.phase.end(Some(time as u32));
            self.start += 1e6 - sooner as f64;
            measured.unwrap()
        }

        fn cycles(&mut self, count: usize) {
            for _ in 0..count {
                self.cycle(0.0);
            }
        }
    }

    fn drifting(ppm: f64) -> impl Fn(f64) -> f64 {
        move |time| 7.3e9 + time * (1.0 + ppm * 1e-6)
    }

    #[test]
    fn it_locks_to_a_clock_that_is_100_ppm_off_and_stays_within_a_tenth_of_the_bound() {
        for ppm in [100.0, -100.0, 200.0, -200.0] {
            let mut run = Run::new(drifting(ppm));
            let locked = (0..200).position(|_| run.cycle(0.0).locked);
            assert!(locked.is_some(), "{ppm}");
            for _ in 0..10_000 {
                let seen = run.cycle(0.0);
                assert!(seen.locked && seen.error.abs() < 2_000, "{ppm}: {seen:?}");
            }
            let last = run.cycle(0.0).error;
            assert!(last.abs() <= 2, "{ppm}: {last}");
        }
    }

    #[test]
    fn the_first_error_is_taken_away_at_once() {
        let mut run = Run::new(drifting(0.0));
        run.start += 300_000.0;
        assert_eq!(run.cycle(0.0).error, 300_000);
        assert!(run.cycle(0.0).error.abs() < 300);
    }

    #[test]
    fn a_late_wake_up_moves_nothing() {
        let mut run = Run::new(drifting(50.0));
        run.cycles(1_000);
        assert_eq!(run.cycle(60_000.0).error / 1_000, 60);
        assert!(run.cycle(0.0).error.abs() < 10);
    }

    #[test]
    fn cycles_that_were_slept_through_keep_the_phase() {
        let mut run = Run::new(drifting(0.0));
        run.cycles(100);
        // The next start is three periods later.
        run.phase.begin(Duration::from_micros(2_100), 3);
        let time = (run.reference)(run.start + 2.1e6) as u64;
        run.phase.end(Some(time as u32));
        run.start += 3e6;
        assert!(run.cycle(0.0).error.abs() < 5);
    }

    #[test]
    fn a_sleep_of_more_than_32_bits_of_nanoseconds_keeps_the_phase() {
        let mut run = Run::new(drifting(0.0));
        run.cycles(200);
        run.phase.begin(Duration::from_millis(5_000), 5_001);
        let time = (run.reference)(run.start + 5e9) as u64;
        let (sooner, measured) = run.phase.end(Some(time as u32));
        assert_eq!((sooner, measured.unwrap().locked), (0, true));
    }

    #[test]
    fn a_clock_at_the_end_of_its_64_bits_is_no_reason_to_panic() {
        let (_, ahead) = Phase::starting_at(u64::MAX - 5, PERIOD);
        assert!(ahead < PERIOD, "{ahead:?}");
    }

    #[test]
    fn without_the_reference_the_crystals_are_held() {
        let mut run = Run::new(drifting(100.0));
        run.cycles(2_000);
        for _ in 0..1_000 {
            run.phase.begin(Duration::ZERO, 1);
            let (sooner, measured) = run.phase.end(None);
            assert_eq!(measured, None);
            run.start += 1e6 - sooner as f64;
        }
        let seen = run.cycle(0.0);
        assert!(seen.error.abs() < 200 && !seen.locked, "{seen:?}");
    }

    #[test]
    fn a_frame_that_is_lost_ends_no_lock_and_errors_that_stay_do() {
        let mut run = Run::new(drifting(0.0));
        run.cycles(1_000);
        run.phase.begin(Duration::ZERO, 1);
        run.phase.end(None);
        run.start += 1e6;
        assert!(run.cycle(0.0).locked);
        // The reference clock has been set to another time.
        run.start += 400_000.0;
        let mut lost = 0;
        while run.cycle(0.0).locked {
            lost += 1;
        }
        assert!((2..8).contains(&lost), "{lost}");
    }

    #[test]
    fn the_stated_bandwidth_is_where_the_cycles_follow_by_half_of_the_power() {
        // The reference clock swings by 10 us at 1/80 of the cycle's frequency: what of it do the cycles follow?
        let swing = |time: f64| 10_000.0 * (time / 1e6 / 80.0 * core::f64::consts::TAU).sin();
        let mut run = Run::new(move |time| 1e12 + time + swing(time));
        let mut largest = 0.0_f64;
        for cycle in 0..4_000 {
            let planned = run.start;
            run.cycle(0.0);
            if cycle > 2_000 {
                let ideal = (planned / 1e6).round() * 1e6;
                largest = largest.max((planned - ideal).abs());
            }
        }
        let followed = largest / 10_000.0;
        assert!((0.6..0.85).contains(&followed), "{followed}");
    }

    #[test]
    fn the_low_half_is_extended_to_the_nearest_time() {
        assert_eq!(extend(0x1_0000_0005, 0xFFFF_FFFE), 0xFFFF_FFFE);
        assert_eq!(extend(0xFFFF_FFF0, 5), 0x1_0000_0005);
        assert_eq!(extend(77, 80), 80);
    }
}
