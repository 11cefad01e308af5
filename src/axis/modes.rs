//! The active mode: whose bits and set-points are in the outputs, and how one mode gives way to another.

use core::time::Duration;

use crate::{
    ds402::{Controlword, Mode, Sample},
    homing::{HomingCommand, Verdict},
    profile_position::{CommandId, Completion, Delivery, Failure, Parameters, WaitingFor},
    profile_velocity::JogSetPoint,
};

use super::{AxisCore, core::cycle};

/// The bits of the controlword that mean something else in each mode.
pub(super) const MODE_BITS: Controlword = Controlword::NEW_SET_POINT
    .union(Controlword::CHANGE_IMMEDIATELY)
    .union(Controlword::RELATIVE)
    .union(Controlword::BLEND);

/// A change of 6060h that waits for 6061h.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct ModeChange {
    id: CommandId,
    to: Mode,
    before: Mode,
    deadline: Duration,
    step: Step,
}

/// How far a change of mode is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Step {
    /// Until the axis stands and the drive has surely seen the bits of the last mode low and its target velocity 0; then it is written, or
    /// whoever writes it by SDO is told.
    Quiet { by_sdo: bool },
    /// 6060h is in the outputs.
    Written,
    /// Whoever writes 6060h by SDO has been told to: until the mode is awaited, the drive may show either.
    BySdo,
}

impl AxisCore {
    /// The velocity of a jog that is held, from the next outputs on. False if it is not followed: this jog is not held any
    /// more, or the velocity is above max profile velocity 607Fh.
    pub fn set_jog(&mut self, id: CommandId, velocity: i32, outputs: &mut [u8]) -> bool {
        let followed = self.check_jog(velocity).is_ok() && self.jogging.set(id, velocity);
        if followed {
            self.write_outputs(outputs);
        }
        followed
    }

    /// Lets go of a jog: target velocity 0 in the next outputs. It is done at standstill. False if it is not held any more.
    pub fn release_jog(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) -> bool {
        let until = now.saturating_add(self.config.deadlines.standstill);
        let held = self.jogging.release(id, until);
        if held {
            self.write_outputs(outputs);
        }
        held
    }

    /// Max profile velocity 607Fh as velocities are checked against it.
    #[cfg(feature = "std")]
    pub(super) const fn max_velocity(&self) -> Option<u32> {
        self.config.limits.max_velocity
    }

    /// The jog that is held or coming to rest.
    #[must_use]
    pub const fn jog(&self) -> Option<CommandId> {
        self.jogging.id()
    }

    pub(super) fn select_mode(&mut self, now: Duration, id: CommandId, to: Mode, by_sdo: bool) {
        let shown = self.sample.is_some_and(|sample| sample.mode == to);
        if shown && self.mode == to && self.mode_change.is_none() {
            self.done(id, Ok(Completion::Done));
        } else if !self
            .config
            .supported_modes
            .is_none_or(|modes| modes.allows(to))
        {
            self.done(id, Err(Failure::ModeNotSupported { mode: to }));
        } else if self.halted {
            self.done(id, Err(Failure::HALTED));
        } else if !self.is_idle() || self.has_motion() {
            self.done(id, Err(Failure::Moving));
        } else if self.stopping.is_active()
            || self
                .mode_change
                .is_some_and(|change| change.step != Step::BySdo)
        {
            self.done(id, Err(Failure::Busy));
        } else {
            let change = ModeChange {
                id,
                to,
                before: self.mode,
                deadline: now.saturating_add(self.config.deadlines.mode),
                step: Step::Quiet { by_sdo },
            };
            self.mode_change = Some(change);
            self.write_mode(now);
        }
    }

