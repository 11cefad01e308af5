//! The drives of a line with all their axes: as a `machine.toml` names them, or each by its own description.

use std::cell::Cell;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use servocrab::{
    AxisConfig, DriveConfig, Network, NetworkError,
    bus::{BringUpStep, Expected, IoConfig, LineDevice, NetworkBuilder},
    coe::{AxisOffset, DriveId, SdoHandle, obj},
    esi::{Esi, EsiDriveError},
};
use servocrab_sim::EsiChoice;

use crate::{
    line::LineArguments,
    machine::{Axis, Machine, Units, init::points_of, io_name},
    output::{Failure, Tool},
    report::description_of,
};

/// How the drives of a line are driven.
#[derive(Args)]
pub(crate) struct DrivesArguments {
    #[command(flatten)]
    pub(crate) line: LineArguments,
    #[command(flatten)]
    pub(crate) described: DescribedBy,
    /// Time from one cycle to the next, in microseconds; without it: that of the machine's file, or 1000
    #[arg(long, value_parser = clap::value_parser!(u32).range(100..=20_000))]
    cycle_us: Option<u32>,
    /// After this time without process data a drive stops by itself, in milliseconds; without it: twenty cycles, at least 100 ms
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=6500))]
    watchdog_ms: Option<u64>,
}

/// What says how the drives of a line are driven, where that is not known of them.
#[derive(Args)]
pub(crate) struct DescribedBy {
    /// The line's description, as `servocrab init` writes it: the names of the axes and their units. The line has to be as it says
    #[arg(long, value_name = "FILE")]
    machine: Option<PathBuf>,
    /// A maker's ESI file: the drives of this maker that are in it are driven by it, or all of this maker by one device of it
    #[arg(
        long,
        value_name = "FILE[:PRODUCT[:REVISION]]",
        conflicts_with = "machine"
    )]
    esi: Option<EsiChoice>,
}

impl DescribedBy {
    pub(crate) fn machine(&self) -> Result<Option<Machine>, Failure> {
        self.machine.as_deref().map(Machine::load).transpose()
    }

    pub(crate) fn file(&self, tool: &Tool) -> Result<MakersFile, Failure> {
        let mut file = MakersFile {
            esi: None,
            used: Cell::new(false),
        };
        if let Some(choice) = &self.esi {
            let esi = Esi::load(&choice.file)?;
            esi.warnings.iter().for_each(|warning| tool.note(warning));
            file.esi = Some((choice.clone(), esi));
        }
        Ok(file)
    }

    /// The running network; what is to be done where the profile's objects do not fit a drive.
    pub(crate) async fn start(&self, network: NetworkBuilder) -> Result<Network, Failure> {
        let started = network.start().await;
        started.map_err(|error| match &error {
            NetworkError::Drive {
                step: BringUpStep::Mapping,
                ..
            } if self.esi.is_none() && self.machine.is_none() => {
                format!("{error}: describe the drive by its maker's file, --esi FILE").into()
            }
            _ => error.into(),
        })
    }
}

/// An ESI file, where one was named.
pub(crate) struct MakersFile {
    esi: Option<(EsiChoice, Esi)>,
    used: Cell<bool>,
}

