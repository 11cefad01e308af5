//! What lies where in a device's process data, with its name: from its SII, or from the PDOs that it has assigned.

use std::fmt;

use crate::{
    coe::ObjectAddress,
    pdo_map::{self, BitRange, Direction, Mapping},
    sii::{self, Sii, SyncManagerUsage},
};

/// An input or output of a device.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct IoPoint {
    /// Whether the program reads or writes it.
    pub direction: Direction,
    /// Its object.
    pub object: ObjectAddress,
    /// The names of its PDO and of its entry, with a dot between: `Channel 1.Input`. Empty where the SII names neither.
    pub name: String,
    /// Where it lies.
    pub place: BitRange,
}

impl fmt::Display for IoPoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.name.is_empty() {
            write!(f, "`{}` ", self.name)?;
        }
        let bits = self.place.bits;
        let plural = if bits == 1 { "" } else { "s" };
        write!(f, "{} ({bits} bit{plural})", self.object)
    }
}

/// By what a program names an input or output: its name, or index and subindex.
///
/// ```
/// use servocrab::bus::PointName;
/// assert_eq!(PointName::from("Channel 1.Input").to_string(), "`Channel 1.Input`");
/// assert_eq!(PointName::from((0x6000, 1)).to_string(), "6000h:01");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointName<'a> {
    /// The names of its PDO and of its entry, with a dot between, or the one that there is.
    Name(&'a str),
    /// Its object.
    Object(ObjectAddress),
}

impl<'a> From<&'a str> for PointName<'a> {
    fn from(name: &'a str) -> Self {
        Self::Name(name)
    }
}

impl From<(u16, u8)> for PointName<'_> {
    fn from((index, subindex): (u16, u8)) -> Self {
        Self::Object(ObjectAddress::new(index, subindex))
    }
}

impl From<ObjectAddress> for PointName<'_> {
    fn from(object: ObjectAddress) -> Self {
        Self::Object(object)
    }
}

impl fmt::Display for PointName<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(name) => write!(f, "`{name}`"),
            Self::Object(object) => object.fmt(f),
        }
    }
}

impl PointName<'_> {
    pub(in crate::bus) fn means(self, point: &IoPoint) -> bool {
        match self {
            Self::Name(name) => point.name == name,
            Self::Object(object) => point.object == object,
        }
    }
}

/// The share of one sync manager in a device's process data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Piece {
    pub direction: Direction,
    /// The sync manager's number.
    pub manager: u8,
    pub bytes: usize,
}

/// A device's process data: outputs and inputs, each sync manager's in whole bytes, one behind the other.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(in crate::bus) struct Image {
    pub points: Vec<IoPoint>,
    pub pieces: Vec<Piece>,
}

/// An assigned PDO.
struct Assigned<'a> {
    manager: u8,
    name: &'a str,
    entries: Vec<Entry<'a>>,
}

struct Entry<'a> {
    object: ObjectAddress,
    bits: u8,
    name: &'a str,
}

impl Image {
    /// What the SII assigns.
    pub fn of_sii(sii: &Sii) -> Self {
        let mut image = Self::default();
        for (direction, pdos) in [
            (Direction::Outputs, &sii.rx_pdos),
            (Direction::Inputs, &sii.tx_pdos),
        ] {
            let assigned = pdos.iter().filter_map(|pdo| {
                Some(Assigned {
                    manager: pdo.sync_manager?,
                    name: name(sii, pdo.name),
                    entries: pdo.entries.iter().map(|entry| of_sii(sii, entry)).collect(),
                })
            });
            image.add(direction, assigned.collect());
        }
        image
    }

    /// What the device has assigned by CoE, with the names that its SII has for the same.
    pub fn of_mapping(mapping: &Mapping, sii: &Sii) -> Self {
        let mut image = Self::default();
        for (direction, known, usage) in [
            (Direction::Outputs, &sii.rx_pdos, SyncManagerUsage::Outputs),
            (Direction::Inputs, &sii.tx_pdos, SyncManagerUsage::Inputs),
        ] {
            let managers = (0..).zip(&sii.sync_managers);
            let manager = managers
                .into_iter()
                .find(|(_, manager)| manager.usage == usage)
                // The usual ones of a device with a mailbox.
                .map_or(
                    if direction == Direction::Outputs {
                        2
                    } else {
                        3
                    },
                    |(number, _)| number,
                );
            let assigned = mapping.pdos(direction).iter().map(|pdo| {
                let known = known.iter().find(|known| known.index == pdo.index);
                let entries = pdo.entries.iter().map(|entry| {
                    let object = entry.address();
                    let known = known.and_then(|known| {
                        let mut entries = known.entries.iter();
                        entries.find(|e| (e.index, e.subindex) == (object.index, object.subindex))
                    });
                    Entry {
                        object,
                        bits: entry.bits,
                        name: known.map_or("", |known| name(sii, known.name)),
                    }
                });
                Assigned {
                    manager,
                    name: known.map_or("", |known| name(sii, known.name)),
                    entries: entries.collect(),
                }
            });
            image.add(direction, assigned.collect());
        }
        image
    }

    /// Bytes of one direction.
    pub fn bytes(&self, direction: Direction) -> usize {
        let pieces = self.pieces.iter();
        let pieces = pieces.filter(|piece| piece.direction == direction);
        pieces.map(|piece| piece.bytes).sum()
    }

