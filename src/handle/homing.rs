//! Homing as a lease of an axis.

use core::{
    fmt,
    future::Future,
    pin::Pin,
    sync::atomic::Ordering,
    task::{Context, Poll},
    time::Duration,
};
use std::sync::Arc;

use smol::future::{try_zip, zip};

use crate::{
    Failure, HomingMethod, HomingParameters,
    axis::{Command, Completion, Delivery, ParameterFault, WaitingFor},
    coe::{ObjectAddress, SdoError, obj},
    ds402::Mode,
    homing::HomingCommand,
    units::{AxisUnit, Counts},
};

use super::{
    Axis, AxisError, AxisErrorKind, BoxFuture, axis::Lease, pair::is_consequence,
    parameters::Claim, pending::Pending, stops::LastStop,
};

/// The lease of an axis in homing mode, from [`Axis::homing`].
///
/// Dropping it gives the mode back and leaves the motion alone; [`release`](Self::release) ends the motion as well.
///
/// ```
/// # use core::time::Duration;
/// use servocrab::{HomingMethod, HomingParameters};
/// # use servocrab::{DriveConfig, Network, drives, link::Wire};
/// # use servocrab_sim::{Segment, personality::Servo};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # smol::block_on(async {
/// # // The axis stands 5000 counts above its negative limit switch.
/// # let servo = Servo::generic().change(|drive| drive.machine.negative_limit = Some(-5_000));
/// # let mut segment = Segment::new().with(servo.build()).ideal();
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::generic()).axis("lift");
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// let lift = net.axis("lift")?;
/// lift.enable().await?;
/// let homing = lift.homing().await?;
/// let parameters = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
///     .speeds(50_000, 5_000)
///     .acceleration(1_000_000);
/// homing.home(parameters).within(Duration::from_secs(60)).await?;
/// assert!(lift.status().referenced);
/// homing.release().await?; // for the next mode
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug)]
pub struct Homing<U: AxisUnit = Counts> {
    axis: Axis<U>,
    _lease: Arc<Lease>,
}

/// A homing whose parameters its drive holds.
struct PreparedHoming<'a> {
    command: HomingCommand,
    claim: Claim<'a>,
    asked: LastStop,
}

/// Where an axis is, now that it knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(
    feature = "serde",
    serde(bound(serialize = "U::Signed: serde::Serialize"))
)]
#[non_exhaustive]
pub struct Homed<U: AxisUnit = Counts> {
    /// Position actual value 6064h at the end of the homing.
    pub position: U::Signed,
}

impl<U: AxisUnit> Axis<U> {
    /// Selects homing (mode 6) and leases it. The lease ends by [`Homing::release`] or by dropping it.
    ///
    /// # Errors
    /// [`AxisErrorKind::ModeInUse`] while another lease exists. [`Unsupported::Mode`](crate::profile_position::Unsupported::Mode) where 6502h does not name it.
    /// Otherwise when the drive does not show the mode in time, the axis moves or is halted in another mode, the axis was stopped
    /// meanwhile, or the bus is lost. A jog that an earlier lease has left is let go in any case.
    pub async fn homing(&self) -> Result<Homing<U>, AxisError> {
        let lease = Lease::take(&self.handles)?;
        self.select(Mode::Homing).await?;
        Ok(Homing::new(self.clone(), Arc::new(lease)))
    }
}

