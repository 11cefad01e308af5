//! The types that values of objects have, and how objects may be reached, as types of the language.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use core::fmt;
use core::str::FromStr;

/// The type of an object's value at run time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum DataType {
    /// UNSIGNED8.
    U8,
    /// INTEGER8.
    I8,
    /// UNSIGNED16.
    U16,
    /// INTEGER16.
    I16,
    /// UNSIGNED32.
    U32,
    /// INTEGER32.
    I32,
    /// VISIBLE_STRING or any other sequence of bytes.
    Bytes,
}

impl DataType {
    /// The length in bits; 0 for bytes of varying number.
    #[must_use]
    pub const fn bits(self) -> u8 {
        match self {
            Self::U8 | Self::I8 => 8,
            Self::U16 | Self::I16 => 16,
            Self::U32 | Self::I32 => 32,
            Self::Bytes => 0,
        }
    }
}

mod sealed {
    pub trait SealedValue {}
}

/// How an object may be reached: [`ReadOnly`], [`WriteOnly`] or [`ReadWrite`].
pub trait Access: sealed::SealedValue {
    /// Whether the value can be read.
    const READABLE: bool;
    /// Whether the value can be written.
    const WRITABLE: bool;
}

/// Access that allows reading.
pub trait Readable: Access {}

/// Access that allows writing.
pub trait Writable: Access {}

macro_rules! access {
    ($(#[$doc:meta] $name:ident, $readable:literal, $writable:literal, [$($also:ident),+];)+) => {$(
        #[$doc]
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $name {}
        impl sealed::SealedValue for $name {}
        impl Access for $name {
            const READABLE: bool = $readable;
            const WRITABLE: bool = $writable;
        }
        $(impl $also for $name {})+
    )+};
}

access! {
    /// The value can be read, not written.
    ReadOnly, true, false, [Readable];
    /// The value can be written, not read.
    WriteOnly, false, true, [Writable];
    /// The value can be read and written.
    ReadWrite, true, true, [Readable, Writable];
}

/// A type that an object's value can have.
pub trait Value: Sized + sealed::SealedValue {
    /// The type at run time.
    const DATA_TYPE: DataType;

    /// The value in `bytes`, or `None` if their number is not the type's.
    fn decode(bytes: &[u8]) -> Option<Self>;

    /// The value's bytes, little-endian.
    fn encode(&self) -> Vec<u8>;
}

/// A value of fixed width, which can be mapped into a PDO.
pub trait Number: Value + Copy {
    /// The length in bits: 8, 16 or 32.
    const BITS: u8;

    /// The value's lowest bits, without the sign's extension.
    fn to_raw(self) -> u32;

    /// The value in the lowest [`Number::BITS`] of `raw`; bits above them are ignored.
    fn from_raw(raw: u32) -> Self;
}

macro_rules! numbers {
    ($($ty:ident, $unsigned:ident, $data_type:ident;)+) => {$(
        impl sealed::SealedValue for $ty {}
        impl Value for $ty {
            const DATA_TYPE: DataType = DataType::$data_type;
            fn decode(bytes: &[u8]) -> Option<Self> {
                Some(Self::from_le_bytes(bytes.try_into().ok()?))
            }
            fn encode(&self) -> Vec<u8> {
                self.to_le_bytes().to_vec()
            }
        }
        impl Number for $ty {
            const BITS: u8 = Self::DATA_TYPE.bits();
            fn to_raw(self) -> u32 {
                u32::from(self as $unsigned)
            }
            fn from_raw(raw: u32) -> Self {
                raw as $unsigned as Self
            }
        }
    )+};
}

numbers! {
    u8, u8, U8;
    i8, u8, I8;
    u16, u16, U16;
    i16, u16, I16;
    u32, u32, U32;
    i32, u32, I32;
}

impl sealed::SealedValue for Vec<u8> {}

/// A string or any other sequence of bytes, as the drive sends it.
impl Value for Vec<u8> {
    const DATA_TYPE: DataType = DataType::Bytes;

    fn decode(bytes: &[u8]) -> Option<Self> {
        Some(bytes.to_vec())
    }

    fn encode(&self) -> Vec<u8> {
        self.clone()
    }
}

// Data types by their numbers in an object dictionary, and values of them as text (CiA 301, data types; ETG.1020).

