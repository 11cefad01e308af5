//! The axis core: one cycle at a time, inputs in, controlword and set-point out (pure).
//!
//! Contract, per cycle: [`AxisCore::submit`] what is new, [`AxisCore::apply_stop`] what the stop lane holds as the last thing
//! before sending, send the outputs, [`AxisCore::step`] with what came back, then drain [`AxisCore::poll_event`].
//! Everything in the outputs when `step` is called counts as sent.

use alloc::boxed::Box;
use core::time::Duration;

use crate::{
    Failure,
    ds402::{Controlword, Mode},
    profile_position::{Bounds, CommandId, Event, Limits, LimitsRule, Quiet},
    timer::{Elapsed, nanoseconds},
};

use super::{
    Brake, Command, CoreConfig, Inputs, Snapshot,
    command::StopRequest,
    machines::{Machines, Step},
    observed::{Aside, News, Observed},
    outputs::{CommandedMode, ManufacturerBits},
    snapshot::SnapshotChange,
};

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
#[derive(Debug, Clone, Hash)]
pub struct AxisCore {
    pub(super) known: Known,
    machines: Machines,
    /// Whether the program counts as not alive.
    pub(crate) expired: bool,
    attention: Aside<Attention>,
    report: Aside<Report>,
}

/// What is known of the axis: how it is configured, and what was seen of it.
#[derive(Debug, Clone, Hash)]
pub(super) struct Known {
    pub config: Aside<Box<CoreConfig>>,
    bounds: Aside<Bounds>,
    observed: Observed,
    /// When the machines were stepped last.
    stepped: Aside<u64>,
}

impl Known {
    /// A step of the machines, in a cycle; or between two, where no time has elapsed for them.
    fn step(&self, machines: &Machines, now: Duration, elapsed: Elapsed) -> Step<'_> {
        let ahead = Elapsed(nanoseconds(now).saturating_sub(self.stepped.0));
        let (config, bounds) = (&*self.config.0, &self.bounds.0);
        Step::new(
            now,
            elapsed,
            ahead,
            config,
            bounds,
            &self.observed,
            machines,
        )
    }

    fn between(&self, machines: &Machines, now: Duration) -> Step<'_> {
        self.step(machines, now, Elapsed::default())
    }

    /// How long it is since the machines were stepped, up to now. Without inputs: the time since they came last does not count.
    fn elapse_to(&mut self, now: Duration, answered: bool) -> Elapsed {
        let now = nanoseconds(now);
        let left_out = if answered {
            0
        } else {
            self.observed.answered_at().saturating_sub(self.stepped.0)
        };
        let next = now.saturating_sub(left_out);
        let stepped = core::mem::replace(&mut self.stepped.0, next);
        Elapsed(next.saturating_sub(stepped))
    }

    #[cfg(feature = "std")]
    fn follow(&self, sequencer: &mut crate::profile_position::Sequencer) {
        if let Some(sample) = self.observed.sample {
            sequencer.follow_position(sample.position);
        }
    }
}

/// When the machines have to be stepped, whatever the inputs are; when inputs are to be looked at, though they are the same; and at which
/// positions there is nothing to see for the machines.
#[derive(Debug, Clone, Copy, Default)]
struct Attention {
    due: u64,
    looks: u64,
    quiet: Quiet,
}

/// What the inputs show that only some axes are asked for.
#[derive(Debug, Clone, Copy)]
struct Beside {
    torque: Option<i16>,
    brake: Option<bool>,
}

/// What the owner of the cycle is told.
#[derive(Debug, Clone, Copy)]
struct Report {
    cycle: u64,
    change: SnapshotChange,
}

