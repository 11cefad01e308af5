//! The bus loop in steady state allocates and frees nothing: it is turned 100 000 cycles long in virtual time under a counting
//! allocator, with moves and halts under way, SDO transfers of all kinds on several drives and from several tasks, emergencies,
//! and frames of messages lost now and then, while statistics are read. What the program itself allocates is not counted.
#![allow(missing_docs, unsafe_code)]

#[path = "common/counting.rs"]
mod counting;

use std::{
    cell::Cell,
    future::{Future, poll_fn},
    pin::{Pin, pin},
    rc::Rc,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context, Poll, Wake, Waker},
    time::Duration,
};

use servocrab::{
    AxisConfig, DriveConfig, Network, Referencing, SetPoint,
    bus::BusLoop,
    coe::{Emergencies, SdoHandle, information::ListKind, obj},
    drives,
    link::{Fate, Wire},
};
use servocrab_sim::{Habits, Segment, personality::Servo};

use counting::{counted, uncounted};

const CYCLES: u64 = 30_000;
const DRIVES: u16 = 3;
/// The drive that sends emergencies around its answers.
const TALKATIVE: u16 = 2;
/// One of so many frames with messages is lost.
const LOST: u64 = 1_000;

/// The loop, and what the program does beside it: polled when it was woken.
struct Bench {
    bus: BusLoop,
    tasks: Vec<Task>,
}

struct Task {
    future: Pin<Box<dyn Future<Output = ()>>>,
    woken: Arc<Woken>,
}

struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        self.0.store(true, Ordering::Release);
    }
}

impl Bench {
    fn begin(&mut self, future: impl Future<Output = ()> + 'static) {
        self.tasks.push(Task {
            future: Box::pin(future),
            woken: Arc::new(Woken(AtomicBool::new(true))),
        });
    }

    /// One turn of the loop, in which allocations and frees are counted; then the program.
    fn turn(&mut self) {
        assert!(counted(|| self.bus.turn()));
        for task in &mut self.tasks {
            if task.woken.0.swap(false, Ordering::AcqRel) {
                let waker = Waker::from(Arc::clone(&task.woken));
                let poll = task.future.as_mut().poll(&mut Context::from_waker(&waker));
                assert!(poll.is_pending(), "a task has ended");
            }
        }
    }

    fn until<T>(&mut self, future: impl Future<Output = T>) -> T {
        let mut future = pin!(future);
        loop {
            let poll = future
                .as_mut()
                .poll(&mut Context::from_waker(Waker::noop()));
            if let Poll::Ready(value) = poll {
                return value;
            }
            self.turn();
        }
    }

    /// Turns until the network has gone through this many more cycles.
    fn cycles(&mut self, net: &Network, cycles: u64) {
        let end = net.statistics().cycles + cycles;
        while net.statistics().cycles < end {
            self.turn();
        }
    }
}

/// How much of what the program did.
#[derive(Debug, Default)]
struct Done {
    transfers: Cell<u64>,
    refused: Cell<u64>,
    gone: Cell<u64>,
    emergencies: Cell<u64>,
}

fn add(count: &Cell<u64>) {
    count.set(count.get() + 1);
}

/// Writes and reads texts of this length without end: all kinds of transfers there are, by their lengths.
async fn texts(sdo: SdoHandle, length: usize, done: Rc<Done>) {
    loop {
        let text = vec![length as u8; length];
        sdo.write_bytes(0x5F00, 0, text).await.unwrap();
        // Another task may have written another one.
        let read = sdo.read_bytes(0x5F00, 0).await.unwrap();
        assert!(read.iter().all(|byte| *byte == read.len() as u8));
        add(&done.transfers);
    }
}

/// Typed values, complete access and questions about the dictionary; what the drive refuses.
async fn others(sdo: SdoHandle, done: Rc<Done>) {
    loop {
        sdo.read(obj::STATUSWORD).await.unwrap();
        let window = sdo.read(obj::POSITION_WINDOW).await.unwrap();
        sdo.write(obj::POSITION_WINDOW, window).await.unwrap();
        let speeds = sdo.read_complete(0x6099, 1).await.unwrap();
        sdo.write_complete(0x6099, 1, speeds).await.unwrap();
        assert!(sdo.object_list(ListKind::All).await.unwrap().len() > 50);
        sdo.describe_entry(0x6081, 0).await.unwrap();
        for refused in [
            sdo.read_bytes(0x5555, 0).await.map(drop),
            sdo.read_complete(0x1000, 0).await.map(drop),
            sdo.write_bytes(0x1000, 0, vec![0; 4]).await,
            sdo.write_bytes(0x5555, 0, vec![0; 2_000]).await,
            sdo.describe_object(0x5555).await.map(drop),
        ] {
            assert!(refused.unwrap_err().error.abort_code().is_some());
            add(&done.refused);
        }
        add(&done.transfers);
    }
}

/// Asks, and goes away before or while it is answered.
async fn leaver(sdo: SdoHandle, done: Rc<Done>) {
    for patience in (0..30).cycle() {
        let mut read = pin!(sdo.read_bytes(0x5F00, 0));
        let mut write = pin!(sdo.write_bytes(0x5F00, 0, vec![4; 4]));
        for _ in 0..patience {
            let answered = poll_fn(|context| {
                // It is woken at once, so that it is polled in each turn.
                context.waker().wake_by_ref();
                let over = read.as_mut().poll(context).is_ready()
                    || write.as_mut().poll(context).is_ready();
                Poll::Ready(over)
            });
            if answered.await {
                break;
            }
            smol::future::yield_now().await;
        }
        add(&done.gone);
    }
}

