//! EtherCAT frames as this library builds and reads them (ETG.1000.4: frame, datagram, working counter).

use std::ops::Range;

use super::reference_clock::{self, Distribution, Slot};
use crate::{axis::WorkingCounter, coe::MailboxSignal, esc};

/// Bytes of the Ethernet header.
pub(in crate::bus) const ETHERNET_HEADER: usize = 14;
/// Bytes before the first datagram: Ethernet and EtherCAT header.
pub(in crate::bus) const HEADERS: usize = ETHERNET_HEADER + 2;
/// Bytes of a datagram before its data.
pub(in crate::bus) const DATAGRAM_HEADER: usize = 10;
/// Bytes of a datagram around its data.
pub(in crate::bus) const DATAGRAM_OVERHEAD: usize = DATAGRAM_HEADER + 2;
/// What an EtherCAT frame holds beside the EtherCAT header.
const PAYLOAD: usize = 1498;

/// Datagram commands.
pub(in crate::bus) mod command {
    pub const NOP: u8 = 0;
    pub const FPRD: u8 = 4;
    pub const BRD: u8 = 7;
    pub const BWR: u8 = 8;
    pub const LRD: u8 = 10;
    pub const LWR: u8 = 11;
    pub const LRW: u8 = 12;
    pub const FRMW: u8 = 14;
}

/// The source address of all our frames, so that bridges learn one for a network: unicast, and with the bit clear which the first
/// SubDevice sets.
const SOURCE: [u8; 6] = [0x10, 0xA5, 0x00, 0x00, 0x00, 0x01];
const LOCALLY_ADMINISTERED: u8 = 0x02;

/// What a frame of ours is for. It is in the first datagram, a NOP, which every SubDevice passes on as it is: whose frame it is in the
/// index, and a number in the address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) enum Tag {
    /// A frame of ethercrab's, with the number of its sending.
    Acyclic(u32),
    /// Process data, with the cycle's number and the frame's place in the cycle.
    Cyclic {
        /// The low 32 bits of the cycle's number.
        cycle: u32,
        /// The frame's place, below [`ACYCLIC`].
        frame: u8,
    },
}

/// The index of the tag of an acyclic frame. In process data it is the frame's place in the cycle.
pub(in crate::bus) const ACYCLIC: u8 = 0xFF;
/// Data of the tag's datagram, all zeros. Masters do not send datagrams without data; so nobody knows what every controller makes of
/// one.
const TAG_DATA: usize = 4;
/// Bytes that the tag takes of a frame.
const TAG: usize = DATAGRAM_OVERHEAD + TAG_DATA;
/// Where the first datagram after the tag begins.
pub(in crate::bus) const BEHIND_TAG: usize = HEADERS + TAG;
/// Bytes of the tag up to the length of its data.
const TAG_FIELDS: usize = 8;

impl Tag {
    /// The tag of this frame of this cycle.
    pub const fn cyclic(cycle: u64, frame: u8) -> Self {
        Self::Cyclic {
            cycle: cycle as u32,
            frame,
        }
    }

    /// How many cycles before this one a frame of process data was sent.
    pub const fn age(self, now: u64) -> Option<u32> {
        match self {
            Self::Cyclic { cycle, .. } => Some((now as u32).wrapping_sub(cycle)),
            Self::Acyclic(_) => None,
        }
    }

    /// The datagram's command, index, address, and length with the mark that another one follows.
    const fn fields(self) -> [u8; TAG_FIELDS] {
        let (index, [a, b, c, d]) = match self {
            Self::Acyclic(number) => (ACYCLIC, number.to_le_bytes()),
            Self::Cyclic { cycle, frame } => (frame, cycle.to_le_bytes()),
        };
        [command::NOP, index, a, b, c, d, TAG_DATA as u8, 0x80]
    }

    /// Writes it into a frame that has room for it behind its headers.
    pub fn put(self, frame: &mut [u8]) {
        if let Some(to) = frame.get_mut(HEADERS..).and_then(<[u8]>::first_chunk_mut) {
            *to = self.fields();
        }
    }

