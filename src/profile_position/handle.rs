//! Profile Position as a lease of an axis: moves are asked for here.

use core::fmt;

use crate::axis::{Axis, AxisError, AxisErrorKind, Claim, Command, LastStop, Lease, Pending};

use super::{Failure, Move, MoveCommand, Reference, SetPoint, by_sdo::BySdo};

/// The lease of an axis in Profile Position mode, from [`Axis::profile_position`].
///
/// Dropping it gives the mode back and leaves the motion alone; [`release`](Self::release) ends the motion as well.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::akd2g()).axis("x").referencing("x", servocrab::axis::Referencing::AbsoluteEncoder);
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// use servocrab::profile_position::{Outcome, SetPoint, Start};
/// let x = net.axis("x")?;
/// x.enable().await?;
/// let profile_position = x.profile_position().await?;
/// let set_point = SetPoint::new().velocity(50_000).acceleration(500_000).deceleration(500_000);
/// let first = profile_position.move_abs(2_000, set_point).await?; // the drive has acknowledged
/// let second = profile_position.move_abs(5_000, set_point.start(Start::Blend)).await?;
/// assert!(matches!(first.done().await?, Outcome::Passed { .. })); // without a stop
/// assert!(matches!(second.done().await?, Outcome::Reached { .. }));
/// profile_position.release().await?; // for the next mode
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug)]
pub struct ProfilePosition {
    pub(super) axis: Axis,
    _lease: Lease,
}

impl ProfilePosition {
    pub(crate) const fn new(axis: Axis, lease: Lease) -> Self {
        Self {
            axis,
            _lease: lease,
        }
    }

    /// The axis.
    #[must_use]
    pub const fn axis(&self) -> &Axis {
        &self.axis
    }

    /// Moves to a position; resolves when the drive has acknowledged the set-point.
    ///
    /// Parameters that the set-point names and that are not in the process data are written by SDO and confirmed
    /// before. Dropped before bit 4 rose, the move is withdrawn; later, the drive executes it.
    ///
    /// # Errors
    /// With the reason: the axis refuses the move (not enabled, halted, a fault, a start that the drive cannot do, a parameter of
    /// zero …), the drive did not take it, or a parameter could not be written. A failure says whether the set-point was not sent,
    /// was accepted, or may have been taken.
    pub async fn move_abs(&self, target: i32, set_point: SetPoint) -> Result<Move, AxisError> {
        self.abs(target, set_point).send().await
    }

    /// Moves by a distance from the base that the drive documents (60F2h); otherwise as [`move_abs`](Self::move_abs).
    ///
    /// # Errors
    /// As [`move_abs`](Self::move_abs).
    pub async fn move_rel(&self, distance: i32, set_point: SetPoint) -> Result<Move, AxisError> {
        self.rel(distance, set_point).send().await
    }

    /// A move to a position that is not sent yet, for [`together`](crate::axis::together).
    pub fn abs(&self, target: i32, set_point: SetPoint) -> MoveRequest {
        self.request(Reference::Absolute, target, set_point)
    }

    /// A move by a distance that is not sent yet, for [`together`](crate::axis::together).
    pub fn rel(&self, distance: i32, set_point: SetPoint) -> MoveRequest {
        self.request(Reference::Relative, distance, set_point)
    }

    /// Ends the motion as [`Axis::stop`] does, with bit 4 low and the set-point abandoned, and gives the mode back. A
    /// standing axis without a set-point stays enabled.
    ///
    /// # Errors
    /// When a deadline passes or the bus is lost. The mode is given back all the same.
    pub async fn release(self) -> Result<(), AxisError> {
        self.axis.release().await
    }

    fn request(&self, reference: Reference, target: i32, set_point: SetPoint) -> MoveRequest {
        MoveRequest {
            axis: self.axis.clone(),
            command: MoveCommand {
                reference,
                target,
                set_point,
                gated: false,
            },
        }
    }
}

/// A move that is not sent yet.
#[must_use = "it is sent by `together` or `follow`"]
#[derive(Debug, Clone)]
pub struct MoveRequest {
    pub(crate) axis: Axis,
    pub(crate) command: MoveCommand,
}

impl MoveRequest {
    pub(super) async fn send(self) -> Result<Move, AxisError> {
        // A stop that comes while parameters are being written stops this move as well.
        let asked = self.last_stop();
        let (command, claim) = self.prepare().await?;
        let pending = self.axis.submit_motion(Command::Move(command), asked)?;
        if let Some(claim) = claim {
            claim.sent(&pending);
        }
        self.accepted(pending).await
    }

    pub(crate) fn last_stop(&self) -> LastStop {
        self.axis.handles.shared.last_stop()
    }

    /// Waits for the acknowledge.
    pub(crate) async fn accepted(&self, mut pending: Pending) -> Result<Move, AxisError> {
        match pending.accepted().await {
            Ok(()) => {
                self.trace("move accepted", &"by the drive");
                Ok(Move::new(pending, self.command))
            }
            Err(error) => {
                self.trace("move not accepted", &error.kind);
                Err(error)
            }
        }
    }

    /// Writes by SDO what the move needs and the process data does not hold. Hold the claim until the move is sent, and notify it
    /// then, so that no other move's parameters come in between.
    pub(crate) async fn prepare(&self) -> Result<(MoveCommand, Option<Claim<'_>>), AxisError> {
        let mut command = self.command;
        let handles = &self.axis.handles;
        let fields = &handles.shared.setup.fields;
        let by_sdo = BySdo::take(fields, &mut command.set_point.parameters);
        if let Some(name) = by_sdo.zero {
            let failure = Failure::Zero(name);
            return Err(handles.shared.error(AxisErrorKind::Failed(failure)));
        }
        if !by_sdo.is_needed(handles) {
            return Ok((command, None));
        }
        // What is refused must not have changed the drive's parameters.
        self.axis.run(Command::CheckMove(self.command)).await?;
        let mut claim = handles.claim().await?;
        by_sdo.write(handles, &mut claim).await?;
        Ok((command, Some(claim)))
    }

    fn trace(&self, what: &str, why: &dyn fmt::Display) {
        let identity = self.axis.identity();
        tracing::info!(
            axis = identity.axis,
            drive = %identity.drive,
            reference = ?self.command.reference,
            target = self.command.target,
            "{what}: {why}"
        );
    }
}