    fn add(&mut self, direction: Direction, mut assigned: Vec<Assigned<'_>>) {
        assigned.sort_by_key(|pdo| pdo.manager);
        let mut before = 0;
        for pdos in assigned.chunk_by(|a, b| a.manager == b.manager) {
            let mut bit = 0;
            for pdo in pdos {
                for entry in &pdo.entries {
                    let ObjectAddress { index, subindex } = entry.object;
                    // Padding is no object.
                    if !pdo_map::Entry::new(index, subindex, entry.bits).is_padding() {
                        self.points.push(IoPoint {
                            direction,
                            object: entry.object,
                            name: joined(pdo.name, entry.name),
                            place: BitRange {
                                byte: before + bit / 8,
                                bit: (bit % 8) as u8,
                                bits: entry.bits,
                            },
                        });
                    }
                    bit += usize::from(entry.bits);
                }
            }
            let bytes = bit.div_ceil(8);
            if let Some(manager) = pdos.first().map(|pdo| pdo.manager)
                && bytes != 0
            {
                self.pieces.push(Piece {
                    direction,
                    manager,
                    bytes,
                });
            }
            before += bytes;
        }
    }
}

fn of_sii<'a>(sii: &'a Sii, entry: &sii::PdoEntry) -> Entry<'a> {
    Entry {
        object: ObjectAddress::new(entry.index, entry.subindex),
        bits: entry.bits,
        name: name(sii, entry.name),
    }
}

fn name(sii: &Sii, number: u8) -> &str {
    sii.string(number).unwrap_or_default().trim()
}

fn joined(pdo: &str, entry: &str) -> String {
    match (pdo, entry) {
        ("", one) | (one, "") => one.to_owned(),
        (pdo, entry) => format!("{pdo}.{entry}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pdo_map::{Entry, MappedPdo};

    fn pdo(index: u16, entries: &[Entry]) -> MappedPdo {
        MappedPdo {
            index,
            entries: entries.to_vec(),
        }
    }

    /// An SII with strings and sync managers and nothing else.
    fn sii(strings: &[&str], usages: &[SyncManagerUsage]) -> Sii {
        let mut image = vec![0; 0x80];
        image.extend([0xFF, 0xFF]);
        let mut sii = Sii::parse(&image).unwrap();
        sii.strings = strings.iter().map(ToString::to_string).collect();
        sii.sync_managers = usages
            .iter()
            .map(|usage| sii::SyncManager {
                start: 0x1000,
                length: 0,
                control: 0,
                enable: 1,
                usage: *usage,
            })
            .collect();
        sii
    }

    fn places(image: &Image) -> Vec<(String, usize, u8, u8)> {
        let points = image.points.iter();
        points
            .map(|p| (p.name.clone(), p.place.byte, p.place.bit, p.place.bits))
            .collect()
    }

    #[test]
    fn each_sync_manager_begins_at_a_whole_byte() {
        use SyncManagerUsage::Outputs;
        let mut sii = sii(&["Channel", "Output"], &[Outputs, Outputs]);
        let entry = |index| sii::PdoEntry {
            index,
            subindex: 1,
            name: 2,
            bits: 1,
        };
        sii.rx_pdos = [(1, 0x7010), (0, 0x7000), (0, 0x7008)]
            .map(|(manager, object)| sii::Pdo {
                index: 0x1600,
                sync_manager: Some(manager),
                name: 1,
                flags: 0,
                entries: vec![entry(object)],
            })
            .into();
        let image = Image::of_sii(&sii);
        let name = || String::from("Channel.Output");
        assert_eq!(
            places(&image),
            [(name(), 0, 0, 1), (name(), 0, 1, 1), (name(), 1, 0, 1)]
        );
        assert_eq!(image.bytes(Direction::Outputs), 2);
        let managers: Vec<_> = image.pieces.iter().map(|piece| piece.manager).collect();
        assert_eq!(managers, [0, 1]);
    }

    #[test]
    fn what_coe_assigns_has_the_names_of_the_sii_where_both_name_the_same_object() {
        use SyncManagerUsage::{Inputs, MailboxIn, MailboxOut, Outputs};
        let mut sii = sii(&["AI", "Value"], &[MailboxOut, MailboxIn, Outputs, Inputs]);
        sii.tx_pdos = vec![sii::Pdo {
            index: 0x1A00,
            sync_manager: None,
            name: 1,
            flags: 0,
            entries: vec![sii::PdoEntry {
                index: 0x6000,
                subindex: 0x11,
                name: 2,
                bits: 16,
            }],
        }];
        let entries = [
            Entry::new(0x6000, 1, 1),
            Entry::padding(7),
            Entry::new(0x6000, 0x11, 16),
        ];
        let mapping = Mapping::from_pdos(Vec::new(), vec![pdo(0x1A00, &entries)]);
        let image = Image::of_mapping(&mapping, &sii);
        assert_eq!(
            places(&image),
            [("AI".into(), 0, 0, 1), ("AI.Value".into(), 1, 0, 16)]
        );
        assert_eq!(image.pieces.len(), 1);
        assert_eq!((image.pieces[0].manager, image.pieces[0].bytes), (3, 3));
    }

    /// CiA 301, dummy entries. The inputs of some devices are 0006h:01 and on.
    #[test]
    fn a_gap_that_is_written_as_a_data_type_is_no_point_and_an_object_there_is_one() {
        let entries = [
            Entry::new(0x6000, 1, 1),
            Entry::new(0x0001, 0, 7),
            Entry::new(0x0006, 1, 8),
        ];
        let mapping = Mapping::from_pdos(Vec::new(), vec![pdo(0x1A00, &entries)]);
        let image = Image::of_mapping(&mapping, &sii(&[], &[]));
        let points: Vec<_> = image
            .points
            .iter()
            .map(|point| (point.object.to_string(), point.place.byte))
            .collect();
        assert_eq!(points, [("6000h:01".into(), 0), ("0006h:01".into(), 1)]);
    }
}
