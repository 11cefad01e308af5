//! A network and a simulated segment in virtual time, turned by the test itself.

use std::{
    future::Future,
    pin::pin,
    sync::{Arc, Mutex, MutexGuard},
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    DriveConfig, Move, Network, NetworkError, Outcome, ProfilePosition, Referencing, SetPoint,
    bus::{BusLoop, NetworkBuilder, Recovered},
    drives::{self, DriveDescription},
    link::{Fate, Wire},
};
use servocrab_sim::Segment;

/// How long a frame takes to come back.
const LATENCY: Duration = Duration::from_micros(10);
/// Longer than anything that a test waits for.
const LIMIT: Duration = Duration::from_secs(120);

/// A simulated segment that the test and the wire share.
#[derive(Clone)]
pub(crate) struct Line(pub(crate) Arc<Mutex<Segment>>);

impl Line {
    pub(crate) fn new(segment: Segment) -> Self {
        Self(Arc::new(Mutex::new(segment)))
    }

    /// With shafts that are exactly where their demand is, for tests of figures.
    pub(crate) fn ideal(segment: Segment) -> Self {
        Self::new(segment.ideal())
    }

    pub(crate) fn segment(&self) -> MutexGuard<'_, Segment> {
        self.0.lock().unwrap()
    }

    pub(crate) fn wire(&self) -> Wire {
        let segment = Arc::clone(&self.0);
        Wire::in_virtual_time(LATENCY, move |frame: &mut [u8], now| {
            segment.lock().unwrap().process(frame, now)
        })
    }

    /// A wire whose clock begins where another network's has ended.
    pub(crate) fn wire_from(&self, begin: Duration) -> Wire {
        let segment = Arc::clone(&self.0);
        Wire::in_virtual_time(LATENCY, move |frame: &mut [u8], now| {
            segment.lock().unwrap().process(frame, begin + now)
        })
    }

    pub(crate) fn wire_with(&self, plan: impl FnMut(u64, &[u8]) -> Fate + Send + 'static) -> Wire {
        self.wire().with_plan(plan)
    }
}

impl Line {
    /// A wire on which each frame is changed before the segment sees it.
    pub(crate) fn spoiled_wire(&self, spoil: impl Fn(&mut [u8]) + Send + 'static) -> Wire {
        let segment = Arc::clone(&self.0);
        Wire::in_virtual_time(LATENCY, move |frame: &mut [u8], now| {
            spoil(frame);
            segment.lock().unwrap().process(frame, now)
        })
    }
}

/// Where a frame has its first datagram: a NOP which says in its index what the frame is for, and has a number as its address.
pub(crate) const TAG: usize = 16;
/// Bytes of that datagram.
pub(crate) const TAG_BYTES: usize = 16;

/// Whether a frame carries process data: of others the first datagram has the index 255.
pub(crate) fn is_cyclic(frame: &[u8]) -> bool {
    frame[TAG + 1] != 0xFF
}

/// The datagrams of a frame, each from its command to its working counter; its data begin at byte 10 (ETG.1000.4).
pub(crate) fn datagrams(frame: &mut [u8]) -> Vec<&mut [u8]> {
    let mut found = Vec::new();
    let mut rest = frame.get_mut(16..).unwrap_or_default();
    while let &[_, _, _, _, _, _, l0, l1, ..] = &*rest {
        let flags = u16::from_le_bytes([l0, l1]);
        let Some((datagram, behind)) = rest.split_at_mut_checked(usize::from(flags & 0x07FF) + 12)
        else {
            break;
        };
        found.push(datagram);
        rest = if flags & 0x8000 == 0 { &mut [] } else { behind };
    }
    found
}

/// Whether a datagram writes to this register of one SubDevice.
pub(crate) fn is_write_to(datagram: &[u8], register: u16) -> bool {
    datagram[0] == 5 && datagram[4..6] == register.to_le_bytes()
}

/// Whether a datagram reads or writes a mailbox: memory of one SubDevice by its address.
pub(crate) fn is_message(datagram: &[u8]) -> bool {
    matches!(datagram[0], 4 | 5) && u16::from_le_bytes([datagram[4], datagram[5]]) >= 0x1000
}

/// An AKD2G with axes `x` and `y`, which are moved without being homed.
pub(crate) fn akd2g() -> DriveConfig {
    unhomed(drives::akd2g(), &["x", "y"])
}

