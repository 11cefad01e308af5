//! Homing and jog over frames: mailbox, mapping and process data of the second axis of a drive.

use std::time::Duration;

use servocrab::{
    AxisConfig, DriveConfig, Failure, HomingMethod, HomingParameters, Network, Outcome,
    Referencing, SetPoint,
    axis::{Unsupported, WaitingFor},
    coe::obj,
    drives,
    ds402::Mode,
    profile_velocity::JogSetPoint,
};
use servocrab_sim::{Segment, ds402::Machine, personality::Servo};

use crate::rig::{Line, Rig};

const MS: Duration = Duration::from_millis(1);

/// Axis `y` stands 5000 counts above its negative limit switch and does not know it.
fn line() -> (Line, DriveConfig) {
    let machine = Machine {
        start: 20_000,
        negative_limit: Some(15_000),
        ..Machine::default()
    };
    let servo = Servo::akd2g().change(move |drive| drive.machine = machine.clone());
    let config = DriveConfig::new(drives::akd2g()).axis("x").axis(
        AxisConfig::new("y")
            .referencing(Referencing::ByHoming)
            .map_output(obj::TARGET_VELOCITY),
    );
    (Line::new(Segment::new().with(servo.build())), config)
}

fn to_the_switch() -> HomingParameters {
    HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
        .speeds(50_000, 5_000)
        .acceleration(1_000_000)
        .offset(100)
}

#[test]
fn the_second_axis_of_a_drive_is_homed_and_moved_and_a_loss_takes_its_reference_away() {
    let (line, config) = line();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, config)).unwrap();
    let y = rig.net().axis("y").unwrap();
    rig.until(async {
        y.enable().await.unwrap();
        let homing = y.homing().await.unwrap();
        homing.home(to_the_switch()).await.unwrap();
        homing.release().await.unwrap();
        let pp = y.profile_position().await.unwrap();
        let set_point = SetPoint::new()
            .velocity(50_000)
            .acceleration(1_000_000)
            .deceleration(1_000_000);
        let moved = pp.move_abs(2_100, set_point).await.unwrap();
        let reached = moved.done().await.unwrap();
        assert!(
            matches!(reached, Outcome::Reached { position } if (position - 2_100).abs() <= 10),
            "{reached:?}"
        );
    });
    assert!(y.status().referenced);
    {
        let segment = line.segment();
        let drive = segment.axis(0, 1).unwrap();
        let home = drive.homings()[0].home.unwrap();
        assert!((drive.mechanical_position() - home - 2_000).abs() <= 10);
        assert!(segment.axis(0, 0).unwrap().homings().is_empty());
    }
    line.segment().unplug(0);
    rig.run_for(200 * MS);
    assert!(y.status().lost && !y.status().referenced);
    rig.shutdown();
}

#[test]
fn a_jog_whose_holder_falls_silent_ends_in_a_running_network() {
    let (line, config) = line();
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, config)).unwrap();
    let y = rig.net().axis("y").unwrap();
    let (pv, jog) = rig.until(async {
        y.enable().await.unwrap();
        let pv = y.profile_velocity().await.unwrap();
        let set_point = JogSetPoint::new(10_000).dead_man(50 * MS);
        let jog = pv.jog(set_point).await.unwrap();
        (pv, jog)
    });
    for _ in 0..10 {
        jog.hold().unwrap();
        rig.run_for(40 * MS);
    }
    assert!((y.status().velocity - 10_000).abs() < 1_000);
    rig.run_for(400 * MS);
    assert_eq!(jog.ended(), Some(Failure::NotHeld));
    let status = y.status();
    assert!(
        !status.halted && status.velocity.abs() < 1_000,
        "{status:?}"
    );
    drop((jog, pv));
    rig.shutdown();
}

#[test]
fn a_mode_that_6502h_does_not_name_is_refused_and_without_6502h_it_is_tried() {
    const WITHOUT: &[u16] = &[0x6502];
    for without in [&[], WITHOUT] {
        let servo = Servo::akd2g().change(move |drive| {
            drive.supported_modes = 0x21;
            drive.without = without;
        });
        let line = Line::new(Segment::new().with(servo.build()));
        let config = DriveConfig::new(drives::akd2g())
            .axis("x")
            .axis(AxisConfig::new("y").map_output(obj::TARGET_VELOCITY));
        let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, config)).unwrap();
        let y = rig.net().axis("y").unwrap();
        let asked = rig.bus.now();
        let error = rig.until(y.profile_velocity()).unwrap_err();
        let failure = error.failure().unwrap();
        if without.is_empty() {
            let mode = Mode::ProfileVelocity;
            assert_eq!(failure, Failure::Unsupported(Unsupported::Mode(mode)));
            let text = error.to_string();
            assert!(
                text.contains("profile velocity mode (3)") && text.contains("6502h"),
                "{text}"
            );
            assert!(rig.bus.now() - asked < 20 * MS);
        } else {
            let waiting_for = WaitingFor::Mode(Mode::ProfileVelocity);
            assert!(
                matches!(failure, Failure::Timeout { waiting_for: asked, .. } if asked == waiting_for),
                "{failure:?}"
            );
        }
        rig.until(y.homing()).unwrap();
        rig.shutdown();
    }
}
