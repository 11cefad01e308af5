//! One device: what a program declares of it, its way into OP, and the handles of an I/O device's inputs and outputs.
//!
//! `config` and `io` are what a program says and holds. [`Device`] has the steps of the way: to PREOP, configured, to SAFEOP, to OP.
//! The first start and a recovery call the same steps. `drive` has what only drives have. It calls `clocks`, `line` and `requests`. It
//! must not know of other devices, of cycles that run, or of the network.

pub(crate) mod config;
pub(super) mod drive;
pub(super) mod held_outputs;
pub(crate) mod io;
mod io_cell;
pub(super) mod io_points;
pub(super) mod io_port;
pub(super) mod progress;

use std::{cell::Cell, rc::Rc, sync::Arc, time::Duration};

use super::{
    clocks::{self, Clocks},
    cycle::frame::{InputMarker, Member, fits_one_frame},
    error::{
        AlError, AlState, AtStep, BringUpStep, DriveFault, NetworkError, OfDevice, StepError,
        SyncManagerError,
    },
    expected::{DevicePlace, LineVerdict, Present},
    line::{self, Found},
    log::LogRecord,
    requests::{
        Context, eeprom,
        executor::Time,
        registers::{self, Registers},
        sync_managers::{self, Area, AreaDirection},
    },
};
use crate::{
    coe::{
        AbortCode, Clock, DriveId, Emergencies, ErrorTexts, EthercrabMailbox, MailboxClient,
        MailboxSettings, MailboxSignal, ObjectAddress, SdoHandle, UnservedMailbox,
    },
    parameters::{StartUpLines, StartUpList, Transition},
    pdo_map::{self, ConfigureError, Direction, Layout, MappedPdo, Mapping},
    sii::{self, FmmuUsage, SyncManagerUsage},
};
use config::{DriveConfig, Watchdog};
use drive::Drive;
use held_outputs::{Brakes, HeldOutputs};
use io::IoConfig;
use io_points::{Image, IoPoint, Piece};
use progress::Progress;

/// How long a device may take into SAFEOP, and into OP (ETG.1020, default timeouts of both are 10 s).
pub(in crate::bus) const SAFE_OP_LIMIT: Duration = Duration::from_secs(10);
const OP_LIMIT: Duration = Duration::from_secs(10);

/// A device whose process data are exchanged.
#[derive(Clone)]
pub(in crate::bus) struct Device {
    pub found: Found,
    /// How it was declared.
    pub place: DevicePlace,
    pub kind: DeviceKind,
    /// Its mailbox, once that is served; an I/O device need not have one.
    pub mailbox: Option<Mailbox>,
    /// The logical address of its outputs; its inputs follow.
    pub logical: u32,
    pub progress: Rc<Progress>,
    /// Whether it takes LRW.
    lrw: bool,
    /// Silent cycles after which an I/O device counts as lost.
    patience: u32,
    /// The watchdog's time; none if the program does without.
    watchdog: Option<Duration>,
    start_up: Vec<StartUpList>,
}

/// A drive writes its PDOs; those of an I/O device are read.
#[derive(Clone)]
pub(in crate::bus) enum DeviceKind {
    Drive(Box<Drive>),
    Io { name: String, points: Image },
}

impl Device {
    /// A declared drive, if its mapping can be made.
    pub async fn drive(
        context: &Context,
        found: Found,
        place: DevicePlace,
        config: DriveConfig,
        (watchdog, cycle): (&Watchdog, Duration),
        clocks: Option<Rc<Clocks>>,
        progress: Rc<Progress>,
    ) -> Result<Self, NetworkError> {
        let mapping = match config.mapping() {
            Ok(mapping) => mapping,
            Err(error) => {
                let sdo = serve_mailbox(context, &found, ErrorTexts::default());
                let sdo = sdo.map(|mailbox| mailbox.sdo);
                let fault = Drive::not_mapped(&config, error, sdo.as_ref()).await;
                return Err(fault).at(BringUpStep::Mapping).of(&found.id);
            }
        };
        let times = (watchdog, cycle);
        Self::mapped(found, place, (config, mapping), times, clocks, progress)
    }

