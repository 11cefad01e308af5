//! One axis: the pure core. The handles are in `src/handle/`, and this module re-exports those of the axis itself.
//!
//! The core joins power sequencing, stopping, the active mode and the one composer of controlwords. It is stepped once a cycle, either by
//! the bus thread of a `Network` or by a program with a cyclic exchange of its own. Read `core.rs` first, then `machines.rs`.

mod brake;
mod command;
mod commands;
mod config;
mod core;
mod deceleration;
mod fields;
mod machines;
mod mode;
mod observed;
mod outputs;
mod power;
mod snapshot;
mod stopping;
#[cfg(test)]
mod tests;

pub use self::core::AxisCore;
pub use crate::profile_position::{
    CommandId, Completion, Delivery, Doubt, Event, Failure, FailureClass, Inhibit, ParameterFault,
    Unrest, Unsupported, WaitingFor, WorkingCounter,
};
pub use command::{Command, StopRequest};
pub use config::{CoreConfig, Deadlines, DriveSettings, Loss, Referencing, Tolerances};
pub use fields::{AxisFields, FieldError};
pub use snapshot::{Inputs, Snapshot};

#[cfg(feature = "std")]
pub(crate) use self::core::Reattach;
#[cfg(feature = "std")]
pub(crate) use fields::TARGET_VELOCITY;
#[cfg(feature = "std")]
pub(crate) use outputs::CommandedMode;
#[cfg(feature = "std")]
pub(crate) use snapshot::SnapshotChange;

#[cfg(feature = "std")]
pub use crate::handle::{
    Axis, AxisError, AxisErrorKind, AxisIdentity, AxisPort, AxisSet, AxisSetup, AxisSource,
    AxisStatistics, BoxFuture, Field, GroupQueue, Groups, Liveness, LivenessWatch, MotionEnd,
    NoParameters, OutputField, ParameterAccess, Sampled, Stale, StartTogether, StopHandle,
    start_together,
};
