//! What the drive may still hold: a set-point counts as held until its end is proven or a stop has abandoned it.
#![allow(missing_docs)]

#[path = "common/differential.rs"]
mod differential;
#[path = "common/frames.rs"]
mod frames;
#[path = "common/plant.rs"]
mod plant;

use core::time::Duration;

use frames::Link;
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

/// A drive that rests with bit 10 between two moves, on its way to 1000.
fn on_the_way() -> (Bus, CommandId) {
    let habits = Habits {
        dwell: 400,
        ..Habits::default()
    };
    let mut bus = Bus::enabled(habits, |_| {});
    let first = bus.abs(1_000, after());
    bus.wait_accepted(first);
    bus.run_until(2_000, |bus| bus.drive.actual > 100.0);
    (bus, first)
}

#[test]
fn a_resume_in_motion_changes_nothing_of_how_the_one_behind_begins() {
    let (mut bus, first) = on_the_way();
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
    let (mut bus, first) = on_the_way();
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
        ..habits
    };
    showing_room(habits, RelativeBase::Demand)
}

/// A drive whose bit 12 shows its buffer, and bit 10 its demand alone.
fn showing_room(habits: Habits, relative_base: RelativeBase) -> Bus {
    let habits = Habits {
        window: 1_000,
        window_time: 0,
        shows_room: true,
        ..habits
    };
    Bus::enabled(habits, |config| {
        config.traits = Traits {
            buffer_signal: BufferSignal::Acknowledge,
            relative_base,
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

/// The drive takes a distance while the axis swings through the end of the move before, counts from where the axis is, and begins it
/// when the swing is over. The axis then rests at the end of a distance from that move's end.
#[test]
fn a_distance_from_a_swing_has_not_ended_where_the_axis_then_rests() {
    let mut late = 0;
    for after_end in 0..60 {
        let habits = Habits {
            frequency: 60.0,
            damping: 0.25,
            start_delay: 900,
            from_actual: true,
            ..Habits::default()
        };
        let mut bus = showing_room(habits, RelativeBase::Undocumented);
        let first = bus.abs(1_000, after());
        bus.run_until(4_000, |bus| bus.drive.demand > 999.0);
        bus.run(after_end);
        let short = bus.rel(-5, after());
        if bus.outcome(first).is_some() {
            continue;
        }
        bus.run_until(4_000, |bus| {
            let gone = !bus.core.snapshot().has_set_point;
            if gone && let Some(entry) = bus.entry(short) {
                let end = entry.end.expect("it was taken");
                let gap = (bus.drive.actual - end).abs();
                assert!(
                    entry.ended.is_some() || gap < 25.0,
                    "{after_end}: {gap:.0} counts from its end"
                );
            }
            late += usize::from(gone);
            bus.outcome(short).is_some() && !bus.drive.holds_any()
        });
    }
    assert!(late > 0);
}

/// The axis creeps to the end of a move while the drive rests before the next one.
#[test]
fn the_creep_to_the_end_of_the_move_before_is_not_the_motion_of_the_next() {
    let mut bus = resting(Habits {
        frequency: 30.0,
        feed_forward: 0.0,
        start_delay: 150,
        ..Habits::default()
    });
    bus.run(150);
    let first = bus.abs(24, after());
    bus.wait_accepted(first);
    let second = bus.abs(3_815, after());
    for (id, position) in [(first, 24), (second, 3_815)] {
        let end = finish(&mut bus, id);
        assert!(
            matches!(end, Ok(Completion::Reached { position: at }) if (at - position).abs() <= 10),
            "{position}: {end:?}"
        );
    }
}

/// A drive goes on from end to end while the axis swings: it passes the end of the third move while the settle times of those before it,
/// at whose ends it never was, are not over yet.
#[test]
fn an_end_that_was_passed_while_those_before_it_were_open_is_not_missed() {
    for frequency in 15..30 {
        let habits = Habits {
            frequency: f64::from(frequency),
            damping: 0.25,
            feed_forward: 0.5,
            ..Habits::default()
        };
        let mut bus = showing_room(habits, RelativeBase::Demand);
        let quick = after().acceleration(2_000_000).deceleration(2_000_000);
        let moves = [-275, -6, -100].map(|target| bus.abs(target, quick));
        bus.wait_accepted(moves[2]);
        bus.run_until(2_000, |bus| bus.outcome(moves[0]).is_some());
        bus.abs(-1_220, quick);
        for id in moves {
            let end = bus.finish(id);
            let entry = bus.entry(id).expect("it was sent");
            let missed = matches!(end, Err(Failure::MissedTarget { .. }));
            assert!(
                !missed || entry.nearest > 9.0,
                "{frequency}: {end:?}, {entry:?}"
            );
        }
    }
}

/// The drive has ended a move whose end the axis has swung through, and counts the distance behind it from where the axis is.
#[test]
fn a_distance_behind_an_end_that_the_axis_has_swung_past_counts_from_nobody_knows_where() {
    let mut swung = 0;
    for after_end in 0..60 {
        let habits = Habits {
            frequency: 60.0,
            damping: 0.25,
            from_actual: true,
            shows_room: true,
            ..Habits::default()
        };
        let mut bus = Bus::enabled(habits, |config| {
            config.traits = Traits {
                buffer_signal: BufferSignal::Acknowledge,
                relative_base: RelativeBase::Actual,
                ..Traits::cia402()
            };
        });
        let first = bus.abs(1_000, after());
        bus.run_until(4_000, |bus| bus.drive.demand > 999.0);
        bus.run(after_end);
        let distance = bus.rel(40, after());
        swung += usize::from(bus.outcome(first).is_none());
        let end = bus.finish(distance);
        assert!(
            !matches!(end, Err(Failure::MissedTarget { .. })),
            "{after_end}: {end:?}, {:?}",
            bus.entry(distance)
        );
    }
    assert!(
        swung > 0,
        "the first is still followed when the distance comes"
    );
}

/// The same where the axis is far from that end, and bit 10 shows between the rise of bit 4 and its acknowledge that the drive is done with the
/// move before.
#[test]
fn a_distance_counts_from_nobody_knows_where_if_bit_10_rises_before_its_acknowledge() {
    let mut taken = 0;
    for before_end in 0..60 {
        let habits = Habits {
            // It lags by more than an axis is taken to lag for itself.
            frequency: 10.0,
            feed_forward: 0.0,
            from_actual: true,
            ..Habits::default()
        };
        let mut bus = showing_room(habits, RelativeBase::Actual);
        let first = bus.abs(1_000, after());
        bus.wait_accepted(first);
        bus.run_until(4_000, |bus| bus.drive.demand > 950.0);
        bus.run(before_end);
        let distance = bus.rel(40, after());
        bus.run_until(10, |bus| bus.entry(distance).is_some());
        let first = bus.entry(first).expect("it was sent");
        // Behind one that it still has it counts from the end of that.
        if first.ended.is_some() {
            bus.wait_accepted(distance);
            bus.run(1_500);
            bus.abs(-1_000, after());
            let end = bus.finish(distance);
            assert!(
                !matches!(end, Err(Failure::MissedTarget { .. })),
                "{before_end}: {end:?}, {:?}",
                bus.entry(distance)
            );
            taken += 1;
        }
    }
    assert!(taken > 2);
}

/// The drive stops before a blended move that turns back, and rests with bit 10, there and at the end of that.
#[test]
fn a_short_blend_for_which_the_drive_stops_has_not_begun_with_bit_12() {
    let mut bus = resting(Habits::default());
    let first = bus.abs(1_000, after());
    bus.wait_accepted(first);
    bus.run_until(2_000, |bus| bus.drive.actual > 100.0);
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

/// Bit 10 is wrong in one cycle, in which the axis, ahead of its demand, goes through the end of the move: it is elsewhere in the next.
#[test]
fn a_bit_10_of_one_cycle_while_the_axis_goes_through_its_end_ends_nothing() {
    let mut passed = 0;
    for frequency in 40..80 {
        let at_speed = |wrong_bit_10| {
            let habits = Habits {
                frequency: f64::from(frequency),
                damping: 0.25,
                wrong_bit_10,
                ..Habits::default()
            };
            let mut bus = Bus::enabled(habits, |_| {});
            let quick = SetPoint::new().acceleration(2_000_000);
            let id = bus.abs(2_000, quick.deceleration(2_000_000));
            bus.wait_accepted(id);
            (bus, id)
        };
        let (mut bus, _) = at_speed(None);
        let at_end = |bus: &Bus| bus.drive.actual > 1_990.0;
        bus.run_until(2_000, at_end);
        let early = bus.drive.demand < 1_950.0 && bus.drive.rate > 11.0;
        if bus.drive.actual > 2_010.0 || !early {
            continue;
        }
        let (mut bus, id) = at_speed(Some(bus.drive.now));
        // The drive never holds one that the core does not know.
        let end = finish(&mut bus, id);
        let entry = bus.entry(id).expect("it was sent");
        assert!(
            matches!(entry.ended, Some((_, End::Stopped))),
            "{frequency}: {end:?}, {entry:?}"
        );
        passed += 1;
    }
    assert!(passed > 3, "{passed}");
}

/// Where nothing before it may be held, the next one goes to the drive before the axis has moved.
#[test]
fn behind_a_move_that_the_drive_begins_late_the_next_is_sent_at_once() {
    for buffer_mode in [BufferMode::Buffered, BufferMode::Blending] {
        let mut bus = Bus::enabled(late(), |_| {});
        bus.run(110);
        let first = bus.abs(1_000, after());
        bus.wait_accepted(first);
        let second = bus.abs(2_000, SetPoint::new().buffer_mode(buffer_mode));
        bus.wait_accepted(second);
        assert_eq!(bus.drive.actual, 0.0, "{buffer_mode:?} came late");
        let passed = match buffer_mode {
            BufferMode::Blending => "Passed",
            _ => "Reached",
        };
        let end = format!("{:?}", finish(&mut bus, first));
        assert!(end.contains(passed), "{end}");
        let end = finish(&mut bus, second);
        assert_eq!(end, Ok(Completion::Reached { position: 2_000 }));
    }
}

fn quick() -> SetPoint {
    after().acceleration(2_000_000).deceleration(2_000_000)
}

/// An axis that swings around 1000, so many cycles after its demand has come there; the drive counts distances from where the axis is.
fn swinging(frequency: u16, dwell: u32, after_end: usize) -> Bus {
    let mut bus = showing_room(
        Habits {
            frequency: frequency.into(),
            damping: 0.5,
            dwell,
            from_actual: true,
            ..Habits::default()
        },
        RelativeBase::Actual,
    );
    bus.abs(1_000, quick());
    bus.run_until(4_000, |bus| bus.drive.demand > 999.0);
    bus.run(after_end);
    bus
}

/// Whether the drive ends this one outside of the window around the place.
fn ends_beside(bus: &Bus, id: CommandId, place: f64) -> bool {
    let end = bus.entry(id).and_then(|entry| entry.end);
    end.is_some_and(|end| (end - place).abs() > 10.0)
}

/// The drive counts both distances from where the axis swings: where they lead is not known to the count, so none has missed its end.
#[test]
fn a_distance_behind_one_that_ends_beside_its_end_has_missed_nothing() {
    let mut beside = 0;
    for frequency in [40, 60, 100, 200] {
        for (after_end, dwell) in (0..40).flat_map(|after_end| [(after_end, 0), (after_end, 30)]) {
            let mut bus = swinging(frequency, dwell, after_end);
            bus.rel(4_000, quick());
            bus.run(30);
            let last = bus.rel(400, quick());
            let end = finish(&mut bus, last);
            assert!(
                !matches!(end, Err(Failure::MissedTarget { .. })),
                "{frequency}, {after_end}, {dwell}: {end:?}"
            );
            beside += usize::from(ends_beside(&bus, last, 5_400.0));
        }
    }
    assert!(beside > 0);
}

/// A distance ends beside the place that was calculated for its end, since the drive counts it from where the axis swings. The drive rests there,
/// with bit 10, before the next distance: the axis has not gone on that by as much.
#[test]
fn what_a_distance_leads_beside_its_end_is_not_the_motion_of_the_next() {
    let mut beside = 0;
    for frequency in (30..320).step_by(10) {
        for after_end in 0..40 {
            let mut bus = swinging(frequency, 400, after_end);
            let distances = [bus.rel(40, quick()), bus.rel(40, quick())];
            bus.run_until(10_000, |bus| {
                let gone = !bus.core.snapshot().has_set_point;
                if gone && let Some(entry) = bus.entry(distances[1]) {
                    assert!(entry.ended.is_some(), "{frequency}, {after_end}: {entry:?}");
                }
                distances.iter().all(|id| bus.outcome(*id).is_some())
            });
            beside += usize::from(ends_beside(&bus, distances[0], 1_040.0));
        }
    }
    assert!(beside > 0);
}

/// A move that waits for its acknowledge behind another replaces nothing: it does not hold back how that one ends.
#[test]
fn a_queued_move_without_its_acknowledge_does_not_hold_back_the_end_of_the_one_before() {
    let habits = Habits {
        acknowledge_delay: 100,
        dwell: 200,
        ..Habits::default()
    };
    let mut bus = Bus::enabled(habits, |_| {});
    let first = bus.abs(10_000, after());
    bus.wait_accepted(first);
    bus.run_until(4_000, |bus| bus.drive.demand > 9_950.0);
    let second = bus.abs(20_000, after());
    assert_eq!(
        finish(&mut bus, first),
        Ok(Completion::Reached { position: 10_000 })
    );
    assert!(!bus.accepted(second));
    assert_eq!(
        finish(&mut bus, second),
        Ok(Completion::Reached { position: 20_000 })
    );
}

/// A drive that shows no room, and of whose distances nobody knows from where they count.
fn undocumented() -> Bus {
    Bus::enabled(Habits::default(), |config| {
        config.traits = Traits {
            buffer_signal: BufferSignal::None,
            relative_base: RelativeBase::Undocumented,
            ..Traits::cia402()
        };
    })
}

#[test]
fn a_short_distance_behind_a_move_that_was_halted_and_resumed_has_begun() {
    let mut bus = undocumented();
    let first = bus.abs(1_000, after());
    bus.run_until(2_000, |bus| bus.drive.actual > 900.0);
    let short = bus.rel(25, after());
    bus.wait_accepted(short);
    let halt = bus.send(Command::Halt);
    assert!(bus.finish(halt).is_ok());
    assert!(bus.drive.actual < 990.0);
    let resume = bus.send(Command::Resume);
    assert_eq!(finish(&mut bus, resume), Ok(Completion::Done));
    assert_eq!(
        bus.finish(first),
        Ok(Completion::Reached { position: 1_000 })
    );
    assert_eq!(
        bus.finish(short),
        Ok(Completion::Reached { position: 1_025 })
    );
}

#[test]
fn a_distance_that_was_dropped_in_a_halt_has_not_passed_its_end() {
    let habits = Habits {
        start_delay: 200,
        shows_room: true,
        ..Habits::default()
    };
    let mut bus = Bus::enabled(habits, |config| {
        config.traits = Traits {
            buffer_signal: BufferSignal::Acknowledge,
            relative_base: RelativeBase::Undocumented,
            ..Traits::cia402()
        };
    });
    let dropped = bus.rel(-700, after());
    bus.wait_accepted(dropped);
    let halt = bus.send(Command::Halt);
    bus.run(10);
    // Its drive drops it while nothing is seen, and is halted no more before the axis is known to stand.
    bus.cycle_over(Link::ReplyLost);
    bus.drive.drop_all(End::Dropped);
    bus.cycle_over(Link::ReplyLost);
    let resume = bus.send(Command::Resume);
    assert_eq!(bus.finish(resume), Ok(Completion::Done));
    assert_eq!(bus.outcome(halt), Some(Err(Failure::Superseded)));
    let next = bus.abs(-4_000, SetPoint::new().buffer_mode(BufferMode::Blending));
    assert_eq!(bus.finish(dropped), Err(Failure::EndNotKnown { actual: 0 }));
    assert_eq!(
        bus.finish(next),
        Ok(Completion::Reached { position: -4_000 })
    );
}
