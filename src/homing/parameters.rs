//! What one homing asks of a drive.

use core::time::Duration;

use crate::units::{AxisUnit, Counts, Quantity, Scale, ScaleError};

/// The method of a homing, and its speeds, acceleration and offset in the unit of the axis: whole numbers for [`Counts`], `f64` for
/// others. What is left out is what the drive holds.
///
/// ```
/// use servocrab::{HomingMethod, HomingParameters, units::Mm};
/// let slow: HomingParameters = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
///     .speeds(10_000, 1_000)
///     .acceleration(50_000)
///     .offset(-2_500);
/// assert_eq!(slow.offset, Some(-2_500));
/// let in_mm: HomingParameters<Mm> = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT).speeds(10.0, 1.5);
/// assert_eq!(in_mm.zero_speed, Some(1.5));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct HomingParameters<U: AxisUnit = Counts> {
    /// Homing method 6098h.
    pub method: HomingMethod,
    /// Speed during the search for the switch 6099h:1; more than 0.
    pub switch_speed: Option<U::Magnitude>,
    /// Speed during the search for zero 6099h:2; more than 0.
    pub zero_speed: Option<U::Magnitude>,
    /// Homing acceleration 609Ah; more than 0.
    pub acceleration: Option<U::Magnitude>,
    /// Home offset 607Ch. How it enters 6064h differs from drive to drive.
    pub offset: Option<U::Signed>,
}

impl<U: AxisUnit> HomingParameters<U> {
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

    /// With these speeds during the search for the switch (6099h:1) and for zero (6099h:2).
    #[must_use]
    pub const fn speeds(mut self, switch: U::Magnitude, zero: U::Magnitude) -> Self {
        self.switch_speed = Some(switch);
        self.zero_speed = Some(zero);
        self
    }

    /// With this acceleration (609Ah).
    #[must_use]
    pub const fn acceleration(mut self, acceleration: U::Magnitude) -> Self {
        self.acceleration = Some(acceleration);
        self
    }

    /// With this home offset (607Ch).
    #[must_use]
    pub const fn offset(mut self, offset: U::Signed) -> Self {
        self.offset = Some(offset);
        self
    }

    /// The same in the drive's units.
    ///
    /// # Errors
    /// The first of its numbers that cannot be converted, with its object.
    pub fn in_counts(&self, scale: &Scale) -> Result<HomingParameters, ScaleError> {
        let offset = self.offset.map(|offset| scale.home_offset(offset.into()));
        Ok(HomingParameters {
            method: self.method,
            switch_speed: scale.speed(Quantity::HomingSwitchSpeed, self.switch_speed)?,
            zero_speed: scale.speed(Quantity::HomingZeroSpeed, self.zero_speed)?,
            acceleration: scale.ramp(Quantity::HomingAcceleration, self.acceleration)?,
            offset: offset.transpose()?,
        })
    }
}

impl<U: AxisUnit> From<HomingMethod> for HomingParameters<U> {
    fn from(method: HomingMethod) -> Self {
        Self::new(method)
    }
}

/// One homing as the axis core takes it. The drive holds its parameters already.
///
/// ```
/// use core::time::Duration;
/// use servocrab::{HomingMethod, axis::Command, homing::HomingCommand};
/// let homing = HomingCommand {
///     method: HomingMethod::CURRENT_POSITION,
///     offset: Some(0),
///     until: Some(Duration::from_secs(5)),
/// };
/// let command = Command::Home(homing);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct HomingCommand {
    /// The method that 6098h holds: some show no motion.
    pub method: HomingMethod,
    /// Home offset 607Ch, where it is known. The software position limits 607Dh are counted from there. By it a method that moves
    /// nothing is recognized as done; where it is not known, it counts as 0 there.
    pub offset: Option<i32>,
    /// When it is to have ended, by the clock of [`AxisCore::step`](crate::axis::AxisCore::step); none for a travel without a limit.
    /// A homing that has not ended then is stopped: bit 8, then quick stop.
    pub until: Option<Duration>,
}

