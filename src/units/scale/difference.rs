//! Where the declared scale of an axis and what its drive says of its units contradict each other.
//!
//! A scale says how many counts a unit of the machine has. A drive does not know the machine's unit: its factors convert encoder
//! increments, and say how its velocities and accelerations relate to its positions. So only that is compared which follows without an
//! assumption. An object that is missing says nothing.

use alloc::vec::Vec;
use core::fmt;

use super::{AxisScale, Edition, Factors, Ratio};
use crate::coe::{Object, ObjectAddress, ReadWrite, obj};

/// What is done where the declared scale of an axis contradicts its drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ScaleMismatch {
    /// The start, or the recovery of the drive, fails: the axis would move by other distances or velocities than the program means.
    #[default]
    Refuse,
    /// It is logged as a warning, and the program's scale counts. For drives whose factor objects do not say what they do.
    Warn,
    /// 6092h, 6096h and 6097h are written as the scale says, before anything that is counted in their units. What still differs then is
    /// refused.
    Write,
}

/// A quantity of which the declared scale says one thing, and the drive another.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ScaleDifference {
    /// Where the drive says it.
    pub object: ObjectAddress,
    /// What is compared.
    pub quantity: ScaleQuantity,
    /// What it is by the declared scale.
    pub expected: f64,
    /// What the drive says.
    pub got: f64,
    /// What has to be written so that the drive says what is expected.
    factor: Option<Ratio>,
}

/// What a drive says of its units.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ScaleQuantity {
    /// Position units in a revolution of the shaft: 6092h; of older drives by 608Fh, 6091h and 6093h.
    PositionUnitsPerRevolution,
    /// Velocity units in one position unit/s: 6096h; of older drives by 6093h and 6094h.
    VelocityUnits,
    /// Acceleration units in one velocity unit/s: 6097h; of older drives by 6094h and 6097h.
    AccelerationUnits,
    /// Position units in a metre: 60A8h.
    PositionUnitsPerMetre,
    /// Velocity units in one metre per second: 60A9h.
    VelocityUnitsPerMetre,
}

impl fmt::Display for ScaleQuantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PositionUnitsPerRevolution => "position units in a revolution of the shaft",
            Self::VelocityUnits => "velocity units in a position unit/s",
            Self::AccelerationUnits => "acceleration units in a velocity unit/s",
            Self::PositionUnitsPerMetre => "position units in a metre",
            Self::VelocityUnitsPerMetre => "velocity units in a metre/s",
        })
    }
}

impl fmt::Display for ScaleDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            object,
            quantity,
            expected,
            got,
            ..
        } = self;
        write!(f, "{object}: expected {expected} {quantity}, got {got}")
    }
}

/// A factor object: numerator and divisor.
type Factor = [Object<u32, ReadWrite>; 2];

const POSITION: Factor = [obj::POSITION_FACTOR_NUMERATOR, obj::POSITION_FACTOR_DIVISOR];
const ENCODER: Factor = [obj::ENCODER_INCREMENTS, obj::ENCODER_REVOLUTIONS];
const GEAR: Factor = [obj::GEAR_MOTOR_REVOLUTIONS, obj::GEAR_SHAFT_REVOLUTIONS];
const FEED: Factor = [obj::FEED, obj::FEED_SHAFT_REVOLUTIONS];
const VELOCITY_ENCODER: Factor = [
    obj::VELOCITY_ENCODER_FACTOR_NUMERATOR,
    obj::VELOCITY_ENCODER_FACTOR_DIVISOR,
];
const VELOCITY: Factor = [obj::VELOCITY_FACTOR_NUMERATOR, obj::VELOCITY_FACTOR_DIVISOR];
const ACCELERATION: Factor = [
    obj::ACCELERATION_FACTOR_NUMERATOR,
    obj::ACCELERATION_FACTOR_DIVISOR,
];

/// What a drive says of its units.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct DriveUnits {
    pub factors: Factors,
    /// 60A8h.
    pub si_position: Option<u32>,
    /// 60A9h.
    pub si_velocity: Option<u32>,
}

impl DriveUnits {
    /// The objects of factors.
    pub const FACTORS: [Factor; 7] = [
        POSITION,
        ENCODER,
        GEAR,
        FEED,
        VELOCITY_ENCODER,
        VELOCITY,
        ACCELERATION,
    ];