    /// The tag of a frame that came back; `None` if it is not ours or never passed a SubDevice.
    pub fn of_answer(frame: &[u8]) -> Option<Self> {
        let (ethernet, ether_cat) = frame.split_first_chunk::<ETHERNET_HEADER>()?;
        let &[_, _, _, _, _, _, source, s1, s2, s3, s4, s5, t0, t1] = ethernet;
        let &[_, _, command::NOP, index, a, b, c, d, length, flags, ..] = ether_cat else {
            return None;
        };
        let is_ours = [source, s1, s2, s3, s4, s5] == ANSWERED
            && [t0, t1] == crate::link::ETHERTYPE.to_be_bytes()
            // A frame that circulates has bit 6.
            && (length, flags & !0x40) == (TAG_DATA as u8, 0x80);
        let number = u32::from_le_bytes([a, b, c, d]);
        is_ours.then_some(match index {
            ACYCLIC => Self::Acyclic(number),
            frame => Self::Cyclic {
                cycle: number,
                frame,
            },
        })
    }
}

/// The source address of an answer.
const ANSWERED: [u8; 6] = {
    let [first, rest @ ..] = SOURCE;
    let [b, c, d, e, f] = rest;
    [first | LOCALLY_ADMINISTERED, b, c, d, e, f]
};

/// Empties `frame` and begins one of ours in it: the headers and the tag.
pub(in crate::bus) fn begin(frame: &mut Vec<u8>, tag: Tag) {
    frame.clear();
    frame.extend([0xFF; 6]);
    frame.extend(SOURCE);
    frame.extend(crate::link::ETHERTYPE.to_be_bytes());
    frame.extend([0; 2]);
    frame.extend(tag.fields());
    frame.resize(BEHIND_TAG, 0);
}

/// One datagram of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Datagram<'a> {
    pub command: u8,
    pub index: u8,
    pub address: [u8; 4],
    pub data: &'a [u8],
    pub working_counter: u16,
    /// Where its data start in the frame.
    pub offset: usize,
}

/// The datagrams of an Ethernet frame; `None` in the place of one that is cut.
fn datagrams(frame: &[u8]) -> impl Iterator<Item = Option<Datagram<'_>>> {
    datagrams_from(frame, HEADERS)
}

/// The same, from the one on that begins at `start`.
pub(in crate::bus) fn datagrams_from(
    frame: &[u8],
    start: usize,
) -> impl Iterator<Item = Option<Datagram<'_>>> {
    let end = match *frame {
        [.., _] => frame
            .get(ETHERNET_HEADER..HEADERS)
            .and_then(|header| <[u8; 2]>::try_from(header).ok())
            .map_or(0, |header| {
                HEADERS + usize::from(u16::from_le_bytes(header) & 0x07FF)
            }),
        [] => 0,
    };
    let mut next = Some(start);
    core::iter::from_fn(move || {
        let start = next.take()?;
        let Some((datagram, more)) = frame.get(..end).and_then(|whole| parse(whole, start)) else {
            return Some(None);
        };
        if more {
            next = Some(datagram.offset + datagram.data.len() + 2);
        }
        Some(Some(datagram))
    })
}

fn parse(frame: &[u8], start: usize) -> Option<(Datagram<'_>, bool)> {
    let &[command, index, a0, a1, a2, a3, l0, l1, _, _, ref rest @ ..] = frame.get(start..)? else {
        return None;
    };
    let flags = u16::from_le_bytes([l0, l1]);
    let length = usize::from(flags & 0x07FF);
    let (data, rest) = rest.split_at_checked(length)?;
    let &[w0, w1, ..] = rest else { return None };
    let datagram = Datagram {
        command,
        index,
        address: [a0, a1, a2, a3],
        data,
        working_counter: u16::from_le_bytes([w0, w1]),
        offset: start + DATAGRAM_HEADER,
    };
    Some((datagram, flags & 0x8000 != 0))
}

