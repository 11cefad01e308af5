//! Whether an axis stands: by a position that stays, which velocity actual value 606Ch may show earlier.

use core::time::Duration;

use crate::ds402::Sample;

use super::{PositionRange, Unrest, circle::Circle};

/// The time between two samples counts as stood for this part of the time asked for at most. So five samples are needed at least, and the
/// samples before and after a stall are no proof that the axis stood in between.
const GAP: u32 = 4;

/// Where 606Ch says so too, a position that stays within this part of the window for this part of the settle time is enough: the axis
/// is no faster by that than by the whole of both.
const SHORTER: u32 = 8;

/// But neither is less than so many of the drive's own cycles: its position may be new only once in each.
const DRIVE_CYCLES: u32 = 4;

/// In no time at all every axis stands.
const LEAST_SETTLE: Duration = Duration::from_millis(1);

/// Follows position and velocity through the cycles.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Standstill {
    stay: Option<Stay>,
    /// A stay within a part of the window, with 606Ch within its threshold.
    quiet: Option<Stay>,
    /// It stands since it came to where it is.
    stands: bool,
}

/// A position that stays.
#[derive(Debug, Clone, Copy)]
struct Stay {
    position: i32,
    /// Since when, less the time in which nothing was seen.
    since: Duration,
    /// By when the next sample has to come.
    next: Duration,
}

impl Stay {
    /// Begins with this sample, after which the next one has this time.
    const fn new(now: Duration, position: i32, gap: Duration) -> Self {
        Self {
            position,
            since: now,
            next: now.saturating_add(gap),
        }
    }

    /// Goes on with one more sample.
    #[inline]
    fn go_on(&mut self, now: Duration, gap: Duration) {
        if now > self.next {
            let unseen = now.saturating_sub(self.next);
            self.since = self.since.saturating_add(unseen);
        }
        self.next = now.saturating_add(gap);
    }

    /// For how long it has stayed, all of it after `since`.
    fn time_after(&self, now: Duration, since: Duration) -> Duration {
        now.saturating_sub(self.since.max(since))
    }
}

/// The bounds within which an axis counts as standing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    pub(crate) position: u32,
    /// Of 606Ch: at most what leads through the window in the settle time.
    pub(crate) velocity: u32,
    pub(crate) settle: Duration,
    /// How long the position must stay where 606Ch says as well that the axis stands.
    shorter: Duration,
    /// And within which part of the window.
    shorter_window: u32,
    /// How much of the time between two samples counts, of both.
    gap: Duration,
    shorter_gap: Duration,
    /// One turn of a modulo axis.
    pub(crate) turn: Option<PositionRange>,
}

impl Bounds {
    /// Bounds of this window, this threshold of 606Ch and this settle time, for a drive with this cycle.
    pub(crate) fn new(
        position: u32,
        velocity: u32,
        settle: Duration,
        drive_cycle: Duration,
        turn: Option<PositionRange>,
    ) -> Self {
        let drive_cycles = drive_cycle.saturating_mul(DRIVE_CYCLES);
        let settle = settle.max(drive_cycles).max(LEAST_SETTLE);
        let fastest = u128::from(position) * 1_000_000_000 / settle.as_nanos();
        let shorter = (settle / SHORTER).max(drive_cycles);
        Self {
            position,
            velocity: u32::try_from(fastest).map_or(velocity, |fastest| velocity.min(fastest)),
            settle,
            shorter,
            shorter_window: (position / SHORTER).max(1),
            gap: settle / GAP,
            shorter_gap: shorter / GAP,
            turn,
        }
    }

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
    /// Takes in one cycle with inputs.
    #[inline]
    pub(crate) fn observe(
        &mut self,
        now: Duration,
        position: i32,
        velocity: Option<i32>,
        bounds: &Bounds,
    ) {
        let gap = bounds.gap;
        match &mut self.stay {
            Some(stay) if bounds.distance(stay.position, position) <= bounds.position => {
                stay.go_on(now, gap);
            }
            stay => {
                *stay = Some(Stay::new(now, position, gap));
                self.stands = false;
            }
        }
        if let Some(velocity) = velocity {
            self.observe_velocity(now, position, velocity, bounds);
        }
        if !self.stands {
            self.stands = self.stands_since(now, Duration::ZERO, bounds);
        }
    }

