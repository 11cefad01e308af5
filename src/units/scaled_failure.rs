//! Failures of an axis in a program's own units.

use core::fmt;

use super::Scale;
use crate::axis::{AxisError, AxisErrorKind, Failure};

/// A failure that names positions or velocities, in a program's own units.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ScaledFailure {
    /// The failure, in the drive's units.
    pub failure: Failure,
    /// The scale of the axis.
    pub scale: Scale,
}

impl fmt::Display for ScaledFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scale = &self.scale;
        match self.failure {
            Failure::MissedTarget { target, actual } => write!(
                f,
                "the drive reports its target reached but stands at {} instead of {}: look for a limit in the drive",
                scale.position_of(actual),
                scale.position_of(target)
            ),
            Failure::Unseen { target, actual } => write!(
                f,
                "the drive has gone on to the next move while nothing was seen of the axis, which is at {}: whether it was at {} is not known",
                scale.position_of(actual),
                scale.position_of(target)
            ),
            Failure::EndNotKnown { actual } => write!(
                f,
                "the drive reports its target reached at {}, which is not where the distance leads from where the axis was: it counts from elsewhere or has limited the move; look for a limit in the drive",
                scale.position_of(actual)
            ),
            Failure::NotBegun { actual } => write!(
                f,
                "the drive has acknowledged the move and has not begun it, the axis stands at {}: it may begin at any time; stop() it, and look for a brake or an input that holds it",
                scale.position_of(actual)
            ),
            Failure::Unconfirmed { target, actual } => write!(
                f,
                "the drive has not acknowledged the move, its buffer was full, and stands at {} instead of {}: it may not have taken it",
                scale.position_of(actual),
                scale.position_of(target)
            ),
            Failure::PerhapsSuperseded { actual } => write!(
                f,
                "the axis stands at {}, and a later move that the drive has not acknowledged may have taken this one's place: stop() before the next",
                scale.position_of(actual)
            ),
            Failure::BeyondLimit {
                object,
                limit,
                target,
            } => write!(
                f,
                "the target {} lies beyond the limit {} of {object}: move within it, or change it and read the limits again",
                scale.position_of(target),
                scale.position_of(limit)
            ),
            Failure::TooFast { limit, velocity } => write!(
                f,
                "the velocity {} is above max profile velocity 607Fh, {}: the drive would not go as fast",
                scale.velocity_of(velocity),
                scale.velocity_of(limit)
            ),
            failure => failure.fmt(f),
        }
    }
}

pub(super) fn in_units(error: AxisError, scale: Scale) -> AxisError {
    match error.kind {
        AxisErrorKind::Failed(
            failure @ (Failure::MissedTarget { .. }
            | Failure::Unseen { .. }
            | Failure::NotBegun { .. }
            | Failure::EndNotKnown { .. }
            | Failure::Unconfirmed { .. }
            | Failure::PerhapsSuperseded { .. }
            | Failure::BeyondLimit { .. }
            | Failure::TooFast { .. }),
        ) => AxisError {
            kind: AxisErrorKind::Scaled(ScaledFailure { failure, scale }),
            ..error
        },
        _ => error,
    }
}
