//! Distributed clocks: drives that insist on outputs in time against SYNC0, on crystals that drift.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use servocrab::coe::{ObjectAddress, obj};
use servocrab::drives;
use servocrab::link::Link;
use servocrab::parameters::StartUpWrite;
use servocrab::{
    DriveConfig, Network, NetworkError,
    bus::{BringUpStep, DistributedClock, DriveFault, ReferenceClock},
};
use servocrab_sim::personality::{self, Servo};
use servocrab_sim::{AlState, ClockDemand, ClockWidth, Device, Habits, Segment};

use crate::otherwise::Otherwise;
use crate::rig::{Line, Rig};

const MS: Duration = Duration::from_millis(1);
/// What the drives want of outputs, in parts of their cycle: a tenth before SYNC0, and a tenth after the one before.
const MARGIN: u32 = 10;

/// A drive that goes into a fault when outputs come at a wrong time.
pub(crate) fn insisting(cycle: Duration, drift_ppm: f64, start_ns: u64) -> Device {
    let mut drive = Servo::sigma7()
        .insists_on_clock(ClockDemand {
            before: cycle / MARGIN,
            after: cycle / MARGIN,
            lock_pulses: 10,
            fault: Some(0xFF06),
        })
        // One cycle of its processor for each of the network's.
        .change(|behaviour| behaviour.period = cycle)
        .build();
    drive.set_clock(start_ns, drift_ppm);
    drive
}

fn named(axis: &str) -> DriveConfig {
    DriveConfig::new(drives::sigma7())
        .axis(axis)
        .dc(DistributedClock::new(0x0300))
}

/// How far the clocks of the segment's devices are apart, in nanoseconds.
pub(crate) fn apart(segment: &Segment, now: Duration) -> u64 {
    let clocks = segment.devices().iter();
    let times = clocks
        .filter(|device| device.description().clock == Some(ClockWidth::Bits64))
        .map(|device| device.system_time(now));
    let (least, most) = times.fold((u64::MAX, 0), |(least, most), time| {
        (least.min(time), most.max(time))
    });
    most - least
}

pub(crate) fn mistakes(line: &Line) -> u64 {
    let segment = line.segment();
    segment.devices().iter().map(Device::sync_mistakes).sum()
}

fn all_in_op(line: &Line) -> bool {
    let segment = line.segment();
    segment
        .devices()
        .iter()
        .all(|device| device.al_state() == AlState::Op)
}

#[test]
fn the_phase_stays_within_its_bound_with_crystals_100_ppm_apart_each_way() {
    for (reference, others) in [(100.0, -100.0), (-100.0, 100.0)] {
        let mut segment = Segment::new().with(insisting(MS, reference, 5_000_000_000));
        segment.push(insisting(MS, others, 77));
        segment.push(insisting(MS, 0.0, 1 << 40));
        segment.set_delay(2, Duration::from_nanos(1_700));
        let line = Line::new(segment);
        let builder = Network::builder()
            .link(line.wire())
            .drive(0, named("x"))
            .drive(1, named("y"))
            .drive(2, named("z"));
        let mut rig = Rig::start(builder).unwrap();
        assert!(all_in_op(&line));
        rig.run_for(200 * MS);
        let before = mistakes(&line);
        for _ in 0..50 {
            rig.run_for(100 * MS);
            let apart = apart(&line.segment(), rig.bus.now());
            assert!(apart < 200, "{apart} ns apart");
        }
        let clock = rig.net().statistics().clock.unwrap();
        assert_eq!(clock.bound, MS / 50);
        assert!(clock.locked && clock.beyond == 0, "{clock:?}");
        // Far within the bound, and at the end hardly anything is left.
        assert!(clock.worst_ns < 5_000, "{clock:?}");
        assert!(clock.phase_error_ns.abs() < 100, "{clock:?}");
        let errors = rig.net().timing().phase_error;
        let worst = Duration::from_nanos(clock.worst_ns.unsigned_abs());
        assert!(errors.count() > 5_000 && errors.most() == Some(worst));
        assert!(errors.quantile(0.5) < Some(Duration::from_nanos(200)));
        assert_eq!(mistakes(&line), before, "nobody has complained");
        assert!(all_in_op(&line));
        rig.shutdown();
    }
}

