//! Simulated CiA 402 drives in virtual time, of which a figure looks at each millisecond.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use servocrab::{
    AxisConfig, DriveConfig, Network, Referencing,
    bus::{BusLoop, NetworkBuilder},
    drives,
    link::Wire,
    units::{Mm, Ratio, Scale},
};
use servocrab_sim::Segment;

use crate::{Result, picture::lock, turn_until};

const COUNTS_PER_MM: u64 = 10_000;

/// A running network, and its line.
pub(crate) struct Line {
    segment: Arc<Mutex<Segment>>,
    bus: BusLoop,
    pub(crate) net: Network,
}

/// An axis in millimetres, which is moved without being homed.
pub(crate) fn axis(name: &str) -> Result<AxisConfig> {
    let scale = Scale::counts_per_unit(Ratio::new(COUNTS_PER_MM, 1)?);
    Ok(AxisConfig::new(name)
        .unit::<Mm>(scale)
        .referencing(Referencing::UnreferencedMovesAllowed))
}

/// A drive with this axis.
pub(crate) fn drive(axis: AxisConfig) -> DriveConfig {
    let mut description = drives::generic();
    description.traits.acknowledges_while_halted = true;
    DriveConfig::new(description).axis(axis)
}

/// Where the axis of the drive at this place is, in mm.
pub(crate) fn position(segment: &Segment, place: usize) -> f64 {
    let axis = segment.axis(place, 0);
    axis.map_or(0.0, |axis| axis.position() as f64 / COUNTS_PER_MM as f64)
}

impl Line {
    /// With one axis for each drive of the segment.
    pub(crate) fn start(segment: Segment, axes: Vec<AxisConfig>) -> Result<Self> {
        Self::declared(segment, |builder| {
            (0..).zip(axes).fold(builder, |builder, (place, axis)| {
                builder.drive(place, drive(axis))
            })
        })
    }

    /// With what is declared of the segment.
    pub(crate) fn declared(
        segment: Segment,
        declare: impl FnOnce(NetworkBuilder) -> NetworkBuilder,
    ) -> Result<Self> {
        let segment = Arc::new(Mutex::new(segment));
        let on_the_wire = Arc::clone(&segment);
        let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame, now| {
            lock(&on_the_wire).process(frame, now)
        });
        let builder = Network::builder()
            .link(wire)
            .cycle(Duration::from_millis(1));
        let (starting, mut bus) = declare(builder).split()?;
        let net = turn_until(&mut bus, starting.network())?;
        Ok(Self { segment, bus, net })
    }

    /// Turns the line until the future is ready.
    pub(crate) fn until<T>(&mut self, future: impl Future<Output = T>) -> T {
        turn_until(&mut self.bus, future)
    }

    /// The line's time.
    pub(crate) fn now_ms(&self) -> f64 {
        self.bus.now().as_secs_f64() * 1e3
    }

    /// One millisecond, and what is seen behind it.
    pub(crate) fn millisecond<T>(&mut self, look: impl FnOnce(&mut Segment) -> T) -> T {
        let next = self.bus.now() + Duration::from_millis(1);
        while self.bus.now() < next && self.bus.turn() {}
        look(&mut lock(&self.segment))
    }
}
