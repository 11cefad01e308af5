//! The DS402 device profile: words, states, transitions, modes, option codes, error codes.
//!
//! Everything here is pure: values in, values out. The states are decoded from *this* cycle's statusword
//! and never remembered.

mod error_code;
mod mode;
mod words;

pub use error_code::describe as describe_error_code;
pub use mode::{
    AbortConnection, FollowingErrorWindow, Mode, QuickStopOption, StopOptions, SupportedModes,
    VelocityWindows,
};
pub(crate) use words::mode_bits::{ModeBits, SetPointBits};
pub use words::{
    Controlword, DigitalInput, DigitalInputs, DigitalOutput, DigitalOutputs, PowerCommand,
    PowerGoal, Sample, State, Statusword, TouchProbeFunction, TouchProbeStatus, next_command,
};
