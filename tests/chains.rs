//! Set-points behind and over each other: full buffers, blends both ways, moves of no length, the same target twice;
//! judged by the drive's ledger.
#![allow(missing_docs)]

mod common;

use common::{Link, Rig};
use servocrab::axis::{Command, CommandId, Completion, Failure};
use servocrab::drives;
use servocrab::profile_position::{
    BufferMode, Delivery, MoveCommand, Reference, RelativeBase, SetPoint,
};
use servocrab_sim::ds402::{self, AckFault, Behaviour, Bit5, Executed, FullBuffer, Outcome};

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

fn after() -> SetPoint {
    SetPoint::new().buffer_mode(BufferMode::Buffered)
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

fn executed(rig: &Rig) -> Vec<(i64, Outcome)> {
    let judge = |e: &Executed| (e.target.expect("it was started"), e.outcome);
    rig.ledger().iter().map(judge).collect()
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
        Err(Failure::Unsupported { .. })
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

#[test]
fn a_full_buffer_is_not_taken_for_replaced_by_a_drive_under_local_control() {
    let mut rig = pp2010();
    let (first, second) = full(&mut rig);
    // Its active move ends soon, and bit 12 falls.
    rig.run_until(20_000, |rig| rig.drive.position() > 49_900);
    rig.drive.set_remote(false);
    rig.run(2);
    let third = rig.abs(-10_000, SetPoint::new());
    rig.run(200);
    rig.drive.set_remote(true);
    let end = rig.finish(third);
    rig.run(5_000);
    assert!(
        matches!(
            end,
            Err(Failure::Timeout {
                delivery: Delivery::Unknown,
                ..
            })
        ),
        "{end:?}"
    );
    let judged = executed(&rig);
    let reached = [(50_000, Outcome::Reached), (60_000, Outcome::Reached)];
    assert_eq!(judged, reached, "the drive has gone on with its queue");
    for id in [first, second] {
        let told = rig.outcome(id);
        assert_ne!(told, Some(Err(Failure::Superseded)));
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
    let failure = rig.finish(third).expect_err("it was not taken");
    assert!(
        matches!(
            failure,
            Failure::Unconfirmed {
                target: -10_000,
                ..
            } | Failure::Timeout {
                delivery: Delivery::Unknown,
                ..
            }
        ),
        "{failure:?}"
    );
    let next = rig.abs(0, SetPoint::new());
    if matches!(failure, Failure::Timeout { .. }) {
        assert_eq!(rig.outcome(next), Some(Err(Failure::NeedsStop)));
    }
}

#[test]
fn a_stop_between_the_edge_and_its_proof_says_that_it_is_unknown() {
    let mut rig = pp2010();
    full(&mut rig);
    let third = rig.abs(-10_000, SetPoint::new());
    rig.run_until(10, |rig| rig.words.last() == Some(&0x3F));
    let stop = rig.send(Command::QuickStop);
    assert!(rig.finish(stop).is_ok());
    assert_eq!(
        rig.outcome(third),
        Some(Err(Failure::QuickStopped {
            delivery: Delivery::Unknown
        }))
    );
}

#[test]
fn blends_pass_their_targets_both_ways_and_in_order() {
    for direction in [1, -1] {
        let mut rig = Rig::enabled();
        let blend = SetPoint::new().buffer_mode(BufferMode::Blending);
        let moves: Vec<_> = (1..=4)
            .map(|n| {
                let start = if n == 1 { SetPoint::new() } else { blend };
                rig.abs(direction * n * 15_000, start)
            })
            .collect();
        let last = *moves.last().expect("four moves");
        rig.assert_reached(last, direction * 60_000);
        for id in &moves[..3] {
            assert!(matches!(
                rig.outcome(*id),
                Some(Ok(Completion::Passed { .. }))
            ));
        }
        let ends: Vec<_> = rig
            .events
            .iter()
            .filter_map(|(id, event)| {
                matches!(event, servocrab::axis::Event::Done(_)).then_some(*id)
            })
            .filter(|id| moves.contains(id))
            .collect();
        assert_eq!(ends, moves, "in the order of the moves");
        let outcomes: Vec<_> = rig.ledger().iter().map(|e| e.outcome).collect();
        assert_eq!(
            outcomes,
            [
                Outcome::Passed,
                Outcome::Passed,
                Outcome::Passed,
                Outcome::Reached
            ]
        );
    }
}

#[test]
fn a_blend_that_has_to_turn_back_is_executed_and_ends_at_its_own_target() {
    let mut rig = Rig::enabled();
    let first = rig.abs(20_000, SetPoint::new());
    let second = rig.abs(5_000, SetPoint::new().buffer_mode(BufferMode::Blending));
    rig.assert_reached(second, 5_000);
    assert!(matches!(rig.outcome(first), Some(Ok(_))));
    assert_eq!(rig.ledger().len(), 2);
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

#[test]
fn a_way_that_is_longer_than_half_the_number_circle_is_not_over_on_its_way() {
    for (from, to) in [
        (-2_000_000_000, 2_000_000_000),
        (2_000_000_000, -2_000_000_000),
    ] {
        let behaviour = Behaviour {
            full_buffer: FullBuffer::OverwritePending,
            ..Behaviour::akd2g()
        };
        // These are the numbers' ends, and faster than any shaft.
        let mut rig = Rig::new(behaviour, |_| {}).ideal();
        rig.drive.place(from);
        rig.enable();
        let fast = |start| {
            SetPoint::new()
                .velocity(2_000_000_000)
                .acceleration(4_000_000_000)
                .deceleration(4_000_000_000)
                .buffer_mode(start)
        };
        let first = rig.abs(to as i32, fast(BufferMode::Aborting));
        let second = rig.abs(to as i32 / 2, fast(BufferMode::Buffered));
        let third = rig.abs(to as i32 / 4, fast(BufferMode::Buffered));
        let reached = |position: i64| {
            Ok(Completion::Reached {
                position: position as i32,
            })
        };
        assert_eq!(rig.finish(first), reached(to));
        assert_eq!(rig.finish(second), reached(to / 2));
        assert_eq!(rig.finish(third), reached(to / 4));
        let ends: Vec<_> = executed(&rig);
        assert_eq!(
            ends,
            [to, to / 2, to / 4].map(|end| (end, Outcome::Reached)),
            "each was executed, in order"
        );
    }
}

#[test]
fn a_move_that_waits_for_others_to_start_with_does_not_fail_by_one_cycle_that_is_not_delivered() {
    let mut rig = Rig::akd2g();
    rig.enable();
    let gated = |target: i32| {
        Command::Move(MoveCommand {
            reference: Reference::Absolute,
            target,
            set_point: SetPoint::new(),
            gated: true,
        })
    };
    // The handshake before is not over yet: it waits for that for a moment.
    let before = rig.abs(0, SetPoint::new());
    rig.wait_accepted(before);
    let id = rig.send(gated(1_000));
    // Then it has all that it needs, for much longer than any deadline of a handshake.
    rig.run(5_000);
    assert!(rig.core.is_armed(id));
    rig.cycle_over(Link::Miscounted);
    assert_eq!(rig.outcome(id), None);
    rig.cycle();
    assert!(rig.core.is_armed(id));
    rig.core.fire(rig.now, id, &mut rig.outputs);
    rig.assert_reached(id, 1_000);
}

/// It counts from where the axis is when the move before passes its end: behind that by the following error.
#[test]
fn a_distance_blended_on_a_drive_that_counts_from_the_actual_position_ends_where_that_leads() {
    let behaviour = Behaviour {
        relative_base: ds402::RelativeBase::Actual,
        actual_lag_cycles: 5,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |config| {
        config.traits.relative_base = RelativeBase::Actual;
    });
    rig.enable();
    let first = rig.abs(10_000, SetPoint::new());
    let second = rig.rel(10_000, SetPoint::new().buffer_mode(BufferMode::Blending));
    let end = rig.finish(second);
    let executed = executed(&rig)[1];
    assert!(executed.0 < 19_900, "{executed:?}");
    assert_eq!(executed.1, Outcome::Reached);
    assert!(matches!(
        rig.outcome(first),
        Some(Ok(Completion::Passed { .. }))
    ));
    let Ok(Completion::Reached { position }) = end else {
        panic!("{end:?}");
    };
    assert!(executed.0.abs_diff(position.into()) <= 10, "{position}");
}
