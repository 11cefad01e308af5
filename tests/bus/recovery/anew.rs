//! Drives that were without power: brought up anew, as at the start.

use std::{
    future::Future,
    pin::pin,
    task::{Context, Waker},
    time::Duration,
};

use servocrab::{
    Axis, AxisConfig, DriveConfig, Failure, Network, Referencing, SetPoint,
    bus::{AlState as State, AlStatus, Recovered},
    coe::{ObjectAddress, obj},
    drives,
    parameters::{StartUpWrite, Transition},
};
use servocrab_sim::{
    AlState, Segment,
    personality::{self},
};

use super::{MIDDLE, MS, Yard, is_over, kinds, set_point, unhomed, with_parameters_by_sdo};
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
