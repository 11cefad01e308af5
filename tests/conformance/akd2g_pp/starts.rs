//! "Controlword Bit 4", "Controlword Bit 5", "Controlword Bit 6" and "Controlword Bit 9".

use servocrab::{BufferMode, SetPoint};
use servocrab::{Failure, axis::Completion};
use servocrab_sim::ds402::{Behaviour, Outcome};

use super::profile::akd2g;
use crate::bench::{Drive, VELOCITY, assert_near};
use crate::common::{Link, Rig};

/// Under way to 10 000 at full speed, bit 4 low.
fn to_10_000() -> Drive {
    let mut drive = akd2g();
    drive.start(0x0F, 10_000);
    drive.run(300);
    drive.lower();
    drive
}

/// How often bit 4 rises in the library's words.
fn edges(words: &[u16]) -> usize {
    let pairs = words.windows(2);
    pairs.filter(|pair| !pair[0] & pair[1] & 0x10 != 0).count()
}

#[test]
pub(super) fn drive_starts_by_bit_4() {
    let mut drive = akd2g();
    drive.set(0x607A, 20_000);
    for word in [0x0F, 0x2F, 0x4F, 0x20F] {
        drive.word(word);
        assert!(!drive.moves(), "{word:03X}h has no bit 4");
    }
    drive.word(0x0F);
    drive.word(0x1F);
    assert!(drive.moves());
}

#[test]
pub(super) fn library_starts_by_bit_4() {
    let mut rig = Rig::ideal_enabled();
    rig.run(100);
    assert!(rig.words.iter().all(|word| word & 0x10 == 0));
    let id = rig.abs(5_000, SetPoint::new());
    assert!(rig.finish(id).is_ok());
    assert_eq!(edges(&rig.words), 1);
    assert_eq!(rig.ledger().len(), 1);
}

#[test]
pub(super) fn drive_uses_the_profile_of_the_edge() {
    let mut drive = akd2g();
    drive.start(0x0F, 20_000);
    drive.set(0x607A, -20_000);
    drive.set(0x6081, 2 * VELOCITY);
    drive.set(0x6084, 1);
    drive.run(500);
    assert_near(drive.axis.velocity(), VELOCITY as f64);
    drive.settle();
    assert_eq!(drive.axis.position(), 20_000);
}

#[test]
pub(super) fn library_holds_the_profile_until_the_drive_has_taken_it() {
    let behaviour = Behaviour {
        bit_4_filter_cycles: 5,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |_| {}).ideal();
    rig.enable();
    let first = rig.abs(5_000, SetPoint::new().velocity(11_000));
    let second = rig.abs(-5_000, SetPoint::new().velocity(22_000));
    assert!(rig.finish(second).is_ok());
    assert_eq!(rig.outcome(first), Some(Err(Failure::Superseded)));
    let taken: Vec<_> = rig
        .ledger()
        .iter()
        .map(|line| (line.value, line.velocity))
        .collect();
    assert_eq!(taken, [(5_000, 11_000), (-5_000, 22_000)]);
}

#[test]
pub(super) fn drive_takes_edges_and_no_levels() {
    let mut drive = akd2g();
    drive.start(0x0F, 2_000);
    drive.settle();
    drive.set(0x607A, 4_000);
    drive.word(0x1F);
    assert!(!drive.moves(), "still high");
    drive.lower();
    assert!(!drive.moves(), "falling");
    drive.word(0x1F);
    assert!(drive.moves(), "rising again");
    assert_eq!(drive.outcomes().len(), 2);
}

#[test]
pub(super) fn library_shows_each_low_before_the_next_edge() {
    for lost in 0..10 {
        let mut rig = Rig::ideal_enabled();
        rig.abs(20_000, SetPoint::new());
        let second = rig.abs(-20_000, SetPoint::new());
        rig.run(lost);
        rig.cycle_over(Link::RequestLost);
        assert_eq!(
            rig.finish(second),
            Ok(Completion::Reached { position: -20_000 })
        );
        assert_eq!(edges(&rig.words), 2);
        assert_eq!(rig.ledger().len(), 2, "frame {lost} lost");
    }
}

#[test]
pub(super) fn drive_goes_on_when_bit_4_falls() {
    let mut drive = akd2g();
    drive.start(0x0F, 20_000);
    drive.run(300);
    drive.lower();
    assert_near(drive.axis.velocity(), VELOCITY as f64);
    drive.settle();
    assert_eq!(drive.axis.position(), 20_000);
    assert_eq!(drive.outcomes(), [Outcome::Reached]);
}

