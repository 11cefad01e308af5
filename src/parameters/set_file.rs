//! Sets of parameters as TOML files, written so that people can read and change them.

use std::fmt::Write;
use std::io;
use std::path::Path;

use serde::Deserialize;
use toml::Spanned;

use super::file::{FileError, FileFault, LONGEST_FILE, Source, io_error, read};
use super::raw_value::RawValue;
use super::set::{Parameter, ParameterSet, is_parameter};
use super::value::{ObjectValue, ValueType, known_name};
use crate::sii::Identity;

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
        for raw in raw.parameter {
            let raw = raw.into_inner();
            let (object, value) = source.entry(&raw.object, None, raw.kind.as_ref(), raw.value)?;
            if !is_parameter(object) {
                let (span, name) = (raw.object.span(), raw.object.get_ref());
                return Err(source.error(Some(span), Some(name), FileFault::NoParameter));
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

    /// Writes the set into a TOML file. A file that is there is replaced at once or not at all.
    ///
    /// # Errors
    /// [`FileError`] with the reason of the operating system; [`FileFault::TooLong`] for a set that could not be read again.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), FileError> {
        let path = path.as_ref();
        let text = self.to_toml();
        if text.len() > LONGEST_FILE {
            return Err(Source::new(&text, &path.display().to_string()).too_long());
        }
        let mut beside = path.as_os_str().to_owned();
        beside.push(".new");
        let failed = |error: io::Error| io_error(path, &error);
        std::fs::write(&beside, text).map_err(failed)?;
        std::fs::rename(&beside, path).map_err(failed)
    }
}

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
    use super::*;
    use crate::coe::ObjectAddress;
    use proptest::prelude::*;

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

    #[test]
    fn a_command_in_a_file_is_refused_with_its_line() {
        let text = "drive = \"left\"\n[[parameter]]\nobject = \"modes of operation\"\nvalue = 1\n";
        let error = ParameterSet::from_toml(text, "left.toml").unwrap_err();
        assert_eq!(
            error.to_string(),
            "left.toml:3: drive \"left\": object \"modes of operation\": this object is a command or a record, and no parameter"
        );
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
            let parameters = values.into_iter().map(|value| Parameter {
                object: ObjectAddress::new(0x2345, 0xAB),
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