    /// Writes 6060h, or says that it may be written, once nothing of the last mode is left that the next could take for its
    /// own.
    fn write_mode(&mut self, now: Duration) {
        let Some(change) = &mut self.mode_change else {
            return;
        };
        let Step::Quiet { by_sdo } = change.step else {
            return;
        };
        let quiet = self
            .quiet_since
            .is_some_and(|since| now.saturating_sub(since) >= self.config.traits.surely_seen());
        if !quiet || (self.power.is_driving() && !self.standstill.is_standing()) {
            return;
        }
        // 607Ah still holds the last move's target or distance; another mode may follow it at once.
        if let Some(sample) = self.sample {
            self.sequencer.follow_position(sample.position);
        }
        let (id, to) = (change.id, change.to);
        if by_sdo {
            change.step = Step::BySdo;
            self.done(id, Ok(Completion::Done));
        } else {
            change.step = Step::Written;
            self.mode = to;
        }
    }

    /// What has just been sent, of the mode's own: since when it is nothing.
    pub(super) fn observe_quiet(&mut self, now: Duration, delivered: bool) {
        if self.sent.intersects(MODE_BITS) || self.sent_velocity != 0 {
            self.quiet_since = None;
        } else if delivered {
            self.quiet_since.get_or_insert(now);
        }
    }

    pub(super) fn observe_mode_change(&mut self, now: Duration, sample: &Sample) {
        self.write_mode(now);
        let Some(change) = self.mode_change.filter(|change| change.step != Step::BySdo) else {
            return;
        };
        if change.step == Step::Written && sample.mode == change.to {
            self.mode_change = None;
            self.done(change.id, Ok(Completion::Done));
        } else if now >= change.deadline {
            self.mode_change = None;
            self.mode = change.before;
            let moves = matches!(change.step, Step::Quiet { .. }) && !self.is_standing();
            let failure = if moves {
                Failure::Moving
            } else {
                self.timeout(WaitingFor::Mode(change.to), Delivery::NotSent)
            };
            self.done(change.id, Err(failure));
        }
    }

    /// Gives up the change of mode with this id: nobody waits for it. The mode before is in the outputs again.
    pub(super) fn withdraw_mode_change(&mut self, id: CommandId) -> bool {
        let mut of_id = self.mode_change.iter().filter(|change| change.id == id);
        let is_pending = of_id.any(|change| change.step != Step::BySdo);
        if is_pending {
            self.fail_mode_change(Failure::Withdrawn);
        }
        is_pending
    }

    pub(super) fn fail_mode_change(&mut self, failure: Failure) {
        if let Some(change) = self
            .mode_change
            .take_if(|change| change.step != Step::BySdo)
        {
            self.mode = change.before;
            self.done(change.id, Err(failure));
        }
    }

    pub(super) fn start_homing(&mut self, id: CommandId, command: HomingCommand) {
        if let Some(offset) = command.offset {
            // The drive holds it already, and counts its software position limits from it.
            self.config.limits.home_offset = offset;
        }
        match self.check_homing() {
            Err(failure) => self.done(id, Err(failure)),
            Ok(()) => self.homing.submit(id, command, &mut self.events),
        }
    }

    pub(super) fn start_jog(&mut self, id: CommandId, mut set_point: JogSetPoint) {
        let fields = &self.config.fields;
        let checked = self
            .check_jogging(set_point.velocity)
            .and_then(|()| fields.complete_jog(&mut set_point, &self.config.defaults));
        match checked {
            Err(failure) => self.done(id, Err(failure)),
            Ok(()) => self.jogging.submit(id, set_point, &mut self.events),
        }
    }

