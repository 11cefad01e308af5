//! The active mode: whose bits and set-points are in the outputs, and how one mode gives way to another.

use crate::{
    Failure,
    ds402::{Mode, ModeBits, State},
    homing::{HomingVerdict, Procedure},
    profile_position::{
        Bounds, CommandId, Completion, Cycle, Delivery, Event, Events, Parameters, Quiet,
        Sequencer, WaitingFor,
    },
    profile_velocity::{JogStep, Jogging},
    timer::{Due, Timer, UntilSeen},
};

use super::{CoreConfig, machines::Step};

/// The machines of the modes, and which of them is active.
#[derive(Debug, Clone, Hash)]
pub(super) struct Modes {
    pub sequencer: Sequencer,
    pub homing: Procedure,
    pub jogging: Jogging,
    /// What 6060h is, or is to be.
    active: Mode,
    change: Option<ModeChange>,
    /// What 6060h is, or is about to be, by SDO, until 6061h has shown it.
    by_sdo: Option<Mode>,
    /// So long the drive may come to a mode that was taken back: nothing begins before.
    hold: Timer,
    /// That no bit of a mode and no velocity is sent.
    quiet: UntilSeen,
    reference: Reference,
}

/// Whether the axis knows where it is, by a homing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Reference {
    None,
    Homed,
    /// It was homed when its drive was lost: that is still true of a drive that has kept its power.
    BeforeLoss,
}

/// A change of 6060h.
#[derive(Debug, Clone, Copy, Hash)]
struct ModeChange {
    id: CommandId,
    to: Mode,
    before: Mode,
    /// Of the wait that is under way.
    left: Timer,
    step: ModeStep,
}

/// How far a change of mode is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum ModeStep {
    /// Until the axis stands and the drive has surely seen the bits of the last mode low and its target velocity 0.
    Quiet { by_sdo: bool },
    /// 6060h is in the outputs, or was written by SDO: 6061h is awaited.
    Written,
}

/// What a machine of a mode asks for.
pub(super) enum ModeStepped {
    Nothing,
    /// Quick stop, for which nobody has asked.
    QuickStop,
    /// Halt, then quick stop.
    Stop,
    CountRestAnew,
}

impl Modes {
    pub fn new(config: &CoreConfig) -> Self {
        Self {
            sequencer: Sequencer::new(config.defaults),
            homing: Procedure::new(),
            jogging: Jogging::new(),
            active: config.mode,
            change: None,
            by_sdo: None,
            hold: Timer::OVER,
            quiet: UntilSeen::UNDELIVERED,
            reference: Reference::of(config.homed),
        }
    }

    /// The machines begin again; what was written by SDO, or taken back, is in the drive still. `is_anew`: a drive that was without power
    /// comes to nothing that was taken back.
    #[cfg(feature = "std")]
    pub fn restart(&mut self, config: &CoreConfig, is_anew: bool) {
        *self = Self {
            active: self.active,
            by_sdo: self.by_sdo,
            hold: if is_anew { Timer::OVER } else { self.hold },
            reference: self.reference,
            sequencer: self.sequencer_anew(config),
            ..Self::new(config)
        };
    }

    /// The drive's settings are read, before anything moves.
    #[cfg(feature = "std")]
    pub fn know(&mut self, config: &CoreConfig) {
        self.sequencer = self.sequencer_anew(config);
        self.reference = match self.reference {
            Reference::BeforeLoss if !config.homed => Reference::BeforeLoss,
            _ => Reference::of(config.homed),
        };
    }

    /// What the program has set stays.
    #[cfg(feature = "std")]
    const fn sequencer_anew(&self, config: &CoreConfig) -> Sequencer {
        let factor = self.sequencer.velocity_override();
        Sequencer::new(config.defaults).with_override(factor)
    }

    pub const fn active(&self) -> Mode {
        self.active
    }

    pub fn is_homed(&self) -> bool {
        self.reference == Reference::Homed
    }

    /// The drive is lost.
    pub fn lose_reference(&mut self) {
        if self.is_homed() {
            self.reference = Reference::BeforeLoss;
        }
    }

    /// The drive has kept its power.
    #[cfg(feature = "std")]
    pub fn recall_reference(&mut self) {
        if self.reference == Reference::BeforeLoss {
            self.reference = Reference::Homed;
        }
    }

    /// The drive was without power.
    #[cfg(feature = "std")]
    pub const fn forget_reference(&mut self) {
        self.reference = Reference::None;
    }

    /// Bits 4, 5, 6 and 9 of the next controlword, of a drive that follows us.
    pub const fn bits(&self) -> ModeBits {
        match self.active {
            Mode::ProfilePosition => self.sequencer.bits(),
            Mode::Homing => self.homing.bits(),
            _ => ModeBits::NONE,
        }
    }

    /// Target velocity 60FFh of the next outputs, of a drive that follows us.
    pub const fn target_velocity(&self) -> i32 {
        match self.active {
            Mode::ProfileVelocity => self.jogging.velocity(),
            _ => 0,
        }
    }

