//! Distributed clocks: delays and offsets of a line, SYNC0 of its drives, and the way of the cycles into step with the reference clock.
//!
//! `topology` computes and is pure; `measure` and `sync` make the accesses. The phase controller itself is in `cycle`, which it is part
//! of. It calls `line` and `requests`, and must not know of drives but their setting here.

pub(super) mod measure;
pub(super) mod sync;
pub(super) mod topology;

use std::time::Duration;

use crate::bus::cycle::reference_clock::to_multiple;

/// Bits of the assign-activate word's upper byte, register 0981h.
const UNIT_ON: u16 = 0x0100;
const SYNC0_ON: u16 = 0x0200;
const SYNC1_ON: u16 = 0x0400;

/// A drive's distributed clock in use: its SYNC0 pulses at the same time in every cycle, and the network keeps its cycles in
/// step with that.
///
/// Give it to [`DriveConfig::dc`](crate::bus::DriveConfig::dc). The words for `assign_activate` are in the drive's ESI file
/// (`Dc`, `OpMode`, `AssignActivate`) and in its manual; 0300h, SYNC0 alone, is the usual one.
///
/// ```
/// use servocrab::bus::{DistributedClock, DriveConfig};
/// use servocrab::drives;
/// use std::time::Duration;
///
/// let clock = DistributedClock::new(0x0300).shift(Duration::from_micros(400));
/// let drive = DriveConfig::new(drives::akd2g()).axis("x").dc(clock);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DistributedClock {
    pub(in crate::bus) assign_activate: u16,
    cycle: Option<Duration>,
    shift: Option<Duration>,
    sync1_after: Duration,
}

impl DistributedClock {
    /// A clock whose SYNC unit is switched on with this word (registers 0980h and 0981h): SYNC0 once in each cycle of the
    /// network, half a cycle after its frames.
    #[must_use]
    pub const fn new(assign_activate: u16) -> Self {
        Self {
            assign_activate,
            cycle: None,
            shift: None,
            sync1_after: Duration::ZERO,
        }
    }

    /// SYNC0 this long after the network's frames pass the reference clock; it must be less than SYNC0's cycle.
    #[must_use]
    pub const fn shift(mut self, shift: Duration) -> Self {
        self.shift = Some(shift);
        self
    }

    /// SYNC0 with this cycle (09A0h): a multiple or a whole part of the network's, and a multiple of what the drive asks for.
    #[must_use]
    pub const fn sync0_cycle(mut self, cycle: Duration) -> Self {
        self.cycle = Some(cycle);
        self
    }

    /// SYNC1 this long after SYNC0 (09A4h), for words that switch it on, as 0700h.
    #[must_use]
    pub const fn sync1_after(mut self, time: Duration) -> Self {
        self.sync1_after = time;
        self
    }

    /// What is wrong with it for a network with this cycle.
    pub(in crate::bus) fn mistake(&self, period: Duration) -> Option<String> {
        let word = self.assign_activate;
        let (cycle, shift) = (self.cycle(period), self.shift_in(period));
        let divides = |one: Duration, other: Duration| {
            one.as_nanos().checked_rem(other.as_nanos()) == Some(0)
        };
        if word & UNIT_ON == 0 || word & SYNC0_ON == 0 {
            Some(format!(
                "the assign-activate word {word:04X}h does not switch SYNC0 on (bits 8 and 9)"
            ))
        } else if nanoseconds(cycle).is_none() || nanoseconds(self.sync1_after).is_none() {
            Some(format!(
                "SYNC0 each {cycle:?} and SYNC1 {:?} later have no room in registers of 32 bits of nanoseconds",
                self.sync1_after
            ))
        } else if !self.sync1_after.is_zero() && word & SYNC1_ON == 0 {
            Some(format!(
                "the assign-activate word {word:04X}h does not switch SYNC1 on (bit 10), and it is to come {:?} after SYNC0",
                self.sync1_after
            ))
        } else if !divides(cycle, period) && !divides(period, cycle) {
            Some(format!(
                "SYNC0 each {cycle:?} is neither a multiple nor a whole part of the network's cycle of {period:?}"
            ))
        } else if shift >= cycle {
            Some(format!(
                "SYNC0's shift of {shift:?} is not less than its cycle of {cycle:?}"
            ))
        } else {
            None
        }
    }

    /// SYNC0's cycle.
    pub(in crate::bus) fn cycle(&self, period: Duration) -> Duration {
        self.cycle.unwrap_or(period)
    }

    /// How long after the network's frames SYNC0 comes.
    pub(in crate::bus) fn shift_in(&self, period: Duration) -> Duration {
        self.shift.unwrap_or(self.cycle(period).min(period) / 2)
    }

    /// The registers' values: SYNC0's cycle and the time to SYNC1, in nanoseconds.
    pub(in crate::bus) fn cycles(&self, period: Duration) -> (u32, u32) {
        let value = |time| nanoseconds(time).unwrap_or(u32::MAX);
        (value(self.cycle(period)), value(self.sync1_after))
    }

    /// The system time of the first pulse: the first of all possible ones that is not before `earliest`.
    pub(in crate::bus) fn first_pulse(&self, earliest: u64, period: Duration) -> u64 {
        let (cycle, _) = self.cycles(period);
        let shift = nanoseconds(self.shift_in(period)).unwrap_or(0);
        let earliest = earliest.saturating_sub(shift.into());
        let ahead = to_multiple(earliest, u64::from(cycle).max(1));
        earliest.saturating_add(ahead).saturating_add(shift.into())
    }
}

fn nanoseconds(time: Duration) -> Option<u32> {
    u32::try_from(time.as_nanos()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn pulses_lie_on_the_grid_of_the_cycle_half_a_cycle_after_the_frames() {
        let clock = DistributedClock::new(0x0300);
        assert_eq!(clock.cycles(MS), (1_000_000, 0));
        assert_eq!(clock.first_pulse(7_200_000, MS), 7_500_000);
        assert_eq!(clock.first_pulse(7_500_000, MS), 7_500_000);
        assert_eq!(clock.first_pulse(7_500_001, MS), 8_500_000);
        let clock = clock.shift(MS / 4).sync0_cycle(2 * MS);
        assert_eq!(clock.cycles(MS), (2_000_000, 0));
        assert_eq!(clock.first_pulse(7_200_000, MS), 8_250_000);
        // A clock may show anything.
        assert_eq!(clock.first_pulse(u64::MAX, MS), u64::MAX);
    }

    #[test]
    fn each_mistake_has_its_words() {
        let clock = DistributedClock::new(0x0300);
        assert_eq!(clock.mistake(MS), None);
        assert_eq!(clock.sync0_cycle(MS / 4).mistake(MS), None);
        let both = DistributedClock::new(0x0700).sync1_after(MS / 4);
        assert_eq!(both.mistake(MS), None);
        for (clock, words) in [
            (DistributedClock::new(0), "0000h does not switch SYNC0 on"),
            (DistributedClock::new(0x0100), "0100h does not"),
            (clock.shift(MS), "not less than its cycle"),
            (clock.sync0_cycle(MS * 3 / 2), "neither a multiple"),
            (clock.sync0_cycle(Duration::ZERO), "not less than its cycle"),
            (clock.sync0_cycle(5_000 * MS), "no room"),
            (clock.sync1_after(MS / 4), "does not switch SYNC1 on"),
        ] {
            let mistake = clock.mistake(MS).unwrap();
            assert!(mistake.contains(words), "{mistake}");
        }
    }
}
