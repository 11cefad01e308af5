//! When a device's mailbox is looked at while its answer is due: by how long it took for the answer before.
//!
//! Each look costs the line a datagram, each reading of an empty mailbox one as long as the mailbox.

use core::time::Duration;

/// Pauses between two looks grow with the time waited, from this one on.
const SHORTEST_PAUSE: Duration = Duration::from_micros(50);
/// Who answers within this time is read at once.
const AT_ONCE: Duration = Duration::from_micros(100);
/// No first look is later: the answer before may have been an exception.
const LATEST_FIRST_LOOK: Duration = Duration::from_millis(4);

/// How long a device takes for its answers.
#[derive(Debug, Default)]
pub(super) struct Pace {
    /// The answer before took so long.
    last: Duration,
}

impl Pace {
    /// Whether its answer is expected to be there as soon as the request is.
    pub(super) fn is_quick(&self) -> bool {
        self.last <= AT_ONCE
    }

    pub(super) fn answered_after(&mut self, time: Duration) {
        self.last = time;
    }

    /// How long after the request the first look is worth its frame. It is somewhat before the answer is expected, so that an
    /// estimate that was too long comes down.
    pub(super) fn first_look(&self) -> Duration {
        (self.last * 3 / 4).min(LATEST_FIRST_LOOK)
    }

    /// The pause before the next look, after this time.
    pub(super) fn pause(&self, waited: Duration, longest: Duration) -> Duration {
        (waited / 16).max(SHORTEST_PAUSE).min(longest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn the_first_look_comes_before_the_answer_is_expected_and_never_late() {
        let mut pace = Pace::default();
        assert!(pace.is_quick());
        pace.answered_after(2 * MS);
        assert!(!pace.is_quick());
        assert_eq!(pace.first_look(), MS * 3 / 2);
        pace.answered_after(Duration::from_secs(3));
        assert_eq!(pace.first_look(), 4 * MS);
    }

    #[test]
    fn a_device_that_becomes_quick_is_soon_found_out() {
        let mut pace = Pace::default();
        pace.answered_after(2 * MS);
        let mut answers = 0;
        while !pace.is_quick() {
            // It has answered by the first look.
            pace.answered_after(pace.first_look());
            answers += 1;
        }
        assert!(answers <= 12, "{answers}");
    }

    #[test]
    fn pauses_grow_with_the_time_waited_up_to_the_longest() {
        let pace = Pace::default();
        let longest = MS / 4;
        assert_eq!(pace.pause(Duration::ZERO, longest), SHORTEST_PAUSE);
        assert_eq!(pace.pause(2 * MS, longest), MS / 8);
        assert_eq!(pace.pause(100 * MS, longest), longest);
    }
}
