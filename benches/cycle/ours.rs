//! This library: the bus loop with its axis cores, as a program runs it.

use std::{
    cell::{Cell, RefCell},
    future::{Future, poll_fn},
    io,
    path::Path,
    pin::pin,
    sync::{
        Mutex,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll, Waker},
    thread,
    time::Duration,
};

use servocrab::{
    Axis, DriveConfig, Network,
    bus::{BusLoop, WaitStrategy},
    coe::obj,
    drives,
    link::{Link, RawSocket, RawSocketError},
};

use crate::{
    floor::write_frames,
    measure::{Measured, Mode, PERIOD_NS, cpu_ns, now_ns, serve},
};

/// Where a frame's first datagram has its index: the frame's place in the cycle, or this.
const PLACE: usize = 17;
const ACYCLIC: u8 = 0xFF;

/// Brings the line up, enables every axis, and runs cycles as it is commanded.
pub(crate) fn servocrab(interface: &str, axes: usize, spin: bool, frames: &Path) {
    let mut line = Line::bring_up(interface, axes, spin);
    write_frames(frames, &last_frames(&mut line.bus));
    serve(|mode, count| line.measure(mode, count));
}

/// The same asleep, while many tasks of the program wait for every cycle.
pub(crate) fn awaited(interface: &str, axes: usize) {
    let mut line = Line::bring_up(interface, axes, false);
    let woken: &'static Woken = Box::leak(Box::default());
    let clock = line._network.clock();
    thread::spawn(move || {
        let executor = smol::LocalExecutor::new();
        for _ in 0..TASKS {
            let clock = clock.clone();
            let task = executor.spawn(async move {
                while clock.next_cycle().await.is_ok() {
                    woken.note();
                }
            });
            task.detach();
        }
        smol::block_on(executor.run(std::future::pending::<()>()));
    });
    serve(|mode, count| {
        woken.times.lock().expect("nobody panics").clear();
        let measured = line.measure(mode, count);
        let times = woken.times.lock().expect("nobody panics");
        match mode {
            Mode::Woken => Measured::new(
                times.clone(),
                (measured.cpu * 1e3) as u64 * times.len() as u64,
            ),
            _ => measured,
        }
    });
}

/// Tasks that wait.
const TASKS: u64 = 64;
/// When the last frame of the last cycle was received.
static RECEIVED: AtomicU64 = AtomicU64::new(0);

/// When the tasks have run.
#[derive(Default)]
struct Woken {
    count: AtomicU64,
    times: Mutex<Vec<u64>>,
}

