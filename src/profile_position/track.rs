//! One set-point that the drive has acknowledged, followed to its end.

use core::time::Duration;

use crate::ds402::{Sample, Statusword};

use super::{
    BufferMode, CommandId, Completion, Cycle, Delivery, Failure, Reference, RelativeBase,
    WaitingFor, no_older,
    sequencer::{Raised, Request},
    standstill::{Bounds, ShownFor},
};

/// So many cycles at least have to show an axis away from an end before it counts as left.
const AWAY_CYCLES: u8 = 3;

/// What was seen of an axis at the end of a set-point that another has followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EndSeen {
    There,
    /// It may have been there in cycles that brought no inputs.
    Unseen,
    Elsewhere,
}

/// What an axis at rest with two set-points held means for them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rest {
    BothOver,
    /// The first is over, and the second has not begun in time.
    NextNotBegun,
    NoneBegun,
    /// The axis stands at the end of one of them, and bit 10 stays low: which of them the drive has not ended is not known.
    Unreached,
}

/// The bounds of an axis that does not keep within its window, span by span: in two spans within the same bounds it is at rest.
#[derive(Debug, Clone, Copy, Hash, Default)]
struct Lingering {
    span: ShownFor,
    bounds: Option<(i32, i32)>,
    before: Option<(i32, i32)>,
    rests: bool,
}

impl Lingering {
    /// Takes in a cycle with bit 10 high. Whether the axis is at rest.
    fn observe(&mut self, cycle: &Cycle<'_>) -> bool {
        let position = cycle.sample.position;
        let (low, high) = self.bounds.unwrap_or((position, position));
        let (low, high) = (low.min(position), high.max(position));
        self.bounds = Some((low, high));
        if self.span.observe(cycle.now, true, cycle.begin) {
            let same = |a: i32, b: i32| a.abs_diff(b) <= cycle.bounds.position;
            self.rests = self
                .before
                .is_some_and(|before| same(before.0, low) && same(before.1, high));
            self.before = Some((low, high));
            self.span = ShownFor::default();
            self.bounds = None;
        }
        self.rests
    }

    /// How far apart its bounds are.
    fn width(&self) -> u32 {
        self.before.map_or(0, |(low, high)| low.abs_diff(high))
    }
}

/// What a distance may count from, where the drive's documents do not say, or the position does not show it. That is the end before it, or
/// where the axis, or its demand, was when the drive took it.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Bases {
    previous: Option<i32>,
    position: i32,
    /// How far the drive's base may be from that position.
    slack: u32,
    /// Whether the position is that of the axis when the drive took it.
    is_own: bool,
}

impl Bases {
    fn of(begin: i32, previous: Option<i32>, from_rest: bool, cycle: &Cycle<'_>) -> Self {
        // In motion the drive took it between these two cycles, and its demand may be ahead of the axis by several times that way. What
        // an axis that stands has gone is noise.
        let way = if from_rest || cycle.standstill.is_standing() {
            0
        } else {
            cycle.bounds.distance(begin, cycle.sample.position)
        };
        Self {
            previous,
            position: begin,
            slack: way.saturating_mul(8).saturating_add(cycle.bounds.position),
            is_own: true,
        }
    }

    /// The same at the end of a distance from them.
    fn after(self, distance: i32, bounds: &Bounds) -> Self {
        Self {
            previous: self.previous.map(|end| bounds.after(end, distance)),
            position: bounds.after(self.position, distance),
            slack: self.slack.saturating_add(bounds.position),
            is_own: false,
        }
    }

    /// Whether the axis was no further than this from the end before it.
    fn are_near(&self, lag: u32, bounds: &Bounds) -> bool {
        let lag = lag.max(bounds.position.saturating_mul(3));
        self.previous
            .is_none_or(|end| bounds.distance(end, self.position) <= lag)
    }

    /// Whether a distance may end at this position.
    fn lead_to(&self, position: i32, distance: i32, bounds: &Bounds) -> bool {
        let near = |base: i32, slack: u32| {
            let end = bounds.after(base, distance);
            bounds.distance(end, position) <= bounds.position.saturating_add(slack)
        };
        let window = bounds.position;
        // An axis that is where it was has gone no distance, however vague the base is.
        let stays = self.is_own
            && bounds.distance(self.position, position) <= window
            && distance.unsigned_abs() > window.saturating_mul(2);
        if stays {
            return false;
        }
        near(self.position, self.slack) || self.previous.is_some_and(|end| near(end, 0))
    }

    /// Whether a distance ends at this position from wherever it counts: from anywhere between these places.
    fn all_lead_to(&self, position: i32, distance: i32, bounds: &Bounds) -> bool {
        let window = bounds.position;
        let beside = self.slack.saturating_sub(window);
        let near = |base: i32, beside: u32| {
            let away = bounds.distance(bounds.after(base, distance), position);
            away.saturating_add(beside) <= window
        };
        near(self.position, beside) && self.previous.is_none_or(|end| near(end, 0))
    }
}

/// How far an axis may lag behind its demand at the end of a way before this one.
const fn lag_of(way: i32) -> u32 {
    way.unsigned_abs() / 4
}

