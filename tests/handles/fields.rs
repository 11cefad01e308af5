//! Further objects in the process data, the manufacturer's bits, and waiting for changes.

use servocrab::{
    Failure, SetPoint,
    axis::{AxisErrorKind, Sampled, Stale, TorqueLimit},
    coe::{Object, ReadWrite, obj},
    ds402::{Controlword, State},
};

use servocrab_sim::ds402::{Behaviour, Plant};

use crate::machine::{Machine, Task, Variant};

#[test]
fn a_mapped_input_is_that_of_the_last_cycle_or_stale() {
    let mut machine = Machine::new(1);
    let inputs = machine.axis(0).input(obj::DIGITAL_INPUTS).unwrap();
    machine.drive().set_digital_inputs(0xA5A5_0102);
    machine.run(2);
    assert_eq!(inputs.get(), Ok(0xA5A5_0102));
    machine.silent = true;
    machine.run(2);
    assert_eq!(inputs.get(), Err(Stale { age: Some(2) }));
    let value = 0xA5A5_0102;
    assert_eq!(inputs.last(), Some(Sampled { value, age: 2 }));
}

#[test]
fn a_mapped_output_is_sent_once_it_is_set_and_disturbs_nothing() {
    let (mut machine, axis) = Machine::enabled();
    let outputs = axis.output(obj::DIGITAL_OUTPUTS).unwrap();
    assert_eq!(outputs.get(), None);
    outputs.set(0x8001_0000);
    machine.run(2);
    assert_eq!(machine.drive().get(0x60FE, 1), Some(0x8001_0000));
    assert_eq!(outputs.get(), Some(0x8001_0000));
    assert_eq!(axis.status().state, State::OperationEnabled);
}

#[test]
fn what_the_axis_writes_itself_cannot_be_written_by_the_program() {
    let axis = Machine::new(1).axis(0);
    let controlword = axis.output(obj::CONTROLWORD).unwrap_err();
    assert!(matches!(
        controlword.kind,
        AxisErrorKind::OwnedByAxis { .. }
    ));
    let of_another_axis: Object<i32, ReadWrite> = obj::TARGET_POSITION.axis(2);
    let target = axis.output(of_another_axis).unwrap_err();
    assert!(matches!(target.kind, AxisErrorKind::OwnedByAxis { .. }));
}

#[test]
fn an_object_that_is_not_mapped_or_not_so_wide_is_an_error_that_names_it() {
    let axis = Machine::new(1).axis(0);
    let missing = axis.input(obj::POSITION_DEMAND).unwrap_err();
    assert!(matches!(missing.kind, AxisErrorKind::Field(_)));
    assert!(missing.to_string().contains("6062h"), "{missing}");
    const NARROW: Object<u16, ReadWrite> = Object::new(0x60FD, 0, "digital inputs");
    assert!(axis.input(NARROW).is_err());
}

#[test]
fn the_manufacturers_bits_are_the_programs_and_no_others() {
    let (mut machine, axis) = Machine::enabled();
    axis.set_manufacturer_bits(Controlword::all());
    machine.run(3);
    assert_eq!(*machine.stations[0].words.last().unwrap(), 0xF80F);
    axis.set_manufacturer_bits(Controlword::empty());
    machine.run(3);
    assert_eq!(*machine.stations[0].words.last().unwrap(), 0x000F);
}

#[test]
fn a_wait_for_a_change_ends_with_the_change_and_not_with_the_cycle() {
    // The ideal axis: whatever changes is changed by the test.
    let variant = Variant {
        behaviour: Behaviour::akd2g().with_plant(Plant::ideal()),
        ..Variant::default()
    };
    let (mut machine, axis) = Machine::enabled_of(&variant);
    machine.run(10);
    let mut first = Task::new(axis.changed());
    let mut second = Task::new(axis.changed());
    for _ in 0..50 {
        assert!(first.poll().is_none() && second.poll().is_none());
        machine.cycle();
    }
    machine.drive().set_warning(true);
    let status = machine.finish_task(&mut first).unwrap();
    assert_ne!(status.statusword.bits() & 0x80, 0);
    assert_eq!(machine.finish_task(&mut second), Some(status));
}

#[test]
fn missing_inputs_show_in_the_status() {
    let (mut machine, axis) = Machine::enabled();
    let mut changing = Task::new(axis.changed());
    assert!(changing.poll().is_none());
    machine.silent = true;
    let status = machine.finish_task(&mut changing).unwrap();
    assert!(!status.answered);
    machine.run(3);
    assert_eq!(axis.status().age, 4);
}

#[test]
fn a_handle_in_a_log_names_its_axis_and_fits_a_line() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(1_000, servocrab::SetPoint::new()))
        .unwrap();
    let texts = [
        format!("{axis:?}"),
        format!("{pp:?}"),
        format!("{moved:?}"),
        format!("{:?}", axis.stop_handle()),
    ];
    for text in texts {
        assert!(text.contains("axis0") && text.len() < 500, "{text}");
    }
}

/// By SDO, and by the process data where it is mapped: then an SDO would be overwritten.
#[test]
fn a_torque_limit_holds_until_it_is_restored_and_that_is_refused_in_motion() {
    for mapped_too in [Vec::new(), vec![obj::MAX_TORQUE.into()]] {
        let variant = Variant {
            mapped_too,
            ..Variant::default()
        };
        let (mut machine, axis) = Machine::enabled_of(&variant);
        let at_first = machine.drive().get(0x6072, 0).unwrap();
        let limited = axis.limit_torque(TorqueLimit::Both(300));
        let limited = machine.finish(limited).unwrap();
        machine.run(2);
        assert_eq!(machine.drive().get(0x6072, 0), Some(300));
        let positions = machine.finish(axis.profile_position()).unwrap();
        let motion = machine.finish(positions.move_abs(20_000, SetPoint::new()));
        let motion = motion.unwrap();
        let error = machine.finish(limited.restore()).unwrap_err();
        assert_eq!(error.failure(), Some(Failure::Moving));
        machine.run(2);
        assert_eq!(machine.drive().get(0x6072, 0), Some(300));
        machine.finish(motion.done()).unwrap();
        machine.finish(limited.restore()).unwrap();
        machine.run(2);
        assert_eq!(machine.drive().get(0x6072, 0), Some(at_first));
    }
    let behaviour = Behaviour {
        without: &[0x60E0],
        ..Behaviour::akd2g()
    };
    let variant = Variant {
        behaviour,
        ..Variant::default()
    };
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let limited = machine.finish(axis.limit_torque(TorqueLimit::Positive(300)));
    let error = limited.unwrap_err();
    assert!(matches!(error.kind, AxisErrorKind::Sdo(_)), "{error}");
    assert!(error.to_string().contains("60E0h"), "{error}");
}
