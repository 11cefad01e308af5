//! All devices together: the start, the run, the recovery of a device and the end; and the running network, as a program holds it.
//!
//! `builder` takes what a program declares, `bring_up` leads the line into OP, `supervisor` keeps it. `recovery` leads one device back,
//! `reference` its clock, `replacement` what stands in place of it; `hot_connect` lets devices come and go. `axes` steps the cores in each
//! cycle. `scan` looks at a line without using it, and writes EEPROMs of it. It may call every other room of the bus; none calls it.

pub(super) mod axes;
pub(super) mod bring_up;
pub(super) mod builder;
pub(super) mod hot_connect;
pub(super) mod recovery;
mod reference;
mod replacement;
pub(super) mod scan;
pub(super) mod supervisor;
pub(super) mod view;

use std::{
    fmt,
    future::{Future, poll_fn},
    sync::{Arc, Mutex, PoisonError},
    task::Poll,
    thread::JoinHandle,
    time::Duration,
};

use smol::channel::{Receiver, Sender, bounded, unbounded};

use super::{
    cable::CableLoad,
    cycle::{
        CycleClock,
        black_box::BlackBox,
        statistics::{DriveStatistics, Statistics, Timing},
    },
    device::{io::Io, progress::Listener},
    error::{NetworkError, NotStopped, SettingError},
    event::{NetworkEvent, Recovered},
    expected::DevicePlace,
    recorder::{Recorder, Signal},
    watch::{Control, DevicePorts, Question},
};
use crate::{
    Axis, AxisError, Failure, StopRequest,
    axis::{AxisSource, AxisStatistics, Liveness, Pairing},
    coe::{DriveHistory, DriveId, Emergencies, SdoHandle},
    parameters::ParameterSet,
    units::Unit,
    wakes::Waiters,
};
use hot_connect::{GroupState, HotConnect};
use supervisor::{Started, StartedDrive};
use view::NetworkView;

/// Drives in OP, exchanging process data on a thread of their own.
///
/// A device that has left OP, or was lost, is reported ([`NetworkEvent`]) and stays as it is until the program has it brought back
/// ([`recover`](Self::recover)); all others go on.
///
/// Made by [`Network::builder`](Network::builder). When it is dropped all axes are stopped and disabled, the drives
/// leave OP in order, and the thread ends; [`shutdown`](Self::shutdown) does the same and is awaited.
pub struct Network {
    view: NetworkView,
    /// Where all devices of the exchange stand, in its order, and how they were declared.
    places: Vec<(u16, DevicePlace)>,
    groups: Vec<Arc<GroupState>>,
    listener: Listener,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Network {
    pub(in crate::bus) fn new(
        started: Started,
        control: Arc<Control>,
        listener: Listener,
        over: Receiver<()>,
        thread: Option<JoinHandle<()>>,
    ) -> Self {
        let positions = started.places.iter().map(|(at, _)| *at).collect();
        Self {
            view: NetworkView {
                axes: started.axes.into(),
                drives: started.drives.into(),
                control,
                over,
                ring: started.ring,
                ios: started.ios.into(),
                positions,
                emergencies: started.emergencies,
            },
            places: started.places,
            groups: started.groups,
            listener,
            thread: Mutex::new(thread),
        }
    }

    /// A handle of the axis with this name, in the drive's own units.
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if no axis has this name.
    pub fn axis(&self, name: &str) -> Result<Axis, NetworkError> {
        self.view.source(name).map(AxisSource::axis)
    }

    /// A handle of the axis with this name, in the unit in which the axis was declared.
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if no axis has this name, or it was declared in another unit.
    pub fn axis_in<U: Unit>(&self, name: &str) -> Result<Axis<U>, NetworkError> {
        let in_unit = self.view.source(name)?.axis_in();
        in_unit.map_err(|error| NetworkError::Declaration(error.to_string()))
    }

    /// These two axes as a pair, in the drive's own units: see [`Pair`](crate::axis::Pair) for an example.
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if no axis has one of these names.
    pub fn pair(&self, one: &str, other: &str) -> Result<Pairing, NetworkError> {
        Ok(self.axis(one)?.pair_with(self.axis(other)?))
    }

    /// These two axes as a pair, in the unit in which both were declared.
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if no axis has one of these names, or one was declared in another unit.
    pub fn pair_in<U: Unit>(&self, one: &str, other: &str) -> Result<Pairing<U>, NetworkError> {
        Ok(self.axis_in(one)?.pair_with(self.axis_in(other)?))
    }

    /// As [`axis`](Self::axis), for a server beside the program, such as a panel: this handle is not counted among those of the program.
    /// What happens once the program has dropped its last one happens although this exists, and dropping this stops nothing.
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if no axis has this name.
    pub fn uncounted_axis(&self, name: &str) -> Result<Axis, NetworkError> {
        self.view.source(name).map(AxisSource::uncounted_axis)
    }

    /// A handle of every axis, in the order of their declaration.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x").axis("y");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// net.reset_faults().await?;
    /// let axes: Vec<_> = net.axes().collect();
    /// for axis in &axes {
    ///     println!("{}: {:?}", axis.identity(), axis.status().state);
    ///     axis.enable().await?;
    /// }
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    pub fn axes(&self) -> impl Iterator<Item = Axis> + '_ {
        self.view.axes.iter().map(AxisSource::axis)
    }

