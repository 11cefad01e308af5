//! Which changes of the PDO mapping and assignment the drive takes, and what it answers to the others.

use servocrab_sim::{EsiDrive, Segment, personality};

use crate::master::Master;

const IN_PRESENT_STATE: u32 = 0x0800_0022;
const LOCKED: u32 = 0x0601_0003;
const NO_OBJECT: u32 = 0x0602_0000;
const NO_SUBINDEX: u32 = 0x0609_0011;
const NOT_MAPPABLE: u32 = 0x0604_0041;
const TOO_LONG: u32 = 0x0604_0042;
const INCOMPATIBLE: u32 = 0x0604_0043;
const LENGTH: u32 = 0x0607_0010;
const RANGE: u32 = 0x0609_0030;

fn preop() -> Master {
    let mut master = Master::new(Segment::new().with(personality::akd2g()));
    master.bring_to_preop();
    master
}

/// A drive of which both assignments and the PDOs of axis 1 are empty.
fn emptied() -> Master {
    let mut master = preop();
    for index in [0x1C12, 0x1C13, 0x1600, 0x1A00] {
        assert_eq!(master.download(index, 0, &[0]), Ok(()), "{index:04X}h");
    }
    master
}

/// Mapping entry: index, subindex, bits.
fn entry(index: u16, subindex: u8, bits: u8) -> [u8; 4] {
    (u32::from(index) << 16 | u32::from(subindex) << 8 | u32::from(bits)).to_le_bytes()
}

#[test]
fn the_mapping_at_power_up_is_the_one_of_the_table() {
    let mut master = preop();
    let expected: [(u16, &[(u16, u8)]); 4] = [
        (
            0x1600,
            &[
                (0x6040, 16),
                (0x6060, 8),
                (0x607A, 32),
                (0x6081, 32),
                (0x6083, 32),
                (0x6084, 32),
            ],
        ),
        (
            0x1610,
            &[
                (0x6840, 16),
                (0x6860, 8),
                (0x687A, 32),
                (0x6881, 32),
                (0x6883, 32),
                (0x6884, 32),
            ],
        ),
        (
            0x1A00,
            &[(0x6041, 16), (0x6061, 8), (0x6064, 32), (0x606C, 32)],
        ),
        (
            0x1A10,
            &[(0x6841, 16), (0x6861, 8), (0x6864, 32), (0x686C, 32)],
        ),
    ];
    for (pdo, objects) in expected {
        assert_eq!(master.upload(pdo, 0), Ok(vec![objects.len() as u8]));
        for (subindex, (index, bits)) in (1..).zip(objects) {
            assert_eq!(
                master.upload(pdo, subindex),
                Ok(entry(*index, 0, *bits).to_vec())
            );
        }
    }
    assert_eq!(master.upload(0x1C12, 0), Ok(vec![2]));
    assert_eq!(master.upload(0x1C12, 2), Ok(vec![0x10, 0x16]));
    assert_eq!(master.upload(0x1C13, 2), Ok(vec![0x10, 0x1A]));
}

#[test]
fn a_mapping_written_by_the_rules_becomes_the_process_data() {
    let mut master = emptied();
    assert_eq!(master.download(0x1600, 1, &entry(0x6040, 0, 16)), Ok(()));
    assert_eq!(master.download(0x1600, 2, &entry(0x607A, 0, 32)), Ok(()));
    assert_eq!(master.download(0x1600, 0, &[2]), Ok(()));
    assert_eq!(master.download(0x1A00, 1, &entry(0x5000, 4, 32)), Ok(()));
    assert_eq!(master.download(0x1A00, 2, &entry(0x605A, 0, 16)), Ok(()));
    assert_eq!(master.download(0x1A00, 0, &[2]), Ok(()));
    assert_eq!(master.download(0x1C12, 1, &[0x00, 0x16]), Ok(()));
    assert_eq!(master.download(0x1C12, 0, &[1]), Ok(()));
    assert_eq!(master.download(0x1C13, 1, &[0x00, 0x1A]), Ok(()));
    assert_eq!(master.download(0x1C13, 0, &[1]), Ok(()));
    master.sync_manager(0x1001, 2, 0x1100, 6, 0x24);
    master.sync_manager(0x1001, 3, 0x1140, 6, 0x20);
    assert_eq!(master.request(0x1001, 4), (4, 0));
    master.write(0x1001, 0x1100, &[0, 0, 0x78, 0x56, 0x34, 0x12]);
    assert_eq!(master.request(0x1001, 8), (8, 0));
    master.now += core::time::Duration::from_millis(2);
    let quick_stop_option = master.upload(0x605A, 0).unwrap();
    assert_eq!(master.read::<6>(0x1001, 0x1140)[4..], quick_stop_option);
    assert_eq!(
        master.segment.axis(0, 0).unwrap().get(0x607A, 0),
        Some(0x1234_5678)
    );
}

#[test]
fn each_wrong_entry_is_refused_with_its_reason() {
    let mut master = emptied();
    let cases: [(u16, [u8; 4], u32); 8] = [
        (0x1600, entry(0x2345, 0, 16), NO_OBJECT),
        (0x1600, entry(0x6040, 1, 16), NO_SUBINDEX),
        (0x1600, entry(0x6041, 0, 16), NOT_MAPPABLE),
        (0x1A00, entry(0x607A, 0, 32), NOT_MAPPABLE),
        (0x1600, entry(0x605B, 0, 16), NOT_MAPPABLE),
        (0x1600, entry(0x5000, 4, 32), NOT_MAPPABLE),
        (0x1600, entry(0x6040, 0, 32), LENGTH),
        (0x1600, entry(0x1000, 0, 32), NOT_MAPPABLE),
    ];
    for (pdo, value, expected) in cases {
        assert_eq!(
            master.download(pdo, 1, &value),
            Err(expected),
            "{pdo:04X}h {value:02X?}"
        );
    }
}

