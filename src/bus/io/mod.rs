//! Devices of the line that are no drives: what they send and take, by name and typed.

mod cell;
mod error;
mod handle;
mod points;
mod port;
mod setup;

pub use error::{IoError, IoErrorKind};
pub use handle::{Io, IoInput, IoOutput, IoStatus, IoValue, Sampled, Stale};
pub use points::{IoPoint, PointName};
pub(super) use port::Ports;
pub(super) use setup::{IoJob, ReadyIo};

use super::Expected;
use crate::parameters::StartUpList;

/// A device of the line whose process data the program uses: an I/O terminal, a valve island, a sensor.
///
/// ```
/// use servocrab::bus::{Expected, IoConfig, Network};
/// let builder = Network::builder()
///     .io(1, IoConfig::new("buttons", Expected::new(0x2, 0x03F0_3052).named("EL1008")))
///     .io(2, IoConfig::new("valves", Expected::new(0x2, 0x07D8_3052).named("EL2008")));
/// ```
#[derive(Debug, Clone)]
pub struct IoConfig {
    pub(super) name: String,
    pub(super) expected: Expected,
    pub(super) start_up: Vec<StartUpList>,
}

impl IoConfig {
    /// The device that is called `name` in the program, and what it must be.
    ///
    /// Its process data are those of its PDO assignment, which is read from it, if it has CoE; else those that its SII assigns.
    /// Outputs are 0 until they are set.
    #[must_use]
    pub fn new(name: &str, expected: Expected) -> Self {
        Self {
            name: name.to_owned(),
            expected,
            start_up: Vec::new(),
        }
    }

    /// Writes this start-up list, or a single line of one, at its transitions: those of PREOP before the PDO assignment is read.
    #[must_use]
    pub fn start_up(mut self, list: impl Into<StartUpList>) -> Self {
        self.start_up.push(list.into());
        self
    }

    /// What is wrong with the declaration itself.
    pub(super) fn mistake(&self) -> Option<String> {
        let mistake = self.start_up.iter().find_map(StartUpList::mistake)?;
        Some(format!("start-up list: {mistake}"))
    }
}