    /// The drives, in the order of their declaration: each as it was found in the line.
    pub fn drives(&self) -> impl Iterator<Item = &DriveId> + '_ {
        self.view.drives.iter().map(|drive| &drive.id)
    }

    /// Resets the faults of all axes at once, as [`Axis::reset_fault`] does of one. None is enabled by it. Axes without a fault stay as they
    /// are, and so do those of an optional group that is not in the line.
    ///
    /// # Errors
    /// The first error. The faults of all other axes are reset all the same.
    pub async fn reset_faults(&self) -> Result<(), AxisError> {
        let axes = self.uncounted_axes();
        let resets = axes.iter().map(Axis::reset_fault);
        let mut done = all_of(resets).await.into_iter();
        let is_absent = |error: &AxisError| error.failure() == Some(Failure::Absent);
        done.find(|done| matches!(done, Err(error) if !is_absent(error)))
            .unwrap_or(Ok(()))
    }

    fn uncounted_axes(&self) -> Vec<Axis> {
        let sources = self.view.axes.iter();
        sources.map(AxisSource::uncounted_axis).collect()
    }

    /// The inputs and outputs of the device with this name.
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if no device that was declared by `io` has this name.
    pub fn io(&self, name: &str) -> Result<Io, NetworkError> {
        find_io(&self.view.ios, name).cloned()
    }

    /// The optional group with this name.
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if no group was declared by [`NetworkBuilder::optional`](crate::bus::NetworkBuilder::optional) with this name.
    pub fn hot_connect(&self, name: &str) -> Result<HotConnect, NetworkError> {
        let mut groups = self.groups.iter();
        let group = groups.find(|group| group.name == name);
        let names = self.groups.iter().map(|group| group.name.as_str());
        let group = group.ok_or_else(|| unknown("optional group", name, names))?;
        Ok(group.handle(self.clock()))
    }

    /// The time of the cycles: to wait for the next inputs, and for pauses.
    #[must_use]
    pub fn clock(&self) -> CycleClock {
        CycleClock::new(Arc::clone(&self.view.control.tick))
    }

    /// SDO access to the drive at this position in the line, or at the place by which it was declared; `None` if no drive was
    /// declared there. What is mapped into the process data is not to be written by it: the next frame overwrites it.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use servocrab::coe::obj;
    /// let sdo = net.sdo(0).ok_or("no drive was declared there")?;
    /// sdo.write(obj::QUICK_STOP_DECELERATION, 150_000).await?;
    /// assert_eq!(sdo.read(obj::QUICK_STOP_DECELERATION).await?, 150_000);
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    #[must_use]
    pub fn sdo(&self, place: impl Into<DevicePlace>) -> Option<SdoHandle> {
        self.drive(place.into()).map(|drive| drive.sdo.clone())
    }

    /// The emergencies of the drive at this position in the line, or at the place by which it was declared, from its bring-up
    /// on; `None` if no drive was declared there. 64 of them are kept for a program that does not take them.
    ///
    /// They name the cause of a fault also where its error has no code, since the drive has no 603Fh
    /// ([`Failure::Fault`](crate::Failure::Fault)). Of a drive with several axes they do not say whose fault it is.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
    /// # use std::sync::{Arc, Mutex};
    /// # let segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let segment = Arc::new(Mutex::new(segment));
    /// # let wired = Arc::clone(&segment);
    /// # let wire = Wire::new(move |frame, now| wired.lock().unwrap().process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use std::time::Duration;
    /// use servocrab::{Failure, SetPoint, coe::EmergencyReport};
    /// let emergencies = net.emergencies(0).ok_or("no drive was declared there")?;
    /// let x = net.axis("x")?;
    /// x.enable().await?;
    /// let profile_position = x.profile_position().await?;
    /// let motion = profile_position.move_rel(1_000_000, SetPoint::new().velocity(10_000)).await?;
    /// # segment.lock().unwrap().axis_mut(0, 0).unwrap().inject_fault(0x8611);
    /// let Err(error) = motion.done().await else { return Ok(()) };
    /// eprintln!("{error}");
    /// assert!(matches!(error.failure(), Some(Failure::Fault { .. })));
    /// // Why, in the drive's own words. They may come some cycles after the fault; a drive need not have any.
    /// let late = async {
    ///     smol::Timer::after(Duration::from_secs(1)).await;
    ///     None
    /// };
    /// let report = smol::future::or(emergencies.next(), late).await;
    /// if let Some(EmergencyReport::Emergency(cause)) = &report {
    ///     eprintln!("{cause}");
    /// }
    /// # assert_eq!(report.and_then(EmergencyReport::emergency).unwrap().emergency.code, 0x8611);
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    #[must_use]
    pub fn emergencies(&self, place: impl Into<DevicePlace>) -> Option<Emergencies> {
        self.drive(place.into())
            .map(|drive| drive.emergencies.clone())
    }

    /// What the drive at this position in the line, or at the place by which it was declared, remembers of its errors (1003h, 10F3h);
    /// `None` if no drive was declared there. Nothing is read, and nothing cleared, by this.
    #[must_use]
    pub fn history(&self, place: impl Into<DevicePlace>) -> Option<DriveHistory> {
        let drive = self.drive(place.into())?;
        let texts = Arc::clone(&drive.error_texts);
        Some(DriveHistory::new(drive.sdo.clone(), texts))
    }

    /// The emergencies of all drives, from the bring-up on, in the order in which they were read: the same ones as of each
    /// drive, in a queue of their own. 256 of them are kept for a program that does not take them.
    #[must_use]
    pub fn all_emergencies(&self) -> Emergencies {
        self.view.emergencies.clone()
    }

    /// What happens to drives: lost, back, out of OP. All handles take from one queue, so each event goes to one reader. It keeps 64 events,
    /// four more for each device, and black boxes only while fewer than 32 events wait. Later ones are dropped and not counted: take them all
    /// the time, and look at the status of an axis for whether it is lost.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// let events = net.events();
    /// // In a task of its own:
    /// let told = async {
    ///     while let Some(event) = events.next().await {
    ///         eprintln!("{event}");
    ///     }
    /// };
    /// # smol::future::or(told, async {}).await;
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    #[must_use]
    pub fn events(&self) -> NetworkEvents {
        NetworkEvents {
            queue: self.view.control.events.1.clone(),
            waiters: Arc::clone(&self.view.control.waiters),
        }
    }

    /// Brings the device at this position in the line, or at the place by which it was declared, back into OP: a drive, or a device
    /// with inputs and outputs, that [`NetworkEvent::LeftOp`] or [`NetworkEvent::Lost`] has named. All others go on meanwhile.
    ///
    /// Nothing moves by it, and nothing is switched on. What was pending on the axes of the drive ends as
    /// [`BusLost`](crate::Failure::BusLost) before it is in OP, if it had not ended by then. Its outputs are those of
    /// an axis that is switched off. What the program sets in them beside goes out as after the start, until it is set again. Handles stay
    /// valid, and the axes are enabled by [`Axis::enable`]. Outputs of a device that is no drive are 0 until they are set again.
    ///
    /// Its progress is reported as at the start ([`NetworkBuilder::on_progress`](crate::bus::NetworkBuilder::on_progress)), where this is awaited. Several
    /// devices can be brought back at the same time; of one device, one call comes after the other. When the future is dropped
    /// the attempt ends, and the device stays out of OP.
    ///
    /// Where the reference of the distributed clocks was without power, its clock is set to the time of the cycles by this, before the
    /// device follows it: the device may be the reference, or one that follows it. The others keep their cycles and their SYNC0.
    ///
    /// ```no_run
    /// # async fn example(net: servocrab::Network) -> Result<(), Box<dyn std::error::Error>> {
    /// use servocrab::bus::NetworkEvent;
    /// let events = net.events();
    /// while let Some(event) = events.next().await {
    ///     if let NetworkEvent::LeftOp { drive, status } = event {
    ///         eprintln!("{drive} is in {status}: somebody looks after the machine, then");
    ///         let recovered = net.recover(&drive).await?;
    ///         eprintln!("{drive}: {recovered}");
    ///     }
    /// }
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// - [`NetworkError::Drive`]: a step failed, which it names. Or the drive follows a distributed clock and others in front of it are
    ///   missing ([`DriveFault::ClockOfRunningLine`](crate::bus::DriveFault::ClockOfRunningLine)). Or an enabled axis would have to bear a
    ///   step of its clock, whose drive this names ([`DriveFault::ClockStep`](crate::bus::DriveFault::ClockStep)): disable it, then call again.
    /// - [`NetworkError::NotLocked`]: it follows a distributed clock and the reference is silent, has jumped, or is out of step.
    /// - [`NetworkError::WrongLine`]: it is not in the line any more, or another device is in its place. Or the reference clock that it follows
    ///   is not.
    /// - [`NetworkError::Declaration`]: no drive and no device with inputs and outputs was declared there.
    /// - [`NetworkError::Absent`]: it is of an optional group that is not in the line.
    /// - [`NetworkError::Thread`]: the network has ended.
    ///
    /// After an error the device is asked to leave OP. Outputs of one that is no drive stay 0 until a call succeeds, also if it comes back
    /// by itself.
    pub async fn recover(&self, place: impl Into<DevicePlace>) -> Result<Recovered, NetworkError> {
        let index = self.in_exchange(place.into())?;
        let (to_tell, steps) = unbounded();
        let asked = self.ask(|reply| Question::Recover(index, to_tell, reply));
        let told = self.listener.report_until(steps, asked);
        self.view.control.waiters.relay(told).await?
    }

    /// Takes the drive that stands in place of the one of this axis, of all of whose axes it is: it gets the station alias and the parameters
    /// of the old one, and is brought into OP. All others go on meanwhile.
    ///
    /// The new drive is accepted by its serial number. The error of [`recover`](Self::recover) names what stands there, and
    /// `servocrab scan` lists it with the rest of the line. Its vendor and product must be those of the old one, and its revision the same
    /// or a higher one. Where nothing is there with that number, or something else, nothing is written.
    ///
    /// 1. Its station alias is written to its EEPROM where the old one was declared [by alias](crate::bus::DevicePlace::Alias).
    /// 2. In PREOP the parameters of the backup are written and read back ([`ParameterSet::restore`]), and stored
    ///    ([`store`](crate::parameters::store), 1010h) unless the drive does that by itself. From a backup without parameters nothing is
    ///    written and stored.
    /// 3. It is brought up as by `recover`, with start-up lists and mapping. What moves leave out, and what the outputs hold, is as it
    ///    was with the old drive.
    ///
    /// Nothing moves by it, and nothing is switched on. Its axes are disabled and not referenced, also those that were declared with
    /// [`Referencing::AbsoluteEncoder`](crate::Referencing::AbsoluteEncoder), and although it may show that it was homed: home them, or
    /// check where they are and start the network anew.
    ///
    /// Whatever interrupts it, the drive stays out of OP, and the same call begins again from the first step. When it has succeeded, `recover`
    /// takes the new drive for the one of this place, and the same call does nothing if it is in OP. Handles stay valid; events and
    /// [`drives`](Self::drives) go on naming the drive as it was found at the start. A serial number that the program
    /// [declares](crate::bus::NetworkBuilder::drive) is to be changed before the next start.
    ///
    /// ```no_run
    /// # async fn example(net: servocrab::Network) -> Result<(), Box<dyn std::error::Error>> {
    /// use servocrab::parameters::ParameterSet;
    /// let backup = ParameterSet::load("x.toml")?;
    /// // Axes x and y are of one drive.
    /// let replaced = net.replace("x", 0x0042_A7F1, &backup).await?;
    /// println!("{replaced}: home its axes");
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// As of [`recover`](Self::recover), and:
    /// - [`NetworkError::WrongLine`]: what stands there has not this serial number, or is of another vendor or product.
    /// - [`NetworkError::Drive`] with the step and the cause:
    ///   [`OlderRevision`](crate::bus::DriveFault::OlderRevision), [`OtherMailbox`](crate::bus::DriveFault::OtherMailbox),
    ///   [`Restore`](crate::bus::DriveFault::Restore), which may be that the backup is of another kind of drive,
    ///   [`Store`](crate::bus::DriveFault::Store), [`NoImage`](crate::bus::DriveFault::NoImage), and
    ///   [`NotInForce`](crate::bus::DriveFault::NotInForce), after which it is to be switched off and on.
    /// - [`NetworkError::Declaration`]: no axis has this name.
    pub async fn replace(
        &self,
        axis: &str,
        serial: u32,
        backup: &ParameterSet,
    ) -> Result<Recovered, NetworkError> {
        let drive = &self.view.source(axis)?.setup().identity.drive;
        let index = self.in_exchange(drive.into())?;
        let by = (serial, backup.clone());
        let (to_tell, steps) = unbounded();
        let asked = self.ask(|reply| Question::Replace(index, by, to_tell, reply));
        let told = self.listener.report_until(steps, asked);
        self.view.control.waiters.relay(told).await?
    }

    fn in_exchange(&self, place: DevicePlace) -> Result<usize, NetworkError> {
        let mut places = self.places.iter();
        let is_there = |(at, declared): &(u16, DevicePlace)| {
            place == *declared || place == DevicePlace::Position(*at)
        };
        places.position(is_there).ok_or_else(|| {
            NetworkError::Declaration(format!(
                "no drive and no device with inputs and outputs was declared at {place}"
            ))
        })
    }

    async fn ask<T>(
        &self,
        question: impl FnOnce(Sender<T>) -> Question,
    ) -> Result<T, NetworkError> {
        ask(&self.view.control, &self.view.over, question).await
    }

    /// Stops and disables all axes, brings the drives out of OP, and ends the thread. Whoever has the network may ask for it, also
    /// while others wait for something of it: these get an error, and so does everybody who asks for something later.
    ///
    /// The drives stay in OP until every axis that answers stands without power. That takes at most, for the slowest axis,
    /// [`Deadlines::standstill`](crate::axis::Deadlines::standstill), [`Deadlines::disable`](crate::axis::Deadlines::disable), the settle
    /// time of its [`Tolerances`](crate::axis::Tolerances) and a second; then at most a second for each of the four steps down. Dropping the network
    /// does the same; what is an error here is only logged then.
    ///
    /// # Errors
    /// [`NetworkError::StillMoving`] with the axes that did not stand without power by then, or whose drives no longer answered while they
    /// moved: what these do now is up to their own watchdog. The network has ended all the same.
    pub async fn shutdown(&self) -> Result<(), NetworkError> {
        self.view.control.request_shutdown();
        // Ready when the bus loop is gone.
        let _ = self.view.control.waiters.relay(self.view.over.recv()).await;
        self.join();
        match self.view.control.left_moving.get() {
            Some(moving) => Err(NetworkError::StillMoving(moving.clone())),
            None => Ok(()),
        }
    }

    fn drive(&self, place: DevicePlace) -> Option<&StartedDrive> {
        self.view
            .drives
            .iter()
            .find(|drive| drive.place == place || DevicePlace::Position(drive.id.position) == place)
    }

    fn join(&self) {
        let thread = self
            .thread
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let Some(thread) = thread else { return };
        if thread.join().is_err() {
            tracing::error!(target: crate::log_target::BUS, "the bus thread has panicked");
        }
    }
}

