//! Touch probes: the position of an edge beside a running move, and nothing that is not an edge.

use core::{sync::atomic::Ordering, time::Duration};
use std::sync::Arc;

use servocrab::{
    Axis, AxisError, Failure, FailureClass, SetPoint,
    axis::{ArmedProbe, AxisErrorKind, Edge, Probe, ProbeError, Probed},
    coe::{AnyObject, obj},
    ds402::State,
    profile_position::{PositionRange, Traits},
    units::{AxisScale, Mm, Ratio, Scale},
};
use servocrab_sim::ds402::{self, Behaviour, Mark, Plant};

use crate::machine::{CYCLE, Machine, Task, Variant, output};

/// All of both probes in the process data.
fn mapped() -> Variant {
    let inputs: [AnyObject; 7] = [
        obj::TOUCH_PROBE_STATUS.into(),
        obj::TOUCH_PROBE_1_POSITIVE.into(),
        obj::TOUCH_PROBE_1_NEGATIVE.into(),
        obj::TOUCH_PROBE_2_POSITIVE.into(),
        obj::TOUCH_PROBE_2_NEGATIVE.into(),
        obj::TOUCH_PROBE_1_POSITIVE_COUNTER.into(),
        obj::TOUCH_PROBE_2_NEGATIVE_COUNTER.into(),
    ];
    Variant {
        mapped_too: vec![obj::TOUCH_PROBE_FUNCTION.into()],
        inputs_too: inputs.to_vec(),
        ..by_sdo()
    }
}

/// Nothing of them.
fn by_sdo() -> Variant {
    Variant {
        behaviour: Behaviour::generic(),
        ..Variant::default()
    }
}

/// The same with marks for both probes.
fn meeting(variant: Variant, probes: [Option<Mark>; 2]) -> Variant {
    let mut behaviour = variant.behaviour.clone();
    behaviour.machine.probes = probes;
    Variant {
        behaviour,
        ..variant
    }
}

fn fast() -> SetPoint {
    SetPoint::new()
        .velocity(100_000)
        .acceleration(1_000_000)
        .deceleration(1_000_000)
}

fn probe_error(error: &AxisError) -> &ProbeError {
    match &error.kind {
        AxisErrorKind::Probe(error) => error,
        other => panic!("{other:?}"),
    }
}

/// The latest 60B8h.
fn function(machine: &Machine) -> i64 {
    machine.drive().get(0x60B8, 0).unwrap()
}

fn armed(machine: &mut Machine, axis: &Axis) -> ArmedProbe {
    machine.finish(axis.probe(Probe::One).arm()).unwrap()
}

/// The input of probe 1 is active for a cycle from now on.
fn pulse(machine: &Machine) {
    let mut drive = machine.drive();
    drive.set_probe_input(1, true, machine.now + CYCLE / 2);
    drive.set_probe_input(1, false, machine.now + CYCLE * 3 / 2);
}

#[test]
fn the_position_of_an_edge_is_that_of_the_edge_beside_a_running_move() {
    let cases = [
        (Probe::One, Edge::Rising, 12_345),
        (Probe::One, Edge::Falling, 14_001),
        (Probe::Two, Edge::Rising, 15_432),
        (Probe::Two, Edge::Falling, 16_001),
    ];
    let marks = [Mark::new(12_345, 14_000), Mark::new(15_432, 16_000)].map(Some);
    for variant in [mapped(), by_sdo()] {
        for (probe, edge, at) in cases {
            let (mut machine, axis) = Machine::enabled_of(&meeting(variant.clone(), marks));
            let pp = machine.finish(axis.profile_position()).unwrap();
            let probe = machine.finish(axis.probe(probe).edge(edge).arm()).unwrap();
            let moved = machine.finish(pp.move_abs(30_000, fast())).unwrap();
            let latched = machine.finish(probe.latched()).unwrap();
            assert_eq!(latched, at);
            assert!(!machine.stands(), "it moves on");
            assert_eq!(machine.finish(probe.latched()).unwrap(), at, "asked again");
            machine.finish(moved.done()).unwrap();
            assert!(machine.is_at(30_000));
        }
    }
}

