//! The link to a line with seeded faults, in virtual time.

use std::{
    collections::VecDeque,
    io,
    sync::{Arc, Mutex, MutexGuard},
    task::Waker,
    time::Duration,
};

use servocrab::link::Link;
use servocrab_sim::{Faults, FaultyLine, Rate, Segment};

use crate::messages;

/// How long a frame takes to come back where nothing delays it.
const LATENCY: Duration = Duration::from_micros(10);
const US: Duration = Duration::from_micros(1);

/// A line with faults, which outlives the cables of its networks.
#[derive(Clone)]
pub struct Wired {
    line: Arc<Mutex<FaultyLine>>,
    /// Of what was sent to mailboxes.
    messages: Arc<Mutex<messages::Watch>>,
    now: Arc<Mutex<Duration>>,
    /// Whether what devices say can reach the program as something else, with nobody able to tell.
    pub lies: bool,
}

impl Wired {
    pub fn new(segment: Segment, faults: &Faults) -> Self {
        let mut line = FaultyLine::new(segment, faults).expect("no outage is asked for");
        line.set_quiet(true);
        let messages = Arc::new(Mutex::new(messages::Watch::default()));
        let watch = Arc::clone(&messages);
        line.watch(move |sent, answer| watch.lock().unwrap().see(sent, answer));
        let never = Rate::default();
        Self {
            line: Arc::new(Mutex::new(line)),
            messages,
            now: Arc::default(),
            lies: faults.flip_data != never || faults.mail_garbage != never,
        }
    }

    pub fn line(&self) -> MutexGuard<'_, FaultyLine> {
        self.line.lock().unwrap()
    }

    pub fn messages(&self) -> MutexGuard<'_, messages::Watch> {
        self.messages.lock().unwrap()
    }

    /// The time of the cable.
    pub fn now(&self) -> Duration {
        *self.now.lock().unwrap()
    }
}

pub struct Cable {
    wired: Wired,
    now: Duration,
    /// On their way to the interface: when they arrive.
    arriving: VecDeque<(Duration, Vec<u8>)>,
    refused: u64,
}

impl Cable {
    /// A new one: what is on its way to the one before is nobody's.
    pub fn new(wired: &Wired) -> Self {
        wired.line().forget();
        Self {
            wired: wired.clone(),
            now: wired.now(),
            arriving: VecDeque::new(),
            refused: 0,
        }
    }

    /// Takes in what the line has returned by now.
    fn take_in(&mut self) {
        let mut line = self.wired.line();
        line.advance(self.now);
        while let Some(at) = line.next_arrival().filter(|at| *at <= self.now)
            && let Some(frame) = line.receive(self.now)
        {
            self.arriving.push_back((at + LATENCY, frame));
        }
    }

    fn next(&self) -> Option<Duration> {
        let arriving = self.arriving.front().map(|(at, _)| *at);
        let returning = self.wired.line().next_arrival();
        arriving.into_iter().chain(returning).min()
    }
}

impl Link for Cable {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        let mut frame = frame.to_vec();
        frame.resize(frame.len().max(60), 0);
        if !self.wired.line().send(&frame, self.now) {
            self.refused += 1;
            let kinds = [io::ErrorKind::WouldBlock, io::ErrorKind::NetworkDown];
            return Err(kinds[(self.refused % 2) as usize].into());
        }
        self.take_in();
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        self.take_in();
        if self.arriving.front().is_none_or(|(at, _)| *at > self.now) {
            return Ok(None);
        }
        let Some((_, frame)) = self.arriving.pop_front() else {
            return Ok(None);
        };
        buffer[..frame.len()].copy_from_slice(&frame);
        Ok(Some(frame.len()))
    }

    fn wait(&mut self, until: Duration) {
        let until = self.next().map_or(until, |next| next.min(until));
        self.now = self.now.max(until);
        self.take_in();
        *self.wired.now.lock().unwrap() = self.now;
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
