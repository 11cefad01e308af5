//! Moves of an axis that lags behind its demand, goes past its ends, dithers, and begins late. The drive is written from CiA 402 alone, and what
//! it has done judges.
#![allow(missing_docs)]

use core::time::Duration;

#[path = "common/differential.rs"]
mod differential;
#[path = "common/frames.rs"]
mod frames;
#[path = "common/plant.rs"]
mod plant;

use frames::{Link, Random};
use plant::{Bus, End, Habits};
use servocrab::axis::{Command, CommandId, Completion, Doubt, Failure};
use servocrab::profile_position::{
    BufferMode, BufferSignal, MoveCommand, Reference, RelativeBase, SetPoint,
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
            Err(Failure::Timeout { .. })
            | Err(Failure::Unknown {
                doubt: Doubt::NotBegun | Doubt::StillLow | Doubt::Unacknowledged,
                ..
            }) => {
                return Err(format!("{id:?} was told {result:?} at {at}: {entry:?}"));
            }
            _ => {}
        }
    }
    Ok(())
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
        for id in moves {
            let end = bus.finish(id);
            assert!(
                matches!(end, Ok(Completion::Reached { .. })),
                "{signal:?} {id:?}: {end:?}"
            );
        }
        assert_eq!(judge(&bus, &moves), Ok(()), "{signal:?}");
    }
}

/// What one random run drew, and what came of it.
fn sweep(seed: u64, wild: bool) -> Result<(), String> {
    let mut random = Random::new(seed);
    let mut draw = |range: core::ops::Range<i64>| {
        let span = (range.end - range.start) as u64;
        range.start + random.below(span) as i64
    };
    let shows_room = draw(0..4) == 0;
    let window = [5, 10, 20, 50, 100, 300][draw(0..6) as usize];
    let habits = Habits {
        frequency: draw(25..400) as f64,
        damping: draw(4..13) as f64 / 10.0,
        window: window as i32,
        window_time: draw(1..20) as u32,
        ends_settled: draw(0..2) == 0,
        shows_room,
        dither: draw(0..3) as i32,
        acknowledge_delay: draw(0..4) as u32,
        ..Habits::default()
    };
    let signal = match (shows_room, draw(0..2)) {
        (true, _) => BufferSignal::Acknowledge,
        (false, 0) => BufferSignal::None,
        (false, _) => BufferSignal::Unknown,
    };
    let mut bus = Bus::new(habits, |config| {
        config.traits.buffer_signal = signal;
        config.tolerances.position = window;
    });
    bus.latency = draw(0..3) as usize;
    bus.period = [1, 1, 1, 2, 4, 20][draw(0..if wild { 6 } else { 4 }) as usize];
    let faults = if wild {
        [0, 1, 5][draw(0..3) as usize]
    } else {
        0
    };
    bus.enable();
    let mut moves = Vec::new();
    let mut at = 0;
    for _ in 0..draw(3..7) {
        let start = match draw(0..5) {
            _ if moves.is_empty() => BufferMode::Aborting,
            0..3 => BufferMode::Buffered,
            _ => BufferMode::Blending,
        };
        let far = [200, 2_000, 20_000][draw(0..3) as usize];
        at += draw(-far..far);
        let set_point = SetPoint::new()
            .buffer_mode(start)
            .acceleration(draw(50..2_000) as u32 * 1_000)
            .deceleration(draw(50..2_000) as u32 * 1_000);
        // As many as may wait.
        while moves.len() >= 3
            && bus.outcome(moves[moves.len() - 3]).is_none()
            && bus.drive.now < 60_000
        {
            let link = link(draw(0..1_000), faults);
            bus.cycle_over(link);
        }
        moves.push(bus.abs(at as i32, set_point));
        let pause = [0, 5, 50, 400][draw(0..4) as usize];
        for _ in 0..pause {
            let link = link(draw(0..1_000), faults);
            bus.cycle_over(link);
        }
    }
    while moves.iter().any(|id| bus.outcome(*id).is_none()) && bus.drive.now < 90_000 {
        let link = link(draw(0..1_000), faults);
        bus.cycle_over(link);
    }
    if std::env::var_os("PLANT_PRINT").is_some() {
        for event in &bus.events {
            println!("{event:?}");
        }
        for entry in &bus.drive.ledger {
            println!("{entry:?}");
        }
    }
    judge(&bus, &moves).map_err(|what| {
        format!(
            "seed {seed}, {signal:?}, {:?}, period {}: {what}",
            bus.drive.habits, bus.period
        )
    })
}

