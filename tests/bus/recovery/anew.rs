//! Drives that were without power: brought up anew, as at the start.

use std::{
    future::Future,
    pin::pin,
    sync::{Arc, Mutex},
    task::{Context, Waker},
    time::Duration,
};

use servocrab::{
    axis::{Axis, Failure, Referencing},
    bus::{
        AlState as State, AlStatus, AxisConfig, BringUpStep, DistributedClock, DriveConfig,
        Network, Recovered, ReferenceClock,
    },
    coe::{ObjectAddress, obj},
    drives,
    homing::{HomingMethod, HomingParameters},
    parameters::{StartUpWrite, Transition},
    profile_position::{Outcome, SetPoint},
};
use servocrab_sim::{
    AlState, Segment,
    ds402::{Machine, ReachedPolicy},
    personality::{self, Servo},
};

use super::{
    MIDDLE, MS, Yard, is_over, kinds, servo_with_parameters_by_sdo, set_point, unhomed,
    with_parameters_by_sdo,
};
use crate::rig::{Line, Rig};

const ANEW: Recovered = Recovered::BroughtUp {
    position: 1,
    from: None,
};

#[test]
fn a_drive_that_lost_its_power_while_its_axes_moved_is_brought_up_and_nothing_moves_by_it() {
    for (device, description, axes) in kinds() {
        let name = description.name.clone();
        let mut yard = Yard::new(device, unhomed(description, axes));
        let moves: Vec<_> = axes.iter().map(|axis| yard.start(axis)).collect();
        yard.loses_power(300 * MS);
        let mut modes = Vec::new();
        for (mode, motion) in moves {
            let outcome = yard.rig.until(motion.done());
            assert!(is_over(&outcome), "{name}: {outcome:?}");
            modes.push(mode);
        }
        assert_eq!(yard.state(MIDDLE), AlState::Init);
        yard.nothing_may_happen();
        assert_eq!(yard.recover(1).unwrap(), ANEW, "{name}");
        assert_eq!(yard.state(MIDDLE), AlState::Op);
        yard.nothing_has_happened();
        // What stood behind it was cut off, and has fallen by its watchdog.
        yard.undisturbed = yard.counters();
        let rear = yard.recover(2).unwrap();
        assert!(
            matches!(rear, Recovered::FromSafeOp { from } if from.error == Some(0x001B)),
            "{name}: {rear}"
        );
        assert_eq!(yard.undisturbed, yard.counters());
        drop(modes);
        for axis in axes {
            yard.works_again(axis);
        }
        yard.rig.moved("a", 500);
        yard.ends();
    }
}

#[test]
fn what_was_homed_is_not_known_any_more_and_what_an_absolute_encoder_tells_is() {
    for (referencing, known) in [
        (Referencing::ByHoming, false),
        (Referencing::AbsoluteEncoder, true),
    ] {
        let drive =
            DriveConfig::new(drives::akd2g()).axis(AxisConfig::new("z").referencing(referencing));
        let mut yard = Yard::new(personality::akd2g(), drive);
        let z = yard.is_homed_here("z", 700);
        yard.loses_power(300 * MS);
        yard.recover(1).unwrap();
        assert_eq!(z.status().referenced, known);
        // Nor does a drive that keeps its power later bring back what one without power has lost.
        yard.falls(0x001B);
        yard.recover(1).unwrap();
        yard.rig.run_for(2 * MS);
        assert_eq!(z.status().referenced, known);
        if !known {
            let refused = yard.rig.until(async {
                z.enable().await.unwrap();
                let mode = z.profile_position().await.unwrap();
                mode.move_abs(700, super::set_point()).await.unwrap_err()
            });
            assert_eq!(refused.failure(), Some(Failure::NotReferenced));
        }
        yard.ends();
    }
}

#[test]
fn start_up_lists_are_written_again_and_what_the_program_wrote_later_is_gone() {
    let drive = unhomed(drives::generic(), &["z"])
        .start_up(StartUpWrite::new(obj::POSITION_WINDOW, 33))
        .start_up(StartUpWrite::new(obj::QUICK_STOP_DECELERATION, 77_000));
    let mut yard = Yard::new(personality::generic(), drive);
    let sdo = yard.rig.net().sdo(1).unwrap();
    yard.rig.until(async {
        sdo.write(obj::POSITION_WINDOW, 44).await.unwrap();
        sdo.write(obj::PROFILE_VELOCITY, 4_321).await.unwrap();
    });
    yard.loses_power(300 * MS);
    yard.recover(1).unwrap();
    let (window, ramp, velocity) = yard.rig.until(async {
        (
            sdo.read(obj::POSITION_WINDOW).await.unwrap(),
            sdo.read(obj::QUICK_STOP_DECELERATION).await.unwrap(),
            sdo.read(obj::PROFILE_VELOCITY).await.unwrap(),
        )
    });
    assert_eq!((window, ramp), (33, 77_000));
    assert_ne!(velocity, 4_321);
    yard.works_again("z");
    yard.ends();
}

