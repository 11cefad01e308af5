//! Statusword 6041h, controlword 6040h, and the states that a statusword shows.
//!
//! Source of the masks: CiA DSP 402 v2.0, table 7 (statusword patterns) and table 4 (device control commands).

use bitflags::bitflags;

use super::Mode;

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

impl Statusword {
    /// Whether bit 13 is set and means a following error: in Profile Position and in cyclic synchronous position. `mode` is that of
    /// 6061h.
    ///
    /// ```
    /// use servocrab::ds402::{Mode, Statusword};
    /// let word = Statusword::from_bits_retain(0x2218);
    /// assert!(word.shows_following_error(Mode::ProfilePosition));
    /// assert!(!word.shows_following_error(Mode::Homing)); // a homing error
    /// ```
    #[must_use]
    pub const fn shows_following_error(self, mode: Mode) -> bool {
        matches!(mode, Mode::ProfilePosition | Mode::CyclicPosition)
            && self.contains(Self::FOLLOWING_ERROR)
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

/// As its number.
#[cfg(feature = "serde")]
impl serde::Serialize for Statusword {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u16(self.bits())
    }
}

/// As its number.
#[cfg(feature = "serde")]
impl serde::Serialize for Controlword {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u16(self.bits())
    }
}

/// A state of the DS402 state machine, as a statusword shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
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

    /// Whether the drive moves the axis or holds it: Operation enabled, Quick stop active and Fault reaction active.
    #[must_use]
    pub const fn holds_axis(self) -> bool {
        matches!(
            self,
            Self::OperationEnabled | Self::QuickStopActive | Self::FaultReactionActive
        )
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

// Power sequencing: which command leads from the state just seen towards a goal.

/// Where the power sequencing is to lead.
///
/// ```
/// use servocrab::ds402::{PowerCommand, PowerGoal, State, next_command};
/// let next = next_command(State::SwitchOnDisabled, PowerGoal::Enabled);
/// assert_eq!(next, PowerCommand::Shutdown);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PowerGoal {
    /// Voltage disabled: Switch on disabled.
    Off,
    /// Ready to switch on, power off; from Operation enabled by shutdown (605Bh).
    Ready,
    /// Operation enabled.
    Enabled,
}

/// A command of bits 0–3 and 7 of the controlword.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PowerCommand {
    /// Bits x x 0 x: transitions 7, 9, 10, 12.
    DisableVoltage,
    /// 06h: transitions 2, 6, 8.
    Shutdown,
    /// 07h: transition 3, or 5 from Operation enabled.
    SwitchOn,
    /// 0Fh: transition 4.
    EnableOperation,
    /// Bit 2 low: transitions 7, 10, 11. Sent with bits 0, 1 and 3 as in Operation enabled (0Bh).
    QuickStop,
    /// Bit 7: transition 15 at its rising edge.
    FaultReset,
}

impl PowerCommand {
    /// The command's bits; no others are set.
    ///
    /// ```
    /// use servocrab::ds402::PowerCommand;
    /// assert_eq!(PowerCommand::QuickStop.controlword().bits(), 0x000B);
    /// ```
    #[must_use]
    pub const fn controlword(self) -> Controlword {
        Controlword::from_bits_retain(match self {
            Self::DisableVoltage => 0x0000,
            Self::Shutdown => 0x0006,
            Self::SwitchOn => 0x0007,
            Self::EnableOperation => 0x000F,
            Self::QuickStop => 0x000B,
            Self::FaultReset => 0x0080,
        })
    }
}

/// The command that leads from `state` one step towards `goal`.
///
/// The step after it is chosen from the next statusword, never sent blindly. Quick stop active is always left by
/// disabling the voltage, since not every drive knows transition 16. Nothing here resets a fault: in Fault the bits stay 0.
#[must_use]
pub const fn next_command(state: State, goal: PowerGoal) -> PowerCommand {
    match (goal, state) {
        (PowerGoal::Enabled, State::OperationEnabled | State::SwitchedOn) => {
            PowerCommand::EnableOperation
        }
        (PowerGoal::Enabled, State::ReadyToSwitchOn) => PowerCommand::SwitchOn,
        (PowerGoal::Enabled, State::SwitchOnDisabled)
        | (
            PowerGoal::Ready,
            State::SwitchOnDisabled
            | State::ReadyToSwitchOn
            | State::SwitchedOn
            | State::OperationEnabled,
        ) => PowerCommand::Shutdown,
        (PowerGoal::Off, _)
        | (
            _,
            State::NotReadyToSwitchOn
            | State::QuickStopActive
            | State::FaultReactionActive
            | State::Fault
            | State::Unknown,
        ) => PowerCommand::DisableVoltage,
    }
}

