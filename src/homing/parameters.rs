//! What one homing asks of a drive.

use core::time::Duration;

use super::HomingMethod;

/// The method of a homing, and its speeds, acceleration and offset. What is left out is what the drive holds.
///
/// ```
/// use servocrab::homing::{HomingMethod, HomingParameters};
/// let slow = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
///     .speeds(10_000, 1_000)
///     .acceleration(50_000)
///     .offset(-2_500);
/// assert_eq!(slow.offset, Some(-2_500));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct HomingParameters {
    /// Homing method 6098h.
    pub method: HomingMethod,
    /// Speed during the search for the switch 6099h:1, velocity units; more than 0.
    pub switch_speed: Option<u32>,
    /// Speed during the search for zero 6099h:2, velocity units; more than 0.
    pub zero_speed: Option<u32>,
    /// Homing acceleration 609Ah, acceleration units; more than 0.
    pub acceleration: Option<u32>,
    /// Home offset 607Ch, position units. How it enters 6064h differs from drive to drive.
    pub offset: Option<i32>,
}

impl HomingParameters {
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

    /// With these speeds during the search for the switch (6099h:1) and for zero (6099h:2), velocity units.
    #[must_use]
    pub const fn speeds(mut self, switch: u32, zero: u32) -> Self {
        self.switch_speed = Some(switch);
        self.zero_speed = Some(zero);
        self
    }

    /// With this acceleration (609Ah), acceleration units.
    #[must_use]
    pub const fn acceleration(mut self, acceleration: u32) -> Self {
        self.acceleration = Some(acceleration);
        self
    }

    /// With this home offset (607Ch), position units.
    #[must_use]
    pub const fn offset(mut self, offset: i32) -> Self {
        self.offset = Some(offset);
        self
    }
}

impl From<HomingMethod> for HomingParameters {
    fn from(method: HomingMethod) -> Self {
        Self::new(method)
    }
}

/// One homing as the axis core takes it. The drive holds its parameters already.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct HomingCommand {
    /// The method that 6098h holds: some show no motion.
    pub method: HomingMethod,
    /// Home offset 607Ch, where it is known. The software position limits 607Dh are counted from there. By it a method that moves
    /// nothing is recognized as done; where it is not known, it is taken for 0 there.
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
