//! The declaration of what a drive exchanges every cycle.

use alloc::vec::Vec;
use core::fmt;

use super::entry::{Entry, Pdo};
use super::layout::Layout;
use super::mapping_error::MappingError;
use super::plan::Plan;
use crate::coe::{AnyObject, AxisOffset, Number, Object, Readable, Value, Writable};

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
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Objects in one PDO.
    pub entries_per_pdo: usize,
    /// PDOs assigned to one sync manager, in 1C12h or 1C13h.
    pub pdos_per_sync_manager: usize,
    /// Bytes of all outputs.
    pub output_bytes: usize,
    /// Bytes of all inputs.
    pub input_bytes: usize,
}

impl Default for Limits {
    /// What the protocol itself allows: subindices 1 to 254, and process data that fits a frame of 1486 bytes.
    fn default() -> Self {
        Self {
            entries_per_pdo: 254,
            pdos_per_sync_manager: 254,
            output_bytes: 1486,
            input_bytes: 1486,
        }
    }
}

/// What a drive exchanges every cycle, in the order in which it lies in the process data.
///
/// Either direction may be empty: a drive that is only watched needs no outputs.
///
/// ```
/// use servocrab::coe::obj;
/// use servocrab::pdo_map::{Direction, Mapping, Place};
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
/// assert_eq!(layout.find(Direction::Outputs, 0x687A, 0), Some(Place { byte: 2, bit: 0, bits: 32 }));
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
    outputs: Vec<Pdo>,
    inputs: Vec<Pdo>,
    /// PDOs whose content is the drive's own: assigned, not filled.
    fixed: Vec<u16>,
}

impl Mapping {
    /// An empty declaration, to be filled.
    #[must_use]
    pub fn builder() -> MappingBuilder {
        MappingBuilder {
            offset: AxisOffset::default(),
            limits: Limits::default(),
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
    pub const fn from_pdos(outputs: Vec<Pdo>, inputs: Vec<Pdo>) -> Self {
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
    pub fn outputs(&self) -> &[Pdo] {
        &self.outputs
    }

    /// The PDOs that the master reads.
    #[must_use]
    pub fn inputs(&self) -> &[Pdo] {
        &self.inputs
    }

    /// The PDOs of one direction.
    #[must_use]
    pub fn pdos(&self, direction: Direction) -> &[Pdo] {
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
    pub(super) fn within(self, limits: Limits) -> Result<Self, MappingError> {
        for (direction, limit) in [
            (Direction::Outputs, limits.output_bytes),
            (Direction::Inputs, limits.input_bytes),
        ] {
            let pdos = self.pdos(direction);
            for pdo in pdos {
                if pdo.entries.len() > limits.entries_per_pdo && !self.is_fixed(pdo.index) {
                    return Err(MappingError::TooManyEntries {
                        pdo: pdo.index,
                        entries: pdo.entries.len(),
                        limit: limits.entries_per_pdo,
                    });
                }
            }
            if pdos.len() > limits.pdos_per_sync_manager {
                return Err(MappingError::TooManyPdos {
                    direction,
                    pdos: pdos.len(),
                    limit: limits.pdos_per_sync_manager,
                });
            }
            let bytes = pdos.iter().map(Pdo::bits).sum::<usize>().div_ceil(8);
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
#[derive(Debug, Clone)]
pub struct MappingBuilder {
    offset: AxisOffset,
    limits: Limits,
    mapping: Mapping,
    /// The PDO being filled, per direction.
    current: [Option<usize>; 2],
    error: Option<MappingError>,
}

impl MappingBuilder {
    /// What the drive can hold.
    #[must_use]
    pub const fn limits(mut self, limits: Limits) -> Self {
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
    /// without a PDO, a PDO of the other direction or named twice, or more than the drive's [`Limits`].
    pub fn build(self) -> Result<Mapping, MappingError> {
        if let Some(error) = self.error {
            return Err(error);
        }
        self.mapping.within(self.limits)
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
        pdos.push(Pdo {
            index,
            entries: Vec::new(),
        });
        self
    }

    fn push(&mut self, direction: Direction, entry: Entry) {
        let taken = |pdo: &Pdo| pdo.entries.iter().any(|e| e.address() == entry.address());
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

    fn side(&mut self, direction: Direction) -> (&mut Vec<Pdo>, &mut Option<usize>) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coe::{Mappable, ReadWrite, obj};

    const EIGHT_ENTRIES: Limits = Limits {
        entries_per_pdo: 8,
        pdos_per_sync_manager: 2,
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
}
