//! A device of an ESI file.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;

use super::xml::{Element, EsiError, EsiFault, Max, quoted};
use crate::coe::{ErrorTexts, Mappable, ObjectAddress, obj};
use crate::ds402::Mode;
use crate::parameters::{
    ObjectValue, StartUpLines, StartUpList, StartUpWrite, Transition, WriteFault,
};
use crate::pdo_map::{Direction, Entry, MappedPdo};

/// Subindices that a mapping object has room for (CiA 301, object 1600h).
const MOST_ENTRIES_OF_A_PDO: usize = 254;

/// A device as its maker's ESI file describes it; made by [`Esi`](super::Esi).
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct EsiDevice {
    /// The maker's number.
    pub vendor: u32,
    /// The product code.
    pub product: u32,
    /// The revision number.
    pub revision: u32,
    /// The type, as it is ordered.
    pub kind: String,
    /// The name, in the file's first language.
    pub name: String,
    /// The sync managers, in order.
    pub sync_managers: Vec<EsiSyncManager>,
    /// Whether PDOs with a free content can be filled by SDO (`CoE`, `PdoConfig`).
    pub fills_pdos: bool,
    /// Whether the SDO information service is there.
    pub sdo_information: bool,
    /// Whether complete access is there.
    pub complete_access: bool,
    /// The slots of a modular device, in order; what the modules in them have is among the rest.
    pub slots: Vec<EsiSlot>,
    /// The PDOs of both directions.
    pub pdos: Vec<EsiPdo>,
    /// The entries of all objects of its dictionary, in the file's order; empty if the file has none.
    pub dictionary: Vec<EsiEntry>,
    /// What its errors mean: texts of diagnosis messages (`DiagMessages`), and of the values of 603Fh where their data type lists them
    /// (`EnumInfo`).
    pub error_texts: ErrorTexts,
    /// The modes of its distributed clock; the first is the default.
    pub clock_modes: Vec<EsiClockMode>,
    /// What is written to it by CoE on its way to OP.
    pub init_commands: Vec<EsiInitCommand>,
    /// The register in which its explicit device identification always stands (`IdentificationAdo`): for
    /// [`DevicePlace::IdentificationAt`](crate::bus::DevicePlace::IdentificationAt).
    pub identification_ado: Option<u16>,
}

/// A sync manager.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct EsiSyncManager {
    /// What it is for: `MBoxOut`, `MBoxIn`, `Outputs`, `Inputs`.
    pub purpose: String,
    /// The first address of its memory.
    pub start: Option<u16>,
    /// The control byte.
    pub control: Option<u8>,
    /// The most bytes that it takes, where the file says.
    pub most_bytes: Option<u16>,
}

/// A PDO.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct EsiPdo {
    /// Index and content by default.
    pub pdo: MappedPdo,
    /// Which way its data go.
    pub direction: Direction,
    /// The name.
    pub name: String,
    /// Its content cannot be changed.
    pub fixed: bool,
    /// It must be assigned.
    pub mandatory: bool,
    /// The sync manager to which it is assigned by default.
    pub sync_manager: Option<u8>,
    /// The PDOs that cannot be assigned beside it.
    pub excludes: Vec<u16>,
}

/// A mode of the distributed clock (`OpMode`).
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct EsiClockMode {
    /// The name.
    pub name: String,
    /// What is written to register 0980h.
    pub assign_activate: u16,
}

/// A start-up command (`InitCmd` of `CoE`).
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct EsiInitCommand {
    /// The transitions at which it is written.
    pub transitions: Vec<EsiTransition>,
    /// The object.
    pub object: ObjectAddress,
    /// The bytes.
    pub data: Vec<u8>,
    /// Whether the bytes are all subindices from the object's one on, by complete access.
    pub complete_access: bool,
    /// What it is for.
    pub comment: String,
}

/// A change of the AL state as ESI files name it.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum EsiTransition {
    /// `IP`.
    InitToPreOp,
    /// `PS`.
    PreOpToSafeOp,
    /// `SO`.
    SafeOpToOp,
    /// Another one, as the file names it, cut to 40 characters. At these the library writes nothing.
    Other(String),
}

impl fmt::Display for EsiTransition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::InitToPreOp => "IP",
            Self::PreOpToSafeOp => "PS",
            Self::SafeOpToOp => "SO",
            Self::Other(name) => name,
        })
    }
}

