//! What one homing asks of a drive, in a program's own units.

use super::{Quantity, Scale, ScaleError};
use crate::homing::{HomingMethod, HomingParameters};

/// The method of a homing, and its speeds, acceleration and offset in a program's own units. What is left out is what the drive
/// holds.
///
/// ```
/// use servocrab::{homing::HomingMethod, units::{Ratio, Scale, ScaledHomingParameters}};
/// let slow = ScaledHomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
///     .speeds(10.0, 1.5)
///     .offset(-2.5);
/// let counts = Scale::counts_per_unit(Ratio::new(1000, 1)?).homing(&slow)?;
/// assert_eq!((counts.switch_speed, counts.zero_speed), (Some(10_000), Some(1_500)));
/// assert_eq!(counts.offset, Some(-2_500));
/// # Ok::<(), servocrab::units::ScaleError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaledHomingParameters {
    /// Homing method 6098h.
    pub method: HomingMethod,
    /// Speed during the search for the switch 6099h:1, units/s; more than 0.
    pub switch_speed: Option<f64>,
    /// Speed during the search for zero 6099h:2, units/s; more than 0.
    pub zero_speed: Option<f64>,
    /// Homing acceleration 609Ah, units/s²; more than 0.
    pub acceleration: Option<f64>,
    /// Home offset 607Ch, units. How it enters 6064h differs from drive to drive.
    pub offset: Option<f64>,
}

impl ScaledHomingParameters {
    /// This method, with the speeds, acceleration and offset that the drive holds.
    #[must_use]
    pub const fn new(method: HomingMethod) -> Self {
        Self {
            method,
            switch_speed: None,
            zero_speed: None,
            acceleration: None,
            offset: None,
        }
    }

    /// With these speeds during the search for the switch (6099h:1) and for zero (6099h:2), units/s.
    #[must_use]
    pub const fn speeds(mut self, switch: f64, zero: f64) -> Self {
        self.switch_speed = Some(switch);
        self.zero_speed = Some(zero);
        self
    }

    /// With this acceleration (609Ah), units/s².
    #[must_use]
    pub const fn acceleration(mut self, acceleration: f64) -> Self {
        self.acceleration = Some(acceleration);
        self
    }

    /// With this home offset (607Ch), units.
    #[must_use]
    pub const fn offset(mut self, offset: f64) -> Self {
        self.offset = Some(offset);
        self
    }
}

impl From<HomingMethod> for ScaledHomingParameters {
    fn from(method: HomingMethod) -> Self {
        Self::new(method)
    }
}

impl Scale {
    /// The parameters of a homing in the drive's units.
    ///
    /// # Errors
    /// The first of them that cannot be converted, with its object.
    pub fn homing(
        &self,
        parameters: &ScaledHomingParameters,
    ) -> Result<HomingParameters, ScaleError> {
        let offset = parameters.offset.map(|offset| self.home_offset(offset));
        Ok(HomingParameters {
            method: parameters.method,
            switch_speed: self.speed(Quantity::HomingSwitchSpeed, parameters.switch_speed)?,
            zero_speed: self.speed(Quantity::HomingZeroSpeed, parameters.zero_speed)?,
            acceleration: self.ramp(Quantity::HomingAcceleration, parameters.acceleration)?,
            offset: offset.transpose()?,
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
    fn each_parameter_has_the_factor_of_its_quantity_and_what_is_left_out_stays_out() {
        let method = HomingMethod::NEGATIVE_LIMIT;
        let asked = ScaledHomingParameters::new(method)
            .speeds(1.25, 0.5)
            .acceleration(10.0)
            .offset(-2.5);
        let expected = HomingParameters::new(method)
            .speeds(13, 5)
            .acceleration(3)
            .offset(-2_500);
        assert_eq!(mm().homing(&asked), Ok(expected));
        assert_eq!(mm().homing(&method.into()), Ok(method.into()));
    }

    #[test]
    fn what_cannot_be_converted_is_refused_by_the_name_of_its_object() {
        let asked = ScaledHomingParameters::new(HomingMethod::NEGATIVE_LIMIT);
        let refused = |asked: ScaledHomingParameters| mm().homing(&asked).unwrap_err().to_string();
        for (asked, words) in [
            (asked.speeds(-1.0, 1.0), "homing speed 6099h:1 of -1 is out"),
            (
                asked.speeds(1.0, 0.04),
                "homing speed 6099h:2 of 0.04 is less than",
            ),
            (
                asked.acceleration(f64::NAN),
                "NaN is no homing acceleration 609Ah",
            ),
            (asked.offset(3e6), "home offset 607Ch of 3000000 is out"),
        ] {
            let text = refused(asked);
            assert!(text.contains(words), "{text}");
        }
        // That 0 is no speed is for the homing to say.
        assert_eq!(
            mm().homing(&asked.speeds(0.0, 1.0)).unwrap().switch_speed,
            Some(0)
        );
    }
}