fn find_axis<'a>(axes: &'a [AxisSource], name: &str) -> Result<&'a AxisSource, NetworkError> {
    let found = axes.iter().find(|source| source.name() == name);
    found.ok_or_else(|| unknown("axis", name, axes.iter().map(AxisSource::name)))
}

fn find_io<'a>(ios: &'a [Io], name: &str) -> Result<&'a Io, NetworkError> {
    let found = ios.iter().find(|io| io.name() == name);
    found.ok_or_else(|| unknown("io", name, ios.iter().map(Io::name)))
}

/// The error for a name that was not declared, with those that were.
fn unknown<'a>(kind: &str, name: &str, declared: impl Iterator<Item = &'a str>) -> NetworkError {
    let mut text = format!("no {kind} is named `{name}`");
    for (place, name) in declared.enumerate() {
        text += if place == 0 { "; declared: " } else { ", " };
        text += &format!("`{name}`");
    }
    NetworkError::Declaration(text)
}

impl Drop for Network {
    fn drop(&mut self) {
        self.view.control.request_shutdown();
        self.join();
    }
}

impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Network")
            .field(
                "axes",
                &self
                    .view
                    .axes
                    .iter()
                    .map(AxisSource::name)
                    .collect::<Vec<_>>(),
            )
            .finish_non_exhaustive()
    }
}