impl AxisCore {
    /// An axis that commands nothing until it is asked to: its first words are Disable voltage, or quick stop as long
    /// as it is not known that the drive moves nothing; its first target is where the drive stands.
    #[must_use]
    pub fn new(config: CoreConfig) -> Self {
        let (config, bounds) = config.with_bounds();
        Self {
            machines: Machines::new(&config),
            known: Known {
                config: Aside(Box::new(config)),
                bounds: Aside(bounds),
                observed: Observed::new(),
                stepped: Aside(0),
            },
            expired: false,
            attention: Aside(Attention::default()),
            report: Aside(Report {
                cycle: 0,
                change: SnapshotChange::Anything,
            }),
        }
    }

    /// One cycle: takes in what came back and writes the axis' own fields of the outputs that are sent next.
    ///
    /// Inputs that did not arrive change nothing, until [`Loss`](super::Loss) says that the drive is lost.
    pub fn step(&mut self, now: Duration, inputs: Inputs<'_>, outputs: &mut [u8]) {
        if !self.step_kept(now, inputs, false, outputs) {
            self.write_fields(outputs);
        }
    }

    /// As [`step`](Self::step), for outputs that are kept from cycle to cycle: it writes to them what has changed, and says
    /// whether anything has. `unchanged`: these inputs are, bit for bit, those of the last call.
    #[inline]
    pub fn step_kept(
        &mut self,
        now: Duration,
        inputs: Inputs<'_>,
        unchanged: bool,
        outputs: &mut [u8],
    ) -> bool {
        self.report.0.cycle = self.report.0.cycle.wrapping_add(1);
        let at = nanoseconds(now);
        if unchanged && self.stays(at, &inputs) {
            return false;
        }
        // Whatever is unsent is due.
        let is_due = at >= self.attention.0.due;
        if is_due && self.machines.has_unsent() {
            self.mark_sent(now);
        }
        let number = self.report.0.cycle;
        let known = &mut self.known;
        let news = known
            .observed
            .take_in(at, number, &inputs, &known.config.0, &known.bounds.0);
        let answered = self.known.observed.link.answered;
        let change = &mut self.report.0.change;
        *change = change.and(news.change(answered));
        let counts = match news {
            News::None => false,
            News::Position => !self
                .attention
                .0
                .quiet
                .contains(self.known.observed.position()),
            News::Shown | News::Lost | News::Silent => true,
        };
        // The first one writes what is kept from then on.
        if counts || (answered && is_due) || number == 1 {
            let beside = Beside {
                torque: self.torque_awaited(&inputs),
                brake: self.brake_shown(&inputs),
            };
            self.step_machines(now, news, beside, outputs);
            return true;
        }
        false
    }

    /// Torque actual value 6077h in these inputs, while it may end a move.
    #[inline]
    fn torque_awaited(&self, inputs: &Inputs<'_>) -> Option<i16> {
        if !self.machines.modes.sequencer.awaits_contact() {
            return None;
        }
        match inputs {
            Inputs::Fresh(bytes) | Inputs::Answered(bytes) => {
                self.known.config.0.fields.torque_shown(bytes)
            }
            Inputs::Stale => None,
        }
    }

    /// Whether the brake is released, by its feedback in these inputs.
    #[inline]
    fn brake_shown(&self, inputs: &Inputs<'_>) -> Option<bool> {
        if !self.machines.brake.is_there() {
            return None;
        }
        let config = &self.known.config.0;
        match (&config.brake, inputs) {
            (Some(Brake::Output(brake)), Inputs::Fresh(bytes) | Inputs::Answered(bytes)) => {
                let inputs = bytes.get(config.fields.digital_inputs?..)?.first_chunk()?;
                brake.is_released(u32::from_le_bytes(*inputs))
            }
            _ => None,
        }
    }

