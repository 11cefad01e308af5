//! The process data of the oracle's axes, and the words of the standard in them.

use servocrab::axis::AxisFields;

pub const OUTPUT_BYTES: usize = 27;
pub const INPUT_BYTES: usize = 13;

/// Bits of the controlword.
pub const NEW_SET_POINT: u16 = 1 << 4;
pub const HALT: u16 = 1 << 8;
/// Bits 5, 6 and 9, which belong to bit 4.
pub const START_BITS: u16 = 0x0260;

/// Bits of the statusword.
pub const REACHED: u16 = 1 << 10;
pub const LIMIT: u16 = 1 << 11;
pub const ACKNOWLEDGE: u16 = 1 << 12;

/// Where the objects lie.
pub fn fields(velocity: bool, end_velocity: bool) -> AxisFields {
    let mut fields = AxisFields::at(0, 0);
    fields.controlword = 0;
    fields.mode = Some(2);
    fields.target = 3;
    fields.velocity = Some(7);
    fields.acceleration = Some(11);
    fields.deceleration = Some(15);
    fields.target_velocity = Some(19);
    fields.end_velocity = end_velocity.then_some(23);
    fields.statusword = 0;
    fields.mode_display = Some(2);
    fields.position = 3;
    fields.actual_velocity = velocity.then_some(7);
    fields.error_code = Some(11);
    fields
}

/// What goes out with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Outputs {
    pub word: u16,
    pub mode: i8,
    pub target: i32,
    pub velocity: u32,
    pub acceleration: u32,
    pub deceleration: u32,
    pub target_velocity: i32,
    pub end_velocity: u32,
}

impl Outputs {
    pub fn read(bytes: &[u8; OUTPUT_BYTES]) -> Self {
        let long = |at: usize| {
            u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
        };
        Self {
            word: u16::from_le_bytes([bytes[0], bytes[1]]),
            mode: bytes[2].cast_signed(),
            target: long(3).cast_signed(),
            velocity: long(7),
            acceleration: long(11),
            deceleration: long(15),
            target_velocity: long(19).cast_signed(),
            end_velocity: long(23),
        }
    }

    pub const fn bit(&self, bit: u16) -> bool {
        self.word >> bit & 1 != 0
    }

    pub const fn is_disable_voltage(&self) -> bool {
        self.word & 0x82 == 0
    }

    pub const fn is_quick_stop(&self) -> bool {
        self.word & 0x86 == 0x02
    }

    pub const fn is_shutdown(&self) -> bool {
        self.word & 0x87 == 0x06
    }

    pub const fn is_disable_operation(&self) -> bool {
        self.word & 0x8F == 0x07
    }

    pub const fn is_enable_operation(&self) -> bool {
        self.word & 0x8F == 0x0F
    }

    /// Whether the axis is let go by it.
    pub const fn leads_down(&self) -> bool {
        self.is_disable_voltage() || self.is_shutdown() || self.is_disable_operation()
    }

    /// Whether bit 4 is high in Profile Position mode.
    pub const fn starts(&self) -> bool {
        self.mode == 1 && self.bit(4)
    }
}

/// What comes back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sample {
    pub word: u16,
    pub mode: i8,
    pub position: i32,
}

impl Sample {
    pub const fn read(image: &[u8; INPUT_BYTES]) -> Self {
        Self {
            word: u16::from_le_bytes([image[0], image[1]]),
            mode: image[2].cast_signed(),
            position: i32::from_le_bytes([image[3], image[4], image[5], image[6]]),
        }
    }

    pub const fn is_enabled(&self) -> bool {
        self.word & 0x6F == State::Enabled.bits()
    }

    pub const fn is_fault(&self) -> bool {
        matches!(self.word & 0x4F, 0x08 | 0x0F)
    }
}

/// The states of the standard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum State {
    #[default]
    NotReady,
    SwitchOnDisabled,
    Ready,
    SwitchedOn,
    Enabled,
    QuickStop,
    FaultReaction,
    Fault,
}

impl State {
    /// Bits 0 to 3, 5 and 6.
    pub const fn bits(self) -> u16 {
        match self {
            Self::NotReady => 0x00,
            Self::SwitchOnDisabled => 0x40,
            Self::Ready => 0x21,
            Self::SwitchedOn => 0x23,
            Self::Enabled => 0x27,
            Self::QuickStop => 0x07,
            Self::FaultReaction => 0x0F,
            Self::Fault => 0x08,
        }
    }

    /// Whether the power stage is on.
    pub const fn is_powered(self) -> bool {
        matches!(self, Self::Enabled | Self::QuickStop | Self::FaultReaction)
    }
}
