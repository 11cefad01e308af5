//! "Functional Description": single set-points and sets of set-points, bits 4, 5 and 12.

use servocrab::ds402::Statusword;
use servocrab::{BufferMode, SetPoint};
use servocrab::{
    Failure,
    axis::{Completion, Unsupported},
};
use servocrab_sim::ds402::Outcome;

use super::{drive, rig};
use crate::bench::{Drive, VELOCITY, assert_near};
use crate::common::Rig;

fn after() -> SetPoint {
    SetPoint::new().buffer_mode(BufferMode::Buffered)
}

fn blend() -> SetPoint {
    SetPoint::new().buffer_mode(BufferMode::Blending)
}

/// Under way to 10 000 as the first of a set, bit 4 low.
fn to_10_000() -> Drive {
    let mut drive = drive();
    drive.start(0x2F, 10_000);
    drive.run(300);
    drive.lower();
    drive
}

/// The slowest that the axis is on the last 500 counts before 10 000 and the first 500 behind.
fn slowest_at_10_000(drive: &mut Drive) -> f64 {
    drive.run_until(5_000, |drive| drive.axis.position() > 9_500);
    drive
        .speeds_while(|drive| {
            let position = drive.axis.position();
            position < 10_500 && (position < 10_000 || drive.axis.velocity() > 0.0)
        })
        .0
}

#[test]
pub(super) fn drive_goes_on_through_a_target_of_a_set() {
    let mut drive = to_10_000();
    drive.set(0x607A, 20_000);
    drive.word(0x3F);
    assert_near(slowest_at_10_000(&mut drive), VELOCITY as f64);
    drive.settle();
    assert_eq!(drive.outcomes(), [Outcome::Passed, Outcome::Reached]);
    let ledger = drive.axis.ledger();
    assert_eq!(ledger[0].ended_at, ledger[1].started_at, "immediately");
}

#[test]
pub(super) fn library_blends_by_a_set() {
    let mut rig = rig();
    let first = rig.abs(20_000, blend());
    rig.wait_accepted(first);
    let second = rig.abs(40_000, blend());
    assert_eq!(
        rig.finish(second),
        Ok(Completion::Reached { position: 40_000 })
    );
    assert!(matches!(
        rig.outcome(first),
        Some(Ok(Completion::Passed { .. }))
    ));
    assert_eq!(rig.ledger()[0].outcome, Outcome::Passed);
}

#[test]
pub(super) fn drive_stops_between_with_sin2_ramps() {
    let mut drive = drive();
    drive.set(0x6086, 1);
    drive.start(0x2F, 10_000);
    drive.run(300);
    drive.lower();
    drive.set(0x607A, 20_000);
    drive.word(0x3F);
    assert!(slowest_at_10_000(&mut drive) < 500.0);
    drive.settle();
    assert_eq!(drive.outcomes()[0], Outcome::Reached);
}

#[test]
pub(super) fn library_refuses_a_blend_with_sin2_ramps() {
    let mut rig = rig();
    let refused = rig.abs(20_000, blend().profile_type(1));
    assert!(matches!(
        rig.outcome(refused),
        Some(Err(Failure::Unsupported(Unsupported::ProfileType { .. })))
    ));
    rig.run(50);
    assert!(rig.ledger().is_empty());
    // Nor onto a move that has such ramps.
    let first = rig.abs(20_000, after().profile_type(1));
    rig.wait_accepted(first);
    let refused = rig.abs(40_000, blend().profile_type(0));
    assert!(matches!(
        rig.finish(refused),
        Err(Failure::Unsupported(Unsupported::ProfileType { .. }))
    ));
    assert!(rig.finish(first).is_ok());
    assert_eq!(rig.ledger().len(), 1);
}

#[test]
pub(super) fn drive_tells_of_the_arrival_before_it_takes_a_single_one() {
    let mut drive = drive();
    drive.start(0x0F, 10_000);
    drive.run(300);
    drive.lower();
    drive.set(0x607A, 20_000);
    drive.word(0x1F);
    assert!(!drive.bit(12), "not while it is under way");
    assert_eq!(drive.outcomes(), [Outcome::Active]);
    drive.run_until(5_000, |drive| drive.outcomes().len() == 2);
    let ledger = drive.axis.ledger();
    assert_eq!(ledger[0].outcome, Outcome::Reached);
    assert!(ledger[0].ended_at <= Some(ledger[1].latched_at));
    assert!(drive.bit(12), "taken after the arrival");
}