// Digital inputs and outputs and the touch probes: named bits of CiA 402-2.

bitflags! {
    /// Digital inputs (object 60FDh). Bits 16 to 31 are the manufacturer's.
    ///
    /// ```
    /// use servocrab::ds402::DigitalInputs;
    /// let inputs = DigitalInputs::from_bits_retain(0x0001_0004);
    /// assert!(inputs.contains(DigitalInputs::HOME_SWITCH));
    /// assert!(!inputs.intersects(DigitalInputs::NEGATIVE_LIMIT_SWITCH | DigitalInputs::POSITIVE_LIMIT_SWITCH));
    /// ```
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct DigitalInputs: u32 {
        /// Bit 0, negative limit switch.
        const NEGATIVE_LIMIT_SWITCH = 1 << 0;
        /// Bit 1, positive limit switch.
        const POSITIVE_LIMIT_SWITCH = 1 << 1;
        /// Bit 2, home switch.
        const HOME_SWITCH = 1 << 2;
        /// Bit 3, interlock.
        const INTERLOCK = 1 << 3;
    }
}

bitflags! {
    /// Physical outputs (object 60FEh:1; the same bits in the mask 60FEh:2 enable them). Bits 16 to 31 are the manufacturer's.
    ///
    /// ```
    /// use servocrab::ds402::DigitalOutputs;
    /// assert_eq!(DigitalOutputs::SET_BRAKE.bits(), 1);
    /// ```
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct DigitalOutputs: u32 {
        /// Bit 0, set brake.
        const SET_BRAKE = 1 << 0;
    }
}

/// A digital input of the axis, a bit of 60FDh by its name.
///
/// ```
/// use servocrab::ds402::{DigitalInput, DigitalInputs};
/// assert_eq!(DigitalInput::HomeSwitch.mask(), Some(DigitalInputs::HOME_SWITCH.bits()));
/// assert_eq!(DigitalInput::Bit(16).mask(), Some(0x0001_0000));
/// assert_eq!(DigitalInput::Bit(32).mask(), None);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DigitalInput {
    /// Bit 0.
    NegativeLimitSwitch,
    /// Bit 1.
    PositiveLimitSwitch,
    /// Bit 2.
    HomeSwitch,
    /// Bit 3.
    Interlock,
    /// Any bit, 0 to 31. The manufacturer's are 16 to 31, where the drive's manual says what each is; some drives have inputs in 4 to 15.
    Bit(u8),
}

impl DigitalInput {
    /// Its bit in 60FDh; none of a number above 31.
    #[must_use]
    pub const fn mask(self) -> Option<u32> {
        let number = match self {
            Self::NegativeLimitSwitch => 0,
            Self::PositiveLimitSwitch => 1,
            Self::HomeSwitch => 2,
            Self::Interlock => 3,
            Self::Bit(number) => number,
        };
        1u32.checked_shl(number as u32)
    }
}

/// A digital output of the axis, a bit of 60FEh by its name.
///
/// ```
/// use servocrab::ds402::{DigitalOutput, DigitalOutputs};
/// assert_eq!(DigitalOutput::SetBrake.mask(), Some(DigitalOutputs::SET_BRAKE.bits()));
/// assert_eq!(DigitalOutput::Bit(31).mask(), Some(0x8000_0000));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DigitalOutput {
    /// Bit 0, set brake: 1 closes it.
    SetBrake,
    /// Any bit, 0 to 31. The manufacturer's are 16 to 31, where the drive's manual says what each is.
    Bit(u8),
}

impl DigitalOutput {
    /// Its bit in 60FEh:1, and in the mask 60FEh:2; none of a number above 31.
    #[must_use]
    pub const fn mask(self) -> Option<u32> {
        match self {
            Self::SetBrake => Some(1),
            Self::Bit(number) => 1u32.checked_shl(number as u32),
        }
    }
}

