//! Where the axis' objects lie in its drive's process data.

use crate::{
    Failure,
    coe::{AnyObject, AxisOffset, ObjectAddress, obj},
    ds402::{Mode, Sample, Statusword},
    pdo_map::{Direction, Layout},
    profile_position::{ParameterFault, Parameters},
    profile_velocity::JogSetPoint,
};

use super::outputs::{CommandedMode, ComposedWord};

/// How 60FFh is named to people.
pub(crate) const TARGET_VELOCITY: &str = "target velocity 60FFh";

/// Byte offsets of an axis' objects in the drive's outputs and inputs. The mandatory ones are not optional.
///
/// ```
/// use servocrab::axis::AxisFields;
/// // 6040h, 607Ah in the outputs; 6041h, 6064h in the inputs.
/// let fields = AxisFields { target: 2, position: 2, ..AxisFields::at(0, 0) };
/// assert_eq!(fields.controlword, 0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AxisFields {
    /// Controlword 6040h, 16 bits, in the outputs.
    pub controlword: usize,
    /// Target position 607Ah, 32 bits, in the outputs.
    pub target: usize,
    /// Modes of operation 6060h, 8 bits, in the outputs.
    pub mode: Option<usize>,
    /// Profile velocity 6081h, 32 bits, in the outputs.
    pub velocity: Option<usize>,
    /// End velocity 6082h, 32 bits, in the outputs.
    pub end_velocity: Option<usize>,
    /// Profile acceleration 6083h, 32 bits, in the outputs.
    pub acceleration: Option<usize>,
    /// Profile deceleration 6084h, 32 bits, in the outputs.
    pub deceleration: Option<usize>,
    /// Motion profile type 6086h, 16 bits, in the outputs.
    pub profile_type: Option<usize>,
    /// Target velocity 60FFh, 32 bits, in the outputs.
    pub target_velocity: Option<usize>,
    /// Physical outputs 60FEh:1, 32 bits, in the outputs.
    pub digital_outputs: Option<usize>,
    /// Statusword 6041h, 16 bits, in the inputs.
    pub statusword: usize,
    /// Position actual value 6064h, 32 bits, in the inputs.
    pub position: usize,
    /// Modes of operation display 6061h, 8 bits, in the inputs.
    pub mode_display: Option<usize>,
    /// Velocity actual value 606Ch, 32 bits, in the inputs.
    pub actual_velocity: Option<usize>,
    /// Error code 603Fh, 16 bits, in the inputs.
    pub error_code: Option<usize>,
    /// Torque actual value 6077h, 16 bits, in the inputs.
    pub torque: Option<usize>,
    /// Digital inputs 60FDh, 32 bits, in the inputs.
    pub digital_inputs: Option<usize>,
}

impl AxisFields {
    /// The mandatory objects packed from these byte offsets on (controlword, target; statusword, position), no others.
    #[must_use]
    pub const fn at(outputs: usize, inputs: usize) -> Self {
        Self {
            controlword: outputs,
            target: outputs + 2,
            mode: None,
            velocity: None,
            end_velocity: None,
            acceleration: None,
            deceleration: None,
            profile_type: None,
            target_velocity: None,
            digital_outputs: None,
            statusword: inputs,
            position: inputs + 2,
            mode_display: None,
            actual_velocity: None,
            error_code: None,
            torque: None,
            digital_inputs: None,
        }
    }

