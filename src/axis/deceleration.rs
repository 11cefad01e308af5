//! Whether an axis gets slower after a word that stops it. A drive may ignore it, and an axis that was to stop runs on.

use core::time::Duration;

use crate::{
    profile_position::Bounds,
    timer::{Elapsed, nanoseconds},
};

/// How long each speed is measured for at least. It is long against the jitter of a cycle, and short against the way to a person.
const SPAN: Duration = Duration::from_millis(100);

/// And until way and time have come to this, in counts times nanoseconds. Then a ramp of 40 s takes two counts from the way of the next span.
/// That is more than what is lost by counting in whole ones.
const MEASURED: u128 = 80 * 1_000_000_000;

/// From one span to the next an axis on a ramp loses more than this part of its speed, one in so many. That holds for a linear ramp of up
/// to 400 s. A smooth one (sin²) begins with next to nothing: it holds up to 14 s.
const LEAST_PART: u128 = 4_000;

/// The speed of a halted axis, by its positions, from when its drive has surely seen bit 8.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct DecelerationMonitor {
    span: Option<Span>,
    /// The way of the span before, and how long that was, in nanoseconds.
    before: Option<(u64, u64)>,
    ignores_stop: bool,
}

/// A measurement under way.
#[derive(Debug, Clone, Copy, Hash)]
struct Span {
    time: u64,
    position: i32,
    way: i64,
}

impl DecelerationMonitor {
    pub const fn new() -> Self {
        Self {
            span: None,
            before: None,
            ignores_stop: false,
        }
    }

    /// Whether in the last span the axis was under way, and as fast as in the one before.
    pub const fn ignores_stop(&self) -> bool {
        self.ignores_stop
    }

    /// Takes in one cycle of an axis that does not stand.
    pub fn update(&mut self, elapsed: Elapsed, position: i32, bounds: &Bounds) {
        let begin = Span {
            time: 0,
            position,
            way: 0,
        };
        let Some(span) = &mut self.span else {
            self.span = Some(begin);
            return;
        };
        span.way = span.way.saturating_add(bounds.way(span.position, position));
        span.position = position;
        span.time = span.time.saturating_add(elapsed.0);
        let (way, time) = (span.way.unsigned_abs(), span.time);
        if time < nanoseconds(SPAN) || u128::from(way) * u128::from(time) < MEASURED {
            return;
        }
        self.span = Some(begin);
        self.ignores_stop = self.before.is_some_and(|before| {
            way > u64::from(bounds.position) && !is_slower((way, time), before)
        });
        self.before = Some((way, time));
    }
}

/// Whether the first of two ways, each in its time, was gone more slowly than the second.
fn is_slower(this: (u64, u64), before: (u64, u64)) -> bool {
    let speed = |way: u64, other: u64| u128::from(way) * u128::from(other);
    let (this, before) = (speed(this.0, before.1), speed(before.0, this.1));
    this.saturating_mul(LEAST_PART) < before.saturating_mul(LEAST_PART - 1)
}

#[cfg(test)]
mod deceleration_tests {
    use core::time::Duration;

    use super::*;
    use crate::profile_position::PositionRange;

    /// Whether an axis whose position after so many milliseconds is this is found to run on, within five seconds.
    fn ignores_stop(turn: Option<PositionRange>, at: impl Fn(f64) -> f64) -> Option<u32> {
        ignores_stop_within(10, turn, at)
    }

    /// The same with another position window.
    fn ignores_stop_within(
        window: u32,
        turn: Option<PositionRange>,
        at: impl Fn(f64) -> f64,
    ) -> Option<u32> {
        let settle = Duration::from_millis(100);
        let bounds = Bounds::new(window, settle, Duration::from_millis(1), turn);
        let mut deceleration = DecelerationMonitor::new();
        (0..5_000).find(|&cycle| {
            let position = at(f64::from(cycle)).round() as i64;
            let position = turn.map_or(position as i32, |turn| turn.wrap(position));
            let elapsed = Elapsed(if cycle == 0 { 0 } else { 1_000_000 });
            deceleration.update(elapsed, position, &bounds);
            deceleration.ignores_stop()
        })
    }

    #[test]
    fn one_that_is_as_fast_as_before_or_faster_runs_on_after_two_spans() {
        let turn = PositionRange { min: 0, max: 3_599 };
        for turn in [None, Some(turn)] {
            for (speed, found) in [
                (-50.0, 200),
                (12.0, 200),
                (8.0, 200),
                (7.0, 214),
                (-1.0, 566),
                (0.2, 1_903),
            ] {
                assert_eq!(ignores_stop(turn, |ms| speed * ms), Some(found), "{speed}");
            }
            assert_eq!(ignores_stop(turn, |ms| 0.01 * ms * ms), Some(324), "faster");
        }
    }

    #[test]
    fn one_that_gets_slower_by_less_than_the_least_part_runs_on() {
        // In each span it goes one count less, of about 5000.
        let way = |ms: f64| 50.0 * ms - (ms / 100.0) * (ms / 100.0 - 1.0) / 2.0;
        assert_eq!(ignores_stop(None, way), Some(200));
    }

    #[test]
    fn one_that_goes_no_further_than_its_window_in_a_span_stands() {
        for (speed, found) in [(9.0, None), (9.01, Some(200))] {
            assert_eq!(ignores_stop_within(900, None, |ms| speed * ms), found);
        }
    }

    #[test]
    fn the_least_part_is_lost_by_one_that_gets_slower() {
        let second = 1_000_000_000;
        let before = (4_000, second);
        assert!(!is_slower((3_999, second), before));
        assert!(is_slower((3_998, second), before));
        assert!(is_slower((3_999, second + 1), before));
    }

    #[test]
    fn one_on_a_ramp_does_not_run_on_however_gentle_that_is() {
        for seconds in [0.1, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0] {
            // So many counts a millisecond at first, linear.
            for speed in [0.05, 0.2, 0.5, 1.0, 3.0, 20.0, 300.0] {
                let end = seconds * 1_000.0;
                let linear = |ms: f64| {
                    let ms = ms.min(end);
                    speed * (ms - ms * ms / (2.0 * end))
                };
                assert_eq!(ignores_stop(None, linear), None, "{speed}, {seconds} s");
            }
        }
        for seconds in [0.1, 1.0, 5.0, 8.0] {
            // The same as a sin² ramp, which begins with no deceleration at all.
            let end = seconds * 1_000.0;
            let smooth = |ms: f64| {
                let ms = ms.min(end);
                let turn = core::f64::consts::PI / end;
                10.0 * (ms + (turn * ms).sin() / turn)
            };
            assert_eq!(ignores_stop(None, smooth), None, "{seconds} s, sin²");
        }
    }

    #[test]
    fn one_that_stands_or_comes_to_rest_does_not_run_on() {
        assert_eq!(ignores_stop(None, |_| 5.0), None);
        let swinging = |ms: f64| 4.0 * (ms / 30.0).sin();
        assert_eq!(ignores_stop(None, swinging), None);
    }

    #[test]
    fn one_that_gets_slower_and_then_fast_again_runs_on() {
        // To a target, and on to the next one.
        let way = |ms: f64| 2_000.0 * (ms / 500.0).sin() + 4.0 * ms;
        assert!(ignores_stop(None, way).is_some_and(|found| found > 200));
    }
}
