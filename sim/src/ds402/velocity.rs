//! Profile velocity mode: the axis follows the level of 60FFh by the ramps 6083h and 6084h.

use core::time::Duration;

use super::axis::Axis;
use super::behaviour::LimitSwitches;
use super::ledger::{Cause, VelocityEnd, VelocityPhase};
use super::machine::{NEGATIVE_LIMIT, POSITIVE_LIMIT};
use super::objects;
use super::status::milliseconds;
use super::trajectory::Bounds;

/// 6061h of profile velocity mode.
pub(super) const PROFILE_VELOCITY: i64 = 3;

/// The mode's memory.
#[derive(Debug, Clone, Default)]
pub(super) struct VelocityState {
    /// What the ramp generator was told last: counts/s, and the ramps.
    commanded: Option<(f64, Bounds)>,
    /// The open line of the ledger.
    line: Option<usize>,
    in_window_since: Option<Duration>,
    fast_since: Option<Duration>,
    limited: bool,
}

impl Axis {
    /// Profile velocity mode in this cycle.
    pub(super) fn run_velocity(&mut self, controlword: u16, can_take: bool) {
        if self.objects.value(objects::MODE_DISPLAY) != PROFILE_VELOCITY || !can_take {
            return;
        }
        let halt = controlword & 0x0100 != 0;
        if halt && !self.buffer.halted {
            self.end_phase(VelocityEnd::Halted);
            self.begin_halt();
        }
        self.buffer.halted = halt;
        let asked = self.target_velocity();
        let most = self.objects.highest_velocity();
        let target = asked.clamp(-most, most);
        self.velocity.limited = target != asked;
        // At a limit switch the stop's ramp goes on.
        if halt || self.is_stopped_by_switch(target) {
            return;
        }
        self.note_phase(self.objects.value(objects::TARGET_VELOCITY) as i32);
        let bounds = Bounds {
            velocity: target.abs(),
            end_velocity: target.abs(),
            acceleration: self
                .objects
                .acceleration_within(objects::PROFILE_ACCELERATION, objects::MAX_ACCELERATION),
            deceleration: self.deceleration(),
            shape: self.shape(),
        };
        let command = (target, bounds);
        if self.velocity.commanded.replace(command) != Some(command) {
            self.trajectory.run_at(target, bounds);
        }
    }

    /// 60FFh in counts/s of the axis.
    fn target_velocity(&self) -> f64 {
        self.turned_velocity(self.objects.velocity(objects::TARGET_VELOCITY))
    }

    /// Nothing drives the axis to a velocity any more.
    pub(super) fn discard_velocity(&mut self, cause: Cause) {
        self.end_phase(VelocityEnd::Discarded(cause));
    }

    /// Whether the drive keeps the axis from moving at this velocity because of a limit switch.
    pub(super) fn is_stopped_by_switch(&self, velocity: f64) -> bool {
        let ahead = if velocity > 0.0 {
            POSITIVE_LIMIT
        } else if velocity < 0.0 {
            NEGATIVE_LIMIT
        } else {
            0
        };
        self.behaviour.limit_switches == LimitSwitches::Stop && self.switches() & ahead != 0
    }

    /// Bit 10: for the time 606Eh the velocity was within the window 606Dh around 60FFh.
    pub(super) fn velocity_reached(&mut self) -> bool {
        let target = self.target_velocity();
        let window = self.objects.velocity(objects::VELOCITY_WINDOW);
        if (self.shaft.shown_velocity() - target).abs() > window {
            self.velocity.in_window_since = None;
            return false;
        }
        let since = *self.velocity.in_window_since.get_or_insert(self.now);
        self.now.saturating_sub(since)
            >= milliseconds(self.objects.value(objects::VELOCITY_WINDOW_TIME))
    }

    /// Bit 12, speed zero: not when the velocity was above the threshold 606Fh for longer than 6070h.
    pub(super) fn speed_is_zero(&mut self) -> bool {
        let threshold = self.objects.velocity(objects::VELOCITY_THRESHOLD);
        if self.shaft.shown_velocity().abs() <= threshold {
            self.velocity.fast_since = None;
            return true;
        }
        let since = *self.velocity.fast_since.get_or_insert(self.now);
        self.now.saturating_sub(since)
            < milliseconds(self.objects.value(objects::VELOCITY_THRESHOLD_TIME))
    }

    /// Bit 11: 60FFh is beyond 607Fh.
    pub(super) fn velocity_is_limited(&self) -> bool {
        self.velocity.limited
    }

    /// Keeps the ledger: another target ends a phase and, unless it is 0, begins the next.
    fn note_phase(&mut self, target: i32) {
        let open = self.velocity.line.and_then(|line| {
            let line = self.velocity_phases.get(line)?;
            Some(line.target)
        });
        if open == Some(target) {
            return;
        }
        self.end_phase(VelocityEnd::Changed);
        if target != 0 {
            self.velocity.line = Some(self.velocity_phases.len());
            self.velocity_phases.push(VelocityPhase {
                started_at: self.now,
                start_position: self.trajectory.counts(),
                target,
                ended_at: None,
                end_position: None,
                end: VelocityEnd::Active,
            });
        }
    }

    fn end_phase(&mut self, end: VelocityEnd) {
        self.velocity.commanded = None;
        let (now, position) = (self.now, self.trajectory.counts());
        let line = self.velocity.line.take();
        if let Some(line) = line.and_then(|line| self.velocity_phases.get_mut(line)) {
            line.ended_at = Some(now);
            line.end_position = Some(position);
            line.end = end;
        }
    }
}
