//! What a device's dictionary has, told past all messages.

use super::Device;
use crate::coe::Objects;

/// An object of a device's dictionary.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListedObject {
    /// Index.
    pub index: u16,
    /// Number of the data type (ETG.1000.6).
    pub data_type: u16,
    /// Highest subindex that can exist.
    pub last: u8,
    /// 7 variable, 8 array, 9 record.
    pub code: u8,
    /// Name.
    pub name: String,
    /// The subindices that exist.
    pub entries: Vec<ListedEntry>,
}

/// A subindex of an object of a device's dictionary.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListedEntry {
    /// Subindex.
    pub subindex: u8,
    /// Number of the data type (ETG.1000.6).
    pub data_type: u16,
    /// Length in bits; of a text, as long as it can be.
    pub bits: u16,
    /// Access word of SDO information (ETG.1000.6).
    pub access: u16,
    /// Name.
    pub name: String,
    /// Unit as ETG.1004 codes it.
    pub unit: Option<u32>,
    /// Value at power-up.
    pub default: Option<Vec<u8>>,
    /// Smallest and greatest value.
    pub range: Option<(Vec<u8>, Vec<u8>)>,
}

impl Device {
    /// What it answers when an object is read.
    #[cfg(test)]
    pub(crate) fn read_object(
        &mut self,
        index: u16,
        subindex: u8,
    ) -> Result<Vec<u8>, crate::coe::Abort> {
        let drive = self.drive.as_mut().ok_or(crate::coe::Abort::NoObject)?;
        drive.sdo(true).upload(index, subindex)
    }

    /// The objects of its dictionary, ascending: what SDO information should tell, whether the device has that service or
    /// not. None for a device without CoE.
    pub fn dictionary(&mut self) -> Vec<ListedObject> {
        let Some(drive) = &mut self.drive else {
            return Vec::new();
        };
        let objects = drive.sdo(true);
        let listed = |index| {
            let object = objects.object(index).ok()?;
            let entries = (0..=object.last).filter_map(|subindex| {
                let entry = objects.entry(index, subindex).ok()?;
                Some(ListedEntry {
                    subindex,
                    data_type: entry.data_type,
                    bits: entry.bits,
                    access: entry.access,
                    name: entry.name.into_owned(),
                    unit: entry.unit,
                    default: entry.default,
                    range: entry.range,
                })
            });
            Some(ListedObject {
                index,
                data_type: object.data_type,
                last: object.last,
                code: object.code as u8,
                entries: entries.collect(),
                name: object.name.into_owned(),
            })
        };
        objects.indices().into_iter().filter_map(listed).collect()
    }
}
