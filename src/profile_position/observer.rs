//! What the drive does with the set-points that it holds, and how each of them ends.
//!
//! The drive's buffer is a small automaton that nobody can see: the active set-point waits to begin, runs, or has ended; another may be
//! behind it. The observer keeps the set of its states that fit what was seen ([`Worlds`]). In each cycle it adds the states that the drive
//! may have come to, and takes away those that the evidence rules out. Each rule is an assumption of `docs/fault-model.md`, by its
//! number. An outcome is reported once all states that are left agree on it.

use crate::timer::{Due, Lasting, Timer};

use super::{
    Bit, Bounds, BufferMode, CommandId, Completion, ContactTorque, Cycle, Delivery, Doubt, Ends,
    Event, Events, Evidence, Failure, Quiet, Rules,
};

/// Set-points that a drive holds at most (S2).
const HELD: usize = 2;

/// The set-points that the drive has acknowledged and that it may hold.
#[derive(Debug, Clone, Hash)]
pub(crate) struct Observer {
    entries: [Option<HeldSetPoint>; HELD],
    worlds: Worlds,
    /// Where the axis stands, or stood before it set off.
    place: Option<i32>,
    /// While the axis is at rest with the same bit 10: until that has lasted for [`Deadlines::begin`](crate::axis::Deadlines::begin).
    rest: Lasting,
    /// While bit 10 is high: until it has been so for the settle time.
    high: Lasting,
    /// While the axis is beyond half of the way to the second end: until it has been there for the settle time (A2).
    beyond: Lasting,
    /// Where the last set-point has led the axis, if nothing else can have moved it since.
    last_ends: Option<Ends>,
    /// Beside those that are held: they are copied in each cycle.
    contact: Option<Contact>,
}

/// The torque that ends a set-point, and since when that is shown.
#[derive(Debug, Clone, Copy, Hash)]
struct Contact {
    of: CommandId,
    torque: ContactTorque,
    pressed: Lasting,
}

/// A set-point that the drive has acknowledged.
#[derive(Debug, Clone, Copy, Hash)]
pub(crate) struct HeldSetPoint {
    pub id: CommandId,
    pub start: BufferMode,
    /// It ends at an end velocity, and the axis goes on.
    pub runs_on: bool,
    pub ends: Ends,
    /// Whether the axis may pass its end and come back: one that began in motion.
    pub turns: bool,
    /// Whether the way shows that the one before it is over (A2).
    pub shown_by_way: bool,
    pub behind: Behind,
    sighting: Sighting,
    report: Report,
    /// Until what is shown is surely of after its acknowledge; and of after its beginning, since that is sure.
    seen: Timer,
    begun: Timer,
    /// Until it has begun, if it ever does (S3).
    begin: Timer,
}

/// Whether the drive held another one when it took this.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Behind {
    Nothing,
    /// Another, and this one leads to a position.
    Position,
    /// Another, and this one leads away from its end.
    Distance,
}

/// Whether the axis was seen at an end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Sighting {
    None,
    /// And cycles are missing, or bit 10 was high elsewhere: the drive may have ended it there.
    Doubtful,
    /// In each sample since its turn, whether it has begun or not.
    Staying(i32),
    At(i32),
}

/// What was reported of a set-point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Report {
    Nothing,
    /// That the axis stands halted.
    Halted,
    /// That its torque was seen: its outcome is that of the hold, and not reported here.
    Elsewhere,
    /// Its outcome. It stays as long as the drive may hold it.
    Outcome,
}

impl Report {
    /// Whether the outcome is to be reported here.
    const fn is_open(self) -> bool {
        matches!(self, Self::Nothing | Self::Halted)
    }
}

/// A set of states of the drive's buffer: which set-point is the active one, and how far it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Worlds(u8);

impl Worlds {
    const NONE: Self = Self(0);
    /// The active one has not begun.
    const WAITING: Self = Self(0x11);
    const RUNNING: Self = Self(0x22);
    /// The active one is the last, and the axis goes on beyond its end at its end velocity.
    const RUNS_ON: Self = Self(0x44);
    /// The last one has ended.
    const DONE: Self = Self(0x88);
    /// The first, or the second, is the active one.
    const FIRST: Self = Self(0x0F);
    const SECOND: Self = Self(0xF0);

