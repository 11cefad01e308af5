//! Moves one by one, queued, blended and replaced, up to limits and by distances; judged by the drive's ledger.

use core::time::Duration;

use crate::common::{Link, Rig};
use servocrab::coe::{ObjectAddress, obj};
use servocrab::drives::{self, DriveDescription};
use servocrab::ds402::Mode;
use servocrab::profile_velocity::JogSetPoint;
use servocrab::{
    BufferMode, SetPoint,
    profile_position::{BufferSignal, Limits, PositionRange, RelativeBase},
};
use servocrab::{
    Doubt, Failure, Referencing,
    axis::{Command, CommandId, Completion, Event, Unsupported},
};
use servocrab::{HomingMethod, homing::HomingCommand};
use servocrab_sim::ds402::{
    AckFault, AckPolicy, Behaviour, Bit5, Executed, LimitViolation, Outcome,
};

fn after() -> SetPoint {
    SetPoint::new().buffer_mode(BufferMode::Buffered)
}

fn executed(rig: &Rig) -> Vec<(i64, Outcome)> {
    let judge = |e: &Executed| (e.target.expect("it was started"), e.outcome);
    rig.ledger().iter().map(judge).collect()
}

fn is_unknown(end: Result<Completion, Failure>, why: Doubt) -> bool {
    matches!(end, Err(Failure::Unknown { doubt, .. }) if doubt == why)
}

#[test]
fn an_absolute_move_is_executed_once_and_reaches_its_target() {
    let mut rig = Rig::enabled();
    let id = rig.abs(10_000, SetPoint::new().velocity(50_000));
    rig.assert_reached(id, 10_000);
    assert_eq!(rig.ledger().len(), 1);
    assert_eq!(rig.ledger()[0].outcome, Outcome::Reached);
    assert_eq!(rig.reports(id).first(), Some(&Event::Accepted));
}

#[test]
fn a_move_with_immediately_supersedes_the_one_under_way() {
    let mut rig = Rig::enabled();
    let first = rig.abs(100_000, SetPoint::new());
    rig.wait_accepted(first);
    rig.run(100);
    let second = rig.abs(-5_000, SetPoint::new());
    rig.assert_reached(second, -5_000);
    assert_eq!(rig.outcome(first), Some(Err(Failure::Superseded)));
    assert_eq!(rig.ledger()[0].outcome, Outcome::Replaced);
}

