//! Motions that were asked for and have not reached the axis yet, when the drive stops it by itself: none follows after the axis was
//! enabled again.

use servocrab::{
    Axis, Failure, HomingMethod, HomingParameters, SetPoint, axis::Delivery, ds402::State,
    profile_velocity::JogSetPoint,
};

use crate::machine::{Machine, Task, kept, slow};

/// What takes the axis out of Operation enabled.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Cause {
    Fault,
    /// Its input for a safe stop.
    Inhibited,
    /// No frame comes back for a while.
    Silence,
}

const CAUSES: [Cause; 3] = [Cause::Fault, Cause::Inhibited, Cause::Silence];

/// Until the axis is enabled once more, by another task.
fn enabled_again(machine: &mut Machine, axis: &Axis, cause: Cause) {
    match cause {
        Cause::Fault => machine.drive().inject_fault(0x7305),
        Cause::Inhibited => machine.drive().set_inhibited(true),
        Cause::Silence => machine.silent = true,
    }
    machine.run(200);
    machine.drive().set_inhibited(false);
    machine.silent = false;
    machine.run(200);
    machine.finish(axis.reset_fault()).unwrap();
    machine.finish(axis.enable()).unwrap();
    assert_eq!(axis.status().state, State::OperationEnabled);
}

fn is_of(cause: Cause, failure: Option<Failure>) -> bool {
    match failure {
        Some(Failure::Fault { .. }) => cause == Cause::Fault,
        Some(Failure::Disabled { .. }) => cause == Cause::Inhibited,
        Some(Failure::BusLost { delivery }) => {
            cause == Cause::Silence && delivery == Delivery::NotSent
        }
        _ => false,
    }
}

#[test]
fn a_move_that_was_being_written_ends_with_what_has_stopped_the_axis() {
    for cause in CAUSES {
        let (mut machine, axis) = slow();
        let pp = machine.finish(axis.profile_position()).unwrap();
        let fast = SetPoint::new().velocity(60_000).acceleration(600_000);
        let mut moved = Task::new(pp.move_rel(9_000, fast));
        kept(&mut machine, &mut moved);
        enabled_again(&mut machine, &axis, cause);
        let result = machine.finish_task(&mut moved);
        machine.run(500);
        assert!(machine.drive().ledger().is_empty(), "{cause:?}: it moved");
        let error = result.unwrap_err();
        assert!(is_of(cause, error.failure()), "{cause:?}: {error:?}");
        // The next one is asked for by somebody who knows.
        let moved = machine.finish(pp.move_rel(900, fast)).unwrap();
        machine.finish(moved.done()).unwrap();
    }
}

#[test]
fn a_homing_that_was_being_written_ends_with_what_has_stopped_the_axis() {
    let to_the_switch = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
        .speeds(20_000, 2_000)
        .acceleration(200_000);
    for cause in CAUSES {
        let (mut machine, axis) = slow();
        let homing = machine.finish(axis.homing()).unwrap();
        let mut home = Task::new(homing.home(to_the_switch));
        kept(&mut machine, &mut home);
        enabled_again(&mut machine, &axis, cause);
        let result = machine.finish_task(&mut home);
        assert!(machine.drive().homings().is_empty(), "{cause:?}: it homed");
        let error = result.unwrap_err();
        assert!(is_of(cause, error.failure()), "{cause:?}: {error:?}");
        machine.finish(homing.home(to_the_switch)).unwrap();
    }
}

#[test]
fn a_jog_that_was_being_written_ends_with_what_has_stopped_the_axis() {
    let ramps = JogSetPoint::new(3_000)
        .acceleration(200_000)
        .deceleration(300_000);
    for cause in CAUSES {
        let (mut machine, axis) = slow();
        let pv = machine.finish(axis.profile_velocity()).unwrap();
        let mut jog = Task::new(pv.jog(ramps));
        kept(&mut machine, &mut jog);
        enabled_again(&mut machine, &axis, cause);
        let result = machine.finish_task(&mut jog);
        machine.run(20);
        assert_eq!(machine.drive().demand().1, 0.0, "{cause:?}: it moves");
        let error = result.unwrap_err();
        assert!(is_of(cause, error.failure()), "{cause:?}: {error:?}");
        drop(machine.finish(pv.jog(ramps)).unwrap());
    }
}

#[test]
fn a_path_is_over_with_what_has_stopped_the_axis_between_two_of_its_moves() {
    for cause in CAUSES {
        let (mut machine, axis) = Machine::enabled();
        let pp = machine.finish(axis.profile_position()).unwrap();
        let (give, moves) = smol::channel::unbounded();
        let mut path = pp.follow(moves);
        give.try_send(pp.abs(1_000, SetPoint::new())).unwrap();
        machine.finish(path.next()).unwrap().unwrap();
        enabled_again(&mut machine, &axis, cause);
        give.try_send(pp.abs(2_000, SetPoint::new())).unwrap();
        let result = machine.finish(path.next()).unwrap();
        machine.run(500);
        assert_eq!(machine.drive().ledger().len(), 1, "{cause:?}: it moved");
        let error = result.unwrap_err().error;
        assert!(is_of(cause, error.failure()), "{cause:?}: {error:?}");
    }
}

#[test]
fn a_lease_that_was_being_selected_ends_with_the_fault_and_its_code() {
    let (mut machine, axis) = Machine::enabled();
    let mut leased = Task::new(axis.profile_position());
    assert!(leased.poll().is_none());
    // The mode is selected, and its task hears of it later.
    machine.run(10);
    machine.drive().inject_fault(0x7305);
    machine.run(10);
    let error = machine.finish_task(&mut leased).unwrap_err();
    let code = Some(0x7305);
    assert_eq!(
        error.failure(),
        Some(Failure::Fault {
            code,
            following_error: false
        }),
        "{error}"
    );
}
