//! A simulated device out of a maker's ESI file (`EtherCATInfo`, ETG.2000): identity, SII, sync managers, PDOs and objects as the file
//! says; where it has DS402 axes, they behave as those of the plain drive. The names of PDOs and of their entries are left out.

mod objects;
#[cfg(test)]
mod tests;
mod xml;

use core::time::Duration;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::description::{
    ClockMode, Description, Direction, Identity, Mailbox, PdoDescription, PdoEntryDescription,
    SyncManagerDescription, SyncManagerUse,
};
use crate::device::{Blueprint, Device};
use crate::drive::{DriveBlueprint, PlainObject};
use crate::ds402::Behaviour;
use crate::pdo::PdoLimits;
use xml::Element;
pub use xml::EsiError;

const CONTROLWORD: u16 = 0x6040;
const AXIS_INCREMENT: u16 = 0x0800;
/// CiA 402, more than one axis (ETG.6010).
const MOST_AXES: u16 = 8;
/// CoE messages.
const COE: u16 = 4;
/// Process data of a direction where the file says nothing of its room.
const ROOM: u16 = 64;
/// Entries of a PDO where the dictionary does not show the mapping.
const ENTRIES: u8 = 8;

/// A device as an ESI file describes it. The first device of the file is meant.
///
/// ```
/// use servocrab_sim::EsiDrive;
/// let text = r##"<EtherCATInfo><Vendor><Id>#x6A</Id></Vendor><Descriptions><Devices><Device>
///   <Type ProductCode="2" RevisionNo="1">Coupler</Type></Device></Devices></Descriptions></EtherCATInfo>"##;
/// let device = EsiDrive::from_bytes("coupler.xml", text.as_bytes())?.build();
/// assert_eq!(device.description().identity.vendor, 0x6A);
/// # Ok::<(), servocrab_sim::EsiError>(())
/// ```
#[derive(Clone, Debug)]
pub struct EsiDrive {
    description: Description,
    drive: Option<DriveBlueprint>,
}

impl EsiDrive {
    /// Reads a file.
    ///
    /// # Errors
    /// [`EsiError`] with file and line: it cannot be read, is no ESI file, or has values that no device can have.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, EsiError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        let mut bytes = Vec::new();
        let most = u64::try_from(xml::MOST_BYTES).unwrap_or(u64::MAX);
        File::open(path)
            .and_then(|file| file.take(most.saturating_add(1)).read_to_end(&mut bytes))
            .map_err(|error| EsiError::of_file(&name, error.to_string()))?;
        Self::from_bytes(&name, &bytes)
    }

    /// Reads the content of a file; `name` is for messages.
    ///
    /// # Errors
    /// As [`EsiDrive::load`].
    pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Self, EsiError> {
        let text = xml::text(name, bytes)?;
        let document = xml::parse(name, &text)?;
        let root = Element::root(name, &document);
        if !root.is("EtherCATInfo") {
            return Err(root.error("expected EtherCATInfo as the outermost element"));
        }
        let vendor = root.need("Vendor")?.need("Id")?.number()?;
        let device = root.at(&["Descriptions", "Devices", "Device"]);
        let device = device.ok_or_else(|| root.error("there is no device in this file"))?;
        Self::of(vendor, &device)
    }

    /// Changes how all axes behave.
    #[must_use]
    pub fn change(mut self, change: impl Fn(&mut Behaviour)) -> Self {
        if let Some(drive) = &mut self.drive {
            drive.axes.iter_mut().for_each(change);
        }
        self
    }

    /// The device, just switched on.
    #[must_use]
    pub fn build(self) -> Device {
        let axes = self.drive.as_ref().map(|drive| drive.axes.as_slice());
        let cycle = axes.and_then(|axes| axes.first()).map(|axis| axis.period);
        Device::new(Blueprint {
            cycle: cycle.unwrap_or(Duration::from_millis(1)),
            description: self.description,
            drive: self.drive,
        })
    }

    fn of(vendor: u32, device: &Element<'_>) -> Result<Self, EsiError> {
        let kind = device.need("Type")?;
        let identity = Identity {
            vendor,
            product: kind.attribute_number("ProductCode")?.unwrap_or(0),
            revision: kind.attribute_number("RevisionNo")?.unwrap_or(0),
            serial: 0,
        };
        let name = match device.text_of("Name") {
            "" => kind.text(),
            name => name,
        };
        let mut description = Description::new(&short(name), identity);
        description.order = short(kind.text());
        description.group = short(device.text_of("GroupType"));
        description.pdos = pdos(device)?;
        description.fmmu_usage = device
            .all("Fmmu")
            .map(|fmmu| fmmu_usage(fmmu.text()))
            .collect();
        let managers: Vec<Manager> = device
            .all("Sm")
            .map(|sm| manager(&sm))
            .collect::<Result<_, _>>()?;
        for manager in &managers {
            let mut described = manager.description;
            if let Some(direction) = manager.direction() {
                let bytes = description.process_data_bytes(direction);
                described.length = u16::try_from(bytes).unwrap_or(u16::MAX);
            }
            description.sync_managers.push(described);
        }
        for mode in device.all("Dc").flat_map(|dc| dc.all("OpMode")) {
            description.clock_modes.push(ClockMode {
                name: short(mode.text_of("Name")),
                assign_activate: mode.number_of("AssignActivate")?.unwrap_or(0),
            });
        }
        description.mailbox = mailbox(device, &managers);
        let drive = match &description.mailbox {
            Some(mailbox) if mailbox.coe_details != 0 => {
                Some(drive(objects::read(device)?, &description, &managers))
            }
            _ => None,
        };
        let axes = drive.as_ref().map_or(0, |drive| drive.axes.len());
        description.ds402_channels = u8::try_from(axes).unwrap_or(u8::MAX);
        Ok(Self { description, drive })
    }
}

