//! How each command begins. What it then does from cycle to cycle is in `observe.rs`.

use core::time::Duration;

use crate::{
    ds402::{PowerGoal, State},
    profile_position::{CommandId, Completion, Failure, MoveCommand},
};

use super::{
    AxisCore, Command,
    power::{Power, ResetPhase},
    stopping::{Stage, Wait},
};

impl AxisCore {
    /// Takes a command in, between two steps. What it stops or withdraws is out of the outputs at once. It reports through [`AxisCore::poll_event`], under this id, with exactly one
    /// [`Event::Done`](super::Event::Done).
    pub fn submit(&mut self, now: Duration, id: CommandId, command: Command, outputs: &mut [u8]) {
        self.begin(now, id, command);
        self.write_outputs(outputs);
    }

    fn begin(&mut self, now: Duration, id: CommandId, command: Command) {
        let stops = matches!(
            command,
            Command::Halt | Command::Stop | Command::QuickStop | Command::Disable
        );
        if self.is_lost() && !(stops && self.answered) {
            let failure = self.failure_of_loss();
            self.done(id, Err(failure));
            return;
        }
        if self.expired && command.sets_going() {
            self.done(id, Err(Failure::LivenessExpired));
            return;
        }
        match command {
            Command::Enable => self.enable(now, id),
            Command::Disable => self.disable(now, id),
            Command::ResetFault => self.reset_fault(now, id),
            Command::SelectMode(mode) => self.select_mode(now, id, mode, false),
            Command::PrepareMode(mode) => self.select_mode(now, id, mode, true),
            Command::Home(command) => self.start_homing(id, command),
            Command::Jog(set_point) => self.start_jog(id, set_point),
            Command::Move(command) => self.start_move(now, id, command),
            Command::CheckMove(command) => {
                let result = self.check_unmapped_move(command).map(|()| Completion::Done);
                self.done(id, result);
            }
            Command::CheckHome => {
                let result = self.check_homing().map(|()| Completion::Done);
                self.done(id, result);
            }
            Command::CheckJog(velocity) => {
                let result = self.check_jogging(velocity).map(|()| Completion::Done);
                self.done(id, result);
            }
            Command::SetLimits(limits) => {
                self.config.limits = self.config.limits_with(limits);
                self.done(id, Ok(Completion::Done));
            }
            Command::Halt => self.halt(now, id),
            Command::Resume => self.resume(now, id),
            Command::Stop => self.stop(now, id),
            Command::QuickStop => self.quick_stop(now, id),
            Command::Release => self.release(now, id),
        }
    }

    fn enable(&mut self, now: Duration, id: CommandId) {
        let refused = if let Some(fault) = self.fault() {
            Some(fault)
        } else if self.stopping.is_active() || (self.stop_unsent && !self.power.is_driving()) {
            Some(Failure::Busy)
        } else {
            match self.power {
                Power::Enabling { .. } | Power::Disabling { .. } | Power::Resetting { .. } => {
                    Some(Failure::Busy)
                }
                Power::Enabled => {
                    self.done(id, Ok(Completion::Done));
                    return;
                }
                Power::Off | Power::Ready | Power::Holding => None,
            }
        };
        if let Some(failure) = refused {
            self.done(id, Err(failure));
            return;
        }
        self.lower_mode_bits();
        self.power = Power::Enabling {
            id,
            deadline: now.saturating_add(self.config.deadlines.enable),
            was_down: self.is_down_at_rest(),
            shown: None,
        };
    }

    fn disable(&mut self, now: Duration, id: CommandId) {
        match self.power {
            // Asked for again by those who wait for it.
            Power::Disabling { id: waiter, .. } if waiter == id => return,
            Power::Resetting { .. } | Power::Disabling { .. } => {
                self.done(id, Err(Failure::Busy));
                return;
            }
            _ => {}
        }
        let state = self.state();
        if state.is_fault() {
            self.await_standstill(now, id);
            return;
        }
        self.cancel_enabling(Failure::Disabled { state });
        if self.begin_stop(now, Failure::Disabled { state }) {
            self.stopping.off = !self.stopping.is_switching_off();
            self.wait_for_stop(now, id);
            return;
        }
        let deadline = now.saturating_add(self.config.deadlines.disable);
        match self.power {
            Power::Enabled => {
                self.power = Power::Disabling {
                    id,
                    goal: PowerGoal::Ready,
                    deadline,
                };
            }
            _ if is_down(state) => self.await_standstill(now, id),
            _ => {
                self.power = Power::Disabling {
                    id,
                    goal: PowerGoal::Off,
                    deadline,
                }
            }
        }
    }

