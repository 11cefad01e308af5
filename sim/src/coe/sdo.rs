//! The SDO server: uploads and downloads, in one message or in segments.
//! Payload behind the CoE header: command byte, index, subindex and data; of a segment, command byte and data
//! (ETG.1000.6).

use crate::frame::{read_u16, read_u32};
use crate::mailbox::MailError;

use super::{Abort, MINIMUM, Objects, SERVICE_SDO_REQUEST, SERVICE_SDO_RESPONSE, complete, head};

/// CoE header, command, index, subindex and size of a normal transfer.
const NORMAL_HEAD: usize = 10;
/// CoE header and command of a segment.
const SEGMENT_HEAD: usize = 3;
/// Data bytes that a segment has at least room for.
const SEGMENT_MINIMUM: usize = 7;

/// Complete access, in an initiating command and in the reply to it.
const COMPLETE_ACCESS: u8 = 0x10;
/// Toggle bit, in a segment.
const TOGGLE: u8 = 0x10;
/// Last segment.
const LAST: u8 = 0x01;

/// What a transfer is about.
#[derive(Clone, Copy, Debug)]
struct Target {
    index: u16,
    /// With complete access, the first one.
    subindex: u8,
    complete: bool,
}

impl Target {
    /// The bit of an initiating command and of the reply to it.
    fn complete_bit(self) -> u8 {
        if self.complete { COMPLETE_ACCESS } else { 0 }
    }

    fn refuse(self, abort: Abort) -> (u16, u8, Abort) {
        (self.index, self.subindex, abort)
    }

    fn upload(self, objects: &dyn Objects) -> Result<Vec<u8>, Abort> {
        if self.complete {
            complete::upload(objects, self.index, self.subindex)
        } else {
            objects.upload(self.index, self.subindex)
        }
    }

    fn room(self, objects: &dyn Objects) -> Result<usize, Abort> {
        if self.complete {
            complete::room(objects, self.index, self.subindex)
        } else {
            objects.room(self.index, self.subindex)
        }
    }

    fn download(self, objects: &mut dyn Objects, data: &[u8]) -> Result<(), Abort> {
        if self.complete {
            complete::download(objects, self.index, self.subindex, data)
        } else {
            objects.download(self.index, self.subindex, data)
        }
    }
}

/// A transfer in segments that has begun.
#[derive(Clone, Debug)]
enum Transfer {
    Upload {
        target: Target,
        rest: Vec<u8>,
        toggle: u8,
    },
    Download {
        target: Target,
        data: Vec<u8>,
        size: usize,
        toggle: u8,
    },
}

/// The SDO server.
#[derive(Clone, Debug)]
pub(super) struct Server {
    transfer: Option<Transfer>,
    /// Payload bytes of the longest reply, not fewer than a segment takes.
    pub(super) longest: usize,
    offers_complete_access: bool,
}

impl Server {
    pub(super) fn new(offers_complete_access: bool) -> Self {
        Self {
            transfer: None,
            longest: MINIMUM,
            offers_complete_access,
        }
    }

    /// Serves the payload of one SDO request.
    pub(super) fn serve(
        &mut self,
        payload: &[u8],
        objects: &mut dyn Objects,
    ) -> Result<Option<Vec<u8>>, MailError> {
        let (Some(command), Some(index), Some(subindex), Some(data)) = (
            payload.get(2),
            read_u16(payload, 3),
            payload.get(5),
            payload.get(6..),
        ) else {
            return Err(MailError::TooShort);
        };
        if payload.len() < MINIMUM {
            return Err(MailError::TooShort);
        }
        let target = Target {
            index,
            subindex: *subindex,
            complete: command & COMPLETE_ACCESS != 0,
        };
        let result = match command >> 5 {
            0 => self.download_segment(
                *command,
                payload.get(SEGMENT_HEAD..).unwrap_or(&[]),
                objects,
            ),
            1 => self.initiate_download(target, *command, data, objects),
            2 => self.initiate_upload(target, objects),
            3 => self.upload_segment(*command),
            // The MainDevice gives the transfer up; there is nothing to answer.
            4 => {
                self.transfer = None;
                return Ok(None);
            }
            _ => Err((index, *subindex, Abort::Command)),
        };
        Ok(Some(result.unwrap_or_else(|(index, subindex, abort)| {
            self.transfer = None;
            abort_payload(index, subindex, abort)
        })))
    }

    fn check(&self, target: Target) -> Result<(), Abort> {
        if target.complete && !self.offers_complete_access {
            return Err(Abort::CompleteAccess);
        }
        Ok(())
    }

    fn initiate_upload(&mut self, target: Target, objects: &mut dyn Objects) -> Reply {
        let refuse = |abort| target.refuse(abort);
        self.transfer = None;
        self.check(target).map_err(refuse)?;
        let mut data = target.upload(objects).map_err(refuse)?;
        if (1..=4).contains(&data.len()) {
            let unused = 4 - data.len() as u8;
            data.resize(4, 0);
            return Ok(initiated(0x43 | unused << 2, target, &data));
        }
        let mut bytes = u32::try_from(data.len())
            .unwrap_or(u32::MAX)
            .to_le_bytes()
            .to_vec();
        let rest = data.split_off(data.len().min(self.longest - NORMAL_HEAD));
        bytes.extend(data);
        if !rest.is_empty() {
            self.transfer = Some(Transfer::Upload {
                target,
                rest,
                toggle: 0,
            });
        }
        Ok(initiated(0x41, target, &bytes))
    }

