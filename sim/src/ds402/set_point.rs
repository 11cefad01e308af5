//! One set-point: what is sampled at the rising edge of bit 4, where it leads, and how it joins the one before.

use core::time::Duration;

use super::axis::Axis;
use super::behaviour::{LimitViolation, LimitsOff, RelativeBase};
use super::ledger::{Executed, Outcome};
use super::objects;
use super::trajectory::{Bounds, Shape};

/// More than this is a mistake of whoever set it, and would never end.
const LONGEST_START_DELAY: Duration = Duration::from_secs(10);

/// A set-point in the buffer.
#[derive(Debug, Clone, Copy)]
pub(super) struct SetPoint {
    /// Its line in the ledger.
    pub(super) line: usize,
    base: RelativeBase,
    value: i64,
    /// Where it leads; known from the latch or from the start on.
    pub(super) target: Option<i64>,
    pub(super) bounds: Bounds,
    /// Velocity at its target for the blend that follows, in counts/s; else its own end velocity (6082h).
    junction: Option<f64>,
    /// Passes the target before it without stopping.
    blend: bool,
    /// Its target was outside the limits.
    pub(super) limited: bool,
    pub(super) started: bool,
}

impl Axis {
    /// Samples everything that belongs to a set-point and opens its line in the ledger.
    pub(super) fn latch(
        &mut self,
        controlword: u16,
        replaces: bool,
        blend: bool,
    ) -> Option<SetPoint> {
        let bit = |n: u16| controlword & (1 << n) != 0;
        let relative = bit(6);
        let value = self.objects.value(objects::TARGET_POSITION);
        let option = self.positioning();
        // Positions as the master counts them.
        let end_of_queue = self
            .buffer
            .last_target()
            .unwrap_or(self.buffer.previous_target);
        let end_of_queue = self.turned(end_of_queue);
        let from = if replaces {
            self.turned(self.trajectory.counts())
        } else {
            end_of_queue
        };
        let asked = match (relative, option.base) {
            (false, _) => Some(self.unrolled(value, from, option.direction)),
            (true, RelativeBase::PreviousTarget) => Some(end_of_queue.saturating_add(value)),
            (true, _) => None,
        };
        let expected = asked.unwrap_or(from.saturating_add(value));
        if self.behaviour.limit_violation != LimitViolation::Clamp
            && self.limited(expected) != expected
        {
            return None;
        }
        let bounds = Bounds {
            velocity: self.profile_velocity(),
            end_velocity: self.objects.velocity(objects::END_VELOCITY),
            acceleration: self
                .objects
                .acceleration_within(objects::PROFILE_ACCELERATION, objects::MAX_ACCELERATION),
            deceleration: self.deceleration(),
            shape: self.shape(),
        };
        let allowed = asked.map(|asked| self.limited(asked));
        let limited = allowed.is_some() && allowed != asked;
        self.buffer.limited = limited;
        let target = allowed.map(|allowed| self.turned(allowed));
        self.ledger.push(Executed {
            latched_at: self.now,
            started_at: None,
            start_position: None,
            ended_at: None,
            end_position: None,
            shaft_position: None,
            shaft_velocity: None,
            relative,
            bit_5: bit(5),
            bit_9: bit(9),
            value: value as i32,
            target,
            velocity: self.objects.value(objects::PROFILE_VELOCITY) as u32,
            end_velocity: self.objects.value(objects::END_VELOCITY) as u32,
            acceleration: self.objects.value(objects::PROFILE_ACCELERATION) as u32,
            deceleration: self.objects.value(objects::PROFILE_DECELERATION) as u32,
            profile_type: self.objects.value(objects::PROFILE_TYPE) as i16,
            outcome: Outcome::Queued,
        });
        let line = self.ledger.len() - 1;
        Some(SetPoint {
            line,
            base: option.base,
            value,
            target,
            bounds,
            junction: None,
            blend,
            limited,
            started: false,
        })
    }

    /// A target, as the master counts, within the software position limits (607Dh, each less the home offset 607Ch). On
    /// a modulo axis they limit the position within its range.
    fn limited(&self, target: i64) -> i64 {
        let min = self.objects.value(objects::LIMIT_MIN);
        let max = self.objects.value(objects::LIMIT_MAX);
        let off = match self.behaviour.limits_off {
            LimitsOff::BothZero => min == 0 && max == 0,
            LimitsOff::MinNotBelowMax => min >= max,
        };
        if off || min > max || (self.behaviour.limits_need_reference && !self.referenced) {
            return target;
        }
        let offset = self.objects.value(objects::HOME_OFFSET);
        // Of a target on a rotary axis the place in its turn counts.
        let place = self.in_range(target);
        target.saturating_add(place.clamp(min - offset, max - offset) - place)
    }

