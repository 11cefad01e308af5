//! Moves: accepted, done, dropped, with parameters by SDO.

use std::{sync::atomic::Ordering, time::Duration};

use servocrab::{
    BufferMode, Failure, Outcome, SetPoint,
    axis::{AxisErrorKind, ParameterFault, Unsupported},
    coe::obj,
    ds402::State,
    profile_position::StartBits,
};

use crate::machine::{Machine, Task, Variant, at_target};

#[test]
fn a_move_resolves_at_the_acknowledge_and_its_outcome_at_the_target() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(10_000, SetPoint::new()))
        .unwrap();
    assert!(machine.drive().position() < 5_000, "it has just begun");
    assert_eq!(moved.outcome(), None);
    let reached = at_target(machine.finish(moved.done()).unwrap(), 10_000);
    assert_eq!(
        moved.outcome(),
        Some(Ok(reached)),
        "asked again it is the same"
    );
    assert_eq!(machine.finish(moved.done()).unwrap(), reached);
    assert!(machine.is_at(10_000) && machine.stands());
}

#[test]
fn two_relative_moves_are_two_moves() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    for _ in 0..2 {
        let moved = machine.finish(pp.move_rel(500, SetPoint::new())).unwrap();
        machine.finish(moved.done()).unwrap();
    }
    assert!(machine.is_at(1_000));
    assert_eq!(machine.drive().ledger().len(), 2);
}

#[test]
fn a_move_that_is_dropped_before_its_frame_is_never_executed() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let mut moving = Task::new(pp.move_abs(10_000, SetPoint::new()));
    assert!(moving.poll().is_none());
    drop(moving);
    machine.run(100);
    assert!(machine.drive().ledger().is_empty());
    // Nothing of it is left in the way of the next one.
    let next = machine.finish(pp.move_abs(50, SetPoint::new())).unwrap();
    machine.finish(next.done()).unwrap();
    assert_eq!(machine.drive().ledger().len(), 1);
}

#[test]
fn a_move_that_is_dropped_after_bit_4_rose_is_executed_once_and_the_next_one_goes_on() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let mut moving = Task::new(pp.move_abs(10_000, SetPoint::new()));
    assert!(moving.poll().is_none());
    while machine.stations[0].words.last().unwrap() & 0x10 == 0 {
        machine.cycle();
    }
    drop(moving);
    machine.run(1_000);
    assert_eq!(machine.drive().ledger().len(), 1);
    assert!(machine.is_at(10_000));
}

#[test]
fn more_moves_than_places_can_be_dropped_one_after_another() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    for n in 0..200 {
        let mut moving = Task::new(pp.move_abs(10 * n, SetPoint::new()));
        assert!(moving.poll().is_none());
        machine.run((n % 7) as usize);
        drop(moving);
        machine.cycle();
    }
    let last = machine.finish(pp.move_abs(-77, SetPoint::new())).unwrap();
    machine.finish(last.done()).unwrap();
    assert!(machine.is_at(-77));
}

#[test]
fn a_refused_move_says_which_axis_of_which_drive_and_why() {
    let mut machine = Machine::new(1);
    let axis = machine.axis(0);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let error = machine.finish(pp.move_abs(1, SetPoint::new())).unwrap_err();
    let state = State::SwitchOnDisabled;
    assert_eq!(error.failure(), Some(Failure::NotEnabled { state }));
    let text = error.to_string();
    assert!(
        text.contains("axis0") && text.contains("drive 0 \"AKD2G\""),
        "{text}"
    );
}

#[test]
fn a_superseded_move_and_the_one_in_its_place_have_their_own_outcomes() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let first = machine
        .finish(pp.move_abs(100_000, SetPoint::new()))
        .unwrap();
    machine.run(50);
    let second = machine.finish(pp.move_abs(0, SetPoint::new())).unwrap();
    let superseded = machine.finish(first.done()).unwrap_err();
    assert_eq!(superseded.failure(), Some(Failure::Superseded));
    assert!(machine.finish(second.done()).is_ok());
}

#[test]
fn a_fault_without_a_code_in_the_process_data_has_the_code_that_sdo_reads() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(100_000, SetPoint::new()))
        .unwrap();
    machine.drive().inject_fault(0x8611);
    let error = machine.finish(moved.done()).unwrap_err();
    let code = Some(0x8611);
    assert_eq!(
        error.failure(),
        Some(Failure::Fault {
            code,
            following_error: false
        })
    );
    assert!(error.to_string().contains("8611h"), "{error}");
    machine.run(500);
    machine.finish(axis.reset_fault()).unwrap();
    assert_eq!(axis.status().state, State::SwitchOnDisabled);
}