/// Asks the loop, which answers between its cycles.
async fn ask<T>(
    control: &Control,
    over: &Receiver<()>,
    question: impl FnOnce(Sender<T>) -> Question,
) -> Result<T, NetworkError> {
    let has_ended = || NetworkError::Thread("the network has ended".into());
    let (reply, answer) = bounded(1);
    let answered = async {
        let asked = control.questions.0.send(question(reply)).await;
        asked.map_err(|_| has_ended())?;
        answer.recv().await.map_err(|_| has_ended())
    };
    // Nobody takes what waits once the loop has ended, which it says by this.
    let ended = async {
        let _ = over.recv().await;
        Err(has_ended())
    };
    let told = smol::future::or(answered, ended);
    control.waiters.relay(told).await
}

/// What happens to the drives of a network.
#[derive(Debug, Clone)]
pub struct NetworkEvents {
    queue: Receiver<NetworkEvent>,
    waiters: Arc<Waiters>,
}

impl NetworkEvents {
    /// The next event; `None` once the network is gone.
    pub async fn next(&self) -> Option<NetworkEvent> {
        self.waiters.relay(self.queue.recv()).await.ok()
    }

    /// The next event, if there is one now.
    #[must_use]
    pub fn try_next(&self) -> Option<NetworkEvent> {
        self.queue.try_recv().ok()
    }
}

