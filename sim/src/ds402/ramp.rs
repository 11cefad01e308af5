//! The ramps of a trajectory, and what bounds them.
//!
//! A ramp is linear, or the velocity follows sin² of the time (6086h = 1). A sin² ramp whose steepest point has the rate
//! that was given takes π/2 as long as the linear one, and as much way as a linear one with 2/π of that rate: plans are
//! made with this mean rate.

/// What bounds a trajectory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bounds {
    /// Counts/s.
    pub(super) velocity: f64,
    /// Counts/s at the target, in the direction of travel.
    pub(super) end_velocity: f64,
    /// Counts/s².
    pub(super) acceleration: f64,
    /// Counts/s².
    pub(super) deceleration: f64,
    /// How the velocity rises and falls within these.
    pub(super) shape: Shape,
}

/// How the velocity changes in a ramp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Shape {
    /// With constant acceleration.
    #[default]
    Linear,
    /// As sin²: the acceleration begins and ends at 0.
    SinSquared,
}

impl Shape {
    /// The mean rate of a ramp that is nowhere steeper than `rate`.
    pub(super) fn mean(self, rate: f64) -> f64 {
        match self {
            Shape::Linear => rate,
            Shape::SinSquared => rate * core::f64::consts::FRAC_2_PI,
        }
    }
}

impl Bounds {
    /// Whether a motion within these bounds ever gets anywhere.
    pub(super) fn can_move(&self) -> bool {
        self.velocity > 0.0 && self.acceleration > 0.0 && self.deceleration > 0.0
    }
}

/// A part of a trajectory: from one velocity to another, or at one.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Segment {
    /// Counts/s.
    pub(super) from: f64,
    /// Counts/s.
    pub(super) to: f64,
    /// Seconds.
    pub(super) time: f64,
    pub(super) shape: Shape,
}

impl Segment {
    /// Way and velocity after a time that is not longer than the segment.
    pub(super) fn after(&self, t: f64) -> (f64, f64) {
        let change = self.to - self.from;
        let share = t / self.time;
        match self.shape {
            Shape::Linear => {
                let velocity = self.from + change * share;
                ((self.from + velocity) * 0.5 * t, velocity)
            }
            Shape::SinSquared => {
                let angle = core::f64::consts::PI * share;
                let velocity = self.from + change * 0.5 * (1.0 - angle.cos());
                let swing = angle.sin() * self.time / core::f64::consts::TAU;
                (self.from * t + change * (0.5 * t - swing), velocity)
            }
        }
    }
}
