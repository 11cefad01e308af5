//! The axis core: one cycle at a time, inputs in, controlword and set-point out (pure).
//!
//! Contract, per cycle: [`AxisCore::submit`] what is new, [`AxisCore::apply_stop`] what the stop lane holds as the last thing
//! before sending, send the outputs, [`AxisCore::step`] with what came back, then drain [`AxisCore::poll_event`].
//! Everything in the outputs when `step` is called counts as sent.

use core::time::Duration;

use crate::{
    ds402::{Controlword, Mode, PowerCommand, Sample, State, Statusword},
    homing::Procedure,
    profile_position::{
        Bounds, CommandId, Completion, Event, Events, Failure, LastSeen, Sequencer, Standstill,
    },
    profile_velocity::Jogging,
};

use super::{
    AxisConfig, Inputs, Referencing, Snapshot, StopRequest,
    brake::Brake,
    calm::{Calm, News},
    fields::Sight,
    intake::Pace,
    modes::{MODE_BITS, ModeChange},
    power::Power,
    stopping::{Stopping, Wait},
    submit::Resuming,
};

/// One cycle as the modes see it. A macro, because they change while it is borrowed from the rest of the core.
macro_rules! cycle {
    ($core:ident, $now:expr, $sample:expr, $delivered:expr) => {
        crate::profile_position::Cycle {
            now: $now,
            sample: $sample,
            standstill: &$core.standstill,
            bounds: &$core.bounds,
            last_seen: &$core.last_seen,
            traits: &$core.config.traits,
            limits: &$core.config.limits,
            referenced: $core.is_referenced(),
            delivered: $delivered,
            halted: $core.halted,
            blind: $core.blind_cycles,
            stalled: $core.pace.stalled,
            limit_tells: $core.limit_tells,
            acknowledge: $core.config.deadlines.acknowledge,
            begin: $core.config.deadlines.begin,
            controlword: $core.sent,
        }
    };
}
pub(super) use cycle;

/// One axis, stepped once a cycle.
///
/// ```
/// use core::time::Duration;
/// use servocrab::axis::{AxisConfig, AxisCore, AxisFields, Command, CommandId, Inputs};
///
/// let mut axis = AxisCore::new(AxisConfig::new(AxisFields::at(0, 0)));
/// let mut outputs = [0; 6];
/// axis.submit(Duration::ZERO, CommandId(1), Command::Enable, &mut outputs);
/// // The drive shows Switch on disabled at position 0, for two of its cycles; the answer is Shutdown, 06h.
/// for ms in 1..=3 {
///     let now = Duration::from_millis(ms);
///     axis.step(now, Inputs::Fresh(&[0x50, 0x02, 0, 0, 0, 0]), &mut outputs);
/// }
/// assert_eq!(outputs[0], 0x06);
/// ```
#[derive(Debug, Clone)]
pub struct AxisCore {
    pub(super) config: AxisConfig,
    pub(super) bounds: Bounds,
    pub(super) sample: Option<Sample>,
    pub(super) standstill: Standstill,
    pub(super) last_seen: LastSeen,
    pub(super) brake: Brake,
    pub(super) sequencer: Sequencer,
    pub(super) homing: Procedure,
    pub(super) jogging: Jogging,
    pub(super) power: Power,
    pub(super) stopping: Stopping,
    pub(super) events: Events,
    /// Bit 8.
    pub(super) halted: bool,
    /// Whether a stop was asked for since the last frame: nothing takes it back before it is sent.
    pub(super) stop_unsent: bool,
    /// A resume whose frame has not been sent.
    pub(super) resuming: Option<Resuming>,
    /// Since when bit 8 is known to have been delivered.
    pub(super) halt_delivered: Option<Duration>,
    pub(super) mode: Mode,
    pub(super) mode_change: Option<ModeChange>,
    /// 6061h where it is read by SDO.
    pub(super) noted_mode: Mode,
    pub(super) manufacturer: Controlword,
    /// In the outputs now, and sent with the next cycle.
    pub(super) outgoing: Controlword,
    /// Sent with the last cycle.
    pub(super) sent: Controlword,
    /// Target velocity in the outputs now, and sent with the last cycle.
    pub(super) outgoing_velocity: i32,
    pub(super) sent_velocity: i32,
    /// Since when no bit of a mode and no velocity is known to have been delivered.
    pub(super) quiet_since: Option<Duration>,
    /// Whether a homing was attained since the drive was last lost.
    pub(super) homed: bool,
    /// Whether one was when the drive was lost last: it is still true of a drive that has kept its power.
    pub(super) homed_before_loss: bool,
    pub(super) answered: bool,
    pub(super) lost: bool,
    pub(super) stale_cycles: u32,
    /// How many cycles without inputs there were before the last one with them.
    pub(super) blind_cycles: u32,
    pub(super) undelivered_cycles: u32,
    pub(super) pace: Pace,
    /// Whether bit 11 was ever seen low in Operation enabled.
    pub(super) limit_tells: bool,
    pub(super) cycle: u64,
    /// Whether the program counts as not alive.
    pub(super) expired: bool,
    pub(super) calm: Calm,
    /// What was shown when it was calm.
    pub(super) sight: Sight,
    pub(super) news: News,
}

