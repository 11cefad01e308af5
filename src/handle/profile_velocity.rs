//! Profile Velocity as a lease of an axis: jogs are asked for here.

use core::marker::PhantomData;

use crate::{
    Failure,
    axis::{Command, ParameterFault, TARGET_VELOCITY, Unsupported},
    ds402::Mode,
    profile_position::Parameters,
    profile_velocity::JogSetPoint,
    units::{AxisUnit, Counts, ScaleError},
};

use super::{Axis, AxisError, AxisErrorKind, axis::Lease, parameters::BySdo, pending::Pending};

/// The lease of an axis in Profile Velocity mode, from [`Axis::profile_velocity`].
///
/// Dropping it gives the mode back; a [`Jog`] that is held goes on until it is let go, or until the axis is leased again.
/// [`release`](Self::release) ends the motion as well.
///
/// ```
/// # use core::time::Duration;
/// use servocrab::{AxisConfig, DriveConfig, coe::obj, drives};
/// # use servocrab::{Network, link::Wire};
/// # use servocrab_sim::{Segment, personality};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # smol::block_on(async {
/// # let mut segment = Segment::new().with(personality::generic());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// let drive = DriveConfig::new(drives::generic())
///     .axis(AxisConfig::new("lift").map_output(obj::TARGET_VELOCITY));
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// # let lift = net.axis("lift")?;
/// lift.enable().await?;
/// let pv = lift.profile_velocity().await?;
/// let jog = pv.jog(5_000).await?; // it moves
/// # smol::Timer::after(Duration::from_millis(20)).await;
/// jog.set(-2_000)?; // back, slower
/// jog.release().await?; // it stands
/// pv.release().await?;
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug)]
pub struct ProfileVelocity<U: AxisUnit = Counts> {
    axis: Axis<U>,
    _lease: Lease,
}

impl<U: AxisUnit> Axis<U> {
    /// Selects Profile Velocity (mode 3) and leases it. The lease ends by [`ProfileVelocity::release`] or by dropping it.
    ///
    /// The target velocity 60FFh must be mapped: `AxisConfig::map_output(obj::TARGET_VELOCITY)`. A jog that an earlier lease has left is
    /// let go.
    ///
    /// # Errors
    /// [`Unsupported::Mode`](crate::axis::Unsupported::Mode) where 6502h does not name mode 3. [`Failure::Parameter`] if 60FFh is not mapped.
    /// [`AxisErrorKind::ModeInUse`] while another lease exists. Otherwise when the drive does not show the mode in time, the axis moves or is halted in
    /// another mode, the axis was stopped meanwhile, or the bus is lost.
    pub async fn profile_velocity(&self) -> Result<ProfileVelocity<U>, AxisError> {
        let shared = &self.handles.shared;
        let mode = Mode::ProfileVelocity;
        // First: to map 60FFh would not help.
        let supported = shared.notes.settings().supported_modes;
        if supported.is_some_and(|modes| !modes.allows(mode)) {
            let failure = Failure::Unsupported(Unsupported::Mode(mode));
            return Err(shared.error(AxisErrorKind::Failed(failure)));
        }
        if shared.setup.fields.target_velocity.is_none() {
            let failure = Failure::Parameter {
                name: TARGET_VELOCITY,
                fault: ParameterFault::NotMapped,
            };
            return Err(shared.error(AxisErrorKind::Failed(failure)));
        }
        let lease = Lease::take(&self.handles)?;
        self.select(mode).await?;
        Ok(ProfileVelocity {
            axis: self.clone(),
            _lease: lease,
        })
    }
}

impl<U: AxisUnit> ProfileVelocity<U> {
    /// The axis.
    #[must_use]
    pub const fn axis(&self) -> &Axis<U> {
        &self.axis
    }

