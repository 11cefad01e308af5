//! Homing methods, object 6098h.

/// How the drive looks for its home position: the value of object 6098h (CiA DSP 402 v2.0, 13.4; CiA 402-2 for 37).
/// Which of them a drive has is in its manual; it refuses others by SDO abort.
///
/// ```
/// use servocrab::homing::HomingMethod;
/// assert_eq!(HomingMethod(37), HomingMethod::CURRENT_POSITION);
/// assert!(!HomingMethod::NEGATIVE_LIMIT.is_motionless());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct HomingMethod(
    /// The number: 1 to 37 are the standard's, negative ones the manufacturer's.
    pub i8,
);

impl HomingMethod {
    /// 1: to the negative limit switch, then to the first index pulse on its positive side.
    pub const NEGATIVE_LIMIT_AND_INDEX: Self = Self(1);
    /// 2: to the positive limit switch, then to the first index pulse on its negative side.
    pub const POSITIVE_LIMIT_AND_INDEX: Self = Self(2);
    /// 17: the edge of the negative limit switch.
    pub const NEGATIVE_LIMIT: Self = Self(17);
    /// 18: the edge of the positive limit switch.
    pub const POSITIVE_LIMIT: Self = Self(18);
    /// 33: the next index pulse in negative direction.
    pub const INDEX_NEGATIVE: Self = Self(33);
    /// 34: the next index pulse in positive direction.
    pub const INDEX_POSITIVE: Self = Self(34);
    /// 35: where the axis stands is home, in drives after the older editions. Nothing moves.
    pub const CURRENT_POSITION_OLD: Self = Self(35);
    /// 37: where the axis stands is home. Nothing moves.
    pub const CURRENT_POSITION: Self = Self(37);

    /// Whether the method takes the position as it is: 35 and 37.
    #[must_use]
    pub const fn is_motionless(self) -> bool {
        matches!(self, Self::CURRENT_POSITION_OLD | Self::CURRENT_POSITION)
    }
}
