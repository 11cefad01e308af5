//! "Example Sequence of Events": options 1 to 4, first with the document's own words on the simulated drive, then with
//! the library's.

use servocrab::{BufferMode, SetPoint, profile_position::Reference};
use servocrab::{
    Failure, StopRequest,
    axis::{Command, CommandId, Completion, Delivery},
};
use servocrab_sim::ds402::{Behaviour, Cause, Outcome, State};

use crate::bench::Drive;
use crate::common::Rig;

/// One option: the values of 6040h in its rows, and what they ask for.
struct Example {
    base: u16,
    start: u16,
    halt: u16,
    resume: u16,
    quick_stop: u16,
    kind: BufferMode,
    reference: Reference,
}

const OPTIONS: [Example; 4] = [
    Example {
        base: 0x0F,
        start: 0x1F,
        halt: 0x11F,
        resume: 0x1F,
        quick_stop: 0x1B,
        kind: BufferMode::Buffered,
        reference: Reference::Absolute,
    },
    Example {
        base: 0x4F,
        start: 0x5F,
        halt: 0x15F,
        resume: 0x5F,
        quick_stop: 0x5B,
        kind: BufferMode::Buffered,
        reference: Reference::Relative,
    },
    Example {
        base: 0x2F,
        start: 0x3F,
        halt: 0x13F,
        resume: 0x3F,
        quick_stop: 0x3B,
        kind: BufferMode::Aborting,
        reference: Reference::Absolute,
    },
    Example {
        base: 0x6F,
        start: 0x7F,
        halt: 0x17F,
        resume: 0x7F,
        quick_stop: 0x7B,
        kind: BufferMode::Aborting,
        reference: Reference::Relative,
    },
];

/// Where the axis stands before, and the user's value of 607Ah.
const BEGIN: i32 = 1_000;
const VALUE: i32 = 20_000;

impl Example {
    fn end(&self) -> i64 {
        match self.reference {
            Reference::Absolute => i64::from(VALUE),
            Reference::Relative => i64::from(BEGIN + VALUE),
        }
    }

    /// Enabled, with the option's own word, bit 4 low.
    fn drive(&self) -> Drive {
        let mut drive = Drive::new(Behaviour::akd2g());
        drive.axis.place(BEGIN.into());
        drive.enable();
        drive.set(0x607A, VALUE.into());
        drive.word(self.base);
        assert!(!drive.moves(), "nothing moves before bit 4");
        drive
    }

    fn started_drive(&self) -> Drive {
        let mut drive = self.drive();
        drive.word(self.start);
        drive
    }

    fn rig(&self) -> (Rig, CommandId) {
        let mut rig = Rig::akd2g().ideal();
        rig.run(5);
        rig.drive.place(BEGIN.into());
        rig.enable();
        let set_point = SetPoint::new().buffer_mode(self.kind);
        let id = match self.reference {
            Reference::Absolute => rig.abs(VALUE, set_point),
            Reference::Relative => rig.rel(VALUE, set_point),
        };
        (rig, id)
    }

    fn drive_starts(&self) {
        let mut drive = self.started_drive();
        assert!(drive.bit(12) && !drive.bit(10));
        assert!(drive.moves());
        drive.settle();
        drive.run(2);
        assert_eq!(drive.axis.position(), self.end());
        assert!(drive.bit(10));
        let line = &drive.axis.ledger()[0];
        assert_eq!(line.bit_5, self.kind == BufferMode::Aborting);
        assert_eq!(line.relative, self.reference == Reference::Relative);
    }

    fn library_starts(&self) {
        let (mut rig, id) = self.rig();
        let end = i32::try_from(self.end()).expect("small");
        assert_eq!(rig.finish(id), Ok(Completion::Reached { position: end }));
        // What needs no bit but 4 has one word for both.
        let mut words = vec![0x0B, 0x00, 0x06, 0x07, 0x0F, self.base, self.start, 0x0F];
        words.dedup();
        assert_eq!(
            rig.distinct_words(1),
            words,
            "bits 5 and 6 come before bit 4 and go with it"
        );
        assert_eq!(rig.ledger().len(), 1);
    }

