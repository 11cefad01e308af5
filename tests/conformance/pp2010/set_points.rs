//! How set-points are handed over and processed.

use servocrab::coe::obj;
use servocrab::ds402::Statusword;
use servocrab::{BufferMode, SetPoint};
use servocrab::{
    Failure,
    axis::{Completion, Event, Unsupported},
};
use servocrab_sim::ds402::{Behaviour, Outcome, SetError};

use super::{drive, rig};
use crate::bench::{ACCELERATION, DECELERATION, Drive, VELOCITY, assert_near};
use crate::common::Rig;

fn after() -> SetPoint {
    SetPoint::new().buffer_mode(BufferMode::Buffered)
}

/// Under way to 10 000, with 20 000 behind it: two set-points, bit 4 low.
fn full() -> Drive {
    let mut drive = drive();
    drive.start(0x0F, 10_000);
    drive.lower();
    drive.start(0x0F, 20_000);
    drive.lower();
    drive
}

fn bit_12(rig: &Rig) -> bool {
    rig.statusword().contains(Statusword::SET_POINT_ACKNOWLEDGE)
}

#[test]
pub(super) fn drive_generates_the_demand_from_the_target() {
    let mut drive = Drive::enabled(Behaviour {
        actual_lag_cycles: 20,
        ..Behaviour::pp2010()
    });
    drive.start(0x0F, 10_000);
    drive.run(200);
    let (demand, actual) = (drive.get(0x6062), drive.get(0x6064));
    assert!(0 < actual && actual < demand && demand < 10_000);
    drive.run(20);
    assert_eq!(drive.get(0x6064), demand, "the position follows it");
    drive.settle();
    assert_eq!(drive.get(0x6062), 10_000);
}

#[test]
pub(super) fn drive_takes_set_points_by_bits_4_5_and_12_alone() {
    let mut drive = drive();
    drive.set(0x607A, 10_000);
    for word in [0x0F, 0x2F, 0x20F] {
        drive.word(word);
        assert!(!drive.moves());
        assert!(!drive.bit(12));
    }
    drive.word(0x0F);
    drive.word(0x1F);
    assert!(drive.bit(12));
    assert!(drive.moves());
    assert_eq!(drive.outcomes().len(), 1);
}

#[test]
pub(super) fn library_takes_bit_12_for_the_answer() {
    let mut rig = rig();
    rig.drive.disturbances().ack_delay_cycles = 40;
    let id = rig.abs(10_000, SetPoint::new());
    rig.run(30);
    assert_eq!(rig.ledger().len(), 1);
    assert_eq!(rig.reports(id), [], "no answer yet");
    rig.wait_accepted(id);
    assert_eq!(rig.reports(id), [Event::Accepted]);
}

#[test]
pub(super) fn drive_expects_one_set_point_with_bit_5() {
    let mut drive = drive();
    for target in [10_000, 5_000, -5_000] {
        drive.start(0x2F, target);
        drive.run(50);
    }
    assert_eq!(
        drive.outcomes(),
        [Outcome::Replaced, Outcome::Replaced, Outcome::Active],
        "one at a time"
    );
}

#[test]
pub(super) fn library_asks_for_a_single_set_point_with_bit_5() {
    let mut rig = rig();
    let id = rig.abs(10_000, SetPoint::new());
    assert!(rig.finish(id).is_ok());
    assert!(rig.words.contains(&0x3F));
    assert!(!rig.words.contains(&0x1F));
}

#[test]
pub(super) fn drive_expects_a_set_without_bit_5() {
    let mut drive = full();
    assert_eq!(
        drive.outcomes(),
        [Outcome::Active, Outcome::Queued],
        "both are there"
    );
    drive.settle();
    assert_eq!(drive.outcomes(), [Outcome::Reached; 2]);
}

#[test]
pub(super) fn library_asks_for_a_set_without_bit_5() {
    let mut rig = rig();
    let id = rig.abs(10_000, after());
    rig.wait_accepted(id);
    let second = rig.abs(20_000, after());
    rig.wait_accepted(second);
    assert!(rig.outcome(id).is_none(), "both are there");
    assert!(!rig.words.contains(&0x3F));
    assert_eq!(rig.ledger().len(), 2);
}

#[test]
pub(super) fn drive_takes_what_is_there_at_the_edge() {
    let mut drive = drive();
    drive.start(0x2F, 10_000);
    drive.set(0x607A, -10_000);
    drive.run(300);
    assert!(drive.axis.position() > 0, "valid was what came before");
    drive.settle();
    assert_eq!(drive.axis.position(), 10_000);
    assert_eq!(drive.outcomes().len(), 1);
}

