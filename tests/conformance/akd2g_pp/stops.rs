//! "Controlword Bit 2" and "Controlword Bit 8".

use servocrab::SetPoint;
use servocrab::ds402::State as Shown;
use servocrab::{
    Failure,
    axis::{Command, CommandId, Completion, Delivery, Event},
};
use servocrab_sim::ds402::{Behaviour, Cause, Outcome, State};

use super::profile::akd2g;
use crate::bench::{DECELERATION, Drive, QUICK_STOP_DECELERATION, VELOCITY, assert_near};
use crate::common::Rig;

/// At full speed, bit 4 high.
fn cruising() -> Drive {
    let mut drive = akd2g();
    drive.start(0x0F, 20_000);
    drive.run(300);
    assert_near(drive.axis.velocity(), VELOCITY as f64);
    drive
}

/// The library's axis under way to 50 000, accepted.
fn under_way() -> (Rig, CommandId) {
    let mut rig = Rig::ideal_enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(200);
    (rig, id)
}

#[test]
pub(super) fn drive_stops_by_bit_2() {
    let mut drive = cruising();
    let status = drive.word(0x1B);
    assert_eq!(status & 0x6F, 0x07, "Quick stop active");
    drive.run(20);
    assert!(drive.axis.velocity() < 0.7 * VELOCITY as f64);
}

#[test]
pub(super) fn library_stops_by_bit_2() {
    let (mut rig, _) = under_way();
    let stop = rig.send(Command::QuickStop);
    assert_eq!(rig.word() & 0x04, 0, "in the outputs at once");
    assert!(matches!(rig.finish(stop), Ok(Completion::Stopped { .. })));
    assert_eq!(rig.drive.velocity(), 0.0);
}

#[test]
pub(super) fn drive_takes_the_quick_stop_ramp_from_605ah() {
    for (option, rate) in [
        (1, DECELERATION),
        (2, QUICK_STOP_DECELERATION),
        (5, DECELERATION),
        (6, QUICK_STOP_DECELERATION),
    ] {
        let mut drive = cruising();
        drive.set(0x605A, option);
        drive.word(0x1B);
        drive.run(20);
        assert_near(drive.axis.velocity(), VELOCITY as f64 - rate as f64 * 0.020);
    }
}

#[test]
pub(super) fn library_ends_a_quick_stop_where_605ah_leads() {
    for (option, state) in [(2, Shown::SwitchOnDisabled), (6, Shown::QuickStopActive)] {
        let behaviour = Behaviour {
            quick_stop_option: option,
            ..Behaviour::akd2g()
        };
        let mut rig = Rig::new(behaviour, |config| {
            config.quick_stop = servocrab::ds402::QuickStopOption(option);
        })
        .ideal();
        rig.enable();
        let id = rig.abs(50_000, SetPoint::new());
        rig.wait_accepted(id);
        rig.run(100);
        let stop = rig.send(Command::QuickStop);
        assert_eq!(rig.finish(stop), Ok(Completion::Stopped { state }));
        assert_eq!(rig.drive.velocity(), 0.0);
    }
}

#[test]
pub(super) fn drive_ends_a_quick_stop_at_velocity_zero() {
    let mut drive = cruising();
    drive.set(0x605A, 6);
    drive.word(0x1B);
    drive.run(100);
    assert_eq!(drive.get(0x606B), 0, "velocity demand");
    assert_eq!(drive.axis.velocity(), 0.0);
    assert!(!drive.moves());
    assert_eq!(drive.state(), State::QuickStopActive, "605Ah is 6");
}

#[test]
pub(super) fn library_reports_a_quick_stop_only_at_rest() {
    let (mut rig, id) = under_way();
    rig.drive.set(0x6085, 0, 200_000).expect("the ramp");
    let stop = rig.send(Command::QuickStop);
    rig.run(5);
    assert!(rig.drive.velocity() > 0.0);
    assert_eq!(rig.outcome(stop), None);
    assert!(rig.finish(stop).is_ok());
    assert_eq!(rig.drive.velocity(), 0.0);
    assert_eq!(
        rig.outcome(id),
        Some(Err(Failure::QuickStopped {
            delivery: Delivery::Accepted
        }))
    );
}

