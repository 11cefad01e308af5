//! What the drive may still hold: a set-point counts as held until its end is proven or a stop has abandoned it.
#![allow(missing_docs)]

#[path = "common/differential.rs"]
mod differential;
#[path = "common/frames.rs"]
mod frames;
#[path = "common/plant.rs"]
mod plant;

use core::time::Duration;

use plant::{Bus, End, Habits};
use servocrab::axis::{Command, CommandId, Completion, Failure};
use servocrab::profile_position::{
    BufferMode, BufferSignal, Delivery, RelativeBase, SetPoint, Traits,
};

fn after() -> SetPoint {
    SetPoint::new().buffer_mode(BufferMode::Buffered)
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
    for base in [RelativeBase::Undocumented, RelativeBase::Demand] {
        let mut bus = Bus::enabled(late(), |config| config.traits.relative_base = base);
        missed(&mut bus);
        // Within the window of nothing that is known: it counts from the end of the one before.
        let id = bus.rel(5, after());
        let end = finish(&mut bus, id);
        assert!(
            matches!(
                end,
                Err(Failure::EndNotKnown { .. } | Failure::NotBegun { .. })
            ),
            "{base:?}: {end:?}"
        );
        assert!(bus.core.snapshot().has_set_point);
    }
}

#[test]
fn two_moves_count_as_held_where_a_load_has_brought_the_axis_to_the_end_of_the_second() {
    let habits = Habits {
        start_delay: 600,
        ..late()
    };
    let mut bus = Bus::enabled(habits, |_| {});
    bus.run(110);
    let first = bus.abs(1_000, after());
    bus.wait_accepted(first);
    let second = bus.abs(60, after());
    bus.wait_accepted(second);
    bus.drive.habits.droop = 60;
    for id in [first, second] {
        // Whatever they are told to be, the drive holds them.
        let _ = finish(&mut bus, id);
    }
    assert!(bus.drive.holds_any(), "they have only begun late");
    let stop = bus.send(Command::Stop);
    assert!(bus.finish(stop).is_ok());
    assert!(!bus.drive.holds_any());
    assert!(!bus.core.snapshot().has_set_point);
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

/// A drive that rests with bit 10 between two moves, in the middle of one to 1000.
fn half_way() -> (Bus, CommandId) {
    let habits = Habits {
        dwell: 400,
        ..Habits::default()
    };
    let mut bus = Bus::enabled(habits, |_| {});
    let first = bus.abs(1_000, after());
    bus.wait_accepted(first);
    bus.run_until(2_000, |bus| bus.drive.actual > 500.0);
    (bus, first)
}

#[test]
fn a_resume_in_motion_changes_nothing_of_how_the_one_behind_begins() {
    let (mut bus, first) = half_way();
    let short = bus.abs(1_005, after());
    bus.wait_accepted(short);
    let halt = bus.send(Command::Halt);
    bus.run(3);
    let resume = bus.send(Command::Resume);
    assert_eq!(finish(&mut bus, resume), Ok(Completion::Done));
    assert!(bus.outcome(halt).is_some());
    assert!(bus.drive.speed > 0.0, "it goes on in motion");
    for id in [first, short] {
        assert_eq!(bus.finish(id), Ok(Completion::Reached { position: 1_000 }));
    }
    assert!(bus.drive.holds_any(), "the short one begins later");
    let next = bus.abs(2_000, after());
    assert_eq!(
        finish(&mut bus, next),
        Ok(Completion::Reached { position: 2_000 })
    );
}

#[test]
fn a_short_blend_that_begins_late_is_not_the_end_of_the_next() {
    let (mut bus, first) = half_way();
    // It turns back, so the drive stops before it.
    let short = bus.rel(-5, SetPoint::new().buffer_mode(BufferMode::Blending));
    for id in [first, short] {
        assert!(bus.finish(id).is_ok());
    }
    assert!(bus.drive.holds_any(), "the short one begins later");
    let next = bus.abs(2_000, after());
    assert_eq!(
        finish(&mut bus, next),
        Ok(Completion::Reached { position: 2_000 })
    );
}

/// A drive whose bit 12 shows its buffer, whose distances count from its demand, and which rests with bit 10 between two moves.
fn resting(habits: Habits) -> Bus {
    let habits = Habits {
        dwell: 400,
        window: 1_000,
        window_time: 0,
        shows_room: true,
        ..habits
    };
    Bus::enabled(habits, |config| {
        config.traits = Traits {
            buffer_signal: BufferSignal::Acknowledge,
            relative_base: RelativeBase::Demand,
            ..Traits::cia402()
        };
    })
}

#[test]
fn the_way_of_the_move_before_through_the_end_of_a_short_one_is_not_its_motion() {
    for frequency in [60, 70, 80, 90, 100, 110, 120, 130, 140] {
        let mut bus = resting(Habits {
            frequency: f64::from(frequency),
            feed_forward: 0.0,
            start_delay: 50,
            ..Habits::default()
        });
        let quick = after().acceleration(5_000_000).deceleration(5_000_000);
        let first = bus.abs(13, quick);
        bus.wait_accepted(first);
        // From where the axis passes its end, it has 17 counts to go.
        let short = bus.abs(-4, quick);
        bus.run_until(2_000, |bus| bus.outcome(first).is_some());
        let third = bus.rel(0, after());
        let end = bus.finish(short);
        let entry = bus.entry(short).expect("it was sent");
        let stopped = matches!(entry.ended, Some((_, End::Stopped)));
        assert!(stopped, "{frequency}: {end:?}, {entry:?}");
        assert!(bus.finish(third).is_ok());
    }
}

#[test]
fn a_distance_does_not_end_where_the_axis_waits_for_the_one_before_it() {
    let mut bus = resting(Habits {
        frequency: 40.0,
        feed_forward: 0.5,
        acknowledge_delay: 8,
        ..Habits::default()
    });
    let quick = SetPoint::new()
        .acceleration(2_000_000)
        .deceleration(2_000_000);
    let first = bus.abs(2_240, quick.buffer_mode(BufferMode::Buffered));
    bus.wait_accepted(first);
    let short = bus.rel(5, quick.buffer_mode(BufferMode::Buffered));
    bus.wait_accepted(short);
    let far = bus.rel(1_000, quick.buffer_mode(BufferMode::Blending));
    for id in [first, short, far] {
        let end = finish(&mut bus, id);
        let entry = bus.entry(id).expect("it was sent");
        assert!(
            end.is_err() || entry.nearest <= 500.0,
            "{id:?}: {end:?}, {entry:?}"
        );
    }
}

/// The drive takes a replacement and acknowledges it too late; on its way to the end of that, it swings through the end of the one
/// before, with bit 10.
#[test]
fn what_a_doubtful_replacement_passes_is_not_the_end_of_the_one_before() {
    for frequency in [120, 130, 140, 150, 160, 170, 180, 190, 200] {
        let habits = Habits {
            frequency: f64::from(frequency),
            damping: 0.1,
            window: 1_000,
            window_time: 0,
            ..Habits::default()
        };
        let mut bus = Bus::enabled(habits, |config| {
            config.deadlines.acknowledge = Duration::from_millis(40);
        });
        let quick = SetPoint::new()
            .acceleration(5_000_000)
            .deceleration(5_000_000);
        let first = bus.abs(2_000, quick);
        bus.wait_accepted(first);
        bus.drive.habits.acknowledge_delay = 50;
        bus.run_until(2_000, |bus| bus.drive.demand > 1_700.0);
        let doubtful = bus.abs(1_960, quick);
        assert!(matches!(
            bus.finish(doubtful),
            Err(Failure::Timeout {
                delivery: Delivery::Unknown,
                ..
            })
        ));
        let end = bus.finish(first);
        assert!(
            matches!(end, Err(Failure::PerhapsSuperseded { .. })),
            "{frequency}: {end:?}"
        );
    }
}
