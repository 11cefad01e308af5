//! One mapping entry, as subindices of 16xxh and 1Axxh hold it, and one PDO.

use alloc::vec::Vec;
use core::fmt;

use crate::coe::{AnyObject, ObjectAddress};

/// An object mapped into a PDO.
///
/// ```
/// use servocrab::{coe::obj, pdo_map::Entry};
/// let entry = Entry::from(servocrab::coe::AnyObject::from(obj::CONTROLWORD));
/// assert_eq!(entry.raw(), 0x6040_0010);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Entry {
    /// The object's index; 0 for padding.
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

    /// Whether the entry holds no object.
    #[must_use]
    pub const fn is_padding(self) -> bool {
        self.index == 0
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
        if self.is_padding() {
            return write!(f, "{} bits of padding", self.bits);
        }
        write!(f, "{} ({} bits)", self.address(), self.bits)
    }
}

/// A PDO: its index (1600h to 17FFh or 1A00h to 1BFFh) and what it holds, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pdo {
    /// The index of its mapping object.
    pub index: u16,
    /// What it holds.
    pub entries: Vec<Entry>,
}

impl Pdo {
    /// Its length in bits.
    #[must_use]
    pub fn bits(&self) -> usize {
        self.entries
            .iter()
            .map(|entry| usize::from(entry.bits))
            .sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