/// A set-point that the drive has acknowledged.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Track {
    pub id: CommandId,
    /// How it was started: the end of the set-point before it is `Reached` or `Passed` by this.
    pub buffer_mode: BufferMode,
    /// Where it ends, where that is known.
    pub end: Option<i32>,
    /// Where it leads, also where its end is not known to the count.
    goal: Option<i32>,
    /// Of a distance, how far it leads, and what is known of where it counts from.
    distance: Option<i32>,
    bases: Bases,
    /// Whether the axis stood where every base of a distance is.
    at_base: bool,
    /// Whether the axis stood when it was sent, with nothing that the drive held. Else it may swing on its way.
    stood_before: bool,
    swings: bool,
    /// Whether a distance may count from a place beside the one that its end was reckoned from.
    is_loose: bool,
    /// Whether its end was reckoned from that of one which may end beside it.
    is_vague: bool,
    /// Whether the one before it may have ended beside its end, so that it is not known where the axis was when this one became active.
    begins_beside: bool,
    /// Whether it begins at rest: then the axis goes to its end without passing it before.
    pub from_rest: bool,
    /// Whether it was begun by a drive in motion, which may be too fast to stop at its end, and come back to it.
    overshoots: bool,
    /// Whether it is one of a modulo axis: the position alone does not say which way round it goes to its end, and how often.
    pub turns: bool,
    absolute: bool,
    /// Whether the way to an absolute target is longer than half the circle of 32 bits: then the position does not say which
    /// way the drive goes there.
    far: bool,
    /// Whether its end was near when it became active: then what is left of the motion before, within the window, looks like
    /// leaving or passing it.
    short: bool,
    /// Whether bit 11 (internal limit active) was seen low since it became active, and high. A drive that shows it all the time
    /// may have limited the move, and the axis may pass the end that was asked for on its way to another.
    unlimited: bool,
    limited: bool,
    /// Whether an edge of bit 12 has acknowledged it; else its own motion has to show that the drive has taken it.
    confirmed: bool,
    /// Whether it was reported that the axis stands halted.
    pub halt_told: bool,
    /// When it became the active one, or was resumed.
    since: Duration,
    /// Whether bit 10 was seen low since then: only then a high one is news. And when it was last.
    left_target: bool,
    low: Duration,
    /// When it rose after that, and whether the axis went further than its window in that cycle.
    rose: Duration,
    passing: bool,
    /// Resumed: until the drive has surely seen bit 8 low, bit 10 may still be that of the halt. No time is known before that was delivered.
    halt_seen_over: Option<Duration>,
    /// Whether it became active behind another, or behind one that was over with no way to go and may begin yet. A low bit 10 may be of
    /// that one still.
    follows: bool,
    /// Whether bit 12 alone has shown that it became active: the axis may have been on its way to the end of the one before.
    by_room: bool,
    /// Whether it was sent after one that was over with no way to go.
    after_unseen: bool,
    /// Whether the drive may have to execute another before it: then that one may have moved the axis.
    doubted: bool,
    /// Where the axis stood when it became active. None where it did not stand: then where it has come to rest without a word of bit 10.
    stood: Option<i32>,
    /// With bit 10 high: since when the axis has left that place. On its way from there it is not at rest, however slowly it sets off.
    left_place: Option<Duration>,
    /// What bounds an axis that does not come to rest within its window, with bit 10 high.
    lingering: Lingering,
    /// With another behind it, or one in doubt before it: since when it is at rest with bit 10.
    resting: Option<Duration>,
    /// With bit 10 low: the axis stands at its end.
    unreached: ShownFor,
    /// The last position within the window around its end.
    arrived: Option<i32>,
    /// On which side of its end the axis was when it became active: the sign of end − position.
    side: i64,
    /// Of a modulo axis, the way to its end in the last cycle, and whether that has changed its sign there.
    way: i64,
    crossed: bool,
    /// How far the end was in the last cycle, and whether the axis has come nearer since it became active.
    remaining: u32,
    approaching: bool,
    /// Where the axis was in the last cycle, and the longest way that it has gone in one.
    before: i32,
    fastest: u32,
    /// Whether it has come so near between two cycles that it was at the end.
    near: bool,
    /// How fast the axis would have had to be, in counts a cycle, to have been at the end while nothing was seen of it.
    unseen: u32,
    /// Whether the axis was seen at the end, or beyond it, whatever it has done since.
    seen_there: bool,

    /// With another behind it, `was_there`: the axis was at the end or beyond, and has not come back to it. `rested`: it has stood there.
    /// `astray`: how far it was on the far side of the end, seen from where the next leads. `away`: since when it has been away on the way
    /// there, in so many cycles.
    was_there: bool,
    rested: bool,
    astray: i64,
    away: Option<(Duration, u8)>,
    farthest: i64,
    /// How long its way was when it became active.
    length: u32,
    /// Whether its side and its way have to be taken anew, from where the axis goes on.
    resumed: bool,
}

