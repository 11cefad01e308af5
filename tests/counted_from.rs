//! From when things count: inputs that decode to no state, a rest before a quick stop, a set-point before a resume.
#![allow(missing_docs)]

use core::time::Duration;

use servocrab::axis::{
    AxisCore, AxisFields, Command, CommandId, Completion, CoreConfig, Event, Failure, Inputs,
    Referencing,
};
use servocrab::ds402::{Mode, QuickStopOption, State};
use servocrab::profile_position::{BufferSignal, MoveCommand, Reference, SetPoint};

const SWITCHED_ON: u16 = 0x0233;
const ENABLED: u16 = 0x0237;
const QUICK_STOP_ACTIVE: u16 = 0x0217;
/// Bits 0 to 6 of no state.
const NO_STATE: u16 = 0x0201;
/// Bit 10, target reached.
const REACHED: u16 = 1 << 10;
const BIT_4: u16 = 1 << 4;
const BIT_12: u16 = 1 << 12;

const SETTLE: u64 = 100;
/// `Deadlines::begin`.
const BEGIN: u64 = 2_000;

/// A core whose inputs are written by the test, a millisecond at a time.
struct Played {
    core: AxisCore,
    outputs: [u8; 6],
    events: Vec<(CommandId, Event)>,
    now: u64,
    position: i32,
    next: u32,
}

impl Played {
    fn new() -> Self {
        let mut config = CoreConfig::new(AxisFields::at(0, 0));
        config.quick_stop = QuickStopOption(6);
        config.referencing = Referencing::AbsoluteEncoder;
        config.traits.buffer_signal = BufferSignal::None;
        let mut played = Self {
            core: AxisCore::new(config),
            outputs: [0; 6],
            events: Vec::new(),
            now: 0,
            position: 0,
            next: 0,
        };
        played.core.note_mode(Mode::ProfilePosition);
        played.shows(200, 0x0250);
        let enable = played.send(Command::Enable);
        for word in [0x0231, SWITCHED_ON, ENABLED, ENABLED, ENABLED] {
            played.shows(2, word);
        }
        assert_eq!(played.outcome(enable), Some(Ok(Completion::Done)));
        played
    }

    /// With a set-point that was taken at rest and has not begun, in the cycle that shows that.
    fn acknowledged() -> (Self, CommandId) {
        let mut played = Self::new();
        played.shows(200, ENABLED | REACHED);
        let id = played.send(Command::Move(MoveCommand {
            reference: Reference::Absolute,
            target: 1_000_000,
            set_point: SetPoint::new(),
            gated: false,
        }));
        played.shows(1, ENABLED | REACHED);
        assert_ne!(played.word() & BIT_4, 0);
        while !played.events.contains(&(id, Event::Accepted)) {
            played.shows(1, ENABLED | REACHED | BIT_12);
            assert!(played.now < 1_000, "it is not taken");
        }
        (played, id)
    }

    /// The same, with its handshake over.
    fn waiting() -> (Self, CommandId) {
        let (mut played, id) = Self::acknowledged();
        played.shows(3, ENABLED | REACHED);
        (played, id)
    }

    fn send(&mut self, command: Command) -> CommandId {
        self.next += 1;
        let id = CommandId(self.next);
        let now = Duration::from_millis(self.now);
        self.core.submit(now, id, command, &mut self.outputs);
        id
    }

    fn bytes(&self, statusword: u16) -> [u8; 6] {
        let mut inputs = [0; 6];
        inputs[..2].copy_from_slice(&statusword.to_le_bytes());
        inputs[2..].copy_from_slice(&self.position.to_le_bytes());
        inputs
    }

    fn step(&mut self, inputs: Inputs<'_>) {
        self.now += 1;
        let now = Duration::from_millis(self.now);
        self.core.step(now, inputs, &mut self.outputs);
        while let Some(event) = self.core.poll_event() {
            self.events.push(event);
        }
    }

    fn shows(&mut self, cycles: u64, statusword: u16) {
        for _ in 0..cycles {
            let inputs = self.bytes(statusword);
            self.step(Inputs::Fresh(&inputs));
        }
    }

    /// The same while the axis goes ten counts in each cycle.
    fn shows_moving(&mut self, cycles: u64, statusword: u16) {
        for _ in 0..cycles {
            self.position += 10;
            self.shows(1, statusword);
        }
    }

    fn word(&self) -> u16 {
        u16::from_le_bytes([self.outputs[0], self.outputs[1]])
    }

    fn outcome(&self, id: CommandId) -> Option<Result<Completion, Failure>> {
        self.events.iter().find_map(|&(of, event)| match event {
            Event::Done(result) if of == id => Some(result),
            _ => None,
        })
    }

