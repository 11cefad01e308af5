//! The part of an object dictionary that is plain storage: fixed values, and a few objects that can be written.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry as MapEntry;

use crate::coe::Abort;
use crate::coe::info::{EntryInfo, ObjectCode, ObjectInfo, access, data_type};
use crate::drive::PlainObject;

/// One stored value, as it is put into a dictionary.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Entry {
    data_type: u16,
    name: Cow<'static, str>,
    access: u16,
    value: Vec<u8>,
    default: Vec<u8>,
    /// Shortest and longest value.
    lengths: (usize, usize),
    /// The values that are taken, when not all are.
    choices: Option<&'static [u16]>,
}

impl Entry {
    fn new(data_type: u16, value: &[u8]) -> Self {
        Self {
            data_type,
            name: "".into(),
            access: access::READ,
            value: value.to_vec(),
            default: value.to_vec(),
            lengths: (value.len(), value.len()),
            choices: None,
        }
    }

    /// An UNSIGNED8 that can only be read.
    pub(crate) fn u8(value: u8) -> Self {
        Self::new(data_type::U8, &[value])
    }

    /// An UNSIGNED16 that can only be read.
    pub(crate) fn u16(value: u16) -> Self {
        Self::new(data_type::U16, &value.to_le_bytes())
    }

    /// An UNSIGNED32 that can only be read.
    pub(crate) fn u32(value: u32) -> Self {
        Self::new(data_type::U32, &value.to_le_bytes())
    }

    /// A VISIBLE_STRING that can only be read.
    pub(crate) fn text(value: &str) -> Self {
        Self::new(data_type::VISIBLE_STRING, value.as_bytes())
    }

    /// Gives it a name.
    pub(crate) fn named(self, name: impl Into<Cow<'static, str>>) -> Self {
        Self {
            name: name.into(),
            ..self
        }
    }

    /// Lets it be written with as many bytes as it has.
    pub(crate) fn writable(self) -> Self {
        Self {
            access: self.access | access::WRITE,
            ..self
        }
    }

    /// Lets it be written but not read.
    pub(crate) fn write_only(self) -> Self {
        Self {
            access: access::WRITE,
            ..self
        }
    }

    /// Lets it be written with anything from no byte up to this many.
    pub(crate) fn up_to(self, longest: usize) -> Self {
        Self {
            lengths: (0, longest),
            ..self.writable()
        }
    }

    /// Lets it be written with these numbers.
    pub(crate) fn one_of(self, choices: &'static [u16]) -> Self {
        Self {
            choices: Some(choices),
            ..self.writable()
        }
    }

    fn is_writable(&self) -> bool {
        self.access & access::WRITE != 0
    }

    fn check(&self, data: &[u8]) -> Result<(), Abort> {
        if !self.is_writable() {
            return Err(Abort::ReadOnly);
        }
        if data.len() > self.lengths.1 {
            return Err(Abort::TooLong);
        }
        if data.len() < self.lengths.0 {
            return Err(Abort::TooShort);
        }
        let taken = |choice: &u16| choice.to_le_bytes() == data;
        if self
            .choices
            .is_some_and(|choices| !choices.iter().any(taken))
        {
            return Err(Abort::Range);
        }
        Ok(())
    }
}

/// An object with its subindices.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Object {
    code: ObjectCode,
    data_type: u16,
    name: Cow<'static, str>,
    entries: BTreeMap<u8, Entry>,
}

/// Stored objects by index.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Dictionary {
    objects: BTreeMap<u16, Object>,
}

impl Dictionary {
    /// Adds an object of one value.
    pub(crate) fn variable(&mut self, index: u16, name: &'static str, entry: Entry) {
        let object = Object {
            code: ObjectCode::Var,
            data_type: entry.data_type,
            name: name.into(),
            entries: [(0, entry.named(name))].into(),
        };
        self.objects.insert(index, object);
    }

