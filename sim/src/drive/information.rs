//! What the SDO information service tells about an axis's objects.

use crate::coe::info::{EntryInfo, ObjectCode, ObjectInfo, access, data_type};
use crate::ds402::{Access, DataType, Entry, Mapping};

/// About an object, from all of its entries; `None` when there are none.
pub(super) fn axis_object_info(entries: &[Entry]) -> Option<ObjectInfo> {
    let first = entries.first()?;
    let mut elements = entries.iter().filter(|entry| entry.subindex > 0);
    let Some(element) = elements.next() else {
        return Some(ObjectInfo {
            data_type: type_of(first.kind),
            last: 0,
            code: ObjectCode::Var,
            name: first.name.into(),
        });
    };
    let is_array = elements.all(|other| other.kind == element.kind);
    Some(ObjectInfo {
        data_type: if is_array {
            type_of(element.kind)
        } else {
            data_type::NONE
        },
        last: entries
            .iter()
            .map(|entry| entry.subindex)
            .max()
            .unwrap_or(0),
        code: if is_array {
            ObjectCode::Array
        } else {
            ObjectCode::Record
        },
        name: first.name.into(),
    })
}

/// About one entry. Subindex 0 of a record bears the record's name in the axis model, but is its number of entries.
pub(super) fn axis_entry_info(entry: &Entry, is_record: bool, default: Option<i64>) -> EntryInfo {
    let by_sdo = match entry.access {
        Access::ReadOnly => access::READ,
        Access::ReadWrite => access::READ | access::WRITE,
    };
    let by_pdo = match entry.mapping {
        Mapping::None => 0,
        Mapping::Rx => access::RX,
        Mapping::Tx => access::TX,
        Mapping::Both => access::RX | access::TX,
    };
    if is_record {
        return EntryInfo::count(by_sdo);
    }
    let kept = if entry.saved { access::BACKUP } else { 0 };
    let bytes = entry.kind.size();
    let encode = |value: i64| value.to_le_bytes().into_iter().take(bytes).collect();
    let bits = u16::try_from(8 * bytes).unwrap_or(u16::MAX);
    let mut info = EntryInfo::new(
        type_of(entry.kind),
        bits,
        by_sdo | by_pdo | kept,
        entry.name,
    );
    info.unit = unit_of(entry.index);
    if entry.access == Access::ReadWrite {
        info.default = default.map(encode);
        info.range = Some((encode(entry.min), encode(entry.max)));
    }
    info
}

fn type_of(kind: DataType) -> u16 {
    match kind {
        DataType::I8 => data_type::I8,
        DataType::U8 => data_type::U8,
        DataType::I16 => data_type::I16,
        DataType::U16 => data_type::U16,
        DataType::I32 => data_type::I32,
        DataType::U32 => data_type::U32,
    }
}

/// Units of positions, velocities and times, with the numbers of ETG.1004 as far as they are known from drives' manuals:
/// B5h increments, 03h second, prefix FDh for a thousandth. Not confirmed by the document itself.
fn unit_of(index: u16) -> Option<u32> {
    match index {
        0x6062..=0x6065 | 0x6067 | 0x607A | 0x607C | 0x607D | 0x60F4 => Some(0x00B5_0000),
        0x606B | 0x606C | 0x607F | 0x6081 | 0x6082 => Some(0x00B5_0300),
        0x6066 | 0x6068 => Some(0xFD03_0000),
        _ => None,
    }
}
