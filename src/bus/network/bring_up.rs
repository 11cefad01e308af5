//! The line from power-on to OP, as one future on the bus thread.

use std::{rc::Rc, sync::Arc, time::Duration};

use tracing::Instrument;

use crate::{
    bus::{
        cable::CableLoad,
        clocks::{
            measure::{self, Clocks},
            sync,
        },
        cycle::{
            Cycle, Stepper,
            exchange::Exchange,
            packing::{InputMarker, Member, Watched, fits_one_frame, logical_addresses},
        },
        device::{
            config::{DriveConfig, Watchdog},
            drive::{DriveSetup, Failed, ReadyDrive},
            io_setup::{IoSetup, ReadyIo},
            progress::Progress,
        },
        error::{AlState, BringUpStep, DriveFault, NetworkError},
        expected::DevicePlace,
        line::{self, Found, loop_is_gone},
        log::LogRecord,
        network::plan::LinePlan,
        requests::{Context, al, registers::Registers},
    },
    coe::{DriveId, SdoHandle},
    parameters::{StartUpList, Transition},
};

/// Complete exchanges before OP is asked for: with the first one every drive has taken valid outputs.
const GOOD_CYCLES: u32 = 1;
/// How long that may take, beside the cycles themselves.
pub(in crate::bus) const EXCHANGE_LIMIT: Duration = Duration::from_secs(2);
/// How long a drive may take into OP (ETG.1020, default timeout of SAFEOP to OP is 10 s).
const OP_LIMIT: Duration = Duration::from_secs(10);

/// The devices of the exchange, in SAFEOP or above. In the exchange the drives are first.
pub(in crate::bus) struct Ready {
    /// All SubDevices of the line, also those that are not in the exchange.
    pub(in crate::bus) line: Vec<DriveId>,
    pub(in crate::bus) drives: Vec<ReadyDrive>,
    pub(in crate::bus) ios: Vec<ReadyIo>,
    /// The distributed clocks, where a drive uses its.
    clocks: Option<Rc<Clocks>>,
}

impl Ready {
    /// Whose clock is the reference, where there is one.
    pub(in crate::bus) fn reference(&self) -> Option<DriveId> {
        Some(self.clocks.as_ref()?.reference.clone())
    }

    /// All of them, in the order of the exchange.
    pub(in crate::bus) fn found(&self) -> impl Iterator<Item = &Found> {
        let drives = self.drives.iter().map(|drive| &drive.found);
        drives.chain(self.ios.iter().map(|io| &io.found))
    }

    /// How they were declared, likewise.
    pub(in crate::bus) fn places(&self) -> impl Iterator<Item = DevicePlace> {
        let drives = self.drives.iter().map(|drive| drive.place);
        drives.chain(self.ios.iter().map(|io| io.place))
    }
}