    fn observe_velocity(&mut self, now: Duration, position: i32, velocity: i32, bounds: &Bounds) {
        if velocity.unsigned_abs() > bounds.velocity {
            self.quiet = None;
            return;
        }
        let (gap, within) = (bounds.shorter_gap, bounds.shorter_window);
        match &mut self.quiet {
            Some(quiet) if bounds.distance(quiet.position, position) <= within => {
                quiet.go_on(now, gap);
            }
            quiet => *quiet = Some(Stay::new(now, position, gap)),
        }
    }

    /// The position is measured anew from the next cycle on: where the axis sets off, and where its drive stops it, the time for
    /// which it had stayed before says nothing.
    pub(crate) const fn begin_anew(&mut self) {
        self.stay = None;
        self.quiet = None;
        self.stands = false;
    }

    /// Whether the axis stood in the last cycle with inputs.
    #[inline]
    pub(crate) const fn is_standing(&self) -> bool {
        self.stands
    }

    /// As [`is_standing`](Self::is_standing), by what was seen after `since` alone.
    pub(crate) fn stands_since(&self, now: Duration, since: Duration, bounds: &Bounds) -> bool {
        let quiet = |quiet: Stay| quiet.time_after(now, since) >= bounds.shorter;
        self.steady_since(now, since, bounds) || self.quiet.is_some_and(quiet)
    }

    /// Whether the position has stayed for the settle time, all of it after `since`.
    #[inline(never)]
    pub(crate) fn steady_since(&self, now: Duration, since: Duration, bounds: &Bounds) -> bool {
        self.stay
            .is_some_and(|stay| stay.time_after(now, since) >= bounds.settle)
    }
}

/// What was seen of an axis lately, for whoever waits for its standstill in vain.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LastSeen(Option<Seen>);

/// The last two settle times, the second of which is not over.
#[derive(Debug, Clone, Copy)]
struct Seen {
    since: Duration,
    now: Extremes,
    before: Extremes,
}

/// Least and greatest position and velocity.
#[derive(Debug, Clone, Copy)]
struct Extremes {
    positions: (i32, i32),
    velocities: Option<(i32, i32)>,
}

impl Extremes {
    fn of(sample: &Sample) -> Self {
        Self {
            positions: (sample.position, sample.position),
            velocities: sample.velocity.map(|velocity| (velocity, velocity)),
        }
    }

    fn with(self, other: Self) -> Self {
        let both = |a: (i32, i32), b: (i32, i32)| (a.0.min(b.0), a.1.max(b.1));
        Self {
            positions: both(self.positions, other.positions),
            velocities: match (self.velocities, other.velocities) {
                (Some(a), Some(b)) => Some(both(a, b)),
                (a, b) => a.or(b),
            },
        }
    }
}

impl LastSeen {
    pub(crate) fn observe(&mut self, now: Duration, sample: &Sample, bounds: &Bounds) {
        let new = Extremes::of(sample);
        match &mut self.0 {
            Some(seen) if now.saturating_sub(seen.since) < bounds.settle => {
                seen.now = seen.now.with(new);
            }
            last => {
                *last = Some(Seen {
                    since: now,
                    now: new,
                    before: last.map_or(new, |seen| seen.now),
                });
            }
        }
    }

    pub(crate) fn unrest(&self, bounds: &Bounds) -> Unrest {
        let both = self.0.map(|seen| seen.now.with(seen.before));
        Unrest {
            positions: both.map_or((0, 0), |both| both.positions),
            window: bounds.position,
            settle_ms: u32::try_from(bounds.settle.as_millis()).unwrap_or(u32::MAX),
            velocities: both
                .and_then(|both| both.velocities)
                .map(|(least, greatest)| (least, greatest, bounds.velocity)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bounds(turn: Option<PositionRange>) -> Bounds {
        let settle = Duration::from_millis(100);
        Bounds::new(10, 0, settle, Duration::from_millis(1), turn)
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
