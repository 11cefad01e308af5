//! A simulated device out of a maker's ESI file (`EtherCATInfo`, ETG.2000): identity, SII, sync managers, PDOs and objects as the file
//! says; where it has DS402 axes, they behave as those of the plain drive. The names of PDOs and of their entries are left out.

mod choice;
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
pub use choice::EsiChoice;
use xml::Element;
pub use xml::EsiError;

const CONTROLWORD: u16 = 0x6040;
const AXIS_INCREMENT: u16 = 0x0800;
/// CiA 402, more than one axis (ETG.6010).
const MOST_AXES: u16 = 8;
/// Supported drive modes.
const SUPPORTED_MODES: u16 = 0x6502;
/// Real devices have up to some dozens.
const MOST_SLOTS: u32 = 255;
/// CoE messages.
const COE: u16 = 4;
/// Process data of a direction where the file says nothing of its room.
const ROOM: u16 = 64;
/// Entries of a PDO where the dictionary does not show the mapping.
const ENTRIES: u8 = 8;

/// A device as an ESI file describes it, with the modules that its slots hold by default.
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
    warnings: Vec<String>,
}

impl EsiDrive {
    /// Reads the first device of a file.
    ///
    /// # Errors
    /// [`EsiError`] with file and line: it cannot be read, is no ESI file, or has values that no device can have.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, EsiError> {
        Self::load_one(path.as_ref(), None, None)
    }

    /// Reads one device of a file, by its product code and its revision.
    ///
    /// # Errors
    /// As [`EsiDrive::load`], and if the file has no such device; the message lists those that it has.
    pub fn choose(choice: &EsiChoice) -> Result<Self, EsiError> {
        Self::load_one(&choice.file, choice.product, choice.revision)
    }

    fn load_one(
        path: &Path,
        product: Option<u32>,
        revision: Option<u32>,
    ) -> Result<Self, EsiError> {
        let name = path.display().to_string();
        let mut bytes = Vec::new();
        let most = u64::try_from(xml::MOST_BYTES).unwrap_or(u64::MAX);
        File::open(path)
            .and_then(|file| file.take(most.saturating_add(1)).read_to_end(&mut bytes))
            .map_err(|error| EsiError::of_file(&name, error.to_string()))?;
        Self::read(&name, &bytes, product, revision)
    }

    /// Reads the first device in the content of a file; `name` is for messages.
    ///
    /// # Errors
    /// As [`EsiDrive::load`].
    pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Self, EsiError> {
        Self::read(name, bytes, None, None)
    }

    fn read(
        name: &str,
        bytes: &[u8],
        product: Option<u32>,
        revision: Option<u32>,
    ) -> Result<Self, EsiError> {
        let text = xml::text(name, bytes)?;
        let document = xml::parse(name, &text)?;
        let root = Element::root(name, &document);
        if !root.is("EtherCATInfo") {
            return Err(root.error("expected EtherCATInfo as the outermost element"));
        }
        let vendor = root.need("Vendor")?.need("Id")?.number()?;
        let device = choice::device(&root, product, revision)?;
        Self::of(vendor, &root, &device)
    }

    /// Values at power-up that the device cannot hold as the file has them, each with its line and with what is held instead.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.warnings
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

    fn of(vendor: u32, root: &Element<'_>, device: &Element<'_>) -> Result<Self, EsiError> {
        let kind = device.need("Type")?;
        let parts = parts(root, device)?;
        let mut warnings = Vec::new();
        let mut objects = objects::read(&parts, &mut warnings)?;
        let serial = number(&objects, 0x1018, 4).unwrap_or(0);
        let identity = Identity {
            vendor,
            product: kind.attribute_number("ProductCode")?.unwrap_or(0),
            revision: kind.attribute_number("RevisionNo")?.unwrap_or(0),
            serial,
        };
        identify(&mut objects, identity);
        let name = match device.text_of("Name") {
            "" => kind.text(),
            name => name,
        };
        let mut description = Description::new(&short(name), identity);
        description.order = short(kind.text());
        description.group = short(device.text_of("GroupType"));
        description.pdos = pdos(&parts)?;
        description.fmmu_usage = device
            .all("Fmmu")
            .map(|fmmu| fmmu_usage(fmmu.text()))
            .collect();
        let managers: Vec<Manager> = device
            .all("Sm")
            .zip(0..)
            .map(|(sm, place)| manager(&sm, place))
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
                Some(drive(objects, &description, &managers))
            }
            _ => None,
        };
        let axes = drive.as_ref().map_or(0, |drive| drive.axes.len());
        description.ds402_channels = u8::try_from(axes).unwrap_or(u8::MAX);
        Ok(Self {
            description,
            drive,
            warnings,
        })
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

