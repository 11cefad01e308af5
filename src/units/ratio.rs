//! A positive fraction of whole numbers, and its product with a number, rounded once.

use super::ScaleError;

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
    pub(super) fn round(self, value: f64) -> Option<i64> {
        if !value.is_finite() {
            return None;
        }
        let (mantissa, exponent) = split(value);
        // 53 bits times 64.
        let product = u128::from(mantissa) * u128::from(self.numerator);
        let denominator = u128::from(self.denominator);
        let rounded = if exponent >= 0 {
            let shift = exponent.unsigned_abs();
            if product != 0 && shift > product.leading_zeros() {
                return None;
            }
            divide(product.checked_shl(shift).unwrap_or(0), denominator)
        } else {
            let shift = exponent.unsigned_abs();
            if shift > denominator.leading_zeros() {
                // The divisor is 2¹²⁸ or more, the product less than half of that.
                0
            } else {
                divide(product, denominator << shift)
            }
        };
        let magnitude = i64::try_from(rounded).ok()?;
        Some(if value < 0.0 { -magnitude } else { magnitude })
    }

    /// The number nearest to `count` divided by this fraction.
    pub(super) fn divide(self, count: i64) -> f64 {
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
        if count < 0 { -magnitude } else { magnitude }
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
        exponent => (mantissa | 1 << 52, exponent - 1075),
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

#[cfg(test)]
mod tests {
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
