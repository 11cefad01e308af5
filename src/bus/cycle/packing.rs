//! Which drive's process data go into which datagram of which frame: composed once, before the first cycle.

use std::ops::Range;

use crate::{
    bus::cycle::{
        frame::{self, Composer, DATAGRAM_OVERHEAD, command},
        reference_clock::{self, Distribution, Slot},
    },
    coe::MailSignal,
    profile_position::WorkingCounter,
};

const AL_STATUS: u16 = 0x0130;
/// Bytes of data of the AL status broadcast.
const AL_STATUS_BYTES: usize = 2;
/// What the process data may use of a frame: the rest is the AL status broadcast's, the mailbox states' and the reference
/// time's.
const LONGEST_AREA: usize =
    frame::PAYLOAD - 2 * DATAGRAM_OVERHEAD - AL_STATUS_BYTES - RESERVED - reference_clock::RESERVED;

/// How a drive takes part.
#[derive(Debug, Clone, Copy)]
pub(in crate::bus) struct Member {
    /// Logical address of its outputs; its inputs follow.
    pub(in crate::bus) logical: u32,
    pub(in crate::bus) outputs: usize,
    pub(in crate::bus) inputs: usize,
    pub(in crate::bus) lrw: bool,
    pub(in crate::bus) marker: InputMarker,
    /// Consecutive silent cycles after which it counts as lost.
    pub(in crate::bus) patience: u32,
}

/// How a device's inputs show that it answered. Of one without inputs the working counter of its own datagram tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) enum InputMarker {
    /// They begin with a statusword, which is never all ones.
    Statusword,
    /// Any bits may stand there: the pattern is the complement of the last cycle's, so that inputs that stay as they are
    /// differ from it in every other cycle at least.
    AnyBits,
}

/// A frame of the exchange: what is sent, what came back in this cycle, and what came back last before.
pub(in crate::bus) struct Frame {
    pub(in crate::bus) request: Vec<u8>,
    pub(in crate::bus) answer: Vec<u8>,
    pub(in crate::bus) before: Vec<u8>,
    pub(in crate::bus) back: bool,
}

/// A datagram and the drives that share it.
pub(in crate::bus) struct Part {
    pub(in crate::bus) frame: usize,
    pub(in crate::bus) data: Range<usize>,
    pub(in crate::bus) shares: Vec<Share>,
    /// Whether it was steady in the last cycle.
    pub(in crate::bus) steady: bool,
    /// Its place among all of them.
    pub(in crate::bus) number: u16,
    /// Its working counter, if it was wrong in the last cycle, and in how many before that one after the other.
    pub(in crate::bus) miscounted: Option<(WorkingCounter, u32)>,
}

/// A drive's place in a datagram, with what it adds to the working counter.
pub(in crate::bus) struct Share {
    pub(in crate::bus) drive: usize,
    pub(in crate::bus) outputs: Option<Range<usize>>,
    pub(in crate::bus) inputs: Option<Range<usize>>,
    pub(in crate::bus) counts: u16,
}

/// A datagram that reads the state of a mailbox.
pub(in crate::bus) struct StatusSlot {
    pub(in crate::bus) frame: usize,
    /// Where its data lie in the frame.
    pub(in crate::bus) data: usize,
}

/// The frames of the exchange, ready to be filled.
pub(in crate::bus) struct Packed {
    pub(in crate::bus) frames: Vec<Frame>,
    pub(in crate::bus) parts: Vec<Part>,
    /// The frame with the AL status broadcast, and where its data lie.
    pub(in crate::bus) al_status: Option<(usize, Range<usize>)>,
    pub(in crate::bus) mailbox_states: Vec<StatusSlot>,
    /// What distributes the reference time, in the first frame.
    pub(in crate::bus) clock: Option<Slot>,
}

/// Packs the process data of these drives, the states of so many mailboxes, and the reference time where one is distributed.
pub(in crate::bus) fn pack(
    members: &[Member],
    mailboxes: usize,
    distribution: Option<Distribution>,
) -> Packed {
    let mut packer = Packer::default();
    for (drive, member) in members.iter().enumerate() {
        packer.add(drive, member);
    }
    packer.finish(mailboxes, distribution)
}

/// Where each drive lies in the logical address space: one behind the other, outputs before inputs.
pub(in crate::bus) fn logical_addresses(sizes: &[(usize, usize)]) -> Vec<u32> {
    let mut next = 0;
    sizes
        .iter()
        .map(|(outputs, inputs)| {
            let here = next;
            next += u32::try_from(outputs + inputs).unwrap_or(u32::MAX / 64);
            here
        })
        .collect()
}

