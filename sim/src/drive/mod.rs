//! A CoE servo drive behind its ESC: object dictionary, process data and the DS402 axes.

mod blueprint;
mod communication;
mod diagnosis;
mod history;
mod information;
mod plain;
mod sdo;

use core::time::Duration;
use std::collections::BTreeSet;

use crate::coe::Abort;
use crate::coe::info::access;
use crate::description::{Description, Direction};
use crate::dictionary::Dictionary;
use crate::ds402::{Access, Axis, Emergency, Entry as AxisEntry, Mapping, SetError};
use crate::pdo::{Mappable, PdoSet};
pub use blueprint::{AxisStatusObject, DriveBlueprint, PlainEntry, PlainObject};
use communication::{LOAD, SAVE, communication_objects};
use diagnosis::DiagnosisHistory;
use history::ErrorHistory;
use plain::decode;
pub(crate) use sdo::SdoObjects;

/// First index of the drive profile's area of axis 1.
const PROFILE_AREA: u16 = 0x6000;

/// The drive.
#[derive(Clone, Debug)]
pub(crate) struct Drive {
    objects: DriveObjects,
    outputs: PdoSet,
    inputs: PdoSet,
}

/// Everything in the dictionary but the PDOs.
#[derive(Clone, Debug)]
struct DriveObjects {
    axes: Vec<Axis>,
    /// The axes as they were at power-up: the defaults of their objects.
    fresh: Vec<Axis>,
    axis_increment: u16,
    status_object: Option<AxisStatusObject>,
    stored: Dictionary,
    errors: ErrorHistory,
    diagnosis: Option<DiagnosisHistory>,
    /// Cycle of SYNC0 while the drive follows that.
    sync0_cycle_ns: Option<u32>,
    /// The objects that it shows; `None` for all.
    shown: Option<BTreeSet<(u16, u8)>>,
}

/// Where an object of an axis is.
enum AxisObject {
    Profile {
        axis: usize,
        entry: AxisEntry,
    },
    /// Subindex 0 of a record whose axis model lists only the elements.
    Count(u8),
    Status {
        axis: usize,
    },
}

impl Drive {
    /// A drive after power-up.
    pub(crate) fn new(blueprint: &DriveBlueprint, description: &Description) -> Self {
        let assigned = blueprint.assigned.as_deref();
        let pdos = |direction| {
            PdoSet::new(
                direction,
                blueprint.limits,
                &description.pdos,
                assigned,
                &blueprint.pdo_habits,
            )
        };
        let axes: Vec<Axis> = blueprint.axes.iter().cloned().map(Axis::new).collect();
        let mut drive = Self {
            objects: DriveObjects {
                fresh: axes.clone(),
                axes,
                axis_increment: blueprint.axis_increment,
                status_object: blueprint.status_object,
                stored: communication_objects(blueprint, description),
                errors: ErrorHistory::default(),
                diagnosis: blueprint.diagnosis.map(DiagnosisHistory::new),
                sync0_cycle_ns: None,
                shown: shown(blueprint, description),
            },
            outputs: pdos(Direction::Outputs),
            inputs: pdos(Direction::Inputs),
        };
        for object in &blueprint.objects {
            drive.objects.add(object);
        }
        drive.objects.fresh.clone_from(&drive.objects.axes);
        drive
    }

    /// The axes.
    pub(crate) fn axes(&self) -> &[Axis] {
        &self.objects.axes
    }

    /// The axes, to be changed.
    pub(crate) fn axes_mut(&mut self) -> &mut [Axis] {
        &mut self.objects.axes
    }

    /// Bytes of process data that are mapped.
    pub(crate) fn bytes(&self, direction: Direction) -> usize {
        match direction {
            Direction::Outputs => self.outputs.bytes(),
            Direction::Inputs => self.inputs.bytes(),
        }
    }

    /// Takes the MainDevice's process data over into the objects.
    pub(crate) fn write_outputs(&mut self, bytes: &[u8]) {
        let mut at = 0;
        for entry in self.outputs.layout() {
            let length = usize::from(entry.bits / 8);
            if let Some(value) = bytes.get(at..at + length) {
                // A value that the object does not take leaves it as it was; process data has no way to say so.
                let _refused = self.objects.download(entry.index, entry.subindex, value);
            }
            at += length;
        }
    }

