//! A drive description made of an ESI file's device.

use super::device::{EsiDevice, EsiPdo};
use crate::coe::{AnyObject, AxisOffset, ObjectAddress, obj};
use crate::drives::{AxisDescription, DriveDescription};
use crate::pdo_map::{Direction, FixedPdo, MappingLimits};
use crate::profile_position::{RelativeBase, Traits};

/// Axes for which the profile has room.
const MOST_AXES: u8 = 8;

/// The device has no axis: no controlword 6040h, 6840h … in a PDO, in the dictionary or in a module of its slots.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{device} is no drive: its ESI file has no controlword (6040h) in a PDO or in the dictionary{}",
    if *.slots == 0 { "" } else { ", nor in a module that its slots hold by default" }
)]
pub struct NoAxis {
    /// The device's name.
    pub device: String,
    /// How many slots it has for modules.
    pub slots: usize,
}

/// An ESI file's device that cannot be a drive of a network: [`DriveConfig::from_esi`](crate::DriveConfig::from_esi).
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EsiDriveError {
    /// It has no axis.
    #[error(transparent)]
    NoAxis(#[from] NoAxis),
    /// One of its `InitCmd`s cannot be executed.
    #[error(transparent)]
    InitCommand(#[from] super::RefusedInitCommand),
}

impl EsiDevice {
    /// What the library must know of the drive, as far as the file says it.
    ///
    /// An axis for each controlword. PDOs with a fixed content are fixed, or all where the drive does not let them be filled
    /// (`PdoConfig`). The others are free, those that are assigned by default before the rest. Each is for the axis whose objects
    /// it holds by default. MappingLimits come from the number of subindices of 16xxh, 1Axxh, 1C12h and 1C13h in the dictionary, and from
    /// `MaxSize` of the sync managers, the synchronisation types from the defaults of 1C32h:1 and 1C33h:1. What an axis exchanges is what the usual Profile Position needs of what the file has.
    ///
    /// How bits 5, 9, 10 and 12 behave is in no ESI file: the traits are those of [`generic`](crate::drives::generic). Change them
    /// by the drive's manual.
    ///
    /// # Errors
    /// [`NoAxis`] if the device is no drive.
    pub fn description(&self) -> Result<DriveDescription, NoAxis> {
        let axes = (1..=MOST_AXES).map(|axis| (axis, AxisOffset::of_axis(axis)));
        let there = axes.filter(|(_, offset)| {
            self.has(
                Direction::Outputs,
                obj::CONTROLWORD.offset(*offset).address(),
            )
        });
        let mut descriptions: Vec<_> = there
            .map(|(axis, offset)| (axis, self.axis(offset)))
            .collect();
        let only_one = descriptions.len() == 1;
        for direction in [Direction::Outputs, Direction::Inputs] {
            // An empty PDO belongs to the axis of the one before it.
            let mut current = 1;
            let mut free: Vec<(u8, &EsiPdo)> = Vec::new();
            let mut pdos: Vec<_> = self
                .pdos
                .iter()
                .filter(|pdo| pdo.direction == direction)
                .collect();
            pdos.sort_by_key(|pdo| pdo.pdo.index);
            for pdo in pdos {
                current = axis_of(pdo).unwrap_or(current);
                if !self.is_fixed(pdo) {
                    free.push((current, pdo));
                }
            }
            free.sort_by_key(|(_, pdo)| (pdo.sync_manager.is_none(), pdo.pdo.index));
            for (axis, description) in &mut descriptions {
                let own = free.iter().filter(|(of, _)| only_one || of == axis);
                let indices = own.map(|(_, pdo)| pdo.pdo.index).collect();
                match direction {
                    Direction::Outputs => description.rx_pdos = indices,
                    Direction::Inputs => description.tx_pdos = indices,
                }
            }
        }
        if descriptions.is_empty() {
            return Err(NoAxis {
                device: self.name.clone(),
                slots: self.slots.len(),
            });
        }
        Ok(DriveDescription {
            name: self.name.clone().into(),
            vendor: Some(self.vendor),
            product: Some(self.product),
            axes: descriptions.into_iter().map(|(_, axis)| axis).collect(),
            fixed_pdos: self.fixed_pdos(),
            error_texts: self.error_texts.clone(),
            limits: self.limits(),
            traits: Traits {
                relative_base: RelativeBase::PositioningOption,
                ..Traits::cia402()
            },
            sync_types: [
                obj::OUTPUT_SYNC_TYPE.address(),
                obj::INPUT_SYNC_TYPE.address(),
            ]
            .map(|object| self.default_of(object)),
        })
    }

    /// The number of 16 bits that an object holds by default.
    fn default_of(&self, object: ObjectAddress) -> Option<u16> {
        let entry = self
            .dictionary
            .iter()
            .find(|entry| entry.object == object)?;
        let bytes = entry.default.as_slice().try_into().ok()?;
        Some(u16::from_le_bytes(bytes))
    }

    /// Whether the content of a PDO cannot be changed.
    pub(super) fn is_fixed(&self, pdo: &EsiPdo) -> bool {
        pdo.fixed || !self.fills_pdos
    }

    fn fixed_pdos(&self) -> Vec<FixedPdo> {
        let fixed = self.pdos.iter().filter(|pdo| self.is_fixed(pdo));
        fixed
            .map(|pdo| FixedPdo {
                pdo: pdo.pdo.clone(),
                mandatory: pdo.mandatory,
                excludes: pdo.excludes.clone(),
            })
            .collect()
    }

    fn axis(&self, offset: AxisOffset) -> AxisDescription {
        let usual = AxisDescription::profile_position(1, 0, 0);
        let of_file = |direction, mut objects: Vec<AnyObject>| {
            objects.retain(|object| self.has(direction, object.offset(offset).address()));
            objects
        };
        AxisDescription {
            offset,
            rx_pdos: Vec::new(),
            tx_pdos: Vec::new(),
            outputs: of_file(Direction::Outputs, usual.outputs),
            inputs: of_file(Direction::Inputs, usual.inputs),
        }
    }

    /// Whether an object is in a PDO by default, or in the dictionary and can be mapped.
    fn has(&self, direction: Direction, object: ObjectAddress) -> bool {
        let in_pdo = |pdo: &EsiPdo| {
            pdo.direction == direction
                && pdo
                    .pdo
                    .entries
                    .iter()
                    .any(|entry| entry.address() == object)
        };
        self.pdos.iter().any(in_pdo)
            || self.dictionary.iter().any(|entry| {
                entry.object == object
                    && match direction {
                        Direction::Outputs => entry.mappable.outputs,
                        Direction::Inputs => entry.mappable.inputs,
                    }
            })
    }

    fn limits(&self) -> MappingLimits {
        let last_of = |index: u16| {
            let entries = self
                .dictionary
                .iter()
                .filter(|entry| entry.object.index == index);
            entries
                .map(|entry| usize::from(entry.object.subindex))
                .max()
                .filter(|last| *last > 0)
        };
        let usual = MappingLimits::default();
        let free = self.pdos.iter().filter(|pdo| !self.is_fixed(pdo));
        let mut entries: Vec<_> = free
            .filter_map(|pdo| Some((pdo.pdo.index, last_of(pdo.pdo.index)?)))
            .collect();
        // Also for those of which the dictionary says nothing.
        let fewest = entries.iter().map(|(_, most)| *most).min();
        entries.retain(|(_, most)| Some(*most) != fewest);
        let bytes = |purpose: &str, otherwise| {
            let manager = self
                .sync_managers
                .iter()
                .find(|manager| manager.purpose == purpose);
            let most = manager.and_then(|manager| manager.most_bytes);
            most.map_or(otherwise, usize::from)
        };
        MappingLimits {
            entries_per_pdo: fewest.unwrap_or(usual.entries_per_pdo),
            other_pdos: entries,
            output_pdos: last_of(0x1C12).unwrap_or(usual.output_pdos),
            input_pdos: last_of(0x1C13).unwrap_or(usual.input_pdos),
            output_bytes: bytes("Outputs", usual.output_bytes),
            input_bytes: bytes("Inputs", usual.input_bytes),
        }
    }
}

/// The axis, counted from 1, whose profile objects a PDO holds by default.
fn axis_of(pdo: &EsiPdo) -> Option<u8> {
    let profile = pdo.pdo.entries.iter().map(|entry| entry.index);
    let first = profile
        .filter(|index| (0x6000..0xA000).contains(index))
        .min()?;
    u8::try_from((first - 0x6000) / AxisOffset::PROFILE_STEP + 1).ok()
}
