//! The record of every set-point that the drive took, by which tests judge a master.

use core::time::Duration;

/// One set-point that the drive latched, and what became of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Executed {
    /// Cycle in which the rising edge of bit 4 was taken.
    pub latched_at: Duration,
    /// Cycle in which its trajectory began; none while it waits.
    pub started_at: Option<Duration>,
    /// Demand position when its trajectory began, in counts.
    pub start_position: Option<i64>,
    /// Cycle in which its outcome was final.
    pub ended_at: Option<Duration>,
    /// Demand position at that moment, in counts; the target itself where it was reached or passed.
    pub end_position: Option<i64>,
    /// Bit 6 at the edge: the value is a distance.
    pub relative: bool,
    /// Bit 5 at the edge.
    pub bit_5: bool,
    /// Bit 9 at the edge.
    pub bit_9: bool,
    /// 607Ah at the edge, in counts.
    pub value: i32,
    /// Where it leads, in counts, after base and limits; none while the base of a waiting relative one is unknown.
    pub target: Option<i64>,
    /// 6081h at the edge, in counts/s.
    pub velocity: u32,
    /// 6082h at the edge, in counts/s.
    pub end_velocity: u32,
    /// 6083h at the edge, in counts/s².
    pub acceleration: u32,
    /// 6084h at the edge, in counts/s².
    pub deceleration: u32,
    /// 6086h at the edge.
    pub profile_type: i16,
    /// What became of it.
    pub outcome: Outcome,
}

/// What became of a set-point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Waits behind another one, or for the end of a halt.
    Queued,
    /// Being executed, or paused by a halt.
    Active,
    /// Its trajectory ended at its target, standing.
    Reached,
    /// Its target was passed in motion, for a blend or with an end velocity.
    Passed,
    /// Another set-point took its place.
    Replaced,
    /// The drive dropped it.
    Discarded(Cause),
}

/// Why the drive dropped a set-point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// Quick stop, by command or by a lost connection.
    QuickStop,
    /// Shutdown, disable operation, disable voltage or the enable input.
    Disabled,
    /// A fault.
    Fault,
    /// The mode of operation changed.
    ModeChange,
    /// A halt, on a drive that keeps nothing over it.
    Halt,
}
