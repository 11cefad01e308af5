//! A MainDevice of a few lines for the simulator's own tests: it composes frames by hand and knows no library.

use core::time::Duration;

use servocrab_sim::{Device, Direction, Segment, SyncManagerUse};

pub(crate) const BRD: u8 = 7;
pub(crate) const BWR: u8 = 8;
pub(crate) const APWR: u8 = 2;
pub(crate) const FPRD: u8 = 4;
pub(crate) const FPWR: u8 = 5;
pub(crate) const LRW: u8 = 12;

/// Addresses of the AKD2G's mailboxes: where the MainDevice writes and where it reads.
const MAILBOX_OUT: u16 = 0x1800;
const MAILBOX_IN: u16 = 0x1C00;

/// One Ethernet frame with these datagrams: command, address, offset, data.
pub(crate) fn frame(datagrams: &[(u8, u16, u16, &[u8])]) -> Vec<u8> {
    let mut body = Vec::new();
    for (number, (command, address, offset, data)) in datagrams.iter().enumerate() {
        body.extend([*command, number as u8]);
        body.extend(address.to_le_bytes());
        body.extend(offset.to_le_bytes());
        let more = if number + 1 < datagrams.len() {
            0x8000
        } else {
            0
        };
        body.extend((data.len() as u16 | more).to_le_bytes());
        body.extend([0, 0]);
        body.extend(*data);
        body.extend([0, 0]);
    }
    let mut frame = vec![0xFF; 6];
    frame.extend([0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x88, 0xA4]);
    frame.extend((body.len() as u16 | 0x1000).to_le_bytes());
    frame.extend(body);
    frame
}

/// CoE header, SDO command, index, subindex and data.
pub(crate) fn request(command: u8, index: u16, subindex: u8, data: &[u8]) -> Vec<u8> {
    let mut payload = vec![0x00, 0x20, command];
    payload.extend(index.to_le_bytes());
    payload.push(subindex);
    payload.extend(data);
    payload.resize(payload.len().max(10), 0);
    payload
}

/// The abort code of a reply.
pub(crate) fn abort(reply: &[u8]) -> u32 {
    assert_eq!(reply[..3], [0x00, 0x20, 0x80]);
    u32::from_le_bytes(reply[6..10].try_into().unwrap())
}

pub(crate) struct Master {
    pub(crate) segment: Segment,
    pub(crate) now: Duration,
    /// Length of both mailboxes.
    pub(crate) mailbox: usize,
    /// Where the mailboxes are.
    mailbox_at: (u16, u16),
    /// Where the process data is, outputs and inputs.
    memory: (u16, u16),
    /// Bytes of process data, outputs and inputs.
    pub(crate) lengths: (u16, u16),
    counter: u8,
}

impl Master {
    pub(crate) fn new(segment: Segment) -> Self {
        Self {
            segment,
            now: Duration::ZERO,
            mailbox: 1024,
            mailbox_at: (MAILBOX_OUT, MAILBOX_IN),
            memory: (0x1100, 0x1200),
            lengths: (38, 22),
            counter: 0,
        }
    }

    /// For a segment of this drive alone, with the addresses and lengths of its description.
    pub(crate) fn of(drive: Device) -> Self {
        let description = drive.description();
        let mailbox = description.mailbox.expect("a drive has a mailbox");
        let start = |purpose| {
            let index = description.sync_manager_for(purpose).expect("it has one");
            description.sync_managers[index].start
        };
        let memory = (
            start(SyncManagerUse::Outputs),
            start(SyncManagerUse::Inputs),
        );
        let length = |direction| description.process_data_bytes(direction) as u16;
        let lengths = (length(Direction::Outputs), length(Direction::Inputs));
        Self {
            mailbox: mailbox.out.1.into(),
            mailbox_at: (mailbox.out.0, mailbox.input.0),
            memory,
            lengths,
            ..Self::new(Segment::new().with(drive))
        }
    }

    /// One datagram there and back: its data and working counter.
    pub(crate) fn exchange(
        &mut self,
        command: u8,
        address: u16,
        offset: u16,
        data: &[u8],
    ) -> (Vec<u8>, u16) {
        let mut bytes = frame(&[(command, address, offset, data)]);
        assert!(
            self.segment.process(&mut bytes, self.now),
            "no SubDevice has returned the frame"
        );
        let data = bytes[26..26 + data.len()].to_vec();
        let counter = u16::from_le_bytes(bytes[bytes.len() - 2..].try_into().unwrap());
        (data, counter)
    }

    pub(crate) fn write(&mut self, address: u16, offset: u16, data: &[u8]) {
        assert_eq!(
            self.exchange(FPWR, address, offset, data).1,
            1,
            "write to {offset:04X}h"
        );
    }

    pub(crate) fn read<const N: usize>(&mut self, address: u16, offset: u16) -> [u8; N] {
        let (data, counter) = self.exchange(FPRD, address, offset, &[0; N]);
        assert_eq!(counter, 1, "read of {offset:04X}h");
        data.try_into().unwrap()
    }

    /// AL status and AL status code.
    pub(crate) fn al(&mut self, address: u16) -> (u16, u16) {
        let bytes: [u8; 6] = self.read(address, 0x0130);
        (
            u16::from_le_bytes([bytes[0], bytes[1]]),
            u16::from_le_bytes([bytes[4], bytes[5]]),
        )
    }

    /// Asks for an AL state and tells what came of it at once.
    /// Asks for an AL state; before PREOP the device gets its EEPROM.
    pub(crate) fn request(&mut self, address: u16, control: u8) -> (u16, u16) {
        if control & 0x0F == 2 {
            self.write(address, 0x0500, &[1]);
        }
        self.write(address, 0x0120, &[control, 0]);
        self.al(address)
    }

