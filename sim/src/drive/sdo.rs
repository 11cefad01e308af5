//! The drive's dictionary as the CoE services see it: PDO lists, communication objects and the axes' objects as one.

use super::diagnosis::DiagnosisHistory;
use super::history::ErrorHistory;
use super::information::{axis_entry_info, axis_object_info};
use super::{AxisObject, Drive, DriveObjects, PROFILE_AREA};
use crate::coe::info::{EntryInfo, ObjectCode, ObjectInfo, access, data_type};
use crate::coe::{Abort, Objects};
use crate::description::Direction;
use crate::pdo::PdoSet;

/// The dictionary together with the AL state that some of it depends on.
pub(crate) struct SdoObjects<'a> {
    pub(super) drive: &'a mut Drive,
    pub(super) is_preop: bool,
}

impl SdoObjects<'_> {
    /// The PDO lists that an index belongs to.
    fn pdos(&self, index: u16) -> Option<&PdoSet> {
        [&self.drive.outputs, &self.drive.inputs]
            .into_iter()
            .find(|pdos| pdos.owns(index))
    }
}

impl Objects for SdoObjects<'_> {
    fn upload(&self, index: u16, subindex: u8) -> Result<Vec<u8>, Abort> {
        self.pdos(index).map_or_else(
            || self.drive.objects.upload(index, subindex),
            |pdos| pdos.upload(index, subindex),
        )
    }

    fn room(&self, index: u16, subindex: u8) -> Result<usize, Abort> {
        self.pdos(index).map_or_else(
            || self.drive.objects.room(index, subindex),
            |pdos| pdos.room(index, subindex),
        )
    }

    fn download(&mut self, index: u16, subindex: u8, data: &[u8]) -> Result<(), Abort> {
        let Drive {
            objects,
            outputs,
            inputs,
        } = &mut *self.drive;
        if outputs.owns(index) {
            let lookup = |index, subindex| objects.mappable(index, subindex, Direction::Outputs);
            outputs.download(index, subindex, data, self.is_preop, lookup)
        } else if inputs.owns(index) {
            let lookup = |index, subindex| objects.mappable(index, subindex, Direction::Inputs);
            inputs.download(index, subindex, data, self.is_preop, lookup)
        } else {
            objects.download(index, subindex, data)
        }
    }

    fn download_all(&mut self, index: u16, values: &[(u8, Vec<u8>)]) -> Result<(), Abort> {
        let before = self.drive.clone();
        let written = values
            .iter()
            .try_for_each(|(subindex, value)| self.download(index, *subindex, value));
        if written.is_err() {
            *self.drive = before;
        }
        written
    }

    fn indices(&self) -> Vec<u16> {
        let mut all = self.drive.objects.indices();
        all.extend(self.drive.outputs.indices());
        all.extend(self.drive.inputs.indices());
        all.sort_unstable();
        all.dedup();
        all
    }

    fn object(&self, index: u16) -> Result<ObjectInfo, Abort> {
        self.pdos(index).map_or_else(
            || self.drive.objects.object(index),
            |pdos| pdos.object(index),
        )
    }

    fn entry(&self, index: u16, subindex: u8) -> Result<EntryInfo, Abort> {
        self.pdos(index).map_or_else(
            || self.drive.objects.entry(index, subindex),
            |pdos| pdos.entry(index, subindex),
        )
    }
}

/// The error register, which the axes make up.
const ERROR_REGISTER: u16 = 0x1001;
const ERROR_REGISTER_NAME: &str = "Error register";

impl DriveObjects {
    fn indices(&self) -> Vec<u16> {
        let mut all = vec![ERROR_REGISTER, ErrorHistory::INDEX];
        all.extend(self.diagnosis.as_ref().map(|_| DiagnosisHistory::INDEX));
        all.extend(self.stored.indices());
        for (number, axis) in (0u16..).zip(&self.axes) {
            let profile = axis.entries().iter().filter_map(|entry| {
                let is_profile = entry.index >= PROFILE_AREA;
                // A maker's own object is one of the first axis.
                (is_profile || number == 0)
                    .then(|| entry.index.saturating_add(number * self.axis_increment))
            });
            all.extend(profile);
        }
        if let Some(object) = self.status_object {
            let axes = (0..).zip(&self.axes);
            all.extend(axes.map(|(axis, _)| object.index.saturating_add(axis * object.increment)));
        }
        all.retain(|index| self.shows(*index));
        all
    }

    fn object(&self, index: u16) -> Result<ObjectInfo, Abort> {
        if !self.shows(index) {
            return Err(Abort::NoObject);
        }
        match index {
            ERROR_REGISTER => Ok(ObjectInfo {
                data_type: data_type::U8,
                last: 0,
                code: ObjectCode::Var,
                name: ERROR_REGISTER_NAME.into(),
            }),
            ErrorHistory::INDEX => Ok(ErrorHistory::object()),
            DiagnosisHistory::INDEX => {
                let diagnosis = self.diagnosis.as_ref().ok_or(Abort::NoObject)?;
                Ok(diagnosis.object())
            }
            _ if self.status_axis(index).is_some() => Ok(ObjectInfo {
                data_type: data_type::NONE,
                last: self.status_object.map_or(0, |object| object.subindex),
                code: ObjectCode::Record,
                name: "Axis status".into(),
            }),
            _ => match self.profile_entries(index) {
                None => self.stored.object(index),
                Some((_, entries)) => {
                    axis_object_info(entries).map_or_else(|| self.stored.object(index), Ok)
                }
            },
        }
    }

    pub(super) fn entry(&self, index: u16, subindex: u8) -> Result<EntryInfo, Abort> {
        self.check_shown(index, subindex)?;
        match index {
            ERROR_REGISTER if subindex == 0 => Ok(EntryInfo::new(
                data_type::U8,
                8,
                access::READ,
                ERROR_REGISTER_NAME,
            )),
            ERROR_REGISTER => Err(Abort::NoSubindex),
            ErrorHistory::INDEX => ErrorHistory::entry(subindex),
            DiagnosisHistory::INDEX => {
                let diagnosis = self.diagnosis.as_ref().ok_or(Abort::NoObject)?;
                diagnosis.entry(subindex)
            }
            _ => match self.axis_object(index, subindex)? {
                None => self.stored.entry(index, subindex),
                Some(AxisObject::Count(_)) => Ok(EntryInfo::count(access::READ)),
                Some(AxisObject::Status { .. }) => Ok(EntryInfo::new(
                    data_type::U32,
                    32,
                    access::READ | access::TX,
                    "Status bits",
                )),
                Some(AxisObject::Profile { axis, entry }) => {
                    let is_record = subindex == 0 && self.object(index)?.code != ObjectCode::Var;
                    let default = self
                        .fresh
                        .get(axis)
                        .and_then(|axis| axis.get(entry.index, entry.subindex));
                    Ok(axis_entry_info(&entry, is_record, default))
                }
            },
        }
    }
}
