//! The line from power-on to OP, as one future on the bus thread.

use std::{
    hash::{self, Hash, Hasher},
    ops::Range,
    rc::Rc,
    sync::Arc,
    time::Duration,
};

use async_task::Task;
use tracing::Instrument;

use super::builder::LinePlan;
use crate::{
    bus::{
        cable::CableLoad,
        clocks::{self, Clocks},
        cycle::{
            Cycle, Exchange, SeenState, Stepper,
            frame::{Watched, logical_addresses},
        },
        device::{Device, progress::Progress},
        error::{AlState, AtStep, BringUpStep, DriveFault, NetworkError, OfDevice},
        expected::{self, Present},
        line::{self, Found, KnownLine, loop_is_gone},
        log::LogRecord,
        requests::Context,
    },
    coe::DriveId,
    sii::Identity,
};

/// Complete exchanges before OP is asked for: the first one brings inputs, and with the second every drive has outputs that answer to
/// them. An axis that moves is stopped by these; those of the first would switch it off.
const GOOD_CYCLES: u32 = 2;
/// How long that may take, beside the cycles themselves.
pub(in crate::bus) const EXCHANGE_LIMIT: Duration = Duration::from_secs(2);
/// The devices of the exchange, in SAFEOP or above: the drives first.
pub(in crate::bus) struct Ready {
    /// All SubDevices of the line, also those that are not in the exchange.
    pub line: KnownLine,
    /// In the order of the exchange.
    pub devices: Vec<Device>,
    /// So many of them last; the others come and go, and are not there yet.
    pub lasting: usize,
    /// Of each optional group its first drive, and the places of all.
    pub groups: Vec<(DriveId, Range<usize>)>,
    /// The distributed clocks, where a drive uses its.
    pub clocks: Option<Rc<Clocks>>,
}

impl Ready {
    /// Whose clock is the reference, where there is one.
    pub fn reference(&self) -> Option<DriveId> {
        Some(self.clocks.as_ref()?.reference.clone())
    }
}

/// The line, and which device of it each declared one is.
struct Declared {
    /// In the order in which frames reach them, also those of optional groups that have an address.
    physical: Vec<Found>,
    /// Without those of optional groups.
    line: Vec<Found>,
    /// Of each declared device that is not of an optional group.
    found: Vec<Found>,
}

async fn declared_of(
    context: &Context,
    plan: &LinePlan,
    line: Vec<Found>,
) -> Result<Declared, NetworkError> {
    let declared = plan.declared();
    let of_groups: Vec<_> = plan.optional().collect();
    let places: Vec<_> = declared
        .iter()
        .chain(&of_groups)
        .map(|(at, _)| *at)
        .collect();
    let mut present = Vec::new();
    for found in &line {
        let numbers = line::numbers(&context.registers, found.station, &places).await;
        let numbers = numbers.at(BringUpStep::Identity).of(&found.id)?;
        let id = found.id.clone();
        present.push(Present { id, numbers });
    }
    let members = present.iter().map(|present| {
        let mut members = of_groups.iter();
        members.position(|(place, _)| present.says(*place))
    });
    let members: Vec<_> = members.collect();
    let (line, physical) = Found::number_apart(&context.registers, line, &members).await?;
    let present: Vec<_> = present
        .into_iter()
        .zip(&members)
        .filter(|(_, member)| member.is_none())
        .zip(&line)
        .map(|((present, _), found)| Present {
            id: found.id.clone(),
            ..present
        })
        .collect();
    // Where devices come and go, one that nobody expects may be what somebody has put in.
    let is_complete = plan.complete || !plan.groups.is_empty();
    let places = expected::compare(&declared, &present, is_complete)?;
    let found = places.into_iter().filter_map(|place| line.get(place));
    let found = found.cloned().collect();
    Ok(Declared {
        physical,
        line,
        found,
    })
}