    #[inline(never)]
    fn step_machines(&mut self, now: Duration, news: News, beside: Beside, outputs: &mut [u8]) {
        let answered = self.known.observed.link.answered;
        let elapsed = self.known.elapse_to(now, answered);
        if answered {
            let waits = self.machines.awaits_standstill();
            self.known
                .observed
                .note_unrest(now, waits, &self.known.bounds.0);
            let step = self.known.step(&self.machines, now, elapsed);
            self.machines.step(step, beside.brake);
            if let Some(torque) = beside.torque {
                let step = self.known.step(&self.machines, now, elapsed);
                self.machines.step_contact(&step, torque);
            }
        }
        let step = self.known.between(&self.machines, now);
        match news {
            News::Lost => self.machines.lose(&step, answered),
            News::Silent => self.machines.fall_silent(&step),
            News::None | News::Position | News::Shown => {}
        }
        self.finish(outputs);
    }

    /// What was sent with the frame of this cycle.
    fn mark_sent(&mut self, now: Duration) {
        let step = self.known.between(&self.machines, now);
        let rules = self.machines.rules(&step);
        self.machines.mark_sent(&rules);
        self.count_rest();
    }

    /// The stop lane: merges stops into outputs that have been computed and not been sent, as the last thing before
    /// sending. A rise of bit 4 that was about to be sent is withdrawn and its move fails as not sent; returns whether
    /// there was one. What was sent before keeps its bit 4.
    pub fn apply_stop(&mut self, now: Duration, stop: StopRequest, outputs: &mut [u8]) -> bool {
        if stop.is_empty() {
            return false;
        }
        let rose = self.machines.outputs.rises();
        let step = self.known.between(&self.machines, now);
        if stop.contains(StopRequest::QUICK_STOP) {
            self.machines.begin_quick_stop(&step);
        }
        if stop.contains(StopRequest::STOP) {
            self.machines.begin_stop(&step, Failure::QUICK_STOPPED);
        }
        if stop.contains(StopRequest::HALT) {
            self.machines.begin_halt(&step);
            self.machines.stopping.halt.unwatched = true;
        }
        self.finish(outputs);
        rose && !self.machines.outputs.rises()
    }

    /// Takes a command in, between two steps. What it stops or withdraws is out of the outputs at once. It reports through
    /// [`AxisCore::poll_event`], under this id, with exactly one [`Event::Done`](super::Event::Done).
    pub fn submit(&mut self, now: Duration, id: CommandId, command: Command, outputs: &mut [u8]) {
        let takes = if command.stops() {
            self.takes_stops()
        } else {
            !self.known.observed.link.lost
        };
        if !takes {
            let failure = Machines::failure_of_loss(self.known.observed.link.answered);
            self.machines.done(id, Err(failure));
        } else if self.expired && command.sets_going() {
            self.machines.done(id, Err(Failure::LivenessExpired));
        } else {
            match command {
                Command::SetLimits(limits) => {
                    self.known.config.0.limits = self.known.config.0.limits_with(limits);
                }
                Command::Home(command) => {
                    if let Some(offset) = command.offset {
                        self.note_home_offset(offset);
                    }
                }
                _ => {}
            }
            let step = self.known.between(&self.machines, now);
            self.machines.begin(&step, id, command);
        }
        self.finish(outputs);
    }

    /// Takes the next report; drain it after every other call.
    pub fn poll_event(&mut self) -> Option<(CommandId, Event)> {
        self.machines.events.0.pop()
    }

    /// Withdraws a motion that has not been sent, or a change of mode, which then ends as [`Failure::Withdrawn`]; a rise of bit 4 that
    /// is in the outputs and not sent is taken back. Returns whether there was such a move: afterwards it is too late, and the
    /// handshake completes.
    pub fn withdraw(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) -> bool {
        let step = self.known.between(&self.machines, now);
        let Machines { modes, events, .. } = &mut self.machines;
        let withdrawn = modes.withdraw(id, &step, &mut events.0);
        if withdrawn {
            self.compose(outputs);
        }
        withdrawn
    }

