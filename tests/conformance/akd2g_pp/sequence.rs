//! "Example Sequence of Events": options 1 to 4, first with the document's own words on the simulated drive, then with
//! the library's.

use servocrab::axis::{Command, CommandId, Completion, Delivery, Failure};
use servocrab::profile_position::{Reference, SetPoint, Start};
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
    kind: Start,
    reference: Reference,
}

const OPTIONS: [Example; 4] = [
    Example {
        base: 0x0F,
        start: 0x1F,
        halt: 0x11F,
        resume: 0x1F,
        quick_stop: 0x1B,
        kind: Start::AfterCurrent,
        reference: Reference::Absolute,
    },
    Example {
        base: 0x4F,
        start: 0x5F,
        halt: 0x15F,
        resume: 0x5F,
        quick_stop: 0x5B,
        kind: Start::AfterCurrent,
        reference: Reference::Relative,
    },
    Example {
        base: 0x2F,
        start: 0x3F,
        halt: 0x13F,
        resume: 0x3F,
        quick_stop: 0x3B,
        kind: Start::Immediately,
        reference: Reference::Absolute,
    },
    Example {
        base: 0x6F,
        start: 0x7F,
        halt: 0x17F,
        resume: 0x7F,
        quick_stop: 0x7B,
        kind: Start::Immediately,
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
        let mut rig = Rig::akd2g();
        rig.run(5);
        rig.drive.place(BEGIN.into());
        rig.enable();
        let set_point = SetPoint::new().start(self.kind);
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
        assert_eq!(line.bit_5, self.kind == Start::Immediately);
        assert_eq!(line.relative, self.reference == Reference::Relative);
    }

    fn library_starts(&self) {
        let (mut rig, id) = self.rig();
        let end = i32::try_from(self.end()).expect("small");
        assert_eq!(rig.finish(id), Ok(Completion::Reached { position: end }));
        assert_eq!(
            rig.distinct_words(1),
            [0x0B, 0x00, 0x06, 0x07, 0x0F, self.start, 0x0F],
            "bits 5 and 6 come and go with bit 4"
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
