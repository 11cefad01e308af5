//! The declaration of what a drive exchanges every cycle.

use alloc::vec::Vec;
use core::fmt;

use super::layout::Layout;
use crate::coe::{AnyObject, AxisOffset, Number, Object, ObjectAddress, Readable, Value, Writable};

/// Which way process data travels, seen from the master.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Direction {
    /// The master writes: RxPDOs, 16xxh, assigned in 1C12h.
    Outputs,
    /// The master reads: TxPDOs, 1Axxh, assigned in 1C13h.
    Inputs,
}

impl Direction {
    /// The object in which PDOs of this direction are assigned to their sync manager.
    #[must_use]
    pub const fn assignment(self) -> u16 {
        match self {
            Self::Outputs => 0x1C12,
            Self::Inputs => 0x1C13,
        }
    }

    pub(crate) const fn pdo_range(self) -> core::ops::RangeInclusive<u16> {
        match self {
            Self::Outputs => 0x1600..=0x17FF,
            Self::Inputs => 0x1A00..=0x1BFF,
        }
    }
}

impl fmt::Display for Direction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Outputs => "outputs",
            Self::Inputs => "inputs",
        })
    }
}

/// What a drive's mapping may hold at most.
///
/// ```
/// use servocrab::{coe::obj, pdo_map::{MappingLimits, Mapping}};
/// let small = MappingLimits { entries_per_pdo: 1, ..MappingLimits::default() };
/// let outputs = Mapping::builder().limits(small).rx_pdo(0x1600).output(obj::CONTROLWORD);
/// assert!(outputs.output(obj::TARGET_POSITION).build().is_err());
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MappingLimits {
    /// Objects in one PDO.
    pub entries_per_pdo: usize,
    /// PDOs that take another number of objects, each with its number.
    pub other_pdos: Vec<(u16, usize)>,
    /// RxPDOs assigned in 1C12h.
    pub output_pdos: usize,
    /// TxPDOs assigned in 1C13h.
    pub input_pdos: usize,
    /// Bytes of all outputs.
    pub output_bytes: usize,
    /// Bytes of all inputs.
    pub input_bytes: usize,
}

impl Default for MappingLimits {
    /// What the protocol itself allows: subindices 1 to 254, and process data that fits a frame of 1486 bytes.
    fn default() -> Self {
        Self {
            entries_per_pdo: 254,
            other_pdos: Vec::new(),
            output_pdos: 254,
            input_pdos: 254,
            output_bytes: 1486,
            input_bytes: 1486,
        }
    }
}

impl MappingLimits {
    /// Objects in this PDO.
    pub(super) fn entries(&self, pdo: u16) -> usize {
        let mut others = self.other_pdos.iter();
        let other = others.find(|(index, _)| *index == pdo);
        other.map_or(self.entries_per_pdo, |(_, entries)| *entries)
    }

    /// PDOs of this direction.
    pub(super) const fn pdos(&self, direction: Direction) -> usize {
        match direction {
            Direction::Outputs => self.output_pdos,
            Direction::Inputs => self.input_pdos,
        }
    }

    /// Bytes of this direction.
    pub(super) const fn bytes(&self, direction: Direction) -> usize {
        match direction {
            Direction::Outputs => self.output_bytes,
            Direction::Inputs => self.input_bytes,
        }
    }
}

