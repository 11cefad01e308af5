//! What each cycle's inputs mean for the commands that are under way.

use core::time::Duration;

use crate::{
    ds402::{Controlword, Sample, State, Statusword},
    profile_position::{CommandId, Completion, Delivery, Failure, WaitingFor},
};

use super::{
    AxisCore,
    core::cycle,
    power::{Power, RESET_EDGES, RESET_PAUSE, ResetPhase},
    stopping::{Stage, Wait},
    submit::is_down,
};

/// Between its arrival and its rest an axis without a set-point is within so many position windows: more is a motion, and is
/// stopped.
const SETTLES_WITHIN: u32 = 4;

impl AxisCore {
    /// Takes in one cycle with fresh inputs.
    pub(super) fn observe(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let state = sample.state();
        if state.is_fault() && !matches!(self.power, Power::Resetting { .. }) {
            self.observe_fault(now);
        }
        self.observe_mode_change(now, sample);
        self.observe_power(now, sample, delivered);
        self.observe_halt(now, sample, delivered);
        self.observe_stop(now, sample, delivered);
        if state == State::OperationEnabled && self.power.is_driving() {
            self.limit_tells |= !sample.statusword.contains(Statusword::INTERNAL_LIMIT);
            self.observe_mode(now, sample, delivered);
        } else if !self.power.is_driving() && !self.outgoing_starts() {
            self.sequencer.follow_position(sample.position);
        }
    }

    /// A fault ends everything; nothing here resets it. Should the drive go on by itself, the axis is led down. Who waits for a stop
    /// waits for the standstill.
    fn observe_fault(&mut self, now: Duration) {
        let failure = self.fault().unwrap_or(Failure::Fault { code: None });
        self.fail_motions(failure);
        if !matches!(self.stopping.stage, Stage::Settling { .. }) {
            self.stopping.off = false;
            self.stopping.stage = if self.stopping.note_fault(failure) {
                self.settling(now)
            } else {
                Stage::None
            };
        }
        self.fail_others(failure);
        self.leave_operation(Power::Off);
    }

    /// Waiting for the standstill of an axis that is stopped already, as far as this can be.
    pub(super) fn settling(&self, now: Duration) -> Stage {
        Stage::Settling {
            until: now.saturating_add(self.config.deadlines.standstill),
        }
    }

    /// The drive is out of Operation enabled: bits 4 and 8 fall.
    fn leave_operation(&mut self, power: Power) {
        // A reset that is under way goes on to its own end, and so does a disable that somebody waits for.
        if !matches!(
            self.power,
            Power::Resetting { .. } | Power::Disabling { .. }
        ) {
            self.power = power;
        }
        self.halted = false;
        self.halt_delivered = None;
        self.lower_mode_bits();
    }

    fn observe_power(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let state = sample.state();
        match self.power {
            Power::Off => {}
            Power::Holding => {
                if self.is_down_at_rest() {
                    self.power = Power::Off;
                }
            }
            Power::Ready => {
                if state == State::SwitchOnDisabled {
                    self.power = Power::Off;
                }
            }
            Power::Disabling {
                id,
                goal: _,
                deadline,
            } => {
                if state == State::OperationEnabled && !self.is_standing() {
                    // It was not at rest after all, or something has set it in motion since.
                    self.power = Power::Off;
                    self.begin_quick_stop(now);
                    self.stopping.off = true;
                    self.wait_for_stop(now, id);
                } else if is_down(state) && self.is_at_rest() {
                    self.power = if state == State::ReadyToSwitchOn {
                        Power::Ready
                    } else {
                        Power::Off
                    };
                    self.leave_operation(self.power);
                    self.done(id, Ok(Completion::Stopped { state }));
                } else if now >= deadline {
                    let failure = self.timeout(
                        WaitingFor::State(State::SwitchOnDisabled),
                        Delivery::NotSent,
                    );
                    self.power = Power::Off;
                    self.done(id, Err(failure));
                }
            }
            Power::Enabling {
                id,
                deadline,
                was_down,
                shown,
            } => {
                let ordered = delivered && self.sent.contains(Controlword::ENABLE_OPERATION);
                let enabled = state == State::OperationEnabled && was_down;
                // A single word may be wrong: a drive that was sent no more than 07h is not enabled.
                let shown = (enabled && (ordered || shown.is_some())).then(|| shown.unwrap_or(now));
                if shown.is_some_and(|since| now > since) && self.has_seen(now, shown) {
                    self.power = Power::Enabled;
                    self.done(id, Ok(Completion::Done));
                } else if now >= deadline {
                    self.power = Power::Off;
                    self.done(id, Err(self.why_not_enabled(sample)));
                } else {
                    let down = self.is_down_at_rest();
                    if down {
                        self.halted = false;
                        self.halt_delivered = None;
                    }
                    self.power = Power::Enabling {
                        id,
                        deadline,
                        was_down: was_down || down,
                        shown,
                    };
                }
            }
            Power::Enabled => {
                if state != State::OperationEnabled
                    && !state.is_fault()
                    && !self.stopping.is_quick()
                {
                    if self.stopping.is_active() {
                        // Somebody waits for the standstill, which the drive now brings about its own way.
                        let standstill = self.config.deadlines.standstill;
                        self.stopping.begin_quick(now.saturating_add(standstill));
                    } else {
                        self.observe_drop(now, state);
                    }
                }
            }
            Power::Resetting { id, phase, edges } => {
                self.observe_reset(now, id, phase, edges, state, delivered);
            }
        }
    }

