//! Paths: moves from a stream, kept flowing into the drive's buffer.

use servocrab::{
    axis::{AxisErrorKind, Failure},
    profile_position::{Follow, Followed, MoveRequest, Outcome, SetPoint, Start},
};
use smol::stream::{self, Stream, StreamExt};

use crate::machine::{Machine, Task};

fn blend() -> SetPoint {
    SetPoint::new().start(Start::Blend)
}

fn all<S>(machine: &mut Machine, path: &mut Follow<'_, S>) -> Vec<Followed>
where
    S: Stream<Item = MoveRequest> + Unpin,
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
    let order: Vec<_> = ends.iter().map(|end| end.command.target).collect();
    assert_eq!(order, targets);
    let (last, passed) = ends.split_last().unwrap();
    for end in passed {
        assert!(
            matches!(end.result, Ok(Outcome::Passed { .. })),
            "{:?}",
            end.result
        );
    }
    assert!(matches!(
        last.result,
        Ok(Outcome::Reached { position: 30_000 })
    ));
    assert_eq!(machine.drive().ledger().len(), 5);
}

#[test]
fn only_what_the_drive_has_room_for_is_taken_from_the_stream() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let taken = std::cell::Cell::new(0);
    let after = SetPoint::new().start(Start::AfterCurrent);
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
fn a_halt_ends_the_path_behind_the_moves_that_the_drive_holds() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let after = SetPoint::new().start(Start::AfterCurrent);
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
    assert!(matches!(ends[0].result, Ok(Outcome::Reached { .. })));
    assert!(matches!(
        ends[1].result,
        Ok(Outcome::Reached { position: 10_000 })
    ));
    let refused = ends[2].result.as_ref().unwrap_err();
    assert!(matches!(
        refused.kind,
        AxisErrorKind::Failed(Failure::Halted)
    ));
    assert_eq!(machine.drive().ledger().len(), 2);
}

#[test]
fn a_path_that_is_dropped_leaves_the_sent_moves_and_nothing_else() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let after = SetPoint::new().start(Start::AfterCurrent);
    let mut path = pp.follow(stream::iter((1..=9).map(|n| pp.abs(n * 5_000, after))));
    let mut next = Task::new(path.next());
    for _ in 0..50 {
        assert!(next.poll().is_none());
        machine.cycle();
    }
    drop(next);
    drop(path);
    machine.run(2_000);
    assert_eq!(machine.drive().ledger().len(), 2);
    assert_eq!(machine.drive().position(), 10_000);
}

#[test]
fn an_empty_path_is_over_at_once() {
    let (mut machine, axis) = Machine::enabled();
    let pp = machine.finish(axis.profile_position()).unwrap();
    let mut path = pp.follow(stream::empty());
    assert!(all(&mut machine, &mut path).is_empty());
}
