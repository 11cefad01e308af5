//! The objects of the communication profile that every drive has, and those of its user.

use super::DriveBlueprint;
use crate::coe::info::data_type;
use crate::description::Description;
use crate::dictionary::{Dictionary, Entry};

/// Synchronisation types of 1C32h:1 and 1C33h:1: free run, and with SYNC0.
pub(super) const FREE_RUN: u16 = 0;
pub(super) const WITH_SYNC0: u16 = 2;
/// With the outputs, in 1C32h:1 and in 1C33h:1.
const WITH_OUTPUTS: u16 = 1;
const WITH_OUTPUTS_AT_INPUTS: u16 = 34;

/// Saves what is kept in the EEPROM when its subindex 1 is written with "save" (CiA 301).
pub(super) const SAVE: u16 = 0x1010;

/// Empties that when its subindex 1 is written with "load": the defaults are in force after the next power-up (CiA 301).
pub(super) const LOAD: u16 = 0x1011;

/// The communication profile's objects (CiA 301, ETG.1000.6).
pub(super) fn communication_objects(
    blueprint: &DriveBlueprint,
    description: &Description,
) -> Dictionary {
    let mut objects = Dictionary::default();
    objects.variable(0x1000, "Device type", Entry::u32(blueprint.device_type));
    objects.variable(0x1008, "Device name", Entry::text(&description.name));
    objects.variable(
        0x1009,
        "Hardware version",
        Entry::text(&blueprint.hardware_version),
    );
    objects.variable(
        0x100A,
        "Software version",
        Entry::text(&blueprint.software_version),
    );
    let identity = description.identity;
    objects.record(
        0x1018,
        "Identity",
        data_type::IDENTITY,
        [
            Entry::u32(identity.vendor).named("Vendor ID"),
            Entry::u32(identity.product).named("Product code"),
            Entry::u32(identity.revision).named("Revision number"),
            Entry::u32(identity.serial).named("Serial number"),
        ],
    );
    objects.record(
        0x10F1,
        "Error settings",
        data_type::ERROR_SETTINGS,
        [
            Entry::u32(1).named("Local error reaction").writable(),
            Entry::u16(4).named("Sync error counter limit").writable(),
        ],
    );
    // What the sync managers are for: mailbox out, mailbox in, outputs, inputs.
    objects.array(
        0x1C00,
        "Sync manager communication types",
        (1..=4).map(|kind| Entry::u8(kind).named("Communication type")),
    );
    for (index, name) in [
        (0x1C32, "Output sync manager parameter"),
        (0x1C33, "Input sync manager parameter"),
    ] {
        objects.record(
            index,
            name,
            data_type::SYNC_PARAMETER,
            synchronisation(blueprint, description),
        );
    }
    if blueprint.saves {
        // Reads 1: it saves on command, not by itself (CiA 301).
        objects.array(
            SAVE,
            "Store parameters",
            [Entry::u32(1).named("Save all parameters").writable()],
        );
        objects.array(
            LOAD,
            "Restore default parameters",
            [Entry::u32(1)
                .named("Restore all default parameters")
                .writable()],
        );
    }
    if let Some((index, longest)) = blueprint.note {
        objects.variable(index, "Note of the user", Entry::text("").up_to(longest));
        objects.record(
            index.saturating_add(1),
            "Mark of the user",
            data_type::NONE,
            [
                Entry::u16(0).named("Number").writable(),
                Entry::u32(0).named("Key").write_only(),
                Entry::u32(0).named("Place").writable(),
            ],
        );
    }
    objects
}

/// The elements of 1C32h and 1C33h. A device with a mode of distributed clocks takes type 2 besides free run.
fn synchronisation(blueprint: &DriveBlueprint, description: &Description) -> [Entry; 4] {
    let has_clock = description
        .clock_modes
        .iter()
        .any(|mode| mode.assign_activate != 0);
    // Bit 0: free run; bit 1: with the process data; bits 4 to 2: 001, SYNC0. A real Leadshine EL7 shows 0005h too.
    let (choices, supported): (&[u16], u16) = match (has_clock, description.sm_synchronous) {
        (false, false) => (&[FREE_RUN], 0x0001),
        (true, false) => (&[FREE_RUN, WITH_SYNC0], 0x0005),
        (false, true) => (&[FREE_RUN, WITH_OUTPUTS, WITH_OUTPUTS_AT_INPUTS], 0x0003),
        (true, true) => (
            &[FREE_RUN, WITH_OUTPUTS, WITH_SYNC0, WITH_OUTPUTS_AT_INPUTS],
            0x0007,
        ),
    };
    let cycle = blueprint
        .axes
        .first()
        .map_or(0, |axis| axis.period.as_nanos());
    [
        Entry::u16(FREE_RUN)
            .named("Synchronisation type")
            .one_of(choices),
        Entry::u32(u32::try_from(cycle).unwrap_or(u32::MAX)).named("Cycle time"),
        Entry::u32(0).named("Shift time"),
        Entry::u16(supported).named("Synchronisation types supported"),
    ]
}
