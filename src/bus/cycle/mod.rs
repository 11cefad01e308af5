//! The cyclic exchange of process data: when cycles begin and end, and who is called around them.
//!
//! It owns what each device gets and gives, the frames of the process data (`frame`), the phase against a reference clock
//! (`reference_clock`), the counters (`statistics`) and the last cycles of every axis (`black_box`). From top to bottom: the exchange in
//! time, the exchange of one cycle, the share of each drive, the working counters, the time for acyclic frames, the program's clock. Time is an
//! argument, and the link is only sent to. It knows no tasks, no registers and no devices beyond their share of the frames: it must not
//! call `requests` or any room above that.

pub(super) mod black_box;
#[cfg(test)]
mod exchange_tests;
pub(super) mod frame;
pub(super) mod reference_clock;
pub(super) mod statistics;

use std::{
    future::Future,
    ops::{Deref, DerefMut, Range},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use crate::{
    axis::Inputs,
    axis::WorkingCounter,
    bus::{
        cable::{receive_deadline, time_on_cable},
        error::{AlState, AlStatus, NetworkError, ReferenceClock},
    },
    link::Link,
    wakes::{Waiters, Wakes},
};

use self::{
    black_box::{CycleRing, RecordedAxis, RecordedCycle, RingWriter},
    frame::{Frame, InputMarker, MailboxStates, Member, Packed, Part, Tag, Watched, pack},
    reference_clock::{Distribution, Phase, Slot},
    statistics::Counters,
};

/// Who works with the process data, on the bus thread.
pub(in crate::bus) trait Stepper {
    /// Last thing before the outputs are sent.
    fn before_send(&mut self, now: Duration, drives: &mut Drives);
    /// After the inputs came in, or did not.
    fn after_receive(&mut self, now: Duration, drives: &mut Drives);
}

/// One, then the other.
impl<A: Stepper, B: Stepper> Stepper for (A, B) {
    fn before_send(&mut self, now: Duration, drives: &mut Drives) {
        self.0.before_send(now, drives);
        self.1.before_send(now, drives);
    }

    fn after_receive(&mut self, now: Duration, drives: &mut Drives) {
        self.0.after_receive(now, drives);
        self.1.after_receive(now, drives);
    }
}

/// The exchange in time.
pub(in crate::bus) struct Cycle {
    pub exchange: Exchange,
    stepper: Box<dyn Stepper>,
    /// Keeps the cycles in step with a reference clock.
    clock: Option<Phase>,
    period: Duration,
    /// Parts of it: divisions are dear.
    deadline: Duration,
    eighth: Duration,
    next_start: Duration,
    receive_until: Duration,
    /// When the frames of the last cycle were sent, and when the last of them came back, if all did.
    sent_at: Duration,
    back_at: Option<Duration>,
    /// How long they were away, where that is still to be counted.
    took: Option<Duration>,
    round_trip: RoundTrip,
    /// Whether the frames of the last cycle were all back before its deadline.
    all_back: bool,
    /// Consecutive cycles in which everything was right.
    pub good: u32,
    /// What the last cycle showed.
    pub last: Events,
    /// Whether a drive was lost or came back since somebody looked.
    pub membership_changed: bool,
}

impl Cycle {
    pub fn new(
        exchange: Exchange,
        stepper: Box<dyn Stepper>,
        period: Duration,
        first: Duration,
        clock: Option<Phase>,
    ) -> Self {
        Self {
            exchange,
            stepper,
            clock,
            period,
            deadline: receive_deadline(period),
            eighth: period / 8,
            next_start: first,
            receive_until: first,
            sent_at: first,
            back_at: None,
            took: None,
            round_trip: RoundTrip::default(),
            all_back: false,
            good: 0,
            last: Events::default(),
            membership_changed: false,
        }
    }

    pub const fn in_flight(&self) -> bool {
        self.exchange.in_flight()
    }

    /// When the last cycle was sent.
    pub const fn sent(&self) -> Duration {
        self.sent_at
    }

    /// Whether a cycle is to be sent now, and nothing else before.
    pub fn is_due(&self, now: Duration) -> bool {
        !self.in_flight() && now >= self.next_start
    }

    /// The time for acyclic frames until the next cycle starts.
    pub fn window(&self) -> AcyclicWindow {
        AcyclicWindow {
            end: self.next_start,
            round_trip: self.round_trip.reckoned(self.eighth),
            longest_alone: self.eighth,
        }
    }

    /// When [`turn`](Self::turn) is to be called at the latest. For a frame that is lost when all was well before that is the next
    /// start: the time that the thread is woken at in any case, so that it sets its timer once a cycle and not twice.
    pub const fn next(&self) -> Duration {
        if self.in_flight() && !self.all_back {
            self.receive_until
        } else {
            self.next_start
        }
    }

    /// Takes a frame of process data in a turn that began at `now`. True once all of the cycle are there: it ends with the turn that
    /// received the last one.
    // This and `turn` are kept whole: `benches/step` counts what is done in them, by their names.
    #[inline(never)]
    pub fn accept(&mut self, tag: Tag, frame: &[u8], now: Duration, counters: &Counters) -> bool {
        let complete = self.exchange.accept(tag, frame, counters);
        if complete {
            self.back_at = Some(now);
            self.receive_until = Duration::ZERO;
        } else if let Some(cycles) = self.exchange.take_late() {
            let since = now.saturating_sub(self.sent_at);
            counters.came_late(since.saturating_add(self.period.saturating_mul(cycles)));
        }
        complete
    }

    /// Ends a cycle and begins the next, each when it is time.
    #[inline(never)]
    pub fn turn(&mut self, now: Duration, link: &mut dyn Link, counters: &Counters) {
        if self.in_flight() && now >= self.receive_until {
            self.end(now, counters);
        }
        if self.is_due(now) {
            self.begin(now, link, counters);
        }
    }

    fn begin(&mut self, now: Duration, link: &mut dyn Link, counters: &Counters) {
        let late = now.saturating_sub(self.next_start);
        // Cycles that were slept through are not made up for, and the phase stays.
        let periods = if late < self.period {
            1
        } else {
            let slept_through = late.as_nanos() / self.period.as_nanos().max(1);
            u32::try_from(slept_through + 1).unwrap_or(u32::MAX)
        };
        if let Some(clock) = &mut self.clock {
            let (passes, sooner) = clock.begin(late, periods);
            self.exchange.set_reference_time(passes as u32);
            self.next_start = earlier(self.next_start, sooner);
        }
        self.stepper.before_send(now, &mut self.exchange.drives);
        self.exchange.send(link, counters);
        self.sent_at = now;
        self.receive_until = now.saturating_add(self.deadline);
        let later = self.period.saturating_mul(periods);
        self.next_start = self.next_start.saturating_add(later);
        // The books are kept while nothing waits for it.
        self.exchange.record(now, late);
        counters.lateness.record(late);
        if late > self.period / 2 {
            counters.late_cycles.add();
        }
        if periods > 1 {
            counters.overruns.add_many(u64::from(periods - 1));
        }
        if let Some(took) = self.took.take() {
            counters.round_trip.record(took);
        }
    }

    /// The reference clock's time, and when it was that, where cycles are in step with one.
    pub fn reference_time(&self) -> Option<(u64, Duration)> {
        let clock = self.clock.as_ref()?;
        Some((clock.time(), self.sent_at))
    }

    /// From the next cycle on all clocks get the time of the cycles, and what the reference shows is not looked at. Whether it was otherwise.
    pub fn lead_clocks(&mut self) -> bool {
        let slot = self.exchange.clock().filter(|slot| !slot.leads());
        slot.map(Slot::lead).is_some()
    }

    /// From the next cycle on all clocks get the reference's time, and the cycles follow that too; never after a jump.
    pub fn follow_reference(&mut self) {
        if self.may_follow()
            && let Some(slot) = self.exchange.clock()
        {
            slot.follow();
        }
    }

    /// Whether all clocks get the time of the cycles until the reference's is set.
    pub fn awaits_reference(&mut self) -> bool {
        self.may_follow() && self.exchange.clock().is_some_and(|slot| slot.leads())
    }

    fn may_follow(&self) -> bool {
        let clock = self.clock.as_ref();
        clock.is_some_and(|clock| clock.reference() != ReferenceClock::Jumped)
    }

    fn end(&mut self, now: Duration, counters: &Counters) {
        let events = self.exchange.judge(counters);
        self.all_back = false;
        if let Some(back) = self.back_at.take() {
            let took = back.saturating_sub(self.sent_at);
            self.all_back = took <= self.deadline;
            self.round_trip.observe(took);
            self.took = Some(took);
        }
        let complete = !events.wrong && events.al_status.is_some();
        self.good = if complete {
            self.good.saturating_add(1)
        } else {
            0
        };
        self.membership_changed |= events.membership;
        self.last = events;
        if let Some(clock) = &mut self.clock {
            let (sooner, measured) = clock.end(events.reference_time);
            self.next_start = earlier(self.next_start, sooner);
            match measured {
                Some(measured) => counters.clock.record(&measured),
                None => counters.clock.hold(clock.is_locked(), clock.reference()),
            }
            if clock.reference() == ReferenceClock::Jumped {
                self.lead_clocks();
            }
        }
        self.stepper.after_receive(now, &mut self.exchange.drives);
    }
}

/// So many nanoseconds before, or after with a negative number.
fn earlier(time: Duration, sooner: i64) -> Duration {
    let by = Duration::from_nanos(sooner.unsigned_abs());
    if sooner < 0 {
        time.saturating_add(by)
    } else {
        time.saturating_sub(by)
    }
}

// The exchange of one cycle: process-data frames composed once, sent each cycle, judged when they come back.
//
// Before sending, the input areas are filled with a pattern that no DS402 drive can answer. An area that still holds it was
// not answered, so that one silent drive does not blind the others that share its datagram. The inputs of other devices can
// hold any bits: there the pattern alternates, and where they are equal to it a right working counter decides.

/// The most frames of a cycle: each has its place in a byte of its tag, of which one value is that of acyclic frames.
const MOST_FRAMES: usize = frame::ACYCLIC as usize;

/// What happened to the drives in a cycle, beyond their data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(in crate::bus) struct Events {
    /// A drive fell silent for good, or came back.
    pub membership: bool,
    /// All AL states OR-ed together and the number of SubDevices that answered, where that came back.
    pub al_status: Option<(u8, u16)>,
    /// A working counter was wrong.
    pub wrong: bool,
    /// The low half of the reference clock's time when the frames passed it, where it is distributed and came back.
    pub reference_time: Option<u32>,
}

