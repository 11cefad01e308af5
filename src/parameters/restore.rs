//! Writing a set of parameters back to a drive.

use std::time::Duration;

use super::set::{Differences, Parameter, ParameterSet, Progress, is_parameter, read};
use super::start_up::{StartUpLines, WriteFault, of_first_axis, write_value};
use crate::coe::{
    DriveError, DriveId, Object, ObjectAddress, ReadWrite, SdoError, SdoHandle, TransferKind, obj,
};
use crate::ds402::{State, Statusword};
use crate::sii::Identity;

/// What a restore has done.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Restored {
    /// The objects that were written and read back.
    pub written: Vec<ObjectAddress>,
    /// The objects that held their value before, and those that a restore leaves as they are.
    pub unchanged: Vec<ObjectAddress>,
}

/// A restore that did not come to its end: what was written, and what not.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{drive}: {fault} ({} written, {} not{})", done.written.len(), not_written.len(), unconfirmed_text(unconfirmed.as_ref()))]
#[non_exhaustive]
pub struct RestoreError {
    /// The drive.
    pub drive: DriveId,
    /// What went wrong.
    #[source]
    pub fault: RestoreFault,
    /// What was done before.
    pub done: Restored,
    /// The object of which nobody knows whether it holds its value, since the drive did not answer.
    pub unconfirmed: Option<ObjectAddress>,
    /// The objects that do not hold their values of the set, or were not looked at.
    pub not_written: Vec<ObjectAddress>,
}

fn unconfirmed_text(object: Option<&ObjectAddress>) -> String {
    object.map_or_else(String::new, |object| format!(", {object} not confirmed"))
}

