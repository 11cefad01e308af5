//! A drive that ends a move before its target without a word: whoever waits is told, with the host's own checks off.
#![allow(missing_docs)]

mod common;

use common::Rig;
use servocrab::axis::{Command, CommandId, Completion, Failure};
use servocrab::profile_position::{BufferMode, BufferSignal, Limits, RelativeBase, SetPoint};
use servocrab_sim::ds402::{AckPolicy, Behaviour, LimitViolation};

/// A drive that moves to −5000 or 5000 at most.
fn clamping(ack: AckPolicy) -> Rig {
    lagging(ack, 0)
}

/// The same, with its actual position so many cycles behind the demand.
fn lagging(ack: AckPolicy, actual_lag_cycles: u32) -> Rig {
    let mut rig = not_enabled(ack, actual_lag_cycles);
    set_limits(&mut rig, -5_000, 5_000);
    rig.enable();
    rig
}

/// The same, without limits and before its power is on.
fn not_enabled(ack: AckPolicy, actual_lag_cycles: u32) -> Rig {
    let behaviour = Behaviour {
        ack,
        actual_lag_cycles,
        limit_violation: LimitViolation::Clamp,
        ..Behaviour::generic()
    };
    Rig::new(behaviour, |config| {
        config.limits = Limits::trust_drive();
        config.traits.relative_base = RelativeBase::PreviousTarget;
        config.traits.buffer_signal = match ack {
            AckPolicy::BufferFree => BufferSignal::Acknowledge,
            _ => BufferSignal::None,
        };
    })
}

/// 607Dh; 0 and 0 are no limits.
fn set_limits(rig: &mut Rig, min: i64, max: i64) {
    for (subindex, limit) in [(1, min), (2, max)] {
        rig.drive.set(0x607D, subindex, limit).unwrap();
    }
}

const POLICIES: [AckPolicy; 2] = [AckPolicy::FollowsBit4, AckPolicy::BufferFree];

/// How the move ends. Its position is that of a plant: to the nearest hundred, if it is within the window of that.
fn end(rig: &mut Rig, id: CommandId) -> Result<Completion, Failure> {
    let round = |position: i32| {
        let hundred = (position + 50).div_euclid(100) * 100;
        if (position - hundred).abs() <= 10 {
            hundred
        } else {
            position
        }
    };
    match rig.finish(id) {
        Ok(Completion::Reached { position }) => Ok(Completion::Reached {
            position: round(position),
        }),
        Err(Failure::MissedTarget { target, actual }) => missed(target, round(actual)),
        Err(Failure::NotBegun { actual }) => Err(Failure::NotBegun {
            actual: round(actual),
        }),
        other => other,
    }
}

fn missed(target: i32, actual: i32) -> Result<Completion, Failure> {
    Err(Failure::MissedTarget { target, actual })
}

#[test]
fn a_single_move_beyond_the_drives_limit_has_missed_its_target() {
    for ack in POLICIES {
        for (target, limit) in [(8_000, 5_000), (-5_100, -5_000)] {
            let mut rig = clamping(ack);
            let id = rig.abs(target, SetPoint::new());
            assert_eq!(end(&mut rig, id), missed(target, limit), "{ack:?}");
            let back = rig.abs(0, SetPoint::new());
            assert_eq!(end(&mut rig, back), Ok(Completion::Reached { position: 0 }));
        }
    }
}

#[test]
fn a_distance_beyond_the_drives_limit_has_missed_its_target_where_its_base_is_known() {
    for ack in POLICIES {
        let mut rig = clamping(ack);
        let first = rig.abs(4_000, SetPoint::new());
        end(&mut rig, first).unwrap();
        let id = rig.rel(3_000, SetPoint::new());
        assert_eq!(end(&mut rig, id), missed(7_000, 5_000), "{ack:?}");
    }
}

