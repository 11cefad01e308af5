//! The messages in frames: which writes a device took.

use std::{collections::BTreeMap, ops::Range};

/// FPWR (ETG.1000.4).
const WRITE: u8 = 5;

/// A write of 32 bits that devices took with a mail: station, object, value.
pub type Written = (u16, (u16, u8), u32);

#[derive(Default)]
pub struct Watch {
    /// The counter of the last mail that each device took.
    counters: BTreeMap<u16, u8>,
    /// How often each value was written.
    pub written: BTreeMap<Written, u32>,
}

impl Watch {
    /// Looks at a frame as it was sent and as the devices have left it.
    pub fn see(&mut self, sent: &[u8], answer: &[u8]) {
        for data in datagrams(sent) {
            let header = &sent[data.start - 10..data.start];
            let (station, register) = (word(header, 2), word(header, 4));
            let taken = answer[data.end] > 0;
            // A device in INIT forgets which mail was the last one: 0120h.
            if header[0] == WRITE && register == 0x0120 && sent[data.start] & 0x0F == 1 {
                self.counters.remove(&station);
            }
            if header[0] != WRITE || register < 0x1000 || !taken || data.len() < 16 {
                continue;
            }
            let mail = &sent[data];
            let counter = mail[5] >> 4 & 7;
            if mail[5] & 0x0F != 3 || self.counters.insert(station, counter) == Some(counter) {
                continue;
            }
            // An SDO request that writes four bytes at once (ETG.1000.6).
            if word(mail, 6) >> 12 == 2 && mail[8] == 0x23 {
                let object = (word(mail, 9), mail[11]);
                let value = u32::from_le_bytes([mail[12], mail[13], mail[14], mail[15]]);
                *self.written.entry((station, object, value)).or_default() += 1;
            }
        }
    }
}

fn word(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

/// Where the data of each datagram lie (ETG.1000.4): ten bytes before them, the working counter behind.
fn datagrams(frame: &[u8]) -> Vec<Range<usize>> {
    let (mut start, mut found) = (16, Vec::new());
    while let Some(&[l0, l1]) = frame.get(start + 6..start + 8) {
        let flags = u16::from_le_bytes([l0, l1]);
        let data = start + 10..start + 10 + usize::from(flags & 0x07FF);
        if data.end + 2 > frame.len() {
            break;
        }
        start = data.end + 2;
        found.push(data);
        if flags & 0x8000 == 0 {
            break;
        }
    }
    found
}
