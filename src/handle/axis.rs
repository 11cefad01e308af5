//! The handle of an axis that programs hold: every operation is awaited, from any executor and any thread.

use core::{
    fmt,
    marker::PhantomData,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};
use std::sync::{Arc, Mutex, PoisonError};

use crate::{
    Failure, StopRequest,
    axis::ParameterFault,
    axis::{Command, CommandedMode, Completion, DriveSettings, Snapshot},
    coe::{
        AxisOffset, Number, Object, ObjectAddress, ReadWrite, Readable, SdoError, Transfer,
        Writable, obj,
    },
    ds402::{Controlword, Mode, State},
    profile_position::{Limits, LimitsRule, MinVelocity, PositionRange, VelocityOverride},
    units::{AxisUnit, Counts, DriveUnits, Factors, Ratio, Scale, ScaleError, Unit},
};

use super::{
    AxisError, AxisErrorKind, AxisIdentity, ParameterAccess, ProfilePosition, error::HandleUnit,
    parameters::Claims, pending::Pending, request::AxisRequest, shared::Shared, stops::LastStop,
};

/// One axis. Clones are the same axis; commands of all of them are taken in the order in which they were given.
///
/// When the last of them, and of everything that came from them ([`ProfilePosition`],
/// [`Move`](crate::Move), [`Jog`](crate::profile_velocity::Jog) …), is dropped, a moving axis is stopped; see
/// [`keep_moving_on_drop`](Self::keep_moving_on_drop).
///
/// None of its stops is a safety function in the sense of the safety standards (STO, SS1).
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{AxisConfig, DriveConfig, Network, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::akd2g()).axis(AxisConfig::new("x").referencing(servocrab::Referencing::AbsoluteEncoder));
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// use servocrab::SetPoint;
/// let x = net.axis("x")?;
/// x.enable().await?;
/// let profile_position = x.profile_position().await?;
/// let motion = profile_position.move_abs(20_000, SetPoint::new().velocity(40_000)).await?;
/// x.halt().await?; // stands, and keeps where it is going
/// x.resume().await?;
/// motion.done_through_halt().await?; // `done` would end with the halt
/// assert!((x.status().position - 20_000).abs() < 50);
/// x.stop().await?;
/// x.disable().await?;
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
///
/// Positions, velocities and ramps of the handle, of its leases and of what comes of them are in its unit: the drive's own
/// [`Counts`], or what the axis was declared in ([`Network::axis_in`](crate::Network::axis_in)). Behind it the axis counts; nothing
/// else is different. A number that cannot be converted is refused as [`AxisErrorKind::Scale`], and nothing is written then.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{AxisConfig, DriveConfig, Network, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// use servocrab::{Axis, SetPoint, units::{Degree, Mm, Ratio, Scale}};
/// # let drive = DriveConfig::new(drives::akd2g())
/// #     .axis(AxisConfig::new("slide").unit::<Mm>(Scale::counts_per_unit(Ratio::new(1000, 1)?))).axis(AxisConfig::new("turret").unit::<Degree>(Scale::counts_per_unit(Ratio::new(3600, 360)?)));
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// let slide: Axis<Mm> = net.axis_in("slide")?;
/// let turret = net.axis_in::<Degree>("turret")?;
/// assert!(net.axis_in::<Mm>("turret").is_err(), "it was declared in degrees");
/// slide.enable().await?;
/// let on_slide = slide.profile_position().await?;
/// let moved = on_slide.move_rel(2.5, SetPoint::new().velocity(50.0)).await?;
/// println!("{} mm", moved.done().await?.position());
/// println!("{} °", turret.status().position);
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
///
/// What belongs to one unit does not fit another:
///
/// ```compile_fail,E0308
/// use servocrab::{Axis, AxisError, Outcome, ProfilePosition, SetPoint, units::{Degree, Mm}};
/// const FAST: SetPoint<Mm> = SetPoint::new().velocity(200.0);
/// async fn turn(turret: &ProfilePosition<Degree>) -> Result<(), AxisError> {
///     turret.move_abs(90.0, FAST).await?; // millimetres per second
///     Ok(())
/// }
/// ```
///
/// ```compile_fail,E0308
/// use servocrab::{Axis, units::{Degree, Mm}};
/// fn turn(turret: &Axis<Degree>) {}
/// fn mistaken(slide: &Axis<Mm>) {
///     turn(slide);
/// }
/// ```
///
/// ```compile_fail,E0308
/// use servocrab::{AxisError, Move, Outcome, units::{Degree, Mm}};
/// async fn arrived(moved: Move<Mm>) -> Result<Outcome<Degree>, AxisError> {
///     moved.done().await
/// }
/// ```
///
/// ```compile_fail,E0308
/// use servocrab::{AxisError, ProfilePosition, SetPoint};
/// async fn counts(pp: &ProfilePosition) -> Result<(), AxisError> {
///     pp.move_abs(2.5, SetPoint::new()).await?; // counts are whole
///     Ok(())
/// }
/// ```
#[derive(Clone)]
pub struct Axis<U: AxisUnit = Counts> {
    pub(super) handles: Arc<Handles>,
    pub(super) unit: HandleUnit,
    of_unit: PhantomData<U>,
}