#[test]
fn each_step_is_told_as_at_the_start() {
    let told = Arc::new(Mutex::new(Vec::new()));
    let telling = Arc::clone(&told);
    let mut yard = Yard::with(
        personality::generic(),
        unhomed(drives::generic(), &["z"]),
        move |line| {
            Network::builder().link(line.wire()).on_progress(move |at| {
                let step = (at.drive.position, at.step, at.done, at.total);
                telling.lock().unwrap().push(step);
            })
        },
    );
    told.lock().unwrap().clear();
    yard.loses_power(300 * MS);
    yard.recover(1).unwrap();
    let steps = [
        BringUpStep::Identity,
        BringUpStep::StartUpList,
        BringUpStep::Mapping,
        BringUpStep::Watchdog,
        BringUpStep::State(State::SafeOp),
        BringUpStep::Parameters,
        BringUpStep::State(State::Op),
    ];
    let expected = steps.into_iter().zip(1..);
    let expected: Vec<_> = expected.map(|(step, done)| (1, step, done, 7)).collect();
    assert_eq!(*told.lock().unwrap(), expected);
    yard.ends();
}

#[test]
fn a_drive_that_went_back_to_init_or_preop_by_itself_is_brought_up_from_there() {
    for (falls_to, seen) in [(AlState::Init, State::Init), (AlState::PreOp, State::PreOp)] {
        let mut yard = Yard::new(personality::akd2g(), unhomed(drives::akd2g(), &["z", "w"]));
        let (mode, motion) = yard.start("z");
        let mut segment = yard.line.segment();
        segment
            .device_mut(MIDDLE)
            .unwrap()
            .fall_to(falls_to, 0x8001);
        drop(segment);
        yard.rig.run_for(700 * MS);
        assert!(is_over(&yard.rig.until(motion.done())));
        drop(mode);
        yard.nothing_may_happen();
        let recovered = yard.recover(1).unwrap();
        let from = Some(AlStatus {
            state: seen,
            error: Some(0x8001),
        });
        assert_eq!(recovered, Recovered::BroughtUp { position: 1, from });
        yard.nothing_has_happened();
        yard.works_again("z");
        yard.works_again("w");
        yard.ends();
    }
}

#[test]
fn a_move_that_leaves_its_velocity_out_has_none_of_before_a_drive_that_kept_its_power_was_brought_up()
 {
    // By SDO, and with the process data.
    for (drive, description) in [
        with_parameters_by_sdo(),
        (personality::generic(), drives::generic()),
    ] {
        let mut yard = Yard::new(drive, unhomed(description, &["z"]));
        let z = yard.axis("z");
        let sdo = yard.rig.net().sdo(1).unwrap();
        let velocity = async || sdo.read(obj::PROFILE_VELOCITY).await.unwrap();
        let go = async |target, set_point| {
            z.enable().await.unwrap();
            let mode = z.profile_position().await.unwrap();
            mode.move_abs(target, set_point).await.unwrap().done().await
        };
        let (held, written) = yard.rig.until(async {
            let held = velocity().await;
            go(500, SetPoint::new().velocity(held / 2)).await.unwrap();
            (held, velocity().await)
        });
        assert_eq!(written, held / 2);
        let mut segment = yard.line.segment();
        let device = segment.device_mut(MIDDLE).unwrap();
        device.fall_to(AlState::PreOp, 0x8001);
        drop(segment);
        yard.rig.run_for(300 * MS);
        let kept = yard.line.segment().axis(MIDDLE, 0).unwrap().get(0x6081, 0);
        assert_eq!(kept, Some(i64::from(written)), "it has kept its power");
        yard.recover(1).unwrap();
        let after = yard.rig.until(async {
            go(1_000, SetPoint::new()).await.unwrap();
            velocity().await
        });
        assert_eq!(after, held);
        drop(sdo);
        drop(z);
        yard.ends();
    }
}

/// What a drive has in its EEPROM may be other than what it held when its axis attached: restored from a file and not stored, say.
fn loses_power_and_holds(yard: &mut Yard, object: u16, stored: i64) {
    yard.line.segment().device_mut(MIDDLE).unwrap().power_off();
    yard.rig.run_for(300 * MS);
    let now = yard.rig.bus.now();
    let mut segment = yard.line.segment();
    segment.device_mut(MIDDLE).unwrap().power_on(now);
    let axis = segment.axis_mut(MIDDLE, 0).unwrap();
    axis.set(object, 0, stored).unwrap();
    drop(segment);
    yard.rig.run_for(100 * MS);
}

