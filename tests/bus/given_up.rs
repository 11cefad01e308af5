//! Starts and scans that are dropped after each poll, or kept and not polled: nothing stays behind, and the next one works.

use std::{
    future::Future,
    io,
    pin::Pin,
    sync::{Arc, Condvar, Mutex, MutexGuard},
    task::{Context, Poll, Wake, Waker},
    thread,
    time::{Duration, Instant},
};

use servocrab::{
    bus::{BusLoop, DistributedClock, Expected, IoConfig, Network, NetworkBuilder},
    drives,
    link::{Link, Wire},
    profile_position::Outcome,
};
use servocrab_sim::{AlState, Device, Segment, ds402::State, personality};

use crate::rig::{Line, Rig, unhomed};

/// No way down takes longer: four states of a second each.
const END: Duration = Duration::from_secs(4);

/// A drive, and eight outputs.
fn line() -> Line {
    Line::new(
        Segment::new()
            .with(personality::generic())
            .with(personality::digital_outputs()),
    )
}

fn builder() -> NetworkBuilder {
    let drive = unhomed(drives::generic(), &["x"]);
    let valves = IoConfig::new("valves", Expected::new(0, 0x444F_3038));
    Network::builder().drive(0, drive).io(1, valves)
}

fn with_clock() -> NetworkBuilder {
    let drive = unhomed(drives::generic(), &["x"]).dc(DistributedClock::new(0x0300));
    let valves = IoConfig::new("valves", Expected::new(0, 0x444F_3038));
    Network::builder().drive(0, drive).io(1, valves)
}

fn poll<F: Future + ?Sized>(future: &mut Pin<Box<F>>) -> Poll<F::Output> {
    let mut context = Context::from_waker(Waker::noop());
    future.as_mut().poll(&mut context)
}

/// All devices are in INIT, and no axis has power or was asked for anything.
fn is_left(line: &Line, what: &str) {
    let segment = line.segment();
    for device in segment.devices() {
        assert_eq!(device.al_state(), AlState::Init, "{what}");
        for axis in device.axes() {
            assert_ne!(axis.state(), State::OperationEnabled, "{what}");
            assert!(axis.ledger().is_empty(), "{what}");
        }
    }
}

/// The line is brought up and moves, with a time that goes on from `begin`.
fn works(line: &Line, builder: fn() -> NetworkBuilder, begin: Duration, what: &str) {
    let mut rig = Rig::start(builder().link(line.wire_from(begin)))
        .unwrap_or_else(|error| panic!("{what}: {error}"));
    let target = rig.net().axis("x").unwrap().status().position + 500;
    let outcome = rig.moved("x", target);
    assert!(
        matches!(outcome, Outcome::Reached { position } if (position - target).abs() < 20),
        "{what}: {outcome:?}"
    );
    let executed = line.segment().axis(0, 0).unwrap().ledger().len();
    assert_eq!(executed, 1, "{what}");
    rig.shutdown();
}

fn turn_to_the_end(bus: &mut BusLoop, what: &str) {
    let limit = bus.now() + END;
    while bus.turn() {
        assert!(bus.now() < limit, "{what}: the loop goes on");
    }
}

/// Polls `network` so many times, with a turn after each; whether it was ready by then.
fn polled<T>(
    bus: &mut BusLoop,
    network: &mut Pin<Box<impl Future<Output = T>>>,
    polls: usize,
) -> Option<T> {
    for _ in 0..polls {
        if let Poll::Ready(ready) = poll(network) {
            return Some(ready);
        }
        assert!(bus.turn());
    }
    None
}

/// Drops a start after each `step`-th number of polls, for all numbers until it is ready; how many that takes.
fn drop_starts(builder: fn() -> NetworkBuilder, step: usize) -> usize {
    let mut polls = 0;
    loop {
        let line = line();
        let (starting, mut bus) = builder().link(line.wire()).split().unwrap();
        let mut network = Box::pin(starting.network());
        let started = polled(&mut bus, &mut network, polls);
        let what = format!("after {polls} polls");
        let ready = started.is_some();
        drop((network, started));
        turn_to_the_end(&mut bus, &what);
        is_left(&line, &what);
        let begin = bus.now();
        drop(bus);
        assert_eq!(Arc::strong_count(&line.0), 1, "{what}: the link is free");
        if ready || (polls / step).is_multiple_of(4) {
            works(&line, builder, begin, &what);
        }
        if ready {
            return polls;
        }
        polls += step;
    }
}