    const fn of_entry(place: usize) -> Self {
        if place == 0 {
            Self::FIRST
        } else {
            Self::SECOND
        }
    }

    const fn and(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    const fn or(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    const fn has(self, any_of: Self) -> bool {
        self.0 & any_of.0 != 0
    }

    const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The states that a drive may have come to from these: it begins, ends, and goes on to the next. `runs_on`: of the last one.
    const fn successors(self, count: usize, runs_on: bool) -> Self {
        let ended = if runs_on { Self::RUNS_ON } else { Self::DONE };
        let mut all = self;
        if all.has(Self::WAITING.and(Self::FIRST)) {
            all = all.or(Self::RUNNING.and(Self::FIRST));
        }
        if all.has(Self::RUNNING.and(Self::FIRST)) {
            all = all.or(match count {
                HELD => Self::WAITING.and(Self::SECOND),
                _ => ended.and(Self::FIRST),
            });
        }
        if all.has(Self::WAITING.and(Self::SECOND)) {
            all = all.or(Self::RUNNING.and(Self::SECOND));
        }
        if all.has(Self::RUNNING.and(Self::SECOND)) {
            all = all.or(ended.and(Self::SECOND));
        }
        all
    }
}

/// What was sent to the drive and is not acknowledged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OnItsWay {
    Nothing,
    /// It goes behind the others, and starts like this.
    Behind(BufferMode),
    /// It replaces them.
    Instead,
    /// Nobody knows whether the drive has taken it, and no answer comes any more.
    Unknown,
}

/// What the observer knows beyond the evidence of a cycle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Known {
    pub on_its_way: OnItsWay,
    /// Bit 12, where it is not that of a handshake: of a drive whose buffer it shows, low says that there is room.
    pub room: Option<Bit>,
}

impl Observer {
    pub const fn new() -> Self {
        Self {
            entries: [None; HELD],
            worlds: Worlds::NONE,
            place: None,
            rest: Lasting::NOT,
            high: Lasting::NOT,
            beyond: Lasting::NOT,
            last_ends: None,
            contact: None,
        }
    }

    /// How many set-points the drive may hold.
    pub const fn count(&self) -> usize {
        match self.entries {
            [None, _] => 0,
            [_, None] => 1,
            _ => HELD,
        }
    }

    /// Whether the drive may hold a set-point that leads on.
    pub fn has_way(&self) -> bool {
        self.has_untold() || self.runs_on()
    }

    /// Whether the drive goes on at an end velocity when the last one has ended.
    pub fn runs_on(&self) -> bool {
        self.last().is_some_and(|entry| entry.runs_on)
    }

    /// The one that was taken last.
    pub fn last(&self) -> Option<&HeldSetPoint> {
        self.entries.iter().flatten().last()
    }

    /// Where the last one ends, or has led the axis.
    pub fn last_ends(&self) -> Option<Ends> {
        self.last().map_or(self.last_ends, |entry| Some(entry.ends))
    }

    /// Something else has moved the axis, or its zero.
    pub const fn forget_place(&mut self) {
        self.last_ends = None;
    }

    /// The drive has acknowledged this one. With `Aborting` it is the only one from now on (S2). `place`: where the axis stood before.
    pub fn push(
        &mut self,
        entry: HeldSetPoint,
        place: Option<i32>,
        rules: &Rules<'_>,
        events: &mut Events,
    ) {
        if entry.start == BufferMode::Aborting {
            self.fail_all(Failure::Superseded, events);
        }
        let behind = self.count();
        let Some(free) = self.entries.get_mut(behind) else {
            return;
        };
        *free = Some(entry);
        self.place = self.place.or(place);
        let waits = Worlds::WAITING.and(Worlds::of_entry(behind));
        self.worlds = if behind == 0 {
            waits
        } else if self.worlds.has(Worlds::DONE.or(Worlds::RUNS_ON)) {
            // The first has ended: it is the turn of this one.
            self.worlds
                .without(Worlds::DONE.or(Worlds::RUNS_ON))
                .or(waits)
        } else {
            self.worlds
        };
        self.rest.restart(rules.begin);
        self.beyond.restart(rules.bounds.settle);
    }