    fn drive_halts_and_resumes(&self) {
        let mut drive = self.started_drive();
        drive.run(300);
        drive.word(self.halt);
        drive.run(400);
        assert!(!drive.moves());
        assert_eq!(drive.state(), State::OperationEnabled);
        drive.word(self.resume);
        assert!(drive.moves());
        drive.settle();
        assert_eq!(drive.axis.position(), self.end());
        assert_eq!(drive.outcomes(), [Outcome::Reached]);
    }

    fn library_halts_and_resumes(&self) {
        let (mut rig, id) = self.rig();
        rig.drive.disturbances().ack_delay_cycles = 400;
        rig.run(150);
        let from = rig.words.len();
        let halt = rig.send(Command::Halt);
        assert!(rig.finish(halt).is_ok());
        rig.send(Command::Resume);
        rig.run(50);
        // The acknowledge is still out, so bit 4 is high: the document's own words.
        assert_eq!(rig.distinct_words(from), [self.halt, self.resume]);
        assert!(rig.finish(id).is_ok());
        assert_eq!(rig.drive.position(), self.end());
        assert_eq!(rig.ledger().len(), 1);
    }

    fn drive_quick_stops(&self) {
        let mut drive = self.started_drive();
        drive.run(300);
        assert_eq!(drive.word(self.quick_stop) & 0x6F, 0x07);
        drive.run(200);
        assert_eq!(drive.axis.velocity(), 0.0);
        assert_eq!(drive.outcomes(), [Outcome::Discarded(Cause::QuickStop)]);
        // Stepped through the state machine with bit 4 left high: that is no edge.
        for word in [0x00, 0x16, 0x17, 0x1F] {
            drive.word(word);
        }
        assert_eq!(drive.state(), State::OperationEnabled);
        assert!(!drive.moves());
        drive.word(self.base);
        drive.word(self.start);
        assert!(drive.moves(), "a new edge, a new move");
    }

    fn library_quick_stops(&self) {
        let (mut rig, id) = self.rig();
        rig.drive.disturbances().ack_delay_cycles = 400;
        rig.run(150);
        let from = rig.words.len();
        let stop = rig.send(Command::QuickStop);
        assert!(rig.finish(stop).is_ok());
        // Bit 4 is still high: the document's own word.
        assert_eq!(rig.distinct_words(from), [self.quick_stop]);
        assert_eq!(
            rig.outcome(id),
            Some(Err(Failure::QuickStopped {
                delivery: Delivery::Unknown
            }))
        );
        let from = rig.words.len();
        rig.enable();
        rig.run(100);
        let words = rig.distinct_words(from);
        assert_eq!(words[words.len() - 3..], [0x06, 0x07, 0x0F]);
        assert!(
            words[1..].iter().all(|word| word & 0x10 == 0),
            "{words:02X?}"
        );
        assert_eq!(rig.ledger().len(), 1);
    }

    fn drive_lets_the_start_bit_fall(&self) {
        for before in [1, 300, 4_000] {
            let mut drive = self.started_drive();
            drive.run(before);
            drive.word(self.base);
            assert!(!drive.bit(12));
            drive.settle();
            assert_eq!(drive.axis.position(), self.end(), "after {before} cycles");
            assert_eq!(drive.outcomes(), [Outcome::Reached]);
        }
    }

    fn library_lets_the_start_bit_fall(&self) {
        let (mut rig, id) = self.rig();
        rig.wait_accepted(id);
        let from = rig.words.len();
        rig.run(100);
        assert_eq!(rig.distinct_words(from), [0x0F], "during the move");
        assert!(rig.drive.velocity() != 0.0);
        assert!(rig.finish(id).is_ok());
    }
}

/// A drive that takes bits 5, 6 and 9 with the edge of bit 4, and one that takes them from the word before.
fn either() -> [Behaviour; 2] {
    [false, true].map(|start_bits_before_edge| Behaviour {
        start_bits_before_edge,
        ..Behaviour::akd2g()
    })
}