#[test]
fn a_list_is_locked_until_its_subindex_0_is_zero() {
    let mut master = preop();
    assert_eq!(master.download(0x1C12, 1, &[0x00, 0x16]), Err(LOCKED));
    assert_eq!(master.download(0x1C12, 0, &[0]), Ok(()));
    assert_eq!(
        master.download(0x1600, 1, &entry(0x6040, 0, 16)),
        Err(LOCKED)
    );
}

#[test]
fn a_pdo_that_is_assigned_cannot_be_remapped() {
    let mut master = preop();
    assert_eq!(master.download(0x1600, 0, &[0]), Err(IN_PRESENT_STATE));
}

#[test]
fn nothing_is_remapped_outside_preop() {
    let mut master = preop();
    master.bring_to_op(0x24);
    for state in [8, 4] {
        assert_eq!(master.request(0x1001, state), (u16::from(state), 0));
        assert_eq!(master.download(0x1C12, 0, &[0]), Err(IN_PRESENT_STATE));
        assert_eq!(master.download(0x1A00, 0, &[0]), Err(IN_PRESENT_STATE));
    }
}

#[test]
fn only_pdos_that_exist_in_that_direction_are_assigned() {
    let mut master = emptied();
    assert_eq!(master.download(0x1C12, 1, &[0x05, 0x16]), Err(RANGE));
    assert_eq!(master.download(0x1C12, 1, &[0x00, 0x1A]), Err(RANGE));
    assert_eq!(master.download(0x1C12, 3, &[0x00, 0x16]), Err(NO_SUBINDEX));
    assert_eq!(master.download(0x1C12, 0, &[3]), Err(RANGE));
}

#[test]
fn an_entry_that_was_cleared_cannot_be_switched_on() {
    let mut master = emptied();
    assert_eq!(master.download(0x1600, 2, &[0; 4]), Ok(()));
    assert_eq!(master.download(0x1600, 0, &[1]), Ok(()));
    assert_eq!(master.download(0x1600, 0, &[0]), Ok(()));
    assert_eq!(master.download(0x1600, 0, &[2]), Err(INCOMPATIBLE));
    assert_eq!(master.download(0x1600, 0, &[17]), Err(TOO_LONG));
}

#[test]
fn no_more_than_64_bytes_go_in_one_direction() {
    let mut master = emptied();
    // Twelve objects of 4 bytes in 1600h and 19 bytes in 1610h: 67 bytes.
    for subindex in 1..=12 {
        assert_eq!(
            master.download(0x1600, subindex, &entry(0x607A, 0, 32)),
            Ok(())
        );
    }
    assert_eq!(master.download(0x1600, 0, &[12]), Ok(()));
    assert_eq!(master.download(0x1C12, 0, &[2]), Err(TOO_LONG));
    assert_eq!(master.upload(0x1C12, 0), Ok(vec![0]));
    assert_eq!(master.download(0x1C12, 0, &[1]), Ok(()));
}

#[test]
fn a_power_failure_brings_the_mapping_at_power_up_back() {
    let mut master = emptied();
    let now = master.now;
    let device = master.segment.device_mut(0).unwrap();
    device.power_off();
    device.power_on(now);
    master.bring_to_preop();
    assert_eq!(master.upload(0x1600, 0), Ok(vec![6]));
}

#[test]
fn what_excludes_each_other_or_leaves_a_mandatory_pdo_out_is_not_assigned() {
    // Of the plain drive 1600h excludes 1601h, and 1602h is mandatory.
    let text = include_str!("../../esi/generic.xml")
        .replace(
            "<Index>#x1600</Index><Name>RxPdo",
            "<Index>#x1600</Index><Exclude>#x1601</Exclude><Name>RxPdo",
        )
        .replace(
            "<RxPdo Fixed=\"0\"><Index>#x1602",
            "<RxPdo Fixed=\"0\" Mandatory=\"1\"><Index>#x1602",
        );
    let drive = EsiDrive::from_bytes("generic.xml", text.as_bytes()).unwrap();
    let mut master = Master::of(drive.build());
    master.bring_to_preop();
    for (pdos, answer) in [
        (&[0x1602][..], Ok(())),
        (&[0x1600, 0x1602], Ok(())),
        (&[0x1602, 0x1601], Ok(())),
        // Only one of the two names the other.
        (&[0x1600, 0x1601, 0x1602], Err(INCOMPATIBLE)),
        (&[0x1601, 0x1602, 0x1600], Err(INCOMPATIBLE)),
        (&[0x1601, 0x1603], Err(INCOMPATIBLE)),
        (&[], Ok(())),
    ] {
        assert_eq!(master.download(0x1C12, 0, &[0]), Ok(()));
        for (subindex, pdo) in (1..).zip(pdos) {
            let pdo = u16::to_le_bytes(*pdo);
            assert_eq!(master.download(0x1C12, subindex, &pdo), Ok(()));
        }
        let count = [pdos.len() as u8];
        assert_eq!(master.download(0x1C12, 0, &count), answer, "{pdos:04X?}");
    }
}
