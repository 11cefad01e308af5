//! Homings whose drive shows bits of an earlier one, does not begin, or does not come to rest.

use super::played::{ENABLED, HOME, Played, REACHED};
use crate::{Failure, axis::Command, ds402::Mode};

/// A drive that keeps bit 13 of an earlier homing until the next has ended.
#[test]
fn a_homing_error_that_was_there_before_is_no_rest_of_an_axis_that_moves() {
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    drive.shows_for(20, 0x2637);
    let homing = drive.submit(HOME);
    drive.shows_for(3, 0x2637);
    assert_eq!(drive.word(), 0x001F);
    // Bits 1 0 0: error, still moving.
    drive.velocity = -300;
    drive.shows_for(200, 0x2237);
    let end = drive.outcome(homing);
    assert_ne!(end, Some(Err(Failure::HomingError { moving: false })));
    assert!(drive.core.snapshot().has_set_point, "{end:?}");
    // It is stopped when it has not come to rest in its time.
    drive.shows_for(400, 0x2237);
    let moving = Failure::HomingError { moving: true };
    assert_eq!(drive.outcome(homing), Some(Err(moving)));
    assert_eq!(drive.word() & 0x0004, 0, "bit 2 is low");
}

/// A halt that the drive ignores, or that does not bring the axis to rest, takes no deadline away from a homing.
#[test]
fn a_halted_homing_whose_axis_does_not_come_to_rest_has_an_end() {
    // In progress; an error while it moves; attained and moving.
    for statusword in [0x0237, 0x2237, 0x1237] {
        for swings in [false, true] {
            let mut drive = Played::enabled_in(Mode::Homing, Played::config());
            let homing = drive.submit(HOME);
            drive.cycles_until(0x001F, REACHED);
            drive.velocity = -300;
            drive.shows_for(20, ENABLED);
            let halting = drive.submit(Command::Halt);
            for cycle in 0..5_000 {
                if swings {
                    drive.velocity = if cycle % 40 < 20 { 3 } else { -3 };
                }
                drive.shows(statusword);
            }
            assert!(matches!(drive.outcome(halting), Some(Err(_))));
            let end = drive.outcome(homing);
            assert!(
                matches!(end, Some(Err(_))),
                "{statusword:04X}h, {swings}: {end:?} after 5 s, {:04X}h",
                drive.word()
            );
        }
    }
}

/// The drive is under local control and ignores bit 4. Bits 12 and 10 are those of an earlier homing, and one word is without bit 12.
#[test]
fn one_word_without_bit_12_is_no_homing_of_a_method_that_moves() {
    for remote in [0x0000, 0x0200] {
        let mut drive = Played::enabled_in(Mode::Homing, Played::config());
        drive.position = 700;
        drive.shows_for(20, 0x1437 | remote);
        let homing = drive.submit(HOME);
        assert_eq!(drive.outcome(homing), None);
        drive.shows_for(10, 0x1437 | remote);
        assert_eq!(drive.word(), 0x001F);
        drive.shows(0x0437 | remote);
        drive.shows_for(300, 0x1437 | remote);
        let outcome = drive.outcome(homing);
        assert!(
            !matches!(outcome, Some(Ok(_))),
            "{outcome:?}, referenced: {}",
            drive.core.snapshot().referenced
        );
    }
}

/// The drive shows "in progress" at rest, is under local control and ignores bit 4. One word is with bit 12.
#[test]
fn a_homing_that_the_drive_does_not_begin_ends_although_one_word_had_bit_12() {
    let mut drive = Played::enabled_in(Mode::Homing, Played::config());
    drive.shows_for(20, 0x0037);
    let homing = drive.submit(HOME);
    drive.shows_for(10, 0x0037);
    assert_eq!(drive.word(), 0x001F);
    drive.shows(0x1037);
    // Each deadline is over by then.
    drive.shows_for(5_000, 0x0037);
    let outcome = drive.outcome(homing);
    assert!(matches!(outcome, Some(Err(_))), "{outcome:?}");
}
