//! Values as a TOML file has them, before their types are known.

use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, Error as _, SeqAccess, Visitor};

use super::value::{ObjectValue, ValueType};

/// A value as TOML has it.
#[derive(Debug)]
pub(super) enum RawValue {
    Integer(i128),
    Float(f64),
    Text(String),
    Bytes(Vec<u8>),
}

impl RawValue {
    /// The value of this type, or how it looks in the file.
    pub(super) fn of_type(self, kind: ValueType) -> Result<ObjectValue, String> {
        let value = match (kind, &self) {
            (ValueType::U8, Self::Integer(n)) => u8::try_from(*n).ok().map(Into::into),
            (ValueType::I8, Self::Integer(n)) => i8::try_from(*n).ok().map(Into::into),
            (ValueType::U16, Self::Integer(n)) => u16::try_from(*n).ok().map(Into::into),
            (ValueType::I16, Self::Integer(n)) => i16::try_from(*n).ok().map(Into::into),
            (ValueType::U32, Self::Integer(n)) => u32::try_from(*n).ok().map(Into::into),
            (ValueType::I32, Self::Integer(n)) => i32::try_from(*n).ok().map(Into::into),
            (ValueType::U64, Self::Integer(n)) => u64::try_from(*n).ok().map(Into::into),
            (ValueType::I64, Self::Integer(n)) => i64::try_from(*n).ok().map(Into::into),
            (ValueType::F32, Self::Integer(n)) => single(*n as f64),
            (ValueType::F32, Self::Float(n)) => single(*n),
            (ValueType::Text, Self::Text(text)) => Some(ObjectValue::Text(text.clone())),
            (ValueType::Bytes, Self::Bytes(bytes)) => Some(ObjectValue::Bytes(bytes.clone())),
            _ => None,
        };
        value.ok_or_else(|| match self {
            Self::Integer(n) => n.to_string(),
            Self::Float(n) => format!("{n:?}"),
            Self::Text(text) => format!("{text:?}"),
            Self::Bytes(_) => "a list of bytes".into(),
        })
    }
}

/// The nearest number of single precision, if there is one.
fn single(number: f64) -> Option<ObjectValue> {
    let near = number as f32;
    (near.is_finite() || !number.is_finite()).then_some(ObjectValue::F32(near))
}

impl<'de> Deserialize<'de> for RawValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(RawValueVisitor)
    }
}

struct RawValueVisitor;

impl<'de> Visitor<'de> for RawValueVisitor {
    type Value = RawValue;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, a string or a list of bytes")
    }

    fn visit_i64<E>(self, value: i64) -> Result<RawValue, E> {
        Ok(RawValue::Integer(value.into()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<RawValue, E> {
        Ok(RawValue::Integer(value.into()))
    }

    fn visit_i128<E>(self, value: i128) -> Result<RawValue, E> {
        Ok(RawValue::Integer(value))
    }

    fn visit_u128<E: serde::de::Error>(self, value: u128) -> Result<RawValue, E> {
        let value = i128::try_from(value);
        value
            .map(RawValue::Integer)
            .map_err(|_| E::custom("a number of more than 64 bits"))
    }

    fn visit_f64<E>(self, value: f64) -> Result<RawValue, E> {
        Ok(RawValue::Float(value))
    }

    fn visit_str<E>(self, value: &str) -> Result<RawValue, E> {
        Ok(RawValue::Text(value.into()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<RawValue, A::Error> {
        let mut bytes = Vec::new();
        while let Some(byte) = list.next_element::<i64>()? {
            bytes.push(
                u8::try_from(byte)
                    .map_err(|_| A::Error::custom(format!("{byte} is no byte (0 to 255)")))?,
            );
        }
        Ok(RawValue::Bytes(bytes))
    }
}