/// What a drive exchanges every cycle, in the order in which it lies in the process data.
///
/// Either direction may be empty: a drive that is only watched needs no outputs.
///
/// ```
/// use servocrab::coe::obj;
/// use servocrab::pdo_map::{BitRange, Direction, Mapping};
///
/// let mapping = Mapping::builder()
///     .axis(2)
///     .rx_pdo(0x1610)
///     .output(obj::CONTROLWORD)
///     .output(obj::TARGET_POSITION)
///     .tx_pdo(0x1A10)
///     .input(obj::STATUSWORD)
///     .build()?;
/// let layout = mapping.layout();
/// assert_eq!((layout.output_bytes(), layout.input_bytes()), (6, 2));
/// assert_eq!(layout.find(Direction::Outputs, 0x687A, 0), Some(BitRange { byte: 2, bit: 0, bits: 32 }));
/// # Ok::<(), servocrab::pdo_map::MappingError>(())
/// ```
///
/// An object that cannot be written is no output:
///
/// ```compile_fail
/// # use servocrab::{coe::obj, pdo_map::Mapping};
/// Mapping::builder().rx_pdo(0x1600).output(obj::STATUSWORD);
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mapping {
    outputs: Vec<MappedPdo>,
    inputs: Vec<MappedPdo>,
    /// PDOs whose content is the drive's own: assigned, not filled.
    fixed: Vec<u16>,
}

impl Mapping {
    /// An empty declaration, to be filled.
    #[must_use]
    pub fn builder() -> MappingBuilder {
        MappingBuilder {
            offset: AxisOffset::default(),
            limits: MappingLimits::default(),
            mapping: Self {
                outputs: Vec::new(),
                inputs: Vec::new(),
                fixed: Vec::new(),
            },
            current: [None; 2],
            error: None,
        }
    }

    /// A mapping read from elsewhere (a device's SII, its objects), taken as it is.
    #[must_use]
    pub const fn from_pdos(outputs: Vec<MappedPdo>, inputs: Vec<MappedPdo>) -> Self {
        Self {
            outputs,
            inputs,
            fixed: Vec::new(),
        }
    }

    /// The same mapping, in which the content of these PDOs is the drive's own: they are assigned and read back, but not filled.
    #[must_use]
    pub fn with_fixed(mut self, pdos: &[u16]) -> Self {
        self.fixed = pdos.to_vec();
        self
    }

    /// Whether the content of this PDO is the drive's own.
    #[must_use]
    pub fn is_fixed(&self, pdo: u16) -> bool {
        self.fixed.contains(&pdo)
    }

    /// The PDOs that the master writes.
    #[must_use]
    pub fn outputs(&self) -> &[MappedPdo] {
        &self.outputs
    }

    /// The PDOs that the master reads.
    #[must_use]
    pub fn inputs(&self) -> &[MappedPdo] {
        &self.inputs
    }

    /// The PDOs of one direction.
    #[must_use]
    pub fn pdos(&self, direction: Direction) -> &[MappedPdo] {
        match direction {
            Direction::Outputs => &self.outputs,
            Direction::Inputs => &self.inputs,
        }
    }

    /// The SDO writes that bring this mapping into a drive.
    #[must_use]
    pub fn plan(&self) -> Plan {
        Plan::of(self)
    }

    /// Where each object lies in the process data.
    #[must_use]
    pub fn layout(&self) -> Layout {
        Layout::of(self)
    }

    /// The mapping, if it is no more than the drive takes.
    pub(super) fn within(self, limits: &MappingLimits) -> Result<Self, MappingError> {
        for direction in [Direction::Outputs, Direction::Inputs] {
            let pdos = self.pdos(direction);
            if direction == Direction::Outputs
                && let Some(object) = twice(pdos)
            {
                return Err(MappingError::ObjectTwice { object, direction });
            }
            for pdo in pdos {
                let limit = limits.entries(pdo.index);
                if pdo.entries.len() > limit && !self.is_fixed(pdo.index) {
                    return Err(MappingError::TooManyEntries {
                        pdo: pdo.index,
                        entries: pdo.entries.len(),
                        limit,
                    });
                }
            }
            let limit = limits.pdos(direction);
            if pdos.len() > limit {
                return Err(MappingError::TooManyPdos {
                    direction,
                    pdos: pdos.len(),
                    limit,
                });
            }
            let limit = limits.bytes(direction);
            let bytes = pdos.iter().map(MappedPdo::bits).sum::<usize>().div_ceil(8);
            if bytes > limit {
                return Err(MappingError::TooLong {
                    direction,
                    bytes,
                    limit,
                });
            }
        }
        Ok(self)
    }
}

