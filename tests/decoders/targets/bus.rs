//! The bus thread: a bring-up and some cycles on a wire that changes, cuts, doubles, delays and loses what comes back.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use servocrab::Referencing;
use servocrab::drives;
use servocrab::link::{Fate, Wire};
use servocrab::{AxisConfig, DriveConfig, Network, bus::BusLoop};
use servocrab_sim::{Segment, personality};
use std::future::Future;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use super::memory::within;

/// Longer than any bring-up, in virtual time.
const LIMIT: Duration = Duration::from_secs(60);

/// What happens to the frames: each step waits for some frames first.
struct Spoiler {
    script: Vec<u8>,
    at: usize,
    wait: u8,
}

impl Spoiler {
    fn byte(&mut self) -> u8 {
        self.at += 1;
        self.script.get(self.at - 1).copied().unwrap_or(0)
    }

    /// Whether the step is due with this frame.
    fn due(&mut self) -> bool {
        if self.at >= self.script.len() {
            return false;
        }
        self.wait = self.wait.saturating_sub(1);
        self.wait == 0
    }

    fn next(&mut self) {
        self.wait = self.byte();
    }

    /// Changes bytes of a frame that comes back.
    fn spoil(&mut self, frame: &mut [u8]) {
        let place = usize::from(self.byte());
        let length = usize::from(self.byte() % 16);
        for at in place..place + length {
            let byte = self.byte();
            if let Some(to) = frame.get_mut(at) {
                *to = byte;
            }
        }
    }
}

/// The script: frames to let pass, then what happens to one. It ends in OP or in an error, within a minute of virtual time,
/// and holds at most 16 MiB: a damaged frame may tell of 65 535 devices, each of which is asked about with some 140 bytes.
pub fn run(data: &[u8]) {
    within(16 << 20, || bring_up(data));
}

fn bring_up(data: &[u8]) {
    let mut spoiler = Spoiler {
        script: data.to_vec(),
        at: 0,
        wait: 0,
    };
    spoiler.next();
    let spoiler = Arc::new(Mutex::new(spoiler));
    let shared = Arc::clone(&spoiler);
    let mut segment = Segment::new().with(personality::generic());
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        let back = segment.process(frame, now);
        let mut spoiler = spoiler.lock().unwrap_or_else(PoisonError::into_inner);
        if spoiler.due() {
            spoiler.spoil(frame);
            spoiler.next();
        }
        back
    });
    let wire = wire.with_plan(move |_, _| {
        let mut spoiler = shared.lock().unwrap_or_else(PoisonError::into_inner);
        if spoiler.wait != 1 || spoiler.at >= spoiler.script.len() {
            return Fate::Deliver;
        }
        let fate = match spoiler.byte() {
            0 => Fate::LoseRequest,
            1 => Fate::LoseAnswer,
            2 => Fate::Double,
            3 => Fate::Cut(usize::from(spoiler.byte())),
            4 => Fate::Delay(Duration::from_micros(u64::from(spoiler.byte()) * 50)),
            5 => Fate::Corrupt(usize::from(spoiler.byte())),
            _ => return Fate::Deliver,
        };
        spoiler.next();
        fate
    });
    let drive = DriveConfig::new(drives::generic())
        .axis(AxisConfig::new("x").referencing(Referencing::UnreferencedMovesAllowed));
    let builder = Network::builder().link(wire).drive(0, drive);
    let Ok((starting, mut bus)) = builder.split() else {
        return;
    };
    let Some(Ok(net)) = until(&mut bus, starting.network()) else {
        return;
    };
    let end = bus.now() + Duration::from_millis(20);
    while bus.now() < end && bus.turn() {}
    let _ = until(&mut bus, net.shutdown());
}

/// Turns the loop until the future is ready; `None` if the loop ends before.
fn until<T>(bus: &mut BusLoop, future: impl Future<Output = T>) -> Option<T> {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    let end = bus.now() + LIMIT;
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return Some(value);
        }
        let goes_on = bus.turn();
        assert!(bus.now() < end, "not over within {LIMIT:?}");
        if !goes_on {
            return match future.as_mut().poll(&mut context) {
                Poll::Ready(value) => Some(value),
                Poll::Pending => None,
            };
        }
    }
}
