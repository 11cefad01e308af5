//! The last cycles of every axis, kept as the frames that went out and came back, and read when somebody asks.
//!
//! Keeping a cycle is two copies for each frame, whatever the number of axes. They go to memory that no cache holds any more, and are
//! made while the thread has to wait for frames in any case.

use std::{fmt, ops::Range, time::Duration};

use crate::{
    axis::{AxisFields, AxisIdentity},
    bus::cycle::{
        exchange::{Answer, DriveData},
        packing::{Frame, Packed},
    },
    ds402::{Controlword, Mode, Sample},
};

/// Cycles that are kept: a second at cycles of 1 ms.
pub(in crate::bus) const KEPT: usize = 1000;

/// What came back of an axis in a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answered {
    /// Inputs, and the outputs were delivered.
    Delivered,
    /// Inputs; whether the outputs were delivered is not known (a wrong working counter).
    InputsOnly,
    /// Nothing.
    Nothing,
}

/// One cycle of an axis as it was.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordedCycle {
    /// The number of the cycle, from 1.
    pub number: u64,
    /// When its frames were sent, in the link's time.
    pub time: Duration,
    /// What came back.
    pub answered: Answered,
    /// Controlword 6040h as it was sent.
    pub controlword: Controlword,
    /// Target position 607Ah as it was sent, position units.
    pub target: i32,
    /// Statusword 6041h, position 6064h and what else is mapped, as they came back; `None` if nothing did.
    pub inputs: Option<Sample>,
}

/// What came upon an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AxisIncident {
    /// The drive went into Fault or Fault reaction active.
    Fault,
    /// The drive no longer answers: the axis counts as lost.
    Lost,
}

/// The last cycles of an axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlackBox {
    /// The axis and its drive.
    pub axis: AxisIdentity,
    /// What they were kept for; `None` where the program asked for them.
    pub incident: Option<AxisIncident>,
    /// The cycles, the oldest first: up to a thousand, and up to some milliseconds after the trouble.
    pub cycles: Vec<RecordedCycle>,
}

impl fmt::Display for BlackBox {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = match self.incident {
            Some(AxisIncident::Fault) => "has a fault",
            Some(AxisIncident::Lost) => "counts as lost",
            None => "was asked about",
        };
        write!(
            f,
            "{} {what}; what its last {} cycles were is in the black box",
            self.axis,
            self.cycles.len()
        )
    }
}

/// An axis of which cycles are read.
#[derive(Debug, Clone)]
pub(in crate::bus) struct RecordedAxis {
    pub(in crate::bus) identity: AxisIdentity,
    /// The place of its drive in the exchange.
    pub(in crate::bus) drive: usize,
    pub(in crate::bus) fields: AxisFields,
}

/// Keeps the last cycles of all drives.
pub(in crate::bus) struct Recorder {
    /// For each cycle: its frames as they were sent, as they came back, then what was judged of each drive.
    bytes: Box<[u8]>,
    heads: Box<[Head]>,
    /// Bytes of a cycle's frames.
    frames: usize,
    /// Bytes of one cycle.
    stride: usize,
    /// Where the cycle that is under way goes, or the next one.
    next: usize,
    /// The cycle that is under way.
    begun: Option<Head>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Head {
    /// 0: no cycle yet.
    number: u64,
    time: Duration,
}

impl Recorder {
    pub(in crate::bus) fn new(packed: &Packed, drives: usize) -> Self {
        let frames = lengths(&packed.frames);
        let stride = 2 * frames + drives;
        Self {
            bytes: vec![0; stride.saturating_mul(KEPT)].into(),
            heads: vec![Head::default(); KEPT].into(),
            frames,
            stride,
            next: 0,
            begun: None,
        }
    }

    /// Begins to keep a cycle, with its frames as they were sent.
    pub(in crate::bus) fn begin(&mut self, number: u64, time: Duration, frames: &[Frame]) {
        let requests = frames.iter().map(|frame| &frame.request);
        copy_in_turn(self.room(0), requests.map(Vec::as_slice));
        if let Some(head) = self.heads.get_mut(self.next) {
            // The oldest cycle is no longer whole.
            *head = Head::default();
        }
        self.begun = Some(Head { number, time });
    }

