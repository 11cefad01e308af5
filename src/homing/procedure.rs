//! Bit 4 of the controlword and bits 10, 12 and 13 of the statusword in homing mode.
//!
//! Contract: the axis core calls [`Procedure::step`] in every cycle with fresh inputs in Operation enabled with mode 6
//! shown, [`Procedure::outside`] in the others, and puts [`Procedure::bits`] into the next controlword. Whatever ends the
//! homing is reported by [`Procedure::fail`], after which bit 4 stays as it is until [`Procedure::lower`].
//!
//! What the three bits mean is the table of CiA DSP 402 v2.0, 13.2.2 (statusword in homing mode), as bits 13, 12, 10:
//! 000 in progress, 001 interrupted or not started, 010 attained and not yet at rest, 011 done, 100 error and moving,
//! 101 error at rest.

use core::time::Duration;

use crate::{
    ds402::{Controlword, ModeBits, Statusword},
    profile_position::{
        CommandId, Completion, Cycle, Delivery, Event, Events, Failure, ShownFor, WaitingFor,
    },
};

use super::HomingCommand;

/// Where the homing is.
#[derive(Debug, Clone, Copy, Hash)]
enum HomingPhase {
    /// Bit 4 is low; a homing may be waiting to be started.
    Low {
        /// Since when it is known to have been delivered low in this mode.
        delivered: Option<Duration>,
        waiting: Option<(CommandId, HomingCommand)>,
    },
    High(Run),
    /// Bit 4 is high and its homing has been reported as failed: a stop is under way.
    Abandoned,
    /// Halted: the drive may go on when bit 8 falls, so only a quick stop leads on.
    Halted,
    /// Bit 4 was sent and nothing came of it that differs from what an earlier homing leaves: only a stop makes that known.
    Unknown,
}

const LOW: HomingPhase = HomingPhase::Low {
    delivered: None,
    waiting: None,
};

/// What the axis core must do after a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HomingVerdict {
    /// Nothing.
    GoOn,
    /// The axis knows where it is.
    Attained,
    /// The drive reports an error and does not come to rest: stop it.
    StopIt,
    /// It has not ended in its time: halt it, then stop it.
    EndIt,
}

/// The sequencing of one drive axis' homing.
#[derive(Debug, Clone, Hash)]
pub(crate) struct Procedure {
    stage: HomingPhase,
    /// How long an axis with an error may take to come to rest.
    standstill: Duration,
}

impl Procedure {
    pub const fn new(standstill: Duration) -> Self {
        Self {
            stage: LOW,
            standstill,
        }
    }

    /// Bit 4 of the next controlword.
    pub const fn bits(&self) -> ModeBits {
        match self.stage {
            HomingPhase::High(_) | HomingPhase::Abandoned => ModeBits::HOMING_START,
            HomingPhase::Low { .. } | HomingPhase::Halted | HomingPhase::Unknown => ModeBits::NONE,
        }
    }

    /// Whether the drive is homing, or may be, or would go on when bit 8 falls.
    pub const fn has_motion(&self) -> bool {
        match self.stage {
            HomingPhase::Low { .. } => false,
            HomingPhase::High(Run { sent, .. }) => sent,
            HomingPhase::Abandoned | HomingPhase::Halted | HomingPhase::Unknown => true,
        }
    }

    /// Whether no homing waits or is under way.
    pub const fn is_idle(&self) -> bool {
        matches!(self.stage, HomingPhase::Low { waiting: None, .. })
    }

    /// Whether a cycle like the last one changes nothing. `in_mode`: the drive is enabled and shows mode 6, if it is to.
    pub const fn allows_idle_path(&self, in_mode: bool) -> bool {
        match self.stage {
            HomingPhase::Low {
                waiting: None,
                delivered,
            } => delivered.is_some() || !in_mode,
            _ => false,
        }
    }

    /// Whether the homing with this number was sent and has not ended.
    #[cfg(feature = "std")]
    pub fn is_under_way(&self, id: CommandId) -> bool {
        matches!(self.stage, HomingPhase::High(run) if run.sent && run.id == id)
    }