impl AxisCore {
    /// An axis that commands nothing until it is told to: its first words are Disable voltage, or quick stop as long
    /// as it is not known that the drive moves nothing; its first target is where the drive stands.
    #[must_use]
    pub fn new(config: AxisConfig) -> Self {
        let (config, bounds) = config.with_bounds();
        Self {
            bounds,
            sequencer: Sequencer::new(config.defaults),
            homing: Procedure::new(config.deadlines.standstill),
            jogging: Jogging::new(),
            mode: config.mode,
            config,
            sample: None,
            standstill: Standstill::default(),
            last_seen: LastSeen::default(),
            brake: Brake::default(),
            power: Power::Off,
            stopping: Stopping::default(),
            events: Events::new(),
            halted: false,
            stop_unsent: false,
            resuming: None,
            halt_delivered: None,
            mode_change: None,
            noted_mode: Mode::None,
            manufacturer: Controlword::empty(),
            outgoing: Controlword::empty(),
            sent: Controlword::empty(),
            outgoing_velocity: 0,
            sent_velocity: 0,
            quiet_since: None,
            homed: false,
            homed_before_loss: false,
            answered: false,
            lost: false,
            stale_cycles: 0,
            blind_cycles: 0,
            undelivered_cycles: 0,
            pace: Pace::default(),
            limit_tells: false,
            cycle: 0,
            expired: false,
            calm: Calm::No,
            sight: Sight::default(),
            news: News::Anything,
        }
    }

    /// The stop lane: merges stops into outputs that have been computed and not been sent, as the last thing before
    /// sending. A rise of bit 4 that was about to be sent is withdrawn and its move fails as not sent; returns whether
    /// there was one. What was sent before keeps its bit 4.
    pub fn apply_stop(&mut self, now: Duration, stop: StopRequest, outputs: &mut [u8]) -> bool {
        if stop.is_empty() && self.calm != Calm::No {
            return false;
        }
        let rising = self
            .outgoing
            .difference(self.sent)
            .contains(Controlword::NEW_SET_POINT);
        if stop.contains(StopRequest::QUICK_STOP) {
            self.begin_quick_stop(now);
        }
        if stop.contains(StopRequest::STOP) {
            self.begin_stop(now, Failure::QUICK_STOPPED);
        }
        if stop.contains(StopRequest::HALT) {
            self.begin_halt(now);
            self.stopping.unwatched = true;
        }
        self.write_outputs(outputs);
        rising && !self.outgoing.contains(Controlword::NEW_SET_POINT)
    }

