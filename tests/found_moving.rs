//! An axis that a program finds enabled and moving without having enabled it: it is stopped before it is switched off.
#![allow(missing_docs)]

mod common;

use common::{Link, Rig};
use servocrab::axis::{Command, Completion};
use servocrab::ds402::{QuickStopOption, State};
use servocrab::profile_position::SetPoint;
use servocrab_sim::ds402::{self, Behaviour};

const QUICK_STOP: u16 = 0x000B;

/// 605Ah, and whether 606Ch is mapped.
const DRIVES: [(i16, bool); 8] = [
    (1, true),
    (2, true),
    (5, true),
    (6, true),
    (1, false),
    (2, false),
    (5, false),
    (6, false),
];

fn rig((option, shows_velocity): (i16, bool)) -> Rig {
    let behaviour = Behaviour {
        quick_stop_option: option,
        ..Behaviour::akd2g()
    };
    Rig::new(behaviour, |config| {
        config.quick_stop = QuickStopOption(option);
        if !shows_velocity {
            config.fields.actual_velocity = None;
        }
    })
}

/// A drive that is on its way to this target, and a core that has seen nothing of it.
fn found_on_the_way_to(target: i32, drive: (i16, bool)) -> Rig {
    let mut rig = rig(drive);
    // A quick stop of a fifth of a second.
    rig.drive.set(0x6085, 0, 200_000).unwrap();
    rig.enable();
    let id = rig.abs(target, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(150);
    assert!(rig.drive.velocity() > 10_000.0);
    let begun_anew = self::rig(drive);
    rig.core = begun_anew.core;
    rig.outputs = begun_anew.outputs;
    rig.words.clear();
    // The drive does not take outputs yet; nothing comes back either.
    rig.cycle_over(Link::RequestLost);
    rig
}

fn found(drive: (i16, bool)) -> Rig {
    found_on_the_way_to(1_000_000, drive)
}

/// Runs the axis, which must not lose its power while it moves.
fn run_without_coasting(rig: &mut Rig, cycles: usize) {
    for _ in 0..cycles {
        rig.cycle();
        let powered = matches!(
            rig.drive.state(),
            ds402::State::OperationEnabled | ds402::State::QuickStopActive
        );
        assert!(powered || !rig.moves(), "it coasts");
    }
}

#[test]
fn it_gets_a_quick_stop_until_it_stands_and_then_disable_voltage() {
    for drive in DRIVES {
        let mut rig = found(drive);
        run_without_coasting(&mut rig, 2_000);
        assert_eq!(rig.distinct_words(1), [QUICK_STOP, 0], "{drive:?}");
        assert_eq!(rig.drive.state(), ds402::State::SwitchOnDisabled);
    }
}

#[test]
fn one_that_stands_is_switched_off_at_once() {
    let mut rig = found_on_the_way_to(5_000, (2, true));
    // It arrives before the first frame that it takes.
    while !rig.drive.stands() {
        rig.cycle_over(Link::RequestLost);
    }
    let from = rig.words.len();
    rig.run(500);
    assert_eq!(rig.drive.state(), ds402::State::SwitchOnDisabled);
    assert_eq!(rig.words.last(), Some(&0));
    assert_eq!(rig.distinct_words(from), [QUICK_STOP, 0]);
}

#[test]
fn one_whose_drive_takes_no_orders_is_told_to_switch_off_when_it_stands() {
    let mut rig = found_on_the_way_to(30_000, (2, false));
    rig.drive.set_remote(false);
    run_without_coasting(&mut rig, 100);
    assert_eq!(rig.word(), QUICK_STOP);
    run_without_coasting(&mut rig, 2_000);
    assert!(rig.drive.stands(), "it has arrived");
    assert_eq!(rig.word(), 0);
}

#[test]
fn whoever_stops_it_is_told_when_it_stands() {
    for drive in DRIVES {
        let held = match drive {
            (5 | 6, _) => State::QuickStopActive,
            _ => State::SwitchOnDisabled,
        };
        for (command, state) in [
            (Command::Stop, held),
            (Command::QuickStop, held),
            (Command::Halt, held),
            (Command::Release, held),
            (Command::Disable, State::SwitchOnDisabled),
        ] {
            let mut rig = found(drive);
            rig.cycle();
            let id = rig.send(command);
            run_without_coasting(&mut rig, 10);
            assert_eq!(rig.outcome(id), None, "{command:?} waits");
            while rig.outcome(id).is_none() {
                run_without_coasting(&mut rig, 1);
            }
            assert!(rig.drive.stands(), "{command:?}, {drive:?}");
            assert_eq!(rig.outcome(id), Some(Ok(Completion::Stopped { state })));
        }
    }
}

#[test]
fn an_enable_stops_it_first_and_no_motion_follows() {
    for drive in DRIVES {
        let mut rig = found(drive);
        let id = rig.send(Command::Enable);
        run_without_coasting(&mut rig, 2_000);
        assert_eq!(rig.outcome(id), Some(Ok(Completion::Done)));
        assert_eq!(rig.drive.state(), ds402::State::OperationEnabled);
        assert!(rig.drive.stands());
    }
}
