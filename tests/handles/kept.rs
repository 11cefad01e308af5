//! Futures that are polled a few times and then kept, as the arm of a `select!` that lost: nobody waits for them for ever.

use core::sync::atomic::Ordering;

use crate::machine::{Machine, Task, Variant, kept, slow};
use servocrab::{
    Axis, AxisError, BufferMode, Failure, HomingMethod, HomingParameters, SetPoint,
    axis::AxisErrorKind, profile_velocity::JogSetPoint, start_together,
};

fn to_the_switch() -> HomingParameters {
    HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
        .speeds(20_000, 2_000)
        .acceleration(200_000)
}

fn is_busy<T: core::fmt::Debug>(result: Result<T, AxisError>) {
    let error = result.unwrap_err();
    assert!(
        matches!(error.kind, AxisErrorKind::Failed(Failure::Busy)),
        "{error}"
    );
}

#[test]
fn a_homing_that_is_kept_while_it_writes_makes_the_next_one_busy_until_it_is_dropped() {
    let (mut machine, axis) = slow();
    let homing = machine.finish(axis.homing()).unwrap();
    let mut first = Task::new(homing.home(to_the_switch()));
    kept(&mut machine, &mut first);
    is_busy(machine.finish(homing.home(to_the_switch())));
    assert!(machine.drive().homings().is_empty());
    drop(first);
    machine.finish(homing.home(to_the_switch())).unwrap();
    assert_eq!(machine.drive().homings().len(), 1);
}

#[test]
fn a_homing_that_is_kept_after_it_was_sent_is_busy_only_until_it_has_ended() {
    let (mut machine, axis) = Machine::enabled_of(&Variant::by_sdo());
    let homing = machine.finish(axis.homing()).unwrap();
    let mut first = Task::new(homing.home(to_the_switch()));
    assert!(first.poll().is_none());
    machine.cycle();
    assert!(
        first.poll().is_none(),
        "it is queued, and is kept from here on"
    );
    machine.run(20);
    is_busy(machine.finish(homing.home(to_the_switch())));
    machine.run(3_000);
    machine.finish(homing.home(to_the_switch())).unwrap();
    let homed = machine.finish_task(&mut first).unwrap();
    assert!(homed.position.abs() < 100);
    assert_eq!(machine.drive().homings().len(), 2);
}

#[test]
fn a_jog_that_is_kept_while_it_writes_makes_the_next_one_busy_until_it_is_dropped() {
    let (mut machine, axis) = slow();
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    let ramps = || JogSetPoint::new(1_000).acceleration(7_000);
    let mut first = Task::new(pv.jog(ramps()));
    kept(&mut machine, &mut first);
    is_busy(machine.finish(pv.jog(ramps())));
    drop(first);
    let jog = machine.finish(pv.jog(ramps())).unwrap();
    machine.run(50);
    assert!(machine.drive().velocity() > 0.0);
    machine.finish(jog.release()).unwrap();
}

#[test]
fn a_move_that_is_kept_while_it_writes_makes_the_next_one_busy_until_it_is_dropped() {
    let (mut machine, axis) = slow();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let fast = || SetPoint::new().velocity(70_000).acceleration(700_000);
    let mut first = Task::new(pp.move_rel(100, fast()));
    kept(&mut machine, &mut first);
    let before = machine.now;
    is_busy(machine.finish(pp.move_rel(200, fast())));
    assert!((machine.now - before).as_secs() < 3);
    drop(first);
    let moved = machine.finish(pp.move_rel(300, fast())).unwrap();
    machine.finish(moved.done()).unwrap();
    let lines = machine.drive().ledger().to_vec();
    assert_eq!(lines.len(), 1);
    assert_eq!((lines[0].value, lines[0].velocity), (300, 70_000));
}

/// Each with the speed that it names: they wait for each other, in the order in which they were asked for or another.
#[test]
fn moves_that_write_their_parameters_at_the_same_time_wait_for_each_other() {
    let (mut machine, axis) = slow();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let mut tasks: Vec<_> = (1..=3)
        .map(|n: u32| {
            let set_point = SetPoint::new()
                .velocity(10_000 * n)
                .buffer_mode(BufferMode::Buffered);
            Task::new(pp.move_abs(40_000 * n.cast_signed(), set_point))
        })
        .collect();
    let mut moves: Vec<_> = tasks.iter().map(|_| None).collect();
    let begin = machine.now;
    while moves.iter().filter(|moved| moved.is_some()).count() < 2 {
        for (task, moved) in tasks.iter_mut().zip(&mut moves) {
            if moved.is_none() {
                *moved = task.poll().map(Result::unwrap);
            }
        }
        machine.cycle();
    }
    assert!(
        (machine.now - begin).as_millis() < 200,
        "two are taken at once"
    );
    for (task, moved) in tasks.iter_mut().zip(&mut moves) {
        if moved.is_none() {
            *moved = Some(machine.finish_task(task).unwrap());
        }
    }
    for line in machine.drive().ledger() {
        assert_eq!(4 * line.velocity, line.value as u32);
    }
    assert_eq!(machine.drive().ledger().len(), 3);
}

