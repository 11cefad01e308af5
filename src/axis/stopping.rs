//! A stop under way: how far it is and who waits for it.

use core::time::Duration;

use crate::profile_position::{Bounds, CommandId, Failure, ShownFor, Unanswered};

/// Commands that can wait for one standstill.
const WAITERS: usize = 8;

/// How far a stop is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub(super) enum StopPhase {
    /// No stop is under way; the axis may be halted.
    #[default]
    None,
    /// Halting, with the quick stop to follow at standstill, or before then: the axis is to stand by then. Of one that is known to move for
    /// nothing, where it was: if it comes to rest and has not left that place, there is nothing to abandon.
    Halting { until: Duration, from: Option<i32> },
    /// Quick stop, to be at standstill by then; without a time it is commanded on without anybody waiting.
    Quick { until: Option<Duration> },
    /// The drive stops the axis by itself, or has left it without power: it is to stand by then.
    Settling { until: Duration },
    /// Voltage being disabled: after the quick stop, or in place of one that the drive ignores.
    Off { until: Duration },
}

/// What a waiter waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Wait {
    /// Standstill with bit 8, until then.
    Halt { until: Duration },
    /// The end of the stop.
    Stop,
    /// The standstill of an axis whose stop was overtaken by a fault.
    Faulted(Failure),
}

/// The stop under way.
#[derive(Debug, Clone, Hash, Default)]
pub(super) struct Stopping {
    pub phase: StopPhase,
    /// Whether the axis is to be disabled at the end; and while its voltage is, whether it stood before.
    pub off: bool,
    /// Whether those whose set-points are kept have been informed that the axis stands.
    pub halt_reported: bool,
    /// Whether bit 8 was asked for by something that nobody waits for: liveness, a stop handle.
    pub unwatched: bool,
    /// Whether bit 8 is the stop's own: it falls again where there is nothing to abandon.
    pub lent: bool,
    /// What an axis that was under way for a set-point showed, until bit 8 is answered.
    pub unanswered: Unanswered,
    /// What bit 8 does.
    pub deceleration: DecelerationMonitor,
    /// Since when a drive that stays in Operation enabled is known to have been sent bit 2 low, and what that does.
    pub quick_delivered: Option<Duration>,
    pub quick_deceleration: DecelerationMonitor,
    /// Since when bit 2 low is known to have been delivered in this quick stop, and whether each sample has shown a state in which it may end.
    pub sent_since: Option<Duration>,
    pub shown: ShownFor,
    waiters: [Option<(CommandId, Wait)>; WAITERS],
    /// How many of these places are taken: there is seldom anybody to look for.
    waiting: usize,
}

impl Stopping {
    pub const fn is_quick(&self) -> bool {
        matches!(self.phase, StopPhase::Quick { .. })
    }

    pub const fn is_switching_off(&self) -> bool {
        matches!(self.phase, StopPhase::Off { .. })
    }

    /// Bit 8 begins, or is over.
    pub fn begin_halt(&mut self) {
        self.unwatched = false;
        self.lent = false;
        self.unanswered = Unanswered::default();
        self.deceleration = DecelerationMonitor::default();
    }

    /// Bit 2 falls, and the axis is to stand by then, or by the deadline of the halt that this goes on from.
    pub fn begin_quick(&mut self, until: Duration) {
        let until = match self.phase {
            StopPhase::Halting { until, .. } => until,
            _ => until,
        };
        self.phase = StopPhase::Quick { until: Some(until) };
        self.sent_since = None;
        self.shown = ShownFor::NOT;
        self.measure_quick();
    }

    /// What bit 2 does is measured from its next delivery on.
    pub fn measure_quick(&mut self) {
        self.quick_delivered = None;
        self.quick_deceleration = DecelerationMonitor::default();
    }

    pub const fn is_active(&self) -> bool {
        !matches!(self.phase, StopPhase::None)
    }

    /// Somebody new waits for a quick stop whose deadline has passed: it gets a deadline again.
    pub const fn set_deadline(&mut self, until: Duration) {
        if matches!(self.phase, StopPhase::Quick { until: None }) {
            self.phase = StopPhase::Quick { until: Some(until) };
        }
    }

    /// Adds a waiter; false when there is no room. One that waits already waits on.
    pub fn wait(&mut self, id: CommandId, wait: Wait) -> bool {
        if self
            .waiters
            .iter()
            .flatten()
            .any(|(waiter, _)| *waiter == id)
        {
            return true;
        }
        match self.waiters.iter_mut().find(|place| place.is_none()) {
            Some(place) => {
                *place = Some((id, wait));
                self.waiting += 1;
                true
            }
            None => false,
        }
    }

