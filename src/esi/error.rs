//! What is wrong with an ESI file, and where.

use std::fmt;

/// An ESI file that cannot be read: file, line, element and reason.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: {fault}", Place(*.line, .element))]
pub struct EsiError {
    /// The file.
    pub file: String,
    /// The line, from 1, where it is known.
    pub line: Option<u32>,
    /// The element, where it is known.
    pub element: Option<String>,
    /// The reason.
    pub fault: EsiFault,
}

impl EsiError {
    pub(super) fn of_file(file: &str, fault: EsiFault) -> Self {
        Self {
            file: file.to_owned(),
            line: None,
            element: None,
            fault,
        }
    }
}

struct Place<'a>(Option<u32>, &'a Option<String>);

impl fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(line) = self.0 {
            write!(f, ":{line}")?;
        }
        if let Some(element) = self.1 {
            write!(f, ", element {element}")?;
        }
        Ok(())
    }
}

/// What is wrong with an ESI file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EsiFault {
    /// The file cannot be read.
    #[error("the file cannot be read: {0}")]
    Unreadable(String),
    /// The file is larger than any that is read.
    #[error("the file has more than {} bytes", super::MOST_BYTES)]
    TooLarge,
    /// It is neither UTF-8 nor said to be ISO 8859-1.
    #[error(
        "the text is no UTF-8, and no other encoding that is understood is named: save the file as UTF-8"
    )]
    Encoding,
    /// It is no XML, has a document type definition, or more elements than are read.
    #[error("{0}")]
    Xml(String),
    /// It is XML with more namespaces or attributes than an ESI file has.
    #[error("more {0} than an ESI file has")]
    Excessive(&'static str),
    /// It is XML of another kind.
    #[error("expected EtherCATInfo as the outermost element: this is no ESI file")]
    NoEsi,
    /// An element is missing.
    #[error("the element {0} is missing")]
    Missing(&'static str),
    /// A number was expected.
    #[error(
        "expected a number (decimal, or #x and hexadecimal digits) of at most {max}, got `{got}`"
    )]
    Number {
        /// The greatest number that fits there.
        max: u32,
        /// What is there, cut to 40 characters.
        got: String,
    },
    /// Bytes in hexadecimal digits were expected.
    #[error("expected bytes as pairs of hexadecimal digits, got `{0}`")]
    Bytes(String),
    /// A PDO index out of its range.
    #[error(
        "expected an index of 1600h to 17FFh for an RxPDO and of 1A00h to 1BFFh for a TxPDO, got {0:04X}h"
    )]
    PdoIndex(u16),
    /// A PDO with more entries than a mapping object has room for.
    #[error("PDO {0:04X}h has more than 254 entries")]
    LongPdo(u16),
    /// A device has more slots than are read.
    #[error("the device has more than 255 slots")]
    TooManySlots,
    /// The dictionaries have more entries than are read.
    #[error(
        "the dictionaries have more entries than are read ({})",
        super::dictionary::MOST_ENTRIES
    )]
    TooManyEntries,
}
