//! A simulated EtherCAT segment with DS402 drives: bytes in, bytes out.
//!
//! A [`Segment`] is a line of SubDevices. [`Segment::process`] takes a whole Ethernet frame through it and back, as a
//! ring of real ones would: datagrams, working counters, FMMUs, sync managers, mailboxes, AL states. Time is an argument,
//! so a test runs thousands of cycles in milliseconds. [`ds402::Axis`] is the drive behind the objects, with a ledger of
//! the set-points it executed, and [`ds402::Plant`] is the shaft that hangs on it. What goes wrong is [`Faults`], from a seed.
//!
//! Nothing here shares code or constants with a MainDevice library: it is written from the standards and the drives'
//! documents, so that one misreading cannot cancel out.

/// The Rust block of the README, which `cargo test --doc` compiles.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}

mod al;
mod cable;
mod coe;
mod datagram;
mod description;
mod device;
mod dictionary;
mod drive;
pub mod ds402;
mod esc;
mod esi_file;
mod faults;
mod frame;
#[cfg(target_os = "linux")]
pub mod link;
mod mailbox;
mod pdo;
pub mod personality;
mod seeded_faults;
mod segment;
mod sii;
mod topology;

pub use al::AlState;
pub use coe::Abort;
pub use description::{
    ClockDemand, ClockMode, ClockWidth, Description, Direction, Identity, Mailbox, PdoDescription,
    PdoEntryDescription, SyncManagerDescription, SyncManagerUse,
};
pub use device::{Blueprint, Device, EepromReload, Habits, ListedEntry, ListedObject};
pub use drive::{AxisStatusObject, DriveBlueprint, PlainEntry, PlainObject};
pub use esi_file::{EsiChoice, EsiDrive, EsiError};
pub use faults::{Fault, FaultyWire};
pub use pdo::{PdoHabit, PdoLimits};
pub use seeded_faults::{Delayed, Faults, FaultsError, FaultyLine, Outage, PlantChoice, Rate};
pub use segment::{CycleRecord, Segment};
