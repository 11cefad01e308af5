//! The handshake as a dialogue: what the drive shows, and which words and reports follow, frame by frame of 1 ms.

use alloc::vec::Vec;

use crate::{
    ds402::{Controlword, Mode, Statusword},
    profile_position::{
        BufferSignal, Completion, LastSeen, Limits, SetPoint, Standstill, StartBits, Traits,
    },
};

use super::*;

const ACKNOWLEDGE: Statusword = Statusword::SET_POINT_ACKNOWLEDGE;
const REACHED: Statusword = Statusword::TARGET_REACHED;
const REMOTE: Statusword = Statusword::REMOTE;
/// Deadline of each wait for bit 12, in frames.
const LATE: u64 = 500;

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

struct Dialogue {
    sequencer: Sequencer,
    events: Events,
    standstill: Standstill,
    traits: Traits,
    now: Duration,
    word: Statusword,
    position: i32,
    delivered: bool,
    halted: bool,
    next_id: u32,
}

impl Dialogue {
    /// An axis that stands at 0, on a drive that is ready for a set-point.
    fn begin(traits: Traits) -> Self {
        let mut this = Self {
            sequencer: Sequencer::new(Parameters::default()),
            events: Events::new(),
            standstill: Standstill::default(),
            traits,
            now: ms(10_000),
            word: REACHED,
            position: 0,
            delivered: true,
            halted: false,
            next_id: 0,
        };
        this.frames(150);
        this
    }

    /// On a drive whose bit 12 shows that its buffer is full.
    fn buffered() -> Self {
        Self::begin(Traits {
            buffer_signal: BufferSignal::Acknowledge,
            ..Traits::cia402()
        })
    }

    /// One frame: the outputs go out, and this is what comes back. Whether a set-point was acknowledged.
    fn frame(&mut self) -> bool {
        self.now += ms(1);
        self.sequencer.mark_sent(self.now);
        let (position, now) = (self.position, self.now);
        let bounds = Bounds::new(10, Some(0), ms(100), ms(1), None);
        self.standstill.update(now, position, None, &bounds);
        self.does(Sequencer::step)
    }