    /// The process data for the MainDevice.
    pub(crate) fn read_inputs(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.inputs.bytes());
        for entry in self.inputs.layout() {
            let mut value = self
                .objects
                .upload(entry.index, entry.subindex)
                .unwrap_or_default();
            value.resize(usize::from(entry.bits / 8), 0);
            bytes.extend(value);
        }
        bytes
    }

    /// One drive cycle of every axis.
    pub(crate) fn cycle(&mut self, now: Duration) {
        self.objects
            .axes
            .iter_mut()
            .for_each(|axis| axis.cycle(now));
    }

    /// The next emergency of any axis; its error goes into the history.
    pub(crate) fn take_emergency(&mut self, now: Duration) -> Option<Emergency> {
        let emergency = self
            .objects
            .axes
            .iter_mut()
            .find_map(Axis::take_emergency)?;
        self.record_error(emergency.code, emergency.register, now);
        Some(emergency)
    }

    /// Enters an error into the histories (1003h, 10F3h).
    pub(crate) fn record_error(&mut self, code: u16, register: u8, now: Duration) {
        self.objects.errors.record(code);
        if let Some(diagnosis) = &mut self.objects.diagnosis {
            diagnosis.record(code, register, now);
        }
    }

    /// Whether 1C32h:1 asks for the synchronisation with SYNC0.
    pub(crate) fn wants_sync0(&self) -> bool {
        let kind = self.objects.stored.upload(0x1C32, 1);
        kind.is_ok_and(|kind| kind == communication::WITH_SYNC0.to_le_bytes())
    }

    /// 10F1h:02: above this many mistakes the drive falls out of OP.
    pub(crate) fn sync_error_limit(&self) -> u16 {
        let limit = self.objects.stored.upload(0x10F1, 2).unwrap_or_default();
        crate::frame::read_u16(&limit, 0).unwrap_or(0)
    }

    /// The drive follows SYNC0 with this cycle from now on, or no longer. 1C32h and 1C33h show it.
    pub(crate) fn set_sync0(&mut self, cycle_ns: Option<u32>) {
        self.objects.sync0_cycle_ns = cycle_ns;
    }

    /// OP was entered or left.
    pub(crate) fn set_connected(&mut self, connected: bool) {
        for axis in &mut self.objects.axes {
            if connected {
                axis.connection_restored();
            } else {
                axis.connection_lost();
            }
        }
    }

    /// The dictionary as the SDO server sees it.
    pub(crate) fn sdo(&mut self, is_preop: bool) -> SdoObjects<'_> {
        SdoObjects {
            drive: self,
            is_preop,
        }
    }
}

/// The objects that a drive of this blueprint shows, beside its PDO lists; `None` for all.
fn shown(blueprint: &DriveBlueprint, description: &Description) -> Option<BTreeSet<(u16, u8)>> {
    let listed = blueprint.objects.iter().flat_map(|object| {
        let entries = object.entries.iter();
        entries.map(|entry| (object.index, entry.subindex))
    });
    let mapped = description.pdos.iter().flat_map(|pdo| &pdo.entries);
    let mapped = mapped.map(|entry| (entry.index, entry.subindex));
    blueprint
        .shows_only_these
        .then(|| listed.chain(mapped).collect())
}

impl DriveObjects {
    /// Whether a subindex is one that the drive shows.
    fn check_shown(&self, index: u16, subindex: u8) -> Result<(), Abort> {
        match &self.shown {
            Some(shown) if !shown.contains(&(index, subindex)) => Err(if self.shows(index) {
                Abort::NoSubindex
            } else {
                Abort::NoObject
            }),
            _ => Ok(()),
        }
    }

    /// Whether the drive shows anything of an object.
    fn shows(&self, index: u16) -> bool {
        let subindices = (index, 0)..=(index, u8::MAX);
        self.shown
            .as_ref()
            .is_none_or(|shown| shown.range(subindices).next().is_some())
    }

