//! SDO transfers as state machines without I/O: expedited, normal and segmented, both ways. The bytes are those behind the CoE
//! header of a message (ETG.1000.6 and CiA 301, SDO).
//!
//! The caller sends [`Upload::request`] or [`Download::append_request`], hands each SDO reply to [`Upload::feed`], and repeats this
//! while that says [`Step::More`]. Nothing that a device sends makes them panic, go on without end or grow beyond a bound. An
//! upload holds at most four times the bytes that came beside the buffer that it was given, whatever length they announce. It takes
//! [`LONGEST_OBJECT`] bytes at most. Every segment must bring data. A download holds at most three times what it writes.

use super::abort::AbortCode;
use super::mailbox::CutMail;
use super::object::ObjectAddress;

mod download;
mod reply;
#[cfg(test)]
mod tests;
mod upload;

pub use download::Download;
pub use upload::Upload;

/// Bytes of an SDO without further data.
const SDO_LENGTH: usize = 8;
/// Data bytes of the shortest segment, which is padded to them.
const SHORTEST_SEGMENT: usize = 7;
/// The longest object that is read: no device's dictionary is known to hold a longer one.
pub const LONGEST_OBJECT: usize = 1 << 20;

/// What a reply brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The transfer goes on: send the next request.
    More,
    /// The transfer is complete.
    Done,
    /// The reply belongs to another request, as a late one does; go on waiting.
    Foreign,
}

/// Why a transfer failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SdoFault {
    /// The device refused.
    #[error("aborted by the device: {0}")]
    Aborted(AbortCode),
    /// The toggle bit of a segment is not the one that is due.
    #[error("segment with toggle bit {got}, expected {expected}")]
    Toggle {
        /// The bit that is due.
        expected: u8,
        /// The bit that came.
        got: u8,
    },
    /// The reply's command is none that can answer an SDO request.
    #[error("expected {expected}, got command {got:02X}h")]
    Unexpected {
        /// What was waited for.
        expected: &'static str,
        /// The command byte that came.
        got: u8,
    },
    /// The object's length is not what was announced, or is beyond what is accepted.
    #[error("expected {expected} bytes, got {got}")]
    Size {
        /// Bytes announced, or accepted at most.
        expected: usize,
        /// Bytes that came.
        got: usize,
    },
    /// Of an answer in several fragments one is missing, doubled, or one too many.
    #[error("expected a fragment with {expected} to follow, got one with {got}")]
    Fragments {
        /// Fragments that should follow.
        expected: u16,
        /// Fragments that follow by what the message says.
        got: u16,
    },
    /// The reply is shorter than its kind needs.
    #[error(transparent)]
    Cut(#[from] CutMail),
}

impl SdoFault {
    /// The abort code for the device in this fault; `None` if the device itself aborted.
    #[must_use]
    pub const fn abort_code(&self) -> Option<AbortCode> {
        match self {
            Self::Aborted(_) => None,
            Self::Toggle { .. } => Some(AbortCode::TOGGLE),
            Self::Unexpected { .. } | Self::Fragments { .. } | Self::Cut(_) => {
                Some(AbortCode::COMMAND)
            }
            Self::Size { .. } => Some(AbortCode::LENGTH),
        }
    }
}

/// The request by which a master ends a transfer.
#[must_use]
pub const fn abort_request(object: ObjectAddress, code: AbortCode) -> [u8; SDO_LENGTH] {
    let [c0, c1, c2, c3] = code.0.to_le_bytes();
    let [i0, i1] = object.index.to_le_bytes();
    [0x80, i0, i1, object.subindex, c0, c1, c2, c3]
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Initiate,
    Segments { toggle: bool },
    Done,
}
