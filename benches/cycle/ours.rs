//! This library: the bus loop with its axis cores, as a program runs it.

use std::{
    cell::{Cell, RefCell},
    future::Future,
    io,
    path::Path,
    pin::pin,
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    axis::Axis,
    bus::{BusLoop, DriveConfig, Network, Receiving},
    coe::obj,
    drives,
    link::{Link, RawSocket},
};

use crate::{
    floor::write_frames,
    measure::{Measured, Mode, PERIOD_NS, cpu_ns, now_ns, serve},
};

/// Second byte of the source address of process data.
const PROCESS_DATA: u8 = 0xC5;

/// Brings the line up, enables every axis, and runs cycles as it is told.
pub(crate) fn servocrab(interface: &str, axes: usize, spin: bool, frames: &Path) {
    let mut line = Line::bring_up(interface, axes, spin);
    write_frames(frames, &last_frames(&mut line.bus));
    serve(|mode, count| line.measure(mode, count));
}

/// A line whose axes are enabled.
pub(crate) struct Line {
    bus: BusLoop,
    _network: Network,
    /// Without its handle an axis is stopped.
    _handles: Vec<Axis>,
}

impl Line {
    pub(crate) fn bring_up(interface: &str, axes: usize, spin: bool) -> Self {
        let link = Watched {
            inner: RawSocket::open(interface).expect("the interface is there"),
            skipped: Duration::ZERO,
            away: 0,
            spin,
        };
        // A machine that is busy with other things loses no drive.
        let mut builder = Network::builder()
            .link(link)
            .watchdog(Duration::from_secs(6))
            .cycle(Duration::from_nanos(PERIOD_NS))
            .receiving(if spin {
                Receiving::Spin
            } else {
                Receiving::Block
            });
        for drive in 0..axes.div_ceil(2) {
            builder = builder.drive(drive as u16, drive_of(drive, axes - 2 * drive));
        }
        let (starting, mut bus) = builder.split().expect("the line is declared well");
        let network = run(&mut bus, starting.network()).expect("the line comes up");
        let handles: Vec<_> = (0..axes)
            .map(|axis| network.axis(&axis.to_string()).expect("it is declared"))
            .collect();
        for axis in &handles {
            run(&mut bus, axis.enable()).expect("the axis is enabled");
        }
        Self {
            bus,
            _network: network,
            _handles: handles,
        }
    }

    pub(crate) fn measure(&mut self, mode: Mode, count: usize) -> Measured {
        measure(&mut self.bus, mode, count)
    }
}

fn drive_of(drive: usize, axes: usize) -> DriveConfig {
    let mut description = drives::akd2g();
    for axis in &mut description.axes {
        axis.outputs = vec![
            obj::CONTROLWORD.into(),
            obj::MODE_OF_OPERATION.into(),
            obj::TARGET_POSITION.into(),
        ];
        axis.inputs = vec![
            obj::STATUSWORD.into(),
            obj::MODE_OF_OPERATION_DISPLAY.into(),
            obj::POSITION_ACTUAL.into(),
        ];
    }
    let mut config = DriveConfig::new(description);
    for axis in 0..axes.min(2) {
        config = config.axis(&(2 * drive + axis).to_string());
    }
    config
}

/// Turns the loop until the future is ready.
fn run<T>(bus: &mut BusLoop, future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    let mut goes_on = true;
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
        assert!(goes_on, "the network has ended");
        goes_on = bus.turn();
    }
}

fn measure(bus: &mut BusLoop, mode: Mode, count: usize) -> Measured {
    FAST.set(mode == Mode::Fast);
    // The first cycle after a rest is late.
    begin(16);
    while TIMES.with_borrow(Vec::len) < 8 {
        assert!(bus.turn());
    }
    begin(count + 16);
    let cpu = cpu_ns();
    while TIMES.with_borrow(Vec::len) < count {
        assert!(bus.turn());
    }
    Measured::new(TIMES.take(), cpu_ns() - cpu)
}

fn begin(room: usize) {
    TIMES.set(Vec::with_capacity(room));
    LAST.set(None);
}

/// The frames of one cycle.
fn last_frames(bus: &mut BusLoop) -> Vec<Vec<u8>> {
    FRAMES.set(Some(Vec::new()));
    let begun = now_ns();
    while now_ns() - begun < 20_000_000 {
        assert!(bus.turn());
    }
    FRAMES.take().expect("they were kept")
}

// What is measured at the link: it lives on the thread that turns the loop.
thread_local! {
    /// Waiting for the next cycle takes no time.
    static FAST: Cell<bool> = const { Cell::new(false) };
    /// Of the cycles so far, in nanoseconds.
    static TIMES: RefCell<Vec<u64>> = const { RefCell::new(Vec::new()) };
    /// When the last cycle was sent, or the one under way was due.
    static LAST: Cell<Option<u64>> = const { Cell::new(None) };
    /// When the cycle was due, as the earliest ones show.
    static DUE: Cell<u64> = const { Cell::new(0) };
    static FRAMES: RefCell<Option<Vec<Vec<u8>>>> = const { RefCell::new(None) };
}

/// The raw socket with a clock that leaps over the time in which nothing is to be done, when cycles are to follow each other at once.
struct Watched {
    inner: RawSocket,
    skipped: Duration,
    /// Frames that are not back.
    away: usize,
    spin: bool,
}

impl Link for Watched {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        if let [_, _, _, _, _, _, _, PROCESS_DATA, _, _, _, place, ..] = *frame {
            if self.spin && !FAST.get() && place == 0 {
                let now = now_ns();
                let due = DUE.get() + PERIOD_NS;
                let slept_through = now > due + PERIOD_NS / 2;
                DUE.set(if slept_through { now } else { due.min(now) });
                LAST.set(Some(DUE.get()));
            }
            if FAST.get() && place == 0 {
                let now = now_ns();
                if let Some(before) = LAST.replace(Some(now)) {
                    TIMES.with_borrow_mut(|times| times.push(now - before));
                }
            }
            FRAMES.with_borrow_mut(|frames| {
                if let Some(frames) = frames {
                    frames.truncate(place.into());
                    frames.push(frame.to_vec());
                }
            });
        }
        self.away += 1;
        self.inner.send(frame)
    }

    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        let received = self.inner.receive(buffer);
        if matches!(received, Ok(Some(_))) {
            self.away = self.away.saturating_sub(1);
        }
        received
    }

    fn wait(&mut self, until: Duration) {
        let idle = self.away == 0;
        if idle && FAST.get() {
            self.skipped += until.saturating_sub(self.now());
            return;
        }
        let until = until.saturating_sub(self.skipped);
        if idle {
            // The cycle has ended, and the next is due then. The socket's clock is the one that is measured by.
            let now = now_ns();
            if let Some(due) = LAST.replace(Some(until.as_nanos() as u64))
                && due < now
            {
                TIMES.with_borrow_mut(|times| times.push(now - due));
            }
        }
        self.inner.wait(until);
    }

    fn pause(&mut self) {
        if self.away > 0 {
            return;
        }
        // The cycle has ended. Nobody says here when the next is due: a period after this one was.
        if FAST.get() {
            self.skipped += Duration::from_nanos(PERIOD_NS);
        } else if let Some(due) = LAST.take() {
            TIMES.with_borrow_mut(|times| times.push(now_ns() - due));
        }
    }

    fn now(&self) -> Duration {
        self.inner.now() + self.skipped
    }

    fn waker(&self) -> Waker {
        self.inner.waker()
    }
}
