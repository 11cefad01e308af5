//! What overtakes a command that waits: a wrong word, a motion that begins, another command.

use super::played::{
    ACKNOWLEDGED, Brings, ENABLED, FAULT, FAULT_REACTION, FIELDS, Played, QUICK_STOP_ACTIVE,
    REACHED, READY, SWITCH_ON_DISABLED, SWITCHED_ON, absolute,
};
use crate::{
    axis::{AxisFields, Command, Completion, CoreConfig, Failure},
    ds402::{Mode, QuickStopOption, State},
    profile_position::SetPoint,
    profile_velocity::JogSetPoint,
};

const HALT: u16 = 0x010F;
const GO: u16 = 0x000F;
const QUICK_STOP: u16 = 0x000B;

fn stopped(state: State) -> Option<Result<Completion, Failure>> {
    Some(Ok(Completion::Stopped { state }))
}

fn staying() -> CoreConfig {
    CoreConfig {
        quick_stop: QuickStopOption(6),
        ..Played::config()
    }
}

/// It waits in a fault or in a state without power, and the drive then shows Operation enabled: the quick stop that follows ends without power.
#[test]
fn a_disable_that_waits_for_standstill_does_not_end_in_quick_stop_active() {
    for first in [FAULT_REACTION, FAULT, SWITCH_ON_DISABLED, READY] {
        let (mut drive, _) = Played::moving(staying(), 100_000);
        drive.shows_for(3, first);
        let disabling = drive.submit(Command::Disable);
        assert_eq!(drive.outcome(disabling), None, "{first:04X}");
        drive.shows(ENABLED);
        assert_eq!(drive.word(), QUICK_STOP, "{first:04X}");
        drive.shows_for(3, QUICK_STOP_ACTIVE);
        drive.velocity = 0;
        drive.shows_for(60, QUICK_STOP_ACTIVE);
        assert_eq!(
            (drive.outcome(disabling), drive.word()),
            (None, 0),
            "{first:04X}"
        );
        drive.shows(SWITCH_ON_DISABLED);
        let end = stopped(State::SwitchOnDisabled);
        assert_eq!(drive.outcome(disabling), end, "{first:04X}");
    }
}

/// The same where the drive then shows Switched on.
#[test]
fn a_disable_that_waits_for_standstill_is_not_done_in_switched_on() {
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    drive.shows_for(3, READY);
    let disabling = drive.submit(Command::Disable);
    drive.velocity = 0;
    drive.shows_for(60, SWITCHED_ON);
    assert_eq!((drive.outcome(disabling), drive.word()), (None, 0));
    drive.shows(SWITCH_ON_DISABLED);
    let end = stopped(State::SwitchOnDisabled);
    assert_eq!(drive.outcome(disabling), end);
}

/// One statusword that says Operation enabled while a fault is being reset.
#[test]
fn a_wrong_word_in_a_reset_costs_neither_the_stop_nor_the_reset() {
    let mut drive = Played::enabled(Played::config());
    drive.velocity = 30;
    drive.shows_for(20, FAULT);
    let resetting = drive.submit(Command::ResetFault);
    let stopping = drive.submit(Command::Stop);
    drive.shows_for(5, FAULT);
    assert_eq!(drive.outcome(stopping), None);
    drive.shows(ENABLED);
    drive.shows_for(5, FAULT);
    drive.velocity = 0;
    drive.shows_for(60, FAULT);
    drive.cycles_until(0x80, FAULT);
    let code = None;
    assert_eq!(drive.outcome(stopping), Some(Err(Failure::Fault { code })));
    drive.shows_for(5, SWITCH_ON_DISABLED);
    assert_eq!(drive.outcome(resetting), stopped(State::SwitchOnDisabled));
}

/// The same where the stop is asked for in that cycle.
#[test]
fn a_quick_stop_between_two_faults_of_a_reset_ends_at_standstill() {
    let mut drive = Played::enabled(Played::config());
    drive.shows_for(20, FAULT);
    let resetting = drive.submit(Command::ResetFault);
    assert_eq!(drive.cycles_until(0x80, FAULT), 3);
    drive.shows(ENABLED);
    let stopping = drive.submit(Command::QuickStop);
    assert_eq!(drive.outcome(stopping), None);
    drive.shows_for(200, FAULT);
    let code = None;
    assert_eq!(drive.outcome(stopping), Some(Err(Failure::Fault { code })));
    assert_eq!(drive.outcome(resetting), None);
}

