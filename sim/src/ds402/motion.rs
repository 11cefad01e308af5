//! Profile position mode: the handshake of bits 4 and 12, the set-points one after the other, and halt.

use super::axis::{AckFault, Axis};
use super::behaviour::{
    AckPolicy, Bit5, FullBuffer, LimitViolation, ModeZero, WhileHalted, WhileMoving,
};
use super::emergency;
use super::ledger::{Cause, Outcome};
use super::objects;
use super::positioning::Change;
use super::power::Ramp;
use super::set_point::SetPoint;
use super::state::State;

/// Bits 5, 6 and 9 of the controlword.
const START_BITS: u16 = 0x0260;

/// 6061h of profile position mode.
pub(super) const PROFILE_POSITION: i64 = 1;

impl Axis {
    /// Moves the demand on by one period, and from a target that is passed or reached to the next set-point.
    pub(super) fn advance(&mut self) {
        let left = self.trajectory.advance(self.behaviour.period.as_secs_f64());
        if self.finish_active() && !self.trajectory.stands() {
            self.start_active();
            self.trajectory.advance(left);
        }
    }

    /// Mode of operation: 6061h follows 6060h. True in the cycle in which another mode becomes active.
    pub(super) fn update_mode(&mut self, controlword: u16) -> bool {
        let asked = self.objects.value(objects::MODE);
        let active = self.objects.value(objects::MODE_DISPLAY);
        let known = match asked {
            0 => self.behaviour.mode_zero == ModeZero::Clears,
            1..=32 => self.behaviour.supported_modes >> (asked - 1) & 1 != 0,
            _ => false,
        };
        let enabled = self.state == State::OperationEnabled;
        let moves = enabled && !self.trajectory.stands();
        let blocked = (self.behaviour.halt_blocks_mode_change && controlword & 0x0100 != 0)
            || (self.behaviour.operation_blocks_mode_change && enabled)
            || (self.behaviour.motion_blocks_mode_change && moves);
        if asked == active || !known || blocked {
            self.mode_wait = 0;
            return false;
        }
        if self.mode_wait < self.behaviour.mode_change_cycles {
            self.mode_wait += 1;
            return false;
        }
        self.mode_wait = 0;
        self.objects.put(objects::MODE_DISPLAY, asked);
        if self.state == State::OperationEnabled {
            self.discard_motion(Cause::ModeChange);
            self.slow_down();
        }
        true
    }

    /// Whether bit 4 has risen in this cycle, as this drive sees it.
    pub(super) fn bit_4_rises(&mut self, controlword: u16, mode_became_active: bool) -> bool {
        let bit_4 = controlword & 0x0010 != 0;
        let edge = bit_4 && self.last_controlword & 0x0010 == 0;
        let edge = edge || (mode_became_active && bit_4 && self.behaviour.edge_at_mode_change);
        self.passes_filter(edge, bit_4) && !self.disturbances.deaf_to_bit_4
    }

    /// Drops everything that moves the axis, whatever the mode.
    pub(super) fn discard_motion(&mut self, cause: Cause) {
        self.discard_set_points(cause);
        self.discard_homing(cause);
        self.discard_velocity(cause);
    }

    /// Outside of homing, on a drive that does so: stops before a limit switch.
    pub(super) fn check_limit_switches(&mut self) {
        let homes = self.is_homing();
        if self.state == State::OperationEnabled
            && !homes
            && self.is_stopped_by_switch(self.trajectory.velocity())
        {
            self.discard_motion(Cause::LimitSwitch);
            self.stop_on(Ramp::QuickStop);
        }
    }

