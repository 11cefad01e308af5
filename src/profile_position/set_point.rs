//! What one move asks of a drive, what drives differ in, and the limits that they hold.

use core::{
    hash::{Hash, Hasher},
    time::Duration,
};

use crate::{
    coe::{ObjectAddress, obj},
    units::{AxisUnit, Counts, Quantity, Scale, ScaleError},
};

use super::{
    Failure,
    circle::{Circle, Turn},
};

/// When a move starts, seen from the move that is under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum BufferMode {
    /// Now: the active move is replaced and queued ones are dropped (PLCopen Aborting).
    #[default]
    Aborting,
    /// After the active move has stopped at its target (PLCopen Buffered).
    Buffered,
    /// At the active move's target, without stopping there (PLCopen BlendingPrevious).
    Blending,
}

/// Whether 607Ah is a position or a distance: bit 6 of the controlword.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Reference {
    /// A position.
    Absolute,
    /// A distance from the base that the drive documents (60F2h).
    Relative,
}

/// The parameters of a move and when it starts, in the unit of the axis: `u32` for [`Counts`], `f64` for others. What is left out is what the
/// drive holds.
///
/// ```
/// use servocrab::{profile_position::{SetPoint, BufferMode}, units::Mm};
/// let gentle: SetPoint = SetPoint::new().velocity(5_000).acceleration(20_000).buffer_mode(BufferMode::Buffered);
/// assert_eq!(gentle.buffer_mode, BufferMode::Buffered);
/// /// 40 mm/s.
/// const SLOW: SetPoint<Mm> = SetPoint::new().velocity(40.0);
/// assert_eq!(SLOW.parameters.velocity, Some(40.0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetPoint<U: AxisUnit = Counts> {
    /// When the move starts, as PLCopen's `BufferMode` has it.
    pub buffer_mode: BufferMode,
    /// Velocity, ramps and profile.
    pub parameters: Parameters<U>,
}

/// Velocity, ramps and profile type of a move, in the unit of the axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Parameters<U: AxisUnit = Counts> {
    /// Profile velocity 6081h; more than 0.
    pub velocity: Option<U::Magnitude>,
    /// Profile acceleration 6083h; more than 0.
    pub acceleration: Option<U::Magnitude>,
    /// Profile deceleration 6084h; more than 0.
    pub deceleration: Option<U::Magnitude>,
    /// End velocity 6082h: the speed at the target.
    pub end_velocity: Option<U::Magnitude>,
    /// Motion profile type 6086h.
    pub profile_type: Option<i16>,
}

impl<U: AxisUnit> SetPoint<U> {
    /// Starts immediately, with the parameters that the drive holds.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer_mode: BufferMode::Aborting,
            parameters: Parameters::new(),
        }
    }

    /// With this profile velocity (6081h).
    #[must_use]
    pub const fn velocity(mut self, velocity: U::Magnitude) -> Self {
        self.parameters.velocity = Some(velocity);
        self
    }

    /// With this profile acceleration (6083h).
    #[must_use]
    pub const fn acceleration(mut self, acceleration: U::Magnitude) -> Self {
        self.parameters.acceleration = Some(acceleration);
        self
    }

    /// With this profile deceleration (6084h).
    #[must_use]
    pub const fn deceleration(mut self, deceleration: U::Magnitude) -> Self {
        self.parameters.deceleration = Some(deceleration);
        self
    }

    /// With this end velocity (6082h).
    #[must_use]
    pub const fn end_velocity(mut self, end_velocity: U::Magnitude) -> Self {
        self.parameters.end_velocity = Some(end_velocity);
        self
    }

    /// With this motion profile type (6086h): 0 linear ramps, 1 sin² ramps.
    #[must_use]
    pub const fn profile_type(mut self, profile_type: i16) -> Self {
        self.parameters.profile_type = Some(profile_type);
        self
    }

    /// With this buffer mode.
    #[must_use]
    pub const fn buffer_mode(mut self, buffer_mode: BufferMode) -> Self {
        self.buffer_mode = buffer_mode;
        self
    }
}

