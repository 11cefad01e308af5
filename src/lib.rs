//! Servo axes over EtherCAT: CoE configuration of drives, PDO mapping and cyclic process data. A program gets one typed, awaited
//! handle per axis, with the DS402 operations of Profile Position, homing and jogging.
//!
//! ```
//! # #[cfg(feature = "std")]
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use std::time::Duration;
//! use servocrab::{AxisConfig, DriveConfig, Network, Outcome, Referencing, SetPoint, drives, link::Wire};
//! use servocrab_sim::{Segment, personality};
//!
//! // A simulated segment in this process. On a real link: `.interface("eth0")` in place of `.link(wire)`.
//! let mut segment = Segment::new().with(personality::akd2g());
//! let wire = Wire::new(move |frame, now| segment.process(frame, now));
//!
//! smol::block_on(async {
//!     // Both motors have absolute encoders; an axis without one is homed before its first absolute move.
//!     let drive = DriveConfig::new(drives::akd2g())
//!         .axis(AxisConfig::new("x").referencing(Referencing::AbsoluteEncoder))
//!         .axis(AxisConfig::new("y").referencing(Referencing::AbsoluteEncoder));
//!     let net = Network::builder()
//!         .link(wire)
//!         .cycle(Duration::from_millis(1))
//!         .drive(0, drive)
//!         .start()
//!         .await?;
//!
//!     let x = net.axis("x")?;
//!     x.enable().await?;
//!     let profile_position = x.profile_position().await?;
//!     let set_point = SetPoint::new().velocity(50_000).acceleration(500_000).deceleration(500_000);
//!     let motion = profile_position.move_abs(2_000, set_point).await?; // the drive has acknowledged
//!     assert!(matches!(motion.done().await?, Outcome::Reached { .. })); // and has arrived
//!
//!     profile_position.release().await?;
//!     x.disable().await?;
//!     net.shutdown().await?;
//!     Ok(())
//! })
//! # }
//! # #[cfg(not(feature = "std"))]
//! # fn main() {}
//! ```
//!
//! # Layers
//!
//! | module | what it is | without `std` |
//! |---|---|---|
//! | [`axis`] | the handle of an axis, and the pure core behind it | the core |
//! | [`profile_position`] | set-points, the handshake of bits 4 and 12, outcomes | all but the handle |
//! | [`homing`] | homing: bit 4 held until attained or failed | all but the handle |
//! | [`profile_velocity`] | jogging: a velocity while it is held | all but the handle |
//! | [`ds402`] | statusword, controlword, states, modes, codes | all |
//! | [`coe`] | typed objects, SDO transfers, emergencies | codec and types |
//! | [`pdo_map`] | the mapping: declared once, written, read back, laid out | all but writing it |
//! | [`sii`] | what a device's EEPROM says | all |
//! | [`units`] | millimetres and degrees in place of counts | all but the handles |
//! | [`drives`] | particular drives, as data | all |
//! | `esi` | makers' ESI files (feature `esi`) | – |
//! | `parameters` | start-up lists and parameters of drives, in code and in files | – |
//! | `bus` | the bus thread and the `Network` | – |
//! | `link` | raw socket and in-process wire | – |
//!
//! Commands go from a handle through a bounded queue to the bus thread. It steps one [`axis::AxisCore`] per axis and cycle. Reports
//! and a snapshot come back. Stops go beside the queue and are in the next frame sent. A program with an `ethercrab` loop of its
//! own steps the cores itself (`examples/own_loop.rs`).
//!
//! # Safety
//!
//! Nothing here is a safety function in the sense of the machinery standards (STO, SS1, IEC 61800-5-2). Stops are prompt and
//! watchdogs are armed; people are protected by safety devices that work without this library.
#![cfg_attr(not(feature = "std"), no_std)]

extern crate alloc;

pub mod axis;
#[cfg(feature = "std")]
pub mod bus;
pub mod coe;
pub mod drives;
pub mod ds402;
#[cfg(feature = "std")]
mod esc;
#[cfg(feature = "esi")]
pub mod esi;
#[cfg(feature = "std")]
mod handle;
pub mod homing;
#[cfg(feature = "std")]
pub mod link;
#[cfg(feature = "std")]
pub mod parameters;
pub mod pdo_map;
pub mod profile_position;
pub mod profile_velocity;
pub mod sii;
#[cfg(feature = "std")]
mod sync;
mod timer;
pub mod units;
#[cfg(feature = "std")]
mod wakes;

/// The Rust blocks of the README and of the guide, which `cargo test --doc` compiles.
#[cfg(all(doctest, feature = "esi"))]
mod pages {
    #[doc = include_str!("../README.md")]
    mod readme {}
    #[doc = include_str!("../docs/guide/first-move.md")]
    mod first_move {}
    #[doc = include_str!("../docs/guide/units.md")]
    mod units {}
    #[doc = include_str!("../docs/guide/homing.md")]
    mod homing {}
    #[doc = include_str!("../docs/guide/paths.md")]
    mod paths {}
    #[doc = include_str!("../docs/guide/cell.md")]
    mod cell {}
    #[doc = include_str!("../docs/guide/io.md")]
    mod io {}
    #[doc = include_str!("../docs/guide/faults.md")]
    mod faults {}
    #[doc = include_str!("../docs/guide/tests.md")]
    mod tests {}
    #[doc = include_str!("../docs/guide/own-drive.md")]
    mod own_drive {}
    #[doc = include_str!("../docs/guide/probe.md")]
    mod probe {}
    #[doc = include_str!("../docs/guide/brake.md")]
    mod brake {}
    #[doc = include_str!("../docs/guide/gantry.md")]
    mod gantry {}
    #[doc = include_str!("../docs/guide/service.md")]
    mod service {}
}

/// The targets of log lines: what belongs to one axis, to one device, to the line and its cycle.
mod log_target {
    pub const AXIS: &str = "servocrab::axis";
    #[cfg(feature = "std")]
    pub const DRIVE: &str = "servocrab::drive";
    #[cfg(feature = "std")]
    pub const BUS: &str = "servocrab::bus";
}

// What most programs name. It has no other path.
pub use axis::command::StopRequest;
pub use axis::config::Referencing;
#[cfg(feature = "std")]
pub use bus::{
    device::{
        config::{AxisConfig, DriveConfig},
        io::{IoInput, IoOutput},
    },
    error::NetworkError,
    network::Network,
};
#[cfg(feature = "std")]
pub use handle::{
    Axis, AxisError, Homing, Move, Outcome, ProfilePosition, ProfileVelocity, start_together,
};
pub use homing::parameters::{HomingMethod, HomingParameters};
pub use profile_position::{
    failure::{Doubt, Failure, FailureClass},
    set_point::{BufferMode, SetPoint},
};