/// An `InitCmd` that the library cannot execute as the file asks.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the InitCmd {}{} of {device} {why}: take it out of the file, or of `EsiDevice::init_commands`",
    command.object,
    if command.comment.is_empty() { String::new() } else { format!(" (\"{}\")", command.comment) }
)]
#[non_exhaustive]
pub struct RefusedInitCommand {
    /// The device's name.
    pub device: String,
    /// The command.
    pub command: Box<EsiInitCommand>,
    /// Why not.
    pub why: InitCommandFault,
}

/// Why an `InitCmd` cannot be executed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum InitCommandFault {
    /// Its transition is none of `IP`, `PS` and `SO`.
    #[error(
        "is for the transition {0}, and only those of IP, PS and SO are executed; write the object otherwise if the drive needs it"
    )]
    Transition(EsiTransition),
    /// It writes several subindices at once.
    #[error(
        "is written by complete access, and only single subindices are; write the object otherwise if the drive needs it"
    )]
    CompleteAccess,
    /// It is a controlword, a mode or a target, and asks for something else than the library does, which writes these itself.
    #[error(
        "writes {0:02X?}, but controlword, mode and targets are written by the handles of an axis alone"
    )]
    Owned(Vec<u8>),
}

impl EsiDevice {
    /// Its `InitCmd`s as a start-up list. Those of `IP` come first, in PREOP, since a drive in INIT has no mailbox. Those of `PS`
    /// follow, also in PREOP, and those of `SO` in SAFEOP.
    ///
    /// Left out is what the library does itself: the PDO assignment (1C12h, 1C13h), the content of PDOs that it fills, Profile Position as
    /// the mode 6060h, and a controlword, a mode or a target of 0.
    ///
    /// # Errors
    /// [`RefusedInitCommand`] for the first command of another transition, by complete access, or with another controlword, mode or target.
    pub fn start_up_list(&self) -> Result<StartUpList, RefusedInitCommand> {
        let refused = |command: &EsiInitCommand, why| RefusedInitCommand {
            device: self.name.clone(),
            command: Box::new(command.clone()),
            why,
        };
        let (mut first, mut further) = (Vec::new(), Vec::new());
        for command in &self.init_commands {
            if let Some(why) = StartUpLines::of_the_library(command.object) {
                if is_as_the_library(&command.data, &why) {
                    continue;
                }
                let data = command.data.clone();
                return Err(refused(command, InitCommandFault::Owned(data)));
            }
            if self.is_mapped_by_the_library(command.object.index) {
                continue;
            }
            if command.complete_access {
                return Err(refused(command, InitCommandFault::CompleteAccess));
            }
            let value = ObjectValue::Bytes(command.data.clone());
            let write = StartUpWrite::to(command.object, value).comment(&command.comment);
            for transition in &command.transitions {
                match transition {
                    EsiTransition::InitToPreOp => first.push(write.clone()),
                    EsiTransition::PreOpToSafeOp => further.push(write.clone()),
                    EsiTransition::SafeOpToOp => {
                        further.push(write.clone().at(Transition::SafeOpToOp));
                    }
                    EsiTransition::Other(_) => {
                        let why = InitCommandFault::Transition(transition.clone());
                        return Err(refused(command, why));
                    }
                }
            }
        }
        let all = first.into_iter().chain(further);
        Ok(all.fold(StartUpList::new(), StartUpList::write))
    }

    /// Whether an object assigns PDOs, or is one that the library fills: it writes these, and reads them back.
    fn is_mapped_by_the_library(&self, index: u16) -> bool {
        let is_filled = |pdo: &EsiPdo| pdo.pdo.index == index && !self.is_fixed(pdo);
        let directions = [Direction::Outputs, Direction::Inputs];
        directions.iter().any(|one| one.assignment() == index) || self.pdos.iter().any(is_filled)
    }

