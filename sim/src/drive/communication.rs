//! The objects of the communication profile that every drive has.

use super::DriveBlueprint;
use crate::description::Identity;
use crate::dictionary::Dictionary;

/// The communication profile's objects (CiA 301, ETG.1000.6).
pub(super) fn communication_objects(
    blueprint: &DriveBlueprint,
    name: &str,
    identity: Identity,
) -> Dictionary {
    let mut objects = Dictionary::default();
    // Profile 402 with a servo drive (bit 17).
    objects.fixed(0x1000, 0, &0x0002_0192u32.to_le_bytes());
    objects.fixed(0x1008, 0, name.as_bytes());
    objects.fixed(0x1009, 0, blueprint.hardware_version.as_bytes());
    objects.fixed(0x100A, 0, blueprint.software_version.as_bytes());
    objects.fixed(0x1018, 0, &[4]);
    let numbers = [
        identity.vendor,
        identity.product,
        identity.revision,
        identity.serial,
    ];
    for (subindex, number) in (1..).zip(numbers) {
        objects.fixed(0x1018, subindex, &number.to_le_bytes());
    }
    // Sync manager types: mailbox out, mailbox in, outputs, inputs.
    objects.fixed(0x1C00, 0, &[4]);
    for kind in 1..=4 {
        objects.fixed(0x1C00, kind, &[kind]);
    }
    // Error settings: local error reaction and sync error counter limit.
    objects.fixed(0x10F1, 0, &[2]);
    objects.writable(0x10F1, 1, &1u32.to_le_bytes());
    objects.writable(0x10F1, 2, &4u16.to_le_bytes());
    for index in [0x1C32, 0x1C33] {
        objects.fixed(index, 0, &[4]);
        // Synchronisation type 0: free run, the only one; cycle time in nanoseconds; types supported, bit 0.
        let cycle = blueprint
            .axes
            .first()
            .map_or(0, |axis| axis.period.as_nanos());
        objects.writable(index, 1, &0u16.to_le_bytes());
        objects.fixed(
            index,
            2,
            &u32::try_from(cycle).unwrap_or(u32::MAX).to_le_bytes(),
        );
        objects.fixed(index, 3, &0u32.to_le_bytes());
        objects.fixed(index, 4, &1u16.to_le_bytes());
    }
    if let Some((index, longest)) = blueprint.note {
        objects.text(index, 0, "", longest);
    }
    objects
}
