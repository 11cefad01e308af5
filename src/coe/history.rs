//! What a drive remembers of its errors: the error history 1003h (CiA 301) and the diagnosis history 10F3h (ETG.1020).

use alloc::borrow::Cow;
use alloc::string::String;
use alloc::sync::Arc;
use alloc::vec::Vec;
use core::fmt;

use super::error::{AbortCode, DriveError, ErrorTexts, SdoError};
use super::handle::SdoHandle;
use super::obj;
use super::object::{Object, ObjectAddress};
use super::value::{ReadOnly, ReadWrite, Readable, Value};

/// The error history 1003h.
const ERRORS: u16 = 0x1003;
/// The diagnosis history 10F3h.
const DIAGNOSIS: u16 = 0x10F3;
const ROOM: Object<u8, ReadOnly> = Object::new(DIAGNOSIS, 1, "maximum messages");
const NEWEST: Object<u8, ReadOnly> = Object::new(DIAGNOSIS, 2, "newest message");
const ACKNOWLEDGED: Object<u8, ReadWrite> =
    Object::new(DIAGNOSIS, 3, "newest acknowledged message");
const HAS_NEW: Object<u8, ReadOnly> = Object::new(DIAGNOSIS, 4, "new messages available");
const FLAGS: Object<u16, ReadWrite> = Object::new(DIAGNOSIS, 5, "flags");
/// The subindex of the first place for a message in 10F3h.
const FIRST_MESSAGE: u8 = 6;
/// The bytes that each message has: code, flags, text ID and time.
const HEAD: usize = 16;

/// The histories of one drive, which are read and cleared by SDO. Nothing is cleared unless [`clear`](Self::clear) is called.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{DriveConfig, Network, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// let history = net.history(0).ok_or("no drive was declared there")?;
/// let record = history.read().await?;
/// for error in record.errors.iter().flatten() {
///     eprintln!("{error}"); // the newest first
/// }
/// # assert_eq!(record.errors, Some(Vec::new()));
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct DriveHistory {
    sdo: SdoHandle,
    texts: Arc<ErrorTexts>,
}

/// What a drive remembered when it was read.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct HistoryRecord {
    /// The errors of 1003h, the newest first; none where the drive has no such object.
    pub errors: Option<Vec<RecordedError>>,
    /// The diagnosis history 10F3h; none where the drive has no such object.
    pub diagnosis: Option<DiagnosisHistory>,
}

/// An error in 1003h.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct RecordedError {
    /// The error code, as in 603Fh: bits 0 to 15.
    pub code: u16,
    /// What the maker adds: bits 16 to 31.
    pub additional: u16,
    /// What the code means, by CiA 402 and by the drive's own table ([`ErrorTexts`]).
    pub text: Cow<'static, str>,
}

impl fmt::Display for RecordedError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04X}h ({})", self.code, self.text)?;
        match self.additional {
            0 => Ok(()),
            more => write!(f, ", the maker's {more:04X}h"),
        }
    }
}

/// The diagnosis history 10F3h.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct DiagnosisHistory {
    /// How many messages there is room for: subindex 1.
    pub room: u8,
    /// The subindex of the newest message that was acknowledged; none where none was, or where the drive does not say: subindex 3.
    pub acknowledged: Option<u8>,
    /// Whether there are messages that were not read or acknowledged yet: subindex 4.
    pub has_new: bool,
    /// Whether only acknowledged messages make room for new ones. Else a new one takes the place of the oldest. Bit 4 of the flags.
    pub keeps_unacknowledged: bool,
    /// Whether messages were lost: overwritten before they were acknowledged, or discarded for want of room. Bit 5 of the flags.
    pub has_lost: bool,
    /// All flags as they are: subindex 5.
    pub flags: u16,
    /// The messages, the newest first.
    pub messages: Vec<DiagnosisMessage>,
}

/// A message of 10F3h.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct DiagnosisMessage {
    /// The subindex at which it is.
    pub subindex: u8,
    /// The diagnosis code: its kind in bits 0 to 15, and above that what the kind makes of it.
    pub code: u32,
    /// How grave it is: bits 0 to 3 of its flags.
    pub severity: Severity,
    /// When it came, in nanoseconds: since 2000 on the clock of the bus, or as long as the drive itself counts; 0 for unknown.
    pub time_ns: u64,
    /// Whether the time is the drive's own and not that of the bus: bit 4 of its flags.
    pub is_local_time: bool,
    /// The number of its text; 0 for none.
    pub text_id: u16,
    /// The text of that number where the drive's table has it, else what its error code means, if it has one.
    pub text: Option<Cow<'static, str>>,
    /// Its parameters.
    pub parameters: Vec<DiagnosisParameter>,
}

