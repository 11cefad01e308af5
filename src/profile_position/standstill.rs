//! Whether an axis stands: by its velocity where that is known, else by a position that stays.

use core::time::Duration;

use crate::ds402::Sample;

/// Follows velocity and position through the cycles.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Standstill {
    anchor: Option<(i32, Duration)>,
    /// What 606Ch says, where it is mapped.
    velocity_zero: Option<bool>,
}

/// The bounds within which an axis counts as standing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    pub(crate) position: u32,
    pub(crate) velocity: u32,
    pub(crate) settle: Duration,
}

impl Standstill {
    /// Takes in one fresh cycle.
    pub(crate) fn observe(&mut self, now: Duration, sample: &Sample, bounds: &Bounds) {
        self.velocity_zero = sample.velocity.map(|v| v.unsigned_abs() <= bounds.velocity);
        match self.anchor {
            Some((position, _)) if distance(position, sample.position) <= bounds.position => {}
            _ => self.anchor = Some((sample.position, now)),
        }
    }

    /// Whether the axis stands now: by its velocity where 606Ch is mapped, else by a position that has stayed for the
    /// settle time.
    pub(crate) fn is_standing(&self, now: Duration, bounds: &Bounds) -> bool {
        self.velocity_zero
            .unwrap_or_else(|| self.steady_since(now, Duration::ZERO, bounds))
    }

    /// Whether the position has stayed for the settle time, all of it after `since`.
    pub(crate) fn steady_since(&self, now: Duration, since: Duration, bounds: &Bounds) -> bool {
        self.anchor
            .is_some_and(|(_, from)| now.saturating_sub(from.max(since)) >= bounds.settle)
    }
}

/// How far two positions lie apart on the number circle of 32 bits.
pub(crate) const fn distance(a: i32, b: i32) -> u32 {
    a.wrapping_sub(b).unsigned_abs()
}