    /// A torque ends this one, which has just been taken.
    pub fn await_contact(&mut self, of: CommandId, torque: Option<ContactTorque>) {
        self.contact = torque.map(|torque| Contact {
            of,
            torque,
            pressed: Lasting::NOT,
        });
    }

    /// Whether one is held whose torque was seen.
    pub fn has_pressed(&self) -> bool {
        let mut held = self.entries.iter().flatten();
        held.any(|entry| entry.report == Report::Elsewhere)
    }

    /// The outcome of this one is told elsewhere.
    pub fn tell(&mut self, id: CommandId) {
        for entry in self.entries.iter_mut().flatten() {
            if entry.id == id {
                entry.report = Report::Outcome;
            }
        }
    }

    /// Whether a torque ends the one that is under way.
    pub const fn awaits_contact(&self) -> bool {
        self.contact.is_some()
    }

    /// The set-point that has just met the torque that ends it: what becomes of it is told elsewhere from now on.
    pub fn take_contact(&mut self, cycle: &Cycle<'_>, torque: i16) -> Option<CommandId> {
        let contact = self.contact.as_mut()?;
        let presses = torque.unsigned_abs() >= contact.torque.torque && !cycle.halted;
        let time = contact.torque.lasts;
        let lasts = contact.pressed.update(presses, time, cycle.elapsed);
        let of = contact.of;
        let mut held = self.entries.iter_mut().flatten();
        let Some(held) = held.find(|held| held.id == of && held.report.is_open()) else {
            self.contact = None;
            return None;
        };
        lasts.then(|| {
            held.report = Report::Elsewhere;
            self.contact = None;
            of
        })
    }

    /// One cycle in Operation enabled and mode 1. Whether the drive may hold a set-point that only a stop makes known (`NeedsStop`).
    pub fn step(&mut self, cycle: &Cycle<'_>, known: Known, events: &mut Events) -> bool {
        if self.count() == 0 {
            return false;
        }
        self.pass_time(cycle);
        let evidence = &cycle.evidence;
        let before = self.worlds;
        let possible = before.successors(self.count(), self.runs_on());
        let left = possible.without(self.ruled_out(cycle, known));
        self.worlds = if left.is_empty() {
            self.surprised(possible)
        } else {
            left
        };
        let goes_to_rest = self.alone_under_way().is_some_and(|only| !only.turns);
        if !goes_to_rest || known.on_its_way != OnItsWay::Nothing {
            self.note_sightings(cycle, known, before);
        }
        if evidence.stands() || self.has_left(evidence, &cycle.rules) {
            self.place = evidence.rest;
        }
        !cycle.halted && self.judge(cycle, known, events)
    }

    /// No state of the drive fits: something outside of the fault model has happened, and every proof so far may be wrong.
    fn surprised(&mut self, possible: Worlds) -> Worlds {
        for entry in self.entries.iter_mut().flatten() {
            entry.sighting = Sighting::Doubtful;
        }
        possible
    }

    fn pass_time(&mut self, cycle: &Cycle<'_>) {
        let (evidence, rules) = (&cycle.evidence, &cycle.rules);
        for (place, entry) in self.entries.iter_mut().enumerate() {
            let Some(entry) = entry else { continue };
            entry.seen.pass(cycle.elapsed);
            let waits = Worlds::WAITING.and(Worlds::of_entry(place));
            if !self.worlds.has(waits) {
                entry.begun.pass(cycle.elapsed);
            }
            if place == 0 {
                entry.begin.pass(cycle.elapsed);
            }
        }
        let (reached, settle) = (evidence.reached, rules.bounds.settle);
        let bounds = rules.bounds;
        let half_way = bounds.turn.is_none() && self.is_half_way(evidence, bounds) == Some(true);
        let rests = evidence.stands() && reached.is_sure();
        self.rest.update(rests, rules.begin, cycle.elapsed);
        self.high.update(reached.is_high(), settle, cycle.elapsed);
        self.beyond.update(half_way, settle, cycle.elapsed);
        if cycle.halted {
            // S7: bit 10 says nothing of set-points, and their time does not run.
            self.restart_times(rules);
            for entry in self.entries.iter_mut().flatten() {
                (entry.seen, entry.begun) = (rules.seen(), rules.seen());
            }
        }
    }

