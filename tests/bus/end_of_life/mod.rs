//! The end of a network whose axes move, in every mode and in every trouble: the last frame with outputs goes out when the axis stands, or the
//! error of the end names it. The simulated drive says how fast it was, frame by frame.

use std::{
    future::Future,
    pin::pin,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU8, Ordering::SeqCst},
    },
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    Axis, AxisConfig, DriveConfig, Failure, HomingMethod, HomingParameters, Network, NetworkError,
    Referencing, SetPoint,
    axis::Deadlines,
    bus::{BusLoop, Finding, Miscounted, NetworkEvent},
    coe::obj,
    drives,
    link::Wire,
};
use servocrab_sim::{
    Segment,
    ds402::{Machine, State},
    personality::Servo,
};

const MS: Duration = Duration::from_millis(1);
const SECOND: Duration = Duration::from_secs(1);
/// What the axes do while they are asked to end.
const SPEED: u32 = 300_000;
/// Counts per second that are nothing: what is left of an encoder's noise.
const STANDS: f64 = 100.0;
/// The steps down and a second, beside the axes' own deadlines.
const DOWN: Duration = Duration::from_secs(6);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Doing {
    Positions,
    Jogs,
    Homes,
}

/// What is wrong when the end comes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Incident {
    None,
    /// The drive reacts to a fault of its own.
    Fault,
    /// Its quick stop takes 25 s, and it has the time.
    SlowRamp,
    /// It takes 25 s, and the axis may take 2 s.
    TooSlow,
    /// The working counter is one short, and the axes count as lost since some cycles.
    Lost,
    /// The working counter is one short from the end on.
    LostMeanwhile,
    DeafToHalt,
    DeafToQuickStop,
    DeafToBoth,
    /// The other drive in the datagram shows no inputs and takes its outputs.
    Miscounted,
}

const TROUBLES: [Incident; 10] = [
    Incident::None,
    Incident::Fault,
    Incident::SlowRamp,
    Incident::TooSlow,
    Incident::Lost,
    Incident::LostMeanwhile,
    Incident::DeafToHalt,
    Incident::DeafToQuickStop,
    Incident::DeafToBoth,
    Incident::Miscounted,
];

/// Two drives in one datagram, of which the first one moves.
struct Line {
    segment: Arc<Mutex<Segment>>,
    /// The working counter of the process data comes back so much short.
    short: Arc<AtomicU8>,
    /// How fast the axis was in the last frame with outputs, in counts per second.
    last: Arc<Mutex<f64>>,
}

impl Line {
    fn new(options: &[(u16, i64)]) -> Self {
        let machine = Machine {
            start: 20_000,
            negative_limit: Some(-50_000_000),
            positive_limit: Some(50_000_000),
            ..Machine::default()
        };
        let servo = move || {
            let machine = machine.clone();
            Servo::akd2g().change(move |drive| {
                drive.machine = machine.clone();
                drive.coast_deceleration = 500_000;
            })
        };
        let mut segment = Segment::new().with(servo().build()).with(servo().build());
        for (object, value) in options {
            let axis = segment.axis_mut(0, 0).unwrap();
            axis.set(*object, 0, *value).unwrap();
        }
        Self {
            segment: Arc::new(Mutex::new(segment)),
            short: Arc::default(),
            last: Arc::default(),
        }
    }

    fn wire(&self) -> Wire {
        let (segment, short) = (Arc::clone(&self.segment), Arc::clone(&self.short));
        let last = Arc::clone(&self.last);
        Wire::in_virtual_time(10 * MS / 1000, move |frame: &mut [u8], now| {
            let mut segment = segment.lock().unwrap();
            let answered = segment.process(frame, now);
            let is_cyclic = frame[17] != 0xFF;
            if is_cyclic {
                *last.lock().unwrap() = segment.axis(0, 0).unwrap().velocity();
                let length = usize::from(u16::from_le_bytes([frame[38], frame[39]]) & 0x07FF);
                let counter = &mut frame[42 + length];
                *counter = counter.saturating_sub(short.load(SeqCst));
            }
            answered
        })
    }

    /// One datagram to a register of a device, by its position, past the network.
    fn write(&self, position: u16, register: u16, data: &[u8], now: Duration) {
        let [p0, p1] = position.wrapping_neg().to_le_bytes();
        let [r0, r1] = register.to_le_bytes();
        let length = data.len() as u16;
        let [h0, h1] = (0x1000 | (length + 12)).to_le_bytes();
        let mut frame = vec![0xFF; 12];
        frame.extend([
            0x88,
            0xA4,
            h0,
            h1,
            2,
            0,
            p0,
            p1,
            r0,
            r1,
            length as u8,
            0,
            0,
            0,
        ]);
        frame.extend(data);
        frame.extend([0; 2]);
        assert!(self.segment.lock().unwrap().process(&mut frame, now));
        assert_eq!(frame[26 + data.len()], 1, "it is written");
    }
}