impl<U: AxisUnit> Default for SetPoint<U> {
    fn default() -> Self {
        Self::new()
    }
}

impl Eq for SetPoint {}

impl Hash for SetPoint {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self {
            buffer_mode,
            parameters,
        } = self;
        (buffer_mode, parameters).hash(state);
    }
}

impl<U: AxisUnit> Parameters<U> {
    const fn new() -> Self {
        Self {
            velocity: None,
            acceleration: None,
            deceleration: None,
            end_velocity: None,
            profile_type: None,
        }
    }

    fn in_counts(&self, scale: &Scale) -> Result<Parameters, ScaleError> {
        Ok(Parameters {
            velocity: scale.speed(Quantity::Velocity, self.velocity)?,
            end_velocity: scale.speed(Quantity::EndVelocity, self.end_velocity)?,
            acceleration: scale.ramp(Quantity::Acceleration, self.acceleration)?,
            deceleration: scale.ramp(Quantity::Deceleration, self.deceleration)?,
            profile_type: self.profile_type,
        })
    }
}

impl<U: AxisUnit> Default for Parameters<U> {
    fn default() -> Self {
        Self::new()
    }
}

/// One move: a set-point with its target. The axis core takes those in counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoveCommand<U: AxisUnit = Counts> {
    /// Position or distance.
    pub reference: Reference,
    /// Target position 607Ah: a position or a distance.
    pub target: U::Signed,
    /// Parameters and start.
    pub set_point: SetPoint<U>,
    /// Held until fired: the bit 4 of several axes shall rise in one cycle.
    pub gated: bool,
}

impl Eq for MoveCommand {}

impl Hash for MoveCommand {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self {
            reference,
            target,
            set_point,
            gated,
        } = self;
        (reference, target, set_point, gated).hash(state);
    }
}

impl<U: AxisUnit> MoveCommand<U> {
    /// The same in the drive's units.
    ///
    /// # Errors
    /// The first of its numbers that cannot be converted, with its object.
    pub fn in_counts(&self, scale: &Scale) -> Result<MoveCommand, ScaleError> {
        Ok(MoveCommand {
            reference: self.reference,
            target: scale.position(self.target.into())?,
            set_point: SetPoint {
                buffer_mode: self.set_point.buffer_mode,
                parameters: self.set_point.parameters.in_counts(scale)?,
            },
            gated: self.gated,
        })
    }
}

// How a drive's Profile Position mode differs from other drives', as data.

/// Motion profile type 6086h of linear ramps.
const LINEAR: i16 = 0;

/// The bits that one kind of start takes, or why the drive has no such start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum StartBits {
    /// By the drive's buffer, with these bits. No others of the controlword can be asked for.
    Bits {
        /// Bit 5, change set immediately.
        change_set_immediately: bool,
        /// Bit 9, change on set-point.
        change_on_set_point: bool,
    },
    /// Not by the drive's buffer: sequenced by this library after the active move's arrival.
    Sequenced,
    /// The drive cannot do it, for this reason.
    Unsupported(&'static str),
}

/// Whether bit 12 shows that the drive's set-point buffer is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum BufferSignal {
    /// Bit 12 stays 1 while no set-point can be taken, and falls when the active one ends.
    Acknowledge,
    /// Bit 12 follows bit 4 and shows nothing of the buffer. This library counts set-points. A bit 12 that is still high belongs to
    /// the handshake before.
    None,
    /// The drive's documents do not say. This library counts set-points. A bit 12 that stays high while two are held may be that of
    /// a full buffer.
    Unknown,
}

/// What a relative move counts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum RelativeBase {
    /// The previous target.
    PreviousTarget,
    /// The position demand value, which at rest is the previous target.
    Demand,
    /// The position actual value.
    Actual,
    /// What the drive's positioning option code 60F2h says, which a `Network` reads when the axis attaches; until it is
    /// known as `Undocumented`.
    PositioningOption,
    /// The drive's documents do not say; relative moves are not checked against the position.
    Undocumented,
}