/// A name for the SII, whose strings have at most 255 bytes.
fn short(text: &str) -> String {
    text.chars().take(60).collect()
}

/// A sync manager with the most bytes that it takes.
struct Manager {
    description: SyncManagerDescription,
    room: u16,
}

impl Manager {
    fn direction(&self) -> Option<Direction> {
        match self.description.purpose {
            SyncManagerUse::Outputs => Some(Direction::Outputs),
            SyncManagerUse::Inputs => Some(Direction::Inputs),
            SyncManagerUse::MailboxOut | SyncManagerUse::MailboxIn => None,
        }
    }
}

fn manager(element: &Element<'_>) -> Result<Manager, EsiError> {
    let purpose = match element.text() {
        "MBoxOut" => SyncManagerUse::MailboxOut,
        "MBoxIn" => SyncManagerUse::MailboxIn,
        "Outputs" => SyncManagerUse::Outputs,
        "Inputs" => SyncManagerUse::Inputs,
        other => return Err(element.error(format!("a sync manager for {other:?} is not known"))),
    };
    let length = element.attribute_number("DefaultSize")?.unwrap_or(0);
    Ok(Manager {
        description: SyncManagerDescription {
            start: element.attribute_number("StartAddress")?.unwrap_or(0),
            length,
            control: element.attribute_number("ControlByte")?.unwrap_or(0),
            purpose,
        },
        room: element
            .attribute_number("MaxSize")?
            .unwrap_or(length.max(ROOM)),
    })
}

/// Bytes of category 40.
fn fmmu_usage(text: &str) -> u8 {
    match text {
        "Outputs" => 1,
        "Inputs" => 2,
        "MBoxState" => 3,
        _ => 0xFF,
    }
}

