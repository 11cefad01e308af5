//! Moves of an axis with a scale in front. They convert numbers on the way in and on the way out, and do nothing else.

use core::time::Duration;

use super::{Scale, ScaledMoveRequest, ScaledSetPoint, scaled_failure::in_units};
use crate::{
    axis::AxisError,
    profile_position::{Move, MoveRequest, Outcome, ProfilePosition},
};

/// The lease of an axis in Profile Position mode, with moves in a program's own units.
#[derive(Debug)]
pub struct ScaledProfilePosition {
    inner: ProfilePosition,
    scale: Scale,
}

impl ScaledProfilePosition {
    pub(super) const fn new(inner: ProfilePosition, scale: Scale) -> Self {
        Self { inner, scale }
    }

    pub(super) const fn scale(&self) -> Scale {
        self.scale
    }

    /// The lease itself.
    #[must_use]
    pub const fn inner(&self) -> &ProfilePosition {
        &self.inner
    }

    /// Moves to a position, as [`ProfilePosition::move_abs`].
    ///
    /// # Errors
    /// [`AxisErrorKind::Scale`](crate::axis::AxisErrorKind::Scale) for a number that cannot be converted: nothing was written then. Otherwise as
    /// [`ProfilePosition::move_abs`].
    pub async fn move_abs(
        &self,
        target: f64,
        set_point: ScaledSetPoint,
    ) -> Result<ScaledMove, AxisError> {
        let (target, set_point) = self.convert(target, &set_point)?;
        self.moved(self.inner.move_abs(target, set_point).await)
    }

    /// Moves by a distance, as [`ProfilePosition::move_rel`]. Each distance is rounded by itself: many of them add up to as
    /// many roundings, which absolute targets do not.
    ///
    /// # Errors
    /// As [`move_abs`](Self::move_abs).
    pub async fn move_rel(
        &self,
        distance: f64,
        set_point: ScaledSetPoint,
    ) -> Result<ScaledMove, AxisError> {
        let (distance, set_point) = self.convert(distance, &set_point)?;
        self.moved(self.inner.move_rel(distance, set_point).await)
    }

    /// A move to a position that is not sent yet, for [`together`](super::together) and [`follow`](Self::follow).
    ///
    /// # Errors
    /// [`AxisErrorKind::Scale`](crate::axis::AxisErrorKind::Scale).
    pub fn abs(
        &self,
        target: f64,
        set_point: ScaledSetPoint,
    ) -> Result<ScaledMoveRequest, AxisError> {
        let (target, set_point) = self.convert(target, &set_point)?;
        Ok(self.request(self.inner.abs(target, set_point)))
    }

    /// A move by a distance that is not sent yet, for [`together`](super::together) and [`follow`](Self::follow).
    ///
    /// # Errors
    /// [`AxisErrorKind::Scale`](crate::axis::AxisErrorKind::Scale).
    pub fn rel(
        &self,
        distance: f64,
        set_point: ScaledSetPoint,
    ) -> Result<ScaledMoveRequest, AxisError> {
        let (distance, set_point) = self.convert(distance, &set_point)?;
        Ok(self.request(self.inner.rel(distance, set_point)))
    }

    const fn request(&self, inner: MoveRequest) -> ScaledMoveRequest {
        ScaledMoveRequest::new(inner, self.scale)
    }

    /// As [`ProfilePosition::release`].
    ///
    /// # Errors
    /// As [`ProfilePosition::release`].
    pub async fn release(self) -> Result<(), AxisError> {
        self.inner.release().await
    }

    fn convert(
        &self,
        target: f64,
        set_point: &ScaledSetPoint,
    ) -> Result<(i32, crate::profile_position::SetPoint), AxisError> {
        let converted = self
            .scale
            .position(target)
            .and_then(|target| Ok((target, self.scale.set_point(set_point)?)));
        converted.map_err(|error| self.inner.axis().scale_error(error))
    }

    fn moved(&self, moved: Result<Move, AxisError>) -> Result<ScaledMove, AxisError> {
        moved
            .map(|inner| ScaledMove::new(inner, self.scale))
            .map_err(|error| in_units(error, self.scale))
    }
}

/// A move that the drive has acknowledged, with its outcome in a program's own units.
#[must_use = "await `done()` for the outcome"]
#[derive(Debug)]
pub struct ScaledMove {
    inner: Move,
    scale: Scale,
}

impl ScaledMove {
    pub(super) const fn new(inner: Move, scale: Scale) -> Self {
        Self { inner, scale }
    }

    /// The move itself.
    pub const fn inner(&self) -> &Move {
        &self.inner
    }

    /// As [`Move::done`].
    ///
    /// # Errors
    /// As [`Move::done`], with positions in the program's units.
    pub async fn done(&self) -> Result<ScaledOutcome, AxisError> {
        self.outcome(self.inner.done().await)
    }

    /// As [`Move::done`] with [`Done::within`](crate::profile_position::Done::within).
    ///
    /// # Errors
    /// As [`done`](Self::done), and [`AxisErrorKind::Late`](crate::axis::AxisErrorKind::Late).
    pub async fn done_within(&self, deadline: Duration) -> Result<ScaledOutcome, AxisError> {
        self.outcome(self.inner.done().within(deadline).await)
    }

    /// As [`Move::done_through_halt`].
    ///
    /// # Errors
    /// As [`done`](Self::done).
    pub async fn done_through_halt(&self) -> Result<ScaledOutcome, AxisError> {
        self.outcome(self.inner.done_through_halt().await)
    }

    /// As [`Move::halt_on_drop`].
    pub fn halt_on_drop(self) -> Self {
        Self::new(self.inner.halt_on_drop(), self.scale)
    }

    fn outcome(&self, outcome: Result<Outcome, AxisError>) -> Result<ScaledOutcome, AxisError> {
        outcome
            .map(|outcome| in_scale(outcome, self.scale))
            .map_err(|error| in_units(error, self.scale))
    }
}

pub(super) fn in_scale(outcome: Outcome, scale: Scale) -> ScaledOutcome {
    match outcome {
        Outcome::Reached { position } => ScaledOutcome::Reached {
            position: scale.position_of(position),
        },
        Outcome::Passed { position } => ScaledOutcome::Passed {
            position: scale.position_of(position),
        },
    }
}

/// How a move ended well, in a program's own units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ScaledOutcome {
    /// It arrived at its target and nothing followed it in motion.
    Reached {
        /// Position actual value 6064h when it was seen, units.
        position: f64,
    },
    /// It passed its target without stopping, into the next one.
    Passed {
        /// Position actual value 6064h when it was seen, units.
        position: f64,
    },
}

impl core::fmt::Display for ScaledOutcome {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Reached { position } => write!(f, "reached {position}"),
            Self::Passed { position } => write!(f, "passed {position}"),
        }
    }
}

impl ScaledOutcome {
    /// Position actual value 6064h when the outcome was seen, units.
    #[must_use]
    pub const fn position(&self) -> f64 {
        match *self {
            Self::Reached { position } | Self::Passed { position } => position,
        }
    }
}
