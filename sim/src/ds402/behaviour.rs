//! What one drive does differently from another, as data.

use core::time::Duration;

use super::machine::Machine;
use super::objects::Entry;
use super::plant::Plant;

/// When bit 12 (set-point acknowledge) of the statusword rises and falls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AckPolicy {
    /// Rises with a set-point that was taken, falls with bit 4, whatever the buffer holds (AKD2G).
    FollowsBit4,
    /// Rises with a set-point that was taken, falls when bit 4 is low and the buffer has room (drive with 2010h).
    BufferFree,
    /// As `FollowsBit4`, but already high when operation is enabled, until bit 4 was pulsed once (a drive that users
    /// of canopen-python reported).
    StickyAtEnable,
}

/// What bit 5 of the controlword does at a rising bit 4.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bit5 {
    /// 1 replaces the active set-point at once (CiA 402 v3, AKD2G).
    Replaces,
    /// 1 passes the active target without stopping, then goes on; nothing replaces; only with 6086h = 0 (AX2000).
    Blends,
    /// It is ignored, and bit 9 too: each set-point replaces the active one at once.
    Ignored,
}

/// What happens to a set-point with bit 5 = 0 that comes while another one runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhileMoving {
    /// It waits in the buffer (CiA 402 v3, AKD2G).
    Queues,
    /// It is taken and acknowledged when the axis has arrived, if bit 4 is still high then; else it is lost (AX2000).
    TakenAfterArrival,
}

/// What happens to a rise of bit 4 while bit 8 is high.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhileHalted {
    /// The set-point is taken and acknowledged, and begins when bit 8 falls.
    Takes,
    /// Nothing: it takes another rise after the halt.
    Ignores,
    /// The set-point is taken when bit 8 falls, if bit 4 is still high then.
    TakesAtRelease,
}

/// What happens to a set-point with bit 5 = 0 that finds the buffer full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FullBuffer {
    /// It is not taken.
    Ignore,
    /// It takes the place of the last one that waits.
    OverwritePending,
}

/// Where a relative set-point starts to count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RelativeBase {
    /// As bits 0 and 1 of 60F2h say at the edge.
    PositioningOption,
    /// The target before it, reached or not; for a queued one the end of the queue.
    PreviousTarget,
    /// The demand position at the moment it starts.
    Demand,
    /// The actual position at the moment it starts.
    Actual,
}

/// When bit 10 (target reached) of the statusword is set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReachedPolicy {
    /// When the last trajectory has ended.
    TrajectoryEnd,
    /// When the last trajectory has ended and the actual position was within 6067h for 6068h.
    WindowAfterEnd,
    /// When the actual position was within 6067h of the last target for 6068h, even if the axis still moves.
    Window,
}

/// When the software position limits (607Dh) are not in force.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LimitsOff {
    /// When both are 0 (AKD).
    BothZero,
    /// When the minimum is not below the maximum (Yaskawa).
    MinNotBelowMax,
}

/// What becomes of a target outside the software position limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LimitViolation {
    /// The axis moves to the limit; bit 11 of the statusword is set.
    Clamp,
    /// The set-point is not taken and not acknowledged; bit 11 of the statusword is set.
    Refuse,
    /// As `Refuse`, with fault 8612h.
    Fault,
}

/// What a following error beyond 6065h for 6066h does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FollowingError {
    /// Fault 8611h, with bit 13 of the statusword (AKD2G: F6001).
    Fault,
    /// Bit 13 of the statusword, nothing else.
    BitOnly,
}

/// What 0 in 6060h does to the active mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ModeZero {
    /// The active mode stays.
    Keeps,
    /// No mode is active (6061h = 0).
    Clears,
}

/// What the home position reads after homing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HomeOffset {
    /// The home offset (607Ch): the home position gets the coordinate that 607Ch says.
    HomeReadsOffset,
    /// The home offset (607Ch) with the other sign: position 0 lies by 607Ch beyond the home position.
    ZeroBeyondHome,
}

/// What a scale factor (608Fh to 6097h) that is written changes. The AKD2G's page says that factors "affect the values of the motion
/// setpoint objects and should be set prior to" these, which can be read both ways.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FactorChange {
    /// What the numbers in other objects mean.
    Meaning,
    /// The numbers: positions, velocities and accelerations are kept in the drive's own units, and read and written through the factors. A
    /// value at an end of its object's range stays there: it bounds nothing.
    Numbers,
}

/// What a limit switch does outside of homing when the axis runs into it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LimitSwitches {
    /// It is shown in 60FDh, nothing else.
    Shown,
    /// The axis stops by the quick stop ramp (6085h) and stays in Operation enabled; what moved it is discarded; further
    /// motion in this direction is not begun; bit 11 of the statusword is set while the switch is active.
    Stop,
}

/// The homing methods (6098h) that [`Behaviour::generic`] knows: 1 to 14 by switch and index pulse, 17 to 30 by switch
/// alone, 33 and 34 by index pulse alone, 35 and 37 where the axis stands.
pub const HOMING_METHODS: [i8; 32] = [
    1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28,
    29, 30, 33, 34, 35, 37,
];