/// How grave a message of 10F3h is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Severity {
    /// For information.
    Info,
    /// A warning.
    Warning,
    /// An error.
    Error,
    /// A number that ETG.1020 reserves.
    Reserved(u8),
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Info => f.write_str("info"),
            Self::Warning => f.write_str("warning"),
            Self::Error => f.write_str("error"),
            Self::Reserved(kind) => write!(f, "kind {kind}"),
        }
    }
}

/// A parameter of a message of 10F3h.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum DiagnosisParameter {
    /// A number.
    Number {
        /// The number of its data type (ETG.1000.6), such as 0007h for 32 bits without a sign.
        data_type: u16,
        /// Its bytes, the low one first.
        bytes: Vec<u8>,
    },
    /// Bytes.
    Bytes(Vec<u8>),
    /// Text.
    Text(String),
    /// The number of a text.
    TextId(u16),
    /// It and all behind it: of a data type whose length is not known.
    Unknown(Vec<u8>),
}

impl DiagnosisMessage {
    /// The error code, as in 603Fh, where the message is of an emergency: diagnosis codes of the kind E800h.
    #[must_use]
    pub const fn error_code(&self) -> Option<u16> {
        match self.code as u16 {
            0xE800 => Some((self.code >> 16) as u16),
            _ => None,
        }
    }

    /// A message as it is at this subindex.
    fn parse(subindex: u8, message: &[u8], texts: &ErrorTexts) -> Result<Self, CutDiagnosis> {
        let cut = CutDiagnosis {
            subindex,
            bytes: message.len(),
        };
        let (head, mut rest) = message.split_first_chunk::<HEAD>().ok_or(cut)?;
        let [c0, c1, c2, c3, f0, count, i0, i1, time @ ..] = *head;
        let text_id = u16::from_le_bytes([i0, i1]);
        let mut parameters = Vec::new();
        for _ in 0..count {
            if let Some(DiagnosisParameter::Unknown(_)) = parameters.last() {
                break;
            }
            parameters.push(parameter(&mut rest).ok_or(cut)?);
        }
        let mut parsed = Self {
            subindex,
            code: u32::from_le_bytes([c0, c1, c2, c3]),
            severity: match f0 & 0x0F {
                0 => Severity::Info,
                1 => Severity::Warning,
                2 => Severity::Error,
                kind => Severity::Reserved(kind),
            },
            time_ns: u64::from_le_bytes(time),
            is_local_time: f0 & 0x10 != 0,
            text_id,
            text: texts.diagnosis.get(&text_id).cloned(),
            parameters,
        };
        let code = parsed.error_code();
        let of_code = || code.map(|code| texts.describe(code));
        parsed.text = parsed.text.take().or_else(of_code);
        Ok(parsed)
    }
}

/// The next parameter of a message, taken off the front; none where the message ends before.
fn parameter(rest: &mut &[u8]) -> Option<DiagnosisParameter> {
    let (word, behind) = rest.split_first_chunk()?;
    let word = u16::from_le_bytes(*word);
    let (kind, low) = (word >> 12, word & 0x0FFF);
    let known = match (kind, low) {
        // Basic data types, by their numbers.
        (0, 0x01 | 0x02 | 0x05) => Some(1),
        (0, 0x03 | 0x06) => Some(2),
        (0, 0x04 | 0x07 | 0x08) => Some(4),
        (0, 0x11 | 0x15 | 0x1B) => Some(8),
        // Bytes, text in bytes and text in words, each with its length in bytes.
        (1..=3, bytes) => Some(usize::from(bytes)),
        (4, _) => Some(2),
        _ => None,
    };
    let Some(length) = known else {
        return Some(DiagnosisParameter::Unknown(core::mem::take(rest).to_vec()));
    };
    let (bytes, behind) = behind.split_at_checked(length)?;
    *rest = behind;
    let bytes = bytes.to_vec();
    Some(match kind {
        0 => DiagnosisParameter::Number {
            data_type: low,
            bytes,
        },
        1 => DiagnosisParameter::Bytes(bytes),
        2 => DiagnosisParameter::Text(String::from_utf8_lossy(&bytes).into_owned()),
        3 => {
            let (words, _) = bytes.as_chunks();
            let words: Vec<_> = words.iter().map(|word| u16::from_le_bytes(*word)).collect();
            DiagnosisParameter::Text(String::from_utf16_lossy(&words))
        }
        _ => DiagnosisParameter::TextId(u16::from_le_bytes(bytes.try_into().ok()?)),
    })
}