    /// Completes the cycle that was begun, if one was, when it has been judged. A frame that did not come back leaves an older answer,
    /// which nobody reads.
    pub(in crate::bus) fn complete(&mut self, frames: &[Frame], drives: &[DriveData]) {
        let Some(begun) = self.begun.take() else {
            return;
        };
        let answers = frames.iter().map(|frame| {
            let length = frame.request.len();
            frame.answer.get(..length).unwrap_or(&frame.request)
        });
        copy_in_turn(self.room(self.frames), answers);
        let judged = self.room(2 * self.frames).iter_mut();
        for (to, drive) in judged.zip(drives) {
            *to = drive.answer as u8;
        }
        if let Some(head) = self.heads.get_mut(self.next) {
            *head = begun;
        }
        self.next = (self.next + 1) % KEPT;
    }

    /// Where the cycle that is under way goes, from this byte of it on.
    fn room(&mut self, from: usize) -> &mut [u8] {
        let start = self.next.wrapping_mul(self.stride);
        let end = start.wrapping_add(self.stride);
        self.bytes
            .get_mut(start.wrapping_add(from)..end)
            .unwrap_or_default()
    }

    /// The kept cycles of an axis, the oldest first.
    pub(in crate::bus) fn read(&self, packed: &Packed, axis: &RecordedAxis) -> Vec<RecordedCycle> {
        let place = RecordRanges::of(packed, axis.drive);
        let order = (self.next..KEPT).chain(0..self.next);
        let kept = order.filter_map(|at| {
            let head = self.heads.get(at).filter(|head| head.number != 0)?;
            let from = at.checked_mul(self.stride)?;
            let bytes = self.bytes.get(from..from + self.stride)?;
            cycle_of(head, bytes, &place, axis)
        });
        kept.collect()
    }
}

/// Bytes of these frames.
fn lengths(frames: &[Frame]) -> usize {
    frames.iter().map(|frame| frame.request.len()).sum()
}

/// Copies one slice behind the other.
fn copy_in_turn<'a>(mut to: &mut [u8], from: impl Iterator<Item = &'a [u8]>) {
    for bytes in from {
        let Some((here, rest)) = to.split_at_mut_checked(bytes.len()) else {
            return;
        };
        here.copy_from_slice(bytes);
        to = rest;
    }
}

/// Where a drive's bytes lie in the record of a cycle.
struct RecordRanges {
    outputs: Option<Range<usize>>,
    inputs: Option<Range<usize>>,
    /// What was judged of it, behind the frames.
    judged: usize,
}

impl RecordRanges {
    fn of(packed: &Packed, drive: usize) -> Self {
        let all = lengths(&packed.frames);
        let mut place = Self {
            outputs: None,
            inputs: None,
            judged: 2 * all + drive,
        };
        for part in &packed.parts {
            // What was sent lies in front of what came back.
            let request = lengths(packed.frames.get(..part.frame).unwrap_or_default());
            let answer = all + request;
            let behind =
                |start: usize| move |range: &Range<usize>| start + range.start..start + range.end;
            for share in part.shares.iter().filter(|share| share.drive == drive) {
                place.outputs = share
                    .outputs
                    .as_ref()
                    .map(behind(request))
                    .or(place.outputs);
                place.inputs = share.inputs.as_ref().map(behind(answer)).or(place.inputs);
            }
        }
        place
    }
}

fn cycle_of(
    head: &Head,
    bytes: &[u8],
    place: &RecordRanges,
    axis: &RecordedAxis,
) -> Option<RecordedCycle> {
    let answered = match bytes.get(place.judged)? {
        byte if *byte == Answer::Fresh as u8 => Answered::Delivered,
        byte if *byte == Answer::Answered as u8 => Answered::InputsOnly,
        _ => Answered::Nothing,
    };
    let outputs = bytes.get(place.outputs.clone()?);
    let inputs = place.inputs.clone().and_then(|range| bytes.get(range));
    let (controlword, target) = axis.fields.sent(outputs?)?;
    let inputs = inputs.filter(|_| answered != Answered::Nothing);
    Some(RecordedCycle {
        number: head.number,
        time: head.time,
        answered,
        controlword,
        target,
        inputs: inputs.and_then(|inputs| axis.fields.sample(inputs, Mode::None)),
    })
}
