//! The drive with object 2010h Min_Profile_Velocity, after its page "Profile Position Mode (pp)".

use super::{AxisDescription, DriveDescription};
use crate::coe::{ErrorTexts, obj};
use crate::pdo_map::MappingLimits;
use crate::profile_position::{BufferSignal, LimitsRule, MinVelocity, StartBits, Traits};

/// The drive with object 2010h (`Min_Profile_Velocity`, the speed at which ramps start and end).
///
/// From its page: bit 5 distinguishes single set-points (processed at once) from sets of set-points. The drive holds up to two
/// set-points. Bit 12 falls when another one can be taken. Bit 10 stays low until all are processed. Ramps are linear only. The
/// page names no bit 9, so a target is never passed without stopping. 606Ch is not among its objects: standstill is taken from
/// 6064h. Assumed: the PDOs 1600h and 1A00h. The page names neither maker nor product: any identity is accepted. Nor does it name the unit
/// of 2010h, which is read and shown alone. Where the drive's manual says that it is that of 6081h, have slower moves refused:
///
/// ```
/// use servocrab::{drives, profile_position::MinVelocity};
/// let mut drive = drives::pp2010();
/// assert_eq!(drive.traits.limits.min_velocity, MinVelocity::UnitUnknown);
/// drive.traits.limits.min_velocity = MinVelocity::AsProfileVelocity;
/// ```
#[must_use]
pub fn pp2010() -> DriveDescription {
    let mut axis = AxisDescription::profile_position(1, 0x1600, 0x1A00);
    axis.inputs
        .retain(|object| *object != obj::VELOCITY_ACTUAL.into());
    DriveDescription {
        name: "drive with 2010h".into(),
        vendor: None,
        product: None,
        axes: alloc::vec![axis],
        fixed_pdos: alloc::vec::Vec::new(),
        error_texts: ErrorTexts::default(),
        limits: MappingLimits::default(),
        traits: Traits {
            blend: StartBits::Unsupported(
                "this drive stops at every target: its documents name no bit 9",
            ),
            buffer_signal: BufferSignal::Acknowledge,
            profile_types: &[0],
            limits: LimitsRule {
                min_velocity: MinVelocity::UnitUnknown,
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

    #[test]
    fn the_velocity_is_not_mapped() {
        let layout = pp2010().default_mapping().unwrap().layout();
        assert_eq!((layout.output_bytes(), layout.input_bytes()), (19, 7));
    }
}
