//! The same handles in millimetres: numbers are converted, and nothing else is different.

use servocrab::{
    Axis, BufferMode, Failure, HomingMethod, HomingParameters, Outcome, ProfilePosition,
    Referencing, SetPoint,
    axis::{AxisErrorKind, Delivery, ParameterFault},
    coe::{ObjectAddress, obj},
    profile_position::{Limits, Reference},
    profile_velocity::JogSetPoint,
    start_together,
    units::{AxisScale, Degree, Edition, Mm, Quantity, Ratio, Scale, ScaleError},
};
use servocrab_sim::ds402::{Behaviour, Plant};

use smol::stream::{self, StreamExt};

use crate::machine::{Machine, Variant, beside_its_switch};

/// The ideal axis: what the program reads is compared to the last digit.
fn exact() -> Variant {
    Variant {
        behaviour: Behaviour::akd2g().with_plant(Plant::ideal()),
        ..Variant::default()
    }
}

/// 1000 counts are 1 mm; velocities in counts/s, accelerations in hundreds of counts/s².
fn mm() -> Scale {
    Scale::counts_per_unit(Ratio::new(1000, 1).unwrap())
        .acceleration_counts_per_unit(Ratio::new(10, 1).unwrap())
}

fn in_mm(axis: &Axis) -> Axis<Mm> {
    axis.scaled(mm()).unwrap()
}

#[test]
fn targets_parameters_and_outcomes_are_in_the_programs_units() {
    let (mut machine, axis) = Machine::enabled_of(&exact());
    let x = in_mm(&axis);
    let pp = machine.finish(x.profile_position()).unwrap();
    let set_point = SetPoint::new()
        .velocity(80.25)
        .acceleration(50_000.0)
        .deceleration(60_000.04);
    let moved = machine.finish(pp.move_abs(-12.3456, set_point)).unwrap();
    assert_eq!(
        machine.finish(moved.done()).unwrap(),
        Outcome::Reached { position: -12.346 }
    );
    let line = machine.drive().ledger()[0].clone();
    assert_eq!(line.value, -12_346);
    assert_eq!(
        (line.velocity, line.acceleration, line.deceleration),
        (80_250, 500_000, 600_000)
    );
    assert!(!line.relative);

    let moved = machine
        .finish(pp.move_rel(2.0, SetPoint::new().buffer_mode(BufferMode::Buffered)))
        .unwrap();
    assert_eq!(machine.finish(moved.done()).unwrap().position(), -10.346);
    assert!(machine.drive().ledger()[1].relative);
    assert_eq!(x.status().position, -10.346);
    assert_eq!(axis.status().position, -10_346);
    machine.finish(pp.release()).unwrap();
}

#[test]
fn an_axis_has_the_unit_of_its_declaration_and_counts_and_no_other() {
    let declared = Variant {
        scale: AxisScale::of::<Mm>(mm()),
        ..exact()
    };
    let (mut machine, axis) = Machine::enabled_of(&declared);
    let source = machine.stations[0].source.clone();
    let x = source.axis_in::<Mm>().unwrap();
    assert_eq!(x.scale(), &mm());
    for error in [
        source.axis_in::<Degree>().unwrap_err(),
        axis.scaled::<Degree>(mm()).unwrap_err(),
        // Not even with another scale.
        axis.scaled::<Mm>(Scale::COUNTS).unwrap_err(),
    ] {
        assert!(
            matches!(error.kind, AxisErrorKind::WrongUnit { declared: "mm", .. }),
            "{error}"
        );
    }
    let pp = machine.finish(x.profile_position()).unwrap();
    let moved = machine.finish(pp.move_abs(1.5, SetPoint::new())).unwrap();
    machine.finish(moved.done()).unwrap();
    assert_eq!(axis.status().position, 1_500);

    let (machine, axis) = Machine::enabled_of(&exact());
    let in_mm = machine.stations[0].source.axis_in::<Mm>().unwrap_err();
    assert!(
        matches!(
            in_mm.kind,
            AxisErrorKind::WrongUnit {
                declared: "counts",
                asked: "mm"
            }
        ),
        "{in_mm}"
    );
    assert!(axis.scaled::<Degree>(mm()).is_ok());
}

