//! Where objects lie in the process data, and typed access to them there.

use alloc::vec::Vec;
use core::marker::PhantomData;

use super::mapping::Entry;
use super::mapping::{Direction, Mapping, width};
use crate::coe::{Number, Object, ObjectAddress, Readable, Writable};

/// The places of all mapped objects of one drive, counted from the start of its outputs and of its inputs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    outputs: Vec<(Entry, usize)>,
    inputs: Vec<(Entry, usize)>,
    output_bits: usize,
    input_bits: usize,
}

impl Layout {
    pub(super) fn of(mapping: &Mapping) -> Self {
        let (outputs, output_bits) = places(mapping, Direction::Outputs);
        let (inputs, input_bits) = places(mapping, Direction::Inputs);
        Self {
            outputs,
            inputs,
            output_bits,
            input_bits,
        }
    }

    /// Where `index:subindex` lies; `None` if it is not mapped in this direction.
    #[must_use]
    pub fn find(&self, direction: Direction, index: u16, subindex: u8) -> Option<BitRange> {
        let address = ObjectAddress::new(index, subindex);
        let (_, place) = self
            .objects(direction)
            .find(|(object, _)| *object == address)?;
        Some(place)
    }

    /// All objects mapped in this direction with their places, without padding.
    pub fn objects(&self, direction: Direction) -> impl Iterator<Item = (ObjectAddress, BitRange)> {
        let entries = match direction {
            Direction::Outputs => &self.outputs,
            Direction::Inputs => &self.inputs,
        };
        entries
            .iter()
            .filter(|(entry, _)| !entry.is_padding())
            .map(|(entry, bit)| (entry.address(), BitRange::at(*bit, entry.bits)))
    }

    /// The field of an object that the master writes.
    ///
    /// # Errors
    /// [`LayoutError`] if the object is not mapped into the outputs, or not with its own width.
    pub fn output<T: Number, A: Writable>(
        &self,
        object: Object<T, A>,
    ) -> Result<Field<T>, LayoutError> {
        self.field(Direction::Outputs, object)
    }

    /// The field of an object that the master reads.
    ///
    /// # Errors
    /// [`LayoutError`] if the object is not mapped into the inputs, or not with its own width.
    pub fn input<T: Number, A: Readable>(
        &self,
        object: Object<T, A>,
    ) -> Result<Field<T>, LayoutError> {
        self.field(Direction::Inputs, object)
    }

    /// The length of the outputs in bytes.
    #[must_use]
    pub const fn output_bytes(&self) -> usize {
        self.output_bits.div_ceil(8)
    }

    /// The length of the inputs in bytes.
    #[must_use]
    pub const fn input_bytes(&self) -> usize {
        self.input_bits.div_ceil(8)
    }

    fn field<T: Number, A>(
        &self,
        direction: Direction,
        object: Object<T, A>,
    ) -> Result<Field<T>, LayoutError> {
        let place = self
            .find(direction, object.index(), object.subindex())
            .ok_or(LayoutError::NotMapped {
                object: object.address(),
                name: object.name(),
                direction,
            })?;
        Field::new(place).ok_or(LayoutError::OtherWidth {
            object: object.address(),
            expected: width::<T>(),
            got: place.bits,
        })
    }
}

fn places(mapping: &Mapping, direction: Direction) -> (Vec<(Entry, usize)>, usize) {
    let mut bit = 0;
    let mut places = Vec::new();
    for entry in mapping.pdos(direction).iter().flat_map(|pdo| &pdo.entries) {
        places.push((*entry, bit));
        bit += usize::from(entry.bits);
    }
    (places, bit)
}

/// Where an object lies in a drive's outputs or inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct BitRange {
    /// The byte of its lowest bit.
    pub byte: usize,
    /// The place of its lowest bit in that byte, 0 to 7.
    pub bit: u8,
    /// Its length in bits.
    pub bits: u8,
}

impl BitRange {
    const fn at(first_bit: usize, bits: u8) -> Self {
        Self {
            byte: first_bit / 8,
            bit: (first_bit % 8) as u8,
            bits,
        }
    }

    /// The bits at this place of `image`; `None` where that is too short, or where the place does not lie within eight bytes.
    pub(crate) fn read(self, image: &[u8]) -> Option<u64> {
        let bytes = image.get(self.range()?)?;
        let mut eight = [0; 8];
        eight.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(self.read_eight(eight))
    }

    /// The bits at this place of an image of which these are the eight bytes from its first one on.
    pub(crate) const fn read_eight(self, bytes: [u8; 8]) -> u64 {
        u64::from_le_bytes(bytes).wrapping_shr(self.bit as u32) & self.mask()
    }