pub(in crate::bus) struct Exchange {
    pub drives: Drives,
    packed: Packed,
    /// Where inputs lie that can hold any bits: frame and place.
    any_bits: Vec<(usize, Range<usize>)>,
    /// Whether the last cycle brought inputs from every drive, and all outputs were delivered.
    all_fresh: bool,
    /// Whether it brought other inputs than the one before from any of them.
    changed: bool,
    mailboxes: MailboxStates,
    recorder: RingWriter,
    cycle: u64,
    in_flight: bool,
    /// Frames of this cycle that the link did not take.
    refused: usize,
    /// So many cycles ago the frame was sent that came back last after its cycle, until somebody asks.
    late_by: Option<u32>,
}

impl Exchange {
    pub fn new(members: &[Member], mailboxes: Vec<Watched>, clock: Option<Distribution>) -> Self {
        let mut packed = pack(members, mailboxes.len(), clock);
        let mut any_bits = Vec::new();
        for part in &packed.parts {
            for share in &part.shares {
                let Some(inputs) = &share.inputs else {
                    continue;
                };
                let marker = members.get(share.drive).map(|member| member.marker);
                if marker == Some(InputMarker::AnyBits) {
                    any_bits.push((part.frame, inputs.clone()));
                } else if let Some(frame) = packed.frames.get_mut(part.frame)
                    && let Some(to) = frame.request.get_mut(inputs.clone())
                {
                    to.fill(PATTERN);
                }
            }
        }
        Self {
            drives: Drives::new(members),
            recorder: RingWriter::new(&packed, members.len()),
            packed,
            any_bits,
            all_fresh: false,
            changed: false,
            mailboxes: MailboxStates::new(mailboxes),
            cycle: 0,
            in_flight: false,
            refused: 0,
            late_by: None,
        }
    }

