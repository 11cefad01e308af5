//! What an axis shares.

pub(crate) use servocrab::axis::Snapshot;

#[path = "../../../src/handle/output_cells.rs"]
mod output_cells;
#[path = "../../../src/handle/status.rs"]
mod status;

use servocrab::{coe::obj, drives, pdo_map::Direction};

use output_cells::OutputCells;
use status::{StatusCell, pack};

/// The status of an axis with eight input bytes.
pub(crate) struct Status(StatusCell);

impl Status {
    pub(crate) fn new(first: &Snapshot) -> Self {
        Self(StatusCell::new(first, 8))
    }

    pub(crate) fn publish(&self, snapshot: &Snapshot, inputs: [u8; 8]) {
        self.0.publish(pack(snapshot), Some(&inputs));
    }

    pub(crate) fn read(&self) -> Snapshot {
        self.0.snapshot_after(0)
    }

    pub(crate) fn inputs(&self) -> [u8; 8] {
        self.0.inputs(0)
    }
}

/// The outputs of a drive that the program sets.
pub(crate) struct Outputs {
    cells: OutputCells,
    place: usize,
    byte: usize,
    length: usize,
}

impl Outputs {
    pub(crate) fn new() -> Self {
        let layout = drives::generic().default_mapping().unwrap().layout();
        let object = obj::PROFILE_VELOCITY.address();
        let cells = OutputCells::of(&layout);
        Self {
            place: cells.place_of(object).unwrap(),
            byte: layout
                .find(Direction::Outputs, object.index, object.subindex)
                .unwrap()
                .byte,
            length: layout.output_bytes(),
            cells,
        }
    }

    pub(crate) fn set(&self, value: u32) {
        assert!(self.cells.set(self.place, value));
    }

    /// What lies in the frame after this.
    pub(crate) fn merge_into(&self, frame: &mut Vec<u8>) -> u32 {
        frame.resize(self.length, 0);
        self.cells.merge(frame);
        let bytes = frame[self.byte..self.byte + 4].try_into().unwrap();
        u32::from_le_bytes(bytes)
    }
}
