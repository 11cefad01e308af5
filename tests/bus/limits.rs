//! Limits that the drives hold: read when an axis attaches, read again when asked for, or left to the drive.

use std::time::Duration;

use servocrab::{
    AxisConfig, AxisError, DriveConfig, Failure, FailureClass, HomingMethod, HomingParameters,
    Network, NetworkError, Outcome, ProfilePosition, Referencing, SetPoint,
    axis::AxisErrorKind,
    bus::DriveFault,
    coe::{AxisOffset, ObjectAddress, obj},
    drives,
    parameters::StartUpWrite,
    profile_position::{Limits, LimitsActive, MinVelocity, PositionRange},
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

/// 2010h is 2000 and 6081h 1000, and its unit is known, or not.
fn with_least(what: MinVelocity) -> Rig {
    let mut description = drives::pp2010();
    description.traits.limits.min_velocity = what;
    let drive = DriveConfig::new(description)
        .axis(AxisConfig::new("s").referencing(Referencing::UnreferencedMovesAllowed))
        .start_up(StartUpWrite::new(obj::MIN_PROFILE_VELOCITY, 2_000))
        .start_up(StartUpWrite::new(obj::PROFILE_VELOCITY, 1_000));
    let line = Line::ideal(Segment::new().with(personality::pp2010()));
    Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap()
}

fn goes_by(rig: &mut Rig, pp: &ProfilePosition, set_point: SetPoint) -> Result<(), AxisError> {
    rig.until(async { pp.move_rel(500, set_point).await?.done().await.map(drop) })
}

#[test]
fn a_move_slower_than_2010h_is_refused_where_that_has_the_unit_of_6081h() {
    let mut rig = with_least(MinVelocity::AsProfileVelocity);
    let axis = rig.net().axis("s").unwrap();
    rig.until(axis.enable()).unwrap();
    let pp = rig.until(axis.profile_position()).unwrap();
    let least = 2_000;
    for (velocity, asked) in [(Some(1_999), 1_999), (None, 1_000)] {
        let mut set_point = SetPoint::new();
        set_point.parameters.velocity = velocity;
        let before = axis.status().position;
        let error = rig.until(pp.move_rel(500, set_point)).unwrap_err();
        assert_eq!(error.failure(), Some(Failure::TooSlow { asked, least }));
        assert_eq!(
            error.failure().map(|failure| failure.class()),
            Some(FailureClass::Refused)
        );
        let text = error.to_string();
        assert!(text.contains("2010h") && text.contains("2000"), "{text}");
        rig.run_for(Duration::from_millis(200));
        assert_eq!(axis.status().position, before);
    }
    goes_by(&mut rig, &pp, SetPoint::new().velocity(2_000)).unwrap();
    // Changed, and read again.
    let sdo = rig.net().sdo(0).unwrap();
    rig.until(sdo.write(obj::MIN_PROFILE_VELOCITY, 999))
        .unwrap();
    let read = rig.until(axis.read_limits()).unwrap();
    assert_eq!(read.min_velocity, Some(999));
    goes_by(&mut rig, &pp, SetPoint::new()).unwrap();
    rig.shutdown();
}

#[test]
fn a_2010h_of_unknown_unit_is_shown_and_refuses_nothing() {
    let shown = drives::pp2010().traits.limits.min_velocity;
    assert_eq!(shown, MinVelocity::UnitUnknown, "its page names no unit");
    for (what, read) in [(shown, Some(2_000)), (MinVelocity::Absent, None)] {
        let mut rig = with_least(what);
        let axis = rig.net().axis("s").unwrap();
        let limits = rig.until(axis.read_limits()).unwrap();
        assert_eq!(limits.min_velocity, read);
        rig.until(axis.enable()).unwrap();
        let pp = rig.until(axis.profile_position()).unwrap();
        goes_by(&mut rig, &pp, SetPoint::new()).unwrap();
        rig.shutdown();
    }
}

#[test]
fn a_first_distance_beyond_a_limit_is_refused_and_not_on_a_drive_without_limits() {
    for (limit, is_limited) in [(1_000_i32, true), (0, false)] {
        let drive = DriveConfig::new(drives::sigma7())
            .axis(AxisConfig::new("z").referencing(Referencing::AbsoluteEncoder))
            .start_up(StartUpWrite::new(obj::SOFTWARE_LIMIT_MIN, -limit))
            .start_up(StartUpWrite::new(obj::SOFTWARE_LIMIT_MAX, limit));
        let line = Line::ideal(Segment::new().with(personality::sigma7()));
        let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
        let z = rig.net().axis("z").unwrap();
        rig.until(z.enable()).unwrap();
        let pp = rig.until(z.profile_position()).unwrap();
        for distance in [1_001, -1_001] {
            let moved = rig.until(pp.move_rel(distance, SetPoint::new()));
            let failure = moved.err().and_then(|error| error.failure());
            let beyond = matches!(
                failure,
                Some(Failure::BeyondLimit { asked, .. }) if asked == i64::from(distance)
            );
            assert_eq!(beyond, is_limited, "{limit} {distance}: {failure:?}");
            assert_eq!(failure.is_none(), !is_limited);
        }
        rig.shutdown();
    }
}

/// 607Dh holds once the axis is referenced, and an earlier program has homed `z`, which its drive shows.
#[test]
fn an_axis_that_an_earlier_program_has_homed_has_its_limits() {
    let line = Line::ideal(Segment::new().with(personality::akd2g()));
    let start = || {
        let mut description = drives::akd2g();
        description.traits.limits.active = LimitsActive::WhenReferenced;
        let mut drive = DriveConfig::new(description).axis("y").axis("z");
        for axis in [1, 2] {
            drive = drive
                .start_up(StartUpWrite::new(
                    obj::SOFTWARE_LIMIT_MIN.axis(axis),
                    -1_000,
                ))
                .start_up(StartUpWrite::new(obj::SOFTWARE_LIMIT_MAX.axis(axis), 1_000));
        }
        Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap()
    };
    let beyond = |rig: &mut Rig, name: &str| {
        let axis = rig.net().axis(name).unwrap();
        let moved = rig.until(async {
            axis.enable().await.unwrap();
            let pp = axis.profile_position().await.unwrap();
            pp.move_rel(1_001, SetPoint::new()).await.map(drop)
        });
        let failure = moved.err().and_then(|error| error.failure());
        matches!(
            failure,
            Some(Failure::BeyondLimit {
                limit: 1_000,
                asked: 1_001,
                ..
            })
        )
    };
    let mut rig = start();
    let z = rig.net().axis("z").unwrap();
    rig.until(async {
        z.enable().await.unwrap();
        let homing = z.homing().await.unwrap();
        let home = HomingParameters::new(HomingMethod::CURRENT_POSITION);
        homing.home(home).await.unwrap();
    });
    drop(z);
    rig.shutdown();
    let mut rig = start();
    assert!(beyond(&mut rig, "z"));
    assert!(!beyond(&mut rig, "y"), "nobody has homed this one");
    rig.shutdown();
}
