//! A program's own units: millimetres, degrees, whatever the machine counts in.
//!
//! The conversion is pure: [`Scale`], made of [`Ratio`]s that are given or come from a drive's [`Factors`]. The handles
//! [`ScaledAxis`] and [`ScaledProfilePosition`] are those of an axis with a scale in front; they add no behaviour.

mod factors;
mod ratio;
mod scale;

#[cfg(feature = "std")]
mod scaled;
#[cfg(feature = "std")]
mod scaled_failure;

pub use factors::{Edition, Factors};
pub use ratio::Ratio;
pub use scale::{Quantity, Scale, ScaleError, ScaledSetPoint};
#[cfg(feature = "std")]
pub use scaled::{ScaledAxis, ScaledMove, ScaledOutcome, ScaledProfilePosition, ScaledStatus};
#[cfg(feature = "std")]
pub use scaled_failure::ScaledFailure;
