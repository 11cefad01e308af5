//! How each command begins, and everything for which it is refused before anything of it is sent. What it then does from cycle to cycle is
//! in `machines.rs`.

use crate::{
    Failure, SetPoint,
    ds402::{Mode, PowerGoal, State},
    homing::HomingCommand,
    profile_position::{
        BufferMode, CommandId, Completion, Delivery, MoveCommand, ParameterFault, Reference,
        StartBits, Unsupported, VelocityOverride,
    },
    profile_velocity::JogSetPoint,
};

use super::{
    Command, CoreConfig,
    config::Referencing,
    fields::not_mapped,
    machines::{Machines, Resuming, Step, halts_under_control},
    power::{Power, Reset, is_down},
    stopping::{StopPhase, Wait, stopped},
};

type Answer = Result<(), Failure>;

impl Machines {
    /// Takes a command in, of an axis that is not lost.
    pub fn begin(&mut self, step: &Step<'_>, id: CommandId, command: Command) {
        let asked = |answer: Answer| answer.map(|()| Completion::Done);
        match command {
            Command::Enable => self.enable(step, id),
            Command::Disable => self.disable(step, id),
            Command::ResetFault => self.reset_fault(step, id),
            Command::SelectMode(mode) => self.select_mode(step, id, mode, false),
            Command::PrepareMode(mode) => self.select_mode(step, id, mode, true),
            Command::Home(command) => self.start_homing(step, id, command),
            Command::Jog(set_point) => self.start_jog(step, id, set_point),
            Command::Move(command) => self.start_move(step, id, command),
            Command::CheckMove(command) => {
                self.done(id, asked(self.check_unmapped_move(step, command)));
            }
            Command::CheckHome => self.done(id, asked(self.check_homing(step))),
            Command::CheckJog(velocity) => {
                self.done(id, asked(self.check_jogging(step, velocity)));
            }
            // The core has them already.
            Command::SetLimits(_) => self.done(id, Ok(Completion::Done)),
            Command::SetOverride(factor) => {
                let answer = self.set_override(step.config, factor);
                self.done(id, asked(answer));
            }
            Command::Halt => self.halt(step, id),
            Command::Hold => self.hold(step, id),
            Command::Resume => self.resume(step, id),
            Command::Stop | Command::Release => self.stop(step, id),
            Command::QuickStop => self.quick_stop(step, id),
        }
    }

    fn enable(&mut self, step: &Step<'_>, id: CommandId) {
        let unsent = self.outputs.stop_unsent && !self.power.is_driving();
        let answer = match self.power {
            _ if step.state.is_fault() => Err(step.fault()),
            _ if self.stopping.is_active() || unsent => Err(Failure::Busy),
            Power::Enabling { .. } | Power::Disabling { .. } | Power::Resetting { .. } => {
                Err(Failure::Busy)
            }
            Power::Enabled => Ok(Completion::Done),
            Power::Off | Power::Ready | Power::Holding => {
                self.leave_operation(step, self.power);
                self.power = Power::Enabling {
                    id,
                    left: step.timer(step.config.deadlines.enable),
                    was_down: step.is_down_at_rest(),
                };
                return;
            }
        };
        self.done(id, answer);
    }

    fn disable(&mut self, step: &Step<'_>, id: CommandId) {
        match self.power {
            // Asked for again by those who wait for it.
            Power::Disabling { id: waiter, .. } if waiter == id => return,
            Power::Disabling { .. } => {
                self.done(id, Err(Failure::Busy));
                return;
            }
            _ => {}
        }
        let state = step.state;
        if state.is_fault() {
            self.await_standstill(step, id, true);
            return;
        }
        self.cancel_enabling(Failure::Disabled { state });
        self.fail_resume(Failure::Disabled { state });
        if self.begin_stop(step, Failure::Disabled { state }) {
            self.stopping.off = !self.stopping.is_switching_off();
            self.wait_for_stop(id);
            return;
        }
        if !self.power.is_driving() && is_down(state) {
            self.await_standstill(step, id, true);
            return;
        }
        let goal = if self.power.is_driving() {
            PowerGoal::Ready
        } else {
            PowerGoal::Off
        };
        // Where a fault is gone, the reset of it leads to the same.
        if let Some(reset) = self.power.take_waiter() {
            self.done(reset, Err(Failure::Disabled { state }));
        }
        self.power = Power::Disabling {
            id,
            goal,
            left: step.timer(step.config.deadlines.disable),
        };
    }

