//! Within what an axis stands, and how far two of its positions are apart.

use core::time::Duration;

use super::{PositionRange, circle::Circle};

/// So many of the drive's own cycles the settle time lasts at least: its position may be new only once in each.
const DRIVE_CYCLES: u32 = 4;

/// In no time at all every axis stands.
const LEAST_SETTLE: Duration = Duration::from_millis(1);

/// The bounds within which an axis counts as standing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    /// The window.
    pub position: u32,
    pub settle: Duration,
    /// One turn of a modulo axis.
    pub turn: Option<PositionRange>,
}

impl Bounds {
    /// Bounds of this window and this settle time, for a drive with this cycle.
    pub fn new(
        position: u32,
        settle: Duration,
        drive_cycle: Duration,
        turn: Option<PositionRange>,
    ) -> Self {
        let drive_cycles = drive_cycle.saturating_mul(DRIVE_CYCLES);
        Self {
            position,
            settle: settle.max(drive_cycles).max(LEAST_SETTLE),
            turn,
        }
    }

    /// The shorter way from one position to another: of a modulo axis around its turn, of others on the number circle of 32
    /// bits.
    #[inline]
    pub fn way(&self, from: i32, to: i32) -> i64 {
        let turn = self.turn.as_ref().map(PositionRange::turn);
        Circle::<32>::way(turn, from.into(), to.into())
    }

    /// How far two positions lie apart, the shorter way.
    #[inline]
    pub fn distance(&self, a: i32, b: i32) -> u32 {
        match self.turn {
            None => b.wrapping_sub(a).unsigned_abs(),
            Some(_) => self.distance_around(a, b),
        }
    }

    /// Whether two positions are no further apart than the window.
    #[inline]
    pub fn is_within_window(&self, a: i32, b: i32) -> bool {
        self.distance(a, b) <= self.position
    }

    /// Kept out of the way of axes without a turn: the divisions take many registers.
    #[inline(never)]
    fn distance_around(&self, a: i32, b: i32) -> u32 {
        // At most 2³¹.
        self.way(a, b).unsigned_abs() as u32
    }

    /// Where an axis stands that has gone this far from a position.
    pub fn after(&self, from: i32, distance: i32) -> i32 {
        let turn = self.turn.as_ref().map(PositionRange::turn);
        // On the circle it fits.
        Circle::<32>::after(turn, from.into(), distance.into()) as i32
    }
}
