//! The diagnosis history: object 10F3h, a ring of messages (ETG.1020, as makers' manuals give it).

use core::sync::atomic::{AtomicBool, Ordering::Relaxed};
use core::time::Duration;

use crate::coe::Abort;
use crate::coe::info::{EntryInfo, ObjectCode, ObjectInfo, access, data_type};

/// Subindex of the first message.
const FIRST: u8 = 6;
/// Bytes of a message: code, flags, text ID, time, and a parameter of one byte behind its type.
const LENGTH: usize = 19;
/// Bits of the flags (subindex 5): no errors are stored; acknowledge mode; messages were lost.
const NO_ERRORS: u16 = 1 << 3;
const ACKNOWLEDGE_MODE: u16 = 1 << 4;
const LOST: u16 = 1 << 5;

#[derive(Clone, Debug)]
struct Message {
    bytes: [u8; LENGTH],
    acknowledged: bool,
}

/// Set by a reading, which changes nothing else.
#[derive(Debug)]
struct ReadMark(AtomicBool);

impl Clone for ReadMark {
    fn clone(&self) -> Self {
        Self(AtomicBool::new(self.0.load(Relaxed)))
    }
}

/// The diagnosis history of a drive that has one.
#[derive(Clone, Debug)]
pub(super) struct DiagnosisHistory {
    places: Vec<Option<Message>>,
    newest: Option<usize>,
    /// Subindex 3.
    acknowledged: u8,
    flags: u16,
    /// The newest message was read.
    read: ReadMark,
}

impl DiagnosisHistory {
    pub(super) const INDEX: u16 = 0x10F3;

    /// An empty one with room for so many messages.
    pub(super) fn new(room: u8) -> Self {
        Self {
            places: vec![None; usize::from(room.clamp(1, u8::MAX - FIRST + 1))],
            newest: None,
            acknowledged: 0,
            flags: 0,
            read: ReadMark(AtomicBool::new(true)),
        }
    }

    fn acknowledges(&self) -> bool {
        self.flags & ACKNOWLEDGE_MODE != 0
    }

    /// The highest subindex.
    fn last(&self) -> u8 {
        u8::try_from(self.places.len()).unwrap_or(u8::MAX - FIRST + 1) + (FIRST - 1)
    }

    fn subindex(place: usize) -> u8 {
        u8::try_from(place).unwrap_or(u8::MAX - FIRST) + FIRST
    }

    fn place(&self, subindex: u8) -> Option<usize> {
        let place = usize::from(subindex.checked_sub(FIRST)?);
        (place < self.places.len()).then_some(place)
    }

    /// Takes an error in, with its error register as parameter; code 0, which says that one is gone, is none.
    pub(super) fn record(&mut self, code: u16, register: u8, now: Duration) {
        if code == 0 || self.flags & NO_ERRORS != 0 {
            return;
        }
        let next = self
            .newest
            .map_or(0, |place| (place + 1) % self.places.len());
        if let Some(oldest) = &self.places[next] {
            if !oldest.acknowledged {
                self.flags |= LOST;
                if self.acknowledges() {
                    return;
                }
            }
            if !self.acknowledges() || self.acknowledged == Self::subindex(next) {
                self.acknowledged = 0;
            }
        }
        let mut bytes = [0; LENGTH];
        // An emergency's error code in the upper half of the diagnosis code.
        bytes[0..2].copy_from_slice(&0xE800_u16.to_le_bytes());
        bytes[2..4].copy_from_slice(&code.to_le_bytes());
        // An error with local time and one parameter.
        bytes[4..6].copy_from_slice(&[0x12, 1]);
        let time = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        bytes[8..16].copy_from_slice(&time.to_le_bytes());
        bytes[16..18].copy_from_slice(&data_type::U8.to_le_bytes());
        bytes[18] = register;
        self.places[next] = Some(Message {
            bytes,
            acknowledged: false,
        });
        self.newest = Some(next);
        self.read.0.store(false, Relaxed);
    }

