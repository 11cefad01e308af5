//! What an outcome says, by class. Everything that depends on the names of failures is here.

use servocrab::axis::{Delivery, Failure};

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// Nothing was sent.
    Refused,
    /// A command ended it.
    Aborted,
    /// The drive has ended it elsewhere.
    Missed,
    /// Nobody knows.
    Unknown,
    DriveFault,
    Lost,
    /// A deadline passed, and nothing of it is open.
    Late,
}

impl Class {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Refused => "Refused",
            Self::Aborted => "Aborted",
            Self::Missed => "Missed",
            Self::Unknown => "Unknown",
            Self::DriveFault => "DriveFault",
            Self::Lost => "Lost",
            Self::Late => "Late",
        }
    }
}

pub const fn class(failure: &Failure) -> Class {
    use Failure as F;
    match failure {
        F::Superseded
        | F::QuickStopped { .. }
        | F::Disabled { .. }
        | F::NotHeld
        | F::WrongMode { .. } => Class::Aborted,
        F::Halted { delivery } => match delivery {
            Delivery::NotSent => Class::Refused,
            _ => Class::Aborted,
        },
        F::MissedTarget { .. } => Class::Missed,
        F::Unseen { .. }
        | F::EndNotKnown { .. }
        | F::NotBegun { .. }
        | F::Unconfirmed { .. }
        | F::PerhapsSuperseded { .. } => Class::Unknown,
        F::Timeout { delivery, .. } => match delivery {
            Delivery::NotSent => Class::Late,
            _ => Class::Unknown,
        },
        F::Fault { .. }
        | F::HaltIgnored
        | F::QuickStopIgnored
        | F::HomingError { .. }
        | F::LocalControl { .. }
        | F::SwitchOnRefused { .. }
        | F::NoVoltage { .. } => Class::DriveFault,
        F::BusLost { .. } | F::LeftOp { .. } | F::Undelivered { .. } | F::ClockJumped => {
            Class::Lost
        }
        _ => Class::Refused,
    }
}

/// Whether the drive cannot have the set-point.
pub const fn is_unsent(failure: &Failure) -> bool {
    use Failure as F;
    match failure {
        F::Halted { delivery }
        | F::QuickStopped { delivery }
        | F::WrongMode { delivery, .. }
        | F::BusLost { delivery }
        | F::LeftOp { delivery, .. }
        | F::Undelivered { delivery, .. }
        | F::Timeout { delivery, .. } => matches!(delivery, Delivery::NotSent),
        _ => matches!(class(failure), Class::Refused),
    }
}

/// Whether the drive may still hold the set-point: the next move needs a stop.
pub const fn leaves_open(failure: &Failure) -> bool {
    match failure {
        Failure::NotBegun { .. } => true,
        Failure::Timeout { delivery, .. } => !matches!(delivery, Delivery::NotSent),
        _ => false,
    }
}
