//! The line from power-on to OP, as one future on the bus thread.

use std::{rc::Rc, time::Duration};

use tracing::Instrument;

use super::{
    AlState, BringUpStep, DevicePlace, DriveFault, Expected, NetworkError, Present, al,
    config::{DriveConfig, Watchdog},
    cycle::{Cycle, Stepper},
    dc::{self, Clocks},
    discovery::{self, Found, loop_is_gone},
    drive_setup::{Job, ReadyDrive},
    exchange::Exchange,
    line::ALIAS,
    line_check,
    mailbox_states::Watched,
    packing::{Member, Sign, fits_one_frame, logical_addresses},
    progress::{Listener, Progress},
    reactor::Context,
};
use crate::parameters::Transition;

/// Complete exchanges before OP is asked for: with the first one every drive has taken valid outputs.
const GOOD_CYCLES: u32 = 1;
/// How long that may take, beside the cycles themselves.
const EXCHANGE_LIMIT: Duration = Duration::from_secs(2);
/// How long a drive may take into OP (ETG.1020, default timeout of SAFEOP to OP is 10 s).
const OP_LIMIT: Duration = Duration::from_secs(10);

/// The longest time after which a silent drive must count as lost: until then, nothing that waits for it resolves.
const LONGEST_LOSS: Duration = Duration::from_secs(60);

/// What the program wants of the line.
#[derive(Debug, Clone)]
pub(super) struct LinePlan {
    pub(super) listener: Listener,
    pub(super) cycle: Duration,
    pub(super) drives: Vec<(DevicePlace, DriveConfig)>,
    /// Devices that must be there and are left alone.
    pub(super) others: Vec<(DevicePlace, Expected)>,
    /// No other devices may be there.
    pub(super) complete: bool,
    pub(super) watchdog: Watchdog,
}

impl LinePlan {
    /// What is wrong with the declaration itself.
    pub(super) fn check(&self) -> Result<(), NetworkError> {
        let wrong = |text: String| Err(NetworkError::Declaration(text));
        if self.drives.is_empty() {
            return wrong("no drive was declared".into());
        }
        if self.cycle < Duration::from_micros(50) || self.cycle > Duration::from_secs(1) {
            return wrong(format!(
                "a cycle of {:?} is not between 50 µs and 1 s",
                self.cycle
            ));
        }
        let declared = self.declared();
        for (number, (place, _)) in declared.iter().enumerate() {
            if *place == DevicePlace::Alias(0) {
                return wrong("alias 0 is that of devices without one".into());
            }
            if declared
                .iter()
                .take(number)
                .any(|(other, _)| other == place)
            {
                return wrong(format!("two devices are declared at {place}"));
            }
        }
        let mut names = Vec::new();
        for (place, drive) in &self.drives {
            if let Some(mistake) = drive.mistake() {
                return wrong(format!("drive at {place}: {mistake}"));
            }
            if let Some(mistake) = drive.clock.and_then(|clock| clock.mistake(self.cycle)) {
                return wrong(format!("drive at {place}: {mistake}"));
            }
            for axis in &drive.axes {
                if names.contains(&&axis.name) {
                    return wrong(format!("two axes are named `{}`", axis.name));
                }
                names.push(&axis.name);
                if let Some(loss) = axis.loss {
                    let longest = self
                        .cycle
                        .saturating_mul(loss.stale_cycles.max(loss.undelivered_cycles));
                    if loss.stale_cycles == 0
                        || loss.undelivered_cycles < loss.stale_cycles
                        || longest > LONGEST_LOSS
                    {
                        return wrong(format!(
                            "axis `{}`: {loss:?} at cycles of {:?} is not at least one stale cycle, at most as many as \
                             undelivered ones, and at most {LONGEST_LOSS:?}: nobody may wait longer for a silent drive",
                            axis.name, self.cycle
                        ));
                    }
                }
            }
        }
        Ok(())
    }
}

impl LinePlan {
    /// All devices that must be there: the drives first.
    fn declared(&self) -> Vec<(DevicePlace, Expected)> {
        let drives = self.drives.iter();
        let drives = drives.map(|(place, drive)| (*place, drive.expected()));
        drives.chain(self.others.iter().cloned()).collect()
    }

    /// Which device of the line each declared one is.
    async fn find(&self, context: &Context, line: &[Found]) -> Result<Vec<Found>, NetworkError> {
        let declared = self.declared();
        let by_alias = |(place, _): &_| matches!(place, DevicePlace::Alias(_));
        let needs_alias = declared.iter().any(by_alias);
        let mut present = Vec::new();
        for found in line {
            let alias = if needs_alias {
                let alias = context.registers.read(found.station, ALIAS).await;
                let alias = alias
                    .map_err(|error| found.clone().fault(BringUpStep::Identity, error.into()))?;
                Some(u16::from_le_bytes(alias))
            } else {
                None
            };
            let id = found.id.clone();
            present.push(Present { id, alias });
        }
        let places = line_check::compare(&declared, &present, self.complete)?;
        let found = places.into_iter().filter_map(|place| line.get(place));
        Ok(found.cloned().collect())
    }
}

