//! What can go wrong with an SDO transfer. An error has the object, the step, what was expected and what came, and the drive where
//! it is known.

use alloc::string::String;
use core::fmt;
use core::time::Duration;

use super::abort::AbortCode;
use super::information::{ListKind, Question};
use super::mailbox::{CutMail, MailboxError};
use super::object::ObjectAddress;
use super::sdo::SdoFault;
use crate::sii::Identity;

/// An SDO transfer that failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SdoError {
    /// The device refused the transfer.
    #[error("{transfer}: device refused: {code}")]
    Aborted {
        /// What was attempted.
        transfer: Transfer,
        /// The device's reason.
        code: AbortCode,
    },
    /// A step did not end in time; a write may or may not have taken effect.
    #[error("{transfer}: no success after {after:?} while {step}")]
    Timeout {
        /// What was attempted.
        transfer: Transfer,
        /// What was waited for.
        step: SdoStep,
        /// How long.
        after: Duration,
    },
    /// A reply breaks the protocol.
    #[error("{transfer}: expected {expected}, got command {got:02X}h")]
    UnexpectedReply {
        /// What was attempted.
        transfer: Transfer,
        /// What was waited for.
        expected: &'static str,
        /// The command byte that came.
        got: u8,
    },
    /// The toggle bit of a segment is wrong: one was lost or doubled.
    #[error("{transfer}: segment with toggle bit {got}, expected {expected}")]
    Toggle {
        /// What was attempted.
        transfer: Transfer,
        /// The bit that was due.
        expected: u8,
        /// The bit that came.
        got: u8,
    },
    /// The object has another length than the program, or the device's own announcement, says.
    #[error("{transfer}: expected {expected} bytes, got {got}")]
    WrongSize {
        /// What was attempted.
        transfer: Transfer,
        /// Bytes expected.
        expected: usize,
        /// Bytes that came.
        got: usize,
    },
    /// Of an answer in several fragments one is missing, doubled, or one too many.
    #[error("{transfer}: expected a fragment with {expected} to follow, got one with {got}")]
    Fragments {
        /// What was attempted.
        transfer: Transfer,
        /// Fragments that should follow.
        expected: u16,
        /// Fragments that follow by what the message says.
        got: u16,
    },
    /// The device has no SDO information.
    #[error("{transfer}: the device has no SDO information: {reason}")]
    NotSupported {
        /// What was attempted.
        transfer: Transfer,
        /// How this is known.
        reason: Unsupported,
    },
    /// The device refused the message for its form.
    #[error("{transfer}: device refused the message: {error}")]
    Mailbox {
        /// What was attempted.
        transfer: Transfer,
        /// The device's reason.
        error: MailboxError,
    },
    /// A reply ends before it should.
    #[error("{transfer}: {cut}")]
    Cut {
        /// What was attempted.
        transfer: Transfer,
        /// The lengths.
        cut: CutMail,
    },
    /// The device did not answer, or the link cannot send.
    #[error("{transfer}: {step} failed: {reason}")]
    Link {
        /// What was attempted.
        transfer: Transfer,
        /// What was being done.
        step: SdoStep,
        /// The link's reason.
        reason: String,
    },
    /// The bus has been closed, or the device has no mailbox.
    #[error("{transfer}: nobody serves the mailbox of this device")]
    Closed {
        /// What was attempted.
        transfer: Transfer,
    },
}

impl SdoError {
    /// What was attempted.
    #[must_use]
    pub const fn transfer(&self) -> Transfer {
        match *self {
            Self::Aborted { transfer, .. }
            | Self::Timeout { transfer, .. }
            | Self::UnexpectedReply { transfer, .. }
            | Self::Toggle { transfer, .. }
            | Self::WrongSize { transfer, .. }
            | Self::Fragments { transfer, .. }
            | Self::NotSupported { transfer, .. }
            | Self::Mailbox { transfer, .. }
            | Self::Cut { transfer, .. }
            | Self::Link { transfer, .. }
            | Self::Closed { transfer } => transfer,
        }
    }

    /// The device's abort code, if it refused the transfer with one.
    #[must_use]
    pub const fn abort_code(&self) -> Option<AbortCode> {
        match *self {
            Self::Aborted { code, .. } => Some(code),
            _ => None,
        }
    }

    /// A fault of the protocol, with the transfer in which it happened.
    #[must_use]
    pub const fn from_fault(transfer: Transfer, fault: SdoFault) -> Self {
        match fault {
            SdoFault::Aborted(code) => Self::Aborted { transfer, code },
            SdoFault::Toggle { expected, got } => Self::Toggle {
                transfer,
                expected,
                got,
            },
            SdoFault::Unexpected { expected, got } => Self::UnexpectedReply {
                transfer,
                expected,
                got,
            },
            SdoFault::Size { expected, got } => Self::WrongSize {
                transfer,
                expected,
                got,
            },
            SdoFault::Fragments { expected, got } => Self::Fragments {
                transfer,
                expected,
                got,
            },
            SdoFault::Cut(cut) => Self::Cut { transfer, cut },
        }
    }
}

/// How it is known that a device has no SDO information.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unsupported {
    /// Its SII says so (CoE details); it was not asked.
    Sii,
    /// It refuses the message.
    Mail(MailboxError),
    /// It refuses the service.
    Service(AbortCode),
}

impl fmt::Display for Unsupported {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sii => f.write_str("its SII says so"),
            Self::Mail(error) => write!(f, "it refuses the message: {error}"),
            Self::Service(code) => write!(f, "it refuses: {code}"),
        }
    }
}

