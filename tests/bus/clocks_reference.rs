//! The reference clock comes back: its device was without power, and is set to the time of the cycles while axes that follow it move.

use std::{
    future::Future,
    iter,
    pin::pin,
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    DriveConfig, Failure, Network, NetworkError, Outcome, SetPoint,
    bus::{
        BringUpStep, ClockEvent, DistributedClock, DriveFault, NetworkEvent, Recovered,
        ReferenceClock,
    },
    drives,
    ds402::State,
};
use servocrab_sim::{
    AlState, ClockDemand, ClockWidth, Device, Segment,
    ds402::State as Power,
    personality::{self, Servo},
};

use crate::{
    clocks::apart,
    rig::{Line, Rig, unhomed},
};

const MS: Duration = Duration::from_millis(1);
const SECOND: Duration = Duration::from_secs(1);
/// What its clock shows at first, and after its power was back.
const FIRST: u64 = 5_000_000_000;
const AGAIN: u64 = 77;

/// A drive that complains where outputs come further from the middle of the cycle than a lock allows.
fn strict(ppm: f64, start: u64, width: ClockWidth) -> Device {
    let mut drive = Servo::sigma7()
        .clock(Some(width))
        .insists_on_clock(ClockDemand {
            before: 480 * MS / 1_000,
            after: 480 * MS / 1_000,
            lock_pulses: 10,
            fault: Some(0xFF06),
        })
        .change(|behaviour| behaviour.period = MS)
        .build();
    drive.set_clock(start, ppm);
    drive
}

fn synchronised(axis: &str) -> DriveConfig {
    unhomed(drives::sigma7(), &[axis]).dc(DistributedClock::new(0x0300))
}

/// The reference `x`, and `y` and `z` behind it, with crystals that are so much too fast.
fn started([reference, second, third]: [f64; 3], width: ClockWidth) -> (Line, Rig) {
    let mut segment = Segment::new().with(strict(reference, FIRST, width));
    segment.push(strict(second, 1_234, ClockWidth::Bits64));
    segment.push(strict(third, 1 << 40, ClockWidth::Bits64));
    segment.set_delay(1, Duration::from_nanos(900));
    segment.set_delay(2, Duration::from_nanos(1_700));
    let line = Line::new(segment);
    let builder = Network::builder()
        .link(line.wire())
        .drive(0, synchronised("x"));
    let builder = builder.drive(1, synchronised("y"));
    let rig = Rig::start(builder.drive(2, synchronised("z"))).unwrap();
    (line, rig)
}

/// Its power is gone for so short a time that frames still pass. What its clock showed it has forgotten.
fn power_blinks(line: &Line, now: Duration, start: u64, ppm: f64) {
    let mut segment = line.segment();
    let reference = segment.device_mut(0).unwrap();
    reference.power_off();
    reference.power_on(now);
    reference.set_clock(start, ppm);
}

fn of_followers(line: &Line) -> u64 {
    let segment = line.segment();
    segment.devices()[1..]
        .iter()
        .map(Device::sync_mistakes)
        .sum()
}

fn clock_events(rig: &Rig) -> Vec<ClockEvent> {
    let events = rig.net().events();
    let told = iter::from_fn(|| events.try_next());
    told.filter_map(|event| match event {
        NetworkEvent::Clock { event, .. } => Some(event),
        _ => None,
    })
    .collect()
}

fn reference(rig: &Rig) -> ReferenceClock {
    rig.net().statistics().clock.unwrap().reference
}

fn all_agree(line: &Line, rig: &mut Rig) {
    // The drives average the speed of a crystal that was replaced over 4096 cycles.
    rig.run_for(15 * SECOND);
    for _ in 0..20 {
        rig.run_for(100 * MS);
        let apart = apart(&line.segment(), rig.bus.now());
        assert!(apart < 200, "{apart} ns apart");
    }
    let segment = line.segment();
    let mut devices = segment.devices().iter();
    assert!(devices.all(|device| device.al_state() == AlState::Op));
}

