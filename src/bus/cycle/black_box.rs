//! The last cycles of every axis, kept as the frames that went out and came back, and read when somebody asks.
//!
//! Keeping a cycle is two copies for each frame, whatever the number of axes. They go to memory that no cache holds any more, and are
//! made while the thread has to wait for frames in any case.

use std::{
    fmt, hint, mem,
    ops::Range,
    sync::{
        Arc, Mutex, TryLockError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use super::{
    Answer, DriveData,
    frame::{Frame, Packed},
};
use crate::{
    axis::{AxisFields, AxisIdentity},
    ds402::{Controlword, Mode, Sample},
};

/// Cycles that are kept: a second at cycles of 1 ms.
const KEPT: usize = 1000;
/// How many places in a row are tried where others are at them.
const READERS_PASSED: usize = 4;

/// What came back of an axis in a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
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
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
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
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum AxisIncident {
    /// The drive went into Fault or Fault reaction active.
    Fault,
    /// The drive no longer answers: the axis counts as lost.
    Lost,
    /// It has left its window although its brake is closed and its power gone
    /// ([`Snapshot::slipped`](crate::axis::Snapshot::slipped)).
    Slipped,
}

/// The last cycles of an axis.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
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
            Some(AxisIncident::Slipped) => "has slipped on its brake",
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
    pub identity: AxisIdentity,
    /// The place of its drive in the exchange.
    pub drive: usize,
    pub fields: AxisFields,
}

/// Writes the last cycles of all drives into their ring.
pub(in crate::bus) struct RingWriter {
    ring: Arc<CycleRing>,
    /// The cycle that is under way. When it is complete it changes places with the oldest one.
    record: CycleRecord,
    begun: bool,
}

/// The last cycles of all drives, as their frames went out and came back. One thread writes and any number read.
///
/// Neither side waits for the other. Each record has a lock of its own that is only tried: a reader comes back later, and the writer
/// leaves out a place that is being read, which is the oldest one.
#[derive(Debug)]
pub(in crate::bus) struct CycleRing {
    records: Box<[Mutex<CycleRecord>]>,
    /// How many places were written or left out. The next one is at this number, counted round the ring.
    written: AtomicU64,
    /// Nothing more is written.
    is_over: AtomicBool,
    /// Bytes of a cycle's frames.
    frames: usize,
    devices: Box<[RecordRanges]>,
}

/// One cycle: its frames as they were sent, as they came back, then the judgement of each device.
#[derive(Debug)]
pub(in crate::bus) struct CycleRecord {
    /// The number of its place, from 1; 0 of one that was never written.
    place: u64,
    /// The number of the cycle.
    pub number: u64,
    /// When its frames were sent, and how much later than planned.
    pub time: Duration,
    pub late: Duration,
    bytes: Box<[u8]>,
}

/// What a reader finds at a place of the ring.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) enum RingLook<T> {
    Record(T),
    /// It was left out.
    LeftOut,
    /// A newer one is in its place.
    Overwritten,
    /// It is not written yet, or somebody is at it.
    NotYet,
}

impl RingWriter {
    pub fn new(packed: &Packed, drives: usize) -> Self {
        let frames = lengths(&packed.frames);
        let bytes = (2_usize).saturating_mul(frames).saturating_add(drives);
        let record = || CycleRecord {
            place: 0,
            number: 0,
            time: Duration::ZERO,
            late: Duration::ZERO,
            bytes: vec![0; bytes].into(),
        };
        let devices = (0..drives).map(|drive| RecordRanges::of(packed, drive));
        let ring = CycleRing {
            records: (0..KEPT).map(|_| Mutex::new(record())).collect(),
            written: AtomicU64::new(0),
            is_over: AtomicBool::new(false),
            frames,
            devices: devices.collect(),
        };
        Self {
            ring: Arc::new(ring),
            record: record(),
            begun: false,
        }
    }

    pub const fn ring(&self) -> &Arc<CycleRing> {
        &self.ring
    }

    /// Begins to keep a cycle, with its frames as they were sent.
    pub fn begin(&mut self, number: u64, time: Duration, late: Duration, frames: &[Frame]) {
        let requests = frames.iter().map(|frame| &frame.request);
        copy_in_turn(&mut self.record.bytes, requests.map(Vec::as_slice));
        self.record.number = number;
        self.record.time = time;
        self.record.late = late;
        self.begun = true;
    }

    /// Completes the cycle that was begun, if one was, when it has been judged. A frame that did not come back leaves an older answer,
    /// which nobody reads.
    pub fn complete(&mut self, frames: &[Frame], drives: &[DriveData]) {
        if !mem::take(&mut self.begun) {
            return;
        }
        let (_, behind) = self
            .record
            .bytes
            .split_at_mut_checked(self.ring.frames)
            .unwrap_or_default();
        let answers = frames.iter().map(|frame| {
            let length = frame.request.len();
            frame.answer.get(..length).unwrap_or(&frame.request)
        });
        let judged = copy_in_turn(behind, answers);
        for (to, drive) in judged.iter_mut().zip(drives) {
            *to = drive.answer as u8;
        }
        self.ring.put(&mut self.record);
    }
}

impl Drop for RingWriter {
    fn drop(&mut self) {
        self.ring.is_over.store(true, Ordering::Release);
    }
}

