//! Option codes that this library reads or writes: quick stop (605Ah), the other stops (605Bh to 605Eh) and abort connection (6007h);
//! and the windows by which a drive compares its velocity (606Dh to 6070h).

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
/// axis stands. Where [`Traits::threshold_in_velocity_units`](crate::profile_position::Traits::threshold_in_velocity_units) says that 606Fh
/// has the unit of 606Ch, it becomes [`Tolerances::velocity`](crate::axis::Tolerances::velocity).
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
