//! SDO information: what a device says about its object dictionary, as a dialogue without I/O. The bytes are those behind the CoE
//! header of a message (ETG.1000.6, SDO information).
//!
//! One request is answered by one or several fragments. The caller sends [`Inquiry::append_request`], hands each SDO
//! information message to [`Inquiry::feed`] until that says [`TransferStep::Done`], and decodes [`Inquiry::into_data`].
//!
//! An inquiry holds at most four times the bytes that came (the doubling of a growing list, and its copy) beside the buffer that it
//! was given. It never holds more than an answer of [`LONGEST_INFORMATION`], or [`LONGEST_DESCRIPTION`] where one object is asked
//! for. What is decoded from an answer takes at most eight times its bytes. Each fragment says fewer to follow than the one before,
//! so that they end.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;

use super::error::AbortCode;
use super::mailbox::CutMessage;
use super::object::{Mappable, ObjectAddress};
use super::sdo::{SdoFault, TransferStep};
use super::value::TypeCode;

/// Operation, reserved byte, fragments left.
const HEADER: usize = 4;
/// Bit 7 of the operation: more fragments follow.
const INCOMPLETE: u8 = 0x80;
const ERROR: u8 = 7;
/// The longest answer that is taken: a list with its kind and every index there can be.
pub const LONGEST_INFORMATION: usize = 2 + 2 * 0x1_0000;
/// The longest description of an object or an entry that is taken: three values of the greatest width, and a name.
pub const LONGEST_DESCRIPTION: usize = 0x8000;

/// What is asked of a device's dictionary.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Question {
    /// How many objects each list has.
    Counts,
    /// The indices of the objects of a list.
    List(ListKind),
    /// What an object is.
    Object {
        /// Its index.
        index: u16,
    },
    /// What an entry of an object is.
    Entry {
        /// The object's index.
        index: u16,
        /// The entry's subindex.
        subindex: u8,
        /// What is wanted beside type, length and access: bit 3 unit, 4 default, 5 minimum, 6 maximum; bits 0 to 2 ask for
        /// what always comes.
        wanted: u8,
    },
}

impl Question {
    /// [`Question::Entry`]'s `wanted`: everything.
    pub const EVERYTHING: u8 = 0x7F;
    /// [`Question::Entry`]'s `wanted`: what every device can report.
    pub const BASICS: u8 = 0x07;

    const fn operation(self) -> u8 {
        match self {
            Self::Counts | Self::List(_) => 1,
            Self::Object { .. } => 3,
            Self::Entry { .. } => 5,
        }
    }

    /// The longest answer that is taken.
    const fn longest(self) -> usize {
        match self {
            Self::Counts | Self::List(_) => LONGEST_INFORMATION,
            Self::Object { .. } | Self::Entry { .. } => LONGEST_DESCRIPTION,
        }
    }

    /// The bytes of the answer that repeat the question, which come in its first fragment.
    fn names(self) -> ([u8; 3], usize) {
        match self {
            Self::Counts => ([0, 0, 0], 2),
            Self::List(kind) => ([kind as u8, 0, 0], 2),
            Self::Object { index } => {
                let [i0, i1] = index.to_le_bytes();
                ([i0, i1, 0], 2)
            }
            Self::Entry {
                index, subindex, ..
            } => {
                let [i0, i1] = index.to_le_bytes();
                ([i0, i1, subindex], 3)
            }
        }
    }
}

/// One question and its answer.
///
/// ```
/// use servocrab::coe::{information::{Inquiry, ObjectDescription, Question}, sdo::TransferStep};
///
/// let mut inquiry = Inquiry::new(Question::Object { index: 0x1000 });
/// let mut request = Vec::new();
/// inquiry.append_request(&mut request);
/// assert_eq!(request, [3, 0, 0, 0, 0x00, 0x10]);
/// let step = inquiry.feed(b"\x04\0\0\0\x00\x10\x07\x00\x00\x07Device type")?;
/// assert_eq!(step, TransferStep::Done);
/// let object = ObjectDescription::parse(&inquiry.into_data())?;
/// assert_eq!((object.index, object.name.as_str()), (0x1000, "Device type"));
/// # Ok::<(), servocrab::coe::sdo::SdoFault>(())
/// ```
#[derive(Debug, Clone)]
pub struct Inquiry {
    question: Question,
    data: Vec<u8>,
    /// Fragments that must still come; none before the first.
    left: Option<u16>,
}

