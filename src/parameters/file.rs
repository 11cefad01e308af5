//! Start-up lists as TOML files, and what parameter files have in common with them.
//!
//! ```toml
//! drive = "gantry left"                  # for messages; may be left out
//!
//! [[write]]
//! object = "quick stop deceleration"     # an object of `coe::obj` by its name, and so its type …
//! axis = 2                               # 1 if left out
//! value = 1_000_000
//! comment = "as tried out with the full load"
//! verify = true                          # false if left out
//!
//! [[write]]
//! object = "2345h:01"                    # … or any object by index and subindex, both in hexadecimal
//! type = "u16"                           # u8 … i64, f32, string, bytes
//! value = 7
//! transition = "SAFEOP-OP"               # PREOP-SAFEOP if left out
//! ```

use std::fmt;
use std::io::Read;
use std::ops::Range;
use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use toml::Spanned;

use super::raw_value::RawValue;
use super::start_up::{StartUpList, StartUpWrite, Transition, is_controlword};
use super::value::{ObjectValue, ValueType};
use crate::coe::{AxisOffset, ObjectAddress, obj};

/// The longest file that is read or written: some ten thousand parameters, more than any drive has.
///
/// Reading one takes about 60 bytes of memory for each of its bytes, and never more than 768, whatever is in it. Tables within
/// tables cost most: they are read before it is known that none belongs there.
pub const LONGEST_FILE: usize = 1 << 20;

/// A file that could not be used: which, where, and why.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}: {kind}", Place(self))]
pub struct FileError {
    /// The file, as it was named.
    pub file: String,
    /// The line, from 1; none if the file as a whole is meant.
    pub line: Option<usize>,
    /// The drive, where the file names it.
    pub drive: Option<String>,
    /// The object of the line, as the file names it.
    pub object: Option<String>,
    /// What is wrong.
    #[source]
    pub kind: FileFault,
}

struct Place<'a>(&'a FileError);

impl fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let error = self.0;
        f.write_str(&error.file)?;
        if let Some(line) = error.line {
            write!(f, ":{line}")?;
        }
        if let Some(drive) = &error.drive {
            write!(f, ": drive \"{drive}\"")?;
        }
        if let Some(object) = &error.object {
            write!(f, ": object \"{object}\"")?;
        }
        Ok(())
    }
}

/// What is wrong with a file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FileFault {
    /// It cannot be read or written.
    #[error("{0}")]
    Io(String),
    /// It is longer than [`LONGEST_FILE`].
    #[error("more than {LONGEST_FILE} bytes")]
    TooLong,
    /// It is no TOML, or has keys that are not expected or lacks others.
    #[error("{0}")]
    Toml(String),
    /// The object is neither index and subindex nor a name.
    #[error(
        "neither index and subindex, such as \"6081h:00\", nor the name of an object that the library knows"
    )]
    UnknownObject,
    /// The axis is not one of eight.
    #[error("axis {0} is not 1 to 8")]
    Axis(u8),
    /// The type of an object that the library does not know is missing.
    #[error("its type is not known: give it, such as type = \"u32\"")]
    NoType,
    /// The type or the transition is not known.
    #[error("{0}")]
    Word(String),
    /// The value is none of the type.
    #[error("expected {expected}, got {got}")]
    Value {
        /// The type.
        expected: ValueType,
        /// What the file says.
        got: String,
    },
    /// The controlword is written.
    #[error("the controlword is no parameter: enable the axis by its handle")]
    Controlword,
    /// An object that commands or records, and that a restore must not write.
    #[error("this object is a command or a record, and no parameter")]
    NoParameter,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawList {
    drive: Option<String>,
    #[serde(default)]
    write: Vec<Spanned<RawWrite>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawWrite {
    object: Spanned<String>,
    axis: Option<Spanned<u8>>,
    #[serde(rename = "type")]
    kind: Option<Spanned<String>>,
    value: Spanned<RawValue>,
    #[serde(default)]
    comment: String,
    transition: Option<Spanned<String>>,
    #[serde(default)]
    verify: bool,
}

impl StartUpList {
    /// Reads a list from a TOML file.
    ///
    /// # Errors
    /// [`FileError`]: file, line, drive and object, and what is wrong there.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, FileError> {
        let path = path.as_ref();
        Self::from_toml(&read(path)?, &path.display().to_string())
    }

    /// Reads a list from TOML; `file` is how errors call it.
    ///
    /// ```
    /// use servocrab::parameters::StartUpList;
    /// let toml = "[[write]]\nobject = \"position window\"\nvalue = 50\nverify = true\n";
    /// let list = StartUpList::from_toml(toml, "gantry.toml").unwrap();
    /// assert_eq!(list.writes[0].object.to_string(), "6067h:00");
    ///
    /// let toml = "[[write]]\nobject = \"position window\"\nvalue = -1\n";
    /// let error = StartUpList::from_toml(toml, "gantry.toml").unwrap_err();
    /// assert_eq!(error.to_string(), "gantry.toml:3: object \"position window\": expected u32, got -1");
    /// ```
    ///
    /// # Errors
    /// As [`StartUpList::load`].
    pub fn from_toml(text: &str, file: &str) -> Result<Self, FileError> {
        let mut source = Source::new(text, file);
        let raw: RawList = source.parse()?;
        source.drive = raw.drive;
        let writes = raw.write.into_iter();
        Ok(Self {
            writes: writes
                .map(|write| source.write(write))
                .collect::<Result<_, _>>()?,
            file: Some(file.into()),
        })
    }
}

