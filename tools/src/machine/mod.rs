//! `machine.toml`: the devices of a line, in order. `init` writes it, `sim` simulates it, `check` compares a line with it.

pub(crate) mod check;
pub(crate) mod init;
mod rust;
pub(crate) mod simulate;
mod units;

use std::path::{Path, PathBuf};

use serde::Deserialize;
use servocrab::{
    DriveConfig,
    bus::{DistributedClock, Expected, IoConfig, NetworkBuilder},
    coe::{AnyObject, DriveId, ErrorTexts, ObjectAddress},
    drives::{self, DriveDescription},
    esi::Esi,
    sii::Identity,
};

pub(crate) use units::{Axis, Units};

use crate::output::Failure;

/// The longest file that is read, in bytes: some ten thousand devices.
const LONGEST: u64 = 1 << 20;

/// A line, as a file has it.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Machine {
    /// Time from one cycle to the next.
    #[serde(default = "a_millisecond")]
    pub(crate) cycle_us: u32,
    /// In the line's order.
    #[serde(default, rename = "device")]
    pub(crate) devices: Vec<Device>,
    /// Where the file stands: the ESI files that it names stand beside it.
    #[serde(skip)]
    directory: PathBuf,
}

const fn a_millisecond() -> u32 {
    1000
}

/// What a device is to the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Kind {
    Akd2g,
    Ax2000,
    Pp2010,
    Sigma7,
    /// A drive with the objects of CiA 402, less those that it does not have.
    Generic,
    /// A drive by its maker's file.
    Esi,
    /// No drive; its inputs and outputs are exchanged.
    Io,
    /// No process data: a coupler, a junction.
    Other,
}

impl Kind {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Akd2g => "akd2g",
            Self::Ax2000 => "ax2000",
            Self::Pp2010 => "pp2010",
            Self::Sigma7 => "sigma7",
            Self::Generic => "generic",
            Self::Esi => "esi",
            Self::Io => "io",
            Self::Other => "other",
        }
    }

    /// The drive that the library suggests for what a scan has found.
    pub(crate) fn of(identity: &Identity) -> Option<Self> {
        let suggested = drives::for_identity(identity)?;
        let kinds = [Self::Akd2g, Self::Ax2000, Self::Pp2010, Self::Sigma7];
        let is_it = |kind: &Self| kind.known().as_ref() == Some(&suggested);
        kinds.into_iter().find(is_it)
    }

    /// The description of a drive that the library knows.
    fn known(self) -> Option<DriveDescription> {
        match self {
            Self::Akd2g => Some(drives::akd2g()),
            Self::Ax2000 => Some(drives::ax2000()),
            Self::Pp2010 => Some(drives::pp2010()),
            Self::Sigma7 => Some(drives::sigma7()),
            Self::Generic | Self::Esi | Self::Io | Self::Other => None,
        }
    }

    pub(crate) const fn is_drive(self) -> bool {
        !matches!(self, Self::Io | Self::Other)
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Device {
    /// What it calls itself; I/O devices are called so in the program.
    pub(crate) name: String,
    pub(crate) kind: Kind,
    pub(crate) vendor: u32,
    pub(crate) product: u32,
    pub(crate) revision: u32,
    /// 0 where it has none, or any will do.
    #[serde(default)]
    pub(crate) serial: u32,
    #[serde(default)]
    pub(crate) alias: u16,
    /// The bits of its distributed clock.
    pub(crate) clock_bits: Option<u8>,
    /// By which it is synchronised; without it, it is not.
    pub(crate) assign_activate: Option<u16>,
    pub(crate) esi: Option<PathBuf>,
    /// What the drive's error codes mean, by a file beside this one.
    pub(crate) alarms: Option<PathBuf>,
    /// Objects of the profile that a plain drive does not have.
    #[serde(default)]
    pub(crate) absent: Vec<Address>,
    /// Those of a drive, in order.
    #[serde(default)]
    pub(crate) axes: Vec<Axis>,
    /// The inputs and outputs of a device that is no drive.
    #[serde(default, rename = "point")]
    pub(crate) points: Vec<Point>,
}

#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Point {
    pub(crate) direction: Direction,
    /// The names of its PDO and of its entry, with a dot between.
    pub(crate) name: String,
    /// 0000h:00 for a gap.
    pub(crate) object: Address,
    pub(crate) bits: u8,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Direction {
    Input,
    Output,
}

/// Index and subindex as a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub(crate) struct Address(pub(crate) ObjectAddress);

impl TryFrom<String> for Address {
    type Error = servocrab::coe::NoAddress;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse().map(Self)
    }
}

