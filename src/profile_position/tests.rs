//! Set-points and the drive's words, cycle by cycle, and what is said of each in the end.

use core::time::Duration;
use std::{vec, vec::Vec};

use crate::ds402::Controlword;

use super::{
    BufferMode, BufferSignal, CommandId, Completion, Delivery, Doubt, Event, Events, Eyes, Failure,
    MoveCommand, Parameters, Reference, RelativeBase, Sequencer, WaitingFor, set_point::SetPoint,
};

/// Bits 10 and 12.
const REACHED: u16 = 1 << 10;
const ACKNOWLEDGE: u16 = 1 << 12;

const FIRST: CommandId = CommandId(1);
const SECOND: CommandId = CommandId(2);
const THIRD: CommandId = CommandId(3);

/// A drive with a cycle of 1 ms whose axis stands at 0, with a window of 10 and a settle time of 100 ms.
struct SetPointDialogue {
    sequencer: Sequencer,
    eyes: Eyes,
    events: Events,
    now: Duration,
    position: i32,
    halted: bool,
}

impl SetPointDialogue {
    fn with(signal: BufferSignal) -> Self {
        let mut eyes = Eyes::new();
        eyes.traits.buffer_signal = signal;
        eyes.traits.relative_base = RelativeBase::Actual;
        let mut this = Self {
            sequencer: Sequencer::new(Parameters::default()),
            eyes,
            events: Events::new(),
            now: Duration::ZERO,
            position: 0,
            halted: false,
        };
        this.shows_for(200, REACHED);
        this
    }

    fn asks(&mut self, id: CommandId, reference: Reference, target: i32, start: BufferMode) {
        let command = MoveCommand {
            reference,
            target,
            set_point: SetPoint::new().buffer_mode(start),
            gated: false,
        };
        self.sequencer.submit(id, command, &mut self.events);
    }

    fn asks_abs(&mut self, id: CommandId, target: i32, start: BufferMode) -> &mut Self {
        self.asks(id, Reference::Absolute, target, start);
        self
    }

    /// One cycle in which the drive shows these bits.
    fn shows(&mut self, bits: u16) -> &mut Self {
        self.now += Duration::from_millis(1);
        let sent = self.sequencer.bits().word() | Controlword::from_bits_retain(0x0F);
        self.sequencer.mark_sent();
        let mut cycle = self.eyes.see(self.now, 0x0237 | bits, self.position, sent);
        cycle.halted = self.halted;
        self.sequencer.step(&cycle, &mut self.events);
        self
    }

    fn shows_for(&mut self, cycles: u32, bits: u16) -> &mut Self {
        for _ in 0..cycles {
            self.shows(bits);
        }
        self
    }

    /// The axis goes there in steps of so many counts.
    fn goes(&mut self, to: i32, step: usize, bits: u16) -> &mut Self {
        let from = self.position;
        let way = (to - from).signum();
        let step = i32::try_from(step).unwrap();
        while self.position != to {
            self.position += way * step.min((to - self.position).abs());
            self.shows(bits);
        }
        self
    }

    /// The drive takes the move that was asked for: bit 4 rises, bit 12 after it, and both fall. It shows these bits besides.
    fn takes(&mut self, bits: u16) -> &mut Self {
        let mut cycles = 0;
        while !self.bit_4() {
            self.shows(bits);
            cycles += 1;
            assert!(cycles < 10, "bit 4 does not rise");
        }
        self.shows(bits);
        self.shows(bits | ACKNOWLEDGE);
        assert!(!self.bit_4());
        self.shows_for(3, bits)
    }

    /// The same, and its buffer is full: bit 12 stays.
    fn fills(&mut self) -> &mut Self {
        while !self.bit_4() {
            self.shows(0);
        }
        self.shows(0).shows_for(4, ACKNOWLEDGE)
    }

    fn bit_4(&self) -> bool {
        self.sequencer.bits().word().bits() & 1 << 4 != 0
    }

    fn reports(&mut self) -> Vec<(CommandId, Event)> {
        core::iter::from_fn(|| self.events.pop()).collect()
    }

    /// The outcomes so far, without the acknowledges.
    fn outcomes(&mut self) -> Vec<(CommandId, Result<Completion, Failure>)> {
        let outcome = |(id, event)| match event {
            Event::Done(result) => Some((id, result)),
            Event::Accepted => None,
            other => panic!("{other:?}"),
        };
        self.reports().into_iter().filter_map(outcome).collect()
    }

    /// The doubt in which the only move has ended.
    fn doubt(&mut self) -> Doubt {
        match self.outcomes()[..] {
            [(_, Err(Failure::Unknown { doubt, .. }))] => doubt,
            ref other => panic!("{other:?}"),
        }
    }
}

