//! Emergency messages, which a drive sends through its mailbox on its own account (ETG.1000.6, CiA 301).

use core::fmt;

use super::mailbox::CutMessage;
use crate::ds402::describe_error_code;

/// What a drive says in an emergency message.
///
/// ```
/// use servocrab::coe::Emergency;
/// let emergency = Emergency { code: 0x8611, register: 0x21, data: [0; 5] };
/// assert_eq!(emergency.to_string(), "emergency 8611h (following error), error register 21h, data 00 00 00 00 00");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Emergency {
    /// The error code, as in 603Fh; 0000h says that an error is gone.
    pub code: u16,
    /// The error register, as in 1001h.
    pub register: u8,
    /// Bytes of the manufacturer's meaning.
    pub data: [u8; 5],
}

impl Emergency {
    /// The message behind the CoE header.
    ///
    /// # Errors
    /// [`CutMessage`] if there are fewer than eight bytes.
    pub fn parse(bytes: &[u8]) -> Result<Self, CutMessage> {
        match *bytes {
            [c0, c1, register, d0, d1, d2, d3, d4, ..] => Ok(Self {
                code: u16::from_le_bytes([c0, c1]),
                register,
                data: [d0, d1, d2, d3, d4],
            }),
            _ => Err(CutMessage {
                needed: 8,
                got: bytes.len(),
            }),
        }
    }

    /// Whether the message says that an error is gone.
    #[must_use]
    pub const fn is_reset(&self) -> bool {
        self.code == 0
    }
}

impl fmt::Display for Emergency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "emergency {:04X}h ({}), error register {:02X}h, data",
            self.code,
            describe_error_code(self.code),
            self.register
        )?;
        self.data
            .iter()
            .try_for_each(|byte| write!(f, " {byte:02X}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_truncation_of_an_emergency_is_an_error() {
        let whole = [0x11, 0x86, 0x21, 1, 2, 3, 4, 5];
        for length in 0..whole.len() {
            assert_eq!(
                Emergency::parse(&whole[..length]),
                Err(CutMessage {
                    needed: 8,
                    got: length
                })
            );
        }
        let emergency = Emergency::parse(&whole);
        assert_eq!(
            emergency,
            Ok(Emergency {
                code: 0x8611,
                register: 0x21,
                data: [1, 2, 3, 4, 5]
            })
        );
    }
}