impl<U: AxisUnit> fmt::Debug for Axis<U> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Axis")
            .field("handles", &self.handles)
            .field("unit", &self.unit)
            .finish()
    }
}

impl Axis {
    pub(super) fn new(handles: Arc<Handles>) -> Self {
        Self {
            handles,
            unit: HandleUnit::of::<Counts>(Scale::COUNTS),
            of_unit: PhantomData,
        }
    }

    /// This axis in another unit: for a scale that the program has read from the drive ([`factors`](Self::factors)). An axis whose scale is
    /// known before is declared in its unit.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{AxisConfig, DriveConfig, Network, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis(AxisConfig::new("x").referencing(servocrab::Referencing::AbsoluteEncoder));
    /// use servocrab::{SetPoint, units::{Mm, Ratio}};
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// let axis = net.axis("x")?;
    /// // A spindle of 5 mm a revolution; how many counts a revolution has, the drive's factor objects say.
    /// let x = axis.scaled::<Mm>(axis.factors().await?.scale(Ratio::new(5, 1)?)?)?;
    /// x.enable().await?;
    /// let profile_position = x.profile_position().await?;
    /// let motion = profile_position.move_abs(0.5, SetPoint::new().velocity(40.0)).await?;
    /// let position = motion.done().await?.position();
    /// assert!((position - 0.5).abs() < 0.001, "{position} mm");
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`AxisErrorKind::WrongUnit`] where the axis was declared in a unit: it has no other.
    pub fn scaled<U: Unit>(&self, scale: Scale) -> Result<Axis<U>, AxisError> {
        let declared = &self.handles.shared.setup.scale;
        if declared.is_in::<Counts>() {
            Ok(self.with(scale))
        } else {
            Err(self.wrong_unit::<U>())
        }
    }

    /// This axis in the unit in which it was declared.
    pub(super) fn declared_in<U: AxisUnit>(&self) -> Result<Axis<U>, AxisError> {
        let declared = &self.handles.shared.setup.scale;
        if declared.is_in::<U>() {
            Ok(self.with(*declared.scale()))
        } else {
            Err(self.wrong_unit::<U>())
        }
    }

    fn with<U: AxisUnit>(&self, scale: Scale) -> Axis<U> {
        Axis {
            handles: Arc::clone(&self.handles),
            unit: HandleUnit::of::<U>(scale),
            of_unit: PhantomData,
        }
    }

    fn wrong_unit<U: AxisUnit>(&self) -> AxisError {
        let shared = &self.handles.shared;
        shared.error(AxisErrorKind::WrongUnit {
            declared: shared.setup.scale.unit(),
            asked: U::NAME,
        })
    }
}

impl<U: AxisUnit> Axis<U> {
    /// The axis' name and its drive.
    #[must_use]
    pub fn identity(&self) -> &AxisIdentity {
        &self.handles.shared.identity
    }

    /// To Operation enabled, from every state but Fault. No motion follows from it. With a [brake](crate::AxisConfig::brake) on an output it ends
    /// when that is open.
    ///
    /// Once asked for it is completed, also when the future is dropped.
    ///
    /// # Errors
    /// With the reason for which the drive refuses: a fault, local control, no supply, or a deadline.
    /// [`Failure::BrakeNotReleased`](crate::Failure::BrakeNotReleased) where the feedback of its brake does not show it open in time.
    /// [`Failure::Busy`](crate::Failure::Busy) while another command changes the axis' state, or where a stop that is not sent yet
    /// has ended another enable. When the bus is lost.
    pub async fn enable(&self) -> Result<(), AxisError> {
        self.run(Command::Enable).await?;
        self.trace("enabled");
        Ok(())
    }

    /// Off power, to Ready to switch on or below. An axis that moves or is halted is stopped first and its set-point
    /// abandoned. A [brake](crate::AxisConfig::brake) on an output is closed before the power goes.
    ///
    /// # Errors
    /// [`Failure::AxisSlipped`](crate::Failure::AxisSlipped) where its brake does not hold it.
    /// [`Failure::Fault`](crate::Failure::Fault) when a fault overtakes the stop of an axis that moves. Also when the drive ignores the
    /// quick stop of that ([`QuickStopIgnored`](crate::Failure::QuickStopIgnored)), when a deadline passes, or the bus is lost.
    pub async fn disable(&self) -> Result<(), AxisError> {
        self.run(Command::Disable).await?;
        self.trace("disabled");
        Ok(())
    }