    fn upload(&self, index: u16, subindex: u8) -> Result<Vec<u8>, Abort> {
        self.check_shown(index, subindex)?;
        match self.axis_object(index, subindex)? {
            None if index == 0x1001 => {
                let register = self
                    .axes
                    .iter()
                    .fold(0, |register, axis| register | axis.error_register());
                if subindex == 0 {
                    Ok(vec![register])
                } else {
                    Err(Abort::NoSubindex)
                }
            }
            None if index == ErrorHistory::INDEX => self.errors.upload(subindex),
            None if index == DiagnosisHistory::INDEX => {
                let diagnosis = self.diagnosis.as_ref().ok_or(Abort::NoObject)?;
                diagnosis.upload(subindex)
            }
            None => self
                .synchronisation(index, subindex)
                .map_or_else(|| self.stored.upload(index, subindex), Ok),
            Some(AxisObject::Count(count)) => Ok(vec![count]),
            Some(AxisObject::Status { axis }) => Ok(self.status_bits(axis).to_le_bytes().to_vec()),
            Some(AxisObject::Profile { axis, entry }) => {
                let value = self
                    .axes
                    .get(axis)
                    .and_then(|axis| axis.get(entry.index, entry.subindex));
                let bytes = value.ok_or(Abort::NoObject)?.to_le_bytes();
                Ok(bytes.into_iter().take(entry.kind.size()).collect())
            }
        }
    }

    fn room(&self, index: u16, subindex: u8) -> Result<usize, Abort> {
        self.check_shown(index, subindex)?;
        match self.axis_object(index, subindex)? {
            None if index == 0x1001 => Err(Abort::ReadOnly),
            None if index == ErrorHistory::INDEX => ErrorHistory::room(subindex),
            None if index == DiagnosisHistory::INDEX => {
                let diagnosis = self.diagnosis.as_ref().ok_or(Abort::NoObject)?;
                diagnosis.room(subindex)
            }
            None => self.stored.room(index, subindex),
            Some(AxisObject::Profile { entry, .. }) if entry.access == Access::ReadWrite => {
                Ok(entry.kind.size())
            }
            Some(_) => Err(Abort::ReadOnly),
        }
    }

    fn download(&mut self, index: u16, subindex: u8, data: &[u8]) -> Result<(), Abort> {
        self.check_shown(index, subindex)?;
        match self.axis_object(index, subindex)? {
            None if index == 0x1001 => Err(Abort::ReadOnly),
            None if index == ErrorHistory::INDEX => self.errors.download(subindex, data),
            None if index == DiagnosisHistory::INDEX => {
                let diagnosis = self.diagnosis.as_mut().ok_or(Abort::NoObject)?;
                diagnosis.download(subindex, data)
            }
            None if (index, subindex) == (SAVE, 1) => {
                self.memory_command(SAVE, b"save", data, Axis::save)
            }
            None if (index, subindex) == (LOAD, 1) => {
                self.memory_command(LOAD, b"load", data, Axis::forget)
            }
            None => self.stored.download(index, subindex, data),
            Some(AxisObject::Count(_) | AxisObject::Status { .. }) => Err(Abort::ReadOnly),
            Some(AxisObject::Profile { axis, entry }) => {
                if data.len() != entry.kind.size() {
                    return Err(if data.len() > entry.kind.size() {
                        Abort::TooLong
                    } else {
                        Abort::TooShort
                    });
                }
                let axis = self.axes.get_mut(axis).ok_or(Abort::NoObject)?;
                axis.set(entry.index, entry.subindex, decode(entry.kind, data))
                    .map_err(|error| match error {
                        SetError::Unknown => Abort::NoObject,
                        SetError::ReadOnly => Abort::ReadOnly,
                        SetError::OutOfRange => Abort::Range,
                    })
            }
        }
    }

    /// 1010h and 1011h take nothing but their signature.
    fn memory_command(
        &mut self,
        index: u16,
        signature: &[u8],
        data: &[u8],
        command: fn(&mut Axis),
    ) -> Result<(), Abort> {
        self.stored.room(index, 1)?;
        if data != signature {
            return Err(Abort::NotSaved);
        }
        self.axes.iter_mut().for_each(command);
        Ok(())
    }

    fn mappable(&self, index: u16, subindex: u8, direction: Direction) -> Result<Mappable, Abort> {
        self.check_shown(index, subindex)?;
        match self.axis_object(index, subindex)? {
            Some(AxisObject::Profile { entry, .. }) => Ok(Mappable {
                bits: 8 * entry.kind.size() as u8,
                allowed: match entry.mapping {
                    Mapping::None => false,
                    Mapping::Rx => direction == Direction::Outputs,
                    Mapping::Tx => direction == Direction::Inputs,
                    Mapping::Both => true,
                },
            }),
            Some(AxisObject::Status { .. }) => Ok(Mappable {
                bits: 32,
                allowed: direction == Direction::Inputs,
            }),
            Some(AxisObject::Count(_)) => Ok(Mappable {
                bits: 8,
                allowed: false,
            }),
            None => {
                let entry = self.entry(index, subindex)?;
                let way = match direction {
                    Direction::Outputs => access::RX,
                    Direction::Inputs => access::TX,
                };
                Ok(Mappable {
                    bits: u8::try_from(entry.bits).unwrap_or(0),
                    allowed: entry.access & way != 0,
                })
            }
        }
    }

