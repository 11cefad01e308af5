//! What one jog asks of a drive.

/// A velocity and the ramps to it. Ramps that are left out are what the drive holds.
///
/// ```
/// use servocrab::profile_velocity::JogSetPoint;
/// let backwards = JogSetPoint::new(-5_000).acceleration(20_000).deceleration(40_000);
/// assert_eq!(backwards.velocity, -5_000);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct JogSetPoint {
    /// Target velocity 60FFh, velocity units; its sign is the direction, and 0 stands.
    pub velocity: i32,
    /// Profile acceleration 6083h, acceleration units; more than 0.
    pub acceleration: Option<u32>,
    /// Profile deceleration 6084h, acceleration units; more than 0.
    pub deceleration: Option<u32>,
}

impl JogSetPoint {
    /// This velocity (60FFh, velocity units), with the ramps that the drive holds.
    #[must_use]
    pub const fn new(velocity: i32) -> Self {
        Self {
            velocity,
            acceleration: None,
            deceleration: None,
        }
    }

    /// With this profile acceleration (6083h), acceleration units.
    #[must_use]
    pub const fn acceleration(mut self, acceleration: u32) -> Self {
        self.acceleration = Some(acceleration);
        self
    }

    /// With this profile deceleration (6084h), acceleration units.
    #[must_use]
    pub const fn deceleration(mut self, deceleration: u32) -> Self {
        self.deceleration = Some(deceleration);
        self
    }
}

impl From<i32> for JogSetPoint {
    fn from(velocity: i32) -> Self {
        Self::new(velocity)
    }
}
