//! PDO mapping and assignment of one direction: the objects 16xxh or 1Axxh and 1C12h or 1C13h, and their rules.
//! A list is rewritten in PREOP, after its subindex 0 was set to zero; a mapping, after its PDO was taken out of the
//! assignment.

mod list;

use crate::coe::Abort;
use crate::coe::info::{EntryInfo, ObjectCode, ObjectInfo, access, data_type};
use crate::description::{Direction, PdoDescription};
use list::List;
pub(crate) use list::MappedEntry;

/// What can be known about an object that is to be mapped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Mappable {
    /// Length in bits.
    pub(crate) bits: u8,
    /// Whether it can be mapped in this direction.
    pub(crate) allowed: bool,
}

/// How much a drive can map in one direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoLimits {
    /// Bytes in all assigned PDOs together.
    pub bytes: usize,
    /// Entries in one PDO.
    pub entries: u8,
    /// PDOs that are assigned at the same time.
    pub assigned: u8,
}

/// What a drive makes of one write to its PDO lists in place of what the rules say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoHabit {
    /// 1C12h, 1C13h, 16xxh or 1Axxh.
    pub index: u16,
    /// The subindex.
    pub subindex: u8,
    /// The value whose writing is meant.
    pub value: u32,
    /// The abort code; `None`: the write is confirmed, and the drive keeps what it had.
    pub abort: Option<Abort>,
}

/// All PDOs of one direction.
#[derive(Clone, Debug)]
pub(crate) struct PdoSet {
    direction: Direction,
    limits: PdoLimits,
    pdos: Vec<Pdo>,
    assignment: List,
    habits: Vec<PdoHabit>,
}

/// One PDO.
#[derive(Clone, Debug)]
struct Pdo {
    index: u16,
    fixed: bool,
    mandatory: bool,
    excludes: Vec<u16>,
    content: List,
}

impl PdoSet {
    /// The PDOs of a direction as they are at power-up. Assigned are those of `assigned`, and without such a list those
    /// that the description gives a sync manager.
    pub(crate) fn new(
        direction: Direction,
        limits: PdoLimits,
        all: &[PdoDescription],
        assigned: Option<&[u16]>,
        habits: &[PdoHabit],
    ) -> Self {
        let own = all.iter().filter(|pdo| pdo.direction == direction);
        let is_assigned = |pdo: &PdoDescription| {
            assigned.map_or(pdo.sync_manager.is_some(), |list| list.contains(&pdo.index))
        };
        let at_power_up: Vec<u32> = own
            .clone()
            .filter(|pdo| is_assigned(pdo))
            .map(|pdo| u32::from(pdo.index))
            .collect();
        let pdos = own.map(|pdo| {
            let values: Vec<u32> = pdo
                .entries
                .iter()
                .map(MappedEntry::of_description)
                .collect();
            Pdo {
                index: pdo.index,
                fixed: pdo.fixed,
                mandatory: pdo.mandatory,
                excludes: pdo.excludes.clone(),
                // What is fixed may be longer than what can be mapped.
                content: List::new(&values, limits.entries.max(values.len() as u8)),
            }
        });
        Self {
            direction,
            limits,
            pdos: pdos.collect(),
            assignment: List::new(&at_power_up, limits.assigned),
            habits: habits.to_vec(),
        }
    }

    /// Index of the assignment object.
    fn assignment_index(&self) -> u16 {
        match self.direction {
            Direction::Outputs => 0x1C12,
            Direction::Inputs => 0x1C13,
        }
    }

    /// Whether this set answers for an object.
    pub(crate) fn owns(&self, index: u16) -> bool {
        index == self.assignment_index() || self.pdos.iter().any(|pdo| pdo.index == index)
    }