fn deadlines(standstill: Duration) -> Deadlines {
    Deadlines {
        standstill,
        ..Deadlines::default()
    }
}

fn drive(axis: &str, standstill: Duration) -> DriveConfig {
    let second = format!("{axis}2");
    DriveConfig::new(drives::akd2g())
        .axis(
            AxisConfig::new(axis)
                .referencing(Referencing::UnreferencedMovesAllowed)
                .map_output(obj::TARGET_VELOCITY)
                .deadlines(deadlines(standstill)),
        )
        .axis(AxisConfig::new(&second).deadlines(deadlines(standstill)))
}

/// Turns the loop until the future is ready.
fn until<T>(bus: &mut BusLoop, future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    let end = bus.now() + 600 * SECOND;
    let mut goes_on = true;
    loop {
        let polled = future
            .as_mut()
            .poll(&mut Context::from_waker(Waker::noop()));
        if let Poll::Ready(value) = polled {
            return value;
        }
        assert!(goes_on && bus.now() < end, "it does not end");
        goes_on = bus.turn();
    }
}

fn run_for(bus: &mut BusLoop, time: Duration) {
    let end = bus.now() + time;
    while bus.now() < end {
        assert!(bus.turn());
    }
}

/// What keeps the motion under way.
type Kept = Box<dyn std::any::Any>;

fn begin(bus: &mut BusLoop, axis: &Axis, doing: Doing) -> Kept {
    let speed = SetPoint::new().velocity(SPEED);
    match doing {
        Doing::Positions => until(bus, async {
            let pp = axis.profile_position().await.unwrap();
            let set_point = speed.acceleration(3_000_000).deceleration(3_000_000);
            let motion = pp.move_abs(40_000_000, set_point).await.unwrap();
            Box::new((pp, motion))
        }),
        Doing::Jogs => until(bus, async {
            let pv = axis.profile_velocity().await.unwrap();
            let jog = pv.jog(SPEED as i32).await.unwrap();
            Box::new((pv, jog))
        }),
        Doing::Homes => {
            let homing = until(bus, axis.homing()).unwrap();
            let parameters = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
                .speeds(SPEED, 5_000)
                .acceleration(3_000_000);
            let mut home = Box::pin(async move {
                let _ = homing.home(parameters).await;
            });
            for _ in 0..2_000 {
                let polled = home.as_mut().poll(&mut Context::from_waker(Waker::noop()));
                assert!(polled.is_pending());
                assert!(bus.turn());
            }
            // It is under way, and whoever waits for it waits on.
            Box::new(home)
        }
    }
}

/// How it ended, how fast the axis was in the last frame with outputs, and how long the end took.
struct Ended {
    result: Result<(), NetworkError>,
    speed: f64,
    took: Duration,
}

/// None if the drive is not taken with these options.
fn live(doing: Doing, trouble: Incident, options: &[(u16, i64)]) -> Option<Ended> {
    let mut all = options.to_vec();
    // As fast as an axis stops, unless it is to take long.
    all.push((0x6085, 3_000_000));
    let slow = matches!(trouble, Incident::SlowRamp | Incident::TooSlow);
    if slow {
        all.push((0x6085, i64::from(SPEED) / 25));
        all.push((0x605A, 2));
        all.push((0x605D, 2));
    }
    let standstill = if trouble == Incident::TooSlow { 2 } else { 60 };
    let standstill = u32::from(standstill as u8) * SECOND;
    let line = Line::new(&all);
    let network = Network::builder()
        .link(line.wire())
        .drive(0, drive("x", standstill))
        .drive(1, drive("z", standstill));
    let (starting, mut bus) = network.split().unwrap();
    let net = until(&mut bus, starting.network());
    let net = match net {
        Ok(net) => net,
        // A drive that would coast is refused.
        Err(_) if options.iter().any(|option| option.1 == 0) => return None,
        Err(error) => panic!("{error}"),
    };
    let x = net.axis("x").unwrap();
    until(&mut bus, x.enable()).unwrap();
    let kept = begin(&mut bus, &x, doing);
    run_for(&mut bus, 500 * MS);
    let moving = || {
        line.segment
            .lock()
            .unwrap()
            .axis(0, 0)
            .unwrap()
            .velocity()
            .abs()
    };
    assert!(moving() > 0.9 * f64::from(SPEED), "{doing:?}: {}", moving());
    {
        let mut segment = line.segment.lock().unwrap();
        let drive = segment.axis_mut(0, 0).unwrap();
        let deaf = drive.disturbances();
        deaf.deaf_to_halt = matches!(trouble, Incident::DeafToHalt | Incident::DeafToBoth);
        deaf.deaf_to_quick_stop =
            matches!(trouble, Incident::DeafToQuickStop | Incident::DeafToBoth);
        if trouble == Incident::Fault {
            drive.inject_fault(0x8611);
        }
    }
    match trouble {
        Incident::Fault => run_for(&mut bus, 5 * MS),
        Incident::Lost => {
            line.short.store(1, SeqCst);
            run_for(&mut bus, 155 * MS);
            assert!(x.status().lost && x.status().answered, "{:?}", x.status());
        }
        Incident::LostMeanwhile => line.short.store(1, SeqCst),
        // FMMU 1, of the inputs.
        Incident::Miscounted => line.write(1, 0x061C, &[0], bus.now()),
        _ => {}
    }
    let begun = bus.now();
    let result = until(&mut bus, net.shutdown());
    let took = bus.now() - begun;
    drop(kept);
    let speed = line.last.lock().unwrap().abs();
    Some(Ended {
        result,
        speed,
        took,
    })
}