impl Track {
    pub fn new(raised: &Raised, confirmed: bool, cycle: &Cycle<'_>) -> Self {
        let &Raised {
            request: Request { id, command, .. },
            since: _,
            begin,
            at,
            end,
            goal,
            previous,
            from_rest,
            stands,
            at_base,
            far_behind,
            behind,
            behind_loose,
        } = raised;
        let mut track = Self {
            id,
            buffer_mode: command.set_point.buffer_mode,
            end,
            goal,
            distance: match command.reference {
                Reference::Absolute => None,
                Reference::Relative => Some(command.target),
            },
            at_base: stands && at_base,
            is_loose: false,
            begins_beside: false,
            is_vague: behind_loose && command.reference == Reference::Relative,
            stood_before: stands,
            swings: !stands,
            // Only a distance counts from them.
            bases: behind.unwrap_or_else(|| {
                let is_absolute = command.reference == Reference::Absolute;
                Bases::of(at, previous, from_rest || is_absolute, cycle)
            }),
            from_rest,
            overshoots: !from_rest && command.set_point.buffer_mode == BufferMode::Aborting,
            confirmed,
            halt_told: false,
            turns: cycle.bounds.turn_length().is_some(),
            absolute: command.reference == Reference::Absolute,
            far: false,
            short: false,
            unlimited: false,
            limited: false,
            since: cycle.now,
            left_target: false,
            low: cycle.now,
            rose: cycle.now,
            passing: false,
            halt_seen_over: None,
            follows: false,
            by_room: false,
            after_unseen: false,
            doubted: false,
            stood: None,
            left_place: None,
            lingering: Lingering::default(),
            resting: None,
            unreached: ShownFor::NOT,
            arrived: None,
            side: 0,
            way: 0,
            crossed: false,
            remaining: 0,
            approaching: false,
            before: begin,
            fastest: 0,
            near: false,
            unseen: u32::MAX,
            seen_there: false,
            was_there: false,
            rested: false,
            astray: 0,
            away: None,
            farthest: 0,
            length: 0,
            resumed: false,
        };
        track.is_loose = track.is_loose_on(far_behind, cycle);
        track.becomes_active(cycle, begin, stands);
        track
    }

    /// Whether what is known of where it counts from may be beside that. Behind another, only where that is over already, for all that
    /// is known: far from its end it is not.
    fn is_loose_on(&self, far_behind: bool, cycle: &Cycle<'_>) -> bool {
        let Some(way) = self.distance else {
            return false;
        };
        let known = cycle.traits.relative_base == RelativeBase::PreviousTarget
            || (far_behind && !self.bases.are_near(lag_of(way), cycle.bounds));
        self.end.is_none() || !known
    }

    /// Whether it may end beside the place that its end was reckoned for.
    pub const fn may_end_beside(&self) -> bool {
        self.is_loose || self.is_vague
    }

    /// Of a distance whose end is not known, what one behind it counts from.
    pub fn bases_behind(&self, bounds: &Bounds) -> Option<Bases> {
        let distance = self.distance.filter(|_| self.end.is_none())?;
        Some(self.bases.after(distance, bounds))
    }

    /// How far it came, should it not end well.
    pub const fn delivery(&self) -> Delivery {
        if self.confirmed {
            Delivery::Accepted
        } else {
            Delivery::Unknown
        }
    }

    /// It is the active one from now on.
    fn becomes_active(&mut self, cycle: &Cycle<'_>, position: i32, stands: bool) {
        self.since = cycle.now;
        self.left_target = false;
        self.low = cycle.now;
        self.rose = cycle.now;
        self.passing = false;
        self.arrived = None;
        self.unlimited = false;
        self.limited = false;
        self.near = false;
        self.unseen = u32::MAX;
        self.seen_there = false;
        self.fastest = 0;
        self.before = position;
        self.stood = (self.from_rest && stands).then_some(position);
        self.left_place = None;
        self.lingering = Lingering::default();
        self.resting = None;
        self.unreached = ShownFor::NOT;
        self.turn(position, cycle.bounds);
    }

    /// It is the active one from now on, in place of `before`. Where that was seen at its end, this one's way began there, however far
    /// the axis has come on it meanwhile. `by_room`: by bit 12 alone. `rests`: the axis
    /// stands, and may not have come on it at all.
    pub fn takes_over(&mut self, before: &Self, by_room: bool, rests: bool, cycle: &Cycle<'_>) {
        let position = cycle.sample.position;
        let unseen = self.unseen;
        let (near, arrived) = (self.near, self.arrived);
        self.becomes_active(cycle, position, cycle.standstill.is_standing());
        let from_rest = self.from_rest || rests;
        if rests {
            self.stood = Some(position);
        }
        // What was not seen may have been its whole way, and as fast as the one before.
        self.unseen = unseen;
        self.fastest = before.fastest;
        (self.near, self.arrived) = (near, arrived);
        if before.end_seen(cycle) == EndSeen::There {
            self.begins_at_end_of(before, from_rest, cycle);
        }
        self.follows = true;
        self.by_room = by_room;
        self.swings = false;
    }