#[test]
fn a_mapped_edge_is_known_in_the_cycle_after_it_and_lies_between_two_cycles() {
    let (mut machine, axis) = Machine::enabled_of(&Variant {
        behaviour: Behaviour::generic().with_plant(Plant::ideal()),
        ..mapped()
    });
    let pp = machine.finish(axis.profile_position()).unwrap();
    let probe = armed(&mut machine, &axis);
    let _moved = machine.finish(pp.move_abs(50_000, fast())).unwrap();
    machine.run(200);
    let mut latched = Task::new(probe.latched());
    machine.run_beside(&mut latched, 5);
    let before = machine.drive().position();
    let at = machine.now + CYCLE * 3 / 10;
    machine.drive().set_probe_input(1, true, at);
    // The drive's own cycle comes after the frame.
    machine.run_beside(&mut latched, 1);
    machine.cycle();
    let latched = latched.poll().expect("the frame after it has it").unwrap();
    assert_eq!(i64::from(latched) - before, 30, "of 100 counts in a cycle");
}

#[test]
fn an_edge_is_in_the_unit_of_the_axis() {
    let scale = Scale::counts_per_unit(Ratio::new(1_000, 1).unwrap());
    let variant = Variant {
        scale: AxisScale::of::<Mm>(scale),
        ..meeting(mapped(), [Some(Mark::new(12_345, i64::MAX)), None])
    };
    let (mut machine, _counts) = Machine::enabled_of(&variant);
    let axis = machine.stations[0].source.axis_in::<Mm>().unwrap();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let probe = axis.probe(Probe::One).within(12.3, 12.4);
    let probe = machine.finish(probe.arm()).unwrap();
    let _moved = machine
        .finish(pp.move_abs(20.0, SetPoint::new().velocity(100.0)))
        .unwrap();
    assert_eq!(machine.finish(probe.latched()).unwrap(), 12.345);
}

#[test]
fn what_an_earlier_probe_has_left_is_no_edge() {
    for variant in [mapped(), by_sdo()] {
        let (mut machine, axis) = Machine::enabled_of(&variant);
        let probe = armed(&mut machine, &axis);
        pulse(&machine);
        machine.finish(probe.latched()).unwrap();
        drop(probe);
        let probe = armed(&mut machine, &axis);
        let mut latched = Task::new(probe.latched());
        machine.run_beside(&mut latched, 100);
        pulse(&machine);
        machine.finish_task(&mut latched).unwrap();
    }
}

/// It was there before the network: another program has armed it.
#[test]
fn a_probe_that_another_program_has_left_armed_begins_anew() {
    let (mut machine, axis) = Machine::enabled_of(&by_sdo());
    machine.drive().set(0x60B8, 0, 0x1313).unwrap();
    machine.run(2);
    pulse(&machine);
    machine.run(3);
    assert_eq!(machine.drive().get(0x60B9, 0), Some(0x0103));
    let probe = armed(&mut machine, &axis);
    assert_eq!(function(&machine), 0x1311, "probe 2 stays as it is");
    let mut latched = Task::new(probe.latched());
    machine.run_beside(&mut latched, 100);
}

/// The drive has armed the first one, and does not show that yet.
#[test]
fn an_edge_of_a_probe_that_was_given_up_is_not_that_of_the_next() {
    for drive_cycle in [1, 4] {
        let variant = Variant {
            drive_cycle,
            ..mapped()
        };
        for given_up_after in 1..60 {
            let (mut machine, axis) = Machine::enabled_of(&variant);
            machine.drive().disturbances().touch_probe_lag_cycles = 1;
            let mut first = Task::new(axis.probe(Probe::One).arm());
            for _ in 0..given_up_after {
                let _ = first.poll();
                machine.cycle();
            }
            pulse(&machine);
            machine.run(2);
            drop(first);
            let mut second = Task::new(axis.probe(Probe::One).arm());
            let probe = machine.finish_task(&mut second).unwrap();
            let mut latched = Task::new(probe.latched());
            machine.run_beside(&mut latched, 40);
        }
    }
}