#[test]
fn a_moving_follower_loses_no_cycle_while_the_reference_comes_back() {
    // The same crystal, and one that was replaced; a clock of 32 bits, too.
    for (before, after, width) in [
        (100.0, 100.0, ClockWidth::Bits64),
        (100.0, -100.0, ClockWidth::Bits64),
        (-50.0, 50.0, ClockWidth::Bits32),
    ] {
        let (line, mut rig) = started([before, -100.0, 30.0], width);
        // Longer than the low half of the times lasts.
        rig.run_for(5 * SECOND);
        let x = rig.net().axis("x").unwrap();
        rig.until(x.enable()).unwrap();
        let (_mode, motion) = rig.starts_a_long_move("y");
        rig.run_for(200 * MS);
        assert_eq!(clock_events(&rig), []);
        let mistakes = of_followers(&line);
        power_blinks(&line, rig.bus.now(), AGAIN, after);
        rig.run_for(300 * MS);
        assert_eq!(clock_events(&rig), [ClockEvent::Silent]);
        let recovered = rig.recover(0).unwrap();
        let from = None;
        assert_eq!(recovered, Recovered::BroughtUp { position: 0, from });
        assert_eq!(clock_events(&rig), [ClockEvent::InStep]);
        assert_eq!(reference(&rig), ReferenceClock::Heard);
        assert_eq!(
            of_followers(&line),
            mistakes,
            "each SYNC0 was within the bound"
        );
        // Its own axis is back without power, and does not know where it is.
        assert!(x.status().state != State::OperationEnabled && !x.status().referenced);
        let state = line.segment().axis(0, 0).unwrap().state();
        assert_ne!(state, Power::OperationEnabled);
        all_agree(&line, &mut rig);
        assert_eq!(of_followers(&line), mistakes);
        assert!(line.segment().axis(1, 0).unwrap().velocity() > 0.0);
        assert!(rig.net().statistics().clock.unwrap().locked);
        let moved = rig.moved("x", 2_000);
        assert!(matches!(moved, Outcome::Reached { .. }), "{moved:?}");
        drop(motion);
        rig.shutdown();
    }
}

#[test]
fn power_that_is_lost_again_at_any_step_leaves_the_others_in_step() {
    let (line, mut rig) = started([100.0, -100.0, 30.0], ClockWidth::Bits64);
    let (_mode, _motion) = rig.starts_a_long_move("y");
    rig.run_for(SECOND);
    let mistakes = of_followers(&line);
    power_blinks(&line, rig.bus.now(), AGAIN, 100.0);
    let mut was_done = false;
    for step in 0..60 {
        let net = rig.net.take().unwrap();
        let after = rig.bus.now() + 7 * MS * step * step / 8;
        let result = {
            let mut recovery = pin!(net.recover(0));
            let early = until_then(&mut rig, recovery.as_mut(), after);
            power_blinks(&line, rig.bus.now(), AGAIN << (step % 40), 100.0);
            was_done = early.is_some();
            early.unwrap_or_else(|| rig.until(recovery))
        };
        rig.net = Some(net);
        // What it has not begun with has not begun anew.
        assert!(was_done || step < 3 || result.is_err(), "{step}");
        rig.run_for(80 * MS);
        assert_eq!(of_followers(&line), mistakes, "{step}");
        if was_done {
            break;
        }
    }
    assert!(was_done);
    rig.recover(0).unwrap();
    all_agree(&line, &mut rig);
    assert_eq!(of_followers(&line), mistakes);
    assert!(line.segment().axis(1, 0).unwrap().velocity() > 0.0);
    rig.shutdown();
}