    /// Adds an array of elements of one type; subindex 0 is their number.
    pub(crate) fn array(
        &mut self,
        index: u16,
        name: &'static str,
        elements: impl IntoIterator<Item = Entry>,
    ) {
        self.record(index, name, data_type::NONE, elements);
        if let Some(object) = self.objects.get_mut(&index) {
            object.code = ObjectCode::Array;
            object.data_type = object
                .entries
                .get(&1)
                .map_or(data_type::NONE, |first| first.data_type);
        }
    }

    /// Adds a record; subindex 0 is the number of its elements.
    pub(crate) fn record(
        &mut self,
        index: u16,
        name: &'static str,
        data_type: u16,
        elements: impl IntoIterator<Item = Entry>,
    ) {
        let mut entries: BTreeMap<u8, Entry> = (1..=u8::MAX).zip(elements).collect();
        let count = entries.keys().next_back().copied().unwrap_or(0);
        entries.insert(0, Entry::u8(count).named("Number of entries"));
        let object = Object {
            code: ObjectCode::Record,
            data_type,
            name: name.into(),
            entries,
        };
        self.objects.insert(index, object);
    }

    /// Adds an object that only keeps what is written to it. Of one that is there already the subindices get the
    /// values at power-up and the access that are given, and the missing ones are added.
    pub(crate) fn plain(&mut self, plain: &PlainObject) {
        let entries = plain.entries.iter().map(|entry| {
            let mut value = entry.default.clone().unwrap_or_default();
            if !entry.varies {
                value.resize(entry.bytes, 0);
            }
            let bit = |is: bool, bit: u16| if is { bit } else { 0 };
            let mut stored = Entry::new(entry.data_type, &value).named(entry.name.clone());
            stored.access = bit(entry.readable, access::READ)
                | bit(entry.writable, access::WRITE)
                | bit(entry.outputs, access::RX)
                | bit(entry.inputs, access::TX);
            stored.lengths = if entry.varies {
                (0, entry.bytes)
            } else {
                (entry.bytes, entry.bytes)
            };
            (entry.subindex, stored)
        });
        let entries: BTreeMap<u8, Entry> = entries.collect();
        let first = entries.get(&u8::from(plain.is_array));
        let has_elements = entries.keys().any(|subindex| *subindex > 0);
        let object = Object {
            code: match (has_elements, plain.is_array) {
                (false, _) => ObjectCode::Var,
                (true, true) => ObjectCode::Array,
                (true, false) => ObjectCode::Record,
            },
            data_type: first
                .filter(|_| !has_elements || plain.is_array)
                .map_or(data_type::NONE, |entry| entry.data_type),
            name: plain.name.clone().into(),
            entries,
        };
        match self.objects.entry(plain.index) {
            MapEntry::Vacant(vacant) => {
                vacant.insert(object);
            }
            MapEntry::Occupied(mut there) => {
                let there = &mut there.get_mut().entries;
                for (subindex, mut entry) in object.entries {
                    if let Some(own) = there.get(&subindex) {
                        entry.choices = own.choices;
                        let mut given = plain.entries.iter();
                        if !given.any(|given| given.subindex == subindex && given.default.is_some())
                        {
                            entry.value.clone_from(&own.value);
                            entry.default.clone_from(&own.default);
                            entry.lengths.1 = entry.lengths.1.max(own.value.len());
                        }
                    }
                    there.insert(subindex, entry);
                }
            }
        }
    }

