//! What a drive holds after its mapping was written, compared with what was declared.

use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;

use super::mapping::{Direction, Mapping};
use super::mapping::{Entry, MappedPdo};
use crate::coe::value::column_width;

/// Compares what was declared with what was read back.
///
/// # Errors
/// [`MappingDifferences`], each naming PDO and place, with what was expected beside what was got.
pub fn compare(expected: &Mapping, got: &Mapping) -> Result<(), MappingDifferences> {
    let mut differences = Vec::new();
    for direction in [Direction::Outputs, Direction::Inputs] {
        let (expected, got) = (expected.pdos(direction), got.pdos(direction));
        for place in 0..expected.len().max(got.len()) {
            match (expected.get(place), got.get(place)) {
                (Some(expected), Some(got)) if expected.index == got.index => {
                    compare_pdo(direction, expected, got, &mut differences);
                }
                (expected, got) => differences.push(MappingDifference::Assignment {
                    direction,
                    place: place + 1,
                    expected: expected.map(|pdo| pdo.index),
                    got: got.map(|pdo| pdo.index),
                }),
            }
        }
    }
    if differences.is_empty() {
        return Ok(());
    }
    Err(MappingDifferences(differences))
}

fn compare_pdo(
    direction: Direction,
    expected: &MappedPdo,
    got: &MappedPdo,
    differences: &mut Vec<MappingDifference>,
) {
    for place in 0..expected.entries.len().max(got.entries.len()) {
        let entries = (
            expected.entries.get(place).copied(),
            got.entries.get(place).copied(),
        );
        if entries.0 != entries.1 {
            differences.push(MappingDifference::Entry {
                direction,
                pdo: expected.index,
                place: place + 1,
                expected: entries.0,
                got: entries.1,
            });
        }
    }
}

/// All differences; never empty.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MappingDifferences(pub Vec<MappingDifference>);

/// A table with a line for each difference: what was expected beside what was got.
impl fmt::Display for MappingDifferences {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the drive holds another mapping than was written:")?;
        let head = ["place", "expected", "got"].map(String::from);
        let rows: Vec<_> = core::iter::once(head)
            .chain(self.0.iter().map(MappingDifference::cells))
            .collect();
        let width = |column: usize| column_width(rows.iter().filter_map(|row| row.get(column)));
        let widths = (width(0), width(1));
        for [place, expected, got] in &rows {
            write!(
                f,
                "\n  {place:0$}  {expected:1$}  {got}",
                widths.0, widths.1
            )?;
        }
        Ok(())
    }
}

impl core::error::Error for MappingDifferences {}

/// One difference; `None` stands for nothing at that place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum MappingDifference {
    /// Another PDO is assigned.
    Assignment {
        /// The direction.
        direction: Direction,
        /// The subindex of 1C12h or 1C13h.
        place: usize,
        /// The PDO declared.
        expected: Option<u16>,
        /// The PDO that the drive holds.
        got: Option<u16>,
    },
    /// Another object is mapped.
    Entry {
        /// The direction.
        direction: Direction,
        /// The PDO.
        pdo: u16,
        /// The subindex of the PDO's mapping object.
        place: usize,
        /// The entry declared.
        expected: Option<Entry>,
        /// The entry that the drive holds.
        got: Option<Entry>,
    },
}

impl MappingDifference {
    /// The object that differs, what was expected there, what was got.
    fn cells(&self) -> [String; 3] {
        let nothing = || String::from("nothing");
        match self {
            Self::Assignment {
                direction,
                place,
                expected,
                got,
            } => {
                let name = |pdo: &Option<u16>| {
                    pdo.map_or_else(nothing, |pdo| alloc::format!("PDO {pdo:04X}h"))
                };
                let object = alloc::format!("{:04X}h:{place:02X}", direction.assignment());
                [object, name(expected), name(got)]
            }
            Self::Entry {
                pdo,
                place,
                expected,
                got,
                ..
            } => {
                let name = |entry: &Option<Entry>| {
                    entry.map_or_else(nothing, |entry| alloc::format!("{entry}"))
                };
                [
                    alloc::format!("{pdo:04X}h:{place:02X}"),
                    name(expected),
                    name(got),
                ]
            }
        }
    }
}

impl fmt::Display for MappingDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [place, expected, got] = self.cells();
        write!(f, "{place}: expected {expected}, got {got}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::string::ToString;
    use alloc::vec;

    fn mapping(outputs: &[(u16, &[Entry])]) -> Mapping {
        let pdos = outputs.iter().map(|(index, entries)| MappedPdo {
            index: *index,
            entries: entries.to_vec(),
        });
        Mapping::from_pdos(pdos.collect(), Vec::new())
    }

    const CONTROLWORD: Entry = Entry::new(0x6040, 0, 16);
    const MODE: Entry = Entry::new(0x6060, 0, 8);

    #[test]
    fn equal_mappings_have_no_difference() {
        let same = mapping(&[(0x1600, &[CONTROLWORD, MODE])]);
        assert_eq!(compare(&same, &same.clone()), Ok(()));
    }

    #[test]
    fn another_entry_is_shown_beside_the_expected_one() {
        let expected = mapping(&[(0x1600, &[CONTROLWORD, MODE])]);
        let got = mapping(&[(0x1600, &[CONTROLWORD])]);
        let differences = compare(&expected, &got).unwrap_err();
        assert_eq!(
            differences.0,
            [MappingDifference::Entry {
                direction: Direction::Outputs,
                pdo: 0x1600,
                place: 2,
                expected: Some(MODE),
                got: None
            }]
        );
        assert_eq!(
            differences.to_string(),
            "the drive holds another mapping than was written:\n  \
             place     expected           got\n  \
             1600h:02  6060h:00 (8 bits)  nothing"
        );
    }

    #[test]
    fn another_or_a_further_assigned_pdo_is_a_difference() {
        let expected = mapping(&[(0x1600, &[CONTROLWORD])]);
        let got = mapping(&[(0x1601, &[CONTROLWORD]), (0x1602, &[])]);
        let differences = compare(&expected, &got).unwrap_err().0;
        let shown: Vec<_> = differences.iter().map(ToString::to_string).collect();
        assert_eq!(
            shown,
            vec![
                "1C12h:01: expected PDO 1600h, got PDO 1601h",
                "1C12h:02: expected nothing, got PDO 1602h"
            ]
        );
    }
}