/// An object that has two places. What is written to the first does not reach the second.
fn twice(pdos: &[MappedPdo]) -> Option<ObjectAddress> {
    let entries = pdos.iter().flat_map(|pdo| &pdo.entries);
    let objects = entries.filter(|entry| !entry.is_padding());
    let objects: Vec<_> = objects.map(|entry| entry.address()).collect();
    let mut each = objects.iter().enumerate();
    let again = each.find(|(number, object)| objects[..*number].contains(object));
    again.map(|(_, object)| *object)
}

/// The mapping entry of an object, if it can be mapped that way.
pub(super) fn entry_of(direction: Direction, object: AnyObject) -> Result<Entry, MappingError> {
    let (mappable, accessible) = match direction {
        Direction::Outputs => (object.mappable.outputs, object.writable),
        Direction::Inputs => (object.mappable.inputs, object.readable),
    };
    if !mappable || !accessible || object.bits() == 0 {
        return Err(MappingError::NotMappable {
            object: object.address(),
            name: object.name,
            direction,
        });
    }
    Ok(object.into())
}

/// A [`Mapping`] in the making; the first error is kept and given by [`MappingBuilder::build`].
///
/// ```
/// use servocrab::{coe::obj, pdo_map::Mapping};
/// let of_both_axes = Mapping::builder()
///     .rx_pdo(0x1600)
///     .output(obj::CONTROLWORD)
///     .axis(2)
///     .rx_pdo(0x1610)
///     .output(obj::CONTROLWORD)
///     .build()?;
/// assert_eq!(of_both_axes.outputs()[1].entries[0].address().to_string(), "6840h:00");
/// # Ok::<(), servocrab::pdo_map::MappingError>(())
/// ```
#[derive(Debug, Clone)]
pub struct MappingBuilder {
    offset: AxisOffset,
    limits: MappingLimits,
    mapping: Mapping,
    /// The PDO being filled, per direction.
    current: [Option<usize>; 2],
    error: Option<MappingError>,
}

impl MappingBuilder {
    /// What the drive can hold.
    #[must_use]
    pub fn limits(mut self, limits: MappingLimits) -> Self {
        self.limits = limits;
        self
    }

    /// Objects named from here on belong to axis `axis`, counted from 1, by the rule of
    /// [`AxisOffset::of_axis`]. PDO indices are named as they are.
    #[must_use]
    pub const fn axis(self, axis: u8) -> Self {
        self.offset(AxisOffset::of_axis(axis))
    }

    /// Objects named from here on are moved by `offset`.
    #[must_use]
    pub const fn offset(mut self, offset: AxisOffset) -> Self {
        self.offset = offset;
        self
    }

    /// Outputs named from here on go into the RxPDO `index` (1600h to 17FFh).
    #[must_use]
    pub fn rx_pdo(self, index: u16) -> Self {
        self.pdo(Direction::Outputs, index)
    }

    /// Inputs named from here on go into the TxPDO `index` (1A00h to 1BFFh).
    #[must_use]
    pub fn tx_pdo(self, index: u16) -> Self {
        self.pdo(Direction::Inputs, index)
    }

    /// Adds an object that the master writes every cycle.
    #[must_use]
    pub fn output<T: Number, A: Writable>(self, object: Object<T, A>) -> Self {
        self.object(Direction::Outputs, object.into())
    }

    /// Adds an object that the master reads every cycle.
    #[must_use]
    pub fn input<T: Number, A: Readable>(self, object: Object<T, A>) -> Self {
        self.object(Direction::Inputs, object.into())
    }

    /// Adds an object whose type is known at run time only; the checks are then made here.
    #[must_use]
    pub fn object(mut self, direction: Direction, object: AnyObject) -> Self {
        match entry_of(direction, object.offset(self.offset)) {
            Ok(entry) => self.push(direction, entry),
            Err(error) => return self.fail(error),
        }
        self
    }

