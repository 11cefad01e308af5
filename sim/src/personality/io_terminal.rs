//! An I/O terminal without CoE: process data as its SII describes it, nothing else.

use core::time::Duration;

use crate::description::{
    Description, Direction, Identity, PdoDescription, PdoEntryDescription, SyncManagerDescription,
    SyncManagerUse,
};
use crate::device::{Blueprint, Device};

/// A terminal of no particular maker with two bytes of outputs and two bytes of inputs.
#[must_use]
pub fn io_terminal() -> Device {
    let identity = Identity {
        vendor: 0,
        product: 0x494F_3136,
        revision: 1,
        serial: 0,
    };
    let mut description = Description::new("16 outputs, 16 inputs", identity);
    description.sync_managers = vec![
        SyncManagerDescription {
            start: 0x1000,
            length: 2,
            control: 0x44,
            purpose: SyncManagerUse::Outputs,
        },
        SyncManagerDescription {
            start: 0x1080,
            length: 2,
            control: 0x20,
            purpose: SyncManagerUse::Inputs,
        },
    ];
    description.fmmu_usage = vec![1, 2];
    let sixteen_bits = |index| PdoEntryDescription {
        index,
        subindex: 1,
        data_type: 6,
        bits: 16,
    };
    description.pdos = vec![
        PdoDescription {
            index: 0x1600,
            direction: Direction::Outputs,
            sync_manager: Some(0),
            fixed: true,
            entries: vec![sixteen_bits(0x7000)],
        },
        PdoDescription {
            index: 0x1A00,
            direction: Direction::Inputs,
            sync_manager: Some(1),
            fixed: true,
            entries: vec![sixteen_bits(0x6000)],
        },
    ];
    Device::new(Blueprint {
        description,
        drive: None,
        cycle: Duration::from_millis(1),
    })
}
