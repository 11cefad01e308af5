//! Limits that the drives hold: read when an axis attaches, read again when asked for, or left to the drive.

use servocrab::{
    AxisError, DriveConfig, Failure, HomingMethod, HomingParameters, Network, NetworkError,
    Outcome, ProfilePosition, Referencing, SetPoint,
    axis::AxisErrorKind,
    bus::DriveFault,
    coe::{AxisOffset, ObjectAddress, obj},
    drives,
    parameters::StartUpWrite,
    profile_position::{Limits, PositionRange},
};
use servocrab_sim::{Segment, personality};

use crate::rig::{Line, Rig};

/// 607Dh of the second axis from −5000 to 5000, 607Fh 60000, home offset 100.
fn second_axis_limited() -> DriveConfig {
    let second = AxisOffset::of_axis(2);
    let mut drive = DriveConfig::new(drives::akd2g()).axis("x").axis("y");
    for (object, value) in [
        (obj::SOFTWARE_LIMIT_MIN.address(), -5_000_i32),
        (obj::SOFTWARE_LIMIT_MAX.address(), 5_000),
        (obj::HOME_OFFSET.address(), 100),
        (obj::MAX_PROFILE_VELOCITY.address(), 60_000),
    ] {
        let object = ObjectAddress::new(second.apply(object.index), object.subindex);
        drive = drive.start_up(StartUpWrite::to(object, value));
    }
    ["x", "y"].into_iter().fold(drive, |drive, axis| {
        drive.change_axis(axis, |axis| axis.referencing(Referencing::AbsoluteEncoder))
    })
}

fn start(drive: DriveConfig) -> Rig {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap()
}

fn move_to(rig: &mut Rig, pp: &ProfilePosition, target: i32) -> Result<Outcome, AxisError> {
    let set_point = SetPoint::new()
        .velocity(50_000)
        .acceleration(1_000_000)
        .deceleration(1_000_000);
    rig.until(async { pp.move_abs(target, set_point).await?.done().await })
}

#[test]
fn each_axis_is_checked_against_its_own_objects_until_they_are_read_again() {
    let mut rig = start(second_axis_limited());
    let y = rig.net().axis("y").unwrap();
    rig.until(y.enable()).unwrap();
    let pp = rig.until(y.profile_position()).unwrap();
    move_to(&mut rig, &pp, 4_900).unwrap();
    let beyond = |limit, asked| {
        Some(Failure::BeyondLimit {
            object: ObjectAddress::new(0x607D, 2),
            limit,
            asked,
        })
    };
    let error = move_to(&mut rig, &pp, 4_901).unwrap_err();
    assert_eq!(error.failure(), beyond(4_900, 4_901), "{error}");
    let fast = rig.until(pp.move_abs(0, SetPoint::new().velocity(60_001)));
    let too_fast = Failure::BeyondLimit {
        object: ObjectAddress::new(0x607F, 0),
        limit: 60_000,
        asked: 60_001,
    };
    assert_eq!(fast.unwrap_err().failure(), Some(too_fast));

    // Changed behind the axis' back, the limit of before is checked, until it is told.
    let sdo = rig.net().sdo(0).unwrap();
    rig.until(sdo.write(obj::SOFTWARE_LIMIT_MAX.axis(2), 8_000))
        .unwrap();
    let error = move_to(&mut rig, &pp, 6_000).unwrap_err();
    assert_eq!(error.failure(), beyond(4_900, 6_000));
    let read = rig.until(y.read_limits()).unwrap();
    assert_eq!(
        read.software,
        Some(PositionRange {
            min: -5_000,
            max: 8_000
        })
    );
    assert_eq!((read.home_offset, read.max_velocity), (100, Some(60_000)));
    move_to(&mut rig, &pp, 6_000).unwrap();

    // The first axis has objects of its own: its limits are 0 and 0, which on this drive means off.
    let x = rig.net().axis("x").unwrap();
    rig.until(x.enable()).unwrap();
    let pp = rig.until(x.profile_position()).unwrap();
    move_to(&mut rig, &pp, 20_000).unwrap();
    rig.shutdown();
}

#[test]
fn a_program_that_trusts_the_drive_is_told_when_it_ends_a_move_early() {
    let mut rig =
        start(second_axis_limited().change_axis("y", |axis| axis.limits(Limits::trust_drive())));
    let y = rig.net().axis("y").unwrap();
    rig.until(y.enable()).unwrap();
    let pp = rig.until(y.profile_position()).unwrap();
    let error = move_to(&mut rig, &pp, 6_000).unwrap_err();
    assert!(
        matches!(
            error.kind,
            AxisErrorKind::Failed(Failure::MissedTarget { target: 6_000, actual }) if (actual - 4_900).abs() < 20
        ),
        "{error}"
    );
    rig.shutdown();
}

