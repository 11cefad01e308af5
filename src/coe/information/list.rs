//! Lists of objects.

use alloc::vec::Vec;

use super::cut;
use crate::coe::sdo::SdoFault;

/// Which objects a list has (ETG.1000.6, list types).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum ListKind {
    /// All objects.
    All = 1,
    /// Those that can be mapped into an RxPDO (outputs).
    Outputs = 2,
    /// Those that can be mapped into a TxPDO (inputs).
    Inputs = 3,
    /// Those that must be kept when the device is replaced.
    Backup = 4,
    /// Those that are written at start-up.
    Settings = 5,
}

/// How many objects each list has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ObjectCounts {
    /// All objects.
    pub all: u16,
    /// Those of [`ListKind::Outputs`].
    pub outputs: u16,
    /// Those of [`ListKind::Inputs`].
    pub inputs: u16,
    /// Those of [`ListKind::Backup`].
    pub backup: u16,
    /// Those of [`ListKind::Settings`].
    pub settings: u16,
}

/// The indices in the answer to [`Question::List`](super::Question::List), in the device's order.
///
/// # Errors
/// [`SdoFault::Cut`] if the answer does not end with a whole index.
pub fn object_list(answer: &[u8]) -> Result<Vec<u16>, SdoFault> {
    let (words, rest) = answer.as_chunks::<2>();
    if words.is_empty() || !rest.is_empty() {
        return Err(cut(2 * words.len() + 2, answer.len()));
    }
    // The first word is the kind of list.
    Ok(words
        .iter()
        .skip(1)
        .map(|word| u16::from_le_bytes(*word))
        .collect())
}

/// The answer to [`Question::Counts`](super::Question::Counts).
///
/// # Errors
/// [`SdoFault::Cut`] if it has fewer than five counts.
pub fn object_counts(answer: &[u8]) -> Result<ObjectCounts, SdoFault> {
    let words = object_list(answer)?;
    let &[all, outputs, inputs, backup, settings, ..] = words.as_slice() else {
        return Err(cut(12, answer.len()));
    };
    Ok(ObjectCounts {
        all,
        outputs,
        inputs,
        backup,
        settings,
    })
}
