//! One set-point that the drive has acknowledged, followed to its end.

use core::time::Duration;

use crate::ds402::{Sample, Statusword};

use super::{Bounds, CommandId, Completion, Failure, Standstill, Start, standstill::distance};

/// A set-point that the drive has acknowledged.
#[derive(Debug, Clone, Copy)]
pub(super) struct Track {
    pub(super) id: CommandId,
    /// How it was started: the end of the set-point before it is `Reached` or `Passed` by this.
    pub(super) start: Start,
    /// Where it ends, where that is known.
    pub(super) end: Option<i32>,
    /// When it became the active one, or was resumed.
    since: Duration,
    /// Whether bit 10 was seen low since then: only then a high one is news.
    left_target: bool,
    /// The last position within the window around its end.
    arrived: Option<i32>,
    /// On which side of its end the axis was when it became active: the sign of end − position.
    side: i32,
}

impl Track {
    pub(super) fn new(
        id: CommandId,
        start: Start,
        end: Option<i32>,
        now: Duration,
        position: i32,
    ) -> Self {
        let mut track = Self {
            id,
            start,
            end,
            since: now,
            left_target: false,
            arrived: None,
            side: 0,
        };
        track.becomes_active(now, position);
        track
    }

    /// It is the active one from now on (again): what bit 10 showed before is of no meaning for it.
    pub(super) fn becomes_active(&mut self, now: Duration, position: i32) {
        self.since = now;
        self.left_target = false;
        self.side = self
            .end
            .map_or(0, |end| end.wrapping_sub(position).signum());
    }

    /// Whether the position shows that it has ended and the next one is under way: the axis was at the end, or has
    /// passed it, and is away from it again. Being at the end is not enough: the drive may still be finishing this one,
    /// and has no place for another before that.
    pub(super) fn is_left_behind(&self, position: i32, tolerance: u32) -> bool {
        self.end.is_some_and(|end| {
            let passed = end.wrapping_sub(position).signum() == -self.side && self.side != 0;
            distance(end, position) > tolerance && (passed || self.arrived.is_some())
        })
    }

    /// The position at which it was last seen at its end.
    pub(super) const fn arrived(&self) -> Option<i32> {
        self.arrived
    }

    /// Takes in one fresh cycle.
    pub(super) fn note(&mut self, sample: &Sample, tolerance: u32) {
        self.left_target |= !sample.statusword.contains(Statusword::TARGET_REACHED);
        if self
            .end
            .is_some_and(|end| distance(end, sample.position) <= tolerance)
        {
            self.arrived = Some(sample.position);
        }
    }

    /// Whether both this one and `next` are over: the axis has been under way and now stands for the settle time at the
    /// end of `next`.
    pub(super) fn is_over_with(
        &self,
        next: &Self,
        now: Duration,
        sample: &Sample,
        standstill: &Standstill,
        bounds: &Bounds,
    ) -> bool {
        self.left_target
            && sample.statusword.contains(Statusword::TARGET_REACHED)
            && next
                .end
                .is_some_and(|end| distance(end, sample.position) <= bounds.position)
            && standstill.steady_since(now, next.since, bounds)
    }

    /// When and how it ended, as the last set-point.
    pub(super) fn outcome(
        &self,
        now: Duration,
        sample: &Sample,
        standstill: &Standstill,
        bounds: &Bounds,
    ) -> Option<Result<Completion, Failure>> {
        if !sample.statusword.contains(Statusword::TARGET_REACHED) {
            return None;
        }
        let reached = Ok(Completion::Reached {
            position: sample.position,
        });
        let steady = standstill.steady_since(now, self.since, bounds);
        match self.end {
            Some(end) if distance(end, sample.position) <= bounds.position => {
                (self.left_target || standstill.is_standing(now, bounds)).then_some(reached)
            }
            // Bit 10 alone may be the one of the set-point before; an axis that stands for the settle time is not on its way.
            Some(end) => steady.then_some(Err(Failure::MissedTarget {
                target: end,
                actual: sample.position,
            })),
            None => (self.left_target || steady).then_some(reached),
        }
    }
}
