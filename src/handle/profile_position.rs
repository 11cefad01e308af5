//! Profile Position as a lease of an axis: moves are asked for here.

use core::{
    fmt,
    future::Future,
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};
use std::sync::Arc;

use crate::{
    Failure, SetPoint,
    axis::{Command, Completion, ParameterFault},
    profile_position::{MoveCommand, Reference},
    units::{AxisUnit, Counts},
};

use super::{
    Axis, AxisError, AxisErrorKind, BoxFuture,
    axis::{Handles, Lease},
    error::HandleUnit,
    parameters::{BySdo, Claim},
    pending::Pending,
    stops::LastStop,
};

/// The lease of an axis in Profile Position mode, from [`Axis::profile_position`].
///
/// Dropping it gives the mode back and leaves the motion alone; [`release`](Self::release) ends the motion as well.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{AxisConfig, DriveConfig, Network, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::akd2g()).axis(AxisConfig::new("x").referencing(servocrab::Referencing::AbsoluteEncoder));
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// use servocrab::{BufferMode, Outcome, SetPoint};
/// let x = net.axis("x")?;
/// x.enable().await?;
/// let profile_position = x.profile_position().await?;
/// let set_point = SetPoint::new().velocity(50_000).acceleration(500_000).deceleration(500_000);
/// let first = profile_position.move_abs(2_000, set_point).await?; // the drive has acknowledged
/// let second = profile_position.move_abs(5_000, set_point.buffer_mode(BufferMode::Blending)).await?;
/// assert!(matches!(first.done().await?, Outcome::Passed { .. })); // without a stop
/// assert!(matches!(second.done().await?, Outcome::Reached { .. }));
/// profile_position.release().await?; // for the next mode
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug)]
pub struct ProfilePosition<U: AxisUnit = Counts> {
    pub(super) axis: Axis<U>,
    _lease: Arc<Lease>,
}

impl<U: AxisUnit> ProfilePosition<U> {
    pub(super) const fn new(axis: Axis<U>, lease: Arc<Lease>) -> Self {
        Self {
            axis,
            _lease: lease,
        }
    }

    /// The axis.
    #[must_use]
    pub const fn axis(&self) -> &Axis<U> {
        &self.axis
    }

    /// Moves to a position; resolves when the drive has acknowledged the set-point.
    ///
    /// Parameters that the set-point names and that are not in the process data are written by SDO and confirmed
    /// before. Dropped before bit 4 rose, the move is withdrawn; later, the drive executes it, or is halted where the set-point
    /// says so ([`SetPoint::halt_on_drop`]).
    ///
    /// # Errors
    /// With the reason: the axis refuses the move (not enabled, halted, a fault, a start that the drive cannot do, a parameter of
    /// zero …), the drive did not take it, a parameter could not be written, or a number cannot be converted into counts. A failure says whether the set-point was not sent,
    /// was accepted, or may have been taken.
    pub async fn move_abs(
        &self,
        target: U::Signed,
        set_point: SetPoint<U>,
    ) -> Result<Move<U>, AxisError> {
        self.abs(target, set_point).send().await
    }

    /// Moves by a distance from the base that the drive documents (60F2h); otherwise as [`move_abs`](Self::move_abs). Each distance is
    /// rounded to counts by itself: many of them add up to as many roundings, which absolute targets do not.
    ///
    /// # Errors
    /// As [`move_abs`](Self::move_abs).
    pub async fn move_rel(
        &self,
        distance: U::Signed,
        set_point: SetPoint<U>,
    ) -> Result<Move<U>, AxisError> {
        self.rel(distance, set_point).send().await
    }

    /// A move to a position that is not sent yet, for [`start_together`](crate::start_together) and [`follow`](Self::follow).
    pub fn abs(&self, target: U::Signed, set_point: SetPoint<U>) -> MoveRequest<U> {
        self.request(Reference::Absolute, target, set_point)
    }

