//! What the axis reports: actual position, following error, target reached, the statusword.

use core::time::Duration;

use super::axis::Axis;
use super::behaviour::{FollowingError, LimitSwitches, ReachedPolicy};
use super::emergency;
use super::homing::HOMING;
use super::machine::{Machine, NEGATIVE_LIMIT, POSITIVE_LIMIT};
use super::motion::PROFILE_POSITION;
use super::objects;
use super::state::State;
use super::velocity::PROFILE_VELOCITY;

/// A window object with this value switches its check off (DSP 402).
const WINDOW_OFF: i64 = 0xFFFF_FFFF;

/// The memory behind bits 10 and 13.
#[derive(Debug, Clone, Default)]
pub(super) struct Reached {
    shown: bool,
    in_window_since: Option<Duration>,
    /// Cycles for which an old bit 10 is still shown.
    stale: u32,
    outside_since: Option<Duration>,
    following_error: bool,
}

impl Reached {
    /// A set-point was taken.
    pub(super) fn set_point_taken(&mut self, stale_cycles: u32) {
        if self.shown {
            self.stale = stale_cycles;
        }
        self.in_window_since = None;
    }

    pub(super) fn forget_following_error(&mut self) {
        self.following_error = false;
        self.outside_since = None;
    }
}

impl Axis {
    /// The shaft follows the demand, by so many cycles later.
    pub(super) fn follow_demand(&mut self) {
        let held = self.disturbances.blocked || self.is_braked();
        if !self.state.controls()
            && !held
            && let Some(face) = self.pushed_back_to()
        {
            self.put_down(face);
        }
        let demand = (self.trajectory.position(), self.trajectory.velocity());
        self.lagging.push_back(demand);
        while self.lagging.len() > self.behaviour.actual_lag_cycles as usize + 1 {
            self.lagging.pop_front();
        }
        let demand = self.lagging.front().copied().unwrap_or(demand);
        let contact = self.contact();
        let machine = &self.behaviour.machine;
        let offset = self.machine_offset;
        self.shaft.follow(
            self.behaviour.period,
            demand,
            self.state.controls(),
            held,
            contact,
            |position| reach(machine, offset, position),
        );
        let moved = self.shaft.counts.saturating_sub(self.anchor);
        if moved.saturating_abs() > self.behaviour.plant.rest_band() {
            self.anchor = self.shaft.counts;
            self.moved_at = Some(self.now);
        }
        self.stands_since = self.stands().then(|| self.stands_since.unwrap_or(self.now));
    }

    /// Where the shaft gets to for a demand, in reported counts.
    pub(super) fn within_ends(&self, position: i64) -> i64 {
        reach(&self.behaviour.machine, self.machine_offset, position)
    }

    /// By how much the demand is ahead of what the encoder shows, as of the servo's last cycle.
    fn following_error(&self) -> i64 {
        let (demand, delayed) = (self.trajectory.position(), self.lagging.front());
        let ahead = delayed.map_or(0.0, |(position, _)| demand - position);
        ((self.shaft.demand + ahead).round() as i64).saturating_sub(self.shaft.encoder)
    }

    pub(super) fn check_following_error(&mut self) {
        let window = self.objects.value(objects::FOLLOWING_WINDOW);
        let controlled = self.state.controls() && self.state != State::FaultReactionActive;
        let error = self.following_error().saturating_abs();
        if !controlled || window == WINDOW_OFF || error <= window {
            self.reached.outside_since = None;
            if self.behaviour.following_error == FollowingError::BitOnly {
                self.reached.following_error = false;
            }
            return;
        }
        let since = *self.reached.outside_since.get_or_insert(self.now);
        let timeout = milliseconds(self.objects.value(objects::FOLLOWING_TIMEOUT));
        if self.now.saturating_sub(since) >= timeout && !self.reached.following_error {
            self.reached.following_error = true;
            if self.behaviour.following_error == FollowingError::Fault {
                self.raise_fault(emergency::FOLLOWING_ERROR);
            }
        }
    }

    /// Updates the objects that the master reads.
    pub(super) fn publish(&mut self, controlword: u16) {
        let (reached, stale) = self.update_reached(controlword);
        let statusword = self.compose_statusword(reached, stale);
        let statusword = if self.shaft.composes_word(self.behaviour.period) {
            i64::from(statusword)
        } else {
            self.objects.value(objects::STATUSWORD)
        };
        let (demand, actual) = (
            self.turned(self.trajectory.counts()),
            self.turned(self.shaft.encoder),
        );
        let velocity = |velocity: f64| {
            let turned = self.turned_velocity(velocity);
            saturated(self.objects.shown_velocity(turned))
        };
        let values = [
            (objects::STATUSWORD, statusword),
            (objects::DIGITAL_INPUTS, i64::from(self.switches())),
            (objects::POSITION_DEMAND, wrapped(self.in_range(demand))),
            (objects::POSITION_ACTUAL, wrapped(self.in_range(actual))),
            (
                objects::POSITION_INTERNAL,
                wrapped(self.internal_position()),
            ),
            (
                objects::VELOCITY_DEMAND,
                velocity(self.trajectory.velocity()),
            ),
            (
                objects::VELOCITY_ACTUAL,
                velocity(self.shaft.shown_velocity()),
            ),
            (objects::TORQUE_ACTUAL, self.shaft.torque),
            (
                objects::FOLLOWING_ERROR_ACTUAL,
                saturated(self.turned(self.following_error())),
            ),
        ];
        for (address, value) in values {
            self.objects.put(address, value);
        }
    }