#[test]
pub(super) fn library_lowers_bit_4_during_the_move() {
    let mut rig = Rig::ideal_enabled();
    let id = rig.abs(50_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(5);
    assert!(rig.drive.velocity() > 0.0);
    assert_eq!(rig.word(), 0x0F);
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 50_000 }));
}

#[test]
pub(super) fn drive_needs_a_low_to_restart_the_same_move() {
    let mut drive = akd2g();
    drive.start(0x4F, 1_000);
    drive.settle();
    assert!(!drive.moves());
    drive.word(0x5F);
    assert!(!drive.moves());
    drive.word(0x4F);
    drive.word(0x5F);
    drive.settle();
    assert_eq!(drive.axis.position(), 2_000, "twice the same distance");
}

#[test]
pub(super) fn library_sends_the_same_target_again() {
    let mut rig = Rig::ideal_enabled();
    for n in 1..=3 {
        let id = rig.abs(5_000, SetPoint::new());
        assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 5_000 }));
        assert_eq!(rig.ledger().len(), n);
    }
}

#[test]
pub(super) fn drive_waits_for_the_current_move_with_bit_5_low() {
    let mut drive = to_10_000();
    drive.set(0x607A, 4_000);
    drive.word(0x1F);
    assert!(drive.moves());
    drive.run_until(5_000, |drive| drive.outcomes()[0] == Outcome::Reached);
    assert_eq!(drive.axis.position(), 10_000);
    drive.settle();
    assert_eq!(drive.axis.position(), 4_000);
    let ledger = drive.axis.ledger();
    assert_eq!(ledger[1].start_position, Some(10_000));
}

#[test]
pub(super) fn library_queues_with_bit_5_low() {
    let mut rig = Rig::ideal_enabled();
    let first = rig.abs(10_000, SetPoint::new());
    rig.wait_accepted(first);
    let from = rig.words.len();
    let second = rig.abs(4_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    assert_eq!(
        rig.finish(second),
        Ok(Completion::Reached { position: 4_000 })
    );
    assert!(matches!(
        rig.outcome(first),
        Some(Ok(Completion::Reached { .. }))
    ));
    assert_eq!(rig.distinct_words(from), [0x0F, 0x1F, 0x0F]);
    assert_eq!(rig.ledger()[0].outcome, Outcome::Reached);
}

#[test]
pub(super) fn drive_starts_at_once_with_bit_5_high() {
    let mut drive = to_10_000();
    drive.set(0x607A, -4_000);
    drive.word(0x3F);
    assert_eq!(drive.outcomes(), [Outcome::Replaced, Outcome::Active]);
    drive.settle();
    assert_eq!(drive.axis.position(), -4_000);
    let turned = drive.axis.ledger()[1].start_position;
    assert!(turned.is_some_and(|at| at < 10_000), "{turned:?}");
}

#[test]
pub(super) fn library_replaces_with_bit_5_high() {
    let mut rig = Rig::ideal_enabled();
    let first = rig.abs(100_000, SetPoint::new());
    rig.wait_accepted(first);
    rig.run(100);
    let from = rig.words.len();
    let second = rig.abs(-4_000, SetPoint::new());
    rig.wait_accepted(second);
    assert_eq!(rig.outcome(first), Some(Err(Failure::Superseded)));
    assert_eq!(rig.distinct_words(from), [0x2F, 0x3F]);
    assert_eq!(rig.ledger()[0].outcome, Outcome::Replaced);
    assert_eq!(
        rig.finish(second),
        Ok(Completion::Reached { position: -4_000 })
    );
}

#[test]
pub(super) fn drive_takes_bit_6_with_each_set_point() {
    let mut drive = akd2g();
    drive.start(0x0F, 3_000);
    drive.settle();
    drive.start(0x4F, 3_000);
    drive.settle();
    assert_eq!(drive.axis.position(), 6_000);
    drive.start(0x0F, 3_000);
    drive.settle();
    assert_eq!(drive.axis.position(), 3_000);
}

#[test]
pub(super) fn library_sets_bit_6_for_relative_moves_alone() {
    let mut rig = Rig::ideal_enabled();
    let mut words: Vec<u16> = Vec::new();
    for (relative, end) in [(false, 3_000), (true, 6_000), (false, 3_000)] {
        let from = rig.words.len();
        let id = if relative {
            rig.rel(3_000, SetPoint::new())
        } else {
            rig.abs(3_000, SetPoint::new())
        };
        assert_eq!(rig.finish(id), Ok(Completion::Reached { position: end }));
        words.extend(rig.words[from..].iter().find(|word| **word & 0x10 != 0));
    }
    assert_eq!(words, [0x3F, 0x7F, 0x3F]);
}

#[test]
pub(super) fn drive_moves_to_an_absolute_target_from_anywhere() {
    for place in [-7_000, 0, 2_000, 9_000] {
        let mut drive = Drive::new(Behaviour::akd2g());
        drive.axis.place(place);
        drive.enable();
        drive.start(0x0F, 2_000);
        drive.settle();
        assert_eq!(drive.axis.position(), 2_000, "from {place}");
    }
}

#[test]
pub(super) fn library_moves_to_an_absolute_target_from_anywhere() {
    for place in [-7_000, 0, 2_000, 9_000] {
        let mut rig = Rig::akd2g().ideal();
        rig.run(5);
        rig.drive.place(place);
        rig.enable();
        let id = rig.abs(2_000, SetPoint::new());
        assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 2_000 }));
        assert_eq!(rig.ledger()[0].value, 2_000);
    }
}