    /// What these objects hold, in that order. A drive that has 6093h follows version 2.
    pub fn factors(held: [Option<Ratio>; 7]) -> Factors {
        let [
            position,
            encoder,
            gear,
            feed,
            velocity_encoder,
            velocity,
            acceleration,
        ] = held;
        Factors {
            edition: position.map_or(Edition::Version3, |_| Edition::Version2),
            encoder,
            gear,
            feed,
            position,
            velocity_encoder,
            velocity,
            acceleration,
        }
    }

    /// What contradicts the scale of an axis, of which a revolution of the shaft is this number of its units, where that is declared.
    pub fn differences(
        &self,
        axis: &AxisScale,
        units_per_revolution: Option<Ratio>,
    ) -> Vec<ScaleDifference> {
        let factors = &self.factors;
        let scale = &axis.scale;
        let (object, turn) = factors.turn();
        let turn = compare(
            object,
            ScaleQuantity::PositionUnitsPerRevolution,
            units_per_revolution.map(|units| Exactly(scale.position, units)),
            turn,
        );
        let mut found: Vec<_> = turn.into_iter().collect();
        if axis.unit.is_some() {
            let (object, velocity) = factors.velocity_of_position();
            found.extend(compare(
                object,
                ScaleQuantity::VelocityUnits,
                Some(Exactly(scale.velocity, scale.position.inverse())),
                velocity,
            ));
            found.extend(compare(
                obj::ACCELERATION_FACTOR_NUMERATOR,
                ScaleQuantity::AccelerationUnits,
                Some(Exactly(scale.acceleration, scale.velocity.inverse())),
                factors.acceleration_of_velocity(),
            ));
        }
        let per_metre = |ratio| {
            let metres = axis.unit?.metres?;
            Some(Exactly(ratio, metres.inverse()))
        };
        found.extend(compare(
            obj::SI_UNIT_POSITION,
            ScaleQuantity::PositionUnitsPerMetre,
            per_metre(scale.position),
            self.si_position
                .and_then(|unit| si_per_metre(unit, DIMENSIONLESS)),
        ));
        found.extend(compare(
            obj::SI_UNIT_VELOCITY,
            ScaleQuantity::VelocityUnitsPerMetre,
            per_metre(scale.velocity),
            self.si_velocity.and_then(|unit| si_per_metre(unit, SECOND)),
        ));
        found
    }

    /// What is written to the drive so that it says what is expected; none where that is no factor of two numbers of 32 bits in an object
    /// that can be written. By version 2 factors convert to increments: none of them alone makes the scale.
    pub fn writes(
        &self,
        difference: &ScaleDifference,
    ) -> Option<[(Object<u32, ReadWrite>, u32); 2]> {
        if self.factors.edition == Edition::Version2 {
            return None;
        }
        let objects = [FEED, VELOCITY, ACCELERATION];
        let [numerator, divisor] = objects
            .into_iter()
            .find(|[numerator, _]| numerator.index() == difference.object.index)?;
        let factor = difference.factor?;
        let value = |number| u32::try_from(number).ok();
        Some([
            (numerator, value(factor.numerator())?),
            (divisor, value(factor.denominator())?),
        ])
    }
}

#[cfg(test)]
impl ScaleDifference {
    /// A feed constant that is another.
    pub fn example() -> Self {
        Self {
            object: obj::FEED.address(),
            quantity: ScaleQuantity::PositionUnitsPerRevolution,
            expected: 5_000.0,
            got: 1.0,
            factor: None,
        }
    }
}

impl Factors {
    /// Position units in a revolution of the shaft, and where they come from.
    fn turn(&self) -> (Object<u32, ReadWrite>, Option<f64>) {
        let by_factor = match (self.encoder, self.position) {
            (Some(encoder), Some(position)) => {
                let gear = self.gear.map_or(1.0, value);
                Some(value(encoder) * gear / value(position))
            }
            _ => None,
        };
        match by_factor {
            Some(turn) => (obj::POSITION_FACTOR_NUMERATOR, Some(turn)),
            None => (obj::FEED, self.feed.map(value)),
        }
    }

    /// Velocity units in a position unit/s.
    fn velocity_of_position(&self) -> (Object<u32, ReadWrite>, Option<f64>) {
        match self.edition {
            Edition::Version3 => (obj::VELOCITY_FACTOR_NUMERATOR, self.velocity.map(value)),
            Edition::Version2 => {
                let factors = self.position.zip(self.velocity_encoder);
                (
                    obj::VELOCITY_ENCODER_FACTOR_NUMERATOR,
                    factors.map(|(position, velocity)| value(position) / value(velocity)),
                )
            }
        }
    }

