//! The SDO writes that bring a mapping into a drive, in the order that drives demand.

use alloc::vec::Vec;
use core::fmt;

use super::entry::{Entry, Pdo};
use super::mapping::{Direction, Mapping};
use crate::coe::ObjectAddress;

/// Ordered SDO writes, to be made in PREOP and stopped at the first that the drive refuses.
///
/// The order is that of ETG.1000.6. The assignment is emptied. Each PDO is emptied, filled and given its number of entries. Then
/// the assignment is filled and given its number of PDOs. Both directions are there, so that nothing of a former configuration
/// stays. PDOs with a content of the drive's own are assigned and not filled.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plan {
    steps: Vec<Step>,
}

impl Plan {
    /// Everything of `mapping`, whatever the drive holds.
    pub(super) fn of(mapping: &Mapping) -> Self {
        let directions = [Direction::Outputs, Direction::Inputs];
        let steps = directions.map(|direction| Self::of_direction(mapping, direction, |_| true));
        Self {
            steps: steps.into_iter().flat_map(|plan| plan.steps).collect(),
        }
    }

    /// The assignment of one direction, with the content of those PDOs that are to be filled.
    pub(super) fn of_direction(
        mapping: &Mapping,
        direction: Direction,
        is_filled: impl Fn(u16) -> bool,
    ) -> Self {
        let mut steps = Vec::new();
        let assignment = direction.assignment();
        let pdos = mapping.pdos(direction);
        steps.push(Step::count(assignment, 0, Purpose::EmptyAssignment));
        for pdo in pdos {
            if is_filled(pdo.index) && !mapping.is_fixed(pdo.index) {
                steps.extend(fill(pdo));
            }
        }
        for (subindex, pdo) in (1..=u8::MAX).zip(pdos) {
            let [low, high] = pdo.index.to_le_bytes();
            steps.push(Step {
                object: ObjectAddress::new(assignment, subindex),
                value: Bytes::new(&[low, high]),
                purpose: Purpose::Assign(pdo.index),
            });
        }
        let count = u8::try_from(pdos.len()).unwrap_or(u8::MAX);
        if count != 0 {
            steps.push(Step::count(assignment, count, Purpose::CloseAssignment));
        }
        Self { steps }
    }

    /// The writes, in order.
    #[must_use]
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }
}

fn fill(pdo: &Pdo) -> impl Iterator<Item = Step> + '_ {
    let entries = (1..=u8::MAX)
        .zip(&pdo.entries)
        .map(|(subindex, entry)| Step {
            object: ObjectAddress::new(pdo.index, subindex),
            value: Bytes::new(&entry.raw().to_le_bytes()),
            purpose: Purpose::Map(*entry),
        });
    let count = u8::try_from(pdo.entries.len()).unwrap_or(u8::MAX);
    let close = (count != 0).then(|| Step::count(pdo.index, count, Purpose::ClosePdo));
    core::iter::once(Step::count(pdo.index, 0, Purpose::EmptyPdo))
        .chain(entries)
        .chain(close)
}

/// One SDO write of a [`Plan`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// The object that is written.
    pub object: ObjectAddress,
    value: Bytes,
    /// What for.
    pub purpose: Purpose,
}

impl Step {
    const fn count(index: u16, count: u8, purpose: Purpose) -> Self {
        Self {
            object: ObjectAddress::new(index, 0),
            value: Bytes {
                bytes: [count, 0, 0, 0],
                length: 1,
            },
            purpose,
        }
    }

    /// The value's bytes, little-endian, as many as the object is wide.
    #[must_use]
    pub fn value(&self) -> &[u8] {
        self.value
            .bytes
            .get(..usize::from(self.value.length))
            .unwrap_or_default()
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.purpose, self.object)
    }
}

/// What a step of a plan is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// No PDO is assigned while PDOs are changed.
    EmptyAssignment,
    /// The PDO is emptied before it is filled.
    EmptyPdo,
    /// This entry is mapped.
    Map(Entry),
    /// The PDO gets its number of entries.
    ClosePdo,
    /// This PDO is assigned.
    Assign(u16),
    /// The assignment gets its number of PDOs.
    CloseAssignment,
}

impl fmt::Display for Purpose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::EmptyAssignment => f.write_str("emptying the PDO assignment"),
            Self::EmptyPdo => f.write_str("emptying the PDO"),
            Self::Map(entry) => write!(f, "mapping {entry}"),
            Self::ClosePdo => f.write_str("setting the PDO's number of entries"),
            Self::Assign(pdo) => write!(f, "assigning PDO {pdo:04X}h"),
            Self::CloseAssignment => f.write_str("setting the number of PDOs"),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Bytes {
    bytes: [u8; 4],
    length: u8,
}

impl Bytes {
    /// The first four of `value`.
    fn new(value: &[u8]) -> Self {
        let mut bytes = [0; 4];
        for (to, from) in bytes.iter_mut().zip(value) {
            *to = *from;
        }
        Self {
            bytes,
            length: value.len().min(4) as u8,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coe::obj;

    fn writes(mapping: &Mapping) -> Vec<(u16, u8, Vec<u8>)> {
        let plan = mapping.plan();
        plan.steps()
            .iter()
            .map(|step| {
                (
                    step.object.index,
                    step.object.subindex,
                    step.value().to_vec(),
                )
            })
            .collect()
    }

    #[test]
    fn everything_is_emptied_before_it_is_filled() {
        // Pitfall 30.
        let mapping = Mapping::builder()
            .rx_pdo(0x1600)
            .output(obj::CONTROLWORD)
            .output(obj::TARGET_POSITION)
            .tx_pdo(0x1A00)
            .input(obj::STATUSWORD)
            .build()
            .unwrap();
        let expected: Vec<(u16, u8, Vec<u8>)> = [
            (0x1C12, 0, &[0][..]),
            (0x1600, 0, &[0]),
            (0x1600, 1, &[0x10, 0, 0x40, 0x60]),
            (0x1600, 2, &[0x20, 0, 0x7A, 0x60]),
            (0x1600, 0, &[2]),
            (0x1C12, 1, &[0x00, 0x16]),
            (0x1C12, 0, &[1]),
            (0x1C13, 0, &[0]),
            (0x1A00, 0, &[0]),
            (0x1A00, 1, &[0x10, 0, 0x41, 0x60]),
            (0x1A00, 0, &[1]),
            (0x1C13, 1, &[0x00, 0x1A]),
            (0x1C13, 0, &[1]),
        ]
        .map(|(index, subindex, value)| (index, subindex, value.to_vec()))
        .into();
        assert_eq!(writes(&mapping), expected);
    }

    #[test]
    fn a_direction_without_pdos_is_emptied_all_the_same() {
        // Pitfall 35: nothing of a former assignment may stay.
        let mapping = Mapping::builder()
            .tx_pdo(0x1A00)
            .input(obj::STATUSWORD)
            .build()
            .unwrap();
        let writes = writes(&mapping);
        assert_eq!(writes[0], (0x1C12, 0, alloc::vec![0]));
        assert!(
            !writes[1..].iter().any(|write| write.0 == 0x1C12),
            "nothing else is written there"
        );
    }

    #[test]
    fn a_step_says_what_it_is_for() {
        use alloc::string::ToString;
        let mapping = Mapping::builder()
            .rx_pdo(0x1600)
            .output(obj::CONTROLWORD)
            .build()
            .unwrap();
        assert_eq!(
            mapping.plan().steps()[2].to_string(),
            "mapping 6040h:00 (16 bits) (1600h:01)"
        );
    }
}