#[test]
fn an_axis_that_its_drive_leads_on_at_a_stored_end_velocity_after_a_recovery_is_known_to_move() {
    let (_, description) = with_parameters_by_sdo();
    let drive = servo_with_parameters_by_sdo().change(|behaviour| {
        behaviour.goes_on_at_end_velocity = true;
        behaviour.reached = ReachedPolicy::Window;
    });
    let mut yard = Yard::new(drive.build(), unhomed(description, &["z"]));
    let z = yard.axis("z");
    let at_start = yard.line.segment().axis(MIDDLE, 0).unwrap().get(0x6082, 0);
    assert_eq!(at_start, Some(0));
    loses_power_and_holds(&mut yard, 0x6082, 5_000);
    assert_eq!(yard.recover(1).unwrap(), ANEW);
    let target = z.status().position + 10_000;
    let (mode, outcome) = yard.rig.until(async {
        z.enable().await.unwrap();
        let mode = z.profile_position().await.unwrap();
        let moved = mode.move_abs(target, set_point()).await.unwrap();
        let outcome = moved.done().await.unwrap();
        (mode, outcome)
    });
    assert!(matches!(outcome, Outcome::Reached { .. }), "{outcome:?}");
    yard.rig.run_for(300 * MS);
    let velocity = |yard: &Yard| yard.line.segment().axis(MIDDLE, 0).unwrap().velocity();
    // Either it stands, since the move left the end velocity out and the drive held 0 when the axis attached, or it is known to move.
    let moves = velocity(&yard).abs() > 1_000.0;
    let known = z.status().has_set_point;
    drop((mode, z));
    yard.rig.run_for(500 * MS);
    let after = velocity(&yard);
    assert!(
        after.abs() < 100.0,
        "moved: {moves}, known: {known}; its last handle is gone, and it goes at {after} counts/s"
    );
    yard.ends();
}

#[test]
fn a_move_that_leaves_its_velocity_out_after_a_recovery_has_that_of_the_start() {
    // With the process data, and by SDO.
    for (drive, description) in [
        (personality::generic(), drives::generic()),
        with_parameters_by_sdo(),
    ] {
        let mut yard = Yard::new(drive, unhomed(description, &["z"]));
        let z = yard.axis("z");
        let get = |yard: &Yard| yard.line.segment().axis(MIDDLE, 0).unwrap().get(0x6081, 0);
        let held = get(&yard).unwrap();
        loses_power_and_holds(&mut yard, 0x6081, 5 * held);
        assert_eq!(yard.recover(1).unwrap(), ANEW);
        yard.rig.until(async {
            z.enable().await.unwrap();
            let mode = z.profile_position().await.unwrap();
            let target = z.status().position + 1_000;
            mode.move_abs(target, SetPoint::new())
                .await
                .unwrap()
                .done()
                .await
                .unwrap();
        });
        assert_eq!(get(&yard), Some(held));
        drop(z);
        yard.ends();
    }
}

#[test]
fn a_move_that_leaves_its_velocity_out_has_none_of_a_client_beside_the_program() {
    let (drive, description) = with_parameters_by_sdo();
    let mut yard = Yard::new(drive, unhomed(description, &["z"]));
    let z = yard.axis("z");
    let beside = yard.rig.net().uncounted_axis("z").unwrap();
    let sdo = yard.rig.net().sdo(1).unwrap();
    let velocity = async || sdo.read(obj::PROFILE_VELOCITY).await.unwrap();
    let go = async |axis: &Axis, target, set_point| {
        let mode = axis.profile_position().await.unwrap();
        mode.move_abs(target, set_point).await.unwrap().done().await
    };
    let (held, of_client, of_program) = yard.rig.until(async {
        z.enable().await.unwrap();
        let held = velocity().await;
        let slow = SetPoint::new().velocity(held / 2);
        go(&beside, 500, slow).await.unwrap();
        let of_client = velocity().await;
        go(&z, 1_000, SetPoint::new()).await.unwrap();
        (held, of_client, velocity().await)
    });
    assert_eq!((of_client, of_program), (held / 2, held));
    drop((sdo, beside, z));
    yard.ends();
}

/// At the start they are read in OP, behind these lines.
#[test]
fn limits_of_start_up_lines_in_safe_op_hold_after_a_recovery_as_after_the_start() {
    let in_safe_op = |write: StartUpWrite| write.at(Transition::SafeOpToOp);
    let drive = unhomed(drives::generic(), &["z"])
        .start_up(in_safe_op(StartUpWrite::new(
            obj::SOFTWARE_LIMIT_MIN,
            -5_000,
        )))
        .start_up(in_safe_op(StartUpWrite::new(
            obj::SOFTWARE_LIMIT_MAX,
            5_000,
        )));
    let mut yard = Yard::new(personality::generic(), drive);
    let z = yard.axis("z");
    no_further_than_5000(&mut yard, &z);
    yard.loses_power(300 * MS);
    assert_eq!(yard.recover(1).unwrap(), ANEW);
    no_further_than_5000(&mut yard, &z);
    drop(z);
    yard.ends();
}

