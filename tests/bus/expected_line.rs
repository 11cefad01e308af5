//! The line that a program expects, and each way in which the one that is there differs from it.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use servocrab::{
    DriveConfig, Network, NetworkError,
    bus::{DevicePlace, Expected, LineVerdict, NetworkBuilder},
    coe::obj,
    drives,
    link::Wire,
};
use servocrab_sim::{AlState, Device, Segment, personality};

use crate::rig::{Line, Rig, akd2g, datagrams, is_write_to};

const COUPLER: Expected = Expected::new(0, 0x434F_5550);
const TERMINAL: Expected = Expected::new(0, 0x494F_3136);
const AKD2G: DevicePlace = DevicePlace::Identity {
    vendor: 0x6A,
    product: 0x414B_4432,
    serial: None,
};

/// A line with these devices, and whether any of them was asked to leave INIT.
fn line(devices: impl IntoIterator<Item = Device>) -> (Line, Wire, Arc<AtomicBool>) {
    let mut segment = Segment::new();
    devices.into_iter().for_each(|device| segment.push(device));
    let line = Line::new(segment);
    let asked = Arc::new(AtomicBool::new(false));
    let noted = Arc::clone(&asked);
    let wire = line.spoiled_wire(move |frame| {
        for datagram in datagrams(frame) {
            if is_write_to(datagram, 0x0120) && matches!(datagram[10], 2 | 4 | 8) {
                noted.store(true, Ordering::Relaxed);
            }
        }
    });
    (line, wire, asked)
}

fn drive(axis: &str) -> DriveConfig {
    DriveConfig::new(drives::akd2g()).axis(axis)
}

fn generic(axis: &str) -> DriveConfig {
    let mut description = drives::generic();
    (description.vendor, description.product) = (Some(0), Some(0x4453_0402));
    DriveConfig::new(description).axis(axis)
}

fn akd(serial: u32) -> Device {
    personality::Servo::akd2g().serial(serial).build()
}

fn with_alias(alias: u16) -> Device {
    personality::Servo::akd2g().alias(alias).build()
}

/// The verdicts on a line that is refused, with nothing configured and no device asked to leave PREOP.
fn verdicts(
    devices: impl IntoIterator<Item = Device>,
    declare: impl FnOnce(NetworkBuilder) -> NetworkBuilder,
) -> Vec<LineVerdict> {
    let (line, wire, asked) = line(devices);
    let error = Rig::start(declare(Network::builder().link(wire))).err();
    let Some(NetworkError::WrongLine(mismatch)) = error else {
        panic!("not a wrong line: {error:?}");
    };
    assert!(
        !asked.load(Ordering::Relaxed),
        "a device was led out of PREOP"
    );
    for device in line.segment().devices() {
        assert_eq!(
            device.messages_taken(),
            0,
            "{:?}",
            device.description().name
        );
        assert!(device.al_state() <= AlState::PreOp);
    }
    mismatch.0.into_iter().map(|row| row.verdict).collect()
}

use LineVerdict::{Different, Extra, Missing, NotDeclared, Right};

#[test]
fn drives_are_found_by_position_by_alias_and_by_identity() {
    let devices = [
        personality::coupler(),
        with_alias(7),
        personality::Servo::generic().serial(3).build(),
        personality::Servo::generic().serial(4).build(),
        personality::generic(),
    ];
    let (line, wire, asked) = line(devices);
    let fourth = DevicePlace::Identity {
        vendor: 0,
        product: 0x4453_0402,
        serial: Some(4),
    };
    let builder = Network::builder()
        .link(wire)
        .drive(fourth, generic("by identity"))
        .drive(DevicePlace::Alias(7), drive("by alias"))
        .drive(4, generic("by position"));
    let mut rig = Rig::start(builder).unwrap();
    let states: Vec<_> = line
        .segment()
        .devices()
        .iter()
        .map(Device::al_state)
        .collect();
    let (up, down) = (AlState::Op, AlState::PreOp);
    assert_eq!(states, [down, up, down, up, up]);
    assert!(asked.load(Ordering::Relaxed), "seen on the wire");
    // The axis is that of its own drive.
    let axis = rig.net().axis("by identity").unwrap();
    rig.until(axis.enable()).unwrap();
    let enabled: Vec<_> = [1, 3, 4]
        .map(|at| line.segment().axis(at, 0).unwrap().statusword() & 0x6F == 0x27)
        .into();
    assert_eq!(enabled, [false, true, false]);
    // And its mailbox is found by both.
    for place in [fourth, DevicePlace::Position(3)] {
        let sdo = rig.net().sdo(place).unwrap();
        assert_eq!(rig.until(sdo.read(obj::SERIAL_NUMBER)).unwrap(), 4);
    }
    assert!(rig.net().sdo(2).is_none());
    rig.shutdown();
}