    /// What ends the motion with this id, if it was sent and has not ended: a homing is stopped, a move is halted.
    #[cfg(feature = "std")]
    pub(crate) fn stop_of(&self, id: CommandId) -> Option<StopRequest> {
        let modes = &self.machines.modes;
        if modes.homing.is_under_way(id) {
            Some(StopRequest::STOP)
        } else {
            let moves = modes.sequencer.is_under_way(id);
            moves.then_some(StopRequest::HALT)
        }
    }

    /// Whether a gated move has all that it needs in this cycle.
    #[must_use]
    pub fn is_armed(&self, id: CommandId) -> bool {
        self.known.observed.link.is_whole() && self.machines.modes.sequencer.is_armed(id)
    }

    /// Releases a gated, armed move: its bit 4 rises in the outputs that are sent next. Call it in the cycle in which
    /// [`AxisCore::is_armed`] said so, after `step`. On inputs that are not fresh nothing is released.
    pub fn fire(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) {
        if self.is_armed(id) {
            let step = self.known.between(&self.machines, now);
            let cycle = self.machines.cycle(&step);
            self.machines.modes.sequencer.fire(id, &cycle);
            self.compose(outputs);
        }
    }

    /// The velocity of a jog that is held, from the next outputs on. False if it is not followed: this jog is not held any
    /// more, or the velocity is above max profile velocity 607Fh. One below min profile velocity 2010h, of a drive on which that counts, is
    /// not followed either: the jog is held at 0.
    pub fn set_jog(&mut self, id: CommandId, velocity: i32, outputs: &mut [u8]) -> bool {
        let checked = self.limits().check_jog(velocity, self.limits_rule());
        let next = match checked {
            Ok(()) => velocity,
            Err(Failure::TooSlow { .. }) => 0,
            Err(_) => return false,
        };
        let is_held = self.machines.modes.jogging.set(id, next);
        if is_held {
            self.compose(outputs);
        }
        is_held && checked.is_ok()
    }

    /// What moves and jogs are checked against.
    pub(crate) fn limits(&self) -> &Limits {
        &self.known.config.0.limits
    }

    /// How its drive counts them.
    pub(crate) fn limits_rule(&self) -> &LimitsRule {
        &self.known.config.0.traits.limits
    }

    /// Lets go of a jog: target velocity 0 in the next outputs. It is done at standstill. False if it is not held any more.
    pub fn release_jog(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) -> bool {
        self.let_jog_go(now, id, false, outputs)
    }

    /// Whether a jog with a dead-man time is held, of which [`hold_jog`](Self::hold_jog) is to be told in every cycle.
    #[must_use]
    pub const fn has_dead_man(&self) -> bool {
        self.machines.modes.jogging.has_dead_man()
    }

    /// To be called in every cycle with how often the holder of a jog has said that it holds it. Where it has been silent for longer than
    /// the jog's [`dead_man`](crate::profile_velocity::JogSetPoint::dead_man) time the jog is let go, which fails as
    /// [`Failure::NotHeld`] at standstill, and this is false.
    pub fn hold_jog(
        &mut self,
        now: Duration,
        id: CommandId,
        times: u32,
        outputs: &mut [u8],
    ) -> bool {
        let is_silent = self.machines.modes.jogging.is_silent(now, id, times);
        if is_silent {
            self.let_jog_go(now, id, true, outputs);
        }
        !is_silent
    }

    fn let_jog_go(
        &mut self,
        now: Duration,
        id: CommandId,
        by_itself: bool,
        outputs: &mut [u8],
    ) -> bool {
        let left = self.known.between(&self.machines, now).deadline();
        let held = self.machines.modes.jogging.release(id, left, by_itself);
        if held {
            self.finish(outputs);
        }
        held
    }

    /// The jog that is held or coming to rest.
    #[must_use]
    pub const fn jog(&self) -> Option<CommandId> {
        self.machines.modes.jogging.id()
    }

