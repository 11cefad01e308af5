//! Bits 5, 6 and 9 of an AKD2G's set-points: on a drive that takes them from the word before bit 4, and on one that takes them with it.

use crate::common::Rig;
use servocrab::{BufferMode, SetPoint, profile_position::Reference};
use servocrab::{
    Failure,
    axis::{Command, CommandId},
};
use servocrab_sim::ds402::{Behaviour, Outcome};

const ENABLED: u16 = 0x0F;
const BIT_4: u16 = 1 << 4;
const BIT_5: u16 = 1 << 5;
const BIT_6: u16 = 1 << 6;
const BIT_9: u16 = 1 << 9;
const START_BITS: u16 = BIT_5 | BIT_6 | BIT_9;

/// From bits 5, 6 and 9 to bit 4: the frame that brings them, and two cycles of the drive.
const BEFORE: usize = 3;

const MODES: [BufferMode; 3] = [
    BufferMode::Aborting,
    BufferMode::Buffered,
    BufferMode::Blending,
];
const REFERENCES: [Reference; 2] = [Reference::Absolute, Reference::Relative];

/// The bits that a start takes beside bit 4.
fn start_bits(reference: Reference, mode: BufferMode) -> u16 {
    let by_mode = match mode {
        BufferMode::Aborting => BIT_5,
        BufferMode::Buffered => 0,
        BufferMode::Blending => BIT_9,
    };
    match reference {
        Reference::Absolute => by_mode,
        Reference::Relative => by_mode | BIT_6,
    }
}

fn rig(before_edge: bool) -> Rig {
    let behaviour = Behaviour {
        start_bits_before_edge: before_edge,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |_| {}).ideal();
    rig.enable();
    rig.run(20);
    rig
}

fn start(rig: &mut Rig, reference: Reference, target: i32, mode: BufferMode) -> CommandId {
    let set_point = SetPoint::new().buffer_mode(mode);
    match reference {
        Reference::Absolute => rig.abs(target, set_point),
        Reference::Relative => rig.rel(target, set_point),
    }
}

fn each(mut judge: impl FnMut(bool, Reference, BufferMode)) {
    for before_edge in [false, true] {
        for reference in REFERENCES {
            for mode in MODES {
                judge(before_edge, reference, mode);
            }
        }
    }
}

/// How many frames there were before the first one with bit 4 since frame `from`.
fn frames_before_bit_4(rig: &Rig, from: usize) -> usize {
    let words = &rig.words[from..];
    let rise = words.iter().position(|word| word & BIT_4 != 0);
    rise.expect("it was sent")
}

#[test]
fn each_start_at_rest_is_executed_as_it_was_asked_for() {
    each(|before_edge, reference, mode| {
        let mut rig = rig(before_edge);
        let case = format!("{before_edge} {reference:?} {mode:?}");
        for target in [5_000, 7_000] {
            let id = start(&mut rig, reference, target, mode);
            assert!(rig.finish(id).is_ok(), "{case}");
        }
        let end = match reference {
            Reference::Absolute => 7_000,
            Reference::Relative => 12_000,
        };
        assert_eq!(rig.drive.position(), end, "{case}");
        let asked = start_bits(reference, mode);
        for line in rig.ledger() {
            assert_eq!(line.relative, asked & BIT_6 != 0, "{case}");
            assert_eq!(line.bit_5, asked & BIT_5 != 0, "{case}");
            assert_eq!(line.bit_9, asked & BIT_9 != 0, "{case}");
            assert_eq!(line.outcome, Outcome::Reached, "{case}");
        }
    });
}

#[test]
fn each_start_behind_a_move_is_executed_as_it_was_asked_for() {
    each(|before_edge, reference, mode| {
        let mut rig = rig(before_edge);
        let case = format!("{before_edge} {reference:?} {mode:?}");
        let first = rig.abs(30_000, SetPoint::new());
        rig.wait_accepted(first);
        rig.run(50);
        let second = start(&mut rig, reference, 60_000, mode);
        let end = rig.finish(second);
        // Nobody knows where a distance ends that is blended.
        let open = reference == Reference::Relative && mode == BufferMode::Blending;
        let is_unknown = matches!(end, Err(Failure::Unknown { .. }));
        assert!(end.is_ok() || (open && is_unknown), "{case}: {end:?}");
        let [first, second] = rig.ledger() else {
            panic!("{case}: {:?}", rig.ledger());
        };
        let outcome = match mode {
            BufferMode::Aborting => Outcome::Replaced,
            BufferMode::Blending => Outcome::Passed,
            _ => Outcome::Reached,
        };
        assert_eq!(first.outcome, outcome, "{case}");
        assert_eq!(second.outcome, Outcome::Reached, "{case}");
        let asked = start_bits(reference, mode);
        let taken = (second.bit_5, second.relative, second.bit_9);
        let bits = [BIT_5, BIT_6, BIT_9].map(|bit| asked & bit != 0);
        assert_eq!(taken, (bits[0], bits[1], bits[2]), "{case}");
        let end = rig.drive.position();
        match (reference, mode) {
            (Reference::Absolute, _) => assert_eq!(end, 60_000, "{case}"),
            // From where it was replaced.
            (_, BufferMode::Aborting) => assert!((60_000..90_000).contains(&end), "{case}"),
            _ => assert_eq!(end, 90_000, "{case}"),
        }
    });
}

#[test]
fn bits_5_6_and_9_are_out_before_bit_4_and_fall_with_it() {
    each(|before_edge, reference, mode| {
        let mut rig = rig(before_edge);
        let asked = start_bits(reference, mode);
        let from = rig.words.len();
        let id = start(&mut rig, reference, 5_000, mode);
        assert!(rig.finish(id).is_ok());
        let mut words = vec![ENABLED | asked, ENABLED | asked | BIT_4, ENABLED];
        if asked == 0 {
            words.remove(0);
        }
        assert_eq!(rig.distinct_words(from), words, "{before_edge}");
        let before = if asked == 0 { 0 } else { BEFORE };
        assert_eq!(frames_before_bit_4(&rig, from), before, "{asked:03X}h");
    });
}

#[test]
fn the_bits_of_a_move_that_does_not_come_are_taken_back() {
    for before_edge in [false, true] {
        let mut rig = rig(before_edge);
        // It waits for a place in the drive, with its bits out.
        let buffered = SetPoint::new().buffer_mode(BufferMode::Buffered);
        rig.abs(20_000, buffered);
        rig.abs(30_000, buffered);
        let relative = rig.rel(5_000, buffered);
        rig.run(100);
        assert_eq!(rig.word() & (START_BITS | BIT_4), BIT_6);
        let mut outputs = rig.outputs.clone();
        assert!(rig.core.withdraw(rig.now, relative, &mut outputs));
        rig.outputs = outputs;
        assert_eq!(rig.word(), ENABLED);
        let after = rig.abs(40_000, buffered);
        assert!(rig.finish(after).is_ok());
        assert_eq!(rig.drive.position(), 40_000);
        assert!(rig.ledger().iter().all(|line| !line.relative));
        // And by a stop.
        rig.abs(80_000, buffered);
        rig.abs(90_000, buffered);
        rig.rel(5_000, buffered);
        rig.run(100);
        assert_eq!(rig.word() & (START_BITS | BIT_4), BIT_6);
        rig.send(Command::Halt);
        assert_eq!(rig.word(), ENABLED | 1 << 8);
    }
}
