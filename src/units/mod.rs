//! A program's own units: millimetres, degrees, whatever the machine counts in.
//!
//! The conversion is pure: [`Scale`], made of [`Ratio`]s that are given or come from a drive's [`Factors`]. The handles
//! [`ScaledAxis`], [`ScaledProfilePosition`], [`ScaledHoming`] and [`ScaledProfileVelocity`] are those of an axis with a scale in
//! front; they add no behaviour.

mod factors;
mod homing;
mod jog;
mod ratio;
mod scale;

#[cfg(feature = "std")]
mod scaled;
#[cfg(feature = "std")]
mod scaled_axis;
#[cfg(feature = "std")]
mod scaled_failure;
#[cfg(feature = "std")]
mod scaled_homing;
#[cfg(feature = "std")]
mod scaled_jog;
#[cfg(feature = "std")]
mod scaled_request;

pub use factors::{Edition, Factors};
pub use homing::ScaledHomingParameters;
pub use jog::ScaledJogSetPoint;
pub use ratio::Ratio;
pub use scale::{Quantity, Scale, ScaleError, ScaledSetPoint};
#[cfg(feature = "std")]
pub use scaled::{ScaledMove, ScaledOutcome, ScaledProfilePosition};
#[cfg(feature = "std")]
pub use scaled_axis::{ScaledAxis, ScaledStatus};
#[cfg(feature = "std")]
pub use scaled_failure::ScaledFailure;
#[cfg(feature = "std")]
pub use scaled_homing::{ScaledHome, ScaledHomed, ScaledHoming};
#[cfg(feature = "std")]
pub use scaled_jog::{ScaledJog, ScaledProfileVelocity};
#[cfg(feature = "std")]
pub use scaled_request::{
    ScaledFollow, ScaledFollowed, ScaledMoveRequest, ScaledPathError, together,
};
