//! From power-up to a move, and back by a watchdog: what a MainDevice sees on the wire of an AKD2G.

use core::time::Duration;

use crate::master::{BRD, BWR, FPRD, FPWR, LRW, Master, frame};
use servocrab_sim::{AlState, Segment, personality};

fn drive() -> Master {
    Master::new(Segment::new().with(personality::akd2g()).ideal())
}

/// Outputs of both axes with axis 1's controlword, target and velocity.
fn outputs(controlword: u16, target: i32) -> [u8; 38] {
    let mut bytes = [0; 38];
    bytes[0..2].copy_from_slice(&controlword.to_le_bytes());
    bytes[2] = 1;
    bytes[3..7].copy_from_slice(&target.to_le_bytes());
    bytes[7..11].copy_from_slice(&10_000u32.to_le_bytes());
    bytes[11..15].copy_from_slice(&100_000u32.to_le_bytes());
    bytes[15..19].copy_from_slice(&100_000u32.to_le_bytes());
    bytes
}

/// Steps until bits of axis 1's statusword have a value.
fn until(master: &mut Master, outputs: &[u8; 38], mask: u16, value: u16) {
    for _ in 0..2000 {
        let inputs = master.cycle(outputs);
        if u16::from_le_bytes([inputs[0], inputs[1]]) & mask == value {
            return;
        }
    }
    panic!("statusword & {mask:04X}h never was {value:04X}h");
}

fn enable(master: &mut Master) {
    until(master, &outputs(0x00, 0), 0x004F, 0x0040);
    until(master, &outputs(0x06, 0), 0x006F, 0x0021);
    until(master, &outputs(0x0F, 0), 0x006F, 0x0027);
}

#[test]
fn a_drive_goes_from_power_up_to_a_finished_move() {
    let mut master = drive();
    master.bring_to_preop();
    master.bring_to_op(0x24);
    enable(&mut master);
    until(&mut master, &outputs(0x1F, 1000), 0x1000, 0x1000);
    until(&mut master, &outputs(0x0F, 1000), 0x1400, 0x0400);
    let axis = master.segment.axis(0, 0).unwrap();
    assert_eq!((axis.position(), axis.ledger().len()), (1000, 1));
    assert_eq!(master.segment.axis(0, 1).unwrap().ledger().len(), 0);
}

#[test]
fn a_mailbox_of_the_wrong_size_is_refused() {
    let mut master = drive();
    assert_eq!(master.exchange(2, 0, 0x0010, &[0x01, 0x10]).1, 1);
    master.sync_manager(0x1001, 0, 0x1800, 512, 0x26);
    master.sync_manager(0x1001, 1, 0x1C00, 1024, 0x22);
    assert_eq!(master.request(0x1001, 2), (0x11, 0x0016));
}

#[test]
fn process_data_of_the_wrong_length_is_refused_by_direction() {
    let mut master = drive();
    master.bring_to_preop();
    master.sync_manager(0x1001, 2, 0x1100, 37, 0x24);
    master.sync_manager(0x1001, 3, 0x1200, 22, 0x20);
    assert_eq!(master.request(0x1001, 4), (0x12, 0x001D));
    master.write(0x1001, 0x0816, &[0]);
    master.sync_manager(0x1001, 2, 0x1100, 38, 0x24);
    master.write(0x1001, 0x081E, &[0]);
    master.sync_manager(0x1001, 3, 0x1200, 21, 0x20);
    assert_eq!(master.request(0x1001, 0x12), (2, 0));
    assert_eq!(master.request(0x1001, 4), (0x12, 0x001E));
}

#[test]
fn three_output_buffers_that_run_into_the_inputs_are_refused() {
    let mut master = drive();
    master.bring_to_preop();
    master.sync_manager(0x1001, 2, 0x1100, 38, 0x24);
    master.sync_manager(0x1001, 3, 0x1140, 22, 0x20);
    assert_eq!(master.request(0x1001, 4), (0x12, 0x001D));
}