    /// The handshake and the halt of this cycle.
    pub(super) fn run_set_points(&mut self, controlword: u16, can_take: bool, rise: bool) {
        let can_take = can_take && self.objects.value(objects::MODE_DISPLAY) == PROFILE_POSITION;
        if can_take {
            self.run_halt(controlword & 0x0100 != 0);
        }
        if controlword & 0x0010 == 0 {
            self.buffer.low_word = controlword;
        }
        let rise = self.counting_rise(controlword & 0x0010 != 0, rise);
        if can_take && self.may_take(controlword, rise) {
            let word = if self.behaviour.start_bits_before_edge {
                controlword & !START_BITS | self.buffer.low_word & START_BITS
            } else {
                controlword
            };
            self.take_set_point(word);
        }
        self.run_acknowledge(controlword & 0x0010 != 0);
        if can_take && self.behaviour.velocity_at_once {
            self.follow_velocity();
        }
        if can_take && !self.buffer.halted {
            self.start_active();
            // A set-point that leads nowhere is done in the cycle that took it.
            while self.finish_active() {
                self.start_active();
            }
        }
    }

    /// Whether bit 4 counts as rising in this cycle: one that has risen during a halt may count later, or never.
    fn counting_rise(&mut self, bit_4: bool, rise: bool) -> bool {
        let halted = self.buffer.halted;
        match self.behaviour.while_halted {
            WhileHalted::Takes => rise,
            WhileHalted::Ignores => rise && !halted,
            WhileHalted::TakesAtRelease => {
                let waits = bit_4 && (rise || self.buffer.edge_at_halt);
                self.buffer.edge_at_halt = waits && halted;
                waits && !halted
            }
        }
    }

    /// Whether a set-point is taken in this cycle: with the rising bit 4, or, where single set-points are taken after
    /// arrival, as soon as the axis has arrived and bit 4 is still high.
    fn may_take(&mut self, controlword: u16, rise: bool) -> bool {
        let bit_4 = controlword & 0x0010 != 0;
        let single = controlword & 0x0020 == 0
            && self.behaviour.while_moving == WhileMoving::TakenAfterArrival;
        self.buffer.asked = bit_4 && (rise || self.buffer.asked);
        // One that had to wait is taken after the master could see the arrival.
        let told = rise || self.statusword() & 0x0400 != 0;
        let free = !single || (self.buffer.is_empty() && self.trajectory.stands() && told);
        let take = self.buffer.asked && (rise || single) && free;
        if take || !single {
            self.buffer.asked = false;
        }
        take
    }

    /// Drops what is active and what waits.
    fn discard_set_points(&mut self, cause: Cause) {
        for set_point in self.buffer.drain() {
            self.close(set_point, Outcome::Discarded(cause));
        }
        self.buffer.halted = false;
        self.buffer.ack = false;
        self.buffer.ack_due = None;
        self.buffer.edge_due = None;
        self.buffer.asked = false;
        self.buffer.previous_target = self.trajectory.counts();
    }

    fn passes_filter(&mut self, edge: bool, bit_4: bool) -> bool {
        if edge {
            self.buffer.edge_due = Some(self.behaviour.bit_4_filter_cycles);
        }
        if !bit_4 {
            self.buffer.edge_due = None;
        }
        match self.buffer.edge_due {
            Some(0) => {
                self.buffer.edge_due = None;
                true
            }
            Some(left) => {
                self.buffer.edge_due = Some(left - 1);
                false
            }
            None => false,
        }
    }

    fn run_halt(&mut self, halt: bool) {
        if halt && !self.buffer.halted {
            if !self.behaviour.halt_keeps {
                let ack = self.buffer.ack;
                self.discard_set_points(Cause::Halt);
                self.buffer.ack = ack;
            }
            self.begin_halt();
            self.buffer.halted = true;
        } else if !halt && self.buffer.halted {
            self.buffer.halted = false;
            if let Some(active) = self.buffer.active.filter(|active| active.started) {
                self.run(active);
            }
        }
    }

