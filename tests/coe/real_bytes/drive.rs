//! A simulated drive in PREOP and its mailbox, message by message.

use std::cell::Cell;

use servocrab::coe::mailbox::Counter;
use servocrab::sii::{Mailbox, Sii};
use servocrab_sim::Device;

use crate::datagrams::{APWR, Wire};

pub(crate) struct Drive {
    wire: Wire,
    mailbox: Mailbox,
    /// Of the messages that are composed here.
    counter: Cell<Counter>,
}

impl Drive {
    pub(crate) fn new(device: Device) -> Self {
        let wire = Wire::new(device);
        let sii = Sii::parse(&wire.sii_image()).unwrap();
        let mailbox = sii.mailbox.unwrap();
        wire.pre_op(&mailbox);
        Self {
            wire,
            mailbox,
            counter: Cell::new(Counter::FIRST),
        }
    }

    /// Writes a message as SOEM does, all bytes of the mailbox, waits for the answer, and gives the mailbox that was read.
    pub(crate) fn ask(&self, request: &[u8]) -> Vec<u8> {
        let mut message = request.to_vec();
        message.resize(usize::from(self.mailbox.receive_length), 0);
        let (_, acted) = self
            .wire
            .datagram(APWR, self.mailbox.receive_offset, &message);
        assert!(acted, "the mailbox is full");
        self.next_message()
            .unwrap_or_else(|| panic!("no answer to {request:02X?}"))
    }

    /// The next message, if there is one soon.
    pub(crate) fn next_message(&self) -> Option<Vec<u8>> {
        let length = usize::from(self.mailbox.send_length);
        for _ in 0..1_000 {
            // Sync manager 1's status, bit 3: full.
            if self.wire.read(0x080D, 1)[0] & 0x08 != 0 {
                return Some(self.wire.read(self.mailbox.send_offset, length));
            }
        }
        None
    }

    /// The list of all objects by SDO information, with the fragments checked.
    pub(crate) fn objects(&self) -> Vec<u16> {
        let mut message = self.ask(&self.information_request(1, &[1, 0]));
        let mut objects = Vec::new();
        let mut left = u16::from_le_bytes([message[10], message[11]]);
        loop {
            let length = usize::from(u16::from_le_bytes([message[0], message[1]]));
            // SDO information; operation 2, bit 7 while more follow; how many follow.
            let more = if left > 0 { 0x80 } else { 0 };
            assert_eq!(message[6..10], [0x00, 0x80, 0x02 | more, 0x00]);
            assert_eq!(message[10..12], left.to_le_bytes());
            let pairs = message[12..6 + length].chunks(2);
            objects.extend(pairs.map(|pair| u16::from_le_bytes([pair[0], pair[1]])));
            if left == 0 {
                break;
            }
            left -= 1;
            message = self.next_message().expect("the next part");
        }
        assert_eq!(
            objects.remove(0),
            1,
            "the kind of list stands once, in front"
        );
        objects
    }

    fn information_request(&self, operation: u8, asked: &[u8]) -> Vec<u8> {
        let counter = self.counter.replace(self.counter.get().next()).get();
        let mut request = vec![6 + asked.len() as u8, 0, 0, 0, 0, counter << 4 | 3];
        request.extend([0x00, 0x80, operation, 0, 0, 0]);
        request.extend(asked);
        request
    }

    /// Operation 3 or 5 of SDO information: the bytes of the reply behind what it shares with the request.
    fn information(&self, operation: u8, asked: &[u8]) -> Option<Vec<u8>> {
        let message = self.ask(&self.information_request(operation, asked));
        let length = usize::from(u16::from_le_bytes([message[0], message[1]]));
        (message[8] == operation + 1).then(|| message[12 + asked.len()..6 + length].to_vec())
    }

    /// The highest subindex of an object, by its description.
    pub(crate) fn last_subindex(&self, index: u16) -> u8 {
        // Data type, highest subindex, object code, name.
        self.information(3, &index.to_le_bytes())
            .expect("a description")[2]
    }

    /// Data type, bits and access of an entry; `None` where there is none.
    pub(crate) fn entry(&self, index: u16, subindex: u8) -> Option<(u16, u16, u16)> {
        let [low, high] = index.to_le_bytes();
        let entry = self.information(5, &[low, high, subindex, 0])?;
        let word = |at: usize| u16::from_le_bytes([entry[at], entry[at + 1]]);
        Some((word(0), word(2), word(4)))
    }
}
