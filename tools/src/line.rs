//! The line that a command works on.

use std::{fmt::Write, path::PathBuf, str::FromStr};

use clap::{Args, ValueEnum};
use servocrab::{
    Network,
    bus::{Line, LineDevice, NetworkBuilder},
    coe::{DriveId, SdoHandle},
    link::Wire,
};
use servocrab_attach::{ClientError, Program, socket_of};
use servocrab_sim::{Device, EsiChoice, EsiDrive, Segment, personality};

use crate::{
    machine::{Machine, simulate},
    output::{Failure, Tool},
};

/// Which line.
#[derive(Args)]
pub(crate) struct LineArguments {
    /// The network interface that the line is on
    #[arg(long, global = true, value_name = "NAME", conflicts_with = "sim")]
    interface: Option<String>,
    /// A line that is simulated in this process, in place of a real one: its devices in order, of akd2g, pp2010, ax2000, sigma7, generic,
    /// coupler and io, a drive's ESI file as FILE.xml[:PRODUCT[:REVISION]], or all those of a machine.toml
    #[arg(long, global = true, value_name = "DEVICES", value_delimiter = ',')]
    sim: Vec<Simulated>,
}

/// What can be simulated.
#[derive(Clone, Debug)]
enum Simulated {
    Known(Known),
    /// What the file describes.
    Esi(EsiChoice),
    /// The devices of a `machine.toml`.
    Machine(PathBuf),
}

/// The devices that the simulator knows.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Known {
    /// Kollmorgen AKD2G, two axes
    Akd2g,
    /// Stepper drive with object 2010h
    Pp2010,
    /// Beckhoff AX2000
    Ax2000,
    /// Yaskawa Sigma-7
    Sigma7,
    /// Plain CiA 402 drive
    Generic,
    /// A coupler without process data
    Coupler,
    /// An I/O terminal without CoE
    Io,
}

impl FromStr for Simulated {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Ok(known) = Known::from_str(text, false) {
            return Ok(Self::Known(known));
        }
        let Ok(choice) = text.parse::<EsiChoice>();
        let ends_in = |kind: &str| {
            choice
                .file
                .extension()
                .is_some_and(|end| end.eq_ignore_ascii_case(kind))
        };
        if ends_in("xml") {
            Ok(Self::Esi(choice))
        } else if ends_in("toml") {
            Ok(Self::Machine(choice.file))
        } else {
            let known = Known::value_variants()
                .iter()
                .filter_map(Known::to_possible_value);
            let known: Vec<_> = known.map(|value| value.get_name().to_owned()).collect();
            Err(format!(
                "expected one of {}, an ESI file (.xml) or a machine's file (.toml)",
                known.join(", ")
            ))
        }
    }
}

impl Simulated {
    fn build(&self) -> Result<Vec<Device>, Failure> {
        match self {
            Self::Known(known) => Ok(vec![known.build()]),
            Self::Esi(choice) => Ok(vec![EsiDrive::choose(choice)?.build()]),
            Self::Machine(file) => simulate::devices(&Machine::load(file)?),
        }
    }
}

impl Known {
    fn build(self) -> Device {
        match self {
            Self::Akd2g => personality::akd2g(),
            Self::Pp2010 => personality::pp2010(),
            Self::Ax2000 => personality::ax2000(),
            Self::Sigma7 => personality::sigma7(),
            Self::Generic => personality::generic(),
            Self::Coupler => personality::coupler(),
            Self::Io => personality::io_terminal(),
        }
    }
}

impl LineArguments {
    /// The network interface, of a line that is not simulated here.
    pub(crate) fn interface(&self) -> Option<&str> {
        self.interface.as_deref()
    }

    /// A network on this line. Here alone a command gets at a line.
    pub(crate) fn network(&self) -> Result<NetworkBuilder, Failure> {
        match &self.interface {
            Some(interface) => Ok(Network::builder().interface(interface)),
            None if self.sim.is_empty() => Err(
                "which line? Name its network interface (--interface eth0), or simulated devices (--sim akd2g,io)"
                    .into(),
            ),
            None => {
                let devices = self.sim.iter().map(Simulated::build);
                let devices = devices.collect::<Result<Vec<_>, _>>()?.into_iter().flatten();
                let mut segment = Segment::new();
                for (position, mut device) in (0..).zip(devices) {
                    // No two crystals are alike; these are within 50 ppm, as most are.
                    device.set_clock(position, (position * 37 % 101) as f64 - 50.0);
                    segment.push(device);
                }
                Ok(Network::builder().link(Wire::new(move |frame, now| segment.process(frame, now))))
            }
        }
    }

