//! One set-point that the drive has acknowledged, followed to its end.

use core::time::Duration;

use crate::ds402::Statusword;

use super::{
    CommandId, Completion, Cycle, Delivery, Failure, Reference, Start, bit4::Raised,
    standstill::Bounds, waiting::Request,
};

/// A set-point that the drive has acknowledged.
#[derive(Debug, Clone, Copy)]
pub(super) struct Track {
    pub(super) id: CommandId,
    /// How it was started: the end of the set-point before it is `Reached` or `Passed` by this.
    pub(super) start: Start,
    /// Where it ends, where that is known.
    pub(super) end: Option<i32>,
    /// Whether it begins at rest: then the axis goes to its end without passing it before.
    pub(super) from_rest: bool,
    /// Whether it was begun by a drive in motion, which may be too fast to stop at its end, and come back to it.
    overshoots: bool,
    /// Whether it is one of a modulo axis: the position alone does not say which way round it goes to its end, and how often.
    pub(super) turns: bool,
    absolute: bool,
    /// Whether the way to an absolute target is longer than half the circle of 32 bits: then the position does not say which
    /// way the drive goes there.
    far: bool,
    /// Whether its end was near when it became active: then what is left of the motion before, within the window, looks like
    /// leaving or passing it.
    short: bool,
    /// Whether bit 11 (internal limit active) was seen low since it became active. A drive that shows it all the time may have
    /// limited the move, and the axis may pass the end that was asked for on its way to another.
    unlimited: bool,
    /// Whether an edge of bit 12 has acknowledged it; else its own motion has to show that the drive has taken it.
    confirmed: bool,
    /// Whether whoever waits has been told that the axis stands halted.
    pub(super) halt_told: bool,
    /// When it became the active one, or was resumed.
    since: Duration,
    /// Whether bit 10 was seen low since then: only then a high one is news.
    left_target: bool,
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
    /// Whether the axis may have been at the end between two cycles.
    near: bool,
    /// Whether its side and its way have to be taken anew, from where the axis goes on.
    resumed: bool,
}

impl Track {
    pub(super) fn new(raised: &Raised, confirmed: bool, cycle: &Cycle<'_>) -> Self {
        let &Raised {
            request: Request { id, command, .. },
            begin,
            end,
            from_rest,
            ..
        } = raised;
        let mut track = Self {
            id,
            start: command.set_point.start,
            end,
            from_rest,
            overshoots: !from_rest && command.set_point.start == Start::Immediately,
            confirmed,
            halt_told: false,
            turns: cycle.bounds.turn_length().is_some(),
            absolute: command.reference == Reference::Absolute,
            far: false,
            short: false,
            unlimited: false,
            since: cycle.now,
            left_target: false,
            arrived: None,
            side: 0,
            way: 0,
            crossed: false,
            remaining: 0,
            approaching: false,
            before: begin,
            fastest: 0,
            near: false,
            resumed: false,
        };
        track.becomes_active(cycle.now, begin, cycle.bounds);
        track
    }

    /// How far it came, should it not end well.
    pub(super) const fn delivery(&self) -> Delivery {
        if self.confirmed {
            Delivery::Accepted
        } else {
            Delivery::Unknown
        }
    }

    /// It is the active one from now on.
    pub(super) fn becomes_active(&mut self, now: Duration, position: i32, bounds: &Bounds) {
        self.since = now;
        self.left_target = false;
        self.arrived = None;
        self.unlimited = false;
        self.near = false;
        self.fastest = 0;
        self.before = position;
        self.turn(position, bounds);
    }

    /// It goes on after a halt: what bit 10 showed before is of no meaning for it.
    pub(super) const fn goes_on(&mut self, now: Duration, from_rest: bool, active: bool) {
        self.since = now;
        self.left_target = false;
        self.halt_told = false;
        self.from_rest = from_rest && (active || self.from_rest);
        self.overshoots = !from_rest;
        // The halt may have carried the axis past the end, to which the drive goes back.
        self.arrived = None;
        self.resumed = true;
    }

    /// Takes in bit 11 of a cycle in which it is surely the active one.
    #[inline(always)]
    pub(super) fn note_limit(&mut self, cycle: &Cycle<'_>) {
        let statusword = cycle.sample.statusword;
        self.unlimited |= !statusword.contains(Statusword::INTERNAL_LIMIT);
    }

    /// Takes in one fresh cycle. `alone`: no other set-point can have taken over.
    #[inline(always)]
    pub(super) fn note(&mut self, cycle: &Cycle<'_>, alone: bool) {
        let statusword = cycle.sample.statusword;
        self.left_target |= !statusword.contains(Statusword::TARGET_REACHED);
        let Some(end) = self.end else { return };
        let position = cycle.sample.position;
        let resumed = core::mem::take(&mut self.resumed);
        if resumed {
            self.before = position;
        }
        if resumed || (self.far && !self.is_far(position, cycle.bounds)) {
            self.turn(position, cycle.bounds);
        }
        let remaining = cycle.bounds.distance(end, position);
        self.look_between(cycle, remaining);
        if let Some(turn) = cycle.bounds.turn_length() {
            // The way changes its sign on the far side as well; only near the end that is a crossing of it.
            let way = cycle.bounds.way(position, end);
            let near = way.abs() < turn / 4 && self.way.abs() < turn / 4;
            self.crossed |= near && way.signum() == -self.way.signum() && way != 0;
            self.way = way;
        }
        self.approaching |= remaining < self.remaining;
        self.remaining = remaining;
        if remaining <= cycle.bounds.position {
            // The nearest that was seen: a later position may be on the way to the next end already.
            let nearer = self
                .arrived
                .is_none_or(|before| cycle.bounds.distance(end, before) >= remaining);
            self.arrived = if nearer { Some(position) } else { self.arrived };
        } else if alone && !self.from_rest && (self.passed(position) || self.arrived.is_some()) {
            // It was replaced too fast to stop at its end: it has overshot, and comes back.
            self.arrived = None;
            self.turn(position, cycle.bounds);
        }
    }

