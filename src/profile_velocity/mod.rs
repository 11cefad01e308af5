//! Profile Velocity: jogging, a velocity for as long as it is held (mode 3; CiA 402-2, "Profile velocity mode").
//!
//! The types and the machine that owns the target velocity 60FFh are pure.

mod jogging;
mod set_point;

#[cfg(feature = "std")]
mod handle;

pub(crate) use jogging::Jogging;
pub use set_point::JogSetPoint;

#[cfg(feature = "std")]
pub use handle::{Jog, ProfileVelocity};