#[test]
fn a_move_that_waits_for_one_that_is_kept_ends_with_the_network() {
    let (mut machine, axis) = slow();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let fast = || SetPoint::new().velocity(70_000).acceleration(700_000);
    let mut first = Task::new(pp.move_rel(100, fast()));
    kept(&mut machine, &mut first);
    let mut second = Task::new(pp.move_rel(200, fast()));
    for _ in 0..20 {
        let end = second.poll();
        assert!(end.is_none(), "{end:?}");
        machine.cycle();
    }
    drop(machine);
    let closed = second.poll().expect("it ends").unwrap_err();
    assert!(matches!(closed.kind, AxisErrorKind::Closed), "{closed}");
}

/// Its bit 4 is in a frame that was lost, and the drive takes it with the next one.
#[test]
fn the_parameters_of_a_move_that_was_sent_and_dropped_are_its_own_until_the_drive_has_taken_it() {
    let (mut machine, axis) = Machine::enabled_of(&Variant::by_sdo());
    let pp = machine.finish(axis.profile_position()).unwrap();
    let set_point = |velocity| SetPoint::new().velocity(velocity);
    let mut first = Task::new(pp.move_abs(10_000, set_point(70_000)));
    let high = |machine: &Machine| {
        machine.stations[0]
            .words
            .last()
            .is_some_and(|word| word & 0x10 != 0)
    };
    // The drive gets no frame while bit 4 is out for the first time.
    while !high(&machine) {
        assert!(first.poll().is_none());
        let written = machine.stations[0].sdo.written.lock().unwrap().len();
        machine.stations[0].deaf = written > 0;
        machine.cycle();
    }
    drop(first);
    let mut second = Task::new(pp.move_abs(20_000, set_point(10_000)));
    machine.run_beside(&mut second, 7);
    machine.stations[0].deaf = false;
    let _ = machine.finish_task(&mut second);
    machine.run(500);
    let ledger = machine.drive().ledger().to_vec();
    assert_eq!(
        (ledger[0].value, ledger[0].velocity),
        (10_000, 70_000),
        "{ledger:?}"
    );
}

/// It waits for room in the drive's buffer, and has nothing written itself.
#[test]
fn a_move_that_waits_for_its_turn_has_not_the_parameters_of_a_later_one() {
    let (mut machine, axis) = Machine::enabled_of(&Variant::by_sdo());
    let pp = machine.finish(axis.profile_position()).unwrap();
    let buffered = SetPoint::new().buffer_mode(BufferMode::Buffered);
    let held = machine.finish(pp.move_abs(20_000, buffered)).unwrap();
    let queued = machine.finish(pp.move_abs(40_000, buffered)).unwrap();
    let mut waiting = Task::new(pp.move_abs(60_000, buffered));
    let mut later = Task::new(pp.move_abs(61_000, buffered.velocity(7_000)));
    for _ in 0..20 {
        assert!(waiting.poll().is_none() && later.poll().is_none());
        machine.cycle();
    }
    let taken = machine.finish_task(&mut waiting).unwrap();
    drop(machine.finish_task(&mut later).unwrap());
    drop((held, queued, taken));
    let ledger = machine.drive().ledger().to_vec();
    let velocities: Vec<_> = ledger.iter().map(|line| line.velocity).collect();
    let usual = velocities[0];
    assert_eq!(velocities, [usual, usual, usual, 7_000]);
}

/// The one of the two axes waits for the other one's parameters, and is not sent yet.
#[test]
fn a_move_that_is_to_start_with_another_keeps_the_parameters_that_it_found() {
    let mut machine = Machine::of(2, &Variant::by_sdo());
    let (x, y) = (machine.axis(0), machine.axis(1));
    machine.finish(x.enable()).unwrap();
    machine.finish(y.enable()).unwrap();
    let on_x = machine.finish(x.profile_position()).unwrap();
    let on_y = machine.finish(y.profile_position()).unwrap();
    machine.stations[1]
        .sdo
        .slow_writes
        .store(true, Ordering::Relaxed);
    let slow = SetPoint::new().velocity(9_000);
    let mut together = Task::new(start_together([
        on_x.abs(21_000, SetPoint::new()),
        on_y.abs(21_000, slow),
    ]));
    // The question whether it would be refused, and the write.
    machine.run_beside(&mut together, 2);
    is_busy(machine.finish(on_x.move_abs(22_000, slow)));
    for station in &machine.stations {
        assert!(station.sdo.written.lock().unwrap().is_empty());
    }
    drop(machine.finish_task(&mut together).unwrap());
    drop(machine.finish(on_x.move_abs(22_000, slow)).unwrap());
    let ledger = machine.drive().ledger().to_vec();
    assert_eq!(ledger.len(), 2);
    assert_ne!(ledger[0].velocity, 9_000);
    assert_eq!(ledger[1].velocity, 9_000);
}

