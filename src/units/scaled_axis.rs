//! An axis with a scale in front, and what its drive says of units.

use super::{Edition, Factors, Ratio, Scale, ScaleError, ScaledProfilePosition};
use crate::{
    axis::{Axis, AxisError, AxisErrorKind, AxisIdentity, Snapshot, StopHandle},
    coe::{Object, ReadWrite, obj},
    ds402::State,
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

    /// Reads the factor objects 608Fh, 6091h, 6092h, 6096h and 6097h of this axis by SDO, and 6093h and 6094h of older drives. A
    /// drive that has 6093h is taken to follow [`Edition::Version2`]. Objects that the drive does not have are left out.
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

    pub(super) fn scale_error(&self, error: ScaleError) -> AxisError {
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
/// x.enable().await?;
/// let profile_position = x.profile_position().await?;
/// let motion = profile_position.move_abs(0.5, ScaledSetPoint::new().velocity(40.0)).await?;
/// let position = motion.done().await?.position();
/// assert!((position - 0.5).abs() < 0.001, "{position} mm");
/// # net.shutdown().await?;
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
    /// The axis itself: for its objects, its limits, and programs that count in its drive's units.
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
        self.seen(self.axis.status())
    }

    /// As [`Axis::changed`], with position and velocity in the program's units.
    #[must_use = "it is `None` once the network has ended"]
    pub async fn changed(&self) -> Option<ScaledStatus> {
        let snapshot = self.axis.changed().await?;
        Some(self.seen(snapshot))
    }

    fn seen(&self, snapshot: Snapshot) -> ScaledStatus {
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
        let inner = self.axis.profile_position().await?;
        Ok(ScaledProfilePosition::new(inner, self.scale))
    }

    /// As [`Axis::identity`].
    #[must_use]
    pub fn identity(&self) -> &AxisIdentity {
        self.axis.identity()
    }

    /// As [`Axis::enable`].
    ///
    /// # Errors
    /// As [`Axis::enable`].
    pub async fn enable(&self) -> Result<(), AxisError> {
        self.axis.enable().await
    }

    /// As [`Axis::disable`].
    ///
    /// # Errors
    /// As [`Axis::disable`].
    pub async fn disable(&self) -> Result<(), AxisError> {
        self.axis.disable().await
    }

    /// As [`Axis::reset_fault`].
    ///
    /// # Errors
    /// As [`Axis::reset_fault`].
    pub async fn reset_fault(&self) -> Result<(), AxisError> {
        self.axis.reset_fault().await
    }

    /// As [`Axis::halt`].
    ///
    /// # Errors
    /// As [`Axis::halt`].
    pub async fn halt(&self) -> Result<(), AxisError> {
        self.axis.halt().await
    }

    /// As [`Axis::resume`].
    ///
    /// # Errors
    /// As [`Axis::resume`].
    pub async fn resume(&self) -> Result<(), AxisError> {
        self.axis.resume().await
    }

    /// As [`Axis::stop`].
    ///
    /// # Errors
    /// As [`Axis::stop`].
    pub async fn stop(&self) -> Result<State, AxisError> {
        self.axis.stop().await
    }

    /// As [`Axis::quick_stop`].
    ///
    /// # Errors
    /// As [`Axis::quick_stop`].
    pub async fn quick_stop(&self) -> Result<State, AxisError> {
        self.axis.quick_stop().await
    }

    /// As [`Axis::stop_handle`].
    #[must_use]
    pub fn stop_handle(&self) -> StopHandle {
        self.axis.stop_handle()
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