    /// A move by a distance that is not sent yet, for [`start_together`](crate::start_together) and [`follow`](Self::follow).
    pub fn rel(&self, distance: U::Signed, set_point: SetPoint<U>) -> MoveRequest<U> {
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

    fn request(
        &self,
        reference: Reference,
        target: U::Signed,
        set_point: SetPoint<U>,
    ) -> MoveRequest<U> {
        MoveRequest {
            lease: self.axis.handles.shared.lease(),
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

/// A move that is not sent yet. It belongs to the [`ProfilePosition`] that it was made with. Once that is released or dropped it is
/// refused as [`AxisErrorKind::NotLeased`], and as [`AxisErrorKind::ModeInUse`] while the axis is leased again.
#[must_use = "it is sent by `start_together` or `follow`"]
#[derive(Debug, Clone)]
pub struct MoveRequest<U: AxisUnit = Counts> {
    /// The lease that it is of.
    lease: u64,
    pub(super) axis: Axis<U>,
    pub(super) command: MoveCommand<U>,
}

impl<U: AxisUnit> MoveRequest<U> {
    pub(super) async fn send(self) -> Result<Move<U>, AxisError> {
        // A stop that comes while parameters are being written stops this move as well.
        let asked = self.axis.handles.shared.stops.last();
        self.send_asked(asked).await
    }

    /// The same for one that was asked for when this was the last stop.
    pub(super) async fn send_asked(self, asked: LastStop) -> Result<Move<U>, AxisError> {
        let request = self.in_counts();
        let split = request.split()?;
        let (command, claim) = request.write(split, asked).await?;
        let pending = request.submit(command, asked)?;
        if let Some(claim) = claim {
            claim.sent(&pending);
        }
        let pending = request.accepted(pending).await?;
        Ok(Move::new(pending, self.command))
    }

    /// The same, whatever the unit. A number that cannot be converted fails it before anything is sent.
    pub(super) fn in_counts(&self) -> CountsRequest {
        let command = self.command.in_counts(&self.axis.unit.scale);
        CountsRequest {
            handles: Arc::clone(&self.axis.handles),
            lease: self.lease,
            unit: self.axis.unit,
            command: command.map_err(|error| self.axis.scale_error(error)),
        }
    }
}

/// A move in the drive's units that is not sent yet.
#[derive(Debug)]
pub(super) struct CountsRequest {
    pub handles: Arc<Handles>,
    pub lease: u64,
    unit: HandleUnit,
    command: Result<MoveCommand, AxisError>,
}

/// A move in the drive's units, with what of it is written by SDO.
#[derive(Debug)]
pub(super) struct SplitMove {
    pub asked: MoveCommand,
    /// Without what is written by SDO.
    command: MoveCommand,
    /// None where nothing can be.
    by_sdo: Option<BySdo>,
    /// Whether the axis core has said that it would not refuse the move.
    pub checked: bool,
}

impl CountsRequest {
    pub fn last_stop(&self) -> LastStop {
        self.handles.shared.stops.last()
    }

    pub fn submit(&self, command: MoveCommand, asked: LastStop) -> Result<Pending, AxisError> {
        self.check_lease()?;
        let handles = Arc::clone(&self.handles);
        Pending::submit(handles, self.unit, Command::Move(command), asked)
    }

    /// A move is of one lease. Once that is given back the axis may be another's, or in another mode.
    pub fn check_lease(&self) -> Result<(), AxisError> {
        let shared = &self.handles.shared;
        let checked = shared.check_lease(self.lease);
        checked.map_err(|kind| shared.error(kind))
    }

    /// Waits for the acknowledge.
    pub async fn accepted(&self, mut pending: Pending) -> Result<Pending, AxisError> {
        match pending.accepted().await {
            Ok(()) => {
                self.trace("move accepted", &"by the drive");
                Ok(pending)
            }
            Err(error) => {
                self.trace("move not accepted", &error.reason());
                Err(error)
            }
        }
    }

    /// Takes out of the move what the process data does not hold, and what is to be written by SDO therefore.
    pub fn split(&self) -> Result<SplitMove, AxisError> {
        self.check_lease()?;
        let asked = self.command.clone()?;
        let mut command = asked;
        let handles = &*self.handles;
        let fields = &handles.shared.setup.fields;
        let by_sdo = BySdo::take(fields, &mut command.set_point.parameters);
        if let Some(name) = by_sdo.zero {
            let failure = Failure::Parameter {
                name,
                fault: ParameterFault::Zero,
            };
            return Err(handles.shared.error(AxisErrorKind::Failed(failure)));
        }
        Ok(SplitMove {
            asked,
            command,
            by_sdo: by_sdo.some(),
            checked: false,
        })
    }

    /// Whether anything of this has to be written to the drive, as far as is known.
    pub fn has_to_write(&self, split: &SplitMove) -> bool {
        let by_sdo = split.by_sdo.as_ref();
        by_sdo.is_some_and(|by_sdo| self.handles.have_to_write(by_sdo))
    }

    /// Writes by SDO what is to be written so, of a move that was asked for when `asked` was the last stop. Hold the claim until the move
    /// is sent, and notify it then, so that no other move's parameters come in between.
    pub async fn write(
        &self,
        split: SplitMove,
        asked: LastStop,
    ) -> Result<(MoveCommand, Option<Claim<'_>>), AxisError> {
        let Some(by_sdo) = split.by_sdo else {
            return Ok((split.command, None));
        };
        let handles = &*self.handles;
        let mut checked = split.checked;
        if !checked && handles.have_to_write(&by_sdo) {
            self.check(split.asked).await?;
            checked = true;
        }
        let mut claim = handles.claim(&by_sdo).await?;
        if claim.written.is_some() {
            if !checked {
                self.check(split.asked).await?;
            }
            self.check_still_asked(asked).await?;
            by_sdo.write(&mut claim).await?;
        }
        Ok((split.command, Some(claim)))
    }

    /// Since it was checked the axis may have been stopped, or leased by another: then the drive's parameters are those of a motion that
    /// came after this move.
    async fn check_still_asked(&self, asked: LastStop) -> Result<(), AxisError> {
        self.check_lease()?;
        let checked = self.handles.check_not_stopped(asked).await;
        checked.map_err(|error| error.in_unit(self.unit))
    }

    /// What is refused must not have changed the drive's parameters.
    async fn check(&self, asked: MoveCommand) -> Result<(), AxisError> {
        let check = self.submit_check(asked)?;
        check.done().await?;
        Ok(())
    }

    /// Asks whether this move would be refused.
    pub fn submit_check(&self, asked: MoveCommand) -> Result<Pending, AxisError> {
        let check = Command::CheckMove(asked);
        let handles = Arc::clone(&self.handles);
        Pending::submit(handles, self.unit, check, self.last_stop())
    }

    fn trace(&self, what: &str, why: &dyn fmt::Display) {
        let identity = &self.handles.shared.identity;
        let Ok(command) = &self.command else { return };
        tracing::debug!(
            target: super::LOG,
            axis = identity.axis,
            drive = %identity.drive,
            reference = ?command.reference,
            to = self.unit.position(command.target),
            "{what}: {why}"
        );
    }
}

/// How a move ended well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(
    feature = "serde",
    serde(bound(serialize = "U::Signed: serde::Serialize"))
)]
#[non_exhaustive]
pub enum Outcome<U: AxisUnit = Counts> {
    /// It arrived at its target and nothing followed it in motion.
    Reached {
        /// Position actual value 6064h when it was seen.
        position: U::Signed,
    },
    /// It met the torque that ends it ([`SetPoint::until_torque`]), and the axis is held.
    Contact {
        /// Position actual value 6064h when the torque had lasted.
        position: U::Signed,
        /// Torque actual value 6077h then, in thousandths of the rated torque.
        torque: i16,
    },
    /// It passed its target, into the next one that is blended into it.
    Passed {
        /// Position actual value 6064h when this was known. Where bit 12 does not show the drive's buffer the axis is then half of the way to
        /// the next target, or further.
        position: U::Signed,
    },
}

impl<U: AxisUnit> Outcome<U> {
    /// Position actual value 6064h when it was seen.
    #[must_use]
    pub const fn position(&self) -> U::Signed {
        match *self {
            Self::Reached { position }
            | Self::Passed { position }
            | Self::Contact { position, .. } => position,
        }
    }
}

impl<U: AxisUnit> fmt::Display for Outcome<U> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reached { position } => write!(f, "reached {position}"),
            Self::Passed { position } => write!(f, "passed {position}"),
            Self::Contact { position, torque } => {
                write!(
                    f,
                    "contact at {position}, with {torque} ‰ of the rated torque"
                )
            }
        }
    }
}