impl HomingCommand {
    /// Whether it is to have ended by now.
    pub(super) fn is_late(&self, now: Duration) -> bool {
        self.until.is_some_and(|until| now >= until)
    }
}

// Homing methods, object 6098h.

/// How the drive looks for its home position: the value of object 6098h (CiA DSP 402 v2.0, 13.4; CiA 402-2 for 37).
/// Which of them a drive has is in its manual. It refuses others by SDO abort, or by a homing error (bit 13) when it is to begin.
///
/// ```
/// use servocrab::HomingMethod;
/// assert_eq!(HomingMethod(37), HomingMethod::CURRENT_POSITION);
/// assert!(!HomingMethod::NEGATIVE_LIMIT.is_motionless());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct HomingMethod(
    /// The number: 1 to 37 are the standard's, negative ones the manufacturer's.
    pub i8,
);

impl HomingMethod {
    /// 1: to the negative limit switch, then to the first index pulse on its positive side.
    pub const NEGATIVE_LIMIT_AND_INDEX: Self = Self(1);
    /// 2: to the positive limit switch, then to the first index pulse on its negative side.
    pub const POSITIVE_LIMIT_AND_INDEX: Self = Self(2);
    /// 17: the edge of the negative limit switch.
    pub const NEGATIVE_LIMIT: Self = Self(17);
    /// 18: the edge of the positive limit switch.
    pub const POSITIVE_LIMIT: Self = Self(18);
    /// 33: the next index pulse in negative direction.
    pub const INDEX_NEGATIVE: Self = Self(33);
    /// 34: the next index pulse in positive direction.
    pub const INDEX_POSITIVE: Self = Self(34);
    /// 35: where the axis stands is home, in drives after the older editions. Nothing moves.
    pub const CURRENT_POSITION_OLD: Self = Self(35);
    /// 37: where the axis stands is home. Nothing moves.
    pub const CURRENT_POSITION: Self = Self(37);

    /// Whether the method takes the position as it is: 35 and 37.
    #[must_use]
    pub const fn is_motionless(self) -> bool {
        matches!(self, Self::CURRENT_POSITION_OLD | Self::CURRENT_POSITION)
    }
}

#[cfg(test)]
mod unit_tests {
    use super::*;
    use crate::units::{Mm, example as mm};

    const SEARCH: HomingParameters<Mm> = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT);

    #[test]
    fn each_parameter_has_the_factor_of_its_quantity_and_what_is_left_out_stays_out() {
        let asked = SEARCH.speeds(1.25, 0.5).acceleration(10.0).offset(-2.5);
        let expected = HomingParameters::new(SEARCH.method)
            .speeds(13, 5)
            .acceleration(3)
            .offset(-2_500);
        assert_eq!(asked.in_counts(&mm()), Ok(expected));
        assert_eq!(SEARCH.in_counts(&mm()), Ok(SEARCH.method.into()));
    }

    #[test]
    fn what_cannot_be_converted_is_refused_by_the_name_of_its_object() {
        for (asked, words) in [
            (
                SEARCH.speeds(-1.0, 1.0),
                "homing speed 6099h:1 of -1 is out",
            ),
            (
                SEARCH.speeds(1.0, 0.04),
                "homing speed 6099h:2 of 0.04 is less than",
            ),
            (
                SEARCH.acceleration(f64::NAN),
                "NaN is no homing acceleration 609Ah",
            ),
            (SEARCH.offset(3e6), "home offset 607Ch of 3000000 is out"),
        ] {
            let text = alloc::format!("{}", asked.in_counts(&mm()).unwrap_err());
            assert!(text.contains(words), "{text}");
        }
        // That 0 is no speed is for the homing to say.
        let standing = SEARCH.speeds(0.0, 1.0).in_counts(&mm()).unwrap();
        assert_eq!(standing.switch_speed, Some(0));
    }
}
