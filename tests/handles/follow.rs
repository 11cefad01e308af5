//! Paths: moves from a stream, kept flowing into the drive's buffer.

use servocrab::{
    AxisError, BufferMode, Failure, Outcome, SetPoint,
    axis::{AxisErrorKind, Delivery},
    profile_position::{Follow, Followed, MoveRequest, PathError},
};
use smol::stream::{self, Stream, StreamExt};

use crate::machine::{Machine, Task, at_target};

fn blend() -> SetPoint {
    SetPoint::new().buffer_mode(BufferMode::Blending)
}

fn all<S>(machine: &mut Machine, path: &mut Follow<'_, S>) -> Vec<Result<Followed, PathError>>
where
    S: Stream<Item = MoveRequest>,
{
    let mut ends = Vec::new();
    while let Some(followed) = machine.finish(path.next()) {
        ends.push(followed);
    }
    ends
}

#[test]
fn a_path_of_blended_moves_passes_each_target_in_order_without_a_stop() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let targets = [6_000, 12_000, 18_000, 24_000, 30_000];
    let mut path = pp.follow(stream::iter(targets.map(|target| pp.abs(target, blend()))));
    let ends = all(&mut machine, &mut path);
    let ends: Vec<_> = ends.into_iter().map(Result::unwrap).collect();
    let order: Vec<_> = ends.iter().map(|end| end.command.target).collect();
    assert_eq!(order, targets);
    let (last, passed) = ends.split_last().unwrap();
    for end in passed {
        assert!(matches!(end.outcome, Outcome::Passed { .. }), "{end:?}");
    }
    let reached = at_target(last.outcome, 30_000);
    assert_eq!(machine.finish(path.finish()).unwrap(), Some(reached));
    assert_eq!(machine.drive().ledger().len(), 5);
}

#[test]
fn only_what_the_drive_has_room_for_is_taken_from_the_stream() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let taken = std::cell::Cell::new(0);
    let after = SetPoint::new().buffer_mode(BufferMode::Buffered);
    let moves = stream::iter(1..=6).map(|n| {
        taken.set(taken.get() + 1);
        pp.abs(n * 5_000, after)
    });
    let mut path = pp.follow(moves);
    let mut next = Task::new(path.next());
    assert!(next.poll().is_none());
    for _ in 0..50 {
        machine.cycle();
        assert!(next.poll().is_none());
    }
    assert_eq!(taken.get(), 3, "one active, one queued, one that waits");
    drop(next);
    assert_eq!(all(&mut machine, &mut path).len(), 6);
    assert_eq!(taken.get(), 6);
}

#[test]
fn a_path_that_halts_on_drop_halts_its_axis_and_what_waits_is_withdrawn() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let halting = SetPoint::new()
        .buffer_mode(BufferMode::Buffered)
        .halt_on_drop();
    let targets = [20_000, 40_000, 60_000, 80_000];
    let mut task = Task::new(async {
        let path = pp.follow(targets.map(|target| pp.abs(target, halting)));
        path.finish().await
    });
    machine.run_beside(&mut task, 60);
    drop(task);
    machine.cycle();
    assert!(axis.status().halted);
    machine.run(2_000);
    assert!(machine.stands());
    assert_eq!(machine.drive().ledger().len(), 2, "one active, one queued");
}

#[test]
fn a_halt_ends_the_path_behind_the_moves_that_the_drive_holds() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let after = SetPoint::new().buffer_mode(BufferMode::Buffered);
    let mut path = pp.follow(stream::iter((1..=9).map(|n| pp.abs(n * 5_000, after))));
    let mut next = Task::new(path.next());
    assert!(next.poll().is_none());
    for _ in 0..50 {
        machine.cycle();
        assert!(next.poll().is_none());
    }
    drop(next);
    machine.finish(axis.halt()).unwrap();
    machine.finish(axis.resume()).unwrap();
    let ends = all(&mut machine, &mut path);
    assert_eq!(ends.len(), 3, "{ends:?}");
    let outcomes: Vec<_> = ends
        .iter()
        .map(|end| end.as_ref().map(|end| end.outcome))
        .collect();
    assert!(matches!(outcomes[0], Ok(Outcome::Reached { .. })));
    at_target(outcomes[1].unwrap(), 10_000);
    let refused = outcomes[2].unwrap_err();
    assert_eq!((refused.number, refused.command.target), (2, 15_000));
    assert_eq!(
        refused.error.failure(),
        Some(Failure::Halted {
            delivery: Delivery::NotSent
        })
    );
    // Whoever has not looked at it is told by the one result.
    let failed = machine.finish(path.finish()).unwrap_err();
    assert_eq!(
        failed.error.failure(),
        Some(Failure::Halted {
            delivery: Delivery::NotSent
        })
    );
    assert_eq!(machine.drive().ledger().len(), 2);
}

