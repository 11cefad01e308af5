//! Modes against a drive that is played word by word: what a simulated one never does.

use super::played::{FIELDS, Played};
use crate::{
    axis::{Command, Completion, CoreConfig, Delivery, Failure},
    ds402::Mode,
    homing::{HomingCommand, HomingMethod},
    profile_velocity::JogSetPoint,
};

/// In Operation enabled, in this mode, with the deadlines of every axis.
fn enabled(mode: Mode) -> Played {
    let mut config = CoreConfig::new(FIELDS);
    config.traits.threshold_in_velocity_units = true;
    Played::enabled_in(mode, config)
}

fn by_switch() -> Command {
    Command::Home(HomingCommand {
        method: HomingMethod::NEGATIVE_LIMIT,
        offset: None,
        until: None,
    })
}

#[test]
fn a_homing_error_that_does_not_come_to_rest_is_ended_by_a_quick_stop() {
    let mut drive = enabled(Mode::Homing);
    let homing = drive.submit(by_switch());
    drive.shows_for(4, 0x0637);
    assert_eq!(drive.word(), 0x001F);
    drive.velocity = -300;
    drive.shows_for(20, 0x0237);
    // An error, and it goes on moving, for longer than a standstill may take.
    drive.shows_for(9_990, 0x2237);
    assert_eq!((drive.outcome(homing), drive.word()), (None, 0x001F));
    drive.shows_for(20, 0x2237);
    let moving = Failure::HomingError { moving: true };
    assert_eq!(drive.outcome(homing), Some(Err(moving)));
    assert_eq!(drive.word() & 0x0004, 0, "bit 2 is low");
    drive.velocity = 0;
    drive.shows_for(20, 0x0250);
    assert_eq!(drive.word() & 0x0010, 0);
    assert!(!drive.core.snapshot().has_set_point);
}

#[test]
fn a_drive_that_leaves_the_mode_by_itself_is_stopped_with_nothing_left_in_the_outputs() {
    let wrong = |expected| Failure::WrongMode {
        delivery: Delivery::Accepted,
        expected,
        shown: Mode::ProfilePosition,
    };
    let mut drive = enabled(Mode::Homing);
    let homing = drive.submit(by_switch());
    drive.shows_for(4, 0x0637);
    drive.shows_for(20, 0x0237);
    drive.mode = 1;
    drive.shows(0x0237);
    assert_eq!(drive.outcome(homing), Some(Err(wrong(Mode::Homing))));
    assert_eq!(drive.word() & 0x0004, 0, "bit 2 is low");

    let mut drive = enabled(Mode::ProfileVelocity);
    let jog = drive.submit(Command::Jog(JogSetPoint::new(-700)));
    assert_eq!(drive.target_velocity(), -700);
    drive.shows_for(5, 0x0237);
    drive.mode = 1;
    drive.shows(0x0237);
    assert_eq!(drive.outcome(jog), Some(Err(wrong(Mode::ProfileVelocity))));
    assert_eq!(drive.target_velocity(), 0);
    assert_eq!(drive.word() & 0x0004, 0, "bit 2 is low");
}

#[test]
fn a_jog_that_was_let_go_is_at_rest_only_after_the_drive_has_had_the_zero() {
    let mut drive = enabled(Mode::ProfileVelocity);
    let jog = drive.submit(Command::Jog(JogSetPoint::new(700)));
    drive.shows(0x0237);
    let (core, outputs) = (&mut drive.core, &mut drive.outputs);
    assert!(core.release_jog(drive.now, jog, outputs));
    assert_eq!(drive.target_velocity(), 0);
    // What it shows is the rest from which it is only just starting.
    drive.shows(0x0237);
    drive.shows(0x0237);
    assert_eq!(drive.outcome(jog), None);
    drive.velocity = 40;
    drive.shows_for(50, 0x0237);
    assert_eq!(drive.outcome(jog), None);
    drive.velocity = 0;
    drive.shows_for(14, 0x0637);
    assert!(matches!(
        drive.outcome(jog),
        Some(Ok(Completion::Stopped { .. }))
    ));
}
