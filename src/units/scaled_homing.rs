//! Homing with a scale in front.

use core::{
    future::Future,
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use super::{Scale, ScaledAxis, ScaledHomingParameters, scaled_failure::in_units};
use crate::{
    axis::AxisError,
    homing::{Home, Homing},
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
/// let homed = homing.home(parameters).within(Duration::from_secs(60)).await?;
/// assert!(homed.position.abs() < 1.0, "{} mm", homed.position);
/// homing.release().await?; // for the next mode
/// # net.shutdown().await?;
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
    /// Of the future: [`AxisErrorKind::Scale`](crate::axis::AxisErrorKind::Scale) for a number that cannot be converted: nothing was written
    /// then. Otherwise as [`Homing::home`].
    pub fn home(&self, parameters: impl Into<ScaledHomingParameters>) -> ScaledHome<'_> {
        let parameters = self.axis.convert(|scale| scale.homing(&parameters.into()));
        ScaledHome {
            inner: parameters
                .map(|parameters| self.inner.home(parameters))
                .map_err(Some),
            scale: *self.axis.scale(),
        }
    }

    /// As [`Homing::release`].
    ///
    /// # Errors
    /// As [`Homing::release`].
    pub async fn release(self) -> Result<(), AxisError> {
        self.inner.release().await
    }
}

/// A homing, and the wait for its end, as [`Home`].
#[must_use = "futures do nothing unless awaited"]
#[derive(Debug)]
pub struct ScaledHome<'a> {
    /// What could not be converted is reported once.
    inner: Result<Home<'a>, Option<AxisError>>,
    scale: Scale,
}

impl ScaledHome<'_> {
    /// As [`Home::within`].
    pub fn within(self, limit: Duration) -> Self {
        Self {
            inner: self.inner.map(|home| home.within(limit)),
            ..self
        }
    }

    /// As [`Home::keep_homing`].
    pub fn keep_homing(self, reason: &str) -> Self {
        Self {
            inner: self.inner.map(|home| home.keep_homing(reason)),
            ..self
        }
    }
}

impl Future for ScaledHome<'_> {
    type Output = Result<ScaledHomed, AxisError>;

    fn poll(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Self::Output> {
        let this = self.get_mut();
        let scale = this.scale;
        match &mut this.inner {
            Ok(home) => Pin::new(home).poll(cx).map(|homed| {
                homed
                    .map(|homed| ScaledHomed {
                        position: scale.position_of(homed.position),
                    })
                    .map_err(|error| in_units(error, scale))
            }),
            Err(error) => match error.take() {
                Some(error) => Poll::Ready(Err(error)),
                // It has been reported: it is not to be polled again.
                None => Poll::Pending,
            },
        }
    }
}