/// Whether `answer` holds the datagrams of `request`: commands, indices, addresses and lengths. The tag before them is whole in what
/// [`Tag::of_answer`] gives.
pub(in crate::bus) fn is_answer_to(answer: &[u8], request: &[u8]) -> bool {
    let (Some(answer), Some(request)) = (ether_cat(answer), ether_cat(request)) else {
        return false;
    };
    let mut at = BEHIND_TAG;
    loop {
        let (Some(asked), Some(got)) = (header(request, at), header(answer, at)) else {
            return false;
        };
        if (asked ^ got) & repeated(asked as u8) != 0 {
            return false;
        }
        let length = (asked >> 48) as usize & 0x07FF;
        let end = at + DATAGRAM_OVERHEAD + length;
        if end > request.len().min(answer.len()) {
            return false;
        }
        if asked >> 63 == 0 {
            return true;
        }
        at = end;
    }
}

/// The frame as far as its EtherCAT header says; none if it is shorter.
fn ether_cat(frame: &[u8]) -> Option<&[u8]> {
    let header = frame.get(ETHERNET_HEADER..)?.first_chunk()?;
    frame.get(..HEADERS + usize::from(u16::from_le_bytes(*header) & 0x07FF))
}

/// The first eight bytes of a datagram as a number: command, index, address, length and whether another follows.
fn header(frame: &[u8], at: usize) -> Option<u64> {
    let bytes = frame.get(at..)?.first_chunk()?;
    Some(u64::from_le_bytes(*bytes))
}

/// What of these an answer repeats. SubDevices count up the device part of position and broadcast addresses, and mark frames
/// that circulate.
const fn repeated(command: u8) -> u64 {
    match command {
        1..=3 | 7..=9 | 13 => 0x87FF_FFFF_0000_FFFF,
        _ => 0x87FF_FFFF_FFFF_FFFF,
    }
}

/// Where a SubDevice's registers end and its memory with the mailboxes begins (ETG.1000.4, address space).
const MEMORY: u16 = 0x1000;

/// Whether the frame reads or writes memory of a SubDevice by its address, which is how a mailbox is reached. A reading
/// empties one: a second reading would bring the next message, and nobody would miss the first. A writing fills one: the
/// device may have taken the message already, and take a second one for a further request.
pub(in crate::bus) fn reaches_memory(frame: &[u8]) -> bool {
    datagrams(frame).flatten().any(|datagram| {
        let [_, _, low, high] = datagram.address;
        // APRD to BRW: all commands with a physical address but ARMW and FRMW, which are for the clock.
        matches!(datagram.command, 1..=9) && u16::from_le_bytes([low, high]) >= MEMORY
    })
}

/// Where the datagram whose data lie at `data` has the station address of its SubDevice.
fn station_mut(frame: &mut [u8], data: usize) -> Option<&mut [u8; 2]> {
    let start = data.checked_sub(DATAGRAM_HEADER)?;
    frame.get_mut(start + 2..)?.first_chunk_mut()
}

/// A frame that is composed once and sent many times.
#[derive(Debug, Clone)]
pub(in crate::bus) struct Composer {
    bytes: Vec<u8>,
    last: Option<usize>,
}

impl Composer {
    pub fn new() -> Self {
        let mut bytes = Vec::new();
        begin(&mut bytes, Tag::cyclic(0, 0));
        Self { bytes, last: None }
    }

    /// Adds a datagram with zeros as data and gives where they lie in the frame.
    pub fn push(
        &mut self,
        command: u8,
        address: [u8; 4],
        length: usize,
    ) -> core::ops::Range<usize> {
        if let Some(flags) = self.last.and_then(|at| self.bytes.get_mut(at + 7)) {
            *flags |= 0x80;
        }
        let start = self.bytes.len();
        self.last = Some(start);
        let count = u16::try_from(length).unwrap_or(u16::MAX) & 0x07FF;
        self.bytes.push(command);
        self.bytes.push(0);
        self.bytes.extend(address);
        self.bytes.extend(count.to_le_bytes());
        self.bytes.extend([0, 0]);
        self.bytes.resize(self.bytes.len() + length + 2, 0);
        let start = start + DATAGRAM_HEADER;
        start..start + length
    }

