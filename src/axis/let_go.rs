//! What makes no difference to an axis any more, for a search over all its states.
//!
//! Times count up for ever, and numbers of cycles. Each is compared with a bound, and beyond that all values mean the same:
//! [`AxisCore::let_go`] makes them the same, and [`Hash`] tells two cores apart that may do different things next.

use core::{
    hash::{Hash, Hasher},
    time::Duration,
};

use crate::ds402::Controlword;

use super::{
    AxisCore,
    power::{Power, ResetPhase},
    stopping::{Stage, Stopping, Wait},
};

/// A time in the past, as one that lies back no farther than this.
pub(crate) fn no_older(at: &mut Duration, now: Duration, than: Duration) {
    *at = (*at).max(now.saturating_sub(than));
}

/// A deadline that is over, as one that is over just now.
fn not_over(until: &mut Duration, now: Duration) {
    *until = (*until).max(now);
}

impl AxisCore {
    /// Lets go of what makes no difference any more, after a step at this time. Before the next bit 4 rises, what 607Ah and the
    /// parameters hold is part of that.
    #[doc(hidden)]
    pub fn let_go(&mut self, now: Duration) {
        let (seen, deadlines) = (self.config.traits.surely_seen(), &self.config.deadlines);
        let settle = self.bounds.settle;
        self.standstill.let_go(now, settle);
        self.brake.let_go(now, seen);
        self.sequencer.let_go(
            now,
            seen,
            deadlines,
            settle,
            self.config.fields.actual_velocity.is_some(),
        );
        if !self.outgoing_starts() && !self.sent.contains(Controlword::NEW_SET_POINT) {
            self.sequencer.let_go_of_target();
        }
        for (at, longest) in [
            (&mut self.quiet_since, seen),
            (&mut self.halt_delivered, seen.saturating_add(settle)),
        ] {
            if let Some(at) = at {
                no_older(at, now, longest);
            }
        }
        self.stopping.let_go(now, deadlines.standstill.max(seen));
        match &mut self.power {
            Power::Off | Power::Ready | Power::Enabled | Power::Holding => {}
            Power::Disabling { deadline, .. } | Power::Enabling { deadline, .. } => {
                not_over(deadline, now);
            }
            Power::Resetting { phase, .. } => phase.let_go(now, seen),
        }
        if self.lost {
            let loss = &self.config.loss;
            let beyond = |cycles: u32, bound: u32| cycles.min(bound.saturating_add(1));
            self.stale_cycles = beyond(self.stale_cycles, loss.stale_cycles);
            self.undelivered_cycles = beyond(self.undelivered_cycles, loss.undelivered_cycles);
        }
    }
}

impl ResetPhase {
    fn let_go(&mut self, now: Duration, seen: Duration) {
        match self {
            Self::Low {
                until,
                reaction,
                shown,
            } => {
                not_over(until, now);
                not_over(reaction, now);
                if let Some(shown) = shown {
                    no_older(shown, now, seen.max(Duration::from_nanos(1)));
                }
            }
            Self::High { until } => not_over(until, now),
            Self::Gone { since, until } => {
                no_older(since, now, seen.max(Duration::from_nanos(1)));
                not_over(until, now);
            }
        }
    }
}

impl Stopping {
    fn let_go(&mut self, now: Duration, longest: Duration) {
        match &mut self.stage {
            Stage::None | Stage::Quick { until: None } => {}
            Stage::Halting { until, .. }
            | Stage::Quick { until: Some(until) }
            | Stage::Settling { until }
            | Stage::Off { until } => not_over(until, now),
        }
        if let Some(at) = &mut self.quick_delivered {
            no_older(at, now, longest);
        }
        self.each_wait(|wait| {
            if let Wait::Halt { until } = wait {
                not_over(until, now);
            }
        });
    }
}

/// Everything that decides what the axis does next, but for what it was configured with: of two that differ in that alone, this
/// says nothing. A field that is left out here says so.
impl Hash for AxisCore {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self {
            config: _,
            bounds: _,
            sample,
            standstill,
            // Only what errors say.
            last_seen: _,
            brake,
            sequencer,
            homing,
            jogging,
            power,
            stopping,
            // Drained after each call.
            events: _,
            halted,
            stop_unsent,
            resuming,
            halt_delivered,
            mode,
            mode_change,
            noted_mode,
            manufacturer,
            outgoing,
            sent,
            outgoing_velocity,
            sent_velocity,
            quiet_since,
            homed,
            homed_before_loss,
            answered,
            lost,
            stale_cycles,
            blind_cycles,
            undelivered_cycles,
            // With cycles of one length nothing ever stalls.
            pace: _,
            limit_tells,
            cycle: _,
            expired,
            // A cycle that is computed as a whole comes to the same.
            calm: _,
            sight: _,
            news: _,
        } = self;
        sample.hash(state);
        standstill.hash(state);
        brake.hash(state);
        sequencer.hash(state);
        homing.hash(state);
        jogging.hash(state);
        power.hash(state);
        stopping.hash(state);
        (halted, stop_unsent, resuming, halt_delivered).hash(state);
        (mode, mode_change, noted_mode, manufacturer).hash(state);
        (
            outgoing,
            sent,
            outgoing_velocity,
            sent_velocity,
            quiet_since,
        )
            .hash(state);
        (
            homed,
            homed_before_loss,
            answered,
            lost,
            limit_tells,
            expired,
        )
            .hash(state);
        (stale_cycles, blind_cycles, undelivered_cycles).hash(state);
    }
}
