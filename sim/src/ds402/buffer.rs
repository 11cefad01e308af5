//! The set-points that a drive holds, and what the handshake of bits 4 and 12 remembers.

use core::time::Duration;
use std::collections::VecDeque;

use super::behaviour::AckPolicy;
use super::set_point::SetPoint;

/// One set-point is active, as many may wait as the behaviour says.
#[derive(Debug, Clone, Default)]
pub(super) struct Buffer {
    pub(super) active: Option<SetPoint>,
    pub(super) waiting: VecDeque<SetPoint>,
    pub(super) halted: bool,
    pub(super) ack: bool,
    /// Cycles until a delayed acknowledge rises.
    pub(super) ack_due: Option<u32>,
    /// Cycles until a rising edge of bit 4 passes the filter.
    pub(super) edge_due: Option<u32>,
    /// Bit 4 rose during a halt, and is high since.
    pub(super) edge_at_halt: bool,
    /// A single set-point is asked for, and is taken after arrival.
    pub(super) asked: bool,
    /// When the active set-point sets off, while it waits for that.
    pub(super) sets_off_at: Option<Duration>,
    /// The last target was outside the limits.
    pub(super) limited: bool,
    pub(super) previous_target: i64,
    /// The last controlword with bit 4 low.
    pub(super) low_word: u16,
}

impl Buffer {
    /// Empty, with this position as the target before the first.
    pub(super) fn at(position: i64) -> Buffer {
        Buffer {
            previous_target: position,
            ..Buffer::default()
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.active.is_none() && self.waiting.is_empty()
    }

    /// Whether nothing more can wait behind the active one.
    pub(super) fn is_full(&self, waiting: usize) -> bool {
        self.active.is_some() && self.waiting.len() >= waiting
    }

    /// Whether the axis goes to a limit, or the last target was outside the limits.
    pub(super) fn is_limited(&self) -> bool {
        self.limited || self.active.as_ref().is_some_and(|active| active.limited)
    }

    /// Takes out everything, in order.
    pub(super) fn drain(&mut self) -> Vec<SetPoint> {
        self.sets_off_at = None;
        self.active
            .take()
            .into_iter()
            .chain(self.waiting.drain(..))
            .collect()
    }

    /// The target of the last set-point in the buffer, where it is known.
    pub(super) fn last_target(&self) -> Option<i64> {
        self.waiting.back().or(self.active.as_ref())?.target
    }

    /// Operation was enabled.
    pub(super) fn enabled(&mut self, policy: AckPolicy) {
        self.ack = policy == AckPolicy::StickyAtEnable;
    }
}