impl Inquiry {
    /// The asking of `question`.
    #[must_use]
    pub const fn new(question: Question) -> Self {
        Self {
            question,
            data: Vec::new(),
            left: None,
        }
    }

    /// Puts the answer into `buffer`, in place of what it holds: nothing is allocated as long as it fits.
    #[must_use]
    pub fn with_buffer(mut self, mut buffer: Vec<u8>) -> Self {
        buffer.clear();
        self.data = buffer;
        self
    }

    /// Appends the request. It is sent once; further fragments come unasked.
    pub fn append_request(&self, request: &mut Vec<u8>) {
        request.extend_from_slice(&[self.question.operation(), 0, 0, 0]);
        let (names, length) = self.question.names();
        request.extend(names.iter().take(length));
        if let Question::Entry { wanted, .. } = self.question {
            request.push(wanted);
        }
    }

    /// Whether fragments have come, and more must.
    #[must_use]
    pub fn is_under_way(&self) -> bool {
        self.left.is_some_and(|left| left > 0)
    }

    /// Takes one SDO information message.
    ///
    /// # Errors
    /// [`SdoFault`]: the device refuses (`Aborted`), a fragment is missing or too many come (`Fragments`), the answer is
    /// longer than any can be (`Size`), or the message ends before its headers do (`Cut`). The inquiry is then over.
    pub fn feed(&mut self, message: &[u8]) -> Result<TransferStep, SdoFault> {
        let &[operation, _, l0, l1, ref data @ ..] = message else {
            return Err(cut(HEADER, message.len()));
        };
        let left = u16::from_le_bytes([l0, l1]);
        let incomplete = operation & INCOMPLETE != 0;
        match operation & !INCOMPLETE {
            ERROR => {
                let &[c0, c1, c2, c3, ..] = data else {
                    return Err(cut(HEADER + 4, message.len()));
                };
                let code = u32::from_le_bytes([c0, c1, c2, c3]);
                return Err(SdoFault::Aborted(AbortCode(code)));
            }
            operation if operation == self.question.operation() + 1 => {}
            _ => return Ok(TransferStep::Foreign),
        }
        match self.left {
            None => {
                let (names, length) = self.question.names();
                let Some(named) = data.get(..length) else {
                    return Err(cut(HEADER + length, message.len()));
                };
                if names.get(..length) != Some(named) {
                    return Ok(TransferStep::Foreign);
                }
            }
            Some(before) => {
                let expected = before.saturating_sub(1);
                if left != expected {
                    return Err(SdoFault::Fragments {
                        expected,
                        got: left,
                    });
                }
            }
        }
        // A device may leave bit 7 out; one that sets it with nothing left contradicts itself.
        if incomplete && left == 0 {
            return Err(SdoFault::Fragments {
                expected: 1,
                got: 0,
            });
        }
        let got = self.data.len() + data.len();
        let expected = self.question.longest();
        if got > expected {
            return Err(SdoFault::Size { expected, got });
        }
        self.left = Some(left);
        self.data.extend_from_slice(data);
        Ok(if left == 0 {
            TransferStep::Done
        } else {
            TransferStep::More
        })
    }

    /// How many bytes of the answer have come.
    #[must_use]
    pub const fn received(&self) -> usize {
        self.data.len()
    }

    /// The answer, complete once [`Inquiry::feed`] said [`TransferStep::Done`].
    #[must_use]
    pub fn into_data(self) -> Vec<u8> {
        self.data
    }
}

const fn cut(needed: usize, got: usize) -> SdoFault {
    SdoFault::Cut(CutMessage { needed, got })
}

// Descriptions of objects and of their entries.