impl fmt::Display for DiagnosisMessage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            severity,
            code,
            text_id,
            ..
        } = self;
        write!(f, "{severity} {code:08X}h")?;
        match &self.text {
            Some(text) => write!(f, " ({text})")?,
            None => write!(f, " (text {text_id:04X}h)")?,
        }
        self.parameters
            .iter()
            .try_for_each(|parameter| write!(f, ", {parameter}"))
    }
}

impl fmt::Display for DiagnosisParameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number { bytes, .. } => {
                f.write_str("0x")?;
                let mut high_first = bytes.iter().rev();
                high_first.try_for_each(|byte| write!(f, "{byte:02X}"))
            }
            Self::Bytes(bytes) | Self::Unknown(bytes) => {
                f.write_str("bytes")?;
                bytes.iter().try_for_each(|byte| write!(f, " {byte:02X}"))
            }
            Self::Text(text) => write!(f, "{text:?}"),
            Self::TextId(id) => write!(f, "text {id:04X}h"),
        }
    }
}

/// A message ends before its last byte.
#[derive(Clone, Copy)]
struct CutDiagnosis {
    subindex: u8,
    bytes: usize,
}

/// Why a history could not be read or cleared.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum HistoryFault {
    /// An object could not be read or written.
    #[error(transparent)]
    Sdo(#[from] SdoError),
    /// The drive counts more errors than it has.
    #[error(
        "1003h:00 counts {count} errors, and {} holds none: the history may have been cleared meanwhile, so read it again",
        ObjectAddress::new(ERRORS, *.missing)
    )]
    Count {
        /// What 1003h:0 says.
        count: u8,
        /// The first subindex that cannot be read.
        missing: u8,
    },
    /// The newest message is at none of the places that there are.
    #[error(
        "10F3h:02 says that the newest message is at subindex {newest}, expected 0 or 6 to {last}"
    )]
    Newest {
        /// What 10F3h:2 says.
        newest: u8,
        /// The last place.
        last: u8,
    },
    /// There is no message where the newest one is to be.
    #[error("10F3h:02 says that the newest message is at subindex {newest}, and none is there")]
    NoMessage {
        /// What 10F3h:2 says.
        newest: u8,
    },
    /// A message is shorter than what it holds by its own words.
    #[error(
        "{object} is no message of a diagnosis history: its {bytes} bytes end within its head or a parameter"
    )]
    Message {
        /// The message.
        object: ObjectAddress,
        /// How many bytes came.
        bytes: usize,
    },
}

impl From<CutDiagnosis> for HistoryFault {
    fn from(CutDiagnosis { subindex, bytes }: CutDiagnosis) -> Self {
        Self::Message {
            object: ObjectAddress::new(DIAGNOSIS, subindex),
            bytes,
        }
    }
}

impl DriveHistory {
    /// The histories of the drive that this handle reads and writes. `texts` say what its own codes mean.
    #[must_use]
    pub fn new(sdo: SdoHandle, texts: impl Into<Arc<ErrorTexts>>) -> Self {
        let texts = texts.into();
        Self { sdo, texts }
    }

    /// Reads both histories. It changes nothing in the drive, but a drive may count its messages as read. An error that comes meanwhile
    /// may be missing, or be there twice.
    ///
    /// # Errors
    /// [`HistoryFault`] with the drive: `Sdo` as of [`SdoHandle::read`], and the others for answers that contradict each other. That the
    /// drive has no such object is no error.
    pub async fn read(&self) -> Result<HistoryRecord, DriveError<HistoryFault>> {
        let read = async {
            Ok(HistoryRecord {
                errors: self.errors().await?,
                diagnosis: self.diagnosis().await?,
            })
        };
        read.await.map_err(|error| self.of_drive(error))
    }

