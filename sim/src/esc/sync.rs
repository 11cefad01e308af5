//! The SYNC unit of a device's distributed clock: what the MainDevice set in 0980h to 09A7h, and when SYNC0 pulses.
//! Source: the register list in the ESC data sheets, as far as masters use it.

use core::time::Duration;

use super::Esc;
use super::clock::nanoseconds;
use super::registers as reg;
use crate::description::ClockWidth;

/// Bits of register 0981h.
const CYCLIC: u8 = 0x01;
const SYNC0: u8 = 0x02;
const SYNC1: u8 = 0x04;

/// What the registers of the SYNC unit say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SyncUnit {
    /// 0981h bit 0: the unit is on. Without it the other bits have no effect.
    pub(crate) is_on: bool,
    /// 0981h bit 1: SYNC0 is generated.
    pub(crate) sync0: bool,
    /// 0981h bit 2: SYNC1 is generated.
    pub(crate) sync1: bool,
    /// 09A0h: time between two pulses of SYNC0 in nanoseconds; zero means a single pulse.
    pub(crate) cycle_ns: u32,
}

impl Esc {
    /// The settings of the SYNC unit.
    pub(crate) fn sync_unit(&self) -> SyncUnit {
        let activation = self.byte(reg::SYNC_ACTIVATION);
        SyncUnit {
            is_on: activation & CYCLIC != 0,
            sync0: activation & SYNC0 != 0,
            sync1: activation & SYNC1 != 0,
            cycle_ns: self.double_word(reg::SYNC0_CYCLE),
        }
    }

    /// Whether SYNC0 pulses: the unit is on, and the first pulse has come.
    pub(crate) fn sync0_runs(&self) -> bool {
        let unit = self.sync_unit();
        unit.is_on && unit.sync0 && unit.cycle_ns > 0 && self.has_pulsed
    }

    /// 0981h was written: a start time that has passed already does not come for a very long time, with 32 bits for at
    /// least two seconds.
    pub(super) fn activate_sync(&mut self, was_on: bool, now: Duration) {
        let unit = self.sync_unit();
        if !unit.is_on {
            self.next_pulse = None;
            self.has_pulsed = false;
        } else if !was_on {
            let start = self.quad_word(reg::SYNC0_START);
            let time = self.system_time(now);
            self.next_pulse = match self.clock_width {
                Some(ClockWidth::Bits32) => {
                    let ahead = (start as u32).wrapping_sub(time as u32);
                    Some(time.wrapping_add(ahead.into()))
                }
                _ => (start > time).then_some(start),
            };
        }
    }

    /// What 0990h shows: the next pulse while the unit is on, else the start time as it was written.
    pub(super) fn refresh_next_pulse(&mut self, now: Duration) {
        if let Some(next) = self.next_pulse {
            let cycle = u64::from(self.sync_unit().cycle_ns);
            // The processor has not been told yet of one that came while the frame was on its way.
            let passed = next <= self.system_time(now);
            self.set_clock_value(reg::SYNC0_START, next + if passed { cycle } else { 0 });
        }
    }

    /// When SYNC0 pulses next, as a time of the simulation.
    pub(crate) fn pulse_at(&self) -> Option<Duration> {
        let unit = self.sync_unit();
        let next = self.next_pulse.filter(|_| unit.is_on && unit.sync0)?;
        let local = next.wrapping_sub(self.quad_word(reg::DC_OFFSET));
        Some(Duration::from_nanos(self.clock.when(local)))
    }

    /// Takes the pulse that is due at `now`: when it was, in system time.
    pub(crate) fn take_pulse(&mut self, now: Duration) -> Option<u64> {
        let due = self.pulse_at().is_some_and(|at| at <= now);
        let pulse = self.next_pulse.filter(|_| due)?;
        self.has_pulsed = true;
        // A single pulse where there is no cycle. A system time that was set forward leaves pulses out.
        let cycle = u64::from(self.sync_unit().cycle_ns);
        let time = self.system_time_at(nanoseconds(now));
        self.next_pulse = time
            .saturating_sub(pulse)
            .checked_div(cycle)
            .map(|missed| pulse + (missed + 1) * cycle);
        Some(pulse)
    }

    /// System time at which a buffer of outputs was complete last.
    pub(crate) fn outputs_at(&self) -> Option<u64> {
        self.outputs_at
    }
}
