//! A drive on which bit 8 does nothing: a stop does not wait for its deadline, and a halt says so.
#![allow(missing_docs)]

mod common;

use common::{Link, Rig};
use servocrab::axis::{Command, CommandId, Completion, Delivery, Failure, StopRequest};
use servocrab::coe::obj;
use servocrab::drives;
use servocrab::ds402::{Mode, State};
use servocrab::homing::{HomingCommand, HomingMethod};
use servocrab::profile_position::{SetPoint, WaitingFor};
use servocrab::profile_velocity::JogSetPoint;
use servocrab_sim::ds402::{Behaviour, Machine, Outcome, Plant};

/// Cycles of 1 ms from bit 8 until it is known that it does nothing: until the drive has surely seen it, and twice 100 ms.
const NOTICED: usize = 206;

/// A drive that can do all modes, with 606Ch or without. Its shaft is ideal: these are the figures of docs/motion.md.
fn rig(shows_velocity: bool) -> Rig {
    rig_on(Plant::ideal(), shows_velocity)
}

fn rig_on(plant: Plant, shows_velocity: bool) -> Rig {
    let mut description = drives::akd2g();
    for axis in &mut description.axes {
        axis.outputs.push(obj::TARGET_VELOCITY.into());
    }
    let behaviour = Behaviour {
        machine: Machine {
            positive_limit: Some(1_000_000),
            ..Machine::default()
        },
        profile_types: &[0, 1],
        plant,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::of(description, behaviour, |config| {
        if !shows_velocity {
            config.fields.actual_velocity = None;
        }
    });
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

/// A move that still speeds up.
fn speeding_up(rig: &mut Rig) -> CommandId {
    let id = rig.abs(900_000, SetPoint::new().acceleration(20_000));
    rig.wait_accepted(id);
    rig.run(200);
    id
}

fn homing(rig: &mut Rig) -> CommandId {
    rig.run(200);
    mode(rig, Mode::Homing);
    for (index, subindex, value) in [(0x6098, 0, 18), (0x6099, 1, 10_000), (0x6099, 2, 1_000)] {
        rig.drive.set(index, subindex, value).unwrap();
    }
    rig.drive.set(0x609A, 0, 100_000).unwrap();
    let id = rig.send(Command::Home(HomingCommand {
        method: HomingMethod(18),
        offset: None,
        until: None,
    }));
    rig.run(300);
    assert!(rig.drive.velocity() > 9_000.0);
    id
}

/// Sets the axis in motion.
type Begin = fn(&mut Rig) -> CommandId;

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
    for shows_velocity in [true, false] {
        // One that has just set off is slow, and each of its speeds takes longer to measure.
        let begun: [(Begin, usize); 3] = [
            (moving, NOTICED),
            (speeding_up, NOTICED + 25),
            (homing, NOTICED),
        ];
        for (begin, noticed) in begun {
            let mut rig = rig(shows_velocity);
            let id = begin(&mut rig);
            rig.drive.disturbances().deaf_to_halt = true;
            let stop = rig.send(Command::Stop);
            assert!(until_quick_stop(&mut rig, 300) <= noticed);
            assert!(
                rig.words.iter().any(|word| word & 0x0100 != 0),
                "bit 8 came first"
            );
            assert!(matches!(rig.finish(stop), Ok(Completion::Stopped { .. })));
            assert_eq!(rig.drive.velocity(), 0.0);
            assert_eq!(
                rig.outcome(id),
                Some(Err(Failure::QuickStopped {
                    delivery: Delivery::Accepted
                }))
            );
        }
    }
}

/// Its noise can make an axis that runs on look slower than in the span before: then a later span tells.
#[test]
fn an_axis_on_a_plant_is_known_to_run_on_within_some_spans() {
    let mut taken = Vec::new();
    for seed in 1..=24 {
        for shows_velocity in [true, false] {
            let mut rig = rig_on(Plant::seeded(seed), shows_velocity);
            let id = moving(&mut rig);
            rig.drive.disturbances().deaf_to_halt = true;
            let stop = rig.send(Command::Stop);
            taken.push(until_quick_stop(&mut rig, 3_000));
            assert!(matches!(rig.finish(stop), Ok(Completion::Stopped { .. })));
            assert!(matches!(
                rig.outcome(id),
                Some(Err(Failure::QuickStopped { .. }))
            ));
        }
    }
    taken.sort_unstable();
    assert!(taken[taken.len() / 2] < 500, "cycles: {taken:?}");
}

#[test]
fn a_disable_of_a_moving_axis_does_so_too() {
    let mut rig = rig(true);
    moving(&mut rig);
    rig.drive.disturbances().deaf_to_halt = true;
    let disable = rig.send(Command::Disable);
    assert!(until_quick_stop(&mut rig, 300) <= NOTICED);
    let off = Completion::Stopped {
        state: State::SwitchOnDisabled,
    };
    assert_eq!(rig.finish(disable), Ok(off));
}

#[test]
fn a_jog_is_stopped_by_its_velocity_whatever_bit_8_does() {
    let mut rig = rig(true);
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
    for shows_velocity in [true, false] {
        for latency in [0, 5] {
            // Down from 10000 in 8 s, linear, and by a sin² ramp.
            for (profile_type, deceleration) in [(0, 1_250), (1, 2_000)] {
                let mut rig = rig(shows_velocity);
                rig.latency = latency;
                rig.drive.set(0x6086, 0, profile_type).unwrap();
                let set_point = SetPoint::new().deceleration(deceleration);
                moving_with(&mut rig, set_point);
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
}

#[test]
fn a_halt_says_that_the_axis_runs_on_and_leaves_it_to_the_program() {
    let mut rig = rig(false);
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
    let is_over = |outcome: Outcome| matches!(outcome, Outcome::Discarded(_));
    assert!(is_over(rig.ledger()[0].outcome));
}

#[test]
fn what_one_halt_has_shown_is_not_taken_for_what_the_next_one_does() {
    let mut rig = rig(true);
    moving(&mut rig);
    rig.drive.disturbances().deaf_to_halt = true;
    let halt = rig.send(Command::Halt);
    assert_eq!(rig.finish(halt), Err(Failure::HaltIgnored));
    rig.drive.disturbances().deaf_to_halt = false;
    let resume = rig.send(Command::Resume);
    assert_eq!(rig.finish(resume), Ok(Completion::Done));
    let halt = rig.send(Command::Halt);
    assert!(matches!(rig.finish(halt), Ok(Completion::Stopped { .. })));
}

#[test]
fn an_axis_that_is_driven_slower_all_the_time_and_never_stands_is_stopped_at_the_deadline() {
    let mut rig = rig(true);
    moving_with(&mut rig, SetPoint::new().deceleration(500));
    let halt = rig.send(Command::Halt);
    assert!(matches!(
        rig.finish(halt),
        Err(Failure::Timeout {
            waiting_for: WaitingFor::Standstill(_),
            ..
        })
    ));
    let stop = rig.send(Command::Stop);
    // Lost frames alone show nothing.
    for _ in 0..300 {
        for _ in 0..4 {
            rig.cycle_over(Link::RequestLost);
        }
        rig.cycle();
        assert!(!is_quick_stop(*rig.words.last().unwrap()));
    }
    assert!(matches!(rig.finish(stop), Ok(Completion::Stopped { .. })));
}

#[test]
fn a_halt_that_nobody_waits_for_goes_on_to_a_quick_stop() {
    for halted_before in [false, true] {
        let mut rig = rig(false);
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
fn what_was_asked_for_before_a_resume_makes_no_quick_stop_of_the_next_halt() {
    let mut rig = rig(true);
    moving(&mut rig);
    rig.stop = StopRequest::HALT;
    rig.run(2_000);
    let resume = rig.send(Command::Resume);
    assert_eq!(rig.finish(resume), Ok(Completion::Done));
    rig.run(500);
    rig.drive.disturbances().deaf_to_halt = true;
    let halt = rig.send(Command::Halt);
    assert_eq!(rig.finish(halt), Err(Failure::HaltIgnored));
    let from = rig.words.len();
    rig.run(1_000);
    assert!(rig.words[from..].iter().all(|&word| !is_quick_stop(word)));
}