    fn reset_fault(&mut self, step: &Step<'_>, id: CommandId) {
        if self.power.is_resetting() {
            // Also while no fault is shown: it may come back.
            self.done(id, Err(Failure::Busy));
        } else if step.state.is_fault() {
            self.power = Power::Resetting {
                id,
                reset: Reset::new(step.deadline()),
                edges: 0,
            };
        } else {
            self.done(id, Ok(Completion::Done));
        }
    }

    fn select_mode(&mut self, step: &Step<'_>, id: CommandId, to: Mode, by_sdo: bool) {
        let modes = step.config.supported_modes;
        let answer = if self.modes.is_there(to, step.mode) {
            Ok(Completion::Done)
        } else if !modes.is_none_or(|modes| modes.allows(to)) {
            Err(Failure::Unsupported(Unsupported::Mode(to)))
        } else if self.stopping.halt.is_on {
            Err(Failure::HALTED)
        } else if !self.modes.is_idle() {
            Err(Failure::Moving)
        } else if self.stopping.is_active() || self.modes.is_changing() {
            Err(Failure::Busy)
        } else {
            self.modes.select(id, to, by_sdo, step);
            let rests = self.rests_for_mode(step);
            self.modes.write(rests, step.position(), &mut self.events.0);
            return;
        };
        self.done(id, answer);
    }

    fn start_move(&mut self, step: &Step<'_>, id: CommandId, command: MoveCommand) {
        match self.check_move(step, command) {
            Err(failure) => self.done(id, Err(failure)),
            Ok(command) => {
                let events = &mut self.events.0;
                self.modes.sequencer.submit(id, command, events);
                self.start_move_now(step);
            }
        }
    }

    /// The move that has just been taken in rises in the next frame, if the last inputs were fresh and nothing is in its way. After
    /// others it waits for the next fresh ones.
    fn start_move_now(&mut self, step: &Step<'_>) {
        let ready =
            step.delivered && !self.outputs.stop_unsent && step.state == State::OperationEnabled;
        if ready {
            let cycle = self.cycle(step);
            let events = &mut self.events.0;
            self.modes.sequencer.start_next(&cycle, events);
        }
    }

    fn start_homing(&mut self, step: &Step<'_>, id: CommandId, command: HomingCommand) {
        match self.check_homing(step) {
            Err(failure) => self.done(id, Err(failure)),
            Ok(()) => {
                self.modes.sequencer.forget_place();
                self.modes.homing.submit(id, command, &mut self.events.0);
            }
        }
    }

    fn start_jog(&mut self, step: &Step<'_>, id: CommandId, mut set_point: JogSetPoint) {
        let config = step.config;
        let checked = self
            .check_jogging(step, set_point.velocity)
            .and_then(|()| set_point.check_dead_man())
            .and_then(|()| config.fields.complete_jog(&mut set_point, &config.defaults));
        match checked {
            Err(failure) => self.done(id, Err(failure)),
            Ok(()) => self.modes.jogging.submit(id, set_point, &mut self.events.0),
        }
    }

    /// Refused where a move that waits or is under way would be faster than max profile velocity 607Fh, or slower than its least one.
    fn set_override(&mut self, config: &CoreConfig, factor: VelocityOverride) -> Answer {
        if config.fields.velocity.is_none() {
            return Err(not_mapped("profile velocity 6081h"));
        }
        let sequencer = &mut self.modes.sequencer;
        for parameters in sequencer.open_parameters() {
            if parameters.goes_on() && config.fields.end_velocity.is_none() {
                return Err(not_mapped("end velocity 6082h"));
            }
            let (limits, scaled) = (&config.limits, factor.apply(parameters));
            limits.check_velocity(scaled.velocity)?;
            limits.check_velocity(scaled.end_velocity)?;
            limits.check_least(scaled.velocity, &config.traits.limits)?;
        }
        sequencer.set_override(factor, &config.traits);
        Ok(())
    }

