//! The example sequence of the AKD2G's "Profile Position Mode", options 1 to 4, row by row: first with the document's own
//! controlwords given to the simulated drive, then as the library does the same four, with its words.
#![allow(missing_docs)]

mod common;

use core::time::Duration;

use common::Rig;
use servocrab::axis::{Command, Completion, Failure};
use servocrab::profile_position::{Reference, SetPoint, Start};
use servocrab_sim::ds402::{Axis, Behaviour, Cause, Outcome, State};

/// One option of the example: its rows' values of 6040h, and what they ask for.
#[derive(Debug)]
struct Example {
    /// "Start from standstill" or "start immediate", "absolute" or "relative": the word before the move, which is also
    /// the one that resets the start move bit.
    base: u16,
    /// "Start move (bit 4=1)".
    start: u16,
    /// "Halt (bit 8=1)".
    halt: u16,
    /// "Resume from halt (bit 8=0)".
    resume: u16,
    /// "Quick stop (bit 2=0)".
    quick_stop: u16,
    kind: Start,
    reference: Reference,
}

/// The document's table "Example Sequence of Events".
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

/// Where the axis stands before each example, and the row "Target position".
const BEGIN: i32 = 1_000;
const VALUE: i32 = 20_000;

impl Example {
    fn end(&self) -> i64 {
        match self.reference {
            Reference::Absolute => i64::from(VALUE),
            Reference::Relative => i64::from(BEGIN + VALUE),
        }
    }
}

/// The simulated drive alone.
struct Drive {
    axis: Axis,
    now: Duration,
}

impl Drive {
    fn set(&mut self, object: u16, value: i64) {
        self.axis.set(object, 0, value).expect("the drive takes it");
    }

    fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.now += Duration::from_millis(1);
            self.axis.cycle(self.now);
        }
    }

    /// One row of the table: a value of 6040h, one drive cycle, the statusword.
    fn controlword(&mut self, word: u16) -> u16 {
        self.set(0x6040, word.into());
        self.run(1);
        self.axis.statusword()
    }

    fn bit(&self, bit: u16) -> bool {
        self.axis.statusword() & (1 << bit) != 0
    }

    fn moves(&mut self) -> bool {
        let before = self.axis.position();
        self.run(10);
        self.axis.position() != before
    }

    /// The rows down to "Operation enable", and the option's own word.
    fn enabled(example: &Example) -> Self {
        let mut drive = Self {
            axis: Axis::new(Behaviour::akd2g()),
            now: Duration::ZERO,
        };
        drive.run(5);
        drive.axis.place(BEGIN.into());
        drive.set(0x6060, 0x01);
        drive.set(0x607A, VALUE.into());
        drive.set(0x6081, 10_000);
        drive.set(0x6083, 100_000);
        drive.set(0x6084, 50_000);
        assert_eq!(drive.controlword(0x06) & 0x6F, 0x21, "Ready to switch on");
        assert_eq!(drive.axis.get(0x6061, 0), Some(1), "the mode is shown");
        drive.controlword(0x0F);
        // One transition in a cycle: 3, then 4, of the same word.
        assert_eq!(drive.controlword(0x0F) & 0x6F, 0x27, "Operation enabled");
        drive.controlword(example.base);
        assert!(!drive.moves(), "nothing moves before bit 4");
        assert!(!drive.bit(12));
        drive
    }

    fn started(example: &Example) -> Self {
        let mut drive = Self::enabled(example);
        drive.controlword(example.start);
        assert!(drive.bit(12), "set-point acknowledge");
        assert!(!drive.bit(10), "target position not reached");
        assert!(drive.moves());
        drive
    }

    fn arrives_at(&mut self, end: i64) {
        self.run(4_000);
        assert_eq!(self.axis.position(), end);
        assert!(self.bit(10), "target position reached");
    }
}

#[test]
fn start_move_is_acknowledged_and_arrives_and_bit_12_stays_with_bit_4() {
    for example in &OPTIONS {
        let mut drive = Drive::started(example);
        drive.arrives_at(example.end());
        assert!(drive.bit(12), "as long as bit 4 is high");
        drive.controlword(example.base);
        assert!(!drive.bit(12), "turns off with bit 4");
        let [line] = drive.axis.ledger() else {
            panic!("one set-point: {:?}", drive.axis.ledger());
        };
        assert_eq!(line.outcome, Outcome::Reached);
        assert_eq!(line.relative, example.reference == Reference::Relative);
        assert_eq!(line.bit_5, example.kind == Start::Immediately);
    }
}

#[test]
fn the_start_move_bit_is_reset_during_the_move_without_stopping_it() {
    for example in &OPTIONS {
        let mut drive = Drive::started(example);
        drive.controlword(example.base);
        assert!(!drive.bit(12));
        assert!(drive.moves());
        drive.arrives_at(example.end());
        assert_eq!(drive.axis.ledger().len(), 1);
    }
}

#[test]
fn only_an_edge_of_bit_4_starts_a_move() {
    for example in &OPTIONS {
        let mut drive = Drive::started(example);
        drive.arrives_at(example.end());
        drive.set(0x607A, 0);
        drive.controlword(example.start);
        assert!(!drive.moves(), "bit 4 is still high: no new set-point");
        drive.controlword(example.base);
        drive.set(0x607A, -500);
        drive.controlword(example.start);
        assert!(drive.moves(), "toggled off and on again");
        assert_eq!(drive.axis.ledger().len(), 2);
    }
}

