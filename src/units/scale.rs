//! A program's units and the drive's counts, both ways.

use core::fmt;

use super::Ratio;
use crate::{
    coe::ObjectAddress,
    profile_position::{Parameters, SetPoint, Start},
};

/// How many of the drive's units one of the program's units is: for positions, velocities and accelerations.
///
/// "Counts" here are the units of 607Ah and 6064h, of 6081h and 606Ch, of 6083h and 6084h. Numbers go to the nearest count. The
/// middle between two counts goes to the one that is further from zero, so that a mirrored motion is the mirrored counts. Factors
/// are fractions of whole numbers, so that this is the only rounding. What comes back from the drive is the number nearest to the
/// exact value, and gives the same count again.
///
/// ```
/// use servocrab::units::{Ratio, Scale};
/// // A spindle of 5 mm a revolution, an encoder of 2²⁰ counts; velocities in counts/s, accelerations in counts/s².
/// let mm = Scale::counts_per_unit(Ratio::new(1 << 20, 5)?);
/// assert_eq!(mm.position(2.5)?, 1 << 19);
/// assert_eq!(mm.position_of(1 << 19), 2.5);
/// // The same with a drive whose velocity unit is a revolution per minute.
/// let mm = mm.velocity_counts_per_unit(Ratio::new(60, 5)?);
/// assert_eq!(mm.velocity(100.0)?, 1200);
/// assert!(mm.position(20_000.0).is_err(), "607Ah has 32 bits");
/// assert!(mm.position(f64::NAN).is_err());
/// # Ok::<(), servocrab::units::ScaleError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Scale {
    position: Ratio,
    velocity: Ratio,
    acceleration: Ratio,
}

impl Scale {
    /// So many counts are one unit; velocities are in counts/s and accelerations in counts/s².
    #[must_use]
    pub const fn counts_per_unit(counts: Ratio) -> Self {
        Self {
            position: counts,
            velocity: counts,
            acceleration: counts,
        }
    }

    /// With so many of the drive's velocity units for one unit/s.
    #[must_use]
    pub const fn velocity_counts_per_unit(mut self, counts: Ratio) -> Self {
        self.velocity = counts;
        self
    }

    /// With so many of the drive's acceleration units for one unit/s².
    #[must_use]
    pub const fn acceleration_counts_per_unit(mut self, counts: Ratio) -> Self {
        self.acceleration = counts;
        self
    }

    /// A position or distance as 607Ah takes it.
    ///
    /// # Errors
    /// [`ScaleError::NotFinite`], or [`ScaleError::OutOfRange`] where `i32` does not hold it.
    pub fn position(&self, position: f64) -> Result<i32, ScaleError> {
        signed(Quantity::Position, self.position, position)
    }

    /// A home offset as 607Ch takes it.
    ///
    /// # Errors
    /// As [`position`](Self::position).
    pub fn home_offset(&self, offset: f64) -> Result<i32, ScaleError> {
        signed(Quantity::HomeOffset, self.position, offset)
    }

    /// A velocity with a direction as 60FFh takes it.
    ///
    /// # Errors
    /// [`ScaleError::NotFinite`], [`ScaleError::OutOfRange`] where `i32` does not hold it, or [`ScaleError::RoundsToZero`].
    pub fn target_velocity(&self, velocity: f64) -> Result<i32, ScaleError> {
        let quantity = Quantity::TargetVelocity;
        match signed(quantity, self.velocity, velocity)? {
            0 if velocity != 0.0 => Err(rounds_to_zero(quantity, self.velocity, velocity)),
            counts => Ok(counts),
        }
    }

    /// A velocity as 6081h takes it.
    ///
    /// # Errors
    /// [`ScaleError::NotFinite`], [`ScaleError::OutOfRange`] where it is negative or `u32` does not hold it, or
    /// [`ScaleError::RoundsToZero`].
    pub fn velocity(&self, velocity: f64) -> Result<u32, ScaleError> {
        unsigned(Quantity::Velocity, self.velocity, velocity)
    }

    /// An acceleration or deceleration as 6083h and 6084h take it.
    ///
    /// # Errors
    /// As [`velocity`](Self::velocity).
    pub fn acceleration(&self, acceleration: f64) -> Result<u32, ScaleError> {
        unsigned(Quantity::Acceleration, self.acceleration, acceleration)
    }