    /// Out of Fault, to Switch on disabled. It never enables. An axis without a fault stays as it is.
    ///
    /// # Errors
    /// [`Failure::Fault`](crate::Failure::Fault) if the drive keeps its fault. [`Failure::Busy`](crate::Failure::Busy) while another
    /// reset is under way. [`Failure::Disabled`](crate::Failure::Disabled) where the axis is disabled meanwhile. Also when the axis is not
    /// seen to stand within the deadline for standstill, or the bus is lost.
    pub async fn reset_fault(&self) -> Result<(), AxisError> {
        self.run(Command::ResetFault).await?;
        self.trace("fault reset");
        Ok(())
    }

    /// The latest snapshot.
    #[must_use]
    pub fn status(&self) -> Snapshot<U> {
        self.handles.shared.snapshot().in_unit(&self.unit.scale)
    }

    /// How many counts one of this handle's units is.
    #[must_use]
    pub const fn scale(&self) -> &Scale {
        &self.unit.scale
    }

    /// What the drive held, when the axis attached, of how it stops (605Ah to 605Eh) and of when it calls the axis standing
    /// (606Dh to 6070h). A drive that was brought up anew shows what it holds since.
    #[must_use]
    pub fn drive_settings(&self) -> DriveSettings {
        self.handles.shared.notes.settings()
    }

    /// The next snapshot in which anything but the cycle's number and age differs; `None` once the network has ended. The last one before
    /// that says that the drive is lost.
    ///
    /// It begins to look when it is polled first. A change between a look at [`status`](Self::status) and that poll is not seen. A
    /// program that waits for a state, and looks at `status` for it, polls this once before it looks.
    ///
    /// ```
    /// # async fn example(axis: servocrab::Axis) {
    /// while let Some(status) = axis.changed().await {
    ///     println!("{:?} at {}", status.state, status.position);
    /// }
    /// # }
    /// ```
    #[must_use = "it is `None` once the network has ended, and then at once: a loop that does not look at it goes round for ever"]
    pub async fn changed(&self) -> Option<Snapshot<U>> {
        let is_new = self.handles.shared.until_changed().await;
        is_new.then(|| self.status())
    }

    /// Selects Profile Position and leases it. The lease ends by [`ProfilePosition::release`] or by dropping it.
    ///
    /// # Errors
    /// [`AxisErrorKind::ModeInUse`] while another lease exists. [`Unsupported::Mode`](crate::profile_position::Unsupported::Mode)
    /// where 6502h does not name it. Otherwise when the drive does not show the mode in time, the axis moves or is halted in another mode,
    /// the axis was stopped meanwhile, or the bus is lost. A jog that an earlier lease has left is let go in any case.
    pub async fn profile_position(&self) -> Result<ProfilePosition<U>, AxisError> {
        let lease = Lease::take(&self.handles)?;
        self.select(Mode::ProfilePosition).await?;
        Ok(ProfilePosition::new(self.clone(), Arc::new(lease)))
    }

    /// Pauses by bit 8, keeping the set-point; resolves at standstill. [`resume`](Self::resume) goes on.
    ///
    /// Once asked for it is completed, also when the future is dropped. Then what is an error below is a quick stop: of an axis that does
    /// not get slower at bit 8, and where 605Dh is 0.
    ///
    /// # Errors
    /// [`Unsupported::Halt`](crate::profile_position::Unsupported::Halt) where 605Dh is 0: nothing was sent, and the axis moves on. Call [`stop`](Self::stop).
    /// [`HaltIgnored`](crate::Failure::HaltIgnored) when the axis does not get slower: bit 8 stays set, and the axis still moves. Call
    /// `stop` or [`quick_stop`](Self::quick_stop). That shows after 0.2 s at 8000 counts/s and more, and later for a slower axis (1.9 s at
    /// 200 counts/s), at the latest when the deadline for standstill passes. Also in Fault, when a deadline passes, or the bus is lost.
    pub async fn halt(&self) -> Result<(), AxisError> {
        self.stop_by(Command::Halt).await?;
        self.trace("halted");
        Ok(())
    }

