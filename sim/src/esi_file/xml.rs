//! The XML of an ESI file: elements, their numbers, and where in the file something is wrong.

use roxmltree::{Document, Node, ParsingOptions};

/// The most bytes and elements of a file that is read.
pub(super) const MOST_BYTES: usize = 32 << 20;
const MOST_NODES: u32 = 4_000_000;
/// Of one element. The reader compares each attribute with all others of its element.
const MOST_ATTRIBUTES: usize = 200;

/// An ESI file that cannot be used: which, where, and why.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: {reason}", line.map(|line| format!(":{line}")).unwrap_or_default())]
pub struct EsiError {
    /// The file.
    pub file: String,
    /// The line, from 1; none if the file as a whole is meant.
    pub line: Option<u32>,
    /// What is wrong.
    pub reason: String,
}

impl EsiError {
    pub(super) fn of_file(file: &str, reason: impl Into<String>) -> Self {
        Self {
            file: file.to_owned(),
            line: None,
            reason: reason.into(),
        }
    }
}

/// The text of a file: UTF-8, or what it says of ISO 8859-1.
pub(super) fn text(file: &str, bytes: &[u8]) -> Result<String, EsiError> {
    if bytes.len() > MOST_BYTES {
        return Err(EsiError::of_file(
            file,
            format!("more than {MOST_BYTES} bytes"),
        ));
    }
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    match core::str::from_utf8(bytes) {
        Ok(text) => Ok(text.to_owned()),
        Err(_)
            if bytes
                .get(..100)
                .unwrap_or(bytes)
                .windows(6)
                .any(|word| word == b"8859-1") =>
        {
            Ok(bytes.iter().map(|byte| char::from(*byte)).collect())
        }
        Err(_) => Err(EsiError::of_file(
            file,
            "neither UTF-8 nor, as it says itself, ISO 8859-1",
        )),
    }
}

pub(super) fn parse<'a>(file: &str, text: &'a str) -> Result<Document<'a>, EsiError> {
    for (number, tag) in text.split('<').enumerate() {
        if tag.split('>').next().unwrap_or(tag).matches('=').count() > MOST_ATTRIBUTES {
            let before = text
                .split('<')
                .take(number)
                .map(|part| part.matches('\n').count());
            return Err(EsiError {
                file: file.to_owned(),
                line: u32::try_from(before.sum::<usize>() + 1).ok(),
                reason: format!("an element with more than {MOST_ATTRIBUTES} attributes"),
            });
        }
    }
    let options = ParsingOptions {
        nodes_limit: MOST_NODES,
        ..ParsingOptions::default()
    };
    Document::parse_with_options(text, options).map_err(|error| EsiError {
        file: file.to_owned(),
        line: Some(error.pos().row),
        reason: error.to_string(),
    })
}

/// What follows `#x`, or `0x` as some makers write it.
pub(super) fn hexadecimal_digits(text: &str) -> Option<&str> {
    let prefixes = ["#x", "#X", "0x", "0X"];
    prefixes.iter().find_map(|prefix| text.strip_prefix(prefix))
}

/// An element and its file.
#[derive(Clone, Copy)]
pub(super) struct Element<'a> {
    file: &'a str,
    node: Node<'a, 'a>,
}

impl<'a> Element<'a> {
    pub(super) fn root(file: &'a str, document: &'a Document<'a>) -> Self {
        let node = document.root_element();
        Self { file, node }
    }

    pub(super) fn is(&self, name: &str) -> bool {
        self.node.has_tag_name(name)
    }

    /// The children of this name.
    pub(super) fn all(&self, name: &'static str) -> impl Iterator<Item = Self> + use<'a> {
        let file = self.file;
        let children = self.node.children();
        children
            .filter(move |node| node.has_tag_name(name))
            .map(move |node| Self { file, node })
    }

    /// The first element at the end of this path.
    pub(super) fn at(&self, path: &[&'static str]) -> Option<Self> {
        path.iter()
            .try_fold(*self, |element, name| element.all(name).next())
    }

    pub(super) fn need(&self, name: &'static str) -> Result<Self, EsiError> {
        let missing = || self.error(format!("the element {name} is missing"));
        self.at(&[name]).ok_or_else(missing)
    }

    pub(super) fn text(&self) -> &'a str {
        self.node.text().unwrap_or_default().trim()
    }

    /// The text of a child; empty without it.
    pub(super) fn text_of(&self, name: &'static str) -> &'a str {
        self.at(&[name])
            .map(|child| child.text())
            .unwrap_or_default()
    }

    pub(super) fn attribute(&self, name: &str) -> Option<&'a str> {
        self.node.attribute(name).map(str::trim)
    }

    pub(super) fn is_set(&self, name: &str) -> bool {
        matches!(self.attribute(name), Some("1" | "true"))
    }

    pub(super) fn number<T: TryFrom<u32>>(&self) -> Result<T, EsiError> {
        self.parsed(self.text())
    }

    /// The number of a child, when there is one.
    pub(super) fn number_of<T: TryFrom<u32>>(
        &self,
        name: &'static str,
    ) -> Result<Option<T>, EsiError> {
        self.at(&[name]).map(|child| child.number()).transpose()
    }

    /// The number of an attribute, when there is one.
    pub(super) fn attribute_number<T: TryFrom<u32>>(
        &self,
        name: &str,
    ) -> Result<Option<T>, EsiError> {
        self.attribute(name)
            .map(|text| self.parsed(text))
            .transpose()
    }

    fn parsed<T: TryFrom<u32>>(&self, text: &str) -> Result<T, EsiError> {
        let number = match hexadecimal_digits(text) {
            Some(digits) => u32::from_str_radix(digits, 16),
            None => text.parse(),
        };
        let wrong = || {
            let most = 256_u64.pow(size_of::<T>() as u32) - 1;
            let text: String = text.chars().take(40).collect();
            self.error(format!("{text:?} is no number of 0 to {most}"))
        };
        number
            .ok()
            .and_then(|number| T::try_from(number).ok())
            .ok_or_else(wrong)
    }

    pub(super) fn error(&self, reason: impl Into<String>) -> EsiError {
        let start = self.node.range().start;
        EsiError {
            file: self.file.to_owned(),
            line: Some(self.node.document().text_pos_at(start).row),
            reason: reason.into(),
        }
    }
}