/// The drive has held the axis at rest since the jog was sent, and it sets off as it is halted.
#[test]
fn the_rest_before_a_jogged_axis_sets_off_is_not_that_of_its_halt() {
    for command in [
        Command::Halt,
        Command::Stop,
        Command::QuickStop,
        Command::Disable,
    ] {
        let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
        drive.submit(Command::Jog(JogSetPoint::new(700)));
        drive.shows_for(30, REACHED);
        let id = drive.submit(command);
        for velocity in [1, 2, 2, 2] {
            drive.velocity = velocity;
            let quick = drive.word() & 4 == 0;
            drive.shows(if quick { QUICK_STOP_ACTIVE } else { ENABLED });
        }
        drive.shows(if drive.word() & 4 == 0 {
            SWITCH_ON_DISABLED
        } else {
            ENABLED
        });
        assert_eq!(drive.outcome(id), None, "{command:?}");
    }
}

/// The same of a move.
#[test]
fn the_rest_before_a_move_sets_off_is_not_that_of_its_halt() {
    for command in [
        Command::Halt,
        Command::Stop,
        Command::QuickStop,
        Command::Disable,
    ] {
        let mut drive = Played::enabled(Played::config());
        drive.move_to(100_000);
        drive.shows(REACHED);
        drive.shows(ACKNOWLEDGED);
        drive.shows_for(30, ENABLED);
        let id = drive.submit(command);
        for velocity in [1, 2, 2, 2] {
            drive.velocity = velocity;
            let quick = drive.word() & 4 == 0;
            drive.shows(if quick { QUICK_STOP_ACTIVE } else { ENABLED });
        }
        drive.shows(if drive.word() & 4 == 0 {
            SWITCH_ON_DISABLED
        } else {
            ENABLED
        });
        assert_eq!(drive.outcome(id), None, "{command:?}");
    }
}

/// An earlier halt that was resumed is no proof that the axis stands.
#[test]
fn the_rest_after_a_resume_is_not_that_of_a_later_quick_stop() {
    for resumed in [false, true] {
        let (mut drive, _) = Played::moving(staying(), 100_000);
        if resumed {
            let halting = drive.submit(Command::Halt);
            for velocity in [20, 10, 0] {
                drive.velocity = velocity;
                drive.shows(ENABLED);
            }
            assert!(drive.cycles_to_end(halting, ENABLED).1.is_ok());
            let resuming = drive.submit(Command::Resume);
            drive.shows(ENABLED);
            assert_eq!(drive.outcome(resuming), Some(Ok(Completion::Done)));
        }
        // An input of the drive holds it, until just now.
        drive.velocity = 0;
        drive.shows_for(150, ENABLED);
        let stopping = drive.submit(Command::QuickStop);
        drive.velocity = 2;
        drive.shows(ENABLED);
        drive.shows_for(3, QUICK_STOP_ACTIVE);
        assert_eq!(drive.outcome(stopping), None, "{resumed}");
    }
}

#[test]
fn a_disable_comes_before_a_resume_that_is_not_sent() {
    let mut drive = Played::enabled(Played::config());
    drive.submit(Command::Halt);
    drive.shows_for(30, REACHED);
    let resuming = drive.submit(Command::Resume);
    drive.submit(Command::Disable);
    drive.shows(REACHED);
    let state = State::OperationEnabled;
    assert_eq!(
        drive.outcome(resuming),
        Some(Err(Failure::Disabled { state }))
    );
}

