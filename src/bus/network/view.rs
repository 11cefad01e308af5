//! What other threads may see and stop of a running network, without a handle of an axis and without keeping the network running.

use std::{fmt, sync::Arc};

use smol::channel::Receiver;

use super::{ask, supervisor::StartedDrive, unknown};
use crate::{
    axis::{AxisIdentity, AxisSource, Snapshot, StopRequest},
    bus::{
        cycle::statistics::{DriveStatistics, Statistics, Timing},
        error::NetworkError,
        watch::{Control, DevicePorts, Question},
    },
    coe::{Emergencies, SdoHandle},
};

/// What a network shows to threads beside the program's own: a panel, a monitor. Made by [`Network::view`](super::Network::view).
///
/// It holds no handle of an axis: a view that is dropped stops nothing, and a network that is dropped ends although views of it exist.
/// Then its axes count as lost, and its SDO transfers fail.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{bus::{DriveConfig, Network}, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// let view = net.view();
/// std::thread::spawn(move || {
///     for axis in view.axes() {
///         println!("{}: {} at {} {}", axis.identity.axis, axis.snapshot.state, axis.position, axis.unit);
///     }
/// });
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Clone)]
pub struct NetworkView {
    axes: Arc<[AxisSource]>,
    /// Of each drive its objects, its place in the exchange, and its emergencies.
    drives: Arc<[(SdoHandle, usize, Emergencies)]>,
    control: Arc<Control>,
    over: Receiver<()>,
}

/// An axis as a [`NetworkView`] shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisView {
    /// Its name and its drive.
    pub identity: AxisIdentity,
    /// The unit in which it was declared.
    pub unit: &'static str,
    /// The position actual value in that unit.
    pub position: f64,
    /// The velocity actual value in that unit per second.
    pub velocity: f64,
    /// The latest snapshot, in counts.
    pub snapshot: Snapshot,
}

impl NetworkView {
    pub(super) fn new(
        axes: &[AxisSource],
        drives: &[StartedDrive],
        control: &Arc<Control>,
        over: &Receiver<()>,
    ) -> Self {
        let drives = drives.iter();
        Self {
            axes: axes.to_vec().into(),
            drives: drives
                .map(|drive| {
                    let emergencies = drive.emergencies.clone();
                    (drive.sdo.clone(), drive.in_exchange, emergencies)
                })
                .collect(),
            control: Arc::clone(control),
            over: over.clone(),
        }
    }

    /// The axes, in the order of their declaration.
    #[must_use]
    pub fn axes(&self) -> Vec<AxisView> {
        let seen = self.axes.iter().map(|source| {
            let (setup, snapshot) = (source.setup(), source.snapshot());
            let scale = setup.scale.scale();
            AxisView {
                identity: setup.identity.clone(),
                unit: setup.scale.unit(),
                position: scale.position_of(snapshot.position),
                velocity: scale.velocity_of(snapshot.velocity),
                snapshot,
            }
        });
        seen.collect()
    }

    /// The objects of each drive, with its identity, in the order of their declaration.
    pub fn drives(&self) -> impl Iterator<Item = &SdoHandle> + '_ {
        self.drives.iter().map(|(sdo, _, _)| sdo)
    }

    /// As [`Network::statistics`](super::Network::statistics).
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        self.control.statistics()
    }

    /// As [`Network::timing`](super::Network::timing).
    #[must_use]
    pub fn timing(&self) -> Timing {
        self.control.counters.timing()
    }

    /// As [`Network::drive_statistics`](super::Network::drive_statistics).
    #[must_use]
    pub fn drive_statistics(&self) -> Vec<DriveStatistics> {
        let counted = self.drives.iter().map(|(sdo, in_exchange, emergencies)| {
            let counters = self.control.counters.drive(*in_exchange);
            DriveStatistics {
                drive: sdo.drive().clone(),
                stale_cycles: counters.map_or(0, |counters| counters.stale.get()),
                undelivered_cycles: counters.map_or(0, |counters| counters.undelivered.get()),
                emergencies: emergencies.counted(),
            }
        });
        counted.collect()
    }

    /// As [`Network::port_errors`](super::Network::port_errors).
    ///
    /// # Errors
    /// [`NetworkError::Line`] if they could not be read; [`NetworkError::Thread`] if the network has ended.
    pub async fn port_errors(&self) -> Result<Vec<DevicePorts>, NetworkError> {
        let asked = ask(&self.control, &self.over, Question::Ports);
        asked.await?.map_err(NetworkError::Line)
    }

    /// Stops one axis, in the next frame. It does not wait for the standstill.
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if no axis has this name.
    pub fn stop_axis(&self, name: &str, stop: StopRequest) -> Result<(), NetworkError> {
        let found = self.axes.iter().find(|source| source.name() == name);
        let source =
            found.ok_or_else(|| unknown("axis", name, self.axes.iter().map(AxisSource::name)))?;
        source.request_stop(stop);
        Ok(())
    }

    /// Stops every axis, in the next frame.
    pub fn stop_all(&self, stop: StopRequest) {
        self.control.request_stop(stop);
    }
}

impl fmt::Debug for NetworkView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let axes: Vec<_> = self.axes.iter().map(AxisSource::name).collect();
        f.debug_struct("NetworkView")
            .field("axes", &axes)
            .finish_non_exhaustive()
    }
}
