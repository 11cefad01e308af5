//! What a program holds of an axis: its handle, leases of its modes, moves, paths, stops and the program's liveness.
//!
//! A handle makes a request for each command (`request`) and holds it as a `pending` one. The request goes out in one queue and comes
//! back in another (`queue`). Stops go beside it (`stops`). The owner of the cycle takes requests to the axis core, and brings reports
//! and snapshots back (`port`). It takes no lock, allocates nothing and frees nothing. What it meets of the handles is in `shared`.
//!
//! The handles are thin layers over that: `axis`, `profile_position`, `follow`, `homing`, `profile_velocity`, `start_together`, `pair`.
//!
//! This room imports the pure ones and `wakes`; of those that need `std`, only `bus` imports it. The modules of the public interface
//! re-export from here what belongs to them.

mod axis;
mod drive_notes;
mod error;
mod field;
mod follow;
mod homing;
mod output_cells;
mod pair;
mod parameters;
mod pending;
mod port;
mod probe;
mod profile_position;
mod profile_velocity;
mod queue;
mod request;
mod sampled;
mod setup;
mod shared;
mod signals;
mod start_together;
mod statistics;
mod status;
mod stop_handle;
mod stops;
mod torque_limit;

// The owner of the cycle logs what an axis does; handles log who asked for it, at DEBUG.
use crate::log_target::AXIS as LOG;

// As `status` names it: it is part of the models of loom too.
use crate::axis::Snapshot;

pub use axis::Axis;
pub use error::{AxisError, AxisErrorKind, AxisIdentity};
pub use field::{InputBit, InputField, OutputBit, OutputField};
pub use follow::{ByIterator, ByStream, Follow, Followed, Path, PathError};
pub use homing::{Home, Homed, Homing};
pub use pair::{Pair, PairError, PairMove, Pairing, SkewReport};
pub use port::AxisPort;
pub use probe::{
    ArmedProbe, ContinuousProbe, Edge, Probe, ProbeError, ProbeRequest, Probed, ProbedEdge,
};
pub use profile_position::{Done, Move, MoveRequest, Outcome, ProfilePosition};
pub use profile_velocity::{Jog, ProfileVelocity};
pub use sampled::{Sampled, Stale};
pub use setup::{AxisSetup, AxisSource, BoxFuture, NoParameters, ParameterAccess};
pub use start_together::{AxisSet, GroupQueue, Groups, StartTogether, start_together};
pub use statistics::{AxisStatistics, MotionEnd};
pub use stop_handle::{Liveness, LivenessWatch, StopHandle};
pub use torque_limit::{LimitedTorque, TorqueLimit};
