//! The bus thread: discovery, configuration, cyclic exchange, and the [`Network`](crate::Network) that a program holds of it.
//!
//! Each room calls those above it in this table and none below it; `.ci/structure` checks the imports.
//!
//! | room | what it does |
//! |---|---|
//! | `cable`, `real_time` | times of frames on the cable; what the thread gets of the operating system |
//! | `expected`, `error` | the line that a program expects; all errors, and the states that they name |
//! | `cycle` | the process data: frames, exchange, statistics, black boxes |
//! | `event`, `log` | what happens to a running network; what of it is logged |
//! | `requests` | the loop, its tasks, and acyclic access to registers, AL states, SII and sync managers |
//! | `line` | which devices are there: from power-on to PREOP, and where a device went |
//! | `clocks` | distributed clocks |
//! | `device` | one device: its configuration, its way to SAFEOP, the handles of an I/O device |
//! | `watch` | what happens while cycles run: AL states, ports, working counters, axes |
//! | `network` | all devices together: start, run, recovery, end, and the handle of it |

mod cable;
mod clocks;
mod cycle;
pub(crate) mod device;
pub(crate) mod error;
mod event;
mod expected;
mod line;
mod log;
pub(crate) mod network;
mod real_time;
mod recorder;
mod requests;
mod watch;

pub use cable::CableLoad;
pub use clocks::DistributedClock;
pub use cycle::CycleClock;
pub use cycle::black_box::{Answered, AxisIncident, BlackBox, RecordedCycle};
pub use cycle::statistics::{ClockStatistics, DriveStatistics, Durations, Statistics, Timing};
pub use device::io::{Io, IoConfig, IoError, IoErrorKind, IoStatus, IoValue};
pub use device::io_points::{IoPoint, PointName};
pub use device::progress::BringUpProgress;
pub use error::{
    AlError, AlState, AlStatus, BringUpStep, DriveFault, EepromError, MovingAxis, NotStopped,
    ReferenceClock, RegisterError, SettingError, SyncManagerError, TopologyError, WatchdogState,
};
pub use event::{ClockEvent, DeviceFinding, Finding, Miscounted, NetworkEvent, Recovered};
pub use expected::{DevicePlace, Expected, LineMismatch, LineRow, LineVerdict, Present};
pub use network::builder::{HotConnectGroup, NetworkBuilder, Starting};
pub use network::hot_connect::HotConnect;
pub use network::scan::{
    EepromAccessError, EepromContent, EepromWritten, ImageKind, Line, LineDevice,
};
pub use network::view::{AxisView, NetworkView};
pub use network::{NetworkEvents, NetworkStop};
pub use real_time::{RealTime, RealTimeError, Scheduling};
pub use recorder::{
    Capture, NoSignal, RecordedCycles, RecordedSignal, RecordedValues, Recorder, Signal, Trigger,
    TriggerCondition,
};
pub use requests::sync_managers::{WatchdogError, arm_watchdog};
pub use requests::{BusLoop, WaitStrategy};
pub use watch::{DevicePorts, PortErrors, SeenDevice};

pub use crate::wakes::WakeStatistics;
