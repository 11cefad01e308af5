//! What the frames of a cycle take on the cable: docs/scaling.md has the formula with its sources.

use std::time::Duration;

use super::{NetworkError, exchange::receive_deadline, gap::on_wire};

/// What a device keeps a frame, there and back. Assumed: some 0.25 µs each way in two PHYs, and as much in the ESC.
const DEVICE: Duration = Duration::from_micros(1);

/// What the frames of a cycle take on the cable of an EtherCAT segment, 100 Mbit/s: the same in every cycle.
///
/// ```
/// use servocrab::bus::CableLoad;
/// let nothing_yet = CableLoad::default();
/// assert_eq!((nothing_yet.frames, nothing_yet.time().as_nanos()), (0, 0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CableLoad {
    /// Frames of a cycle.
    pub frames: usize,
    /// Bytes of all of them, as they are handed to the operating system.
    pub bytes: usize,
    /// How long the cable is taken by them, with what Ethernet puts around each: 80 ns a byte.
    pub sending: Duration,
    /// How long the devices of the line keep each frame, there and back: 1 µs for each, which is assumed and not measured.
    pub delay: Duration,
}

impl CableLoad {
    /// Of frames of these lengths, in a line of so many devices.
    pub(super) fn of(lengths: impl Iterator<Item = usize>, devices: usize) -> Self {
        let delay = DEVICE * u32::try_from(devices).unwrap_or(u32::MAX);
        lengths.fold(
            Self {
                delay,
                ..Self::default()
            },
            |load, length| Self {
                frames: load.frames + 1,
                bytes: load.bytes + length,
                sending: load.sending + on_wire(length),
                delay,
            },
        )
    }

    /// From the first bit sent to the last one back, without the cable's own delay (some 10 ns for each metre).
    #[must_use]
    pub fn time(&self) -> Duration {
        self.sending + self.delay
    }

    /// The shortest cycle in which the frames are waited for until they are back: 4/3 of their time, since the bus loop waits
    /// three quarters of a cycle. What the machine is late comes on top.
    #[must_use]
    pub fn shortest_cycle(&self) -> Duration {
        self.time() * 4 / 3
    }

    /// Refuses a cycle that these frames cannot keep.
    pub(super) fn check(&self, cycle: Duration) -> Result<(), NetworkError> {
        if self.sending > cycle {
            return Err(NetworkError::CycleTooShort { cycle, load: *self });
        }
        Ok(())
    }

    /// Whether they take more of the cycle than they are waited for.
    pub(super) fn is_tight(&self, cycle: Duration) -> bool {
        self.time() > receive_deadline(cycle)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{CableLoad, NetworkError};

    const fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn a_cycle_takes_its_frames_with_what_is_around_them_and_its_devices() {
        // 1514 + 24 and 60 + 24 bytes of 80 ns.
        let load = CableLoad::of([1514, 40].into_iter(), 10);
        assert_eq!((load.frames, load.bytes), (2, 1554));
        assert_eq!(load.sending, Duration::from_nanos(123_040 + 6_720));
        assert_eq!(load.time(), Duration::from_nanos(139_760));
        // 139.76 · 4 / 3.
        assert_eq!(load.shortest_cycle(), Duration::from_nanos(186_346));
        assert!(load.is_tight(us(186)) && !load.is_tight(us(187)));
    }

    #[test]
    fn a_cycle_that_is_shorter_than_its_frames_is_refused_with_the_numbers() {
        let load = CableLoad::of([1514; 2].into_iter(), 1);
        assert!(load.check(us(247)).is_ok());
        let error = load.check(us(246)).unwrap_err();
        assert!(matches!(error, NetworkError::CycleTooShort { .. }));
        assert_eq!(
            error.to_string(),
            "a cycle of 246µs cannot be kept: its 2 frames (3028 bytes) take 246.08µs on 100 Mbit/s alone, and their cycle is to be \
             329.44µs at least: make it longer, map less, or divide the line into several networks"
        );
    }
}
