//! An in-process wire: frames go through a function instead of a cable, in real or in virtual time.

use std::{
    collections::VecDeque,
    io,
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, Ordering},
    },
    task::{Wake, Waker},
    thread::{self, Thread},
    time::{Duration, Instant},
};

use super::{Link, SHORTEST_FRAME};

/// What a segment does with a frame: changes it in place and says whether it comes back.
type Segment = Box<dyn FnMut(&mut [u8], Duration) -> bool + Send>;
/// Decides a frame's fate: its number (from 0) and its bytes as sent.
type Plan = Box<dyn FnMut(u64, &[u8]) -> Fate + Send>;

/// What a look without sleeping takes in virtual time.
const PAUSE: Duration = Duration::from_micros(1);

/// What happens to a frame on a [`Wire`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fate {
    /// It comes back.
    Deliver,
    /// It is lost on its way out: the segment never sees it.
    LoseRequest,
    /// It is lost on its way back: the segment has acted on it.
    LoseAnswer,
    /// It comes back this much later.
    Delay(Duration),
    /// It comes back twice.
    Double,
    /// It comes back with this byte (counted from the start of the Ethernet frame) inverted.
    Corrupt(usize),
    /// It comes back cut to this length.
    Cut(usize),
}

/// A link to a segment inside the process.
///
/// ```
/// use servocrab::link::{Link, Wire};
/// // A segment that answers every frame as it came, with the bit that the first SubDevice sets in the source address.
/// let mut wire = Wire::new(|frame: &mut [u8], _now| {
///     frame[6] |= 0x02;
///     true
/// });
/// wire.send(&[0; 60])?;
/// let mut buffer = [0; 1514];
/// assert_eq!(wire.receive(&mut buffer)?, Some(60));
/// assert_eq!(buffer[6], 0x02);
/// # Ok::<(), std::io::Error>(())
/// ```
pub struct Wire {
    segment: Segment,
    plan: Option<Plan>,
    sent: u64,
    clock: Clock,
    returning: VecDeque<(Duration, Vec<u8>)>,
    spare: Vec<Vec<u8>>,
    parked: Arc<Parked>,
}

enum Clock {
    Real(Instant),
    Virtual { now: Duration, latency: Duration },
}

impl Wire {
    /// A wire in real time to this segment, which changes a frame in place and says whether it comes back.
    #[must_use]
    pub fn new(segment: impl FnMut(&mut [u8], Duration) -> bool + Send + 'static) -> Self {
        Self::with_clock(Box::new(segment), Clock::Real(Instant::now()))
    }

    /// A wire in virtual time: waiting takes no time but moves the clock, and each frame takes `latency` to come back.
    #[must_use]
    pub fn in_virtual_time(
        latency: Duration,
        segment: impl FnMut(&mut [u8], Duration) -> bool + Send + 'static,
    ) -> Self {
        let now = Duration::ZERO;
        Self::with_clock(Box::new(segment), Clock::Virtual { now, latency })
    }

    /// Lets `plan` decide each frame's fate, from the frame's number (from 0) and its bytes as sent.
    #[must_use]
    pub fn with_plan(mut self, plan: impl FnMut(u64, &[u8]) -> Fate + Send + 'static) -> Self {
        self.plan = Some(Box::new(plan));
        self
    }

    fn with_clock(segment: Segment, clock: Clock) -> Self {
        Self {
            segment,
            plan: None,
            sent: 0,
            clock,
            returning: VecDeque::new(),
            spare: Vec::new(),
            parked: Arc::new(Parked {
                thread: OnceLock::new(),
                woken: AtomicBool::new(false),
            }),
        }
    }

    fn return_at(&mut self, at: Duration, frame: Vec<u8>) {
        let behind = self.returning.partition_point(|(other, _)| *other <= at);
        self.returning.insert(behind, (at, frame));
    }
}

