//! What stops an axis from anywhere.

use std::sync::Arc;

use super::{Axis, StopRequest, shared::Shared};

impl Axis {
    /// What stops this axis from anywhere: `Drop`, a signal, a panic hook.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// let stop = net.axis("x")?.stop_handle();
    /// // From any thread, or a signal handler:
    /// std::thread::spawn(move || stop.quick_stop());
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    #[must_use]
    pub fn stop_handle(&self) -> StopHandle {
        StopHandle {
            shared: Arc::clone(&self.handles.shared),
        }
    }
}

/// Stops one axis: at once, from any thread, without waiting and without failing. What it asks for is in the next
/// process-data frame, whatever else is queued, and it wins over everything that is asked for in the same cycle. It does
/// not count as a handle of the axis.
///
/// Only atomics are touched: it may be called from a signal handler. It is no safety function.
#[derive(Debug, Clone)]
pub struct StopHandle {
    shared: Arc<Shared>,
}

impl StopHandle {
    /// Pauses by bit 8, keeping the set-point. On a drive that ignores bit 8 it goes on to the quick stop as soon as that is known.
    pub fn halt(&self) {
        self.shared.request_stop(StopRequest::HALT);
    }

    /// Halts, then abandons the set-point by quick stop.
    pub fn stop(&self) {
        self.shared.request_stop(StopRequest::STOP);
    }

    /// Quick stop (bit 2).
    pub fn quick_stop(&self) {
        self.shared.request_stop(StopRequest::QUICK_STOP);
    }
}
