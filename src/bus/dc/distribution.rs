//! The datagram that reads the reference clock's time and gives it to all others: FRMW of register 0910h, the low half, which
//! is what the clocks compare (ESC data sheet, section I, 9.1.5).

use std::ops::Range;

use crate::bus::frame::{Composer, DATAGRAM_OVERHEAD, command};

/// Register of the system time.
pub(super) const SYSTEM_TIME: u16 = 0x0910;
const BYTES: usize = 4;
/// What the datagram takes of the first frame.
pub(in crate::bus) const RESERVED: usize = DATAGRAM_OVERHEAD + BYTES;

/// Whose time is given to whom.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Distribution {
    /// Station address of the reference clock.
    pub(in crate::bus) station: u16,
    /// How many clocks there are, the reference among them.
    pub(in crate::bus) clocks: u16,
}

/// The datagram in the first frame of the exchange.
#[derive(Debug, Clone)]
pub(in crate::bus) struct Slot {
    data: Range<usize>,
    clocks: u16,
    sent: u32,
}

impl Slot {
    /// Adds it to a frame.
    pub(in crate::bus) fn push(composer: &mut Composer, distribution: Distribution) -> Self {
        let [s0, s1] = distribution.station.to_le_bytes();
        let [r0, r1] = SYSTEM_TIME.to_le_bytes();
        Self {
            data: composer.push(command::FRMW, [s0, s1, r0, r1], BYTES),
            clocks: distribution.clocks,
            sent: 0,
        }
    }

    /// Puts the time in at which the frame will pass the reference clock, as far as is known: where the reference is gone,
    /// that is what the others get.
    pub(in crate::bus) fn fill(&mut self, request: &mut [u8], time: u32) {
        self.sent = time;
        if let Some(data) = request.get_mut(self.data.clone()) {
            data.copy_from_slice(&time.to_le_bytes());
        }
    }

    /// The time that the reference clock put in, if it answered.
    pub(in crate::bus) fn read(&self, answer: &[u8]) -> Option<u32> {
        let data = answer.get(self.data.start..self.data.end + 2)?;
        let &[t0, t1, t2, t3, c0, c1] = data else {
            return None;
        };
        let time = u32::from_le_bytes([t0, t1, t2, t3]);
        let all = u16::from_le_bytes([c0, c1]) == self.clocks;
        // It cannot be told otherwise from one that is gone: the others count for themselves.
        (time != self.sent || all).then_some(time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_datagram_has_the_bytes_of_the_standard_and_tells_an_answer_from_none() {
        let mut composer = Composer::new();
        let distribution = Distribution {
            station: 0x1001,
            clocks: 3,
        };
        let mut slot = Slot::push(&mut composer, distribution);
        let mut frame = composer.finish();
        slot.fill(&mut frame, 0x0403_0201);
        // ETG.1000.4: FRMW is command 14.
        let datagram = [14, 0, 0x01, 0x10, 0x10, 0x09, 4, 0, 0, 0, 1, 2, 3, 4, 0, 0];
        assert_eq!(frame[16..], datagram);
        // Two others have taken what was sent.
        frame[30] = 2;
        assert_eq!(slot.read(&frame), None);
        frame[30] = 3;
        assert_eq!(slot.read(&frame), Some(0x0403_0201));
        // One other is silent, and the reference has put its time in.
        frame[30] = 2;
        frame[26] = 9;
        assert_eq!(slot.read(&frame), Some(0x0403_0209));
        assert_eq!(slot.read(&frame[..31]), None);
    }
}
