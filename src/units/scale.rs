//! A program's units and the drive's counts, both ways.

#[cfg(feature = "std")]
pub mod difference;

use core::{any::TypeId, fmt};

use crate::coe::ObjectAddress;

/// How many of the drive's units one of the program's units is: for positions, velocities and accelerations.
///
/// "Counts" here are the units of 607Ah and 6064h, of 6081h and 606Ch, of 6083h and 6084h. Numbers go to the nearest count. The
/// middle between two counts goes to the one that is further from zero, so that a mirrored motion is the mirrored counts. Factors
/// are fractions of whole numbers, so that this is the only rounding. What comes back from the drive is the number nearest to the
/// exact value, and gives the same count again.
///
/// A scale is positive. An axis whose direction is mirrored is set in the drive, by polarity 607Eh.
///
/// ```
/// use servocrab::units::{Ratio, Scale};
/// // A spindle of 5 mm a revolution, an encoder of 2²⁰ counts; velocities in counts/s, accelerations in counts/s².
/// let mm = Scale::counts_per_unit(Ratio::new(1 << 20, 5)?);
/// assert_eq!(mm.position(2.5)?, 1 << 19);
/// assert_eq!(mm.position_of(1 << 19), 2.5);
/// // The same with a drive whose velocity unit is a revolution per minute.
/// let mm = mm.velocity_counts_per_unit(Ratio::new(60, 5)?);
/// assert_eq!(mm.velocity(100.0)?, 1200);
/// assert!(mm.position(20_000.0).is_err(), "607Ah has 32 bits");
/// assert!(mm.position(f64::NAN).is_err());
/// # Ok::<(), servocrab::units::ScaleError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Scale {
    position: Ratio,
    velocity: Ratio,
    acceleration: Ratio,
}

impl Scale {
    /// The drive's own units.
    pub const COUNTS: Self = Self::counts_per_unit(Ratio::ONE);

    /// So many counts are one unit; velocities are in counts/s and accelerations in counts/s².
    #[must_use]
    pub const fn counts_per_unit(counts: Ratio) -> Self {
        Self {
            position: counts,
            velocity: counts,
            acceleration: counts,
        }
    }

    /// With so many of the drive's velocity units for one unit/s.
    #[must_use]
    pub const fn velocity_counts_per_unit(mut self, counts: Ratio) -> Self {
        self.velocity = counts;
        self
    }

    /// With so many of the drive's acceleration units for one unit/s².
    #[must_use]
    pub const fn acceleration_counts_per_unit(mut self, counts: Ratio) -> Self {
        self.acceleration = counts;
        self
    }

    /// A position or distance as 607Ah takes it.
    ///
    /// # Errors
    /// [`ScaleError::NotFinite`], or [`ScaleError::OutOfRange`] where `i32` does not hold it.
    pub fn position(&self, position: f64) -> Result<i32, ScaleError> {
        signed(Quantity::Position, self.position, position)
    }

    /// A home offset as 607Ch takes it.
    ///
    /// # Errors
    /// As [`position`](Self::position).
    pub fn home_offset(&self, offset: f64) -> Result<i32, ScaleError> {
        signed(Quantity::HomeOffset, self.position, offset)
    }

    /// A velocity with a direction as 60FFh takes it.
    ///
    /// # Errors
    /// [`ScaleError::NotFinite`], [`ScaleError::OutOfRange`] where `i32` does not hold it, or [`ScaleError::RoundsToZero`].
    pub fn target_velocity(&self, velocity: f64) -> Result<i32, ScaleError> {
        let quantity = Quantity::TargetVelocity;
        match signed(quantity, self.velocity, velocity)? {
            0 if velocity != 0.0 => Err(rounds_to_zero(quantity, self.velocity, velocity)),
            counts => Ok(counts),
        }
    }

    /// A velocity as 6081h takes it.
    ///
    /// # Errors
    /// [`ScaleError::NotFinite`], [`ScaleError::OutOfRange`] where it is negative or `u32` does not hold it, or
    /// [`ScaleError::RoundsToZero`].
    pub fn velocity(&self, velocity: f64) -> Result<u32, ScaleError> {
        unsigned(Quantity::Velocity, self.velocity, velocity)
    }

    /// An acceleration or deceleration as 6083h and 6084h take it.
    ///
    /// # Errors
    /// As [`velocity`](Self::velocity).
    pub fn acceleration(&self, acceleration: f64) -> Result<u32, ScaleError> {
        unsigned(Quantity::Acceleration, self.acceleration, acceleration)
    }

    /// A position or distance in the program's units.
    #[must_use]
    pub fn position_of(&self, counts: impl Into<i64>) -> f64 {
        self.position.divide(counts.into())
    }

    /// A velocity in the program's units/s.
    #[must_use]
    pub fn velocity_of(&self, counts: impl Into<i64>) -> f64 {
        self.velocity.divide(counts.into())
    }

    /// An acceleration in the program's units/s².
    #[must_use]
    pub fn acceleration_of(&self, counts: u32) -> f64 {
        self.acceleration.divide(counts.into())
    }

    /// A velocity without a direction, where there is one.
    pub(crate) fn speed(
        &self,
        quantity: Quantity,
        asked: Option<impl Into<f64>>,
    ) -> Result<Option<u32>, ScaleError> {
        asked
            .map(|asked| unsigned(quantity, self.velocity, asked.into()))
            .transpose()
    }

    /// An acceleration or deceleration, where there is one.
    pub(crate) fn ramp(
        &self,
        quantity: Quantity,
        asked: Option<impl Into<f64>>,
    ) -> Result<Option<u32>, ScaleError> {
        asked
            .map(|asked| unsigned(quantity, self.acceleration, asked.into()))
            .transpose()
    }
}