#[test]
fn of_an_input_that_bounces_the_first_edge_counts() {
    let (mut machine, axis) = Machine::enabled_of(&mapped());
    let pp = machine.finish(axis.profile_position()).unwrap();
    let probe = armed(&mut machine, &axis);
    let _moved = machine.finish(pp.move_abs(50_000, fast())).unwrap();
    machine.run(200);
    let mut expected = 0;
    for step in 0..20 {
        let at = machine.now + CYCLE * step / 3;
        machine.drive().set_probe_input(1, step % 2 == 1, at);
        if step == 2 {
            // After the first edge, before the third.
            expected = machine.drive().position();
        }
    }
    machine.run(20);
    let latched = machine.finish(probe.latched()).unwrap();
    // The first edge is a third of a cycle behind; another comes two thirds of one later.
    let off = i64::from(latched) - expected;
    assert!((20..=60).contains(&off), "{off} counts, at 100 a cycle");
}

#[test]
fn an_edge_outside_of_the_window_is_none_and_the_next_one_inside_is() {
    let marks = [Some(Mark::new(2_000, 2_100).every(4_000)), None];
    let (mut machine, axis) = Machine::enabled_of(&meeting(mapped(), marks));
    let pp = machine.finish(axis.profile_position()).unwrap();
    let probe = axis.probe(Probe::One).within(9_900, 10_100);
    let probe = machine.finish(probe.arm()).unwrap();
    let _moved = machine.finish(pp.move_abs(30_000, fast())).unwrap();
    assert_eq!(machine.finish(probe.latched()).unwrap(), 10_000);
}

#[test]
fn on_a_modulo_axis_an_edge_lies_in_the_turn_and_a_window_across_its_end() {
    let turn = PositionRange { min: 0, max: 3_599 };
    // Rising edges at 10 and at 1800 of each turn.
    let marks = [
        Some(Mark::new(10, 99).every(3_600)),
        Some(Mark::new(1_800, 1_899).every(3_600)),
    ];
    let mut variant = meeting(mapped(), marks);
    variant.behaviour.position_range = (0, 3_599);
    variant.modulo = Some(turn);
    // The first edge that the window lets through, of an axis that turns in positive direction from 0.
    for (probe, window, expected) in [
        (Probe::One, (3_500, 100), Some(10)),
        (Probe::Two, (3_500, 100), None),
        (Probe::Two, (1_000, 2_000), Some(1_800)),
        (Probe::One, (0, 3_599), Some(10)),
    ] {
        let (mut machine, axis) = Machine::enabled_of(&variant);
        let pp = machine.finish(axis.profile_position()).unwrap();
        let probe = axis.probe(probe).within(window.0, window.1);
        let probe = machine.finish(probe.arm()).unwrap();
        let set_point = fast().velocity(20_000);
        let _moved = machine.finish(pp.move_rel(36_000, set_point)).unwrap();
        // Two turns later.
        machine.run(400);
        let mut latched = Task::new(probe.latched());
        match expected {
            Some(at) => assert_eq!(machine.finish_task(&mut latched).unwrap(), at, "{window:?}"),
            None => machine.run_beside(&mut latched, 1_000),
        }
    }
}

/// 607Bh of it is not set, and its positions run on.
#[test]
fn a_position_beyond_the_turn_is_brought_into_it() {
    let mut variant = meeting(mapped(), [Some(Mark::new(7_210, 7_300)), None]);
    variant.modulo = Some(PositionRange { min: 0, max: 3_599 });
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let probe = armed(&mut machine, &axis);
    let _moved = machine.finish(pp.move_rel(10_000, fast())).unwrap();
    assert_eq!(machine.finish(probe.latched()).unwrap(), 10);
}

#[test]
fn a_window_that_is_empty_is_refused_and_nothing_is_sent() {
    let (mut machine, axis) = Machine::enabled_of(&mapped());
    let error = machine
        .finish(axis.probe(Probe::One).within(100, -100).arm())
        .unwrap_err();
    assert!(matches!(
        probe_error(&error),
        ProbeError::EmptyWindow { .. }
    ));
    let station = &machine.stations[0];
    let sent = |frame: &Vec<u8>| output(station, frame, 0x60B8) != 0;
    assert!(!station.frames.iter().any(sent));
}