    /// A position or distance in the program's units.
    #[must_use]
    pub fn position_of(&self, counts: impl Into<i64>) -> f64 {
        self.position.divide(counts.into())
    }

    /// A velocity in the program's units/s.
    #[must_use]
    pub fn velocity_of(&self, counts: impl Into<i64>) -> f64 {
        self.velocity.divide(counts.into())
    }

    /// An acceleration in the program's units/s².
    #[must_use]
    pub fn acceleration_of(&self, counts: u32) -> f64 {
        self.acceleration.divide(counts.into())
    }

    /// A set-point in the drive's units.
    ///
    /// # Errors
    /// The first of its parameters that cannot be converted, with its object.
    pub fn set_point(&self, set_point: &ScaledSetPoint) -> Result<SetPoint, ScaleError> {
        Ok(SetPoint {
            start: set_point.start,
            parameters: Parameters {
                velocity: self.speed(Quantity::Velocity, set_point.velocity)?,
                end_velocity: self.speed(Quantity::EndVelocity, set_point.end_velocity)?,
                acceleration: self.ramp(Quantity::Acceleration, set_point.acceleration)?,
                deceleration: self.ramp(Quantity::Deceleration, set_point.deceleration)?,
                profile_type: set_point.profile_type,
            },
        })
    }

    /// A velocity without a direction, where there is one.
    pub(super) fn speed(
        &self,
        quantity: Quantity,
        asked: Option<f64>,
    ) -> Result<Option<u32>, ScaleError> {
        asked
            .map(|asked| unsigned(quantity, self.velocity, asked))
            .transpose()
    }

    /// An acceleration or deceleration, where there is one.
    pub(super) fn ramp(
        &self,
        quantity: Quantity,
        asked: Option<f64>,
    ) -> Result<Option<u32>, ScaleError> {
        asked
            .map(|asked| unsigned(quantity, self.acceleration, asked))
            .transpose()
    }
}

/// The parameters of a move in a program's own units, and when it starts. What is left out is what the drive holds.
///
/// ```
/// use servocrab::units::{Ratio, Scale, ScaledSetPoint};
/// let gentle = ScaledSetPoint::new().velocity(40.0).acceleration(200.0);
/// let counts = Scale::counts_per_unit(Ratio::new(1000, 1)?).set_point(&gentle)?;
/// assert_eq!(counts.parameters.velocity, Some(40_000));
/// # Ok::<(), servocrab::units::ScaleError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ScaledSetPoint {
    /// When the move starts.
    pub start: Start,
    /// Profile velocity 6081h, units/s; more than 0.
    pub velocity: Option<f64>,
    /// Profile acceleration 6083h, units/s²; more than 0.
    pub acceleration: Option<f64>,
    /// Profile deceleration 6084h, units/s²; more than 0.
    pub deceleration: Option<f64>,
    /// End velocity 6082h, units/s: the speed at the target.
    pub end_velocity: Option<f64>,
    /// Motion profile type 6086h.
    pub profile_type: Option<i16>,
}

impl ScaledSetPoint {
    /// Starts immediately, with the parameters that the drive holds.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            start: Start::Immediately,
            velocity: None,
            acceleration: None,
            deceleration: None,
            end_velocity: None,
            profile_type: None,
        }
    }

    /// With this profile velocity (6081h), units/s.
    #[must_use]
    pub const fn velocity(mut self, velocity: f64) -> Self {
        self.velocity = Some(velocity);
        self
    }

    /// With this profile acceleration (6083h), units/s².
    #[must_use]
    pub const fn acceleration(mut self, acceleration: f64) -> Self {
        self.acceleration = Some(acceleration);
        self
    }

    /// With this profile deceleration (6084h), units/s².
    #[must_use]
    pub const fn deceleration(mut self, deceleration: f64) -> Self {
        self.deceleration = Some(deceleration);
        self
    }

    /// With this end velocity (6082h), units/s.
    #[must_use]
    pub const fn end_velocity(mut self, end_velocity: f64) -> Self {
        self.end_velocity = Some(end_velocity);
        self
    }

    /// With this motion profile type (6086h): 0 linear ramps, 1 sin² ramps.
    #[must_use]
    pub const fn profile_type(mut self, profile_type: i16) -> Self {
        self.profile_type = Some(profile_type);
        self
    }

    /// Starting then.
    #[must_use]
    pub const fn start(mut self, start: Start) -> Self {
        self.start = start;
        self
    }
}