/// What a number is converted for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Quantity {
    /// Target position 607Ah: a position or distance.
    Position,
    /// Profile velocity 6081h.
    Velocity,
    /// End velocity 6082h.
    EndVelocity,
    /// Profile acceleration 6083h.
    Acceleration,
    /// Profile deceleration 6084h.
    Deceleration,
    /// Target velocity 60FFh: the velocity of a jog.
    TargetVelocity,
    /// Speed during the search for the switch 6099h:1.
    HomingSwitchSpeed,
    /// Speed during the search for zero 6099h:2.
    HomingZeroSpeed,
    /// Homing acceleration 609Ah.
    HomingAcceleration,
    /// Home offset 607Ch.
    HomeOffset,
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "target position 607Ah",
            Self::Velocity => "profile velocity 6081h",
            Self::EndVelocity => "end velocity 6082h",
            Self::Acceleration => "profile acceleration 6083h",
            Self::Deceleration => "profile deceleration 6084h",
            Self::TargetVelocity => "target velocity 60FFh",
            Self::HomingSwitchSpeed => "homing speed 6099h:1",
            Self::HomingZeroSpeed => "homing speed 6099h:2",
            Self::HomingAcceleration => "homing acceleration 609Ah",
            Self::HomeOffset => "home offset 607Ch",
        })
    }
}

/// What is wrong with a number or a factor; nothing was sent.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScaleError {
    /// NaN or infinity.
    #[error("{asked} is no {quantity}: give a finite number")]
    NotFinite {
        /// What it was given for.
        quantity: Quantity,
        /// What was given.
        asked: f64,
    },
    /// The object's type does not hold the value.
    #[error(
        "{quantity} of {} is out of range: the object holds {} to {}, in the program's units",
        Short(*asked), Short(*min), Short(*max)
    )]
    OutOfRange {
        /// What it was given for.
        quantity: Quantity,
        /// What was given, in the program's units.
        asked: f64,
        /// The least that the object holds, in the program's units.
        min: f64,
        /// The most that the object holds, in the program's units.
        max: f64,
    },
    /// A velocity or acceleration of less than half a unit of the drive, which is not 0.
    #[error(
        "{quantity} of {} is less than the drive's smallest value: the least is {}",
        Short(*asked), Short(*least)
    )]
    RoundsToZero {
        /// What it was given for.
        quantity: Quantity,
        /// What was given, in the program's units.
        asked: f64,
        /// One of the drive's units, in the program's units.
        least: f64,
    },
    /// A factor is not a finite number.
    #[error("a factor must be a finite number")]
    NotANumber,
    /// A factor is 0 or negative.
    #[error("a factor must be more than zero")]
    Zero,
    /// A factor needs more than 64 bits above or below the fraction line.
    #[error(
        "the factor is no fraction of two numbers of 64 bits: give it as one that is close to it"
    )]
    TooLong,
    /// A factor object of the drive is 0.
    #[error("the drive's factor {object} is zero: set it, or give the scale with the program")]
    ZeroFactor {
        /// The object, as of the drive's first axis.
        object: ObjectAddress,
    },
    /// The drive has none of the factor objects that define the scale.
    #[error("the drive has neither 6092h nor 608Fh (with 6093h): configure the scale explicitly")]
    NoFactors,
}

/// A number as a message shows it: by its exponent where its digits would be a row of zeros.
struct Short(f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = self.0.abs();
        if size == 0.0 || (1e-6..1e15).contains(&size) {
            self.0.fmt(f)
        } else {
            write!(f, "{:e}", self.0)
        }
    }
}

fn to_count(quantity: Quantity, ratio: Ratio, asked: f64) -> Result<Option<i64>, ScaleError> {
    if !asked.is_finite() {
        return Err(ScaleError::NotFinite { quantity, asked });
    }
    Ok(ratio.round(asked))
}

fn rounds_to_zero(quantity: Quantity, ratio: Ratio, asked: f64) -> ScaleError {
    ScaleError::RoundsToZero {
        quantity,
        asked,
        least: ratio.divide(1),
    }
}

fn signed(quantity: Quantity, ratio: Ratio, asked: f64) -> Result<i32, ScaleError> {
    to_count(quantity, ratio, asked)?
        .and_then(|count| i32::try_from(count).ok())
        .ok_or_else(|| ScaleError::OutOfRange {
            quantity,
            asked,
            min: ratio.divide(i32::MIN.into()),
            max: ratio.divide(i32::MAX.into()),
        })
}

fn unsigned(quantity: Quantity, ratio: Ratio, asked: f64) -> Result<u32, ScaleError> {
    let counts = to_count(quantity, ratio, asked)?;
    if counts == Some(0) && asked != 0.0 {
        return Err(rounds_to_zero(quantity, ratio, asked));
    }
    counts
        .and_then(|counts| u32::try_from(counts).ok())
        .ok_or_else(|| ScaleError::OutOfRange {
            quantity,
            asked,
            min: 0.0,
            max: ratio.divide(u32::MAX.into()),
        })
}

/// A scale of which each quantity has a factor of its own.
#[cfg(test)]
pub fn example() -> Scale {
    Scale::counts_per_unit(Ratio::new(1000, 1).unwrap())
        .velocity_counts_per_unit(Ratio::new(10, 1).unwrap())
        .acceleration_counts_per_unit(Ratio::new(1, 4).unwrap())
}

// The unit that a handle counts in, as a type.

