//! Bringing a mapping into a drive by SDO, and reading back what it then holds.

use alloc::boxed::Box;
use alloc::vec::Vec;

use super::entry::{Entry, Pdo};
use super::layout::Layout;
use super::mapping::{Direction, Mapping};
use super::plan::{Plan, Step};
use super::verify::{self, Differences};
use crate::coe::{DriveError, Number, Object, ReadOnly, SdoHandle};

/// Writes `mapping` into a drive in PREOP, reads it back, compares, and gives the places of its objects.
///
/// # Errors
/// [`ConfigureError`]: the drive refused a step, did not answer, or holds another mapping afterwards.
pub async fn configure(mapping: &Mapping, sdo: &SdoHandle) -> Result<Layout, ConfigureError> {
    execute(&mapping.plan(), sdo).await?;
    let held = read_back(sdo).await?;
    verify::compare(mapping, &held).map_err(|error| {
        ConfigureError::Differs(Box::new(DriveError {
            drive: sdo.drive().clone(),
            error,
        }))
    })?;
    Ok(mapping.layout())
}

/// Makes the writes of `plan`, and stops at the first that fails.
///
/// # Errors
/// [`ConfigureError::Refused`] with the step and the drive's reason.
pub async fn execute(plan: &Plan, sdo: &SdoHandle) -> Result<(), ConfigureError> {
    for step in plan.steps() {
        let (index, subindex) = (step.object.index, step.object.subindex);
        sdo.write_bytes(index, subindex, step.value().to_vec())
            .await
            .map_err(|error| ConfigureError::Refused {
                step: *step,
                error: Box::new(error),
            })?;
    }
    Ok(())
}

/// Reads the mapping that a drive holds: assignments, PDOs, entries.
///
/// # Errors
/// [`ConfigureError::Unreadable`] with the object and the drive's reason.
pub async fn read_back(sdo: &SdoHandle) -> Result<Mapping, ConfigureError> {
    let outputs = read_pdos(Direction::Outputs, sdo).await?;
    let inputs = read_pdos(Direction::Inputs, sdo).await?;
    Ok(Mapping::from_pdos(outputs, inputs))
}

async fn read_pdos(direction: Direction, sdo: &SdoHandle) -> Result<Vec<Pdo>, ConfigureError> {
    let mut pdos = Vec::new();
    for index in read_list::<u16>(direction.assignment(), sdo).await? {
        // Some drives fill unused places of the assignment with 0.
        if index == 0 {
            continue;
        }
        let raw = read_list::<u32>(index, sdo).await?;
        let entries = raw.into_iter().map(Entry::from_raw).collect();
        pdos.push(Pdo { index, entries });
    }
    Ok(pdos)
}

/// The elements of an object whose subindex 0 tells their number.
async fn read_list<T: Number>(index: u16, sdo: &SdoHandle) -> Result<Vec<T>, ConfigureError> {
    let unreadable = |error| ConfigureError::Unreadable(Box::new(error));
    let count: Object<u8, ReadOnly> = Object::new(index, 0, "number of entries");
    let count = sdo.read(count).await.map_err(unreadable)?;
    let mut list = Vec::new();
    for subindex in 1..=count {
        let element: Object<T, ReadOnly> = Object::new(index, subindex, "entry");
        list.push(sdo.read(element).await.map_err(unreadable)?);
    }
    Ok(list)
}

/// A mapping that did not get into the drive.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigureError {
    /// A step of the plan failed: the drive refused it or did not answer.
    #[error("{step}: {error}")]
    Refused {
        /// The step.
        step: Step,
        /// The drive and its reason.
        error: Box<DriveError>,
    },
    /// The mapping could not be read back.
    #[error("reading the mapping back: {0}")]
    Unreadable(Box<DriveError>),
    /// The drive holds another mapping than was written.
    #[error("{0}")]
    Differs(Box<DriveError<Differences>>),
}
