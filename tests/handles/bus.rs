//! What becomes of futures when the bus goes away.

use servocrab::{
    Failure, SetPoint,
    axis::{AxisErrorKind, Delivery},
};

use crate::machine::{Machine, Task};

#[test]
fn every_future_resolves_when_the_bus_thread_ends_and_says_how_far_its_set_point_came() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(90_000, SetPoint::new()))
        .unwrap();
    let mut done = Task::new(moved.done());
    let mut changed = Task::new(axis.changed());
    let mut unsent = Task::new(pp.move_abs(1, SetPoint::new()));
    assert!(done.poll().is_none() && unsent.poll().is_none() && changed.poll().is_none());
    // As a panic of the bus thread drops it.
    machine.stations[0].port = None;
    let lost = |delivery| Some(Failure::BusLost { delivery });
    assert_eq!(
        done.poll().unwrap().unwrap_err().failure(),
        lost(Delivery::Accepted)
    );
    assert_eq!(
        unsent.poll().unwrap().unwrap_err().failure(),
        lost(Delivery::NotSent)
    );
    assert!(changed.poll().unwrap().unwrap().lost);
    // A loop over the changes ends with the bus.
    assert_eq!(Task::new(axis.changed()).poll(), Some(None));
    assert!(axis.status().lost);
    let refused = Task::new(axis.enable()).poll().unwrap().unwrap_err();
    assert!(matches!(refused.kind, AxisErrorKind::Closed));
}

#[test]
fn what_fails_by_a_loss_says_of_a_set_point_only_what_it_knows() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(90_000, SetPoint::new()))
        .unwrap();
    let mut done = Task::new(moved.done());
    let mut disabled = Task::new(axis.disable());
    assert!(done.poll().is_none() && disabled.poll().is_none());
    // It is taken and sent.
    machine.cycle();
    assert!(disabled.poll().is_none());
    machine.stations[0].port = None;
    let text = |error: &dyn std::fmt::Display| error.to_string();
    let moved = text(&done.poll().unwrap().unwrap_err());
    assert!(!moved.contains("no set-point was sent"), "{moved}");
    // It has none, and its axis was moved by another.
    let disabled = text(&disabled.poll().unwrap().unwrap_err());
    assert!(
        disabled.ends_with("the drive no longer answers"),
        "{disabled}"
    );
    let fallen = Failure::LeftOp {
        delivery: Delivery::NotSent,
        code: 0x001B,
    };
    assert!(!text(&fallen).contains("set-point"), "{fallen}");
}

#[test]
fn a_move_between_bit_4_and_its_acknowledge_is_unknown_when_the_bus_thread_ends() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let mut moving = Task::new(pp.move_abs(1, SetPoint::new()));
    assert!(moving.poll().is_none());
    while machine.stations[0].words.last().unwrap() & 0x10 == 0 {
        machine.cycle();
    }
    machine.stations[0].port = None;
    let delivery = Delivery::Unknown;
    assert_eq!(
        moving.poll().unwrap().unwrap_err().failure(),
        Some(Failure::BusLost { delivery })
    );
}

#[test]
fn an_outcome_that_came_before_the_end_is_not_lost_with_the_bus() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine.finish(pp.move_abs(100, SetPoint::new())).unwrap();
    machine.run(500);
    machine.stations[0].port = None;
    assert!(Task::new(moved.done()).poll().unwrap().is_ok());
}

#[test]
fn a_drive_that_falls_silent_ends_every_wait_within_its_limit_of_cycles() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine
        .finish(pp.move_abs(90_000, SetPoint::new()))
        .unwrap();
    let mut done = Task::new(moved.done());
    assert!(done.poll().is_none());
    machine.silent = true;
    machine.run(10);
    let delivery = Delivery::Accepted;
    assert_eq!(
        done.poll().unwrap().unwrap_err().failure(),
        Some(Failure::BusLost { delivery })
    );
    assert!(axis.status().lost);
}