    /// Of the frame that was accepted last, how many cycles ago it was sent, where it came back after its cycle.
    pub const fn take_late(&mut self) -> Option<u32> {
        self.late_by.take()
    }

    /// The lengths of a cycle's frames.
    pub fn lengths(&self) -> impl Iterator<Item = usize> {
        self.packed.frames.iter().map(|frame| frame.request.len())
    }

    /// The exchange, if it can send all of its frames.
    pub fn checked(self) -> Result<Self, NetworkError> {
        match self.packed.frames.len() {
            ..=MOST_FRAMES => Ok(self),
            got => Err(NetworkError::TooManyFrames {
                most: MOST_FRAMES,
                got,
            }),
        }
    }

    /// Whether frames are on their way.
    pub const fn in_flight(&self) -> bool {
        self.in_flight
    }

    /// Sets what the next frames carry as the time at which they pass the reference clock.
    pub fn set_reference_time(&mut self, time: u32) {
        if let (Some(slot), Some(first)) = (&mut self.packed.clock, self.packed.frames.first_mut())
        {
            slot.fill(&mut first.request, time);
        }
    }

    /// The datagram by which all clocks get their time.
    pub const fn clock(&mut self) -> Option<&mut Slot> {
        self.packed.clock.as_mut()
    }

    /// How long the frames of a cycle take at one place of the cable.
    pub fn time_on_cable(&self) -> Duration {
        let lengths = self.packed.frames.iter().map(|frame| frame.request.len());
        lengths.map(time_on_cable).sum()
    }

    /// Sends all frames of a cycle back to back.
    pub fn send(&mut self, link: &mut dyn Link, counters: &Counters) {
        self.cycle = self.cycle.wrapping_add(1);
        if self.drives.take_written() {
            self.pack_outputs();
        }
        for (frame, area) in &self.any_bits {
            if let Some(frame) = self.packed.frames.get_mut(*frame)
                && let Some(to) = frame.request.get_mut(area.clone())
            {
                to.fill(alternating(self.cycle));
            }
        }
        let Packed {
            mailbox_states,
            frames,
            ..
        } = &mut self.packed;
        self.mailboxes.address(mailbox_states, frames);
        self.refused = 0;
        for (frame, place) in self.packed.frames.iter_mut().zip(0..) {
            Tag::cyclic(self.cycle, place).put(&mut frame.request);
            frame.back = false;
            if link.send(&frame.request).is_err() {
                counters.not_sent.add();
                self.refused += 1;
            }
        }
        self.in_flight = true;
        counters.cycles.add();
    }

    /// Takes a frame of process data that came back. True once all of this cycle are there.
    #[inline]
    pub fn accept(&mut self, tag: Tag, answer: &[u8], counters: &Counters) -> bool {
        let Tag::Cyclic { frame: place, .. } = tag else {
            return false;
        };
        let current = self.in_flight && tag == Tag::cyclic(self.cycle, place);
        match self.packed.frames.get_mut(usize::from(place)) {
            Some(frame) if current && !frame.back => {
                if frame::is_answer_to(answer, &frame.request) {
                    core::mem::swap(&mut frame.answer, &mut frame.before);
                    frame.answer.clear();
                    frame.answer.extend_from_slice(answer);
                    frame.back = true;
                } else {
                    counters.damaged.add();
                }
            }
            _ => {
                counters.late.add();
                // One of this cycle that is there already came twice.
                self.late_by = tag.age(self.cycle).filter(|_| !current);
            }
        }
        // The last one first: frames come back in their order.
        current && self.packed.frames.iter().rev().all(|frame| frame.back)
    }

    /// Judges what came back and ends the cycle.
    pub fn judge(&mut self, counters: &Counters) -> Events {
        self.in_flight = false;
        let mut events = Events::default();
        let missing = self
            .packed
            .frames
            .iter()
            .filter(|frame| !frame.back)
            .count();
        let lost = missing.saturating_sub(self.refused);
        counters.lost.add_many(lost as u64);
        let is_disturbed = self.drives.take_disturbed();
        let (were_fresh, changed) = (self.all_fresh && !is_disturbed, self.changed);
        if !were_fresh || changed {
            for drive in self.drives.iter_mut() {
                drive.answer = Answer::Fresh;
                drive.changed = false;
            }
        }
        (self.all_fresh, self.changed) = (true, false);
        for part in &mut self.packed.parts {
            if let [share] = part.shares.as_slice()
                && let Some(drive) = self.drives.get_mut(share.drive)
                && drive.away
            {
                // Nobody else is counted in it.
                drive.answer = Answer::Stale;
                (part.steady, part.miscounted) = (false, None);
                continue;
            }
            let frame = self.packed.frames.get(part.frame);
            let frame = frame.filter(|frame| frame.back);
            let unchanged = frame
                .filter(|_| were_fresh && part.steady)
                .and_then(|frame| {
                    let Frame { answer, before, .. } = frame;
                    check_unchanged(part, answer, before, self.cycle, &mut self.drives)
                });
            let check = unchanged.unwrap_or_else(|| {
                let answer = frame.map(|frame| frame.answer.as_slice());
                check_part(part, answer, self.cycle, &mut self.drives, &mut events)
            });
            part.steady = check.steady;
            part.miscounted = check.miscounted.map(|counter| {
                let cycles = part.miscounted.map_or(0, |(_, cycles)| cycles);
                (counter, cycles.saturating_add(1))
            });
            self.all_fresh &= check.fresh;
            self.changed |= check.changed;
            if !check.right && frame.is_some() {
                counters.wrong_working_counters.add();
                events.wrong = true;
            }
        }
        if !(were_fresh && self.all_fresh) {
            self.count_silence(counters, &mut events);
        }
        self.mailboxes
            .judge(&self.packed.mailbox_states, &self.packed.frames);
        events.al_status = self.read_al_status();
        events.reference_time = self.read_reference_time();
        events
    }

