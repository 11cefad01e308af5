//! PDO mapping: declared once, written by the rules, read back, laid out.
//!
//! A [`Mapping`] is declared with typed objects. From that one declaration come the SDO writes
//! ([`Mapping::plan`]), the check of what the drive then holds ([`verify`](verify::compare)), and the places
//! of the objects in the process data ([`Layout`], [`Field`]).

mod entry;
#[cfg(feature = "std")]
mod execute;
mod layout;
mod mapping;
mod mapping_error;
mod offer;
mod plan;
pub mod verify;

pub use entry::{Entry, Pdo};
#[cfg(feature = "std")]
pub use execute::{ConfigureError, configure, execute, read_assigned, read_back, read_offered};
pub use layout::{Field, Layout, LayoutError, Place};
pub use mapping::{Direction, Limits, Mapping, MappingBuilder};
pub use mapping_error::MappingError;
pub use offer::{Demand, FixedPdo, choose};
pub use plan::{Plan, Purpose, Step};
