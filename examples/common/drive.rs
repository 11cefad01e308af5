//! The drive of a line that an example works on.

use std::error::Error;

use clap::Args;
use servocrab::{bus::Line, coe::SdoHandle};

/// Which drive.
#[derive(Args)]
pub(crate) struct DriveArguments {
    /// Position of the drive in the line, from 0; without it, the first with CoE.
    #[arg(long, global = true)]
    drive: Option<usize>,
}

impl DriveArguments {
    /// Its objects.
    pub(crate) fn of<'line>(&self, line: &'line Line) -> Result<&'line SdoHandle, Box<dyn Error>> {
        let mut devices = line.devices().iter();
        let device = match self.drive {
            Some(position) => devices.nth(position),
            None => devices.find(|device| device.sdo.is_some()),
        };
        let device = device.ok_or("there is no such drive in the line")?;
        device.sdo.as_ref().ok_or_else(|| {
            let problem = device.problem.as_ref().map(ToString::to_string);
            let problem = problem.unwrap_or_else(|| format!("{} has no CoE", device.id));
            problem.into()
        })
    }
}
