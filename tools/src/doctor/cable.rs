//! What a cycle takes on the cable: the formula of docs/scaling.md, written apart from the library and compared with the frames that
//! the library sends.

/// Bytes around an Ethernet frame: preamble with start delimiter 8, checksum 4, gap 12 (IEEE 802.3).
const AROUND_FRAME: usize = 8 + 4 + 12;
/// Ethernet header and EtherCAT header (ETG.1000.4).
const HEADERS: usize = 14 + 2;
/// A shorter frame is filled up to this, without its checksum (IEEE 802.3).
const SHORTEST: usize = 60;
/// Around a datagram's data: header 10, working counter 2 (ETG.1000.4).
const DATAGRAM: usize = 10 + 2;
/// The tag, a NOP with four bytes of data.
const TAG: usize = DATAGRAM + 4;
/// Data of a frame's one LRW: 1498 bytes of datagrams less the tag, its own 12, the AL status (14), four mailbox states (13 each), and
/// the reference clock's time (16), for which there is room in every frame.
const AREA: usize = 1498 - TAG - DATAGRAM - 14 - 4 * 13 - 16;
/// Of a byte at 100 Mbit/s, in nanoseconds.
const BYTE_NS: usize = 80;
/// What a SubDevice keeps a frame, there and back, in nanoseconds. Assumed: each way some 0.25 µs in two 100BASE-TX PHYs and as much in
/// the ESC.
const DEVICE_NS: usize = 1_000;
/// Of a metre of cable, in nanoseconds.
const METRE_NS: usize = 5;

/// A line whose drives are all alike.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cable {
    /// Drives with a mailbox.
    pub(crate) drives: usize,
    /// Bytes of a drive, outputs and inputs.
    pub(crate) bytes: usize,
    /// Whether the time of a reference clock is distributed.
    pub(crate) clock: bool,
    /// All cables together.
    pub(crate) metres: usize,
}

impl Cable {
    /// The lengths of a cycle's frames, as they are handed to the operating system. No drive is divided between two.
    pub(crate) fn frames(self) -> Vec<usize> {
        let in_a_frame = AREA / self.bytes;
        let count = self.drives.div_ceil(in_a_frame);
        let mailbox_states = self.drives.div_ceil(8).min(4 * count);
        let length = |frame: usize| {
            let drives = in_a_frame.min(self.drives - frame * in_a_frame);
            let states = mailbox_states / count + usize::from(frame < mailbox_states % count);
            HEADERS
                + TAG
                + (DATAGRAM + drives * self.bytes)
                + states * (DATAGRAM + 1)
                + usize::from(frame == count - 1) * (DATAGRAM + 2)
                + usize::from(self.clock && frame == 0) * (DATAGRAM + 4)
        };
        (0..count).map(length).collect()
    }

    /// From the first bit sent to the last one received, in nanoseconds.
    pub(crate) fn nanoseconds(self) -> usize {
        let bytes = self.frames().into_iter();
        let bytes: usize = bytes.map(|frame| frame.max(SHORTEST) + AROUND_FRAME).sum();
        bytes * BYTE_NS + self.drives * DEVICE_NS + 2 * self.metres * METRE_NS
    }
}
