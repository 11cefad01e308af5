//! The reset of a fault: each edge of bit 7, to the cycle.

use alloc::vec::Vec;
use core::time::Duration;

use super::played::{
    Brings, ENABLED, FAULT, FAULT_REACTION, NOT_READY, Played, QUICK_STOP_ACTIVE, READY,
    SWITCH_ON_DISABLED, SWITCHED_ON,
};
use crate::{
    axis::{Command, CommandId, Completion, CoreConfig, Failure, WaitingFor},
    ds402::{State, Statusword},
};

const RESET: u16 = 0x80;
const LOW: u16 = 0x00;

/// At rest with a fault, and asked to reset it.
fn resetting(config: CoreConfig) -> (Played, CommandId) {
    let mut drive = Played::enabled(config);
    drive.shows_for(20, FAULT);
    assert_eq!(drive.word(), LOW);
    let id = drive.submit(Command::ResetFault);
    assert_eq!(drive.word(), LOW);
    (drive, id)
}

/// The same, with bit 7 high.
fn reset_once() -> (Played, CommandId) {
    let (mut drive, id) = resetting(Played::config());
    assert_eq!(drive.cycles_until(RESET, FAULT), 3);
    (drive, id)
}

fn stopped(state: State) -> Option<Result<Completion, Failure>> {
    Some(Ok(Completion::Stopped { state }))
}

#[track_caller]
fn assert_waited_for(result: Result<Completion, Failure>, expected: WaitingFor) {
    let Err(Failure::Timeout { waiting_for, .. }) = result else {
        panic!("{result:?}");
    };
    assert_eq!(waiting_for, expected);
}

#[test]
fn a_fault_that_stays_gets_three_edges_and_ends_the_reset() {
    let (mut drive, id) = resetting(Played::config());
    drive.error_code = 0x8611;
    let mut lengths = Vec::new();
    for _ in 0..3 {
        lengths.push(drive.cycles_until(RESET, FAULT));
        lengths.push(drive.cycles_until(LOW, FAULT));
    }
    // Seen for two cycles of the drive; then each edge's time, and the pause.
    assert_eq!(lengths, [3, 30, 100, 30, 100, 30]);
    let code = Some(0x8611);
    assert_eq!(drive.outcome(id), Some(Err(Failure::Fault { code })));
    drive.shows_for(300, FAULT);
    assert_eq!(drive.word(), LOW);
}

#[test]
fn an_edge_comes_only_when_the_low_is_known_to_be_delivered() {
    let (mut drive, _) = resetting(Played::config());
    drive.cycles(20, Brings::Answered, FAULT);
    assert_eq!(drive.word(), LOW);
    drive.shows(FAULT);
    assert_eq!(drive.word(), RESET);
}

#[test]
fn an_edge_comes_only_when_two_samples_have_shown_the_fault() {
    let mut config = Played::config();
    config.traits.drive_cycle = Duration::ZERO;
    let (mut drive, id) = resetting(config);
    assert_eq!(drive.cycles_until(RESET, FAULT), 2);
    // And it is over when two have shown that it is gone.
    drive.shows(SWITCH_ON_DISABLED);
    assert_eq!((drive.outcome(id), drive.word()), (None, LOW));
    drive.shows(SWITCH_ON_DISABLED);
    assert_eq!(drive.outcome(id), stopped(State::SwitchOnDisabled));
}

#[test]
fn it_is_done_when_the_drive_has_shown_a_state_without_power_for_two_of_its_cycles() {
    for (statusword, state) in [
        (SWITCH_ON_DISABLED, State::SwitchOnDisabled),
        (NOT_READY, State::NotReadyToSwitchOn),
        (READY, State::ReadyToSwitchOn),
    ] {
        let (mut drive, id) = reset_once();
        drive.shows_for(2, statusword);
        assert_eq!((drive.outcome(id), drive.word()), (None, LOW));
        drive.shows(statusword);
        assert_eq!(drive.outcome(id), stopped(state));
        drive.shows_for(50, statusword);
        assert_eq!(drive.word(), LOW, "nothing is enabled");
    }
}

