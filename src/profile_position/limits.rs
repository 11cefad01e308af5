//! Limits that a drive holds, checked before a move is sent. How the drive counts them is its data: [`LimitsRule`].

use crate::coe::{ObjectAddress, obj};

use super::{
    Failure,
    circle::{Circle, Turn},
};

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

/// What a drive's object 2010h is. The makers say what 2000h to 5FFFh hold: other drives have something else there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum MinVelocity {
    /// No min profile velocity: it is not read.
    Absent,
    /// Min profile velocity, and the drive's documents do not name its unit: it is read, and nothing is compared with it.
    UnitUnknown,
    /// Min profile velocity in the unit of profile velocity 6081h: a slower move or jog is refused as [`Failure::TooSlow`].
    AsProfileVelocity,
}

/// How a drive counts its limits, as data: software position limits 607Dh and min profile velocity 2010h.
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
    /// What 2010h is.
    pub min_velocity: MinVelocity,
}

impl LimitsRule {
    /// As CiA DSP 402 has it in 607Dh: less the home offset, and always in force. Limits that are no range are off. There is no 2010h.
    #[must_use]
    pub const fn cia402() -> Self {
        Self {
            off: LimitsOff::MinNotBelowMax,
            less_home_offset: true,
            active: LimitsActive::Always,
            min_velocity: MinVelocity::Absent,
        }
    }
}

/// What an axis' drive holds in its limit objects, or what the program says in their place. Absolute targets and velocities
/// beyond it are refused before anything is written. The end of a relative move is checked when its turn comes: parameters that go by SDO are
/// written by then. Where it is not known what the drive counts from, an axis without a set-point is taken to count from where it is, or from
/// the target before: neither end may lie beyond a limit. A distance on top of a set-point that leads on is not checked then. What is `None` is
/// not checked.
///
/// A [`Network`](crate::Network) reads them when an axis attaches. A program that changes 607Bh, 607Ch, 607Dh, 607Fh or 2010h later
/// has them read again: `Axis::read_limits`.
///
/// ```
/// use servocrab::{AxisConfig, DriveConfig, drives, profile_position::{Limits, PositionRange}};
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
    /// Min profile velocity 2010h, of a drive that has it. [`LimitsRule::min_velocity`] says whether moves and jogs are compared with it.
    /// A profile velocity that is left out is compared where 6081h is in the process data.
    pub min_velocity: Option<u16>,
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
            min_velocity: None,
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
                asked: target,
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
                Err(Failure::BeyondLimit {
                    object: obj::MAX_PROFILE_VELOCITY.address(),
                    limit: limit.into(),
                    asked: velocity.into(),
                })
            }
            _ => Ok(()),
        }
    }

    /// Refuses a velocity of a motion below min profile velocity 2010h. One of 0 moves nothing.
    pub(crate) fn check_least(
        &self,
        velocity: Option<u32>,
        rule: &LimitsRule,
    ) -> Result<(), Failure> {
        let least = self
            .min_velocity
            .filter(|_| rule.min_velocity == MinVelocity::AsProfileVelocity)
            .map_or(0, u32::from);
        match velocity {
            Some(asked) if asked != 0 && asked < least => Err(Failure::TooSlow { asked, least }),
            _ => Ok(()),
        }
    }

    /// Refuses a target velocity of a jog.
    pub(crate) fn check_jog(&self, velocity: i32, rule: &LimitsRule) -> Result<(), Failure> {
        let speed = Some(velocity.unsigned_abs());
        self.check_velocity(speed)?;
        self.check_least(speed, rule)
    }
}

#[cfg(test)]
mod tests {
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
                asked: 701
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
            Err(Failure::BeyondLimit { object, limit: 3_599, asked: 3_600 }) if object.index == 0x607B
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
        let too_fast = Failure::BeyondLimit {
            object: ObjectAddress::new(0x607F, 0),
            limit: 100,
            asked: 101,
        };
        assert_eq!(limits.check_velocity(Some(101)), Err(too_fast));
    }
}
