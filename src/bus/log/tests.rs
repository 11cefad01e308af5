use std::{
    cell::RefCell,
    fmt::{Debug, Write},
    sync::Once,
};

use tracing::{
    Event, Level, Metadata, Subscriber,
    field::{Field, Visit},
    span,
};

use super::*;
use crate::{
    axis::{AxisIdentity, StopRequest},
    bus::{AlError, AlState, AlStatus, BringUpStep, ClockEvent},
    coe::{DriveId, MailNote},
    ds402::{Controlword, State, Statusword},
    sii::Identity,
    wakes::WakeStatistics,
};

thread_local! {
    static SEEN: RefCell<Vec<(Level, String)>> = const { RefCell::new(Vec::new()) };
}

/// Keeps the events of each thread for itself. One for all tests, since `tracing` remembers who listens for all threads.
struct Seen;

impl Subscriber for Seen {
    fn enabled(&self, _: &Metadata<'_>) -> bool {
        true
    }

    fn new_span(&self, _: &span::Attributes<'_>) -> span::Id {
        span::Id::from_u64(1)
    }

    fn record(&self, _: &span::Id, _: &span::Record<'_>) {}

    fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}

    fn event(&self, event: &Event<'_>) {
        let mut line = Line(String::new());
        event.record(&mut line);
        SEEN.with_borrow_mut(|seen| seen.push((*event.metadata().level(), line.0)));
    }

    fn enter(&self, _: &span::Id) {}

    fn exit(&self, _: &span::Id) {}
}

struct Line(String);

impl Visit for Line {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        write!(self.0, "{}={value:?} ", field.name()).unwrap();
    }
}

/// What this thread has written since this was asked for last.
fn seen() -> Vec<(Level, String)> {
    static SUBSCRIBED: Once = Once::new();
    SUBSCRIBED.call_once(|| tracing::subscriber::set_global_default(Seen).unwrap());
    SEEN.take()
}

fn drive() -> Arc<DriveId> {
    Arc::new(DriveId {
        position: 2,
        name: "AKD2G".into(),
        identity: Identity::default(),
    })
}

fn axis(change: AxisChange) -> Note {
    let drive = DriveId::clone(&drive());
    Note::Axis(AxisNote {
        axis: Arc::new(AxisIdentity {
            axis: "z".into(),
            drive,
        }),
        change,
        from: Some(State::OperationEnabled),
        to: State::Fault,
        statusword: Statusword::from_bits_retain(0x0218),
        controlword: Controlword::from_bits_retain(0x000F),
        position: -7,
    })
}

fn queued(room: usize) -> (Log, Arc<Queue>) {
    let queue = Arc::new(Queue::new(room));
    let log = Log(Some(Arc::clone(&queue)));
    log.begin_cycles();
    (log, queue)
}

fn in_step(error: i64) -> Note {
    Note::InStep {
        phase_error_ns: error,
    }
}

const AT: Duration = Duration::from_millis(1500);

#[test]
fn the_level_of_a_note_is_that_of_its_event_and_each_says_when_it_happened() {
    let status = AlStatus {
        state: AlState::SafeOp,
        error: Some(0x1B),
    };
    let mut notes: Vec<Note> = [
        AxisChange::Lost,
        AxisChange::Back,
        AxisChange::Fault,
        AxisChange::State,
        AxisChange::Halted,
        AxisChange::Resumed,
    ]
    .map(axis)
    .into();
    let changes = [
        DriveChange::Lost,
        DriveChange::Back,
        DriveChange::LeftOp(status),
        DriveChange::InOp,
    ];
    notes.extend(changes.map(|change| Note::Drive(drive(), change)));
    notes.extend(MailNote::of_each_kind(&drive()).map(Note::Mail));
    notes.extend([
        Note::BroughtUp(drive()),
        Note::StopOfAll(StopRequest::HALT),
        Note::Unfed,
        in_step(-5),
        Note::Clock(drive(), ClockEvent::OutOfStep { phase_error_ns: 5 }),
        Note::Clock(drive(), ClockEvent::InStep),
        Note::Clock(drive(), ClockEvent::Silent),
        Note::Clock(drive(), ClockEvent::Jumped { by_ns: 5 }),
        Note::Step {
            drive: drive(),
            step: BringUpStep::Mapping,
            done: 3,
            total: 14,
        },
        Note::NotStopped,
        Note::Wakers(WakeStatistics::default()),
        Note::NotOnTheWayDown {
            drive: drive(),
            state: AlState::SafeOp,
            error: AlError::Refused(status),
        },
    ]);
    seen();
    for note in notes {
        let (level, text) = (note.level(), format!("{note:?}"));
        note.write(AT);
        let events = seen();
        let [(of_event, line)] = &events[..] else {
            panic!("{text}: {events:?}");
        };
        assert_eq!(level, *of_event, "{text}: {line}");
        assert!(line.contains("at=1.5s "), "{text}: {line}");
    }
}

#[test]
fn a_fault_is_an_event_with_its_axis_its_drive_and_its_words() {
    seen();
    axis(AxisChange::Fault).write(AT);
    let line = format!(
        "message=fault axis=\"z\" drive={} from=OperationEnabled to=Fault statusword=0218h controlword=000Fh position=-7 at=1.5s ",
        drive()
    );
    assert_eq!(seen(), [(Level::ERROR, line)]);
}

#[test]
fn before_the_first_cycle_a_note_is_written_at_once_and_then_only_by_the_thread_of_the_queue() {
    seen();
    let queue = Arc::new(Queue::new(4));
    let log = Log(Some(Arc::clone(&queue)));
    log.note(AT, in_step(1));
    assert_eq!(seen().len(), 1);
    log.begin_cycles();
    log.note(AT, in_step(2));
    assert_eq!(seen(), [], "it waits");
    queue.write();
    let lines = seen();
    assert!(
        matches!(&lines[..], [(Level::INFO, line)] if line.contains("phase_error_ns=2 ")),
        "{lines:?}"
    );
}

#[test]
fn what_finds_the_queue_full_is_counted_and_told_in_its_place() {
    seen();
    let (log, queue) = queued(4);
    (0..10).for_each(|number| log.note(AT, in_step(number)));
    // There is room again, but the number is not told yet.
    let (_, first) = queue.notes.pop().unwrap();
    first.write(AT);
    log.note(AT, in_step(10));
    queue.write();
    log.note(AT, in_step(11));
    queue.write();
    let lines: Vec<String> = seen().into_iter().map(|(_, line)| line).collect();
    let parts = [
        "phase_error_ns=0 ",
        "phase_error_ns=1 ",
        "phase_error_ns=2 ",
        "phase_error_ns=3 ",
        "missed=7 ",
        "phase_error_ns=11 ",
    ];
    assert_eq!(lines.len(), parts.len(), "{lines:#?}");
    for (line, part) in lines.iter().zip(parts) {
        assert!(line.contains(part), "{line}, expected {part}");
    }
}
