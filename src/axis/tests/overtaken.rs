//! What overtakes a command that waits: a wrong word, a motion that begins, another command.

use super::played::{
    ACKNOWLEDGED, Brings, ENABLED, FAULT, FAULT_REACTION, FIELDS, GO, HALT, HOME, Played,
    QUICK_STOP, QUICK_STOP_ACTIVE, REACHED, READY, SWITCH_ON_DISABLED, SWITCHED_ON, absolute, home,
    stopped,
};
use crate::{
    axis::{AxisFields, Command, CommandId, Completion, CoreConfig, Event, Failure, StopRequest},
    ds402::{Mode, State},
    homing::HomingMethod,
    profile_position::{BufferMode, SetPoint},
    profile_velocity::JogSetPoint,
};

/// It waits in a fault or in a state without power, and the drive then shows Operation enabled. The quick stop that follows ends without power.
#[test]
fn a_disable_that_waits_for_standstill_does_not_end_in_quick_stop_active() {
    for first in [FAULT_REACTION, FAULT, SWITCH_ON_DISABLED, READY] {
        let (mut drive, _) = Played::moving(Played::staying(), 100_000);
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
        drive.shows_for(3, SWITCH_ON_DISABLED);
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
    drive.shows_for(3, SWITCH_ON_DISABLED);
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
    drive.cycles_until(0x80, FAULT);
    drive.shows(ENABLED);
    let stopping = drive.submit(Command::QuickStop);
    assert_eq!(drive.outcome(stopping), None);
    drive.shows_for(200, FAULT);
    let code = None;
    assert_eq!(drive.outcome(stopping), Some(Err(Failure::Fault { code })));
    assert_eq!(drive.outcome(resetting), None);
}

/// The drive lets the axis go, and answers what is sent.
fn sets_off(drive: &mut Played) {
    let shown = |drive: &Played, after: u16| {
        let is_quick = drive.word() & 4 == 0;
        if is_quick { after } else { ENABLED }
    };
    for velocity in [1, 2, 2, 2] {
        drive.velocity = velocity;
        drive.shows(shown(drive, QUICK_STOP_ACTIVE));
    }
    drive.shows(shown(drive, SWITCH_ON_DISABLED));
}

/// The drive has held the axis at rest since it was asked to move, and it sets off as it is stopped.
fn sets_off_as_it_is_stopped(asked: impl Fn() -> Played) {
    for command in [
        Command::Halt,
        Command::Stop,
        Command::QuickStop,
        Command::Disable,
    ] {
        let mut drive = asked();
        let id = drive.submit(command);
        sets_off(&mut drive);
        assert_eq!(drive.outcome(id), None, "{command:?}");
    }
}

#[test]
fn the_rest_before_a_jogged_axis_sets_off_is_not_that_of_its_halt() {
    sets_off_as_it_is_stopped(|| {
        let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
        drive.submit(Command::Jog(JogSetPoint::new(700)));
        drive.shows_for(30, REACHED);
        drive
    });
}

/// Its velocity was in the outputs for one cycle, and it sets off as its drive leaves the mode. That ends the jog by a quick stop.
#[test]
fn the_rest_before_an_axis_was_jogged_is_not_that_of_the_quick_stop_that_ends_the_jog() {
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::staying());
    drive.shows_for(200, REACHED);
    let jog = drive.submit(Command::Jog(JogSetPoint::new(700)));
    drive.shows(REACHED);
    drive.core.set_jog(jog, 0, &mut drive.outputs);
    drive.shows(REACHED);
    drive.mode = 1;
    drive.shows(ENABLED);
    assert_eq!(drive.word(), QUICK_STOP);
    let stopping = drive.submit(Command::Stop);
    for velocity in [1, 2, 2, 2, 2] {
        drive.velocity = velocity;
        drive.shows(QUICK_STOP_ACTIVE);
    }
    assert_eq!(drive.outcome(stopping), None);
    drive.velocity = 0;
    let (cycles, result) = drive.cycles_to_end(stopping, QUICK_STOP_ACTIVE);
    assert!(cycles > 5 && result.is_ok(), "{cycles}: {result:?}");
}

