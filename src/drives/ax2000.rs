//! Beckhoff AX2000, after its CANopen manual of 07/2007, section "Profile position mode", pages 101 and 102.

use super::{AxisDescription, DriveDescription};
use crate::coe::{ErrorTexts, obj};
use crate::pdo_map::MappingLimits;
use crate::profile_position::{BufferSignal, StartBits, Traits};

/// A Beckhoff AX2000.
///
/// From its manual: bit 5 of the controlword selects single set-points or sets of set-points. There is no bit 9. A target is passed
/// without stopping only with linear ramps. 6086h is 0 (linear) or 1 (sin²). Page 102 says which value of bit 5 is which: with 1
/// the next set-point is processed after the active one is reached, without a stop. Nothing replaces an active set-point, so
/// [`BufferMode::Aborting`](crate::BufferMode::Aborting) is refused. Bit 12 is 1 from the recognition of a set-point
/// until the next one can be taken. Assumed, because the manual is that of CANopen: the PDOs 1600h and 1A00h. Its product code is
/// not in the manual; any of the vendor's is accepted.
#[must_use]
pub fn ax2000() -> DriveDescription {
    let mut axis = AxisDescription::profile_position(1, 0x1600, 0x1A00);
    // In the process data, since whether a set-point can be blended depends on it.
    axis.outputs.push(obj::MOTION_PROFILE_TYPE.into());
    DriveDescription {
        name: "AX2000".into(),
        vendor: Some(0x0000_0002),
        product: None,
        axes: alloc::vec![axis],
        fixed_pdos: alloc::vec::Vec::new(),
        error_texts: ErrorTexts::default(),
        limits: MappingLimits::default(),
        traits: Traits {
            immediately: StartBits::Unsupported(
                "this drive always ends the active set-point first: use Buffered or Blending, or stop the axis",
            ),
            after_current: StartBits::Sequenced,
            blend: StartBits::Bits {
                change_set_immediately: true,
                change_on_set_point: false,
            },
            buffer_signal: BufferSignal::Acknowledge,
            profile_types: &[0, 1],
            blend_needs_linear_ramps: true,
            ..Traits::cia402()
        },
        sync_types: [None; 2],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BufferMode;

    #[test]
    fn bit_5_blends_and_nothing_replaces() {
        let traits = ax2000().traits;
        assert_eq!(
            traits.bits(BufferMode::Blending),
            StartBits::Bits {
                change_set_immediately: true,
                change_on_set_point: false,
            }
        );
        assert!(matches!(
            traits.bits(BufferMode::Aborting),
            StartBits::Unsupported(_)
        ));
    }

    #[test]
    fn the_profile_type_is_in_the_process_data() {
        let layout = ax2000().default_mapping().unwrap().layout();
        assert_eq!((layout.output_bytes(), layout.input_bytes()), (21, 11));
    }
}