    /// Acceleration units in a velocity unit/s.
    fn acceleration_of_velocity(&self) -> Option<f64> {
        let acceleration = value(self.acceleration?);
        match self.edition {
            Edition::Version3 => Some(acceleration),
            Edition::Version2 => Some(value(self.velocity_encoder?) / acceleration),
        }
    }
}

/// The product of two factors.
struct Exactly(Ratio, Ratio);

/// A hundred-thousandth: what a kelvin makes of steel. Fractions that stand for one that is none, such as 2π, come closer.
const TOLERANCE: f64 = 1e-5;

/// What differs, where both are known.
fn compare(
    object: Object<u32, ReadWrite>,
    quantity: ScaleQuantity,
    expected: Option<Exactly>,
    got: Option<f64>,
) -> Option<ScaleDifference> {
    let (Exactly(first, second), got) = expected.zip(got)?;
    let expected = value(first) * value(second);
    let differs = (expected - got).abs() > TOLERANCE * expected.max(got);
    differs.then(|| ScaleDifference {
        object: object.address(),
        quantity,
        expected,
        got,
        factor: first.times(second).ok(),
    })
}

fn value(ratio: Ratio) -> f64 {
    ratio.numerator() as f64 / ratio.denominator() as f64
}

/// Codes of CiA 303-2.
const DIMENSIONLESS: u8 = 0x00;
const METRE: u8 = 0x01;
const SECOND: u8 = 0x03;

