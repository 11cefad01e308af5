//! CANopen over EtherCAT: the SDO server of a device, and the bytes of an emergency.
//! Payload of a CoE mail: number and service u16, then for an SDO the command byte, index u16, subindex and data.

mod abort;

pub use abort::Abort;

use crate::frame::{read_u16, read_u32};
use crate::mailbox::{HEADER, MailError};

const SERVICE_EMERGENCY: u16 = 1;
const SERVICE_SDO_REQUEST: u16 = 2;
const SERVICE_SDO_RESPONSE: u16 = 3;
/// CoE header and SDO: no mail is shorter.
const MINIMUM: usize = 10;
/// CoE header, command, index, subindex and size of a normal transfer.
const NORMAL_HEAD: usize = 10;
/// CoE header and command of a segment.
const SEGMENT_HEAD: usize = 3;
/// Data bytes that a segment has at least room for.
const SEGMENT_MINIMUM: usize = 7;

/// Complete access, in an initiating command.
const COMPLETE_ACCESS: u8 = 0x10;
/// Toggle bit, in a segment.
const TOGGLE: u8 = 0x10;
/// Last segment.
const LAST: u8 = 0x01;

/// The objects that an SDO server gives access to.
pub(crate) trait Objects {
    /// The bytes of an object.
    fn upload(&self, index: u16, subindex: u8) -> Result<Vec<u8>, Abort>;
    /// The most bytes that can be written to an object.
    fn room(&self, index: u16, subindex: u8) -> Result<usize, Abort>;
    /// Writes an object.
    fn download(&mut self, index: u16, subindex: u8, data: &[u8]) -> Result<(), Abort>;
}

/// A transfer in segments that has begun.
#[derive(Clone, Debug)]
enum Transfer {
    Upload {
        index: u16,
        subindex: u8,
        rest: Vec<u8>,
        toggle: u8,
    },
    Download {
        index: u16,
        subindex: u8,
        data: Vec<u8>,
        size: usize,
        toggle: u8,
    },
}

/// The SDO server.
#[derive(Clone, Debug)]
pub(crate) struct Server {
    transfer: Option<Transfer>,
    /// Payload bytes of the longest reply.
    longest: usize,
}

/// An initiating request.
struct Request<'a> {
    command: u8,
    index: u16,
    subindex: u8,
    data: &'a [u8],
}

impl Server {
    /// A server that replies through a mailbox of `length` bytes.
    pub(crate) fn new(length: u16) -> Self {
        Self {
            transfer: None,
            longest: usize::from(length).saturating_sub(HEADER).max(MINIMUM),
        }
    }

