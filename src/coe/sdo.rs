//! SDO transfers as state machines without I/O: expedited, normal and segmented, both ways. The bytes are those behind the CoE
//! header of a message (ETG.1000.6 and CiA 301, SDO).
//!
//! The caller sends [`Upload::request`] or [`Download::append_request`], hands each SDO reply to [`Upload::feed`], and repeats this
//! while that says [`TransferStep::More`]. Nothing that a device sends makes them panic, go on without end or grow beyond a bound. An
//! upload holds at most four times the bytes that came beside the buffer that it was given, whatever length they announce. It takes
//! [`LONGEST_OBJECT`] bytes at most. Every segment must bring data. A download holds at most three times what it writes.

use alloc::vec::Vec;

use super::error::AbortCode;
use super::mailbox::{COE_HEADER_LENGTH, CutMessage, HEADER_LENGTH, SHORTEST_MAILBOX};
use super::object::ObjectAddress;

/// Bytes of an SDO without further data.
const SDO_LENGTH: usize = 8;
/// Data bytes of the shortest segment, which is padded to them.
const SHORTEST_SEGMENT: usize = 7;
/// The longest object that is read: no device's dictionary is known to hold a longer one.
pub const LONGEST_OBJECT: usize = 1 << 20;

/// What a reply brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TransferStep {
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
    Cut(#[from] CutMessage),
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

// The reading of an object (SDO upload).

/// The reading of one object.
///
/// ```
/// use servocrab::coe::{ObjectAddress, sdo::{TransferStep, Upload}};
///
/// let mut upload = Upload::new(ObjectAddress::new(0x6041, 0));
/// assert_eq!(upload.request(), [0x40, 0x41, 0x60, 0, 0, 0, 0, 0]);
/// let step = upload.feed(&[0x4B, 0x41, 0x60, 0, 0x37, 0x16, 0, 0])?;
/// assert_eq!((step, upload.into_data()), (TransferStep::Done, vec![0x37, 0x16]));
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

/// What both transfers say of their object.
macro_rules! of_object {
    ($transfer:ident) => {
        impl $transfer {
            /// The object.
            #[must_use]
            pub const fn object(&self) -> ObjectAddress {
                self.object
            }

            /// Transfers all subindices from the object's one on at once.
            #[must_use]
            pub const fn complete_access(mut self) -> Self {
                self.complete_access = true;
                self
            }

            /// Whether it transfers all subindices from the object's one on.
            #[must_use]
            pub const fn is_complete_access(&self) -> bool {
                self.complete_access
            }
        }
    };
}

of_object!(Upload);
of_object!(Download);

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

    /// The object's width in bytes, used where a device's expedited reply does not show it.
    #[must_use]
    pub const fn width(mut self, bytes: usize) -> Self {
        self.width = Some(bytes);
        self
    }

    /// Puts the object's bytes into `buffer`, in place of what it holds: nothing is allocated as long as they fit.
    #[must_use]
    pub fn with_buffer(mut self, mut buffer: Vec<u8>) -> Self {
        buffer.clear();
        self.data = buffer;
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
    pub fn feed(&mut self, reply: &[u8]) -> Result<TransferStep, SdoFault> {
        let reply = Reply::parse(reply)?;
        if let Some(step) = reply.common(self.object)? {
            return Ok(step);
        }
        match (self.phase, reply.specifier()) {
            (Phase::Initiate, UPLOAD) if reply.names(self.object) => self.initiated(&reply),
            (Phase::Segments { toggle }, UPLOAD_SEGMENT) => self.segment(&reply, toggle),
            _ => Ok(TransferStep::Foreign),
        }
    }

    /// Whether segments follow the first reply.
    #[must_use]
    pub const fn is_segmented(&self) -> bool {
        matches!(self.phase, Phase::Segments { .. })
    }

    /// How many bytes have come.
    #[must_use]
    pub const fn received(&self) -> usize {
        self.data.len()
    }

    /// The object's bytes; complete once [`Upload::feed`] said [`TransferStep::Done`].
    #[must_use]
    pub fn into_data(self) -> Vec<u8> {
        self.data
    }

    fn initiated(&mut self, reply: &Reply<'_>) -> Result<TransferStep, SdoFault> {
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
                Ok(TransferStep::Done)
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
                    return Ok(TransferStep::Done);
                }
                self.phase = Phase::Segments { toggle: false };
                Ok(TransferStep::More)
            }
            (false, false) => Err(SdoFault::Unexpected {
                expected: "an upload reply that shows its size",
                got: reply.command,
            }),
        }
    }

    fn segment(&mut self, reply: &Reply<'_>, toggle: bool) -> Result<TransferStep, SdoFault> {
        reply.check_toggle(toggle)?;
        let last = reply.command & 1 != 0;
        // The number of unused bytes counts for the shortest segment only; a longer one fills its message.
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
            return Ok(TransferStep::Done);
        }
        self.phase = Phase::Segments { toggle: !toggle };
        Ok(TransferStep::More)
    }
}

