//! Profile Position: set-points, the handshake of bits 4 and 12, halt, outcomes.
//!
//! The types and the sequencing are pure. How a drive differs is data: [`Traits`].

mod bit4;
mod chain;
mod circle;
mod cycle;
mod events;
mod limits;
mod outcome;
mod sequencer;
mod set_point;
mod standstill;
mod track;
mod traits;
mod waiting;

#[cfg(feature = "std")]
mod by_sdo;
#[cfg(feature = "std")]
mod follow;
#[cfg(feature = "std")]
mod handle;
#[cfg(feature = "std")]
mod motion;

pub(crate) use cycle::Cycle;
pub(crate) use events::Events;
pub use limits::{Limits, LimitsActive, LimitsOff, LimitsRule, PositionRange};
pub use outcome::{
    CommandId, Completion, Delivery, Event, Failure, Unrest, WaitingFor, WorkingCounter,
};
pub(crate) use sequencer::Sequencer;
pub use set_point::{MoveCommand, Parameters, Reference, SetPoint, Start};
pub(crate) use standstill::{Bounds, LastSeen, Standstill};
pub use traits::{BufferSignal, RelativeBase, StartBits, Traits};

#[cfg(feature = "std")]
pub(crate) use by_sdo::{BySdo, WrittenParameters};
#[cfg(feature = "std")]
pub use follow::{ByIterator, ByStream, Follow, Followed, Path, PathError};
#[cfg(feature = "std")]
pub use handle::{MoveRequest, ProfilePosition};
#[cfg(feature = "std")]
pub use motion::{Done, Move, Outcome};