/// Axes of several units start in one frame, and each move has the unit of its own axis.
#[test]
fn moves_in_different_units_start_together() {
    let (mut machine, pp) = two_units();
    let both = (
        pp.0.abs(2.5, SetPoint::new()),
        pp.1.abs(-90.0, SetPoint::new()),
    );
    let (slide, table) = machine.finish(start_together(both)).unwrap();
    assert_eq!(machine.finish(slide.done()).unwrap().position(), 2.5);
    assert_eq!(machine.finish(table.done()).unwrap().position(), -90.0);
    let latched = [0, 1].map(|n| {
        let drive = machine.stations[n].drive.lock().unwrap();
        let first = drive.ledger()[0].clone();
        (first.value, first.latched_at)
    });
    assert_eq!((latched[0].0, latched[1].0), (2_500, -900));
    assert_eq!(latched[0].1, latched[1].1);

    // One that cannot be converted keeps the other from being sent.
    let both = (
        pp.0.abs(0.0, SetPoint::new()),
        pp.1.abs(1e12, SetPoint::new()),
    );
    let error = machine.finish(start_together(both)).unwrap_err();
    assert_eq!(error.identity.axis, "axis1");
    assert!(matches!(error.kind, AxisErrorKind::Scale(_)), "{error}");
    machine.run(300);
    assert_eq!(machine.drive().ledger().len(), 1);
}

/// A slide in millimetres and a table in degrees, both enabled.
fn two_units() -> (Machine, (ProfilePosition<Mm>, ProfilePosition<Degree>)) {
    let mut machine = Machine::of(2, &exact());
    let tenths = Scale::counts_per_unit(Ratio::new(10, 1).unwrap());
    let slide = in_mm(&machine.axis(0));
    let table = machine.axis(1).scaled::<Degree>(tenths).unwrap();
    machine.finish(slide.enable()).unwrap();
    machine.finish(table.enable()).unwrap();
    let slide = machine.finish(slide.profile_position()).unwrap();
    let table = machine.finish(table.profile_position()).unwrap();
    (machine, (slide, table))
}

#[test]
fn moves_that_start_together_can_be_scaled_too() {
    let (mut machine, axis) = Machine::enabled_of(&exact());
    let pp = machine.finish(in_mm(&axis).profile_position()).unwrap();
    let request = pp.abs(1.5, SetPoint::new());
    let twice = [request.clone(), request.clone()];
    assert!(machine.finish(start_together(twice)).is_err());
    let moves = machine.finish(start_together([request])).unwrap();
    for moved in moves {
        assert_eq!(machine.finish(moved.done()).unwrap().position(), 1.5);
    }
    let endless = [pp.rel(f64::INFINITY, SetPoint::new())];
    let error = machine.finish(start_together(endless)).unwrap_err();
    assert!(matches!(error.kind, AxisErrorKind::Scale(_)), "{error}");
}

#[test]
fn a_path_and_its_end_are_told_in_the_programs_units() {
    let (mut machine, axis) = Machine::enabled_of(&exact());
    let pp = machine.finish(in_mm(&axis).profile_position()).unwrap();
    machine.drive().set(0x607D, 1, -9_000).unwrap();
    machine.drive().set(0x607D, 2, 9_000).unwrap();
    let queued = SetPoint::new().buffer_mode(BufferMode::Buffered);
    let moves = [
        pp.abs(2.5, queued),
        pp.rel(-0.5, queued),
        pp.abs(9.5, queued),
    ];
    let path = pp.follow(stream::iter(moves));
    let followed: Vec<_> = machine.finish(path.collect());
    let ends: Vec<_> = followed
        .iter()
        .map(|followed| match followed {
            Ok(followed) => (followed.command.reference, followed.command.target),
            Err(failed) => (failed.command.reference, failed.command.target),
        })
        .collect();
    assert_eq!(
        ends,
        [
            (Reference::Absolute, 2.5),
            (Reference::Relative, -0.5),
            (Reference::Absolute, 9.5)
        ]
    );
    // A position within the window, of ten counts, shows that it was there.
    let reached = followed.iter().flatten().zip([2.5, 2.0]);
    for (followed, target) in reached {
        let Outcome::Reached { position } = followed.outcome else {
            panic!("{}", followed.outcome);
        };
        assert!((position - target).abs() < 0.0105, "{position}");
        assert_eq!(followed.outcome.to_string(), format!("reached {position}"));
    }
    let texts: Vec<_> = followed
        .iter()
        .map(|followed| match followed {
            Ok(followed) => followed.outcome.to_string(),
            Err(error) => error.to_string(),
        })
        .collect();
    assert!(followed[0].is_ok() && followed[1].is_ok(), "{texts:?}");
    assert!(
        texts[2].contains("stands at 9 mm instead of 9.5 mm"),
        "{}",
        texts[2]
    );
}