/// Two drives that insist, crystals 200 ppm apart, and nobody complains.
fn never_complain(cycle: Duration, time: Duration) {
    let segment = Segment::new()
        .with(insisting(cycle, 100.0, 0))
        .with(insisting(cycle, -100.0, 1_000_000));
    let line = Line::new(segment);
    let builder = Network::builder()
        .link(line.wire())
        .cycle(cycle)
        .drive(0, named("x"))
        .drive(1, named("y"));
    let mut rig = Rig::start(builder).unwrap();
    rig.run_for(100 * cycle);
    let before = mistakes(&line);
    rig.run_for(time);
    assert_eq!(mistakes(&line), before);
    assert!(all_in_op(&line));
    let statistics = rig.net().statistics();
    assert!(u128::from(statistics.cycles) > time.as_nanos() / cycle.as_nanos());
    let clock = statistics.clock.unwrap();
    assert!(clock.locked && clock.beyond == 0, "{clock:?}");
    rig.shutdown();
}

// A cycle of two drives takes 0.15 ms of a debug build: ten minutes take 9 s at 10 ms, and would take 90 s at 1 ms. Built with
// optimisation they are run at 1 ms; without it a minute is.
const OPTIMISED: bool = !cfg!(debug_assertions);

#[test]
fn a_drive_that_insists_never_complains_in_ten_minutes() {
    let cycle = if OPTIMISED { MS } else { 10 * MS };
    never_complain(cycle, Duration::from_secs(600));
}

#[test]
fn a_drive_that_insists_never_complains_in_a_minute_of_milliseconds() {
    never_complain(MS, Duration::from_secs(60));
}

#[test]
fn cycles_that_were_slept_through_keep_the_phase() {
    let mut drive = personality::sigma7();
    drive.set_clock(0, 20.0);
    let line = Line::new(Segment::new().with(drive));
    let oversleep_us = Arc::new(AtomicU64::new(0));
    // The operating system keeps the thread asleep for longer than it wanted, when it is told to.
    let longer = Arc::clone(&oversleep_us);
    let link = Otherwise::new(line.wire()).waits(move |wire, until| {
        wire.wait(until);
        let until = wire.now() + Duration::from_micros(longer.swap(0, Ordering::Relaxed));
        while wire.now() < until {
            wire.wait(until);
        }
    });
    let builder = Network::builder().link(link).drive(0, named("x"));
    let mut rig = Rig::start(builder).unwrap();
    rig.run_for(300 * MS);
    oversleep_us.store(1_900, Ordering::Relaxed);
    rig.run_for(4 * MS);
    let clock = rig.net().statistics().clock.unwrap();
    assert!(clock.worst_ns > 300_000, "it has slept: {clock:?}");
    for _ in 0..20 {
        rig.run_for(MS);
        let clock = rig.net().statistics().clock.unwrap();
        assert!(clock.phase_error_ns.abs() < 1_000, "{clock:?}");
    }
    assert!(all_in_op(&line));
    rig.shutdown();
}

#[test]
fn clocks_behind_a_branch_and_devices_without_one_agree() {
    // A drive without a clock, the reference, a terminal; two drives at port 3 of the reference; one behind it.
    let mut segment = Segment::new()
        .with(Servo::sigma7().clock(None).build())
        .with(insisting(MS, 30.0, 4_711))
        .with(insisting(MS, -60.0, 99));
    assert_eq!(segment.attach(1, 3, insisting(MS, 90.0, 1 << 33)), Some(2));
    assert_eq!(segment.attach(2, 1, personality::coupler()), Some(3));
    for (position, ns) in [(1, 800), (2, 2_300), (3, 400), (4, 1_100)] {
        segment.set_delay(position, Duration::from_nanos(ns));
    }
    let line = Line::new(segment);
    let builder = Network::builder()
        .link(line.wire())
        .drive(1, named("x"))
        .drive(2, named("y"))
        .drive(4, named("z"));
    let mut rig = Rig::start(builder).unwrap();
    rig.run_for(500 * MS);
    // The delays are exact: nothing but the control loops' nanoseconds is left.
    let apart = apart(&line.segment(), rig.bus.now());
    assert!(apart < 150, "{apart} ns apart");
    rig.shutdown();
}

