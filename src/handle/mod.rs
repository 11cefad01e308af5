//! What a program holds of an axis: its handle, leases of its modes, moves, paths, stops and the program's liveness.
//!
//! Handles put commands into a bounded queue and stops beside it. The owner of the cycle takes them to the axis core and brings its
//! reports and snapshots back (`queue`, with both its ends). It takes no lock and allocates nothing. Each handle is a thin layer over
//! that: `axis`, `profile_position`, `follow`, `homing`, `profile_velocity`, `start_together`.
//!
//! This room imports the pure ones and `wakes`; of those that need `std`, only `bus` imports it. The modules of the public interface
//! re-export from here what belongs to them.

mod axis;
mod error;
mod field;
mod follow;
mod homing;
mod output_cells;
mod parameters;
mod profile_position;
mod profile_velocity;
mod queue;
mod setup;
mod signals;
mod start_together;
mod statistics;
mod status;
mod stop_handle;

// The owner of the cycle logs what an axis does; handles log who asked for it, at DEBUG.
use crate::log_target::AXIS as LOG;

// As `status` names it: it is part of the models of loom too.
use crate::axis::Snapshot;

pub use axis::Axis;
pub use error::{AxisError, AxisErrorKind, AxisIdentity};
pub use field::{Field, OutputField};
pub use follow::{ByIterator, ByStream, Follow, Followed, Path, PathError};
pub use homing::{Home, Homed, Homing};
pub use profile_position::{Done, Move, MoveRequest, Outcome, ProfilePosition};
pub use profile_velocity::{Jog, ProfileVelocity};
pub use queue::AxisPort;
pub use setup::{AxisSetup, AxisSource, BoxFuture, NoParameters, ParameterAccess};
pub use start_together::{AxisSet, GroupQueue, Groups, StartTogether, start_together};
pub use statistics::{AxisStatistics, MotionEnd};
pub use stop_handle::{Liveness, LivenessWatch, StopHandle};
