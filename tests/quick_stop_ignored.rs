//! A drive on which bit 2 does nothing: an axis that does not stop is not driven any further.
#![allow(missing_docs)]

mod common;

use common::{Link, Rig};
use servocrab::axis::{Command, CommandId, Completion, Failure, StopRequest};
use servocrab::ds402::{QuickStopOption, State};
use servocrab::profile_position::SetPoint;
use servocrab_sim::ds402::{self, Behaviour};

/// Cycles of 1 ms until it is known that a bit does nothing: until the drive has surely seen it, and twice 100 ms.
const NOTICED: usize = 206;

const STOPS: [Command; 4] = [
    Command::QuickStop,
    Command::Stop,
    Command::Disable,
    Command::Release,
];

/// On a move of a minute, with a drive that takes no quick stop any more. Its shaft is ideal: `NOTICED` is a figure of docs/motion.md.
fn moving(shows_velocity: bool) -> (Rig, CommandId) {
    let mut rig = Rig::new(Behaviour::akd2g(), |config| {
        if !shows_velocity {
            config.fields.actual_velocity = None;
        }
    })
    .ideal();
    rig.enable();
    let id = rig.abs(600_000, SetPoint::new().velocity(10_000));
    rig.wait_accepted(id);
    rig.run(200);
    rig.drive.disturbances().deaf_to_quick_stop = true;
    (rig, id)
}

fn is_driven(rig: &Rig) -> bool {
    rig.drive.state() == ds402::State::OperationEnabled
}

#[test]
fn an_axis_that_runs_on_loses_its_voltage_and_whoever_waits_is_told() {
    for shows_velocity in [true, false] {
        for command in STOPS {
            let (mut rig, id) = moving(shows_velocity);
            // Then a stop comes to its quick stop with the axis at speed.
            rig.drive.disturbances().deaf_to_halt = true;
            let stop = rig.send(command);
            let mut cycles = 0;
            while is_driven(&rig) {
                rig.cycle();
                cycles += 1;
            }
            assert!(cycles <= 2 * NOTICED, "{command:?}: {cycles}");
            assert_eq!(rig.outcome(stop), Some(Err(Failure::QuickStopIgnored)));
            assert_eq!(rig.outcome(id), Some(Err(Failure::QuickStopIgnored)));
            // It stays off, and the next enable begins with nothing left over.
            rig.run(2_000);
            assert_eq!(rig.core.snapshot().state, State::SwitchOnDisabled);
            rig.drive.disturbances().deaf_to_quick_stop = false;
            rig.enable();
            rig.run(100);
            assert_eq!(rig.drive.velocity(), 0.0);
            assert_eq!(rig.word() & 0x0110, 0, "bits 4 and 8");
        }
    }
}

#[test]
fn whoever_asks_again_does_not_give_it_its_voltage_back() {
    let (mut rig, _) = moving(true);
    let first = rig.send(Command::QuickStop);
    while rig.outcome(first).is_none() {
        if rig.words.len() % 10 == 0 {
            rig.stop = StopRequest::QUICK_STOP;
        }
        rig.cycle();
    }
    assert_eq!(rig.outcome(first), Some(Err(Failure::QuickStopIgnored)));
    assert!(is_driven(&rig), "the word is not sent yet");
    let asked: Vec<CommandId> = STOPS
        .into_iter()
        .chain([Command::Halt])
        .map(|command| rig.send(command))
        .collect();
    assert_eq!(rig.word() & 0x0002, 0, "disable voltage");
    for id in asked {
        let off = Completion::Stopped {
            state: State::SwitchOnDisabled,
        };
        assert_eq!(rig.finish(id), Ok(off), "{id:?}");
    }
}

#[test]
fn one_that_gets_slower_or_stands_is_left_alone_until_the_deadline() {
    // It slows down to its target, because bit 8 still works, or because the target is near.
    let (mut rig, id) = moving(false);
    let halt = rig.send(Command::Halt);
    assert!(matches!(rig.finish(halt), Ok(Completion::Stopped { .. })));
    let stop = rig.send(Command::Stop);
    rig.run(5_000);
    assert!(is_driven(&rig), "it stands, held by its drive");
    assert_eq!(rig.outcome(stop), None);
    assert_eq!(rig.finish(stop), Err(Failure::QuickStopIgnored));
    rig.run(10);
    assert_eq!(rig.core.snapshot().state, State::SwitchOnDisabled);
    assert_eq!(rig.outcome(id), Some(Err(Failure::QuickStopIgnored)));
}

