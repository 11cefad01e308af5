//! A subscriber that blocks (a paused terminal, a full pipe, a slow disk) stops neither the cycles nor the handles, nor the
//! end of a network, and whoever is told of progress stops no more than what tells it: in real time, with the threads that a
//! program has.

use std::{
    future::Future,
    io,
    pin::pin,
    sync::{Arc, Condvar, Mutex, MutexGuard, mpsc},
    task::{Context, Poll, Waker},
    thread,
    time::Duration,
};

use servocrab::{
    AxisConfig, DriveConfig, Failure, Network, Outcome, Referencing, SetPoint, StopRequest,
    axis::AxisErrorKind,
    bus::{AlState as State, BringUpStep, BusLoop, NetworkBuilder, Recovered},
    drives,
    link::Wire,
};
use servocrab_sim::{AlState, Segment, personality};
use tracing::Level;
use tracing_subscriber::fmt::MakeWriter;

use crate::counting::{counted, uncounted};

const MS: Duration = Duration::from_millis(1);
/// Longer than anything here takes. Only a test that fails waits for it.
const LIMIT: Duration = Duration::from_secs(10);
/// Notes that wait for a subscriber (docs/architecture.md).
const ROOM: usize = 1024;

/// A subscriber's output that takes no line as long as it is shut. Whoever writes one waits, but for the bus thread, which must not
/// write any: its lines are kept, to be found.
#[derive(Clone, Default)]
struct Gate(Arc<(Mutex<Output>, Condvar)>);

#[derive(Default)]
struct Output {
    shut: bool,
    /// A thread waits to write a line.
    waited_for: bool,
    /// Whoever writes a line with this in it next panics.
    panics_at: Option<&'static str>,
    /// The network whose lines these are has ended.
    has_ended: bool,
    /// With the name of the thread that wrote it.
    lines: Vec<(String, String)>,
}

impl Gate {
    fn output(&self) -> MutexGuard<'_, Output> {
        self.0.0.lock().unwrap()
    }

    fn set_shut(&self, shut: bool) {
        self.output().shut = shut;
        self.0.1.notify_all();
    }

    fn until(&self, what: &str, is_there: impl Fn(&Output) -> bool) -> MutexGuard<'_, Output> {
        let condition = |output: &mut Output| !is_there(output);
        let (output, late) = self
            .0
            .1
            .wait_timeout_while(self.output(), LIMIT, condition)
            .unwrap();
        assert!(!late.timed_out(), "no {what}: {:#?}", output.lines);
        output
    }

    fn until_line(&self, parts: &[&str]) -> MutexGuard<'_, Output> {
        self.until(&format!("line with {parts:?}"), |output| {
            output.place(parts).is_some()
        })
    }
}

impl Output {
    /// Where the last line is that has all of these parts.
    fn place(&self, parts: &[&str]) -> Option<usize> {
        self.lines
            .iter()
            .rposition(|(_, line)| parts.iter().all(|part| line.contains(part)))
    }

    /// Nothing behind so many lines was written by the bus thread.
    fn assert_silent_bus(&self, before: usize) {
        let later = self.lines.iter().skip(before);
        let of_bus: Vec<_> = later
            .filter(|(thread, _)| thread == "servocrab-bus")
            .collect();
        assert!(of_bus.is_empty(), "{of_bus:#?}");
    }

    fn of_thread(&self, name: &str) -> Vec<&str> {
        let lines = self.lines.iter().filter(|(thread, _)| thread == name);
        lines.map(|(_, line)| line.as_str()).collect()
    }
}

impl io::Write for Gate {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let thread = thread::current().name().unwrap_or_default().to_owned();
        let mut output = self.output();
        while output.shut && thread != "servocrab-bus" {
            output.waited_for = true;
            self.0.1.notify_all();
            output = self.0.1.wait(output).unwrap();
        }
        let line = String::from_utf8(bytes.to_vec()).unwrap();
        if output.panics_at.is_some_and(|part| line.contains(part)) {
            output.panics_at = None;
            drop(output);
            panic!("a subscriber that cannot bear {line}");
        }
        output.lines.push((thread, line));
        self.0.1.notify_all();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl MakeWriter<'_> for Gate {
    type Writer = Self;

    fn make_writer(&self) -> Self {
        self.clone()
    }
}

/// An axis `x` in real time.
fn line() -> (Arc<Mutex<Segment>>, NetworkBuilder) {
    let segment = Arc::new(Mutex::new(Segment::new().with(personality::generic())));
    let shared = Arc::clone(&segment);
    let wire = Wire::new(move |frame: &mut [u8], now| {
        uncounted(|| shared.lock().unwrap().process(frame, now))
    });
    let drive = DriveConfig::new(drives::generic())
        .axis(AxisConfig::new("x").referencing(Referencing::UnreferencedMovesAllowed));
    let builder = Network::builder()
        .link(wire)
        .cycle(MS)
        .watchdog(Duration::from_secs(5))
        .drive(0, drive);
    (segment, builder)
}