/// The number of a data type.
///
/// ```
/// use servocrab::coe::TypeCode;
/// assert_eq!(TypeCode(4).to_string(), "INTEGER32");
/// assert_eq!(TypeCode(4).show(&[0xFE, 0xFF, 0xFF, 0xFF]), "-2");
/// assert_eq!(TypeCode(4).parse("-2", 32), Ok(vec![0xFE, 0xFF, 0xFF, 0xFF]));
/// assert_eq!(TypeCode(6).parse("0x1F", 16), Ok(vec![0x1F, 0x00]));
/// assert_eq!(TypeCode(6).parse("1Fh", 16), Ok(vec![0x1F, 0x00]));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TypeCode(pub u16);

/// How a value is to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    Boolean,
    /// Of this many bytes.
    Signed(usize),
    Unsigned(usize),
    Real32,
    Real64,
    Text,
    Bytes,
}

/// A text that is no value of the type.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no {expected}")]
pub struct ValueError {
    /// What was given.
    pub text: String,
    /// What is expected.
    pub expected: String,
}

impl TypeCode {
    /// The name in the standard's words; none for a type of the device's own.
    #[must_use]
    pub const fn name(self) -> Option<&'static str> {
        Some(match self.0 {
            0x0001 => "BOOLEAN",
            0x0002 => "INTEGER8",
            0x0003 => "INTEGER16",
            0x0004 => "INTEGER32",
            0x0005 => "UNSIGNED8",
            0x0006 => "UNSIGNED16",
            0x0007 => "UNSIGNED32",
            0x0008 => "REAL32",
            0x0009 => "VISIBLE_STRING",
            0x000A => "OCTET_STRING",
            0x000B => "UNICODE_STRING",
            0x000C => "TIME_OF_DAY",
            0x000D => "TIME_DIFFERENCE",
            0x000F => "DOMAIN",
            0x0010 => "INTEGER24",
            0x0011 => "REAL64",
            0x0012 => "INTEGER40",
            0x0013 => "INTEGER48",
            0x0014 => "INTEGER56",
            0x0015 => "INTEGER64",
            0x0016 => "UNSIGNED24",
            0x0018 => "UNSIGNED40",
            0x0019 => "UNSIGNED48",
            0x001A => "UNSIGNED56",
            0x001B => "UNSIGNED64",
            0x0021 => "PDO_MAPPING",
            0x0023 => "IDENTITY",
            _ => return None,
        })
    }

    const fn form(self) -> Form {
        match self.0 {
            0x0001 => Form::Boolean,
            0x0002 => Form::Signed(1),
            0x0003 => Form::Signed(2),
            0x0004 => Form::Signed(4),
            0x0005 => Form::Unsigned(1),
            0x0006 => Form::Unsigned(2),
            0x0007 => Form::Unsigned(4),
            0x0008 => Form::Real32,
            0x0009 => Form::Text,
            0x0010 => Form::Signed(3),
            0x0011 => Form::Real64,
            0x0012 => Form::Signed(5),
            0x0013 => Form::Signed(6),
            0x0014 => Form::Signed(7),
            0x0015 => Form::Signed(8),
            0x0016 => Form::Unsigned(3),
            0x0018 => Form::Unsigned(5),
            0x0019 => Form::Unsigned(6),
            0x001A => Form::Unsigned(7),
            0x001B => Form::Unsigned(8),
            _ => Form::Bytes,
        }
    }

    /// The value in `bytes` as text: a number, the text itself, or the bytes in hexadecimal where they are no value of
    /// the type.
    #[must_use]
    pub fn show(self, bytes: &[u8]) -> String {
        let hexadecimal = || {
            let bytes: Vec<_> = bytes.iter().map(|byte| format!("{byte:02X}")).collect();
            bytes.join(" ")
        };
        match self.form() {
            Form::Boolean => match bytes {
                [0] => "false".into(),
                [1] => "true".into(),
                _ => hexadecimal(),
            },
            Form::Signed(width) if bytes.len() == width => {
                let unused = 64 - 8 * width as u32;
                ((raw(bytes) << unused) as i64 >> unused).to_string()
            }
            Form::Unsigned(width) if bytes.len() == width => raw(bytes).to_string(),
            Form::Real32 => bytes
                .try_into()
                .map_or_else(|_| hexadecimal(), |b| f32::from_le_bytes(b).to_string()),
            Form::Real64 => bytes
                .try_into()
                .map_or_else(|_| hexadecimal(), |b| f64::from_le_bytes(b).to_string()),
            Form::Text => {
                let end = bytes.iter().rposition(|byte| *byte != 0);
                let text = bytes.get(..end.map_or(0, |end| end + 1)).unwrap_or(bytes);
                match core::str::from_utf8(text) {
                    Ok(text) if !text.chars().any(char::is_control) => text.into(),
                    _ => hexadecimal(),
                }
            }
            _ => hexadecimal(),
        }
    }

    /// The bytes of the value that `text` shows, for an entry of `bits` bits. `text` is a number (decimal, or hexadecimal as `0x2A` or `2Ah`), `true` or
    /// `false`, a text, or bytes in hexadecimal (`"0A FF"`) for every other type. Of 0 bits a text can have any length.
    ///
    /// # Errors
    /// [`ValueError`] if `text` is no such value, or does not fit.
    pub fn parse(self, text: &str, bits: u16) -> Result<Vec<u8>, ValueError> {
        let wrong = |expected: &str| ValueError {
            text: text.into(),
            expected: expected.into(),
        };
        match self.form() {
            Form::Boolean => match text {
                "0" | "false" => Ok([0].into()),
                "1" | "true" => Ok([1].into()),
                _ => Err(wrong("BOOLEAN (true or false)")),
            },
            Form::Signed(width) => {
                let half = 1i128 << (8 * width - 1);
                self.number(text, -half, half - 1, width)
            }
            Form::Unsigned(width) => self.number(text, 0, (1i128 << (8 * width)) - 1, width),
            Form::Real32 => f32::from_str(text)
                .map(|value| value.to_le_bytes().to_vec())
                .map_err(|_| wrong("REAL32")),
            Form::Real64 => f64::from_str(text)
                .map(|value| value.to_le_bytes().to_vec())
                .map_err(|_| wrong("REAL64")),
            Form::Text => {
                let most = usize::from(bits / 8);
                if bits != 0 && text.len() > most {
                    return Err(wrong(&format!("text of at most {most} bytes")));
                }
                Ok(text.as_bytes().to_vec())
            }
            Form::Bytes => text
                .split_ascii_whitespace()
                .map(|byte| u8::from_str_radix(byte, 16))
                .collect::<Result<_, _>>()
                .map_err(|_| wrong("sequence of bytes in hexadecimal")),
        }
    }

    fn number(
        self,
        text: &str,
        lowest: i128,
        highest: i128,
        width: usize,
    ) -> Result<Vec<u8>, ValueError> {
        let (sign, digits) = text.strip_prefix('-').map_or((1, text), |rest| (-1, rest));
        let hexadecimal = digits
            .strip_prefix("0x")
            .or_else(|| digits.strip_prefix("0X"))
            .or_else(|| digits.strip_suffix(['h', 'H']));
        let value = match hexadecimal {
            Some(digits) => u64::from_str_radix(digits, 16),
            None => digits.parse(),
        };
        match value.map(|value| sign * i128::from(value)) {
            Ok(value) if (lowest..=highest).contains(&value) => {
                Ok(value.to_le_bytes().into_iter().take(width).collect())
            }
            _ => Err(ValueError {
                text: text.into(),
                expected: format!("{self} ({lowest} to {highest})"),
            }),
        }
    }
}