#[test]
fn a_reference_whose_power_blinks_while_another_learns_its_time_takes_nobody_along() {
    let (line, mut rig) = started([100.0, -100.0, 30.0], ClockWidth::Bits64);
    let (_mode, _motion) = rig.starts_a_long_move("y");
    rig.run_for(SECOND);
    let mistakes = || line.segment().device(1).unwrap().sync_mistakes();
    let before = mistakes();
    let mut segment = line.segment();
    let last = segment.device_mut(2).unwrap();
    last.power_off();
    last.power_on(rig.bus.now());
    drop(segment);
    rig.run_for(100 * MS);
    let net = rig.net.take().unwrap();
    let after = rig.bus.now() + 100 * MS;
    {
        let mut recovery = pin!(net.recover(2));
        assert!(until_then(&mut rig, recovery.as_mut(), after).is_none());
        power_blinks(&line, rig.bus.now(), AGAIN, 100.0);
        let error = rig.until(recovery).unwrap_err();
        assert!(error.to_string().contains("did not answer"), "{error}");
    }
    rig.net = Some(net);
    rig.run_for(SECOND);
    assert_eq!(mistakes(), before);
    for position in [2, 0] {
        rig.recover(position).unwrap();
    }
    all_agree(&line, &mut rig);
    assert_eq!(mistakes(), before);
    rig.shutdown();
}

/// What the future gives until then.
fn until_then<T>(
    rig: &mut Rig,
    mut future: std::pin::Pin<&mut impl Future<Output = T>>,
    end: Duration,
) -> Option<T> {
    let mut context = Context::from_waker(Waker::noop());
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return Some(value);
        }
        if rig.bus.now() >= end {
            return None;
        }
        assert!(rig.bus.turn());
    }
}

#[test]
fn a_follower_that_cannot_bear_the_step_is_named_and_nothing_is_switched() {
    let mut segment = Segment::new().with(personality::sigma7());
    segment.push(personality::sigma7());
    segment.device_mut(0).unwrap().set_clock(FIRST, 0.0);
    segment.device_mut(1).unwrap().set_clock(0, 0.0);
    let line = Line::new(segment);
    let builder = Network::builder().link(line.wire());
    let builder = builder.drive(0, synchronised("x"));
    let mut rig = Rig::start(builder.drive(1, synchronised("y"))).unwrap();
    let y = rig.net().axis("y").unwrap();
    rig.until(y.enable()).unwrap();
    power_blinks(&line, rig.bus.now(), AGAIN, 0.0);
    // More than it makes up for before it is looked at.
    let mut segment = line.segment();
    segment.device_mut(1).unwrap().set_clock(3_000_000, 0.0);
    drop(segment);
    for _ in 0..2 {
        let error = rig.recover(0).unwrap_err();
        let NetworkError::Drive { drive, step, error } = error else {
            panic!("{error}");
        };
        assert_eq!((drive.position, step), (1, BringUpStep::Clock));
        let DriveFault::ClockStep { axis, by_ns, bound } = *error else {
            panic!("{error}");
        };
        assert_eq!((axis.as_str(), bound), ("y", MS / 50));
        assert!((20_000..3_000_000).contains(&by_ns), "{by_ns}");
        rig.run_for(100 * MS);
        assert_eq!(reference(&rig), ReferenceClock::Silent);
        assert_eq!(y.status().state, State::OperationEnabled);
    }
    rig.until(y.disable()).unwrap();
    rig.recover(0).unwrap();
    assert_eq!(reference(&rig), ReferenceClock::Heard);
    rig.run_for(5 * SECOND);
    all_agree(&line, &mut rig);
    rig.shutdown();
}

