//! What a network reports of a pair, and of a following error.

use std::time::Duration;

use servocrab::{
    AxisConfig, DriveConfig, Network, NetworkError, Referencing, SetPoint,
    axis::{AxisErrorKind, PairError},
    bus::{DriveFault, NetworkEvent},
    drives,
    units::{Mm, Ratio, Scale},
};
use servocrab_sim::{Segment, personality::Servo};

use crate::rig::{Line, Rig};

fn axis(name: &str) -> AxisConfig {
    let scale = Scale::counts_per_unit(Ratio::new(1_000, 1).unwrap());
    AxisConfig::new(name)
        .unit::<Mm>(scale)
        .referencing(Referencing::UnreferencedMovesAllowed)
}

fn line() -> Line {
    let servo = || Servo::generic().build();
    Line::new(Segment::new().with(servo()).with(servo()))
}

fn drive(axis: AxisConfig) -> DriveConfig {
    DriveConfig::new(drives::generic()).axis(axis)
}

fn start(line: &Line, first: AxisConfig) -> Result<Rig, NetworkError> {
    let builder = Network::builder().link(line.wire());
    Rig::start(builder.drive(0, drive(first)).drive(1, drive(axis("x2"))))
}

#[test]
fn a_jam_of_one_side_is_warned_of_and_stops_both_in_millimetres() {
    let line = line();
    let mut rig = start(&line, axis("x1")).unwrap();
    let events = rig.net().events();
    let pairing = rig.net().pair_in::<Mm>("x1", "x2").unwrap();
    let gantry = pairing.skew(0.5, 2.0).unwrap();
    assert!(rig.net().pair("x1", "y").is_err(), "there is no y");
    rig.until(gantry.enable()).unwrap();
    let fast = SetPoint::new().velocity(100.0).acceleration(1_000.0);
    let motion = rig.until(gantry.move_abs(100.0, fast)).unwrap();
    rig.run_for(Duration::from_millis(300));
    let mut segment = line.segment();
    segment.axis_mut(1, 0).unwrap().disturbances().blocked = true;
    drop(segment);
    let error = rig.until(motion.done()).unwrap_err();
    let text = error.to_string();
    let AxisErrorKind::Pair(error) = error.kind else {
        panic!("{text}");
    };
    let PairError::Skew { skew, limit, unit } = *error else {
        panic!("{text}");
    };
    assert!(skew > 2.0 && skew < 2.3, "{text}");
    assert_eq!((limit, unit), (2.0, "mm"));
    rig.run_for(Duration::from_millis(20));
    let told: Vec<_> = std::iter::from_fn(|| events.try_next()).collect();
    let [NetworkEvent::Skew(warned), NetworkEvent::Skew(stopped)] = &told[..] else {
        panic!("{told:?}");
    };
    assert!(!warned.stopped && warned.skew > 0.5 && warned.skew < 0.8);
    assert!(stopped.stopped && stopped.skew == skew);
    assert!(
        told[1]
            .to_string()
            .ends_with("mm, beyond 2 mm: both are stopped")
    );
    rig.shutdown();
}

#[test]
fn a_side_that_has_lost_its_position_is_not_square_any_more() {
    for absolute in [false, true] {
        let line = line();
        let side = |name| match absolute {
            true => axis(name).referencing(Referencing::AbsoluteEncoder),
            false => axis(name),
        };
        let builder = Network::builder().link(line.wire());
        let builder = builder.drive(0, drive(side("x1")));
        let mut rig = Rig::start(builder.drive(1, drive(side("x2")))).unwrap();
        let gantry = rig.net().pair_in::<Mm>("x1", "x2").unwrap();
        let gantry = gantry.skew(0.5, 2.0).unwrap();
        rig.loses_power(&line, 1);
        rig.recover(1).unwrap();
        rig.until(gantry.enable()).unwrap();
        let moved = rig.until(gantry.move_abs(1.0, SetPoint::new()));
        if absolute {
            rig.until(moved.unwrap().done()).unwrap();
        } else {
            let error = moved.unwrap_err();
            let is_not_square =
                matches!(&error.kind, AxisErrorKind::Pair(of) if **of == PairError::NotSquare);
            assert!(is_not_square, "{error}");
        }
        drop(gantry);
        rig.shutdown();
    }
}

#[test]
fn a_following_error_is_reported_once_until_it_was_low_again() {
    let line = line();
    let mut rig = start(&line, axis("x1").following_error_warning(2.5)).unwrap();
    let events = rig.net().events();
    let axis = rig.net().axis_in::<Mm>("x1").unwrap();
    rig.until(axis.enable()).unwrap();
    let positions = rig.until(axis.profile_position()).unwrap();
    let slow = SetPoint::new().velocity(20.0).acceleration(1_000.0);
    for target in [50.0, 0.0] {
        let motion = rig.until(positions.move_abs(target, slow)).unwrap();
        rig.run_for(Duration::from_millis(500));
        for blocked in [true, false] {
            let mut segment = line.segment();
            segment.axis_mut(0, 0).unwrap().disturbances().blocked = blocked;
            drop(segment);
            rig.run_for(Duration::from_millis(200));
        }
        rig.until(motion.done()).unwrap();
        let told: Vec<_> = std::iter::from_fn(|| events.try_next()).collect();
        let [
            NetworkEvent::FollowingErrorHigh {
                axis,
                following_error,
                level,
                unit,
            },
        ] = &told[..]
        else {
            panic!("{told:?}");
        };
        assert_eq!((&*axis.axis, *level, *unit), ("x1", 2.5, "mm"));
        let size = following_error.abs();
        assert!(size > 2.5 && size < 2.6, "{}", told[0]);
    }
    rig.shutdown();
}

#[test]
fn a_warning_that_would_come_after_the_fault_or_is_none_is_refused() {
    let line = line();
    line.segment()
        .axis_mut(0, 0)
        .unwrap()
        .set(0x6065, 0, 2_000)
        .unwrap();
    let error = start(&line, axis("x1").following_error_warning(2.5));
    assert!(
        matches!(
            error.as_ref().err(),
            Some(NetworkError::Drive { error, .. })
                if matches!(**error, DriveFault::LateWarning { warning: 2_500, window: 2_000, .. })
        ),
        "{:?}",
        error.err()
    );
    for level in [0.0, -1.0, f64::NAN, 1e9] {
        let error = start(&line, axis("x1").following_error_warning(level)).err();
        assert!(
            matches!(error, Some(NetworkError::Declaration(_))),
            "{error:?}"
        );
    }
}
