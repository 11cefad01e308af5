//! The bus thread: discovery, configuration, cyclic exchange, and the [`Network`] that a program holds of it.

mod acyclic;
mod al;
mod axes;
mod black_box;
mod bring_up;
mod builder;
mod cable;
mod config;
mod control;
mod cycle;
mod dc;
mod discovery;
mod drive_setup;
mod eeprom;
mod error;
mod exchange;
mod expected;
mod frame;
mod gap;
mod histogram;
mod io;
mod journal;
mod line;
mod line_check;
mod log;
mod mailbox_states;
mod network;
mod packing;
mod plan;
mod port_errors;
mod progress;
mod reactor;
mod real_time;
mod receiving;
mod registers;
mod statistics;
mod supervisor;
mod sync_managers;
mod tasks;
mod time;
mod watchdog;

pub use al::{AlError, AlState, AlStatus};
pub use black_box::{Answered, BlackBox, RecordedCycle, Trouble};
pub use builder::{BusLoop, NetworkBuilder, Starting};
pub use cable::CableLoad;
pub use config::DriveConfig;
pub use control::{ClockEvent, NetworkEvent};
pub use dc::{DistributedClock, TopologyError};
pub use eeprom::EepromError;
pub use error::{BringUpStep, DriveFault, NetworkError};
pub use expected::{DevicePlace, Expected, LineMismatch, LineRow, Present, Verdict};
pub use histogram::Durations;
pub use io::{
    Io, IoConfig, IoError, IoErrorKind, IoInput, IoOutput, IoPoint, IoStatus, IoValue, PointName,
    Sampled, Stale,
};
pub use line::{Line, LineDevice};
pub use network::{Network, NetworkEvents, NetworkStop};
pub use port_errors::{DevicePorts, PortErrors};
pub use progress::BringUpProgress;
pub use real_time::{RealTime, RealTimeError, Scheduling};
pub use receiving::Receiving;
pub use registers::RegisterError;
pub use statistics::{ClockStatistics, DriveStatistics, ReferenceClock, Statistics, Timing};
pub use sync_managers::{SyncManagerError, WatchdogState};
pub use watchdog::{WatchdogError, arm_watchdog};
