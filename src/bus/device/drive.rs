//! One drive from PREOP to SAFEOP: identity, start-up list, mapping, parameters, process data, watchdog.
//!
//! The futures of all drives run concurrently.

use std::{rc::Rc, sync::Arc, time::Duration};

use crate::{
    axis::{AxisConfig, AxisFields, BoxFuture, Loss, ParameterAccess, Tolerances},
    bus::{
        clocks::{measure::Clocks, sync},
        device::{
            config::{AxisDeclaration, DriveConfig, Turn},
            progress::Progress,
        },
        error::{AlState, BringUpStep, DriveFault, NetworkError, WatchdogState},
        expected::DevicePlace,
        line::Found,
        log::LogRecord,
        requests::{
            Context, al, eeprom,
            executor::Time,
            sync_managers::{self, Area, AreaDirection},
        },
    },
    coe::{
        AbortCode, AxisOffset, Clock, DriveError, Emergencies, ErrorTexts, EthercrabMailbox,
        MailSignal, MailboxClient, MailboxSettings, Number, Object, ObjectAddress, Readable,
        SdoError, SdoHandle, obj,
    },
    ds402::{AbortConnection, QuickStopOption, StopOptions, SupportedModes, VelocityWindows},
    parameters::{StartUpList, Transition},
    pdo_map::{self, ConfigureError, Layout, Mapping},
    profile_position::{self, Limits, RelativeBase},
    sii::SyncManagerUsage,
};

/// How long a drive may take into SAFEOP (ETG.1020, default timeout of PREOP to SAFEOP is 10 s).
pub(in crate::bus) const SAFE_OP_LIMIT: Duration = Duration::from_secs(10);

/// A drive in SAFEOP, ready for the exchange.
pub(in crate::bus) struct ReadyDrive {
    pub(in crate::bus) found: Found,
    pub(in crate::bus) place: DevicePlace,
    pub(in crate::bus) sdo: SdoHandle,
    pub(in crate::bus) emergencies: Emergencies,
    pub(in crate::bus) mail: MailSignal,
    pub(in crate::bus) layout: Layout,
    pub(in crate::bus) logical: u32,
    pub(in crate::bus) lrw: bool,
    /// How long after the frames pass the reference clock its SYNC0 comes, where it follows that.
    pub(in crate::bus) sync0_after: Option<Duration>,
    pub(in crate::bus) axes: Vec<ReadyAxis>,
    /// What is still to be written in SAFEOP.
    pub(in crate::bus) start_up: Vec<StartUpList>,
    /// How it is set up once more, by the same mailbox.
    pub(in crate::bus) setup: DriveSetup,
}

/// An axis with what was read from its drive.
pub(in crate::bus) struct ReadyAxis {
    pub(in crate::bus) name: String,
    pub(in crate::bus) offset: AxisOffset,
    pub(in crate::bus) config: AxisConfig,
}

/// What is to be done with one drive.
#[derive(Clone)]
pub(in crate::bus) struct DriveSetup {
    pub(in crate::bus) found: Found,
    pub(in crate::bus) place: DevicePlace,
    pub(in crate::bus) config: DriveConfig,
    pub(in crate::bus) mapping: Mapping,
    /// The logical address of its outputs; its inputs follow.
    pub(in crate::bus) logical: u32,
    /// The watchdog's time; none if the program does without.
    pub(in crate::bus) watchdog: Option<Duration>,
    /// When an axis counts as lost, where the program does not say.
    pub(in crate::bus) loss: Loss,
    /// The network's cycle.
    pub(in crate::bus) cycle: Duration,
    /// The line's clocks, where they are used.
    pub(in crate::bus) clocks: Option<Rc<Clocks>>,
    /// Its mailbox, where that is served already.
    pub(in crate::bus) mailbox: Option<Mailbox>,
    pub(in crate::bus) progress: Rc<Progress>,
}

impl DriveSetup {
    /// Does it.
    pub(in crate::bus) async fn run(self, context: Context) -> Result<ReadyDrive, NetworkError> {
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
            sync::set_types(&sdo, clock, self.cycle)
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
            sync::start(registers, station, position, clocks, clock, self.cycle)
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
            setup: Self {
                mailbox: Some(mailbox),
                ..self
            },
        })
    }
}

impl Found {
    /// Notes how far its set-up is.
    pub(in crate::bus) fn note(&self, context: &Context, what: &'static str) {
        let note = LogRecord::SetUp(Arc::new(self.id.clone()), what);
        context.log.record(context.time.now(), note);
    }

    /// The error of a step, with the drive.
    pub(in crate::bus) fn fault(self, step: BringUpStep, error: DriveFault) -> NetworkError {
        NetworkError::Drive {
            drive: self.id,
            step,
            error: Box::new(error),
        }
    }
}