impl Link for Wire {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        let number = self.sent;
        self.sent += 1;
        let fate = self
            .plan
            .as_mut()
            .map_or(Fate::Deliver, |plan| plan(number, frame));
        if fate == Fate::LoseRequest {
            return Ok(());
        }
        let mut bytes = self.spare.pop().unwrap_or_default();
        bytes.clear();
        bytes.extend_from_slice(frame);
        if bytes.len() < SHORTEST_FRAME {
            bytes.resize(SHORTEST_FRAME, 0);
        }
        let now = self.now();
        if !(self.segment)(&mut bytes, now) {
            self.spare.push(bytes);
            return Ok(());
        }
        let latency = match self.clock {
            Clock::Real(_) => Duration::ZERO,
            Clock::Virtual { latency, .. } => latency,
        };
        let mut at = now + latency;
        match fate {
            Fate::LoseRequest | Fate::LoseAnswer => {
                self.spare.push(bytes);
                return Ok(());
            }
            Fate::Deliver => {}
            Fate::Delay(delay) => at += delay,
            Fate::Double => self.return_at(at, bytes.clone()),
            Fate::Corrupt(position) => {
                if let Some(byte) = bytes.get_mut(position) {
                    *byte = !*byte;
                }
            }
            Fate::Cut(length) => bytes.truncate(length),
        }
        self.return_at(at, bytes);
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        let now = self.now();
        while self.returning.front().is_some_and(|(at, _)| *at <= now) {
            let Some((_, frame)) = self.returning.pop_front() else {
                break;
            };
            let length = frame.len();
            let fits = buffer
                .get_mut(..length)
                .map(|to| to.copy_from_slice(&frame));
            self.spare.push(frame);
            if fits.is_some() {
                return Ok(Some(length));
            }
        }
        Ok(None)
    }

    fn wait(&mut self, until: Duration) {
        let until = self
            .returning
            .front()
            .map_or(until, |(at, _)| until.min(*at));
        match &mut self.clock {
            Clock::Virtual { now, .. } => *now = until.max(*now),
            Clock::Real(start) => self.parked.wait(until.saturating_sub(start.elapsed())),
        }
    }

    fn pause(&mut self) {
        match self.clock {
            Clock::Virtual { .. } => self.wait(self.now() + PAUSE),
            Clock::Real(_) => std::hint::spin_loop(),
        }
    }

    fn now(&self) -> Duration {
        match self.clock {
            Clock::Real(start) => start.elapsed(),
            Clock::Virtual { now, .. } => now,
        }
    }

    fn is_virtual(&self) -> bool {
        matches!(self.clock, Clock::Virtual { .. })
    }

    fn waker(&self) -> Waker {
        Waker::from(Arc::clone(&self.parked))
    }
}

/// The thread that waits on the wire: the first that did. On any other a wake is only seen when its wait is over.
struct Parked {
    thread: OnceLock<Thread>,
    woken: AtomicBool,
}

impl Parked {
    fn wait(&self, timeout: Duration) {
        if timeout.is_zero() {
            return;
        }
        self.thread.get_or_init(thread::current);
        if !self.woken.swap(false, Ordering::AcqRel) {
            thread::park_timeout(timeout);
            self.woken.store(false, Ordering::Release);
        }
    }
}

impl Wake for Parked {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        self.woken.store(true, Ordering::Release);
        if let Some(thread) = self.thread.get() {
            thread.unpark();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{Fate, Wire};
    use crate::link::Link;

    const LATENCY: Duration = Duration::from_micros(10);

    fn echo(plan: impl FnMut(u64, &[u8]) -> Fate + Send + 'static) -> Wire {
        Wire::in_virtual_time(LATENCY, |_, _| true).with_plan(plan)
    }

    #[test]
    fn waiting_in_virtual_time_ends_when_the_next_frame_comes_back() {
        let mut wire = echo(|_, _| Fate::Deliver);
        let mut buffer = [0; 1514];
        wire.send(&[7; 64]).unwrap();
        assert_eq!(wire.receive(&mut buffer).unwrap(), None);
        wire.wait(Duration::from_secs(1));
        assert_eq!(wire.now(), LATENCY);
        assert_eq!(wire.receive(&mut buffer).unwrap(), Some(64));
        wire.wait(Duration::from_secs(1));
        assert_eq!(wire.now(), Duration::from_secs(1));
    }

    #[test]
    fn short_frames_are_padded_as_on_a_cable() {
        let mut wire = echo(|_, _| Fate::Deliver);
        wire.send(&[7; 20]).unwrap();
        wire.wait(LATENCY);
        assert_eq!(wire.receive(&mut [0; 1514]).unwrap(), Some(60));
    }

    #[test]
    fn each_frame_meets_the_fate_that_the_plan_gives_it() {
        let mut wire = echo(|number, _| match number {
            0 => Fate::LoseAnswer,
            1 => Fate::Delay(Duration::from_millis(1)),
            2 => Fate::Double,
            3 => Fate::Corrupt(14),
            _ => Fate::Cut(17),
        });
        for number in 0..5 {
            wire.send(&[number; 64]).unwrap();
        }
        wire.wait(Duration::from_millis(1));
        let mut buffer = [0; 1514];
        let mut come_back = Vec::new();
        while wire.now() < Duration::from_millis(3) {
            while let Some(length) = wire.receive(&mut buffer).unwrap() {
                come_back.push((buffer[0], buffer[14], length));
            }
            wire.wait(wire.now() + Duration::from_millis(1));
        }
        assert_eq!(
            come_back,
            [(2, 2, 64), (2, 2, 64), (3, !3, 64), (4, 4, 17), (1, 1, 64)]
        );
    }
}
