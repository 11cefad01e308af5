//! A stop under way: how far it is and who waits for it.

use core::time::Duration;

use crate::{
    ds402::{Controlword, Sample, State},
    profile_position::{CommandId, Failure},
};

use super::{AxisCore, power::Power, slowing::Slowing};

/// Commands that can wait for one standstill.
const WAITERS: usize = 8;

/// How far a stop is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub(super) enum Stage {
    /// No stop is under way; the axis may be halted.
    #[default]
    None,
    /// Halting, with the quick stop to follow at standstill or then. Of an axis that is known to move for nothing, where it was: if
    /// it comes to rest and has not left that place, there is nothing to abandon.
    Halting { until: Duration, from: Option<i32> },
    /// Quick stop, to be at standstill by then; without a time it is commanded on without anybody waiting.
    Quick { until: Option<Duration> },
    /// The drive stops the axis by itself, or has left it without power: it is to stand by then.
    Settling { until: Duration },
    /// Voltage being disabled: after the quick stop, or in place of one that the drive ignores.
    Off { until: Duration },
}

/// What a waiter waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Wait {
    /// Standstill with bit 8, until then.
    Halt { until: Duration },
    /// The end of the stop.
    Stop,
    /// The standstill of an axis whose stop was overtaken by a fault.
    Faulted(Failure),
}

/// The stop under way.
#[derive(Debug, Clone, Hash, Default)]
pub(super) struct Stopping {
    pub(super) stage: Stage,
    /// Whether the axis is to be disabled at the end.
    pub(super) off: bool,
    /// Whether those whose set-points are kept have been told that the axis stands.
    pub(super) halt_reported: bool,
    /// Whether bit 8 was asked for by something that nobody waits for: liveness, a stop handle.
    pub(super) unwatched: bool,
    /// Whether bit 8 is the stop's own: it falls again where there is nothing to abandon.
    pub(super) lent: bool,
    /// Whether the axis was under way for a set-point when bit 8 was asked for, and no input has changed since that was delivered: then nobody knows
    /// whether the drive is still at work, and a position that stays is no rest.
    pub(super) unanswered: bool,
    /// What bit 8 does.
    pub(super) slowing: Slowing,
    /// Since when a drive that stays in Operation enabled is known to have been sent bit 2 low, and what that does.
    pub(super) quick_delivered: Option<Duration>,
    pub(super) quick_slowing: Slowing,
    /// Since when bit 2 low is known to have been delivered in this quick stop, and since when each sample has shown a state in which it may end.
    sent_since: Option<Duration>,
    shown_since: Option<Duration>,
    waiters: [Option<(CommandId, Wait)>; WAITERS],
    /// How many of these places are taken: there is seldom anybody to look for.
    waiting: usize,
}

impl Stopping {
    pub(super) const fn is_quick(&self) -> bool {
        matches!(self.stage, Stage::Quick { .. })
    }

    pub(super) const fn is_switching_off(&self) -> bool {
        matches!(self.stage, Stage::Off { .. })
    }

    /// Bit 8 begins, or is over.
    pub(super) fn begin_halt(&mut self) {
        self.unwatched = false;
        self.lent = false;
        self.unanswered = false;
        self.slowing = Slowing::default();
    }

    /// Bit 2 falls, and the axis is to stand by then.
    pub(super) fn begin_quick(&mut self, until: Duration) {
        self.stage = Stage::Quick { until: Some(until) };
        self.sent_since = None;
        self.shown_since = None;
        self.measure_quick();
    }

