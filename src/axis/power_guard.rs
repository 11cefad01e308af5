//! Whether a word that leads down may take the axis' power: only from one that stands, or has had the time to.
//!
//! As long as the drive may be driving an axis that does not stand, quick stop goes out in place of every word that leads down. In the
//! states without power both lead to the same.

use core::time::Duration;

use crate::{
    ds402::State,
    timer::{Due, Elapsed, Timer},
};

/// What is known of the drive's power stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Stage {
    /// Nothing yet.
    Unknown,
    /// It drives the axis or holds it, or has done so, and the axis has not been seen to stand since. `left`: while it is led down, how
    /// long quick stop goes out.
    Driven { left: Option<Timer> },
    /// The axis has had its time, and was not seen to stand.
    GivenUp,
    /// It drives nothing, and the axis does not run on from what it did.
    Free,
}

/// What brakes the axis before its power goes.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct PowerGuard {
    stage: Stage,
    /// While a state without power is shown, and a word that does not enable the drive is delivered: until that is sure.
    down: Option<Timer>,
}

/// What a cycle shows of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shown {
    pub state: State,
    pub stands: bool,
    /// The word sent last enables the drive, or is not known to have been delivered.
    pub enables: bool,
    /// The axis is to lose its power.
    pub leading_down: bool,
}

impl PowerGuard {
    pub const fn new() -> Self {
        Self {
            stage: Stage::Unknown,
            down: None,
        }
    }

    /// Takes in one sample. `seen`: how long the drive takes to see a word; `patience`: the axis to come to rest.
    pub fn update(&mut self, shown: Shown, elapsed: Elapsed, seen: Timer, patience: Duration) {
        let Shown { state, stands, .. } = shown;
        let powered = state.holds_axis();
        self.down = match self.down {
            _ if powered || shown.enables => None,
            None => Some(seen),
            Some(mut left) => {
                left.pass(elapsed);
                Some(left)
            }
        };
        let surely_down = matches!(self.down, Some(left) if left.is_over());
        self.stage = match self.stage {
            Stage::Unknown | Stage::Free if powered => Stage::Driven { left: None },
            Stage::Unknown if surely_down => Stage::Free,
            Stage::Driven { .. } | Stage::GivenUp if surely_down && stands => Stage::Free,
            Stage::GivenUp if stands || !shown.leading_down => Stage::Driven { left: None },
            Stage::Driven { .. } if stands || !shown.leading_down => Stage::Driven { left: None },
            Stage::Driven { left } => {
                let mut left = left.unwrap_or(Timer::new(patience));
                left.pass(elapsed);
                if left.is_over() {
                    Stage::GivenUp
                } else {
                    Stage::Driven { left: Some(left) }
                }
            }
            stage => stage,
        };
    }

    /// The axis has had its time, whatever is known of the drive.
    pub const fn give_up(&mut self) {
        self.stage = Stage::GivenUp;
    }

    /// Whether quick stop goes out in place of a word that leads down.
    pub const fn holds(&self, stands: bool) -> bool {
        !stands && self.may_hold()
    }

    /// Whether the drive drives nothing, and the axis does not run on from what it did.
    pub const fn is_free(&self) -> bool {
        matches!(self.stage, Stage::Free)
    }

    /// Whether the axis has had its time to stand.
    pub const fn has_given_up(&self) -> bool {
        matches!(self.stage, Stage::GivenUp)
    }

    /// Whether the drive may hold the axis, which has not had its time.
    pub const fn may_hold(&self) -> bool {
        matches!(self.stage, Stage::Unknown | Stage::Driven { .. })
    }

    /// Whether the drive has surely shown that its power stage is off, and was led there.
    pub const fn is_down(&self) -> bool {
        matches!(self.down, Some(left) if left.is_over())
    }

    pub fn due(&self) -> Due {
        let left = match self.stage {
            Stage::Driven { left: Some(left) } => left.due(),
            // It may be free with the next cycle.
            Stage::Unknown | Stage::GivenUp => Due::NEXT,
            Stage::Driven { left: None } | Stage::Free => Due::NEVER,
        };
        left.sooner(self.down.map_or(Due::NEVER, Timer::due))
    }
}
