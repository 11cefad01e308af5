//! Moves of an axis that lags behind its demand, goes past its ends, dithers, and begins late. The drive is written from CiA 402 alone, and what
//! it has done judges.

use crate::common::Link;
use crate::plant::{Bus, End, Habits};
use servocrab::{
    BufferMode, SetPoint,
    profile_position::{BufferSignal, MoveCommand, Reference},
};
use servocrab::{
    Doubt, Failure,
    axis::{Command, CommandId, Completion},
};

/// An axis that goes 32 counts past its end at 500 000 counts/s², critically damped.
fn overshooting() -> Habits {
    Habits {
        frequency: 125.0,
        ..Habits::default()
    }
}

fn after() -> SetPoint {
    SetPoint::new().buffer_mode(BufferMode::Buffered)
}

fn is_unknown(end: Result<Completion, Failure>, why: Doubt) -> bool {
    matches!(end, Err(Failure::Unknown { doubt, .. }) if doubt == why)
}

/// With what its documents say of bit 12.
fn showing(habits: Habits) -> Bus {
    Bus::enabled(habits, |config| {
        config.traits.buffer_signal = if habits.shows_room {
            BufferSignal::Acknowledge
        } else {
            BufferSignal::None
        };
    })
}

/// `Reached` and `Passed` are true of each of these moves, none went into a full buffer, and each has ended.
fn judge(bus: &Bus, moves: &[CommandId]) -> Result<(), String> {
    for id in moves {
        let Some((at, result)) = bus.told(*id) else {
            return Err(format!("{id:?} has no end"));
        };
        let entry = bus.entry(*id);
        if let Some(lost) = entry.filter(|entry| !entry.taken) {
            return Err(format!(
                "{id:?} went into a full buffer: {lost:?}, {result:?}"
            ));
        }
        let ended = entry.and_then(|entry| entry.ended);
        let over = ended
            .is_some_and(|(when, how)| when <= at && matches!(how, End::Stopped | End::Passed));
        match result {
            Ok(_) if !over => return Err(format!("{id:?} was told {result:?} at {at}: {entry:?}")),
            // An axis that cuts a corner has not been at its end.
            Err(Failure::MissedTarget { .. })
                if entry
                    .is_some_and(|entry| entry.nearest <= f64::from(bus.drive.habits.window)) =>
            {
                return Err(format!("{id:?} was told {result:?} at {at}: {entry:?}"));
            }
            Err(Failure::Timeout { .. }) => {
                return Err(format!("{id:?} was told {result:?} at {at}: {entry:?}"));
            }
            _ => {}
        }
    }
    Ok(())
}

fn all_are_reached(bus: &mut Bus, moves: &[CommandId], what: &str) {
    for id in moves {
        let end = bus.finish(*id);
        assert!(
            matches!(end, Ok(Completion::Reached { .. })),
            "{what} {id:?}: {end:?}"
        );
    }
    assert_eq!(judge(bus, moves), Ok(()), "{what}");
}

#[test]
fn an_axis_that_goes_past_its_end_has_not_left_it() {
    for signal in [BufferSignal::None, BufferSignal::Unknown] {
        let mut bus = Bus::enabled(overshooting(), |config| {
            config.traits.buffer_signal = signal;
        });
        let moves = [
            bus.abs(10_000, SetPoint::new()),
            bus.abs(20_000, after()),
            bus.abs(30_000, after()),
            bus.abs(25_000, after()),
        ];
        all_are_reached(&mut bus, &moves, &format!("{signal:?}"));
    }
}

#[test]
fn a_set_point_that_the_drive_begins_late_has_neither_ended_nor_missed() {
    for signal in [BufferSignal::None, BufferSignal::Acknowledge] {
        for start_delay in [150, 400, 1_500] {
            let habits = Habits {
                start_delay,
                ..Habits::default()
            };
            let mut bus = Bus::enabled(habits, |config| config.traits.buffer_signal = signal);
            let absolute = bus.abs(5_000, SetPoint::new());
            assert_eq!(
                bus.finish(absolute),
                Ok(Completion::Reached { position: 5_000 }),
                "{start_delay}"
            );
            let relative = bus.rel(-2_000, SetPoint::new());
            assert_eq!(
                bus.finish(relative),
                Ok(Completion::Reached { position: 3_000 }),
                "{start_delay}"
            );
            let nowhere = bus.rel(0, SetPoint::new());
            assert_eq!(
                bus.finish(nowhere),
                Ok(Completion::Reached { position: 3_000 })
            );
        }
    }
}

