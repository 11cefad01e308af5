//! The other end of every master's cable: a simulated segment for the bring-up, then answers of fixed cost.
//!
//! While a segment is simulated, the answers to frames of process data are kept. When it is reflected, such a frame gets the data
//! and working counters of its kind's last answer, and the bit in its source address that the first SubDevice sets. That costs a copy
//! of the data, whatever the drives.

use std::{
    collections::VecDeque,
    io::{self, BufRead},
    ops::Range,
    sync::atomic::{AtomicU32, Ordering},
    thread,
    time::{Duration, Instant},
};

use servocrab::link::{Link as _, RawSocket};
use servocrab_sim::{Segment, link::FRAME_CAPACITY, personality::Servo};

use crate::{
    lines,
    measure::{HELD_FOR, say},
    slave,
};

/// Bytes of the Ethernet and the EtherCAT header.
const HEADERS: usize = 16;
const NOP: u8 = 0;
const FPRD: u8 = 4;
const LOGICAL: std::ops::RangeInclusive<u8> = 10..=12;

/// What the main program says last: a bit for each line to be served, and whether they are simulated or their frames are held.
static ORDER: AtomicU32 = AtomicU32::new(0);
const SIMULATED: u32 = 1 << 31;
const HELD: u32 = 1 << 30;

/// A master's line.
struct Line {
    socket: RawSocket,
    segment: Segment,
    /// Time stands still while the segment is not simulated, so that no watchdog expires.
    age: Duration,
    kept: Vec<Kept>,
}

/// An answer on its way.
struct Held {
    until: Instant,
    place: usize,
    frame: Vec<u8>,
}

/// The answer to a kind of frame.
struct Kept {
    length: usize,
    /// Command and address of the first datagram that is no NOP.
    first: [u8; 5],
    answer: Vec<u8>,
    /// The datagrams' data with their working counters.
    data: Vec<Range<usize>>,
}

/// The far end of a cable, which receives into a ring.
fn far_end(interface: &str) -> RawSocket {
    let mut socket = RawSocket::open(interface).expect("the interface is there");
    socket.prepare().expect("nobody else is there");
    socket
}

/// Serves the lines of all masters, as commanded by the standard input, with this many axes each.
pub(crate) fn reflect(axes: usize) {
    let mut all: Vec<Line> = lines()
        .enumerate()
        .map(|(place, who)| Line {
            socket: far_end(&slave(place)),
            segment: segment(axes, who),
            age: Duration::ZERO,
            kept: Vec::new(),
        })
        .collect();
    // The floor's frames are this library's, and get its answers.
    let ours = lines().position(|who| who == "servocrab-block");
    let source_of: Vec<usize> = lines()
        .enumerate()
        .map(|(place, who)| ours.filter(|_| who.starts_with("floor")).unwrap_or(place))
        .collect();
    thread::spawn(take_orders);
    say("ready");
    let mut buffer = [0; FRAME_CAPACITY];
    let mut before = Instant::now();
    let mut held: VecDeque<Held> = VecDeque::new();
    loop {
        let order = ORDER.load(Ordering::Relaxed);
        let now = Instant::now();
        let passed = now - before;
        before = now;
        let served = (0..all.len()).filter(|place| order & 1 << place != 0);
        if order & SIMULATED != 0 {
            for place in served {
                let line = &mut all[place];
                line.age += passed;
                line.segment.advance(line.age);
                line.simulate(&mut buffer);
            }
            continue;
        }
        let served: Vec<usize> = served.collect();
        if served.is_empty() {
            thread::sleep(Duration::from_millis(1));
        }
        // A while without looking at the clock and the orders.
        for _ in 0..200 {
            for &place in &served {
                let Ok(Some(length)) = all[place].socket.receive(&mut buffer) else {
                    continue;
                };
                let frame = &mut buffer[..length];
                let kept = &all[source_of[place]].kept;
                let Some(kept) = kept.iter().find(|kept| kept.is_for(frame)) else {
                    all[place].answer(length, &mut buffer);
                    continue;
                };
                kept.put_into(frame);
                if order & HELD == 0 {
                    let _ = all[place].socket.send(frame);
                } else {
                    held.push_back(Held {
                        until: Instant::now() + HELD_FOR,
                        place,
                        frame: frame.to_vec(),
                    });
                }
            }
            while let Some(first) = held.front()
                && first.until <= Instant::now()
            {
                let _ = all[first.place].socket.send(&first.frame);
                held.pop_front();
            }
        }
    }
}

