//! What is known of an axis after a cycle.

use crate::ds402::{Controlword, Mode, State, Statusword};

/// What is known of an axis after a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Snapshot {
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
    /// Position actual value 6064h, position units.
    pub position: i32,
    /// Velocity actual value 606Ch, velocity units; 0 where it is not mapped.
    pub velocity: i32,
    /// Whether the axis is halted (bit 8).
    pub halted: bool,
    /// Whether the axis has a set-point, or may have one.
    pub has_set_point: bool,
    /// Whether the axis knows where it is: by [`Referencing`](super::Referencing).
    pub referenced: bool,
}