    /// A declared drive that is not there yet. Its axes exist, and nothing was read of them.
    pub fn absent(
        context: &Context,
        id: DriveId,
        place: DevicePlace,
        config: DriveConfig,
        times: (&Watchdog, Duration),
        progress: Rc<Progress>,
    ) -> Result<Self, NetworkError> {
        let mapping = config.mapping();
        let mapping = mapping.at(BringUpStep::Mapping).of(&id)?;
        let error_texts = config.description.error_texts.clone();
        let mailbox = Mailbox::unserved(context, &id, error_texts);
        let (found, drive) = (Found::absent(id), (config, mapping));
        let mut device = Self::mapped(found, place, drive, times, None, progress)?;
        if let DeviceKind::Drive(drive) = &mut device.kind {
            drive.declare_axes().of(&device.found.id)?;
        }
        device.mailbox = Some(mailbox);
        Ok(device)
    }

    /// As this drive comes into the line, of whose kind another one may have been there: nothing is known of it.
    pub fn join(&mut self, found: Found) {
        let id = self.found.id.clone();
        self.found = found;
        (self.found.id.position, self.found.id.name) = (id.position, id.name);
        if let DeviceKind::Drive(drive) = &mut self.kind {
            drive.axes.clear();
        }
    }

    fn mapped(
        found: Found,
        place: DevicePlace,
        (config, mapping): (DriveConfig, Mapping),
        (watchdog, cycle): (&Watchdog, Duration),
        clocks: Option<Rc<Clocks>>,
        progress: Rc<Progress>,
    ) -> Result<Self, NetworkError> {
        let layout = mapping.layout();
        config.log_what_is_not_mapped(&layout, &found.id);
        let start_up = config.start_up.clone();
        let drive = Drive {
            config,
            mapping,
            layout,
            held: HeldOutputs::default(),
            axes: Vec::new(),
            loss: watchdog.loss(cycle),
            cycle,
            clocks,
        };
        let kind = DeviceKind::Drive(Box::new(drive));
        let device = Self::new(found, place, kind, start_up, (watchdog, cycle), progress);
        device.fits().of(&device.found.id)?;
        Ok(device)
    }

    /// A declared I/O device.
    pub fn io(
        found: Found,
        place: DevicePlace,
        config: IoConfig,
        watchdog: (&Watchdog, Duration),
        progress: Rc<Progress>,
    ) -> Self {
        let kind = DeviceKind::Io {
            name: config.name,
            points: Image::default(),
        };
        Self::new(found, place, kind, config.start_up, watchdog, progress)
    }

    fn new(
        found: Found,
        place: DevicePlace,
        kind: DeviceKind,
        start_up: Vec<StartUpList>,
        (watchdog, cycle): (&Watchdog, Duration),
        progress: Rc<Progress>,
    ) -> Self {
        Self {
            found,
            place,
            kind,
            mailbox: None,
            logical: 0,
            progress,
            lrw: true,
            patience: watchdog.loss(cycle).stale_cycles,
            watchdog: watchdog.time(cycle),
            start_up,
        }
    }

    /// The drive, where it is one.
    pub fn as_drive(&self) -> Option<&Drive> {
        match &self.kind {
            DeviceKind::Drive(drive) => Some(drive),
            DeviceKind::Io { .. } => None,
        }
    }

    /// How long after the frames pass the reference clock its SYNC0 comes, where it follows that.
    pub fn sync0_after(&self) -> Option<Duration> {
        let drive = self.as_drive()?;
        Some(drive.config.clock?.shift_in(drive.cycle))
    }

    /// The line's clocks, if its own follows the reference.
    pub fn clocks(&self) -> Option<&Rc<Clocks>> {
        let drive = self.as_drive()?;
        drive.config.clock.and(drive.clocks.as_ref())
    }

    /// Bytes of outputs and of inputs. Those of an I/O device are known once it is configured.
    pub fn sizes(&self) -> (usize, usize) {
        match &self.kind {
            DeviceKind::Drive(drive) => (drive.layout.output_bytes(), drive.layout.input_bytes()),
            DeviceKind::Io { points, .. } => (
                points.bytes(Direction::Outputs),
                points.bytes(Direction::Inputs),
            ),
        }
    }

    /// Whether it exchanges the same, in the same places, as `other`.
    pub fn exchanges_as(&self, other: &Self) -> bool {
        let same = match (&self.kind, &other.kind) {
            (DeviceKind::Drive(this), DeviceKind::Drive(other)) => this.layout == other.layout,
            (DeviceKind::Io { points, .. }, DeviceKind::Io { points: other, .. }) => {
                points == other
            }
            _ => false,
        };
        same && self.lrw == other.lrw
    }

