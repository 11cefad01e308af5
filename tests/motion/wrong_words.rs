//! A statusword that is wrong for one cycle, and states that follow each other in ways that the standard does not know: a moving axis
//! keeps its brake, everything asked for ends, and the axis can be enabled again.

use crate::common::{Link, Rig};
use servocrab::SetPoint;
use servocrab::ds402::{QuickStopOption, State};
use servocrab::{
    Failure,
    axis::{Command, CommandId, Completion},
};
use servocrab_sim::ds402::{self, Behaviour};

/// A word of each state, and one of none.
const WORDS: [u16; 9] = [
    0x0200, 0x0250, 0x0231, 0x0233, 0x0237, 0x0217, 0x023F, 0x0238, 0x022A,
];

fn rig(option: i16) -> Rig {
    let behaviour = Behaviour {
        quick_stop_option: option,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |config| {
        config.quick_stop = QuickStopOption(option);
        // What is tried here ends before the drive counts as lost.
        config.loss.undelivered_cycles = 400;
    });
    // A quick stop of a fifth of a second, and slow ramps.
    rig.drive.set(0x6085, 0, 200_000).unwrap();
    rig
}

/// On its way at 50 000 counts/s.
fn moving(option: i16) -> (Rig, CommandId) {
    let mut rig = rig(option);
    rig.enable();
    let id = rig.abs(10_000_000, SetPoint::new().deceleration(200_000));
    rig.wait_accepted(id);
    rig.run(300);
    assert!(rig.drive.velocity() > 40_000.0);
    (rig, id)
}

fn is_powered(rig: &Rig) -> bool {
    use ds402::State::{FaultReactionActive, OperationEnabled, QuickStopActive};
    matches!(
        rig.drive.state(),
        OperationEnabled | QuickStopActive | FaultReactionActive
    )
}

/// One cycle, in which a moving axis must not lose its power. Where 605Ah is 0 the drive lets it coast by quick stop itself; then no other
/// word may have done so.
fn cycle(rig: &mut Rig, option: i16, what: &str) {
    rig.cycle();
    let moves = rig.moves();
    if option == 0 {
        let sent = rig.words.last().unwrap();
        assert!(!moves || sent & 2 != 0, "{what}: {sent:04X} is sent");
    } else {
        assert!(is_powered(rig) || !moves, "{what}: it coasts");
    }
}

fn to_rest(rig: &mut Rig, option: i16, what: &str) {
    for _ in 0..12_000 {
        if rig.drive.stands() {
            for _ in 0..400 {
                cycle(rig, option, what);
            }
            if rig.drive.stands() {
                return;
            }
        }
        cycle(rig, option, what);
    }
    panic!("{what}: it does not come to rest");
}

/// Everything leads on from where this has ended.
fn is_usable(rig: &mut Rig, what: &str) {
    if rig.core.snapshot().state == State::Fault {
        let reset = rig.send(Command::ResetFault);
        assert!(rig.finish(reset).is_ok(), "{what}: reset");
    }
    let at = rig.drive.position() as i32;
    let enable = rig.send(Command::Enable);
    assert_eq!(rig.finish(enable), Ok(Completion::Done), "{what}: enable");
    rig.run(200);
    let off = (rig.drive.position() as i32 - at).abs();
    assert!(off <= 10, "{what}: it moves unasked, by {off}");
    let halted = rig.core.snapshot().halted;
    if halted {
        let resume = rig.send(Command::Resume);
        assert!(rig.finish(resume).is_ok());
    }
    let target = at + 500;
    let id = rig.abs(target, SetPoint::new());
    let end = rig.finish(id);
    let is_there = |position: i32| (position - target).abs() <= 10;
    assert!(
        matches!(end, Ok(Completion::Reached { position }) if is_there(position)),
        "{what}: a move to {target}: {end:?}"
    );
}

#[test]
fn one_wrong_word_does_not_let_a_moving_axis_coast() {
    for option in 0..=8 {
        for word in WORDS {
            let what = format!("605Ah {option}, {word:04X}");
            let (mut rig, id) = moving(option);
            rig.forged = Some(word);
            cycle(&mut rig, option, &what);
            if matches!(word, 0x0237 | 0x022A) {
                // What it is, and what is no state at all: nothing has happened.
                rig.run(100);
                assert!(rig.drive.velocity() > 40_000.0, "{what}");
                assert_eq!(rig.outcome(id), None, "{what}");
                continue;
            }
            assert!(rig.outcome(id).is_some(), "{what}");
            to_rest(&mut rig, option, &what);
            is_usable(&mut rig, &what);
        }
    }
}

