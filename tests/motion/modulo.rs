//! Modulo axes: positions that begin again are compared around the turn, on a simulated drive whose 607Bh makes it wrap.

use crate::common::{Link, Rig};
use servocrab::{
    BufferMode, SetPoint,
    profile_position::{BufferSignal, Limits, PositionRange, RelativeBase},
};
use servocrab::{
    Doubt, Failure,
    axis::{Completion, CoreConfig},
};
use servocrab_sim::ds402::{AckPolicy, Behaviour, LimitViolation, Outcome};

const TURN: PositionRange = PositionRange {
    min: 0,
    max: 35_999,
};

/// 60F2h, bits 7 and 6: only in positive direction, or the shortest way.
const POSITIVE: i64 = 2 << 6;
const SHORTEST: i64 = 3 << 6;

fn table(direction: i64, change: impl FnOnce(&mut CoreConfig)) -> Rig {
    table_of(Behaviour::generic(), direction, change)
}

/// A rotary table of 36000 counts a turn, enabled, at 0.
fn table_of(behaviour: Behaviour, direction: i64, change: impl FnOnce(&mut CoreConfig)) -> Rig {
    let follows = behaviour.ack == AckPolicy::FollowsBit4;
    let mut rig = Rig::new(behaviour, |config| {
        config.modulo = Some(TURN);
        config.traits.relative_base = RelativeBase::Demand;
        config.traits.buffer_signal = if follows {
            BufferSignal::None
        } else {
            BufferSignal::Acknowledge
        };
        change(config);
    });
    rig.drive.set(0x607B, 1, TURN.min.into()).unwrap();
    rig.drive.set(0x607B, 2, TURN.max.into()).unwrap();
    // The base of relative moves is the demand position.
    rig.drive.set(0x60F2, 0, direction | 1).unwrap();
    rig.enable();
    rig
}

fn reached(rig: &mut Rig, id: servocrab::axis::CommandId) -> i32 {
    match rig.finish(id) {
        Ok(Completion::Reached { position }) => position,
        other => panic!("{other:?}"),
    }
}

/// How far a shaft may be from where it is to be, in counts: the position window.
const WINDOW: i64 = 10;

/// The move ends within the window of its target, around the turn.
fn reaches(rig: &mut Rig, id: servocrab::axis::CommandId, target: i32) {
    let position = reached(rig, id);
    let turn = i64::from(TURN.max) + 1;
    let off = (i64::from(position) - i64::from(target)).rem_euclid(turn);
    assert!(off.min(turn - off) <= WINDOW, "{position}, not {target}");
}

/// So far, but for the windows at both ends.
fn assert_way(rig: &Rig, from: i64, way: i64, what: &str) {
    let gone = rig.drive.position() - from;
    assert!(
        (gone - way).abs() <= 2 * WINDOW,
        "{what}: {gone}, not {way}"
    );
}

#[test]
fn a_target_on_the_other_side_of_zero_is_reached_around_it() {
    for (direction, way) in [(POSITIVE, 1_000), (SHORTEST, 1_000), (0, -35_000)] {
        let mut rig = table(direction, |_| {});
        let first = rig.abs(35_500, SetPoint::new());
        reaches(&mut rig, first, 35_500);
        let before = rig.drive.position();
        let second = rig.abs(500, SetPoint::new());
        reaches(&mut rig, second, 500);
        assert_way(&rig, before, way, &format!("direction {direction:#x}"));
    }
}

#[test]
fn an_arrival_on_the_other_side_of_the_seam_is_within_the_window() {
    let mut rig = table(POSITIVE, |config| config.tolerances.position = 10);
    rig.drive.set(0x6067, 0, 100).unwrap();
    let near = rig.abs(35_900, SetPoint::new());
    reached(&mut rig, near);
    let id = rig.abs(0, SetPoint::new().velocity(1_000));
    rig.run_until(1_000, |rig| rig.drive.position() >= 35_994);
    // The last counts are friction.
    rig.drive.disturbances().blocked = true;
    let position = reached(&mut rig, id);
    // Less the noise of the encoder.
    assert!((35_990..36_000).contains(&position), "{position}");
}

#[test]
fn distances_of_several_turns_end_where_they_lead() {
    let mut rig = table(SHORTEST, |_| {});
    let start = rig.drive.position();
    let id = rig.rel(3 * 36_000 + 100, SetPoint::new().velocity(200_000));
    reaches(&mut rig, id, 100);
    assert_way(&rig, start, 108_100, "there");
    let back = rig.rel(-200, SetPoint::new());
    reaches(&mut rig, back, 35_900);
    assert_way(&rig, start, 107_900, "and back");
}

#[test]
fn an_absolute_target_beyond_the_turn_is_refused() {
    let mut rig = table(POSITIVE, |config| config.limits = Limits::trust_drive());
    for target in [-1, 36_000] {
        let id = rig.abs(target, SetPoint::new());
        assert!(
            matches!(rig.outcome(id), Some(Err(Failure::BeyondLimit { object, .. })) if object.index == 0x607B),
            "{target}"
        );
    }
    assert!(rig.ledger().is_empty());
}