    /// One cycle in Operation enabled: the active mode's machine goes on.
    pub(super) fn observe_mode(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        if self.stopping.is_quick() {
            return;
        }
        if sample.mode != self.mode {
            self.homing.outside();
            if !self.is_idle() {
                let failure = Failure::WrongMode {
                    expected: self.mode,
                    shown: sample.mode,
                    delivery: Delivery::NotSent,
                };
                self.fail_motions(failure);
                self.begin_quick_stop(now);
            }
            return;
        }
        if self.mode == Mode::ProfilePosition {
            self.observe_moves(now, sample, delivered);
            return;
        }
        // No move of ours is under way: whoever looks at 607Ah finds no jump, not even after a homing has moved the zero.
        self.sequencer.follow_other_mode(sample.position);
        let cycle = cycle!(self, now, sample, delivered);
        match self.mode {
            Mode::Homing => match self.homing.step(&cycle, &mut self.events) {
                Verdict::GoOn => {}
                Verdict::Attained => self.homed = true,
                Verdict::StopIt => {
                    self.begin_quick_stop(now);
                }
                Verdict::EndIt => {
                    self.begin_stop(now, Failure::QUICK_STOPPED);
                }
            },
            Mode::ProfileVelocity => self.jogging.step(&cycle, &mut self.events),
            _ => {}
        }
    }

    /// Bits 4, 5, 6 and 9 of the next controlword: the active mode's.
    pub(super) const fn mode_bits(&self) -> Controlword {
        if !self.power.allows_mode_bits() {
            return Controlword::empty();
        }
        match self.mode {
            Mode::ProfilePosition => self.sequencer.bits(),
            Mode::Homing => self.homing.bits(),
            _ => Controlword::empty(),
        }
    }

    /// Target velocity 60FFh of the next outputs.
    pub(super) const fn target_velocity(&self) -> i32 {
        match self.mode {
            Mode::ProfileVelocity if self.power.allows_mode_bits() => self.jogging.velocity(),
            _ => 0,
        }
    }

    /// Profile parameters of the next outputs, of a jog: its ramps in place of those of the moves.
    pub(super) fn jog_parameters(&self) -> Parameters {
        let held = *self.sequencer.parameters();
        let ramps = self.jogging.ramps();
        Parameters {
            acceleration: ramps.acceleration.or(held.acceleration),
            deceleration: ramps.deceleration.or(held.deceleration),
            ..held
        }
    }

    /// Whether the drive follows a set-point of any mode, or may.
    pub(super) fn has_motion(&self) -> bool {
        self.sequencer.has_set_point()
            || self.homing.has_motion()
            || self.jogging.has_motion()
            || (self.sequencer.has_end_velocity() && self.power.is_driving() && !self.is_standing())
    }

    /// Whether nothing waits and nothing is under way, in any mode.
    fn is_idle(&self) -> bool {
        self.sequencer.is_idle() && self.homing.is_idle() && self.jogging.is_idle()
    }

    /// The outputs composed last have been sent.
    pub(super) fn mark_sent(&mut self, now: Duration) {
        self.sequencer.mark_sent(now);
        self.jogging.mark_sent();
        if self.homing.mark_sent(now) {
            // From now on the drive's positions are between two meanings.
            self.homed = false;
        }
    }

    /// Ends every motion with this failure, which says how far each set-point came.
    pub(super) fn fail_motions(&mut self, failure: Failure) {
        self.sequencer.fail_all(failure, &mut self.events);
        self.homing.fail(failure, &mut self.events);
        self.jogging.end(failure, &mut self.events);
    }

    /// A stop takes over: what is not sent is not started, and a velocity that is held is let go with this frame.
    pub(super) fn withdraw_unsent(&mut self, failure: Failure) {
        self.sequencer.withdraw_unsent(failure, &mut self.events);
        self.homing.withdraw_unsent(failure, &mut self.events);
        self.jogging.end(failure, &mut self.events);
    }

    /// The axis is out of Operation enabled: no bit of a mode stays, and nothing is held any more.
    pub(super) fn lower_mode_bits(&mut self) {
        self.sequencer.lower();
        self.homing.lower();
        // Nothing that leads here leaves a jog; should one be left, it must not come back with the next enable.
        let state = self.state();
        self.jogging
            .end(Failure::Disabled { state }, &mut self.events);
    }
}
