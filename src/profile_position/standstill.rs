//! Whether an axis stands: by a position that stays, which velocity actual value 606Ch may show earlier.

use core::time::Duration;

use crate::ds402::{Sample, Statusword};

use super::{PositionRange, Unrest, circle::Circle};

/// The time between two samples counts as stood for this part of the time asked for at most. So five samples are needed at least, and the
/// samples before and after a stall are no proof that the axis stood in between. Where frames were lost for half as long again, all time
/// before counts for nothing: an axis that swings comes back to where it was.
const GAP: u32 = 4;

/// Where 606Ch says so too, a position that stays within this part of the window for this part of the settle time is enough: the axis
/// is no faster by that than by the whole of both.
const SHORTER: u32 = 8;

/// But neither is less than so many of the drive's own cycles: its position may be new only once in each.
const DRIVE_CYCLES: u32 = 4;

/// How many later references an axis that does not stand yet has at most: each begins where it has gone a part of the window further
/// than the one before, so they cover the window. When the axis leaves the first it has still stayed around the next.
const LATER: usize = 3;

/// In no time at all every axis stands.
const LEAST_SETTLE: Duration = Duration::from_millis(1);

/// Follows position and velocity through the cycles. Times are nanoseconds here: this runs in every cycle of every axis.
#[derive(Debug, Clone, Copy, Hash, Default)]
pub(crate) struct Standstill {
    stay: Stay,
    /// Around later references, the oldest first; empty once it stands.
    later: [Stay; LATER],
    /// A stay within a part of the window, with 606Ch within its threshold.
    quiet: Stay,
    /// When the last sample came, for both.
    last: u64,
    /// It stands since it came to where it is.
    stands: bool,
    /// It came here from another place, and does not stand.
    came: bool,
    /// Around it, where it stands and 606Ch is no more than its threshold: at these positions it stands on.
    rest: Option<Positions>,
}

/// Positions next to one another.
#[derive(Debug, Clone, Copy, Hash)]
struct Positions {
    least: i32,
    /// From the least to the greatest.
    width: u32,
}

/// A position that stays.
#[derive(Debug, Clone, Copy, Hash)]
struct Stay {
    /// Since when, less the time in which nothing was seen; [`NEVER`] where nothing stays.
    since: u64,
    position: i32,
}

/// Later than every sample: the time from it on is 0.
const NEVER: u64 = u64::MAX;

impl Default for Stay {
    fn default() -> Self {
        Self::NONE
    }
}

impl Stay {
    const NONE: Self = Self {
        since: NEVER,
        position: 0,
    };

    /// Goes on with this sample, or begins with it where it is further away than that. Whether it goes on.
    #[inline]
    fn update(&mut self, now: u64, position: i32, within: u32, bounds: &Bounds) -> bool {
        let goes_on = self.since != NEVER && bounds.distance(self.position, position) <= within;
        if !goes_on {
            *self = Self {
                since: now,
                position,
            };
        }
        goes_on
    }

    /// No more than this counts of the time between the last two samples.
    fn leave_out(&mut self, passed: u64, gap: u64) {
        self.since = self.since.saturating_add(passed.saturating_sub(gap));
    }

    /// For how long it has stayed, all of it after `since`.
    #[inline]
    fn time_after(&self, now: u64, since: u64) -> u64 {
        now.saturating_sub(self.since.max(since))
    }
}

impl Positions {
    /// Those that lie within the windows of both, and not beyond the ends of 32 bits: so they do around a turn, too.
    fn of_both(stay: (i32, u32), quiet: (i32, u32)) -> Option<Self> {
        let least = |(position, within): (i32, u32)| position.saturating_sub_unsigned(within);
        let greatest = |(position, within): (i32, u32)| position.saturating_add_unsigned(within);
        let (least, greatest) = (
            least(stay).max(least(quiet)),
            greatest(stay).min(greatest(quiet)),
        );
        (least <= greatest).then(|| Self {
            least,
            width: greatest.abs_diff(least),
        })
    }

    #[inline]
    const fn contain(&self, position: i32) -> bool {
        position.wrapping_sub(self.least).cast_unsigned() <= self.width
    }
}

