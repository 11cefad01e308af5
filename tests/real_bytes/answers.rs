//! The simulated drive asked what SOEM asked a real one, mail by mail.

use std::time::Duration;

use servocrab::sii::Sii;
use servocrab_sim::{
    Blueprint, Device, Direction, DriveBlueprint, PdoDescription, PdoEntryDescription, PdoLimits,
    ds402::Behaviour, personality,
};

use crate::datagrams::{APRD, APWR, Wire};
use crate::vectors::{akd_exchanges, object};

/// The mailboxes of the AKD and of the simulated AKD2G: both have 1024 bytes.
const MAILBOX_OUT: u16 = 0x1800;
const MAILBOX_IN: u16 = 0x1C00;
const MAILBOX_BYTES: usize = 1024;

/// A simulated drive with one axis and the PDOs that the AKD shows by CoE.
fn drive_with_the_akds_mapping() -> Device {
    let pdo = |index: u16, direction, objects: &[(u16, u8, u8)]| PdoDescription {
        index,
        direction,
        sync_manager: Some(if direction == Direction::Outputs {
            2
        } else {
            3
        }),
        fixed: false,
        entries: objects
            .iter()
            .map(|&(index, data_type, bits)| PdoEntryDescription {
                index,
                subindex: 0,
                data_type,
                bits,
            })
            .collect(),
    };
    let (controlword, statusword) = ((0x6040, 6, 16), (0x6041, 6, 16));
    let outputs = |index, objects: &[_]| pdo(index, Direction::Outputs, objects);
    let inputs = |index, objects: &[_]| pdo(index, Direction::Inputs, objects);
    let mut description = personality::akd2g().description().clone();
    description.pdos = vec![
        outputs(0x1600, &[controlword]),
        outputs(0x1601, &[controlword, (0x6060, 2, 8)]),
        outputs(0x1602, &[controlword, (0x607A, 4, 32)]),
        outputs(0x1603, &[controlword, (0x60FF, 4, 32)]),
        inputs(0x1A00, &[statusword]),
        inputs(0x1A01, &[statusword, (0x6061, 2, 8)]),
        inputs(0x1A02, &[statusword, (0x6064, 4, 32)]),
        inputs(0x1A03, &[statusword, (0x606C, 4, 32)]),
    ];
    Device::new(Blueprint {
        description,
        drive: Some(DriveBlueprint {
            axes: vec![Behaviour::akd2g()],
            axis_increment: 0x0800,
            status_object: None,
            note: None,
            limits: PdoLimits {
                bytes: 64,
                entries: 16,
                assigned: 4,
            },
            device_type: 0x0002_0192,
            assigned: None,
            saves: false,
            software_version: String::new(),
            hardware_version: String::new(),
        }),
        cycle: Duration::from_millis(1),
    })
}

/// A device in PREOP.
fn in_pre_op(device: Device) -> Wire {
    let wire = Wire::new(device);
    let sii = Sii::parse(&wire.sii_image()).unwrap();
    wire.pre_op(&sii.mailbox.unwrap());
    wire
}

/// Writes a mail as SOEM does, all bytes of the mailbox, waits for the answer, and gives the mailbox that was read.
fn ask(wire: &Wire, request: &[u8]) -> Vec<u8> {
    let mut mailbox = request.to_vec();
    mailbox.resize(MAILBOX_BYTES, 0);
    assert!(
        wire.datagram(APWR, MAILBOX_OUT, &mailbox).1,
        "mailbox is full"
    );
    for _ in 0..1_000 {
        // Sync manager 1's status, bit 3: full.
        if wire.read(0x080D, 1)[0] & 0x08 != 0 {
            let (mail, acted) = wire.datagram(APRD, MAILBOX_IN, &[0; MAILBOX_BYTES]);
            assert!(acted);
            return mail;
        }
    }
    panic!("no answer to {request:02X?}");
}

#[test]
fn a_simulated_drive_with_the_akds_mapping_answers_with_the_real_ones_bytes() {
    let wire = in_pre_op(drive_with_the_akds_mapping());
    for exchange in akd_exchanges() {
        let mut expected = exchange.reply.clone();
        expected.resize(MAILBOX_BYTES, 0);
        let answer = ask(&wire, &exchange.request);
        assert!(
            answer == expected,
            "{}: {:02X?} in place of {:02X?}",
            exchange.what,
            &answer[..16],
            exchange.reply
        );
    }
}

#[test]
fn the_simulated_akd2g_differs_from_the_real_akd_only_in_what_it_maps() {
    // Two axes, one PDO of each direction for each, with more in it; no PDOs at the AKD's other indices.
    const NO_OBJECT: [u8; 4] = [0x00, 0x00, 0x02, 0x06];
    let other_value: [((u16, u8), [u8; 4]); 6] = [
        ((0x1C12, 0), [2, 0, 0, 0]),
        ((0x1C12, 2), [0x10, 0x16, 0, 0]),
        ((0x1600, 0), [6, 0, 0, 0]),
        ((0x1C13, 0), [2, 0, 0, 0]),
        ((0x1C13, 2), [0x10, 0x1A, 0, 0]),
        ((0x1A00, 0), [4, 0, 0, 0]),
    ];
    let wire = in_pre_op(personality::akd2g());
    let mut differing = 0;
    for exchange in akd_exchanges() {
        let (index, subindex) = object(exchange.what);
        let mut expected = exchange.reply.clone();
        if matches!(index, 0x1601..=0x1603 | 0x1A01..=0x1A03) {
            // An abort is an SDO request by its service, in the same mail.
            expected[7] = 0x20;
            expected[8] = 0x80;
            expected[12..16].copy_from_slice(&NO_OBJECT);
        } else if matches!(index, 0x1C12 | 0x1C13) && subindex > 2 {
            expected[7] = 0x20;
            expected[8] = 0x80;
            expected[12..16].copy_from_slice(&[0x11, 0x00, 0x09, 0x06]);
        } else if let Some((_, value)) = other_value
            .iter()
            .find(|(address, _)| *address == (index, subindex))
        {
            expected[12..16].copy_from_slice(value);
        }
        differing += usize::from(expected != exchange.reply);
        assert_eq!(
            ask(&wire, &exchange.request)[..16],
            expected,
            "{}",
            exchange.what
        );
    }
    assert_eq!(differing, 28);
}
