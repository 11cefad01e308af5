//! What frames take on the cable: docs/scaling.md has the formula with its sources. Pure, and used by cycles and requests alike.

use std::time::Duration;

use crate::link::SHORTEST_FRAME;

/// What a byte takes on 100 Mbit/s (IEEE 802.3, 100BASE-TX), the speed of an EtherCAT segment.
const BYTE: Duration = Duration::from_nanos(80);
/// Preamble and start of the frame, checksum, gap to the next one (IEEE 802.3).
const AROUND: usize = 8 + 4 + 12;

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
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
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
                sending: load.sending + time_on_cable(length),
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

    /// Whether they take more of the cycle than they are waited for.
    pub(super) fn is_tight(&self, cycle: Duration) -> bool {
        self.time() > receive_deadline(cycle)
    }
}

/// How long a frame of this length takes at one place of the cable.
pub(super) fn time_on_cable(length: usize) -> Duration {
    let bytes = length.max(SHORTEST_FRAME) + AROUND;
    BYTE * u32::try_from(bytes).unwrap_or(u32::MAX)
}

/// How long the frames of a cycle may be away.
pub(super) fn receive_deadline(cycle: Duration) -> Duration {
    // The rest of the cycle is for the axis cores and for acyclic frames.
    cycle * 3 / 4
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::CableLoad;

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
}