/// A time in nanoseconds; of more than 584 years, those.
#[inline]
const fn nanoseconds(time: Duration) -> u64 {
    let seconds = time.as_secs().saturating_mul(1_000_000_000);
    seconds.saturating_add(time.subsec_nanos() as u64)
}

/// The bounds within which an axis counts as standing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    pub position: u32,
    /// Of 606Ch: at most what leads through the window in the settle time.
    pub velocity: u32,
    pub settle: Duration,
    /// The same in nanoseconds, like the times below.
    settle_ns: u64,
    /// How long the position must stay where 606Ch says as well that the axis stands. Where it may not shorten that, this is the settle time,
    /// and what follows is of the whole window.
    shorter: u64,
    /// And within which part of the window.
    shorter_window: u32,
    /// How much of the time between two samples counts, of both. The shorter one is not longer than the other.
    gap: u64,
    shorter_gap: u64,
    /// One turn of a modulo axis.
    pub turn: Option<PositionRange>,
}

impl Bounds {
    /// Bounds of this window, this threshold of 606Ch and this settle time, for a drive with this cycle. Without a threshold in the unit of
    /// 606Ch that shortens nothing: a drive may show 0 at any speed below its unit. Nor does it where the window has no eighth: within a whole
    /// count an axis may be faster than by the window.
    pub fn new(
        position: u32,
        velocity: Option<u32>,
        settle: Duration,
        drive_cycle: Duration,
        turn: Option<PositionRange>,
    ) -> Self {
        let drive_cycles = drive_cycle.saturating_mul(DRIVE_CYCLES);
        let settle = settle.max(drive_cycles).max(LEAST_SETTLE);
        let fastest = u128::from(position) * 1_000_000_000 / settle.as_nanos();
        let (shorter, shorter_window) = if velocity.is_some() && position >= SHORTER {
            ((settle / SHORTER).max(drive_cycles), position / SHORTER)
        } else {
            (settle, position)
        };
        let velocity = velocity.unwrap_or(0);
        Self {
            position,
            velocity: u32::try_from(fastest).map_or(velocity, |fastest| velocity.min(fastest)),
            settle,
            settle_ns: nanoseconds(settle),
            shorter: nanoseconds(shorter),
            shorter_window,
            gap: nanoseconds(settle / GAP),
            shorter_gap: nanoseconds(shorter / GAP),
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

    /// The length of a modulo axis' turn; none on the number circle of 32 bits.
    pub fn turn_length(&self) -> Option<i64> {
        self.turn?.length().map(i64::from)
    }
}

impl Standstill {
    /// Takes in one cycle with inputs.
    #[inline(always)]
    pub fn update(&mut self, now: Duration, position: i32, velocity: Option<i32>, bounds: &Bounds) {
        let now = nanoseconds(now);
        // Most axes of a line stand, and dither.
        if let Some(rest) = &self.rest
            && rest.contain(position)
            && velocity.is_none_or(|velocity| velocity.unsigned_abs() <= bounds.velocity)
            && now.wrapping_sub(self.last) <= bounds.shorter_gap
        {
            self.last = now;
        } else {
            self.judge(now, position, velocity, bounds);
        }
    }

    #[inline(never)]
    fn judge(&mut self, now: u64, position: i32, velocity: Option<i32>, bounds: &Bounds) {
        // A time before the last one is a gap of none.
        if now.wrapping_sub(self.last) >= bounds.shorter_gap {
            let passed = now.saturating_sub(self.last);
            self.quiet.leave_out(passed, bounds.shorter_gap);
            self.stay.leave_out(passed, bounds.gap);
            for stay in &mut self.later {
                stay.leave_out(passed, bounds.gap);
            }
        }
        self.last = now;
        let quiet = match velocity {
            Some(velocity) if velocity.unsigned_abs() <= bounds.velocity => {
                let within = bounds.shorter_window;
                self.quiet.update(now, position, within, bounds)
            }
            _ => {
                self.quiet.since = NEVER;
                false
            }
        };
        let was_seen = self.stay.since != NEVER;
        let stays = self.stay.update(now, position, bounds.position, bounds);
        // What has just begun has stayed for no time.
        self.stands = (stays && (self.stands || self.stay.time_after(now, 0) >= bounds.settle_ns))
            || (quiet && self.quiet.time_after(now, 0) >= bounds.shorter);
        self.came = !self.stands && (if stays { self.came } else { was_seen });
        if self.stands {
            self.later = [Stay::NONE; LATER];
            self.rest = self.rest(velocity.is_some(), bounds);
        } else {
            self.rest = None;
            if stays || self.later[0].since != NEVER {
                self.refer(now, position, stays, bounds);
            }
        }
    }

    /// Follows the later references. Where the axis does not stay around the first, the oldest around which it has stayed takes its place.
    #[inline(never)]
    fn refer(&mut self, now: u64, position: i32, stays: bool, bounds: &Bounds) {
        let distance = |stay: &Stay| bounds.distance(stay.position, position);
        let mut near = self
            .later
            .into_iter()
            .filter(|stay| stay.since != NEVER && distance(stay) <= bounds.position);
        if !stays && let Some(oldest) = near.next() {
            self.stay = oldest;
        }
        let mut later = [Stay::NONE; LATER];
        let (mut newest, mut places) = (self.stay, later.iter_mut());
        for stay in near {
            newest = stay;
            if let Some(place) = places.next() {
                *place = stay;
            }
        }
        if distance(&newest) > bounds.position / (LATER as u32 + 1) {
            let begins = Stay {
                since: now,
                position,
            };
            match places.next() {
                Some(place) => *place = begins,
                None => later[LATER - 1] = begins,
            }
        }
        self.later = later;
    }

    /// Where the axis may be and stands on. `measured`: 606Ch shows its velocity.
    #[inline(never)]
    fn rest(&self, measured: bool, bounds: &Bounds) -> Option<Positions> {
        let stay = (self.stay.position, bounds.position);
        let quiet = (self.quiet.position, bounds.shorter_window);
        match measured {
            false => Positions::of_both(stay, stay),
            true if self.quiet.since == NEVER => None,
            true => Positions::of_both(stay, quiet),
        }
    }

    /// The position is measured anew from the next cycle on: where the axis sets off, and where its drive stops it, the time for
    /// which it had stayed before says nothing.
    pub const fn begin_anew(&mut self) {
        self.stay.since = NEVER;
        self.quiet.since = NEVER;
        self.later = [Stay::NONE; LATER];
        self.stands = false;
        self.came = false;
        self.rest = None;
    }

    /// Frames were lost until now. Of an axis that does not stand, all time before a long loss counts for nothing.
    pub fn note_loss(&mut self, now: Duration, bounds: &Bounds) {
        let now = nanoseconds(now);
        let passed = now.saturating_sub(self.last);
        if !self.stands && passed > bounds.gap.saturating_add(bounds.gap / 2) {
            let stays = [&mut self.stay, &mut self.quiet];
            for stay in stays.into_iter().chain(&mut self.later) {
                stay.since = stay.since.max(now);
            }
            self.last = now;
        }
    }

    /// Lets go of what makes no difference any more.
    pub fn canonicalize(&mut self, now: Duration, settle: Duration) {
        let (now, settle) = (nanoseconds(now), nanoseconds(settle));
        let last = self.last.max(now.saturating_sub(settle));
        let stays = [&mut self.stay, &mut self.quiet];
        for stay in stays.into_iter().chain(&mut self.later) {
            if stay.since == NEVER {
                stay.position = 0;
            } else {
                let stayed = self.last.saturating_sub(stay.since);
                stay.since = last.saturating_sub(stayed.min(settle));
            }
        }
        self.last = last;
        // The next sample is judged as a whole, which comes to the same.
        self.rest = None;
    }

    /// Whether the axis stood in the last cycle with inputs.
    #[inline]
    pub const fn is_standing(&self) -> bool {
        self.stands
    }

    /// Whether it was seen to move, and has not stood since.
    #[inline]
    pub const fn is_under_way(&self) -> bool {
        self.came
    }

    /// As [`is_standing`](Self::is_standing), by what was seen after `since` alone.
    pub fn stands_since(&self, now: Duration, since: Duration, bounds: &Bounds) -> bool {
        let (now, since) = (nanoseconds(now), nanoseconds(since));
        self.stay.time_after(now, since) >= bounds.settle_ns
            || self.quiet.time_after(now, since) >= bounds.shorter
    }

    /// Whether the position has stayed for the settle time, all of it after `since`.
    pub fn steady_since(&self, now: Duration, since: Duration, bounds: &Bounds) -> bool {
        let time = self.stay.time_after(nanoseconds(now), nanoseconds(since));
        time >= bounds.settle_ns
    }
}

/// Since when each sample has shown something, as a standstill counts time: of the time between two samples no more than a quarter of
/// what is asked for. The samples before and after a stall are no proof of what was between them.
#[derive(Debug, Clone, Copy, Hash)]
pub(crate) struct ShownFor {
    /// Since when, less the time in which nothing was seen, in nanoseconds; [`NEVER`] if the last sample did not show it.
    since: u64,
    /// When the last sample came.
    last: u64,
}

impl Default for ShownFor {
    fn default() -> Self {
        Self::NOT
    }
}

impl ShownFor {
    pub const NOT: Self = Self {
        since: NEVER,
        last: NEVER,
    };

    /// Takes in a sample that shows it, or does not. Whether it has been shown for this time.
    pub fn update(&mut self, now: Duration, shown: bool, time: Duration) -> bool {
        if !shown {
            *self = Self::NOT;
            return false;
        }
        let (now, time) = (nanoseconds(now), nanoseconds(time));
        if self.since == NEVER {
            (self.since, self.last) = (now, now);
        }
        self.since = self.since.saturating_add(self.unseen(now, time));
        self.last = now;
        now.saturating_sub(self.since) >= time
    }

    /// What does not count of the time since the last sample.
    #[inline]
    fn unseen(&self, now: u64, time: u64) -> u64 {
        let gap = time / u64::from(GAP);
        now.saturating_sub(self.last).saturating_sub(gap)
    }

    /// Lets go of what makes no difference any more, of whoever asks for this time.
    pub fn canonicalize(&mut self, now: Duration, time: Duration) {
        if self.since != NEVER {
            let (now, time) = (nanoseconds(now), nanoseconds(time));
            let unseen = self.unseen(now, time);
            self.last = self.last.saturating_add(unseen);
            let since = self.since.saturating_add(unseen);
            self.since = since.max(self.last.saturating_sub(time));
        }
    }
}

/// What an axis under way showed last, from the moment it is told to stop until its drive shows anything else after the delivery, or that
/// it has come to rest. Until then nobody knows whether the drive is still at work, and a position that stays is no rest.
#[derive(Debug, Clone, Copy, Hash, Default)]
pub(crate) struct Unanswered(Option<Sample>);

impl Unanswered {
    /// `shown`: the last sample of an axis under way; none of one at rest, which has nothing to show.
    pub const fn new(shown: Option<Sample>) -> Self {
        Self(shown)
    }

    /// Takes in a sample. `delivered`: what tells the axis to stop was delivered before it. Where the frames of its way to rest were lost,
    /// the drive answers by bit 10.
    pub fn update(&mut self, sample: &Sample, delivered: bool) {
        if let Some(shown) = self.0 {
            let is_reached = |sample: &Sample| {
                let word = sample.statusword;
                word.contains(Statusword::TARGET_REACHED)
            };
            let came_to_rest = is_reached(sample) && !is_reached(&shown);
            let answers = (delivered && shown != *sample) || came_to_rest;
            self.0 = (!answers).then_some(*sample);
        }
    }

    /// Whether the drive may have died with the stop.
    pub const fn is_open(&self) -> bool {
        self.0.is_some()
    }
}

/// What was seen of an axis lately, for whoever waits for its standstill in vain.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LastSeen(Option<RecentExtremes>);

/// The last two settle times, the second of which is not over.
#[derive(Debug, Clone, Copy)]
struct RecentExtremes {
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
    pub fn update(&mut self, now: Duration, sample: &Sample, bounds: &Bounds) {
        let new = Extremes::of(sample);
        match &mut self.0 {
            Some(seen) if now.saturating_sub(seen.since) < bounds.settle => {
                seen.now = seen.now.with(new);
            }
            last => {
                *last = Some(RecentExtremes {
                    since: now,
                    now: new,
                    before: last.map_or(new, |seen| seen.now),
                });
            }
        }
    }

    pub fn unrest(&self, bounds: &Bounds) -> Unrest {
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
        Bounds::new(10, None, settle, Duration::from_millis(1), turn)
    }

    /// Of the time after the last sample no more than a quarter counts, and of all no more than is asked for.
    #[test]
    fn what_was_shown_counts_no_longer_than_is_asked_for() {
        let (ms, time) = (Duration::from_millis, Duration::from_millis(100));
        let after = |first, last, now| {
            let mut shown = ShownFor::NOT;
            for at in [first, last] {
                shown.update(ms(at), true, time);
            }
            shown.canonicalize(ms(now), time);
            (shown.since / 1_000_000, shown.last / 1_000_000)
        };
        assert_eq!(after(1, 1, 1), (1, 1));
        assert_eq!(after(1, 11, 11), (1, 11));
        assert_eq!(after(1, 11, 36), (1, 11), "a quarter has passed");
        assert_eq!(after(1, 11, 1_036), (1_001, 1_011));
    }

    /// Before the delivery of what tells the axis to stop only a bit 10 that rises answers it.
    #[test]
    fn a_drive_answers_before_the_delivery_by_the_rise_of_bit_10_alone() {
        let sample = |word: Statusword, position: i32| Sample {
            statusword: word,
            mode: crate::ds402::Mode::ProfilePosition,
            position,
            velocity: None,
            error_code: None,
        };
        let (low, high) = (Statusword::empty(), Statusword::TARGET_REACHED);
        for (before, after, answers) in [
            (low, low, false),
            (low, high, true),
            (high, low, false),
            (high, high, false),
        ] {
            let mut unanswered = Unanswered::new(Some(sample(before, 100)));
            unanswered.update(&sample(after, 90), false);
            assert_eq!(unanswered.is_open(), !answers, "{before:?} {after:?}");
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

    /// What is said of an axis whose position stays around a place is the same as where each cycle is judged as a whole.
    #[test]
    fn a_cycle_at_rest_is_judged_as_any_other() {
        let turns = [
            None,
            Some(PositionRange { min: 0, max: 3_599 }),
            Some(PositionRange {
                min: i32::MAX - 99,
                max: i32::MAX,
            }),
        ];
        let mut number = 1_u64;
        let mut random = |below: u64| {
            number ^= number << 13;
            number ^= number >> 7;
            number ^= number << 17;
            number % below
        };
        let (mut short, mut cycles) = ([0, 0], [0, 0]);
        for scenario in 0..3_000 {
            let window = random(20) as u32;
            let threshold = (random(4) as u32).checked_sub(1);
            let settle = Duration::from_millis(20);
            let cycle = Duration::from_millis(1);
            let bounds = Bounds::new(window, threshold, settle, cycle, turns[scenario % 3]);
            let (mut axis, mut now) = (Standstill::default(), Duration::ZERO);
            let mut position = [0, 3_600, i32::MAX, i32::MIN][random(4) as usize];
            let measured = random(2) == 0;
            for _ in 0..200 {
                now += Duration::from_micros(if random(40) == 0 { 9_000 } else { 1_000 });
                let step = if random(30) == 0 { 15 } else { 1 };
                position = position.wrapping_add(random(2 * step + 1) as i32 - step as i32);
                let velocity = measured.then(|| random(5) as i32 - 2);
                let mut whole = Standstill { rest: None, ..axis };
                let is_short = axis.rest.is_some_and(|rest| rest.contain(position));
                short[usize::from(measured)] += u32::from(is_short);
                cycles[usize::from(measured)] += 1;
                axis.update(now, position, velocity, &bounds);
                whole.update(now, position, velocity, &bounds);
                assert_eq!(axis.is_standing(), whole.is_standing());
                let said = |axis: &Standstill| {
                    [0, 2, 5, 20].map(|ms| {
                        let since = now.saturating_sub(Duration::from_millis(ms));
                        (
                            axis.stands_since(now, since, &bounds),
                            axis.steady_since(now, since, &bounds),
                        )
                    })
                };
                assert_eq!(said(&axis), said(&whole), "scenario {scenario}");
                let state = |axis: &Standstill| {
                    let stay = |stay: Stay| (stay.since, stay.position);
                    (stay(axis.stay), stay(axis.quiet), axis.last)
                };
                assert_eq!(state(&axis), state(&whole), "scenario {scenario}");
            }
        }
        for (short, cycles) in short.into_iter().zip(cycles) {
            assert!(short > cycles / 10, "{short} of {cycles}");
        }
    }

    /// When an axis of one sample in a millisecond, a window of 100 counts and a settle time of 100 ms stands.
    fn stands_at(positions: impl Iterator<Item = i32>) -> Option<u64> {
        let settle = Duration::from_millis(100);
        let bounds = Bounds::new(100, None, settle, Duration::from_millis(1), None);
        let mut axis = Standstill::default();
        (0..).zip(positions).find_map(|(ms, position)| {
            axis.update(Duration::from_millis(ms), position, None, &bounds);
            axis.is_standing().then_some(ms)
        })
    }

    #[test]
    fn an_axis_that_leaves_its_first_place_has_stood_around_a_later_one() {
        // It comes to rest at 90, and settles to 110.
        let way = [0, 30, 60].into_iter().chain([90; 60]);
        let settled = way.chain([95, 100, 105]).chain([110; 200]);
        assert_eq!(stands_at(settled), Some(101));
        // The same the other way, from a swing.
        let way = [0, -60, -30, 20, -60].into_iter().chain([-90; 60]);
        assert_eq!(stands_at(way.chain([-110; 200])), Some(101));
        // What leads away from each of them begins anew.
        let away = [0, 30, 60].into_iter().chain([90; 60]);
        assert_eq!(stands_at(away.chain([500; 200])), Some(163));
        let away = [0].into_iter().chain([60; 50]).chain([200]);
        assert_eq!(stands_at(away.chain([80; 200])), Some(152));
    }

    #[test]
    fn an_axis_that_creeps_through_its_window_within_the_settle_time_does_not_stand() {
        let creep = |hundredths: i32| (0..10_000).map(move |ms| ms * hundredths / 100);
        for hundredths in [103, -103, 150, 199, -250, 1_000, -4_000] {
            assert_eq!(stands_at(creep(hundredths)), None, "{hundredths}");
        }
        // From peak to peak it goes further than the window on either side.
        let swing = |far: f64| (0..10_000).map(move |ms| (far * f64::from(ms).sin()) as i32);
        assert_eq!(stands_at(swing(150.0)), None);
        assert!(stands_at(creep(99)).is_some() && stands_at(swing(49.0)).is_some());
    }

    #[test]
    fn a_606ch_that_shows_0_takes_no_axis_for_standing_that_is_faster_than_by_its_window() {
        let settle = Duration::from_millis(100);
        // One count in 12 ms goes further than 7 in 100 ms.
        for (window, threshold) in [(0, Some(0)), (3, Some(0)), (7, Some(0)), (100, None)] {
            let bounds = Bounds::new(window, threshold, settle, Duration::from_millis(1), None);
            let way = (0..10_000).map(|ms: i32| ms * (window as i32 + 2) / 100);
            let mut axis = Standstill::default();
            for (ms, position) in (0..).zip(way) {
                axis.update(Duration::from_millis(ms), position, Some(0), &bounds);
                assert!(!axis.is_standing(), "{window} {threshold:?}: {ms} ms");
            }
        }
        // One that turns round where 606Ch may be too coarse to show its speed.
        let bounds = Bounds::new(100, None, settle, Duration::from_millis(1), None);
        let mut axis = Standstill::default();
        for ms in 0..2_000_u32 {
            let position = 400.0 * (f64::from(ms) / 20.0).cos();
            axis.update(
                Duration::from_millis(ms.into()),
                position as i32,
                Some(0),
                &bounds,
            );
            assert!(!axis.is_standing(), "{ms} ms");
        }
    }

    #[test]
    fn after_a_long_loss_an_axis_has_to_stand_for_the_whole_time_again() {
        let settle = Duration::from_millis(100);
        let bounds = Bounds::new(10, None, settle, Duration::from_millis(1), None);
        let stands_after = |lost: u64| {
            let mut axis = Standstill::default();
            let ms = Duration::from_millis;
            for at in 0..90 {
                axis.update(ms(at), 0, None, &bounds);
            }
            for at in 90..90 + lost {
                axis.note_loss(ms(at), &bounds);
            }
            let mut after = 90 + lost..1_000;
            after.find(|&at| {
                axis.update(ms(at), 0, None, &bounds);
                axis.is_standing()
            })
        };
        // A quarter of the settle time counts of a short loss. Nothing counts before a long one, which shows after three eighths.
        assert_eq!(stands_after(20), Some(110));
        assert_eq!(stands_after(60), Some(127 + 100));
    }

    /// The bound of a long loss itself is a short one: three eighths of the settle time.
    #[test]
    fn a_loss_of_three_eighths_of_the_settle_time_is_short() {
        let us = Duration::from_micros;
        let bounds = bounds(None);
        let stands_after = |loss: Duration| {
            let mut axis = Standstill::default();
            for at in 0..=50 {
                axis.update(us(1_000 * at), 0, None, &bounds);
            }
            let back = us(50_000) + loss;
            axis.note_loss(back, &bounds);
            (0..200_000).step_by(500).find(|&later| {
                axis.update(back + us(later), 0, None, &bounds);
                axis.is_standing()
            })
        };
        // A quarter of it counts.
        assert_eq!(stands_after(us(37_500)), Some(25_000));
        let a_little_more = us(37_500) + Duration::from_nanos(1);
        assert_eq!(stands_after(a_little_more), Some(100_000));
        // Of an axis that stands, none is long.
        let mut axis = Standstill::default();
        for at in 0..=100 {
            axis.update(us(1_000 * at), 0, None, &bounds);
        }
        axis.note_loss(us(300_000), &bounds);
        assert!(axis.is_standing() && axis.stands_since(us(300_000), us(200_000), &bounds));
    }

    #[test]
    fn a_later_reference_begins_further_than_a_quarter_of_the_window_from_the_one_before() {
        let to = |first: i32| [0].into_iter().chain([first; 50]).chain([101; 200]);
        assert_eq!(
            stands_at(to(25)),
            Some(151),
            "none but the first, which it leaves"
        );
        assert_eq!(
            stands_at(to(26)),
            Some(101),
            "it has stayed around this one"
        );
        assert_eq!(stands_at(to(-25)), Some(151));
        // The last of three is replaced by newer ones.
        let swings = [0, 26, 52, 78]
            .into_iter()
            .chain([50; 40])
            .chain([101; 200]);
        assert_eq!(stands_at(swings), Some(101));
        let swings = [0, 26, 52, 78]
            .into_iter()
            .chain([50; 40])
            .chain([130; 200]);
        assert_eq!(stands_at(swings), Some(102));
        let swings = [0, 26, 52, 78]
            .into_iter()
            .chain([-50; 40])
            .chain([-110; 200]);
        assert_eq!(stands_at(swings), Some(104));
    }

    /// With 606Ch: an eighth of the window for an eighth of the settle time.
    #[test]
    fn a_velocity_within_its_threshold_shows_a_standstill_earlier() {
        let stands_at = |positions: [i32; 2], velocity: i32| {
            let settle = Duration::from_millis(80);
            let bounds = Bounds::new(80, Some(3), settle, Duration::from_millis(1), None);
            let mut axis = Standstill::default();
            (0..1_000).find(|&ms| {
                let position = positions[ms as usize % 2];
                axis.update(Duration::from_millis(ms), position, Some(velocity), &bounds);
                axis.is_standing()
            })
        };
        assert_eq!(stands_at([0, 0], 0), Some(10));
        assert_eq!(stands_at([0, 10], 3), Some(10));
        assert_eq!(stands_at([0, -10], -3), Some(10));
        assert_eq!(stands_at([0, 11], 3), Some(80));
        assert_eq!(stands_at([0, 0], 4), Some(80));
        assert_eq!(stands_at([0, 0], -4), Some(80));
        assert_eq!(stands_at([0, 81], 0), None);
    }

    #[test]
    fn an_axis_is_under_way_from_its_first_motion_to_its_standstill() {
        let bounds = bounds(None);
        let mut axis = Standstill::default();
        let mut ms = 0;
        let mut at = |axis: &mut Standstill, position: i32| {
            axis.update(Duration::from_millis(ms), position, None, &bounds);
            ms += 1;
            axis.is_under_way()
        };
        assert!(!at(&mut axis, 0) && !at(&mut axis, 10), "within its window");
        assert!(
            at(&mut axis, 11) && at(&mut axis, 11),
            "it came from another place"
        );
        for _ in 0..100 {
            at(&mut axis, 11);
        }
        assert!(axis.is_standing() && !axis.is_under_way());
        assert!(at(&mut axis, 22));
        axis.begin_anew();
        assert!(!axis.is_under_way() && !axis.is_standing());
        assert!(!at(&mut axis, 40), "nothing is known of before");
    }

    #[test]
    fn a_standstill_counts_from_when_it_is_asked_for() {
        let ms = Duration::from_millis;
        let bounds = Bounds::new(10, Some(0), ms(100), ms(1), None);
        let stood = |velocity: Option<i32>, since: u64| {
            let mut axis = Standstill::default();
            for at in 0..=200 {
                axis.update(ms(at), 0, velocity, &bounds);
            }
            let (now, since) = (ms(200), ms(since));
            (
                axis.stands_since(now, since, &bounds),
                axis.steady_since(now, since, &bounds),
            )
        };
        assert_eq!(stood(None, 100), (true, true));
        assert_eq!(stood(None, 101), (false, false));
        // 606Ch shows it after an eighth: 12.5 ms.
        assert_eq!(stood(Some(0), 101), (true, false));
        assert_eq!(stood(Some(0), 187), (true, false));
        assert_eq!(stood(Some(0), 188), (false, false));
    }

    #[test]
    fn the_turn_of_a_modulo_axis_has_a_length() {
        let degrees = PositionRange { min: 0, max: 3_599 };
        assert_eq!(bounds(Some(degrees)).turn_length(), Some(3_600));
        assert_eq!(bounds(None).turn_length(), None);
    }

    /// What is told of an axis that does not come to rest: its extremes in the settle time that runs and in the one before.
    #[test]
    fn what_was_seen_lately_is_of_two_settle_times_at_most() {
        let bounds = bounds(None);
        let mut seen = LastSeen::default();
        let mut at = |ms: u64, position: i32, velocity: Option<i32>| {
            let sample = Sample {
                statusword: crate::ds402::Statusword::empty(),
                mode: crate::ds402::Mode::None,
                position,
                velocity,
                error_code: None,
            };
            seen.update(Duration::from_millis(ms), &sample, &bounds);
            let unrest = seen.unrest(&bounds);
            (unrest.positions, unrest.velocities)
        };
        assert_eq!(at(0, 40, None), ((40, 40), None));
        assert_eq!(at(50, -90, Some(7)), ((-90, 40), Some((7, 7, 0))));
        assert_eq!(at(99, 0, Some(-3)), ((-90, 40), Some((-3, 7, 0))));
        assert_eq!(at(100, 5, Some(1)), ((-90, 40), Some((-3, 7, 0))));
        assert_eq!(at(199, 6, None), ((-90, 40), Some((-3, 7, 0))));
        assert_eq!(at(200, 7, None), ((5, 7), Some((1, 1, 0))));
        assert_eq!(at(300, 8, None), ((7, 8), None));
        let unrest = seen.unrest(&bounds);
        assert_eq!((unrest.window, unrest.settle_ms), (10, 100));
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