    fn reset_fault(&mut self, now: Duration, id: CommandId) {
        let state = self.state();
        if !state.is_fault() {
            self.done(id, Err(Failure::NoFault { state }));
        } else if matches!(self.power, Power::Resetting { .. }) {
            self.done(id, Err(Failure::Busy));
        } else {
            let reaction = now.saturating_add(self.config.deadlines.standstill);
            self.power = Power::Resetting {
                id,
                phase: ResetPhase::Low {
                    until: now,
                    reaction,
                    shown: None,
                },
                edges: 0,
            };
        }
    }

    fn start_move(&mut self, now: Duration, id: CommandId, command: MoveCommand) {
        match self.check_move(command) {
            Ok(command) => {
                self.sequencer.submit(id, command, &mut self.events);
                self.start_move_now(now);
            }
            Err(failure) => self.done(id, Err(failure)),
        }
    }

    fn halt(&mut self, now: Duration, id: CommandId) {
        if let Some(fault) = self.fault() {
            self.done(id, Err(fault));
            return;
        }
        if self.power.is_driving() && !self.stopping.is_quick() && !self.halts_under_control() {
            self.done(id, Err(Failure::HaltCoasts));
            return;
        }
        self.begin_halt(now);
        if self.stopping.is_quick() || self.stopping.is_switching_off() {
            self.wait_for_stop(now, id);
        } else if self.power.is_driving() {
            let until = now.saturating_add(self.config.deadlines.standstill);
            if !self.stopping.wait(id, Wait::Halt { until }) {
                self.done(id, Err(Failure::Busy));
            }
        } else {
            self.await_standstill(now, id);
        }
    }

    fn resume(&mut self, now: Duration, id: CommandId) {
        let state = self.state();
        let result = if let Some(fault) = self.fault() {
            Err(fault)
        } else if self.stopping.is_active() {
            Err(Failure::QUICK_STOPPED)
        } else if !self.power.is_driving() {
            Err(Failure::NotEnabled { state })
        } else if self.resuming.is_some() {
            Err(Failure::Busy)
        } else if !self.halted {
            if self.has_motion() {
                Err(Failure::Moving)
            } else {
                self.resuming = Some(Resuming {
                    id,
                    from_rest: None,
                });
                return;
            }
        } else if self.stop_unsent && (self.has_motion() || !self.is_standing()) {
            Err(Failure::Busy)
        } else if self.sequencer.is_unknown() || self.homing.is_unknown() {
            Err(Failure::NeedsStop)
        } else if self.homing.has_motion() {
            Err(Failure::HomingHalted)
        } else if self.sequencer.has_set_point() && !self.config.traits.halt_keeps_set_point {
            Err(Failure::ResumeUnsupported)
        } else {
            self.halted = false;
            let stands = self.stands_halted(now);
            self.resuming = Some(Resuming {
                id,
                from_rest: Some(stands),
            });
            return;
        };
        self.done(id, result);
    }

    /// What was sent last had bit 8 low, and nothing has stopped the axis before that.
    pub(super) fn finish_resume(&mut self, now: Duration) {
        let Some(Resuming { id, from_rest }) = self.resuming.take() else {
            return;
        };
        if let Some(from_rest) = from_rest {
            self.sequencer.resumed(now, from_rest);
            while let Some((waiter, _)) = self.stopping.next_waiter() {
                self.done(waiter, Err(Failure::Superseded));
            }
        }
        self.done(id, Ok(Completion::Done));
    }

    /// A stop comes before bit 8 has fallen.
    pub(super) fn fail_resume(&mut self, failure: Failure) {
        if let Some(Resuming { id, from_rest }) = self.resuming.take() {
            self.halted |= from_rest.is_some();
            self.done(id, Err(failure));
        }
    }

    fn stop(&mut self, now: Duration, id: CommandId) {
        let state = self.state();
        if !state.is_fault() && self.begin_stop(now, Failure::QUICK_STOPPED) {
            self.wait_for_stop(now, id);
        } else {
            self.await_standstill(now, id);
        }
    }

    fn quick_stop(&mut self, now: Duration, id: CommandId) {
        if let Some(fault) = self.fault() {
            self.done(id, Err(fault));
        } else if self.begin_quick_stop(now) {
            self.wait_for_stop(now, id);
        } else {
            self.await_standstill(now, id);
        }
    }

    fn release(&mut self, now: Duration, id: CommandId) {
        self.stop(now, id);
    }

    /// There is nothing to send: it is done when the axis stands.
    fn await_standstill(&mut self, now: Duration, id: CommandId) {
        if self.is_at_rest_for_good() {
            let state = self.state();
            self.done(id, Ok(Completion::Stopped { state }));
            return;
        }
        if !self.stopping.is_active() {
            self.stopping.stage = self.settling(now);
        }
        self.wait_for_stop(now, id);
    }

    pub(super) fn wait_for_stop(&mut self, now: Duration, id: CommandId) {
        self.stopping
            .set_deadline(now.saturating_add(self.config.deadlines.standstill));
        if !self.stopping.wait(id, Wait::Stop) {
            self.done(id, Err(Failure::Busy));
        }
    }