#[test]
pub(super) fn library_raises_bit_4_with_the_target_there() {
    let mut rig = Rig::of(
        servocrab::drives::pp2010(),
        Behaviour {
            bit_4_filter_cycles: 4,
            ..Behaviour::pp2010()
        },
        |_| {},
    )
    .ideal();
    rig.enable();
    for target in [3_000, -7_000, 500] {
        let id = rig.abs(target, SetPoint::new());
        assert_eq!(rig.finish(id), Ok(Completion::Reached { position: target }));
        assert_eq!(rig.ledger().last().expect("a line").value, target);
    }
}

#[test]
pub(super) fn drive_acknowledges_a_set_point() {
    let mut drive = drive();
    assert!(!drive.bit(12));
    drive.start(0x2F, 10_000);
    assert!(drive.bit(12));
    drive.run(500);
    assert!(drive.bit(12), "until bit 4 falls");
}

#[test]
pub(super) fn library_holds_bit_4_until_the_acknowledge() {
    let mut rig = rig();
    rig.drive.disturbances().ack_delay_cycles = 100;
    let id = rig.abs(10_000, SetPoint::new());
    rig.wait_accepted(id);
    let high = rig.words.iter().filter(|word| **word & 0x10 != 0).count();
    assert!(high >= 100, "high for {high} cycles");
    assert!(rig.finish(id).is_ok());
}

#[test]
pub(super) fn drive_lowers_bit_12_when_it_can_take_another() {
    let mut drive = drive();
    drive.start(0x0F, 10_000);
    drive.lower();
    assert!(!drive.bit(12), "a second one can be taken at once");
    drive.start(0x0F, 20_000);
    drive.lower();
    assert!(drive.bit(12), "a third one cannot");
    drive.run_until(5_000, |drive| drive.outcomes()[0] == Outcome::Reached);
    drive.run(1);
    assert!(!drive.bit(12), "now it can");
}

#[test]
pub(super) fn library_sends_the_third_when_bit_12_is_low() {
    let mut rig = rig();
    let moves = [10_000, 20_000, 30_000].map(|target| rig.abs(target, after()));
    rig.wait_accepted(moves[1]);
    rig.run(5);
    let full = rig.words.len();
    rig.run_until(5_000, |rig| !bit_12(rig));
    let rises = rig.words[full..].iter().any(|word| word & 0x10 != 0);
    assert!(!rises, "not into a full buffer");
    assert_eq!(
        rig.finish(moves[2]),
        Ok(Completion::Reached { position: 30_000 })
    );
    assert_eq!(rig.ledger().len(), 3);
}

#[test]
pub(super) fn drive_processes_a_single_set_point_at_once() {
    let mut drive = drive();
    drive.start(0x2F, 10_000);
    drive.run(300);
    drive.start(0x2F, -10_000);
    drive.run(400);
    assert!(drive.axis.velocity() < 0.0, "it has turned round");
    let line = &drive.axis.ledger()[1];
    assert_eq!(line.started_at, Some(line.latched_at));
}

#[test]
pub(super) fn library_tells_a_single_set_point_that_it_is_superseded() {
    let mut rig = rig();
    let first = rig.abs(100_000, SetPoint::new());
    rig.wait_accepted(first);
    rig.run(100);
    let second = rig.abs(-10_000, SetPoint::new());
    rig.wait_accepted(second);
    assert_eq!(rig.outcome(first), Some(Err(Failure::Superseded)));
    assert_eq!(rig.ledger()[0].outcome, Outcome::Replaced);
}

#[test]
pub(super) fn drive_processes_a_set_in_order() {
    let mut drive = drive();
    drive.start(0x0F, 10_000);
    drive.run(300);
    drive.start(0x0F, 2_000);
    drive.run_until(5_000, |drive| drive.axis.ledger()[1].started_at.is_some());
    let ledger = drive.axis.ledger();
    assert_eq!(ledger[0].outcome, Outcome::Reached);
    assert_eq!(ledger[1].start_position, Some(10_000));
}

#[test]
pub(super) fn library_reports_a_set_in_order() {
    let mut rig = rig();
    let first = rig.abs(10_000, after());
    let second = rig.abs(2_000, after());
    assert_eq!(
        rig.finish(second),
        Ok(Completion::Reached { position: 2_000 })
    );
    let Some(Ok(Completion::Reached { position })) = rig.outcome(first) else {
        panic!("{:?}", rig.outcome(first));
    };
    assert!((position - 10_000).abs() <= 10, "{position}");
}

#[test]
pub(super) fn drive_holds_two_set_points() {
    let mut drive = full();
    drive.start(0x0F, 30_000);
    drive.lower();
    drive.settle();
    let ends: Vec<_> = drive.axis.ledger().iter().map(|line| line.value).collect();
    assert_eq!(ends, [10_000, 20_000], "a third is not taken");
}

#[test]
pub(super) fn library_waits_with_a_third_set_point() {
    let mut rig = rig();
    let slow = after().velocity(5_000);
    let moves = [10_000, 20_000, 30_000].map(|target| rig.abs(target, slow));
    rig.run(1_500);
    assert_eq!(rig.ledger().len(), 2);
    assert_eq!(rig.outcome(moves[2]), None, "however long the first takes");
    assert!(rig.finish(moves[2]).is_ok());
}

