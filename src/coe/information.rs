//! SDO information: what a device says about its object dictionary, as a dialogue without I/O. The bytes are those behind the CoE
//! header of a message (ETG.1000.6, SDO information).
//!
//! One request is answered by one or several fragments. The caller sends [`Inquiry::append_request`], hands each SDO
//! information message to [`Inquiry::feed`] until that says [`Step::Done`], and decodes [`Inquiry::into_data`].
//!
//! An inquiry holds at most four times the bytes that came (the doubling of a growing list, and its copy) beside the buffer that it
//! was given. It never holds more than an answer of [`LONGEST_INFORMATION`], or [`LONGEST_DESCRIPTION`] where one object is asked
//! for. What is decoded from an answer takes at most eight times its bytes. Each fragment says fewer to follow than the one before,
//! so that they end.

use alloc::vec::Vec;

use super::abort::AbortCode;
use super::mailbox::CutMail;
use super::sdo::{SdoFault, Step};

mod describe;
mod list;
#[cfg(test)]
mod tests;

pub use describe::{EntryAccess, EntryDescription, ObjectCode, ObjectDescription};
pub use list::{ListKind, ObjectCounts, object_counts, object_list};

/// Operation, reserved byte, fragments left.
const HEADER: usize = 4;
/// Bit 7 of the operation: more fragments follow.
const INCOMPLETE: u8 = 0x80;
const ERROR: u8 = 7;
/// The longest answer that is taken: a list with its kind and every index there can be.
pub const LONGEST_INFORMATION: usize = 2 + 2 * 0x1_0000;
/// The longest description of an object or an entry that is taken: three values of the greatest width, and a name.
pub const LONGEST_DESCRIPTION: usize = 0x8000;

/// What is asked of a device's dictionary.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Question {
    /// How many objects each list has.
    Counts,
    /// The indices of the objects of a list.
    List(ListKind),
    /// What an object is.
    Object {
        /// Its index.
        index: u16,
    },
    /// What an entry of an object is.
    Entry {
        /// The object's index.
        index: u16,
        /// The entry's subindex.
        subindex: u8,
        /// What is wanted beside type, length and access: bit 3 unit, 4 default, 5 minimum, 6 maximum; bits 0 to 2 ask for
        /// what always comes.
        wanted: u8,
    },
}

impl Question {
    /// [`Question::Entry`]'s `wanted`: everything.
    pub const EVERYTHING: u8 = 0x7F;
    /// [`Question::Entry`]'s `wanted`: what every device can report.
    pub const BASICS: u8 = 0x07;

    const fn operation(self) -> u8 {
        match self {
            Self::Counts | Self::List(_) => 1,
            Self::Object { .. } => 3,
            Self::Entry { .. } => 5,
        }
    }

    /// The longest answer that is taken.
    const fn longest(self) -> usize {
        match self {
            Self::Counts | Self::List(_) => LONGEST_INFORMATION,
            Self::Object { .. } | Self::Entry { .. } => LONGEST_DESCRIPTION,
        }
    }

    /// The bytes of the answer that repeat the question, which come in its first fragment.
    fn names(self) -> ([u8; 3], usize) {
        match self {
            Self::Counts => ([0, 0, 0], 2),
            Self::List(kind) => ([kind as u8, 0, 0], 2),
            Self::Object { index } => {
                let [i0, i1] = index.to_le_bytes();
                ([i0, i1, 0], 2)
            }
            Self::Entry {
                index, subindex, ..
            } => {
                let [i0, i1] = index.to_le_bytes();
                ([i0, i1, subindex], 3)
            }
        }
    }
}

