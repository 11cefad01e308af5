//! A drive of which nothing is known but that it follows the DS402 profile.

use super::{AxisDescription, DriveDescription};
use crate::coe::ErrorTexts;
use crate::pdo_map::MappingLimits;
use crate::profile_position::{RelativeBase, Traits};

/// One axis with the standard's objects in 1600h and 1A00h. Those behind the eighth are in 1601h and 1A01h. It matches any vendor and
/// product. What relative moves count from is read from 60F2h, where the drive has it.
#[must_use]
pub fn generic() -> DriveDescription {
    DriveDescription {
        name: "DS402 drive".into(),
        vendor: None,
        product: None,
        axes: alloc::vec![AxisDescription {
            rx_pdos: alloc::vec![0x1600, 0x1601],
            tx_pdos: alloc::vec![0x1A00, 0x1A01],
            ..AxisDescription::profile_position(1, 0x1600, 0x1A00)
        }],
        fixed_pdos: alloc::vec::Vec::new(),
        error_texts: ErrorTexts::default(),
        limits: MappingLimits {
            // Many drives take eight objects in one PDO and no more.
            entries_per_pdo: 8,
            ..MappingLimits::default()
        },
        traits: Traits {
            relative_base: RelativeBase::PositioningOption,
            ..Traits::cia402()
        },
        sync_types: [None; 2],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_generic_drive_of_any_maker_gets_one_axis() {
        let drive = generic();
        assert!(drive.matches(&crate::sii::Identity::default()));
        let layout = drive.default_mapping().unwrap().layout();
        assert_eq!((layout.output_bytes(), layout.input_bytes()), (19, 11));
    }
}
