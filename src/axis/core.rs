//! The axis core: one cycle at a time, inputs in, controlword and set-point out (pure).
//!
//! Contract, per cycle: [`AxisCore::submit`] what is new, [`AxisCore::apply_stop`] what the stop lane holds as the last thing
//! before sending, send the outputs, [`AxisCore::step`] with what came back, then drain [`AxisCore::poll_event`].
//! Everything in the outputs when `step` is called counts as sent.

use core::{
    hash::{Hash, Hasher},
    time::Duration,
};

use bitflags::bitflags;

use crate::{
    coe::{AnyObject, AxisOffset, ObjectAddress, obj},
    ds402::{Controlword, Mode, ModeBits, PowerCommand, PowerGoal, Sample, State, Statusword},
    homing::{HomingCommand, HomingVerdict, Procedure},
    pdo_map::{Direction, Layout},
    profile_position::{
        Bounds, CommandId, Completion, Delivery, Event, Events, Failure, LastSeen, Limits,
        MoveCommand, Parameters, Reference, Sequencer, Standstill, StartBits, Unanswered,
        WaitingFor, no_older,
    },
    profile_velocity::{JogSetPoint, Jogging},
    units::{AxisUnit, Counts, Scale},
};

use super::{
    CoreConfig, Referencing,
    power::{Brake, Power, RESET_EDGES, RESET_PAUSE, ResetPhase},
    stopping::{StopPhase, Stopping, Wait},
};

pub(crate) use commanded::CommandedMode;
use commanded::{ComposedWord, ManufacturerBits};

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
            stalled: $core.spacing.stalled,
            bit_11_is_valid: $core.bit_11_is_valid,
            acknowledge: $core.config.deadlines.acknowledge,
            begin: $core.config.deadlines.begin,
            controlword: $core.sent.word(),
        }
    };
}

/// One axis, stepped once a cycle.
///
/// ```
/// use core::time::Duration;
/// use servocrab::axis::{CoreConfig, AxisCore, AxisFields, Command, CommandId, Inputs};
///
/// let mut axis = AxisCore::new(CoreConfig::new(AxisFields::at(0, 0)));
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
    pub(super) config: CoreConfig,
    pub(super) bounds: Bounds,
    pub(super) sample: Option<Sample>,
    standstill: Standstill,
    last_seen: LastSeen,
    pub(super) brake: Brake,
    sequencer: Sequencer,
    homing: Procedure,
    jogging: Jogging,
    pub(super) power: Power,
    pub(super) stopping: Stopping,
    events: Events,
    /// Bit 8.
    halted: bool,
    /// Whether a stop was asked for since the last frame: nothing takes it back before it is sent.
    stop_unsent: bool,
    /// A resume whose frame has not been sent.
    resuming: Option<Resuming>,
    /// Whether a motion was given up that the drive may hold until it is out of Operation enabled.
    given_up: bool,
    /// Why the axis is not driven any more, without having been stopped by a command: until somebody takes it.
    fallen: Option<Failure>,
    /// Since when bit 8 is known to have been delivered.
    halt_delivered: Option<Duration>,
    pub(super) mode: Mode,
    pub(super) mode_change: Option<ModeChange>,
    /// 6061h where it is read by SDO.
    noted_mode: Mode,
    manufacturer: ManufacturerBits,
    /// In the outputs now, and sent with the next cycle.
    outgoing: ComposedWord,
    /// Sent with the last cycle.
    pub(super) sent: ComposedWord,
    /// Target velocity in the outputs now, and sent with the last cycle.
    outgoing_velocity: i32,
    sent_velocity: i32,
    /// Since when no bit of a mode and no velocity is known to have been delivered.
    quiet_since: Option<Duration>,
    /// Whether a homing was attained since the drive was last lost.
    homed: bool,
    /// Whether one was when the drive was lost last: it is still true of a drive that has kept its power.
    homed_before_loss: bool,
    answered: bool,
    pub(super) lost: bool,
    stale_cycles: u32,
    /// How many cycles without inputs there were before the last one with them.
    blind_cycles: u32,
    undelivered_cycles: u32,
    /// Whether its drive is on its way into OP: until it is there, outputs that it does not take are no loss.
    awaits_op: bool,
    spacing: CycleSpacing,
    /// Whether bit 11 was ever seen low in Operation enabled.
    bit_11_is_valid: bool,
    pub(crate) cycle: u64,
    /// Whether the program counts as not alive.
    pub(crate) expired: bool,
    idle_path: IdlePath,
    /// What was shown when the idle path was taken.
    status_key: StatusKey,
    change: SnapshotChange,
}

impl AxisCore {
    /// An axis that commands nothing until it is asked to: its first words are Disable voltage, or quick stop as long
    /// as it is not known that the drive moves nothing; its first target is where the drive stands.
    #[must_use]
    pub fn new(config: CoreConfig) -> Self {
        let homed = config.homed;
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
            given_up: false,
            fallen: None,
            halt_delivered: None,
            mode_change: None,
            noted_mode: Mode::None,
            manufacturer: ManufacturerBits::NONE,
            outgoing: ComposedWord::DISABLE_VOLTAGE,
            sent: ComposedWord::DISABLE_VOLTAGE,
            outgoing_velocity: 0,
            sent_velocity: 0,
            quiet_since: None,
            homed,
            homed_before_loss: false,
            answered: false,
            lost: false,
            stale_cycles: 0,
            blind_cycles: 0,
            undelivered_cycles: 0,
            awaits_op: false,
            spacing: CycleSpacing::default(),
            bit_11_is_valid: false,
            cycle: 0,
            expired: false,
            idle_path: IdlePath::No,
            status_key: StatusKey::default(),
            change: SnapshotChange::Anything,
        }
    }

    /// The stop lane: merges stops into outputs that have been computed and not been sent, as the last thing before
    /// sending. A rise of bit 4 that was about to be sent is withdrawn and its move fails as not sent; returns whether
    /// there was one. What was sent before keeps its bit 4.
    pub fn apply_stop(&mut self, now: Duration, stop: StopRequest, outputs: &mut [u8]) -> bool {
        if stop.is_empty() && self.idle_path != IdlePath::No {
            return false;
        }
        let rising = self.outgoing_starts() && !self.sent.contains(Controlword::NEW_SET_POINT);
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
        rising && !self.outgoing_starts()
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
        if let Some(changed) = self.step_on_idle_path(now, &inputs, outputs) {
            return changed;
        }
        self.step_whole(now, inputs, outputs);
        true
    }

    #[inline(never)]
    fn step_whole(&mut self, now: Duration, inputs: Inputs<'_>, outputs: &mut [u8]) {
        let delivered = self.take_in(now, inputs);
        self.write_outputs(outputs);
        self.choose_path(delivered);
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
    pub(crate) fn end_homing(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) -> bool {
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
            self.sequencer.fire(id, &cycle);
            self.write_outputs(outputs);
        }
    }

    /// Its drive is in SAFEOP and on its way into OP, or has come there: until then outputs that it does not take are no loss.
    #[cfg(feature = "std")]
    pub(crate) const fn await_op(&mut self, awaits_op: bool) {
        self.awaits_op = awaits_op;
        if self.undelivered_cycles > 0 {
            self.undelivered_cycles = 1;
        }
    }

    /// Whether the last step had inputs of the drive, and the outputs before them were delivered.
    const fn has_fresh_inputs(&self) -> bool {
        self.answered && self.undelivered_cycles == 0
    }

    /// The move that has just been taken in rises in the next frame, if the last inputs were fresh and nothing is in its way. After
    /// others it waits for the next fresh ones.
    fn start_move_now(&mut self, now: Duration) {
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
            self.sequencer.start_next(&cycle, &mut self.events, false);
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
            controlword: self.outgoing.word(),
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
        self.manufacturer = ManufacturerBits::of(bits);
        self.idle_path = IdlePath::No;
    }

    /// Whether the program counts as not alive. As long as it does nothing is enabled, started or resumed: that fails as
    /// [`Failure::LivenessExpired`]. The halt with which this begins is asked for by [`apply_stop`](Self::apply_stop).
    pub const fn set_expired(&mut self, expired: bool) {
        self.expired = expired;
    }

    /// Says what home offset 607Ch the drive holds: it counts its software position limits 607Dh from there.
    pub const fn note_home_offset(&mut self, offset: i32) {
        self.config.limits.home_offset = offset;
    }

    /// Says what 6061h shows, where it is not mapped and was read by SDO.
    pub fn note_mode(&mut self, mode: Mode) {
        self.noted_mode = mode;
        self.idle_path = IdlePath::No;
        if let Some(sample) = &mut self.sample
            && self.config.fields.mode_display.is_none()
        {
            sample.mode = mode;
        }
    }

    /// What the drive held when it was attached last.
    #[cfg(feature = "std")]
    pub(crate) const fn drive_settings(&self) -> super::DriveSettings {
        super::DriveSettings::of(&self.config)
    }

    /// What is new since this was asked last.
    #[cfg(feature = "std")]
    #[inline]
    pub(crate) const fn take_change(&mut self) -> SnapshotChange {
        core::mem::replace(&mut self.change, SnapshotChange::Nothing)
    }

    /// Why the axis has stopped being driven since this was asked last, where no command has stopped it. What was asked for before that is
    /// not to move it after it was enabled again.
    #[cfg(feature = "std")]
    #[inline]
    pub(crate) const fn take_fall(&mut self) -> Option<Failure> {
        self.fallen.take()
    }

    /// Position and velocity, as the snapshot has them.
    #[cfg(feature = "std")]
    #[inline]
    pub(crate) fn motion(&self) -> (i32, i32) {
        self.sample.map_or((0, 0), |sample| {
            (sample.position, sample.velocity.unwrap_or(0))
        })
    }

    /// Cycles since inputs came in last.
    #[cfg(feature = "std")]
    #[inline]
    pub(crate) const fn age(&self) -> u32 {
        self.stale_cycles
    }

    pub(super) const fn is_lost(&self) -> bool {
        self.lost
    }

    /// Whether a stop or a disable is taken: not by an axis that counts as lost and did not answer in the last cycle.
    pub(crate) const fn takes_stops(&self) -> bool {
        !self.lost || self.answered
    }

    /// Whether the outputs hold bit 4, with a target that belongs to it.
    const fn outgoing_starts(&self) -> bool {
        self.outgoing.contains(Controlword::NEW_SET_POINT)
    }

    #[inline(always)]
    pub(crate) fn state(&self) -> State {
        self.sample.map_or(State::NotReadyToSwitchOn, |s| s.state())
    }

    fn done(&mut self, id: CommandId, result: Result<Completion, Failure>) {
        self.events.push(id, Event::Done(result));
    }

    /// Whether the axis stood in the last cycle with inputs. Without any it is not known to stand.
    #[inline]
    const fn is_standing(&self) -> bool {
        self.standstill.is_standing()
    }

    /// Whether the axis has come to rest from all that its drive has done, or may have done.
    const fn is_at_rest(&self) -> bool {
        self.is_standing() || self.brake.is_free()
    }

    /// Whether the drive has surely shown that its power stage is off, and the axis rests from what it may have been driven to, or has had the
    /// time to. A moving one may be driven still, whatever the statuswords show.
    const fn is_down_at_rest(&self) -> bool {
        self.brake.is_down() && (self.is_standing() || !self.brake.may_drive())
    }

    /// Rest as before; and of an axis that is not to be enabled any more, what was sent last keeps the drive from following a set-point: a state
    /// without power that was shown once may be wrong.
    fn is_at_rest_for_good(&self) -> bool {
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
        deadlines
            .standstill
            .saturating_add(deadlines.disable)
            .saturating_add(self.bounds.settle)
    }

    /// Whether the axis' positions are known to mean what the program means.
    fn is_referenced(&self) -> bool {
        self.homed || self.config.referencing == Referencing::AbsoluteEncoder
    }

    /// Every pending command but moves ends with `failure`, and what they were doing ends with them.
    pub(super) fn fail_commands(&mut self, failure: Failure) {
        self.fail_commands_but_stops(failure);
        self.fail_stops(failure);
    }

    /// Those who wait for a stop fail with `failure`, or with the fault that has overtaken them.
    fn fail_stops(&mut self, failure: Failure) {
        while let Some((id, instead)) = self.stopping.next_waiter() {
            self.done(id, Err(instead.unwrap_or(failure)));
        }
    }

    /// The same, where those who wait for a stop wait on.
    fn fail_commands_but_stops(&mut self, failure: Failure) {
        if let Some(id) = self.power.take_waiter() {
            self.done(id, Err(failure));
        }
        self.fail_mode_change(failure);
        self.fail_resume(failure);
    }

    /// The same, and those who wait for a halt fail.
    fn fail_others(&mut self, failure: Failure) {
        self.fail_commands_but_stops(failure);
        while let Some(id) = self
            .stopping
            .take_waiter(|wait| matches!(wait, Wait::Halt { .. }))
        {
            self.done(id, Err(failure));
        }
    }

    /// The one composer of controlwords.
    fn compose(&self) -> ComposedWord {
        let state = self.state();
        let traits = &self.config.traits;
        let command = if self.stopping.is_quick() {
            PowerCommand::QuickStop
        } else if self.stopping.is_switching_off()
            && (state == State::OperationEnabled || self.stopping.off)
        {
            // A drive that ignores quick stop, in every other state of which it may still brake the axis; or one that has stopped the axis by it.
            PowerCommand::DisableVoltage
        } else {
            let command = self.power.command(state, self.sample.as_ref(), traits);
            if self.power.leads_down(command) && self.brake.holds(self.is_standing()) {
                PowerCommand::QuickStop
            } else {
                command
            }
        };
        if command == PowerCommand::QuickStop
            && !self.power.allows_mode_bits()
            && !self.is_standing()
        {
            // During quick stop they stay as they were sent last.
            return ComposedWord::after(command, self.sent, self.manufacturer);
        }
        // A drive that is late in its transitions would go on for a moment if bit 8 fell before it is out of Operation enabled, where a fault
        // reaction may lead, too.
        let obeys = || matches!(state, State::OperationEnabled | State::FaultReactionActive);
        let sent = self.sent.contains(Controlword::HALT);
        let kept = sent && !self.power.allows_mode_bits() && obeys();
        let halt = self.halted || kept;
        ComposedWord::new(command, self.mode_bits(), halt, self.manufacturer)
    }

    fn write_outputs(&mut self, outputs: &mut [u8]) {
        self.outgoing = self.compose();
        self.outgoing_velocity = self.target_velocity();
        self.idle_path = IdlePath::No;
        self.change = SnapshotChange::Anything;
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
            CommandedMode::of_core(self.mode),
            self.sequencer.target(),
            parameters,
        );
        fields.write_velocity(outputs, self.outgoing_velocity);
    }
}

