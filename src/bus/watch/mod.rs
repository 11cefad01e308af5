//! What happens while cycles run, and what a program's thread and the bus thread share beside the axes: stops of all axes, the end, events.
//!
//! It follows the AL states and the working counters, reads the error counters of the ports, and notes what happens to axes. It reports
//! through [`Control`], and must not change a device: that is `network`.

use std::{
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, AtomicU8, Ordering},
    },
    task::Waker,
    thread::JoinHandle,
    time::Duration,
};

use crossbeam_queue::SegQueue;
use smol::channel::{Receiver, Sender};

use super::{
    cycle::{
        Cycle, CycleTick, DriveData, SeenState,
        black_box::{AxisIncident, BlackBox},
        statistics::{Counters, Statistics},
    },
    device::progress::StepDone,
    error::{AlState, AlStatus, MovingAxis, NetworkError, RegisterError},
    event::{DeviceFinding, Finding, Miscounted, NetworkEvent, Recovered},
    line::KnownLine,
    log::{AxisChange, AxisRecord, DriveChange, Log, LogRecord},
    requests::{
        Context, SLOTS,
        registers::{self, Registers},
        sync_managers::{Area, AreaDirection},
    },
};
use crate::{
    StopRequest,
    axis::WorkingCounter,
    axis::{AxisIdentity, LivenessWatch, Snapshot},
    coe::DriveId,
    ds402::{Controlword, State},
    esc,
    parameters::ParameterSet,
    sync::Recent,
    units::AxisScale,
    wakes::{Waiters, Wakes},
};

/// Network events that are kept for a program that does not look, beside four for each device: those of a whole line come at once.
const EVENTS: usize = 64;
const EVENTS_OF_A_DEVICE: usize = 4;
/// Of these, how many black boxes may take: what happened goes out before how.
const BLACK_BOXES: usize = 32;
/// Questions that may wait for the bus thread.
const QUESTIONS: usize = 16;

/// What a program asks of the bus thread.
pub(in crate::bus) enum Question {
    /// The last cycles of the axis at this place.
    BlackBox(usize, Sender<BlackBox>),
    /// The error counters of all ports.
    Ports(Sender<Result<Vec<DevicePorts>, RegisterError>>),
    /// The AL states of all SubDevices.
    States(Sender<Result<Vec<SeenDevice>, RegisterError>>),
    /// That the device at this place of the exchange be brought back into OP, and its progress be reported.
    Recover(
        usize,
        Sender<StepDone>,
        Sender<Result<Recovered, NetworkError>>,
    ),
    /// The same with the drive that was put there in place of another one, if it has this serial number: it gets these parameters.
    Replace(
        usize,
        (u32, ParameterSet),
        Sender<StepDone>,
        Sender<Result<Recovered, NetworkError>>,
    ),
}

#[derive(Debug)]
pub(in crate::bus) struct Control {
    shutdown: AtomicBool,
    stop: AtomicU8,
    watches: SegQueue<LivenessWatch>,
    waker: OnceLock<Waker>,
    pub counters: Arc<Counters>,
    pub tick: Arc<CycleTick>,
    pub wakes: Wakes,
    /// The program's futures that wait for what the bus thread sends.
    pub waiters: Arc<Waiters>,
    pub events: (Sender<NetworkEvent>, Receiver<NetworkEvent>),
    pub recent: Recent<NetworkEvent>,
    pub questions: (Sender<Question>, Receiver<Question>),
    /// At the end, the axes that were not seen to stand.
    pub left_moving: OnceLock<Vec<MovingAxis>>,
}

impl Control {
    /// For so many devices.
    pub fn new(devices: usize, wakes: Wakes) -> Arc<Self> {
        Arc::new(Self {
            shutdown: AtomicBool::new(false),
            stop: AtomicU8::new(0),
            watches: SegQueue::new(),
            waker: OnceLock::new(),
            counters: Arc::default(),
            tick: CycleTick::new(&wakes),
            waiters: wakes.waiters(),
            wakes,
            events: smol::channel::bounded(EVENTS + EVENTS_OF_A_DEVICE * devices),
            recent: Recent::default(),
            questions: smol::channel::bounded(QUESTIONS),
            left_moving: OnceLock::new(),
        })
    }

    /// Lets requests end the link's wait.
    pub fn set_waker(&self, waker: Waker) {
        // A second one would be of the same loop.
        let _ = self.waker.set(waker);
    }