    /// Its way began at the end of `before`, where the axis was seen.
    fn begins_at_end_of(&mut self, before: &Self, from_rest: bool, cycle: &Cycle<'_>) {
        let Some(begin) = before.end else { return };
        self.begins_beside = before.may_end_beside();
        // What is left of the way to where that has ended is no motion of this one.
        if !self.begins_beside {
            self.stood = from_rest.then_some(begin);
        }
        self.left_place = None;
        self.turn(begin, cycle.bounds);
        self.remaining = self
            .end
            .map_or(0, |end| cycle.bounds.distance(end, cycle.sample.position));
    }

    /// The axis has come to the end of the one before only now: the way there was not this one's.
    pub fn came_to_end_of(&mut self, before: &Self, cycle: &Cycle<'_>) {
        if before.end_seen(cycle) == EndSeen::There && self.stood.is_some() {
            self.begins_at_end_of(before, true, cycle);
        }
    }

    /// The one before it has ended, and nothing has shown that the drive had begun it. `unproven`: nor that it has ended.
    pub const fn comes_after_doubt(&mut self, unproven: bool) {
        self.follows = true;
        self.after_unseen = true;
        self.doubted = unproven;
    }

    /// Whether the drive holds none before it: where nothing has shown that it had begun the one before, this one has led the axis on.
    pub fn is_surely_first(&self, cycle: &Cycle<'_>) -> bool {
        !self.after_unseen || self.has_begun(cycle)
    }

    /// Whether anything but the position of its end has shown that the drive has begun it: it has moved the axis, or bit 10 was low for it.
    pub fn has_begun(&self, cycle: &Cycle<'_>) -> bool {
        let gone = |stood| cycle.bounds.distance(stood, cycle.sample.position);
        let moved = match self.stood {
            Some(stood) => gone(stood) > cycle.bounds.position,
            // Begun at rest, with an axis that was not there yet, its motion may be of the one before. So may that on a short way where bit 12
            // alone has shown that its turn has come, and any behind one that the drive may hold.
            None => !(self.from_rest || self.doubted || (self.by_room && self.short)),
        };
        moved || (self.left_target && !self.follows)
    }

    /// It goes on after a halt: what bit 10 showed before is of no meaning for it.
    pub fn goes_on(&mut self, now: Duration, from_rest: bool, active: bool) {
        self.since = now;
        self.left_target = false;
        self.low = now;
        self.rose = now;
        self.halt_seen_over = Some(Duration::MAX);
        self.halt_told = false;
        // How one behind it begins does not change.
        if active {
            self.from_rest = from_rest;
            self.overshoots = !from_rest;
        }
        self.left_place = None;
        self.lingering = Lingering::default();
        self.resting = None;
        self.unreached = ShownFor::NOT;
        // The halt may have carried the axis past the end, to which the drive goes back.
        self.arrived = None;
        self.resumed = true;
    }

    /// Lets go of what makes no difference any more.
    pub fn let_go(&mut self, now: Duration, begin: Duration, settle: Duration) {
        no_older(&mut self.since, now, begin.max(settle));
        no_older(&mut self.low, now, settle);
        no_older(&mut self.rose, now, settle);
        self.passing &= now.saturating_sub(self.rose) < settle;
        self.lingering.span.let_go(now, begin);
        self.unreached.let_go(now, begin);
        if let Some(since) = &mut self.resting {
            no_older(since, now, begin);
        }
        if let Some(since) = &mut self.left_place {
            no_older(since, now, settle);
        }
        if let Some((since, cycles)) = &mut self.away {
            no_older(since, now, settle);
            *cycles = (*cycles).min(AWAY_CYCLES);
        }
    }

    /// Takes in bit 11 of a cycle in which it is surely the active one.
    #[inline(always)]
    pub fn note_limit(&mut self, statusword: Statusword) {
        let limited = statusword.contains(Statusword::INTERNAL_LIMIT);
        self.unlimited |= !limited;
        self.limited |= limited;
    }

    /// Takes in one fresh cycle. `alone`: no other set-point can have taken over.
    pub fn note(&mut self, cycle: &Cycle<'_>, alone: bool) {
        self.follow(cycle.now, cycle.sample, cycle.blind, alone, cycle.bounds);
        if self.halt_seen_over.is_some() {
            self.note_end_of_halt(cycle);
        }
    }

    /// Whether [`follow`](Self::follow) is all of [`note`](Self::note).
    pub const fn allows_idle_path(&self) -> bool {
        self.halt_seen_over.is_none()
    }

    /// As [`note`](Self::note), with nothing but what every cycle needs: `blind` cycles without inputs were before it. Whether the axis is
    /// within the window around its end.
    #[inline(always)]
    pub fn follow(
        &mut self,
        now: Duration,
        sample: &Sample,
        blind: u32,
        alone: bool,
        bounds: &Bounds,
    ) -> bool {
        if !sample.statusword.contains(Statusword::TARGET_REACHED) {
            self.left_target |= self.halt_seen_over.is_none();
            self.low = now;
        } else if self.rose < self.low {
            self.note_rise(now, sample.position, bounds);
        }
        let position = sample.position;
        let resumed = core::mem::take(&mut self.resumed);
        if resumed {
            self.before = position;
            self.stood = self.from_rest.then_some(position);
        }
        let Some(end) = self.end else {
            self.before = position;
            return false;
        };
        if resumed || (self.far && !self.is_far(position, bounds)) {
            self.turn(position, bounds);
        }
        let remaining = bounds.distance(end, position);
        self.look_between(position, remaining, blind, bounds);
        if self.turns {
            self.look_for_crossing(end, position, bounds);
        }
        self.approaching |= remaining < self.remaining;
        self.remaining = remaining;
        if remaining <= bounds.position {
            self.note_arrival(end, position, remaining, bounds);
            return true;
        }
        self.unreached = ShownFor::NOT;
        if alone && !self.from_rest && (self.passed(position) || self.arrived.is_some()) {
            // It was replaced too fast to stop at its end: it has overshot, and comes back.
            self.arrived = None;
            self.turn(position, bounds);
            self.seen_there = true;
        }
        false
    }