#[test]
fn a_deadline_of_the_caller_ends_the_wait_and_not_the_move() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(10_000, SetPoint::new()))
        .unwrap();
    // The time of the network: it stands still while the machine does.
    let mut wait = Task::new(moved.done().within(Duration::from_millis(20)));
    let begin = machine.now;
    let late = machine.finish_task(&mut wait).unwrap_err();
    let AxisErrorKind::Late {
        statusword,
        controlword,
        ..
    } = late.kind
    else {
        panic!("{late}");
    };
    assert_eq!(statusword, axis.status().statusword);
    assert_eq!(controlword, axis.status().controlword);
    assert_eq!(controlword.bits() & 0x000F, 0x000F);
    assert_eq!(machine.now - begin, Duration::from_millis(20));
    let reached = at_target(machine.finish(moved.done()).unwrap(), 10_000);
    let in_time = smol::block_on(moved.done().within(Duration::from_secs(60)));
    assert_eq!(in_time.unwrap(), reached);
}

#[test]
fn a_parameter_that_is_not_mapped_is_written_by_sdo_before_bit_4_rises() {
    let variant = Variant {
        not_mapped: vec![0x6081],
        ..Variant::default()
    };
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let set_point = SetPoint::new().velocity(12_345);
    let moved = machine.finish(pp.move_abs(1_000, set_point)).unwrap();
    machine.finish(moved.done()).unwrap();
    assert_eq!(machine.drive().ledger()[0].velocity, 12_345);
    let written = machine.stations[0].sdo.written.lock().unwrap().clone();
    assert_eq!(written, [(0x6081, 12_345u32.to_le_bytes().to_vec())]);
}

#[test]
fn pitfall_12_a_parameter_that_the_drive_refuses_leaves_the_move_unsent() {
    let variant = Variant {
        not_mapped: vec![0x6081],
        ..Variant::default()
    };
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pp = machine.finish(axis.profile_position()).unwrap();
    machine.stations[0]
        .sdo
        .refuse
        .store(true, Ordering::Relaxed);
    let refused = machine
        .finish(pp.move_abs(1_000, SetPoint::new().velocity(5)))
        .unwrap_err();
    assert!(matches!(refused.kind, AxisErrorKind::Sdo(_)));
    assert!(refused.to_string().contains("6081h"), "{refused}");
    machine.run(100);
    assert!(machine.drive().ledger().is_empty());
}

#[test]
fn a_zero_velocity_and_a_start_that_the_drive_lacks_are_refused_before_anything_is_written() {
    let mut variant = Variant {
        not_mapped: vec![0x6081],
        ..Variant::default()
    };
    variant.traits.blend = StartBits::Unsupported("it has no blending");
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let zero = SetPoint::new().velocity(0);
    let zero = machine.finish(pp.move_abs(1, zero)).unwrap_err();
    assert!(matches!(
        zero.failure(),
        Some(Failure::Parameter {
            fault: ParameterFault::Zero,
            ..
        })
    ));
    let blend = SetPoint::new()
        .velocity(7)
        .buffer_mode(BufferMode::Blending);
    let blend = machine.finish(pp.move_abs(1, blend)).unwrap_err();
    assert!(matches!(
        blend.failure(),
        Some(Failure::Unsupported(Unsupported::Start { .. }))
    ));
    assert!(machine.stations[0].sdo.written.lock().unwrap().is_empty());
}

#[test]
fn an_override_out_of_range_or_of_a_velocity_that_is_not_mapped_is_refused() {
    let (mut machine, axis) = Machine::enabled();
    for factor in [0.0, 0.049, 2.001, -1.0, f64::NAN, f64::INFINITY] {
        let refused = machine.finish(axis.set_override(factor)).unwrap_err();
        let text = refused.to_string();
        assert!(
            text.contains("0.05 to 2; to stop the axis, halt() it"),
            "{text}"
        );
    }
    machine.finish(axis.set_override(0.5)).unwrap();
    let mut variant = Variant::default();
    variant.not_mapped.push(0x6081);
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let refused = machine.finish(axis.set_override(0.5)).unwrap_err();
    let text = refused.to_string();
    assert!(text.contains("6081h is not in the process data"), "{text}");
}

#[test]
fn a_move_until_a_torque_says_where_the_axis_pressed() {
    let mut variant = Variant::default();
    variant.traits.acknowledges_while_halted = true;
    variant.inputs_too.push(obj::TORQUE_ACTUAL.into());
    let (mut machine, axis) = Machine::enabled_of(&variant);
    machine.drive().put_wall(10_000, 0.5);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let press = SetPoint::new().until_torque(300, Duration::from_millis(20));
    let moved = machine.finish(pp.move_abs(20_000, press)).unwrap();
    let outcome = machine.finish(moved.done()).unwrap();
    let Outcome::Contact { position, torque } = outcome else {
        panic!("{outcome}");
    };
    assert!(
        (10_500..13_000).contains(&position) && torque >= 300,
        "{outcome}"
    );
    assert_eq!(axis.status().state, State::OperationEnabled);
    let back = machine.finish(pp.move_abs(0, SetPoint::new())).unwrap();
    at_target(machine.finish(back.done()).unwrap(), 0);
}
