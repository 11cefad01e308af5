//! What happens on the bus thread, on its way to the log.
//!
//! A subscriber may block: a paused terminal, a full pipe, a slow disk. Once cycles run, the bus thread therefore calls none: it
//! puts typed notes into a bounded queue, and a thread of the network's own makes events of them ([`Writer`]). What finds the queue
//! full is counted, and the number logged in its place.
//!
//! Before the first cycle nothing can be late and notes are written where they arise, in order with the other lines of the
//! bring-up and in its spans; so they are in virtual time, which stands still meanwhile.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    thread::{self, Thread},
    time::Duration,
};

use crossbeam_queue::ArrayQueue;
use thread_priority::{
    NormalThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id, thread_schedule_policy,
};
use tracing::{Dispatch, Level, dispatcher, level_filters::LevelFilter, subscriber::NoSubscriber};

use crate::{
    StopRequest,
    axis::AxisIdentity,
    bus::{
        error::{AlError, AlState, AlStatus, BringUpStep, NetworkError},
        event::{ClockEvent, Miscounted, NetworkEvent, Recovered},
    },
    coe::{DriveId, MailboxRecord, ObjectAddress},
    ds402::{Controlword, State, Statusword},
    log_target::{AXIS, BUS, DRIVE},
    units::{AxisScale, ScaleDifference},
    wakes::WakeStatistics,
};

/// Notes that wait for the thread that writes them.
const ROOM: usize = 1024;

/// Where the bus thread notes what is to be logged. Without a [`Writer`] notes are written at once.
#[derive(Debug, Clone, Default)]
pub(super) struct Log(Option<Arc<Queue>>);

/// Filled by one thread, emptied by one other.
#[derive(Debug)]
struct Queue {
    notes: ArrayQueue<(Duration, LogRecord)>,
    /// For how many notes there was no room. As long as it is not 0 nothing is queued, so that the number has its place.
    missed: AtomicU64,
    /// Whether notes go through the queue: cycles run, or have run.
    in_cycles: AtomicBool,
    /// Whether the thread is still to hear of a note.
    is_news: AtomicBool,
    /// Nothing more will be noted.
    over: AtomicBool,
    thread: OnceLock<Thread>,
}

impl Log {
    /// Notes what happened at this time of the bus. It neither blocks nor allocates once cycles run, and does nothing where nobody
    /// listens to events of its level.
    pub fn record(&self, at: Duration, note: LogRecord) {
        if note.level() > LevelFilter::current() {
            return;
        }
        match &self.0 {
            Some(queue) if queue.in_cycles.load(Ordering::Relaxed) => queue.push(at, note),
            _ => note.write(at),
        }
    }

    /// Cycles begin: from now on nothing is written on this thread.
    pub fn begin_cycles(&self) {
        if let Some(queue) = &self.0 {
            queue.in_cycles.store(true, Ordering::Relaxed);
        }
    }

    /// Wakes the thread that writes, if there is something new for it. A system call, and so not for the time in which frames are
    /// away.
    pub fn hand_over(&self) {
        if let Some(queue) = &self.0
            && queue.is_news.load(Ordering::Relaxed)
        {
            queue.is_news.store(false, Ordering::Relaxed);
            queue.wake();
        }
    }
}

impl Queue {
    fn new(room: usize) -> Self {
        Self {
            notes: ArrayQueue::new(room),
            missed: AtomicU64::new(0),
            in_cycles: AtomicBool::new(false),
            is_news: AtomicBool::new(false),
            over: AtomicBool::new(false),
            thread: OnceLock::new(),
        }
    }

    fn push(&self, at: Duration, note: LogRecord) {
        if self.missed.load(Ordering::Acquire) > 0 || self.notes.push((at, note)).is_err() {
            self.missed.fetch_add(1, Ordering::AcqRel);
        }
        self.is_news.store(true, Ordering::Relaxed);
    }

    fn wake(&self) {
        if let Some(thread) = self.thread.get() {
            thread.unpark();
        }
    }

    /// Makes events of all that waits.
    fn write(&self) {
        loop {
            while let Some((at, note)) = self.notes.pop() {
                note.write(at);
            }
            let missed = self.missed.swap(0, Ordering::AcqRel);
            if missed == 0 {
                return;
            }
            tracing::warn!(
                target: BUS,
                missed,
                "events found no room while the log was behind: they are not logged"
            );
        }
    }
}

