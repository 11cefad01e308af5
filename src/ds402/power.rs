//! Power sequencing: which command leads from the state just seen towards a goal.

use super::{Controlword, State};

/// Where the power sequencing is to lead.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PowerGoal {
    /// Voltage disabled: Switch on disabled.
    Off,
    /// Ready to switch on, power off; from Operation enabled by shutdown (605Bh).
    Ready,
    /// Operation enabled.
    Enabled,
}

/// A command of bits 0–3 and 7 of the controlword.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PowerCommand {
    /// Bits x x 0 x: transitions 7, 9, 10, 12.
    DisableVoltage,
    /// 06h: transitions 2, 6, 8.
    Shutdown,
    /// 07h: transition 3, or 5 from Operation enabled.
    SwitchOn,
    /// 0Fh: transition 4.
    EnableOperation,
    /// Bit 2 low: transitions 7, 10, 11. Sent with bits 0, 1 and 3 as in Operation enabled (0Bh).
    QuickStop,
    /// Bit 7: transition 15 at its rising edge.
    FaultReset,
}

impl PowerCommand {
    /// The command's bits; no others are set.
    ///
    /// ```
    /// use servocrab::ds402::PowerCommand;
    /// assert_eq!(PowerCommand::QuickStop.controlword().bits(), 0x000B);
    /// ```
    #[must_use]
    pub const fn controlword(self) -> Controlword {
        Controlword::from_bits_retain(match self {
            Self::DisableVoltage => 0x0000,
            Self::Shutdown => 0x0006,
            Self::SwitchOn => 0x0007,
            Self::EnableOperation => 0x000F,
            Self::QuickStop => 0x000B,
            Self::FaultReset => 0x0080,
        })
    }
}

/// The command that leads from `state` one step towards `goal`.
///
/// The step after it is chosen from the next statusword, never sent blindly. Quick stop active is always left by
/// disabling the voltage, since not every drive knows transition 16. Nothing here resets a fault: in Fault the bits stay 0.
#[must_use]
pub const fn next_command(state: State, goal: PowerGoal) -> PowerCommand {
    match (goal, state) {
        (PowerGoal::Enabled, State::OperationEnabled | State::SwitchedOn) => {
            PowerCommand::EnableOperation
        }
        (PowerGoal::Enabled, State::ReadyToSwitchOn) => PowerCommand::SwitchOn,
        (PowerGoal::Enabled, State::SwitchOnDisabled)
        | (
            PowerGoal::Ready,
            State::SwitchOnDisabled
            | State::ReadyToSwitchOn
            | State::SwitchedOn
            | State::OperationEnabled,
        ) => PowerCommand::Shutdown,
        (PowerGoal::Off, _)
        | (
            _,
            State::NotReadyToSwitchOn
            | State::QuickStopActive
            | State::FaultReactionActive
            | State::Fault
            | State::Unknown,
        ) => PowerCommand::DisableVoltage,
    }
}