    /// Whether bit 4 was sent without an answer: only a stop clears that.
    pub const fn is_unknown(&self) -> bool {
        matches!(self.stage, HomingPhase::Unknown)
    }

    /// Takes a checked homing in; one at a time.
    pub fn submit(&mut self, id: CommandId, command: HomingCommand, events: &mut Events) {
        match &mut self.stage {
            HomingPhase::Low { waiting, .. } if waiting.is_none() => *waiting = Some((id, command)),
            _ => events.push(id, Event::Done(Err(Failure::Busy))),
        }
    }

    /// Withdraws a homing that has not been sent; whether there was one.
    pub fn withdraw(&mut self, id: CommandId, failure: Failure, events: &mut Events) -> bool {
        let unsent = self.unsent() == Some(id);
        if unsent {
            self.withdraw_unsent(failure, events);
        }
        unsent
    }

    /// A stop takes over: a homing that is not sent does not start.
    pub fn withdraw_unsent(&mut self, failure: Failure, events: &mut Events) {
        if let Some(id) = self.unsent() {
            self.stage = LOW;
            events.push(id, Event::Done(Err(failure)));
        }
    }

    /// The outputs composed last have been sent. Whether a homing has begun with them.
    pub fn mark_sent(&mut self, now: Duration) -> bool {
        match &mut self.stage {
            HomingPhase::High(run) if !run.sent => {
                run.sent = true;
                run.since = now;
                true
            }
            _ => false,
        }
    }

    /// Ends it with this failure, which says how far it came. Bit 4 stays as it was sent.
    pub fn fail(&mut self, failure: Failure, events: &mut Events) {
        self.withdraw_unsent(failure.with_delivery(Delivery::NotSent), events);
        if let HomingPhase::High(run) = self.stage {
            let failure = failure.with_delivery(run.delivery());
            events.push(run.id, Event::Done(Err(failure)));
            self.stage = HomingPhase::Abandoned;
        }
    }

    /// The axis stands halted: the homing is over, and bit 4 falls.
    pub fn halted(&mut self, events: &mut Events) {
        if let HomingPhase::High(run) = self.stage {
            let failure = Failure::Halted {
                delivery: run.delivery(),
            };
            events.push(run.id, Event::Done(Err(failure)));
        }
        if matches!(self.stage, HomingPhase::High(_) | HomingPhase::Abandoned) {
            self.stage = HomingPhase::Halted;
        }
    }

    /// The axis is out of Operation enabled: bit 4 is low and no homing goes on.
    pub const fn lower(&mut self) {
        self.stage = LOW;
    }

    /// A cycle in another mode or state: what bit 4 was there counts for nothing here.
    pub const fn outside(&mut self) {
        if let HomingPhase::Low { delivered, .. } = &mut self.stage {
            *delivered = None;
        }
    }

