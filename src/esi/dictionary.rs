//! The dictionary of a device: its objects, unfolded by their data types into entries.

use std::collections::BTreeMap;

use super::error::{EsiError, EsiFault};
use super::modules::DevicePart;
use super::xml::Element;
use crate::coe::{Mappable, ObjectAddress};

/// Entries of all dictionaries of a file together. A short file can name data types of many subindices often.
pub(super) const MOST_ENTRIES: usize = 1 << 18;

/// An entry of a device's dictionary.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EsiEntry {
    /// Where it is.
    pub object: ObjectAddress,
    /// The name; for an element of an array that of the object.
    pub name: String,
    /// Its length in bits; of a text the most.
    pub bits: u32,
    /// It is text or another value of varying length.
    pub varies: bool,
    /// It can be read.
    pub readable: bool,
    /// It can be written.
    pub writable: bool,
    /// The PDOs into which it can be mapped.
    pub mappable: Mappable,
}

/// Access and mapping, as `Flags` says; a subitem's are those of its object where it says nothing.
#[derive(Clone, Copy)]
struct Flags {
    readable: bool,
    writable: bool,
    mappable: Mappable,
}

impl Flags {
    fn read(element: &Element<'_>, otherwise: Self) -> Self {
        let Some(flags) = element.child("Flags") else {
            return otherwise;
        };
        let access = flags.text_of("Access");
        let mapping = flags.text_of("PdoMapping").to_uppercase();
        Self {
            readable: access.is_empty() && otherwise.readable || access.contains('r'),
            writable: access.contains('w'),
            mappable: Mappable {
                outputs: mapping.contains('R'),
                inputs: mapping.contains('T'),
            },
        }
    }
}

/// Adds the entries of a dictionary. A module's may name data types of its device's.
pub(super) fn read(
    dictionary: &Element<'_>,
    of_device: Option<&Element<'_>>,
    part: &DevicePart<'_>,
    room: &mut usize,
    entries: &mut Vec<EsiEntry>,
) -> Result<(), EsiError> {
    let types: BTreeMap<_, _> = of_device
        .into_iter()
        .chain([dictionary])
        .flat_map(|dictionary| dictionary.children("DataTypes"))
        .flat_map(|types| types.children("DataType"))
        .filter_map(|kind| Some((kind.child("Name")?.text(), kind)))
        .collect();
    for object in dictionary
        .children("Objects")
        .flat_map(|objects| objects.children("Object"))
    {
        let mut unfolding = Unfolding {
            types: &types,
            index: part.object_index(&object.need("Index")?)?,
            object,
            room,
            entries,
        };
        unfolding.unfold()?;
    }
    Ok(())
}

struct Unfolding<'a, 'b> {
    types: &'a BTreeMap<&'a str, Element<'a>>,
    index: u16,
    object: Element<'a>,
    room: &'b mut usize,
    entries: &'b mut Vec<EsiEntry>,
}

impl Unfolding<'_, '_> {
    fn unfold(&mut self) -> Result<(), EsiError> {
        let nothing = Flags {
            readable: true,
            writable: false,
            mappable: Mappable::NO,
        };
        let flags = Flags::read(&self.object, nothing);
        let name = self.object.text_of("Name");
        let type_name = self.object.text_of("Type");
        let kind = self.types.get(type_name.as_str()).copied();
        let mut subitems = kind
            .iter()
            .flat_map(|kind| kind.children("SubItem"))
            .peekable();
        if subitems.peek().is_none() {
            let bits = self.object.number_of("BitSize")?.unwrap_or(0);
            return self.push(0, &name, &type_name, bits, flags);
        }
        for item in subitems {
            let type_of_item = item.text_of("Type");
            let bits: u32 = item.number_of("BitSize")?.unwrap_or(0);
            let flags = Flags::read(&item, flags);
            if let Some(subindex) = item.number_of("SubIdx")? {
                self.push(subindex, &item.text_of("Name"), &type_of_item, bits, flags)?;
                continue;
            }
            // The elements of an array, which follow subindex 0.
            let array = self.types.get(type_of_item.as_str());
            let bounds = array.and_then(|array| array.child("ArrayInfo"));
            let Some(bounds) = bounds else { continue };
            let first: u8 = bounds.number_of("LBound")?.unwrap_or(1).max(1);
            let elements: u8 = bounds.need("Elements")?.number()?;
            let base = array
                .map(|array| array.text_of("BaseType"))
                .unwrap_or_default();
            let bits = bits.checked_div(u32::from(elements)).unwrap_or(0);
            for subindex in (first..=u8::MAX).take(usize::from(elements)) {
                self.push(subindex, &name, &base, bits, flags)?;
            }
        }
        Ok(())
    }

    fn push(
        &mut self,
        subindex: u8,
        name: &str,
        type_name: &str,
        bits: u32,
        flags: Flags,
    ) -> Result<(), EsiError> {
        *self.room = self
            .room
            .checked_sub(1)
            .ok_or_else(|| self.object.error(EsiFault::TooManyEntries))?;
        // A name is repeated for each element of an array.
        let name = name.chars().take(128).collect();
        self.entries.push(EsiEntry {
            object: ObjectAddress::new(self.index, subindex),
            name,
            bits,
            varies: type_name.contains("STRING") || type_name.contains("ARRAY"),
            readable: flags.readable,
            writable: flags.writable,
            mappable: flags.mappable,
        });
        Ok(())
    }
}
