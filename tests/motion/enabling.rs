//! Enabling a drive that waits for its supply, is inhibited, is under local control, or takes its time: `enable` waits and
//! goes on by itself, or refuses with that reason; and what it gave up is not done later.

use crate::common::Rig;
use servocrab::SetPoint;
use servocrab::ds402::{Controlword, State, Statusword};
use servocrab::{
    Failure,
    axis::{Command, Completion, Inhibit, WaitingFor},
};
use servocrab_sim::ds402::{self, Behaviour};

/// Cycles within which `enable` gives up: its deadline, and some more.
const DEADLINE: usize = 5_100;

/// A condition that keeps a drive from being enabled, and how it ends.
struct Obstacle {
    name: &'static str,
    behaviour: Behaviour,
    /// Whether the library is told that bit 4 of the statusword means something.
    shows_voltage: bool,
    set: fn(&mut ds402::Axis),
    clear: fn(&mut ds402::Axis),
    /// Without the words of it.
    refusal: Failure,
}

fn refused(by: Inhibit, state: State) -> Failure {
    Failure::EnableRefused {
        by,
        state,
        statusword: Statusword::empty(),
        controlword: Controlword::empty(),
    }
}

/// Takes the words out of such a failure.
fn take_words(failure: &mut Failure) -> (Statusword, Controlword) {
    let Failure::EnableRefused {
        statusword,
        controlword,
        ..
    } = failure
    else {
        panic!("{failure}");
    };
    let none = (Statusword::empty(), Controlword::empty());
    (
        core::mem::replace(statusword, none.0),
        core::mem::replace(controlword, none.1),
    )
}

fn obstacles() -> Vec<Obstacle> {
    let drives = [
        Behaviour::akd2g(),
        Behaviour::ax2000(),
        Behaviour::sigma7(),
        Behaviour::generic(),
    ];
    let mut obstacles = Vec::new();
    for behaviour in drives {
        obstacles.push(Obstacle {
            name: "local control",
            behaviour: behaviour.clone(),
            shows_voltage: false,
            set: |drive| drive.set_remote(false),
            clear: |drive| drive.set_remote(true),
            refusal: refused(Inhibit::LocalControl, State::SwitchOnDisabled),
        });
        obstacles.push(Obstacle {
            name: "safe torque off",
            behaviour: behaviour.clone(),
            shows_voltage: false,
            set: |drive| drive.set_inhibited(true),
            clear: |drive| drive.set_inhibited(false),
            refusal: refused(Inhibit::Unnamed, State::ReadyToSwitchOn),
        });
        for ready_needs_voltage in [false, true] {
            for shows_voltage in [false, true] {
                let state = if ready_needs_voltage {
                    State::SwitchOnDisabled
                } else {
                    State::ReadyToSwitchOn
                };
                let inhibit = if shows_voltage {
                    Inhibit::NoVoltage
                } else {
                    Inhibit::Unnamed
                };
                obstacles.push(Obstacle {
                    name: "no supply",
                    behaviour: Behaviour {
                        ready_needs_voltage,
                        ..behaviour.clone()
                    },
                    shows_voltage,
                    set: |drive| drive.set_voltage(false),
                    clear: |drive| drive.set_voltage(true),
                    refusal: refused(inhibit, state),
                });
            }
        }
    }
    obstacles
}

impl Obstacle {
    /// A rig whose drive has the obstacle from the start.
    fn rig(&self) -> Rig {
        let mut rig = Rig::new(self.behaviour.clone(), |config| {
            config.traits.shows_voltage = self.shows_voltage;
        });
        rig.run(5);
        (self.set)(&mut rig.drive);
        rig.run(5);
        rig
    }
}