    /// What is known of the axis.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        let (observed, machines) = (&self.known.observed, &self.machines);
        let sample = observed.sample;
        Snapshot {
            cycle: self.report.0.cycle,
            age: observed.link.age.0,
            answered: observed.link.answered,
            lost: observed.link.lost,
            statusword: observed.statusword(),
            state: observed.statusword().state(),
            controlword: machines.outputs.next.word.word(),
            mode: observed.mode(),
            position: sample.map_or(0, |s| s.position),
            velocity: sample.and_then(|s| s.velocity).unwrap_or(0),
            following_error: None,
            torque: None,
            error_code: None,
            halted: machines.stopping.halt.is_on,
            has_set_point: machines.modes.has_motion(),
            referenced: machines.is_referenced(&self.known.config.0),
            slipped: machines.brake.has_slipped(),
        }
    }

    /// Sets bits 11–15 of the controlword, which are the manufacturer's; other bits are ignored.
    pub fn set_manufacturer_bits(&mut self, bits: Controlword) {
        self.machines.outputs.manufacturer = ManufacturerBits::of(bits);
        self.step_next();
    }

    /// Whether the program counts as not alive. As long as it does nothing is enabled, started or resumed: that fails as
    /// [`Failure::LivenessExpired`]. The halt with which this begins is asked for by [`apply_stop`](Self::apply_stop).
    pub const fn set_expired(&mut self, expired: bool) {
        self.expired = expired;
    }

    /// Says what home offset 607Ch the drive holds: it counts its software position limits 607Dh from there.
    pub fn note_home_offset(&mut self, offset: i32) {
        self.known.config.0.limits.home_offset = offset;
    }

    /// Says what 6061h shows, where it is not mapped and was read by SDO.
    pub fn note_mode(&mut self, mode: Mode) {
        let is_mapped = self.known.config.0.fields.mode_display.is_some();
        self.known.observed.note_mode(mode, is_mapped);
        self.step_next();
    }

    /// Whether a stop or a disable is taken: not by an axis that counts as lost and did not answer in the last cycle.
    pub(crate) const fn takes_stops(&self) -> bool {
        !self.known.observed.link.lost || self.known.observed.link.answered
    }

    #[cfg(feature = "std")]
    pub(crate) fn state(&self) -> crate::ds402::State {
        self.known.observed.state()
    }

    /// What 603Fh shows, where it is mapped and not 0.
    #[cfg(feature = "std")]
    pub(crate) fn error_code(&self) -> Option<u16> {
        self.known
            .observed
            .sample?
            .error_code
            .filter(|&code| code != 0)
    }

    // How the parts come together.

    /// The machines have done something: what comes of that goes out.
    fn finish(&mut self, outputs: &mut [u8]) {
        self.count_rest();
        self.compose(outputs);
        let in_mode = self.known.observed.mode() == self.machines.modes.active()
            && self.machines.is_stepped_in(self.known.observed.state());
        let due = self.machines.due(in_mode);
        let looks = due.sooner(self.known.observed.due());
        let position = self.known.observed.position();
        let quiet = self.machines.quiet(in_mode, position, &self.known.bounds.0);
        let attention = &mut self.attention.0;
        attention.due = due.after(self.known.stepped.0);
        attention.looks = looks.after(self.known.stepped.0);
        attention.quiet = quiet;
    }

    fn count_rest(&mut self) {
        if core::mem::take(&mut self.machines.counts_rest_anew.0) {
            self.known.observed.count_rest_anew();
        }
    }

    /// The next cycle is not left out.
    const fn step_next(&mut self) {
        (self.attention.0.due, self.attention.0.looks) = (0, 0);
    }

    fn compose(&mut self, outputs: &mut [u8]) {
        let lacks_voltage = self
            .known
            .between(&self.machines, Duration::ZERO)
            .lacks_voltage();
        let (state, stands) = (self.known.observed.state(), self.known.observed.stands());
        self.machines.compose(state, stands, lacks_voltage);
        self.report.0.change = SnapshotChange::Anything;
        self.step_next();
        self.write_fields(outputs);
    }

    fn write_fields(&self, outputs: &mut [u8]) {
        let modes = &self.machines.modes;
        let next = self.machines.outputs.next;
        self.known.config.0.fields.write(
            outputs,
            next.word,
            CommandedMode::of_core(modes.active()),
            modes.sequencer.target(),
            next.velocity,
            &modes.parameters(),
        );
        if let Some(is_set) = self.machines.brake.is_set() {
            self.write_brake(is_set, outputs);
        }
    }

    /// The output of the brake, and no other bit of 60FEh:1.
    fn write_brake(&self, is_set: bool, outputs: &mut [u8]) {
        let config = &self.known.config.0;
        let place = config.fields.digital_outputs;
        let place = place.and_then(|at| outputs.get_mut(at..)?.first_chunk_mut());
        if let (Some(Brake::Output(brake)), Some(place)) = (&config.brake, place) {
            let held = u32::from_le_bytes(*place);
            *place = brake.in_outputs(held, is_set).to_le_bytes();
        }
    }

    /// Whether a step with these inputs, which are those of the last one, does nothing but count the cycle.
    #[inline]
    const fn stays(&self, at: u64, inputs: &Inputs<'_>) -> bool {
        matches!(inputs, Inputs::Fresh(_))
            && self.known.observed.link.is_whole()
            && at < self.attention.0.looks
    }
}

