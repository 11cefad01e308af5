//! Bringing a mapping into a drive by SDO, and reading back what it then holds.

use alloc::boxed::Box;
use alloc::vec::Vec;

use super::layout::Layout;
use super::mapping::{Direction, Mapping, MappingLimits};
use super::mapping::{Entry, MappedPdo};
use super::mapping::{MappingWrite, Plan, Purpose};
use super::offer::FixedPdo;
use super::verify::{self, MappingDifferences};
use crate::coe::{AbortCode, DriveError, Number, SdoError, SdoHandle};

/// Brings `mapping` into a drive in PREOP, and gives the places of its objects.
///
/// What the drive holds is read first, in both directions. What is as it should be is left as it is: a direction in which nothing
/// differs is not written at all, a PDO whose entries do not differ is not filled. Where something was written both directions are
/// read back and compared: some drives set back the one when the other is written. Where the drive has the right PDOs assigned and its assignment cannot be written, only PDOs are filled.
///
/// # Errors
/// [`ConfigureError`]: the drive refused a step, did not answer, or holds another mapping afterwards.
pub async fn configure(mapping: &Mapping, sdo: &SdoHandle) -> Result<Layout, ConfigureError> {
    let outputs = differing(mapping, Direction::Outputs, sdo).await?;
    let inputs = differing(mapping, Direction::Inputs, sdo).await?;
    if outputs.is_none() && inputs.is_none() {
        return Ok(mapping.layout());
    }
    for change in [outputs, inputs].into_iter().flatten() {
        change.execute(sdo).await?;
    }
    let held = read_back(sdo).await?;
    verify::compare(mapping, &held).map_err(|error| {
        ConfigureError::Differs(Box::new(DriveError {
            drive: sdo.drive().clone(),
            error,
        }))
    })?;
    Ok(mapping.layout())
}

/// What is to be written in one direction.
struct Change {
    plan: Plan,
    /// The drive has the right PDOs assigned: only what they hold differs.
    is_assigned: bool,
}

impl Change {
    /// Makes the writes. A drive whose assignment cannot be written, and is right, has its PDOs filled alone.
    async fn execute(&self, sdo: &SdoHandle) -> Result<(), ConfigureError> {
        match execute(&self.plan, sdo).await {
            Err(ConfigureError::Refused { step, error })
                if self.is_assigned
                    && step.purpose == Purpose::EmptyAssignment
                    && matches!(
                        error.error.abort_code(),
                        Some(AbortCode::READ_ONLY | AbortCode::UNSUPPORTED_ACCESS)
                    ) =>
            {
                let fills = |step: &&MappingWrite| {
                    matches!(
                        step.purpose,
                        Purpose::EmptyPdo | Purpose::Map(_) | Purpose::ClosePdo
                    )
                };
                write(self.plan.steps().iter().filter(fills), sdo).await
            }
            result => result,
        }
    }
}

/// What is to be written in one direction; `None` where the drive holds what it should.
///
/// What the drive does not let be read is written.
async fn differing(
    mapping: &Mapping,
    direction: Direction,
    sdo: &SdoHandle,
) -> Result<Option<Change>, ConfigureError> {
    let wanted = mapping.pdos(direction);
    let assigned = wanted.iter().map(|pdo| u32::from(pdo.index));
    let is_assigned = holds::<u16>(direction.assignment(), assigned, sdo).await?;
    let mut different = Vec::new();
    for pdo in wanted {
        let entries = pdo.entries.iter().map(|entry| entry.raw());
        if !holds::<u32>(pdo.index, entries, sdo).await? {
            different.push(pdo.index);
        }
    }
    if is_assigned && different.is_empty() {
        return Ok(None);
    }
    let is_filled = |pdo| different.contains(&pdo);
    let plan = Plan::of_direction(mapping, direction, is_filled);
    Ok(Some(Change { plan, is_assigned }))
}