/// The drive has this limit, and a move beyond it is refused.
#[track_caller]
fn no_further_than_5000(yard: &mut Yard, z: &Axis) {
    let held = yard.line.segment().axis(MIDDLE, 0).unwrap().get(0x607D, 2);
    assert_eq!(held, Some(5_000));
    let beyond = yard.rig.until(async {
        z.enable().await.unwrap();
        let mode = z.profile_position().await.unwrap();
        mode.move_abs(8_000, set_point()).await
    });
    let failure = beyond.err().and_then(|error| error.failure());
    assert!(
        matches!(failure, Some(Failure::BeyondLimit { limit: 5_000, .. })),
        "{failure:?}"
    );
}

/// The drive falls to SAFEOP, and is led back from there.
fn is_led_back(yard: &mut Yard) {
    yard.falls(0x001B);
    let recovered = yard.recover(1).unwrap();
    assert!(
        matches!(recovered, Recovered::FromSafeOp { .. }),
        "{recovered:?}"
    );
}

/// The program has set a wider limit since the start, and a start-up line sets the narrow one again.
#[test]
fn limits_of_start_up_lines_in_safe_op_hold_after_the_drive_was_led_back_from_there() {
    let limit = StartUpWrite::new(obj::SOFTWARE_LIMIT_MAX, 5_000).at(Transition::SafeOpToOp);
    let drive = unhomed(drives::generic(), &["z"]).start_up(limit);
    let mut yard = Yard::new(personality::generic(), drive);
    let z = yard.axis("z");
    let sdo = yard.rig.net().sdo(1).unwrap();
    let limits = yard.rig.until(async {
        sdo.write(obj::SOFTWARE_LIMIT_MIN, -20_000).await.unwrap();
        sdo.write(obj::SOFTWARE_LIMIT_MAX, 20_000).await.unwrap();
        z.read_limits().await.unwrap()
    });
    assert_eq!(limits.software.map(|range| range.max), Some(20_000));
    is_led_back(&mut yard);
    no_further_than_5000(&mut yard, &z);
    drop((z, sdo));
    yard.ends();
}

#[test]
fn a_drive_whose_quick_stop_a_start_up_line_in_safe_op_sets_is_recovered_as_it_was_started() {
    let quick_stop = StartUpWrite::new(obj::QUICK_STOP_OPTION, 2).at(Transition::SafeOpToOp);
    let drive = unhomed(drives::generic(), &["z"]).start_up(quick_stop);
    let mut device = personality::generic();
    device.axis_mut(0).unwrap().set(0x605A, 0, 0).unwrap();
    let mut yard = Yard::new(device, drive);
    loses_power_and_holds(&mut yard, 0x605A, 0);
    let recovered = yard.recover(1);
    assert!(recovered.is_ok(), "{recovered:?}");
    yard.works_again("z");
    yard.ends();
}

/// A start-up line says that the drive goes on without its master. After this it stops all the same, as at the start.
fn stops_on_loss_again(recover: impl FnOnce(&mut Yard)) {
    let goes_on = StartUpWrite::new(obj::ABORT_CONNECTION_OPTION, 0).at(Transition::SafeOpToOp);
    let drive = unhomed(drives::generic(), &["z"]).start_up(goes_on);
    let mut yard = Yard::new(personality::generic(), drive);
    let held = |yard: &Yard| yard.line.segment().axis(MIDDLE, 0).unwrap().get(0x6007, 0);
    let at_start = held(&yard);
    assert_ne!(at_start, Some(0), "it is set to a value that stops");
    recover(&mut yard);
    assert_eq!(held(&yard), at_start);
    yard.works_again("z");
    yard.ends();
}

#[test]
fn a_drive_stops_on_loss_after_a_recovery_whatever_a_start_up_line_in_safe_op_says() {
    stops_on_loss_again(|yard| {
        yard.loses_power(300 * MS);
        assert_eq!(yard.recover(1).unwrap(), ANEW);
    });
}

#[test]
fn a_drive_stops_on_loss_after_it_was_led_back_from_safe_op_whatever_a_start_up_line_says() {
    stops_on_loss_again(is_led_back);
}

