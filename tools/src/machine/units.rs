//! The axes of a `machine.toml` and their units.

use std::time::Duration;

use serde::Deserialize;

use servocrab::{
    AxisConfig,
    axis::{Brake, OutputBrake},
    ds402::{DigitalInput, DigitalOutput},
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
    is_vertical: bool,
    brake: Option<Brake>,
}

/// As a file has it: the name alone of an axis in counts, or what else is said of it.
#[derive(Deserialize)]
#[serde(
    untagged,
    expecting = "an axis is its name, \"x\", or { name = \"x\", unit = \"mm\", counts = 1048576, per = 5 } with the unit mm or degree"
)]
enum Written {
    Name(String),
    InFull(InFull),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct InFull {
    name: String,
    unit: Option<Unit>,
    counts: Option<u64>,
    #[serde(default = "one")]
    per: u64,
    per_revolution: Option<f64>,
    #[serde(default)]
    scale_mismatch: Mismatch,
    #[serde(default)]
    vertical: bool,
    brake: Option<WrittenBrake>,
}

/// Managed by the drive, or on an output of it.
#[derive(Clone, Copy, Deserialize)]
#[serde(untagged)]
enum WrittenBrake {
    Managed(Managed),
    Output(OnOutput),
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Managed {
    Drive,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct OnOutput {
    bit: u8,
    release_ms: u32,
    set_ms: u32,
    #[serde(default)]
    released_by_one: bool,
    feedback: Option<u8>,
    #[serde(default)]
    inverted_feedback: bool,
    #[serde(default)]
    set_by_drive: bool,
}

impl WrittenBrake {
    fn declared(self) -> Brake {
        let OnOutput {
            bit,
            release_ms,
            set_ms,
            released_by_one,
            feedback,
            inverted_feedback,
            set_by_drive,
        } = match self {
            Self::Managed(Managed::Drive) => return Brake::DriveManaged,
            Self::Output(brake) => brake,
        };
        let time = |ms: u32| Duration::from_millis(ms.into());
        let output = DigitalOutput::Bit(bit);
        let mut brake = OutputBrake::new(output, time(release_ms), time(set_ms));
        if released_by_one {
            brake = brake.released_by_one();
        }
        brake = match feedback.map(DigitalInput::Bit) {
            None => brake,
            Some(input) if inverted_feedback => brake.inverted_feedback(input),
            Some(input) => brake.feedback(input),
        };
        if set_by_drive {
            brake = brake.set_by_drive();
        }
        brake.into()
    }
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
            is_vertical: false,
            brake: None,
        }
    }

    /// The axis as a drive of the network has it.
    pub(crate) fn declare(&self) -> AxisConfig {
        let axis = self.units.declare(AxisConfig::new(&self.name));
        let mut axis = axis.scale_mismatch(self.scale_mismatch);
        if self.is_vertical {
            axis = axis.vertical();
        }
        if let Some(brake) = self.brake {
            axis = axis.brake(brake);
        }
        match self.per_revolution {
            Some(units) => axis.units_per_revolution(units),
            None => axis,
        }
    }
}

impl TryFrom<Written> for Axis {
    type Error = String;

    fn try_from(written: Written) -> Result<Self, String> {
        let InFull {
            name,
            unit,
            counts,
            per,
            per_revolution,
            scale_mismatch,
            vertical,
            brake,
        } = match written {
            Written::Name(name) => return Ok(Self::named(name)),
            Written::InFull(axis) => axis,
        };
        let wrong = |error| format!("axis \"{name}\": {error}");
        let per_revolution = per_revolution.map(Ratio::try_from).transpose();
        let per_revolution = per_revolution.map_err(wrong)?;
        let units = match (unit, counts) {
            (None, None) => Units::Counts,
            (Some(unit), Some(counts)) => {
                let scale = Scale::counts_per_unit(Ratio::new(counts, per).map_err(wrong)?);
                match unit {
                    Unit::Mm => Units::Mm(scale),
                    Unit::Degree => Units::Degree(scale),
                }
            }
            _ => {
                return Err(format!(
                    "axis \"{name}\": unit = and counts = belong together"
                ));
            }
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
            is_vertical: vertical,
            brake: brake.map(WrittenBrake::declared),
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