/// A unit of a program's positions: millimetres, degrees, whatever the machine counts in. Velocities are in it per second,
/// accelerations in it per second squared. A value of the type says nothing; the type keeps numbers of one axis from another.
///
/// ```
/// use servocrab::units::Unit;
/// /// Turns of the table.
/// #[derive(Debug, Clone, Copy, PartialEq)]
/// struct Turn;
///
/// impl Unit for Turn {
///     const NAME: &'static str = "turns";
/// }
/// ```
pub trait Unit: Copy + fmt::Debug + PartialEq + Send + Sync + Unpin + 'static {
    /// What stands behind a number in a text, such as "mm".
    const NAME: &'static str;

    /// How many metres one is, if it is a length: then the scale is compared with what a drive says in 60A8h and 60A9h.
    const METRES: Option<Ratio> = None;
}

/// Millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Mm;

impl Unit for Mm {
    const NAME: &'static str = "mm";
    const METRES: Option<Ratio> = Some(Ratio::ONE_THOUSANDTH);
}

/// Degrees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Degree;

impl Unit for Degree {
    const NAME: &'static str = "°";
}

/// The drive's own units, of which each object has one of its own. No [`Unit`]: its numbers are whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Counts;

/// What a handle counts in: [`Counts`], or any [`Unit`].
pub trait AxisUnit:
    sealed::Sealed + Copy + fmt::Debug + PartialEq + Send + Sync + Unpin + 'static
{
    /// What stands behind a number in a text.
    const NAME: &'static str;

    /// A position, a distance, or a velocity with its direction: `i32` for counts, `f64` for others.
    type Signed: AxisNumber;

    /// A velocity without a direction, an acceleration: `u32` for counts, `f64` for others.
    type Magnitude: AxisNumber;

    /// A number of counts, given its value in this unit.
    #[doc(hidden)]
    fn signed(counts: i32, value: f64) -> Self::Signed;
}

/// A number of a handle. Each has its exact value as an `f64`.
pub trait AxisNumber:
    Copy
    + fmt::Debug
    + fmt::Display
    + PartialEq
    + PartialOrd
    + Into<f64>
    + Send
    + Sync
    + Unpin
    + 'static
{
}

impl AxisNumber for i32 {}
impl AxisNumber for u32 {}
impl AxisNumber for f64 {}

impl AxisUnit for Counts {
    const NAME: &'static str = "counts";
    type Signed = i32;
    type Magnitude = u32;

    fn signed(counts: i32, _: f64) -> i32 {
        counts
    }
}

impl<U: Unit> AxisUnit for U {
    const NAME: &'static str = U::NAME;
    type Signed = f64;
    type Magnitude = f64;

    fn signed(_: i32, value: f64) -> f64 {
        value
    }
}

mod sealed {
    pub trait Sealed {}

    impl Sealed for super::Counts {}
    impl<U: super::Unit> Sealed for U {}
}

/// The unit that an axis was declared in, and its scale.
///
/// ```
/// use servocrab::units::{AxisScale, Mm, Ratio, Scale};
/// // A thousand counts are a millimetre.
/// let mm = AxisScale::of::<Mm>(Scale::counts_per_unit(Ratio::new(1000, 1)?));
/// assert_eq!(mm.unit(), "mm");
/// assert_eq!(AxisScale::default(), AxisScale::COUNTS);
/// # Ok::<(), servocrab::units::ScaleError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AxisScale {
    /// None of an axis in counts.
    unit: Option<DeclaredUnit>,
    scale: Scale,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct DeclaredUnit {
    id: TypeId,
    name: &'static str,
    metres: Option<Ratio>,
}

impl AxisScale {
    /// The drive's own units.
    pub const COUNTS: Self = Self {
        unit: None,
        scale: Scale::COUNTS,
    };

    /// This unit, with so many counts for one of it.
    #[must_use]
    pub fn of<U: Unit>(scale: Scale) -> Self {
        Self {
            unit: Some(DeclaredUnit {
                id: TypeId::of::<U>(),
                name: U::NAME,
                metres: U::METRES,
            }),
            scale,
        }
    }

    /// The unit's name.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        self.unit.map_or(Counts::NAME, |unit| unit.name)
    }

    /// The scale.
    #[must_use]
    pub const fn scale(&self) -> &Scale {
        &self.scale
    }

    /// Whether this is that unit.
    #[must_use]
    pub fn is_in<U: AxisUnit>(&self) -> bool {
        let id = self.unit.map_or(TypeId::of::<Counts>(), |unit| unit.id);
        id == TypeId::of::<U>()
    }
}

impl Default for AxisScale {
    fn default() -> Self {
        Self::COUNTS
    }
}

impl Scale {
    /// A position or distance of so many counts, in the unit of this scale.
    #[must_use]
    pub fn position_in<U: AxisUnit>(&self, counts: i32) -> U::Signed {
        U::signed(counts, self.position_of(counts))
    }

    /// A velocity of so many counts, in the unit of this scale per second.
    #[must_use]
    pub fn velocity_in<U: AxisUnit>(&self, counts: i32) -> U::Signed {
        U::signed(counts, self.velocity_of(counts))
    }
}

// A positive fraction of whole numbers, and its product with a number, rounded once.

/// A positive fraction of two whole numbers, in lowest terms: exact where a decimal number is not.
///
/// ```
/// use servocrab::units::Ratio;
/// // An encoder of 2²⁰ counts behind a gear of 10:3, on a spindle of 5 mm a revolution.
/// let counts_per_mm = Ratio::new(1 << 20, 5)?.times(Ratio::new(10, 3)?)?;
/// assert_eq!(counts_per_mm, Ratio::new(2 << 20, 3)?);
/// // A factor that is no fraction of small numbers: counts per radian.
/// let counts_per_radian = Ratio::try_from(f64::from(1 << 20) / core::f64::consts::TAU)?;
/// assert!(counts_per_radian.numerator() > 166_886 * counts_per_radian.denominator());
/// # Ok::<(), servocrab::units::ScaleError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Ratio {
    numerator: u64,
    denominator: u64,
}

