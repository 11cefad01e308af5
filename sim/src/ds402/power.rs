//! The device state machine: transitions 0 to 16 of DS402, their option codes, faults, and the lost connection.

use super::axis::Axis;
use super::emergency::{self, Emergency};
use super::ledger::Cause;
use super::objects::{self, Address};
use super::state::{Command, State};
use super::trajectory::Shape;

/// Emergencies that wait at most; a drive's queue is short, and nobody may read it.
const EMERGENCIES_KEPT: usize = 16;

/// The present fault.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Fault {
    /// 603Fh; 0 without a fault.
    pub(super) code: u16,
    /// What caused it is still there: a reset has no effect.
    pub(super) cause_persists: bool,
}

/// The ramps to which option codes refer.
#[derive(Debug, Clone, Copy)]
pub(super) enum Ramp {
    /// No torque: the axis coasts.
    Coast,
    /// 6084h.
    SlowDown,
    /// 6085h.
    QuickStop,
    /// As hard as current or voltage allow.
    Limit,
}

impl Axis {
    /// A fault whose cause is gone at once, so that a reset clears it. The code goes to 603Fh.
    pub fn inject_fault(&mut self, code: u16) {
        self.raise_fault(code);
    }

    /// A fault that no reset clears until [`Axis::clear_cause`].
    pub fn inject_lasting_fault(&mut self, code: u16) {
        self.raise_fault(code);
        self.fault.cause_persists = true;
    }

    /// Takes away the cause of a lasting fault.
    pub fn clear_cause(&mut self) {
        self.fault.cause_persists = false;
    }

    /// The connection is gone (OP left, or the process-data watchdog expired): does what 6007h says, once. The
    /// controlword keeps its last value; whoever owns the process image may write another.
    pub fn connection_lost(&mut self) {
        if !core::mem::replace(&mut self.connected, false) {
            return;
        }
        match self.objects.value(objects::ABORT_CONNECTION_OPTION) {
            1 if self.state.is_powered() => self.raise_fault(emergency::CONNECTION_LOST),
            2 if self.state.is_powered() && self.state != State::FaultReactionActive => {
                self.cut_power(State::SwitchOnDisabled);
            }
            3 if self.state == State::OperationEnabled => self.begin_quick_stop(),
            _ => {}
        }
    }

    /// The connection is back. Nothing moves and nothing is enabled by that.
    pub fn connection_restored(&mut self) {
        self.connected = true;
    }

    pub(super) fn run_state_machine(&mut self, controlword: u16) {
        self.cycles_in_state = self.cycles_in_state.saturating_add(1);
        self.brake.is_asked = false;
        if self.state.is_powered() && !self.voltage && self.state != State::FaultReactionActive {
            self.raise_fault(emergency::UNDER_VOLTAGE);
            return;
        }
        if self.inhibited && self.state.is_powered() && self.state != State::FaultReactionActive {
            self.cut_power(State::SwitchOnDisabled);
            return;
        }
        match self.state {
            State::NotReadyToSwitchOn => {
                if self.cycles_in_state > self.behaviour.start_up_cycles {
                    self.enter(State::SwitchOnDisabled);
                }
            }
            State::FaultReactionActive => {
                // One cycle at least, so that it can be seen.
                let seen = self.cycles_in_state > 1;
                let free = self.option(objects::FAULT_REACTION_OPTION) == 0;
                if seen && (free || self.has_stopped()) {
                    self.cut_power(State::Fault);
                }
            }
            State::Fault => self.look_for_reset(controlword),
            State::QuickStopActive if self.quick_stop_leads_out() && self.cycles_in_state > 1 => {
                self.cut_power(State::SwitchOnDisabled);
            }
            _ => self.obey(controlword),
        }
    }