    /// The frame, with its length filled in.
    pub fn finish(mut self) -> Vec<u8> {
        let length = u16::try_from(self.bytes.len() - HEADERS).unwrap_or(0x07FF) & 0x07FF;
        let header = (0x1000 | length).to_le_bytes();
        for (to, from) in self.bytes.iter_mut().skip(ETHERNET_HEADER).zip(header) {
            *to = from;
        }
        self.bytes
    }
}

// Which drive's process data go into which datagram of which frame: composed once, before the first cycle.

/// Bytes of data of the AL status broadcast.
const AL_STATUS_BYTES: usize = 2;
/// What the process data may use of a frame: the rest is the tag's, the AL status broadcast's, the mailbox states' and the
/// reference time's.
const LONGEST_AREA: usize =
    PAYLOAD - TAG - 2 * DATAGRAM_OVERHEAD - AL_STATUS_BYTES - RESERVED - reference_clock::RESERVED;

/// How a drive takes part.
#[derive(Debug, Clone, Copy)]
pub(in crate::bus) struct Member {
    /// Logical address of its outputs; its inputs follow.
    pub logical: u32,
    pub outputs: usize,
    pub inputs: usize,
    pub lrw: bool,
    pub marker: InputMarker,
    /// Consecutive silent cycles after which it counts as lost.
    pub patience: u32,
    /// It may come and go: the working counters of all others are the same with and without it.
    pub leaves: bool,
}

/// How a device's inputs show that it answered. Of one without inputs the working counter of its own datagram shows it.
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
    pub request: Vec<u8>,
    pub answer: Vec<u8>,
    pub before: Vec<u8>,
    pub back: bool,
}

/// A datagram and the drives that share it.
pub(in crate::bus) struct Part {
    pub frame: usize,
    pub data: Range<usize>,
    pub shares: Vec<Share>,
    /// Whether it was steady in the last cycle.
    pub steady: bool,
    /// Its place among all of them.
    pub number: u16,
    /// Its working counter, if it was wrong in the last cycle, and in how many before that one after the other.
    pub miscounted: Option<(WorkingCounter, u32)>,
}

/// A drive's place in a datagram, with what it adds to the working counter.
pub(in crate::bus) struct Share {
    pub drive: usize,
    pub outputs: Option<Range<usize>>,
    pub inputs: Option<Range<usize>>,
    pub counts: u16,
}

/// A datagram that reads the state of a mailbox.
pub(in crate::bus) struct StatusSlot {
    pub frame: usize,
    /// Where its data lie in the frame.
    pub data: usize,
}