    fn why_not_enabled(&self, sample: &Sample) -> Failure {
        if !sample.statusword.contains(Statusword::REMOTE) {
            Failure::LocalControl
        } else if self.config.traits.shows_voltage
            && !sample.statusword.contains(Statusword::VOLTAGE_ENABLED)
        {
            Failure::NoVoltage
        } else if matches!(
            sample.state(),
            State::SwitchOnDisabled | State::ReadyToSwitchOn
        ) {
            Failure::SwitchOnRefused {
                state: sample.state(),
            }
        } else {
            self.timeout(
                WaitingFor::State(State::OperationEnabled),
                Delivery::NotSent,
            )
        }
    }

    /// The drive has left Operation enabled by itself, or by somebody else's stop.
    fn observe_drop(&mut self, now: Duration, state: State) {
        let (failure, power) = if state == State::QuickStopActive {
            (Failure::QUICK_STOPPED, Power::Holding)
        } else {
            (Failure::Disabled { state }, Power::Off)
        };
        self.fail_motions(failure);
        self.fail_others(failure);
        self.stopping.off = false;
        self.stopping.stage = if self.stopping.has_no_waiter() {
            Stage::None
        } else {
            self.settling(now)
        };
        self.leave_operation(power);
    }

    fn observe_reset(
        &mut self,
        now: Duration,
        id: CommandId,
        phase: ResetPhase,
        edges: u8,
        state: State,
        delivered: bool,
    ) {
        let deadlines = self.config.deadlines;
        let low = ResetPhase::Low {
            until: now.saturating_add(RESET_PAUSE),
            reaction: now.saturating_add(deadlines.standstill),
            shown: None,
        };
        let seen = |since| self.has_seen(now, Some(since)) && now > since;
        let spent = edges >= RESET_EDGES;
        let phase = match phase {
            ResetPhase::Low { .. } | ResetPhase::High { .. } if !state.is_fault() => {
                ResetPhase::Gone {
                    since: now,
                    until: now.saturating_add(deadlines.standstill),
                }
            }
            ResetPhase::Low {
                until,
                reaction,
                shown,
            } => {
                let is_fault = state == State::Fault;
                let shown = is_fault.then(|| shown.unwrap_or(now));
                let is_low = delivered && !self.sent.contains(Controlword::FAULT_RESET);
                let stands = self.is_standing();
                if stands && is_low && now >= until && shown.is_some_and(seen) {
                    ResetPhase::High {
                        until: now.saturating_add(deadlines.fault_reset),
                    }
                } else if now >= reaction {
                    let waiting_for = if is_fault {
                        self.standstill_awaited()
                    } else {
                        WaitingFor::State(State::Fault)
                    };
                    let failure = self.timeout(waiting_for, Delivery::NotSent);
                    self.end_reset(id, Err(failure));
                    return;
                } else {
                    ResetPhase::Low {
                        until,
                        reaction,
                        shown,
                    }
                }
            }
            ResetPhase::High { until } if now < until => return,
            ResetPhase::High { .. } | ResetPhase::Gone { .. } if state.is_fault() && spent => {
                let failure = self.fault().unwrap_or(Failure::Fault { code: None });
                self.end_reset(id, Err(failure));
                return;
            }
            ResetPhase::High { .. } => low,
            ResetPhase::Gone { .. } if state.is_fault() => low,
            ResetPhase::Gone { since, until } => {
                if is_down(state) && seen(since) {
                    self.end_reset(id, Ok(Completion::Stopped { state }));
                    return;
                }
                if now >= until {
                    let waiting_for = WaitingFor::State(State::SwitchOnDisabled);
                    let failure = self.timeout(waiting_for, Delivery::NotSent);
                    self.end_reset(id, Err(failure));
                    return;
                }
                ResetPhase::Gone { since, until }
            }
        };
        let edges = edges + u8::from(matches!(phase, ResetPhase::High { .. }));
        self.power = Power::Resetting { id, phase, edges };
    }

