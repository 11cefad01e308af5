//! Modes of operation (6060h, 6061h) and the modes that a drive supports (6502h).

use bitflags::bitflags;

/// A mode of operation, as written to 6060h and shown in 6061h.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
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

impl core::fmt::Display for SupportedModes {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let named = (1..=16_i8).filter(|mode| self.bits() & 1 << (mode - 1) != 0);
        let mut before = "";
        for mode in named {
            write!(f, "{before}{}", Mode::from_raw(mode))?;
            before = ", ";
        }
        if before.is_empty() {
            f.write_str("no mode")?;
        }
        Ok(())
    }
}

// Option codes that this library reads or writes: quick stop (605Ah), the other stops (605Bh to 605Eh) and abort connection (6007h);
// and the windows by which a drive compares its velocity (606Dh to 6070h).

/// Quick stop option code, object 605Ah: how the drive stops at quick stop and where it ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct QuickStopOption(pub i16);

impl QuickStopOption {
    /// Whether the drive stays in Quick stop active after standstill: values 5 to 8 (CiA DSP 402 v2.0, object 605Ah).
    #[must_use]
    pub const fn stays_in_quick_stop_active(self) -> bool {
        matches!(self.0, 5..=8)
    }

    /// Whether the drive stops on a ramp or at a limit; 0 switches the power stage off at once and the axis coasts.
    #[must_use]
    pub const fn stops_under_control(self) -> bool {
        !matches!(self.0, 0)
    }
}

/// The other option codes of stops, 605Bh to 605Eh, as read from a drive; none where it has no such object.
///
/// ```
/// use servocrab::ds402::StopOptions;
/// let options = StopOptions { halt: Some(0), ..StopOptions::default() };
/// assert!(!options.halts_under_control());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct StopOptions {
    /// Shutdown option code 605Bh: what 06h does in Operation enabled, by which a standing axis is disabled. 0 cuts the power at once, 1 after
    /// a ramp.
    pub shutdown: Option<i16>,
    /// Disable operation option code 605Ch: the same for 07h, which this library does not send in Operation enabled.
    pub disable_operation: Option<i16>,
    /// Halt option code 605Dh: how the drive stops at bit 8.
    pub halt: Option<i16>,
    /// Fault reaction option code 605Eh: how the drive stops at a fault. 0 lets the axis coast.
    pub fault_reaction: Option<i16>,
}

impl StopOptions {
    /// Whether bit 8 stops the axis on a ramp or at a limit; with 605Dh = 0 the drive lets it coast.
    #[must_use]
    pub const fn halts_under_control(self) -> bool {
        !matches!(self.halt, Some(0))
    }
}

/// The windows and times by which a drive compares its velocity in Profile Velocity mode, 606Dh to 6070h, as read from it; none where it
/// has no such object, or one of another size. Drives differ in their units and in what 6070h means, so that none of them decides whether an
/// axis stands: they are shown.
///
/// ```
/// use servocrab::ds402::VelocityWindows;
/// let held = VelocityWindows { threshold: Some(50), ..VelocityWindows::default() };
/// assert_eq!(held.window, None);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct VelocityWindows {
    /// Velocity window 606Dh around the target velocity, in the drive's own unit.
    pub window: Option<u16>,
    /// Velocity window time 606Eh, in milliseconds.
    pub window_ms: Option<u16>,
    /// Velocity threshold 606Fh of "speed is zero", in the drive's own unit.
    pub threshold: Option<u16>,
    /// Velocity threshold time 6070h, in milliseconds.
    pub threshold_ms: Option<u16>,
}

/// How far an axis may be behind its demand before its drive has a fault (8611h), as the drive holds it.
///
/// ```
/// use servocrab::ds402::FollowingErrorWindow;
/// let held = FollowingErrorWindow { window: Some(5_000), time_out_ms: Some(10) };
/// assert_ne!(held, FollowingErrorWindow::default());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FollowingErrorWindow {
    /// Following error window 6065h, in position units. FFFFFFFFh switches the watch off.
    pub window: Option<u32>,
    /// Following error time out 6066h: a following error beyond the window is a fault after so many milliseconds.
    pub time_out_ms: Option<u16>,
}

/// Abort connection option code, object 6007h (6807h): what an axis does when the process data stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum AbortConnection {
    /// 0: nothing. The axis would go on moving.
    NoAction,
    /// 1: a fault; the drive stops by its fault reaction (605Eh).
    Malfunction,
    /// 2: Disable voltage; the axis coasts.
    DisableVoltage,
    /// 3: Quick stop (605Ah).
    QuickStop,
    /// Any other number.
    Other(i16),
}

impl AbortConnection {
    /// The meaning of a value of 6007h.
    #[must_use]
    pub const fn from_raw(raw: i16) -> Self {
        match raw {
            0 => Self::NoAction,
            1 => Self::Malfunction,
            2 => Self::DisableVoltage,
            3 => Self::QuickStop,
            n => Self::Other(n),
        }
    }

    /// The value of 6007h.
    #[must_use]
    pub const fn raw(self) -> i16 {
        match self {
            Self::NoAction => 0,
            Self::Malfunction => 1,
            Self::DisableVoltage => 2,
            Self::QuickStop => 3,
            Self::Other(n) => n,
        }
    }

    /// Whether an axis with this value is sure to stop when the process data stop.
    #[must_use]
    pub const fn stops(self) -> bool {
        matches!(
            self,
            Self::Malfunction | Self::DisableVoltage | Self::QuickStop
        )
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
    fn each_of_sixteen_modes_has_its_bit() {
        for bit in 0..16 {
            let one = SupportedModes::from_bits_retain(1 << bit | 0xFFFF_0000);
            for raw in 1..=16 {
                let mode = Mode::from_raw(raw);
                assert_eq!(one.allows(mode), i32::from(raw) == bit + 1, "{bit}, {raw}");
            }
            for raw in [i8::MIN, -1, 0, 17, i8::MAX] {
                assert!(one.allows(Mode::from_raw(raw)), "{bit}, {raw}");
            }
        }
    }

    #[test]
    fn option_codes_say_where_a_stop_ends_and_whether_it_is_under_control() {
        for code in -1..=9 {
            let option = QuickStopOption(code);
            let stays = (5..=8).contains(&code);
            assert_eq!(option.stays_in_quick_stop_active(), stays, "{code}");
            assert_eq!(option.stops_under_control(), code != 0, "{code}");
            let options = StopOptions {
                halt: Some(code),
                ..StopOptions::default()
            };
            assert_eq!(options.halts_under_control(), code != 0, "{code}");
        }
        assert!(StopOptions::default().halts_under_control());
    }

    #[test]
    fn an_axis_is_sure_to_stop_by_three_values_of_6007h() {
        for raw in -1..=5 {
            let option = AbortConnection::from_raw(raw);
            assert_eq!(option.raw(), raw);
            assert_eq!(option.stops(), (1..=3).contains(&raw), "{raw}");
        }
        assert_eq!(AbortConnection::from_raw(3), AbortConnection::QuickStop);
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