    /// Profile parameters of the next outputs: of a jog its ramps in place of those of the moves.
    pub fn parameters(&self) -> Parameters {
        let held = self.sequencer.outgoing();
        if self.active != Mode::ProfileVelocity {
            return held;
        }
        let ramps = self.jogging.ramps();
        Parameters {
            acceleration: ramps.acceleration.or(held.acceleration),
            deceleration: ramps.deceleration.or(held.deceleration),
            ..held
        }
    }

    /// Whether the drive follows a set-point of any mode, or may.
    pub fn has_motion(&self) -> bool {
        self.sequencer.has_set_point() || self.homing.has_motion() || self.jogging.has_motion()
    }

    /// Whether nothing waits and nothing is under way, in any mode.
    pub fn is_idle(&self) -> bool {
        self.sequencer.is_idle()
            && self.homing.is_idle()
            && self.jogging.is_idle()
            && !self.has_motion()
    }

    /// The outputs composed last have been sent.
    pub fn mark_sent(&mut self, events: &mut Events) {
        self.sequencer.mark_sent();
        self.jogging.mark_sent(events);
        if self.homing.mark_sent() {
            // From now on the drive's positions are between two meanings.
            self.reference = Reference::None;
        }
    }

    /// Ends every motion with this failure, which says how far each set-point came.
    pub fn fail_motions(&mut self, failure: Failure, events: &mut Events) {
        self.sequencer.fail_all(failure, events);
        self.homing.fail(failure, events);
        self.jogging.end(failure, events);
    }

    /// A stop takes over: what is not sent is not started, and a velocity that is held is let go with this frame.
    pub fn withdraw_unsent(&mut self, failure: Failure, events: &mut Events) {
        self.sequencer.withdraw_unsent(failure, events);
        self.homing.withdraw_unsent(failure, events);
        self.jogging.end(failure, events);
        if let Some(change) = self
            .change
            .take_if(|change| change.step != ModeStep::Written)
        {
            events.push(change.id, Event::Done(Err(failure)));
        }
    }

    /// Withdraws a motion that was not sent, or a change of mode; whether there was one.
    pub fn withdraw(&mut self, id: CommandId, step: &Step<'_>, events: &mut Events) -> bool {
        let failure = Failure::Withdrawn;
        let withdrawn = self.sequencer.withdraw(id, failure, events)
            || self.homing.withdraw(id, failure, events)
            || self.jogging.withdraw(id, failure, events);
        let awaited = self.change.is_some_and(|change| change.id == id);
        if awaited {
            self.fail_change(failure, step, events);
        }
        withdrawn || awaited
    }

    /// The axis is out of Operation enabled: no bit of a mode stays, and nothing is held any more.
    pub fn lower(&mut self, state: State, events: &mut Events) {
        self.sequencer.lower();
        self.homing.lower();
        // Nothing that leads here leaves a jog; should one be left, it must not come back with the next enable.
        self.jogging.end(Failure::Disabled { state }, events);
    }

    /// Whether a motion in this mode may begin, of a drive that shows this one.
    pub fn check(&self, expected: Mode, shown: Mode) -> Result<(), Failure> {
        if !self.is_settled() || shown != expected || self.active != expected {
            return Err(Failure::WrongMode {
                expected,
                shown,
                delivery: Delivery::NotSent,
            });
        }
        Ok(())
    }

    /// Whether a change of mode is under way.
    pub const fn is_changing(&self) -> bool {
        self.change.is_some()
    }

    /// Whether the drive comes to no other mode.
    const fn is_settled(&self) -> bool {
        self.change.is_none() && self.by_sdo.is_none() && self.hold.is_over()
    }

    /// Whether this mode is active already, and shown.
    pub fn is_there(&self, to: Mode, shown: Mode) -> bool {
        shown == to && self.active == to && self.is_settled()
    }

    /// A change of mode begins: it is written as soon as nothing of the last mode is left.
    pub fn select(&mut self, id: CommandId, to: Mode, by_sdo: bool, step: &Step<'_>) {
        let config = step.config;
        let deadline = config.deadlines.mode;
        // The drive may come to the one that was written before.
        if self.by_sdo.is_some_and(|mode| mode != to) {
            self.hold = step.timer(deadline);
        }
        // It has its time from when nothing keeps it from being written.
        let left = Timer::new(deadline).later(step.ahead.max(self.hold.left()));
        self.change = Some(ModeChange {
            id,
            to,
            before: self.active,
            left,
            step: ModeStep::Quiet { by_sdo },
        });
    }

    /// Writes 6060h, or says that it may be written, once nothing of the last mode is left that the next could take for its own. `rests`:
    /// nor does the axis move, nor go on.
    pub fn write(&mut self, rests: bool, position: i32, events: &mut Events) {
        let Some(change) = &mut self.change else {
            return;
        };
        let ModeStep::Quiet { by_sdo } = change.step else {
            return;
        };
        if !(self.quiet.is_seen() && rests && (by_sdo || self.hold.is_over())) {
            return;
        }
        // 607Ah still holds the last move's target or distance; another mode may follow it at once.
        self.sequencer.follow_position(position);
        if by_sdo {
            self.by_sdo = Some(change.to);
            let prepared = Ok(Completion::Prepared { mode: change.to });
            events.push(change.id, Event::Done(prepared));
            self.change = None;
        } else {
            change.step = ModeStep::Written;
            self.active = change.to;
            self.homing.outside();
            self.sequencer.outside();
        }
    }