/// A file's text, and what its errors begin with.
pub(super) struct Source<'a> {
    text: &'a str,
    file: &'a str,
    pub(super) drive: Option<String>,
}

impl<'a> Source<'a> {
    pub(super) const fn new(text: &'a str, file: &'a str) -> Self {
        Self {
            text,
            file,
            drive: None,
        }
    }

    pub(super) fn parse<T: DeserializeOwned>(&self) -> Result<T, FileError> {
        if self.text.len() > LONGEST_FILE {
            return Err(self.too_long());
        }
        toml::from_str(self.text).map_err(|error| {
            let kind = FileFault::Toml(error.message().into());
            self.error(error.span(), None, kind)
        })
    }

    pub(super) fn too_long(&self) -> FileError {
        self.error(None, None, FileFault::TooLong)
    }

    pub(super) fn error(
        &self,
        span: Option<Range<usize>>,
        object: Option<&str>,
        kind: FileFault,
    ) -> FileError {
        let before = span.and_then(|span| self.text.as_bytes().get(..span.start));
        FileError {
            file: self.file.into(),
            line: before.map(line_behind),
            drive: self.drive.clone(),
            object: object.map(Into::into),
            kind,
        }
    }

    pub(super) fn line(&self, at: usize) -> Option<usize> {
        self.text.as_bytes().get(..at).map(line_behind)
    }

    fn write(&self, write: Spanned<RawWrite>) -> Result<StartUpWrite, FileError> {
        let raw = write.into_inner();
        let (object, value) =
            self.entry(&raw.object, raw.axis.as_ref(), raw.kind.as_ref(), raw.value)?;
        let name = raw.object.get_ref();
        if is_controlword(object) {
            let fault = FileFault::Controlword;
            return Err(self.error(Some(raw.object.span()), Some(name), fault));
        }
        let transition = match raw.transition {
            None => Transition::default(),
            Some(text) => text
                .get_ref()
                .parse()
                .map_err(|error| self.word(&text, name, &error))?,
        };
        Ok(StartUpWrite {
            object,
            value,
            comment: raw.comment,
            transition,
            verify: raw.verify,
            line: self.line(raw.object.span().start),
        })
    }

    fn word(&self, word: &Spanned<String>, object: &str, error: &dyn fmt::Display) -> FileError {
        let fault = FileFault::Word(error.to_string());
        self.error(Some(word.span()), Some(object), fault)
    }

    /// The object and the value of an entry.
    pub(super) fn entry(
        &self,
        object: &Spanned<String>,
        axis: Option<&Spanned<u8>>,
        kind: Option<&Spanned<String>>,
        value: Spanned<RawValue>,
    ) -> Result<(ObjectAddress, ObjectValue), FileError> {
        let name = object.get_ref().as_str();
        let error = |span, fault| self.error(Some(span), Some(name), fault);
        let address =
            address(name).ok_or_else(|| error(object.span(), FileFault::UnknownObject))?;
        let offset = match axis.map(|axis| (*axis.get_ref(), axis.span())) {
            None => AxisOffset::default(),
            Some((axis @ 1..=8, _)) => AxisOffset::of_axis(axis),
            Some((axis, span)) => return Err(error(span, FileFault::Axis(axis))),
        };
        let kind = match kind {
            None => ObjectValue::known_type(address)
                .ok_or_else(|| error(object.span(), FileFault::NoType))?,
            Some(kind) => kind
                .get_ref()
                .parse()
                .map_err(|fault| self.word(kind, name, &fault))?,
        };
        let span = value.span();
        let value = value.into_inner().of_type(kind).map_err(|got| {
            let expected = kind;
            error(span, FileFault::Value { expected, got })
        })?;
        let moved = ObjectAddress::new(offset.apply(address.index), address.subindex);
        Ok((moved, value))
    }
}

/// The number of the line on which the next byte is.
fn line_behind(before: &[u8]) -> usize {
    let ends = before.iter().filter(|byte| **byte == b'\n').count();
    ends.saturating_add(1)
}

/// Index and subindex, or the name of a known object.
fn address(text: &str) -> Option<ObjectAddress> {
    text.parse().ok().or_else(|| {
        let all = obj::all();
        all.iter()
            .find(|object| object.name.eq_ignore_ascii_case(text))
            .map(crate::coe::AnyObject::address)
    })
}

/// The text of a file, unless it is too long.
pub(super) fn read(path: &Path) -> Result<String, FileError> {
    let failed = |error: std::io::Error| io_error(path, &error);
    let file = std::fs::File::open(path).map_err(failed)?;
    let mut text = String::new();
    // One byte more than allowed, so that what is too long is seen to be.
    file.take(LONGEST_FILE as u64 + 1)
        .read_to_string(&mut text)
        .map_err(failed)?;
    Ok(text)
}

pub(super) fn io_error(path: &Path, error: &std::io::Error) -> FileError {
    FileError {
        file: path.display().to_string(),
        line: None,
        drive: None,
        object: None,
        kind: FileFault::Io(error.to_string()),
    }
}

#[cfg(test)]
#[path = "file_tests.rs"]
mod tests;
