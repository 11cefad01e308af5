//! How the motions of an axis ended, counted for those who look beside the program.

use core::{
    fmt,
    sync::atomic::{AtomicU64, Ordering},
};

use crate::{Failure, FailureClass, axis::Completion, coe::CodeCounts};

use super::AxisIdentity;

/// How a move, a homing or a jog has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum MotionEnd {
    /// A move at its target, or a jog at a velocity that its program has let go.
    Reached,
    /// A move that went on into the next one.
    Passed,
    /// A homing that is attained.
    Homed,
    /// A later move took its place, or perhaps did.
    Superseded,
    /// The axis was stopped, halted or disabled, or nobody held its jog.
    Stopped,
    /// The axis has a fault.
    Fault,
    /// The drive counts as lost, or has left OP.
    Lost,
    /// It stands elsewhere, or never began.
    Missed,
    /// Where it ended was not seen.
    Unknown,
    /// A time limit ran out, or the drive reports an error of the homing.
    Failed,
    /// Nothing of it was sent: what its error names was against it.
    Refused,
}

/// All of them with their names, in their order.
const ENDS: [(MotionEnd, &str); 11] = [
    (MotionEnd::Reached, "reached"),
    (MotionEnd::Passed, "passed"),
    (MotionEnd::Homed, "homed"),
    (MotionEnd::Superseded, "superseded"),
    (MotionEnd::Stopped, "stopped"),
    (MotionEnd::Fault, "fault"),
    (MotionEnd::Lost, "lost"),
    (MotionEnd::Missed, "missed"),
    (MotionEnd::Unknown, "unknown"),
    (MotionEnd::Failed, "failed"),
    (MotionEnd::Refused, "refused"),
];

impl MotionEnd {
    const fn of(result: &Result<Completion, Failure>) -> Self {
        let failure = match result {
            Ok(Completion::Reached { .. } | Completion::Prepared { .. } | Completion::Done) => {
                return Self::Reached;
            }
            Ok(Completion::Passed { .. }) => return Self::Passed,
            Ok(Completion::Homed { .. }) => return Self::Homed,
            Ok(Completion::Stopped { .. }) => return Self::Stopped,
            Err(failure) => failure,
        };
        match failure.class() {
            _ if matches!(failure, Failure::Superseded) => Self::Superseded,
            _ if matches!(failure, Failure::Fault { .. }) => Self::Fault,
            FailureClass::Aborted => Self::Stopped,
            FailureClass::Lost => Self::Lost,
            FailureClass::Missed => Self::Missed,
            FailureClass::Unknown => Self::Unknown,
            FailureClass::Late | FailureClass::DriveFault => Self::Failed,
            FailureClass::Refused => Self::Refused,
        }
    }
}

impl fmt::Display for MotionEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(ENDS.get(*self as usize).map_or("", |(_, name)| name))
    }
}

/// What has become of an axis' motions since its network started.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct AxisStatistics {
    /// The axis and its drive.
    pub axis: AxisIdentity,
    /// How many moves, homings and jogs ended in which way; without those that nothing ended in.
    pub motions: Vec<(MotionEnd, u64)>,
    /// How many faults there were of each error code 603Fh. `None`: 603Fh is not mapped or was 0. Sixteen codes are counted apart; `None`
    /// stands for all others too.
    pub faults: Vec<(Option<u16>, u64)>,
}

/// The counters behind it. The bus thread alone counts.
#[derive(Debug, Default)]
pub(super) struct AxisCounts {
    motions: [AtomicU64; ENDS.len()],
    faults: CodeCounts,
}

impl AxisCounts {
    pub fn ended(&self, result: &Result<Completion, Failure>) {
        if let Some(count) = self.motions.get(MotionEnd::of(result) as usize) {
            count.fetch_add(1, Ordering::Relaxed);
        }
    }

    pub fn fault(&self, code: Option<u16>) {
        self.faults.add(code);
    }

    pub fn read(&self, axis: AxisIdentity) -> AxisStatistics {
        let counted = ENDS.iter().zip(&self.motions);
        let counted = counted.map(|(&(end, _), count)| (end, count.load(Ordering::Relaxed)));
        AxisStatistics {
            axis,
            motions: counted.filter(|(_, number)| *number > 0).collect(),
            faults: self.faults.read(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_end_has_a_counter_and_a_name_of_its_own() {
        for (place, (end, name)) in ENDS.into_iter().enumerate() {
            assert_eq!(end as usize, place, "{end}");
            assert_eq!(format!("{end:?}").to_lowercase(), name);
        }
    }
}