#[test]
fn two_drives_at_each_others_place_are_swapped() {
    let declare = |net: NetworkBuilder| {
        net.expect(0, COUPLER)
            .drive(1, drive("x").serial(1))
            .drive(2, drive("y").serial(2))
            .drive(3, generic("z"))
    };
    let devices = |one, two| {
        [
            personality::coupler(),
            akd(one),
            akd(two),
            personality::generic(),
        ]
    };
    let swapped = |with| LineVerdict::Swapped { with };
    assert_eq!(
        verdicts(devices(2, 1), declare),
        [Right, swapped(2), swapped(1), Right]
    );
    // Where anything may stand, it is only one that is at the wrong place.
    let anything = |net: NetworkBuilder| net.drive(0, drive("x")).expect(1, Expected::any());
    assert_eq!(
        verdicts([personality::generic(), akd(0)], anything),
        [LineVerdict::Moved { to: 1 }, Right]
    );
    // Different kinds need no serial numbers for it.
    let kinds = [personality::generic(), akd(0)];
    assert_eq!(
        verdicts(kinds, |net| net.drive(0, drive("x")).drive(1, generic("y"))),
        [swapped(1), swapped(0)]
    );
}

#[test]
fn a_missing_drive_moves_those_behind_it_and_is_told_apart_from_them() {
    let declare = |net: NetworkBuilder| {
        net.expect(0, COUPLER)
            .drive(1, drive("x"))
            .drive(2, generic("y"))
            .expect(3, TERMINAL)
    };
    let devices = [
        personality::coupler(),
        personality::generic(),
        personality::io_terminal(),
    ];
    let moved = |to| LineVerdict::Moved { to };
    assert_eq!(
        verdicts(devices, declare),
        [Right, Missing, moved(1), moved(2)]
    );
    // The last one.
    let devices = [personality::coupler(), akd(1), personality::generic()];
    assert_eq!(verdicts(devices, declare), [Right, Right, Right, Missing]);
    // One of two of a kind: the line ends earlier.
    let two = |net: NetworkBuilder| net.drive(0, drive("x")).drive(1, drive("y"));
    assert_eq!(verdicts([akd(1)], two), [Right, Missing]);
}

#[test]
fn a_device_in_between_moves_those_behind_it() {
    let declare = |net: NetworkBuilder| net.expect(0, COUPLER).drive(1, drive("x"));
    let devices = || [personality::coupler(), personality::io_terminal(), akd(1)];
    let moved = LineVerdict::Moved { to: 2 };
    assert_eq!(
        verdicts(devices(), declare),
        [Right, moved, LineVerdict::Astray { from: 1 }]
    );
}

#[test]
fn another_device_stands_where_one_is_expected() {
    let devices = [personality::coupler(), personality::generic()];
    assert_eq!(
        verdicts(devices, |net| net.drive(1, drive("x"))),
        [NotDeclared, Different]
    );
    // The right kind, but of another revision, or not the one with the number.
    assert_eq!(
        verdicts([akd(1)], |net| net.drive(0, drive("x").revision(2))),
        [Different]
    );
    assert_eq!(
        verdicts([akd(1)], |net| net.drive(0, drive("x").serial(2))),
        [Different]
    );
}

