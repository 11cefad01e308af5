//! Whether an axis stands: by its velocity where that is known, else by a position that stays.

use core::time::Duration;

use super::{PositionRange, circle::Circle};

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
    /// One turn of a modulo axis.
    pub(crate) turn: Option<PositionRange>,
}

impl Bounds {
    /// The shorter way from one position to another: of a modulo axis around its turn, of others on the number circle of 32
    /// bits.
    #[inline]
    pub(crate) fn way(&self, from: i32, to: i32) -> i64 {
        let turn = self.turn.as_ref().map(PositionRange::turn);
        Circle::<32>::way(turn, from.into(), to.into())
    }

    /// How far two positions lie apart, the shorter way.
    #[inline]
    pub(crate) fn distance(&self, a: i32, b: i32) -> u32 {
        match self.turn {
            None => b.wrapping_sub(a).unsigned_abs(),
            // At most 2³¹.
            Some(_) => self.way(a, b).unsigned_abs() as u32,
        }
    }

    /// Where an axis stands that has gone this far from a position.
    pub(crate) fn after(&self, from: i32, distance: i32) -> i32 {
        let turn = self.turn.as_ref().map(PositionRange::turn);
        // On the circle it fits.
        Circle::<32>::after(turn, from.into(), distance.into()) as i32
    }

    /// The length of a modulo axis' turn; none on the number circle of 32 bits.
    pub(crate) fn turn_length(&self) -> Option<i64> {
        self.turn?.length().map(i64::from)
    }
}

impl Standstill {
    /// Takes in one fresh cycle.
    #[inline]
    pub(crate) fn observe(
        &mut self,
        now: Duration,
        position: i32,
        velocity: Option<i32>,
        bounds: &Bounds,
    ) {
        self.velocity_zero = velocity.map(|v| v.unsigned_abs() <= bounds.velocity);
        match self.anchor {
            Some((stood, _)) if bounds.distance(stood, position) <= bounds.position => {}
            _ => self.anchor = Some((position, now)),
        }
    }

    /// The position is measured anew from the next cycle on: where the axis sets off, and where its drive stops it, the time for
    /// which it had stayed before says nothing.
    pub(crate) const fn begin_anew(&mut self) {
        self.anchor = None;
    }

    /// Whether the axis stands now: by its velocity where 606Ch is mapped, else by a position that has stayed for the
    /// settle time.
    #[inline]
    pub(crate) fn is_standing(&self, now: Duration, bounds: &Bounds) -> bool {
        self.stands_since(now, Duration::ZERO, bounds)
    }

    /// Whether 606Ch is mapped, so that it alone says whether the axis stands.
    pub(crate) const fn shows_velocity(&self) -> bool {
        self.velocity_zero.is_some()
    }

    /// As [`is_standing`](Self::is_standing), and a position must have stayed for the settle time after `since`.
    #[inline]
    pub(crate) fn stands_since(&self, now: Duration, since: Duration, bounds: &Bounds) -> bool {
        self.velocity_zero
            .unwrap_or_else(|| self.steady_since(now, since, bounds))
    }

    /// Whether the position has stayed for the settle time, all of it after `since`.
    #[inline(never)]
    pub(crate) fn steady_since(&self, now: Duration, since: Duration, bounds: &Bounds) -> bool {
        self.anchor
            .is_some_and(|(_, from)| now.saturating_sub(from.max(since)) >= bounds.settle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bounds(turn: Option<PositionRange>) -> Bounds {
        Bounds {
            position: 10,
            velocity: 0,
            settle: Duration::from_millis(100),
            turn,
        }
    }

    #[test]
    fn the_shorter_way_goes_around_the_turn() {
        let degrees = bounds(Some(PositionRange { min: 0, max: 3_599 }));
        for (from, to, way) in [
            (3_590, 5, 15),
            (5, 3_590, -15),
            (0, 1_800, 1_800),
            (0, 1_801, -1_799),
            (7, 7, 0),
        ] {
            assert_eq!(degrees.way(from, to), way, "{from} to {to}");
            assert_eq!(degrees.distance(from, to), way.unsigned_abs() as u32);
        }
        assert_eq!(degrees.after(3_590, 3_600 + 20), 10);
        assert_eq!(degrees.after(10, -20), 3_590);
        let about_zero = bounds(Some(PositionRange {
            min: -1_800,
            max: 1_799,
        }));
        assert_eq!(about_zero.way(1_790, -1_790), 20);
        assert_eq!(about_zero.after(1_790, 20), -1_790);
    }

    #[test]
    fn positions_without_a_turn_lie_on_the_circle_of_32_bits() {
        for turn in [
            None,
            Some(PositionRange {
                min: i32::MIN,
                max: i32::MAX,
            }),
            Some(PositionRange { min: 5, max: 5 }),
        ] {
            let bounds = bounds(turn);
            assert_eq!(bounds.way(i32::MAX, i32::MIN), 1);
            assert_eq!(bounds.distance(i32::MIN, i32::MAX), 1);
            assert_eq!(bounds.distance(0, i32::MIN), 1 << 31);
            assert_eq!(bounds.after(i32::MAX, 1), i32::MIN);
        }
    }
}
