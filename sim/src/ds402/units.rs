//! Between the values of objects and the axis: factors of velocity and acceleration, the highest motor speed, polarity.
//!
//! The axis counts in its own coordinates, which polarity does not turn and which never wrap.

use super::axis::Axis;
use super::entries::TURN;
use super::objects::{self, Address, Objects};

impl Objects {
    /// Counts/s of one unit of velocity. 6096h says how many units one count/s is (IEC 61800-7-201); DSP 402 v2 gives
    /// increments in 6093h for a position unit and in 6094h for a velocity unit.
    fn velocity_unit(&self) -> f64 {
        if self.has(objects::VELOCITY_NUMERATOR) {
            self.ratio(objects::VELOCITY_DIVISOR, objects::VELOCITY_NUMERATOR)
        } else {
            let increments = self.ratio(
                objects::VELOCITY_ENCODER_NUMERATOR,
                objects::VELOCITY_ENCODER_DIVISOR,
            );
            increments / self.increments()
        }
    }

    /// Counts/s² of one unit of acceleration. 6097h says how many units one unit of velocity a second is; in DSP 402 v2
    /// it gives the increments/s² of one unit.
    fn acceleration_unit(&self) -> f64 {
        let (numerator, divisor) = (
            objects::ACCELERATION_NUMERATOR,
            objects::ACCELERATION_DIVISOR,
        );
        if self.has(objects::VELOCITY_NUMERATOR) {
            self.ratio(divisor, numerator) * self.velocity_unit()
        } else {
            self.ratio(numerator, divisor) / self.increments()
        }
    }

    /// Encoder increments of one position unit, by 6093h.
    pub(super) fn increments(&self) -> f64 {
        self.ratio(objects::POSITION_NUMERATOR, objects::POSITION_DIVISOR)
    }

    /// Position units of one turn of the motor: by feed constant and gear, or by the position factor.
    fn turn(&self) -> f64 {
        if self.has(objects::FEED) {
            self.ratio(objects::FEED, objects::FEED_SHAFT)
                * self.ratio(objects::GEAR_SHAFT, objects::GEAR_MOTOR)
        } else {
            TURN as f64 / self.increments()
        }
    }

    fn has(&self, address: Address) -> bool {
        self.get(address).is_some()
    }

    /// One object over another; one that the drive does not have counts as 1.
    fn ratio(&self, over: Address, under: Address) -> f64 {
        let value = |address| self.get(address).unwrap_or(1).max(1) as f64;
        value(over) / value(under)
    }

    /// A velocity object in counts/s.
    pub(super) fn velocity(&self, address: Address) -> f64 {
        self.value(address) as f64 * self.velocity_unit()
    }

    /// A velocity in counts/s as a velocity object shows it.
    pub(super) fn shown_velocity(&self, velocity: f64) -> i64 {
        (velocity / self.velocity_unit()).round() as i64
    }

    /// An acceleration object in counts/s².
    pub(super) fn acceleration(&self, address: Address) -> f64 {
        self.value(address) as f64 * self.acceleration_unit()
    }

    /// An acceleration object within another that limits it, in counts/s².
    pub(super) fn acceleration_within(&self, address: Address, limit: Address) -> f64 {
        self.value(address).min(self.limit(limit)) as f64 * self.acceleration_unit()
    }

    /// The most that 607Fh (velocity units) and 6080h (turns of the motor a minute, DSP 402 v2) allow, in counts/s.
    pub(super) fn highest_velocity(&self) -> f64 {
        let profile = self.limit(objects::MAX_PROFILE_VELOCITY) as f64 * self.velocity_unit();
        let motor = self.limit(objects::MAX_MOTOR_SPEED) as f64 / 60.0 * self.turn();
        profile.min(motor)
    }
}

impl Axis {
    /// A position of the axis as the master counts it, or one of the master's as the axis counts it: bit 7 of 607Eh
    /// turns the sign.
    pub(super) fn turned(&self, position: i64) -> i64 {
        if self.objects.value(objects::POLARITY) & 0x80 == 0 {
            position
        } else {
            position.saturating_neg()
        }
    }

    /// The same for a velocity, by bit 6 of 607Eh.
    pub(super) fn turned_velocity(&self, velocity: f64) -> f64 {
        if self.objects.value(objects::POLARITY) & 0x40 == 0 {
            velocity
        } else {
            -velocity
        }
    }
}