/// Everything in which drives differ. Start from a preset and change fields.
///
/// ```
/// use servocrab_sim::ds402::{AckPolicy, Axis, Behaviour};
///
/// let axis = Axis::new(Behaviour { ack: AckPolicy::BufferFree, ..Behaviour::akd2g() });
/// assert_eq!(axis.position(), 0);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Behaviour {
    /// Time from one drive cycle to the next.
    pub period: Duration,
    /// Cycles in Not ready to switch on after power-up.
    pub start_up_cycles: u32,
    /// Cycles that the power section takes in Switched on before operation can be enabled.
    pub power_on_cycles: u32,
    /// Cycles from a new value in 6060h to 6061h.
    pub mode_change_cycles: u32,
    /// Controlword 000Fh in Ready to switch on runs transitions 3 and 4.
    pub auto_3_4: bool,
    /// Transition 16: enable operation leads from Quick stop active back to Operation enabled (605Ah 5–8).
    pub transition_16: bool,
    /// Bit 7 of the controlword is irrelevant for all commands but fault reset; else a set bit 7 masks them.
    pub bit_7_irrelevant: bool,
    /// Ready to switch on is refused without voltage; else only Switched on is.
    pub ready_needs_voltage: bool,
    /// Bit 5 of the statusword is 1 in the states that leave it undefined.
    pub open_bit_5: bool,
    /// Manufacturer bits that the statusword always carries; only bits 8, 14 and 15 are used.
    pub manufacturer_bits: u16,
    /// Bit 12 of the statusword.
    pub ack: AckPolicy,
    /// Bit 5 of the controlword.
    pub bit_5: Bit5,
    /// Bit 9 of the controlword (blend) is understood; else it is ignored.
    pub bit_9: bool,
    /// Bits 5, 6 and 9 are those of the last word with bit 4 low, not those of the word with the rising bit 4.
    pub start_bits_before_edge: bool,
    /// A set-point with bit 5 = 0 while another one runs.
    pub while_moving: WhileMoving,
    /// Set-points that can wait behind the active one.
    pub waiting_set_points: usize,
    /// A set-point on a full buffer.
    pub full_buffer: FullBuffer,
    /// The base of relative set-points.
    pub relative_base: RelativeBase,
    /// Bit 10 of the statusword.
    pub reached: ReachedPolicy,
    /// A change of 6081h changes the velocity of the active set-point; else each has the one that it was taken with.
    pub velocity_at_once: bool,
    /// Halt keeps the set-points and continues them when bit 8 falls; else it discards them.
    pub halt_keeps: bool,
    /// What it does with a set-point that comes during a halt.
    pub while_halted: WhileHalted,
    /// A bit 4 that is already high when profile position mode becomes active starts a move (Nanotec).
    pub edge_at_mode_change: bool,
    /// A mode change is refused while bit 8 is set.
    pub halt_blocks_mode_change: bool,
    /// A mode change waits until the axis stands; else a moving axis is stopped by 6084h when the mode changes.
    pub motion_blocks_mode_change: bool,
    /// A mode change waits until the axis leaves Operation enabled (DSP 402 lets a drive restrict it so).
    pub operation_blocks_mode_change: bool,
    /// 0 in 6060h.
    pub mode_zero: ModeZero,
    /// Cycles that bit 4 must stay high before a set-point is taken; 0 takes it in the cycle of the edge.
    pub bit_4_filter_cycles: u32,
    /// When 607Dh is not in force.
    pub limits_off: LimitsOff,
    /// 607Dh is in force only when the axis is referenced (Yaskawa).
    pub limits_need_reference: bool,
    /// A target outside 607Dh.
    pub limit_violation: LimitViolation,
    /// A following error that is too large for too long.
    pub following_error: FollowingError,
    /// Cycles by which the demand reaches the plant late.
    pub actual_lag_cycles: u32,
    /// Counts/s² by which an axis without power slows down.
    pub coast_deceleration: u32,
    /// Counts/s² of a stop at the current or voltage limit.
    pub limit_deceleration: u32,
    /// 6502h. Modes 1, 3 and 6 are modelled; in another one the axis stands.
    pub supported_modes: u32,
    /// Values of 6098h by which this drive can home. At most those of [`HOMING_METHODS`] work.
    pub homing_methods: &'static [i8],
    /// 6098h takes none but [`Behaviour::homing_methods`]; else a start with another one ends in a homing error.
    pub homing_method_refused_at_write: bool,
    /// What the home position reads after homing.
    pub home_offset: HomeOffset,
    /// A scale factor that is written.
    pub factor_change: FactorChange,
    /// Limit switches outside of homing.
    pub limit_switches: LimitSwitches,
    /// How the shaft follows the demand, and what the drive measures of it.
    pub plant: Plant,
    /// What is fixed to the machine: switches, index pulse, ends of travel.
    pub machine: Machine,
    /// Values that 6086h takes: 0 linear, 1 sin²; the ramps are linear with any other.
    pub profile_types: &'static [i16],
    /// Indices of the general list that this drive does not have.
    pub without: &'static [u16],
    /// Entries that this drive adds to the general list, or has in another form.
    pub own_objects: &'static [Entry],
    /// 607Bh at power-up. Within a range that is not all of its type, positions wrap: a modulo axis.
    pub position_range: (i32, i32),
    /// An end velocity (6082h) that no further set-point takes up is kept; otherwise the axis stops beyond its target.
    pub goes_on_at_end_velocity: bool,
    /// 605Ah at power-up.
    pub quick_stop_option: i16,
    /// 6007h at power-up.
    pub abort_connection_option: i16,
}

impl Behaviour {
    /// The same drive with another plant.
    ///
    /// ```
    /// use servocrab_sim::ds402::{Axis, Behaviour, Plant};
    ///
    /// let axis = Axis::new(Behaviour::akd2g().with_plant(Plant::ideal()));
    /// assert_eq!(axis.plant(), &Plant::ideal());
    /// ```
    #[must_use]
    pub fn with_plant(mut self, plant: Plant) -> Behaviour {
        self.plant = plant;
        self
    }
}
