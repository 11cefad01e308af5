//! Where an axis' objects lie in its drive's process data.

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
            statusword: inputs,
            position: inputs + 2,
            mode_display: None,
            actual_velocity: None,
            error_code: None,
        }
    }
}