#[test]
fn a_turn_of_the_table_that_passes_its_end_is_not_over() {
    // Three turns over the place where it ends, with the next one queued by the drive: neither is reported early.
    let mut rig = table(POSITIVE, |_| {});
    let first = rig.rel(3 * 36_000, SetPoint::new().velocity(100_000));
    rig.wait_accepted(first);
    let second = rig.rel(500, SetPoint::new().buffer_mode(BufferMode::Buffered));
    rig.run_until(2_000, |rig| rig.drive.position() > 40_000);
    assert_eq!(rig.outcome(first), None);
    reaches(&mut rig, first, 0);
    reaches(&mut rig, second, 500);
    let ends: Vec<_> = rig.ledger().iter().map(|line| line.outcome).collect();
    assert_eq!(ends, [Outcome::Reached, Outcome::Reached]);
}

#[test]
fn where_bit_12_shows_nothing_the_next_move_waits_for_the_arrival() {
    for start in [BufferMode::Buffered, BufferMode::Blending] {
        let mut rig = table_of(Behaviour::akd2g(), POSITIVE, |_| {});
        let first = rig.rel(2 * 36_000, SetPoint::new().velocity(100_000));
        rig.wait_accepted(first);
        let second = rig.abs(1_000, SetPoint::new().buffer_mode(start));
        rig.run_until(3_000, |rig| rig.drive.position() > 60_000);
        assert_eq!(rig.ledger().len(), 1, "sequenced here, after the arrival");
        reaches(&mut rig, first, 0);
        reaches(&mut rig, second, 1_000);
    }
}

#[test]
fn a_blend_over_the_seam_passes_its_target() {
    let mut rig = table(POSITIVE, |_| {});
    let first = rig.abs(35_000, SetPoint::new().velocity(100_000));
    rig.wait_accepted(first);
    let second = rig.abs(3_000, SetPoint::new().buffer_mode(BufferMode::Blending));
    assert!(matches!(rig.finish(first), Ok(Completion::Passed { .. })));
    reaches(&mut rig, second, 3_000);
    assert_way(&rig, 0, 39_000, "over the seam");
}

/// A drive that moves to 30000 at most is sent to 34000, not over zero, with another move behind that one. No inputs come
/// while the axis is on this part of its way.
fn end_of_a_clamped_move(blind: core::ops::Range<i64>) -> Result<Completion, Failure> {
    let clamping = Behaviour {
        limit_violation: LimitViolation::Clamp,
        ..Behaviour::generic()
    };
    let mut rig = table_of(clamping, 0, |config| {
        config.limits = Limits::trust_drive();
        config.loss.stale_cycles = 40;
        config.loss.undelivered_cycles = 50;
    });
    for (subindex, limit) in [(1, 0), (2, 30_000)] {
        rig.drive.set(0x607D, subindex, limit).unwrap();
    }
    let before = rig.abs(2_500, SetPoint::new());
    reaches(&mut rig, before, 2_500);
    let quick = SetPoint::new()
        .velocity(500_000)
        .acceleration(20_000_000)
        .deceleration(20_000_000);
    let clamped = rig.abs(34_000, quick);
    rig.wait_accepted(clamped);
    let next = rig.abs(28_000, quick.buffer_mode(BufferMode::Buffered));
    for _ in 0..2_000 {
        // Its bit 11 says nothing of the limit.
        rig.forged = Some(rig.drive.statusword() & !0x0800);
        let is_blind = blind.contains(&rig.drive.position());
        rig.cycle_over(if is_blind {
            Link::ReplyLost
        } else {
            Link::Good
        });
    }
    reaches(&mut rig, next, 28_000);
    rig.finish(clamped)
}

/// The shorter way to the end is the other way first, and changes over on the far side of the circle.
#[test]
fn the_far_side_of_the_circle_is_not_the_end_seen_or_not() {
    for blind in [0..0, 3_000..18_000, 10_000..26_000] {
        let end = end_of_a_clamped_move(blind);
        assert!(
            matches!(
                end,
                Err(Failure::MissedTarget { .. }
                    | Failure::Unknown {
                        doubt: Doubt::Unseen,
                        ..
                    })
            ),
            "{end:?}"
        );
    }
}

#[test]
fn an_axis_at_the_seam_stands_though_its_position_jumps() {
    let mut rig = table(SHORTEST, |config| {
        config.tolerances.position = 10;
    });
    for n in 0..300 {
        rig.drive.place(if n % 2 == 0 { 0 } else { 35_999 });
        rig.cycle();
    }
    let halt = rig.send(servocrab::axis::Command::Stop);
    assert!(
        matches!(rig.outcome(halt), Some(Ok(Completion::Stopped { .. }))),
        "it has nothing to stop"
    );
}

/// A turn has 36 000 counts: the axis goes all the way round to where it stands.
#[test]
fn a_whole_turn_is_not_over_before_it_has_begun() {
    // Bit 10 of the move before stays for a while.
    for stale in [0, 2, 50, 300] {
        let mut rig = table(POSITIVE, |_| {});
        let first = rig.abs(1_000, SetPoint::new());
        goes_round(&mut rig, first, stale);
    }
}

/// A whole turn after this move, with its bit 10 still there for so many cycles.
fn goes_round(rig: &mut Rig, first: servocrab::axis::CommandId, stale: u32) {
    reached(rig, first);
    rig.run(200);
    rig.drive.disturbances().stale_reached_cycles = stale;
    rig.drive.disturbances().ack_delay_cycles = 3;
    let before = rig.drive.position();
    let turn = rig.rel(36_000, SetPoint::new());
    reached(rig, turn);
    assert_way(rig, before, 36_000, &format!("stale for {stale}"));
}
