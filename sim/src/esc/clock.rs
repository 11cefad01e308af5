//! The distributed clock of a device: a local time from a crystal of its own, receive times, and the control loop that
//! makes the local copy of the system time follow the reference clock. Times are nanoseconds.
//! Source: ESC data sheet, section I "Technology", 9.1.

use core::time::Duration;

/// Binary places of a nanosecond that are kept, so that corrections of less than one do not get lost.
const PLACES: u32 = 32;
/// One nanosecond in each.
const ONE: i128 = 1 << PLACES;
/// The largest step towards the reference clock on one received time.
const LARGEST_STEP: i64 = 32;
/// The control loop changes the speed by at most this much, as it can with the bandwidth of a reset.
const FASTEST: i64 = (ONE / 50) as i64;

/// Where the device is in the segment, as far as the times of passing frames depend on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Place {
    /// From the MainDevice to port 0.
    pub(crate) arrival: u64,
    /// From the arrival at port 0 to the arrival at each other port of the frame that comes back there; `None` for a port
    /// without a neighbour. The first is always `None`.
    pub(crate) back: [Option<u64>; 4],
}

impl Place {
    /// Time of the simulation at which a frame that left the MainDevice at `now` is at port 0.
    pub(crate) fn at_port_0(self, now: Duration) -> u64 {
        nanoseconds(now).wrapping_add(self.arrival)
    }
}

/// Nanoseconds of the simulation's time.
pub(crate) fn nanoseconds(now: Duration) -> u64 {
    // 64 bits of nanoseconds last for 584 years.
    now.as_nanos() as u64
}

/// Settings of the control loop: registers 0930h, 0934h and 0935h.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ControlLoop {
    /// Speed counter start: the larger, the smaller the bandwidth.
    pub(crate) start: u16,
    /// Depth of the filter of the system time difference.
    pub(crate) difference_depth: u8,
    /// Depth of the filter of the clock period's deviation.
    pub(crate) speed_depth: u8,
}

/// The local clock.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Clock {
    /// What it showed at `since`, with its binary places.
    shown: i128,
    since: u64,
    /// How much faster the crystal is than the simulation's time: this many parts of `ONE`.
    drift: i64,
    /// What the control loop adds to that, in parts of `ONE` · 2^16.
    speed: i64,
    /// Mean of the differences, with eight binary places; nothing after a reset.
    mean: Option<i64>,
    /// When the reference time came last, how far the local time was ahead, and the step that was taken then.
    last: Option<(u64, i64, i64)>,
}

impl Clock {
    /// A clock that shows `start` nanoseconds at time zero of the simulation, with an exact crystal.
    pub(crate) fn new(start: u64) -> Self {
        Self {
            shown: i128::from(start) << PLACES,
            ..Self::default()
        }
    }

    /// Gives it a crystal that is this much too fast, in parts per billion.
    pub(crate) fn set_drift(&mut self, parts_per_billion: i32, now: u64) {
        self.move_on(now);
        self.drift = (i128::from(parts_per_billion) * ONE / 1_000_000_000) as i64;
    }

    /// Local time at a time of the simulation.
    pub(crate) fn local(self, at: u64) -> u64 {
        (self.shown_at(at) >> PLACES) as u64
    }

    /// The first time of the simulation at which the clock shows `local` or more, at the speed that it has now.
    pub(crate) fn when(self, local: u64) -> u64 {
        let shown = (self.shown >> PLACES) as u64;
        let whole = i128::from(local.wrapping_sub(shown).cast_signed()) << PLACES;
        let missing = whole - (self.shown & (ONE - 1));
        let rate = self.rate();
        let elapsed = missing.div_euclid(rate) + i128::from(missing.rem_euclid(rate) != 0);
        self.since.saturating_add_signed(elapsed as i64)
    }

    /// Takes a received system time, from which the local copy differs by so many nanoseconds at `at`.
    ///
    /// The data sheet says that the difference is averaged (0934h), that the deviation of the clock period is averaged
    /// (0935h), and that the local clock is sped up or slowed down by both within a bandwidth (0930h). Assumed, because it
    /// does not say how: a step of an eighth of the difference, at least one and at most 32 nanoseconds, for a bandwidth of
    /// 1000h; and a speed that takes up the deviation with the time constant of its filter.
    pub(crate) fn follow(&mut self, difference: i32, at: u64, settings: ControlLoop) {
        self.move_on(at);
        let difference = i64::from(difference);
        let depth = settings.difference_depth.min(15);
        let mean = self.mean.unwrap_or(difference << 8);
        self.mean = Some(mean + (((difference << 8) - mean) >> depth));
        if let Some((before, then, step)) = self.last {
            let elapsed = at.saturating_sub(before);
            if elapsed == 0 {
                return;
            }
            let deviation = (i128::from(difference - then + step) << PLACES) / i128::from(elapsed);
            let change = (deviation << 16) >> settings.speed_depth.min(15);
            let most = FASTEST << 16;
            let speed = i128::from(self.speed) - change;
            self.speed = speed.clamp((-most).into(), most.into()) as i64;
        }
        let bandwidth = i64::from(settings.start.max(0x80));
        let part = difference * 0x200 / bandwidth;
        let step = match difference {
            0 => 0,
            _ if part == 0 => difference.signum(),
            _ => part.clamp(-LARGEST_STEP, LARGEST_STEP),
        };
        self.shown -= i128::from(step) << PLACES;
        self.last = Some((at, difference, step));
    }