    /// The axis' objects where a mapping has put them; `offset` is that of the axis in its drive.
    ///
    /// ```
    /// use servocrab::{axis::AxisFields, coe::AxisOffset, drives};
    /// let layout = drives::akd2g().default_mapping()?.layout();
    /// let second = AxisFields::from_layout(&layout, AxisOffset::of_axis(2))?;
    /// assert_eq!((second.controlword, second.statusword), (19, 11));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`FieldError`] if 6040h, 607Ah, 6041h or 6064h is not mapped, or an object is not byte-aligned with its own width.
    pub fn from_layout(layout: &Layout, offset: AxisOffset) -> Result<Self, FieldError> {
        let find = |direction, object: AnyObject| -> Result<Option<usize>, FieldError> {
            let object = object.offset(offset);
            let address = object.address();
            match layout.find(direction, address.index, address.subindex) {
                None => Ok(None),
                Some(place) if place.bit == 0 && place.bits == object.bits() => {
                    Ok(Some(place.byte))
                }
                Some(_) => Err(FieldError::Misplaced { object: address }),
            }
        };
        let output = |object| find(Direction::Outputs, object);
        let input = |object| find(Direction::Inputs, object);
        let must = |direction, object: AnyObject| {
            find(direction, object)?.ok_or(FieldError::Missing {
                object: object.offset(offset).address(),
                direction,
            })
        };
        Ok(Self {
            controlword: must(Direction::Outputs, obj::CONTROLWORD.into())?,
            target: must(Direction::Outputs, obj::TARGET_POSITION.into())?,
            mode: output(obj::MODE_OF_OPERATION.into())?,
            velocity: output(obj::PROFILE_VELOCITY.into())?,
            end_velocity: output(obj::END_VELOCITY.into())?,
            acceleration: output(obj::PROFILE_ACCELERATION.into())?,
            deceleration: output(obj::PROFILE_DECELERATION.into())?,
            profile_type: output(obj::MOTION_PROFILE_TYPE.into())?,
            target_velocity: output(obj::TARGET_VELOCITY.into())?,
            digital_outputs: output(obj::DIGITAL_OUTPUTS.into())?,
            statusword: must(Direction::Inputs, obj::STATUSWORD.into())?,
            position: must(Direction::Inputs, obj::POSITION_ACTUAL.into())?,
            mode_display: input(obj::MODE_OF_OPERATION_DISPLAY.into())?,
            actual_velocity: input(obj::VELOCITY_ACTUAL.into())?,
            error_code: input(obj::ERROR_CODE.into())?,
            torque: input(obj::TORQUE_ACTUAL.into())?,
            digital_inputs: input(obj::DIGITAL_INPUTS.into())?,
        })
    }

    /// The parameters as they go into the process data: given ones, else what the drive held. An end velocity that is not mapped has been
    /// written by SDO; it is kept, for the axis goes on at it.
    pub(super) fn complete(
        &self,
        given: &Parameters,
        held: &Parameters,
    ) -> Result<Parameters, Failure> {
        if given.profile_type.is_some() && self.profile_type.is_none() {
            return Err(not_mapped("motion profile type 6086h"));
        }
        Ok(Parameters {
            velocity: speed(
                self.velocity.is_some(),
                given.velocity,
                held.velocity,
                "profile velocity 6081h",
            )?,
            acceleration: speed(
                self.acceleration.is_some(),
                given.acceleration,
                held.acceleration,
                "profile acceleration 6083h",
            )?,
            deceleration: speed(
                self.deceleration.is_some(),
                given.deceleration,
                held.deceleration,
                "profile deceleration 6084h",
            )?,
            // Left out means what the drive held, and 0 (stop at the target, linear ramps) where nobody has said.
            end_velocity: given
                .end_velocity
                .or(held.end_velocity)
                .or(self.end_velocity.map(|_| 0)),
            profile_type: given
                .profile_type
                .or(held.profile_type)
                .or(self.profile_type.map(|_| 0)),
        })
    }

    /// Without the parameters that go by SDO alone. An end velocity stays: the axis goes on at it, however it is written.
    pub(super) fn mapped(&self, parameters: &Parameters) -> Parameters {
        Parameters {
            velocity: parameters.velocity.filter(|_| self.velocity.is_some()),
            acceleration: parameters
                .acceleration
                .filter(|_| self.acceleration.is_some()),
            deceleration: parameters
                .deceleration
                .filter(|_| self.deceleration.is_some()),
            end_velocity: parameters.end_velocity,
            profile_type: parameters
                .profile_type
                .filter(|_| self.profile_type.is_some()),
        }
    }

    /// The ramps of a jog as they go into the process data: given ones, else what the drive held.
    pub(super) fn complete_jog(
        &self,
        jog: &mut JogSetPoint,
        held: &Parameters,
    ) -> Result<(), Failure> {
        if self.target_velocity.is_none() {
            return Err(not_mapped(TARGET_VELOCITY));
        }
        jog.acceleration = speed(
            self.acceleration.is_some(),
            jog.acceleration,
            held.acceleration,
            "profile acceleration 6083h",
        )?;
        jog.deceleration = speed(
            self.deceleration.is_some(),
            jog.deceleration,
            held.deceleration,
            "profile deceleration 6084h",
        )?;
        Ok(())
    }