    /// Puts the lowest bits of `value` at this place of `image` and leaves all others as they are; `false` where that is too short,
    /// or where the place does not lie within eight bytes.
    pub(crate) fn write(self, image: &mut [u8], value: u64) -> bool {
        let Some(target) = self.range().and_then(|range| image.get_mut(range)) else {
            return false;
        };
        let mask = self.mask();
        let [value, mask] =
            [value & mask, mask].map(|bits| bits.wrapping_shl(self.bit.into()).to_le_bytes());
        let parts = value.into_iter().zip(mask);
        for (byte, (value, mask)) in target.iter_mut().zip(parts) {
            *byte = *byte & !mask | value;
        }
        true
    }

    /// The bytes in which it lies.
    fn range(self) -> Option<core::ops::Range<usize>> {
        let touched = (usize::from(self.bit) + usize::from(self.bits)).div_ceil(8);
        (touched <= 8).then_some(())?;
        Some(self.byte..self.byte.checked_add(touched)?)
    }

    /// As many low bits as it is long.
    const fn mask(self) -> u64 {
        match self.bits {
            0..64 => (1 << self.bits) - 1,
            _ => u64::MAX,
        }
    }
}

/// A number at its place in a drive's process data.
///
/// ```
/// use servocrab::coe::obj;
/// use servocrab::pdo_map::Mapping;
///
/// let mapping = Mapping::builder().rx_pdo(0x1600).output(obj::TARGET_POSITION).build()?;
/// let target = mapping.layout().output(obj::TARGET_POSITION)?;
/// let mut outputs = [0; 4];
/// assert!(target.write(&mut outputs, -2));
/// assert_eq!(outputs, [0xFE, 0xFF, 0xFF, 0xFF]);
/// assert_eq!(target.read(&outputs), Some(-2));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Field<T> {
    place: BitRange,
    kind: PhantomData<fn() -> T>,
}

impl<T: Number> Field<T> {
    /// The field at `place`; `None` if that is not as wide as the type.
    #[must_use]
    pub const fn new(place: BitRange) -> Option<Self> {
        if place.bits != T::BITS || place.bit > 7 {
            return None;
        }
        Some(Self {
            place,
            kind: PhantomData,
        })
    }

    /// Where it lies.
    #[must_use]
    pub const fn place(&self) -> BitRange {
        self.place
    }

    /// The number in `image`; `None` if that is too short.
    #[must_use]
    pub fn read(&self, image: &[u8]) -> Option<T> {
        Some(T::from_raw(self.place.read(image)? as u32))
    }

    /// Puts `value` into `image`, leaving all other bits as they are; `false` if that is too short.
    #[must_use = "a value that does not fit is not written"]
    pub fn write(&self, image: &mut [u8], value: T) -> bool {
        self.place.write(image, value.to_raw().into())
    }
}

impl<T> Clone for Field<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Field<T> {}

impl<T> PartialEq for Field<T> {
    fn eq(&self, other: &Self) -> bool {
        self.place == other.place
    }
}

impl<T> Eq for Field<T> {}

