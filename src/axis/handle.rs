//! The handle of an axis that programs hold: every operation is awaited, from any executor and any thread.

use core::{
    fmt,
    sync::atomic::{AtomicBool, AtomicU32, Ordering},
    time::Duration,
};
use std::sync::Arc;

use crate::{
    coe::ObjectAddress,
    ds402::{Controlword, Mode, State},
    profile_position::ProfilePosition,
};

use super::{
    AxisError, AxisErrorKind, AxisIdentity, Claims, Command, CommandId, Completion, DriveSettings,
    ParameterAccess, Snapshot, StopRequest, last_stop::LastStop, pending::Pending, shared::Shared,
};

/// One axis. Clones are the same axis; commands of all of them are taken in the order in which they were given.
///
/// When the last of them, and of everything that came from them ([`ProfilePosition`],
/// [`Move`](crate::profile_position::Move), [`Jog`](crate::profile_velocity::Jog) …), is dropped, a moving axis is stopped; see
/// [`keep_moving_on_drop`](Self::keep_moving_on_drop).
///
/// None of its stops is a safety function in the sense of the safety standards (STO, SS1).
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::akd2g()).axis("x").referencing("x", servocrab::axis::Referencing::AbsoluteEncoder);
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// use servocrab::profile_position::SetPoint;
/// let x = net.axis("x")?;
/// x.enable().await?;
/// let profile_position = x.profile_position().await?;
/// let motion = profile_position.move_abs(20_000, SetPoint::new().velocity(40_000)).await?;
/// x.halt().await?; // stands, and keeps where it is going
/// x.resume().await?;
/// motion.done_through_halt().await?; // `done` would tell of the halt
/// assert!((x.status().position - 20_000).abs() < 50);
/// x.stop().await?;
/// x.disable().await?;
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Axis {
    pub(crate) handles: Arc<Handles>,
}

impl Axis {
    pub(super) fn new(handles: Arc<Handles>) -> Self {
        Self { handles }
    }

    /// The axis' name and its drive.
    #[must_use]
    pub fn identity(&self) -> &AxisIdentity {
        &self.handles.shared.identity
    }

    /// To Operation enabled, from every state but Fault. No motion follows from it.
    ///
    /// Once asked for it is completed, also when the future is dropped.
    ///
    /// # Errors
    /// With the reason for which the drive refuses: a fault, local control, no supply, or a deadline.
    /// [`Failure::Busy`](super::Failure::Busy) while another command changes the axis' state, or where a stop that is not sent yet
    /// has ended another enable. When the bus is lost.
    pub async fn enable(&self) -> Result<(), AxisError> {
        self.run(Command::Enable).await?;
        self.trace("enabled");
        Ok(())
    }

    /// Off power, to Ready to switch on or below. An axis that moves or is halted is stopped first and its set-point
    /// abandoned.
    ///
    /// # Errors
    /// When a deadline passes or the bus is lost.
    pub async fn disable(&self) -> Result<(), AxisError> {
        self.run(Command::Disable).await?;
        self.trace("disabled");
        Ok(())
    }

    /// Out of Fault, to Switch on disabled. It never enables.
    ///
    /// # Errors
    /// [`Failure::NoFault`](super::Failure::NoFault), or [`Failure::Fault`](super::Failure::Fault) if the drive keeps
    /// its fault, or when the bus is lost.
    pub async fn reset_fault(&self) -> Result<(), AxisError> {
        self.run(Command::ResetFault).await?;
        self.trace("fault reset");
        Ok(())
    }

    /// The latest snapshot.
    #[must_use]
    pub fn status(&self) -> Snapshot {
        self.handles.shared.snapshot()
    }

    /// What the drive held, when the axis attached, of how it stops (605Ah to 605Eh) and of when it calls the axis standing
    /// (606Dh to 6070h). A drive that was brought up anew shows what it holds since.
    #[must_use]
    pub fn drive_settings(&self) -> DriveSettings {
        self.handles.shared.drive_settings()
    }

    /// The next snapshot in which anything but the cycle's number and age differs; `None` once the network has ended. The last one before
    /// that says that the drive is lost.
    ///
    /// ```
    /// # async fn example(axis: servocrab::axis::Axis) {
    /// while let Some(status) = axis.changed().await {
    ///     println!("{:?} at {}", status.state, status.position);
    /// }
    /// # }
    /// ```
    #[must_use = "it is `None` once the network has ended, and then at once: a loop that does not look at it goes round for ever"]
    pub async fn changed(&self) -> Option<Snapshot> {
        let shared = &self.handles.shared;
        shared.until_changed().await.then(|| shared.snapshot())
    }