/// What a bus thread asks of an axis beyond that.
#[cfg(feature = "std")]
impl AxisCore {
    /// Its drive is in SAFEOP and on its way into OP, or has come there: until then outputs that it does not take are no loss.
    pub(crate) const fn await_op(&mut self, awaits_op: bool) {
        self.known.observed.link.await_op(awaits_op);
    }

    /// Whether a step with these inputs, which are those of the last one, may be left out, if it is counted later: it does nothing, and the
    /// port has taken in everything.
    #[inline]
    pub(crate) fn rests_at(&self, now: Duration, inputs: &Inputs<'_>) -> bool {
        self.stays(nanoseconds(now), inputs) && self.report.0.change == SnapshotChange::Nothing
    }

    /// Counts the steps that were left out: there were so many in all.
    #[inline]
    pub(crate) const fn count_to(&mut self, cycles: u64) {
        self.report.0.cycle = cycles;
    }

    #[inline]
    pub(crate) const fn cycle(&self) -> u64 {
        self.report.0.cycle
    }

    /// What is new since this was asked last.
    #[inline]
    pub(crate) const fn take_change(&mut self) -> SnapshotChange {
        core::mem::replace(&mut self.report.0.change, SnapshotChange::Nothing)
    }

    /// Why the axis has stopped being driven since this was asked last, where no command has stopped it. What was asked for before that is
    /// not to move it after it was enabled again.
    #[inline]
    pub(crate) const fn take_fall(&mut self) -> Option<Failure> {
        self.machines.fallen.0.take()
    }

    /// Position and velocity, as the snapshot has them.
    #[inline]
    pub(crate) fn motion(&self) -> (i32, i32) {
        self.known.observed.sample.map_or((0, 0), |sample| {
            (sample.position, sample.velocity.unwrap_or(0))
        })
    }

    /// Cycles since inputs came in last.
    #[inline]
    pub(crate) const fn age(&self) -> u32 {
        self.known.observed.link.age.0
    }

    /// Whether the axis stands; of one that does not answer, whether it did when it answered last.
    pub(crate) const fn stands(&self) -> bool {
        self.known.observed.stands()
    }