    /// Moves with a velocity (60FFh) for as long as the [`Jog`] is held; resolves when the drive has it.
    ///
    /// Ramps that are given and not mapped are written by SDO and confirmed before. Dropped on the way, the jog is let go.
    ///
    /// # Errors
    /// With the reason: the axis refuses to move (not enabled, halted, a fault, a ramp or a dead-man time of zero, another jog held …), it was stopped
    /// meanwhile, a ramp could not be written, or a number cannot be converted into counts.
    pub async fn jog(&self, set_point: impl Into<JogSetPoint<U>>) -> Result<Jog<U>, AxisError> {
        let set_point = set_point.into().in_counts(&self.axis.unit.scale);
        let mut set_point = set_point.map_err(|error| self.axis.scale_error(error))?;
        let handles = &self.axis.handles;
        if let Err(failure) = set_point.check_dead_man() {
            return Err(handles.shared.error(AxisErrorKind::Failed(failure)));
        }
        // A stop that comes while ramps are being written stops this jog as well.
        let asked = handles.shared.stops.last();
        let mut ramps = Parameters {
            acceleration: set_point.acceleration,
            deceleration: set_point.deceleration,
            ..Parameters::default()
        };
        let by_sdo = BySdo::take(&handles.shared.setup.fields, &mut ramps);
        if let Some(name) = by_sdo.zero {
            let failure = Failure::Parameter {
                name,
                fault: ParameterFault::Zero,
            };
            return Err(handles.shared.error(AxisErrorKind::Failed(failure)));
        }
        set_point.acceleration = ramps.acceleration;
        set_point.deceleration = ramps.deceleration;
        // First: nobody begins another jog between the check and the writes.
        let mut claim = handles.claim_now()?;
        if claim.has_to_write(&by_sdo) {
            // What is refused must not have changed the ramps, least of all those of a jog that is held.
            let check = Command::CheckJog(set_point.velocity);
            self.axis.run(check).await?;
            handles.check_not_stopped(asked).await?;
        }
        by_sdo.write(&mut claim).await?;
        // From here on whatever drops it lets it go.
        let mut jog = Jog {
            pending: self.axis.submit_asked(Command::Jog(set_point), asked)?,
            unit: PhantomData,
        };
        claim.sent(&jog.pending);
        jog.pending.accepted().await?;
        self.axis.trace("jogging");
        Ok(jog)
    }

    /// Ends the motion as [`Axis::stop`] does and gives the mode back. A standing axis without a jog stays enabled.
    ///
    /// # Errors
    /// When a deadline passes or the bus is lost. The mode is given back all the same.
    pub async fn release(self) -> Result<(), AxisError> {
        self.axis.release().await
    }
}

/// A velocity that is held. Dropping it lets go: the target velocity is 0 in the next frame, whatever is queued.
///
/// Every stop of the axis, by anyone, ends it for good: no resume or enable brings its motion back. So does another lease of the axis,
/// where its own was given back.
#[must_use = "dropping it stops the axis"]
#[derive(Debug)]
pub struct Jog<U: AxisUnit = Counts> {
    pending: Pending,
    unit: PhantomData<U>,
}

impl<U: AxisUnit> Jog<U> {
    /// Another velocity (60FFh), from the next frame on; 0 stands and holds.
    ///
    /// # Errors
    /// With the reason for which the jog has ended: halted, stopped, disabled, a fault, the bus lost. What was asked for then
    /// is not followed. [`Failure::BeyondLimit`] above max profile velocity 607Fh, and [`AxisErrorKind::Scale`] for a number that cannot be
    /// converted into counts: the jog goes on as it was. [`Failure::TooSlow`] below min profile velocity 2010h, of a drive on which that counts. [`AxisErrorKind::ModeInUse`] once its lease was given back and the axis was
    /// leased again: the jog was let go then. Such a velocity, and a number
    /// that is less than the drive's smallest ([`ScaleError::RoundsToZero`]), hold it at 0, so that a jog that gets slower and slower comes to
    /// a stand.
    pub fn set(&self, velocity: U::Signed) -> Result<(), AxisError> {
        let converted = self.pending.unit.scale.target_velocity(velocity.into());
        if matches!(converted, Err(ScaleError::RoundsToZero { .. })) {
            self.hold_at(Some(0))?;
        }
        let velocity =
            converted.map_err(|error| self.pending.error(AxisErrorKind::Scale(error)))?;
        self.hold_at(Some(velocity))
    }