    /// Stops the axis, which stays enabled where it stands: bit 8, and at standstill a set-point to there in place of those that the drive
    /// keeps, which end as [`Superseded`](crate::Failure::Superseded); then bit 8 falls, and it resolves. PLCopen
    /// calls it `MC_Halt`. An axis that stands without a set-point stays as it is.
    ///
    /// Once asked for it is completed, also when the future is dropped.
    ///
    /// # Errors
    /// [`Unsupported::Hold`](crate::profile_position::Unsupported::Hold) where nothing was sent, and the axis moves on: its drive is not
    /// known to take a set-point while it is halted
    /// ([`Traits::acknowledges_while_halted`](crate::profile_position::Traits::acknowledges_while_halted)), the axis is a modulo axis, or
    /// the drive cannot replace a move. Call [`stop`](Self::stop).
    /// [`NeedsStop`](crate::Failure::NeedsStop), or [`LivenessExpired`](crate::Failure::LivenessExpired), whose halt it would end.
    /// [`Unknown`](crate::Failure::Unknown) when the drive does not acknowledge: bit 8 stays set, and the axis needs a stop.
    /// [`Halted`](crate::Failure::Halted) where somebody halts it meanwhile: it stays halted. In another mode than Profile Position, and
    /// else as [`halt`](Self::halt).
    pub async fn stop_and_hold(&self) -> Result<(), AxisError> {
        self.handles.shared.check_unpaired()?;
        let settings = self.handles.shared.notes.settings();
        let can_hold = settings.traits.check_hold(settings.turn.is_some());
        can_hold.map_err(|failure| {
            let kind = AxisErrorKind::Failed(failure);
            self.handles.shared.error(kind)
        })?;
        self.stop_by(Command::Hold).await?;
        self.trace("stopped, and held");
        Ok(())
    }

    /// Makes moves so much faster or slower than asked for, 0.05 to 2: their profile velocity 6081h and end velocity 6082h. PLCopen calls it
    /// `MC_SetOverride`. It holds until it is set anew, for the moves that are sent from now on, and for the one under way where
    /// [`Traits::takes_velocity_at_once`](crate::profile_position::Traits::takes_velocity_at_once) says that its drive takes that. No
    /// set-point is sent again for it. To stop, [`halt`](Self::halt).
    ///
    /// # Errors
    /// Nothing changes, and [`Failure::Parameter`](crate::Failure::Parameter) says that the factor is out of range or 6081h is not in the
    /// process data, or [`Failure::BeyondLimit`](crate::Failure::BeyondLimit) that a move would be faster than 607Fh, or
    /// [`Failure::TooSlow`](crate::Failure::TooSlow) that one would be slower than 2010h.
    pub async fn set_override(&self, factor: f64) -> Result<(), AxisError> {
        self.handles.shared.check_unpaired()?;
        let factor = VelocityOverride::new(factor).ok_or_else(|| {
            let fault = ParameterFault::OutOfRange("0.05 to 2; to stop the axis, halt() it");
            let name = "the override";
            let refused = Failure::Parameter { name, fault };
            self.handles.shared.error(AxisErrorKind::Failed(refused))
        })?;
        self.run(Command::SetOverride(factor)).await?;
        self.trace("override set");
        Ok(())
    }

    /// Goes on after a halt; resolves when a frame with bit 8 low has been sent.
    ///
    /// # Errors
    /// [`Failure::Busy`](crate::Failure::Busy) while the halt is not sent yet: it is in the next frame all the same. Also while another
    /// resume is not sent yet.
    /// [`Failure::Halted`](crate::Failure::Halted) or [`Failure::QuickStopped`](crate::Failure::QuickStopped) where a stop has come
    /// before that frame: bit 8 has not fallen.
    /// [`Failure::Disabled`](crate::Failure::Disabled) where the axis is disabled before it.
    /// [`Unsupported::Resume`](crate::profile_position::Unsupported::Resume) if the drive has forgotten its set-point; in
    /// Fault, while not enabled, while moving, or when the bus is lost. [`PairError::Paired`](super::PairError::Paired) for one axis of a pair.
    pub async fn resume(&self) -> Result<(), AxisError> {
        self.handles.shared.check_unpaired()?;
        self.run(Command::Resume).await?;
        self.trace("resumed");
        Ok(())
    }

    /// Halts, then abandons the set-point by quick stop. Gives the state in which the drive stands, which 605Ah decides.
    /// A standing axis without a set-point stays as it is.
    ///
    /// # Errors
    /// [`Failure::Fault`](crate::Failure::Fault) when a fault overtakes it: the axis stands then. Also when the drive ignores the quick stop
    /// too ([`QuickStopIgnored`](crate::Failure::QuickStopIgnored)), when a deadline passes or the bus is lost.
    pub async fn stop(&self) -> Result<State, AxisError> {
        let state = self.stop_by(Command::Stop).await?;
        self.trace("stopped");
        Ok(state)
    }