    /// One cycle: takes in what came back and writes the axis' own fields of the outputs that are sent next.
    ///
    /// Inputs that did not arrive change nothing, until [`Loss`](super::Loss) says that the drive is lost.
    pub fn step(&mut self, now: Duration, inputs: Inputs<'_>, outputs: &mut [u8]) {
        self.step_kept(now, inputs, false, outputs);
        self.write_fields(outputs);
    }

    /// As [`step`](Self::step), for outputs that are kept from cycle to cycle: it writes to them what has changed, and says
    /// whether anything has. `unchanged`: these inputs are, bit for bit, those of the last call.
    #[inline(always)]
    pub fn step_kept(
        &mut self,
        now: Duration,
        inputs: Inputs<'_>,
        unchanged: bool,
        outputs: &mut [u8],
    ) -> bool {
        if unchanged && self.step_at_rest(&inputs) {
            return false;
        }
        if let Some(changed) = self.step_calmly(now, &inputs, outputs) {
            return changed;
        }
        self.step_whole(now, inputs, outputs);
        true
    }

    #[inline(never)]
    fn step_whole(&mut self, now: Duration, inputs: Inputs<'_>, outputs: &mut [u8]) {
        let delivered = self.take_in(now, inputs);
        self.write_outputs(outputs);
        self.judge_calm(delivered);
    }

    /// Takes the next report; drain it after every other call.
    pub fn poll_event(&mut self) -> Option<(CommandId, Event)> {
        self.events.pop()
    }

    /// Withdraws a motion that has not been sent, or a change of mode, which then ends as [`Failure::Withdrawn`]; a rise of bit 4 that
    /// is in the outputs and not sent is taken back. Returns whether there was such a move: afterwards it is too late, and the
    /// handshake completes.
    pub fn withdraw(&mut self, id: CommandId, outputs: &mut [u8]) -> bool {
        let (failure, events) = (Failure::Withdrawn, &mut self.events);
        let withdrawn = self.sequencer.withdraw(id, failure, events)
            || self.homing.withdraw(id, failure, events)
            || self.jogging.withdraw(id, failure, events)
            || self.withdraw_mode_change(id);
        if withdrawn {
            self.write_outputs(outputs);
        }
        withdrawn
    }

    /// Ends the homing with this id as by [`StopRequest::STOP`], if it was sent and has not ended: nobody waits for it any more.
    #[cfg(feature = "std")]
    pub(super) fn end_homing(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) -> bool {
        let ends = self.homing.is_under_way(id);
        if ends {
            self.apply_stop(now, StopRequest::STOP, outputs);
        }
        ends
    }

    /// Whether a gated move has all that it needs in this cycle.
    #[must_use]
    pub fn is_armed(&self, id: CommandId) -> bool {
        self.sequencer.is_armed(id)
    }

    /// Releases a gated, armed move: its bit 4 rises in the outputs that are sent next. Call it in the cycle in which
    /// [`AxisCore::is_armed`] said so, after `step`. On inputs that are not fresh nothing is released.
    pub fn fire(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) {
        if let Some(sample) = self.sample
            && self.has_fresh_inputs()
        {
            let cycle = cycle!(self, now, &sample, true);
            self.sequencer.fire(id, &cycle, &mut self.events);
            self.write_outputs(outputs);
        }
    }

    /// Whether the last step had inputs of the drive, and the outputs before them were delivered.
    const fn has_fresh_inputs(&self) -> bool {
        self.answered && self.undelivered_cycles == 0
    }

    /// The move that has just been taken in rises in the next frame, if the last inputs were fresh and nothing is in its way. After
    /// others it waits for the next fresh ones.
    pub(super) fn start_move_now(&mut self, now: Duration) {
        let Some(sample) = self.sample else { return };
        let ready = self.has_fresh_inputs()
            && !self.halted
            && !self.stop_unsent
            && !self.sent.contains(Controlword::HALT)
            && sample.state() == State::OperationEnabled
            && self.power.is_driving()
            && !self.stopping.is_active()
            && self.mode == Mode::ProfilePosition
            && sample.mode == self.mode;
        if ready {
            let cycle = cycle!(self, now, &sample, true);
            self.sequencer.start_next(&cycle, &mut self.events);
        }
    }