    fn take_set_point(&mut self, controlword: u16) {
        let bit = |n: u16| controlword & (1 << n) != 0;
        let linear = self.objects.value(objects::PROFILE_TYPE) == 0;
        let (replaces, blend) = match (self.behaviour.bit_5, self.positioning().change) {
            (Bit5::Ignored, _) => (true, false),
            (Bit5::Blends, _) => (false, bit(5) && linear),
            (Bit5::Replaces, Change::AtOnce) if bit(5) => (true, false),
            (Bit5::Replaces, Change::ThroughTarget) if bit(5) => (false, true),
            (Bit5::Replaces, Change::AfterTarget) if bit(5) => (false, false),
            (Bit5::Replaces, _) => (false, bit(9) && self.behaviour.bit_9),
        };
        let full = self.buffer.is_full(self.behaviour.waiting_set_points);
        let overwrites = self.behaviour.full_buffer == FullBuffer::OverwritePending
            && !self.buffer.waiting.is_empty();
        if full && !replaces && !overwrites {
            return;
        }
        let Some(set_point) = self.latch(controlword, replaces, blend) else {
            self.buffer.limited = true;
            if self.behaviour.limit_violation == LimitViolation::Fault {
                self.raise_fault(emergency::REFERENCE_LIMIT);
            }
            return;
        };
        if replaces {
            for old in self.buffer.drain() {
                self.close(old, Outcome::Replaced);
            }
        }
        if self.buffer.active.is_none() {
            self.buffer.active = Some(set_point);
        } else {
            if full && let Some(old) = self.buffer.waiting.pop_back() {
                self.close(old, Outcome::Replaced);
            }
            self.buffer.waiting.push_back(set_point);
            self.plan_junction();
        }
        self.reached
            .set_point_taken(self.disturbances.stale_reached_cycles);
        if self.disturbances.ack_delay_cycles == 0 {
            self.buffer.ack = true;
        } else {
            self.buffer.ack_due = Some(self.disturbances.ack_delay_cycles);
        }
    }

    /// Closes the active set-point if its trajectory is done, and lets the waiting one move up. True if so.
    fn finish_active(&mut self) -> bool {
        if self.buffer.halted || !self.trajectory.is_done() {
            return false;
        }
        let Some(active) = self.buffer.active.take_if(|active| active.started) else {
            return false;
        };
        let outcome = if self.trajectory.stands() {
            Outcome::Reached
        } else {
            Outcome::Passed
        };
        if let Some(target) = active.target {
            self.buffer.previous_target = target;
        }
        self.close(active, outcome);
        self.buffer.active = self.buffer.waiting.pop_front();
        if self.buffer.active.is_none() && !self.trajectory.stands() {
            // An end velocity (6082h) that no further set-point takes up: assumed to end in a stop beyond the target.
            if self.behaviour.goes_on_at_end_velocity {
                let velocity = self.trajectory.velocity();
                self.trajectory.run_at(velocity, active.bounds);
            } else {
                self.slow_down();
            }
        }
        true
    }

    fn close(&mut self, set_point: SetPoint, outcome: Outcome) {
        let (now, position) = (self.now, self.trajectory.counts());
        if let Some(line) = self.ledger.get_mut(set_point.line) {
            line.ended_at = Some(now);
            line.end_position = Some(position);
            line.shaft_position = Some(self.shaft.counts);
            line.shaft_velocity = Some(self.shaft.velocity);
            line.outcome = outcome;
        }
        if outcome == Outcome::Replaced
            && let Some(target) = set_point.target
        {
            self.buffer.previous_target = target;
        }
    }

    fn run_acknowledge(&mut self, bit_4: bool) {
        match self.buffer.ack_due {
            Some(left) if left > 1 => self.buffer.ack_due = Some(left - 1),
            Some(_) => {
                self.buffer.ack_due = None;
                self.buffer.ack = true;
            }
            None => {}
        }
        if bit_4 {
            return;
        }
        match self.behaviour.ack {
            AckPolicy::FollowsBit4 | AckPolicy::StickyAtEnable => {
                let pulsed = self.last_controlword & 0x0010 != 0;
                if self.behaviour.ack == AckPolicy::FollowsBit4 || pulsed {
                    self.buffer.ack = false;
                    self.buffer.ack_due = None;
                }
            }
            AckPolicy::BufferFree => {
                let full = self.buffer.is_full(self.behaviour.waiting_set_points);
                if !full && self.buffer.ack_due.is_none() {
                    self.buffer.ack = false;
                }
            }
        }
    }

    /// Bit 12 as it is shown.
    pub(super) fn acknowledge(&self) -> bool {
        match self.disturbances.ack {
            AckFault::None => self.buffer.ack,
            AckFault::Never => false,
            AckFault::StuckHigh => true,
        }
    }
}
