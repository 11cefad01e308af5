//! Further objects of a drive: plain storage, or the values at power-up of what the axes have themselves.

use super::{DriveObjects, PlainObject};
use crate::ds402::DataType;

const CONTROLWORD: u16 = 0x6040;

impl DriveObjects {
    /// Adds an object that only keeps what is written to it, or gives those of the axes its values.
    pub(super) fn add(&mut self, object: &PlainObject) {
        let Some((axis, entries)) = self.profile_entries(object.index) else {
            return self.stored.plain(object);
        };
        if entries.is_empty() {
            return self.stored.plain(object);
        }
        let known = entries.to_vec();
        for entry in known {
            let told = object
                .entries
                .iter()
                .find(|told| told.subindex == entry.subindex);
            let default = told.and_then(|told| told.default.as_ref());
            // A controlword would switch the axis on.
            if let Some(default) = default
                && entry.index != CONTROLWORD
                && let Some(axis) = self.axes.get_mut(axis)
            {
                axis.power_up_with(&entry, decode(entry.kind, default));
            }
        }
    }
}

/// The value of little-endian bytes of a type.
pub(super) fn decode(kind: DataType, data: &[u8]) -> i64 {
    let unsigned = data
        .iter()
        .take(8)
        .rev()
        .fold(0u64, |value, byte| value << 8 | u64::from(*byte));
    match kind {
        DataType::I8 => i64::from(unsigned as i8),
        DataType::I16 => i64::from(unsigned as i16),
        DataType::I32 => i64::from(unsigned as i32),
        DataType::U8 | DataType::U16 | DataType::U32 => unsigned.cast_signed(),
    }
}
