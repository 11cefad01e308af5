//! The set-points that the drive holds: the active one and the one behind it, followed to their ends.

use core::time::Duration;

use crate::ds402::{ModeBits, Sample, SetPointBits, Statusword};

use super::{
    Bounds, BufferMode, BufferSignal, Cycle, Event, Events, Failure, MoveCommand, Reference,
    RelativeBase, StartBits, Traits, no_older,
    track::{Rest, Track},
};

/// Set-points that the drive may hold.
const HELD: usize = 2;

/// Whether the drive can take a move.
pub(super) enum Place {
    Free,
    /// Its buffer is full; if bit 12 shows that, whatever is known of the drive, a set-point that replaces everything is
    /// taken without an edge of it.
    Full,
    Later,
    Never(&'static str),
}

/// Whether there may be a set-point that the drive has taken and not acknowledged: what the position shows may be its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Next {
    None,
    /// Its acknowledge is still to come. `replaces`: when it comes, the others have been replaced, and what shows before that may be its
    /// way past their ends.
    Comes {
        replaces: bool,
    },
    /// Its acknowledge has not come in time: whether the drive has taken it stays unknown. `anywhere`: it replaces the others, and may
    /// end anywhere, at their ends, too.
    Perhaps {
        anywhere: bool,
    },
}

/// The set-points that the drive has acknowledged and not ended, in order.
#[derive(Debug, Clone, Hash, Default)]
pub(super) struct Chain {
    held: [Option<Track>; HELD],
    /// One that is over by the drive's word, bit 12, and whose end the axis has not been seen at.
    over: Option<Over>,
    /// The end of the last set-point, where the axis has arrived.
    last_end: Option<i32>,
    /// Whether the last one has ended with no way to go, and nothing has shown that the drive had begun it: it may do so yet, before the next.
    unseen: bool,
    /// Whether the last one has ended without a proof of it: the axis came to rest elsewhere than at its end, and what brought it there may
    /// have been something else. The drive may hold that one still, until a later one has led the axis to its end.
    unproven: bool,
    /// Whether the axis is where the last set-point has ended well, or where it was enabled: there a distance counts from, whatever the
    /// drive counts from.
    at_base: bool,
    /// When the last one has ended.
    ended: Duration,
    /// Whether the drive has been given up on beginning one that it has acknowledged: it may still do so.
    not_begun: bool,
}

/// A set-point whose place the next one has taken.
#[derive(Debug, Clone, Hash)]
struct Over {
    track: Track,
    /// How the next one was started, and when it was seen to have taken over, from where.
    next: BufferMode,
    since: Duration,
    position: i32,
}

impl Chain {
    /// Whether one has just ended that the drive may still begin.
    pub const fn take_not_begun(&mut self) -> bool {
        core::mem::replace(&mut self.not_begun, false)
    }

    /// Whether the drive may hold one of which the end was reported already.
    pub const fn is_unproven(&self) -> bool {
        self.unproven
    }

    /// The drive has dropped all of them, out of Operation enabled: when it is enabled again it begins where the axis then is.
    pub const fn forget(&mut self) {
        self.unproven = false;
        self.at_base = true;
    }

    pub fn is_empty(&self) -> bool {
        self.held.iter().all(Option::is_none)
    }

    /// Whether at most one is held, and nothing is open about a halt or those before it.
    pub fn allows_idle_path(&self) -> bool {
        let [first, rest @ ..] = &self.held;
        self.over.is_none()
            && rest.iter().all(Option::is_none)
            && first.as_ref().is_none_or(Track::allows_idle_path)
    }

    /// Takes in a set-point that the drive has acknowledged; with `Aborting` it is the only one from now on.
    pub fn push(&mut self, mut track: Track, events: &mut Events) {
        self.at_base = false;
        if track.buffer_mode == BufferMode::Aborting {
            self.fail_all(Failure::Superseded, events);
            self.unproven = false;
        } else if self.is_empty() && (self.unseen || self.unproven) {
            track.comes_after_doubt(self.unproven);
        }
        if let Some(place) = self.held.iter_mut().find(|place| place.is_none()) {
            *place = Some(track);
        }
    }

