//! The drive's torque limits, for as long as a program wants them.

use crate::{
    Failure,
    coe::{Object, ReadWrite, obj},
    units::{AxisUnit, Counts},
};

use super::{Axis, AxisError, AxisErrorKind};

/// A torque that the drive limits, in thousandths of the rated torque 6076h.
///
/// ```
/// use servocrab::axis::TorqueLimit;
/// assert_eq!(TorqueLimit::Both(300).to_string(), "300 ‰ (6072h:00)");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum TorqueLimit {
    /// Max torque 6072h, in both directions.
    Both(u16),
    /// Positive torque limit 60E0h.
    Positive(u16),
    /// Negative torque limit 60E1h.
    Negative(u16),
}

impl TorqueLimit {
    const fn parts(self) -> (Object<u16, ReadWrite>, u16) {
        match self {
            Self::Both(limit) => (obj::MAX_TORQUE, limit),
            Self::Positive(limit) => (obj::POSITIVE_TORQUE_LIMIT, limit),
            Self::Negative(limit) => (obj::NEGATIVE_TORQUE_LIMIT, limit),
        }
    }
}

impl core::fmt::Display for TorqueLimit {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let (object, limit) = self.parts();
        write!(f, "{limit} ‰ ({})", object.address())
    }
}

/// A torque limit that is in force, from [`Axis::limit_torque`]. Dropped, it stays in force.
#[must_use = "the limit stays in force until it is restored"]
#[derive(Debug)]
pub struct LimitedTorque<U: AxisUnit = Counts> {
    axis: Axis<U>,
    object: Object<u16, ReadWrite>,
    before: u16,
}

impl<U: AxisUnit> Axis<U> {
    /// Limits the torque of the axis; confirmed by the drive when the future resolves, or in the next frame where the object is mapped. What
    /// the drive held before comes back by [`LimitedTorque::restore`].
    ///
    /// A limit below what carries the load drops a vertical axis. One below what a ramp needs ends in a following error.
    ///
    /// ```
    /// # use servocrab::{Axis, AxisError, SetPoint, axis::TorqueLimit};
    /// # async fn example(axis: Axis) -> Result<(), AxisError> {
    /// let limited = axis.limit_torque(TorqueLimit::Both(300)).await?;
    /// let positions = axis.profile_position().await?;
    /// positions.move_abs(20_000, SetPoint::new()).await?.done().await?;
    /// limited.restore().await?;
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`AxisErrorKind::Sdo`] where the drive has no such object, or refuses the value.
    pub async fn limit_torque(&self, limit: TorqueLimit) -> Result<LimitedTorque<U>, AxisError> {
        let (object, limit) = limit.parts();
        let before = self.handles.read(object).await?;
        self.handles.put(object, limit).await?;
        Ok(LimitedTorque {
            axis: self.clone(),
            object,
            before,
        })
    }
}

impl<U: AxisUnit> LimitedTorque<U> {
    /// The axis.
    #[must_use]
    pub const fn axis(&self) -> &Axis<U> {
        &self.axis
    }

    /// Brings back what the drive held before, while the axis has no set-point: an axis that presses against something would
    /// accelerate.
    ///
    /// # Errors
    /// [`Failure::Moving`] while the axis has a set-point, or may have one: nothing was written then. [`AxisErrorKind::Sdo`].
    pub async fn restore(&self) -> Result<(), AxisError> {
        let shared = &self.axis.handles.shared;
        if shared.snapshot().has_set_point {
            return Err(shared.error(AxisErrorKind::Failed(Failure::Moving)));
        }
        self.axis.handles.put(self.object, self.before).await
    }
}
