//! The types that values of objects have, and how objects may be reached, as types of the language.

use alloc::vec::Vec;

/// The type of an object's value at run time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
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
    pub trait Sealed {}
}

/// How an object may be reached: [`ReadOnly`], [`WriteOnly`] or [`ReadWrite`].
pub trait Access: sealed::Sealed {
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
        impl sealed::Sealed for $name {}
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
pub trait Value: Sized + sealed::Sealed {
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
        impl sealed::Sealed for $ty {}
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

impl sealed::Sealed for Vec<u8> {}

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

#[cfg(test)]
mod tests {
    use super::*;

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
}