// What a network shows of itself: counters, histograms, black boxes, the ports of its line.

impl Network {
    /// What the bus thread has counted.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
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
        self.view.statistics()
    }

    /// How steady the cycles were, as histograms.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
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
        self.view.timing()
    }

    /// What the frames of each cycle take on the cable.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
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
        let load = self.view.control.counters.cable.get();
        load.copied().unwrap_or_default()
    }

    /// What was counted of each declared drive.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
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
        self.view.drive_statistics()
    }

    /// What has become of the motions of each axis since the start, and its faults, in the order of their declaration.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use servocrab::{SetPoint, axis::MotionEnd};
    /// let x = net.axis("x")?;
    /// x.enable().await?;
    /// let profile_position = x.profile_position().await?;
    /// let fast = SetPoint::new().velocity(1_000_000);
    /// profile_position.move_rel(1000, fast).await?.done().await?;
    /// assert_eq!(net.axis_statistics()[0].motions, [(MotionEnd::Reached, 1)]);
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    #[must_use]
    pub fn axis_statistics(&self) -> Vec<AxisStatistics> {
        self.view.axis_statistics()
    }

    /// What other threads may see and stop of this network. It does not keep the network running.
    #[must_use]
    pub fn view(&self) -> NetworkView {
        self.view.clone()
    }

    /// The last cycles of the axis with this name: words, positions, what was answered. With each fault they come by
    /// themselves ([`NetworkEvent::AxisIncident`](crate::bus::NetworkEvent::AxisIncident)).
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
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
        let names = || self.view.axes.iter().map(AxisSource::name);
        let index = names().position(|name| name == axis);
        let index = index.ok_or_else(|| unknown("axis", axis, names()))?;
        self.ask(|reply| Question::BlackBox(index, reply)).await
    }

    /// A recorder of these values of every cycle, from now on: of axes in their units, of any mapped object, of inputs and outputs. The
    /// bus thread does nothing for it. See [`Recorder`] and [`Capture`](crate::bus::Capture).
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use std::time::Duration;
    /// let mut recorder = net.recorder(["x.position".parse()?, "x.state".parse()?, "lateness".parse()?])?;
    /// net.axis("x")?.enable().await?;
    /// // Every now and then; the last thousand cycles are there.
    /// smol::Timer::after(Duration::from_millis(50)).await;
    /// let read = recorder.read().ok_or("the network has ended")?;
    /// for cycle in &read.cycles {
    ///     println!("{:?} {:?}", cycle.time, cycle.values);
    /// }
    /// assert_eq!(read.lost, 0);
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`NetworkError::Declaration`] if an axis, a device or a point is not declared, or an object is not mapped.
    pub fn recorder(
        &self,
        signals: impl IntoIterator<Item = Signal>,
    ) -> Result<Recorder, NetworkError> {
        self.view.recorder(signals)
    }

    /// The error counters of all ports of the line, declared or not: which cable or device damages frames. They count from
    /// when a device was switched on, so what counts is how they change.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
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
        self.view.port_errors().await
    }
}