const UNIT: u8 = 0x08;
const DEFAULT: u8 = 0x10;
const MINIMUM: u8 = 0x20;
const MAXIMUM: u8 = 0x40;

/// What an object is.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct ObjectDescription {
    /// Its index.
    pub index: u16,
    /// The type of its value, or of its elements; a record has a type of its own.
    pub data_type: TypeCode,
    /// The highest subindex that it can have.
    pub max_subindex: u8,
    /// What kind of an object it is.
    pub code: ObjectCode,
    /// Its name, as the device gives it.
    pub name: String,
}

impl ObjectDescription {
    /// The name of an entry of this object together with the object's, such as `Identity: Serial number`.
    #[must_use]
    pub fn name_with(&self, entry: &EntryDescription) -> String {
        let (whole, part) = (&self.name, &entry.name);
        match self.code {
            ObjectCode::Array | ObjectCode::Record if whole != part => format!("{whole}: {part}"),
            _ if part.is_empty() => whole.clone(),
            _ => part.clone(),
        }
    }

    /// Reads the answer to [`Question::Object`].
    ///
    /// # Errors
    /// [`SdoFault::Cut`] if it ends before the name.
    pub fn parse(answer: &[u8]) -> Result<Self, SdoFault> {
        let &[i0, i1, t0, t1, max_subindex, code, ref name @ ..] = answer else {
            return Err(cut(6, answer.len()));
        };
        Ok(Self {
            index: u16::from_le_bytes([i0, i1]),
            data_type: TypeCode(u16::from_le_bytes([t0, t1])),
            max_subindex,
            code: code.into(),
            name: text(name),
        })
    }
}

/// What kind of an object it is (CiA 301, object codes).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ObjectCode {
    /// A large amount of data, as a program's.
    Domain,
    /// One value, at subindex 0.
    Variable,
    /// Elements of one type, and their number at subindex 0.
    Array,
    /// Elements of several types, and their number at subindex 0.
    Record,
    /// A number that the standard does not list here, or that of a type's definition.
    Other(u8),
}

impl From<u8> for ObjectCode {
    fn from(code: u8) -> Self {
        match code {
            2 => Self::Domain,
            7 => Self::Variable,
            8 => Self::Array,
            9 => Self::Record,
            other => Self::Other(other),
        }
    }
}

impl fmt::Display for ObjectCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Domain => f.write_str("domain"),
            Self::Variable => f.write_str("variable"),
            Self::Array => f.write_str("array"),
            Self::Record => f.write_str("record"),
            Self::Other(code) => write!(f, "object code {code}"),
        }
    }
}

/// What an entry of an object is.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct EntryDescription {
    /// Index and subindex.
    pub address: ObjectAddress,
    /// The type of its value.
    pub data_type: TypeCode,
    /// The length of its value in bits; of a text the most that it can have.
    pub bits: u16,
    /// When it can be read, written and mapped.
    pub access: EntryAccess,
    /// Its unit as ETG.1004 codes it, where the device reports one.
    pub unit: Option<u32>,
    /// Its value's bytes at power-up, where the device reports them.
    pub default: Option<Vec<u8>>,
    /// Its lowest value's bytes, where the device reports them.
    pub minimum: Option<Vec<u8>>,
    /// Its highest value's bytes, where the device reports them.
    pub maximum: Option<Vec<u8>>,
    /// Its name, as the device gives it; often empty.
    pub name: String,
}