    /// Does this with what the frame has shown.
    fn does<R>(&mut self, of: impl FnOnce(&mut Sequencer, &Cycle<'_>, &mut Events) -> R) -> R {
        let sample = Sample {
            statusword: self.word,
            mode: Mode::ProfilePosition,
            position: self.position,
            velocity: None,
            error_code: None,
        };
        let cycle = Cycle {
            now: self.now,
            sample: &sample,
            standstill: &self.standstill,
            bounds: &Bounds::new(10, Some(0), ms(100), ms(1), None),
            last_seen: &LastSeen::default(),
            traits: &self.traits,
            limits: &Limits::trust_drive(),
            referenced: true,
            delivered: self.delivered,
            halted: self.halted,
            blind: 0,
            stalled: 0,
            bit_11_is_valid: true,
            acknowledge: ms(LATE),
            begin: ms(2_000),
            controlword: self.sequencer.bits().word(),
        };
        of(&mut self.sequencer, &cycle, &mut self.events)
    }

    fn frames(&mut self, count: u64) {
        for _ in 0..count {
            self.frame();
        }
    }

    fn is_high(&self) -> bool {
        self.sequencer
            .bits()
            .word()
            .contains(Controlword::NEW_SET_POINT)
    }

    /// Asks for a move, and does nothing else.
    fn ask(&mut self, command: MoveCommand) -> CommandId {
        self.next_id += 1;
        let id = CommandId(self.next_id);
        self.sequencer.submit(id, command, &mut self.events);
        id
    }

    /// The same up to its acknowledge; bit 12 stays high.
    fn accept(&mut self, command: MoveCommand) -> CommandId {
        let id = self.ask(command);
        self.frame();
        assert!(self.is_high(), "{:?}", self.reports());
        // What the frame shows that brings it is from before.
        assert!(!self.frame());
        self.word |= ACKNOWLEDGE;
        assert!(self.frame() && !self.is_high());
        assert_eq!(self.reports(), [(id, Event::Accepted)]);
        id
    }

    /// Half way from 0 to 1000 on a drive with a buffer.
    fn half_way() -> (Self, CommandId) {
        let mut this = Self::buffered();
        this.word -= REACHED;
        let first = this.accept(to(1_000, BufferMode::Aborting));
        this.word -= ACKNOWLEDGE;
        this.position = 500;
        this.frames(10);
        (this, first)
    }

    /// With the active set-point of a drive and one behind it: its buffer is full.
    fn full() -> (Self, [CommandId; 2]) {
        let mut this = Self::buffered();
        this.word -= REACHED;
        let first = this.accept(to(10_000, BufferMode::Aborting));
        this.frame();
        this.word -= ACKNOWLEDGE;
        // One word that shows a place may be wrong.
        this.frames(3);
        let second = this.accept(to(20_000, BufferMode::Buffered));
        this.frames(5);
        (this, [first, second])
    }

    fn reports(&mut self) -> Vec<(CommandId, Event)> {
        core::iter::from_fn(|| self.events.pop()).collect()
    }

    /// That this is all that was reported: the move waited for this in vain, and was so far.
    #[track_caller]
    fn is_timed_out(&mut self, id: CommandId, wait: WaitingFor, came: Delivery) {
        let reports = self.reports();
        assert!(
            matches!(
                reports[..],
                [(of, Event::Done(Err(Failure::Timeout { waiting_for, delivery, .. })))]
                    if of == id && waiting_for == wait && delivery == came
            ),
            "{reports:?}"
        );
    }
}

fn to(target: i32, buffer_mode: BufferMode) -> MoveCommand {
    MoveCommand {
        reference: Reference::Absolute,
        target,
        set_point: SetPoint::new().buffer_mode(buffer_mode),
        gated: false,
    }
}

fn failed(id: CommandId, failure: Failure) -> (CommandId, Event) {
    (id, Event::Done(Err(failure)))
}

#[test]
fn moves_wait_in_order_and_one_that_replaces_all_overtakes() {
    let mut pending = PendingMoves::default();
    assert!(pending.is_empty() && pending.first().is_none() && pending.last().is_none());
    let buffered = to(1, BufferMode::Buffered);
    for id in 1..=3 {
        assert!(pending.push(CommandId(id), buffered));
    }
    assert!(pending.push(CommandId(4), to(1, BufferMode::Aborting)));
    assert!(!pending.push(CommandId(5), buffered), "four wait at most");
    let first = |pending: &PendingMoves| pending.first().map(|request| request.id.0);
    let last = |pending: &PendingMoves| pending.last().map(|request| request.id.0);
    assert_eq!((first(&pending), last(&pending)), (Some(4), Some(4)));
    let overtaken =
        |pending: &mut PendingMoves| pending.pop_overtaken().map(|request| request.id.0);
    assert_eq!(overtaken(&mut pending), None, "it is not taken yet");
    // Those before it are taken out one by one, and then none.
    pending.take_turn();
    assert!(pending.push(CommandId(6), buffered));
    assert_eq!(overtaken(&mut pending), Some(1));
    assert_eq!(last(&pending), Some(6));
    assert!(pending.remove(CommandId(2)));
    assert_eq!(overtaken(&mut pending), Some(3));
    assert_eq!(overtaken(&mut pending), None);
    assert_eq!(pending.pop().map(|request| request.id.0), Some(6));
    assert!(pending.is_empty() && pending.pop().is_none());

    for id in 1..=4 {
        assert!(pending.push(CommandId(id), buffered));
    }
    assert!(!pending.remove(CommandId(5)));
    assert!(pending.remove(CommandId(2)) && !pending.remove(CommandId(2)));
    let left = core::iter::from_fn(|| pending.pop().map(|request| request.id.0));
    assert_eq!(left.collect::<Vec<_>>(), [1, 3, 4]);
}

#[test]
fn a_fifth_move_that_waits_is_refused() {
    let mut dialogue = Dialogue::buffered();
    dialogue.halted = true;
    for _ in 0..4 {
        dialogue.ask(to(1_000, BufferMode::Buffered));
    }
    assert_eq!(dialogue.reports(), []);
    let refused = dialogue.ask(to(1_000, BufferMode::Buffered));
    assert_eq!(dialogue.reports(), [failed(refused, Failure::Busy)]);
}

#[test]
fn bit_4_is_high_until_bit_12_and_low_until_the_drive_has_seen_it() {
    let mut dialogue = Dialogue::begin(Traits::cia402());
    dialogue.accept(to(10_000, BufferMode::Aborting));
    // Its bit 12 falls, which shows that the low was seen.
    let next = dialogue.ask(to(20_000, BufferMode::Aborting));
    dialogue.frames(2);
    assert!(!dialogue.is_high());
    dialogue.word -= ACKNOWLEDGE;
    dialogue.frame();
    assert!(dialogue.is_high());
    assert_eq!(dialogue.sequencer.target(), 20_000);
    assert_eq!(dialogue.reports(), []);
    assert!(
        dialogue
            .sequencer
            .withdraw(next, Failure::NeedsStop, &mut dialogue.events)
    );
    assert_eq!(dialogue.reports(), [failed(next, Failure::NeedsStop)]);
    assert!(!dialogue.is_high());
}

/// It may be that of a full buffer, whatever is known of the drive: what the drive holds may have been reported as over. One word
/// that shows it low may be wrong.
#[test]
fn after_a_bit_12_that_stays_high_the_next_goes_when_more_than_one_word_shows_it_low() {
    for buffer_signal in [BufferSignal::None, BufferSignal::Unknown] {
        let mut dialogue = Dialogue::begin(Traits {
            buffer_signal,
            ..Traits::cia402()
        });
        dialogue.accept(to(10_000, BufferMode::Aborting));
        dialogue.ask(to(20_000, BufferMode::Aborting));
        dialogue.frames(20);
        dialogue.word -= ACKNOWLEDGE;
        dialogue.frame();
        dialogue.word |= ACKNOWLEDGE;
        dialogue.frames(2);
        assert!(!dialogue.is_high());
        dialogue.word -= ACKNOWLEDGE;
        dialogue.frames(2);
        assert!(!dialogue.is_high());
        dialogue.frame();
        assert!(dialogue.is_high());
    }
}

/// Where bit 12 was low already, two of the drive's cycles show it.
#[test]
fn a_low_that_no_fall_of_bit_12_shows_is_seen_after_two_cycles_of_the_drive() {
    let mut dialogue = Dialogue::begin(Traits::cia402());
    let first = dialogue.ask(to(10_000, BufferMode::Aborting));
    dialogue.frame();
    assert!(
        dialogue
            .sequencer
            .withdraw(first, Failure::NeedsStop, &mut dialogue.events)
    );
    dialogue.delivered = false;
    dialogue.ask(to(20_000, BufferMode::Aborting));
    dialogue.frames(20);
    dialogue.delivered = true;
    dialogue.frames(2);
    assert!(!dialogue.is_high());
    dialogue.frame();
    assert!(dialogue.is_high());
}

#[test]
fn an_acknowledge_that_does_not_come_in_time_leaves_the_set_point_unknown() {
    let mut dialogue = Dialogue::begin(Traits::cia402());
    let lost = dialogue.ask(to(10_000, BufferMode::Aborting));
    dialogue.frame();
    let waits = dialogue.ask(to(20_000, BufferMode::Buffered));
    dialogue.frames(LATE);
    assert!(dialogue.is_high() && dialogue.reports().is_empty());
    assert!(!dialogue.sequencer.is_unknown() && dialogue.sequencer.has_set_point());
    dialogue.frame();
    assert!(!dialogue.is_high());
    let reports = dialogue.reports();
    assert_eq!(reports[1..], [failed(waits, Failure::NeedsStop)]);
    for (id, event) in &reports[..1] {
        dialogue.events.push(*id, *event);
    }
    dialogue.is_timed_out(lost, WaitingFor::Acknowledge, Delivery::Unknown);
    assert!(dialogue.sequencer.is_unknown() && dialogue.sequencer.has_set_point());
    assert!(!dialogue.sequencer.is_idle() && !dialogue.sequencer.holds_any());
    dialogue.sequencer.lower();
    assert!(dialogue.sequencer.is_idle() && !dialogue.sequencer.has_set_point());
}

/// The time counts while bit 12 is in the way, and anew when it was not.
#[test]
fn a_move_waits_for_the_low_of_bit_12_for_its_time_without_a_break() {
    let mut dialogue = Dialogue::begin(Traits::cia402());
    dialogue.word |= ACKNOWLEDGE;
    let id = dialogue.ask(to(10_000, BufferMode::Aborting));
    dialogue.frames(LATE - 2);
    // Free for some frames, whose outputs were not delivered.
    dialogue.word -= ACKNOWLEDGE;
    dialogue.delivered = false;
    dialogue.frames(3);
    dialogue.delivered = true;
    dialogue.word |= ACKNOWLEDGE;
    dialogue.frames(LATE);
    assert!(dialogue.reports().is_empty() && !dialogue.is_high());
    dialogue.frame();
    dialogue.is_timed_out(id, WaitingFor::AcknowledgeLow, Delivery::NotSent);
    assert!(dialogue.sequencer.is_idle());
}

/// Bit 12 is high all the time: the fourth frame that can show what the drive did with bit 4 says that it has taken the set-point.
#[test]
fn on_a_full_buffer_bit_4_falls_after_the_frames_in_which_the_drive_can_have_seen_it() {
    let (mut dialogue, [first, second]) = Dialogue::full();
    let id = dialogue.ask(to(-500, BufferMode::Aborting));
    dialogue.frame();
    assert!(dialogue.is_high(), "bit 12 is that of the buffer");
    // Delivered in the first frame, and surely seen two cycles later.
    for frame in 1..=5 {
        dialogue.frame();
        assert!(dialogue.is_high(), "{frame}");
    }
    dialogue.frame();
    assert!(!dialogue.is_high() && dialogue.reports().is_empty());
    assert!(dialogue.sequencer.has_set_point());
    // Bit 12 falls, which is its acknowledge.
    dialogue.frames(20);
    assert!(dialogue.reports().is_empty());
    dialogue.word -= ACKNOWLEDGE;
    assert!(dialogue.frame());
    let superseded = |id| failed(id, Failure::Superseded);
    let accepted = (id, Event::Accepted);
    assert_eq!(
        dialogue.reports(),
        [accepted, superseded(first), superseded(second)]
    );
}

#[test]
fn a_set_point_on_a_full_buffer_that_stays_full_is_given_up_in_time() {
    let (mut dialogue, _) = Dialogue::full();
    let id = dialogue.ask(to(-500, BufferMode::Aborting));
    dialogue.frames(1 + LATE);
    assert!(dialogue.reports().is_empty() && !dialogue.is_high());
    dialogue.frame();
    dialogue.is_timed_out(id, WaitingFor::AcknowledgeLow, Delivery::Unknown);
    assert!(dialogue.sequencer.is_unknown());
}

#[test]
fn bit_12_of_the_frame_that_brings_bit_4_is_no_answer() {
    let mut dialogue = Dialogue::begin(Traits::cia402());
    let id = dialogue.ask(to(1_000, BufferMode::Aborting));
    dialogue.frame();
    dialogue.word |= ACKNOWLEDGE;
    assert!(dialogue.is_high() && !dialogue.frame());
    // It falls, and the answer comes.
    dialogue.word -= ACKNOWLEDGE;
    dialogue.frames(3);
    assert!(dialogue.is_high() && dialogue.reports().is_empty());
    dialogue.word |= ACKNOWLEDGE;
    assert!(dialogue.frame() && !dialogue.is_high());
    assert_eq!(dialogue.reports(), [(id, Event::Accepted)]);
}

#[test]
fn the_second_of_a_drive_goes_when_more_than_one_word_shows_a_place() {
    let mut dialogue = Dialogue::buffered();
    dialogue.word -= REACHED;
    dialogue.accept(to(10_000, BufferMode::Aborting));
    dialogue.frame();
    dialogue.ask(to(20_000, BufferMode::Buffered));
    dialogue.word -= ACKNOWLEDGE;
    dialogue.frames(2);
    assert!(!dialogue.is_high());
    dialogue.frame();
    assert!(dialogue.is_high());
}

/// Bit 12 stays high from the frame that brings bit 4. The drive has no place for it.
#[test]
fn one_behind_that_met_a_full_buffer_is_not_known_to_be_taken() {
    let mut dialogue = Dialogue::buffered();
    dialogue.word -= REACHED;
    dialogue.accept(to(10_000, BufferMode::Aborting));
    dialogue.word -= ACKNOWLEDGE;
    dialogue.frames(5);
    let id = dialogue.ask(to(20_000, BufferMode::Buffered));
    dialogue.frame();
    dialogue.word |= ACKNOWLEDGE;
    dialogue.frames(10);
    dialogue.is_timed_out(id, WaitingFor::Acknowledge, Delivery::Unknown);
    assert!(dialogue.sequencer.is_unknown());
}

/// One wrong word shows a place where there is none.
#[test]
fn one_wrong_word_neither_frees_a_place_nor_acknowledges_what_was_just_sent() {
    // With a move that waits, nothing goes out.
    let (mut dialogue, _) = Dialogue::full();
    dialogue.ask(to(20_000, BufferMode::Buffered));
    dialogue.frames(3);
    dialogue.word -= ACKNOWLEDGE;
    dialogue.frame();
    dialogue.word |= ACKNOWLEDGE;
    assert!(!dialogue.is_high());
    dialogue.frames(300);
    assert!(dialogue.reports().is_empty() && !dialogue.is_high());

    // One that replaces all goes out with that word. The level that comes back with it is from before.
    let (mut dialogue, _) = Dialogue::full();
    dialogue.frames(3);
    dialogue.word -= ACKNOWLEDGE;
    dialogue.ask(to(-500, BufferMode::Aborting));
    dialogue.frame();
    dialogue.word |= ACKNOWLEDGE;
    assert!(dialogue.is_high() && !dialogue.frame());
    assert!(dialogue.reports().is_empty() && dialogue.is_high());
}

/// A place became free before the drive took it: an edge of bit 12 acknowledges it.
#[test]
fn a_buffer_that_frees_a_place_acknowledges_by_an_edge() {
    let (mut dialogue, _) = Dialogue::full();
    let id = dialogue.ask(to(-500, BufferMode::Aborting));
    dialogue.frames(2);
    // One word that shows a place is wrong, perhaps: the level that follows is no edge.
    dialogue.word -= ACKNOWLEDGE;
    dialogue.frame();
    dialogue.word |= ACKNOWLEDGE;
    assert!(!dialogue.frame() && dialogue.is_high());
    assert!(dialogue.reports().is_empty());
    dialogue.word -= ACKNOWLEDGE;
    dialogue.frames(3);
    dialogue.reports();
    dialogue.word |= ACKNOWLEDGE;
    assert!(dialogue.frame() && !dialogue.is_high());
    assert_eq!(dialogue.reports().first(), Some(&(id, Event::Accepted)));
}

/// Bit 9 low: the drive follows no edge, and its bit 12 falls all the same when the active one ends.
#[test]
fn under_local_control_a_set_point_on_a_full_buffer_is_given_up_at_once() {
    let give_up = |was_remote: bool| {
        let (mut dialogue, _) = Dialogue::full();
        if was_remote {
            dialogue.word |= REMOTE;
        }
        dialogue.frames(2);
        let id = dialogue.ask(to(-500, BufferMode::Aborting));
        dialogue.frame();
        assert!(dialogue.is_high());
        dialogue.word -= REMOTE;
        dialogue.frame();
        (dialogue, id)
    };
    let (mut dialogue, id) = give_up(true);
    assert!(!dialogue.is_high());
    dialogue.is_timed_out(id, WaitingFor::Acknowledge, Delivery::Unknown);
    assert!(dialogue.sequencer.is_unknown());
    // Of a drive that never shows bit 9 its low says nothing.
    let (mut dialogue, _) = give_up(false);
    assert!(dialogue.is_high() && dialogue.reports().is_empty());
    // With a place in the buffer the edge is waited for.
    let mut dialogue = Dialogue::begin(Traits::cia402());
    dialogue.word |= REMOTE;
    dialogue.frame();
    dialogue.ask(to(10_000, BufferMode::Aborting));
    dialogue.frame();
    dialogue.word -= REMOTE;
    dialogue.frames(20);
    assert!(dialogue.is_high() && dialogue.reports().is_empty());
}

/// The second one ends in motion near the end of the first, and the axis swings past both before the drive sets off for it.
#[test]
fn an_axis_that_swings_past_the_end_of_one_that_ends_in_motion_is_not_there() {
    let passes = |stays: bool| {
        let (mut dialogue, first) = Dialogue::half_way();
        let mut command = to(40, BufferMode::Buffered);
        command.reference = Reference::Relative;
        command.set_point.parameters.end_velocity = Some(20_000);
        let second = dialogue.accept(command);
        dialogue.frames(5);
        dialogue.position = 995;
        dialogue.frame();
        dialogue.word = REACHED;
        dialogue.position = 1_118;
        dialogue.frames(50);
        let (position, reached) = (995, |of, position| {
            (of, Event::Done(Ok(Completion::Reached { position })))
        });
        assert_eq!(dialogue.reports(), [reached(first, position)]);
        dialogue.position = if stays { 1_118 } else { 1_020 };
        dialogue.frames(90);
        (dialogue.reports(), reached(second, 1_118))
    };
    let (reports, _) = passes(false);
    assert_eq!(reports, []);
    let (reports, reached) = passes(true);
    assert_eq!(reports, [reached]);
}

/// The drive may be at the end of the first one on its way to that of the second, which it has taken and not acknowledged yet.
#[test]
fn a_move_does_not_end_while_one_that_replaces_it_may_have_been_taken() {
    let reports = |buffer_mode| {
        let (mut dialogue, first) = Dialogue::half_way();
        let second = dialogue.ask(to(5_000, buffer_mode));
        dialogue.frame();
        assert!(dialogue.is_high());
        dialogue.position = 1_000;
        dialogue.word |= REACHED;
        dialogue.frames(200);
        (first, second, dialogue.reports())
    };
    let (_, _, none) = reports(BufferMode::Aborting);
    assert_eq!(none, []);
    let (first, _, ended) = reports(BufferMode::Buffered);
    let position = 1_000;
    let reached = Event::Done(Ok(Completion::Reached { position }));
    assert_eq!(ended, [(first, reached)]);
}

/// The axis passes its target before the acknowledge, and swings to where the next one leads.
#[test]
fn a_move_that_has_come_to_its_end_before_its_acknowledge_has_not_missed_it() {
    let ends = |passed: i32| {
        let mut dialogue = Dialogue::begin(Traits::cia402());
        let first = dialogue.ask(to(1_000, BufferMode::Aborting));
        dialogue.frames(2);
        dialogue.word -= REACHED;
        dialogue.position = 500;
        dialogue.frame();
        dialogue.word |= REACHED;
        dialogue.position = passed;
        dialogue.frame();
        dialogue.position = 976;
        dialogue.word |= ACKNOWLEDGE;
        assert!(dialogue.frame());
        assert_eq!(dialogue.reports(), [(first, Event::Accepted)]);
        dialogue.word -= ACKNOWLEDGE;
        dialogue.frames(5);
        let second = dialogue.accept(to(976, BufferMode::Buffered));
        dialogue.word -= ACKNOWLEDGE;
        dialogue.frames(2_000);
        let reports = dialogue.reports();
        let last = (
            second,
            Event::Done(Ok(Completion::Reached { position: 976 })),
        );
        assert_eq!(reports.last(), Some(&last));
        reports[0]
    };
    let (target, actual) = (1_000, 976);
    let failed = |failure| Event::Done(Err(failure));
    let unseen = failed(Failure::Unseen { target, actual });
    assert_eq!(ends(1_008).1, unseen);
    let missed = failed(Failure::MissedTarget { target, actual });
    assert_eq!(ends(970).1, missed);
}

#[test]
fn a_gated_move_is_armed_while_it_has_all_that_it_needs() {
    let mut dialogue = Dialogue::begin(Traits::cia402());
    let gated = |target| MoveCommand {
        gated: true,
        ..to(target, BufferMode::Aborting)
    };
    let id = dialogue.ask(gated(1_000));
    assert!(!dialogue.sequencer.is_armed(id));
    dialogue.frame();
    assert!(dialogue.sequencer.is_armed(id) && !dialogue.is_high());
    assert!(!dialogue.sequencer.is_armed(CommandId(99)));
    dialogue.sequencer.disarm();
    assert!(!dialogue.sequencer.is_armed(id));
    dialogue.frame();
    // A move that is asked for behind it changes nothing; one that is in turn before it does.
    dialogue.ask(to(2_000, BufferMode::Buffered));
    assert!(dialogue.sequencer.is_armed(id));
    let fire = |dialogue: &mut Dialogue, id| {
        dialogue.does(|sequencer, cycle, _| sequencer.fire(id, cycle));
        assert!(dialogue.reports().is_empty());
    };
    fire(&mut dialogue, CommandId(99));
    assert!(!dialogue.is_high());
    fire(&mut dialogue, id);
    assert!(dialogue.is_high() && !dialogue.sequencer.is_armed(id));
    assert_eq!(dialogue.sequencer.target(), 1_000);

    let mut dialogue = Dialogue::begin(Traits::cia402());
    let buffered = MoveCommand {
        gated: true,
        ..to(1_000, BufferMode::Buffered)
    };
    let id = dialogue.ask(buffered);
    dialogue.frame();
    assert!(dialogue.sequencer.is_armed(id));
    dialogue.ask(to(2_000, BufferMode::Aborting));
    assert!(!dialogue.sequencer.is_armed(id), "overtaken");
    fire(&mut dialogue, id);
    assert!(!dialogue.is_high());
}

/// Bits 5, 6 and 9 go out before bit 4 where the drive takes them from the word before.
#[test]
fn bits_that_a_drive_takes_before_the_edge_are_seen_before_it() {
    let traits = Traits {
        start_bits_first: true,
        ..Traits::cia402()
    };
    let immediately = Controlword::CHANGE_IMMEDIATELY;
    let mut dialogue = Dialogue::begin(traits);
    dialogue.ask(to(1_000, BufferMode::Aborting));
    dialogue.frame();
    assert_eq!(dialogue.sequencer.bits().word(), immediately);
    // What was not delivered is not seen.
    dialogue.delivered = false;
    dialogue.frames(10);
    assert_eq!(dialogue.sequencer.bits().word(), immediately);
    dialogue.delivered = true;
    dialogue.frames(2);
    assert_eq!(dialogue.sequencer.bits().word(), immediately);
    dialogue.frame();
    assert_eq!(
        dialogue.sequencer.bits().word(),
        immediately | Controlword::NEW_SET_POINT
    );
    dialogue.frame();
    dialogue.word |= ACKNOWLEDGE;
    assert!(dialogue.frame());
    assert_eq!(dialogue.sequencer.bits().word(), Controlword::empty());

    // Those of a move that does not come are taken back, and the next one's are seen before its edge, too: none of them here.
    let mut dialogue = Dialogue::begin(traits);
    let withdrawn = dialogue.ask(to(1_000, BufferMode::Aborting));
    dialogue.frame();
    assert!(
        dialogue
            .sequencer
            .withdraw(withdrawn, Failure::NeedsStop, &mut dialogue.events)
    );
    assert_eq!(dialogue.sequencer.bits().word(), Controlword::empty());
    dialogue.ask(to(1_000, BufferMode::Buffered));
    dialogue.frames(2);
    assert_eq!(dialogue.sequencer.bits().word(), Controlword::empty());
    dialogue.frame();
    assert_eq!(dialogue.sequencer.bits().word(), Controlword::NEW_SET_POINT);

    // With a drive that takes them at the edge they come with it.
    let mut dialogue = Dialogue::begin(Traits::cia402());
    dialogue.ask(to(1_000, BufferMode::Aborting));
    dialogue.frame();
    assert_eq!(
        dialogue.sequencer.bits().word(),
        immediately | Controlword::NEW_SET_POINT
    );
}

#[test]
fn what_ends_all_says_of_each_set_point_how_far_it_came() {
    let (mut dialogue, [first, second]) = Dialogue::full();
    let on_its_way = dialogue.ask(to(-500, BufferMode::Aborting));
    dialogue.frames(2);
    let waits = dialogue.ask(to(7, BufferMode::Buffered));
    let lost = |delivery| Failure::BusLost { delivery };
    dialogue
        .sequencer
        .fail_all(lost(Delivery::NotSent), &mut dialogue.events);
    let expected = [
        failed(waits, lost(Delivery::NotSent)),
        failed(on_its_way, lost(Delivery::Unknown)),
        failed(first, lost(Delivery::Accepted)),
        failed(second, lost(Delivery::Accepted)),
    ];
    assert_eq!(dialogue.reports(), expected);
    // Bit 4 stays as it was sent, until the axis is out of operation.
    assert!(dialogue.is_high() && dialogue.sequencer.has_set_point());
    dialogue.sequencer.lower();
    assert!(!dialogue.is_high() && dialogue.sequencer.is_idle());

    // One that was sent onto the full buffer, with bit 4 low again.
    let (mut dialogue, _) = Dialogue::full();
    let unconfirmed = dialogue.ask(to(-500, BufferMode::Aborting));
    dialogue.frames(10);
    assert!(!dialogue.is_high());
    dialogue
        .sequencer
        .fail_all(lost(Delivery::NotSent), &mut dialogue.events);
    let reports = dialogue.reports();
    assert_eq!(reports[0], failed(unconfirmed, lost(Delivery::Unknown)));
    assert_eq!(reports.len(), 3);
}

#[test]
fn a_stop_takes_back_what_was_not_sent_and_leaves_what_was() {
    let delivery = Delivery::NotSent;
    let failure = Failure::Halted { delivery };
    let mut dialogue = Dialogue::begin(Traits::cia402());
    let raised = dialogue.ask(to(1_000, BufferMode::Aborting));
    dialogue.frame();
    assert!(dialogue.is_high());
    let waits = dialogue.ask(to(2_000, BufferMode::Buffered));
    dialogue
        .sequencer
        .withdraw_unsent(failure, &mut dialogue.events);
    let expected = [failed(waits, failure), failed(raised, failure)];
    assert_eq!(dialogue.reports(), expected);
    assert!(!dialogue.is_high() && dialogue.sequencer.is_idle());

    let sent = dialogue.ask(to(1_000, BufferMode::Aborting));
    dialogue.frames(5);
    assert!(dialogue.is_high());
    dialogue
        .sequencer
        .withdraw_unsent(failure, &mut dialogue.events);
    assert!(
        !dialogue
            .sequencer
            .withdraw(sent, failure, &mut dialogue.events)
    );
    assert!(dialogue.is_high() && dialogue.reports().is_empty());
    assert!(dialogue.sequencer.has_set_point() && !dialogue.sequencer.holds_any());
}

#[test]
fn a_sequencer_says_what_it_holds() {
    let said = |dialogue: &Dialogue| {
        let of = &dialogue.sequencer;
        (of.is_idle(), of.has_set_point(), of.holds_any())
    };
    let mut dialogue = Dialogue::begin(Traits::cia402());
    assert_eq!(said(&dialogue), (true, false, false));
    let id = dialogue.ask(to(1_000, BufferMode::Aborting));
    assert_eq!(said(&dialogue), (false, false, false), "it waits");
    dialogue.frame();
    assert_eq!(said(&dialogue), (false, false, false), "it is raised");
    dialogue.frame();
    dialogue.word |= ACKNOWLEDGE;
    dialogue.word -= REACHED;
    dialogue.frame();
    assert_eq!(dialogue.reports(), [(id, Event::Accepted)]);
    assert_eq!(said(&dialogue), (false, true, true), "the drive has it");
    dialogue.word -= ACKNOWLEDGE;
    dialogue.frame();
    dialogue.position = 1_000;
    dialogue.word |= REACHED;
    dialogue.frames(3);
    let position = 1_000;
    let reached = Event::Done(Ok(Completion::Reached { position }));
    assert_eq!(dialogue.reports(), [(id, reached)]);
    assert_eq!(said(&dialogue), (true, false, false));
}

#[test]
fn a_cycle_may_be_cheap_where_nothing_but_the_position_changes() {
    let allows = |dialogue: &Dialogue| {
        let of = &dialogue.sequencer;
        let allows = |in_mode| of.allows_idle_path(in_mode, dialogue.word);
        (allows(true), allows(false))
    };
    assert_eq!(
        allows(&Dialogue {
            sequencer: Sequencer::new(Parameters::default()),
            ..Dialogue::begin(Traits::cia402())
        }),
        (false, true),
        "the low of bit 4 is to be delivered"
    );
    let mut dialogue = Dialogue::begin(Traits::cia402());
    assert_eq!(allows(&dialogue), (true, true));
    dialogue.word -= REACHED;
    let id = dialogue.ask(to(1_000, BufferMode::Aborting));
    assert_eq!(allows(&dialogue), (false, false));
    dialogue.frame();
    assert_eq!(allows(&dialogue), (false, false), "bit 4 is high");
    dialogue.frame();
    dialogue.word |= ACKNOWLEDGE;
    dialogue.frames(2);
    assert_eq!(allows(&dialogue), (false, true), "bit 12 falls or stays");
    dialogue.frames(2);
    assert_eq!(allows(&dialogue), (true, true), "one set-point is followed");
    assert_eq!(dialogue.reports(), [(id, Event::Accepted)]);
    let (full, _) = Dialogue::full();
    assert_eq!(allows(&full), (false, false), "two are not");
    // One on a full buffer that is not acknowledged.
    let (mut unconfirmed, _) = Dialogue::full();
    unconfirmed.ask(to(-500, BufferMode::Aborting));
    unconfirmed.frames(10);
    assert_eq!(allows(&unconfirmed), (false, false));
    // One of which nobody knows whether the drive has taken it, and no other.
    let mut unknown = Dialogue::begin(Traits::cia402());
    unknown.ask(to(1_000, BufferMode::Aborting));
    unknown.frames(2 + LATE + 5);
    assert!(unknown.sequencer.is_unknown());
    assert_eq!(allows(&unknown), (true, true));
    // And with one that it holds.
    let mut both = Dialogue::begin(Traits::cia402());
    both.word -= REACHED;
    both.accept(to(1_000, BufferMode::Aborting));
    both.word -= ACKNOWLEDGE;
    both.frames(3);
    both.ask(to(2_000, BufferMode::Aborting));
    both.frames(2 + LATE + 5);
    assert!(both.sequencer.is_unknown() && both.sequencer.holds_any());
    assert_eq!(allows(&both), (false, false));
}

#[test]
fn the_profile_type_before_a_move_is_that_of_the_last_one_that_waits_or_was_sent() {
    let typed = |profile_type, buffer_mode| MoveCommand {
        set_point: SetPoint::new()
            .buffer_mode(buffer_mode)
            .profile_type(profile_type),
        ..to(1_000, buffer_mode)
    };
    let mut dialogue = Dialogue::begin(Traits::cia402());
    let last = |dialogue: &Dialogue| dialogue.sequencer.last_profile_type();
    assert_eq!(last(&dialogue), None);
    dialogue.word -= REACHED;
    dialogue.accept(typed(7, BufferMode::Aborting));
    assert_eq!(last(&dialogue), Some(7));
    dialogue.ask(typed(8, BufferMode::Buffered));
    dialogue.ask(typed(9, BufferMode::Buffered));
    assert_eq!(last(&dialogue), Some(9));
    dialogue
        .sequencer
        .fail_all(Failure::NeedsStop, &mut dialogue.events);
    dialogue.sequencer.lower();
    assert_eq!(last(&dialogue), None, "it would follow none");
}

#[test]
fn a_move_that_is_taken_back_before_it_is_sent_leaves_the_fields_as_they_were() {
    let typed = |profile_type, target| MoveCommand {
        set_point: SetPoint::new().profile_type(profile_type),
        ..to(target, BufferMode::Aborting)
    };
    let mut dialogue = Dialogue::begin(Traits::cia402());
    dialogue.word -= REACHED;
    dialogue.accept(typed(7, 1_000));
    dialogue.word -= ACKNOWLEDGE;
    dialogue.frames(5);
    let id = dialogue.ask(typed(8, 2_000));
    dialogue.frame();
    let fields = |dialogue: &Dialogue| {
        let sequencer = &dialogue.sequencer;
        (
            sequencer.target(),
            sequencer.parameters().profile_type,
            sequencer.last_profile_type(),
        )
    };
    assert!(dialogue.is_high());
    assert_eq!(fields(&dialogue), (2_000, Some(8), Some(8)));
    let withdrawn =
        dialogue.does(|sequencer, _, events| sequencer.withdraw(id, Failure::Withdrawn, events));
    assert!(withdrawn && !dialogue.is_high());
    assert_eq!(fields(&dialogue), (1_000, Some(7), Some(7)));
}

#[test]
fn a_set_point_with_an_end_velocity_was_to_end_in_motion() {
    for (end_velocity, moves) in [(None, false), (Some(0), false), (Some(5), true)] {
        let mut dialogue = Dialogue::begin(Traits::cia402());
        dialogue.word -= REACHED;
        let mut command = to(1_000, BufferMode::Aborting);
        command.set_point.parameters.end_velocity = end_velocity;
        dialogue.accept(command);
        assert_eq!(dialogue.sequencer.has_end_velocity(), moves);
        dialogue.sequencer.lower();
        assert!(!dialogue.sequencer.has_end_velocity());
    }
}

/// A wait that has lasted for longer than its deadline is as one that has lasted for just that: a halted axis goes on with it.
#[test]
fn a_wait_is_made_canonical_beyond_its_deadline_alone() {
    let (now, acknowledge) = (ms(10_000), ms(LATE));
    let latest = now - acknowledge;
    for (since, kept) in [
        (ms(3), latest),
        (latest, latest),
        (now - ms(7), now - ms(7)),
    ] {
        let mut pending = PendingMoves::default();
        pending.push(CommandId(1), to(1, BufferMode::Buffered));
        assert_eq!(pending.first_blocked_since(since), since);
        pending.canonicalize(now, acknowledge);
        assert_eq!(pending.first_blocked_since(now), kept);
        pending.first_is_free();
        assert_eq!(pending.first_blocked_since(now), now);
    }
}

/// What is let go of is what the next set-point brings anew; what the one before it was is compared with the next.
#[test]
fn what_canonicalize_drops_of_a_set_point_is_no_more_than_what_the_next_one_brings() {
    let mut dialogue = Dialogue::begin(Traits::cia402());
    dialogue.word -= REACHED;
    let set_point = SetPoint::new().velocity(3).end_velocity(5).profile_type(7);
    dialogue.accept(MoveCommand {
        set_point,
        ..to(1_000, BufferMode::Aborting)
    });
    dialogue.sequencer.canonicalize_target();
    assert!(dialogue.sequencer.has_end_velocity());
    assert_eq!(dialogue.sequencer.last_profile_type(), Some(7));
    assert_eq!(dialogue.sequencer.target(), 0);
    assert_eq!(dialogue.sequencer.parameters().velocity, None);
}

#[test]
fn the_target_follows_the_axis_where_no_set_point_is_active() {
    let mut sequencer = Sequencer::new(Parameters::default());
    sequencer.lower();
    assert!(sequencer.drive_buffer.is_at_base());
    sequencer.follow_position(77);
    assert_eq!(sequencer.target(), 77);
    assert!(sequencer.drive_buffer.is_at_base());
    sequencer.follow_other_mode(-78);
    assert_eq!(sequencer.target(), -78);
    assert!(
        !sequencer.drive_buffer.is_at_base(),
        "another mode leads anywhere"
    );
}

/// A start that the drive's buffer does not take waits for the end of the one before, and bit 12 is not what it waits for.
#[test]
fn a_move_that_is_sequenced_here_waits_without_a_deadline() {
    let mut dialogue = Dialogue::begin(Traits {
        after_current: StartBits::Sequenced,
        buffer_signal: BufferSignal::Acknowledge,
        ..Traits::cia402()
    });
    dialogue.word -= REACHED;
    let first = dialogue.accept(to(1_000, BufferMode::Aborting));
    dialogue.word -= ACKNOWLEDGE;
    dialogue.ask(to(2_000, BufferMode::Buffered));
    dialogue.frames(3 * LATE);
    assert!(dialogue.reports().is_empty() && !dialogue.is_high());
    dialogue.position = 1_000;
    dialogue.word |= REACHED;
    dialogue.frames(3);
    let position = 1_000;
    let reached = Event::Done(Ok(Completion::Reached { position }));
    assert_eq!(dialogue.reports(), [(first, reached)]);
    assert!(dialogue.is_high());
}

#[test]
fn a_distance_behind_a_move_on_its_way_begins_far_from_where_it_counts() {
    let far_behind = |follows: bool, word: Statusword| {
        let mut dialogue = Dialogue::buffered();
        if follows {
            dialogue.accept(to(10_000, BufferMode::Aborting));
            dialogue.word = Statusword::empty();
            dialogue.frames(5);
        }
        dialogue.word = word;
        dialogue.ask(MoveCommand {
            reference: Reference::Relative,
            ..to(5_000, BufferMode::Buffered)
        });
        dialogue.frame();
        match &dialogue.sequencer.bit4 {
            Bit4::High { raised, .. } => raised.far_behind,
            other => panic!("{other:?}"),
        }
    };
    assert!(far_behind(true, Statusword::empty()));
    assert!(!far_behind(true, REACHED), "it may be over");
    assert!(!far_behind(false, Statusword::empty()) && !far_behind(false, REACHED));
}

/// Between two frames, with what the last one has shown.
#[test]
fn start_bits_that_were_put_out_since_the_last_frame_are_not_delivered_yet() {
    let mut dialogue = Dialogue::begin(Traits {
        start_bits_first: true,
        ..Traits::cia402()
    });
    let start = |dialogue: &mut Dialogue| {
        dialogue.does(|sequencer, cycle, events| sequencer.start_next(cycle, events, false));
    };
    dialogue.ask(to(1_000, BufferMode::Aborting));
    start(&mut dialogue);
    dialogue.ask(to(2_000, BufferMode::Aborting));
    start(&mut dialogue);
    // That frame and those after it are lost for longer than the drive takes to see them.
    dialogue.now += ms(20);
    dialogue.delivered = false;
    dialogue.frame();
    dialogue.delivered = true;
    dialogue.frames(2);
    assert!(!dialogue.is_high(), "it has not surely seen them");
    dialogue.frame();
    assert!(dialogue.is_high());
}

#[test]
fn a_move_is_superseded_when_the_later_one_is_sent_and_not_before() {
    let waiting = || {
        let (mut dialogue, _) = Dialogue::full();
        let overtaken = dialogue.ask(to(30_000, BufferMode::Buffered));
        dialogue.frame();
        let later = dialogue.ask(to(-500, BufferMode::Aborting));
        dialogue.does(|sequencer, cycle, events| sequencer.start_next(cycle, events, false));
        assert!(dialogue.is_high() && dialogue.reports().is_empty());
        (dialogue, overtaken, later)
    };
    let (mut dialogue, overtaken, _) = waiting();
    let behind = dialogue.ask(to(7, BufferMode::Buffered));
    dialogue.frame();
    assert_eq!(dialogue.reports(), [failed(overtaken, Failure::Superseded)]);
    let first = dialogue.sequencer.pending.first();
    assert_eq!(first.map(|request| request.id), Some(behind));

    // It was given up before it was sent.
    let (mut dialogue, overtaken, later) = waiting();
    let withdrawn = Failure::Withdrawn;
    dialogue
        .sequencer
        .withdraw(later, withdrawn, &mut dialogue.events);
    dialogue.frames(2);
    assert_eq!(dialogue.reports(), [failed(later, withdrawn)]);
    let first = dialogue.sequencer.pending.first();
    assert_eq!(first.map(|request| request.id), Some(overtaken));
}
