//! Stops: halt and resume, stop, quick stop, disable, faults; drives that ignore them; an axis that is found moving.

use core::time::Duration;

use crate::common::{Link, Rig};
use servocrab::SetPoint;
use servocrab::coe::obj;
use servocrab::drives;
use servocrab::ds402::{Mode, QuickStopOption, State};
use servocrab::profile_velocity::JogSetPoint;
use servocrab::{
    Failure, StopRequest,
    axis::{Command, CommandId, Completion, Delivery, Event},
};
use servocrab_sim::ds402::{self, Behaviour, Plant};

#[test]
fn a_halt_keeps_the_set_point_and_resume_completes_it() {
    let mut rig = Rig::enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(200);
    let halt = rig.send(Command::Halt);
    assert_eq!(
        rig.finish(halt),
        Ok(Completion::Stopped {
            state: State::OperationEnabled
        })
    );
    assert_eq!(rig.drive.velocity(), 0.0);
    assert_eq!(rig.reports(id), [Event::Accepted, Event::Halted]);
    let refused = rig.abs(0, SetPoint::new());
    assert_eq!(
        rig.outcome(refused),
        Some(Err(Failure::Halted {
            delivery: Delivery::NotSent
        }))
    );
    rig.run(500);
    assert!(rig.outcome(id).is_none());
    let resume = rig.send(Command::Resume);
    rig.cycle();
    assert_eq!(rig.outcome(resume), Some(Ok(Completion::Done)));
    rig.assert_reached(id, 50_000);
    assert_eq!(rig.ledger().len(), 1);
}

/// The failure says whether bit 4 had gone out, and whether the drive had acknowledged it.
#[test]
fn a_move_that_is_stopped_says_how_far_its_set_point_came() {
    for (command, came) in [
        (Command::Stop, Delivery::NotSent),
        // The halt of a stop leaves the drive the time for its acknowledge.
        (Command::Stop, Delivery::Accepted),
        (Command::QuickStop, Delivery::NotSent),
        (Command::QuickStop, Delivery::Unknown),
        (Command::QuickStop, Delivery::Accepted),
    ] {
        let mut rig = Rig::enabled();
        let id = rig.abs(50_000, SetPoint::new());
        match came {
            Delivery::NotSent => {}
            Delivery::Unknown => {
                rig.run_until(10, |rig| rig.word() & 0x10 != 0);
                rig.run(1);
                assert!(!rig.accepted(id), "{command:?}");
            }
            Delivery::Accepted => rig.wait_accepted(id),
        }
        let stop = rig.send(command);
        assert!(rig.finish(stop).is_ok());
        let failure = Failure::QuickStopped { delivery: came };
        assert_eq!(rig.outcome(id), Some(Err(failure)), "{command:?} {came:?}");
    }
    let mut rig = Rig::enabled();
    let unsent = rig.abs(50_000, SetPoint::new());
    rig.send(Command::Halt);
    let delivery = Delivery::NotSent;
    assert_eq!(rig.outcome(unsent), Some(Err(Failure::Halted { delivery })));
}

#[test]
fn a_quick_stop_loses_the_set_point_and_enabling_again_moves_nothing() {
    let mut rig = Rig::enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(200);
    let stop = rig.send(Command::QuickStop);
    assert_eq!(
        rig.finish(stop),
        Ok(Completion::Stopped {
            state: State::SwitchOnDisabled
        })
    );
    assert_eq!(
        rig.outcome(id),
        Some(Err(Failure::QuickStopped {
            delivery: Delivery::Accepted
        }))
    );
    let stood = rig.drive.position();
    rig.enable();
    rig.run(500);
    assert_eq!(rig.drive.position(), stood);
}