/// What a number is converted for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Target position 607Ah: a position or distance.
    Position,
    /// Profile velocity 6081h.
    Velocity,
    /// End velocity 6082h.
    EndVelocity,
    /// Profile acceleration 6083h.
    Acceleration,
    /// Profile deceleration 6084h.
    Deceleration,
    /// Target velocity 60FFh: the velocity of a jog.
    TargetVelocity,
    /// Speed during the search for the switch 6099h:1.
    HomingSwitchSpeed,
    /// Speed during the search for zero 6099h:2.
    HomingZeroSpeed,
    /// Homing acceleration 609Ah.
    HomingAcceleration,
    /// Home offset 607Ch.
    HomeOffset,
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "target position 607Ah",
            Self::Velocity => "profile velocity 6081h",
            Self::EndVelocity => "end velocity 6082h",
            Self::Acceleration => "profile acceleration 6083h",
            Self::Deceleration => "profile deceleration 6084h",
            Self::TargetVelocity => "target velocity 60FFh",
            Self::HomingSwitchSpeed => "homing speed 6099h:1",
            Self::HomingZeroSpeed => "homing speed 6099h:2",
            Self::HomingAcceleration => "homing acceleration 609Ah",
            Self::HomeOffset => "home offset 607Ch",
        })
    }
}

/// What is wrong with a number or a factor; nothing was sent.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScaleError {
    /// NaN or infinity.
    #[error("{asked} is no {quantity}: give a finite number")]
    NotFinite {
        /// What it was given for.
        quantity: Quantity,
        /// What was given.
        asked: f64,
    },
    /// The object's type does not hold the value.
    #[error(
        "{quantity} of {asked} is out of range: the object holds {min} to {max}, in the program's units"
    )]
    OutOfRange {
        /// What it was given for.
        quantity: Quantity,
        /// What was given, in the program's units.
        asked: f64,
        /// The least that the object holds, in the program's units.
        min: f64,
        /// The most that the object holds, in the program's units.
        max: f64,
    },
    /// A velocity or acceleration of less than half a unit of the drive, which is not 0.
    #[error("{quantity} of {asked} is less than the drive's smallest value: the least is {least}")]
    RoundsToZero {
        /// What it was given for.
        quantity: Quantity,
        /// What was given, in the program's units.
        asked: f64,
        /// One of the drive's units, in the program's units.
        least: f64,
    },
    /// A factor is not a finite number.
    #[error("a factor must be a finite number")]
    NotANumber,
    /// A factor is 0 or negative.
    #[error("a factor must be more than zero")]
    Zero,
    /// A factor needs more than 64 bits above or below the fraction line.
    #[error(
        "the factor is no fraction of two numbers of 64 bits: give it as one that is close to it"
    )]
    TooLong,
    /// A factor object of the drive is 0.
    #[error("the drive's factor {object} is zero: set it, or give the scale with the program")]
    ZeroFactor {
        /// The object, as of the drive's first axis.
        object: ObjectAddress,
    },
    /// The drive has none of the factor objects that define the scale.
    #[error("the drive has neither 6092h nor 608Fh (with 6093h): configure the scale explicitly")]
    NoFactors,
}

fn to_count(quantity: Quantity, ratio: Ratio, asked: f64) -> Result<Option<i64>, ScaleError> {
    if !asked.is_finite() {
        return Err(ScaleError::NotFinite { quantity, asked });
    }
    Ok(ratio.round(asked))
}

fn rounds_to_zero(quantity: Quantity, ratio: Ratio, asked: f64) -> ScaleError {
    ScaleError::RoundsToZero {
        quantity,
        asked,
        least: ratio.divide(1),
    }
}

fn signed(quantity: Quantity, ratio: Ratio, asked: f64) -> Result<i32, ScaleError> {
    to_count(quantity, ratio, asked)?
        .and_then(|count| i32::try_from(count).ok())
        .ok_or_else(|| ScaleError::OutOfRange {
            quantity,
            asked,
            min: ratio.divide(i32::MIN.into()),
            max: ratio.divide(i32::MAX.into()),
        })
}