    /// Adds `bits` bits that hold no object.
    #[must_use]
    pub fn padding(mut self, direction: Direction, bits: u8) -> Self {
        self.push(direction, Entry::padding(bits));
        self
    }

    /// The declaration.
    ///
    /// # Errors
    /// The first [`MappingError`]: an object that cannot be mapped that way or is mapped twice, an object
    /// without a PDO, a PDO of the other direction or named twice, or more than the drive's [`MappingLimits`].
    pub fn build(self) -> Result<Mapping, MappingError> {
        if let Some(error) = self.error {
            return Err(error);
        }
        self.mapping.within(&self.limits)
    }

    fn pdo(mut self, direction: Direction, index: u16) -> Self {
        if !direction.pdo_range().contains(&index) {
            return self.fail(MappingError::WrongPdo {
                pdo: index,
                direction,
            });
        }
        if self
            .mapping
            .pdos(direction)
            .iter()
            .any(|pdo| pdo.index == index)
        {
            return self.fail(MappingError::PdoTwice { pdo: index });
        }
        let (pdos, current) = self.side(direction);
        *current = Some(pdos.len());
        pdos.push(MappedPdo {
            index,
            entries: Vec::new(),
        });
        self
    }

    fn push(&mut self, direction: Direction, entry: Entry) {
        let taken = |pdo: &MappedPdo| pdo.entries.iter().any(|e| e.address() == entry.address());
        if !entry.is_padding() && self.mapping.pdos(direction).iter().any(taken) {
            self.error.get_or_insert(MappingError::ObjectTwice {
                object: entry.address(),
                direction,
            });
            return;
        }
        let (pdos, current) = self.side(direction);
        match current.and_then(|place| pdos.get_mut(place)) {
            Some(pdo) => pdo.entries.push(entry),
            None => {
                self.error.get_or_insert(MappingError::NoPdo {
                    object: entry.address(),
                    direction,
                });
            }
        }
    }

    fn side(&mut self, direction: Direction) -> (&mut Vec<MappedPdo>, &mut Option<usize>) {
        let [outputs, inputs] = &mut self.current;
        match direction {
            Direction::Outputs => (&mut self.mapping.outputs, outputs),
            Direction::Inputs => (&mut self.mapping.inputs, inputs),
        }
    }

    fn fail(mut self, error: MappingError) -> Self {
        self.error.get_or_insert(error);
        self
    }
}

/// The width of a type in a PDO, checked against a place there.
pub(super) const fn width<T: Value>() -> u8 {
    T::DATA_TYPE.bits()
}

// What can be wrong with a declared mapping.

/// A declaration that no drive, or not this one, can take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MappingError {
    /// The object cannot be mapped in this direction.
    #[error("{object} {name} cannot be mapped into the {direction}")]
    NotMappable {
        /// The object.
        object: ObjectAddress,
        /// Its name.
        name: &'static str,
        /// The direction.
        direction: Direction,
    },
    /// The object is declared twice in one direction.
    #[error("{object} is mapped twice into the {direction}")]
    ObjectTwice {
        /// The object.
        object: ObjectAddress,
        /// The direction.
        direction: Direction,
    },
    /// An object was named before a PDO of its direction.
    #[error("{object} is declared before any PDO of the {direction}")]
    NoPdo {
        /// The object.
        object: ObjectAddress,
        /// The direction.
        direction: Direction,
    },
    /// The index is none of a PDO of this direction.
    #[error("{pdo:04X}h is no PDO of the {direction}")]
    WrongPdo {
        /// The index.
        pdo: u16,
        /// The direction.
        direction: Direction,
    },
    /// The PDO is named twice.
    #[error("PDO {pdo:04X}h is declared twice")]
    PdoTwice {
        /// The PDO.
        pdo: u16,
    },
    /// The PDO holds more objects than the drive takes.
    #[error("PDO {pdo:04X}h holds {entries} objects, the drive takes {limit}")]
    TooManyEntries {
        /// The PDO.
        pdo: u16,
        /// Objects declared.
        entries: usize,
        /// Objects that the drive takes.
        limit: usize,
    },
    /// No PDO that the drive offers holds the object, or not together with the others that are needed.
    #[error(
        "{object} {name} is in no PDO of the {direction} that the drive offers and that can be assigned together with the others"
    )]
    NotOffered {
        /// The object.
        object: ObjectAddress,
        /// Its name.
        name: &'static str,
        /// The direction.
        direction: Direction,
    },
    /// More PDOs are assigned than the drive takes.
    #[error("{pdos} PDOs of the {direction}, the drive takes {limit}")]
    TooManyPdos {
        /// The direction.
        direction: Direction,
        /// PDOs declared.
        pdos: usize,
        /// PDOs that the drive takes.
        limit: usize,
    },
    /// The process data are longer than the drive takes.
    #[error("{bytes} bytes of {direction}, the drive takes {limit}")]
    TooLong {
        /// The direction.
        direction: Direction,
        /// Bytes declared.
        bytes: usize,
        /// Bytes that the drive takes.
        limit: usize,
    },
}