/// Whether a drive's process data fit into one frame.
pub(in crate::bus) const fn fits_one_frame(outputs: usize, inputs: usize) -> bool {
    outputs + inputs <= LONGEST_AREA
}

/// Puts datagrams into frames, drive by drive.
#[derive(Default)]
struct Packer {
    frames: Vec<Composer>,
    /// Datagrams of the last frame that are still open for more drives: logical address and drives.
    parts: Vec<(usize, PartPlan)>,
}

/// A datagram before it is put into its frame.
struct PartPlan {
    command: u8,
    logical: u32,
    length: usize,
    shares: Vec<Share>,
    /// Its working counter is to tell of one device.
    alone: bool,
}

impl Packer {
    fn add(&mut self, drive: usize, member: &Member) {
        let Member {
            logical,
            outputs,
            inputs,
            lrw,
            ..
        } = *member;
        let logical_inputs = logical.saturating_add(u32::try_from(outputs).unwrap_or(u32::MAX));
        // Nothing but a working counter tells whether such a device is there.
        let alone = inputs == 0;
        let share = |out: bool, inp: bool, counts| Share {
            drive,
            outputs: (out && outputs != 0).then_some(0..outputs),
            inputs: (inp && inputs != 0).then_some(if out {
                outputs..outputs + inputs
            } else {
                0..inputs
            }),
            counts,
        };
        if lrw {
            let counts = u16::from(inputs != 0) + 2 * u16::from(outputs != 0);
            self.put(
                command::LRW,
                logical,
                outputs + inputs,
                share(true, true, counts),
                alone,
            );
            return;
        }
        if inputs != 0 {
            self.put(
                command::LRD,
                logical_inputs,
                inputs,
                share(false, true, 1),
                false,
            );
        }
        if outputs != 0 {
            self.put(command::LWR, logical, outputs, share(true, false, 1), alone);
        }
    }

    /// Joins the last datagram if the addresses follow each other and the frame has room, else begins one.
    fn put(&mut self, command: u8, logical: u32, length: usize, mut share: Share, alone: bool) {
        let frame = self.parts.last().map_or(0, |(frame, _)| *frame);
        let used: usize = self
            .parts
            .iter()
            .filter(|(at, _)| *at == frame)
            .map(|(_, part)| part.length + DATAGRAM_OVERHEAD)
            .sum();
        let joins = |part: &PartPlan| {
            part.command == command
                && !(alone || part.alone)
                && u32::try_from(part.length).is_ok_and(|n| part.logical + n == logical)
        };
        // The AL status broadcast finds room in every frame.
        let room = LONGEST_AREA + DATAGRAM_OVERHEAD;
        match self.parts.last_mut() {
            Some((_, part)) if joins(part) && used + length <= room => {
                let moved =
                    |range: Range<usize>| range.start + part.length..range.end + part.length;
                share.outputs = share.outputs.map(moved);
                share.inputs = share.inputs.map(moved);
                part.length += length;
                part.shares.push(share);
            }
            _ => {
                let full = used + length + DATAGRAM_OVERHEAD > room;
                let part = PartPlan {
                    command,
                    logical,
                    length,
                    shares: vec![share],
                    alone,
                };
                self.parts.push((frame + usize::from(full), part));
            }
        }
    }

    fn finish(mut self, mailboxes: usize, distribution: Option<Distribution>) -> Packed {
        // Before anything else, so that it passes the reference clock as soon as it is sent.
        let clock = distribution.map(|distribution| {
            let mut first = Composer::new();
            let slot = Slot::push(&mut first, distribution);
            self.frames.push(first);
            slot
        });
        let mut parts = Vec::new();
        for (frame, plan) in self.parts {
            while self.frames.len() <= frame {
                self.frames.push(Composer::new());
            }
            let Some(composer) = self.frames.get_mut(frame) else {
                continue;
            };
            let data = composer.push(plan.command, plan.logical.to_le_bytes(), plan.length);
            let moved = |range: Range<usize>| range.start + data.start..range.end + data.start;
            let shares = plan.shares.into_iter().map(|share| Share {
                outputs: share.outputs.map(moved),
                inputs: share.inputs.map(moved),
                ..share
            });
            parts.push(Part {
                number: u16::try_from(parts.len()).unwrap_or(u16::MAX),
                miscounted: None,
                frame,
                shares: shares.collect(),
                data,
                steady: false,
            });
        }
        let [r0, r1] = AL_STATUS.to_le_bytes();
        let last = self.frames.len().checked_sub(1);
        let al_status = last.and_then(|last| {
            let data = self
                .frames
                .last_mut()?
                .push(command::BRD, [0, 0, r0, r1], AL_STATUS_BYTES);
            Some((last, data))
        });
        let mailbox_states = push_mailbox_states(&mut self.frames, mailboxes);
        let frames = self.frames.into_iter().map(|composer| {
            let request = composer.finish();
            Frame {
                answer: Vec::with_capacity(crate::link::LONGEST_FRAME),
                before: Vec::with_capacity(crate::link::LONGEST_FRAME),
                request,
                back: false,
            }
        });
        Packed {
            frames: frames.collect(),
            parts,
            al_status,
            mailbox_states,
            clock,
        }
    }
}