    /// After how many cycles with this word the command has ended.
    fn cycles_to_end(&mut self, id: CommandId, statusword: u16) -> u64 {
        let from = self.now;
        while self.outcome(id).is_none() {
            self.shows(1, statusword);
            assert!(self.now - from < 60_000, "it has no end");
        }
        self.now - from
    }
}

#[test]
fn a_word_of_no_state_brings_no_inputs() {
    let mut played = Played::new();
    let before = played.core.snapshot();
    played.position = 5_000;
    for age in 1..10 {
        played.shows(1, NO_STATE);
        let shown = played.core.snapshot();
        assert_eq!((shown.age, shown.answered, shown.lost), (age, false, false));
        assert_eq!(shown.position, before.position);
        assert_eq!(shown.statusword, before.statusword);
    }
    played.shows(1, NO_STATE);
    assert!(played.core.snapshot().lost, "as after as many lost frames");
}

/// The drive answers every second cycle, and what it got is not known then.
#[test]
fn outputs_are_not_delivered_by_a_word_of_no_state() {
    let mut played = Played::new();
    let mut cycles = 0;
    while !played.core.snapshot().lost {
        let (known, unknown) = (played.bytes(ENABLED), played.bytes(NO_STATE));
        played.step(Inputs::Answered(&known));
        played.step(Inputs::Fresh(&unknown));
        cycles += 2;
        assert!(cycles <= 30, "undelivered for {cycles} cycles");
    }
    assert_eq!(cycles, 30);
}

/// Before the next edge of bit 4 the drive has to have seen it low, for two of its cycles.
#[test]
fn words_of_no_state_do_not_show_that_bit_4_was_seen_low() {
    let (mut played, _) = Played::acknowledged();
    let next = played.send(Command::Move(MoveCommand {
        reference: Reference::Absolute,
        target: 2_000_000,
        set_point: SetPoint::new(),
        gated: false,
    }));
    played.shows(5, NO_STATE);
    for _ in 0..2 {
        assert_eq!(played.word() & BIT_4, 0);
        played.shows(1, ENABLED | REACHED);
    }
    assert_eq!(played.word() & BIT_4, 0);
    played.shows(1, ENABLED | REACHED);
    assert_ne!(played.word() & BIT_4, 0);
    assert_eq!(played.outcome(next), None);
}

/// A drive that shows another state for a moment takes the quick stop after that. Until then it may drive the axis.
#[test]
fn a_rest_counts_from_a_quick_stop_that_was_come_to_by_way_of_another_state() {
    for before in [10, 60, 90] {
        let (mut played, _) = Played::waiting();
        played.shows_moving(300, ENABLED);
        let stop = played.send(Command::QuickStop);
        played.shows_moving(5, ENABLED);
        // It is at a turn, or its inputs are late: the position stays.
        played.shows(before, SWITCHED_ON);
        let took = played.cycles_to_end(stop, QUICK_STOP_ACTIVE);
        assert!(
            (SETTLE..SETTLE + 5).contains(&took),
            "{took} ms after {before} ms in Switched on"
        );
        let state = State::QuickStopActive;
        assert_eq!(
            played.outcome(stop),
            Some(Ok(Completion::Stopped { state }))
        );
    }
}

#[test]
fn a_set_point_that_shows_nothing_has_its_whole_time_to_begin_after_a_resume() {
    for halted_after in [100, BEGIN / 2, BEGIN - 100] {
        let (mut played, id) = Played::waiting();
        played.shows(halted_after, ENABLED | REACHED);
        let halt = played.send(Command::Halt);
        played.shows(2 * BEGIN, ENABLED | REACHED);
        assert!(played.outcome(halt).is_some_and(|halted| halted.is_ok()));
        assert_eq!(played.outcome(id), None);
        played.send(Command::Resume);
        let took = played.cycles_to_end(id, ENABLED | REACHED);
        assert!(
            (BEGIN..BEGIN + 10).contains(&took),
            "{halted_after}: {took}"
        );
        let not_begun = Failure::NotBegun { actual: 0 };
        assert_eq!(played.outcome(id), Some(Err(not_begun)));
    }
}

#[test]
fn a_set_point_that_begins_late_after_a_resume_is_under_way() {
    let (mut played, id) = Played::waiting();
    played.shows(BEGIN - 100, ENABLED | REACHED);
    played.send(Command::Halt);
    played.shows(500, ENABLED | REACHED);
    played.send(Command::Resume);
    played.shows(BEGIN - 50, ENABLED | REACHED);
    played.shows_moving(2 * BEGIN, ENABLED);
    assert_eq!(played.outcome(id), None);
    played.position = 1_000_000;
    played.cycles_to_end(id, ENABLED | REACHED);
    let position = 1_000_000;
    assert_eq!(
        played.outcome(id),
        Some(Ok(Completion::Reached { position }))
    );
}
