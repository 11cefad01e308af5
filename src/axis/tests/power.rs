//! To Operation enabled and down again: each word, and each deadline to the cycle.

use alloc::format;

use super::played::{
    Brings, ENABLED, FAULT, FAULT_REACTION, Played, QUICK_STOP, QUICK_STOP_ACTIVE, REACHED, READY,
    SWITCH_ON_DISABLED, SWITCHED_ON, stopped,
};
use crate::{
    Failure,
    axis::{Command, CommandId, Completion, CoreConfig, Inhibit, WaitingFor},
    ds402::{Controlword, QuickStopOption, State, Statusword},
};

const DISABLE_VOLTAGE: u16 = 0x00;
const SHUTDOWN: u16 = 0x06;
const SWITCH_ON: u16 = 0x07;
const ENABLE_OPERATION: u16 = 0x0F;

const DONE: Option<Result<Completion, Failure>> = Some(Ok(Completion::Done));

/// Led up to the word that enables it, with Switched on shown.
fn led_up(config: CoreConfig) -> (Played, CommandId) {
    let mut drive = Played::disabled(config);
    assert_eq!(drive.word(), DISABLE_VOLTAGE);
    let enabling = drive.submit(Command::Enable);
    assert_eq!(drive.word(), SHUTDOWN);
    for (statusword, word) in [
        (SWITCH_ON_DISABLED, SHUTDOWN),
        (READY, SWITCH_ON),
        (SWITCHED_ON, ENABLE_OPERATION),
    ] {
        drive.shows(statusword);
        assert_eq!(drive.word(), word);
    }
    (drive, enabling)
}

#[test]
fn it_is_enabled_when_the_drive_shows_that() {
    let (mut drive, enabling) = led_up(Played::config());
    assert_eq!(drive.outcome(enabling), None);
    drive.shows(ENABLED);
    assert_eq!(drive.outcome(enabling), DONE);
}

#[test]
fn a_word_that_enables_it_counts_from_when_it_is_known_to_be_delivered() {
    let (mut drive, enabling) = led_up(Played::config());
    drive.cycles(10, Brings::Answered, ENABLED);
    assert_eq!(
        (drive.outcome(enabling), drive.word()),
        (None, ENABLE_OPERATION)
    );
    drive.shows(ENABLED);
    assert_eq!(drive.outcome(enabling), DONE);
}

#[test]
fn a_drive_that_is_enabled_before_it_was_asked_to_is_led_down_first() {
    let mut drive = Played::disabled(Played::config());
    let enabling = drive.submit(Command::Enable);
    drive.shows(READY);
    assert_eq!(drive.word(), SWITCH_ON);
    drive.shows(ENABLED);
    assert_eq!(drive.word(), DISABLE_VOLTAGE);
    assert_eq!(drive.cycles_until(SHUTDOWN, SWITCH_ON_DISABLED), 3);
    for statusword in [READY, SWITCHED_ON, ENABLED] {
        assert_eq!(drive.outcome(enabling), None);
        drive.shows(statusword);
    }
    assert_eq!(drive.outcome(enabling), DONE);
}