    /// Packs the outputs that were written since the last time: what was packed into the frame before stays there.
    fn pack_outputs(&mut self) {
        for part in &self.packed.parts {
            let Some(frame) = self.packed.frames.get_mut(part.frame) else {
                continue;
            };
            for share in &part.shares {
                if let Some(outputs) = &share.outputs
                    && let Some(drive) = self.drives.get_mut(share.drive)
                    && let Some(from) = drive.take_unpacked()
                    && let Some(to) = frame.request.get_mut(outputs.clone())
                {
                    to.copy_from_slice(from);
                }
            }
        }
    }

    /// Counts who was silent and whose outputs may not have been delivered.
    fn count_silence(&mut self, counters: &Counters, events: &mut Events) {
        let drives = self.drives.iter_mut().enumerate();
        for (place, drive) in drives.filter(|(_, drive)| !drive.away) {
            events.membership |= drive.count_silence();
            if drive.answer != Answer::Fresh
                && let Some(counters) = counters.drive(place)
            {
                match drive.answer {
                    Answer::Answered => counters.undelivered.add(),
                    _ => counters.stale.add(),
                }
            }
        }
    }

    /// The working counters that are wrong, whether for so long that a silent drive would count as lost, and who shares the datagram.
    pub fn miscounted(
        &self,
    ) -> impl Iterator<Item = (WorkingCounter, bool, impl Iterator<Item = usize>)> {
        self.packed.parts.iter().filter_map(|part| {
            let (counter, cycles) = part.miscounted?;
            let sharing = part.shares.iter().map(|share| share.drive);
            let drives = sharing.clone().filter_map(|place| self.drives.get(place));
            let patience = drives.map(|drive| drive.patience).max().unwrap_or(0);
            Some((counter, cycles >= patience, sharing))
        })
    }

    /// Keeps the frames that were just sent, at `time`, and what became of those before. To be called while they are away.
    pub fn record(&mut self, time: Duration, late: Duration) {
        let Packed { frames, .. } = &self.packed;
        self.recorder.complete(frames, &self.drives);
        self.recorder.begin(self.cycle, time, late, frames);
    }

    /// Keeps what was judged last, for whoever does not wait for the next cycle.
    pub fn complete_record(&mut self) {
        if !self.in_flight {
            self.recorder.complete(&self.packed.frames, &self.drives);
        }
    }

    /// The last cycles of an axis that are complete, the oldest first.
    pub fn history(&self, axis: &RecordedAxis) -> Vec<RecordedCycle> {
        self.recorder.ring().read(axis)
    }

    /// The last cycles of all devices.
    pub fn ring(&self) -> Arc<CycleRing> {
        Arc::clone(self.recorder.ring())
    }

    fn read_reference_time(&mut self) -> Option<u32> {
        let slot = self.packed.clock.as_mut()?;
        let first = self.packed.frames.first().filter(|frame| frame.back);
        slot.read(first.map(|frame| frame.answer.as_slice()))
    }

    fn read_al_status(&self) -> Option<(u8, u16)> {
        let (place, data) = self.packed.al_status.as_ref()?;
        let frame = self.packed.frames.get(*place).filter(|frame| frame.back)?;
        let &[status, _, c0, c1] = frame.answer.get(data.start..data.end + 2)? else {
            return None;
        };
        Some((status, u16::from_le_bytes([c0, c1])))
    }
}

// What each drive gets and gives in the exchange, and how long it has been silent.

/// Fills unanswered input areas. As a statusword it decodes to no state (CiA DSP 402 v2.0, table 7).
const PATTERN: u8 = 0xFF;
/// Fill unanswered inputs of other devices, in turn.
const PATTERNS: [u8; 2] = [0x55, 0xAA];

/// All that take part, in the order of the exchange.
#[derive(Debug)]
pub(in crate::bus) struct Drives {
    drives: Box<[DriveData]>,
    /// Whether outputs of any of them were written since they were packed.
    written: bool,
    /// Whether one was taken away or put back since the last cycle was judged.
    disturbed: bool,
    /// Whether it was not known of any in the last cycle whether its outputs were delivered, or why has become known.
    pub doubted: bool,
}

/// One drive's share of the exchange.
#[derive(Debug, Clone)]
pub(in crate::bus) struct DriveData {
    /// What is sent in the next cycle.
    outputs: Box<[u8]>,
    /// Whether that is not in the frame yet.
    unpacked: bool,
    /// What came back last.
    pub inputs: Box<[u8]>,
    /// Whether the last cycle brought other inputs than the one before.
    pub changed: bool,
    /// What the last cycle brought; [`worth`](Self::worth) is for who uses it.
    pub answer: Answer,
    /// Whether it counts as lost: then nothing is expected of it.
    pub lost: bool,
    /// The working counter because of which it is not known whether its outputs were delivered, where it has answered.
    pub miscounted: Option<WorkingCounter>,
    /// In which AL state it was seen.
    pub seen: SeenState,
    /// With which AL status code it has.
    pub left_op: Option<u16>,
    /// Whether it is being set up anew: it counts as lost, and what it adds to a working counter meanwhile is nobody's loss.
    pub away: bool,
    stale_cycles: u32,
    pub patience: u32,
    pub marker: InputMarker,
}

/// In which AL state a drive was seen last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) enum SeenState {
    /// In none since it was lost, or taken into the exchange.
    None,
    /// It acts on its outputs.
    Op,
    /// It may close its outputs, and counts for its inputs alone.
    LeftOp,
    /// The same below SAFEOP, where it updates no inputs: what it answers is from before.
    Below,
}

