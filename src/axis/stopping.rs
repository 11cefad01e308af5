//! A stop under way: how far it is and who waits for it.

use core::time::Duration;

use crate::profile_position::CommandId;

use super::slowing::Slowing;

/// Commands that can wait for one standstill.
const WAITERS: usize = 8;

/// How far a stop is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Stage {
    /// No stop is under way; the axis may be halted.
    #[default]
    None,
    /// Halting, with the quick stop to follow at standstill or then.
    Halting { until: Duration },
    /// Quick stop, to be at standstill by then; without a time it is commanded on without anybody waiting.
    Quick { until: Option<Duration> },
    /// Voltage being disabled after the quick stop.
    Off { until: Duration },
}

/// What a waiter waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wait {
    /// Standstill with bit 8, until then.
    Halt { until: Duration },
    /// The end of the stop.
    Stop,
}

/// The stop under way.
#[derive(Debug, Default)]
pub(super) struct Stopping {
    pub(super) stage: Stage,
    /// Whether the axis is to be disabled at the end.
    pub(super) off: bool,
    /// Whether those whose set-points are kept have been told that the axis stands.
    pub(super) halt_reported: bool,
    /// What bit 8 does.
    pub(super) slowing: Slowing,
    waiters: [Option<(CommandId, Wait)>; WAITERS],
}

impl Stopping {
    pub(super) const fn is_quick(&self) -> bool {
        matches!(self.stage, Stage::Quick { .. })
    }

    pub(super) const fn is_active(&self) -> bool {
        !matches!(self.stage, Stage::None)
    }

    /// Somebody new waits for a quick stop whose deadline has passed: it gets a deadline again.
    pub(super) const fn set_deadline(&mut self, until: Duration) {
        if matches!(self.stage, Stage::Quick { until: None }) {
            self.stage = Stage::Quick { until: Some(until) };
        }
    }

    /// Adds a waiter; false when there is no room.
    pub(super) fn wait(&mut self, id: CommandId, wait: Wait) -> bool {
        match self.waiters.iter_mut().find(|place| place.is_none()) {
            Some(place) => {
                *place = Some((id, wait));
                true
            }
            None => false,
        }
    }

    pub(super) fn has_no_waiter(&self) -> bool {
        self.waiters.iter().all(Option::is_none)
    }

    pub(super) fn pop_waiter(&mut self) -> Option<CommandId> {
        self.take_waiter(|_| true)
    }

    /// Takes one waiter for which `which` holds.
    pub(super) fn take_waiter(&mut self, which: impl Fn(Wait) -> bool) -> Option<CommandId> {
        self.waiters
            .iter_mut()
            .find(|place| place.is_some_and(|(_, wait)| which(wait)))
            .and_then(Option::take)
            .map(|(id, _)| id)
    }
}