// What the core is asked for, what a cycle brings it, and what is known of the axis after that.

/// A command to an axis. Each gives exactly one last event ([`Event::Done`]).
///
/// ```
/// use core::time::Duration;
/// use servocrab::axis::{AxisCore, AxisFields, Command, CommandId, CoreConfig, Event};
/// let mut axis = AxisCore::new(CoreConfig::new(AxisFields::at(0, 0)));
/// // An axis that is not enabled refuses to resume, at once.
/// axis.submit(Duration::ZERO, CommandId(7), Command::Resume, &mut [0; 6]);
/// assert!(matches!(axis.poll_event(), Some((CommandId(7), Event::Done(Err(_))))));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Command {
    /// To Operation enabled, from every state but Fault.
    Enable,
    /// To Ready to switch on or below; a moving or halted axis is stopped before, by halt and quick stop.
    Disable,
    /// Out of Fault, to Switch on disabled.
    ResetFault,
    /// Modes of operation 6060h, confirmed in 6061h; only while no set-point is active.
    SelectMode(Mode),
    /// As [`SelectMode`](Self::SelectMode), up to where 6060h may be written: for drives that get it by SDO. It ends well as
    /// [`Completion::Prepared`](super::Completion::Prepared).
    PrepareMode(Mode),
    /// A homing in homing mode, with the parameters that the drive holds.
    Home(HomingCommand),
    /// A velocity in Profile Velocity mode, until [`AxisCore::release_jog`](AxisCore::release_jog) or a stop.
    Jog(JogSetPoint),
    /// A move in Profile Position mode. An end velocity 6082h that is not in the process data counts as written already.
    Move(MoveCommand),
    /// Says whether such a move would be refused now, and why; nothing is sent. Parameters that are not in the process data
    /// count as written already.
    CheckMove(MoveCommand),
    /// Says whether a homing would be refused now, and why; nothing is sent.
    CheckHome,
    /// Says whether a jog with this velocity would be refused now, and why; nothing is sent.
    CheckJog(i32),
    /// What moves are checked against from now on.
    SetLimits(Limits),
    /// Bit 8: pause, keeping the set-point.
    Halt,
    /// Bit 8 low: go on.
    Resume,
    /// Halt, then abandon the set-point by quick stop.
    Stop,
    /// Bit 2 low.
    QuickStop,
    /// Leave the mode: bit 4 low, the set-point abandoned as by `Stop`.
    Release,
}

impl Command {
    /// Whether it enables, starts or resumes, or asks whether that would be refused.
    const fn sets_going(&self) -> bool {
        match self {
            Self::Enable
            | Self::Resume
            | Self::Home(_)
            | Self::Jog(_)
            | Self::Move(_)
            | Self::CheckMove(_)
            | Self::CheckHome
            | Self::CheckJog(_) => true,
            Self::Disable
            | Self::ResetFault
            | Self::SelectMode(_)
            | Self::PrepareMode(_)
            | Self::SetLimits(_)
            | Self::Halt
            | Self::Stop
            | Self::QuickStop
            | Self::Release => false,
        }
    }
}

bitflags! {
    /// Stops asked for outside the command queue: the stop lane.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub struct StopRequest: u8 {
        /// Pause (bit 8); a quick stop where 605Dh is 0.
        const HALT = 1;
        /// Halt, then abandon the set-point by quick stop.
        const STOP = 2;
        /// Quick stop (bit 2).
        const QUICK_STOP = 4;
    }
}

/// What one cycle's exchange brought for an axis.
///
/// ```
/// use servocrab::axis::Inputs;
/// // The drive's bytes, where its datagram came back; the frame itself is lost in the second cycle.
/// let process_data = [0x37, 0x02, 0x10, 0x27, 0, 0];
/// let cycles = [Inputs::Fresh(&process_data), Inputs::Stale];
/// # assert_ne!(cycles[0], cycles[1]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Inputs<'a> {
    /// The working counter was right: these inputs are of this cycle and the outputs were delivered.
    Fresh(&'a [u8]),
    /// The drive answered, but the working counter was wrong: fresh inputs, outputs perhaps not delivered.
    Answered(&'a [u8]),
    /// Nothing came back from the drive.
    Stale,
}

impl<'a> Inputs<'a> {
    /// Decides by the working counter of their datagram what inputs are worth.
    ///
    /// ```
    /// use servocrab::axis::Inputs;
    /// assert_eq!(Inputs::from_wkc(3, 3, &[0x31]), Inputs::Fresh(&[0x31]));
    /// assert_eq!(Inputs::from_wkc(2, 3, &[0x31]), Inputs::Stale);
    /// ```
    #[must_use]
    pub const fn from_wkc(working_counter: u16, expected: u16, inputs: &'a [u8]) -> Self {
        if working_counter == expected {
            Self::Fresh(inputs)
        } else {
            Self::Stale
        }
    }
}

/// What is known of an axis after a cycle, with position and velocity in the unit of the handle that it comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(
    feature = "serde",
    serde(bound(serialize = "U::Signed: serde::Serialize"))
)]
pub struct Snapshot<U: AxisUnit = Counts> {
    /// How many cycles there were since the first one, with and without inputs.
    pub cycle: u64,
    /// Consecutive cycles that brought no inputs; 0 when the other fields are of this cycle.
    pub age: u32,
    /// Whether the drive answered in this cycle.
    pub answered: bool,
    /// Whether the drive counts as lost.
    pub lost: bool,
    /// Statusword 6041h.
    pub statusword: Statusword,
    /// The state it shows.
    pub state: State,
    /// The controlword 6040h in the outputs now.
    pub controlword: Controlword,
    /// Modes of operation display 6061h; [`Mode::None`] while not known.
    pub mode: Mode,
    /// Position actual value 6064h.
    pub position: U::Signed,
    /// Velocity actual value 606Ch; 0 where it is not mapped.
    pub velocity: U::Signed,
    /// Whether the axis is halted (bit 8).
    pub halted: bool,
    /// Whether the axis has a set-point, or may have one.
    pub has_set_point: bool,
    /// Whether the axis knows where it is: by [`Referencing`].
    pub referenced: bool,
}

impl Snapshot {
    /// The same with position and velocity in another unit.
    #[must_use]
    pub fn in_unit<U: AxisUnit>(&self, scale: &Scale) -> Snapshot<U> {
        Snapshot {
            position: scale.position_in::<U>(self.position),
            velocity: scale.velocity_in::<U>(self.velocity),
            cycle: self.cycle,
            age: self.age,
            answered: self.answered,
            lost: self.lost,
            statusword: self.statusword,
            state: self.state,
            controlword: self.controlword,
            mode: self.mode,
            halted: self.halted,
            has_set_point: self.has_set_point,
            referenced: self.referenced,
        }
    }
}

// What the outputs may hold in 6040h and 6060h. `AxisFields` writes nothing else there, and nothing outside of this module can make it.

mod commanded {
    use crate::ds402::{Controlword, Mode, ModeBits, PowerCommand};
    #[cfg(feature = "std")]
    use crate::profile_position::Completion;

    /// A controlword 6040h that may be sent. Bits 0 to 3 and 7 are those of a power command, bits 4, 5, 6 and 9 those of the active mode, bit 8
    /// is the halt, and bits 11 to 15 are the manufacturer's. Nothing sets bit 10.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    pub(in super::super) struct ComposedWord(Controlword);

    impl ComposedWord {
        /// Of an axis that has been sent nothing.
        pub const DISABLE_VOLTAGE: Self = Self(Controlword::DISABLE_VOLTAGE);

        #[inline]
        pub fn new(
            command: PowerCommand,
            mode_bits: ModeBits,
            halt: bool,
            manufacturer: ManufacturerBits,
        ) -> Self {
            let halt = if halt {
                Controlword::HALT
            } else {
                Controlword::empty()
            };
            Self(
                command
                    .controlword()
                    .union(mode_bits.word())
                    .union(halt)
                    .union(manufacturer.0),
            )
        }

        /// With the bits of the mode and bit 8 as they were sent last.
        #[inline]
        pub fn after(command: PowerCommand, sent: Self, manufacturer: ManufacturerBits) -> Self {
            let kept = sent.0.intersection(ModeBits::MASK.union(Controlword::HALT));
            Self(command.controlword().union(kept).union(manufacturer.0))
        }

        /// The word itself, to be looked at.
        #[inline]
        pub const fn word(self) -> Controlword {
            self.0
        }

        /// Whether all of these bits are set.
        #[inline]
        pub const fn contains(self, bits: Controlword) -> bool {
            self.0.contains(bits)
        }
    }

    /// Bits 11 to 15 of the controlword. It can hold no others.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    pub(in super::super) struct ManufacturerBits(Controlword);

    impl ManufacturerBits {
        pub const NONE: Self = Self(Controlword::empty());

        /// These bits without the others.
        pub fn of(bits: Controlword) -> Self {
            Self(bits.intersection(Controlword::MANUFACTURER))
        }
    }

    /// A mode that may be written to 6060h.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub(crate) struct CommandedMode(Mode);

    impl CommandedMode {
        /// The one that the axis core holds in its outputs.
        #[inline]
        pub(in super::super) const fn of_core(mode: Mode) -> Self {
            Self(mode)
        }

        /// The one that the axis core has said may be written by SDO now; none if it has said something else.
        #[cfg(feature = "std")]
        pub const fn by_sdo(said: Completion) -> Option<Self> {
            match said {
                Completion::Prepared { mode } => Some(Self(mode)),
                Completion::Done
                | Completion::Reached { .. }
                | Completion::Passed { .. }
                | Completion::Homed { .. }
                | Completion::Stopped { .. } => None,
            }
        }

        /// As 6060h has it.
        #[inline]
        pub const fn byte(self) -> u8 {
            self.0.raw().cast_unsigned()
        }
    }

    #[cfg(test)]
    mod tests {
        use super::*;
        use crate::ds402::SetPointBits;

        #[test]
        fn each_bit_of_a_composed_word_comes_from_its_owner_alone() {
            let all = ModeBits::of_set_point(SetPointBits {
                change_set_immediately: true,
                relative: true,
                change_on_set_point: true,
            });
            for command in [
                PowerCommand::DisableVoltage,
                PowerCommand::Shutdown,
                PowerCommand::SwitchOn,
                PowerCommand::EnableOperation,
                PowerCommand::QuickStop,
                PowerCommand::FaultReset,
            ] {
                let power = command.controlword().bits();
                assert_eq!(power & !0x008F, 0, "{command:?}");
                for (mode, mode_bits) in [
                    (ModeBits::NONE, 0),
                    (ModeBits::HOMING_START, 0x0010),
                    (all.with_new_set_point(), 0x0270),
                ] {
                    for halt in [false, true] {
                        for asked in [0, 0x07FF, 0xF800, 0xFFFF] {
                            let own = ManufacturerBits::of(Controlword::from_bits_retain(asked));
                            let word = ComposedWord::new(command, mode, halt, own);
                            let kept = mode_bits | u16::from(halt) << 8;
                            let others = power | asked & 0xF800;
                            assert_eq!(word.word().bits(), kept | others, "{command:?}");
                            let quick = PowerCommand::QuickStop;
                            let after = ComposedWord::after(quick, word, ManufacturerBits::NONE);
                            assert_eq!(after.word().bits(), kept | 0x000B, "{command:?}");
                        }
                    }
                }
            }
        }
    }
}

// Where the axis' objects lie in its drive's process data.

/// How 60FFh is named to people.
pub(crate) const TARGET_VELOCITY: &str = "target velocity 60FFh";

/// Byte offsets of an axis' objects in the drive's outputs and inputs. The mandatory ones are not optional.
///
/// ```
/// use servocrab::axis::AxisFields;
/// // 6040h, 607Ah in the outputs; 6041h, 6064h in the inputs.
/// let fields = AxisFields { target: 2, position: 2, ..AxisFields::at(0, 0) };
/// assert_eq!(fields.controlword, 0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AxisFields {
    /// Controlword 6040h, 16 bits, in the outputs.
    pub controlword: usize,
    /// Target position 607Ah, 32 bits, in the outputs.
    pub target: usize,
    /// Modes of operation 6060h, 8 bits, in the outputs.
    pub mode: Option<usize>,
    /// Profile velocity 6081h, 32 bits, in the outputs.
    pub velocity: Option<usize>,
    /// End velocity 6082h, 32 bits, in the outputs.
    pub end_velocity: Option<usize>,
    /// Profile acceleration 6083h, 32 bits, in the outputs.
    pub acceleration: Option<usize>,
    /// Profile deceleration 6084h, 32 bits, in the outputs.
    pub deceleration: Option<usize>,
    /// Motion profile type 6086h, 16 bits, in the outputs.
    pub profile_type: Option<usize>,
    /// Target velocity 60FFh, 32 bits, in the outputs.
    pub target_velocity: Option<usize>,
    /// Statusword 6041h, 16 bits, in the inputs.
    pub statusword: usize,
    /// Position actual value 6064h, 32 bits, in the inputs.
    pub position: usize,
    /// Modes of operation display 6061h, 8 bits, in the inputs.
    pub mode_display: Option<usize>,
    /// Velocity actual value 606Ch, 32 bits, in the inputs.
    pub actual_velocity: Option<usize>,
    /// Error code 603Fh, 16 bits, in the inputs.
    pub error_code: Option<usize>,
}

impl AxisFields {
    /// The mandatory objects packed from these byte offsets on (controlword, target; statusword, position), no others.
    #[must_use]
    pub const fn at(outputs: usize, inputs: usize) -> Self {
        Self {
            controlword: outputs,
            target: outputs + 2,
            mode: None,
            velocity: None,
            end_velocity: None,
            acceleration: None,
            deceleration: None,
            profile_type: None,
            target_velocity: None,
            statusword: inputs,
            position: inputs + 2,
            mode_display: None,
            actual_velocity: None,
            error_code: None,
        }
    }

