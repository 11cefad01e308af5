//! The sample ESI files against the simulated drives that they describe, over a whole bring-up in virtual time.
#![allow(missing_docs)]
#![cfg(feature = "esi")]

#[path = "../bus/rig.rs"]
#[allow(dead_code, reason = "the tests of the bus use more of it")]
mod rig;

use std::path::PathBuf;

use rig::{Line, Rig, unhomed};
use servocrab::{
    bus::Network,
    esi::{Esi, EsiDevice, EsiDifferences},
};
use servocrab_sim::{AlState, Device, EsiDrive, Segment, personality::Servo};

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("sim/esi")
        .join(name)
}

fn sample(name: &str) -> EsiDevice {
    let mut esi = Esi::load(path(name)).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(esi.devices.len(), 1);
    esi.devices.remove(0)
}

/// Brings a drive up by a description from the file, and compares it with another file.
fn compared(by: &EsiDevice, device: Device, with: &EsiDevice) -> (Rig, Line, EsiDifferences) {
    let line = Line::new(Segment::new().with(device));
    let description = by.description().unwrap();
    let names = &["x", "y"][..description.axes.len()];
    let config = unhomed(description, names).start_up(by.start_up_list());
    let builder = Network::builder().link(line.wire()).drive(0, config);
    let mut rig = Rig::start(builder).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(line.segment().devices()[0].al_state(), AlState::Op);
    let sdo = rig.net().sdo(0).unwrap();
    let differences = rig.until(with.compare(&sdo)).unwrap();
    (rig, line, differences)
}

#[test]
fn a_drive_described_by_its_esi_file_moves_and_is_as_the_file_says() {
    // The drives that the files were written of, and drives made of the files.
    let of_file = |name| EsiDrive::load(path(name)).unwrap().build();
    let drives = [
        ("generic.xml", Servo::generic().build(), ["x"].as_slice()),
        ("akd2g.xml", Servo::akd2g().build(), ["x", "y"].as_slice()),
        ("generic.xml", of_file("generic.xml"), ["x"].as_slice()),
        ("akd2g.xml", of_file("akd2g.xml"), ["x", "y"].as_slice()),
    ];
    for (file, drive, axes) in drives {
        let device = sample(file);
        let (mut rig, line, differences) = compared(&device, drive, &device);
        assert!(differences.is_empty(), "{file}: {differences}");
        assert_eq!(differences.to_string(), "the drive is as its ESI file says");
        rig.moves_each(&line, axes);
        rig.shutdown();
    }
}

#[test]
fn a_scan_finds_a_drive_made_of_a_file_as_the_file_says() {
    let segment = Segment::new()
        .with(EsiDrive::load(path("generic.xml")).unwrap().build())
        .with(EsiDrive::load(path("akd2g.xml")).unwrap().build());
    let segment = std::sync::Mutex::new(segment);
    let wire =
        servocrab::link::Wire::new(move |frame, now| segment.lock().unwrap().process(frame, now));
    let line = smol::block_on(Network::builder().link(wire).scan()).unwrap();
    for (found, file) in line.devices().iter().zip(["generic.xml", "akd2g.xml"]) {
        let device = sample(file);
        assert!(found.problem.is_none(), "{:?}", found.problem);
        let identity = found.id.identity;
        assert_eq!(
            (identity.vendor, identity.product, identity.revision),
            (device.vendor, device.product, device.revision)
        );
    }
    assert_eq!(line.devices().len(), 2);
}

#[test]
fn a_file_of_another_drive_is_shown_as_a_table_of_what_differs() {
    let own = sample("generic.xml");
    let mut other = own.clone();
    other.revision = 7;
    other.pdos[1].fixed = true;
    other.pdos[1].pdo.entries.pop();
    let mut missing = other.dictionary[0].clone();
    missing.object.index = 0x2FFE;
    missing.name = "Not there".to_owned();
    other.dictionary.push(missing);
    other.dictionary[0].bits = 16;
    let (rig, _line, differences) = compared(&own, Servo::generic().build(), &other);
    let lines: Vec<_> = differences
        .to_string()
        .lines()
        .map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "))
        .collect();
    assert_eq!(
        lines,
        [
            "the drive is not as its ESI file says:",
            "object what ESI file drive",
            "1018h:03 revision 00000007h 00000001h",
            "1601h:02 PDO entry nothing 607Ah:00 (32 bits)",
            "1000h:00 Device type 16 bits 32 bits",
            "2FFEh:00 Not there 32 bits missing",
        ]
    );
    rig.shutdown();
}

#[test]
fn an_axis_that_the_drive_does_not_have_is_missing_with_its_pdos_and_objects() {
    let one_axis = sample("generic.xml");
    let two_axes = sample("akd2g.xml");
    let (rig, _line, differences) = compared(&one_axis, Servo::generic().build(), &two_axes);
    let missing = |index: u16| {
        differences
            .0
            .iter()
            .any(|difference| difference.object.index == index && difference.drive == "missing")
    };
    assert!(
        missing(0x1610) && missing(0x1A10) && missing(0x6840),
        "{differences}"
    );
    assert!(!missing(0x6040), "{differences}");
    rig.shutdown();
}
