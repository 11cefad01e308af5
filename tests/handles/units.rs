//! The same handles in millimetres: numbers are converted, and nothing else is different.

use servocrab::{
    axis::{AxisErrorKind, Failure, together},
    coe::ObjectAddress,
    profile_position::Start,
    units::{
        Edition, Quantity, Ratio, Scale, ScaleError, ScaledMove, ScaledOutcome, ScaledSetPoint,
    },
};

use crate::machine::Machine;

/// 1000 counts are 1 mm; velocities in counts/s, accelerations in hundreds of counts/s².
fn mm() -> Scale {
    Scale::counts_per_unit(Ratio::new(1000, 1).unwrap())
        .acceleration_counts_per_unit(Ratio::new(10, 1).unwrap())
}

#[test]
fn targets_parameters_and_outcomes_are_in_the_programs_units() {
    let (mut machine, axis) = Machine::enabled();
    let x = axis.scaled(mm());
    let pp = machine.finish(x.profile_position()).unwrap();
    let set_point = ScaledSetPoint::new()
        .velocity(80.25)
        .acceleration(50_000.0)
        .deceleration(60_000.04);
    let moved = machine.finish(pp.move_abs(-12.3456, set_point)).unwrap();
    assert_eq!(
        machine.finish(moved.done()).unwrap(),
        ScaledOutcome::Reached { position: -12.346 }
    );
    let line = machine.drive().ledger()[0].clone();
    assert_eq!(line.value, -12_346);
    assert_eq!(
        (line.velocity, line.acceleration, line.deceleration),
        (80_250, 500_000, 600_000)
    );
    assert!(!line.relative);

    let moved = machine
        .finish(pp.move_rel(2.0, ScaledSetPoint::new().start(Start::AfterCurrent)))
        .unwrap();
    assert_eq!(machine.finish(moved.done()).unwrap().position(), -10.346);
    assert!(machine.drive().ledger()[1].relative);
    assert_eq!(x.status().position, -10.346);
    assert_eq!(x.status().snapshot.position, -10_346);
    machine.finish(pp.release()).unwrap();
}

#[test]
fn moves_that_start_together_can_be_scaled_too() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine
        .finish(axis.scaled(mm()).profile_position())
        .unwrap();
    let request = pp.abs(1.5, ScaledSetPoint::new()).unwrap();
    let moves = machine.finish(together([request])).unwrap();
    for moved in moves {
        let moved = ScaledMove::new(moved, mm());
        assert_eq!(machine.finish(moved.done()).unwrap().position(), 1.5);
    }
    assert!(pp.rel(f64::INFINITY, ScaledSetPoint::new()).is_err());
}

#[test]
fn a_target_that_the_drive_missed_is_told_in_the_programs_units() {
    let (mut machine, axis) = Machine::enabled();
    for (subindex, limit) in [(1, -5_000), (2, 5_000)] {
        machine.drive().set(0x607D, subindex, limit).unwrap();
    }
    let pp = machine
        .finish(axis.scaled(mm()).profile_position())
        .unwrap();
    let moved = machine
        .finish(pp.move_abs(8.0, ScaledSetPoint::new()))
        .unwrap();
    let error = machine.finish(moved.done()).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("stands at 5 instead of 8"), "{text}");
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
    let (mut machine, axis) = Machine::enabled();
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
    let (mut machine, axis) = Machine::enabled();
    let pp = machine
        .finish(axis.scaled(mm()).profile_position())
        .unwrap();
    let frames = machine.stations[0].words.len();
    let before = machine.stations[0].outputs.clone();
    let error = machine
        .finish(pp.move_abs(3e6, ScaledSetPoint::new()))
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
