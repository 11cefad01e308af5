//! The cyclic exchange: process-data frames composed once, sent each cycle, judged when they come back.
//!
//! Before sending, the input areas are filled with a pattern that no DS402 drive can answer. An area that still holds it was
//! not answered, so that one silent drive does not blind the others that share its datagram. The inputs of other devices can
//! hold any bits: there the pattern alternates, and where they are equal to it a right working counter decides.

use std::{ops::Range, time::Duration};

use super::NetworkError;
use super::black_box::{RecordedAxis, RecordedCycle, Recorder};
use super::dc::Distribution;
use super::frame::{self, Tag};
use super::mailbox_states::{MailboxStates, Watched};
use super::packing::{Member, Packed, Part, Sign, pack};
use super::statistics::Counters;
use crate::{axis::Inputs, link::Link};

/// Fills unanswered input areas. As a statusword it decodes to no state (CiA DSP 402 v2.0, table 7).
const PATTERN: u8 = 0xFF;
/// Fill unanswered inputs of other devices, in turn.
const PATTERNS: [u8; 2] = [0x55, 0xAA];

/// The most frames of a cycle: each has its place in a byte of its source address.
const MOST_FRAMES: usize = 255;

/// One drive's share of the exchange.
#[derive(Debug, Clone)]
pub(super) struct DriveData {
    /// What is sent in the next cycle.
    outputs: Vec<u8>,
    /// Whether that is not in the frame yet.
    unpacked: bool,
    /// What came back last.
    pub(super) inputs: Vec<u8>,
    /// Whether the last cycle brought other inputs than the one before.
    pub(super) changed: bool,
    /// What the last cycle brought.
    pub(super) answer: Answer,
    /// Whether it counts as lost: then nothing is expected of it.
    pub(super) lost: bool,
    /// Whether it is in OP, so that it acts on its outputs.
    pub(super) operational: bool,
    /// Whether it was seen to have left OP: it may close its outputs then, and counts for its inputs alone.
    pub(super) fallen: bool,
    /// Whether it is being set up anew: it counts as lost, and what it adds to a working counter meanwhile is nobody's loss.
    pub(super) away: bool,
    stale_cycles: u32,
    patience: u32,
    sign: Sign,
}

/// What a cycle brought from a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Answer {
    /// Inputs, and the outputs were delivered.
    Fresh,
    /// Inputs; whether the outputs were delivered is not known.
    Answered,
    /// Nothing.
    Stale,
}

impl DriveData {
    /// What is sent in the next cycle, to be written to.
    pub(super) fn outputs_mut(&mut self) -> &mut [u8] {
        self.unpacked = true;
        &mut self.outputs
    }

    /// Lets an axis core take the inputs and write the outputs, and say whether it has.
    pub(super) fn step(&mut self, core: impl FnOnce(Inputs<'_>, bool, &mut [u8]) -> bool) {
        let unchanged = !self.changed;
        let (inputs, outputs) = self.judged();
        let written = core(inputs, unchanged, outputs);
        self.unpacked |= written;
    }

    fn judged(&mut self) -> (Inputs<'_>, &mut [u8]) {
        let inputs = match self.answer {
            Answer::Fresh if self.operational => Inputs::Fresh(&self.inputs),
            Answer::Fresh | Answer::Answered => Inputs::Answered(&self.inputs),
            Answer::Stale => Inputs::Stale,
        };
        (inputs, &mut self.outputs)
    }

    /// It is being set up anew from now on: nothing of it is taken.
    pub(super) const fn take_away(&mut self) {
        self.away = true;
        self.lost = true;
        self.operational = false;
    }

    /// It is set up, and not yet in OP.
    pub(super) const fn put_back(&mut self) {
        self.away = false;
        self.fallen = true;
    }

    /// The inputs, where they are others than before.
    pub(super) fn news(&self) -> Option<&[u8]> {
        self.changed.then_some(&self.inputs)
    }
}

/// What happened to the drives in a cycle, beyond their data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Events {
    /// A drive fell silent for good, or came back.
    pub(super) membership: bool,
    /// All AL states OR-ed together and the number of SubDevices that answered, where that came back.
    pub(super) al_status: Option<(u8, u16)>,
    /// A working counter was wrong.
    pub(super) wrong: bool,
    /// The low half of the reference clock's time when the frames passed it, where it is distributed and came back.
    pub(super) reference_time: Option<u32>,
}