/// Brings all declared drives into SAFEOP; all others stay in PREOP.
pub(super) async fn configure(
    context: &Context,
    plan: LinePlan,
    progress: &Rc<Progress>,
) -> Result<(Vec<ReadyDrive>, Option<Rc<Clocks>>), NetworkError> {
    let line = discovery::discover(context).await?;
    tracing::info!(count = line.len(), "SubDevices in PREOP");
    let found = plan.find(context, &line).await?;
    let uses_clocks = plan.drives.iter().any(|(_, drive)| drive.clock.is_some());
    let clocks = if uses_clocks {
        dc::measure(context, &line).await?
    } else {
        None
    };
    let mut jobs = Vec::new();
    for (found, (place, config)) in found.into_iter().zip(plan.drives) {
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
    let sizes: Vec<_> = jobs
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
    let mut ready = Vec::new();
    for task in tasks {
        ready.push(task.await?);
    }
    if let Some(teaching) = teaching {
        teaching.await;
    }
    Ok((ready, clocks))
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
) -> Result<Job, NetworkError> {
    let mapping = match config.mapping() {
        Ok(mapping) => mapping,
        Err(error) => return Err(found.fault(BringUpStep::Mapping, error.into())),
    };
    let layout = mapping.layout();
    let (outputs, inputs) = (layout.output_bytes(), layout.input_bytes());
    if !fits_one_frame(outputs, inputs) {
        return Err(found.fault(
            BringUpStep::ProcessData,
            DriveFault::TooLong { outputs, inputs },
        ));
    }
    Ok(Job {
        found,
        place,
        config,
        mapping,
        logical: 0,
        watchdog: watchdog.time(cycle),
        loss: watchdog.loss(cycle),
        cycle,
        clocks,
        progress,
    })
}

/// Starts the cycles, in step with the reference clock where there is one.
pub(super) async fn start_cycles(
    context: &Context,
    drives: &[ReadyDrive],
    clocks: Option<&Clocks>,
    stepper: Box<dyn Stepper>,
    period: Duration,
) -> Result<(), NetworkError> {
    let members: Vec<_> = drives.iter().map(member).collect();
    let mailboxes = drives.iter().map(|drive| Watched {
        station: drive.found.station,
        signal: drive.mail.clone(),
    });
    let distribution = clocks.map(|clocks| clocks.distribution);
    let exchange = Exchange::new(&members, mailboxes.collect(), distribution);
    let (first, phase) = match clocks {
        None => (context.time.now(), None),
        Some(clocks) => {
            let (first, phase) = dc::first_cycle(context, clocks, period).await?;
            (first, Some(phase))
        }
    };
    *context.cycle.borrow_mut() = Some(Cycle::new(exchange, stepper, period, first, phase));
    Ok(())
}

/// A drive's part in the exchange.
fn member(drive: &ReadyDrive) -> Member {
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
        sign: Sign::Statusword,
        patience: patience.unwrap_or(1).max(1),
    }
}

/// Brings all drives from SAFEOP into OP, once complete exchanges have given them valid outputs.
pub(super) async fn operate(
    context: &Context,
    drives: &[ReadyDrive],
    period: Duration,
    progress: &Progress,
) -> Result<(), NetworkError> {
    wait_for_exchange(context, drives, period).await?;
    let synchronised = drives.iter().filter(|drive| drive.synchronised);
    dc::wait_for_lock(context, synchronised.map(|drive| &drive.found), period).await?;
    let tasks: Option<Vec<_>> = drives
        .iter()
        .map(|drive| {
            let registers = context.registers.clone();
            let station = drive.found.station;
            let (sdo, lists) = (drive.sdo.clone(), drive.start_up.clone());
            context.spawn(async move {
                for list in lists {
                    list.apply(&sdo, Transition::SafeOpToOp)
                        .await
                        .map_err(|error| (BringUpStep::StartUpList, error.into()))?;
                }
                al::climb(&registers, station, AlState::SafeOp, AlState::Op, OP_LIMIT)
                    .await
                    .map_err(|error| (BringUpStep::State(AlState::Op), DriveFault::from(error)))
            })
        })
        .collect();
    let tasks = tasks.ok_or_else(loop_is_gone)?;
    for (place, (task, drive)) in tasks.into_iter().zip(drives).enumerate() {
        task.await
            .map_err(|(step, error)| drive.found.clone().fault(step, error))?;
        if let Some(cycle) = &mut *context.cycle.borrow_mut()
            && let Some(data) = cycle.exchange.drives.get_mut(place)
        {
            data.operational = true;
        }
        tracing::info!(drive = %drive.found.id, "in OP");
        progress.step(&drive.found.id, BringUpStep::State(AlState::Op));
    }
    Ok(())
}

async fn wait_for_exchange(
    context: &Context,
    drives: &[ReadyDrive],
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
            return Err(match drives.get(silent.unwrap_or(0)) {
                Some(drive) => drive
                    .found
                    .clone()
                    .fault(BringUpStep::ProcessData, DriveFault::NoExchange(limit)),
                None => NetworkError::NoSubDevice,
            });
        }
    }
}
