//! The process-data watchdog: outputs that stop coming are noticed after the time that the registers give.

use core::time::Duration;

/// State of the process-data watchdog of one ESC.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Watchdog {
    /// Last completed write to a sync manager with the trigger bit.
    last_trigger: Option<Duration>,
    /// The time ran out since the last trigger, or there never was one.
    running: bool,
}

impl Watchdog {
    /// Outputs came.
    pub(crate) fn trigger(&mut self, now: Duration) {
        self.last_trigger = Some(now);
        self.running = true;
    }

    /// Whether outputs come often enough (0440h bit 0).
    pub(crate) fn is_running(self) -> bool {
        self.running
    }

    /// When it expires unless it is triggered before; `None` when it is off or has expired.
    pub(crate) fn deadline(self, timeout: Option<Duration>) -> Option<Duration> {
        if self.running {
            self.last_trigger?.checked_add(timeout?)
        } else {
            None
        }
    }

    /// Looks at the time; `true` at the moment of expiry.
    pub(crate) fn check(&mut self, timeout: Option<Duration>, now: Duration) -> bool {
        let expired = self
            .deadline(timeout)
            .is_some_and(|deadline| now >= deadline);
        if expired {
            self.running = false;
        }
        expired
    }
}

/// Time of the watchdog: (divider + 2) × 40 ns per tick; `None` for zero ticks, which switch it off (ET1100 data sheet,
/// registers 0400h and 0420h: 09C2h gives 100 µs).
pub(crate) fn timeout(divider: u16, ticks: u16) -> Option<Duration> {
    let nanoseconds = (u64::from(divider) + 2) * 40 * u64::from(ticks);
    (nanoseconds > 0).then(|| Duration::from_nanos(nanoseconds))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_registers_give_100_ms() {
        assert_eq!(timeout(0x09C2, 0x03E8), Some(Duration::from_millis(100)));
        assert_eq!(timeout(0x09C2, 0), None);
    }

    #[test]
    fn it_expires_once_after_its_time() {
        let time = Some(Duration::from_millis(100));
        let mut watchdog = Watchdog::default();
        assert!(!watchdog.check(time, Duration::from_secs(1)));
        watchdog.trigger(Duration::from_secs(1));
        assert!(!watchdog.check(time, Duration::from_millis(1099)));
        assert!(watchdog.check(time, Duration::from_millis(1100)));
        assert!(!watchdog.is_running());
        assert!(!watchdog.check(time, Duration::from_millis(1200)));
    }

    #[test]
    fn a_watchdog_that_is_off_never_expires() {
        let mut watchdog = Watchdog::default();
        watchdog.trigger(Duration::ZERO);
        assert!(!watchdog.check(None, Duration::from_secs(1000)));
    }
}