impl EntryDescription {
    /// Reads the answer to [`Question::Entry`].
    ///
    /// # Errors
    /// [`SdoFault::Cut`] if it ends before the values that it says to have.
    pub fn parse(answer: &[u8]) -> Result<Self, SdoFault> {
        let &[
            i0,
            i1,
            subindex,
            told,
            t0,
            t1,
            b0,
            b1,
            a0,
            a1,
            ref rest @ ..,
        ] = answer
        else {
            return Err(cut(10, answer.len()));
        };
        let bits = u16::from_le_bytes([b0, b1]);
        let width = usize::from(bits.div_ceil(8));
        let mut rest = rest;
        let mut value = |bit: u8, length: usize| -> Result<Option<Vec<u8>>, SdoFault> {
            if told & bit == 0 {
                return Ok(None);
            }
            let at = answer.len() - rest.len();
            let (value, behind) = rest
                .split_at_checked(length)
                .ok_or_else(|| cut(at + length, answer.len()))?;
            rest = behind;
            Ok(Some(value.to_vec()))
        };
        let unit = value(UNIT, 4)?;
        let (default, minimum, maximum) = (
            value(DEFAULT, width)?,
            value(MINIMUM, width)?,
            value(MAXIMUM, width)?,
        );
        Ok(Self {
            address: ObjectAddress::new(u16::from_le_bytes([i0, i1]), subindex),
            data_type: TypeCode(u16::from_le_bytes([t0, t1])),
            bits,
            access: EntryAccess(u16::from_le_bytes([a0, a1])),
            unit: unit
                .and_then(|unit| unit.try_into().ok())
                .map(u32::from_le_bytes),
            default,
            minimum,
            maximum,
            name: text(rest),
        })
    }

    /// The memory that it takes.
    #[cfg(feature = "std")]
    pub(super) fn bytes(&self) -> usize {
        let values = [&self.default, &self.minimum, &self.maximum];
        let values = values.into_iter().flatten().map(Vec::len).sum::<usize>();
        size_of::<Self>() + values + self.name.len()
    }
}

/// In which states an entry can be read and written, and where it can be mapped.
///
/// Bits 0 to 2: read in PREOP, SAFEOP, OP; 3 to 5: write in these; 6 RxPDO, 7 TxPDO, 8 backup, 9 settings. Shown as
/// `rw` with what is special: `ro`, `rw, written in PREOP only, RxPDO`.
///
/// ```
/// use servocrab::coe::information::EntryAccess;
/// assert_eq!(EntryAccess(0x003F).to_string(), "rw");
/// assert_eq!(EntryAccess(0x008F).to_string(), "rw, written in PREOP only, TxPDO");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct EntryAccess(pub u16);

impl EntryAccess {
    const PRE_OP: u16 = 1;
    const SAFE_OP: u16 = 2;
    const OP: u16 = 4;
    /// Write bits lie this far above those of reading.
    const WRITE: u16 = 3;

    const fn read(self) -> u16 {
        self.0 & 7
    }

    const fn write(self) -> u16 {
        self.0 >> Self::WRITE & 7
    }

    /// Whether it can be read in any state.
    #[must_use]
    pub const fn readable(self) -> bool {
        self.read() != 0
    }

    /// Whether it can be written in any state.
    #[must_use]
    pub const fn writable(self) -> bool {
        self.write() != 0
    }

    /// Whether it can be read in PREOP.
    #[must_use]
    pub const fn readable_in_pre_op(self) -> bool {
        self.read() & Self::PRE_OP != 0
    }

    /// Whether it can be read in SAFEOP.
    #[must_use]
    pub const fn readable_in_safe_op(self) -> bool {
        self.read() & Self::SAFE_OP != 0
    }

    /// Whether it can be read in OP.
    #[must_use]
    pub const fn readable_in_op(self) -> bool {
        self.read() & Self::OP != 0
    }

    /// Whether it can be written in PREOP.
    #[must_use]
    pub const fn writable_in_pre_op(self) -> bool {
        self.write() & Self::PRE_OP != 0
    }

    /// Whether it can be written in SAFEOP.
    #[must_use]
    pub const fn writable_in_safe_op(self) -> bool {
        self.write() & Self::SAFE_OP != 0
    }

    /// Whether it can be written in OP.
    #[must_use]
    pub const fn writable_in_op(self) -> bool {
        self.write() & Self::OP != 0
    }

    /// Into which PDOs it can be mapped.
    #[must_use]
    pub const fn mappable(self) -> Mappable {
        Mappable {
            outputs: self.0 & 0x40 != 0,
            inputs: self.0 & 0x80 != 0,
        }
    }

    /// Whether it must be kept when the device is replaced.
    #[must_use]
    pub const fn backup(self) -> bool {
        self.0 & 0x100 != 0
    }

