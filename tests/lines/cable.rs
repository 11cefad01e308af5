//! A cable in virtual time that does to frames what a bad cable, a bad driver or a bad device does.

use std::{
    collections::{BTreeMap, VecDeque},
    io,
    sync::{Arc, Mutex},
    task::Waker,
    time::Duration,
};

use servocrab::link::Link;
use servocrab_sim::Segment;

use crate::{mails, random::Random};

/// How long a frame takes to come back.
const LATENCY: Duration = Duration::from_micros(10);
const US: Duration = Duration::from_micros(1);

/// What can happen to a frame, or to a mail in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Trouble {
    RequestLost,
    AnswerLost,
    /// It comes back in one of the next cycles.
    Late,
    /// It comes back when its request is long given up.
    VeryLate,
    /// Later ones overtake it.
    Overtaken,
    /// It and all behind it stay in the interface for some milliseconds.
    HeldUp,
    AnswerTwice,
    /// It passes the devices twice.
    PassesTwice,
    Cut,
    /// A bit of its headers, or of a datagram's.
    HeaderBit,
    /// A working counter is any number.
    Counter,
    /// A bit of what devices answered.
    DataBit,
    /// Frames of others come with it.
    Foreign,
    /// The interface refuses it.
    NotSent,
    /// A mail's toggle bit, or its counter, is another.
    MailBits,
    /// In place of a mail comes an earlier one about another object.
    OtherMail,
    /// In place of a mail comes an emergency.
    EmergencyInstead,
    /// In place of a mail comes anything.
    Garbage,
}

pub const ALL: [Trouble; 18] = [
    Trouble::RequestLost,
    Trouble::AnswerLost,
    Trouble::Late,
    Trouble::VeryLate,
    Trouble::Overtaken,
    Trouble::HeldUp,
    Trouble::AnswerTwice,
    Trouble::PassesTwice,
    Trouble::Cut,
    Trouble::HeaderBit,
    Trouble::Counter,
    Trouble::DataBit,
    Trouble::Foreign,
    Trouble::NotSent,
    Trouble::MailBits,
    Trouble::OtherMail,
    Trouble::EmergencyInstead,
    Trouble::Garbage,
];

/// What the cable does now.
pub struct Weather {
    pub random: Random,
    /// How often of a million times.
    pub rates: BTreeMap<Trouble, u64>,
    pub calm: bool,
    /// How often each has happened.
    pub seen: BTreeMap<Trouble, u64>,
    /// Of what was sent to mailboxes, and came from them.
    pub mails: mails::Watch,
    /// The time of the cable.
    pub now: Duration,
}

impl Weather {
    pub fn new(seed: u64) -> Self {
        Self {
            random: Random::new(seed),
            rates: BTreeMap::new(),
            calm: true,
            seen: BTreeMap::new(),
            mails: mails::Watch::default(),
            now: Duration::ZERO,
        }
    }

    fn happens(&mut self, trouble: Trouble) -> bool {
        let rate = self.rates.get(&trouble).copied().unwrap_or(0);
        let happens = !self.calm && rate > 0 && self.random.below(1_000_000) < rate;
        if happens {
            *self.seen.entry(trouble).or_default() += 1;
            tracing::debug!(at = ?self.now, ?trouble);
        }
        happens
    }

    /// Whether what devices say can reach the program as something else, with nobody able to tell.
    pub fn lies(&self) -> bool {
        [Trouble::DataBit, Trouble::Garbage]
            .iter()
            .any(|trouble| self.rates.get(trouble).is_some_and(|rate| *rate > 0))
    }
}

pub struct Cable {
    segment: Arc<Mutex<Segment>>,
    weather: Arc<Mutex<Weather>>,
    now: Duration,
    /// On their way out: when they reach the first device.
    outgoing: VecDeque<(Duration, Vec<u8>)>,
    /// On their way back: when they arrive.
    returning: VecDeque<(Duration, Vec<u8>)>,
}

impl Cable {
    pub fn new(segment: &Arc<Mutex<Segment>>, weather: &Arc<Mutex<Weather>>) -> Self {
        let now = weather.lock().unwrap().now;
        Self {
            segment: Arc::clone(segment),
            weather: Arc::clone(weather),
            now,
            outgoing: VecDeque::new(),
            returning: VecDeque::new(),
        }
    }