    fn halt(&mut self, step: &Step<'_>, id: CommandId) {
        if let Some(fault) = step.shown_fault() {
            self.done(id, Err(fault));
            return;
        }
        let coasts = !halts_under_control(step);
        if self.power.is_driving() && !self.stopping.is_quick() && coasts {
            self.done(id, Err(Failure::Unsupported(Unsupported::Halt)));
            return;
        }
        self.begin_halt(step);
        if self.stopping.is_quick() || self.stopping.is_switching_off() {
            self.wait_for_stop(id);
        } else if !self.power.is_driving() {
            self.await_standstill(step, id, false);
        } else {
            self.wait_for_halt(step, id, false);
        }
    }

    pub fn wait_for_halt(&mut self, step: &Step<'_>, id: CommandId, holds: bool) {
        let left = step.deadline();
        if !self.stopping.wait(id, Wait::Halt { left, holds }) {
            self.done(id, Err(Failure::Busy));
        }
    }

    /// Stops the axis, which stays enabled where it stands. An axis that stands without a set-point stays as it is.
    fn hold(&mut self, step: &Step<'_>, id: CommandId) {
        if self.stopping.is_to_hold_for(id) {
            // Asked for again by those who wait for it.
            return;
        }
        let stands = step.stands() && !self.stopping.halt.is_on && self.modes.is_idle();
        match self.check_hold(step) {
            Err(failure) => self.done(id, Err(failure)),
            Ok(()) if stands => self.done(id, stopped(step.state)),
            Ok(()) => {
                self.begin_halt(step);
                self.wait_for_halt(step, id, true);
            }
        }
    }

    fn check_hold(&self, step: &Step<'_>) -> Answer {
        self.check_driving(step)?;
        self.modes.check(Mode::ProfilePosition, step.mode)?;
        if self.modes.sequencer.needs_stop() {
            return Err(Failure::NeedsStop);
        }
        can_hold(step)
    }

    fn resume(&mut self, step: &Step<'_>, id: CommandId) {
        let state = step.state;
        let halted = self.stopping.halt.is_on;
        let has_motion = self.modes.has_motion();
        let sequencer = &self.modes.sequencer;
        let unsent = self.outputs.stop_unsent && (has_motion || !step.stands());
        let refused = if let Some(fault) = step.shown_fault() {
            Some(fault)
        } else if self.stopping.is_active() {
            Some(Failure::QUICK_STOPPED)
        } else if !self.power.is_driving() {
            Some(Failure::NotEnabled { state })
        } else if self.resuming.is_some()
            || (halted && unsent)
            || self.stopping.halt.holds.is_some()
        {
            Some(Failure::Busy)
        } else if !halted {
            has_motion.then_some(Failure::Moving)
        } else if sequencer.needs_stop()
            || sequencer.has_pressed()
            || self.modes.homing.is_unknown()
        {
            Some(Failure::NeedsStop)
        } else if self.modes.homing.has_motion() {
            Some(Failure::Unsupported(Unsupported::ResumeHoming))
        } else if sequencer.has_set_point() && !step.config.traits.halt_keeps_set_point {
            Some(Failure::Unsupported(Unsupported::Resume))
        } else {
            None
        };
        if let Some(failure) = refused {
            self.done(id, Err(failure));
            return;
        }
        self.stopping.halt.is_on = false;
        self.resuming = Some(Resuming { id, falls: halted });
    }

    fn stop(&mut self, step: &Step<'_>, id: CommandId) {
        if !step.state.is_fault() && self.begin_stop(step, Failure::QUICK_STOPPED) {
            self.wait_for_stop(id);
        } else {
            self.await_standstill(step, id, false);
        }
    }

