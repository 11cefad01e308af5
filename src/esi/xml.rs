//! The XML below an ESI file: bounds that hold whatever is in it, and elements with their numbers.

use std::borrow::Cow;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use roxmltree::{Document, Node, ParsingOptions};

use super::error::{EsiError, EsiFault};

/// The most bytes of a file that is read. Real files have up to some ten million.
pub const MOST_BYTES: usize = 32 << 20;
/// Elements, texts and comments together.
const MOST_NODES: u32 = 2_000_000;
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
    Document::parse_with_options(text, options).map_err(|error| EsiError {
        file: file.to_owned(),
        line: Some(error.pos().row),
        element: None,
        fault: EsiFault::Xml(quoted_to(&error.to_string(), 200)),
    })
}

/// An element and the file in which it is.
#[derive(Clone, Copy)]
pub(super) struct Element<'a> {
    file: &'a str,
    node: Node<'a, 'a>,
}

impl<'a> Element<'a> {
    pub(super) fn root(file: &'a str, document: &'a Document<'a>) -> Self {
        Self {
            file,
            node: document.root_element(),
        }
    }

    pub(super) fn name(&self) -> &'a str {
        self.node.tag_name().name()
    }

    pub(super) fn children(&self, name: &'static str) -> impl Iterator<Item = Self> + use<'a> {
        let file = self.file;
        self.node
            .children()
            .filter(move |node| node.is_element() && node.tag_name().name() == name)
            .map(move |node| Self { file, node })
    }

    pub(super) fn child(&self, name: &'static str) -> Option<Self> {
        self.children(name).next()
    }

    pub(super) fn need(&self, name: &'static str) -> Result<Self, EsiError> {
        self.child(name)
            .ok_or_else(|| self.error(EsiFault::Missing(name)))
    }

    pub(super) fn text(&self) -> &'a str {
        self.node.text().unwrap_or_default().trim()
    }

    /// The text of a child; empty without it. Of several (languages) the first.
    pub(super) fn text_of(&self, name: &'static str) -> String {
        self.child(name)
            .map(|child| child.text().to_owned())
            .unwrap_or_default()
    }

    pub(super) fn attribute(&self, name: &str) -> Option<&'a str> {
        self.node.attribute(name)
    }

    /// Whether an attribute says yes.
    pub(super) fn flag(&self, name: &str) -> bool {
        matches!(self.attribute(name).map(str::trim), Some("1" | "true"))
    }

    pub(super) fn number<T: TryFrom<u32> + Max>(&self) -> Result<T, EsiError> {
        self.parsed(self.text())
    }

    /// The number of a child.
    pub(super) fn number_of<T: TryFrom<u32> + Max>(
        &self,
        name: &'static str,
    ) -> Result<Option<T>, EsiError> {
        self.child(name).map(|child| child.number()).transpose()
    }

    /// The number of an attribute.
    pub(super) fn attribute_number<T: TryFrom<u32> + Max>(
        &self,
        name: &str,
    ) -> Result<Option<T>, EsiError> {
        self.attribute(name)
            .map(|text| self.parsed(text))
            .transpose()
    }

    /// The bytes that its text writes in hexadecimal digits.
    pub(super) fn bytes(&self) -> Result<Vec<u8>, EsiError> {
        let text = self.text();
        let wrong = || self.error(EsiFault::Bytes(quoted_to(text, QUOTED)));
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

    pub(super) fn error(&self, fault: EsiFault) -> EsiError {
        let document = self.node.document();
        EsiError {
            file: self.file.to_owned(),
            line: Some(document.text_pos_at(self.node.range().start).row),
            element: Some(quoted_to(self.name(), QUOTED)),
            fault,
        }
    }

    fn parsed<T: TryFrom<u32> + Max>(&self, text: &str) -> Result<T, EsiError> {
        let text = text.trim();
        let number = match text.strip_prefix("#x").or_else(|| text.strip_prefix("#X")) {
            Some(digits) if digits.bytes().all(|digit| digit.is_ascii_hexdigit()) => {
                u32::from_str_radix(digits, 16).ok()
            }
            Some(_) => None,
            None => text.parse().ok(),
        };
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

fn quoted_to(text: &str, most: usize) -> String {
    text.chars().take(most).collect()
}
