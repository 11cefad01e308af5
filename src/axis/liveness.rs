//! Whether the program is alive: it feeds a [`Liveness`], and the bus thread halts every axis when that stops.

use core::{
    sync::atomic::{AtomicU64, Ordering},
    time::Duration,
};
use std::sync::Arc;

/// Fed by the program. When it is not fed for its time, or all clones are dropped unfed, every axis halts.
///
/// ```
/// use core::time::Duration;
/// use servocrab::axis::Liveness;
/// let (live, mut watch) = Liveness::new(Duration::from_millis(200));
/// assert!(!watch.expired(Duration::from_secs(1)), "the time counts from the first look");
/// live.feed();
/// assert!(!watch.expired(Duration::from_millis(1150)));
/// assert!(watch.expired(Duration::from_millis(1351)));
/// ```
#[derive(Debug, Clone)]
pub struct Liveness {
    fed: Arc<AtomicU64>,
}

impl Liveness {
    /// A pair: one end for the program, one for whoever owns the cycle.
    #[must_use]
    pub fn new(timeout: Duration) -> (Self, LivenessWatch) {
        let fed = Arc::new(AtomicU64::new(0));
        let watch = LivenessWatch {
            fed: Arc::clone(&fed),
            timeout,
            seen: None,
        };
        (Self { fed }, watch)
    }

    /// Says that the program is alive.
    pub fn feed(&self) {
        self.fed.fetch_add(1, Ordering::Relaxed);
    }
}

/// The end that is looked at once a cycle.
#[derive(Debug)]
pub struct LivenessWatch {
    fed: Arc<AtomicU64>,
    timeout: Duration,
    /// How often it was fed, and when that was first seen.
    seen: Option<(u64, Duration)>,
}

impl LivenessWatch {
    /// Whether the program has not fed it for longer than the timeout: then every axis is to be halted in this cycle.
    /// It stays true until it is fed again; what was halted stays halted until it is resumed.
    pub fn expired(&mut self, now: Duration) -> bool {
        let fed = self.fed.load(Ordering::Relaxed);
        match self.seen {
            Some((seen, since)) if seen == fed => now.saturating_sub(since) > self.timeout,
            _ => {
                self.seen = Some((fed, now));
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_stops_feeding_is_noticed_once_its_time_is_over_and_not_before() {
        let (live, mut watch) = Liveness::new(Duration::from_millis(5));
        let expired: Vec<bool> = (0..20)
            .map(|ms| {
                if ms < 4 || ms == 15 {
                    live.feed();
                }
                watch.expired(Duration::from_millis(ms))
            })
            .collect();
        let noticed: Vec<usize> = (0..20).filter(|ms| expired[*ms]).collect();
        assert_eq!(
            noticed,
            [9, 10, 11, 12, 13, 14],
            "last fed at 3 ms, and again at 15 ms"
        );
    }
}
