//! Emergency messages and the error register (1001h) that goes with an error code.

/// An emergency message, as it goes into the mailbox.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Emergency {
    /// Error code as in 603Fh; 0000h announces that the error is gone.
    pub code: u16,
    /// Error register 1001h.
    pub register: u8,
    /// Manufacturer's data.
    pub data: [u8; 5],
}

/// Following error: the difference is too large (DSP 402 v2 table 2).
pub(super) const FOLLOWING_ERROR: u16 = 0x8611;
/// Reference limit: a target beyond the position limits (DSP 402 v2 table 2).
pub(super) const REFERENCE_LIMIT: u16 = 0x8612;
/// DC link under-voltage.
pub(super) const UNDER_VOLTAGE: u16 = 0x3220;
/// Lost communication, the node-guarding code of the communication group.
pub(super) const CONNECTION_LOST: u16 = 0x8130;

/// The bits of 1001h that belong to an error code: bit 0 with any error, the others by group.
pub(super) fn register_of(code: u16) -> u8 {
    let group = match code >> 8 {
        0x00 => return 0,
        0x20..=0x2F => 0b0000_0010,
        0x30..=0x3F => 0b0000_0100,
        0x40..=0x4F => 0b0000_1000,
        0x75 | 0x81 | 0x82 => 0b0001_0000,
        0x83..=0x87 => 0b0010_0000,
        0xFF => 0b1000_0000,
        _ => 0,
    };
    group | 1
}