#[test]
fn queued_and_blended_moves_end_in_order() {
    let mut rig = Rig::enabled();
    let a = rig.abs(10_000, SetPoint::new());
    let b = rig.abs(20_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    let c = rig.abs(30_000, SetPoint::new().buffer_mode(BufferMode::Blending));
    rig.assert_reached(c, 30_000);
    assert!(matches!(
        rig.outcome(a),
        Some(Ok(Completion::Reached { .. }))
    ));
    assert!(matches!(
        rig.outcome(b),
        Some(Ok(Completion::Passed { .. }))
    ));
    let outcomes: Vec<_> = rig.ledger().iter().map(|e| e.outcome).collect();
    assert_eq!(
        outcomes,
        [Outcome::Reached, Outcome::Passed, Outcome::Reached]
    );
}

#[test]
fn an_axis_that_was_not_homed_moves_by_distances_only_and_nothing_of_an_absolute_move_is_sent() {
    let mut rig = Rig::new(Behaviour::akd2g(), |config| {
        config.referencing = Referencing::ByHoming;
    });
    rig.enable();
    assert!(!rig.core.snapshot().referenced);
    let from = rig.words.len();
    let refused = rig.abs(10_000, SetPoint::new());
    assert_eq!(rig.outcome(refused), Some(Err(Failure::NotReferenced)));
    rig.run(200);
    assert_eq!(rig.distinct_words(from), [0x000F]);
    assert!(rig.ledger().is_empty());

    let relative = rig.rel(10_000, SetPoint::new());
    assert!(rig.finish(relative).is_ok());
    rig.assert_at(10_000);
}

#[test]
fn moves_of_no_length_are_moves() {
    for set_point in [SetPoint::new(), after()] {
        let mut rig = Rig::enabled();
        let moves = [
            rig.abs(0, set_point),
            rig.rel(0, after()),
            rig.abs(0, after()),
        ];
        for id in moves {
            rig.assert_reached(id, 0);
        }
        assert_eq!(rig.ledger().len(), 3);
    }
}

#[test]
fn the_same_target_twice_is_two_moves_queued_or_not() {
    for mut rig in [Rig::enabled(), pp2010()] {
        let first = rig.abs(8_000, SetPoint::new());
        let second = rig.abs(8_000, after());
        let third = rig.abs(8_000, after());
        for id in [first, second, third] {
            rig.assert_reached(id, 8_000);
        }
        assert_eq!(rig.ledger().len(), 3);
    }
}

#[test]
fn a_queued_move_that_is_executed_before_its_late_acknowledge_is_seen_is_not_the_end_of_the_one_before()
 {
    // It executes at once and acknowledges late.
    let mut rig = Rig::enabled();
    rig.drive.disturbances().ack_delay_cycles = 400;
    let first = rig.abs(696, SetPoint::new());
    rig.wait_accepted(first);
    let second = rig.abs(711, SetPoint::new().buffer_mode(BufferMode::Buffered));
    assert!(rig.finish(second).is_ok());
    assert!(rig.finish(first).is_ok(), "{:?}", rig.outcome(first));
}

#[test]
fn a_replacement_to_nearly_the_same_end_is_not_the_end_of_the_move_that_it_replaces() {
    for (deadline, late) in [(5_000, false), (300, true)] {
        // It executes at once and acknowledges late.
        let mut rig = Rig::new(Behaviour::akd2g(), |config| {
            config.deadlines.acknowledge = Duration::from_millis(deadline);
        });
        rig.enable();
        let first = rig.abs(10_000, SetPoint::new());
        rig.wait_accepted(first);
        rig.run(20);
        rig.drive.disturbances().ack_delay_cycles = 2_000;
        let second = rig.abs(10_008, SetPoint::new());
        let end = rig.finish(second);
        if late {
            assert!(is_unknown(end, Doubt::Unacknowledged), "{end:?}");
            let end = rig.finish(first);
            assert!(is_unknown(end, Doubt::Unacknowledged), "{end:?}");
        } else {
            assert!(matches!(end, Ok(Completion::Reached { .. })), "{end:?}");
            assert_eq!(rig.outcome(first), Some(Err(Failure::Superseded)));
        }
    }
}

/// The drive with 2010h: two set-points, a bit 12 that stays high while both are there.
fn pp2010() -> Rig {
    with_behaviour(behaviour())
}

/// That drive, but with 606Ch, which the rig maps.
fn behaviour() -> Behaviour {
    Behaviour {
        without: &[],
        ..Behaviour::pp2010()
    }
}

fn with_behaviour(behaviour: Behaviour) -> Rig {
    let mut rig = Rig::new(behaviour, |config| config.traits = drives::pp2010().traits);
    rig.enable();
    rig
}

/// A move under way to 50 000 and one behind it to 60 000: the buffer is full.
fn full(rig: &mut Rig) -> (CommandId, CommandId) {
    let first = rig.abs(50_000, SetPoint::new());
    let second = rig.abs(60_000, after());
    rig.wait_accepted(second);
    rig.run(100);
    assert!(rig.statusword().bits() & 1 << 12 != 0, "the buffer is full");
    (first, second)
}

#[test]
fn a_full_buffer_is_replaced_by_one_edge_and_the_motion_tells() {
    let mut rig = pp2010();
    let (first, second) = full(&mut rig);
    let sent = rig.words.len();
    let third = rig.abs(-10_000, SetPoint::new());
    rig.assert_reached(third, -10_000);
    assert_eq!(rig.outcome(first), Some(Err(Failure::Superseded)));
    assert_eq!(rig.outcome(second), Some(Err(Failure::Superseded)));
    assert_eq!(rig.distinct_words(sent), [0x3F, 0x0F]);
    assert_eq!(
        rig.ledger().last().map(|e| e.outcome),
        Some(Outcome::Reached)
    );
    rig.assert_at(-10_000);
}

#[test]
fn a_distance_onto_a_full_buffer_is_refused_and_nothing_is_sent() {
    let mut rig = pp2010();
    let (first, second) = full(&mut rig);
    let sent = rig.words.len();
    let third = rig.rel(-10_000, SetPoint::new());
    assert!(matches!(
        rig.finish(third),
        Err(Failure::Unsupported(Unsupported::Start { .. }))
    ));
    rig.assert_reached(second, 60_000);
    assert!(matches!(
        rig.outcome(first),
        Some(Ok(Completion::Reached { .. }))
    ));
    assert_eq!(rig.distinct_words(sent), [0x0F]);
}

/// At each moment around the edge one frame is lost, either way: the move is executed once.
#[test]
fn a_lost_frame_around_the_replacement_changes_timing_only() {
    for (link, lost) in [Link::RequestLost, Link::ReplyLost, Link::Miscounted]
        .into_iter()
        .flat_map(|link| (0..12).map(move |lost| (link, lost)))
    {
        let mut rig = pp2010();
        full(&mut rig);
        let third = rig.abs(-10_000, SetPoint::new());
        rig.run(lost);
        rig.cycle_over(link);
        rig.assert_reached(third, -10_000);
        let runs = executed(&rig)
            .iter()
            .filter(|(target, _)| *target == -10_000)
            .count();
        assert_eq!(runs, 1, "{link:?} {lost}");
    }
}

/// At each moment of the run down to the first target, which empties a place by itself.
#[test]
fn a_replacement_while_a_place_becomes_free_is_executed_once() {
    for moment in (0..1_200).step_by(3) {
        let mut rig = pp2010();
        let first = rig.abs(20_000, SetPoint::new());
        let second = rig.abs(25_000, after());
        rig.wait_accepted(second);
        rig.run(moment);
        if rig.outcome(second).is_some() {
            return;
        }
        let third = rig.abs(-3_000, SetPoint::new());
        rig.assert_reached(third, -3_000);
        assert!(rig.outcome(first).is_some() && rig.outcome(second).is_some());
        let runs = executed(&rig)
            .iter()
            .filter(|(target, _)| *target == -3_000)
            .count();
        assert_eq!(runs, 1, "at {moment} ms");
    }
    panic!("the second move has not ended");
}

#[test]
fn a_replacement_overtakes_the_moves_that_wait_for_their_turn() {
    for mut rig in [Rig::enabled(), pp2010()] {
        let moves: Vec<_> = (1..=4).map(|n| rig.abs(n * 50_000, after())).collect();
        rig.run(100);
        let now = rig.abs(-2_000, SetPoint::new());
        let behind = rig.abs(-4_000, after());
        rig.assert_reached(behind, -4_000);
        rig.assert_reached(now, -2_000);
        for id in moves {
            assert_eq!(rig.outcome(id), Some(Err(Failure::Superseded)));
        }
        let targets: Vec<_> = executed(&rig).iter().map(|(target, _)| *target).collect();
        let waited = targets.iter().any(|&target| target > 100_000);
        assert!(!waited, "{targets:?}");
    }
}

/// Against its documents, this drive goes on through its queue whatever bit 5 says.
#[test]
fn a_full_buffer_that_does_not_take_the_replacement_is_never_reported_as_reached() {
    let behaviour = Behaviour {
        bit_5: Bit5::Blends,
        ..behaviour()
    };
    let mut rig = with_behaviour(behaviour);
    full(&mut rig);
    let third = rig.abs(-10_000, SetPoint::new());
    let end = rig.finish(third);
    assert!(is_unknown(end, Doubt::Unacknowledged), "{end:?}");
    let next = rig.abs(0, SetPoint::new());
    assert_eq!(rig.outcome(next), Some(Err(Failure::NeedsStop)));
}

/// Where bit 12 follows bit 4, one that is still high belongs to the handshake before, which comes first: a drive need not
/// see an edge of bit 4 before it has ended that.
#[test]
fn a_replacement_waits_for_the_handshake_before_where_bit_12_follows_bit_4() {
    for late in [1, 3, 8, 20] {
        let mut rig = Rig::enabled();
        let first = rig.abs(50_000, SetPoint::new());
        let second = rig.abs(60_000, after());
        rig.wait_accepted(second);
        rig.drive.disturbances().ack = AckFault::StuckHigh;
        let third = rig.abs(-10_000, SetPoint::new());
        let sent = rig.words.len();
        rig.run(late);
        // Its bit 5 is out, and no bit 4.
        assert_eq!(rig.distinct_words(sent), [0x2F], "for {late} ms");
        rig.drive.disturbances().ack = AckFault::None;
        rig.assert_reached(third, -10_000);
        for replaced in [first, second] {
            assert_eq!(rig.outcome(replaced), Some(Err(Failure::Superseded)));
        }
    }
}

/// An AKD2G that can be jogged.
fn description() -> DriveDescription {
    let mut description = drives::akd2g();
    for axis in &mut description.axes {
        axis.outputs.push(obj::TARGET_VELOCITY.into());
    }
    description
}

/// A drive whose relative moves count from the previous target, 60F2h = 0, and a library that knows.
fn rig() -> Rig {
    let behaviour = Behaviour {
        relative_base: servocrab_sim::ds402::RelativeBase::PreviousTarget,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::of(description(), behaviour, |config| {
        config.traits.relative_base = RelativeBase::PreviousTarget;
        config.limits = Limits {
            software: Some(PositionRange {
                min: -100_000,
                max: 100_000,
            }),
            ..Limits::trust_drive()
        };
    });
    rig.enable();
    rig
}

fn mode(rig: &mut Rig, mode: Mode) {
    let id = rig.send(Command::SelectMode(mode));
    assert_eq!(rig.finish(id), Ok(Completion::Done));
}

/// Half a second with 20 000 counts/s.
fn jog(rig: &mut Rig) {
    mode(rig, Mode::ProfileVelocity);
    let jog = rig.send(Command::Jog(JogSetPoint::from(20_000)));
    rig.run(500);
    rig.core.release_jog(rig.now, jog, &mut rig.outputs);
    rig.finish(jog).unwrap();
    mode(rig, Mode::ProfilePosition);
}

/// A distance is gone from where the axis stands, and reported so.
fn goes(rig: &mut Rig, distance: i32) {
    let from = rig.drive.position() as i32;
    let id = rig.rel(distance, SetPoint::new());
    let end = rig.finish(id);
    let position = from + distance;
    assert!(
        matches!(end, Ok(Completion::Reached { position: at }) if at.abs_diff(position) <= 10),
        "{end:?}"
    );
}

#[test]
fn a_relative_replacement_beyond_a_limit_fails_alone() {
    let mut rig = rig();
    let first = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(first);
    let second = rig.abs(60_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    rig.wait_accepted(second);
    // No place for this one yet.
    let third = rig.abs(70_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    let fourth = rig.rel(90_000, SetPoint::new());
    rig.cycle();
    rig.cycle();
    assert!(matches!(
        rig.finish(fourth),
        Err(Failure::BeyondLimit { .. })
    ));
    assert!(matches!(rig.finish(third), Ok(Completion::Reached { .. })));
    assert_eq!(rig.reports(fourth).len(), 1);
}

/// No document says what its distances count from. 607Dh is from −5000 to 8000.
#[test]
fn a_distance_of_unknown_base_is_refused_where_it_may_end_beyond_a_limit() {
    let mut rig = Rig::of(drives::sigma7(), Behaviour::sigma7(), |config| {
        config.referencing = Referencing::AbsoluteEncoder;
        config.limits.software = Some(PositionRange {
            min: -5_000,
            max: 8_000,
        });
    })
    .ideal();
    rig.enable();
    let beyond = |rig: &mut Rig, distance, limit, asked| {
        let id = rig.rel(distance, SetPoint::new());
        rig.run(5);
        let expected = Failure::BeyondLimit {
            object: ObjectAddress::new(0x607D, if limit < 0 { 1 } else { 2 }),
            limit,
            asked,
        };
        assert_eq!(rig.outcome(id), Some(Err(expected)), "{distance}");
    };
    // The first, and those behind one of which it is not known where it ended.
    beyond(&mut rig, 8_001, 8_000, 8_001);
    beyond(&mut rig, -5_001, -5_000, -5_001);
    let first = rig.rel(8_000, SetPoint::new());
    rig.finish(first).unwrap();
    rig.assert_at(8_000);
    beyond(&mut rig, 1, 8_000, 8_001);
    beyond(&mut rig, i32::MAX, 8_000, 8_000 + i64::from(i32::MAX));
    assert_eq!(rig.ledger().len(), 1);
    // Pushed by hand, it may count from where it stands or from the target before.
    let before = rig.abs(7_000, SetPoint::new());
    rig.finish(before).unwrap();
    rig.run(300);
    let off = rig.send(Command::Disable);
    rig.finish(off).unwrap();
    rig.drive.place(1_000);
    rig.enable();
    beyond(&mut rig, 1_001, 8_000, 8_001);
    beyond(&mut rig, -6_001, -5_000, -5_001);
    let within = rig.rel(-6_000, SetPoint::new());
    rig.finish(within).unwrap();
    rig.assert_at(-5_000);
    // A stop has taken the target before away.
    let stopped = rig.abs(8_000, SetPoint::new().velocity(5_000));
    rig.wait_accepted(stopped);
    rig.run(500);
    let stop = rig.send(Command::Stop);
    rig.finish(stop).unwrap();
    rig.enable();
    let at = rig.core.snapshot().position;
    assert!((-4_500..0).contains(&at), "{at}");
    beyond(&mut rig, 8_001 - at, 8_000, 8_001);
    let within = rig.rel(8_000 - at, SetPoint::new());
    rig.finish(within).unwrap();
    rig.assert_at(8_000);
}

/// On a drive that counts from the target before, if that is still there.
#[test]
fn a_distance_of_an_axis_that_was_pushed_is_checked_from_where_it_is_and_from_the_target_before() {
    let mut rig = rig();
    let before = rig.abs(90_000, SetPoint::new());
    rig.finish(before).unwrap();
    rig.run(300);
    let off = rig.send(Command::Disable);
    rig.finish(off).unwrap();
    rig.drive.place(-90_000);
    rig.enable();
    let at = i64::from(rig.core.snapshot().position);
    let count = rig.ledger().len();
    for (distance, limit, asked) in [(10_001, 100_000, 100_001), (-20_000, -100_000, at - 20_000)] {
        let id = rig.rel(distance, SetPoint::new());
        assert!(
            matches!(
                rig.finish(id),
                Err(Failure::BeyondLimit { limit: of, asked: to, .. }) if of == limit && asked.abs_diff(to) <= 10
            ),
            "{distance}"
        );
    }
    assert_eq!(rig.ledger().len(), count);
    goes(&mut rig, 10_000);
}

#[test]
fn after_a_jog_a_homing_or_without_power_a_distance_counts_from_where_the_axis_stands() {
    let homes = |rig: &mut Rig| {
        mode(rig, Mode::Homing);
        rig.drive.set(0x6098, 0, 37).unwrap();
        let home = rig.send(Command::Home(HomingCommand {
            method: HomingMethod(37),
            offset: None,
            until: None,
        }));
        rig.finish(home).unwrap();
        mode(rig, Mode::ProfilePosition);
    };
    let is_pushed_by_hand = |rig: &mut Rig| {
        // At rest: there is nothing to stop.
        rig.run(300);
        let off = rig.send(Command::Disable);
        rig.finish(off).unwrap();
        rig.drive.place(5_000);
        rig.enable();
    };
    let between: [fn(&mut Rig); 3] = [jog, homes, is_pushed_by_hand];
    for between in between {
        let mut rig = rig();
        let first = rig.abs(1_000, SetPoint::new());
        rig.finish(first).unwrap();
        between(&mut rig);
        goes(&mut rig, 300);
    }
}

/// A drive that moves to −5000 or 5000 at most (607Dh), where the host does not know.
fn clamping(ack: AckPolicy) -> Rig {
    let behaviour = Behaviour {
        ack,
        limit_violation: LimitViolation::Clamp,
        ..Behaviour::generic()
    };
    let mut rig = Rig::new(behaviour, |config| {
        config.limits = Limits::trust_drive();
        config.traits.relative_base = RelativeBase::PreviousTarget;
        config.traits.buffer_signal = match ack {
            AckPolicy::BufferFree => BufferSignal::Acknowledge,
            _ => BufferSignal::None,
        };
    });
    for (subindex, limit) in [(1, -5_000), (2, 5_000)] {
        rig.drive.set(0x607D, subindex, limit).unwrap();
    }
    rig.enable();
    rig
}

/// The drive has gone on to the next: that the axis was never there between two samples is not proven.
fn is_missed_or_unseen(end: Result<Completion, Failure>) -> bool {
    matches!(end, Err(Failure::MissedTarget { .. })) || is_unknown(end, Doubt::Unseen)
}

const POLICIES: [AckPolicy; 2] = [AckPolicy::FollowsBit4, AckPolicy::BufferFree];

#[test]
fn a_move_beyond_the_drives_limit_has_missed_its_target() {
    for ack in POLICIES {
        for (target, limit) in [(8_000, 5_000), (-5_100, -5_000_i32)] {
            let mut rig = clamping(ack);
            let id = rig.abs(target, SetPoint::new());
            let end = rig.finish(id);
            let is_there = |actual: i32| actual.abs_diff(limit) <= 10;
            assert!(
                matches!(end, Err(Failure::MissedTarget { target: of, actual }) if of == target && is_there(actual)),
                "{ack:?}: {end:?}"
            );
            let back = rig.abs(0, SetPoint::new());
            rig.assert_reached(back, 0);
        }
    }
}

#[test]
fn a_move_beyond_the_drives_limit_has_not_reached_its_target_with_another_behind_it() {
    for ack in POLICIES {
        for start in [BufferMode::Buffered, BufferMode::Blending] {
            for next in [1_000, -4_000, 5_000, 9_000] {
                let what = format!("{ack:?} {start:?} {next}");
                let mut rig = clamping(ack);
                let first = rig.abs(8_000, SetPoint::new());
                rig.wait_accepted(first);
                let second = rig.abs(next, SetPoint::new().buffer_mode(start));
                let ends = [rig.finish(first), rig.finish(second)];
                assert!(is_missed_or_unseen(ends[0]), "{what}: {:?}", ends[0]);
                if next == 9_000 {
                    // It stands there with bit 10 high: the drive is done with the second, or waits with it.
                    assert!(
                        is_unknown(ends[1], Doubt::NotBegun),
                        "{what}: {:?}",
                        ends[1]
                    );
                } else {
                    rig.assert_reached(second, next);
                }
            }
        }
    }
}