    /// The indices of all objects, ascending.
    pub(crate) fn indices(&self) -> impl Iterator<Item = u16> + '_ {
        self.objects.keys().copied()
    }

    /// What there is to say about an object.
    pub(crate) fn object(&self, index: u16) -> Result<ObjectInfo, Abort> {
        let object = self.objects.get(&index).ok_or(Abort::NoObject)?;
        Ok(ObjectInfo {
            data_type: object.data_type,
            last: object.entries.keys().next_back().copied().unwrap_or(0),
            code: object.code,
            name: object.name.clone(),
        })
    }

    /// What there is to say about a subindex.
    pub(crate) fn entry(&self, index: u16, subindex: u8) -> Result<EntryInfo, Abort> {
        let entry = self.find(index, subindex)?;
        let bits = u16::try_from(8 * entry.lengths.1.max(entry.value.len())).unwrap_or(u16::MAX);
        let mut info = EntryInfo::new(entry.data_type, bits, entry.access, entry.name.clone());
        info.default = entry.is_writable().then(|| entry.default.clone());
        Ok(info)
    }

    /// The bytes of an object.
    pub(crate) fn upload(&self, index: u16, subindex: u8) -> Result<Vec<u8>, Abort> {
        let entry = self.find(index, subindex)?;
        if entry.access & access::READ == 0 {
            return Err(Abort::WriteOnly);
        }
        Ok(entry.value.clone())
    }

    /// The most bytes that can be written to an object.
    pub(crate) fn room(&self, index: u16, subindex: u8) -> Result<usize, Abort> {
        let entry = self.find(index, subindex)?;
        if entry.is_writable() {
            Ok(entry.lengths.1)
        } else {
            Err(Abort::ReadOnly)
        }
    }

    /// Writes an object.
    pub(crate) fn download(&mut self, index: u16, subindex: u8, data: &[u8]) -> Result<(), Abort> {
        self.find(index, subindex)?.check(data)?;
        let object = self.objects.get_mut(&index);
        if let Some(entry) = object.and_then(|object| object.entries.get_mut(&subindex)) {
            data.clone_into(&mut entry.value);
        }
        Ok(())
    }

    fn find(&self, index: u16, subindex: u8) -> Result<&Entry, Abort> {
        let object = self.objects.get(&index).ok_or(Abort::NoObject)?;
        object.entries.get(&subindex).ok_or(Abort::NoSubindex)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dictionary() -> Dictionary {
        let mut dictionary = Dictionary::default();
        dictionary.array(0x1018, "Identity", [Entry::u8(3), Entry::u8(7)]);
        dictionary.variable(0x1008, "Name", Entry::text("a text"));
        dictionary.record(
            0x2000,
            "Settings",
            data_type::NONE,
            [
                Entry::u16(0).one_of(&[0, 2]),
                Entry::text("").up_to(3),
                Entry::u8(9).write_only(),
            ],
        );
        dictionary
    }

    #[test]
    fn an_index_and_a_subindex_that_are_missing_are_told_apart() {
        assert_eq!(dictionary().upload(0x2345, 0), Err(Abort::NoObject));
        assert_eq!(dictionary().upload(0x1018, 3), Err(Abort::NoSubindex));
    }

    #[test]
    fn a_fixed_object_refuses_a_write() {
        assert_eq!(dictionary().download(0x1018, 1, &[9]), Err(Abort::ReadOnly));
        assert_eq!(dictionary().room(0x1018, 1), Err(Abort::ReadOnly));
    }

    #[test]
    fn a_length_beyond_the_limits_or_a_value_beside_the_choice_is_refused() {
        let mut dictionary = dictionary();
        assert_eq!(dictionary.download(0x2000, 2, b"four"), Err(Abort::TooLong));
        assert_eq!(dictionary.download(0x2000, 1, &[2]), Err(Abort::TooShort));
        assert_eq!(dictionary.download(0x2000, 1, &[1, 0]), Err(Abort::Range));
        assert_eq!(dictionary.download(0x2000, 1, &[2, 0]), Ok(()));
        assert_eq!(dictionary.upload(0x2000, 1), Ok(vec![2, 0]));
        assert_eq!(dictionary.download(0x2000, 2, b"abc"), Ok(()));
        assert_eq!(dictionary.upload(0x2000, 2), Ok(b"abc".to_vec()));
    }

    #[test]
    fn an_object_that_can_only_be_written_refuses_the_read() {
        let mut dictionary = dictionary();
        assert_eq!(dictionary.download(0x2000, 3, &[1]), Ok(()));
        assert_eq!(dictionary.upload(0x2000, 3), Err(Abort::WriteOnly));
    }

    #[test]
    fn subindex_0_counts_the_elements() {
        assert_eq!(dictionary().upload(0x2000, 0), Ok(vec![3]));
        assert_eq!(dictionary().object(0x2000).unwrap().last, 3);
    }
}