#[test]
fn a_fault_that_is_gone_before_the_edge_is_done_as_well() {
    let (mut drive, id) = resetting(Played::config());
    drive.shows_for(3, SWITCH_ON_DISABLED);
    assert_eq!(drive.outcome(id), stopped(State::SwitchOnDisabled));
    assert_eq!(drive.word(), LOW);
}

#[test]
fn a_fault_that_comes_back_gets_the_next_edge_after_the_pause() {
    let (mut drive, id) = reset_once();
    drive.shows(SWITCH_ON_DISABLED);
    assert_eq!(drive.word(), LOW);
    assert_eq!(drive.cycles_until(RESET, FAULT), 101);
    drive.shows(SWITCH_ON_DISABLED);
    assert_eq!(drive.cycles_until(RESET, FAULT), 101);
    // The last edge is spent: it ends at once when the fault comes back.
    drive.shows(SWITCH_ON_DISABLED);
    assert_eq!(drive.outcome(id), None);
    drive.shows(FAULT);
    let code = None;
    assert_eq!(drive.outcome(id), Some(Err(Failure::Fault { code })));
}

#[test]
fn a_drive_that_does_not_come_to_a_state_without_power_is_given_up_at_the_deadline() {
    for statusword in [SWITCHED_ON, ENABLED, QUICK_STOP_ACTIVE] {
        let (mut drive, id) = reset_once();
        drive.shows(statusword);
        let (cycles, result) = drive.cycles_to_end(id, statusword);
        assert_eq!(cycles, 400, "{statusword:04X}");
        assert_waited_for(result, WaitingFor::State(State::SwitchOnDisabled));
    }
}

#[test]
fn it_waits_for_the_fault_reaction_and_for_the_standstill_until_the_deadline() {
    let mut drive = Played::enabled(Played::config());
    drive.shows_for(2, FAULT_REACTION);
    let id = drive.submit(Command::ResetFault);
    let (cycles, result) = drive.cycles_to_end(id, FAULT_REACTION);
    assert_eq!(cycles, 400);
    assert_waited_for(result, WaitingFor::State(State::Fault));

    let mut drive = Played::enabled(Played::config());
    drive.velocity = 30;
    drive.shows_for(20, FAULT);
    let id = drive.submit(Command::ResetFault);
    let begun = drive.position;
    let (cycles, result) = drive.cycles_to_end(id, FAULT);
    assert_eq!(cycles, 400);
    let Err(Failure::Timeout {
        waiting_for: WaitingFor::Standstill(seen),
        statusword,
        ..
    }) = result
    else {
        panic!("{result:?}");
    };
    assert_eq!(statusword, Statusword::from_bits_retain(FAULT));
    let (least, greatest) = seen.positions;
    assert!(least > begun && greatest == drive.position, "{seen:?}");
    assert_eq!(seen.velocities, Some((30, 30, 0)));

    // It comes to rest in time.
    let mut drive = Played::enabled(Played::config());
    drive.velocity = 30;
    drive.shows_for(20, FAULT);
    drive.submit(Command::ResetFault);
    drive.shows_for(50, FAULT);
    assert_eq!(drive.word() & RESET, 0);
    drive.velocity = 0;
    // The place where it stands is new; it stands there for an eighth of the settle time.
    assert_eq!(drive.cycles_until(RESET, FAULT), 14);
}

#[test]
fn without_a_fault_there_is_nothing_to_reset_and_one_reset_goes_on_at_a_time() {
    let mut drive = Played::enabled(Played::config());
    let state = State::OperationEnabled;
    assert_eq!(
        drive.answer(Command::ResetFault),
        Some(Err(Failure::NoFault { state }))
    );
    let (mut drive, id) = reset_once();
    assert_eq!(drive.answer(Command::ResetFault), Some(Err(Failure::Busy)));
    // A disable is done at standstill, and leaves the reset to go on.
    assert_eq!(drive.answer(Command::Disable), stopped(State::Fault));
    let code = None;
    assert_eq!(
        drive.answer(Command::Enable),
        Some(Err(Failure::Fault { code }))
    );
    assert_eq!((drive.word(), drive.outcome(id)), (RESET, None));
    drive.shows(SWITCH_ON_DISABLED);
    assert_eq!(drive.answer(Command::Enable), Some(Err(Failure::Busy)));
}
