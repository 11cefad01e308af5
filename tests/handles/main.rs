//! What the awaited handles of an axis promise, on simulated drives in virtual time.
#![cfg(feature = "std")]
#![allow(missing_docs)]

mod bad_input;
mod bus;
mod cancelled;
mod chaos;
mod fields;
mod follow;
mod homing;
mod jog;
mod kept;
mod lease;
mod machine;
mod moves;
mod outlived;
mod pair;
mod parameters;
mod probe;
mod stops;
mod threads;
mod together;
mod units;
