//! One drive from PREOP to SAFEOP: identity, start-up list, mapping, parameters, process data, watchdog.
//!
//! The futures of all drives run concurrently.

use std::{rc::Rc, sync::Arc, time::Duration};

use super::{
    AlState, BringUpStep, DevicePlace, DriveFault, NetworkError, al,
    axis_setup::stop_on_loss,
    config::DriveConfig,
    dc::{self, Clocks},
    discovery::Found,
    eeprom,
    log::Note,
    progress::Progress,
    reactor::Context,
    sync_managers::{self, Area, AreaDirection, WatchdogState},
    time::Time,
};
use crate::{
    axis::{AxisConfig, AxisFields, Loss},
    coe::{
        AxisOffset, Clock, Emergencies, ErrorTexts, EthercrabMailbox, MailSignal, MailboxClient,
        MailboxSettings, SdoHandle,
    },
    parameters::{StartUpList, Transition},
    pdo_map::{self, ConfigureError, Layout, Mapping},
    sii::SyncManagerUsage,
};

/// How long a drive may take into SAFEOP (ETG.1020, default timeout of PREOP to SAFEOP is 10 s).
pub(super) const SAFE_OP_LIMIT: Duration = Duration::from_secs(10);

/// A drive in SAFEOP, ready for the exchange.
pub(super) struct ReadyDrive {
    pub(super) found: Found,
    pub(super) place: DevicePlace,
    pub(super) sdo: SdoHandle,
    pub(super) emergencies: Emergencies,
    pub(super) mail: MailSignal,
    pub(super) layout: Layout,
    pub(super) logical: u32,
    pub(super) lrw: bool,
    /// How long after the frames pass the reference clock its SYNC0 comes, where it follows that.
    pub(super) sync0_after: Option<Duration>,
    pub(super) axes: Vec<ReadyAxis>,
    /// What is still to be written in SAFEOP.
    pub(super) start_up: Vec<StartUpList>,
    /// How it is set up once more, by the same mailbox.
    pub(super) again: Job,
}

/// An axis with what was read from its drive.
pub(super) struct ReadyAxis {
    pub(super) name: String,
    pub(super) offset: AxisOffset,
    pub(super) config: AxisConfig,
}

/// What is to be done with one drive.
#[derive(Clone)]
pub(super) struct Job {
    pub(super) found: Found,
    pub(super) place: DevicePlace,
    pub(super) config: DriveConfig,
    pub(super) mapping: Mapping,
    /// The logical address of its outputs; its inputs follow.
    pub(super) logical: u32,
    /// The watchdog's time; none if the program does without.
    pub(super) watchdog: Option<Duration>,
    /// When an axis counts as lost, where the program does not say.
    pub(super) loss: Loss,
    /// The network's cycle.
    pub(super) cycle: Duration,
    /// The line's clocks, where they are used.
    pub(super) clocks: Option<Rc<Clocks>>,
    /// Its mailbox, where that is served already.
    pub(super) mailbox: Option<Mailbox>,
    pub(super) progress: Rc<Progress>,
}

impl Job {
    /// Does it.
    pub(super) async fn run(self, context: Context) -> Result<ReadyDrive, NetworkError> {
        let found = self.found.clone();
        self.steps(&context)
            .await
            .map_err(|(step, error)| found.fault(step, error))
    }

    async fn steps(self, context: &Context) -> Result<ReadyDrive, Failed> {
        let registers = &context.registers;
        let station = self.found.station;
        self.found.note(context, "configuring");
        let done = |step| self.progress.step(&self.found.id, step);
        done(BringUpStep::Identity);
        let sii = Rc::clone(&self.found.sii);
        let error_texts = &self.config.description.error_texts;
        let mailbox = self.mailbox.clone();
        let mailbox = mailbox
            .or_else(|| serve_mailbox(context, &self.found, error_texts.clone()))
            .ok_or((BringUpStep::Sii, DriveFault::NoMailbox))?;
        let sdo = mailbox.sdo.clone();

        if let Some(clock) = &self.config.clock {
            dc::set_types(&sdo, clock, self.cycle)
                .await
                .map_err(|error| (BringUpStep::Clock, error))?;
        }
        for list in &self.config.start_up {
            list.apply(&sdo, Transition::PreOpToSafeOp)
                .await
                .map_err(|error| (BringUpStep::StartUpList, error.into()))?;
        }
        done(BringUpStep::StartUpList);
        let layout = pdo_map::configure(&self.mapping, &sdo)
            .await
            .map_err(|error| (BringUpStep::Mapping, mapping_fault(error)))?;
        done(BringUpStep::Mapping);
        let mut axes = Vec::new();
        for (axis, description) in self.config.axes.iter().zip(&self.config.description.axes) {
            let fields = AxisFields::from_layout(&layout, description.offset)
                .map_err(|error| (BringUpStep::Mapping, error.into()))?;
            let config = self
                .axis_config(&sdo, axis, fields, description.offset)
                .await?;
            stop_on_loss(context, &sdo, axis, description.offset, config.quick_stop).await?;
            axes.push(ReadyAxis {
                name: axis.name.clone(),
                offset: description.offset,
                config,
            });
        }
        done(BringUpStep::Parameters);

        let process_data = |error: DriveFault| (BringUpStep::ProcessData, error);
        let (outputs, inputs) = (layout.output_bytes(), layout.input_bytes());
        let behind = u32::try_from(outputs).unwrap_or(u32::MAX);
        let outputs = sync_managers::area(&sii, SyncManagerUsage::Outputs, outputs, self.logical)
            .map_err(|error| process_data(error.into()))?;
        let inputs = sync_managers::area(
            &sii,
            SyncManagerUsage::Inputs,
            inputs,
            self.logical.saturating_add(behind),
        )
        .map_err(|error| process_data(error.into()))?;
        let watchdog = self.watchdog.is_some();
        outputs
            .write(registers, station, AreaDirection::Outputs { watchdog })
            .await
            .map_err(|error| process_data(error.into()))?;
        inputs
            .write(registers, station, AreaDirection::Inputs)
            .await
            .map_err(|error| process_data(error.into()))?;
        let lrw = sync_managers::takes_lrw(registers, station)
            .await
            .map_err(|error| process_data(error.into()))?;
        arm(
            context,
            station,
            &outputs,
            self.watchdog,
            |expected, got| DriveFault::WatchdogUnarmed { expected, got },
        )
        .await?;
        done(BringUpStep::Watchdog);
        if let Some(clock) = &self.config.clock {
            let position = self.found.id.position;
            let clocks = self.clocks.as_ref();
            dc::start(registers, station, position, clocks, clock, self.cycle)
                .await
                .map_err(|error| (BringUpStep::Clock, error))?;
        }
        eeprom::give_away(registers, station)
            .await
            .map_err(|error| (BringUpStep::Sii, error.into()))?;
        al::climb(
            registers,
            station,
            AlState::PreOp,
            AlState::SafeOp,
            SAFE_OP_LIMIT,
        )
        .await
        .map_err(|error| (BringUpStep::State(AlState::SafeOp), error.into()))?;
        self.found.note(context, "in SAFEOP");
        done(BringUpStep::State(AlState::SafeOp));
        Ok(ReadyDrive {
            found: self.found.clone(),
            place: self.place,
            sdo,
            emergencies: mailbox.emergencies.clone(),
            mail: mailbox.signal.clone(),
            layout,
            logical: self.logical,
            lrw,
            sync0_after: self.config.clock.map(|clock| clock.shift_in(self.cycle)),
            axes,
            start_up: self.config.start_up.clone(),
            again: Self {
                mailbox: Some(mailbox),
                ..self
            },
        })
    }
}

