//! Writing a set of parameters back to a drive.

use super::guard::{Enabled, Guard, GuardFault};
use super::set::{Differences, Parameter, ParameterSet, Progress, is_parameter, read};
use super::start_up::{WriteFault, write_value};
use crate::coe::{DriveId, ObjectAddress, SdoError, SdoHandle};
use crate::sii::Identity;

/// What a restore has done.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Restored {
    /// The objects that were written and read back.
    pub written: Vec<ObjectAddress>,
    /// The objects that held their value before.
    pub unchanged: Vec<ObjectAddress>,
}

/// A restore that did not come to its end: what was written, and what not.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{drive}: {fault} ({} written, {} not{})", done.written.len(), not_written.len(), doubt(in_doubt.as_ref()))]
pub struct RestoreError {
    /// The drive.
    pub drive: DriveId,
    /// What went wrong.
    #[source]
    pub fault: RestoreFault,
    /// What was done before.
    pub done: Restored,
    /// The object of which nobody knows whether it holds its value, since the drive did not answer.
    pub in_doubt: Option<ObjectAddress>,
    /// The objects that do not hold their values of the set, or were not looked at.
    pub not_written: Vec<ObjectAddress>,
}

fn doubt(object: Option<&ObjectAddress>) -> String {
    object.map_or_else(String::new, |object| format!(", {object} in doubt"))
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
    #[error("{} {}: {fault}", .parameter.object, .parameter.name)]
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
    /// Writes the set to a drive, in order. What holds its value already is left alone; what is written is read back, and all
    /// is compared once more at the end.
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
        let error = |fault, done: &Restored, at: usize, in_doubt| RestoreError {
            drive: sdo.drive().clone(),
            fault,
            done: done.clone(),
            in_doubt,
            not_written: self
                .parameters
                .iter()
                .skip(at)
                .map(|parameter| parameter.object)
                .filter(|object| Some(*object) != in_doubt)
                .collect(),
        };
        self.check(sdo)
            .map_err(|fault| error(fault, &done, 0, None))?;
        let guard = Guard::of(sdo)
            .await
            .map_err(|fault| error(fault.into(), &done, 0, None))?;
        for (place, parameter) in self.parameters.iter().enumerate() {
            progress.tell(place, all);
            let object = parameter.object;
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
                let in_doubt = leaves_doubt(&fault).then_some(object);
                let parameter = Box::new(parameter.clone());
                let fault = RestoreFault::Write { parameter, fault };
                return Err(error(fault, &done, place, in_doubt));
            }
            done.written.push(object);
        }
        let differences = self
            .compare(sdo, Progress::none())
            .await
            .map_err(|fault| error(fault.error.into(), &done, all, None))?;
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

    /// What can be seen to be wrong before anything is sent.
    fn check(&self, sdo: &SdoHandle) -> Result<(), RestoreFault> {
        let got = sdo.drive().identity;
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

/// Whether the object may hold its value though the write failed: the drive has not refused it, and not shown another.
const fn leaves_doubt(fault: &WriteFault) -> bool {
    match fault {
        WriteFault::Sdo(error) => error.abort_code().is_none(),
        WriteFault::Differs { .. } | WriteFault::Controlword => false,
    }
}
