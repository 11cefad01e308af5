//! Drives that were without power: brought up anew, as at the start.

use std::sync::{Arc, Mutex};

use servocrab::{
    axis::{Axis, Failure, Referencing},
    bus::{
        AlState as State, AlStatus, AxisConfig, BringUpStep, DistributedClock, DriveConfig,
        Network, Recovered, ReferenceClock,
    },
    coe::obj,
    drives,
    parameters::StartUpWrite,
    profile_position::{Outcome, SetPoint},
};
use servocrab_sim::{AlState, Segment, personality};

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
        BringUpStep::Parameters,
        BringUpStep::Watchdog,
        BringUpStep::State(State::SafeOp),
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
