//! Homing: the procedure by which an axis finds out where it is (mode 6; CiA 402-2, "Homing mode").
//!
//! The drive does it by itself. The types and the sequencing of bit 4 here are pure.

pub(crate) mod parameters;
mod procedure;
#[cfg(test)]
mod tests;

pub use parameters::HomingCommand;
pub(crate) use procedure::{HomingVerdict, Procedure};

#[cfg(feature = "std")]
pub use crate::handle::{Home, Homed};
