//! One cycle as the sequencer sees it.

use core::time::Duration;

use crate::ds402::{Controlword, Sample, Statusword};

use super::{Bounds, Delivery, Failure, LastSeen, Limits, Standstill, Traits, WaitingFor};

/// What the sequencer needs to know of a cycle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cycle<'a> {
    pub(crate) now: Duration,
    pub(crate) sample: &'a Sample,
    pub(crate) standstill: &'a Standstill,
    pub(crate) bounds: &'a Bounds,
    pub(crate) last_seen: &'a LastSeen,
    pub(crate) traits: &'a Traits,
    pub(crate) limits: &'a Limits,
    pub(crate) referenced: bool,
    /// Whether the outputs of this cycle are known to have been delivered.
    pub(crate) delivered: bool,
    pub(crate) halted: bool,
    /// How many cycles before this one brought no inputs.
    pub(crate) blind: u32,
    /// How many cycles, by the clock, the host has stood still before this one.
    pub(crate) stalled: u32,
    /// Whether bit 11 (internal limit active) was ever seen low in Operation enabled: of a drive that shows it always it says
    /// nothing.
    pub(crate) limit_tells: bool,
    /// Deadline of each wait for bit 12.
    pub(crate) acknowledge: Duration,
    /// How long a set-point may take to show that it has begun.
    pub(crate) begin: Duration,
    /// The word sent with this cycle, for errors.
    pub(crate) controlword: Controlword,
}

impl Cycle<'_> {
    /// The same, blind for as long as the host has stood still too.
    pub(super) fn with_stall(&self) -> Self {
        Self {
            blind: self.blind.max(self.stalled),
            ..*self
        }
    }

    /// A wait for standstill, with what was seen instead.
    pub(crate) fn standstill(&self) -> WaitingFor {
        WaitingFor::Standstill(self.last_seen.unrest(self.bounds))
    }

    /// Bit 12.
    pub(super) fn is_acknowledging(&self) -> bool {
        let statusword = self.sample.statusword;
        statusword.contains(Statusword::SET_POINT_ACKNOWLEDGE)
    }

    /// Bit 10.
    pub(super) fn is_reached(&self) -> bool {
        self.sample.statusword.contains(Statusword::TARGET_REACHED)
    }

    /// Bit 9.
    pub(super) fn is_remote(&self) -> bool {
        self.sample.statusword.contains(Statusword::REMOTE)
    }

    /// Whether the drive has surely seen what was delivered at that time.
    pub(super) fn is_seen(&self, delivered: Duration) -> bool {
        self.now.saturating_sub(delivered) >= self.traits.surely_seen()
    }

    /// Whether the time for each wait for bit 12 is over.
    pub(super) fn is_late(&self, since: Duration) -> bool {
        self.now.saturating_sub(since) >= self.acknowledge
    }

    pub(super) const fn timeout(&self, waiting_for: WaitingFor, delivery: Delivery) -> Failure {
        Failure::Timeout {
            waiting_for,
            statusword: self.sample.statusword,
            controlword: self.controlword,
            delivery,
        }
    }
}
