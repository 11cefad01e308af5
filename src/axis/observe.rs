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

impl AxisCore {
    /// Takes in one cycle with fresh inputs.
    pub(super) fn observe(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let state = sample.state();
        if state.is_fault() && !matches!(self.power, Power::Resetting { .. }) {
            self.observe_fault(state);
        }
        if state == State::Fault {
            self.halted = false;
            self.halt_delivered = None;
            self.lower_mode_bits();
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

    /// A fault ends everything; nothing here resets it.
    fn observe_fault(&mut self, state: State) {
        let failure = self.fault().unwrap_or(Failure::Fault { code: None });
        self.fail_motions(|_| failure);
        self.fail_commands(failure);
        self.stopping.stage = Stage::None;
        self.stopping.off = false;
        if state == State::Fault {
            self.leave_operation(Power::Off);
        }
    }

    /// The drive is out of Operation enabled: bits 4 and 8 fall.
    fn leave_operation(&mut self, power: Power) {
        self.power = power;
        self.halted = false;
        self.halt_delivered = None;
        self.lower_mode_bits();
    }

    fn observe_power(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let state = sample.state();
        match self.power {
            Power::Off | Power::Holding => {}
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
                if is_down(state) {
                    self.leave_operation(if state == State::ReadyToSwitchOn {
                        Power::Ready
                    } else {
                        Power::Off
                    });
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
            } => {
                if state == State::OperationEnabled && was_down {
                    self.power = Power::Enabled;
                    self.done(id, Ok(Completion::Done));
                } else if now >= deadline {
                    self.power = Power::Off;
                    self.done(id, Err(self.why_not_enabled(sample)));
                } else if state != State::OperationEnabled {
                    self.halted = false;
                    self.halt_delivered = None;
                    self.power = Power::Enabling {
                        id,
                        deadline,
                        was_down: true,
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
                        self.stopping.stage = Stage::Quick {
                            until: Some(now + self.config.deadlines.standstill),
                        };
                    } else {
                        self.observe_drop(state);
                    }
                }
            }
            Power::Resetting { id, phase, edges } => {
                if state.is_fault() {
                    self.observe_reset(now, id, phase, edges, state, delivered);
                } else {
                    self.leave_operation(Power::Off);
                    self.done(id, Ok(Completion::Stopped { state }));
                }
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
    fn observe_drop(&mut self, state: State) {
        let (failure, power) = if state == State::QuickStopActive {
            (Failure::QuickStopped, Power::Holding)
        } else {
            (Failure::Disabled { state }, Power::Off)
        };
        self.fail_motions(|_| failure);
        while let Some(id) = self.stopping.take_waiter(|wait| wait == Wait::Stop) {
            self.done(id, Ok(Completion::Stopped { state }));
        }
        self.fail_commands(failure);
        self.stopping.stage = Stage::None;
        self.stopping.off = false;
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
        let phase = match phase {
            ResetPhase::Low { until, reaction } => {
                if state != State::Fault && now >= reaction {
                    let failure = self.timeout(WaitingFor::State(State::Fault), Delivery::NotSent);
                    self.power = Power::Off;
                    self.done(id, Err(failure));
                    return;
                }
                let low = delivered && !self.sent.contains(Controlword::FAULT_RESET);
                if state != State::Fault || !low || now < until {
                    return;
                }
                ResetPhase::High {
                    until: now + self.config.deadlines.fault_reset,
                }
            }
            ResetPhase::High { until } => {
                if now < until {
                    return;
                }
                if edges >= RESET_EDGES {
                    let failure = self.fault().unwrap_or(Failure::Fault { code: None });
                    self.leave_operation(Power::Off);
                    self.done(id, Err(failure));
                    return;
                }
                ResetPhase::Low {
                    until: now + RESET_PAUSE,
                    reaction: now + self.config.deadlines.standstill,
                }
            }
        };
        let edges = edges + u8::from(matches!(phase, ResetPhase::High { .. }));
        self.power = Power::Resetting { id, phase, edges };
    }

    fn observe_halt(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        if !self.halted {
            self.stopping.begin_halt();
            // The axis left Operation enabled before it was seen to stand: its stop is over all the same.
            let state = sample.state();
            while let Some(id) = self
                .stopping
                .take_waiter(|wait| matches!(wait, Wait::Halt { .. }))
            {
                self.done(id, Ok(Completion::Stopped { state }));
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
        if self.stands_halted(now, sample) {
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
            let failure = self.timeout(WaitingFor::Standstill, Delivery::NotSent);
            self.done(id, Err(failure));
        }
        if self.stopping.slowing.runs_on() && self.stopping.unwatched {
            self.begin_quick_stop(now);
        }
    }

    /// Whether bit 8 has brought the axis to rest: by bit 10 and the velocity, or by a position that stays, both seen
    /// only after the drive has had the time to take bit 8 in.
    pub(super) fn stands_halted(&self, now: Duration, sample: &Sample) -> bool {
        self.has_seen_halt(now)
            && sample.statusword.contains(Statusword::TARGET_REACHED)
            && self.is_standing(now)
    }

    /// Whether the drive has had the time to take bit 8 in.
    fn has_seen_halt(&self, now: Duration) -> bool {
        self.has_seen(now, self.halt_delivered)
    }

    fn observe_stop(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let state = sample.state();
        match self.stopping.stage {
            Stage::None => {}
            Stage::Halting { until } => {
                // A drive that ignores bit 8 would let the axis run on until the deadline.
                let ignored = self.stopping.slowing.runs_on();
                if ignored || self.stands_halted(now, sample) || now >= until {
                    self.begin_quick_stop(now);
                }
            }
            Stage::Quick { until } => {
                // A drive that stays there although 605Ah said otherwise when it was read is believed in the end.
                let late = until.is_none_or(|until| now >= until);
                let holds = state == State::QuickStopActive
                    && (self.config.quick_stop.stays_in_quick_stop_active() || late)
                    && self.is_standing(now);
                if holds || matches!(state, State::NotReadyToSwitchOn | State::SwitchOnDisabled) {
                    self.finish_quick_stop(now, state);
                } else if self.ignores_quick_stop(now, sample, delivered) {
                    self.give_quick_stop_up(now);
                } else if self.stopping.quick_delivered.is_none()
                    && until.is_some_and(|until| now >= until)
                {
                    // It is commanded on; those who wait are told that it has not worked.
                    self.stopping.stage = Stage::Quick { until: None };
                    let failure = self.timeout(WaitingFor::Standstill, Delivery::Accepted);
                    self.fail_motions(|_| failure);
                    self.fail_commands(failure);
                }
            }
            Stage::Off { until } => {
                if is_down(state) {
                    self.leave_operation(self.power);
                    self.finish_stop(state);
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

    fn finish_quick_stop(&mut self, now: Duration, state: State) {
        let off = core::mem::take(&mut self.stopping.off);
        let failure = if off {
            Failure::Disabled { state }
        } else {
            Failure::QuickStopped
        };
        self.fail_motions(|_| failure);
        if state == State::QuickStopActive && off {
            self.leave_operation(Power::Off);
            self.stopping.stage = Stage::Off {
                until: now + self.config.deadlines.disable,
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

    fn finish_stop(&mut self, state: State) {
        self.stopping.stage = Stage::None;
        while let Some(id) = self.stopping.pop_waiter() {
            self.done(id, Ok(Completion::Stopped { state }));
        }
    }

    pub(super) fn observe_moves(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let cycle = cycle!(self, now, sample, delivered);
        if self.sequencer.step(&cycle, &mut self.events) {
            // A set-point that the drive took while halted is kept as well: whoever asked for it is told.
            self.stopping.halt_reported = false;
        }
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