    /// The indices of its objects.
    pub(crate) fn indices(&self) -> impl Iterator<Item = u16> + '_ {
        let pdos = self.pdos.iter().map(|pdo| pdo.index);
        pdos.chain([self.assignment_index()])
    }

    /// What there is to say about one of its objects.
    pub(crate) fn object(&self, index: u16) -> Result<ObjectInfo, Abort> {
        let is_assignment = index == self.assignment_index();
        let list = if is_assignment {
            &self.assignment
        } else {
            self.list(index).ok_or(Abort::NoObject)?
        };
        let kind = match self.direction {
            Direction::Outputs => "RxPDO",
            Direction::Inputs => "TxPDO",
        };
        let last = u8::try_from(list.values.len()).unwrap_or(u8::MAX);
        Ok(if is_assignment {
            ObjectInfo {
                data_type: data_type::U16,
                last,
                code: ObjectCode::Array,
                name: format!("{kind} assignment").into(),
            }
        } else {
            ObjectInfo {
                data_type: data_type::PDO_MAPPING,
                last,
                code: ObjectCode::Record,
                name: format!("{kind} mapping {}", (index & 0x01FF) + 1).into(),
            }
        })
    }

    /// What there is to say about a subindex of one of its objects.
    pub(crate) fn entry(&self, index: u16, subindex: u8) -> Result<EntryInfo, Abort> {
        let is_assignment = index == self.assignment_index();
        let access = if self.pdos.iter().any(|pdo| pdo.index == index && pdo.fixed) {
            access::READ
        } else {
            access::READ | access::WRITE_PREOP
        };
        match subindex {
            0 => Ok(EntryInfo::count(access)),
            _ if subindex > self.object(index)?.last => Err(Abort::NoSubindex),
            _ if is_assignment => Ok(EntryInfo::new(data_type::U16, 16, access, "PDO")),
            _ => Ok(EntryInfo::new(data_type::U32, 32, access, "Mapped object")),
        }
    }

    /// The bytes of one of its objects.
    pub(crate) fn upload(&self, index: u16, subindex: u8) -> Result<Vec<u8>, Abort> {
        if index == self.assignment_index() {
            return self.assignment.upload(subindex, 2);
        }
        self.list(index).ok_or(Abort::NoObject)?.upload(subindex, 4)
    }

    /// Length in bytes of one of its objects.
    pub(crate) fn room(&self, index: u16, subindex: u8) -> Result<usize, Abort> {
        self.upload(index, subindex).map(|bytes| bytes.len())
    }

    /// Writes one of its objects by the rules.
    pub(crate) fn download(
        &mut self,
        index: u16,
        subindex: u8,
        data: &[u8],
        is_preop: bool,
        lookup: impl Fn(u16, u8) -> Result<Mappable, Abort>,
    ) -> Result<(), Abort> {
        let length = self.room(index, subindex)?;
        if data.len() != length {
            return Err(if data.len() > length {
                Abort::TooLong
            } else {
                Abort::TooShort
            });
        }
        if !is_preop {
            return Err(Abort::State);
        }
        let value = data
            .iter()
            .rev()
            .fold(0, |value, byte| value << 8 | u32::from(*byte));
        let meant = (index, subindex, value);
        if let Some(habit) = self
            .habits
            .iter()
            .find(|habit| (habit.index, habit.subindex, habit.value) == meant)
        {
            return habit.abort.map_or(Ok(()), Err);
        }
        if index == self.assignment_index() {
            self.write_assignment(subindex, value)
        } else {
            self.write_mapping(index, subindex, value, lookup)
        }
    }

    /// The objects in all assigned PDOs, in order.
    pub(crate) fn layout(&self) -> Vec<MappedEntry> {
        let assigned = self
            .assignment
            .active()
            .iter()
            .filter_map(|pdo| self.list(u16::try_from(*pdo).ok()?));
        assigned
            .flat_map(List::active)
            .map(|value| MappedEntry::from_value(*value))
            .collect()
    }

    /// Bytes of all assigned PDOs.
    pub(crate) fn bytes(&self) -> usize {
        self.layout()
            .iter()
            .map(|entry| usize::from(entry.bits))
            .sum::<usize>()
            .div_ceil(8)
    }

    fn list(&self, index: u16) -> Option<&List> {
        self.pdos
            .iter()
            .find(|pdo| pdo.index == index)
            .map(|pdo| &pdo.content)
    }

    /// Whether these PDOs can be assigned together: none excludes another, and no mandatory one is missing. An empty
    /// assignment is the first step to another one.
    fn go_together(&self, chosen: &[u32]) -> bool {
        let is_chosen = |index: &u16| chosen.contains(&u32::from(*index));
        chosen.is_empty()
            || self.pdos.iter().all(|pdo| {
                if is_chosen(&pdo.index) {
                    !pdo.excludes.iter().any(is_chosen)
                } else {
                    !pdo.mandatory
                }
            })
    }

    fn write_assignment(&mut self, subindex: u8, value: u32) -> Result<(), Abort> {
        if subindex == 0 {
            let count = u8::try_from(value).map_err(|_| Abort::Range)?;
            let chosen = self
                .assignment
                .values
                .get(..usize::from(count))
                .ok_or(Abort::Range)?;
            if chosen.contains(&0) || !self.go_together(chosen) {
                return Err(Abort::Incompatible);
            }
            let before = core::mem::replace(&mut self.assignment.count, count);
            if self.bytes() > self.limits.bytes {
                self.assignment.count = before;
                return Err(Abort::MappingTooLong);
            }
            return Ok(());
        }
        if self.assignment.count != 0 {
            return Err(Abort::SubindexLocked);
        }
        if value != 0 && !self.pdos.iter().any(|pdo| u32::from(pdo.index) == value) {
            return Err(Abort::Range);
        }
        *self.assignment.slot(subindex)? = value;
        Ok(())
    }

    fn write_mapping(
        &mut self,
        index: u16,
        subindex: u8,
        value: u32,
        lookup: impl Fn(u16, u8) -> Result<Mappable, Abort>,
    ) -> Result<(), Abort> {
        let limit = self.limits.bytes * 8;
        let is_assigned = self.assignment.active().contains(&u32::from(index));
        let pdo = self.pdos.iter_mut().find(|pdo| pdo.index == index);
        let pdo = pdo.ok_or(Abort::NoObject)?;
        if pdo.fixed {
            return Err(Abort::ReadOnly);
        }
        if is_assigned {
            return Err(Abort::State);
        }
        let list = &mut pdo.content;
        if subindex == 0 {
            let count = u8::try_from(value).map_err(|_| Abort::Range)?;
            let chosen = list
                .values
                .get(..usize::from(count))
                .ok_or(Abort::MappingTooLong)?;
            if chosen.contains(&0) {
                return Err(Abort::Incompatible);
            }
            if chosen
                .iter()
                .map(|value| usize::from(MappedEntry::from_value(*value).bits))
                .sum::<usize>()
                > limit
            {
                return Err(Abort::MappingTooLong);
            }
            list.count = count;
            return Ok(());
        }
        if list.count != 0 {
            return Err(Abort::SubindexLocked);
        }
        if value != 0 {
            let entry = MappedEntry::from_value(value);
            // 0000h:00 fills bits with nothing (ETG.1000.6, PDO mapping).
            if (entry.index, entry.subindex) != (0, 0) {
                let object = lookup(entry.index, entry.subindex)?;
                if !object.allowed {
                    return Err(Abort::NotMappable);
                }
                if object.bits != entry.bits {
                    return Err(Abort::Length);
                }
            }
        }
        *list.slot(subindex)? = value;
        Ok(())
    }
}
