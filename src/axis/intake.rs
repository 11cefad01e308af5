//! What a cycle brought: inputs, or none, and when a drive counts as lost.

use core::time::Duration;

use crate::{
    ds402::{Controlword, PowerCommand, State},
    profile_position::{Delivery, Failure, LastSeen},
};

use super::{AxisCore, Inputs, power::Power};

/// How far apart the cycles with inputs are: a host that stalls sees as little as one whose frames are lost.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pace {
    /// The last cycle with inputs that was computed as a whole.
    last: (u64, Duration),
    /// From it to the one before.
    gap: Option<Duration>,
    /// For how many cycles nothing was seen before the last one, by the clock; 0 where that is not known.
    pub(super) stalled: u32,
}

impl Pace {
    /// Takes in a cycle with inputs, after so many without.
    fn observe(&mut self, now: Duration, cycle: u64, stale: u32) {
        let (last, at) = core::mem::replace(&mut self.last, (cycle, now));
        let cycles = stale.saturating_add(1);
        // Between others lie those that were not computed as a whole.
        let gap = (cycle.wrapping_sub(last) == u64::from(cycles)).then(|| {
            let time = now.saturating_sub(at);
            // A division is dear.
            if cycles == 1 { time } else { time / cycles }
        });
        self.stalled = match (core::mem::replace(&mut self.gap, gap), gap) {
            (Some(before), Some(gap)) if gap > before && gap / 2 > before => {
                let times = gap.as_micros() / before.as_micros().max(1);
                u32::try_from(times)
                    .unwrap_or(u32::MAX)
                    .saturating_mul(cycles)
            }
            _ => 0,
        };
    }
}

impl AxisCore {
    /// Takes in what a cycle brought. Whether the outputs are known to have been delivered.
    pub(super) fn take_in(&mut self, now: Duration, inputs: Inputs<'_>) -> bool {
        self.cycle = self.cycle.wrapping_add(1);
        if self.sets_off() {
            self.standstill.begin_anew();
        }
        self.sent = self.outgoing;
        self.sent_velocity = self.outgoing_velocity;
        self.stop_unsent = false;
        self.mark_sent(now);
        self.finish_resume(now);
        self.sequencer.disarm();
        let (bytes, delivered) = match inputs {
            Inputs::Fresh(bytes) => (Some(bytes), true),
            Inputs::Answered(bytes) => (Some(bytes), false),
            Inputs::Stale => (None, false),
        };
        let sample = bytes
            .and_then(|bytes| self.config.fields.sample(bytes, self.noted_mode))
            .filter(|sample| sample.state() != State::Unknown);
        let delivered = delivered && sample.is_some();
        self.answered = sample.is_some();
        if self.answered {
            self.blind_cycles = self.stale_cycles;
            self.pace.observe(now, self.cycle, self.stale_cycles);
        }
        self.stale_cycles = if self.answered {
            0
        } else {
            self.stale_cycles.saturating_add(1)
        };
        self.undelivered_cycles = if delivered {
            0
        } else {
            self.undelivered_cycles.saturating_add(1)
        };
        if delivered {
            self.lost = false;
        }
        self.observe_quiet(now, delivered);
        if let Some(sample) = sample {
            if self.begins_to_stop(now, sample.state()) {
                self.standstill.begin_anew();
            }
            if self.stopping.unanswered && self.halt_delivered.is_some() {
                self.stopping.unanswered = self.sample == Some(sample);
            }
            self.sample = Some(sample);
            self.standstill
                .observe(now, sample.position, sample.velocity, &self.bounds);
            if self.awaits_standstill() {
                self.last_seen.observe(now, &sample, &self.bounds);
            } else {
                self.last_seen = LastSeen::default();
            }
            self.brake.observe(
                now,
                sample.state(),
                self.standstill.is_standing(),
                !self.power.leads_up(),
                &self.config.traits,
                self.config.deadlines.standstill,
            );
            if self
                .sent
                .contains(PowerCommand::EnableOperation.controlword())
            {
                self.brake.may_be_enabled();
            }
            self.observe(now, &sample, delivered);
        }
        let loss = self.config.loss;
        if !self.lost
            && (self.stale_cycles >= loss.stale_cycles
                || self.undelivered_cycles >= loss.undelivered_cycles)
        {
            self.lose(now);
        } else if self.lost && self.stale_cycles == loss.stale_cycles {
            // It answered until now: stops were to end by what it shows.
            self.fail_commands(Failure::BusLost {
                delivery: Delivery::NotSent,
            });
        }
        delivered
    }

    /// Whether anybody waits for the axis to stand.
    fn awaits_standstill(&self) -> bool {
        self.stopping.is_active()
            || !self.stopping.has_no_waiter()
            || self.jogging.is_released()
            || matches!(self.power, Power::Resetting { .. })
    }

    /// Whether the drive may have begun just now to stop an axis that was under way, or that it may set going: that it stood before says
    /// nothing then. One that stands halted has come to rest from that, for a quick stop of ours; what the drive does by itself is its own affair.
    fn begins_to_stop(&self, now: Duration, state: State) -> bool {
        let Some(before) = &self.sample else {
            return false;
        };
        let leaves = before.state() == State::OperationEnabled && state != before.state();
        let enters = state == State::QuickStopActive && state != before.state();
        let obeys = self.stopping.is_quick() && !state.is_fault();
        (leaves || enters)
            && !(self.is_standing() && (!self.has_motion() || (obeys && self.stands_halted(now))))
    }

    /// Whether a motion may begin with the outputs composed last.
    fn sets_off(&self) -> bool {
        let rises = self.outgoing.difference(self.sent);
        let falls = self.sent.difference(self.outgoing);
        rises.contains(Controlword::NEW_SET_POINT)
            // Without a set-point nothing goes on by it.
            || (falls.contains(Controlword::HALT) && self.has_motion())
            || (self.sent_velocity == 0 && self.outgoing_velocity != 0)
    }

    /// The drive does not answer, or whether it receives its outputs is not known: everything ends, and what still reaches it is a
    /// quick stop. Of one that answers, those who wait for a stop wait for what it shows.
    pub(super) fn lose(&mut self, now: Duration) {
        self.lost = true;
        self.homed_before_loss = self.homed;
        self.homed = false;
        let driven = self.power.is_driving();
        if self.has_motion() {
            // Since it was seen last its drive may have set off.
            self.standstill.begin_anew();
        }
        let failure = self.failure_of_loss();
        self.fail_motions(failure);
        if self.answered {
            self.fail_commands_but_stops(failure);
        } else {
            self.fail_commands(failure);
        }
        if driven && !self.begin_quick_stop(now) {
            self.power = Power::Off;
        }
    }

    /// What is said of commands of a drive that counts as lost.
    pub(super) fn failure_of_loss(&self) -> Failure {
        if self.answered {
            Failure::Undelivered {
                delivery: Delivery::NotSent,
                counter: None,
            }
        } else {
            Failure::BusLost {
                delivery: Delivery::NotSent,
            }
        }
    }
}
