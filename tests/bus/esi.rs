//! The sample ESI files against the simulated drives that they describe, over a whole bring-up in virtual time.
#![cfg(feature = "esi")]

use std::path::PathBuf;

use crate::rig::{Line, Rig, unhomed};
use servocrab::{
    AxisConfig, DriveConfig, Network, Outcome, Referencing, SetPoint,
    bus::DistributedClock,
    coe::{AbortCode, obj},
    drives,
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

/// The plain drive's file with these changes.
fn edited(changes: &[(&str, &str)]) -> String {
    let text = std::fs::read_to_string(path("generic.xml")).unwrap();
    changes.iter().fold(text, |text, (find, put)| {
        assert!(text.contains(find), "{find}");
        text.replace(find, put)
    })
}

fn described(text: &str) -> EsiDevice {
    let esi = Esi::from_bytes("made.xml", text.as_bytes());
    esi.unwrap_or_else(|error| panic!("{error}"))
        .devices
        .remove(0)
}

fn simulated(text: &str) -> Device {
    let drive = EsiDrive::from_bytes("made.xml", text.as_bytes());
    drive.unwrap_or_else(|error| panic!("{error}")).build()
}

/// Why a drive of a file does not come up.
fn not_brought_up(text: &str) -> String {
    let line = Line::new(Segment::new().with(simulated(text)));
    let config = DriveConfig::from_esi(&described(text)).unwrap().axis("x");
    let builder = Network::builder().link(line.wire()).drive(0, config);
    let started = Rig::start(builder);
    let error = started.err().expect("it cannot be moved").to_string();
    assert_eq!(error.matches(". ").count(), 0, "one sentence: {error}");
    error
}

/// Without this object in a PDO or in the dictionary.
fn without(text: &str, index: &str) -> String {
    let lines = text.lines();
    let rest = lines.filter(|line| !line.contains(&format!("<Index>#x{index}</Index>")));
    rest.collect::<Vec<_>>().join("\n")
}

fn command(attributes: &str, index: &str, data: &str) -> String {
    format!(
        "<InitCmd {attributes}><Transition>PS</Transition><Index>#x{index}</Index><SubIndex>0</SubIndex>\
         <Data>{data}</Data><Comment>Opmode</Comment></InitCmd>"
    )
}

#[test]
fn commands_for_what_the_library_does_itself_are_left_out_where_they_agree() {
    let commands = [
        command("", "6060", "01"),
        command("", "6040", "0000"),
        command("", "60FF", "00000000"),
        command("CompleteAccess=\"1\"", "1C12", "0100001A"),
        command("CompleteAccess=\"1\"", "1600", "00"),
        command("", "6067", "4D000000"),
    ];
    let text = edited(&[("</CoE>", &format!("{}</CoE>", commands.concat()))]);
    let device = described(&text);
    let list = device.start_up_list().unwrap();
    let objects: Vec<_> = list.writes.iter().map(|write| write.object.index).collect();
    assert_eq!(objects, [0x605A, 0x6067]);
    let (mut rig, _line) = brought_up_and_moved(&device, simulated(&text), &["x"]);
    assert_eq!(held(&mut rig, 0x6067, 0), [77, 0, 0, 0]);
    rig.shutdown();
}

#[test]
fn commands_for_another_mode_or_a_motion_are_refused_by_name_with_the_way_round() {
    for (index, data) in [("6060", "08"), ("6040", "0F00"), ("607A", "10270000")] {
        let commands = format!("{}</CoE>", command("", index, data));
        let text = edited(&[("</CoE>", &commands)]);
        let mut device = described(&text);
        let error = DriveConfig::from_esi(&device).unwrap_err().to_string();
        for part in [
            index,
            "Opmode",
            "CiA 402 servo drive",
            "take it out of the file, or of `EsiDevice::init_commands`",
        ] {
            assert!(error.contains(part), "{part}: {error}");
        }
        let index = u16::from_str_radix(index, 16).unwrap();
        device
            .init_commands
            .retain(|command| command.object.index != index);
        let (rig, _line) = brought_up_and_moved(&device, simulated(&text), &["x"]);
        rig.shutdown();
    }
}

#[test]
fn of_a_file_with_a_device_that_cannot_be_described_the_others_are_brought_up_and_moved() {
    let text = edited(&[(
        "<Devices>",
        "<Devices><Device><Type ProductCode=\"0x1800\" RevisionNo=\"0x1\">EL</Type><Name>Terminal</Name>\
         <RxPdo><Index>#x1800</Index></RxPdo></Device>\
         <Device><Type ProductCode=\"24\">AX</Type><TxPdo/></Device>",
    )]);
    let esi = Esi::from_bytes("many.xml", text.as_bytes()).unwrap();
    let skipped: Vec<_> = esi.skipped.iter().map(ToString::to_string).collect();
    assert!(
        skipped[0].starts_with(
            "Terminal cannot be described: many.xml:7, element Index: expected an index of 1600h"
        ),
        "{skipped:?}"
    );
    assert!(
        skipped[1].starts_with("AX cannot be described"),
        "{skipped:?}"
    );
    let absent = esi.device(0x1800, 1).unwrap_err().to_string();
    assert!(absent.contains(&skipped[0]), "{absent}");
    assert_eq!(
        esi.device(7, 1).unwrap_err().to_string(),
        "the file describes no device with product code 00000007h"
    );
    let warnings: Vec<_> = esi.warnings.iter().map(ToString::to_string).collect();
    assert_eq!(
        warnings,
        [
            "many.xml:7, element Type: `0x1800` is no number as ETG.2000 has them: it is read as hexadecimal, which #x says"
        ]
    );
    let file = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("many.xml");
    std::fs::write(&file, &text).unwrap();
    let choice: EsiChoice = format!("{}:44530402h", file.display()).parse().unwrap();
    let drive = EsiDrive::choose(&choice).unwrap().build();
    let device = esi.device(0x4453_0402, 1).unwrap();
    let (rig, _line) = brought_up_and_moved(device, drive, &["x"]);
    rig.shutdown();
}

#[test]
fn a_file_with_numbers_as_0x_and_values_of_other_lengths_is_simulated_brought_up_and_moved() {
    let object = |index: &str, kind: &str, bits: u32, value: &str| {
        format!(
            "<Object><Index>0x{index}</Index><Type>{kind}</Type><BitSize>{bits}</BitSize>\
             <Info><DefaultData>{value}</DefaultData></Info><Flags><Access>rw</Access></Flags></Object>"
        )
    };
    let objects = [
        object("6502", "UINT", 16, "2100"),
        object("6065", "UDINT", 32, "3930"),
        object("2000", "UINT", 16, "341256"),
        object("2001", "ARRAY [0..511] OF BYTE", 4096, "0102"),
    ];
    let text = edited(&[
        ("#x", "0x"),
        ("</Objects>", &format!("{}</Objects>", objects.concat())),
    ]);
    let (mut rig, _line) = brought_up_and_moved(&described(&text), simulated(&text), &["x"]);
    assert_eq!(held(&mut rig, 0x6065, 0), [0x39, 0x30, 0, 0]);
    assert_eq!(held(&mut rig, 0x2000, 0), [0x34, 0x12]);
    let array = held(&mut rig, 0x2001, 0);
    assert_eq!((array.len(), &array[..3]), (512, &[1, 2, 0][..]));
    rig.shutdown();
}

#[test]
fn a_module_that_a_slot_names_by_its_ident_is_the_one_that_is_brought_up() {
    let text = std::fs::read_to_string(path("two_axes.xml")).unwrap();
    let other = "<ModuleIdent>0x777</ModuleIdent>";
    let text = text
        .replacen("<ModuleIdent", &format!("{other}<ModuleIdent"), 1)
        .replace(
            "<Modules>",
            "<Modules><Module><Type>no ident</Type></Module>",
        );
    let device = described(&text);
    assert_eq!(device.slots[0].fitting[0], 0x777);
    assert_eq!(device.slots[0].module, Some(0x401));
    let (rig, _line) = brought_up_and_moved(&device, simulated(&text), &["x", "y"]);
    rig.shutdown();
}

#[test]
fn a_drive_whose_pdos_have_no_target_position_says_which_modes_it_has() {
    let outputs = entries(&[(0x6040, 16), (0x6060, 8), (0x60FF, 32)]);
    let inputs = entries(&[(0x6041, 16), (0x6061, 8), (0x6064, 32)]);
    let pdos = format!(
        "<RxPdo Fixed=\"1\" Sm=\"2\"><Index>#x1600</Index>{outputs}</RxPdo>\
         <TxPdo Fixed=\"1\" Sm=\"3\"><Index>#x1A00</Index>{inputs}</TxPdo>"
    );
    let modes = "<Object><Index>#x6502</Index><Type>UDINT</Type><BitSize>32</BitSize>\
                 <Info><DefaultData>84010000</DefaultData></Info></Object></Objects>";
    let text = changed(&pdos, "", "").replace("</Objects>", modes);
    let error = not_brought_up(&text);
    assert!(
        error.ends_with(
            "axis x cannot be moved: moves need 607Ah:00 target position in an RxPDO, which none holds that this drive offers, and \
             it has profile velocity mode (3), cyclic synchronous position mode (8), cyclic synchronous velocity mode (9) by 6502h"
        ),
        "{error}"
    );
}

#[test]
fn a_drive_without_profile_position_says_which_modes_it_has() {
    let modes = "<Object><Index>#x6502</Index><Type>UDINT</Type><BitSize>32</BitSize>\
                 <Info><DefaultData>80000000</DefaultData></Info></Object></Objects>";
    let error = not_brought_up(&edited(&[("</Objects>", modes)]));
    assert!(
        error.ends_with(
            "axis x cannot be moved: its drive has cyclic synchronous position mode (8) by 6502h, and moves need profile position \
             mode (1)"
        ),
        "{error}"
    );
}

#[test]
fn a_drive_without_a_profile_velocity_moves_with_what_it_holds() {
    let text = without(&edited(&[]), "6081");
    let line = Line::new(Segment::new().with(simulated(&text)));
    let config = DriveConfig::from_esi(&described(&text)).unwrap().axis("x");
    let config = config.change_axis("x", |axis| {
        axis.referencing(Referencing::UnreferencedMovesAllowed)
    });
    let builder = Network::builder().link(line.wire()).drive(0, config);
    let mut rig = Rig::start(builder).unwrap_or_else(|error| panic!("{error}"));
    let axis = rig.net().axis("x").unwrap();
    let outcome = rig.until(async {
        axis.enable().await.unwrap();
        let positions = axis.profile_position().await.unwrap();
        let motion = positions.move_abs(10_000, SetPoint::new()).await.unwrap();
        motion.done().await.unwrap()
    });
    assert!(matches!(outcome, Outcome::Reached { .. }), "{outcome:?}");
    assert_eq!(line.segment().axis(0, 0).unwrap().ledger()[0].value, 10_000);
    rig.shutdown();
}

/// A drive with room for so many objects in 1600h and 1A00h, and no other PDO.
fn with_room_for(places: usize) -> Device {
    let text = edited(&[]);
    let (head, rest) = text.split_at(text.find("<DataType><Name>DT1600").unwrap());
    let (_, tail) = rest.split_at(rest.find("<DataType><Name>DT1C12ARR").unwrap());
    let place = |place| {
        let kind = if place == 0 { "USINT" } else { "UDINT" };
        let bits = if place == 0 { 8 } else { 32 };
        format!(
            "<SubItem><SubIdx>{place}</SubIdx><Type>{kind}</Type><BitSize>{bits}</BitSize><Flags><Access>rw</Access></Flags></SubItem>"
        )
    };
    let places: String = (0..=places).map(place).collect();
    let text = format!("{head}<DataType><Name>DT1600</Name>{places}</DataType>\n{tail}");
    let pdo = |name: &str, index: &str, entries: String| {
        format!(
            "<{name} Sm=\"{}\"><Index>#x{index}</Index>{entries}</{name}>",
            if name == "RxPdo" { 2 } else { 3 }
        )
    };
    let pdos = pdo("RxPdo", "1600", entries(&[(0x6040, 16), (0x607A, 32)]))
        + &pdo("TxPdo", "1A00", entries(&[(0x6041, 16), (0x6064, 32)]));
    let (head, rest) = text.split_at(text.find("<RxPdo").unwrap());
    let (_, tail) = rest.split_at(rest.find("<Mailbox").unwrap());
    let text = ["1601", "1602", "1603", "1A01", "1A02", "1A03"]
        .iter()
        .fold(format!("{head}{pdos}{tail}"), |text, index| {
            without(&text, index)
        });
    simulated(&text)
}

#[test]
fn what_a_drive_has_no_room_for_in_its_pdos_goes_by_sdo_the_most_needed_is_mapped() {
    for (places, expected) in [
        (5, &[0x6040_u16, 0x6060, 0x607A, 0x6081, 0x6083][..]),
        (2, &[0x6040, 0x607A]),
    ] {
        let line = Line::new(Segment::new().with(with_room_for(places)));
        let config = unhomed(drives::generic(), &["x"]);
        let builder = Network::builder().link(line.wire()).drive(0, config);
        let mut rig = Rig::start(builder).unwrap_or_else(|error| panic!("{error}"));
        rig.moves_each(&line, &["x"]);
        assert_eq!(held(&mut rig, 0x1C12, 0), [1]);
        assert_eq!(usize::from(held(&mut rig, 0x1600, 0)[0]), expected.len());
        for (place, index) in (1..).zip(expected) {
            let entry = held(&mut rig, 0x1600, place);
            assert_eq!(entry[2..], index.to_le_bytes(), "{place}");
        }
        rig.loses_power(&line, 0);
        rig.recover(0).unwrap_or_else(|error| panic!("{error}"));
        rig.shutdown();
    }
    let line = Line::new(Segment::new().with(with_room_for(2)));
    let axis = AxisConfig::new("x").map_output(obj::TARGET_TORQUE);
    let config = DriveConfig::new(drives::generic()).axis(axis);
    let builder = Network::builder().link(line.wire()).drive(0, config);
    let error = Rig::start(builder).err().expect("no room").to_string();
    assert!(error.contains("1600h"), "{error}");
}
