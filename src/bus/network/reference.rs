//! The way of the reference clock back into a running line, after its device was without power.
//!
//! While it is away the cycles give their own time to all clocks, also to it. What it shows is not looked at. Its clock is set to that time.
//! It is followed again when it shows that, and no enabled axis has to bear a step.

use super::recovery::Recovery;
use crate::{
    bus::{
        clocks::Clocks,
        cycle::{Cycle, reference_clock::bound},
        error::{
            AtStep, BringUpStep, DriveFault, MovingAxis, NetworkError, OfDevice, ReferenceClock,
            RegisterError,
        },
        requests::registers,
    },
    coe::DriveId,
};

impl Recovery {
    /// Sees to it that the reference gives its time, where its device was without power. It need not be in the exchange. Its AL state stays.
    pub async fn join_reference(&self, clocks: &Clocks) -> Result<(), NetworkError> {
        let _searching = self.search.lock().await;
        let seen = self.context.counters.clock.read();
        let is_silent = seen.is_some_and(|seen| seen.reference == ReferenceClock::Silent);
        if !is_silent && !self.awaits_reference() {
            return Ok(());
        }
        let registers = &self.context.registers;
        let (id, station) = (&clocks.reference, clocks.distribution.station);
        match registers::status(registers, station).await {
            Ok(_) => {}
            Err(RegisterError::NotAnswered) => {
                let position = self.address(id, None).await?;
                if position != id.position {
                    let fault: Result<(), _> = Err(DriveFault::ClockOfRunningLine);
                    return fault.at(BringUpStep::Clock).of(id);
                }
            }
            Err(error) => return Err(error).at(BringUpStep::Clock).of(id),
        }
        // One that has kept its address has kept its time.
        if !self.awaits_reference() {
            return Ok(());
        }
        let set = clocks.set_reference(&self.context, self.period).await;
        set.at(BringUpStep::Clock).of(id)?;
        self.bear_the_step(clocks).await?;
        self.with_cycle(Cycle::follow_reference);
        Ok(())
    }

    /// Gives a device its station address again. The reference's time is not looked at from then on, and given to nobody.
    pub async fn address(&self, id: &DriveId, accepted: Option<u32>) -> Result<u16, NetworkError> {
        let line = self.line.borrow().clone();
        let clocks = self.clocks.as_ref();
        let is_reference = clocks.is_some_and(|clocks| clocks.reference == *id);
        let leads_since_now = is_reference && self.with_cycle(Cycle::lead_clocks) == Some(true);
        let found = line.find_again(&self.context.registers, id, accepted).await;
        if leads_since_now && matches!(found, Err(NetworkError::WrongLine(_))) {
            // It is not there, and has no address. One that has kept its power will give its time.
            self.with_cycle(Cycle::follow_reference);
        }
        found
    }

    /// That no drive with an enabled or moving axis gets a step of its clock beyond the bound.
    async fn bear_the_step(&self, clocks: &Clocks) -> Result<(), NetworkError> {
        let bound = bound(self.period);
        for member in &self.devices {
            // Axes of one that is on its way back are switched off.
            let Some(device) = member.device.try_lock() else {
                continue;
            };
            let found = &device.found;
            let of_drive = |moving: &MovingAxis| moving.answers && moving.axis.drive == found.id;
            let moving = self.axes.borrow().moving().find(of_drive);
            let Some(moving) = moving.filter(|_| device.clocks().is_some()) else {
                continue;
            };
            let step = clocks.step_of(&self.context.registers, found.station).await;
            let by_ns = step.at(BringUpStep::Clock).of(&found.id)?;
            if u128::from(by_ns.unsigned_abs()) > bound.as_nanos() {
                let axis = moving.axis.axis;
                let fault: Result<(), _> = Err(DriveFault::ClockStep { axis, by_ns, bound });
                return fault.at(BringUpStep::Clock).of(&found.id);
            }
        }
        Ok(())
    }

    fn awaits_reference(&self) -> bool {
        self.with_cycle(Cycle::awaits_reference) == Some(true)
    }

    fn with_cycle<T>(&self, change: impl FnOnce(&mut Cycle) -> T) -> Option<T> {
        self.context.cycle.borrow_mut().as_mut().map(change)
    }
}