// The writing of an object (SDO download).

/// The writing of one object.
///
/// ```
/// use servocrab::coe::{ObjectAddress, sdo::{Download, TransferStep}};
///
/// let mut download = Download::new(ObjectAddress::new(0x6068, 0), vec![10, 0], 128);
/// let mut request = Vec::new();
/// download.append_request(&mut request);
/// assert_eq!(request, [0x2B, 0x68, 0x60, 0, 10, 0, 0, 0]);
/// assert_eq!(download.feed(&[0x60, 0x68, 0x60, 0, 0, 0, 0, 0])?, TransferStep::Done);
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

    /// The bytes that it writes.
    #[must_use]
    pub fn into_data(self) -> Vec<u8> {
        self.data
    }

    /// Whether the first request carries all data, so that the device writes the object when it takes that one.
    #[must_use]
    pub fn fits_one_message(&self) -> bool {
        self.is_expedited() || self.data.len() + SDO_LENGTH <= self.room
    }

    /// Appends the next request; the same one until a reply to it was fed.
    pub fn append_request(&self, request: &mut Vec<u8>) {
        let part = self.part();
        if let Phase::Segments { toggle } = self.phase {
            let last = self.sent + part.len() == self.data.len();
            let unused = SHORTEST_SEGMENT.saturating_sub(part.len());
            request.push(u8::from(toggle) << 4 | (unused as u8) << 1 | u8::from(last));
            request.extend_from_slice(part);
            request.resize(request.len() + unused, 0);
            return;
        }
        let complete = u8::from(self.complete_access) << 4;
        let [i0, i1] = self.object.index.to_le_bytes();
        let address = [i0, i1, self.object.subindex];
        if self.is_expedited() {
            let unused = 4 - self.data.len();
            request.push(0x23 | complete | (unused as u8) << 2);
            request.extend_from_slice(&address);
            request.extend_from_slice(&self.data);
            request.resize(request.len() + unused, 0);
        } else {
            let size = u32::try_from(self.data.len()).unwrap_or(u32::MAX);
            request.push(0x21 | complete);
            request.extend_from_slice(&address);
            request.extend_from_slice(&size.to_le_bytes());
            request.extend_from_slice(part);
        }
    }

    /// Takes one SDO reply.
    ///
    /// # Errors
    /// [`SdoFault`]: the device aborted, or the reply breaks the protocol. The transfer is then over.
    pub fn feed(&mut self, reply: &[u8]) -> Result<TransferStep, SdoFault> {
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
            _ => return Ok(TransferStep::Foreign),
        };
        self.sent += self.part().len();
        if self.sent == self.data.len() {
            self.phase = Phase::Done;
            return Ok(TransferStep::Done);
        }
        self.phase = Phase::Segments { toggle: next };
        Ok(TransferStep::More)
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

