//! What a network tells of itself: counters, histograms, black boxes, the ports of its line.

use super::{Network, unknown};
use crate::axis::AxisSource;
use crate::bus::{
    BlackBox, CableLoad, DevicePorts, DriveStatistics, NetworkError, Statistics, Timing,
    control::Question,
};

impl Network {
    /// What the bus thread has counted.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// let before = net.statistics();
    /// net.axis("x")?.enable().await?; // what the machine does
    /// let now = net.statistics();
    /// let (cycles, lost) = (now.cycles - before.cycles, now.lost - before.lost);
    /// println!("{lost} frames of {cycles} cycles were lost");
    /// assert!(cycles > 0);
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        Statistics {
            wakes: self.control.wakes.statistics(),
            ..self.control.counters.read()
        }
    }

    /// How steady the cycles were, as histograms.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// let before = net.timing();
    /// net.axis("x")?.enable().await?; // what the machine does
    /// let late = net.timing().lateness.since(&before.lateness);
    /// if let (Some(most), Some(worst)) = (late.quantile(0.99), late.most()) {
    ///     println!("99 % of {} cycles began at most {most:?} late, the worst {worst:?}", late.count());
    ///     assert!(most <= worst);
    /// }
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    #[must_use]
    pub fn timing(&self) -> Timing {
        self.control.counters.timing()
    }

    /// What the frames of each cycle take on the cable.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// let load = net.cable_load();
    /// println!("{} bytes: {:?} on the cable", load.bytes, load.time());
    /// assert!(load.shortest_cycle() < std::time::Duration::from_micros(50));
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    #[must_use]
    pub fn cable_load(&self) -> CableLoad {
        let load = self.control.counters.cable.get();
        load.copied().unwrap_or_default()
    }

    /// What was counted of each declared drive.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// let told = net.drive_statistics();
    /// for drive in &told {
    ///     println!("{}: silent in {} cycles", drive.drive, drive.stale_cycles);
    /// }
    /// assert_eq!(told.len(), 1);
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    #[must_use]
    pub fn drive_statistics(&self) -> Vec<DriveStatistics> {
        self.drives
            .iter()
            .map(|drive| {
                let counters = self.control.counters.drive(drive.in_exchange);
                DriveStatistics {
                    drive: drive.sdo.drive().clone(),
                    stale_cycles: counters.map_or(0, |counters| counters.stale.get()),
                    undelivered_cycles: counters.map_or(0, |counters| counters.undelivered.get()),
                }
            })
            .collect()
    }

    /// The last cycles of the axis with this name: words, positions, what was answered. With each fault they come by
    /// themselves ([`NetworkEvent::Trouble`](crate::bus::NetworkEvent::Trouble)).
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// net.axis("x")?.enable().await?;
    /// let black_box = net.black_box("x").await?;
    /// for cycle in black_box.cycles.iter().rev().take(10) {
    ///     let statusword = cycle.inputs.map(|inputs| inputs.statusword);
    ///     println!("{}: sent {:?}, came back {statusword:?}", cycle.number, cycle.controlword);
    /// }
    /// assert_eq!(black_box.axis.axis, "x");
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if no axis has this name; [`NetworkError::Thread`] if the network has ended.
    pub async fn black_box(&self, axis: &str) -> Result<BlackBox, NetworkError> {
        let index = self
            .axes
            .iter()
            .position(|source| source.name() == axis)
            .ok_or_else(|| unknown("axis", axis, self.axes.iter().map(AxisSource::name)))?;
        self.ask(|reply| Question::BlackBox(index, reply)).await
    }

    /// The error counters of all ports of the line, declared or not: which cable or device damages frames. They count from
    /// when a device was switched on, so what counts is how they change.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// let ports = net.port_errors().await?;
    /// for device in &ports {
    ///     for (port, errors) in device.ports.iter().enumerate() {
    ///         if errors.invalid_frames > 0 || errors.physical > 0 {
    ///             println!("device {}: look at the cable of its port {port}: {errors:?}", device.position);
    ///         }
    ///     }
    /// }
    /// assert_eq!(ports.len(), 1);
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`NetworkError::Line`] if they could not be read; [`NetworkError::Thread`] if the network has ended.
    pub async fn port_errors(&self) -> Result<Vec<DevicePorts>, NetworkError> {
        self.ask(Question::Ports).await?.map_err(NetworkError::Line)
    }
}