    /// Begins the active set-point's trajectory, unless it runs already.
    pub(super) fn start_active(&mut self) {
        let Some(mut active) = self.buffer.active.filter(|active| !active.started) else {
            return;
        };
        if self.waits_to_set_off() {
            return;
        }
        let position = self.trajectory.counts();
        let target = active.target.unwrap_or_else(|| {
            let base = if active.base == RelativeBase::Actual {
                self.shaft.encoder
            } else {
                position
            };
            let asked = self.turned(base).saturating_add(active.value);
            let allowed = self.limited(asked);
            active.limited = allowed != asked;
            self.buffer.limited = active.limited;
            self.turned(allowed)
        });
        active.target = Some(target);
        active.started = true;
        self.buffer.active = Some(active);
        let now = self.now;
        if let Some(line) = self.ledger.get_mut(active.line) {
            line.started_at = Some(now);
            line.start_position = Some(position);
            line.target = Some(target);
            line.outcome = Outcome::Active;
        }
        self.run(active);
        self.plan_junction();
    }

    /// From standstill the axis sets off later than its set-point is taken (`Plant::start_delay`).
    fn waits_to_set_off(&mut self) -> bool {
        let delay = self.behaviour.plant.start_delay.min(LONGEST_START_DELAY);
        if !delay.is_zero() && self.trajectory.stands() {
            let now = self.now;
            let at = *self
                .buffer
                .sets_off_at
                .get_or_insert(now.saturating_add(delay));
            if now < at {
                return true;
            }
        }
        self.buffer.sets_off_at = None;
        false
    }

    pub(super) fn run(&mut self, set_point: SetPoint) {
        if let Some(target) = set_point.target {
            let own = set_point.bounds;
            let end_velocity = set_point.junction.unwrap_or(own.end_velocity);
            self.trajectory.run_to(
                target,
                Bounds {
                    end_velocity,
                    ..own
                },
            );
        }
    }

    /// The active set-point goes on with what 6081h is now.
    pub(super) fn follow_velocity(&mut self) {
        let now = self.profile_velocity();
        if let Some(active) = self.buffer.active.as_mut()
            && active.bounds.velocity != now
        {
            active.bounds.velocity = now;
            let active = *active;
            if active.started && !self.buffer.halted {
                self.run(active);
            }
        }
    }

    /// 6081h, within 607Fh, in counts/s.
    fn profile_velocity(&self) -> f64 {
        let asked = self.objects.velocity(objects::PROFILE_VELOCITY);
        asked.min(self.objects.highest_velocity())
    }

    /// Lets the active set-point keep its velocity to its target where the waiting one blends: as fast as its own
    /// profile velocity, but not faster than allows to stop at the second target. A reversal stops at the first.
    pub(super) fn plan_junction(&mut self) {
        let (Some(mut active), Some(&next)) = (self.buffer.active, self.buffer.waiting.front())
        else {
            return;
        };
        let Some(first) = active.target.filter(|_| active.started) else {
            return;
        };
        let second = next
            .target
            .unwrap_or(first.saturating_add(self.turned(next.value)));
        let direction = (first as f64 - self.trajectory.position()).signum();
        let way = second.saturating_sub(first) as f64 * direction;
        let junction = next.blend.then(|| {
            if way > 0.0 && next.bounds.can_move() {
                let rate = next.bounds.shape.mean(next.bounds.deceleration);
                let from_stop = 2.0 * rate * way;
                let fastest = (from_stop + next.bounds.end_velocity.powi(2)).sqrt();
                fastest.min(active.bounds.velocity)
            } else {
                0.0
            }
        });
        if junction == active.junction {
            return;
        }
        active.junction = junction;
        self.buffer.active = Some(active);
        if !self.buffer.halted {
            self.run(active);
        }
    }

    /// The ramps of 6086h: 1 is sin², any other is linear.
    pub(super) fn shape(&self) -> Shape {
        if self.objects.value(objects::PROFILE_TYPE) == 1 {
            Shape::SinSquared
        } else {
            Shape::Linear
        }
    }

    /// 6084h, or 6083h where that is 0, within 60C6h, in counts/s².
    pub(super) fn deceleration(&self) -> f64 {
        let own = if self.objects.value(objects::PROFILE_DECELERATION) == 0 {
            objects::PROFILE_ACCELERATION
        } else {
            objects::PROFILE_DECELERATION
        };
        self.objects
            .acceleration_within(own, objects::MAX_DECELERATION)
    }
}