impl Woken {
    fn note(&self) {
        // Where a cycle found them running still, the last one of two cycles counts.
        if (self.count.fetch_add(1, Ordering::Relaxed) + 1).is_multiple_of(TASKS) {
            let took = now_ns().saturating_sub(RECEIVED.load(Ordering::Relaxed));
            self.times.lock().expect("nobody panics").push(took);
        }
    }
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
        let socket = RawSocket::open(interface).expect("the interface is there");
        // A machine that is busy with other things loses no drive.
        let mut builder = Network::builder()
            .link(Watched::new(socket, spin))
            .watchdog(Duration::from_secs(6))
            .cycle(Duration::from_nanos(PERIOD_NS))
            .wait_strategy(if spin {
                WaitStrategy::Spin
            } else {
                WaitStrategy::Block
            });
        for drive in 0..axes.div_ceil(2) {
            builder = builder.drive(drive as u16, drive_of(drive, axes - 2 * drive));
        }
        let (starting, mut bus) = builder.split().expect("the line is declared well");
        let network = run(&mut bus, starting.network()).expect("the line comes up");
        let handles: Vec<_> = (0..axes)
            .map(|axis| network.axis(&axis.to_string()).expect("it is declared"))
            .collect();
        enable(&mut bus, &handles);
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
        config = config.axis((2 * drive + axis).to_string());
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

/// All at the same time.
fn enable(bus: &mut BusLoop, axes: &[Axis]) {
    let enabling = axes.iter().map(|axis| Box::pin(axis.enable()));
    let mut enabling: Vec<_> = enabling.collect();
    let all = poll_fn(|context| {
        enabling.retain_mut(|axis| match axis.as_mut().poll(context) {
            Poll::Ready(enabled) => {
                enabled.expect("the axis is enabled");
                false
            }
            Poll::Pending => true,
        });
        if enabling.is_empty() {
            Poll::Ready(())
        } else {
            Poll::Pending
        }
    });
    run(bus, all);
}

fn measure(bus: &mut BusLoop, mode: Mode, count: usize) -> Measured {
    FAST.set(!matches!(mode, Mode::Paced | Mode::Woken));
    PATIENT.set(mode == Mode::Simulated);
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

// What is measured at the link: it stays on the thread that turns the loop.
thread_local! {
    /// Waiting for the next cycle takes no time.
    static FAST: Cell<bool> = const { Cell::new(false) };
    /// Waiting for frames takes no time: the line is brought up, or simulated.
    static PATIENT: Cell<bool> = const { Cell::new(true) };
    /// Of the cycles so far, in nanoseconds.
    static TIMES: RefCell<Vec<u64>> = const { RefCell::new(Vec::new()) };
    /// When the last cycle was sent, or the one under way was due.
    static LAST: Cell<Option<u64>> = const { Cell::new(None) };
    /// When the cycle was due, as the earliest ones show.
    static DUE: Cell<u64> = const { Cell::new(0) };
    static FRAMES: RefCell<Option<Vec<Vec<u8>>>> = const { RefCell::new(None) };
}

/// A frame that is away for longer is lost.
const PATIENCE: Duration = Duration::from_secs(1);

/// The raw socket with a clock of its own. It leaps over the time in which nothing is to be done, when cycles are to follow each other
/// at once; and it stands still while a simulated segment has frames, however long that takes on a slow machine.
struct Watched {
    inner: RawSocket,
    /// By how much its clock is ahead of the socket's.
    ahead: Duration,
    /// What its clock showed last.
    shown: Cell<Duration>,
    /// Since when it stands still, by the socket's clock.
    stands: Option<Duration>,
    /// Frames that are not back.
    away: usize,
    spin: bool,
}

impl Watched {
    fn new(inner: RawSocket, spin: bool) -> Self {
        Self {
            inner,
            // So that it can fall back too.
            ahead: Duration::from_secs(3600),
            shown: Cell::default(),
            stands: None,
            away: 0,
            spin,
        }
    }

    fn goes_on(&mut self) {
        if let Some(since) = self.stands.take() {
            let stood = self.inner.now() - since;
            self.ahead = self.ahead.saturating_sub(stood);
        }
    }

    /// Gives frames up that do not come back.
    fn look_for_lost_frames(&mut self) {
        if self
            .stands
            .is_some_and(|since| self.inner.now() > since + PATIENCE)
        {
            self.away = 0;
            self.goes_on();
        }
    }
}

impl Link for Watched {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        if let Some(&place) = frame.get(PLACE)
            && place != ACYCLIC
        {
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
        if PATIENT.get() && self.stands.is_none() {
            self.stands = Some(self.inner.now());
        }
        let sent = self.inner.send(frame);
        match sent {
            Ok(()) => self.away += 1,
            Err(_) if self.away == 0 => self.goes_on(),
            Err(_) => {}
        }
        sent
    }

    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        let received = self.inner.receive(buffer);
        if matches!(received, Ok(Some(_))) {
            self.away = self.away.saturating_sub(1);
            if self.away == 0 {
                RECEIVED.store(now_ns(), Ordering::Relaxed);
                self.goes_on();
            }
        }
        received
    }

    fn wait(&mut self, until: Duration) {
        if let Some(since) = self.stands {
            self.inner.wait(since + PATIENCE);
            return self.look_for_lost_frames();
        }
        let idle = self.away == 0;
        if idle && FAST.get() {
            self.ahead += until.saturating_sub(self.shown.get());
            return;
        }
        let until = until.saturating_sub(self.ahead);
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
            return self.look_for_lost_frames();
        }
        // The cycle has ended. Nobody says here when the next is due: a period after this one was.
        if FAST.get() {
            self.ahead += Duration::from_nanos(PERIOD_NS);
        } else if let Some(due) = LAST.take() {
            TIMES.with_borrow_mut(|times| times.push(now_ns() - due));
        }
    }

    fn now(&self) -> Duration {
        let now = self.stands.unwrap_or_else(|| self.inner.now()) + self.ahead;
        self.shown.set(now);
        now
    }

    fn waker(&self) -> Waker {
        self.inner.waker()
    }

    fn prepare(&mut self) -> Result<(), RawSocketError> {
        self.inner.prepare()
    }
}