/// How many units of 60A8h or 60A9h a metre has, or a metre per `denominator`: prefix, numerator and denominator are the bytes from the
/// highest on, the lowest is reserved (CiA 402-2). None of a unit that is no length: what an angle moves is the machine's.
fn si_per_metre(unit: u32, denominator: u8) -> Option<f64> {
    let [prefix, numerator, divisor, _] = unit.to_be_bytes();
    let exponent = i32::from(prefix.cast_signed());
    (numerator == METRE && divisor == denominator).then(|| 10_f64.powi(-exponent))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{Degree, Mm, Scale, ScaleError};

    fn ratio(numerator: u64, denominator: u64) -> Ratio {
        Ratio::new(numerator, denominator).unwrap()
    }

    /// What differs: the objects, with what is expected and what the drive says.
    fn found(
        units: &DriveUnits,
        axis: &AxisScale,
        per_revolution: Option<Ratio>,
    ) -> Vec<(u16, f64, f64)> {
        let differences = units.differences(axis, per_revolution).into_iter();
        differences
            .map(|one| (one.object.index, one.expected, one.got))
            .collect()
    }

    fn of_factors(factors: Factors) -> DriveUnits {
        DriveUnits {
            factors,
            ..DriveUnits::default()
        }
    }

    /// 1000 counts a millimetre.
    fn mm() -> AxisScale {
        AxisScale::of::<Mm>(Scale::counts_per_unit(ratio(1000, 1)))
    }

    #[test]
    fn a_feed_constant_is_compared_where_a_revolution_is_declared() {
        let units = of_factors(Factors {
            encoder: Some(ratio(1 << 20, 1)),
            gear: Some(ratio(10, 1)),
            feed: Some(ratio(10_000, 2)),
            ..Factors::default()
        });
        assert!(found(&units, &mm(), None).is_empty());
        assert!(found(&units, &mm(), Some(ratio(5, 1))).is_empty());
        let other = found(&units, &mm(), Some(ratio(10, 1)));
        assert_eq!(other, [(0x6092, 10_000.0, 5_000.0)]);
        // Without 6092h, increments alone do not say that they are counts.
        let units = of_factors(Factors {
            feed: None,
            ..units.factors
        });
        assert!(found(&units, &mm(), Some(ratio(10, 1))).is_empty());
    }

    #[test]
    fn what_is_no_fraction_may_be_written_as_one_that_is_close() -> Result<(), ScaleError> {
        // A pinion of 100 mm around: π is no fraction.
        let turn = Ratio::try_from(10.0 * core::f64::consts::PI)?;
        let units = |feed| {
            of_factors(Factors {
                feed: Some(ratio(feed, 1)),
                ..Factors::default()
            })
        };
        assert!(found(&units(31_416), &mm(), Some(turn)).is_empty());
        assert_eq!(found(&units(31_415), &mm(), Some(turn)).len(), 1);
        Ok(())
    }

    #[test]
    fn velocities_and_accelerations_are_compared_whatever_the_unit_is() {
        let declared = |scale| AxisScale::of::<Degree>(scale);
        let plain = Scale::counts_per_unit(ratio(1000, 7));
        // 60 units of velocity for a count/s, three of acceleration for a unit of velocity/s.
        let factors = Factors {
            velocity: Some(ratio(60, 1)),
            acceleration: Some(ratio(3, 1)),
            ..Factors::default()
        };
        let units = of_factors(factors);
        let right = plain
            .velocity_counts_per_unit(ratio(60_000, 7))
            .acceleration_counts_per_unit(ratio(180_000, 7));
        assert!(found(&units, &declared(right), None).is_empty());
        let differ = units.differences(&declared(plain), None);
        let text: Vec<_> = differ.iter().map(ToString::to_string).collect();
        assert_eq!(
            text,
            [
                "6096h:01: expected 1 velocity units in a position unit/s, got 60",
                "6097h:01: expected 1 acceleration units in a velocity unit/s, got 3",
            ]
        );
        // In counts each object has a unit of its own.
        assert!(found(&units, &AxisScale::COUNTS, None).is_empty());
        // By version 2 all of them are in increments.
        let units = of_factors(Factors {
            edition: Edition::Version2,
            encoder: Some(ratio(1 << 20, 1)),
            position: Some(ratio(60, 1)),
            velocity_encoder: Some(ratio(1, 1)),
            acceleration: Some(ratio(1, 3)),
            velocity: Some(ratio(7, 1)),
            ..Factors::default()
        });
        assert!(found(&units, &declared(right), None).is_empty());
        let differ = units.differences(&declared(plain), Some(ratio(7, 1)));
        let indices: Vec<_> = differ.iter().map(|one| one.object.index).collect();
        assert_eq!(indices, [0x6093, 0x6094, 0x6097]);
        assert!(differ.iter().all(|one| units.writes(one).is_none()));
    }

    #[test]
    fn a_unit_of_length_is_compared_with_the_si_unit_and_another_is_not() {
        let units = |si_position, si_velocity| DriveUnits {
            si_position: Some(si_position),
            si_velocity: Some(si_velocity),
            ..DriveUnits::default()
        };
        // µm and µm/s.
        assert!(found(&units(0xFA01_0000, 0xFA01_0300), &mm(), None).is_empty());
        // mm and m/s.
        let other = found(&units(0xFD01_0000, 0x0001_0300), &mm(), None);
        let near = |value: f64, other: f64| (value / other - 1.0).abs() < 1e-9;
        assert_eq!(other.len(), 2);
        assert!(other[0].0 == 0x60A8 && near(other[0].1, 1e6) && near(other[0].2, 1e3));
        assert!(other[1].0 == 0x60A9 && near(other[1].1, 1e6) && near(other[1].2, 1.0));
        // Increments, degrees and rpm say nothing of a machine's length, nor a metre of its angle.
        for (position, velocity) in [(0x00B5_0000, 0x00B4_4700), (0xFF41_0000, 0), (0, 0)] {
            assert!(found(&units(position, velocity), &mm(), None).is_empty());
        }
        let degrees = AxisScale::of::<Degree>(*mm().scale());
        assert!(found(&units(0xFD01_0000, 0x0001_0300), &degrees, None).is_empty());
        for exponent in [i8::MIN, i8::MAX] {
            let unit = u32::from_be_bytes([exponent.cast_unsigned(), METRE, 0, 0]);
            assert_eq!(found(&units(unit, 0), &mm(), None).len(), 1);
        }
    }

    #[test]
    fn what_is_written_is_a_fraction_of_32_bits() {
        let feed = |scale, per_revolution| {
            let units = of_factors(Factors {
                feed: Some(Ratio::ONE),
                ..Factors::default()
            });
            let axis = AxisScale::of::<Mm>(Scale::counts_per_unit(scale));
            let differences = units.differences(&axis, Some(per_revolution));
            units.writes(&differences[0])
        };
        let written = feed(ratio(1 << 20, 15), ratio(5, 1)).unwrap();
        assert_eq!(written.map(|(_, value)| value), [1 << 20, 3]);
        assert_eq!(written.map(|(object, _)| object.subindex()), [1, 2]);
        assert!(feed(ratio(1 << 33, 1), Ratio::ONE).is_none());
        assert!(feed(ratio(u64::MAX, 2), ratio(u64::MAX, 2)).is_none());
    }
}
