//! The distributed clock of a device: a local time with an offset of its own, receive times, system time.

use core::time::Duration;

/// Delay from one device to the next, in nanoseconds; a port and 10 m of cable take about this long.
const HOP_NS: u64 = 500;

/// Where the device is in the line, as far as the times of passing frames depend on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Place {
    /// Devices between the MainDevice and this one.
    pub(crate) position: usize,
    /// Devices behind this one.
    pub(crate) behind: usize,
}

impl Place {
    /// When a frame that left the MainDevice at `now` arrives at port 0, in nanoseconds.
    fn arrival(self, now: Duration) -> u64 {
        nanoseconds(now).wrapping_add(self.position as u64 * HOP_NS)
    }

    /// When it comes back to port 1 from the devices behind.
    fn comes_back(self, now: Duration) -> u64 {
        self.arrival(now)
            .wrapping_add(2 * self.behind as u64 * HOP_NS)
    }
}

/// Nanoseconds of the simulation's time.
fn nanoseconds(now: Duration) -> u64 {
    // 64 bits of nanoseconds last for 584 years.
    now.as_nanos() as u64
}

/// The local clock. It runs at the simulation's rate, from a start that differs from device to device.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Clock {
    start: u64,
}

impl Clock {
    /// A clock that shows `start` nanoseconds at time zero of the simulation.
    pub(crate) fn new(start: u64) -> Self {
        Self { start }
    }

    /// Takes a step towards the reference clock, from which it differs by so many nanoseconds: an eighth of the
    /// difference, at least one and at most 32 nanoseconds. Assumed: the control loop of an ESC takes its steps from the
    /// filters at 0934h, and gets there as well.
    pub(crate) fn follow(&mut self, difference: i32) {
        let size = match difference.unsigned_abs() {
            0 => 0,
            size => (size / 8).clamp(1, 32),
        };
        let step = u64::from(size);
        self.start = if difference > 0 {
            self.start.wrapping_sub(step)
        } else {
            self.start.wrapping_add(step)
        };
    }

    /// Local time while a frame passes.
    pub(crate) fn local(self, place: Place, now: Duration) -> u64 {
        self.start.wrapping_add(place.arrival(now))
    }

    /// Receive times of the ports 0 to 3; a port without a neighbour shows zero.
    pub(crate) fn receive_times(self, place: Place, now: Duration) -> [u32; 4] {
        // The registers hold the low half.
        let low = |time: u64| self.start.wrapping_add(time) as u32;
        let port1 = if place.behind == 0 {
            0
        } else {
            low(place.comes_back(now))
        };
        [low(place.arrival(now)), port1, 0, 0]
    }
}

/// Difference of the local system time to a received one as register 092Ch shows it: magnitude, and bit 31 when the
/// local time is smaller.
pub(crate) fn difference(local: u32, received: u32) -> u32 {
    let signed = local.wrapping_sub(received).cast_signed();
    let magnitude = signed.unsigned_abs() & 0x7FFF_FFFF;
    if signed < 0 {
        magnitude | 0x8000_0000
    } else {
        magnitude
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loop_time_of_a_device_grows_with_the_devices_behind_it() {
        let clock = Clock::new(7_000);
        let times = clock.receive_times(
            Place {
                position: 1,
                behind: 3,
            },
            Duration::from_micros(1),
        );
        assert_eq!(
            times,
            [7_000 + 1_000 + 500, 7_000 + 1_000 + 500 + 3_000, 0, 0]
        );
    }

    #[test]
    fn the_last_device_has_no_time_at_port_1() {
        let times = Clock::new(0).receive_times(
            Place {
                position: 0,
                behind: 0,
            },
            Duration::from_micros(1),
        );
        assert_eq!(times, [1_000, 0, 0, 0]);
    }

    #[test]
    fn the_difference_has_its_sign_in_bit_31() {
        assert_eq!(difference(10, 7), 3);
        assert_eq!(difference(7, 10), 0x8000_0003);
    }
}
