//! Start-up lists as TOML files, and what parameter files have in common with them.
//!
//! ```toml
//! drive = "gantry left"                  # for messages; may be left out
//!
//! [[write]]
//! object = "quick stop deceleration"     # an object of `coe::obj` by its name, and so its type …
//! axis = 2                               # 1 if left out; for objects from 6000h to 67FFh and from 5000h to 50FFh
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

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write as _};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::{fmt, process};

use serde::Deserialize;
use serde::de::{DeserializeOwned, Deserializer, Error as _, SeqAccess, Visitor};
use toml::Spanned;

use super::set::{Parameter, ParameterSet, is_parameter};
use super::start_up::{StartUpList, StartUpWrite, Transition, of_first_axis};
use super::value::{ObjectValue, ValueType, known_name};
use crate::coe::{AxisOffset, ErrorTexts, ObjectAddress, obj};
use crate::sii::Identity;

/// The longest file that is read or written: some ten thousand parameters, more than any drive has.
///
/// Reading one takes about 60 bytes of memory for each of its bytes, and never more than 768, whatever is in it. Tables within
/// tables cost most: they are read before it is known that none belongs there.
pub const LONGEST_FILE: usize = 1 << 20;

/// A file that could not be used: which, where, and why.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}: {kind}", FilePosition(self))]
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

struct FilePosition<'a>(&'a FileError);

impl fmt::Display for FilePosition<'_> {
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
    /// There is a directory, a pipe or a device where a file is to be written.
    #[error("what is there is a directory, a pipe or a device, and is left as it is: name a file")]
    NoFile,
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
    /// The axis is not the first, and the object is none that each axis has at an index of its own.
    #[error("this object is not of one axis: give its own index")]
    NotOfAxis,
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
    /// A key is no error code.
    #[error("no error code: write the four hexadecimal digits of 603Fh, such as 8611h or 0x8611")]
    ErrorCode,
    /// The object, or the code, has another value further up.
    #[error("this object is in the file already: leave one of the two out")]
    Twice,
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

impl ErrorTexts {
    /// Reads what a drive's error codes mean from a TOML file: each code in hexadecimal, as in 603Fh, and its text.
    ///
    /// ```toml
    /// FF01h = "brake resistor missing"
    /// 0x8611 = "F6001 following error magnitude"
    /// ```
    ///
    /// # Errors
    /// [`FileError`]: file, line and code, and what is wrong there.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, FileError> {
        let path = path.as_ref();
        Self::from_toml(&read(path)?, &path.display().to_string())
    }

    /// Reads texts from TOML; `file` is how errors call it.
    ///
    /// ```
    /// use servocrab::coe::ErrorTexts;
    /// let texts = ErrorTexts::from_toml("FF01h = \"brake resistor missing\"", "alarms.toml").unwrap();
    /// assert_eq!(texts.describe(0xFF01), "brake resistor missing");
    ///
    /// let error = ErrorTexts::from_toml("F6001 = \"following error\"", "alarms.toml").unwrap_err();
    /// assert!(error.to_string().starts_with("alarms.toml:1: object \"F6001\": no error code"));
    /// ```
    ///
    /// # Errors
    /// As [`ErrorTexts::load`].
    pub fn from_toml(text: &str, file: &str) -> Result<Self, FileError> {
        let source = Source::new(text, file);
        let raw: BTreeMap<Spanned<String>, String> = source.parse()?;
        let mut texts = Self::default();
        for (name, text) in raw {
            let error = |fault| source.error(Some(name.span()), Some(name.get_ref()), fault);
            let code = error_code(name.get_ref()).ok_or_else(|| error(FileFault::ErrorCode))?;
            if texts.codes.insert(code, text.into()).is_some() {
                return Err(error(FileFault::Twice));
            }
        }
        Ok(texts)
    }
}

/// An error code as a file writes it: `8611h` or `0x8611`.
fn error_code(text: &str) -> Option<u16> {
    let digits = text
        .strip_suffix('h')
        .or_else(|| text.strip_prefix("0x"))
        .filter(|digits| digits.len() == 4 && !digits.starts_with('+'))?;
    u16::from_str_radix(digits, 16).ok()
}

/// A file's text, and what its errors begin with.
struct Source<'a> {
    text: &'a str,
    file: &'a str,
    pub drive: Option<String>,
}