    /// What bit 2 does is measured from its next delivery on.
    fn measure_quick(&mut self) {
        self.quick_delivered = None;
        self.quick_slowing = Slowing::default();
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

    /// Adds a waiter; false when there is no room. One that waits already waits on.
    pub(super) fn wait(&mut self, id: CommandId, wait: Wait) -> bool {
        if self
            .waiters
            .iter()
            .flatten()
            .any(|(waiter, _)| *waiter == id)
        {
            return true;
        }
        match self.waiters.iter_mut().find(|place| place.is_none()) {
            Some(place) => {
                *place = Some((id, wait));
                self.waiting += 1;
                true
            }
            None => false,
        }
    }

    /// Whoever waits for a stop has heard of a fault, and waits for the standstill alone. Whether there is anybody.
    pub(super) fn note_fault(&mut self, failure: Failure) -> bool {
        let mut waits = false;
        for (_, wait) in self.waiters.iter_mut().flatten() {
            if *wait == Wait::Stop {
                *wait = Wait::Faulted(failure);
            }
            waits |= matches!(wait, Wait::Faulted(_));
        }
        waits
    }

    /// Whoever waits for a halt waits for the standstill alone. Whether there is anybody.
    pub(super) fn halts_become_stops(&mut self) -> bool {
        if self.has_no_waiter() {
            return false;
        }
        let mut waits = false;
        for (_, wait) in self.waiters.iter_mut().flatten() {
            if matches!(wait, Wait::Halt { .. }) {
                *wait = Wait::Stop;
                waits = true;
            }
        }
        waits
    }

    /// Takes one waiter, and what it was to be told instead of the end of its stop.
    pub(super) fn next_waiter(&mut self) -> Option<(CommandId, Option<Failure>)> {
        let (id, wait) = self.take(|_| true)?;
        let failure = match wait {
            Wait::Faulted(failure) => Some(failure),
            Wait::Stop | Wait::Halt { .. } => None,
        };
        Some((id, failure))
    }

    /// Does this with what each of them waits for.
    pub(super) fn each_wait(&mut self, of: impl FnMut(&mut Wait)) {
        let waits = self.waiters.iter_mut().flatten().map(|(_, wait)| wait);
        waits.for_each(of);
    }

    pub(super) const fn has_no_waiter(&self) -> bool {
        self.waiting == 0
    }

    /// Takes one waiter for which `which` holds.
    pub(super) fn take_waiter(&mut self, which: impl Fn(Wait) -> bool) -> Option<CommandId> {
        self.take(which).map(|(id, _)| id)
    }

    fn take(&mut self, which: impl Fn(Wait) -> bool) -> Option<(CommandId, Wait)> {
        if self.has_no_waiter() {
            return None;
        }
        let mut places = self.waiters.iter_mut();
        let place = places.find(|place| place.is_some_and(|(_, wait)| which(wait)))?;
        self.waiting -= 1;
        place.take()
    }
}

impl AxisCore {
    /// Whether the drive has had the time to take in what was delivered then.
    pub(super) fn has_seen(&self, now: Duration, delivered: Option<Duration>) -> bool {
        delivered.is_some_and(|since| now.saturating_sub(since) >= self.config.traits.surely_seen())
    }

    /// Whether the state of this sample, in which a quick stop may end or not, shows that the drive has followed it: the drive has surely seen bit 2
    /// low; or, where nobody knows what it receives, has shown no other state for the settle time. One statusword alone may be wrong.
    pub(super) fn has_quick_stopped(
        &mut self,
        now: Duration,
        may_end: bool,
        delivered: bool,
    ) -> bool {
        if delivered && !self.sent.contains(Controlword::BIT_QUICK_STOP) {
            self.stopping.sent_since.get_or_insert(now);
        }
        if !may_end {
            self.stopping.shown_since = None;
            return false;
        }
        let shown = *self.stopping.shown_since.get_or_insert(now);
        self.has_seen(now, self.stopping.sent_since)
            || now.saturating_sub(shown) >= self.bounds.settle
    }

    /// Whether the drive stays in Operation enabled although it has surely seen the quick stop, and the axis gets no slower, or has
    /// had the time to come to rest since.
    pub(super) fn ignores_quick_stop(
        &mut self,
        now: Duration,
        sample: &Sample,
        delivered: bool,
    ) -> bool {
        if sample.state() != State::OperationEnabled {
            self.stopping.measure_quick();
            return false;
        }
        if delivered && !self.sent.contains(Controlword::BIT_QUICK_STOP) {
            self.stopping.quick_delivered.get_or_insert(now);
        }
        if self.has_seen(now, self.stopping.quick_delivered) {
            let slowing = &mut self.stopping.quick_slowing;
            slowing.observe(now, sample.position, &self.bounds);
        }
        let standstill = self.config.deadlines.standstill;
        let since = self.stopping.quick_delivered;
        self.stopping.quick_slowing.runs_on()
            || since.is_some_and(|since| now.saturating_sub(since) >= standstill)
    }

    /// The drive does not stop the axis: without voltage it at least drives it no further.
    pub(super) fn give_quick_stop_up(&mut self, now: Duration) {
        self.fail_motions(Failure::QuickStopIgnored);
        self.fail_commands(Failure::QuickStopIgnored);
        self.power = Power::Off;
        self.stopping.off = false;
        self.brake.give_up();
        let until = now.saturating_add(self.config.deadlines.disable);
        self.stopping.stage = Stage::Off { until };
    }
}
