//! Modes of operation (6060h, 6061h) and the modes that a drive supports (6502h).

use bitflags::bitflags;

/// A mode of operation, as written to 6060h and shown in 6061h.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Mode {
    /// 0: no mode, no change.
    None,
    /// 1: Profile Position.
    ProfilePosition,
    /// 3: Profile Velocity.
    ProfileVelocity,
    /// 6: Homing.
    Homing,
    /// 8: cyclic synchronous position.
    CyclicPosition,
    /// 9: cyclic synchronous velocity.
    CyclicVelocity,
    /// 10: cyclic synchronous torque.
    CyclicTorque,
    /// Any other number; negative ones are the manufacturer's.
    Other(i8),
}

impl Mode {
    /// The mode that a value of 6060h or 6061h means.
    #[must_use]
    pub const fn from_raw(raw: i8) -> Self {
        match raw {
            0 => Self::None,
            1 => Self::ProfilePosition,
            3 => Self::ProfileVelocity,
            6 => Self::Homing,
            8 => Self::CyclicPosition,
            9 => Self::CyclicVelocity,
            10 => Self::CyclicTorque,
            n => Self::Other(n),
        }
    }

    /// The value of 6060h or 6061h.
    #[must_use]
    pub const fn raw(self) -> i8 {
        match self {
            Self::None => 0,
            Self::ProfilePosition => 1,
            Self::ProfileVelocity => 3,
            Self::Homing => 6,
            Self::CyclicPosition => 8,
            Self::CyclicVelocity => 9,
            Self::CyclicTorque => 10,
            Self::Other(n) => n,
        }
    }
}

impl core::fmt::Display for Mode {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let name = match self {
            Self::None => "mode",
            Self::ProfilePosition => "profile position mode",
            Self::ProfileVelocity => "profile velocity mode",
            Self::Homing => "homing mode",
            Self::CyclicPosition => "cyclic synchronous position mode",
            Self::CyclicVelocity => "cyclic synchronous velocity mode",
            Self::CyclicTorque => "cyclic synchronous torque mode",
            Self::Other(_) => "mode",
        };
        write!(f, "{name} ({})", self.raw())
    }
}

bitflags! {
    /// Supported drive modes, object 6502h. Bit 4 is reserved and bits 16–31 are the manufacturer's.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct SupportedModes: u32 {
        /// Bit 0, Profile Position.
        const PROFILE_POSITION = 1 << 0;
        /// Bit 1, velocity (frequency converters).
        const VELOCITY = 1 << 1;
        /// Bit 2, Profile Velocity.
        const PROFILE_VELOCITY = 1 << 2;
        /// Bit 3, Profile Torque.
        const PROFILE_TORQUE = 1 << 3;
        /// Bit 5, Homing.
        const HOMING = 1 << 5;
        /// Bit 6, interpolated position.
        const INTERPOLATED_POSITION = 1 << 6;
        /// Bit 7, cyclic synchronous position.
        const CYCLIC_POSITION = 1 << 7;
        /// Bit 8, cyclic synchronous velocity.
        const CYCLIC_VELOCITY = 1 << 8;
        /// Bit 9, cyclic synchronous torque.
        const CYCLIC_TORQUE = 1 << 9;
        const _ = !0;
    }
}

impl SupportedModes {
    /// Whether these do not speak against a mode: modes 1 to 16 have a bit each. Of the manufacturer's modes nothing is said,
    /// nor of any mode where no bit is set at all.
    #[must_use]
    pub const fn allows(self, mode: Mode) -> bool {
        match mode.raw() {
            n @ 1..=16 => self.bits() & 0xFFFF == 0 || self.bits() & 1 << (n - 1) != 0,
            _ => true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_of_6061h_survives_the_way_through_the_enum() {
        for raw in i8::MIN..=i8::MAX {
            assert_eq!(Mode::from_raw(raw).raw(), raw);
        }
    }

    #[test]
    fn a_mode_is_spoken_against_by_its_bit_alone() {
        let akd_like = SupportedModes::from_bits_retain(0x0000_03E5);
        for mode in [Mode::ProfilePosition, Mode::ProfileVelocity, Mode::Homing] {
            assert!(akd_like.allows(mode), "{mode}");
            assert!(SupportedModes::empty().allows(mode), "{mode}");
        }
        assert!(!akd_like.allows(Mode::from_raw(4)));
        assert!(akd_like.allows(Mode::from_raw(-3)) && akd_like.allows(Mode::from_raw(40)));
        let manufacturers = SupportedModes::from_bits_retain(0x8000_0000);
        assert!(manufacturers.allows(Mode::Homing));
    }

    #[test]
    fn pitfall_27_the_modes_of_6502h_keep_their_numbers_past_the_reserved_bit_4() {
        // CiA DSP 402 v2.0, object 6502h: bit 4 is reserved, homing is bit 5.
        assert_eq!(SupportedModes::HOMING.bits(), 0x20);
        let akd_like = SupportedModes::from_bits_retain(0x0000_03E5);
        assert!(akd_like.contains(SupportedModes::HOMING | SupportedModes::CYCLIC_TORQUE));
        assert!(!akd_like.contains(SupportedModes::PROFILE_TORQUE));
    }
}