#[test]
pub(super) fn drive_moves_by_a_relative_distance() {
    for place in [-7_000, 0, 9_000] {
        let mut drive = Drive::new(Behaviour::akd2g());
        drive.axis.place(place);
        drive.enable();
        drive.start(0x4F, 2_000);
        drive.settle();
        assert_eq!(drive.axis.position(), place + 2_000);
    }
}

#[test]
pub(super) fn library_moves_by_a_relative_distance() {
    let mut rig = Rig::akd2g().ideal();
    rig.run(5);
    rig.drive.place(9_000);
    rig.enable();
    let id = rig.rel(2_000, SetPoint::new());
    assert_eq!(rig.finish(id), Ok(Completion::Reached { position: 11_000 }));
    assert!(rig.ledger()[0].relative);
    assert_eq!(rig.ledger()[0].value, 2_000, "the distance itself");
}

#[test]
pub(super) fn drive_takes_the_direction_from_the_sign() {
    for distance in [2_000, -2_000] {
        let mut drive = akd2g();
        drive.start(0x4F, distance);
        drive.run(100);
        assert_eq!(drive.axis.velocity() > 0.0, distance > 0);
        drive.settle();
        assert_eq!(drive.axis.position(), distance);
    }
}

#[test]
pub(super) fn library_sends_the_sign_of_a_distance() {
    let mut rig = Rig::ideal_enabled();
    for (distance, end) in [(-2_000, -2_000), (500, -1_500), (-1, -1_501)] {
        let id = rig.rel(distance, SetPoint::new());
        assert_eq!(rig.finish(id), Ok(Completion::Reached { position: end }));
        assert_eq!(rig.ledger().last().expect("a line").value, distance);
    }
}

/// The slowest that the axis is from here until the first set-point is over and well behind.
fn slowest_through_the_first(drive: &mut Drive) -> f64 {
    drive.speeds_while(|drive| drive.axis.position() < 10_500).0
}

#[test]
pub(super) fn drive_blends_a_set_point_into_one_in_progress() {
    let mut drive = to_10_000();
    drive.set(0x607A, 20_000);
    drive.word(0x21F);
    assert_eq!(drive.outcomes(), [Outcome::Active, Outcome::Queued]);
    drive.settle();
    assert_eq!(drive.outcomes(), [Outcome::Passed, Outcome::Reached]);
    assert_eq!(drive.axis.position(), 20_000);
}

#[test]
pub(super) fn library_blends_a_set_point_into_one_in_progress() {
    let mut rig = Rig::ideal_enabled();
    let first = rig.abs(20_000, SetPoint::new());
    rig.wait_accepted(first);
    let second = rig.abs(40_000, SetPoint::new().buffer_mode(BufferMode::Blending));
    assert_eq!(
        rig.finish(second),
        Ok(Completion::Reached { position: 40_000 })
    );
    assert!(matches!(
        rig.outcome(first),
        Some(Ok(Completion::Passed { .. }))
    ));
    let outcomes: Vec<_> = rig.ledger().iter().map(|line| line.outcome).collect();
    assert_eq!(outcomes, [Outcome::Passed, Outcome::Reached]);
}