    /// Times of the set-points begin anew.
    fn restart_times(&mut self, rules: &Rules<'_>) {
        self.rest.restart(rules.begin);
        self.high.restart(rules.bounds.settle);
        self.beyond.restart(rules.bounds.settle);
        for entry in self.entries.iter_mut().flatten() {
            entry.begin = rules.timer(rules.begin);
        }
    }

    /// Whether the axis has left the place where it stood: anywhere within the window of where it rests, on either side (A1).
    fn has_left(&self, evidence: &Evidence, rules: &Rules<'_>) -> bool {
        let reach = u64::from(rules.bounds.position) * 2;
        let distance = |place| u64::from(rules.bounds.distance(place, evidence.position));
        self.place.is_some_and(|place| distance(place) > reach)
    }

    /// Whether the axis, which was at the first end, has covered half of the way to the second (A2). None where that shows nothing.
    fn is_half_way(&self, evidence: &Evidence, bounds: &Bounds) -> Option<bool> {
        let [Some(first), Some(second)] = &self.entries else {
            return None;
        };
        if !(second.shown_by_way && first.was_met()) {
            return None;
        }
        first
            .ends
            .half_way_to(&second.ends, evidence.position, bounds)
    }

    /// The states that the evidence excludes: the rules of the fault model.
    fn ruled_out(&self, cycle: &Cycle<'_>, known: Known) -> Worlds {
        let (evidence, rules) = (&cycle.evidence, &cycle.rules);
        let mut out = Worlds::NONE;
        let mut rule = |holds: bool, worlds: Worlds| {
            if holds {
                out = out.or(worlds);
            }
        };
        let count = self.count();
        let room = known.room.filter(|_| count == HELD);
        let full = room.is_some_and(Bit::is_high);
        // S2: while both are held the first is the active one, and with room it is over.
        rule(full, Worlds::SECOND);
        rule(room.is_some_and(Bit::is_low), Worlds::FIRST);
        if cycle.halted {
            return out;
        }
        let (low, high) = (evidence.reached.is_low(), evidence.reached.is_high());
        let stands = evidence.stands();
        // S4: with bit 10 low the last one has not ended.
        rule(low, Worlds::DONE.or(Worlds::RUNS_ON));
        // S4: with bit 10 high none is under way at rest, but for one that is sure to be the active one: it settles. That it stood before it
        // set off is no rest.
        let rests = stands && self.high.has_lasted();
        rule(rests && !full, Worlds::RUNNING);
        // A1: an axis that leaves its rest is led by the first, which has begun.
        rule(
            self.has_left(evidence, rules),
            Worlds::WAITING.and(Worlds::FIRST),
        );
        // A2.
        rule(self.beyond.has_lasted(), Worlds::FIRST);
        for (place, entry) in self.entries.iter().enumerate() {
            let Some(entry) = entry else { continue };
            let worlds = Worlds::of_entry(place);
            let at_end = entry.ends.are_known(rules.bounds)
                && entry.ends.contain(evidence.position, rules.bounds);
            // S3: with bit 10 low for it, it has begun.
            let news = place == 1 && room.is_some_and(Bit::is_low);
            rule(
                low && entry.seen.is_over() && !news,
                Worlds::WAITING.and(worlds),
            );
            // S4: the last one is over at its end with bit 10 high; or in motion with bit 10 high for so long, if it goes on.
            let goes_on = entry.runs_on && self.high.has_lasted();
            let is_last = place + 1 == count;
            let is_over = high && is_last && entry.begun.is_over() && (at_end || goes_on);
            rule(is_over, Worlds::RUNNING.and(worlds));
            // S3: by now it has begun, if it was not at rest with bit 10 high all the time.
            let begun = place == 0 && entry.begin.is_over() && (at_end || !self.rest.holds());
            rule(begun, Worlds::WAITING.and(worlds));
        }
        out
    }