    /// The axis object that an index and subindex mean; `None` when the index is of no axis.
    fn axis_object(&self, index: u16, subindex: u8) -> Result<Option<AxisObject>, Abort> {
        if let Some(axis) = self.status_axis(index) {
            let last = self.status_object.map_or(0, |object| object.subindex);
            return match subindex {
                0 => Ok(Some(AxisObject::Count(last))),
                _ if subindex == last => Ok(Some(AxisObject::Status { axis })),
                _ => Err(Abort::NoSubindex),
            };
        }
        let Some((axis, entries)) = self.profile_entries(index) else {
            return Ok(None);
        };
        if let Some(entry) = entries.iter().find(|entry| entry.subindex == subindex) {
            return Ok(Some(AxisObject::Profile {
                axis,
                entry: *entry,
            }));
        }
        match entries.iter().map(|entry| entry.subindex).max() {
            // In the area of an axis, but not of its profile.
            None => Ok(None),
            Some(last) if subindex == 0 => Ok(Some(AxisObject::Count(last))),
            Some(_) => Err(Abort::NoSubindex),
        }
    }

    /// The axis in whose profile area an index is, and the entries there; `None` when the index is of no axis.
    fn profile_entries(&self, index: u16) -> Option<(usize, &[AxisEntry])> {
        let (axis, base) = match index.checked_sub(PROFILE_AREA) {
            Some(offset) => (
                usize::from(offset / self.axis_increment.max(1)),
                PROFILE_AREA + offset % self.axis_increment.max(1),
            ),
            // A maker's own object of the only axis.
            None => (0, index),
        };
        // They are sorted; this is looked up for each mapped object in each cycle.
        let all = self.axes.get(axis)?.entries();
        let first = all.partition_point(|entry| entry.index < base);
        let behind = all.partition_point(|entry| entry.index <= base);
        let entries = all.get(first..behind)?;
        (index >= PROFILE_AREA || !entries.is_empty()).then_some((axis, entries))
    }

    /// What 1C32h and 1C33h show of SYNC0 in place of what is stored: the type and the cycle time.
    fn synchronisation(&self, index: u16, subindex: u8) -> Option<Vec<u8>> {
        let cycle = self.sync0_cycle_ns?;
        match (index, subindex) {
            (0x1C32 | 0x1C33, 1) => Some(communication::WITH_SYNC0.to_le_bytes().to_vec()),
            (0x1C32 | 0x1C33, 2) => Some(cycle.to_le_bytes().to_vec()),
            _ => None,
        }
    }

    fn status_axis(&self, index: u16) -> Option<usize> {
        let object = self.status_object?;
        let offset = index.checked_sub(object.index)?;
        let axis = usize::from(offset.checked_div(object.increment)?);
        (offset % object.increment == 0 && axis < self.axes.len()).then_some(axis)
    }

    /// The maker's status word, AXIS#.MOTIONSTAT of the public help of the AKD2G. Assumed: that a set-point of the
    /// profile counts as its motion task, and that what is shown of a homing stays until the next one begins or power
    /// fails. Service motion, velocity, exceptions and crossed targets are not modelled.
    fn status_bits(&self, axis: usize) -> u32 {
        let Some(axis) = self.axes.get(axis) else {
            return 0;
        };
        let word = axis.statusword();
        let enabled = word & 0x006F == 0x0027;
        let reached = word & 0x0400 != 0;
        let (found, failed) = axis.homing_verdict();
        [
            (0, enabled && !reached),
            (1, found),
            (2, found && axis.is_referenced()),
            (3, axis.is_homing()),
            (4, failed),
            (11, enabled && reached),
            (15, axis.is_in_window()),
        ]
        .into_iter()
        .fold(0, |bits, (bit, shown)| bits | u32::from(shown) << bit)
    }
}
