//! What an axis core is asked for.

use bitflags::bitflags;

use crate::{
    ds402::Mode,
    homing::HomingCommand,
    profile_position::{Limits, MoveCommand, VelocityOverride},
    profile_velocity::JogSetPoint,
};

/// A command to an axis. Each gives exactly one last event ([`Event::Done`](super::Event::Done)).
///
/// ```
/// use core::time::Duration;
/// use servocrab::axis::{AxisCore, AxisFields, Command, CommandId, CoreConfig, Event};
/// let mut axis = AxisCore::new(CoreConfig::new(AxisFields::at(0, 0)));
/// // An axis that is not enabled refuses to resume, at once.
/// axis.submit(Duration::ZERO, CommandId(7), Command::Resume, &mut [0; 6]);
/// assert!(matches!(axis.poll_event(), Some((CommandId(7), Event::Done(Err(_))))));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Command {
    /// To Operation enabled, from every state but Fault.
    Enable,
    /// To Ready to switch on or below; a moving or halted axis is stopped before, by halt and quick stop.
    Disable,
    /// Out of Fault, to Switch on disabled.
    ResetFault,
    /// Modes of operation 6060h, confirmed in 6061h; only while no set-point is active.
    SelectMode(Mode),
    /// As [`SelectMode`](Self::SelectMode), up to where 6060h may be written: for drives that get it by SDO. It ends well as
    /// [`Completion::Prepared`](super::Completion::Prepared).
    PrepareMode(Mode),
    /// A homing in homing mode, with the parameters that the drive holds.
    Home(HomingCommand),
    /// A velocity in Profile Velocity mode, until [`AxisCore::release_jog`](super::AxisCore::release_jog) or a stop.
    Jog(JogSetPoint),
    /// A move in Profile Position mode. An end velocity 6082h that is not in the process data counts as written already.
    Move(MoveCommand),
    /// Says whether such a move would be refused now, and why; nothing is sent. Parameters that are not in the process data
    /// count as written already.
    CheckMove(MoveCommand),
    /// Says whether a homing would be refused now, and why; nothing is sent.
    CheckHome,
    /// Says whether a jog with this velocity would be refused now, and why; nothing is sent.
    CheckJog(i32),
    /// What moves are checked against from now on.
    SetLimits(Limits),
    /// How much faster or slower than asked for moves are from now on, and the one under way where its drive can do that.
    SetOverride(VelocityOverride),
    /// Bit 8: pause, keeping the set-point.
    Halt,
    /// Bit 8, and at standstill a set-point to where the axis stands, then bit 8 low: the kept set-points are gone, and it stays enabled. It
    /// is done when bit 8 was sent low.
    Hold,
    /// Bit 8 low: go on.
    Resume,
    /// Halt, then abandon the set-point by quick stop.
    Stop,
    /// Bit 2 low.
    QuickStop,
    /// Leave the mode: bit 4 low, the set-point abandoned as by `Stop`.
    Release,
}

impl Command {
    /// Whether it stops the axis, or leads it down.
    pub(super) const fn stops(&self) -> bool {
        matches!(
            self,
            Self::Halt | Self::Hold | Self::Stop | Self::Release | Self::QuickStop | Self::Disable
        )
    }

    /// Whether it enables, starts or resumes, or asks whether that would be refused.
    pub(super) const fn sets_going(&self) -> bool {
        match self {
            Self::Enable
            | Self::Resume
            | Self::Hold
            | Self::Home(_)
            | Self::Jog(_)
            | Self::Move(_)
            | Self::CheckMove(_)
            | Self::CheckHome
            | Self::CheckJog(_) => true,
            Self::Disable
            | Self::ResetFault
            | Self::SelectMode(_)
            | Self::PrepareMode(_)
            | Self::SetLimits(_)
            | Self::SetOverride(_)
            | Self::Halt
            | Self::Stop
            | Self::QuickStop
            | Self::Release => false,
        }
    }
}

bitflags! {
    /// Stops asked for outside the command queue: the stop lane.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub struct StopRequest: u8 {
        /// Pause (bit 8); a quick stop where 605Dh is 0.
        const HALT = 1;
        /// Halt, then abandon the set-point by quick stop.
        const STOP = 2;
        /// Quick stop (bit 2).
        const QUICK_STOP = 4;
    }
}