#[test]
fn a_drive_that_is_not_enabled_in_time_is_told_what_keeps_it() {
    let refused = |by, state| (by, state);
    let local = refused(Inhibit::LocalControl, State::SwitchOnDisabled);
    let no_voltage = refused(Inhibit::NoVoltage, State::SwitchOnDisabled);
    let ready_without_voltage = refused(Inhibit::NoVoltage, State::ReadyToSwitchOn);
    let on_without_voltage = refused(Inhibit::NoVoltage, State::SwitchedOn);
    let disabled = refused(Inhibit::Unnamed, State::SwitchOnDisabled);
    let ready = refused(Inhibit::Unnamed, State::ReadyToSwitchOn);
    // With bit 9 low; with bit 4 low; with both high. Of a drive whose bit 4 shows its voltage, and of others.
    for (statusword, shows_voltage, word, failure) in [
        (0x0050, true, SHUTDOWN, Some(local)),
        (0x0050, false, SHUTDOWN, Some(local)),
        (0x0240, true, SHUTDOWN, Some(no_voltage)),
        (0x0240, false, SHUTDOWN, Some(disabled)),
        (0x0250, true, SHUTDOWN, Some(disabled)),
        (0x0221, true, SHUTDOWN, Some(ready_without_voltage)),
        (0x0221, false, SWITCH_ON, Some(ready)),
        (0x0231, true, SWITCH_ON, Some(ready)),
        (0x0223, true, ENABLE_OPERATION, Some(on_without_voltage)),
        (0x0223, false, ENABLE_OPERATION, None),
        (0x0233, true, ENABLE_OPERATION, None),
    ] {
        let mut config = Played::config();
        config.traits.shows_voltage = shows_voltage;
        let mut drive = Played::disabled(config);
        let enabling = drive.submit(Command::Enable);
        drive.shows_for(299, statusword);
        let case = format!("{statusword:04X}, {shows_voltage}");
        assert_eq!(
            (drive.outcome(enabling), drive.word()),
            (None, word),
            "{case}"
        );
        drive.shows(statusword);
        assert_eq!(drive.word(), DISABLE_VOLTAGE, "{case}");
        match (drive.outcome(enabling), failure) {
            (Some(Err(shown)), Some(failure)) => {
                let (by, state) = failure;
                let refused = Failure::EnableRefused {
                    by,
                    state,
                    statusword: Statusword::from_bits_retain(statusword),
                    controlword: Controlword::from_bits_retain(word),
                };
                assert_eq!(shown, refused, "{case}");
            }
            (Some(Err(Failure::Timeout { waiting_for, .. })), None) => {
                assert_eq!(
                    waiting_for,
                    WaitingFor::State(State::OperationEnabled),
                    "{case}"
                );
            }
            (shown, _) => panic!("{case}: {shown:?}"),
        }
    }
}

#[test]
fn an_enable_says_what_is_in_its_way() {
    let mut drive = Played::enabled(Played::config());
    assert_eq!(drive.answer(Command::Enable), DONE);
    // A stop of an axis at rest stops nothing, and leaves it enabled.
    let state = State::OperationEnabled;
    assert_eq!(drive.answer(Command::Stop), stopped(state));
    assert_eq!(drive.answer(Command::Enable), DONE);
    drive.answer(Command::QuickStop);
    assert_eq!(drive.answer(Command::Enable), Some(Err(Failure::Busy)));

    let mut drive = Played::disabled(Played::config());
    drive.submit(Command::Enable);
    assert_eq!(drive.answer(Command::Enable), Some(Err(Failure::Busy)));
    // Whoever stops an enabling is not overtaken in the same frame.
    drive.submit(Command::Stop);
    assert_eq!(drive.word(), DISABLE_VOLTAGE);
    assert_eq!(drive.answer(Command::Enable), Some(Err(Failure::Busy)));
    drive.shows(SWITCH_ON_DISABLED);
    assert_eq!(drive.answer(Command::Enable), None);
    assert_eq!(drive.word(), SHUTDOWN);
}

#[test]
fn whatever_stops_an_enabling_is_its_end() {
    let state = State::SwitchOnDisabled;
    for (command, failure) in [
        (Command::Halt, Failure::HALTED),
        (Command::Stop, Failure::QUICK_STOPPED),
        (Command::QuickStop, Failure::QUICK_STOPPED),
        (Command::Disable, Failure::Disabled { state }),
    ] {
        let mut drive = Played::disabled(Played::config());
        let enabling = drive.submit(Command::Enable);
        assert_eq!(drive.answer(command), stopped(state), "{command:?}");
        assert_eq!(drive.outcome(enabling), Some(Err(failure)), "{command:?}");
        assert_eq!(drive.word(), DISABLE_VOLTAGE, "{command:?}");
    }
}

#[test]
fn a_standing_axis_is_disabled_by_shutdown() {
    let mut drive = Played::enabled(Played::config());
    let disabling = drive.submit(Command::Disable);
    assert_eq!(drive.word(), SHUTDOWN);
    for statusword in [ENABLED, SWITCHED_ON] {
        drive.shows(statusword);
        assert_eq!((drive.outcome(disabling), drive.word()), (None, SHUTDOWN));
    }
    drive.shows_for(3, READY);
    assert_eq!(drive.outcome(disabling), stopped(State::ReadyToSwitchOn));
    // It stays there, as long as its drive does.
    drive.shows_for(30, READY);
    assert_eq!(drive.word(), SHUTDOWN);
    drive.shows(SWITCH_ON_DISABLED);
    assert_eq!(drive.word(), DISABLE_VOLTAGE);

    let mut drive = Played::enabled(Played::config());
    let disabling = drive.submit(Command::Disable);
    drive.shows_for(3, SWITCH_ON_DISABLED);
    assert_eq!(drive.outcome(disabling), stopped(State::SwitchOnDisabled));
    assert_eq!(drive.word(), DISABLE_VOLTAGE);
}