impl MakersFile {
    /// How a device is driven, and how many axes it has: by the file, by what is known of it, or by the profile's objects; `None` if it is no
    /// drive.
    pub(crate) async fn drive(
        &self,
        device: &LineDevice,
    ) -> Result<Option<(DriveConfig, usize)>, Failure> {
        let identity = &device.id.identity;
        let esi = self.esi.as_ref();
        if let Some((choice, esi)) = esi.filter(|(_, esi)| esi.vendor == identity.vendor) {
            let product = choice.product.unwrap_or(identity.product);
            let revision = choice.revision.unwrap_or(match choice.product {
                Some(_) => u32::MAX,
                None => identity.revision,
            });
            match esi.device(product, revision) {
                Ok(found) => {
                    let mut found = found.clone();
                    found.product = identity.product;
                    self.used.set(true);
                    return match DriveConfig::from_esi(&found) {
                        Ok(drive) => Ok(Some((drive, found.description()?.axes.len()))),
                        Err(EsiDriveError::NoAxis(_)) => Ok(None),
                        Err(error) => Err(error.into()),
                    };
                }
                Err(error) if choice.product.is_some() || error.skipped.is_some() => {
                    return Err(format!("{}: {error}", choice.file.display()).into());
                }
                Err(_) => {}
            }
        }
        let description = description_of(device).await;
        Ok(description.map(|description| {
            let axes = description.axes.len();
            (DriveConfig::new(description), axes)
        }))
    }

    /// That it says something of a device of the line.
    pub(crate) fn is_used(&self) -> Result<(), Failure> {
        match &self.esi {
            Some((choice, _)) if !self.used.get() => {
                let file = choice.file.display();
                Err(format!("{file} describes no device of this line").into())
            }
            _ => Ok(()),
        }
    }
}

/// All drives of a line, each with all its axes.
pub(crate) struct Drives {
    drives: Vec<(u16, DriveConfig)>,
    /// The other devices that have process data, where no file says what they are.
    ios: Vec<(u16, IoConfig)>,
    machine: Option<Machine>,
    pub(crate) axes: Vec<FoundAxis>,
}

/// An axis of a drive that is there.
pub(crate) struct FoundAxis {
    /// `0-1` is the first axis of the drive at position 0, where no file gives it a name.
    pub(crate) name: String,
    pub(crate) drive: DriveId,
    /// The drive has a target velocity 60FFh: not every drive has the mode of a jog.
    pub(crate) jogs: bool,
    pub(crate) units: Units,
}

impl DrivesArguments {
    /// What is on the line. `config` is asked for the settings of each axis.
    pub(crate) async fn find(
        &self,
        tool: &Tool,
        config: impl Fn(&FoundAxis, AxisConfig) -> AxisConfig,
    ) -> Result<Drives, Failure> {
        let machine = self.described.machine()?;
        let file = self.described.file(tool)?;
        let line = self.line.scan(tool).await?;
        let found = tool
            .unless_interrupted(Drives::on(machine, &file, line.devices(), config))
            .await;
        line.close().await;
        found
    }

    /// The network of these drives.
    pub(crate) fn network(&self, drives: Drives) -> Result<NetworkBuilder, Failure> {
        let mut network = self.line.network()?;
        if let Some(machine) = &drives.machine {
            network = machine.without_drives(network);
        }
        if let Some(cycle) = self.cycle_us {
            network = network.cycle(Duration::from_micros(cycle.into()));
        }
        if let Some(time) = self.watchdog_ms {
            network = network.watchdog(Duration::from_millis(time));
        }
        let ios = drives.ios.into_iter();
        let network = ios.fold(network, |network, (position, io)| network.io(position, io));
        let drives = drives.drives.into_iter();
        Ok(drives.fold(network, |network, (position, drive)| {
            network.drive(position, drive)
        }))
    }
}

impl Drives {
    async fn on(
        machine: Option<Machine>,
        file: &MakersFile,
        line: &[LineDevice],
        config: impl Fn(&FoundAxis, AxisConfig) -> AxisConfig,
    ) -> Result<Self, Failure> {
        let mut all = Self {
            drives: Vec::new(),
            ios: Vec::new(),
            axes: Vec::new(),
            machine: None,
        };
        match &machine {
            Some(machine) => all.take_machine(machine, line, config).await?,
            None => all.take_line(file, line, config).await?,
        }
        if all.axes.is_empty() {
            return Err("no drive was found on the line".into());
        }
        all.machine = machine;
        Ok(all)
    }