    pub(super) fn read<'a>(
        vendor: u32,
        device: &Element<'a>,
        modules: &Modules<'a>,
        room: &mut usize,
    ) -> Result<Self, EsiError> {
        let kind = device.need("Type")?;
        let coe = device
            .child("Mailbox")
            .and_then(|mailbox| mailbox.child("CoE"));
        let mut pdos = Vec::new();
        let mut dictionary = Vec::new();
        let mut init_commands = Vec::new();
        let (slots, parts) = parts(device, modules)?;
        let dictionary_of = |element: &Element<'a>| {
            let mut profiles = element.children("Profile");
            profiles.find_map(|profile| profile.child("Dictionary"))
        };
        let of_device = dictionary_of(device);
        for (name, direction) in [("RxPdo", Direction::Outputs), ("TxPdo", Direction::Inputs)] {
            for part in &parts {
                for pdo in part.element.children(name) {
                    pdos.push(read_pdo(&pdo, part, direction)?);
                }
            }
        }
        for part in &parts {
            if let Some(element) = dictionary_of(&part.element) {
                read_dictionary(&element, of_device.as_ref(), part, room, &mut dictionary)?;
            }
            let coe = part
                .element
                .child("Mailbox")
                .and_then(|mailbox| mailbox.child("CoE"));
            for command in coe.iter().flat_map(|coe| coe.children("InitCmd")) {
                init_commands.push(read_command(&command, part)?);
            }
        }
        let mut error_texts = ErrorTexts::default();
        for part in &parts {
            for profile in part.element.children("Profile") {
                read_error_texts(&profile, &mut error_texts);
            }
        }
        let clock = device.child("Dc");
        let modes = clock.iter().flat_map(|dc| dc.children("OpMode"));
        let info = device.child("Info");
        Ok(Self {
            vendor,
            product: kind.attribute_number("ProductCode")?.unwrap_or(0),
            revision: kind.attribute_number("RevisionNo")?.unwrap_or(0),
            kind: kind.text().into_owned(),
            name: device.text_of("Name"),
            sync_managers: device
                .children("Sm")
                .map(|manager| read_sync_manager(&manager))
                .collect::<Result<_, _>>()?,
            fills_pdos: coe.is_some_and(|coe| coe.flag("PdoConfig")),
            sdo_information: coe.is_some_and(|coe| coe.flag("SdoInfo")),
            complete_access: coe.is_some_and(|coe| coe.flag("CompleteAccess")),
            slots,
            pdos,
            dictionary,
            error_texts,
            clock_modes: modes
                .map(|mode| {
                    Ok(EsiClockMode {
                        name: mode.text_of("Name"),
                        assign_activate: mode.number_of("AssignActivate")?.unwrap_or(0),
                    })
                })
                .collect::<Result<_, EsiError>>()?,
            init_commands,
            identification_ado: match info {
                Some(info) => info.number_of("IdentificationAdo")?,
                None => None,
            },
        })
    }
}

/// Whether a command to an object of the library asks for what that does anyway: nothing, or Profile Position as the mode.
fn is_as_the_library(data: &[u8], object: &WriteFault) -> bool {
    let is_nothing = data.iter().all(|byte| *byte == 0);
    match object {
        WriteFault::Mode => is_nothing || data == Mode::ProfilePosition.raw().to_le_bytes(),
        WriteFault::Statusword => false,
        _ => is_nothing,
    }
}

fn read_sync_manager(manager: &Element<'_>) -> Result<EsiSyncManager, EsiError> {
    Ok(EsiSyncManager {
        purpose: manager.text().into_owned(),
        start: manager.attribute_number("StartAddress")?,
        control: manager.attribute_number("ControlByte")?,
        most_bytes: manager.attribute_number("MaxSize")?,
    })
}

fn read_pdo(
    element: &Element<'_>,
    part: &DevicePart<'_>,
    direction: Direction,
) -> Result<EsiPdo, EsiError> {
    let index_element = element.need("Index")?;
    let index = part.pdo_index(&index_element)?;
    if !direction.pdo_range().contains(&index) {
        return Err(index_element.error(EsiFault::PdoIndex(index)));
    }
    if element.children("Entry").count() > MOST_ENTRIES_OF_A_PDO {
        return Err(element.error(EsiFault::LongPdo(index)));
    }
    let entry = |entry: Element<'_>| {
        Ok(Entry::new(
            part.object_index(&entry.need("Index")?)?,
            entry.number_of("SubIndex")?.unwrap_or(0),
            entry.need("BitLen")?.number()?,
        ))
    };
    Ok(EsiPdo {
        pdo: MappedPdo {
            index,
            entries: element
                .children("Entry")
                .map(entry)
                .collect::<Result<_, _>>()?,
        },
        direction,
        name: element.text_of("Name"),
        fixed: element.flag("Fixed"),
        mandatory: element.flag("Mandatory"),
        sync_manager: element.attribute_number("Sm")?,
        excludes: element
            .children("Exclude")
            .map(|other| part.pdo_index(&other))
            .collect::<Result<_, _>>()?,
    })
}

