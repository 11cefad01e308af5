//! SDO transfers as state machines without I/O: expedited, normal and segmented, both ways
//! (ETG.1000.6 and CiA 301, SDO; the bytes behind the CoE header of a mail).
//!
//! The caller sends [`Upload::request`], hands each SDO reply to [`Upload::feed`], and repeats this while
//! that says [`Step::More`]. Nothing that a device sends makes them panic or grow beyond a bound.

use alloc::vec::Vec;

use super::abort::AbortCode;
use super::mailbox::{COE_HEADER_LENGTH, CutMail, HEADER_LENGTH, SHORTEST_MAILBOX};
use super::object::ObjectAddress;

#[cfg(test)]
mod tests;

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
    /// The reply is shorter than its kind needs.
    #[error(transparent)]
    Cut(#[from] CutMail),
}

impl SdoFault {
    /// The abort code that tells the device of this fault; `None` if the device itself aborted.
    #[must_use]
    pub const fn abort_code(&self) -> Option<AbortCode> {
        match self {
            Self::Aborted(_) => None,
            Self::Toggle { .. } => Some(AbortCode::TOGGLE),
            Self::Unexpected { .. } | Self::Cut(_) => Some(AbortCode::COMMAND),
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

/// The reading of one object.
///
/// ```
/// use servocrab::coe::{ObjectAddress, sdo::{Step, Upload}};
///
/// let mut upload = Upload::new(ObjectAddress::new(0x6041, 0));
/// assert_eq!(upload.request(), [0x40, 0x41, 0x60, 0, 0, 0, 0, 0]);
/// let step = upload.feed(&[0x4B, 0x41, 0x60, 0, 0x37, 0x16, 0, 0])?;
/// assert_eq!((step, upload.into_data()), (Step::Done, vec![0x37, 0x16]));
/// # Ok::<(), servocrab::coe::sdo::SdoFault>(())
/// ```
#[derive(Debug, Clone)]
pub struct Upload {
    object: ObjectAddress,
    complete_access: bool,
    width: Option<usize>,
    announced: usize,
    data: Vec<u8>,
    phase: Phase,
}

impl Upload {
    /// The reading of `object`.
    #[must_use]
    pub const fn new(object: ObjectAddress) -> Self {
        Self {
            object,
            complete_access: false,
            width: None,
            announced: 0,
            data: Vec::new(),
            phase: Phase::Initiate,
        }
    }

    /// Read all subindices from the object's one on in one transfer.
    #[must_use]
    pub const fn complete_access(mut self) -> Self {
        self.complete_access = true;
        self
    }

    /// The object's width in bytes, used where a device's expedited reply does not tell it.
    #[must_use]
    pub const fn width(mut self, bytes: usize) -> Self {
        self.width = Some(bytes);
        self
    }

    /// The next request, eight bytes; the same one until a reply to it was fed.
    #[must_use]
    pub fn request(&self) -> [u8; SDO_LENGTH] {
        let [i0, i1] = self.object.index.to_le_bytes();
        match self.phase {
            Phase::Segments { toggle } => [0x60 | u8::from(toggle) << 4, 0, 0, 0, 0, 0, 0, 0],
            Phase::Initiate | Phase::Done => {
                let command = 0x40 | u8::from(self.complete_access) << 4;
                [command, i0, i1, self.object.subindex, 0, 0, 0, 0]
            }
        }
    }

    /// Takes one SDO reply.
    ///
    /// # Errors
    /// [`SdoFault`]: the device aborted, or the reply breaks the protocol. The transfer is then over.
    pub fn feed(&mut self, reply: &[u8]) -> Result<Step, SdoFault> {
        let reply = Reply::parse(reply)?;
        if let Some(step) = reply.common(self.object)? {
            return Ok(step);
        }
        match (self.phase, reply.specifier()) {
            (Phase::Initiate, UPLOAD) if reply.names(self.object) => self.initiated(&reply),
            (Phase::Segments { toggle }, UPLOAD_SEGMENT) => self.segment(&reply, toggle),
            _ => Ok(Step::Foreign),
        }
    }

    /// Whether segments follow the first reply.
    #[must_use]
    pub const fn is_segmented(&self) -> bool {
        matches!(self.phase, Phase::Segments { .. })
    }

    /// The object's bytes; complete once [`Upload::feed`] said [`Step::Done`].
    #[must_use]
    pub fn into_data(self) -> Vec<u8> {
        self.data
    }

    fn initiated(&mut self, reply: &Reply<'_>) -> Result<Step, SdoFault> {
        let (expedited, sized) = (reply.command & 2 != 0, reply.command & 1 != 0);
        match (expedited, sized) {
            (true, sized) => {
                let length = if sized {
                    4 - usize::from(reply.command >> 2 & 3)
                } else {
                    self.width.unwrap_or(4).min(4)
                };
                self.data.extend(reply.data.iter().take(length));
                self.phase = Phase::Done;
                Ok(Step::Done)
            }
            (false, true) => {
                let size = usize::try_from(u32::from_le_bytes(reply.data)).unwrap_or(usize::MAX);
                if size > LONGEST_OBJECT {
                    return Err(SdoFault::Size {
                        expected: LONGEST_OBJECT,
                        got: size,
                    });
                }
                self.announced = size;
                self.data.extend(reply.rest.iter().take(size));
                if self.data.len() == size {
                    self.phase = Phase::Done;
                    return Ok(Step::Done);
                }
                self.phase = Phase::Segments { toggle: false };
                Ok(Step::More)
            }
            (false, false) => Err(SdoFault::Unexpected {
                expected: "an upload reply that tells its size",
                got: reply.command,
            }),
        }
    }

    fn segment(&mut self, reply: &Reply<'_>, toggle: bool) -> Result<Step, SdoFault> {
        reply.check_toggle(toggle)?;
        let last = reply.command & 1 != 0;
        // The number of unused bytes counts for the shortest segment only; a longer one fills its mail.
        let unused = if reply.rest.is_empty() {
            usize::from(reply.command >> 1 & 7)
        } else {
            0
        };
        let length = SHORTEST_SEGMENT + reply.rest.len() - unused;
        let got = self.data.len() + length;
        if got > self.announced || (last && got != self.announced) {
            return Err(SdoFault::Size {
                expected: self.announced,
                got,
            });
        }
        if length == 0 && !last {
            return Err(SdoFault::Unexpected {
                expected: "a segment with data",
                got: reply.command,
            });
        }
        self.data.extend(reply.segment_data().take(length));
        if last {
            self.phase = Phase::Done;
            return Ok(Step::Done);
        }
        self.phase = Phase::Segments { toggle: !toggle };
        Ok(Step::More)
    }
}

/// The writing of one object.
///
/// ```
/// use servocrab::coe::{ObjectAddress, sdo::{Download, Step}};
///
/// let mut download = Download::new(ObjectAddress::new(0x6068, 0), vec![10, 0], 128);
/// assert_eq!(download.request(), [0x2B, 0x68, 0x60, 0, 10, 0, 0, 0]);
/// assert_eq!(download.feed(&[0x60, 0x68, 0x60, 0, 0, 0, 0, 0])?, Step::Done);
/// # Ok::<(), servocrab::coe::sdo::SdoFault>(())
/// ```
#[derive(Debug, Clone)]
pub struct Download {
    object: ObjectAddress,
    complete_access: bool,
    data: Vec<u8>,
    /// Bytes that an SDO may have in this mailbox.
    room: usize,
    /// Bytes that the device has confirmed.
    sent: usize,
    phase: Phase,
}

impl Download {
    /// The writing of `data` to `object` through a mailbox of `mailbox_length` bytes (sync manager 0).
    ///
    /// A mailbox that is too short for an SDO counts as one of 16 bytes.
    #[must_use]
    pub fn new(object: ObjectAddress, data: Vec<u8>, mailbox_length: usize) -> Self {
        Self {
            object,
            complete_access: false,
            data,
            room: mailbox_length.max(SHORTEST_MAILBOX) - HEADER_LENGTH - COE_HEADER_LENGTH,
            sent: 0,
            phase: Phase::Initiate,
        }
    }

    /// Write all subindices from the object's one on in one transfer.
    #[must_use]
    pub const fn complete_access(mut self) -> Self {
        self.complete_access = true;
        self
    }

    /// The next request; the same one until a reply to it was fed.
    #[must_use]
    pub fn request(&self) -> Vec<u8> {
        let part = self.part();
        if let Phase::Segments { toggle } = self.phase {
            let last = self.sent + part.len() == self.data.len();
            let unused = SHORTEST_SEGMENT.saturating_sub(part.len()) as u8;
            let mut request = Vec::with_capacity(1 + part.len() + usize::from(unused));
            request.push(u8::from(toggle) << 4 | unused << 1 | u8::from(last));
            request.extend_from_slice(part);
            request.resize(request.len() + usize::from(unused), 0);
            return request;
        }
        let complete = u8::from(self.complete_access) << 4;
        let [i0, i1] = self.object.index.to_le_bytes();
        let address = [i0, i1, self.object.subindex];
        let mut request = Vec::with_capacity(SDO_LENGTH + part.len());
        if self.is_expedited() {
            request.push(0x23 | complete | ((4 - self.data.len()) as u8) << 2);
            request.extend_from_slice(&address);
            request.extend_from_slice(&self.data);
            request.resize(SDO_LENGTH, 0);
        } else {
            let size = u32::try_from(self.data.len()).unwrap_or(u32::MAX);
            request.push(0x21 | complete);
            request.extend_from_slice(&address);
            request.extend_from_slice(&size.to_le_bytes());
            request.extend_from_slice(part);
        }
        request
    }

    /// Takes one SDO reply.
    ///
    /// # Errors
    /// [`SdoFault`]: the device aborted, or the reply breaks the protocol. The transfer is then over.
    pub fn feed(&mut self, reply: &[u8]) -> Result<Step, SdoFault> {
        let reply = Reply::parse(reply)?;
        if let Some(step) = reply.common(self.object)? {
            return Ok(step);
        }
        let next = match (self.phase, reply.specifier()) {
            (Phase::Initiate, DOWNLOAD) if reply.names(self.object) => false,
            (Phase::Segments { toggle }, DOWNLOAD_SEGMENT) => {
                reply.check_toggle(toggle)?;
                !toggle
            }
            _ => return Ok(Step::Foreign),
        };
        self.sent += self.part().len();
        if self.sent == self.data.len() {
            self.phase = Phase::Done;
            return Ok(Step::Done);
        }
        self.phase = Phase::Segments { toggle: next };
        Ok(Step::More)
    }

    /// Whether segments follow the first reply.
    #[must_use]
    pub const fn is_segmented(&self) -> bool {
        matches!(self.phase, Phase::Segments { .. })
    }

    fn is_expedited(&self) -> bool {
        (1..=4).contains(&self.data.len())
    }

    /// The data of the request that is due.
    fn part(&self) -> &[u8] {
        let left = self.data.get(self.sent..).unwrap_or_default();
        let room = match self.phase {
            Phase::Initiate if self.is_expedited() => 4,
            Phase::Initiate => self.room - SDO_LENGTH,
            Phase::Segments { .. } => self.room - 1,
            Phase::Done => 0,
        };
        left.get(..room).unwrap_or(left)
    }
}

/// Command specifiers of replies: bits 5 to 7 of the first byte.
const UPLOAD_SEGMENT: u8 = 0;
const DOWNLOAD_SEGMENT: u8 = 1;
const UPLOAD: u8 = 2;
const DOWNLOAD: u8 = 3;
const ABORT: u8 = 4;

/// The fields that all replies share.
struct Reply<'a> {
    command: u8,
    object: ObjectAddress,
    data: [u8; 4],
    rest: &'a [u8],
}

impl<'a> Reply<'a> {
    fn parse(reply: &'a [u8]) -> Result<Self, CutMail> {
        match *reply {
            [command, i0, i1, subindex, d0, d1, d2, d3, ref rest @ ..] => Ok(Self {
                command,
                object: ObjectAddress::new(u16::from_le_bytes([i0, i1]), subindex),
                data: [d0, d1, d2, d3],
                rest,
            }),
            _ => Err(CutMail {
                needed: SDO_LENGTH,
                got: reply.len(),
            }),
        }
    }

    fn specifier(&self) -> u8 {
        self.command >> 5
    }

    fn names(&self, object: ObjectAddress) -> bool {
        self.object == object
    }

    /// What every phase does alike: aborts, which name their object, and commands that answer nothing.
    fn common(&self, object: ObjectAddress) -> Result<Option<Step>, SdoFault> {
        match self.specifier() {
            ABORT if self.names(object) => {
                Err(SdoFault::Aborted(AbortCode(u32::from_le_bytes(self.data))))
            }
            ABORT => Ok(Some(Step::Foreign)),
            UPLOAD_SEGMENT..=DOWNLOAD => Ok(None),
            _ => Err(SdoFault::Unexpected {
                expected: "an SDO reply",
                got: self.command,
            }),
        }
    }

    fn check_toggle(&self, expected: bool) -> Result<(), SdoFault> {
        let got = self.command >> 4 & 1;
        if got == u8::from(expected) {
            return Ok(());
        }
        Err(SdoFault::Toggle {
            expected: u8::from(expected),
            got,
        })
    }

    /// The bytes behind the command, which in a segment are all data.
    fn segment_data(&self) -> impl Iterator<Item = u8> + use<'a> {
        let [i0, i1] = self.object.index.to_le_bytes();
        let head = [i0, i1, self.object.subindex];
        let (data, rest) = (self.data, self.rest);
        head.into_iter().chain(data).chain(rest.iter().copied())
    }
}