/// What was attempted: reading or writing of one object, or a question about the dictionary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Transfer {
    /// The direction.
    pub kind: TransferKind,
    /// The object; 0000h:00 where none is meant.
    pub object: ObjectAddress,
}

impl Transfer {
    /// The reading of `object`.
    #[must_use]
    pub const fn read(object: ObjectAddress) -> Self {
        Self {
            kind: TransferKind::Read,
            object,
        }
    }

    /// The writing of `object`.
    #[must_use]
    pub const fn write(object: ObjectAddress) -> Self {
        Self {
            kind: TransferKind::Write,
            object,
        }
    }
}

#[cfg(feature = "std")]
impl Transfer {
    /// Whether a late reply to the one could pass for a reply to the other: SDO replies name their object, parts of SDO
    /// information need not.
    pub(super) fn is_like(self, other: Self) -> bool {
        use TransferKind::{Read, Write};
        match (self.kind, other.kind) {
            (Read | Write, Read | Write) => self.object == other.object,
            (Read | Write, _) | (_, Read | Write) => false,
            _ => true,
        }
    }
}

impl From<Question> for Transfer {
    fn from(question: Question) -> Self {
        let (kind, object) = match question {
            Question::Counts => (TransferKind::Count, ObjectAddress::new(0, 0)),
            Question::List(kind) => (TransferKind::List(kind), ObjectAddress::new(0, 0)),
            Question::Object { index } => (TransferKind::Describe, ObjectAddress::new(index, 0)),
            Question::Entry {
                index, subindex, ..
            } => (
                TransferKind::DescribeEntry,
                ObjectAddress::new(index, subindex),
            ),
        };
        Self { kind, object }
    }
}

impl fmt::Display for Transfer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind {
            TransferKind::Read => write!(f, "reading {}", self.object),
            TransferKind::Write => write!(f, "writing {}", self.object),
            TransferKind::Count => f.write_str("asking for the number of objects"),
            TransferKind::List(ListKind::All) => f.write_str("asking for the list of objects"),
            TransferKind::List(kind) => {
                write!(f, "asking for the list of objects of kind {}", kind as u8)
            }
            TransferKind::Describe => write!(f, "asking what {:04X}h is", self.object.index),
            TransferKind::DescribeEntry => write!(f, "asking what {} is", self.object),
        }
    }
}

/// The kind of a transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TransferKind {
    /// From the device (SDO upload).
    Read,
    /// To the device (SDO download).
    Write,
    /// SDO information: how many objects there are.
    Count,
    /// SDO information: a list of objects.
    List(ListKind),
    /// SDO information: what an object is.
    Describe,
    /// SDO information: what an entry of an object is.
    DescribeEntry,
}

/// What a transfer was waiting for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SdoStep {
    /// The device to take the request out of its mailbox, or the request to reach it.
    Sending,
    /// The first reply.
    Reply,
    /// A further segment, or its confirmation.
    Segment,
    /// A further fragment.
    Fragment,
    /// A late reply of an earlier transfer of the same object, which must not be taken for this one's.
    EarlierReply,
    /// Reading a message that is there.
    Fetching,
}

impl fmt::Display for SdoStep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Sending => "putting the request into the device's mailbox",
            Self::Reply => "waiting for the reply",
            Self::Segment => "waiting for the next segment",
            Self::Fragment => "waiting for the next fragment",
            Self::EarlierReply => "waiting for the late reply of an earlier transfer",
            Self::Fetching => "fetching a message from the device",
        })
    }
}

/// Which drive: its place in the line, its name and what it says it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriveId {
    /// Its place in the line, the first SubDevice being 0.
    pub position: u16,
    /// Its name, from its SII or given by the program.
    pub name: String,
    /// Vendor, product, revision and serial number, from its SII.
    pub identity: Identity,
}

impl fmt::Display for DriveId {
    /// Its place and its name, and by `{:#}` its identity as well.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "drive {} \"{}\"", self.position, self.name)?;
        if f.alternate() {
            write!(f, " ({})", self.identity)?;
        }
        Ok(())
    }
}

/// An error together with the drive that it concerns.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{drive:#}: {error}")]
pub struct DriveError<E = SdoError>
where
    E: core::error::Error + 'static,
{
    /// The drive.
    pub drive: DriveId,
    /// What went wrong.
    #[source]
    pub error: E,
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::string::ToString;

    #[test]
    fn a_drives_error_tells_drive_object_and_reason() {
        let error = DriveError {
            drive: DriveId {
                position: 1,
                name: "x".to_string(),
                identity: Identity {
                    vendor: 0x6A,
                    product: 0x414B_4432,
                    revision: 1,
                    serial: 0,
                },
            },
            error: SdoError::Aborted {
                transfer: Transfer::write(ObjectAddress::new(0x1600, 1)),
                code: AbortCode::NOT_MAPPABLE,
            },
        };
        assert_eq!(
            error.to_string(),
            "drive 1 \"x\" (vendor 0000006Ah, product 414B4432h, revision 00000001h, serial 00000000h): \
             writing 1600h:01: device refused: object cannot be mapped into a PDO (06040041h)"
        );
    }

    #[test]
    fn a_timeout_tells_what_was_waited_for() {
        let error = SdoError::Timeout {
            transfer: Transfer::read(ObjectAddress::new(0x6041, 0)),
            step: SdoStep::Reply,
            after: Duration::from_millis(500),
        };
        assert_eq!(
            error.to_string(),
            "reading 6041h:00: no success after 500ms while waiting for the reply"
        );
    }
}