/// A SubDevice's mailbox that is served.
#[derive(Clone)]
pub(in crate::bus) struct Mailbox {
    pub(in crate::bus) sdo: SdoHandle,
    pub(in crate::bus) emergencies: Emergencies,
    pub(in crate::bus) signal: MailSignal,
}

/// Begins to serve a SubDevice's mailbox; none if it has no CoE.
pub(in crate::bus) fn serve_mailbox(
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
        .noting_to(Arc::new(move |at, note| {
            log.record(at, LogRecord::Mail(note));
        }));
    let signal = client.signal();
    context.spawn(client.run())?.detach();
    Some(Mailbox {
        sdo,
        emergencies,
        signal,
    })
}

/// A step that failed, and how.
pub(in crate::bus) type Failed = (BringUpStep, DriveFault);

/// Sets a device's process-data watchdog to this time, or switches it off, and checks what the device holds then.
pub(in crate::bus) async fn arm(
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
pub(in crate::bus) fn mapping_fault(error: ConfigureError) -> DriveFault {
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

// What is read of each axis of a drive on its way to SAFEOP, and what it does when the process data stop.

impl DriveSetup {
    /// What is read of an axis, and what the program says of it.
    pub(in crate::bus) async fn axis_config(
        &self,
        sdo: &SdoHandle,
        axis: &AxisDeclaration,
        fields: AxisFields,
        offset: AxisOffset,
    ) -> Result<AxisConfig, Failed> {
        let mut config = AxisConfig::new(fields);
        config.traits = self.config.description.traits;
        if let Some(clock) = &self.config.clock {
            // It acts on its process data once for each SYNC0, however short its own cycle is.
            let sync0 = clock.cycle(self.cycle);
            config.traits.drive_cycle = config.traits.drive_cycle.max(sync0);
        }
        config.mode = axis.mode;
        config.deadlines = axis.deadlines;
        config.referencing = axis.referencing;
        config.loss = axis.loss.unwrap_or(self.loss);
        config.tolerances = axis.tolerances.unwrap_or_default();
        if axis.tolerances.is_none()
            && let Some(position) = read_if_there(sdo, obj::POSITION_WINDOW.offset(offset)).await?
            // FFFFFFFFh switches the window off (CiA DSP 402 v2.0, object 6067h).
            && position != u32::MAX
        {
            config.tolerances = Tolerances {
                position,
                ..config.tolerances
            };
        }
        if let Some(code) = read_if_there(sdo, obj::QUICK_STOP_OPTION.offset(offset)).await? {
            config.quick_stop = QuickStopOption(code);
        }
        if !config.quick_stop.stops_under_control() && !axis.coasts {
            let axis = axis.name.clone();
            return Err((
                BringUpStep::Parameters,
                DriveFault::QuickStopCoasts { axis },
            ));
        }
        config.stop_options = StopOptions {
            shutdown: read_if_there(sdo, obj::SHUTDOWN_OPTION.offset(offset)).await?,
            disable_operation: read_if_there(sdo, obj::DISABLE_OPERATION_OPTION.offset(offset))
                .await?,
            halt: read_if_there(sdo, obj::HALT_OPTION.offset(offset)).await?,
            fault_reaction: read_if_there(sdo, obj::FAULT_REACTION_OPTION.offset(offset)).await?,
        };
        config.velocity_windows = VelocityWindows {
            window: read_if_it_can_be(sdo, obj::VELOCITY_WINDOW.offset(offset)).await?,
            window_ms: read_if_it_can_be(sdo, obj::VELOCITY_WINDOW_TIME.offset(offset)).await?,
            threshold: read_if_it_can_be(sdo, obj::VELOCITY_THRESHOLD.offset(offset)).await?,
            threshold_ms: read_if_it_can_be(sdo, obj::VELOCITY_THRESHOLD_TIME.offset(offset))
                .await?,
        };
        if axis.tolerances.is_none()
            && config.traits.threshold_in_velocity_units
            && let Some(threshold) = config.velocity_windows.threshold
        {
            config.tolerances.velocity = threshold.into();
        }
        config.supported_modes = read_if_it_can_be(sdo, obj::SUPPORTED_MODES.offset(offset))
            .await?
            .map(SupportedModes::from_bits_retain);
        if config.traits.relative_base == RelativeBase::PositioningOption
            && let Some(code) = read_if_there(sdo, obj::POSITIONING_OPTION.offset(offset)).await?
        {
            config.traits.relative_base = RelativeBase::of_positioning_option(code);
        }
        config.defaults = profile_position::Parameters {
            velocity: read_if_there(sdo, obj::PROFILE_VELOCITY.offset(offset)).await?,
            acceleration: read_if_there(sdo, obj::PROFILE_ACCELERATION.offset(offset)).await?,
            deceleration: read_if_there(sdo, obj::PROFILE_DECELERATION.offset(offset)).await?,
            end_velocity: match fields.end_velocity {
                Some(_) => read_if_there(sdo, obj::END_VELOCITY.offset(offset)).await?,
                None => None,
            },
            profile_type: match fields.profile_type {
                Some(_) => read_if_there(sdo, obj::MOTION_PROFILE_TYPE.offset(offset)).await?,
                None => None,
            },
        };
        let held = match (axis.limits, axis.modulo) {
            (Some(limits), None | Some(Turn::These(_))) => limits,
            _ => Limits::read(&Parameters(sdo.clone()), offset)
                .await
                .map_err(|error| (BringUpStep::Parameters, error.into()))?,
        };
        config.limits = axis.limits.unwrap_or(held);
        let turn = match axis.modulo {
            None => return Ok(config),
            Some(Turn::OfDrive) => held.position_range,
            Some(Turn::These(turn)) => Some(turn),
        };
        config.modulo = turn.filter(|turn| turn.length().is_some());
        if config.modulo.is_none() {
            let axis = axis.name.clone();
            return Err((BringUpStep::Parameters, DriveFault::NoTurn { axis }));
        }
        Ok(config)
    }
}

/// Sets what the axis does when the process data stop to a value that stops it, and checks what the drive holds then.
pub(in crate::bus) async fn stop_on_loss(
    context: &Context,
    sdo: &SdoHandle,
    axis: &AxisDeclaration,
    offset: AxisOffset,
    quick_stop: QuickStopOption,
) -> Result<(), Failed> {
    let step = BringUpStep::AbortConnection;
    let object = obj::ABORT_CONNECTION_OPTION.offset(offset);
    let Some(mut value) = read_if_there(sdo, object)
        .await
        .map_err(|(_, error)| (step, error))?
    else {
        let axis = axis.name.clone();
        let note = LogRecord::NoAbortConnection { axis };
        context.log.record(context.time.now(), note);
        return Ok(());
    };
    // A quick stop that only switches off would let the axis coast: then a fault, which has a reaction of its own.
    let preferred = [
        AbortConnection::QuickStop,
        AbortConnection::Malfunction,
        AbortConnection::DisableVoltage,
    ];
    let skip = usize::from(!quick_stop.stops_under_control());
    for choice in preferred.into_iter().skip(skip) {
        if value == choice.raw() {
            return Ok(());
        }
        match sdo.write(object, choice.raw()).await {
            Ok(()) => {}
            Err(error) if error.error.abort_code().is_some() => continue,
            Err(error) => return Err(at(step)(error)),
        }
        value = sdo.read(object).await.map_err(at(step))?;
        if value == choice.raw() {
            return Ok(());
        }
    }
    if AbortConnection::from_raw(value).stops() {
        return Ok(());
    }
    let axis = axis.name.clone();
    Err((step, DriveFault::DoesNotStop { axis, value }))
}

/// Reads an object that a drive need not have.
async fn read_if_there<T: Number, A: Readable>(
    sdo: &SdoHandle,
    object: Object<T, A>,
) -> Result<Option<T>, Failed> {
    match sdo.read(object).await {
        Ok(value) => Ok(Some(value)),
        Err(DriveError {
            error: SdoError::Aborted { code, .. },
            ..
        }) if code == AbortCode::NO_OBJECT || code == AbortCode::NO_SUBINDEX => Ok(None),
        Err(error) => Err(at(BringUpStep::Parameters)(error)),
    }
}

/// Reads an object without which the axis attaches all the same, whatever the drive says of it.
async fn read_if_it_can_be<T: Number, A: Readable>(
    sdo: &SdoHandle,
    object: Object<T, A>,
) -> Result<Option<T>, Failed> {
    match sdo.read(object).await {
        Ok(value) => Ok(Some(value)),
        Err(DriveError {
            error: SdoError::Aborted { .. } | SdoError::WrongSize { .. },
            ..
        }) => Ok(None),
        Err(error) => Err(at(BringUpStep::Parameters)(error)),
    }
}

fn at(step: BringUpStep) -> impl Fn(DriveError) -> Failed {
    move |DriveError { error, .. }| (step, error.into())
}

/// SDO access for the handles of an axis.
pub(in crate::bus) struct Parameters(pub(in crate::bus) SdoHandle);

impl ParameterAccess for Parameters {
    fn write(&self, object: ObjectAddress, value: Vec<u8>) -> BoxFuture<'_, Result<(), SdoError>> {
        Box::pin(async move {
            self.0
                .write_bytes(object.index, object.subindex, value)
                .await
                .map_err(|error| error.error)
        })
    }

    fn read(&self, object: ObjectAddress) -> BoxFuture<'_, Result<Vec<u8>, SdoError>> {
        Box::pin(async move {
            self.0
                .read_bytes(object.index, object.subindex)
                .await
                .map_err(|error| error.error)
        })
    }
}
