//! Sets the reference clock of a running line after its device was without power. Meanwhile the cycles give their time to all clocks. The
//! reference is set to that.

use std::time::Duration;

use super::{Clocks, Setting, read_time, write_setting};
use crate::{
    bus::{
        cycle::{
            Cycle,
            reference_clock::{LOCK_CYCLES, bound},
        },
        error::{DriveFault, RegisterError},
        requests::{Context, registers::Registers},
    },
    esc,
};

/// How often its offset is corrected. The first one leaves what a frame waits for its turn. The second leaves what the mean lags behind.
const CORRECTIONS: usize = 8;

impl Clocks {
    /// Sets the reference's offset so that it shows the cycles' time. The cycles must lead.
    pub async fn set_reference(
        &self,
        context: &Context,
        period: Duration,
    ) -> Result<(), DriveFault> {
        let (registers, station) = (&context.registers, self.distribution.station);
        let width = self
            .width(self.reference.position)
            .ok_or(DriveFault::NoClock)?;
        let mut offset = read_time(registers, station, esc::SYSTEM_TIME_OFFSET, width).await?;
        let shown = read_time(registers, station, esc::SYSTEM_TIME, width).await?;
        let known = {
            let cycle = context.cycle.borrow();
            cycle.as_ref().and_then(Cycle::reference_time)
        };
        let (time, at) = known.ok_or(DriveFault::NoClock)?;
        let since = context.time.now().saturating_sub(at).as_nanos();
        let time = time.wrapping_add(u64::try_from(since).unwrap_or(u64::MAX));
        offset = offset.wrapping_add(time.wrapping_sub(shown));
        // More than what stays between two cycles of a crystal that is 200 ppm off. The others bear four times as much.
        let bound = bound(period) / 4;
        let mut apart = Duration::MAX;
        for _ in 0..CORRECTIONS {
            let setting = Setting { delay: 0, offset };
            write_setting(registers, station, setting, width).await?;
            self.offset.set(offset);
            // Its filter takes the mean of 16 (0934h).
            context.time.sleep(period * LOCK_CYCLES).await;
            let ahead = ahead(registers, station).await?;
            apart = Duration::from_nanos(ahead.unsigned_abs());
            if apart <= bound {
                return Ok(());
            }
            offset = offset.wrapping_add_signed(ahead.wrapping_neg());
        }
        Err(DriveFault::ClockApart { apart, bound })
    }

    /// By how much the reference's time would set another clock back, in nanoseconds.
    pub async fn step_of(&self, registers: &Registers, station: u16) -> Result<i64, RegisterError> {
        let of_reference = ahead(registers, self.distribution.station).await?;
        Ok(ahead(registers, station)
            .await?
            .saturating_sub(of_reference))
    }
}

/// How far a clock is ahead of the time that it gets, in nanoseconds. This is the mean that 092Ch shows.
async fn ahead(registers: &Registers, station: u16) -> Result<i64, RegisterError> {
    let shown = registers
        .read(station, esc::SYSTEM_TIME_DIFFERENCE)
        .await
        .map(u32::from_le_bytes)?;
    let size = i64::from(shown & 0x7FFF_FFFF);
    // Set where the local time is smaller.
    Ok(if shown >> 31 == 0 { size } else { -size })
}
