//! The machines of an axis, and the one place where what one of them comes to changes another: power, stopping, the modes, the outputs.
//!
//! [`Machines::step`] is one cycle with inputs. Each machine says what came of it; the `apply_…` functions carry that out.

use core::time::Duration;

use crate::{
    Failure,
    ds402::{Controlword, Mode, ModeBits, PowerCommand, State, Statusword},
    profile_position::{
        Bounds, CommandId, Completion, Cycle, Delivery, Event, Events, Evidence, LastSeen,
        MoveCommand, Quiet, Rules, WaitingFor,
    },
    timer::{Due, Elapsed, Timer},
};

use super::{
    CoreConfig,
    brake::HoldingBrake,
    config::Referencing,
    mode::{ModeStepped, Modes},
    observed::{Aside, Observed},
    outputs::{ComposedWord, Outgoing, Outputs},
    power::{Power, PowerStep},
    power_guard::{self, PowerGuard},
    stopping::{Halt, StopPhase, StopStep, Stopping, Wait, quarter, stopped},
};

/// What the machines get in a cycle, or with a command.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step<'a> {
    pub now: Duration,
    /// Since the machines had the last one.
    pub elapsed: Elapsed,
    /// With a command: how long that is ago. It is part of what the next cycle has for `elapsed`.
    pub ahead: Elapsed,
    pub state: State,
    pub statusword: Statusword,
    /// 6061h.
    pub mode: Mode,
    pub evidence: Evidence,
    /// 603Fh, where it is mapped and not 0.
    pub error_code: Option<u16>,
    /// Whether what was sent last is known to have been delivered.
    pub delivered: bool,
    pub sent: Outgoing,
    /// Two cycles of the drive.
    pub seen: Timer,
    pub guard: PowerGuard,
    pub power: Power,
    pub config: &'a CoreConfig,
    pub bounds: &'a Bounds,
    pub last_seen: &'a LastSeen,
}

impl<'a> Step<'a> {
    pub fn new(
        now: Duration,
        elapsed: Elapsed,
        ahead: Elapsed,
        config: &'a CoreConfig,
        bounds: &'a Bounds,
        observed: &'a Observed,
        machines: &Machines,
    ) -> Self {
        let code = observed.sample.and_then(|sample| sample.error_code);
        Self {
            now,
            elapsed,
            ahead,
            state: observed.state(),
            statusword: observed.statusword(),
            mode: observed.mode(),
            evidence: observed.evidence(),
            error_code: code.filter(|&code| code != 0),
            delivered: observed.link.delivered,
            sent: machines.outputs.sent,
            seen: Timer::new(config.traits.surely_seen()),
            guard: machines.guard,
            power: machines.power,
            config,
            bounds,
            last_seen: observed.last_seen(),
        }
    }

    pub const fn position(&self) -> i32 {
        self.evidence.position
    }

    pub const fn stands(&self) -> bool {
        self.evidence.stands()
    }

    pub const fn sends(&self, bits: Controlword) -> bool {
        self.sent.word.contains(bits)
    }

    pub const fn sends_enable(&self) -> bool {
        self.sends(Controlword::ENABLE_OPERATION)
    }

    /// Whether the drive is in Operation enabled, and is commanded so.
    pub fn is_enabled_by_us(&self) -> bool {
        self.state == State::OperationEnabled && self.sends_enable() && self.delivered
    }

    pub const fn sends_reset(&self) -> bool {
        self.sends(Controlword::FAULT_RESET)
    }

    pub const fn sends_halt(&self) -> bool {
        self.sends(Controlword::HALT)
    }

    pub const fn sends_quick_stop(&self) -> bool {
        !self.sends(Controlword::BIT_QUICK_STOP)
    }

    pub const fn sends_mode_bits(&self) -> bool {
        self.sent.word.word().intersects(ModeBits::MASK) || self.sent.velocity != 0
    }

    /// Whether the axis has come to rest from all that its drive has done, or may have done.
    pub const fn is_at_rest(&self) -> bool {
        self.stands() || self.guard.is_free()
    }

    /// The same; and what was sent last keeps the drive from following a set-point, unless the axis stays enabled.
    pub const fn is_at_rest_for_good(&self) -> bool {
        self.is_at_rest() && (!self.sends_enable() || self.power.is_driving())
    }

