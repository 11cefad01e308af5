//! What the drive does by itself, or because of the connection: emergencies, falls, the way back to OP.

use core::time::Duration;

use servocrab_sim::{AlState, Segment, personality};

use crate::master::{BWR, Master};

fn in_op(control: u8) -> Master {
    let mut master = Master::new(Segment::new().with(personality::akd2g()));
    master.bring_to_preop();
    master.bring_to_op(control);
    master
}

#[test]
fn a_fault_of_an_axis_sends_its_emergency_and_shows_in_the_error_register() {
    let mut master = in_op(0x24);
    master.cycle(&[0; 38]);
    master.segment.axis_mut(0, 1).unwrap().inject_fault(0x7320);
    for _ in 0..20 {
        master.cycle(&[0; 38]);
    }
    let (_, mail) = master.fetch().expect("an emergency");
    assert_eq!(mail[..4], [0x00, 0x10, 0x20, 0x73]);
    assert_eq!(master.upload(0x1001, 0).unwrap()[0] & 1, 1);
    assert_eq!(master.upload(0x683F, 0), Ok(vec![0x20, 0x73]));
}

/// CiA 301, object 1001h: generic error in bit 0, then current, voltage, temperature, communication, device profile, and bit 7 for the
/// manufacturer's.
#[test]
fn an_emergency_names_the_group_of_its_error_in_the_register() {
    for (code, register) in [
        (0x2310_u16, 0x03),
        (0x3220, 0x05),
        (0x4310, 0x09),
        (0x8130, 0x11),
        (0x8611, 0x21),
        (0xFF01, 0x81),
        (0x7320, 0x01),
    ] {
        let mut master = in_op(0x24);
        master.cycle(&[0; 38]);
        let axis = master.segment.axis_mut(0, 1).unwrap();
        axis.inject_fault(code);
        for _ in 0..20 {
            master.cycle(&[0; 38]);
        }
        let (_, mail) = master.fetch().expect("an emergency");
        let [low, high] = code.to_le_bytes();
        assert_eq!(mail[2..5], [low, high, register], "{code:04X}h");
        assert_eq!(master.upload(0x1001, 0), Ok(vec![register]), "{code:04X}h");
    }
}

#[test]
fn a_sync_manager_that_is_switched_off_in_op_takes_the_drive_to_preop() {
    let mut master = in_op(0x24);
    master.exchange(BWR, 0, 0x0816, &[0]);
    assert_eq!(master.al(0x1001), (0x12, 0x001D));
}

#[test]
fn after_a_watchdog_expiry_op_needs_an_acknowledgement_and_new_outputs() {
    let mut master = Master::new(Segment::new().with(personality::akd2g()));
    master.bring_to_preop();
    master.write(0x1001, 0x0420, &[100, 0]);
    master.bring_to_op(0x64);
    master.now += Duration::from_millis(20);
    assert_eq!(master.al(0x1001), (0x14, 0x001B));
    assert_eq!(master.request(0x1001, 8), (0x14, 0x001B));
    assert_eq!(master.request(0x1001, 0x14), (4, 0));
    assert_eq!(master.request(0x1001, 8), (4, 0), "waits for outputs");
    master.cycle(&[0; 38]);
    master.cycle(&[0; 38]);
    assert_eq!(master.al(0x1001), (8, 0));
}

#[test]
fn a_device_that_falls_by_itself_shows_the_given_code() {
    let mut master = in_op(0x24);
    master
        .segment
        .device_mut(0)
        .unwrap()
        .fall_to_safe_op(0x001A);
    assert_eq!(master.al(0x1001), (0x14, 0x001A));
    assert_eq!(
        master.segment.device(0).unwrap().al_state(),
        AlState::SafeOp
    );
}

#[test]
fn init_forgets_the_messages_that_wait() {
    let mut master = in_op(0x24);
    let device = master.segment.device_mut(0).unwrap();
    for _ in 0..3 {
        device.inject_emergency(0x1000, 1, [0; 5], Duration::from_secs(1));
    }
    assert_eq!(device.queued_messages(), 2);
    assert_eq!(master.request(0x1001, 1), (1, 0));
    assert_eq!(master.segment.device(0).unwrap().queued_messages(), 0);
}

#[test]
fn the_observer_sees_each_axis_once_in_each_cycle() {
    use std::sync::{Arc, Mutex};
    let rows = Arc::new(Mutex::new(Vec::new()));
    let mut segment = Segment::new()
        .with(personality::io_terminal())
        .with(personality::akd2g());
    let seen = Arc::clone(&rows);
    segment.observe(move |record| {
        seen.lock()
            .unwrap()
            .push((record.time, record.drive, record.axis));
    });
    segment.advance(Duration::from_secs(7));
    segment.advance(Duration::from_secs(7) + Duration::from_micros(1500));
    let first = Duration::from_secs(7);
    let second = first + Duration::from_millis(1);
    assert_eq!(
        *rows.lock().unwrap(),
        [(first, 0, 1), (first, 0, 2), (second, 0, 1), (second, 0, 2)]
    );
}

#[test]
fn a_frozen_processor_leaves_the_esc_answering_with_old_inputs() {
    let mut master = in_op(0x24);
    let before = master.cycle(&[0; 38]);
    master.segment.device_mut(0).unwrap().freeze(true);
    let mut outputs = [0; 38];
    outputs[0] = 0x06;
    for _ in 0..10 {
        assert_eq!(master.cycle(&outputs), before);
    }
    master.post(3, &[0x00, 0x20, 0x40, 0x00, 0x10, 0x00, 0, 0, 0, 0]);
    assert_eq!(master.fetch(), None);
    assert_eq!(master.request(0x1001, 1), (8, 0));
    master.segment.device_mut(0).unwrap().freeze(false);
    assert_eq!(master.exchange(BWR, 0, 0x1000, &[0]).1, 1);
    assert_eq!(master.al(0x1001), (1, 0), "the request is served late");
}

#[test]
fn a_segment_can_be_moved_to_another_thread() {
    let segment = Segment::new().with(personality::akd2g());
    let length = std::thread::spawn(move || segment.len()).join().unwrap();
    assert_eq!(length, 1);
}