fn mailbox(device: &Element<'_>, managers: &[Manager]) -> Option<Mailbox> {
    let place = |purpose| {
        let mut all = managers.iter().map(|manager| manager.description);
        let found = all.find(|manager| manager.purpose == purpose)?;
        Some((found.start, found.length))
    };
    let coe = device.at(&["Mailbox", "CoE"]);
    let details = coe.map_or(0, |coe| {
        [
            ("SdoInfo", Mailbox::SDO_INFORMATION),
            ("PdoAssign", Mailbox::PDO_ASSIGNMENT),
            ("PdoConfig", Mailbox::PDO_CONFIGURATION),
            ("CompleteAccess", Mailbox::COMPLETE_ACCESS),
        ]
        .into_iter()
        .filter(|(name, _)| coe.is_set(name))
        .fold(Mailbox::SDO, |details, (_, bit)| details | bit)
    });
    Some(Mailbox {
        out: place(SyncManagerUse::MailboxOut)?,
        input: place(SyncManagerUse::MailboxIn)?,
        protocols: if details == 0 { 0 } else { COE },
        coe_details: details,
    })
}

fn pdos(device: &Element<'_>) -> Result<Vec<PdoDescription>, EsiError> {
    let mut pdos = Vec::new();
    for (name, direction) in [("RxPdo", Direction::Outputs), ("TxPdo", Direction::Inputs)] {
        for pdo in device.all(name) {
            let mut entries = Vec::new();
            for entry in pdo.all("Entry") {
                entries.push(PdoEntryDescription {
                    name: "",
                    index: entry.need("Index")?.number()?,
                    subindex: entry.number_of("SubIndex")?.unwrap_or(0),
                    data_type: u8::try_from(objects::number_of_type(entry.text_of("DataType")))
                        .unwrap_or(0),
                    bits: entry.need("BitLen")?.number()?,
                });
            }
            if entries.len() > usize::from(u8::MAX) - 1 {
                return Err(pdo.error("a PDO has at most 254 entries"));
            }
            pdos.push(PdoDescription {
                name: "",
                index: pdo.need("Index")?.number()?,
                direction,
                sync_manager: pdo.attribute_number("Sm")?,
                fixed: pdo.is_set("Fixed"),
                entries,
            });
        }
    }
    Ok(pdos)
}

fn drive(
    objects: Vec<PlainObject>,
    description: &Description,
    managers: &[Manager],
) -> DriveBlueprint {
    let object = |index: u16| objects.iter().find(|object| object.index == index);
    let last = |object: &PlainObject| object.entries.iter().map(|entry| entry.subindex).max();
    let mapped = |index: u16| {
        let mut entries = description.pdos.iter().flat_map(|pdo| &pdo.entries);
        entries.any(|entry| entry.index == index)
    };
    let axes = (0..MOST_AXES)
        .map(|axis| CONTROLWORD + axis * AXIS_INCREMENT)
        .take_while(|index| object(*index).is_some() || mapped(*index))
        .count();
    let number = |index: u16| {
        let value = object(index)?.entries.first()?.default.clone()?;
        Some(u32::from_le_bytes(value.try_into().ok()?))
    };
    let longest = objects
        .iter()
        .filter(|object| matches!(object.index, 0x1600..=0x17FF | 0x1A00..=0x1BFF))
        .filter_map(last)
        .max();
    let assigned = [0x1C12, 0x1C13]
        .into_iter()
        .filter_map(|index| last(object(index)?));
    let offered = u8::try_from(description.pdos.len()).unwrap_or(u8::MAX);
    let room = managers
        .iter()
        .filter(|manager| manager.direction().is_some());
    DriveBlueprint {
        axes: vec![Behaviour::generic(); axes],
        axis_increment: AXIS_INCREMENT,
        status_object: None,
        note: None,
        limits: PdoLimits {
            bytes: room
                .map(|manager| usize::from(manager.room))
                .max()
                .unwrap_or(0),
            entries: longest.unwrap_or(ENTRIES),
            assigned: assigned.max().unwrap_or(offered),
        },
        // 402, a servo drive (CiA 402).
        device_type: number(0x1000).unwrap_or(if axes > 0 { 0x0002_0192 } else { 0 }),
        assigned: None,
        pdo_habits: Vec::new(),
        saves: object(0x1010).is_some(),
        software_version: "simulated".to_owned(),
        hardware_version: "simulated".to_owned(),
        objects,
    }
}