impl From<DataType> for TypeCode {
    fn from(data_type: DataType) -> Self {
        Self(match data_type {
            DataType::I8 => 2,
            DataType::I16 => 3,
            DataType::I32 => 4,
            DataType::U8 => 5,
            DataType::U16 => 6,
            DataType::U32 => 7,
            DataType::Bytes => 9,
        })
    }
}

impl fmt::Display for TypeCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.name() {
            Some(name) => f.write_str(name),
            None => write!(f, "type {:04X}h", self.0),
        }
    }
}

/// Up to eight bytes as a number.
fn raw(bytes: &[u8]) -> u64 {
    bytes
        .iter()
        .rev()
        .fold(0, |value, byte| value << 8 | u64::from(*byte))
}

/// The widest column of a table: formatting takes no width above 16 bits, and a text may have megabytes.
const WIDEST_COLUMN: usize = 200;

/// How wide a column is that shows these texts: as its longest cell, in characters, and at most 200. A longer cell goes beyond it.
pub(crate) fn column_width<'a>(cells: impl Iterator<Item = &'a String>) -> usize {
    let longest = cells.map(|cell| cell.chars().count()).max();
    longest.unwrap_or(0).min(WIDEST_COLUMN)
}

#[cfg(test)]
mod tests {
    use alloc::vec;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_column_is_as_wide_as_its_longest_cell_and_no_wider_than_formatting_takes() {
        for (lengths, expected) in [
            (&[][..], 0),
            (&[3, 200, 0], 200),
            (&[3, 201], 200),
            (&[70_000, 3], 200),
        ] {
            let cells: Vec<_> = lengths.iter().map(|length| "ä".repeat(*length)).collect();
            assert_eq!(column_width(cells.iter()), expected, "{lengths:?}");
        }
    }

