//! Cycles in which nothing happens: what cannot have changed is not computed again.
//!
//! At the end of each whole step it is judged once whether the next can only come to the same: nothing asked for, nothing
//! waiting, no deadline running, the outputs delivered as they are. As long as statusword, mode and error code then stay as
//! they were, all that is left to do is to follow the position. Whatever composes outputs ends the calm
//! ([`AxisCore::write_outputs`]), and so does everything else that a whole step would take in.
//! `tests/invariants` holds both ways against each other.

use core::time::Duration;

use crate::ds402::{Mode, State};

use super::{
    AxisCore, Inputs,
    core::cycle,
    fields::Sight,
    power::Power,
    stopping::{Stage, Stopping},
};

/// Whether the next step can be other than this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Calm {
    /// It can: it is computed as a whole.
    No,
    /// No set-point is under way, and 607Ah stays.
    Standing,
    /// The same, and 607Ah follows the position.
    Following,
    /// One set-point is under way, and only its position and bit 10 can end it.
    Moving,
}

/// What is new since the axis' port looked last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(
    not(feature = "std"),
    expect(dead_code, reason = "only a port asks for news")
)]
pub(super) enum News {
    /// The cycle's number alone.
    Nothing,
    /// Position and velocity.
    Motion,
    /// That there were no inputs.
    Silence,
    Anything,
}

impl AxisCore {
    /// Whether a step with these inputs, which are those of the last one, does nothing but count the cycle: no set-point is under way.
    #[inline]
    const fn stays(&self, inputs: &Inputs<'_>) -> bool {
        matches!(self.calm, Calm::Standing | Calm::Following)
            && matches!(inputs, Inputs::Fresh(_))
            && self.stale_cycles == 0
            // Else the time alone may bring it to rest.
            && self.is_standing()
    }

    /// Whether moreover its port has been told of everything: such a step may be left out, if it is counted later.
    #[cfg(feature = "std")]
    #[inline]
    pub(crate) fn rests_at(&self, inputs: &Inputs<'_>) -> bool {
        self.stays(inputs) && self.news == News::Nothing
    }

    /// Counts the steps that were left out: there were so many in all.
    #[cfg(feature = "std")]
    #[inline]
    pub(crate) const fn count_to(&mut self, cycles: u64) {
        self.cycle = cycles;
    }

    /// A step with inputs that are those of the last one: whether that is all.
    #[inline(always)]
    pub(super) fn step_at_rest(&mut self, inputs: &Inputs<'_>) -> bool {
        let stays = self.stays(inputs);
        if stays {
            self.cycle = self.cycle.wrapping_add(1);
        }
        stays
    }

    /// A step that needs nothing but the position. None if it has to be computed as a whole; else whether the outputs have
    /// changed.
    #[inline(always)]
    pub(super) fn step_calmly(
        &mut self,
        now: Duration,
        inputs: &Inputs<'_>,
        outputs: &mut [u8],
    ) -> Option<bool> {
        if self.calm == Calm::No {
            return None;
        }
        match inputs {
            // How long it was blind matters for the first one after that.
            Inputs::Fresh(bytes) if self.stale_cycles == 0 => self.follow(now, bytes, outputs),
            Inputs::Stale => self.wait_blindly().then_some(false),
            Inputs::Fresh(_) | Inputs::Answered(_) => None,
        }
    }

    #[inline(always)]
    fn follow(&mut self, now: Duration, bytes: &[u8], outputs: &mut [u8]) -> Option<bool> {
        let fields = &self.config.fields;
        if !fields.shows(bytes, &self.sight) {
            return None;
        }
        let (position, velocity) = fields.motion(bytes)?;
        let sample = self.sample.as_mut()?;
        sample.position = position;
        if let Some(before) = &mut sample.velocity {
            *before = velocity;
        }
        self.standstill
            .observe(now, position, sample.velocity, &self.bounds);
        self.cycle = self.cycle.wrapping_add(1);
        self.news = match self.news {
            News::Nothing | News::Motion => News::Motion,
            News::Silence | News::Anything => News::Anything,
        };
        match self.calm {
            Calm::Standing | Calm::No => Some(false),
            Calm::Following => {
                self.sequencer.follow_position(position);
                fields.write_target(outputs, position);
                Some(true)
            }
            Calm::Moving => {
                if self.sequencer.follow(now, sample, &self.bounds) {
                    self.look_for_end(now);
                }
                Some(false)
            }
        }
    }