// What stops all axes of a network: at once, from anywhere, or because the program is not alive.

impl Network {
    /// Stops every axis, in the next frame.
    pub fn stop_all(&self, stop: StopRequest) {
        self.view.control.request_stop(stop);
    }

    /// Stops every axis, in the next frame, and waits until all of them stand, no longer than this by the network's time. Asked for by the
    /// call: dropped, the future takes nothing back. An axis that is disabled, or has a fault and stands, has stopped.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use std::time::Duration;
    /// use servocrab::StopRequest;
    /// net.stop_all_and_wait(StopRequest::STOP, Duration::from_secs(5)).await?;
    /// # net.shutdown().await?;
    /// # Ok(())
    /// # })
    /// # }
    /// ```
    ///
    /// # Errors
    /// Of the future: [`NotStopped`] names the axes that were not seen to stand, each with the reason.
    pub fn stop_all_and_wait(
        &self,
        stop: StopRequest,
        within: Duration,
    ) -> impl Future<Output = Result<(), NotStopped>> + use<> {
        self.stop_all(stop);
        let axes = self.uncounted_axes();
        async move {
            let stops = axes.iter().map(|axis| axis.stopped_within(stop, within));
            let failed = all_of(stops).await.into_iter().filter_map(Result::err);
            // A tool that is not in the line cannot be seen to stop.
            let stands = |error: &AxisError| {
                let failure = error.failure();
                matches!(failure, Some(Failure::Fault { .. } | Failure::Absent))
            };
            let axes: Vec<_> = failed.filter(|error| !stands(error)).collect();
            if axes.is_empty() {
                Ok(())
            } else {
                Err(NotStopped { axes })
            }
        }
    }