#[test]
fn a_stop_that_ends_well_ends_at_standstill_whatever_one_word_shows() {
    for option in [2, 6] {
        for word in WORDS {
            for command in [
                Command::Halt,
                Command::Stop,
                Command::QuickStop,
                Command::Disable,
            ] {
                for wait in [0, 1, 2, 5, 20, 100, 180, 240] {
                    let what = format!("605Ah {option}, {word:04X} {wait} after {command:?}");
                    let (mut rig, _) = moving(option);
                    let id = rig.send(command);
                    for _ in 0..wait {
                        cycle(&mut rig, option, &what);
                    }
                    rig.forged = Some(word);
                    let mut fastest = 0.0;
                    for _ in 0..12_000 {
                        if let Some(result) = rig.outcome(id) {
                            let standstill = f64::from(rig.drive.plant().standstill_velocity);
                            let stands = fastest <= standstill;
                            assert!(result.is_err() || stands, "{what}: at {fastest}");
                            break;
                        }
                        cycle(&mut rig, option, &what);
                        fastest = rig.drive.velocity().abs();
                    }
                    assert!(rig.outcome(id).is_some(), "{what}: it has no end");
                }
            }
        }
    }
}

#[test]
fn a_fault_is_reset_only_at_standstill_and_when_it_was_shown_for_two_drive_cycles() {
    for reaction in [0, 2] {
        let (mut rig, _) = moving(2);
        rig.drive.set(0x605E, 0, reaction).unwrap();
        rig.drive.inject_fault(0x7305);
        rig.cycle();
        rig.cycle();
        let reset = rig.send(Command::ResetFault);
        let mut shown = 0;
        while rig.outcome(reset).is_none() {
            let fault = rig.drive.state() == ds402::State::Fault;
            rig.cycle();
            if rig.words.last().unwrap() & 0x80 != 0 {
                assert_eq!(rig.drive.velocity(), 0.0, "605Eh = {reaction}");
                assert!(shown >= 2, "605Eh = {reaction}: {shown}");
            }
            shown = if fault { shown + 1 } else { 0 };
        }
        let state = State::SwitchOnDisabled;
        assert_eq!(rig.outcome(reset), Some(Ok(Completion::Stopped { state })));
    }
}

#[test]
fn stops_in_a_fault_reaction_are_done_when_the_axis_stands() {
    for command in [Command::Stop, Command::QuickStop, Command::Disable] {
        for before in [false, true] {
            let (mut rig, _) = moving(2);
            rig.drive.set(0x605E, 0, 1).unwrap();
            let early = before.then(|| rig.send(command));
            rig.cycle();
            rig.drive.inject_fault(0x7305);
            rig.cycle();
            rig.cycle();
            assert_eq!(rig.core.snapshot().state, State::FaultReactionActive);
            let id = early.unwrap_or_else(|| rig.send(command));
            while rig.outcome(id).is_none() {
                rig.cycle();
            }
            assert_eq!(rig.drive.velocity(), 0.0, "{command:?}");
            match rig.outcome(id) {
                Some(Err(Failure::Fault { .. })) if before => {}
                Some(Ok(Completion::Stopped { state })) if !before => assert!(state.is_fault()),
                other => panic!("{command:?}: {other:?}"),
            }
        }
    }
}

/// Standing halted, with a set-point that the drive keeps.
fn halted(option: i16) -> Rig {
    let (mut rig, _) = moving(option);
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    assert!(rig.core.snapshot().has_set_point);
    rig
}

#[test]
fn an_axis_is_not_enabled_by_one_wrong_word() {
    for wait in 0..12 {
        let mut rig = rig(2);
        rig.run(200);
        let id = rig.send(Command::Enable);
        rig.run(wait);
        rig.forged = Some(0x0237);
        rig.run_until(1_000, |rig| rig.outcome(id).is_some());
        assert_eq!(rig.outcome(id), Some(Ok(Completion::Done)), "{wait}");
        assert_eq!(rig.drive.state(), ds402::State::OperationEnabled, "{wait}");
    }
}

#[test]
fn words_of_a_drive_without_power_do_not_enable_an_axis_that_moves() {
    for word in [0x0250, 0x0231, 0x0233] {
        let (mut rig, _) = moving(6);
        let mut enable = None;
        for wrong in 0..600 {
            if wrong < 5 {
                rig.forged = Some(word);
            }
            if wrong == 3 {
                enable = Some(rig.send(Command::Enable));
            }
            rig.cycle();
            let brakes = rig.words.last().unwrap() & 0x06 == 0x02;
            let moves = rig.moves();
            assert!(brakes || !moves || wrong == 0, "{word:04X}: {wrong}");
        }
        assert!(
            enable.is_some_and(|id| rig.finish(id).is_ok()),
            "{word:04X}"
        );
    }
}

/// The drive gets no outputs as long as its words are wrong: nothing has led it down, and it holds its set-point.
#[test]
fn an_axis_is_not_enabled_before_a_word_that_leads_it_down_was_delivered() {
    for word in [0x0250, 0x0231, 0x0233] {
        for wrong in [1, 20, 120, 180] {
            let what = format!("{word:04X} for {wrong} cycles");
            let mut rig = halted(6);
            let at = rig.drive.position() as i32;
            rig.forged = Some(word);
            rig.cycle_over(Link::Undelivered);
            let enable = rig.send(Command::Enable);
            for _ in 0..wrong {
                rig.forged = Some(word);
                rig.cycle_over(Link::Undelivered);
            }
            let end = rig.finish(enable);
            assert_eq!(end, Ok(Completion::Done), "{what}");
            rig.run(300);
            let gone = (rig.drive.position() as i32 - at).abs();
            assert!(gone <= 10, "{what}: it moves unasked, by {gone}");
        }
    }
}