    /// Bit 10 has risen, with the axis at this position.
    #[inline(never)]
    fn note_rise(&mut self, now: Duration, position: i32, bounds: &Bounds) {
        self.rose = now;
        self.passing = bounds.distance(self.before, position) > bounds.position;
    }

    /// The nearest that was seen: a later position may be on the way to the next end already.
    #[inline(always)]
    fn note_arrival(&mut self, end: i32, position: i32, remaining: u32, bounds: &Bounds) {
        let nearer = self
            .arrived
            .is_none_or(|before| bounds.distance(end, before) >= remaining);
        self.arrived = if nearer { Some(position) } else { self.arrived };
    }

    /// Bit 8 has fallen: from when on bit 10 is that of the set-point.
    fn note_end_of_halt(&mut self, cycle: &Cycle<'_>) {
        self.halt_seen_over = match self.halt_seen_over {
            Some(Duration::MAX) if cycle.delivered => {
                Some(cycle.now.saturating_add(cycle.traits.surely_seen()))
            }
            Some(over) if cycle.now >= over => None,
            waits => waits,
        };
    }

    /// Whether the way since the last cycle is long enough to have led to the end. After cycles without inputs it also says how fast the
    /// axis would have had to be to have been there.
    #[inline(always)]
    fn look_between(&mut self, position: i32, remaining: u32, blind: u32, bounds: &Bounds) {
        let way = bounds.distance(self.before, position);
        self.before = position;
        if blind == 0 {
            self.fastest = self.fastest.max(way);
            self.note_near(way, remaining, bounds);
        } else {
            self.note_unseen(self.remaining, remaining, blind);
        }
    }

    /// Takes in the way of one cycle.
    #[inline(always)]
    const fn note_near(&mut self, way: u32, remaining: u32, bounds: &Bounds) {
        // What goes no further than the window in a cycle is seen in it, if it comes there.
        let far = if way > bounds.position { way } else { 0 };
        self.near |= remaining <= far.saturating_add(bounds.position);
    }

    /// Of a modulo axis, whether it has crossed its end since the last cycle.
    #[inline(never)]
    fn look_for_crossing(&mut self, end: i32, position: i32, bounds: &Bounds) {
        let Some(turn) = bounds.turn_length() else {
            return;
        };
        // The way changes its sign on the far side as well; only near the end that is a crossing of it.
        let way = bounds.way(position, end);
        let near = way.abs() < turn / 4 && self.way.abs() < turn / 4;
        self.crossed |= near && way.signum() == -self.way.signum() && way != 0;
        self.way = way;
    }

    fn note_unseen(&mut self, before: u32, after: u32, blind: u32) {
        let there_and_back = before.saturating_add(after);
        self.unseen = self.unseen.min(there_and_back / blind.saturating_add(1));
    }

    /// Takes in a cycle as the one behind `first`, before that does: what was not seen may be of this one, too. `active`: so is what was, for
    /// bit 12 shows that the drive is at it.
    pub fn note_behind(&mut self, first: &Self, active: bool, cycle: &Cycle<'_>) {
        let Some(end) = self.end else { return };
        let position = cycle.sample.position;
        let remaining = |position| cycle.bounds.distance(end, position);
        let after = remaining(position);
        if cycle.blind != 0 {
            self.note_unseen(remaining(first.before), after, cycle.blind);
        } else if active {
            let way = cycle.bounds.distance(first.before, position);
            self.note_near(way, after, cycle.bounds);
        }
        if active && after <= cycle.bounds.position {
            self.note_arrival(end, position, after, cycle.bounds);
        }
    }

    /// What was seen of the axis at the end.
    pub fn end_seen(&self, cycle: &Cycle<'_>) -> EndSeen {
        let position = cycle.sample.position;
        let Some(end) = self.end else {
            return EndSeen::There;
        };
        let shown = if self.unlimited || !cycle.bit_11_is_valid {
            self.came_to_end(position)
        } else {
            cycle.bounds.distance(end, position) <= cycle.bounds.position
        };
        // The fastest that was seen need not be the fastest that there was.
        let fastest = self.fastest.max(cycle.bounds.position).saturating_mul(4);
        let blind = self.unseen <= fastest;
        let limit_unseen = cycle.bit_11_is_valid && !self.unlimited && !self.limited;
        match shown {
            true => EndSeen::There,
            false if blind || limit_unseen => EndSeen::Unseen,
            false => EndSeen::Elsewhere,
        }
    }

