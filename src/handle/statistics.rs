//! What has become of an axis' motions, counted for those who look beside the program.

use core::fmt;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::{
    axis::{AxisIdentity, Completion, Failure},
    coe::CodeCounts,
};

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

impl MotionEnd {
    const ALL: [Self; 11] = [
        Self::Reached,
        Self::Passed,
        Self::Homed,
        Self::Superseded,
        Self::Stopped,
        Self::Fault,
        Self::Lost,
        Self::Missed,
        Self::Unknown,
        Self::Failed,
        Self::Refused,
    ];

    const fn of(result: &Result<Completion, Failure>) -> Self {
        match result {
            Ok(Completion::Reached { .. } | Completion::Done) => Self::Reached,
            Ok(Completion::Passed { .. }) => Self::Passed,
            Ok(Completion::Homed { .. }) => Self::Homed,
            Ok(Completion::Stopped { .. })
            | Err(
                Failure::Halted { .. }
                | Failure::QuickStopped { .. }
                | Failure::Disabled { .. }
                | Failure::HomingHalted
                | Failure::LivenessExpired
                | Failure::NotHeld,
            ) => Self::Stopped,
            Err(Failure::Superseded | Failure::PerhapsSuperseded { .. }) => Self::Superseded,
            Err(Failure::Fault { .. }) => Self::Fault,
            Err(
                Failure::BusLost { .. }
                | Failure::LeftOp { .. }
                | Failure::Undelivered { .. }
                | Failure::ClockJumped,
            ) => Self::Lost,
            Err(Failure::MissedTarget { .. } | Failure::NotBegun { .. }) => Self::Missed,
            Err(
                Failure::Unseen { .. } | Failure::EndNotKnown { .. } | Failure::Unconfirmed { .. },
            ) => Self::Unknown,
            Err(
                Failure::Timeout { .. }
                | Failure::HomingError { .. }
                | Failure::HaltIgnored
                | Failure::HaltCoasts
                | Failure::QuickStopIgnored,
            ) => Self::Failed,
            Err(_) => Self::Refused,
        }
    }
}

impl fmt::Display for MotionEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Reached => "reached",
            Self::Passed => "passed",
            Self::Homed => "homed",
            Self::Superseded => "superseded",
            Self::Stopped => "stopped",
            Self::Fault => "fault",
            Self::Lost => "lost",
            Self::Missed => "missed",
            Self::Unknown => "unknown",
            Self::Failed => "failed",
            Self::Refused => "refused",
        })
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

/// The same as it is being counted, on the bus thread.
#[derive(Debug, Default)]
pub(super) struct AxisCounts {
    motions: [AtomicU64; MotionEnd::ALL.len()],
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
        let ends = MotionEnd::ALL.into_iter().zip(&self.motions);
        let counted = ends.map(|(end, count)| (end, count.load(Ordering::Relaxed)));
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
    fn every_end_has_a_place_of_its_own() {
        for (place, end) in MotionEnd::ALL.into_iter().enumerate() {
            assert_eq!(end as usize, place, "{end}");
        }
    }
}
