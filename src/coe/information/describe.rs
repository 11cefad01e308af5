//! Descriptions of objects and of their entries.

use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;

use super::cut;
use crate::coe::data_type::TypeCode;
use crate::coe::object::{Mappable, ObjectAddress};
use crate::coe::sdo::SdoFault;

const UNIT: u8 = 0x08;
const DEFAULT: u8 = 0x10;
const MINIMUM: u8 = 0x20;
const MAXIMUM: u8 = 0x40;

/// What an object is.
#[derive(Debug, Clone, PartialEq, Eq)]
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
    /// Reads the answer to [`Question::Object`](super::Question::Object).
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
    /// Reads the answer to [`Question::Entry`](super::Question::Entry).
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
    pub(in crate::coe) fn bytes(&self) -> usize {
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
    String::from_utf8_lossy(name).into_owned()
}