/// By its name (ETG.2000), or by its number where the file has none: that in the element, or its place among the others.
fn manager(element: &Element<'_>, place: u16) -> Result<Manager, EsiError> {
    let text = element.text();
    let number = if text.is_empty() {
        Ok(place)
    } else {
        text.parse()
    };
    let purpose = match (text.to_ascii_lowercase().as_str(), number) {
        ("mboxout", _) | (_, Ok(0)) => SyncManagerUse::MailboxOut,
        ("mboxin", _) | (_, Ok(1)) => SyncManagerUse::MailboxIn,
        ("outputs", _) | (_, Ok(2)) => SyncManagerUse::Outputs,
        ("inputs", _) | (_, Ok(3)) => SyncManagerUse::Inputs,
        _ => return Err(element.error(format!("a sync manager for {text:?} is not known"))),
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

fn pdos<'a: 'b, 'b>(parts: &'b [Part<'a>]) -> Result<Vec<PdoDescription>, EsiError> {
    let mut pdos = Vec::new();
    for (name, direction) in [("RxPdo", Direction::Outputs), ("TxPdo", Direction::Inputs)] {
        let of_part = |part: &'b Part<'a>| part.element.all(name).map(move |pdo| (part, pdo));
        for (part, pdo) in parts.iter().flat_map(of_part) {
            let mut entries = Vec::new();
            for entry in pdo.all("Entry") {
                entries.push(PdoEntryDescription {
                    name: "",
                    index: part.index(&entry.need("Index")?)?,
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
                index: part.index(&pdo.need("Index")?)?,
                direction,
                sync_manager: pdo.attribute_number("Sm")?,
                fixed: pdo.is_set("Fixed"),
                mandatory: pdo.is_set("Mandatory"),
                excludes: pdo
                    .all("Exclude")
                    .map(|other| part.index(&other))
                    .collect::<Result<_, _>>()?,
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
    let mut behaviours = vec![Behaviour::generic(); axes];
    for (axis, behaviour) in (0u16..).zip(&mut behaviours) {
        if let Some(modes) = number(&objects, SUPPORTED_MODES + axis * AXIS_INCREMENT, 0) {
            behaviour.supported_modes = modes;
        }
    }
    DriveBlueprint {
        axes: behaviours,
        axis_increment: AXIS_INCREMENT,
        diagnosis: None,
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
        device_type: number(&objects, 0x1000, 0).unwrap_or(if axes > 0 { 0x0002_0192 } else { 0 }),
        assigned: None,
        pdo_habits: Vec::new(),
        saves: object(0x1010).is_some(),
        software_version: "simulated".to_owned(),
        hardware_version: "simulated".to_owned(),
        shows_only_these: !objects.is_empty(),
        objects,
    }
}

/// The number that the file gives an object at power-up.
fn number(objects: &[PlainObject], index: u16, subindex: u8) -> Option<u32> {
    let object = objects.iter().find(|object| object.index == index)?;
    let mut entries = object.entries.iter();
    let entry = entries.find(|entry| entry.subindex == subindex)?;
    let bytes = entry.default.as_ref().filter(|bytes| bytes.len() <= 4)?;
    let number = bytes
        .iter()
        .rev()
        .fold(0, |number, byte| number << 8 | u32::from(*byte));
    Some(number)
}

/// 1018h holds the identity of the device, whatever the dictionary says of it.
fn identify(objects: &mut [PlainObject], identity: Identity) {
    let numbers = [
        identity.vendor,
        identity.product,
        identity.revision,
        identity.serial,
    ];
    let own = objects.iter_mut().filter(|object| object.index == 0x1018);
    for entry in own.flat_map(|object| &mut object.entries) {
        let place = usize::from(entry.subindex).checked_sub(1);
        let number = place.and_then(|place| numbers.get(place));
        if let (Some(number), 4) = (number, entry.bytes) {
            entry.default = Some(number.to_le_bytes().to_vec());
        }
    }
}

/// What is read for a device: its own element, or that of a module, whose indices may depend on its slot (ETG.5001).
struct Part<'a> {
    element: Element<'a>,
    /// Added to the indices of PDOs, and to those of all other objects.
    pdos: u32,
    objects: u32,
}

impl<'a> Part<'a> {
    fn dictionary(&self) -> Option<Element<'a>> {
        self.element.at(&["Profile", "Dictionary"])
    }

    /// Mapping objects have the indices of their PDOs.
    fn index(&self, index: &Element<'_>) -> Result<u16, EsiError> {
        let base: u16 = index.number()?;
        if !index.is_set("DependOnSlot") {
            return Ok(base);
        }
        let is_pdo = (0x1600..0x1C00).contains(&base);
        let by = if is_pdo { self.pdos } else { self.objects };
        u32::from(base)
            .checked_add(by)
            .and_then(|index| u16::try_from(index).ok())
            .ok_or_else(|| {
                index.error(format!("{base:04X}h and {by:X}h for the slot are no index"))
            })
    }
}

/// The device, and the modules that its slots hold: the default one, or where one has to be there the first that fits.
fn parts<'a>(root: &Element<'a>, device: &Element<'a>) -> Result<Vec<Part<'a>>, EsiError> {
    let mut parts = vec![Part {
        element: *device,
        pdos: 0,
        objects: 0,
    }];
    let mut number = 0_u32;
    for slots in device.all("Slots") {
        for slot in slots.all("Slot") {
            let most: u32 = slot.attribute_number("MaxInstances")?.unwrap_or(1);
            let least: u32 = slot.attribute_number("MinInstances")?.unwrap_or(0);
            if most > MOST_SLOTS.saturating_sub(number) {
                return Err(slot.error(format!("a device has at most {MOST_SLOTS} slots")));
            }
            let default = slot
                .all("ModuleIdent")
                .find(|ident| ident.is_set("Default"));
            let first = slot.all("ModuleIdent").next();
            let step = |name: &'static str| -> Result<u32, EsiError> {
                let step = match slot.attribute_number(name)? {
                    Some(step) => Some(step),
                    None => slots.attribute_number(name)?,
                };
                Ok(step.unwrap_or(0))
            };
            let (pdos, objects) = (step("SlotPdoIncrement")?, step("SlotIndexIncrement")?);
            for instance in 0..most {
                let held = default.or_else(|| first.filter(|_| instance < least));
                if let Some(ident) = held {
                    parts.push(Part {
                        element: module(root, &ident)?,
                        pdos: pdos.saturating_mul(number),
                        objects: objects.saturating_mul(number),
                    });
                }
                number += 1;
            }
        }
    }
    Ok(parts)
}

/// The module that a slot names.
fn module<'a>(root: &Element<'a>, ident: &Element<'a>) -> Result<Element<'a>, EsiError> {
    let wanted: u32 = ident.number()?;
    let modules = root.all("Descriptions").flat_map(|all| all.all("Modules"));
    for module in modules.flat_map(|modules| modules.all("Module")) {
        let kind = module.at(&["Type"]);
        let own = kind.map(|kind| kind.attribute_number::<u32>("ModuleIdent"));
        if own.transpose()?.flatten() == Some(wanted) {
            return Ok(module);
        }
    }
    Err(ident.error(format!(
        "the slot holds module {wanted:08X}h, which is not in this file"
    )))
}