#[test]
fn clocks_of_32_bits_begin_again_every_four_seconds_and_nobody_notices() {
    let narrow = |drift: f64, start: u64| {
        let mut drive = Servo::sigma7()
            .clock(Some(ClockWidth::Bits32))
            .insists_on_clock(ClockDemand {
                before: MS / MARGIN,
                after: MS / MARGIN,
                lock_pulses: 10,
                fault: Some(0xFF06),
            })
            .build();
        drive.set_clock(start, drift);
        drive
    };
    let segments = [
        Segment::new()
            .with(narrow(50.0, 0xFFFF_0000))
            .with(insisting(MS, -50.0, 1 << 35)),
        Segment::new()
            .with(insisting(MS, -50.0, (1 << 35) - 100_000_000))
            .with(narrow(50.0, 0xFFFF_0000)),
    ];
    for segment in segments {
        let line = Line::new(segment);
        let builder = Network::builder()
            .link(line.wire())
            .drive(0, named("x"))
            .drive(1, named("y"));
        let mut rig = Rig::start(builder).unwrap();
        rig.run_for(100 * MS);
        let before = mistakes(&line);
        rig.run_for(Duration::from_secs(10));
        assert_eq!(mistakes(&line), before);
        assert!(all_in_op(&line));
        rig.shutdown();
    }
}

#[test]
fn the_synchronisation_types_are_set_where_the_drive_has_them() {
    let segment = Segment::new().with(personality::akd2g());
    let line = Line::new(segment);
    let drive = DriveConfig::new(drives::akd2g())
        .axis("x")
        .dc(DistributedClock::new(0x0300).sync0_cycle(2 * MS));
    let builder = Network::builder().link(line.wire()).drive(0, drive);
    let mut rig = Rig::start(builder).unwrap();
    let sdo = rig.net().sdo(0).unwrap();
    for (kind, time) in [
        (obj::OUTPUT_SYNC_TYPE, obj::OUTPUT_CYCLE_TIME),
        (obj::INPUT_SYNC_TYPE, obj::INPUT_CYCLE_TIME),
    ] {
        assert_eq!(rig.until(sdo.read(kind)).unwrap(), 2);
        assert_eq!(rig.until(sdo.read(time)).unwrap(), 2_000_000);
    }
    rig.shutdown();
}

/// A drive that a program with distributed clocks has used, and when that has ended.
fn left_by_a_program_with_clocks(drive: Servo) -> (Line, Duration) {
    let line = Line::new(Segment::new().with(drive.build()));
    let clocked = DriveConfig::new(drives::akd2g())
        .axis("x")
        .dc(DistributedClock::new(0x0300));
    let builder = Network::builder().link(line.wire());
    let rig = Rig::start(builder.drive(0, clocked)).unwrap();
    let end = rig.bus.now() + Duration::from_secs(10);
    rig.shutdown();
    (line, end)
}

#[test]
fn a_drive_left_in_sync0_follows_its_process_data_without_clocks() {
    let (line, begin) = left_by_a_program_with_clocks(Servo::akd2g().sm_synchronous());
    // Its processor takes its time for the acknowledge of what it has refused, too.
    line.segment().device_mut(0).unwrap().set_habits(Habits {
        al_delay: 20 * MS,
        ..Habits::default()
    });
    let drive = DriveConfig::new(drives::akd2g()).axis("x");
    let builder = Network::builder().link(line.wire_from(begin));
    let mut rig = Rig::start(builder.drive(0, drive)).unwrap();
    assert!(all_in_op(&line));
    let sdo = rig.net().sdo(0).unwrap();
    assert_eq!(rig.until(sdo.read(obj::OUTPUT_SYNC_TYPE)).unwrap(), 1);
    assert_eq!(rig.until(sdo.read(obj::INPUT_SYNC_TYPE)).unwrap(), 34);
    rig.shutdown();
}