    fn quick_stop(&mut self, step: &Step<'_>, id: CommandId) {
        if step.state == State::Fault {
            self.done(id, Err(step.fault()));
        } else if self.begin_quick_stop(step) {
            self.wait_for_stop(id);
        } else {
            self.await_standstill(step, id, false);
        }
    }

    /// There is nothing to send: it is done when the axis stands. `off`: a drive that enables the axis meanwhile is led down after its stop.
    fn await_standstill(&mut self, step: &Step<'_>, id: CommandId, off: bool) {
        if step.is_at_rest_for_good() {
            self.done(id, stopped(step.state));
            return;
        }
        if !self.stopping.is_active() {
            self.stopping.phase = StopPhase::Settling {
                left: step.deadline(),
            };
        }
        self.stopping.off |= off;
        self.wait_for_stop(id);
    }

    // Everything for which a motion is refused.

    /// What every motion needs.
    fn check_driving(&self, step: &Step<'_>) -> Answer {
        if let Some(fault) = step.shown_fault() {
            return Err(fault);
        }
        if self.stopping.is_active() {
            return Err(Failure::QUICK_STOPPED);
        }
        if !self.power.is_driving() {
            let state = step.state;
            return Err(Failure::NotEnabled { state });
        }
        Ok(())
    }

    /// What every start of a motion needs. `replaces`: it takes the place of what the drive keeps while the axis is halted.
    fn check_mode(&self, step: &Step<'_>, expected: Mode, replaces: bool) -> Answer {
        self.check_driving(step)?;
        if self.stopping.halt.is_on && !replaces {
            return Err(Failure::HALTED);
        }
        self.modes.check(expected, step.mode)
    }

    /// Whether the drive takes this move in place of those that it keeps while the axis stands halted.
    fn replaces_halted(&self, step: &Step<'_>, command: &MoveCommand) -> bool {
        step.config.traits.acknowledges_while_halted
            && command.replaces()
            && !command.gated
            && !self.stopping.is_to_hold()
            && self.stopping.stands_halted(step)
    }

    fn check_homing(&self, step: &Step<'_>) -> Answer {
        self.check_mode(step, Mode::Homing, false)?;
        if self.modes.homing.is_unknown() {
            Err(Failure::NeedsStop)
        } else if self.modes.homing.is_idle() {
            Ok(())
        } else {
            Err(Failure::Busy)
        }
    }

    /// Everything for which a jog is refused, but for ramps that are zero.
    fn check_jogging(&self, step: &Step<'_>, velocity: i32) -> Answer {
        self.check_mode(step, Mode::ProfileVelocity, false)?;
        let config = step.config;
        config.limits.check_jog(velocity, &config.traits.limits)?;
        if self.modes.jogging.is_held() {
            Err(Failure::Busy)
        } else {
            Ok(())
        }
    }

    /// As `check_move`, for a move whose parameters may have to be written by SDO first.
    fn check_unmapped_move(&self, step: &Step<'_>, mut command: MoveCommand) -> Answer {
        let config = step.config;
        self.check_limits(config, &command)?;
        let set_point = &mut command.set_point;
        config.traits.check_profile_type(
            set_point.buffer_mode,
            set_point.parameters.profile_type,
            None,
        )?;
        set_point.parameters = config.fields.mapped(&set_point.parameters);
        self.check_move(step, command).map(drop)
    }

    /// What the drive's limits say of a move. Where a relative one ends shows when its turn comes.
    fn check_limits(&self, config: &CoreConfig, command: &MoveCommand) -> Answer {
        let limits = &config.limits;
        let factor = self.modes.sequencer.velocity_override();
        let parameters = factor.apply(&command.set_point.parameters);
        limits.check_velocity(parameters.velocity)?;
        limits.check_velocity(parameters.end_velocity)?;
        let rule = &config.traits.limits;
        // One that is not mapped has been checked before it was written by SDO.
        let held = factor.apply(&config.defaults).velocity;
        let held = config.fields.velocity.and(held);
        limits.check_least(parameters.velocity.or(held), rule)?;
        match command.reference {
            Reference::Absolute => {
                let referenced = self.is_referenced(config);
                limits.check_target(command.target.into(), rule, referenced)
            }
            Reference::Relative => Ok(()),
        }
    }