    /// Quick stop (bit 2): the set-point is gone. Gives the state in which the drive stands, which 605Ah decides.
    ///
    /// # Errors
    /// In Fault (in Fault reaction active it waits until the axis stands), when the drive ignores it ([`QuickStopIgnored`](crate::Failure::QuickStopIgnored), after the same
    /// time as [`HaltIgnored`](crate::Failure::HaltIgnored)), when a deadline passes, or the bus is lost.
    pub async fn quick_stop(&self) -> Result<State, AxisError> {
        let state = self.stop_by(Command::QuickStop).await?;
        self.trace("quick stopped");
        Ok(state)
    }

    /// Stops it as by this request, and waits no longer than this.
    pub(crate) async fn stopped_within(
        &self,
        stop: StopRequest,
        within: Duration,
    ) -> Result<(), AxisError> {
        let stopped = async {
            if stop.contains(StopRequest::QUICK_STOP) {
                self.quick_stop().await.map(drop)
            } else if stop.contains(StopRequest::STOP) {
                self.stop().await.map(drop)
            } else {
                self.halt().await
            }
        };
        smol::future::or(stopped, self.handles.late(within)).await
    }

    /// Sets bits 11 to 15 of the controlword, which are the manufacturer's; other bits are ignored.
    pub fn set_manufacturer_bits(&self, bits: Controlword) {
        let shared = &self.handles.shared;
        shared.manufacturer.store(bits.bits(), Ordering::Release);
        shared.ask();
    }

    /// Lets the axis finish its move when the last handle is dropped, for the reason given.
    pub fn keep_moving_on_drop(&self, reason: &str) {
        self.handles.keep_moving.store(true, Ordering::Release);
        tracing::info!(
            target: super::LOG,
            axis = self.identity().axis,
            drive = %self.identity().drive,
            reason,
            "keeps moving when its last handle is dropped"
        );
    }

    pub(super) fn submit(&self, command: Command) -> Result<Pending, AxisError> {
        self.submit_asked(command, self.handles.shared.stops.last())
    }

    /// Submits what was asked for when this was the last stop.
    pub(super) fn submit_asked(
        &self,
        command: Command,
        asked: LastStop,
    ) -> Result<Pending, AxisError> {
        Pending::submit(Arc::clone(&self.handles), self.unit, command, asked)
    }

    /// The error for a number that cannot be converted.
    pub(super) fn scale_error(&self, error: ScaleError) -> AxisError {
        self.handles.shared.error(AxisErrorKind::Scale(error))
    }

    pub(super) async fn run(&self, command: Command) -> Result<Completion, AxisError> {
        self.submit(command)?.done().await
    }

    /// Ends the motion of a mode that is given back.
    pub(super) async fn release(&self) -> Result<(), AxisError> {
        self.run(Command::Release).await.map(drop)
    }

    pub(super) fn trace(&self, what: &str) {
        self.handles.shared.trace(what);
    }

    /// Stops of one kind that are asked for while one is under way share it.
    async fn stop_by(&self, command: Command) -> Result<State, AxisError> {
        Ok(match self.run(command).await? {
            Completion::Stopped { state } => state,
            _ => self.status().state,
        })
    }
}

/// An error is not held back longer than this for its code.
const ERROR_CODE_DEADLINE: Duration = Duration::from_secs(1);

const ERROR_CODE: ObjectAddress = ObjectAddress::new(0x603F, 0);

/// All handles of an axis together; the axis is stopped when the last one goes.
pub(super) struct Handles {
    pub shared: Arc<Shared>,
    /// The motions that depend on what the drive's parameters are, until the drive has taken each. What they have written stays in the drive
    /// when all handles are gone, and concerns handles of others: it is the axis'.
    pub claims: Arc<Claims>,
    keep_moving: AtomicBool,
    /// The last motion whose future was dropped before it was accepted.
    given_up: Mutex<Option<Arc<AxisRequest>>>,
}

/// By the axis alone, as all that is shared.
impl fmt::Debug for Handles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.shared.fmt(f)
    }
}

impl Handles {
    pub fn new(shared: Arc<Shared>, claims: Arc<Claims>) -> Self {
        Self {
            shared,
            claims,
            keep_moving: AtomicBool::new(false),
            given_up: Mutex::default(),
        }
    }

    /// Handles by whose end nothing is stopped.
    pub fn of_network(shared: Arc<Shared>, claims: Arc<Claims>) -> Self {
        let handles = Self::new(shared, claims);
        handles.keep_moving.store(true, Ordering::Release);
        handles
    }

