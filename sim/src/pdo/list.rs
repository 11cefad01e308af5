//! What the objects of PDOs hold: counted lists, of PDOs or of what is mapped.

use crate::coe::Abort;
use crate::description::PdoEntryDescription;

/// A mapped object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MappedEntry {
    pub(crate) index: u16,
    pub(crate) subindex: u8,
    pub(crate) bits: u8,
}

impl MappedEntry {
    /// Index in the upper half, subindex, length in bits in the lowest byte (CiA 301, object 1600h).
    pub(super) fn from_value(value: u32) -> Self {
        let [bits, subindex, low, high] = value.to_le_bytes();
        Self {
            index: u16::from_le_bytes([low, high]),
            subindex,
            bits,
        }
    }

    pub(super) fn of_description(entry: &PdoEntryDescription) -> u32 {
        let entry = Self {
            index: entry.index,
            subindex: entry.subindex,
            bits: entry.bits,
        };
        entry.value()
    }

    fn value(self) -> u32 {
        u32::from(self.index) << 16 | u32::from(self.subindex) << 8 | u32::from(self.bits)
    }
}

/// A counted list: subindex 0 says how many of the elements count.
#[derive(Clone, Debug)]
pub(super) struct List {
    pub(super) count: u8,
    pub(super) values: Vec<u32>,
}

impl List {
    pub(super) fn new(values: &[u32], capacity: u8) -> Self {
        let mut all = values.to_vec();
        all.resize(usize::from(capacity), 0);
        Self {
            count: u8::try_from(values.len()).unwrap_or(capacity).min(capacity),
            values: all,
        }
    }

    pub(super) fn active(&self) -> &[u32] {
        self.values.get(..usize::from(self.count)).unwrap_or(&[])
    }

    pub(super) fn slot(&mut self, subindex: u8) -> Result<&mut u32, Abort> {
        self.values
            .get_mut(usize::from(subindex).wrapping_sub(1))
            .ok_or(Abort::NoSubindex)
    }

    /// Bytes of a subindex, of which the elements have `width` bytes.
    pub(super) fn upload(&self, subindex: u8, width: usize) -> Result<Vec<u8>, Abort> {
        if subindex == 0 {
            return Ok(vec![self.count]);
        }
        let value = self
            .values
            .get(usize::from(subindex) - 1)
            .ok_or(Abort::NoSubindex)?;
        Ok(value.to_le_bytes().into_iter().take(width).collect())
    }
}