    /// Whether the drive may be at the one behind it already: the axis was seen at its end, however far it has swung from there since.
    pub fn may_be_over(&self, cycle: &Cycle<'_>) -> bool {
        self.end.is_none() || self.came_to_end(cycle.sample.position)
    }

    fn came_to_end(&self, position: i32) -> bool {
        self.near || self.arrived.is_some() || self.seen_there || self.passed(position)
    }

    /// Whether the axis was seen at the end; of a distance whose end is not known, whether it has gone at all.
    pub fn is_seen_at_end(&self, cycle: &Cycle<'_>) -> bool {
        self.end_seen(cycle) == EndSeen::There && !self.has_not_left(cycle)
    }

    /// Whether a distance whose end is not known has not led the axis away from where it stood.
    fn has_not_left(&self, cycle: &Cycle<'_>) -> bool {
        let window = cycle.bounds.position;
        let at = |stood| cycle.bounds.distance(stood, cycle.sample.position) <= window;
        let far = |way: i32| way.unsigned_abs() > window.saturating_mul(2);
        self.end.is_none() && self.distance.is_some_and(far) && self.stood.is_some_and(at)
    }

    /// Whether a set-point that stops at this one's end may be queued behind it: the position will show without doubt
    /// when that has taken over.
    pub const fn shows_its_stop(&self) -> bool {
        self.shows_its_end() && self.from_rest
    }

    /// Whether a set-point may be blended onto this one: the position will show when the end is passed.
    pub const fn shows_its_passing(&self) -> bool {
        self.shows_its_end() && (self.from_rest || self.approaching)
    }

    /// Whether a position beyond its end means that the axis was there.
    const fn shows_its_end(&self) -> bool {
        self.end.is_some() && !self.turns && !self.far && !self.short && self.unlimited
    }

    /// Whether the position shows that it has ended and `next` is under way. Neither being at the end is enough, for the drive may
    /// still be finishing this one, nor being past it, for the axis may be ahead of its demand and come back. It has to be well on
    /// the way to the next end: half of that, and half as far as this one's own way was, or away from the window for the settle time.
    /// Or it has to leave after it has stood. One that may come back to its end is not over beyond it.
    pub fn is_left_behind(&mut self, next: &Self, cycle: &Cycle<'_>) -> bool {
        let (Some(end), Some(goal)) = (self.end, next.goal) else {
            return false;
        };
        let position = cycle.sample.position;
        let window = i64::from(cycle.bounds.position);
        // A way of more than half the number circle does not show its direction.
        let Some(way) = goal.checked_sub(end).map(i64::from) else {
            return false;
        };
        if self.short || self.turns || self.far || way.abs() <= 3 * window {
            return false;
        }
        let passed = self.passed(position);
        self.was_there |= passed || self.arrived.is_some();
        self.seen_there |= self.was_there;
        let beyond = i64::from(position.wrapping_sub(end));
        let gone = if way.is_negative() { -beyond } else { beyond };
        if gone <= window {
            self.rested |= gone >= -window && self.is_steady(cycle);
            self.astray = if self.was_there {
                self.astray.max(-gone)
            } else {
                0
            };
            self.away = None;
            return false;
        }
        let (since, cycles) = self.away.unwrap_or((cycle.now, 0));
        let cycles = cycles.saturating_add(1);
        self.away = Some((since, cycles));
        if !self.was_there || (self.overshoots && passed) {
            return false;
        }
        // One that comes back is not on its way.
        let goes_on = gone >= self.farthest;
        self.farthest = self.farthest.max(gone);
        let half = way.abs() / 2;
        let stayed =
            cycle.now.saturating_sub(since) >= cycle.bounds.settle && cycles >= AWAY_CYCLES;
        // One that swung when it set off may swing as far.
        let goes = gone >= i64::from(self.length / 2) && !self.swings;
        let far = gone >= half && (goes || stayed);
        let leaves = self.rested && gone >= half.min(3 * window);
        (far || leaves) && goes_on && gone > self.astray
    }

    /// Whether both this one and `next` are over, with the axis at rest. It has been under way, or had no way to go, and has stood with
    /// bit 10 for the settle time at the end of the next one. Elsewhere it has to stand for as long as that may take to begin.
    pub fn rests_with(&mut self, next: &Self, cycle: &Cycle<'_>) -> Option<Rest> {
        let reached = cycle.is_reached();
        if reached {
            self.note_place(cycle);
        }
        let steady = || {
            let standstill = cycle.standstill;
            standstill.steady_since(cycle.now, next.since.max(self.low), cycle.bounds)
        };
        if !(reached && (steady() || self.lingering.observe(cycle))) {
            self.resting = None;
            let unreached = !reached && self.stands_unreached(next.end, cycle);
            return unreached.then_some(Rest::Unreached);
        }
        let resting = *self.resting.get_or_insert(cycle.now);
        let (position, window) = (cycle.sample.position, cycle.bounds.position);
        let at = |end: i32| cycle.bounds.distance(end, position) <= window;
        let left = self.left_target && !self.after_unseen;
        let moved = self.stood.is_some_and(|stood| !at(stood)) && self.rests_away(cycle);
        // What is left of the motion before leads there as well, on a short way or where the axis had not come to that end.
        let own = !self.by_room || (!self.short && self.stood.is_some());
        let was_there = own && self.end.is_some() && self.end_seen(cycle) == EndSeen::There;
        let gone = (moved || was_there) && !self.doubted;
        let proven = left || gone;
        let begun = proven || self.has_no_way(cycle);
        // A distance from nobody knows where seems to end wherever the axis waits for the one before it.
        let over = next.end.is_some_and(at) || (proven && next.may_end_at(position, cycle.bounds));
        if begun && over {
            return Some(Rest::BothOver);
        }
        let begun = begun && (self.end.is_some() || self.may_end_at(position, cycle.bounds));
        let late = cycle.now.saturating_sub(resting) >= cycle.begin;
        late.then_some(if begun {
            Rest::NextNotBegun
        } else {
            Rest::NoneBegun
        })
    }