#[test]
fn bit_8_falls_outside_operation_enabled_where_its_disable_has_failed() {
    for lost in [false, true] {
        let mut drive = Played::enabled(Played::config());
        drive.submit(Command::Halt);
        drive.shows_for(30, REACHED);
        let disabling = drive.submit(Command::Disable);
        if lost {
            drive.cycles(12, Brings::Nothing, REACHED);
        } else {
            drive.shows_for(200, REACHED);
        }
        assert!(matches!(drive.outcome(disabling), Some(Err(_))));
        drive.shows_for(300, SWITCH_ON_DISABLED);
        assert_eq!(drive.word(), 0, "{lost}");
        assert!(!drive.core.snapshot().halted);
        let answer = drive.answer(Command::SelectMode(Mode::ProfileVelocity));
        assert_eq!(answer, None, "{lost}");
    }
}

#[test]
fn nothing_is_left_of_a_motion_whose_drive_has_left_operation_enabled_late() {
    let (mut drive, _) = Played::moving(Played::config(), 1_000_000);
    drive.submit(Command::QuickStop);
    drive.shows_for(451, ENABLED);
    drive.velocity = 0;
    drive.shows_for(300, ENABLED);
    drive.shows_for(300, SWITCH_ON_DISABLED);
    let snapshot = drive.core.snapshot();
    assert!(!snapshot.has_set_point && !snapshot.halted, "{snapshot:?}");
    assert_eq!(
        drive.answer(Command::SelectMode(Mode::ProfileVelocity)),
        None
    );
}

#[test]
fn nothing_is_left_of_a_halted_motion_whose_drive_has_left_operation_enabled_late() {
    let (mut drive, _) = Played::moving(Played::config(), 1_000_000);
    drive.move_to(50_000);
    drive.shows(ENABLED);
    drive.submit(Command::Stop);
    drive.shows_for(1_000, ENABLED);
    drive.velocity = 0;
    drive.shows_for(300, ENABLED);
    drive.shows_for(300, SWITCH_ON_DISABLED);
    let snapshot = drive.core.snapshot();
    assert!(!snapshot.has_set_point && !snapshot.halted, "{snapshot:?}");
    assert_eq!(
        drive.answer(Command::SelectMode(Mode::ProfileVelocity)),
        None
    );
}

/// Halted on its way at an end velocity: it goes on with that when bit 8 falls.
fn halted_at_end_velocity() -> Played {
    let mut drive = Played::enabled(CoreConfig {
        fields: AxisFields {
            target_velocity: None,
            end_velocity: Some(7),
            ..FIELDS
        },
        ..Played::config()
    });
    let mut command = absolute(100);
    command.set_point = SetPoint::new().end_velocity(20);
    let moving = drive.submit(Command::Move(command));
    drive.shows(REACHED);
    drive.shows(ACKNOWLEDGED);
    drive.velocity = 20;
    drive.shows_for(5, ENABLED);
    drive.velocity = 0;
    let (_, result) = drive.cycles_to_end(moving, REACHED);
    assert!(result.is_ok(), "{result:?}");
    drive.velocity = 20;
    drive.shows_for(30, REACHED);
    let halting = drive.submit(Command::Halt);
    for velocity in [20, 10, 0] {
        drive.velocity = velocity;
        drive.shows(ENABLED);
    }
    assert!(drive.cycles_to_end(halting, ENABLED).1.is_ok());
    drive
}

#[test]
fn a_stop_just_after_a_resume_stops_what_goes_on_at_its_end_velocity() {
    let mut drive = halted_at_end_velocity();
    let resuming = drive.submit(Command::Resume);
    drive.shows(ENABLED);
    assert_eq!(drive.outcome(resuming), Some(Ok(Completion::Done)));
    assert_eq!(drive.word(), GO);
    let stopping = drive.submit(Command::Stop);
    // The drive has begun to go on by now.
    drive.velocity = 20;
    drive.shows_for(3, ENABLED);
    assert_eq!(drive.outcome(stopping), None);
    assert_eq!(drive.word(), HALT);
}

#[test]
fn a_stop_before_a_resume_that_is_not_sent_stops_what_goes_on_at_its_end_velocity() {
    let mut drive = halted_at_end_velocity();
    let resuming = drive.submit(Command::Resume);
    let stopping = drive.submit(Command::Stop);
    let stopped = Some(Err(Failure::QUICK_STOPPED));
    assert_eq!(
        (drive.outcome(resuming), drive.outcome(stopping)),
        (stopped, None)
    );
    assert_eq!(drive.word(), HALT);
}