/// A field that is not there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LayoutError {
    /// The object is not mapped in this direction.
    #[error("{object} {name} is not mapped into the {direction}")]
    NotMapped {
        /// The object.
        object: ObjectAddress,
        /// Its name.
        name: &'static str,
        /// The direction.
        direction: Direction,
    },
    /// The object is mapped with another width than its type has.
    #[error("{object} is mapped with {got} bits, expected {expected}")]
    OtherWidth {
        /// The object.
        object: ObjectAddress,
        /// Bits of the type.
        expected: u8,
        /// Bits mapped.
        got: u8,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coe::obj;
    use crate::pdo_map::MappedPdo;
    use proptest::prelude::*;

    #[test]
    fn offsets_follow_the_order_of_declaration() {
        let mapping = Mapping::builder()
            .rx_pdo(0x1600)
            .output(obj::CONTROLWORD)
            .output(obj::MODE_OF_OPERATION)
            .output(obj::TARGET_POSITION)
            .axis(2)
            .rx_pdo(0x1610)
            .output(obj::CONTROLWORD)
            .build()
            .unwrap();
        let layout = mapping.layout();
        let byte = |index| {
            layout
                .find(Direction::Outputs, index, 0)
                .map(|place| place.byte)
        };
        assert_eq!(
            [byte(0x6040), byte(0x6060), byte(0x607A), byte(0x6840)],
            [Some(0), Some(2), Some(3), Some(7)]
        );
        assert_eq!(layout.output_bytes(), 9);
        assert_eq!(layout.find(Direction::Inputs, 0x6040, 0), None);
        assert_eq!(layout.find(Direction::Outputs, 0x6860, 0), None);
    }

    proptest! {
        #[test]
        fn bits_survive_at_any_place_and_leave_their_neighbours(
            value: u64, byte in 0usize..4, bit in 0u8..8, bits in 0u8..=57, fill: [u8; 16],
        ) {
            let place = BitRange { byte, bit, bits };
            let mut image = fill;
            prop_assert!(place.write(&mut image, value));
            prop_assert_eq!(place.read(&image), Some(value & ((1 << bits) - 1)));
            prop_assert_eq!(
                Some(place.read_eight(image[byte..byte + 8].try_into().unwrap())),
                place.read(&image)
            );
            prop_assert!(place.write(&mut image, place.read(&fill).unwrap()));
            prop_assert_eq!(image, fill);
        }
    }

    #[test]
    fn bits_that_end_behind_the_image_or_behind_eight_bytes_are_none() {
        let place = |byte, bit, bits| BitRange { byte, bit, bits };
        let mut image = [0xFF; 9];
        assert_eq!(place(0, 0, 64).read(&image), Some(u64::MAX));
        for place in [
            place(0, 1, 64),
            place(8, 0, 9),
            place(9, 0, 1),
            place(usize::MAX, 7, 9),
        ] {
            assert_eq!(place.read(&image), None, "{place:?}");
            assert!(!place.write(&mut image, 0), "{place:?}");
        }
        assert_eq!(image, [0xFF; 9]);
    }

    #[test]
    fn padding_moves_what_follows_and_is_never_found() {
        let entries = alloc::vec![
            Entry::new(0x2000, 1, 1),
            Entry::padding(3),
            Entry::new(0x6040, 0, 16)
        ];
        let pdo = MappedPdo {
            index: 0x1600,
            entries,
        };
        let layout = Mapping::from_pdos(alloc::vec![pdo], Vec::new()).layout();
        assert_eq!(
            layout.find(Direction::Outputs, 0x6040, 0),
            Some(BitRange {
                byte: 0,
                bit: 4,
                bits: 16
            })
        );
        assert_eq!(layout.find(Direction::Outputs, 0, 0), None);
        assert_eq!(layout.output_bytes(), 3);
    }

    #[test]
    fn a_field_of_an_object_mapped_with_another_width_is_refused() {
        let pdo = MappedPdo {
            index: 0x1A00,
            entries: alloc::vec![Entry::new(0x6041, 0, 8)],
        };
        let layout = Mapping::from_pdos(Vec::new(), alloc::vec![pdo]).layout();
        assert_eq!(
            layout.input(obj::STATUSWORD),
            Err(LayoutError::OtherWidth {
                object: obj::STATUSWORD.address(),
                expected: 16,
                got: 8
            })
        );
        assert!(matches!(
            layout.input(obj::POSITION_ACTUAL),
            Err(LayoutError::NotMapped { .. })
        ));
    }

    #[test]
    fn a_short_image_is_refused_and_left_alone() {
        let place = BitRange {
            byte: 2,
            bit: 1,
            bits: 16,
        };
        let field = Field::<u16>::new(place).unwrap();
        let mut image = [0xAA; 4];
        assert_eq!(field.read(&image), None);
        assert!(!field.write(&mut image, 7));
        assert_eq!(image, [0xAA; 4]);
    }

    proptest! {
        #[test]
        fn a_value_survives_at_any_place_and_leaves_its_neighbours(value: i32, byte in 0usize..4, bit in 0u8..8, fill: [u8; 12]) {
            let field = Field::<i32>::new(BitRange { byte, bit, bits: 32 }).unwrap();
            let mut image = fill;
            prop_assert!(field.write(&mut image, value));
            prop_assert_eq!(field.read(&image), Some(value));
            prop_assert!(field.write(&mut image, field.read(&fill).unwrap()));
            prop_assert_eq!(image, fill);
        }

        #[test]
        fn bytes_and_words_survive_at_any_place(value: i16, byte in 0usize..4, bit in 0u8..8, fill: [u8; 8]) {
            let word = Field::<i16>::new(BitRange { byte, bit, bits: 16 }).unwrap();
            let mut image = fill;
            prop_assert!(word.write(&mut image, value));
            prop_assert_eq!(word.read(&image), Some(value));
            let small = Field::<i8>::new(BitRange { byte, bit, bits: 8 }).unwrap();
            prop_assert_eq!(small.read(&image), Some(value as i8));
        }
    }
}