fn read_command(command: &Element<'_>, part: &DevicePart<'_>) -> Result<EsiInitCommand, EsiError> {
    let transition = |element: Element<'_>| match element.text().as_ref() {
        "IP" => EsiTransition::InitToPreOp,
        "PS" => EsiTransition::PreOpToSafeOp,
        "SO" => EsiTransition::SafeOpToOp,
        other => EsiTransition::Other(quoted(other)),
    };
    // Without one it would never be written.
    command.need("Transition")?;
    Ok(EsiInitCommand {
        complete_access: command.flag("CompleteAccess"),
        transitions: command.children("Transition").map(transition).collect(),
        object: ObjectAddress::new(
            part.object_index(&command.need("Index")?)?,
            command.need("SubIndex")?.number()?,
        ),
        data: command.need("Data")?.bytes()?,
        comment: command.text_of("Comment"),
    })
}

// Modules in the slots of a device, which hold the PDOs of an axis each in the files of many drives (ETG.5001).

/// Slots of a device. Real files have one for an axis, and couplers up to 255.
const MOST_SLOTS: u16 = 255;

/// A slot of a device, with the module that the file puts there: by default, or because one has to be there.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct EsiSlot {
    /// The slot's name.
    pub name: String,
    /// The identification of the module in it; none where it is empty. What the module has is read if it is in the same file.
    pub module: Option<u32>,
    /// The modules that fit, by their identification.
    pub fitting: Vec<u32>,
}

/// The modules of a file, by their identification.
pub(super) struct Modules<'a>(BTreeMap<u32, Element<'a>>);

impl<'a> Modules<'a> {
    /// One that names no identification is in no slot.
    pub fn read(root: &Element<'a>) -> Self {
        let mut modules = BTreeMap::new();
        for module in root
            .children("Descriptions")
            .flat_map(|descriptions| descriptions.children("Modules"))
            .flat_map(|modules| modules.children("Module"))
        {
            let kind = module.child("Type");
            if let Some(ident) = kind.and_then(|kind| kind.attribute_number("ModuleIdent").ok()?) {
                modules.entry(ident).or_insert(module);
            }
        }
        Self(modules)
    }
}

/// What is read for a device: its own element, or a module with the place where it is put.
#[derive(Clone, Copy)]
struct DevicePart<'a> {
    pub element: Element<'a>,
    /// Added to the index of a PDO that depends on the slot.
    pdo_offset: u32,
    /// Added to the index of an object that depends on the slot.
    object_offset: u32,
}

impl<'a> DevicePart<'a> {
    pub const fn device(element: Element<'a>) -> Self {
        Self {
            element,
            pdo_offset: 0,
            object_offset: 0,
        }
    }

    pub fn pdo_index(&self, index: &Element<'_>) -> Result<u16, EsiError> {
        shifted(index, self.pdo_offset)
    }

    pub fn object_index(&self, index: &Element<'_>) -> Result<u16, EsiError> {
        // The object that maps a PDO has the PDO's index.
        let offset = match index.number()? {
            0x1600..=0x1BFF_u16 => self.pdo_offset,
            _ => self.object_offset,
        };
        shifted(index, offset)
    }
}

fn shifted(index: &Element<'_>, by: u32) -> Result<u16, EsiError> {
    let base: u16 = index.number()?;
    if !index.flag("DependOnSlot") {
        return Ok(base);
    }
    u32::from(base)
        .checked_add(by)
        .and_then(|index| u16::try_from(index).ok())
        .ok_or_else(|| {
            index.error(EsiFault::Number {
                max: <u16 as Max>::MAX,
                got: format!("{base} and {by} for the slot"),
            })
        })
}

/// The slots of a device, and the device's element followed by the modules in them.
fn parts<'a>(
    device: &Element<'a>,
    modules: &Modules<'a>,
) -> Result<(Vec<EsiSlot>, Vec<DevicePart<'a>>), EsiError> {
    let mut slots = Vec::new();
    let mut parts = vec![DevicePart::device(*device)];
    for all in device.children("Slots") {
        for slot in all.children("Slot") {
            let instances: u16 = slot.attribute_number("MaxInstances")?.unwrap_or(1);
            let needed: u16 = slot.attribute_number("MinInstances")?.unwrap_or(0);
            if slots.len() + usize::from(instances) > usize::from(MOST_SLOTS) {
                return Err(slot.error(EsiFault::TooManySlots));
            }
            let mut fitting = Vec::new();
            let mut default = None;
            for ident in slot.children("ModuleIdent") {
                let number: u32 = ident.number()?;
                if ident.flag("Default") {
                    default = default.or(Some(number));
                }
                fitting.push(number);
            }
            for instance in 0..instances {
                let must = instance < needed;
                let module = default.or_else(|| fitting.first().copied().filter(|_| must));
                let number = u32::try_from(slots.len()).unwrap_or(u32::MAX);
                if let Some(element) = module.and_then(|ident| modules.0.get(&ident)) {
                    let offset = |name| -> Result<u32, EsiError> {
                        let own: Option<u32> = slot.attribute_number(name)?;
                        let step =
                            own.map_or_else(|| all.attribute_number(name), |own| Ok(Some(own)))?;
                        Ok(step.unwrap_or(0).saturating_mul(number))
                    };
                    parts.push(DevicePart {
                        element: *element,
                        pdo_offset: offset("SlotPdoIncrement")?,
                        object_offset: offset("SlotIndexIncrement")?,
                    });
                }
                slots.push(EsiSlot {
                    name: slot.text_of("Name"),
                    module,
                    fitting: fitting.clone(),
                });
            }
        }
    }
    Ok((slots, parts))
}