#[test]
fn a_halt_of_an_axis_that_takes_no_voltage_off_either_is_not_taken_back() {
    let (mut rig, _) = moving(true);
    let halt = rig.send(Command::Halt);
    assert!(matches!(rig.finish(halt), Ok(Completion::Stopped { .. })));
    // A drive under local control takes no orders at all.
    rig.drive.set_remote(false);
    let stop = rig.send(Command::Stop);
    assert_eq!(rig.finish(stop), Err(Failure::QuickStopIgnored));
    rig.run(3_000);
    let halted_to_the_end = rig.words.iter().rev().take(3_000);
    assert!(halted_to_the_end.into_iter().all(|word| word & 0x0100 != 0));
}

#[test]
fn one_that_goes_into_its_quick_stop_late_keeps_its_voltage_until_it_stands() {
    let behaviour = Behaviour {
        abort_connection_option: 3,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |_| {});
    rig.drive.set(0x6085, 0, 20_000).expect("a slow ramp");
    rig.enable();
    let id = rig.abs(600_000, SetPoint::new().velocity(10_000));
    rig.wait_accepted(id);
    rig.run(200);
    // It takes no orders, and then stops by itself.
    rig.drive.set_remote(false);
    let stop = rig.send(Command::QuickStop);
    assert_eq!(rig.finish(stop), Err(Failure::QuickStopIgnored));
    rig.drive.connection_lost();
    rig.drive.connection_restored();
    rig.run(10);
    assert_eq!(rig.drive.state(), ds402::State::QuickStopActive);
    rig.drive.set_remote(true);
    while rig.drive.velocity() > 0.0 {
        assert_ne!(rig.word() & 0x0002, 0, "disable voltage");
        rig.cycle();
    }
    rig.run(1_000);
    assert_eq!(rig.core.snapshot().state, State::SwitchOnDisabled);
}

/// It has not ignored what it has never got.
#[test]
fn an_axis_that_was_lost_for_longer_than_the_deadline_is_stopped_before_its_voltage_is_taken() {
    for latency in [0, 3] {
        let (mut rig, id) = moving(true);
        rig.latency = latency;
        rig.drive.disturbances().deaf_to_quick_stop = false;
        for _ in 0..12_000 {
            rig.cycle_over(Link::RequestLost);
        }
        assert!(matches!(
            rig.outcome(id),
            Some(Err(Failure::BusLost { .. }))
        ));
        assert!(rig.drive.velocity() > 0.0);
        while rig.drive.velocity() > 0.0 {
            rig.cycle();
            assert_ne!(rig.word() & 0x0002, 0, "disable voltage");
        }
    }
}

#[test]
fn a_disable_of_an_axis_that_is_being_switched_off_says_nothing_of_the_next_quick_stop() {
    let behaviour = Behaviour {
        quick_stop_option: 6,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |config| {
        config.quick_stop = QuickStopOption(6);
    });
    for round in 0..3 {
        rig.enable();
        let target = if round % 2 == 0 { 100_000 } else { 0 };
        let id = rig.abs(target, SetPoint::new());
        rig.wait_accepted(id);
        rig.run(50);
        let quick = rig.send(Command::QuickStop);
        let state = State::QuickStopActive;
        assert_eq!(
            rig.finish(quick),
            Ok(Completion::Stopped { state }),
            "{round}"
        );
        rig.enable();
        let id = rig.abs(target, SetPoint::new());
        rig.wait_accepted(id);
        rig.run(50);
        let first = rig.send(Command::Disable);
        rig.run_until(1_000, |rig| rig.word() & 0x0002 == 0);
        assert_eq!(rig.outcome(first), None);
        let second = rig.send(Command::Disable);
        for id in [first, second] {
            assert!(matches!(rig.finish(id), Ok(Completion::Stopped { .. })));
        }
    }
}