impl<U: AxisUnit> Homing<U> {
    const fn new(axis: Axis<U>, lease: Arc<Lease>) -> Self {
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

    /// Homes the axis; resolves when the homing is attained and the axis stands. From then on it is referenced
    /// ([`Snapshot::referenced`](crate::axis::Snapshot::referenced)).
    ///
    /// Method (6098h) and what else is given are written by SDO and confirmed first, or go with the process data where they
    /// are mapped. There is no limit for the travel unless one is given by [`Home::within`]. Dropped before bit 4 rose,
    /// the homing is withdrawn; later, the axis is stopped, unless it was asked to go on by [`Home::keep_homing`].
    ///
    /// # Errors
    /// Of the future:
    /// - [`AxisErrorKind::HomingMethod`] for a method that the drive does not list in 60E3h, where it has that: nothing was written then;
    /// - [`AxisErrorKind::Sdo`] with the drive's abort for a method or parameter that it does not have;
    /// - [`Failure::HomingError`] when the drive reports one (bit 13): some drives do so for a method that they do not have;
    /// - [`Failure::Halted`] when somebody halted the axis: a halted homing is over, and the axis is to be stopped;
    /// - [`Failure::QuickStopped`], [`Failure::Disabled`], [`Failure::Fault`], [`Failure::BusLost`];
    /// - [`Failure::Timeout`] when the drive does not show that it has begun: then whether it has is unknown, and
    ///   [`Axis::stop`] comes before the next try; or when it does not end within the time that it was given, by which it is stopped;
    /// - [`AxisErrorKind::Scale`] for a number that cannot be converted into counts: nothing was written then;
    /// - [`Failure::Parameter`] for a speed or acceleration of 0;
    /// - [`AxisErrorKind::Late`] where only the wait has ended: by [`Home::within`] after [`Home::keep_homing`];
    /// - what refuses every motion: not enabled, halted, another homing under way.
    pub fn home(&self, parameters: impl Into<HomingParameters<U>>) -> Home<'_, U> {
        Home {
            homing: self,
            parameters: parameters.into(),
            limit: None,
            keep: false,
            result: None,
        }
    }

    /// Ends a homing as [`Axis::stop`] does and gives the mode back. An axis that stands and is not halted stays enabled.
    ///
    /// # Errors
    /// When a deadline passes or the bus is lost. The mode is given back all the same.
    pub async fn release(self) -> Result<(), AxisError> {
        self.axis.release().await
    }

    /// `limit`: how long it may take. `keep`: it goes on when nobody waits for it any more, also after that time.
    async fn run(
        &self,
        parameters: HomingParameters<U>,
        limit: Option<Duration>,
        keep: bool,
    ) -> Result<Homed<U>, AxisError> {
        let signals = &self.axis.handles.shared.setup.groups.signals;
        let until = limit.map(|limit| signals.now().saturating_add(limit));
        let scale = self.axis.unit.scale;
        let parameters = parameters.in_counts(&scale);
        let parameters = parameters.map_err(|error| self.axis.scale_error(error))?;
        let asking = self.ask(parameters, until.filter(|_| !keep));
        let mut pending = match until {
            Some(until) => smol::future::or(asking, self.late_before(until)).await?,
            None => asking.await?,
        };
        if !keep {
            pending.end_on_drop();
        }
        let kept = limit.zip(until).filter(|_| keep);
        if let Some((_, until)) = kept {
            self.begun_by(&mut pending, until).await?;
        } else {
            pending.accepted().await?;
        }
        self.axis.trace("homing");
        let late = async {
            match kept {
                Some((limit, until)) => {
                    signals.sleep_until(until).await;
                    Err(self.axis.handles.late_error(limit))
                }
                None => core::future::pending().await,
            }
        };
        let result = smol::future::or(homed(&pending), late).await;
        let result = result.map(|position| Homed {
            position: scale.position_in::<U>(position),
        });
        self.axis.trace(match &result {
            Ok(_) => "homed",
            Err(_) => "homing ended",
        });
        result
    }

    /// Writes the parameters and asks for the homing.
    async fn ask(
        &self,
        parameters: HomingParameters,
        until: Option<Duration>,
    ) -> Result<Pending, AxisError> {
        let prepared = self.prepare(parameters, until).await?;
        self.start(prepared)
    }

