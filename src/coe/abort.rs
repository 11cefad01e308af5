//! SDO abort codes as number and words (ETG.1000.6, CiA 301).

use core::fmt;

/// The reason for which a device refused an SDO transfer; shown as words and number.
///
/// ```
/// use servocrab::coe::AbortCode;
/// assert_eq!(AbortCode(0x0602_0000).to_string(), "object does not exist (06020000h)");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct AbortCode(pub u32);

impl AbortCode {
    /// The toggle bit of a segment did not alternate.
    pub const TOGGLE: Self = Self(0x0503_0000);
    /// The protocol timed out.
    pub const TIME_OUT: Self = Self(0x0504_0000);
    /// The command is not valid or unknown.
    pub const COMMAND: Self = Self(0x0504_0001);
    /// The access is not supported.
    pub const UNSUPPORTED_ACCESS: Self = Self(0x0601_0000);
    /// The object cannot be written.
    pub const READ_ONLY: Self = Self(0x0601_0002);
    /// The entry cannot be written while subindex 0 is not zero.
    pub const SUBINDEX_0_NOT_ZERO: Self = Self(0x0601_0003);
    /// There is no such object.
    pub const NO_OBJECT: Self = Self(0x0602_0000);
    /// The object cannot be mapped into a PDO.
    pub const NOT_MAPPABLE: Self = Self(0x0604_0041);
    /// The mapping is longer than the PDO may be.
    pub const MAPPING_TOO_LONG: Self = Self(0x0604_0042);
    /// The number of bytes is not that of the object's type.
    pub const LENGTH: Self = Self(0x0607_0010);
    /// There is no such subindex.
    pub const NO_SUBINDEX: Self = Self(0x0609_0011);
    /// Not in the present state.
    pub const PRESENT_STATE: Self = Self(0x0800_0022);

    /// The meaning as text; "unknown reason" for a code that the standards do not list.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self.0 {
            0x0503_0000 => "toggle bit did not alternate",
            0x0504_0000 => "SDO protocol timed out",
            0x0504_0001 => "command specifier unknown",
            0x0504_0005 => "out of memory",
            0x0601_0000 => "access to this object not supported",
            0x0601_0001 => "read of a write-only object",
            0x0601_0002 => "write of a read-only object",
            0x0601_0003 => "entry cannot be written while subindex 0 is not zero",
            0x0601_0004 => "complete access not supported",
            0x0601_0005 => "object is longer than the mailbox",
            0x0601_0006 => "object is mapped into an RxPDO, download blocked",
            0x0602_0000 => "object does not exist",
            0x0604_0041 => "object cannot be mapped into a PDO",
            0x0604_0042 => "mapped objects exceed the PDO's length",
            0x0604_0043 => "parameters are incompatible",
            0x0604_0047 => "internal incompatibility in the device",
            0x0606_0000 => "access failed because of a hardware error",
            0x0607_0010 => "length does not match the data type",
            0x0607_0012 => "length too high for the data type",
            0x0607_0013 => "length too low for the data type",
            0x0609_0011 => "subindex does not exist",
            0x0609_0030 => "value out of range",
            0x0609_0031 => "value too high",
            0x0609_0032 => "value too low",
            0x0609_0033 => "detected modules do not match the configured ones",
            0x0609_0036 => "maximum is less than minimum",
            0x060A_0023 => "resource not available",
            0x0800_0000 => "general error",
            0x0800_0020 => "data cannot be stored or transferred",
            0x0800_0021 => "data cannot be stored or transferred because of local control",
            0x0800_0022 => "data cannot be stored or transferred in the present state",
            0x0800_0023 => "object dictionary could not be generated",
            0x0800_0024 => "no data available",
            _ => "unknown reason",
        }
    }
}

impl fmt::Display for AbortCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({:08X}h)", self.text(), self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::string::ToString;

    #[test]
    fn an_abort_code_shows_words_and_number() {
        assert_eq!(
            AbortCode::PRESENT_STATE.to_string(),
            "data cannot be stored or transferred in the present state (08000022h)"
        );
    }

    #[test]
    fn an_unlisted_code_keeps_its_number() {
        assert_eq!(
            AbortCode(0x1234_5678).to_string(),
            "unknown reason (12345678h)"
        );
    }
}