pub(super) struct Exchange {
    pub(super) drives: Vec<DriveData>,
    packed: Packed,
    mailboxes: MailboxStates,
    recorder: Recorder,
    cycle: u64,
    in_flight: bool,
    /// Frames of this cycle that the link did not take.
    refused: usize,
}

impl Exchange {
    pub(super) fn new(
        members: &[Member],
        mailboxes: Vec<Watched>,
        clock: Option<Distribution>,
    ) -> Self {
        let drives = members.iter().map(|member| DriveData {
            outputs: vec![0; member.outputs],
            unpacked: true,
            inputs: vec![0; member.inputs],
            changed: false,
            answer: Answer::Stale,
            lost: false,
            operational: false,
            fallen: false,
            away: false,
            stale_cycles: 0,
            patience: member.patience,
            sign: member.sign,
        });
        let mut packed = pack(members, mailboxes.len(), clock);
        for part in &packed.parts {
            for share in &part.shares {
                if let Some(frame) = packed.frames.get_mut(part.frame)
                    && let Some(to) = slice_mut(&mut frame.request, share.inputs.as_ref())
                {
                    to.fill(PATTERN);
                }
            }
        }
        Self {
            drives: drives.collect(),
            recorder: Recorder::new(&packed, members.len()),
            packed,
            mailboxes: MailboxStates::new(mailboxes),
            cycle: 0,
            in_flight: false,
            refused: 0,
        }
    }

    /// The lengths of a cycle's frames.
    pub(super) fn lengths(&self) -> impl Iterator<Item = usize> {
        self.packed.frames.iter().map(|frame| frame.request.len())
    }

    /// The exchange, if it can send all of its frames.
    pub(super) fn checked(self) -> Result<Self, NetworkError> {
        match self.packed.frames.len() {
            ..=MOST_FRAMES => Ok(self),
            got => Err(NetworkError::TooManyFrames {
                most: MOST_FRAMES,
                got,
            }),
        }
    }

    /// Whether frames are on their way.
    pub(super) const fn in_flight(&self) -> bool {
        self.in_flight
    }

    /// Sets what the next frames carry as the time at which they pass the reference clock.
    pub(super) fn set_reference_time(&mut self, time: u32) {
        if let (Some(slot), Some(first)) = (&mut self.packed.clock, self.packed.frames.first_mut())
        {
            slot.fill(&mut first.request, time);
        }
    }

    /// From now on all clocks get the time of the cycles.
    pub(super) fn lead_clocks(&mut self) {
        if let (Some(slot), Some(first)) = (&self.packed.clock, self.packed.frames.first_mut()) {
            slot.lead(&mut first.request);
        }
    }

    /// How long the frames of a cycle take at one place of the cable.
    pub(super) fn time_on_cable(&self) -> Duration {
        let lengths = self.packed.frames.iter().map(|frame| frame.request.len());
        lengths.map(frame::time_on_cable).sum()
    }

