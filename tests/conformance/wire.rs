//! A simulated drive by its frames: SDO transfers of up to four bytes.

#[path = "../common/datagrams.rs"]
mod datagrams;

use core::time::Duration;

use servocrab::sii::{Mailbox, Protocols};
use servocrab_sim::Device;

/// One drive in PREOP.
pub(crate) struct Wire {
    pub(crate) line: datagrams::Wire,
    out: (u16, u16),
    back: (u16, u16),
    counter: u8,
}

impl Wire {
    pub(crate) fn new(device: Device) -> Self {
        let mailbox = device.description().mailbox.expect("a drive with CoE");
        let (out, back) = (mailbox.out, mailbox.input);
        let line = datagrams::Wire::new(device);
        line.pre_op(&Mailbox {
            receive_offset: out.0,
            receive_length: out.1,
            send_offset: back.0,
            send_length: back.1,
            protocols: Protocols(0x0004),
        });
        Self {
            line,
            out,
            back,
            counter: 0,
        }
    }

    /// Runs the drive's processor for so long.
    pub(crate) fn run(&mut self, milliseconds: u64) {
        for _ in 0..milliseconds {
            self.line.pass(Duration::from_millis(1));
            let now = self.line.now();
            self.line.segment().advance(now);
        }
    }

    /// The eight bytes of an SDO response to these eight.
    fn sdo(&mut self, request: [u8; 8]) -> [u8; 8] {
        self.counter = self.counter % 7 + 1;
        let mut mail = vec![10, 0, 0, 0, 0, 3 | self.counter << 4, 0, 0x20];
        mail.extend(request);
        mail.resize(self.out.1.into(), 0);
        self.line.write(self.out.0, &mail);
        for _ in 0..10_000 {
            if self.line.read(0x080D, 1)[0] & 0x08 != 0 {
                let mail = self.line.read(self.back.0, self.back.1.into());
                assert_eq!(mail[5] & 0x0F, 3, "CoE");
                return mail[8..16].try_into().expect("eight bytes");
            }
        }
        panic!("no answer to {request:02X?}");
    }

    /// Reads an object of up to four bytes; an abort code on refusal.
    pub(crate) fn upload(&mut self, index: u16, subindex: u8) -> Result<Vec<u8>, u32> {
        let [low, high] = index.to_le_bytes();
        let answer = self.sdo([0x40, low, high, subindex, 0, 0, 0, 0]);
        let data = &answer[4..];
        match answer[0] {
            0x80 => Err(u32::from_le_bytes(data.try_into().expect("four bytes"))),
            command => {
                assert_eq!(command & 0x43, 0x43, "expedited");
                let unused = usize::from(command >> 2 & 3);
                Ok(data[..4 - unused].to_vec())
            }
        }
    }

    /// Writes an object of up to four bytes; an abort code on refusal.
    pub(crate) fn download(&mut self, index: u16, subindex: u8, data: &[u8]) -> Result<(), u32> {
        let [low, high] = index.to_le_bytes();
        let unused = u8::try_from(4 - data.len()).expect("up to four bytes");
        let mut request = [0x23 | unused << 2, low, high, subindex, 0, 0, 0, 0];
        request[4..4 + data.len()].copy_from_slice(data);
        let answer = self.sdo(request);
        match answer[0] {
            0x80 => Err(u32::from_le_bytes(
                answer[4..].try_into().expect("four bytes"),
            )),
            _ => Ok(()),
        }
    }

    /// Maps these objects, and no others, into one PDO of one direction.
    pub(crate) fn map(&mut self, assign: u16, pdo: u16, entries: &[u32]) -> Result<(), u32> {
        self.download(assign, 0, &[0])?;
        self.download(pdo, 0, &[0])?;
        for (subindex, entry) in (1..).zip(entries) {
            self.download(pdo, subindex, &entry.to_le_bytes())?;
        }
        let count = u8::try_from(entries.len()).expect("few");
        self.download(pdo, 0, &[count])?;
        self.download(assign, 1, &pdo.to_le_bytes())?;
        self.download(assign, 0, &[1])
    }
}
