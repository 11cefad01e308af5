//! What a cycle shows, once it is taken out what one word or one sample may have wrong (D1, D2 in docs/fault-model.md).
//!
//! The axis makes it in `axis/observed.rs`. The machines of the modes look at this and at no bit of a statusword.

use core::time::Duration;

use crate::{
    ds402::{Controlword, Statusword},
    timer::{Due, Elapsed, Timer},
};

use super::{Bounds, Delivery, Doubt, Failure, LastSeen, Limits, Traits, WaitingFor};

/// A bit of the statusword. What it has shown for two cycles of the drive is sure; before that it may be wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Bit {
    Low,
    High,
    PerhapsLow,
    PerhapsHigh,
}

impl Bit {
    /// Surely high.
    #[inline]
    pub const fn is_high(self) -> bool {
        matches!(self, Self::High)
    }

    /// Surely low.
    #[inline]
    pub const fn is_low(self) -> bool {
        matches!(self, Self::Low)
    }

    /// As two words show it.
    #[inline]
    pub const fn is_sure(self) -> bool {
        self.is_high() || self.is_low()
    }

    /// High in this word.
    #[inline]
    pub const fn shows_high(self) -> bool {
        matches!(self, Self::High | Self::PerhapsHigh)
    }
}

/// A bit that is followed from word to word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub(crate) struct ShownBit {
    high: bool,
    steady: Timer,
}

impl ShownBit {
    /// Takes in a word. `seen`: two cycles of the drive.
    #[inline]
    pub fn update(&mut self, high: bool, elapsed: Elapsed, seen: Duration) {
        if high == self.high {
            self.steady.pass(elapsed);
        } else {
            // A second word is needed, however long ago this one was.
            self.steady = Timer::new(seen.max(Duration::from_nanos(1)));
            self.high = high;
        }
    }

    #[inline]
    pub const fn bit(self) -> Bit {
        match (self.high, self.steady.is_over()) {
            (false, true) => Bit::Low,
            (true, true) => Bit::High,
            (false, false) => Bit::PerhapsLow,
            (true, false) => Bit::PerhapsHigh,
        }
    }

    pub const fn due(self) -> Due {
        self.steady.due()
    }
}

/// What one cycle shows of the axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Evidence {
    /// Position actual value 6064h, and that of the sample before.
    pub position: i32,
    pub before: i32,
    /// Where the axis stands, if it does.
    pub rest: Option<i32>,
    /// Before this sample others are missing, for more than three eighths of the settle time: frames were lost, or the host stood still.
    pub blind: bool,
    /// Bits 10, 12 and 13.
    pub reached: Bit,
    pub acknowledge: Bit,
    pub error: Bit,
}

impl Evidence {
    #[inline]
    pub const fn stands(&self) -> bool {
        self.rest.is_some()
    }
}

/// What a machine of a mode gets in a cycle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cycle<'a> {
    /// The network's time.
    pub now: Duration,
    /// Since the machines had the last one.
    pub elapsed: Elapsed,
    pub evidence: Evidence,
    /// Whether the outputs sent last are known to have been delivered.
    pub delivered: bool,
    /// Bit 8 is sent, or its low is not surely seen (S7).
    pub halted: bool,
    /// For errors.
    pub statusword: Statusword,
    pub controlword: Controlword,
    pub last_seen: &'a LastSeen,
    pub rules: Rules<'a>,
}

/// What is known of the drive and its axis beforehand.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rules<'a> {
    pub traits: &'a Traits,
    pub bounds: &'a Bounds,
    pub limits: &'a Limits,
    pub referenced: bool,
    /// Deadline of each wait for bit 12.
    pub acknowledge: Duration,
    /// How long a set-point may take to begin.
    pub begin: Duration,
    /// How long an axis may take to come to rest.
    pub standstill: Duration,
    /// With a command: how long ago the machines were stepped. It is part of what the next cycle has for `elapsed`.
    pub ahead: Elapsed,
}

impl Rules<'_> {
    /// A time that begins now.
    pub const fn timer(&self, time: Duration) -> Timer {
        Timer::new(time).later(self.ahead)
    }

    /// After so long the drive has surely seen what was delivered.
    pub const fn seen(&self) -> Timer {
        self.timer(self.traits.surely_seen())
    }
}

/// What a drive shows from one millisecond to the next, for tests of the machines.
#[cfg(test)]
#[derive(Debug)]
pub(crate) struct Eyes {
    pub bounds: Bounds,
    pub traits: Traits,
    pub limits: Limits,
    pub acknowledge: Duration,
    pub begin: Duration,
    pub standstill: Duration,
    bits: [ShownBit; 3],
    rest: super::Standstill,
    last_seen: LastSeen,
    now: Duration,
    before: i32,
}

#[cfg(test)]
impl Eyes {
    pub fn new() -> Self {
        let ms = Duration::from_millis;
        Self {
            bounds: Bounds::new(10, ms(100), ms(1), None),
            traits: Traits::cia402(),
            limits: Limits::trust_drive(),
            acknowledge: ms(500),
            begin: ms(2_000),
            standstill: ms(1_000),
            bits: [ShownBit::default(); 3],
            rest: super::Standstill::default(),
            last_seen: LastSeen::default(),
            now: Duration::ZERO,
            before: 0,
        }
    }

    /// What is counted as rest before now is none.
    pub fn count_rest_anew(&mut self) {
        self.rest.begin_anew();
    }

    /// A cycle with this sample, up to this time.
    pub fn see(
        &mut self,
        now: Duration,
        word: u16,
        position: i32,
        controlword: Controlword,
    ) -> Cycle<'_> {
        let statusword = Statusword::from_bits_retain(word);
        let elapsed = Elapsed(crate::timer::nanoseconds(now.saturating_sub(self.now)));
        self.now = now;
        let rest = self.rest.update(position, elapsed, false, &self.bounds);
        for (bit, number) in self.bits.iter_mut().zip([10, 12, 13]) {
            bit.update(word >> number & 1 != 0, elapsed, self.traits.surely_seen());
        }
        let [reached, acknowledge, error] = self.bits.map(ShownBit::bit);
        let before = core::mem::replace(&mut self.before, position);
        Cycle {
            now,
            elapsed,
            evidence: Evidence {
                position,
                before,
                rest,
                blind: false,
                reached,
                acknowledge,
                error,
            },
            delivered: true,
            halted: false,
            statusword,
            controlword,
            last_seen: &self.last_seen,
            rules: Rules {
                traits: &self.traits,
                bounds: &self.bounds,
                limits: &self.limits,
                referenced: true,
                acknowledge: self.acknowledge,
                begin: self.begin,
                standstill: self.standstill,
                ahead: Elapsed(0),
            },
        }
    }
}

impl Cycle<'_> {
    /// A wait for standstill, with what was seen instead.
    pub fn standstill(&self) -> WaitingFor {
        WaitingFor::Standstill(self.last_seen.unrest(self.rules.bounds))
    }

    /// What has become of a set-point is not known.
    pub const fn unknown(&self, doubt: Doubt) -> Failure {
        Failure::Unknown {
            doubt,
            actual: self.evidence.position,
            statusword: self.statusword,
            controlword: self.controlword,
        }
    }

    pub const fn timeout(&self, waiting_for: WaitingFor, delivery: Delivery) -> Failure {
        Failure::Timeout {
            waiting_for,
            statusword: self.statusword,
            controlword: self.controlword,
            delivery,
        }
    }
}
