//! The bus thread: discovery, configuration, cyclic exchange, and the [`Network`] that a program holds of it.

mod acyclic;
mod al;
mod axes;
mod bring_up;
mod builder;
mod config;
mod control;
mod cycle;
mod discovery;
mod drive_setup;
mod eeprom;
mod error;
mod exchange;
mod frame;
mod journal;
mod network;
mod packing;
mod reactor;
mod registers;
mod statistics;
mod supervisor;
mod sync_managers;
mod tasks;
mod time;
mod watchdog;

pub use al::{AlError, AlState, AlStatus};
pub use builder::{BusLoop, NetworkBuilder, Starting};
pub use config::DriveConfig;
pub use control::NetworkEvent;
pub use eeprom::EepromError;
pub use error::{BringUpStep, DriveFault, NetworkError};
pub use network::{Network, NetworkEvents, NetworkStop};
pub use registers::RegisterError;
pub use statistics::Statistics;
pub use sync_managers::{SyncManagerError, WatchdogState};
pub use watchdog::{WatchdogError, arm_watchdog};
