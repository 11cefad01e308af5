//! The sample ESI files against the simulated drives that they describe, over a whole bring-up in virtual time.
#![cfg(feature = "esi")]

use std::path::PathBuf;

use crate::rig::{Line, Rig, unhomed};
use servocrab::{
    DriveConfig, Network, Referencing,
    bus::DistributedClock,
    coe::AbortCode,
    esi::{Esi, EsiDevice, EsiDifferences},
};
use servocrab_sim::{AlState, Device, EsiChoice, EsiDrive, Segment, personality::Servo};

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
    let config = unhomed(description, names).start_up(by.start_up_list().unwrap());
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
        (
            "two_axes.xml",
            of_file("two_axes.xml"),
            ["x", "y"].as_slice(),
        ),
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

/// Brings up a drive made of a file by what the same file says of it, and moves each of its axes.
fn brought_up_and_moved(device: &EsiDevice, drive: Device, axes: &[&str]) -> (Rig, Line) {
    let line = Line::new(Segment::new().with(drive));
    let config = DriveConfig::from_esi(device).unwrap_or_else(|error| panic!("{error}"));
    let config = axes.iter().fold(config, |drive, axis| {
        drive.axis(*axis).change_axis(axis, |axis| {
            axis.referencing(Referencing::UnreferencedMovesAllowed)
        })
    });
    let builder = Network::builder().link(line.wire()).drive(0, config);
    let mut rig = Rig::start(builder).unwrap_or_else(|error| panic!("{error}"));
    rig.moves_each(&line, axes);
    (rig, line)
}

/// What a drive holds.
fn held(rig: &mut Rig, index: u16, subindex: u8) -> Vec<u8> {
    let sdo = rig.net().sdo(0).unwrap();
    rig.until(sdo.read_bytes(index, subindex)).unwrap()
}

#[test]
fn a_modular_drive_is_brought_up_in_one_call_with_the_commands_of_each_axis() {
    let drive = EsiDrive::load(path("two_axes.xml")).unwrap().build();
    let (mut rig, _line) = brought_up_and_moved(&sample("two_axes.xml"), drive, &["x", "y"]);
    assert_eq!(held(&mut rig, 0x605A, 0), [6, 0]);
    assert_eq!(held(&mut rig, 0x685A, 0), [6, 0]);
    rig.shutdown();
}

#[test]
fn a_drive_made_of_a_file_holds_its_values_at_power_up_and_has_no_other_object() {
    let drive = EsiDrive::load(path("two_axes.xml")).unwrap().build();
    let (mut rig, line) = brought_up_and_moved(&sample("two_axes.xml"), drive, &["x", "y"]);
    let identity = line.segment().devices()[0].description().identity;
    assert_eq!(identity.serial, 0x1234_5678);
    assert_eq!(held(&mut rig, 0x1018, 4), [0x78, 0x56, 0x34, 0x12]);
    assert_eq!(held(&mut rig, 0x1009, 0), b"B7");
    assert_eq!(held(&mut rig, 0x100A, 0), b"2.04");
    assert_eq!(held(&mut rig, 0x6502, 0), [0x21, 0, 0, 0]);
    assert_eq!(held(&mut rig, 0x6D02, 0), [0x01, 0, 0, 0]);
    let axis = EsiDrive::load(path("two_axes.xml")).unwrap().build();
    assert_eq!(axis.axis(1).unwrap().get(0x6081, 0), Some(54_321));
    let sdo = rig.net().sdo(0).unwrap();
    for (index, subindex) in [(0x607D, 1), (0x687D, 1), (0x10F1, 2), (0x1010, 1)] {
        let error = rig.until(sdo.read_bytes(index, subindex)).unwrap_err();
        assert_eq!(
            error.error.abort_code(),
            Some(AbortCode::NO_OBJECT),
            "{error}"
        );
    }
    rig.shutdown();
}

/// The plain drive's file with other PDOs, other flags of its `CoE`, and other `InitCmd`s.
fn changed(pdos: &str, coe: &str, commands: &str) -> String {
    let text = std::fs::read_to_string(path("generic.xml")).unwrap();
    let (head, rest) = text.split_at(text.find("<RxPdo").unwrap());
    let (_, rest) = rest.split_at(rest.find("<Mailbox").unwrap());
    let (_, tail) = rest.split_at(rest.find("</CoE>").unwrap());
    format!("{head}{pdos}<Mailbox><CoE SdoInfo=\"1\" PdoAssign=\"1\" {coe}>{commands}{tail}")
}