    /// Clears what the drive has of both: it writes 0 to 1003h:0 and to 10F3h:3. Where only acknowledged messages may be cleared, it
    /// acknowledges all of them first.
    ///
    /// # Errors
    /// `Sdo` with the drive, as of [`SdoHandle::write`]. The first of the two may have been cleared.
    pub async fn clear(&self) -> Result<(), DriveError<HistoryFault>> {
        let clear = async {
            let errors = self.sdo.write(obj::ERROR_HISTORY_COUNT, 0);
            if_there(errors.await)?;
            let newest = if_there(self.sdo.read(NEWEST).await)?;
            let Some(newest) = newest else { return Ok(()) };
            let flags = self.number(FLAGS).await?;
            if keeps_unacknowledged(flags) && newest != 0 {
                self.write_acknowledged(newest).await?;
            }
            self.write_acknowledged(0).await
        };
        clear.await.map_err(|error| self.of_drive(error))
    }

    /// Acknowledges a message of 10F3h and all that are older: it writes the subindex to 10F3h:3.
    ///
    /// # Errors
    /// `Sdo` with the drive, as of [`SdoHandle::write`]. The drive refuses where there is no message at this place any more.
    pub async fn acknowledge(
        &self,
        message: &DiagnosisMessage,
    ) -> Result<(), DriveError<HistoryFault>> {
        let written = self.write_acknowledged(message.subindex).await;
        written.map_err(|error| self.of_drive(error))
    }

    async fn write_acknowledged(&self, subindex: u8) -> Result<(), HistoryFault> {
        let written = self.sdo.write(ACKNOWLEDGED, subindex).await;
        written.map_err(|failed| failed.error.into())
    }

    async fn number<T: Value, A: Readable>(&self, object: Object<T, A>) -> Result<T, HistoryFault> {
        let read = self.sdo.read(object).await;
        read.map_err(|failed| failed.error.into())
    }

    fn of_drive(&self, error: HistoryFault) -> DriveError<HistoryFault> {
        DriveError {
            drive: self.sdo.drive().clone(),
            error,
        }
    }

    async fn errors(&self) -> Result<Option<Vec<RecordedError>>, HistoryFault> {
        let Some(count) = if_there(self.sdo.read(obj::ERROR_HISTORY_COUNT).await)? else {
            return Ok(None);
        };
        let mut errors = Vec::with_capacity(count.into());
        for subindex in 1..=count {
            let missing = HistoryFault::Count {
                count,
                missing: subindex,
            };
            let object = Object::<u32, ReadOnly>::new(ERRORS, subindex, "error");
            let field = if_there(self.sdo.read(object).await)?.ok_or(missing)?;
            let code = field as u16;
            errors.push(RecordedError {
                code,
                additional: (field >> 16) as u16,
                text: self.texts.describe(code),
            });
        }
        Ok(Some(errors))
    }

    async fn diagnosis(&self) -> Result<Option<DiagnosisHistory>, HistoryFault> {
        let Some(room) = if_there(self.sdo.read(ROOM).await)? else {
            return Ok(None);
        };
        let newest = self.number(NEWEST).await?;
        let acknowledged = self.number(ACKNOWLEDGED).await?;
        let has_new = self.number(HAS_NEW).await?;
        let flags = self.number(FLAGS).await?;
        Ok(Some(DiagnosisHistory {
            room,
            acknowledged: (acknowledged != 0).then_some(acknowledged),
            has_new: has_new != 0,
            keeps_unacknowledged: keeps_unacknowledged(flags),
            has_lost: flags & 0x0020 != 0,
            flags,
            messages: self.messages(room, newest).await?,
        }))
    }

    /// The messages, from the newest back to the oldest: they follow each other in a ring.
    async fn messages(&self, room: u8, newest: u8) -> Result<Vec<DiagnosisMessage>, HistoryFault> {
        let last = (FIRST_MESSAGE - 1).saturating_add(room);
        let mut messages = Vec::new();
        if newest == 0 {
            return Ok(messages);
        }
        if !(FIRST_MESSAGE..=last).contains(&newest) {
            return Err(HistoryFault::Newest { newest, last });
        }
        let older = (FIRST_MESSAGE..=newest).rev();
        let oldest = (FIRST_MESSAGE..=last)
            .rev()
            .take_while(|place| *place > newest);
        for subindex in older.chain(oldest).take(room.into()) {
            let message = self.sdo.read_bytes(DIAGNOSIS, subindex).await;
            let message = if_there(message)?.unwrap_or_default();
            // A place without a message is refused, or has no bytes, or zeros.
            if message.iter().all(|byte| *byte == 0) {
                break;
            }
            messages.push(DiagnosisMessage::parse(subindex, &message, &self.texts)?);
        }
        if messages.is_empty() {
            return Err(HistoryFault::NoMessage { newest });
        }
        Ok(messages)
    }
}