    /// Resets the filters, as a write to 0930h does.
    pub(crate) fn reset_filters(&mut self, at: u64) {
        self.move_on(at);
        self.mean = None;
        self.last = None;
        self.speed = 0;
    }

    /// Register 092Ch: magnitude of the mean difference, and bit 31 when the local time is smaller.
    pub(crate) fn mean_difference(self) -> u32 {
        let mean = (self.mean.unwrap_or(0) + 0x80) >> 8;
        let magnitude = (mean.unsigned_abs() as u32) & 0x7FFF_FFFF;
        magnitude | if mean < 0 { 0x8000_0000 } else { 0 }
    }

    /// Receive times of the ports 0 to 3 of a frame that left the MainDevice at `now`; a port without a neighbour shows
    /// zero.
    pub(crate) fn receive_times(self, place: Place, now: Duration) -> [u32; 4] {
        let arrival = place.at_port_0(now);
        // The registers hold the low half.
        let mut times = place
            .back
            .map(|back| back.map_or(0, |back| self.local(arrival.wrapping_add(back)) as u32));
        times[0] = self.local(arrival) as u32;
        times
    }

    fn rate(self) -> i128 {
        ONE + i128::from(self.drift) + i128::from(self.speed >> 16)
    }

    fn shown_at(self, at: u64) -> i128 {
        // Between the frames and the device's own events the time goes back by the frames' way.
        let elapsed = at.wrapping_sub(self.since).cast_signed();
        self.shown + i128::from(elapsed) * self.rate()
    }

    fn move_on(&mut self, at: u64) {
        self.shown = self.shown_at(at);
        self.since = at;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AFTER_A_RESET: ControlLoop = ControlLoop {
        start: 0x1000,
        difference_depth: 4,
        speed_depth: 12,
    };

    /// How far the clock is ahead of the simulation's time after it was given that so many times.
    fn distribute(clock: &mut Clock, from: u64, every: u64, times: u64) -> i64 {
        let ahead = |clock: &Clock, at: u64| clock.local(at).wrapping_sub(at).cast_signed();
        let mut at = from;
        for _ in 0..times {
            at += every;
            let difference = ahead(clock, at);
            clock.follow(difference as i32, at, AFTER_A_RESET);
        }
        ahead(clock, at + every)
    }

    #[test]
    fn receive_times_show_the_way_to_each_neighbour_and_back() {
        let place = Place {
            arrival: 500,
            back: [None, Some(3_000), None, Some(1_000)],
        };
        let times = Clock::new(7_000).receive_times(place, Duration::from_micros(1));
        assert_eq!(times, [8_500, 11_500, 0, 9_500]);
    }

    #[test]
    fn a_crystal_that_is_100_ppm_too_fast_gains_100_us_in_a_second() {
        let mut clock = Clock::new(0);
        clock.set_drift(100_000, 0);
        assert_eq!(clock.local(1_000_000_000), 1_000_099_999);
        assert_eq!(clock.when(1_000_100_000), 1_000_000_001);
        assert!(clock.local(clock.when(5_000_123)) >= 5_000_123);
    }

    #[test]
    fn the_control_loop_takes_a_difference_away() {
        for start in [700, -700_i64] {
            let mut clock = Clock::new(start.cast_unsigned());
            assert_eq!(distribute(&mut clock, 0, 1_000_000, 100), 0);
        }
    }

    #[test]
    fn fifteen_thousand_times_teach_it_the_speed() {
        for drift in [100_000, -100_000] {
            let mut clock = Clock::new(0);
            clock.set_drift(drift, 0);
            distribute(&mut clock, 0, 10_000, 15_000);
            // At the network's cycle what is left of the drift stays small.
            let ahead = distribute(&mut clock, 150_000_000, 1_000_000, 1_000);
            assert!(ahead.abs() < 30, "{ahead}");
            let mut untaught = Clock::new(0);
            untaught.set_drift(drift, 0);
            let ahead = distribute(&mut untaught, 0, 1_000_000, 1_000);
            assert!(ahead.abs() > 1_000, "{ahead}");
        }
    }

    #[test]
    fn the_difference_has_its_sign_in_bit_31() {
        for (difference, shown) in [(3, 3), (-3, 0x8000_0003)] {
            let mut clock = Clock::new(0);
            clock.follow(difference, 1_000, AFTER_A_RESET);
            assert_eq!(clock.mean_difference(), shown);
            clock.reset_filters(1_000);
            assert_eq!(clock.mean_difference(), 0);
        }
    }
}
