//! What stops all axes of a network: at once, from anywhere, or because the program is not alive.

use std::{sync::Arc, time::Duration};

use super::Network;
use crate::{
    axis::{Liveness, StopRequest},
    bus::control::Control,
};

impl Network {
    /// Stops every axis, in the next frame.
    pub fn stop_all(&self, stop: StopRequest) {
        self.control.request_stop(stop);
    }

    /// Stops every axis from anywhere: signal handlers, panic hooks, other threads.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use servocrab::axis::StopRequest;
    /// let stop = net.stop_handle();
    /// // On the thread of the panel's stop button:
    /// std::thread::spawn(move || stop.stop_all(StopRequest::QUICK_STOP));
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    #[must_use]
    pub fn stop_handle(&self) -> NetworkStop {
        NetworkStop {
            control: Arc::clone(&self.control),
        }
    }

    /// Has every axis halt when the program does not feed the returned rule for this time, or drops it. From then on, until it is fed,
    /// ended, or another takes its place, nothing is enabled, resumed or started
    /// ([`Failure::LivenessExpired`](crate::axis::Failure::LivenessExpired)); stops, `disable` and `reset_fault` work all the time.
    /// What has halted goes on only by `resume`.
    ///
    /// There is one rule: the last one that was asked for.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use std::time::Duration;
    /// let alive = net.liveness(Duration::from_millis(200));
    /// for _ in 0..3 {
    ///     alive.feed(); // once in each turn of the program's own loop
    ///     smol::Timer::after(Duration::from_millis(10)).await;
    /// }
    /// alive.end(); // dropped without it, it would halt every axis
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    pub fn liveness(&self, timeout: Duration) -> Liveness {
        let (liveness, watch) = Liveness::new(timeout);
        self.control.add_watch(watch);
        liveness
    }
}

/// Stops every axis of a network, in the next frame. It neither blocks nor fails.
#[derive(Debug, Clone)]
pub struct NetworkStop {
    control: Arc<Control>,
}

impl NetworkStop {
    /// Stops every axis.
    pub fn stop_all(&self, stop: StopRequest) {
        self.control.request_stop(stop);
    }
}
