//! What can go wrong with an SDO transfer. An error has the object, the step, what was expected and what came, and the drive where
//! it is known.

use alloc::{borrow::Cow, collections::BTreeMap, format, string::String};
use core::{fmt, time::Duration};

use crate::{ds402::describe_error_code, sii::Identity};

use super::{
    emergency::Emergency,
    information::{ListKind, Question},
    mailbox::{CutMessage, MailboxError},
    object::ObjectAddress,
    sdo::SdoFault,
};

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
        reason: NoInformation,
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
        cut: CutMessage,
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
    #[error(
        "{transfer}: nothing serves the mailbox of this device: its network was shut down or has ended, or it has no mailbox"
    )]
    Closed {
        /// What was attempted.
        transfer: Transfer,
    },
    /// The device is of an optional group that has not joined yet.
    #[error("{transfer}: the device is not in the line: its group has not joined yet")]
    Absent {
        /// What was attempted.
        transfer: Transfer,
    },
    /// The program that has the drive's line did not do it: of an `SdoHandle::remote`.
    #[error("{transfer}: {reason}")]
    Remote {
        /// What was attempted.
        transfer: Transfer,
        /// Why, as it says.
        reason: String,
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
            | Self::Closed { transfer }
            | Self::Absent { transfer }
            | Self::Remote { transfer, .. } => transfer,
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
#[non_exhaustive]
pub enum NoInformation {
    /// Its SII says so (CoE details); it was not asked.
    Sii,
    /// It refuses the message.
    MailboxMessage(MailboxError),
    /// It refuses the service.
    Service(AbortCode),
}

impl fmt::Display for NoInformation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sii => f.write_str("its SII says so"),
            Self::MailboxMessage(error) => write!(f, "it refuses the message: {error}"),
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
#[non_exhaustive]
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
#[non_exhaustive]
pub enum SdoStep {
    /// The device to take the request out of its mailbox, or the request to reach it.
    Sending,
    /// The first reply.
    Reply,
    /// A further segment, or its confirmation.
    Segment,
    /// A further fragment.
    Fragment,
    /// A late reply of an earlier transfer of the same object, which must not answer this one.
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
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
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

// What a drive's own error codes mean, as data.

/// What the error codes of a drive mean by its own documents, beyond those of CiA 402.
///
/// ```
/// use servocrab::coe::{Emergency, ErrorTexts};
///
/// let mut texts = ErrorTexts::default();
/// texts.codes.insert(0xFF01, "brake resistor missing".into());
/// let emergency = |code| Emergency { code, register: 0x81, data: [0; 5] };
/// assert_eq!(texts.text(&emergency(0xFF01)), "brake resistor missing");
/// assert_eq!(texts.text(&emergency(0x8611)), "following error");
/// texts.codes.insert(0x8611, "F6001 following error magnitude".into());
/// assert_eq!(texts.describe(0x8611), "following error; F6001 following error magnitude");
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ErrorTexts {
    /// Texts of error codes (603Fh). They stand beside those of CiA 402.
    pub codes: BTreeMap<u16, Cow<'static, str>>,
    /// What the drive says by bit 13 of its statusword in Profile Position (following error).
    pub following_error: Option<Cow<'static, str>>,
    /// Texts of diagnosis messages (10F3h), by their text ID.
    pub diagnosis: BTreeMap<u16, Cow<'static, str>>,
    /// The number by which the drive itself names its errors, where its emergencies carry one.
    pub number: Option<DriveNumber>,
}

/// A number of the maker's in the five data bytes of an emergency: what the drive shows on its display.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriveNumber {
    /// The error code with which it comes.
    pub with_code: u16,
    /// Where its two bytes, the low one first, begin among the five (0 to 3).
    pub byte: u8,
    /// What the maker calls it; the number follows in three hexadecimal digits.
    pub prefix: Cow<'static, str>,
    /// Texts of these numbers.
    pub texts: BTreeMap<u16, Cow<'static, str>>,
}

impl ErrorTexts {
    /// What an error code means: by CiA 402, and then by the drive's own table where it has the code. Of the manufacturer's codes
    /// (FF00h to FFFFh) CiA 402 says nothing, and the drive's own text stands alone.
    #[must_use]
    pub fn describe(&self, code: u16) -> Cow<'static, str> {
        let standard = describe_error_code(code);
        match self.codes.get(&code) {
            None => Cow::Borrowed(standard),
            Some(own) if code >= 0xFF00 => own.clone(),
            Some(own) => Cow::Owned(format!("{standard}; {own}")),
        }
    }

    /// What this emergency means: as its code, or by the drive's number where only that is known.
    #[must_use]
    pub fn text(&self, emergency: &Emergency) -> Cow<'static, str> {
        let number = || self.number.as_ref()?.text(emergency);
        let of_number = match self.codes.get(&emergency.code) {
            Some(_) => None,
            None => number(),
        };
        of_number.unwrap_or_else(|| self.describe(emergency.code))
    }

    /// What the drive itself says of a fault with this code, where its table has anything.
    #[cfg(feature = "std")]
    pub(crate) fn of_fault(&self, code: Option<u16>, following_error: bool) -> Option<String> {
        let of_bit = self.following_error.as_ref().filter(|_| following_error);
        let of_code = code.and_then(|code| self.codes.get(&code));
        match (of_code, of_bit) {
            (Some(code), Some(bit)) if code != bit => Some(format!("{code}, {bit}")),
            (Some(text), _) | (None, Some(text)) => Some(text.clone().into_owned()),
            (None, None) => None,
        }
    }

    /// Adds the texts of another table, which go before those that are here.
    pub fn extend(&mut self, with: Self) {
        let Self {
            codes,
            number,
            following_error,
            diagnosis,
        } = with;
        self.codes.extend(codes);
        self.diagnosis.extend(diagnosis);
        self.number = number.or(self.number.take());
        self.following_error = following_error.or(self.following_error.take());
    }
}

