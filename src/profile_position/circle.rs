//! Positions on the number circle of so many bits, and on a turn of it (pure).
//!
//! Generic over the width: at 8 bits every position, distance and turn is tested. The axis core uses the same code at 32. A position
//! is held as an `i64` and lies on the circle, from −2ᴮᴵᵀˢ⁻¹ to 2ᴮᴵᵀˢ⁻¹ − 1.

/// The number circle of so many bits, at most 32.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Circle<const BITS: u32>;

/// One turn, both ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Turn {
    pub min: i64,
    pub max: i64,
}

impl<const BITS: u32> Circle<BITS> {
    /// The position of the circle that a number falls on: its lowest bits, with their sign.
    #[inline]
    pub const fn of(number: i64) -> i64 {
        let rest = 64 - BITS;
        number.wrapping_shl(rest).wrapping_shr(rest)
    }

    /// How many positions a turn has. There is none where it is empty or one position alone, or the circle itself.
    #[inline]
    pub const fn length(turn: Turn) -> Option<i64> {
        if turn.min >= turn.max {
            return None;
        }
        let length = turn.max - turn.min + 1;
        if length == 1 << BITS {
            None
        } else {
            Some(length)
        }
    }

    /// The position of a turn on which an axis stands that has gone to `position`, turn after turn.
    #[inline]
    pub const fn wrap(turn: Turn, position: i64) -> i64 {
        match Self::length(turn) {
            // No difference of the two fits everywhere; that of their places in the turn does.
            Some(length) => {
                let place = position.rem_euclid(length) - turn.min.rem_euclid(length);
                turn.min + place.rem_euclid(length)
            }
            None => Self::of(position),
        }
    }

    /// The shorter way from one position to another: around the turn, where there is one, else around the circle. Of two that are as
    /// long it is the positive one around a turn, and the negative one around the circle.
    #[inline]
    pub const fn way(turn: Option<Turn>, from: i64, to: i64) -> i64 {
        let length = match turn {
            Some(turn) => Self::length(turn),
            None => None,
        };
        let Some(length) = length else {
            return Self::of(to - from);
        };
        let forward = (to - from).rem_euclid(length);
        if forward > length / 2 {
            forward - length
        } else {
            forward
        }
    }

    /// Where an axis stands that has gone this far from a position.
    #[inline]
    pub const fn after(turn: Option<Turn>, from: i64, distance: i64) -> i64 {
        match turn {
            Some(turn) => Self::wrap(turn, from + distance),
            None => Self::of(from + distance),
        }
    }
}