    /// Its part in the exchange, where it may come and go or not.
    pub fn member(&self, leaves: bool) -> Member {
        let (outputs, inputs) = self.sizes();
        let (marker, patience) = match &self.kind {
            DeviceKind::Drive(drive) => {
                let axes = drive.axes.iter();
                let patience = axes.map(|axis| axis.config.loss.stale_cycles).min();
                (InputMarker::Statusword, patience.unwrap_or(1).max(1))
            }
            DeviceKind::Io { .. } => (InputMarker::AnyBits, self.patience),
        };
        Member {
            logical: self.logical,
            outputs,
            inputs,
            lrw: self.lrw,
            marker,
            patience,
            leaves,
        }
    }

    fn fits(&self) -> Result<(), StepError> {
        let (outputs, inputs) = self.sizes();
        if fits_one_frame(outputs, inputs) {
            return Ok(());
        }
        Err(DriveFault::TooLong { outputs, inputs }).at(BringUpStep::ProcessData)
    }

    /// A step is done, for whoever shows how far it is.
    pub fn done(&self, step: BringUpStep) {
        self.progress.step(&self.found.id, step);
    }

    /// Set back to INIT and brought into PREOP once more, if it still is the same device: its SII is kept. The line does that at the
    /// start, for all SubDevices at once.
    pub async fn enter_pre_op(&self, context: &Context) -> Result<(), NetworkError> {
        let registers = &context.registers;
        let Found { station, id, .. } = &self.found;
        line::set_back(registers, *station)
            .await
            .at(BringUpStep::State(AlState::Init))
            .of(id)?;
        let present = self.present(registers).await.of(id)?;
        if self.is(&present) {
            self.found.enter_pre_op(registers).await.of(id)?;
            // Not before: a message that comes in INIT is taken by memory, and nobody answers it.
            if let Some(mailbox) = &self.mailbox {
                mailbox.signal.begin_anew();
            }
            return Ok(());
        }
        // It is none of ours.
        let _ = registers
            .write(*station, crate::esc::STATION_ADDRESS, &[0; 2])
            .await;
        let verdict = LineVerdict::Different;
        Err(line::mismatch(self.place, id, Some(present), verdict))
    }

    /// Who answers at its station address.
    pub async fn present(&self, registers: &Registers) -> Result<Present, StepError> {
        let Found { station, id, .. } = &self.found;
        let identity = eeprom::identity(registers, *station).await;
        let identity = identity.at(BringUpStep::Sii)?;
        let numbers = line::numbers(registers, *station, &[self.place]).await;
        let id = DriveId {
            position: id.position,
            name: String::new(),
            identity,
        };
        Ok(Present {
            id,
            numbers: numbers.at(BringUpStep::Identity)?,
        })
    }

    /// Whether that is the device of the start. One that was declared by a number must have that still.
    pub fn is(&self, present: &Present) -> bool {
        let is_meant = match self.place {
            DevicePlace::Position(_) | DevicePlace::Identity { .. } => true,
            number => present.says(number),
        };
        is_meant && present.id.identity == self.found.id.identity
    }

    /// In PREOP: start-up lists, PDOs, and of a drive's parameters those that its outputs will overwrite.
    pub async fn configure(&mut self, context: &Context) -> Result<(), StepError> {
        self.found.note(context, "configuring");
        self.done(BringUpStep::Identity);
        match self.kind {
            DeviceKind::Drive(_) => self.configure_drive(context).await,
            DeviceKind::Io { .. } => self.configure_io(context).await,
        }
    }

    async fn configure_drive(&mut self, context: &Context) -> Result<(), StepError> {
        let DeviceKind::Drive(drive) = &mut self.kind else {
            return Ok(());
        };
        let done = |step| self.progress.step(&self.found.id, step);
        let mailbox = self.mailbox.get_or_insert_with(|| {
            let error_texts = drive.config.description.error_texts.clone();
            Mailbox::unserved(context, &self.found.id, error_texts)
        });
        mailbox.serve(context, &self.found)?;
        let sdo = mailbox.sdo.clone();
        if let Some(clock) = &drive.config.clock {
            clocks::set_sync_types(context, &sdo, clock, drive.cycle)
                .await
                .at(BringUpStep::Clock)?;
        }
        let is_output = |layout: &Layout, object: ObjectAddress| {
            let place = layout.find(Direction::Outputs, object.index, object.subindex);
            place.is_some()
        };
        let lines = StartUpLines::all(&self.start_up);
        let brakes = Brakes::of(&drive.config);
        let opens = |object, value: &[u8]| {
            is_output(&drive.layout, object) && brakes.are_opened_by(object, value)
        };
        if let Some(error) = lines.opens_brake(opens) {
            return Err(error).at(BringUpStep::StartUpList);
        }
        held_outputs::set_brakes(&drive.layout, &self.start_up, &brakes, &sdo).await?;
        let step = BringUpStep::StartUpList;
        let lines = StartUpLines::of(&self.start_up, Transition::PreOpToSafeOp);
        let [scaling, values] = lines.scaling_first();
        scaling.write(&sdo).await.at(step)?;
        drive.write_scales(&sdo).await?;
        values.write(&sdo).await.at(step)?;
        done(step);
        drive.map(&self.found.id, &sdo).await?;
        check_lists(&self.start_up, |object| is_output(&drive.layout, object))?;
        done(BringUpStep::Mapping);
        drive.open_axes(&sdo).await
    }