#[test]
fn a_request_that_the_drive_has_forgotten_in_init_holds_up_no_recovery() {
    let mut yard = Yard::new(personality::generic(), unhomed(drives::generic(), &["z"]));
    let sdo = yard
        .rig
        .net()
        .sdo(1)
        .unwrap()
        .with_timeout(Duration::from_secs(20));
    let slow = |yard: &Yard, delay| {
        let mut segment = yard.line.segment();
        segment.device_mut(MIDDLE).unwrap().set_mailbox_delay(delay);
    };
    slow(&yard, Duration::from_secs(5));
    let mut read = pin!(sdo.read(obj::VENDOR_ID));
    let mut context = Context::from_waker(Waker::noop());
    assert!(read.as_mut().poll(&mut context).is_pending());
    yard.rig.run_for(20 * MS);
    assert!(read.as_mut().poll(&mut context).is_pending());
    let mut segment = yard.line.segment();
    let device = segment.device_mut(MIDDLE).unwrap();
    device.fall_to(AlState::Init, 0x8001);
    drop(segment);
    slow(&yard, Duration::ZERO);
    yard.rig.run_for(300 * MS);
    let asked = yard.rig.bus.now();
    let recovered = yard.recover(1);
    assert!(recovered.is_ok(), "{recovered:?}");
    let took = yard.rig.bus.now() - asked;
    assert!(took < Duration::from_secs(5), "{took:?}");
    let read = yard.rig.until(read);
    assert!(read.is_err(), "{read:?}");
    yard.works_again("z");
    yard.ends();
}

/// Until its mailbox is set up a device takes a message into its memory, and nobody answers it. The recovery goes by the same mailbox.
#[test]
fn a_request_without_a_limit_holds_up_no_recovery_whenever_it_is_made() {
    for turns in 0.. {
        let line = Line::new(Segment::new().with(personality::generic()));
        let drive = unhomed(drives::generic(), &["z"]);
        let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
        let sdo = rig.net().sdo(0).unwrap().with_timeout(Duration::MAX);
        let mut segment = line.segment();
        segment
            .device_mut(0)
            .unwrap()
            .fall_to(AlState::Init, 0x8001);
        drop(segment);
        rig.run_for(100 * MS);
        let net = rig.net.take().unwrap();
        let mut read = pin!(sdo.read(obj::VENDOR_ID));
        let mut context = Context::from_waker(Waker::noop());
        let was_asked_before = {
            let mut recovered = pin!(net.recover(0));
            let is_under_way = (0..turns).all(|_| {
                let is_under_way = recovered.as_mut().poll(&mut context).is_pending();
                is_under_way && rig.bus.turn()
            });
            if is_under_way {
                assert!(read.as_mut().poll(&mut context).is_pending());
                let recovered = rig.until(recovered);
                assert!(recovered.is_ok(), "after {turns} turns: {recovered:?}");
            }
            is_under_way
        };
        rig.net = Some(net);
        if !was_asked_before {
            assert!(turns > 50, "it took {turns} turns alone");
            break;
        }
        // It has its answer, or has failed.
        let _ = rig.until(read);
    }
}

#[test]
fn a_drive_that_follows_its_clock_is_led_back_after_a_fall_and_brought_up_after_it_was_without_power()
 {
    let drive = unhomed(drives::sigma7(), &["z"]).dc(DistributedClock::new(0x0300));
    let mut yard = Yard::new(personality::sigma7(), drive);
    yard.falls(0x001B);
    yard.nothing_may_happen();
    let recovered = yard.recover(1).unwrap();
    assert!(
        matches!(recovered, Recovered::FromSafeOp { .. }),
        "{recovered}"
    );
    yard.nothing_has_happened();
    yard.works_again("z");
    yard.loses_power(300 * MS);
    yard.nothing_may_happen();
    let recovered = yard.recover(1).unwrap();
    let from = None;
    assert_eq!(recovered, Recovered::BroughtUp { position: 1, from });
    yard.nothing_has_happened();
    yard.works_again("z");
    yard.ends();
}

#[test]
fn a_reference_that_has_begun_anew_is_not_made_the_clock_of_a_line_that_runs() {
    let mut segment = Segment::new()
        .with(personality::sigma7())
        .with(personality::sigma7());
    segment
        .device_mut(0)
        .unwrap()
        .set_clock(90_000_000_000, 0.0);
    let line = Line::new(segment);
    let follower = unhomed(drives::sigma7(), &["z"]).dc(DistributedClock::new(0x0300));
    let builder = Network::builder()
        .link(line.wire())
        .drive(0, unhomed(drives::sigma7(), &["r"]))
        .drive(1, follower);
    let mut rig = Rig::start(builder).unwrap();
    let z = rig.net().axis("z").unwrap();
    let motion = rig.until(async {
        z.enable().await.unwrap();
        let mode = z.profile_position().await.unwrap();
        mode.move_abs(20_000, set_point()).await.unwrap()
    });
    let now = rig.bus.now();
    {
        let mut segment = line.segment();
        let reference = segment.device_mut(0).unwrap();
        reference.power_off();
        reference.power_on(now);
        reference.set_clock(0, 0.0);
    }
    rig.run_for(200 * MS);
    let net = rig.net.take().unwrap();
    let recovered = rig.until(net.recover(0));
    rig.net = Some(net);
    let outcome = rig.until(motion.done()).unwrap();
    assert_eq!(outcome, Outcome::Reached { position: 20_000 });
    let clock = rig.net().statistics().clock.unwrap();
    assert_eq!(clock.reference, ReferenceClock::Silent);
    let error = recovered.unwrap_err().to_string();
    assert!(error.contains("the reference of the others"), "{error}");
    rig.shutdown();
}

