//! The cyclic exchange: process-data frames composed once, sent each cycle, judged when they come back.
//!
//! Before sending, the input areas are filled with a pattern that no DS402 drive can answer. An area that still holds it was
//! not answered, so that one silent drive does not blind the others that share its datagram. The inputs of other devices can
//! hold any bits: there the pattern alternates, and where they are equal to it a right working counter decides.

use std::{ops::Range, time::Duration};

use super::NetworkError;
use super::black_box::{RecordedAxis, RecordedCycle, Recorder};
use super::dc::Distribution;
use super::drive_data::{Answer, Drives, PATTERN, alternating};
use super::frame::{self, Tag};
use super::judging::{judge_calmly, judge_part};
use super::mailbox_states::{MailboxStates, Watched};
use super::packing::{Frame, Member, Packed, Sign, pack};
use super::statistics::Counters;
use crate::{link::Link, profile_position::WorkingCounter};

/// The most frames of a cycle: each has its place in a byte of its source address.
const MOST_FRAMES: usize = 255;

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
    pub(super) drives: Drives,
    packed: Packed,
    /// Where inputs lie that can hold any bits: frame and place.
    any_bits: Vec<(usize, Range<usize>)>,
    /// Whether the last cycle brought inputs from every drive, and all outputs were delivered.
    all_fresh: bool,
    /// Whether it brought other inputs than the one before from any of them.
    changed: bool,
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
        let mut packed = pack(members, mailboxes.len(), clock);
        let mut any_bits = Vec::new();
        for part in &packed.parts {
            for share in &part.shares {
                let Some(inputs) = &share.inputs else {
                    continue;
                };
                let sign = members.get(share.drive).map(|member| member.sign);
                if sign == Some(Sign::AnyBits) {
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
            recorder: Recorder::new(&packed, members.len()),
            packed,
            any_bits,
            all_fresh: false,
            changed: false,
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
                    core::mem::swap(&mut frame.answer, &mut frame.before);
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
            let frame = self.packed.frames.get(part.frame);
            let frame = frame.filter(|frame| frame.back);
            let calmly = frame.filter(|_| were_fresh && part.calm).and_then(|frame| {
                let Frame { answer, before, .. } = frame;
                judge_calmly(part, answer, before, self.cycle, &mut self.drives)
            });
            let verdict = calmly.unwrap_or_else(|| {
                let answer = frame.map(|frame| frame.answer.as_slice());
                judge_part(part, answer, self.cycle, &mut self.drives, &mut events)
            });
            part.calm = verdict.calm;
            part.miscounted = verdict.miscounted.map(|counter| {
                let cycles = part.miscounted.map_or(0, |(_, cycles)| cycles);
                (counter, cycles.saturating_add(1))
            });
            self.all_fresh &= verdict.fresh;
            self.changed |= verdict.changed;
            if !verdict.right && frame.is_some() {
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

    /// Counts who was silent and whose outputs are in doubt.
    fn count_silence(&mut self, counters: &Counters, events: &mut Events) {
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
    }

    /// The working counters that are wrong, whether for so long that a silent drive would count as lost, and who shares the datagram.
    pub(super) fn miscounted(
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
    pub(super) fn record(&mut self, time: Duration) {
        let Packed { frames, .. } = &self.packed;
        self.recorder.complete(frames, &self.drives);
        self.recorder.begin(self.cycle, time, frames);
    }

    /// Keeps what was judged last, for whoever does not wait for the next cycle.
    pub(super) fn complete_record(&mut self) {
        if !self.in_flight {
            self.recorder.complete(&self.packed.frames, &self.drives);
        }
    }

    /// The last cycles of an axis that are complete, the oldest first.
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

/// How long the frames of a cycle may be away.
pub(super) fn receive_deadline(cycle: Duration) -> Duration {
    // The rest of the cycle is for the axis cores and for acyclic frames.
    cycle * 3 / 4
}

#[cfg(test)]
#[path = "exchange_tests.rs"]
mod tests;

#[cfg(test)]
#[path = "exchange_twins.rs"]
mod twins;
