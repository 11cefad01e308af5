//! What relative moves count from, across everything that moves the axis between two of them.
#![allow(missing_docs)]

mod common;

use common::Rig;
use servocrab::axis::{Command, Completion, Failure};
use servocrab::coe::obj;
use servocrab::drives::{self, DriveDescription};
use servocrab::ds402::Mode;
use servocrab::homing::{HomingCommand, HomingMethod};
use servocrab::profile_position::{BufferMode, Limits, PositionRange, RelativeBase, SetPoint};
use servocrab::profile_velocity::JogSetPoint;
use servocrab_sim::ds402::{Behaviour, ReachedPolicy};

/// An AKD2G that can be jogged.
fn description() -> DriveDescription {
    let mut description = drives::akd2g();
    for axis in &mut description.axes {
        axis.outputs.push(obj::TARGET_VELOCITY.into());
    }
    description
}

/// A drive whose relative moves count from the previous target, 60F2h = 0, and a library that knows.
fn rig() -> Rig {
    let behaviour = Behaviour {
        relative_base: servocrab_sim::ds402::RelativeBase::PreviousTarget,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::of(description(), behaviour, |config| {
        config.traits.relative_base = RelativeBase::PreviousTarget;
        config.limits = Limits {
            software: Some(PositionRange {
                min: -100_000,
                max: 100_000,
            }),
            ..Limits::trust_drive()
        };
    });
    rig.enable();
    rig
}

fn mode(rig: &mut Rig, mode: Mode) {
    let id = rig.send(Command::SelectMode(mode));
    assert_eq!(rig.finish(id), Ok(Completion::Done));
}

/// Half a second with 20 000 counts/s.
fn jog(rig: &mut Rig) {
    mode(rig, Mode::ProfileVelocity);
    let jog = rig.send(Command::Jog(JogSetPoint::from(20_000)));
    rig.run(500);
    rig.core.release_jog(rig.now, jog, &mut rig.outputs);
    rig.finish(jog).unwrap();
    mode(rig, Mode::ProfilePosition);
}

/// A distance is gone from where the axis stands, and reported so.
fn goes(rig: &mut Rig, distance: i32) {
    let from = rig.drive.position() as i32;
    let id = rig.rel(distance, SetPoint::new());
    let end = rig.finish(id);
    let position = from + distance;
    assert!(
        matches!(end, Ok(Completion::Reached { position: at }) if at.abs_diff(position) <= 10),
        "{end:?}"
    );
}

#[test]
fn a_relative_replacement_beyond_a_limit_fails_alone() {
    let mut rig = rig();
    let first = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(first);
    let second = rig.abs(60_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    rig.wait_accepted(second);
    // No place for this one yet.
    let third = rig.abs(70_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    let fourth = rig.rel(90_000, SetPoint::new());
    rig.cycle();
    rig.cycle();
    assert!(matches!(
        rig.finish(fourth),
        Err(Failure::BeyondLimit { .. })
    ));
    assert!(matches!(rig.finish(third), Ok(Completion::Reached { .. })));
    assert_eq!(rig.reports(fourth).len(), 1);
}

/// Distances one after another, each while the axis is still on the way of the one before; the first since it was enabled.
#[test]
fn a_distance_that_replaces_another_may_count_from_where_that_would_have_ended() {
    use servocrab_sim::ds402::RelativeBase as Simulated;
    for (known, drive) in [
        (RelativeBase::PreviousTarget, Simulated::PreviousTarget),
        (RelativeBase::Undocumented, Simulated::PreviousTarget),
        (RelativeBase::Undocumented, Simulated::Demand),
    ] {
        let behaviour = Behaviour {
            relative_base: drive,
            ..Behaviour::akd2g()
        };
        let mut rig = Rig::of(description(), behaviour, |config| {
            config.traits.relative_base = known;
        });
        rig.enable();
        for replacements in 1..4 {
            let mut last = rig.rel(30_000, SetPoint::new());
            for _ in 0..replacements {
                rig.wait_accepted(last);
                rig.run(150);
                last = rig.rel(30_000, SetPoint::new());
            }
            let end = rig.finish(last);
            assert!(
                matches!(end, Ok(Completion::Reached { .. })),
                "{known:?} {drive:?} {replacements}: {end:?}"
            );
            // What the next one counts from is not known.
            jog(&mut rig);
        }
    }
}

#[test]
fn after_a_jog_a_distance_counts_from_where_the_axis_stands() {
    let mut rig = rig();
    let first = rig.abs(1_000, SetPoint::new());
    rig.finish(first).unwrap();
    jog(&mut rig);
    goes(&mut rig, 300);
}

#[test]
fn of_no_length_after_a_jog_a_distance_may_have_a_way_to_go_where_nobody_knows_its_base() {
    // Its bit 10 stays high on no way, on a shaft that no load moves.
    let behaviour = Behaviour {
        reached: ReachedPolicy::Window,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::of(description(), behaviour, |config| {
        config.traits.relative_base = RelativeBase::Undocumented;
    })
    .ideal();
    rig.enable();
    let nowhere = rig.rel(0, SetPoint::new());
    assert_eq!(rig.finish(nowhere), Ok(Completion::Reached { position: 0 }));
    jog(&mut rig);
    let nowhere = rig.rel(0, SetPoint::new());
    assert!(matches!(rig.finish(nowhere), Err(Failure::NotBegun { .. })));
}

#[test]
fn after_a_homing_a_distance_counts_from_where_the_axis_stands() {
    let mut rig = rig();
    let first = rig.abs(1_000, SetPoint::new());
    rig.finish(first).unwrap();
    mode(&mut rig, Mode::Homing);
    rig.drive.set(0x6098, 0, 37).unwrap();
    let home = rig.send(Command::Home(HomingCommand {
        method: HomingMethod(37),
        offset: None,
        until: None,
    }));
    rig.finish(home).unwrap();
    mode(&mut rig, Mode::ProfilePosition);
    goes(&mut rig, 300);
}

#[test]
fn after_the_power_was_off_a_distance_counts_from_where_the_axis_stands() {
    let mut rig = rig();
    let first = rig.abs(1_000, SetPoint::new());
    rig.finish(first).unwrap();
    let off = rig.send(Command::Disable);
    rig.finish(off).unwrap();
    // Pushed by hand.
    rig.drive.place(5_000);
    rig.enable();
    goes(&mut rig, 300);
}

#[test]
fn what_a_replacement_shows_before_its_acknowledge_is_not_the_end_of_the_move_before() {
    let mut rig = Rig::new(Behaviour::akd2g(), |config| {
        config.traits.relative_base = RelativeBase::Demand;
        config.deadlines.acknowledge = core::time::Duration::from_secs(5);
    });
    rig.enable();
    let first = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(first);
    rig.run(200);
    // Where these two end is not known here: they count from wherever the axis is when the drive takes them.
    let second = rig.rel(20_000, SetPoint::new());
    rig.wait_accepted(second);
    rig.drive.disturbances().ack_delay_cycles = 2_000;
    let third = rig.rel(-1_000, SetPoint::new());
    // Since its acknowledge it has shown nothing either.
    assert!(matches!(rig.finish(third), Err(Failure::NotBegun { .. })));
    assert_eq!(rig.outcome(second), Some(Err(Failure::Superseded)));
}
