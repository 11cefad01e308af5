//! Profile Velocity as a lease of an axis: jogs are asked for here.

use crate::{
    axis::{Axis, AxisError, AxisErrorKind, Command, Failure, Lease, Pending, TARGET_VELOCITY},
    ds402::Mode,
    profile_position::{BySdo, Parameters},
};

use super::JogSetPoint;

/// The lease of an axis in Profile Velocity mode, from [`Axis::profile_velocity`].
///
/// Dropping it gives the mode back; a [`Jog`] that is held goes on until it is let go. [`release`](Self::release) ends the
/// motion as well.
///
/// ```
/// # use core::time::Duration;
/// use servocrab::{bus::DriveConfig, coe::obj, drives};
/// # use servocrab::{bus::Network, link::Wire};
/// # use servocrab_sim::{Segment, personality};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # smol::block_on(async {
/// # let mut segment = Segment::new().with(personality::generic());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// let drive = DriveConfig::new(drives::generic())
///     .axis("lift")
///     .map_output("lift", obj::TARGET_VELOCITY);
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
pub struct ProfileVelocity {
    axis: Axis,
    _lease: Lease,
}

impl Axis {
    /// Selects Profile Velocity (mode 3) and leases it. The lease ends by [`ProfileVelocity::release`] or by dropping it.
    ///
    /// The target velocity 60FFh must be mapped: `DriveConfig::map_output(axis, obj::TARGET_VELOCITY)`.
    ///
    /// # Errors
    /// [`Failure::NotMapped`] if it is not. [`AxisErrorKind::ModeInUse`] while another lease exists. [`Failure::ModeNotSupported`]
    /// where 6502h does not name mode 3. Otherwise when the drive does not show the mode in time, the axis moves or is halted in
    /// another mode, or the bus is lost.
    pub async fn profile_velocity(&self) -> Result<ProfileVelocity, AxisError> {
        let shared = &self.handles.shared;
        if shared.setup.fields.target_velocity.is_none() {
            let failure = Failure::NotMapped(TARGET_VELOCITY);
            return Err(shared.error(AxisErrorKind::Failed(failure)));
        }
        let lease = Lease::take(&self.handles)?;
        self.select(Mode::ProfileVelocity).await?;
        Ok(ProfileVelocity {
            axis: self.clone(),
            _lease: lease,
        })
    }
}

impl ProfileVelocity {
    /// The axis.
    #[must_use]
    pub const fn axis(&self) -> &Axis {
        &self.axis
    }

    /// Moves with a velocity (60FFh, velocity units) for as long as the [`Jog`] is held; resolves when the drive has it.
    ///
    /// Ramps that are given and not mapped are written by SDO and confirmed before. Dropped on the way, the jog is let go.
    ///
    /// # Errors
    /// With the reason: the axis refuses to move (not enabled, halted, a fault, a ramp of zero, another jog held …), it was stopped
    /// meanwhile, or a ramp could not be written.
    pub async fn jog(&self, set_point: impl Into<JogSetPoint>) -> Result<Jog, AxisError> {
        let mut set_point = set_point.into();
        let handles = &self.axis.handles;
        // A stop that comes while ramps are being written stops this jog as well.
        let asked = handles.shared.last_stop();
        let mut ramps = Parameters {
            acceleration: set_point.acceleration,
            deceleration: set_point.deceleration,
            ..Parameters::default()
        };
        let by_sdo = BySdo::take(&handles.shared.setup.fields, &mut ramps);
        if let Some(name) = by_sdo.zero {
            let failure = Failure::Zero(name);
            return Err(handles.shared.error(AxisErrorKind::Failed(failure)));
        }
        set_point.acceleration = ramps.acceleration;
        set_point.deceleration = ramps.deceleration;
        if by_sdo.is_needed(handles) {
            // What is refused must not have changed the ramps, least of all those of a jog that is held.
            let check = Command::CheckJog(set_point.velocity);
            self.axis.run(check).await?;
        }
        let mut claim = handles.claim_now()?;
        by_sdo.write(handles, &mut claim).await?;
        // From here on whatever drops it lets it go.
        let mut jog = Jog {
            pending: self.axis.submit_motion(Command::Jog(set_point), asked)?,
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
/// Every stop of the axis, by anyone, ends it for good: no resume or enable brings its motion back.
#[must_use = "dropping it stops the axis"]
#[derive(Debug)]
pub struct Jog {
    pending: Pending,
}

impl Jog {
    /// Another velocity, from the next frame on: velocity units of 60FFh; 0 stands and holds.
    ///
    /// # Errors
    /// With the reason for which the jog has ended: halted, stopped, disabled, a fault, the bus lost. What was asked for then
    /// is not followed. [`Failure::TooFast`] above max profile velocity 607Fh: the jog goes on as it was.
    pub fn set(&self, velocity: i32) -> Result<(), AxisError> {
        let shared = &self.pending.handles.shared;
        let set = match self.ended() {
            Some(reason) => Err(reason),
            None => shared.set_jog(self.pending.id, velocity),
        };
        set.map_err(|failure| shared.error(AxisErrorKind::Failed(failure)))
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
        let Self { pending } = &self;
        pending.handles.shared.release_jog(pending.id);
        pending.done().await?;
        pending.handles.shared.trace("jog released");
        Ok(())
    }
}

impl Drop for Jog {
    fn drop(&mut self) {
        self.pending.handles.shared.release_jog(self.pending.id);
    }
}