#[test]
fn a_set_point_that_does_not_begin_counts_as_held_until_a_stop() {
    for reference in [Reference::Absolute, Reference::Relative] {
        let habits = Habits {
            start_delay: 2_500,
            ..Habits::default()
        };
        let mut bus = Bus::enabled(habits, |_| {});
        let id = bus.go(reference, 5_000, SetPoint::new());
        bus.wait_accepted(id);
        let accepted = bus.now;
        let end = bus.finish(id);
        assert!(is_unknown(end, Doubt::NotBegun), "{end:?}");
        // It has to stand before that counts.
        let took = bus.now.saturating_sub(accepted).as_millis();
        assert!((2_000..=2_105).contains(&took), "{took}");
        needs_stop(&mut bus);
        bus.run(3_000);
        assert_eq!(bus.drive.demand, 0.0, "it has never begun");
        bus.drive.habits.start_delay = 0;
        let again = bus.abs(100, SetPoint::new());
        assert!(bus.finish(again).is_ok());
    }
}

#[test]
fn a_drive_that_rests_between_queued_moves_with_bit_10_high_is_followed_to_the_last() {
    for shows_room in [true, false] {
        is_followed_to_the_last(shows_room, 50);
    }
}

#[test]
fn a_long_rest_between_moves_is_no_end_where_bit_12_shows_the_buffer() {
    is_followed_to_the_last(true, 250);
}

fn is_followed_to_the_last(shows_room: bool, dwell: u32) {
    for frequency in [0.0, 125.0] {
        let habits = Habits {
            dwell,
            shows_room,
            frequency,
            ..Habits::default()
        };
        let mut bus = showing(habits);
        let moves = [
            bus.abs(5_000, SetPoint::new()),
            bus.abs(9_000, after()),
            bus.abs(-3_000, after()),
            bus.abs(-2_000, after()),
        ];
        all_are_reached(&mut bus, &moves, &format!("{shows_room} {dwell}"));
    }
}

/// An acknowledge during lost frames: bit 12 was low before the rise of bit 4, and is high in the first answer after it.
#[test]
fn an_acknowledge_is_seen_also_where_the_replies_behind_bit_4_are_lost() {
    for shows_room in [true, false] {
        let mut bus = showing(Habits {
            shows_room,
            ..Habits::default()
        });
        bus.run(150);
        let id = bus.abs(2_000, after());
        bus.run_until(10, |bus| bus.word() & 1 << 4 != 0);
        for _ in 0..3 {
            bus.cycle_over(Link::ReplyLost);
        }
        let end = bus.finish(id);
        assert_eq!(end, Ok(Completion::Reached { position: 2_000 }));
    }
}

/// A drive that never says that a target is reached.
fn silent() -> Bus {
    showing(Habits {
        never_reached: true,
        ..Habits::default()
    })
}

#[test]
fn a_move_whose_drive_never_shows_bit_10_ends_when_the_axis_has_stood_at_its_target() {
    let mut bus = silent();
    for (target, takes) in [(5_000, 300), (5_000, 0), (5_004, 0), (-3_000, 400)] {
        let id = bus.abs(target, SetPoint::new());
        bus.wait_accepted(id);
        bus.run(1_950);
        assert_eq!(bus.outcome(id), None, "{target}");
        bus.run(takes + 200);
        let end = bus.outcome(id).expect("it has stood for long enough");
        assert!(is_unknown(end, Doubt::StillLow), "{target}: {end:?}");
        needs_stop(&mut bus);
    }
}

/// The drive may hold a set-point: no other is sent before a stop.
fn needs_stop(bus: &mut Bus) {
    assert!(bus.core.snapshot().has_set_point);
    let refused = bus.abs(100, SetPoint::new());
    assert_eq!(bus.outcome(refused), Some(Err(Failure::NeedsStop)));
    let stop = bus.send(Command::Stop);
    assert!(bus.finish(stop).is_ok());
    assert!(!bus.core.snapshot().has_set_point && !bus.drive.holds_any());
    bus.enable();
}

#[test]
fn a_move_that_rests_elsewhere_with_bit_10_low_is_under_way() {
    let habits = Habits {
        never_reached: true,
        droop: 60,
        ..Habits::default()
    };
    let mut bus = Bus::enabled(habits, |_| {});
    let id = bus.abs(5_000, SetPoint::new());
    bus.run(10_000);
    assert_eq!(bus.outcome(id), None);
}

