//! One device that is no drive, from PREOP to SAFEOP: what it exchanges, sync managers and FMMUs, watchdog.

use std::{rc::Rc, time::Duration};

use crate::{
    bus::{
        cycle::packing::{InputMarker, Member, fits_one_frame},
        device::{
            drive::{Failed, Mailbox, SAFE_OP_LIMIT, arm, mapping_fault, serve_mailbox},
            io::IoConfig,
            io_points::{Image, Piece},
            progress::Progress,
        },
        error::{AlState, BringUpStep, DriveFault, NetworkError, SyncManagerError},
        expected::DevicePlace,
        line::Found,
        requests::{
            Context, al, eeprom,
            sync_managers::{self, Area, AreaDirection},
        },
    },
    coe::{AbortCode, ErrorTexts, SdoHandle},
    parameters::{StartUpList, Transition},
    pdo_map::{self, ConfigureError, Direction, Mapping, Pdo},
    sii::FmmuUsage,
};

/// What is to be done with one device.
#[derive(Clone)]
pub(in crate::bus) struct IoSetup {
    pub(in crate::bus) found: Found,
    pub(in crate::bus) place: DevicePlace,
    pub(in crate::bus) config: IoConfig,
    /// The watchdog's time; none if the program does without.
    pub(in crate::bus) watchdog: Option<Duration>,
    /// Silent cycles after which it counts as lost.
    pub(in crate::bus) patience: u32,
    /// Its mailbox, where that is served already.
    pub(in crate::bus) mailbox: Option<Mailbox>,
    pub(in crate::bus) progress: Rc<Progress>,
}

/// A device of which it is known what it exchanges, to be led into SAFEOP, or there.
pub(in crate::bus) struct ReadyIo {
    pub(in crate::bus) found: Found,
    pub(in crate::bus) place: DevicePlace,
    pub(in crate::bus) name: String,
    /// Its mailbox, if it has CoE.
    pub(in crate::bus) mailbox: Option<Mailbox>,
    pub(in crate::bus) image: Image,
    /// The logical address of its outputs; its inputs follow.
    pub(in crate::bus) logical: u32,
    lrw: bool,
    patience: u32,
    watchdog: Option<Duration>,
    /// What is still to be written in SAFEOP.
    pub(in crate::bus) start_up: Vec<StartUpList>,
    progress: Rc<Progress>,
    /// How it is set up once more, by the same mailbox.
    pub(in crate::bus) setup: IoSetup,
}

impl IoSetup {
    /// Finds out what the device exchanges.
    pub(in crate::bus) async fn look(self, context: Context) -> Result<ReadyIo, NetworkError> {
        let found = self.found.clone();
        self.steps(&context)
            .await
            .map_err(|(step, error)| found.fault(step, error))
    }

    async fn steps(self, context: &Context) -> Result<ReadyIo, Failed> {
        let id = &self.found.id;
        self.found.note(context, "configuring");
        let done = |step| self.progress.step(id, step);
        done(BringUpStep::Identity);
        // The names, which configuration needs of no other device.
        let sii = eeprom::read_whole(&context.registers, self.found.station)
            .await
            .map_err(|error| (BringUpStep::Sii, error.into()))?;
        let mailbox = self.mailbox.clone();
        let mailbox =
            mailbox.or_else(|| serve_mailbox(context, &self.found, ErrorTexts::default()));
        if mailbox.is_none() && !self.config.start_up.is_empty() {
            return Err((BringUpStep::StartUpList, DriveFault::NoMailbox));
        }
        let image = match &mailbox {
            None => {
                done(BringUpStep::StartUpList);
                Image::of_sii(&sii)
            }
            Some(Mailbox { sdo, .. }) => {
                for list in &self.config.start_up {
                    list.apply(sdo, Transition::PreOpToSafeOp)
                        .await
                        .map_err(|error| (BringUpStep::StartUpList, error.into()))?;
                }
                done(BringUpStep::StartUpList);
                let outputs = assigned(Direction::Outputs, sdo).await?;
                let inputs = assigned(Direction::Inputs, sdo).await?;
                Image::of_mapping(&Mapping::from_pdos(outputs, inputs), &sii)
            }
        };
        let (outputs, inputs) = (
            image.bytes(Direction::Outputs),
            image.bytes(Direction::Inputs),
        );
        if outputs + inputs == 0 {
            return Err((BringUpStep::Mapping, DriveFault::NoProcessData));
        }
        if !fits_one_frame(outputs, inputs) {
            let fault = DriveFault::TooLong { outputs, inputs };
            return Err((BringUpStep::ProcessData, fault));
        }
        done(BringUpStep::Mapping);
        Ok(ReadyIo {
            found: self.found.clone(),
            place: self.place,
            name: self.config.name.clone(),
            mailbox: mailbox.clone(),
            image,
            logical: 0,
            lrw: true,
            patience: self.patience,
            watchdog: self.watchdog,
            start_up: self.config.start_up.clone(),
            progress: Rc::clone(&self.progress),
            setup: Self { mailbox, ..self },
        })
    }
}

