//! What the outputs of a drive hold until the program sets them: none of them is 0 because nobody has set it.
//!
//! What the drive holds is read in PREOP, once its start-up lists are written. Set-points, targets and commands belong to the axes, which
//! begin with 0. A brake bit is set whatever the drive held, and in the drive before anything can enable its output.

use super::config::DriveConfig;
use crate::{
    axis::{Brake, OutputBrake},
    bus::error::{AtStep, BringUpStep, DriveFault, StepError},
    coe::{AxisOffset, DriveError, ObjectAddress, SdoError, SdoHandle, obj},
    parameters::{StartUpLines, StartUpList, Transition, is_parameter},
    pdo_map::{BitRange, Direction, Layout},
};

/// What a set-point brings (6081h to 6084h, 6086h).
const OF_SET_POINT: [u16; 5] = [0x6081, 0x6082, 0x6083, 0x6084, 0x6086];

/// What is mapped below stands for the padding of a data type (CiA 301, static data types).
const FIRST_OBJECT: u16 = 0x1000;

/// The brakes of a drive that are on its outputs, each with its 60FEh:1.
#[derive(Debug, Clone, Default)]
pub(in crate::bus) struct Brakes(Vec<(ObjectAddress, OutputBrake)>);

impl Brakes {
    /// Those that the axes of a drive are declared with.
    pub fn of(config: &DriveConfig) -> Self {
        let axes = config.axes.iter().zip(&config.description.axes);
        let brakes = axes.filter_map(|(axis, description)| {
            let Some(Brake::Output(brake)) = &axis.brake else {
                return None;
            };
            let outputs = obj::DIGITAL_OUTPUTS.offset(description.offset);
            Some((outputs.address(), *brake))
        });
        Self(brakes.collect())
    }

    /// Closes those that this value of an object would open: the declared ones, and bit 0 of each 60FEh:1.
    fn set(&self, object: ObjectAddress, value: &mut [u8]) {
        if let Some(lowest) = value.first_mut().filter(|_| is_brake(object)) {
            *lowest |= 1;
        }
        for (_, brake) in self.0.iter().filter(|(outputs, _)| *outputs == object) {
            let mut held = [0; 4];
            for (to, byte) in held.iter_mut().zip(value.iter()) {
                *to = *byte;
            }
            let set = brake.in_outputs(u32::from_le_bytes(held), true);
            for (byte, set) in value.iter_mut().zip(set.to_le_bytes()) {
                *byte = set;
            }
        }
    }

    /// Whether this value of an object opens one of them.
    pub fn are_opened_by(&self, object: ObjectAddress, value: &[u8]) -> bool {
        let mut set = value.to_vec();
        self.set(object, &mut set);
        set != value
    }
}

/// The outputs of a drive as they go out from the first frame on, and again after a recovery.
#[derive(Debug, Clone, Default)]
pub(in crate::bus) struct HeldOutputs {
    bytes: Box<[u8]>,
    /// Of which bits that is so at the end, too: digital outputs and makers' objects.
    at_the_end: Box<[u8]>,
}

impl HeldOutputs {
    /// Reads what a drive holds in them. `axes`: those that are commanded.
    pub(super) async fn read(
        layout: &Layout,
        axes: impl Iterator<Item = AxisOffset> + Clone,
        lists: &[StartUpList],
        brakes: &Brakes,
        sdo: &SdoHandle,
    ) -> Result<Self, StepError> {
        let mut held = vec![0; layout.output_bytes()];
        let mut at_the_end = held.clone();
        for (object, place) in layout.objects(Direction::Outputs) {
            let of_set_point = |axis: AxisOffset| {
                let mut indices = OF_SET_POINT.iter().map(|index| axis.apply(*index));
                indices.any(|index| index == object.index)
            };
            let is_held = is_parameter(object) || is_digital_output(object.index);
            let is_held = is_held && object.index >= FIRST_OBJECT;
            let is_said = said_of(object, lists).is_some();
            if !(is_held || is_said) || axes.clone().any(of_set_point) {
                continue;
            }
            let mut value = value_of(object, lists, sdo).await?;
            brakes.set(object, &mut value);
            write(&mut held, place, &value);
            if matches!(object.index, 0x2000..=0x5FFF) || is_digital_output(object.index) {
                write(&mut at_the_end, place, &[0xFF; 32]);
            }
        }
        Ok(Self {
            bytes: held.into(),
            at_the_end: at_the_end.into(),
        })
    }