#[test]
fn halt_remembers_and_resume_continues_whatever_bit_4_is() {
    for example in &OPTIONS {
        for resume in [example.resume, example.base] {
            let mut drive = Drive::started(example);
            drive.run(300);
            drive.controlword(example.halt);
            assert!(!drive.bit(10), "axis decelerating");
            drive.run(100);
            // 100 ms at the 50 000 counts/s² of 6084h, from 10 000 counts/s.
            assert_eq!(drive.axis.velocity().round(), 5_000.0);
            assert!(!drive.bit(10));
            drive.run(250);
            assert!(drive.bit(10), "velocity dropped to zero");
            assert!(!drive.moves());
            assert_eq!(drive.axis.state(), State::OperationEnabled);
            assert_eq!(drive.axis.ledger()[0].outcome, Outcome::Active);

            drive.controlword(resume);
            assert!(drive.moves());
            drive.arrives_at(example.end());
            assert_eq!(drive.axis.ledger().len(), 1, "the same set-point");
        }
    }
}

#[test]
fn quick_stop_does_not_remember_and_enabling_with_bit_4_high_moves_nothing() {
    for example in &OPTIONS {
        let mut drive = Drive::started(example);
        drive.run(300);
        let word = drive.controlword(example.quick_stop);
        assert_eq!(word & 0x6F, 0x07, "Quick stop active");
        drive.run(500);
        assert_eq!(drive.axis.velocity(), 0.0);
        assert_eq!(
            drive.axis.ledger()[0].outcome,
            Outcome::Discarded(Cause::QuickStop)
        );
        assert_eq!(drive.axis.state(), State::SwitchOnDisabled, "605Ah is 2");

        // "Resume from quick stop: step through state machine", with the start move bit left high on the way.
        drive.controlword(example.start);
        assert_eq!(drive.axis.state(), State::SwitchOnDisabled);
        drive.controlword(0x16);
        assert_eq!(drive.axis.state(), State::ReadyToSwitchOn);
        drive.controlword(example.start);
        drive.controlword(example.start);
        assert_eq!(drive.axis.state(), State::OperationEnabled);
        assert!(!drive.moves());

        drive.controlword(example.base);
        drive.controlword(example.start);
        assert!(drive.moves(), "a new edge, a new move");
        assert_eq!(drive.axis.ledger().len(), 2);
    }
}

/// A rig whose axis stands where the examples begin.
fn rig() -> Rig {
    let mut rig = Rig::akd2g();
    rig.run(5);
    rig.drive.place(BEGIN.into());
    rig.enable();
    rig
}

fn begin(rig: &mut Rig, example: &Example) -> servocrab::axis::CommandId {
    let set_point = SetPoint::new().start(example.kind);
    match example.reference {
        Reference::Absolute => rig.abs(VALUE, set_point),
        Reference::Relative => rig.rel(VALUE, set_point),
    }
}

#[test]
fn the_librarys_words_for_the_same_four_options() {
    for example in &OPTIONS {
        let mut rig = rig();
        // Two commands where the document lets one word run two transitions.
        assert_eq!(rig.distinct_words(0), [0x00, 0x06, 0x07, 0x0F]);

        let from = rig.words.len();
        let id = begin(&mut rig, example);
        rig.run(150);
        assert!(rig.accepted(id));
        // Bits 5 and 6 rise with bit 4 and fall with it, after the acknowledge.
        assert_eq!(rig.distinct_words(from), [0x0F, example.start, 0x0F]);

        let from = rig.words.len();
        let halt = rig.send(Command::Halt);
        assert!(rig.finish(halt).is_ok());
        let resume = rig.send(Command::Resume);
        assert_eq!(rig.outcome(resume), Some(Ok(Completion::Done)));
        rig.run(50);
        assert_eq!(rig.distinct_words(from), [0x10F, 0x0F]);

        let from = rig.words.len();
        let stop = rig.send(Command::QuickStop);
        assert!(matches!(rig.finish(stop), Ok(Completion::Stopped { .. })));
        assert_eq!(rig.outcome(id), Some(Err(Failure::QuickStopped)));
        rig.enable();
        rig.run(100);
        assert_eq!(
            rig.distinct_words(from),
            [0x0B, 0x06, 0x07, 0x0F],
            "stepped through the state machine, bit 4 low before"
        );
        assert_eq!(rig.ledger().len(), 1);
        assert_eq!(rig.drive.velocity(), 0.0);
    }
}

#[test]
fn with_the_acknowledge_still_out_the_librarys_words_are_the_documents() {
    for example in &OPTIONS {
        let mut rig = rig();
        rig.drive.disturbances().ack_delay_cycles = 400;
        let from = rig.words.len();
        begin(&mut rig, example);
        rig.run(100);
        let halt = rig.send(Command::Halt);
        assert!(rig.finish(halt).is_ok());
        rig.send(Command::Resume);
        rig.run(50);
        let stop = rig.send(Command::QuickStop);
        assert!(rig.finish(stop).is_ok());
        assert_eq!(
            rig.distinct_words(from),
            [
                0x0F,
                example.start,
                example.halt,
                example.resume,
                example.quick_stop
            ]
        );
        rig.enable();
        rig.run(100);
        assert_eq!(rig.ledger().len(), 1, "bit 4 was low before 0Fh");
        assert_eq!(
            rig.ledger()[0].outcome,
            Outcome::Discarded(Cause::QuickStop)
        );
    }
}
