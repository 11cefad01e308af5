//! What a cycle brings an axis core, and what is known of the axis after it.

use core::fmt;

use crate::{
    ds402::{Controlword, Mode, State, Statusword, describe_error_code},
    units::{AxisUnit, Counts, Scale},
};

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

/// What is known of an axis after a cycle, with position and velocity in the unit of the handle that it comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(
    feature = "serde",
    serde(bound(serialize = "U::Signed: serde::Serialize"))
)]
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
    /// Following error actual value 60F4h, where the drive sends it. None in what an [`AxisCore`](super::AxisCore) gives itself.
    pub following_error: Option<U::Signed>,
    /// Torque actual value 6077h in thousandths of the rated torque, where the drive sends it; as there.
    pub torque: Option<i16>,
    /// Error code 603Fh, where the drive sends it; as there.
    pub error_code: Option<u16>,
    /// Whether the axis is halted (bit 8).
    pub halted: bool,
    /// Whether the axis has a set-point, or may have one.
    pub has_set_point: bool,
    /// Whether the axis knows where it is: by [`Referencing`](crate::Referencing).
    pub referenced: bool,
    /// Whether an axis with a [`Brake`](super::Brake) has left its position window since its brake was closed and its power gone: the brake
    /// does not hold it. It stays so until the axis has power again.
    pub slipped: bool,
}

impl<U: AxisUnit> Snapshot<U> {
    /// Whether the drive shows a following error: bit 13 of the statusword, in a mode in which it means that.
    #[must_use]
    pub const fn shows_following_error(&self) -> bool {
        self.statusword.shows_following_error(self.mode)
    }
}

impl<U: AxisUnit> fmt::Display for Snapshot<U>
where
    U::Signed: fmt::Display,
{
    /// For example `Fault, following error (statusword 2218h, controlword 000Fh), error code 8611h (following error), at 1200 counts`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.state)?;
        let also = [
            (self.shows_following_error(), "following error"),
            (self.halted, "halted"),
            (self.lost, "lost"),
            (self.slipped, "slipped on its brake"),
        ];
        for (_, what) in also.into_iter().filter(|(is_so, _)| *is_so) {
            write!(f, ", {what}")?;
        }
        let Self {
            statusword,
            controlword,
            position,
            ..
        } = self;
        write!(f, " (statusword {statusword}, controlword {controlword})")?;
        if let Some(code) = self.error_code.filter(|&code| code != 0) {
            let text = describe_error_code(code);
            write!(f, ", error code {code:04X}h ({text})")?;
        }
        write!(f, ", at {position} {}", U::NAME)
    }
}

impl Snapshot {
    /// The same with position and velocity in another unit.
    #[must_use]
    pub fn in_unit<U: AxisUnit>(&self, scale: &Scale) -> Snapshot<U> {
        Snapshot {
            position: scale.position_in::<U>(self.position),
            velocity: scale.velocity_in::<U>(self.velocity),
            following_error: self
                .following_error
                .map(|error| scale.position_in::<U>(error)),
            torque: self.torque,
            error_code: self.error_code,
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
            slipped: self.slipped,
        }
    }
}

/// What is new since the axis' port looked last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SnapshotChange {
    /// The cycle's number alone.
    Nothing,
    /// Position and velocity.
    Motion,
    /// That there were no inputs.
    Silence,
    Anything,
}

impl SnapshotChange {
    /// This and what a later cycle has brought.
    #[inline]
    pub const fn and(self, new: Self) -> Self {
        match (self, new) {
            (Self::Nothing, new) => new,
            (old, Self::Nothing) => old,
            (Self::Motion, Self::Motion) => Self::Motion,
            (Self::Silence, Self::Silence) => Self::Silence,
            _ => Self::Anything,
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