impl RelativeBase {
    /// What positioning option code 60F2h says in its bits 0 and 1.
    ///
    /// ```
    /// use servocrab::profile_position::RelativeBase;
    /// assert_eq!(RelativeBase::of_positioning_option(0x0001), RelativeBase::Demand);
    /// ```
    #[must_use]
    pub const fn of_positioning_option(code: u16) -> Self {
        match code & 0b11 {
            0b00 => Self::PreviousTarget,
            0b01 => Self::Demand,
            0b10 => Self::Actual,
            _ => Self::Undocumented,
        }
    }
}

/// Where a drive shows whether an axis has been homed and has kept its position since: bits of a 32-bit object.
///
/// ```
/// use servocrab::drives;
/// let shown = drives::akd2g().traits.homed.ok_or("it shows nothing")?;
/// assert!(shown.is_homed(0b0_0110)); // home position found, homing done
/// assert!(!shown.is_homed(0b1_0110)); // and a homing error since
/// # Ok::<(), &str>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HomedSignal {
    /// The object of axis 1.
    pub object: ObjectAddress,
    /// All of these bits are 1 of an axis that is homed.
    pub set: u32,
    /// All of these bits are 0 of an axis that is homed.
    pub clear: u32,
}

impl HomedSignal {
    /// Whether the object's value says that the axis is homed.
    #[must_use]
    pub const fn is_homed(&self, value: u32) -> bool {
        self.set != 0 && value & self.set == self.set && value & self.clear == 0
    }
}

/// How a drive's Profile Position mode behaves.
///
/// ```
/// use servocrab::profile_position::{BufferSignal, StartBits, BufferMode, Traits};
/// let traits = Traits::cia402();
/// assert!(matches!(traits.bits(BufferMode::Blending), StartBits::Bits { .. }));
/// assert_eq!(traits.buffer_signal, BufferSignal::Unknown);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Traits {
    /// Bits of [`BufferMode::Aborting`].
    pub immediately: StartBits,
    /// Bits of [`BufferMode::Buffered`].
    pub after_current: StartBits,
    /// Bits of [`BufferMode::Blending`].
    pub blend: StartBits,
    /// Whether bits 5, 6 and 9 go out before bit 4 rises, until the drive has surely seen them: for a drive that takes them from the
    /// word before. Else they go out with bit 4, as CiA 402 has it, and a move on an axis that is ready rises in the next frame.
    /// With it a move whose bits 5, 6 and 9 are not all 0 rises two of the drive's cycles later, unless it waits for its turn that long.
    pub start_bits_first: bool,
    /// What bit 12 shows of the buffer.
    pub buffer_signal: BufferSignal,
    /// What relative moves count from.
    pub relative_base: RelativeBase,
    /// Whether a halted set-point is kept and continued when bit 8 falls.
    pub halt_keeps_set_point: bool,
    /// The drive's own cycle: bit 4 must stay low for two of them where nothing shows that the drive has seen it low. With distributed
    /// clocks a `Network` takes SYNC0's cycle where that is longer.
    pub drive_cycle: Duration,
    /// Whether bit 4 of the statusword shows that the power stage has its supply.
    pub shows_voltage: bool,
    /// Where the drive shows that an axis is homed; none where its documents do not say. A `Network` reads it when the axis attaches
    /// ([`CoreConfig::homed`](crate::axis::CoreConfig::homed)).
    pub homed: Option<HomedSignal>,
    /// The motion profile types 6086h that the drive has; empty where its documents do not say: then all are sent.
    pub profile_types: &'static [i16],
    /// Whether a target is passed without stopping only with linear ramps (6086h = 0), on both sides of it.
    pub blend_needs_linear_ramps: bool,
    /// How it counts its software position limits 607Dh.
    pub limits: LimitsRule,
    /// Whether the drive's documents give the velocity threshold 606Fh in the unit of 606Ch. Then a `Network` reads it as
    /// [`Tolerances::velocity`](crate::axis::Tolerances::velocity) when the axis attaches.
    pub threshold_in_velocity_units: bool,
}

