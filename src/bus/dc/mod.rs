//! Distributed clocks: delays and offsets of a line, SYNC0 of its drives, and the phase of the cycles against the reference
//! clock. `topology`, `delay`, `phase` and `setting` compute and are pure; the others are the accesses around them.

mod delay;
mod distribution;
mod lock;
mod measure;
mod phase;
mod setting;
mod sync;
mod topology;

pub(super) use distribution::{Distribution, RESERVED, Slot};
pub(super) use lock::{LockWatch, first_cycle, wait_for_lock};
pub(super) use measure::{Clocks, measure};
pub(super) use phase::{Measured, Phase};
pub use setting::DistributedClock;
pub(super) use sync::{set_types, settling, start};
pub use topology::TopologyError;
