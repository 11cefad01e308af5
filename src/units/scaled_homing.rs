//! Homing with a scale in front.

use core::time::Duration;

use super::{ScaledAxis, ScaledHomingParameters, scaled_failure::in_units};
use crate::{
    axis::AxisError,
    homing::{Homed, Homing},
};

impl ScaledAxis {
    /// As [`Axis::homing`](crate::axis::Axis::homing).
    ///
    /// # Errors
    /// As [`Axis::homing`](crate::axis::Axis::homing).
    pub async fn homing(&self) -> Result<ScaledHoming, AxisError> {
        Ok(ScaledHoming {
            inner: self.axis().homing().await?,
            axis: self.clone(),
        })
    }
}

/// The lease of an axis in homing mode, with speeds, offset and result in a program's own units.
///
/// ```
/// # use core::time::Duration;
/// use servocrab::{homing::HomingMethod, units::{Ratio, Scale, ScaledHomingParameters}};
/// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
/// # use servocrab_sim::{Segment, personality::Servo};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # smol::block_on(async {
/// # // The axis stands 5 mm above its negative limit switch.
/// # let servo = Servo::generic().change(|drive| drive.machine.negative_limit = Some(-5_000));
/// # let mut segment = Segment::new().with(servo.build());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::generic()).axis("lift");
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// // A thousand counts are a millimetre.
/// let lift = net.axis("lift")?.scaled(Scale::counts_per_unit(Ratio::new(1000, 1)?));
/// lift.enable().await?;
/// let homing = lift.homing().await?;
/// let parameters = ScaledHomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
///     .speeds(50.0, 5.0)
///     .acceleration(1_000.0);
/// let homed = homing.home_within(parameters, Duration::from_secs(60)).await?;
/// assert!(homed.position.abs() < 1.0, "{} mm", homed.position);
/// homing.release().await?; // for the next mode
/// # net.shutdown().await;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug)]
pub struct ScaledHoming {
    inner: Homing,
    axis: ScaledAxis,
}

/// Where an axis is, now that it knows, in a program's own units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaledHomed {
    /// Position actual value 6064h at the end of the homing, units.
    pub position: f64,
}

impl ScaledHoming {
    /// The lease itself.
    #[must_use]
    pub const fn inner(&self) -> &Homing {
        &self.inner
    }

    /// Homes the axis, as [`Homing::home`].
    ///
    /// # Errors
    /// [`AxisErrorKind::Scale`](crate::axis::AxisErrorKind::Scale) for a number that cannot be converted: nothing was written then. Otherwise as
    /// [`Homing::home`].
    pub async fn home(
        &self,
        parameters: impl Into<ScaledHomingParameters>,
    ) -> Result<ScaledHomed, AxisError> {
        let parameters = self
            .axis
            .convert(|scale| scale.homing(&parameters.into()))?;
        self.homed(self.inner.home(parameters).await)
    }

    /// The same, waiting no longer than this: as [`Home::within`](crate::homing::Home::within).
    ///
    /// # Errors
    /// As [`home`](Self::home), and [`AxisErrorKind::Late`](crate::axis::AxisErrorKind::Late), by which nothing is stopped.
    pub async fn home_within(
        &self,
        parameters: impl Into<ScaledHomingParameters>,
        deadline: Duration,
    ) -> Result<ScaledHomed, AxisError> {
        let parameters = self
            .axis
            .convert(|scale| scale.homing(&parameters.into()))?;
        self.homed(self.inner.home(parameters).within(deadline).await)
    }

    /// As [`Homing::release`].
    ///
    /// # Errors
    /// As [`Homing::release`].
    pub async fn release(self) -> Result<(), AxisError> {
        self.inner.release().await
    }

    fn homed(&self, homed: Result<Homed, AxisError>) -> Result<ScaledHomed, AxisError> {
        let scale = self.axis.scale();
        homed
            .map(|homed| ScaledHomed {
                position: scale.position_of(homed.position),
            })
            .map_err(|error| in_units(error, *scale))
    }
}