    /// The outputs begin with these.
    pub fn begin(&self, outputs: &mut [u8]) {
        for (output, held) in outputs.iter_mut().zip(&self.bytes) {
            *output = *held;
        }
    }

    /// Whatever the program has set, digital outputs and makers' objects are what they began with.
    pub fn end(&self, outputs: &mut [u8]) {
        let held = self.bytes.iter().zip(&self.at_the_end);
        for (output, (held, bits)) in outputs.iter_mut().zip(held) {
            *output = *output & !bits | held & bits;
        }
    }
}

/// In PREOP, before start-up lists, mapping and process data can enable its output: each brake that the outputs hold is set.
pub(super) async fn set_brakes(
    layout: &Layout,
    lists: &[StartUpList],
    brakes: &Brakes,
    sdo: &SdoHandle,
) -> Result<(), StepError> {
    let objects = layout.objects(Direction::Outputs);
    for (object, _) in objects.filter(|(object, _)| is_brake(*object)) {
        let mut value = value_of(object, lists, sdo).await?;
        brakes.set(object, &mut value);
        sdo.write_bytes(object.index, object.subindex, value)
            .await
            .at(BringUpStep::Parameters)?;
    }
    Ok(())
}

/// What the drive holds in an object; of one that cannot be read, what a start-up list says.
async fn value_of(
    object: ObjectAddress,
    lists: &[StartUpList],
    sdo: &SdoHandle,
) -> Result<Vec<u8>, StepError> {
    match sdo.read_bytes(object.index, object.subindex).await {
        Ok(value) => Ok(value),
        Err(DriveError {
            error: error @ SdoError::Aborted { .. },
            ..
        }) => {
            let unknown = DriveFault::OutputUnknown { object, error };
            let said = said_of(object, lists);
            said.ok_or(unknown).at(BringUpStep::Parameters)
        }
        Err(error) => Err(error).at(BringUpStep::Parameters),
    }
}

/// What a start-up list says of an object before the mapping.
fn said_of(object: ObjectAddress, lists: &[StartUpList]) -> Option<Vec<u8>> {
    StartUpLines::of(lists, Transition::PreOpToSafeOp).value_of(object)
}

fn is_digital_output(index: u16) -> bool {
    (0x6000..=0x9FFF).contains(&index) && (index - 0x6000) % AxisOffset::PROFILE_STEP == 0x00FE
}

/// Whether bit 0 of the object is a brake: 60FEh:1 of any axis (CiA 402, "set brake").
fn is_brake(object: ObjectAddress) -> bool {
    is_digital_output(object.index) && object.subindex == 1
}

/// Puts a value of any length at a place of any length.
fn write(outputs: &mut [u8], place: BitRange, value: &[u8]) {
    for bit in 0..usize::from(place.bits) {
        let is_set = value
            .get(bit / 8)
            .is_some_and(|byte| byte >> (bit % 8) & 1 != 0);
        let at = usize::from(place.bit) + bit;
        if let Some(byte) = outputs.get_mut(place.byte + at / 8) {
            *byte = *byte & !(1 << (at % 8)) | u8::from(is_set) << (at % 8);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        AxisConfig, DriveConfig,
        coe::{obj, test_device::rig},
        drives,
    };

    /// It may show what its terminals are, and not what was written.
    #[test]
    fn a_brake_goes_out_as_set_whatever_the_drive_shows() {
        let axis = AxisConfig::new("z").map_output(obj::DIGITAL_OUTPUTS);
        let config = DriveConfig::new(drives::generic()).axis(axis);
        let layout = config.mapping().unwrap().layout();
        let (rig, device, sdo, _) = rig();
        let shown = vec![0, 0, 5, 0];
        device.0.borrow_mut().objects.insert((0x60FE, 1), shown);
        let mut outputs = vec![0; layout.output_bytes()];
        let axes = core::iter::once(AxisOffset::default());
        let held = rig.run(async move {
            HeldOutputs::read(&layout, axes, &[], &Brakes::default(), &sdo).await
        });
        held.unwrap().begin(&mut outputs);
        assert_eq!(outputs[19..], [1, 0, 5, 0]);
    }
}