impl SeenState {
    pub const fn of(status: AlStatus) -> Self {
        match status.state {
            AlState::Op if status.error.is_none() => Self::Op,
            AlState::Op | AlState::SafeOp => Self::LeftOp,
            _ => Self::Below,
        }
    }
}

/// What a cycle brought from a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) enum Answer {
    /// Inputs, and the outputs were delivered.
    Fresh,
    /// Inputs; whether the outputs were delivered is not known.
    Answered,
    /// Nothing.
    Stale,
}

impl Drives {
    pub fn new(members: &[Member]) -> Self {
        Self {
            drives: members.iter().map(DriveData::new).collect(),
            written: true,
            disturbed: false,
            doubted: false,
        }
    }

    /// What a drive is sent in the next cycle, to be written to.
    pub fn outputs_mut(&mut self, place: usize) -> Option<&mut [u8]> {
        let drive = self.drives.get_mut(place)?;
        self.written = true;
        drive.unpacked = true;
        Some(&mut drive.outputs)
    }

    /// Lets an axis core take the inputs of its drive, which are the same as before or not, and write the outputs, and say whether
    /// it has. Gives the inputs where they are others than before; none at all where the core says nothing, or there is no such drive.
    #[inline]
    pub fn step(
        &mut self,
        place: usize,
        core: impl FnOnce(Inputs<'_>, bool, &mut [u8]) -> Option<bool>,
    ) -> Option<Option<&[u8]>> {
        let drive = self.drives.get_mut(place)?;
        let others = drive.changed.then_some(&*drive.inputs);
        let inputs = match drive.worth() {
            Answer::Fresh => Inputs::Fresh(&drive.inputs),
            Answer::Answered => Inputs::Answered(&drive.inputs),
            Answer::Stale => Inputs::Stale,
        };
        if core(inputs, others.is_none(), &mut drive.outputs)? {
            drive.unpacked = true;
            self.written = true;
        }
        Some(others)
    }

    /// The working counter because of which it is not known whether the outputs of the drive at this place were delivered.
    pub fn miscounted(&self, place: usize) -> Option<WorkingCounter> {
        let drive = self.drives.get(place)?;
        drive
            .miscounted
            .filter(|_| drive.answer == Answer::Answered)
    }

    /// Whether that is not known of any. For whoever asks first.
    pub fn take_doubted(&mut self) -> bool {
        core::mem::take(&mut self.doubted)
    }

    /// One of them is being set up anew from now on: nothing of it is taken.
    pub fn take_away(&mut self, place: usize) {
        if let Some(drive) = self.drives.get_mut(place) {
            drive.away = true;
            drive.lost = true;
            drive.seen = match drive.seen {
                SeenState::None | SeenState::Op => SeenState::None,
                SeenState::LeftOp | SeenState::Below => SeenState::LeftOp,
            };
            self.disturbed = true;
        }
    }

    /// It counts again from now on; whether it is lost shows.
    pub fn put_back(&mut self, place: usize) -> Option<&mut DriveData> {
        let drive = self.drives.get_mut(place)?;
        drive.away = false;
        self.disturbed = true;
        Some(drive)
    }

    /// Whether one was taken away or put back: then nothing holds that was judged before. For whoever asks first.
    pub fn take_disturbed(&mut self) -> bool {
        core::mem::take(&mut self.disturbed)
    }

    /// Whether outputs of any drive are not in the frames yet. They are packed by whoever asks.
    pub fn take_written(&mut self) -> bool {
        core::mem::take(&mut self.written)
    }
}

impl Deref for Drives {
    type Target = [DriveData];

    #[inline]
    fn deref(&self) -> &[DriveData] {
        &self.drives
    }
}

impl DerefMut for Drives {
    #[inline]
    fn deref_mut(&mut self) -> &mut [DriveData] {
        &mut self.drives
    }
}

impl DriveData {
    fn new(member: &Member) -> Self {
        Self {
            outputs: vec![0; member.outputs].into(),
            unpacked: true,
            inputs: vec![0; member.inputs].into(),
            changed: false,
            answer: Answer::Stale,
            lost: false,
            miscounted: None,
            seen: SeenState::None,
            left_op: None,
            away: false,
            stale_cycles: 0,
            patience: member.patience,
            marker: member.marker,
        }
    }

    /// Whether it is in OP, so that it acts on its outputs.
    pub const fn is_operational(&self) -> bool {
        matches!(self.seen, SeenState::Op)
    }

    /// Whether it was seen to have left OP.
    const fn has_left_op(&self) -> bool {
        matches!(self.seen, SeenState::LeftOp | SeenState::Below)
    }

    /// The outputs, where they were written since this was asked last.
    pub fn take_unpacked(&mut self) -> Option<&[u8]> {
        core::mem::take(&mut self.unpacked).then_some(&*self.outputs)
    }

    /// Takes what came back in the place of its inputs. False if it has not answered there.
    #[inline]
    pub fn take_answer(&mut self, bytes: Option<&[u8]>, cycle: u64) -> bool {
        match bytes.filter(|bytes| self.is_answer(bytes, cycle)) {
            Some(bytes) => self.take(bytes),
            None => self.answer = Answer::Stale,
        }
        self.answer != Answer::Stale
    }

    /// The same, of bytes that are others than the inputs of one that has answered in the cycle before.
    #[inline]
    pub fn take_other(&mut self, bytes: &[u8], cycle: u64) -> bool {
        let answered = self.is_answer(bytes, cycle);
        if answered {
            self.changed = true;
            copy(&mut self.inputs, bytes);
        } else {
            self.answer = Answer::Stale;
        }
        answered
    }

    /// Whether anybody has written here since it was filled.
    #[inline]
    fn is_answer(&self, bytes: &[u8], cycle: u64) -> bool {
        let pattern = match self.marker {
            InputMarker::Statusword => PATTERN,
            InputMarker::AnyBits => alternating(cycle),
        };
        bytes.iter().any(|byte| *byte != pattern)
    }

