//! The lease of the mode.

use servocrab::axis::{AxisErrorKind, Failure};
use servocrab::ds402::Mode;
use servocrab::profile_position::SetPoint;

use crate::machine::{Machine, Task, Variant};

#[test]
fn a_second_lease_is_refused_until_the_first_is_given_back() {
    let (mut machine, axis) = Machine::enabled();
    let first = machine.finish(axis.profile_position()).unwrap();
    let second = machine.finish(axis.clone().profile_position()).unwrap_err();
    assert!(matches!(second.kind, AxisErrorKind::ModeInUse));
    machine.finish(first.release()).unwrap();
    let third = machine.finish(axis.profile_position()).unwrap();
    drop(third);
    assert!(machine.finish(axis.profile_position()).is_ok());
}

#[test]
fn a_lease_that_was_asked_for_and_dropped_is_given_back() {
    let (mut machine, axis) = Machine::enabled();
    let mut asking = Task::new(axis.profile_position());
    assert!(asking.poll().is_none());
    drop(asking);
    machine.run(10);
    assert!(machine.finish(axis.profile_position()).is_ok());
}

#[test]
fn release_stops_a_moving_axis_and_abandons_its_set_point() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(900_000, SetPoint::new()))
        .unwrap();
    machine.run(100);
    machine.finish(pp.release()).unwrap();
    assert_eq!(machine.drive().velocity(), 0.0);
    let ended = machine.finish(moved.done_through_halt()).unwrap_err();
    assert_eq!(ended.failure(), Some(Failure::QuickStopped));
}

#[test]
fn a_mode_that_is_not_in_the_process_data_is_selected_and_confirmed_by_sdo() {
    let variant = Variant {
        not_mapped: vec![0x6060, 0x6061],
        ..Variant::default()
    };
    let mut machine = Machine::of(1, &variant);
    let axis = machine.axis(0);
    machine.finish(axis.enable()).unwrap();
    let pp = {
        let mut leasing = Task::new(axis.profile_position());
        // 6061h is read by the program's clock.
        let mut leased = leasing.poll();
        for _ in 0..200 {
            if leased.is_some() {
                break;
            }
            machine.cycle();
            std::thread::sleep(std::time::Duration::from_millis(1));
            leased = leasing.poll();
        }
        leased.unwrap().unwrap()
    };
    assert_eq!(axis.status().mode, Mode::ProfilePosition);
    let written = machine.stations[0].sdo.written.lock().unwrap().clone();
    assert_eq!(written, [(0x6060, vec![1])]);
    let moved = machine.finish(pp.move_abs(500, SetPoint::new())).unwrap();
    machine.finish(moved.done()).unwrap();
}