    /// What is known of the axis.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        let sample = self.sample;
        let statusword = sample.map_or(Statusword::empty(), |s| s.statusword);
        Snapshot {
            cycle: self.cycle,
            age: self.stale_cycles,
            answered: self.answered,
            lost: self.lost,
            statusword,
            state: statusword.state(),
            controlword: self.outgoing,
            mode: sample.map_or(Mode::None, |s| s.mode),
            position: sample.map_or(0, |s| s.position),
            velocity: sample.and_then(|s| s.velocity).unwrap_or(0),
            halted: self.halted,
            has_set_point: self.has_motion(),
            referenced: self.is_referenced(),
        }
    }

    /// Sets bits 11–15 of the controlword, which are the manufacturer's; other bits are ignored.
    pub fn set_manufacturer_bits(&mut self, bits: Controlword) {
        self.manufacturer = bits & Controlword::MANUFACTURER;
        self.calm = Calm::No;
    }

    /// Whether the program counts as not alive. As long as it does nothing is enabled, started or resumed: that fails as
    /// [`Failure::LivenessExpired`]. The halt with which this begins is asked for by [`apply_stop`](Self::apply_stop).
    pub const fn set_expired(&mut self, expired: bool) {
        self.expired = expired;
    }

    /// Says what 6061h shows, where it is not mapped and was read by SDO.
    pub fn note_mode(&mut self, mode: Mode) {
        self.noted_mode = mode;
        self.calm = Calm::No;
        if let Some(sample) = &mut self.sample
            && self.config.fields.mode_display.is_none()
        {
            sample.mode = mode;
        }
    }

    /// What the drive held when it was attached last.
    #[cfg(feature = "std")]
    pub(super) const fn drive_settings(&self) -> super::DriveSettings {
        super::DriveSettings::of(&self.config)
    }

    /// What is new since this was asked last.
    #[cfg(feature = "std")]
    #[inline]
    pub(super) const fn take_news(&mut self) -> News {
        core::mem::replace(&mut self.news, News::Nothing)
    }

    /// Position and velocity, as the snapshot has them.
    #[cfg(feature = "std")]
    #[inline]
    pub(super) fn motion(&self) -> u64 {
        self.sample.map_or(0, |sample| {
            super::status::motion(sample.position, sample.velocity.unwrap_or(0))
        })
    }

    /// Cycles since inputs came in last.
    #[cfg(feature = "std")]
    #[inline]
    pub(super) const fn age(&self) -> u32 {
        self.stale_cycles
    }

    pub(super) const fn is_lost(&self) -> bool {
        self.lost
    }

    /// Whether the outputs hold bit 4, with a target that belongs to it.
    pub(super) const fn outgoing_starts(&self) -> bool {
        self.outgoing.contains(Controlword::NEW_SET_POINT)
    }

    #[inline(always)]
    pub(super) fn state(&self) -> State {
        self.sample.map_or(State::NotReadyToSwitchOn, |s| s.state())
    }

    pub(super) fn done(&mut self, id: CommandId, result: Result<Completion, Failure>) {
        self.events.push(id, Event::Done(result));
    }

    /// Whether the axis stood in the last cycle with inputs. Without any it is not known to stand.
    #[inline]
    pub(super) const fn is_standing(&self) -> bool {
        self.standstill.is_standing()
    }

    /// Whether the axis has come to rest from all that its drive has done, or may have done.
    pub(super) const fn is_at_rest(&self) -> bool {
        self.is_standing() || !self.brake.may_drive()
    }

    /// Whether the drive has surely shown that its power stage is off, and the axis rests from what it may have been driven to. A moving one
    /// may be driven still, whatever the statuswords show.
    pub(super) const fn is_down_at_rest(&self) -> bool {
        self.brake.is_down() && self.is_at_rest()
    }

    /// Rest as before; and of an axis that is not to be enabled any more, what was sent last keeps the drive from following a set-point: a state
    /// without power that was shown once may be wrong.
    pub(super) fn is_at_rest_for_good(&self) -> bool {
        let led_down = !self.sent.contains(Controlword::ENABLE_OPERATION);
        self.is_at_rest() && (led_down || self.power.is_driving())
    }

    /// Whether the axis stands; of one that does not answer, whether it did when it answered last.
    #[cfg(feature = "std")]
    pub(crate) const fn stands(&self) -> bool {
        self.is_standing()
    }

    /// How long a disable may take at most, with the stop of a moving axis before it.
    #[cfg(feature = "std")]
    pub(crate) const fn longest_stop(&self) -> Duration {
        let deadlines = &self.config.deadlines;
        let stops = deadlines.standstill.saturating_mul(2);
        stops
            .saturating_add(deadlines.disable)
            .saturating_add(self.bounds.settle)
    }

    /// Whether the axis' positions are known to mean what the program means.
    pub(super) fn is_referenced(&self) -> bool {
        self.homed || self.config.referencing == Referencing::AbsoluteEncoder
    }

    /// Every pending command but moves ends with `failure`, and what they were doing ends with them.
    pub(super) fn fail_commands(&mut self, failure: Failure) {
        self.fail_commands_but_stops(failure);
        while let Some((id, instead)) = self.stopping.next_waiter() {
            self.done(id, Err(instead.unwrap_or(failure)));
        }
    }

    /// The same, where those who wait for a stop wait on.
    pub(super) fn fail_commands_but_stops(&mut self, failure: Failure) {
        if let Some(id) = self.power.take_waiter() {
            self.done(id, Err(failure));
        }
        self.fail_mode_change(failure);
        self.fail_resume(failure);
    }

    /// The same, and those who wait for a halt fail.
    pub(super) fn fail_others(&mut self, failure: Failure) {
        self.fail_commands_but_stops(failure);
        while let Some(id) = self
            .stopping
            .take_waiter(|wait| matches!(wait, Wait::Halt { .. }))
        {
            self.done(id, Err(failure));
        }
    }

    /// The one composer of controlwords.
    fn compose(&self) -> Controlword {
        let state = self.state();
        let halt = if self.halted {
            Controlword::HALT
        } else {
            Controlword::empty()
        };
        let traits = &self.config.traits;
        let command = if self.stopping.is_quick() {
            PowerCommand::QuickStop
        } else if self.stopping.is_switching_off() && state != State::QuickStopActive {
            // A drive that ignores quick stop, or has stopped the axis by it.
            PowerCommand::DisableVoltage
        } else {
            let command = self.power.command(state, self.sample.as_ref(), traits);
            if self.power.leads_down(command) && self.brake.holds(self.is_standing()) {
                PowerCommand::QuickStop
            } else {
                command
            }
        };
        let bits = if command == PowerCommand::QuickStop
            && !self.power.allows_mode_bits()
            && !self.is_standing()
        {
            // During quick stop they stay as they were sent last.
            self.sent & (MODE_BITS | Controlword::HALT)
        } else {
            self.mode_bits() | halt
        };
        command.controlword() | bits | self.manufacturer
    }

    pub(super) fn write_outputs(&mut self, outputs: &mut [u8]) {
        self.outgoing = self.compose();
        self.outgoing_velocity = self.target_velocity();
        self.calm = Calm::No;
        self.news = News::Anything;
        self.write_fields(outputs);
    }

    fn write_fields(&self, outputs: &mut [u8]) {
        let of_jog;
        let parameters = if self.mode == Mode::ProfileVelocity {
            of_jog = self.jog_parameters();
            &of_jog
        } else {
            self.sequencer.parameters()
        };
        let fields = &self.config.fields;
        fields.write(
            outputs,
            self.outgoing,
            self.mode,
            self.sequencer.target(),
            parameters,
        );
        fields.write_velocity(outputs, self.outgoing_velocity);
    }
}
