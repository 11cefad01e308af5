//! The bus thread: discovery, configuration, cyclic exchange.

mod watchdog;

pub use watchdog::{WatchdogError, arm_watchdog};
