//! What is counted: a network of many one-axis drives on the simulated segment, in process and in virtual time.

use std::{
    future::Future,
    process,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    task::Poll,
    time::Duration,
};

use servocrab::{
    Axis, AxisConfig, DriveConfig, Network, ProfilePosition, Referencing, SetPoint, bus::BusLoop,
    drives, link::Wire, pdo_map::Direction,
};
use servocrab_sim::{Segment, personality};

use crate::counted::{Outside, counted, poll, until};

/// A part of the scenario that is counted by itself.
pub(crate) struct Phase {
    pub(crate) name: &'static str,
    pub(crate) cycles: usize,
    /// Instructions of each axis in a cycle that are allowed: a little more than was measured, for another compiler's sake.
    pub(crate) bound: f64,
}

/// In the order in which they are lived.
pub(crate) const PHASES: [Phase; 6] = [
    // Enabled, at rest, nothing asked for; the inputs are the same in each cycle, bit for bit.
    Phase {
        name: "standing",
        cycles: 100,
        bound: 90.0,
    },
    // The same, but the position of one axis in eight dithers: it is another by an increment in each cycle.
    Phase {
        name: "some dither",
        cycles: 100,
        bound: 163.0,
    },
    // The position of each of them does.
    Phase {
        name: "all dither",
        cycles: 100,
        bound: 510.0,
    },
    // Every axis on its way; 6064h and 606Ch are others in each cycle.
    Phase {
        name: "moving",
        cycles: 100,
        bound: 520.0,
    },
    // Every axis is given another move, which is acknowledged, and bits 4 and 12 are low again.
    Phase {
        name: "handshake",
        cycles: 10,
        bound: 2480.0,
    },
    // No frame comes back.
    Phase {
        name: "stale",
        cycles: 5,
        bound: 450.0,
    },
];

struct Bus {
    net: Network,
    bus: BusLoop,
}

pub(crate) fn live(axes: usize) {
    let mut segment = Segment::new();
    for _ in 0..axes {
        segment.push(personality::generic());
    }
    let segment = Arc::new(Mutex::new(segment.ideal()));
    let silent = Arc::new(AtomicBool::new(false));
    let unheard = Arc::clone(&silent);
    // One axis in so many dithers; 0: none.
    let dithering = Arc::new(AtomicUsize::new(0));
    let every = Arc::clone(&dithering);
    let place = place();
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        let heard = segment.lock().expect("one thread").process(frame, now)
            && !unheard.load(Ordering::Relaxed);
        let every = every.load(Ordering::Relaxed);
        if every != 0 {
            dither(frame, every, &place);
        }
        heard
    });
    let mut builder = Network::builder().link(Outside(wire));
    for position in 0..axes {
        let name = position.to_string();
        let drive = DriveConfig::new(drives::generic())
            .axis(AxisConfig::new(&name).referencing(Referencing::AbsoluteEncoder));
        builder = builder.drive(u16::try_from(position).expect("fewer drives"), drive);
    }
    let (starting, mut bus) = builder.split().expect("a network");
    let net = until(&mut bus, starting.network()).expect("the line comes up");
    let mut bus = Bus { net, bus };
    let axes: Vec<Axis> = (0..axes)
        .map(|position| bus.net.axis(&position.to_string()).expect("an axis"))
        .collect();
    let modes = axes.iter().map(|axis| async {
        axis.enable().await.expect("it is enabled");
        axis.profile_position().await.expect("its mode")
    });
    let modes = bus.all(modes.collect());
    // Longer than standstill takes to show.
    bus.cycles(200);
    bus.counted(0);
    for (phase, every) in [(1, 8), (2, 1)] {
        dithering.store(every, Ordering::Relaxed);
        bus.cycles(10);
        bus.counted(phase);
    }
    dithering.store(0, Ordering::Relaxed);
    bus.all(modes.iter().map(|mode| moved(mode, 1_000_000)).collect());
    bus.cycles(100);
    bus.counted(3);
    let mut moves: Vec<_> = modes
        .iter()
        .map(|mode| Box::pin(moved(mode, 2_000_000)))
        .collect();
    assert!(
        moves
            .iter_mut()
            .all(|sent| poll(sent.as_mut()).is_pending())
    );
    bus.counted(4);
    assert!(
        moves.iter_mut().all(|sent| poll(sent.as_mut()).is_ready()),
        "every move was acknowledged"
    );
    bus.cycles(20);
    silent.store(true, Ordering::Relaxed);
    bus.counted(5);
    process::exit(0);
}

/// Where a drive's process data are in the image, of all that follow one another: bytes of each, and the position's first.
struct Place {
    stride: usize,
    position: usize,
}

fn place() -> Place {
    let mapping = drives::generic().default_mapping().expect("a mapping");
    let layout = mapping.layout();
    let position = layout
        .find(Direction::Inputs, 0x6064, 0)
        .expect("a position");
    Place {
        stride: layout.output_bytes() + layout.input_bytes(),
        position: layout.output_bytes() + position.byte,
    }
}

/// Makes the position of one drive in so many another one in every other cycle, in a frame that comes back.
fn dither(frame: &mut [u8], every: usize, place: &Place) {
    const LRW: u8 = 12;
    // The low bit of the cycle's number, which is the address of the first datagram.
    let bit = frame[18] & 1;
    let mut at = 16;
    loop {
        let number = |at: usize| usize::from(u16::from_le_bytes([frame[at], frame[at + 1]]));
        let (command, logical, length) = (frame[at], number(at + 2), number(at + 6));
        let data = at + 10;
        let end = data + (length & 0x07FF);
        if command == LRW {
            for first in (data..end).step_by(place.stride) {
                let drive = (logical + first - data) / place.stride;
                if drive.is_multiple_of(every) {
                    frame[first + place.position] ^= bit;
                }
            }
        }
        if length & 0x8000 == 0 {
            return;
        }
        at = end + 2;
    }
}

async fn moved(mode: &ProfilePosition, target: i32) {
    let set_point = SetPoint::new()
        .velocity(100_000)
        .acceleration(1_000_000)
        .deceleration(1_000_000);
    let sent = mode.move_abs(target, set_point).await;
    drop(sent.expect("the move is acknowledged"));
}

impl Bus {
    fn counted(&mut self, phase: usize) {
        counted(|| self.cycles(PHASES[phase].cycles));
    }

    /// Whole cycles, from the sending of one to that of another.
    fn cycles(&mut self, cycles: usize) {
        let end = self.net.statistics().cycles + cycles as u64;
        while self.net.statistics().cycles < end {
            assert!(self.bus.turn(), "the loop has ended");
        }
    }

    /// All of these at once.
    fn all<T>(&mut self, futures: Vec<impl Future<Output = T>>) -> Vec<T> {
        let mut futures: Vec<_> = futures.into_iter().map(Box::pin).collect();
        let mut values: Vec<Option<T>> = futures.iter().map(|_| None).collect();
        while values.iter().any(Option::is_none) {
            for (value, future) in values.iter_mut().zip(&mut futures) {
                if value.is_none()
                    && let Poll::Ready(ready) = poll(future.as_mut())
                {
                    *value = Some(ready);
                }
            }
            assert!(self.bus.turn(), "the loop has ended");
        }
        values.into_iter().flatten().collect()
    }
}