    /// Only a sample proves that the axis was at an end. `worlds`: before this sample.
    fn note_sightings(&mut self, cycle: &Cycle<'_>, known: Known, worlds: Worlds) {
        let (evidence, bounds) = (&cycle.evidence, cycle.rules.bounds);
        let (before, position) = (evidence.before, evidence.position);
        let count = self.count();
        let next = self.entries[1].map(|second| second.start);
        let crossed_first = self.is_half_way(evidence, bounds).is_some();
        for (place, entry) in self.entries.iter_mut().enumerate() {
            let Some(entry) = entry else { continue };
            let own = Worlds::of_entry(place);
            let is_last = place + 1 == count;
            // Another may have taken over in the drive.
            let follower = match known.on_its_way {
                OnItsWay::Nothing if is_last => None,
                OnItsWay::Nothing => next,
                OnItsWay::Behind(start) => Some(start),
                OnItsWay::Instead | OnItsWay::Unknown => Some(BufferMode::Buffered),
            };
            let has_follower = follower.is_some();
            let full = known.room.is_some_and(Bit::is_high) && count == HELD;
            let follower = follower.filter(|_| !(full && place == 0));
            let may_be_active = if place == 0 {
                worlds.has(own)
            } else {
                worlds.without(own).is_empty() || crossed_first
            };
            if !may_be_active {
                continue;
            }
            let at_end = entry.ends.contain(position, bounds);
            let waits = self.worlds.has(Worlds::WAITING.and(own));
            // Until the first has begun, from rest, bit 10 may be high.
            let is_fresh = waits && entry.behind == Behind::Nothing && !entry.turns;
            let may_be_over = evidence.reached.shows_high() || worlds.has(Worlds::DONE.and(own));
            let elsewhere = !cycle.halted && !is_fresh && may_be_over && !at_end;
            let doubtful = (has_follower && elsewhere) || (follower.is_some() && evidence.blind);
            let passes = follower != Some(BufferMode::Buffered);
            let met = at_end || (passes && entry.ends.are_met(before, position, bounds));
            entry.sighting = match entry.sighting {
                Sighting::None | Sighting::Staying(_) if doubtful => Sighting::Doubtful,
                Sighting::Doubtful if follower.is_some() => Sighting::Doubtful,
                Sighting::Staying(at) if !met && !waits => Sighting::At(at),
                Sighting::Staying(_) if !met => Sighting::None,
                sighting if !met || (waits && entry.was_met()) => sighting,
                _ if waits => Sighting::Staying(position),
                _ => Sighting::At(position),
            };
        }
    }

    /// Reports what all states agree on. Whether only a stop can make known what the drive holds.
    fn judge(&mut self, cycle: &Cycle<'_>, known: Known, events: &mut Events) -> bool {
        if known.on_its_way == OnItsWay::Instead {
            // When its acknowledge comes, it has replaced them, and what shows now may be its own.
            return false;
        }
        if known.on_its_way == OnItsWay::Unknown {
            if cycle.evidence.stands() && cycle.evidence.reached.is_high() {
                return self.give_up(Doubt::Unacknowledged, cycle, events);
            }
            return false;
        }
        if let [Some(first), Some(second)] = self.entries
            && !self.worlds.has(Worlds::FIRST)
        {
            let outcome = first.passed_into(second.start, cycle);
            self.report(0, outcome, events);
            let mut second = second;
            if second.behind == Behind::Distance && outcome.is_err() {
                second.ends = Ends::ANYWHERE;
            }
            if known.room.is_some() {
                // What is low may be the first that settles.
                second.seen = second
                    .seen
                    .longer(cycle.rules.timer(cycle.rules.bounds.settle));
            }
            self.entries = [Some(second), None];
            // The first has led the axis away from there.
            self.place = None;
            self.worlds = Worlds(self.worlds.0 >> 4);
            self.restart_times(&cycle.rules);
        }
        if let [Some(last), None] = self.entries {
            self.judge_last(&last, cycle, known, events)
        } else {
            self.judge_rest(cycle, known, events)
        }
    }

