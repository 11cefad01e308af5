//! Jogs that follow each other, that are let go, and that their drive does not end.

use super::played::{ENABLED, FIELDS, Played, QUICK_STOP, QUICK_STOP_ACTIVE, REACHED};
use crate::{
    Failure,
    axis::{AxisFields, Command, CommandId, CoreConfig},
    ds402::{Mode, State},
    profile_velocity::JogSetPoint,
};

/// An axis that moves by a jog that was let go in this cycle.
fn let_go(config: CoreConfig, set_point: JogSetPoint) -> (Played, CommandId) {
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, config);
    let jog = drive.submit(Command::Jog(set_point));
    drive.velocity = 20;
    drive.shows_for(20, ENABLED);
    assert!(drive.core.release_jog(drive.now, jog, &mut drive.outputs));
    (drive, jog)
}

/// Its drive follows no 0 in 60FFh, and perhaps nobody waits for the rest any more.
#[test]
fn a_jog_that_was_let_go_and_does_not_come_to_rest_is_ended_by_a_quick_stop() {
    let (mut drive, jog) = let_go(Played::config(), JogSetPoint::new(20_000));
    let (_, result) = drive.cycles_to_end(jog, ENABLED);
    assert!(matches!(result, Err(Failure::Timeout { .. })), "{result:?}");
    assert_eq!(drive.word(), QUICK_STOP);
    drive.shows_for(3, QUICK_STOP_ACTIVE);
    drive.velocity = 0;
    drive.shows_for(60, QUICK_STOP_ACTIVE);
    assert_eq!(drive.core.snapshot().state, State::QuickStopActive);
}

/// The jog that was to take over from one that was let go is given up before it is sent.
#[test]
fn a_jog_that_was_let_go_is_watched_on_where_the_next_is_given_up_before_it_is_sent() {
    let (mut drive, first) = let_go(Played::config(), JogSetPoint::new(20_000));
    drive.shows_for(5, ENABLED);
    let second = drive.submit(Command::Jog(JogSetPoint::new(-20_000)));
    assert!(drive.core.withdraw(drive.now, second, &mut drive.outputs));
    drive.drain();
    assert_eq!(drive.target_velocity(), 0);
    // Its drive follows no 0 in 60FFh.
    drive.shows_for(500, ENABLED);
    assert_eq!(drive.word(), QUICK_STOP);
    let end = drive.outcome(first);
    assert!(matches!(end, Some(Err(Failure::Timeout { .. }))), "{end:?}");
}

/// The second is let go before it is sent. A third one takes over in the same cycle.
#[test]
fn each_of_three_jogs_between_two_frames_has_its_end() {
    let (mut drive, first) = let_go(Played::config(), JogSetPoint::new(20_000));
    let second = drive.submit(Command::Jog(JogSetPoint::new(-20_000)));
    assert!(
        drive
            .core
            .release_jog(drive.now, second, &mut drive.outputs)
    );
    let third = drive.submit(Command::Jog(JogSetPoint::new(10_000)));
    drive.shows_for(5, ENABLED);
    assert!(drive.core.release_jog(drive.now, third, &mut drive.outputs));
    for velocity in [10, 5, 0] {
        drive.velocity = velocity;
        drive.shows(ENABLED);
    }
    drive.shows_for(1_000, REACHED);
    let ends = [first, second, third].map(|id| drive.outcome(id));
    assert!(ends.iter().all(Option::is_some), "{ends:?}");
}

/// The next jog has another deceleration 6084h. Its own future or a stop gives it up before it is sent.
#[test]
fn a_jog_that_was_let_go_comes_to_rest_by_its_own_ramp() {
    // 6084h in place of 60FFh, and that in place of 607Ah, which is not looked at here.
    let config = || CoreConfig {
        fields: AxisFields {
            deceleration: Some(7),
            target_velocity: Some(2),
            ..FIELDS
        },
        ..Played::config()
    };
    for by_stop in [false, true] {
        let jog = |velocity, ramp| JogSetPoint::new(velocity).deceleration(ramp);
        let (mut drive, _) = let_go(config(), jog(20_000, 90_000));
        drive.shows_for(2, ENABLED);
        let ramp = |drive: &Played| drive.outputs[7..].try_into().map_or(0, u32::from_le_bytes);
        assert_eq!(ramp(&drive), 90_000);
        let second = drive.submit(Command::Jog(jog(-20_000, 10)));
        if by_stop {
            drive.submit(Command::Stop);
        } else {
            assert!(drive.core.withdraw(drive.now, second, &mut drive.outputs));
            drive.drain();
        }
        assert!(drive.outcome(second).is_some());
        assert_eq!(ramp(&drive), 90_000, "{by_stop}");
        drive.shows_for(2, ENABLED);
        assert_eq!(ramp(&drive), 90_000, "{by_stop}");
    }
}