impl DriveNumber {
    fn text(&self, emergency: &Emergency) -> Option<Cow<'static, str>> {
        let &[low, high] = emergency
            .data
            .get(usize::from(self.byte)..)?
            .first_chunk()?;
        if emergency.code != self.with_code {
            return None;
        }
        let (prefix, number) = (&self.prefix, u16::from_le_bytes([low, high]));
        Some(Cow::Owned(match self.texts.get(&number) {
            Some(text) => format!("{prefix}{number:03X}: {text}"),
            None => format!("{prefix}{number:03X}"),
        }))
    }
}

// SDO abort codes as number and words (ETG.1000.6, CiA 301).

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
    /// Read of a write-only object.
    pub const WRITE_ONLY: Self = Self(0x0601_0001);
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
    /// The object has no value now.
    pub const NO_DATA: Self = Self(0x0800_0024);

    /// Whether the device says that it has no such object or subindex. By every other code it may have it, and does not give it now.
    #[must_use]
    pub const fn is_no_object(self) -> bool {
        matches!(self, Self::NO_OBJECT | Self::NO_SUBINDEX)
    }

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
    use alloc::string::ToString;

    use super::*;

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

    fn emergency(code: u16, data: [u8; 5]) -> Emergency {
        Emergency {
            code,
            register: 0x81,
            data,
        }
    }

    #[test]
    fn the_drives_own_text_stands_behind_the_standards() {
        let mut texts = ErrorTexts::default();
        assert_eq!(
            texts.text(&emergency(0x3220, [0; 5])),
            "DC link under-voltage"
        );
        texts.codes.insert(0x3220, "F502".into());
        assert_eq!(
            texts.text(&emergency(0x3220, [0; 5])),
            "DC link under-voltage; F502"
        );
        assert_eq!(texts.text(&emergency(0x3299, [0; 5])), "DC link voltage");
    }

    #[test]
    fn a_number_in_the_data_is_read_where_it_lies_and_with_its_code_alone() {
        let number = |byte| ErrorTexts {
            number: Some(DriveNumber {
                with_code: 0xFF00,
                byte,
                prefix: "alarm A.".into(),
                texts: [(0x0D00, "position deviation".into())].into(),
            }),
            ..ErrorTexts::default()
        };
        let data = [0xAA, 0x00, 0x0D, 0x10, 0x0C];
        let text = |byte, code| number(byte).text(&emergency(code, data));
        assert_eq!(text(1, 0xFF00), "alarm A.D00: position deviation");
        assert_eq!(text(3, 0xFF00), "alarm A.C10");
        assert_eq!(text(4, 0xFF00), "manufacturer specific");
        assert_eq!(text(1, 0x8611), "following error");
    }
}

#[cfg(test)]
mod abort_tests {
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
