//! CANopen over EtherCAT: what a device does with the payload of a CoE message, and the bytes of an emergency.
//! Payload: number and service u16, then what the service puts there (ETG.1000.6).

mod abort;
mod complete;
pub(crate) mod info;
mod information;
mod sdo;

pub use abort::Abort;

use crate::description::Mailbox;
use crate::frame::read_u16;
use crate::mailbox::{HEADER, MailError};
use info::{EntryInfo, ObjectInfo};

const SERVICE_EMERGENCY: u16 = 1;
const SERVICE_SDO_REQUEST: u16 = 2;
const SERVICE_SDO_RESPONSE: u16 = 3;
const SERVICE_SDO_INFORMATION: u16 = 8;
/// CoE header and SDO: no message of the SDO services is shorter.
const MINIMUM: usize = 10;

/// The objects that the services give access to.
pub(crate) trait Objects {
    /// The bytes of an object.
    fn upload(&self, index: u16, subindex: u8) -> Result<Vec<u8>, Abort>;
    /// The most bytes that can be written to an object.
    fn room(&self, index: u16, subindex: u8) -> Result<usize, Abort>;
    /// Writes an object.
    fn download(&mut self, index: u16, subindex: u8, data: &[u8]) -> Result<(), Abort>;
    /// Writes several subindices of an object in this order; when one is refused, none is written.
    fn download_all(&mut self, index: u16, values: &[(u8, Vec<u8>)]) -> Result<(), Abort>;
    /// The indices of all objects, ascending.
    fn indices(&self) -> Vec<u16>;
    /// What there is to say about an object.
    fn object(&self, index: u16) -> Result<ObjectInfo, Abort>;
    /// What there is to say about a subindex.
    fn entry(&self, index: u16, subindex: u8) -> Result<EntryInfo, Abort>;
}

/// The CoE services of a device.
#[derive(Clone, Debug)]
pub(crate) struct Server {
    sdo: sdo::Server,
    offers_information: bool,
    /// Payload bytes of the longest reply.
    longest: usize,
}

impl Server {
    /// The services of a device with this mailbox, as far as its CoE details offer them.
    pub(crate) fn new(mailbox: Option<Mailbox>) -> Self {
        let offers_complete_access =
            mailbox.is_some_and(|mailbox| mailbox.offers_complete_access());
        Self {
            sdo: sdo::Server::new(offers_complete_access),
            offers_information: mailbox.is_some_and(|mailbox| mailbox.offers_sdo_information()),
            longest: MINIMUM,
        }
    }

    /// Its replies go into a mailbox of this length from now on.
    pub(crate) fn fit(&mut self, length: u16) {
        self.longest = usize::from(length).saturating_sub(HEADER).max(MINIMUM);
        self.sdo.longest = self.longest;
    }

    /// Serves the payload of one CoE message: the payloads of the replies. SDO information that is not offered is refused as real drives
    /// mostly do, by an SDO abort, or by a message of the mailbox.
    pub(crate) fn serve(
        &mut self,
        payload: &[u8],
        objects: &mut dyn Objects,
        refuses_by_mailbox: bool,
    ) -> Result<Vec<Vec<u8>>, MailError> {
        let header = read_u16(payload, 0).ok_or(MailError::TooShort)?;
        match header >> 12 {
            SERVICE_SDO_REQUEST => {
                let reply = self.sdo.serve(payload, objects)?;
                Ok(reply.into_iter().collect())
            }
            SERVICE_SDO_INFORMATION if self.offers_information => {
                information::serve(payload, objects, self.longest)
            }
            SERVICE_SDO_INFORMATION if !refuses_by_mailbox => {
                Ok(vec![sdo::abort_payload(0, 0, Abort::Command)])
            }
            _ => Err(MailError::ServiceNotSupported),
        }
    }
}

/// Payload of an emergency message: error code, error register, five bytes of the maker's.
pub(crate) fn emergency_payload(code: u16, register: u8, data: [u8; 5]) -> Vec<u8> {
    let mut payload = (SERVICE_EMERGENCY << 12).to_le_bytes().to_vec();
    payload.extend(code.to_le_bytes());
    payload.push(register);
    payload.extend(data);
    payload
}

/// The refusal of an SDO request; `None` for any other message, and for a segment, which names no object.
pub(crate) fn refusal(payload: &[u8], abort: Abort) -> Option<Vec<u8>> {
    let is_request = read_u16(payload, 0)? >> 12 == SERVICE_SDO_REQUEST;
    let names_object = matches!(payload.get(2)? >> 5, 1 | 2);
    let (index, subindex) = (read_u16(payload, 3)?, *payload.get(5)?);
    (is_request && names_object).then(|| sdo::abort_payload(index, subindex, abort))
}

/// CoE header and the first byte of a service.
fn head(service: u16, command: u8) -> Vec<u8> {
    let mut payload = (service << 12).to_le_bytes().to_vec();
    payload.push(command);
    payload
}
