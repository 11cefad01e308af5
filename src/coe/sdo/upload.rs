//! The reading of an object (SDO upload).

use alloc::vec::Vec;

use super::reply::{Reply, UPLOAD, UPLOAD_SEGMENT};
use super::{LONGEST_OBJECT, Phase, SDO_LENGTH, SHORTEST_SEGMENT, SdoFault, Step};
use crate::coe::object::ObjectAddress;

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

    /// The object.
    #[must_use]
    pub const fn object(&self) -> ObjectAddress {
        self.object
    }

    /// Read all subindices from the object's one on in one transfer.
    #[must_use]
    pub const fn complete_access(mut self) -> Self {
        self.complete_access = true;
        self
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

    /// How many bytes have come.
    #[must_use]
    pub const fn received(&self) -> usize {
        self.data.len()
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
                expected: "an upload reply that shows its size",
                got: reply.command,
            }),
        }
    }

    fn segment(&mut self, reply: &Reply<'_>, toggle: bool) -> Result<Step, SdoFault> {
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
            return Ok(Step::Done);
        }
        self.phase = Phase::Segments { toggle: !toggle };
        Ok(Step::More)
    }
}