#[test]
fn a_target_that_the_drive_missed_is_told_in_the_programs_units() {
    let (mut machine, axis) = Machine::enabled_of(&exact());
    for (subindex, limit) in [(1, -5_000), (2, 5_000)] {
        machine.drive().set(0x607D, subindex, limit).unwrap();
    }
    let pp = machine.finish(in_mm(&axis).profile_position()).unwrap();
    let moved = machine.finish(pp.move_abs(8.0, SetPoint::new())).unwrap();
    let error = machine.finish(moved.done()).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("stands at 5 mm instead of 8 mm"), "{text}");
    assert_eq!(
        error.failure(),
        Some(Failure::MissedTarget {
            target: 8_000,
            actual: 5_000
        })
    );
}

#[test]
fn the_factor_objects_of_the_drive_make_the_scale() {
    let (mut machine, axis) = Machine::enabled_of(&exact());
    let turn = machine.drive().get(0x6092, 1).unwrap();
    // Velocities in revolutions per minute.
    machine.drive().set(0x6096, 1, 60).unwrap();
    machine.drive().set(0x6096, 2, turn).unwrap();
    let factors = machine.finish(axis.factors()).unwrap();
    // The simulated AKD2G has no 6093h.
    assert_eq!(
        (factors.edition, factors.position),
        (Edition::Version3, None)
    );
    let scale = factors.scale(Ratio::new(5, 1).unwrap()).unwrap();
    assert_eq!(scale.position(5.0), Ok(i32::try_from(turn).unwrap()));
    assert_eq!(scale.velocity(50.0), Ok(600));

    let divisor = ObjectAddress::new(0x6091, 2);
    *machine.stations[0].sdo.zero.lock().unwrap() = Some(divisor);
    let error = machine.finish(axis.factors()).unwrap_err();
    assert!(
        matches!(
            error.kind,
            AxisErrorKind::Scale(ScaleError::ZeroFactor { object }) if object == divisor
        ),
        "{error}"
    );
}

#[test]
fn a_number_that_cannot_be_converted_is_told_before_anything_is_written() {
    let (mut machine, axis) = Machine::enabled_of(&exact());
    let pp = machine.finish(in_mm(&axis).profile_position()).unwrap();
    let frames = machine.stations[0].words.len();
    let before = machine.stations[0].outputs.clone();
    let error = machine
        .finish(pp.move_abs(3e6, SetPoint::new()))
        .unwrap_err();
    assert!(
        matches!(
            error.kind,
            AxisErrorKind::Scale(ScaleError::OutOfRange {
                quantity: Quantity::Position,
                ..
            })
        ),
        "{error}"
    );
    assert_eq!(
        machine.stations[0].words.len(),
        frames,
        "not even a cycle was waited for"
    );
    assert_eq!(machine.stations[0].outputs, before);
}

/// 1000 counts are 1 mm; velocities in half counts/s, accelerations in hundreds of counts/s².
fn with_factors_of_their_own() -> Scale {
    mm().velocity_counts_per_unit(Ratio::new(500, 1).unwrap())
}

