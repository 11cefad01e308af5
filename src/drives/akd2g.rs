//! Kollmorgen AKD2G with two axes, after its documents "Profile Position Mode" and "6040h, 6840h Controlword".

use super::{AxisDescription, DriveDescription};
use crate::coe::ErrorTexts;
use crate::pdo_map::Limits;
use crate::profile_position::{BufferSignal, LimitsOff, LimitsRule, RelativeBase, Traits};

/// A two-axis AKD2G.
///
/// From its documents: axis 2 at +0800h, 5000h and 5100h, the objects of Profile Position. Assumed, because no
/// document at hand says: product code 414B4432h, one RxPDO and one TxPDO per axis (1600h and 1610h, 1A00h and
/// 1A10h), 64 bytes per direction.
#[must_use]
pub fn akd2g() -> DriveDescription {
    DriveDescription {
        name: "AKD2G".into(),
        vendor: Some(0x0000_006A),
        product: Some(0x414B_4432),
        axes: alloc::vec![
            AxisDescription::profile_position(1, 0x1600, 0x1A00),
            AxisDescription::profile_position(2, 0x1610, 0x1A10),
        ],
        fixed_pdos: alloc::vec::Vec::new(),
        error_texts: ErrorTexts::default(),
        limits: Limits {
            output_bytes: 64,
            input_bytes: 64,
            ..Limits::default()
        },
        // "Profile Position Mode": bit 5 starts at once, bit 9 with bit 5 low blends, bit 12 follows bit 4, a halt keeps
        // the set-point. What relative moves count from is not documented.
        traits: Traits {
            buffer_signal: BufferSignal::None,
            relative_base: RelativeBase::Undocumented,
            halt_keeps_set_point: true,
            // Of the first AKD generation's manual: limits of 0 and 0 are off.
            limits: LimitsRule {
                off: LimitsOff::BothZero,
                ..LimitsRule::cia402()
            },
            ..Traits::cia402()
        },
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
    fn another_product_is_not_an_akd2g() {
        let identity = Identity {
            vendor: 0x6A,
            product: 0x414B_4432,
            revision: 7,
            serial: 1,
        };
        assert!(akd2g().matches(&identity));
        let akd = Identity {
            product: 0x0041_4B44,
            ..identity
        };
        assert!(!akd2g().matches(&akd));
    }
}