    /// Ends all of them, with the axis anywhere.
    pub fn fail_all(&mut self, failure: Failure, events: &mut Events) {
        let over = self.over.take().map(|over| over.track);
        let held = self.held.iter_mut().filter_map(Option::take);
        for track in over.into_iter().chain(held) {
            let failure = failure.with_delivery(track.delivery());
            events.push(track.id, Event::Done(Err(failure)));
        }
        self.last_end = None;
        self.unseen = false;
    }

    /// Lets go of what makes no difference any more.
    pub fn let_go(&mut self, now: Duration, begin: Duration, settle: Duration) {
        for track in self.held.iter_mut().flatten() {
            track.let_go(now, begin, settle);
        }
        if let Some(over) = &mut self.over {
            over.track.let_go(now, begin, settle);
            no_older(&mut over.since, now, settle);
        }
        no_older(&mut self.ended, now, settle);
    }

    /// The axis stands halted: reports it for each of them, once for each halt.
    pub fn report_halted(&mut self, events: &mut Events) {
        for track in self
            .held
            .iter_mut()
            .flatten()
            .filter(|track| !track.halt_told)
        {
            track.halt_told = true;
            events.push(track.id, Event::Halted);
        }
    }

    /// Bit 8 falls.
    pub fn resumed(&mut self, now: Duration, from_rest: bool) {
        for (place, track) in self.held.iter_mut().flatten().enumerate() {
            track.goes_on(now, from_rest, place == 0);
        }
        if let Some(over) = &mut self.over {
            over.since = now;
        }
    }

    /// One cycle that is not halted: of a halted axis nothing is claimed. `room_shown`: bit 12 is low again after a set-point.
    pub fn follow(&mut self, cycle: &Cycle<'_>, room_shown: bool, next: Next, events: &mut Events) {
        // A single set-point, with nothing behind it, ends where the axis stands, whatever was not seen of its way.
        let alone = self.over.is_none() && self.held[1].is_none() && next == Next::None;
        let stalled;
        let cycle = if alone {
            cycle
        } else {
            stalled = cycle.with_stall();
            &stalled
        };
        let undecided = self.follow_over(cycle, events);
        if let Next::Perhaps { anywhere } = next
            && !undecided
        {
            self.follow_doubtful(anywhere, cycle, events);
            return;
        }
        match &mut self.held {
            [Some(first), Some(second)] => {
                let shown = room_shown && cycle.traits.buffer_signal == BufferSignal::Acknowledge;
                second.note_behind(first, shown && undecided, cycle);
                first.note(cycle, false);
                // When bit 12 has fallen, the next one has taken over, and bit 11 is of that.
                if cycle.is_acknowledging() {
                    first.note_limit(cycle.sample.statusword);
                }
                let left = first.is_left_behind(second, cycle)
                    && cycle.traits.buffer_signal != BufferSignal::Acknowledge;
                let rest = if shown || left {
                    None
                } else {
                    first.rests_with(second, cycle)
                };
                let over = shown || left || rest.is_some();
                if over && next == Next::None && !undecided {
                    if let Some(Rest::Unreached) = rest {
                        events.push(first.id, Event::Done(Err(first.unreached(cycle))));
                        events.push(second.id, Event::Done(Err(second.unreached(cycle))));
                        self.held = [None; HELD];
                        self.last_end = None;
                        self.not_begun = true;
                        return;
                    }
                    if let Some(Rest::NextNotBegun | Rest::NoneBegun) = rest {
                        let not_begun = Err(Failure::NotBegun {
                            actual: cycle.sample.position,
                        });
                        let outcome = match rest {
                            Some(Rest::NextNotBegun) => first.ended_into(second.buffer_mode, cycle),
                            _ => not_begun,
                        };
                        events.push(first.id, Event::Done(outcome));
                        events.push(second.id, Event::Done(not_begun));
                        self.held = [None; HELD];
                        self.last_end = None;
                        self.not_begun = true;
                        return;
                    }
                    if shown && !first.is_seen_at_end(cycle) {
                        self.over = Some(Over {
                            track: *first,
                            next: second.buffer_mode,
                            since: cycle.now,
                            position: cycle.sample.position,
                        });
                    } else {
                        let outcome = first.ended_into(second.buffer_mode, cycle);
                        // At rest nothing shows that the next one has taken over.
                        if rest.is_some() && outcome.is_err() {
                            self.unproven = true;
                            second.comes_after_doubt(true);
                        }
                        events.push(first.id, Event::Done(outcome));
                    }
                    second.takes_over(first, shown, rest.is_some(), cycle);
                    self.last_end = first.end;
                    self.held[0] = self.held[1].take();
                }
            }
            [Some(_), None] => {
                self.follow_active(cycle, next, undecided, events);
            }
            [None, _] => {}
        }
    }