/// Brings all declared drives and devices with inputs and outputs into SAFEOP; all others stay in PREOP.
pub(in crate::bus) async fn configure(
    context: &Context,
    plan: LinePlan,
    progress: &Rc<Progress>,
) -> Result<Ready, NetworkError> {
    let line = line::discover(context).await?;
    let Declared {
        physical,
        line,
        mut found,
    } = declared_of(context, &plan, line).await?;
    let ios = found.iter_mut().skip(plan.drives.len());
    read_whole_siis(context, ios.take(plan.ios.len())).await?;
    line::enter_pre_op(context, &line).await?;
    tracing::info!(target: crate::log_target::BUS, count = line.len(), "SubDevices in PREOP");
    let mut found = found.into_iter();
    let uses_clocks = plan.drives.iter().any(|(_, drive)| drive.clock.is_some());
    let clocks = if uses_clocks {
        clocks::measure(context, &physical, line.len()).await?
    } else {
        None
    };
    if let Some(clocks) = &clocks {
        tracing::info!(target: crate::log_target::BUS, reference = %clocks.reference, "distributed clocks are set");
    }
    let times = (&plan.watchdog, plan.cycle);
    let mut drives = Vec::new();
    for ((place, config), found) in plan.drives.into_iter().zip(found.by_ref()) {
        let (clocks, progress) = (clocks.clone(), Rc::clone(progress));
        let drive = Device::drive(context, found, place, config, times, clocks, progress);
        drives.push(drive.await?);
    }
    let mut sizes: Vec<_> = drives.iter().map(Device::sizes).collect();
    let base = if plan.groups.is_empty() {
        0
    } else {
        base_of(&line)
    };
    for (drive, logical) in drives.iter_mut().zip(logical_addresses(base, &sizes)) {
        drive.logical = logical;
    }
    let drives = begin(context, drives, |context, mut drive| async move {
        let id = &drive.found.id;
        let span = tracing::info_span!(target: crate::log_target::DRIVE, "bring-up", position = id.position, name = id.name);
        let steps = async {
            drive.configure(&context).await?;
            drive.enter_safe_op(&context).await?;
            drive.read_axes(&context).await
        };
        let result = steps.instrument(span).await;
        result.of(&drive.found.id).map(|()| drive)
    })?;
    let teaching = clocks.clone().and_then(|clocks| {
        let registers = context.registers.clone();
        context.spawn(async move { clocks.teach(&registers).await })
    });
    // Meanwhile what the others exchange is read, and they get their place behind the drives.
    let ios = plan.ios.into_iter().zip(found);
    let ios = ios
        .map(|((place, config), found)| {
            Device::io(found, place, config, times, Rc::clone(progress))
        })
        .collect();
    let configured = begin(context, ios, |context, mut io| async move {
        let result = io.configure(&context).await;
        result.of(&io.found.id).map(|()| io)
    })?;
    let mut ios = all(configured).await?;
    let behind = sizes.len();
    sizes.extend(ios.iter().map(Device::sizes));
    let addresses = logical_addresses(base, &sizes);
    for (io, logical) in ios.iter_mut().zip(addresses.into_iter().skip(behind)) {
        io.logical = logical;
    }
    let ios = begin(context, ios, |context, mut io| async move {
        let steps = async {
            io.enter_safe_op(&context).await?;
            io.read_axes(&context).await
        };
        let result = steps.await;
        result.of(&io.found.id).map(|()| io)
    })?;
    let ios = all(ios).await?;
    let mut devices = all(drives).await?;
    devices.extend(ios);
    if let Some(teaching) = teaching {
        teaching.await;
    }
    let lasting = devices.len();
    let mut groups = Vec::new();
    let mut numbers = u16::try_from(line.len()).unwrap_or(u16::MAX)..;
    for group in plan.groups {
        let first = devices.len();
        for (place, config) in group.drives {
            let position = numbers.next().unwrap_or(u16::MAX);
            let id = DriveId {
                position,
                name: group.name.clone(),
                identity: Identity::default(),
            };
            let progress = Rc::clone(progress);
            let absent = Device::absent(context, id, place, config, times, progress)?;
            sizes.push(absent.sizes());
            devices.push(absent);
        }
        if let Some(device) = devices.get(first) {
            groups.push((device.found.id.clone(), first..devices.len()));
        }
    }
    let addresses = logical_addresses(base, &sizes).into_iter().skip(lasting);
    for (device, logical) in devices.iter_mut().skip(lasting).zip(addresses) {
        device.logical = logical;
    }
    let optional = devices.iter().skip(lasting).map(|device| device.place);
    let optional = optional.collect();
    Ok(Ready {
        line: KnownLine {
            devices: line.into_iter().map(|found| found.id).collect(),
            optional,
        },
        devices,
        lasting,
        groups,
        clocks,
    })
}