    fn upload_segment(&mut self, command: u8) -> Reply {
        let Some(Transfer::Upload {
            target,
            rest,
            toggle,
        }) = &mut self.transfer
        else {
            return Err((0, 0, Abort::Command));
        };
        if command & TOGGLE != *toggle {
            return Err(target.refuse(Abort::Toggle));
        }
        let later = rest.split_off(rest.len().min(self.longest - SEGMENT_HEAD));
        let mut segment = core::mem::replace(rest, later);
        let last = if rest.is_empty() { LAST } else { 0 };
        // The command byte has room to say how many of seven bytes are unused; longer ones go by the message's length.
        let unused = SEGMENT_MINIMUM.saturating_sub(segment.len());
        segment.resize(segment.len().max(SEGMENT_MINIMUM), 0);
        let mut payload = head(SERVICE_SDO_RESPONSE, *toggle | (unused as u8) << 1 | last);
        payload.extend(segment);
        *toggle ^= TOGGLE;
        if last != 0 {
            self.transfer = None;
        }
        Ok(payload)
    }

    fn initiate_download(
        &mut self,
        target: Target,
        command: u8,
        data: &[u8],
        objects: &mut dyn Objects,
    ) -> Reply {
        let refuse = |abort| target.refuse(abort);
        self.transfer = None;
        self.check(target).map_err(refuse)?;
        let room = target.room(objects).map_err(refuse)?;
        if command & 0x02 != 0 {
            // Expedited; without size indication the object's own length counts.
            let length = if command & 0x01 != 0 {
                4 - usize::from(command >> 2 & 0x03)
            } else {
                room.min(4)
            };
            let data = data.get(..length).ok_or(refuse(Abort::TooShort))?;
            target.download(objects, data).map_err(refuse)?;
            return Ok(initiated(0x60, target, &[0; 4]));
        }
        let size = read_u32(data, 0)
            .and_then(|size| usize::try_from(size).ok())
            .ok_or(refuse(Abort::TooShort))?;
        let data = data.get(4..).unwrap_or(&[]);
        if size > room || data.len() > size {
            return Err(refuse(Abort::TooLong));
        }
        if data.len() == size {
            target.download(objects, data).map_err(refuse)?;
        } else {
            self.transfer = Some(Transfer::Download {
                target,
                data: data.to_vec(),
                size,
                toggle: 0,
            });
        }
        Ok(initiated(0x60, target, &[0; 4]))
    }

    fn download_segment(
        &mut self,
        command: u8,
        segment: &[u8],
        objects: &mut dyn Objects,
    ) -> Reply {
        let Some(Transfer::Download {
            target,
            data,
            size,
            toggle,
        }) = &mut self.transfer
        else {
            return Err((0, 0, Abort::Command));
        };
        let target = *target;
        let refuse = |abort| target.refuse(abort);
        if command & TOGGLE != *toggle {
            return Err(refuse(Abort::Toggle));
        }
        let unused = if segment.len() == SEGMENT_MINIMUM {
            usize::from(command >> 1 & 0x07)
        } else {
            0
        };
        data.extend(
            segment
                .get(..segment.len().saturating_sub(unused))
                .unwrap_or(&[]),
        );
        if data.len() > *size {
            return Err(refuse(Abort::TooLong));
        }
        let mut payload = head(SERVICE_SDO_RESPONSE, 0x20 | *toggle);
        *toggle ^= TOGGLE;
        if command & LAST != 0 {
            if data.len() < *size {
                return Err(refuse(Abort::TooShort));
            }
            target.download(objects, data).map_err(refuse)?;
            self.transfer = None;
        }
        payload.resize(MINIMUM, 0);
        Ok(payload)
    }
}

/// The payload of a reply, or what to abort and why.
type Reply = Result<Vec<u8>, (u16, u8, Abort)>;

/// The reply to an initiating request.
fn initiated(command: u8, target: Target, data: &[u8]) -> Vec<u8> {
    let mut payload = head(SERVICE_SDO_RESPONSE, command | target.complete_bit());
    payload.extend(target.index.to_le_bytes());
    payload.push(target.subindex);
    payload.extend(data);
    payload
}

/// An abort travels with the service number of a request in both directions, as the open SubDevice stack SOES sends it; not
/// confirmed on a drive.
pub(super) fn abort_payload(index: u16, subindex: u8, abort: Abort) -> Vec<u8> {
    let mut payload = head(SERVICE_SDO_REQUEST, 0x80);
    payload.extend(index.to_le_bytes());
    payload.push(subindex);
    payload.extend(abort.code().to_le_bytes());
    payload
}