/// Its network, started where the gate's subscriber is the default: nobody else's.
fn start(gate: &Gate) -> (Arc<Mutex<Segment>>, Network) {
    let (segment, builder) = line();
    let start = || within(builder.start());
    let net = tracing::subscriber::with_default(subscriber(gate), start).unwrap();
    (segment, net)
}

fn subscriber(gate: &Gate) -> impl tracing::Subscriber + Send + Sync {
    tracing_subscriber::fmt()
        .with_max_level(Level::DEBUG)
        .with_ansi(false)
        .with_writer(gate.clone())
        .finish()
}

fn turn_until<T>(bus: &mut BusLoop, future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
        assert!(bus.turn(), "the loop has ended");
    }
}

fn within<T>(future: impl Future<Output = T>) -> T {
    smol::block_on(smol::future::or(future, async {
        smol::Timer::after(LIMIT).await;
        panic!("not within {LIMIT:?}");
    }))
}

fn set_point() -> SetPoint {
    SetPoint::new()
        .velocity(1_000_000)
        .acceleration(10_000_000)
        .deceleration(10_000_000)
}

#[test]
fn a_subscriber_that_blocks_keeps_no_cycle_and_no_handle_waiting_and_what_is_missing_is_told() {
    let gate = Gate::default();
    let (segment, net) = start(&gate);
    drop(gate.until_line(&["in OP"]));
    gate.set_shut(true);
    let before = gate.output().lines.len();
    let axis = net.axis("x").unwrap();
    within(async {
        axis.enable().await.unwrap();
        let mode = axis.profile_position().await.unwrap();
        let far = mode.move_abs(100_000_000, set_point()).await.unwrap();
        segment
            .lock()
            .unwrap()
            .axis_mut(0, 0)
            .unwrap()
            .inject_fault(0x7320);
        let fault = far.done().await.unwrap_err();
        assert!(
            matches!(fault.kind, AxisErrorKind::Failed(Failure::Fault { .. })),
            "{fault}"
        );
        axis.reset_fault().await.unwrap();
        axis.enable().await.unwrap();
        let near = mode.move_abs(1_000, set_point()).await.unwrap();
        let outcome = near.done().await.unwrap();
        assert!(matches!(outcome, Outcome::Reached { .. }), "{outcome:?}");
    });
    gate.output().assert_silent_bus(before);
    drop(gate.until("blocked thread", |output| output.waited_for));
    // More than there is room for: a line in each cycle.
    for _ in 0..ROOM + 100 {
        let cycles = net.statistics().cycles;
        net.stop_all(StopRequest::HALT);
        within(async {
            while net.statistics().cycles < cycles + 2 {
                smol::future::yield_now().await;
            }
        });
    }
    assert_eq!(gate.output().lines.len(), before, "it blocks");
    gate.set_shut(false);
    let output = gate.until_line(&["WARN", "missed=", "found no room"]);
    let missed = output.place(&["missed="]).unwrap();
    assert_eq!(
        missed - before,
        1 + ROOM,
        "the line that was waited for, what had room, and then the number"
    );
    for event in [
        ["ERROR", "axis=\"x\"", "to=Fault", " at="],
        ["WARN", "emergency", "code=7320h", " at="],
        ["INFO", "axis=\"x\"", "to=OperationEnabled", " at="],
    ] {
        let place = output.place(&event);
        assert!(
            place.is_some_and(|place| (before..missed).contains(&place)),
            "{event:?} at {place:?}"
        );
    }
    drop(output);
    within(axis.disable()).unwrap();
    let output = gate.until_line(&["axis=\"x\"", "from=OperationEnabled", "state changed"]);
    assert!(output.place(&["state changed"]) > Some(missed));
    // Before its first cycle the bus thread writes its lines itself, and none after it.
    let of_bus = output.of_thread("servocrab-bus");
    let of_log = output.of_thread("servocrab-log");
    assert!(
        of_bus.iter().any(|line| line.contains("in SAFEOP")),
        "{of_bus:#?}"
    );
    assert!(
        of_log.iter().any(|line| line.contains("in OP")),
        "{of_bus:#?}"
    );
    output.assert_silent_bus(before);
    drop(output);
    within(net.shutdown()).unwrap();
}

#[test]
fn a_network_ends_in_order_though_its_subscriber_blocks_and_the_last_lines_come_when_it_goes_on() {
    let gate = Gate::default();
    let (segment, net) = start(&gate);
    within(net.axis("x").unwrap().enable()).unwrap();
    gate.set_shut(true);
    // On a thread of its own: one that does not end would wait for good.
    let program = gate.clone();
    thread::spawn(move || {
        smol::block_on(net.shutdown()).unwrap();
        program.output().has_ended = true;
        program.0.1.notify_all();
    });
    drop(gate.until("end of the network", |output| output.has_ended));
    let state = segment.lock().unwrap().devices()[0].al_state();
    assert_eq!(state, AlState::Init);
    let disabled = ["axis=\"x\"", "from=OperationEnabled", "state changed"];
    assert_eq!(gate.output().place(&disabled), None, "it blocks");
    gate.set_shut(false);
    drop(gate.until_line(&disabled));
}