#[test]
fn a_start_is_dropped_after_every_poll_and_nothing_stays_behind() {
    let polls = drop_starts(builder, 1);
    assert!(polls > 100, "{polls}");
}

#[test]
fn a_start_is_dropped_while_the_clocks_are_set_and_nothing_stays_behind() {
    // Most of it is the time in which the clocks settle.
    let polls = drop_starts(with_clock, 499);
    assert!(polls > 5_000, "{polls}");
}

#[test]
fn a_start_is_kept_after_every_poll_and_its_drives_wait_without_power() {
    let mut polls = 0;
    loop {
        let line = line();
        let (starting, mut bus) = builder().link(line.wire()).split().unwrap();
        let mut network = Box::pin(starting.network());
        let what = format!("after {polls} polls");
        if polled(&mut bus, &mut network, polls).is_some() {
            break;
        }
        let until = bus.now() + END;
        while bus.now() < until {
            assert!(bus.turn(), "{what}");
        }
        for device in line.segment().devices() {
            assert_eq!(device.al_state(), AlState::Op, "{what}");
        }
        assert_ne!(axis_state(&line), State::OperationEnabled, "{what}");
        if polls % 2 == 0 {
            // Whoever takes it up again finds it ready.
            let Poll::Ready(Ok(net)) = poll(&mut network) else {
                panic!("{what}: it is not ready");
            };
            let net = Some(net);
            let mut rig = Rig { net, bus };
            assert!(
                matches!(rig.moved("x", 500), Outcome::Reached { .. }),
                "{what}"
            );
            rig.shutdown();
        } else {
            drop(network);
            turn_to_the_end(&mut bus, &what);
            is_left(&line, &what);
        }
        polls += 5;
    }
    assert!(polls > 100, "{polls}");
}

fn axis_state(line: &Line) -> State {
    line.segment().axis(0, 0).unwrap().state()
}

/// Stops a link before its frame of this number until somebody wakes it: a network that is dropped does.
struct Gate {
    before: usize,
    seen: Mutex<Seen>,
    changed: Condvar,
}

#[derive(Default)]
struct Seen {
    sent: usize,
    /// The frame is about to be sent.
    reached: bool,
    opened: bool,
    /// The program is to poll.
    woken: bool,
    /// It has what it wanted, and no frame is stopped any more.
    done: bool,
}

impl Gate {
    fn before(number: usize) -> Arc<Self> {
        Arc::new(Self {
            before: number,
            seen: Mutex::default(),
            changed: Condvar::new(),
        })
    }

    fn change(&self, change: impl FnOnce(&mut Seen)) {
        change(&mut self.seen.lock().unwrap());
        self.changed.notify_all();
    }

    /// Polls until the frame is about to be sent; what it gives, if that comes first.
    fn poll_until_reached<F: Future + ?Sized>(
        self: &Arc<Self>,
        future: &mut Pin<Box<F>>,
    ) -> Option<F::Output> {
        let waker = Waker::from(Arc::new(Woken(Arc::clone(self))));
        loop {
            self.change(|seen| seen.woken = false);
            if let Poll::Ready(value) = future.as_mut().poll(&mut Context::from_waker(&waker)) {
                self.change(|seen| seen.done = true);
                return Some(value);
            }
            if self.wait_until(|seen| seen.woken || seen.reached).reached {
                return None;
            }
        }
    }

    fn wait_until(&self, is_so: impl Fn(&Seen) -> bool) -> MutexGuard<'_, Seen> {
        let waits = |seen: &mut Seen| !is_so(seen);
        self.changed
            .wait_while(self.seen.lock().unwrap(), waits)
            .unwrap()
    }
}

impl Wake for Gate {
    fn wake(self: Arc<Self>) {
        self.change(|seen| seen.opened = true);
    }
}

struct Woken(Arc<Gate>);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.change(|seen| seen.woken = true);
    }
}

struct Gated {
    wire: Wire,
    gate: Arc<Gate>,
}

