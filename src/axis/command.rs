//! What the axis core takes in: commands, stops, and what came back from the wire.

use bitflags::bitflags;

use crate::{
    ds402::{Controlword, Mode, State, Statusword},
    homing::HomingCommand,
    profile_position::{Limits, MoveCommand},
    profile_velocity::JogSetPoint,
    units::{AxisUnit, Counts, Scale},
};

/// A command to an axis. Each gives exactly one last event ([`Event::Done`](super::Event::Done)).
///
/// ```
/// use core::time::Duration;
/// use servocrab::axis::{AxisCore, AxisFields, Command, CommandId, CoreConfig, Event};
/// let mut axis = AxisCore::new(CoreConfig::new(AxisFields::at(0, 0)));
/// // An axis that is not enabled refuses a halt, at once.
/// axis.submit(Duration::ZERO, CommandId(7), Command::Halt, &mut [0; 6]);
/// assert!(matches!(axis.poll_event(), Some((CommandId(7), Event::Done(Err(_))))));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Command {
    /// To Operation enabled, from every state but Fault.
    Enable,
    /// To Ready to switch on or below; a moving or halted axis is stopped by quick stop before.
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
    /// A move in Profile Position mode.
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
    /// Bit 8: pause, keeping the set-point.
    Halt,
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
    /// Whether it enables, starts or resumes, or asks whether that would be refused.
    pub(super) const fn sets_going(&self) -> bool {
        match self {
            Self::Enable
            | Self::Resume
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
        /// Pause (bit 8).
        const HALT = 1;
        /// Halt, then abandon the set-point by quick stop.
        const STOP = 2;
        /// Quick stop (bit 2).
        const QUICK_STOP = 4;
    }
}

/// What one cycle's exchange brought for an axis.
///
/// ```
/// use servocrab::axis::Inputs;
/// // The drive's bytes, where its datagram came back; the frame itself is lost in the second cycle.
/// let process_data = [0x37, 0x02, 0x10, 0x27, 0, 0];
/// let cycles = [Inputs::Fresh(&process_data), Inputs::Stale];
/// # assert_ne!(cycles[0], cycles[1]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Inputs<'a> {
    /// The working counter was right: these inputs are of this cycle and the outputs were delivered.
    Fresh(&'a [u8]),
    /// The drive answered, but the working counter was wrong: fresh inputs, outputs perhaps not delivered.
    Answered(&'a [u8]),
    /// Nothing came back from the drive.
    Stale,
}

impl<'a> Inputs<'a> {
    /// Decides by the working counter of their datagram what inputs are worth.
    ///
    /// ```
    /// use servocrab::axis::Inputs;
    /// assert_eq!(Inputs::from_wkc(3, 3, &[0x31]), Inputs::Fresh(&[0x31]));
    /// assert_eq!(Inputs::from_wkc(2, 3, &[0x31]), Inputs::Stale);
    /// ```
    #[must_use]
    pub const fn from_wkc(working_counter: u16, expected: u16, inputs: &'a [u8]) -> Self {
        if working_counter == expected {
            Self::Fresh(inputs)
        } else {
            Self::Stale
        }
    }
}

// What is known of an axis after a cycle.

/// What is known of an axis after a cycle, with position and velocity in the unit of the handle that it comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(
    feature = "serde",
    serde(bound(serialize = "U::Signed: serde::Serialize"))
)]
#[non_exhaustive]
pub struct Snapshot<U: AxisUnit = Counts> {
    /// How many cycles there were since the first one, with and without inputs.
    pub cycle: u64,
    /// Consecutive cycles that brought no inputs; 0 when the other fields are of this cycle.
    pub age: u32,
    /// Whether the drive answered in this cycle.
    pub answered: bool,
    /// Whether the drive counts as lost.
    pub lost: bool,
    /// Statusword 6041h.
    pub statusword: Statusword,
    /// The state it shows.
    pub state: State,
    /// The controlword 6040h in the outputs now.
    pub controlword: Controlword,
    /// Modes of operation display 6061h; [`Mode::None`] while not known.
    pub mode: Mode,
    /// Position actual value 6064h.
    pub position: U::Signed,
    /// Velocity actual value 606Ch; 0 where it is not mapped.
    pub velocity: U::Signed,
    /// Whether the axis is halted (bit 8).
    pub halted: bool,
    /// Whether the axis has a set-point, or may have one.
    pub has_set_point: bool,
    /// Whether the axis knows where it is: by [`Referencing`](super::Referencing).
    pub referenced: bool,
}

impl Snapshot {
    /// The same with position and velocity in another unit.
    #[must_use]
    pub fn in_unit<U: AxisUnit>(&self, scale: &Scale) -> Snapshot<U> {
        Snapshot {
            position: scale.position_in::<U>(self.position),
            velocity: scale.velocity_in::<U>(self.velocity),
            cycle: self.cycle,
            age: self.age,
            answered: self.answered,
            lost: self.lost,
            statusword: self.statusword,
            state: self.state,
            controlword: self.controlword,
            mode: self.mode,
            halted: self.halted,
            has_set_point: self.has_set_point,
            referenced: self.referenced,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_count_with_the_expected_working_counter_alone() {
        for (counter, expected) in [(2, 3), (4, 3), (0, 1), (u16::MAX, 0)] {
            assert_eq!(Inputs::from_wkc(counter, expected, &[1]), Inputs::Stale);
        }
        assert_eq!(Inputs::from_wkc(3, 3, &[1]), Inputs::Fresh(&[1]));
        assert_eq!(Inputs::from_wkc(0, 0, &[]), Inputs::Fresh(&[]));
    }
}