/// Bit 4 of the flags, 10F3h:5: a message goes only after it was acknowledged.
const fn keeps_unacknowledged(flags: u16) -> bool {
    flags & 0x0010 != 0
}

/// None where the drive says that it has no such object, or no value for it.
fn if_there<T>(answer: Result<T, DriveError>) -> Result<Option<T>, SdoError> {
    match answer {
        Ok(value) => Ok(Some(value)),
        Err(DriveError {
            error: SdoError::Aborted { code, .. },
            ..
        }) if code.is_no_object() || code == AbortCode::NO_DATA => Ok(None),
        Err(failed) => Err(failed.error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coe::test_device::{Device, Rig, rig};

    /// A drive without errors that has room for two messages, and the handle of its histories.
    fn drive() -> (Rig, Device, DriveHistory) {
        let (rig, device, sdo, _) = rig();
        device.set(0x1003, 0, &[0]);
        for (subindex, value) in [(1, &[2][..]), (2, &[0]), (3, &[0]), (4, &[0]), (5, &[0, 0])] {
            device.set(0x10F3, subindex, value);
        }
        let mut texts = ErrorTexts::default();
        texts.diagnosis.insert(0x0102, "fan %d stands".into());
        (rig, device, DriveHistory::new(sdo, texts))
    }

    fn read(rig: &Rig, history: &DriveHistory) -> Result<HistoryRecord, HistoryFault> {
        let history = history.clone();
        rig.run(async move { history.read().await.map_err(|failed| failed.error) })
    }

    /// A warning with the text 0102h, of a maker's code, with this many parameters.
    fn message(parameters: u8, bytes: &[u8]) -> Vec<u8> {
        let head = [0x00, 0xE0, 0x34, 0x12, 0x01, parameters, 0x02, 0x01];
        let time = 5_u64.to_le_bytes();
        [&head[..], &time, bytes].concat()
    }

    #[test]
    fn a_message_has_its_text_and_its_parameters_of_each_kind() {
        let (rig, device, history) = drive();
        let parameters = [
            &[0x06, 0x00, 0x34, 0x12][..],
            &[0x02, 0x10, 7, 8],
            &[0x03, 0x20, b'f', b'a', b'n'],
            &[0x02, 0x30, b'x', 0],
            &[0x00, 0x40, 9, 0],
            &[0x31, 0x00, 1, 2],
        ];
        device.set(0x10F3, 2, &[6]);
        device.set(0x10F3, 6, &message(6, &parameters.concat()));
        let record = read(&rig, &history).unwrap();
        let [message] = &*record.diagnosis.unwrap().messages else {
            panic!("one message")
        };
        assert_eq!((message.severity, message.time_ns), (Severity::Warning, 5));
        assert!(!message.is_local_time);
        assert_eq!(message.error_code(), None);
        assert_eq!(
            message.parameters,
            [
                DiagnosisParameter::Number {
                    data_type: 6,
                    bytes: vec![0x34, 0x12]
                },
                DiagnosisParameter::Bytes(vec![7, 8]),
                DiagnosisParameter::Text("fan".into()),
                DiagnosisParameter::Text("x".into()),
                DiagnosisParameter::TextId(9),
                DiagnosisParameter::Unknown(vec![0x31, 0x00, 1, 2]),
            ]
        );
        assert_eq!(
            message.to_string(),
            "warning 1234E000h (fan %d stands), 0x1234, bytes 07 08, \"fan\", \"x\", text 0009h, bytes 31 00 01 02"
        );
    }

    #[test]
    fn a_message_that_ends_too_early_is_named_wherever_it_ends() {
        let (rig, device, history) = drive();
        device.set(0x10F3, 2, &[7]);
        let whole = message(2, &[0x07, 0x00, 1, 2, 3, 4, 0x03, 0x20, b'f', b'a', b'n']);
        for bytes in 1..whole.len() {
            // Zeros alone are a place without a message.
            device.set(0x10F3, 7, &whole[..bytes]);
            let fault = match bytes {
                1 => HistoryFault::NoMessage { newest: 7 },
                _ => HistoryFault::Message {
                    object: ObjectAddress::new(0x10F3, 7),
                    bytes,
                },
            };
            assert_eq!(read(&rig, &history), Err(fault), "{bytes}");
        }
        device.set(0x10F3, 7, &whole);
        assert!(read(&rig, &history).is_ok());
    }

    #[test]
    fn answers_that_contradict_each_other_or_have_another_length_are_errors() {
        let (rig, device, history) = drive();
        for newest in [1, 5, 8, 255] {
            device.set(0x10F3, 2, &[newest]);
            let fault = HistoryFault::Newest { newest, last: 7 };
            assert_eq!(read(&rig, &history), Err(fault));
        }
        device.set(0x10F3, 2, &[6]);
        let fault = HistoryFault::NoMessage { newest: 6 };
        assert_eq!(read(&rig, &history), Err(fault));
        device.set(0x10F3, 2, &[0]);
        for (subindex, wrong) in [(1, &[2, 0][..]), (2, &[0, 0]), (4, &[]), (5, &[0])] {
            let before = device.0.borrow().objects[&(0x10F3, subindex)].clone();
            device.set(0x10F3, subindex, wrong);
            let fault = read(&rig, &history);
            assert!(matches!(fault, Err(HistoryFault::Sdo(_))), "{fault:?}");
            device.set(0x10F3, subindex, &before);
        }
        // Two of three errors are there.
        device.set(0x1003, 0, &[3]);
        device.set(0x1003, 1, &[0x11, 0x86, 7, 0]);
        device.set(0x1003, 2, &[0x20, 0x32, 0, 0]);
        let fault = read(&rig, &history).unwrap_err();
        let missing = HistoryFault::Count {
            count: 3,
            missing: 3,
        };
        assert_eq!(fault, missing);
        assert!(fault.to_string().contains("1003h:03"), "{fault}");
        device.set(0x1003, 0, &[2]);
        let errors = read(&rig, &history).unwrap().errors.unwrap();
        assert_eq!(
            errors[0].to_string(),
            "8611h (following error), the maker's 0007h"
        );
        device.set(0x1003, 2, &[0x20, 0x32]);
        let fault = read(&rig, &history);
        assert!(
            matches!(fault, Err(HistoryFault::Sdo(SdoError::WrongSize { .. }))),
            "{fault:?}"
        );
    }

    #[test]
    fn a_ring_that_names_more_places_than_subindices_is_read_to_its_end() {
        let (rig, device, history) = drive();
        device.set(0x10F3, 1, &[255]);
        device.set(0x10F3, 2, &[255]);
        for subindex in 6..=255 {
            device.set(0x10F3, subindex, &message(0, &[]));
        }
        let messages = read(&rig, &history).unwrap().diagnosis.unwrap().messages;
        assert_eq!(messages.len(), 250);
    }

    #[test]
    fn clearing_writes_what_the_drive_has_and_reading_writes_nothing() {
        let (rig, device, history) = drive();
        read(&rig, &history).unwrap();
        assert_eq!(device.0.borrow().written, []);
        let clear = |history: &DriveHistory| {
            let history = history.clone();
            rig.run(async move { history.clear().await })
        };
        assert_eq!(clear(&history), Ok(()));
        let zeros = [(0x1003, 0, vec![0]), (0x10F3, 3, vec![0])];
        assert_eq!(device.0.borrow().written, zeros);
        // Acknowledged first, where only that is cleared.
        device.0.borrow_mut().written.clear();
        device.set(0x10F3, 5, &[0x10, 0]);
        device.set(0x10F3, 2, &[6]);
        assert_eq!(clear(&history), Ok(()));
        let [errors, all] = zeros;
        assert_eq!(
            device.0.borrow().written,
            [errors, (0x10F3, 3, vec![6]), all]
        );
        // A drive with neither.
        device.0.borrow_mut().objects.clear();
        let nothing = HistoryRecord {
            errors: None,
            diagnosis: None,
        };
        assert_eq!(read(&rig, &history), Ok(nothing));
    }
}
