//! What the worlds have in common in which a core is stepped against a drive in virtual time, as bytes without frames: what a lost
//! frame is, inputs that are late, numbers from a seed.
#![allow(missing_docs)]
#![allow(dead_code, reason = "each test file uses its own part of it")]

use std::collections::VecDeque;

use servocrab::axis::Inputs;

/// What happens to one cycle's frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Link {
    /// Out and back, working counter right.
    Good,
    /// Lost on the way out: the drive sees nothing, the master neither.
    RequestLost,
    /// Lost on the way back, or too late: the drive has the outputs, the master nothing.
    ReplyLost,
    /// Out and back, but the working counter is wrong because of somebody else.
    Miscounted,
    /// As that, and the drive has not taken its outputs.
    Undelivered,
}

impl Link {
    /// Whether the drive gets the outputs.
    pub fn delivers(self) -> bool {
        !matches!(self, Self::RequestLost | Self::Undelivered)
    }

    /// What the core is told of the inputs that came back, if any have.
    pub fn tells(self, inputs: Option<&[u8]>) -> Inputs<'_> {
        match (self, inputs) {
            (Self::Good, Some(inputs)) => Inputs::Fresh(inputs),
            (Self::Miscounted | Self::Undelivered, Some(inputs)) => Inputs::Answered(inputs),
            _ => Inputs::Stale,
        }
    }
}

/// Inputs on their way.
#[derive(Debug, Default)]
pub struct Late(VecDeque<Vec<u8>>);

impl Late {
    /// Sends these off; which ones arrive, where each takes so many frames more to come.
    pub fn pass(&mut self, inputs: Vec<u8>, frames: usize) -> Option<Vec<u8>> {
        self.0.push_back(inputs);
        if self.0.len() > frames {
            self.0.pop_front()
        } else {
            None
        }
    }
}

/// What these bytes of the outputs say, as the object of this index.
pub fn value(index: u16, bytes: &[u8]) -> i64 {
    let mut raw = [0; 8];
    raw[..bytes.len()].copy_from_slice(bytes);
    let value = i64::from_le_bytes(raw);
    match index {
        0x6060 => i64::from(value as i8),
        0x6086 => i64::from(value as i16),
        0x607A | 0x60FF => i64::from(value as i32),
        _ => value,
    }
}

/// SplitMix64.
#[derive(Debug)]
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }

    pub fn one_in(&mut self, n: u64) -> bool {
        self.below(n) == 0
    }

    pub fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len() as u64) as usize]
    }

    pub fn between(&mut self, from: i32, to: i32) -> i32 {
        from + self.below(u64::from(from.abs_diff(to))) as i32
    }
}
