//! What counts as a standstill when a stop begins, and what is taken for none.

use super::played::{
    ACKNOWLEDGED, Brings, ENABLED, FIELDS, Played, QUICK_STOP_ACTIVE, REACHED, READY,
    SWITCH_ON_DISABLED, absolute,
};
use crate::{
    axis::{AxisFields, Command, CommandId, Completion, CoreConfig, Failure, StopRequest},
    ds402::{Mode, QuickStopOption, State, StopOptions},
    homing::{HomingCommand, HomingMethod},
    profile_position::SetPoint,
    profile_velocity::JogSetPoint,
};

const HALT: u16 = 0x010F;
const GO: u16 = 0x000F;
const QUICK_STOP: u16 = 0x000B;

fn stopped(state: State) -> Option<Result<Completion, Failure>> {
    Some(Ok(Completion::Stopped { state }))
}

/// Without a set-point, in Operation enabled, and just come to this position.
fn shifted(by: i32) -> Played {
    let mut drive = Played::enabled(Played::config());
    drive.position += by;
    drive.shows(REACHED);
    drive
}

/// Halted at rest, with a set-point.
fn halted(config: CoreConfig) -> Played {
    let (mut drive, _) = Played::moving(config, 100_000);
    let halting = drive.submit(Command::Halt);
    // It gets slower: an axis that freezes at once may be at work unseen.
    for velocity in [20, 10, 0] {
        drive.velocity = velocity;
        drive.shows(ENABLED);
    }
    assert!(drive.cycles_to_end(halting, ENABLED).1.is_ok());
    drive.shows_for(20, ENABLED);
    drive
}

fn staying() -> CoreConfig {
    CoreConfig {
        quick_stop: QuickStopOption(6),
        ..Played::config()
    }
}

/// Whether a quick stop follows the bit 8 of this command, and what the word is when the axis has stood for a while.
fn ends(drive: &mut Played, command: Command) -> (CommandId, u16) {
    let id = drive.submit(command);
    assert_eq!(drive.word(), HALT, "{command:?}");
    assert_eq!(drive.outcome(id), None, "{command:?}");
    drive.shows_for(30, REACHED);
    (id, drive.word())
}

#[test]
fn an_axis_that_settles_where_it_is_keeps_its_power_at_a_stop() {
    for command in [Command::Stop, Command::Release] {
        let mut drive = shifted(15);
        let (id, word) = ends(&mut drive, command);
        assert_eq!(word, GO, "bit 8 falls again");
        assert_eq!(drive.outcome(id), stopped(State::OperationEnabled));
    }
    // Bit 8 stays where somebody asks for a halt meanwhile.
    let mut drive = shifted(15);
    drive.submit(Command::Stop);
    drive.submit(Command::Halt);
    drive.shows_for(30, REACHED);
    assert_eq!(drive.word(), HALT);

    // One that is to be disabled, or was halted before, gets the quick stop; so does one that a set-point may set off.
    let (id, word) = ends(&mut shifted(15), Command::Disable);
    assert_eq!((id, word), (CommandId(2), QUICK_STOP | 0x100));
    let mut drive = Played::enabled(Played::config());
    drive.submit(Command::Halt);
    drive.shows_for(30, REACHED);
    drive.position += 15;
    drive.shows(REACHED);
    assert_eq!(ends(&mut drive, Command::Stop).1, QUICK_STOP | 0x100);
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    drive.velocity = 0;
    assert_eq!(ends(&mut drive, Command::Stop).1, QUICK_STOP | 0x100);
}

#[test]
fn one_that_leaves_its_place_by_more_than_four_windows_gets_the_quick_stop() {
    for (further, word) in [(40, GO), (41, QUICK_STOP | 0x100)] {
        for sign in [1, -1] {
            let mut drive = shifted(15);
            drive.submit(Command::Stop);
            drive.shows(REACHED);
            drive.position += sign * further;
            drive.shows(REACHED);
            // Also if it comes back.
            drive.position -= sign * 30;
            drive.shows_for(30, REACHED);
            assert_eq!(drive.word(), word, "{further}");
        }
    }
    // A disable that is asked for later does not leave it its power.
    let mut drive = shifted(15);
    drive.submit(Command::Stop);
    drive.submit(Command::Disable);
    drive.shows_for(30, REACHED);
    assert_eq!(drive.word(), QUICK_STOP | 0x100);
}

#[test]
fn a_stop_that_does_not_bring_it_to_rest_goes_on_to_a_quick_stop_at_the_deadline() {
    let (mut drive, _) = Played::moving(Played::config(), 1_000_000);
    drive.submit(Command::Stop);
    for cycle in 0..399 {
        // It gets slower all the time.
        drive.velocity = 500 - cycle;
        drive.shows(ENABLED);
    }
    assert_eq!(drive.word(), HALT);
    drive.shows(ENABLED);
    assert_eq!(drive.word(), QUICK_STOP | 0x100);
}

#[test]
fn where_bit_8_would_let_it_coast_every_stop_is_a_quick_stop_at_once() {
    let coasting = || CoreConfig {
        stop_options: StopOptions {
            halt: Some(0),
            ..StopOptions::default()
        },
        ..Played::config()
    };
    for stop in [StopRequest::HALT, StopRequest::STOP] {
        let (mut drive, _) = Played::moving(coasting(), 100_000);
        drive.stop_lane(stop);
        assert_eq!(drive.word(), QUICK_STOP, "{stop:?}");
    }
    let (mut drive, moving) = Played::moving(coasting(), 100_000);
    let refused = Some(Err(Failure::HaltCoasts));
    assert_eq!(drive.answer(Command::Halt), refused);
    assert_eq!((drive.word(), drive.outcome(moving)), (GO, None));
    // During the quick stop it waits for that, and without power there is nothing that bit 8 could do.
    drive.submit(Command::QuickStop);
    assert_eq!(drive.answer(Command::Halt), None);
    let mut drive = Played::disabled(coasting());
    let state = State::SwitchOnDisabled;
    assert_eq!(drive.answer(Command::Halt), stopped(state));
}

