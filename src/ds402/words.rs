//! Statusword 6041h, controlword 6040h, and the states that a statusword shows.
//!
//! Source of the masks: CiA DSP 402 v2.0, table 7 (statusword patterns) and table 4 (device control commands).

use bitflags::bitflags;

bitflags! {
    /// The statusword (object 6041h; 6841h for a second axis).
    ///
    /// ```
    /// use servocrab::ds402::{State, Statusword};
    /// let word = Statusword::from_bits_retain(0x1637);
    /// assert_eq!(word.state(), State::OperationEnabled);
    /// assert!(word.contains(Statusword::TARGET_REACHED | Statusword::SET_POINT_ACKNOWLEDGE));
    /// ```
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct Statusword: u16 {
        /// Bit 0, ready to switch on.
        const READY_TO_SWITCH_ON = 1 << 0;
        /// Bit 1, switched on.
        const SWITCHED_ON = 1 << 1;
        /// Bit 2, operation enabled.
        const OPERATION_ENABLED = 1 << 2;
        /// Bit 3, fault.
        const FAULT = 1 << 3;
        /// Bit 4, voltage enabled: the power stage has its supply. Independent of the state.
        const VOLTAGE_ENABLED = 1 << 4;
        /// Bit 5, quick stop, active low.
        const QUICK_STOP = 1 << 5;
        /// Bit 6, switch on disabled.
        const SWITCH_ON_DISABLED = 1 << 6;
        /// Bit 7, warning.
        const WARNING = 1 << 7;
        /// Bit 8, manufacturer specific.
        const MANUFACTURER_8 = 1 << 8;
        /// Bit 9, remote: 0 means local control, the controlword is ignored.
        const REMOTE = 1 << 9;
        /// Bit 10, target reached; with halt set: velocity is zero.
        const TARGET_REACHED = 1 << 10;
        /// Bit 11, internal limit active.
        const INTERNAL_LIMIT = 1 << 11;
        /// Bit 12 in Profile Position mode: set-point acknowledge.
        const SET_POINT_ACKNOWLEDGE = 1 << 12;
        /// Bit 12 in homing mode: homing attained.
        const HOMING_ATTAINED = 1 << 12;
        /// Bit 13 in homing mode: homing error.
        const HOMING_ERROR = 1 << 13;
        /// Bit 13 in Profile Position mode: following error.
        const FOLLOWING_ERROR = 1 << 13;
        /// Bit 14, manufacturer specific.
        const MANUFACTURER_14 = 1 << 14;
        /// Bit 15, manufacturer specific.
        const MANUFACTURER_15 = 1 << 15;
    }
}

impl core::fmt::Display for Statusword {
    /// As the standard writes it: `0637h`.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:04X}h", self.bits())
    }
}

bitflags! {
    /// The controlword (object 6040h; 6840h for a second axis).
    ///
    /// Each bit has one owner in this library: the power sequencing owns bits 0–3 and 7, the active mode owns 4, 5, 6
    /// and 9, stopping owns 8, and the user owns 11–15.
    ///
    /// ```
    /// use servocrab::ds402::Controlword;
    /// let start = Controlword::ENABLE_OPERATION | Controlword::NEW_SET_POINT;
    /// assert_eq!(start.bits(), 0x001F);
    /// ```
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct Controlword: u16 {
        /// Bit 0, switch on.
        const BIT_SWITCH_ON = 1 << 0;
        /// Bit 1, enable voltage (0 disables).
        const BIT_ENABLE_VOLTAGE = 1 << 1;
        /// Bit 2, quick stop, active low.
        const BIT_QUICK_STOP = 1 << 2;
        /// Bit 3, enable operation.
        const BIT_ENABLE_OPERATION = 1 << 3;
        /// Bit 4 in Profile Position mode: new set-point, taken at its rising edge.
        const NEW_SET_POINT = 1 << 4;
        /// Bit 4 in homing mode: homing operation start, held until the end.
        const HOMING_START = 1 << 4;
        /// Bit 5 in Profile Position mode: change set immediately.
        const CHANGE_IMMEDIATELY = 1 << 5;
        /// Bit 6 in Profile Position mode: 0 absolute, 1 relative.
        const RELATIVE = 1 << 6;
        /// Bit 7, fault reset, taken at its rising edge.
        const FAULT_RESET = 1 << 7;
        /// Bit 8, halt.
        const HALT = 1 << 8;
        /// Bit 9 in Profile Position mode: change on set-point (blend).
        const BLEND = 1 << 9;
        /// Bits 11–15, manufacturer specific: the user's.
        const MANUFACTURER = 0xF800;
        /// The command Disable voltage.
        const DISABLE_VOLTAGE = 0x0000;
        /// The command Shutdown.
        const SHUTDOWN = 0x0006;
        /// The command Switch on, which is Disable operation when sent in Operation enabled.
        const SWITCH_ON = 0x0007;
        /// The command Enable operation.
        const ENABLE_OPERATION = 0x000F;
        const _ = !0;
    }
}

impl core::fmt::Display for Controlword {
    /// As the standard writes it: `001Fh`.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:04X}h", self.bits())
    }
}

/// A state of the DS402 state machine, as a statusword shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// Initialising; the drive leaves it by itself.
    NotReadyToSwitchOn,
    /// Power must not be switched on; the state after start and after most stops.
    SwitchOnDisabled,
    /// Power may be switched on.
    ReadyToSwitchOn,
    /// Power is on, set-points are not followed.
    SwitchedOn,
    /// Set-points are followed.
    OperationEnabled,
    /// Stopping by quick stop, or holding after it (605Ah 5 to 8).
    QuickStopActive,
    /// Stopping because of a fault (605Eh).
    FaultReactionActive,
    /// A fault is stored; only a reset leads out.
    Fault,
    /// The bits are those of no state (never sent by a drive that keeps to DS402).
    Unknown,
}

impl Statusword {
    /// The state that the word shows, by mask and value; bits outside the mask are of no meaning for it.
    #[must_use]
    #[inline]
    pub const fn state(self) -> State {
        // One match, which becomes a table. In the first four the mask is 004Fh: bit 5 is of no meaning.
        match self.bits() & 0x006F {
            0x0000 | 0x0020 => State::NotReadyToSwitchOn,
            0x0040 | 0x0060 => State::SwitchOnDisabled,
            0x000F | 0x002F => State::FaultReactionActive,
            0x0008 | 0x0028 => State::Fault,
            0x0021 => State::ReadyToSwitchOn,
            0x0023 => State::SwitchedOn,
            0x0027 => State::OperationEnabled,
            0x0007 => State::QuickStopActive,
            _ => State::Unknown,
        }
    }
}

impl State {
    /// Whether the drive has or may have stored a fault: Fault and Fault reaction active.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        matches!(self, Self::Fault | Self::FaultReactionActive)
    }
}

impl core::fmt::Display for State {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotReadyToSwitchOn => "Not ready to switch on",
            Self::SwitchOnDisabled => "Switch on disabled",
            Self::ReadyToSwitchOn => "Ready to switch on",
            Self::SwitchedOn => "Switched on",
            Self::OperationEnabled => "Operation enabled",
            Self::QuickStopActive => "Quick stop active",
            Self::FaultReactionActive => "Fault reaction active",
            Self::Fault => "Fault",
            Self::Unknown => "no DS402 state",
        })
    }
}