/// An `Entry` of a PDO.
fn entry(index: u16, subindex: u8, bits: u8) -> String {
    format!(
        "<Entry><Index>#x{index:X}</Index><SubIndex>{subindex}</SubIndex><BitLen>{bits}</BitLen></Entry>"
    )
}

fn entries(all: &[(u16, u8)]) -> String {
    all.iter()
        .map(|(index, bits)| entry(*index, 0, *bits))
        .collect()
}

#[test]
fn fixed_mandatory_and_excluding_pdos_are_assigned_as_the_file_allows() {
    let position = entries(&[
        (0x6040, 16),
        (0x6060, 8),
        (0x607A, 32),
        (0x6081, 32),
        (0x6083, 32),
        (0x6084, 32),
    ]);
    let velocity = entries(&[(0x6040, 16), (0x60FF, 32)]);
    let outputs = entry(0x60FE, 1, 32) + &entry(0x60FE, 2, 32);
    let actual = entries(&[(0x6041, 16), (0x6061, 8), (0x6064, 32), (0x606C, 32)]);
    let pdos = format!(
        "<RxPdo Fixed=\"1\"><Index>#x1701</Index><Exclude>#x1702</Exclude>{position}</RxPdo>\
         <RxPdo Fixed=\"1\" Sm=\"2\"><Index>#x1702</Index><Exclude>#x1701</Exclude>{velocity}</RxPdo>\
         <RxPdo Fixed=\"1\" Mandatory=\"1\" Sm=\"2\"><Index>#x1703</Index>{outputs}</RxPdo>\
         <TxPdo Fixed=\"1\" Mandatory=\"1\" Sm=\"3\"><Index>#x1B01</Index>{actual}</TxPdo>"
    );
    let text = changed(&pdos, "", "");
    let device = Esi::from_bytes("fixed.xml", text.as_bytes())
        .unwrap()
        .devices
        .remove(0);
    let drive = EsiDrive::from_bytes("fixed.xml", text.as_bytes())
        .unwrap()
        .build();
    let (mut rig, _line) = brought_up_and_moved(&device, drive, &["x"]);
    // Without the one that is assigned by default and excludes that of Profile Position; with the mandatory one.
    let mut assigned = [held(&mut rig, 0x1C12, 1), held(&mut rig, 0x1C12, 2)];
    assigned.sort();
    assert_eq!(held(&mut rig, 0x1C12, 0), [2]);
    assert_eq!(assigned, [[0x01, 0x17], [0x03, 0x17]]);
    assert_eq!(held(&mut rig, 0x1C13, 1), [0x01, 0x1B]);
    rig.shutdown();
}

#[test]
fn commands_of_ip_ps_and_so_reach_the_drive() {
    let text = std::fs::read_to_string(path("generic.xml")).unwrap();
    let command = |transition: &str, index: u16, data: &str| {
        format!(
            "<InitCmd Fixed=\"1\"><Transition>{transition}</Transition><Index>#x{index:X}</Index>\
             <SubIndex>0</SubIndex><Data>{data}</Data></InitCmd>"
        )
    };
    let commands = [
        command("IP", 0x6067, "4D000000"),
        command("PS", 0x6068, "0700"),
        command("SO", 0x605A, "0600"),
    ];
    let text = text.replace("</CoE>", &format!("{}</CoE>", commands.concat()));
    let device = Esi::from_bytes("commands.xml", text.as_bytes())
        .unwrap()
        .devices
        .remove(0);
    let drive = EsiDrive::from_bytes("commands.xml", text.as_bytes())
        .unwrap()
        .build();
    let (mut rig, _line) = brought_up_and_moved(&device, drive, &["x"]);
    assert_eq!(held(&mut rig, 0x6067, 0), [77, 0, 0, 0]);
    assert_eq!(held(&mut rig, 0x6068, 0), [7, 0]);
    // PS has written 2 before.
    assert_eq!(held(&mut rig, 0x605A, 0), [6, 0]);
    rig.shutdown();
}