    /// Gives a motion up, so far as it was not sent. `ends`: a homing that was sent is stopped.
    pub fn give_up(&self, request: &Arc<AxisRequest>, ends: bool) {
        let mut last = self.given_up.lock().unwrap_or_else(PoisonError::into_inner);
        *last = Some(Arc::clone(request));
        request.give_up(ends);
        self.shared.ask();
    }

    /// This much later by the network's time: [`AxisErrorKind::Late`], by which nothing is stopped.
    pub async fn late<T>(&self, within: Duration) -> Result<T, AxisError> {
        let signals = &self.shared.setup.groups.signals;
        signals
            .sleep_until(signals.now().saturating_add(within))
            .await;
        Err(self.late_error(within))
    }

    /// What is said when nobody waits any longer for what goes on.
    pub fn late_error(&self, within: Duration) -> AxisError {
        let snapshot = self.shared.snapshot();
        self.shared.error(AxisErrorKind::Late {
            within,
            statusword: snapshot.statusword,
            controlword: snapshot.controlword,
        })
    }

    fn parameters(&self) -> &dyn ParameterAccess {
        &*self.shared.setup.parameters
    }

    /// An object as the drive numbers it for this axis.
    pub fn of_axis(&self, object: ObjectAddress) -> ObjectAddress {
        ObjectAddress::new(
            self.shared.setup.offset.apply(object.index),
            object.subindex,
        )
    }

    /// Writes an object of this axis by SDO.
    pub async fn write_parameter(
        &self,
        object: ObjectAddress,
        value: Vec<u8>,
    ) -> Result<(), AxisError> {
        let object = self.of_axis(object);
        let written = self.parameters().write(object, value).await;
        written.map_err(|error| self.shared.error(AxisErrorKind::Sdo(Arc::new(error))))
    }

    /// 6060h.
    async fn write_mode(&self, mode: CommandedMode) -> Result<(), AxisError> {
        let value = vec![mode.byte()];
        self.write_parameter(MODE_OF_OPERATION, value).await
    }

    /// Writes an object of this axis. Where it is mapped, an SDO would be overwritten by the next frame.
    pub async fn put<T: Number, A: Writable>(
        &self,
        object: Object<T, A>,
        value: T,
    ) -> Result<(), AxisError> {
        let (shared, address) = (&self.shared, object.address());
        match shared.outputs.place_of(self.of_axis(address)) {
            Some(cell) => {
                shared.write_output(cell, value.to_raw());
                Ok(())
            }
            None => self.write_parameter(address, value.encode()).await,
        }
    }

    /// Reads an object of this axis.
    pub async fn read<T: Number, A: Readable>(&self, object: Object<T, A>) -> Result<T, AxisError> {
        let read = read(self.parameters(), self.shared.setup.offset, object).await;
        read.map_err(|error| self.shared.error(AxisErrorKind::Sdo(Arc::new(error))))
    }

    pub async fn read_parameter(&self, object: ObjectAddress) -> Result<Vec<u8>, AxisError> {
        let object = self.of_axis(object);
        let read = self.parameters().read(object).await;
        read.map_err(|error| self.shared.error(AxisErrorKind::Sdo(Arc::new(error))))
    }

    /// What was asked for when this was the last stop has ended with any stop since. It is not to write parameters any more: they would be
    /// those of what has come after it.
    pub async fn check_not_stopped(&self, asked: LastStop) -> Result<(), AxisError> {
        let shared = &self.shared;
        match shared.stops.since(asked, shared.snapshot().state) {
            Some(failure) => Err(self.fail(failure).await),
            None => Ok(()),
        }
    }

    /// The error for a failure. A fault whose code is not in the process data is asked for its code, so that the error
    /// has it.
    pub async fn fail(&self, failure: Failure) -> AxisError {
        let failure = match failure {
            // The drive may show bit 13 some cycles after its fault.
            Failure::Fault {
                code,
                following_error,
            } => Failure::Fault {
                code: match code {
                    None => self.read_error_code().await,
                    known => known,
                },
                following_error: following_error || self.shows_faulty_lag(),
            },
            failure => failure,
        };
        if let Failure::Fault { code, .. } = failure {
            let status = self.shared.snapshot();
            // The fault itself is logged once, by the owner of the cycle.
            tracing::debug!(
                target: super::LOG,
                axis = self.shared.identity.axis,
                drive = %self.shared.identity.drive,
                code = code.map(tracing::field::display),
                statusword = %status.statusword,
                controlword = %status.controlword,
                "{failure}"
            );
        }
        self.shared.error(AxisErrorKind::Failed(failure))
    }

    /// Whether the drive shows a fault with a following error.
    fn shows_faulty_lag(&self) -> bool {
        let status = self.shared.snapshot();
        status.state.is_fault() && status.shows_following_error()
    }