/// One question and its answer.
///
/// ```
/// use servocrab::coe::{information::{Inquiry, ObjectDescription, Question}, sdo::Step};
///
/// let mut inquiry = Inquiry::new(Question::Object { index: 0x1000 });
/// let mut request = Vec::new();
/// inquiry.append_request(&mut request);
/// assert_eq!(request, [3, 0, 0, 0, 0x00, 0x10]);
/// let step = inquiry.feed(b"\x04\0\0\0\x00\x10\x07\x00\x00\x07Device type")?;
/// assert_eq!(step, Step::Done);
/// let object = ObjectDescription::parse(&inquiry.into_data())?;
/// assert_eq!((object.index, object.name.as_str()), (0x1000, "Device type"));
/// # Ok::<(), servocrab::coe::sdo::SdoFault>(())
/// ```
#[derive(Debug, Clone)]
pub struct Inquiry {
    question: Question,
    data: Vec<u8>,
    /// Fragments that must still come; none before the first.
    left: Option<u16>,
}

impl Inquiry {
    /// The asking of `question`.
    #[must_use]
    pub const fn new(question: Question) -> Self {
        Self {
            question,
            data: Vec::new(),
            left: None,
        }
    }

    /// Puts the answer into `buffer`, in place of what it holds: nothing is allocated as long as it fits.
    #[must_use]
    pub fn with_buffer(mut self, mut buffer: Vec<u8>) -> Self {
        buffer.clear();
        self.data = buffer;
        self
    }

    /// Appends the request. It is sent once; further fragments come unasked.
    pub fn append_request(&self, request: &mut Vec<u8>) {
        request.extend_from_slice(&[self.question.operation(), 0, 0, 0]);
        let (names, length) = self.question.names();
        request.extend(names.iter().take(length));
        if let Question::Entry { wanted, .. } = self.question {
            request.push(wanted);
        }
    }

    /// Whether fragments have come, and more must.
    #[must_use]
    pub fn is_under_way(&self) -> bool {
        self.left.is_some_and(|left| left > 0)
    }

    /// Takes one SDO information message.
    ///
    /// # Errors
    /// [`SdoFault`]: the device refuses (`Aborted`), a fragment is missing or too many come (`Fragments`), the answer is
    /// longer than any can be (`Size`), or the message ends before its headers do (`Cut`). The inquiry is then over.
    pub fn feed(&mut self, mail: &[u8]) -> Result<Step, SdoFault> {
        let &[operation, _, l0, l1, ref data @ ..] = mail else {
            return Err(cut(HEADER, mail.len()));
        };
        let left = u16::from_le_bytes([l0, l1]);
        let incomplete = operation & INCOMPLETE != 0;
        match operation & !INCOMPLETE {
            ERROR => {
                let &[c0, c1, c2, c3, ..] = data else {
                    return Err(cut(HEADER + 4, mail.len()));
                };
                let code = u32::from_le_bytes([c0, c1, c2, c3]);
                return Err(SdoFault::Aborted(AbortCode(code)));
            }
            operation if operation == self.question.operation() + 1 => {}
            _ => return Ok(Step::Foreign),
        }
        match self.left {
            None => {
                let (names, length) = self.question.names();
                let Some(named) = data.get(..length) else {
                    return Err(cut(HEADER + length, mail.len()));
                };
                if names.get(..length) != Some(named) {
                    return Ok(Step::Foreign);
                }
            }
            Some(before) => {
                let expected = before.saturating_sub(1);
                if left != expected {
                    return Err(SdoFault::Fragments {
                        expected,
                        got: left,
                    });
                }
            }
        }
        // A device may leave bit 7 out; one that sets it with nothing left contradicts itself.
        if incomplete && left == 0 {
            return Err(SdoFault::Fragments {
                expected: 1,
                got: 0,
            });
        }
        let got = self.data.len() + data.len();
        let expected = self.question.longest();
        if got > expected {
            return Err(SdoFault::Size { expected, got });
        }
        self.left = Some(left);
        self.data.extend_from_slice(data);
        Ok(if left == 0 { Step::Done } else { Step::More })
    }

    /// How many bytes of the answer have come.
    #[must_use]
    pub const fn received(&self) -> usize {
        self.data.len()
    }

    /// The answer, complete once [`Inquiry::feed`] said [`Step::Done`].
    #[must_use]
    pub fn into_data(self) -> Vec<u8> {
        self.data
    }
}

const fn cut(needed: usize, got: usize) -> SdoFault {
    SdoFault::Cut(CutMail { needed, got })
}
