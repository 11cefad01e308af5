//! The power side of an axis: which state it is led to, and who waits for that.

use core::time::Duration;

use crate::{
    Failure,
    ds402::{PowerCommand, PowerGoal, State, Statusword, next_command},
    profile_position::{CommandId, Completion, Delivery, Inhibit, WaitingFor},
    timer::{Due, Timer},
};

use super::{brake::HoldingBrake, machines::Step};

/// Edges of bit 7 that one reset sends at most.
const RESET_EDGES: u8 = 3;

/// How long bit 7 stays low between two edges: some drives stop answering when it toggles faster than about ten times a
/// second (seen in a public master for real drives).
const RESET_PAUSE: Duration = Duration::from_millis(100);

/// Where the axis is led to.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) enum Power {
    /// Voltage disabled.
    Off,
    /// Shut down to Ready to switch on, where it was enabled before.
    Ready,
    /// On the way down, somebody waits.
    Disabling {
        id: CommandId,
        goal: PowerGoal,
        left: Timer,
    },
    /// On the way to Operation enabled. What somebody else has enabled is led down before (`was_down`).
    Enabling {
        id: CommandId,
        left: Timer,
        was_down: bool,
    },
    /// In Operation enabled, by our command.
    Enabled,
    /// In Quick stop active, standing.
    Holding,
    Resetting {
        id: CommandId,
        reset: Reset,
        /// Edges of bit 7 that were sent.
        edges: u8,
    },
}

/// Where bit 7 is, in a reset.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) enum Reset {
    /// Low at least for `pause`, until the axis stands in Fault, for which there is a deadline.
    Low { pause: Timer, left: Timer },
    /// High for so long, or until the fault is gone.
    High { left: Timer },
    /// Low, and no fault is shown any more: so long the drive may take to Switch on disabled.
    Gone { left: Timer },
}

/// What comes of a cycle.
#[derive(Clone, Copy)]
pub(super) enum PowerStep {
    Nothing,
    /// A command has ended.
    Done(CommandId, Result<Completion, Failure>),
    /// One that was to be disabled at rest moves: it is stopped before.
    StopFirst(CommandId),
    /// The drive has left Operation enabled by itself.
    Dropped,
}

impl Power {
    /// Whether the drive follows, or may follow, set-points of ours.
    pub const fn is_driving(&self) -> bool {
        matches!(self, Self::Enabled)
    }

    /// Whether the drive is led, or stays led, to Operation enabled.
    pub const fn leads_up(&self) -> bool {
        matches!(self, Self::Enabled | Self::Enabling { was_down: true, .. })
    }

    pub const fn is_resetting(&self) -> bool {
        matches!(self, Self::Resetting { .. })
    }

    /// Whether this command of it takes, or may take, the axis' power.
    pub const fn leads_down(&self, command: PowerCommand) -> bool {
        match command {
            PowerCommand::DisableVoltage => true,
            PowerCommand::Shutdown | PowerCommand::SwitchOn => !self.leads_up(),
            PowerCommand::EnableOperation | PowerCommand::QuickStop | PowerCommand::FaultReset => {
                false
            }
        }
    }

    /// The command that leads on from this state.
    pub fn command(&self, state: State, lacks_voltage: bool) -> PowerCommand {
        match self {
            Self::Off => PowerCommand::DisableVoltage,
            Self::Ready => next_command(state, PowerGoal::Ready),
            Self::Disabling { goal, .. } => next_command(state, *goal),
            Self::Enabling {
                was_down: false, ..
            } => PowerCommand::DisableVoltage,
            Self::Enabling { .. } if state == State::ReadyToSwitchOn && lacks_voltage => {
                PowerCommand::Shutdown
            }
            Self::Enabling { .. } => next_command(state, PowerGoal::Enabled),
            Self::Enabled => PowerCommand::EnableOperation,
            Self::Holding => PowerCommand::QuickStop,
            Self::Resetting {
                reset: Reset::High { .. },
                ..
            } => PowerCommand::FaultReset,
            Self::Resetting { .. } => PowerCommand::DisableVoltage,
        }
    }

    /// Ends what somebody waits for, with the voltage disabled; says who waited.
    pub const fn take_waiter(&mut self) -> Option<CommandId> {
        match *self {
            Self::Disabling { id, .. } | Self::Enabling { id, .. } | Self::Resetting { id, .. } => {
                *self = Self::Off;
                Some(id)
            }
            Self::Off | Self::Ready | Self::Enabled | Self::Holding => None,
        }
    }