#[test]
fn a_drive_that_does_not_take_its_shutdown_gets_disable_voltage_at_the_deadline() {
    for statusword in [REACHED, SWITCHED_ON, QUICK_STOP_ACTIVE] {
        let mut drive = Played::enabled(Played::config());
        let disabling = drive.submit(Command::Disable);
        let (cycles, result) = drive.cycles_to_end(disabling, statusword);
        assert_eq!(cycles, 200, "{statusword:04X}");
        let Err(Failure::Timeout { waiting_for, .. }) = result else {
            panic!("{result:?}");
        };
        assert_eq!(waiting_for, WaitingFor::State(State::SwitchOnDisabled));
        assert_eq!(drive.word(), DISABLE_VOLTAGE);
    }
}

#[test]
fn an_axis_that_moves_after_its_shutdown_gets_a_quick_stop_and_no_power_after_it() {
    // By 605Ah the drive goes on to Switch on disabled, or stays in Quick stop active.
    for option in [2, 6] {
        let mut config = Played::config();
        config.quick_stop = QuickStopOption(option);
        let mut drive = Played::enabled(config);
        let disabling = drive.submit(Command::Disable);
        drive.velocity = 50;
        drive.shows(ENABLED);
        assert_eq!(drive.word(), QUICK_STOP);
        drive.shows_for(3, QUICK_STOP_ACTIVE);
        drive.velocity = 0;
        let stays = option == 6;
        if stays {
            assert_eq!(drive.cycles_until(DISABLE_VOLTAGE, QUICK_STOP_ACTIVE), 12);
        } else {
            drive.shows_for(30, QUICK_STOP_ACTIVE);
            assert_eq!(drive.word(), QUICK_STOP);
        }
        assert_eq!(drive.outcome(disabling), None);
        drive.shows_for(3, SWITCH_ON_DISABLED);
        assert_eq!(drive.outcome(disabling), stopped(State::SwitchOnDisabled));
        assert_eq!(drive.word(), DISABLE_VOLTAGE);
    }
}

#[test]
fn a_disable_is_asked_for_once_and_again_by_those_who_wait_for_it() {
    let mut drive = Played::enabled(Played::config());
    let disabling = drive.submit(Command::Disable);
    drive.submit_as(disabling, Command::Disable);
    assert_eq!(drive.outcome(disabling), None);
    assert_eq!(drive.answer(Command::Disable), Some(Err(Failure::Busy)));
    assert_eq!(drive.answer(Command::Enable), Some(Err(Failure::Busy)));
    drive.shows_for(3, READY);
    assert_eq!(drive.outcome(disabling), stopped(State::ReadyToSwitchOn));
}

#[test]
fn a_disable_of_an_axis_that_was_not_enabled_leads_it_below_switched_on() {
    let mut drive = Played::disabled(Played::config());
    assert_eq!(
        drive.answer(Command::Disable),
        stopped(State::SwitchOnDisabled)
    );
    let mut drive = Played::new(Played::config());
    drive.shows_for(20, SWITCHED_ON);
    let disabling = drive.submit(Command::Disable);
    drive.shows(SWITCHED_ON);
    assert_eq!((drive.outcome(disabling), drive.word()), (None, 0));
    drive.shows_for(3, SWITCH_ON_DISABLED);
    assert_eq!(drive.outcome(disabling), stopped(State::SwitchOnDisabled));
}

#[test]
fn a_fault_ends_whatever_leads_the_axis_somewhere() {
    let code = None;
    for command in [Command::Enable, Command::Disable] {
        let mut drive = if command == Command::Enable {
            Played::disabled(Played::config())
        } else {
            Played::enabled(Played::config())
        };
        let id = drive.submit(command);
        drive.shows(FAULT);
        assert_eq!(
            drive.outcome(id),
            Some(Err(Failure::Fault {
                code,
                following_error: false
            }))
        );
    }
}

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
    assert_eq!(
        drive.outcome(stopping),
        Some(Err(Failure::Fault {
            code,
            following_error: false
        }))
    );
    drive.shows_for(5, SWITCH_ON_DISABLED);
    assert_eq!(drive.outcome(resetting), stopped(State::SwitchOnDisabled));
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
    assert_eq!(
        drive.outcome(disabling),
        Some(Err(Failure::Fault {
            code,
            following_error: false
        }))
    );
}