    /// Sends all frames of a cycle back to back.
    pub(super) fn send(&mut self, link: &mut dyn Link, counters: &Counters) {
        self.cycle = self.cycle.wrapping_add(1);
        for part in &self.packed.parts {
            let Some(frame) = self.packed.frames.get_mut(part.frame) else {
                continue;
            };
            for share in &part.shares {
                let Some(drive) = self.drives.get_mut(share.drive) else {
                    continue;
                };
                // What was packed into the frame before stays there.
                if drive.unpacked
                    && let Some(to) = slice_mut(&mut frame.request, share.outputs.as_ref())
                {
                    to.copy_from_slice(&drive.outputs);
                    drive.unpacked = false;
                }
                if drive.sign == Sign::AnyBits
                    && let Some(to) = slice_mut(&mut frame.request, share.inputs.as_ref())
                {
                    to.fill(drive.pattern(self.cycle));
                }
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
            let source = Tag::cyclic(self.cycle, place).source_address();
            if let Some(to) = frame.request.get_mut(6..12) {
                to.copy_from_slice(&source);
            }
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
    pub(super) fn accept(&mut self, tag: Tag, answer: &[u8], counters: &Counters) -> bool {
        let Tag::Cyclic { frame: place, .. } = tag else {
            return false;
        };
        let current = self.in_flight && tag == Tag::cyclic(self.cycle, place);
        match self.packed.frames.get_mut(usize::from(place)) {
            Some(frame) if current && !frame.back => {
                if frame::is_answer_to(answer, &frame.request) {
                    frame.answer.clear();
                    frame.answer.extend_from_slice(answer);
                    frame.back = true;
                } else {
                    counters.damaged.add();
                }
            }
            _ => counters.late.add(),
        }
        current && self.packed.frames.iter().all(|frame| frame.back)
    }

    /// Judges what came back and ends the cycle.
    pub(super) fn judge(&mut self, counters: &Counters) -> Events {
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
        for drive in &mut self.drives {
            drive.answer = Answer::Fresh;
            drive.changed = false;
        }
        for part in &self.packed.parts {
            let answer = self
                .packed
                .frames
                .get(part.frame)
                .filter(|frame| frame.back)
                .map(|frame| frame.answer.as_slice());
            let right = judge_part(part, answer, self.cycle, &mut self.drives, &mut events);
            if !right && answer.is_some() {
                counters.wrong_working_counters.add();
                events.wrong = true;
            }
        }
        for (place, drive) in self.drives.iter_mut().enumerate() {
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
        self.mailboxes
            .judge(&self.packed.mailbox_states, &self.packed.frames);
        events.al_status = self.read_al_status();
        events.reference_time = self.read_reference_time();
        events
    }

    /// Keeps the cycle that was just judged, whose frames were sent at `time`.
    pub(super) fn record(&mut self, time: Duration) {
        let Packed { frames, .. } = &self.packed;
        self.recorder.keep(self.cycle, time, frames, &self.drives);
    }

    /// The last cycles of an axis, the oldest first.
    pub(super) fn history(&self, axis: &RecordedAxis) -> Vec<RecordedCycle> {
        self.recorder.read(&self.packed, axis)
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

impl DriveData {
    /// What its inputs are filled with before they are sent.
    const fn pattern(&self, cycle: u64) -> u8 {
        match self.sign {
            Sign::Statusword => PATTERN,
            Sign::AnyBits => PATTERNS[(cycle % 2) as usize],
        }
    }

    /// True when it is lost from now on, or no longer.
    fn count_silence(&mut self) -> bool {
        let before = self.lost;
        if self.answer == Answer::Stale {
            self.stale_cycles = self.stale_cycles.saturating_add(1);
            self.lost |= self.stale_cycles >= self.patience;
            // What state it comes back in is to be read anew.
            self.operational &= !self.lost;
        } else {
            self.stale_cycles = 0;
        }
        self.lost != before
    }
}

/// Takes the inputs of the drives that share a datagram. Whether its working counter was right.
fn judge_part(
    part: &Part,
    answer: Option<&[u8]>,
    cycle: u64,
    drives: &mut [DriveData],
    events: &mut Events,
) -> bool {
    let counter = answer
        .and_then(|answer| answer.get(part.data.end..part.data.end + 2))
        .and_then(|bytes| <[u8; 2]>::try_from(bytes).ok())
        .map(u16::from_le_bytes);
    let (mut expected, mut closed, mut undecided) = (0, 0, false);
    for share in &part.shares {
        let Some(drive) = drives.get_mut(share.drive) else {
            continue;
        };
        if drive.away {
            drive.answer = Answer::Stale;
            expected += share.counts;
            closed += share.counts;
            continue;
        }
        let inputs = share.inputs.as_ref().map(|inputs| {
            let bytes = answer.and_then(|answer| answer.get(inputs.clone()));
            let pattern = drive.pattern(cycle);
            bytes.filter(|bytes| bytes.iter().any(|byte| *byte != pattern))
        });
        let answered = match inputs {
            Some(Some(bytes)) => {
                drive.changed = take(&mut drive.inputs, bytes);
                true
            }
            Some(None) => {
                drive.answer = Answer::Stale;
                undecided = true;
                false
            }
            // It has none at all, and the datagram to itself.
            None if drive.inputs.is_empty() => {
                let there = counter.is_some_and(|counter| counter != 0);
                if !there && !drive.fallen {
                    drive.answer = Answer::Stale;
                }
                there
            }
            None => false,
        };
        if answered {
            events.membership |= drive.lost;
            drive.lost = false;
        }
        if !drive.lost {
            expected += share.counts;
            if drive.fallen && share.outputs.is_some() {
                closed += share.counts - u16::from(share.inputs.is_some());
            }
        }
    }
    if undecided && counter == Some(expected) {
        take_equal_to_the_pattern(part, answer, drives);
    }
    let right = counter.is_some_and(|counter| (expected - closed..=expected).contains(&counter));
    if !right {
        for share in &part.shares {
            if let Some(drive) = drives.get_mut(share.drive)
                && drive.answer == Answer::Fresh
            {
                drive.answer = Answer::Answered;
            }
        }
    }
    right
}

/// Everybody has answered: whose inputs are equal to the pattern, has them so.
fn take_equal_to_the_pattern(part: &Part, answer: Option<&[u8]>, drives: &mut [DriveData]) {
    for share in &part.shares {
        if let Some(drive) = drives.get_mut(share.drive)
            && drive.sign == Sign::AnyBits
            && drive.answer == Answer::Stale
            && !drive.lost
            && let Some(inputs) = &share.inputs
            && let Some(bytes) = answer.and_then(|answer| answer.get(inputs.clone()))
        {
            drive.changed = take(&mut drive.inputs, bytes);
            drive.answer = Answer::Fresh;
        }
    }
}

/// Takes bytes of the same length. Whether they are others than before.
#[inline]
fn take(to: &mut [u8], from: &[u8]) -> bool {
    // An axis is seldom more: as two words, which may overlap. A call of a general copy costs more than that.
    if (8..=16).contains(&from.len())
        && to.len() == from.len()
        && let (Some(first), Some(last)) = (from.first_chunk::<8>(), from.last_chunk::<8>())
    {
        let changed = to.first_chunk() != Some(first) || to.last_chunk() != Some(last);
        if changed && let Some(to) = to.first_chunk_mut() {
            *to = *first;
        }
        if changed && let Some(to) = to.last_chunk_mut() {
            *to = *last;
        }
        return changed;
    }
    let changed = to != from;
    if changed {
        to.copy_from_slice(from);
    }
    changed
}

fn slice_mut<'a>(bytes: &'a mut [u8], range: Option<&Range<usize>>) -> Option<&'a mut [u8]> {
    bytes.get_mut(range?.clone())
}

/// How long the frames of a cycle may be away.
pub(super) fn receive_deadline(cycle: Duration) -> Duration {
    // The rest of the cycle is for the axis cores and for acyclic frames.
    cycle * 3 / 4
}

#[cfg(test)]
#[path = "exchange_tests.rs"]
mod tests;