    /// Whoever waits for a stop has heard of a fault, and waits for the standstill alone. Whether there is anybody.
    pub fn note_fault(&mut self, failure: Failure) -> bool {
        let mut waits = false;
        for (_, wait) in self.waiters.iter_mut().flatten() {
            if *wait == Wait::Stop {
                *wait = Wait::Faulted(failure);
            }
            waits |= matches!(wait, Wait::Faulted(_));
        }
        waits
    }

    /// Whoever waits for a halt waits for the standstill alone. Whether there is anybody.
    pub fn halts_become_stops(&mut self) -> bool {
        if self.has_no_waiter() {
            return false;
        }
        let mut waits = false;
        for (_, wait) in self.waiters.iter_mut().flatten() {
            if matches!(wait, Wait::Halt { .. }) {
                *wait = Wait::Stop;
                waits = true;
            }
        }
        waits
    }

    /// Takes one waiter, and the answer that it was to get instead of the end of its stop.
    pub fn next_waiter(&mut self) -> Option<(CommandId, Option<Failure>)> {
        let (id, wait) = self.take(|_| true)?;
        let failure = match wait {
            Wait::Faulted(failure) => Some(failure),
            Wait::Stop | Wait::Halt { .. } => None,
        };
        Some((id, failure))
    }

    pub const fn has_no_waiter(&self) -> bool {
        self.waiting == 0
    }

    /// Takes one waiter for which `which` holds.
    pub fn take_waiter(&mut self, which: impl Fn(Wait) -> bool) -> Option<CommandId> {
        self.take(which).map(|(id, _)| id)
    }

    fn take(&mut self, which: impl Fn(Wait) -> bool) -> Option<(CommandId, Wait)> {
        if self.has_no_waiter() {
            return None;
        }
        let mut places = self.waiters.iter_mut();
        let place = places.find(|place| place.is_some_and(|(_, wait)| which(wait)))?;
        self.waiting -= 1;
        place.take()
    }
}

// Whether an axis gets slower after bit 8. A drive may ignore it, and an axis that was to stop runs on.

/// How long each speed is measured for at least: long against the jitter of a cycle, short against the way to a person.
const SPAN: Duration = Duration::from_millis(100);

/// And until way and time have come to this, in counts times nanoseconds: then what a ramp of 40 s takes from the way of the next span is two
/// counts, more than what is lost by counting in whole ones.
const MEASURED: u128 = 80 * 1_000_000_000;

/// From one span to the next an axis on a ramp loses more than this part of its speed, one in so many: on a linear ramp of up to
/// 400 s, and on a smooth one (sin²), which begins with next to nothing, of up to 14 s.
const LEAST_PART: u128 = 4_000;

/// The speed of a halted axis, by its positions, from when its drive has surely seen bit 8.
#[derive(Debug, Clone, Copy, Hash, Default)]
pub(super) struct DecelerationMonitor {
    span: Option<Span>,
    /// The way of the span before, and how long that was.
    before: Option<(u64, Duration)>,
    ignores_stop: bool,
}

/// A measurement under way.
#[derive(Debug, Clone, Copy, Hash)]
struct Span {
    since: Duration,
    position: i32,
    way: i64,
}

impl DecelerationMonitor {
    /// Whether in the last span the axis was under way, and as fast as in the one before.
    pub const fn ignores_stop(&self) -> bool {
        self.ignores_stop
    }

    /// Takes in one cycle.
    pub fn update(&mut self, now: Duration, position: i32, bounds: &Bounds) {
        let begin = Span {
            since: now,
            position,
            way: 0,
        };
        let span = self.span.get_or_insert(begin);
        span.way = span.way.saturating_add(bounds.way(span.position, position));
        span.position = position;
        let time = now.saturating_sub(span.since);
        let way = span.way.unsigned_abs();
        if time < SPAN || u128::from(way) * time.as_nanos() < MEASURED {
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
fn is_slower(this: (u64, Duration), before: (u64, Duration)) -> bool {
    let speed = |way: u64, other: Duration| u128::from(way).saturating_mul(other.as_nanos());
    let (this, before) = (speed(this.0, before.1), speed(before.0, this.1));
    this.saturating_mul(LEAST_PART) < before.saturating_mul(LEAST_PART - 1)
}

#[cfg(test)]
mod deceleration_tests {
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
        let bounds = Bounds::new(window, None, settle, Duration::from_millis(1), turn);
        let mut deceleration = DecelerationMonitor::default();
        (0..5_000).find(|&cycle| {
            let position = at(f64::from(cycle)).round() as i64;
            let position = turn.map_or(position as i32, |turn| turn.wrap(position));
            deceleration.update(Duration::from_millis(cycle.into()), position, &bounds);
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
        let second = Duration::from_secs(1);
        let before = (4_000, second);
        assert!(!is_slower((3_999, second), before));
        assert!(is_slower((3_998, second), before));
        assert!(is_slower((3_999, second + Duration::from_nanos(1)), before));
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
