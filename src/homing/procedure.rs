//! Bit 4 of the controlword and bits 10, 12 and 13 of the statusword in homing mode.
//!
//! Contract: the axis core calls [`Procedure::step`] in every cycle with inputs in Operation enabled with mode 6 shown,
//! [`Procedure::outside`] in the others, and puts [`Procedure::bits`] into the next controlword. Whatever ends the homing is reported by
//! [`Procedure::fail`], after which bit 4 stays as it is until [`Procedure::lower`].
//!
//! What the three bits mean is the table of CiA DSP 402 v2.0, 13.2.2 (statusword in homing mode), as bits 13, 12, 10:
//! 000 in progress, 001 interrupted or not started, 010 attained and not yet at rest, 011 done, 100 error and moving,
//! 101 error at rest.

use crate::{
    Failure,
    ds402::{Controlword, ModeBits},
    profile_position::{
        Bit, CommandId, Completion, Cycle, Delivery, Event, Events, Evidence, WaitingFor,
    },
    timer::{Due, Lasting, Timer, UntilSeen},
};

use super::HomingCommand;

/// Where the homing is.
#[derive(Debug, Clone, Copy, Hash)]
enum HomingPhase {
    /// Bit 4 is low; a homing may be waiting to be started.
    Low {
        /// The low, in this mode.
        seen: UntilSeen,
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
    seen: UntilSeen::UNDELIVERED,
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
}

impl Procedure {
    pub const fn new() -> Self {
        Self { stage: LOW }
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

    /// When it has something to do without a word of the drive. `in_mode`: it is stepped then.
    pub const fn due(&self, in_mode: bool) -> Due {
        match self.stage {
            HomingPhase::Low {
                waiting: None,
                seen,
            } if seen.is_delivered() => Due::NEVER,
            HomingPhase::Low { .. } | HomingPhase::High(_) => Due::next_if(in_mode),
            HomingPhase::Abandoned | HomingPhase::Halted | HomingPhase::Unknown => Due::NEVER,
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
    pub const fn mark_sent(&mut self) -> bool {
        match &mut self.stage {
            HomingPhase::High(run) if !run.sent => {
                run.sent = true;
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
        if let HomingPhase::Low { seen, .. } = &mut self.stage {
            *seen = UntilSeen::UNDELIVERED;
        }
    }

    /// One cycle with inputs in Operation enabled and mode 6.
    pub fn step(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> HomingVerdict {
        match &mut self.stage {
            HomingPhase::Low { seen, waiting } => {
                let low = !cycle.controlword.contains(Controlword::HOMING_START);
                seen.update(low && cycle.delivered, cycle.elapsed, cycle.rules.seen());
                // The drive has surely seen bit 4 low in this mode, and shows the bits of this mode.
                let is_seen = seen.is_seen();
                // D1: what an earlier homing has left is known.
                let evidence = &cycle.evidence;
                let bits = [evidence.reached, evidence.acknowledge, evidence.error];
                let is_steady = bits.into_iter().all(Bit::is_sure);
                if let Some((id, command)) = *waiting {
                    if command.is_late(cycle.now) {
                        let failure = cycle.timeout(WaitingFor::HomingEnd, Delivery::NotSent);
                        self.withdraw_unsent(failure, events);
                    } else if is_seen && cycle.delivered && !cycle.halted && is_steady {
                        self.stage = HomingPhase::High(Run::new(id, command, cycle));
                    }
                }
                HomingVerdict::GoOn
            }
            HomingPhase::High(run) if run.sent => {
                let was_sure = run.has_surely_begun();
                let end = run.step(cycle);
                let is_sure = run.has_surely_begun() || matches!(end, Some(Ok(_)));
                let (id, begins) = (run.id, is_sure && !was_sure);
                if begins {
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

/// A bit that an earlier homing may have left high.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Left {
    /// It was low when bit 4 rose.
    Low,
    /// It was high, and has been since.
    High,
    /// It was high, and has been low since, if that word was not wrong.
    Fallen,
}

impl Left {
    const fn by(bit: Bit) -> Self {
        if bit.is_low() { Self::Low } else { Self::High }
    }

    fn note(&mut self, bit: Bit) {
        if *self == Self::High && !bit.shows_high() {
            *self = Self::Fallen;
        }
    }
}

/// How far the drive is with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum HomingProgress {
    None,
    /// Bit 12 of an earlier homing fell for one word, which may be wrong.
    Perhaps,
    /// It is at work on this one, for all that shows.
    Begun,
    /// It was surely at work: "in progress" was news.
    Worked,
}

/// A homing whose bit 4 is high.
#[derive(Debug, Clone, Copy, Hash)]
struct Run {
    id: CommandId,
    command: HomingCommand,
    sent: bool,
    /// Until it has to show that it has begun.
    start: Timer,
    seen: UntilSeen,
    attained: Left,
    error: Left,
    /// The bits said "in progress" before bit 4 rose, as they do of some drives at rest.
    idles_in_progress: bool,
    progress: HomingProgress,
    /// Where the axis was before bit 4 rose; none once it has left that place.
    place: Option<i32>,
    /// Since the drive has shown an error, or has not been at work any more, or the axis is halted: until it has to be at rest.
    rest: Option<Timer>,
    /// All three bits say done; they have since bit 4 is known to have been delivered; bit 12 does and the axis stands.
    done: Lasting,
    proven: Lasting,
    rested: Lasting,
}

impl Run {
    const fn new(id: CommandId, command: HomingCommand, cycle: &Cycle<'_>) -> Self {
        let evidence = &cycle.evidence;
        let idles_in_progress = is_in_progress(evidence);
        let (acknowledge, begin) = (
            cycle.rules.timer(cycle.rules.acknowledge),
            cycle.rules.timer(cycle.rules.begin),
        );
        Self {
            id,
            command,
            sent: false,
            // It may take its time to leave.
            start: if idles_in_progress {
                acknowledge.longer(begin)
            } else {
                acknowledge
            },
            seen: UntilSeen::UNDELIVERED,
            attained: Left::by(evidence.acknowledge),
            error: Left::by(evidence.error),
            idles_in_progress,
            progress: HomingProgress::None,
            place: Some(evidence.position),
            rest: None,
            done: Lasting::NOT,
            proven: Lasting::NOT,
            rested: Lasting::NOT,
        }
    }

    fn has_begun(&self) -> bool {
        self.progress != HomingProgress::None
    }

    const fn has_surely_begun(&self) -> bool {
        matches!(
            self.progress,
            HomingProgress::Begun | HomingProgress::Worked
        )
    }

    fn begin(&mut self) {
        if !self.has_surely_begun() {
            self.progress = HomingProgress::Begun;
        }
    }

    /// How far it came, should it not end well.
    fn delivery(&self) -> Delivery {
        if self.has_surely_begun() {
            Delivery::Accepted
        } else {
            Delivery::Unknown
        }
    }

    /// One cycle after bit 4 was sent; the result, once there is one.
    fn step(&mut self, cycle: &Cycle<'_>) -> Option<Result<Completion, Failure>> {
        self.note(cycle);
        if self.command.is_late(cycle.now) {
            return Some(Err(self.timeout(cycle)));
        }
        let evidence = &cycle.evidence;
        let error = evidence.error.is_high();
        let is_old = self.error == Left::High && !(self.has_begun() && self.start.is_over());
        let is_over = self.has_begun() && !is_in_progress(evidence);
        if cycle.halted || (error && !is_old) || is_over {
            let left = self
                .rest
                .get_or_insert(cycle.rules.timer(cycle.rules.standstill));
            left.pass(cycle.elapsed);
        } else {
            self.rest = None;
        }
        let late = self.rest.is_some_and(Timer::is_over);
        if cycle.halted {
            // It ends at standstill, to which it has to come in time.
            return late.then(|| Err(self.timeout(cycle)));
        }
        if error && !is_old {
            self.begin();
            return self.error(cycle, late);
        }
        if let Some(homed) = self.judge(cycle) {
            return Some(Ok(homed));
        }
        if late {
            return Some(Err(self.timeout(cycle)));
        }
        // What has just changed may be its answer.
        let is_sure = cycle.evidence.acknowledge.is_sure() && cycle.evidence.reached.is_sure();
        if !self.has_begun() && self.start.is_over() && is_sure {
            if error {
                // An error that has stood all the time. With the drive at rest it did not even begin.
                return self.error(cycle, true);
            }
            return Some(Err(
                cycle.timeout(WaitingFor::HomingStart, Delivery::Unknown)
            ));
        }
        None
    }

    /// Takes in what the bits and the position say of this homing.
    fn note(&mut self, cycle: &Cycle<'_>) {
        let (evidence, bounds) = (&cycle.evidence, cycle.rules.bounds);
        self.start.pass(cycle.elapsed);
        let seen_in = cycle.rules.seen();
        self.seen.update(cycle.delivered, cycle.elapsed, seen_in);
        self.attained.note(evidence.acknowledge);
        if evidence.error.is_low() {
            self.error.note(evidence.error);
        }
        let position = evidence.position;
        self.place = self
            .place
            .filter(|&place| bounds.is_within_window(place, position));
        let seen = self.seen.is_seen();
        let attained = evidence.acknowledge.is_high() && !evidence.error.is_high();
        let rose = seen && attained && self.attained == Left::Low;
        let has_fallen = !self.idles_in_progress && self.attained == Left::Fallen;
        if !self.idles_in_progress && is_in_progress(evidence) {
            // "In progress" is news, and this one's doing.
            self.progress = HomingProgress::Worked;
        } else if rose
            || (self.idles_in_progress && seen && self.place.is_none())
            || (has_fallen && evidence.acknowledge.is_low())
        {
            // Bit 12 has risen, or the axis has left its place, after the drive has surely seen bit 4; or what an earlier homing has left has
            // fallen.
            self.begin();
        } else if has_fallen && !self.has_begun() {
            self.progress = HomingProgress::Perhaps;
        }
    }

    /// Whether the drive has attained home by this homing, and rests.
    fn judge(&mut self, cycle: &Cycle<'_>) -> Option<Completion> {
        let (evidence, rules) = (&cycle.evidence, &cycle.rules);
        let (elapsed, settle) = (cycle.elapsed, rules.bounds.settle);
        let attained = evidence.acknowledge.is_high() && !evidence.error.is_high();
        let done = attained && evidence.reached.is_high();
        let held = self.done.update(done, settle, elapsed);
        // So long that a drive that is at work on this one would show it.
        let long = settle.max(rules.traits.surely_seen().saturating_mul(2));
        let told = self.seen.is_delivered();
        let proven = self.proven.update(done && told, long, elapsed);
        let motionless = self.command.method.is_motionless();
        let anew = self.attained != Left::High;
        let mine = attained
            && if self.has_begun() {
                anew
            } else {
                // Nothing moves: an edge of bit 12 after bit 4 is proof. Without one, the drive has had bit 4 for so long that it would show
                // it if it were still at work, and the axis reads what it reads at home.
                motionless && (anew || (proven && self.reads_home(cycle)))
            };
        if mine && !self.has_begun() {
            self.begin();
        }
        let stands = evidence.stands();
        let rested = self.rested.update(mine && stands, rules.begin, elapsed);
        let worked = match self.progress {
            HomingProgress::Worked => true,
            HomingProgress::Begun if self.idles_in_progress && self.attained == Left::Low => true,
            _ if motionless => self.attained == Left::Low || (proven && self.reads_home(cycle)),
            _ => {
                let left = self.place.is_none() || self.reads_home(cycle);
                self.start.is_over() && (self.attained == Left::Low || left)
            }
        };
        // Where standstill does not show because the axis is never quiet, the drive's word counts after a while; and where bit 10 does
        // not come, the axis' rest.
        let rests = (stands && done) || held || rested;
        let position = evidence.position;
        (mine && worked && rests).then_some(Completion::Homed { position })
    }

    /// It has not ended in its time.
    fn timeout(&self, cycle: &Cycle<'_>) -> Failure {
        cycle.timeout(WaitingFor::HomingEnd, self.delivery())
    }

    /// Whether the position is what it is at home: the home offset, with the sign that the drive gives it.
    fn reads_home(&self, cycle: &Cycle<'_>) -> bool {
        let offset = self.command.offset.unwrap_or(0);
        let (position, bounds) = (cycle.evidence.position, cycle.rules.bounds);
        [offset, offset.wrapping_neg()]
            .into_iter()
            .any(|home| bounds.is_within_window(home, position))
    }

    /// The drive shows an error: the end comes at rest, or when the axis has had the time to come to it.
    fn error(&mut self, cycle: &Cycle<'_>, late: bool) -> Option<Result<Completion, Failure>> {
        let evidence = &cycle.evidence;
        let settle = cycle.rules.bounds.settle;
        let held = self
            .done
            .update(evidence.reached.is_high(), settle, cycle.elapsed);
        let moving = !(evidence.stands() || held);
        (!moving || late).then_some(Err(Failure::HomingError { moving }))
    }
}

/// Bits 13, 12 and 10 as 000.
const fn is_in_progress(evidence: &Evidence) -> bool {
    evidence.acknowledge.is_low() && evidence.error.is_low() && evidence.reached.is_low()
}