impl Traits {
    /// A drive after CiA 402 version 3, of whose bit 12 it is not known whether it shows a full buffer.
    #[must_use]
    pub const fn cia402() -> Self {
        Self {
            immediately: StartBits::Bits {
                change_set_immediately: true,
                change_on_set_point: false,
            },
            after_current: StartBits::Bits {
                change_set_immediately: false,
                change_on_set_point: false,
            },
            blend: StartBits::Bits {
                change_set_immediately: false,
                change_on_set_point: true,
            },
            start_bits_first: false,
            buffer_signal: BufferSignal::Unknown,
            relative_base: RelativeBase::Undocumented,
            halt_keeps_set_point: true,
            drive_cycle: Duration::from_millis(1),
            shows_voltage: false,
            homed: None,
            profile_types: &[],
            blend_needs_linear_ramps: false,
            limits: LimitsRule::cia402(),
            threshold_in_velocity_units: false,
        }
    }

    /// The time after which the drive has surely seen a delivered word: two of its own cycles.
    #[must_use]
    pub const fn surely_seen(&self) -> Duration {
        self.drive_cycle.saturating_mul(2)
    }

    /// The bits that a kind of start takes on this drive.
    #[must_use]
    pub const fn bits(&self, buffer_mode: BufferMode) -> StartBits {
        match buffer_mode {
            BufferMode::Aborting => self.immediately,
            BufferMode::Buffered => self.after_current,
            BufferMode::Blending => self.blend,
        }
    }

    /// Whether a move that is started this way needs linear ramps, its own and those of the move before.
    pub(crate) fn needs_linear_ramps(&self, buffer_mode: BufferMode) -> bool {
        buffer_mode == BufferMode::Blending && self.blend_needs_linear_ramps
    }

    /// Whether the drive can start a move with this profile type, this way, after a set-point with that type.
    ///
    /// # Errors
    /// [`Failure::ProfileType`].
    pub(crate) fn check_profile_type(
        &self,
        buffer_mode: BufferMode,
        profile_type: Option<i16>,
        before: Option<i16>,
    ) -> Result<(), Failure> {
        let refuse = |profile_type, reason| {
            Err(Failure::ProfileType {
                profile_type,
                reason,
            })
        };
        if let Some(asked) = profile_type
            && !self.profile_types.is_empty()
            && !self.profile_types.contains(&asked)
        {
            return refuse(asked, "the drive has no such profile type");
        }
        if self.needs_linear_ramps(buffer_mode) {
            if let Some(asked) = profile_type.filter(|&asked| asked != LINEAR) {
                return refuse(asked, "this drive passes a target only with linear ramps");
            }
            if let Some(before) = before.filter(|&before| before != LINEAR) {
                return refuse(
                    before,
                    "this drive passes a target only with linear ramps, and the move before has others",
                );
            }
        }
        Ok(())
    }
}

// Limits that a drive holds, checked before a move is sent. How the drive counts them is its data: `LimitsRule`.

/// Positions from `min` to `max`, both included, in the drive's position units.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PositionRange {
    /// The least.
    pub min: i32,
    /// The greatest.
    pub max: i32,
}

impl PositionRange {
    /// How many positions it has; none where it is empty or only one.
    #[must_use]
    pub const fn length(&self) -> Option<u32> {
        // The whole range of `i32` is one more than `u32` holds; as a turn it is the number circle itself.
        if self.min < self.max {
            (self.max.wrapping_sub(self.min) as u32).checked_add(1)
        } else {
            None
        }
    }

    /// The position of this range at which an axis stands that has gone to `position` turn after turn.
    ///
    /// ```
    /// use servocrab::profile_position::PositionRange;
    /// let turn = PositionRange { min: 0, max: 3_599 };
    /// assert_eq!(turn.wrap(3_600), 0);
    /// assert_eq!(turn.wrap(-10), 3_590);
    /// ```
    #[must_use]
    pub fn wrap(&self, position: i64) -> i32 {
        // On the circle, and there is no turn where both ends are one: it fits.
        Circle::<32>::wrap(self.turn(), position) as i32
    }