/// A drive with axes of these names, which are moved without being homed.
pub(crate) fn unhomed(description: DriveDescription, axes: &[&str]) -> DriveConfig {
    axes.iter()
        .fold(DriveConfig::new(description), |drive, axis| {
            let drive = drive.axis(*axis);
            drive.change_axis(axis, |axis| {
                axis.referencing(Referencing::UnreferencedMovesAllowed)
            })
        })
}

/// A network and its loop.
pub(crate) struct Rig {
    pub(crate) net: Option<Network>,
    pub(crate) bus: BusLoop,
}

impl Rig {
    pub(crate) fn start(builder: NetworkBuilder) -> Result<Self, NetworkError> {
        let (starting, mut bus) = builder.split()?;
        let net = turn_until(&mut bus, starting.network())?;
        Ok(Self {
            net: Some(net),
            bus,
        })
    }

    pub(crate) fn net(&self) -> &Network {
        self.net.as_ref().unwrap()
    }

    /// Enables the axis and moves it once.
    pub(crate) fn moved(&mut self, axis: &str, target: i32) -> Outcome {
        let axis = self.net().axis(axis).unwrap();
        self.until(axis.enable()).unwrap();
        self.until(async {
            let mode = axis.profile_position().await.unwrap();
            let set_point = SetPoint::new()
                .velocity(100_000)
                .acceleration(1_000_000)
                .deceleration(1_000_000);
            let motion = mode.move_abs(target, set_point).await.unwrap();
            motion.done().await.unwrap()
        })
    }

    /// Starts a way of the axis that takes a minute. What is returned keeps the mode.
    pub(crate) fn starts_a_long_move(&mut self, axis: &str) -> (ProfilePosition, Move) {
        let axis = self.net().axis(axis).unwrap();
        self.until(axis.enable()).unwrap();
        self.until(async {
            let mode = axis.profile_position().await.unwrap();
            let set_point = SetPoint::new()
                .velocity(10_000)
                .acceleration(100_000)
                .deceleration(100_000);
            let motion = mode.move_abs(600_000, set_point).await.unwrap();
            (mode, motion)
        })
    }

    /// Moves each of the axes of the only drive once, and sees that the drive has executed that and nothing else.
    pub(crate) fn moves_each(&mut self, line: &Line, axes: &[&str]) {
        for (number, name) in axes.iter().enumerate() {
            let moved = self.moved(name, 10_000);
            assert!(
                matches!(moved, Outcome::Reached { .. }),
                "{name}: {moved:?}"
            );
            let segment = line.segment();
            let executed = segment.axis(0, number).unwrap().ledger();
            assert_eq!(executed.len(), 1, "{name}");
            assert_eq!(executed[0].value, 10_000, "{name}");
        }
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

    /// The SubDevice at this position is without power for a while.
    pub(crate) fn loses_power(&mut self, line: &Line, position: usize) {
        line.segment().device_mut(position).unwrap().power_off();
        self.run_for(Duration::from_millis(300));
        let now = self.bus.now();
        line.segment().device_mut(position).unwrap().power_on(now);
        self.run_for(Duration::from_millis(100));
    }

    pub(crate) fn recover(&mut self, position: u16) -> Result<Recovered, NetworkError> {
        let net = self.net.take().unwrap();
        let recovered = self.until(net.recover(position));
        self.net = Some(net);
        recovered
    }

    /// The end in order.
    pub(crate) fn shutdown(mut self) {
        let net = self.net.take().unwrap();
        let mut over = pin!(net.shutdown());
        let mut context = Context::from_waker(Waker::noop());
        assert!(over.as_mut().poll(&mut context).is_pending());
        self.bus.run();
        assert!(over.as_mut().poll(&mut context).is_ready());
    }
}

/// Turns the loop until the future is ready.
pub(crate) fn turn_until<T>(bus: &mut BusLoop, future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    let end = bus.now() + LIMIT;
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
        let goes_on = bus.turn();
        assert!(
            bus.now() < end,
            "not ready within {LIMIT:?} of virtual time"
        );
        if !goes_on {
            match future.as_mut().poll(&mut context) {
                Poll::Ready(value) => return value,
                Poll::Pending => panic!("the loop has ended and the future is not ready"),
            }
        }
    }
}
