//! One axis: the pure core, and the handle that users hold.
//!
//! The core joins power sequencing, the active mode and the one composer of controlwords. It is stepped once a cycle,
//! either by the bus thread of a `Network` or by a program with a cyclic exchange of its own.

mod command;
mod config;
mod core;
mod fields;
mod observe;
mod power;
mod snapshot;
mod stopping;
mod submit;

pub use self::core::AxisCore;
pub use crate::profile_position::{CommandId, Completion, Delivery, Event, Failure, WaitingFor};
pub use command::{Command, Inputs, StopRequest};
pub use config::{AxisConfig, Deadlines, Loss, Tolerances};
pub use fields::{AxisFields, FieldError};
pub use snapshot::Snapshot;