impl Ratio {
    /// One to one.
    pub const ONE: Self = Self {
        numerator: 1,
        denominator: 1,
    };
    /// One to a thousand.
    const ONE_THOUSANDTH: Self = Self {
        numerator: 1,
        denominator: 1000,
    };

    /// `numerator` to `denominator`, in lowest terms.
    ///
    /// # Errors
    /// [`ScaleError::Zero`] if one of them is 0.
    pub const fn new(numerator: u64, denominator: u64) -> Result<Self, ScaleError> {
        if numerator == 0 || denominator == 0 {
            return Err(ScaleError::Zero);
        }
        let divisor = greatest_common_divisor(numerator, denominator);
        Ok(Self {
            numerator: numerator / divisor,
            denominator: denominator / divisor,
        })
    }

    /// The upper number.
    #[must_use]
    pub const fn numerator(self) -> u64 {
        self.numerator
    }

    /// The lower number.
    #[must_use]
    pub const fn denominator(self) -> u64 {
        self.denominator
    }

    /// The product of two fractions.
    ///
    /// # Errors
    /// [`ScaleError::TooLong`] if it needs more than 64 bits above or below the line.
    pub fn times(self, other: Self) -> Result<Self, ScaleError> {
        // Reduced crosswise before, the product is in lowest terms and overflows only where its value needs it.
        let first = greatest_common_divisor(self.numerator, other.denominator);
        let second = greatest_common_divisor(other.numerator, self.denominator);
        let product = |a: u64, b: u64| a.checked_mul(b).ok_or(ScaleError::TooLong);
        Ok(Self {
            numerator: product(self.numerator / first, other.numerator / second)?,
            denominator: product(self.denominator / second, other.denominator / first)?,
        })
    }

    /// This fraction divided by another.
    ///
    /// # Errors
    /// As [`times`](Self::times).
    pub fn over(self, other: Self) -> Result<Self, ScaleError> {
        self.times(other.inverse())
    }

    /// One divided by this fraction.
    #[must_use]
    pub const fn inverse(self) -> Self {
        Self {
            numerator: self.denominator,
            denominator: self.numerator,
        }
    }

    /// The whole number nearest to `value` times this fraction, ties away from zero. `None` for a value that is not finite and for
    /// a product that `i64` does not hold. Nothing else is rounded on the way.
    fn round(self, value: f64) -> Option<i64> {
        if !value.is_finite() {
            return None;
        }
        let (mantissa, exponent) = split(value);
        // 53 bits times 64.
        let product = u128::from(mantissa) * u128::from(self.numerator);
        let denominator = u128::from(self.denominator);
        let rounded = if exponent >= 0 {
            let shift = exponent.unsigned_abs();
            if shift >= product.leading_zeros() {
                // The quotient is more than 2⁶³.
                return None;
            }
            divide(product << shift, denominator)
        } else {
            let shift = exponent.unsigned_abs();
            if shift >= denominator.leading_zeros() {
                // The divisor is 2¹²⁷ or more, the product less than half of that.
                0
            } else {
                divide(product, denominator << shift)
            }
        };
        let magnitude = i64::try_from(rounded).ok()?;
        Some(if value.is_sign_negative() {
            -magnitude
        } else {
            magnitude
        })
    }

    /// The number nearest to `count` divided by this fraction.
    fn divide(self, count: i64) -> f64 {
        let product = u128::from(count.unsigned_abs()) * u128::from(self.denominator);
        if product == 0 {
            return 0.0;
        }
        let shift = product.leading_zeros();
        let scaled = product << shift;
        let numerator = u128::from(self.numerator);
        // At least 64 bits. The remainder of the division counts as one more bit, so that the conversion rounds as if it saw all of
        // them.
        let quotient = (scaled / numerator) | u128::from(!scaled.is_multiple_of(numerator));
        let magnitude = quotient as f64 * power_of_two(shift);
        if count.is_negative() {
            -magnitude
        } else {
            magnitude
        }
    }
}

impl TryFrom<f64> for Ratio {
    type Error = ScaleError;

    /// The fraction that this number is, exactly.
    ///
    /// # Errors
    /// [`ScaleError::Zero`] for a number that is not positive, [`ScaleError::NotANumber`] for NaN and infinity,
    /// [`ScaleError::TooLong`] for one that needs more than 64 bits before or behind the point.
    fn try_from(value: f64) -> Result<Self, ScaleError> {
        if !value.is_finite() {
            return Err(ScaleError::NotANumber);
        }
        if value <= 0.0 {
            return Err(ScaleError::Zero);
        }
        let (mantissa, exponent) = split(value);
        let zeros = mantissa.trailing_zeros();
        let mantissa = mantissa >> zeros;
        let exponent = exponent.saturating_add_unsigned(zeros);
        let shift = exponent.unsigned_abs();
        if exponent >= 0 {
            if shift > mantissa.leading_zeros() {
                return Err(ScaleError::TooLong);
            }
            Self::new(mantissa << shift, 1)
        } else {
            let denominator = 1u64.checked_shl(shift).ok_or(ScaleError::TooLong)?;
            Self::new(mantissa, denominator)
        }
    }
}