    #[test]
    fn a_value_of_the_wrong_width_is_refused() {
        assert_eq!(u16::decode(&[1, 2]), Some(0x0201));
        assert_eq!(u16::decode(&[1, 2, 3]), None);
        assert_eq!(i32::decode(&[0xFE, 0xFF, 0xFF, 0xFF]), Some(-2));
        assert_eq!(i8::decode(&[]), None);
    }

    #[test]
    fn a_negative_number_keeps_its_sign_through_its_raw_bits() {
        assert_eq!((-1i8).to_raw(), 0xFF);
        assert_eq!(i8::from_raw(0xFFFF_FFFF), -1);
        assert_eq!(i16::from_raw((-300i16).to_raw()), -300);
    }

    #[test]
    fn values_are_shown_as_what_they_are() {
        for (code, bytes, text) in [
            (1, &[1][..], "true"),
            (2, &[0x80], "-128"),
            (3, &[0xFE, 0xFF], "-2"),
            (6, &[0xFE, 0xFF], "65534"),
            (0x10, &[0xFF, 0xFF, 0xFF], "-1"),
            (0x15, &[0, 0, 0, 0, 0, 0, 0, 0x80], "-9223372036854775808"),
            (8, &[0, 0, 0xC0, 0x3F], "1.5"),
            (9, b"AKD2G\0\0", "AKD2G"),
            (9, b"\x01\x02", "01 02"),
            (7, &[1, 2], "01 02"),
            (0x21, &[1, 2], "01 02"),
            (9, b"", ""),
        ] {
            assert_eq!(TypeCode(code).show(bytes), text, "type {code}");
        }
    }

    #[test]
    fn a_value_that_does_not_fit_is_refused_and_not_cut() {
        assert_eq!(TypeCode(2).parse("-128", 8), Ok(vec![0x80]));
        let error = TypeCode(2).parse("128", 8).unwrap_err();
        assert_eq!(error.to_string(), "`128` is no INTEGER8 (-128 to 127)");
        for (code, text) in [
            (5, "256"),
            (5, "-1"),
            (5, ""),
            (5, "+"),
            (4, "--1"),
            (7, "0x1_0"),
            (0x1B, "18446744073709551616"),
            (1, "yes"),
            (9, "longer than four"),
            (0x21, "1G"),
            (8, "one"),
        ] {
            assert!(TypeCode(code).parse(text, 32).is_err(), "{code}: {text}");
        }
    }

    #[test]
    fn a_text_has_room_where_its_length_is_known_and_else_any_length() {
        assert!(TypeCode(9).parse("abc", 16).is_err());
        assert_eq!(TypeCode(9).parse("abc", 24), Ok(b"abc".to_vec()));
        assert_eq!(TypeCode(9).parse("abc", 0), Ok(b"abc".to_vec()));
    }

    proptest! {
        #[test]
        fn every_shown_number_is_read_back(code in prop::sample::select(vec![2u16, 3, 4, 5, 6, 7, 0x10, 0x14, 0x15, 0x16, 0x1B]), bytes: [u8; 8]) {
            let (Form::Signed(width) | Form::Unsigned(width)) = TypeCode(code).form() else { panic!("no number") };
            let bytes = &bytes[..width];
            let text = TypeCode(code).show(bytes);
            prop_assert_eq!(TypeCode(code).parse(&text, 8 * width as u16).unwrap(), bytes);
        }

        #[test]
        fn nothing_makes_them_panic(code: u16, bytes: Vec<u8>, text: String, bits: u16) {
            let _ = (TypeCode(code).show(&bytes), TypeCode(code).parse(&text, bits));
            let _ = TypeCode(code % 0x30).parse(&text, bits);
        }
    }
}