const fn reached(position: i32) -> Result<Completion, Failure> {
    Ok(Completion::Reached { position })
}

#[test]
fn a_move_is_acknowledged_and_then_reached() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting).takes(0);
    assert_eq!(drive.reports(), [(FIRST, Event::Accepted)]);
    drive.goes(1000, 50, 0).shows(0);
    assert!(drive.outcomes().is_empty(), "bit 10 is low");
    drive.shows_for(5, REACHED);
    assert_eq!(drive.outcomes(), [(FIRST, reached(1000))]);
    assert!(!drive.sequencer.has_set_point());
}

#[test]
fn the_level_of_bit_12_acknowledges_nothing() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting);
    drive.shows_for(100, REACHED | ACKNOWLEDGE);
    assert!(!drive.bit_4() && drive.reports().is_empty());
    drive.shows_for(600, REACHED | ACKNOWLEDGE);
    let [
        (
            FIRST,
            Err(Failure::Timeout {
                waiting_for,
                delivery,
                ..
            }),
        ),
    ] = drive.outcomes()[..]
    else {
        panic!("a bit 12 that does not fall has a deadline");
    };
    assert_eq!(
        (waiting_for, delivery),
        (WaitingFor::AcknowledgeLow, Delivery::NotSent)
    );
}

#[test]
fn a_move_that_is_not_acknowledged_needs_a_stop() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting);
    drive.shows_for(600, REACHED);
    assert_eq!(drive.doubt(), Doubt::Unacknowledged);
    assert!(drive.sequencer.needs_stop() && drive.sequencer.has_set_point());
    drive.sequencer.lower();
    assert!(
        !drive.sequencer.needs_stop(),
        "the drive has left Operation enabled"
    );
}

#[test]
fn a_move_that_does_not_begin_needs_a_stop() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive
        .asks_abs(FIRST, 1000, BufferMode::Aborting)
        .takes(REACHED);
    drive.shows_for(1900, REACHED);
    assert!(drive.outcomes().is_empty());
    drive.shows_for(200, REACHED);
    assert_eq!(drive.doubt(), Doubt::NotBegun);
    assert!(drive.sequencer.needs_stop());
}

#[test]
fn a_move_whose_end_the_drive_does_not_show_needs_a_stop() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting).takes(0);
    drive.goes(1000, 50, 0).shows_for(2200, 0);
    assert_eq!(drive.doubt(), Doubt::StillLow);
    assert!(drive.sequencer.needs_stop());
}

#[test]
fn an_axis_that_an_input_holds_is_under_way() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting).takes(0);
    drive.goes(500, 50, 0).shows_for(5000, 0);
    assert!(drive.outcomes().is_empty() && !drive.sequencer.needs_stop());
    drive.goes(1000, 50, 0).shows_for(5, REACHED);
    assert_eq!(drive.outcomes(), [(FIRST, reached(1000))]);
}

#[test]
fn an_axis_at_rest_elsewhere_has_missed_its_target() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting).takes(0);
    drive.goes(600, 50, 0).shows_for(50, REACHED);
    assert!(drive.outcomes().is_empty());
    drive.shows_for(100, REACHED);
    let (target, actual) = (1000, 600);
    assert_eq!(
        drive.outcomes(),
        [(FIRST, Err(Failure::MissedTarget { target, actual }))]
    );
    assert!(!drive.sequencer.needs_stop());
}

#[test]
fn one_wrong_bit_10_ends_nothing() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting).takes(0);
    drive.goes(995, 50, 0).shows(REACHED).goes(1100, 50, 0);
    assert!(drive.outcomes().is_empty(), "it overshoots");
}

#[test]
fn a_move_to_where_the_axis_stands_is_over_with_the_settle_time() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive
        .asks_abs(FIRST, 3, BufferMode::Aborting)
        .takes(REACHED);
    drive.shows_for(5, REACHED);
    assert_eq!(drive.outcomes(), [(FIRST, reached(0))]);
}

#[test]
fn an_aborting_move_supersedes_the_other_when_it_is_acknowledged() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting).takes(0);
    drive.goes(500, 50, 0);
    drive.asks_abs(SECOND, -1000, BufferMode::Aborting);
    drive.shows_for(2, 0);
    assert!(drive.bit_4() && drive.outcomes().is_empty());
    drive.shows(ACKNOWLEDGE);
    assert_eq!(drive.outcomes(), [(FIRST, Err(Failure::Superseded))]);
    drive
        .shows_for(3, 0)
        .goes(-1000, 50, 0)
        .shows_for(5, REACHED);
    assert_eq!(drive.outcomes(), [(SECOND, reached(-1000))]);
}

