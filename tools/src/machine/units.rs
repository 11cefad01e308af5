//! The axes of a `machine.toml` and their units.

use serde::Deserialize;
use servocrab::{
    AxisConfig,
    units::{Degree, Mm, Ratio, Scale, ScaleMismatch},
};

use crate::output::Failure;

/// An axis of a drive.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "Written")]
pub(crate) struct Axis {
    pub(crate) name: String,
    pub(crate) units: Units,
    /// So many of its units are a revolution of the drive's shaft.
    per_revolution: Option<Ratio>,
    scale_mismatch: ScaleMismatch,
}

/// As a file has it: the name alone of an axis in counts, or its unit as well.
#[derive(Deserialize)]
#[serde(
    untagged,
    expecting = "an axis is its name, \"x\", or { name = \"x\", unit = \"mm\", counts = 1048576, per = 5 } with the unit mm or degree"
)]
enum Written {
    Name(String),
    WithUnit(WithUnit),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WithUnit {
    name: String,
    unit: Unit,
    counts: u64,
    #[serde(default = "one")]
    per: u64,
    per_revolution: Option<f64>,
    #[serde(default)]
    scale_mismatch: Mismatch,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Mismatch {
    #[default]
    Refuse,
    Warn,
    Write,
}

const fn one() -> u64 {
    1
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Unit {
    Mm,
    Degree,
}

impl Axis {
    pub(crate) const fn named(name: String) -> Self {
        Self {
            name,
            units: Units::Counts,
            per_revolution: None,
            scale_mismatch: ScaleMismatch::Refuse,
        }
    }

    /// The axis as a drive of the network has it.
    pub(crate) fn declare(&self) -> AxisConfig {
        let axis = self.units.declare(AxisConfig::new(&self.name));
        let axis = axis.scale_mismatch(self.scale_mismatch);
        match self.per_revolution {
            Some(units) => axis.units_per_revolution(units),
            None => axis,
        }
    }
}

impl TryFrom<Written> for Axis {
    type Error = String;

    fn try_from(written: Written) -> Result<Self, String> {
        let WithUnit {
            name,
            unit,
            counts,
            per,
            per_revolution,
            scale_mismatch,
        } = match written {
            Written::Name(name) => return Ok(Self::named(name)),
            Written::WithUnit(axis) => axis,
        };
        let wrong = |error| format!("axis \"{name}\": {error}");
        let ratio = Ratio::new(counts, per).map_err(wrong)?;
        let per_revolution = per_revolution.map(Ratio::try_from).transpose();
        let per_revolution = per_revolution.map_err(wrong)?;
        let scale = Scale::counts_per_unit(ratio);
        let units = match unit {
            Unit::Mm => Units::Mm(scale),
            Unit::Degree => Units::Degree(scale),
        };
        Ok(Self {
            name,
            units,
            per_revolution,
            scale_mismatch: match scale_mismatch {
                Mismatch::Refuse => ScaleMismatch::Refuse,
                Mismatch::Warn => ScaleMismatch::Warn,
                Mismatch::Write => ScaleMismatch::Write,
            },
        })
    }
}

/// The unit of an axis, and how many counts it has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Units {
    Counts,
    Mm(Scale),
    Degree(Scale),
}

impl Units {
    fn declare(self, axis: AxisConfig) -> AxisConfig {
        match self {
            Self::Counts => axis,
            Self::Mm(scale) => axis.unit::<Mm>(scale),
            Self::Degree(scale) => axis.unit::<Degree>(scale),
        }
    }

    /// The name behind a number.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Counts => "counts",
            Self::Mm(_) => "mm",
            Self::Degree(_) => "°",
        }
    }

    pub(crate) fn position(self, position: f64) -> Result<i32, Failure> {
        Ok(self.scale_of(position)?.position(position)?)
    }

    pub(crate) fn target_velocity(self, velocity: f64) -> Result<i32, Failure> {
        Ok(self.scale_of(velocity)?.target_velocity(velocity)?)
    }

    pub(crate) fn velocity(self, velocity: f64) -> Result<u32, Failure> {
        Ok(self.scale_of(velocity)?.velocity(velocity)?)
    }

    pub(crate) fn acceleration(self, acceleration: f64) -> Result<u32, Failure> {
        Ok(self.scale_of(acceleration)?.acceleration(acceleration)?)
    }

    pub(crate) fn home_offset(self, offset: f64) -> Result<i32, Failure> {
        Ok(self.scale_of(offset)?.home_offset(offset)?)
    }

    /// The scale by which this number is meant. Counts are whole.
    fn scale_of(self, number: f64) -> Result<Scale, Failure> {
        match self {
            Self::Counts if number.is_finite() && number.fract() != 0.0 => Err(format!(
                "{number} is no whole number, and the axis has no unit: --machine FILE gives it one, with counts = …"
            )
            .into()),
            Self::Counts => Ok(Scale::COUNTS),
            Self::Mm(scale) | Self::Degree(scale) => Ok(scale),
        }
    }

    /// Rounded to a thousandth; counts are whole.
    pub(crate) fn show(self, counts: i32) -> f64 {
        match self {
            Self::Counts => counts.into(),
            Self::Mm(scale) | Self::Degree(scale) => {
                (scale.position_of(counts) * 1000.0).round() / 1000.0
            }
        }
    }
}
