//! What takes over from a motion, or changes its mode, while the axis may move unseen.

use super::played::{
    ENABLED, FAULT_REACTION, FIELDS, HALT, Played, QUICK_STOP, QUICK_STOP_ACTIVE, REACHED,
    SWITCH_ON_DISABLED,
};
use crate::{
    axis::{AxisFields, Command, Completion, CoreConfig, Failure},
    ds402::Mode,
    homing::{HomingCommand, HomingMethod},
    profile_velocity::JogSetPoint,
};

const fn home(method: HomingMethod) -> Command {
    Command::Home(HomingCommand {
        method,
        offset: None,
        until: None,
    })
}

/// Held at rest by an input of its drive since it was jogged; then its jog is let go and another begins in the same cycle.
fn taken_over() -> Played {
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    let first = drive.submit(Command::Jog(JogSetPoint::new(700)));
    drive.shows_for(30, REACHED);
    let (core, outputs) = (&mut drive.core, &mut drive.outputs);
    assert!(core.release_jog(drive.now, first, outputs));
    drive.submit(Command::Jog(JogSetPoint::new(-700)));
    drive
}

/// 1. The drive lets it go just then.
#[test]
fn the_rest_before_a_jog_that_was_taken_over_is_not_that_of_its_stop() {
    for command in [
        Command::Halt,
        Command::Stop,
        Command::Release,
        Command::QuickStop,
        Command::Disable,
    ] {
        let mut drive = taken_over();
        let id = drive.submit(command);
        // No shutdown, whose way is 605Bh: bit 8, or bit 2 low.
        assert!(
            matches!(drive.word(), HALT | QUICK_STOP),
            "{command:?}: {:04X}h, {:?}",
            drive.word(),
            drive.outcome(id)
        );
        let shown = |drive: &Played, after: u16| {
            let is_quick = drive.word() & 4 == 0;
            if is_quick { after } else { ENABLED }
        };
        for velocity in [1, 2, 2, 2] {
            drive.velocity = velocity;
            drive.shows(shown(&drive, QUICK_STOP_ACTIVE));
        }
        drive.shows(shown(&drive, SWITCH_ON_DISABLED));
        assert_eq!(drive.outcome(id), None, "{command:?}");
    }
}

/// 1, of those that are not answered at once: each by itself.
#[test]
fn the_rest_before_a_jog_that_was_taken_over_is_not_that_of_its_halt() {
    for command in [Command::Halt, Command::QuickStop] {
        let mut drive = taken_over();
        let id = drive.submit(command);
        drive.velocity = 2;
        for _ in 0..4 {
            let is_quick = drive.word() & 4 == 0;
            drive.shows(if is_quick { QUICK_STOP_ACTIVE } else { ENABLED });
        }
        if command == Command::QuickStop {
            drive.shows(SWITCH_ON_DISABLED);
        }
        assert_eq!(drive.outcome(id), None, "{command:?}");
    }
}

/// 2. A drive that keeps bit 13 of an earlier homing until the next has ended.
#[test]
fn a_homing_error_that_was_there_before_is_no_rest_of_an_axis_that_moves() {
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    drive.shows_for(20, 0x2637);
    let homing = drive.submit(home(HomingMethod::NEGATIVE_LIMIT));
    drive.shows_for(3, 0x2637);
    assert_eq!(drive.word(), 0x001F);
    // Bits 1 0 0: error, still moving.
    drive.velocity = -300;
    drive.shows_for(200, 0x2237);
    let end = drive.outcome(homing);
    assert_ne!(end, Some(Err(Failure::HomingError { moving: false })));
    assert!(drive.core.snapshot().has_set_point, "{end:?}");
    // It is stopped when it has not come to rest in its time.
    drive.shows_for(400, 0x2237);
    let moving = Failure::HomingError { moving: true };
    assert_eq!(drive.outcome(homing), Some(Err(moving)));
    assert_eq!(drive.word() & 0x0004, 0, "bit 2 is low");
}

