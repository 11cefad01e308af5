//! Values of the process data with their age.

use core::fmt;

/// A value with its age.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sampled<T> {
    /// The value.
    pub value: T,
    /// Cycles since it came; 0 if the last cycle brought it.
    pub age: u32,
}

/// Inputs that the last cycle did not bring.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the inputs are not of the last cycle: {}", Age(*.age))]
pub struct Stale {
    /// Cycles since they came; none if they never did.
    pub age: Option<u32>,
}

struct Age(Option<u32>);

impl fmt::Display for Age {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            None => f.write_str("none came yet"),
            Some(u32::MAX) => f.write_str("the network has ended"),
            Some(age) => write!(f, "they came {age} cycles earlier"),
        }
    }
}