// What the bus thread notes for the log, and the events that come of it. `at` is when it happened, by the bus's clock: a line may
// come later.

/// One event to be logged.
#[derive(Debug)]
pub(super) enum LogRecord {
    Axis(AxisRecord),
    Drive(Arc<DriveId>, DriveChange),
    /// A drive is in OP for the first time.
    BroughtUp(Arc<DriveId>),
    MailboxMessage(MailboxRecord),
    /// The program stopped all axes.
    StopOfAll(StopRequest),
    /// The program no longer says that it is alive.
    Unfed,
    /// The cycles are in step with the reference clock, for the first time.
    InStep {
        phase_error_ns: i64,
    },
    /// What happened between them after that.
    Clock(Arc<DriveId>, ClockEvent),
    /// A step of a drive's bring-up is done.
    Step {
        drive: Arc<DriveId>,
        step: BringUpStep,
        done: usize,
        total: usize,
    },
    /// How far the set-up of a device is.
    SetUp(Arc<DriveId>, &'static str),
    /// Its processor had not let go of its EEPROM.
    EepromForced(Arc<DriveId>),
    /// A device is in OP again because the program asked for it.
    Recovered(Arc<DriveId>, Recovered),
    /// It is not, for this reason, or because nobody waits for it any more.
    NotRecovered(Arc<DriveId>, Option<String>),
    /// A drive does not let its synchronisation type be set to SYNC0, and has this one.
    KeepsSyncType {
        drive: Arc<DriveId>,
        object: ObjectAddress,
        value: u16,
    },
    /// A drive has no object 6007h.
    NoAbortConnection {
        axis: String,
    },
    /// The scale of an axis and its drive contradict each other, which the program accepts.
    ScaleDiffers {
        axis: String,
        difference: ScaleDifference,
    },
    /// The working counter of a datagram stays wrong.
    Miscounted(Arc<Miscounted>),
    /// A level that the program has given for an axis, or a pair, is passed.
    Passed(NetworkEvent),
    /// A waker of the program holds up the others, or has panicked.
    Wakers(WakeStatistics),
    /// Frames of process data come back after their cycle.
    LateFrames {
        away: Duration,
        cycle: Duration,
    },
    /// At the end, axes still move.
    NotStopped,
    /// At the end, a drive did not go into this state.
    NotOnTheWayDown {
        drive: Arc<DriveId>,
        state: AlState,
        error: AlError,
    },
}

/// What has changed of an axis, and what it shows.
#[derive(Debug)]
pub(super) struct AxisRecord {
    pub axis: Arc<AxisIdentity>,
    pub scale: AxisScale,
    pub change: AxisChange,
    pub from: Option<State>,
    pub to: State,
    pub statusword: Statusword,
    pub controlword: Controlword,
    pub position: i32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AxisChange {
    Lost,
    Back,
    Fault {
        following_error: bool,
    },
    /// The fault was there before: its reaction has ended, or a further one has begun.
    InFault,
    State,
    Halted,
    Resumed,
    Slipped,
}

/// What has happened to a drive, or to another device.
#[derive(Debug, Clone, Copy)]
pub(super) enum DriveChange {
    Lost,
    Back,
    LeftOp(AlStatus),
    InOp,
}

impl DriveChange {
    /// As the program gets it.
    pub fn of(self, drive: &DriveId) -> NetworkEvent {
        let drive = drive.clone();
        match self {
            Self::Lost => NetworkEvent::Lost(drive),
            Self::Back => NetworkEvent::Back(drive),
            Self::LeftOp(status) => NetworkEvent::LeftOp { drive, status },
            Self::InOp => NetworkEvent::InOp(drive),
        }
    }
}

impl LogRecord {
    /// The level of the event that [`write`](Self::write) makes of it.
    pub fn level(&self) -> Level {
        match self {
            Self::Axis(note) => match note.change {
                AxisChange::Fault { .. } | AxisChange::Slipped => Level::ERROR,
                AxisChange::Lost => Level::WARN,
                AxisChange::Back | AxisChange::State | AxisChange::Halted | AxisChange::Resumed => {
                    Level::INFO
                }
                AxisChange::InFault => Level::DEBUG,
            },
            Self::Drive(_, DriveChange::Lost | DriveChange::LeftOp(_)) => Level::WARN,
            Self::Drive(..)
            | Self::BroughtUp(_)
            | Self::Recovered(..)
            | Self::InStep { .. }
            | Self::Clock(_, ClockEvent::InStep) => Level::INFO,
            Self::MailboxMessage(note) => note.level(),
            Self::Step { .. } | Self::SetUp(..) => Level::DEBUG,
            Self::StopOfAll(_)
            | Self::NotRecovered(..)
            | Self::KeepsSyncType { .. }
            | Self::NoAbortConnection { .. }
            | Self::ScaleDiffers { .. }
            | Self::EepromForced(_)
            | Self::Unfed
            | Self::Clock(..)
            | Self::NotStopped
            | Self::LateFrames { .. }
            | Self::Wakers(_)
            | Self::Miscounted(_)
            | Self::Passed(_)
            | Self::NotOnTheWayDown { .. } => Level::WARN,
        }
    }

