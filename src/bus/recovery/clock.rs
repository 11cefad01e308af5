//! The distributed clock of a device that has begun anew in a line whose clocks run.

use std::iter;

use super::{
    super::{BringUpStep, NetworkError, cycle::Cycle, dc, discovery::Found},
    Recovery,
    device::Device,
};

impl Recovery {
    /// By the reference clock that all others follow, if it follows that too.
    pub(super) async fn set_clock(&self, device: &Device) -> Result<(), NetworkError> {
        let Some(clocks) = device.clocks() else {
            return Ok(());
        };
        dc::wait_for_lock(&self.context, iter::empty(), self.period).await?;
        let known = {
            let cycle = self.context.cycle.borrow();
            cycle.as_ref().and_then(Cycle::reference_time)
        };
        if let Some((time, at)) = known {
            clocks.remember(time, at);
        }
        // Its own was not set.
        if device.is_reference {
            return Ok(());
        }
        let Found { station, id, .. } = &device.found;
        let _latching = self.search.lock().await;
        clocks
            .set_anew(&self.context.registers, *station, id.position)
            .await
            .map_err(|error| device.fault((BringUpStep::Clock, error)))
    }
}
