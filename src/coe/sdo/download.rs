//! The writing of an object (SDO download).

use alloc::vec::Vec;

use super::reply::{DOWNLOAD, DOWNLOAD_SEGMENT, Reply};
use super::{Phase, SDO_LENGTH, SHORTEST_SEGMENT, SdoFault, Step};
use crate::coe::mailbox::{COE_HEADER_LENGTH, HEADER_LENGTH, SHORTEST_MAILBOX};
use crate::coe::object::ObjectAddress;

/// The writing of one object.
///
/// ```
/// use servocrab::coe::{ObjectAddress, sdo::{Download, Step}};
///
/// let mut download = Download::new(ObjectAddress::new(0x6068, 0), vec![10, 0], 128);
/// let mut request = Vec::new();
/// download.append_request(&mut request);
/// assert_eq!(request, [0x2B, 0x68, 0x60, 0, 10, 0, 0, 0]);
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

    /// The object.
    #[must_use]
    pub const fn object(&self) -> ObjectAddress {
        self.object
    }

    /// Write all subindices from the object's one on in one transfer.
    #[must_use]
    pub const fn complete_access(mut self) -> Self {
        self.complete_access = true;
        self
    }

    /// Whether the first request carries all data, so that the device writes the object when it takes that one.
    #[must_use]
    pub fn fits_one_mail(&self) -> bool {
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
