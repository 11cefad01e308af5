//! What can be wrong with a declared mapping.

use super::Direction;
use crate::coe::ObjectAddress;

/// A declaration that no drive, or not this one, can take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MappingError {
    /// The object cannot be mapped in this direction.
    #[error("{object} {name} cannot be mapped into the {direction}")]
    NotMappable {
        /// The object.
        object: ObjectAddress,
        /// Its name.
        name: &'static str,
        /// The direction.
        direction: Direction,
    },
    /// The object is declared twice in one direction.
    #[error("{object} is mapped twice into the {direction}")]
    ObjectTwice {
        /// The object.
        object: ObjectAddress,
        /// The direction.
        direction: Direction,
    },
    /// An object was named before a PDO of its direction.
    #[error("{object} is declared before any PDO of the {direction}")]
    NoPdo {
        /// The object.
        object: ObjectAddress,
        /// The direction.
        direction: Direction,
    },
    /// The index is none of a PDO of this direction.
    #[error("{pdo:04X}h is no PDO of the {direction}")]
    WrongPdo {
        /// The index.
        pdo: u16,
        /// The direction.
        direction: Direction,
    },
    /// The PDO is named twice.
    #[error("PDO {pdo:04X}h is declared twice")]
    PdoTwice {
        /// The PDO.
        pdo: u16,
    },
    /// The PDO holds more objects than the drive takes.
    #[error("PDO {pdo:04X}h holds {entries} objects, the drive takes {limit}")]
    TooManyEntries {
        /// The PDO.
        pdo: u16,
        /// Objects declared.
        entries: usize,
        /// Objects that the drive takes.
        limit: usize,
    },
    /// No PDO that the drive offers holds the object, or not together with the others that are needed.
    #[error(
        "{object} {name} is in no PDO of the {direction} that the drive offers and that can be assigned together with the others"
    )]
    NotOffered {
        /// The object.
        object: ObjectAddress,
        /// Its name.
        name: &'static str,
        /// The direction.
        direction: Direction,
    },
    /// More PDOs are assigned than the drive takes.
    #[error("{pdos} PDOs of the {direction}, the drive takes {limit}")]
    TooManyPdos {
        /// The direction.
        direction: Direction,
        /// PDOs declared.
        pdos: usize,
        /// PDOs that the drive takes.
        limit: usize,
    },
    /// The process data are longer than the drive takes.
    #[error("{bytes} bytes of {direction}, the drive takes {limit}")]
    TooLong {
        /// The direction.
        direction: Direction,
        /// Bytes declared.
        bytes: usize,
        /// Bytes that the drive takes.
        limit: usize,
    },
}
