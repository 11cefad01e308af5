//! The line that a command works on.

use std::fmt::Write;

use clap::{Args, ValueEnum};
use servocrab::{
    bus::{Line, LineDevice, Network, NetworkBuilder},
    coe::SdoHandle,
    link::Wire,
};
use servocrab_sim::{Device, Segment, personality};

use crate::output::{Failure, Tool};

/// Which line.
#[derive(Args)]
pub(crate) struct LineArguments {
    /// The network interface that the line is on
    #[arg(long, global = true, value_name = "NAME", conflicts_with = "sim")]
    interface: Option<String>,
    /// A line that is simulated in this process, in place of a real one: its devices in order
    #[arg(long, global = true, value_name = "DEVICES", value_delimiter = ',')]
    sim: Vec<Simulated>,
}

/// The devices that can be simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Simulated {
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

impl Simulated {
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
                let mut segment = Segment::new();
                for (position, kind) in (0..).zip(&self.sim) {
                    let mut device = kind.build();
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
    pub(crate) fn of<'line>(&self, line: &'line Line) -> Result<&'line SdoHandle, Failure> {
        let Some(position) = self.drive else {
            let all: Vec<_> = line.devices().iter().filter(|d| d.sdo.is_some()).collect();
            return match all.as_slice() {
                [one] => objects(one),
                [] => Err(format!("no device of the line has CoE:\n{}", places(line)).into()),
                _ => Err(format!("which drive? --drive POSITION:\n{}", places(line)).into()),
            };
        };
        let device = line.devices().get(usize::from(position));
        let device = device
            .ok_or_else(|| format!("there is nothing at position {position}:\n{}", places(line)))?;
        objects(device)
    }
}

/// The objects of a device.
pub(crate) fn objects(device: &LineDevice) -> Result<&SdoHandle, Failure> {
    device.sdo.as_ref().ok_or_else(|| {
        let problem = device.problem.as_ref().map(ToString::to_string);
        let problem = problem.unwrap_or_else(|| format!("{} has no CoE", device.id));
        problem.into()
    })
}

/// Who is where, for an error.
fn places(line: &Line) -> String {
    line.devices()
        .iter()
        .fold(String::new(), |mut text, device| {
            let _ = writeln!(text, "  {}: {}", device.id.position, device.id.name);
            text
        })
}
