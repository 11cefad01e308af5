//! SDO abort codes, by the reasons for which a simulated drive uses them (ETG.1000.6).

/// Why an SDO transfer was not done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[repr(u32)]
pub enum Abort {
    /// A segment came with the toggle bit of the one before.
    #[error("toggle bit not alternated")]
    Toggle = 0x0503_0000,
    /// The command specifier is not known, or not expected now.
    #[error("unknown command specifier")]
    Command = 0x0504_0001,
    /// The object cannot be accessed this way.
    #[error("access is not supported")]
    Access = 0x0601_0000,
    /// The object cannot be read.
    #[error("read of a write-only object")]
    WriteOnly = 0x0601_0001,
    /// The object cannot be written.
    #[error("write of a read-only object")]
    ReadOnly = 0x0601_0002,
    /// Subindex 0 is not zero, so the list behind it is locked.
    #[error("subindex cannot be written while subindex 0 is not zero")]
    SubindexLocked = 0x0601_0003,
    /// The device, or the object, has no complete access.
    #[error("complete access is not supported")]
    CompleteAccess = 0x0601_0004,
    /// There is no such object.
    #[error("object does not exist")]
    NoObject = 0x0602_0000,
    /// The object cannot be mapped into this PDO.
    #[error("object cannot be mapped")]
    NotMappable = 0x0604_0041,
    /// More is mapped than the PDO or the sync manager can carry.
    #[error("mapping exceeds the length of the PDO")]
    MappingTooLong = 0x0604_0042,
    /// An entry that is switched on by subindex 0 was never written.
    #[error("parameters do not fit together")]
    Incompatible = 0x0604_0043,
    /// The length is not the object's.
    #[error("length does not match the type")]
    Length = 0x0607_0010,
    /// More bytes than the object takes.
    #[error("too many bytes")]
    TooLong = 0x0607_0012,
    /// Fewer bytes than the object takes or than were announced.
    #[error("too few bytes")]
    TooShort = 0x0607_0013,
    /// There is no such subindex.
    #[error("subindex does not exist")]
    NoSubindex = 0x0609_0011,
    /// The value is not one that the object takes.
    #[error("value out of range")]
    Range = 0x0609_0030,
    /// The value is above those that the object takes.
    #[error("value too high")]
    TooHigh = 0x0609_0031,
    /// The value is below those that the object takes.
    #[error("value too low")]
    TooLow = 0x0609_0032,
    /// The values are not saved: the signature is wrong.
    #[error("cannot be stored")]
    NotSaved = 0x0800_0020,
    /// The object cannot be written in this AL state.
    #[error("not possible in the present state")]
    State = 0x0800_0022,
    /// The object has no value now.
    #[error("no data available")]
    NoData = 0x0800_0024,
}

impl Abort {
    /// The number on the wire.
    #[must_use]
    pub fn code(self) -> u32 {
        self as u32
    }
}