fn judge(doing: Doing, trouble: Incident, options: &[(u16, i64)]) -> bool {
    let Some(ended) = live(doing, trouble, options) else {
        return false;
    };
    let case = format!("{doing:?}, {trouble:?}, {options:04X?}: {:?}", ended.result);
    match &ended.result {
        Ok(()) => assert!(ended.speed < STANDS, "{case}: at {} counts/s", ended.speed),
        Err(NetworkError::StillMoving(axes)) => {
            assert!(axes.iter().any(|axis| axis.axis.axis == "x"), "{case}");
            let text = ended.result.as_ref().unwrap_err().to_string();
            assert!(text.contains(": axis x (drive 0 "), "{text}");
            // A velocity would be in counts/s.
            assert!(text.contains(" counts, in "), "{text}");
        }
        Err(error) => panic!("{case}: {error}"),
    }
    let too_slow = trouble == Incident::TooSlow && ended.speed >= STANDS;
    assert_eq!(ended.result.is_err(), too_slow, "{case}");
    let standstill = if trouble == Incident::TooSlow { 2 } else { 60 };
    let bound = 2 * standstill * SECOND + Deadlines::default().disable + DOWN;
    assert!(ended.took <= bound, "{case}: {:?}", ended.took);
    true
}

fn every_trouble(doing: Doing) {
    for trouble in TROUBLES {
        assert!(judge(doing, trouble, &[]));
    }
}

#[test]
fn a_set_point_under_way() {
    every_trouble(Doing::Positions);
}

#[test]
fn a_jog_that_is_held() {
    every_trouble(Doing::Jogs);
}

#[test]
fn a_homing_under_way() {
    every_trouble(Doing::Homes);
}

/// The option codes of quick stop, halt, shutdown, disable operation and fault reaction, with all values that the standard has.
#[test]
fn whatever_the_drive_does_by_its_option_codes() {
    let codes: [(u16, &[i64]); 5] = [
        (0x605A, &[0, 1, 2, 3, 4, 5, 6, 7, 8]),
        (0x605B, &[0, 1]),
        (0x605C, &[0, 1]),
        (0x605D, &[0, 1, 2, 3, 4]),
        (0x605E, &[0, 1, 2, 3, 4]),
    ];
    let mut lived = 0;
    for (object, values) in codes {
        for value in values {
            for doing in [Doing::Positions, Doing::Jogs, Doing::Homes] {
                let troubles: &[Incident] = if object == 0x605E {
                    &[Incident::Fault]
                } else {
                    &[Incident::None, Incident::Lost]
                };
                for trouble in troubles {
                    lived += u32::from(judge(doing, *trouble, &[(object, *value)]));
                }
            }
        }
    }

    assert!(lived > 100, "{lived}");
}