#[test]
fn a_reference_that_is_not_synchronised_itself_comes_back_as_well() {
    let mut segment = Segment::new().with(personality::sigma7());
    segment.push(strict(100.0, 1_234, ClockWidth::Bits64));
    segment.device_mut(0).unwrap().set_clock(FIRST, 0.0);
    let line = Line::new(segment);
    let builder = Network::builder().link(line.wire());
    let builder = builder.drive(0, unhomed(drives::sigma7(), &["r"]));
    let mut rig = Rig::start(builder.drive(1, synchronised("y"))).unwrap();
    let y = rig.net().axis("y").unwrap();
    let motion = rig.until(async {
        y.enable().await.unwrap();
        let mode = y.profile_position().await.unwrap();
        let set_point = SetPoint::new().velocity(10_000);
        mode.move_abs(20_000, set_point).await.unwrap()
    });
    let mistakes = of_followers(&line);
    power_blinks(&line, rig.bus.now(), AGAIN, 0.0);
    // At once: that it is silent is not known yet.
    rig.recover(0).unwrap();
    rig.run_for(70 * MS);
    assert_eq!(reference(&rig), ReferenceClock::Heard);
    let outcome = rig.until(motion.done()).unwrap();
    assert!(matches!(outcome, Outcome::Reached { .. }), "{outcome:?}");
    all_agree(&line, &mut rig);
    assert_eq!(of_followers(&line), mistakes);
    rig.shutdown();
}

#[test]
fn drives_that_were_without_power_with_the_reference_come_back_in_any_order() {
    let (line, mut rig) = started([100.0, -100.0, 30.0], ClockWidth::Bits64);
    rig.run_for(SECOND);
    for position in 0..3 {
        line.segment().device_mut(position).unwrap().power_off();
    }
    rig.run_for(300 * MS);
    let now = rig.bus.now();
    for position in 0..3 {
        let mut segment = line.segment();
        let device = segment.device_mut(position).unwrap();
        device.power_on(now);
        device.set_clock(AGAIN << (10 * position), 100.0);
    }
    rig.run_for(100 * MS);
    for position in [2, 0, 1] {
        rig.recover(position).unwrap();
    }
    rig.run_for(100 * MS);
    all_agree(&line, &mut rig);
    for axis in ["x", "y", "z"] {
        let moved = rig.moved(axis, 2_000);
        assert!(matches!(moved, Outcome::Reached { .. }), "{moved:?}");
    }
    rig.shutdown();
}

#[test]
fn a_reference_that_was_unplugged_with_its_power_on_is_followed_by_itself() {
    // In front of it frames come back without it.
    let segment = Segment::new().with(Servo::sigma7().clock(None).build());
    let segment = segment.with(strict(100.0, FIRST, ClockWidth::Bits64));
    let line = Line::new(segment);
    let builder = Network::builder().link(line.wire());
    let mut rig = Rig::start(builder.drive(1, synchronised("x"))).unwrap();
    rig.run_for(SECOND);
    line.segment().unplug(1);
    rig.run_for(200 * MS);
    let error = rig.recover(1).unwrap_err();
    assert!(matches!(error, NetworkError::WrongLine(_)), "{error}");
    line.segment().plug();
    rig.run_for(200 * MS);
    assert_eq!(clock_events(&rig), [ClockEvent::Silent, ClockEvent::InStep]);
    rig.shutdown();
}

#[test]
fn a_reference_that_has_jumped_is_not_followed_again() {
    let (line, mut rig) = started([100.0, -100.0, 30.0], ClockWidth::Bits64);
    let y = rig.net().axis("y").unwrap();
    rig.until(y.enable()).unwrap();
    let mut segment = line.segment();
    segment.device_mut(0).unwrap().set_clock(AGAIN, 100.0);
    drop(segment);
    rig.run_for(SECOND);
    assert_eq!(reference(&rig), ReferenceClock::Jumped);
    power_blinks(&line, rig.bus.now(), AGAIN, 100.0);
    let error = rig.recover(0).unwrap_err();
    let NetworkError::NotLocked {
        reference: shown, ..
    } = error
    else {
        panic!("{error}");
    };
    assert_eq!(shown, ReferenceClock::Jumped);
    rig.run_for(SECOND);
    assert_eq!(reference(&rig), ReferenceClock::Jumped);
    let refused = rig.until(y.enable()).unwrap_err();
    assert_eq!(refused.failure(), Some(Failure::ClockJumped));
    rig.shutdown();
}