#[test]
pub(super) fn drive_blends_only_with_bit_5_low() {
    for (word, first) in [(0x21F, Outcome::Passed), (0x23F, Outcome::Replaced)] {
        let mut drive = to_10_000();
        drive.set(0x607A, 20_000);
        drive.word(word);
        drive.settle();
        assert_eq!(drive.outcomes()[0], first, "{word:03X}h");
    }
}

#[test]
pub(super) fn library_blends_with_bit_5_low() {
    let mut rig = Rig::ideal_enabled();
    let first = rig.abs(20_000, SetPoint::new());
    rig.wait_accepted(first);
    let from = rig.words.len();
    let second = rig.abs(40_000, SetPoint::new().buffer_mode(BufferMode::Blending));
    rig.wait_accepted(second);
    rig.run(5);
    assert_eq!(rig.distinct_words(from), [0x20F, 0x21F, 0x0F]);
}

#[test]
pub(super) fn drive_starts_from_standstill_with_bit_9_low() {
    let mut drive = to_10_000();
    drive.set(0x607A, 20_000);
    drive.word(0x1F);
    assert!(slowest_through_the_first(&mut drive) < 200.0);
    drive.settle();
    assert_eq!(drive.outcomes(), [Outcome::Reached; 2]);
}

#[test]
pub(super) fn library_reports_a_stop_between_queued_moves() {
    let mut rig = Rig::ideal_enabled();
    let first = rig.abs(20_000, SetPoint::new());
    rig.wait_accepted(first);
    let second = rig.abs(40_000, SetPoint::new().buffer_mode(BufferMode::Buffered));
    assert!(rig.finish(second).is_ok());
    assert!(
        matches!(rig.outcome(first), Some(Ok(Completion::Reached { .. }))),
        "reached, not passed: {:?}",
        rig.outcome(first)
    );
    assert!(!rig.ledger()[1].bit_9);
    assert_eq!(rig.ledger()[0].outcome, Outcome::Reached);
}

#[test]
pub(super) fn drive_keeps_its_speed_through_a_blend() {
    let mut drive = to_10_000();
    drive.set(0x607A, 20_000);
    drive.set(0x6081, 2 * VELOCITY);
    drive.word(0x21F);
    let (slowest, fastest) = drive.speeds_while(|drive| drive.axis.position() < 10_000);
    assert_near(slowest, VELOCITY as f64);
    assert_near(fastest, VELOCITY as f64);
    drive.run(200);
    assert_near(drive.axis.velocity(), 2.0 * VELOCITY as f64);
}

#[test]
pub(super) fn library_says_passed_where_the_axis_did_not_stop() {
    let mut rig = Rig::ideal_enabled();
    let first = rig.abs(20_000, SetPoint::new());
    rig.wait_accepted(first);
    let second = rig.abs(60_000, SetPoint::new().buffer_mode(BufferMode::Blending));
    rig.run_until(5_000, |rig| rig.outcome(first).is_some());
    assert!(matches!(
        rig.outcome(first),
        Some(Ok(Completion::Passed { .. }))
    ));
    assert!(rig.drive.velocity() > 40_000.0, "it is still moving");
    assert_eq!(rig.outcome(second), None);
}

#[test]
pub(super) fn drive_lets_bit_5_override_bit_9() {
    let mut drive = to_10_000();
    drive.set(0x607A, -4_000);
    drive.word(0x23F);
    drive.settle();
    assert_eq!(drive.outcomes(), [Outcome::Replaced, Outcome::Reached]);
    let line = &drive.axis.ledger()[0];
    assert!(
        line.end_position.is_some_and(|at| at < 10_000),
        "it never went on to its own target"
    );
    assert_eq!(drive.axis.position(), -4_000);
}

#[test]
pub(super) fn library_never_sends_bits_5_and_9_together() {
    let mut rig = Rig::ideal_enabled();
    let starts = [
        BufferMode::Aborting,
        BufferMode::Buffered,
        BufferMode::Blending,
    ];
    for (n, start) in starts.into_iter().cycle().take(9).enumerate() {
        let target = 20_000 * (i32::try_from(n).expect("small") + 1);
        rig.abs(target, SetPoint::new().buffer_mode(start));
        rig.run(30);
    }
    rig.run(5_000);
    assert!(rig.ledger().len() >= 3);
    for word in &rig.words {
        assert_ne!(word & 0x220, 0x220, "{word:03X}h");
    }
    assert!(rig.words.iter().any(|word| word & 0x230 == 0x30));
    assert!(rig.words.iter().any(|word| word & 0x230 == 0x210));
}
