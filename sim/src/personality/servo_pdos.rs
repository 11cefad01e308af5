//! What a test changes of a drive's PDOs: which there are, which are fixed, how many fit, and what the drive makes of single
//! writes.

use super::servo::Servo;
use crate::coe::Abort;
use crate::description::{Direction, PdoDescription, PdoEntryDescription};
use crate::pdo::PdoHabit;

/// What differs from the model.
#[derive(Clone, Debug, Default)]
pub(super) struct Changes {
    all_fixed: bool,
    fixed: Vec<u16>,
    further: Vec<PdoDescription>,
    pub(super) assigned: Option<Vec<u16>>,
    pub(super) habits: Vec<PdoHabit>,
}

impl Changes {
    /// The PDOs of the model with what differs.
    pub(super) fn apply(&self, pdos: &mut Vec<PdoDescription>) {
        for pdo in &self.further {
            pdos.retain(|other| other.index != pdo.index);
            pdos.push(pdo.clone());
        }
        pdos.sort_by_key(|pdo| pdo.index);
        for pdo in pdos {
            pdo.fixed |= self.all_fixed || self.fixed.contains(&pdo.index);
        }
    }
}

impl Servo {
    /// Sets what is added to a PDO's index for each further axis.
    #[must_use]
    pub fn pdo_increment(mut self, increment: u16) -> Self {
        self.model.pdo_increment = increment;
        self
    }

    /// Sets how many entries one PDO takes.
    #[must_use]
    pub fn entries_per_pdo(mut self, entries: u8) -> Self {
        self.model.limits.entries = entries;
        self
    }

    /// Fixes the content of all PDOs: it can be read, and only the assignment be changed.
    #[must_use]
    pub fn fixed_mapping(mut self) -> Self {
        self.pdos.all_fixed = true;
        self
    }

    /// Assigns other PDOs at power-up (1C12h and 1C13h) than those that the SII says.
    #[must_use]
    pub fn assigned_at_power_up(mut self, pdos: &[u16]) -> Self {
        self.pdos.assigned = Some(pdos.to_vec());
        self
    }

    /// Fixes the content of these PDOs; the others stay free.
    #[must_use]
    pub fn fixed_pdos(mut self, pdos: &[u16]) -> Self {
        self.pdos.fixed.extend(pdos);
        self
    }

    /// Offers one more PDO, with a fixed content and not assigned at power-up: index, subindex and length in bits of each
    /// object; 0, 0 for padding. A PDO of the same index is replaced.
    #[must_use]
    pub fn with_fixed_pdo(mut self, index: u16, entries: &[(u16, u8, u8)]) -> Self {
        let entry = |&(index, subindex, bits): &(u16, u8, u8)| PdoEntryDescription {
            index,
            subindex,
            name: "",
            // As the SII codes unsigned numbers; 0 for padding.
            data_type: match (index, bits) {
                (0, _) => 0,
                (_, 8) => 5,
                (_, 16) => 6,
                _ => 7,
            },
            bits,
        };
        self.pdos.further.push(PdoDescription {
            index,
            name: "",
            direction: if index < 0x1A00 {
                Direction::Outputs
            } else {
                Direction::Inputs
            },
            sync_manager: None,
            fixed: true,
            mandatory: false,
            excludes: Vec::new(),
            entries: entries.iter().map(entry).collect(),
        });
        self
    }

    /// Sets how many PDOs one sync manager takes.
    #[must_use]
    pub fn pdos_assigned(mut self, pdos: u8) -> Self {
        self.model.limits.assigned = pdos;
        self
    }

    /// Refuses one write to its PDO lists (1C12h, 1C13h, 16xxh, 1Axxh), of this value alone.
    #[must_use]
    pub fn refuses_pdo_write(mut self, index: u16, subindex: u8, value: u32, abort: Abort) -> Self {
        self.pdos.habits.push(PdoHabit {
            index,
            subindex,
            value,
            abort: Some(abort),
        });
        self
    }

    /// Confirms one write to its PDO lists, of this value alone, and keeps what it had.
    #[must_use]
    pub fn ignores_pdo_write(mut self, index: u16, subindex: u8, value: u32) -> Self {
        self.pdos.habits.push(PdoHabit {
            index,
            subindex,
            value,
            abort: None,
        });
        self
    }
}
