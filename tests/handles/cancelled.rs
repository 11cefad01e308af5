//! Every await of the handles, cancelled and kept: a program is polled so many times and then dropped, or held and not polled, for every
//! such number. What comes then works, and nothing moves that nobody asks for.

use core::{cell::Cell, future::Future, pin::pin, sync::atomic::Ordering, time::Duration};
use std::{collections::BTreeMap, future::poll_fn, rc::Rc};

use crate::machine::{Machine, Task, Variant, lock};
use servocrab::{
    Axis, AxisError, BufferMode, HomingMethod, HomingParameters, Outcome, SetPoint,
    axis::AxisErrorKind, ds402::State, profile_velocity::JogSetPoint, start_together,
};

/// Parameters by SDO, and in the second one the mode as well.
fn variants() -> [Variant; 2] {
    let variant = Variant::by_sdo();
    let mut by_sdo = variant.clone();
    by_sdo.not_mapped.extend([0x6060, 0x6061]);
    [variant, by_sdo]
}

type Ended = Result<(), AxisError>;

fn after(velocity: u32) -> SetPoint {
    SetPoint::new()
        .velocity(velocity)
        .buffer_mode(BufferMode::Buffered)
}

async fn moves(x: Axis, _: Axis) -> Ended {
    x.enable().await?;
    let pp = x.profile_position().await?;
    let first = pp.move_rel(601, after(70_000)).await?;
    let second = pp.move_rel(602, after(60_000)).await?;
    first.done().within(Duration::from_secs(5)).await?;
    second.done_through_halt().await?;
    pp.release().await?;
    x.disable().await
}

async fn stops(x: Axis, _: Axis) -> Ended {
    x.enable().await?;
    let pp = x.profile_position().await?;
    let _far = pp.move_rel(90_603, after(40_000)).await?;
    x.halt().await?;
    x.resume().await?;
    x.stop().await?;
    x.enable().await?;
    let _far = pp.move_rel(-90_604, after(40_000)).await?;
    x.quick_stop().await?;
    x.enable().await?;
    let _far = pp.move_rel(90_605, after(40_000)).await?;
    x.disable().await
}

async fn path(x: Axis, _: Axis) -> Ended {
    x.enable().await?;
    let pp = x.profile_position().await?;
    let moves = (1..=4).map(|n| pp.rel(600 + n, after(50_000)));
    pp.follow(moves).finish().await?;
    Ok(())
}

async fn both(x: Axis, y: Axis) -> Ended {
    x.enable().await?;
    y.enable().await?;
    let (on_x, on_y) = (x.profile_position().await?, y.profile_position().await?);
    let set_point = SetPoint::new().velocity(30_000);
    for moved in start_together([on_y.rel(601, set_point), on_x.rel(601, set_point)]).await? {
        moved.done().await?;
    }
    on_x.release().await?;
    on_y.release().await
}

async fn home(x: Axis, _: Axis) -> Ended {
    x.enable().await?;
    let homing = x.homing().await?;
    let parameters = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
        .speeds(20_000, 2_000)
        .acceleration(200_000);
    let home = homing.home(parameters).within(Duration::from_secs(1));
    home.await?;
    homing.release().await
}

async fn jog(x: Axis, _: Axis) -> Ended {
    x.enable().await?;
    let pv = x.profile_velocity().await?;
    let jog = pv.jog(JogSetPoint::new(9_000).acceleration(90_000)).await?;
    x.read_limits().await?;
    jog.set(-4_000)?;
    x.read_limits().await?;
    jog.release().await?;
    pv.release().await
}

async fn objects(x: Axis, y: Axis) -> Ended {
    x.read_limits().await?;
    x.factors().await?;
    let changes = async {
        while y.changed().await.is_some() {}
        Ok(())
    };
    smol::future::or(y.enable(), changes).await?;
    y.disable().await
}

/// Polls it and counts that.
async fn counted<T>(future: impl Future<Output = T>, polls: Rc<Cell<usize>>) -> T {
    let mut future = pin!(future);
    poll_fn(|cx| {
        polls.set(polls.get() + 1);
        future.as_mut().poll(cx)
    })
    .await
}

/// What becomes of a program after so many polls.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fate {
    Dropped,
    Kept,
}

/// Each target is one move, and executed at most once.
fn judge_ledger(machine: &Machine, what: &str) {
    for station in &machine.stations {
        let mut executed = BTreeMap::new();
        for line in lock(&station.drive).ledger() {
            *executed.entry(line.value).or_insert(0) += 1;
        }
        assert!(
            executed.values().all(|times| *times == 1),
            "{what}: {executed:?}"
        );
    }
}