    /// Whether it is written at start-up.
    #[must_use]
    pub const fn settings(self) -> bool {
        self.0 & 0x200 != 0
    }
}

impl fmt::Display for EntryAccess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match (self.readable(), self.writable()) {
            (true, false) => "ro",
            (true, true) => "rw",
            (false, true) => "wo",
            (false, false) => "no access",
        })?;
        for (verb, states) in [("read", self.read()), ("written", self.write())] {
            if states == 0 || states == 7 {
                continue;
            }
            write!(f, ", {verb} in ")?;
            let named = [
                (Self::PRE_OP, "PREOP"),
                (Self::SAFE_OP, "SAFEOP"),
                (Self::OP, "OP"),
            ];
            let mut between = "";
            for (_, name) in named.into_iter().filter(|(bit, _)| states & bit != 0) {
                write!(f, "{between}{name}")?;
                between = " and ";
            }
            f.write_str(" only")?;
        }
        let mapped = self.mappable();
        let extra = [
            (mapped.outputs, "RxPDO"),
            (mapped.inputs, "TxPDO"),
            (self.backup(), "backup"),
            (self.settings(), "settings"),
        ];
        extra
            .into_iter()
            .filter(|(is, _)| *is)
            .try_for_each(|(_, name)| write!(f, ", {name}"))
    }
}

/// A name up to its first zero: some devices pad it.
fn text(bytes: &[u8]) -> String {
    let name = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
    crate::sii::text_of_device(name)
}

// Lists of objects.

/// Which objects a list has (ETG.1000.6, list types).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum ListKind {
    /// All objects.
    All = 1,
    /// Those that can be mapped into an RxPDO (outputs).
    Outputs = 2,
    /// Those that can be mapped into a TxPDO (inputs).
    Inputs = 3,
    /// Those that must be kept when the device is replaced.
    Backup = 4,
    /// Those that are written at start-up.
    Settings = 5,
}

/// How many objects each list has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ObjectCounts {
    /// All objects.
    pub all: u16,
    /// Those of [`ListKind::Outputs`].
    pub outputs: u16,
    /// Those of [`ListKind::Inputs`].
    pub inputs: u16,
    /// Those of [`ListKind::Backup`].
    pub backup: u16,
    /// Those of [`ListKind::Settings`].
    pub settings: u16,
}

/// The indices in the answer to [`Question::List`], in the device's order.
///
/// # Errors
/// [`SdoFault::Cut`] if the answer does not end with a whole index.
pub fn object_list(answer: &[u8]) -> Result<Vec<u16>, SdoFault> {
    let (words, rest) = answer.as_chunks::<2>();
    if words.is_empty() || !rest.is_empty() {
        return Err(cut(2 * words.len() + 2, answer.len()));
    }
    // The first word is the kind of list.
    Ok(words
        .iter()
        .skip(1)
        .map(|word| u16::from_le_bytes(*word))
        .collect())
}

/// The answer to [`Question::Counts`].
///
/// # Errors
/// [`SdoFault::Cut`] if it has fewer than five counts.
pub fn object_counts(answer: &[u8]) -> Result<ObjectCounts, SdoFault> {
    let words = object_list(answer)?;
    let &[all, outputs, inputs, backup, settings, ..] = words.as_slice() else {
        return Err(cut(12, answer.len()));
    };
    Ok(ObjectCounts {
        all,
        outputs,
        inputs,
        backup,
        settings,
    })
}

// A device's object dictionary as it describes it itself, by SDO information.

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
#[non_exhaustive]
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

#[cfg(test)]
mod tests {
    use alloc::string::ToString;
    use alloc::vec;

    use proptest::prelude::*;

    use super::*;
    use crate::coe::object::{Mappable, ObjectAddress};
    use crate::coe::value::TypeCode;

    // Dialogues of SDO information. Bytes named SOEM are of a session of SOEM with a simulated drive made with KickCAT, from the
    // byte behind the CoE header on.

    const VENDOR: Question = Question::Entry {
        index: 0x1018,
        subindex: 1,
        wanted: Question::BASICS,
    };