    /// In SAFEOP: what its start-up lists write there, and then what motion needs of a drive. At the start no cycle is in the way of it; on
    /// its way back a program that has handles of its axes could enable them in OP.
    pub async fn read_axes(&mut self, context: &Context) -> Result<(), StepError> {
        if let Some(mailbox) = &self.mailbox {
            let transition = Transition::SafeOpToOp;
            write_lists(&self.start_up, &mailbox.sdo, transition).await?;
        }
        if let (DeviceKind::Drive(drive), Some(mailbox)) = (&mut self.kind, &self.mailbox) {
            drive.read_axes(context, &mailbox.sdo).await?;
            self.done(BringUpStep::Parameters);
        }
        Ok(())
    }

    /// On its way back. What its axes did without a set-point's parameters is that of an earlier start.
    pub async fn read_as_it_is_now(
        &mut self,
        context: &Context,
        before: &Self,
    ) -> Result<(), StepError> {
        self.read_axes(context).await?;
        match (&mut self.kind, &self.mailbox, before.as_drive()) {
            (DeviceKind::Drive(drive), Some(mailbox), Some(before)) => {
                drive.keep_defaults_of(before, &mailbox.sdo).await
            }
            _ => Ok(()),
        }
    }

    async fn configure_io(&mut self, context: &Context) -> Result<(), StepError> {
        let DeviceKind::Io { points, .. } = &mut self.kind else {
            return Ok(());
        };
        let done = |step| self.progress.step(&self.found.id, step);
        let sii = &self.found.sii;
        let mailbox = self.mailbox.take();
        self.mailbox =
            mailbox.or_else(|| serve_mailbox(context, &self.found, ErrorTexts::default()));
        *points = match &self.mailbox {
            None if !self.start_up.is_empty() => {
                return Err(DriveFault::NoMailbox).at(BringUpStep::StartUpList);
            }
            None => {
                done(BringUpStep::StartUpList);
                Image::of_sii(sii)
            }
            Some(Mailbox { sdo, .. }) => {
                write_lists(&self.start_up, sdo, Transition::PreOpToSafeOp).await?;
                done(BringUpStep::StartUpList);
                let outputs = assigned(Direction::Outputs, sdo).await?;
                let inputs = assigned(Direction::Inputs, sdo).await?;
                let image = Image::of_mapping(&Mapping::from_pdos(outputs, inputs), sii);
                check_lists(&self.start_up, |object| {
                    let outputs = |point: &&IoPoint| point.direction == Direction::Outputs;
                    let mut outputs = image.points.iter().filter(outputs);
                    outputs.any(|point| point.object == object)
                })?;
                image
            }
        };
        if self.sizes() == (0, 0) {
            return Err(DriveFault::NoProcessData).at(BringUpStep::Mapping);
        }
        self.fits()?;
        self.done(BringUpStep::Mapping);
        Ok(())
    }

