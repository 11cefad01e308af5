//! Profile Position: set-points, the handshake of bits 4 and 12, halt, outcomes.
//!
//! The types and the sequencing are pure. How a drive differs is data: [`Traits`].

mod circle;
mod outcome;
mod sequencer;
mod set_point;
mod standstill;

pub(crate) use outcome::Events;
pub use outcome::{
    CommandId, Completion, Delivery, Event, Failure, Unrest, WaitingFor, WorkingCounter,
};
pub(crate) use sequencer::{Cycle, Sequencer, no_older};
pub use set_point::{
    BufferMode, BufferSignal, HomedSignal, Limits, LimitsActive, LimitsOff, LimitsRule,
    MoveCommand, Parameters, PositionRange, Reference, RelativeBase, SetPoint, StartBits, Traits,
};
pub(crate) use standstill::{Bounds, LastSeen, ShownFor, Standstill, Unanswered};

#[cfg(feature = "std")]
pub use crate::handle::{
    ByIterator, ByStream, Done, Follow, Followed, Move, MoveRequest, Outcome, Path, PathError,
    ProfilePosition,
};
