//! Emergency messages, which a drive sends through its mailbox on its own account (ETG.1000.6, CiA 301).

use core::fmt;

use super::mailbox::CutMail;

/// What a drive says in an emergency message.
///
/// ```
/// use servocrab::coe::Emergency;
/// let emergency = Emergency { code: 0x8611, register: 0x21, data: [0; 5] };
/// assert_eq!(emergency.to_string(), "emergency 8611h (monitoring and control), error register 21h, data 00 00 00 00 00");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
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
    /// [`CutMail`] if there are fewer than eight bytes.
    pub fn parse(bytes: &[u8]) -> Result<Self, CutMail> {
        match *bytes {
            [c0, c1, register, d0, d1, d2, d3, d4, ..] => Ok(Self {
                code: u16::from_le_bytes([c0, c1]),
                register,
                data: [d0, d1, d2, d3, d4],
            }),
            _ => Err(CutMail {
                needed: 8,
                got: bytes.len(),
            }),
        }
    }

    /// The kind of error in words, by the code's group (CiA 402, table of error codes).
    #[must_use]
    pub const fn group(&self) -> &'static str {
        match self.code {
            0x0000..=0x00FF => "error reset or no error",
            0xA000 => "transition from PREOP to SAFEOP not successful",
            0xA001 => "transition from SAFEOP to OP not successful",
            0xFF00..=0xFFFF => "manufacturer's own",
            code => match code >> 8 {
                0x10..=0x1F => "generic error",
                0x21 => "current on the device's input side",
                0x22 => "current inside the device",
                0x23 => "current on the device's output side",
                0x20 | 0x24..=0x2F => "current",
                0x31 => "mains voltage",
                0x32 => "DC link voltage",
                0x30 | 0x33..=0x3F => "voltage",
                0x40..=0x4F => "temperature",
                0x50..=0x5F => "device hardware",
                0x60..=0x6F => "device software",
                0x71 => "motor or brake",
                0x73 => "sensor",
                0x75 => "communication inside the device",
                0x70..=0x7F => "additional modules",
                0x81 | 0x82 => "communication or protocol",
                0x80..=0x8F => "monitoring and control",
                0x90..=0x9F => "external error",
                0xF0..=0xFF => "additional functions",
                _ => "unknown group",
            },
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
            self.group(),
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
                Err(CutMail {
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

    #[test]
    fn codes_are_named_by_their_group() {
        let group = |code| {
            Emergency {
                code,
                register: 0,
                data: [0; 5],
            }
            .group()
        };
        assert_eq!(group(0x7320), "sensor");
        assert_eq!(group(0x3220), "DC link voltage");
        assert_eq!(group(0x4210), "temperature");
        assert_eq!(group(0xFF01), "manufacturer's own");
        assert_eq!(group(0xB000), "unknown group");
    }
}