/// 3. The application of the drive has died: its inputs stay as they were.
#[test]
fn a_jogged_axis_that_freezes_with_its_halt_is_not_taken_for_one_at_rest() {
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    drive.submit(Command::Jog(JogSetPoint::new(700)));
    drive.velocity = 20;
    drive.shows_for(30, ENABLED);
    let halting = drive.submit(Command::Halt);
    drive.velocity = 0;
    let (cycles, result) = drive.cycles_to_end(halting, ENABLED);
    assert!(result.is_err(), "{cycles}: {result:?}");
    assert_eq!(cycles, 400);
}

/// 4. By its own quick stop, in its fault reaction, or found enabled.
#[test]
fn a_mode_is_not_written_while_the_drive_stops_an_axis_by_itself() {
    for statusword in [QUICK_STOP_ACTIVE, FAULT_REACTION] {
        let (mut drive, _) = Played::moving(Played::staying(), 100_000);
        drive.shows_for(3, statusword);
        assert_eq!((drive.word(), drive.outputs[6]), (QUICK_STOP, 1));
        drive.submit(Command::SelectMode(Mode::Homing));
        assert_eq!(drive.outputs[6], 1, "{statusword:04X}h");
        drive.shows_for(3, statusword);
        assert_eq!(drive.outputs[6], 1, "{statusword:04X}h");
    }
}

#[test]
fn a_mode_is_not_written_while_an_axis_that_was_found_enabled_moves() {
    let mut drive = Played::new(Played::staying());
    drive.velocity = 30;
    drive.shows_for(10, ENABLED);
    assert_eq!((drive.word(), drive.outputs[6]), (QUICK_STOP, 1));
    drive.submit(Command::SelectMode(Mode::Homing));
    drive.shows(ENABLED);
    assert_eq!(drive.outputs[6], 1);
}

/// 5.
#[test]
fn a_drive_that_leaves_the_mode_at_its_end_velocity_is_stopped() {
    let mut drive = Played::at_end_velocity();
    assert!(drive.core.snapshot().has_set_point);
    drive.mode = 3;
    drive.shows(ENABLED);
    assert_eq!(drive.word(), QUICK_STOP);
}

/// 6. The change waits for standstill, and a halt comes before that.
#[test]
fn a_mode_is_not_written_on_a_halted_axis() {
    let mut drive = Played::enabled(Played::config());
    drive.position += 100;
    drive.shows(ENABLED);
    let selecting = drive.submit(Command::SelectMode(Mode::Homing));
    assert_eq!((drive.outcome(selecting), drive.outputs[6]), (None, 1));
    drive.submit(Command::Halt);
    drive.shows_for(40, ENABLED);
    assert_eq!((drive.word(), drive.outputs[6]), (HALT, 1));
}

/// 7. Both 6060h and 6061h go by SDO; what is shown when the mode has just been read is a word of the mode before.
#[test]
fn a_homing_waits_for_a_low_of_its_own_mode_where_that_is_noted() {
    let mut drive = Played::enabled(CoreConfig {
        fields: AxisFields {
            mode_display: None,
            mode: None,
            ..FIELDS
        },
        ..Played::config()
    });
    let to = |drive: &mut Played, mode: Mode, statusword: u16| {
        drive.submit(Command::PrepareMode(mode));
        drive.shows_for(5, statusword);
        drive.core.note_mode(mode);
        let id = drive.submit(Command::SelectMode(mode));
        drive.shows(statusword);
        assert_eq!(drive.outcome(id), Some(Ok(Completion::Done)));
    };
    to(&mut drive, Mode::Homing, REACHED);
    drive.shows_for(10, REACHED);
    to(&mut drive, Mode::ProfilePosition, REACHED);
    drive.shows_for(10, REACHED);
    to(&mut drive, Mode::Homing, REACHED);
    let homing = drive.submit(home(HomingMethod::CURRENT_POSITION));
    drive.position += 5_000;
    drive.shows(REACHED);
    assert_eq!(drive.word(), 0x000F);
    // From now on bits 12 and 10 of an earlier homing. The drive does nothing.
    drive.shows_for(40, 0x1637);
    let end = drive.outcome(homing);
    assert!(!matches!(end, Some(Ok(_))), "{end:?}");
}
