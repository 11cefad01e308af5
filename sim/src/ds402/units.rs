//! Between the values of objects and the axis: factors of velocity and acceleration, the highest motor speed, polarity.
//!
//! The axis counts in its own coordinates, which polarity does not turn and which never wrap.

use super::axis::Axis;
use super::entries::TURN;
use super::objects::{self, Address, Objects};

/// Encoder increments of one unit of position, increments/s of one of velocity, increments/s² of one of acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct UnitSizes {
    position: f64,
    velocity: f64,
    acceleration: f64,
}

const POSITIONS: [Address; 8] = [
    objects::FOLLOWING_WINDOW,
    objects::POSITION_WINDOW,
    objects::TARGET_POSITION,
    objects::RANGE_MIN,
    objects::RANGE_MAX,
    objects::HOME_OFFSET,
    objects::LIMIT_MIN,
    objects::LIMIT_MAX,
];
const VELOCITIES: [Address; 8] = [
    objects::VELOCITY_WINDOW,
    objects::VELOCITY_THRESHOLD,
    objects::MAX_PROFILE_VELOCITY,
    objects::PROFILE_VELOCITY,
    objects::END_VELOCITY,
    objects::HOMING_SPEED_SWITCH,
    objects::HOMING_SPEED_ZERO,
    objects::TARGET_VELOCITY,
];
const ACCELERATIONS: [Address; 6] = [
    objects::PROFILE_ACCELERATION,
    objects::PROFILE_DECELERATION,
    objects::QUICK_STOP_DECELERATION,
    objects::HOMING_ACCELERATION,
    objects::MAX_ACCELERATION,
    objects::MAX_DECELERATION,
];

impl Objects {
    pub(super) fn unit_sizes(&self) -> UnitSizes {
        let encoder = self.ratio(objects::ENCODER_INCREMENTS, objects::ENCODER_REVOLUTIONS);
        let gear = self.ratio(objects::GEAR_MOTOR, objects::GEAR_SHAFT);
        let feed = self.ratio(objects::FEED, objects::FEED_SHAFT);
        let position = encoder * gear / feed * self.increments();
        UnitSizes {
            position,
            velocity: position * self.velocity_unit(),
            acceleration: position * self.acceleration_unit(),
        }
    }

    fn convert(&mut self, address: Address, times: f64) {
        let Some(entry) = self.entries().iter().find(|one| one.address() == address) else {
            return;
        };
        let (min, max) = (entry.min, entry.max);
        let value = self.value(address);
        if value != min && value != max {
            let converted = (value as f64 * times).round() as i64;
            self.put(address, converted.clamp(min, max));
        }
    }

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
    /// Shows what the drive holds in the units of its factors as they are now. An axis without power stands where it stood; what is fixed to
    /// its machine stays in counts.
    pub(super) fn convert_from(&mut self, before: UnitSizes) {
        let now = self.objects.unit_sizes();
        if now == before {
            return;
        }
        let times = before.position / now.position;
        for address in POSITIONS {
            self.objects.convert(address, times);
        }
        for address in VELOCITIES {
            let times = before.velocity / now.velocity;
            self.objects.convert(address, times);
        }
        for address in ACCELERATIONS {
            let times = before.acceleration / now.acceleration;
            self.objects.convert(address, times);
        }
        self.place((self.position() as f64 * times).round() as i64);
    }

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
