//! A device's object dictionary as it describes it itself, by SDO information.

use alloc::vec::Vec;

use super::abort::AbortCode;
use super::information::{EntryDescription, ObjectDescription};
use super::object::ObjectAddress;

/// The objects of a device, as read by [`SdoHandle::dictionary`](super::SdoHandle::dictionary).
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ObjectDictionary {
    /// The objects with their entries, in the device's order.
    pub objects: Vec<DictionaryObject>,
    /// What the device lists but does not describe.
    pub undescribed: Vec<Undescribed>,
}

/// An object with its entries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DictionaryObject {
    /// What it is.
    pub description: ObjectDescription,
    /// Its entries in ascending order; subindices that do not exist are left out.
    pub entries: Vec<EntryDescription>,
}

/// An object or an entry whose description a device refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Undescribed {
    /// The index.
    pub index: u16,
    /// The entry; none if it is the object itself.
    pub subindex: Option<u8>,
    /// The device's reason.
    pub code: AbortCode,
}

impl ObjectDictionary {
    /// The object with this index.
    #[must_use]
    pub fn object(&self, index: u16) -> Option<&DictionaryObject> {
        self.objects
            .iter()
            .find(|object| object.description.index == index)
    }

    /// The entry with this address.
    #[must_use]
    pub fn entry(&self, address: ObjectAddress) -> Option<&EntryDescription> {
        self.object(address.index)?
            .entries
            .iter()
            .find(|entry| entry.address == address)
    }

    /// The entries that bear this name, whatever its case: their own, or their object's where it is a single variable. A
    /// drive of two axes has most names twice.
    pub fn named<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a EntryDescription> {
        self.objects.iter().flat_map(move |object| {
            let of_object = object.description.name.eq_ignore_ascii_case(name);
            object.entries.iter().filter(move |entry| {
                entry.name.eq_ignore_ascii_case(name)
                    || of_object && object.description.max_subindex == 0
            })
        })
    }

    /// All entries.
    pub fn entries(&self) -> impl Iterator<Item = &EntryDescription> {
        self.objects.iter().flat_map(|object| &object.entries)
    }
}