    fn end_reset(&mut self, id: CommandId, result: Result<Completion, Failure>) {
        self.power = Power::Off;
        self.leave_operation(Power::Off);
        self.done(id, result);
    }

    fn observe_halt(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        if !self.halted {
            self.stopping.begin_halt();
            // The axis left Operation enabled before it was seen to stand: who waited for the halt waits for that all the same.
            if self.stopping.halts_become_stops() && !self.stopping.is_active() {
                self.stopping.stage = self.settling(now);
            }
            return;
        }
        if delivered && self.sent.contains(Controlword::HALT) {
            self.halt_delivered.get_or_insert(now);
        }
        if self.has_seen_halt(now) {
            let slowing = &mut self.stopping.slowing;
            slowing.observe(now, sample.position, &self.bounds);
        }
        if self.stands_halted(now) && !self.stopping.unanswered {
            // Of a stop under way the halt is the first part alone: no set-point is kept, and who waits is told of the stop.
            if !self.stopping.is_active() {
                self.homing.halted(&mut self.events);
                if !self.stopping.halt_reported {
                    self.stopping.halt_reported = true;
                    self.sequencer.report_halted(&mut self.events);
                }
            }
            let state = sample.state();
            while let Some(id) = self
                .stopping
                .take_waiter(|wait| matches!(wait, Wait::Halt { .. }))
            {
                self.done(id, Ok(Completion::Stopped { state }));
            }
        }
        while self.stopping.slowing.runs_on()
            && let Some(id) = self
                .stopping
                .take_waiter(|wait| matches!(wait, Wait::Halt { .. }))
        {
            self.done(id, Err(Failure::HaltIgnored));
        }
        while let Some(id) = self
            .stopping
            .take_waiter(|w| matches!(w, Wait::Halt { until } if now >= until))
        {
            let failure = self.timeout(self.standstill_awaited(), Delivery::NotSent);
            self.done(id, Err(failure));
        }
        if self.stopping.slowing.runs_on() && self.stopping.unwatched {
            self.begin_quick_stop(now);
        }
    }

    /// Whether bit 8 has brought the axis to rest. With a set-point that may have set it off just before, by what was seen after the
    /// drive has had the time to take bit 8 in.
    pub(super) fn stands_halted(&self, now: Duration) -> bool {
        let seen = self.halt_delivered.map_or(Duration::MAX, |delivered| {
            delivered.saturating_add(self.config.traits.surely_seen())
        });
        now >= seen
            && self.is_standing()
            && (!self.has_motion() || self.standstill.stands_since(now, seen, &self.bounds))
    }

    /// Whether the drive has had the time to take bit 8 in.
    fn has_seen_halt(&self, now: Duration) -> bool {
        self.has_seen(now, self.halt_delivered)
    }