    /// How the only one that is held has ended.
    fn judge_last(
        &mut self,
        entry: &HeldSetPoint,
        cycle: &Cycle<'_>,
        known: Known,
        events: &mut Events,
    ) -> bool {
        let (evidence, rules) = (&cycle.evidence, &cycle.rules);
        let position = evidence.position;
        let (stands, high) = (evidence.stands(), evidence.reached.is_high());
        let ends_are_known = entry.ends.are_known(rules.bounds);
        let at_end = entry.ends.contain(position, rules.bounds);
        let rests_at_end = evidence
            .rest
            .is_some_and(|rest| entry.ends.contain(rest, rules.bounds));
        let waits = self.worlds.has(Worlds::WAITING);
        if known.on_its_way != OnItsWay::Nothing {
            // What shows may be of the next one.
            return false;
        }
        if self.worlds == Worlds::RUNS_ON.and(Worlds::FIRST) {
            // It stays: the axis goes on, until another is taken.
            let outcome = entry.passed_into(BufferMode::Buffered, cycle);
            self.report(0, outcome, events);
            return false;
        }
        let reached = high
            && at_end
            && !entry.runs_on
            && match (waits, ends_are_known) {
                (false, true) => !self.worlds.has(Worlds::RUNNING),
                (false, false) => stands,
                // Whether it has begun or not, it leads no further than where the axis rests; on a modulo axis it may lead round.
                (true, true) => rests_at_end && rules.bounds.turn.is_none(),
                (true, false) => false,
            };
        if reached {
            self.report(0, Ok(Completion::Reached { position }), events);
            self.last_ends = Some(entry.ends);
            match &mut self.entries[0] {
                Some(entry) if waits => entry.meet(position),
                _ => self.clear(),
            }
            return false;
        }
        if self.worlds == Worlds::DONE.and(Worlds::FIRST) {
            let elsewhere = !entry.ends.may_contain(position, rules.bounds);
            let failure = if ends_are_known && elsewhere {
                Failure::MissedTarget {
                    target: entry.ends.middle(rules.bounds),
                    actual: position,
                }
            } else {
                cycle.unknown(Doubt::EndUnknown)
            };
            self.report(0, Err(failure), events);
            self.last_ends = None;
            self.clear();
            return false;
        }
        self.judge_rest(cycle, known, events)
    }

    /// An axis has rested for as long as a set-point may take to begin, and some state of the drive may still lead it on.
    fn judge_rest(&mut self, cycle: &Cycle<'_>, known: Known, events: &mut Events) -> bool {
        if !self.rest.has_lasted() || known.on_its_way != OnItsWay::Nothing {
            return false;
        }
        let doubt = if cycle.evidence.reached.is_high() {
            Doubt::NotBegun
        } else {
            // At no end an input of the drive holds it, and may let it go on at any time.
            let (position, bounds) = (cycle.evidence.position, cycle.rules.bounds);
            let at_end = |entry: &HeldSetPoint| {
                entry.report != Report::Outcome
                    && entry.ends.are_known(bounds)
                    && entry.ends.contain(position, bounds)
            };
            if !self.entries.iter().flatten().any(at_end) {
                return false;
            }
            Doubt::StillLow
        };
        if !self.has_untold() {
            return false;
        }
        self.give_up(doubt, cycle, events)
    }

    /// Where those may end whose outcome is not reported.
    pub fn untold(&self, bounds: &Bounds) -> Option<Ends> {
        let held = self.entries.iter().flatten();
        let untold = held.filter(|entry| entry.report != Report::Outcome);
        let mut ends = untold.map(|entry| entry.ends);
        let first = ends.next()?;
        Some(ends.fold(first, |all, ends| all.with(ends, bounds)))
    }

    /// Whether this one is held, and its outcome is not reported.
    pub fn is_untold(&self, id: CommandId) -> bool {
        let mut held = self.entries.iter().flatten();
        held.any(|entry| entry.id == id && entry.report.is_open())
    }

    /// Whether there is one whose outcome is not reported.
    pub fn has_untold(&self) -> bool {
        let mut held = self.entries.iter().flatten();
        held.any(|entry| entry.report != Report::Outcome)
    }

    /// The rest is not known. The drive may hold each of them, until it is seen outside of Operation enabled. Whether that needs a stop.
    fn give_up(&mut self, doubt: Doubt, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        for place in 0..HELD {
            self.report(place, Err(cycle.unknown(doubt)), events);
        }
        doubt.needs_stop()
    }

    fn report(&mut self, place: usize, outcome: Result<Completion, Failure>, events: &mut Events) {
        if let Some(Some(entry)) = self.entries.get_mut(place)
            && let before = core::mem::replace(&mut entry.report, Report::Outcome)
            && before.is_open()
        {
            events.push(entry.id, Event::Done(outcome));
        }
    }

    /// Nothing is held.
    const fn clear(&mut self) {
        *self = Self {
            last_ends: self.last_ends,
            ..Self::new()
        };
    }

