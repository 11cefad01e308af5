//! A device of an ESI file.

use super::dictionary::{self, EsiEntry};
use super::error::{EsiError, EsiFault};
use super::modules::{self, DevicePart, EsiSlot, Modules};
use super::xml::Element;
use crate::coe::ObjectAddress;
use crate::parameters::{ObjectValue, StartUpList, StartUpWrite, Transition};
use crate::pdo_map::{Direction, Entry, Pdo};

/// Subindices that a mapping object has room for (CiA 301, object 1600h).
const MOST_ENTRIES_OF_A_PDO: usize = 254;

/// A device as its maker's ESI file describes it; made by [`Esi`](super::Esi).
#[derive(Debug, Clone, PartialEq, Eq)]
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
    /// The modes of its distributed clock; the first is the default.
    pub clock_modes: Vec<EsiClockMode>,
    /// What is written to it by CoE on its way to OP.
    pub init_commands: Vec<EsiInitCommand>,
}

/// A sync manager.
#[derive(Debug, Clone, PartialEq, Eq)]
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
pub struct EsiPdo {
    /// Index and content by default.
    pub pdo: Pdo,
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
pub struct EsiClockMode {
    /// The name.
    pub name: String,
    /// What is written to register 0980h.
    pub assign_activate: u16,
}

/// A start-up command (`InitCmd` of `CoE`).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EsiInitCommand {
    /// The transitions at which it is written.
    pub transitions: Vec<EsiTransition>,
    /// The object.
    pub object: ObjectAddress,
    /// The bytes.
    pub data: Vec<u8>,
    /// What it is for.
    pub comment: String,
}

/// A change of the AL state as ESI files name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EsiTransition {
    /// `PS`.
    PreOpToSafeOp,
    /// `SO`.
    SafeOpToOp,
    /// Another one, of those at which nothing is written here.
    Other,
}

impl EsiDevice {
    /// Its `InitCmd`s as a start-up list: those of `PS` in PREOP, those of `SO` in SAFEOP; others are left out.
    #[must_use]
    pub fn start_up_list(&self) -> StartUpList {
        let mut list = StartUpList::new();
        for command in &self.init_commands {
            for transition in &command.transitions {
                let transition = match transition {
                    EsiTransition::PreOpToSafeOp => Transition::PreOpToSafeOp,
                    EsiTransition::SafeOpToOp => Transition::SafeOpToOp,
                    EsiTransition::Other => continue,
                };
                let value = ObjectValue::Bytes(command.data.clone());
                let write = StartUpWrite::to(command.object, value);
                list = list.write(write.comment(&command.comment).at(transition));
            }
        }
        list
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
        let (slots, parts) = modules::parts(device, modules)?;
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
                dictionary::read(&element, of_device.as_ref(), part, room, &mut dictionary)?;
            }
            let coe = part
                .element
                .child("Mailbox")
                .and_then(|mailbox| mailbox.child("CoE"));
            for command in coe.iter().flat_map(|coe| coe.children("InitCmd")) {
                init_commands.push(read_command(&command, part)?);
            }
        }
        let clock = device.child("Dc");
        let modes = clock.iter().flat_map(|dc| dc.children("OpMode"));
        Ok(Self {
            vendor,
            product: kind.attribute_number("ProductCode")?.unwrap_or(0),
            revision: kind.attribute_number("RevisionNo")?.unwrap_or(0),
            kind: kind.text().to_owned(),
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
            clock_modes: modes
                .map(|mode| {
                    Ok(EsiClockMode {
                        name: mode.text_of("Name"),
                        assign_activate: mode.number_of("AssignActivate")?.unwrap_or(0),
                    })
                })
                .collect::<Result<_, EsiError>>()?,
            init_commands,
        })
    }
}

fn read_sync_manager(manager: &Element<'_>) -> Result<EsiSyncManager, EsiError> {
    Ok(EsiSyncManager {
        purpose: manager.text().to_owned(),
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
        pdo: Pdo {
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
    let transition = |element: Element<'_>| match element.text() {
        "PS" => EsiTransition::PreOpToSafeOp,
        "SO" => EsiTransition::SafeOpToOp,
        _ => EsiTransition::Other,
    };
    Ok(EsiInitCommand {
        transitions: command.children("Transition").map(transition).collect(),
        object: ObjectAddress::new(
            part.object_index(&command.need("Index")?)?,
            command.need("SubIndex")?.number()?,
        ),
        data: command.need("Data")?.bytes()?,
        comment: command.text_of("Comment"),
    })
}