#[test]
fn bit_10_of_a_halt_that_is_still_shown_is_not_that_of_the_move_that_goes_on() {
    goes_on_after_its_halt([(0, Link::Good)]);
}

#[test]
fn bit_10_of_a_halt_whose_end_was_lost_is_not_that_of_the_move_that_goes_on() {
    goes_on_after_its_halt([(8, Link::RequestLost), (8, Link::Undelivered)]);
}

/// With so many frames like this behind its resume.
fn goes_on_after_its_halt<const N: usize>(lost: [(u32, Link); N]) {
    for reference in [Reference::Absolute, Reference::Relative] {
        for (lost, link) in lost {
            let habits = Habits {
                start_delay: 600,
                halt_hides_bit_10: true,
                ..Habits::default()
            };
            let mut bus = Bus::enabled(habits, |_| {});
            bus.latency = 1;
            let id = bus.go(reference, 1_000, SetPoint::new());
            bus.wait_accepted(id);
            let halt = bus.send(Command::Halt);
            assert!(bus.finish(halt).is_ok());
            bus.send(Command::Resume);
            // The drive hears of it late.
            for _ in 0..lost {
                bus.cycle_over(link);
            }
            let resumed = bus.drive.now;
            let end = bus.finish(id);
            assert!(
                matches!(end, Ok(Completion::Reached { .. })),
                "{reference:?} {lost} {link:?}: {end:?}"
            );
            assert!(
                bus.drive.now - resumed > 500,
                "{reference:?} {lost} {link:?}"
            );
            assert!((bus.drive.actual - 1_000.0).abs() < 1.0);
        }
    }
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
        let end = bus.finish(id);
        let entry = bus.entry(id).expect("it was sent");
        assert!(
            matches!(entry.ended, Some((_, End::Stopped))),
            "{frequency}: {end:?}, {entry:?}"
        );
        passed += 1;
    }
    assert!(passed > 3, "{passed}");
}

#[test]
fn a_move_on_a_ready_axis_rises_in_the_next_frame() {
    const BIT_4: u16 = 1 << 4;
    let mut bus = Bus::enabled(Habits::default(), |_| {});
    for (target, last) in [
        (1_000, Link::Good),
        (2_000, Link::ReplyLost),
        (3_000, Link::RequestLost),
        (4_000, Link::Miscounted),
    ] {
        bus.run(50);
        bus.cycle_over(last);
        let id = bus.abs(target, SetPoint::new());
        let at_once = bus.word() & BIT_4 != 0;
        assert_eq!(at_once, last == Link::Good, "after {last:?}");
        if !at_once {
            // Not before fresh inputs, whatever else comes.
            bus.cycle_over(last);
            assert_eq!(bus.word() & BIT_4, 0, "after {last:?}");
            bus.cycle();
            assert_eq!(bus.word() & BIT_4, BIT_4, "after {last:?}");
        }
        assert!(bus.finish(id).is_ok());
    }
}

#[test]
fn a_move_in_the_frame_of_a_resume_waits_until_that_was_sent() {
    const BIT_4: u16 = 1 << 4;
    let mut bus = Bus::enabled(Habits::default(), |_| {});
    let halt = bus.send(Command::Halt);
    assert!(bus.finish(halt).is_ok());
    bus.send(Command::Resume);
    let id = bus.abs(1_000, SetPoint::new());
    assert_eq!(bus.word() & (BIT_4 | 1 << 8), 0);
    assert!(bus.finish(id).is_ok());
}

#[test]
fn moves_that_start_together_are_not_released_on_old_inputs() {
    let gated = |target| {
        Command::Move(MoveCommand {
            reference: Reference::Absolute,
            target,
            set_point: SetPoint::new(),
            gated: true,
        })
    };
    for last in [Link::ReplyLost, Link::RequestLost, Link::Miscounted] {
        let mut bus = Bus::enabled(Habits::default(), |_| {});
        bus.run(50);
        let id = bus.send(gated(1_000));
        assert!(bus.core.is_armed(id));
        bus.cycle_over(last);
        assert!(!bus.core.is_armed(id), "{last:?}");
        bus.core.fire(bus.now, id, &mut bus.outputs);
        assert_eq!(bus.word() & 1 << 4, 0, "{last:?}");
        bus.cycle();
        assert!(bus.core.is_armed(id), "{last:?}");
        bus.core.fire(bus.now, id, &mut bus.outputs);
        assert!(bus.finish(id).is_ok());
    }
}
