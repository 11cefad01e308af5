//! One axis: the pure core. The handles are in `src/handle/`, and this module re-exports those of the axis itself.
//!
//! The core joins power sequencing, the active mode and the one composer of controlwords. It is stepped once a cycle,
//! either by the bus thread of a `Network` or by a program with a cyclic exchange of its own.

mod config;
mod core;
mod power;
mod stopping;
#[cfg(test)]
mod tests;

pub use self::core::AxisCore;
pub use self::core::{AxisFields, Command, FieldError, Inputs, Snapshot, StopRequest};
pub use crate::profile_position::{
    CommandId, Completion, Delivery, Event, Failure, Unrest, WaitingFor, WorkingCounter,
};
pub use config::DriveSettings;
pub use config::Referencing;
pub use config::{CoreConfig, Deadlines, Loss, Tolerances};

#[cfg(feature = "std")]
pub(crate) use self::core::CommandedMode;
#[cfg(feature = "std")]
pub(crate) use self::core::{Reattach, SnapshotChange, TARGET_VELOCITY};
#[cfg(feature = "std")]
pub use crate::handle::{
    Axis, AxisError, AxisErrorKind, AxisIdentity, AxisPort, AxisSet, AxisSetup, AxisSource,
    AxisStatistics, BoxFuture, Field, GroupQueue, Groups, Liveness, LivenessWatch, MotionEnd,
    NoParameters, OutputField, ParameterAccess, StartTogether, StopHandle, start_together,
};