#[test]
fn both_probes_are_armed_and_disarmed_each_without_the_other() {
    for variant in [mapped(), by_sdo()] {
        let (mut machine, axis) = Machine::enabled_of(&variant);
        let first = armed(&mut machine, &axis);
        let second = axis.probe(Probe::Two).edge(Edge::Falling);
        let second = machine.finish(second.arm()).unwrap();
        assert_eq!(function(&machine), 0x2111);
        machine.finish(first.disarm()).unwrap();
        assert_eq!(function(&machine), 0x2100);
        let first = armed(&mut machine, &axis);
        assert_eq!(function(&machine), 0x2111);
        machine.finish(second.disarm()).unwrap();
        assert_eq!(function(&machine), 0x0011);
        pulse(&machine);
        machine.finish(first.latched()).unwrap();
    }
}

#[test]
fn a_dropped_probe_is_disarmed_in_the_next_frame() {
    let (mut machine, axis) = Machine::enabled_of(&mapped());
    let first = armed(&mut machine, &axis);
    let second = machine.finish(axis.probe(Probe::Two).arm()).unwrap();
    assert_eq!(function(&machine), 0x1111);
    drop(first);
    machine.cycle();
    assert_eq!(function(&machine), 0x1100);
    drop(second);
    machine.cycle();
    assert_eq!(function(&machine), 0);
}

#[test]
fn a_probe_has_one_user_at_a_time() {
    let (mut machine, axis) = Machine::enabled_of(&mapped());
    let probe = armed(&mut machine, &axis);
    let error = machine.finish(axis.probe(Probe::One).arm()).unwrap_err();
    assert!(
        matches!(probe_error(&error), ProbeError::InUse { .. }),
        "{error}"
    );
    assert_eq!(function(&machine), 0x0011, "the first is armed still");
    drop(probe);
    drop(armed(&mut machine, &axis));
}

#[test]
fn a_drive_without_touch_probe_is_an_error_that_names_the_object() {
    let variant = Variant {
        behaviour: Behaviour::pp2010(),
        not_mapped: vec![0x606C],
        ..Variant::default()
    };
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let error = machine.finish(axis.probe(Probe::One).arm()).unwrap_err();
    assert!(matches!(probe_error(&error), ProbeError::Unreadable { .. }));
    assert!(error.to_string().contains("60B8h"), "{error}");
}

#[test]
fn a_drive_that_does_not_answer_is_an_error_within_a_second() {
    for variant in [mapped(), by_sdo()] {
        let (mut machine, axis) = Machine::enabled_of(&variant);
        machine.drive().disturbances().deaf_to_touch_probe = true;
        let began = machine.now;
        let error = machine.finish(axis.probe(Probe::One).arm()).unwrap_err();
        assert!(
            matches!(probe_error(&error), ProbeError::NoAnswer { on: true, .. }),
            "{error}"
        );
        let lasted = machine.now - began;
        assert!(lasted < Duration::from_millis(1_200), "{lasted:?}");
    }
    // One that does not give its old edge up.
    let (mut machine, axis) = Machine::enabled_of(&mapped());
    let probe = armed(&mut machine, &axis);
    machine.drive().disturbances().deaf_to_touch_probe = true;
    drop(probe);
    let error = machine.finish(axis.probe(Probe::One).arm()).unwrap_err();
    assert!(
        matches!(
            probe_error(&error),
            ProbeError::NoAnswer {
                on: false,
                status: 0x0001,
                ..
            }
        ),
        "{error}"
    );
    assert_eq!(function(&machine), 0, "and it is given up");
}

#[test]
fn a_wait_for_an_edge_ends_with_the_axis() {
    type End = fn(&mut Machine, &Axis);
    let ends: [(End, FailureClass); 5] = [
        (
            |_, axis| axis.stop_handle().quick_stop(),
            FailureClass::Aborted,
        ),
        (|_, axis| axis.stop_handle().stop(), FailureClass::Aborted),
        (
            |machine, _| machine.drive().set_voltage(false),
            FailureClass::DriveFault,
        ),
        (|machine, _| machine.silent = true, FailureClass::Lost),
        (
            |machine, _| drop(machine.stations[0].port.take()),
            FailureClass::Lost,
        ),
    ];
    for (number, (end, class)) in ends.into_iter().enumerate() {
        let (mut machine, axis) = Machine::enabled_of(&mapped());
        let pp = machine.finish(axis.profile_position()).unwrap();
        let probe = armed(&mut machine, &axis);
        let _moved = machine.finish(pp.move_abs(50_000, fast())).unwrap();
        machine.run(50);
        let mut latched = Task::new(probe.latched());
        machine.run_beside(&mut latched, 5);
        end(&mut machine, &axis);
        let error = machine.finish_task(&mut latched).unwrap_err();
        let failure = error.failure().expect("the axis has failed");
        assert_eq!(failure.class(), class, "{number}: {error}");
        // Asked again it ends at once, where nothing was enabled since.
        let error = machine.finish(probe.latched()).unwrap_err();
        assert!(error.failure().is_some(), "{number}: {error}");
    }
}