#[test]
fn a_drive_left_in_sync0_that_has_free_run_alone_is_refused_with_what_to_write() {
    let (line, begin) = left_by_a_program_with_clocks(Servo::akd2g());
    let drive = DriveConfig::new(drives::akd2g()).axis("x");
    let builder = Network::builder().link(line.wire_from(begin));
    let error = Rig::start(builder.drive(0, drive.clone())).err().unwrap();
    let text = error.to_string();
    for part in ["0030h", "1C32h:01 holds 2 (SYNC0)", "start-up list"] {
        assert!(text.contains(part), "{text}");
    }
    let free_run = |index| StartUpWrite::to(ObjectAddress::new(index, 1), 0_u16);
    let drive = drive.start_up(free_run(0x1C32)).start_up(free_run(0x1C33));
    let begin = begin + Duration::from_secs(10);
    let builder = Network::builder().link(line.wire_from(begin));
    Rig::start(builder.drive(0, drive)).unwrap().shutdown();
}

#[test]
fn a_drive_has_surely_seen_a_word_after_two_pulses() {
    // Its own cycle is no longer than SYNC0's, and it may look at its outputs at each pulse alone.
    for (sync0, least) in [(MS, 2 * MS), (8 * MS, 16 * MS)] {
        let line = Line::new(Segment::new().with(Servo::sigma7().build()));
        let drive = DriveConfig::new(drives::sigma7())
            .axis("x")
            .dc(DistributedClock::new(0x0300).sync0_cycle(sync0));
        let builder = Network::builder().link(line.wire()).drive(0, drive);
        let mut rig = Rig::start(builder).unwrap();
        let axis = rig.net().axis("x").unwrap();
        rig.until(axis.enable()).unwrap();
        rig.run_for(200 * MS);
        let asked = rig.bus.now();
        rig.until(axis.halt()).unwrap();
        let took = rig.bus.now() - asked;
        assert!(
            took >= least && took <= least + 4 * MS,
            "{sync0:?}: {took:?}"
        );
        rig.shutdown();
    }
}

#[test]
fn a_reference_that_nobody_can_follow_keeps_the_line_from_op() {
    let line = Line::new(Segment::new().with(insisting(MS, 5_000.0, 0)));
    let builder = Network::builder().link(line.wire()).drive(0, named("x"));
    let error = Rig::start(builder).err().unwrap();
    let NetworkError::NotLocked {
        reference: ReferenceClock::Heard,
        phase_error_ns,
        bound,
        ..
    } = error
    else {
        panic!("{error}");
    };
    assert!(phase_error_ns.unsigned_abs() > bound.as_nanos() as u64);
    assert!(error.to_string().contains("20µs is too much"), "{error}");
}

#[test]
fn what_cannot_be_synchronised_says_why() {
    let line = Line::new(
        Segment::new()
            .with(Servo::sigma7().clock(None).build())
            .with(personality::coupler()),
    );
    let builder = Network::builder().link(line.wire()).drive(0, named("x"));
    let error = Rig::start(builder).err().unwrap();
    let NetworkError::Drive { step, error, .. } = error else {
        panic!("{error}");
    };
    assert_eq!(step, BringUpStep::Clock);
    assert!(matches!(*error, DriveFault::NoClock), "{error}");

    let wrong = DriveConfig::new(drives::sigma7())
        .axis("x")
        .dc(DistributedClock::new(0x0300).shift(MS));
    let error = Rig::start(Network::builder().link(line.wire()).drive(0, wrong)).err();
    let text = error.unwrap().to_string();
    assert!(text.contains("not less than its cycle"), "{text}");
}

#[test]
fn without_a_clock_an_insisting_drive_says_what_it_wants() {
    let line = Line::new(Segment::new().with(insisting(MS, 0.0, 0)));
    let drive = DriveConfig::new(drives::sigma7()).axis("x");
    let error = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).err();
    let text = error.unwrap().to_string();
    assert!(text.contains("0030h"), "{text}");
}