    /// Whether the axis has stood with bit 10 for the settle time: nothing that the drive holds is under way.
    pub fn is_at_rest(&mut self, cycle: &Cycle<'_>) -> bool {
        cycle.is_reached() && (self.is_settled(cycle) || self.lingering.observe(cycle))
    }

    /// Whether the axis has stood since bit 10 was low last. Before that it may have been about to set off.
    fn is_settled(&self, cycle: &Cycle<'_>) -> bool {
        let since = self.since.max(self.low);
        cycle
            .standstill
            .steady_since(cycle.now, since, cycle.bounds)
    }

    /// Takes in where the axis is, with bit 10 high.
    fn note_place(&mut self, cycle: &Cycle<'_>) {
        if self.left_place.is_none() && self.has_left_place(cycle) {
            self.left_place = Some(cycle.now);
        }
    }

    fn has_left_place(&self, cycle: &Cycle<'_>) -> bool {
        let window = cycle.bounds.position;
        let at = |stood| cycle.bounds.distance(stood, cycle.sample.position) <= window;
        self.stood.is_some_and(|stood| !at(stood))
    }

    /// Whether the axis has come to rest since it left the place where it stood: what stayed around it before was still that.
    fn rests_away(&self, cycle: &Cycle<'_>) -> bool {
        let standstill = cycle.standstill;
        self.left_place
            .is_some_and(|left| standstill.steady_since(cycle.now, left, cycle.bounds))
    }

    fn is_steady(&self, cycle: &Cycle<'_>) -> bool {
        cycle
            .standstill
            .steady_since(cycle.now, self.since, cycle.bounds)
    }

    /// How it ended, with one that was started as `next` taking over.
    pub fn ended_into(&self, next: BufferMode, cycle: &Cycle<'_>) -> Result<Completion, Failure> {
        let position = cycle.sample.position;
        match (self.end, self.end_seen(cycle)) {
            (Some(target), EndSeen::Elsewhere) => Err(self.missed(target, position)),
            (Some(target), EndSeen::Unseen) => Err(Failure::Unseen {
                target,
                actual: position,
            }),
            (None, _) if self.has_not_left(cycle) => Err(Failure::EndNotKnown { actual: position }),
            _ if next == BufferMode::Blending => Ok(Completion::Passed { position }),
            // Between two cycles it was at its end; the nearest that was seen is the better word.
            _ => Ok(Completion::Reached {
                position: self.arrived.unwrap_or(position),
            }),
        }
    }

    /// With bit 10 low: whether the axis has stood for so long at its end, or at the end of the one behind it, that the drive will hardly
    /// show that. A drive that has paused the move elsewhere may go on at any time.
    #[inline(never)]
    fn stands_unreached(&mut self, behind: Option<i32>, cycle: &Cycle<'_>) -> bool {
        let (position, window) = (cycle.sample.position, cycle.bounds.position);
        let mut ends = [self.end, behind].into_iter().flatten();
        let at_end = ends.any(|end| cycle.bounds.distance(end, position) <= window);
        let stands = at_end && cycle.standstill.is_standing();
        self.unreached.observe(cycle.now, stands, cycle.begin)
    }

    /// What is said of it then. The drive may hold it still.
    pub fn unreached(&self, cycle: &Cycle<'_>) -> Failure {
        cycle.timeout(WaitingFor::TargetReached, self.delivery())
    }

    /// When and how it ended, as the last set-point.
    #[inline(always)]
    pub fn outcome(&mut self, cycle: &Cycle<'_>) -> Option<Result<Completion, Failure>> {
        if !cycle.is_reached() {
            if self.doubted {
                self.resting = None;
            }
            let unreached = self.stands_unreached(None, cycle);
            return unreached.then(|| Err(self.unreached(cycle)));
        }
        self.end_shown(cycle)
    }

