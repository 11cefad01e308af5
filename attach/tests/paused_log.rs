//! A subscriber of the log that blocks: a paused terminal, a full pipe. It is the one of the whole process, and so has a file of its own.
#![allow(missing_docs)]

use std::{
    fmt::Debug,
    io::{Read, Write},
    os::unix::net::UnixStream,
    sync::{Arc, Condvar, Mutex, MutexGuard, Once, PoisonError, mpsc},
    thread,
    time::{Duration, Instant},
};

use servocrab::{AxisConfig, DriveConfig, Network, Referencing, SetPoint, drives, link::Wire};
use servocrab_attach::{Attach, Attached, Grant, serve};
use servocrab_sim::{Segment, personality};
use tempfile::TempDir;
use tracing::{
    Event, Metadata, Subscriber,
    field::{Field, Visit},
    span,
};

const TIME: Duration = Duration::from_secs(10);

/// What the terminal shows, and whether it is paused.
struct Shown {
    lines: Vec<String>,
    is_paused: bool,
}

static SHOWN: Mutex<Shown> = Mutex::new(Shown {
    lines: Vec::new(),
    is_paused: false,
});
static CHANGED: Condvar = Condvar::new();

fn shown() -> MutexGuard<'static, Shown> {
    SHOWN.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Terminal;

impl Subscriber for Terminal {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.target().starts_with("servocrab") && metadata.is_event()
    }

    fn new_span(&self, _: &span::Attributes<'_>) -> span::Id {
        span::Id::from_u64(1)
    }

    fn record(&self, _: &span::Id, _: &span::Record<'_>) {}

    fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}

    fn event(&self, event: &Event<'_>) {
        let mut line = Text(format!("{}:", event.metadata().target()));
        event.record(&mut line);
        let shown = CHANGED.wait_while(shown(), |shown| shown.is_paused);
        shown
            .unwrap_or_else(PoisonError::into_inner)
            .lines
            .push(line.0);
        CHANGED.notify_all();
    }

    fn enter(&self, _: &span::Id) {}

    fn exit(&self, _: &span::Id) {}
}

struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            self.0 = format!("{} {value:?}", self.0);
        }
    }
}

/// The terminal takes nothing until this is dropped.
struct Pause;

impl Pause {
    fn begin() -> Self {
        shown().is_paused = true;
        Self
    }
}

impl Drop for Pause {
    fn drop(&mut self) {
        shown().is_paused = false;
        CHANGED.notify_all();
    }
}

/// The turn of one test: they share the terminal.
fn turn() -> MutexGuard<'static, ()> {
    static ONCE: Once = Once::new();
    static TURN: Mutex<()> = Mutex::new(());
    ONCE.call_once(|| tracing::subscriber::set_global_default(Terminal).unwrap());
    let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    shown().lines.clear();
    turn
}

/// Two axes, of which clients may move `y`.
fn machine() -> (Network, TempDir, Attached) {
    let segment = Arc::new(Mutex::new(Segment::new().with(personality::akd2g())));
    let wire = Wire::new(move |frame, now| segment.lock().unwrap().process(frame, now));
    let axis = |name: &str| AxisConfig::new(name).referencing(Referencing::AbsoluteEncoder);
    let drive = DriveConfig::new(drives::akd2g())
        .axis(axis("x"))
        .axis(axis("y"));
    let builder = Network::builder()
        .link(wire)
        .cycle(Duration::from_millis(2))
        .watchdog(Duration::from_secs(5))
        .drive(0, drive);
    let net = smol::block_on(builder.start()).unwrap();
    let runtime = tempfile::tempdir().unwrap();
    let attach = Attach::new("sim0").directory(runtime.path().join("servocrab"));
    let motion = Grant::Motion {
        axes: vec!["y".into()],
    };
    let attached = serve(&net, attach.grant(motion)).unwrap();
    (net, runtime, attached)
}

/// The answer, or as much of it as comes in time.
fn post(attached: &Attached, request: &str) -> String {
    let mut stream = UnixStream::connect(attached.socket()).unwrap();
    stream.set_read_timeout(Some(TIME)).unwrap();
    write!(
        stream,
        "POST {request} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
    )
    .unwrap();
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer);
    answer
}

#[test]
fn a_log_that_blocks_holds_no_request_up_and_has_every_line_afterwards() {
    let _turn = turn();
    let (net, _runtime, attached) = machine();
    let x = net.axis("x").unwrap();
    smol::block_on(x.enable()).unwrap();
    let mode = smol::block_on(x.profile_position()).unwrap();
    let set_point = SetPoint::new().velocity(10_000);
    let _motion = smol::block_on(mode.move_rel(10_000_000, set_point)).unwrap();
    let pause = Pause::begin();
    // What is logged for one client, by the server and by the library, keeps no stop of another from the axis.
    let enabled = post(&attached, "/v1/axes/y/enable");
    assert!(enabled.starts_with("HTTP/1.1 200 "), "{enabled:?}");
    let stopped = post(&attached, "/v1/axes/x/stop");
    assert!(stopped.starts_with("HTTP/1.1 202 "), "{stopped:?}");
    let begun = Instant::now();
    while x.status().has_set_point && begun.elapsed() < TIME {
        thread::yield_now();
    }
    assert!(!x.status().has_set_point, "{:?}", x.status());
    drop(pause);

    let own = format!("process {}", std::process::id());
    let expected = [
        "enable y: by user ",
        "enable y: enabled",
        "axis x is stopped by user ",
    ];
    let has = |shown: &Shown, part: &str| {
        let mut lines = shown.lines.iter();
        lines.any(|line| line.starts_with("servocrab::attach: ") && line.contains(part))
    };
    let has_all = |shown: &Shown| expected.iter().all(|part| has(shown, part)) && has(shown, &own);
    let (shown, _) = CHANGED
        .wait_timeout_while(shown(), TIME, |shown| !has_all(shown))
        .unwrap();
    assert!(has_all(&shown), "{:#?}", shown.lines);
    drop(shown);
    drop(attached);
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn a_log_that_blocks_does_not_keep_the_end_of_the_server_from_the_program() {
    let _turn = turn();
    let (net, _runtime, attached) = machine();
    let pause = Pause::begin();
    let enabled = post(&attached, "/v1/axes/y/enable");
    assert!(enabled.starts_with("HTTP/1.1 200 "), "{enabled:?}");
    let (ends, ended) = mpsc::channel();
    let ending = thread::spawn(move || {
        drop(attached);
        let _ = ends.send(());
    });
    let has_ended = ended.recv_timeout(TIME);
    drop(pause);
    ending.join().unwrap();
    assert!(has_ended.is_ok(), "it has waited for the log");
    smol::block_on(net.shutdown()).unwrap();
}
