//! The time between the end of a cycle and the start of the next one, in which acyclic frames may be on their way.

use std::time::Duration;

/// What a byte takes on 100 Mbit/s (IEEE 802.3, 100BASE-TX), the speed of an EtherCAT segment.
const BYTE: Duration = Duration::from_nanos(80);
/// Preamble and start of the frame, checksum, gap to the next one (IEEE 802.3).
const AROUND: usize = 8 + 4 + 12;

/// A gap, as seen from within it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gap {
    /// When the next cycle starts.
    pub(super) end: Duration,
    /// How long a frame is away, as measured.
    pub(super) round_trip: Duration,
    /// What a frame alone on the wire is reckoned with at the most: the longest ones would never go between short cycles.
    pub(super) longest_alone: Duration,
}

impl Gap {
    /// Whether a frame that is sent now is back before the gap ends, when the wire is busy until then and takes this long for it.
    pub(super) fn has_room(&self, now: Duration, busy_until: Duration, takes: Duration) -> bool {
        let takes = if busy_until <= now {
            takes.min(self.longest_alone)
        } else {
            takes
        };
        busy_until.max(now) + takes + self.round_trip <= self.end
    }
}

/// How long the wire is taken by a frame of this length.
pub(super) fn on_wire(length: usize) -> Duration {
    let bytes = length.max(crate::link::SHORTEST_FRAME) + AROUND;
    BYTE * u32::try_from(bytes).unwrap_or(u32::MAX)
}

/// How long frames are away: the longest of late.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RoundTrip(Duration);

impl RoundTrip {
    /// Takes in what the frames of one cycle took. A long one counts for some hundred cycles.
    pub(super) fn observe(&mut self, took: Duration) {
        self.0 = took.max(self.0 - self.0 / 64);
    }

    /// What is reckoned with. Not more than the end of every cycle leaves, an eighth of the period, so that mailboxes are served
    /// whatever was measured: a frame that is late then is counted.
    pub(super) fn reckoned(self, eighth: Duration) -> Duration {
        self.0.min(eighth)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{Gap, RoundTrip, on_wire};

    const fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn a_frame_has_room_when_it_is_back_before_the_next_cycle() {
        let gap = Gap {
            end: us(1000),
            round_trip: us(50),
            longest_alone: us(125),
        };
        // 84 bytes with all that is around the shortest frame: 6.72 µs.
        assert!(gap.has_room(us(943), us(0), on_wire(14)));
        assert!(!gap.has_room(us(944), us(0), on_wire(60)));
        // 1538 bytes with all that is around the longest one: 123.04 µs.
        assert!(gap.has_room(us(826), us(0), on_wire(1514)));
        assert!(!gap.has_room(us(827), us(0), on_wire(1514)));
        assert!(!gap.has_room(us(820), us(828), on_wire(1514)));
    }

    #[test]
    fn between_cycles_shorter_than_a_frame_one_goes_alone() {
        let gap = Gap {
            end: us(100),
            round_trip: us(12),
            longest_alone: us(12),
        };
        assert!(gap.has_room(us(50), us(0), on_wire(1514)));
        assert!(!gap.has_room(us(50), us(57), on_wire(1514)));
        assert!(!gap.has_room(us(80), us(0), on_wire(1514)));
    }

    #[test]
    fn a_long_round_trip_is_reckoned_with_for_a_while_and_never_with_more_than_is_left_of_every_cycle()
     {
        let mut round_trip = RoundTrip::default();
        round_trip.observe(us(80));
        round_trip.observe(us(20));
        assert!(round_trip.reckoned(us(125)) > us(75));
        for _ in 0..300 {
            round_trip.observe(us(20));
        }
        assert_eq!(round_trip.reckoned(us(125)), us(20));
        round_trip.observe(us(700));
        assert_eq!(round_trip.reckoned(us(125)), us(125));
    }
}
