//! How a device came back: what was found, and what was done.

use std::fmt;

use super::super::AlStatus;

/// How a device has come back into OP.
///
/// ```
/// use servocrab::bus::{AlState, AlStatus, Recovered};
/// let from = AlStatus { state: AlState::SafeOp, error: Some(0x001B) };
/// let text = Recovered::LedBack { from }.to_string();
/// assert!(text.starts_with("led back into OP from SAFEOP with AL status code 001Bh"), "{text}");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recovered {
    /// It was in OP, and nothing was done.
    WasInOp,
    /// It had left OP and kept its power: the error was acknowledged, and it was led back. It holds what it held, all
    /// parameters and modes, and where it has been homed.
    LedBack {
        /// What it was found in.
        from: AlStatus,
    },
    /// It had lost its power or was set back, or had left SAFEOP: it was brought up as at the start. What was written to it since
    /// then and not stored in it is gone: parameters, the mode, where it had been homed. What its start-up lists write
    /// it has again.
    BroughtUp {
        /// Where in the line it is now: not where it was at the start if devices before it are missing.
        position: u16,
        /// The AL state that it was found in, if it had kept its station address; else it has been without power.
        from: Option<AlStatus>,
    },
}

impl fmt::Display for Recovered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WasInOp => f.write_str("in OP: nothing was done"),
            Self::LedBack { from } => write!(f, "led back into OP from {from}"),
            Self::BroughtUp { position, from } => {
                write!(f, "brought up anew into OP at position {position}, ")?;
                match from {
                    Some(from) => write!(f, "from {from}"),
                    None => f.write_str("after it was without power"),
                }
            }
        }
    }
}