    /// Makes an event of it.
    pub fn write(self, at: Duration) {
        match self {
            Self::Axis(note) => note.write(at),
            Self::Drive(drive, change) => write_drive(&drive, change, at),
            Self::BroughtUp(drive) => {
                tracing::info!(target: DRIVE, drive = %format_args!("{drive:#}"), ?at, "in OP");
            }
            Self::MailboxMessage(note) => note.write(at),
            Self::StopOfAll(stop) => {
                tracing::warn!(target: BUS, ?stop, ?at, "all axes are stopped");
            }
            Self::Unfed => {
                tracing::warn!(
                    target: BUS,
                    ?at,
                    "the program no longer feeds its liveness: all axes are halted"
                );
            }
            Self::InStep { phase_error_ns } => {
                tracing::info!(target: BUS, phase_error_ns, ?at, "in step with the reference clock");
            }
            Self::Clock(drive, event @ ClockEvent::InStep) => {
                tracing::info!(target: BUS, %drive, ?at, "{event}");
            }
            Self::Clock(drive, event) => tracing::warn!(target: BUS, %drive, ?at, "{event}"),
            Self::Step {
                drive,
                step,
                done,
                total,
            } => {
                tracing::debug!(target: DRIVE, %drive, %step, done, total, ?at, "bring-up step done");
            }
            Self::SetUp(drive, what) => tracing::debug!(target: DRIVE, %drive, ?at, "{what}"),
            Self::EepromForced(drive) => {
                tracing::warn!(
                    target: DRIVE,
                    %drive,
                    ?at,
                    "its processor does not let go of its EEPROM (0501h bit 0): taken by force (0500h = 02h)"
                );
            }
            Self::Recovered(drive, recovered) => {
                tracing::info!(target: DRIVE, %drive, ?at, "{recovered}");
            }
            Self::NotRecovered(drive, Some(reason)) => {
                tracing::warn!(target: DRIVE, %drive, ?at, "not recovered into OP: {reason}");
            }
            Self::NotRecovered(drive, None) => {
                tracing::warn!(target: DRIVE, %drive, ?at, "not recovered into OP: no call waits for it any more");
            }
            Self::KeepsSyncType {
                drive,
                object,
                value,
            } => {
                let value = format_args!("{value:04X}h");
                tracing::warn!(target: DRIVE, %drive, %object, %value, ?at, "not to be set to SYNC0");
            }
            Self::NoAbortConnection { axis } => {
                tracing::warn!(
                    target: DRIVE,
                    axis,
                    ?at,
                    "no object 6007h: the drive alone decides what it does when the process data stop"
                );
            }
            Self::ScaleDiffers { axis, difference } => {
                tracing::warn!(
                    target: DRIVE,
                    axis,
                    ?at,
                    "the scale of the axis and the drive disagree, {difference}"
                );
            }
            Self::Miscounted(miscounted) => tracing::warn!(target: BUS, ?at, "{miscounted}"),
            Self::Passed(event) => tracing::warn!(target: AXIS, ?at, "{event}"),
            Self::Wakers(WakeStatistics {
                slow,
                longest,
                panicked,
            }) => {
                tracing::warn!(
                    target: BUS,
                    slow,
                    ?longest,
                    panicked,
                    ?at,
                    "a waker of the program blocks or has panicked: no other future is woken while one blocks"
                );
            }
            Self::LateFrames { away, cycle } => tracing::warn!(
                target: BUS,
                ?at,
                ?away,
                ?cycle,
                "frames of process data come back after their cycle, and are not used: their drives count as silent"
            ),
            Self::NotStopped => {
                tracing::warn!(
                    target: BUS,
                    ?at,
                    "axes did not stop in time; their drives now act by 6007h"
                );
            }
            Self::NotOnTheWayDown {
                drive,
                state,
                error,
            } => tracing::warn!(target: DRIVE, %drive, %state, ?at, "not on the way down: {error}"),
        }
    }
}

impl AxisRecord {
    fn write(&self, at: Duration) {
        let AxisIdentity { axis, drive } = &*self.axis;
        let position = self.scale.scale().position_of(self.position);
        let unit = self.scale.unit();
        // As a macro, because the level of an event is a constant.
        macro_rules! event {
            ($level:ident, $text:literal) => {
                tracing::$level!(
                    target: AXIS,
                    axis,
                    %drive,
                    from = self.from.map(tracing::field::debug),
                    to = ?self.to,
                    statusword = %self.statusword,
                    controlword = %self.controlword,
                    position = %format_args!("{position} {unit}"),
                    ?at,
                    $text
                )
            };
        }
        match self.change {
            AxisChange::Lost => event!(warn, "counts as lost"),
            AxisChange::Back => event!(info, "is there again"),
            AxisChange::Fault {
                following_error: true,
            } => event!(error, "fault with following error"),
            AxisChange::Fault { .. } => event!(error, "fault"),
            AxisChange::InFault => event!(debug, "state changed within the fault"),
            AxisChange::State => event!(info, "state changed"),
            AxisChange::Halted => event!(info, "halted"),
            AxisChange::Resumed => event!(info, "no longer halted"),
            AxisChange::Slipped => event!(error, "has slipped on its brake"),
        }
    }
}

fn write_drive(drive: &DriveId, change: DriveChange, at: Duration) {
    let event = change.of(drive);
    match change {
        DriveChange::Lost | DriveChange::LeftOp(_) => {
            tracing::warn!(target: DRIVE, %drive, ?at, "{event}");
        }
        DriveChange::Back | DriveChange::InOp => {
            tracing::info!(target: DRIVE, %drive, ?at, "{event}");
        }
    }
}

// The thread that makes events of notes.

/// How often it looks without being woken: on a bus that is too busy for gaps nobody wakes it.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// How long the end of a network waits for the last lines.
const LAST_LINES: Duration = Duration::from_secs(1);

/// The other end of a [`Log`]: a thread of the network's own. It ends with the network, once all is written.
pub(super) struct Writer {
    queue: Arc<Queue>,
    /// Fails once the thread is gone.
    gone: mpsc::Receiver<()>,
}

impl Writer {
    /// To be called where the program starts the network, before the bus thread takes a real-time class, which a thread would inherit.
    /// The events go to the subscriber that is the default here.
    ///
    /// # Errors
    /// [`NetworkError::Thread`] if the system gives no thread.
    pub fn start() -> Result<(Log, Self), NetworkError> {
        let queue = Arc::new(Queue::new(ROOM));
        let (alive, gone) = mpsc::channel();
        let subscriber = Subscriber::current();
        let notes = Arc::clone(&queue);
        let thread = thread::Builder::new()
            .name("servocrab-log".into())
            .spawn(move || {
                leave_real_time();
                subscriber.of(|| write_all(&notes));
                drop(alive);
            })
            .map_err(|error| NetworkError::Thread(error.to_string()))?;
        // It was made here and holds nothing.
        let _ = queue.thread.set(thread.thread().clone());
        Ok((Log(Some(Arc::clone(&queue))), Self { queue, gone }))
    }

