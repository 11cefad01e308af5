//! What the drive may still hold: a set-point counts as held until its end is proven or a stop has abandoned it.
#![allow(missing_docs)]

#[path = "common/plant.rs"]
mod plant;
#[path = "common/twins.rs"]
mod twins;

use plant::{Bus, End, Habits};
use servocrab::axis::{Command, CommandId, Completion, Failure};
use servocrab::profile_position::{SetPoint, Start};

fn after() -> SetPoint {
    SetPoint::new().start(Start::AfterCurrent)
}

/// It waits 200 ms with bit 10 high before it begins, and between two moves.
fn late() -> Habits {
    Habits {
        start_delay: 200,
        dwell: 200,
        ..Habits::default()
    }
}

/// Runs until this has an end; the drive never holds a set-point that the core does not know.
fn finish(bus: &mut Bus, id: CommandId) -> Result<Completion, Failure> {
    for _ in 0..10_000 {
        if let Some(end) = bus.outcome(id) {
            return end;
        }
        bus.cycle();
        let known = bus.core.snapshot().has_set_point;
        assert!(known || !bus.drive.holds_any(), "at {}", bus.drive.now);
    }
    panic!("{id:?} has no end");
}

#[test]
fn what_a_short_move_shows_when_it_begins_late_is_not_the_end_of_the_next() {
    let mut bus = Bus::enabled(late(), |_| {});
    // Within the window: over at once, for all that shows. The drive begins it later, and rests again before the next.
    let short = bus.abs(5, after());
    assert_eq!(bus.finish(short), Ok(Completion::Reached { position: 0 }));
    assert!(bus.drive.holds_any());
    let next = bus.abs(1_000, after());
    assert_eq!(
        finish(&mut bus, next),
        Ok(Completion::Reached { position: 1_000 })
    );
}

#[test]
fn what_a_short_move_shows_when_it_begins_late_does_not_end_two_behind_it() {
    let mut bus = Bus::enabled(late(), |_| {});
    bus.run(110);
    let short = bus.abs(5, after());
    assert_eq!(bus.finish(short), Ok(Completion::Reached { position: 0 }));
    let first = bus.abs(1_000, after());
    bus.wait_accepted(first);
    bus.run_until(400, |bus| {
        bus.entry(short).is_some_and(|entry| entry.ended.is_some())
    });
    // The axis rests where this one ends, before the drive begins the first of them.
    let second = bus.abs(5, after());
    for (id, position) in [(first, 1_000), (second, 5)] {
        assert_eq!(finish(&mut bus, id), Ok(Completion::Reached { position }));
    }
}

/// A load moves the axis out of its window while the drive waits: bit 10 is high, and the move seems to have ended elsewhere.
fn missed(bus: &mut Bus) {
    // It is seen to stand first.
    bus.run(110);
    let first = bus.abs(1_000, after());
    bus.wait_accepted(first);
    bus.drive.habits.droop = 60;
    assert_eq!(
        finish(bus, first),
        Err(Failure::MissedTarget {
            target: 1_000,
            actual: 60
        })
    );
    assert!(bus.drive.holds_any(), "it has only begun late");
    bus.drive.habits.droop = 0;
    bus.cycle();
}

#[test]
fn a_stop_abandons_a_move_that_seemed_to_have_missed_its_target() {
    let mut bus = Bus::enabled(late(), |_| {});
    missed(&mut bus);
    assert!(bus.core.snapshot().has_set_point);
    let stop = bus.send(Command::Stop);
    assert!(matches!(bus.finish(stop), Ok(Completion::Stopped { .. })));
    assert!(!bus.drive.holds_any());
    assert!(!bus.core.snapshot().has_set_point);
    bus.run(1_000);
    assert!(bus.drive.actual.abs() < 10.0, "nothing has moved it");
}

#[test]
fn behind_a_move_that_seemed_to_have_missed_its_target_one_is_sent_and_no_more() {
    let mut bus = Bus::enabled(late(), |_| {});
    missed(&mut bus);
    let moves = [bus.abs(2_000, after()), bus.abs(3_000, after())];
    for (id, position) in moves.into_iter().zip([2_000, 3_000]) {
        assert_eq!(finish(&mut bus, id), Ok(Completion::Reached { position }));
        let entry = bus.entry(id).expect("it was sent");
        assert!(entry.taken, "it went into a full buffer");
        assert!(matches!(entry.ended, Some((_, End::Stopped))));
    }
    // The end of a later one proves that of those before it.
    assert!(!bus.core.snapshot().has_set_point);
    let stop = bus.send(Command::Stop);
    assert!(bus.finish(stop).is_ok());
    assert_eq!(bus.word() & 0x010F, 0x000F, "there was nothing to stop");
}

#[test]
fn a_distance_behind_a_move_that_seemed_to_have_missed_its_target_ends_nowhere_known() {
    let mut bus = Bus::enabled(late(), |_| {});
    missed(&mut bus);
    // Within the window of nothing that is known: it counts from the end of the one before.
    let id = bus.rel(5, after());
    let end = finish(&mut bus, id);
    assert!(
        matches!(
            end,
            Err(Failure::EndNotKnown { .. } | Failure::NotBegun { .. })
        ),
        "{end:?}"
    );
    assert!(bus.core.snapshot().has_set_point);
}

#[test]
fn a_replacement_drops_a_move_that_seemed_to_have_missed_its_target() {
    let mut bus = Bus::enabled(late(), |_| {});
    missed(&mut bus);
    let id = bus.abs(-500, SetPoint::new());
    assert_eq!(
        finish(&mut bus, id),
        Ok(Completion::Reached { position: -500 })
    );
    assert!(!bus.core.snapshot().has_set_point);
}