impl CycleRing {
    /// Puts a record in the place of the oldest one, and gives that back to be written anew. Only one thread puts.
    fn put(&self, record: &mut CycleRecord) {
        let mut written = self.written.load(Ordering::Relaxed);
        // Nobody holds more than one place at a time. Where readers hold all that are tried the cycle is lost to all of them.
        for _ in 0..READERS_PASSED {
            let place = self.records.get(slot(written));
            written += 1;
            let free = match place.map(Mutex::try_lock) {
                Some(Ok(free)) => Some(free),
                Some(Err(TryLockError::Poisoned(poisoned))) => Some(poisoned.into_inner()),
                Some(Err(TryLockError::WouldBlock)) | None => None,
            };
            if let Some(mut oldest) = free {
                record.place = written;
                mem::swap(&mut *oldest, record);
                break;
            }
        }
        self.written.store(written, Ordering::Release);
    }

    /// The number of the place behind the newest.
    pub fn written(&self) -> u64 {
        self.written.load(Ordering::Acquire)
    }

    /// The number of the oldest place that is not overwritten soon.
    pub fn not_soon_overwritten(&self) -> u64 {
        const MARGIN: u64 = KEPT as u64 / 8;
        let oldest = self.written().saturating_sub(KEPT as u64);
        oldest + MARGIN
    }

    /// Whether nothing more is written. To be asked before the last look at what was.
    pub fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Acquire)
    }

    /// Reads the record at this place, counted from 0.
    pub fn look<T>(&self, place: u64, read: impl FnOnce(&CycleRecord) -> T) -> RingLook<T> {
        let written = self.written();
        if place >= written {
            return RingLook::NotYet;
        }
        if written - place > KEPT as u64 {
            return RingLook::Overwritten;
        }
        let record = match self.records.get(slot(place)).map(Mutex::try_lock) {
            Some(Ok(record)) => record,
            Some(Err(TryLockError::Poisoned(poisoned))) => poisoned.into_inner(),
            Some(Err(TryLockError::WouldBlock)) | None => return RingLook::NotYet,
        };
        match record.place.cmp(&(place + 1)) {
            std::cmp::Ordering::Equal => RingLook::Record(read(&record)),
            std::cmp::Ordering::Less => RingLook::LeftOut,
            std::cmp::Ordering::Greater => RingLook::Overwritten,
        }
    }

    /// The kept cycles of an axis, the oldest first.
    pub fn read(&self, axis: &RecordedAxis) -> Vec<RecordedCycle> {
        let written = self.written();
        let kept = written.saturating_sub(KEPT as u64)..written;
        let cycles = kept.filter_map(|place| {
            for _ in 0..READERS_PASSED {
                match self.look(place, |record| self.cycle_of(record, axis)) {
                    RingLook::Record(cycle) => return cycle,
                    RingLook::NotYet => hint::spin_loop(),
                    RingLook::LeftOut | RingLook::Overwritten => break,
                }
            }
            None
        });
        cycles.collect()
    }

    /// Of the device at this place of the exchange, in this cycle: what answered, its outputs, and its inputs if it answered.
    pub fn device<'a>(&self, record: &'a CycleRecord, device: usize) -> Option<RecordedDevice<'a>> {
        let ranges = self.devices.get(device)?;
        let bytes = &record.bytes;
        let answered = match bytes.get(ranges.judged)? {
            byte if *byte == Answer::Fresh as u8 => Answered::Delivered,
            byte if *byte == Answer::Answered as u8 => Answered::InputsOnly,
            _ => Answered::Nothing,
        };
        let inputs = ranges.inputs.clone().and_then(|range| bytes.get(range));
        Some(RecordedDevice {
            answered,
            outputs: ranges.outputs.clone().and_then(|range| bytes.get(range)),
            inputs: inputs.filter(|_| answered != Answered::Nothing),
        })
    }

    fn cycle_of(&self, record: &CycleRecord, axis: &RecordedAxis) -> Option<RecordedCycle> {
        let device = self.device(record, axis.drive)?;
        let (controlword, target) = axis.fields.sent(device.outputs?)?;
        Some(RecordedCycle {
            number: record.number,
            time: record.time,
            answered: device.answered,
            controlword,
            target,
            inputs: device
                .inputs
                .and_then(|inputs| axis.fields.sample(inputs, Mode::None)),
        })
    }
}

/// A device in one cycle.
#[derive(Debug, Clone, Copy)]
pub(in crate::bus) struct RecordedDevice<'a> {
    pub answered: Answered,
    pub outputs: Option<&'a [u8]>,
    pub inputs: Option<&'a [u8]>,
}

const fn slot(place: u64) -> usize {
    (place % KEPT as u64) as usize
}

/// Bytes of these frames.
fn lengths(frames: &[Frame]) -> usize {
    frames.iter().map(|frame| frame.request.len()).sum()
}

/// Copies one slice behind the other, and gives what is behind them.
fn copy_in_turn<'to, 'from>(
    mut to: &'to mut [u8],
    from: impl Iterator<Item = &'from [u8]>,
) -> &'to mut [u8] {
    for bytes in from {
        let Some((here, rest)) = to.split_at_mut_checked(bytes.len()) else {
            return &mut [];
        };
        here.copy_from_slice(bytes);
        to = rest;
    }
    to
}

/// Where a device's bytes lie in the record of a cycle.
#[derive(Debug)]
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
