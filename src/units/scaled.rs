//! An axis and its moves with a scale in front: numbers are converted on the way in and on the way out, and that is all.

use core::time::Duration;

use super::{Edition, Factors, Ratio, Scale, ScaleError, ScaledSetPoint, scaled_failure::in_units};
use crate::{
    axis::{Axis, AxisError, AxisErrorKind, Snapshot},
    coe::{Object, ReadWrite, obj},
    profile_position::{Move, MoveRequest, Outcome, ProfilePosition},
};

impl Axis {
    /// This axis in a program's own units.
    #[must_use]
    pub fn scaled(&self, scale: Scale) -> ScaledAxis {
        ScaledAxis {
            axis: self.clone(),
            scale,
        }
    }

    /// Reads the factor objects 608Fh, 6091h, 6092h, 6096h and 6097h of this axis by SDO, and 6093h and 6094h of older
    /// drives: a drive that has 6093h is taken to follow [`Edition::Version2`]. Objects that the drive does not have are
    /// left out.
    ///
    /// # Errors
    /// [`AxisErrorKind::Sdo`] if an object could not be read, [`ScaleError::ZeroFactor`] if one is 0.
    pub async fn factors(&self) -> Result<Factors, AxisError> {
        let position = self
            .factor(obj::POSITION_FACTOR_NUMERATOR, obj::POSITION_FACTOR_DIVISOR)
            .await?;
        let edition = if position.is_some() {
            Edition::Version2
        } else {
            Edition::Version3
        };
        Ok(Factors {
            edition,
            encoder: self
                .factor(obj::ENCODER_INCREMENTS, obj::ENCODER_REVOLUTIONS)
                .await?,
            gear: self
                .factor(obj::GEAR_MOTOR_REVOLUTIONS, obj::GEAR_SHAFT_REVOLUTIONS)
                .await?,
            feed: self.factor(obj::FEED, obj::FEED_SHAFT_REVOLUTIONS).await?,
            position,
            velocity_encoder: match edition {
                Edition::Version2 => {
                    self.factor(
                        obj::VELOCITY_ENCODER_FACTOR_NUMERATOR,
                        obj::VELOCITY_ENCODER_FACTOR_DIVISOR,
                    )
                    .await?
                }
                Edition::Version3 => None,
            },
            velocity: self
                .factor(obj::VELOCITY_FACTOR_NUMERATOR, obj::VELOCITY_FACTOR_DIVISOR)
                .await?,
            acceleration: self
                .factor(
                    obj::ACCELERATION_FACTOR_NUMERATOR,
                    obj::ACCELERATION_FACTOR_DIVISOR,
                )
                .await?,
        })
    }

    async fn factor(
        &self,
        numerator: Object<u32, ReadWrite>,
        divisor: Object<u32, ReadWrite>,
    ) -> Result<Option<Ratio>, AxisError> {
        let mut values = [0; 2];
        for (value, object) in values.iter_mut().zip([numerator, divisor]) {
            let Some(read) = self.read_if_there(object).await? else {
                return Ok(None);
            };
            if read == 0 {
                let object = object.address();
                return Err(self.scale_error(ScaleError::ZeroFactor { object }));
            }
            *value = u64::from(read);
        }
        let [numerator, divisor] = values;
        Ratio::new(numerator, divisor)
            .map(Some)
            .map_err(|error| self.scale_error(error))
    }

    fn scale_error(&self, error: ScaleError) -> AxisError {
        self.handles.shared.error(AxisErrorKind::Scale(error))
    }
}

/// An axis in a program's own units, from [`Axis::scaled`].
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::akd2g()).axis("x").referencing("x", servocrab::axis::Referencing::AbsoluteEncoder);
/// use servocrab::units::{Ratio, ScaledSetPoint};
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// let axis = net.axis("x")?;
/// // A spindle of 5 mm a revolution; how many counts a revolution has, the drive's factor objects say.
/// let x = axis.scaled(axis.factors().await?.scale(Ratio::new(5, 1)?)?);
/// axis.enable().await?;
/// let profile_position = x.profile_position().await?;
/// let motion = profile_position.move_abs(0.5, ScaledSetPoint::new().velocity(40.0)).await?;
/// let position = motion.done().await?.position();
/// assert!((position - 0.5).abs() < 0.001, "{position} mm");
/// # net.shutdown().await;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct ScaledAxis {
    axis: Axis,
    scale: Scale,
}