    /// Serves the payload of one CoE mail.
    pub(crate) fn serve(
        &mut self,
        payload: &[u8],
        objects: &mut dyn Objects,
    ) -> Result<Option<Vec<u8>>, MailError> {
        let header = read_u16(payload, 0).ok_or(MailError::TooShort)?;
        if header >> 12 != SERVICE_SDO_REQUEST {
            return Err(MailError::ServiceNotSupported);
        }
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
        let request = Request {
            command: *command,
            index,
            subindex: *subindex,
            data,
        };
        let result = match command >> 5 {
            0 => self.download_segment(
                *command,
                payload.get(SEGMENT_HEAD..).unwrap_or(&[]),
                objects,
            ),
            1 => self.initiate_download(&request, objects),
            2 => self.initiate_upload(&request, objects),
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

    fn initiate_upload(&mut self, request: &Request<'_>, objects: &mut dyn Objects) -> Reply {
        let Request {
            command,
            index,
            subindex,
            ..
        } = *request;
        let refuse = |abort| (index, subindex, abort);
        self.transfer = None;
        if command & COMPLETE_ACCESS != 0 {
            return Err(refuse(Abort::CompleteAccess));
        }
        let mut data = objects.upload(index, subindex).map_err(refuse)?;
        if (1..=4).contains(&data.len()) {
            let unused = 4 - data.len() as u8;
            data.resize(4, 0);
            return Ok(initiate_payload(0x43 | unused << 2, index, subindex, &data));
        }
        let mut bytes = u32::try_from(data.len())
            .unwrap_or(u32::MAX)
            .to_le_bytes()
            .to_vec();
        let rest = data.split_off(data.len().min(self.longest - NORMAL_HEAD));
        bytes.extend(data);
        if !rest.is_empty() {
            self.transfer = Some(Transfer::Upload {
                index,
                subindex,
                rest,
                toggle: 0,
            });
        }
        Ok(initiate_payload(0x41, index, subindex, &bytes))
    }

    fn upload_segment(&mut self, command: u8) -> Reply {
        let Some(Transfer::Upload {
            index,
            subindex,
            rest,
            toggle,
        }) = &mut self.transfer
        else {
            return Err((0, 0, Abort::Command));
        };
        if command & TOGGLE != *toggle {
            return Err((*index, *subindex, Abort::Toggle));
        }
        let later = rest.split_off(rest.len().min(self.longest - SEGMENT_HEAD));
        let mut segment = core::mem::replace(rest, later);
        let last = if rest.is_empty() { LAST } else { 0 };
        // The command byte has room to say how many of seven bytes are unused; longer ones go by the mail's length.
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

    fn initiate_download(&mut self, request: &Request<'_>, objects: &mut dyn Objects) -> Reply {
        let Request {
            command,
            index,
            subindex,
            data,
        } = *request;
        let refuse = |abort| (index, subindex, abort);
        self.transfer = None;
        if command & COMPLETE_ACCESS != 0 {
            return Err(refuse(Abort::CompleteAccess));
        }
        let room = objects.room(index, subindex).map_err(refuse)?;
        if command & 0x02 != 0 {
            // Expedited; without size indication the object's own length counts.
            let length = if command & 0x01 != 0 {
                4 - usize::from(command >> 2 & 0x03)
            } else {
                room.min(4)
            };
            let data = data.get(..length).ok_or(refuse(Abort::TooShort))?;
            objects.download(index, subindex, data).map_err(refuse)?;
            return Ok(initiate_payload(0x60, index, subindex, &[0; 4]));
        }
        let size = read_u32(data, 0)
            .and_then(|size| usize::try_from(size).ok())
            .ok_or(refuse(Abort::TooShort))?;
        let data = data.get(4..).unwrap_or(&[]);
        if size > room || data.len() > size {
            return Err(refuse(Abort::TooLong));
        }
        if data.len() == size {
            objects.download(index, subindex, data).map_err(refuse)?;
        } else {
            self.transfer = Some(Transfer::Download {
                index,
                subindex,
                data: data.to_vec(),
                size,
                toggle: 0,
            });
        }
        Ok(initiate_payload(0x60, index, subindex, &[0; 4]))
    }

    fn download_segment(
        &mut self,
        command: u8,
        segment: &[u8],
        objects: &mut dyn Objects,
    ) -> Reply {
        let Some(Transfer::Download {
            index,
            subindex,
            data,
            size,
            toggle,
        }) = &mut self.transfer
        else {
            return Err((0, 0, Abort::Command));
        };
        let (index, subindex) = (*index, *subindex);
        let refuse = |abort| (index, subindex, abort);
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
            objects.download(index, subindex, data).map_err(refuse)?;
            self.transfer = None;
        }
        payload.resize(MINIMUM, 0);
        Ok(payload)
    }
}

/// The payload of a reply, or what to abort and why.
type Reply = Result<Vec<u8>, (u16, u8, Abort)>;

/// Payload of an emergency mail: error code, error register, five bytes of the maker's.
pub(crate) fn emergency_payload(code: u16, register: u8, data: [u8; 5]) -> Vec<u8> {
    let mut payload = (SERVICE_EMERGENCY << 12).to_le_bytes().to_vec();
    payload.extend(code.to_le_bytes());
    payload.push(register);
    payload.extend(data);
    payload
}

/// CoE header and SDO command.
fn head(service: u16, command: u8) -> Vec<u8> {
    let mut payload = (service << 12).to_le_bytes().to_vec();
    payload.push(command);
    payload
}

fn initiate_payload(command: u8, index: u16, subindex: u8, data: &[u8]) -> Vec<u8> {
    let mut payload = head(SERVICE_SDO_RESPONSE, command);
    payload.extend(index.to_le_bytes());
    payload.push(subindex);
    payload.extend(data);
    payload
}

/// An abort travels with the service number of a request in both directions, as the open SubDevice stack SOES sends it; not
/// confirmed on a drive.
fn abort_payload(index: u16, subindex: u8, abort: Abort) -> Vec<u8> {
    let mut payload = head(SERVICE_SDO_REQUEST, 0x80);
    payload.extend(index.to_le_bytes());
    payload.push(subindex);
    payload.extend(abort.code().to_le_bytes());
    payload
}