/// The frames of the exchange, ready to be filled.
pub(in crate::bus) struct Packed {
    pub frames: Vec<Frame>,
    pub parts: Vec<Part>,
    /// The frame with the AL status broadcast, and where its data lie.
    pub al_status: Option<(usize, Range<usize>)>,
    pub mailbox_states: Vec<StatusSlot>,
    /// What distributes the reference time, in the first frame.
    pub clock: Option<Slot>,
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

/// Where each drive lies in the logical address space, from this on: one behind the other, outputs before inputs.
pub(in crate::bus) fn logical_addresses(base: u32, sizes: &[(usize, usize)]) -> Vec<u32> {
    let mut next = base;
    sizes
        .iter()
        .map(|(outputs, inputs)| {
            let here = next;
            next = next.saturating_add(u32::try_from(outputs + inputs).unwrap_or(u32::MAX / 64));
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
    /// Its working counter must be that of one device.
    alone: bool,
}

impl Packer {
    fn add(&mut self, drive: usize, member: &Member) {
        let Member {
            logical,
            outputs,
            inputs,
            lrw,
            leaves,
            ..
        } = *member;
        let logical_inputs = logical.saturating_add(u32::try_from(outputs).unwrap_or(u32::MAX));
        // Only a working counter shows whether such a device is there.
        let alone = inputs == 0 || leaves;
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
                leaves,
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
        // Before all process data, so that it passes the reference clock as soon as it is sent.
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
        let [r0, r1] = esc::AL_STATUS.to_le_bytes();
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
    let [r0, r1] = esc::MAILBOX_IN_STATUS.to_le_bytes();
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

// Which mailboxes hold a message, seen within the cycle's frames: a few datagrams that read the state of one mailbox each, and
// go round over the drives.

/// Bit 3 of the status: the mailbox is full.
const MAIL_WAITS: u8 = 0x08;
/// Bytes of such a datagram's data.
const STATUS_BYTES: usize = 1;
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
    pub station: u16,
    /// Tells its client.
    pub signal: MailboxSignal,
}

/// How many datagrams read mailbox states, in this many frames.
fn status_slots(mailboxes: usize, frames: usize) -> usize {
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
    pub const fn new(mailboxes: Vec<Watched>) -> Self {
        Self { mailboxes, turn: 0 }
    }

    /// Addresses the datagrams to those whose turn it is.
    pub fn address(&mut self, slots: &[StatusSlot], frames: &mut [Frame]) {
        let Some(count) = core::num::NonZeroUsize::new(self.mailboxes.len()) else {
            return;
        };
        self.turn = (self.turn + slots.len()) % count;
        for (slot, watched) in slots.iter().zip(self.in_turn()) {
            let address = frames
                .get_mut(slot.frame)
                .and_then(|frame| station_mut(&mut frame.request, slot.data));
            if let Some(address) = address {
                *address = watched.station.to_le_bytes();
            }
        }
    }

    /// Tells the clients what was seen in the frames that came back.
    pub fn judge(&self, slots: &[StatusSlot], frames: &[Frame]) {
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

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::{
        BEHIND_TAG, Composer, Tag, command, datagrams, datagrams_from, is_answer_to, reaches_memory,
    };

    fn two_datagrams() -> Vec<u8> {
        let mut composer = Composer::new();
        composer.push(command::LRW, [0, 0, 1, 0], 3);
        composer.push(command::BRD, [0, 0, 0x30, 0x01], 2);
        composer.finish()
    }

    #[test]
    fn a_composed_frame_has_the_bytes_of_the_standard() {
        // ETG.1000.4: 11 bits of length and type 1; command, index, address, 11 bits of length with bit 15 for more, interrupt,
        // data, working counter. First the tag.
        let mut frame = two_datagrams();
        Tag::cyclic(0x0706_0504, 3).put(&mut frame);
        assert_eq!(
            frame,
            [
                0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x10, 0xA5, 0, 0, 0, 1, //
                0x88, 0xA4, 45, 0x10, //
                0, 3, 4, 5, 6, 7, 4, 0x80, 0, 0, 0, 0, 0, 0, 0, 0, //
                12, 0, 0, 0, 1, 0, 3, 0x80, 0, 0, 0, 0, 0, 0, 0, //
                7, 0, 0, 0, 0x30, 0x01, 2, 0, 0, 0, 0, 0, 0, 0,
            ]
        );
    }

    #[test]
    fn every_truncation_of_a_frame_is_no_answer_and_no_panic() {
        let request = two_datagrams();
        assert!(is_answer_to(&request, &request));
        for length in 0..request.len() {
            assert!(!is_answer_to(&request[..length], &request), "{length}");
        }
    }

    /// By their datagrams, one by one.
    fn holds_the_datagrams_of(answer: &[u8], request: &[u8]) -> bool {
        let fields = |frame| -> Option<Vec<_>> {
            let fields = datagrams_from(frame, BEHIND_TAG).map(|datagram| {
                let datagram = datagram?;
                let [a, b, c, d] = datagram.address;
                let counted = matches!(datagram.command, 1..=3 | 7..=9 | 13);
                let device = (!counted).then_some([a, b]);
                let rest = (datagram.index, device, [c, d], datagram.data.len());
                Some((datagram.command, rest))
            });
            fields.collect()
        };
        fields(request).is_some() && fields(answer) == fields(request)
    }

    proptest! {
        #[test]
        fn an_answer_is_one_by_the_fields_of_its_datagrams(
            asked in vec((0..16u8, any::<[u8; 4]>(), 0..6usize), 1..5),
            changes in vec((any::<prop::sample::Index>(), 0..8u32), 0..4),
            length in any::<prop::sample::Index>(),
            cut in any::<bool>(),
        ) {
            let mut composer = Composer::new();
            for (command, address, length) in asked {
                composer.push(command, address, length);
            }
            let request = composer.finish();
            let mut answer = request.clone();
            answer.extend([0; 8]);
            for (at, bit) in changes {
                // From the EtherCAT header on.
                let at = 14 + at.index(answer.len() - 14);
                answer[at] ^= 1 << bit;
            }
            if cut {
                answer.truncate(length.index(answer.len()));
            }
            prop_assert_eq!(
                is_answer_to(&answer, &request),
                holds_the_datagrams_of(&answer, &request)
            );
            let request_itself = is_answer_to(&request, &request);
            prop_assert!(request_itself);
        }
    }

    #[test]
    fn an_answer_with_another_address_or_length_is_refused_but_a_counted_broadcast_is_not() {
        let request = two_datagrams();
        let mut counted = request.clone();
        counted[BEHIND_TAG + 17] = 5;
        assert!(is_answer_to(&counted, &request));
        let mut elsewhere = request.clone();
        elsewhere[BEHIND_TAG + 2] = 1;
        assert!(!is_answer_to(&elsewhere, &request));
        let mut register = request.clone();
        register[BEHIND_TAG + 19] = 0x31;
        assert!(!is_answer_to(&register, &request));
        let mut length = request.clone();
        length[BEHIND_TAG + 6] = 2;
        assert!(!is_answer_to(&length, &request));
    }

    #[test]
    fn an_access_to_a_mailbox_is_told_from_one_to_registers_and_to_process_data() {
        let frame = |command, address: [u8; 4]| {
            let mut composer = Composer::new();
            composer.push(command, address, 16);
            composer.finish()
        };
        let (mailbox, register) = ([1, 0x10, 0x00, 0x1C], [1, 0x10, 0x0D, 0x08]);
        assert!(reaches_memory(&frame(4, mailbox)), "FPRD of 1C00h");
        assert!(reaches_memory(&frame(5, mailbox)), "FPWR of 1C00h");
        assert!(!reaches_memory(&frame(4, register)), "FPRD of 080Dh");
        assert!(!reaches_memory(&frame(5, register)), "FPWR of 080Dh");
        assert!(
            !reaches_memory(&frame(command::LRW, [0, 0, 1, 0x1C])),
            "LRW"
        );
    }

    #[test]
    fn a_tag_comes_back_only_from_a_segment() {
        for tag in [Tag::Acyclic(0xDEAD_BEEF), Tag::cyclic(0x0123_4567_89AB, 7)] {
            let mut frame = two_datagrams();
            tag.put(&mut frame);
            assert_eq!(Tag::of_answer(&frame), None, "our own frame, not an answer");
            frame[6] |= 2;
            assert_eq!(Tag::of_answer(&frame), Some(tag));
            frame[13] = 0;
            assert_eq!(Tag::of_answer(&frame), None, "another EtherType");
        }
    }

    #[test]
    fn the_datagrams_are_found_where_they_were_put() {
        let frame = two_datagrams();
        let offsets: Vec<_> = datagrams(&frame).map(|d| d.unwrap().offset).collect();
        assert_eq!(offsets, [26, BEHIND_TAG + 10, BEHIND_TAG + 25]);
    }
}
