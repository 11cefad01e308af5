//! A simulated segment that counts datagrams and sends emergencies after one of them, and the network on it.

use std::{
    future::Future,
    ops::Range,
    pin::pin,
    sync::{Arc, Mutex, MutexGuard},
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    Network,
    bus::{BusLoop, NetworkBuilder},
    coe::{Emergencies, Emergency},
    link::Wire,
};
use servocrab_sim::{AlState, Segment};

pub(crate) const MS: Duration = Duration::from_millis(1);
/// How long a frame takes to come back: as on a real line, so that a cycle holds some twenty frames.
const LATENCY: Duration = Duration::from_micros(50);
/// Longer than anything that a test waits for.
const LIMIT: Duration = Duration::from_secs(30);
/// Ethernet header and EtherCAT header.
const HEADERS: usize = 16;
/// Behind them is the tag, a NOP with four bytes of data.
const BEHIND_TAG: usize = HEADERS + 16;
/// Command, index, address, length, interrupt.
const DATAGRAM_HEADER: usize = 10;
const WORKING_COUNTER: usize = 2;
/// LRD, LWR, LRW: what a frame of process data begins with, behind the tag.
const LOGICAL: std::ops::RangeInclusive<u8> = 10..=12;
/// In a datagram's length: another one follows.
const MORE_FOLLOW: u8 = 0x80;

/// Emergencies that wait for their datagram.
struct Due {
    after: u64,
    position: usize,
    emergencies: Vec<Emergency>,
}

/// Emergencies after every so many datagrams.
#[derive(Default)]
struct Repeating {
    every: u64,
    position: usize,
    sent: u64,
}

/// A segment, and how many datagrams it has seen since the last [`Line::arm`].
struct Counted {
    segment: Segment,
    seen: u64,
    /// Frames that were sent, and those among them without process data.
    frames: u64,
    own: Vec<Own>,
    due: Option<Due>,
    repeating: Repeating,
    lost: Option<Loss>,
}

/// A frame without process data: the command, station address and register of its first datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Own {
    pub(crate) command: u8,
    pub(crate) station: u16,
    pub(crate) register: u16,
}

/// The frame with this datagram gets lost.
#[derive(Clone, Copy)]
pub(crate) enum Loss {
    /// On its way out: the segment does not see it.
    Request(u64),
    /// On its way back: the segment has acted on it.
    Answer(u64),
}

#[derive(Clone)]
pub(crate) struct Line(Arc<Mutex<Counted>>);

impl Line {
    pub(crate) fn new(segment: Segment) -> Self {
        Self(Arc::new(Mutex::new(Counted {
            segment,
            seen: 0,
            frames: 0,
            own: Vec::new(),
            due: None,
            repeating: Repeating::default(),
            lost: None,
        })))
    }

    fn counted(&self) -> MutexGuard<'_, Counted> {
        self.0.lock().unwrap()
    }

    /// Counts from 0 again, and lets the device at `position` send these emergencies after datagram number `after`
    /// (from 1). Datagrams count while that device is in PREOP or above.
    pub(crate) fn arm(&self, after: u64, position: usize, emergencies: &[Emergency]) {
        let mut counted = self.counted();
        counted.seen = 0;
        counted.lost = None;
        counted.due = Some(Due {
            after,
            position,
            emergencies: emergencies.to_vec(),
        });
    }

    pub(crate) fn lose(&self, loss: Loss) {
        self.counted().lost = Some(loss);
    }

    /// Sends emergencies now.
    pub(crate) fn inject(&self, position: usize, emergencies: &[Emergency], now: Duration) {
        let device = &mut self.counted().segment;
        send(device, position, emergencies, now);
    }

    /// The segment, for what happens to it.
    pub(crate) fn with_segment<T>(&self, act: impl FnOnce(&mut Segment) -> T) -> T {
        act(&mut self.counted().segment)
    }

    /// From now on lets the device at `position` send an emergency after every so many datagrams (0: no more), numbered
    /// from 0. Gives how many it has sent since this was called last.
    pub(crate) fn every(&self, datagrams: u64, position: usize) -> u64 {
        let mut counted = self.counted();
        let next = Repeating {
            every: datagrams,
            position,
            ..Repeating::default()
        };
        std::mem::replace(&mut counted.repeating, next).sent
    }

    /// How many datagrams were counted.
    pub(crate) fn seen(&self) -> u64 {
        self.counted().seen
    }

    /// The frames since this was asked last: how many, and those of them without process data.
    pub(crate) fn take_frames(&self) -> (u64, Vec<Own>) {
        let mut counted = self.counted();
        let own = std::mem::take(&mut counted.own);
        (std::mem::take(&mut counted.frames), own)
    }

    /// Whether the emergencies still wait for their datagram.
    pub(crate) fn is_armed(&self) -> bool {
        self.counted().due.is_some()
    }

    pub(crate) fn al_state(&self, position: usize) -> AlState {
        self.counted().segment.devices()[position].al_state()
    }

    pub(crate) fn wire(&self) -> Wire {
        let line = self.clone();
        Wire::in_virtual_time(LATENCY, move |frame: &mut [u8], now| {
            line.counted().process(frame, now)
        })
    }
}

