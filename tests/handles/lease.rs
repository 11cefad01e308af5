//! The lease of the mode.

use core::sync::atomic::Ordering;

use servocrab::SetPoint;
use servocrab::coe::obj;
use servocrab::ds402::Mode;
use servocrab::{
    Axis, Failure,
    axis::{AxisErrorKind, Delivery},
    start_together,
};
use servocrab_sim::ds402::Behaviour;

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
    assert!(machine.stands());
    let ended = machine.finish(moved.done_through_halt()).unwrap_err();
    assert_eq!(
        ended.failure(),
        Some(Failure::QuickStopped {
            delivery: Delivery::Accepted
        })
    );
}

#[test]
fn a_mode_that_is_not_in_the_process_data_is_selected_and_confirmed_by_sdo() {
    let variant = Variant {
        not_mapped: vec![0x6060, 0x6061],
        ..Variant::default()
    };
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let pp = { machine.finish(axis.profile_position()).unwrap() };
    assert_eq!(axis.status().mode, Mode::ProfilePosition);
    let written = machine.stations[0].sdo.written.lock().unwrap().clone();
    assert_eq!(written, [(0x6060, vec![1])]);
    let moved = machine.finish(pp.move_abs(500, SetPoint::new())).unwrap();
    machine.finish(moved.done()).unwrap();
}

/// From the moment at which 6060h may be written by SDO to the one at which the mode is shown, no move of the old mode starts,
/// whoever has kept one.
#[test]
fn no_move_starts_while_the_mode_is_being_changed_by_sdo() {
    let variant = Variant {
        not_mapped: vec![0x6060],
        ..Variant::default()
    };
    for cycles in 0..8 {
        let (mut machine, axis) = Machine::enabled_of(&variant);
        let pp = machine.finish(axis.profile_position()).unwrap();
        let kept = pp.abs(5_000, SetPoint::new());
        drop(pp);
        let from = machine.stations[0].words.len();
        let mut homing = Task::new(axis.homing());
        assert!(homing.poll().is_none());
        machine.run(cycles);
        // The program is not quick: 6060h has not been written.
        // The move is of a lease before, and the axis is that of the homing.
        let started = machine.finish(start_together([kept]));
        let homing = machine.finish_task(&mut homing);
        // Either the one or the other.
        assert!(homing.is_err() || started.is_err(), "after {cycles} cycles");
        let words = &machine.stations[0].words[from..];
        let raised = words.iter().any(|word| word & 0x10 != 0);
        let changed = machine.drive().get(0x6060, 0) == Some(6);
        assert!(!(raised && changed), "after {cycles} cycles");
    }
}

/// With neither 6060h nor 6061h in the process data, and a drive that is slow to change its mode.
fn slow_by_sdo() -> (Machine, Axis) {
    Machine::enabled_of(&Variant {
        not_mapped: vec![0x6060, 0x6061],
        behaviour: Behaviour {
            mode_change_cycles: 60,
            ..Behaviour::akd2g()
        },
        ..Variant::default()
    })
}

/// Until 6060h is that of homing, and 6061h is not yet.
fn until_homing_is_written<T>(machine: &mut Machine, homing: &mut Task<'_, T>) {
    while machine.drive().get(0x6060, 0) != Some(6) {
        assert!(homing.poll().is_none());
        machine.cycle();
    }
}

/// 6061h is not in the process data: what was read there before a change that nobody awaited says nothing.
#[test]
fn a_mode_that_was_read_before_a_change_was_given_up_is_read_again() {
    let (mut machine, axis) = slow_by_sdo();
    drop(machine.finish(axis.profile_position()).unwrap());
    let mut homing = Task::new(axis.homing());
    until_homing_is_written(&mut machine, &mut homing);
    drop(homing);
    machine.run(5_000);
    assert_eq!(machine.drive().get(0x6061, 0), Some(6));
    // What was read of mode 1 before is all that there is for a while.
    machine.stations[0].sdo.slow.store(true, Ordering::Relaxed);
    let pp = machine.finish(axis.profile_position()).unwrap();
    assert_eq!(machine.drive().get(0x6061, 0), Some(1));
    let moved = machine.finish(pp.move_abs(500, SetPoint::new())).unwrap();
    machine.finish(moved.done()).unwrap();
    assert!(machine.drive().homings().is_empty());
}