    /// Takes in one cycle of the only one that is held, where no cycle before it was without inputs. Whether it may end with it.
    #[inline(always)]
    pub fn note_active(&mut self, now: Duration, sample: &Sample, bounds: &Bounds) -> bool {
        let [Some(track), _] = &mut self.held else {
            return false;
        };
        let at_end = track.follow(now, sample, 0, true, bounds);
        track.note_limit(sample.statusword);
        at_end || sample.statusword.contains(Statusword::TARGET_REACHED)
    }

    /// One cycle of the only one that is held. Whether it has ended.
    fn follow_active(
        &mut self,
        cycle: &Cycle<'_>,
        next: Next,
        undecided: bool,
        events: &mut Events,
    ) -> bool {
        let [Some(track), _] = &mut self.held else {
            return false;
        };
        track.note(cycle, true);
        track.note_limit(cycle.sample.statusword);
        self.end_active(cycle, next, undecided, events)
    }

    /// Ends the only one that is held, if what was taken in of this cycle shows its end. Whether it has ended.
    pub fn end_active(
        &mut self,
        cycle: &Cycle<'_>,
        next: Next,
        undecided: bool,
        events: &mut Events,
    ) -> bool {
        let [Some(track), _] = &mut self.held else {
            return false;
        };
        // What one shows that is taken and not acknowledged yet is not the end of this one; its own end, where that is
        // known, is, unless the other has replaced it.
        let known = track.end.is_some() && next != (Next::Comes { replaces: true });
        let outcome = track
            .outcome(cycle)
            .filter(|outcome| next == Next::None || (known && outcome.is_ok()));
        match outcome {
            Some(outcome) if !undecided => {
                self.last_end = if outcome.is_ok() { track.end } else { None };
                let begun = track.has_begun(cycle);
                self.unseen = outcome.is_ok() && !begun;
                let proven = begun && track.end.is_some();
                self.unproven = outcome.is_err() || (self.unproven && !proven);
                self.at_base = outcome.is_ok();
                self.ended = cycle.now;
                self.not_begun |= matches!(outcome, Err(Failure::NotBegun { .. }));
                events.push(track.id, Event::Done(outcome));
                self.held[0] = None;
                true
            }
            _ => false,
        }
    }

    /// A later set-point may have replaced them: what the axis passes says nothing of them. Where it stands at the end of the last of
    /// them that one has arrived; where it stands otherwise, none of them is known to be what has led it there.
    fn follow_doubtful(&mut self, anywhere: bool, cycle: &Cycle<'_>, events: &mut Events) {
        let actual = cycle.sample.position;
        let last = self.held.iter().flatten().count();
        for (place, held) in self.held.iter_mut().enumerate() {
            let Some(track) = held else { continue };
            track.note(cycle, false);
            let at_rest = track.is_at_rest(cycle);
            let may_arrive = track.end.is_some() && !anywhere && place + 1 == last && at_rest;
            let outcome = match track.outcome(cycle) {
                Some(Ok(completion)) if may_arrive => Ok(completion),
                Some(Err(Failure::Timeout { .. })) => Err(Failure::PerhapsSuperseded { actual }),
                _ if at_rest => Err(Failure::PerhapsSuperseded { actual }),
                _ => continue,
            };
            events.push(track.id, Event::Done(outcome));
            *held = None;
        }
        if self.held[0].is_none() {
            self.held[0] = self.held[1].take();
        }
        self.last_end = None;
    }