#[test]
fn the_rest_before_a_move_sets_off_is_not_that_of_its_halt() {
    sets_off_as_it_is_stopped(|| {
        let mut drive = Played::enabled(Played::config());
        drive.move_to(100_000);
        drive.shows(REACHED);
        drive.shows(ACKNOWLEDGED);
        drive.shows_for(30, ENABLED);
        drive
    });
}

/// An earlier halt that was resumed is no proof that the axis stands.
#[test]
fn the_rest_after_a_resume_is_not_that_of_a_later_quick_stop() {
    for resumed in [false, true] {
        let (mut drive, _) = Played::moving(Played::staying(), 100_000);
        if resumed {
            drive.halt_to_rest();
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

/// It ignores its stop for so long, comes to rest all the same, and leaves Operation enabled at last.
fn nothing_is_left_of(mut drive: Played, ignores_for: u32) {
    drive.shows_for(ignores_for, ENABLED);
    drive.velocity = 0;
    drive.shows_for(300, ENABLED);
    drive.shows_for(300, SWITCH_ON_DISABLED);
    let snapshot = drive.core.snapshot();
    assert!(!snapshot.has_set_point && !snapshot.halted, "{snapshot:?}");
    let selecting = drive.answer(Command::SelectMode(Mode::ProfileVelocity));
    assert_eq!(selecting, None);
}

#[test]
fn nothing_is_left_of_a_motion_whose_drive_has_left_operation_enabled_late() {
    let (mut drive, _) = Played::moving(Played::config(), 1_000_000);
    drive.submit(Command::QuickStop);
    nothing_is_left_of(drive, 451);
}

#[test]
fn nothing_is_left_of_a_halted_motion_whose_drive_has_left_operation_enabled_late() {
    let (mut drive, _) = Played::moving(Played::config(), 1_000_000);
    drive.move_to(50_000);
    drive.shows(ENABLED);
    drive.submit(Command::Stop);
    nothing_is_left_of(drive, 1_000);
}

/// Halted on its way at an end velocity: it goes on with that when bit 8 falls.
fn halted_at_end_velocity() -> Played {
    let mut drive = Played::at_end_velocity();
    drive.halt_to_rest();
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

/// The drive lets it go just then.
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
        sets_off(&mut drive);
        assert_eq!(drive.outcome(id), None, "{command:?}");
    }
}

/// A drive that keeps bit 13 of an earlier homing until the next has ended.
#[test]
fn a_homing_error_that_was_there_before_is_no_rest_of_an_axis_that_moves() {
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    drive.shows_for(20, 0x2637);
    let homing = drive.submit(HOME);
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

/// By its own quick stop, in its fault reaction, or found enabled.
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

#[test]
fn a_drive_that_leaves_the_mode_at_its_end_velocity_is_stopped() {
    let mut drive = Played::at_end_velocity();
    assert!(drive.core.snapshot().has_set_point);
    drive.mode = 3;
    drive.shows(ENABLED);
    assert_eq!(drive.word(), QUICK_STOP);
}

/// The change waits for standstill, and a halt comes before that.
#[test]
fn a_mode_is_not_written_on_a_halted_axis() {
    let mut drive = Played::enabled(Played::config());
    drive.position += 100;
    drive.shows(ENABLED);
    let selecting = drive.submit(Command::SelectMode(Mode::Homing));
    assert_eq!((drive.outcome(selecting), drive.outputs[6]), (None, 1));
    drive.submit(Command::Halt);
    drive.shows(ENABLED);
    assert_eq!(drive.outcome(selecting), Some(Err(Failure::HALTED)));
    drive.shows_for(40, ENABLED);
    assert_eq!((drive.word(), drive.outputs[6]), (HALT, 1));
}

/// Both 6060h and 6061h go by SDO; what is shown when the mode has just been read is a word of the mode before.
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

/// A fault reaction overtakes whoever stops the axis, and the drive leaves it by itself with power. Its 605Ah says that it stays in Quick stop
/// active.
#[test]
fn a_drive_that_leaves_its_fault_reaction_is_switched_off_also_where_somebody_waits_for_a_stop() {
    let ends = |asked: Option<Command>, before: bool| {
        let (mut drive, _) = Played::moving(Played::staying(), 100_000);
        if before && let Some(command) = asked {
            drive.submit(command);
            drive.shows_for(3, ENABLED);
        }
        drive.shows_for(3, FAULT_REACTION);
        if !before && let Some(command) = asked {
            drive.submit(command);
        }
        drive.shows(ENABLED);
        assert_eq!(drive.word() & 0x000F, QUICK_STOP);
        drive.shows_for(3, QUICK_STOP_ACTIVE);
        drive.velocity = 0;
        drive.shows_for(60, QUICK_STOP_ACTIVE);
        drive.word()
    };
    assert_eq!(ends(None, false), 0, "nobody waits");
    assert_eq!(ends(Some(Command::Disable), false), 0);
    assert_eq!(ends(Some(Command::Disable), true), 0, "asked for before");
    for command in [Command::Stop, Command::QuickStop] {
        for before in [false, true] {
            assert_eq!(ends(Some(command), before), 0, "{command:?}, {before}");
        }
    }
}

/// A halt that the drive ignores, or that does not bring the axis to rest, takes no deadline away from a homing.
#[test]
fn a_halted_homing_whose_axis_does_not_come_to_rest_has_an_end() {
    // In progress; an error while it moves; attained and moving.
    for statusword in [0x0237, 0x2237, 0x1237] {
        for swings in [false, true] {
            let mut drive = Played::enabled_in(Mode::Homing, Played::config());
            let homing = drive.submit(HOME);
            drive.cycles_until(0x001F, REACHED);
            drive.velocity = -300;
            drive.shows_for(20, ENABLED);
            let halting = drive.submit(Command::Halt);
            for cycle in 0..5_000 {
                if swings {
                    drive.velocity = if cycle % 40 < 20 { 3 } else { -3 };
                }
                drive.shows(statusword);
            }
            assert!(matches!(drive.outcome(halting), Some(Err(_))));
            let end = drive.outcome(homing);
            assert!(
                matches!(end, Some(Err(_))),
                "{statusword:04X}h, {swings}: {end:?} after 5 s, {:04X}h",
                drive.word()
            );
        }
    }
}

/// The fault comes back with a reaction while bit 7 is high, and the axis moves.
#[test]
fn an_axis_that_moves_in_a_fault_reaction_gets_no_disable_voltage_with_bit_7() {
    let mut drive = Played::enabled(Played::config());
    drive.shows_for(20, FAULT);
    drive.submit(Command::ResetFault);
    drive.cycles_until(0x80, FAULT);
    drive.velocity = 30;
    drive.shows_for(3, FAULT_REACTION);
    assert_eq!(drive.word(), QUICK_STOP);
}

/// A stop that has waited for long gives up; the reset was asked for just now.
#[test]
fn the_deadline_of_a_stop_is_not_that_of_a_later_reset() {
    let mut drive = Played::enabled(Played::config());
    drive.velocity = 30;
    drive.shows_for(20, FAULT);
    let stopping = drive.submit(Command::Stop);
    drive.shows_for(390, FAULT);
    let resetting = drive.submit(Command::ResetFault);
    drive.shows_for(20, FAULT);
    assert!(matches!(drive.outcome(stopping), Some(Err(_))));
    assert_eq!(drive.outcome(resetting), None, "after 20 of 400 ms");
    drive.velocity = 0;
    drive.cycles_until(0x80, FAULT);
}

/// It stood when its disable was asked for, and its fault reaction moves it.
#[test]
fn a_disable_that_a_fault_overtakes_fails_at_standstill() {
    let mut drive = Played::enabled(Played::config());
    let disabling = drive.submit(Command::Disable);
    drive.shows(ENABLED);
    drive.velocity = 30;
    drive.shows(FAULT_REACTION);
    drive.shows_for(20, FAULT_REACTION);
    assert_eq!(drive.outcome(disabling), None, "it moves");
    drive.velocity = 0;
    drive.shows_for(30, FAULT);
    let code = None;
    assert_eq!(drive.outcome(disabling), Some(Err(Failure::Fault { code })));
}

/// The resume that came before the change was taken back by a halt before it was sent: bit 8 has never fallen.
#[test]
fn a_mode_is_not_written_on_an_axis_whose_resume_was_taken_back() {
    let mut drive = Played::enabled(Played::config());
    drive.submit(Command::Halt);
    drive.shows_for(30, REACHED);
    drive.submit(Command::Resume);
    let selecting = drive.submit(Command::SelectMode(Mode::Homing));
    drive.submit(Command::Halt);
    assert_eq!((drive.word(), drive.outputs[6]), (HALT, 1));
    drive.shows(REACHED);
    assert_eq!(drive.outcome(selecting), Some(Err(Failure::HALTED)));
}

/// Its drive follows no 0 in 60FFh, and perhaps nobody waits for the rest any more.
#[test]
fn a_jog_that_was_let_go_and_does_not_come_to_rest_is_ended_by_a_quick_stop() {
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    let jog = drive.submit(Command::Jog(JogSetPoint::new(20_000)));
    drive.velocity = 20;
    drive.shows_for(20, ENABLED);
    assert!(drive.core.release_jog(drive.now, jog, &mut drive.outputs));
    let (_, result) = drive.cycles_to_end(jog, ENABLED);
    assert!(matches!(result, Err(Failure::Timeout { .. })), "{result:?}");
    assert_eq!(drive.word(), QUICK_STOP);
    drive.shows_for(3, QUICK_STOP_ACTIVE);
    drive.velocity = 0;
    drive.shows_for(60, QUICK_STOP_ACTIVE);
    assert_eq!(drive.core.snapshot().state, State::QuickStopActive);
}

fn ask(drive: &mut Played, target: i32, buffer_mode: BufferMode, gated: bool) -> CommandId {
    let mut command = absolute(target);
    command.set_point = SetPoint::new().buffer_mode(buffer_mode);
    command.gated = gated;
    drive.submit(Command::Move(command))
}

/// As `start_together` asks for them, on the same two axes. Of each group one move replaces the others and one queues.
#[test]
fn two_groups_do_not_wait_for_each_other_for_ever() {
    let gated = |drive: &mut Played, target, mode| ask(drive, target, mode, true);
    let mut axes = [0, 1].map(|_| Played::moving(Played::config(), 1_000).0);
    let [x, y] = &mut axes;
    // The buffer of the first axis is full: the first group waits for that.
    let queued = ask(x, 1_500, BufferMode::Buffered, false);
    x.shows(ENABLED);
    x.shows(ACKNOWLEDGED);
    x.shows(ACKNOWLEDGED);
    x.shows_for(5, ENABLED);
    assert!(x.reports.contains(&(queued, Event::Accepted)));
    let first = [
        gated(x, 2_000, BufferMode::Buffered),
        gated(y, 2_000, BufferMode::Aborting),
    ];
    for _ in 0..3 {
        x.shows(ENABLED);
        y.shows(ENABLED);
        assert_eq!(
            [x.core.is_armed(first[0]), y.core.is_armed(first[1])],
            [false, true]
        );
    }
    let second = [
        gated(x, 3_000, BufferMode::Aborting),
        gated(y, 3_000, BufferMode::Buffered),
    ];
    // The first group has failed: `Groups::advance` withdraws its other move, and the second group starts.
    assert_eq!(x.outcome(first[0]), Some(Err(Failure::Superseded)));
    assert!(y.core.withdraw(first[1], &mut y.outputs));
    x.shows_for(5, ENABLED);
    y.velocity = 0;
    y.position = 1_000;
    y.shows_for(5, REACHED);
    assert_eq!(
        [x.core.is_armed(second[0]), y.core.is_armed(second[1])],
        [true, true]
    );
}

/// What starts alone waits for nobody: it goes on waiting behind one that starts together with others.
#[test]
fn a_move_of_no_group_waits_behind_one_of_a_group_that_overtakes_it() {
    let mut drive = Played::moving(Played::config(), 1_000).0;
    ask(&mut drive, 1_500, BufferMode::Buffered, false);
    drive.shows(ENABLED);
    drive.shows_for(2, ACKNOWLEDGED);
    drive.shows_for(5, ENABLED);
    let waits = ask(&mut drive, 2_000, BufferMode::Buffered, false);
    let replaces = [3_000, 4_000].map(|to| ask(&mut drive, to, BufferMode::Aborting, true));
    drive.shows_for(5, ENABLED);
    assert!(drive.core.is_armed(replaces[0]));
    assert!(drive.core.withdraw(replaces[0], &mut drive.outputs));
    drive.shows_for(5, ENABLED);
    assert!(drive.core.is_armed(replaces[1]));
    assert_eq!(drive.outcome(waits), None);
}

/// The jog that was to take over from one that was let go is given up before it is sent.
#[test]
fn a_jog_that_was_let_go_is_watched_on_where_the_next_is_given_up_before_it_is_sent() {
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    let first = drive.submit(Command::Jog(JogSetPoint::new(20_000)));
    drive.velocity = 20;
    drive.shows_for(20, ENABLED);
    assert!(drive.core.release_jog(drive.now, first, &mut drive.outputs));
    drive.shows_for(5, ENABLED);
    let second = drive.submit(Command::Jog(JogSetPoint::new(-20_000)));
    assert!(drive.core.withdraw(second, &mut drive.outputs));
    drive.drain();
    assert_eq!(drive.target_velocity(), 0);
    // Its drive follows no 0 in 60FFh.
    drive.shows_for(500, ENABLED);
    assert_eq!(drive.word(), QUICK_STOP);
    let end = drive.outcome(first);
    assert!(matches!(end, Some(Err(Failure::Timeout { .. }))), "{end:?}");
}

/// As its drive leaves its mode for this one. A stop is not done by the rest from before.
fn sets_off_in(mode: i8, drive: &mut Played) {
    drive.mode = mode;
    drive.velocity = 1;
    drive.shows(ENABLED);
    assert_eq!(drive.word(), QUICK_STOP);
    let stopping = drive.submit(Command::Stop);
    for velocity in [1, 2, 2, 2] {
        drive.velocity = velocity;
        drive.shows(QUICK_STOP_ACTIVE);
    }
    assert_eq!(drive.outcome(stopping), None);
}

/// Held at rest by an input of its drive since it was set going, it sets off as its drive leaves the mode.
#[test]
fn the_rest_before_a_held_jog_sets_off_is_not_that_of_the_quick_stop_for_its_mode() {
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::staying());
    drive.submit(Command::Jog(JogSetPoint::new(700)));
    drive.shows_for(200, REACHED);
    sets_off_in(1, &mut drive);
}

#[test]
fn the_rest_before_a_held_move_sets_off_is_not_that_of_the_quick_stop_for_its_mode() {
    let mut drive = Played::enabled(Played::staying());
    drive.move_to(100_000);
    drive.shows(REACHED);
    drive.shows(ACKNOWLEDGED);
    drive.shows_for(200, ENABLED);
    sets_off_in(3, &mut drive);
}

/// One word that says mode 1, in the frame that brings 6060h.
#[test]
fn one_word_of_another_mode_starts_no_homing_in_place_of_a_move() {
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    drive.shows_for(20, REACHED);
    let selecting = drive.submit(Command::SelectMode(Mode::ProfilePosition));
    drive.mode = 1;
    drive.shows(REACHED);
    drive.mode = 6;
    let moving = drive.move_to(100_000);
    for _ in 0..5 {
        let ends = (drive.outcome(selecting), drive.outcome(moving));
        assert_eq!(drive.word() & 0x0010, 0, "{ends:?}");
        drive.shows(REACHED);
    }
}

/// Its drive has ignored bit 8 for a while, and the axis stands halted since.
#[test]
fn a_halt_that_nobody_waits_for_leaves_an_axis_that_stands_halted_as_it_is() {
    let (mut drive, _) = Played::moving(Played::config(), 100_000);
    let halting = drive.submit(Command::Halt);
    let (_, result) = drive.cycles_to_end(halting, ENABLED);
    assert_eq!(result, Err(Failure::HaltIgnored));
    for velocity in [10, 5, 0] {
        drive.velocity = velocity;
        drive.shows(ENABLED);
    }
    drive.shows_for(1_000, ENABLED);
    assert_eq!(drive.word(), HALT);
    drive.stop_lane(StopRequest::HALT);
    drive.shows_for(5, ENABLED);
    assert_eq!(drive.word(), HALT);
}

/// The second is let go before it is sent. A third one takes over in the same cycle.
#[test]
fn each_of_three_jogs_between_two_frames_has_its_end() {
    let mut drive = Played::enabled_in(Mode::ProfileVelocity, Played::config());
    let first = drive.submit(Command::Jog(JogSetPoint::new(20_000)));
    drive.velocity = 20;
    drive.shows_for(20, ENABLED);
    assert!(drive.core.release_jog(drive.now, first, &mut drive.outputs));
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
        let mut drive = Played::enabled_in(Mode::ProfileVelocity, config());
        let jog = |velocity, ramp| Command::Jog(JogSetPoint::new(velocity).deceleration(ramp));
        let first = drive.submit(jog(20_000, 90_000));
        drive.velocity = 20;
        drive.shows_for(20, ENABLED);
        assert!(drive.core.release_jog(drive.now, first, &mut drive.outputs));
        drive.shows_for(2, ENABLED);
        let ramp = |drive: &Played| drive.outputs[7..].try_into().map_or(0, u32::from_le_bytes);
        assert_eq!(ramp(&drive), 90_000);
        let second = drive.submit(jog(-20_000, 10));
        if by_stop {
            drive.submit(Command::Stop);
        } else {
            assert!(drive.core.withdraw(second, &mut drive.outputs));
            drive.drain();
        }
        assert!(drive.outcome(second).is_some());
        assert_eq!(ramp(&drive), 90_000, "{by_stop}");
        drive.shows_for(2, ENABLED);
        assert_eq!(ramp(&drive), 90_000, "{by_stop}");
    }
}

/// The drive never begins. Bit 12 is that of an earlier homing, and one word is without it. The axis is not at home.
#[test]
fn one_word_without_bit_12_is_no_homing_without_motion_after_a_settle_time_either() {
    const DONE: u16 = 0x1637;
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    drive.position = 5_000;
    drive.shows_for(200, DONE);
    let homing = drive.submit(home(HomingMethod::CURRENT_POSITION));
    assert!(drive.cycles_until(0x001F, DONE) < 10);
    drive.shows_for(2, DONE);
    drive.shows(REACHED);
    for _ in 0..1_000 {
        drive.shows(DONE);
        let outcome = drive.outcome(homing);
        assert!(!matches!(outcome, Some(Ok(_))), "{outcome:?}");
    }
    assert!(!drive.core.snapshot().referenced);
}

/// The drive is under local control and ignores bit 4. Bits 12 and 10 are those of an earlier homing, and one word is without bit 12.
#[test]
fn one_word_without_bit_12_is_no_homing_of_a_method_that_moves() {
    for remote in [0x0000, 0x0200] {
        let mut drive = Played::enabled_in(Mode::Homing, Played::config());
        drive.position = 700;
        drive.shows_for(20, 0x1437 | remote);
        let homing = drive.submit(HOME);
        assert_eq!(drive.outcome(homing), None);
        drive.shows_for(10, 0x1437 | remote);
        assert_eq!(drive.word(), 0x001F);
        drive.shows(0x0437 | remote);
        drive.shows_for(300, 0x1437 | remote);
        let outcome = drive.outcome(homing);
        assert!(
            !matches!(outcome, Some(Ok(_))),
            "{outcome:?}, referenced: {}",
            drive.core.snapshot().referenced
        );
    }
}

/// The drive shows "in progress" at rest, is under local control and ignores bit 4. One word is with bit 12.
#[test]
fn a_homing_that_the_drive_does_not_begin_ends_although_one_word_had_bit_12() {
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    drive.shows_for(20, 0x0037);
    let homing = drive.submit(HOME);
    drive.shows_for(10, 0x0037);
    assert_eq!(drive.word(), 0x001F);
    drive.shows(0x1037);
    // Each deadline is over by then.
    drive.shows_for(5_000, 0x0037);
    let outcome = drive.outcome(homing);
    assert!(matches!(outcome, Some(Err(_))), "{outcome:?}");
}