/// A move that the drive has acknowledged. Dropping it stops the motion only where its set-point says so
/// ([`SetPoint::halt_on_drop`]).
#[must_use = "await `done()` for the outcome"]
#[derive(Debug)]
pub struct Move<U: AxisUnit = Counts> {
    pending: Pending,
    command: MoveCommand<U>,
}

impl<U: AxisUnit> Move<U> {
    pub(super) const fn new(pending: Pending, command: MoveCommand<U>) -> Self {
        Self { pending, command }
    }

    /// What was asked for.
    #[must_use]
    pub const fn command(&self) -> &MoveCommand<U> {
        &self.command
    }

    /// Waits for the outcome, of which there is exactly one: asked again it is the same. A halt, by anyone, ends the
    /// wait with [`Failure::Halted`] when the axis stands, once for each halt: the move may go on, and so may a later
    /// wait. There is no deadline unless one is given by [`Done::within`].
    ///
    /// # Errors
    /// Of the future: the [`Failure`] of the move, with the drive's error code for a fault.
    pub fn done(&self) -> Done<'_, U> {
        self.wait(false)
    }

    /// As [`done`](Self::done), but waits on through halts until the move is resumed and done, or abandoned.
    ///
    /// # Errors
    /// Of the future: the [`Failure`] of the move, with the drive's error code for a fault.
    pub fn done_through_halt(&self) -> Done<'_, U> {
        self.wait(true)
    }

    /// The outcome, if it is there: nothing is waited for.
    #[must_use]
    pub fn outcome(&self) -> Option<Result<Outcome<U>, Failure>> {
        self.pending
            .result()
            .map(|result| result.and_then(|completion| self.outcome_of(completion)))
    }

    fn wait(&self, through_halt: bool) -> Done<'_, U> {
        let result = async move {
            let completion = if through_halt {
                self.pending.done().await
            } else {
                self.pending.done_or_halted().await
            };
            let result = completion.and_then(|completion| {
                self.outcome_of(completion)
                    .map_err(|failure| self.pending.error(AxisErrorKind::Failed(failure)))
            });
            self.trace(&result);
            result
        };
        Done {
            pending: &self.pending,
            result: Box::pin(result),
        }
    }

    /// A move has no other way to end well.
    fn outcome_of(&self, completion: Completion) -> Result<Outcome<U>, Failure> {
        let at = |position| self.pending.unit.scale.position_in::<U>(position);
        if let Some((position, torque)) = self.pending.request.contact() {
            return Ok(Outcome::Contact {
                position: at(position),
                torque,
            });
        }
        match completion {
            Completion::Reached { position } => Ok(Outcome::Reached {
                position: at(position),
            }),
            Completion::Passed { position } => Ok(Outcome::Passed {
                position: at(position),
            }),
            Completion::Homed { .. }
            | Completion::Stopped { .. }
            | Completion::Prepared { .. }
            | Completion::Done => Err(Failure::QUICK_STOPPED),
        }
    }

    fn trace(&self, result: &Result<Outcome<U>, AxisError>) {
        let identity = &self.pending.handles.shared.identity;
        let to = || format!("{} {}", self.command.target, U::NAME);
        match result {
            Ok(outcome) => tracing::debug!(
                target: super::LOG,
                axis = identity.axis,
                drive = %identity.drive,
                to = to(),
                %outcome,
                "move done"
            ),
            Err(error) => tracing::debug!(
                target: super::LOG,
                axis = identity.axis,
                drive = %identity.drive,
                to = to(),
                "move ended: {}",
                error.reason()
            ),
        }
    }
}

/// The wait for the outcome of a [`Move`].
#[must_use = "futures do nothing unless awaited"]
pub struct Done<'a, U: AxisUnit = Counts> {
    pending: &'a Pending,
    result: BoxFuture<'a, Result<Outcome<U>, AxisError>>,
}

impl<U: AxisUnit> Done<'_, U> {
    /// Waits no longer than this, by the network's time, from when it is first polled; then [`AxisErrorKind::Late`]. That stops
    /// nothing: the move goes on, and can be waited for again.
    pub fn within(self, deadline: Duration) -> Self {
        let pending = self.pending;
        let late = pending.handles.late(deadline);
        Done {
            pending,
            result: Box::pin(smol::future::or(self.result, late)),
        }
    }
}

impl<U: AxisUnit> Future for Done<'_, U> {
    type Output = Result<Outcome<U>, AxisError>;

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Self::Output> {
        self.result.as_mut().poll(cx)
    }
}

impl<U: AxisUnit> fmt::Debug for Done<'_, U> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Done").finish_non_exhaustive()
    }
}