/// The outcomes of a move beyond the limit and of the one queued behind it.
fn with_one_behind(
    rig: &mut Rig,
    target: i32,
    next: i32,
    buffer_mode: BufferMode,
) -> [Result<Completion, Failure>; 2] {
    let first = rig.abs(target, SetPoint::new());
    rig.wait_accepted(first);
    let second = rig.abs(next, SetPoint::new().buffer_mode(buffer_mode));
    let outcomes = [end(rig, first), end(rig, second)];
    let order: Vec<CommandId> = rig
        .events
        .iter()
        .filter(|(_, event)| matches!(event, servocrab::axis::Event::Done(_)))
        .map(|(id, _)| *id)
        .filter(|id| [first, second].contains(id))
        .collect();
    assert_eq!(order, [first, second], "outcomes come in order");
    outcomes
}

#[test]
fn a_move_beyond_the_drives_limit_has_missed_its_target_also_with_another_behind_it() {
    for ack in POLICIES {
        for start in [BufferMode::Buffered, BufferMode::Blending] {
            for next in [1_000, -4_000, 4_990, 5_000] {
                let mut rig = clamping(ack);
                let [first, second] = with_one_behind(&mut rig, 8_000, next, start);
                assert!(
                    matches!(first, Err(Failure::MissedTarget { target: 8_000, .. })),
                    "{ack:?} {start:?} {next}: {first:?}"
                );
                let is_there = |position: i32| (position - next).abs() <= 20;
                assert!(
                    matches!(second, Ok(Completion::Reached { position }) if is_there(position)),
                    "{ack:?} {start:?} {next}: {second:?}"
                );
            }
        }
    }
}

/// It stands where the first has ended, with bit 10 high: nothing shows whether the drive has done with the second or waits with it.
#[test]
fn of_two_moves_beyond_the_drives_limit_the_second_does_not_show_that_it_has_begun() {
    for ack in POLICIES {
        for start in [BufferMode::Buffered, BufferMode::Blending] {
            let mut rig = clamping(ack);
            let outcomes = with_one_behind(&mut rig, 8_000, 9_000, start);
            assert_eq!(
                outcomes,
                [
                    missed(8_000, 5_000),
                    Err(Failure::NotBegun { actual: 5_000 })
                ],
                "{ack:?} {start:?}"
            );
            let next = rig.abs(0, SetPoint::new());
            assert_eq!(rig.outcome(next), Some(Err(Failure::NeedsStop)));
            assert!(rig.core.snapshot().has_set_point);
            let stop = rig.send(Command::Stop);
            assert!(rig.finish(stop).is_ok());
            assert!(!rig.core.snapshot().has_set_point);
        }
    }
}

#[test]
fn a_target_that_the_axis_reaches_late_behind_its_demand_is_not_missed() {
    // The actual position follows the demand by 20 ms: when the drive goes on, the axis is not there yet.
    for ack in POLICIES {
        for (start, next) in [
            (BufferMode::Buffered, 1_000),
            (BufferMode::Buffered, 9_000),
            (BufferMode::Blending, 9_000),
        ] {
            let mut rig = lagging(ack, 20);
            rig.drive.set(0x607D, 1, 0).unwrap();
            rig.drive.set(0x607D, 2, 0).unwrap();
            let first = rig.abs(4_000, SetPoint::new().deceleration(4_000_000));
            rig.wait_accepted(first);
            let second = rig.abs(
                next,
                SetPoint::new().buffer_mode(start).deceleration(4_000_000),
            );
            let outcome = end(&mut rig, first);
            assert!(outcome.is_ok(), "{ack:?} {start:?} {next}: {outcome:?}");
            assert!(end(&mut rig, second).is_ok());
        }
    }
}

