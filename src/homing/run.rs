//! A homing whose bit 4 is high: what the drive's bits say of it, and not of an earlier one.

use core::time::Duration;

use crate::{
    ds402::Statusword,
    profile_position::{CommandId, Completion, Cycle, Delivery, Failure, WaitingFor},
};

use super::HomingCommand;

/// A homing whose bit 4 is high.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Run {
    pub(super) id: CommandId,
    command: HomingCommand,
    pub(super) sent: bool,
    /// When bit 4 was sent.
    pub(super) since: Duration,
    /// When it is known to have been delivered.
    delivered: Option<Duration>,
    /// Bit 12 was high when bit 4 rose: of an earlier homing, until it has been low.
    stale_attained: bool,
    /// Bit 13, likewise.
    stale_error: bool,
    /// The bits said "in progress" before bit 4 rose, and have since: they do of some drives at rest.
    stale_progress: bool,
    /// Where the axis was before bit 4 rose.
    position: i32,
    /// The drive has shown that it is at work on this one.
    pub(super) begun: bool,
    /// Since when all three bits say done.
    done_since: Option<Duration>,
    /// Since when bit 12 has said so of this one, and the axis stands.
    attained_since: Option<Duration>,
    /// Since when the drive has not been at work on this one, by bits 12 and 10.
    over_since: Option<Duration>,
    /// Since when the drive has shown an error while moving.
    error_since: Option<Duration>,
}

impl Run {
    /// How far it came, should it not end well.
    pub(super) const fn delivery(&self) -> Delivery {
        if self.begun {
            Delivery::Accepted
        } else {
            Delivery::Unknown
        }
    }

    pub(super) const fn new(id: CommandId, command: HomingCommand, cycle: &Cycle<'_>) -> Self {
        let word = cycle.sample.statusword;
        Self {
            id,
            command,
            sent: false,
            since: cycle.now,
            delivered: None,
            stale_attained: word.contains(Statusword::HOMING_ATTAINED),
            stale_error: word.contains(Statusword::HOMING_ERROR),
            stale_progress: is_in_progress(word),
            position: cycle.sample.position,
            begun: false,
            done_since: None,
            attained_since: None,
            over_since: None,
            error_since: None,
        }
    }

    /// One cycle after bit 4 was sent; the result, once there is one.
    pub(super) fn step(
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
        let seen = self
            .delivered
            .is_some_and(|since| cycle.now.saturating_sub(since) >= cycle.traits.surely_seen());
        let left =
            cycle.bounds.distance(self.position, cycle.sample.position) > cycle.bounds.position;
        self.begun |= if self.stale_progress {
            seen && !error && (attained || left)
        } else {
            fell || progress
        };
        let start = if self.stale_progress {
            // It may take its time to leave.
            cycle.acknowledge.max(cycle.begin)
        } else {
            cycle.acknowledge
        };
        self.stale_progress &= progress || attained;
        self.stale_attained &= attained;
        self.stale_error &= error;

        if error && !self.stale_error {
            self.begun = true;
            return self.error(cycle, at_rest, standstill);
        }
        let done = attained && at_rest && !error;
        let since = |since: &mut Option<Duration>, holds: bool| {
            *since = holds.then(|| since.unwrap_or(cycle.now));
            since.map_or(Duration::ZERO, |since| cycle.now.saturating_sub(since))
        };
        let held = since(&mut self.done_since, done) >= cycle.bounds.settle;
        let mine = attained && !error && self.is_mine(cycle);
        let stands = cycle.standstill.is_standing();
        let rested = since(&mut self.attained_since, mine && stands);
        let over = since(&mut self.over_since, self.begun && !progress && !error);
        if self.command.is_late(cycle.now) || over >= standstill {
            return Some(Err(Failure::Timeout {
                waiting_for: WaitingFor::HomingEnd,
                statusword: word,
                controlword: cycle.controlword,
                delivery: self.delivery(),
            }));
        }
        self.begun |= mine;
        // Where standstill does not show because the axis is never quiet, the drive's word counts after a while; and where bit 10 does
        // not come, the axis' rest.
        if mine && ((at_rest && (stands || held)) || rested >= cycle.begin) {
            return Some(Ok(Completion::Homed {
                position: cycle.sample.position,
            }));
        }
        if !self.begun && cycle.now.saturating_sub(self.since) >= start {
            return Some(Err(if error {
                // An error that has stood all the time, and the drive at rest: it did not even begin.
                Failure::HomingError { moving: false }
            } else {
                Failure::Timeout {
                    waiting_for: WaitingFor::HomingStart,
                    statusword: word,
                    controlword: cycle.controlword,
                    delivery: Delivery::Unknown,
                }
            }));
        }
        None
    }

    /// Whether bits that say "done" say it of this homing.
    fn is_mine(&self, cycle: &Cycle<'_>) -> bool {
        if self.begun {
            return !self.stale_attained;
        }
        if !self.command.method.is_motionless() {
            return false;
        }
        // Nothing moves: "in progress" may be over within one of the drive's cycles and never be seen. An edge of bit 12
        // after bit 4 is proof as well. Without one, the drive has had bit 4 for so long that it would show it if it were
        // still at work, and the axis reads what it reads at home: then even a drive that has not seen bit 4 tells the truth.
        let long_enough = |since: Duration| {
            cycle.now.saturating_sub(since)
                >= cycle
                    .bounds
                    .settle
                    .max(cycle.traits.surely_seen().saturating_mul(2))
        };
        !self.stale_attained
            || (self.reads_home(cycle)
                && self.delivered.is_some_and(long_enough)
                && self.done_since.is_some_and(long_enough))
    }

    /// Whether the position is what it is at home: the home offset, with the sign that the drive gives it.
    fn reads_home(&self, cycle: &Cycle<'_>) -> bool {
        let offset = self.command.offset.unwrap_or(0);
        [offset, offset.wrapping_neg()]
            .into_iter()
            .any(|home| cycle.bounds.distance(home, cycle.sample.position) <= cycle.bounds.position)
    }

    fn error(
        &mut self,
        cycle: &Cycle<'_>,
        at_rest: bool,
        standstill: Duration,
    ) -> Option<Result<Completion, Failure>> {
        let since = *self.error_since.get_or_insert(cycle.now);
        let moving = !at_rest && !cycle.standstill.is_standing();
        let late = cycle.now.saturating_sub(since) >= standstill;
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
