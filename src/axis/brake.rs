//! Whether a word that leads down may take the axis' power: only from one that stands.
//!
//! A statusword of one cycle may be wrong, and the axis move all the same. As long as the drive may be driving an axis that does
//! not stand, quick stop goes out in place of every word that leads down. In the states without power both lead to the same.

use core::time::Duration;

use crate::{ds402::State, profile_position::Traits};

use super::no_older;

/// What is known of the drive's power stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
enum Stage {
    /// Nothing yet.
    #[default]
    Unknown,
    /// It holds or drives the axis, or has done so, and the axis has not been seen to stand since.
    Driven,
    /// It drives nothing.
    Free,
}

/// What brakes the axis before its power goes.
#[derive(Debug, Clone, Copy, Hash, Default)]
pub(super) struct Brake {
    stage: Stage,
    /// Until when quick stop is sent for an axis that does not come to rest.
    until: Option<Duration>,
    /// Since when each sample has shown a state without power, and how many there were.
    down: Option<(Duration, u32)>,
    over: bool,
    confirmed: bool,
    /// Whether the last sample showed Quick stop active.
    stopping: bool,
}

impl Brake {
    /// Takes in one sample of a drive with these traits. `leading_down`: the axis is to lose its power. `patience` is how long it may
    /// take to come to rest.
    pub(super) fn observe(
        &mut self,
        now: Duration,
        state: State,
        standing: bool,
        leading_down: bool,
        traits: &Traits,
        patience: Duration,
    ) {
        let powered = is_powered(state);
        let stopping = state == State::QuickStopActive;
        if stopping && !self.stopping {
            // It stops the axis from now on, however long it did not.
            self.until = None;
            self.over = false;
        }
        self.stopping = stopping;
        self.down = match self.down {
            _ if powered => None,
            None => Some((now, 1)),
            Some((since, samples)) => Some((since, samples.saturating_add(1))),
        };
        self.confirmed = self.down.is_some_and(|(since, samples)| {
            samples > 1 && now.saturating_sub(since) >= traits.surely_seen()
        });
        if powered {
            self.stage = Stage::Driven;
        } else if standing || (self.confirmed && (self.stage == Stage::Unknown || self.over)) {
            self.stage = Stage::Free;
        }
        if standing || !leading_down || self.stage == Stage::Free {
            self.until = None;
            self.over = false;
        } else {
            let until = *self.until.get_or_insert(now.saturating_add(patience));
            self.over |= now >= until;
        }
    }

    /// The drive was told to enable operation, and may have done so, whatever it has shown.
    pub(super) const fn may_be_enabled(&mut self) {
        self.down = None;
        self.confirmed = false;
    }

    /// Lets go of what makes no difference any more.
    pub(super) fn let_go(&mut self, now: Duration, seen: Duration) {
        if let Some((since, samples)) = &mut self.down {
            no_older(since, now, seen);
            *samples = (*samples).min(2);
        }
        if let Some(until) = &mut self.until {
            *until = (*until).max(now);
        }
    }

    /// The drive ignores quick stop.
    pub(super) const fn give_up(&mut self) {
        self.over = true;
    }

    /// Whether quick stop goes out in place of a word that leads down.
    pub(super) const fn holds(&self, standing: bool) -> bool {
        !standing && !self.over && self.may_drive()
    }

    /// Whether the drive may be driving the axis, or the axis run on from that.
    pub(super) const fn may_drive(&self) -> bool {
        !matches!(self.stage, Stage::Free)
    }

    /// Whether a sample like the last one changes nothing.
    pub(super) const fn is_calm(&self, driving: bool) -> bool {
        match self.stage {
            Stage::Unknown => false,
            Stage::Driven => driving && self.down.is_none() && self.until.is_none(),
            Stage::Free => self.confirmed,
        }
    }

    /// Whether the drive has surely shown that its power stage is off.
    pub(super) const fn is_down(&self) -> bool {
        self.confirmed
    }
}

/// Whether the drive follows set-points in this state, or stops the axis.
const fn is_powered(state: State) -> bool {
    matches!(
        state,
        State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive
    )
}