/// Brings all declared drives and devices with inputs and outputs into SAFEOP; all others stay in PREOP.
pub(in crate::bus) async fn configure(
    context: &Context,
    plan: LinePlan,
    progress: &Rc<Progress>,
) -> Result<Ready, NetworkError> {
    let line = line::discover(context).await?;
    tracing::info!(count = line.len(), "SubDevices in PREOP");
    let mut found = plan.find(context, &line).await?.into_iter();
    let uses_clocks = plan.drives.iter().any(|(_, drive)| drive.clock.is_some());
    let clocks = if uses_clocks {
        measure::measure(context, &line).await?
    } else {
        None
    };
    let mut jobs = Vec::new();
    for ((place, config), found) in plan.drives.into_iter().zip(found.by_ref()) {
        let progress = Rc::clone(progress);
        jobs.push(checked(
            found,
            place,
            config,
            &plan.watchdog,
            plan.cycle,
            clocks.clone(),
            progress,
        )?);
    }
    let mut sizes: Vec<_> = jobs
        .iter()
        .map(|job| {
            let layout = job.mapping.layout();
            (layout.output_bytes(), layout.input_bytes())
        })
        .collect();
    for (job, logical) in jobs.iter_mut().zip(logical_addresses(&sizes)) {
        job.logical = logical;
    }
    let tasks: Option<Vec<_>> = jobs
        .into_iter()
        .map(|job| {
            let id = &job.found.id;
            let span = tracing::info_span!("bring-up", position = id.position, name = id.name);
            context.spawn(job.run(context.clone()).instrument(span))
        })
        .collect();
    let tasks = tasks.ok_or_else(loop_is_gone)?;
    let teaching = clocks.clone().and_then(|clocks| {
        let registers = context.registers.clone();
        context.spawn(async move { clocks.teach(&registers).await })
    });
    // Meanwhile the others tell what they exchange, and get their place behind the drives.
    let ios = plan
        .ios
        .into_iter()
        .zip(found)
        .map(|((place, config), found)| {
            let job = IoSetup {
                found,
                place,
                config,
                watchdog: plan.watchdog.time(plan.cycle),
                patience: plan.watchdog.loss(plan.cycle).stale_cycles,
                mailbox: None,
                progress: Rc::clone(progress),
            };
            job.look(context.clone())
        });
    let mut ios = all(context, ios).await?;
    let behind = sizes.len();
    sizes.extend(ios.iter().map(ReadyIo::sizes));
    let addresses = logical_addresses(&sizes);
    for (io, logical) in ios.iter_mut().zip(addresses.into_iter().skip(behind)) {
        io.logical = logical;
    }
    let ios = ios.into_iter().map(|io| io.into_safe_op(context.clone()));
    let ios = all(context, ios).await?;
    let mut drives = Vec::new();
    for task in tasks {
        drives.push(task.await?);
    }
    if let Some(teaching) = teaching {
        teaching.await;
    }
    Ok(Ready {
        line: line.into_iter().map(|found| found.id).collect(),
        drives,
        ios,
        clocks,
    })
}

/// Waits for all of these, which are under way at the same time.
async fn all<T: 'static, F>(
    context: &Context,
    futures: impl Iterator<Item = F>,
) -> Result<Vec<T>, NetworkError>
where
    F: Future<Output = Result<T, NetworkError>> + 'static,
{
    let tasks: Option<Vec<_>> = futures.map(|future| context.spawn(future)).collect();
    let mut results = Vec::new();
    for task in tasks.ok_or_else(loop_is_gone)? {
        results.push(task.await?);
    }
    Ok(results)
}

/// What is to be done with a drive, if its mapping can be made.
fn checked(
    found: Found,
    place: DevicePlace,
    config: DriveConfig,
    watchdog: &Watchdog,
    cycle: Duration,
    clocks: Option<Rc<Clocks>>,
    progress: Rc<Progress>,
) -> Result<DriveSetup, NetworkError> {
    let mapping = match config.mapping() {
        Ok(mapping) => mapping,
        Err(error) => return Err(found.fault(BringUpStep::Mapping, error.into())),
    };
    let layout = mapping.layout();
    config.log_what_is_not_mapped(&layout, &found.id);
    let (outputs, inputs) = (layout.output_bytes(), layout.input_bytes());
    if !fits_one_frame(outputs, inputs) {
        return Err(found.fault(
            BringUpStep::ProcessData,
            DriveFault::TooLong { outputs, inputs },
        ));
    }
    Ok(DriveSetup {
        found,
        place,
        config,
        mapping,
        logical: 0,
        watchdog: watchdog.time(cycle),
        loss: watchdog.loss(cycle),
        cycle,
        clocks,
        mailbox: None,
        progress,
    })
}

/// Starts the cycles, in step with the reference clock where there is one.
pub(in crate::bus) async fn start_cycles(
    context: &Context,
    ready: &Ready,
    stepper: Box<dyn Stepper>,
    period: Duration,
) -> Result<(), NetworkError> {
    let Ready {
        drives,
        ios,
        line,
        clocks,
    } = ready;
    let members = drives.iter().map(member);
    let members: Vec<_> = members.chain(ios.iter().map(ReadyIo::member)).collect();
    let mailboxes = drives.iter().map(|drive| Watched {
        station: drive.found.station,
        signal: drive.mail.clone(),
    });
    context.counters.count_drives(members.len());
    let further = ios.iter().filter_map(|io| {
        Some(Watched {
            station: io.found.station,
            signal: io.mailbox.as_ref()?.signal.clone(),
        })
    });
    let distribution = clocks.as_ref().map(|clocks| clocks.distribution);
    let exchange = Exchange::new(&members, mailboxes.chain(further).collect(), distribution);
    let exchange = exchange.checked()?;
    let load = CableLoad::of(exchange.lengths(), line.len());
    check_load(load, period)?;
    if load.is_tight(period) {
        tracing::warn!(
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
            check_shifts(drives, exchange.time_on_cable());
            let (first, phase) = sync::first_cycle(context, clocks, period).await?;
            (first, Some(phase))
        }
    };
    context.log.begin_cycles();
    *context.cycle.borrow_mut() = Some(Cycle::new(exchange, stepper, period, first, phase));
    Ok(())
}