// One mapping entry, as subindices of 16xxh and 1Axxh hold it, and one PDO.

/// An object mapped into a PDO.
///
/// ```
/// use servocrab::{coe::obj, pdo_map::Entry};
/// let entry = Entry::from(servocrab::coe::AnyObject::from(obj::CONTROLWORD));
/// assert_eq!(entry.raw(), 0x6040_0010);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Entry {
    /// The object's index; 0 or that of a data type for padding.
    pub index: u16,
    /// The object's subindex.
    pub subindex: u8,
    /// The length in bits.
    pub bits: u8,
}

impl Entry {
    /// The entry `index:subindex` of `bits` bits.
    #[must_use]
    pub const fn new(index: u16, subindex: u8, bits: u8) -> Self {
        Self {
            index,
            subindex,
            bits,
        }
    }

    /// `bits` bits that hold no object.
    #[must_use]
    pub const fn padding(bits: u8) -> Self {
        Self::new(0, 0, bits)
    }

    /// The entry as the object holds it: index in the upper 16 bits, then subindex, then length.
    #[must_use]
    pub const fn raw(self) -> u32 {
        (self.index as u32) << 16 | (self.subindex as u32) << 8 | self.bits as u32
    }

    /// The entry that the object holds as `raw`.
    #[must_use]
    pub const fn from_raw(raw: u32) -> Self {
        Self {
            index: (raw >> 16) as u16,
            subindex: (raw >> 8) as u8,
            bits: raw as u8,
        }
    }

    /// Whether the entry holds no object: its index is 0, or it is a data type that stands for a gap (CiA 301, dummy entries: 0001h to
    /// 001Fh with subindex 0). An entry there with another subindex is an object: some devices have theirs at 0005h and 0006h.
    #[must_use]
    pub const fn is_padding(self) -> bool {
        match self.index {
            0 => true,
            0x0001..=0x001F => self.subindex == 0,
            _ => false,
        }
    }

    /// Index and subindex together.
    #[must_use]
    pub const fn address(self) -> ObjectAddress {
        ObjectAddress::new(self.index, self.subindex)
    }
}

impl From<AnyObject> for Entry {
    fn from(object: AnyObject) -> Self {
        Self::new(object.index, object.subindex, object.bits())
    }
}

impl fmt::Display for Entry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // A data type is shown as it is: a drive that holds another has another mapping.
        if self.index == 0 {
            return write!(f, "{} bits of padding", self.bits);
        }
        write!(f, "{} ({} bits)", self.address(), self.bits)
    }
}

/// A PDO: its index (1600h to 17FFh or 1A00h to 1BFFh) and what it holds, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MappedPdo {
    /// The index of its mapping object.
    pub index: u16,
    /// What it holds.
    pub entries: Vec<Entry>,
}

