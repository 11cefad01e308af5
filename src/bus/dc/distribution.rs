//! The datagram that reads the reference clock's time and gives it to all others: FRMW of register 0910h, the low half, which
//! is what the clocks compare (ESC data sheet, section I, 9.1.5).

use std::ops::Range;

use crate::bus::frame::{Composer, DATAGRAM_HEADER, DATAGRAM_OVERHEAD, command};

/// Register of the system time.
pub(super) const SYSTEM_TIME: u16 = 0x0910;
const BYTES: usize = 4;
/// What the datagram takes of the first frame.
pub(in crate::bus) const RESERVED: usize = DATAGRAM_OVERHEAD + BYTES;

/// Whose time is given to all others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Distribution {
    /// Station address of the reference clock.
    pub(in crate::bus) station: u16,
}

/// By how many nanoseconds what is sent goes up and down from cycle to cycle: no clock in step does that.
const RIPPLE: u32 = 8;
/// What comes back as it was sent so often in a row was not read from a clock.
const ECHOES: u32 = 4;

/// The datagram in the first frame of the exchange.
#[derive(Debug, Clone)]
pub(in crate::bus) struct Slot {
    data: Range<usize>,
    ripple: u32,
    sent: u32,
    /// How often in a row came back what was sent.
    echoes: u32,
}

impl Slot {
    /// Adds it to a frame.
    pub(in crate::bus) fn push(composer: &mut Composer, distribution: Distribution) -> Self {
        let [s0, s1] = distribution.station.to_le_bytes();
        let [r0, r1] = SYSTEM_TIME.to_le_bytes();
        Self {
            data: composer.push(command::FRMW, [s0, s1, r0, r1], BYTES),
            ripple: 0,
            sent: 0,
            echoes: ECHOES,
        }
    }

    /// Puts the time in at which the frame will pass the reference clock, as far as is known: where the reference is gone,
    /// that is what the others get.
    pub(in crate::bus) fn fill(&mut self, request: &mut [u8], time: u32) {
        self.ripple ^= RIPPLE;
        self.sent = time.wrapping_add(self.ripple);
        if let Some(data) = request.get_mut(self.data.clone()) {
            data.copy_from_slice(&self.sent.to_le_bytes());
        }
    }

    /// The time that the reference clock put into the frame that came back, if it did. The working counter does not tell: a
    /// SubDevice that was switched off and on has lost its station address, and takes the time like all others.
    pub(in crate::bus) fn read(&mut self, answer: Option<&[u8]>) -> Option<u32> {
        let data = answer.and_then(|answer| answer.get(self.data.clone()));
        let time = data.and_then(|data| Some(u32::from_le_bytes(data.try_into().ok()?)));
        self.echoes = match time {
            None => ECHOES,
            Some(time) if time == self.sent => self.echoes.saturating_add(1),
            Some(_) => 0,
        };
        // A clock in step may show by chance what was sent, and what was sent is where it should be.
        time.filter(|_| self.echoes < ECHOES)
    }

    /// From now on all clocks get the time that is put in, the reference among them (BWR).
    pub(in crate::bus) fn lead(&self, request: &mut [u8]) {
        let start = self.data.start.checked_sub(DATAGRAM_HEADER);
        let datagram = start.and_then(|start| request.get_mut(start..self.data.start));
        if let Some([command, _, s0, s1, ..]) = datagram {
            (*command, *s0, *s1) = (command::BWR, 0, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slot() -> (Slot, Vec<u8>) {
        let mut composer = Composer::new();
        let slot = Slot::push(&mut composer, Distribution { station: 0x1001 });
        (slot, composer.finish())
    }

    #[test]
    fn the_datagram_has_the_bytes_of_the_standard() {
        let (mut slot, mut frame) = slot();
        slot.fill(&mut frame, 0x0403_0201);
        // ETG.1000.4: FRMW is command 14.
        let datagram = [14, 0, 0x01, 0x10, 0x10, 0x09, 4, 0, 0, 0, 9, 2, 3, 4, 0, 0];
        assert_eq!(frame[16..], datagram);
        // BWR is command 8; the first SubDevice's position is 0.
        slot.lead(&mut frame);
        assert_eq!(frame[16..22], [8, 0, 0, 0, 0x10, 0x09]);
        assert_eq!(slot.read(Some(&frame[..29])), None);
    }

    #[test]
    fn an_echo_is_no_answer_whatever_the_working_counter_says() {
        let (mut slot, mut frame) = slot();
        // Three SubDevices have taken what was sent.
        frame[30] = 3;
        let mut heard = |cycles| {
            let echoes = (0..cycles).filter(|cycle| {
                slot.fill(&mut frame, 1_000 * cycle);
                slot.read(Some(&frame)).is_some()
            });
            let heard = echoes.count();
            // The clock answers once.
            frame[26] ^= 1;
            assert!(slot.read(Some(&frame)).is_some());
            heard
        };
        assert_eq!(heard(100), 0);
        assert_eq!(heard(100), ECHOES as usize - 1);
    }

    #[test]
    fn a_clock_that_is_exactly_in_step_is_heard_in_each_cycle() {
        let (mut slot, mut frame) = slot();
        for cycle in 0..100 {
            let time = 1_000 * cycle;
            slot.fill(&mut frame, time);
            let mut answer = frame.clone();
            answer[26..30].copy_from_slice(&time.to_le_bytes());
            assert_eq!(slot.read(Some(&answer)), Some(time));
        }
    }
}
