//! The XML below an ESI file: bounds that hold whatever is in it, and elements with their numbers.

use std::borrow::Cow;
use std::cell::RefCell;
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use roxmltree::{Document, Node, ParsingOptions};

// What is wrong with an ESI file, and where.

/// An ESI file that cannot be read: file, line, element and reason.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: {fault}", LineAndElement(*.line, .element))]
#[non_exhaustive]
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

struct LineAndElement<'a>(Option<u32>, &'a Option<String>);

impl fmt::Display for LineAndElement<'_> {
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
    /// It ends within an element.
    #[error(
        "the file ends here, before its outermost element does: it was cut off, so copy it again"
    )]
    Truncated,
    /// It has a document type definition, which no ESI file needs.
    #[error(
        "the file has a document type definition, which is not read: take the line that begins with <!DOCTYPE out of it"
    )]
    TypeDefinition,
    /// It is no XML, or has more elements than are read.
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
    /// A number as C writes it. It is read as hexadecimal: see [`Esi::warnings`](super::Esi::warnings).
    #[error("`{0}` is no number as ETG.2000 has them: it is read as hexadecimal, which #x says")]
    CNumber(String),
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
        super::device::MOST_ENTRIES
    )]
    TooManyEntries,
}

/// The most bytes of a file that is read. Real files have up to some ten million.
pub const MOST_BYTES: usize = 32 << 20;
/// Elements, texts and comments together.
const MOST_NODES: u32 = 4_000_000;
/// Declarations of namespaces in the whole file; each costs memory in every element below.
const MOST_NAMESPACES: usize = 32;
/// Attributes of one element, which are compared each with each.
const MOST_ATTRIBUTES: usize = 1024;
/// Characters that a message quotes.
const QUOTED: usize = 40;

/// The content of a file, unless it is too large.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, EsiFault> {
    let unreadable = |error: std::io::Error| EsiFault::Unreadable(error.to_string());
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(unreadable)?;
    let most = u64::try_from(MOST_BYTES).unwrap_or(u64::MAX);
    file.take(most.saturating_add(1))
        .read_to_end(&mut bytes)
        .map_err(unreadable)?;
    Ok(bytes)
}

/// The text of a file.
pub(super) fn decode(bytes: &[u8]) -> Result<Cow<'_, str>, EsiFault> {
    if bytes.len() > MOST_BYTES {
        return Err(EsiFault::TooLarge);
    }
    let bytes = bytes.strip_prefix(&[0xEF, 0xBB, 0xBF]).unwrap_or(bytes);
    if let Ok(text) = std::str::from_utf8(bytes) {
        return Ok(Cow::Borrowed(text));
    }
    let head = String::from_utf8_lossy(bytes.get(..200).unwrap_or(bytes)).to_lowercase();
    let declaration = head.split("?>").next().unwrap_or_default();
    if declaration.contains("iso-8859-1") || declaration.contains("windows-1252") {
        // The first 256 characters of Unicode are those of ISO 8859-1.
        return Ok(Cow::Owned(
            bytes.iter().map(|byte| char::from(*byte)).collect(),
        ));
    }
    Err(EsiFault::Encoding)
}

/// The elements of a text.
pub(super) fn parse<'a>(file: &str, text: &'a str) -> Result<Document<'a>, EsiError> {
    if text.matches("xmlns").count() > MOST_NAMESPACES {
        return Err(EsiError::of_file(file, EsiFault::Excessive("namespaces")));
    }
    let attributes = |part: &str| part.bytes().filter(|byte| *byte == b'=').count();
    if text
        .split('<')
        .any(|part| attributes(part) > MOST_ATTRIBUTES)
    {
        return Err(EsiError::of_file(
            file,
            EsiFault::Excessive("attributes of one element"),
        ));
    }
    let options = ParsingOptions {
        nodes_limit: MOST_NODES,
        ..ParsingOptions::default()
    };
    Document::parse_with_options(text, options).map_err(|error| {
        let (line, fault) = match error {
            // Their position is always the first line.
            roxmltree::Error::UnexpectedEndOfStream | roxmltree::Error::UnclosedRootNode => {
                (text.lines().count(), EsiFault::Truncated)
            }
            roxmltree::Error::DtdDetected => {
                let before = text.split("<!DOCTYPE").next().unwrap_or_default();
                let line = before.matches('\n').count().saturating_add(1);
                (line, EsiFault::TypeDefinition)
            }
            error => (
                error.pos().row as usize,
                EsiFault::Xml(quoted_to(&error.to_string(), 200)),
            ),
        };
        EsiError {
            file: file.to_owned(),
            line: u32::try_from(line.max(1)).ok(),
            element: None,
            fault,
        }
    })
}

/// A file that is being read.
pub(super) struct Source<'a> {
    name: &'a str,
    /// The first number that is written as C has it.
    c_number: RefCell<Option<EsiError>>,
}

impl<'a> Source<'a> {
    pub const fn new(name: &'a str) -> Self {
        Self {
            name,
            c_number: RefCell::new(None),
        }
    }

    pub fn into_c_number(self) -> Option<EsiError> {
        self.c_number.into_inner()
    }
}