/// A program keeps the futures of seventeen answered reads and polls none of them again. The drive loses its power. The recovery ends.
#[test]
fn a_drive_whose_answered_transfers_are_kept_is_recovered() {
    let mut yard = Yard::new(personality::akd2g(), unhomed(drives::akd2g(), &["z", "w"]));
    let sdo = yard.rig.net().sdo(1).unwrap();
    let mut cx = Context::from_waker(Waker::noop());
    let mut kept = Vec::new();
    for _ in 0..17 {
        let sdo = sdo.clone();
        let mut read = Box::pin(async move { sdo.read(obj::STATUSWORD).await });
        assert!(read.as_mut().poll(&mut cx).is_pending());
        yard.rig.run_for(20 * MS);
        kept.push(read);
    }
    yard.loses_power(300 * MS);
    let net = yard.rig.net.take().unwrap();
    let mut recovery = pin!(net.recover(1));
    let end = yard.rig.bus.now() + 60_000 * MS;
    let mut ready = None;
    while yard.rig.bus.now() < end && ready.is_none() {
        if let std::task::Poll::Ready(result) = recovery.as_mut().poll(&mut cx) {
            ready = Some(result);
        }
        assert!(yard.rig.bus.turn());
    }
    assert!(ready.is_some(), "the recovery has no end after a minute");
    drop(kept);
}

/// A thousand counts from where it is, enabled.
async fn goes_on(axis: &Axis, set_point: SetPoint) {
    axis.enable().await.unwrap();
    let mode = axis.profile_position().await.unwrap();
    let target = axis.status().position + 1_000;
    let moved = mode.move_abs(target, set_point).await.unwrap();
    moved.done().await.unwrap();
}

/// The first move has noted what the program had written before it. The recovery writes what the drive held at the first start.
#[test]
fn a_move_that_leaves_its_velocity_out_after_a_recovery_has_none_that_the_program_wrote_since() {
    let (drive, description) = with_parameters_by_sdo();
    let mut yard = Yard::new(drive, unhomed(description, &["z"]));
    let z = yard.axis("z");
    let sdo = yard.rig.net().sdo(1).unwrap();
    let get = |yard: &Yard| yard.line.segment().axis(MIDDLE, 0).unwrap().get(0x6081, 0);
    let held = get(&yard).unwrap();
    let fast = 5 * u32::try_from(held).unwrap();
    yard.rig.until(async {
        sdo.write(obj::PROFILE_VELOCITY, fast).await.unwrap();
        goes_on(&z, SetPoint::new().velocity(10_000)).await;
    });
    yard.loses_power(300 * MS);
    assert_eq!(yard.recover(1).unwrap(), ANEW);
    assert_eq!(get(&yard), Some(held), "the recovery has written it");
    yard.rig.until(goes_on(&z, SetPoint::new()));
    assert_eq!(get(&yard), Some(held), "and the move {fast}");
    drop((sdo, z));
    yard.ends();
}

/// 6086h is in no process data, and nobody reads it at the start. A move before the recovery had another one.
#[test]
fn a_move_that_leaves_its_profile_type_out_after_a_recovery_has_that_of_the_first_start() {
    let (_, description) = with_parameters_by_sdo();
    let servo = servo_with_parameters_by_sdo().change(|drive| drive.profile_types = &[0, 1]);
    let mut yard = Yard::new(servo.build(), unhomed(description, &["z"]));
    let z = yard.axis("z");
    let get = |yard: &Yard| yard.line.segment().axis(MIDDLE, 0).unwrap().get(0x6086, 0);
    assert_eq!(get(&yard), Some(0));
    yard.rig.until(goes_on(&z, SetPoint::new().profile_type(1)));
    is_led_back(&mut yard);
    assert_eq!(get(&yard), Some(1));
    yard.rig.until(goes_on(&z, SetPoint::new()));
    assert_eq!(get(&yard), Some(0));
    drop(z);
    yard.ends();
}