#[test]
pub(super) fn drive_forgets_the_set_point_in_a_quick_stop() {
    let mut drive = cruising();
    drive.set(0x605A, 6);
    drive.word(0x1B);
    drive.run(200);
    assert_eq!(drive.outcomes(), [Outcome::Discarded(Cause::QuickStop)]);
    drive.enable();
    assert!(!drive.moves());
    drive.word(0x1F);
    drive.settle();
    assert_eq!(drive.outcomes().len(), 2, "a new one, by a new edge");
}

#[test]
pub(super) fn library_moves_nothing_after_a_quick_stop() {
    let (mut rig, id) = under_way();
    let stop = rig.send(Command::QuickStop);
    assert!(rig.finish(stop).is_ok());
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
    assert_eq!(rig.ledger().len(), 1);
}

#[test]
pub(super) fn drive_leaves_a_quick_stop_through_the_state_machine_only() {
    let mut drive = cruising();
    drive.set(0x605A, 6);
    drive.word(0x1B);
    drive.run(200);
    for word in [0x0F, 0x1F, 0x06, 0x07] {
        drive.word(word);
        assert_eq!(drive.state(), State::QuickStopActive, "{word:02X}h");
    }
    for (word, state) in [
        (0x00, State::SwitchOnDisabled),
        (0x06, State::ReadyToSwitchOn),
        (0x07, State::SwitchedOn),
        (0x0F, State::OperationEnabled),
    ] {
        drive.word(word);
        assert_eq!(drive.state(), state);
    }
}

#[test]
pub(super) fn library_leaves_a_quick_stop_through_the_state_machine() {
    let behaviour = Behaviour {
        quick_stop_option: 6,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |config| {
        config.quick_stop = servocrab::ds402::QuickStopOption(6);
    })
    .ideal();
    rig.enable();
    let stop = rig.send(Command::QuickStop);
    assert!(rig.finish(stop).is_ok());
    assert_eq!(rig.drive.state(), State::QuickStopActive);
    let from = rig.words.len();
    rig.enable();
    assert_eq!(
        rig.distinct_words(from),
        [0x0B, 0x00, 0x06, 0x07, 0x0F],
        "step by step"
    );
}

#[test]
pub(super) fn drive_moves_with_bit_2_high() {
    let mut drive = cruising();
    for word in [0x1F, 0x0F, 0x0F] {
        let status = drive.word(word);
        assert_eq!(status & 0x6F, 0x27);
    }
    drive.settle();
    assert_eq!(drive.axis.position(), 20_000);
}

#[test]
pub(super) fn library_keeps_bit_2_high_in_a_move() {
    let mut rig = Rig::ideal_enabled();
    let from = rig.words.len();
    let id = rig.abs(50_000, SetPoint::new());
    assert!(rig.finish(id).is_ok());
    assert!(rig.words[from..].iter().all(|word| word & 0x04 != 0));
}

#[test]
pub(super) fn drive_pauses_by_bit_8() {
    let mut drive = cruising();
    drive.word(0x11F);
    drive.run(400);
    assert!(!drive.moves());
    assert_eq!(drive.state(), State::OperationEnabled);
}

#[test]
pub(super) fn library_pauses_by_bit_8() {
    let (mut rig, _) = under_way();
    let from = rig.words.len();
    let halt = rig.send(Command::Halt);
    assert_eq!(
        rig.finish(halt),
        Ok(Completion::Stopped {
            state: Shown::OperationEnabled
        })
    );
    assert_eq!(rig.distinct_words(from), [0x10F]);
    assert_eq!(rig.drive.velocity(), 0.0);
}

#[test]
pub(super) fn drive_halts_to_velocity_zero() {
    let mut drive = cruising();
    drive.word(0x11F);
    drive.run_until(1_000, |drive| drive.bit(10));
    assert_eq!(drive.get(0x606B), 0, "velocity demand");
    assert_eq!(drive.axis.velocity(), 0.0);
    assert!(drive.axis.position() < 20_000, "not at the target");
}

