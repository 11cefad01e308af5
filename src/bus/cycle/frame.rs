//! EtherCAT frames as this library builds and reads them (ETG.1000.4: frame, datagram, working counter).

/// Bytes of the Ethernet header.
pub(in crate::bus) const ETHERNET_HEADER: usize = 14;
/// Bytes before the first datagram: Ethernet and EtherCAT header.
pub(in crate::bus) const HEADERS: usize = ETHERNET_HEADER + 2;
/// Bytes of a datagram before its data.
pub(in crate::bus) const DATAGRAM_HEADER: usize = 10;
/// Bytes of a datagram around its data.
pub(in crate::bus) const DATAGRAM_OVERHEAD: usize = DATAGRAM_HEADER + 2;
/// What an EtherCAT frame holds beside the EtherCAT header.
pub(in crate::bus) const PAYLOAD: usize = 1498;

/// Datagram commands.
pub(in crate::bus) mod command {
    pub(in crate::bus) const NOP: u8 = 0;
    pub(in crate::bus) const FPRD: u8 = 4;
    pub(in crate::bus) const BRD: u8 = 7;
    pub(in crate::bus) const BWR: u8 = 8;
    pub(in crate::bus) const LRD: u8 = 10;
    pub(in crate::bus) const LWR: u8 = 11;
    pub(in crate::bus) const LRW: u8 = 12;
    pub(in crate::bus) const FRMW: u8 = 14;
}

/// What a frame of ours is for, in its source address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) enum Tag {
    /// A frame of ethercrab's, with the number of its sending.
    Acyclic(u32),
    /// Process data, with the cycle's number and the frame's place in the cycle.
    Cyclic {
        /// The low 24 bits of the cycle's number.
        cycle: u32,
        /// The frame's place.
        frame: u8,
    },
}

/// First bytes of our source addresses: unicast, and with bit 1 clear, which the first SubDevice sets.
const ACYCLIC: [u8; 2] = [0x10, 0xA5];
const CYCLIC: [u8; 2] = [0x10, 0xC5];
const LOCALLY_ADMINISTERED: u8 = 0x02;
const CYCLE_MASK: u32 = 0x00FF_FFFF;

impl Tag {
    /// The tag of this frame of this cycle.
    pub(in crate::bus) const fn cyclic(cycle: u64, frame: u8) -> Self {
        Self::Cyclic {
            cycle: cycle as u32 & CYCLE_MASK,
            frame,
        }
    }

    pub(in crate::bus) const fn source_address(self) -> [u8; 6] {
        let ([a, b], [c, d, e, f]) = match self {
            Self::Acyclic(number) => (ACYCLIC, number.to_be_bytes()),
            Self::Cyclic { cycle, frame } => (CYCLIC, (cycle << 8 | frame as u32).to_be_bytes()),
        };
        [a, b, c, d, e, f]
    }

    /// The tag of a frame that came back; `None` if it is not ours or never passed a SubDevice.
    pub(in crate::bus) fn of_answer(frame: &[u8]) -> Option<Self> {
        let &[_, _, _, _, _, _, a, b, c, d, e, f, t0, t1, ..] = frame else {
            return None;
        };
        if [t0, t1] != crate::link::ETHERTYPE.to_be_bytes() || a & LOCALLY_ADMINISTERED == 0 {
            return None;
        }
        let number = u32::from_be_bytes([c, d, e, f]);
        match [a & !LOCALLY_ADMINISTERED, b] {
            ACYCLIC => Some(Self::Acyclic(number)),
            CYCLIC => Some(Self::Cyclic {
                cycle: number >> 8,
                frame: f,
            }),
            _ => None,
        }
    }
}

/// One datagram of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Datagram<'a> {
    pub(in crate::bus) command: u8,
    pub(in crate::bus) index: u8,
    pub(in crate::bus) address: [u8; 4],
    pub(in crate::bus) data: &'a [u8],
    pub(in crate::bus) working_counter: u16,
    /// Where its data start in the frame.
    pub(in crate::bus) offset: usize,
}

/// The datagrams of an Ethernet frame; `None` in the place of one that is cut.
pub(in crate::bus) fn datagrams(frame: &[u8]) -> impl Iterator<Item = Option<Datagram<'_>>> {
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

/// Whether `answer` holds the datagrams of `request`: commands, indices, addresses and lengths.
pub(in crate::bus) fn is_answer_to(answer: &[u8], request: &[u8]) -> bool {
    let (Some(answer), Some(request)) = (ether_cat(answer), ether_cat(request)) else {
        return false;
    };
    let mut at = HEADERS;
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
/// empties one: a second reading would bring the next mail, and nobody would miss the first. A writing fills one: the
/// device may have taken the mail already, and take a second one for a further request.
pub(in crate::bus) fn reaches_memory(frame: &[u8]) -> bool {
    datagrams(frame).flatten().any(|datagram| {
        let [_, _, low, high] = datagram.address;
        // APRD to BRW: all commands with a physical address but ARMW and FRMW, which are for the clock.
        matches!(datagram.command, 1..=9) && u16::from_le_bytes([low, high]) >= MEMORY
    })
}

/// Where the datagram whose data lie at `data` has the station address of its SubDevice.
pub(in crate::bus) fn station_mut(frame: &mut [u8], data: usize) -> Option<&mut [u8; 2]> {
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
    pub(in crate::bus) fn new() -> Self {
        let mut bytes = vec![0xFF; 6];
        bytes.extend([0; 6]);
        bytes.extend(crate::link::ETHERTYPE.to_be_bytes());
        bytes.extend([0, 0]);
        Self { bytes, last: None }
    }

    /// Adds a datagram with zeros as data and gives where they lie in the frame.
    pub(in crate::bus) fn push(
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
    pub(in crate::bus) fn finish(mut self) -> Vec<u8> {
        let length = u16::try_from(self.bytes.len() - HEADERS).unwrap_or(0x07FF) & 0x07FF;
        let header = (0x1000 | length).to_le_bytes();
        for (to, from) in self.bytes.iter_mut().skip(ETHERNET_HEADER).zip(header) {
            *to = from;
        }
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*};

    use super::{Composer, Tag, command, datagrams, is_answer_to, reaches_memory};

    fn two_datagrams() -> Vec<u8> {
        let mut composer = Composer::new();
        composer.push(command::LRW, [0, 0, 1, 0], 3);
        composer.push(command::BRD, [0, 0, 0x30, 0x01], 2);
        composer.finish()
    }

    #[test]
    fn a_composed_frame_has_the_bytes_of_the_standard() {
        // ETG.1000.4: 11 bits of length and type 1; command, index, address, 11 bits of length with bit 15 for more, interrupt,
        // data, working counter.
        assert_eq!(
            two_datagrams()[12..],
            [
                0x88, 0xA4, 29, 0x10, //
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
            let fields = datagrams(frame).map(|datagram| {
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
        counted[33] = 5;
        assert!(is_answer_to(&counted, &request));
        let mut elsewhere = request.clone();
        elsewhere[18] = 1;
        assert!(!is_answer_to(&elsewhere, &request));
        let mut register = request.clone();
        register[35] = 0x31;
        assert!(!is_answer_to(&register, &request));
        let mut length = request.clone();
        length[22] = 2;
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
            frame[6..12].copy_from_slice(&tag.source_address());
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
        assert_eq!(offsets, [26, 41]);
    }
}