    /// Whether the way since the last cycle is long enough to have led to the end and back.
    fn look_between(&mut self, cycle: &Cycle<'_>, remaining: u32) {
        let way = cycle.bounds.distance(self.before, cycle.sample.position);
        self.before = cycle.sample.position;
        let reach = if cycle.blind == 0 {
            self.fastest = self.fastest.max(way);
            way
        } else {
            self.fastest.saturating_mul(cycle.blind.saturating_add(1))
        };
        self.near |= remaining <= reach.saturating_add(cycle.bounds.position);
    }

    /// Whether the position has shown that the axis was at the end, or may have been there unseen.
    pub(super) fn was_at_end(&self, cycle: &Cycle<'_>) -> bool {
        let position = cycle.sample.position;
        self.end.is_none_or(|end| {
            if self.unlimited || !cycle.limit_tells {
                self.near || self.arrived.is_some() || self.passed(position)
            } else {
                cycle.bounds.distance(end, position) <= cycle.bounds.position
            }
        })
    }

    /// Whether a set-point that stops at this one's end may be queued behind it: the position will show without doubt
    /// when that has taken over.
    pub(super) const fn shows_its_stop(&self) -> bool {
        self.shows_its_end() && self.from_rest
    }

    /// Whether a set-point may be blended onto this one: the position will show when the end is passed.
    pub(super) const fn shows_its_passing(&self) -> bool {
        self.shows_its_end() && (self.from_rest || self.approaching)
    }

    /// Whether a position beyond its end means that the axis was there.
    const fn shows_its_end(&self) -> bool {
        self.end.is_some() && !self.turns && !self.far && !self.short && self.unlimited
    }

    /// Whether the position shows that it has ended and the next one is under way: the axis was at the end, or has
    /// passed it, and is away from it again. Being at the end is not enough: the drive may still be finishing this one,
    /// and has no place for another before that. One that may come back to its end is not over beyond it.
    pub(super) fn is_left_behind(&self, cycle: &Cycle<'_>) -> bool {
        let position = cycle.sample.position;
        let passed = self.passed(position);
        self.end.is_some_and(|end| {
            cycle.bounds.distance(end, position) > cycle.bounds.position
                && !self.short
                && !(self.overshoots && passed)
                && (passed || self.arrived.is_some())
        })
    }

    /// Whether both this one and `next` are over, wherever the axis is: it has been under way, or had no way to go, and
    /// has stood with bit 10 for the settle time.
    pub(super) fn is_over_with(&self, next: &Self, cycle: &Cycle<'_>) -> bool {
        (self.left_target || self.remaining <= cycle.bounds.position)
            && cycle.sample.statusword.contains(Statusword::TARGET_REACHED)
            && cycle
                .standstill
                .steady_since(cycle.now, next.since, cycle.bounds)
    }

    /// Whether the axis has stood with bit 10 for the settle time: nothing that the drive holds is under way.
    pub(super) fn is_at_rest(&self, cycle: &Cycle<'_>) -> bool {
        cycle.sample.statusword.contains(Statusword::TARGET_REACHED)
            && cycle
                .standstill
                .steady_since(cycle.now, self.since, cycle.bounds)
    }

    /// How it ended, with one that was started as `next` taking over.
    pub(super) fn ended_into(&self, next: Start, cycle: &Cycle<'_>) -> Result<Completion, Failure> {
        let position = cycle.sample.position;
        match self.end {
            Some(target) if !self.was_at_end(cycle) => Err(self.missed(target, position)),
            _ if next == Start::Blend => Ok(Completion::Passed { position }),
            // Between two cycles it was at its end; the nearest that was seen is the better word.
            _ => Ok(Completion::Reached {
                position: self.arrived.unwrap_or(position),
            }),
        }
    }

    /// When and how it ended, as the last set-point.
    #[inline(always)]
    pub(super) fn outcome(&self, cycle: &Cycle<'_>) -> Option<Result<Completion, Failure>> {
        if !cycle.sample.statusword.contains(Statusword::TARGET_REACHED) {
            return None;
        }
        let position = cycle.sample.position;
        let reached = Ok(Completion::Reached { position });
        let steady = cycle
            .standstill
            .steady_since(cycle.now, self.since, cycle.bounds);
        // A bit 10 that was never seen low since then may be that of the set-point or halt before. An axis that stands for
        // the settle time all the same is not on its way: its position decides.
        let told = self.left_target || steady;
        match self.end {
            Some(end) if cycle.bounds.distance(end, position) <= cycle.bounds.position => {
                told.then_some(reached)
            }
            Some(target) => steady.then_some(Err(self.missed(target, position))),
            None => told.then_some(reached),
        }
    }

    /// It is over, and the axis is elsewhere.
    const fn missed(&self, target: i32, actual: i32) -> Failure {
        if self.confirmed {
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
