//! I/O terminals without CoE: process data as their SII describes them, nothing else. All are of no particular maker.

use core::time::Duration;

use crate::description::{
    Description, Direction, Identity, PdoDescription, PdoEntryDescription, SyncManagerDescription,
    SyncManagerUse,
};
use crate::device::{Blueprint, Device};

/// The names of the channels of the digital terminals.
const CHANNELS: [&str; 8] = [
    "Channel 1",
    "Channel 2",
    "Channel 3",
    "Channel 4",
    "Channel 5",
    "Channel 6",
    "Channel 7",
    "Channel 8",
];
const OUTPUTS: SyncManagerDescription = SyncManagerDescription {
    start: 0x1000,
    length: 2,
    control: 0x44,
    purpose: SyncManagerUse::Outputs,
};
const INPUTS: SyncManagerDescription = SyncManagerDescription {
    start: 0x1080,
    length: 2,
    control: 0x20,
    purpose: SyncManagerUse::Inputs,
};

/// A terminal with two bytes of outputs and two bytes of inputs.
#[must_use]
pub fn io_terminal() -> Device {
    let sixteen_bits = |index, name| PdoEntryDescription {
        index,
        subindex: 1,
        name,
        data_type: 6,
        bits: 16,
    };
    let pdo = |index, direction, sync_manager, entry| PdoDescription {
        index,
        name: "",
        direction,
        sync_manager: Some(sync_manager),
        fixed: true,
        mandatory: false,
        excludes: Vec::new(),
        entries: vec![entry],
    };
    terminal(
        ("16 outputs, 16 inputs", 0x494F_3136),
        vec![OUTPUTS, INPUTS],
        vec![1, 2],
        vec![
            pdo(
                0x1600,
                Direction::Outputs,
                0,
                sixteen_bits(0x7000, "Outputs"),
            ),
            pdo(0x1A00, Direction::Inputs, 1, sixteen_bits(0x6000, "Inputs")),
        ],
    )
}

/// A terminal with eight digital inputs, a PDO of one bit each: "Channel 1" with the entry "Input", and so on.
#[must_use]
pub fn digital_inputs() -> Device {
    terminal(
        ("8 digital inputs", 0x4449_3038),
        vec![SyncManagerDescription {
            length: 1,
            ..INPUTS
        }],
        vec![2],
        channels(Direction::Inputs, 0x1A00, 0x6000, "Input"),
    )
}

/// A terminal with eight digital outputs, a PDO of one bit each: "Channel 1" with the entry "Output", and so on.
#[must_use]
pub fn digital_outputs() -> Device {
    terminal(
        ("8 digital outputs", 0x444F_3038),
        vec![SyncManagerDescription {
            length: 1,
            ..OUTPUTS
        }],
        vec![1],
        channels(Direction::Outputs, 0x1600, 0x7000, "Output"),
    )
}

fn channels(
    direction: Direction,
    first_pdo: u16,
    first_object: u16,
    entry: &'static str,
) -> Vec<PdoDescription> {
    let numbered = (0..).zip(CHANNELS);
    let channel = |(number, name): (u16, _)| PdoDescription {
        index: first_pdo + number,
        name,
        direction,
        sync_manager: Some(0),
        fixed: true,
        mandatory: false,
        excludes: Vec::new(),
        entries: vec![PdoEntryDescription {
            index: first_object + 0x10 * number,
            subindex: 1,
            name: entry,
            data_type: 1,
            bits: 1,
        }],
    };
    numbered.map(channel).collect()
}

fn terminal(
    (name, product): (&str, u32),
    sync_managers: Vec<SyncManagerDescription>,
    fmmu_usage: Vec<u8>,
    pdos: Vec<PdoDescription>,
) -> Device {
    let identity = Identity {
        vendor: 0,
        product,
        revision: 1,
        serial: 0,
    };
    let mut description = Description::new(name, identity);
    description.sync_managers = sync_managers;
    description.fmmu_usage = fmmu_usage;
    description.pdos = pdos;
    Device::new(Blueprint {
        description,
        drive: None,
        cycle: Duration::from_millis(1),
    })
}
