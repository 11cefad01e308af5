//! "Commands in the controlword": each command from each state that its transitions leave, with every value of the bits
//! that the table marks as irrelevant.

use servocrab::SetPoint;
use servocrab::ds402::{QuickStopOption, State as Shown};
use servocrab::{
    Failure,
    axis::{Command, Completion, Inhibit},
};
use servocrab_sim::ds402::{Behaviour, State};

use crate::bench::Drive;
use crate::common::Rig;

/// A drive that stays in Quick stop active.
fn behaviour() -> Behaviour {
    Behaviour {
        quick_stop_option: 6,
        ..Behaviour::akd2g()
    }
}

/// Led to the state by the document's own words; bit 7 low.
fn in_state(state: State) -> Drive {
    let mut drive = Drive::new(behaviour());
    let words: &[u16] = match state {
        State::ReadyToSwitchOn => &[0x06],
        State::SwitchedOn => &[0x06, 0x07],
        State::OperationEnabled => &[0x06, 0x07, 0x0F],
        State::QuickStopActive => &[0x06, 0x07, 0x0F, 0x0B],
        _ => &[0x00],
    };
    for word in words {
        drive.word(*word);
    }
    drive.run(5);
    assert_eq!(drive.state(), state);
    drive
}

/// Every word of a command leads from each state to the one of its transition.
fn leads(value: u16, irrelevant: u16, transitions: &[(State, State)]) {
    for &(from, to) in transitions {
        for bits in 0..=0xFF_u16 {
            if bits & !irrelevant != 0 {
                continue;
            }
            let mut drive = in_state(from);
            drive.word(value | bits);
            drive.run(50);
            assert_eq!(drive.state(), to, "{:02X}h from {from:?}", value | bits);
        }
    }
}

/// Bit 7 beside the command's own bits.
const BIT_7: u16 = 0x80;
const BIT_3: u16 = 0x08;

/// The words of an enabled rig from here on, each run once, after a command.
fn words_of(rig: &mut Rig, command: Command) -> Vec<u16> {
    let from = rig.words.len();
    let id = rig.send(command);
    assert!(rig.finish(id).is_ok());
    rig.run(3);
    rig.distinct_words(from)
}

fn enabled() -> Rig {
    let mut rig = Rig::new(behaviour(), |config| config.quick_stop = QuickStopOption(6)).ideal();
    rig.enable();
    rig
}

#[test]
pub(super) fn drive_shuts_down() {
    leads(
        0x06,
        BIT_7 | BIT_3,
        &[
            (State::SwitchOnDisabled, State::ReadyToSwitchOn),
            (State::SwitchedOn, State::ReadyToSwitchOn),
            (State::OperationEnabled, State::ReadyToSwitchOn),
        ],
    );
}

#[test]
pub(super) fn library_shuts_down() {
    let mut rig = enabled();
    assert_eq!(words_of(&mut rig, Command::Disable), [0x06]);
    assert_eq!(rig.drive.state(), State::ReadyToSwitchOn);
}

#[test]
pub(super) fn drive_switches_on() {
    // Bit 3 is open in the table as well, but with it the word is the next command too.
    leads(0x07, BIT_7, &[(State::ReadyToSwitchOn, State::SwitchedOn)]);
}

#[test]
pub(super) fn library_switches_on() {
    let mut rig = Rig::new(
        Behaviour {
            power_on_cycles: 20,
            ..behaviour()
        },
        |_| {},
    )
    .ideal();
    let id = rig.send(Command::Enable);
    rig.run_until(50, |rig| rig.core.snapshot().state == Shown::SwitchedOn);
    assert!(rig.words.contains(&0x07));
    assert_eq!(rig.finish(id), Ok(Completion::Done));
}

#[test]
pub(super) fn drive_disables_the_voltage() {
    leads(
        0x00,
        BIT_7 | BIT_3 | 0x05,
        &[
            (State::ReadyToSwitchOn, State::SwitchOnDisabled),
            (State::SwitchedOn, State::SwitchOnDisabled),
            (State::OperationEnabled, State::SwitchOnDisabled),
            (State::QuickStopActive, State::SwitchOnDisabled),
        ],
    );
}

#[test]
pub(super) fn library_disables_the_voltage() {
    let mut rig = enabled();
    let stop = words_of(&mut rig, Command::QuickStop);
    assert_eq!(stop.last(), Some(&0x0B));
    let words = words_of(&mut rig, Command::Disable);
    assert_eq!(words.last(), Some(&0x00));
    assert_eq!(rig.drive.state(), State::SwitchOnDisabled);
}

#[test]
pub(super) fn drive_quick_stops() {
    leads(
        0x02,
        BIT_7 | BIT_3 | 0x01,
        &[
            (State::ReadyToSwitchOn, State::SwitchOnDisabled),
            (State::SwitchedOn, State::SwitchOnDisabled),
            (State::OperationEnabled, State::QuickStopActive),
        ],
    );
}

#[test]
pub(super) fn library_quick_stops() {
    let mut rig = enabled();
    let from = rig.words.len();
    let stop = rig.send(Command::QuickStop);
    assert_eq!(
        rig.finish(stop),
        Ok(Completion::Stopped {
            state: Shown::QuickStopActive
        })
    );
    assert_eq!(rig.distinct_words(from), [0x0B]);
}

