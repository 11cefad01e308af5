//! What a dictionary tells about its objects: types, access, names, values that are allowed (ETG.1000.6).

use std::borrow::Cow;

/// Numbers of the data types.
pub(crate) mod data_type {
    pub(crate) const BOOLEAN: u16 = 0x0001;
    pub(crate) const I8: u16 = 0x0002;
    pub(crate) const I16: u16 = 0x0003;
    pub(crate) const I32: u16 = 0x0004;
    pub(crate) const U8: u16 = 0x0005;
    pub(crate) const U16: u16 = 0x0006;
    pub(crate) const U32: u16 = 0x0007;
    pub(crate) const VISIBLE_STRING: u16 = 0x0009;
    pub(crate) const OCTET_STRING: u16 = 0x000A;
    /// The record of a PDO mapping.
    pub(crate) const PDO_MAPPING: u16 = 0x0021;
    /// The record 1018h.
    pub(crate) const IDENTITY: u16 = 0x0023;
    /// The records 1C32h and 1C33h.
    pub(crate) const SYNC_PARAMETER: u16 = 0x0029;
    /// The record 10F1h, by SOEM's list of a real Leadshine EL7.
    pub(crate) const ERROR_SETTINGS: u16 = 0x002A;
    /// A record of no type that has a number.
    pub(crate) const NONE: u16 = 0x0000;
}

/// The bits of an entry's access word.
pub(crate) mod access {
    /// Readable in PREOP, SAFEOP and OP.
    pub(crate) const READ: u16 = 0x0007;
    /// Writable in PREOP.
    pub(crate) const WRITE_PREOP: u16 = 0x0008;
    /// Writable in PREOP, SAFEOP and OP.
    pub(crate) const WRITE: u16 = 0x0038;
    /// Can be mapped into an RxPDO.
    pub(crate) const RX: u16 = 0x0040;
    /// Can be mapped into a TxPDO.
    pub(crate) const TX: u16 = 0x0080;
    /// Kept by the device for a replacement.
    pub(crate) const BACKUP: u16 = 0x0100;
    /// Read by the MainDevice at start.
    pub(crate) const SETTINGS: u16 = 0x0200;
}

/// What kind of an object it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ObjectCode {
    /// One value, at subindex 0.
    Var = 7,
    /// A count at subindex 0 and elements of one type.
    Array = 8,
    /// A count at subindex 0 and elements of several types.
    Record = 9,
}

/// What there is to say about an object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ObjectInfo {
    pub(crate) data_type: u16,
    /// Highest subindex that can exist.
    pub(crate) last: u8,
    pub(crate) code: ObjectCode,
    pub(crate) name: Cow<'static, str>,
}

/// What there is to say about one subindex of an object.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct EntryInfo {
    pub(crate) data_type: u16,
    /// Length in bits; of a text, as long as it can be.
    pub(crate) bits: u16,
    pub(crate) access: u16,
    pub(crate) name: Cow<'static, str>,
    /// Unit as ETG.1004 codes it: prefix, numerator, denominator, each one byte, from the highest down.
    pub(crate) unit: Option<u32>,
    /// Value at power-up.
    pub(crate) default: Option<Vec<u8>>,
    /// Smallest and greatest value.
    pub(crate) range: Option<(Vec<u8>, Vec<u8>)>,
}

impl EntryInfo {
    /// An entry with neither unit, default nor range.
    pub(crate) fn new(
        data_type: u16,
        bits: u16,
        access: u16,
        name: impl Into<Cow<'static, str>>,
    ) -> Self {
        Self {
            data_type,
            bits,
            access,
            name: name.into(),
            unit: None,
            default: None,
            range: None,
        }
    }

    /// Subindex 0 of an array or a record.
    pub(crate) fn count(access: u16) -> Self {
        Self::new(data_type::U8, 8, access, "Number of entries")
    }

    pub(crate) fn is_readable(&self) -> bool {
        self.access & access::READ != 0
    }

    pub(crate) fn is_writable(&self) -> bool {
        self.access & access::WRITE != 0
    }

    /// Whole bytes that it takes.
    pub(crate) fn bytes(&self) -> usize {
        usize::from(self.bits).div_ceil(8)
    }
}