    #[inline(never)]
    fn look_for_end(&mut self, now: Duration) {
        let Some(sample) = &self.sample else { return };
        let cycle = cycle!(self, now, sample, true);
        if self.sequencer.end(&cycle, &mut self.events) {
            self.calm = Calm::No;
            self.news = News::Anything;
        }
    }

    /// A cycle without inputs, if the drive does not count as lost by it.
    fn wait_blindly(&mut self) -> bool {
        let (stale, undelivered) = (
            self.stale_cycles.saturating_add(1),
            self.undelivered_cycles.saturating_add(1),
        );
        let loss = &self.config.loss;
        if stale >= loss.stale_cycles || undelivered >= loss.undelivered_cycles {
            return false;
        }
        self.cycle = self.cycle.wrapping_add(1);
        self.answered = false;
        self.stale_cycles = stale;
        self.undelivered_cycles = undelivered;
        self.news = match self.news {
            News::Nothing => News::Silence,
            _ => News::Anything,
        };
        true
    }

    /// Whether the next step can be other than the one just computed.
    pub(super) fn judge_calm(&mut self, delivered: bool) {
        self.calm = Calm::No;
        let Some(sample) = self.sample else { return };
        // In the others, drives do things by themselves.
        let settled = matches!(
            sample.state(),
            State::NotReadyToSwitchOn
                | State::SwitchOnDisabled
                | State::ReadyToSwitchOn
                | State::SwitchedOn
                | State::OperationEnabled
        );
        let sent = self.outgoing == self.sent && self.outgoing_velocity == self.sent_velocity;
        let driving = self.power.is_driving();
        // One that is enabled and not to be is stopped before it is switched off: whether it stands is looked at.
        let settled = settled && (driving || sample.state() != State::OperationEnabled);
        let enabled = sample.state() == State::OperationEnabled && driving;
        let in_mode = enabled && sample.mode == self.mode;
        let calm = delivered
            && self.brake.is_calm(driving)
            && settled
            && sent
            && self.blind_cycles == 0
            && !self.lost
            && !self.halted
            && self.mode_change.is_none()
            && self.power.is_calm()
            && self.stopping.is_calm()
            && self.homing.is_calm(in_mode && self.mode == Mode::Homing)
            && self.jogging.is_calm()
            && (self.sequencer.holds_any() || !self.sequencer.has_end_velocity())
            && self
                .sequencer
                .is_calm(in_mode && self.mode == Mode::ProfilePosition);
        if !calm {
            return;
        }
        self.sight = Sight::of(&sample);
        let follows = if enabled {
            in_mode && self.mode != Mode::ProfilePosition
        } else {
            !driving && !self.outgoing_starts()
        };
        self.calm = match (self.sequencer.holds_any(), follows) {
            (false, false) => Calm::Standing,
            (false, true) => Calm::Following,
            (true, _) if in_mode && self.mode == Mode::ProfilePosition => Calm::Moving,
            (true, _) => Calm::No,
        };
    }
}

impl Power {
    /// Whether nobody waits for it and it has no deadline.
    const fn is_calm(&self) -> bool {
        matches!(
            self,
            Self::Off | Self::Ready | Self::Enabled | Self::Holding
        )
    }
}

impl Stopping {
    /// Whether no stop is under way and nobody waits for one.
    fn is_calm(&self) -> bool {
        self.stage == Stage::None && self.has_no_waiter()
    }
}