    /// Whether it has answered where it has no inputs: only where it has none at all, and the datagram to itself, that is
    /// known.
    pub fn is_counted(&mut self, counter: Option<u16>) -> bool {
        if !self.inputs.is_empty() {
            return false;
        }
        let there = counter.is_some_and(|counter| counter != 0);
        if !there && !self.has_left_op() {
            self.answer = Answer::Stale;
        }
        there
    }

    /// Takes inputs of their own length.
    #[inline]
    pub fn take(&mut self, from: &[u8]) {
        self.changed = !are_equal(&self.inputs, from);
        if self.changed {
            copy(&mut self.inputs, from);
        }
    }

    /// How far those who use its inputs can trust them.
    #[inline]
    pub const fn worth(&self) -> Answer {
        match (self.seen, self.answer) {
            (SeenState::Op, answer) => answer,
            (SeenState::Below, _) => Answer::Stale,
            (SeenState::None | SeenState::LeftOp, Answer::Fresh) => Answer::Answered,
            (SeenState::None | SeenState::LeftOp, answer) => answer,
        }
    }

    /// Counts a cycle. True when it is lost from now on, or no longer.
    pub fn count_silence(&mut self) -> bool {
        let before = self.lost;
        if self.answer == Answer::Stale {
            self.stale_cycles = self.stale_cycles.saturating_add(1);
            self.lost |= self.stale_cycles >= self.patience;
            // What state it comes back in is to be read anew.
            if self.lost && self.is_operational() {
                self.seen = SeenState::None;
            }
        } else {
            self.stale_cycles = 0;
        }
        self.lost != before
    }
}

/// What unanswered inputs are filled with that can hold any bits.
const fn alternating(cycle: u64) -> u8 {
    PATTERNS[(cycle % 2) as usize]
}

// An axis has seldom more than two words, which may overlap: a call of a general comparison or copy costs more than these.

/// Whether the inputs of a drive are the same.
#[inline]
fn are_equal(a: &[u8], b: &[u8]) -> bool {
    if (8..=16).contains(&a.len()) && a.len() == b.len() {
        return a.first_chunk::<8>() == b.first_chunk() && a.last_chunk::<8>() == b.last_chunk();
    }
    a == b
}

/// Copies bytes of the same length.
#[inline]
fn copy(to: &mut [u8], from: &[u8]) {
    if to.len() != from.len() {
        return;
    }
    if (8..=16).contains(&from.len())
        && let (Some(first), Some(last)) = (from.first_chunk::<8>(), from.last_chunk::<8>())
    {
        if let Some(to) = to.first_chunk_mut() {
            *to = *first;
        }
        if let Some(to) = to.last_chunk_mut() {
            *to = *last;
        }
    } else {
        to.copy_from_slice(from);
    }
}

// The rule of who answered in a datagram that several drives share, and whose outputs were delivered.

/// What was judged of a datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct CounterCheck {
    /// Its working counter was right.
    pub right: bool,
    /// Moreover all of its drives are [`Answer::Fresh`], as far as it is their datagram.
    pub fresh: bool,
    /// Moreover nobody counts as lost, and the working counter is everybody's: with the same one again, only inputs that are
    /// others need to be looked at.
    pub steady: bool,
    /// It has brought other inputs than the one before.
    pub changed: bool,
    /// Its working counter, where that came back and was wrong although all of its drives answer, but for those that are lost.
    pub miscounted: Option<WorkingCounter>,
}

/// Takes the inputs of the drives that share a datagram. An answer that is not [`Answer::Fresh`] is noted with the drive, and
/// so are other inputs than before.
#[inline(never)]
fn check_part(
    part: &Part,
    answer: Option<&[u8]>,
    cycle: u64,
    drives: &mut Drives,
    events: &mut Events,
) -> CounterCheck {
    let counter = answer
        .and_then(|answer| answer.get(part.data.end..part.data.end + 2))
        .and_then(|bytes| <[u8; 2]>::try_from(bytes).ok())
        .map(u16::from_le_bytes);
    let bytes = answer.unwrap_or_default();
    let mut expected = 0;
    let (mut silent, mut lost, mut changed) = (false, false, false);
    for share in &part.shares {
        let Some(drive) = drives.get_mut(share.drive) else {
            continue;
        };
        if drive.away {
            drive.answer = Answer::Stale;
            expected += share.counts;
            (silent, lost) = (true, true);
            continue;
        }
        let answered = match &share.inputs {
            Some(area) => drive.take_answer(bytes.get(area.clone()), cycle),
            None => drive.is_counted(counter),
        };
        if answered && drive.lost {
            events.membership = true;
            drive.lost = false;
        }
        silent |= drive.answer == Answer::Stale;
        lost |= drive.lost;
        changed |= drive.changed;
        if !drive.lost {
            expected += share.counts;
        }
    }
    let all = counter == Some(expected);
    if silent && all {
        changed |= take_equal_to_the_pattern(part, bytes, drives);
    }
    let right = all || is_right_with_closed_outputs(part, drives, expected, counter);
    // One that is silent, and not yet lost, is not counted: its silence is enough.
    let is_explained = part.shares.iter().any(|share| {
        let drive = drives.get(share.drive);
        drive.is_some_and(|drive| drive.answer == Answer::Stale && !drive.lost)
    });
    // To who reads it, the lost ones are missing as well.
    let miscounted = counter.filter(|_| !right).map(|got| WorkingCounter {
        datagram: part.number,
        expected: part.shares.iter().map(|share| share.counts).sum(),
        got,
        devices: u16::try_from(part.shares.len()).unwrap_or(u16::MAX),
    });
    if !right {
        mark_unconfirmed(part, miscounted, drives);
    }
    let fresh = right && !silent;
    CounterCheck {
        right,
        fresh,
        // Where nobody is to count, that nobody has says something only of who has left OP.
        steady: fresh && all && !lost && expected > 0,
        changed,
        miscounted: miscounted.filter(|_| !is_explained),
    }
}