/// A homing leaves them out, and the limits count from the home offset.
#[test]
fn mapped_objects_of_homing_are_what_the_drive_held_until_a_homing_sets_them() {
    let objects = [
        (obj::HOMING_METHOD.address(), 17),
        (obj::HOMING_SWITCH_SPEED.address(), 30_000),
        (obj::HOMING_ZERO_SPEED.address(), 3_000),
        (obj::HOMING_ACCELERATION.address(), 700_000),
        (obj::HOME_OFFSET.address(), -250),
    ];
    let machine = Machine {
        start: 20_000,
        negative_limit: Some(15_000),
        ..Machine::default()
    };
    let servo = Servo::generic().change(move |drive| drive.machine = machine.clone());
    let z = AxisConfig::new("z")
        .referencing(Referencing::UnreferencedMovesAllowed)
        .map_output(obj::HOMING_METHOD)
        .map_output(obj::HOMING_SWITCH_SPEED)
        .map_output(obj::HOMING_ZERO_SPEED)
        .map_output(obj::HOMING_ACCELERATION)
        .map_output(obj::HOME_OFFSET);
    let drive = DriveConfig::new(drives::generic())
        .axis(z)
        .start_up(StartUpWrite::new(obj::HOMING_METHOD, 17))
        .start_up(StartUpWrite::new(obj::HOMING_SWITCH_SPEED, 30_000))
        .start_up(StartUpWrite::new(obj::HOMING_ZERO_SPEED, 3_000))
        .start_up(StartUpWrite::new(obj::HOMING_ACCELERATION, 700_000))
        .start_up(StartUpWrite::new(obj::HOME_OFFSET, -250));
    let mut yard = Yard::new(servo.build(), drive);
    let holds = |yard: &Yard| {
        objects.map(|(object, _)| {
            let segment = yard.line.segment();
            let held = segment.axis(MIDDLE, 0).unwrap();
            held.get(object.index, object.subindex).unwrap()
        })
    };
    let held = objects.map(|(_, value)| i64::from(value));
    assert_eq!(holds(&yard), held);
    let z = yard.axis("z");
    yard.rig.until(async {
        z.enable().await.unwrap();
        let homing = z.homing().await.unwrap();
        homing.home(HomingMethod::NEGATIVE_LIMIT).await.unwrap();
        let other = HomingParameters::new(HomingMethod::CURRENT_POSITION).offset(90);
        homing.home(other).await.unwrap();
    });
    assert_eq!(holds(&yard), [37, 30_000, 3_000, 700_000, 90]);
    is_led_back(&mut yard);
    assert_eq!(holds(&yard), held);
    yard.loses_power(300 * MS);
    assert_eq!(yard.recover(1).unwrap(), ANEW);
    assert_eq!(holds(&yard), held);
    drop(z);
    yard.ends();
}

/// As 0 they would leave the axis no range. Moves are checked against what the drive holds.
#[test]
fn mapped_limits_are_what_the_drive_held_until_the_program_sets_them() {
    let objects = [
        (obj::SOFTWARE_LIMIT_MIN.address(), -5_000),
        (obj::SOFTWARE_LIMIT_MAX.address(), 5_000),
        (obj::MAX_PROFILE_VELOCITY.address(), 60_000),
        (obj::FOLLOWING_ERROR_WINDOW.address(), 900),
    ];
    let z = AxisConfig::new("z")
        .referencing(Referencing::AbsoluteEncoder)
        .map_output(obj::SOFTWARE_LIMIT_MIN)
        .map_output(obj::SOFTWARE_LIMIT_MAX)
        .map_output(obj::MAX_PROFILE_VELOCITY)
        .map_output(obj::FOLLOWING_ERROR_WINDOW);
    let drive = DriveConfig::new(drives::generic())
        .axis(z)
        .start_up(StartUpWrite::new(obj::SOFTWARE_LIMIT_MIN, -5_000))
        .start_up(StartUpWrite::new(obj::SOFTWARE_LIMIT_MAX, 5_000))
        .start_up(StartUpWrite::new(obj::MAX_PROFILE_VELOCITY, 60_000))
        .start_up(StartUpWrite::new(obj::FOLLOWING_ERROR_WINDOW, 900));
    let mut yard = Yard::new(personality::generic(), drive);
    let z = yard.axis("z");
    let is_limited = |yard: &mut Yard| {
        let held = objects.map(|(object, _)| {
            let segment = yard.line.segment();
            let held = segment.axis(MIDDLE, 0).unwrap();
            held.get(object.index, object.subindex).unwrap()
        });
        assert_eq!(held, objects.map(|(_, value)| i64::from(value)));
        yard.rig.until(async {
            z.enable().await.unwrap();
            let pp = z.profile_position().await.unwrap();
            let set_point = SetPoint::new().velocity(50_000);
            let moved = pp.move_abs(4_900, set_point).await.unwrap();
            moved.done().await.unwrap();
            let beyond = pp.move_abs(5_001, set_point).await.unwrap_err();
            let object = ObjectAddress::new(0x607D, 2);
            let is_beyond = |failure| matches!(failure, Failure::BeyondLimit { object: at, .. } if at == object);
            assert!(beyond.failure().is_some_and(is_beyond), "{beyond}");
        });
    };
    is_limited(&mut yard);
    is_led_back(&mut yard);
    is_limited(&mut yard);
    yard.loses_power(300 * MS);
    assert_eq!(yard.recover(1).unwrap(), ANEW);
    is_limited(&mut yard);
    drop(z);
    yard.ends();
}