/// So many of a hundred frames do not come back as they should.
fn link(drawn: i64, faults: i64) -> Link {
    match drawn {
        drawn if drawn >= faults * 10 => Link::Good,
        drawn if drawn % 3 == 0 => Link::RequestLost,
        drawn if drawn % 3 == 1 => Link::ReplyLost,
        _ => Link::Miscounted,
    }
}

fn search(wild: bool) {
    let runs = std::env::var("PLANT_RUNS")
        .ok()
        .and_then(|runs| runs.parse().ok())
        .unwrap_or(400);
    let from = std::env::var("PLANT_FROM")
        .ok()
        .and_then(|from| from.parse().ok())
        .unwrap_or(0);
    let failed: Vec<String> = (from..from + runs)
        .filter_map(|seed| sweep(seed, wild).err())
        .collect();
    assert!(
        failed.is_empty(),
        "{} of {runs}:\n{}",
        failed.len(),
        failed[..failed.len().min(5)].join("\n")
    );
}

#[test]
fn no_size_of_overshoot_makes_a_place_free_that_is_not() {
    search(false);
}

#[test]
fn nor_does_it_with_frames_lost_and_long_cycles() {
    search(true);
}

/// A chain of two, with `blind` so many cycles from moment `moment` on; `stall`: as one long cycle.
fn blind_around_an_arrival(
    habits: &Habits,
    targets: [i32; 3],
    moment: u32,
    blind: u32,
    stall: bool,
) -> Result<[Result<Completion, Failure>; 3], String> {
    let signal = if habits.shows_room {
        BufferSignal::Acknowledge
    } else {
        BufferSignal::None
    };
    let mut bus = Bus::enabled(*habits, |config| {
        config.traits.buffer_signal = signal;
        config.loss.stale_cycles = 60;
        config.loss.undelivered_cycles = 90;
    });
    let fast = SetPoint::new()
        .acceleration(4_000_000)
        .deceleration(4_000_000);
    let moves = [
        bus.abs(targets[0], fast),
        bus.abs(targets[1], fast.buffer_mode(BufferMode::Buffered)),
        bus.abs(targets[2], fast.buffer_mode(BufferMode::Buffered)),
    ];
    bus.run(moment as usize);
    if stall {
        bus.cycle_after(Link::Good, blind + 1);
    } else {
        for _ in 0..blind {
            bus.cycle_over(Link::ReplyLost);
        }
    }
    let outcomes = moves.map(|id| bus.finish(id));
    judge(&bus, &moves).map_err(|what| {
        format!("{habits:?} {targets:?}, blind for {blind} from {moment}, stall {stall}: {what}")
    })?;
    Ok(outcomes)
}

/// So many cycles without inputs around each arrival, as one long cycle where `stall`: no end is wrong, and some are unseen.
fn nothing_unseen_is_missed(times: &[u32], stall: bool) {
    let (mut runs, mut unseen, mut failed) = (0, 0, Vec::new());
    for shows_room in [true, false] {
        for frequency in [0.0, 300.0] {
            let habits = Habits {
                shows_room,
                frequency,
                ..Habits::default()
            };
            for targets in [
                [300, -300, 0],
                [2_000, 1_000, 3_000],
                [60, 20, 100],
                [120, 240, 120],
            ] {
                for moment in (0..220).step_by(4) {
                    for &blind in times {
                        runs += 1;
                        match blind_around_an_arrival(&habits, targets, moment, blind, stall) {
                            Ok(outcomes) => {
                                unseen += outcomes
                                    .iter()
                                    .filter(|outcome| is_unknown(**outcome, Doubt::Unseen))
                                    .count();
                            }
                            Err(what) => failed.push(what),
                        }
                    }
                }
            }
        }
    }
    assert!(
        failed.is_empty(),
        "{} of {runs}: {:#?}",
        failed.len(),
        &failed[..failed.len().min(5)]
    );
    assert!(unseen > 0, "of {runs}");
    println!("{runs} runs, {unseen} ends unseen");
}

