//! The mails in frames: which writes a device took, and what it said before.

use std::{
    collections::{BTreeMap, VecDeque},
    ops::Range,
};

use crate::{cable::datagrams, random::Random};

/// FPRD and FPWR.
const READ: u8 = 4;
const WRITE: u8 = 5;
/// Mails of a device that are kept to be said again.
const KEPT: usize = 64;

/// The only object that is longer than a mail.
const NOTE: (u16, u8) = (0x5F00, 0);

/// A write of 32 bits that devices took with a mail: station, object, value.
pub type Written = (u16, (u16, u8), u32);

#[derive(Default)]
pub struct Watch {
    /// The counter of the last mail that each device took.
    counters: BTreeMap<u16, u8>,
    /// How often each value was written.
    pub written: BTreeMap<Written, u32>,
    /// What each device said last about objects that never change.
    said: VecDeque<(u16, Vec<u8>)>,
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
            if is_answered_mail(answer, &data) {
                let mail = &answer[data.clone()];
                if names_its_object(mail) && word(mail, 9) < NOTE.0 {
                    self.said.push_back((station, mail.to_vec()));
                }
                if self.said.len() > KEPT {
                    self.said.pop_front();
                }
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

    /// An answer that this device gave before, about another object than the one that this mail is about: as true as ever, and
    /// not what was asked.
    pub fn earlier(&self, random: &mut Random, station: u16, mail: &[u8]) -> Option<Vec<u8>> {
        let about = |mail: &[u8]| names_its_object(mail).then(|| (word(mail, 9), mail[11]));
        let is_reply = word(mail, 6) >> 12 == 3;
        // Segments belong to the note of the user. An emergency may come while anything is awaited.
        let now = about(mail).or(is_reply.then_some(NOTE))?;
        let others = self
            .said
            .iter()
            .filter(|(of, said)| *of == station && about(said) != Some(now));
        let others: Vec<_> = others.collect();
        let (_, other) = others.get(random.below(others.len() as u64) as usize)?;
        Some(other.clone())
    }
}

fn word(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

/// Whether these are the data of a mailbox that a device has put a CoE mail into.
pub fn is_answered_mail(frame: &[u8], data: &Range<usize>) -> bool {
    let header = &frame[data.start - 10..data.start];
    header[0] == READ
        && word(header, 4) >= 0x1000
        && data.len() >= 16
        && frame[data.end] > 0
        && frame[data.start + 5] & 0x0F == 3
}

/// Answers to the first request of a transfer, and aborts.
fn names_its_object(mail: &[u8]) -> bool {
    let is_reply = word(mail, 6) >> 12 == 3;
    is_reply && (mail[8] >> 5 == 2 || mail[8] == 0x60 || mail[8] == 0x80)
}

/// A mail with an emergency, which names no error that a drive here has.
pub fn emergency(random: &mut Random) -> Vec<u8> {
    let counter = random.between(1, 7) as u8;
    let mut mail = vec![10, 0, 0, 0, 0, 3 | counter << 4, 0x00, 0x10];
    mail.extend([0x00, 0xFF, 0x81, 0, 0, 0, 0, 0]);
    mail
}
