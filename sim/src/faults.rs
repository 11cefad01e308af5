//! A wire between MainDevice and segment on which a plan decides what happens to each frame.

use core::time::Duration;

use crate::segment::Segment;

/// What happens to one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It comes back at once.
    None,
    /// It is lost on the way out: no SubDevice sees it.
    LoseRequest,
    /// It is lost on the way back: every SubDevice has seen it.
    LoseReply,
    /// It comes back after this time.
    Delay(Duration),
    /// It comes back at once and once more after this time.
    Double(Duration),
    /// It comes back with this many bytes at most.
    Cut(usize),
    /// It comes back with these bits of this byte inverted; a byte behind the end stays away.
    Corrupt {
        /// Number of the byte in the frame.
        at: usize,
        /// Bits to invert.
        bits: u8,
    },
}

/// Decides about each frame, by its number and its bytes as sent.
type Plan = Box<dyn FnMut(u64, &[u8]) -> Fault + Send>;

/// A segment behind a wire with faults.
///
/// ```
/// use core::time::Duration;
/// use servocrab_sim::{Fault, FaultyWire, Segment, personality};
///
/// let segment = Segment::new().with(personality::coupler());
/// let mut wire = FaultyWire::new(segment, |number, _| if number == 0 { Fault::LoseReply } else { Fault::None });
/// let mut frame = vec![0xFF; 12];
/// frame.extend([0x88, 0xA4, 13, 0x10, 7, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]);
/// wire.send(&frame, Duration::ZERO);
/// assert!(wire.receive(Duration::ZERO).is_none());
/// wire.send(&frame, Duration::ZERO);
/// assert!(wire.receive(Duration::ZERO).is_some());
/// ```
pub struct FaultyWire {
    segment: Segment,
    plan: Plan,
    sent: u64,
    /// Frames on their way back: when they arrive, and in which order they were sent.
    returning: Vec<(Duration, Vec<u8>)>,
}

impl FaultyWire {
    /// Puts a wire in front of a segment.
    pub fn new(segment: Segment, plan: impl FnMut(u64, &[u8]) -> Fault + Send + 'static) -> Self {
        Self {
            segment,
            plan: Box::new(plan),
            sent: 0,
            returning: Vec::new(),
        }
    }

    /// Changes the plan; frames on their way keep their fate, and the count of frames goes on.
    pub fn set_plan(&mut self, plan: impl FnMut(u64, &[u8]) -> Fault + Send + 'static) {
        self.plan = Box::new(plan);
    }

    /// The segment at the end of the wire.
    #[must_use]
    pub fn segment(&self) -> &Segment {
        &self.segment
    }

    /// The segment at the end of the wire, to be changed.
    pub fn segment_mut(&mut self) -> &mut Segment {
        &mut self.segment
    }

    /// Number of frames sent so far.
    #[must_use]
    pub fn sent(&self) -> u64 {
        self.sent
    }

    /// Sends a frame into the wire.
    pub fn send(&mut self, frame: &[u8], now: Duration) {
        let fault = (self.plan)(self.sent, frame);
        self.sent += 1;
        let mut frame = frame.to_vec();
        if fault == Fault::LoseRequest {
            self.segment.advance(now);
            return;
        }
        if !self.segment.process(&mut frame, now) || fault == Fault::LoseReply {
            return;
        }
        match fault {
            Fault::Delay(time) => self.returning.push((now.saturating_add(time), frame)),
            Fault::Double(time) => {
                self.returning.push((now, frame.clone()));
                self.returning.push((now.saturating_add(time), frame));
            }
            Fault::Cut(length) => {
                frame.truncate(length);
                self.returning.push((now, frame));
            }
            Fault::Corrupt { at, bits } => {
                if let Some(byte) = frame.get_mut(at) {
                    *byte ^= bits;
                }
                self.returning.push((now, frame));
            }
            Fault::None | Fault::LoseRequest | Fault::LoseReply => {
                self.returning.push((now, frame));
            }
        }
    }

    /// The next frame that has come back by `now`.
    pub fn receive(&mut self, now: Duration) -> Option<Vec<u8>> {
        let earliest = self.next_arrival().filter(|time| *time <= now)?;
        let position = self
            .returning
            .iter()
            .position(|(time, _)| *time == earliest)?;
        Some(self.returning.remove(position).1)
    }

    /// When the next frame comes back, of those that were sent.
    #[must_use]
    pub fn next_arrival(&self) -> Option<Duration> {
        self.returning.iter().map(|(time, _)| *time).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::personality;

    const NOW: Duration = Duration::from_secs(1);

    /// A BRD of one byte at 0000h, and a write of the AL control.
    const READ: [u8; 13] = [7, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0];
    const TO_PREOP: [u8; 14] = [8, 0, 0, 0, 0x20, 0x01, 2, 0, 0, 0, 2, 0, 0, 0];

    fn frame(datagram: &[u8]) -> Vec<u8> {
        let mut frame = vec![0xFF; 6];
        frame.extend([0x10; 6]);
        frame.extend([0x88, 0xA4, datagram.len() as u8, 0x10]);
        frame.extend(datagram);
        frame
    }

    fn wire(fault: Fault) -> FaultyWire {
        FaultyWire::new(Segment::new().with(personality::coupler()), move |_, _| {
            fault
        })
    }

    /// What comes back, with the time in milliseconds after sending.
    fn returned(fault: Fault, datagram: &[u8]) -> (Vec<(u64, Vec<u8>)>, FaultyWire) {
        let mut wire = wire(fault);
        wire.send(&frame(datagram), NOW);
        let mut all = Vec::new();
        for later in 0..20 {
            while let Some(frame) = wire.receive(NOW + Duration::from_millis(later)) {
                all.push((later, frame));
            }
        }
        (all, wire)
    }

    #[test]
    fn a_lost_request_has_no_effect_and_a_lost_reply_has_its_effect() {
        for (fault, state) in [
            (Fault::LoseRequest, crate::AlState::Init),
            (Fault::LoseReply, crate::AlState::PreOp),
        ] {
            let (all, wire) = returned(fault, &TO_PREOP);
            assert!(all.is_empty());
            assert_eq!(wire.segment().device(0).unwrap().al_state(), state);
        }
    }

    #[test]
    fn a_late_frame_comes_at_its_time_and_a_doubled_one_twice() {
        let five = Duration::from_millis(5);
        let times = |fault| {
            returned(fault, &READ)
                .0
                .iter()
                .map(|(time, _)| *time)
                .collect::<Vec<_>>()
        };
        assert_eq!(times(Fault::None), [0]);
        assert_eq!(times(Fault::Delay(five)), [5]);
        assert_eq!(times(Fault::Double(five)), [0, 5]);
    }

    #[test]
    fn a_cut_frame_is_shorter_and_a_corrupt_one_differs_in_its_bits() {
        let whole = returned(Fault::None, &READ).0[0].1.clone();
        assert_eq!(returned(Fault::Cut(20), &READ).0[0].1, whole[..20]);
        let corrupt = returned(Fault::Corrupt { at: 26, bits: 0x81 }, &READ).0[0]
            .1
            .clone();
        assert_eq!(corrupt[26], whole[26] ^ 0x81);
        assert_eq!(corrupt[..26], whole[..26]);
    }
}