    /// Waits until all is written, but not for a subscriber that blocks: the thread is left to itself then, writes the rest when it
    /// can, and ends.
    pub fn end(self) {
        self.close();
        let _ = self.gone.recv_timeout(LAST_LINES);
    }

    fn close(&self) {
        self.queue.over.store(true, Ordering::Release);
        self.queue.wake();
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.close();
    }
}

fn write_all(queue: &Queue) {
    loop {
        let over = queue.over.load(Ordering::Acquire);
        // A subscriber that panics has cost the line that it was given, and no other one.
        while catch_unwind(AssertUnwindSafe(|| queue.write())).is_err() {}
        if over {
            return;
        }
        thread::park_timeout(LOOK_EVERY);
    }
}

/// A program that starts a network on a thread of a real-time class does not mean its log: at the bus thread's priority it would keep
/// that from its cycles.
fn leave_real_time() {
    if let Ok(ThreadSchedulePolicy::Realtime(_)) = thread_schedule_policy() {
        // Nobody is refused a lower class.
        let _ = set_thread_priority_and_policy(
            thread_native_id(),
            ThreadPriority::Min,
            ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other),
        );
    }
}

/// To whom the events of a network's threads go.
#[derive(Clone)]
pub(super) struct Subscriber(Dispatch);

impl Subscriber {
    /// The default of this thread.
    pub fn current() -> Self {
        Self(dispatcher::get_default(Clone::clone))
    }