#[test]
fn a_homing_has_its_speeds_offset_and_result_in_the_programs_units() {
    let variant = Variant {
        behaviour: Behaviour {
            machine: beside_its_switch(),
            ..exact().behaviour
        },
        referencing: Referencing::ByHoming,
        ..Variant::default()
    };
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let x = axis.scaled::<Mm>(with_factors_of_their_own()).unwrap();
    let homing = machine.finish(x.homing()).unwrap();
    let parameters = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
        .speeds(40.0, 4.0)
        .acceleration(20_000.04)
        .offset(2.4996);

    let refused = machine
        .finish(homing.home(parameters.offset(-3e6)))
        .unwrap_err();
    assert!(
        matches!(
            refused.kind,
            AxisErrorKind::Scale(ScaleError::OutOfRange {
                quantity: Quantity::HomeOffset,
                ..
            })
        ),
        "{refused}"
    );
    assert!(machine.stations[0].sdo.written.lock().unwrap().is_empty());

    let homed = machine.finish(homing.home(parameters)).unwrap();
    let held = |index, subindex| machine.drive().get(index, subindex);
    assert_eq!(held(0x6099, 1), Some(20_000));
    assert_eq!(held(0x6099, 2), Some(2_000));
    assert_eq!(held(0x609A, 0), Some(200_000));
    assert_eq!(held(0x607C, 0), Some(2_500));
    let counts = machine.drive().position();
    assert_eq!(homed.position, counts as f64 / 1000.0);
    assert!(x.status().referenced);
    let standing = machine
        .finish(homing.home(HomingParameters::from(HomingMethod::NEGATIVE_LIMIT).speeds(0.0, 1.0)))
        .unwrap_err();
    assert!(matches!(
        standing.failure(),
        Some(Failure::Parameter {
            fault: ParameterFault::Zero,
            ..
        })
    ));
    machine.finish(homing.release()).unwrap();
}

#[test]
fn a_jog_has_its_velocity_and_ramps_in_the_programs_units() {
    let variant = Variant {
        mapped_too: vec![obj::TARGET_VELOCITY.into()],
        limits: Limits {
            max_velocity: Some(20_000),
            ..Limits::trust_drive()
        },
        ..exact()
    };
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let x = axis.scaled::<Mm>(with_factors_of_their_own()).unwrap();
    let pv = machine.finish(x.profile_velocity()).unwrap();
    let asked = JogSetPoint::new(-20.0)
        .acceleration(50_000.0)
        .deceleration(60_000.0);
    let jog = machine.finish(pv.jog(asked)).unwrap();
    machine.run(100);
    assert_eq!(machine.drive().velocity(), -10_000.0);
    assert_eq!(x.status().velocity, -20.0);
    assert_eq!(machine.drive().get(0x6083, 0), Some(500_000));
    assert_eq!(machine.drive().get(0x6084, 0), Some(600_000));
    jog.set(3.5).unwrap();
    machine.run(100);
    assert_eq!(machine.drive().velocity(), 1_750.0);

    // What cannot be converted, or is too fast, leaves the jog as it was; what is too slow stops it.
    let slow = jog.set(-0.0001).unwrap_err();
    assert!(
        matches!(
            slow.kind,
            AxisErrorKind::Scale(ScaleError::RoundsToZero {
                quantity: Quantity::TargetVelocity,
                ..
            })
        ),
        "{slow}"
    );
    machine.run(100);
    assert_eq!(machine.drive().velocity(), 0.0);
    jog.set(3.5).unwrap();
    machine.run(100);
    assert!(jog.set(f64::NAN).is_err());
    let fast = jog.set(-50.0).unwrap_err();
    assert!(
        matches!(
            fast.failure(),
            Some(Failure::BeyondLimit { limit: 20_000, .. })
        ),
        "{fast}"
    );
    let text = fast.to_string();
    assert!(
        text.contains("50 mm/s lies beyond the limit 40 mm/s of 607Fh"),
        "{text}"
    );
    machine.run(10);
    assert_eq!(machine.drive().velocity(), 1_750.0);
    assert_eq!(jog.ended(), None);
    machine.finish(jog.release()).unwrap();
    assert_eq!(machine.drive().velocity(), 0.0);

    let fast = machine.finish(pv.jog(50.0)).unwrap_err().to_string();
    assert!(fast.contains("the limit 40 mm/s of 607Fh"), "{fast}");
    let jog = machine.finish(pv.jog(1.0)).unwrap();
    machine.finish(axis.halt()).unwrap();
    assert_eq!(
        jog.ended(),
        Some(Failure::Halted {
            delivery: Delivery::Accepted
        })
    );
    machine.finish(axis.stop()).unwrap();
    machine.finish(pv.release()).unwrap();
}