/// Nearest, ties away from zero. `divisor` is not 0.
const fn divide(value: u128, divisor: u128) -> u128 {
    let (quotient, rest) = (value / divisor, value % divisor);
    quotient + (rest >= divisor - rest) as u128
}

/// Mantissa and exponent: the value's magnitude is mantissa times 2 to the exponent.
const fn split(value: f64) -> (u64, i32) {
    let bits = value.to_bits();
    let mantissa = bits & ((1 << 52) - 1);
    match (bits >> 52 & 0x7FF) as i32 {
        0 => (mantissa, -1074),
        exponent => (mantissa + (1 << 52), exponent - 1075),
    }
}

/// 2 to the power of −`exponent`, for exponents up to 127.
const fn power_of_two(exponent: u32) -> f64 {
    f64::from_bits((1023 - exponent as u64) << 52)
}

const fn greatest_common_divisor(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

// The factor objects of a drive, and the scale that they make.

/// What a drive's factor objects hold; read by [`Axis::factors`](crate::Axis::factors), or written down by a program.
/// Those that the drive does not have are `None`.
///
/// ```
/// use servocrab::units::{Factors, Ratio};
/// // 6092h: 65536 position units a revolution of the shaft, which moves the slide by 5 mm. 6096h: velocities in rpm.
/// let factors = Factors {
///     feed: Some(Ratio::new(65_536, 1)?),
///     velocity: Some(Ratio::new(60, 65_536)?),
///     ..Factors::default()
/// };
/// let mm = factors.scale(Ratio::new(5, 1)?)?;
/// assert_eq!(mm.position(2.5)?, 32_768);
/// assert_eq!(mm.velocity(10.0)?, 120);
/// # Ok::<(), servocrab::units::ScaleError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Factors {
    /// Which edition of the profile the drive follows in 6096h and 6097h.
    pub edition: Edition,
    /// Position encoder resolution 608Fh: encoder increments to motor revolutions.
    pub encoder: Option<Ratio>,
    /// Gear ratio 6091h: motor revolutions to shaft revolutions.
    pub gear: Option<Ratio>,
    /// Feed constant 6092h: position units to shaft revolutions.
    pub feed: Option<Ratio>,
    /// Position factor 6093h of older drives: encoder increments to position units.
    pub position: Option<Ratio>,
    /// Velocity encoder factor 6094h of older drives: encoder increments/s to velocity units.
    pub velocity_encoder: Option<Ratio>,
    /// Velocity factor 6096h: velocity units to position units/s.
    pub velocity: Option<Ratio>,
    /// Acceleration factor 6097h: by [`Edition`].
    pub acceleration: Option<Ratio>,
}

/// Which way the factor objects for velocity and acceleration convert: the editions of the profile differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Edition {
    /// CiA 402-2 version 3 and later. A velocity in position units/s times 6096h is in velocity units; an acceleration in
    /// velocity units/s times 6097h is in acceleration units. So AKD2G's description of 6096h, and the defaults of AX8000.
    #[default]
    Version3,
    /// DSP 402 version 2. A velocity in velocity units times 6094h is in increments/s. An acceleration in acceleration units times
    /// 6097h is in increments/s². A position in position units times 6093h is in increments. Its 6096h relates two encoders and is
    /// not used here.
    Version2,
}

impl Factors {
    /// The scale of a machine on which one revolution of the shaft is this number of the program's units: 5 for a spindle of 5 mm,
    /// 360 for degrees of the shaft.
    ///
    /// Position units a revolution are 6092h. Where the drive has no such object, they are increments a revolution divided by
    /// 6093h, where it has that. Increments a revolution are 608Fh times 6091h, or 608Fh alone without a gear. A factor for
    /// velocity or acceleration that the drive does not have means position units/s and position units/s², by version 3 also
    /// velocity units/s.
    ///
    /// # Errors
    /// [`ScaleError::NoFactors`] where the drive has neither 6092h nor 608Fh, [`ScaleError::TooLong`] where the product is no
    /// fraction of two numbers of 64 bits.
    pub fn scale(&self, units_per_revolution: Ratio) -> Result<Scale, ScaleError> {
        let increments = match self.encoder {
            Some(encoder) => Some(encoder.times(self.gear.unwrap_or(Ratio::ONE))?),
            None => None,
        };
        let by_factor = match (increments, self.position) {
            (Some(increments), Some(factor)) => Some(increments.over(factor)?),
            _ => None,
        };
        let position = match self.edition {
            Edition::Version2 => by_factor.or(self.feed),
            Edition::Version3 => self.feed.or(by_factor),
        };
        let position = position.or(increments).ok_or(ScaleError::NoFactors)?;
        let (velocity, acceleration) = match self.edition {
            Edition::Version3 => {
                let velocity = position.times(self.velocity.unwrap_or(Ratio::ONE))?;
                let acceleration = velocity.times(self.acceleration.unwrap_or(Ratio::ONE))?;
                (velocity, acceleration)
            }
            Edition::Version2 => {
                let of = |factor: Option<Ratio>| match (increments, factor) {
                    (Some(increments), Some(factor)) => increments.over(factor),
                    (None, Some(_)) => Err(ScaleError::NoFactors),
                    (_, None) => Ok(position),
                };
                (of(self.velocity_encoder)?, of(self.acceleration)?)
            }
        };
        Ok(Scale::counts_per_unit(position.over(units_per_revolution)?)
            .velocity_counts_per_unit(velocity.over(units_per_revolution)?)
            .acceleration_counts_per_unit(acceleration.over(units_per_revolution)?))
    }
}

#[cfg(test)]
mod tests {
    use alloc::string::ToString;

    use proptest::prelude::*;

    use super::{example as mm, *};

