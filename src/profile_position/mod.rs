//! Profile Position: set-points, the handshake of bits 4 and 12, halt, outcomes.
//!
//! The types and the sequencing are pure. How a drive differs is data: [`Traits`].

mod set_point;
mod traits;

pub use set_point::{MoveCommand, Parameters, Reference, SetPoint, Start};
pub use traits::{BufferSignal, RelativeBase, StartBits, Traits};
