//! Values of objects whose type is known only at run time: from a file, or for one.

use std::fmt;
use std::str::FromStr;

use crate::coe::{AnyObject, ObjectAddress, TypeCode, obj};

macro_rules! values {
    ($($name:ident, $ty:ty, $text:literal;)+) => {
        /// The type of an [`ObjectValue`]; in files by the name with which it is shown.
        ///
        /// ```
        /// use servocrab::parameters::ValueType;
        /// assert_eq!("i16".parse(), Ok(ValueType::I16));
        /// assert_eq!(ValueType::F32.to_string(), "f32");
        /// ```
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[non_exhaustive]
        pub enum ValueType {
            $(#[doc = concat!("`", $text, "`.")] $name,)+
            /// `string`: text, one byte for each character of ASCII.
            Text,
            /// `bytes`: any others.
            Bytes,
        }

        /// A value of an object, with its type.
        ///
        /// ```
        /// use servocrab::parameters::{ObjectValue, ValueType};
        /// let value = ObjectValue::from(-2_i16);
        /// assert_eq!(value.encode(), [0xFE, 0xFF]);
        /// assert_eq!(ObjectValue::decode(ValueType::I16, &[0xFE, 0xFF]), value);
        /// assert_eq!(value.to_string(), "-2 (i16)");
        /// ```
        #[derive(Debug, Clone, PartialEq)]
        #[non_exhaustive]
        pub enum ObjectValue {
            $(#[doc = concat!("`", $text, "`, ", stringify!($ty), ".")] $name($ty),)+
            /// Text.
            Text(String),
            /// Bytes as the drive sends them.
            Bytes(Vec<u8>),
        }

        impl ObjectValue {
            /// The type.
            #[must_use]
            pub const fn value_type(&self) -> ValueType {
                match self {
                    $(Self::$name(_) => ValueType::$name,)+
                    Self::Text(_) => ValueType::Text,
                    Self::Bytes(_) => ValueType::Bytes,
                }
            }

            /// The bytes as they are written, little-endian.
            #[must_use]
            pub fn encode(&self) -> Vec<u8> {
                match self {
                    $(Self::$name(value) => value.to_le_bytes().to_vec(),)+
                    Self::Text(text) => text.as_bytes().to_vec(),
                    Self::Bytes(bytes) => bytes.clone(),
                }
            }

            /// The value in `bytes`; [`ObjectValue::Bytes`] if they are none of the type: of another number, or no text.
            #[must_use]
            pub fn decode(kind: ValueType, bytes: &[u8]) -> Self {
                let value = match kind {
                    $(ValueType::$name => bytes.try_into().ok().map(|bytes| Self::$name(<$ty>::from_le_bytes(bytes))),)+
                    ValueType::Text => text(bytes).map(Self::Text),
                    ValueType::Bytes => None,
                };
                value.unwrap_or_else(|| Self::Bytes(bytes.to_vec()))
            }
        }

        $(impl From<$ty> for ObjectValue {
            fn from(value: $ty) -> Self {
                Self::$name(value)
            }
        })+

        impl FromStr for ValueType {
            type Err = UnknownType;

            fn from_str(text: &str) -> Result<Self, UnknownType> {
                Ok(match text {
                    $($text => Self::$name,)+
                    "string" => Self::Text,
                    "bytes" => Self::Bytes,
                    _ => return Err(UnknownType(text.into())),
                })
            }
        }

        impl fmt::Display for ValueType {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(match self {
                    $(Self::$name => $text,)+
                    Self::Text => "string",
                    Self::Bytes => "bytes",
                })
            }
        }

        impl fmt::Display for ObjectValue {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self {
                    $(Self::$name(value) => write!(f, "{value} ({})", $text),)+
                    Self::Text(text) => write!(f, "{text:?}"),
                    Self::Bytes(bytes) => write!(f, "bytes {bytes:02X?}"),
                }
            }
        }
    };
}

values! {
    U8, u8, "u8";
    I8, i8, "i8";
    U16, u16, "u16";
    I16, i16, "i16";
    U32, u32, "u32";
    I32, i32, "i32";
    U64, u64, "u64";
    I64, i64, "i64";
    F32, f32, "f32";
}

/// A name that is no type's.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is no type: one of u8, i8, u16, i16, u32, i32, u64, i64, f32, string, bytes is expected"
)]
pub struct UnknownType(pub String);

impl From<&str> for ObjectValue {
    fn from(text: &str) -> Self {
        Self::Text(text.into())
    }
}