#[test]
pub(super) fn library_gives_a_single_one_after_the_arrival() {
    let mut rig = rig();
    let first = rig.abs(20_000, after());
    rig.wait_accepted(first);
    let from = rig.words.len();
    let second = rig.abs(40_000, after());
    rig.run_until(5_000, |rig| rig.outcome(first).is_some());
    assert!(rig.words[from..].iter().all(|word| word & 0x10 == 0));
    assert_eq!(
        rig.outcome(first),
        Some(Ok(Completion::Reached { position: 20_000 }))
    );
    assert!(rig.statusword().contains(Statusword::TARGET_REACHED));
    assert_eq!(
        rig.finish(second),
        Ok(Completion::Reached { position: 40_000 })
    );
    assert_eq!(rig.ledger().len(), 2);
}

#[test]
pub(super) fn drive_stands_between_single_ones() {
    let mut drive = drive();
    drive.start(0x0F, 10_000);
    drive.run(300);
    drive.lower();
    drive.set(0x607A, 20_000);
    drive.word(0x1F);
    assert!(slowest_at_10_000(&mut drive) < 200.0);
    drive.run_until(5_000, |drive| drive.outcomes().len() == 2);
    drive.settle();
    assert_eq!(drive.outcomes(), [Outcome::Reached; 2]);
}

#[test]
pub(super) fn library_says_reached_between_single_ones() {
    let mut rig = rig();
    let moves = [20_000, 40_000, 10_000].map(|target| rig.abs(target, after()));
    assert!(rig.finish(moves[2]).is_ok());
    for (id, position) in moves.into_iter().zip([20_000, 40_000, 10_000]) {
        assert_eq!(rig.outcome(id), Some(Ok(Completion::Reached { position })));
    }
    let outcomes: Vec<_> = rig.ledger().iter().map(|line| line.outcome).collect();
    assert_eq!(outcomes, [Outcome::Reached; 3]);
}

#[test]
pub(super) fn drive_is_told_by_bit_5_which_of_both() {
    for (word, first) in [(0x1F, Outcome::Reached), (0x3F, Outcome::Passed)] {
        let mut drive = to_10_000();
        drive.set(0x607A, 20_000);
        drive.word(word);
        drive.run_until(5_000, |drive| drive.outcomes().len() == 2);
        drive.settle();
        assert_eq!(drive.outcomes(), [first, Outcome::Reached], "{word:02X}h");
    }
}

#[test]
pub(super) fn library_tells_by_bit_5_which_of_both() {
    for (set_point, word) in [(after(), 0x1F), (blend(), 0x3F)] {
        let mut rig = rig();
        let id = rig.abs(20_000, set_point);
        assert!(rig.finish(id).is_ok());
        let sent = rig.words.iter().find(|word| **word & 0x10 != 0);
        assert_eq!(sent, Some(&word));
    }
}

#[test]
pub(super) fn drive_knows_no_replacing() {
    let mut drive = to_10_000();
    drive.set(0x607A, -20_000);
    drive.word(0x3F);
    drive.settle();
    assert_eq!(drive.outcomes(), [Outcome::Reached; 2], "it reverses there");
    assert_eq!(drive.axis.ledger()[1].start_position, Some(10_000));
}

#[test]
pub(super) fn library_refuses_to_replace() {
    let mut rig = rig();
    let refused = rig.abs(20_000, SetPoint::new());
    assert!(matches!(
        rig.finish(refused),
        Err(Failure::Unsupported(Unsupported::Start {
            buffer_mode: BufferMode::Aborting,
            ..
        }))
    ));
    rig.run(50);
    assert!(rig.words.iter().all(|word| word & 0x10 == 0));
    assert!(rig.ledger().is_empty());
}