/// Where the process data of a line begin that devices may come into from another one: there they are to lie elsewhere.
fn base_of(line: &[Found]) -> u32 {
    let mut hash = hash::DefaultHasher::new();
    for found in line {
        found.id.identity.hash(&mut hash);
    }
    // A multiple of what the process data of a line may take.
    (hash.finish() as u32 & 0x7FFF) << 16
}

/// Reads the whole SII of these devices at the same time: the names of their inputs and outputs, which of other devices nobody needs.
async fn read_whole_siis(
    context: &Context,
    devices: impl Iterator<Item = &mut Found>,
) -> Result<(), NetworkError> {
    let mut reading = Vec::new();
    for found in devices {
        let (registers, mut whole) = (context.registers.clone(), found.clone());
        let task = context.spawn(async move {
            let read = whole.read_whole_sii(&registers).await;
            read.of(&whole.id).map(|()| whole)
        });
        reading.push((found, task.ok_or_else(loop_is_gone)?));
    }
    for (found, task) in reading {
        *found = task.await?;
    }
    Ok(())
}

/// Steps of a device that are under way.
type UnderWay = Task<Result<Device, NetworkError>>;

/// Begins steps of all these devices at the same time.
fn begin<F>(
    context: &Context,
    devices: Vec<Device>,
    steps: impl Fn(Context, Device) -> F,
) -> Result<Vec<UnderWay>, NetworkError>
where
    F: Future<Output = Result<Device, NetworkError>> + 'static,
{
    let devices = devices.into_iter();
    let tasks = devices.map(|device| context.spawn(steps(context.clone(), device)));
    tasks.collect::<Option<_>>().ok_or_else(loop_is_gone)
}

/// Waits for all of these.
async fn all(tasks: Vec<UnderWay>) -> Result<Vec<Device>, NetworkError> {
    let mut devices = Vec::new();
    for task in tasks {
        devices.push(task.await?);
    }
    Ok(devices)
}

/// Starts the cycles, in step with the reference clock where there is one.
pub(in crate::bus) async fn start_cycles(
    context: &Context,
    ready: &Ready,
    stepper: Box<dyn Stepper>,
    period: Duration,
) -> Result<(), NetworkError> {
    let Ready {
        devices,
        line,
        lasting,
        clocks,
        ..
    } = ready;
    let members = (0..).zip(devices);
    let members = members.map(|(place, device)| device.member(place >= *lasting));
    let members: Vec<_> = members.collect();
    context.counters.count_drives(members.len());
    let mailboxes = devices.iter().filter_map(|device| {
        Some(Watched {
            station: device.found.station,
            signal: device.mailbox.as_ref()?.signal.clone(),
        })
    });
    let distribution = clocks.as_ref().map(|clocks| clocks.distribution);
    let exchange = Exchange::new(&members, mailboxes.collect(), distribution);
    let mut exchange = exchange.checked()?;
    for (place, device) in devices.iter().enumerate() {
        if let (Some(drive), Some(outputs)) =
            (device.as_drive(), exchange.drives.outputs_mut(place))
        {
            drive.held.begin(outputs);
        }
    }
    for place in *lasting..devices.len() {
        exchange.drives.take_away(place);
    }
    let load = CableLoad::of(exchange.lengths(), line.devices.len() + line.optional.len());
    check_load(load, period)?;
    if load.is_tight(period) {
        tracing::warn!(
            target: crate::log_target::BUS,
            frames = load.frames,
            bytes = load.bytes,
            takes = ?load.time(),
            cycle = ?period,
            shortest = ?load.shortest_cycle(),
            "the frames of a cycle take more than the three quarters of it for which they are waited for: on a cable of 100 Mbit/s \
             they will count as lost"
        );
    }
    // A second exchange of the same loop has the same frames.
    let _ = context.counters.cable.set(load);
    let (first, phase) = match clocks {
        None => (context.time.now(), None),
        Some(clocks) => {
            check_shifts(devices, exchange.time_on_cable());
            let (first, phase) = clocks::first_cycle(context, clocks, period).await?;
            (first, Some(phase))
        }
    };
    context.log.begin_cycles();
    *context.cycle.borrow_mut() = Some(Cycle::new(exchange, stepper, period, first, phase));
    Ok(())
}