    /// One cycle with fresh inputs in Operation enabled and mode 6.
    pub fn step(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> HomingVerdict {
        match &mut self.stage {
            HomingPhase::Low { delivered, waiting } => {
                let low = !cycle.controlword.contains(Controlword::HOMING_START);
                if low && cycle.delivered {
                    delivered.get_or_insert(cycle.now);
                }
                // The drive has surely seen bit 4 low in this mode, and shows the bits of this mode, after two of its cycles.
                let seen = delivered.is_some_and(|since| cycle.is_seen(since));
                if let Some((_, command)) = *waiting
                    && command.is_late(cycle.now)
                {
                    let failure = Failure::Timeout {
                        waiting_for: WaitingFor::HomingEnd,
                        statusword: cycle.sample.statusword,
                        controlword: cycle.controlword,
                        delivery: Delivery::NotSent,
                    };
                    self.withdraw_unsent(failure, events);
                } else if let Some((id, command)) = *waiting
                    && seen
                    && cycle.delivered
                    && !cycle.halted
                {
                    self.stage = HomingPhase::High(Run::new(id, command, cycle));
                }
                HomingVerdict::GoOn
            }
            HomingPhase::High(run) if run.sent => {
                let was_begun = run.begun;
                // A halted one ends at standstill, to which it has to come in time. Its own time goes on.
                let end = if cycle.halted {
                    let since = *run.halted_since.get_or_insert(cycle.now);
                    let late = cycle.now.saturating_sub(since) >= self.standstill;
                    (late || run.is_late(cycle)).then(|| Err(run.timeout(cycle)))
                } else {
                    run.halted_since = None;
                    run.step(cycle, self.standstill)
                };
                let id = run.id;
                if run.begun && !was_begun {
                    events.push(id, Event::Accepted);
                }
                match end {
                    None => HomingVerdict::GoOn,
                    Some(result) => self.end(id, result, events),
                }
            }
            _ => HomingVerdict::GoOn,
        }
    }

    fn end(
        &mut self,
        id: CommandId,
        result: Result<Completion, Failure>,
        events: &mut Events,
    ) -> HomingVerdict {
        events.push(id, Event::Done(result));
        self.stage = LOW;
        match result {
            Ok(_) => HomingVerdict::Attained,
            Err(Failure::HomingError { moving: true }) => {
                self.stage = HomingPhase::Abandoned;
                HomingVerdict::StopIt
            }
            Err(Failure::Timeout {
                waiting_for: WaitingFor::HomingEnd,
                ..
            }) => {
                self.stage = HomingPhase::Abandoned;
                HomingVerdict::EndIt
            }
            Err(Failure::Timeout { .. }) => {
                self.stage = HomingPhase::Unknown;
                HomingVerdict::GoOn
            }
            Err(_) => HomingVerdict::GoOn,
        }
    }

    const fn unsent(&self) -> Option<CommandId> {
        match self.stage {
            HomingPhase::Low {
                waiting: Some((id, _)),
                ..
            }
            | HomingPhase::High(Run {
                id, sent: false, ..
            }) => Some(id),
            _ => None,
        }
    }
}

// A homing whose bit 4 is high: what the drive's bits say of it, and not of an earlier one.

/// A homing whose bit 4 is high.
#[derive(Debug, Clone, Copy, Hash)]
struct Run {
    pub id: CommandId,
    command: HomingCommand,
    pub sent: bool,
    /// When bit 4 was sent.
    pub since: Duration,
    /// When it is known to have been delivered.
    delivered: Option<Duration>,
    /// Bit 12 was high when bit 4 rose: of an earlier homing, until it has been low.
    stale_attained: bool,
    /// Whether it was: then one word without it is no edge.
    was_attained: bool,
    /// Bit 13, likewise.
    stale_error: bool,
    /// Since when bit 13 has been low.
    no_error_since: Option<Duration>,
    /// The bits said "in progress" before bit 4 rose, and have since: they do of some drives at rest.
    stale_progress: bool,
    /// Since when it is halted.
    halted_since: Option<Duration>,
    /// Where the axis was before bit 4 rose.
    position: i32,
    /// Whether it has been elsewhere since.
    left: bool,
    /// The drive has shown that it is at work on this one.
    pub begun: bool,
    /// Since when it shows that it is at work on this one, and whether it has in more than one word.
    at_work_since: Option<Duration>,
    /// Since when bit 12 has been high without an error.
    attained_since: Option<Duration>,
    worked: bool,
    /// Since when all three bits say done; whether they do for a settle time; and they have since bit 4 is known to have been delivered.
    done_since: Option<Duration>,
    done: ShownFor,
    done_after: ShownFor,
    /// Bit 12 says so of this one, and the axis stands.
    attained: ShownFor,
    /// Since when the drive has not been at work on this one, by bits 12 and 10.
    over_since: Option<Duration>,
    /// Since when the drive has shown an error, and that the axis rests with it.
    error_since: Option<Duration>,
    error_at_rest: ShownFor,
}

impl Run {
    /// How far it came, should it not end well.
    pub const fn delivery(&self) -> Delivery {
        if self.begun {
            Delivery::Accepted
        } else {
            Delivery::Unknown
        }
    }