    /// What the bus thread has counted, and what the wakers did.
    pub fn statistics(&self) -> Statistics {
        Statistics {
            wakes: self.wakes.statistics(),
            ..self.counters.read()
        }
    }

    pub fn request_stop(&self, stop: StopRequest) {
        self.stop.fetch_or(stop.bits(), Ordering::Release);
    }

    pub fn take_stop(&self) -> StopRequest {
        StopRequest::from_bits_truncate(self.stop.swap(0, Ordering::AcqRel))
    }

    pub fn request_shutdown(&self) {
        self.shutdown.store(true, Ordering::Release);
        if let Some(waker) = self.waker.get() {
            waker.wake_by_ref();
        }
    }

    pub fn is_shutdown(&self) -> bool {
        self.shutdown.load(Ordering::Acquire)
    }

    /// Hands a liveness rule to the bus thread.
    pub fn add_watch(&self, watch: LivenessWatch) {
        self.watches.push(watch);
    }

    pub fn take_watch(&self) -> Option<LivenessWatch> {
        // In most cycles there is none: to see that takes less than to ask the queue for one.
        if self.watches.is_empty() {
            return None;
        }
        self.watches.pop()
    }

    /// Nothing more happens: whoever waits for events learns it once all events are taken.
    pub fn end_events(&self) {
        self.events.0.close();
    }

    /// Keeps the event if there is room; a program that does not look loses the later ones.
    pub fn report(&self, event: NetworkEvent) {
        self.recent.keep(event.clone());
        if matches!(event, NetworkEvent::AxisIncident(_)) && self.events.0.len() >= BLACK_BOXES {
            return;
        }
        drop(self.events.0.try_send(event));
    }
}

/// Ends what was begun when nobody waits for it any more, and waits for its thread: whoever begins again finds the link free.
pub(in crate::bus) struct Guard {
    control: Option<Arc<Control>>,
    thread: Option<JoinHandle<()>>,
}

impl Guard {
    pub const fn new(control: Arc<Control>) -> Self {
        Self {
            control: Some(control),
            thread: None,
        }
    }

    /// Where the program waits for what is being made.
    pub fn waiters(&self) -> Arc<Waiters> {
        let control = self.control.as_ref();
        control.map_or_else(Waiters::direct, |control| Arc::clone(&control.waiters))
    }

    /// Takes the thread in.
    pub fn watch(&mut self, thread: JoinHandle<()>) {
        self.thread = Some(thread);
    }

    /// Waits until a loop that has failed, and the link with it, is gone: whoever tries again finds the link free. A program that turns
    /// the loop itself sees to that itself.
    pub async fn gone(self, over: &Receiver<()>) {
        if self.thread.is_some()
            && let Some(control) = &self.control
        {
            let _ = control.waiters.relay(over.recv()).await;
        }
    }

    /// Ends nothing any more.
    pub fn release(mut self) -> (Option<Arc<Control>>, Option<JoinHandle<()>>) {
        (self.control.take(), self.thread.take())
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        if let Some(control) = &self.control {
            control.request_shutdown();
        }
        if let Some(thread) = self.thread.take() {
            // Only a panic fails it, and that has been reported.
            let _ = thread.join();
        }
    }
}

// Which devices are there and in OP, as cycles and AL states show it: what is reported of it, and what the exchange is to know.

/// What the last cycle showed; `None` when there are no cycles any more.
pub(super) fn look(
    context: &Context,
    control: &Control,
    drives: &[Arc<DriveId>],
    lost: &mut [bool],
) -> Option<(Option<(u8, u16)>, bool)> {
    let mut cycle = context.cycle.borrow_mut();
    let cycle = cycle.as_mut()?;
    let states = drives.iter().zip(cycle.exchange.drives.iter()).zip(lost);
    for ((drive, data), lost) in states {
        if data.lost != *lost {
            *lost = data.lost;
            let change = if data.lost {
                DriveChange::Lost
            } else {
                DriveChange::Back
            };
            report(context, control, drive, change);
        }
    }
    Some((cycle.last.al_status, cycle.last.wrong))
}

/// Logs and reports what happened to a drive.
fn report(context: &Context, control: &Control, drive: &Arc<DriveId>, change: DriveChange) {
    let note = LogRecord::Drive(Arc::clone(drive), change);
    context.log.record(context.time.now(), note);
    control.report(change.of(drive));
}