/// Warns of drives whose SYNC0 comes before all frames of a cycle, which take so long, have passed.
fn check_shifts(drives: &[ReadyDrive], frames_take: Duration) {
    for drive in drives {
        if let Some(sync0_after) = drive.sync0_after.filter(|after| *after <= frames_take) {
            tracing::warn!(
                drive = %drive.found.id,
                ?sync0_after,
                ?frames_take,
                "SYNC0 comes while frames of the cycle are still on their way: what they bring may count from the next SYNC0 on, \
                 or sooner or later in turn"
            );
        }
    }
}

/// A drive's part in the exchange.
pub(in crate::bus) fn member(drive: &ReadyDrive) -> Member {
    let patience = drive
        .axes
        .iter()
        .map(|axis| axis.config.loss.stale_cycles)
        .min();
    Member {
        logical: drive.logical,
        outputs: drive.layout.output_bytes(),
        inputs: drive.layout.input_bytes(),
        lrw: drive.lrw,
        marker: InputMarker::Statusword,
        patience: patience.unwrap_or(1).max(1),
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
    let synchronised = ready
        .drives
        .iter()
        .filter(|drive| drive.sync0_after.is_some());
    sync::wait_for_lock(context, synchronised.map(|drive| &drive.found), period).await?;
    let drives = ready.drives.iter();
    let drives = drives.map(|drive| (&drive.found, Some(&drive.sdo), &drive.start_up));
    let ios = ready.ios.iter().map(|io| {
        let sdo = io.mailbox.as_ref().map(|mailbox| &mailbox.sdo);
        (&io.found, sdo, &io.start_up)
    });
    let tasks: Option<Vec<_>> = drives
        .chain(ios)
        .map(|(found, sdo, lists)| {
            let registers = context.registers.clone();
            let station = found.station;
            let lists = sdo.map(|sdo| (sdo.clone(), lists.clone()));
            context.spawn(async move { into_op(&registers, station, lists.as_ref()).await })
        })
        .collect();
    let tasks = tasks.ok_or_else(loop_is_gone)?;
    for (place, (task, found)) in tasks.into_iter().zip(ready.found()).enumerate() {
        task.await
            .map_err(|(step, error)| found.clone().fault(step, error))?;
        if let Some(cycle) = &mut *context.cycle.borrow_mut()
            && let Some(data) = cycle.exchange.drives.get_mut(place)
        {
            data.operational = true;
        }
        let note = LogRecord::BroughtUp(Arc::new(found.id.clone()));
        context.log.record(context.time.now(), note);
        progress.step(&found.id, BringUpStep::State(AlState::Op));
    }
    Ok(())
}

/// Brings one device from SAFEOP into OP, with what its start-up lists write there.
pub(in crate::bus) async fn into_op(
    registers: &Registers,
    station: u16,
    lists: Option<&(SdoHandle, Vec<StartUpList>)>,
) -> Result<(), Failed> {
    if let Some((sdo, lists)) = lists {
        for list in lists {
            list.apply(sdo, Transition::SafeOpToOp)
                .await
                .map_err(|error| (BringUpStep::StartUpList, error.into()))?;
        }
    }
    al::climb(registers, station, AlState::SafeOp, AlState::Op, OP_LIMIT)
        .await
        .map_err(|error| (BringUpStep::State(AlState::Op), error.into()))
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
            let silent = cycle.exchange.drives.iter().position(|drive| drive.lost);
            return Err(match ready.found().nth(silent.unwrap_or(0)) {
                Some(found) => found
                    .clone()
                    .fault(BringUpStep::ProcessData, DriveFault::NoExchange(limit)),
                None => NetworkError::NoSubDevice,
            });
        }
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