    /// All drives of the file, there or not: the network refuses another line.
    async fn take_machine(
        &mut self,
        machine: &Machine,
        line: &[LineDevice],
        config: impl Fn(&FoundAxis, AxisConfig) -> AxisConfig,
    ) -> Result<(), Failure> {
        for (position, known) in (0..).zip(&machine.devices) {
            if known.kind.is_drive() {
                let found = line.get(usize::from(position));
                let sdo = found.and_then(|device| device.sdo.as_ref());
                let drive = machine.drive(known)?;
                self.take(known.id(position), drive, known.axes.clone(), sdo, &config)
                    .await;
            }
        }
        Ok(())
    }

    /// Each device by its own description.
    async fn take_line(
        &mut self,
        file: &MakersFile,
        line: &[LineDevice],
        config: impl Fn(&FoundAxis, AxisConfig) -> AxisConfig,
    ) -> Result<(), Failure> {
        for device in line {
            let position = device.id.position;
            if let Some((drive, axes)) = file.drive(device).await? {
                let named = (1..=axes).map(|axis| Axis::named(axis_name(position, axis)));
                let named = named.collect();
                let sdo = device.sdo.as_ref();
                self.take(device.id.clone(), drive, named, sdo, &config)
                    .await;
            } else {
                self.ios.extend(io(device).map(|io| (position, io)));
            }
        }
        file.is_used()
    }

    async fn take(
        &mut self,
        id: DriveId,
        mut drive: DriveConfig,
        named: Vec<Axis>,
        sdo: Option<&SdoHandle>,
        config: impl Fn(&FoundAxis, AxisConfig) -> AxisConfig,
    ) {
        for (number, axis) in (1..).zip(named) {
            let velocity = obj::TARGET_VELOCITY.offset(AxisOffset::of_axis(number));
            let declared = axis.declare();
            let Axis { name, units, .. } = axis;
            let axis = FoundAxis {
                jogs: match sdo {
                    Some(sdo) => sdo.read(velocity).await.is_ok(),
                    None => false,
                },
                name,
                drive: id.clone(),
                units,
            };
            drive = drive.axis(config(&axis, declared));
            self.axes.push(axis);
        }
        self.drives.push((id.position, drive));
    }

    /// The devices that are no drives stay as they are.
    pub(crate) fn without_ios(mut self) -> Self {
        self.ios.clear();
        self
    }

    /// The other devices stay as they are, unless a file says that they belong to the machine.
    pub(crate) fn only(mut self, position: u16) -> Self {
        if self.machine.is_none() {
            self.drives.retain(|(other, _)| *other == position);
            self.ios.clear();
        }
        self
    }

    /// The axis of this name; without one, the only axis.
    pub(crate) fn axis(&self, name: Option<&str>) -> Result<&FoundAxis, Failure> {
        let all = || self.axes.iter().map(|axis| axis.name.as_str());
        match (name, self.axes.as_slice()) {
            (None, [only]) => Ok(only),
            (None, _) => {
                let all: Vec<_> = all().collect();
                Err(format!("which axis? --axis {}", all.join(", --axis ")).into())
            }
            (Some(name), axes) => axes.iter().find(|axis| axis.name == name).ok_or_else(|| {
                let all: Vec<_> = all().collect();
                format!(
                    "there is no axis \"{name}\": the line has {}",
                    all.join(", ")
                )
                .into()
            }),
        }
    }
}

/// A device that is no drive, by what it exchanges by default; none where that is nothing.
fn io(device: &LineDevice) -> Option<IoConfig> {
    if points_of(device.sii.as_ref()?).is_empty() {
        return None;
    }
    let DriveId {
        position,
        name,
        identity,
    } = &device.id;
    let expected = Expected::new(identity.vendor, identity.product).named(name.clone());
    Some(IoConfig::new(&io_name(*position), expected))
}

/// How an axis is called that no file names.
pub(crate) fn axis_name(position: u16, number: impl std::fmt::Display) -> String {
    format!("{position}-{number}")
}