/// Waits for all of these, whose requests share frames: many devices that do not answer take no longer than one.
pub(super) async fn at_once<F>(
    context: &Context,
    futures: impl Iterator<Item = F>,
) -> Vec<F::Output>
where
    F: Future<Output: 'static> + 'static,
{
    let tasks: Vec<_> = futures.filter_map(|future| context.spawn(future)).collect();
    let mut results = Vec::with_capacity(tasks.len());
    for task in tasks {
        results.push(task.await);
    }
    results
}

/// Looks whether a device has left OP, or is back in it, and takes in at once what was seen: a moment later it may be on its way back.
pub(super) async fn read_state(
    context: Context,
    control: Arc<Control>,
    place: usize,
    station: u16,
    id: Arc<DriveId>,
) {
    match registers::status(&context.registers, station).await {
        Ok(status) => note_state(&context, &control, place, &id, status),
        // It is reported as lost by its process data. Of one without inputs a working counter of 0 may be that of outputs
        // closed since it left OP: but not where nobody is there.
        Err(RegisterError::NotAnswered) => {
            let mut cycle = context.cycle.borrow_mut();
            if let Some(data) = data_of(&mut cycle, place)
                && data.inputs.is_empty()
                && data.seen != SeenState::Op
            {
                data.seen = SeenState::None;
            }
        }
        Err(_) => {}
    }
}

/// The share of the exchange that the device at this place has; `None` when there are no cycles any more.
pub(super) fn data_of(cycle: &mut Option<Cycle>, place: usize) -> Option<&mut DriveData> {
    cycle.as_mut()?.exchange.drives.get_mut(place)
}

/// Takes in what AL state a device was seen in, and reports it if it has left OP or is back.
pub(super) fn note_state(
    context: &Context,
    control: &Control,
    place: usize,
    device: &Arc<DriveId>,
    status: AlStatus,
) {
    let mut cycle = context.cycle.borrow_mut();
    let Some(drives) = cycle.as_mut().map(|cycle| &mut cycle.exchange.drives) else {
        return;
    };
    let Some(data) = drives.get_mut(place).filter(|data| !data.away) else {
        return;
    };
    let seen = SeenState::of(status);
    let in_op = seen == SeenState::Op;
    let left_op = status.error.filter(|_| !in_op);
    let is_new = data.left_op != left_op;
    data.left_op = left_op;
    drives.doubted |= is_new;
    let Some(data) = drives.get_mut(place) else {
        return;
    };
    // Of one that is lost, whose registers alone answer, the process data show when it is back.
    if in_op && data.lost {
        return;
    }
    let before = core::mem::replace(&mut data.seen, seen);
    // One that was lost may come back fallen.
    if before != SeenState::None && (before == SeenState::Op) == in_op {
        return;
    }
    let change = if in_op {
        DriveChange::InOp
    } else {
        DriveChange::LeftOp(status)
    };
    report(context, control, device, change);
}

// What happens to axes, also what no handle waits for: for the log, and for the black boxes of those that have trouble.
//
// A cycle in which nothing happens costs a comparison for each axis; what has happened is noted and written elsewhere
// ([`Log`]).

/// Troubles that are kept until somebody asks, for each axis: all of a line may come in one cycle.
const INCIDENTS_OF_AN_AXIS: usize = 2;

/// Notes what happens to the axes, in the order in which it happens.
pub(super) struct TransitionLog {
    axes: Vec<(Arc<AxisIdentity>, AxisScale)>,
    seen: Vec<Option<ShownState>>,
    log: Log,
    unfed: bool,
    /// What came upon which axis since somebody asked.
    incidents: Vec<(usize, AxisIncident)>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct ShownState {
    state: State,
    halted: bool,
    lost: bool,
    slipped: bool,
}

impl TransitionLog {
    pub fn new(axes: impl Iterator<Item = (AxisIdentity, AxisScale)>, log: Log) -> Self {
        let axes: Vec<_> = axes.map(|(axis, scale)| (Arc::new(axis), scale)).collect();
        Self {
            seen: vec![None; axes.len()],
            incidents: Vec::with_capacity(INCIDENTS_OF_AN_AXIS * axes.len()),
            axes,
            log,
            unfed: false,
        }
    }