impl MappedPdo {
    /// Its length in bits.
    #[must_use]
    pub fn bits(&self) -> usize {
        self.entries
            .iter()
            .map(|entry| usize::from(entry.bits))
            .sum()
    }
}

// The SDO writes that bring a mapping into a drive, in the order that drives demand.

/// Ordered SDO writes, to be made in PREOP and stopped at the first that the drive refuses.
///
/// The order is that of ETG.1000.6. The assignment is emptied. Each PDO is emptied, filled and given its number of entries. Then
/// the assignment is filled and given its number of PDOs. Both directions are there, so that nothing of a former configuration
/// stays. PDOs with a content of the drive's own are assigned and not filled.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plan {
    steps: Vec<MappingWrite>,
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
        steps.push(MappingWrite::count(assignment, 0, Purpose::EmptyAssignment));
        for pdo in pdos {
            if is_filled(pdo.index) && !mapping.is_fixed(pdo.index) {
                steps.extend(fill(pdo));
            }
        }
        for (subindex, pdo) in (1..=u8::MAX).zip(pdos) {
            let [low, high] = pdo.index.to_le_bytes();
            steps.push(MappingWrite {
                object: ObjectAddress::new(assignment, subindex),
                value: Bytes::new(&[low, high]),
                purpose: Purpose::Assign(pdo.index),
            });
        }
        let count = u8::try_from(pdos.len()).unwrap_or(u8::MAX);
        if count != 0 {
            steps.push(MappingWrite::count(
                assignment,
                count,
                Purpose::CloseAssignment,
            ));
        }
        Self { steps }
    }

    /// The writes, in order.
    #[must_use]
    pub fn steps(&self) -> &[MappingWrite] {
        &self.steps
    }
}

fn fill(pdo: &MappedPdo) -> impl Iterator<Item = MappingWrite> + '_ {
    let entries = (1..=u8::MAX)
        .zip(&pdo.entries)
        .map(|(subindex, entry)| MappingWrite {
            object: ObjectAddress::new(pdo.index, subindex),
            value: Bytes::new(&entry.raw().to_le_bytes()),
            purpose: Purpose::Map(*entry),
        });
    let count = u8::try_from(pdo.entries.len()).unwrap_or(u8::MAX);
    let close = (count != 0).then(|| MappingWrite::count(pdo.index, count, Purpose::ClosePdo));
    core::iter::once(MappingWrite::count(pdo.index, 0, Purpose::EmptyPdo))
        .chain(entries)
        .chain(close)
}

/// One SDO write of a [`Plan`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MappingWrite {
    /// The object that is written.
    pub object: ObjectAddress,
    value: Bytes,
    /// What for.
    pub purpose: Purpose,
}

impl MappingWrite {
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

impl fmt::Display for MappingWrite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.purpose, self.object)
    }
}