/// The PDOs that a device has assigned; none if it has no such object.
async fn assigned(direction: Direction, sdo: &SdoHandle) -> Result<Vec<Pdo>, Failed> {
    match pdo_map::read_assigned(direction, sdo).await {
        Ok(pdos) => Ok(pdos),
        Err(ConfigureError::Unreadable(error))
            if error.error.abort_code() == Some(AbortCode::NO_OBJECT)
                && error.error.transfer().object.index == direction.assignment() =>
        {
            Ok(Vec::new())
        }
        Err(error) => Err((BringUpStep::Mapping, mapping_fault(error))),
    }
}

impl ReadyIo {
    /// Whether it exchanges the same, in the same places, as `other`.
    pub(in crate::bus) fn exchanges_as(&self, other: &Self) -> bool {
        self.image == other.image
    }

    /// Bytes of outputs and of inputs.
    pub(in crate::bus) fn sizes(&self) -> (usize, usize) {
        let bytes = |direction| self.image.bytes(direction);
        (bytes(Direction::Outputs), bytes(Direction::Inputs))
    }

    pub(in crate::bus) fn input_bytes(&self) -> usize {
        self.image.bytes(Direction::Inputs)
    }

    /// Its part in the exchange.
    pub(in crate::bus) fn member(&self) -> Member {
        let (outputs, inputs) = self.sizes();
        Member {
            logical: self.logical,
            outputs,
            inputs,
            lrw: self.lrw,
            marker: InputMarker::AnyBits,
            patience: self.patience,
        }
    }

    /// Leads it into SAFEOP, at its logical address.
    pub(in crate::bus) async fn into_safe_op(
        mut self,
        context: Context,
    ) -> Result<Self, NetworkError> {
        let led = self.safe_op(&context).await;
        match led {
            Ok(lrw) => {
                self.lrw = lrw;
                Ok(self)
            }
            Err((step, error)) => Err(self.found.fault(step, error)),
        }
    }

    /// Whether it takes LRW.
    async fn safe_op(&self, context: &Context) -> Result<bool, Failed> {
        let (registers, station) = (&context.registers, self.found.station);
        let process_data = |error: DriveFault| (BringUpStep::ProcessData, error);
        let watchdog = self.watchdog.is_some();
        let areas = self.areas().map_err(|error| process_data(error.into()))?;
        for (direction, area) in &areas {
            let direction = match direction {
                Direction::Outputs => AreaDirection::Outputs { watchdog },
                Direction::Inputs => AreaDirection::Inputs,
            };
            area.write(registers, station, direction)
                .await
                .map_err(|error| process_data(error.into()))?;
        }
        let lrw = sync_managers::takes_lrw(registers, station)
            .await
            .map_err(|error| process_data(error.into()))?;
        let outputs = areas
            .iter()
            .find(|(direction, _)| *direction == Direction::Outputs);
        if let Some((_, outputs)) = outputs {
            arm(context, station, outputs, self.watchdog, |expected, got| {
                DriveFault::OutputsUnwatched { expected, got }
            })
            .await?;
        }
        self.progress.step(&self.found.id, BringUpStep::Watchdog);
        eeprom::give_away(registers, station)
            .await
            .map_err(|error| (BringUpStep::Sii, error.into()))?;
        let safe_op = BringUpStep::State(AlState::SafeOp);
        al::request(registers, station, AlState::SafeOp, SAFE_OP_LIMIT)
            .await
            .map_err(|error| (safe_op, error.into()))?;
        self.found.note(context, "in SAFEOP");
        self.progress.step(&self.found.id, safe_op);
        Ok(lrw)
    }

    /// Each sync manager's area, one behind the other, with an FMMU of its own.
    fn areas(&self) -> Result<Vec<(Direction, Area)>, SyncManagerError> {
        let sii = &self.found.sii;
        let mut fmmus: Vec<u8> = Vec::new();
        let mut logical = self.logical;
        let mut areas = Vec::new();
        for piece in &self.image.pieces {
            let &Piece {
                direction,
                manager,
                bytes,
            } = piece;
            let (what, usage) = match direction {
                Direction::Outputs => ("outputs", FmmuUsage::Outputs),
                Direction::Inputs => ("inputs", FmmuUsage::Inputs),
            };
            let meant = (0..).zip(&sii.fmmu_usage);
            let meant = meant
                .filter(|(_, of)| **of == usage)
                .map(|(number, _)| number);
            let fmmu = meant
                .chain(0..u8::MAX)
                .find(|number| !fmmus.contains(number))
                .unwrap_or(u8::MAX);
            fmmus.push(fmmu);
            areas.push((
                direction,
                Area::of_manager(sii, manager, fmmu, bytes, logical, what)?,
            ));
            logical = logical.saturating_add(u32::try_from(bytes).unwrap_or(u32::MAX));
        }
        Ok(areas)
    }
}