#[test]
fn a_halt_ends_no_wait_for_an_edge() {
    let marks = [Some(Mark::new(40_000, i64::MAX)), None];
    let (mut machine, axis) = Machine::enabled_of(&meeting(mapped(), marks));
    let pp = machine.finish(axis.profile_position()).unwrap();
    let probe = armed(&mut machine, &axis);
    let _moved = machine.finish(pp.move_abs(50_000, fast())).unwrap();
    machine.run(50);
    machine.finish(axis.halt()).unwrap();
    let mut latched = Task::new(probe.latched());
    machine.run_beside(&mut latched, 50);
    machine.finish(axis.resume()).unwrap();
    assert_eq!(machine.finish_task(&mut latched).unwrap(), 40_000);
}

#[test]
fn an_axis_without_power_is_probed_by_hand_and_an_end_of_its_power_is_none() {
    let variant = meeting(mapped(), [Some(Mark::new(500, i64::MAX)), None]);
    let mut machine = Machine::of(1, &variant);
    let axis = machine.axis(0);
    assert_eq!(axis.status().state, State::SwitchOnDisabled);
    let probe = armed(&mut machine, &axis);
    let mut latched = Task::new(probe.latched());
    machine.run_beside(&mut latched, 20);
    machine.drive().place(900);
    assert_eq!(machine.finish_task(&mut latched).unwrap(), 500);
}

#[test]
fn a_probe_that_the_drive_switches_off_is_an_error() {
    let (mut machine, axis) = Machine::enabled_of(&by_sdo());
    let probe = armed(&mut machine, &axis);
    let mut latched = Task::new(probe.latched());
    machine.run_beside(&mut latched, 5);
    // Another program.
    machine.drive().set(0x60B8, 0, 0).unwrap();
    let error = machine.finish_task(&mut latched).unwrap_err();
    assert!(
        matches!(probe_error(&error), ProbeError::SwitchedOff { .. }),
        "{error}"
    );
}

#[test]
fn inputs_that_do_not_come_hold_no_edge_back_and_make_none() {
    let marks = [Some(Mark::new(12_345, i64::MAX)), None];
    let (mut machine, axis) = Machine::enabled_of(&meeting(mapped(), marks));
    let pp = machine.finish(axis.profile_position()).unwrap();
    let probe = armed(&mut machine, &axis);
    let _moved = machine.finish(pp.move_abs(30_000, fast())).unwrap();
    let mut latched = Task::new(probe.latched());
    let end = loop {
        machine.silent = !machine.silent;
        if let Some(end) = latched.poll() {
            break end;
        }
        machine.cycle();
    };
    assert_eq!(end.unwrap(), 12_345);
}

// Each edge.

#[test]
fn each_edge_of_a_continuous_probe_comes_once_and_what_is_missed_is_counted() {
    for variant in [mapped(), by_sdo()] {
        let marks = [Some(Mark::new(2_000, 2_100).every(2_000)), None];
        let (mut machine, axis) = Machine::enabled_of(&meeting(variant, marks));
        let pp = machine.finish(axis.profile_position()).unwrap();
        let mut probe = machine
            .finish(axis.probe(Probe::One).arm_continuous())
            .unwrap();
        let moved = machine.finish(pp.move_abs(9_000, fast())).unwrap();
        for position in [2_000, 4_000, 6_000, 8_000] {
            let edge = machine.finish(probe.latched()).unwrap();
            assert_eq!((edge.position, edge.missed), (position, 0));
        }
        machine.finish(moved.done()).unwrap();
        let mut latched = Task::new(probe.latched());
        machine.run_beside(&mut latched, 100);
        drop(latched);
        // Back to where it was: 2099 and 99 come while nobody looks.
        let moved = machine.finish(pp.move_abs(50, fast())).unwrap();
        machine.finish(moved.done()).unwrap();
        let edge = machine.finish(probe.latched()).unwrap();
        assert_eq!((edge.position, edge.missed), (100, 4));
    }
}

