//! Mapped objects of a drive's outputs that are none of the axis' own, as the program sets them. Only atomics.

use crate::{
    coe::{Number, ObjectAddress},
    pdo_map::{BitRange, Direction, Field, Layout},
    sync::{AtomicBool, AtomicU64, Ordering},
};

/// All mapped outputs of a drive.
#[derive(Debug)]
pub(super) struct OutputCells(Box<[OutputCell]>);

/// A mapped object of the drive's outputs, and what the program has set of it.
#[derive(Debug)]
struct OutputCell {
    object: ObjectAddress,
    place: BitRange,
    /// Which bits the axis itself writes.
    owned: u32,
    /// Below, the bits as they were set; above, which were.
    set: AtomicU64,
    /// Whether any was since they were taken in.
    is_new: AtomicBool,
}

impl OutputCells {
    /// `owned`: the bits of an object that the axis itself writes.
    pub fn of(layout: &Layout, owned: Option<(ObjectAddress, u32)>) -> Self {
        let objects = layout.objects(Direction::Outputs);
        let cells = objects.map(|(object, place)| OutputCell {
            object,
            place,
            owned: match owned {
                Some((of, bits)) if of == object => bits,
                _ => 0,
            },
            set: AtomicU64::new(0),
            is_new: AtomicBool::new(false),
        });
        Self(cells.collect())
    }

    /// The place among them of an object that is mapped there.
    pub fn place_of(&self, object: ObjectAddress) -> Option<usize> {
        self.0.iter().position(|cell| cell.object == object)
    }

    /// The bits of the one at this place that the axis itself writes.
    pub fn owned(&self, cell: usize) -> u32 {
        self.0.get(cell).map_or(0, |cell| cell.owned)
    }

    /// Sets the one at this place; false if there is none.
    pub fn set(&self, cell: usize, raw: u32) -> bool {
        self.change(cell, u32::MAX, raw)
    }

    /// Sets these bits of the one at this place, and leaves its others as they are; false if there is none.
    pub fn change(&self, cell: usize, mask: u32, bits: u32) -> bool {
        let Some(cell) = self.0.get(cell) else {
            return false;
        };
        let change = |set: u64| {
            let value = set as u32 & !mask | bits & mask;
            u64::from((set >> 32) as u32 | mask) << 32 | u64::from(value)
        };
        let _ = cell
            .set
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, |set| Some(change(set)));
        // Exchanged and not stored: it has its place among the other exchanges of this cell.
        cell.is_new.swap(true, Ordering::AcqRel);
        true
    }

    /// What these bits of the one at this place were set to, if all of them were.
    pub fn get(&self, cell: usize, mask: u32) -> Option<u32> {
        let set = self.0.get(cell)?.set.load(Ordering::Acquire);
        ((set >> 32) as u32 & mask == mask).then_some(set as u32 & mask)
    }

    /// Writes what was set since the last time into the drive's outputs.
    pub fn merge(&self, outputs: &mut [u8]) {
        for cell in &self.0 {
            if cell.is_new.load(Ordering::Relaxed) && cell.is_new.swap(false, Ordering::AcqRel) {
                let set = cell.set.load(Ordering::Acquire);
                let (bits, mask) = (set as u32, (set >> 32) as u32 & !cell.owned);
                match cell.place.bits {
                    8 => write(cell.place, bits as u8, mask as u8, outputs),
                    16 => write(cell.place, bits as u16, mask as u16, outputs),
                    _ => write(cell.place, bits, mask, outputs),
                }
            }
        }
    }

    /// Nothing was set.
    pub fn clear(&self) {
        for cell in &self.0 {
            cell.set.store(0, Ordering::Release);
        }
    }
}

/// An image that is too short is the exchange's error, and shows there.
fn write<T: Number>(place: BitRange, bits: T, mask: T, outputs: &mut [u8]) {
    let Some(field) = Field::<T>::new(place) else {
        return;
    };
    if let Some(before) = field.read(outputs) {
        let (before, bits, mask) = (before.to_raw(), bits.to_raw(), mask.to_raw());
        let _ = field.write(outputs, T::from_raw(before & !mask | bits & mask));
    }
}
