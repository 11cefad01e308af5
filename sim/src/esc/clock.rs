//! The distributed clock of a device: a local time from a crystal of its own, receive times, and the control loop that
//! makes the local copy of the system time follow the reference clock. Times are nanoseconds.
//! Source: ESC data sheet, section I "Technology", 9.1; section II "Register description", 0900h to 0935h.

use core::time::Duration;

/// Binary places of a nanosecond that are kept, so that corrections of less than one do not get lost.
const PLACES: u32 = 32;
/// One nanosecond in each.
const ONE: i128 = 1 << PLACES;
/// Binary places of the speed counter difference that are kept.
const COUNTER_PLACES: u32 = 16;

/// Where the device is in the segment, as far as the times of passing frames depend on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Place {
    /// From the MainDevice to port 0.
    pub(crate) arrival: u64,
    /// From the arrival at port 0 to the arrival at each other port of the frame that comes back there; `None` for a port
    /// behind which no frame goes. The first is always `None`.
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

impl ControlLoop {
    /// The values that 0930h may have.
    fn start(self) -> i64 {
        i64::from(self.start).clamp(0x80, 0x3FFF)
    }

    /// The largest speed counter difference (0932h): start less 7Fh.
    fn most(self) -> i64 {
        (self.start() - 0x7F) << COUNTER_PLACES
    }

    /// By how much a speed counter difference slows the clock down, in parts of `ONE` · 2^16: difference / (5 (start +
    /// difference + 2) (start - difference + 2)). With the start of a reset that is 763 ppm at most.
    fn speed(self, counter: i64) -> i64 {
        let start = i128::from((self.start() + 2) << COUNTER_PLACES);
        let counter = i128::from(counter);
        let shown = counter << (PLACES + 16 + COUNTER_PLACES);
        (shown / (5 * (start * start - counter * counter))) as i64
    }
}

/// The local clock.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Clock {
    /// What it showed at `since`, with its binary places.
    shown: i128,
    since: u64,
    /// How much faster the crystal is than the simulation's time: this many parts of `ONE`.
    drift: i64,
    /// The speed counter difference, with its binary places.
    counter: i64,
    /// What the control loop takes from the speed by that, in parts of `ONE` · 2^16.
    slowed: i64,
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
        if rate <= 0 {
            return u64::MAX;
        }
        let elapsed = missing.div_euclid(rate) + i128::from(missing.rem_euclid(rate) != 0);
        self.since.saturating_add_signed(elapsed as i64)
    }

    /// Takes a received system time, from which the local copy differs by so many nanoseconds at `at`.
    ///
    /// The data sheet says that the difference is averaged (0934h), that the deviation of the clock period is averaged
    /// (0935h) and shown (0932h), and what the speed counter does at most. Assumed, because it does not say how the loop is
    /// made: a speed counter that takes up the deviation with the time constant of its filter, and a step of an eighth of
    /// the difference for a start of 1000h, at least one nanosecond, and with that counter never more than it could do alone
    /// since the time before.
    pub(crate) fn follow(&mut self, difference: i32, at: u64, settings: ControlLoop) {
        self.move_on(at);
        let difference = i64::from(difference);
        let depth = settings.difference_depth.min(15);
        let mean = self.mean.unwrap_or(difference << 8);
        self.mean = Some(mean + (((difference << 8) - mean) >> depth));
        let mut step = 0;
        if let Some((before, then, step_before)) = self.last {
            let elapsed = at.saturating_sub(before);
            if elapsed == 0 {
                return;
            }
            let start = settings.start();
            let change = difference - then + step_before;
            let deviation = (i128::from(change) << PLACES) / i128::from(elapsed);
            // Near zero a count is 1 / (5 (start + 2)^2).
            let counts = (deviation * i128::from(5 * (start + 2) * (start + 2)))
                >> (PLACES - COUNTER_PLACES)
                >> settings.speed_depth.min(15);
            let most = i128::from(settings.most());
            self.counter = (i128::from(self.counter) + counts).clamp(-most, most) as i64;
            self.slowed = settings.speed(self.counter);
            let sign = difference.signum();
            let left = settings.speed(settings.most()) - sign * self.slowed;
            let most = (i128::from(left) * i128::from(elapsed)) >> (PLACES + 16);
            let part = (difference * 0x200 / start).abs().max(sign.abs());
            step = sign * part.min(most as i64);
        }
        self.shown -= i128::from(step) << PLACES;
        self.last = Some((at, difference, step));
    }

    /// Resets the filters, as a write to 0930h does.
    pub(crate) fn reset_filters(&mut self, at: u64) {
        self.move_on(at);
        self.mean = None;
        self.last = None;
        self.counter = 0;
        self.slowed = 0;
    }

    /// Register 0932h, two's complement: positive while a crystal that is too fast is slowed down. Which sign is which is
    /// assumed.
    pub(crate) fn speed_difference(self) -> i16 {
        (self.counter >> COUNTER_PLACES) as i16
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
        ONE + i128::from(self.drift) - i128::from(self.slowed >> 16)
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
            assert!(ahead.abs() > 300, "{ahead}");
        }
    }

    #[test]
    fn the_speed_counter_shows_the_deviation_of_the_periods() {
        // Worked by hand: 3218 / (5 (4096 + 3218 + 2) (4096 - 3218 + 2)) is 100 ppm.
        let mut clock = Clock::new(0);
        clock.set_drift(100_000, 0);
        distribute(&mut clock, 0, 10_000, 60_000);
        let shown = clock.speed_difference();
        assert!((3_150..3_290).contains(&shown), "{shown}");
        assert_eq!(AFTER_A_RESET.speed(3_218 << COUNTER_PLACES) >> 16, 429_357);
    }

    #[test]
    fn a_reference_that_jumps_by_a_second_is_followed_with_763_ppm_at_most() {
        let mut clock = Clock::new(0);
        distribute(&mut clock, 0, 10_000, 15_000);
        let mut at = 150_000_000;
        for _ in 0..1_000 {
            at += 1_000_000;
            let difference = clock.local(at).wrapping_sub(at + 1_000_000_000);
            clock.follow(difference as i32, at, AFTER_A_RESET);
        }
        let gained = clock.local(at).wrapping_sub(at);
        assert!((740_000..780_000).contains(&gained), "{gained}");
    }

    #[test]
    fn a_crystal_that_stands_still_shows_nothing_new_and_reaches_no_time() {
        let mut clock = Clock::new(5);
        clock.set_drift(-1_000_000_000, 0);
        assert_eq!(clock.local(1_000_000_000), 5);
        assert_eq!(clock.when(6), u64::MAX);
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