#[test]
pub(super) fn library_reports_a_halt_only_at_rest() {
    let (mut rig, id) = under_way();
    let halt = rig.send(Command::Halt);
    rig.run(20);
    assert!(rig.drive.velocity() > 0.0);
    assert_eq!(rig.outcome(halt), None);
    assert_eq!(rig.reports(id), [Event::Accepted]);
    assert!(rig.finish(halt).is_ok());
    assert_eq!(rig.drive.velocity(), 0.0);
    assert_eq!(rig.reports(id), [Event::Accepted, Event::Halted]);
}

#[test]
pub(super) fn drive_remembers_the_set_point_in_a_halt() {
    let mut drive = cruising();
    drive.word(0x11F);
    drive.run(2_000);
    assert_eq!(drive.outcomes(), [Outcome::Active]);
    drive.word(0x1F);
    drive.settle();
    assert_eq!(drive.axis.position(), 20_000);
    assert_eq!(drive.outcomes(), [Outcome::Reached], "the same one");
}

#[test]
pub(super) fn library_completes_a_halted_move_after_resume() {
    let (mut rig, id) = under_way();
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    rig.run(1_000);
    assert_eq!(rig.outcome(id), None);
    let resume = rig.send(Command::Resume);
    assert_eq!(rig.finish(resume), Ok(Completion::Done));
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 50_000 }));
    assert_eq!(rig.ledger().len(), 1, "no second set-point");
}

#[test]
pub(super) fn drive_resumes_whatever_bit_4_is() {
    for (halt, resume) in [(0x11F, 0x1F), (0x11F, 0x0F), (0x10F, 0x0F)] {
        let mut drive = cruising();
        drive.word(halt);
        drive.run(400);
        drive.word(resume);
        assert!(drive.moves(), "{resume:03X}h");
        drive.settle();
        assert_eq!(drive.axis.position(), 20_000);
        assert_eq!(drive.outcomes(), [Outcome::Reached]);
    }
}

#[test]
pub(super) fn library_resumes_without_bit_4() {
    let (mut rig, id) = under_way();
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    let from = rig.words.len();
    rig.send(Command::Resume);
    assert!(rig.finish(id).is_ok());
    assert_eq!(rig.distinct_words(from), [0x0F]);
}

#[test]
pub(super) fn drive_halts_by_6084h() {
    for deceleration in [DECELERATION, 2 * DECELERATION] {
        let mut drive = akd2g();
        drive.set(0x6084, deceleration);
        drive.start(0x0F, 20_000);
        drive.run(300);
        drive.word(0x11F);
        drive.run(50);
        assert_near(
            drive.axis.velocity(),
            VELOCITY as f64 - deceleration as f64 * 0.050,
        );
    }
}

#[test]
pub(super) fn library_waits_out_a_gentle_ramp() {
    let mut rig = Rig::ideal_enabled();
    let set_point = SetPoint::new().velocity(20_000).deceleration(10_000);
    let id = rig.abs(100_000, set_point);
    rig.wait_accepted(id);
    rig.run(500);
    let halt = rig.send(Command::Halt);
    rig.run(1_900);
    assert_eq!(rig.outcome(halt), None, "two seconds at 6084h");
    assert!(rig.finish(halt).is_ok());
    assert_eq!(rig.drive.velocity(), 0.0);
}

#[test]
pub(super) fn drive_moves_with_bit_8_low_only() {
    let mut drive = akd2g();
    drive.word(0x10F);
    drive.set(0x607A, 20_000);
    drive.word(0x11F);
    assert!(!drive.moves(), "1 pauses");
    drive.word(0x1F);
    assert!(drive.moves(), "0 allows");
}

#[test]
pub(super) fn library_refuses_a_move_while_halted() {
    let mut rig = Rig::ideal_enabled();
    let halt = rig.send(Command::Halt);
    assert!(rig.finish(halt).is_ok());
    let from = rig.words.len();
    let id = rig.abs(5_000, SetPoint::new());
    assert_eq!(
        rig.outcome(id),
        Some(Err(Failure::Halted {
            delivery: Delivery::NotSent
        }))
    );
    rig.run(100);
    assert_eq!(rig.distinct_words(from), [0x10F], "nothing was sent");
    rig.send(Command::Resume);
    let id = rig.abs(5_000, SetPoint::new());
    assert!(rig.finish(id).is_ok());
}