    /// Error code 603Fh, by SDO; none if it cannot be read, or not soon.
    pub async fn read_error_code(&self) -> Option<u16> {
        let read = async { self.read_parameter(ERROR_CODE).await.ok() };
        let late = async {
            let _ = self.late::<()>(ERROR_CODE_DEADLINE).await;
            None
        };
        let value = smol::future::or(read, late).await?;
        Some(u16::from_le_bytes(value.try_into().ok()?))
    }
}

impl Drop for Handles {
    fn drop(&mut self) {
        let status = self.shared.snapshot();
        // An axis without a set-point has nothing to stop, whatever 606Ch shows: at rest that is seldom 0. A stop that comes a cycle
        // later would end what the next handle has begun.
        let given_up = self.given_up.get_mut();
        let given_up = given_up.unwrap_or_else(PoisonError::into_inner);
        // The frame with its bit 4 may be under way, and then no snapshot shows it yet.
        let may_be_sent = given_up.as_ref().is_some_and(|request| !request.is_done());
        let may_move = status.has_set_point || may_be_sent;
        if may_move && !self.keep_moving.load(Ordering::Acquire) {
            self.shared.request_stop(StopRequest::STOP);
            self.shared.trace("last handle dropped: stopped");
        }
    }
}

/// The one lease of a mode.
#[derive(Debug)]
pub(super) struct Lease {
    shared: Arc<Shared>,
}

impl Lease {
    pub fn take(handles: &Handles) -> Result<Self, AxisError> {
        let shared = &handles.shared;
        if !shared.take_lease() {
            shared.check_unpaired()?;
            return Err(shared.error(AxisErrorKind::ModeInUse));
        }
        shared.trace("mode leased");
        Ok(Self {
            shared: Arc::clone(shared),
        })
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        self.shared.give_lease_back();
        self.shared.trace("mode lease given back");
    }
}

const MODE_OF_OPERATION: ObjectAddress = ObjectAddress::new(0x6060, 0);
const MODE_OF_OPERATION_DISPLAY: ObjectAddress = ObjectAddress::new(0x6061, 0);

impl<U: AxisUnit> Axis<U> {
    /// Selects a mode; ready when the drive shows it. Whoever asks for it is about to move the axis: a stop that comes meanwhile ends
    /// it.
    pub(super) async fn select(&self, mode: Mode) -> Result<(), AxisError> {
        let asked = self.handles.shared.stops.last();
        self.change_mode(mode).await?;
        self.handles.check_not_stopped(asked).await
    }

    async fn change_mode(&self, mode: Mode) -> Result<(), AxisError> {
        let handles = &self.handles;
        let fields = &handles.shared.setup.fields;
        if handles
            .shared
            .notes
            .home_offset_in_doubt
            .load(Ordering::Acquire)
        {
            // Limits are counted from it.
            let start = handles.shared.notes.starts();
            let offset = self.read_if_there(obj::HOME_OFFSET).await?;
            handles.shared.note_home_offset(start, offset.unwrap_or(0));
        }
        if fields.mode.is_none() {
            // Nothing is written before the axis has said that it stands and that nothing of the last mode is left.
            let preparing = self.submit(Command::PrepareMode(mode))?;
            let said = preparing.withdraw_on_drop().done().await?;
            // In the mode already, nothing is written, and a motion goes on.
            if let Some(mode) = CommandedMode::by_sdo(said) {
                if fields.mode_display.is_none() {
                    // What was read before says nothing from here on.
                    handles.shared.note_mode(Mode::None.raw());
                }
                handles.write_mode(mode).await?;
            }
        }
        let pending = self.submit(Command::SelectMode(mode))?.withdraw_on_drop();
        if fields.mode_display.is_some() {
            return pending.done().await.map(drop);
        }
        let shown = async {
            loop {
                let value = handles.read_parameter(MODE_OF_OPERATION_DISPLAY).await?;
                if let Some(raw) = value.first() {
                    handles.shared.note_mode(raw.cast_signed());
                }
                // The mailbox sets the pace: a transfer takes some cycles.
                smol::future::yield_now().await;
            }
        };
        smol::future::or(async { pending.done().await.map(drop) }, shown).await
    }
}

/// Reads an object of an axis.
async fn read<T: Number, A: Readable>(
    parameters: &dyn ParameterAccess,
    offset: AxisOffset,
    object: Object<T, A>,
) -> Result<T, SdoError> {
    let address = object.offset(offset).address();
    let bytes = parameters.read(address).await?;
    T::decode(&bytes).ok_or_else(|| SdoError::WrongSize {
        transfer: Transfer::read(address),
        expected: usize::from(T::BITS / 8),
        got: bytes.len(),
    })
}

