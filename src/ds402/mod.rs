//! The DS402 device profile: words, states, transitions, modes, option codes, error codes.
//!
//! Everything here is pure: values in, values out. The states are decoded from *this* cycle's statusword
//! and never remembered.

mod error_code;
mod mode;
mod option_code;
mod power;
mod sample;
mod signals;
mod words;

pub use error_code::describe as describe_error_code;
pub use mode::{Mode, SupportedModes};
pub use option_code::{AbortConnection, QuickStopOption, StopOptions, VelocityWindows};
pub use power::{PowerCommand, PowerGoal, next_command};
pub use sample::Sample;
pub use signals::{DigitalInputs, DigitalOutputs, TouchProbeFunction, TouchProbeStatus};
pub use words::{Controlword, State, Statusword};