#[test]
fn a_quick_stop_of_a_halted_axis_is_done_when_the_drive_has_surely_followed_it() {
    // Sent in the first cycle, seen two later: the rest from bit 8 counts.
    let mut drive = halted(Played::config());
    let id = drive.submit(Command::QuickStop);
    assert_eq!(drive.cycles_to_end(id, SWITCH_ON_DISABLED).0, 3);
    let mut drive = halted(staying());
    let id = drive.submit(Command::QuickStop);
    assert_eq!(drive.cycles_to_end(id, QUICK_STOP_ACTIVE).0, 3);
    // Where nobody knows what arrives, after the settle time.
    let mut drive = halted(Played::config());
    drive.core.config.loss.undelivered_cycles = 1_000;
    let id = drive.submit(Command::QuickStop);
    drive.cycles(100, Brings::Answered, SWITCH_ON_DISABLED);
    assert_eq!(drive.outcome(id), None);
    drive.cycle(Brings::Answered, SWITCH_ON_DISABLED);
    assert_eq!(drive.outcome(id), stopped(State::SwitchOnDisabled));
    // By a single word it is not.
    let mut drive = halted(Played::config());
    let id = drive.submit(Command::QuickStop);
    drive.cycles(10, Brings::Answered, ENABLED);
    drive.cycle(Brings::Answered, SWITCH_ON_DISABLED);
    drive.cycles(10, Brings::Answered, ENABLED);
    assert_eq!(drive.outcome(id), None);
}

#[test]
fn what_a_drive_does_by_itself_begins_a_standstill_anew() {
    // It goes down by a state to which no quick stop leads.
    let mut drive = halted(Played::config());
    let id = drive.submit(Command::QuickStop);
    drive.shows(READY);
    assert_eq!(drive.cycles_to_end(id, SWITCH_ON_DISABLED).0, 13);
    // It begins a quick stop of its own, or of somebody else.
    for (statusword, state) in [
        (QUICK_STOP_ACTIVE, State::QuickStopActive),
        (SWITCH_ON_DISABLED, State::SwitchOnDisabled),
    ] {
        let mut drive = halted(staying());
        drive.shows(statusword);
        let id = drive.submit(Command::Stop);
        assert_eq!(drive.outcome(id), None, "{state:?}");
        let (cycles, result) = drive.cycles_to_end(id, statusword);
        assert_eq!((cycles, Some(result)), (13, stopped(state)));
        // An axis without a set-point has nothing to come to rest from.
        let mut drive = Played::enabled(staying());
        drive.shows(statusword);
        drive.shows(statusword);
        assert_eq!(drive.answer(Command::Stop), stopped(state));
    }
}

#[test]
fn an_axis_that_is_found_enabled_is_stopped_by_whoever_asks() {
    // It stands: there is something to switch off all the same.
    let mut drive = Played::new(Played::config());
    drive.shows_for(30, REACHED);
    assert_eq!(drive.word(), 0);
    let id = drive.submit(Command::QuickStop);
    assert_eq!((drive.outcome(id), drive.word()), (None, QUICK_STOP));
    drive.shows_for(3, SWITCH_ON_DISABLED);
    assert_eq!(drive.outcome(id), stopped(State::SwitchOnDisabled));

    // It moves, and its drive ignores quick stop: that shows after two spans of 100 ms.
    for stop in [
        StopRequest::HALT,
        StopRequest::STOP,
        StopRequest::QUICK_STOP,
    ] {
        let mut drive = Played::new(Played::config());
        drive.velocity = 50;
        drive.shows_for(5, ENABLED);
        assert_eq!(drive.word(), QUICK_STOP);
        drive.stop_lane(stop);
        assert_eq!(drive.cycles_until(0, ENABLED), 203, "{stop:?}");
    }
}

#[test]
fn the_rest_before_a_motion_is_not_the_rest_after_it() {
    // A jog whose velocity was sent once, and a stop: the axis may be setting off all the same.
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    drive.submit(Command::Jog(JogSetPoint::new(700)));
    drive.shows(REACHED);
    drive.submit(Command::Stop);
    assert_eq!(drive.cycles_until(QUICK_STOP | 0x100, REACHED), 13);

    // A homing that reports an error as it sets off.
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    let homing = drive.submit(Command::Home(HomingCommand {
        method: HomingMethod::NEGATIVE_LIMIT,
        offset: None,
        until: None,
    }));
    drive.cycles_until(0x001F, REACHED);
    drive.shows(REACHED);
    let (cycles, result) = drive.cycles_to_end(homing, 0x2237);
    let failure = Failure::HomingError { moving: false };
    assert_eq!((cycles, result), (13, Err(failure)));
}

#[test]
fn an_axis_that_is_found_moving_is_held_for_its_time_and_then_loses_its_power() {
    let mut drive = Played::new(Played::config());
    drive.velocity = 50;
    drive.shows(ENABLED);
    assert_eq!(drive.word(), QUICK_STOP);
    assert_eq!(drive.cycles_until(0, ENABLED), 400);
}

#[test]
fn an_end_velocity_is_a_motion_until_the_axis_stands() {
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
    // It goes on by that velocity.
    drive.velocity = 20;
    drive.shows_for(30, REACHED);
    assert!(drive.core.snapshot().has_set_point);
    drive.velocity = 0;
    drive.shows_for(30, REACHED);
    assert!(!drive.core.snapshot().has_set_point);
}