/// A mark that comes by in the same place of each turn.
#[test]
fn two_edges_at_the_same_position_are_two() {
    let (mut machine, axis) = Machine::enabled_of(&Variant {
        behaviour: Behaviour::generic().with_plant(Plant::ideal()),
        ..mapped()
    });
    let probe = axis.probe(Probe::One);
    let mut probe = machine.finish(probe.arm_continuous()).unwrap();
    for _ in 0..3 {
        pulse(&machine);
        let edge = machine.finish(probe.latched()).unwrap();
        assert_eq!((edge.position, edge.missed), (0, 0));
        let mut next = Task::new(probe.latched());
        machine.run_beside(&mut next, 20);
    }
}

#[test]
fn a_continuous_probe_begins_without_the_edges_before_it() {
    let (mut machine, axis) = Machine::enabled_of(&mapped());
    let probe = machine
        .finish(axis.probe(Probe::One).arm_continuous())
        .unwrap();
    for _ in 0..3 {
        pulse(&machine);
        machine.run(10);
    }
    drop(probe);
    let mut probe = machine
        .finish(axis.probe(Probe::One).arm_continuous())
        .unwrap();
    let mut latched = Task::new(probe.latched());
    machine.run_beside(&mut latched, 100);
    pulse(&machine);
    let edge = machine.finish_task(&mut latched).unwrap();
    assert_eq!(edge.missed, 0);
}

#[test]
fn a_continuous_probe_needs_the_drives_counter() {
    let mut variant = mapped();
    variant.behaviour.without = &[0x60D6];
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let probe = axis.probe(Probe::One).edge(Edge::Falling);
    let error = machine.finish(probe.arm_continuous()).unwrap_err();
    assert!(matches!(probe_error(&error), ProbeError::Unreadable { .. }));
    assert!(error.to_string().contains("60D6h"), "{error}");
}

// A move until an edge.

/// Whether it holds decides how the move ends; that it does, and that its set-point is gone, does not depend on that.
fn holding() -> Variant {
    let variant = mapped();
    Variant {
        traits: Traits {
            acknowledges_while_halted: true,
            ..variant.traits
        },
        ..variant
    }
}

#[test]
fn a_move_until_a_probe_ends_at_the_edge_and_no_set_point_is_left() {
    let marks = [Some(Mark::new(12_345, i64::MAX)), None];
    for (variant, stays_enabled) in [(mapped(), false), (holding(), true)] {
        let (mut machine, axis) = Machine::enabled_of(&meeting(variant, marks));
        let pp = machine.finish(axis.profile_position()).unwrap();
        let request = pp.abs(100_000, fast());
        let probed = machine.finish(pp.move_until_probe(request, axis.probe(Probe::One)));
        assert_eq!(probed.unwrap(), Probed::Edge { position: 12_345 });
        assert!(machine.stands());
        let state = axis.status().state;
        assert_eq!(state == State::OperationEnabled, stays_enabled);
        // 100 counts a cycle; two cycles until the stop is in a frame, and its ramp of 5000.
        let stood = machine.drive().position();
        assert!((12_345..18_500).contains(&stood), "{stood}");
        machine.cycle();
        assert_eq!(function(&machine), 0, "disarmed");
        machine.finish(axis.enable()).unwrap();
        machine.run(200);
        let off = machine.drive().position() - stood;
        assert!(off.abs() < 20, "nothing is left of the move");
        let moved = machine.finish(pp.move_abs(1_000, fast())).unwrap();
        machine.finish(moved.done()).unwrap();
        assert!(machine.is_at(1_000));
    }
}