bitflags! {
    /// Touch probe function (object 60B8h).
    ///
    /// ```
    /// use servocrab::ds402::TouchProbeFunction;
    /// let once = TouchProbeFunction::ENABLE_1 | TouchProbeFunction::POSITIVE_EDGE_1;
    /// assert_eq!(once.bits(), 0x0011);
    /// ```
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct TouchProbeFunction: u16 {
        /// Bit 0, touch probe 1 enabled.
        const ENABLE_1 = 1 << 0;
        /// Bit 1, touch probe 1: each event; else the first one only.
        const CONTINUOUS_1 = 1 << 1;
        /// Bit 2, touch probe 1: the encoder's zero pulse; else the probe's input.
        const ZERO_PULSE_1 = 1 << 2;
        /// Bit 3, touch probe 1: the source that 60D0h:1 names.
        const OTHER_SOURCE_1 = 1 << 3;
        /// Bit 4, touch probe 1: samples at the positive edge.
        const POSITIVE_EDGE_1 = 1 << 4;
        /// Bit 5, touch probe 1: samples at the negative edge.
        const NEGATIVE_EDGE_1 = 1 << 5;
        /// Bit 8, touch probe 2 enabled.
        const ENABLE_2 = 1 << 8;
        /// Bit 9, touch probe 2: each event; else the first one only.
        const CONTINUOUS_2 = 1 << 9;
        /// Bit 10, touch probe 2: the encoder's zero pulse; else the probe's input.
        const ZERO_PULSE_2 = 1 << 10;
        /// Bit 11, touch probe 2: the source that 60D0h:2 names.
        const OTHER_SOURCE_2 = 1 << 11;
        /// Bit 12, touch probe 2: samples at the positive edge.
        const POSITIVE_EDGE_2 = 1 << 12;
        /// Bit 13, touch probe 2: samples at the negative edge.
        const NEGATIVE_EDGE_2 = 1 << 13;
    }
}

bitflags! {
    /// Touch probe status (object 60B9h).
    ///
    /// ```
    /// use servocrab::ds402::TouchProbeStatus;
    /// let status = TouchProbeStatus::from_bits_retain(0x0003);
    /// assert!(status.contains(TouchProbeStatus::POSITIVE_STORED_1));
    /// ```
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct TouchProbeStatus: u16 {
        /// Bit 0, touch probe 1 is enabled.
        const ENABLED_1 = 1 << 0;
        /// Bit 1, touch probe 1: 60BAh holds the position of a positive edge.
        const POSITIVE_STORED_1 = 1 << 1;
        /// Bit 2, touch probe 1: 60BBh holds the position of a negative edge.
        const NEGATIVE_STORED_1 = 1 << 2;
        /// Bit 8, touch probe 2 is enabled.
        const ENABLED_2 = 1 << 8;
        /// Bit 9, touch probe 2: 60BCh holds the position of a positive edge.
        const POSITIVE_STORED_2 = 1 << 9;
        /// Bit 10, touch probe 2: 60BDh holds the position of a negative edge.
        const NEGATIVE_STORED_2 = 1 << 10;
    }
}

// Bits 4, 5, 6 and 9 of the controlword, which mean something else in each mode. Nothing outside of this module can set them.

pub(super) mod mode_bits {
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
}

// What one cycle's inputs show of an axis.

/// What one cycle's inputs show of an axis.
///
/// ```
/// use servocrab::ds402::{Mode, Sample, State, Statusword};
/// let sample = Sample {
///     statusword: Statusword::from_bits_retain(0x0237),
///     mode: Mode::ProfilePosition,
///     position: 10_000,
///     velocity: None,
///     error_code: None,
/// };
/// assert_eq!(sample.state(), State::OperationEnabled);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Sample {
    /// Statusword 6041h.
    pub statusword: Statusword,
    /// Modes of operation display 6061h; [`Mode::None`] where it is not known.
    pub mode: Mode,
    /// Position actual value 6064h, position units.
    pub position: i32,
    /// Velocity actual value 606Ch, velocity units, where it is mapped.
    pub velocity: Option<i32>,
    /// Error code 603Fh, where it is mapped.
    pub error_code: Option<u16>,
}

impl Sample {
    /// The state that the statusword shows.
    #[must_use]
    #[inline(always)]
    pub const fn state(&self) -> State {
        self.statusword.state()
    }
}