    /// Whether the drive has surely shown that its power stage is off, and the axis rests.
    pub const fn is_down_at_rest(&self) -> bool {
        self.guard.is_down() && self.is_at_rest()
    }

    pub const fn disables(&self) -> bool {
        matches!(self.power, Power::Disabling { .. })
    }

    /// Whether the drive has no supply, where it shows that.
    pub const fn lacks_voltage(&self) -> bool {
        self.config.traits.shows_voltage && !self.statusword.contains(Statusword::VOLTAGE_ENABLED)
    }

    /// A wait for standstill, with what was seen instead.
    pub fn standstill(&self) -> WaitingFor {
        WaitingFor::Standstill(self.last_seen.unrest(self.bounds))
    }

    pub const fn timeout(&self, waiting_for: WaitingFor, delivery: Delivery) -> Failure {
        Failure::Timeout {
            waiting_for,
            statusword: self.statusword,
            controlword: self.sent.word.word(),
            delivery,
        }
    }

    /// The fault of a drive that shows one.
    pub const fn fault(&self) -> Failure {
        Failure::Fault {
            code: self.error_code,
            following_error: self.statusword.shows_following_error(self.mode),
        }
    }

    /// The fault, if the drive shows one.
    pub fn shown_fault(&self) -> Option<Failure> {
        self.state.is_fault().then(|| self.fault())
    }

    /// A time that begins now.
    pub const fn timer(&self, time: Duration) -> Timer {
        Timer::new(time).later(self.ahead)
    }

    /// How long the axis may take to come to rest.
    pub const fn deadline(&self) -> Timer {
        self.timer(self.config.deadlines.standstill)
    }
}

/// The machines of an axis.
#[derive(Debug, Clone, Hash)]
pub(super) struct Machines {
    pub guard: PowerGuard,
    pub brake: HoldingBrake,
    pub power: Power,
    pub stopping: Stopping,
    pub modes: Modes,
    pub outputs: Outputs,
    /// A resume whose frame has not been sent.
    pub resuming: Option<Resuming>,
    /// The state in the last cycle.
    state: State,
    /// Rest is to be counted anew.
    pub counts_rest_anew: Aside<bool>,
    /// Why the axis is not driven any more, without having been stopped by a command: until somebody takes it.
    pub fallen: Aside<Option<Failure>>,
    pub events: Aside<Events>,
}

/// A resume that is not sent yet.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Resuming {
    pub id: CommandId,
    /// Bit 8 falls with it.
    pub falls: bool,
}

impl Machines {
    pub fn new(config: &CoreConfig) -> Self {
        Self {
            guard: PowerGuard::new(),
            brake: HoldingBrake::new(config.brake.as_ref()),
            power: Power::Off,
            stopping: Stopping::new(),
            modes: Modes::new(config),
            outputs: Outputs::new(),
            resuming: None,
            state: State::NotReadyToSwitchOn,
            counts_rest_anew: Aside(false),
            fallen: Aside(None),
            events: Aside(Events::new()),
        }
    }

    /// One cycle with inputs. `released`: whether its brake is open, by its feedback.
    pub fn step(&mut self, step: Step<'_>, released: Option<bool>) {
        let mut step = step;
        let before = core::mem::replace(&mut self.state, step.state);
        self.note_state(&step, before);
        self.doubt_rest(&mut step);
        self.step_guard(&mut step);
        self.modes.pass_time(&step);
        if step.state.is_fault() {
            self.apply_fault(&step, before);
        }
        let rests = self.rests_for_mode(&step);
        let events = &mut self.events.0;
        self.modes.step_change(&step, rests, events);
        let stepped = self.power.step(&step, &self.brake);
        self.apply_power(&step, stepped);
        step.power = self.power;
        let stepped = self.stopping.step_halt(&step, self.modes.has_motion());
        self.apply_halt(&step, stepped);
        self.doubt_rest(&mut step);
        let stepped = self.stopping.step(&step);
        self.apply_stop(&step, stepped);
        self.step_modes(&step);
        self.step_hold();
        if self.brake.is_there() {
            self.doubt_rest(&mut step);
            (step.power, step.guard) = (self.power, self.guard);
            self.step_brake(&step, released);
        }
        // Of the time until now the axis was halted.
        self.stopping.note_release(&step);
    }