#[test]
fn a_target_that_was_passed_unseen_is_not_missed() {
    nothing_unseen_is_missed(&[2, 5, 9], false);
}

#[test]
fn a_target_that_was_passed_while_the_host_stood_still_is_not_missed() {
    nothing_unseen_is_missed(&[30, 120], true);
}

#[test]
fn a_target_that_is_passed_between_two_long_cycles_is_not_missed() {
    for shows_room in [true, false] {
        for frequency in [0.0, 300.0] {
            for (first, second) in [
                (300, 0),
                (900, 100),
                (2_000, 1_900),
                (140, -2_000),
                (5_000, 9_000),
            ] {
                for phase in 0..20 {
                    let habits = Habits {
                        shows_room,
                        frequency,
                        ..Habits::default()
                    };
                    let mut bus = Bus::enabled(habits, |config| {
                        config.traits.buffer_signal = if shows_room {
                            BufferSignal::Acknowledge
                        } else {
                            BufferSignal::None
                        };
                    });
                    bus.period = 20;
                    bus.cycle_after(Link::Good, 20 + phase);
                    let fast = SetPoint::new()
                        .acceleration(4_000_000)
                        .deceleration(4_000_000);
                    let moves = [
                        bus.abs(first, fast),
                        bus.abs(second, fast.buffer_mode(BufferMode::Buffered)),
                        bus.abs(first, fast.buffer_mode(BufferMode::Buffered)),
                    ];
                    for id in moves {
                        bus.finish(id).ok();
                    }
                    assert_eq!(
                        judge(&bus, &moves),
                        Ok(()),
                        "{shows_room} {frequency} {first} {second} {phase}"
                    );
                }
            }
        }
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
        assert_eq!(bus.now.saturating_sub(accepted).as_millis(), 2_000);
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
        for dwell in [50, 250, 900] {
            for frequency in [0.0, 125.0] {
                let habits = Habits {
                    dwell,
                    shows_room,
                    frequency,
                    ..Habits::default()
                };
                let mut bus = Bus::enabled(habits, |config| {
                    config.traits.buffer_signal = if shows_room {
                        BufferSignal::Acknowledge
                    } else {
                        BufferSignal::None
                    };
                });
                let moves = [
                    bus.abs(5_000, SetPoint::new()),
                    bus.abs(9_000, after()),
                    bus.abs(-3_000, after()),
                    bus.abs(-2_000, after()),
                ];
                for id in moves {
                    let end = bus.finish(id);
                    assert!(
                        matches!(end, Ok(Completion::Reached { .. })),
                        "{shows_room} {dwell} {id:?}: {end:?}"
                    );
                }
                assert_eq!(judge(&bus, &moves), Ok(()), "{shows_room} {dwell}");
            }
        }
    }
}

#[test]
fn an_axis_that_rests_beside_its_end_and_does_not_stand_still_has_missed_it() {
    for (droop, dither) in [(60, 20), (-60, 20), (200, 90)] {
        let habits = Habits {
            droop,
            dither,
            frequency: 125.0,
            ..Habits::default()
        };
        let mut bus = Bus::enabled(habits, |_| {});
        let id = bus.abs(5_000, SetPoint::new());
        let end = bus.finish(id);
        assert!(
            matches!(end, Err(Failure::MissedTarget { target: 5_000, .. })),
            "{droop} {dither}: {end:?}"
        );
        // The same with another behind it.
        let first = bus.abs(0, SetPoint::new());
        bus.wait_accepted(first);
        let second = bus.abs(3_000, after());
        bus.finish(first).ok();
        bus.finish(second).ok();
    }
}