// The fields and rules that all replies of an SDO server share.

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
    fn parse(reply: &'a [u8]) -> Result<Self, CutMessage> {
        match *reply {
            [command, i0, i1, subindex, d0, d1, d2, d3, ref rest @ ..] => Ok(Self {
                command,
                object: ObjectAddress::new(u16::from_le_bytes([i0, i1]), subindex),
                data: [d0, d1, d2, d3],
                rest,
            }),
            _ => Err(CutMessage {
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
    fn common(&self, object: ObjectAddress) -> Result<Option<TransferStep>, SdoFault> {
        match self.specifier() {
            ABORT if self.names(object) => {
                Err(SdoFault::Aborted(AbortCode(u32::from_le_bytes(self.data))))
            }
            ABORT => Ok(Some(TransferStep::Foreign)),
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

#[cfg(test)]
mod tests {
    use alloc::vec;
    use alloc::vec::Vec;

    use proptest::prelude::*;

    use super::*;

    // Dialogues of SDO transfers. Bytes named AKD are from the public ethercrab repository,
    // dumps/soem-sdinfo-akd.pcapng; bytes named SOEM are requests that SOEM sent to a simulated drive.

    const NAME: ObjectAddress = ObjectAddress::new(0x1008, 0);

    fn object(index: u16, subindex: u8) -> ObjectAddress {
        ObjectAddress::new(index, subindex)
    }

    /// The bytes of a normal upload's first reply: size and what fits.
    fn normal(object: ObjectAddress, size: u32, data: &[u8]) -> Vec<u8> {
        let mut reply = vec![0x41];
        reply.extend(object.index.to_le_bytes());
        reply.push(object.subindex);
        reply.extend(size.to_le_bytes());
        reply.extend(data);
        reply
    }

    /// A device that serves `data` in messages of `mailbox` bytes, written from the standard's tables.
    fn serve_upload(
        object: ObjectAddress,
        data: &[u8],
        mailbox: usize,
    ) -> Result<Vec<u8>, SdoFault> {
        let mut upload = Upload::new(object);
        let first = data.len().min(mailbox - 16);
        let mut sent = first;
        let mut step = upload.feed(&normal(object, data.len() as u32, &data[..first]))?;
        let mut toggle = 0;
        while step == TransferStep::More {
            assert_eq!(upload.request(), [0x60 | toggle << 4, 0, 0, 0, 0, 0, 0, 0]);
            let part = (data.len() - sent).min(mailbox - 9);
            let last = u8::from(sent + part == data.len());
            let unused = 7usize.saturating_sub(part);
            let mut reply = vec![toggle << 4 | (unused as u8) << 1 | last];
            reply.extend(&data[sent..sent + part]);
            reply.extend(vec![0; unused]);
            step = upload.feed(&reply)?;
            sent += part;
            toggle ^= 1;
        }
        assert_eq!(step, TransferStep::Done);
        Ok(upload.into_data())
    }

    fn request_of(download: &Download) -> Vec<u8> {
        let mut request = Vec::new();
        download.append_request(&mut request);
        request
    }

    /// A device that takes a download apart again.
    fn serve_download(object: ObjectAddress, data: Vec<u8>, mailbox: usize) -> Vec<u8> {
        let mut download = Download::new(object, data, mailbox);
        let [i0, i1] = object.index.to_le_bytes();
        let request = request_of(&download);
        assert!(request.len() + 8 <= mailbox);
        assert_eq!(request[1..4], [i0, i1, object.subindex]);
        let mut got = if request[0] & 2 != 0 {
            request[4..8 - usize::from(request[0] >> 2 & 3)].to_vec()
        } else {
            request[8..].to_vec()
        };
        let mut step = download
            .feed(&[0x60, i0, i1, object.subindex, 0, 0, 0, 0])
            .unwrap();
        let mut toggle = 0;
        while step == TransferStep::More {
            let request = request_of(&download);
            assert!((8..=mailbox - 8).contains(&request.len()));
            assert_eq!(request[0] & 0xF0, toggle << 4);
            let unused = if request.len() == 8 {
                usize::from(request[0] >> 1 & 7)
            } else {
                0
            };
            got.extend(&request[1..request.len() - unused]);
            step = download
                .feed(&[0x20 | toggle << 4, 0, 0, 0, 0, 0, 0, 0])
                .unwrap();
            assert_eq!(step == TransferStep::Done, request[0] & 1 == 1);
            toggle ^= 1;
        }
        got
    }

    #[test]
    fn an_expedited_upload_of_a_real_akd_gives_its_bytes() {
        // 1C00h:3 = 3, 1C12h:1 = 1600h, 1600h:1 = 60400010h of a real AKD.
        for (address, reply, expected) in [
            (
                object(0x1C00, 3),
                [0x4F, 0x00, 0x1C, 3, 3, 0, 0, 0],
                &[3][..],
            ),
            (
                object(0x1C12, 1),
                [0x4B, 0x12, 0x1C, 1, 0, 0x16, 0, 0],
                &[0, 0x16],
            ),
            (
                object(0x1600, 1),
                [0x43, 0x00, 0x16, 1, 0x10, 0, 0x40, 0x60],
                &[0x10, 0, 0x40, 0x60],
            ),
        ] {
            let mut upload = Upload::new(address);
            assert_eq!(upload.request()[..4], [0x40, reply[1], reply[2], reply[3]]);
            assert_eq!(upload.feed(&reply), Ok(TransferStep::Done));
            assert_eq!(upload.into_data(), expected);
        }
    }

    #[test]
    fn a_normal_upload_in_one_message_is_complete_at_once() {
        let mut upload = Upload::new(NAME);
        assert_eq!(
            upload.feed(&normal(NAME, 6, b"PP-SIM")),
            Ok(TransferStep::Done),
            "a device name as a simulated drive sent it to SOEM"
        );
        assert_eq!(upload.into_data(), b"PP-SIM");
    }

    #[test]
    fn an_expedited_reply_without_size_has_the_width_of_the_object() {
        let mut upload = Upload::new(object(0x6041, 0)).width(2);
        assert_eq!(
            upload.feed(&[0x42, 0x41, 0x60, 0, 0x37, 0x16, 0xEE, 0xEE]),
            Ok(TransferStep::Done)
        );
        assert_eq!(upload.into_data(), [0x37, 0x16]);
    }

    #[test]
    fn expedited_downloads_are_written_as_soem_writes_them() {
        // SOEM: 6081h = 200 000 as 23 81 60 00 40 0D 03 00.
        let download = Download::new(object(0x6081, 0), vec![0x40, 0x0D, 3, 0], 128);
        assert_eq!(
            request_of(&download),
            [0x23, 0x81, 0x60, 0, 0x40, 0x0D, 3, 0]
        );
        let one = Download::new(object(0x6060, 0), vec![1], 128);
        assert_eq!(request_of(&one), [0x2F, 0x60, 0x60, 0, 1, 0, 0, 0]);
        let two = Download::new(object(0x6068, 0), vec![10, 0], 128);
        assert_eq!(request_of(&two)[0], 0x2B);
        let three = Download::new(object(0x2000, 0), vec![1, 2, 3], 128);
        assert_eq!(request_of(&three)[0], 0x27);
    }

    #[test]
    fn a_segmented_download_is_cut_as_soem_cuts_it() {
        // SOEM writes 300 bytes through a mailbox of 128: 21 … 2C 01 00 00 and 112 bytes, 00 and 119 bytes,
        // 11 and 69 bytes.
        let mut download = Download::new(object(0x2001, 0), vec![0x7A; 300], 128);
        let first = request_of(&download);
        assert_eq!(first[..8], [0x21, 0x01, 0x20, 0, 0x2C, 1, 0, 0]);
        assert_eq!(first.len(), 120);
        assert_eq!(
            download.feed(&[0x60, 0x01, 0x20, 0, 0, 0, 0, 0]),
            Ok(TransferStep::More)
        );
        let second = request_of(&download);
        assert_eq!((second[0], second.len()), (0x00, 120));
        assert_eq!(
            download.feed(&[0x20, 0, 0, 0, 0, 0, 0, 0]),
            Ok(TransferStep::More)
        );
        let third = request_of(&download);
        assert_eq!((third[0], third.len()), (0x11, 70));
        assert_eq!(
            download.feed(&[0x30, 0, 0, 0, 0, 0, 0, 0]),
            Ok(TransferStep::Done)
        );
    }

    #[test]
    fn downloads_at_the_boundaries_of_a_mailbox_have_the_stated_bytes() {
        // ETG.1000.6, download SDO segment request: bit 4 toggle, bits 1 to 3 unused bytes of seven, bit 0 last. Through a
        // mailbox of 128 go 112 bytes in the first message and 119 in each segment. Of each further message: command, length.
        for (length, messages) in [
            (111usize, &[][..]),
            (112, &[]),
            (113, &[(0x0Du8, 8usize)]),
            (118, &[(0x03, 8)]),
            (119, &[(0x01, 8)]),
            (120, &[(0x01, 9)]),
            (230, &[(0x01, 119)]),
            (231, &[(0x01, 120)]),
            (232, &[(0x00, 120), (0x1D, 8)]),
            (350, &[(0x00, 120), (0x11, 120)]),
            (351, &[(0x00, 120), (0x10, 120), (0x0D, 8)]),
        ] {
            let data: Vec<u8> = (0..length).map(|at| at as u8).collect();
            let mut download = Download::new(object(0x2001, 0), data.clone(), 128);
            let first = request_of(&download);
            let [l0, l1, l2, l3] = (length as u32).to_le_bytes();
            assert_eq!(first[..8], [0x21, 0x01, 0x20, 0, l0, l1, l2, l3]);
            assert_eq!(first[8..], data[..length.min(112)]);
            let mut step = download.feed(&[0x60, 0x01, 0x20, 0, 0, 0, 0, 0]).unwrap();
            let mut sent = first.len() - 8;
            for (at, (command, bytes)) in messages.iter().enumerate() {
                assert_eq!(step, TransferStep::More);
                let segment = request_of(&download);
                assert_eq!((segment[0], segment.len()), (*command, *bytes), "{length}");
                let part = (length - sent).min(119);
                assert_eq!(segment[1..=part], data[sent..sent + part]);
                assert!(segment[part + 1..].iter().all(|byte| *byte == 0));
                sent += part;
                let confirmation = [0x20 | (at as u8 & 1) << 4, 0, 0, 0, 0, 0, 0, 0];
                step = download.feed(&confirmation).unwrap();
            }
            assert_eq!((step, sent), (TransferStep::Done, length));
        }
    }

    #[test]
    fn the_same_segments_are_understood_as_answers() {
        for (length, command, bytes) in [
            (113, 0x0D, 8),
            (118, 0x03, 8),
            (119, 0x01, 8),
            (120, 0x01, 9),
        ] {
            let data: Vec<u8> = (0..length).collect();
            let mut upload = Upload::new(NAME);
            let first = normal(NAME, u32::from(length), &data[..112]);
            assert_eq!(upload.feed(&first), Ok(TransferStep::More));
            assert_eq!(upload.request(), [0x60, 0, 0, 0, 0, 0, 0, 0]);
            let mut segment = [&[command], &data[112..]].concat();
            segment.resize(bytes, 0);
            assert_eq!(upload.feed(&segment), Ok(TransferStep::Done), "{length}");
            assert_eq!(upload.into_data(), data);
        }
    }

    #[test]
    fn an_upload_whose_first_reply_has_no_data_comes_by_segments_alone() {
        // A simulated drive recorded with SOEM: 41 01 20 00 2C 01 00 00, then segments of 119, 119 and 62 bytes.
        let mut upload = Upload::new(object(0x2001, 0));
        assert_eq!(
            upload.feed(&[0x41, 0x01, 0x20, 0, 0x2C, 1, 0, 0]),
            Ok(TransferStep::More)
        );
        let segment = |command: u8, length: usize| {
            let mut segment = vec![b'z'; length + 1];
            segment[0] = command;
            segment
        };
        assert_eq!(upload.feed(&segment(0x00, 119)), Ok(TransferStep::More));
        assert_eq!(upload.feed(&segment(0x10, 119)), Ok(TransferStep::More));
        assert_eq!(upload.feed(&segment(0x01, 62)), Ok(TransferStep::Done));
        assert_eq!(upload.into_data().len(), 300);
    }

    #[test]
    fn the_shortest_segment_tells_how_many_bytes_it_has() {
        // The last segment of 600 bytes recorded with SOEM: 15 "56789" 0 0, five of seven bytes used.
        let mut upload = Upload::new(object(0x2000, 0));
        assert_eq!(
            upload.feed(&normal(object(0x2000, 0), 12, b"")),
            Ok(TransferStep::More)
        );
        assert_eq!(upload.feed(b"\x000123456"), Ok(TransferStep::More));
        assert_eq!(upload.feed(b"\x1556789\0\0"), Ok(TransferStep::Done));
        assert_eq!(upload.into_data(), b"012345656789");
    }

    #[test]
    fn transfers_at_every_boundary_arrive_whole() {
        for mailbox in [16, 17, 23, 24, 64] {
            for length in 0..80 {
                let data: Vec<u8> = (0..length).collect();
                assert_eq!(
                    serve_upload(NAME, &data, mailbox),
                    Ok(data.clone()),
                    "upload of {length} bytes, mailbox {mailbox}"
                );
                assert_eq!(
                    serve_download(NAME, data.clone(), mailbox),
                    data,
                    "download of {length} bytes, mailbox {mailbox}"
                );
            }
        }
    }

    #[test]
    fn complete_access_sets_its_bit() {
        let entry = object(0x1C12, 1);
        assert_eq!(Upload::new(entry).complete_access().request()[0], 0x50);
        let download = Download::new(entry, vec![0; 8], 128).complete_access();
        assert_eq!(request_of(&download)[0], 0x31);
    }

    #[test]
    fn an_abort_ends_the_transfer_with_its_code() {
        // A simulated drive recorded with SOEM: 5555h does not exist.
        let reply = [0x80, 0x55, 0x55, 0, 0, 0, 2, 6];
        let mut upload = Upload::new(object(0x5555, 0));
        assert_eq!(
            upload.feed(&reply),
            Err(SdoFault::Aborted(AbortCode::NO_OBJECT))
        );
        let mut download = Download::new(object(0x5555, 0), vec![1], 128);
        assert_eq!(
            download.feed(&reply),
            Err(SdoFault::Aborted(AbortCode::NO_OBJECT))
        );
    }

    #[test]
    fn an_abort_with_request_flags_left_in_it_is_still_an_abort() {
        let mut upload = Upload::new(object(0x1018, 9)).complete_access();
        assert_eq!(
            upload.feed(&[0x90, 0x18, 0x10, 9, 0x11, 0, 9, 6]),
            Err(SdoFault::Aborted(AbortCode::NO_SUBINDEX))
        );
    }

    #[test]
    fn replies_of_other_requests_are_foreign() {
        let mut upload = Upload::new(object(0x6041, 0));
        for late in [
            [0x4B, 0x40, 0x60, 0, 6, 0, 0, 0],
            [0x4B, 0x41, 0x60, 1, 6, 0, 0, 0],
            [0x60, 0x41, 0x60, 0, 0, 0, 0, 0],
            [0x80, 0x40, 0x60, 0, 0, 0, 2, 6],
            [0x01, 1, 2, 3, 4, 5, 6, 7],
            [0x20, 0, 0, 0, 0, 0, 0, 0],
        ] {
            assert_eq!(upload.feed(&late), Ok(TransferStep::Foreign), "{late:02X?}");
        }
        assert_eq!(
            upload.feed(&[0x4B, 0x41, 0x60, 0, 0x37, 2, 0, 0]),
            Ok(TransferStep::Done),
            "the transfer is unharmed"
        );
        let mut download = Download::new(object(0x6060, 0), vec![1], 128);
        for late in [
            [0x4F, 0x60, 0x60, 0, 1, 0, 0, 0],
            [0x60, 0x81, 0x60, 0, 0, 0, 0, 0],
        ] {
            assert_eq!(
                download.feed(&late),
                Ok(TransferStep::Foreign),
                "{late:02X?}"
            );
        }
    }

    #[test]
    fn a_wrong_toggle_bit_is_an_error_in_both_directions() {
        let mut upload = Upload::new(NAME);
        assert_eq!(upload.feed(&normal(NAME, 20, b"")), Ok(TransferStep::More));
        let wrong = SdoFault::Toggle {
            expected: 0,
            got: 1,
        };
        assert_eq!(upload.feed(b"\x100123456"), Err(wrong));
        assert_eq!(wrong.abort_code(), Some(AbortCode::TOGGLE));

        let mut download = Download::new(NAME, vec![0; 20], 16);
        assert_eq!(
            download.feed(&[0x60, 0x08, 0x10, 0, 0, 0, 0, 0]),
            Ok(TransferStep::More)
        );
        assert_eq!(
            download.feed(&[0x20, 0, 0, 0, 0, 0, 0, 0]),
            Ok(TransferStep::More)
        );
        assert_eq!(
            download.feed(&[0x20, 0, 0, 0, 0, 0, 0, 0]),
            Err(SdoFault::Toggle {
                expected: 1,
                got: 0
            })
        );
    }

    #[test]
    fn lengths_that_are_not_as_announced_are_errors() {
        let mut short = Upload::new(NAME);
        assert_eq!(short.feed(&normal(NAME, 20, b"")), Ok(TransferStep::More));
        assert_eq!(
            short.feed(b"\x010123456"),
            Err(SdoFault::Size {
                expected: 20,
                got: 7
            })
        );
        let mut long = Upload::new(NAME);
        assert_eq!(long.feed(&normal(NAME, 5, b"")), Ok(TransferStep::More));
        assert_eq!(
            long.feed(b"\x000123456"),
            Err(SdoFault::Size {
                expected: 5,
                got: 7
            })
        );
        let mut endless = Upload::new(NAME);
        assert!(matches!(
            endless.feed(&normal(NAME, u32::MAX, b"")),
            Err(SdoFault::Size { .. })
        ));
    }

    #[test]
    fn empty_segments_without_end_are_refused() {
        let mut upload = Upload::new(NAME);
        assert_eq!(upload.feed(&normal(NAME, 5, b"")), Ok(TransferStep::More));
        assert!(matches!(
            upload.feed(&[0x0E, 0, 0, 0, 0, 0, 0, 0]),
            Err(SdoFault::Unexpected { got: 0x0E, .. })
        ));
    }

    #[test]
    fn every_truncation_of_every_reply_is_an_error() {
        for whole in [
            [0x4B, 0x41, 0x60, 0, 0x37, 2, 0, 0],
            [0x80, 0x41, 0x60, 0, 0, 0, 2, 6],
            [0x60, 0x41, 0x60, 0, 0, 0, 0, 0],
            [0x20, 0, 0, 0, 0, 0, 0, 0],
            [0x01, 1, 2, 3, 4, 5, 6, 7],
        ] {
            for got in 0..whole.len() {
                let cut = Err(SdoFault::Cut(CutMessage { needed: 8, got }));
                assert_eq!(Upload::new(object(0x6041, 0)).feed(&whole[..got]), cut);
                assert_eq!(
                    Download::new(object(0x6041, 0), vec![1], 64).feed(&whole[..got]),
                    cut
                );
            }
        }
    }

    #[test]
    fn the_masters_abort_names_the_object() {
        assert_eq!(
            abort_request(object(0x2001, 3), AbortCode::TIME_OUT),
            [0x80, 0x01, 0x20, 3, 0, 0, 4, 5]
        );
    }

    proptest! {
        #[test]
        fn any_data_survives_any_mailbox(data in prop::collection::vec(any::<u8>(), 0..600), mailbox in 16usize..200) {
            prop_assert_eq!(serve_upload(NAME, &data, mailbox), Ok(data.clone()));
            prop_assert_eq!(serve_download(NAME, data.clone(), mailbox), data);
        }

        #[test]
        fn no_replies_make_a_transfer_panic(replies in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 0..20)) {
            let mut upload = Upload::new(NAME);
            let _ = upload.feed(&normal(NAME, 100, b""));
            let mut download = Download::new(NAME, vec![7; 100], 20);
            let _ = download.feed(&[0x60, 0x08, 0x10, 0, 0, 0, 0, 0]);
            for reply in replies {
                let _ = (upload.feed(&reply), download.feed(&reply));
                prop_assert!(upload.clone().into_data().len() <= 100);
                prop_assert!(!request_of(&download).is_empty());
            }
        }
    }
}
