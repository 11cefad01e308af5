//! What other threads may see and stop of a running network, without a handle of an axis and without keeping the network running.

use std::{fmt, sync::Arc};

use smol::channel::{Receiver, unbounded};

use super::{ask, find_axis, find_io, supervisor::StartedDrive};
use crate::{
    StopRequest,
    axis::{AxisIdentity, AxisSource, AxisStatistics, Snapshot},
    bus::{
        cycle::{
            black_box::CycleRing,
            statistics::{DriveStatistics, Statistics, Timing},
        },
        device::{io::Io, io_points::IoPoint},
        error::NetworkError,
        event::{NetworkEvent, Recovered},
        recorder::{RecordedSignal, Recorder, Signal, SignalSource, no_signal},
        watch::{Control, DevicePorts, Question, SeenDevice},
    },
    coe::{
        AxisOffset, DataType, DriveEmergency, Emergencies, ObjectAddress, ObjectUnit, SdoHandle,
        obj,
    },
    pdo_map::{Direction, Layout},
    units::{AxisScale, Scale},
};

/// What a network shows to threads beside the program's own: a panel, a monitor. Made by [`Network::view`](crate::Network::view).
///
/// It holds no handle of an axis: a view that is dropped stops nothing, and a network that is dropped ends although views of it exist.
/// Then its axes count as lost, and its SDO transfers fail.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{DriveConfig, Network, drives, link::Wire};
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
    pub(super) axes: Arc<[AxisSource]>,
    pub(super) drives: Arc<[StartedDrive]>,
    pub(super) control: Arc<Control>,
    pub(super) over: Receiver<()>,
    pub(super) ring: Arc<CycleRing>,
    pub(super) ios: Arc<[Io]>,
    /// Where all devices of the exchange stand, in its order.
    pub(super) positions: Arc<[u16]>,
    /// Those of all drives.
    pub(super) emergencies: Emergencies,
}

/// An axis as a [`NetworkView`] shows it.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AxisView {
    /// Its name and its drive.
    pub identity: AxisIdentity,
    /// The unit in which it was declared.
    pub unit: &'static str,
    /// The position actual value in that unit.
    pub position: f64,
    /// The velocity actual value in that unit per second.
    pub velocity: f64,
    /// The following error 60F4h in that unit, where the drive sends it.
    pub following_error: Option<f64>,
    /// The torque actual value 6077h in rated torques, where the drive sends it.
    pub torque: Option<f64>,
    /// The latest snapshot, in counts.
    pub snapshot: Snapshot,
    /// Between its unit and counts.
    pub scale: Scale,
    /// By how much its objects lie above those of the drive's first axis.
    pub offset: AxisOffset,
}