/// Why a restore did not come to its end.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RestoreFault {
    /// An axis of the drive is enabled.
    #[error(transparent)]
    Enabled(#[from] Enabled),
    /// The drive did not report the state of its axes, or what it holds.
    #[error(transparent)]
    Sdo(#[from] SdoError),
    /// The parameters are of another kind of drive.
    #[error("the parameters are of another kind of drive: expected {expected}")]
    OtherDrive {
        /// The identity in the set.
        expected: Identity,
    },
    /// The set has a command or a record.
    #[error("{0} is a command or a record, and no parameter: take it out of the file")]
    NoParameter(ObjectAddress),
    /// A parameter could not be written.
    #[error("{}: {fault}", .parameter.title())]
    Write {
        /// The parameter with the value of the set.
        parameter: Box<Parameter>,
        /// What went wrong; the drive's own reason is in it if it refused.
        fault: WriteFault,
    },
    /// All was written, but a later write changed what an earlier one had written.
    #[error("parameters that depend on others have changed again; put them behind those:\n{0}")]
    ChangedAgain(Differences),
}

impl From<GuardFault> for RestoreFault {
    fn from(fault: GuardFault) -> Self {
        match fault {
            GuardFault::Enabled(enabled) => Self::Enabled(enabled),
            GuardFault::Sdo(error) => Self::Sdo(error),
        }
    }
}

impl ParameterSet {
    /// Writes the set to a drive, in order, but scaling first as [`StartUpList`](super::StartUpList) says. What holds its value already is left alone; what is written is read back, and all
    /// is compared once more at the end.
    ///
    /// 6007h of each axis is left as it is: every start sets it to a value that stops the axis when the program dies.
    ///
    /// No axis of the drive may be enabled: this is asked of the drive before each write. What was written is in force, but
    /// only stored for the next power-up by [`store`](super::store).
    ///
    /// # Errors
    /// [`RestoreError`], with what was written and what not.
    pub async fn restore(
        &self,
        sdo: &SdoHandle,
        mut progress: Progress<'_>,
    ) -> Result<Restored, RestoreError> {
        let mut done = Restored::default();
        let all = self.parameters.len();
        let parameters = self.parameters.iter().collect();
        let ordered = StartUpLines::split_at_scaling(parameters, |parameter| parameter.object);
        let ordered = ordered.concat();
        let error = |fault, done: &Restored, at: usize, unconfirmed| RestoreError {
            drive: sdo.drive().clone(),
            fault,
            done: done.clone(),
            unconfirmed,
            not_written: ordered
                .iter()
                .skip(at)
                .map(|parameter| parameter.object)
                .filter(|object| Some(*object) != unconfirmed)
                .collect(),
        };
        self.check(sdo.drive().identity)
            .map_err(|fault| error(fault, &done, 0, None))?;
        let guard = Guard::of(sdo)
            .await
            .map_err(|fault| error(fault.into(), &done, 0, None))?;
        for (place, parameter) in ordered.iter().copied().enumerate() {
            progress.tell(place, all);
            let object = parameter.object;
            if is_of_start(object) {
                done.unchanged.push(object);
                continue;
            }
            let held = read(sdo, object)
                .await
                .map_err(|fault| error(fault.error.into(), &done, place, None))?;
            if held.is_ok_and(|bytes| parameter.value.is_held_by(&bytes)) {
                done.unchanged.push(object);
                continue;
            }
            guard
                .check(sdo)
                .await
                .map_err(|fault| error(fault.into(), &done, place, None))?;
            if let Err(fault) = write_value(sdo, object, &parameter.value, true).await {
                let unconfirmed = leaves_unconfirmed(&fault).then_some(object);
                let parameter = Box::new(parameter.clone());
                let fault = RestoreFault::Write { parameter, fault };
                return Err(error(fault, &done, place, unconfirmed));
            }
            done.written.push(object);
        }
        let mut differences = self
            .compare(sdo, Progress::none())
            .await
            .map_err(|fault| error(fault.error.into(), &done, all, None))?;
        let all_differences = &mut differences.0;
        all_differences.retain(|difference| !is_of_start(difference.parameter.object));
        if !differences.0.is_empty() {
            let changed = |object: &ObjectAddress| {
                let mut all = differences.0.iter();
                all.any(|difference| difference.parameter.object == *object)
            };
            done.written.retain(|object| !changed(object));
            done.unchanged.retain(|object| !changed(object));
            let objects = differences.0.iter();
            let not_written = objects.map(|difference| difference.parameter.object);
            return Err(RestoreError {
                not_written: not_written.collect(),
                ..error(
                    RestoreFault::ChangedAgain(differences.clone()),
                    &done,
                    all,
                    None,
                )
            });
        }
        progress.tell(all, all);
        Ok(done)
    }

    /// Whether the set can be restored to a drive that says it is this, as far as that can be seen before anything is sent. A set without
    /// an identity is for any drive.
    ///
    /// # Errors
    /// [`RestoreFault::OtherDrive`]: it is of another vendor or product. [`RestoreFault::NoParameter`]: it has a command or a record.
    pub fn check(&self, got: Identity) -> Result<(), RestoreFault> {
        if let Some(expected) = self.identity
            && (expected.vendor, expected.product) != (got.vendor, got.product)
        {
            return Err(RestoreFault::OtherDrive { expected });
        }
        let mut objects = self.parameters.iter().map(|parameter| parameter.object);
        objects
            .find(|object| !is_parameter(*object))
            .map_or(Ok(()), |object| Err(RestoreFault::NoParameter(object)))
    }
}

/// Whether every start sets this object: what an axis does when the process data stop.
fn is_of_start(object: ObjectAddress) -> bool {
    of_first_axis(object) == Some(obj::ABORT_CONNECTION_OPTION.index())
}

/// Whether the object may hold its value though the write failed: the drive has not refused it, and not shown another. It may have
/// refused to be read after it.
const fn leaves_unconfirmed(fault: &WriteFault) -> bool {
    match fault {
        WriteFault::Sdo(error) => {
            error.abort_code().is_none() || matches!(error.transfer().kind, TransferKind::Read)
        }
        WriteFault::Differs { .. }
        | WriteFault::Controlword
        | WriteFault::Mode
        | WriteFault::Target
        | WriteFault::Output
        | WriteFault::LateScaling
        | WriteFault::Brake
        | WriteFault::Statusword => false,
    }
}

// The drive's own memory: storing its parameters for the next power-up (1010h) and its maker's defaults (1011h).

/// 1010h:01, store all parameters (CiA 301).
const STORE: Object<u32, ReadWrite> = Object::new(0x1010, 1, "store all parameters");
/// 1011h:01, restore all default parameters (CiA 301).
const DEFAULTS: Object<u32, ReadWrite> = Object::new(0x1011, 1, "restore all default parameters");
/// What 1010h takes, so that nothing is stored by mistake.
const SAVE: u32 = u32::from_le_bytes(*b"save");
/// What 1011h takes.
const LOAD: u32 = u32::from_le_bytes(*b"load");
/// Drives answer when the memory is written, which takes some of them seconds.
const PATIENCE: Duration = Duration::from_secs(30);

/// What a drive says of 1010h:01 or 1011h:01.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct MemorySupport {
    /// Bit 0: it stores, or loads the defaults, on command.
    pub on_command: bool,
    /// Bit 1 of 1010h: it stores by itself.
    pub by_itself: bool,
}

/// Why a drive's memory was not written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{drive}: {fault}")]
#[non_exhaustive]
pub struct MemoryError {
    /// The drive.
    pub drive: DriveId,
    /// What went wrong.
    #[source]
    pub fault: MemoryFault,
}

/// Why a drive's memory was not written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MemoryFault {
    /// An axis of the drive is enabled.
    #[error(transparent)]
    Enabled(Enabled),
    /// It has no such object.
    #[error("it has no object {object}: its parameters are kept in another way, see its manual")]
    NotThere {
        /// 1010h:01 or 1011h:01.
        object: crate::coe::ObjectAddress,
    },
    /// It has the object, but says that it does nothing on command.
    #[error("its {object} says that it takes no command{}", if *.by_itself { ": it stores by itself" } else { "" })]
    NotOnCommand {
        /// 1010h:01 or 1011h:01.
        object: crate::coe::ObjectAddress,
        /// It stores by itself.
        by_itself: bool,
    },
    /// The transfer failed; the drive's own reason is in it if it refused.
    #[error(transparent)]
    Sdo(SdoError),
}