    /// Reads the axis' objects out of the drive's inputs; nothing where they are too short.
    pub(crate) fn sample(&self, inputs: &[u8], noted_mode: Mode) -> Option<Sample> {
        let mode = match self.mode_display {
            Some(at) => Mode::from_raw(i8::from_le_bytes(read(inputs, at)?)),
            None => noted_mode,
        };
        let velocity = match self.actual_velocity {
            Some(at) => Some(i32::from_le_bytes(read(inputs, at)?)),
            None => None,
        };
        let error_code = match self.error_code {
            Some(at) => Some(u16::from_le_bytes(read(inputs, at)?)),
            None => None,
        };
        Some(Sample {
            statusword: Statusword::from_bits_retain(u16::from_le_bytes(read(
                inputs,
                self.statusword,
            )?)),
            mode,
            position: i32::from_le_bytes(read(inputs, self.position)?),
            velocity,
            error_code,
        })
    }

    /// Torque actual value 6077h; nothing where it is not mapped, or the inputs are too short.
    pub(super) fn torque_shown(&self, inputs: &[u8]) -> Option<i16> {
        let at = self.torque?;
        Some(i16::from_le_bytes(read(inputs, at)?))
    }

    /// Controlword and target position in the drive's outputs; nothing where they are too short.
    #[cfg(feature = "std")]
    pub(crate) fn sent(&self, outputs: &[u8]) -> Option<(crate::ds402::Controlword, i32)> {
        let controlword = u16::from_le_bytes(read(outputs, self.controlword)?);
        let target = i32::from_le_bytes(read(outputs, self.target)?);
        let controlword = crate::ds402::Controlword::from_bits_retain(controlword);
        Some((controlword, target))
    }

    /// Writes the axis' objects into the drive's outputs. What is not known (parameters that nobody gave) stays.
    pub(super) fn write(
        &self,
        outputs: &mut [u8],
        controlword: ComposedWord,
        mode: CommandedMode,
        target: i32,
        velocity: i32,
        parameters: &Parameters,
    ) {
        put(
            outputs,
            Some(self.controlword),
            Some(controlword.word().bits().to_le_bytes()),
        );
        put(outputs, Some(self.target), Some(target.to_le_bytes()));
        put(outputs, self.target_velocity, Some(velocity.to_le_bytes()));
        put(outputs, self.mode, Some([mode.byte()]));
        put(
            outputs,
            self.velocity,
            parameters.velocity.map(u32::to_le_bytes),
        );
        put(
            outputs,
            self.end_velocity,
            parameters.end_velocity.map(u32::to_le_bytes),
        );
        put(
            outputs,
            self.acceleration,
            parameters.acceleration.map(u32::to_le_bytes),
        );
        put(
            outputs,
            self.deceleration,
            parameters.deceleration.map(u32::to_le_bytes),
        );
        put(
            outputs,
            self.profile_type,
            parameters.profile_type.map(i16::to_le_bytes),
        );
    }
}

/// A parameter that must not be 0 as it goes into the process data, where it is mapped.
const fn speed(
    mapped: bool,
    given: Option<u32>,
    held: Option<u32>,
    name: &'static str,
) -> Result<Option<u32>, Failure> {
    let value = match given {
        None => held,
        given => given,
    };
    match (mapped, given, value) {
        (false, Some(_), _) => Err(not_mapped(name)),
        (false, None, _) => Ok(None),
        (true, _, None) => Err(Failure::Parameter {
            name,
            fault: ParameterFault::Missing,
        }),
        (true, _, Some(0)) => Err(Failure::Parameter {
            name,
            fault: ParameterFault::Zero,
        }),
        (true, _, some) => Ok(some),
    }
}

pub(super) const fn not_mapped(name: &'static str) -> Failure {
    Failure::Parameter {
        name,
        fault: ParameterFault::NotMapped,
    }
}

/// A mapping that an axis cannot work with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FieldError {
    /// An object without which no axis works is not mapped.
    #[error("{object} is not mapped into the {direction}: an axis cannot work without it")]
    Missing {
        /// The object.
        object: ObjectAddress,
        /// Where it belongs.
        direction: Direction,
    },
    /// An object of the axis does not begin at a byte, or has another width than its type.
    #[error("{object} must be mapped with its own width, beginning at a byte")]
    Misplaced {
        /// The object.
        object: ObjectAddress,
    },
}

#[inline]
fn read<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

fn put<const N: usize>(bytes: &mut [u8], at: Option<usize>, value: Option<[u8; N]>) {
    if let (Some(at), Some(value)) = (at, value)
        && let Some(place) = bytes.get_mut(at..).and_then(<[u8]>::first_chunk_mut)
    {
        *place = value;
    }
}