    pub(crate) const fn turn(&self) -> Turn {
        Turn {
            min: self.min as i64,
            max: self.max as i64,
        }
    }
}

/// When the software position limits 607Dh are switched off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LimitsOff {
    /// When the minimum is not below the maximum.
    MinNotBelowMax,
    /// When both are 0. Of a minimum above the maximum nothing is known: it is not checked.
    BothZero,
}

/// When the software position limits 607Dh are in force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LimitsActive {
    /// Always.
    Always,
    /// While the axis is referenced: after homing, or with an absolute encoder.
    WhenReferenced,
}

/// How a drive counts its software position limits 607Dh, as data.
///
/// ```
/// use servocrab::profile_position::{LimitsActive, LimitsOff, LimitsRule, Traits};
/// let rule = LimitsRule { active: LimitsActive::WhenReferenced, ..LimitsRule::cia402() };
/// let traits = Traits { limits: rule, ..Traits::cia402() };
/// assert_eq!(traits.limits.off, LimitsOff::MinNotBelowMax);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct LimitsRule {
    /// When they are off.
    pub off: LimitsOff,
    /// Whether targets are compared with the limits less the home offset 607Ch; else with the limits as they are.
    pub less_home_offset: bool,
    /// When they are in force.
    pub active: LimitsActive,
}

impl LimitsRule {
    /// As CiA DSP 402 has it in 607Dh: less the home offset, and always in force. Limits that are no range are off.
    #[must_use]
    pub const fn cia402() -> Self {
        Self {
            off: LimitsOff::MinNotBelowMax,
            less_home_offset: true,
            active: LimitsActive::Always,
        }
    }
}

/// What an axis' drive holds in its limit objects, or what the program says in their place. Absolute targets and velocities
/// beyond it are refused before anything is written. The end of a relative move is checked when its turn comes, and only where it is known
/// what the drive counts from: parameters that go by SDO are written by then. What is `None` is not checked.
///
/// A [`Network`](crate::bus::Network) reads them when an axis attaches. A program that changes 607Bh, 607Ch, 607Dh or 607Fh later
/// has them read again: `Axis::read_limits`.
///
/// ```
/// use servocrab::{bus::{AxisConfig, DriveConfig}, drives, profile_position::{Limits, PositionRange}};
/// let limits = Limits { software: Some(PositionRange { min: -200_000, max: 1_000_000 }), ..Limits::trust_drive() };
/// let drive = DriveConfig::new(drives::akd2g())
///     .axis("x") // what the drive holds
///     .axis(AxisConfig::new("y").limits(limits)); // what the program says
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Software position limits 607Dh, as the drive holds them.
    pub software: Option<PositionRange>,
    /// Home offset 607Ch; 0 where the drive has none.
    pub home_offset: i32,
    /// Position range limits 607Bh, beyond which positions wrap. Off where the minimum is not below the maximum.
    pub position_range: Option<PositionRange>,
    /// Max profile velocity 607Fh, velocity units. 0 is no limit.
    pub max_velocity: Option<u32>,
}

impl Limits {
    /// Nothing is checked here: the drive alone applies its limits. A move that a drive ends early without a sign is reported as
    /// [`Failure::MissedTarget`] all the same.
    #[must_use]
    pub const fn trust_drive() -> Self {
        Self {
            software: None,
            home_offset: 0,
            position_range: None,
            max_velocity: None,
        }
    }

    /// The positions that 607Dh allows, by the drive's rule; none where it is not in force.
    #[must_use]
    pub fn allowed(&self, rule: &LimitsRule, referenced: bool) -> Option<(i64, i64)> {
        let PositionRange { min, max } = self.software?;
        let off = match rule.off {
            LimitsOff::MinNotBelowMax => min >= max,
            LimitsOff::BothZero => (min == 0 && max == 0) || min > max,
        };
        let waits = rule.active == LimitsActive::WhenReferenced && !referenced;
        let correction = if rule.less_home_offset {
            i64::from(self.home_offset)
        } else {
            0
        };
        (!off && !waits).then_some((i64::from(min) - correction, i64::from(max) - correction))
    }