async fn listener(emergencies: Emergencies, done: Rc<Done>) {
    loop {
        let report = emergencies.next().await.unwrap();
        assert!(report.emergency().is_some());
        add(&done.emergencies);
    }
}

/// Whether a frame's first datagram behind the tag reads or writes a mailbox: FPRD or FPWR from 1000h on.
fn carries_message(frame: &[u8]) -> bool {
    matches!(frame[32], 4 | 5) && u16::from_le_bytes([frame[36], frame[37]]) >= 0x1000
}

/// A wire to the segment, on which every thousandth frame with messages is lost, on its way out and back in turns.
fn wire(segment: Arc<Mutex<Segment>>) -> Wire {
    let mut messages = 0;
    Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        uncounted(|| segment.lock().unwrap().process(frame, now))
    })
    .with_plan(move |_, frame| {
        messages += u64::from(carries_message(frame));
        match messages % (2 * LOST) {
            LOST if carries_message(frame) => Fate::LoseRequest,
            0 if carries_message(frame) => Fate::LoseAnswer,
            _ => Fate::Deliver,
        }
    })
}

#[test]
fn thousands_of_cycles_with_moves_sdo_traffic_and_statistics_allocate_and_free_nothing() {
    let segment = (0..DRIVES).fold(Segment::new(), |segment, _| {
        let drive = Servo::akd2g().with_complete_access();
        segment.with(drive.with_sdo_information().build())
    });
    let segment = Arc::new(Mutex::new(segment));
    let drive = |name: &str| {
        DriveConfig::new(drives::akd2g())
            .axis(AxisConfig::new(name).referencing(Referencing::UnreferencedMovesAllowed))
    };
    let builder = Network::builder()
        .cycle(Duration::from_micros(250))
        .link(wire(Arc::clone(&segment)));
    let builder = (0..DRIVES).fold(builder, |builder, position| {
        builder.drive(position, drive(&format!("axis {position}")))
    });
    let (starting, bus) = builder.split().unwrap();
    let mut bench = Bench {
        bus,
        tasks: Vec::new(),
    };
    let net = bench.until(starting.network()).unwrap();
    let axis = net.axis("axis 0").unwrap();
    bench.until(axis.enable()).unwrap();
    let pp = bench.until(axis.profile_position()).unwrap();
    let set_point = SetPoint::new()
        .velocity(100_000)
        .acceleration(1_000_000)
        .deceleration(1_000_000);

    let done = Rc::new(Done::default());
    for position in 0..DRIVES {
        let sdo = || net.sdo(position).unwrap();
        // Expedited, in one mail, in segments.
        for length in [2, 200, 3_000] {
            bench.begin(texts(sdo(), length, Rc::clone(&done)));
        }
        bench.begin(others(sdo(), Rc::clone(&done)));
        bench.begin(leaver(sdo(), Rc::clone(&done)));
        let emergencies = net.emergencies(position).unwrap();
        bench.begin(listener(emergencies, Rc::clone(&done)));
    }
    bench.begin(listener(net.all_emergencies(), Rc::clone(&done)));
    let delay = |position: u16, delay| {
        let mut segment = segment.lock().unwrap();
        let device = segment.device_mut(position.into()).unwrap();
        device.set_mailbox_delay(delay);
    };
    {
        let mut segment = segment.lock().unwrap();
        let talkative = segment.device_mut(TALKATIVE.into()).unwrap();
        talkative.set_habits(Habits {
            emergencies: true,
            ..Habits::default()
        });
    }
    for position in 0..DRIVES {
        delay(position, Duration::from_millis(1));
    }
    bench.cycles(&net, 5_000);

    counting::begin();
    let mut target = 0;
    let start = net.statistics().cycles;
    let mut moves = 0;
    let cycles = cycles();
    while net.statistics().cycles < start + cycles {
        // Now and then one answers at once.
        let is_quick = moves % 20 == 0;
        delay(0, Duration::from_millis(if is_quick { 0 } else { 1 }));
        target = 5_000 - target;
        moves += 1;
        let moved = bench.until(pp.move_abs(target, set_point)).unwrap();
        let mut done = pin!(moved.done());
        let mut context = Context::from_waker(Waker::noop());
        assert!(done.as_mut().poll(&mut context).is_pending());
        bench.cycles(&net, 500);
        assert!(net.timing().round_trip.count() > 0);
        assert!(net.drive_statistics().len() == usize::from(DRIVES));
        bench.cycles(&net, 500);
        assert!(matches!(
            done.as_mut().poll(&mut context),
            Poll::Ready(Ok(_))
        ));
        // Those who ask go away before the answer, and two share one halt.
        for _ in 0..3 {
            let mut left = Box::pin(axis.enable());
            assert!(left.as_mut().poll(&mut context).is_pending());
        }
        let mut halts = [Box::pin(axis.halt()), Box::pin(axis.halt())];
        for halt in &mut halts {
            assert!(halt.as_mut().poll(&mut context).is_pending());
        }
        let [left, halt] = halts;
        drop(left);
        bench.until(halt).unwrap();
        bench.until(axis.resume()).unwrap();
        let cycles = net.statistics().cycles - start;
        let counted = counting::so_far();
        assert_eq!(counted, 0, "allocations and frees in {cycles} cycles");
    }
    let least = |of_all: u64| of_all * cycles / CYCLES;
    assert!(done.transfers.get() > least(1_500), "{done:?}");
    assert!(done.refused.get() > least(600), "{done:?}");
    assert!(done.gone.get() > least(3_000), "{done:?}");
    assert!(done.emergencies.get() > least(3_000), "{done:?}");
}

fn cycles() -> u64 {
    let cycles = std::env::var("ALLOCATION_CYCLES").ok();
    cycles.map_or(CYCLES, |cycles| cycles.parse().unwrap())
}
