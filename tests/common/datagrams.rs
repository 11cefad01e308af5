//! One simulated device, reached by EtherCAT frames composed here, without ethercrab.
#![allow(missing_docs)]
#![allow(dead_code, reason = "each test file uses its own part")]

use std::cell::{Cell, RefCell, RefMut};
use std::rc::Rc;
use std::time::Duration;

use servocrab::sii::Mailbox;
use servocrab_sim::{Device, Segment};

/// Datagram command: auto-increment read.
pub const APRD: u8 = 1;
/// Datagram command: auto-increment write.
pub const APWR: u8 = 2;

/// The wire with one device; time passes with each frame.
#[derive(Clone)]
pub struct Wire(Rc<(RefCell<Segment>, Cell<Duration>)>);

impl Wire {
    /// A segment of this device alone.
    pub fn new(device: Device) -> Self {
        let segment = Segment::new().with(device);
        Self(Rc::new((
            RefCell::new(segment),
            Cell::new(Duration::from_millis(1)),
        )))
    }

    pub fn now(&self) -> Duration {
        self.0.1.get()
    }

    pub fn segment(&self) -> RefMut<'_, Segment> {
        self.0.0.borrow_mut()
    }

    /// Lets time pass without a frame.
    pub fn pass(&self, time: Duration) {
        self.0.1.set(self.now() + time);
    }

    /// One datagram to the first SubDevice; its data and whether it acted on it.
    pub fn datagram(&self, command: u8, register: u16, data: &[u8]) -> (Vec<u8>, bool) {
        let length = data.len() as u16;
        let mut frame = vec![0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x10, 0, 0, 0, 0, 1];
        frame.extend([0x88, 0xA4]);
        frame.extend(((length + 12) | 0x1000).to_le_bytes());
        frame.extend([command, 0, 0, 0]);
        frame.extend(register.to_le_bytes());
        frame.extend(length.to_le_bytes());
        frame.extend([0, 0]);
        frame.extend(data);
        frame.extend([0, 0]);
        self.0.1.set(self.now() + Duration::from_micros(50));
        assert!(self.0.0.borrow_mut().process(&mut frame, self.now()));
        let data = frame[26..26 + data.len()].to_vec();
        (data, frame[frame.len() - 2] == 1)
    }

    pub fn read(&self, register: u16, length: usize) -> Vec<u8> {
        let (data, acted) = self.datagram(APRD, register, &vec![0; length]);
        assert!(acted, "read of {register:04X}h");
        data
    }

    pub fn write(&self, register: u16, data: &[u8]) {
        assert!(
            self.datagram(APWR, register, data).1,
            "write of {register:04X}h"
        );
    }

    pub fn inject_emergency(&self, data: [u8; 5]) {
        let mut segment = self.0.0.borrow_mut();
        let device = segment.device_mut(0).unwrap();
        device.inject_emergency(0x7320, 0x21, data, self.now());
    }

    /// The whole SII, word by word (registers 0502h, 0504h, 0508h).
    pub fn sii_image(&self) -> Vec<u8> {
        let mut image = Vec::new();
        while !image.ends_with(&[0xFF, 0xFF]) || image.len() < 0x82 {
            let word = (image.len() / 2) as u32;
            self.write(0x0504, &word.to_le_bytes());
            self.write(0x0502, &[0x00, 0x01]);
            while self.read(0x0502, 2)[1] & 0x80 != 0 {}
            image.extend(self.read(0x0508, 2));
            assert!(image.len() < 4096, "no end of the SII");
        }
        image
    }

    /// Sets the mailbox's sync managers, gives the EEPROM to the device (0500h = 01h) and goes to PREOP.
    pub fn pre_op(&self, mailbox: &Mailbox) {
        let sync_manager = |start: u16, length: u16, control| {
            let ([s0, s1], [l0, l1]) = (start.to_le_bytes(), length.to_le_bytes());
            [s0, s1, l0, l1, control, 0, 1, 0]
        };
        let out = sync_manager(mailbox.receive_offset, mailbox.receive_length, 0x26);
        let back = sync_manager(mailbox.send_offset, mailbox.send_length, 0x22);
        self.write(0x0800, &out);
        self.write(0x0808, &back);
        self.write(0x0500, &[1]);
        self.write(0x0120, &[2, 0]);
        for _ in 0..1000 {
            if self.read(0x0130, 2) == [2, 0] {
                return;
            }
        }
        panic!("no PREOP: AL status {:02X?}", self.read(0x0130, 6));
    }
}