    /// One fragment of an answer.
    fn fragment(operation: u8, left: u16, data: &[u8]) -> Vec<u8> {
        let more = if left > 0 { INCOMPLETE } else { 0 };
        let mut message = vec![operation | more, 0];
        message.extend(left.to_le_bytes());
        message.extend(data);
        message
    }

    fn list_of(words: &[u16]) -> Vec<u8> {
        words.iter().flat_map(|word| word.to_le_bytes()).collect()
    }

    #[test]
    fn questions_are_asked_as_soem_asks_them() {
        let request = |question| {
            let mut request = Vec::new();
            Inquiry::new(question).append_request(&mut request);
            request
        };
        assert_eq!(request(Question::List(ListKind::All)), [1, 0, 0, 0, 1, 0]);
        assert_eq!(
            request(Question::Object { index: 0x607D }),
            [3, 0, 0, 0, 0x7D, 0x60]
        );
        assert_eq!(request(VENDOR), [5, 0, 0, 0, 0x18, 0x10, 1, 7]);
        assert_eq!(request(Question::Counts), [1, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn descriptions_that_soem_read_are_understood() {
        let mut inquiry = Inquiry::new(Question::Object { index: 0x607D });
        let answer = b"\x04\0\0\0\x7D\x60\x05\x00\x02\x09Software position limit";
        assert_eq!(inquiry.feed(answer), Ok(TransferStep::Done));
        assert_eq!(
            ObjectDescription::parse(&inquiry.into_data()),
            Ok(ObjectDescription {
                index: 0x607D,
                data_type: TypeCode(5),
                max_subindex: 2,
                code: ObjectCode::Record,
                name: "Software position limit".into(),
            })
        );
        let mut inquiry = Inquiry::new(VENDOR);
        assert_eq!(
            inquiry.feed(b"\x06\0\0\0\x18\x10\x01\x00\x07\x00\x20\x00\x07\x00Vendor"),
            Ok(TransferStep::Done)
        );
        let entry = EntryDescription::parse(&inquiry.into_data()).unwrap();
        assert_eq!(entry.address, ObjectAddress::new(0x1018, 1));
        assert_eq!((entry.data_type, entry.bits), (TypeCode(7), 32));
        assert_eq!(entry.access, EntryAccess(7));
        assert_eq!((entry.name.as_str(), entry.default), ("Vendor", None));
    }

    #[test]
    fn unit_default_and_limits_stand_in_front_of_the_name_as_far_as_they_are_told() {
        // ETG.1000.6, entry description: value info 78h, an INTEGER16 with unit, -1, -2 and 3.
        let head = [0x81, 0x60, 0, 0x78, 3, 0, 16, 0, 0x7F, 0x01];
        let values = [0, 0, 0xB5, 0, 0xFF, 0xFF, 0xFE, 0xFF, 3, 0];
        let answer = [&head[..], &values, b"Name\0\0"].concat();
        let entry = EntryDescription::parse(&answer).unwrap();
        assert_eq!(entry.unit, Some(0x00B5_0000));
        assert_eq!(entry.default, Some(vec![0xFF, 0xFF]));
        assert_eq!(entry.minimum, Some(vec![0xFE, 0xFF]));
        assert_eq!(entry.maximum, Some(vec![3, 0]));
        assert_eq!(entry.name, "Name");
        assert_eq!(
            entry.access.mappable(),
            Mappable {
                outputs: true,
                inputs: false
            }
        );
        assert!(entry.access.backup() && !entry.access.settings());
        for length in 0..head.len() + values.len() {
            assert!(
                matches!(
                    EntryDescription::parse(&answer[..length]),
                    Err(SdoFault::Cut(_))
                ),
                "{length} bytes"
            );
        }
    }

    #[test]
    fn access_is_told_per_state() {
        // PREOP and SAFEOP readable, PREOP writable; a real EL7's 1600h:1 has 050Fh.
        let access = EntryAccess(0x050F);
        assert!(access.readable_in_op() && access.readable_in_safe_op());
        assert!(access.writable_in_pre_op());
        assert!(!access.writable_in_safe_op() && !access.writable_in_op());
        assert_eq!(access.to_string(), "rw, written in PREOP only, backup");
        assert_eq!(
            EntryAccess(0x0003).to_string(),
            "ro, read in PREOP and SAFEOP only"
        );
        assert_eq!(EntryAccess(0).to_string(), "no access");
    }

    #[test]
    fn a_list_is_put_together_from_its_fragments_wherever_they_are_cut() {
        let words: Vec<u16> = [1].into_iter().chain(0x6040..0x6060).collect();
        let whole = list_of(&words);
        for room in 2..whole.len() + 2 {
            let mut inquiry = Inquiry::new(Question::List(ListKind::All));
            let pieces: Vec<_> = whole.chunks(room).collect();
            for (at, piece) in pieces.iter().enumerate() {
                let left = (pieces.len() - at - 1) as u16;
                let due = if left == 0 {
                    TransferStep::Done
                } else {
                    TransferStep::More
                };
                assert_eq!(inquiry.feed(&fragment(2, left, piece)), Ok(due));
                assert_eq!(inquiry.is_under_way(), left > 0);
            }
            assert_eq!(object_list(&inquiry.into_data()).unwrap(), words[1..]);
        }
    }

    #[test]
    fn a_list_that_ends_within_an_index_is_cut() {
        assert!(matches!(object_list(&[1, 0, 0x40]), Err(SdoFault::Cut(_))));
        assert!(matches!(object_list(&[]), Err(SdoFault::Cut(_))));
        assert_eq!(object_list(&[1, 0]), Ok(vec![]));
        let counts = object_counts(&list_of(&[0, 300, 20, 30, 4, 5])).unwrap();
        assert_eq!((counts.all, counts.outputs, counts.inputs), (300, 20, 30));
        assert_eq!((counts.backup, counts.settings), (4, 5));
        assert!(object_counts(&list_of(&[0, 300, 20, 30, 4])).is_err());
    }

    #[test]
    fn a_missing_a_doubled_and_an_endless_fragment_are_errors() {
        let start = || {
            let mut inquiry = Inquiry::new(Question::List(ListKind::All));
            let first = inquiry.feed(&fragment(2, 3, &[1, 0, 0x40, 0x60]));
            assert_eq!(first, Ok(TransferStep::More));
            inquiry
        };
        for got in [0, 1, 3, 4, u16::MAX] {
            assert_eq!(
                start().feed(&fragment(2, got, &[0x41, 0x60])),
                Err(SdoFault::Fragments { expected: 2, got })
            );
        }
        // Bit 7 says that more follow, the number says none.
        let endless = [0x82, 0, 0, 0, 1, 0];
        assert!(matches!(
            Inquiry::new(Question::List(ListKind::All)).feed(&endless),
            Err(SdoFault::Fragments { .. })
        ));
        // A device that leaves bit 7 out is understood by the number.
        let mut bare = Inquiry::new(Question::List(ListKind::All));
        assert_eq!(bare.feed(&[2, 0, 1, 0, 1, 0]), Ok(TransferStep::More));
        assert_eq!(bare.feed(&[2, 0, 0, 0, 0x40, 0x60]), Ok(TransferStep::Done));
    }

    #[test]
    fn answers_to_other_questions_are_foreign() {
        let mut inquiry = Inquiry::new(VENDOR);
        for other in [
            &b"\x06\0\0\0\x18\x10\x02\x00\x07\x00\x20\x00\x07\x00"[..],
            b"\x06\0\0\0\x19\x10\x01\x00\x07\x00\x20\x00\x07\x00",
            b"\x04\0\0\0\x18\x10\x05\x00\x04\x09Identity",
            b"\x82\0\x01\0\x01\x00",
            b"\x05\0\0\0\x18\x10\x01\x07",
        ] {
            assert_eq!(
                inquiry.feed(other),
                Ok(TransferStep::Foreign),
                "{other:02X?}"
            );
        }
        let mut list = Inquiry::new(Question::List(ListKind::Inputs));
        assert_eq!(
            list.feed(&fragment(2, 0, &[1, 0])),
            Ok(TransferStep::Foreign)
        );
    }

    #[test]
    fn a_refusal_has_its_reason_at_every_place() {
        // ETG.1000.6, SDO information error: the abort code behind the header.
        let refusal = fragment(7, 0, &[0x11, 0, 9, 6]);
        let aborted = Err(SdoFault::Aborted(AbortCode::NO_SUBINDEX));
        assert_eq!(Inquiry::new(VENDOR).feed(&refusal), aborted);
        let mut list = Inquiry::new(Question::List(ListKind::All));
        assert_eq!(list.feed(&fragment(2, 1, &[1, 0])), Ok(TransferStep::More));
        assert_eq!(list.feed(&refusal), aborted);
        for length in 0..refusal.len() {
            assert!(matches!(
                Inquiry::new(VENDOR).feed(&refusal[..length]),
                Err(SdoFault::Cut(_))
            ));
        }
    }

    #[test]
    fn an_answer_longer_than_any_list_is_refused() {
        let mut inquiry = Inquiry::new(Question::List(ListKind::All));
        let mut left = u16::MAX;
        let mut taken = 0;
        let piece = [1, 0].repeat(700);
        loop {
            match inquiry.feed(&fragment(2, left, &piece)) {
                Ok(step) => assert_eq!(step, TransferStep::More),
                Err(fault) => break assert!(matches!(fault, SdoFault::Size { .. })),
            }
            taken += piece.len();
            left -= 1;
        }
        assert!(taken <= LONGEST_INFORMATION);
    }

    #[test]
    fn a_description_may_be_shorter_than_a_list() {
        for (question, operation, longest) in [
            (Question::List(ListKind::All), 2, LONGEST_INFORMATION),
            (VENDOR, 6, LONGEST_DESCRIPTION),
        ] {
            let mut inquiry = Inquiry::new(question);
            let (mut left, mut got) = (u16::MAX, 0);
            let fault = loop {
                let mut message = vec![operation | 0x80, 0];
                message.extend(left.to_le_bytes());
                let (names, length) = question.names();
                message.extend(names.iter().take(if left == u16::MAX { length } else { 0 }));
                message.resize(1000, b'x');
                got += message.len() - 4;
                match inquiry.feed(&message) {
                    Ok(step) => assert_eq!(step, TransferStep::More),
                    Err(fault) => break fault,
                }
                left -= 1;
            };
            let expected = longest;
            assert_eq!(fault, SdoFault::Size { expected, got });
            assert!(got - longest < 1000);
        }
    }

    proptest! {
        #[test]
        fn any_messages_are_decoded_without_panic_and_within_the_bound(
            messages in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..20),
            which in 0u8..4,
        ) {
            let question = match which {
                0 => Question::Counts,
                1 => Question::List(ListKind::All),
                2 => Question::Object { index: 0x1018 },
                _ => VENDOR,
            };
            let mut inquiry = Inquiry::new(question);
            let mut bytes = 0;
            for message in messages {
                bytes += message.len();
                let _ = inquiry.feed(&message);
            }
            let answer = inquiry.into_data();
            prop_assert!(answer.len() <= bytes.min(LONGEST_INFORMATION));
        }

        #[test]
        fn any_answer_is_decoded_without_panic_and_to_no_more_than_it_has(answer in prop::collection::vec(any::<u8>(), 0..200)) {
            if let Ok(object) = ObjectDescription::parse(&answer) {
                // A byte that is no text becomes a replacement character of three.
                prop_assert!(object.name.len() <= 3 * answer.len());
            }
            if let Ok(entry) = EntryDescription::parse(&answer) {
                let values = [&entry.default, &entry.minimum, &entry.maximum];
                let held: usize = values.into_iter().flatten().map(Vec::len).sum();
                prop_assert!(held <= answer.len());
            }
            if let Ok(list) = object_list(&answer) {
                prop_assert!(2 * list.len() <= answer.len());
            }
            let _ = object_counts(&answer);
        }
    }
}
