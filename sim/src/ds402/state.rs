//! The DS402 device states, their statusword patterns, and the commands in a controlword.

/// A state of the DS402 device state machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// The drive starts up; no command is evaluated.
    NotReadyToSwitchOn,
    /// Started; drive parameters may be set, high voltage may be applied.
    SwitchOnDisabled,
    /// Power may be switched on.
    ReadyToSwitchOn,
    /// The power section is ready, the axis not yet controlled.
    SwitchedOn,
    /// The axis is controlled and follows set-points.
    OperationEnabled,
    /// The quick stop runs, or stands where 605Ah says so.
    QuickStopActive,
    /// A fault's stop runs.
    FaultReactionActive,
    /// A fault; only a reset leads out.
    Fault,
}

impl State {
    /// Every state, in the order of the state diagram.
    pub const ALL: [State; 8] = [
        State::NotReadyToSwitchOn,
        State::SwitchOnDisabled,
        State::ReadyToSwitchOn,
        State::SwitchedOn,
        State::OperationEnabled,
        State::QuickStopActive,
        State::FaultReactionActive,
        State::Fault,
    ];

    /// Bits 0–3, 5 and 6 of the statusword in this state (DSP 402 v2 table 7), undefined bits 0.
    pub(super) fn pattern(self) -> u16 {
        match self {
            State::NotReadyToSwitchOn => 0x0000,
            State::SwitchOnDisabled => 0x0040,
            State::ReadyToSwitchOn => 0x0021,
            State::SwitchedOn => 0x0023,
            State::OperationEnabled => 0x0027,
            State::QuickStopActive => 0x0007,
            State::FaultReactionActive => 0x000F,
            State::Fault => 0x0008,
        }
    }

    /// Whether bit 5 of the statusword has no meaning in this state.
    pub(super) fn leaves_bit_5_open(self) -> bool {
        matches!(
            self,
            State::NotReadyToSwitchOn
                | State::SwitchOnDisabled
                | State::FaultReactionActive
                | State::Fault
        )
    }

    /// Whether the drive controls its shaft.
    pub(super) fn controls(self) -> bool {
        self.is_powered() && self != State::SwitchedOn
    }

    /// Whether the power section may be on.
    pub fn is_powered(self) -> bool {
        matches!(
            self,
            State::SwitchedOn
                | State::OperationEnabled
                | State::QuickStopActive
                | State::FaultReactionActive
        )
    }
}

/// A command of the device state machine, as its bits stand in one controlword.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Command {
    Shutdown,
    /// Bits 0–2 set, bit 3 clear: switch on, or disable operation where that is already done.
    SwitchOn,
    /// Bits 0–3 set.
    EnableOperation,
    DisableVoltage,
    QuickStop,
}

impl Command {
    /// Decodes bits 0–3, and bit 7 unless the drive takes that for irrelevant.
    ///
    /// Priority: disable voltage, quick stop, shutdown, then the two that need all three low bits.
    pub(super) fn decode(controlword: u16, bit_7_irrelevant: bool) -> Option<Command> {
        let bit = |n: u16| controlword & (1 << n) != 0;
        if bit(7) && !bit_7_irrelevant {
            return None;
        }
        Some(match (bit(1), bit(2), bit(0), bit(3)) {
            (false, ..) => Command::DisableVoltage,
            (true, false, ..) => Command::QuickStop,
            (true, true, false, _) => Command::Shutdown,
            (true, true, true, false) => Command::SwitchOn,
            (true, true, true, true) => Command::EnableOperation,
        })
    }
}
