//! Why an input or output cannot be had: what was asked for, beside what there is.

use std::fmt;

use super::IoPoint;
use crate::{coe::DriveId, pdo_map::Direction};

/// An input or output that cannot be had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("io `{io}`, {device:#}: {kind}")]
pub struct IoError {
    /// What the device is called in the program.
    pub io: String,
    /// The device.
    pub device: DriveId,
    /// What is the matter.
    pub kind: Box<IoErrorKind>,
}

/// Why an input or output cannot be had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum IoErrorKind {
    /// There is none with this name.
    #[error("{name} is not among its {direction}: {}", List(.there))]
    NoPoint {
        /// What was asked for.
        name: String,
        /// Inputs or outputs.
        direction: Direction,
        /// What there is.
        there: Vec<IoPoint>,
    },
    /// There are several with this name: take index and subindex.
    #[error("{name} is not unique, take index and subindex: {}", List(.points))]
    NotUnique {
        /// What was asked for.
        name: String,
        /// What has this name.
        points: Vec<IoPoint>,
    },
    /// It has another length.
    #[error("{point} does not have the {expected} of the type")]
    OtherWidth {
        /// What there is.
        point: IoPoint,
        /// Bits of the type.
        expected: u8,
    },
}

struct List<'a>(&'a [IoPoint]);

impl fmt::Display for List<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str("there are none");
        }
        for (number, point) in self.0.iter().enumerate() {
            let comma = if number == 0 { "" } else { ", " };
            write!(f, "{comma}{point}")?;
        }
        Ok(())
    }
}
