//! FMMUs: which bits of a logical address range lie where in a device's memory.

use crate::frame::{read_u16, read_u32};

/// One FMMU as its sixteen registers describe it, in bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fmmu {
    logical_bit: u64,
    bits: u64,
    physical_bit: u64,
    pub(crate) reads: bool,
    pub(crate) writes: bool,
}

/// A part of a datagram that one FMMU maps: bits of the datagram's data against bits of the memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Mapped {
    /// First bit in the datagram's data.
    pub(crate) data_bit: usize,
    /// First bit in the device's memory.
    pub(crate) memory_bit: usize,
    /// How many bits.
    pub(crate) bits: usize,
}

impl Fmmu {
    /// Decodes the registers; `None` when the FMMU is off or describes no bit.
    ///
    /// Logical start u32, length u16, start bit, end bit, physical start u16, physical start bit, type (1 read, 2 write),
    /// activate bit 0 (ETG.1000.4).
    pub(crate) fn from_registers(registers: &[u8]) -> Option<Self> {
        let byte = |at: usize| registers.get(at).copied().unwrap_or(0);
        let length = u64::from(read_u16(registers, 4)?);
        if byte(12) & 0x01 == 0 || length == 0 {
            return None;
        }
        let start_bit = u64::from(byte(6) & 0x07);
        let end_bit = u64::from(byte(7) & 0x07);
        let bits = ((length - 1) * 8 + end_bit + 1).checked_sub(start_bit)?;
        Some(Self {
            logical_bit: u64::from(read_u32(registers, 0)?) * 8 + start_bit,
            bits,
            physical_bit: u64::from(read_u16(registers, 8)?) * 8 + u64::from(byte(10) & 0x07),
            reads: byte(11) & 0x01 != 0,
            writes: byte(11) & 0x02 != 0,
        })
    }

    /// The part that lies in a datagram of `length` bytes at the logical address `logical`.
    pub(crate) fn mapped(&self, logical: u32, length: usize) -> Option<Mapped> {
        let from = u64::from(logical) * 8;
        let to = from + length as u64 * 8;
        let first = from.max(self.logical_bit);
        let behind = to.min(self.logical_bit + self.bits);
        if first >= behind {
            return None;
        }
        Some(Mapped {
            data_bit: usize::try_from(first - from).ok()?,
            memory_bit: usize::try_from(self.physical_bit + first - self.logical_bit).ok()?,
            bits: usize::try_from(behind - first).ok()?,
        })
    }
}

impl Mapped {
    /// First byte of memory and number of bytes that hold the bits.
    pub(crate) fn memory_bytes(&self) -> (usize, usize) {
        let first = self.memory_bit / 8;
        (first, (self.memory_bit + self.bits).div_ceil(8) - first)
    }

    /// The bytes of the datagram's data, when no byte is mapped in part.
    fn whole_bytes(&self) -> Option<core::ops::Range<usize>> {
        let aligned = [self.data_bit, self.memory_bit, self.bits]
            .iter()
            .all(|bits| bits % 8 == 0);
        aligned.then(|| self.data_bit / 8..(self.data_bit + self.bits) / 8)
    }

    /// Takes the bits out of a datagram: memory bytes and, for each, which of its bits are meant.
    pub(crate) fn gather(&self, data: &[u8]) -> (Vec<u8>, Vec<u8>) {
        let (first, count) = self.memory_bytes();
        if let Some(bytes) = self.whole_bytes().and_then(|range| data.get(range)) {
            return (bytes.to_vec(), vec![0xFF; count]);
        }
        let mut bytes = vec![0; count];
        let mut mask = vec![0; count];
        for bit in 0..self.bits {
            let target = self.memory_bit + bit - first * 8;
            let source = self.data_bit + bit;
            let set = data
                .get(source / 8)
                .is_some_and(|byte| byte >> (source % 8) & 1 != 0);
            if let (Some(byte), Some(mask)) = (bytes.get_mut(target / 8), mask.get_mut(target / 8))
            {
                *byte |= u8::from(set) << (target % 8);
                *mask |= 1 << (target % 8);
            }
        }
        (bytes, mask)
    }

