//! A simulated drive by its frames: SDO transfers of up to four bytes, and registers.
#![allow(dead_code, reason = "each document uses its own part of the wire")]

use core::time::Duration;

use servocrab_sim::{Device, Segment};

const APRD: u8 = 1;
const APWR: u8 = 2;

/// One drive in PREOP.
pub(crate) struct Wire {
    pub(crate) segment: Segment,
    now: Duration,
    out: (u16, u16),
    back: (u16, u16),
    counter: u8,
}

impl Wire {
    pub(crate) fn new(device: Device) -> Self {
        let mailbox = device.description().mailbox.expect("a drive with CoE");
        let mut wire = Self {
            segment: Segment::new().with(device),
            now: Duration::from_millis(1),
            out: mailbox.out,
            back: mailbox.input,
            counter: 0,
        };
        for (register, (start, length), control) in
            [(0x0800, wire.out, 0x26), (0x0808, wire.back, 0x22)]
        {
            let ([s0, s1], [l0, l1]) = (start.to_le_bytes(), length.to_le_bytes());
            wire.write(register, &[s0, s1, l0, l1, control, 0, 1, 0]);
        }
        wire.write(0x0120, &[2, 0]);
        for _ in 0..1_000 {
            if wire.read(0x0130, 2) == [2, 0] {
                return wire;
            }
        }
        panic!("no PREOP");
    }

    /// Runs the drive's processor for so long.
    pub(crate) fn run(&mut self, milliseconds: u64) {
        for _ in 0..milliseconds {
            self.now += Duration::from_millis(1);
            self.segment.advance(self.now);
        }
    }

    fn datagram(&mut self, command: u8, register: u16, data: &[u8]) -> (Vec<u8>, bool) {
        let length = u16::try_from(data.len()).expect("it fits");
        let mut frame = vec![0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x10, 0, 0, 0, 0, 1];
        frame.extend([0x88, 0xA4]);
        frame.extend(((length + 12) | 0x1000).to_le_bytes());
        frame.extend([command, 0, 0, 0]);
        frame.extend(register.to_le_bytes());
        frame.extend(length.to_le_bytes());
        frame.extend([0, 0]);
        frame.extend(data);
        frame.extend([0, 0]);
        self.now += Duration::from_micros(50);
        assert!(self.segment.process(&mut frame, self.now));
        let acted = frame[frame.len() - 2] == 1;
        (frame[26..26 + data.len()].to_vec(), acted)
    }

    pub(crate) fn read(&mut self, register: u16, length: usize) -> Vec<u8> {
        let (data, acted) = self.datagram(APRD, register, &vec![0; length]);
        assert!(acted, "read of {register:04X}h");
        data
    }

    fn write(&mut self, register: u16, data: &[u8]) {
        let (_, acted) = self.datagram(APWR, register, data);
        assert!(acted, "write of {register:04X}h");
    }

    /// The eight bytes of an SDO response to these eight.
    fn sdo(&mut self, request: [u8; 8]) -> [u8; 8] {
        self.counter = self.counter % 7 + 1;
        let mut mail = vec![10, 0, 0, 0, 0, 3 | self.counter << 4, 0, 0x20];
        mail.extend(request);
        mail.resize(self.out.1.into(), 0);
        self.write(self.out.0, &mail);
        for _ in 0..10_000 {
            if self.read(0x080D, 1)[0] & 0x08 != 0 {
                let mail = self.read(self.back.0, self.back.1.into());
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