    /// Writes the parameters.
    async fn prepare(
        &self,
        parameters: HomingParameters,
        until: Option<Duration>,
    ) -> Result<PreparedHoming<'_>, AxisError> {
        let handles = &self.axis.handles;
        // A stop that comes while parameters are being written stops this homing as well.
        let asked = handles.shared.stops.last();
        let claim = handles.claim_now()?;
        // What is refused must not have changed the drive's parameters, least of all those of a homing under way.
        self.axis.run(Command::CheckHome).await?;
        handles.check_not_stopped(asked).await?;
        self.check_method(parameters.method).await?;
        self.write(&parameters).await?;
        let offset = match parameters.offset {
            // By what it reads at home a homing is told from an earlier one.
            None => self.axis.read_if_there(obj::HOME_OFFSET).await?,
            offset => offset,
        };
        let command = HomingCommand {
            method: parameters.method,
            offset,
            until,
        };
        Ok(PreparedHoming {
            command,
            claim,
            asked,
        })
    }

    /// Asks for the homing.
    fn start(&self, prepared: PreparedHoming<'_>) -> Result<Pending, AxisError> {
        let command = Command::Home(prepared.command);
        let pending = self.axis.submit_asked(command, prepared.asked)?;
        prepared.claim.sent(&pending);
        Ok(pending)
    }

    /// Some drives take any method, and fail at the start of the homing. A drive that lists none has to be tried.
    async fn check_method(&self, method: HomingMethod) -> Result<(), AxisError> {
        let handles = &self.axis.handles;
        let shared = &handles.shared;
        let list = obj::SUPPORTED_HOMING_METHODS.address();
        let read = async |subindex| {
            let entry = handles.of_axis(ObjectAddress::new(list.index, subindex));
            match shared.setup.parameters.read(entry).await {
                Ok(bytes) => Ok(bytes.first().copied()),
                Err(SdoError::Aborted { .. }) => Ok(None),
                Err(error) => Err(shared.error(AxisErrorKind::Sdo(Arc::new(error)))),
            }
        };
        let mut methods = Vec::new();
        for subindex in 1..=read(list.subindex).await?.unwrap_or(0) {
            let Some(listed) = read(subindex).await? else {
                return Ok(());
            };
            methods.push(HomingMethod(listed.cast_signed()));
        }
        if methods.is_empty() || methods.contains(&method) {
            return Ok(());
        }
        Err(shared.error(AxisErrorKind::HomingMethod { method, methods }))
    }

    /// The time is over, and nothing was asked for.
    async fn late_before<T>(&self, until: Duration) -> Result<T, AxisError> {
        let signals = &self.axis.handles.shared.setup.groups.signals;
        signals.sleep_until(until).await;
        Err(self.late_unsent())
    }

    /// The time is over, and bit 4 does not rise.
    fn late_unsent(&self) -> AxisError {
        let shared = &self.axis.handles.shared;
        let status = shared.snapshot();
        shared.error(AxisErrorKind::Failed(Failure::Timeout {
            waiting_for: WaitingFor::HomingEnd,
            statusword: status.statusword,
            controlword: status.controlword,
            delivery: Delivery::NotSent,
        }))
    }

    /// Waits until the drive has begun a homing that is kept. One whose bit 4 is not sent by then is withdrawn; what becomes of
    /// another one the drive shows.
    async fn begun_by(&self, pending: &mut Pending, until: Duration) -> Result<(), AxisError> {
        let signals = &self.axis.handles.shared.setup.groups.signals;
        let begun = async { Some(pending.accepted().await) };
        let over = async {
            signals.sleep_until(until).await;
            None
        };
        if let Some(result) = smol::future::or(begun, over).await {
            return result;
        }
        pending.withdraw();
        match pending.accepted().await {
            Err(error) if error.failure() == Some(Failure::Withdrawn) => Err(self.late_unsent()),
            result => result,
        }
    }

    async fn write(&self, parameters: &HomingParameters) -> Result<(), AxisError> {
        let speeds = [
            (
                parameters.switch_speed,
                obj::HOMING_SWITCH_SPEED,
                "homing speed 6099h:1",
            ),
            (
                parameters.zero_speed,
                obj::HOMING_ZERO_SPEED,
                "homing speed 6099h:2",
            ),
            (
                parameters.acceleration,
                obj::HOMING_ACCELERATION,
                "homing acceleration 609Ah",
            ),
        ];
        if let Some((.., name)) = speeds.iter().find(|(value, ..)| *value == Some(0)) {
            let kind = AxisErrorKind::Failed(Failure::Parameter {
                name,
                fault: ParameterFault::Zero,
            });
            return Err(self.axis.handles.shared.error(kind));
        }
        self.axis
            .handles
            .put(obj::HOMING_METHOD, parameters.method.0)
            .await?;
        for (value, object, _) in speeds {
            if let Some(value) = value {
                self.axis.handles.put(object, value).await?;
            }
        }
        if let Some(offset) = parameters.offset {
            let shared = &self.axis.handles.shared;
            // Until its answer: it may be given up in between, and the drive take it all the same.
            let start = shared.notes.starts();
            let in_doubt = &shared.notes.home_offset_in_doubt;
            in_doubt.store(true, Ordering::Release);
            self.axis.handles.put(obj::HOME_OFFSET, offset).await?;
            shared.note_home_offset(start, offset);
        }
        Ok(())
    }
}

