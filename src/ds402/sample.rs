//! What one cycle's inputs show of an axis.

use super::{Mode, State, Statusword};

/// What one cycle's inputs show of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Sample {
    /// Statusword 6041h.
    pub statusword: Statusword,
    /// Modes of operation display 6061h; [`Mode::None`] where it is not known.
    pub mode: Mode,
    /// Position actual value 6064h, position units.
    pub position: i32,
    /// Velocity actual value 606Ch, velocity units, where it is mapped.
    pub velocity: Option<i32>,
    /// Error code 603Fh, where it is mapped.
    pub error_code: Option<u16>,
}

impl Sample {
    /// The state that the statusword shows.
    #[must_use]
    #[inline(always)]
    pub const fn state(&self) -> State {
        self.statusword.state()
    }
}
