//! The SDO information service: which objects there are, what they are called and what they take.
//! Payload behind the CoE header: operation (bit 7: more fragments follow), zero, fragments left u16, data (ETG.1000.6).

use crate::frame::read_u16;
use crate::mailbox::MailError;

use super::info::{EntryInfo, access};
use super::{Abort, Objects, SERVICE_SDO_INFORMATION, head};

const LIST_REQUEST: u8 = 1;
const LIST_RESPONSE: u8 = 2;
const OBJECT_REQUEST: u8 = 3;
const OBJECT_RESPONSE: u8 = 4;
const ENTRY_REQUEST: u8 = 5;
const ENTRY_RESPONSE: u8 = 6;
const ERROR: u8 = 7;
/// More fragments follow.
const INCOMPLETE: u8 = 0x80;
/// CoE header, operation, zero and fragments left.
const HEAD: usize = 6;

/// Bits of what a request for an entry wants to know; bits 0 to 2 are in the access word, which always comes.
const INFO_ACCESS: u8 = 0x07;
const INFO_UNIT: u8 = 0x08;
const INFO_DEFAULT: u8 = 0x10;
const INFO_MINIMUM: u8 = 0x20;
const INFO_MAXIMUM: u8 = 0x40;

/// Serves a request; `longest` is the number of payload bytes that a message holds.
pub(super) fn serve(
    payload: &[u8],
    objects: &dyn Objects,
    longest: usize,
) -> Result<Vec<Vec<u8>>, MailError> {
    let operation = payload.get(2).ok_or(MailError::TooShort)? & !INCOMPLETE;
    let data = payload.get(HEAD..).ok_or(MailError::TooShort)?;
    let word = || read_u16(data, 0).ok_or(MailError::TooShort);
    let answer = match operation {
        LIST_REQUEST => list(objects, word()?).map(|data| (LIST_RESPONSE, data)),
        OBJECT_REQUEST => object(objects, word()?).map(|data| (OBJECT_RESPONSE, data)),
        ENTRY_REQUEST => {
            let (Some(subindex), Some(wanted)) = (data.get(2), data.get(3)) else {
                return Err(MailError::TooShort);
            };
            entry(objects, word()?, *subindex, *wanted).map(|data| (ENTRY_RESPONSE, data))
        }
        _ => Err(Abort::Command),
    };
    let (operation, data) =
        answer.unwrap_or_else(|abort| (ERROR, abort.code().to_le_bytes().to_vec()));
    Ok(fragments(operation, &data, longest))
}

/// List types: 0 the number of objects in each of the others, 1 all, 2 mappable into an RxPDO, 3 into a TxPDO, 4 kept for
/// a replacement of the device, 5 read at start.
fn list(objects: &dyn Objects, kind: u16) -> Result<Vec<u8>, Abort> {
    let words: Vec<u16> = match kind {
        0 => (1..=5)
            .map(|kind| u16::try_from(of_kind(objects, kind).len()).unwrap_or(u16::MAX))
            .collect(),
        1..=5 => of_kind(objects, kind),
        _ => return Err(Abort::Access),
    };
    Ok([kind]
        .into_iter()
        .chain(words)
        .flat_map(u16::to_le_bytes)
        .collect())
}

fn of_kind(objects: &dyn Objects, kind: u16) -> Vec<u16> {
    let mask = match kind {
        2 => access::RX,
        3 => access::TX,
        4 => access::BACKUP,
        5 => access::SETTINGS,
        _ => 0,
    };
    let mut all = objects.indices();
    if mask != 0 {
        all.retain(|index| has_entry_with(objects, *index, mask));
    }
    all
}

fn has_entry_with(objects: &dyn Objects, index: u16, mask: u16) -> bool {
    objects.object(index).is_ok_and(|object| {
        (0..=object.last).any(|subindex| {
            objects
                .entry(index, subindex)
                .is_ok_and(|entry| entry.access & mask != 0)
        })
    })
}

/// Index, data type, highest subindex, object code, name.
fn object(objects: &dyn Objects, index: u16) -> Result<Vec<u8>, Abort> {
    let object = objects.object(index)?;
    let mut data = index.to_le_bytes().to_vec();
    data.extend(object.data_type.to_le_bytes());
    data.extend([object.last, object.code as u8]);
    data.extend(object.name.bytes());
    Ok(data)
}

/// Index, subindex, what the answer tells, data type, bits, access; then unit, default, minimum and maximum as far as they
/// were asked for and are known; then the name.
fn entry(objects: &dyn Objects, index: u16, subindex: u8, wanted: u8) -> Result<Vec<u8>, Abort> {
    let EntryInfo {
        data_type,
        bits,
        access,
        name,
        unit,
        default,
        range,
    } = objects.entry(index, subindex)?;
    let (minimum, maximum) = range.unzip();
    let known = [
        (INFO_UNIT, unit.map(|unit| unit.to_le_bytes().to_vec())),
        (INFO_DEFAULT, default),
        (INFO_MINIMUM, minimum),
        (INFO_MAXIMUM, maximum),
    ];
    let mut told = wanted & INFO_ACCESS;
    let mut values = Vec::new();
    for (bit, value) in known {
        if wanted & bit != 0
            && let Some(value) = value
        {
            told |= bit;
            values.extend(value);
        }
    }
    let mut data = index.to_le_bytes().to_vec();
    data.extend([subindex, told]);
    for word in [data_type, bits, access] {
        data.extend(word.to_le_bytes());
    }
    data.extend(values);
    data.extend(name.bytes());
    Ok(data)
}

/// Cuts an answer into as many messages as it takes; only the first has the beginning of the data.
fn fragments(operation: u8, data: &[u8], longest: usize) -> Vec<Vec<u8>> {
    // A list is cut between its words.
    let room = (longest.saturating_sub(HEAD) & !1).max(2);
    let count = data.len().div_ceil(room).max(1);
    data.chunks(room)
        .zip((0..count).rev())
        .map(|(piece, left)| {
            let more = if left > 0 { INCOMPLETE } else { 0 };
            let mut payload = head(SERVICE_SDO_INFORMATION, operation | more);
            payload.push(0);
            payload.extend(u16::try_from(left).unwrap_or(u16::MAX).to_le_bytes());
            payload.extend(piece);
            payload
        })
        .collect()
}