    /// Puts bits of memory bytes into a datagram; other bits of the datagram stay.
    pub(crate) fn scatter(&self, bytes: &[u8], data: &mut [u8]) {
        if let Some(target) = self.whole_bytes().and_then(|range| data.get_mut(range)) {
            target
                .iter_mut()
                .zip(bytes)
                .for_each(|(target, byte)| *target = *byte);
            return;
        }
        let (first, _) = self.memory_bytes();
        for bit in 0..self.bits {
            let source = self.memory_bit + bit - first * 8;
            let target = self.data_bit + bit;
            let set = bytes
                .get(source / 8)
                .is_some_and(|byte| byte >> (source % 8) & 1 != 0);
            if let Some(byte) = data.get_mut(target / 8) {
                *byte = *byte & !(1 << (target % 8)) | u8::from(set) << (target % 8);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Registers of an FMMU: logical start, length, start and end bit, physical start and bit, type.
    fn registers(
        logical: u32,
        length: u16,
        bits: (u8, u8),
        physical: u16,
        bit: u8,
        kind: u8,
    ) -> [u8; 16] {
        let mut bytes = [0; 16];
        bytes[0..4].copy_from_slice(&logical.to_le_bytes());
        bytes[4..6].copy_from_slice(&length.to_le_bytes());
        bytes[6] = bits.0;
        bytes[7] = bits.1;
        bytes[8..10].copy_from_slice(&physical.to_le_bytes());
        bytes[10] = bit;
        bytes[11] = kind;
        bytes[12] = 1;
        bytes
    }

    #[test]
    fn whole_bytes_map_one_to_one() {
        let fmmu = Fmmu::from_registers(&registers(0x1000, 4, (0, 7), 0x1100, 0, 2)).unwrap();
        let mapped = fmmu.mapped(0x0FFE, 8).unwrap();
        assert_eq!(
            mapped,
            Mapped {
                data_bit: 16,
                memory_bit: 0x1100 * 8,
                bits: 32
            }
        );
        let (bytes, mask) = mapped.gather(&[9, 9, 1, 2, 3, 4, 9, 9]);
        assert_eq!((bytes, mask), (vec![1, 2, 3, 4], vec![0xFF; 4]));
    }

    #[test]
    fn a_datagram_that_holds_a_part_maps_that_part() {
        let fmmu = Fmmu::from_registers(&registers(0x1000, 4, (0, 7), 0x1100, 0, 1)).unwrap();
        let mapped = fmmu.mapped(0x1002, 8).unwrap();
        assert_eq!(
            mapped,
            Mapped {
                data_bit: 0,
                memory_bit: 0x1102 * 8,
                bits: 16
            }
        );
        assert_eq!(fmmu.mapped(0x1004, 8), None);
    }

    #[test]
    fn single_bits_keep_their_neighbours() {
        // Bits 3 to 4 of the logical byte are bits 0 to 1 of the memory byte.
        let fmmu = Fmmu::from_registers(&registers(0, 1, (3, 4), 0x1000, 0, 3)).unwrap();
        let mapped = fmmu.mapped(0, 1).unwrap();
        let mut data = [0b1110_0111];
        mapped.scatter(&[0b0000_0011], &mut data);
        assert_eq!(data, [0b1111_1111]);
        assert_eq!(mapped.gather(&[0b0001_0000]), (vec![0b10], vec![0b11]));
    }

    #[test]
    fn an_fmmu_that_is_off_maps_nothing() {
        let mut bytes = registers(0, 1, (0, 7), 0x1000, 0, 1);
        bytes[12] = 0;
        assert_eq!(Fmmu::from_registers(&bytes), None);
    }
}
