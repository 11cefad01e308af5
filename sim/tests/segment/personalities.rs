//! The drives of the documents on the wire: who they say they are, what can be read, written and mapped, and a move of each.

use servocrab_sim::ds402::Outcome;
use servocrab_sim::personality::{self, Servo};
use servocrab_sim::{Device, Direction};

use crate::master::Master;

const NOT_SAVED: u32 = 0x0800_0020;
const READ_ONLY: u32 = 0x0601_0002;
const NO_OBJECT: u32 = 0x0602_0000;
const NOT_MAPPABLE: u32 = 0x0604_0041;
const NO_SUBINDEX: u32 = 0x0609_0011;
const RANGE: u32 = 0x0609_0030;

/// The drives with one axis: vendor, product, device type, and what lies in the process data at power-up.
struct Expected {
    drive: fn() -> Device,
    vendor: u32,
    product: u32,
    device_type: u32,
    outputs: (u16, &'static [(u16, u8)]),
    inputs: (u16, &'static [(u16, u8)]),
}

const PROFILE: &[(u16, u8)] = &[
    (0x6040, 16),
    (0x6060, 8),
    (0x607A, 32),
    (0x6081, 32),
    (0x6083, 32),
    (0x6084, 32),
];
const ACTUAL: &[(u16, u8)] = &[(0x6041, 16), (0x6061, 8), (0x6064, 32), (0x606C, 32)];

const DRIVES: [Expected; 4] = [
    Expected {
        drive: personality::pp2010,
        vendor: 0,
        product: 0x5050_2010,
        device_type: 0x0004_0192,
        outputs: (0x1600, PROFILE),
        inputs: (0x1A00, &[(0x6041, 16), (0x6061, 8), (0x6064, 32)]),
    },
    Expected {
        drive: personality::ax2000,
        vendor: 2,
        product: 0x4158_2000,
        device_type: 0x0002_0192,
        outputs: (0x1600, PROFILE),
        inputs: (0x1A00, ACTUAL),
    },
    Expected {
        drive: personality::sigma7,
        vendor: 0x539,
        product: 0x5347_4437,
        device_type: 0x0002_0192,
        outputs: (0x1601, &[(0x6040, 16), (0x607A, 32)]),
        inputs: (0x1A01, &[(0x6041, 16), (0x6064, 32)]),
    },
    Expected {
        drive: personality::generic,
        vendor: 0,
        product: 0x4453_0402,
        device_type: 0x0002_0192,
        outputs: (0x1600, PROFILE),
        inputs: (0x1A00, ACTUAL),
    },
];

fn preop(drive: Device) -> Master {
    let mut master = Master::of(drive);
    master.bring_to_preop();
    master
}

fn number(master: &mut Master, index: u16, subindex: u8) -> i64 {
    let bytes = master.upload(index, subindex).expect("it can be read");
    let unsigned = bytes
        .iter()
        .rev()
        .fold(0, |n, byte| n << 8 | i64::from(*byte));
    let top = 1 << (8 * bytes.len() - 1);
    // Read as signed: all objects that are asked for here are.
    if unsigned & top == 0 {
        unsigned
    } else {
        unsigned - 2 * top
    }
}

/// Mapping entry: index, subindex, bits.
fn entry(index: u16, subindex: u8, bits: u8) -> [u8; 4] {
    (u32::from(index) << 16 | u32::from(subindex) << 8 | u32::from(bits)).to_le_bytes()
}

/// A double word of the SII.
fn sii(master: &mut Master, word: u8) -> u32 {
    // It is the device's own in PREOP.
    master.write(0x1001, 0x0500, &[0]);
    master.write(0x1001, 0x0502, &[0x00, 0x01, word, 0, 0, 0]);
    u32::from_le_bytes(master.read::<4>(0x1001, 0x0508))
}

#[test]
fn every_drive_says_in_the_sii_and_by_coe_who_it_is() {
    for expected in DRIVES {
        let mut master = preop((expected.drive)());
        let identity = [expected.vendor, expected.product];
        assert_eq!([sii(&mut master, 0x08), sii(&mut master, 0x0A)], identity);
        for (subindex, value) in (1..).zip(identity) {
            assert_eq!(
                master.upload(0x1018, subindex),
                Ok(value.to_le_bytes().to_vec())
            );
        }
        assert_eq!(
            master.upload(0x1000, 0),
            Ok(expected.device_type.to_le_bytes().to_vec())
        );
        let name = (expected.drive)().description().name.clone();
        assert_eq!(master.upload(0x1008, 0), Ok(name.into_bytes()));
    }
}

#[test]
fn every_drive_has_its_own_mapping_at_power_up() {
    for expected in DRIVES {
        let mut master = preop((expected.drive)());
        for (assignment, (pdo, objects)) in [(0x1C12, expected.outputs), (0x1C13, expected.inputs)]
        {
            assert_eq!(master.upload(assignment, 0), Ok(vec![1]));
            assert_eq!(master.upload(assignment, 1), Ok(pdo.to_le_bytes().to_vec()));
            assert_eq!(master.upload(pdo, 0), Ok(vec![objects.len() as u8]));
            for (subindex, (index, bits)) in (1..).zip(objects) {
                assert_eq!(
                    master.upload(pdo, subindex),
                    Ok(entry(*index, 0, *bits).to_vec())
                );
            }
        }
    }
}

#[test]
fn the_process_data_sync_managers_are_as_long_as_the_mapping_of_the_sii() {
    for expected in DRIVES {
        let drive = (expected.drive)();
        let description = drive.description();
        let bytes =
            |objects: &[(u16, u8)]| objects.iter().map(|(_, bits)| usize::from(bits / 8)).sum();
        let (outputs, inputs): (usize, usize) =
            (bytes(expected.outputs.1), bytes(expected.inputs.1));
        assert_eq!(description.process_data_bytes(Direction::Outputs), outputs);
        assert_eq!(description.process_data_bytes(Direction::Inputs), inputs);
        let lengths: Vec<usize> = description.sync_managers[2..]
            .iter()
            .map(|sync_manager| sync_manager.length.into())
            .collect();
        assert_eq!(lengths, [outputs, inputs]);
    }
}

#[test]
fn every_drive_is_enabled_and_moved_over_the_wire() {
    for expected in DRIVES {
        let mut master = preop((expected.drive)());
        for (index, value) in [
            (0x6081, 100_000_u32),
            (0x6083, 1_000_000),
            (0x6084, 1_000_000),
        ] {
            assert_eq!(master.download(index, 0, &value.to_le_bytes()), Ok(()));
        }
        // PDOs that all have; the mode goes by SDO.
        for (assignment, pdo, objects) in [
            (0x1C12_u16, expected.outputs.0, [(0x6040, 16), (0x607A, 32)]),
            (0x1C13, expected.inputs.0, [(0x6041, 16), (0x6064, 32)]),
        ] {
            assert_eq!(master.download(assignment, 0, &[0]), Ok(()));
            assert_eq!(master.download(pdo, 0, &[0]), Ok(()));
            for (subindex, (index, bits)) in (1..).zip(objects) {
                assert_eq!(
                    master.download(pdo, subindex, &entry(index, 0, bits)),
                    Ok(())
                );
            }
            assert_eq!(master.download(pdo, 0, &[2]), Ok(()));
            assert_eq!(master.download(assignment, 1, &pdo.to_le_bytes()), Ok(()));
            assert_eq!(master.download(assignment, 0, &[1]), Ok(()));
        }
        master.lengths = (6, 6);
        assert_eq!(master.download(0x6060, 0, &[1]), Ok(()));
        master.bring_to_op(0x24);
        for (word, cycles) in [(0x06, 5), (0x07, 5), (0x0F, 5), (0x1F, 500)] {
            let mut outputs = vec![word, 0];
            outputs.extend(5_000_i32.to_le_bytes());
            for _ in 0..cycles {
                master.cycle(&outputs);
            }
        }
        let inputs = master.cycle(&[0x0F, 0, 0, 0, 0, 0]);
        assert_eq!(inputs[2..], 5_000_i32.to_le_bytes());
        assert_eq!(inputs[1] & 0x04, 0x04, "target reached");
        let axis = master.segment.axis(0, 0).expect("an axis");
        assert_eq!(axis.ledger().len(), 1);
        assert_eq!(axis.ledger()[0].outcome, Outcome::Reached);
    }
}

/// The page on profile position mode, table of related objects: index, bytes, written to or not, mandatory or not.
#[test]
fn the_objects_of_the_drive_with_2010h_are_those_of_its_table() {
    let table: [(u16, usize, bool); 17] = [
        (0x6040, 2, true),
        (0x6041, 2, false),
        (0x6062, 4, false),
        (0x6063, 4, false),
        (0x6064, 4, false),
        (0x6065, 4, true),
        (0x6066, 2, true),
        (0x6067, 4, true),
        (0x6068, 2, true),
        (0x607A, 4, true),
        (0x6081, 4, true),
        (0x6083, 4, true),
        (0x6084, 4, true),
        (0x6085, 4, true),
        (0x6086, 2, true),
        (0x60F4, 4, false),
        (0x2010, 2, true),
    ];
    let mut master = preop(personality::pp2010());
    for (index, bytes, writable) in table {
        let value = master.upload(index, 0).expect("it exists");
        assert_eq!(value.len(), bytes, "{index:04X}h");
        let written = master.download(index, 0, &value);
        let expected = if writable { Ok(()) } else { Err(READ_ONLY) };
        assert_eq!(written, expected, "{index:04X}h");
    }
    for index in [0x607D, 0x607F, 0x6082, 0x60C5, 0x60F2] {
        assert_eq!(master.upload(index, 0), Err(NO_OBJECT), "{index:04X}h");
    }
}

/// The same page: only linear ramps, yet 6086h is mandatory. A value that it does not support is out of range.
#[test]
fn the_drive_with_2010h_has_6086h_and_takes_linear_ramps_only() {
    let mut master = preop(personality::pp2010());
    assert_eq!(master.download(0x6086, 0, &0_i16.to_le_bytes()), Ok(()));
    for other in [-1_i16, 1, 2, 3] {
        assert_eq!(
            master.download(0x6086, 0, &other.to_le_bytes()),
            Err(RANGE),
            "{other}"
        );
    }
    assert_eq!(master.upload(0x6086, 0), Ok(vec![0, 0]));
}

/// AX2000 manual, page 101, table of profile codes.
#[test]
fn the_ax2000_takes_linear_and_sin2_ramps_and_nothing_else() {
    let mut master = preop(personality::ax2000());
    for (code, answer) in [
        (0_i16, Ok(())),
        (1, Ok(())),
        (2, Err(RANGE)),
        (i16::MAX, Err(RANGE)),
        (-1, Err(RANGE)),
        (i16::MIN, Err(RANGE)),
    ] {
        assert_eq!(
            master.download(0x6086, 0, &code.to_le_bytes()),
            answer,
            "{code}"
        );
    }
    assert_eq!(number(&mut master, 0x6086, 0), 1);
}

#[test]
fn the_ax2000_has_the_factors_of_version_2_and_a_symmetrical_target_range() {
    let mut master = preop(personality::ax2000());
    for index in [0x6093, 0x6094, 0x6097] {
        assert_eq!(master.upload(index, 0), Ok(vec![2]));
        assert_eq!(number(&mut master, index, 1), 1);
    }
    for index in [0x608F, 0x6091, 0x6092, 0x6096, 0x60F2] {
        assert_eq!(master.upload(index, 0), Err(NO_OBJECT), "{index:04X}h");
    }
    let mut target = |value: i32| master.download(0x607A, 0, &value.to_le_bytes());
    assert_eq!(target(i32::MIN), Err(RANGE));
    assert_eq!(target(-i32::MAX), Ok(()));
    assert_eq!(target(i32::MAX), Ok(()));
}

/// Sigma-7, the tables of 607Ah, 607Dh and 607Fh: access, PDO mapping, range, default.
#[test]
fn the_objects_of_the_sigma7_have_the_ranges_and_defaults_of_its_page() {
    let mut master = preop(personality::sigma7());
    assert_eq!(number(&mut master, 0x607A, 0), 0);
    for value in [i32::MIN, i32::MAX] {
        assert_eq!(master.download(0x607A, 0, &value.to_le_bytes()), Ok(()));
    }
    assert_eq!(master.upload(0x607D, 0), Ok(vec![2]));
    assert_eq!(master.download(0x607D, 0, &[2]), Err(READ_ONLY));
    for subindex in [1, 2] {
        assert_eq!(number(&mut master, 0x607D, subindex), 0);
        for (value, answer) in [
            (-536_870_913, Err(RANGE)),
            (-536_870_912, Ok(())),
            (536_870_911, Ok(())),
            (536_870_912_i32, Err(RANGE)),
        ] {
            let written = master.download(0x607D, subindex, &value.to_le_bytes());
            assert_eq!(written, answer, "607Dh:{subindex} = {value}");
        }
    }
    assert_eq!(
        master.upload(0x607F, 0),
        Ok(2_147_483_647_u32.to_le_bytes().to_vec())
    );
    for value in [0, u32::MAX] {
        assert_eq!(master.download(0x607F, 0, &value.to_le_bytes()), Ok(()));
    }
}

#[test]
fn the_sigma7_maps_607ah_and_607fh_and_not_607dh() {
    let mut master = preop(personality::sigma7());
    assert_eq!(master.download(0x1600, 0, &[0]), Ok(()));
    let mut map = |entry: [u8; 4]| master.download(0x1600, 1, &entry);
    assert_eq!(map(entry(0x607A, 0, 32)), Ok(()));
    assert_eq!(map(entry(0x607F, 0, 32)), Ok(()));
    assert_eq!(map(entry(0x607D, 1, 32)), Err(NOT_MAPPABLE));
    assert_eq!(map(entry(0x607D, 2, 32)), Err(NOT_MAPPABLE));
}

/// Its maker's answers to users: 1600h to 1603h and 1A00h to 1A03h, eight objects each, two on a sync manager.
#[test]
fn the_sigma7_takes_eight_objects_in_a_pdo_and_two_pdos_on_a_sync_manager() {
    let mut master = preop(personality::sigma7());
    for (first, assignment) in [(0x1600_u16, 0x1C12), (0x1A00, 0x1C13)] {
        assert_eq!(master.download(assignment, 0, &[0]), Ok(()));
        for pdo in first..first + 4 {
            assert!(master.upload(pdo, 8).is_ok());
            assert_eq!(master.upload(pdo, 9), Err(NO_SUBINDEX));
            assert_eq!(master.download(assignment, 1, &pdo.to_le_bytes()), Ok(()));
        }
        assert_eq!(master.upload(first + 4, 0), Err(NO_OBJECT));
        assert_eq!(master.download(assignment, 2, &first.to_le_bytes()), Ok(()));
        let third = (first + 2).to_le_bytes();
        assert_eq!(master.download(assignment, 3, &third), Err(NO_SUBINDEX));
        assert_eq!(master.download(assignment, 0, &[2]), Ok(()));
        assert_eq!(master.download(assignment, 0, &[3]), Err(RANGE));
    }
}

#[test]
fn what_was_saved_outlives_a_power_failure_and_nothing_else_does() {
    let save = |master: &mut Master, signature: &[u8; 4]| master.download(0x1010, 1, signature);
    let limit = 4321_i32.to_le_bytes();
    for saved in [false, true] {
        let mut master = preop(personality::sigma7());
        assert_eq!(master.upload(0x1010, 1), Ok(vec![1, 0, 0, 0]));
        assert_eq!(master.download(0x607D, 2, &limit), Ok(()));
        assert_eq!(master.download(0x607F, 0, &limit), Ok(()));
        assert_eq!(master.download(0x607A, 0, &limit), Ok(()));
        let signature = if saved { b"save" } else { b"evas" };
        let answer = if saved { Ok(()) } else { Err(NOT_SAVED) };
        assert_eq!(save(&mut master, signature), answer);
        let now = master.now;
        let device = master.segment.device_mut(0).expect("a drive");
        device.power_off();
        device.power_on(now);
        master.bring_to_preop();
        let kept = if saved { 4321 } else { 0 };
        assert_eq!(number(&mut master, 0x607D, 2), kept);
        assert_eq!(
            number(&mut master, 0x607F, 0),
            if saved { 4321 } else { 0x7FFF_FFFF }
        );
        assert_eq!(number(&mut master, 0x607A, 0), 0);
    }
    for drive in [
        personality::generic(),
        personality::akd2g(),
        personality::pp2010(),
    ] {
        assert_eq!(save(&mut preop(drive), b"save"), Err(NO_OBJECT));
    }
    let mut ax2000 = preop(personality::ax2000());
    assert_eq!(ax2000.download(0x6086, 0, &[1, 0]), Ok(()));
    assert_eq!(save(&mut ax2000, b"save"), Ok(()));
}

#[test]
fn a_builder_gives_absolute_encoders_and_modulo_axes() {
    let drive = Servo::sigma7().absolute_encoder().modulo(0, 3599).build();
    let axis = drive.axis(0).expect("an axis");
    assert!(axis.is_referenced());
    assert_eq!(
        (axis.get(0x607B, 1), axis.get(0x607B, 2)),
        (Some(0), Some(3599))
    );
    let plain = Servo::sigma7().build();
    assert!(!plain.axis(0).expect("an axis").is_referenced());
}

#[test]
fn a_builder_changes_identity_serial_and_behaviour_of_every_drive() {
    let builders: [fn() -> Servo; 5] = [
        Servo::akd2g,
        Servo::pp2010,
        Servo::ax2000,
        Servo::sigma7,
        Servo::generic,
    ];
    for builder in builders {
        let drive = builder()
            .serial(77)
            .change(|behaviour| behaviour.power_on_cycles = 9);
        let drive = drive.build();
        assert_eq!(drive.description().identity.serial, 77);
        assert_eq!(
            usize::from(drive.description().ds402_channels),
            drive.axes().len()
        );
    }
}