    fn return_at(&mut self, at: Duration, frame: Vec<u8>) {
        let behind = self.returning.partition_point(|(other, _)| *other <= at);
        self.returning.insert(behind, (at, frame));
    }

    /// Lets pass what has reached the first device by now.
    fn pass(&mut self) {
        while self.outgoing.front().is_some_and(|(at, _)| *at <= self.now) {
            let Some((at, frame)) = self.outgoing.pop_front() else {
                break;
            };
            self.pass_one(at, frame);
        }
    }

    fn pass_one(&mut self, at: Duration, mut frame: Vec<u8>) {
        let sent = frame.clone();
        let weather = Arc::clone(&self.weather);
        let mut weather = weather.lock().unwrap();
        let mut segment = self.segment.lock().unwrap();
        if !segment.process(&mut frame, at) {
            return;
        }
        weather.mails.see(&sent, &frame);
        if weather.happens(Trouble::PassesTwice) {
            let mut again = sent.clone();
            segment.process(&mut again, at);
            weather.mails.see(&sent, &again);
        }
        drop(segment);
        if weather.happens(Trouble::AnswerLost) {
            return;
        }
        spoil_mails(&mut weather, &mut frame);
        let whole = frame.clone();
        if weather.happens(Trouble::HeaderBit) {
            let places = header_bytes(&frame);
            flip_one_of(&mut weather.random, &mut frame, &places);
        }
        if weather.happens(Trouble::DataBit) {
            let places = data_bytes(&frame);
            flip_one_of(&mut weather.random, &mut frame, &places);
        }
        if weather.happens(Trouble::Counter) {
            let all = datagrams(&frame);
            if let Some(at) = all.get(weather.random.below(all.len() as u64) as usize) {
                let counter = match weather.random.below(3) {
                    0 => weather.random.below(4) as u16,
                    1 => weather.random.next() as u16,
                    _ => 0,
                };
                frame[at.end..at.end + 2].copy_from_slice(&counter.to_le_bytes());
            }
        }
        if weather.happens(Trouble::Cut) {
            let length = weather.random.below(frame.len() as u64) as usize;
            frame.truncate(length);
        }
        let mut back = at + LATENCY;
        if weather.happens(Trouble::Overtaken) {
            back += US * weather.random.between(5, 150) as u32;
        }
        if weather.happens(Trouble::Late) {
            back += US * weather.random.between(500, 9_000) as u32;
        }
        if weather.happens(Trouble::VeryLate) {
            back += US * weather.random.between(20_000, 400_000) as u32;
        }
        if weather.happens(Trouble::AnswerTwice) {
            let again = back + US * weather.random.below(3_000) as u32;
            self.return_at(again, frame.clone());
        }
        if weather.happens(Trouble::Foreign) {
            let foreign = foreign(&mut weather.random, &sent, &whole);
            self.return_at(back, foreign);
        }
        self.return_at(back, frame);
    }

    fn next(&self) -> Option<Duration> {
        let fronts = [self.outgoing.front(), self.returning.front()];
        fronts.into_iter().flatten().map(|(at, _)| *at).min()
    }
}

impl Link for Cable {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        let mut weather = self.weather.lock().unwrap();
        if weather.happens(Trouble::NotSent) {
            let kinds = [io::ErrorKind::WouldBlock, io::ErrorKind::NetworkDown];
            return Err(weather.random.one_of(&kinds).into());
        }
        if weather.happens(Trouble::RequestLost) {
            return Ok(());
        }
        let mut at = self.outgoing.back().map_or(self.now, |(at, _)| *at);
        at = at.max(self.now);
        if weather.happens(Trouble::HeldUp) {
            at = at.max(self.now + US * weather.random.between(300, 12_000) as u32);
        }
        drop(weather);
        let mut frame = frame.to_vec();
        frame.resize(frame.len().max(60), 0);
        self.outgoing.push_back((at, frame));
        self.pass();
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        self.pass();
        if self.returning.front().is_none_or(|(at, _)| *at > self.now) {
            return Ok(None);
        }
        let Some((_, frame)) = self.returning.pop_front() else {
            return Ok(None);
        };
        buffer[..frame.len()].copy_from_slice(&frame);
        Ok(Some(frame.len()))
    }

    fn wait(&mut self, until: Duration) {
        let until = self.next().map_or(until, |next| next.min(until));
        self.now = self.now.max(until);
        self.pass();
        self.weather.lock().unwrap().now = self.now;
    }

    fn pause(&mut self) {
        self.wait(self.now + US);
    }

    fn now(&self) -> Duration {
        self.now
    }

    fn is_virtual(&self) -> bool {
        true
    }

    fn waker(&self) -> Waker {
        Waker::noop().clone()
    }
}

