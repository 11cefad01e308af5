//! The factor objects of a drive, and the scale that they make.

use super::{Ratio, Scale, ScaleError};

/// What a drive's factor objects hold; read by [`Axis::factors`](crate::axis::Axis::factors), or written down by a program.
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
