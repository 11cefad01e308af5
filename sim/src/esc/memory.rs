//! The bytes behind all addresses: values of several bytes have the lowest first.

use super::Esc;

impl Esc {
    /// Puts bytes in; with a mask only the bits that are set in it.
    pub(super) fn copy_in(&mut self, at: usize, bytes: &[u8], mask: Option<&[u8]>) {
        let Some(target) = self.memory.get_mut(at..at + bytes.len()) else {
            return;
        };
        for (offset, (target, byte)) in target.iter_mut().zip(bytes).enumerate() {
            let mask = mask.map_or(0xFF, |mask| mask.get(offset).copied().unwrap_or(0));
            *target = *target & !mask | byte & mask;
        }
    }

    pub(super) fn byte(&self, address: u16) -> u8 {
        self.memory[usize::from(address)]
    }

    pub(super) fn word(&self, address: u16) -> u16 {
        crate::frame::read_u16(&self.memory, usize::from(address)).unwrap_or(0)
    }

    pub(super) fn double_word(&self, address: u16) -> u32 {
        crate::frame::read_u32(&self.memory, usize::from(address)).unwrap_or(0)
    }

    pub(super) fn quad_word(&self, address: u16) -> u64 {
        let low = u64::from(self.double_word(address));
        let high = u64::from(self.double_word(address + 4));
        high << 32 | low
    }

    pub(super) fn set_byte(&mut self, address: u16, value: u8) {
        self.memory[usize::from(address)] = value;
    }

    pub(super) fn set_word(&mut self, address: u16, value: u16) {
        self.set_bytes(address, &value.to_le_bytes());
    }

    pub(super) fn set_bytes(&mut self, address: u16, bytes: &[u8]) {
        self.copy_in(usize::from(address), bytes, None);
    }
}