    pub(crate) fn sync_manager(
        &mut self,
        address: u16,
        index: u16,
        start: u16,
        length: u16,
        control: u8,
    ) {
        let mut bytes = start.to_le_bytes().to_vec();
        bytes.extend(length.to_le_bytes());
        bytes.extend([control, 0, 1, 0]);
        self.write(address, 0x0800 + 8 * index, &bytes);
    }

    pub(crate) fn fmmu(
        &mut self,
        address: u16,
        index: u16,
        logical: u32,
        length: u16,
        physical: u16,
        kind: u8,
    ) {
        let mut bytes = logical.to_le_bytes().to_vec();
        bytes.extend(length.to_le_bytes());
        bytes.extend([0, 7]);
        bytes.extend(physical.to_le_bytes());
        bytes.extend([0, kind, 1, 0, 0, 0]);
        self.write(address, 0x0600 + 16 * index, &bytes);
    }

    /// Gives the first device the station address 1001h and brings it to PREOP.
    pub(crate) fn bring_to_preop(&mut self) {
        assert_eq!(self.exchange(APWR, 0, 0x0010, &[0x01, 0x10]).1, 1);
        let (out, input) = self.mailbox_at;
        self.sync_manager(0x1001, 0, out, self.mailbox as u16, 0x26);
        self.sync_manager(0x1001, 1, input, self.mailbox as u16, 0x22);
        assert_eq!(self.request(0x1001, 2), (2, 0));
    }

    /// Brings the first device from PREOP to OP with its process data as long as `lengths` says; `control` is that of SM2.
    pub(crate) fn bring_to_op(&mut self, control: u8) {
        let ((out, input), (sent, received)) = (self.memory, self.lengths);
        if control & 0x40 == 0 {
            // Without the trigger, the watchdog gets no time.
            self.write(0x1001, 0x0420, &[0, 0]);
        }
        self.sync_manager(0x1001, 2, out, sent, control);
        self.sync_manager(0x1001, 3, input, received, 0x20);
        self.fmmu(0x1001, 0, 0, sent, out, 2);
        self.fmmu(0x1001, 1, sent.into(), received, input, 1);
        assert_eq!(self.request(0x1001, 4), (4, 0));
        self.cycle(&vec![0; sent.into()]);
        assert_eq!(self.request(0x1001, 8), (8, 0));
    }

    /// One LRW of the outputs, 1 ms later: the inputs.
    pub(crate) fn cycle(&mut self, outputs: &[u8]) -> Vec<u8> {
        self.now += Duration::from_millis(1);
        let mut data = outputs.to_vec();
        data.resize(outputs.len() + usize::from(self.lengths.1), 0);
        let (data, counter) = self.exchange(LRW, 0, 0, &data);
        assert_eq!(counter, 3);
        data[outputs.len()..].to_vec()
    }

    /// Writes one mail with the next counter; `payload` is what follows the mailbox header.
    pub(crate) fn post(&mut self, kind: u8, payload: &[u8]) {
        self.counter = self.counter % 7 + 1;
        let mut mail = (payload.len() as u16).to_le_bytes().to_vec();
        mail.extend([0, 0, 0, kind | self.counter << 4]);
        mail.extend(payload);
        mail.resize(self.mailbox, 0);
        self.write(0x1001, self.mailbox_at.0, &mail);
    }

    /// The next mail's header and payload, when there is one.
    pub(crate) fn fetch(&mut self) -> Option<(u8, Vec<u8>)> {
        let (mail, counter) =
            self.exchange(FPRD, 0x1001, self.mailbox_at.1, &vec![0; self.mailbox]);
        let length = usize::from(u16::from_le_bytes([mail[0], mail[1]]));
        (counter == 1).then(|| (mail[5], mail[6..6 + length].to_vec()))
    }

    /// Sends a CoE payload and gives the payload of the reply. An emergency may come before it: its service is 1.
    pub(crate) fn coe(&mut self, payload: &[u8]) -> Vec<u8> {
        self.post(3, payload);
        loop {
            let (kind, reply) = self.fetch().expect("a reply");
            let is_emergency = kind & 0x0F == 3 && reply.get(1).is_some_and(|high| high >> 4 == 1);
            if !is_emergency {
                return reply;
            }
        }
    }

    /// An upload that is answered in one mail, or its abort code.
    pub(crate) fn upload(&mut self, index: u16, subindex: u8) -> Result<Vec<u8>, u32> {
        let mut request = vec![0x00, 0x20, 0x40];
        request.extend(index.to_le_bytes());
        request.extend([subindex, 0, 0, 0, 0]);
        let reply = self.coe(&request);
        match reply[2] {
            0x80 => Err(u32::from_le_bytes(reply[6..10].try_into().unwrap())),
            0x41 => Ok(reply[10..].to_vec()),
            command => Ok(reply[6..10 - usize::from(command >> 2 & 3)].to_vec()),
        }
    }

    /// An expedited download, or its abort code.
    pub(crate) fn download(&mut self, index: u16, subindex: u8, data: &[u8]) -> Result<(), u32> {
        let mut request = vec![0x00, 0x20, 0x23 | (4 - data.len() as u8) << 2];
        request.extend(index.to_le_bytes());
        request.push(subindex);
        request.extend(data);
        request.resize(10, 0);
        let reply = self.coe(&request);
        if reply[2] == 0x80 {
            Err(u32::from_le_bytes(reply[6..10].try_into().unwrap()))
        } else {
            Ok(())
        }
    }
}
