//! What an axis handle's operations fail with: which axis, which drive, and why.

use core::{fmt, time::Duration};
use std::sync::Arc;

use crate::{
    coe::{DriveId, ObjectAddress, SdoError},
    ds402::Statusword,
    pdo_map::LayoutError,
    units::{ScaleError, ScaledFailure},
};

use super::Failure;

/// An operation of an axis did not end well.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{identity}: {kind}")]
pub struct AxisError {
    /// The axis and its drive.
    pub identity: Arc<AxisIdentity>,
    /// Why.
    pub kind: AxisErrorKind,
}

impl AxisError {
    /// The axis core's reason, where the axis itself refused or failed.
    #[must_use]
    pub const fn failure(&self) -> Option<Failure> {
        match self.kind {
            AxisErrorKind::Failed(failure)
            | AxisErrorKind::Scaled(ScaledFailure { failure, .. }) => Some(failure),
            _ => None,
        }
    }
}

/// The name of an axis and what its drive is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AxisIdentity {
    /// The axis' name in the program.
    pub axis: String,
    /// The drive.
    pub drive: DriveId,
}

impl fmt::Display for AxisIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "axis {} ({})", self.axis, self.drive)
    }
}

/// Why an operation of an axis did not end well.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum AxisErrorKind {
    /// The axis refused or failed.
    #[error("{0}")]
    Failed(Failure),
    /// The same of a handle in the program's own units, where the failure names positions or velocities.
    #[error("{0}")]
    Scaled(ScaledFailure),
    /// A number or a factor cannot be converted between the program's units and the drive's; nothing was sent.
    #[error("{0}")]
    Scale(ScaleError),
    /// The mode is leased already; release the other lease first.
    #[error("a mode of this axis is in use: release it first")]
    ModeInUse,
    /// More commands at once than there are places for.
    #[error("too many commands are waiting")]
    QueueFull,
    /// The network was closed, or its thread has ended.
    #[error("the network is closed")]
    Closed,
    /// The object is not in the drive's process data in this direction, or with another length than its type has.
    #[error("{0}")]
    Field(LayoutError),
    /// The object is written by the axis itself.
    #[error("{object} is written by the axis itself: use its operations")]
    OwnedByAxis {
        /// The object, as the drive numbers it for this axis.
        object: ObjectAddress,
    },
    /// An object could not be read or written by SDO.
    #[error("{0}")]
    Sdo(Arc<SdoError>),
    /// The caller waited no longer; nothing was stopped by that.
    #[error(
        "no outcome within {within:?} (statusword {statusword}); it goes on, unless it is stopped"
    )]
    Late {
        /// The deadline.
        within: Duration,
        /// The last statusword seen.
        statusword: Statusword,
    },
    /// A path has moves of another axis: nothing of such a move was sent.
    #[error(
        "this move is one of axis {axis}: a path moves one axis, use `axis::together` for several"
    )]
    OtherAxis {
        /// The axis that it is of.
        axis: String,
    },
    /// Moves are started together on the axes of one network, at least one, each axis once.
    #[error("moves that start together need axes of one network, each of them once")]
    NotTogether,
}