#[test]
pub(super) fn drive_replaces_a_full_buffer_with_bit_5() {
    let mut drive = full();
    drive.run(300);
    assert!(drive.bit(12), "all are busy");
    drive.start(0x2F, -5_000);
    assert_eq!(
        drive.outcomes(),
        [Outcome::Replaced, Outcome::Replaced, Outcome::Active]
    );
    drive.settle();
    assert_eq!(drive.axis.position(), -5_000);
}

#[test]
pub(super) fn library_replaces_a_full_buffer() {
    let mut rig = rig();
    let first = rig.abs(50_000, after());
    let second = rig.abs(60_000, after());
    rig.wait_accepted(second);
    rig.run(100);
    assert!(bit_12(&rig), "all are busy");
    let third = rig.abs(-10_000, SetPoint::new());
    assert_eq!(
        rig.finish(third),
        Ok(Completion::Reached { position: -10_000 })
    );
    for replaced in [first, second] {
        assert_eq!(rig.outcome(replaced), Some(Err(Failure::Superseded)));
    }
    let outcomes: Vec<_> = rig.ledger().iter().map(|line| line.outcome).collect();
    assert_eq!(
        outcomes,
        [Outcome::Replaced, Outcome::Replaced, Outcome::Reached]
    );
}

#[test]
pub(super) fn drive_has_bit_10_low_until_all_are_processed() {
    let mut drive = full();
    drive.run_until(10_000, |drive| {
        let done = drive.outcomes() == [Outcome::Reached; 2];
        assert!(done || !drive.bit(10), "{}", drive.axis.position());
        done
    });
    drive.run(2);
    assert!(drive.bit(10));
}

#[test]
pub(super) fn library_needs_no_bit_10_for_the_first_of_two() {
    let mut rig = rig();
    let first = rig.abs(10_000, after());
    let second = rig.abs(30_000, after());
    rig.run_until(5_000, |rig| rig.outcome(first).is_some());
    assert!(matches!(
        rig.outcome(first),
        Some(Ok(Completion::Reached { .. }))
    ));
    assert!(rig.drive.position() < 11_000, "it is told at once");
    assert_eq!(rig.outcome(second), None);
    assert!(rig.finish(second).is_ok());
}

#[test]
pub(super) fn drive_has_linear_ramps_only() {
    let mut drive = drive();
    for kind in [1, 2, -1, 32_767, -32_768] {
        assert_eq!(drive.axis.set(0x6086, 0, kind), Err(SetError::OutOfRange));
    }
    drive.set(0x6086, 0);
    drive.start(0x2F, 20_000);
    for tenth in 1..=9 {
        drive.run(10);
        let expected = ACCELERATION as f64 * f64::from(tenth) * 0.010;
        assert_near(drive.axis.velocity(), expected);
    }
}

#[test]
pub(super) fn library_refuses_other_ramps() {
    let mut description = servocrab::drives::pp2010();
    description.axes[0]
        .outputs
        .push(obj::MOTION_PROFILE_TYPE.into());
    let mut rig = Rig::of(description, Behaviour::pp2010(), |_| {}).ideal();
    rig.enable();
    let refused = rig.abs(5_000, SetPoint::new().profile_type(1));
    assert!(matches!(
        rig.outcome(refused),
        Some(Err(Failure::Unsupported(Unsupported::ProfileType {
            profile_type: 1,
            ..
        })))
    ));
    let id = rig.abs(5_000, SetPoint::new().profile_type(0));
    assert!(rig.finish(id).is_ok());
    assert_eq!(rig.ledger().len(), 1);
}

#[test]
pub(super) fn drive_has_a_ramp_up_and_a_ramp_down() {
    let mut drive = drive();
    drive.start(0x2F, 20_000);
    drive.run(50);
    assert_near(drive.axis.velocity(), ACCELERATION as f64 * 0.05);
    drive.run_until(5_000, |drive| drive.axis.position() >= 18_900);
    assert_near(drive.axis.velocity(), VELOCITY as f64);
    drive.run_until(5_000, |drive| drive.axis.position() >= 19_750);
    assert_near(
        drive.axis.velocity(),
        (2.0 * DECELERATION as f64 * 250.0).sqrt(),
    );
}

#[test]
pub(super) fn library_sends_a_ramp_up_and_a_ramp_down() {
    let mut rig = rig();
    let set_point = SetPoint::new().acceleration(60_000).deceleration(70_000);
    let id = rig.abs(20_000, set_point);
    assert!(rig.finish(id).is_ok());
    let line = &rig.ledger()[0];
    assert_eq!((line.acceleration, line.deceleration), (60_000, 70_000));
}