    /// Refuses a target position beyond a limit.
    pub(crate) fn check_target(
        &self,
        target: i64,
        rule: &LimitsRule,
        referenced: bool,
    ) -> Result<(), Failure> {
        let beyond = |index, min: i64, max: i64| {
            let (subindex, limit) = if target < min {
                (1, min)
            } else if target > max {
                (2, max)
            } else {
                return Ok(());
            };
            Err(Failure::BeyondLimit {
                object: ObjectAddress::new(index, subindex),
                limit,
                target,
            })
        };
        if let Some(PositionRange { min, max }) = self.position_range
            && min < max
        {
            beyond(obj::POSITION_RANGE_MIN.index(), min.into(), max.into())?;
        }
        match self.allowed(rule, referenced) {
            Some((min, max)) => beyond(obj::SOFTWARE_LIMIT_MIN.index(), min, max),
            None => Ok(()),
        }
    }

    /// Refuses a profile velocity or end velocity above the limit.
    pub(crate) fn check_velocity(&self, velocity: Option<u32>) -> Result<(), Failure> {
        match (velocity, self.max_velocity) {
            (Some(velocity), Some(limit)) if limit != 0 && velocity > limit => {
                Err(Failure::TooFast { limit, velocity })
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{Mm, Ratio};

    /// A move to 0 mm, at 1000 counts a millimetre, 10 a mm/s, and a quarter a mm/s².
    fn converted(set_point: SetPoint<Mm>) -> Result<SetPoint, ScaleError> {
        let scale = Scale::counts_per_unit(Ratio::new(1000, 1)?)
            .velocity_counts_per_unit(Ratio::new(10, 1)?)
            .acceleration_counts_per_unit(Ratio::new(1, 4)?);
        let command = MoveCommand {
            reference: Reference::Absolute,
            target: 0.0,
            set_point,
            gated: false,
        };
        command.in_counts(&scale).map(|command| command.set_point)
    }

    #[cfg(feature = "std")]
    #[test]
    fn what_differs_has_another_hash() {
        use core::hash::BuildHasher;
        let state = std::hash::RandomState::new();
        let command = MoveCommand {
            reference: Reference::Absolute,
            target: 5,
            set_point: SetPoint::new(),
            gated: false,
        };
        let faster = SetPoint::new().velocity(7);
        assert_ne!(state.hash_one(command.set_point), state.hash_one(faster));
        let further = MoveCommand {
            target: 6,
            ..command
        };
        assert_ne!(state.hash_one(command), state.hash_one(further));
        assert_eq!(
            state.hash_one(command),
            state.hash_one(MoveCommand { ..command })
        );
    }

    #[test]
    fn each_parameter_has_the_factor_of_its_quantity() {
        let set_point = SetPoint::new()
            .velocity(1.25)
            .end_velocity(0.0)
            .acceleration(10.0)
            .deceleration(14.0)
            .profile_type(1)
            .buffer_mode(BufferMode::Blending);
        let expected = SetPoint::new()
            .velocity(13)
            .end_velocity(0)
            .acceleration(3)
            .deceleration(4)
            .profile_type(1)
            .buffer_mode(BufferMode::Blending);
        assert_eq!(converted(set_point), Ok(expected));
        assert_eq!(converted(SetPoint::new()), Ok(SetPoint::new()));
    }

    #[test]
    fn what_an_object_does_not_hold_is_refused_by_its_name() {
        let refused = |set_point| converted(set_point).unwrap_err();
        assert!(matches!(
            refused(SetPoint::new().velocity(-1.0)),
            ScaleError::OutOfRange {
                quantity: Quantity::Velocity,
                min: 0.0,
                ..
            }
        ));
        assert!(matches!(
            refused(SetPoint::new().acceleration(1e11)),
            ScaleError::OutOfRange {
                quantity: Quantity::Acceleration,
                ..
            }
        ));
        assert!(matches!(
            refused(SetPoint::new().deceleration(1.0)),
            ScaleError::RoundsToZero {
                quantity: Quantity::Deceleration,
                least: 4.0,
                ..
            }
        ));
        assert!(matches!(
            refused(SetPoint::new().end_velocity(f64::NAN)),
            ScaleError::NotFinite {
                quantity: Quantity::EndVelocity,
                ..
            }
        ));
    }
}

#[cfg(test)]
mod limits_tests {
    use super::*;

    const ALWAYS: LimitsRule = LimitsRule::cia402();

    #[test]
    fn a_turn_has_a_length_and_each_position_a_place_in_it() {
        let range = |min, max| PositionRange { min, max };
        for (min, max, length) in [
            (0, 3_599, Some(3_600)),
            (-1_800, 1_799, Some(3_600)),
            (5, 6, Some(2)),
            (5, 5, None),
            (6, 5, None),
            (i32::MIN, i32::MAX - 1, Some(u32::MAX)),
        ] {
            assert_eq!(range(min, max).length(), length, "{min} {max}");
        }
        for (position, place) in [(3_599, 3_599), (3_600, 0), (-10, 3_590), (7_205, 5)] {
            assert_eq!(range(0, 3_599).wrap(position), place);
        }
        assert_eq!(range(-1_800, 1_799).wrap(1_810), -1_790);
    }

    fn limits(min: i32, max: i32) -> Limits {
        Limits {
            software: Some(PositionRange { min, max }),
            ..Limits::trust_drive()
        }
    }

    #[test]
    fn the_home_offset_is_taken_off_both_limits_where_the_drive_does_so() {
        // Yaskawa's manual, 607Dh: the corrected limit is the limit minus 607Ch.
        let limits = Limits {
            home_offset: 300,
            ..limits(-1_000, 1_000)
        };
        assert_eq!(limits.allowed(&ALWAYS, true), Some((-1_300, 700)));
        assert_eq!(limits.check_target(700, &ALWAYS, true), Ok(()));
        assert_eq!(
            limits.check_target(701, &ALWAYS, true),
            Err(Failure::BeyondLimit {
                object: ObjectAddress::new(0x607D, 2),
                limit: 700,
                target: 701
            })
        );
        assert_eq!(limits.check_target(-1_300, &ALWAYS, true), Ok(()));
        assert!(limits.check_target(-1_301, &ALWAYS, true).is_err());
        let as_they_are = LimitsRule {
            less_home_offset: false,
            ..ALWAYS
        };
        assert_eq!(limits.allowed(&as_they_are, true), Some((-1_000, 1_000)));
    }

    #[test]
    fn limits_at_the_ends_of_the_type_are_corrected_without_overflow() {
        for home_offset in [i32::MIN, i32::MAX] {
            let limits = Limits {
                home_offset,
                ..limits(i32::MIN, i32::MAX)
            };
            let (min, max) = limits.allowed(&ALWAYS, true).unwrap();
            assert_eq!(min, i64::from(i32::MIN) - i64::from(home_offset));
            assert_eq!(max, i64::from(i32::MAX) - i64::from(home_offset));
        }
    }

    #[test]
    fn each_rule_switches_them_off_its_own_way() {
        let both_zero = LimitsRule {
            off: LimitsOff::BothZero,
            ..ALWAYS
        };
        for (min, max, by_order, by_zero) in [
            (0, 0, false, false),
            (5, 5, false, true),
            (6, 5, false, false),
            (0, 5, true, true),
            (-5, 0, true, true),
        ] {
            let limits = limits(min, max);
            assert_eq!(
                limits.allowed(&ALWAYS, true).is_some(),
                by_order,
                "{min} {max}"
            );
            assert_eq!(
                limits.allowed(&both_zero, true).is_some(),
                by_zero,
                "{min} {max}"
            );
        }
    }

    #[test]
    fn limits_that_need_a_reference_are_not_in_force_before() {
        let rule = LimitsRule {
            active: LimitsActive::WhenReferenced,
            ..ALWAYS
        };
        assert_eq!(limits(-5, 5).check_target(6, &rule, false), Ok(()));
        assert!(limits(-5, 5).check_target(6, &rule, true).is_err());
        assert!(limits(-5, 5).check_target(6, &ALWAYS, false).is_err());
    }

    #[test]
    fn a_position_range_and_a_velocity_are_limits_of_their_own() {
        let limits = Limits {
            position_range: Some(PositionRange { min: 0, max: 3_599 }),
            max_velocity: Some(100),
            ..Limits::trust_drive()
        };
        assert_eq!(limits.check_target(3_599, &ALWAYS, true), Ok(()));
        assert!(matches!(
            limits.check_target(3_600, &ALWAYS, true),
            Err(Failure::BeyondLimit { object, limit: 3_599, target: 3_600 }) if object.index == 0x607B
        ));
        let off = Limits {
            position_range: Some(PositionRange { min: 0, max: 0 }),
            max_velocity: Some(0),
            ..limits
        };
        assert_eq!(off.check_target(3_600, &ALWAYS, true), Ok(()));
        assert_eq!(off.check_velocity(Some(u32::MAX)), Ok(()));
        assert_eq!(limits.check_velocity(None), Ok(()));
        assert_eq!(limits.check_velocity(Some(100)), Ok(()));
        let too_fast = Failure::TooFast {
            limit: 100,
            velocity: 101,
        };
        assert_eq!(limits.check_velocity(Some(101)), Err(too_fast));
    }
}

#[cfg(test)]
mod traits_tests {
    use super::*;

    #[test]
    fn the_lowest_two_bits_of_60f2h_say_what_a_distance_counts_from() {
        use RelativeBase::{Actual, Demand, PreviousTarget, Undocumented};
        for high in [0, 0b100, 0xFFFC] {
            let bases = [0, 1, 2, 3].map(|low| RelativeBase::of_positioning_option(high | low));
            assert_eq!(bases, [PreviousTarget, Demand, Actual, Undocumented]);
        }
    }

    #[test]
    fn an_axis_is_homed_with_all_of_its_bits_high_and_all_others_low() {
        let shown = |set, clear| HomedSignal {
            object: ObjectAddress::new(0x1234, 0),
            set,
            clear,
        };
        let signal = shown(0b0110, 0b1000);
        for (value, homed) in [
            (0b0110, true),
            (0b0111, true),
            (0b0010, false),
            (0b0100, false),
            (0b0001, false),
            (0b1110, false),
            (0, false),
        ] {
            assert_eq!(signal.is_homed(value), homed, "{value:#06b}");
        }
        assert!(!shown(0, 0b1000).is_homed(0), "no bit says so");
    }

    #[test]
    fn a_profile_type_is_refused_that_the_drive_has_not_or_does_not_blend_with() {
        let traits = Traits {
            profile_types: &[0, 1],
            blend_needs_linear_ramps: true,
            ..Traits::cia402()
        };
        let check = |traits: &Traits, buffer_mode, asked, before| match traits.check_profile_type(
            buffer_mode,
            asked,
            before,
        ) {
            Ok(()) => None,
            Err(Failure::ProfileType { profile_type, .. }) => Some(profile_type),
            Err(other) => panic!("{other:?}"),
        };
        use BufferMode::{Blending, Buffered};
        assert_eq!(check(&traits, Buffered, Some(1), Some(1)), None);
        assert_eq!(check(&traits, Buffered, Some(2), None), Some(2));
        assert_eq!(check(&traits, Buffered, None, None), None);
        assert_eq!(check(&traits, Blending, Some(0), Some(0)), None);
        assert_eq!(check(&traits, Blending, Some(1), Some(0)), Some(1));
        assert_eq!(check(&traits, Blending, Some(0), Some(1)), Some(1));
        assert_eq!(check(&traits, Blending, None, Some(1)), Some(1));
        assert_eq!(check(&traits, Blending, None, None), None);
        let of_all = Traits {
            profile_types: &[],
            blend_needs_linear_ramps: false,
            ..traits
        };
        assert_eq!(check(&of_all, Buffered, Some(2), None), None);
        assert_eq!(check(&of_all, Blending, Some(1), Some(1)), None);
    }
}