    /// Time passes, in each cycle.
    pub fn pass_time(&mut self, step: &Step<'_>) {
        self.hold.pass(step.elapsed);
        if step.sends_mode_bits() {
            self.quiet = UntilSeen::UNDELIVERED;
        } else {
            self.quiet.update(step.delivered, step.elapsed, step.seen);
        }
    }

    /// One cycle of a change of mode. `rests` as above.
    pub fn step_change(&mut self, step: &Step<'_>, rests: bool, events: &mut Events) {
        self.write(rests, step.position(), events);
        let Some(change) = &mut self.change else {
            return;
        };
        change.left.pass(step.elapsed);
        let change = *change;
        if change.step == ModeStep::Written && step.mode == change.to {
            (self.change, self.by_sdo) = (None, None);
            events.push(change.id, Event::Done(Ok(Completion::Done)));
        } else if change.left.is_over() {
            let moves = matches!(change.step, ModeStep::Quiet { .. }) && !step.stands();
            let failure = if moves {
                Failure::Moving
            } else {
                step.timeout(WaitingFor::Mode(change.to), Delivery::NotSent)
            };
            self.fail_change(failure, step, events);
        }
    }

    /// A change of mode ends; the mode before is in the outputs again. What was written by SDO stays in the drive.
    pub fn fail_change(&mut self, failure: Failure, step: &Step<'_>, events: &mut Events) {
        let Some(change) = self.change.take() else {
            return;
        };
        self.active = change.before;
        let is_in_outputs = change.step == ModeStep::Written && step.config.fields.mode.is_some();
        if is_in_outputs && change.to != change.before {
            self.hold = step.timer(step.config.deadlines.mode);
        }
        events.push(change.id, Event::Done(Err(failure)));
    }

    /// One cycle in Operation enabled: the active mode's machine goes on.
    pub fn step(&mut self, cycle: &Cycle<'_>, shown: Mode, events: &mut Events) -> ModeStepped {
        if shown != self.active {
            self.homing.outside();
            self.sequencer.outside();
            if self.is_idle() {
                return ModeStepped::Nothing;
            }
            let failure = Failure::WrongMode {
                expected: self.active,
                shown,
                delivery: Delivery::NotSent,
            };
            self.fail_motions(failure, events);
            return ModeStepped::QuickStop;
        }
        if self.active == Mode::ProfilePosition {
            self.sequencer.step(cycle, events);
            return ModeStepped::Nothing;
        }
        // Whoever looks at 607Ah finds no jump, not even after the zero has moved. A drive that takes its set-points from there would chase
        // its own position.
        if matches!(self.active, Mode::Homing | Mode::ProfileVelocity) {
            self.sequencer.follow_position(cycle.evidence.position);
        }
        if self.has_motion() {
            self.sequencer.forget_place();
        }
        match self.active {
            Mode::Homing => match self.homing.step(cycle, events) {
                HomingVerdict::GoOn => {}
                HomingVerdict::Attained => self.reference = Reference::Homed,
                HomingVerdict::StopIt => return ModeStepped::QuickStop,
                HomingVerdict::EndIt => return ModeStepped::Stop,
            },
            Mode::ProfileVelocity => match self.jogging.step(cycle, events) {
                JogStep::GoOn => {}
                JogStep::Seen => return ModeStepped::CountRestAnew,
                JogStep::RunsOn => return ModeStepped::QuickStop,
            },
            _ => {}
        }
        ModeStepped::Nothing
    }

    /// When it has something to do without a word of the drive. `in_mode`: the machine of the active mode is stepped.
    pub fn due(&self, in_mode: bool) -> Due {
        let change = Due::next_if(self.change.is_some());
        let machine = match self.active {
            Mode::ProfilePosition => self.sequencer.due(in_mode),
            Mode::Homing => self.homing.due(in_mode),
            _ => self.jogging.due(),
        };
        let quiet = self.quiet.due();
        change.sooner(machine).sooner(self.hold.due()).sooner(quiet)
    }

    /// Where the next position tells nothing, as seen from this one. `in_mode` as above.
    pub fn quiet(&self, in_mode: bool, position: i32, bounds: &Bounds) -> Quiet {
        match self.active {
            Mode::ProfilePosition if in_mode => self.sequencer.quiet(position, bounds),
            Mode::ProfilePosition => Quiet::EVERYWHERE,
            // 607Ah follows the axis.
            _ => Quiet::NOWHERE,
        }
    }
}

impl Reference {
    const fn of(homed: bool) -> Self {
        if homed { Self::Homed } else { Self::None }
    }
}