    /// Where the drive begins to stop an axis that was under way, or that it may set going, that it stood before says nothing. One that
    /// our stop has brought to rest before its quick stop stands.
    fn note_state(&mut self, step: &Step<'_>, before: State) {
        let leaves = before == State::OperationEnabled && step.state != before;
        let stops = step.state == State::QuickStopActive && step.state != before;
        let stands_halted = self.stopping.is_quick() && self.stopping.stands_halted(step);
        let stands = step.stands() && !self.modes.has_motion() && !stops;
        if (leaves || stops) && !stands && !stands_halted || self.begins_to_hang(step, before) {
            self.counts_rest_anew = Aside(true);
        }
    }

    /// Whether an axis that loses its power is to stay on its brake.
    const fn begins_to_hang(&self, step: &Step<'_>, before: State) -> bool {
        self.brake.is_there() && before.holds_axis() && !step.state.holds_axis()
    }

    /// Where rest is to be counted anew, the axis does not stand.
    fn doubt_rest(&self, step: &mut Step<'_>) {
        if self.counts_rest_anew.0 {
            step.evidence.rest = None;
        }
    }

    fn step_guard(&mut self, step: &mut Step<'_>) {
        let shown = power_guard::Shown {
            state: step.state,
            stands: step.stands(),
            enables: step.sends_enable() || !step.delivered,
            leading_down: !self.power.leads_up(),
        };
        let patience = step.config.deadlines.standstill;
        self.guard.update(shown, step.elapsed, step.seen, patience);
        step.guard = self.guard;
    }

    fn step_brake(&mut self, step: &Step<'_>, released: Option<bool>) {
        let Some(from) = self.brake.update(step, released) else {
            return;
        };
        let failure = Failure::AxisSlipped {
            from,
            to: step.position(),
        };
        if !self.power.is_resetting() {
            self.fail_commands(step, failure);
        }
        self.fail_stops(failure);
    }

    /// A fault ends everything; nothing here resets it. Should the drive go on by itself, the axis is led down. Who waited for a stop
    /// before waits for the standstill.
    fn apply_fault(&mut self, step: &Step<'_>, before: State) {
        let failure = step.fault();
        if self.power.is_driving() {
            self.fallen = Aside(Some(failure));
        }
        if let Power::Disabling { id, .. } = self.power {
            self.power = Power::Off;
            self.wait_for_stop(id);
        }
        if !before.is_fault() {
            self.stopping.fault(failure, step);
        }
        // A reset that is under way goes on to its own end, also where another state was shown between two faults.
        if !self.power.is_resetting() {
            self.fail_motions(failure);
            self.fail_commands(step, failure);
            self.fail_halts(failure);
            self.leave_operation(step, Power::Off);
        }
    }

    fn apply_power(&mut self, step: &Step<'_>, stepped: PowerStep) {
        match stepped {
            PowerStep::Nothing => self.drop_what_is_left(step),
            PowerStep::Done(id, result) => {
                self.done(id, result);
                if !self.power.is_driving() {
                    self.leave_operation(step, self.power);
                }
            }
            PowerStep::StopFirst(id) => {
                self.begin_quick_stop(step);
                self.stopping.off = true;
                self.wait_for_stop(id);
            }
            // The stop that is under way goes on, in the drive's own way.
            PowerStep::Dropped if self.stopping.is_quick() || self.stopping.is_switching_off() => {}
            PowerStep::Dropped if self.stopping.is_active() => {
                let left = self.stopping.left(step);
                self.stopping.begin_quick(left);
            }
            PowerStep::Dropped => self.apply_drop(step),
        }
    }

    /// What was left of a motion for which nobody waits any more: its drive is down, and has dropped it.
    fn drop_what_is_left(&mut self, step: &Step<'_>) {
        let left = self.stopping.halt.is_on || self.modes.has_motion();
        let is_off = matches!(self.power, Power::Off);
        if is_off && left && step.is_down_at_rest() && !self.stopping.awaits_standstill() {
            self.leave_operation(step, Power::Off);
        }
        if matches!(self.power, Power::Enabling { was_down: true, .. }) {
            self.stopping.halt = Halt::OFF;
        }
    }

