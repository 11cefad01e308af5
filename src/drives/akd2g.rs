//! Kollmorgen AKD2G with two axes, after its documents "Profile Position Mode" and "6040h, 6840h Controlword".

use super::{AxisDescription, DriveDescription};
use bitflags::bitflags;

use crate::coe::{ErrorTexts, obj};
use crate::pdo_map::MappingLimits;
use crate::profile_position::{
    BufferSignal, HomedSignal, LimitsOff, LimitsRule, RelativeBase, Traits,
};

bitflags! {
    /// The motion status of an axis (`AXIS#.MOTIONSTAT`), 5000h:4 and 5100h:4: [`obj::AKD2G_MOTION_STATUS`]. After the maker's public
    /// help, page "AXIS#.MOTIONSTAT".
    ///
    /// ```
    /// use servocrab::drives::Akd2gMotionStatus;
    /// let shown = Akd2gMotionStatus::from_bits_retain(0x0000_8806);
    /// assert!(shown.contains(Akd2gMotionStatus::HOMING_DONE));
    /// ```
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    pub struct Akd2gMotionStatus: u32 {
        /// Bit 0, a motion task is active.
        const MOTION_TASK_ACTIVE = 1 << 0;
        /// Bit 1, the home position has been found.
        const HOME_POSITION_FOUND = 1 << 1;
        /// Bit 2, the homing is done.
        const HOMING_DONE = 1 << 2;
        /// Bit 3, a homing is active.
        const HOMING_ACTIVE = 1 << 3;
        /// Bit 4, an error during the homing.
        const HOMING_ERROR = 1 << 4;
        /// Bit 9, a service motion is active.
        const SERVICE_MOTION = 1 << 9;
        /// Bit 10, a motion task could not be activated.
        const MOTION_TASK_NOT_ACTIVATED = 1 << 10;
        /// Bit 11, the trajectory is over and the axis is within SETTLE.P.
        const SETTLED = 1 << 11;
        /// Bit 12, the target velocity is reached.
        const TARGET_VELOCITY_REACHED = 1 << 12;
        /// Bit 13, an exception.
        const EXCEPTION = 1 << 13;
        /// Bit 14, the target has been crossed.
        const TARGET_CROSSED = 1 << 14;
        /// Bit 15, the axis is in the position window.
        const IN_POSITION_WINDOW = 1 << 15;
    }
}

/// A two-axis AKD2G.
///
/// From its documents: axis 2 at +0800h, 5000h and 5100h, the objects of Profile Position. From its maker's public help: the
/// bits of 5000h:4, by which an axis counts as homed. Assumed, because no
/// document at hand says: one RxPDO and one TxPDO per axis (1600h and 1610h, 1A00h and 1A10h), 64 bytes per direction.
/// Its product code is in none of them; any of the vendor's is accepted. Set [`DriveDescription::product`] to demand one.
#[must_use]
pub fn akd2g() -> DriveDescription {
    DriveDescription {
        name: "AKD2G".into(),
        vendor: Some(0x0000_006A),
        product: None,
        axes: alloc::vec![
            AxisDescription::profile_position(1, 0x1600, 0x1A00),
            AxisDescription::profile_position(2, 0x1610, 0x1A10),
        ],
        fixed_pdos: alloc::vec::Vec::new(),
        // "Profile Position Mode", mode-specific statusword bits.
        error_texts: ErrorTexts {
            following_error: Some("F6001 following error magnitude".into()),
            ..ErrorTexts::default()
        },
        limits: MappingLimits {
            output_bytes: 64,
            input_bytes: 64,
            ..MappingLimits::default()
        },
        // "Profile Position Mode": bit 5 starts at once, bit 9 with bit 5 low blends, bit 12 follows bit 4, a halt keeps
        // the set-point. Its example has bits 5 and 6 one word before bit 4. What relative moves count from is not documented.
        traits: Traits {
            start_bits_first: true,
            buffer_signal: BufferSignal::None,
            relative_base: RelativeBase::Undocumented,
            halt_keeps_set_point: true,
            // Of the public help, page "AXIS#.MOTIONSTAT".
            homed: Some(HomedSignal {
                object: obj::AKD2G_MOTION_STATUS.address(),
                set: Akd2gMotionStatus::HOMING_DONE.bits(),
                clear: Akd2gMotionStatus::HOMING_ACTIVE
                    .union(Akd2gMotionStatus::HOMING_ERROR)
                    .bits(),
            }),
            // Of the first AKD generation's manual: limits of 0 and 0 are off.
            limits: LimitsRule {
                off: LimitsOff::BothZero,
                ..LimitsRule::cia402()
            },
            ..Traits::cia402()
        },
        sync_types: [None; 2],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pdo_map::{Direction, Entry};
    use crate::sii::Identity;

    #[test]
    fn both_axes_have_their_own_objects_in_their_own_pdos() {
        // Pitfall 36.
        let mapping = akd2g().default_mapping().unwrap();
        let entry = Entry::new;
        let outputs = mapping.outputs();
        assert_eq!((outputs[0].index, outputs[1].index), (0x1600, 0x1610));
        assert_eq!(
            outputs[1].entries,
            [
                entry(0x6840, 0, 16),
                entry(0x6860, 0, 8),
                entry(0x687A, 0, 32),
                entry(0x6881, 0, 32),
                entry(0x6883, 0, 32),
                entry(0x6884, 0, 32)
            ]
        );
        let inputs = mapping.inputs();
        assert_eq!((inputs[0].index, inputs[1].index), (0x1A00, 0x1A10));
        assert_eq!(
            inputs[1].entries,
            [
                entry(0x6841, 0, 16),
                entry(0x6861, 0, 8),
                entry(0x6864, 0, 32),
                entry(0x686C, 0, 32)
            ]
        );
        let layout = mapping.layout();
        assert_eq!((layout.output_bytes(), layout.input_bytes()), (38, 22));
        let second = layout.find(Direction::Inputs, 0x6841, 0).unwrap();
        assert_eq!((second.byte, second.bit), (11, 0));
    }

    #[test]
    fn any_product_of_the_maker_is_accepted_until_one_is_demanded() {
        let identity = Identity {
            vendor: 0x6A,
            product: 0x0041_4B44,
            revision: 7,
            serial: 1,
        };
        assert!(akd2g().matches(&identity));
        let vendor = Identity {
            vendor: 2,
            ..identity
        };
        assert!(!akd2g().matches(&vendor));
        let demanding = DriveDescription {
            product: Some(0x414B_4432),
            ..akd2g()
        };
        assert!(!demanding.matches(&identity));
    }
}
