//! Times that are left until something is due (pure). They stay at 0 once they are over, so that two that are over are equal.

use core::time::Duration;

/// A time in nanoseconds; of more than 584 years, those.
#[inline]
pub(crate) const fn nanoseconds(time: Duration) -> u64 {
    let seconds = time.as_secs().saturating_mul(1_000_000_000);
    seconds.saturating_add(time.subsec_nanos() as u64)
}

/// How much time passed, in nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub(crate) struct Elapsed(pub u64);

impl Elapsed {
    /// Of the time between two samples no more than a quarter of a time counts for it: five samples are needed at least, and those
    /// before and after a stall are no proof of what was between them.
    #[inline]
    pub const fn of_samples(self, time: Duration) -> Self {
        let most = nanoseconds(time) / 4;
        Self(if self.0 < most { self.0 } else { most })
    }
}

/// How long it is until something is due. It counts down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub(crate) struct Timer(u64);

impl Timer {
    pub const OVER: Self = Self(0);

    #[inline]
    pub const fn new(time: Duration) -> Self {
        Self(nanoseconds(time))
    }

    /// The same, to begin this much later.
    #[inline]
    pub const fn later(self, time: Elapsed) -> Self {
        Self(self.0.saturating_add(time.0))
    }

    /// The same, to end this much sooner.
    #[inline]
    pub const fn sooner(self, time: Elapsed) -> Self {
        Self(self.0.saturating_sub(time.0))
    }

    #[inline]
    pub const fn pass(&mut self, elapsed: Elapsed) {
        *self = self.sooner(elapsed);
    }

    pub const fn left(self) -> Elapsed {
        Elapsed(self.0)
    }

    pub const fn longer(self, other: Self) -> Self {
        if self.0 < other.0 { other } else { self }
    }

    #[inline]
    pub const fn is_over(self) -> bool {
        self.0 == 0
    }

    /// When somebody is to look at it again: never, once it is over.
    #[inline]
    pub const fn due(self) -> Due {
        if self.is_over() {
            Due::NEVER
        } else {
            Due(self.0)
        }
    }
}

/// Whether the drive has surely seen what was sent. Its time begins when that is known to have been delivered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct UntilSeen(Option<Timer>);

impl UntilSeen {
    pub const UNDELIVERED: Self = Self(None);
    pub const SEEN: Self = Self(Some(Timer::OVER));

    /// One cycle. `time`: how long the drive takes from now on.
    #[inline]
    pub const fn update(&mut self, delivered: bool, elapsed: Elapsed, time: Timer) {
        match &mut self.0 {
            Some(left) => left.pass(elapsed),
            None if delivered => self.0 = Some(time),
            None => {}
        }
    }

    pub const fn is_delivered(self) -> bool {
        self.0.is_some()
    }

    #[inline]
    pub const fn is_seen(self) -> bool {
        matches!(self.0, Some(left) if left.is_over())
    }

    /// When it is seen. A delivery is an input.
    pub const fn due(self) -> Due {
        match self.0 {
            Some(left) => left.due(),
            None => Due::NEVER,
        }
    }
}

/// Whether something has lasted for a time, in time and in samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub(crate) struct Lasting(Option<Timer>);

impl Lasting {
    pub const NOT: Self = Self(None);

    /// Takes in a sample that shows it, or does not. Whether it has lasted.
    pub fn update(&mut self, holds: bool, time: Duration, elapsed: Elapsed) -> bool {
        self.0 = match self.0 {
            _ if !holds => None,
            None => Some(Timer::new(time)),
            Some(mut left) => {
                left.pass(elapsed.of_samples(time));
                Some(left)
            }
        };
        self.has_lasted()
    }

    /// It is to last for this time from now on.
    pub fn restart(&mut self, time: Duration) {
        self.0 = self.0.map(|_| Timer::new(time));
    }

    /// Whether the last sample showed it.
    pub const fn holds(self) -> bool {
        self.0.is_some()
    }

    pub const fn has_lasted(self) -> bool {
        matches!(self.0, Some(left) if left.is_over())
    }

    /// In the next cycle, while it counts.
    pub const fn due(self) -> Due {
        Due::next_if(matches!(self.0, Some(left) if !left.is_over()))
    }
}

/// In how many nanoseconds a machine has something to do that no input brings about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Due(u64);

impl Due {
    /// Nothing happens without an input.
    pub const NEVER: Self = Self(u64::MAX);
    /// Each cycle counts.
    pub const NEXT: Self = Self(0);

    #[inline]
    pub const fn sooner(self, other: Self) -> Self {
        if self.0 < other.0 { self } else { other }
    }

    /// In the next cycle, if this holds.
    #[inline]
    pub const fn next_if(holds: bool) -> Self {
        if holds { Self::NEXT } else { Self::NEVER }
    }

    /// At what time, from this one on.
    #[inline]
    pub const fn after(self, nanoseconds: u64) -> u64 {
        nanoseconds.saturating_add(self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(time: u64) -> Duration {
        Duration::from_millis(time)
    }

    #[test]
    fn a_timer_counts_down_and_two_that_are_over_are_equal() {
        let mut timer = Timer::new(ms(3));
        timer.pass(Elapsed(1_000_000));
        assert!(!timer.is_over());
        assert_eq!(timer.due(), Due(2_000_000));
        timer.pass(Elapsed(5_000_000));
        assert!(timer.is_over());
        assert_eq!(timer, Timer::OVER);
        assert_eq!(timer.due(), Due::NEVER);
    }

    #[test]
    fn the_soonest_of_what_is_due_counts() {
        let soon = Timer::new(ms(1)).due();
        assert_eq!(soon.sooner(Due::NEVER), soon);
        assert_eq!(soon.sooner(Due::NEXT), Due::NEXT);
        assert_eq!(soon.after(2), 1_000_002);
        assert_eq!(Due::NEVER.after(2), u64::MAX);
    }

    #[test]
    fn a_stall_counts_for_no_more_than_a_quarter() {
        let counted = |millis: u64| Elapsed(millis * 1_000_000).of_samples(ms(100));
        assert_eq!(counted(24), Elapsed(24_000_000));
        assert_eq!(counted(26), Elapsed(25_000_000));
        assert_eq!(counted(10_000), Elapsed(25_000_000));
    }

    #[test]
    fn what_lasts_is_shown_by_five_samples_and_without_a_break() {
        let mut lasting = Lasting::NOT;
        let second = Elapsed(1_000_000_000);
        let mut show = |holds| lasting.update(holds, ms(100), second);
        assert_eq!([true; 5].map(&mut show), [false, false, false, false, true]);
        assert!(show(true) && !show(false));
        assert_eq!([true; 5].map(show), [false, false, false, false, true]);
    }

    #[test]
    fn a_time_that_does_not_fit_is_the_longest() {
        assert_eq!(nanoseconds(Duration::MAX), u64::MAX);
        assert_eq!(nanoseconds(Duration::new(2, 3)), 2_000_000_003);
    }
}
