//! A program's own units: millimetres, degrees, whatever the machine counts in.
//!
//! A [`Unit`] is a type, so that numbers of one axis do not fit another in another unit. Its conversion is a value: a [`Scale`], made of
//! [`Ratio`]s that are given or come from a drive's [`Factors`]. Handles of an axis have both: [`Axis<Mm>`](crate::Axis).

mod scale;

pub use scale::Ratio;
#[cfg(feature = "std")]
pub(crate) use scale::difference::DriveUnits;
#[cfg(feature = "std")]
pub use scale::difference::{ScaleDifference, ScaleMismatch, ScaleQuantity};
#[cfg(test)]
pub(crate) use scale::example;
pub use scale::{AxisNumber, AxisScale, AxisUnit, Counts, Degree, Mm, Unit};
pub use scale::{Edition, Factors};
pub use scale::{Quantity, Scale, ScaleError};