impl ScaledAxis {
    /// The axis itself: for everything that knows no units, such as enabling and stops.
    #[must_use]
    pub const fn axis(&self) -> &Axis {
        &self.axis
    }

    /// The scale.
    #[must_use]
    pub const fn scale(&self) -> &Scale {
        &self.scale
    }

    /// The latest snapshot, with position and velocity in the program's units.
    #[must_use]
    pub fn status(&self) -> ScaledStatus {
        let snapshot = self.axis.status();
        ScaledStatus {
            position: self.scale.position_of(snapshot.position),
            velocity: self.scale.velocity_of(snapshot.velocity),
            snapshot,
        }
    }

    /// What `converted` makes of numbers, or why not.
    pub(super) fn convert<T>(
        &self,
        converted: impl FnOnce(&Scale) -> Result<T, ScaleError>,
    ) -> Result<T, AxisError> {
        converted(&self.scale).map_err(|error| self.axis.scale_error(error))
    }

    /// As [`Axis::profile_position`].
    ///
    /// # Errors
    /// As [`Axis::profile_position`].
    pub async fn profile_position(&self) -> Result<ScaledProfilePosition, AxisError> {
        Ok(ScaledProfilePosition {
            inner: self.axis.profile_position().await?,
            scale: self.scale,
        })
    }
}

/// What is known of an axis after a cycle, in a program's own units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaledStatus {
    /// Position actual value 6064h, units.
    pub position: f64,
    /// Velocity actual value 606Ch, units/s; 0 where it is not mapped.
    pub velocity: f64,
    /// The snapshot itself.
    pub snapshot: Snapshot,
}

/// The lease of an axis in Profile Position mode, with moves in a program's own units.
#[derive(Debug)]
pub struct ScaledProfilePosition {
    inner: ProfilePosition,
    scale: Scale,
}

impl ScaledProfilePosition {
    /// The lease itself: for a path ([`ProfilePosition::follow`]), whose moves come from [`abs`](Self::abs) and
    /// [`rel`](Self::rel).
    #[must_use]
    pub const fn inner(&self) -> &ProfilePosition {
        &self.inner
    }

    /// Moves to a position, as [`ProfilePosition::move_abs`].
    ///
    /// # Errors
    /// [`AxisErrorKind::Scale`] for a number that cannot be converted: nothing was written then. Otherwise as
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

    /// A move to a position that is not sent yet, for [`together`](crate::axis::together); see [`ScaledMove::new`].
    ///
    /// # Errors
    /// [`AxisErrorKind::Scale`].
    pub fn abs(&self, target: f64, set_point: ScaledSetPoint) -> Result<MoveRequest, AxisError> {
        let (target, set_point) = self.convert(target, &set_point)?;
        Ok(self.inner.abs(target, set_point))
    }

    /// A move by a distance that is not sent yet, for [`together`](crate::axis::together); see [`ScaledMove::new`].
    ///
    /// # Errors
    /// [`AxisErrorKind::Scale`].
    pub fn rel(&self, distance: f64, set_point: ScaledSetPoint) -> Result<MoveRequest, AxisError> {
        let (distance, set_point) = self.convert(distance, &set_point)?;
        Ok(self.inner.rel(distance, set_point))
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
#[must_use = "the outcome of a move is told by `done`"]
#[derive(Debug)]
pub struct ScaledMove {
    inner: Move,
    scale: Scale,
}

impl ScaledMove {
    /// A move seen through a scale: for those that [`together`](crate::axis::together) has started.
    pub const fn new(inner: Move, scale: Scale) -> Self {
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
    /// As [`done`](Self::done), and [`AxisErrorKind::Late`].
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
        match outcome {
            Ok(Outcome::Reached { position }) => Ok(ScaledOutcome::Reached {
                position: self.scale.position_of(position),
            }),
            Ok(Outcome::Passed { position }) => Ok(ScaledOutcome::Passed {
                position: self.scale.position_of(position),
            }),
            Err(error) => Err(in_units(error, self.scale)),
        }
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
