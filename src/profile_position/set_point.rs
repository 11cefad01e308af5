//! What one move asks of a drive.

use core::{
    hash::{Hash, Hasher},
    time::Duration,
};

use crate::units::{AxisUnit, Counts, Quantity, Scale, ScaleError};

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
/// use servocrab::{BufferMode, SetPoint, units::Mm};
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
    /// Whether the axis is halted when whoever waits for the move is dropped before its end.
    pub halt_on_drop: bool,
    /// The torque that ends the move.
    pub contact: Option<ContactTorque>,
}

/// The torque that ends a move, and for how long it is shown without a break.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ContactTorque {
    /// Torque actual value 6077h, in either direction, in thousandths of the rated torque; more than 0.
    pub torque: u16,
    /// For so long. One sample is enough for 0.
    pub lasts: Duration,
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
            halt_on_drop: false,
            contact: None,
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

    /// Dropped before its end the move does not go on: the axis is halted. That holds for the future that sends it, for the
    /// [`Move`](crate::Move), and for the moves of [`start_together`](crate::start_together) and of a
    /// [`Follow`](crate::profile_position::Follow), each of which halts its axis. A move that was not sent is withdrawn.
    ///
    /// ```
    /// use servocrab::SetPoint;
    /// let careful: SetPoint = SetPoint::new().velocity(5_000).halt_on_drop();
    /// assert!(careful.halt_on_drop);
    /// ```
    #[must_use]
    pub const fn halt_on_drop(mut self) -> Self {
        self.halt_on_drop = true;
        self
    }

    /// Until the axis presses: the move ends as soon as torque actual value 6077h is so high in either direction, in thousandths of the
    /// rated torque, for so long. The axis is halted with the next frame, held where it then stands
    /// ([`Axis::stop_and_hold`](crate::Axis::stop_and_hold)), and [`Outcome::Contact`](crate::Outcome::Contact) says what was seen. The torque
    /// is then what keeps it in that place. Until it stands the drive's own limits 6072h, 60E0h and 60E1h bound it. Choose `lasts` longer
    /// than the peaks of friction and of the ramps.
    ///
    /// Dropped before its end the move is halted. It is refused where 6077h is not in the process data, with another buffer mode than
    /// `Aborting`, and where the axis cannot be held.
    ///
    /// ```
    /// use core::time::Duration;
    /// use servocrab::SetPoint;
    /// // 30 % of the rated torque for 20 ms.
    /// let press: SetPoint = SetPoint::new().velocity(2_000).until_torque(300, Duration::from_millis(20));
    /// assert!(press.halt_on_drop);
    /// ```
    #[must_use]
    pub const fn until_torque(mut self, torque: u16, lasts: Duration) -> Self {
        self.contact = Some(ContactTorque { torque, lasts });
        self.halt_on_drop = true;
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
            halt_on_drop,
            contact,
        } = self;
        (buffer_mode, parameters, halt_on_drop, contact).hash(state);
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

impl Parameters {
    /// Whether the axis goes on at the end, by an end velocity 6082h.
    pub(crate) fn goes_on(&self) -> bool {
        self.end_velocity.is_some_and(|velocity| velocity != 0)
    }
}

impl<U: AxisUnit> Default for Parameters<U> {
    fn default() -> Self {
        Self::new()
    }
}

/// How much faster or slower than asked for moves are: 0.05 to 2, in thousandths.
///
/// ```
/// use servocrab::profile_position::VelocityOverride;
/// let half = VelocityOverride::new(0.5).expect("within 0.05 and 2");
/// assert_eq!(half.of(9_000), 4_500);
/// assert!(VelocityOverride::new(0.0).is_none(), "to stop an axis halt it");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct VelocityOverride(u16);

impl VelocityOverride {
    /// As asked for.
    pub const NONE: Self = Self(1_000);

    /// So much; none outside of 0.05 to 2.
    #[must_use]
    pub fn new(factor: f64) -> Option<Self> {
        let allowed = (0.05..=2.0).contains(&factor);
        allowed.then_some(Self((factor * 1_000.0 + 0.5) as u16))
    }

    /// A velocity with it, which is 1 at least.
    #[must_use]
    pub const fn of(self, velocity: u32) -> u32 {
        let scaled = velocity as u64 * self.0 as u64 / 1_000;
        if scaled == 0 {
            return 1;
        }
        if scaled > u32::MAX as u64 {
            return u32::MAX;
        }
        scaled as u32
    }

    /// Parameters with it: profile velocity 6081h, and end velocity 6082h where it is not 0.
    pub(crate) fn apply(self, parameters: &Parameters) -> Parameters {
        if self == Self::NONE {
            return *parameters;
        }
        let scaled = |velocity: u32| if velocity == 0 { 0 } else { self.of(velocity) };
        Parameters {
            velocity: parameters.velocity.map(scaled),
            end_velocity: parameters.end_velocity.map(scaled),
            ..*parameters
        }
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

impl MoveCommand {
    /// Whether it replaces all others.
    pub(crate) fn replaces(&self) -> bool {
        self.set_point.buffer_mode == BufferMode::Aborting
    }

    /// To where the axis stands, with the parameters of the move that it replaces, but for its end velocity.
    pub(crate) fn to_stay_at(position: i32, parameters: &Parameters) -> Self {
        let mut set_point = SetPoint::new();
        set_point.parameters = Parameters {
            end_velocity: parameters.end_velocity.map(|_| 0),
            ..*parameters
        };
        Self {
            reference: Reference::Absolute,
            target: position,
            set_point,
            gated: false,
        }
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
                halt_on_drop: self.set_point.halt_on_drop,
                contact: self.set_point.contact,
            },
            gated: self.gated,
        })
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