    /// Notes what is new in this axis' snapshot.
    pub fn look(&mut self, now: Duration, index: usize, snapshot: &Snapshot) {
        let Some(seen) = self.seen.get_mut(index) else {
            return;
        };
        let new = ShownState {
            state: snapshot.state,
            halted: snapshot.halted,
            lost: snapshot.lost,
            slipped: snapshot.slipped,
        };
        let before = seen.replace(new);
        if before != Some(new) {
            let incident = before.and_then(|before| new.incident_since(before));
            if let Some(incident) = incident
                && self.incidents.len() < self.incidents.capacity()
            {
                self.incidents.push((index, incident));
            }
            if let Some(axis) = self.axes.get(index) {
                note_changes(&self.log, now, axis, before, snapshot);
            }
        }
    }

    /// Notes that the program stopped all axes.
    pub fn stop_of_all(&self, now: Duration, stop: StopRequest) {
        if !stop.is_empty() {
            self.log.record(now, LogRecord::StopOfAll(stop));
        }
    }

    /// Notes that the program no longer says that it is alive, once each time.
    pub fn liveness(&mut self, now: Duration, expired: bool) {
        if expired && !self.unfed {
            self.log.record(now, LogRecord::Unfed);
        }
        self.unfed = expired;
    }

    /// What came upon which axis since the last time, in that order.
    pub fn take_incidents(&mut self) -> impl Iterator<Item = (usize, AxisIncident)> + '_ {
        self.incidents.drain(..)
    }
}

impl ShownState {
    fn incident_since(self, before: Self) -> Option<AxisIncident> {
        if self.lost && !before.lost {
            Some(AxisIncident::Lost)
        } else if self.state.is_fault() && !before.state.is_fault() {
            Some(AxisIncident::Fault)
        } else if self.slipped && !before.slipped {
            Some(AxisIncident::Slipped)
        } else {
            None
        }
    }
}

/// A note for what has changed. A fault, a loss and a state that ends a halt are one event each, and so one line.
fn note_changes(
    log: &Log,
    now: Duration,
    (axis, scale): &(Arc<AxisIdentity>, AxisScale),
    before: Option<ShownState>,
    snapshot: &Snapshot,
) {
    let note = |change| {
        let note = AxisRecord {
            axis: Arc::clone(axis),
            scale: *scale,
            change,
            from: before.map(|seen| seen.state),
            to: snapshot.state,
            statusword: snapshot.statusword,
            controlword: snapshot.controlword,
            position: snapshot.position,
        };
        log.record(now, LogRecord::Axis(note));
    };
    if before.map_or(snapshot.lost, |seen| seen.lost != snapshot.lost) {
        note(if snapshot.lost {
            AxisChange::Lost
        } else {
            AxisChange::Back
        });
    }
    if before.map(|seen| seen.state) != Some(snapshot.state) {
        let had_fault = before.is_some_and(|seen| seen.state.is_fault());
        note(match snapshot.state.is_fault() {
            true if had_fault => AxisChange::InFault,
            true => AxisChange::Fault {
                following_error: snapshot.shows_following_error(),
            },
            false => AxisChange::State,
        });
    }
    if snapshot.slipped && before.is_some_and(|seen| !seen.slipped) {
        note(AxisChange::Slipped);
    }
    if before.is_some_and(|seen| seen.halted != snapshot.halted) {
        let commands_operation = snapshot.controlword.contains(Controlword::ENABLE_OPERATION);
        if snapshot.halted {
            note(AxisChange::Halted);
        } else if snapshot.state == State::OperationEnabled && commands_operation && !snapshot.lost
        {
            note(AxisChange::Resumed);
        }
    }
}

// A datagram whose working counter stays wrong although its devices answer: who shares it, and what the registers of each show.

/// Looks for such datagrams, and reports each once.
pub(super) struct MiscountWatch {
    known: Vec<WorkingCounter>,
}

impl MiscountWatch {
    pub const fn new() -> Self {
        Self { known: Vec::new() }
    }

    /// Has what is new looked into, beside the cycles.
    pub fn look(
        &mut self,
        context: &Context,
        control: &Arc<Control>,
        devices: &[(u16, Arc<DriveId>)],
    ) {
        let mut cycle = context.cycle.borrow_mut();
        let Some(cycle) = cycle.as_mut() else { return };
        let all = || cycle.exchange.miscounted();
        let known = &mut self.known;
        known.retain(|known| all().any(|(counter, ..)| counter.datagram == known.datagram));
        for (counter, lasts, places) in all() {
            if !lasts || known.iter().any(|known| known.datagram == counter.datagram) {
                continue;
            }
            known.push(counter);
            let sharing = places.filter_map(|place| devices.get(place).cloned());
            let looking = look_closer(
                context.clone(),
                Arc::clone(control),
                counter,
                sharing.collect(),
            );
            if let Some(task) = context.spawn(looking) {
                task.detach();
            }
        }
    }
}

