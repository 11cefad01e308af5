//! One axis: the pure core. The handles are in `src/handle/`, and this module re-exports those of the axis itself.
//!
//! The core joins power sequencing, stopping, the active mode and the one composer of controlwords. It is stepped once a cycle, either by
//! the bus thread of a `Network` or by a program with a cyclic exchange of its own. Read `core.rs` first, then `machines.rs`.

mod brake;
pub(crate) mod command;
mod commands;
pub(crate) mod config;
mod core;
mod deceleration;
mod fields;
mod machines;
mod mode;
mod observed;
mod outputs;
mod power;
mod power_guard;
mod snapshot;
mod stopping;
#[cfg(test)]
mod tests;

pub use self::core::AxisCore;
pub use crate::profile_position::events::{CommandId, Completion, Event};
pub use crate::profile_position::failure::{
    Delivery, Inhibit, ParameterFault, Unrest, Unsupported, WaitingFor, WorkingCounter,
};
pub use brake::{Brake, OutputBrake};
pub use command::Command;
pub use config::{CoreConfig, Deadlines, DriveSettings, Loss, Tolerances};
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
    ArmedProbe, AxisErrorKind, AxisIdentity, AxisPort, AxisSet, AxisSetup, AxisSource,
    AxisStatistics, BoxFuture, ContinuousProbe, Edge, GroupQueue, Groups, InputBit, InputField,
    LimitedTorque, Liveness, LivenessWatch, MotionEnd, NoParameters, OutputBit, OutputField, Pair,
    PairError, PairMove, Pairing, ParameterAccess, Probe, ProbeError, ProbeRequest, Probed,
    ProbedEdge, Sampled, SkewReport, Stale, StartTogether, StopHandle, TorqueLimit,
};