#[test]
fn a_drive_left_in_sync0_gets_the_type_that_its_file_names_and_a_read_only_one_stays() {
    let item = |subindex: u8, name: &str, kind: &str, bits: u8, access: &str| {
        format!(
            "<SubItem><SubIdx>{subindex}</SubIdx><Name>{name}</Name><Type>{kind}</Type><BitSize>{bits}</BitSize><BitOffs>0</BitOffs>\
             <Flags><Access>{access}</Access></Flags></SubItem>"
        )
    };
    let kind = |name: &str, access: &str| {
        let items = [
            item(0, "Count", "USINT", 8, "ro"),
            item(1, "Type", "UINT", 16, access),
            item(4, "Supported", "UINT", 16, "ro"),
        ];
        let items = items.concat();
        format!("<DataType><Name>{name}</Name><BitSize>48</BitSize>{items}</DataType>")
    };
    let object = |index: &str, kind: &str, value: &str| {
        let of = |name: &str, data: &str| {
            format!(
                "<SubItem><Name>{name}</Name><Info><DefaultData>{data}</DefaultData></Info></SubItem>"
            )
        };
        let values = [
            of("Count", "04"),
            of("Type", value),
            of("Supported", "0500"),
        ];
        let values = values.concat();
        format!(
            "<Object><Index>#x{index}</Index><Name>Sync</Name><Type>{kind}</Type><BitSize>48</BitSize><Info>{values}</Info></Object>"
        )
    };
    let kinds = kind("DTRW", "rw") + &kind("DTRO", "ro");
    let objects = object("1C32", "DTRW", "0000") + &object("1C33", "DTRO", "0200");
    let text = std::fs::read_to_string(path("generic.xml"))
        .unwrap()
        .replace("</DataTypes>", &format!("{kinds}</DataTypes>"))
        .replace("</Objects>", &format!("{objects}</Objects>"));
    let device = Esi::from_bytes("clocks.xml", text.as_bytes())
        .unwrap()
        .devices
        .remove(0);
    let drive = EsiDrive::from_bytes("clocks.xml", text.as_bytes())
        .unwrap()
        .build();
    let line = Line::new(Segment::new().with(drive));
    let config = || DriveConfig::from_esi(&device).unwrap().axis("x");
    let clocked = config().dc(DistributedClock::new(0x0300));
    let builder = Network::builder().link(line.wire()).drive(0, clocked);
    let mut rig = Rig::start(builder).unwrap();
    assert_eq!(held(&mut rig, 0x1C32, 1), [2, 0]);
    let begin = rig.bus.now() + std::time::Duration::from_secs(10);
    rig.shutdown();
    let builder = Network::builder().link(line.wire_from(begin));
    let mut rig = Rig::start(builder.drive(0, config())).unwrap();
    assert_eq!(held(&mut rig, 0x1C32, 1), [0, 0]);
    assert_eq!(held(&mut rig, 0x1C33, 1), [2, 0]);
    rig.shutdown();
}

#[test]
fn one_device_of_a_generated_file_of_20_mb_is_found_brought_up_and_moved() {
    let text = std::fs::read_to_string(path("generic.xml")).unwrap();
    let begin = text.find("<Device ").unwrap();
    let end = text.find("</Device>").unwrap() + "</Device>".len();
    let (head, device, tail) = (&text[..begin], &text[begin..end], &text[end..]);
    let devices = 20_000_000 / device.len() + 1;
    let mut large = head.to_owned();
    for number in 0..devices {
        let product = format!(
            "ProductCode=\"#x{:08X}\" RevisionNo=\"#x{:08X}\"",
            number / 2,
            number % 2
        );
        large += &device.replace(
            "ProductCode=\"#x44530402\" RevisionNo=\"#x00000001\"",
            &product,
        );
    }
    large += tail;
    assert!(large.len() > 20_000_000);
    let file = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("large.xml");
    std::fs::write(&file, &large).unwrap();
    let esi = Esi::load(&file).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(esi.devices.len(), devices);
    let product = u32::try_from(devices / 4).unwrap();
    let device = esi.device(product, 1).unwrap();
    assert_eq!((device.product, device.revision), (product, 1));
    let choice: EsiChoice = format!("{}:{product:X}h:0x1", file.display())
        .parse()
        .unwrap();
    let drive = EsiDrive::choose(&choice).unwrap_or_else(|error| panic!("{error}"));
    let (rig, line) = brought_up_and_moved(device, drive.build(), &["x"]);
    let identity = line.segment().devices()[0].description().identity;
    assert_eq!((identity.product, identity.revision), (product, 1));
    rig.shutdown();
}