    /// The drive has dropped all of them, or will (S6).
    pub fn fail_all(&mut self, failure: Failure, events: &mut Events) {
        let failure = failure.with_delivery(Delivery::Accepted);
        for place in 0..HELD {
            self.report(place, Err(failure), events);
        }
        self.clear();
        self.last_ends = None;
    }

    /// The axis stands halted: says so of each, once for each halt.
    pub fn report_halted(&mut self, events: &mut Events) {
        for entry in self.entries.iter_mut().flatten() {
            if entry.report == Report::Nothing {
                entry.report = Report::Halted;
                events.push(entry.id, Event::Halted);
            }
        }
    }

    /// Bit 8 falls. What was under way goes on, or waits to; from where it was halted it may come back to an end that it has passed.
    pub fn resumed(&mut self, rules: &Rules<'_>) {
        let under_way = self.worlds.and(Worlds::RUNNING).0 >> 1;
        self.worlds = self.worlds.or(Worlds(under_way));
        for entry in self.entries.iter_mut().flatten() {
            entry.shown_by_way = false;
            entry.turns = true;
            if entry.behind == Behind::Nothing {
                // It may have been under way.
                entry.behind = Behind::Position;
            }
            if entry.report == Report::Halted {
                entry.report = Report::Nothing;
            }
        }
        self.restart_times(rules);
    }

    /// When it has something to do without another word of the drive.
    pub fn due(&self) -> Due {
        let lasting = [self.rest, self.high, self.beyond];
        let mut due = lasting
            .into_iter()
            .fold(Due::next_if(self.awaits_contact()), |due, lasting| {
                due.sooner(lasting.due())
            });
        for (place, entry) in self.entries.iter().flatten().enumerate() {
            due = due.sooner(entry.seen.due());
            if place == 0 {
                due = due.sooner(entry.begin.due());
            }
        }
        due
    }

    /// The only one, while it is surely under way and stops at its end.
    fn alone_under_way(&self) -> Option<&HeldSetPoint> {
        match &self.entries {
            [Some(only), None] if self.worlds == Worlds::RUNNING.and(Worlds::FIRST) => {
                Some(only).filter(|only| !only.runs_on)
            }
            _ => None,
        }
    }

    /// Where the next position tells nothing, as seen from this one.
    pub fn quiet(&self, position: i32, bounds: &Bounds) -> Quiet {
        match self.alone_under_way() {
            _ if self.place.is_some() && self.count() > 0 => Quiet::NOWHERE,
            // From rest to rest bit 10 and rest alone end it; one that began in motion may pass its end and come back.
            Some(only) if only.turns => only.ends.away_from(position, bounds),
            Some(_) => Quiet::EVERYWHERE,
            None if self.count() == HELD || self.has_untold() => Quiet::NOWHERE,
            None => Quiet::EVERYWHERE,
        }
    }
}

impl HeldSetPoint {
    /// What the drive has acknowledged.
    pub const fn new(
        id: CommandId,
        start: BufferMode,
        runs_on: bool,
        ends: Ends,
        rules: &Rules<'_>,
    ) -> Self {
        Self {
            id,
            start,
            runs_on,
            ends,
            turns: false,
            shown_by_way: false,
            behind: Behind::Nothing,
            sighting: Sighting::None,
            report: Report::Nothing,
            seen: rules.seen(),
            begun: rules.seen(),
            begin: rules.timer(rules.begin),
        }
    }

    /// Whether the axis has been seen at its end.
    pub const fn was_met(&self) -> bool {
        matches!(self.sighting, Sighting::At(_))
    }

    /// There was no way to go: the axis is at its end.
    pub const fn meet(&mut self, position: i32) {
        self.sighting = Sighting::At(position);
    }

    /// How it ended, with one that was started like this in its place.
    fn passed_into(&self, next: BufferMode, cycle: &Cycle<'_>) -> Result<Completion, Failure> {
        let actual = cycle.evidence.position;
        match self.sighting {
            Sighting::At(_) | Sighting::Staying(_) if next == BufferMode::Blending => {
                Ok(Completion::Passed { position: actual })
            }
            Sighting::At(position) | Sighting::Staying(position) => {
                Ok(Completion::Reached { position })
            }
            Sighting::None | Sighting::Doubtful => Err(cycle.unknown(Doubt::Unseen)),
        }
    }
}
