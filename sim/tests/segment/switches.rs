//! What drives elsewhere do on the wire, as switches of the builder.

use servocrab_sim::personality::Servo;
use servocrab_sim::{Device, Direction};

use crate::master::{Master, request};

const READ_ONLY: u32 = 0x0601_0002;
const NO_OBJECT: u32 = 0x0602_0000;
const NO_SUBINDEX: u32 = 0x0609_0011;

fn preop(drive: Device) -> Master {
    let mut master = Master::of(drive);
    master.bring_to_preop();
    master
}

#[test]
fn fixed_mappings_are_read_and_refuse_every_write_but_can_be_chosen_among() {
    let mut master = preop(Servo::generic().fixed_mapping().build());
    assert_eq!(master.download(0x1C12, 0, &[0]), Ok(()));
    assert_eq!(master.download(0x1600, 0, &[0]), Err(READ_ONLY));
    assert_eq!(master.download(0x1601, 0, &[0]), Err(READ_ONLY));
    assert_eq!(master.download(0x1601, 1, &[0; 4]), Err(READ_ONLY));
    assert_eq!(master.upload(0x1601, 0), Ok(vec![2]));
    assert_eq!(master.download(0x1C12, 1, &[0x01, 0x16]), Ok(()));
    assert_eq!(master.download(0x1C12, 0, &[1]), Ok(()));
    master.lengths.0 = 6;
    master.bring_to_op(0x24);
    master.cycle(&[0, 0, 0x78, 0x56, 0x34, 0x12]);
    master.cycle(&[0, 0, 0x78, 0x56, 0x34, 0x12]);
    let axis = master.segment.axis(0, 0).expect("an axis");
    assert_eq!(axis.get(0x607A, 0), Some(0x1234_5678));
}

/// Pitfall 37: the SII says one thing, the object dictionary at power-up another.
#[test]
fn the_assignment_at_power_up_can_differ_from_the_sii() {
    let drive = Servo::generic()
        .assigned_at_power_up(&[0x1601, 0x1A01])
        .build();
    assert_eq!(
        drive.description().process_data_bytes(Direction::Outputs),
        19
    );
    let mut master = preop(drive);
    assert_eq!(master.upload(0x1C12, 1), Ok(vec![0x01, 0x16]));
    assert_eq!(master.upload(0x1C13, 1), Ok(vec![0x01, 0x1A]));
    master.sync_manager(0x1001, 2, 0x1400, 19, 0x24);
    master.sync_manager(0x1001, 3, 0x1800, 11, 0x20);
    assert_eq!(
        master.request(0x1001, 4),
        (0x12, 0x001D),
        "the SII's length is wrong"
    );
    let mut master = preop(
        Servo::generic()
            .assigned_at_power_up(&[0x1601, 0x1A01])
            .build(),
    );
    master.lengths = (6, 6);
    master.bring_to_op(0x24);
}

#[test]
fn a_second_axis_has_its_pdos_10h_or_1_further() {
    for (increment, second, none) in [(0x10, 0x1610_u16, 0x1601_u16), (1, 0x1601, 0x1610)] {
        let mut master = preop(Servo::akd2g().pdo_increment(increment).build());
        assert_eq!(master.upload(0x1C12, 2), Ok(second.to_le_bytes().to_vec()));
        assert_eq!(
            master.upload(second, 1),
            Ok(vec![16, 0, 0x40, 0x68]),
            "the controlword of the second axis"
        );
        assert_eq!(master.upload(none, 0), Err(NO_OBJECT));
        assert_eq!(
            master.upload(second + 0x0400, 1),
            Ok(vec![16, 0, 0x41, 0x68])
        );
    }
}

#[test]
fn a_pdo_can_take_as_few_entries_as_a_drive_allows() {
    let mut master = preop(Servo::akd2g().entries_per_pdo(8).build());
    assert!(master.upload(0x1600, 8).is_ok());
    assert_eq!(master.upload(0x1600, 9), Err(NO_SUBINDEX));
}

#[test]
fn a_slow_drive_looks_at_its_outputs_once_in_its_own_cycle() {
    let drive = Servo::generic().change(|behaviour| {
        behaviour.period = core::time::Duration::from_millis(4);
    });
    let mut master = preop(drive.build());
    master.bring_to_op(0x24);
    let mut outputs = [0; 19];
    outputs[3..7].copy_from_slice(&7_i32.to_le_bytes());
    let target = |master: &Master| {
        master
            .segment
            .axis(0, 0)
            .and_then(|axis| axis.get(0x607A, 0))
    };
    let mut cycles = 0;
    while target(&master) != Some(7) {
        master.cycle(&outputs);
        cycles += 1;
        assert!(cycles <= 5);
    }
    outputs[3..7].copy_from_slice(&8_i32.to_le_bytes());
    for _ in 0..3 {
        master.cycle(&outputs);
        assert_eq!(target(&master), Some(7));
    }
    master.cycle(&outputs);
    assert_eq!(target(&master), Some(8));
}

/// Local control: the statusword's bit 9 is 0, commands are ignored, and SDO is served all the same.
#[test]
fn in_local_control_commands_are_ignored_and_sdo_is_served() {
    let mut master = preop(Servo::generic().build());
    master.bring_to_op(0x24);
    master
        .segment
        .axis_mut(0, 0)
        .expect("an axis")
        .set_remote(false);
    let mut outputs = [0; 19];
    for word in [0x06, 0x07, 0x0F, 0x1F] {
        outputs[0] = word;
        for _ in 0..5 {
            let inputs = master.cycle(&outputs);
            assert_eq!(inputs[1] & 0x02, 0, "bit 9");
        }
    }
    assert_eq!(master.upload(0x6041, 0).expect("served")[0] & 0x6F, 0x40);
    assert_eq!(master.download(0x6085, 0, &5_u32.to_le_bytes()), Ok(()));
    assert_eq!(master.upload(0x6085, 0), Ok(vec![5, 0, 0, 0]));
}

#[test]
fn sdo_information_and_complete_access_are_served_where_they_are_offered() {
    for (drive, offered) in [
        (Servo::generic(), (true, true)),
        (Servo::generic().without_sdo_information(), (false, true)),
        (Servo::generic().without_complete_access(), (true, false)),
        (Servo::akd2g(), (false, false)),
        (
            Servo::akd2g().with_sdo_information().with_complete_access(),
            (true, true),
        ),
    ] {
        let mut master = preop(drive.build());
        // A list of how many objects there are: an answer of SDO information (service 8), or an SDO abort.
        let counts = master.coe(&[0x00, 0x80, 0x01, 0x00, 0x00, 0x00, 0x00, 0x00]);
        let whole = master.coe(&request(0x50, 0x1018, 0, &[0; 4]));
        assert_eq!((counts[1] >> 4 == 8, whole[2] != 0x80), offered);
    }
}