/// Neither 6060h nor 6061h is in the process data. A dropped lease leaves the motion alone, and the next one finds the mode as it is.
#[test]
fn the_mode_of_an_axis_in_motion_or_halted_is_leased_again_and_nothing_is_written() {
    let variant = Variant {
        not_mapped: vec![0x6060, 0x6061],
        ..Variant::default()
    };
    for halted in [false, true] {
        let (mut machine, axis) = Machine::enabled_of(&variant);
        let pp = machine.finish(axis.profile_position()).unwrap();
        let moved = machine
            .finish(pp.move_abs(20_000, SetPoint::new()))
            .unwrap();
        machine.run(50);
        drop(pp);
        if halted {
            machine.finish(axis.halt()).unwrap();
        }
        let written = machine.stations[0].sdo.written.lock().unwrap().len();
        let _again = machine.finish(axis.profile_position()).unwrap();
        let writes = machine.stations[0].sdo.written.lock().unwrap().len();
        assert_eq!(writes, written);
        if halted {
            machine.finish(axis.resume()).unwrap();
        } else {
            machine.finish(moved.done()).unwrap();
        }
        machine.run(2_000);
        let position = machine.drive().position();
        assert!((19_990..=20_010).contains(&position), "{position}");
    }
}

/// Neither 6060h nor 6061h is in the process data: nothing takes 6060h back, so the drive may come to the mode at any time.
#[test]
fn no_move_starts_after_a_mode_that_was_written_by_sdo_was_given_up() {
    let (mut machine, axis) = slow_by_sdo();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let kept = pp.abs(5_000, SetPoint::new());
    drop(pp);
    let mut homing = Task::new(axis.homing());
    until_homing_is_written(&mut machine, &mut homing);
    // 6061h is read, and shows mode 1 still.
    for _ in 0..20 {
        assert!(homing.poll().is_none());
        machine.cycle();
    }
    drop(homing);
    machine.run(5_000);
    assert_eq!(machine.drive().get(0x6061, 0), Some(6));
    let refused = machine.finish(start_together([kept])).unwrap_err();
    assert!(
        matches!(refused.kind, AxisErrorKind::NotLeased),
        "{refused:?}"
    );
    machine.run(100);
    assert!(machine.drive().homings().is_empty());
    let pp = machine.finish(axis.profile_position()).unwrap();
    let moved = machine.finish(pp.move_abs(500, SetPoint::new())).unwrap();
    machine.finish(moved.done()).unwrap();
}

/// Nobody has the axis: it moves for nobody.
#[test]
fn a_request_of_a_lease_that_was_given_back_moves_no_axis() {
    for released in [false, true] {
        let (mut machine, axis) = Machine::enabled();
        let pp = machine.finish(axis.profile_position()).unwrap();
        let kept = pp.abs(50_000, SetPoint::new());
        if released {
            machine.finish(pp.release()).unwrap();
        } else {
            drop(pp);
        }
        let refused = machine.finish(start_together([kept])).unwrap_err();
        assert!(
            matches!(refused.kind, AxisErrorKind::NotLeased),
            "{refused:?}"
        );
        machine.run(1_000);
        assert!(machine.drive().ledger().is_empty());
    }
}

/// A move that was made before its lease was given back belongs to nobody any more.
#[test]
fn a_request_of_a_lease_that_was_given_back_does_not_move_the_axis_of_the_next_one() {
    let (mut machine, axis) = Machine::enabled();
    let first = machine.finish(axis.profile_position()).unwrap();
    let kept = first.abs(50_000, SetPoint::new());
    machine.finish(first.release()).unwrap();
    // Another task has the axis to itself now.
    let second = machine.finish(axis.profile_position()).unwrap();
    let own = machine
        .finish(second.move_abs(500, SetPoint::new()))
        .unwrap();
    let started = machine.finish(start_together([kept]));
    let outcome = machine.finish(own.done());
    assert!(
        started.is_err(),
        "it is started, and the move of the lease ends so: {outcome:?}"
    );
}