    pub const fn new(id: CommandId, command: HomingCommand, cycle: &Cycle<'_>) -> Self {
        let word = cycle.sample.statusword;
        Self {
            id,
            command,
            sent: false,
            since: cycle.now,
            delivered: None,
            stale_attained: word.contains(Statusword::HOMING_ATTAINED),
            was_attained: word.contains(Statusword::HOMING_ATTAINED),
            stale_error: word.contains(Statusword::HOMING_ERROR),
            no_error_since: None,
            stale_progress: is_in_progress(word),
            halted_since: None,
            position: cycle.sample.position,
            left: false,
            begun: false,
            at_work_since: None,
            attained_since: None,
            worked: false,
            done_since: None,
            done: ShownFor::NOT,
            done_after: ShownFor::NOT,
            attained: ShownFor::NOT,
            over_since: None,
            error_since: None,
            error_at_rest: ShownFor::NOT,
        }
    }

    /// One cycle after bit 4 was sent; the result, once there is one.
    pub fn step(
        &mut self,
        cycle: &Cycle<'_>,
        standstill: Duration,
    ) -> Option<Result<Completion, Failure>> {
        let word = cycle.sample.statusword;
        let attained = word.contains(Statusword::HOMING_ATTAINED);
        let error = word.contains(Statusword::HOMING_ERROR);
        let at_rest = word.contains(Statusword::TARGET_REACHED);
        if cycle.delivered {
            self.delivered.get_or_insert(cycle.now);
        }
        // The fall of what an earlier homing has left is this one's doing, and so is "in progress" where it is news. Where it
        // is none, the axis leaves where it was, or bit 12 rises, after the drive has surely seen bit 4.
        let fell = self.stale_attained && !attained && !error;
        let progress = is_in_progress(word);
        // One word may be wrong.
        let sure = |since| cycle.is_seen(since);
        let seen = self.delivered.is_some_and(sure);
        let at_work = fell || progress;
        let still = self.at_work_since.filter(|_| !attained && !error);
        self.at_work_since = still.or(at_work.then_some(cycle.now));
        self.worked |= self.at_work_since.is_some_and(sure);
        let left =
            cycle.bounds.distance(self.position, cycle.sample.position) > cycle.bounds.position;
        let only_attained = attained && !error;
        self.attained_since = only_attained.then(|| self.attained_since.unwrap_or(cycle.now));
        let attained_for_sure = self.attained_since.is_some_and(sure);
        self.left |= left;
        self.begun |= if self.stale_progress {
            seen && !error && (attained_for_sure || left)
        } else {
            at_work
        };
        let start = if self.stale_progress {
            // It may take its time to leave.
            cycle.acknowledge.max(cycle.begin)
        } else {
            cycle.acknowledge
        };
        self.stale_progress &= progress || attained;
        self.stale_attained &= attained;
        // One word without an old error makes none anew.
        self.no_error_since = (!error).then(|| self.no_error_since.unwrap_or(cycle.now));
        self.stale_error &= !self.no_error_since.is_some_and(sure);
        let late = self.begun && cycle.now.saturating_sub(self.since) >= start;

        if error && (!self.stale_error || late) {
            self.begun |= self.error_since.is_some_and(sure);
            return self.error(cycle, at_rest, standstill);
        }
        if !error {
            self.error_since = None;
            self.error_at_rest = ShownFor::NOT;
        }
        let done = attained && at_rest && !error;
        let (now, settle) = (cycle.now, cycle.bounds.settle);
        let held = self.done.update(now, done, settle);
        self.done_since = done.then(|| self.done_since.unwrap_or(now));
        let done_for_sure = self.done_since.is_some_and(sure);
        // So long that a drive that is at work on this one would show it.
        let long = settle.max(cycle.traits.surely_seen().saturating_mul(2));
        let told = self.delivered.is_some();
        let proven = self.done_after.update(now, done && told, long);
        let mine = attained && !error && self.is_mine(cycle, proven);
        let stands = cycle.standstill.is_standing();
        let rested = self.attained.update(now, mine && stands, cycle.begin);
        let is_over = self.begun && !progress && !error;
        self.over_since = is_over.then(|| self.over_since.unwrap_or(now));
        let over = |since: Duration| now.saturating_sub(since) >= standstill;
        if self.is_late(cycle) || self.over_since.is_some_and(over) {
            return Some(Err(self.timeout(cycle)));
        }
        self.begun |= mine;
        // Where standstill does not show because the axis is never quiet, the drive's word counts after a while; and where bit 10 does
        // not come, the axis' rest.
        let started = now.saturating_sub(self.since) >= start;
        // Where bit 12 was high before, one word without it proves nothing, however long ago it was. The axis has left where it was by then,
        // or it reads home.
        let was_at_work = self.worked
            || match (self.command.method.is_motionless(), self.was_attained) {
                (true, true) => proven && self.reads_home(cycle),
                (true, false) => true,
                (false, true) => started && (self.left || self.reads_home(cycle)),
                (false, false) => started,
            };
        if mine && was_at_work && ((stands && done_for_sure) || held || rested) {
            return Some(Ok(Completion::Homed {
                position: cycle.sample.position,
            }));
        }
        if !self.begun && started {
            if error {
                // An error that has stood all the time. With the drive at rest it did not even begin.
                return self.error(cycle, at_rest, standstill);
            }
            return Some(Err(Failure::Timeout {
                waiting_for: WaitingFor::HomingStart,
                statusword: word,
                controlword: cycle.controlword,
                delivery: Delivery::Unknown,
            }));
        }
        None
    }

