//! What one jog asks of a drive, in a program's own units.

use super::{Quantity, Scale, ScaleError};
use crate::profile_velocity::JogSetPoint;

/// A velocity and the ramps to it, in a program's own units. Ramps that are left out are what the drive holds.
///
/// ```
/// use servocrab::units::{Ratio, Scale, ScaledJogSetPoint};
/// let backwards = ScaledJogSetPoint::new(-5.0).acceleration(20.0);
/// let counts = Scale::counts_per_unit(Ratio::new(1000, 1)?).jog(&backwards)?;
/// assert_eq!((counts.velocity, counts.acceleration), (-5_000, Some(20_000)));
/// # Ok::<(), servocrab::units::ScaleError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaledJogSetPoint {
    /// Target velocity 60FFh, units/s; its sign is the direction, and 0 stands.
    pub velocity: f64,
    /// Profile acceleration 6083h, units/s²; more than 0.
    pub acceleration: Option<f64>,
    /// Profile deceleration 6084h, units/s²; more than 0.
    pub deceleration: Option<f64>,
}

impl ScaledJogSetPoint {
    /// This velocity (60FFh, units/s), with the ramps that the drive holds.
    #[must_use]
    pub const fn new(velocity: f64) -> Self {
        Self {
            velocity,
            acceleration: None,
            deceleration: None,
        }
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
}

impl From<f64> for ScaledJogSetPoint {
    fn from(velocity: f64) -> Self {
        Self::new(velocity)
    }
}

impl Scale {
    /// What a jog asks for, in the drive's units.
    ///
    /// # Errors
    /// The first of its numbers that cannot be converted, with its object.
    pub fn jog(&self, set_point: &ScaledJogSetPoint) -> Result<JogSetPoint, ScaleError> {
        Ok(JogSetPoint {
            velocity: self.target_velocity(set_point.velocity)?,
            acceleration: self.ramp(Quantity::Acceleration, set_point.acceleration)?,
            deceleration: self.ramp(Quantity::Deceleration, set_point.deceleration)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Ratio;

    fn mm() -> Scale {
        Scale::counts_per_unit(Ratio::new(1000, 1).unwrap())
            .velocity_counts_per_unit(Ratio::new(10, 1).unwrap())
            .acceleration_counts_per_unit(Ratio::new(1, 4).unwrap())
    }

    #[test]
    fn a_velocity_keeps_its_direction_and_each_ramp_has_the_factor_of_accelerations() {
        let asked = ScaledJogSetPoint::new(-1.25)
            .acceleration(10.0)
            .deceleration(14.0);
        let expected = JogSetPoint::new(-13).acceleration(3).deceleration(4);
        assert_eq!(mm().jog(&asked), Ok(expected));
        assert_eq!(mm().jog(&1.25.into()), Ok(13.into()));
    }

    #[test]
    fn a_velocity_that_would_stand_or_be_another_is_refused_and_zero_is_not() {
        for velocity in [0.04, -0.04] {
            let refused = mm().target_velocity(velocity);
            assert!(
                matches!(
                    refused,
                    Err(ScaleError::RoundsToZero {
                        quantity: Quantity::TargetVelocity,
                        asked,
                        least: 0.1,
                    }) if asked == velocity
                ),
                "{refused:?}"
            );
        }
        assert_eq!(mm().target_velocity(0.0), Ok(0));
        for velocity in [1e9, -1e9, f64::INFINITY, f64::NAN] {
            assert!(mm().target_velocity(velocity).is_err(), "{velocity}");
        }
        let ramp = ScaledJogSetPoint::new(1.0).deceleration(-10.0);
        assert!(matches!(
            mm().jog(&ramp),
            Err(ScaleError::OutOfRange {
                quantity: Quantity::Deceleration,
                ..
            })
        ));
    }
}