/// An element and the file in which it is.
#[derive(Clone, Copy)]
pub(super) struct Element<'a> {
    file: &'a Source<'a>,
    node: Node<'a, 'a>,
}

impl<'a> Element<'a> {
    pub fn root(file: &'a Source<'a>, document: &'a Document<'a>) -> Self {
        Self {
            file,
            node: document.root_element(),
        }
    }

    pub fn name(&self) -> &'a str {
        self.node.tag_name().name()
    }

    pub fn children(&self, name: &'static str) -> impl Iterator<Item = Self> + use<'a> {
        let file = self.file;
        self.node
            .children()
            .filter(move |node| node.is_element() && node.tag_name().name() == name)
            .map(move |node| Self { file, node })
    }

    pub fn child(&self, name: &'static str) -> Option<Self> {
        self.children(name).next()
    }

    pub fn need(&self, name: &'static str) -> Result<Self, EsiError> {
        self.child(name)
            .ok_or_else(|| self.error(EsiFault::Missing(name)))
    }

    /// Its text. A comment may stand in it.
    pub fn text(&self) -> Cow<'a, str> {
        let mut texts = self.node.children().filter_map(|child| child.text());
        let first = texts.next().unwrap_or_default();
        let rest: String = texts.collect();
        if rest.is_empty() {
            Cow::Borrowed(first.trim())
        } else {
            Cow::Owned((first.to_owned() + &rest).trim().to_owned())
        }
    }

    /// The text of a child; empty without it. Of several (languages) the first.
    pub fn text_of(&self, name: &'static str) -> String {
        self.child(name)
            .map(|child| child.text().into_owned())
            .unwrap_or_default()
    }

    pub fn attribute(&self, name: &str) -> Option<&'a str> {
        self.node.attribute(name)
    }

    /// Whether an attribute says yes.
    pub fn flag(&self, name: &str) -> bool {
        matches!(self.attribute(name).map(str::trim), Some("1" | "true"))
    }

    pub fn number<T: TryFrom<u32> + Max>(&self) -> Result<T, EsiError> {
        self.parsed(&self.text())
    }

    /// The number of a child.
    pub fn number_of<T: TryFrom<u32> + Max>(
        &self,
        name: &'static str,
    ) -> Result<Option<T>, EsiError> {
        self.child(name).map(|child| child.number()).transpose()
    }

    /// The number of an attribute.
    pub fn attribute_number<T: TryFrom<u32> + Max>(
        &self,
        name: &str,
    ) -> Result<Option<T>, EsiError> {
        self.attribute(name)
            .map(|text| self.parsed(text))
            .transpose()
    }

    /// The bytes that its text writes in hexadecimal digits.
    pub fn bytes(&self) -> Result<Vec<u8>, EsiError> {
        let text = self.text();
        let wrong = || self.error(EsiFault::Bytes(quoted_to(&text, QUOTED)));
        let digits: Option<Vec<u32>> = text
            .chars()
            .filter(|digit| !digit.is_whitespace())
            .map(|digit| digit.to_digit(16))
            .collect();
        let digits = digits.ok_or_else(wrong)?;
        let pairs = digits.chunks_exact(2);
        if !pairs.remainder().is_empty() {
            return Err(wrong());
        }
        Ok(pairs
            .map(|pair| pair.iter().fold(0, |byte, digit| byte << 4 | *digit as u8))
            .collect())
    }

    pub fn error(&self, fault: EsiFault) -> EsiError {
        let document = self.node.document();
        EsiError {
            file: self.file.name.to_owned(),
            line: Some(document.text_pos_at(self.node.range().start).row),
            element: Some(quoted_to(self.name(), QUOTED)),
            fault,
        }
    }

    fn parsed<T: TryFrom<u32> + Max>(&self, text: &str) -> Result<T, EsiError> {
        let text = text.trim();
        let prefixes = ["#x", "#X", "0x", "0X"];
        let hexadecimal = prefixes.iter().find_map(|x| text.strip_prefix(x));
        let number = match hexadecimal {
            Some(digits) if digits.bytes().all(|digit| digit.is_ascii_hexdigit()) => {
                u32::from_str_radix(digits, 16).ok()
            }
            Some(_) => None,
            None => text.parse().ok(),
        };
        if hexadecimal.is_some() && text.starts_with('0') {
            let first = &mut *self.file.c_number.borrow_mut();
            first.get_or_insert_with(|| self.error(EsiFault::CNumber(quoted_to(text, QUOTED))));
        }
        number
            .and_then(|number| T::try_from(number).ok())
            .ok_or_else(|| {
                self.error(EsiFault::Number {
                    max: T::MAX,
                    got: quoted_to(text, QUOTED),
                })
            })
    }
}

/// The greatest number of a type.
pub(super) trait Max {
    const MAX: u32;
}

impl Max for u8 {
    const MAX: u32 = u8::MAX as u32;
}

impl Max for u16 {
    const MAX: u32 = u16::MAX as u32;
}

impl Max for u32 {
    const MAX: u32 = u32::MAX;
}

/// A text of the file as a message quotes it.
pub(super) fn quoted(text: &str) -> String {
    quoted_to(text, QUOTED)
}

fn quoted_to(text: &str, most: usize) -> String {
    text.chars().take(most).collect()
}
