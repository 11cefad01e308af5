//! Yaskawa Σ-7 with EtherCAT, after the section "Profile Position Mode" of its manual's object dictionary.

use alloc::collections::BTreeMap;

use super::{AxisDescription, DriveDescription};
use crate::coe::{DriveNumber, ErrorTexts};
use crate::pdo_map::MappingLimits;
use crate::profile_position::{LimitsActive, LimitsOff, LimitsRule, Traits};

/// A Yaskawa Σ-7 (SGD7S).
///
/// From its manual: the software position limits 607Dh are corrected by the home offset 607Ch. They are off where the minimum is
/// not below the maximum. They hold only after homing or with an absolute encoder. From the maker's answers to users: 1600h–1603h
/// and 1A00h–1A03h with at most eight objects each, two PDOs per direction. What is too much for the first goes into the second.
/// How bits 5, 9 and 12 behave is not in the pages at hand. They are taken to be as in CiA 402. Whether bit 12 shows a full buffer
/// is not known ([`BufferSignal::Unknown`](crate::profile_position::BufferSignal::Unknown)). Its product code is not there either; any of the vendor's is accepted. Its emergencies all have the error code
/// FF00h, with the alarm that the drive shows in bytes 4 and 5 of the message (the manual's section "Emergency Messages"). The
/// meaning of each alarm is in the manual's list, which is not at hand.
#[must_use]
pub fn sigma7() -> DriveDescription {
    DriveDescription {
        name: "Sigma-7".into(),
        vendor: Some(0x0000_0539),
        product: None,
        axes: alloc::vec![AxisDescription {
            rx_pdos: alloc::vec![0x1600, 0x1601],
            tx_pdos: alloc::vec![0x1A00, 0x1A01],
            ..AxisDescription::profile_position(1, 0x1600, 0x1A00)
        }],
        fixed_pdos: alloc::vec::Vec::new(),
        error_texts: ErrorTexts {
            number: Some(DriveNumber {
                with_code: 0xFF00,
                byte: 1,
                prefix: "alarm A.".into(),
                texts: BTreeMap::new(),
            }),
            ..ErrorTexts::default()
        },
        limits: MappingLimits {
            entries_per_pdo: 8,
            output_pdos: 2,
            input_pdos: 2,
            ..MappingLimits::default()
        },
        traits: Traits {
            limits: LimitsRule {
                off: LimitsOff::MinNotBelowMax,
                less_home_offset: true,
                active: LimitsActive::WhenReferenced,
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
    use crate::coe::Emergency;

    #[test]
    fn one_pdo_holds_the_axis() {
        let layout = sigma7().default_mapping().unwrap().layout();
        assert_eq!((layout.output_bytes(), layout.input_bytes()), (19, 11));
    }

    #[test]
    fn an_emergency_is_named_by_its_alarm() {
        // A.D00 in bytes 4 and 5 of the message, byte 3 reserved.
        let emergency = Emergency::parse(&[0x00, 0xFF, 0x81, 0, 0x00, 0x0D, 0, 0]).unwrap();
        assert_eq!(sigma7().error_texts.text(&emergency), "alarm A.D00");
    }
}