#[test]
fn a_place_that_gets_free_shows_that_the_first_is_over() {
    let mut drive = SetPointDialogue::with(BufferSignal::Acknowledge);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting).takes(0);
    drive.asks_abs(SECOND, 1020, BufferMode::Buffered).fills();
    drive.asks_abs(THIRD, 0, BufferMode::Buffered);
    drive.goes(1000, 50, ACKNOWLEDGE).shows_for(10, ACKNOWLEDGE);
    assert!(
        drive.outcomes().is_empty() && !drive.bit_4(),
        "two are held"
    );
    drive.shows_for(4, 0);
    assert_eq!(drive.outcomes(), [(FIRST, reached(1000))]);
    assert!(drive.bit_4(), "there is room");
}

#[test]
fn a_clamped_move_with_another_behind_it_is_not_reached() {
    for step in [10, 20, 40] {
        let mut drive = SetPointDialogue::with(BufferSignal::Acknowledge);
        drive.asks_abs(FIRST, 6020, BufferMode::Aborting).takes(0);
        drive.asks_abs(SECOND, 8000, BufferMode::Buffered).fills();
        drive.goes(6000, 500, ACKNOWLEDGE);
        drive.shows_for(3, ACKNOWLEDGE | REACHED);
        // It goes on to the next one.
        drive.goes(7000, step, 0);
        let outcomes = drive.outcomes();
        assert!(
            matches!(outcomes[..], [(FIRST, Err(_))]),
            "{step}: {outcomes:?}"
        );
    }
}

#[test]
fn half_of_the_way_to_the_next_end_shows_that_the_first_is_over() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting).takes(0);
    drive.asks_abs(SECOND, 2000, BufferMode::Blending).takes(0);
    drive.goes(1000, 10, 0).goes(1490, 10, 0).shows_for(300, 0);
    assert!(drive.outcomes().is_empty());
    drive.goes(1600, 10, 0).shows_for(150, 0);
    assert_eq!(
        drive.outcomes(),
        [(FIRST, Ok(Completion::Passed { position: 1600 }))]
    );
}

#[test]
fn rest_ends_both_on_a_drive_that_shows_nothing() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting).takes(0);
    drive.asks_abs(SECOND, 1020, BufferMode::Buffered).takes(0);
    drive.asks_abs(THIRD, 0, BufferMode::Buffered);
    drive
        .goes(1000, 10, 0)
        .shows_for(20, REACHED)
        .goes(1020, 2, 0);
    assert!(drive.outcomes().is_empty() && !drive.bit_4());
    drive.shows_for(3000, REACHED);
    let outcomes = drive.outcomes();
    assert_eq!(
        outcomes[0],
        (FIRST, reached(1010)),
        "where it was seen last while it could be the active one"
    );
    assert_eq!(outcomes[1], (SECOND, reached(1020)));
}

#[test]
fn while_the_axis_is_halted_bit_10_says_nothing_of_set_points() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting).takes(0);
    drive.goes(500, 50, 0);
    drive.halted = true;
    drive.shows_for(5000, REACHED);
    assert!(drive.outcomes().is_empty());
    drive.halted = false;
    drive
        .shows_for(3, 0)
        .goes(1000, 50, 0)
        .shows_for(5, REACHED);
    assert_eq!(drive.outcomes(), [(FIRST, reached(1000))]);
}

#[test]
fn a_distance_counts_from_where_the_axis_stands() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.goes(700, 50, REACHED).shows_for(200, REACHED);
    drive.asks(FIRST, Reference::Relative, -300, BufferMode::Aborting);
    drive.takes(0).goes(400, 50, 0).shows_for(5, REACHED);
    assert_eq!(drive.outcomes(), [(FIRST, reached(400))]);
}

#[test]
fn what_ends_the_motion_says_how_far_each_set_point_came() {
    let mut drive = SetPointDialogue::with(BufferSignal::None);
    drive.asks_abs(FIRST, 1000, BufferMode::Aborting).takes(0);
    drive.asks_abs(SECOND, 2000, BufferMode::Buffered);
    drive.shows_for(2, 0);
    assert!(drive.bit_4());
    drive.asks_abs(THIRD, 3000, BufferMode::Buffered);
    drive.reports();
    let lost = Failure::BusLost {
        delivery: Delivery::NotSent,
    };
    drive.sequencer.fail_all(lost, &mut drive.events);
    let mut outcomes = drive.outcomes();
    outcomes.sort_by_key(|(id, _)| id.0);
    let with = |delivery| Err(Failure::BusLost { delivery });
    assert_eq!(
        outcomes,
        vec![
            (FIRST, with(Delivery::Accepted)),
            (SECOND, with(Delivery::Unknown)),
            (THIRD, with(Delivery::NotSent)),
        ]
    );
    assert!(drive.bit_4(), "no edge is invented");
    drive.sequencer.lower();
    assert!(!drive.bit_4() && !drive.sequencer.has_set_point());
}