    #[test]
    fn a_greatest_common_divisor_divides_both() {
        for (a, b, divisor) in [(12, 18, 6), (18, 12, 6), (7, 0, 7), (5, 7, 1)] {
            assert_eq!(greatest_common_divisor(a, b), divisor);
        }
    }

    #[test]
    fn each_quantity_has_its_own_factor() {
        assert_eq!(mm().position(-1.5), Ok(-1500));
        assert_eq!(mm().velocity_of(13), 1.3);
        assert_eq!(mm().acceleration_of(3), 12.0);
    }

    #[test]
    fn what_an_object_does_not_hold_is_refused_with_its_range() {
        let edge = f64::from(i32::MAX) / 1000.0;
        assert_eq!(mm().position(edge), Ok(i32::MAX));
        assert_eq!(
            mm().position(edge + 0.001),
            Err(ScaleError::OutOfRange {
                quantity: Quantity::Position,
                asked: edge + 0.001,
                min: -2_147_483.648,
                max: 2_147_483.647,
            })
        );
        let error = mm().position(1e300).unwrap_err().to_string();
        assert!(
            error.contains(" of 1e300 is out of range: ") && error.len() < 200,
            "{error}"
        );
        let error = mm().velocity(1e-300).unwrap_err().to_string();
        assert!(
            error.contains(" of 1e-300 is less than ") && error.len() < 200,
            "{error}"
        );
        // 0 is a value that the drive knows; that it is no velocity of a move is for the axis to say.
        assert_eq!(mm().velocity(0.0), Ok(0));
    }

    #[test]
    fn a_velocity_that_would_stand_or_be_another_is_refused_and_zero_is_not() {
        for velocity in [0.04, -0.04] {
            let refused = mm().target_velocity(velocity);
            assert!(
                matches!(
                    refused,
                    Err(ScaleError::RoundsToZero {
                        quantity: Quantity::TargetVelocity,
                        asked,
                        least: 0.1,
                    }) if asked == velocity
                ),
                "{refused:?}"
            );
        }
        assert_eq!(mm().target_velocity(0.0), Ok(0));
        for velocity in [1e9, -1e9, f64::INFINITY, f64::NAN] {
            assert!(mm().target_velocity(velocity).is_err(), "{velocity}");
        }
    }

    #[test]
    fn a_message_shows_long_numbers_by_their_exponent() {
        for (number, text) in [
            (0.0, "0"),
            (1e-6, "0.000001"),
            (9e-7, "9e-7"),
            (-9e-7, "-9e-7"),
            (999_999_999_999_999.0, "999999999999999"),
            (1e15, "1e15"),
            (-2.5, "-2.5"),
        ] {
            assert_eq!(Short(number).to_string(), text);
        }
    }

    #[test]
    fn an_axis_is_in_the_unit_that_it_was_declared_in() {
        let in_mm = AxisScale::of::<Mm>(mm());
        assert!(in_mm.is_in::<Mm>() && !in_mm.is_in::<Degree>() && !in_mm.is_in::<Counts>());
        assert!(AxisScale::COUNTS.is_in::<Counts>() && !AxisScale::COUNTS.is_in::<Mm>());
        let units = [in_mm.unit(), AxisScale::of::<Degree>(mm()).unit()];
        assert_eq!(units, ["mm", "°"]);
        assert_eq!(AxisScale::default().unit(), "counts");
        assert_eq!(*in_mm.scale(), mm());
        assert_eq!(mm().position_in::<Mm>(-1_500), -1.5);
        assert_eq!(mm().position_in::<Counts>(-1_500), -1_500);
        assert_eq!(mm().velocity_in::<Mm>(13), 1.3);
        assert_eq!(mm().velocity_in::<Counts>(13), 13);
    }

    proptest! {
        #[test]
        fn every_count_of_every_object_comes_back_from_its_value(
            numerator in 1..=u64::MAX,
            denominator in 1..=u64::MAX,
            position in any::<i32>(),
            unsigned in any::<u32>(),
        ) {
            let scale = Scale::counts_per_unit(Ratio::new(numerator, denominator).unwrap());
            prop_assert_eq!(scale.position(scale.position_of(position)), Ok(position));
            prop_assert_eq!(scale.velocity(scale.velocity_of(unsigned)), Ok(unsigned));
            prop_assert_eq!(scale.acceleration(scale.acceleration_of(unsigned)), Ok(unsigned));
        }

        #[test]
        fn counts_go_through_as_they_are(signed in any::<i32>(), unsigned in any::<u32>()) {
            prop_assert_eq!(Scale::COUNTS.position(signed.into()), Ok(signed));
            prop_assert_eq!(Scale::COUNTS.target_velocity(signed.into()), Ok(signed));
            prop_assert_eq!(Scale::COUNTS.home_offset(signed.into()), Ok(signed));
            prop_assert_eq!(Scale::COUNTS.speed(Quantity::Velocity, Some(unsigned)), Ok(Some(unsigned)));
            prop_assert_eq!(Scale::COUNTS.ramp(Quantity::Acceleration, Some(unsigned)), Ok(Some(unsigned)));
        }

        #[test]
        fn a_mirrored_position_is_the_mirrored_count(value in -1e6..1e6_f64, counts in 1..5000_u64, units in 1..5000_u64) {
            let scale = Scale::counts_per_unit(Ratio::new(counts, units).unwrap());
            if let (Ok(there), Ok(mirrored)) = (scale.position(value), scale.position(-value)) {
                prop_assert_eq!(there, -mirrored);
            }
        }
    }
}

#[cfg(test)]
mod ratio_tests {
    use proptest::prelude::*;

    use super::*;