impl Line {
    fn simulate(&mut self, buffer: &mut [u8]) {
        while let Ok(Some(length)) = self.socket.receive(buffer) {
            self.answer(length, buffer);
        }
    }

    /// Answers as the segment does, and keeps the answer.
    fn answer(&mut self, length: usize, buffer: &mut [u8]) {
        let frame = &mut buffer[..length];
        let (kind, data) = kind(frame);
        if self.segment.process(frame, self.age) {
            let _ = self.socket.send(frame);
            if let Some(first) = kind {
                self.kept
                    .retain(|kept| kept.length != length || kept.first != first);
                self.kept.push(Kept {
                    length,
                    first,
                    answer: frame.to_vec(),
                    data,
                });
            }
        }
    }
}

impl Kept {
    fn is_for(&self, frame: &[u8]) -> bool {
        self.length == frame.len() && Some(self.first) == first(frame)
    }

    fn put_into(&self, frame: &mut [u8]) {
        frame[6] |= 2;
        for range in &self.data {
            frame[range.clone()].copy_from_slice(&self.answer[range.clone()]);
        }
    }
}

fn first(frame: &[u8]) -> Option<[u8; 5]> {
    let &[command, _, a, b, c, d, ..] = frame.get(begin(frame)..)? else {
        return None;
    };
    Some([command, a, b, c, d])
}

/// Where the first datagram is that does something: ours has a NOP before it, whose address is another one in each frame.
fn begin(frame: &[u8]) -> usize {
    match frame.get(HEADERS..) {
        Some(&[NOP, _, _, _, _, _, length, _, ..]) => HEADERS + 12 + usize::from(length),
        _ => HEADERS,
    }
}

/// What distinguishes a frame of process data, or of many states, from others; and where data and working counters are.
fn kind(frame: &[u8]) -> (Option<[u8; 5]>, Vec<Range<usize>>) {
    let mut data = Vec::new();
    let (mut at, mut logical) = (begin(frame), false);
    while let Some(&[command, _, _, _, _, _, low, high]) = frame.get(at..at + 8) {
        logical |= LOGICAL.contains(&command);
        let flags = u16::from_le_bytes([low, high]);
        let end = at + 12 + usize::from(flags & 0x07FF);
        data.push(at + 10..end);
        if flags & 0x8000 == 0 {
            break;
        }
        at = end;
    }
    let first = first(frame);
    let states = first.is_some_and(|[command, _, _, low, high]| {
        command == FPRD && [low, high] == [0x30, 0x01] && data.len() > 1
    });
    (first.filter(|_| logical || states), data)
}

fn take_orders() {
    for line in io::stdin().lock().lines() {
        let line = line.expect("text");
        let mut words = line.split(' ');
        let how = match words.next() {
            Some("simulate") => SIMULATED,
            Some("hold") => HELD,
            _ => 0,
        };
        let places = words.map(|place| 1 << place.parse::<u32>().expect("a number"));
        ORDER.store(how | places.sum::<u32>(), Ordering::Relaxed);
        // Longer than a look at the order takes.
        thread::sleep(Duration::from_millis(5));
        say("done");
    }
    std::process::exit(0);
}

/// Two-axis drives with 7 bytes of outputs and 7 of inputs for each axis: as free PDOs for the master that writes its mapping,
/// as what is there at power-up for the others.
fn segment(axes: usize, master: &str) -> Segment {
    let mut segment = Segment::new();
    if master.starts_with("floor") {
        return segment;
    }
    for drive in 0..axes.div_ceil(2) {
        let both = axes - 2 * drive >= 2;
        let mut servo = Servo::akd2g();
        if !master.starts_with("servocrab") {
            let assigned: &[u16] = if both {
                &[0x1600, 0x1610, 0x1A00, 0x1A10]
            } else {
                &[0x1600, 0x1A00]
            };
            servo = servo
                .with_fixed_pdo(0x1600, &[(0x6040, 0, 16), (0x6060, 0, 8), (0x607A, 0, 32)])
                .with_fixed_pdo(0x1610, &[(0x6840, 0, 16), (0x6860, 0, 8), (0x687A, 0, 32)])
                .with_fixed_pdo(0x1A00, &[(0x6041, 0, 16), (0x6061, 0, 8), (0x6064, 0, 32)])
                .with_fixed_pdo(0x1A10, &[(0x6841, 0, 16), (0x6861, 0, 8), (0x6864, 0, 32)])
                .assigned_at_power_up(assigned);
        }
        segment.push(servo.build());
    }
    segment
}