impl Link for Gated {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        let mut seen = self.gate.seen.lock().unwrap();
        if seen.sent == self.gate.before {
            (seen.reached, seen.opened) = (true, false);
            self.gate.changed.notify_all();
            let shut = |seen: &mut Seen| !seen.opened && !seen.done;
            seen = self.gate.changed.wait_while(seen, shut).unwrap();
        }
        seen.sent += 1;
        drop(seen);
        self.wire.send(frame)
    }

    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        self.wire.receive(buffer)
    }

    fn wait(&mut self, until: Duration) {
        self.wire.wait(until);
    }

    fn now(&self) -> Duration {
        self.wire.now()
    }

    fn is_virtual(&self) -> bool {
        true
    }

    fn waker(&self) -> Waker {
        Waker::from(Arc::clone(&self.gate))
    }
}

/// Drops what `begin` gives before each frame that it sends, until it is ready before that; how many frames it takes.
fn drop_before_each_frame<T>(
    begin: impl Fn(Gated) -> Pin<Box<dyn Future<Output = T>>>,
    is_well: impl Fn(&T),
) -> usize {
    let mut before = 0;
    loop {
        let line = line();
        let gate = Gate::before(before);
        let gated = Gated {
            wire: line.wire(),
            gate: Arc::clone(&gate),
        };
        let mut future = begin(gated);
        let what = format!("before frame {before}");
        let ready = gate.poll_until_reached(&mut future);
        // A network that nobody has taken over yet goes on with its cycles.
        let in_op = |device: &Device| device.al_state() == AlState::Op;
        let is_ready = ready.is_some() || line.segment().devices().iter().all(in_op);
        if let Some(value) = &ready {
            is_well(value);
        }
        drop((future, ready));
        // Dropping it has waited for its thread.
        assert_eq!(Arc::strong_count(&line.0), 1, "{what}: the link is free");
        // The thread that wakes may still hold the waker that it has just called.
        let limit = Instant::now() + Duration::from_secs(60);
        while Arc::strong_count(&gate) > 1 {
            assert!(Instant::now() < limit, "{what}: a waker stays behind");
            thread::yield_now();
        }
        is_left(&line, &what);
        let sent = gate.seen.lock().unwrap().sent;
        let begin = Duration::from_secs(60);
        if before % 10 == 0 || is_ready {
            works(&line, builder, begin, &what);
        }
        if is_ready {
            return before;
        }
        assert!(sent >= before, "{what}");
        before += 1;
    }
}

#[test]
fn a_scan_is_dropped_before_every_frame_and_nothing_stays_behind() {
    let frames = drop_before_each_frame(
        |link| Box::pin(Network::builder().link(link).scan()),
        |scanned| assert_eq!(scanned.as_ref().unwrap().devices().len(), 2),
    );
    assert!(frames > 30, "{frames}");
}

#[test]
fn a_scan_that_is_kept_waits_with_its_line_and_is_ready_when_it_is_polled_again() {
    for is_taken_up in [true, false] {
        let line = line();
        // Nothing is sent before the scan was polled once: until then it cannot be over.
        let gate = Gate::before(0);
        let gated = Gated {
            wire: line.wire(),
            gate: Arc::clone(&gate),
        };
        let mut scan = Box::pin(Network::builder().link(gated).scan());
        let waker = Waker::from(Arc::new(Woken(Arc::clone(&gate))));
        let mut context = Context::from_waker(&waker);
        assert!(scan.as_mut().poll(&mut context).is_pending());
        drop(gate.wait_until(|seen| seen.reached));
        gate.change(|seen| seen.opened = true);
        drop(gate.wait_until(|seen| seen.woken));
        for device in line.segment().devices() {
            assert_eq!(device.al_state(), AlState::PreOp);
        }
        let polled = is_taken_up.then(|| poll(&mut scan));
        let scanned = polled.map(|polled| match polled {
            Poll::Ready(scanned) => scanned.unwrap(),
            Poll::Pending => panic!("it is not ready"),
        });
        drop((scan, scanned));
        assert_eq!(Arc::strong_count(&line.0), 1, "the link is free");
        is_left(&line, "kept");
    }
}

#[test]
fn a_start_on_its_own_thread_is_dropped_before_every_frame_and_nothing_stays_behind() {
    let frames = drop_before_each_frame(
        |link| Box::pin(builder().link(link).start()),
        |started| drop(started.as_ref().unwrap().axis("x").unwrap()),
    );
    assert!(frames > 50, "{frames}");
}
