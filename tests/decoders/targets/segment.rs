//! The simulated segment: any frames, datagrams and messages.

use std::sync::OnceLock;
use std::time::Duration;

use servocrab_sim::personality::{self, Servo};
use servocrab_sim::{Device, Segment};

use super::Script;
use super::memory::within;

const MAILBOX: u16 = 64;
const STATION: u16 = 0x1001;

/// A drive, a terminal and a coupler; the drive in PREOP with its mailboxes at 1800h and 1C00h.
fn devices() -> &'static [Device] {
    static DEVICES: OnceLock<Vec<Device>> = OnceLock::new();
    DEVICES.get_or_init(|| {
        let drive = Servo::akd2g()
            .with_complete_access()
            .with_sdo_information()
            .mailbox_bytes(MAILBOX)
            .build();
        let mut segment = Segment::new()
            .with(drive)
            .with(personality::io_terminal())
            .with(personality::coupler());
        let manager = |start: u16, control| {
            let [s0, s1] = start.to_le_bytes();
            let [l0, l1] = MAILBOX.to_le_bytes();
            [s0, s1, l0, l1, control, 0, 1, 0]
        };
        for (command, address, register, data) in [
            (2, 0, 0x0010, &STATION.to_le_bytes()[..]),
            (5, STATION, 0x0800, &manager(0x1800, 0x26)),
            (5, STATION, 0x0808, &manager(0x1C00, 0x22)),
            (5, STATION, 0x0120, &[2, 0]),
        ] {
            let mut frame = frame(command, address, register, data);
            assert!(segment.process(&mut frame, Duration::ZERO));
        }
        segment.devices().to_vec()
    })
}

/// One datagram in a frame.
pub fn frame(command: u8, address: u16, register: u16, data: &[u8]) -> Vec<u8> {
    let mut frame = vec![0xFF; 6];
    frame.extend([0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x88, 0xA4]);
    frame.extend(((12 + data.len() as u16) | 0x1000).to_le_bytes());
    frame.extend([command, 0]);
    frame.extend(address.to_le_bytes());
    frame.extend(register.to_le_bytes());
    frame.extend((data.len() as u16).to_le_bytes());
    frame.extend([0, 0]);
    frame.extend(data);
    frame.extend([0, 0]);
    frame
}

/// A step of the script is a byte and a part: 0 a whole frame, 1 to 14 a datagram of that command whose address and register
/// come first, 15 a message, 16 its content, 17 time that passes. The segment holds at most 1 MiB more than before.
pub fn run(data: &[u8]) {
    within(1 << 20, || {
        let mut segment = Segment::new();
        for device in devices() {
            segment.push(device.clone());
        }
        let mut script = Script(data);
        let mut now = Duration::ZERO;
        let mut counter = 0;
        while !script.is_over() {
            match script.byte() % 18 {
                0 => {
                    let mut bytes = script.part().to_vec();
                    let length = bytes.len();
                    segment.process(&mut bytes, now);
                    assert_eq!(bytes.len(), length);
                }
                command @ 1..=14 => {
                    let (address, register) = (script.word(), script.word());
                    segment.process(&mut frame(command, address, register, script.part()), now);
                }
                15 => message(&mut segment, now, script.part()),
                16 => {
                    counter = counter % 7 + 1;
                    let part = script.part();
                    let mut whole = (part.len() as u16).to_le_bytes().to_vec();
                    whole.extend([0, 0, 0, 3 | counter << 4]);
                    whole.extend(part);
                    message(&mut segment, now, &whole);
                }
                _ => {
                    now += Duration::from_micros(100 * u64::from(script.byte()));
                    segment.advance(now);
                }
            }
        }
        // It still takes frames.
        let mut last = frame(7, 0, 0x0130, &[0; 2]);
        assert!(segment.process(&mut last, now));
    });
}

/// Writes a message and reads what answers it: each answer keeps within the mailbox, and they end.
fn message(segment: &mut Segment, now: Duration, bytes: &[u8]) {
    let mut whole = bytes.to_vec();
    whole.resize(usize::from(MAILBOX), 0);
    segment.process(&mut frame(5, STATION, 0x1800, &whole), now);
    for _ in 0..400 {
        let mut answer = frame(4, STATION, 0x1C00, &[0; MAILBOX as usize]);
        segment.process(&mut answer, now);
        let counter = answer[26 + usize::from(MAILBOX)];
        if counter == 0 {
            return;
        }
    }
}