#[test]
fn a_subscriber_that_panics_loses_its_line_and_stops_neither_cycles_nor_the_lines_behind_nor_the_end()
 {
    let gate = Gate::default();
    let (segment, net) = start(&gate);
    drop(gate.until_line(&["in OP"]));
    gate.output().panics_at = Some("all axes are stopped");
    let axis = net.axis("x").unwrap();
    within(axis.enable()).unwrap();
    net.stop_all(StopRequest::HALT);
    within(async {
        axis.disable().await.unwrap();
        axis.enable().await.unwrap();
        let mode = axis.profile_position().await.unwrap();
        let near = mode.move_rel(1_000, set_point()).await.unwrap();
        let outcome = near.done().await.unwrap();
        assert!(matches!(outcome, Outcome::Reached { .. }), "{outcome:?}");
        axis.disable().await.unwrap();
    });
    drop(gate.until_line(&["axis=\"x\"", "from=OperationEnabled", "state changed"]));
    assert_eq!(gate.output().panics_at, None, "it has");
    within(net.shutdown()).unwrap();
    let state = segment.lock().unwrap().devices()[0].al_state();
    assert_eq!(state, AlState::Init);
}

#[test]
fn what_happens_in_cycles_is_neither_formatted_nor_allocated_by_the_loop_that_runs_them() {
    const STOPS: usize = 200;
    let gate = Gate::default();
    let (_segment, builder) = line();
    // In the place of the bus thread, whose lines are kept by their writer.
    let default = tracing::subscriber::set_default(subscriber(&gate));
    let (starting, mut bus) = builder.split().unwrap();
    let net = turn_until(&mut bus, starting.network()).unwrap();
    turn_until(&mut bus, net.axis("x").unwrap().enable()).unwrap();
    let stop = |bus: &mut BusLoop| {
        let end = net.statistics().cycles + 2;
        net.stop_all(StopRequest::HALT);
        counted(|| {
            while net.statistics().cycles < end {
                assert!(bus.turn());
            }
        });
    };
    // Buffers reach their size.
    (0..STOPS).for_each(|_| stop(&mut bus));
    crate::counting::begin();
    (0..STOPS).for_each(|_| stop(&mut bus));
    assert_eq!(crate::counting::so_far(), 0, "allocations and frees");
    let own = thread::current().name().unwrap_or_default().to_owned();
    drop(default);
    drop(net);
    bus.run();
    let output = gate.output();
    let stops = |name: &str| {
        let lines = output.of_thread(name).into_iter();
        lines
            .filter(|line| line.contains("all axes are stopped"))
            .count()
    };
    assert_eq!((stops("servocrab-log"), stops(&own)), (2 * STOPS, 0));
}

/// Awaits it on a thread of the program's own.
fn on_a_thread<T: Send + 'static>(
    future: impl Future<Output = T> + Send + 'static,
) -> thread::JoinHandle<T> {
    let thread = thread::Builder::new().name("program".into());
    thread.spawn(move || within(future)).unwrap()
}

#[test]
fn whoever_is_told_of_progress_and_blocks_keeps_neither_the_bring_up_nor_the_cycles_waiting() {
    // A step is told when it is taken here.
    let (tell, told) = mpsc::sync_channel(0);
    let (segment, builder) = line();
    let builder = builder.on_progress(move |at| {
        let thread = thread::current().name().unwrap_or_default().to_owned();
        // Nobody takes it when the test has failed.
        let _ = tell.send((thread, at.step, at.done, at.total));
    });
    let in_op = async || {
        while segment.lock().unwrap().devices()[0].al_state() != AlState::Op {
            smol::future::yield_now().await;
        }
    };
    let take = |steps: &[BringUpStep]| {
        for (step, done) in steps.iter().zip(1..) {
            let expected = ("program".to_owned(), *step, done, steps.len());
            assert_eq!(told.recv_timeout(LIMIT).unwrap(), expected);
        }
    };

    let starting = on_a_thread(builder.start());
    within(in_op());
    take(&[
        BringUpStep::Identity,
        BringUpStep::StartUpList,
        BringUpStep::Mapping,
        BringUpStep::Watchdog,
        BringUpStep::State(State::SafeOp),
        BringUpStep::Parameters,
        BringUpStep::State(State::Op),
    ]);
    let net = Arc::new(starting.join().unwrap().unwrap());

    let mut shared = segment.lock().unwrap();
    shared.device_mut(0).unwrap().fall_to_safe_op(0x001B);
    drop(shared);
    let falling = Arc::clone(&net);
    let recovering = on_a_thread(async move { falling.recover(0).await });
    within(in_op());
    let end = net.statistics().cycles + 100;
    within(async {
        while net.statistics().cycles < end {
            smol::future::yield_now().await;
        }
    });
    take(&[
        BringUpStep::State(State::SafeOp),
        BringUpStep::Parameters,
        BringUpStep::State(State::Op),
    ]);
    let recovered = recovering.join().unwrap().unwrap();
    assert!(
        matches!(recovered, Recovered::FromSafeOp { .. }),
        "{recovered}"
    );
}