#[test]
fn a_path_that_is_dropped_leaves_the_sent_moves_and_nothing_else() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let after = SetPoint::new().buffer_mode(BufferMode::Buffered);
    let mut path = pp.follow(stream::iter((1..=9).map(|n| pp.abs(n * 5_000, after))));
    let mut next = Task::new(path.next());
    machine.run_beside(&mut next, 50);
    drop(next);
    drop(path);
    machine.run(2_000);
    assert_eq!(machine.drive().ledger().len(), 2);
    assert!(machine.is_at(10_000));
}

#[test]
fn an_empty_path_is_over_at_once() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let mut path = pp.follow(stream::empty());
    assert!(all(&mut machine, &mut path).is_empty());
}

#[test]
fn the_one_result_of_a_path_is_its_first_failure_or_its_last_outcome() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let after = SetPoint::new().buffer_mode(BufferMode::Buffered);
    // An iterator, a stream, and one that is pinned where it is.
    let moves = || (1..=4).map(|n| pp.abs(n * 1_000, after));
    let last = machine.finish(pp.follow(moves()).finish()).unwrap();
    at_target(last.unwrap(), 4_000);
    let path = pp.follow(stream::iter(moves()).then(|request| async { request }));
    let last = machine.finish(path.finish()).unwrap();
    at_target(last.unwrap(), 4_000);
    let none: [MoveRequest; 0] = [];
    assert_eq!(machine.finish(pp.follow(none).finish()).unwrap(), None);

    let mut finishing = Task::new(
        pp.follow([pp.abs(90_000, after), pp.abs(0, after)])
            .finish(),
    );
    machine.run_beside(&mut finishing, 100);
    machine.finish(axis.quick_stop()).unwrap();
    let failed = machine.finish_task(&mut finishing).unwrap_err();
    assert_eq!((failed.number, failed.command.target), (0, 90_000));
    let error = AxisError::from(failed);
    assert_eq!(
        error.failure(),
        Some(Failure::QuickStopped {
            delivery: Delivery::Accepted
        })
    );
}

#[test]
fn a_path_refuses_a_move_of_another_axis_and_sends_nothing_of_it() {
    let mut machine = Machine::new(2);
    let (one, other) = (machine.axis(0), machine.axis(1));
    machine.finish(one.enable()).unwrap();
    machine.finish(other.enable()).unwrap();
    let pp = machine.finish(one.profile_position()).unwrap();
    let elsewhere = machine.finish(other.profile_position()).unwrap();
    let after = SetPoint::new().buffer_mode(BufferMode::Buffered);
    let moves = [
        pp.abs(500, after),
        elsewhere.abs(700, after),
        pp.abs(900, after),
    ];
    let failed = machine.finish(pp.follow(moves).finish()).unwrap_err();
    assert_eq!((failed.number, failed.command.target), (1, 700));
    assert_eq!(failed.error.identity.axis, "axis0");
    assert!(
        matches!(&failed.error.kind, AxisErrorKind::OtherAxis { axis } if axis == "axis1"),
        "{failed}"
    );
    machine.run(200);
    assert_eq!(
        machine.drive().ledger().len(),
        1,
        "the one before it was executed"
    );
    assert!(machine.is_at(500));
    let there = machine.stations[1].drive.lock().unwrap();
    assert!(there.ledger().is_empty());
}

/// Nobody polls the path meanwhile.
#[test]
fn a_path_sends_nothing_more_after_a_stop_whenever_it_is_polled_again() {
    let after = SetPoint::new().buffer_mode(BufferMode::Buffered);
    for run in [5, 400, 2_000] {
        let (mut machine, axis) = Machine::enabled();
        let pp = machine.finish(axis.profile_position()).unwrap();
        let mut path = pp.follow(stream::iter((1..=9).map(|n| pp.abs(n * 5_000, after))));
        let mut next = Task::new(path.next());
        assert!(next.poll().is_none());
        drop(next);
        machine.run(run);
        machine.finish(axis.quick_stop()).unwrap();
        machine.finish(axis.enable()).unwrap();
        let taken = machine.drive().ledger().len();
        let failed = machine.finish(path.finish()).unwrap_err();
        assert!(
            matches!(
                failed.error.failure(),
                Some(Failure::QuickStopped { .. } | Failure::Disabled { .. })
            ),
            "{run}: {failed:?}"
        );
        machine.run(1_000);
        assert_eq!(machine.drive().ledger().len(), taken, "{run}");
    }
}

#[test]
fn a_path_is_over_with_a_stop_that_came_between_two_of_its_moves() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let (give, moves) = smol::channel::unbounded();
    let mut path = pp.follow(moves);
    give.try_send(pp.abs(1_000, SetPoint::new())).unwrap();
    machine.finish(path.next()).unwrap().unwrap();
    machine.finish(axis.quick_stop()).unwrap();
    machine.finish(axis.enable()).unwrap();
    give.try_send(pp.abs(2_000, SetPoint::new())).unwrap();
    let refused = machine.finish(path.next()).unwrap().unwrap_err();
    let delivery = Delivery::NotSent;
    assert_eq!(
        refused.error.failure(),
        Some(Failure::QuickStopped { delivery })
    );
    assert_eq!(machine.drive().ledger().len(), 1);
}