impl Counted {
    /// Takes the frame's datagrams through the segment one at a time, so that something can happen between them.
    fn process(&mut self, frame: &mut [u8], now: Duration) -> bool {
        self.frames += 1;
        if !LOGICAL.contains(&frame[BEHIND_TAG]) {
            self.own.push(Own {
                command: frame[BEHIND_TAG],
                station: u16::from_le_bytes([frame[BEHIND_TAG + 2], frame[BEHIND_TAG + 3]]),
                register: u16::from_le_bytes([frame[BEHIND_TAG + 4], frame[BEHIND_TAG + 5]]),
            });
        }
        let datagrams = datagrams(frame);
        let seen = self.seen;
        let counts = self.counts();
        let holds =
            |datagram| counts && (seen + 1..=seen + datagrams.len() as u64).contains(&datagram);
        let (request_lost, answer_lost) = match self.lost {
            Some(Loss::Request(datagram)) => (holds(datagram), false),
            Some(Loss::Answer(datagram)) => (false, holds(datagram)),
            None => (false, false),
        };
        let mut comes_back = false;
        for Range { start: at, end } in datagrams {
            if request_lost {
                self.count(now);
                continue;
            }
            let more = frame[at + 7] & MORE_FOLLOW;
            let mut alone = frame[..HEADERS].to_vec();
            alone.extend_from_slice(&frame[at..end]);
            alone[HEADERS + 7] &= !MORE_FOLLOW;
            comes_back |= self.segment.process(&mut alone, now);
            alone[HEADERS + 7] |= more;
            frame[at..end].copy_from_slice(&alone[HEADERS..]);
            // The first SubDevice marks the source address.
            frame[6] = alone[6];
            self.count(now);
        }
        comes_back && !answer_lost
    }

    /// Whether the device is in PREOP or above.
    fn counts(&self) -> bool {
        let position = self.due.as_ref().map_or(0, |due| due.position);
        self.segment.devices()[position].al_state() != AlState::Init
    }

    fn count(&mut self, now: Duration) {
        if !self.counts() {
            return;
        }
        self.seen += 1;
        if self.repeating.every != 0 && self.seen.is_multiple_of(self.repeating.every) {
            let (position, number) = (self.repeating.position, self.repeating.sent);
            self.repeating.sent += 1;
            send(&mut self.segment, position, &[emergency(number)], now);
        }
        if let Some(due) = self.due.take_if(|due| due.after == self.seen) {
            send(&mut self.segment, due.position, &due.emergencies, now);
        }
    }
}

/// Where the frame's datagrams behind the tag are.
fn datagrams(frame: &[u8]) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    let mut at = BEHIND_TAG;
    loop {
        let length = u16::from_le_bytes([frame[at + 6], frame[at + 7] & 0x07]);
        let end = at + DATAGRAM_HEADER + usize::from(length) + WORKING_COUNTER;
        found.push(at..end);
        if frame[at + 7] & MORE_FOLLOW == 0 {
            return found;
        }
        at = end;
    }
}

fn send(segment: &mut Segment, position: usize, emergencies: &[Emergency], now: Duration) {
    let device = segment.device_mut(position).unwrap();
    for emergency in emergencies {
        device.inject_emergency(emergency.code, emergency.register, emergency.data, now);
    }
}

/// An emergency that no other number gives.
pub(crate) fn emergency(number: u64) -> Emergency {
    const CODES: [u16; 4] = [0x7320, 0x3220, 0x8611, 0x4210];
    let [a, b, c, ..] = number.to_le_bytes();
    Emergency {
        code: CODES[(number % 4) as usize],
        register: 0x01 | a << 1,
        data: [a, b, c, !a, 0xA5],
    }
}

/// A network and its loop.
pub(crate) struct Rig {
    pub(crate) net: Network,
    pub(crate) bus: BusLoop,
}

impl Rig {
    /// Up to OP.
    pub(crate) fn start(builder: NetworkBuilder) -> Self {
        let (starting, mut bus) = builder.split().unwrap();
        let net = turn_until(&mut bus, starting.network()).unwrap();
        Self { net, bus }
    }

    pub(crate) fn until<T>(&mut self, future: impl Future<Output = T>) -> T {
        turn_until(&mut self.bus, future)
    }

    pub(crate) fn run_for(&mut self, time: Duration) {
        let end = self.bus.now() + time;
        while self.bus.now() < end {
            assert!(self.bus.turn(), "the loop has ended");
        }
    }

    pub(crate) fn emergencies(&self, position: u16) -> Emergencies {
        self.net.emergencies(position).unwrap()
    }

    /// Demands these of the drive at `position`, in this order, and then no other.
    pub(crate) fn expect(&mut self, position: u16, expected: &[Emergency]) {
        let emergencies = self.emergencies(position);
        for expected in expected {
            let got = self.until(emergencies.next()).unwrap().emergency();
            assert_eq!(got.unwrap().emergency, *expected);
        }
        assert_eq!(
            emergencies.try_next(),
            None,
            "none comes twice, none is lost"
        );
    }
}

/// Turns the loop until the future is ready.
fn turn_until<T>(bus: &mut BusLoop, future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    let end = bus.now() + LIMIT;
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
        assert!(bus.turn(), "the loop has ended");
        assert!(bus.now() < end, "not ready within {LIMIT:?}");
    }
}

/// Says at which datagram a test failed.
pub(crate) struct At(pub(crate) u64);

impl Drop for At {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("with the emergency after datagram {}", self.0);
        }
    }
}