    /// The drive has left Operation enabled by itself, or by somebody else's stop.
    fn apply_drop(&mut self, step: &Step<'_>) {
        let state = step.state;
        let (failure, power) = if state == State::QuickStopActive {
            (Failure::QUICK_STOPPED, Power::Holding)
        } else {
            (Failure::Disabled { state }, Power::Off)
        };
        self.fallen = Aside(Some(failure));
        self.fail_motions(failure);
        self.fail_commands(step, failure);
        self.fail_halts(failure);
        self.stopping.off = false;
        self.leave_operation(step, power);
    }

    fn apply_halt(&mut self, step: &Step<'_>, stepped: StopStep) {
        match stepped {
            StopStep::HaltSeen => self.counts_rest_anew = Aside(true),
            // Of a stop under way the halt is the first part alone: no set-point is kept, and who waits gets the stop as the reason.
            StopStep::Halted if !self.stopping.is_active() => {
                let events = &mut self.events.0;
                self.modes.homing.halted(events);
                self.modes.sequencer.report_halted(events);
                if let Some(id) = self.stopping.take_hold() {
                    self.replace_kept(step, id);
                }
                self.end_halts(stopped(step.state));
            }
            StopStep::Halted => self.end_halts(stopped(step.state)),
            StopStep::Quick => {
                self.begin_quick_stop(step);
            }
            _ => {}
        }
        if self.stopping.ignores_halt() {
            self.end_halts(Err(Failure::HaltIgnored));
        }
        if !self.stopping.halt.is_on
            && self.stopping.halts_become_stops()
            && !self.stopping.is_active()
        {
            // The axis left Operation enabled before it was seen to stand.
            self.stopping.phase = StopPhase::Settling {
                left: step.deadline(),
            };
        }
        while let Some(id) = self.stopping.pass_time_of_waiters(step) {
            let failure = step.timeout(step.standstill(), Delivery::NotSent);
            self.done(id, Err(failure));
        }
    }

    /// In place of what the drive keeps: a set-point to where the axis stands. Where it keeps none, bit 8 falls.
    fn replace_kept(&mut self, step: &Step<'_>, id: CommandId) {
        let sequencer = &mut self.modes.sequencer;
        if sequencer.needs_stop() {
            self.done(id, Err(Failure::NeedsStop));
        } else if sequencer.has_set_point() {
            self.stopping.halt.holds = Some(id);
            let command = MoveCommand::to_stay_at(step.position(), sequencer.parameters());
            sequencer.submit(id, command, &mut self.events.0);
        } else {
            self.release_halt(id);
        }
    }

    /// One cycle of a move that a torque ends, with torque actual value 6077h: it is halted then, and the axis is to be held.
    pub fn step_contact(&mut self, step: &Step<'_>, torque: i16) {
        if !self.is_stepped_in(step.state) || step.mode != Mode::ProfilePosition {
            return;
        }
        let cycle = self.cycle(step);
        let Some(id) = self.modes.sequencer.take_contact(&cycle, torque) else {
            return;
        };
        let position = step.position();
        self.events.0.push(id, Event::Contact { position, torque });
        self.begin_halt(step);
        self.stopping.halt.unwatched = true;
        self.wait_for_halt(step, id, true);
    }

    /// Where the drive has taken the set-point that keeps the axis where it stands, bit 8 falls.
    fn step_hold(&mut self) {
        let holds = self.stopping.halt.holds;
        if let Some(id) = holds
            && self.modes.sequencer.is_held(id)
        {
            // It is there, whatever presses on it.
            self.modes.sequencer.tell(id);
            self.release_halt(id);
        } else if holds.is_some_and(|id| !self.modes.sequencer.knows(id)) {
            // It has ended otherwise.
            self.stopping.halt.holds = None;
        }
    }

    /// Bit 8 falls with the next frame.
    const fn release_halt(&mut self, id: CommandId) {
        (self.stopping.halt.is_on, self.stopping.halt.holds) = (false, None);
        self.resuming = Some(Resuming { id, falls: true });
    }

