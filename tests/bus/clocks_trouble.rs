//! Distributed clocks in trouble: a reference clock that jumps, is gone, was switched off and on, or does not run.

use std::{
    iter,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use servocrab::{
    AxisConfig, DriveConfig, Failure, Network, NetworkError, Referencing, SetPoint,
    axis::Loss,
    bus::{
        ClockEvent, ClockStatistics, DistributedClock, DriveFault, NetworkBuilder, NetworkEvent,
        ReferenceClock,
    },
    drives,
    link::{Fate, Wire},
};
use servocrab_sim::{AlState, Segment, ds402::State as Power, personality::Servo};

use crate::{
    clocks::{insisting, mistakes},
    rig::{Line, Rig, TAG, TAG_BYTES, is_cyclic},
};

const MS: Duration = Duration::from_millis(1);
const REFERENCE_PPM: f64 = 50.0;
/// By which byte of the frame the datagram with the reference's time begins, and where the time ends.
const DATAGRAM: usize = TAG + TAG_BYTES;
const TIME_END: usize = DATAGRAM + 10 + 4;
const SLOW: SetPoint = SetPoint::new()
    .velocity(10_000)
    .acceleration(100_000)
    .deceleration(100_000);

/// A reference that is no drive of the network, and two drives behind it that insist on outputs in time.
fn behind_a_reference() -> Line {
    let mut reference = Servo::sigma7().build();
    reference.set_clock(START, REFERENCE_PPM);
    Line::new(
        Segment::new()
            .with(reference)
            .with(insisting(MS, -100.0, 77))
            .with(insisting(MS, 100.0, 1 << 40)),
    )
}

/// Of the reference's clock.
const START: u64 = 90_000_000_000;

fn network(wire: Wire) -> NetworkBuilder {
    let drive = |axis: &str| {
        DriveConfig::new(drives::sigma7())
            .axis(AxisConfig::new(axis).referencing(Referencing::UnreferencedMovesAllowed))
            .dc(DistributedClock::new(0x0300))
    };
    Network::builder()
        .link(wire)
        .drive(1, drive("y"))
        .drive(2, drive("z"))
}

/// In OP and for some time in step.
fn running(line: &Line) -> Rig {
    let mut rig = Rig::start(network(line.wire())).unwrap();
    rig.run_for(Duration::from_secs(1));
    rig
}

fn jump(line: &Line, by: i64) {
    let mut segment = line.segment();
    let reference = segment.device_mut(0).unwrap();
    reference.set_clock(START.wrapping_add_signed(by), REFERENCE_PPM);
}

fn clock(rig: &Rig) -> ClockStatistics {
    rig.net().statistics().clock.unwrap()
}

/// How far the clocks of the two drives are apart.
fn apart(line: &Line, now: Duration) -> u64 {
    let segment = line.segment();
    let time = |position| segment.device(position).unwrap().system_time(now);
    time(1).abs_diff(time(2))
}

fn clock_events(rig: &Rig) -> Vec<ClockEvent> {
    let events = rig.net().events();
    let told = iter::from_fn(|| events.try_next());
    told.filter_map(|event| match event {
        NetworkEvent::Clock { reference, event } => {
            assert_eq!(reference.position, 0);
            Some(event)
        }
        _ => None,
    })
    .collect()
}

#[test]
fn a_reference_that_jumps_is_followed_by_nobody_and_all_axes_stop() {
    // As after its power was gone; further than 32 bits can tell; a little more than half a cycle.
    for by in [-(START as i64), 11_000_000_000, 700_000] {
        let line = behind_a_reference();
        let mut rig = running(&line);
        let (y, z) = (rig.net().axis("y").unwrap(), rig.net().axis("z").unwrap());
        rig.until(y.enable()).unwrap();
        rig.until(z.enable()).unwrap();
        let motion = rig.until(async {
            let mode = y.profile_position().await.unwrap();
            mode.move_abs(1_000_000, SLOW).await.unwrap()
        });
        rig.run_for(200 * MS);
        let before = mistakes(&line);
        jump(&line, by);
        let ended = rig.until(motion.done()).unwrap_err();
        assert_eq!(ended.failure(), Some(Failure::ClockJumped), "{by}");
        rig.run_for(Duration::from_secs(1));
        let told = clock_events(&rig);
        let [ClockEvent::Jumped { by_ns }] = told[..] else {
            panic!("{by}: {told:?}");
        };
        let wraps = (by - by_ns) as f64 / f64::from(u32::MAX);
        assert!((wraps - wraps.round()).abs() < 1e-5, "{by}: {by_ns}");
        let seen = clock(&rig);
        assert_eq!(
            (seen.locked, seen.reference),
            (false, ReferenceClock::Jumped)
        );
        for position in [1, 2] {
            let segment = line.segment();
            let axis = segment.axis(position, 0).unwrap();
            let off = [Power::SwitchOnDisabled, Power::ReadyToSwitchOn];
            assert!(off.contains(&axis.state()), "{:?}", axis.state());
            assert_eq!(axis.velocity(), 0.0);
        }
        let refused = rig.until(y.enable()).unwrap_err();
        assert_eq!(refused.failure(), Some(Failure::ClockJumped), "{by}");
        // A drive that is led back would have to follow it.
        line.segment()
            .device_mut(2)
            .unwrap()
            .fall_to_safe_op(0x001B);
        rig.run_for(50 * MS);
        let asked = rig.bus.now();
        let error = not_led_back(&mut rig, 2);
        let NetworkError::NotLocked { reference, .. } = error else {
            panic!("{error}");
        };
        assert_eq!(reference, ReferenceClock::Jumped);
        assert!(error.to_string().contains("start it again"), "{error}");
        assert!(rig.bus.now() - asked < 100 * MS, "it is not waited for");
        // The drives' own clocks go on together, and the frames with them.
        let apart = apart(&line, rig.bus.now());
        assert!(apart < 10_000, "{by}: {apart} ns apart");
        assert_eq!(mistakes(&line), before, "{by}");
        let state = |position| line.segment().device(position).unwrap().al_state();
        assert_eq!([1, 2].map(state), [AlState::Op, AlState::SafeOp]);
        rig.shutdown();
    }
}

#[test]
fn an_axis_that_is_silent_when_the_reference_jumps_is_disabled_when_it_answers_again() {
    let mut reference = Servo::sigma7().build();
    reference.set_clock(START, REFERENCE_PPM);
    // It has a watchdog alone, and outlives a silence that one with a clock does not.
    let segment = Segment::new()
        .with(reference)
        .with(insisting(MS, 0.0, 77))
        .with(Servo::sigma7().build());
    let line = Line::new(segment);
    // A quick stop leaves it holding.
    line.segment()
        .axis_mut(2, 0)
        .unwrap()
        .set(0x605A, 0, 6)
        .unwrap();
    let without_clock =
        DriveConfig::new(drives::sigma7()).axis(AxisConfig::new("z").loss(Loss::default()));
    let with_clock = DriveConfig::new(drives::sigma7())
        .axis(AxisConfig::new("y"))
        .dc(DistributedClock::new(0x0300));
    let builder = Network::builder()
        .link(line.wire())
        .drive(1, with_clock)
        .drive(2, without_clock);
    let mut rig = Rig::start(builder).unwrap();
    rig.run_for(Duration::from_secs(1));
    let z = rig.net().axis("z").unwrap();
    rig.until(z.enable()).unwrap();
    line.segment().unplug(2);
    rig.run_for(40 * MS);
    assert!(z.status().lost, "{:?}", z.status());
    jump(&line, 11_000_000_000);
    // Shorter than the watchdog of the drive, which would take the power away.
    rig.run_for(40 * MS);
    assert_eq!(clock_events(&rig).len(), 1);
    line.segment().plug();
    rig.run_for(Duration::from_secs(1));
    let device = line.segment().device(2).unwrap().al_state();
    assert_eq!(device, AlState::Op);
    let state = line.segment().axis(2, 0).unwrap().state();
    let off = [Power::SwitchOnDisabled, Power::ReadyToSwitchOn];
    assert!(off.contains(&state), "{state:?}");
    rig.shutdown();
}

/// Why the drive at this position could not be led back.
fn not_led_back(rig: &mut Rig, position: u16) -> NetworkError {
    let net = rig.net.take().unwrap();
    let error = rig.until(net.recover(position)).unwrap_err();
    rig.net = Some(net);
    error
}

#[test]
fn a_reference_that_jumps_by_less_than_half_a_cycle_is_followed_again_within_half_a_second() {
    for by in [300_000, -300_000] {
        let line = behind_a_reference();
        let mut rig = running(&line);
        let before = mistakes(&line);
        jump(&line, by);
        rig.run_for(500 * MS);
        let told = clock_events(&rig);
        assert!(
            matches!(told[..], [ClockEvent::OutOfStep { .. }, ClockEvent::InStep]),
            "{told:?}"
        );
        rig.run_for(Duration::from_secs(2));
        assert!(clock(&rig).phase_error_ns.abs() < 100);
        assert_eq!(mistakes(&line), before);
        rig.shutdown();
    }
}

#[test]
fn a_time_that_was_spoiled_on_its_way_moves_nothing() {
    let line = behind_a_reference();
    let spoiled = Arc::new(AtomicUsize::new(0));
    let left = Arc::clone(&spoiled);
    let wire = line.wire_with(move |_, frame| {
        // FRMW.
        let has_time = is_cyclic(frame) && frame[DATAGRAM] == 14;
        let next = |left: usize| left.checked_sub(1);
        if has_time
            && left
                .fetch_update(Ordering::Relaxed, Ordering::Relaxed, next)
                .is_ok()
        {
            // The highest byte: hours of 32 bits off.
            Fate::Corrupt(TIME_END - 1)
        } else {
            Fate::Deliver
        }
    });
    let mut rig = Rig::start(network(wire)).unwrap();
    rig.run_for(Duration::from_secs(2));
    let before = mistakes(&line);
    spoiled.store(7, Ordering::Relaxed);
    rig.run_for(8 * MS);
    assert_eq!(spoiled.load(Ordering::Relaxed), 0);
    let seen = clock(&rig);
    assert!(seen.phase_error_ns.abs() < 100, "{seen:?}");
    rig.run_for(200 * MS);
    assert!(clock(&rig).locked);
    assert_eq!(mistakes(&line), before);
    rig.shutdown();
}

#[test]
fn a_reference_that_was_switched_off_and_on_gives_no_time_and_the_others_follow_the_cycles() {
    let line = behind_a_reference();
    let mut rig = running(&line);
    rig.loses_power(&line, 0);
    rig.run_for(200 * MS);
    // It is there, and has lost its station address: it takes the time as all others do.
    assert_eq!(clock_events(&rig), [ClockEvent::Silent]);
    let seen = clock(&rig);
    assert_eq!(
        (seen.locked, seen.reference),
        (false, ReferenceClock::Silent)
    );
    let before = mistakes(&line);
    for _ in 0..5 {
        rig.run_for(Duration::from_secs(1));
        let apart = apart(&line, rig.bus.now());
        assert!(apart < 200, "{apart} ns apart");
    }
    // They have left OP, but SYNC0 comes where it came, and outputs in time before it.
    assert_eq!(mistakes(&line), before);
    assert_eq!(clock_events(&rig), []);
    // Whichever drive is brought back needs it, and it need not be one of the network.
    rig.recover(1).unwrap();
    rig.recover(2).unwrap();
    assert_eq!(clock_events(&rig), [ClockEvent::InStep]);
    rig.run_for(Duration::from_secs(1));
    let apart = apart(&line, rig.bus.now());
    assert!(apart < 200, "{apart} ns apart");
    assert_eq!(mistakes(&line), before);
    assert_eq!(line.segment().devices()[0].al_state(), AlState::Init);
    rig.shutdown();
}

#[test]
fn a_line_that_is_gone_for_a_while_finds_the_cycles_in_step() {
    let line = behind_a_reference();
    let mut rig = running(&line);
    line.segment().unplug(0);
    rig.run_for(Duration::from_secs(10));
    assert_eq!(clock_events(&rig), [ClockEvent::Silent]);
    line.segment().plug();
    rig.run_for(5 * MS);
    let seen = clock(&rig);
    assert!(seen.phase_error_ns.abs() < 2_000, "{seen:?}");
    rig.run_for(200 * MS);
    assert_eq!(clock_events(&rig), [ClockEvent::InStep]);
    rig.shutdown();
}

#[test]
fn a_clock_that_stands_still_is_named_at_the_bring_up() {
    const STOPPED: f64 = -1_000_000.0;
    let mut drive = Servo::sigma7().build();
    drive.set_clock(5, STOPPED);
    let line = Line::new(Segment::new().with(Servo::sigma7().build()).with(drive));
    let z = DriveConfig::new(drives::sigma7())
        .axis("z")
        .dc(DistributedClock::new(0x0300));
    let builder = Network::builder().link(line.wire()).drive(1, z.clone());
    let Some(NetworkError::Drive { drive, error, .. }) = Rig::start(builder).err() else {
        panic!("nothing was noticed");
    };
    assert_eq!(drive.position, 1);
    assert!(matches!(*error, DriveFault::ClockApart { .. }), "{error}");
    // And as the reference.
    line.segment().device_mut(1).unwrap().set_clock(5, 0.0);
    line.segment().device_mut(0).unwrap().set_clock(5, STOPPED);
    let builder = Network::builder().link(line.wire()).drive(1, z);
    let text = Rig::start(builder).err().unwrap().to_string();
    assert!(text.contains("that of drive 0 \"SGD7S\""), "{text}");
    assert!(text.contains("stands still"), "{text}");
}