/// As [`check_part`], where nobody was silent in the cycle before, and the verdict on this datagram was steady: from both
/// answers. None if its working counter is another one now.
// A function of its own, as is `check_part`: within `Exchange::judge` its loop over the drives has too few registers.
#[inline(never)]
fn check_unchanged(
    part: &Part,
    answer: &[u8],
    before: &[u8],
    cycle: u64,
    drives: &mut Drives,
) -> Option<CounterCheck> {
    let end = part.data.end + 2;
    let (answer, before) = (answer.get(..end)?, before.get(..end)?);
    let (mut silent, mut changed) = (false, false);
    if answer.get(part.data.start..) != before.get(part.data.start..) {
        if answer.last_chunk::<2>() != before.last_chunk() {
            return None;
        }
        for share in &part.shares {
            if let Some(area) = &share.inputs
                && let Some(bytes) = answer.get(area.clone())
                && let Some(old) = before.get(area.clone())
                && !are_equal(bytes, old)
                && let Some(drive) = drives.get_mut(share.drive)
            {
                silent |= !drive.take_other(bytes, cycle);
                changed = true;
            }
        }
        if silent {
            take_equal_to_the_pattern(part, answer, drives);
        }
    }
    Some(CounterCheck {
        right: true,
        fresh: !silent,
        steady: !silent,
        changed,
        miscounted: None,
    })
}

/// Whether what the working counter lacks are outputs of drives that have left OP, or drives that are being set up anew.
fn is_right_with_closed_outputs(
    part: &Part,
    drives: &Drives,
    expected: u16,
    counter: Option<u16>,
) -> bool {
    let closed = part.shares.iter().filter_map(|share| {
        let drive = drives.get(share.drive)?;
        if drive.away {
            return Some(share.counts);
        }
        let is_closed = share.outputs.is_some() && drive.has_left_op() && !drive.lost;
        is_closed.then(|| share.counts - u16::from(share.inputs.is_some()))
    });
    let closed: u16 = closed.sum();
    counter.is_some_and(|counter| (expected - closed..=expected).contains(&counter))
}

/// It is not known whose outputs were delivered.
fn mark_unconfirmed(part: &Part, miscounted: Option<WorkingCounter>, drives: &mut Drives) {
    drives.doubted = true;
    for share in &part.shares {
        if let Some(drive) = drives.get_mut(share.drive)
            && drive.answer == Answer::Fresh
        {
            drive.answer = Answer::Answered;
            drive.miscounted = miscounted;
        }
    }
}

/// Everybody has answered: whose inputs are equal to the pattern, has them so. Whether any are others than before.
fn take_equal_to_the_pattern(part: &Part, answer: &[u8], drives: &mut Drives) -> bool {
    let mut changed = false;
    for share in &part.shares {
        if let Some(drive) = drives.get_mut(share.drive)
            && drive.marker == InputMarker::AnyBits
            && drive.answer == Answer::Stale
            && !drive.lost
            && let Some(inputs) = &share.inputs
            && let Some(bytes) = answer.get(inputs.clone())
        {
            drive.take(bytes);
            drive.answer = Answer::Fresh;
            changed |= drive.changed;
        }
    }
    changed
}

// The time between the end of a cycle and the start of the next one, in which acyclic frames may be on their way.

/// The acyclic window, as seen from within it.
#[derive(Debug, Clone, Copy)]
pub(in crate::bus) struct AcyclicWindow {
    /// When the next cycle starts.
    pub end: Duration,
    /// How long a frame is away, as measured.
    pub round_trip: Duration,
    /// What a frame alone on the wire is reckoned with at the most: the longest ones would never go between short cycles.
    pub longest_alone: Duration,
}

impl AcyclicWindow {
    /// Whether a frame that is sent now is back before the window ends, when the wire is busy until then and takes this long for it.
    pub fn has_room(&self, now: Duration, busy_until: Duration, takes: Duration) -> bool {
        let takes = if busy_until <= now {
            takes.min(self.longest_alone)
        } else {
            takes
        };
        busy_until.max(now) + takes + self.round_trip <= self.end
    }
}

/// How long frames are away: the longest of late.
#[derive(Debug, Clone, Copy, Default)]
struct RoundTrip(Duration);

impl RoundTrip {
    /// Takes in what the frames of one cycle took. A long one counts for some hundred cycles.
    pub fn observe(&mut self, took: Duration) {
        self.0 = took.max(self.0 - self.0 / 64);
    }

    /// What is reckoned with. Not more than the end of every cycle leaves, an eighth of the period, so that mailboxes are served
    /// whatever was measured: a frame that is late then is counted.
    pub fn reckoned(self, eighth: Duration) -> Duration {
        self.0.min(eighth)
    }
}

// The cycles, as a program's time.

/// All wait for the same.
const CYCLE: u32 = 0;

/// What the bus thread reports of each cycle.
#[derive(Debug)]
pub(in crate::bus) struct CycleTick {
    ended_ns: AtomicU64,
    /// There are no more cycles.
    is_over: AtomicBool,
    waiters: Arc<Waiters>,
}

/// The end of whoever has the cycles: without it there are none any more.
pub(in crate::bus) struct TickSource(Arc<CycleTick>);

impl CycleTick {
    pub fn new(wakes: &Wakes) -> Arc<Self> {
        Arc::new(Self {
            ended_ns: AtomicU64::new(0),
            is_over: AtomicBool::new(false),
            waiters: wakes.waiters(),
        })
    }

    pub fn source(self: &Arc<Self>) -> TickSource {
        TickSource(Arc::clone(self))
    }

    /// When the last cycle ended.
    pub fn ended(&self) -> Duration {
        Duration::from_nanos(self.ended_ns.load(Ordering::Acquire))
    }
}

impl Drop for TickSource {
    fn drop(&mut self) {
        self.0.is_over.store(true, Ordering::Release);
        self.0.waiters.announce(CYCLE);
    }
}

impl Stepper for TickSource {
    fn before_send(&mut self, _: Duration, _: &mut Drives) {}