#[test]
fn enable_waits_for_what_is_missing_and_goes_on_when_it_is_there() {
    for obstacle in obstacles() {
        let mut rig = obstacle.rig();
        let id = rig.send(Command::Enable);
        rig.run(1_000);
        assert_eq!(rig.outcome(id), None, "{}: it waits", obstacle.name);
        assert!(rig.drive.state() != ds402::State::OperationEnabled);
        let switched_on = rig.words.iter().any(|word| word & 0x000F == 0x0007);
        assert!(
            !(switched_on && obstacle.shows_voltage),
            "{}: shows no voltage, and is switched on",
            obstacle.name
        );
        (obstacle.clear)(&mut rig.drive);
        assert_eq!(rig.finish(id), Ok(Completion::Done), "{}", obstacle.name);
        assert_eq!(rig.drive.state(), ds402::State::OperationEnabled);
        assert!(rig.ledger().is_empty(), "and nothing moves");
    }
}

#[test]
fn enable_gives_up_with_the_reason_and_does_not_come_back_to_it() {
    for obstacle in obstacles() {
        let mut rig = obstacle.rig();
        let id = rig.send(Command::Enable);
        rig.run(DEADLINE);
        let Some(Err(mut failure)) = rig.outcome(id) else {
            panic!("{}: {:?}", obstacle.name, rig.outcome(id));
        };
        let (seen, sent) = take_words(&mut failure);
        assert_eq!(failure, obstacle.refusal, "{}", obstacle.name);
        let Failure::EnableRefused { state, .. } = failure else {
            panic!("{failure}");
        };
        assert_eq!(seen.state(), state, "{}", obstacle.name);
        // Shutdown or Switch on.
        assert!(
            matches!(sent.bits(), 0x06 | 0x07),
            "{}: {sent}",
            obstacle.name
        );
        assert!(seen.contains(Statusword::READY_TO_SWITCH_ON) || sent.bits() == 0x06);
        assert_eq!(rig.word(), 0, "nothing is commanded any more");
        let refused = rig.abs(5_000, SetPoint::new());
        assert!(matches!(
            rig.outcome(refused),
            Some(Err(Failure::NotEnabled { .. }))
        ));
        (obstacle.clear)(&mut rig.drive);
        rig.run(1_000);
        assert_eq!(
            rig.drive.state(),
            ds402::State::SwitchOnDisabled,
            "{}: nobody has asked again",
            obstacle.name
        );
        rig.enable();
    }
}

#[test]
fn a_stop_or_disable_in_the_middle_of_an_enable_is_done_when_the_drive_will_not_be_enabled() {
    for command in [Command::Stop, Command::Disable] {
        for wait in 0..20 {
            let mut rig = Rig::akd2g();
            rig.run(120);
            let enable = rig.send(Command::Enable);
            rig.run(wait);
            let id = rig.send(command);
            // A stop of an axis that is enabled by now leaves it so.
            if command == Command::Stop && rig.outcome(enable) == Some(Ok(Completion::Done)) {
                break;
            }
            let ended = rig.finish(id);
            let enabled = ds402::State::OperationEnabled;
            for _ in 0..20 {
                assert_ne!(rig.drive.state(), enabled, "{command:?} {wait}: {ended:?}");
                rig.cycle();
            }
        }
    }
}

#[test]
fn a_power_section_that_takes_its_time_is_waited_for() {
    let slow = |power_on_cycles| Behaviour {
        power_on_cycles,
        ..Behaviour::generic()
    };
    let mut rig = Rig::new(slow(3_000), |_| {});
    let id = rig.send(Command::Enable);
    assert_eq!(rig.finish(id), Ok(Completion::Done));

    let mut rig = Rig::new(slow(30_000), |_| {});
    let id = rig.send(Command::Enable);
    assert!(matches!(
        rig.finish(id),
        Err(Failure::Timeout {
            waiting_for: WaitingFor::State(State::OperationEnabled),
            ..
        })
    ));
    rig.run(5);
    assert_eq!(rig.drive.state(), ds402::State::SwitchOnDisabled);
}