    /// Whether its time is over.
    pub fn is_late(&self, cycle: &Cycle<'_>) -> bool {
        self.command.is_late(cycle.now)
    }

    /// It has not ended in its time.
    pub const fn timeout(&self, cycle: &Cycle<'_>) -> Failure {
        Failure::Timeout {
            waiting_for: WaitingFor::HomingEnd,
            statusword: cycle.sample.statusword,
            controlword: cycle.controlword,
            delivery: self.delivery(),
        }
    }

    /// Whether bits that say "done" say it of this homing. `proven`: they have for so long that a drive that has not begun never would.
    fn is_mine(&self, cycle: &Cycle<'_>, proven: bool) -> bool {
        if self.begun {
            return !self.stale_attained;
        }
        if !self.command.method.is_motionless() {
            return false;
        }
        // Nothing moves: "in progress" may be over within one of the drive's cycles and never be seen. An edge of bit 12
        // after bit 4 is proof as well. Without one, the drive has had bit 4 for so long that it would show it if it were
        // still at work, and the axis reads what it reads at home: then even a drive that has not seen bit 4 tells the truth.
        !self.stale_attained || (self.reads_home(cycle) && proven)
    }

    /// Whether the position is what it is at home: the home offset, with the sign that the drive gives it.
    fn reads_home(&self, cycle: &Cycle<'_>) -> bool {
        let offset = self.command.offset.unwrap_or(0);
        [offset, offset.wrapping_neg()]
            .into_iter()
            .any(|home| cycle.bounds.is_within_window(home, cycle.sample.position))
    }

    fn error(
        &mut self,
        cycle: &Cycle<'_>,
        at_rest: bool,
        standstill: Duration,
    ) -> Option<Result<Completion, Failure>> {
        let since = *self.error_since.get_or_insert(cycle.now);
        let shown_for = cycle.now.saturating_sub(since);
        // As with a good end, one word may be wrong.
        let held = self
            .error_at_rest
            .update(cycle.now, at_rest, cycle.bounds.settle);
        let stands = cycle.standstill.is_standing() && cycle.is_seen(since);
        let (moving, late) = (!(stands || held), shown_for >= standstill);
        (!moving || late).then_some(Err(Failure::HomingError { moving }))
    }
}

/// Bits 13, 12 and 10 as 000.
const fn is_in_progress(word: Statusword) -> bool {
    !word.intersects(
        Statusword::HOMING_ATTAINED
            .union(Statusword::HOMING_ERROR)
            .union(Statusword::TARGET_REACHED),
    )
}