    /// Selects Profile Position and leases it. The lease ends by [`ProfilePosition::release`] or by dropping it.
    ///
    /// # Errors
    /// [`AxisErrorKind::ModeInUse`] while another lease exists. [`Failure::ModeNotSupported`](super::Failure::ModeNotSupported)
    /// where 6502h does not name it. Otherwise when the drive does not show the mode in time, the axis moves in another mode, or
    /// the bus is lost.
    pub async fn profile_position(&self) -> Result<ProfilePosition, AxisError> {
        let lease = Lease::take(&self.handles)?;
        self.select(Mode::ProfilePosition).await?;
        Ok(ProfilePosition::new(self.clone(), lease))
    }

    /// Pauses by bit 8, keeping the set-point; resolves at standstill. [`resume`](Self::resume) goes on.
    ///
    /// Once asked for it is completed, also when the future is dropped.
    ///
    /// # Errors
    /// In Fault, when the axis does not get slower ([`HaltIgnored`](super::Failure::HaltIgnored), after two tenths of a second),
    /// when a deadline passes, or the bus is lost.
    pub async fn halt(&self) -> Result<(), AxisError> {
        self.stop_by(Command::Halt).await?;
        self.trace("halted");
        Ok(())
    }

    /// Goes on after a halt; resolves when a frame with bit 8 low has been sent.
    ///
    /// # Errors
    /// [`Failure::Busy`](super::Failure::Busy) while the halt is not sent yet: it is in the next frame all the same.
    /// [`Failure::Halted`](super::Failure::Halted) or [`Failure::QuickStopped`](super::Failure::QuickStopped) where a stop has come
    /// before that frame: bit 8 has not fallen.
    /// [`Failure::ResumeUnsupported`](super::Failure::ResumeUnsupported) if the drive has forgotten its set-point; in
    /// Fault, while moving, or when the bus is lost.
    pub async fn resume(&self) -> Result<(), AxisError> {
        self.run(Command::Resume).await?;
        self.trace("resumed");
        Ok(())
    }

    /// Halts, then abandons the set-point by quick stop. Gives the state in which the drive stands, which 605Ah decides.
    /// A standing axis without a set-point stays as it is.
    ///
    /// # Errors
    /// When the drive ignores the quick stop too ([`QuickStopIgnored`](super::Failure::QuickStopIgnored)), when a deadline passes or the bus is lost.
    pub async fn stop(&self) -> Result<State, AxisError> {
        let state = self.stop_by(Command::Stop).await?;
        self.trace("stopped");
        Ok(state)
    }

    /// Quick stop (bit 2): the set-point is gone. Gives the state in which the drive stands, which 605Ah decides.
    ///
    /// # Errors
    /// In Fault, when the drive ignores it ([`QuickStopIgnored`](super::Failure::QuickStopIgnored), after two tenths of a second), when a
    /// deadline passes, or the bus is lost.
    pub async fn quick_stop(&self) -> Result<State, AxisError> {
        let state = self.stop_by(Command::QuickStop).await?;
        self.trace("quick stopped");
        Ok(state)
    }

    /// Sets bits 11 to 15 of the controlword, which are the manufacturer's; other bits are ignored.
    pub fn set_manufacturer_bits(&self, bits: Controlword) {
        self.handles.shared.set_manufacturer(bits);
    }

    /// Lets the axis finish its move when the last handle is dropped, for the reason given.
    pub fn keep_moving_on_drop(&self, reason: &str) {
        self.handles.keep_moving.store(true, Ordering::Release);
        tracing::info!(
            axis = self.identity().axis,
            drive = %self.identity().drive,
            reason,
            "keeps moving when its last handle is dropped"
        );
    }

    pub(crate) fn submit(&self, command: Command) -> Result<Pending, AxisError> {
        Pending::submit(Arc::clone(&self.handles), command)
    }

    /// Submits what starts a motion and was asked for when this was the last stop.
    pub(crate) fn submit_motion(
        &self,
        command: Command,
        asked: LastStop,
    ) -> Result<Pending, AxisError> {
        Pending::submit_motion(Arc::clone(&self.handles), command, asked)
    }

    pub(crate) async fn run(&self, command: Command) -> Result<Completion, AxisError> {
        self.submit(command)?.done().await
    }