#[test]
fn an_enabled_sync_manager_keeps_its_length() {
    let mut master = drive();
    master.bring_to_preop();
    master.sync_manager(0x1001, 0, 0x1000, 8, 0x26);
    assert_eq!(master.read::<4>(0x1001, 0x0800), [0x00, 0x18, 0x00, 0x04]);
}

#[test]
fn op_without_outputs_is_refused_after_a_while() {
    let mut master = drive();
    master.bring_to_preop();
    master.sync_manager(0x1001, 2, 0x1100, 38, 0x24);
    master.sync_manager(0x1001, 3, 0x1200, 22, 0x20);
    assert_eq!(master.request(0x1001, 4), (4, 0));
    assert_eq!(master.request(0x1001, 8), (4, 0));
    master.now += Duration::from_millis(300);
    assert_eq!(master.al(0x1001), (0x14, 0x0019));
}

#[test]
fn the_watchdog_takes_the_drive_to_safeop_when_outputs_stop() {
    let mut master = drive();
    master.bring_to_preop();
    assert_eq!(master.download(0x6007, 0, &3i16.to_le_bytes()), Ok(()));
    // Watchdog of 10 ms: 100 ticks of 100 µs, and SM2 with the trigger bit.
    master.write(0x1001, 0x0420, &[100, 0]);
    master.bring_to_op(0x64);
    enable(&mut master);
    until(&mut master, &outputs(0x1F, 1_000_000), 0x1000, 0x1000);
    for _ in 0..200 {
        master.cycle(&outputs(0x0F, 1_000_000));
    }
    assert_eq!(master.segment.axis(0, 0).unwrap().velocity(), 10_000.0);
    master
        .segment
        .advance(master.now + Duration::from_millis(9));
    assert_eq!(master.segment.device(0).unwrap().al_state(), AlState::Op);
    master.now += Duration::from_millis(500);
    assert_eq!(master.al(0x1001), (0x14, 0x001B));
    assert_eq!(master.read::<1>(0x1001, 0x0442), [1]);
    assert_eq!(master.read::<1>(0x1001, 0x0440), [0]);
    assert_eq!(master.segment.axis(0, 0).unwrap().velocity(), 0.0);
}

#[test]
fn without_the_trigger_bit_of_sm2_the_watchdog_never_expires() {
    let mut master = drive();
    master.bring_to_preop();
    master.write(0x1001, 0x0420, &[100, 0]);
    master.bring_to_op(0x24);
    master.now += Duration::from_secs(2);
    assert_eq!(master.al(0x1001), (8, 0));
}

#[test]
fn outputs_are_ignored_in_safeop() {
    let mut master = drive();
    master.bring_to_preop();
    master.bring_to_op(0x24);
    assert_eq!(master.request(0x1001, 4), (4, 0));
    for _ in 0..5 {
        master.cycle(&outputs(0x06, 77));
    }
    assert_eq!(master.segment.axis(0, 0).unwrap().get(0x607A, 0), Some(0));
    let inputs = master.cycle(&outputs(0x06, 77));
    assert_ne!(inputs[..2], [0, 0], "inputs are valid in SAFEOP");
}

#[test]
fn a_broadcast_counts_every_device_and_ors_what_they_answer() {
    let segment = Segment::new()
        .with(personality::coupler())
        .with(personality::akd2g())
        .with(personality::io_terminal());
    let mut master = Master::new(segment);
    let (data, counter) = master.exchange(BRD, 0, 0x0130, &[0; 2]);
    assert_eq!((data, counter), (vec![1, 0], 3));
    assert_eq!(master.exchange(BWR, 0, 0x0120, &[1, 0]).1, 3);
}