    /// The line, in PREOP.
    pub(crate) async fn scan(&self, tool: &Tool) -> Result<Line, Failure> {
        let builder = self.network()?;
        tool.unless_interrupted(async { Ok(builder.scan().await?) })
            .await
    }

    /// The line of the program that shows the interface's network, or else the line itself, in PREOP.
    pub(crate) async fn open(&self, tool: &Tool) -> Result<OpenLine, Failure> {
        if let Some(program) = self.program()? {
            let drives = tool.unless_interrupted(async { Ok(program.drives().await?) });
            let drives = drives.await?;
            tool.note("a running program has the line, and is asked: nothing is reset");
            return Ok(OpenLine::Shown(drives));
        }
        Ok(OpenLine::Own(self.scan(tool).await?))
    }

    /// The program that shows the network of this interface, if there is one.
    pub(crate) fn program(&self) -> Result<Option<Program>, Failure> {
        let Some(interface) = self.interface() else {
            return Ok(None);
        };
        match Program::open(&socket_of(interface)) {
            Ok(program) => Ok(Some(program)),
            // Nobody has the interface, or who has it shows nothing: then the line itself is opened, or that is refused.
            Err(ClientError::Nobody(_)) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}

/// A line whose objects can be read.
pub(crate) enum OpenLine {
    /// In PREOP.
    Own(Line),
    /// The drives that a running program has declared.
    Shown(Vec<SdoHandle>),
}

impl OpenLine {
    pub(crate) fn devices(&self) -> Vec<Found<'_>> {
        match self {
            Self::Own(line) => found(line),
            Self::Shown(drives) => drives
                .iter()
                .map(|sdo| Found {
                    id: sdo.drive(),
                    sdo: Some(sdo),
                    device: None,
                })
                .collect(),
        }
    }

    pub(crate) async fn close(self) {
        match self {
            Self::Own(line) => line.close().await,
            Self::Shown(_) => {}
        }
    }
}

/// The devices of a line in PREOP.
pub(crate) fn found(line: &Line) -> Vec<Found<'_>> {
    let devices = line.devices().iter();
    devices
        .map(|device| Found {
            id: &device.id,
            sdo: device.sdo.as_ref(),
            device: Some(device),
        })
        .collect()
}

/// A device of a line.
#[derive(Clone, Copy)]
pub(crate) struct Found<'line> {
    pub(crate) id: &'line DriveId,
    pub(crate) sdo: Option<&'line SdoHandle>,
    /// As it was scanned; none of a program's line.
    pub(crate) device: Option<&'line LineDevice>,
}

impl<'line> Found<'line> {
    pub fn objects(self) -> Result<&'line SdoHandle, Failure> {
        self.sdo.ok_or_else(|| {
            let problem = self.device.and_then(|device| device.problem.as_ref());
            let problem = problem.map(ToString::to_string);
            let problem = problem.unwrap_or_else(|| format!("{} has no CoE", self.id));
            problem.into()
        })
    }
}

/// Which drive of the line.
#[derive(Args)]
pub(crate) struct DriveArguments {
    /// Position of the drive in the line, from 0; without it, the only device with CoE
    #[arg(long, global = true, value_name = "POSITION")]
    pub(crate) drive: Option<u16>,
}

impl DriveArguments {
    /// Its objects.
    pub(crate) fn of<'line>(&self, line: &[Found<'line>]) -> Result<&'line SdoHandle, Failure> {
        if self.drive.is_some() {
            return self.device(line)?.objects();
        }
        let all: Vec<_> = line.iter().filter(|found| found.sdo.is_some()).collect();
        match all.as_slice() {
            [one] => one.objects(),
            [] => Err(format!("no device of the line has CoE:\n{}", places(line)).into()),
            _ => Err(which(line)),
        }
    }

    /// The device, with or without CoE.
    pub(crate) fn device<'line>(&self, line: &[Found<'line>]) -> Result<Found<'line>, Failure> {
        let Some(position) = self.drive else {
            return match line {
                [one] => Ok(*one),
                _ => Err(which(line)),
            };
        };
        let found = line.iter().find(|found| found.id.position == position);
        let nothing = || format!("there is nothing at position {position}:\n{}", places(line));
        Ok(*found.ok_or_else(nothing)?)
    }
}

fn which(line: &[Found<'_>]) -> Failure {
    format!("which drive? --drive POSITION:\n{}", places(line)).into()
}

/// Who is where, for an error.
fn places(line: &[Found<'_>]) -> String {
    line.iter().fold(String::new(), |mut text, found| {
        let _ = writeln!(text, "  {}: {}", found.id.position, found.id.name);
        text
    })
}