    /// The axis' objects where a mapping has put them; `offset` is that of the axis in its drive.
    ///
    /// ```
    /// use servocrab::{axis::AxisFields, coe::AxisOffset, drives};
    /// let layout = drives::akd2g().default_mapping()?.layout();
    /// let second = AxisFields::from_layout(&layout, AxisOffset::of_axis(2))?;
    /// assert_eq!((second.controlword, second.statusword), (19, 11));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`FieldError`] if 6040h, 607Ah, 6041h or 6064h is not mapped, or an object is not byte-aligned with its own width.
    pub fn from_layout(layout: &Layout, offset: AxisOffset) -> Result<Self, FieldError> {
        let find = |direction, object: AnyObject| -> Result<Option<usize>, FieldError> {
            let object = object.offset(offset);
            let address = object.address();
            match layout.find(direction, address.index, address.subindex) {
                None => Ok(None),
                Some(place) if place.bit == 0 && place.bits == object.bits() => {
                    Ok(Some(place.byte))
                }
                Some(_) => Err(FieldError::Misplaced { object: address }),
            }
        };
        let output = |object| find(Direction::Outputs, object);
        let input = |object| find(Direction::Inputs, object);
        let must = |direction, object: AnyObject| {
            find(direction, object)?.ok_or(FieldError::Missing {
                object: object.offset(offset).address(),
                direction,
            })
        };
        Ok(Self {
            controlword: must(Direction::Outputs, obj::CONTROLWORD.into())?,
            target: must(Direction::Outputs, obj::TARGET_POSITION.into())?,
            mode: output(obj::MODE_OF_OPERATION.into())?,
            velocity: output(obj::PROFILE_VELOCITY.into())?,
            end_velocity: output(obj::END_VELOCITY.into())?,
            acceleration: output(obj::PROFILE_ACCELERATION.into())?,
            deceleration: output(obj::PROFILE_DECELERATION.into())?,
            profile_type: output(obj::MOTION_PROFILE_TYPE.into())?,
            target_velocity: output(obj::TARGET_VELOCITY.into())?,
            statusword: must(Direction::Inputs, obj::STATUSWORD.into())?,
            position: must(Direction::Inputs, obj::POSITION_ACTUAL.into())?,
            mode_display: input(obj::MODE_OF_OPERATION_DISPLAY.into())?,
            actual_velocity: input(obj::VELOCITY_ACTUAL.into())?,
            error_code: input(obj::ERROR_CODE.into())?,
        })
    }

    /// The parameters as they go into the process data: given ones, else what the drive held. An end velocity that is not mapped has been
    /// written by SDO; it is kept, for the axis goes on at it.
    pub(super) fn complete(
        &self,
        given: &Parameters,
        held: &Parameters,
    ) -> Result<Parameters, Failure> {
        if given.profile_type.is_some() && self.profile_type.is_none() {
            return Err(Failure::NotMapped("motion profile type 6086h"));
        }
        Ok(Parameters {
            velocity: speed(
                self.velocity.is_some(),
                given.velocity,
                held.velocity,
                "profile velocity 6081h",
            )?,
            acceleration: speed(
                self.acceleration.is_some(),
                given.acceleration,
                held.acceleration,
                "profile acceleration 6083h",
            )?,
            deceleration: speed(
                self.deceleration.is_some(),
                given.deceleration,
                held.deceleration,
                "profile deceleration 6084h",
            )?,
            // Left out means what the drive held, and 0 (stop at the target, linear ramps) where nobody has said.
            end_velocity: given
                .end_velocity
                .or(held.end_velocity)
                .or(self.end_velocity.map(|_| 0)),
            profile_type: given
                .profile_type
                .or(held.profile_type)
                .or(self.profile_type.map(|_| 0)),
        })
    }

    /// Without the parameters that go by SDO alone. An end velocity stays: the axis goes on at it, however it is written.
    pub(super) fn mapped(&self, parameters: &Parameters) -> Parameters {
        Parameters {
            velocity: parameters.velocity.filter(|_| self.velocity.is_some()),
            acceleration: parameters
                .acceleration
                .filter(|_| self.acceleration.is_some()),
            deceleration: parameters
                .deceleration
                .filter(|_| self.deceleration.is_some()),
            end_velocity: parameters.end_velocity,
            profile_type: parameters
                .profile_type
                .filter(|_| self.profile_type.is_some()),
        }
    }

    /// The ramps of a jog as they go into the process data: given ones, else what the drive held.
    pub(super) fn complete_jog(
        &self,
        jog: &mut JogSetPoint,
        held: &Parameters,
    ) -> Result<(), Failure> {
        if self.target_velocity.is_none() {
            return Err(Failure::NotMapped(TARGET_VELOCITY));
        }
        jog.acceleration = speed(
            self.acceleration.is_some(),
            jog.acceleration,
            held.acceleration,
            "profile acceleration 6083h",
        )?;
        jog.deceleration = speed(
            self.deceleration.is_some(),
            jog.deceleration,
            held.deceleration,
            "profile deceleration 6084h",
        )?;
        Ok(())
    }

    /// Reads the axis' objects out of the drive's inputs; nothing where they are too short.
    pub(crate) fn sample(&self, inputs: &[u8], noted_mode: Mode) -> Option<Sample> {
        let mode = match self.mode_display {
            Some(at) => Mode::from_raw(i8::from_le_bytes(read(inputs, at)?)),
            None => noted_mode,
        };
        let velocity = match self.actual_velocity {
            Some(at) => Some(i32::from_le_bytes(read(inputs, at)?)),
            None => None,
        };
        let error_code = match self.error_code {
            Some(at) => Some(u16::from_le_bytes(read(inputs, at)?)),
            None => None,
        };
        Some(Sample {
            statusword: Statusword::from_bits_retain(u16::from_le_bytes(read(
                inputs,
                self.statusword,
            )?)),
            mode,
            position: i32::from_le_bytes(read(inputs, self.position)?),
            velocity,
            error_code,
        })
    }

    /// Controlword and target position in the drive's outputs; nothing where they are too short.
    #[cfg(feature = "std")]
    pub(crate) fn sent(&self, outputs: &[u8]) -> Option<(crate::ds402::Controlword, i32)> {
        let controlword = u16::from_le_bytes(read(outputs, self.controlword)?);
        let target = i32::from_le_bytes(read(outputs, self.target)?);
        let controlword = crate::ds402::Controlword::from_bits_retain(controlword);
        Some((controlword, target))
    }

    /// Whether the drive's inputs show nothing that is new beside the motion.
    #[inline]
    fn shows(&self, inputs: &[u8], status_key: &StatusKey) -> bool {
        read(inputs, self.statusword) == Some(status_key.statusword)
            && self
                .mode_display
                .is_none_or(|at| read(inputs, at) == Some(status_key.mode))
            && self
                .error_code
                .is_none_or(|at| read(inputs, at) == Some(status_key.error_code))
    }

    /// Position and velocity out of the drive's inputs; a velocity that is not mapped is 0.
    #[inline]
    fn motion(&self, inputs: &[u8]) -> Option<(i32, i32)> {
        let velocity = match self.actual_velocity {
            Some(at) => i32::from_le_bytes(read(inputs, at)?),
            None => 0,
        };
        Some((i32::from_le_bytes(read(inputs, self.position)?), velocity))
    }

    /// Writes the target position alone.
    fn write_target(&self, outputs: &mut [u8], target: i32) {
        put(outputs, Some(self.target), Some(target.to_le_bytes()));
    }

    /// Writes the target velocity, where it is mapped.
    fn write_velocity(&self, outputs: &mut [u8], velocity: i32) {
        put(outputs, self.target_velocity, Some(velocity.to_le_bytes()));
    }

    /// Writes the axis' objects into the drive's outputs. What is not known (parameters that nobody gave) stays.
    fn write(
        &self,
        outputs: &mut [u8],
        controlword: ComposedWord,
        mode: CommandedMode,
        target: i32,
        parameters: &Parameters,
    ) {
        put(
            outputs,
            Some(self.controlword),
            Some(controlword.word().bits().to_le_bytes()),
        );
        put(outputs, Some(self.target), Some(target.to_le_bytes()));
        put(outputs, self.mode, Some([mode.byte()]));
        put(
            outputs,
            self.velocity,
            parameters.velocity.map(u32::to_le_bytes),
        );
        put(
            outputs,
            self.end_velocity,
            parameters.end_velocity.map(u32::to_le_bytes),
        );
        put(
            outputs,
            self.acceleration,
            parameters.acceleration.map(u32::to_le_bytes),
        );
        put(
            outputs,
            self.deceleration,
            parameters.deceleration.map(u32::to_le_bytes),
        );
        put(
            outputs,
            self.profile_type,
            parameters.profile_type.map(i16::to_le_bytes),
        );
    }
}

/// What inputs show beside the motion, as bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct StatusKey {
    statusword: [u8; 2],
    mode: [u8; 1],
    error_code: [u8; 2],
}

impl StatusKey {
    fn of(sample: &Sample) -> Self {
        Self {
            statusword: sample.statusword.bits().to_le_bytes(),
            mode: sample.mode.raw().to_le_bytes(),
            error_code: sample.error_code.unwrap_or(0).to_le_bytes(),
        }
    }
}

/// A parameter that must not be 0 as it goes into the process data, where it is mapped.
const fn speed(
    mapped: bool,
    given: Option<u32>,
    held: Option<u32>,
    name: &'static str,
) -> Result<Option<u32>, Failure> {
    let value = match given {
        None => held,
        given => given,
    };
    match (mapped, given, value) {
        (false, Some(_), _) => Err(Failure::NotMapped(name)),
        (false, None, _) => Ok(None),
        (true, _, None) => Err(Failure::Missing(name)),
        (true, _, Some(0)) => Err(Failure::Zero(name)),
        (true, _, some) => Ok(some),
    }
}

/// A mapping that an axis cannot work with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FieldError {
    /// An object without which no axis works is not mapped.
    #[error("{object} is not mapped into the {direction}: an axis cannot work without it")]
    Missing {
        /// The object.
        object: ObjectAddress,
        /// Where it belongs.
        direction: Direction,
    },
    /// An object of the axis does not begin at a byte, or has another width than its type.
    #[error("{object} must be mapped with its own width, beginning at a byte")]
    Misplaced {
        /// The object.
        object: ObjectAddress,
    },
}

#[inline]
fn read<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

fn put<const N: usize>(bytes: &mut [u8], at: Option<usize>, value: Option<[u8; N]>) {
    if let (Some(at), Some(value)) = (at, value)
        && let Some(place) = bytes.get_mut(at..).and_then(<[u8]>::first_chunk_mut)
    {
        *place = value;
    }
}

// What a cycle brought: inputs, or none, and when a drive counts as lost.

/// How far apart the cycles with inputs are: a host that stalls sees as little as one whose frames are lost.
#[derive(Debug, Clone, Copy, Default)]
struct CycleSpacing {
    /// The last cycle with inputs that was computed as a whole.
    last: (u64, Duration),
    /// From one to the next, of the last two between which none was that was not computed as a whole.
    gap: Option<Duration>,
    /// For how many cycles nothing was seen before the last one, by the clock; 0 where that is not known.
    pub stalled: u32,
}