    fn obey(&mut self, controlword: u16) {
        let command = Command::decode(controlword, self.behaviour.bit_7_irrelevant);
        let Some(command) = command.filter(|_| self.remote) else {
            self.finish_leaving();
            return;
        };
        match (self.state, command) {
            (State::SwitchOnDisabled, Command::Shutdown)
                if self.voltage || !self.behaviour.ready_needs_voltage =>
            {
                self.enter(State::ReadyToSwitchOn);
            }
            (State::ReadyToSwitchOn, Command::SwitchOn) => self.switch_on(),
            (State::ReadyToSwitchOn, Command::EnableOperation) if self.behaviour.auto_3_4 => {
                self.switch_on();
            }
            (
                State::ReadyToSwitchOn | State::SwitchedOn,
                Command::DisableVoltage | Command::QuickStop,
            )
            | (State::OperationEnabled | State::QuickStopActive, Command::DisableVoltage) => {
                self.cut_power(State::SwitchOnDisabled);
            }
            (State::SwitchedOn, Command::Shutdown) => self.cut_power(State::ReadyToSwitchOn),
            (State::SwitchedOn, Command::EnableOperation)
                if self.cycles_in_state > self.behaviour.power_on_cycles
                    && self.has_released_brake() =>
            {
                self.enter_operation();
            }
            // One command is completed before the next is evaluated (DSP 402, notes on the transitions).
            (State::OperationEnabled, _) if self.leaving_to.is_some() => self.finish_leaving(),
            (State::OperationEnabled, Command::QuickStop)
                if !self.disturbances.deaf_to_quick_stop =>
            {
                self.begin_quick_stop();
            }
            (State::OperationEnabled, Command::Shutdown) => {
                self.leave_operation(State::ReadyToSwitchOn, objects::SHUTDOWN_OPTION);
            }
            (State::OperationEnabled, Command::SwitchOn) => {
                self.leave_operation(State::SwitchedOn, objects::DISABLE_OPERATION_OPTION);
            }
            (State::QuickStopActive, Command::EnableOperation)
                if self.behaviour.transition_16 && self.has_stopped() && self.connected =>
            {
                self.enter_operation();
            }
            _ => {}
        }
    }

    fn switch_on(&mut self) {
        if self.voltage && !self.inhibited {
            self.enter(State::SwitchedOn);
        }
    }

    fn enter_operation(&mut self) {
        // An axis that still coasts is caught.
        self.stop_on(Ramp::SlowDown);
        self.buffer.enabled(self.behaviour.ack);
        self.enter(State::OperationEnabled);
    }

    /// Transitions 5 and 8: with option code 1 after the ramp, with 0 at once.
    fn leave_operation(&mut self, to: State, option: Address) {
        self.discard_motion(Cause::Disabled);
        if self.option(option) == 0 {
            self.cut_power(to);
        } else {
            self.stop_on(Ramp::SlowDown);
            self.leaving_to = Some(to);
            self.finish_leaving();
        }
    }

    fn finish_leaving(&mut self) {
        if let Some(to) = self.leaving_to.filter(|_| self.has_stopped()) {
            self.cut_power(to);
        }
    }

    /// Transition 11.
    fn begin_quick_stop(&mut self) {
        self.discard_motion(Cause::QuickStop);
        self.stop_on(match self.option(objects::QUICK_STOP_OPTION) {
            0 => Ramp::Coast,
            1 | 5 => Ramp::SlowDown,
            2 | 6 => Ramp::QuickStop,
            _ => Ramp::Limit,
        });
        self.enter(State::QuickStopActive);
    }

    /// Transition 12 without a command: 605Ah 0 at once, 1 to 4 when the axis stands, 5 to 8 never.
    fn quick_stop_leads_out(&self) -> bool {
        match self.option(objects::QUICK_STOP_OPTION) {
            0 => true,
            1..=4 => self.has_stopped(),
            _ => false,
        }
    }

