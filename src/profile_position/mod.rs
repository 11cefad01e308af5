//! Profile Position: set-points, the handshake of bits 4 and 12, halt, outcomes.
//!
//! The types and the sequencing are pure. How a drive differs is data: [`Traits`].

mod chain;
mod circle;
mod limits;
mod outcome;
mod sequencer;
mod set_point;
mod standstill;
mod track;
mod traits;

pub use limits::{Limits, LimitsActive, LimitsOff, LimitsRule, PositionRange};
pub(crate) use outcome::Events;
pub use outcome::{
    CommandId, Completion, Delivery, Event, Failure, Unrest, WaitingFor, WorkingCounter,
};
pub(crate) use sequencer::Sequencer;
pub use set_point::{BufferMode, MoveCommand, Parameters, Reference, SetPoint};
pub(crate) use standstill::{Bounds, LastSeen, ShownFor, Standstill};
pub use traits::{BufferSignal, HomedSignal, RelativeBase, StartBits, Traits};
pub(crate) use traits::{Cycle, no_older};

#[cfg(feature = "std")]
pub use crate::handle::{
    ByIterator, ByStream, Done, Follow, Followed, Move, MoveRequest, Outcome, Path, PathError,
    ProfilePosition,
};