/// Where the data of each datagram lie (ETG.1000.4): ten bytes before them, the working counter behind.
pub fn datagrams(frame: &[u8]) -> Vec<std::ops::Range<usize>> {
    let (mut start, mut found) = (16, Vec::new());
    while let Some(&[l0, l1]) = frame.get(start + 6..start + 8) {
        let flags = u16::from_le_bytes([l0, l1]);
        let data = start + 10..start + 10 + usize::from(flags & 0x07FF);
        if data.end + 2 > frame.len() {
            break;
        }
        start = data.end + 2;
        found.push(data);
        if flags & 0x8000 == 0 {
            break;
        }
    }
    found
}

fn header_bytes(frame: &[u8]) -> Vec<usize> {
    let datagrams = datagrams(frame);
    let of_datagrams = datagrams
        .iter()
        .flat_map(|data| data.start - 10..data.start);
    (0..16).chain(of_datagrams).collect()
}

fn data_bytes(frame: &[u8]) -> Vec<usize> {
    datagrams(frame).into_iter().flatten().collect()
}

fn flip_one_of(random: &mut Random, frame: &mut [u8], places: &[usize]) {
    if let Some(place) = places.get(random.below(places.len() as u64) as usize) {
        frame[*place] ^= 1 << random.below(8);
    }
}

/// A frame that is no answer to anything: of another protocol, the request itself, another master's answer, or noise.
fn foreign(random: &mut Random, sent: &[u8], answer: &[u8]) -> Vec<u8> {
    let mut frame = match random.below(4) {
        0 => {
            let mut ip = answer.to_vec();
            ip[12..14].copy_from_slice(&[0x08, 0x00]);
            ip
        }
        1 => sent.to_vec(),
        2 => {
            let mut other = answer.to_vec();
            other[8..12]
                .iter_mut()
                .for_each(|byte| *byte = random.next() as u8);
            other
        }
        _ => {
            let mut noise = answer.to_vec();
            noise[14..]
                .iter_mut()
                .for_each(|byte| *byte = random.next() as u8);
            noise
        }
    };
    frame.truncate(1514);
    frame
}

/// What a bad device puts into its mailbox.
fn spoil_mails(weather: &mut Weather, frame: &mut [u8]) {
    for data in datagrams(frame) {
        if !mails::is_answered_mail(frame, &data) {
            continue;
        }
        let station = u16::from_le_bytes([frame[data.start - 8], frame[data.start - 7]]);
        let mail = frame[data.clone()].to_vec();
        let mut other = None;
        if weather.happens(Trouble::MailBits) {
            let mut bits = mail.clone();
            match weather.random.below(2) {
                0 => bits[5] ^= 0x10 << weather.random.below(3),
                _ => bits[8] ^= 0x10,
            }
            other = Some(bits);
        }
        if weather.happens(Trouble::OtherMail) {
            let earlier = weather.mails.earlier(&mut weather.random, station, &mail);
            other = earlier.or(other);
        }
        if weather.happens(Trouble::EmergencyInstead) {
            other = Some(mails::emergency(&mut weather.random));
        }
        if weather.happens(Trouble::Garbage) {
            let mut garbage = mail.clone();
            let from = weather.random.below(12) as usize;
            let length = weather.random.between(1, 10) as usize;
            let some = garbage.iter_mut().skip(from).take(length);
            some.for_each(|byte| *byte = weather.random.next() as u8);
            other = Some(garbage);
        }
        let Some(other) = other else { continue };
        let mail = &mut frame[data];
        mail.fill(0);
        for (to, from) in mail.iter_mut().zip(other) {
            *to = from;
        }
    }
}