    /// Transition 13, and a further fault during or after it.
    pub(crate) fn raise_fault(&mut self, code: u16) {
        self.fault.code = code;
        self.objects.put(objects::ERROR_CODE, code.into());
        self.send_emergency(code);
        if matches!(self.state, State::FaultReactionActive | State::Fault) {
            return;
        }
        self.discard_motion(Cause::Fault);
        if self.state.is_powered() {
            self.stop_on(match self.option(objects::FAULT_REACTION_OPTION) {
                0 => Ramp::Coast,
                1 => Ramp::SlowDown,
                2 => Ramp::QuickStop,
                _ => Ramp::Limit,
            });
        }
        self.enter(State::FaultReactionActive);
    }

    /// Transition 15: only a rising edge of bit 7, only in Fault, only if the cause is gone.
    fn look_for_reset(&mut self, controlword: u16) {
        let edge = controlword & !self.last_controlword & 0x0080 != 0;
        let cause_persists = self.fault.cause_persists
            || (self.fault.code == emergency::CONNECTION_LOST && !self.connected)
            || (self.fault.code == emergency::UNDER_VOLTAGE && !self.voltage);
        if edge && self.remote && !cause_persists {
            self.fault = Fault::default();
            self.reached.forget_following_error();
            self.objects.put(objects::ERROR_CODE, 0);
            self.send_emergency(0);
            self.enter(State::SwitchOnDisabled);
        }
    }

    fn send_emergency(&mut self, code: u16) {
        if self.emergencies.len() == EMERGENCIES_KEPT {
            self.emergencies.pop_front();
        }
        let register = emergency::register_of(code);
        self.emergencies.push_back(Emergency {
            code,
            register,
            data: [0; 5],
        });
    }

    /// Ends the control of the axis: it coasts from whatever it does, and its set-points are gone.
    fn cut_power(&mut self, to: State) {
        self.discard_motion(Cause::Disabled);
        let demand = self.trajectory.counts();
        if !self.behaviour.plant.is_rigid() {
            // The shaft coasts from where it is, not from where it should be.
            let (position, velocity) = (self.shaft.position, self.shaft.velocity);
            self.trajectory.catch(position, velocity);
            self.shaft.caught();
            self.lagging.clear();
        } else if self.disturbances.blocked || self.within_ends(demand) != demand {
            self.trajectory.place(self.shaft.counts);
            self.lagging.clear();
        }
        self.stop_on(Ramp::Coast);
        self.enter(to);
    }

    /// Whether a ramp has ended. A rigid shaft stands with its demand, however late it shows that.
    fn has_stopped(&self) -> bool {
        self.trajectory.stands() && (self.behaviour.plant.is_rigid() || self.shaft.is_slow())
    }

    fn enter(&mut self, state: State) {
        self.state = state;
        self.cycles_in_state = 0;
        self.leaving_to = None;
    }

    /// Halt by 605Dh. Its 0 (free-wheel) is of DSP 402 v2; the state stays.
    pub(super) fn begin_halt(&mut self) {
        self.stop_on(match self.option(objects::HALT_OPTION) {
            0 => Ramp::Coast,
            1 => Ramp::SlowDown,
            2 => Ramp::QuickStop,
            _ => Ramp::Limit,
        });
    }

    /// A stop for which no option code exists: mode change, and the end of a trajectory that passed its last target.
    pub(super) fn slow_down(&mut self) {
        self.stop_on(Ramp::SlowDown);
    }

    pub(super) fn stop_on(&mut self, ramp: Ramp) {
        let limit = f64::from(self.behaviour.limit_deceleration);
        let or_limit = |rate: f64| if rate > 0.0 { rate } else { limit };
        let rate = match ramp {
            Ramp::Coast => f64::from(self.behaviour.coast_deceleration),
            Ramp::SlowDown => or_limit(self.deceleration()),
            Ramp::QuickStop => {
                or_limit(self.objects.acceleration(objects::QUICK_STOP_DECELERATION))
            }
            Ramp::Limit => limit,
        };
        let shape = match ramp {
            Ramp::SlowDown => self.shape(),
            Ramp::Coast | Ramp::QuickStop | Ramp::Limit => Shape::Linear,
        };
        self.trajectory.stop(rate, shape);
    }

    fn option(&self, address: Address) -> i64 {
        self.objects.value(address)
    }
}