    fn ratio(numerator: u64, denominator: u64) -> Ratio {
        Ratio::new(numerator, denominator).unwrap()
    }

    #[test]
    fn a_product_is_rounded_to_the_nearest_and_ties_go_away_from_zero() {
        let half = ratio(1, 2);
        for (value, rounded) in [(1.0, 1), (3.0, 2), (5.0, 3), (4.0, 2), (0.9, 0), (1.1, 1)] {
            assert_eq!(half.round(value), Some(rounded), "{value}");
            assert_eq!(half.round(-value), Some(-rounded), "-{value}");
        }
        // Just below a tie, where a multiplication in floating point would round up to it.
        assert_eq!(Ratio::ONE.round(0.499_999_999_999_999_94), Some(0));
    }

    #[test]
    fn what_is_not_finite_or_too_large_is_refused() {
        for value in [
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            1e19,
            -1e300,
            f64::MAX,
        ] {
            assert_eq!(Ratio::ONE.round(value), None, "{value}");
        }
        assert_eq!(ratio(u64::MAX, 1).round(f64::MAX), None);
        assert_eq!(ratio(1, u64::MAX).round(f64::MAX), None);
        assert_eq!(ratio(1, u64::MAX).round(f64::MIN_POSITIVE), Some(0));
        assert_eq!(ratio(u64::MAX, 1).round(5e-324), Some(0));
        assert_eq!(ratio(u64::MAX, 1).round(0.0), Some(0));
        assert_eq!(ratio(u64::MAX, 1).round(-0.0), Some(0));
    }

    #[test]
    fn a_fraction_that_needs_more_than_64_bits_is_refused() {
        let wide = ratio(u64::MAX, 2);
        assert_eq!(wide.times(wide), Err(ScaleError::TooLong));
        assert_eq!(wide.times(wide.inverse()), Ok(Ratio::ONE));
        assert_eq!(Ratio::new(0, 1), Err(ScaleError::Zero));
        assert_eq!(Ratio::new(1, 0), Err(ScaleError::Zero));
        assert_eq!(Ratio::try_from(1e-30), Err(ScaleError::TooLong));
        assert_eq!(Ratio::try_from(1e30), Err(ScaleError::TooLong));
        assert_eq!(Ratio::try_from(f64::NAN), Err(ScaleError::NotANumber));
        assert_eq!(Ratio::try_from(-1.0), Err(ScaleError::Zero));
        assert_eq!(Ratio::try_from(2.5), Ratio::new(5, 2));
        assert_eq!(
            Ratio::try_from(f64::from(1u32 << 31) * 1024.0),
            Ratio::new(1 << 41, 1)
        );
    }

    #[test]
    fn a_fraction_is_in_lowest_terms_and_so_is_a_product() {
        let parts = |ratio: Ratio| (ratio.numerator(), ratio.denominator());
        assert_eq!(parts(ratio(6, 35)), (6, 35));
        assert_eq!(parts(ratio(36, 210)), (6, 35));
        assert_eq!(ratio(6, 35).times(ratio(14, 9)).map(parts), Ok((4, 15)));
        assert_eq!(ratio(6, 35).over(ratio(9, 14)).map(parts), Ok((4, 15)));
        assert_eq!(parts(ratio(6, 35).inverse()), (35, 6));
    }

    #[test]
    fn the_largest_count_is_the_largest_of_64_bits() {
        let below = 2_f64.powi(63) - 1024.0;
        assert_eq!(Ratio::ONE.round(below), Some(i64::MAX - 1023));
        assert_eq!(Ratio::ONE.round(-below), Some(1023 - i64::MAX));
        assert_eq!(Ratio::ONE.round(2_f64.powi(63)), None);
        // A product of 128 bits whose quotient still fits.
        assert_eq!(
            ratio(u64::MAX, u64::MAX - 1).round(below),
            Some(i64::MAX - 1023)
        );
        // A divisor of 127 bits is the longest that the product is still compared with.
        let small = 2_f64.powi(-115);
        assert_eq!(ratio(u64::MAX, 1).round(small), Some(0));
        assert_eq!(ratio(u64::MAX, 1).round(2_f64.powi(-65)), Some(0));
        assert_eq!(ratio(u64::MAX, 1).round(2_f64.powi(-64)), Some(1));
        assert_eq!(ratio(u64::MAX, 1).round(-(2_f64.powi(-64))), Some(-1));
    }

    #[test]
    fn a_quotient_is_rounded_once_to_the_even_number_at_a_tie_alone() {
        // Halfway between two numbers of 53 bits, exactly.
        assert_eq!(Ratio::ONE.divide((1 << 53) + 1), 2_f64.powi(53));
        assert_eq!(Ratio::ONE.divide((1 << 53) + 3), 2_f64.powi(53) + 4.0);
        // A little more than halfway, which only the rest of the division shows.
        let wide = ratio(13_670_496_365_289_161_525, 1);
        assert_eq!(wide.divide(1_558_683_376), 1.140_180_527_722_213_7e-10);
        assert_eq!(wide.divide(-1_558_683_376), -1.140_180_527_722_213_7e-10);
        assert_eq!(ratio(1, 3).divide(-7), -21.0);
        assert_eq!(ratio(3, 1).divide(0), 0.0);
    }