/// Whether the program ended before it was polled so often.
fn live<F: Future<Output = Ended>>(
    variant: &Variant,
    program: fn(Axis, Axis) -> F,
    polls: usize,
    fate: Fate,
    ends_by_itself: bool,
) -> bool {
    let mut machine = Machine::of(2, variant);
    for station in &machine.stations {
        station.sdo.slow.store(true, Ordering::Relaxed);
        station.sdo.slow_writes.store(true, Ordering::Relaxed);
    }
    let (x, y) = (machine.axis(0), machine.axis(1));
    let count = Rc::new(Cell::new(0));
    let mut task = Task::new(counted(program(x.clone(), y.clone()), Rc::clone(&count)));
    let mut ended = false;
    let begin = machine.now;
    while !ended && count.get() < polls {
        let waited = machine.now - begin;
        assert!(
            waited < Duration::from_secs(30),
            "not woken after {} polls",
            count.get()
        );
        machine.cycle();
        ended = task.poll().is_some();
    }
    let what = format!("{fate:?} after {polls} polls");
    let mut kept = None;
    match fate {
        Fate::Dropped => machine.cycle_while(|| drop(task)),
        Fate::Kept => kept = Some(task),
    }
    let stands = |machine: &Machine| {
        let moves = |station: &crate::machine::Station| !lock(&station.drive).stands();
        !machine.stations.iter().any(moves)
    };
    if ends_by_itself {
        machine.run(1_400);
        assert!(
            stands(&machine),
            "{what}: it moves, and nobody waits for it"
        );
    } else {
        machine.run(20);
    }
    for axis in [&x, &y] {
        machine.finish(axis.stop()).unwrap();
        assert!(lock(&machine.stations[usize::from(core::ptr::eq(axis, &y))].drive).stands());
        machine.finish(axis.disable()).unwrap();
    }
    machine.run(5);
    let since = machine.now;
    machine.run(200);
    for station in &machine.stations {
        assert!(!lock(&station.drive).moved_since(since), "{what}");
    }
    assert!(stands(&machine), "{what}");
    judge_ledger(&machine, &what);
    if let Some(mut kept) = kept {
        // It holds its lease, and nobody up.
        if !ended {
            match machine.finish(x.profile_position()) {
                Ok(lease) => drop(lease),
                Err(error) => {
                    let in_use = matches!(error.kind, AxisErrorKind::ModeInUse);
                    assert!(in_use || error.failure().is_some(), "{what}: {error}");
                }
            }
            // And goes on to an end when it is polled again.
            let _ = machine.finish_task(&mut kept);
        }
        drop(kept);
        for axis in [&x, &y] {
            machine.finish(axis.stop()).unwrap();
            machine.finish(axis.disable()).unwrap();
        }
        judge_ledger(&machine, &what);
    }
    for (n, axis) in [&x, &y].into_iter().enumerate() {
        let moved = machine.finish(async {
            axis.enable().await?;
            let pp = axis.profile_position().await?;
            let from = axis.status().position;
            let moved = pp.move_rel(77, SetPoint::new().velocity(20_000)).await?;
            let outcome = moved.done().await?;
            pp.release().await?;
            Ok::<_, AxisError>((from, outcome))
        });
        let (from, outcome) = moved.unwrap_or_else(|error| panic!("{what}: {error}"));
        let Outcome::Reached { position } = outcome else {
            panic!("{what}: {outcome:?}");
        };
        // Between two positions in the window.
        assert!((position - from - 77).abs() <= 20, "{what}: {position}");
        let drive = lock(&machine.stations[n].drive);
        let probes = drive.ledger().iter().filter(|line| line.value == 77);
        assert_eq!(probes.count(), 1, "{what}");
    }
    assert_eq!(x.status().state, State::OperationEnabled);
    ended
}

fn every_poll<F: Future<Output = Ended>>(
    program: fn(Axis, Axis) -> F,
    ends_by_itself: bool,
    at_least: usize,
) {
    for variant in variants() {
        let mut polls = 0;
        loop {
            let ended = [Fate::Dropped, Fate::Kept]
                .map(|fate| live(&variant, program, polls, fate, ends_by_itself));
            if ended == [true; 2] {
                break;
            }
            polls += 1;
        }
        assert!(polls >= at_least, "only {polls} polls");
    }
}

#[test]
fn moves_are_cancelled_and_kept_at_every_await() {
    every_poll(moves, false, 10);
}

#[test]
fn stops_are_cancelled_and_kept_at_every_await() {
    every_poll(stops, false, 10);
}

#[test]
fn a_path_is_cancelled_and_kept_at_every_await() {
    every_poll(path, false, 10);
}

#[test]
fn moves_together_are_cancelled_and_kept_at_every_await() {
    every_poll(both, false, 10);
}

#[test]
fn a_homing_is_cancelled_and_kept_at_every_await() {
    every_poll(home, true, 10);
}

#[test]
fn a_jog_is_cancelled_and_kept_at_every_await() {
    every_poll(jog, false, 10);
}

#[test]
fn reads_are_cancelled_and_kept_at_every_await() {
    every_poll(objects, true, 10);
}