    /// Does something with it as the default. A program that has none yet may set one for all threads later.
    pub fn of<T>(&self, what: impl FnOnce() -> T) -> T {
        if self.0.is::<NoSubscriber>() {
            return what();
        }
        dispatcher::with_default(&self.0, what)
    }
}

#[cfg(test)]
mod tests {
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
        StopRequest,
        axis::AxisIdentity,
        axis::WorkingCounter,
        bus::{
            BringUpStep,
            error::{AlError, AlState, AlStatus},
            event::ClockEvent,
        },
        coe::{DriveId, MailboxRecord},
        ds402::{Controlword, State, Statusword},
        sii::Identity,
        wakes::WakeStatistics,
    };

    thread_local! {
        static SEEN: RefCell<Vec<(Level, String)>> = const { RefCell::new(Vec::new()) };
    }

    /// Keeps the events of each thread for itself. One for all tests, since `tracing` remembers who listens for all threads.
    struct SeenLines;

    impl Subscriber for SeenLines {
        fn enabled(&self, _: &Metadata<'_>) -> bool {
            true
        }

        fn new_span(&self, _: &span::Attributes<'_>) -> span::Id {
            span::Id::from_u64(1)
        }

        fn record(&self, _: &span::Id, _: &span::Record<'_>) {}

        fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}

        fn event(&self, event: &Event<'_>) {
            let mut line = EventText(format!("{}: ", event.metadata().target()));
            event.record(&mut line);
            SEEN.with_borrow_mut(|seen| seen.push((*event.metadata().level(), line.0)));
        }

        fn enter(&self, _: &span::Id) {}

        fn exit(&self, _: &span::Id) {}
    }

    struct EventText(String);