impl Found {
    /// Notes how far its set-up is.
    pub(super) fn note(&self, context: &Context, what: &'static str) {
        let note = Note::SetUp(Arc::new(self.id.clone()), what);
        context.log.note(context.time.now(), note);
    }

    /// The error of a step, with the drive.
    pub(super) fn fault(self, step: BringUpStep, error: DriveFault) -> NetworkError {
        NetworkError::Drive {
            drive: self.id,
            step,
            error: Box::new(error),
        }
    }
}

/// A SubDevice's mailbox that is served.
#[derive(Clone)]
pub(super) struct Mailbox {
    pub(super) sdo: SdoHandle,
    pub(super) emergencies: Emergencies,
    pub(super) signal: MailSignal,
}

/// Begins to serve a SubDevice's mailbox; none if it has no CoE.
pub(super) fn serve_mailbox(
    context: &Context,
    found: &Found,
    error_texts: ErrorTexts,
) -> Option<Mailbox> {
    let mailbox = found
        .sii
        .mailbox
        .filter(|mailbox| mailbox.protocols.coe())?;
    let (client, sdo, emergencies) = MailboxClient::with(
        EthercrabMailbox::new(context.registers.main(), found.station, mailbox),
        TaskClock(Rc::clone(&context.time)),
        MailboxSettings::of(&found.sii, &mailbox),
        found.id.clone(),
        || context.wakes.waiters(),
    );
    let log = context.log.clone();
    let client = client
        .with_error_texts(error_texts)
        .reporting_to(context.emergencies.0.clone())
        .noting_to(Arc::new(move |at, note| log.note(at, Note::Mail(note))));
    let signal = client.signal();
    context.spawn(client.run())?.detach();
    Some(Mailbox {
        sdo,
        emergencies,
        signal,
    })
}

/// A step that failed, and how.
pub(super) type Failed = (BringUpStep, DriveFault);

/// Sets a device's process-data watchdog to this time, or switches it off, and checks what the device holds then.
pub(super) async fn arm(
    context: &Context,
    station: u16,
    outputs: &Area,
    time: Option<Duration>,
    unarmed: impl FnOnce(u16, WatchdogState) -> DriveFault,
) -> Result<(), Failed> {
    let step = BringUpStep::Watchdog;
    let ticks = match time {
        None => 0,
        Some(time) => {
            sync_managers::watchdog_ticks(time).ok_or((step, DriveFault::WatchdogTime(time)))?
        }
    };
    let got = sync_managers::set_watchdog(&context.registers, station, outputs, ticks)
        .await
        .map_err(|error| (step, error.into()))?;
    if time.is_some() && !got.is_armed_with(ticks) {
        return Err((step, unarmed(ticks, got)));
    }
    Ok(())
}

/// The mapping's fault without the drive, which the error around it names.
pub(super) fn mapping_fault(error: ConfigureError) -> DriveFault {
    match error {
        ConfigureError::Refused { step, error } => DriveFault::MappingRefused {
            step,
            error: error.error,
        },
        ConfigureError::Unreadable(error) => DriveFault::Sdo(error.error),
        ConfigureError::Differs(error) => DriveFault::MappingDiffers(error.error),
    }
}

/// The loop's time as mailbox clients take it.
struct TaskClock(Rc<Time>);

impl Clock for TaskClock {
    fn now(&self) -> Duration {
        self.0.now()
    }

    async fn sleep_until(&self, time: Duration) {
        self.0.sleep(time.saturating_sub(self.0.now())).await;
    }
}