    /// One cycle with inputs.
    pub fn step(&mut self, step: &Step<'_>, brake: &HoldingBrake) -> PowerStep {
        let state = step.state;
        match self {
            Self::Off => {}
            Self::Holding if is_down(state) => *self = Self::Off,
            Self::Ready if state == State::SwitchOnDisabled => *self = Self::Off,
            Self::Holding | Self::Ready => {}
            Self::Enabled => {
                if state != State::OperationEnabled && !state.is_fault() {
                    return PowerStep::Dropped;
                }
            }
            Self::Disabling { id, left, .. } => {
                left.pass(step.elapsed);
                let id = *id;
                if state == State::OperationEnabled && !step.stands() {
                    *self = Self::Off;
                    return PowerStep::StopFirst(id);
                }
                if is_down(state) && step.is_at_rest() {
                    *self = if state == State::ReadyToSwitchOn {
                        Self::Ready
                    } else {
                        Self::Off
                    };
                    return PowerStep::Done(id, Ok(Completion::Stopped { state }));
                }
                if left.is_over() {
                    *self = Self::Off;
                    let waiting_for = WaitingFor::State(State::SwitchOnDisabled);
                    return PowerStep::Done(id, Err(step.timeout(waiting_for, Delivery::NotSent)));
                }
            }
            Self::Enabling { id, left, was_down } => {
                left.pass(step.elapsed);
                let id = *id;
                if state == State::OperationEnabled && *was_down && step.sends_enable() {
                    if step.delivered {
                        let (next, result) = match brake.released() {
                            None => return PowerStep::Nothing,
                            Some(Ok(())) => (Self::Enabled, Ok(Completion::Done)),
                            Some(Err(failure)) => (Self::Off, Err(failure)),
                        };
                        *self = next;
                        return PowerStep::Done(id, result);
                    }
                } else if state == State::OperationEnabled {
                    // Somebody else has enabled it: it may hold a set-point.
                    *was_down = false;
                }
                if left.is_over() {
                    *self = Self::Off;
                    return PowerStep::Done(id, Err(why_not_enabled(step)));
                }
                *was_down |= step.is_down_at_rest();
            }
            Self::Resetting { id, reset, edges } => {
                let id = *id;
                if let Some(result) = reset.step(edges, step) {
                    *self = Self::Off;
                    return PowerStep::Done(id, result);
                }
            }
        }
        PowerStep::Nothing
    }

    /// When it has something to do without a word of the drive.
    pub const fn due(&self) -> Due {
        match self {
            Self::Off | Self::Ready | Self::Enabled | Self::Holding => Due::NEVER,
            Self::Disabling { .. } | Self::Enabling { .. } | Self::Resetting { .. } => Due::NEXT,
        }
    }
}

impl Reset {
    /// A reset begins.
    pub const fn new(left: Timer) -> Self {
        Self::Low {
            pause: Timer::OVER,
            left,
        }
    }

    /// One cycle; the result, once there is one.
    fn step(&mut self, edges: &mut u8, step: &Step<'_>) -> Option<Result<Completion, Failure>> {
        let (state, deadlines) = (step.state, &step.config.deadlines);
        match self {
            Self::Low { pause, left } => {
                pause.pass(step.elapsed);
                left.pass(step.elapsed);
                let is_low = step.delivered && !step.sends_reset();
                if !state.is_fault() {
                    *self = Self::gone(deadlines.standstill);
                } else if state == State::Fault && step.stands() && is_low && pause.is_over() {
                    *edges += 1;
                    *self = Self::High {
                        left: Timer::new(deadlines.fault_reset),
                    };
                } else if left.is_over() {
                    let waiting_for = if state == State::Fault {
                        step.standstill()
                    } else {
                        WaitingFor::State(State::Fault)
                    };
                    return Some(Err(step.timeout(waiting_for, Delivery::NotSent)));
                }
            }
            Self::High { left } => {
                left.pass(step.elapsed);
                if !state.is_fault() {
                    *self = Self::gone(deadlines.standstill);
                } else if left.is_over() || !(state == State::Fault || step.stands()) {
                    return self.again(*edges, step);
                }
            }
            Self::Gone { left } => {
                left.pass(step.elapsed);
                if state.is_fault() {
                    return self.again(*edges, step);
                }
                if is_down(state) {
                    return Some(Ok(Completion::Stopped { state }));
                }
                if left.is_over() {
                    let waiting_for = WaitingFor::State(State::SwitchOnDisabled);
                    return Some(Err(step.timeout(waiting_for, Delivery::NotSent)));
                }
            }
        }
        None
    }

    const fn gone(standstill: Duration) -> Self {
        Self::Gone {
            left: Timer::new(standstill),
        }
    }

    /// The fault is there still: bit 7 is low for a while, and rises once more, if it may.
    fn again(&mut self, edges: u8, step: &Step<'_>) -> Option<Result<Completion, Failure>> {
        if edges >= RESET_EDGES {
            return Some(Err(step.fault()));
        }
        *self = Self::Low {
            pause: Timer::new(RESET_PAUSE),
            left: Timer::new(step.config.deadlines.standstill),
        };
        None
    }
}

fn why_not_enabled(step: &Step<'_>) -> Failure {
    let (statusword, controlword) = (step.statusword, step.sent.word.word());
    let by = if !statusword.contains(Statusword::REMOTE) {
        Inhibit::LocalControl
    } else if step.lacks_voltage() {
        Inhibit::NoVoltage
    } else if matches!(step.state, State::SwitchOnDisabled | State::ReadyToSwitchOn) {
        Inhibit::Unnamed
    } else {
        let waiting_for = WaitingFor::State(State::OperationEnabled);
        return step.timeout(waiting_for, Delivery::NotSent);
    };
    Failure::EnableRefused {
        by,
        state: step.state,
        statusword,
        controlword,
    }
}

/// Whether the power stage is off in this state.
pub(super) const fn is_down(state: State) -> bool {
    matches!(
        state,
        State::NotReadyToSwitchOn | State::SwitchOnDisabled | State::ReadyToSwitchOn
    )
}
