//! What goes out: the words that are in the outputs, and those that were sent.
//!
//! `AxisFields` writes nothing else to 6040h and 6060h than what has a type of its own here, and nothing outside of this file can make it.

use crate::ds402::{Controlword, Mode, ModeBits, PowerCommand};
#[cfg(feature = "std")]
use crate::profile_position::Completion;

/// A controlword 6040h that may be sent. Bits 0 to 3 and 7 are those of a power command, bits 4, 5, 6 and 9 those of the active mode, bit 8
/// is the halt, and bits 11 to 15 are the manufacturer's. Nothing sets bit 10.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct ComposedWord(Controlword);

impl ComposedWord {
    /// Of an axis that has been sent nothing.
    pub const DISABLE_VOLTAGE: Self = Self(Controlword::DISABLE_VOLTAGE);

    #[inline]
    pub fn new(
        command: PowerCommand,
        mode_bits: ModeBits,
        halt: bool,
        manufacturer: ManufacturerBits,
    ) -> Self {
        let halt = if halt {
            Controlword::HALT
        } else {
            Controlword::empty()
        };
        Self(
            command
                .controlword()
                .union(mode_bits.word())
                .union(halt)
                .union(manufacturer.0),
        )
    }

    /// With the bits of the mode and bit 8 as they were sent last.
    #[inline]
    pub fn after(command: PowerCommand, sent: Self, manufacturer: ManufacturerBits) -> Self {
        let kept = sent.0.intersection(ModeBits::MASK.union(Controlword::HALT));
        Self(command.controlword().union(kept).union(manufacturer.0))
    }

    /// The word itself, to be looked at.
    #[inline]
    pub const fn word(self) -> Controlword {
        self.0
    }

    /// Whether all of these bits are set.
    #[inline]
    pub const fn contains(self, bits: Controlword) -> bool {
        self.0.contains(bits)
    }
}

/// Bits 11 to 15 of the controlword. It can hold no others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct ManufacturerBits(Controlword);

impl ManufacturerBits {
    pub const NONE: Self = Self(Controlword::empty());

    /// These bits without the others.
    pub fn of(bits: Controlword) -> Self {
        Self(bits.intersection(Controlword::MANUFACTURER))
    }
}

/// A mode that may be written to 6060h.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CommandedMode(Mode);

impl CommandedMode {
    /// The one that the axis core holds in its outputs.
    #[inline]
    pub(super) const fn of_core(mode: Mode) -> Self {
        Self(mode)
    }

    /// The one that the axis core has said may be written by SDO now; none if it has said something else.
    #[cfg(feature = "std")]
    pub const fn by_sdo(said: Completion) -> Option<Self> {
        match said {
            Completion::Prepared { mode } => Some(Self(mode)),
            Completion::Done
            | Completion::Reached { .. }
            | Completion::Passed { .. }
            | Completion::Homed { .. }
            | Completion::Stopped { .. } => None,
        }
    }

    /// As 6060h has it.
    #[inline]
    pub const fn byte(self) -> u8 {
        self.0.raw().cast_unsigned()
    }
}

/// A controlword and a target velocity 60FFh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Outgoing {
    pub word: ComposedWord,
    pub velocity: i32,
}

impl Outgoing {
    const NONE: Self = Self {
        word: ComposedWord::DISABLE_VOLTAGE,
        velocity: 0,
    };
}

/// What is in the outputs, and what was sent last.
#[derive(Debug, Clone, Hash)]
pub(super) struct Outputs {
    pub next: Outgoing,
    pub sent: Outgoing,
    pub manufacturer: ManufacturerBits,
    /// A stop was asked for since the last frame: nothing takes it back before it is sent.
    pub stop_unsent: bool,
}

impl Outputs {
    pub const fn new() -> Self {
        Self {
            next: Outgoing::NONE,
            sent: Outgoing::NONE,
            manufacturer: ManufacturerBits::NONE,
            stop_unsent: false,
        }
    }

    /// Nothing was sent of a drive that begins again.
    #[cfg(feature = "std")]
    pub const fn restart(&mut self) {
        self.sent = Outgoing::NONE;
        self.manufacturer = ManufacturerBits::NONE;
    }

    /// Whether what is in the outputs was sent.
    pub fn is_sent(&self) -> bool {
        self.next == self.sent && !self.stop_unsent
    }

    pub const fn mark_sent(&mut self) {
        self.sent = self.next;
        self.stop_unsent = false;
    }

    /// Whether they hold bit 4, with a target that belongs to it.
    pub const fn starts(&self) -> bool {
        self.next.word.contains(Controlword::NEW_SET_POINT)
    }

    /// Whether bit 4 rises with the next frame.
    pub const fn rises(&self) -> bool {
        self.starts() && !self.sent.word.contains(Controlword::NEW_SET_POINT)
    }

    /// Whether a motion may begin with the next frame; `has_motion`: one that bit 8 holds.
    pub const fn set_off(&self, has_motion: bool) -> bool {
        let bit_8_falls = self.sent.word.contains(Controlword::HALT)
            && !self.next.word.contains(Controlword::HALT);
        self.rises()
            || (bit_8_falls && has_motion)
            || (self.sent.velocity == 0 && self.next.velocity != 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ds402::SetPointBits;

    #[test]
    fn each_bit_of_a_composed_word_comes_from_its_owner_alone() {
        let all = ModeBits::of_set_point(SetPointBits {
            change_set_immediately: true,
            relative: true,
            change_on_set_point: true,
        });
        for command in [
            PowerCommand::DisableVoltage,
            PowerCommand::Shutdown,
            PowerCommand::SwitchOn,
            PowerCommand::EnableOperation,
            PowerCommand::QuickStop,
            PowerCommand::FaultReset,
        ] {
            let power = command.controlword().bits();
            assert_eq!(power & !0x008F, 0, "{command:?}");
            for (mode, mode_bits) in [
                (ModeBits::NONE, 0),
                (ModeBits::HOMING_START, 0x0010),
                (all.with_new_set_point(), 0x0270),
            ] {
                for halt in [false, true] {
                    for asked in [0, 0x07FF, 0xF800, 0xFFFF] {
                        let own = ManufacturerBits::of(Controlword::from_bits_retain(asked));
                        let word = ComposedWord::new(command, mode, halt, own);
                        let kept = mode_bits | u16::from(halt) << 8;
                        let others = power | asked & 0xF800;
                        assert_eq!(word.word().bits(), kept | others, "{command:?}");
                        let quick = PowerCommand::QuickStop;
                        let after = ComposedWord::after(quick, word, ManufacturerBits::NONE);
                        assert_eq!(after.word().bits(), kept | 0x000B, "{command:?}");
                    }
                }
            }
        }
    }
}