fn unsigned(quantity: Quantity, ratio: Ratio, asked: f64) -> Result<u32, ScaleError> {
    let counts = to_count(quantity, ratio, asked)?;
    if counts == Some(0) && asked != 0.0 {
        return Err(rounds_to_zero(quantity, ratio, asked));
    }
    counts
        .and_then(|counts| u32::try_from(counts).ok())
        .ok_or_else(|| ScaleError::OutOfRange {
            quantity,
            asked,
            min: 0.0,
            max: ratio.divide(u32::MAX.into()),
        })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn mm() -> Scale {
        Scale::counts_per_unit(Ratio::new(1000, 1).unwrap())
            .velocity_counts_per_unit(Ratio::new(10, 1).unwrap())
            .acceleration_counts_per_unit(Ratio::new(1, 4).unwrap())
    }

    #[test]
    fn each_quantity_has_its_own_factor() {
        let counts = mm()
            .set_point(
                &ScaledSetPoint::new()
                    .velocity(1.25)
                    .end_velocity(0.0)
                    .acceleration(10.0)
                    .deceleration(14.0)
                    .profile_type(1)
                    .start(Start::Blend),
            )
            .unwrap();
        let expected = SetPoint::new()
            .velocity(13)
            .end_velocity(0)
            .acceleration(3)
            .deceleration(4)
            .profile_type(1)
            .start(Start::Blend);
        assert_eq!(counts, expected);
        assert_eq!(mm().position(-1.5), Ok(-1500));
        assert_eq!(mm().velocity_of(13), 1.3);
        assert_eq!(mm().acceleration_of(3), 12.0);
    }

    #[test]
    fn what_an_object_does_not_hold_is_refused_with_its_range() {
        let edge = f64::from(i32::MAX) / 1000.0;
        assert_eq!(mm().position(edge), Ok(i32::MAX));
        assert_eq!(
            mm().position(edge + 0.001),
            Err(ScaleError::OutOfRange {
                quantity: Quantity::Position,
                asked: edge + 0.001,
                min: -2_147_483.648,
                max: 2_147_483.647,
            })
        );
        assert!(mm().position(1e300).is_err());
        let refused = |set_point: ScaledSetPoint| mm().set_point(&set_point).unwrap_err();
        assert!(matches!(
            refused(ScaledSetPoint::new().velocity(-1.0)),
            ScaleError::OutOfRange {
                quantity: Quantity::Velocity,
                min: 0.0,
                ..
            }
        ));
        assert!(matches!(
            refused(ScaledSetPoint::new().acceleration(1e11)),
            ScaleError::OutOfRange {
                quantity: Quantity::Acceleration,
                ..
            }
        ));
        assert!(matches!(
            refused(ScaledSetPoint::new().deceleration(1.0)),
            ScaleError::RoundsToZero {
                quantity: Quantity::Deceleration,
                least: 4.0,
                ..
            }
        ));
        assert!(matches!(
            refused(ScaledSetPoint::new().end_velocity(f64::NAN)),
            ScaleError::NotFinite {
                quantity: Quantity::EndVelocity,
                ..
            }
        ));
        // 0 is a value that the drive knows; that it is no velocity of a move is for the axis to say.
        assert_eq!(mm().velocity(0.0), Ok(0));
    }

    proptest! {
        #[test]
        fn every_count_of_every_object_comes_back_from_its_value(
            numerator in 1..=u64::MAX,
            denominator in 1..=u64::MAX,
            position in any::<i32>(),
            unsigned in any::<u32>(),
        ) {
            let scale = Scale::counts_per_unit(Ratio::new(numerator, denominator).unwrap());
            prop_assert_eq!(scale.position(scale.position_of(position)), Ok(position));
            prop_assert_eq!(scale.velocity(scale.velocity_of(unsigned)), Ok(unsigned));
            prop_assert_eq!(scale.acceleration(scale.acceleration_of(unsigned)), Ok(unsigned));
        }

        #[test]
        fn a_mirrored_position_is_the_mirrored_count(value in -1e6..1e6_f64, counts in 1..5000_u64, units in 1..5000_u64) {
            let scale = Scale::counts_per_unit(Ratio::new(counts, units).unwrap());
            if let (Ok(there), Ok(mirrored)) = (scale.position(value), scale.position(-value)) {
                prop_assert_eq!(there, -mirrored);
            }
        }
    }
}