    #[test]
    fn a_number_is_a_fraction_of_64_bits_above_and_below_the_line() {
        let two = |exponent| 2_f64.powi(exponent);
        assert_eq!(Ratio::try_from(two(63)), Ratio::new(1 << 63, 1));
        assert_eq!(Ratio::try_from(two(64)), Err(ScaleError::TooLong));
        assert_eq!(Ratio::try_from(3.0 * two(62)), Ratio::new(3 << 62, 1));
        assert_eq!(Ratio::try_from(3.0 * two(63)), Err(ScaleError::TooLong));
        assert_eq!(Ratio::try_from(two(-63)), Ratio::new(1, 1 << 63));
        assert_eq!(Ratio::try_from(two(-64)), Err(ScaleError::TooLong));
        assert_eq!(Ratio::try_from(0.0), Err(ScaleError::Zero));
    }

    proptest! {
        #[test]
        fn the_sum_of_the_parts_is_rounded_as_integers_are(
            numerator in 1..1_000_000_u64,
            denominator in 1..1_000_000_u64,
            value in -1_000_000_000_i64..1_000_000_000,
        ) {
            let product = i128::from(value) * i128::from(numerator);
            let divisor = i128::from(denominator);
            let expected = (2 * product.abs() + divisor) / (2 * divisor) * product.signum();
            let rounded = ratio(numerator, denominator).round(value as f64).map(i128::from);
            prop_assert_eq!(rounded, Some(expected));
        }

        #[test]
        fn every_count_comes_back_from_its_value(
            numerator in 1..=u64::MAX,
            denominator in 1..=u64::MAX,
            count in any::<i32>(),
        ) {
            let ratio = ratio(numerator, denominator);
            prop_assert_eq!(ratio.round(ratio.divide(count.into())), Some(count.into()));
        }

        #[test]
        fn a_value_comes_back_within_half_a_count(
            numerator in 1..1_u64 << 40,
            denominator in 1..1_u64 << 40,
            value in -1e6..1e6_f64,
        ) {
            let ratio = ratio(numerator, denominator);
            if let Some(count) = ratio.round(value) {
                let half = 0.5 * denominator as f64 / numerator as f64;
                let slack = value.abs() * 1e-15 + half * 1e-12;
                prop_assert!((ratio.divide(count) - value).abs() <= half + slack);
            }
        }

        #[test]
        fn no_number_at_all_makes_it_panic(bits in any::<u64>(), numerator in 1..=u64::MAX, denominator in 1..=u64::MAX) {
            let value = f64::from_bits(bits);
            let ratio = ratio(numerator, denominator);
            let _ = ratio.round(value);
            let _ = Ratio::try_from(value);
            prop_assert!(ratio.divide(bits.cast_signed()).is_finite());
        }
    }
}

#[cfg(test)]
mod factors_tests {
    use super::*;

    fn ratio(numerator: u64, denominator: u64) -> Option<Ratio> {
        Some(Ratio::new(numerator, denominator).unwrap())
    }

    const DEGREES: Ratio = match Ratio::new(360, 1) {
        Ok(ratio) => ratio,
        Err(_) => Ratio::ONE,
    };

    #[test]
    fn the_defaults_of_a_drive_with_its_velocity_in_a_ten_thousandth_of_rpm() {
        // 2^20 position units are 360°; 6096h is 600000/1048576, 6097h is 360/600000: the published defaults of AX8000.
        let factors = Factors {
            feed: ratio(1 << 20, 1),
            velocity: ratio(600_000, 1 << 20),
            acceleration: ratio(360, 600_000),
            ..Factors::default()
        };
        let degrees = factors.scale(DEGREES).unwrap();
        assert_eq!(degrees.position(90.0), Ok(1 << 18));
        // 6 °/s are 1 rpm; 1 °/s² is 1 °/s².
        assert_eq!(degrees.velocity(6.0), Ok(10_000));
        assert_eq!(degrees.acceleration(100.0), Ok(100));
    }

    #[test]
    fn a_drive_without_a_feed_constant_counts_encoder_increments() {
        let factors = Factors {
            encoder: ratio(1 << 20, 1),
            gear: ratio(10, 1),
            ..Factors::default()
        };
        let degrees = factors.scale(DEGREES).unwrap();
        assert_eq!(degrees.position(360.0), Ok(10 << 20));
        assert_eq!(degrees.velocity(36.0), Ok(1 << 20));
    }

    #[test]
    fn a_drive_after_version_2_converts_to_increments() {
        // 2^20 increments a revolution, 10 mm a revolution in µm: 6093h is 2^20/10000; velocities in µm/s, accelerations in
        // mm/s².
        let factors = Factors {
            edition: Edition::Version2,
            encoder: ratio(1 << 20, 1),
            position: ratio(1 << 20, 10_000),
            velocity_encoder: ratio(1 << 20, 10_000),
            // Of no meaning here.
            velocity: ratio(7, 3),
            acceleration: ratio(1 << 20, 10),
            ..Factors::default()
        };
        let mm = factors.scale(Ratio::new(10, 1).unwrap()).unwrap();
        assert_eq!(mm.position(1.5), Ok(1_500));
        assert_eq!(mm.velocity(2.0), Ok(2_000));
        assert_eq!(mm.acceleration(2.0), Ok(2));
    }

    #[test]
    fn a_drive_that_tells_nothing_gives_no_scale() {
        let factors = Factors {
            gear: ratio(3, 1),
            ..Factors::default()
        };
        assert_eq!(factors.scale(Ratio::ONE), Err(ScaleError::NoFactors));
        let wide = Factors {
            encoder: ratio((1 << 32) - 1, 1),
            gear: ratio((1 << 32) - 5, (1 << 32) - 17),
            position: ratio((1 << 32) - 45, (1 << 32) - 65),
            ..Factors::default()
        };
        assert_eq!(
            wide.scale(Ratio::new(7, 1 << 31).unwrap()),
            Err(ScaleError::TooLong)
        );
    }
}
