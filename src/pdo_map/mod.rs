//! PDO mapping: declared once, written by the rules, read back, laid out.
//!
//! A [`Mapping`] is declared with typed objects. From that one declaration come the SDO writes
//! ([`Mapping::plan`]) and the check of what the drive then holds ([`verify`](verify::compare)). So do the places
//! of the objects in the process data ([`Layout`], [`Field`]).

#[cfg(feature = "std")]
mod execute;
mod layout;
mod mapping;
mod offer;
pub mod verify;

#[cfg(feature = "std")]
pub use execute::{ConfigureError, configure, execute, read_assigned, read_back, read_offered};
pub use layout::{BitRange, Field, Layout, LayoutError};
pub use mapping::{
    Direction, Entry, MappedPdo, Mapping, MappingBuilder, MappingError, MappingLimits,
    MappingWrite, Plan, Purpose,
};
pub use offer::{Demand, FixedPdo, choose};