    fn observe_stop(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let state = sample.state();
        match self.stopping.stage {
            Stage::None => {}
            Stage::Halting { until, from } => {
                // An axis that has just come into its window may go past it before it settles.
                let near = self.bounds.position.saturating_mul(SETTLES_WITHIN);
                let distance = |from| self.bounds.distance(from, sample.position);
                let from = from.filter(|&from| distance(from) <= near);
                self.stopping.stage = Stage::Halting { until, from };
                if from.is_some() && self.stands_halted(now) {
                    self.finish_without_quick_stop(state);
                    return;
                }
                // A drive that ignores bit 8 would let the axis run on until the deadline.
                let ignored = self.stopping.slowing.runs_on();
                if ignored || self.stands_halted(now) || now >= until {
                    self.begin_quick_stop(now);
                }
            }
            Stage::Quick { until } => {
                // A drive that stays there although 605Ah said otherwise when it was read is believed in the end.
                let late = until.is_none_or(|until| now >= until);
                let holds = state == State::QuickStopActive
                    && (self.config.quick_stop.stays_in_quick_stop_active() || late);
                let off = matches!(state, State::NotReadyToSwitchOn | State::SwitchOnDisabled);
                let followed = self.has_quick_stopped(now, holds || off, delivered);
                if followed && ((holds && self.is_standing()) || (off && self.is_at_rest())) {
                    self.finish_quick_stop(now, state);
                } else if self.ignores_quick_stop(now, sample, delivered) {
                    self.give_quick_stop_up(now);
                } else if self.stopping.quick_delivered.is_none() && late && until.is_some() {
                    self.give_waiting_up(state);
                }
            }
            Stage::Settling { until } => {
                // A disable under way leads the drive down by itself, and stops the axis if it moves after all.
                let disables = matches!(self.power, Power::Disabling { .. });
                let powered = matches!(state, State::OperationEnabled | State::QuickStopActive);
                if powered && !disables {
                    let standstill = self.config.deadlines.standstill;
                    self.stopping.begin_quick(now.saturating_add(standstill));
                } else if self.is_at_rest_for_good() {
                    self.finish_stop(state);
                } else if now >= until {
                    self.give_waiting_up(state);
                }
            }
            Stage::Off { until } => {
                if is_down(state) {
                    self.leave_operation(self.power);
                    if self.is_at_rest() || self.stopping.has_no_waiter() {
                        self.finish_stop(state);
                    } else {
                        self.stopping.stage = self.settling(now);
                    }
                } else if now >= until {
                    self.stopping.stage = Stage::None;
                    let failure = self.timeout(
                        WaitingFor::State(State::SwitchOnDisabled),
                        Delivery::NotSent,
                    );
                    self.fail_commands(failure);
                }
            }
        }
    }

    /// Waiting stops fail, since the axis does not come to rest. A drive in Operation enabled is commanded on.
    fn give_waiting_up(&mut self, state: State) {
        let failure = self.timeout(self.standstill_awaited(), Delivery::NotSent);
        self.fail_motions(failure);
        self.fail_commands(failure);
        if state == State::OperationEnabled {
            self.stopping.stage = Stage::Quick { until: None };
            return;
        }
        self.stopping.stage = Stage::None;
        self.stopping.off = false;
        self.leave_operation(if state == State::QuickStopActive {
            Power::Holding
        } else {
            Power::Off
        });
    }

    fn finish_quick_stop(&mut self, now: Duration, state: State) {
        let off = core::mem::take(&mut self.stopping.off);
        let failure = if off {
            Failure::Disabled { state }
        } else {
            Failure::QUICK_STOPPED
        };
        self.fail_motions(failure);
        if state == State::QuickStopActive && off {
            self.leave_operation(Power::Off);
            self.stopping.stage = Stage::Off {
                until: now.saturating_add(self.config.deadlines.disable),
            };
        } else {
            self.leave_operation(if state == State::QuickStopActive {
                Power::Holding
            } else {
                Power::Off
            });
            self.finish_stop(state);
        }
    }

    /// The axis stands where it was, and nothing is known that it could move for: bit 8 is as it was before.
    fn finish_without_quick_stop(&mut self, state: State) {
        if self.stopping.lent {
            self.halted = false;
            self.halt_delivered = None;
            self.stopping.begin_halt();
        }
        self.finish_stop(state);
    }

    fn finish_stop(&mut self, state: State) {
        self.stopping.stage = Stage::None;
        while let Some((id, failure)) = self.stopping.next_waiter() {
            self.done(id, failure.map_or(Ok(Completion::Stopped { state }), Err));
        }
    }

    pub(super) fn observe_moves(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let cycle = cycle!(self, now, sample, delivered);
        if self.sequencer.step(&cycle, &mut self.events) {
            // A set-point that the drive took while halted is kept as well: whoever asked for it is told.
            self.stopping.halt_reported = false;
        }
    }

    /// A wait for standstill, with what was seen instead.
    fn standstill_awaited(&self) -> WaitingFor {
        WaitingFor::Standstill(self.last_seen.unrest(&self.bounds))
    }

    pub(super) fn timeout(&self, waiting_for: WaitingFor, delivery: Delivery) -> Failure {
        let statusword = self.sample.map_or(Statusword::empty(), |s| s.statusword);
        Failure::Timeout {
            waiting_for,
            statusword,
            controlword: self.sent,
            delivery,
        }
    }
}