/// Whether an object holds these elements and no others. What the drive refuses to be read, or has in another width, does not.
async fn holds<T: Number>(
    index: u16,
    wanted: impl Iterator<Item = u32>,
    sdo: &SdoHandle,
) -> Result<bool, ConfigureError> {
    match sdo.read_list::<T>(index).await {
        Ok(list) => Ok(list.into_iter().map(T::to_raw).eq(wanted)),
        Err(DriveError {
            error: SdoError::Aborted { .. } | SdoError::WrongSize { .. },
            ..
        }) => Ok(false),
        Err(error) => Err(ConfigureError::Unreadable(Box::new(error))),
    }
}

/// Makes the writes of `plan`, and stops at the first that fails.
///
/// # Errors
/// [`ConfigureError::Refused`] with the step and the drive's reason.
pub async fn execute(plan: &Plan, sdo: &SdoHandle) -> Result<(), ConfigureError> {
    write(plan.steps().iter(), sdo).await
}

async fn write(
    steps: impl Iterator<Item = &MappingWrite>,
    sdo: &SdoHandle,
) -> Result<(), ConfigureError> {
    for step in steps {
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
    let outputs = read_assigned(Direction::Outputs, sdo).await?;
    let inputs = read_assigned(Direction::Inputs, sdo).await?;
    Ok(Mapping::from_pdos(outputs, inputs))
}

/// Reads the PDOs that a drive has assigned in one direction, with what they hold.
///
/// # Errors
/// [`ConfigureError::Unreadable`] with the object and the drive's reason.
pub async fn read_assigned(
    direction: Direction,
    sdo: &SdoHandle,
) -> Result<Vec<MappedPdo>, ConfigureError> {
    let mut pdos = Vec::new();
    for index in read_list::<u16>(direction.assignment(), sdo).await? {
        // Some drives fill unused places of the assignment with 0.
        if index == 0 {
            continue;
        }
        let raw = read_list::<u32>(index, sdo).await?;
        let entries = raw.into_iter().map(Entry::from_raw).collect();
        pdos.push(MappedPdo { index, entries });
    }
    Ok(pdos)
}

/// Reads what the PDOs `pdos` of a drive hold, as the PDOs that a [`DriveDescription`](crate::drives::DriveDescription) names as
/// fixed. PDOs that the drive does not have are left out.
///
/// A drive shows what a PDO holds, not whether that can be changed: name only PDOs that its manual says are fixed.
///
/// # Errors
/// [`ConfigureError::Unreadable`] with the object and the drive's reason.
pub async fn read_offered(
    sdo: &SdoHandle,
    pdos: impl IntoIterator<Item = u16>,
) -> Result<Vec<FixedPdo>, ConfigureError> {
    let mut offered = Vec::new();
    for index in pdos {
        match read_list::<u32>(index, sdo).await {
            Ok(raw) => offered.push(FixedPdo::new(index, raw.into_iter().map(Entry::from_raw))),
            Err(ConfigureError::Unreadable(error))
                if error.error.abort_code() == Some(AbortCode::NO_OBJECT) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(offered)
}

async fn read_list<T: Number>(index: u16, sdo: &SdoHandle) -> Result<Vec<T>, ConfigureError> {
    let list = sdo.read_list(index).await;
    list.map_err(|error| ConfigureError::Unreadable(Box::new(error)))
}

impl MappingLimits {
    /// Takes from a refusal how much the drive has room for, where that says it: a PDO of fewer entries or bytes, none at all, or fewer
    /// PDOs. Each is less than what was written, so that trying again comes to an end.
    pub fn learn_from(&mut self, error: &ConfigureError) -> bool {
        let ConfigureError::Refused { step, error } = error else {
            return false;
        };
        let (index, fits) = (
            step.object.index,
            usize::from(step.object.subindex.saturating_sub(1)),
        );
        match (step.purpose, error.error.abort_code()) {
            (Purpose::Map(_), Some(AbortCode::NO_SUBINDEX | AbortCode::MAPPING_TOO_LONG))
            | (Purpose::EmptyPdo, Some(AbortCode::NO_OBJECT)) => {
                self.other_pdos.retain(|(pdo, _)| *pdo != index);
                self.other_pdos.push((index, fits));
            }
            (Purpose::Assign(_), Some(AbortCode::NO_SUBINDEX)) => {
                if index == Direction::Outputs.assignment() {
                    self.output_pdos = fits;
                } else {
                    self.input_pdos = fits;
                }
            }
            _ => return false,
        }
        true
    }
}

/// A mapping that did not get into the drive.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigureError {
    /// A step of the plan failed: the drive refused it or did not answer.
    #[error("{step}: {error}")]
    Refused {
        /// The step.
        step: MappingWrite,
        /// The drive and its reason.
        error: Box<DriveError>,
    },
    /// The mapping could not be read back.
    #[error("reading the mapping back: {0}")]
    Unreadable(Box<DriveError>),
    /// The drive holds another mapping than was written.
    #[error("{0}")]
    Differs(Box<DriveError<MappingDifferences>>),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coe::obj;
    use crate::coe::test_device::{Device, rig};
    use crate::pdo_map::verify::MappingDifference;

    /// Two axes, as an AKD2G has them.
    fn two_axes() -> Mapping {
        let mut builder = Mapping::builder();
        for (axis, rx_pdo, tx_pdo) in [(1, 0x1600, 0x1A00), (2, 0x1610, 0x1A10)] {
            builder = builder
                .axis(axis)
                .rx_pdo(rx_pdo)
                .output(obj::CONTROLWORD)
                .output(obj::MODE_OF_OPERATION)
                .output(obj::TARGET_POSITION)
                .output(obj::PROFILE_VELOCITY)
                .tx_pdo(tx_pdo)
                .input(obj::STATUSWORD)
                .input(obj::POSITION_ACTUAL);
        }
        builder.build().unwrap()
    }

    fn configured(device: impl Fn(&Device)) -> Result<Layout, ConfigureError> {
        let (rig, scripted, handle, _) = rig();
        device(&scripted);
        let mapping = two_axes();
        rig.run(async move { configure(&mapping, &handle).await })
    }

    #[test]
    fn a_mapping_that_the_drive_takes_gives_its_layout() {
        let layout = configured(|_| {}).unwrap();
        assert_eq!((layout.output_bytes(), layout.input_bytes()), (22, 12));
    }

    #[test]
    fn a_refused_entry_is_named_with_the_drives_reason() {
        let error = configured(|device| {
            let mut state = device.0.borrow_mut();
            state.refused.insert((0x1610, 4), 0x0604_0041);
        });
        let ConfigureError::Refused { step, error } = error.unwrap_err() else {
            panic!("not refused");
        };
        assert_eq!(step.purpose, Purpose::Map(Entry::new(0x6881, 0, 32)));
        assert_eq!(error.error.abort_code(), Some(AbortCode::NOT_MAPPABLE));
        assert_eq!(error.drive.position, 3);
    }

    #[test]
    fn nothing_is_written_after_a_refused_step() {
        // Pitfall 31.
        let (rig, device, handle, _) = rig();
        device
            .0
            .borrow_mut()
            .refused
            .insert((0x1600, 0), 0x0800_0022);
        let plan = two_axes().plan();
        let result = rig.run(async move { execute(&plan, &handle).await });
        assert!(matches!(
            result,
            Err(ConfigureError::Refused {
                step: MappingWrite {
                    purpose: Purpose::EmptyPdo,
                    ..
                },
                ..
            })
        ));
        assert_eq!(device.0.borrow().written, [(0x1C12, 0, vec![0])]);
    }

    /// CoE details: PDO configuration, and no PDO assignment. The assignment is as it should be, and cannot be written.
    #[test]
    fn pdos_are_filled_where_the_drive_has_them_assigned_for_good() {
        for code in [AbortCode::READ_ONLY, AbortCode::UNSUPPORTED_ACCESS] {
            let layout = configured(|device| assigned_for_good(device, code, [0, 0x10]));
            let bytes = layout.map(|layout| (layout.output_bytes(), layout.input_bytes()));
            assert_eq!(bytes, Ok((22, 12)), "{code}");
        }
    }

    #[test]
    fn an_assignment_that_cannot_be_written_is_refused_where_it_is_not_right_or_for_another_reason()
    {
        for (code, steps) in [
            (AbortCode::READ_ONLY, [0x10, 0]),
            (AbortCode::PRESENT_STATE, [0, 0x10]),
        ] {
            let result = configured(|device| assigned_for_good(device, code, steps));
            let Err(ConfigureError::Refused { step, error }) = result else {
                panic!("not refused");
            };
            assert_eq!(step.purpose, Purpose::EmptyAssignment);
            assert_eq!(error.error.abort_code(), Some(code));
        }
    }

    /// A drive that has the PDOs of two axes assigned, these steps above the first, and refuses any other assignment.
    fn assigned_for_good(device: &Device, code: AbortCode, steps: [u16; 2]) {
        for (assignment, first) in [(0x1C12, 0x1600_u16), (0x1C13, 0x1A00)] {
            device.set(assignment, 0, &[2]);
            for (subindex, step) in (1..).zip(steps) {
                device.set(assignment, subindex, &(first + step).to_le_bytes());
            }
            let mut state = device.0.borrow_mut();
            for subindex in 0..=2 {
                state.refused.insert((assignment, subindex), code.0);
            }
        }
    }

    #[test]
    fn a_drive_that_confirms_but_keeps_its_own_mapping_is_found_out() {
        let error = configured(|device| {
            device.set(0x1600, 2, &Entry::new(0x6072, 0, 16).raw().to_le_bytes());
            device.0.borrow_mut().stubborn.push((0x1600, 2));
        });
        let ConfigureError::Differs(error) = error.unwrap_err() else {
            panic!("not found out");
        };
        assert_eq!(
            error.error.0,
            [MappingDifference::Entry {
                direction: Direction::Outputs,
                pdo: 0x1600,
                place: 2,
                expected: Some(Entry::new(0x6060, 0, 8)),
                got: Some(Entry::new(0x6072, 0, 16)),
            }]
        );
    }

    /// What was read before is not what it holds after the writes to the other direction.
    #[test]
    fn a_drive_whose_inputs_change_when_its_outputs_are_written_is_found_out() {
        let other = Entry::new(0x6077, 0, 32);
        let error = configured(|device| {
            for (pdo, axis) in [(0x1A00, 0), (0x1A10, 0x0800)] {
                let entries = [(0x6041, 16), (0x6064, 32)];
                for (subindex, (index, bits)) in (1..).zip(entries) {
                    let entry = Entry::new(index + axis, 0, bits);
                    device.set(pdo, subindex, &entry.raw().to_le_bytes());
                }
                device.set(pdo, 0, &[2]);
            }
            for (subindex, pdo) in (1..).zip([0x1A00_u16, 0x1A10]) {
                device.set(0x1C13, subindex, &pdo.to_le_bytes());
            }
            device.set(0x1C13, 0, &[2]);
            let set_back = ((0x1A00, 2), other.raw().to_le_bytes().to_vec());
            device.0.borrow_mut().set_back = Some(((0x1C12, 0), set_back));
        });
        let ConfigureError::Differs(error) = error.unwrap_err() else {
            panic!("not found out");
        };
        assert_eq!(
            error.error.0,
            [MappingDifference::Entry {
                direction: Direction::Inputs,
                pdo: 0x1A00,
                place: 2,
                expected: Some(Entry::new(0x6064, 0, 32)),
                got: Some(other),
            }]
        );
    }

    #[test]
    fn a_drive_without_assignment_object_is_unreadable_not_empty() {
        let (rig, _, handle, _) = rig();
        let result = rig.run(async move { read_back(&handle).await });
        let ConfigureError::Unreadable(error) = result.unwrap_err() else {
            panic!("not unreadable");
        };
        assert_eq!(error.error.abort_code(), Some(AbortCode::NO_OBJECT));
        assert_eq!(
            error.error.transfer().object,
            obj::OUTPUT_ASSIGNMENT_COUNT.address()
        );
    }
}