    /// From PREOP, configured, to SAFEOP: sync managers, FMMUs, watchdog, SYNC0. At its logical address.
    pub async fn enter_safe_op(&mut self, context: &Context) -> Result<(), StepError> {
        let (registers, station) = (&context.registers, self.found.station);
        let step = BringUpStep::ProcessData;
        let areas = self.areas().at(step)?;
        for (direction, area) in &areas {
            area.write(registers, station, *direction).await.at(step)?;
        }
        self.lrw = sync_managers::takes_lrw(registers, station)
            .await
            .at(step)?;
        let outputs = areas
            .iter()
            .find(|(direction, _)| *direction != AreaDirection::Inputs);
        if let Some((_, outputs)) = outputs {
            self.arm(context, outputs).await.at(BringUpStep::Watchdog)?;
        }
        self.done(BringUpStep::Watchdog);
        if let Some(drive) = self.as_drive()
            && let Some(clock) = &drive.config.clock
        {
            let position = self.found.id.position;
            let clocks = drive.clocks.as_ref();
            clocks::start_sync0(registers, station, position, clocks, clock, drive.cycle)
                .await
                .at(BringUpStep::Clock)?;
            self.found.note(context, "SYNC0 is on");
        }
        let step = BringUpStep::State(AlState::SafeOp);
        let (from, to) = (AlState::PreOp, AlState::SafeOp);
        let mut climbed = registers::climb(registers, station, from, to, SAFE_OP_LIMIT).await;
        let defaults = self
            .as_drive()
            .map(|drive| drive.config.description.sync_types);
        if let (Err(AlError::Refused(status)), None, Some(mailbox)) =
            (&climbed, self.clocks(), &self.mailbox)
            && status.error.is_some_and(clocks::is_about_types)
            && clocks::leave_sync0(&mailbox.sdo, defaults.unwrap_or_default(), *status)
                .await
                .at(step)?
        {
            self.found.note(context, "taken out of SYNC0");
            climbed = registers::climb(registers, station, from, to, SAFE_OP_LIMIT).await;
        }
        climbed.at(step)?;
        self.found.note(context, "in SAFEOP");
        self.done(step);
        Ok(())
    }

    /// From SAFEOP to OP.
    pub async fn enter_op(&self, context: &Context) -> Result<(), StepError> {
        let (registers, station) = (&context.registers, self.found.station);
        registers::climb(registers, station, AlState::SafeOp, AlState::Op, OP_LIMIT)
            .await
            .at(BringUpStep::State(AlState::Op))
    }

    /// Sets its process-data watchdog, or switches it off, and checks what the device holds then.
    async fn arm(&self, context: &Context, outputs: &Area) -> Result<(), DriveFault> {
        let ticks = match self.watchdog {
            None => 0,
            Some(time) => {
                sync_managers::watchdog_ticks(time).ok_or(DriveFault::WatchdogTime(time))?
            }
        };
        let (registers, station) = (&context.registers, self.found.station);
        let got = sync_managers::set_watchdog(registers, station, outputs, ticks).await?;
        if ticks == 0 || got.is_armed_with(ticks) {
            return Ok(());
        }
        let expected = ticks;
        Err(match self.kind {
            DeviceKind::Drive(_) => DriveFault::WatchdogUnarmed { expected, got },
            DeviceKind::Io { .. } => DriveFault::OutputsUnwatched { expected, got },
        })
    }

    /// Each sync manager's area, one behind the other, with an FMMU of its own.
    fn areas(&self) -> Result<Vec<(AreaDirection, Area)>, SyncManagerError> {
        let sii = &self.found.sii;
        let watchdog = self.watchdog.is_some();
        let mut logical = self.logical;
        let (mut areas, mut fmmus) = (Vec::new(), Vec::new());
        match &self.kind {
            DeviceKind::Drive(_) => {
                let (outputs, inputs) = self.sizes();
                for (direction, usage, bytes) in [
                    (
                        AreaDirection::Outputs { watchdog },
                        SyncManagerUsage::Outputs,
                        outputs,
                    ),
                    (AreaDirection::Inputs, SyncManagerUsage::Inputs, inputs),
                ] {
                    let area = sync_managers::area(sii, usage, &mut fmmus, bytes, logical)?;
                    areas.push((direction, area));
                    logical = behind(logical, bytes);
                }
            }
            DeviceKind::Io { points, .. } => {
                for piece in &points.pieces {
                    let &Piece {
                        direction,
                        manager,
                        bytes,
                    } = piece;
                    let (direction, what, usage) = match direction {
                        Direction::Outputs => (
                            AreaDirection::Outputs { watchdog },
                            "outputs",
                            FmmuUsage::Outputs,
                        ),
                        Direction::Inputs => (AreaDirection::Inputs, "inputs", FmmuUsage::Inputs),
                    };
                    let fmmu = sync_managers::fmmu(sii, usage, &mut fmmus);
                    let area = Area::of_manager(sii, manager, fmmu, bytes, logical, what)?;
                    areas.push((direction, area));
                    logical = behind(logical, bytes);
                }
            }
        }
        Ok(areas)
    }
}

fn behind(logical: u32, bytes: usize) -> u32 {
    logical.saturating_add(u32::try_from(bytes).unwrap_or(u32::MAX))
}

