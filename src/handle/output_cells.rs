//! Mapped objects of a drive's outputs that are none of the axis' own, as the program sets them. Only atomics.

use crate::{
    coe::{Number, ObjectAddress},
    pdo_map::{BitRange, Direction, Field, Layout},
    sync::{AtomicU64, Ordering},
};

/// Set in an output cell once a program has written it, and until that has been taken in.
const WRITTEN: u64 = 1 << 32;
const NEW: u64 = 1 << 33;

/// All mapped outputs of a drive.
#[derive(Debug)]
pub(super) struct OutputCells(Box<[OutputCell]>);

/// A mapped object of the drive's outputs, and what the program has set it to.
#[derive(Debug)]
struct OutputCell {
    object: ObjectAddress,
    place: BitRange,
    value: AtomicU64,
}

impl OutputCells {
    pub fn of(layout: &Layout) -> Self {
        let objects = layout.objects(Direction::Outputs);
        let cells = objects.map(|(object, place)| OutputCell {
            object,
            place,
            value: AtomicU64::new(0),
        });
        Self(cells.collect())
    }

    /// The place among them of an object that is mapped there.
    pub fn place_of(&self, object: ObjectAddress) -> Option<usize> {
        self.0.iter().position(|cell| cell.object == object)
    }

    /// Sets the one at this place; false if there is none.
    pub fn set(&self, cell: usize, raw: u32) -> bool {
        let Some(cell) = self.0.get(cell) else {
            return false;
        };
        let value = NEW | WRITTEN | u64::from(raw);
        // Exchanged and not stored: it has its place among the other exchanges of this cell.
        cell.value.swap(value, Ordering::Release);
        true
    }

    /// Sets these bits of the one at this place, and leaves its others as they were set; false if there is none.
    pub fn change(&self, cell: usize, mask: u32, bits: u32) -> bool {
        let Some(cell) = self.0.get(cell) else {
            return false;
        };
        let change = |value: u64| NEW | WRITTEN | u64::from(value as u32 & !mask | bits & mask);
        let _ = cell
            .value
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, |value| {
                Some(change(value))
            });
        true
    }

    /// What the one at this place was set to, if it was.
    pub fn get(&self, cell: usize) -> Option<u32> {
        let value = self.0.get(cell)?.value.load(Ordering::Acquire);
        (value & WRITTEN != 0).then_some(value as u32)
    }

    /// Writes what was set since the last time into the drive's outputs.
    pub fn merge(&self, outputs: &mut [u8]) {
        for cell in &self.0 {
            if cell.value.load(Ordering::Relaxed) & NEW != 0 {
                let raw = cell.value.fetch_and(!NEW, Ordering::AcqRel) as u32;
                match cell.place.bits {
                    8 => write(cell.place, raw as u8, outputs),
                    16 => write(cell.place, raw as u16, outputs),
                    _ => write(cell.place, raw, outputs),
                }
            }
        }
    }

    /// Nothing was set.
    pub fn clear(&self) {
        for cell in &self.0 {
            cell.value.store(0, Ordering::Release);
        }
    }
}

/// An image that is too short is the exchange's error, and shows there.
fn write<T: Number>(place: BitRange, value: T, outputs: &mut [u8]) {
    let _ = Field::new(place).is_some_and(|field| field.write(outputs, value));
}