#[test]
fn a_move_until_a_probe_that_meets_nothing_arrives() {
    let (mut machine, axis) = Machine::enabled_of(&mapped());
    let pp = machine.finish(axis.profile_position()).unwrap();
    let request = pp.rel(10_000, fast());
    let probed = machine.finish(pp.move_until_probe(request, axis.probe(Probe::One)));
    assert!(matches!(probed, Ok(Probed::NoEdge(_))), "{probed:?}");
    assert!(machine.is_at(10_000));
    assert_eq!(axis.status().state, State::OperationEnabled);
}

/// The program is busy until the move has arrived, and a look by SDO takes a while then.
#[test]
fn an_edge_at_the_end_of_a_move_is_found() {
    let marks = [Some(Mark::new(9_000, i64::MAX)), None];
    let (mut machine, axis) = Machine::enabled_of(&meeting(by_sdo(), marks));
    let sdo = Arc::clone(&machine.stations[0].sdo);
    sdo.slow.store(true, Ordering::Relaxed);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let request = pp.abs(10_000, fast());
    let mut probed = Task::new(pp.move_until_probe(request, axis.probe(Probe::One)));
    while axis.status().position < 2_000 {
        assert!(probed.poll().is_none());
        machine.cycle();
    }
    machine.run(1_000);
    assert!(machine.is_at(10_000));
    let probed = machine.finish_task(&mut probed).unwrap();
    assert_eq!(probed, Probed::Edge { position: 9_000 });
    assert_eq!(axis.status().state, State::OperationEnabled);
}

#[test]
fn a_move_whose_probe_is_refused_does_not_begin() {
    let (mut machine, axis) = Machine::enabled_of(&mapped());
    let pp = machine.finish(axis.profile_position()).unwrap();
    machine.drive().disturbances().deaf_to_touch_probe = true;
    let request = pp.abs(10_000, fast());
    let probed = machine.finish(pp.move_until_probe(request, axis.probe(Probe::One)));
    assert!(matches!(
        probe_error(&probed.unwrap_err()),
        ProbeError::NoAnswer { .. }
    ));
    machine.run(100);
    assert!(machine.drive().ledger().is_empty());
}

#[test]
fn a_stop_while_the_probe_is_being_armed_stops_the_move_as_well() {
    let (mut machine, axis) = Machine::enabled_of(&mapped());
    let pp = machine.finish(axis.profile_position()).unwrap();
    let request = pp.abs(10_000, fast());
    let mut probed = Task::new(pp.move_until_probe(request, axis.probe(Probe::One)));
    machine.run_beside(&mut probed, 3);
    axis.stop_handle().stop();
    let error = machine.finish_task(&mut probed).unwrap_err();
    assert!(
        matches!(error.failure(), Some(Failure::QuickStopped { .. })),
        "{error}"
    );
    machine.run(100);
    assert!(machine.drive().ledger().is_empty());
}

#[test]
fn a_move_until_a_probe_that_nobody_waits_for_any_more_is_halted() {
    let (mut machine, axis) = Machine::enabled_of(&mapped());
    let pp = machine.finish(axis.profile_position()).unwrap();
    let request = pp.abs(100_000, fast());
    let mut probed = Task::new(pp.move_until_probe(request, axis.probe(Probe::One)));
    machine.run_beside(&mut probed, 200);
    assert!(!machine.stands());
    drop(probed);
    machine.run(300);
    assert!(machine.stands() && axis.status().halted);
    assert_eq!(function(&machine), 0);
}

#[test]
fn a_move_goes_no_further_when_its_probe_is_gone() {
    let mut variant = mapped();
    variant.mapped_too.clear();
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pp = machine.finish(axis.profile_position()).unwrap();
    let request = pp.abs(100_000, fast());
    let mut probed = Task::new(pp.move_until_probe(request, axis.probe(Probe::One)));
    machine.run_beside(&mut probed, 200);
    machine.drive().set(0x60B8, 0, 0).unwrap();
    let error = machine.finish_task(&mut probed).unwrap_err();
    assert!(
        matches!(probe_error(&error), ProbeError::SwitchedOff { .. }),
        "{error}"
    );
    assert!(machine.stands());
    let outcome = machine.drive().ledger()[0].outcome;
    assert!(
        matches!(outcome, ds402::Outcome::Discarded(_)),
        "{outcome:?}"
    );
}