#[test]
fn one_more_device_is_extra_only_in_a_line_that_is_complete() {
    let declare = |net: NetworkBuilder| net.drive(0, akd2g()).expect(1, Expected::any());
    let devices = || [akd(0), personality::io_terminal(), personality::coupler()];
    let (_, wire, _) = line(devices());
    Rig::start(declare(Network::builder().link(wire)))
        .unwrap()
        .shutdown();
    assert_eq!(
        verdicts(devices(), |net| declare(net).complete()),
        [Right, Right, Extra]
    );
    let (_, wire, _) = line(devices());
    let whole = declare(Network::builder().link(wire)).expect(2, COUPLER);
    Rig::start(whole.complete()).unwrap().shutdown();
}

#[test]
fn an_alias_or_an_identity_means_one_device() {
    let twice = |positions: &[u16]| LineVerdict::NotUnique {
        positions: positions.to_vec(),
    };
    let devices = || [with_alias(7), personality::coupler(), with_alias(7)];
    assert_eq!(
        verdicts(devices(), |net| net
            .drive(DevicePlace::Alias(7), drive("x"))),
        [NotDeclared, NotDeclared, NotDeclared, twice(&[0, 2])]
    );
    assert_eq!(
        verdicts(devices(), |net| net.drive(AKD2G, drive("x"))),
        [NotDeclared, NotDeclared, NotDeclared, twice(&[0, 2])]
    );
    assert_eq!(
        verdicts([akd(0)], |net| net.drive(DevicePlace::Alias(8), drive("x"))),
        [NotDeclared, Missing]
    );
    // The alias of a device of another kind.
    assert_eq!(
        verdicts([with_alias(7)], |net| net
            .drive(DevicePlace::Alias(7), generic("x"))),
        [Different]
    );
}

#[test]
fn two_declarations_of_one_device_are_refused() {
    assert_eq!(
        verdicts([with_alias(7)], |net| net
            .drive(0, drive("x"))
            .drive(DevicePlace::Alias(7), drive("y"))),
        [Right, LineVerdict::DeclaredTwice]
    );
    // Also where one of them may be anything.
    let any = |axis| DriveConfig::new(drives::generic()).axis(axis);
    assert_eq!(
        verdicts([with_alias(7)], |net| net
            .drive(0, any("x"))
            .drive(DevicePlace::Alias(7), drive("y"))),
        [LineVerdict::DeclaredTwice, Right]
    );
    assert_eq!(
        verdicts([with_alias(7)], |net| net
            .drive(0, any("x"))
            .drive(DevicePlace::Alias(7), any("y"))),
        [Right, LineVerdict::DeclaredTwice]
    );
    for (declared, expected) in [
        (
            Network::builder().drive(3, drive("x")).expect(3, COUPLER),
            "two devices are declared at position 3",
        ),
        (
            Network::builder().drive(DevicePlace::Alias(0), drive("x")),
            "alias 0 is that of devices without one",
        ),
    ] {
        let error = Rig::start(declared).err().unwrap();
        assert!(
            matches!(&error, NetworkError::Declaration(text) if text == expected),
            "{error}"
        );
    }
}

#[test]
fn another_product_of_the_same_maker_is_accepted_as_the_message_says() {
    let other = || DriveConfig::new(akd2g_of(0x0041_4B44)).axis("x");
    let (line, wire, asked) = line([personality::akd2g()]);
    let error = Rig::start(Network::builder().link(wire).drive(0, other())).err();
    let text = error.unwrap().to_string();
    assert!(
        text.ends_with(
            "At position 0 is another product of the same maker. If it works as the expected one, accept it: set `product` of its \
             `DriveDescription`, or the product code of its `Expected`, to 0x414B4432"
        ),
        "{text}"
    );
    assert!(!asked.load(Ordering::Relaxed));
    let accepted = DriveConfig::new(akd2g_of(0x414B_4432)).axis("x");
    let rig = Rig::start(Network::builder().link(line.wire()).drive(0, accepted)).unwrap();
    rig.shutdown();
    // Without a demand any of the maker's is one.
    let rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive("x"))).unwrap();
    rig.shutdown();
}

/// An AKD2G of which this product code is demanded.
fn akd2g_of(product: u32) -> drives::DriveDescription {
    let mut description = drives::akd2g();
    assert_eq!(description.product, None, "no document states one");
    description.product = Some(product);
    description
}