#[test]
fn a_target_that_is_passed_on_the_way_to_the_drives_limit_is_not_reached() {
    // The axis stands beyond a limit that was set since: whatever the target, the drive goes to the limit, and shows bit 11.
    for ack in POLICIES {
        for start in [BufferMode::Buffered, BufferMode::Blending] {
            let mut rig = clamping(ack);
            set_limits(&mut rig, 0, 0);
            let out = rig.abs(9_000, SetPoint::new());
            assert!(rig.finish(out).is_ok());
            set_limits(&mut rig, -5_000, 5_000);
            let first = rig.abs(7_000, SetPoint::new());
            let second = rig.abs(0, SetPoint::new().buffer_mode(start));
            let third = rig.abs(4_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
            let outcome = end(&mut rig, first);
            assert!(
                matches!(outcome, Err(Failure::MissedTarget { target: 7_000, .. })),
                "{ack:?} {start:?}: {outcome:?}"
            );
            assert!(end(&mut rig, second).is_ok());
            assert_eq!(
                end(&mut rig, third),
                Ok(Completion::Reached { position: 4_000 })
            );
            assert_eq!(rig.ledger().len(), 4);
        }
    }
}

#[test]
fn a_bit_11_that_is_always_high_makes_no_target_missed() {
    for ack in POLICIES {
        for start in [BufferMode::Buffered, BufferMode::Blending] {
            // At 50 counts a cycle most of them are passed between two cycles, further from both than the window is wide.
            for target in (4_000..4_050).step_by(10) {
                let mut rig = not_enabled(ack, 0);
                rig.drive.disturbances().always_limited = true;
                rig.enable();
                let [first, second] = with_one_behind(&mut rig, target, 9_000, start);
                assert!(first.is_ok(), "{ack:?} {start:?} {target}: {first:?}");
                assert_eq!(second, Ok(Completion::Reached { position: 9_000 }));
            }
        }
    }
}

#[test]
fn the_way_of_the_moves_before_does_not_lead_to_the_end_of_the_next() {
    // The first and the second end at the limit; the third makes the drive say so of the second, too.
    for always_limited in [true, false] {
        let mut rig = not_enabled(AckPolicy::BufferFree, 0);
        rig.drive.disturbances().always_limited = always_limited;
        set_limits(&mut rig, -5_000, 5_000);
        rig.enable();
        let after = || SetPoint::new().buffer_mode(BufferMode::Buffered);
        let moves = [
            rig.abs(8_000, SetPoint::new()),
            rig.abs(5_400, after()),
            rig.abs(-1_000, after()),
        ];
        let [first, second, third] = moves.map(|id| end(&mut rig, id));
        for (target, outcome) in [(8_000, first), (5_400, second)] {
            assert!(
                matches!(outcome, Err(Failure::MissedTarget { target: of, .. }) if of == target),
                "{target}, {always_limited}: {outcome:?}"
            );
        }
        assert_eq!(third, Ok(Completion::Reached { position: -1_000 }));
    }
}

#[test]
fn the_way_through_a_halt_does_not_lead_to_the_end() {
    // The axis takes more counts to come to rest than are left to the target, and the drive does not go there.
    let mut rig = not_enabled(AckPolicy::BufferFree, 0);
    rig.drive.disturbances().always_limited = true;
    set_limits(&mut rig, -5_000, 5_000);
    rig.enable();
    let first = rig.abs(5_600, SetPoint::new());
    let second = rig.abs(0, SetPoint::new().buffer_mode(BufferMode::Buffered));
    rig.run_until(1_000, |rig| rig.drive.position() > 2_300);
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    assert!(rig.drive.position() < 4_950);
    let resume = rig.send(Command::Resume);
    assert_eq!(rig.finish(resume), Ok(Completion::Done));
    let outcome = end(&mut rig, first);
    assert!(
        matches!(outcome, Err(Failure::MissedTarget { target: 5_600, .. })),
        "{outcome:?}"
    );
    assert_eq!(
        end(&mut rig, second),
        Ok(Completion::Reached { position: 0 })
    );
}

/// Bit 10 of the rest before stays while the axis sets off, more slowly than its window in a settle time.
#[test]
fn an_axis_that_sets_off_slowly_with_bit_10_has_not_come_to_rest() {
    let forge = |rig: &mut Rig| {
        rig.forged = Some(rig.drive.statusword() | 0x0400);
        rig.cycle();
    };
    for behind in [None, Some(15)] {
        let mut rig = Rig::enabled();
        let first = rig.abs(500, SetPoint::new().velocity(90));
        while !rig.accepted(first) {
            forge(&mut rig);
        }
        let buffered = SetPoint::new().buffer_mode(BufferMode::Buffered);
        let second = behind.map(|target| (rig.abs(target, buffered), target));
        while rig.drive.position() < 14 {
            forge(&mut rig);
        }
        rig.assert_reached(first, 500);
        if let Some((id, target)) = second {
            rig.assert_reached(id, target);
        }
    }
}