    /// Says that the jog is held, at the velocity that it has. A jog with a [`dead_man`](JogSetPoint::dead_man) time needs this, or
    /// [`set`](Self::set), again and again within that time.
    ///
    /// ```
    /// # use core::time::Duration;
    /// # use servocrab::{AxisConfig, DriveConfig, coe::obj, drives};
    /// # use servocrab::{Network, link::Wire};
    /// # use servocrab_sim::{Segment, personality};
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # smol::block_on(async {
    /// # let mut segment = Segment::new().with(personality::generic());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::generic())
    /// #     .axis(AxisConfig::new("lift").map_output(obj::TARGET_VELOCITY));
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// # let lift = net.axis("lift")?;
    /// use servocrab::{Failure, profile_velocity::JogSetPoint};
    /// lift.enable().await?;
    /// let pv = lift.profile_velocity().await?;
    /// let jog = pv.jog(JogSetPoint::new(5_000).dead_man(Duration::from_millis(100))).await?;
    /// for _ in 0..5 {
    ///     smol::Timer::after(Duration::from_millis(20)).await;
    ///     jog.hold()?; // with each message of the panel
    /// }
    /// // The panel has frozen.
    /// while jog.ended().is_none() {
    ///     smol::Timer::after(Duration::from_millis(20)).await;
    /// }
    /// assert_eq!(jog.ended(), Some(Failure::NotHeld));
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    ///
    /// # Errors
    /// With the reason for which the jog has ended, as [`set`](Self::set). [`Failure::NotHeld`] where it comes too late.
    pub fn hold(&self) -> Result<(), AxisError> {
        self.hold_at(None)
    }

    fn hold_at(&self, velocity: Option<i32>) -> Result<(), AxisError> {
        let held = match self.pending.result() {
            Some(Err(failure)) => Err(failure),
            _ if self.is_of_earlier_lease() => {
                return Err(self.pending.error(AxisErrorKind::ModeInUse));
            }
            Some(Ok(_)) => Err(Failure::Withdrawn),
            None => {
                let shared = &self.pending.handles.shared;
                shared.hold_jog(&self.pending.request, velocity)
            }
        };
        held.map_err(|failure| self.pending.error(AxisErrorKind::Failed(failure)))
    }

    /// Whether the axis has been leased again since.
    fn is_of_earlier_lease(&self) -> bool {
        let shared = &self.pending.handles.shared;
        shared.is_leased_again(self.pending.request.lease)
    }

    /// Why the jog has ended, if something ended it. Nothing is waited for.
    #[must_use]
    pub fn ended(&self) -> Option<Failure> {
        match self.pending.result()? {
            Ok(_) => Some(Failure::Withdrawn),
            Err(failure) => Some(failure),
        }
    }

    /// Lets go, with the target velocity 0 in the next frame, and waits for standstill. Dropped before that, it is let go all
    /// the same.
    ///
    /// # Errors
    /// With the reason for which the jog had ended before, or ended on the way to standstill. Also when the axis does not come to
    /// rest in time, or the bus is lost.
    pub async fn release(self) -> Result<(), AxisError> {
        let Self { pending, .. } = &self;
        pending.handles.shared.release_jog(&pending.request);
        pending.done().await?;
        pending.handles.shared.trace("jog released");
        Ok(())
    }
}

impl<U: AxisUnit> Drop for Jog<U> {
    fn drop(&mut self) {
        let pending = &self.pending;
        pending.handles.shared.release_jog(&pending.request);
    }
}