impl Machine {
    pub(crate) fn load(file: &Path) -> Result<Self, Failure> {
        let named = |error: &dyn std::fmt::Display| format!("{}: {error}", file.display());
        let length = std::fs::metadata(file)
            .map_err(|error| named(&error))?
            .len();
        if length > LONGEST {
            return Err(named(&format!(
                "it has {length} bytes, and at most {LONGEST} are read"
            ))
            .into());
        }
        let text = std::fs::read_to_string(file).map_err(|error| named(&error))?;
        let mut machine = Self::from_toml(&text).map_err(|error| named(&error))?;
        machine.directory = file.parent().unwrap_or(Path::new("")).to_owned();
        Ok(machine)
    }

    fn from_toml(text: &str) -> Result<Self, Failure> {
        let machine: Self = toml::from_str(text)?;
        if !(100..=20_000).contains(&machine.cycle_us) {
            return Err(format!("cycle_us = {}: expected 100 to 20000", machine.cycle_us).into());
        }
        for (position, device) in machine.devices.iter().enumerate() {
            let wrong =
                |what: &str| Err(format!("device {position} \"{}\": {what}", device.name).into());
            match (device.kind, &device.esi) {
                (Kind::Esi, None) => {
                    return wrong("kind = \"esi\" needs the file's name: esi = \"drive.xml\"");
                }
                (Kind::Esi, Some(_)) | (_, None) => {}
                (_, Some(_)) => return wrong("esi = is for a device of kind = \"esi\""),
            }
            if device.alarms.is_some() && !device.kind.is_drive() {
                return wrong("alarms = is for a drive");
            }
            if device.axes.len() > 8 {
                return wrong("axes: a drive has eight at most");
            }
            if !matches!(device.clock_bits, None | Some(32 | 64)) {
                return wrong("clock_bits: expected 32 or 64");
            }
        }
        Ok(machine)
    }

    /// Where the device's ESI file is, if it has one.
    pub(crate) fn esi_of(&self, device: &Device) -> Option<PathBuf> {
        device.esi.as_ref().map(|file| self.directory.join(file))
    }

    /// The network of this line, and of no other.
    pub(crate) fn on(&self, network: NetworkBuilder) -> Result<NetworkBuilder, Failure> {
        let mut network = self.without_drives(network);
        for (position, device) in (0..).zip(&self.devices) {
            if device.kind.is_drive() {
                let axes = device.axes.iter();
                let declared = |drive: DriveConfig, axis: &Axis| drive.axis(axis.declare());
                network = network.drive(position, axes.fold(self.drive(device)?, declared));
            }
        }
        Ok(network)
    }

    /// The same, but for its drives.
    pub(crate) fn without_drives(&self, network: NetworkBuilder) -> NetworkBuilder {
        let network = network
            .cycle(std::time::Duration::from_micros(self.cycle_us.into()))
            .complete();
        let devices = (0..).zip(&self.devices);
        devices.fold(network, |network, (position, device)| match device.kind {
            Kind::Other => network.expect(position, device.expected()),
            Kind::Io => {
                let io = IoConfig::new(&io_name(position), device.expected());
                network.io(position, io)
            }
            _ => network,
        })
    }

