//! What other devices share.

#[path = "../../../src/bus/device/io_cell.rs"]
mod cell;

use cell::{Cell, Head};

/// The inputs of a device: eight bytes.
pub(crate) struct Inputs(Cell);

impl Inputs {
    pub(crate) fn new() -> Self {
        Self(Cell::new(8))
    }

    pub(crate) fn publish(&self, cycle: u8) {
        let head = Head {
            cycle: cycle.into(),
            ..Head::default()
        };
        self.0.publish(head, &[cycle; 8]);
    }

    /// The cycle, and the bytes.
    pub(crate) fn read(&self) -> (u64, [u8; 8]) {
        let (head, bytes) = self.0.read(0);
        (head.cycle, bytes)
    }
}