/// Warns of drives whose SYNC0 comes before all frames of a cycle, which take so long, have passed.
fn check_shifts(drives: &[Device], frames_take: Duration) {
    for drive in drives {
        if let Some(sync0_after) = drive.sync0_after().filter(|after| *after <= frames_take) {
            tracing::warn!(
                target: crate::log_target::DRIVE,
                drive = %drive.found.id,
                ?sync0_after,
                ?frames_take,
                "SYNC0 comes while frames of the cycle are still on their way: what they bring may count from the next SYNC0 on, \
                 or sooner or later in turn"
            );
        }
    }
}

/// Brings all drives from SAFEOP into OP, once complete exchanges have given them valid outputs.
pub(in crate::bus) async fn operate(
    context: &Context,
    ready: &Ready,
    period: Duration,
    progress: &Progress,
) -> Result<(), NetworkError> {
    wait_for_exchange(context, ready, period).await?;
    let devices = || ready.devices.iter().take(ready.lasting);
    let synchronised = devices().filter(|device| device.sync0_after().is_some());
    clocks::wait_for_lock(context, synchronised.map(|device| &device.found), period).await?;
    let tasks = begin(
        context,
        devices().cloned().collect(),
        |context, device| async move {
            let result = device.enter_op(&context).await;
            result.of(&device.found.id).map(|()| device)
        },
    )?;
    for (place, task) in tasks.into_iter().enumerate() {
        let Device { found, .. } = task.await?;
        if let Some(cycle) = &mut *context.cycle.borrow_mut()
            && let Some(data) = cycle.exchange.drives.get_mut(place)
        {
            data.seen = SeenState::Op;
        }
        let note = LogRecord::BroughtUp(Arc::new(found.id.clone()));
        context.log.record(context.time.now(), note);
        progress.step(&found.id, BringUpStep::State(AlState::Op));
    }
    Ok(())
}

async fn wait_for_exchange(
    context: &Context,
    ready: &Ready,
    period: Duration,
) -> Result<(), NetworkError> {
    let limit = EXCHANGE_LIMIT + period * GOOD_CYCLES * 4;
    let started = context.time.now();
    loop {
        context.time.sleep(period / 4).await;
        let cycle = context.cycle.borrow();
        let Some(cycle) = cycle.as_ref() else {
            return Err(NetworkError::Thread("the cycle was ended".into()));
        };
        if cycle.good >= GOOD_CYCLES {
            return Ok(());
        }
        if context.time.now().saturating_sub(started) > limit {
            // The one that does not answer, or else the first, whose working counter is wrong with the others'.
            let mut drives = cycle.exchange.drives.iter();
            let silent = drives.position(|drive| drive.lost && !drive.away);
            return match ready.devices.get(silent.unwrap_or(0)) {
                Some(device) => Err(no_exchange(context, limit, period))
                    .at(BringUpStep::ProcessData)
                    .of(&device.found.id),
                None => Err(NetworkError::NoSubDevice),
            };
        }
    }
}

/// Why there was no complete exchange.
fn no_exchange(context: &Context, limit: Duration, cycle: Duration) -> DriveFault {
    match context.counters.latest() {
        Some(away) => DriveFault::LateFrames { away, cycle },
        None => DriveFault::NoExchange(limit),
    }
}

/// Refuses a cycle that these frames cannot keep.
fn check_load(load: CableLoad, cycle: Duration) -> Result<(), NetworkError> {
    if load.sending > cycle {
        return Err(NetworkError::CycleTooShort { cycle, load });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{CableLoad, NetworkError, check_load};

    const fn us(us: u64) -> Duration {
        Duration::from_micros(us)
    }

    #[test]
    fn a_cycle_that_is_shorter_than_its_frames_is_refused_with_the_numbers() {
        let load = CableLoad::of([1514; 2].into_iter(), 1);
        assert!(check_load(load, us(247)).is_ok());
        let error = check_load(load, us(246)).unwrap_err();
        assert!(matches!(error, NetworkError::CycleTooShort { .. }));
        assert_eq!(
            error.to_string(),
            "a cycle of 246µs cannot be kept: its 2 frames (3028 bytes) take 246.08µs on 100 Mbit/s alone, and their cycle is to be \
             329.44µs at least: make it longer, map less, or divide the line into several networks"
        );
    }
}