/// Reads an object of an axis; none where the drive does not have it.
pub(super) async fn read_if_there<T: Number, A: Readable>(
    parameters: &dyn ParameterAccess,
    offset: AxisOffset,
    object: Object<T, A>,
) -> Result<Option<T>, SdoError> {
    match read(parameters, offset, object).await {
        Ok(value) => Ok(Some(value)),
        Err(error) => match error.abort_code() {
            Some(code) if code.is_no_object() => Ok(None),
            _ => Err(error),
        },
    }
}

impl Limits {
    /// Reads 607Bh, 607Ch, 607Dh and 607Fh of an axis, and 2010h where the drive's rule names it; what the drive does not have is no limit.
    ///
    /// # Errors
    /// When an object that the drive has could not be read.
    pub async fn read(
        parameters: &dyn ParameterAccess,
        offset: AxisOffset,
        rule: &LimitsRule,
    ) -> Result<Self, SdoError> {
        let range = async |min, max| {
            let min = read_if_there(parameters, offset, min).await?;
            let max = read_if_there(parameters, offset, max).await?;
            Ok(min.zip(max).map(|(min, max)| PositionRange { min, max }))
        };
        let home_offset = read_if_there(parameters, offset, obj::HOME_OFFSET).await?;
        let min_velocity = match rule.min_velocity {
            MinVelocity::Absent => None,
            MinVelocity::UnitUnknown | MinVelocity::AsProfileVelocity => {
                read_if_there(parameters, offset, obj::MIN_PROFILE_VELOCITY).await?
            }
        };
        Ok(Self {
            software: range(obj::SOFTWARE_LIMIT_MIN, obj::SOFTWARE_LIMIT_MAX).await?,
            home_offset: home_offset.unwrap_or(0),
            position_range: range(obj::POSITION_RANGE_MIN, obj::POSITION_RANGE_MAX).await?,
            max_velocity: read_if_there(parameters, offset, obj::MAX_PROFILE_VELOCITY).await?,
            min_velocity,
        })
    }
}

impl<U: AxisUnit> Axis<U> {
    /// Reads the limits 607Bh, 607Ch, 607Dh and 607Fh of this axis again, and 2010h of a drive that has it as min profile velocity, and checks
    /// moves against them from now on. It is for programs that have changed one of them since the axis attached. It replaces what was set with
    /// `AxisConfig::limits`.
    ///
    /// # Errors
    /// [`AxisErrorKind::Sdo`] if an object could not be read, or when the bus is lost: the limits stay as they were then.
    pub async fn read_limits(&self) -> Result<Limits, AxisError> {
        let shared = &self.handles.shared;
        let setup = &shared.setup;
        // Several objects, one after the other: a homing, a recovery or another task may come in between.
        loop {
            let before = shared.notes.limits_changed();
            let rule = &shared.limits_rule;
            let read = Limits::read(&*setup.parameters, setup.offset, rule).await;
            let limits = read.map_err(|error| shared.error(AxisErrorKind::Sdo(Arc::new(error))))?;
            if before != shared.notes.limits_changed() {
                continue;
            }
            self.run(Command::SetLimits(limits)).await?;
            if before == shared.notes.limits_changed() {
                shared.notes.note_limits_changed();
                return Ok(limits);
            }
        }
    }

    /// Reads an object of this axis; none where the drive does not have it.
    pub(super) async fn read_if_there<T: Number, A: Readable>(
        &self,
        object: Object<T, A>,
    ) -> Result<Option<T>, AxisError> {
        let shared = &self.handles.shared;
        let setup = &shared.setup;
        let read = read_if_there(&*setup.parameters, setup.offset, object).await;
        read.map_err(|error| shared.error(AxisErrorKind::Sdo(Arc::new(error))))
    }

    /// Reads the factor objects 608Fh, 6091h, 6092h, 6096h and 6097h of this axis by SDO, and 6093h and 6094h of older drives. A
    /// drive that has 6093h is taken to follow [`Edition::Version2`](crate::units::Edition::Version2). Objects that the drive does not have are left out.
    ///
    /// # Errors
    /// [`AxisErrorKind::Sdo`] if an object could not be read, [`ScaleError::ZeroFactor`] if one is 0.
    pub async fn factors(&self) -> Result<Factors, AxisError> {
        let mut held = [None; DriveUnits::FACTORS.len()];
        for (held, [numerator, divisor]) in held.iter_mut().zip(DriveUnits::FACTORS) {
            *held = self.factor(numerator, divisor).await?;
        }
        Ok(DriveUnits::factors(held))
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
}