#[test]
fn several_datagrams_of_one_frame_are_each_executed() {
    let mut master = drive();
    master.bring_to_preop();
    let mut bytes = frame(&[
        (FPRD, 0x1001, 0x0130, &[0, 0]),
        (FPRD, 0x1002, 0x0130, &[0, 0]),
        (BRD, 0, 0x0010, &[0, 0]),
    ]);
    assert!(master.segment.process(&mut bytes, master.now));
    assert_eq!(bytes[6], 0x12, "the source address is marked");
    assert_eq!(bytes[26..30], [2, 0, 1, 0]);
    assert_eq!(bytes[40..44], [0, 0, 0, 0]);
    assert_eq!(bytes[54..58], [0x01, 0x10, 1, 0]);
    assert_eq!(
        bytes[46..48],
        [1, 0],
        "a broadcast's address counts the devices"
    );
}

#[test]
fn a_read_only_register_keeps_its_value() {
    let mut master = drive();
    let before = master.exchange(BRD, 0, 0x0130, &[0; 2]).0;
    master.exchange(BWR, 0, 0x0130, &[8, 0]);
    assert_eq!(master.exchange(BRD, 0, 0x0130, &[0; 2]).0, before);
}

#[test]
fn an_io_terminal_exchanges_its_two_bytes_each_way() {
    let mut master = Master::new(Segment::new().with(personality::io_terminal()));
    assert_eq!(master.exchange(2, 0, 0x0010, &[0x01, 0x10]).1, 1);
    assert_eq!(master.request(0x1001, 2), (2, 0));
    master.sync_manager(0x1001, 0, 0x1000, 2, 0x44);
    master.sync_manager(0x1001, 1, 0x1080, 2, 0x20);
    master.fmmu(0x1001, 0, 0x100, 2, 0x1000, 2);
    master.fmmu(0x1001, 1, 0x102, 2, 0x1080, 1);
    assert_eq!(master.request(0x1001, 4), (4, 0));
    master
        .segment
        .device_mut(0)
        .unwrap()
        .set_inputs(&[0xCD, 0xAB]);
    assert_eq!(master.exchange(LRW, 0x100, 0, &[0x12, 0x34, 0, 0]).1, 3);
    assert_eq!(master.request(0x1001, 8), (8, 0));
    master.now += Duration::from_millis(2);
    let (data, counter) = master.exchange(LRW, 0x100, 0, &[0x12, 0x34, 0, 0]);
    assert_eq!((data, counter), (vec![0x12, 0x34, 0xCD, 0xAB], 3));
    assert_eq!(master.segment.device(0).unwrap().outputs(), [0x12, 0x34]);
}

#[test]
fn a_device_behind_a_pulled_cable_is_not_there() {
    let segment = Segment::new()
        .with(personality::coupler())
        .with(personality::akd2g());
    let mut master = Master::new(segment);
    master.segment.unplug(1);
    assert_eq!(master.exchange(BRD, 0, 0x0110, &[0; 2]).1, 1);
    master.segment.plug();
    assert_eq!(master.exchange(BRD, 0, 0x0110, &[0; 2]).1, 2);
    master.segment.unplug(0);
    let mut bytes = frame(&[(BRD, 0, 0, &[0])]);
    let before = bytes.clone();
    assert!(!master.segment.process(&mut bytes, master.now));
    assert_eq!(bytes, before);
}

#[test]
fn a_drive_that_lost_its_power_comes_back_in_init_without_an_address() {
    let mut master = drive();
    master.bring_to_preop();
    let device = master.segment.device_mut(0).unwrap();
    device.power_off();
    assert!(
        !master
            .segment
            .process(&mut frame(&[(BRD, 0, 0, &[0])]), master.now)
    );
    let now = master.now;
    master.segment.device_mut(0).unwrap().power_on(now);
    assert_eq!(master.exchange(FPRD, 0x1001, 0x0130, &[0; 2]).1, 0);
    assert_eq!(master.exchange(BRD, 0, 0x0130, &[0; 2]), (vec![1, 0], 1));
}

#[test]
fn preop_is_refused_while_the_eeprom_is_not_the_drives_own() {
    let mut master = Master::of(personality::akd2g());
    master.bring_to_preop();
    assert_eq!(master.request(0x1001, 1), (1, 0));
    master.write(0x1001, 0x0500, &[0]);
    master.write(0x1001, 0x0120, &[2, 0]);
    assert_eq!(master.al(0x1001), (0x11, 0x0051));
    assert_eq!(master.request(0x1001, 0x12), (2, 0));
}