impl NetworkView {
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
                following_error: snapshot
                    .following_error
                    .map(|error| scale.position_of(error)),
                torque: snapshot
                    .torque
                    .map(|thousandths| f64::from(thousandths) / 1000.0),
                snapshot,
                scale: *scale,
                offset: setup.offset,
            }
        });
        seen.collect()
    }

    /// The objects of each drive, with its identity, in the order of their declaration.
    pub fn drives(&self) -> impl Iterator<Item = &SdoHandle> + '_ {
        self.drives.iter().map(|drive| &drive.sdo)
    }

    /// As [`Network::statistics`](crate::Network::statistics).
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        self.control.statistics()
    }

    /// As [`Network::timing`](crate::Network::timing).
    #[must_use]
    pub fn timing(&self) -> Timing {
        self.control.counters.timing()
    }

    /// As [`Network::drive_statistics`](crate::Network::drive_statistics).
    #[must_use]
    pub fn drive_statistics(&self) -> Vec<DriveStatistics> {
        let counted = self.drives.iter().map(|drive| {
            let counters = self.control.counters.drive(drive.in_exchange);
            DriveStatistics {
                drive: drive.id.clone(),
                stale_cycles: counters.map_or(0, |counters| counters.stale.get()),
                undelivered_cycles: counters.map_or(0, |counters| counters.undelivered.get()),
                emergencies: drive.emergencies.counted(),
            }
        });
        counted.collect()
    }

    /// What has become of the motions of each axis, and its faults, in the order of their declaration.
    #[must_use]
    pub fn axis_statistics(&self) -> Vec<AxisStatistics> {
        self.axes.iter().map(AxisSource::statistics).collect()
    }

    /// As [`Network::port_errors`](crate::Network::port_errors).
    ///
    /// # Errors
    /// [`NetworkError::Line`] if they could not be read; [`NetworkError::Thread`] if the network has ended.
    pub async fn port_errors(&self) -> Result<Vec<DevicePorts>, NetworkError> {
        let asked = ask(&self.control, &self.over, Question::Ports);
        asked.await?.map_err(NetworkError::Line)
    }

    /// All SubDevices of the line, each as it was found at the start and with the AL state that it shows now, also those that nobody
    /// has declared. Read over the line, between the cycles.
    ///
    /// # Errors
    /// [`NetworkError::Line`] if they could not be read; [`NetworkError::Thread`] if the network has ended.
    pub async fn device_states(&self) -> Result<Vec<SeenDevice>, NetworkError> {
        let asked = ask(&self.control, &self.over, Question::States);
        asked.await?.map_err(NetworkError::Line)
    }

    /// As [`Network::recover`](crate::Network::recover), of the device at this position of the line. Its progress is reported to nobody.
    ///
    /// # Errors
    /// As there.
    pub async fn recover(&self, position: u16) -> Result<Recovered, NetworkError> {
        let place = self.in_exchange(position)?;
        let (steps, _) = unbounded();
        let asked = |reply| Question::Recover(place, steps, reply);
        ask(&self.control, &self.over, asked).await?
    }

    /// As [`Network::recorder`](crate::Network::recorder).
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if an axis, a device or a point is not declared, or an object is not mapped.
    pub fn recorder(
        &self,
        signals: impl IntoIterator<Item = Signal>,
    ) -> Result<Recorder, NetworkError> {
        let sources = signals.into_iter().map(|signal| {
            let (source, unit) = self.signal_source(&signal)?;
            Ok((RecordedSignal { signal, unit }, source))
        });
        let sources: Vec<_> = sources.collect::<Result<_, NetworkError>>()?;
        Ok(Recorder::new(Arc::clone(&self.ring), sources))
    }

    fn signal_source(&self, signal: &Signal) -> Result<(SignalSource, String), NetworkError> {
        match signal {
            Signal::Lateness => Ok((SignalSource::Lateness, "µs".to_owned())),
            // A device that is no drive has a point by its object.
            Signal::Axis { axis, object } if self.ios.iter().any(|io| io.name() == axis) => {
                self.signal_source(&Signal::point(axis, &object.to_string()))
            }
            Signal::Axis { axis, object } => {
                let setup = self.source(axis)?.setup();
                let device = self.in_exchange(setup.identity.drive.position)?;
                let moved = ObjectAddress::new(setup.offset.apply(object.index), object.subindex);
                mapped(&setup.layout, moved, *object, device, setup.scale, signal)
            }
            Signal::State { axis } => {
                let setup = self.source(axis)?.setup();
                let device = self.in_exchange(setup.identity.drive.position)?;
                let object = obj::STATUSWORD.offset(setup.offset);
                let field = setup.layout.input(object);
                let field = field.map_err(|error| NetworkError::Declaration(error.to_string()))?;
                let place = field.place();
                Ok((SignalSource::State { device, place }, String::new()))
            }
            Signal::Device { position, object } => {
                let device = self.in_exchange(*position)?;
                let mut axes = self.axes.iter().map(AxisSource::setup);
                if let Some(setup) = axes.find(|setup| setup.identity.drive.position == *position) {
                    return mapped(
                        &setup.layout,
                        *object,
                        *object,
                        device,
                        AxisScale::COUNTS,
                        signal,
                    );
                }
                let mut ios = self.ios.iter();
                let io = ios.find(|io| io.device().position == *position);
                let point =
                    io.and_then(|io| io.points().iter().find(|point| point.object == *object));
                match point {
                    Some(point) => Ok(point_source(device, point)),
                    None => Err(not_mapped(signal)),
                }
            }
            Signal::Point { io, point } => {
                if let Some(signal) = self.with_point_in_name(io, point) {
                    return self.signal_source(&signal);
                }
                let io = find_io(&self.ios, io).map_err(|error| match self.source(io) {
                    Ok(_) => NetworkError::Declaration(no_signal(io, point)),
                    Err(_) => error,
                })?;
                let device = self.in_exchange(io.device().position)?;
                let object = point.parse::<ObjectAddress>();
                let by_name = io.points().iter().find(|known| known.name == *point);
                let by_object = io.points().iter().find(|known| Ok(known.object) == object);
                match by_name.or(by_object) {
                    Some(point) => Ok(point_source(device, point)),
                    None => Err(not_mapped(signal)),
                }
            }
        }
    }

    /// What a text says that was split at the first of several points, where a name has one: `1.2.position` of the axis `1.2`.
    fn with_point_in_name(&self, io: &str, point: &str) -> Option<Signal> {
        if find_io(&self.ios, io).is_ok() {
            return None;
        }
        let whole = format!("{io}.{point}");
        let value = |name| whole.strip_prefix(name)?.strip_prefix('.');
        let of_axis = self.axes.iter().find_map(|source| {
            let axis = source.name().to_owned();
            match format!("axis.{}", value(source.name())?).parse() {
                Ok(Signal::Axis { object, .. }) => Some(Signal::Axis { axis, object }),
                Ok(Signal::State { .. }) => Some(Signal::State { axis }),
                _ => None,
            }
        });
        let mut ios = self.ios.iter().map(Io::name);
        of_axis.or_else(|| ios.find_map(|io| Some(Signal::point(io, value(io)?))))
    }

    /// The place in the exchange of the device at this position of the line.
    fn in_exchange(&self, position: u16) -> Result<usize, NetworkError> {
        let mut positions = self.positions.iter();
        positions.position(|at| *at == position).ok_or_else(|| {
            let text = format!("no device at position {position} of the line was declared");
            NetworkError::Declaration(text)
        })
    }

    /// The inputs and outputs of the devices that are no drives.
    #[must_use]
    pub fn ios(&self) -> &[Io] {
        &self.ios
    }

    /// The latest events of the network, the oldest first, each with its number from 0: up to 64. Those of
    /// [`Network::events`](crate::Network::events) are not taken by it.
    #[must_use]
    pub fn recent_events(&self) -> Vec<(u64, NetworkEvent)> {
        self.control.recent.read()
    }

    /// The latest emergencies of all drives, the oldest first, each with its number from 0: up to 64. Those of
    /// [`Network::all_emergencies`](crate::Network::all_emergencies) are not taken by it.
    #[must_use]
    pub fn recent_emergencies(&self) -> Vec<(u64, DriveEmergency)> {
        self.emergencies.recent()
    }

    /// Stops one axis, in the next frame. It does not wait for the standstill.
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if no axis has this name.
    pub fn stop_axis(&self, name: &str, stop: StopRequest) -> Result<(), NetworkError> {
        self.source(name)?.request_stop(stop);
        Ok(())
    }

    pub(super) fn source(&self, name: &str) -> Result<&AxisSource, NetworkError> {
        find_axis(&self.axes, name)
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

/// Where this object of a drive lies. `known_as`: by the numbering of its first axis, which tells type and unit.
fn mapped(
    layout: &Layout,
    object: ObjectAddress,
    known_as: ObjectAddress,
    device: usize,
    scale: AxisScale,
    signal: &Signal,
) -> Result<(SignalSource, String), NetworkError> {
    let find = |direction| layout.find(direction, object.index, object.subindex);
    let inputs = find(Direction::Inputs).map(|place| (true, place));
    let place = inputs.or_else(|| find(Direction::Outputs).map(|place| (false, place)));
    let (is_input, place) = place.ok_or_else(|| not_mapped(signal))?;
    let known = obj::all()
        .into_iter()
        .find(|known| known.address() == known_as);
    let (data_type, scaled) = known.map_or((DataType::U32, ObjectUnit::None), |known| {
        (known.data_type, known.unit)
    });
    let unit = match scaled {
        ObjectUnit::Position => scale.unit().to_owned(),
        ObjectUnit::Velocity => format!("{}/s", scale.unit()),
        ObjectUnit::Acceleration => format!("{}/s²", scale.unit()),
        _ => String::new(),
    };
    let source = SignalSource::Value {
        device,
        is_input,
        place,
        data_type,
        scaled,
        scale,
    };
    Ok((source, unit))
}

fn point_source(device: usize, point: &IoPoint) -> (SignalSource, String) {
    let source = SignalSource::Value {
        device,
        is_input: point.direction == Direction::Inputs,
        place: point.place,
        data_type: DataType::U32,
        scaled: ObjectUnit::None,
        scale: AxisScale::COUNTS,
    };
    (source, String::new())
}

fn not_mapped(signal: &Signal) -> NetworkError {
    NetworkError::Declaration(format!(
        "`{signal}` cannot be recorded: it is not in the process data; map it, or read it by SDO"
    ))
}
