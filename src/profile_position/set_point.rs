//! What one move asks of a drive.

/// When a move starts, seen from the move that is under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Start {
    /// Now: the active move is replaced and queued ones are dropped (PLCopen Aborting).
    #[default]
    Immediately,
    /// After the active move has stopped at its target (PLCopen Buffered).
    AfterCurrent,
    /// At the active move's target, without stopping there (PLCopen BlendingPrevious).
    Blend,
}

/// Whether 607Ah is a position or a distance: bit 6 of the controlword.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Reference {
    /// A position.
    Absolute,
    /// A distance from the base that the drive documents (60F2h).
    Relative,
}

/// The parameters of a move and when it starts. What is left out is what the drive holds.
///
/// ```
/// use servocrab::profile_position::{SetPoint, Start};
/// let gentle = SetPoint::new().velocity(5_000).acceleration(20_000).start(Start::AfterCurrent);
/// assert_eq!(gentle.start, Start::AfterCurrent);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct SetPoint {
    /// When the move starts.
    pub start: Start,
    /// Velocity, ramps and profile.
    pub parameters: Parameters,
}

/// Velocity, ramps and profile type of a move, in the drive's own units.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Parameters {
    /// Profile velocity 6081h, velocity units; more than 0.
    pub velocity: Option<u32>,
    /// Profile acceleration 6083h, acceleration units; more than 0.
    pub acceleration: Option<u32>,
    /// Profile deceleration 6084h, acceleration units; more than 0.
    pub deceleration: Option<u32>,
    /// End velocity 6082h, velocity units: the speed at the target.
    pub end_velocity: Option<u32>,
    /// Motion profile type 6086h.
    pub profile_type: Option<i16>,
}

impl SetPoint {
    /// Starts immediately, with the parameters that the drive holds.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            start: Start::Immediately,
            parameters: Parameters {
                velocity: None,
                acceleration: None,
                deceleration: None,
                end_velocity: None,
                profile_type: None,
            },
        }
    }

    /// With this profile velocity (6081h), in the drive's velocity units.
    #[must_use]
    pub const fn velocity(mut self, velocity: u32) -> Self {
        self.parameters.velocity = Some(velocity);
        self
    }

    /// With this profile acceleration (6083h), in the drive's acceleration units.
    #[must_use]
    pub const fn acceleration(mut self, acceleration: u32) -> Self {
        self.parameters.acceleration = Some(acceleration);
        self
    }

    /// With this profile deceleration (6084h), in the drive's acceleration units.
    #[must_use]
    pub const fn deceleration(mut self, deceleration: u32) -> Self {
        self.parameters.deceleration = Some(deceleration);
        self
    }

    /// With this end velocity (6082h), in the drive's velocity units.
    #[must_use]
    pub const fn end_velocity(mut self, end_velocity: u32) -> Self {
        self.parameters.end_velocity = Some(end_velocity);
        self
    }

    /// With this motion profile type (6086h): 0 linear ramps, 1 sin² ramps.
    #[must_use]
    pub const fn profile_type(mut self, profile_type: i16) -> Self {
        self.parameters.profile_type = Some(profile_type);
        self
    }

    /// Starting then.
    #[must_use]
    pub const fn start(mut self, start: Start) -> Self {
        self.start = start;
        self
    }
}

/// One move as the axis core takes it: a set-point with its target.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct MoveCommand {
    /// Position or distance.
    pub reference: Reference,
    /// Target position 607Ah: a position or a distance in the drive's position units.
    pub target: i32,
    /// Parameters and start.
    pub set_point: SetPoint,
    /// Held until fired: the bit 4 of several axes shall rise in one cycle.
    pub gated: bool,
}