#[test]
fn limits_that_the_program_gives_take_the_place_of_the_drives() {
    let limits = Limits {
        software: Some(PositionRange { min: 0, max: 300 }),
        ..Limits::trust_drive()
    };
    let mut rig = start(second_axis_limited().change_axis("y", |axis| axis.limits(limits)));
    let y = rig.net().axis("y").unwrap();
    rig.until(y.enable()).unwrap();
    let pp = rig.until(y.profile_position()).unwrap();
    let error = move_to(&mut rig, &pp, -1).unwrap_err();
    assert!(matches!(
        error.failure(),
        Some(Failure::BeyondLimit {
            limit: 0,
            asked: -1,
            ..
        })
    ));
    move_to(&mut rig, &pp, 300).unwrap();
    rig.shutdown();
}

#[test]
fn a_modulo_axis_takes_its_turn_from_the_drive() {
    let range = |subindex| ObjectAddress::new(0x687B, subindex);
    let drive = || {
        second_axis_limited()
            .change_axis("y", |axis| axis.limits(Limits::trust_drive()))
            .change_axis("y", servocrab::AxisConfig::modulo)
    };
    let set = drive()
        .start_up(StartUpWrite::to(range(1), 0_i32))
        .start_up(StartUpWrite::to(range(2), 3_999_i32));
    let mut rig = start(set);
    let y = rig.net().axis("y").unwrap();
    rig.until(y.enable()).unwrap();
    let pp = rig.until(y.profile_position()).unwrap();
    let moved = rig.until(async { pp.move_rel(9_000, SetPoint::new()).await?.done().await });
    let Ok(Outcome::Reached { position }) = moved else {
        panic!("{moved:?}");
    };
    assert!((position - 1_000).abs() < 20, "{position}");
    let error = move_to(&mut rig, &pp, 4_000).unwrap_err();
    assert!(matches!(
        error.failure(),
        Some(Failure::BeyondLimit { limit: 3_999, .. })
    ));
    rig.shutdown();

    // As the drive comes, its 607Bh is the whole range of its type: that is no turn.
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let error = Rig::start(Network::builder().link(line.wire()).drive(0, drive())).err();
    assert!(
        matches!(
            &error,
            Some(NetworkError::Drive { error, .. }) if matches!(&**error, DriveFault::NoTurn { axis } if axis == "y")
        ),
        "{error:?}"
    );
}

#[test]
fn limits_that_hold_after_homing_are_checked_after_homing() {
    // Sigma-7: 607Dh less 607Ch, off where the minimum is not below the maximum, in force once the axis is homed.
    let mut drive = DriveConfig::new(drives::sigma7()).axis("z");
    for (object, value) in [
        (obj::SOFTWARE_LIMIT_MIN.address(), -1_000_i32),
        (obj::SOFTWARE_LIMIT_MAX.address(), 1_000),
    ] {
        drive = drive.start_up(StartUpWrite::to(object, value));
    }
    let line = Line::new(Segment::new().with(personality::sigma7()));
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
    let z = rig.net().axis("z").unwrap();
    rig.until(z.enable()).unwrap();
    let pp = rig.until(z.profile_position()).unwrap();
    let fast = SetPoint::new()
        .velocity(50_000)
        .acceleration(1_000_000)
        .deceleration(1_000_000);
    // Not homed: neither the drive nor the library holds the axis back, and absolute moves are not asked for.
    rig.until(async { pp.move_rel(5_000, fast).await?.done().await })
        .unwrap();
    let error = move_to(&mut rig, &pp, 0).unwrap_err();
    assert_eq!(error.failure(), Some(Failure::NotReferenced));
    rig.until(pp.release()).unwrap();

    let homing = rig.until(z.homing()).unwrap();
    let home = HomingParameters::new(HomingMethod::CURRENT_POSITION).offset(300);
    rig.until(homing.home(home)).unwrap();
    rig.until(homing.release()).unwrap();
    let pp = rig.until(z.profile_position()).unwrap();
    let error = move_to(&mut rig, &pp, 701).unwrap_err();
    assert_eq!(
        error.failure(),
        Some(Failure::BeyondLimit {
            object: ObjectAddress::new(0x607D, 2),
            limit: 700,
            asked: 701
        }),
        "less the home offset that the homing has set"
    );
    move_to(&mut rig, &pp, 700).unwrap();
    rig.shutdown();
}