    pub(super) fn upload(&self, subindex: u8) -> Result<Vec<u8>, Abort> {
        Ok(match subindex {
            0 => vec![self.last()],
            1 => vec![self.last() - (FIRST - 1)],
            2 => vec![self.newest.map_or(0, Self::subindex)],
            3 => vec![self.acknowledged],
            4 => vec![u8::from(self.has_new())],
            5 => self.flags.to_le_bytes().to_vec(),
            _ => {
                let place = self.place(subindex).ok_or(Abort::NoSubindex)?;
                if Some(place) == self.newest {
                    self.read.0.store(true, Relaxed);
                }
                let message = self.places[place].as_ref();
                message.map_or(vec![0; LENGTH], |message| message.bytes.to_vec())
            }
        })
    }

    /// Subindex 4: the newest message was not read, or one was not acknowledged, by the mode.
    fn has_new(&self) -> bool {
        if self.acknowledges() {
            let mut messages = self.places.iter().flatten();
            messages.any(|message| !message.acknowledged)
        } else {
            !self.read.0.load(Relaxed)
        }
    }

    pub(super) fn room(&self, subindex: u8) -> Result<usize, Abort> {
        match subindex {
            3 => Ok(1),
            5 => Ok(2),
            _ if subindex <= self.last() => Err(Abort::ReadOnly),
            _ => Err(Abort::NoSubindex),
        }
    }

    pub(super) fn download(&mut self, subindex: u8, data: &[u8]) -> Result<(), Abort> {
        let room = self.room(subindex)?;
        match (subindex, data) {
            (3, &[subindex]) => self.acknowledge(subindex),
            (5, &[low, high]) => {
                // Bit 5 can only be read.
                let flags = u16::from_le_bytes([low, high]);
                self.flags = flags & !LOST | self.flags & LOST;
                Ok(())
            }
            _ if data.len() > room => Err(Abort::TooLong),
            _ => Err(Abort::TooShort),
        }
    }

    /// What is written to subindex 3: 0 clears, another acknowledges up to that message.
    fn acknowledge(&mut self, subindex: u8) -> Result<(), Abort> {
        let Some(place) = self.place(subindex) else {
            return match subindex {
                0 => {
                    self.clear();
                    Ok(())
                }
                1..FIRST => Err(Abort::TooLow),
                _ => Err(Abort::TooHigh),
            };
        };
        let Some(newest) = self.newest.filter(|_| self.places[place].is_some()) else {
            return Err(Abort::Range);
        };
        let room = self.places.len();
        let mut older = place;
        loop {
            if let Some(message) = &mut self.places[older] {
                message.acknowledged = true;
            }
            if older == (newest + 1) % room {
                break;
            }
            older = (older + room - 1) % room;
            if older == newest {
                break;
            }
        }
        self.acknowledged = subindex;
        Ok(())
    }

    /// All messages in overwrite mode, those that were acknowledged in acknowledge mode.
    fn clear(&mut self) {
        let all = !self.acknowledges();
        for place in &mut self.places {
            if place
                .as_ref()
                .is_some_and(|message| all || message.acknowledged)
            {
                *place = None;
            }
        }
        if self.places.iter().all(Option::is_none) {
            self.newest = None;
            self.read.0.store(true, Relaxed);
        }
        self.acknowledged = 0;
        self.flags &= !LOST;
    }

    pub(super) fn object(&self) -> ObjectInfo {
        ObjectInfo {
            data_type: data_type::NONE,
            last: self.last(),
            code: ObjectCode::Record,
            name: "Diagnosis history".into(),
        }
    }