// The dictionary of a device: its objects, unfolded by their data types into entries.

/// Entries of all dictionaries of a file together. A short file can name data types of many subindices often.
pub(super) const MOST_ENTRIES: usize = 1 << 18;

/// An entry of a device's dictionary.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct EsiEntry {
    /// Where it is.
    pub object: ObjectAddress,
    /// The name; for an element of an array that of the object.
    pub name: String,
    /// Its length in bits; of a text the most.
    pub bits: u32,
    /// It is text or another value of varying length.
    pub varies: bool,
    /// It can be read.
    pub readable: bool,
    /// It can be written.
    pub writable: bool,
    /// The PDOs into which it can be mapped.
    pub mappable: Mappable,
    /// The bytes that it holds by default (`DefaultData`, `DefaultValue`); empty where the file does not say. Those of an array's elements
    /// are not read.
    pub default: Vec<u8>,
}

/// Access and mapping, as `Flags` says; a subitem's are those of its object where it says nothing.
#[derive(Clone, Copy)]
struct Flags {
    readable: bool,
    writable: bool,
    mappable: Mappable,
}

impl Flags {
    fn read(element: &Element<'_>, otherwise: Self) -> Self {
        let Some(flags) = element.child("Flags") else {
            return otherwise;
        };
        let access = flags.text_of("Access");
        let mapping = flags.text_of("PdoMapping").to_uppercase();
        Self {
            readable: access.is_empty() && otherwise.readable || access.contains('r'),
            writable: access.contains('w'),
            mappable: Mappable {
                outputs: mapping.contains('R'),
                inputs: mapping.contains('T'),
            },
        }
    }
}

/// The most letters of a text.
const MOST_LETTERS: usize = 256;

/// Adds what a profile says of errors.
fn read_error_texts(profile: &Element<'_>, texts: &mut ErrorTexts) {
    let text_of = |element: &Element<'_>, name| -> Cow<'static, str> {
        let text = element.text_of(name);
        text.chars().take(MOST_LETTERS).collect::<String>().into()
    };
    for message in profile
        .children("DiagMessages")
        .flat_map(|messages| messages.children("DiagMessage"))
    {
        // A text that is not understood is missed by nobody but a reader.
        if let Ok(Some(id)) = message.number_of("TextId") {
            texts.diagnosis.insert(id, text_of(&message, "MessageText"));
        }
    }
    for dictionary in profile.children("Dictionary") {
        let objects = dictionary.children("Objects");
        let mut objects = objects.flat_map(|objects| objects.children("Object"));
        let is_error_code = |object: &Element<'_>| {
            let index = object.child("Index").and_then(|index| index.number().ok());
            index == Some(obj::ERROR_CODE.index())
        };
        let Some(object) = objects.find(is_error_code) else {
            continue;
        };
        let named = object.text_of("Type");
        let types = dictionary.children("DataTypes");
        let mut types = types.flat_map(|types| types.children("DataType"));
        let Some(kind) = types.find(|kind| kind.text_of("Name") == named) else {
            continue;
        };
        for value in kind.children("EnumInfo") {
            if let Ok(Some(code)) = value.number_of("Enum") {
                texts.codes.insert(code, text_of(&value, "Text"));
            }
        }
    }
}

