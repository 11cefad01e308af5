//! The power side of an axis: which state it is led to, and who waits for that.

use core::time::Duration;

use crate::{
    ds402::{PowerCommand, PowerGoal, Sample, State, Statusword, next_command},
    profile_position::{CommandId, Traits},
};

/// Edges of bit 7 that one reset sends at most.
pub(super) const RESET_EDGES: u8 = 3;

/// How long bit 7 stays low between two edges: some drives stop answering when it toggles faster than about ten times a
/// second (seen in a public master for real drives).
pub(super) const RESET_PAUSE: Duration = Duration::from_millis(100);

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
        deadline: Duration,
    },
    /// On the way to Operation enabled. What was enabled by somebody else before is left first. `shown`: since when each sample has shown
    /// that state, after it was ordered.
    Enabling {
        id: CommandId,
        deadline: Duration,
        was_down: bool,
        shown: Option<Duration>,
    },
    /// In Operation enabled, by our command.
    Enabled,
    /// In Quick stop active, standing.
    Holding,
    /// Resetting a fault.
    Resetting {
        id: CommandId,
        phase: ResetPhase,
        edges: u8,
    },
}

/// Where bit 7 is.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) enum ResetPhase {
    /// Low at least until then, and until that was delivered, Fault is surely shown and the axis stands, for which there is a
    /// deadline. Since when Fault is shown.
    Low {
        until: Duration,
        reaction: Duration,
        shown: Option<Duration>,
    },
    /// High until then, or until the fault is gone.
    High { until: Duration },
    /// Low, since no fault is shown any more: since when, and until when the drive may take to Switch on disabled.
    Gone { since: Duration, until: Duration },
}

impl Power {
    /// Whether the drive follows, or may follow, set-points of ours.
    pub(super) const fn is_driving(&self) -> bool {
        matches!(self, Self::Enabled)
    }

    /// Whether the bits of the mode go into the controlword.
    pub(super) const fn allows_mode_bits(&self) -> bool {
        matches!(self, Self::Enabled)
    }

    /// Whether the drive is led, or stays led, to Operation enabled.
    pub(super) const fn leads_up(&self) -> bool {
        matches!(self, Self::Enabled | Self::Enabling { was_down: true, .. })
    }

    /// Whether this command of it takes, or may take, the axis' power.
    pub(super) const fn leads_down(&self, command: PowerCommand) -> bool {
        match command {
            PowerCommand::DisableVoltage => true,
            PowerCommand::Shutdown | PowerCommand::SwitchOn => !self.leads_up(),
            PowerCommand::EnableOperation | PowerCommand::QuickStop | PowerCommand::FaultReset => {
                false
            }
        }
    }

    /// The command that leads on from `state`.
    pub(super) fn command(
        &self,
        state: State,
        sample: Option<&Sample>,
        traits: &Traits,
    ) -> PowerCommand {
        match self {
            Self::Off => PowerCommand::DisableVoltage,
            Self::Ready => next_command(state, PowerGoal::Ready),
            Self::Disabling { goal, .. } => next_command(state, *goal),
            Self::Enabling {
                was_down: false, ..
            } => PowerCommand::DisableVoltage,
            Self::Enabling { .. } => {
                let voltage =
                    sample.is_some_and(|s| s.statusword.contains(Statusword::VOLTAGE_ENABLED));
                if state == State::ReadyToSwitchOn && traits.shows_voltage && !voltage {
                    PowerCommand::Shutdown
                } else {
                    next_command(state, PowerGoal::Enabled)
                }
            }
            Self::Enabled => PowerCommand::EnableOperation,
            Self::Holding => PowerCommand::QuickStop,
            Self::Resetting {
                phase: ResetPhase::High { .. },
                ..
            } => PowerCommand::FaultReset,
            Self::Resetting { .. } => PowerCommand::DisableVoltage,
        }
    }

    /// Ends what somebody waits for, with the voltage disabled; says who waited.
    pub(super) fn take_waiter(&mut self) -> Option<CommandId> {
        match *self {
            Self::Disabling { id, .. } | Self::Enabling { id, .. } | Self::Resetting { id, .. } => {
                *self = Self::Off;
                Some(id)
            }
            _ => None,
        }
    }
}