impl CycleSpacing {
    /// Takes in a cycle with inputs, after so many without.
    fn update(&mut self, now: Duration, cycle: u64, stale: u32) {
        let (last, at) = core::mem::replace(&mut self.last, (cycle, now));
        let cycles = stale.saturating_add(1);
        // Between others lie those that were not computed as a whole.
        let gap = (cycle.wrapping_sub(last) == u64::from(cycles)).then(|| {
            let time = now.saturating_sub(at);
            // A division is dear.
            if cycles == 1 { time } else { time / cycles }
        });
        let before = self.gap;
        self.gap = gap.or(before);
        self.stalled = match (before, gap) {
            (Some(before), Some(gap)) if gap.saturating_sub(before) > before => {
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
    fn take_in(&mut self, now: Duration, inputs: Inputs<'_>) -> bool {
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
            self.spacing.update(now, self.cycle, self.stale_cycles);
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
        self.update_quiet(now, delivered);
        if let Some(sample) = sample {
            if self.begins_to_stop(now, sample.state()) {
                self.standstill.begin_anew();
            }
            let halt_delivered = self.halt_delivered.is_some();
            self.stopping.unanswered.update(&sample, halt_delivered);
            self.sample = Some(sample);
            if self.blind_cycles != 0 {
                self.standstill.note_loss(now, &self.bounds);
            }
            self.standstill
                .update(now, sample.position, sample.velocity, &self.bounds);
            if self.awaits_standstill() {
                self.last_seen.update(now, &sample, &self.bounds);
            } else {
                self.last_seen = LastSeen::default();
            }
            let enables = self.sent.contains(Controlword::ENABLE_OPERATION);
            self.brake.note_sent(now, enables, delivered);
            self.brake.update(
                now,
                sample.state(),
                self.standstill.is_standing(),
                !self.power.leads_up(),
                &self.config.traits,
                self.config.deadlines.standstill,
            );
            self.update(now, &sample, delivered);
        }
        let loss = self.config.loss;
        if !self.lost
            && (self.stale_cycles >= loss.stale_cycles
                || (self.undelivered_cycles >= loss.undelivered_cycles && !self.awaits_op))
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
        let led_to = is_down(state) && state != State::ReadyToSwitchOn;
        let obeys = self.stopping.is_quick() && (led_to || state == State::QuickStopActive);
        (leaves || enters)
            && !(self.is_standing()
                && (!(self.has_motion() || self.given_up) || (obeys && self.stands_halted(now))))
    }

    /// Whether a motion may begin with the outputs composed last.
    fn sets_off(&self) -> bool {
        let (outgoing, sent) = (self.outgoing.word(), self.sent.word());
        let rises = outgoing.difference(sent);
        let falls = sent.difference(outgoing);
        rises.contains(Controlword::NEW_SET_POINT)
            // Without a set-point nothing goes on by it.
            || (falls.contains(Controlword::HALT) && self.has_motion())
            || (self.sent_velocity == 0 && self.outgoing_velocity != 0)
    }

    /// The drive does not answer, or whether it receives its outputs is not known: everything ends, and what still reaches it is a
    /// quick stop. Of one that answers, those who wait for a stop wait for what it shows.
    fn lose(&mut self, now: Duration) {
        self.lost = true;
        self.homed_before_loss |= self.homed;
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
        if driven {
            self.fallen = Some(failure);
            self.begin_quick_stop(now);
        }
    }

    /// What is said of commands of a drive that counts as lost.
    fn failure_of_loss(&self) -> Failure {
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

// What each cycle's inputs mean for the commands that are under way.

/// A stop by bit 8 leaves this part of the time for standstill to its quick stop.
const QUICK_STOP_PART: u32 = 8;

/// Between its arrival and its rest an axis without a set-point is within so many position windows: more is a motion, and is
/// stopped.
const SETTLES_WITHIN: u32 = 4;

impl AxisCore {
    /// Takes in one cycle with fresh inputs.
    fn update(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let state = sample.state();
        if state.is_fault() {
            self.update_fault(now);
        }
        self.update_mode_change(now, sample);
        self.update_power(now, sample, delivered);
        self.update_halt(now, sample, delivered);
        self.update_stop(now, sample, delivered);
        if state == State::OperationEnabled && self.power.is_driving() {
            self.bit_11_is_valid |= !sample.statusword.contains(Statusword::INTERNAL_LIMIT);
            self.update_mode(now, sample, delivered);
        } else if !self.power.is_driving() && !self.outgoing_starts() {
            self.sequencer.follow_position(sample.position);
        }
    }

    /// A fault ends everything; nothing here resets it. Should the drive go on by itself, the axis is led down. Who waits for a stop
    /// waits for the standstill.
    fn update_fault(&mut self, now: Duration) {
        let failure = self.fault().unwrap_or(Failure::Fault { code: None });
        if self.power.is_driving() {
            self.fallen = Some(failure);
        }
        if let Power::Disabling { id, .. } = self.power {
            self.power = Power::Off;
            self.wait_for_stop(now, id);
            self.stopping.note_fault(failure);
        }
        if !matches!(self.stopping.phase, StopPhase::Settling { .. }) {
            self.stopping.off = false;
            self.stopping.phase = if self.stopping.note_fault(failure) {
                self.settling(now)
            } else {
                StopPhase::None
            };
        }
        // A reset that is under way goes on to its own end, also where another state was shown between two faults.
        if !matches!(self.power, Power::Resetting { .. }) {
            self.fail_motions(failure);
            self.fail_others(failure);
            self.leave_operation(Power::Off);
        }
    }

    /// Waiting for the standstill of an axis that is stopped already, as far as this can be.
    pub(super) fn settling(&self, now: Duration) -> StopPhase {
        StopPhase::Settling {
            until: now.saturating_add(self.config.deadlines.standstill),
        }
    }

    /// The drive is out of Operation enabled: bits 4 and 8 fall.
    fn leave_operation(&mut self, power: Power) {
        // A reset that is under way goes on to its own end.
        if !matches!(self.power, Power::Resetting { .. }) {
            self.power = power;
        }
        self.lower_halt();
        self.lower_mode_bits();
    }

    /// Bit 8 falls.
    const fn lower_halt(&mut self) {
        self.halted = false;
        self.halt_delivered = None;
    }

    fn update_power(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let state = sample.state();
        match self.power {
            Power::Off => {
                // What was left of a motion for which nobody waits any more.
                let left = self.stopping.has_no_waiter() && (self.halted || self.has_motion());
                if left && self.is_down_at_rest() {
                    self.leave_operation(Power::Off);
                }
            }
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
                let powered = matches!(state, State::OperationEnabled | State::QuickStopActive);
                let stops = state == State::QuickStopActive && self.stopping.is_active();
                if powered && !stops && !self.is_standing() {
                    // It was not at rest after all, or something has set it in motion since.
                    self.power = Power::Off;
                    self.begin_quick_stop(now);
                    self.stopping.off = true;
                    self.wait_for_stop(now, id);
                } else if is_down(state) && self.brake.is_shown_down() && self.is_at_rest() {
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
                    // One that is enabled without having been asked to was not down, whatever it showed: it may hold a set-point.
                    let was_down =
                        was_down && (!enabled || self.sent.contains(Controlword::ENABLE_OPERATION));
                    if down {
                        self.lower_halt();
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
                        self.update_drop(now, state);
                    }
                }
            }
            Power::Resetting { id, phase, edges } => {
                self.update_reset(now, id, phase, edges, state, delivered);
            }
        }
    }

    fn why_not_enabled(&self, sample: &Sample) -> Failure {
        let (statusword, controlword) = (sample.statusword, self.sent.word());
        if !sample.statusword.contains(Statusword::REMOTE) {
            Failure::LocalControl {
                statusword,
                controlword,
            }
        } else if self.config.traits.shows_voltage
            && !sample.statusword.contains(Statusword::VOLTAGE_ENABLED)
        {
            Failure::NoVoltage {
                statusword,
                controlword,
            }
        } else if matches!(
            sample.state(),
            State::SwitchOnDisabled | State::ReadyToSwitchOn
        ) {
            Failure::SwitchOnRefused {
                state: sample.state(),
                statusword,
                controlword,
            }
        } else {
            self.timeout(
                WaitingFor::State(State::OperationEnabled),
                Delivery::NotSent,
            )
        }
    }

    /// The drive has left Operation enabled by itself, or by somebody else's stop.
    fn update_drop(&mut self, now: Duration, state: State) {
        let (failure, power) = if state == State::QuickStopActive {
            (Failure::QUICK_STOPPED, Power::Holding)
        } else {
            (Failure::Disabled { state }, Power::Off)
        };
        self.fallen = Some(failure);
        self.fail_motions(failure);
        self.fail_others(failure);
        self.stopping.off = false;
        self.stopping.phase = if self.stopping.has_no_waiter() {
            StopPhase::None
        } else {
            self.settling(now)
        };
        self.leave_operation(power);
    }

    fn update_reset(
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
            ResetPhase::High { until }
                if now < until && (state == State::Fault || self.is_standing()) =>
            {
                return;
            }
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

    fn update_halt(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        if !self.halted {
            self.stopping.begin_halt();
            // The axis left Operation enabled before it was seen to stand: who waited for the halt waits for that all the same.
            if self.stopping.halts_become_stops() && !self.stopping.is_active() {
                self.stopping.phase = self.settling(now);
            }
            return;
        }
        if delivered && self.sent.contains(Controlword::HALT) {
            self.halt_delivered.get_or_insert(now);
        }
        if self.has_seen_halt(now) {
            let deceleration = &mut self.stopping.deceleration;
            deceleration.update(now, sample.position, &self.bounds);
        }
        if self.stands_halted(now) && !self.stopping.unanswered.is_open() {
            // Of a stop under way the halt is the first part alone: no set-point is kept, and who waits gets the stop as the reason.
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
        while self.stopping.deceleration.ignores_stop()
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
        // One that has come to rest since is left as it is.
        let runs_on = self.stopping.deceleration.ignores_stop() && !self.is_standing();
        if runs_on && self.stopping.unwatched {
            self.begin_quick_stop(now);
        }
    }

    /// Whether bit 8 has brought the axis to rest. With a set-point that may have set it off just before, by what was seen after the
    /// drive has had the time to take bit 8 in.
    fn stands_halted(&self, now: Duration) -> bool {
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

    fn update_stop(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let state = sample.state();
        match self.stopping.phase {
            StopPhase::None => {}
            StopPhase::Halting { until, from } => {
                // An axis that has just come into its window may go past it before it settles.
                let near = self.bounds.position.saturating_mul(SETTLES_WITHIN);
                let distance = |from| self.bounds.distance(from, sample.position);
                let from = from.filter(|&from| distance(from) <= near);
                self.stopping.phase = StopPhase::Halting { until, from };
                if from.is_some() && self.stands_halted(now) {
                    self.finish_without_quick_stop(state);
                    return;
                }
                // A drive that ignores bit 8 would let the axis run on until then.
                let ignored = self.stopping.deceleration.ignores_stop();
                let quick = self.config.deadlines.standstill / QUICK_STOP_PART;
                if ignored || self.stands_halted(now) || now >= until.saturating_sub(quick) {
                    self.begin_quick_stop(now);
                }
            }
            StopPhase::Quick { mut until } => {
                if self.delivers_quick_stop(now, delivered)
                    && until.is_none_or(|until| now >= until)
                {
                    // It gets bit 2 only now, and has its time from now on.
                    until = Some(now.saturating_add(self.config.deadlines.standstill));
                    self.stopping.phase = StopPhase::Quick { until };
                }
                // A drive that stays there although 605Ah said otherwise when it was read is believed in the end.
                let late = until.is_none_or(|until| now >= until);
                let holds = state == State::QuickStopActive
                    && (self.config.quick_stop.stays_in_quick_stop_active() || late);
                let off = matches!(state, State::NotReadyToSwitchOn | State::SwitchOnDisabled);
                let followed = self.has_quick_stopped(now, holds || off);
                if followed && ((holds && self.is_standing()) || (off && self.is_at_rest())) {
                    self.finish_quick_stop(now, state);
                } else if self.ignores_quick_stop(now, sample, delivered, late) {
                    self.give_quick_stop_up(now);
                } else if self.stopping.quick_delivered.is_none() && late && until.is_some() {
                    self.give_waiting_up(state);
                }
            }
            StopPhase::Settling { until } => {
                // A disable under way leads the drive down by itself, and stops the axis if it moves after all.
                let disables = matches!(self.power, Power::Disabling { .. });
                let powered = matches!(state, State::OperationEnabled | State::QuickStopActive);
                let has_no_power = is_down(state) || state.is_fault();
                if powered && !disables {
                    self.cancel_enabling(Failure::QUICK_STOPPED);
                    self.stopping.off |= !matches!(self.power, Power::Holding);
                    let standstill = self.config.deadlines.standstill;
                    self.stopping.begin_quick(now.saturating_add(standstill));
                } else if self.is_at_rest_for_good() && (!self.stopping.off || has_no_power) {
                    self.finish_stop(state);
                } else if now >= until {
                    self.give_waiting_up(state);
                }
            }
            StopPhase::Off { until } => {
                if is_down(state) && self.brake.is_shown_down() {
                    self.leave_operation(self.power);
                    if self.is_at_rest() || self.stopping.has_no_waiter() {
                        self.finish_stop(state);
                    } else {
                        // The words that say so may be wrong: one that is driven still is led down after its stop.
                        self.stopping.phase = self.settling(now);
                        self.stopping.off = true;
                    }
                } else if now >= until {
                    self.stopping.phase = StopPhase::None;
                    self.stopping.off = false;
                    let failure = self.timeout(
                        WaitingFor::State(State::SwitchOnDisabled),
                        Delivery::NotSent,
                    );
                    self.fail_commands(failure);
                }
            }
        }
    }

    /// Waiting stops fail, since the axis does not come to rest, and its power goes. A drive that is not known to have got the quick stop is
    /// commanded on.
    fn give_waiting_up(&mut self, state: State) {
        let failure = self.timeout(self.standstill_awaited(), Delivery::NotSent);
        self.fail_motions(failure);
        // A reset has its own deadlines.
        if !matches!(self.power, Power::Resetting { .. }) {
            self.fail_commands_but_stops(failure);
        }
        self.fail_stops(failure);
        if state == State::OperationEnabled {
            self.stopping.phase = StopPhase::Quick { until: None };
            return;
        }
        self.stopping.phase = StopPhase::None;
        self.stopping.off = false;
        if self.stopping.sent_since.is_some() {
            self.brake.give_up();
        }
        self.leave_operation(Power::Off);
    }

    fn finish_quick_stop(&mut self, now: Duration, state: State) {
        let off = self.stopping.off;
        let failure = if off {
            Failure::Disabled { state }
        } else {
            Failure::QUICK_STOPPED
        };
        self.fail_motions(failure);
        if state == State::QuickStopActive && off {
            self.leave_operation(Power::Off);
            self.stopping.phase = StopPhase::Off {
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
            self.lower_halt();
            self.stopping.begin_halt();
        }
        self.finish_stop(state);
    }

    fn finish_stop(&mut self, state: State) {
        self.stopping.phase = StopPhase::None;
        self.stopping.off = false;
        while let Some((id, failure)) = self.stopping.next_waiter() {
            self.done(id, failure.map_or(Ok(Completion::Stopped { state }), Err));
        }
    }

    fn update_moves(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        let cycle = cycle!(self, now, sample, delivered);
        if self.sequencer.step(&cycle, &mut self.events) {
            // A set-point that the drive took while halted is kept as well: whoever asked for it gets that answer.
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
            controlword: self.sent.word(),
            delivery,
        }
    }
}

// How each command begins. What it then does from cycle to cycle is above.

impl AxisCore {
    /// Takes a command in, between two steps. What it stops or withdraws is out of the outputs at once. It reports through [`AxisCore::poll_event`], under this id, with exactly one
    /// [`Event::Done`](super::Event::Done).
    pub fn submit(&mut self, now: Duration, id: CommandId, command: Command, outputs: &mut [u8]) {
        self.begin(now, id, command);
        self.write_outputs(outputs);
    }

    fn begin(&mut self, now: Duration, id: CommandId, command: Command) {
        let stops = matches!(
            command,
            Command::Halt
                | Command::Stop
                | Command::Release
                | Command::QuickStop
                | Command::Disable
        );
        let takes = if stops {
            self.takes_stops()
        } else {
            !self.is_lost()
        };
        if !takes {
            let failure = self.failure_of_loss();
            self.done(id, Err(failure));
            return;
        }
        if self.expired && command.sets_going() {
            self.done(id, Err(Failure::LivenessExpired));
            return;
        }
        match command {
            Command::Enable => self.enable(now, id),
            Command::Disable => self.disable(now, id),
            Command::ResetFault => self.reset_fault(now, id),
            Command::SelectMode(mode) => self.select_mode(now, id, mode, false),
            Command::PrepareMode(mode) => self.select_mode(now, id, mode, true),
            Command::Home(command) => self.start_homing(id, command),
            Command::Jog(set_point) => self.start_jog(id, set_point),
            Command::Move(command) => self.start_move(now, id, command),
            Command::CheckMove(command) => {
                let result = self.check_unmapped_move(command).map(|()| Completion::Done);
                self.done(id, result);
            }
            Command::CheckHome => {
                let result = self.check_homing().map(|()| Completion::Done);
                self.done(id, result);
            }
            Command::CheckJog(velocity) => {
                let result = self.check_jogging(velocity).map(|()| Completion::Done);
                self.done(id, result);
            }
            Command::SetLimits(limits) => {
                self.config.limits = self.config.limits_with(limits);
                self.done(id, Ok(Completion::Done));
            }
            Command::Halt => self.halt(now, id),
            Command::Resume => self.resume(now, id),
            Command::Stop => self.stop(now, id),
            Command::QuickStop => self.quick_stop(now, id),
            Command::Release => self.release(now, id),
        }
    }

    fn enable(&mut self, now: Duration, id: CommandId) {
        let refused = if let Some(fault) = self.fault() {
            Some(fault)
        } else if self.stopping.is_active() || (self.stop_unsent && !self.power.is_driving()) {
            Some(Failure::Busy)
        } else {
            match self.power {
                Power::Enabling { .. } | Power::Disabling { .. } | Power::Resetting { .. } => {
                    Some(Failure::Busy)
                }
                Power::Enabled => {
                    self.done(id, Ok(Completion::Done));
                    return;
                }
                Power::Off | Power::Ready | Power::Holding => None,
            }
        };
        if let Some(failure) = refused {
            self.done(id, Err(failure));
            return;
        }
        self.lower_mode_bits();
        let was_down = self.is_down_at_rest();
        if was_down {
            self.lower_halt();
        }
        self.power = Power::Enabling {
            id,
            deadline: now.saturating_add(self.config.deadlines.enable),
            was_down,
            shown: None,
        };
    }

    fn disable(&mut self, now: Duration, id: CommandId) {
        match self.power {
            // Asked for again by those who wait for it.
            Power::Disabling { id: waiter, .. } if waiter == id => return,
            Power::Disabling { .. } => {
                self.done(id, Err(Failure::Busy));
                return;
            }
            _ => {}
        }
        let state = self.state();
        if state.is_fault() {
            self.await_standstill_without_power(now, id);
            return;
        }
        self.cancel_enabling(Failure::Disabled { state });
        self.fail_resume(Failure::Disabled { state });
        if self.begin_stop(now, Failure::Disabled { state }) {
            self.stopping.off |= !self.stopping.is_switching_off();
            self.wait_for_stop(now, id);
            return;
        }
        let deadline = now.saturating_add(self.config.deadlines.disable);
        match self.power {
            Power::Enabled => {
                self.power = Power::Disabling {
                    id,
                    goal: PowerGoal::Ready,
                    deadline,
                };
            }
            // At standstill one word does not say so.
            _ if is_down(state) && (self.brake.is_shown_down() || !self.is_standing()) => {
                self.await_standstill_without_power(now, id);
            }
            _ => {
                // The fault is gone, and the reset of it leads to the same.
                if let Some(reset) = self.power.take_waiter() {
                    self.done(reset, Err(Failure::Disabled { state }));
                }
                self.power = Power::Disabling {
                    id,
                    goal: PowerGoal::Off,
                    deadline,
                }
            }
        }
    }

    fn reset_fault(&mut self, now: Duration, id: CommandId) {
        let state = self.state();
        if matches!(self.power, Power::Resetting { .. }) {
            // Also while no fault is shown: it may come back.
            self.done(id, Err(Failure::Busy));
        } else if !state.is_fault() {
            self.done(id, Err(Failure::NoFault { state }));
        } else {
            let reaction = now.saturating_add(self.config.deadlines.standstill);
            self.power = Power::Resetting {
                id,
                phase: ResetPhase::Low {
                    until: now,
                    reaction,
                    shown: None,
                },
                edges: 0,
            };
        }
    }

    fn start_move(&mut self, now: Duration, id: CommandId, command: MoveCommand) {
        match self.check_move(command) {
            Ok(command) => {
                self.sequencer.submit(id, command, &mut self.events);
                self.start_move_now(now);
            }
            Err(failure) => self.done(id, Err(failure)),
        }
    }

    fn halt(&mut self, now: Duration, id: CommandId) {
        if let Some(fault) = self.fault() {
            self.done(id, Err(fault));
            return;
        }
        if self.power.is_driving() && !self.stopping.is_quick() && !self.halts_under_control() {
            self.done(id, Err(Failure::HaltCoasts));
            return;
        }
        self.begin_halt(now);
        if self.stopping.is_quick() || self.stopping.is_switching_off() {
            self.wait_for_stop(now, id);
        } else if self.power.is_driving() {
            let until = now.saturating_add(self.config.deadlines.standstill);
            if !self.stopping.wait(id, Wait::Halt { until }) {
                self.done(id, Err(Failure::Busy));
            }
        } else {
            self.await_standstill(now, id);
        }
    }

    fn resume(&mut self, now: Duration, id: CommandId) {
        let state = self.state();
        let result = if let Some(fault) = self.fault() {
            Err(fault)
        } else if self.stopping.is_active() {
            Err(Failure::QUICK_STOPPED)
        } else if !self.power.is_driving() {
            Err(Failure::NotEnabled { state })
        } else if self.resuming.is_some() {
            Err(Failure::Busy)
        } else if !self.halted {
            if self.has_motion() {
                Err(Failure::Moving)
            } else {
                self.resuming = Some(Resuming {
                    id,
                    from_rest: None,
                });
                return;
            }
        } else if self.stop_unsent && (self.has_motion() || !self.is_standing()) {
            Err(Failure::Busy)
        } else if self.sequencer.is_unknown() || self.homing.is_unknown() {
            Err(Failure::NeedsStop)
        } else if self.homing.has_motion() {
            Err(Failure::HomingHalted)
        } else if self.sequencer.has_set_point() && !self.config.traits.halt_keeps_set_point {
            Err(Failure::ResumeUnsupported)
        } else {
            self.halted = false;
            let stands = self.stands_halted(now);
            self.resuming = Some(Resuming {
                id,
                from_rest: Some(stands),
            });
            return;
        };
        self.done(id, result);
    }

    /// What was sent last had bit 8 low, and nothing has stopped the axis before that.
    fn finish_resume(&mut self, now: Duration) {
        let Some(Resuming { id, from_rest }) = self.resuming.take() else {
            return;
        };
        if let Some(from_rest) = from_rest {
            self.halt_delivered = None;
            self.sequencer.resumed(now, from_rest);
            while let Some((waiter, _)) = self.stopping.next_waiter() {
                self.done(waiter, Err(Failure::Superseded));
            }
        }
        self.done(id, Ok(Completion::Done));
    }

    /// A stop comes before bit 8 has fallen.
    fn fail_resume(&mut self, failure: Failure) {
        if let Some(Resuming { id, from_rest }) = self.resuming.take() {
            self.halted |= from_rest.is_some();
            self.done(id, Err(failure));
        }
    }

    fn stop(&mut self, now: Duration, id: CommandId) {
        let state = self.state();
        if !state.is_fault() && self.begin_stop(now, Failure::QUICK_STOPPED) {
            self.wait_for_stop(now, id);
        } else {
            self.await_standstill(now, id);
        }
    }

    fn quick_stop(&mut self, now: Duration, id: CommandId) {
        let reacts = self.state() == State::FaultReactionActive;
        if let Some(fault) = self.fault().filter(|_| !reacts) {
            self.done(id, Err(fault));
        } else if self.begin_quick_stop(now) {
            self.wait_for_stop(now, id);
        } else {
            self.await_standstill(now, id);
        }
    }

    fn release(&mut self, now: Duration, id: CommandId) {
        self.stop(now, id);
    }

    /// There is nothing to send: it is done when the axis stands.
    fn await_standstill(&mut self, now: Duration, id: CommandId) {
        if self.is_at_rest_for_good() {
            let state = self.state();
            self.done(id, Ok(Completion::Stopped { state }));
            return;
        }
        if !self.stopping.is_active() {
            self.stopping.phase = self.settling(now);
        }
        self.wait_for_stop(now, id);
    }

    /// The same. A drive that enables the axis meanwhile is led down after its stop.
    fn await_standstill_without_power(&mut self, now: Duration, id: CommandId) {
        self.await_standstill(now, id);
        self.stopping.off = self.stopping.is_active();
    }

    fn wait_for_stop(&mut self, now: Duration, id: CommandId) {
        self.stopping
            .set_deadline(now.saturating_add(self.config.deadlines.standstill));
        if !self.stopping.wait(id, Wait::Stop) {
            self.done(id, Err(Failure::Busy));
        }
    }

    /// Bit 8 from the next frame on. Moves that are not sent fail as halted.
    fn begin_halt(&mut self, now: Duration) {
        self.cancel_enabling(Failure::HALTED);
        if self.runs_unasked() || (self.power.is_driving() && !self.halts_under_control()) {
            self.begin_quick_stop(now);
            return;
        }
        if !self.power.is_driving() || self.stopping.is_quick() || self.state().is_fault() {
            return;
        }
        let unanswered = if self.has_motion() {
            self.unanswered()
        } else {
            Unanswered::default()
        };
        self.withdraw_unsent(Failure::HALTED);
        self.fail_resume(Failure::HALTED);
        self.stop_unsent = true;
        self.stopping.lent = false;
        if !self.halted {
            self.halted = true;
            self.halt_delivered = None;
            self.stopping.begin_halt();
            self.stopping.unanswered = unanswered;
            self.stopping.halt_reported = false;
        }
    }

    /// Halt, with the quick stop to follow. False when the axis stands without a set-point: nothing is sent then.
    /// Moves that are not sent fail as `failure`.
    fn begin_stop(&mut self, now: Duration, failure: Failure) -> bool {
        self.cancel_enabling(failure);
        if self.runs_unasked() || self.stopping.is_switching_off() {
            return self.begin_quick_stop(now);
        }
        if !self.power.is_driving() || self.state().is_fault() {
            return false;
        }
        let disables = matches!(failure, Failure::Disabled { .. });
        if self.stopping.is_active() {
            if disables && let StopPhase::Halting { from, .. } = &mut self.stopping.phase {
                *from = None;
            }
            return true;
        }
        let has_motion = self.has_motion();
        self.withdraw_unsent(failure);
        // Nothing starts in its frame, also where there is nothing to stop.
        self.stop_unsent = true;
        if !has_motion && self.is_standing() {
            return false;
        }
        self.fail_resume(failure);
        if !self.halts_under_control() {
            return self.begin_quick_stop(now);
        }
        let rests_perhaps = !has_motion && !disables && !self.halted;
        let from = match self.sample {
            Some(sample) if rests_perhaps && sample.state() == State::OperationEnabled => {
                Some(sample.position)
            }
            _ => None,
        };
        self.begin_halt(now);
        self.stopping.lent = from.is_some();
        let until = now.saturating_add(self.config.deadlines.standstill);
        self.stopping.phase = StopPhase::Halting { until, from };
        true
    }

    /// Whether bit 8 stops the axis and does not let it coast.
    const fn halts_under_control(&self) -> bool {
        self.config.stop_options.halts_under_control()
    }

    /// Bit 2 low from the next frame on. False when the axis is not enabled: it has nothing to stop.
    fn begin_quick_stop(&mut self, now: Duration) -> bool {
        self.cancel_enabling(Failure::QUICK_STOPPED);
        if self.stopping.is_switching_off() {
            return true;
        }
        let enabled = self.power.is_driving() || self.state() == State::OperationEnabled;
        if self.state().is_fault() || !(enabled || self.runs_unasked()) {
            return false;
        }
        if let Power::Disabling { id, .. } = self.power {
            // What it sends would leave the way in which the axis stops to 605Bh.
            self.power = Power::Off;
            self.stopping.off = true;
            self.wait_for_stop(now, id);
        }
        self.withdraw_unsent(Failure::QUICK_STOPPED);
        self.fail_resume(Failure::QUICK_STOPPED);
        if !self.stopping.is_quick() {
            let standstill = self.config.deadlines.standstill;
            self.stopping.begin_quick(now.saturating_add(standstill));
        }
        true
    }

    /// Whether the drive moves, or holds, an axis that we have not enabled: it is stopping by quick stop. It was found so, or
    /// somebody else has enabled it.
    fn runs_unasked(&self) -> bool {
        let powered = matches!(
            self.state(),
            State::OperationEnabled | State::QuickStopActive
        );
        !self.power.is_driving() && (self.stopping.is_quick() || powered && !self.is_standing())
    }

    fn cancel_enabling(&mut self, failure: Failure) {
        if let Power::Enabling { id, .. } = self.power {
            self.power = Power::Off;
            self.stop_unsent = true;
            self.done(id, Err(failure));
        }
    }

    fn fault(&self) -> Option<Failure> {
        let code = self.error_code();
        let is_fault = self.sample?.state().is_fault();
        is_fault.then_some(Failure::Fault { code })
    }

    /// What 603Fh shows, where it is mapped and not 0.
    pub(crate) fn error_code(&self) -> Option<u16> {
        self.sample?.error_code.filter(|&code| code != 0)
    }
}

/// A resume that is not sent yet.
#[derive(Debug, Clone, Copy, Hash)]
struct Resuming {
    id: CommandId,
    /// Whether the axis goes on from standstill; none if it was not halted.
    from_rest: Option<bool>,
}

/// Whether the power stage is off in this state.
const fn is_down(state: State) -> bool {
    matches!(
        state,
        State::NotReadyToSwitchOn | State::SwitchOnDisabled | State::ReadyToSwitchOn
    )
}

// What a quick stop shows of itself, and when it is given up.

impl AxisCore {
    /// Whether the drive has had the time to take in what was delivered then.
    fn has_seen(&self, now: Duration, delivered: Option<Duration>) -> bool {
        delivered.is_some_and(|since| now.saturating_sub(since) >= self.config.traits.surely_seen())
    }

    /// Whether bit 2 low is known to be delivered by this cycle, for the first time in this quick stop.
    fn delivers_quick_stop(&mut self, now: Duration, delivered: bool) -> bool {
        let is_first = delivered
            && !self.sent.contains(Controlword::BIT_QUICK_STOP)
            && self.stopping.sent_since.is_none();
        if is_first {
            self.stopping.sent_since = Some(now);
        }
        is_first
    }

    /// Whether the state of this sample, in which a quick stop may end or not, shows that the drive has followed it: the drive has surely seen bit 2
    /// low; or, where nobody knows what it receives, has shown no other state for the settle time. One statusword alone may be wrong.
    fn has_quick_stopped(&mut self, now: Duration, may_end: bool) -> bool {
        let settle = self.bounds.settle;
        let shown = self.stopping.shown.update(now, may_end, settle);
        may_end && (shown || self.has_seen(now, self.stopping.sent_since))
    }

    /// Whether the drive stays in Operation enabled although it has surely seen the quick stop, and the axis gets no slower, or its time to
    /// come to rest is over.
    fn ignores_quick_stop(
        &mut self,
        now: Duration,
        sample: &Sample,
        delivered: bool,
        late: bool,
    ) -> bool {
        if sample.state() != State::OperationEnabled {
            self.stopping.measure_quick();
            return false;
        }
        if delivered && !self.sent.contains(Controlword::BIT_QUICK_STOP) {
            self.stopping.quick_delivered.get_or_insert(now);
        }
        if self.has_seen(now, self.stopping.quick_delivered) {
            let deceleration = &mut self.stopping.quick_deceleration;
            deceleration.update(now, sample.position, &self.bounds);
        }
        self.stopping.quick_deceleration.ignores_stop()
            || (late && self.has_seen(now, self.stopping.quick_delivered))
    }

    /// The drive does not stop the axis: without voltage it at least drives it no further.
    fn give_quick_stop_up(&mut self, now: Duration) {
        self.fail_motions(Failure::QuickStopIgnored);
        self.fail_commands(Failure::QuickStopIgnored);
        self.power = Power::Off;
        self.stopping.off = false;
        self.brake.give_up();
        let until = now.saturating_add(self.config.deadlines.disable);
        self.stopping.phase = StopPhase::Off { until };
    }
}

// Everything for which a motion is refused before anything of it is written.

impl AxisCore {
    /// What the drive's limits say of a velocity.
    fn check_jog(&self, velocity: i32) -> Result<(), Failure> {
        let limits = &self.config.limits;
        limits.check_velocity(Some(velocity.unsigned_abs()))
    }

    /// Everything for which a homing is refused.
    fn check_homing(&self) -> Result<(), Failure> {
        self.check_mode(Mode::Homing)?;
        if self.homing.is_unknown() {
            Err(Failure::NeedsStop)
        } else if self.homing.is_idle() {
            Ok(())
        } else {
            Err(Failure::Busy)
        }
    }

    /// Everything for which a jog is refused, but for ramps that are zero.
    fn check_jogging(&self, velocity: i32) -> Result<(), Failure> {
        self.check_mode(Mode::ProfileVelocity)?;
        self.check_jog(velocity)?;
        if self.jogging.is_held() {
            Err(Failure::Busy)
        } else {
            Ok(())
        }
    }

    /// What every start of a motion needs.
    fn check_mode(&self, expected: Mode) -> Result<(), Failure> {
        let shown = self.sample.map_or(Mode::None, |s| s.mode);
        if let Some(fault) = self.fault() {
            return Err(fault);
        }
        if self.stopping.is_active() {
            return Err(Failure::QUICK_STOPPED);
        }
        if !matches!(self.power, Power::Enabled) {
            return Err(Failure::NotEnabled {
                state: self.state(),
            });
        }
        if self.halted {
            return Err(Failure::HALTED);
        }
        if self.mode_change.is_some() || shown != expected || self.mode != expected {
            return Err(Failure::WrongMode {
                expected,
                shown,
                delivery: Delivery::NotSent,
            });
        }
        Ok(())
    }

    /// As `check_move`, for a move whose parameters may have to be written by SDO first.
    fn check_unmapped_move(&self, mut command: MoveCommand) -> Result<(), Failure> {
        self.check_limits(&command)?;
        let traits = &self.config.traits;
        let set_point = &mut command.set_point;
        traits.check_profile_type(
            set_point.buffer_mode,
            set_point.parameters.profile_type,
            None,
        )?;
        set_point.parameters = self.config.fields.mapped(&set_point.parameters);
        self.check_move(command).map(drop)
    }

    /// What the drive's limits say of a move. Where a relative one ends shows when its turn comes.
    fn check_limits(&self, command: &MoveCommand) -> Result<(), Failure> {
        let limits = &self.config.limits;
        let parameters = &command.set_point.parameters;
        limits.check_velocity(parameters.velocity)?;
        limits.check_velocity(parameters.end_velocity)?;
        match command.reference {
            Reference::Absolute => {
                let rule = &self.config.traits.limits;
                limits.check_target(command.target.into(), rule, self.is_referenced())
            }
            Reference::Relative => Ok(()),
        }
    }

    /// Everything that can be refused before anything is written.
    fn check_move(&self, mut command: MoveCommand) -> Result<MoveCommand, Failure> {
        let buffer_mode = command.set_point.buffer_mode;
        if let StartBits::Unsupported(reason) = self.config.traits.bits(buffer_mode) {
            return Err(Failure::Unsupported {
                buffer_mode,
                reason,
            });
        }
        self.check_mode(Mode::ProfilePosition)?;
        if self.sequencer.is_unknown() {
            return Err(Failure::NeedsStop);
        }
        if command.reference == Reference::Absolute
            && !self.is_referenced()
            && self.config.referencing != Referencing::UnreferencedMovesAllowed
        {
            return Err(Failure::NotReferenced);
        }
        self.check_limits(&command)?;
        let parameters = &mut command.set_point.parameters;
        *parameters = self
            .config
            .fields
            .complete(parameters, &self.config.defaults)?;
        self.check_profile_type(&command)?;
        Ok(command)
    }

    fn check_profile_type(&self, command: &MoveCommand) -> Result<(), Failure> {
        let traits = &self.config.traits;
        let set_point = &command.set_point;
        let mut before = None;
        if traits.needs_linear_ramps(set_point.buffer_mode) {
            if self.config.fields.profile_type.is_none() {
                // Written by SDO it would not be known here, nor changed between two set-points.
                return Err(Failure::NotMapped("motion profile type 6086h"));
            }
            before = self.sequencer.last_profile_type();
        }
        traits.check_profile_type(
            set_point.buffer_mode,
            set_point.parameters.profile_type,
            before,
        )
    }
}

// The active mode: whose bits and set-points are in the outputs, and how one mode gives way to another.

/// A change of 6060h that waits for 6061h.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct ModeChange {
    id: CommandId,
    to: Mode,
    before: Mode,
    deadline: Duration,
    step: ModeStep,
    /// What it has taken the place of: until this one is written the drive may come to that mode all the same.
    instead_of: Option<Unawaited>,
    /// Whether another mode was written by SDO before: the drive may come to that first, and shows this one from before then.
    by_way_of_another: bool,
}

/// A change of mode for which nobody waits, and to which the drive may come at any time.
#[derive(Debug, Clone, Copy, Hash)]
struct Unawaited {
    to: Mode,
    deadline: Duration,
    step: ModeStep,
}

/// How far a change of mode is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum ModeStep {
    /// Until the axis stands and the drive has surely seen the bits of the last mode low and its target velocity 0; then it is written, or
    /// whoever writes it by SDO gets the reason.
    Quiet { by_sdo: bool },
    /// 6060h is in the outputs.
    Written,
    /// Whoever writes 6060h by SDO has been asked to: until the mode is awaited, the drive may show either.
    BySdo,
    /// 6060h was in the outputs, and is what it was before. A drive may come to a mode late, and take bit 4 for its own: for the time that it
    /// has for that, nothing begins. Somebody may wait for that time to be over, to select this mode then.
    TakenBack { then: Option<Mode> },
}

impl ModeStep {
    /// Whether somebody waits for it.
    const fn is_awaited(self) -> bool {
        matches!(
            self,
            Self::Quiet { .. } | Self::Written | Self::TakenBack { then: Some(_) }
        )
    }
}

impl AxisCore {
    /// The velocity of a jog that is held, from the next outputs on. False if it is not followed: this jog is not held any
    /// more, or the velocity is above max profile velocity 607Fh.
    pub fn set_jog(&mut self, id: CommandId, velocity: i32, outputs: &mut [u8]) -> bool {
        let followed = self.check_jog(velocity).is_ok() && {
            let unanswered = self.unanswered();
            self.jogging.set(id, velocity, unanswered)
        };
        if followed {
            self.write_outputs(outputs);
        }
        followed
    }

    /// Lets go of a jog: target velocity 0 in the next outputs. It is done at standstill. False if it is not held any more.
    pub fn release_jog(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) -> bool {
        self.let_jog_go(now, id, false, outputs)
    }

    /// Whether a jog with a dead-man time is held, of which [`hold_jog`](Self::hold_jog) is to be told in every cycle.
    #[must_use]
    pub const fn has_dead_man(&self) -> bool {
        self.jogging.has_dead_man()
    }

    /// To be called in every cycle with how often the holder of a jog has said that it holds it. Where it has been silent for longer than
    /// the jog's [`dead_man`](JogSetPoint::dead_man) time the jog is let go, which fails as [`Failure::NotHeld`] at standstill, and this
    /// is false.
    pub fn hold_jog(
        &mut self,
        now: Duration,
        id: CommandId,
        times: u32,
        outputs: &mut [u8],
    ) -> bool {
        let is_silent = self.jogging.is_silent(now, id, times);
        if is_silent {
            self.let_jog_go(now, id, true, outputs);
        }
        !is_silent
    }

    /// What the axis shows at the moment in which it is told to stop.
    fn unanswered(&self) -> Unanswered {
        Unanswered::new(self.sample.filter(|_| self.standstill.is_under_way()))
    }

    fn let_jog_go(
        &mut self,
        now: Duration,
        id: CommandId,
        by_itself: bool,
        outputs: &mut [u8],
    ) -> bool {
        let until = now.saturating_add(self.config.deadlines.standstill);
        let unanswered = self.unanswered();
        let held = self.jogging.release(id, until, by_itself, unanswered);
        if held {
            self.write_outputs(outputs);
        }
        held
    }

    /// Max profile velocity 607Fh as velocities are checked against it.
    #[cfg(feature = "std")]
    pub(crate) const fn max_velocity(&self) -> Option<u32> {
        self.config.limits.max_velocity
    }

    /// The jog that is held or coming to rest.
    #[must_use]
    pub const fn jog(&self) -> Option<CommandId> {
        self.jogging.id()
    }

    fn select_mode(&mut self, now: Duration, id: CommandId, to: Mode, by_sdo: bool) {
        let shown = self.sample.is_some_and(|sample| sample.mode == to);
        if shown && self.mode == to && self.mode_change.is_none() {
            self.done(id, Ok(Completion::Done));
        } else if !self
            .config
            .supported_modes
            .is_none_or(|modes| modes.allows(to))
        {
            self.done(id, Err(Failure::ModeNotSupported { mode: to }));
        } else if self.halted {
            self.done(id, Err(Failure::HALTED));
        } else if !self.is_idle() {
            self.done(id, Err(Failure::Moving));
        } else if self.stopping.is_active()
            || self
                .mode_change
                .is_some_and(|change| change.step.is_awaited())
        {
            self.done(id, Err(Failure::Busy));
        } else if let Some(change) = &mut self.mode_change
            && matches!(change.step, ModeStep::TakenBack { .. })
            && (change.instead_of.is_some() || (to == self.mode || to == change.to))
        {
            // The drive may show either from before, and each mode that was taken back before the last one.
            change.id = id;
            change.step = ModeStep::TakenBack { then: Some(to) };
        } else {
            let by_way_of_another = self.config.fields.mode.is_none()
                && (self.mode_change)
                    .is_some_and(|change| change.by_way_of_another || change.to != to);
            let limit = self.config.deadlines.mode;
            let way = if by_way_of_another {
                limit
            } else {
                Duration::ZERO
            };
            let change = ModeChange {
                id,
                to,
                before: self.mode,
                deadline: now.saturating_add(limit).saturating_add(way),
                by_way_of_another,
                step: ModeStep::Quiet { by_sdo },
                instead_of: self.mode_change.map(|change| Unawaited {
                    to: change.to,
                    deadline: change.deadline,
                    step: change.step,
                }),
            };
            self.mode_change = Some(change);
            self.write_mode(now);
        }
    }

    /// Writes 6060h, or says that it may be written, once nothing of the last mode is left that the next could take for its
    /// own.
    fn write_mode(&mut self, now: Duration) {
        let Some(change) = &mut self.mode_change else {
            return;
        };
        let ModeStep::Quiet { by_sdo } = change.step else {
            return;
        };
        if self.halted {
            self.fail_mode_change(Failure::HALTED);
            return;
        }
        let seen = self.config.traits.surely_seen();
        let quiet = self
            .quiet_since
            .is_some_and(|since| now.saturating_sub(since) >= seen);
        let may_move = self.brake.may_drive() && !self.standstill.is_standing();
        // A halt may take back a resume that has not gone out yet.
        if !quiet || may_move || self.resuming.is_some() {
            return;
        }
        // 607Ah still holds the last move's target or distance; another mode may follow it at once.
        if let Some(sample) = self.sample {
            self.sequencer.follow_position(sample.position);
        }
        let (id, to) = (change.id, change.to);
        if by_sdo {
            change.step = ModeStep::BySdo;
            self.done(id, Ok(Completion::Prepared { mode: to }));
        } else {
            change.step = ModeStep::Written;
            self.mode = to;
            self.homing.outside();
            self.sequencer.outside();
        }
    }

    /// What has just been sent, of the mode's own: since when it is nothing.
    fn update_quiet(&mut self, now: Duration, delivered: bool) {
        if self.sent.word().intersects(ModeBits::MASK) || self.sent_velocity != 0 {
            self.quiet_since = None;
        } else if delivered {
            self.quiet_since.get_or_insert(now);
        }
    }

    fn update_mode_change(&mut self, now: Duration, sample: &Sample) {
        self.write_mode(now);
        let Some(change) = self
            .mode_change
            .filter(|change| change.step != ModeStep::BySdo)
        else {
            return;
        };
        if let ModeStep::TakenBack { then } = change.step {
            self.update_taken_back(now, change, then);
        } else if change.step == ModeStep::Written
            && sample.mode == change.to
            && !(change.by_way_of_another
                && now.saturating_add(self.config.deadlines.mode) < change.deadline)
        {
            self.mode_change = None;
            self.done(change.id, Ok(Completion::Done));
        } else if now >= change.deadline {
            self.take_mode_back(change);
            let moves = matches!(change.step, ModeStep::Quiet { .. }) && !self.is_standing();
            let failure = if moves {
                Failure::Moving
            } else {
                self.timeout(WaitingFor::Mode(change.to), Delivery::NotSent)
            };
            self.done(change.id, Err(failure));
        }
    }

    /// Gives up the change of mode with this id: nobody waits for it. The mode before is in the outputs again.
    fn withdraw_mode_change(&mut self, id: CommandId) -> bool {
        let mut of_id = self.mode_change.iter().filter(|change| change.id == id);
        let is_pending = of_id.any(|change| change.step.is_awaited());
        if is_pending {
            self.fail_mode_change(Failure::Withdrawn);
        }
        is_pending
    }

    fn fail_mode_change(&mut self, failure: Failure) {
        if let Some(change) = self.mode_change.filter(|change| change.step.is_awaited()) {
            self.take_mode_back(change);
            self.done(change.id, Err(failure));
        }
    }

    /// The mode before is in the outputs again.
    fn take_mode_back(&mut self, change: ModeChange) {
        self.mode = change.before;
        let is_mapped = self.config.fields.mode.is_some();
        let deadline = match change.step {
            ModeStep::Written if is_mapped && change.to != change.before => Duration::MAX,
            ModeStep::TakenBack { .. } => change.deadline,
            // Nothing takes it back: until a mode was selected, the drive may come to this one at any time.
            ModeStep::Written if !is_mapped => {
                self.mode_change = Some(ModeChange {
                    step: ModeStep::BySdo,
                    ..change
                });
                return;
            }
            ModeStep::Quiet { .. } | ModeStep::Written | ModeStep::BySdo => {
                let before = change.instead_of;
                let before = before.filter(|_| change.step != ModeStep::Written);
                self.mode_change = before.map(|before| ModeChange {
                    to: before.to,
                    deadline: before.deadline,
                    step: before.step,
                    instead_of: None,
                    ..change
                });
                return;
            }
        };
        self.mode_change = Some(ModeChange {
            step: ModeStep::TakenBack { then: None },
            deadline,
            ..change
        });
    }

    /// A mode that was taken back is not come to any more after the time that a drive has to show a mode. Whoever waits for that selects a
    /// mode then as any other.
    fn update_taken_back(&mut self, now: Duration, mut change: ModeChange, then: Option<Mode>) {
        let later = now.saturating_add(self.config.deadlines.mode);
        if change.deadline == Duration::MAX {
            change.deadline = later;
        }
        self.mode_change = if now < change.deadline {
            Some(change)
        } else {
            then.map(|to| ModeChange {
                id: change.id,
                to,
                before: self.mode,
                deadline: later,
                step: ModeStep::Quiet { by_sdo: false },
                instead_of: None,
                by_way_of_another: false,
            })
        };
    }

    fn start_homing(&mut self, id: CommandId, command: HomingCommand) {
        if let Some(offset) = command.offset {
            self.note_home_offset(offset);
        }
        match self.check_homing() {
            Err(failure) => self.done(id, Err(failure)),
            Ok(()) => {
                self.sequencer.zero_moves();
                self.homing.submit(id, command, &mut self.events);
            }
        }
    }

    fn start_jog(&mut self, id: CommandId, mut set_point: JogSetPoint) {
        let fields = &self.config.fields;
        let checked = self
            .check_jogging(set_point.velocity)
            .and_then(|()| set_point.check_dead_man())
            .and_then(|()| fields.complete_jog(&mut set_point, &self.config.defaults));
        match checked {
            Err(failure) => self.done(id, Err(failure)),
            Ok(()) => self.jogging.submit(id, set_point, &mut self.events),
        }
    }

    /// One cycle in Operation enabled: the active mode's machine goes on.
    fn update_mode(&mut self, now: Duration, sample: &Sample, delivered: bool) {
        if self.stopping.is_quick() {
            return;
        }
        if sample.mode != self.mode {
            self.homing.outside();
            self.sequencer.outside();
            if !self.is_idle() {
                let failure = Failure::WrongMode {
                    expected: self.mode,
                    shown: sample.mode,
                    delivery: Delivery::NotSent,
                };
                self.fail_motions(failure);
                self.stop_by_itself(now);
            }
            return;
        }
        if self.mode == Mode::ProfilePosition {
            self.update_moves(now, sample, delivered);
            return;
        }
        // No move of ours is under way: whoever looks at 607Ah finds no jump, not even after a homing has moved the zero.
        self.sequencer.follow_other_mode(sample.position);
        let cycle = cycle!(self, now, sample, delivered);
        match self.mode {
            Mode::Homing => match self.homing.step(&cycle, &mut self.events) {
                HomingVerdict::GoOn => {}
                HomingVerdict::Attained => self.homed = true,
                HomingVerdict::StopIt => self.stop_by_itself(now),
                HomingVerdict::EndIt => {
                    self.fallen = Some(Failure::QUICK_STOPPED);
                    self.begin_stop(now, Failure::QUICK_STOPPED);
                }
            },
            Mode::ProfileVelocity => {
                let runs_on = self.jogging.step(&cycle, &mut self.events);
                if runs_on {
                    self.stop_by_itself(now);
                }
            }
            _ => {}
        }
    }

    /// Quick stop, for which nobody has asked.
    fn stop_by_itself(&mut self, now: Duration) {
        self.fallen = Some(Failure::QUICK_STOPPED);
        self.begin_quick_stop(now);
    }

    /// Bits 4, 5, 6 and 9 of the next controlword: the active mode's.
    const fn mode_bits(&self) -> ModeBits {
        if !self.power.allows_mode_bits() {
            return ModeBits::NONE;
        }
        match self.mode {
            Mode::ProfilePosition => self.sequencer.bits(),
            Mode::Homing => self.homing.bits(),
            _ => ModeBits::NONE,
        }
    }

    /// Target velocity 60FFh of the next outputs.
    const fn target_velocity(&self) -> i32 {
        match self.mode {
            Mode::ProfileVelocity if self.power.allows_mode_bits() => self.jogging.velocity(),
            _ => 0,
        }
    }

    /// Profile parameters of the next outputs, of a jog: its ramps in place of those of the moves.
    fn jog_parameters(&self) -> Parameters {
        let held = *self.sequencer.parameters();
        let ramps = self.jogging.ramps();
        Parameters {
            acceleration: ramps.acceleration.or(held.acceleration),
            deceleration: ramps.deceleration.or(held.deceleration),
            ..held
        }
    }

    /// Whether the drive follows a set-point of any mode, or may.
    fn has_motion(&self) -> bool {
        self.sequencer.has_set_point()
            || self.homing.has_motion()
            || self.jogging.has_motion()
            // One that stands may be held by an input of its drive, and goes on when that lets it.
            || (self.sequencer.has_end_velocity() && self.power.is_driving())
    }

    /// Whether nothing waits and nothing is under way, in any mode.
    fn is_idle(&self) -> bool {
        let none_waits =
            self.sequencer.is_idle() && self.homing.is_idle() && self.jogging.is_idle();
        none_waits && !self.has_motion()
    }

    /// The outputs composed last have been sent.
    fn mark_sent(&mut self, now: Duration) {
        self.sequencer.mark_sent(now);
        self.jogging.mark_sent(&mut self.events);
        if self.homing.mark_sent(now) {
            // From now on the drive's positions are between two meanings.
            self.homed = false;
            self.homed_before_loss = false;
        }
    }

    /// Ends every motion with this failure, which says how far each set-point came.
    pub(super) fn fail_motions(&mut self, failure: Failure) {
        self.given_up |= self.has_motion();
        self.sequencer.fail_all(failure, &mut self.events);
        self.homing.fail(failure, &mut self.events);
        self.jogging.end(failure, &mut self.events);
    }

    /// A stop takes over: what is not sent is not started, and a velocity that is held is let go with this frame.
    fn withdraw_unsent(&mut self, failure: Failure) {
        self.sequencer.withdraw_unsent(failure, &mut self.events);
        self.homing.withdraw_unsent(failure, &mut self.events);
        self.doubt_rest_of_jog();
        self.jogging.end(failure, &mut self.events);
    }

    /// A jog is given up: its drive may set off just now.
    fn doubt_rest_of_jog(&mut self) {
        if self.jogging.has_motion() {
            self.standstill.begin_anew();
        }
    }

    /// The axis is out of Operation enabled: no bit of a mode stays, and nothing is held any more.
    fn lower_mode_bits(&mut self) {
        self.given_up = false;
        self.sequencer.lower();
        self.homing.lower();
        // Nothing that leads here leaves a jog; should one be left, it must not come back with the next enable.
        let state = self.state();
        self.jogging
            .end(Failure::Disabled { state }, &mut self.events);
    }
}

// Cycles in which nothing happens: what cannot have changed is not computed again.
//
// At the end of each whole step it is judged once whether the next can only come to the same: nothing asked for, nothing
// waiting, no deadline running, the outputs delivered as they are. As long as statusword, mode and error code then stay as
// they were, all that is left to do is to follow the position. Whatever composes outputs ends that
// ([`AxisCore::write_outputs`]), and so does everything else that a whole step would take in.
// `tests/invariants` holds both ways against each other.

/// Whether the next step can be other than this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum IdlePath {
    /// It can: it is computed as a whole.
    No,
    /// No set-point is under way, and 607Ah stays.
    Standing,
    /// The same, and 607Ah follows the position.
    Following,
    /// One set-point is under way, and only its position and bit 10 can end it.
    Moving,
}

/// What is new since the axis' port looked last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(
    not(feature = "std"),
    expect(dead_code, reason = "only a port asks for changes")
)]
pub(crate) enum SnapshotChange {
    /// The cycle's number alone.
    Nothing,
    /// Position and velocity.
    Motion,
    /// That there were no inputs.
    Silence,
    Anything,
}

impl AxisCore {
    /// Whether a step with these inputs, which are those of the last one, does nothing but count the cycle: no set-point is under way.
    #[inline]
    const fn stays(&self, inputs: &Inputs<'_>) -> bool {
        matches!(self.idle_path, IdlePath::Standing | IdlePath::Following)
            && matches!(inputs, Inputs::Fresh(_))
            && self.stale_cycles == 0
            // Else the time alone may bring it to rest.
            && self.is_standing()
    }

    /// Whether moreover its port has taken in everything: such a step may be left out, if it is counted later.
    #[cfg(feature = "std")]
    #[inline]
    pub(crate) fn rests_at(&self, inputs: &Inputs<'_>) -> bool {
        self.stays(inputs) && self.change == SnapshotChange::Nothing
    }

    /// Counts the steps that were left out: there were so many in all.
    #[cfg(feature = "std")]
    #[inline]
    pub(crate) const fn count_to(&mut self, cycles: u64) {
        self.cycle = cycles;
    }

    /// A step with inputs that are those of the last one: whether that is all.
    #[inline(always)]
    fn step_at_rest(&mut self, inputs: &Inputs<'_>) -> bool {
        let stays = self.stays(inputs);
        if stays {
            self.cycle = self.cycle.wrapping_add(1);
        }
        stays
    }

    /// A step that needs nothing but the position. None if it has to be computed as a whole; else whether the outputs have
    /// changed.
    #[inline(always)]
    fn step_on_idle_path(
        &mut self,
        now: Duration,
        inputs: &Inputs<'_>,
        outputs: &mut [u8],
    ) -> Option<bool> {
        if self.idle_path == IdlePath::No {
            return None;
        }
        match inputs {
            // How long it was blind matters for the first one after that.
            Inputs::Fresh(bytes) if self.stale_cycles == 0 => self.follow(now, bytes, outputs),
            Inputs::Stale => self.wait_blindly().then_some(false),
            Inputs::Fresh(_) | Inputs::Answered(_) => None,
        }
    }

    #[inline(always)]
    fn follow(&mut self, now: Duration, bytes: &[u8], outputs: &mut [u8]) -> Option<bool> {
        let fields = &self.config.fields;
        if !fields.shows(bytes, &self.status_key) {
            return None;
        }
        let (position, velocity) = fields.motion(bytes)?;
        let sample = self.sample.as_mut()?;
        sample.position = position;
        if let Some(before) = &mut sample.velocity {
            *before = velocity;
        }
        self.standstill
            .update(now, position, sample.velocity, &self.bounds);
        self.cycle = self.cycle.wrapping_add(1);
        self.change = match self.change {
            SnapshotChange::Nothing | SnapshotChange::Motion => SnapshotChange::Motion,
            SnapshotChange::Silence | SnapshotChange::Anything => SnapshotChange::Anything,
        };
        match self.idle_path {
            IdlePath::Standing | IdlePath::No => Some(false),
            IdlePath::Following => {
                self.sequencer.follow_position(position);
                fields.write_target(outputs, position);
                Some(true)
            }
            IdlePath::Moving => {
                if self.sequencer.follow(now, sample, &self.bounds) {
                    self.look_for_end(now);
                }
                Some(false)
            }
        }
    }

    #[inline(never)]
    fn look_for_end(&mut self, now: Duration) {
        let Some(sample) = &self.sample else { return };
        let cycle = cycle!(self, now, sample, true);
        if self.sequencer.end(&cycle, &mut self.events) {
            self.idle_path = IdlePath::No;
            self.change = SnapshotChange::Anything;
        }
    }

    /// A cycle without inputs, if the drive does not count as lost by it.
    fn wait_blindly(&mut self) -> bool {
        let (stale, undelivered) = (
            self.stale_cycles.saturating_add(1),
            self.undelivered_cycles.saturating_add(1),
        );
        let loss = &self.config.loss;
        if stale >= loss.stale_cycles || undelivered >= loss.undelivered_cycles {
            return false;
        }
        self.cycle = self.cycle.wrapping_add(1);
        self.answered = false;
        self.stale_cycles = stale;
        self.undelivered_cycles = undelivered;
        self.change = match self.change {
            SnapshotChange::Nothing => SnapshotChange::Silence,
            _ => SnapshotChange::Anything,
        };
        true
    }

    /// Whether the next step can be other than the one just computed.
    fn choose_path(&mut self, delivered: bool) {
        self.idle_path = IdlePath::No;
        let Some(sample) = self.sample else { return };
        let sent = self.outgoing == self.sent && self.outgoing_velocity == self.sent_velocity;
        // What is driven shows Operation enabled: another state has ended that in this step.
        let driving = self.power.is_driving();
        let in_mode = driving && sample.mode == self.mode;
        let allowed = delivered
            && self.brake.allows_idle_path(driving)
            && sent
            && self.blind_cycles == 0
            && !self.lost
            && !self.halted
            && self.mode_change.is_none()
            && self.power.allows_idle_path()
            && self.stopping.allows_idle_path()
            && self
                .homing
                .allows_idle_path(in_mode && self.mode == Mode::Homing)
            && self.jogging.allows_idle_path()
            && (self.sequencer.holds_any() || !self.sequencer.has_end_velocity())
            && self.sequencer.allows_idle_path(
                in_mode && self.mode == Mode::ProfilePosition,
                sample.statusword,
            );
        if !allowed {
            return;
        }
        self.status_key = StatusKey::of(&sample);
        let follows = !driving || (in_mode && self.mode != Mode::ProfilePosition);
        // What holds a set-point is driven in its mode.
        self.idle_path = if self.sequencer.holds_any() {
            IdlePath::Moving
        } else if follows {
            IdlePath::Following
        } else {
            IdlePath::Standing
        };
    }
}

impl Power {
    /// Whether nobody waits for it and it has no deadline.
    const fn allows_idle_path(&self) -> bool {
        matches!(
            self,
            Self::Off | Self::Ready | Self::Enabled | Self::Holding
        )
    }
}

impl Stopping {
    /// Whether no stop is under way and nobody waits for one.
    fn allows_idle_path(&self) -> bool {
        self.phase == StopPhase::None && self.has_no_waiter()
    }
}

// An axis whose drive is recovered after it has left OP or was without power: it begins again, disabled.

#[cfg(feature = "std")]
/// What is known of the drive of an axis that begins again.
#[derive(Debug)]
pub(crate) enum Reattach {
    /// Nothing yet: its outputs must be harmless, whatever comes.
    Unknown,
    /// It has kept its power, and with it what it knows. This is what it holds now.
    Kept(Box<CoreConfig>),
    /// It was without power, or was set back: this is what it holds now.
    Anew(Box<CoreConfig>),
}

#[cfg(feature = "std")]
impl AxisCore {
    /// Begins again as if it had just been made, for a drive that does not act on its outputs now. Everything that is pending ends
    /// as lost. No enable, set-point or velocity is left in the outputs. The axis counts as lost until its drive takes outputs
    /// again.
    pub(crate) fn restart(&mut self, now: Duration, again: Reattach, outputs: &mut [u8]) {
        if !self.lost {
            self.lose(now);
        }
        // Of a drive that answers, those who wait for a stop have waited on. What it shows from now on is of another beginning.
        self.fail_commands(self.failure_of_loss());
        let is_anew = matches!(again, Reattach::Anew(_));
        match again {
            Reattach::Unknown => {}
            Reattach::Kept(config) => {
                self.know(*config);
                self.recall_homing();
            }
            Reattach::Anew(config) => self.attach(*config),
        }
        // Where it may still be moving, switching off would let it coast.
        let may_move = matches!(
            self.state(),
            State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive
        );
        self.power = if may_move { Power::Holding } else { Power::Off };
        self.sequencer = Sequencer::new(self.config.defaults);
        if let Some(sample) = self.sample {
            self.sequencer.follow_position(sample.position);
        }
        self.homing = Procedure::new(self.config.deadlines.standstill);
        self.jogging = Jogging::new();
        self.stopping = Stopping::default();
        self.halted = false;
        self.halt_delivered = None;
        // What was written by SDO is in the drive still, and one that has kept its power may come to what was taken back.
        let remains = |change: &ModeChange| match change.step {
            ModeStep::BySdo => true,
            ModeStep::TakenBack { .. } => !is_anew,
            ModeStep::Quiet { .. } | ModeStep::Written => false,
        };
        self.mode_change = self.mode_change.filter(remains);
        self.set_manufacturer_bits(Controlword::empty());
        self.sent = ComposedWord::DISABLE_VOLTAGE;
        self.sent_velocity = 0;
        self.quiet_since = None;
        self.write_outputs(outputs);
    }

    /// What was read of the drive of an axis that is commanded nothing yet.
    pub(crate) fn know(&mut self, config: CoreConfig) {
        self.homed = config.homed;
        (self.config, self.bounds) = config.with_bounds();
        self.sequencer = Sequencer::new(self.config.defaults);
        if let Some(sample) = self.sample {
            self.sequencer.follow_position(sample.position);
        }
        // Seen with other windows.
        self.standstill = Standstill::default();
        self.idle_path = IdlePath::No;
        self.change = SnapshotChange::Anything;
    }

    /// The drive has kept its power: where it was homed before it counted as lost, it still is.
    pub(crate) const fn recall_homing(&mut self) {
        self.homed |= self.homed_before_loss;
        self.idle_path = IdlePath::No;
        self.change = SnapshotChange::Anything;
    }

    /// The drive's power was off: what it knew before is gone, its position among it.
    pub(crate) const fn forget(&mut self) {
        self.homed = false;
        self.homed_before_loss = false;
    }

    /// What the drive holds now, of which nothing has been seen yet.
    fn attach(&mut self, config: CoreConfig) {
        self.forget();
        self.homed = config.homed;
        (self.config, self.bounds) = config.with_bounds();
        self.sample = None;
        self.standstill = Standstill::default();
        self.brake = Brake::default();
        self.bit_11_is_valid = false;
        self.noted_mode = Mode::None;
    }
}

// What makes no difference to an axis any more, for a search over all its states.
//
// Times count up for ever, and numbers of cycles. Each is compared with a bound, and beyond that all values mean the same:
// [`AxisCore::canonicalize`] makes them the same, and [`Hash`] differs for two cores that may do different things next.

/// A deadline that is over, as one that is over just now.
fn not_over(until: &mut Duration, now: Duration) {
    *until = (*until).max(now);
}

impl AxisCore {
    /// Lets go of what makes no difference any more, after a step at this time. Before the next bit 4 rises, what 607Ah and the
    /// parameters hold is part of that.
    #[doc(hidden)]
    pub fn canonicalize(&mut self, now: Duration) {
        let (seen, deadlines) = (self.config.traits.surely_seen(), &self.config.deadlines);
        let settle = self.bounds.settle;
        self.standstill.canonicalize(now, settle);
        self.brake.canonicalize(now, seen);
        self.sequencer
            .canonicalize(now, seen, deadlines.acknowledge, deadlines.begin, settle);
        if !self.outgoing_starts() && !self.sent.contains(Controlword::NEW_SET_POINT) {
            self.sequencer.canonicalize_target();
        }
        for (at, longest) in [
            (&mut self.quiet_since, seen),
            (&mut self.halt_delivered, seen.saturating_add(settle)),
        ] {
            if let Some(at) = at {
                no_older(at, now, longest);
            }
        }
        let longest = deadlines.standstill.max(seen);
        self.stopping.canonicalize(now, longest, settle);
        match &mut self.power {
            Power::Off | Power::Ready | Power::Enabled | Power::Holding => {}
            Power::Disabling { deadline, .. } | Power::Enabling { deadline, .. } => {
                not_over(deadline, now);
            }
            Power::Resetting { phase, .. } => phase.canonicalize(now, seen),
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
    fn canonicalize(&mut self, now: Duration, seen: Duration) {
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
    fn canonicalize(&mut self, now: Duration, longest: Duration, settle: Duration) {
        self.shown.canonicalize(now, settle);
        match &mut self.phase {
            StopPhase::None | StopPhase::Quick { until: None } => {}
            StopPhase::Halting { until, .. }
            | StopPhase::Quick { until: Some(until) }
            | StopPhase::Settling { until }
            | StopPhase::Off { until } => not_over(until, now),
        }
        let delivered = [&mut self.quick_delivered, &mut self.sent_since];
        for at in delivered.into_iter().flatten() {
            no_older(at, now, longest);
        }
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
            given_up,
            // Taken after each step.
            fallen: _,
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
            awaits_op,
            // With cycles of one length nothing ever stalls.
            spacing: _,
            bit_11_is_valid,
            cycle: _,
            expired,
            // A cycle that is computed as a whole comes to the same.
            idle_path: _,
            status_key: _,
            change: _,
        } = self;
        sample.hash(state);
        standstill.hash(state);
        brake.hash(state);
        sequencer.hash(state);
        homing.hash(state);
        jogging.hash(state);
        power.hash(state);
        stopping.hash(state);
        (halted, stop_unsent, resuming, given_up, halt_delivered).hash(state);
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
            awaits_op,
            bit_11_is_valid,
            expired,
        )
            .hash(state);
        (stale_cycles, blind_cycles, undelivered_cycles).hash(state);
    }
}

#[cfg(test)]
mod spacing_tests {
    use super::*;

    /// How long nothing was seen before the last of these cycles: of each its number, the time from the one before in µs, and how many
    /// without inputs there were between.
    fn stalled(cycles: &[(u64, u64, u32)]) -> u32 {
        let (mut spacing, mut now) = (CycleSpacing::default(), Duration::ZERO);
        for &(cycle, micros, stale) in cycles {
            now += Duration::from_micros(micros);
            spacing.update(now, cycle, stale);
        }
        spacing.stalled
    }

    #[test]
    fn a_cycle_after_more_than_twice_the_time_of_the_one_before_comes_late() {
        let after = |micros| stalled(&[(1, 1_000, 0), (2, 1_000, 0), (3, micros, 0)]);
        assert_eq!([1_000, 500, 2_000].map(after), [0; 3]);
        assert_eq!([2_001, 3_000, 7_500].map(after), [2, 3, 7]);
    }

    #[test]
    fn cycles_without_inputs_share_the_time() {
        let after = |micros| stalled(&[(1, 1_000, 0), (2, 1_000, 0), (5, micros, 2)]);
        assert_eq!([3_000, 6_000, 9_000].map(after), [0, 0, 9]);
    }

    #[test]
    fn the_time_since_a_cycle_that_was_not_the_last_one_is_no_stall() {
        let idle_between = [(1, 1_000, 0), (2, 1_000, 0), (90, 88_000, 0)];
        assert_eq!(stalled(&idle_between), 0);
        // One behind it is compared with what was known before.
        let and_late = |micros| {
            let [first, second, third] = idle_between;
            stalled(&[first, second, third, (91, micros, 0)])
        };
        assert_eq!([1_000, 9_000].map(and_late), [0, 9]);
    }
}

#[cfg(all(test, feature = "std"))]
mod restart_tests {
    use super::*;
    use crate::axis::{AxisFields, Command, CommandId, Event, Inputs};

    const QUICK_STOP: u16 = 0x0B;

    /// An axis that was enabled, and whose drive has shown this statusword last.
    fn enabled_then(statusword: u16) -> (AxisCore, [u8; 6], Duration) {
        let mut core = AxisCore::new(CoreConfig::new(AxisFields::at(0, 0)));
        let (mut outputs, mut now) = ([0; 6], Duration::ZERO);
        core.submit(now, CommandId(1), Command::Enable, &mut outputs);
        for word in [
            0x0250, 0x0250, 0x0250, 0x0231, 0x0233, 0x0237, 0x0237, 0x0237, statusword,
        ] {
            now += Duration::from_millis(1);
            let [low, high] = u16::to_le_bytes(word);
            core.step(now, Inputs::Fresh(&[low, high, 0, 0, 0, 0]), &mut outputs);
        }
        (core, outputs, now)
    }

    #[test]
    fn an_axis_that_may_still_be_moving_is_not_switched_off() {
        // Operation enabled, Quick stop active, Fault reaction active.
        for statusword in [0x0237, 0x0217, 0x023F] {
            let (mut core, mut outputs, now) = enabled_then(statusword);
            let config = Box::new(core.config.clone());
            for again in [Reattach::Unknown, Reattach::Kept(config)] {
                core.restart(now, again, &mut outputs);
                assert_eq!(
                    u16::from_le_bytes([outputs[0], outputs[1]]),
                    QUICK_STOP,
                    "{statusword:04X}"
                );
            }
        }
    }

    /// Its limits, windows and reference are of the drive as it is now, and nothing that was seen before counts.
    #[test]
    fn an_axis_whose_drive_was_without_power_knows_what_that_holds_now() {
        let (mut core, mut outputs, now) = enabled_then(0x0237);
        let mut config = CoreConfig::new(AxisFields::at(0, 0));
        config.limits.max_velocity = Some(700);
        config.homed = true;
        core.restart(now, Reattach::Anew(Box::new(config)), &mut outputs);
        assert_eq!(core.max_velocity(), Some(700));
        assert!(core.sample.is_none() && core.homed);
    }

    #[test]
    fn who_waits_for_a_stop_of_a_drive_that_answers_is_not_forgotten() {
        let (mut core, mut outputs, mut now) = enabled_then(0x0237);
        for cycle in 1..=core.config.loss.undelivered_cycles {
            now += Duration::from_millis(1);
            let position = (cycle as i32 * 100).to_le_bytes();
            let moving = [
                0x37,
                0x02,
                position[0],
                position[1],
                position[2],
                position[3],
            ];
            core.step(now, Inputs::Answered(&moving), &mut outputs);
        }
        assert!(core.is_lost());
        core.submit(now, CommandId(2), Command::Stop, &mut outputs);
        while core.poll_event().is_some() {}
        let kept = Reattach::Kept(Box::new(core.config.clone()));
        core.restart(now, kept, &mut outputs);
        let (id, event) = core.poll_event().expect("the stop has an end");
        assert_eq!(id, CommandId(2));
        assert!(matches!(event, Event::Done(Err(_))), "{event:?}");
    }

    #[test]
    fn a_drive_that_is_lost_in_its_fault_reaction_gets_a_quick_stop() {
        let (mut core, mut outputs, now) = enabled_then(0x023F);
        assert_eq!(outputs[0], 0x0B, "its reaction ignores that");
        for _ in 0..core.config.loss.stale_cycles {
            core.step(now, Inputs::Stale, &mut outputs);
        }
        assert!(core.is_lost());
        assert_eq!(u16::from_le_bytes([outputs[0], outputs[1]]), QUICK_STOP);
        // Fault: the reaction is over, and the axis stands.
        for cycle in 1..=110 {
            let now = now + Duration::from_millis(cycle);
            core.step(now, Inputs::Fresh(&[0x38, 0x02, 0, 0, 0, 0]), &mut outputs);
        }
        assert_eq!(u16::from_le_bytes([outputs[0], outputs[1]]), 0);
    }
}

#[cfg(test)]
mod canonical_tests {
    use super::*;

    const fn ms(time: u64) -> Duration {
        Duration::from_millis(time)
    }

    #[test]
    fn a_deadline_that_is_over_is_as_one_that_is_over_just_now() {
        for (until, now, kept) in [(3, 10, 10), (10, 10, 10), (17, 10, 17)] {
            let mut until = ms(until);
            not_over(&mut until, ms(now));
            assert_eq!(until, ms(kept));
        }
    }

    #[test]
    fn times_of_a_reset_count_no_longer_than_they_are_compared_with() {
        let (now, seen) = (ms(1_000), ms(20));
        let low = |until, reaction, shown| ResetPhase::Low {
            until: ms(until),
            reaction: ms(reaction),
            shown: Some(ms(shown)),
        };
        let gone = |since, until| ResetPhase::Gone {
            since: ms(since),
            until: ms(until),
        };
        let high = |until| ResetPhase::High { until: ms(until) };
        for (phase, kept) in [
            (low(1, 2, 3), low(1_000, 1_000, 980)),
            (low(1_500, 1_600, 990), low(1_500, 1_600, 990)),
            (high(1), high(1_000)),
            (high(1_500), high(1_500)),
            (gone(1, 2), gone(980, 1_000)),
            (gone(990, 1_500), gone(990, 1_500)),
        ] {
            let mut phase = phase;
            phase.canonicalize(now, seen);
            // A phase has no equality but that of the search.
            assert_eq!(alloc::format!("{phase:?}"), alloc::format!("{kept:?}"));
        }
    }
}

#[cfg(test)]
mod inputs_tests {
    use super::*;

    #[test]
    fn inputs_count_with_the_expected_working_counter_alone() {
        for (counter, expected) in [(2, 3), (4, 3), (0, 1), (u16::MAX, 0)] {
            assert_eq!(Inputs::from_wkc(counter, expected, &[1]), Inputs::Stale);
        }
        assert_eq!(Inputs::from_wkc(3, 3, &[1]), Inputs::Fresh(&[1]));
        assert_eq!(Inputs::from_wkc(0, 0, &[]), Inputs::Fresh(&[]));
    }
}