async fn write_lists(
    lists: &[StartUpList],
    sdo: &SdoHandle,
    transition: Transition,
) -> Result<(), StepError> {
    let lines = StartUpLines::of(lists, transition);
    lines.write(sdo).await.at(BringUpStep::StartUpList)
}

/// That no line is overwritten by the process data.
fn check_lists(
    lists: &[StartUpList],
    is_output: impl Fn(ObjectAddress) -> bool,
) -> Result<(), StepError> {
    match StartUpLines::all(lists).overwritten(is_output) {
        Some(error) => Err(error).at(BringUpStep::StartUpList),
        None => Ok(()),
    }
}

/// The PDOs that a device has assigned; none if it has no such object.
async fn assigned(direction: Direction, sdo: &SdoHandle) -> Result<Vec<MappedPdo>, StepError> {
    match pdo_map::read_assigned(direction, sdo).await {
        Ok(pdos) => Ok(pdos),
        Err(ConfigureError::Unreadable(error))
            if error.error.abort_code() == Some(AbortCode::NO_OBJECT)
                && error.error.transfer().object.index == direction.assignment() =>
        {
            Ok(Vec::new())
        }
        Err(error) => Err(error).at(BringUpStep::Mapping),
    }
}

// Its mailbox, once it is served on the bus thread.

/// A SubDevice's mailbox.
#[derive(Clone)]
pub(in crate::bus) struct Mailbox {
    pub sdo: SdoHandle,
    pub emergencies: Emergencies,
    pub signal: MailboxSignal,
    pub error_texts: Arc<ErrorTexts>,
    service: Rc<Service>,
}

/// Who serves it.
struct Service {
    /// Nobody: the device has not been in the line yet.
    unserved: Cell<Option<UnservedMailbox>>,
    /// A client, which has it in these areas of the device's memory.
    areas: Cell<Option<sii::Mailbox>>,
}

impl Mailbox {
    /// The mailbox of a device that may come later.
    pub fn unserved(context: &Context, id: &DriveId, error_texts: ErrorTexts) -> Self {
        let waiters = || context.wakes.waiters();
        let (unserved, sdo, emergencies) =
            UnservedMailbox::new(MailboxSettings::CAPACITIES, id.clone(), waiters);
        Self {
            sdo,
            emergencies,
            signal: unserved.signal(),
            error_texts: Arc::new(error_texts),
            service: Rc::new(Service {
                unserved: Cell::new(Some(unserved)),
                areas: Cell::new(None),
            }),
        }
    }

    /// Serves it from now on as the device's SII says. One that is served already stays so, if the device still has it there.
    pub fn serve(&self, context: &Context, found: &Found) -> Result<(), StepError> {
        let step = BringUpStep::Sii;
        let mailbox = found.sii.mailbox;
        let mailbox = mailbox.filter(|mailbox| mailbox.protocols.coe());
        let mailbox = mailbox.ok_or(DriveFault::NoMailbox).at(step)?;
        if let Some(expected) = self.service.areas.get() {
            if expected == mailbox {
                return Ok(());
            }
            let got = mailbox;
            return Err(DriveFault::OtherMailbox { expected, got }).at(step);
        }
        let unserved = self.service.unserved.take();
        let unserved = unserved.ok_or(DriveFault::NoMailbox).at(step)?;
        let client = MailboxClient::serving(
            unserved,
            EthercrabMailbox::new(context.registers.main(), found.station, mailbox),
            TaskClock(Rc::clone(&context.time)),
            MailboxSettings::of(&found.sii, &mailbox),
        );
        let log = context.log.clone();
        let client = client
            .with_error_texts(Arc::clone(&self.error_texts))
            .reporting_to(context.emergencies.0.clone())
            .noting_to(Arc::new(move |at, note| {
                log.record(at, LogRecord::MailboxMessage(note));
            }));
        let task = context.spawn(client.run());
        task.ok_or(DriveFault::NoMailbox).at(step)?.detach();
        self.service.areas.set(Some(mailbox));
        Ok(())
    }
}

/// Begins to serve a SubDevice's mailbox; none if it has no CoE.
pub(in crate::bus) fn serve_mailbox(
    context: &Context,
    found: &Found,
    error_texts: ErrorTexts,
) -> Option<Mailbox> {
    let mailbox = Mailbox::unserved(context, &found.id, error_texts);
    mailbox.serve(context, found).is_ok().then_some(mailbox)
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
