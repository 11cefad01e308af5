//! The objects that the library and the simulated drive know, beside the dictionary of a real Leadshine EL7.
//!
//! Each difference is listed with its reason; one that is not listed, or no longer there, fails.

use std::collections::{BTreeMap, BTreeSet};

use servocrab::coe::{AnyObject, TypeCode, obj};
use servocrab_sim::personality;

use super::drive::Drive;
use super::vectors::{number, object, rows};

/// What can differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Differs {
    Type,
    /// The real drive's can be written, ours cannot.
    ReadOnlyHere,
    /// The real drive's cannot be written, ours can.
    ReadOnlyThere,
    /// The PDOs into which it can be mapped.
    Mapping,
    /// The real drive has no such object.
    Absent,
}
use Differs::{Absent, Mapping, ReadOnlyHere, ReadOnlyThere, Type};

/// An object as any side describes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Form {
    /// As SDO information codes it.
    kind: u8,
    writable: bool,
    /// Into an RxPDO, into a TxPDO.
    mappable: (bool, bool),
}

type Address = (u16, u8);

/// The real drive's objects: all of them can be read.
fn real() -> BTreeMap<Address, Form> {
    rows(include_str!("../../vectors/el7_dictionary.txt"))
        .map(|row| {
            let access = number(row[3]);
            assert_eq!(access & 0x07, 0x07, "{} cannot be read", row[0]);
            let form = Form {
                kind: row[1].parse().unwrap(),
                writable: access & 0x38 != 0,
                mappable: (access & 0x40 != 0, access & 0x80 != 0),
            };
            (object(row[0]), form)
        })
        .collect()
}

fn differences(ours: impl Iterator<Item = (Address, Form)>) -> BTreeSet<(Address, Differs)> {
    let real = real();
    let mut found = BTreeSet::new();
    for (address, ours) in ours {
        let Some(real) = real.get(&address) else {
            found.insert((address, Absent));
            continue;
        };
        let checks = [
            (ours.kind != real.kind, Type),
            (real.writable && !ours.writable, ReadOnlyHere),
            (!real.writable && ours.writable, ReadOnlyThere),
            (ours.mappable != real.mappable, Mapping),
        ];
        for (differs, what) in checks {
            if differs {
                found.insert((address, what));
            }
        }
    }
    found
}

fn of_library(object: AnyObject) -> (Address, Form) {
    let form = Form {
        kind: TypeCode::from(object.data_type).0 as u8,
        writable: object.writable,
        mappable: (object.mappable.outputs, object.mappable.inputs),
    };
    ((object.index, object.subindex), form)
}

/// Objects that each maker has for itself.
const MAKERS: core::ops::Range<u16> = 0x2000..0x6000;

/// All entries of a simulated drive by SDO information, but the maker's and those of PDO mappings and assignments above the first.
fn of_simulation(drive: &Drive) -> BTreeMap<Address, Form> {
    let mut entries = BTreeMap::new();
    let objects = drive.objects();
    for index in objects.into_iter().filter(|index| !MAKERS.contains(index)) {
        let list = matches!(index, 0x1600..=0x1BFF | 0x1C12 | 0x1C13);
        let last = if list { 1 } else { drive.last_subindex(index) };
        for subindex in 0..=last {
            let Some((kind, bits, access)) = drive.entry(index, subindex) else {
                continue;
            };
            let width = match kind {
                2 | 5 => 8,
                3 | 6 => 16,
                4 | 7 => 32,
                _ => bits,
            };
            assert_eq!(bits, width, "{index:04X}h:{subindex} of type {kind}");
            assert_eq!(
                access & 0x07,
                0x07,
                "{index:04X}h:{subindex} cannot be read"
            );
            let form = Form {
                kind: kind as u8,
                writable: access & 0x38 != 0,
                mappable: (access & 0x40 != 0, access & 0x80 != 0),
            };
            entries.insert((index, subindex), form);
        }
    }
    entries
}

/// Objects, how they differ, and why that may be.
type Listed = (&'static [Address], Differs, &'static str);

fn assert_listed(found: &BTreeSet<(Address, Differs)>, listed: &[Listed]) {
    let listed: BTreeSet<_> = listed
        .iter()
        .flat_map(|&(addresses, differs, _)| addresses.iter().map(move |at| (*at, differs)))
        .collect();
    let hex = |differences: Vec<&(Address, Differs)>| {
        differences
            .into_iter()
            .map(|((index, subindex), differs)| format!("{index:04X}h:{subindex} {differs:?}"))
            .collect::<Vec<_>>()
    };
    let unlisted = hex(found.difference(&listed).collect());
    let gone = hex(listed.difference(found).collect());
    assert!(unlisted.is_empty(), "not listed: {unlisted:?}");
    assert!(gone.is_empty(), "no longer there: {gone:?}");
}

/// Why the real drive differs from both sides alike.
const OF_THE_DRIVE: [Listed; 6] = [
    (&[(0x6007, 0)], Absent, "optional in CiA 402"),
    (
        &[(0x60D1, 0), (0x60D2, 0), (0x60D3, 0), (0x60D4, 0)],
        Absent,
        "time stamps of touch probes: optional in CiA 402",
    ),
    (&[(0x60F2, 0)], Absent, "optional, of IEC 61800-7-201"),
    (
        &[(0x605A, 0)],
        Mapping,
        "AKD2G, Profile Position mode: among the data of its TxPDOs",
    ),
    (
        &[(0x607D, 1), (0x607D, 2)],
        Mapping,
        "CiA 402 v2.0 maps it; this drive and the Yaskawa do not",
    ),
    (
        &[(0x608F, 1), (0x608F, 2), (0x6092, 2)],
        ReadOnlyThere,
        "CiA 402: writable; in that drive they are fixed",
    ),
];

