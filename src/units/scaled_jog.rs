//! Jogs with a scale in front.

use super::{ScaleError, ScaledAxis, ScaledJogSetPoint, scaled_failure::in_units};
use crate::{
    axis::{AxisError, Failure},
    profile_velocity::{Jog, ProfileVelocity},
};

impl ScaledAxis {
    /// As [`Axis::profile_velocity`](crate::axis::Axis::profile_velocity).
    ///
    /// # Errors
    /// As [`Axis::profile_velocity`](crate::axis::Axis::profile_velocity).
    pub async fn profile_velocity(&self) -> Result<ScaledProfileVelocity, AxisError> {
        Ok(ScaledProfileVelocity {
            inner: self.axis().profile_velocity().await?,
            axis: self.clone(),
        })
    }
}

/// The lease of an axis in Profile Velocity mode, with jogs in a program's own units.
///
/// ```
/// # use core::time::Duration;
/// # use servocrab::{bus::{DriveConfig, Network}, coe::obj, drives, link::Wire};
/// # use servocrab_sim::{Segment, personality};
/// use servocrab::units::{Ratio, Scale};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # smol::block_on(async {
/// # let mut segment = Segment::new().with(personality::generic());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::generic()).axis("lift").map_output("lift", obj::TARGET_VELOCITY);
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// // A thousand counts are a millimetre.
/// let lift = net.axis("lift")?.scaled(Scale::counts_per_unit(Ratio::new(1000, 1)?));
/// lift.enable().await?;
/// let pv = lift.profile_velocity().await?;
/// let jog = pv.jog(5.0).await?; // it moves at 5 mm/s
/// # smol::Timer::after(Duration::from_millis(20)).await;
/// jog.set(-2.0)?; // back, slower
/// jog.release().await?; // it stands
/// pv.release().await?;
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug)]
pub struct ScaledProfileVelocity {
    inner: ProfileVelocity,
    axis: ScaledAxis,
}

impl ScaledProfileVelocity {
    /// The lease itself.
    #[must_use]
    pub const fn inner(&self) -> &ProfileVelocity {
        &self.inner
    }

    /// Moves with a velocity (60FFh, units/s) for as long as the [`ScaledJog`] is held, as [`ProfileVelocity::jog`].
    ///
    /// # Errors
    /// [`AxisErrorKind::Scale`](crate::axis::AxisErrorKind::Scale) for a number that cannot be converted: nothing was written then. Otherwise as
    /// [`ProfileVelocity::jog`].
    pub async fn jog(
        &self,
        set_point: impl Into<ScaledJogSetPoint>,
    ) -> Result<ScaledJog, AxisError> {
        let set_point = self.axis.convert(|scale| scale.jog(&set_point.into()))?;
        let jog = self.inner.jog(set_point).await;
        Ok(ScaledJog {
            inner: jog.map_err(|error| in_units(error, *self.axis.scale()))?,
            axis: self.axis.clone(),
        })
    }

    /// As [`ProfileVelocity::release`].
    ///
    /// # Errors
    /// As [`ProfileVelocity::release`].
    pub async fn release(self) -> Result<(), AxisError> {
        self.inner.release().await
    }
}

/// A velocity that is held, in a program's own units. Dropping it lets go, as of a [`Jog`].
#[must_use = "dropping it stops the axis"]
#[derive(Debug)]
pub struct ScaledJog {
    inner: Jog,
    axis: ScaledAxis,
}

impl ScaledJog {
    /// The jog itself.
    pub const fn inner(&self) -> &Jog {
        &self.inner
    }

    /// Another velocity, from the next frame on, units/s: as [`Jog::set`].
    ///
    /// # Errors
    /// [`AxisErrorKind::Scale`](crate::axis::AxisErrorKind::Scale) for a number that cannot be converted: the jog goes on as it
    /// was. A number that is less than the drive's smallest ([`ScaleError::RoundsToZero`]) holds it at 0, so that a jog that gets
    /// slower and slower comes to a stand. Otherwise as [`Jog::set`].
    pub fn set(&self, velocity: f64) -> Result<(), AxisError> {
        let converted = self.axis.scale().target_velocity(velocity);
        let set = |counts| {
            let set = self.inner.set(counts);
            set.map_err(|error| in_units(error, *self.axis.scale()))
        };
        if matches!(converted, Err(ScaleError::RoundsToZero { .. })) {
            set(0)?;
        }
        set(self.axis.convert(|_| converted)?)
    }

    /// As [`Jog::ended`].
    #[must_use]
    pub fn ended(&self) -> Option<Failure> {
        self.inner.ended()
    }

    /// As [`Jog::release`].
    ///
    /// # Errors
    /// As [`Jog::release`].
    pub async fn release(self) -> Result<(), AxisError> {
        self.inner.release().await
    }
}