/// Adds the entries of a dictionary. A module's may name data types of its device's.
fn read_dictionary(
    dictionary: &Element<'_>,
    of_device: Option<&Element<'_>>,
    part: &DevicePart<'_>,
    room: &mut usize,
    entries: &mut Vec<EsiEntry>,
) -> Result<(), EsiError> {
    let types: BTreeMap<_, _> = of_device
        .into_iter()
        .chain([dictionary])
        .flat_map(|dictionary| dictionary.children("DataTypes"))
        .flat_map(|types| types.children("DataType"))
        .filter_map(|kind| Some((kind.child("Name")?.text(), kind)))
        .collect();
    for object in dictionary
        .children("Objects")
        .flat_map(|objects| objects.children("Object"))
    {
        let mut unfolding = Unfolding {
            types: &types,
            index: part.object_index(&object.need("Index")?)?,
            object,
            room,
            entries,
        };
        unfolding.unfold()?;
    }
    Ok(())
}

struct Unfolding<'a, 'b> {
    types: &'a BTreeMap<Cow<'a, str>, Element<'a>>,
    index: u16,
    object: Element<'a>,
    room: &'b mut usize,
    entries: &'b mut Vec<EsiEntry>,
}

impl Unfolding<'_, '_> {
    fn unfold(&mut self) -> Result<(), EsiError> {
        let nothing = Flags {
            readable: true,
            writable: false,
            mappable: Mappable::NO,
        };
        let flags = Flags::read(&self.object, nothing);
        let name = self.object.text_of("Name");
        let type_name = self.object.text_of("Type");
        let kind = self.types.get(type_name.as_str()).copied();
        let mut subitems = kind
            .iter()
            .flat_map(|kind| kind.children("SubItem"))
            .peekable();
        if subitems.peek().is_none() {
            let bits = self.object.number_of("BitSize")?.unwrap_or(0);
            let default = default_of(self.object.child("Info"), bits);
            return self.push(0, &name, &type_name, bits, flags, default);
        }
        let infos = self.object.child("Info");
        let mut infos = infos.iter().flat_map(|info| info.children("SubItem"));
        for item in subitems {
            let info = infos.next();
            let type_of_item = item.text_of("Type");
            let bits: u32 = item.number_of("BitSize")?.unwrap_or(0);
            let flags = Flags::read(&item, flags);
            if let Some(subindex) = item.number_of("SubIdx")? {
                let name = item.text_of("Name");
                // They stand in the order of the type's subitems.
                let info = info.filter(|info| info.text_of("Name") == name);
                let default = default_of(info.and_then(|info| info.child("Info")), bits);
                self.push(subindex, &name, &type_of_item, bits, flags, default)?;
                continue;
            }
            // The elements of an array, which follow subindex 0.
            let array = self.types.get(type_of_item.as_str());
            let bounds = array.and_then(|array| array.child("ArrayInfo"));
            let Some(bounds) = bounds else { continue };
            let first: u8 = bounds.number_of("LBound")?.unwrap_or(1).max(1);
            let elements: u8 = bounds.need("Elements")?.number()?;
            let base = array
                .map(|array| array.text_of("BaseType"))
                .unwrap_or_default();
            let bits = bits.checked_div(u32::from(elements)).unwrap_or(0);
            for subindex in (first..=u8::MAX).take(usize::from(elements)) {
                self.push(subindex, &name, &base, bits, flags, Vec::new())?;
            }
        }
        Ok(())
    }

    fn push(
        &mut self,
        subindex: u8,
        name: &str,
        type_name: &str,
        bits: u32,
        flags: Flags,
        default: Vec<u8>,
    ) -> Result<(), EsiError> {
        *self.room = self
            .room
            .checked_sub(1)
            .ok_or_else(|| self.object.error(EsiFault::TooManyEntries))?;
        // A name is repeated for each element of an array.
        let name = name.chars().take(128).collect();
        self.entries.push(EsiEntry {
            object: ObjectAddress::new(self.index, subindex),
            name,
            bits,
            varies: type_name.contains("STRING") || type_name.contains("ARRAY"),
            readable: flags.readable,
            writable: flags.writable,
            mappable: flags.mappable,
            default,
        });
        Ok(())
    }
}

/// The bytes that an `Info` names as the default, if it does.
fn default_of(info: Option<Element<'_>>, bits: u32) -> Vec<u8> {
    let named = |name| info.and_then(|info| info.child(name));
    if let Some(data) = named("DefaultData") {
        return data.bytes().unwrap_or_default();
    }
    let value = named("DefaultValue").and_then(|value| value.number::<u32>().ok());
    let bytes = value.map(u32::to_le_bytes).into_iter().flatten();
    bytes.take(bits.div_ceil(8) as usize).collect()
}
