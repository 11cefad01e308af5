//! Modules in the slots of a device, which hold the PDOs of an axis each in the files of many drives (ETG.5001).

use std::collections::BTreeMap;

use super::error::{EsiError, EsiFault};
use super::xml::{Element, Max};

/// Slots of a device. Real files have one for an axis, and couplers up to 255.
const MOST_SLOTS: u16 = 255;

/// A slot of a device, with the module that the file puts there: by default, or because one has to be there.
#[derive(Debug, Clone, PartialEq, Eq)]
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
    pub(super) fn read(root: &Element<'a>) -> Result<Self, EsiError> {
        let mut modules = BTreeMap::new();
        for module in root
            .children("Descriptions")
            .flat_map(|descriptions| descriptions.children("Modules"))
            .flat_map(|modules| modules.children("Module"))
        {
            if let Some(ident) = module.need("Type")?.attribute_number("ModuleIdent")? {
                modules.entry(ident).or_insert(module);
            }
        }
        Ok(Self(modules))
    }
}

/// What is read for a device: its own element, or a module with the place where it is put.
#[derive(Clone, Copy)]
pub(super) struct DevicePart<'a> {
    pub(super) element: Element<'a>,
    /// Added to the index of a PDO that depends on the slot.
    pdo_offset: u32,
    /// Added to the index of an object that depends on the slot.
    object_offset: u32,
}

impl<'a> DevicePart<'a> {
    pub(super) const fn device(element: Element<'a>) -> Self {
        Self {
            element,
            pdo_offset: 0,
            object_offset: 0,
        }
    }

    pub(super) fn pdo_index(&self, index: &Element<'_>) -> Result<u16, EsiError> {
        shifted(index, self.pdo_offset)
    }

    pub(super) fn object_index(&self, index: &Element<'_>) -> Result<u16, EsiError> {
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
pub(super) fn parts<'a>(
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