    /// A drive of the line, without its axes.
    pub(crate) fn drive(&self, device: &Device) -> Result<DriveConfig, Failure> {
        let mut drive = self.described(device)?.revision(device.revision);
        if let Some(file) = &device.alarms {
            let texts = ErrorTexts::load(self.directory.join(file))?;
            drive = drive.error_texts(texts);
        }
        if device.serial != 0 {
            drive = drive.serial(device.serial);
        }
        if let Some(word) = device.assign_activate {
            drive = drive.dc(DistributedClock::new(word));
        }
        Ok(drive)
    }

    /// The drive by its description, or by its maker's file: one of this vendor and product alone.
    fn described(&self, device: &Device) -> Result<DriveConfig, Failure> {
        let mut description = match device.kind {
            Kind::Generic => {
                let axes = u8::try_from(device.axes.len()).unwrap_or(u8::MAX);
                let absent: Vec<_> = device.absent.iter().map(|address| address.0).collect();
                without(drives::generic(), &absent).with_axes(axes.max(1), 0x10)
            }
            Kind::Esi => {
                let file = self.esi_of(device).ok_or("kind = \"esi\" without a file")?;
                let esi = Esi::load(&file)?;
                let found = esi.device(device.product, device.revision);
                let mut found = found
                    .map_err(|error| format!("{}: {error}", file.display()))?
                    .clone();
                found.vendor = device.vendor;
                return Ok(DriveConfig::from_esi(&found)?);
            }
            kind => kind
                .known()
                .ok_or_else(|| format!("\"{}\" is no drive", device.name))?,
        };
        description.vendor = Some(device.vendor);
        description.product = Some(device.product);
        Ok(DriveConfig::new(description))
    }
}

/// The description without objects that a drive does not have.
pub(crate) fn without(
    mut description: DriveDescription,
    absent: &[ObjectAddress],
) -> DriveDescription {
    let there = |object: &AnyObject| !absent.contains(&object.address());
    for axis in &mut description.axes {
        axis.outputs.retain(there);
        axis.inputs.retain(there);
    }
    description
}

impl Device {
    fn expected(&self) -> Expected {
        let expected = Expected::new(self.vendor, self.product)
            .named(self.name.clone())
            .revision(self.revision);
        match self.serial {
            0 => expected,
            serial => expected.serial(serial),
        }
    }

    fn identity(&self) -> Identity {
        Identity {
            vendor: self.vendor,
            product: self.product,
            revision: self.revision,
            serial: self.serial,
        }
    }

    /// As it stands at this place of the line.
    pub(crate) fn id(&self, position: u16) -> DriveId {
        DriveId {
            position,
            name: self.name.clone(),
            identity: self.identity(),
        }
    }
}