impl<'a> Source<'a> {
    pub const fn new(text: &'a str, file: &'a str) -> Self {
        Self {
            text,
            file,
            drive: None,
        }
    }

    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, FileError> {
        if self.text.len() > LONGEST_FILE {
            return Err(self.too_long());
        }
        toml::from_str(self.text).map_err(|error| {
            let kind = FileFault::Toml(error.message().into());
            self.error(error.span(), None, kind)
        })
    }

    pub fn too_long(&self) -> FileError {
        self.error(None, None, FileFault::TooLong)
    }

    pub fn error(
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

    pub fn line(&self, at: usize) -> Option<usize> {
        self.text.as_bytes().get(..at).map(line_behind)
    }

    fn write(&self, write: Spanned<RawWrite>) -> Result<StartUpWrite, FileError> {
        let raw = write.into_inner();
        let (object, value) =
            self.entry(&raw.object, raw.axis.as_ref(), raw.kind.as_ref(), raw.value)?;
        let name = raw.object.get_ref();
        if of_first_axis(object) == Some(0x6040) {
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
    pub fn entry(
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
        let moved = ObjectAddress::new(offset.apply(address.index), address.subindex);
        if let Some(axis) = axis
            && *axis.get_ref() > 1
            && moved == address
        {
            return Err(error(axis.span(), FileFault::NotOfAxis));
        }
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

fn io_error(path: &Path, error: &std::io::Error) -> FileError {
    FileError {
        file: path.display().to_string(),
        line: None,
        drive: None,
        object: None,
        kind: FileFault::Io(error.to_string()),
    }
}

// Values as a TOML file has them, before their types are known.

/// A value as TOML has it.
#[derive(Debug)]
enum RawValue {
    Integer(i128),
    Float(f64),
    Text(String),
    Bytes(Vec<u8>),
}

impl RawValue {
    /// The value of this type, or how it looks in the file.
    pub fn of_type(self, kind: ValueType) -> Result<ObjectValue, String> {
        let value = match (kind, &self) {
            (ValueType::U8, Self::Integer(n)) => u8::try_from(*n).ok().map(Into::into),
            (ValueType::I8, Self::Integer(n)) => i8::try_from(*n).ok().map(Into::into),
            (ValueType::U16, Self::Integer(n)) => u16::try_from(*n).ok().map(Into::into),
            (ValueType::I16, Self::Integer(n)) => i16::try_from(*n).ok().map(Into::into),
            (ValueType::U32, Self::Integer(n)) => u32::try_from(*n).ok().map(Into::into),
            (ValueType::I32, Self::Integer(n)) => i32::try_from(*n).ok().map(Into::into),
            (ValueType::U64, Self::Integer(n)) => u64::try_from(*n).ok().map(Into::into),
            (ValueType::I64, Self::Integer(n)) => i64::try_from(*n).ok().map(Into::into),
            (ValueType::F32, Self::Integer(n)) => single(*n as f64),
            (ValueType::F32, Self::Float(n)) => single(*n),
            (ValueType::Text, Self::Text(text)) => Some(ObjectValue::Text(text.clone())),
            (ValueType::Bytes, Self::Bytes(bytes)) => Some(ObjectValue::Bytes(bytes.clone())),
            _ => None,
        };
        value.ok_or_else(|| match self {
            Self::Integer(n) => n.to_string(),
            Self::Float(n) => format!("{n:?}"),
            Self::Text(text) => format!("{text:?}"),
            Self::Bytes(_) => "a list of bytes".into(),
        })
    }
}

/// The nearest number of single precision, if there is one.
fn single(number: f64) -> Option<ObjectValue> {
    let near = number as f32;
    (near.is_finite() || !number.is_finite()).then_some(ObjectValue::F32(near))
}

impl<'de> Deserialize<'de> for RawValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(RawValueVisitor)
    }
}

struct RawValueVisitor;

impl<'de> Visitor<'de> for RawValueVisitor {
    type Value = RawValue;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, a string or a list of bytes")
    }

    fn visit_i64<E>(self, value: i64) -> Result<RawValue, E> {
        Ok(RawValue::Integer(value.into()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<RawValue, E> {
        Ok(RawValue::Integer(value.into()))
    }

    fn visit_i128<E>(self, value: i128) -> Result<RawValue, E> {
        Ok(RawValue::Integer(value))
    }

    fn visit_u128<E: serde::de::Error>(self, value: u128) -> Result<RawValue, E> {
        let value = i128::try_from(value);
        value
            .map(RawValue::Integer)
            .map_err(|_| E::custom("a number of more than 64 bits"))
    }

    fn visit_f64<E>(self, value: f64) -> Result<RawValue, E> {
        Ok(RawValue::Float(value))
    }

    fn visit_str<E>(self, value: &str) -> Result<RawValue, E> {
        Ok(RawValue::Text(value.into()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<RawValue, A::Error> {
        let mut bytes = Vec::new();
        while let Some(byte) = list.next_element::<i64>()? {
            bytes.push(
                u8::try_from(byte)
                    .map_err(|_| A::Error::custom(format!("{byte} is no byte (0 to 255)")))?,
            );
        }
        Ok(RawValue::Bytes(bytes))
    }
}

// Sets of parameters as TOML files, written so that people can read and change them.

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSet {
    drive: Option<String>,
    identity: Option<RawIdentity>,
    #[serde(default)]
    parameter: Vec<Spanned<RawParameter>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawIdentity {
    vendor: u32,
    product: u32,
    revision: u32,
    serial: u32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawParameter {
    object: Spanned<String>,
    name: Option<String>,
    #[serde(rename = "type")]
    kind: Option<Spanned<String>>,
    value: Spanned<RawValue>,
}

impl ParameterSet {
    /// Reads a set from a TOML file.
    ///
    /// # Errors
    /// [`FileError`]: file, line, drive and object, and what is wrong there.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, FileError> {
        let path = path.as_ref();
        Self::from_toml(&read(path)?, &path.display().to_string())
    }

    /// Reads a set from TOML; `file` is how errors call it.
    ///
    /// ```
    /// use servocrab::parameters::ParameterSet;
    /// let toml = "[[parameter]]\nobject = \"2345h:01\"\ntype = \"i16\"\nvalue = -7\n";
    /// let set = ParameterSet::from_toml(toml, "left.toml").unwrap();
    /// assert_eq!(ParameterSet::from_toml(&set.to_toml(), "again.toml").unwrap(), set);
    /// ```
    ///
    /// # Errors
    /// As [`ParameterSet::load`].
    pub fn from_toml(text: &str, file: &str) -> Result<Self, FileError> {
        let mut source = Source::new(text, file);
        let raw: RawSet = source.parse()?;
        source.drive.clone_from(&raw.drive);
        let identity = raw.identity.map(|raw| Identity {
            vendor: raw.vendor,
            product: raw.product,
            revision: raw.revision,
            serial: raw.serial,
        });
        let mut parameters = Vec::new();
        let mut objects = BTreeSet::new();
        for raw in raw.parameter {
            let raw = raw.into_inner();
            let (object, value) = source.entry(&raw.object, None, raw.kind.as_ref(), raw.value)?;
            if !is_parameter(object) {
                let (span, name) = (raw.object.span(), raw.object.get_ref());
                return Err(source.error(Some(span), Some(name), FileFault::NoParameter));
            }
            if !objects.insert((object.index, object.subindex)) {
                let (span, name) = (raw.object.span(), raw.object.get_ref());
                return Err(source.error(Some(span), Some(name), FileFault::Twice));
            }
            let name = raw
                .name
                .unwrap_or_else(|| known_name(object).unwrap_or_default().into());
            parameters.push(Parameter {
                object,
                name,
                value,
            });
        }
        Ok(Self {
            drive: raw.drive,
            identity,
            parameters,
        })
    }

    /// The set as TOML, as [`ParameterSet::from_toml`] reads it.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let mut text = String::new();
        // Writing to a string does not fail.
        let _ = self.write_toml(&mut text);
        text
    }

    fn write_toml(&self, text: &mut String) -> std::fmt::Result {
        if let Some(drive) = &self.drive {
            writeln!(text, "drive = {}\n", quoted(drive))?;
        }
        if let Some(identity) = self.identity {
            let Identity {
                vendor,
                product,
                revision,
                serial,
            } = identity;
            writeln!(
                text,
                "[identity]\nvendor = 0x{vendor:08X}\nproduct = 0x{product:08X}\nrevision = 0x{revision:08X}\nserial = {serial}\n"
            )?;
        }
        for parameter in &self.parameters {
            let (kind, value) = shown(&parameter.value);
            writeln!(text, "[[parameter]]\nobject = \"{}\"", parameter.object)?;
            writeln!(text, "name = {}", quoted(&parameter.name))?;
            writeln!(text, "type = \"{kind}\"\nvalue = {value}\n")?;
        }
        Ok(())
    }

    /// Writes the set into a TOML file. A file that is there is replaced at once or not at all, and keeps its permissions. Of a symbolic
    /// link that is the file that it names.
    ///
    /// # Errors
    /// [`FileError`] with the reason of the operating system; [`FileFault::NoFile`] for a directory, a pipe or a device;
    /// [`FileFault::TooLong`] for a set that could not be read again.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), FileError> {
        let path = path.as_ref();
        let text = self.to_toml();
        if text.len() > LONGEST_FILE {
            return Err(Source::new(&text, &path.display().to_string()).too_long());
        }
        NewFile::write(path, text.as_bytes())
    }
}

/// A file that is written beside its place, and takes it when it is complete: at once or not at all. The project's own tool uses it too.
///
/// A file that is there is replaced then, and hands its permissions on. Of a symbolic link that is what it names. Dropped before that, the
/// new file is removed.
#[doc(hidden)]
#[derive(Debug)]
pub struct NewFile {
    /// As it was named.
    named: PathBuf,
    place: PathBuf,
    /// Where it is until it is complete.
    beside: PathBuf,
    file: File,
    is_placed: bool,
}

impl NewFile {
    /// Creates it beside its place, under a name that nothing has.
    ///
    /// # Errors
    /// [`FileFault::NoFile`] where something else than a file is; otherwise with the reason of the operating system.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, FileError> {
        let path = path.as_ref();
        let failed = |error: io::Error| io_error(path, &error);
        let there = there(path).map_err(failed)?;
        if there.as_ref().is_some_and(|there| !there.is_file()) {
            let named = path.display().to_string();
            return Err(Source::new("", &named).error(None, None, FileFault::NoFile));
        }
        let place = behind_links(path).map_err(failed)?;
        let (beside, file) = created_beside(&place).map_err(failed)?;
        let new = Self {
            named: path.into(),
            place,
            beside,
            file,
            is_placed: false,
        };
        if let Some(there) = there {
            let kept = new.file.set_permissions(there.permissions());
            kept.map_err(failed)?;
        }
        Ok(new)
    }

    /// All of it in one go.
    ///
    /// # Errors
    /// As [`create`](Self::create) and [`complete`](Self::complete).
    pub fn write(path: impl AsRef<Path>, bytes: &[u8]) -> Result<(), FileError> {
        let new = Self::create(path)?;
        let written = new.file().write_all(bytes);
        written.map_err(|error| io_error(&new.named, &error))?;
        new.complete()
    }

    /// What is written to.
    #[must_use]
    pub const fn file(&self) -> &File {
        &self.file
    }

    /// Has it take its place, when all of it is on the disk.
    ///
    /// # Errors
    /// With the reason of the operating system: then its place is as it was.
    pub fn complete(mut self) -> Result<(), FileError> {
        let synced = self.file.sync_all();
        let placed = synced.and_then(|()| fs::rename(&self.beside, &self.place));
        self.is_placed = placed.is_ok();
        placed.map_err(|error| io_error(&self.named, &error))
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        if !self.is_placed {
            let _ = fs::remove_file(&self.beside);
        }
    }
}

/// What is at this path, or at the end of its links; none where nothing is.
fn there(path: &Path) -> io::Result<Option<fs::Metadata>> {
    match fs::metadata(path) {
        Ok(there) => Ok(Some(there)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// The path at the end of the links, also where nothing is there yet.
fn behind_links(path: &Path) -> io::Result<PathBuf> {
    let mut place = path.to_owned();
    for _ in 0..MOST_LINKS {
        match fs::read_link(&place) {
            Ok(target) => place.set_file_name(target),
            Err(_) => return Ok(place),
        }
    }
    Err(io::Error::other("too many links, each to the next"))
}

/// As the operating system allows.
const MOST_LINKS: usize = 40;

/// A new file in the directory of this one.
fn created_beside(place: &Path) -> io::Result<(PathBuf, File)> {
    let Some(name) = place.file_name() else {
        let error = "it ends with no name of a file";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, error));
    };
    let mut number = 0;
    loop {
        let mut hidden = std::ffi::OsString::from(".");
        hidden.push(name);
        hidden.push(format!(".new-{}-{number}", process::id()));
        let beside = place.with_file_name(hidden);
        match OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&beside)
        {
            Ok(file) => return Ok((beside, file)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists && number < MOST_NAMES => {
                number += 1;
            }
            Err(error) => return Err(error),
        }
    }
}

/// So many names are tried.
const MOST_NAMES: u32 = 1000;

fn quoted(text: &str) -> String {
    toml::Value::String(text.into()).to_string()
}

/// Type and value as a file has them.
fn shown(value: &ObjectValue) -> (ValueType, String) {
    let text = match value {
        ObjectValue::U8(n) => n.to_string(),
        ObjectValue::I8(n) => n.to_string(),
        ObjectValue::U16(n) => n.to_string(),
        ObjectValue::I16(n) => n.to_string(),
        ObjectValue::U32(n) => n.to_string(),
        ObjectValue::I32(n) => n.to_string(),
        ObjectValue::U64(n) => n.to_string(),
        ObjectValue::I64(n) => n.to_string(),
        // There are many that are no number, and a file has one: its bytes are kept.
        ObjectValue::F32(n) if n.is_nan() => {
            return (ValueType::Bytes, format!("{:?}", n.to_le_bytes()));
        }
        ObjectValue::F32(n) => toml::Value::Float((*n).into()).to_string(),
        ObjectValue::Text(text) => quoted(text),
        ObjectValue::Bytes(bytes) => format!("{bytes:?}"),
    };
    (value.value_type(), text)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::coe::ObjectAddress;

    fn error(text: &str) -> String {
        StartUpList::from_toml(text, "list.toml")
            .unwrap_err()
            .to_string()
    }

    fn entry(rest: &str) -> String {
        format!("drive = \"left\"\n\n[[write]]\nobject = \"2345h:01\"\n{rest}")
    }

    #[test]
    fn texts_of_error_codes_are_refused_with_their_line_where_a_code_or_a_text_is_wrong() {
        let read = |text: &str| ErrorTexts::from_toml(text, "alarms.toml");
        let texts = read("8611h = \"A\"\n0xff01 = \"B\"\n").unwrap().codes;
        let texts: Vec<_> = texts.into_iter().collect();
        assert_eq!(texts, [(0x8611, "A".into()), (0xFF01, "B".into())]);
        for (line, fault) in [
            ("8611 = \"A\"", FileFault::ErrorCode),
            ("861h = \"A\"", FileFault::ErrorCode),
            ("'+611h' = \"A\"", FileFault::ErrorCode),
            ("0x12345 = \"A\"", FileFault::ErrorCode),
            ("0xFF01 = \"again\"", FileFault::Twice),
        ] {
            let error = read(&format!("FF01h = \"B\"\n{line}")).unwrap_err();
            assert_eq!(error.kind, fault, "{line}");
            if fault == FileFault::ErrorCode {
                assert_eq!(error.line, Some(2), "{line}");
            }
        }
        let number = read("8611h = 5").unwrap_err();
        assert!(matches!(number.kind, FileFault::Toml(_)), "{number}");
    }

    #[test]
    fn a_list_has_its_lines_in_order_with_types_axes_and_transitions() {
        let text = r#"
        drive = "gantry left"
        [[write]]
        object = "quick stop deceleration"
        axis = 2
        value = 1_000_000
        comment = "with full load"
        verify = true
        [[write]]
        object = "2345h:0A"
        type = "bytes"
        value = [1, 0xFF]
        transition = "SAFEOP-OP"
    "#;
        let list = StartUpList::from_toml(text, "list.toml").unwrap();
        let mut first = StartUpWrite::new(obj::QUICK_STOP_DECELERATION.axis(2), 1_000_000)
            .comment("with full load")
            .verified();
        first.line = Some(4);
        let mut second = StartUpWrite::to(ObjectAddress::new(0x2345, 10), vec![1, 0xFF])
            .at(Transition::SafeOpToOp);
        second.line = Some(10);
        assert_eq!(list.writes, [first, second]);
    }

    #[test]
    fn every_type_has_its_ends_and_nothing_beyond_them() {
        for (kind, good, bad) in [
            ("u8", ["0", "255"], ["-1", "256"]),
            ("i8", ["-128", "127"], ["-129", "128"]),
            ("u16", ["0", "0xFFFF"], ["-1", "65536"]),
            ("i16", ["-32768", "32767"], ["-32769", "32768"]),
            ("u32", ["0", "4294967295"], ["-1", "4294967296"]),
            (
                "i32",
                ["-2147483648", "2147483647"],
                ["-2147483649", "2147483648"],
            ),
            (
                "u64",
                ["0", "18446744073709551615"],
                ["-1", "18446744073709551616"],
            ),
            (
                "i64",
                ["-9223372036854775808", "9223372036854775807"],
                ["9223372036854775808", "1.5"],
            ),
            ("f32", ["1.5", "-3"], ["1e300", "\"1\""]),
            ("string", ["\"ab\"", "''"], ["1", "[1]"]),
            ("bytes", ["[]", "[0, 255]"], ["\"ab\"", "1"]),
        ] {
            for value in good {
                let text = entry(&format!("type = \"{kind}\"\nvalue = {value}"));
                let list = StartUpList::from_toml(&text, "list.toml").unwrap();
                assert_eq!(list.writes[0].value.value_type().to_string(), kind);
            }
            for value in bad {
                let got = error(&entry(&format!("type = \"{kind}\"\nvalue = {value}")));
                let place = "list.toml:6: drive \"left\": object \"2345h:01\": expected ";
                assert!(got.starts_with(place), "{kind} {value}: {got}");
            }
        }
    }

    #[test]
    fn every_mistake_is_named_with_its_line() {
        for (rest, line, part) in [
            ("value = 1", 4, "its type is not known"),
            ("type = \"u128\"\nvalue = 1", 5, "`u128` is no type"),
            (
                "type = \"u8\"\naxis = 9\nvalue = 1",
                6,
                "axis 9 is not 1 to 8",
            ),
            (
                "type = \"u8\"\nvalue = 1\ntransition = \"INIT-PREOP\"",
                7,
                "PREOP-SAFEOP or SAFEOP-OP",
            ),
            ("type = \"u8\"\nvalues = 1", 6, "unknown field `values`"),
            ("type = \"u8\"", 3, "missing field `value`"),
            (
                "type = \"u8\"\nvalue = true",
                6,
                "a number, a string or a list of bytes",
            ),
            ("type = \"bytes\"\nvalue = [256]", 6, "256 is no byte"),
            ("type = \"u8\"\nvalue = ", 6, ""),
            (
                "type = \"u8\"\nvalue = 1\ntype = \"u8\"",
                7,
                "duplicate key",
            ),
        ] {
            let got = error(&entry(rest));
            assert!(
                got.starts_with(&format!("list.toml:{line}: ")),
                "{rest}: {got}"
            );
            assert!(got.contains(part), "{rest}: {got}");
        }
        for object in [
            "6081",
            "6081h:",
            "6081h:100",
            "60811h:00",
            "h",
            "6081h:00:00",
            "6081h:+1",
            "",
        ] {
            let got = error(&format!(
                "[[write]]\nobject = \"{object}\"\ntype = \"u8\"\nvalue = 1"
            ));
            assert!(
                got.contains("neither index and subindex"),
                "{object}: {got}"
            );
        }
    }

    #[test]
    fn a_list_never_writes_a_controlword() {
        for object in [
            "object = \"controlword\"",
            "object = \"6840h\"",
            "object = \"controlword\"\naxis = 8",
        ] {
            let got = error(&format!("[[write]]\n{object}\nvalue = 15"));
            assert!(got.starts_with("list.toml:2: "), "{got}");
            assert!(got.contains("enable the axis by its handle"), "{got}");
        }
    }

    #[test]
    fn a_file_that_is_missing_or_too_long_is_named() {
        let error = StartUpList::load("no/such/list.toml").unwrap_err();
        assert!(matches!(error.kind, FileFault::Io(_)), "{error}");
        assert!(error.to_string().starts_with("no/such/list.toml: "));
        let error = StartUpList::from_toml(&"#".repeat(LONGEST_FILE + 1), "l").unwrap_err();
        assert_eq!(error.kind, FileFault::TooLong);
    }

    proptest! {
        #[test]
        fn nothing_makes_a_list_panic(text in "\\PC{0,200}") {
            let _ = StartUpList::from_toml(&text, "l");
        }

        #[test]
        fn a_damaged_list_is_read_or_refused_with_a_line(
            cut in 0_usize..400, at in 0_usize..400, new in prop::sample::select(b"\"=[]{}#,.-09xh\n\t \\".to_vec()),
        ) {
            let whole = entry("type = \"u16\"\nvalue = 7\ncomment = \"c\"\n[[write]]\nobject = \"position window\"\nvalue = 0x10\nverify = true\n");
            let mut bytes = whole.into_bytes();
            if let Some(byte) = bytes.get_mut(at) {
                *byte = new;
            }
            bytes.truncate(cut.max(1));
            let text = String::from_utf8(bytes).unwrap();
            if let Err(error) = StartUpList::from_toml(&text, "l") {
                let lines = text.split('\n').count();
                let line = error.line.expect("a line");
                prop_assert!((1..=lines).contains(&line), "{} of {}: {}", line, lines, error);
            }
        }
    }

    fn values() -> impl Strategy<Value = ObjectValue> {
        let kind = prop::sample::select(vec![
            "u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "f32", "string", "bytes",
        ]);
        (kind, prop::collection::vec(any::<u8>(), 0..12)).prop_map(|(kind, mut bytes)| {
            let width = match kind {
                "u8" | "i8" => 1,
                "u16" | "i16" => 2,
                "u32" | "i32" | "f32" => 4,
                "u64" | "i64" => 8,
                _ => bytes.len(),
            };
            bytes.resize(width, 0xA5);
            ObjectValue::decode(kind.parse().unwrap(), &bytes)
        })
    }

    /// Only 6000h to 67FFh and 5000h to 50FFh are of each axis.
    #[test]
    fn an_axis_of_an_object_that_is_not_of_one_axis_is_refused_at_its_line() {
        for object in ["2010h:00", "min profile velocity", "2345h:01", "6881h:00"] {
            let text = |axis| {
                format!(
                    "[[write]]\nobject = \"{object}\"\naxis = {axis}\ntype = \"u16\"\nvalue = 7\n"
                )
            };
            assert_eq!(
                error(&text(2)),
                format!(
                    "list.toml:3: object \"{object}\": this object is not of one axis: give its own index"
                )
            );
            assert!(StartUpList::from_toml(&text(1), "list.toml").is_ok());
        }
    }

    fn set_error(text: &str) -> String {
        ParameterSet::from_toml(text, "left.toml")
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn a_command_in_a_file_is_refused_with_its_line() {
        let text = "drive = \"left\"\n[[parameter]]\nobject = \"modes of operation\"\nvalue = 1\n";
        assert_eq!(
            set_error(text),
            "left.toml:3: drive \"left\": object \"modes of operation\": this object is a command or a record, and no parameter"
        );
    }

    #[test]
    fn an_object_that_is_twice_in_a_file_is_refused_at_the_second() {
        let text = "[[parameter]]\nobject = \"6081h:00\"\nvalue = 1\n[[parameter]]\nobject = \"profile velocity\"\nvalue = 2\n";
        assert_eq!(
            set_error(text),
            "left.toml:5: object \"profile velocity\": this object is in the file already: leave one of the two out"
        );
    }

    #[test]
    fn what_is_no_number_is_refused_for_an_integer() {
        for (value, got) in [("nan", "NaN"), ("inf", "inf"), ("1.5", "1.5")] {
            let text =
                format!("[[parameter]]\nobject = \"6081h:00\"\ntype = \"u32\"\nvalue = {value}\n");
            let error = set_error(&text);
            assert!(
                error.ends_with(&format!("expected u32, got {got}")),
                "{error}"
            );
        }
    }

    /// A directory that nothing else uses.
    fn directory(name: &str) -> PathBuf {
        let name = format!("servocrab-{name}-{}", process::id());
        let directory = std::env::temp_dir().join(name);
        let _ = fs::remove_dir_all(&directory);
        fs::create_dir(&directory).unwrap();
        directory
    }

    fn names(directory: &Path) -> Vec<String> {
        let entries = fs::read_dir(directory).unwrap();
        let mut names: Vec<_> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_set_replaces_the_file_that_a_link_names() {
        use std::os::unix::fs::{PermissionsExt as _, symlink};
        let directory = directory("link");
        fs::create_dir(directory.join("old")).unwrap();
        let (file, link) = (directory.join("old/file"), directory.join("link"));
        symlink("old/file", directory.join("second")).unwrap();
        symlink("second", &link).unwrap();
        let set = ParameterSet::from_toml("drive = \"left\"", "l").unwrap();
        // Also one that names no file yet.
        set.save(&link).unwrap();
        assert_eq!(ParameterSet::load(&file).unwrap(), set);
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        set.save(&link).unwrap();
        let mode = fs::metadata(&file).unwrap().permissions().mode();
        assert_eq!(mode & 0o7777, 0o640);
        assert!(link.is_symlink());
        assert_eq!(names(&directory.join("old")), ["file"]);
        assert_eq!(names(&directory), ["link", "old", "second"]);
        fs::remove_dir_all(&directory).unwrap();
    }

    #[test]
    fn what_is_no_file_is_left_as_it_is_and_nothing_is_left_beside_it() {
        let directory = directory("no-file");
        let place = directory.join("place");
        fs::create_dir(&place).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(directory.join("socket")).unwrap();
        let set = ParameterSet::from_toml("", "l").unwrap();
        for name in ["place", "socket"] {
            let error = set.save(directory.join(name)).unwrap_err();
            assert_eq!(error.kind, FileFault::NoFile);
            let text = error.to_string();
            assert!(
                text.starts_with(&error.file)
                    && error.file.ends_with(name)
                    && text.ends_with("name a file"),
                "{text}"
            );
        }
        assert!(set.save(directory.join("nowhere/file")).is_err());
        assert_eq!(names(&directory), ["place", "socket"]);
        fs::remove_dir_all(&directory).unwrap();
    }

    #[test]
    fn a_new_file_takes_no_other_ones_name_and_is_removed_where_it_is_not_completed() {
        let directory = directory("beside");
        let place = directory.join("file");
        let beside = format!(".file.new-{}-0", process::id());
        fs::write(directory.join(&beside), "a user's").unwrap();
        let new = NewFile::create(&place).unwrap();
        assert_eq!(names(&directory).len(), 2);
        drop(new);
        assert_eq!(names(&directory), [beside.as_str()]);
        let new = NewFile::create(&place).unwrap();
        fs::create_dir(&place).unwrap();
        new.complete().unwrap_err();
        assert_eq!(names(&directory), [beside.as_str(), "file"]);
        assert_eq!(
            fs::read_to_string(directory.join(&beside)).unwrap(),
            "a user's"
        );
        fs::remove_dir_all(&directory).unwrap();
    }

    #[test]
    fn a_set_that_could_not_be_read_again_is_not_written() {
        let path = std::env::temp_dir().join(format!("servocrab-long-{}.toml", std::process::id()));
        let set = |length| ParameterSet {
            drive: Some("x".repeat(length)),
            identity: None,
            parameters: Vec::new(),
        };
        let around = set(0).to_toml().len();
        let longest = LONGEST_FILE - around;
        let error = set(longest + 1).save(&path).unwrap_err();
        assert_eq!(error.kind, FileFault::TooLong);
        assert!(!path.exists());
        set(longest).save(&path).unwrap();
        assert_eq!(ParameterSet::load(&path).unwrap(), set(longest));
        std::fs::remove_file(&path).unwrap();
    }

    proptest! {
        #[test]
        fn a_set_comes_out_of_its_file_as_it_was(
            drive: Option<String>, name: String, values in prop::collection::vec(values(), 0..8), serial: u32,
        ) {
            let parameters = (0..).zip(values).map(|(subindex, value)| Parameter {
                object: ObjectAddress::new(0x2345, subindex),
                name: name.clone(),
                value,
            });
            let identity = Some(Identity { vendor: 0x6A, product: u32::MAX, revision: 0, serial });
            let set = ParameterSet { drive, identity, parameters: parameters.collect() };
            let text = set.to_toml();
            let read = ParameterSet::from_toml(&text, "l").map_err(|error| TestCaseError::fail(format!("{error}\n{text}")))?;
            // Bytes for bytes: what is no number is not equal to itself, and comes back as bytes.
            prop_assert_eq!(read.to_toml(), text);
            for (read, written) in read.parameters.iter().zip(&set.parameters) {
                prop_assert_eq!(read.value.encode(), written.value.encode());
            }
        }

        #[test]
        fn nothing_makes_a_set_panic(text in "\\PC{0,200}") {
            let _ = ParameterSet::from_toml(&text, "l");
        }
    }
}