    /// Stops every axis from anywhere: signal handlers, panic hooks, other threads.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use servocrab::StopRequest;
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
            control: Arc::clone(&self.view.control),
        }
    }

    /// Has every axis halt when the program does not feed the returned rule for this time, or drops it. From then on, until it is fed,
    /// ended, or another takes its place, nothing is enabled, resumed or started
    /// ([`Failure::LivenessExpired`](crate::Failure::LivenessExpired)); stops, `disable` and `reset_fault` work all the time.
    /// What has halted goes on only by `resume`.
    ///
    /// There is one rule: the last one that was asked for.
    ///
    /// ```
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # use servocrab::{DriveConfig, Network, drives, link::Wire};
    /// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::akd2g());
    /// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
    /// # let drive = DriveConfig::new(drives::akd2g()).axis("x");
    /// # smol::block_on(async {
    /// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
    /// use std::time::Duration;
    /// let alive = net.liveness(Duration::from_millis(200))?;
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
    ///
    /// # Errors
    /// When the time is less than a millisecond or more than an hour: nothing has changed then.
    pub fn liveness(&self, timeout: Duration) -> Result<Liveness, SettingError> {
        builder::within(
            "the network",
            "time of `liveness`",
            timeout,
            builder::LIVENESS,
        )?;
        let (liveness, watch) = Liveness::new(timeout);
        self.view.control.add_watch(watch);
        Ok(liveness)
    }
}

/// Waits for all of them at once.
async fn all_of<F: Future>(futures: impl Iterator<Item = F>) -> Vec<F::Output> {
    let mut futures: Vec<_> = futures.map(Box::pin).collect();
    let mut results: Vec<_> = futures.iter().map(|_| None).collect();
    poll_fn(|cx| {
        for (future, result) in futures.iter_mut().zip(&mut results) {
            if result.is_none()
                && let Poll::Ready(ready) = future.as_mut().poll(cx)
            {
                *result = Some(ready);
            }
        }
        if results.iter().all(Option::is_some) {
            Poll::Ready(())
        } else {
            Poll::Pending
        }
    })
    .await;
    results.into_iter().flatten().collect()
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
