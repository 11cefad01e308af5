//! Bits 4, 5, 6 and 9 of the controlword, which mean something else in each mode: nothing else in this library sets them.

use super::Controlword;

/// Bits 4, 5, 6 and 9 of a controlword. It can hold no others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct ModeBits(Controlword);

/// What a set-point says beside bit 4.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SetPointBits {
    /// Bit 5.
    pub change_set_immediately: bool,
    /// Bit 6.
    pub relative: bool,
    /// Bit 9.
    pub change_on_set_point: bool,
}

impl ModeBits {
    /// Where they are in a controlword.
    pub const MASK: Controlword = Controlword::NEW_SET_POINT
        .union(Controlword::CHANGE_IMMEDIATELY)
        .union(Controlword::RELATIVE)
        .union(Controlword::BLEND);

    pub const NONE: Self = Self(Controlword::empty());

    /// Bit 4 in homing mode.
    pub const HOMING_START: Self = Self(Controlword::HOMING_START);

    /// Bits 5, 6 and 9 in Profile Position mode, with bit 4 low.
    #[inline]
    pub const fn of_set_point(set_point: SetPointBits) -> Self {
        let immediately = only(
            set_point.change_set_immediately,
            Controlword::CHANGE_IMMEDIATELY,
        );
        let relative = only(set_point.relative, Controlword::RELATIVE);
        let on_set_point = only(set_point.change_on_set_point, Controlword::BLEND);
        Self(immediately.union(relative).union(on_set_point))
    }

    /// The same with bit 4, new set-point.
    #[inline]
    pub const fn with_new_set_point(self) -> Self {
        Self(self.0.union(Controlword::NEW_SET_POINT))
    }

    #[inline]
    pub const fn is_empty(self) -> bool {
        self.0.is_empty()
    }

    /// As they are in a controlword.
    #[inline]
    pub const fn word(self) -> Controlword {
        self.0
    }
}

/// These bits, if they are to be set.
const fn only(set: bool, bits: Controlword) -> Controlword {
    if set { bits } else { Controlword::empty() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_bit_of_a_set_point_is_where_the_standard_has_it_and_no_other_is_set() {
        for choice in 0..8_u16 {
            let bits = ModeBits::of_set_point(SetPointBits {
                change_set_immediately: choice & 1 != 0,
                relative: choice & 2 != 0,
                change_on_set_point: choice & 4 != 0,
            });
            let expected = (choice & 3) << 5 | (choice & 4) << 7;
            assert_eq!(bits.word().bits(), expected, "{choice}");
            let rising = bits.with_new_set_point().word();
            assert_eq!(rising.bits(), expected | 0x0010, "{choice}");
        }
        assert_eq!(ModeBits::HOMING_START.word().bits(), 0x0010);
        assert_eq!(ModeBits::MASK.bits(), 0x0270);
    }
}