impl From<Vec<u8>> for ObjectValue {
    fn from(bytes: Vec<u8>) -> Self {
        Self::Bytes(bytes)
    }
}

impl ObjectValue {
    /// Whether a drive that was written this value, and reads `bytes`, holds it: byte for byte; a text may be filled up with
    /// zeros.
    #[must_use]
    pub fn is_held_by(&self, bytes: &[u8]) -> bool {
        let own = self.encode();
        match self {
            Self::Text(_) => without_padding(&own) == without_padding(bytes),
            _ => own == bytes,
        }
    }

    /// The type of an object that the library knows: of axes 1 to 4 by its address.
    #[must_use]
    pub fn known_type(address: ObjectAddress) -> Option<ValueType> {
        known(address).map(|object| TypeCode::from(object.data_type).into())
    }
}

/// The type in which a value of this type is kept; bytes for those that have no other here (CiA 301, data types).
///
/// ```
/// use servocrab::{coe::TypeCode, parameters::ValueType};
/// assert_eq!(ValueType::from(TypeCode(4)), ValueType::I32);
/// ```
impl From<TypeCode> for ValueType {
    fn from(code: TypeCode) -> Self {
        match code.0 {
            0x0002 => Self::I8,
            0x0003 => Self::I16,
            0x0004 => Self::I32,
            0x0005 => Self::U8,
            0x0006 => Self::U16,
            0x0007 => Self::U32,
            0x0008 => Self::F32,
            0x0009 => Self::Text,
            0x0015 => Self::I64,
            0x001B => Self::U64,
            _ => Self::Bytes,
        }
    }
}

/// The text in `bytes`, if it can be shown and comes out of a file as it was.
fn text(bytes: &[u8]) -> Option<String> {
    let text = std::str::from_utf8(without_padding(bytes)).ok()?;
    (!text.chars().any(char::is_control)).then(|| text.into())
}

fn without_padding(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|byte| *byte != 0);
    bytes.get(..end.map_or(0, |end| end + 1)).unwrap_or(bytes)
}

/// The object that the library knows at this address, or that it knows of a first axis and that is here of axis 2 to 4.
fn known(address: ObjectAddress) -> Option<AnyObject> {
    let all = obj::all();
    let find = |index| {
        all.iter()
            .find(|object| object.index == index && object.subindex == address.subindex)
            .copied()
    };
    match address.index {
        // Axes 2 to 4, 800h apart (CiA 402). Those of the next are where a terminal has its settings (ETG.5001).
        0x6800..=0x7FFF => find(0x6000 + (address.index - 0x6000) % 0x0800),
        index => find(index),
    }
}

/// The library's name of an object.
pub(super) fn known_name(address: ObjectAddress) -> Option<&'static str> {
    known(address).map(|object| object.name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn objects_of_further_axes_have_the_types_of_the_first() {
        let of = |index, subindex| ObjectValue::known_type(ObjectAddress::new(index, subindex));
        assert_eq!(of(0x6068, 0), Some(ValueType::U16));
        assert_eq!(of(0x6868, 0), Some(ValueType::U16));
        assert_eq!(of(0x687B, 2), Some(ValueType::I32));
        assert_eq!(of(0x687B, 3), None);
        assert_eq!(of(0x2011, 0), None);
    }

    /// ETG.5001: settings of a terminal. 8091h:01 would be the gear ratio of a fifth axis.
    #[test]
    fn a_setting_of_a_terminal_has_no_name_and_no_type_of_an_object_of_an_axis() {
        let setting = ObjectAddress::new(0x8091, 1);
        assert_eq!(
            (known_name(setting), ObjectValue::known_type(setting)),
            (None, None)
        );
    }

    #[test]
    fn bytes_that_are_no_value_of_the_type_stay_bytes() {
        assert_eq!(
            ObjectValue::decode(ValueType::U32, &[1]),
            ObjectValue::Bytes(vec![1])
        );
        assert_eq!(
            ObjectValue::decode(ValueType::Text, b"a\nb"),
            ObjectValue::Bytes(b"a\nb".to_vec())
        );
        assert_eq!(ObjectValue::decode(ValueType::Text, b"ab\0\0"), "ab".into());
    }

    proptest! {
        #[test]
        fn whatever_a_drive_sends_is_held_by_its_value(bytes: Vec<u8>, kind in 0_usize..11) {
            let kind = ["u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "f32", "string", "bytes"][kind];
            let value = ObjectValue::decode(kind.parse().unwrap(), &bytes);
            prop_assert!(value.is_held_by(&bytes));
        }
    }
}