/// A stop of a standing axis has nothing to stop. What the program was about to move by that lease does not move.
#[test]
fn a_stop_that_comes_while_the_mode_is_selected_ends_that_too() {
    for not_mapped in [vec![], vec![0x6060], vec![0x6060, 0x6061]] {
        let variant = Variant {
            not_mapped,
            behaviour: Behaviour {
                mode_change_cycles: 60,
                ..Behaviour::akd2g()
            },
            ..Variant::default()
        };
        let (mut machine, axis) = Machine::enabled_of(&variant);
        drop(machine.finish(axis.homing()).unwrap());
        let from = machine.stations[0].words.len();
        let mut moving = Task::new(async {
            let pp = axis.profile_position().await?;
            pp.move_abs(5_000, SetPoint::new()).await.map(drop)
        });
        assert!(moving.poll().is_none());
        machine.run(10);
        machine.finish(axis.stop()).unwrap();
        let failed = machine.finish_task(&mut moving).unwrap_err();
        let delivery = Delivery::NotSent;
        assert_eq!(failed.failure(), Some(Failure::QuickStopped { delivery }));
        machine.run(100);
        let words = &machine.stations[0].words[from..];
        assert!(words.iter().all(|word| word & 0x10 == 0));
        // One that is asked for after the stop moves.
        let pp = machine.finish(axis.profile_position()).unwrap();
        let moved = machine.finish(pp.move_abs(5_000, SetPoint::new())).unwrap();
        machine.finish(moved.done()).unwrap();
    }
}

/// Which stands or moves, and whether its lease was given back by dropping it alone.
#[test]
fn a_jog_of_a_lease_that_was_given_back_does_not_move_the_axis_of_the_next_one() {
    let variant = Variant {
        mapped_too: vec![obj::TARGET_VELOCITY.into()],
        ..Variant::default()
    };
    for velocity in [0, 20_000] {
        let (mut machine, axis) = Machine::enabled_of(&variant);
        let first = machine.finish(axis.profile_velocity()).unwrap();
        let jog = machine.finish(first.jog(velocity)).unwrap();
        drop(first);
        machine.run(200);
        // It is held, and nobody else has the axis.
        jog.set(velocity).unwrap();
        machine.run(100);
        assert!(machine.goes_at(velocity.into()));
        // Another task has the axis to itself now.
        let second = machine.finish(axis.profile_velocity()).unwrap();
        machine.run(200);
        assert!(machine.stands(), "it was let go");
        let set = jog.set(20_000).unwrap_err();
        assert!(matches!(set.kind, AxisErrorKind::ModeInUse), "{set}");
        let hold = jog.hold().unwrap_err();
        assert!(matches!(hold.kind, AxisErrorKind::ModeInUse), "{hold}");
        assert_eq!(jog.ended(), Some(Failure::Withdrawn));
        machine.run(100);
        assert!(machine.stands());
        let own = machine.finish(second.jog(-5_000)).unwrap();
        drop(jog);
        machine.run(200);
        assert!(machine.goes_at(-5_000.0), "the other one ends nothing");
        machine.finish(own.release()).unwrap();
    }
}

/// It takes over from the one that comes to rest.
#[test]
fn the_first_jog_of_a_lease_takes_over_from_one_of_an_earlier_lease() {
    let variant = Variant {
        mapped_too: vec![obj::TARGET_VELOCITY.into()],
        ..Variant::default()
    };
    let (mut machine, axis) = Machine::enabled_of(&variant);
    let first = machine.finish(axis.profile_velocity()).unwrap();
    let jog = machine.finish(first.jog(20_000)).unwrap();
    drop(first);
    machine.run(100);
    let second = machine.finish(axis.profile_velocity()).unwrap();
    let own = machine.finish(second.jog(10_000)).unwrap();
    machine.run(200);
    assert!(machine.goes_at(10_000.0));
    assert_eq!(jog.ended(), Some(Failure::Superseded));
    machine.finish(own.release()).unwrap();
}