    /// Bit 8 from the next frame on. Moves that are not sent fail as halted.
    pub(super) fn begin_halt(&mut self, now: Duration) {
        self.cancel_enabling(Failure::HALTED);
        if self.runs_unasked() || (self.power.is_driving() && !self.halts_under_control()) {
            self.begin_quick_stop(now);
            return;
        }
        if !self.power.is_driving() || self.stopping.is_quick() || self.state().is_fault() {
            return;
        }
        self.withdraw_unsent(Failure::HALTED);
        self.fail_resume(Failure::HALTED);
        self.stop_unsent = true;
        self.stopping.lent = false;
        if !self.halted {
            self.halted = true;
            self.halt_delivered = None;
            self.stopping.begin_halt();
            self.stopping.unanswered = self.has_motion() && self.standstill.is_under_way();
            self.stopping.halt_reported = false;
        }
    }

    /// Halt, with the quick stop to follow. False when the axis stands without a set-point: nothing is sent then.
    /// Moves that are not sent fail as `failure`.
    pub(super) fn begin_stop(&mut self, now: Duration, failure: Failure) -> bool {
        self.cancel_enabling(failure);
        if self.runs_unasked() || self.stopping.is_switching_off() {
            return self.begin_quick_stop(now);
        }
        if !self.power.is_driving() || self.state().is_fault() {
            return false;
        }
        let disables = matches!(failure, Failure::Disabled { .. });
        if self.stopping.is_active() {
            if disables && let Stage::Halting { from, .. } = &mut self.stopping.stage {
                *from = None;
            }
            return true;
        }
        let has_motion = self.has_motion();
        self.withdraw_unsent(failure);
        // Nothing starts in its frame, also where there is nothing to stop.
        self.stop_unsent = true;
        if !has_motion && self.is_standing() {
            return false;
        }
        self.fail_resume(failure);
        if !self.halts_under_control() {
            return self.begin_quick_stop(now);
        }
        let rests_perhaps = !has_motion && !disables && !self.halted;
        let from = match self.sample {
            Some(sample) if rests_perhaps && sample.state() == State::OperationEnabled => {
                Some(sample.position)
            }
            _ => None,
        };
        self.begin_halt(now);
        self.stopping.lent = from.is_some();
        let until = now.saturating_add(self.config.deadlines.standstill);
        self.stopping.stage = Stage::Halting { until, from };
        true
    }

    /// Whether bit 8 stops the axis and does not let it coast.
    const fn halts_under_control(&self) -> bool {
        self.config.stop_options.halts_under_control()
    }

    /// Bit 2 low from the next frame on. False when the axis is not enabled: it has nothing to stop.
    pub(super) fn begin_quick_stop(&mut self, now: Duration) -> bool {
        self.cancel_enabling(Failure::QUICK_STOPPED);
        if self.stopping.is_switching_off() {
            return true;
        }
        let enabled = self.power.is_driving() || self.state() == State::OperationEnabled;
        if self.state().is_fault() || !(enabled || self.runs_unasked()) {
            return false;
        }
        if let Power::Disabling { id, .. } = self.power {
            // What it sends would leave the way in which the axis stops to 605Bh.
            self.power = Power::Off;
            self.stopping.off = true;
            self.wait_for_stop(now, id);
        }
        self.withdraw_unsent(Failure::QUICK_STOPPED);
        self.fail_resume(Failure::QUICK_STOPPED);
        if !self.stopping.is_quick() {
            let standstill = self.config.deadlines.standstill;
            self.stopping.begin_quick(now.saturating_add(standstill));
        }
        true
    }

    /// Whether the drive moves, or holds, an axis that we have not enabled: it is stopping by quick stop. It was found so, or
    /// somebody else has enabled it.
    fn runs_unasked(&self) -> bool {
        let powered = matches!(
            self.state(),
            State::OperationEnabled | State::QuickStopActive
        );
        !self.power.is_driving() && (self.stopping.is_quick() || powered && !self.is_standing())
    }

    fn cancel_enabling(&mut self, failure: Failure) {
        if let Power::Enabling { id, .. } = self.power {
            self.power = Power::Off;
            self.stop_unsent = true;
            self.done(id, Err(failure));
        }
    }

    pub(super) fn fault(&self) -> Option<Failure> {
        let sample = self.sample?;
        sample.state().is_fault().then_some(Failure::Fault {
            code: sample.error_code.filter(|&code| code != 0),
        })
    }
}

/// A resume that is not sent yet.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Resuming {
    id: CommandId,
    /// Whether the axis goes on from standstill; none if it was not halted.
    from_rest: Option<bool>,
}

/// Whether the power stage is off in this state.
pub(super) const fn is_down(state: State) -> bool {
    matches!(
        state,
        State::NotReadyToSwitchOn | State::SwitchOnDisabled | State::ReadyToSwitchOn
    )
}