/// The position in counts.
async fn homed(pending: &Pending) -> Result<i32, AxisError> {
    match pending.done().await? {
        Completion::Homed { position } => Ok(position),
        // A homing has no other way to end well.
        _ => {
            let kind = AxisErrorKind::Failed(Failure::QUICK_STOPPED);
            Err(pending.error(kind))
        }
    }
}

/// Homes two axes at once: the parameters of both are written before either begins. Gives what `begin` gives, and how both have ended. Where
/// one fails by itself the other is not waited for. A homing that is dropped stops its axis.
pub(super) async fn home_together<U: AxisUnit, T>(
    axes: [&Axis<U>; 2],
    leases: &[Arc<Lease>; 2],
    parameters: [HomingParameters<U>; 2],
    begin: impl FnOnce() -> T,
) -> Result<(T, [Result<i32, AxisError>; 2]), AxisError> {
    let [one, other] = [0, 1].map(|n: usize| Homing::new(axes[n].clone(), Arc::clone(&leases[n])));
    let in_counts = |homing: &Homing<U>, parameters: HomingParameters<U>| {
        let axis = homing.axis();
        let counts = parameters.in_counts(&axis.unit.scale);
        counts.map_err(|error| axis.scale_error(error))
    };
    let [first, second] = parameters;
    let (first, second) = (in_counts(&one, first)?, in_counts(&other, second)?);
    let prepared = zip(one.prepare(first, None), other.prepare(second, None)).await;
    let prepared = (prepared.0?, prepared.1?);
    let begun = begin();
    let mut first = one.start(prepared.0)?;
    first.end_on_drop();
    let mut second = other.start(prepared.1)?;
    second.end_on_drop();
    let (one, other) = try_zip(unless_failed(&first), unless_failed(&second)).await?;
    Ok((begun, [one, other]))
}

/// An error that the other homing has not made is there at once.
async fn unless_failed(pending: &Pending) -> Result<Result<i32, AxisError>, AxisError> {
    match homed(pending).await {
        Err(error) if !is_consequence(&error) => Err(error),
        result => Ok(result),
    }
}

/// A homing, and the wait for its end. Dropped after bit 4 rose it stops the axis (bit 8, then quick stop).
#[must_use = "futures do nothing unless awaited"]
pub struct Home<'a, U: AxisUnit = Counts> {
    homing: &'a Homing<U>,
    parameters: HomingParameters<U>,
    limit: Option<Duration>,
    keep: bool,
    result: Option<BoxFuture<'a, Result<Homed<U>, AxisError>>>,
}

impl<'a, U: AxisUnit> Home<'a, U> {
    /// Stops the axis (bit 8, then quick stop) where the homing has not ended within this time of the network, from when it is
    /// first polled. It then fails as [`Failure::Timeout`] with [`WaitingFor::HomingEnd`]. The axis is stopped also when this
    /// future is not polled any more. After [`keep_homing`](Self::keep_homing) a homing whose bit 4 has not gone out by then is
    /// withdrawn and fails in the same way; of any other only the wait ends, with [`AxisErrorKind::Late`], once the drive has begun.
    pub const fn within(mut self, limit: Duration) -> Self {
        self.limit = Some(limit);
        self
    }

    /// Lets the drive go on with the homing when this is dropped, or when its time is over, for the reason given. Somebody else has
    /// to stop the axis then, if it does not find its home. A homing whose bit 4 has not gone out by then is withdrawn all the same.
    pub fn keep_homing(mut self, reason: &str) -> Self {
        let identity = self.homing.axis.identity();
        tracing::info!(
            target: super::LOG,
            axis = identity.axis,
            drive = %identity.drive,
            reason,
            "goes on homing when nobody waits for it"
        );
        self.keep = true;
        self
    }

    fn begin(&self) -> BoxFuture<'a, Result<Homed<U>, AxisError>> {
        let Self {
            homing,
            parameters,
            limit,
            keep,
            ..
        } = *self;
        Box::pin(homing.run(parameters, limit, keep))
    }
}

impl<U: AxisUnit> Future for Home<'_, U> {
    type Output = Result<Homed<U>, AxisError>;

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Self::Output> {
        if self.result.is_none() {
            self.result = Some(self.begin());
        }
        match &mut self.result {
            Some(result) => result.as_mut().poll(cx),
            None => Poll::Pending,
        }
    }
}

impl<U: AxisUnit> fmt::Debug for Home<'_, U> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Home").finish_non_exhaustive()
    }
}