    fn apply_stop(&mut self, step: &Step<'_>, stepped: StopStep) {
        let state = step.state;
        match stepped {
            StopStep::Quick => {
                // The rest of its time.
                self.begin_quick_stop(step);
            }
            StopStep::OverHalted => {
                if self.stopping.halt.lent {
                    self.stopping.halt = Halt::OFF;
                }
                self.finish_stop(stopped(state));
            }
            StopStep::QuickStopped => {
                let off = core::mem::take(&mut self.stopping.off);
                let holds = state == State::QuickStopActive;
                let failure = if off {
                    Failure::Disabled { state }
                } else {
                    Failure::QUICK_STOPPED
                };
                self.fail_motions(failure);
                self.leave_operation(
                    step,
                    if holds && !off {
                        Power::Holding
                    } else {
                        Power::Off
                    },
                );
                if holds && off {
                    self.stopping.phase = StopPhase::Off {
                        left: step.timer(step.config.deadlines.disable),
                    };
                } else {
                    self.finish_stop(stopped(state));
                }
            }
            StopStep::GiveUp(failure) => {
                self.fail_motions(failure);
                self.fail_commands(step, failure);
                self.finish_stop(Err(failure));
                self.power = Power::Off;
                self.stopping.halt = Halt::OFF;
                if failure != Failure::QuickStopIgnored {
                    self.guard.give_up();
                }
                self.stopping.phase = StopPhase::Off {
                    left: step.timer(step.config.deadlines.disable),
                };
            }
            StopStep::Over => {
                if self.stopping.is_switching_off() {
                    self.leave_operation(step, self.power);
                }
                self.finish_stop(stopped(state));
            }
            StopStep::Fail(failure) => {
                self.fail_motions(failure);
                if !self.power.is_resetting() {
                    self.fail_commands(step, failure);
                }
                self.finish_stop(Err(failure));
                self.leave_operation(step, Power::Off);
            }
            StopStep::StopAgain => {
                self.cancel_enabling(Failure::QUICK_STOPPED);
                self.stopping.off |= !matches!(self.power, Power::Holding);
                let left = self.stopping.left(step);
                self.stopping.begin_quick(left);
            }
            StopStep::Nothing | StopStep::Halted | StopStep::HaltSeen => {}
        }
    }

    /// The machine of the active mode goes on in Operation enabled; else 607Ah follows the axis.
    fn step_modes(&mut self, step: &Step<'_>) {
        let enabled = step.state == State::OperationEnabled && self.power.is_driving();
        if !enabled {
            if !self.power.is_driving() && !self.outputs.starts() {
                self.modes.sequencer.follow_position(step.position());
            }
            return;
        }
        if self.stopping.is_quick() {
            return;
        }
        let cycle = self.cycle(step);
        let events = &mut self.events.0;
        match self.modes.step(&cycle, step.mode, events) {
            ModeStepped::Nothing => {}
            ModeStepped::CountRestAnew => self.counts_rest_anew = Aside(true),
            ModeStepped::QuickStop => {
                self.fallen = Aside(Some(Failure::QUICK_STOPPED));
                self.begin_quick_stop(step);
            }
            ModeStepped::Stop => {
                self.fallen = Aside(Some(Failure::QUICK_STOPPED));
                self.begin_stop(step, Failure::QUICK_STOPPED);
            }
        }
    }

    /// Whether the machine of the active mode is stepped where its drive shows this state, and the mode.
    pub fn is_stepped_in(&self, state: State) -> bool {
        state == State::OperationEnabled && self.power.is_driving() && !self.stopping.is_quick()
    }

    /// Where the next position tells nothing, as seen from this one. `in_mode`: the machine of the active mode is stepped.
    pub fn quiet(&self, in_mode: bool, position: i32, bounds: &Bounds) -> Quiet {
        if self.power.is_driving() {
            self.modes.quiet(in_mode, position, bounds)
        } else {
            Quiet::NOWHERE
        }
    }

    pub fn awaits_standstill(&self) -> bool {
        self.stopping.awaits_standstill()
            || self.modes.jogging.is_released()
            || self.power.is_resetting()
    }

    /// Whether something is in the outputs, or was asked for, that no frame has brought.
    pub fn has_unsent(&self) -> bool {
        !self.outputs.is_sent() || self.resuming.is_some() || self.modes.jogging.is_unsent()
    }

    /// The drive begins again: nothing is commanded. One that may still be moving is held, since switching off would let it coast.
    #[cfg(feature = "std")]
    pub fn restart(&mut self, config: &CoreConfig, state: State, is_anew: bool) {
        self.power = if state.holds_axis() {
            Power::Holding
        } else {
            Power::Off
        };
        self.brake = HoldingBrake::new(config.brake.as_ref());
        self.stopping = Stopping::new();
        self.modes.restart(config, is_anew);
        self.outputs.restart();
    }