/// A drive that never says that a target is reached.
fn silent() -> Bus {
    let habits = Habits {
        never_reached: true,
        ..Habits::default()
    };
    Bus::enabled(habits, |config| {
        config.traits.buffer_signal = BufferSignal::None;
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
fn two_moves_whose_drive_never_shows_bit_10_end_when_the_axis_has_stood_at_the_end_of_one() {
    let mut bus = silent();
    bus.run(200);
    let first = bus.abs(5_000, SetPoint::new());
    bus.wait_accepted(first);
    // So short a way that the position does not show when its turn has come.
    let second = bus.abs(5_015, after());
    bus.wait_accepted(second);
    bus.run(2_000);
    assert_eq!((bus.outcome(first), bus.outcome(second)), (None, None));
    bus.run(500);
    for id in [first, second] {
        let end = bus.finish(id);
        assert!(is_unknown(end, Doubt::StillLow), "{end:?}");
    }
    needs_stop(&mut bus);
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

/// A slow axis, whose drive shows bit 10 as soon as its demand is at the end.
fn slow() -> Habits {
    Habits {
        frequency: 25.0,
        damping: 0.4,
        window: 1_000,
        ..Habits::default()
    }
}

#[test]
fn an_axis_that_still_settles_when_the_next_move_is_taken_has_not_missed_that() {
    // It settles towards the next target, and away from it.
    for (start, target) in [BufferMode::Buffered, BufferMode::Aborting]
        .into_iter()
        .flat_map(|start| [(start, 5_000), (start, 1_000)])
    {
        let mut bus = Bus::enabled(slow(), |config| config.tolerances.position = 50);
        let first = bus.abs(3_000, SetPoint::new());
        assert!(bus.finish(first).is_ok());
        let at = bus.drive.actual;
        // The drive waits with bit 10 high, and the axis goes on to the end before.
        bus.drive.habits.start_delay = 900;
        let second = bus.abs(target, SetPoint::new().buffer_mode(start));
        bus.wait_accepted(second);
        let mut furthest: f64 = 0.0;
        for _ in 0..850 {
            bus.cycle();
            furthest = furthest.max((bus.drive.actual - at).abs());
        }
        assert!(furthest > 60.0, "it moves by {furthest}");
        assert_eq!(bus.outcome(second), None, "{start:?} {target}");
        let end = bus.finish(second);
        assert!(
            matches!(end, Ok(Completion::Reached { .. })),
            "{start:?} {target}: {end:?}"
        );
    }
}

#[test]
fn an_axis_that_sets_off_slowly_has_not_come_to_rest_where_it_was() {
    for (start, target) in [(BufferMode::Buffered, 27), (BufferMode::Aborting, -40)] {
        let habits = Habits {
            start_delay: 400,
            ..slow()
        };
        let mut bus = Bus::enabled(habits, |_| {});
        let id = bus.abs(target, SetPoint::new().buffer_mode(start));
        let end = bus.finish(id);
        assert!(
            matches!(end, Ok(Completion::Reached { .. })),
            "{target}: {end:?}"
        );
        assert!((bus.drive.actual - f64::from(target)).abs() <= 11.0);
        // With another behind it.
        let first = bus.abs(0, SetPoint::new());
        bus.wait_accepted(first);
        let second = bus.abs(target, after());
        for id in [first, second] {
            let end = bus.finish(id);
            assert!(
                matches!(end, Ok(Completion::Reached { .. })),
                "{target} {id:?}: {end:?}"
            );
        }
    }
}

#[test]
fn a_distance_from_an_axis_that_settles_ends_where_any_of_its_bases_lets_it() {
    for base in [
        RelativeBase::Demand,
        RelativeBase::Actual,
        RelativeBase::Undocumented,
    ] {
        for from_actual in [true, false] {
            let habits = Habits {
                from_actual,
                ..slow()
            };
            let mut bus = Bus::enabled(habits, |config| config.traits.relative_base = base);
            let first = bus.abs(3_000, SetPoint::new());
            assert!(bus.finish(first).is_ok());
            bus.run(40);
            let off = (bus.drive.actual - 3_000.0).abs();
            assert!(off > 30.0, "{off}");
            let id = bus.rel(300, SetPoint::new());
            let end = bus.finish(id);
            assert!(
                matches!(end, Ok(Completion::Reached { .. })),
                "{base:?} {from_actual}: {end:?}"
            );
        }
    }
}

#[test]
fn bit_10_of_a_halt_that_is_still_shown_is_not_that_of_the_move_that_goes_on() {
    for reference in [Reference::Absolute, Reference::Relative] {
        for (lost, link) in [
            (0, Link::Good),
            (8, Link::RequestLost),
            (8, Link::Undelivered),
        ] {
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

#[test]
fn a_distance_of_no_length_after_a_miss_has_not_ended_before_it_begins() {
    let habits = Habits {
        limits: Some((-3_000, 3_000)),
        ..Habits::default()
    };
    let mut bus = Bus::enabled(habits, |_| {});
    // Whatever the drive counts from is where the axis was enabled, and then where it has arrived.
    bus.run(100);
    for target in [None, Some(1_000)] {
        if let Some(target) = target {
            let id = bus.abs(target, SetPoint::new());
            assert!(bus.finish(id).is_ok());
        }
        let nowhere = bus.rel(0, SetPoint::new());
        assert!(bus.finish(nowhere).is_ok(), "{target:?}");
    }
    let missed = bus.abs(5_000, SetPoint::new());
    assert!(matches!(
        bus.finish(missed),
        Err(Failure::MissedTarget { .. })
    ));
    bus.run(150);
    // It may count from 5000, and wait before it sets off.
    let nowhere = bus.rel(0, SetPoint::new());
    let end = bus.finish(nowhere);
    assert!(is_unknown(end, Doubt::NotBegun), "{end:?}");
}

#[test]
fn distances_that_wait_behind_one_that_is_short_have_not_ended_with_it() {
    let habits = Habits {
        start_delay: 400,
        dwell: 400,
        shows_room: true,
        ..Habits::default()
    };
    for distances in [[5, 1_000, 5], [5, 1_000, 1_000], [5, -7, 900]] {
        let mut bus = Bus::enabled(habits, |config| {
            config.traits.buffer_signal = BufferSignal::Acknowledge;
            config.deadlines.acknowledge = Duration::from_secs(5);
        });
        bus.run(150);
        let moves = distances.map(|distance| bus.rel(distance, after()));
        for id in moves {
            bus.finish(id).ok();
        }
        // One within the window is over at once, for all that shows.
        let long = moves
            .iter()
            .zip(distances)
            .filter(|(_, way)| way.abs() > 10);
        let long: Vec<_> = long.map(|(id, _)| *id).collect();
        assert_eq!(judge(&bus, &long), Ok(()), "{distances:?}");
        assert!(
            moves
                .iter()
                .all(|id| bus.outcome(*id).is_some_and(|end| end.is_ok()))
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
        for id in [doubtful, first] {
            let end = bus.finish(id);
            assert!(
                is_unknown(end, Doubt::Unacknowledged),
                "{frequency}: {end:?}"
            );
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

/// It waits 200 ms with bit 10 high before it begins, and between two moves.
fn late() -> Habits {
    Habits {
        start_delay: 200,
        dwell: 200,
        ..Habits::default()
    }
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
        let end = format!("{:?}", bus.finish(first));
        assert!(end.contains(passed), "{end}");
        let end = bus.finish(second);
        assert_eq!(end, Ok(Completion::Reached { position: 2_000 }));
    }
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
        bus.finish(first),
        Ok(Completion::Reached { position: 10_000 })
    );
    assert!(!bus.accepted(second));
    assert_eq!(
        bus.finish(second),
        Ok(Completion::Reached { position: 20_000 })
    );
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
