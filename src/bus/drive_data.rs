//! What each drive gets and gives in the exchange, and how long it has been silent.

use std::ops::{Deref, DerefMut};

use super::packing::{Member, Sign};
use crate::{axis::Inputs, profile_position::WorkingCounter};

/// Fills unanswered input areas. As a statusword it decodes to no state (CiA DSP 402 v2.0, table 7).
pub(super) const PATTERN: u8 = 0xFF;
/// Fill unanswered inputs of other devices, in turn.
pub(super) const PATTERNS: [u8; 2] = [0x55, 0xAA];

/// All that take part, in the order of the exchange.
#[derive(Debug)]
pub(super) struct Drives {
    drives: Box<[DriveData]>,
    /// Whether outputs of any of them were written since they were packed.
    written: bool,
    /// Whether one was taken away since the last cycle was judged.
    disturbed: bool,
    /// Whether it was not known of any in the last cycle whether its outputs were delivered.
    pub(super) doubted: bool,
}

/// One drive's share of the exchange.
#[derive(Debug, Clone)]
pub(super) struct DriveData {
    /// What is sent in the next cycle.
    outputs: Box<[u8]>,
    /// Whether that is not in the frame yet.
    unpacked: bool,
    /// What came back last.
    pub(super) inputs: Box<[u8]>,
    /// Whether the last cycle brought other inputs than the one before.
    pub(super) changed: bool,
    /// What the last cycle brought.
    pub(super) answer: Answer,
    /// Whether it counts as lost: then nothing is expected of it.
    pub(super) lost: bool,
    /// The working counter because of which it is not known whether its outputs were delivered, where it has answered.
    pub(super) miscounted: Option<WorkingCounter>,
    /// Whether it is in OP, so that it acts on its outputs.
    pub(super) operational: bool,
    /// Whether it was seen to have left OP: it may close its outputs then, and counts for its inputs alone.
    pub(super) fallen: bool,
    /// Whether it is being set up anew: it counts as lost, and what it adds to a working counter meanwhile is nobody's loss.
    pub(super) away: bool,
    stale_cycles: u32,
    pub(super) patience: u32,
    pub(super) sign: Sign,
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

impl Drives {
    pub(super) fn new(members: &[Member]) -> Self {
        Self {
            drives: members.iter().map(DriveData::new).collect(),
            written: true,
            disturbed: false,
            doubted: false,
        }
    }

    /// What a drive is sent in the next cycle, to be written to.
    pub(super) fn outputs_mut(&mut self, place: usize) -> Option<&mut [u8]> {
        let drive = self.drives.get_mut(place)?;
        self.written = true;
        drive.unpacked = true;
        Some(&mut drive.outputs)
    }

    /// Lets an axis core take the inputs of its drive, which are the same as before or not, and write the outputs, and say whether
    /// it has. Gives the inputs where they are others than before; none at all where the core says nothing, or there is no such drive.
    #[inline]
    pub(super) fn step(
        &mut self,
        place: usize,
        core: impl FnOnce(Inputs<'_>, bool, &mut [u8]) -> Option<bool>,
    ) -> Option<Option<&[u8]>> {
        let drive = self.drives.get_mut(place)?;
        let others = drive.changed.then_some(&*drive.inputs);
        let inputs = judged(drive.answer, drive.operational, &drive.inputs);
        if core(inputs, others.is_none(), &mut drive.outputs)? {
            drive.unpacked = true;
            self.written = true;
        }
        Some(others)
    }

    /// The working counter because of which it is not known whether the outputs of the drive at this place were delivered.
    pub(super) fn miscounted(&self, place: usize) -> Option<WorkingCounter> {
        let drive = self.drives.get(place)?;
        drive
            .miscounted
            .filter(|_| drive.answer == Answer::Answered)
    }

    /// Whether that is not known of any. For whoever asks first.
    pub(super) fn take_doubted(&mut self) -> bool {
        core::mem::take(&mut self.doubted)
    }

    /// One of them is being set up anew from now on: nothing of it is taken.
    pub(super) fn take_away(&mut self, place: usize) {
        if let Some(drive) = self.drives.get_mut(place) {
            drive.away = true;
            drive.lost = true;
            drive.operational = false;
            self.disturbed = true;
        }
    }

    /// Whether one was taken away: then nothing holds that was judged before. For whoever asks first.
    pub(super) fn take_disturbed(&mut self) -> bool {
        core::mem::take(&mut self.disturbed)
    }

    /// Whether outputs of any drive are not in the frames yet. They are packed by whoever asks.
    pub(super) fn take_written(&mut self) -> bool {
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
            operational: false,
            fallen: false,
            away: false,
            stale_cycles: 0,
            patience: member.patience,
            sign: member.sign,
        }
    }

    /// It is set up, and not yet in OP.
    pub(super) const fn put_back(&mut self) {
        self.away = false;
        self.fallen = true;
    }

    /// The outputs, where they were written since this was asked last.
    pub(super) fn take_unpacked(&mut self) -> Option<&[u8]> {
        core::mem::take(&mut self.unpacked).then_some(&*self.outputs)
    }

    /// Takes what came back in the place of its inputs. False if it has not answered there.
    #[inline]
    pub(super) fn take_answer(&mut self, bytes: Option<&[u8]>, cycle: u64) -> bool {
        match bytes.filter(|bytes| self.is_answer(bytes, cycle)) {
            Some(bytes) => self.take(bytes),
            None => self.answer = Answer::Stale,
        }
        self.answer != Answer::Stale
    }

    /// The same, of bytes that are others than the inputs of one that has answered in the cycle before.
    #[inline]
    pub(super) fn take_other(&mut self, bytes: &[u8], cycle: u64) -> bool {
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
        let pattern = match self.sign {
            Sign::Statusword => PATTERN,
            Sign::AnyBits => alternating(cycle),
        };
        bytes.iter().any(|byte| *byte != pattern)
    }

    /// Whether it has answered where it has no inputs: only where it has none at all, and the datagram to itself, that is
    /// known.
    pub(super) fn is_counted(&mut self, counter: Option<u16>) -> bool {
        if !self.inputs.is_empty() {
            return false;
        }
        let there = counter.is_some_and(|counter| counter != 0);
        if !there && !self.fallen {
            self.answer = Answer::Stale;
        }
        there
    }

    /// Takes inputs of their own length.
    #[inline]
    pub(super) fn take(&mut self, from: &[u8]) {
        self.changed = !are_equal(&self.inputs, from);
        if self.changed {
            copy(&mut self.inputs, from);
        }
    }

    /// Counts a cycle. True when it is lost from now on, or no longer.
    pub(super) fn count_silence(&mut self) -> bool {
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

/// What inputs are worth that were judged so, of a drive that acts on its outputs or not.
#[inline]
pub(super) const fn judged(answer: Answer, operational: bool, inputs: &[u8]) -> Inputs<'_> {
    match answer {
        Answer::Fresh if operational => Inputs::Fresh(inputs),
        Answer::Fresh | Answer::Answered => Inputs::Answered(inputs),
        Answer::Stale => Inputs::Stale,
    }
}

/// What unanswered inputs are filled with that can hold any bits.
pub(super) const fn alternating(cycle: u64) -> u8 {
    PATTERNS[(cycle % 2) as usize]
}

// An axis has seldom more than two words, which may overlap: a call of a general comparison or copy costs more than these.

/// Whether the inputs of a drive are the same.
#[inline]
pub(super) fn are_equal(a: &[u8], b: &[u8]) -> bool {
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