    impl Visit for EventText {
        fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
            write!(self.0, "{}={value:?} ", field.name()).unwrap();
        }
    }

    /// What this thread has written since this was asked for last.
    fn seen() -> Vec<(Level, String)> {
        static SUBSCRIBED: Once = Once::new();
        SUBSCRIBED.call_once(|| tracing::subscriber::set_global_default(SeenLines).unwrap());
        SEEN.take()
    }

    fn drive() -> Arc<DriveId> {
        Arc::new(DriveId {
            position: 2,
            name: "AKD2G".into(),
            identity: Identity::default(),
        })
    }

    fn axis(change: AxisChange) -> LogRecord {
        let drive = DriveId::clone(&drive());
        LogRecord::Axis(AxisRecord {
            axis: Arc::new(AxisIdentity {
                axis: "z".into(),
                drive,
            }),
            scale: AxisScale::COUNTS,
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

    fn in_step(error: i64) -> LogRecord {
        LogRecord::InStep {
            phase_error_ns: error,
        }
    }

    const AT: Duration = Duration::from_millis(1500);

    #[test]
    fn each_record_is_one_event_of_its_level_with_one_of_three_targets_and_its_time() {
        let status = AlStatus {
            state: AlState::SafeOp,
            error: Some(0x1B),
        };
        let miscounted = Miscounted {
            counter: WorkingCounter {
                datagram: 0,
                expected: 3,
                got: 2,
                devices: 1,
            },
            devices: Vec::new(),
        };
        let mut notes: Vec<LogRecord> = [
            AxisChange::Lost,
            AxisChange::Back,
            AxisChange::Fault {
                following_error: false,
            },
            AxisChange::Fault {
                following_error: true,
            },
            AxisChange::InFault,
            AxisChange::State,
            AxisChange::Halted,
            AxisChange::Resumed,
            AxisChange::Slipped,
        ]
        .map(axis)
        .into();
        let changes = [
            DriveChange::Lost,
            DriveChange::Back,
            DriveChange::LeftOp(status),
            DriveChange::InOp,
        ];
        notes.extend(changes.map(|change| LogRecord::Drive(drive(), change)));
        notes.extend(MailboxRecord::of_each_kind(&drive()).map(LogRecord::MailboxMessage));
        notes.extend([
            LogRecord::BroughtUp(drive()),
            LogRecord::StopOfAll(StopRequest::HALT),
            LogRecord::Unfed,
            in_step(-5),
            LogRecord::Clock(drive(), ClockEvent::OutOfStep { phase_error_ns: 5 }),
            LogRecord::Clock(drive(), ClockEvent::InStep),
            LogRecord::Clock(drive(), ClockEvent::Silent),
            LogRecord::Clock(drive(), ClockEvent::Jumped { by_ns: 5 }),
            LogRecord::Step {
                drive: drive(),
                step: BringUpStep::Mapping,
                done: 3,
                total: 14,
            },
            LogRecord::LateFrames {
                away: Duration::from_millis(3),
                cycle: Duration::from_millis(1),
            },
            LogRecord::NotStopped,
            LogRecord::Wakers(WakeStatistics::default()),
            LogRecord::NotOnTheWayDown {
                drive: drive(),
                state: AlState::SafeOp,
                error: AlError::Refused(status),
            },
            LogRecord::SetUp(drive(), "in SAFEOP"),
            LogRecord::EepromForced(drive()),
            LogRecord::Recovered(drive(), Recovered::FromSafeOp { from: status }),
            LogRecord::NotRecovered(drive(), Some("it is gone".into())),
            LogRecord::NotRecovered(drive(), None),
            LogRecord::KeepsSyncType {
                drive: drive(),
                object: ObjectAddress::new(0x1C32, 1),
                value: 1,
            },
            LogRecord::NoAbortConnection { axis: "z".into() },
            LogRecord::ScaleDiffers {
                axis: "z".into(),
                difference: ScaleDifference::example(),
            },
            LogRecord::Miscounted(Arc::new(miscounted)),
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
            let (target, _) = line.split_once(": ").unwrap();
            assert!([AXIS, DRIVE, BUS].contains(&target), "{text}: {line}");
        }
    }

    #[test]
    fn a_fault_is_an_event_with_its_axis_its_drive_and_its_words() {
        seen();
        axis(AxisChange::Fault {
            following_error: false,
        })
        .write(AT);
        let line = format!(
            "servocrab::axis: message=fault axis=\"z\" drive={} from=OperationEnabled to=Fault statusword=0218h controlword=000Fh position=-7 counts at=1.5s ",
            drive()
        );
        assert_eq!(seen(), [(Level::ERROR, line)]);
    }

    #[test]
    fn before_the_first_cycle_a_note_is_written_at_once_and_then_only_by_the_thread_of_the_queue() {
        seen();
        let queue = Arc::new(Queue::new(4));
        let log = Log(Some(Arc::clone(&queue)));
        log.record(AT, in_step(1));
        assert_eq!(seen().len(), 1);
        log.begin_cycles();
        log.record(AT, in_step(2));
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
        (0..10).for_each(|number| log.record(AT, in_step(number)));
        // There is room again, but the number is not reported yet.
        let (_, first) = queue.notes.pop().unwrap();
        first.write(AT);
        log.record(AT, in_step(10));
        queue.write();
        log.record(AT, in_step(11));
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
}