async fn look_closer(
    context: Context,
    control: Arc<Control>,
    counter: WorkingCounter,
    sharing: Vec<(u16, Arc<DriveId>)>,
) {
    let looks = sharing.iter().map(|(station, _)| {
        let (registers, station) = (context.registers.clone(), *station);
        async move { registers_of(&registers, station).await }
    });
    let findings = at_once(&context, looks).await;
    let devices = sharing.iter().zip(findings);
    let devices = devices.map(|((_, id), findings)| DeviceFinding {
        device: DriveId::clone(id),
        findings,
    });
    let miscounted = Arc::new(Miscounted {
        counter,
        devices: devices.collect(),
    });
    let note = LogRecord::Miscounted(Arc::clone(&miscounted));
    context.log.record(context.time.now(), note);
    control.report(NetworkEvent::Miscounted(miscounted));
}

/// What of a device is not as it was set.
async fn registers_of(registers: &Registers, station: u16) -> Vec<Finding> {
    let mut findings = Vec::new();
    match registers::status(registers, station).await {
        Ok(status) if status.state == AlState::Op && status.error.is_none() => {}
        Ok(status) => findings.push(Finding::State(status)),
        Err(error) => return vec![Finding::Register(error)],
    }
    for (area, direction) in registers.areas(station) {
        match compare(registers, station, &area, direction).await {
            Ok(found) => findings.extend(found),
            Err(error) => {
                findings.push(Finding::Register(error));
                break;
            }
        }
    }
    findings
}

async fn compare(
    registers: &Registers,
    station: u16,
    area: &Area,
    direction: AreaDirection,
) -> Result<Vec<Finding>, RegisterError> {
    let mut findings = Vec::new();
    if !area.is_managed(registers, station, direction).await? {
        findings.push(Finding::SyncManager(area.number()));
    }
    if !area.is_mapped(registers, station, direction).await? {
        findings.push(Finding::Fmmu(area.fmmu()));
    }
    Ok(findings)
}

// The error counters of the devices' ports: which cable, plug or device damages frames.

/// So many devices are asked at once: half of the slots, so that everybody else's requests find one.
const AT_ONCE: usize = SLOTS / 2;

/// The error counters of one SubDevice. Each stops at 255, and stays until the device is switched off.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DevicePorts {
    /// Its place in the line, from 0.
    pub position: u16,
    /// The counters of its ports 0 to 3. Frames come in from the MainDevice at port 0.
    pub ports: [PortErrors; 4],
    /// Frames in which the processing unit found an error of format (030Ch); `None` where the device does not count them.
    pub processing_unit: Option<u8>,
    /// Errors of the interface to the device's own processor (030Dh); `None` where the device does not count them.
    pub process_data_interface: Option<u8>,
}

/// The error counters of one port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct PortErrors {
    /// Frames with a wrong checksum or length that came in here first (0300h, 0302h and so on).
    pub invalid_frames: u8,
    /// Damaged symbols that came in here (0301h, 0303h and so on): the cable to this port, its plugs, or the device at its
    /// other end.
    pub physical: u8,
    /// Frames that came in here damaged, and that a device before had found out already (0308h to 030Bh): not this cable.
    pub forwarded: u8,
    /// How often the link was lost (0310h to 0313h).
    pub lost_links: u8,
}

impl PortErrors {
    /// Whether nothing was counted.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        *self == Self::default()
    }
}

impl DevicePorts {
    /// By the registers from 0300h on: all 20, or the first 8.
    fn of(position: u16, registers: &[u8]) -> Self {
        let at = |register: usize| registers.get(register).copied();
        Self {
            position,
            ports: core::array::from_fn(|port| PortErrors {
                invalid_frames: at(2 * port).unwrap_or(0),
                physical: at(2 * port + 1).unwrap_or(0),
                forwarded: at(0x08 + port).unwrap_or(0),
                lost_links: at(0x10 + port).unwrap_or(0),
            }),
            processing_unit: at(0x0C),
            process_data_interface: at(0x0D),
        }
    }
}

