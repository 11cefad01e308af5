//! Pitfalls 14 to 19: halt, quick stop, and how soon they are sent.

use servocrab::SetPoint;
use servocrab::ds402::{Mode, QuickStopOption, State};
use servocrab::{
    Failure, StopRequest,
    axis::{Command, CommandId, Completion, Delivery},
};
use servocrab_sim::ds402::{Behaviour, Outcome};

use crate::common::Rig;
use crate::{BIT_4, BIT_7, BIT_8, enabled, rises};

/// Whether a word stops or releases the axis: disable voltage or quick stop.
fn quick_stops(word: u16) -> bool {
    word & 0x0006 != 0x0006
}

/// An AKD2G with an accepted move under way.
fn moving() -> (Rig, CommandId) {
    let mut rig = Rig::enabled();
    let id = is_moving(&mut rig);
    (rig, id)
}

/// A move that has been accepted, and is under way.
fn is_moving(rig: &mut Rig) -> CommandId {
    let id = rig.abs(1_000_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(200);
    id
}

/// A quick stop after which the drive holds.
fn quick_stop_holds(rig: &mut Rig) {
    let stop = rig.send(Command::QuickStop);
    let held = Completion::Stopped {
        state: State::QuickStopActive,
    };
    assert_eq!(rig.finish(stop), Ok(held));
}

/// It moves again.
fn is_back_at_0(rig: &mut Rig) {
    let back = rig.abs(0, SetPoint::new());
    rig.assert_reached(back, 0);
}

#[test]
fn pitfall_14_resume_releases_the_halt() {
    let (mut rig, id) = moving();
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    let resume = rig.send(Command::Resume);
    assert_eq!(rig.finish(resume), Ok(Completion::Done));
    rig.run(2);
    assert_eq!(rig.word() & BIT_8, 0);
    rig.assert_reached(id, 1_000_000);
}

#[test]
fn pitfall_14_after_a_stop_the_axis_is_enabled_without_bit_8() {
    let (mut rig, _) = moving();
    let stop = rig.send(Command::Stop);
    assert!(rig.finish(stop).is_ok());
    let from = rig.words.len();
    rig.enable();
    is_back_at_0(&mut rig);
    assert!(rig.words[from + 1..].iter().all(|word| word & BIT_8 == 0));
}

#[test]
fn pitfall_15_a_halt_is_bit_8_and_keeps_state_and_set_point() {
    let (mut rig, id) = moving();
    let from = rig.words.len();
    let halt = rig.send(Command::Halt);
    assert_eq!(
        rig.finish(halt),
        Ok(Completion::Stopped {
            state: State::OperationEnabled
        })
    );
    rig.run(100);
    assert_eq!(rig.distinct_words(from), [0x10F]);
    assert_eq!(rig.ledger()[0].outcome, Outcome::Active);
    assert_eq!(rig.outcome(id), None);
}

#[test]
fn pitfall_16_no_mode_change_is_tried_while_bit_8_is_set() {
    let mut rig = enabled(|drive| drive.halt_blocks_mode_change = true);
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    let refused = rig.send(Command::SelectMode(Mode::Homing));
    assert_eq!(
        rig.outcome(refused),
        Some(Err(Failure::Halted {
            delivery: Delivery::NotSent
        }))
    );
    let resume = rig.send(Command::Resume);
    assert!(rig.finish(resume).is_ok());
    let change = rig.send(Command::SelectMode(Mode::Homing));
    assert_eq!(rig.finish(change), Ok(Completion::Done));
    assert_eq!(rig.mode(), Mode::Homing);
}

#[test]
fn pitfall_17_no_sequencing_of_the_same_cycle_cancels_a_quick_stop() {
    // From the first word of enabling to the middle of a move's handshake.
    for cycle in 1..40 {
        let mut rig = enabled(|drive| drive.power_on_cycles = 3);
        let disable = rig.send(Command::Disable);
        assert!(rig.finish(disable).is_ok());
        rig.drive.disturbances().ack_delay_cycles = 5;
        let enable = rig.send(Command::Enable);
        let mut id = None;
        for _ in 0..cycle {
            rig.cycle();
            if id.is_none() && rig.outcome(enable).is_some() {
                id = Some(rig.abs(100_000, SetPoint::new()));
            }
        }
        rig.stop = StopRequest::QUICK_STOP;
        let from = rig.words.len();
        rig.run(300);
        assert!(
            rig.words[from..].iter().all(|&word| quick_stops(word)),
            "stopped after cycle {cycle}: {:x?}",
            rig.distinct_words(from)
        );
        assert_eq!(rig.core.snapshot().state, State::SwitchOnDisabled);
    }
}

#[test]
fn pitfall_17_quick_stop_active_is_left_by_enabling() {
    for transition_16 in [false, true] {
        let behaviour = Behaviour {
            transition_16,
            quick_stop_option: 6,
            ..Behaviour::akd2g()
        };
        let mut rig = Rig::new(behaviour, |config| config.quick_stop = QuickStopOption(6));
        rig.enable();
        is_moving(&mut rig);
        quick_stop_holds(&mut rig);
        let stood = rig.drive.position();
        rig.run(100);
        assert_eq!(rig.core.snapshot().state, State::QuickStopActive);
        let enable = rig.send(Command::Enable);
        assert_eq!(rig.finish(enable), Ok(Completion::Done));
        rig.run(100);
        rig.assert_at(stood);
        is_back_at_0(&mut rig);
    }
}

#[test]
fn pitfall_18_a_quick_stop_in_fault_resets_nothing() {
    let (mut rig, _) = moving();
    rig.drive.inject_fault(0x7305);
    rig.run_until(2_000, |rig| rig.core.snapshot().state == State::Fault);
    let from = rig.words.len();
    let stop = rig.send(Command::QuickStop);
    assert!(matches!(rig.finish(stop), Err(Failure::Fault { .. })));
    rig.stop = StopRequest::QUICK_STOP;
    rig.run(500);
    assert!(rig.words[from..].iter().all(|word| word & BIT_7 == 0));
    assert_eq!(rig.core.snapshot().state, State::Fault);
}

#[test]
fn pitfall_18_a_quick_stop_enables_nothing() {
    let mut rig = Rig::akd2g();
    rig.run(10);
    let stop = rig.send(Command::QuickStop);
    assert_eq!(
        rig.finish(stop),
        Ok(Completion::Stopped {
            state: State::SwitchOnDisabled
        })
    );
    rig.stop = StopRequest::QUICK_STOP;
    rig.run(100);
    assert!(rig.words.iter().all(|&word| quick_stops(word)));
    assert_eq!(rig.core.snapshot().state, State::SwitchOnDisabled);
}

#[test]
fn pitfall_19_a_stop_is_in_the_next_frame_whatever_the_handshake_waits_for() {
    for (stop, on_the_wire) in [
        (StopRequest::HALT, BIT_8),
        (StopRequest::STOP, BIT_8),
        (StopRequest::QUICK_STOP, 0),
    ] {
        let mut rig = Rig::enabled();
        rig.drive.disturbances().ack_delay_cycles = 400;
        rig.abs(1_000_000, SetPoint::new());
        rig.abs(0, SetPoint::new());
        rig.run(100);
        assert_ne!(rig.word() & BIT_4, 0, "the handshake is under way");
        let from = rig.words.len();
        rig.stop = stop;
        rig.cycle();
        let word = rig.words[from];
        assert_eq!(word & BIT_8, on_the_wire, "{stop:?}: {word:#06x}");
        assert_eq!(quick_stops(word), on_the_wire == 0, "{word:#06x}");
        rig.run(200);
        assert_eq!(rig.drive.velocity(), 0.0);
    }
}

#[test]
fn pitfall_19_a_stop_command_is_in_the_next_outputs_whatever_waits() {
    for command in [Command::Halt, Command::Stop, Command::QuickStop] {
        let mut rig = Rig::enabled();
        rig.drive.disturbances().ack_delay_cycles = 400;
        rig.abs(1_000_000, SetPoint::new());
        rig.abs(0, SetPoint::new());
        rig.run(100);
        let stop = rig.send(command);
        rig.run(2);
        let word = rig.words[rig.words.len() - 1];
        assert!(
            quick_stops(word) || word & BIT_8 != 0,
            "{command:?}: {word:#06x}"
        );
        assert!(rig.finish(stop).is_ok());
        assert_eq!(rig.drive.velocity(), 0.0);
        assert_eq!(rig.ledger().len(), 1, "what waited was not sent");
    }
}

#[test]
fn pitfall_19_a_stop_withdraws_a_set_point_that_has_not_been_sent() {
    for stop in [
        StopRequest::HALT,
        StopRequest::STOP,
        StopRequest::QUICK_STOP,
    ] {
        let mut rig = Rig::enabled();
        let id = rig.abs(10_000, SetPoint::new());
        rig.run_until(20, |rig| rig.word() & BIT_4 != 0);
        assert_eq!(rises(&rig.words, BIT_4), 0, "composed and not sent");
        rig.stop = stop;
        rig.run(500);
        assert_eq!(rises(&rig.words, BIT_4), 0);
        assert!(rig.ledger().is_empty());
        assert!(matches!(
            rig.outcome(id),
            Some(Err(Failure::Halted { .. } | Failure::QuickStopped { .. }))
        ));
    }
}

#[test]
fn pitfall_19_a_resume_does_not_take_back_a_halt_that_was_not_sent_yet() {
    let (mut rig, id) = moving();
    // While it moves, and while it is halted already.
    for _ in 0..2 {
        // Two programs, in the time of one cycle.
        let halt = rig.send(Command::Halt);
        let resume = rig.send(Command::Resume);
        assert_eq!(rig.outcome(resume), Some(Err(Failure::Busy)));
        rig.cycle();
        assert_eq!(rig.words.last().map(|word| word & BIT_8), Some(BIT_8));
        assert!(rig.finish(halt).is_ok());
    }
    let resume = rig.send(Command::Resume);
    assert_eq!(rig.finish(resume), Ok(Completion::Done));
    assert!(rig.finish(id).is_ok());
}

#[test]
fn pitfall_17_a_quick_stop_whose_drive_stays_where_605ah_does_not_say_is_left_all_the_same() {
    // Somebody has changed 605Ah since it was read.
    let mut rig = Rig::new(
        Behaviour {
            quick_stop_option: 6,
            ..Behaviour::akd2g()
        },
        |config| config.quick_stop = QuickStopOption(2),
    );
    rig.enable();
    let id = is_moving(&mut rig);
    quick_stop_holds(&mut rig);
    assert_eq!(
        rig.outcome(id),
        Some(Err(Failure::QuickStopped {
            delivery: Delivery::Accepted
        }))
    );
    rig.enable();
    is_back_at_0(&mut rig);
}

#[test]
fn pitfall_19_an_enable_does_not_go_on_where_a_stop_has_just_ended_another() {
    let mut rig = Rig::new(
        Behaviour {
            power_on_cycles: 20,
            ..Behaviour::akd2g()
        },
        |_| {},
    );
    let first = rig.send(Command::Enable);
    rig.run_until(100, |rig| rig.core.snapshot().state == State::SwitchedOn);
    let stop = rig.send(Command::QuickStop);
    let second = rig.send(Command::Enable);
    assert_eq!(
        rig.outcome(first),
        Some(Err(Failure::QuickStopped {
            delivery: Delivery::NotSent
        }))
    );
    assert!(rig.outcome(stop).is_some());
    assert_eq!(rig.outcome(second), Some(Err(Failure::Busy)));
    rig.cycle();
    assert_eq!(rig.words.last(), Some(&0), "voltage disabled");
    rig.enable();
}

#[test]
fn pitfall_19_an_enable_is_refused_only_where_it_would_take_a_stop_back() {
    // Of an axis that is off there is nothing to stop.
    let mut rig = Rig::new(Behaviour::akd2g(), |_| {});
    rig.run(50);
    for stop in [Command::Halt, Command::Stop, Command::QuickStop] {
        let stop = rig.send(stop);
        assert!(matches!(rig.outcome(stop), Some(Ok(_))));
    }
    let enable = rig.send(Command::Enable);
    assert_eq!(rig.finish(enable), Ok(Completion::Done));
    // One that is enabled stays so, and halts all the same.
    let halt = rig.send(Command::Halt);
    let enable = rig.send(Command::Enable);
    assert_eq!(rig.outcome(enable), Some(Ok(Completion::Done)));
    rig.cycle();
    assert_eq!(rig.words.last().map(|word| word & BIT_8), Some(BIT_8));
    assert!(rig.finish(halt).is_ok());
}