    /// To be called when everybody else has taken in what the cycle brought.
    fn after_receive(&mut self, now: Duration, _: &mut Drives) {
        let ns = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        self.0.ended_ns.store(ns, Ordering::Release);
        self.0.waiters.announce(CYCLE);
    }
}

/// The time of a network's cycles: by it a program waits for the next inputs, or for a while. From
/// [`Network::clock`](crate::Network::clock); clones are the same clock.
///
/// On a real link it goes as every clock does. On a [`Wire`](crate::link::Wire) in virtual time it goes as fast as the loop is
/// turned, so that a test of a machine's pauses takes no time: see
/// [`BusLoop::run_until`](crate::bus::BusLoop::run_until).
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{Network, bus::{Expected, IoConfig}, link::Wire};
/// # use servocrab_sim::{Segment, personality};
/// # let mut terminal = personality::digital_inputs();
/// # terminal.set_inputs(&[1]);
/// # let mut segment = Segment::new().with(terminal).with(personality::digital_outputs());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire)
/// #     .io(0, IoConfig::new("buttons", Expected::new(0, 0x4449_3038)))
/// #     .io(1, IoConfig::new("valves", Expected::new(0, 0x444F_3038))).start().await?;
/// use std::time::Duration;
/// let clock = net.clock();
/// let start = net.io("buttons")?.input::<bool>("Channel 1.Input")?;
/// let gripper = net.io("valves")?.output::<bool>("Channel 3.Output")?;
/// while start.get() != Ok(true) {
///     clock.next_cycle().await?; // looks at every cycle's inputs once
/// }
/// gripper.set(true);
/// clock.sleep(Duration::from_millis(30)).await?; // until it has closed
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct CycleClock {
    tick: Arc<CycleTick>,
}

impl CycleClock {
    pub(in crate::bus) const fn new(tick: Arc<CycleTick>) -> Self {
        Self { tick }
    }

    /// When the last cycle ended, by the link's time: that of [`Link::now`](crate::link::Link::now), of the log and of the
    /// black boxes.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.tick.ended()
    }

    /// Waits for the end of the next cycle, with what it brought, or did not, and gives its time.
    ///
    /// # Errors
    /// [`NetworkError::Thread`] once the network has ended.
    pub async fn next_cycle(&self) -> Result<Duration, NetworkError> {
        let last = self.now();
        self.until(|now| now > last).await
    }

    /// Waits for the first cycle that ends this much later than the last one did, or more. A time of zero waits for no cycle:
    /// [`next_cycle`](Self::next_cycle) does.
    ///
    /// # Errors
    /// [`NetworkError::Thread`] once the network has ended.
    pub async fn sleep(&self, duration: Duration) -> Result<(), NetworkError> {
        let until = self.now().saturating_add(duration);
        self.until(|now| now >= until).await.map(drop)
    }

    /// Waits for this, and no longer than so much of the network's time. None where that was over first: what was waited for is dropped
    /// then. In virtual time nothing depends on a clock of the computer.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use std::time::Duration;
    /// let emergencies = net.all_emergencies();
    /// let quiet = net.clock().timeout(Duration::from_millis(20), emergencies.next()).await?;
    /// assert!(quiet.is_none(), "no drive has said anything");
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`NetworkError::Thread`] once the network has ended.
    pub async fn timeout<T>(
        &self,
        limit: Duration,
        future: impl Future<Output = T>,
    ) -> Result<Option<T>, NetworkError> {
        let done = async { Ok(Some(future.await)) };
        let late = async { self.sleep(limit).await.map(|()| None) };
        smol::future::or(done, late).await
    }

    async fn until(&self, is_time: impl Fn(Duration) -> bool) -> Result<Duration, NetworkError> {
        let tick = &*self.tick;
        let shown = tick.waiters.until(CYCLE, || {
            // First this: the last cycle is one as well.
            let is_over = tick.is_over.load(Ordering::Acquire);
            let now = tick.ended();
            (is_time(now) || is_over).then_some(now)
        });
        let now = shown.await;
        if is_time(now) {
            return Ok(now);
        }
        Err(NetworkError::Thread("the network has ended".into()))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{AcyclicWindow, RoundTrip};
    use crate::bus::cable::time_on_cable;

    const fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn a_frame_has_room_when_it_is_back_before_the_next_cycle() {
        let window = AcyclicWindow {
            end: us(1000),
            round_trip: us(50),
            longest_alone: us(125),
        };
        // 84 bytes with all that is around the shortest frame: 6.72 µs.
        assert!(window.has_room(us(943), us(0), time_on_cable(14)));
        assert!(!window.has_room(us(944), us(0), time_on_cable(60)));
        // 1538 bytes with all that is around the longest one: 123.04 µs.
        assert!(window.has_room(us(826), us(0), time_on_cable(1514)));
        assert!(!window.has_room(us(827), us(0), time_on_cable(1514)));
        assert!(!window.has_room(us(820), us(828), time_on_cable(1514)));
    }

    #[test]
    fn between_cycles_shorter_than_a_frame_one_goes_alone() {
        let window = AcyclicWindow {
            end: us(100),
            round_trip: us(12),
            longest_alone: us(12),
        };
        assert!(window.has_room(us(50), us(0), time_on_cable(1514)));
        assert!(!window.has_room(us(50), us(57), time_on_cable(1514)));
        assert!(!window.has_room(us(80), us(0), time_on_cable(1514)));
    }

    #[test]
    fn a_long_round_trip_is_reckoned_with_for_a_while_and_never_with_more_than_is_left_of_every_cycle()
     {
        let mut round_trip = RoundTrip::default();
        round_trip.observe(us(80));
        round_trip.observe(us(20));
        assert!(round_trip.reckoned(us(125)) > us(75));
        for _ in 0..300 {
            round_trip.observe(us(20));
        }
        assert_eq!(round_trip.reckoned(us(125)), us(20));
        round_trip.observe(us(700));
        assert_eq!(round_trip.reckoned(us(125)), us(125));
    }
}