#[test]
pub(super) fn drive_disables_operation() {
    leads(0x07, BIT_7, &[(State::OperationEnabled, State::SwitchedOn)]);
}

#[test]
pub(super) fn drive_enables_operation() {
    leads(0x0F, BIT_7, &[(State::SwitchedOn, State::OperationEnabled)]);
}

#[test]
pub(super) fn library_enables_operation() {
    let rig = enabled();
    assert_eq!(rig.drive.state(), State::OperationEnabled);
    // Quick stop until the state was seen for two of the drive's cycles.
    assert_eq!(rig.distinct_words(1), [0x0B, 0x00, 0x06, 0x07, 0x0F]);
}

/// In Fault, the cause gone.
fn faulty() -> Drive {
    let mut drive = in_state(State::OperationEnabled);
    drive.word(0x00);
    drive.axis.inject_fault(0x7305);
    drive.run(50);
    assert_eq!(drive.state(), State::Fault);
    drive
}

#[test]
pub(super) fn drive_resets_a_fault() {
    // Whatever the other bits are.
    for other in [0x00, 0x06, 0x0F, 0x7F] {
        let mut drive = faulty();
        drive.word(other);
        assert_eq!(drive.state(), State::Fault);
        drive.word(other | BIT_7);
        assert_eq!(drive.state(), State::SwitchOnDisabled, "{other:02X}h");
    }
}

#[test]
pub(super) fn library_resets_a_fault() {
    let mut rig = enabled();
    rig.drive.inject_fault(0x7305);
    rig.run_until(100, |rig| rig.core.snapshot().state == Shown::Fault);
    let from = rig.words.len();
    let reset = rig.send(Command::ResetFault);
    assert_eq!(
        rig.finish(reset),
        Ok(Completion::Stopped {
            state: Shown::SwitchOnDisabled
        })
    );
    assert!(rig.words[from..].contains(&0x80));
}

#[test]
pub(super) fn drive_ignores_bit_7_beside_a_command() {
    let mut drive = Drive::new(behaviour());
    for (word, state) in [
        (0x86, State::ReadyToSwitchOn),
        (0x87, State::SwitchedOn),
        (0x8F, State::OperationEnabled),
        (0x8B, State::QuickStopActive),
        (0x80, State::SwitchOnDisabled),
    ] {
        drive.word(word);
        assert_eq!(drive.state(), state, "{word:02X}h");
    }
}

#[test]
pub(super) fn library_sends_bit_7_alone() {
    let mut rig = enabled();
    rig.drive.inject_fault(0x7305);
    rig.run_until(100, |rig| rig.core.snapshot().state == Shown::Fault);
    let reset = rig.send(Command::ResetFault);
    assert!(rig.finish(reset).is_ok());
    rig.enable();
    rig.run(10);
    for word in rig.words.iter().filter(|word| *word & BIT_7 != 0) {
        assert_eq!(*word, BIT_7);
    }
    assert!(rig.words.contains(&BIT_7));
    assert_eq!(rig.word(), 0x0F);
}

#[test]
pub(super) fn drive_resets_nothing_without_a_fault() {
    for state in [
        State::SwitchOnDisabled,
        State::ReadyToSwitchOn,
        State::SwitchedOn,
        State::OperationEnabled,
    ] {
        let mut drive = in_state(state);
        let word = drive.axis.controlword();
        drive.word(word | BIT_7);
        drive.word(word);
        assert_eq!(drive.state(), state);
    }
}

#[test]
pub(super) fn library_sends_no_reset_without_a_fault() {
    let mut rig = enabled();
    let from = rig.words.len();
    let reset = rig.send(Command::ResetFault);
    assert!(rig.finish(reset).is_ok());
    rig.run(10);
    assert_eq!(rig.distinct_words(from), [0x0F]);
}

#[test]
pub(super) fn drive_needs_its_enable_input() {
    let mut drive = Drive::new(behaviour());
    drive.axis.set_inhibited(true);
    for word in [0x06, 0x07, 0x0F] {
        drive.word(word);
        drive.run(5);
        assert_eq!(drive.state(), State::ReadyToSwitchOn, "{word:02X}h");
    }
    drive.axis.set_inhibited(false);
    drive.word(0x07);
    drive.word(0x0F);
    assert_eq!(drive.state(), State::OperationEnabled);
    drive.start(0x0F, 20_000);
    drive.run(100);
    drive.axis.set_inhibited(true);
    drive.run(1);
    assert_eq!(drive.state(), State::SwitchOnDisabled, "and loses it");
}

#[test]
pub(super) fn library_says_what_it_waits_for_without_the_enable_input() {
    let mut rig = Rig::akd2g().ideal();
    rig.drive.set_inhibited(true);
    let id = rig.send(Command::Enable);
    rig.run(100);
    assert_eq!(rig.outcome(id), None, "it waits");
    let end = rig.finish(id);
    assert!(
        matches!(
            end,
            Err(Failure::EnableRefused {
                by: Inhibit::Unnamed,
                state: Shown::ReadyToSwitchOn,
                ..
            })
        ),
        "{end:?}"
    );
    rig.run(3);
    assert_eq!(rig.drive.state(), State::SwitchOnDisabled);
    let refused = rig.abs(5_000, SetPoint::new());
    assert!(matches!(
        rig.outcome(refused),
        Some(Err(Failure::NotEnabled { .. }))
    ));
}