    /// The drive's word alone does not say that the axis was at the end: it may have limited the move. The actual position may
    /// also be behind the demand; it has the settle time to show itself at the end. Whether that is still open.
    fn follow_over(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        let Some(over) = &mut self.over else {
            return false;
        };
        over.track.note(cycle, false);
        let waited = cycle.now.saturating_sub(over.since) >= cycle.bounds.settle;
        if !waited && !over.track.is_seen_at_end(cycle) {
            return true;
        }
        if let Some(next) = &mut self.held[0] {
            next.came_to_end_of(&over.track, cycle);
        }
        let outcome = match over.track.ended_into(over.next, cycle) {
            Err(Failure::MissedTarget { target, .. }) => Err(Failure::MissedTarget {
                target,
                actual: over.position,
            }),
            Err(Failure::Unseen { target, .. }) => Err(Failure::Unseen {
                target,
                actual: over.position,
            }),
            outcome => outcome,
        };
        events.push(over.track.id, Event::Done(outcome));
        self.over = None;
        false
    }

    /// Whether the drive can take this move now.
    pub fn place_for(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Place {
        let traits = cycle.traits;
        let buffer_mode = command.set_point.buffer_mode;
        let bits = traits.bits(buffer_mode);
        let [Some(active), next] = &self.held else {
            return Place::Free;
        };
        let full = next.is_some() || (self.unproven && buffer_mode != BufferMode::Aborting);
        let shown_by_bit_12 = traits.buffer_signal == BufferSignal::Acknowledge;
        match buffer_mode {
            BufferMode::Aborting if full => match (command.reference, traits.buffer_signal) {
                // A bit 12 that is still high is not that of the buffer.
                (_, BufferSignal::None) => Place::Free,
                (Reference::Absolute, _) => Place::Full,
                (Reference::Relative, BufferSignal::Acknowledge) => Place::Never(
                    "its buffer is full and acknowledges nothing, and where a distance taken once too little or too often \
                     would end cannot be seen: use an absolute move, or stop",
                ),
                (Reference::Relative, BufferSignal::Unknown) => Place::Free,
            },
            BufferMode::Aborting => Place::Free,
            _ if bits == StartBits::Sequenced || full => Place::Later,
            _ if shown_by_bit_12 => Place::Free,
            // Before it the drive may hold another one yet.
            _ if !active.is_surely_first(cycle) => Place::Later,
            BufferMode::Buffered if active.shows_its_stop() => Place::Free,
            BufferMode::Blending if active.shows_its_passing() => Place::Free,
            BufferMode::Blending if active.end.is_none() || active.turns => Place::Never(
                "the end of the active move shows neither in bit 12 nor in the position: \
                 use Buffered, or an absolute move before it",
            ),
            // Sent when the axis is on its way to the end, or has arrived there.
            BufferMode::Buffered | BufferMode::Blending => Place::Later,
        }
    }

    /// Whether a move would begin at rest.
    pub fn begins_at_rest(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> bool {
        match command.set_point.buffer_mode {
            BufferMode::Buffered => true,
            BufferMode::Blending | BufferMode::Aborting => self.stands(cycle),
        }
    }

    /// Whether the axis stands, with no set-point that the drive holds.
    pub fn stands(&self, cycle: &Cycle<'_>) -> bool {
        let stands = || {
            let standstill = cycle.standstill;
            standstill.stands_since(cycle.now, self.ended, cycle.bounds)
        };
        self.is_empty() && (stands() || self.has_arrived(cycle))
    }

    /// Whether whatever a distance may count from is where the axis has last come to rest.
    pub const fn is_at_base(&self) -> bool {
        self.at_base
    }

    /// Another mode may lead the axis anywhere.
    pub const fn leave_base(&mut self) {
        self.at_base = false;
    }

    /// Whether the axis is where the last set-point ended, and 606Ch says that it stands there.
    fn has_arrived(&self, cycle: &Cycle<'_>) -> bool {
        let (position, bounds) = (cycle.sample.position, cycle.bounds);
        let slow = |velocity: i32| velocity.unsigned_abs() <= bounds.velocity;
        cycle.sample.velocity.is_some_and(slow)
            && self
                .last_end
                .is_some_and(|end| bounds.distance(end, position) <= bounds.position)
    }

    /// Where a move begins: behind another at the end of that, where it is known; else where the axis is.
    pub fn begin_of(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> i32 {
        self.before(command)
            .and_then(|before| before.end)
            .unwrap_or(cycle.sample.position)
    }

    /// The one that a move is to follow.
    pub fn before(&self, command: &MoveCommand) -> Option<&Track> {
        let queues = command.set_point.buffer_mode != BufferMode::Aborting;
        self.held.iter().flatten().last().filter(|_| queues)
    }

    /// Whether one of them ends so near to a position that an axis there may have been led by either.
    pub fn ends_near(&self, position: i32, bounds: &Bounds) -> bool {
        let near = |end| bounds.distance(end, position) <= bounds.position.saturating_mul(3);
        self.held
            .iter()
            .flatten()
            .any(|track| track.end.is_some_and(near) || track.may_end_at(position, bounds))
    }

    /// Where a move will end, where the documents and the position show it.
    pub fn end_of(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Option<i32> {
        match command.reference {
            // A drive that counts from the actual position takes it on the way, behind the end of the move before by the
            // following error.
            Reference::Relative
                if command.set_point.buffer_mode == BufferMode::Blending
                    && !self.is_empty()
                    && cycle.traits.relative_base == RelativeBase::Actual =>
            {
                None
            }
            Reference::Absolute | Reference::Relative => self.goal_of(command, cycle),
        }
    }

    /// The end of the last set-point, held or arrived at, where it is known.
    pub fn previous_end(&self) -> Option<i32> {
        match self.held.iter().flatten().last() {
            Some(before) => before.end,
            None => self.last_end,
        }
    }

    /// Where a move leads, also where its end is not known to the count.
    pub fn goal_of(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Option<i32> {
        match command.reference {
            Reference::Absolute => Some(command.target),
            Reference::Relative => {
                let base = self.base_of(command, cycle);
                base.map(|base| cycle.bounds.after(base, command.target))
            }
        }
    }

    /// Refuses a relative move whose turn has come and that would end beyond a limit, where its end is known.
    pub fn check_limits(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Result<(), Failure> {
        if command.reference == Reference::Relative
            && let Some(base) = self.base_of(command, cycle)
        {
            let target = match cycle.bounds.turn {
                Some(_) => cycle.bounds.after(base, command.target).into(),
                None => i64::from(base) + i64::from(command.target),
            };
            let rule = &cycle.traits.limits;
            return cycle.limits.check_target(target, rule, cycle.referenced);
        }
        Ok(())
    }

    /// What a relative move would count from, where the documents and the position show it.
    fn base_of(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Option<i32> {
        let (position, traits) = (cycle.sample.position, cycle.traits);
        if self.is_empty() && self.unproven && command.set_point.buffer_mode != BufferMode::Aborting
        {
            // Behind one that the drive may hold.
            return None;
        }
        match (
            self.held.iter().flatten().last(),
            command.set_point.buffer_mode,
        ) {
            // At the end of the move before it all bases are the same, or nearly so: see `end_of`.
            (Some(before), BufferMode::Buffered | BufferMode::Blending) => before.end,
            (Some(before), BufferMode::Aborting) => match traits.relative_base {
                RelativeBase::PreviousTarget => before.end,
                RelativeBase::Demand
                | RelativeBase::Actual
                | RelativeBase::PositioningOption
                | RelativeBase::Undocumented => None,
            },
            (None, _) => match traits.relative_base {
                RelativeBase::Actual | RelativeBase::Demand => Some(position),
                // An axis that is not there any more has been homed, jogged or moved by hand since: what the drive takes for
                // its previous target then, no document says.
                RelativeBase::PreviousTarget
                | RelativeBase::Undocumented
                | RelativeBase::PositioningOption => self
                    .last_end
                    .filter(|&end| cycle.bounds.distance(end, position) <= cycle.bounds.position),
            },
        }
    }
}

/// Bits 5, 6 and 9 that start a move.
pub(super) const fn start_bits(command: &MoveCommand, traits: &Traits) -> ModeBits {
    let (change_set_immediately, change_on_set_point) =
        match traits.bits(command.set_point.buffer_mode) {
            StartBits::Bits {
                change_set_immediately,
                change_on_set_point,
            } => (change_set_immediately, change_on_set_point),
            // Sequenced after arrival: it starts an axis that stands.
            StartBits::Sequenced | StartBits::Unsupported(_) => (false, false),
        };
    let relative = match command.reference {
        Reference::Absolute => false,
        Reference::Relative => true,
    };
    ModeBits::of_set_point(SetPointBits {
        change_set_immediately,
        relative,
        change_on_set_point,
    })
}

#[cfg(test)]
#[path = "chain_tests.rs"]
mod tests;