    /// The strongest stop that is under way; and what stops an axis that is not to move while this one cannot: nothing while this one may
    /// move.
    pub(crate) fn stops(&self) -> [StopRequest; 2] {
        let machines = &self.machines;
        let under_way = machines.stopping.under_way();
        let is_enabled = machines.is_stepped_in(self.known.observed.state());
        let is_in_doubt =
            machines.modes.sequencer.needs_stop() || machines.modes.homing.is_unknown();
        if is_enabled && !is_in_doubt && !self.known.observed.link.lost {
            [under_way, under_way]
        } else {
            [under_way, StopRequest::QUICK_STOP]
        }
    }

    /// What the drive held when it was attached last.
    pub(crate) fn drive_settings(&self) -> super::DriveSettings {
        super::DriveSettings::of(&self.known.config.0)
    }

    /// How long a disable may take at most, with the stop of a moving axis before it.
    pub(crate) fn longest_stop(&self) -> Duration {
        let deadlines = &self.known.config.0.deadlines;
        let closing = match &self.known.config.0.brake {
            Some(Brake::Output(brake)) => brake.set,
            Some(Brake::DriveManaged) | None => Duration::ZERO,
        };
        deadlines
            .standstill
            .saturating_add(deadlines.disable)
            .saturating_add(closing)
            .saturating_add(self.known.bounds.0.settle)
    }

    /// Begins again as if it had just been made, for a drive that does not act on its outputs now. Everything that is pending ends
    /// as lost. No enable, set-point or velocity is left in the outputs. The axis counts as lost until its drive takes outputs
    /// again.
    pub(crate) fn restart(&mut self, now: Duration, again: Reattach, outputs: &mut [u8]) {
        let answered = self.known.observed.link.answered;
        let was_lost = core::mem::replace(&mut self.known.observed.link.lost, true);
        let step = self.known.between(&self.machines, now);
        if !was_lost {
            self.machines.lose(&step, answered);
        }
        // Of a drive that answers, those who wait for a stop have waited on. What it shows from now on is of another beginning.
        let failure = Machines::failure_of_loss(answered);
        let step = self.known.between(&self.machines, now);
        self.machines.fail_commands(&step, failure);
        self.machines.fail_stops(failure);
        let is_anew = matches!(again, Reattach::Anew(_));
        match again {
            Reattach::Unknown => {}
            Reattach::Kept(config) => {
                self.know(*config);
                self.recall_homing();
            }
            Reattach::Anew(config) => {
                self.know(*config);
                self.known.observed.forget_drive();
                self.machines.forget_drive();
            }
        }
        let state = self.known.observed.state();
        self.machines.restart(&self.known.config.0, state, is_anew);
        self.known.follow(&mut self.machines.modes.sequencer);
        self.finish(outputs);
    }

    /// What was read of the drive of an axis that is commanded nothing yet.
    pub(crate) fn know(&mut self, config: CoreConfig) {
        let (config, bounds) = config.with_bounds();
        self.machines.modes.know(&config);
        self.known.follow(&mut self.machines.modes.sequencer);
        *self.known.config.0 = config;
        self.known.bounds = Aside(bounds);
        // It was seen with other windows.
        self.known.observed.count_rest_anew();
        self.report.0.change = SnapshotChange::Anything;
        self.step_next();
    }

    /// The drive has kept its power: where it was homed before it counted as lost, it still is.
    pub(crate) fn recall_homing(&mut self) {
        self.machines.modes.recall_reference();
        self.report.0.change = SnapshotChange::Anything;
        self.step_next();
    }

    /// The drive's power was off: what it knew before is gone, its position among it.
    pub(crate) const fn forget(&mut self) {
        self.machines.modes.forget_reference();
    }
}

/// What is known of the drive of an axis that begins again.
#[cfg(feature = "std")]
#[derive(Debug)]
pub(crate) enum Reattach {
    /// Nothing yet: its outputs must be harmless, whatever comes.
    Unknown,
    /// It has kept its power, and with it what it knows. This is what it holds now.
    Kept(Box<CoreConfig>),
    /// It was without power, or was set back: this is what it holds now.
    Anew(Box<CoreConfig>),
}
