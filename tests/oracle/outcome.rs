//! The parts of an outcome, beyond its class.

pub use servocrab::FailureClass as Class;
use servocrab::{Failure, axis::Delivery};

pub const fn name(class: Class) -> &'static str {
    match class {
        Class::Refused => "Refused",
        Class::Aborted => "Aborted",
        Class::Missed => "Missed",
        Class::Unknown => "Unknown",
        Class::DriveFault => "DriveFault",
        Class::Lost => "Lost",
        Class::Late => "Late",
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
        F::Withdrawn => true,
        _ => matches!(failure.class(), Class::Refused),
    }
}

/// Whether the drive may still hold the set-point: the next move needs a stop.
pub const fn leaves_open(failure: &Failure) -> bool {
    matches!(failure, Failure::Unknown { doubt, .. } if doubt.needs_stop())
}