/// With 605Ah = 6 the drive stays in Quick stop active. The deadline is shorter than its ramp.
#[test]
fn a_stop_that_lasts_too_long_ends_without_power() {
    let mut rig = Rig::new(Behaviour::akd2g(), |config| {
        config.quick_stop = QuickStopOption(6);
        config.deadlines.standstill = Duration::from_millis(200);
    });
    rig.drive.set(0x605A, 0, 6).unwrap();
    rig.drive.set(0x6085, 0, 50_000).unwrap();
    rig.enable();
    let id = rig.abs(500_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(300);
    let stop = rig.send(Command::QuickStop);
    let end = rig.finish(stop);
    assert!(matches!(end, Err(Failure::Timeout { .. })), "{end:?}");
    assert!(rig.moves());
    assert_eq!(rig.word(), 0);
    rig.run(2_000);
    assert!(!rig.moves());
    assert_eq!(rig.core.snapshot().state, State::SwitchOnDisabled);
}

#[test]
fn disabling_a_moving_axis_stops_it_and_a_standing_one_is_shut_down() {
    let mut rig = Rig::enabled();
    let off = rig.send(Command::Disable);
    assert_eq!(
        rig.finish(off),
        Ok(Completion::Stopped {
            state: State::ReadyToSwitchOn
        })
    );
    rig.enable();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(100);
    let off = rig.send(Command::Disable);
    assert!(matches!(
        rig.finish(off),
        Ok(Completion::Stopped {
            state: State::SwitchOnDisabled
        })
    ));
    assert!(matches!(
        rig.outcome(id),
        Some(Err(Failure::Disabled { .. }))
    ));
}

#[test]
fn a_fault_ends_the_move_and_its_reset_enables_nothing() {
    let mut rig = Rig::enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(100);
    rig.drive.inject_fault(0x7305);
    assert!(matches!(rig.finish(id), Err(Failure::Fault { .. })));
    rig.run(500);
    let refused = rig.send(Command::Enable);
    assert!(matches!(
        rig.outcome(refused),
        Some(Err(Failure::Fault { .. }))
    ));
    let reset = rig.send(Command::ResetFault);
    assert_eq!(
        rig.finish(reset),
        Ok(Completion::Stopped {
            state: State::SwitchOnDisabled
        })
    );
    let stood = rig.drive.position();
    rig.run(500);
    assert_eq!(rig.core.snapshot().state, State::SwitchOnDisabled);
    assert_eq!(rig.drive.position(), stood);
}

/// On its ramp of a fault reaction, with this deceleration.
fn in_a_fault_reaction(deceleration: u32) -> Rig {
    let mut rig = Rig::ideal_enabled();
    rig.drive.set(0x605E, 0, 1).expect("slow down");
    let fast = SetPoint::new()
        .velocity(1_000_000)
        .acceleration(100_000_000)
        .deceleration(deceleration);
    let id = rig.abs(i32::MAX, fast);
    rig.wait_accepted(id);
    rig.run(50);
    rig.drive.inject_fault(0x7305);
    rig.run(20);
    let state = rig.core.snapshot().state;
    assert_eq!(state, State::FaultReactionActive);
    rig
}

#[test]
fn a_drive_that_is_lost_in_its_fault_reaction_is_not_left_to_coast() {
    let mut rig = in_a_fault_reaction(1_000_000);
    let from = rig.words.len();
    for _ in 0..100 {
        rig.cycle_over(Link::ReplyLost);
    }
    let quick_stop = |word: u16| word & 0x06 == 0x02;
    assert!(rig.words[from..].iter().all(|word| word & 0x02 != 0));
    assert!(rig.moves() && quick_stop(rig.word()), "{:04X}", rig.word());
}

#[test]
fn a_resume_beside_a_stop_in_the_same_cycle_says_that_bit_8_did_not_fall() {
    let not_sent = Delivery::NotSent;
    let halted = Failure::Halted { delivery: not_sent };
    let stopped = Failure::QuickStopped { delivery: not_sent };
    for (lane, failure) in [
        (StopRequest::HALT, halted),
        (StopRequest::STOP, stopped),
        (StopRequest::QUICK_STOP, stopped),
    ] {
        for moves in [true, false] {
            let mut rig = Rig::ideal_enabled();
            if moves {
                let id = rig.abs(1_000_000, SetPoint::new());
                rig.wait_accepted(id);
                rig.run(100);
            }
            let halt = rig.send(Command::Halt);
            assert!(rig.finish(halt).is_ok());
            let resume = rig.send(Command::Resume);
            assert_eq!(rig.outcome(resume), None, "nothing is sent yet");
            rig.stop = lane;
            rig.cycle();
            let sent = rig.words.last().copied().unwrap_or_default();
            let falls = sent & 0x0104 == 0x0004;
            let expected = if falls {
                Ok(Completion::Done)
            } else {
                Err(failure)
            };
            assert_eq!(rig.finish(resume), expected, "{lane:?}, {moves}");
            // A stop of an axis that stands without a set-point is nothing that bit 8 would have to stay for.
            assert_eq!(falls, lane == StopRequest::STOP && !moves);
        }
    }
}

/// Cycles of 1 ms from bit 8 until it is known that it does nothing: until the drive has surely seen it, and twice 100 ms.
const NOTICED: usize = 206;

/// A drive that can be jogged. Its shaft is ideal: these are the figures of docs/motion.md.
fn ideal() -> Rig {
    let mut description = drives::akd2g();
    for axis in &mut description.axes {
        axis.outputs.push(obj::TARGET_VELOCITY.into());
    }
    let behaviour = Behaviour {
        profile_types: &[0, 1],
        plant: Plant::ideal(),
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::of(description, behaviour, |_| {});
    rig.enable();
    rig
}

fn mode(rig: &mut Rig, mode: Mode) {
    let id = rig.send(Command::SelectMode(mode));
    assert_eq!(rig.finish(id), Ok(Completion::Done));
}

/// A move of a minute at constant speed.
fn moving(rig: &mut Rig) -> CommandId {
    moving_with(rig, SetPoint::new())
}

fn moving_with(rig: &mut Rig, set_point: SetPoint) -> CommandId {
    let id = rig.abs(600_000, set_point.velocity(10_000));
    rig.wait_accepted(id);
    rig.run(200);
    id
}

fn is_quick_stop(word: u16) -> bool {
    word & 0x0006 == 0x0002
}

/// Cycles until the drive is told to quick stop, at most so many.
fn until_quick_stop(rig: &mut Rig, cycles: usize) -> usize {
    let from = rig.words.len();
    rig.run_until(cycles, |rig| {
        rig.words[from..].iter().any(|&w| is_quick_stop(w))
    });
    rig.words.len() - from
}

#[test]
fn a_stop_goes_on_to_its_quick_stop_as_soon_as_the_axis_is_known_to_run_on() {
    for command in [Command::Stop, Command::Disable] {
        let mut rig = ideal();
        let id = moving(&mut rig);
        rig.drive.disturbances().deaf_to_halt = true;
        let from = rig.words.len();
        let stop = rig.send(command);
        assert!(until_quick_stop(&mut rig, 300) <= NOTICED);
        assert_ne!(rig.words[from] & 0x0100, 0, "bit 8 came first");
        assert!(matches!(rig.finish(stop), Ok(Completion::Stopped { .. })));
        assert_eq!(rig.drive.velocity(), 0.0);
        assert!(rig.outcome(id).is_some_and(|end| end.is_err()));
    }
}

#[test]
fn a_jog_is_stopped_by_its_velocity_whatever_bit_8_does() {
    let mut rig = ideal();
    mode(&mut rig, Mode::ProfileVelocity);
    rig.send(Command::Jog(JogSetPoint::from(50_000).deceleration(50_000)));
    rig.run(500);
    rig.drive.disturbances().deaf_to_halt = true;
    let stop = rig.send(Command::Stop);
    let from = rig.words.len();
    while rig.drive.velocity() != 0.0 {
        rig.cycle();
        assert!(!is_quick_stop(*rig.words.last().unwrap()));
    }
    assert!(
        rig.words.len() - from > 900,
        "it takes its ramp of a second"
    );
    assert!(matches!(rig.finish(stop), Ok(Completion::Stopped { .. })));
}

#[test]
fn a_stop_on_a_ramp_waits_for_it_however_gentle_it_is() {
    for latency in [0, 5] {
        // Down from 10000 in 6 s, linear, and by a sin² ramp.
        for (profile_type, deceleration) in [(0, 1_600), (1, 2_500)] {
            let mut rig = ideal();
            rig.latency = latency;
            rig.drive.set(0x6086, 0, profile_type).unwrap();
            moving_with(&mut rig, SetPoint::new().deceleration(deceleration));
            let stop = rig.send(Command::Stop);
            // Slower than by its window in its settle time it stands.
            while rig.drive.velocity().abs() > 100.0 {
                rig.cycle();
                let word = rig.words[rig.words.len() - 1];
                assert!(!is_quick_stop(word), "{latency} {profile_type}");
            }
            assert!(matches!(rig.finish(stop), Ok(Completion::Stopped { .. })));
        }
    }
}

#[test]
fn a_halt_says_that_the_axis_runs_on_and_leaves_it_to_the_program() {
    let mut rig = ideal();
    let id = moving(&mut rig);
    rig.drive.disturbances().deaf_to_halt = true;
    let halt = rig.send(Command::Halt);
    rig.run(NOTICED);
    assert_eq!(rig.outcome(halt), Some(Err(Failure::HaltIgnored)));
    let from = rig.words.len();
    rig.run(1_000);
    assert!(rig.words[from..].iter().all(|&word| !is_quick_stop(word)));
    assert_eq!(rig.word() & 0x0100, 0x0100, "it stays asked for");
    // The next one need not find out again, and a stop neither.
    let again = rig.send(Command::Halt);
    rig.run(2);
    assert_eq!(rig.outcome(again), Some(Err(Failure::HaltIgnored)));
    let stop = rig.send(Command::Stop);
    assert!(until_quick_stop(&mut rig, 5) <= 3);
    assert!(matches!(rig.finish(stop), Ok(Completion::Stopped { .. })));
    assert_eq!(
        rig.outcome(id),
        Some(Err(Failure::QuickStopped {
            delivery: Delivery::Accepted
        }))
    );
}

#[test]
fn a_halt_that_nobody_waits_for_goes_on_to_a_quick_stop() {
    for halted_before in [false, true] {
        let mut rig = ideal();
        let id = moving(&mut rig);
        rig.drive.disturbances().deaf_to_halt = true;
        if halted_before {
            let halt = rig.send(Command::Halt);
            rig.run(NOTICED);
            assert_eq!(rig.outcome(halt), Some(Err(Failure::HaltIgnored)));
        }
        rig.stop = StopRequest::HALT;
        let noticed = if halted_before { 3 } else { NOTICED };
        assert!(until_quick_stop(&mut rig, 300) <= noticed);
        rig.run(1_000);
        assert_eq!(rig.drive.velocity(), 0.0);
        assert_eq!(
            rig.outcome(id),
            Some(Err(Failure::QuickStopped {
                delivery: Delivery::Accepted
            }))
        );
    }
}

#[test]
fn a_stop_ends_a_halt_with_nothing_kept_and_the_axis_moves_after_enable() {
    let mut rig = Rig::enabled();
    rig.run(300);
    let halt = rig.send(Command::Halt);
    rig.finish(halt).unwrap();
    let refused = rig.abs(1_000, SetPoint::new());
    assert_eq!(
        rig.finish(refused),
        Err(Failure::Halted {
            delivery: Delivery::NotSent
        })
    );
    let stop = rig.send(Command::Stop);
    rig.finish(stop).unwrap();
    rig.enable();
    let id = rig.abs(1_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.assert_reached(id, 1_000);
}

const STOPS: [Command; 4] = [
    Command::QuickStop,
    Command::Stop,
    Command::Disable,
    Command::Release,
];

fn is_driven(rig: &Rig) -> bool {
    rig.drive.state() == ds402::State::OperationEnabled
}

/// On its way, with a drive that takes no quick stop any more.
fn deaf_to_quick_stop() -> (Rig, CommandId) {
    let mut rig = ideal();
    let id = moving(&mut rig);
    rig.drive.disturbances().deaf_to_quick_stop = true;
    (rig, id)
}

#[test]
fn an_axis_that_runs_on_loses_its_voltage_and_whoever_waits_is_told() {
    for command in STOPS {
        let (mut rig, id) = deaf_to_quick_stop();
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

#[test]
fn one_that_gets_slower_or_stands_is_left_alone_until_the_deadline() {
    // It slows down to its target, because bit 8 still works, or because the target is near.
    let (mut rig, id) = deaf_to_quick_stop();
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

const QUICK_STOP: u16 = 0x000B;

/// A drive that is on its way to this target, and a core that has seen nothing of it.
fn stopping_by(option: i16) -> Rig {
    let behaviour = Behaviour {
        quick_stop_option: option,
        ..Behaviour::akd2g()
    };
    Rig::new(behaviour, |config| {
        config.quick_stop = QuickStopOption(option);
    })
}

/// A drive that is on its way to this target, and a core that has seen nothing of it.
fn found_on_the_way_to(target: i32, option: i16) -> Rig {
    let mut rig = stopping_by(option);
    // A quick stop of a fifth of a second.
    rig.drive.set(0x6085, 0, 200_000).unwrap();
    rig.enable();
    let id = rig.abs(target, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(150);
    assert!(rig.drive.velocity() > 10_000.0);
    let begun_anew = stopping_by(option);
    rig.core = begun_anew.core;
    rig.outputs = begun_anew.outputs;
    rig.words.clear();
    // The drive does not take outputs yet; nothing comes back either.
    rig.cycle_over(Link::RequestLost);
    rig
}

fn found(option: i16) -> Rig {
    found_on_the_way_to(1_000_000, option)
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
    for option in [1, 2, 5, 6] {
        let mut rig = found(option);
        run_without_coasting(&mut rig, 2_000);
        assert_eq!(rig.distinct_words(1), [QUICK_STOP, 0], "605Ah = {option}");
        assert_eq!(rig.drive.state(), ds402::State::SwitchOnDisabled);
    }
}

#[test]
fn whoever_stops_it_is_told_when_it_stands() {
    for option in [1, 2, 5, 6] {
        let held = match option {
            5 | 6 => State::QuickStopActive,
            _ => State::SwitchOnDisabled,
        };
        for (command, state) in [
            (Command::Stop, held),
            (Command::QuickStop, held),
            (Command::Halt, held),
            (Command::Release, held),
            (Command::Disable, State::SwitchOnDisabled),
        ] {
            let mut rig = found(option);
            rig.cycle();
            let id = rig.send(command);
            run_without_coasting(&mut rig, 10);
            assert_eq!(rig.outcome(id), None, "{command:?} waits");
            while rig.outcome(id).is_none() {
                run_without_coasting(&mut rig, 1);
            }
            assert!(rig.drive.stands(), "{command:?}, {option}");
            assert_eq!(rig.outcome(id), Some(Ok(Completion::Stopped { state })));
        }
    }
}

#[test]
fn an_enable_stops_it_first_and_no_motion_follows() {
    for option in [1, 2, 5, 6] {
        let mut rig = found(option);
        let id = rig.send(Command::Enable);
        run_without_coasting(&mut rig, 2_000);
        assert_eq!(rig.outcome(id), Some(Ok(Completion::Done)));
        assert_eq!(rig.drive.state(), ds402::State::OperationEnabled);
        assert!(rig.drive.stands());
    }
}