#[test]
fn the_sii_is_read_through_its_registers_and_starts_with_the_vendor_category() {
    let mut master = drive();
    assert_eq!(master.exchange(2, 0, 0x0010, &[0x01, 0x10]).1, 1);
    let mut read = |word: u8| {
        master.write(0x1001, 0x0502, &[0x00, 0x01, word, 0, 0, 0]);
        master.read::<8>(0x1001, 0x0508)
    };
    assert_eq!(read(0x08), [0x6A, 0, 0, 0, 0x32, 0x44, 0x4B, 0x41]);
    assert_eq!(read(0x18), [0x00, 0x18, 0x00, 0x04, 0x00, 0x1C, 0x00, 0x04]);
    assert_eq!(read(0x40)[..2], [0x00, 0x08]);
    // Given to the device, the interface refuses: bit 13 of the status.
    master.write(0x1001, 0x0500, &[1]);
    master.exchange(FPWR, 0x1001, 0x0502, &[0x00, 0x01, 0x08, 0, 0, 0]);
    assert_eq!(master.read::<2>(0x1001, 0x0502)[1] & 0x20, 0x20);
}

#[test]
fn a_trigger_without_a_watchdog_time_and_a_time_without_a_trigger_are_refused_where_that_is_looked_at()
 {
    use servocrab_sim::personality::Servo;
    // Control byte of the outputs, watchdog time, and what comes of it on the plain drive.
    for (control, time, expected) in [
        (0x64, 1000u16, (4, 0)),
        (0x24, 0, (4, 0)),
        (0x64, 0, (0x12, 0x001F)),
        (0x24, 1000, (0x12, 0x001F)),
    ] {
        let mut master = Master::of(Servo::generic().build());
        master.bring_to_preop();
        let (outputs, inputs) = master.lengths;
        master.sync_manager(0x1001, 2, 0x1400, outputs, control);
        master.sync_manager(0x1001, 3, 0x1800, inputs, 0x20);
        master.write(0x1001, 0x0420, &time.to_le_bytes());
        assert_eq!(
            master.request(0x1001, 4),
            expected,
            "{control:02X}h, {time}"
        );
    }
    // The AKD's own SII has a time and no trigger.
    let mut master = Master::of(Servo::akd2g().build());
    master.bring_to_preop();
    master.sync_manager(0x1001, 2, 0x1100, 38, 0x24);
    master.sync_manager(0x1001, 3, 0x1200, 22, 0x20);
    assert_eq!(master.request(0x1001, 4), (4, 0));
}

#[test]
fn a_slow_eeprom_is_busy_for_its_time_and_takes_no_other_command_meanwhile() {
    let mut master = drive();
    assert_eq!(master.exchange(2, 0, 0x0010, &[0x01, 0x10]).1, 1);
    let delay = core::time::Duration::from_millis(3);
    master.segment.device_mut(0).unwrap().set_sii_delay(delay);
    let before = master.segment.device(0).unwrap().sii_accesses();
    master.write(0x1001, 0x0502, &[0x00, 0x01, 0x08, 0, 0, 0]);
    let asked = master.now;
    master.write(0x1001, 0x0502, &[0x00, 0x01, 0x0A, 0, 0, 0]);
    while master.read::<2>(0x1001, 0x0502)[1] & 0x80 != 0 {
        assert!(master.now < asked + delay, "busy for too long");
        master.now += core::time::Duration::from_micros(100);
    }
    assert!(master.now >= asked + delay, "{:?}", master.now - asked);
    assert_eq!(
        master.read::<4>(0x1001, 0x0508),
        [0x6A, 0, 0, 0],
        "word 8, the vendor"
    );
    let device = master.segment.device(0).unwrap();
    assert_eq!(device.sii_accesses() - before, 1);
}
