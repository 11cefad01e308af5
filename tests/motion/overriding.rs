//! The override: how much faster or slower than asked for moves are. No set-point is sent again for it.

use crate::common::Rig;
use servocrab::profile_position::{MinVelocity, VelocityOverride};
use servocrab::{
    BufferMode, Failure, SetPoint,
    axis::{Command, Completion},
};
use servocrab_sim::ds402::Behaviour;

const FAR: i32 = 100_000;

fn percent(of: f64) -> Command {
    Command::SetOverride(VelocityOverride::new(of / 100.0).expect("5 to 200"))
}

/// An enabled axis whose drive takes a velocity at once, or with the set-point.
fn rig(at_once: bool) -> Rig {
    let behaviour = Behaviour {
        velocity_at_once: at_once,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |config| {
        config.traits.takes_velocity_at_once = at_once;
        config.limits.max_velocity = Some(60_000);
    });
    rig.enable();
    rig
}

/// In hundreds of counts a second: the shaft swings a little.
fn speed(rig: &Rig) -> i64 {
    (rig.drive.velocity() / 100.0).round() as i64 * 100
}

#[test]
fn a_drive_that_takes_a_velocity_at_once_goes_on_with_it_and_another_with_the_next_move() {
    for at_once in [true, false] {
        let mut rig = rig(at_once);
        let id = rig.abs(FAR, SetPoint::new().velocity(40_000));
        rig.wait_accepted(id);
        rig.run(300);
        assert_eq!(speed(&rig), 40_000);
        let from = rig.words.len();
        let set = rig.send(percent(25.0));
        assert_eq!(rig.finish(set), Ok(Completion::Done));
        rig.run(200);
        let running = if at_once { 10_000 } else { 40_000 };
        assert_eq!(speed(&rig), running, "at once: {at_once}");
        assert_eq!(rig.distinct_words(from), [0x000F], "no set-point is sent");
        let next = rig.abs(-FAR, SetPoint::new().velocity(40_000));
        rig.wait_accepted(next);
        rig.run(600);
        assert_eq!(speed(&rig), -10_000, "at once: {at_once}");
        let set = rig.send(percent(100.0));
        assert_eq!(rig.finish(set), Ok(Completion::Done));
        rig.assert_reached(next, -FAR);
        assert_eq!(rig.ledger().len(), 2);
    }
}

#[test]
fn a_move_that_waits_its_turn_has_the_override_of_when_it_is_sent() {
    let mut rig = rig(false);
    let first = rig.abs(20_000, SetPoint::new().velocity(40_000));
    rig.wait_accepted(first);
    let buffered = SetPoint::new()
        .velocity(40_000)
        .buffer_mode(BufferMode::Buffered);
    let second = rig.abs(40_000, buffered);
    let third = rig.abs(80_000, buffered);
    rig.wait_accepted(second);
    let set = rig.send(percent(50.0));
    assert_eq!(rig.finish(set), Ok(Completion::Done));
    rig.wait_accepted(third);
    rig.run_until(3_000, |rig| rig.outcome(second).is_some());
    rig.run(300);
    assert_eq!(speed(&rig), 20_000);
    rig.assert_reached(third, 80_000);
}

/// The drive takes target and parameters that belong together.
#[test]
fn under_a_high_bit_4_the_velocity_stays_as_it_was_sent() {
    let mut rig = rig(true);
    let id = rig.abs(FAR, SetPoint::new().velocity(40_000));
    rig.run_until(10, |rig| rig.word() & 0x10 != 0);
    assert!(!rig.accepted(id));
    rig.send(percent(50.0));
    rig.cycle();
    let mut cycles = 0;
    while rig.words.last().is_some_and(|word| word & 0x10 != 0) {
        assert_eq!(rig.drive.get(0x6081, 0), Some(40_000));
        rig.cycle();
        cycles += 1;
    }
    assert!(cycles > 0);
    rig.run(300);
    assert_eq!(speed(&rig), 20_000);
}

#[test]
fn an_override_that_would_be_too_fast_is_refused_and_changes_nothing() {
    let mut rig = rig(true);
    let id = rig.abs(FAR, SetPoint::new().velocity(40_000));
    rig.wait_accepted(id);
    rig.run(300);
    let set = rig.send(percent(200.0));
    assert!(matches!(rig.finish(set), Err(Failure::BeyondLimit { .. })));
    rig.run(100);
    assert_eq!(speed(&rig), 40_000);
    // With it set, a move is refused that would be too fast by it.
    let set = rig.send(percent(125.0));
    assert_eq!(rig.finish(set), Ok(Completion::Done));
    let next = rig.abs(0, SetPoint::new().velocity(50_000));
    assert!(matches!(rig.finish(next), Err(Failure::BeyondLimit { .. })));
    rig.assert_reached(id, FAR);
}

/// The drive's defaults are 50 000 counts/s, and its least velocity is 10 000.
#[test]
fn an_override_that_would_be_too_slow_is_refused_and_changes_nothing() {
    let mut rig = Rig::new(Behaviour::akd2g(), |config| {
        config.traits.limits.min_velocity = MinVelocity::AsProfileVelocity;
        config.limits.min_velocity = Some(10_000);
    });
    rig.enable();
    let too_slow = |asked| {
        let least = 10_000;
        Err(Failure::TooSlow { asked, least })
    };
    let id = rig.abs(FAR, SetPoint::new().velocity(40_000));
    rig.wait_accepted(id);
    let set = rig.send(percent(24.0));
    assert_eq!(rig.finish(set), too_slow(9_600));
    // No other is too slow by it. With it set, moves are, also one that leaves its velocity out.
    rig.assert_reached(id, FAR);
    let set = rig.send(percent(19.0));
    assert_eq!(rig.finish(set), Ok(Completion::Done));
    for (set_point, asked) in [
        (SetPoint::new(), 9_500),
        (SetPoint::new().velocity(52_000), 9_880),
    ] {
        let next = rig.abs(0, set_point);
        assert_eq!(rig.finish(next), too_slow(asked));
    }
    let next = rig.abs(0, SetPoint::new().velocity(53_000));
    rig.assert_reached(next, 0);
    assert_eq!(rig.ledger().len(), 2);
}

/// What is held leads nowhere, at any override.
#[test]
fn an_axis_that_is_held_keeps_its_override() {
    let mut rig = Rig::new(Behaviour::akd2g(), |config| {
        config.traits.acknowledges_while_halted = true;
    });
    rig.enable();
    let set = rig.send(percent(50.0));
    assert_eq!(rig.finish(set), Ok(Completion::Done));
    let id = rig.abs(FAR, SetPoint::new().velocity(40_000));
    rig.wait_accepted(id);
    rig.run(300);
    let hold = rig.send(Command::Hold);
    assert!(rig.finish(hold).is_ok());
    assert_eq!(rig.drive.get(0x6081, 0), Some(20_000));
    let next = rig.abs(0, SetPoint::new().velocity(30_000));
    rig.wait_accepted(next);
    assert_eq!(rig.drive.get(0x6081, 0), Some(15_000));
    rig.assert_reached(next, 0);
}
