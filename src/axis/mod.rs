//! One axis: the pure core, and the handle that users hold.
//!
//! The core joins power sequencing, the active mode and the one composer of controlwords. It is stepped once a cycle,
//! either by the bus thread of a `Network` or by a program with a cyclic exchange of its own.

mod brake;
mod calm;
mod check;
#[cfg(feature = "std")]
mod claim;
mod command;
mod config;
mod core;
mod fields;
mod intake;
mod let_go;
mod modes;
#[cfg(test)]
mod modes_tests;
mod observe;
mod power;
mod referencing;
mod slowing;
mod snapshot;
mod stopping;
mod submit;

#[cfg(feature = "std")]
mod error;
#[cfg(feature = "std")]
mod field;
#[cfg(feature = "std")]
mod handle;
#[cfg(feature = "std")]
mod last_stop;
#[cfg(feature = "std")]
mod liveness;
#[cfg(feature = "std")]
mod output_cells;
#[cfg(feature = "std")]
mod pending;
#[cfg(feature = "std")]
mod port;
#[cfg(feature = "std")]
mod reading;
#[cfg(feature = "std")]
mod restart;
#[cfg(feature = "std")]
mod select;
#[cfg(feature = "std")]
mod settings;
#[cfg(feature = "std")]
mod setup;
#[cfg(feature = "std")]
mod shared;
#[cfg(feature = "std")]
mod slots;
#[cfg(feature = "std")]
mod status;
#[cfg(feature = "std")]
mod stop_handle;
#[cfg(feature = "std")]
mod tickets;
#[cfg(feature = "std")]
mod together;

pub use self::core::AxisCore;
pub use crate::profile_position::{
    CommandId, Completion, Delivery, Event, Failure, Unrest, WaitingFor, WorkingCounter,
};
pub use command::{Command, Inputs, StopRequest};
pub use config::{AxisConfig, Deadlines, Loss, Tolerances};
#[cfg(feature = "std")]
pub(crate) use fields::TARGET_VELOCITY;
pub use fields::{AxisFields, FieldError};
pub(crate) use let_go::no_older;
pub use referencing::Referencing;
pub use snapshot::Snapshot;

#[cfg(feature = "std")]
pub(crate) use claim::{Claim, Claims};
#[cfg(feature = "std")]
pub use error::{AxisError, AxisErrorKind, AxisIdentity};
#[cfg(feature = "std")]
pub use field::{Field, OutputField};
#[cfg(feature = "std")]
pub use handle::Axis;
#[cfg(feature = "std")]
pub(crate) use handle::{Handles, Lease};
#[cfg(feature = "std")]
pub(crate) use last_stop::LastStop;
#[cfg(feature = "std")]
pub use liveness::{Liveness, LivenessWatch};
#[cfg(feature = "std")]
pub(crate) use pending::Pending;
#[cfg(feature = "std")]
pub use port::AxisPort;
#[cfg(feature = "std")]
pub(crate) use restart::Again;
#[cfg(feature = "std")]
pub use settings::DriveSettings;
#[cfg(feature = "std")]
pub use setup::{AxisSetup, AxisSource, BoxFuture, NoParameters, ParameterAccess};
#[cfg(feature = "std")]
pub use stop_handle::StopHandle;
#[cfg(feature = "std")]
pub use together::{AxisSet, GroupQueue, Groups, TogetherError, together};