    /// Bit 10, and whether it is an old one. With halt, and in Quick stop active: the axis stands. Else by the mode; in
    /// profile position mode: all set-points are done, by the drive's policy.
    fn update_reached(&mut self, controlword: u16) -> (bool, bool) {
        let stands = self.stands();
        let reached = match self.state {
            State::QuickStopActive => stands,
            State::OperationEnabled if self.buffer.halted && controlword & 0x0100 != 0 => stands,
            State::OperationEnabled => match self.objects.value(objects::MODE_DISPLAY) {
                PROFILE_VELOCITY => self.velocity_reached(),
                HOMING => stands && !self.is_homing() && !self.shows_progress_before_homing(),
                _ => self.target_reached(),
            },
            _ => false,
        };
        let stale = self.reached.stale > 0;
        self.reached.stale = self.reached.stale.saturating_sub(1);
        self.reached.shown = reached;
        (reached || stale, stale)
    }

    fn target_reached(&mut self) -> bool {
        let policy = self.behaviour.reached;
        let open = !self.buffer.is_empty();
        if open && policy != ReachedPolicy::Window {
            self.reached.in_window_since = None;
            return false;
        }
        let target = match (open, self.buffer.last_target()) {
            (true, None) => return false,
            (true, Some(target)) => target,
            (false, _) => self.trajectory.counts(),
        };
        let window = self.objects.value(objects::POSITION_WINDOW);
        let within = window == WINDOW_OFF || self.is_within(target, window);
        if policy == ReachedPolicy::TrajectoryEnd || window == WINDOW_OFF {
            return !open && self.trajectory.stands();
        }
        if !within || (policy == ReachedPolicy::WindowAfterEnd && !self.trajectory.stands()) {
            self.reached.in_window_since = None;
            return false;
        }
        let since = *self.reached.in_window_since.get_or_insert(self.now);
        self.now.saturating_sub(since)
            >= milliseconds(self.objects.value(objects::POSITION_WINDOW_TIME))
    }

    /// Whether the axis is within 6067h of the target that it was given last, or of where it holds without one.
    pub(crate) fn is_in_window(&self) -> bool {
        let target = self
            .buffer
            .last_target()
            .unwrap_or(self.trajectory.counts());
        self.is_within(target, self.objects.value(objects::POSITION_WINDOW))
    }

    /// Whether the encoder shows a position no further from a target than a window.
    fn is_within(&self, target: i64, window: i64) -> bool {
        target.saturating_sub(self.shaft.encoder).saturating_abs() <= window
    }

    fn compose_statusword(&mut self, reached: bool, stale: bool) -> u16 {
        let at_switch = self.behaviour.limit_switches == LimitSwitches::Stop
            && self.switches() & (NEGATIVE_LIMIT | POSITIVE_LIMIT) != 0;
        let (limited, bit_12, bit_13) = match self.objects.value(objects::MODE_DISPLAY) {
            PROFILE_POSITION => (
                self.buffer.is_limited(),
                self.acknowledge(),
                self.reached.following_error,
            ),
            // Slippage (bit 13) is of drives without an encoder.
            PROFILE_VELOCITY => (self.velocity_is_limited(), self.speed_is_zero(), false),
            HOMING => {
                let (attained, failed) = self.homing_bits(stale);
                (false, attained, failed)
            }
            _ => (self.buffer.is_limited(), false, false),
        };
        let bits = [
            (4, self.voltage),
            (
                5,
                self.behaviour.open_bit_5 && self.state.leaves_bit_5_open(),
            ),
            (7, self.warning),
            (9, self.remote),
            (10, reached),
            (11, limited || at_switch || self.disturbances.always_limited),
            (12, bit_12),
            (13, bit_13),
        ];
        let manufacturer = self.behaviour.manufacturer_bits & 0xC100;
        bits.into_iter()
            .filter(|&(_, set)| set)
            .fold(self.state.pattern() | manufacturer, |word, (bit, _)| {
                word | 1 << bit
            })
    }

    /// 6063h: the actual position times encoder resolution and gear ratio over the feed constant, or times 6093h.
    fn internal_position(&self) -> i64 {
        let value = |address| i128::from(self.objects.value(address).max(1));
        let times = value(objects::ENCODER_INCREMENTS)
            * value(objects::GEAR_MOTOR)
            * value(objects::FEED_SHAFT)
            * value(objects::POSITION_NUMERATOR);
        let over = value(objects::ENCODER_REVOLUTIONS)
            * value(objects::GEAR_SHAFT)
            * value(objects::FEED)
            * value(objects::POSITION_DIVISOR);
        // Three 32-bit factors and a position of 63 bits can exceed even 128 bits.
        (i128::from(self.shaft.encoder).saturating_mul(times) / over) as i64
    }
}

/// Where the shaft gets to for a position, in reported counts.
fn reach(machine: &Machine, offset: i64, position: i64) -> i64 {
    let mechanical = position.saturating_add(offset);
    let reached = machine.within_ends(mechanical);
    position.saturating_add(reached.saturating_sub(mechanical))
}

/// A position as a 32-bit object shows it: it wraps.
fn wrapped(position: i64) -> i64 {
    i64::from(position as i32)
}

/// A difference or velocity as a 32-bit object shows it: it stays at the limit.
fn saturated(value: i64) -> i64 {
    value.clamp(i32::MIN.into(), i32::MAX.into())
}

pub(super) fn milliseconds(value: i64) -> Duration {
    Duration::from_millis(value.unsigned_abs())
}
