//! The SYNC unit of a device's distributed clock: what the MainDevice set in 0980h to 09A7h, and when SYNC0 pulses.
//! Source: the register list in the ESC data sheets, as far as masters use it.

use core::time::Duration;

use super::Esc;
use super::registers as reg;

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
    pub(crate) fn sync0_runs(&self, now: Duration) -> bool {
        let unit = self.sync_unit();
        let has_begun = self
            .first_pulse
            .is_some_and(|first| first <= self.system_time(now));
        unit.is_on && unit.sync0 && unit.cycle_ns > 0 && has_begun
    }

    /// 0981h was written: a start time that has passed already does not come for a very long time.
    pub(super) fn activate_sync(&mut self, was_on: bool, now: Duration) {
        let unit = self.sync_unit();
        if !unit.is_on {
            self.first_pulse = None;
        } else if !was_on {
            let start = self.quad_word(reg::SYNC0_START);
            self.first_pulse = (start > self.system_time(now)).then_some(start);
        }
    }

    /// What 0990h shows: the next pulse while the unit is on, else the start time as it was written.
    pub(super) fn refresh_next_pulse(&mut self, now: Duration) {
        let (Some(first), cycle) = (self.first_pulse, u64::from(self.sync_unit().cycle_ns)) else {
            return;
        };
        let since = self.system_time(now).saturating_sub(first);
        let next = match cycle {
            _ if self.system_time(now) < first => first,
            0 => return,
            _ => first.saturating_add((since / cycle + 1).saturating_mul(cycle)),
        };
        self.set_bytes(reg::SYNC0_START, &next.to_le_bytes());
    }
}