/// Spreads the datagrams that read mailbox states over the frames.
fn push_mailbox_states(frames: &mut [Composer], mailboxes: usize) -> Vec<StatusSlot> {
    let [r0, r1] = STATUS.to_le_bytes();
    let count = frames.len();
    (0..status_slots(mailboxes, count))
        .filter_map(|slot| {
            let frame = slot % count;
            let composer = frames.get_mut(frame)?;
            let data = composer.push(command::FPRD, [0, 0, r0, r1], STATUS_BYTES);
            Some(StatusSlot {
                frame,
                data: data.start,
            })
        })
        .collect()
}

// Which mailboxes hold a mail, seen within the cycle's frames: a few datagrams that read the state of one mailbox each, and
// go round over the drives.

/// Status of sync manager 1, the mailbox that the MainDevice reads (ETG.1000.4).
pub(in crate::bus) const STATUS: u16 = 0x080D;
/// Bit 3 of the status: the mailbox is full.
const MAIL_WAITS: u8 = 0x08;
/// Bytes of such a datagram's data.
pub(in crate::bus) const STATUS_BYTES: usize = 1;
/// Each mailbox is looked at once in this many cycles, as long as there are no more than this many times [`MOST_PER_FRAME`]
/// for each frame.
const LOOK_EVERY: usize = 8;
/// Datagrams of a frame that read such a state.
const MOST_PER_FRAME: usize = 4;
/// What they may take of each frame.
pub(in crate::bus) const RESERVED: usize = MOST_PER_FRAME * (DATAGRAM_OVERHEAD + STATUS_BYTES);

/// A mailbox that is looked at.
#[derive(Debug, Clone)]
pub(in crate::bus) struct Watched {
    /// The drive's station address.
    pub(in crate::bus) station: u16,
    /// Tells its client.
    pub(in crate::bus) signal: MailSignal,
}

/// How many datagrams read mailbox states, in this many frames.
pub(in crate::bus) fn status_slots(mailboxes: usize, frames: usize) -> usize {
    mailboxes
        .div_ceil(LOOK_EVERY)
        .min(frames.saturating_mul(MOST_PER_FRAME))
}

/// The mailboxes, and whose turn it is.
#[derive(Debug)]
pub(in crate::bus) struct MailboxStates {
    mailboxes: Vec<Watched>,
    /// Whose turn it is in the first datagram; the following ones are of those behind it.
    turn: usize,
}

impl MailboxStates {
    pub(in crate::bus) const fn new(mailboxes: Vec<Watched>) -> Self {
        Self { mailboxes, turn: 0 }
    }

    /// Addresses the datagrams to those whose turn it is.
    pub(in crate::bus) fn address(&mut self, slots: &[StatusSlot], frames: &mut [Frame]) {
        let Some(count) = core::num::NonZeroUsize::new(self.mailboxes.len()) else {
            return;
        };
        self.turn = (self.turn + slots.len()) % count;
        for (slot, watched) in slots.iter().zip(self.in_turn()) {
            let address = frames
                .get_mut(slot.frame)
                .and_then(|frame| frame::station_mut(&mut frame.request, slot.data));
            if let Some(address) = address {
                *address = watched.station.to_le_bytes();
            }
        }
    }

    /// Tells the clients what was seen in the frames that came back.
    pub(in crate::bus) fn judge(&self, slots: &[StatusSlot], frames: &[Frame]) {
        for (slot, watched) in slots.iter().zip(self.in_turn()) {
            let answer = frames
                .get(slot.frame)
                .filter(|frame| frame.back)
                .and_then(|frame| frame.answer.get(slot.data..slot.data + STATUS_BYTES + 2));
            // One that does not answer has not been seen.
            if let Some(&[status, 1, 0]) = answer {
                watched.signal.observe(status & MAIL_WAITS != 0);
            }
        }
    }

    fn in_turn(&self) -> impl Iterator<Item = &Watched> {
        let (before, from) = self
            .mailboxes
            .split_at_checked(self.turn)
            .unwrap_or_default();
        from.iter().chain(before)
    }
}

impl Drop for MailboxStates {
    /// The clients look themselves again.
    fn drop(&mut self) {
        for watched in &self.mailboxes {
            watched.signal.end();
        }
    }
}