    /// Ends the motion of a mode that is given back.
    pub(crate) async fn release(&self) -> Result<(), AxisError> {
        self.run(Command::Release).await.map(drop)
    }

    pub(crate) fn trace(&self, what: &str) {
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
pub(crate) struct Handles {
    pub(crate) shared: Arc<Shared>,
    /// Held from an SDO write of a motion's parameters until the drive has taken the set-point.
    pub(super) claims: Claims,
    /// Whether the drive may hold parameters that a move has written by SDO.
    pub(crate) parameters_changed: AtomicBool,
    /// Whether the drive holds an end velocity that a move has written by SDO: the axis may go on where a move has ended.
    pub(crate) ends_in_motion: AtomicBool,
    keep_moving: AtomicBool,
    /// The last motion whose future was dropped before it was accepted; 0 for none.
    given_up: AtomicU32,
}

/// By the axis alone, as all that is shared.
impl fmt::Debug for Handles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.shared.fmt(f)
    }
}

impl Handles {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        Self {
            shared,
            claims: Claims::default(),
            parameters_changed: AtomicBool::new(false),
            ends_in_motion: AtomicBool::new(false),
            keep_moving: AtomicBool::new(false),
            given_up: AtomicU32::new(0),
        }
    }

    /// Gives a motion up, so far as it was not sent. `ends`: a homing that was sent is stopped.
    pub(super) fn withdraw(&self, id: CommandId, ends: bool) {
        self.given_up.store(id.0, Ordering::Release);
        self.shared.withdraw(id, ends);
    }

    /// This much later by the network's time: [`AxisErrorKind::Late`], by which nothing is stopped.
    pub(crate) async fn late<T>(&self, within: Duration) -> Result<T, AxisError> {
        let groups = &self.shared.setup.groups;
        groups
            .sleep_until(groups.now().saturating_add(within))
            .await;
        Err(self.shared.error(AxisErrorKind::Late {
            within,
            statusword: self.shared.snapshot().statusword,
        }))
    }

    fn parameters(&self) -> &dyn ParameterAccess {
        &*self.shared.setup.parameters
    }

    /// An object as the drive numbers it for this axis.
    pub(crate) fn of_axis(&self, object: ObjectAddress) -> ObjectAddress {
        ObjectAddress::new(
            self.shared.setup.offset.apply(object.index),
            object.subindex,
        )
    }

    /// Writes an object of this axis by SDO.
    pub(crate) async fn write_parameter(
        &self,
        object: ObjectAddress,
        value: Vec<u8>,
    ) -> Result<(), AxisError> {
        let object = self.of_axis(object);
        let written = self.parameters().write(object, value).await;
        written.map_err(|error| self.shared.error(AxisErrorKind::Sdo(Arc::new(error))))
    }

    pub(crate) async fn read_parameter(&self, object: ObjectAddress) -> Result<Vec<u8>, AxisError> {
        let object = self.of_axis(object);
        let read = self.parameters().read(object).await;
        read.map_err(|error| self.shared.error(AxisErrorKind::Sdo(Arc::new(error))))
    }

    /// Error code 603Fh, by SDO; none if it cannot be read, or not soon.
    pub(super) async fn read_error_code(&self) -> Option<u16> {
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
        // An axis that stands without a set-point has nothing to stop; a stop that comes a cycle later would end what the
        // next handle has begun.
        let given_up = CommandId(self.given_up.load(Ordering::Acquire));
        // The frame with its bit 4 may be under way, and then no snapshot shows it yet.
        let may_be_sent = given_up.0 != 0 && !self.shared.is_done(given_up);
        let goes_on = self.ends_in_motion.load(Ordering::Acquire);
        let may_move = status.has_set_point || status.velocity != 0 || may_be_sent || goes_on;
        if may_move && !self.keep_moving.load(Ordering::Acquire) {
            self.shared.request_stop(StopRequest::STOP);
            self.shared.trace("last handle dropped: stopped");
        }
    }
}

/// The one lease of a mode.
#[derive(Debug)]
pub(crate) struct Lease {
    shared: Arc<Shared>,
}

impl Lease {
    pub(crate) fn take(handles: &Handles) -> Result<Self, AxisError> {
        let shared = &handles.shared;
        if shared.leased.swap(true, Ordering::AcqRel) {
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
        self.shared.leased.store(false, Ordering::Release);
        self.shared.trace("mode lease given back");
    }
}