    /// Everything that can be refused before anything is written; the command with all its parameters.
    fn check_move(
        &self,
        step: &Step<'_>,
        mut command: MoveCommand,
    ) -> Result<MoveCommand, Failure> {
        let config = step.config;
        let buffer_mode = command.set_point.buffer_mode;
        if let StartBits::Unsupported(reason) = config.traits.bits(buffer_mode) {
            return Err(Failure::Unsupported(Unsupported::Start {
                buffer_mode,
                reason,
            }));
        }
        let replaces = self.replaces_halted(step, &command);
        self.check_mode(step, Mode::ProfilePosition, replaces)?;
        if self.modes.sequencer.needs_stop() {
            return Err(Failure::NeedsStop);
        }
        if command.reference == Reference::Absolute
            && !self.is_referenced(config)
            && config.referencing != Referencing::UnreferencedMovesAllowed
        {
            return Err(Failure::NotReferenced);
        }
        self.check_limits(config, &command)?;
        let parameters = &mut command.set_point.parameters;
        *parameters = config.fields.complete(parameters, &config.defaults)?;
        self.check_profile_type(config, &command)?;
        check_contact(step, &command.set_point)?;
        self.check_unmapped_end_velocity(config, &command)?;
        Ok(command)
    }

    /// An end velocity that goes by SDO is in the drive for every set-point from then on, unscaled: that of a hold, too.
    fn check_unmapped_end_velocity(&self, config: &CoreConfig, command: &MoveCommand) -> Answer {
        let goes_on = command.set_point.parameters.goes_on();
        let scales = self.modes.sequencer.velocity_override() != VelocityOverride::NONE;
        let matters = scales || config.traits.acknowledges_while_halted;
        if goes_on && matters && config.fields.end_velocity.is_none() {
            return Err(not_mapped("end velocity 6082h"));
        }
        Ok(())
    }

    fn check_profile_type(&self, config: &CoreConfig, command: &MoveCommand) -> Answer {
        let traits = &config.traits;
        let set_point = &command.set_point;
        let mut before = None;
        if traits.needs_linear_ramps(set_point.buffer_mode) {
            if config.fields.profile_type.is_none() {
                // Written by SDO it would not be known here, nor changed between two set-points.
                return Err(not_mapped("motion profile type 6086h"));
            }
            before = self.modes.sequencer.last_profile_type();
        }
        traits.check_profile_type(
            set_point.buffer_mode,
            set_point.parameters.profile_type,
            before,
        )
    }

    /// What is said of commands of a drive that counts as lost.
    pub const fn failure_of_loss(answered: bool) -> Failure {
        let delivery = Delivery::NotSent;
        if answered {
            Failure::Undelivered {
                delivery,
                counter: None,
            }
        } else {
            Failure::BusLost { delivery }
        }
    }
}

/// Whether the axis can be halted and held.
fn can_hold(step: &Step<'_>) -> Answer {
    step.config.traits.check_hold(step.bounds.turn.is_some())?;
    if halts_under_control(step) {
        Ok(())
    } else {
        Err(Failure::Unsupported(Unsupported::Halt))
    }
}

/// Everything for which a move until a torque is refused.
fn check_contact(step: &Step<'_>, set_point: &SetPoint) -> Answer {
    let Some(contact) = set_point.contact else {
        return Ok(());
    };
    let buffer_mode = set_point.buffer_mode;
    if step.config.fields.torque.is_none() {
        return Err(Failure::Parameter {
            name: "torque actual value 6077h",
            fault: ParameterFault::NotMapped,
        });
    }
    if contact.torque == 0 {
        return Err(Failure::Parameter {
            name: "the torque that ends the move",
            fault: ParameterFault::Zero,
        });
    }
    if buffer_mode != BufferMode::Aborting {
        return Err(Failure::Unsupported(Unsupported::Start {
            buffer_mode,
            reason: "a move until a torque begins at once, as Aborting",
        }));
    }
    can_hold(step)
}
