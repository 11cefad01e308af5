//! A drive's processor and SYNC0: its cycles go along with the pulses, and one that insists looks at each pulse whether
//! outputs came in time.

use core::time::Duration;

use crate::al::code;
use crate::description::ClockDemand;

/// What the processor knows of SYNC0.
#[derive(Clone, Debug, Default)]
pub(super) struct Synchronisation {
    /// OP was entered with SYNC0.
    on: bool,
    /// Pulses until the next cycle.
    pulses_left: u32,
    /// Cycles that the last pulse has brought and that were not done yet.
    cycles_left: u32,
    /// Time between pulses, while they are followed.
    between_pulses: Option<Duration>,
    overdue: bool,
    /// Pulses in a row with outputs in time.
    locked: u32,
    /// Up by three, down by one.
    errors: u32,
    mistakes: u64,
    /// When the outputs of the last pulse came, in system time.
    outputs_at: Option<u64>,
}

impl Synchronisation {
    /// OP was entered with SYNC0.
    pub(super) fn enter(&mut self) {
        self.on = true;
        self.errors = 0;
    }

    /// OP was left, or was not reached.
    pub(super) fn leave(&mut self) {
        *self = Self {
            mistakes: self.mistakes,
            ..Self::default()
        };
    }

    /// Whether OP depends on SYNC0.
    pub(super) fn is_on(&self) -> bool {
        self.on
    }

    /// Pulses without outputs in time.
    pub(super) fn mistakes(&self) -> u64 {
        self.mistakes
    }

    /// Whether the processor's cycle has come without the pulse that should have brought it.
    pub(super) fn is_overdue(&self) -> bool {
        self.overdue
    }

    /// Whether outputs came in time for as many pulses as the drive wants to see.
    pub(super) fn has_locked(&self, demand: ClockDemand) -> bool {
        self.locked >= demand.lock_pulses
    }

    /// Whether there were too many mistakes; a limit of zero means that nobody counts.
    pub(super) fn exceeds(&self, limit: u16) -> bool {
        limit > 0 && self.errors > limit.into()
    }

    /// A pulse; whether it brings a cycle of the processor, which takes one each `period`, in step with the pulses.
    pub(super) fn follow(&mut self, cycle_ns: u32, period: Duration) -> bool {
        let between = Duration::from_nanos(cycle_ns.into());
        self.between_pulses = Some(between);
        if self.pulses_left > 1 {
            self.pulses_left -= 1;
            return false;
        }
        self.pulses_left = ratio(period, between);
        self.cycles_left = ratio(between, period);
        true
    }

    /// A cycle of the processor begins; how long until the next, unless a pulse brings it before.
    pub(super) fn cycle(&mut self, period: Duration) -> Duration {
        let Some(between) = self.between_pulses else {
            return period;
        };
        self.overdue = self.cycles_left == 0;
        self.cycles_left = self.cycles_left.saturating_sub(1);
        if self.cycles_left > 0 {
            period
        } else {
            between.max(period) + period / 2
        }
    }

    /// Looks at a pulse, in system time: the reason to complain, if there is one.
    pub(super) fn judge(
        &mut self,
        demand: ClockDemand,
        pulse: u64,
        cycle_ns: u32,
        outputs_at: Option<u64>,
    ) -> Option<u16> {
        let new = outputs_at.filter(|_| outputs_at != self.outputs_at);
        self.outputs_at = outputs_at;
        let complaint = match new {
            None => Some(code::SYNC_TIMEOUT),
            Some(at) => {
                let before = i128::from(pulse) - i128::from(at);
                let least = demand.before.as_nanos().cast_signed();
                let most = i128::from(cycle_ns) - demand.after.as_nanos().cast_signed();
                (before < least || before > most).then_some(code::SYNC_LOST)
            }
        };
        if complaint.is_none() {
            self.locked = self.locked.saturating_add(1);
            self.errors = self.errors.saturating_sub(1);
        } else {
            self.locked = 0;
            self.errors = self.errors.saturating_add(3);
            self.mistakes += 1;
        }
        complaint
    }
}

/// How many of one there are in the other, at least one.
fn ratio(of: Duration, each: Duration) -> u32 {
    let each = each.as_nanos().max(1);
    u32::try_from((of.as_nanos() + each / 2) / each)
        .unwrap_or(u32::MAX)
        .max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEMAND: ClockDemand = ClockDemand {
        before: Duration::from_micros(100),
        after: Duration::from_micros(50),
        lock_pulses: 3,
        fault: None,
    };

    /// What it says of outputs that came so many microseconds after the pulse before, for a pulse each millisecond.
    fn judged(sync: &mut Synchronisation, number: u64, after_us: Option<u64>) -> Option<u16> {
        let before = number * 1_000_000;
        let at = after_us.map(|after| before + after * 1_000);
        sync.judge(DEMAND, before + 1_000_000, 1_000_000, at)
    }

    #[test]
    fn outputs_too_late_too_early_and_none_are_told_apart() {
        let mut sync = Synchronisation::default();
        assert_eq!(judged(&mut sync, 1, Some(500)), None);
        assert_eq!(judged(&mut sync, 2, Some(901)), Some(0x001A));
        assert_eq!(judged(&mut sync, 3, Some(49)), Some(0x001A));
        assert_eq!(judged(&mut sync, 4, None), Some(0x0034));
        assert_eq!(sync.mistakes(), 3);
    }

    #[test]
    fn one_mistake_is_forgiven_and_two_in_a_row_are_not() {
        let mut sync = Synchronisation::default();
        judged(&mut sync, 1, None);
        assert!(!sync.exceeds(4));
        for number in 2..5 {
            judged(&mut sync, number, Some(500));
        }
        judged(&mut sync, 5, None);
        assert!(!sync.exceeds(4));
        judged(&mut sync, 6, None);
        assert!(sync.exceeds(4));
        assert!(!sync.exceeds(0));
    }

    #[test]
    fn the_lock_needs_its_pulses_in_a_row() {
        let mut sync = Synchronisation::default();
        judged(&mut sync, 1, Some(500));
        judged(&mut sync, 2, Some(500));
        judged(&mut sync, 3, None);
        judged(&mut sync, 4, Some(500));
        judged(&mut sync, 5, Some(500));
        assert!(!sync.has_locked(DEMAND));
        judged(&mut sync, 6, Some(500));
        assert!(sync.has_locked(DEMAND));
    }

    #[test]
    fn the_processor_goes_along_with_faster_and_slower_pulses() {
        let ms = Duration::from_millis(1);
        let mut sync = Synchronisation::default();
        // Pulses each 2 ms: two cycles for each.
        assert!(sync.follow(2_000_000, ms));
        assert_eq!(sync.cycle(ms), ms);
        assert_eq!(sync.cycle(ms), 2 * ms + ms / 2);
        assert!(!sync.is_overdue());
        // The next pulse did not come.
        sync.cycle(ms);
        assert!(sync.is_overdue());
        // Pulses each 250 us: a cycle at each fourth.
        let mut sync = Synchronisation::default();
        let cycles = (0..8).map(|_| sync.follow(250_000, ms));
        let brought: Vec<_> = cycles.collect();
        assert_eq!(
            brought,
            [true, false, false, false, true, false, false, false]
        );
    }
}