/// What the drive says of storing its parameters (1010h:01); nothing if it has no such object.
///
/// # Errors
/// [`DriveError`] as of [`SdoHandle::read`].
pub async fn store_support(sdo: &SdoHandle) -> Result<Option<MemorySupport>, DriveError> {
    support(sdo, STORE).await
}

/// What the drive says of loading its maker's defaults (1011h:01); nothing if it has no such object.
///
/// # Errors
/// [`DriveError`] as of [`SdoHandle::read`].
pub async fn defaults_support(sdo: &SdoHandle) -> Result<Option<MemorySupport>, DriveError> {
    support(sdo, DEFAULTS).await
}

/// Has the drive store its present parameters for its next power-up ("save" to 1010h:01). It takes up to 30 s.
///
/// # Errors
/// [`MemoryError`]; after `Timeout` and `Link` the parameters may have been stored.
pub async fn store(sdo: &SdoHandle) -> Result<(), MemoryError> {
    command(sdo, STORE, SAVE).await
}

/// Has the drive go back to its maker's defaults ("load" to 1011h:01). They are in force after its next power-up or reset
/// (CiA 301); until then it goes on with what it has. It takes up to 30 s.
///
/// # Errors
/// [`MemoryError`]; after `Timeout` and `Link` the command may have taken effect.
pub async fn load_defaults(sdo: &SdoHandle) -> Result<(), MemoryError> {
    command(sdo, DEFAULTS, LOAD).await
}

async fn support(
    sdo: &SdoHandle,
    object: Object<u32, ReadWrite>,
) -> Result<Option<MemorySupport>, DriveError> {
    match sdo.read(object).await {
        Ok(bits) => Ok(Some(MemorySupport {
            on_command: bits & 1 != 0,
            by_itself: bits & 2 != 0 && object.index() == STORE.index(),
        })),
        Err(DriveError {
            error: SdoError::Aborted { code, .. },
            ..
        }) if code.is_no_object() => Ok(None),
        Err(error) => Err(error),
    }
}

async fn command(
    sdo: &SdoHandle,
    object: Object<u32, ReadWrite>,
    signature: u32,
) -> Result<(), MemoryError> {
    let failed = |fault| MemoryError {
        drive: sdo.drive().clone(),
        fault,
    };
    let address = object.address();
    let support = support(sdo, object)
        .await
        .map_err(|error| failed(MemoryFault::Sdo(error.error)))?
        .ok_or_else(|| failed(MemoryFault::NotThere { object: address }))?;
    if !support.on_command {
        return Err(failed(MemoryFault::NotOnCommand {
            object: address,
            by_itself: support.by_itself,
        }));
    }
    Guard::of(sdo).await.map_err(|fault| {
        failed(match fault {
            GuardFault::Enabled(enabled) => MemoryFault::Enabled(enabled),
            GuardFault::Sdo(error) => MemoryFault::Sdo(error),
        })
    })?;
    sdo.clone()
        .with_timeout(PATIENCE)
        .write(object, signature)
        .await
        .map_err(|error| failed(MemoryFault::Sdo(error.error)))
}

// That no axis of a drive is enabled, as the drive itself says.

/// An axis that is enabled, so that the drive's parameters are left alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("axis {axis} of the drive is in {state}: disable it first")]
pub struct Enabled {
    /// The axis, from 1.
    pub axis: u8,
    /// The state that its statusword shows.
    pub state: State,
}

/// Why the axes are not known to be disabled.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum GuardFault {
    Enabled(Enabled),
    Sdo(SdoError),
}

/// The axes of a drive.
pub(crate) struct Guard {
    axes: u8,
}

impl Guard {
    /// Finds the axes of a drive, by their statuswords, and checks them.
    pub async fn of(sdo: &SdoHandle) -> Result<Self, GuardFault> {
        for axis in 1..=8 {
            match check(sdo, axis).await {
                Err(GuardFault::Sdo(SdoError::Aborted { code, .. })) if code.is_no_object() => {
                    return Ok(Self { axes: axis - 1 });
                }
                other => other?,
            }
        }
        Ok(Self { axes: 8 })
    }

    /// Checks them again.
    pub async fn check(&self, sdo: &SdoHandle) -> Result<(), GuardFault> {
        for axis in 1..=self.axes {
            check(sdo, axis).await?;
        }
        Ok(())
    }
}

async fn check(sdo: &SdoHandle, axis: u8) -> Result<(), GuardFault> {
    let word = sdo
        .read(obj::STATUSWORD.axis(axis))
        .await
        .map_err(|error| GuardFault::Sdo(error.error))?;
    let state = Statusword::from_bits_retain(word).state();
    match state {
        State::NotReadyToSwitchOn
        | State::SwitchOnDisabled
        | State::ReadyToSwitchOn
        | State::SwitchedOn
        | State::Fault => Ok(()),
        // Stopping axes move; a statusword of no state says nothing.
        State::OperationEnabled
        | State::QuickStopActive
        | State::FaultReactionActive
        | State::Unknown => Err(GuardFault::Enabled(Enabled { axis, state })),
    }
}