/// How a program calls a device with inputs or outputs at this place of the line.
pub(crate) fn io_name(position: u16) -> String {
    format!("io {position}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_says_what_a_revolution_is_and_what_is_done_where_its_drive_says_another() {
        let axis = |more: &str| {
            let text = format!(
                "[[device]]\nname = \"x\"\nvendor = 1\nproduct = 2\nrevision = 3\nkind = \"generic\"\n\
                 axes = [{{ name = \"x\", unit = \"mm\", counts = 1000{more} }}]"
            );
            let machine = Machine::from_toml(&text).unwrap();
            format!("{:?}", machine.devices[0].axes[0].declare())
        };
        let ratio = |numerator, denominator| {
            let ratio = servocrab::units::Ratio::new(numerator, denominator).unwrap();
            format!("units_per_revolution: Some({ratio:?})")
        };
        let plain = axis("");
        assert!(plain.contains("units_per_revolution: None"), "{plain}");
        assert!(plain.contains("scale_mismatch: Refuse"), "{plain}");
        let written = axis(", per_revolution = 5, scale_mismatch = \"write\"");
        assert!(written.contains(&ratio(5, 1)), "{written}");
        assert!(written.contains("scale_mismatch: Write"), "{written}");
        let warned = axis(", per_revolution = 2.5, scale_mismatch = \"warn\"");
        assert!(warned.contains(&ratio(5, 2)), "{warned}");
        assert!(warned.contains("scale_mismatch: Warn"), "{warned}");
    }

    #[test]
    fn an_axis_says_what_brake_it_has() {
        let axis = |more: &str| {
            let text = format!(
                "[[device]]\nname = \"x\"\nvendor = 1\nproduct = 2\nrevision = 3\nkind = \"generic\"\n\
                 axes = [{{ name = \"x\"{more} }}]"
            );
            let machine = Machine::from_toml(&text)?;
            Ok::<_, Failure>(format!("{:?}", machine.devices[0].axes[0].declare()))
        };
        let plain = axis("").unwrap();
        assert!(plain.contains("brake: None"), "{plain}");
        let managed = axis(", vertical = true, brake = \"drive\"").unwrap();
        assert!(managed.contains("brake: Some(DriveManaged)"), "{managed}");
        assert!(managed.contains("is_vertical: true"), "{managed}");
        let on_output = axis(
            ", brake = { bit = 16, release_ms = 120, set_ms = 60, released_by_one = true, feedback = 17 }",
        )
        .unwrap();
        for part in ["Bit(16)", "120ms", "60ms", "set_by_one: false", "Bit(17)"] {
            assert!(on_output.contains(part), "{part}: {on_output}");
        }
        assert!(axis(", brake = { bit = 16 }").is_err());
        let alone = axis(", unit = \"mm\"").unwrap_err().to_string();
        assert!(alone.contains("belong together"), "{alone}");
    }

    #[test]
    fn a_file_that_cannot_be_meant_is_refused_with_the_reason() {
        let device = "[[device]]\nname = \"x\"\nvendor = 1\nproduct = 2\nrevision = 3\n";
        for (text, why) in [
            ("cycle_us = 5".to_owned(), "expected 100 to 20000"),
            (format!("{device}kind = \"esi\""), "needs the file's name"),
            (
                format!("{device}kind = \"io\"\nesi = \"a.xml\""),
                "is for a device of kind",
            ),
            (format!("{device}kind = \"drive\""), "unknown variant"),
            (
                format!("{device}kind = \"io\"\nalarms = \"a.toml\""),
                "is for a drive",
            ),
            (
                format!("{device}kind = \"io\"\nclock_bits = 16"),
                "expected 32 or 64",
            ),
            (
                format!("{device}kind = \"generic\"\naxes = {:?}", ["x"; 9]),
                "eight at most",
            ),
            (
                format!(
                    "{device}kind = \"generic\"\naxes = [{{ name = \"x\", unit = \"inch\", counts = 1000 }}]"
                ),
                "an axis is its name",
            ),
            (
                format!(
                    "{device}kind = \"generic\"\naxes = [{{ name = \"x\", unit = \"mm\", counts = 0 }}]"
                ),
                "axis \"x\"",
            ),
            (
                format!(
                    "{device}kind = \"generic\"\naxes = [{{ name = \"x\", unit = \"mm\", counts = 1, per_revolution = -5 }}]"
                ),
                "axis \"x\"",
            ),
            (
                format!(
                    "{device}kind = \"generic\"\naxes = [{{ name = \"x\", unit = \"mm\", counts = 1, scale_mismatch = \"no\" }}]"
                ),
                "an axis is its name",
            ),
            (
                format!("{device}kind = \"generic\"\nabsent = [\"606C\"]"),
                "hexadecimal",
            ),
            ("what = 1".to_owned(), "unknown field"),
        ] {
            let error = Machine::from_toml(&text).unwrap_err().to_string();
            assert!(error.contains(why), "{text}: {error}");
        }
    }
}