/// What a step of a plan is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
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
    use crate::coe::{Mappable, ReadWrite, obj};

    const EIGHT_ENTRIES: MappingLimits = MappingLimits {
        entries_per_pdo: 8,
        other_pdos: Vec::new(),
        output_pdos: 2,
        input_pdos: 2,
        output_bytes: 8,
        input_bytes: 8,
    };

    #[test]
    fn a_mapping_of_inputs_alone_is_accepted() {
        // Pitfall 35.
        let mapping = Mapping::builder()
            .tx_pdo(0x1A00)
            .input(obj::STATUSWORD)
            .build()
            .unwrap();
        assert!(mapping.outputs().is_empty());
        assert_eq!(mapping.layout().output_bytes(), 0);
        assert_eq!(mapping.layout().input_bytes(), 2);
    }

    #[test]
    fn a_ninth_object_is_refused_where_the_drive_takes_eight() {
        // Pitfall 32.
        let mut builder = Mapping::builder().limits(EIGHT_ENTRIES).rx_pdo(0x1600);
        for subindex in 1..=9 {
            let object: Object<u8, ReadWrite> =
                Object::new(0x2000, subindex, "byte").mappable(Mappable::OUTPUTS);
            builder = builder.output(object);
        }
        assert_eq!(
            builder.build(),
            Err(MappingError::TooManyEntries {
                pdo: 0x1600,
                entries: 9,
                limit: 8
            })
        );
    }

    #[test]
    fn more_bytes_than_the_drive_takes_are_refused() {
        let builder = Mapping::builder()
            .limits(EIGHT_ENTRIES)
            .tx_pdo(0x1A00)
            .input(obj::POSITION_ACTUAL)
            .input(obj::VELOCITY_ACTUAL)
            .input(obj::STATUSWORD);
        assert_eq!(
            builder.build(),
            Err(MappingError::TooLong {
                direction: Direction::Inputs,
                bytes: 10,
                limit: 8
            })
        );
    }

    #[test]
    fn an_object_is_refused_in_a_direction_in_which_it_is_not_mapped() {
        let builder = Mapping::builder().tx_pdo(0x1A00).input(obj::CONTROLWORD);
        assert!(matches!(
            builder.build(),
            Err(MappingError::NotMappable {
                direction: Direction::Inputs,
                ..
            })
        ));
        let text = Mapping::builder()
            .tx_pdo(0x1A00)
            .object(Direction::Inputs, obj::DEVICE_NAME.into());
        assert!(matches!(
            text.build(),
            Err(MappingError::NotMappable { .. })
        ));
    }

    #[test]
    fn mistakes_of_declaration_are_named() {
        let twice = Mapping::builder()
            .rx_pdo(0x1600)
            .output(obj::CONTROLWORD)
            .output(obj::CONTROLWORD);
        assert!(matches!(
            twice.build(),
            Err(MappingError::ObjectTwice { .. })
        ));
        let homeless = Mapping::builder().output(obj::CONTROLWORD);
        assert!(matches!(homeless.build(), Err(MappingError::NoPdo { .. })));
        let wrong = Mapping::builder().rx_pdo(0x1A00);
        assert!(matches!(wrong.build(), Err(MappingError::WrongPdo { .. })));
        let pdo_twice = Mapping::builder().rx_pdo(0x1600).rx_pdo(0x1600);
        assert_eq!(
            pdo_twice.build(),
            Err(MappingError::PdoTwice { pdo: 0x1600 })
        );
    }

    #[test]
    fn the_second_axis_has_its_own_objects_in_its_own_pdo() {
        // Pitfall 36; AKD2G, Profile Position Mode.
        let mapping = Mapping::builder()
            .rx_pdo(0x1600)
            .output(obj::CONTROLWORD)
            .axis(2)
            .rx_pdo(0x1610)
            .output(obj::CONTROLWORD)
            .tx_pdo(0x1A10)
            .input(obj::AKD2G_MOTION_STATUS)
            .build()
            .unwrap();
        assert_eq!(mapping.outputs()[1].index, 0x1610);
        assert_eq!(mapping.outputs()[1].entries, [Entry::new(0x6840, 0, 16)]);
        assert_eq!(mapping.inputs()[0].entries, [Entry::new(0x5100, 4, 32)]);
    }

    #[test]
    fn an_entry_has_the_bytes_that_a_real_akd_holds() {
        // Public ethercrab repository, dumps/soem-sdinfo-akd.pcapng: 1600h:1 and 1601h:2 of a real AKD.
        assert_eq!(
            Entry::new(0x6040, 0, 16).raw().to_le_bytes(),
            [0x10, 0x00, 0x40, 0x60]
        );
        assert_eq!(
            Entry::from_raw(u32::from_le_bytes([0x08, 0x00, 0x60, 0x60])),
            Entry::new(0x6060, 0, 8)
        );
    }

    proptest::proptest! {
        #[test]
        fn every_raw_entry_survives(raw: u32) {
            proptest::prop_assert_eq!(Entry::from_raw(raw).raw(), raw);
        }
    }

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