#[test]
fn the_librarys_objects_have_a_real_drives_types_and_access() {
    let library: [Listed; 9] = [
        (
            &[(0x6075, 0)],
            ReadOnlyThere,
            "CiA 402: writable; that drive knows its motor",
        ),
        (
            &[
                (0x6076, 0),
                (0x60C1, 1),
                (0x60D0, 1),
                (0x60D0, 2),
                (0x60E3, 0),
            ],
            Absent,
            "optional in CiA 402",
        ),
        (
            &[(0x60A4, 1), (0x60A4, 2), (0x60C2, 1), (0x60C2, 2)],
            Mapping,
            "that drive has them among the data of its TxPDOs",
        ),
        (
            &[(0x1003, 0), (0x1003, 1)],
            Absent,
            "error history, CiA 301: optional",
        ),
        (
            &[
                (0x1C32, 1),
                (0x1C32, 2),
                (0x1C32, 3),
                (0x1C33, 1),
                (0x1C33, 2),
                (0x1C33, 3),
            ],
            ReadOnlyThere,
            "ETG.1020: writable where the device lets the master choose",
        ),
        (&[(0x2010, 0)], Absent, "of the drive with 2010h"),
        (&[(0x5000, 4)], Absent, "of the AKD2G"),
        (
            &[
                (0x608F, 1),
                (0x608F, 2),
                (0x6091, 1),
                (0x6091, 2),
                (0x6092, 2),
            ],
            Mapping,
            "CiA 402: mappable; nobody maps a constant cyclically",
        ),
        (
            &[
                (0x6090, 1),
                (0x6090, 2),
                (0x6093, 1),
                (0x6093, 2),
                (0x6094, 1),
                (0x6094, 2),
                (0x6095, 1),
                (0x6095, 2),
                (0x6096, 1),
                (0x6096, 2),
                (0x6097, 1),
                (0x6097, 2),
                (0x60A8, 0),
                (0x60A9, 0),
                (0x60AA, 0),
                (0x6402, 0),
                (0x6403, 0),
                (0x6404, 0),
                (0x67FF, 0),
            ],
            Absent,
            "optional: factors of other drives, units, the motor's data, a device of one axis",
        ),
    ];
    let listed = [&OF_THE_DRIVE[..], &library].concat();
    assert_listed(
        &differences(obj::all().into_iter().map(of_library)),
        &listed,
    );
}

/// An object with its subindices from 0 on.
const fn elements<const N: usize>(index: u16) -> [Address; N] {
    let mut all = [(index, 0); N];
    let mut subindex = 0;
    while subindex < N {
        all[subindex].1 = subindex as u8;
        subindex += 1;
    }
    all
}
const ERROR_HISTORY: [Address; 9] = elements(0x1003);
const HOMING_METHODS: [Address; 33] = elements(0x60E3);

#[test]
fn the_simulated_generic_drives_objects_have_a_real_drives_types_and_access() {
    let simulation: [Listed; 8] = [
        (&[(0x1001, 0)], Mapping, "optional in CiA 301"),
        (&ERROR_HISTORY, Absent, "error history, CiA 301: optional"),
        (
            &[(0x1A02, 0), (0x1A02, 1), (0x1A03, 0), (0x1A03, 1)],
            Absent,
            "that drive has two TxPDOs",
        ),
        (
            &[(0x1C32, 1), (0x1C33, 1)],
            ReadOnlyThere,
            "ETG.1020: writable where the device lets the master choose",
        ),
        (
            &[(0x6092, 1)],
            Mapping,
            "the factors are constants of the simulated drive's mechanics",
        ),
        (
            &[
                (0x6096, 0),
                (0x6096, 1),
                (0x6096, 2),
                (0x6097, 0),
                (0x6097, 1),
                (0x6097, 2),
            ],
            Absent,
            "optional: that drive's velocities and ramps are in its position unit",
        ),
        (
            &[(0x6099, 0)],
            ReadOnlyHere,
            "CiA 301: subindex 0 of a record only says how many entries follow",
        ),
        (&HOMING_METHODS, Absent, "optional, of later editions"),
    ];
    let listed = [&OF_THE_DRIVE[..], &simulation].concat();
    let drive = Drive::new(personality::Servo::generic().with_sdo_information().build());
    let entries = of_simulation(&drive);
    assert!(entries.len() > 100, "{} entries", entries.len());
    assert_listed(&differences(entries.into_iter()), &listed);
}

#[test]
fn most_of_the_librarys_objects_are_in_the_real_drive() {
    // So that the comparison cannot become empty unseen.
    let real = real();
    let (there, absent): (Vec<_>, Vec<_>) = obj::all()
        .into_iter()
        .partition(|object| real.contains_key(&(object.index, object.subindex)));
    assert!(there.len() > 60, "{} of {}", there.len(), absent.len());
}