#[test]
pub(super) fn drive_takes_the_next_of_a_set_while_one_runs() {
    let mut drive = to_10_000();
    assert!(!drive.bit(12));
    drive.set(0x607A, 20_000);
    drive.word(0x3F);
    assert!(drive.bit(12), "answered while the first is under way");
    assert_eq!(drive.outcomes(), [Outcome::Active, Outcome::Queued]);
    assert_near(drive.axis.velocity(), VELOCITY as f64);
}

#[test]
pub(super) fn library_gives_the_next_of_a_set_while_one_runs() {
    let mut rig = rig();
    let first = rig.abs(20_000, blend());
    rig.wait_accepted(first);
    let second = rig.abs(40_000, blend());
    rig.wait_accepted(second);
    assert_eq!(rig.outcome(first), None);
    assert!(rig.drive.position() < 15_000, "long before the target");
}

/// The words of a set-point with bit 5 = 0 and with bit 5 = 1 (6): bit 4 low, then high.
const SINGLE_AND_SET: [(u16, u16); 2] = [(0x0F, 0x1F), (0x2F, 0x3F)];

#[test]
pub(super) fn drive_answers_in_the_order_of_the_figure() {
    for (low, high) in SINGLE_AND_SET {
        let mut drive = drive();
        drive.word(low);
        drive.set(0x607A, 10_000);
        drive.run(1);
        assert!(!drive.bit(12), "(1) data alone are no set-point");
        drive.word(high);
        assert!(drive.bit(12), "(2), (3)");
        drive.run(50);
        assert!(drive.bit(12), "it stays until (4)");
        drive.word(low);
        assert!(!drive.bit(12), "(4), (5): {high:02X}h");
        assert_eq!(drive.outcomes(), [Outcome::Active]);
        assert_eq!(drive.axis.ledger()[0].bit_5, high == 0x3F, "(6)");
        // New data are accepted: a single one's after the arrival.
        drive.set(0x607A, 20_000);
        drive.word(high);
        let mut cycles = 0;
        drive.run_until(5_000, |drive| {
            cycles += 1;
            drive.bit(12)
        });
        assert_eq!(cycles == 1, high == 0x3F, "{cycles} cycles");
        drive.settle();
        assert_eq!(drive.axis.ledger().len(), 2);
        assert_eq!(drive.axis.position(), 20_000);
    }
}

#[test]
pub(super) fn library_asks_in_the_order_of_the_figure() {
    for set_point in [after(), blend()] {
        let mut rig = Rig::of(
            servocrab::drives::ax2000(),
            servocrab_sim::ds402::Behaviour {
                bit_4_filter_cycles: 3,
                ..servocrab_sim::ds402::Behaviour::ax2000()
            },
            |config| config.defaults.profile_type = Some(0),
        )
        .ideal();
        rig.enable();
        rig.drive.disturbances().ack_delay_cycles = 5;
        let ids = [10_000, 20_000].map(|target| rig.abs(target, set_point));
        // What is seen of data, bits 4 and 5, and bit 12, each time that one of them changes.
        let mut steps: Vec<(i64, bool, bool, bool)> = Vec::new();
        for _ in 0..100 {
            rig.cycle();
            let word = rig.drive.controlword();
            let step = (
                rig.drive.get(0x607A, 0).expect("it is there"),
                word & 0x10 != 0,
                word & 0x20 != 0,
                rig.drive.statusword() & 0x1000 != 0,
            );
            if step.0 != 0 && steps.last() != Some(&step) {
                steps.push(step);
            }
        }
        // (6): bit 5 belongs to a set-point of a set, from (2) to (4). The others are the same with it and without.
        let set = set_point == blend();
        let expected = [
            (10_000, true, set, false),
            (10_000, true, set, true),
            (10_000, false, false, false),
            (20_000, true, set, false),
            (20_000, true, set, true),
            (20_000, false, false, true),
        ];
        // A single one's next data follow the arrival, which takes longer than this.
        let shown = if set { 6 } else { 3 };
        assert_eq!(
            steps,
            expected[..shown],
            "and bit 12 stays while no further one can be taken"
        );
        assert!(rig.finish(ids[1]).is_ok());
    }
}