/// It has nothing written itself, and the drive's parameters are another one's for the moment.
#[test]
fn a_move_without_parameters_waits_for_one_that_writes() {
    let (mut machine, axis) = slow();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let set_point = SetPoint::new().velocity(70_000).acceleration(700_000);
    let mut first = Task::new(pp.move_abs(22_000, set_point));
    kept(&mut machine, &mut first);
    let mut second = Task::new(pp.move_abs(23_000, SetPoint::new()));
    machine.run_beside(&mut second, 20);
    assert!(machine.drive().ledger().is_empty());
    drop(machine.finish_task(&mut first).unwrap());
    drop(machine.finish_task(&mut second).unwrap());
    let ledger = machine.drive().ledger().to_vec();
    assert_eq!((ledger[0].value, ledger[0].velocity), (22_000, 70_000));
    assert_eq!(ledger[1].value, 23_000);
    assert_ne!(ledger[1].velocity, 70_000);
}

/// What the drive takes for the ramp by which the axis comes to rest.
fn deceleration(machine: &Machine) -> Option<i64> {
    machine.drive().get(0x6084, 0)
}

#[test]
fn a_jog_that_was_kept_before_it_writes_leaves_the_ramps_of_the_next_one() {
    let (mut machine, axis) = Machine::enabled_of(&Variant::by_sdo());
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    let mut first = Task::new(pv.jog(JogSetPoint::new(3_000).deceleration(10_000)));
    assert!(first.poll().is_none());
    machine.run(2);
    let next = machine.finish(pv.jog(JogSetPoint::new(2_000).deceleration(400_000)));
    let results = [next, machine.finish_task(&mut first)];
    let [next, first] = results.map(|jog| jog.is_ok());
    assert!(next != first, "one of them has the axis");
    machine.run(50);
    let expected = if next { 400_000 } else { 10_000 };
    assert_eq!(deceleration(&machine), Some(expected));
}

#[test]
fn a_move_of_a_lease_that_was_given_back_leaves_the_ramps_of_the_next_one() {
    let (mut machine, axis) = Machine::enabled_of(&Variant::by_sdo());
    let pp = machine.finish(axis.profile_position()).unwrap();
    let slow = SetPoint::new().deceleration(10_000);
    let mut kept = Task::new(start_together([pp.rel(9_000, slow)]));
    assert!(kept.poll().is_none());
    machine.run(2);
    drop(pp);
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    let jog = machine
        .finish(pv.jog(JogSetPoint::new(2_000).deceleration(400_000)))
        .unwrap();
    let error = machine.finish_task(&mut kept).unwrap_err();
    assert!(
        matches!(error.kind, AxisErrorKind::ModeInUse),
        "{error}: {error:?}"
    );
    assert_eq!(deceleration(&machine), Some(400_000));
    machine.finish(jog.release()).unwrap();
}

#[test]
fn a_move_that_a_stop_has_ended_before_it_writes_leaves_the_ramps_of_the_next_one() {
    let (mut machine, axis) = Machine::enabled_of(&Variant::by_sdo());
    let pp = machine.finish(axis.profile_position()).unwrap();
    let slow = SetPoint::new().deceleration(10_000);
    let mut kept = Task::new(pp.move_rel(9_000, slow));
    assert!(kept.poll().is_none());
    machine.run(2);
    machine.finish(axis.quick_stop()).unwrap();
    machine.finish(axis.enable()).unwrap();
    let next = SetPoint::new().deceleration(400_000);
    let next = machine.finish(pp.move_rel(40_000, next)).unwrap();
    let error = machine.finish_task(&mut kept).unwrap_err();
    assert!(
        matches!(error.failure(), Some(Failure::QuickStopped { .. })),
        "{error}"
    );
    assert_eq!(deceleration(&machine), Some(400_000));
    machine.finish(next.done()).unwrap();
}

#[test]
fn a_jog_or_homing_that_a_stop_has_ended_before_it_writes_writes_nothing() {
    let (mut machine, axis) = Machine::enabled_of(&Variant::by_sdo());
    let pv = machine.finish(axis.profile_velocity()).unwrap();
    let mut jog = Task::new(pv.jog(JogSetPoint::new(2_000).deceleration(10_000)));
    ends_unwritten(&mut machine, &axis, &mut jog);
    drop(jog);
    drop(pv);
    let homing = machine.finish(axis.homing()).unwrap();
    let mut home = Task::new(homing.home(to_the_switch().offset(-10_000)));
    ends_unwritten(&mut machine, &axis, &mut home);
}

/// It is kept once it was asked for, and the axis is stopped meanwhile.
fn ends_unwritten<T>(
    machine: &mut Machine,
    axis: &Axis,
    kept: &mut Task<'_, Result<T, AxisError>>,
) {
    let written = |machine: &Machine| machine.stations[0].sdo.written.lock().unwrap().len();
    let before = written(machine);
    assert!(kept.poll().is_none());
    machine.run(2);
    machine.finish(axis.quick_stop()).unwrap();
    machine.finish(axis.enable()).unwrap();
    let Err(error) = machine.finish_task(kept) else {
        panic!("it has outlived the stop");
    };
    let failure = error.failure();
    assert!(
        matches!(failure, Some(Failure::QuickStopped { .. })),
        "{error}"
    );
    assert_eq!(written(machine), before);
}