    /// With bit 10 high: a bit 10 that was never seen low since then may be that of the set-point or halt before. Then the axis has to
    /// have come to rest elsewhere than where it stood, or it has no way to go; else the set-point has not begun.
    #[inline(never)]
    fn end_shown(&mut self, cycle: &Cycle<'_>) -> Option<Result<Completion, Failure>> {
        let position = cycle.sample.position;
        let window = cycle.bounds.position;
        self.note_place(cycle);
        // It may be wrong for one of the drive's cycles. When that shows, an axis at speed is elsewhere.
        if self.passing && !cycle.is_seen(self.rose) {
            return None;
        }
        let reached = Some(Ok(Completion::Reached { position }));
        let within = self
            .end
            .is_some_and(|end| cycle.bounds.distance(end, position) <= window);
        let may_end_here = self.may_end_at(position, cycle.bounds);
        // Where the one before it has led, or leads, a distance seems to end, too.
        let certain = self.end.is_some() || !self.doubted;
        if self.left_target && (within || (may_end_here && certain)) {
            return reached;
        }
        let steady = self.is_settled(cycle);
        let lingers = !steady && self.lingering.observe(cycle);
        if !(steady || lingers) {
            self.resting = None;
            return None;
        }
        let over = within && self.surely_ends_at(position, cycle.bounds);
        if over || (self.end.is_none() && certain && self.has_no_way(cycle)) {
            return reached;
        }
        let stood = *self.stood.get_or_insert(position);
        let slack = if lingers { self.lingering.width() } else { 0 };
        let gone = cycle.bounds.distance(stood, position);
        let since = if self.doubted {
            *self.resting.get_or_insert(cycle.now)
        } else {
            self.since
        };
        let late = cycle.now.saturating_sub(since) >= cycle.begin;
        let rests = lingers || self.rests_away(cycle);
        let moved = gone > window.saturating_add(slack) && rests && (!self.doubted || late);
        if moved || (self.left_target && !self.follows) {
            return match self.end {
                _ if may_end_here => reached,
                Some(target) => Some(Err(self.missed(target, position))),
                None => Some(Err(Failure::EndNotKnown { actual: position })),
            };
        }
        late.then_some(Err(match self.end {
            // So long after bit 10 was low, it was low for this one.
            Some(target) if self.begins_beside && self.left_target => self.missed(target, position),
            _ => Failure::NotBegun { actual: position },
        }))
    }

    /// Whether this distance may lead to this position, from a place beside the one that its end was reckoned from, or where that is not
    /// known.
    pub fn may_end_at(&self, position: i32, bounds: &Bounds) -> bool {
        let Some(way) = self.distance.filter(|_| self.is_loose) else {
            return false;
        };
        match (self.end, self.goal) {
            // It goes on from beside the end before it, by no more than what the axis lags behind.
            (None, Some(goal)) => bounds.distance(goal, position) <= lag_of(way),
            _ => self.bases.lead_to(position, way, bounds),
        }
    }

    /// Whether it ends at this position, near which its end is, wherever a distance counts from. With a drive that may count from elsewhere it
    /// may have its way still to go.
    fn surely_ends_at(&self, position: i32, bounds: &Bounds) -> bool {
        let way = self.distance.filter(|_| self.is_loose);
        way.is_none_or(|way| self.bases.all_lead_to(position, way, bounds))
    }

    /// Whether it had no way to go when it was begun. A distance of which nobody knows from where it counts has none only where the last
    /// set-point has ended, or the axis was enabled. What it has replaced, a jog or a target that was missed may have left its base
    /// anywhere.
    fn has_no_way(&self, cycle: &Cycle<'_>) -> bool {
        let window = cycle.bounds.position;
        let short = |way: i32| way.unsigned_abs() <= window;
        match self.end {
            Some(_) => {
                self.remaining <= window && self.surely_ends_at(cycle.sample.position, cycle.bounds)
            }
            None => self.at_base && self.distance.is_some_and(short),
        }
    }

    /// It is over, and the axis is elsewhere.
    const fn missed(&self, target: i32, actual: i32) -> Failure {
        if self.is_vague || (self.is_loose && !self.stood_before) {
            Failure::EndNotKnown { actual }
        } else if self.confirmed {
            Failure::MissedTarget { target, actual }
        } else {
            Failure::Unconfirmed { target, actual }
        }
    }

    fn turn(&mut self, position: i32, bounds: &Bounds) {
        self.way = self.end.map_or(0, |end| bounds.way(position, end));
        self.side = self.way.signum();
        self.crossed = false;
        self.remaining = self.end.map_or(0, |end| bounds.distance(end, position));
        self.approaching = false;
        self.length = self.remaining;
        self.was_there = false;
        self.rested = false;
        self.astray = 0;
        self.away = None;
        self.farthest = 0;
        self.far = self.is_far(position, bounds);
        self.short = self.remaining <= bounds.position.saturating_mul(3);
    }

    fn is_far(&self, position: i32, bounds: &Bounds) -> bool {
        let linear = |end: i32| i64::from(end) - i64::from(position);
        self.absolute
            && !self.turns
            && self
                .end
                .is_some_and(|end| bounds.way(position, end) != linear(end))
    }

    #[inline]
    fn passed(&self, position: i32) -> bool {
        if self.turns {
            return self.crossed;
        }
        if self.far {
            return false;
        }
        let way = |end: i32| i64::from(end.wrapping_sub(position));
        self.side != 0 && self.end.is_some_and(|end| way(end).signum() == -self.side)
    }
}

#[cfg(test)]
#[path = "track_tests.rs"]
mod tests;