    /// Nothing is known of the drive.
    #[cfg(feature = "std")]
    pub fn forget_drive(&mut self) {
        self.guard = PowerGuard::new();
        self.state = State::NotReadyToSwitchOn;
    }

    /// What the machine of a mode gets.
    pub fn cycle<'a>(&self, step: &Step<'a>) -> Cycle<'a> {
        Cycle {
            now: step.now,
            elapsed: step.elapsed,
            evidence: step.evidence,
            delivered: step.delivered,
            halted: self.stopping.is_halted() || step.sends_halt(),
            statusword: step.statusword,
            controlword: step.sent.word.word(),
            last_seen: step.last_seen,
            rules: self.rules(step),
        }
    }

    pub fn rules<'a>(&self, step: &Step<'a>) -> Rules<'a> {
        let config = step.config;
        Rules {
            traits: &config.traits,
            bounds: step.bounds,
            limits: &config.limits,
            referenced: self.is_referenced(config),
            acknowledge: config.deadlines.acknowledge,
            begin: config.deadlines.begin,
            standstill: config.deadlines.standstill,
            ahead: step.ahead,
        }
    }

    /// Whether the axis' positions are known to mean what the program means.
    pub fn is_referenced(&self, config: &CoreConfig) -> bool {
        self.modes.is_homed() || config.referencing == Referencing::AbsoluteEncoder
    }

    /// Whether the axis rests for another mode: a halt may take back a resume that has not gone out yet.
    pub fn rests_for_mode(&self, step: &Step<'_>) -> bool {
        step.is_at_rest() && self.resuming.is_none() && !self.stopping.halt.is_on
    }

    /// The outputs composed last have been sent. Whether a motion may have begun with them.
    pub fn mark_sent(&mut self, rules: &Rules<'_>) {
        if self.outputs.set_off(self.modes.has_motion()) {
            self.counts_rest_anew = Aside(true);
        }
        self.outputs.mark_sent();
        self.modes.mark_sent(&mut self.events.0);
        if let Some(Resuming { id, falls }) = self.resuming.take() {
            if falls {
                self.stopping.release();
                self.modes.sequencer.resumed(rules);
                self.finish_stop(Err(Failure::Superseded));
            }
            self.done(id, Ok(Completion::Done));
        }
        self.modes.sequencer.disarm();
    }

    /// The one composer of controlwords.
    pub fn compose(&mut self, state: State, stands: bool, lacks_voltage: bool) {
        let command = if self.stopping.is_quick() {
            PowerCommand::QuickStop
        } else if self.stopping.is_switching_off()
            && state == State::OperationEnabled
            && !(stands && self.keeps_power())
        {
            // A drive that ignores quick stop, or has stopped the axis by it. In every other state it may still brake the axis.
            PowerCommand::DisableVoltage
        } else {
            let command = self.power.command(state, lacks_voltage);
            if self.power.leads_down(command) && (self.guard.holds(stands) || self.keeps_power()) {
                PowerCommand::QuickStop
            } else {
                command
            }
        };
        let outputs = &self.outputs;
        let driving = self.power.is_driving();
        let word = if command == PowerCommand::QuickStop && !driving && !stands {
            // During quick stop they stay as they were sent last.
            ComposedWord::after(command, outputs.sent.word, outputs.manufacturer)
        } else {
            // A drive that is late in its transitions would go on for a moment if bit 8 fell before it is out of Operation enabled, where a
            // fault reaction may lead, too.
            let obeys = matches!(state, State::OperationEnabled | State::FaultReactionActive);
            let kept = outputs.sent.word.contains(Controlword::HALT) && !driving && obeys;
            let halt = self.stopping.halt.is_on || kept;
            let bits = if driving {
                self.modes.bits()
            } else {
                ModeBits::NONE
            };
            ComposedWord::new(command, bits, halt, outputs.manufacturer)
        };
        let velocity = if driving {
            self.modes.target_velocity()
        } else {
            0
        };
        self.outputs.next = Outgoing { word, velocity };
    }

    /// Whether the drive holds the axis until its brake does.
    const fn keeps_power(&self) -> bool {
        self.brake.needs_power() && self.guard.may_hold()
    }

    /// When a machine has something to do without a word of the drive.
    pub fn due(&self, step_in_mode: bool) -> Due {
        Due::next_if(self.has_unsent())
            .sooner(self.power.due())
            .sooner(self.guard.due())
            .sooner(self.brake.due(&self.power))
            .sooner(self.stopping.due())
            .sooner(self.modes.due(step_in_mode))
    }

    // How commands and machines end each other.

    pub fn done(&mut self, id: CommandId, result: Result<Completion, Failure>) {
        self.events.0.push(id, Event::Done(result));
    }

    /// Those who wait for a halt hear this.
    fn end_halts(&mut self, result: Result<Completion, Failure>) {
        while let Some(id) = self
            .stopping
            .take_waiter(|wait| matches!(wait, Wait::Halt { .. }))
        {
            self.done(id, result);
        }
    }

    pub fn fail_halts(&mut self, failure: Failure) {
        self.end_halts(Err(failure));
    }

    /// The stop is over: those who wait for it hear this, or of the fault that has overtaken them.
    fn finish_stop(&mut self, result: Result<Completion, Failure>) {
        self.stopping.phase = StopPhase::None;
        self.stopping.off = false;
        while let Some((id, fault)) = self.stopping.next_waiter() {
            self.done(id, fault.map_or(result, Err));
        }
    }

    /// Every pending command but moves and stops ends with this.
    pub fn fail_commands(&mut self, step: &Step<'_>, failure: Failure) {
        if let Some(id) = self.power.take_waiter() {
            self.done(id, Err(failure));
        }
        let events = &mut self.events.0;
        self.modes.fail_change(failure, step, events);
        self.fail_resume(failure);
    }

    /// The drive does not answer, or whether it receives its outputs is not known: everything ends, and what still reaches it is a quick
    /// stop. Of one that answers, those who wait for a stop wait for what it shows.
    pub fn lose(&mut self, step: &Step<'_>, answered: bool) {
        self.modes.lose_reference();
        let driven = self.power.is_driving();
        if self.modes.has_motion() {
            // Since it was seen last its drive may have set off.
            self.counts_rest_anew = Aside(true);
        }
        let failure = Self::failure_of_loss(answered);
        self.fail_motions(failure);
        self.fail_commands(step, failure);
        if !answered {
            self.fail_stops(failure);
        }
        if driven {
            self.fallen = Aside(Some(failure));
            self.begin_quick_stop(step);
        }
    }

    /// It counted as lost, and does not answer any more: stops were to end by what it shows.
    pub fn fall_silent(&mut self, step: &Step<'_>) {
        let failure = Self::failure_of_loss(false);
        self.fail_commands(step, failure);
        self.fail_stops(failure);
    }

    /// Those who wait for a stop hear this, or of the fault that has overtaken it. The stop goes on.
    pub fn fail_stops(&mut self, failure: Failure) {
        while let Some((id, fault)) = self.stopping.next_waiter() {
            self.done(id, Err(fault.unwrap_or(failure)));
        }
    }

    /// Ends every motion with this failure, which says how far each set-point came.
    pub fn fail_motions(&mut self, failure: Failure) {
        self.modes.fail_motions(failure, &mut self.events.0);
    }

    /// The drive is out of Operation enabled: bits 4 and 8 fall, and nothing is held any more (S6).
    pub fn leave_operation(&mut self, step: &Step<'_>, power: Power) {
        if !self.power.is_resetting() {
            self.power = power;
        }
        self.stopping.halt = Halt::OFF;
        self.modes.lower(step.state, &mut self.events.0);
    }

    pub fn wait_for_stop(&mut self, id: CommandId) {
        if !self.stopping.wait(id, Wait::Stop) {
            self.done(id, Err(Failure::Busy));
        }
    }

    pub fn cancel_enabling(&mut self, failure: Failure) {
        if let Power::Enabling { id, .. } = self.power {
            self.power = Power::Off;
            self.outputs.stop_unsent = true;
            self.done(id, Err(failure));
        }
    }

    /// A stop comes before bit 8 has fallen.
    pub fn fail_resume(&mut self, failure: Failure) {
        if let Some(Resuming { id, falls }) = self.resuming.take() {
            if falls {
                self.stopping.begin_halt();
            }
            self.done(id, Err(failure));
        }
    }

    /// Whether the drive moves, or holds, an axis that we have not enabled: it was found so, or somebody else has enabled it.
    fn runs_unasked(&self, step: &Step<'_>) -> bool {
        let powered = matches!(step.state, State::OperationEnabled | State::QuickStopActive);
        !self.power.is_driving() && (self.stopping.is_quick() || powered && !step.stands())
    }

    /// Bit 2 low from the next frame on. False when the axis is not enabled: it has nothing to stop.
    pub fn begin_quick_stop(&mut self, step: &Step<'_>) -> bool {
        self.cancel_enabling(Failure::QUICK_STOPPED);
        if self.stopping.is_switching_off() {
            return true;
        }
        let enabled = self.power.is_driving() || step.state == State::OperationEnabled;
        if step.state.is_fault() || !(enabled || self.runs_unasked(step)) {
            return false;
        }
        if let Power::Disabling { id, .. } = self.power {
            // What it sends would leave the way in which the axis stops to 605Bh.
            self.power = Power::Off;
            self.stopping.off = true;
            self.wait_for_stop(id);
        }
        self.withdraw_unsent(Failure::QUICK_STOPPED);
        self.fail_resume(Failure::QUICK_STOPPED);
        if !self.stopping.is_quick() {
            self.stopping.begin_quick(self.stopping.left(step));
        }
        true
    }

    /// Bit 8 from the next frame on. Moves that are not sent fail as halted.
    pub fn begin_halt(&mut self, step: &Step<'_>) {
        self.cancel_enabling(Failure::HALTED);
        if self.runs_unasked(step) || (self.power.is_driving() && !halts_under_control(step)) {
            self.begin_quick_stop(step);
            return;
        }
        if !self.power.is_driving() || self.stopping.is_quick() || step.state.is_fault() {
            return;
        }
        self.withdraw_unsent(Failure::HALTED);
        self.fail_resume(Failure::HALTED);
        self.outputs.stop_unsent = true;
        self.stopping.halt.lent = false;
        if !self.stopping.halt.is_on {
            self.stopping.begin_halt();
        }
    }

    /// Halt, with the quick stop to follow. False when the axis stands without a set-point: nothing is sent then. Moves that are not sent
    /// fail as `failure`.
    pub fn begin_stop(&mut self, step: &Step<'_>, failure: Failure) -> bool {
        self.cancel_enabling(failure);
        if self.runs_unasked(step) || self.stopping.is_switching_off() {
            return self.begin_quick_stop(step);
        }
        if !self.power.is_driving() || step.state.is_fault() {
            return false;
        }
        let disables = matches!(failure, Failure::Disabled { .. });
        if self.stopping.is_active() {
            if disables && let StopPhase::Halting { from, .. } = &mut self.stopping.phase {
                *from = None;
            }
            return true;
        }
        let has_motion = self.modes.has_motion();
        self.withdraw_unsent(failure);
        // Nothing starts in its frame, also where there is nothing to stop.
        self.outputs.stop_unsent = true;
        // A stop ends a halt.
        let goes_on = has_motion || (self.stopping.halt.is_on && !disables);
        if !goes_on && step.stands() {
            return false;
        }
        self.fail_resume(failure);
        if !halts_under_control(step) {
            return self.begin_quick_stop(step);
        }
        let rests_perhaps = !has_motion && !disables && !self.stopping.halt.is_on;
        let from = rests_perhaps.then_some(step.position());
        self.begin_halt(step);
        self.stopping.halt.lent = from.is_some();
        self.stopping.phase = StopPhase::Halting {
            left: step.deadline().sooner(quarter(step)),
            from,
        };
        true
    }

    /// A stop takes over: what is not sent is not started, and a velocity that is held is let go with this frame.
    fn withdraw_unsent(&mut self, failure: Failure) {
        if self.modes.jogging.has_motion() {
            // Its drive may set off just now.
            self.counts_rest_anew = Aside(true);
        }
        self.stopping.halt.holds = None;
        if let Some(id) = self.stopping.take_hold() {
            // Of a move that has pressed the drive has the set-point.
            self.done(id, Err(failure.with_delivery(Delivery::Accepted)));
        }
        self.modes.withdraw_unsent(failure, &mut self.events.0);
    }
}

/// Whether bit 8 stops the axis and does not let it coast.
pub(super) const fn halts_under_control(step: &Step<'_>) -> bool {
    step.config.stop_options.halts_under_control()
}