/// It goes out again as at the first start, and the core goes by what goes out.
#[test]
fn a_mapped_setting_that_the_core_goes_by_is_that_of_the_first_start_after_a_recovery() {
    let z = AxisConfig::new("z").map_output(obj::VELOCITY_THRESHOLD);
    let drive = DriveConfig::new(drives::generic()).axis(z);
    let mut yard = Yard::new(personality::generic(), drive);
    let z = yard.axis("z");
    let first = z.drive_settings().velocity_windows.threshold.unwrap();
    loses_power_and_holds(&mut yard, 0x606F, i64::from(first) + 500);
    assert_eq!(yard.recover(1).unwrap(), ANEW);
    let held = yard.line.segment().axis(MIDDLE, 0).unwrap().get(0x606F, 0);
    assert_eq!(held, Some(first.into()));
    let now = yard.axis("z").drive_settings().velocity_windows.threshold;
    assert_eq!(now, Some(first));
    drop(z);
    yard.ends();
}

/// A homing was given up by the loss. Its home offset, for which it is told only later, is not in the drive any more.
#[test]
fn limits_are_not_counted_from_a_home_offset_of_before_the_recovery() {
    let limit =
        |value| StartUpWrite::new(obj::SOFTWARE_LIMIT_MAX, value).at(Transition::SafeOpToOp);
    let drive = unhomed(drives::generic(), &["z"]).start_up(limit(5_000));
    let mut yard = Yard::new(personality::generic(), drive);
    let z = yard.axis("z");
    let homing = yard.rig.until(async {
        z.enable().await.unwrap();
        z.homing().await.unwrap()
    });
    let offset = HomingParameters::new(HomingMethod::CURRENT_POSITION).offset(-10_000);
    let mut home = Box::pin(homing.home(offset));
    let mut context = Context::from_waker(Waker::noop());
    let held = |yard: &Yard| yard.line.segment().axis(MIDDLE, 0).unwrap().get(0x607C, 0);
    while held(&yard) != Some(-10_000) {
        assert!(home.as_mut().poll(&mut context).is_pending());
        yard.rig.run_for(MS);
    }
    // Its answer is there by then, and nobody looks.
    yard.rig.run_for(50 * MS);
    loses_power_and_holds(&mut yard, 0x607C, 0);
    yard.recover(1).unwrap();
    let ended = yard.rig.until(home);
    assert!(ended.is_err(), "{ended:?}");
    assert_eq!(held(&yard), Some(0));
    drop(homing);
    no_further_than_5000(&mut yard, &z);
    drop(z);
    yard.ends();
}

/// What it held at the first start is not what it has stored, or another program has written it since.
#[test]
fn a_distance_counts_from_what_the_drive_says_after_a_recovery() {
    let limits = |drive: DriveConfig| {
        drive
            .start_up(StartUpWrite::new(obj::SOFTWARE_LIMIT_MIN, -5_000))
            .start_up(StartUpWrite::new(obj::SOFTWARE_LIMIT_MAX, 5_000))
    };
    let from_actual = 2;
    let recoveries: [fn(&mut Yard); 2] = [
        |yard| {
            loses_power_and_holds(yard, 0x60F2, 2);
            assert_eq!(yard.recover(1).unwrap(), ANEW);
        },
        |yard| {
            let mut segment = yard.line.segment();
            let axis = segment.axis_mut(MIDDLE, 0).unwrap();
            axis.set(0x60F2, 0, 2).unwrap();
            drop(segment);
            is_led_back(yard);
        },
    ];
    for (case, recovery) in recoveries.into_iter().enumerate() {
        let drive = limits(unhomed(drives::generic(), &["z"]));
        let mut yard = Yard::new(personality::generic(), drive);
        let z = yard.axis("z");
        recovery(&mut yard);
        let held = yard.line.segment().axis(MIDDLE, 0).unwrap().get(0x60F2, 0);
        assert_eq!(held, Some(from_actual));
        let beyond = yard.rig.until(async {
            z.enable().await.unwrap();
            let mode = z.profile_position().await.unwrap();
            mode.move_rel(8_000, set_point()).await
        });
        let failure = beyond.err().and_then(|error| error.failure());
        assert!(
            matches!(failure, Some(Failure::BeyondLimit { limit: 5_000, .. })),
            "{case}: {failure:?}"
        );
        drop(z);
        yard.ends();
    }
}
