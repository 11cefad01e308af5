//! The record of everything that moved the axis: set-points, homings, velocities. By it tests judge a master.

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
    /// Where the shaft was at that moment, in counts.
    pub shaft_position: Option<i64>,
    /// How fast the shaft was at that moment, in counts/s.
    pub shaft_velocity: Option<f64>,
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

/// Why the drive dropped a set-point, a homing or a velocity.
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
    /// A limit switch, on a drive that stops there.
    LimitSwitch,
}

/// One homing that was started, and what became of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Homing {
    /// 6098h at the rising edge of bit 4.
    pub method: i8,
    /// Cycle of that edge.
    pub started_at: Duration,
    /// Demand position at the start, in counts.
    pub start_position: i64,
    /// Cycle in which its outcome was final. The axis may still slow down then.
    pub ended_at: Option<Duration>,
    /// The home position in counts from the machine's own zero, where it was found.
    pub home: Option<i64>,
    /// 607Ch when the home position was found, in counts.
    pub offset: Option<i32>,
    /// What became of it.
    pub outcome: HomingOutcome,
}

/// What became of a homing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HomingOutcome {
    /// Under way, or paused by a halt.
    Active,
    /// The home position was found.
    Attained,
    /// It failed; bit 13 of the statusword was set.
    Failed(HomingError),
    /// Bit 4 fell.
    Interrupted,
    /// The drive dropped it.
    Discarded(Cause),
}

/// Why a homing failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HomingError {
    /// The drive does not know the method in 6098h.
    Method,
    /// A speed (6099h) that the method needs, or the acceleration (609Ah), is 0.
    SpeedZero,
    /// A limit switch stood in the way where the method does not turn round.
    LimitSwitch,
    /// Both limit switches were found, the home switch was not.
    NoHomeSwitch,
}

/// One target velocity (60FFh) that profile velocity mode ran, and what ended it.
#[derive(Debug, Clone, PartialEq)]
pub struct VelocityPhase {
    /// Cycle from which on the axis was driven to this velocity.
    pub started_at: Duration,
    /// Demand position at that moment, in counts.
    pub start_position: i64,
    /// 60FFh, in counts/s; never 0, which ends a phase.
    pub target: i32,
    /// Cycle in which something else took over. The axis may still slow down then.
    pub ended_at: Option<Duration>,
    /// Demand position at that moment, in counts.
    pub end_position: Option<i64>,
    /// What ended it.
    pub end: VelocityEnd,
}

/// What ended a phase of profile velocity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VelocityEnd {
    /// Nothing yet.
    Active,
    /// Another value in 60FFh, 0 included.
    Changed,
    /// A halt; the velocity is taken up again as another phase when bit 8 falls.
    Halted,
    /// The drive dropped it.
    Discarded(Cause),
}