#[test]
fn a_drive_whose_working_counter_is_short_answers_and_its_failure_names_the_datagram_and_the_cause()
{
    let line = Line::new(&[(0x6085, 3_000_000)]);
    let network = Network::builder()
        .link(line.wire())
        .drive(0, drive("x", 60 * SECOND))
        .drive(1, drive("z", 60 * SECOND));
    let (starting, mut bus) = network.split().unwrap();
    let net = until(&mut bus, starting.network()).unwrap();
    let events = net.events();
    let x = net.axis("x").unwrap();
    until(&mut bus, x.enable()).unwrap();
    let pp = until(&mut bus, x.profile_position()).unwrap();
    let set_point = SetPoint::new().velocity(SPEED).acceleration(3_000_000);
    let motion = until(&mut bus, pp.move_abs(40_000_000, set_point)).unwrap();
    run_for(&mut bus, 500 * MS);
    // It takes outputs and gives no inputs: the working counter is one short.
    line.write(1, 0x061C, &[0], bus.now());
    let error = until(&mut bus, motion.done()).unwrap_err();
    let Some(Failure::Undelivered {
        counter: Some(counter),
        ..
    }) = error.failure()
    else {
        panic!("{error}");
    };
    // The other one counts as lost, and is missing all the same.
    assert_eq!((counter.datagram, counter.devices), (0, 2));
    assert_eq!((counter.got, counter.expected), (5, 6));
    let text = error.to_string();
    assert!(
        text.contains("the drive answers") && text.contains("working counter 5, expected 6"),
        "{text}"
    );
    // A stop ends by what the drive shows.
    until(&mut bus, x.stop()).unwrap();
    let stopped = line.segment.lock().unwrap();
    let drive = stopped.axis(0, 0).unwrap();
    assert!(drive.velocity().abs() < STANDS, "{}", drive.velocity());
    assert_ne!(drive.state(), State::OperationEnabled);
    drop(stopped);
    let refused = until(&mut bus, x.enable()).unwrap_err();
    assert!(
        matches!(refused.failure(), Some(Failure::Undelivered { .. })),
        "{refused}"
    );
    // Who it is.
    let found = loop {
        let event = until(&mut bus, events.next()).unwrap();
        if let NetworkEvent::Miscounted(miscounted) = event {
            break miscounted;
        }
    };
    assert_eq!((found.counter.got, found.counter.expected), (5, 6));
    let [first, second] = &found.devices[..] else {
        panic!("{found}");
    };
    assert_eq!((first.device.position, second.device.position), (0, 1));
    assert!(first.findings.is_empty(), "{found}");
    assert_eq!(second.findings, [Finding::Fmmu(1)], "{found}");
    let text = found.to_string();
    assert!(
        text.contains("shared by") && text.contains("FMMU 1"),
        "{text}"
    );
    until(&mut bus, net.shutdown()).unwrap();
}

/// What is found of a line whose working counter stays three short, after a write to a register of its second device. Less would be what
/// one out of OP does not count.
fn found_after(write: Option<(u16, &[u8])>) -> Arc<Miscounted> {
    let line = Line::new(&[]);
    let network = Network::builder()
        .link(line.wire())
        .drive(0, drive("x", SECOND))
        .drive(1, drive("z", SECOND));
    let (starting, mut bus) = network.split().unwrap();
    let net = until(&mut bus, starting.network()).unwrap();
    let events = net.events();
    if let Some((register, data)) = write {
        line.write(1, register, data, bus.now());
    }
    run_for(&mut bus, 200 * MS);
    line.short.store(3, SeqCst);
    let found = loop {
        let event = until(&mut bus, events.next()).unwrap();
        if let NetworkEvent::Miscounted(miscounted) = event {
            break miscounted;
        }
    };
    line.short.store(0, SeqCst);
    until(&mut bus, net.shutdown()).ok();
    assert_eq!(found.counter.expected, 6, "{found}");
    assert_eq!(found.devices.len(), 2, "{found}");
    assert!(found.devices[0].findings.is_empty(), "{found}");
    found
}

#[test]
fn a_miscounting_device_that_is_not_in_op_is_found_by_its_state() {
    let found = found_after(Some((0x0120, &[4, 0])));
    let findings = &found.devices[1].findings;
    assert!(matches!(findings[..], [Finding::State(_)]), "{found}");
    let text = found.to_string();
    assert!(
        text.contains("it is in") && text.contains("SAFEOP"),
        "{text}"
    );
}

#[test]
fn a_miscounting_device_whose_sync_manager_is_off_is_found_by_that() {
    let found = found_after(Some((0x081E, &[0])));
    // It has left OP for that.
    let findings = &found.devices[1].findings;
    assert!(
        matches!(findings[..], [Finding::State(_), Finding::SyncManager(3)]),
        "{found}"
    );
    let text = found.to_string();
    assert!(text.contains("sync manager 3 is off"), "{text}");
}

#[test]
fn a_miscount_that_no_register_explains_is_reported_as_such() {
    let found = found_after(None);
    assert!(found.devices[1].findings.is_empty(), "{found}");
    let text = found.to_string();
    assert!(
        text.contains("shared by") && text.contains("the registers of none show why"),
        "{text}"
    );
}
