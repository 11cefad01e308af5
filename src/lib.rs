//! Servo axes over EtherCAT.
#![cfg_attr(not(feature = "std"), no_std)]

extern crate alloc;

pub mod axis;
#[cfg(feature = "std")]
pub mod bus;
pub mod coe;
pub mod drives;
pub mod ds402;
#[cfg(feature = "std")]
pub mod link;
pub mod pdo_map;
pub mod profile_position;
pub mod sii;
