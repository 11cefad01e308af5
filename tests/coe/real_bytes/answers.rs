//! The simulated drive asked what SOEM asked a real one, message by message.

use std::time::Duration;

use servocrab_sim::{
    Blueprint, Device, Direction, DriveBlueprint, PdoDescription, PdoEntryDescription, PdoLimits,
    ds402::Behaviour, personality,
};

use super::drive::Drive;
use super::vectors::{akd_exchanges, object, pp_drive_exchanges, simulated_exchanges};

/// Of the AKD and of the simulated AKD2G.
const MAILBOX_BYTES: usize = 1024;

/// A simulated drive with one axis and the PDOs that the AKD shows by CoE.
fn drive_with_the_akds_mapping() -> Device {
    let pdo = |index: u16, direction, objects: &[(u16, u8, u8)]| PdoDescription {
        index,
        name: "",
        direction,
        sync_manager: Some(if direction == Direction::Outputs {
            2
        } else {
            3
        }),
        fixed: false,
        mandatory: false,
        excludes: Vec::new(),
        entries: objects
            .iter()
            .map(|&(index, data_type, bits)| PdoEntryDescription {
                index,
                subindex: 0,
                name: "",
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
            diagnosis: None,
            status_object: None,
            note: None,
            limits: PdoLimits {
                bytes: 64,
                entries: 16,
                assigned: 4,
            },
            device_type: 0x0002_0192,
            assigned: None,
            pdo_habits: Vec::new(),
            objects: Vec::new(),
            shows_only_these: false,
            saves: false,
            software_version: String::new(),
            hardware_version: String::new(),
        }),
        cycle: Duration::from_millis(1),
    })
}

#[test]
fn a_simulated_drive_with_the_akds_mapping_answers_with_the_real_ones_bytes() {
    let drive = Drive::new(drive_with_the_akds_mapping());
    for exchange in akd_exchanges() {
        let mut expected = exchange.reply.clone();
        expected.resize(MAILBOX_BYTES, 0);
        let answer = drive.ask(&exchange.request);
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
    let drive = Drive::new(personality::akd2g());
    let mut differing = 0;
    for exchange in akd_exchanges() {
        let (index, subindex) = object(exchange.what);
        let mut expected = exchange.reply.clone();
        if matches!(index, 0x1601..=0x1603 | 0x1A01..=0x1A03) {
            // An abort is an SDO request by its service, in the same message.
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
            drive.ask(&exchange.request)[..16],
            expected,
            "{}",
            exchange.what
        );
    }
    assert_eq!(differing, 28);
}

/// The simulated AKD2G with all of CoE, and short mailboxes.
fn talkative() -> Device {
    personality::Servo::akd2g()
        .with_sdo_information()
        .with_complete_access()
        .mailbox_bytes(128)
        .build()
}

#[test]
fn the_simulated_akd2g_answers_soems_requests_of_every_kind_with_the_stated_bytes() {
    let drive = Drive::new(talkative());
    let exchanges = simulated_exchanges();
    for exchange in &exchanges {
        let answer = drive.ask(&exchange.request);
        let (message, behind) = answer.split_at(exchange.reply.len());
        assert_eq!(message, exchange.reply, "{}", exchange.what);
        assert!(behind.iter().all(|byte| *byte == 0), "{}", exchange.what);
    }
    assert_eq!(exchanges.len(), 30);
}

#[test]
fn those_answers_have_the_structure_of_another_slaves() {
    // CoE service, and the SDO's command specifier or the operation of SDO information.
    let structure = |message: &[u8]| match message[7] >> 4 {
        8 => (8, message[8]),
        service => (service, message[8] >> 5),
    };
    let theirs = pp_drive_exchanges();
    let mut compared = 0;
    for exchange in simulated_exchanges() {
        let what = exchange.what.replace("5F00h", "2001h");
        let mut same = theirs.iter().filter(|row| {
            row.what == what
                && row.request[8] == exchange.request[8]
                && row.request.len() == exchange.request.len()
        });
        let theirs = same.next().expect("SOEM has asked that");
        assert_eq!(
            structure(&exchange.reply),
            structure(&theirs.reply),
            "{what}"
        );
        // Station address 0, channel 0, protocol CoE.
        assert_eq!(exchange.reply[2..5], [0; 3]);
        assert_eq!(exchange.reply[5] & 0x0F, 3);
        compared += 1;
    }
    assert_eq!(compared, 30);
}

#[test]
fn the_list_of_objects_comes_in_as_many_messages_as_it_needs() {
    let objects = Drive::new(talkative()).objects();
    assert!(objects.is_sorted());
    for object in [
        0x1000, 0x1018, 0x1600, 0x1A10, 0x1C12, 0x6040, 0x607A, 0x6840, 0x687A,
    ] {
        assert!(objects.contains(&object), "{object:04X}h");
    }
}
