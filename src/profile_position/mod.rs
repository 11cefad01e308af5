//! Profile Position: set-points, the handshake of bits 4 and 12, halt, outcomes.
//!
//! The types and the sequencing are pure. How a drive differs is data: [`Traits`]. Read `sequencer.rs` first, then `observer.rs`.

mod bounds;
mod circle;
mod ends;
pub(crate) mod events;
mod evidence;
pub(crate) mod failure;
mod handshake;
mod limits;
mod observer;
mod pending;
mod sequencer;
pub(crate) mod set_point;
mod standstill;
#[cfg(test)]
mod tests;
mod traits;

pub(crate) use bounds::Bounds;
use ends::Ends;
pub(crate) use ends::Quiet;
pub(crate) use events::Events;
pub(crate) use events::{CommandId, Completion, Event};
#[cfg(test)]
pub(crate) use evidence::Eyes;
pub(crate) use evidence::{Bit, Cycle, Evidence, Rules, ShownBit};
#[cfg(feature = "std")]
pub(crate) use failure::WHY_MISSED;
pub(crate) use failure::{
    Delivery, Doubt, Failure, Inhibit, ParameterFault, Unrest, Unsupported, WaitingFor,
};
pub use limits::{Limits, LimitsActive, LimitsOff, LimitsRule, MinVelocity, PositionRange};
use observer::{Behind, HeldSetPoint, Known, Observer, OnItsWay};
pub(crate) use sequencer::Sequencer;
pub(crate) use set_point::BufferMode;
pub use set_point::{ContactTorque, MoveCommand, Parameters, Reference, VelocityOverride};
pub(crate) use standstill::{LastSeen, Standstill};
pub use traits::{BufferSignal, HomedSignal, RelativeBase, StartBits, Traits};

#[cfg(feature = "std")]
pub use crate::handle::{
    ByIterator, ByStream, Done, Follow, Followed, MoveRequest, Path, PathError,
};