#[test]
pub(super) fn drive_may_take_the_start_bits_with_the_edge_or_before() {
    for option in &OPTIONS {
        for behaviour in either() {
            let before = behaviour.start_bits_before_edge;
            // The page's way first: the option's own word, then the one with bit 4. Then all at once.
            for (word, right) in [(option.base, true), (0x0F, !before || option.base == 0x0F)] {
                let mut drive = Drive::new(behaviour.clone());
                drive.axis.place(BEGIN.into());
                drive.enable();
                drive.set(0x607A, VALUE.into());
                drive.word(word);
                drive.word(option.start);
                drive.settle();
                let line = &drive.axis.ledger()[0];
                let taken = (line.bit_5, line.relative);
                let asked = (option.start & 0x20 != 0, option.start & 0x40 != 0);
                assert_eq!(taken == asked, right, "{word:02X}h, {:02X}h", option.start);
            }
        }
    }
}

#[test]
pub(super) fn library_sends_the_start_bits_first() {
    for option in &OPTIONS {
        for behaviour in either() {
            let mut rig = Rig::new(behaviour, |_| {}).ideal();
            rig.run(5);
            rig.drive.place(BEGIN.into());
            rig.enable();
            rig.run(10);
            let from = rig.words.len();
            let set_point = SetPoint::new().buffer_mode(option.kind);
            let sent = |rig: &mut Rig| match option.reference {
                Reference::Absolute => rig.abs(VALUE, set_point),
                Reference::Relative => rig.rel(VALUE, set_point),
            };
            let id = sent(&mut rig);
            let end = i32::try_from(option.end()).expect("small");
            assert_eq!(rig.finish(id), Ok(Completion::Reached { position: end }));
            // What needs none of them rises in the next frame.
            let first = usize::from(option.base == 0x0F);
            let words = [option.base, option.start, 0x0F];
            assert_eq!(rig.distinct_words(from), words[first..]);
            let first = rig.words[from..].iter().position(|word| word & 0x10 != 0);
            assert!(
                first.is_some_and(|first| first <= 3),
                "two drive cycles: {first:?}"
            );
            let line = &rig.ledger()[0];
            assert_eq!(line.bit_5, option.kind == BufferMode::Aborting);
            assert_eq!(line.relative, option.reference == Reference::Relative);
            // A stop before bit 4 takes them back: nothing is left of the set-point.
            let gone = sent(&mut rig);
            rig.cycle();
            rig.stop = StopRequest::HALT;
            rig.run(3);
            if option.base != 0x0F {
                assert!(matches!(
                    rig.outcome(gone),
                    Some(Err(Failure::Halted {
                        delivery: Delivery::NotSent
                    }))
                ));
                assert_eq!(rig.word(), 0x010F);
                assert_eq!(rig.ledger().len(), 1);
            }
        }
    }
}

macro_rules! options {
    ($($option:ident: $index:literal;)+) => {
        $(pub(super) mod $option {
            use super::OPTIONS;

            #[test]
            pub(in super::super) fn drive_starts() {
                OPTIONS[$index].drive_starts();
            }

            #[test]
            pub(in super::super) fn library_starts() {
                OPTIONS[$index].library_starts();
            }

            #[test]
            pub(in super::super) fn drive_halts_and_resumes() {
                OPTIONS[$index].drive_halts_and_resumes();
            }

            #[test]
            pub(in super::super) fn library_halts_and_resumes() {
                OPTIONS[$index].library_halts_and_resumes();
            }

            #[test]
            pub(in super::super) fn drive_quick_stops() {
                OPTIONS[$index].drive_quick_stops();
            }

            #[test]
            pub(in super::super) fn library_quick_stops() {
                OPTIONS[$index].library_quick_stops();
            }

            #[test]
            pub(in super::super) fn drive_lets_the_start_bit_fall() {
                OPTIONS[$index].drive_lets_the_start_bit_fall();
            }

            #[test]
            pub(in super::super) fn library_lets_the_start_bit_fall() {
                OPTIONS[$index].library_lets_the_start_bit_fall();
            }
        })+
    };
}

options! {
    option_1: 0;
    option_2: 1;
    option_3: 2;
    option_4: 3;
}