    pub(super) fn entry(&self, subindex: u8) -> Result<EntryInfo, Abort> {
        let both = access::READ | access::WRITE;
        let byte = |access, name| EntryInfo::new(data_type::U8, 8, access, name);
        Ok(match subindex {
            0 => EntryInfo::count(access::READ),
            1 => byte(access::READ, "Maximum messages"),
            2 => byte(access::READ, "Newest message"),
            3 => byte(both, "Newest acknowledged message"),
            4 => EntryInfo::new(
                data_type::BOOLEAN,
                1,
                access::READ,
                "New messages available",
            ),
            5 => EntryInfo::new(data_type::U16, 16, both, "Flags"),
            _ if subindex <= self.last() => EntryInfo::new(
                data_type::OCTET_STRING,
                8 * LENGTH as u16,
                access::READ,
                "Diagnosis message",
            ),
            _ => return Err(Abort::NoSubindex),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(codes: core::ops::RangeInclusive<u16>, flags: u16) -> DiagnosisHistory {
        let mut history = DiagnosisHistory::new(3);
        history.download(5, &flags.to_le_bytes()).unwrap();
        for code in codes {
            history.record(code, 0x21, Duration::from_millis(5));
        }
        history
    }

    fn code(history: &DiagnosisHistory, subindex: u8) -> Vec<u8> {
        history.upload(subindex).unwrap()[..4].to_vec()
    }

    #[test]
    fn in_overwrite_mode_a_fourth_message_takes_the_place_of_the_first_of_three() {
        let mut history = with(0x8601..=0x8603, 0);
        assert_eq!(history.upload(2), Ok(vec![8]));
        assert_eq!(history.upload(4), Ok(vec![1]), "not read");
        assert_eq!(code(&history, 8), [0x00, 0xE8, 0x03, 0x86]);
        assert_eq!(history.upload(4), Ok(vec![0]), "read");
        history.record(0x8604, 0x21, Duration::ZERO);
        assert_eq!(history.upload(2), Ok(vec![6]));
        assert_eq!(code(&history, 6), [0x00, 0xE8, 0x04, 0x86]);
        assert_eq!(history.upload(5), Ok(vec![0x20, 0]), "one was lost");
        assert_eq!(history.download(3, &[0]), Ok(()));
        assert_eq!(history.upload(2), Ok(vec![0]));
        assert_eq!(history.upload(5), Ok(vec![0, 0]));
        assert_eq!(history.upload(6), Ok(vec![0; LENGTH]));
    }

    #[test]
    fn in_acknowledge_mode_only_acknowledged_messages_make_room_and_are_cleared() {
        let mut history = with(0x8601..=0x8604, ACKNOWLEDGE_MODE);
        assert_eq!(code(&history, 6)[2], 0x01, "the fourth was discarded");
        assert_eq!(history.upload(5), Ok(vec![0x30, 0]));
        assert_eq!(history.download(3, &[0]), Ok(()));
        assert_eq!(history.upload(2), Ok(vec![8]), "nothing was acknowledged");
        assert_eq!(history.download(3, &[7]), Ok(()));
        assert_eq!(history.upload(3), Ok(vec![7]));
        assert_eq!(history.upload(4), Ok(vec![1]), "the third");
        history.record(0x8604, 0x21, Duration::ZERO);
        assert_eq!(code(&history, 6)[2], 0x04);
        assert_eq!(history.download(3, &[0]), Ok(()));
        assert_eq!(history.upload(7), Ok(vec![0; LENGTH]), "the second");
        assert_eq!(code(&history, 8)[2], 0x03);
    }

    #[test]
    fn what_is_no_message_cannot_be_acknowledged() {
        let mut history = with(0x8601..=0x8601, 0);
        for (subindex, why) in [
            (1, Abort::TooLow),
            (5, Abort::TooLow),
            (7, Abort::Range),
            (9, Abort::TooHigh),
        ] {
            assert_eq!(history.download(3, &[subindex]), Err(why), "{subindex}");
        }
        assert_eq!(history.download(3, &[]), Err(Abort::TooShort));
        assert_eq!(history.download(2, &[0]), Err(Abort::ReadOnly));
        assert_eq!(history.download(9, &[0]), Err(Abort::NoSubindex));
        assert_eq!(history.upload(9), Err(Abort::NoSubindex));
    }
}