/// Reads the counters of all SubDevices that answer, in the order of the line.
pub(super) async fn read_port_errors(context: &Context) -> Result<Vec<DevicePorts>, RegisterError> {
    let positions: Vec<_> = (0..context.registers.count().await?).collect();
    let mut devices = Vec::with_capacity(positions.len());
    for positions in positions.chunks(AT_ONCE) {
        let asked = positions.iter().map(|position| {
            let (registers, position) = (context.registers.clone(), *position);
            async move { read_one(&registers, position).await }
        });
        for device in at_once(context, asked).await {
            devices.extend(device?);
        }
    }
    Ok(devices)
}

/// Reads the counters of the SubDevice at this place; `None` if none answers there.
async fn read_one(
    registers: &Registers,
    position: u16,
) -> Result<Option<DevicePorts>, RegisterError> {
    match registers.read_at::<20>(position, esc::ERROR_COUNTERS).await {
        Ok(all) => return Ok(Some(DevicePorts::of(position, &all))),
        Err(RegisterError::NotAnswered) => {}
        Err(error) => return Err(error),
    }
    // Only the first eight are in every ESC.
    match registers.read_at::<8>(position, esc::ERROR_COUNTERS).await {
        Ok(first) => Ok(Some(DevicePorts::of(position, &first))),
        Err(RegisterError::NotAnswered) => Ok(None),
        Err(error) => Err(error),
    }
}

/// A SubDevice of a running line.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct SeenDevice {
    /// As it was found at the start, whether it was declared or not.
    pub device: DriveId,
    /// The AL state that whoever stands at its place shows; `None` where nobody answers there.
    pub status: Option<AlStatus>,
}

/// Reads the AL states of the SubDevices of this line, in its order.
pub(super) async fn read_states(
    context: &Context,
    line: &[DriveId],
) -> Result<Vec<SeenDevice>, RegisterError> {
    let mut seen = Vec::with_capacity(line.len());
    for devices in line.chunks(AT_ONCE) {
        let asked = devices.iter().map(|device| {
            let (registers, place) = (context.registers.clone(), device.position.into());
            async move { registers::status(&registers, KnownLine::station_of(place)).await }
        });
        for (device, status) in devices.iter().zip(at_once(context, asked).await) {
            let status = match status {
                Ok(status) => Some(status),
                Err(RegisterError::NotAnswered) => None,
                Err(error) => return Err(error),
            };
            let device = device.clone();
            seen.push(SeenDevice { device, status });
        }
    }
    Ok(seen)
}

#[cfg(test)]
mod tests {
    use super::{DevicePorts, PortErrors, *};

    #[test]
    fn who_goes_away_while_a_failed_loop_ends_waits_for_its_thread() {
        let (wakes, end) = Wakes::in_turn();
        let control = Control::new(0, wakes);
        drop(end);
        let (alive, over) = smol::channel::bounded(1);
        let gone = Arc::new(AtomicBool::new(false));
        let (of_loop, is_gone) = (Arc::clone(&control), Arc::clone(&gone));
        let mut guard = Guard::new(control);
        guard.watch(std::thread::spawn(move || {
            while !of_loop.is_shutdown() {
                std::thread::yield_now();
            }
            is_gone.store(true, Ordering::Release);
            drop(alive);
        }));
        let given_up = smol::future::poll_once(guard.gone(&over));
        assert_eq!(smol::block_on(given_up), None);
        assert!(gone.load(Ordering::Acquire));
    }

    #[test]
    fn the_registers_are_told_apart_by_port() {
        // ETG.1000.4, 0300h: invalid frames and RX errors in turns, then forwarded, 030Ch, 030Dh, two reserved, lost links.
        let registers = [
            1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 0, 0, 15, 16, 17, 18,
        ];
        let ports = DevicePorts::of(2, &registers);
        let second = PortErrors {
            invalid_frames: 3,
            physical: 4,
            forwarded: 10,
            lost_links: 16,
        };
        assert_eq!((ports.position, ports.ports[1]), (2, second));
        assert_eq!(ports.ports[3].lost_links, 18);
        assert_eq!(ports.processing_unit, Some(13));
        assert_eq!(ports.process_data_interface, Some(14));
        let few = DevicePorts::of(0, &registers[..8]);
        assert_eq!((few.ports[3].physical, few.processing_unit), (8, None));
        assert!(!few.ports[0].is_clean());
    }
}
