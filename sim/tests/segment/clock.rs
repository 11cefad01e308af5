//! The distributed clock as SOEM sets it up: receive times, offsets, delays, SYNC0, and the AL states that depend on it.
//! Registers: 0900h receive times, 0910h system time, 0918h receive time of the unit, 0920h offset, 0928h delay, 092Ch
//! difference, 0981h activation, 0990h start time, 09A0h cycle of SYNC0 (ESC data sheets).

use core::time::Duration;

use servocrab_sim::personality::Servo;
use servocrab_sim::{ClockDemand, ClockWidth, Segment, personality};

use crate::master::{APWR, BWR, Master};

/// Read by the device that is addressed, written by those behind it.
const FRMW: u8 = 14;

const FIRST: u16 = 0x1001;
const SECOND: u16 = 0x1002;

/// Two drives, the first in PREOP.
fn two() -> Master {
    let segment = Segment::new()
        .with(personality::akd2g())
        .with(personality::akd2g());
    let mut master = Master::new(segment);
    master.now = Duration::from_millis(1);
    master.bring_to_preop();
    let second = 1u16.wrapping_neg();
    assert_eq!(
        master
            .exchange(APWR, second, 0x0010, &SECOND.to_le_bytes())
            .1,
        1
    );
    master
}

fn system_time(master: &mut Master, address: u16) -> u64 {
    u64::from_le_bytes(master.read(address, 0x0910))
}

/// What 092Ch says: positive when the local time is ahead.
fn difference(master: &mut Master, address: u16) -> i64 {
    let value = u32::from_le_bytes(master.read(address, 0x092C));
    let magnitude = i64::from(value & 0x7FFF_FFFF);
    if value >> 31 == 1 {
        -magnitude
    } else {
        magnitude
    }
}

/// Offsets as SOEM computes them: every device shows `epoch` at the moment of the latch.
fn set_offsets(master: &mut Master, epoch: u64) {
    master.exchange(BWR, 0, 0x0900, &[0; 4]);
    for address in [FIRST, SECOND] {
        let received = u64::from_le_bytes(master.read(address, 0x0918));
        let offset = epoch.wrapping_sub(received);
        master.write(address, 0x0920, &offset.to_le_bytes());
    }
}

/// Starts SYNC0 as SOEM does: off, start time and cycle, on. The first pulse comes after `ahead`.
fn start_sync0(master: &mut Master, ahead: u64, cycle: u32, activation: u8) {
    master.write(FIRST, 0x0981, &[0]);
    master.write(FIRST, 0x0980, &[0]);
    let start = system_time(master, FIRST) + ahead;
    master.write(FIRST, 0x0990, &start.to_le_bytes());
    master.write(FIRST, 0x09A0, &cycle.to_le_bytes());
    master.write(FIRST, 0x0981, &[activation]);
}

/// Process data of the first drive, and a request for SAFEOP.
fn to_safe_op(master: &mut Master) -> (u16, u16) {
    master.sync_manager(FIRST, 2, 0x1100, 38, 0x24);
    master.sync_manager(FIRST, 3, 0x1200, 22, 0x20);
    master.fmmu(FIRST, 0, 0, 38, 0x1100, 2);
    master.fmmu(FIRST, 1, 38, 22, 0x1200, 1);
    master.request(FIRST, 4)
}

#[test]
fn the_features_say_that_there_is_a_clock_of_64_bits() {
    let features = u16::from_le_bytes(two().read(FIRST, 0x0008));
    assert_eq!(features & 0x000C, 0x000C);
}

#[test]
fn the_control_loop_has_the_values_of_a_reset() {
    let mut master = two();
    assert_eq!(master.read::<2>(FIRST, 0x0930), [0x00, 0x10]);
    assert_eq!(master.read::<2>(FIRST, 0x0934), [0x04, 0x0C]);
}

#[test]
fn a_latch_keeps_its_times_until_the_next_one() {
    let mut master = two();
    master.exchange(BWR, 0, 0x0900, &[0; 4]);
    let latched: [u8; 16] = master.read(FIRST, 0x0900);
    let unit: [u8; 8] = master.read(FIRST, 0x0918);
    assert_eq!(latched[..4], unit[..4], "port 0 is where the frame came in");
    assert_eq!(latched[8..], [0; 8], "nothing is at ports 2 and 3");
    master.now += Duration::from_millis(3);
    assert_eq!(master.read::<16>(FIRST, 0x0900), latched);
    master.exchange(BWR, 0, 0x0900, &[0; 4]);
    let again = u64::from_le_bytes(master.read(FIRST, 0x0918));
    assert_eq!(again - u64::from_le_bytes(unit), 3_000_000);
}

#[test]
fn offsets_give_all_devices_one_time_and_the_loop_removes_the_delay() {
    let mut master = two();
    let epoch = 800_000_000_000_000_000;
    set_offsets(&mut master, epoch);
    assert_eq!(system_time(&mut master, FIRST), epoch);
    // The half of what a frame takes through the line and back, as ports 0 and 1 of the first device tell.
    let ports: [u8; 8] = master.read(FIRST, 0x0900);
    let (low, high) = ports.split_at(4);
    let delay = (u32::from_le_bytes(high.try_into().unwrap())
        .wrapping_sub(u32::from_le_bytes(low.try_into().unwrap())))
        / 2;
    assert_eq!(delay, 500);
    master.write(SECOND, 0x0928, &delay.to_le_bytes());
    let mut seen = Vec::new();
    for _ in 0..300 {
        master.now += Duration::from_millis(1);
        master.exchange(FRMW, FIRST, 0x0910, &[0; 8]);
        seen.push(difference(&mut master, SECOND));
    }
    assert_eq!(seen.first(), Some(&-500));
    assert!(seen.is_sorted(), "{seen:?}");
    assert_eq!(seen.last(), Some(&0));
    assert_eq!(
        system_time(&mut master, FIRST),
        epoch + 300_000_000,
        "the reference clock follows nobody"
    );
}

#[test]
fn sync0_starts_at_its_time_and_shows_the_next_pulse() {
    let mut master = two();
    set_offsets(&mut master, 1_000_000_000);
    start_sync0(&mut master, 100_000_000, 2_000_000, 3);
    let next = |master: &mut Master| u64::from_le_bytes(master.read(FIRST, 0x0990));
    assert_eq!(next(&mut master), 1_100_000_000);
    master.now += Duration::from_millis(103);
    assert_eq!(next(&mut master), 1_104_000_000);
    // While the unit is on, start time and cycle are locked.
    master.write(FIRST, 0x09A0, &[0; 4]);
    assert_eq!(u32::from_le_bytes(master.read(FIRST, 0x09A0)), 2_000_000);
}

#[test]
fn op_waits_for_the_first_pulse() {
    let mut master = two();
    start_sync0(&mut master, 100_000_000, 1_000_000, 3);
    assert_eq!(to_safe_op(&mut master), (4, 0));
    master.cycle(&[0; 38]);
    assert_eq!(master.request(FIRST, 8), (4, 0), "no pulse yet");
    for _ in 0..110 {
        master.cycle(&[0; 38]);
    }
    assert_eq!(master.al(FIRST), (8, 0));
}

#[test]
fn a_start_time_in_the_past_never_comes_and_op_is_refused() {
    let mut master = two();
    set_offsets(&mut master, 1_000_000_000);
    start_sync0(&mut master, 0, 1_000_000, 3);
    assert_eq!(to_safe_op(&mut master), (4, 0));
    master.cycle(&[0; 38]);
    master.request(FIRST, 8);
    for _ in 0..250 {
        master.cycle(&[0; 38]);
    }
    assert_eq!(master.al(FIRST), (0x14, 0x002D));
}

#[test]
fn each_wrong_setting_of_sync0_has_its_code() {
    // Activation, cycle, code: SYNC1, which the drive's modes do not have; SYNC0 without the unit; no cycle; one that is
    // no multiple of 62.5 us.
    for (activation, cycle, code) in [
        (7, 1_000_000, 0x0030),
        (2, 1_000_000, 0x0030),
        (1, 1_000_000, 0x0030),
        (3, 0, 0x0035),
        (3, 1_000_001, 0x0036),
    ] {
        let mut master = two();
        start_sync0(&mut master, 100_000_000, cycle, activation);
        assert_eq!(
            to_safe_op(&mut master),
            (0x12, code),
            "{activation}, {cycle}"
        );
        // Set right and acknowledged, it goes on.
        start_sync0(&mut master, 100_000_000, 250_000, 3);
        assert_eq!(master.request(FIRST, 0x12), (2, 0));
        assert_eq!(master.request(FIRST, 4), (4, 0));
    }
}

#[test]
fn a_sync0_that_is_set_wrong_in_safeop_keeps_the_drive_from_op() {
    let mut master = two();
    assert_eq!(to_safe_op(&mut master), (4, 0));
    start_sync0(&mut master, 1_000_000, 1_000_001, 3);
    master.cycle(&[0; 38]);
    master.request(FIRST, 8);
    for _ in 0..250 {
        master.cycle(&[0; 38]);
    }
    assert_eq!(master.al(FIRST), (0x14, 0x0036));
}

#[test]
fn the_synchronisation_type_must_fit_the_unit() {
    let mut master = two();
    assert_eq!(master.upload(0x1C32, 4), Ok(vec![5, 0]));
    assert_eq!(master.download(0x1C32, 1, &[1, 0]), Err(0x0609_0030));
    assert_eq!(master.download(0x1C32, 1, &[2, 0]), Ok(()));
    assert_eq!(to_safe_op(&mut master), (0x12, 0x0030));
    start_sync0(&mut master, 100_000_000, 1_000_000, 3);
    assert_eq!(master.request(FIRST, 0x12), (2, 0));
    assert_eq!(master.request(FIRST, 4), (4, 0));
}

#[test]
fn the_sync_manager_parameters_show_what_the_drive_follows() {
    let mut master = two();
    let shown = |master: &mut Master| {
        [0x1C32, 0x1C33].map(|index| {
            let cycle = master.upload(index, 2).unwrap();
            (
                master.upload(index, 1).unwrap(),
                u32::from_le_bytes(cycle.try_into().unwrap()),
            )
        })
    };
    // Free run in the drive's own millisecond; SYNC0 each 2 ms; free run again.
    let free = (vec![0, 0], 1_000_000);
    assert_eq!(shown(&mut master), [free.clone(), free.clone()]);
    start_sync0(&mut master, 1_000_000, 2_000_000, 3);
    assert_eq!(to_safe_op(&mut master), (4, 0));
    let synchronous = (vec![2, 0], 2_000_000);
    assert_eq!(shown(&mut master), [synchronous.clone(), synchronous]);
    assert_eq!(master.request(FIRST, 2), (2, 0));
    assert_eq!(shown(&mut master), [free.clone(), free]);
}

#[test]
fn sync0_that_stops_in_op_takes_the_drive_to_safeop() {
    let mut master = two();
    start_sync0(&mut master, 1_000_000, 1_000_000, 3);
    assert_eq!(to_safe_op(&mut master), (4, 0));
    master.cycle(&[0; 38]);
    master.cycle(&[0; 38]);
    assert_eq!(master.request(FIRST, 8), (8, 0));
    master.write(FIRST, 0x0981, &[0]);
    master.cycle(&[0; 38]);
    assert_eq!(master.al(FIRST), (0x14, 0x001A));
}

#[test]
fn a_device_without_a_clock_mode_refuses_sync0() {
    let mut master = Master::new(Segment::new().with(personality::io_terminal()));
    assert_eq!(master.exchange(APWR, 0, 0x0010, &FIRST.to_le_bytes()).1, 1);
    assert_eq!(master.request(FIRST, 2), (2, 0));
    master.sync_manager(FIRST, 0, 0x1000, 2, 0x44);
    master.sync_manager(FIRST, 1, 0x1080, 2, 0x20);
    start_sync0(&mut master, 100_000_000, 1_000_000, 3);
    assert_eq!(master.request(FIRST, 4), (0x12, 0x0030));
}

/// A drive that wants its outputs 100 us before SYNC0 and not sooner than 50 us after the one before.
fn insisting(fault: Option<u16>) -> Master {
    let demand = ClockDemand {
        before: Duration::from_micros(100),
        after: Duration::from_micros(50),
        lock_pulses: 20,
        fault,
    };
    let drive = Servo::akd2g().insists_on_clock(demand).build();
    let mut master = Master::new(Segment::new().with(drive));
    master.now = Duration::from_millis(1);
    master.bring_to_preop();
    master
}

/// Starts SYNC0 so that it pulses so long after each frame of `cycle`.
fn start_sync0_after_frames(master: &mut Master, after_us: u64) {
    let on_a_frame = 100_000_000 - system_time(master, FIRST) % 1_000;
    start_sync0(master, on_a_frame + after_us * 1_000, 1_000_000, 3);
}

/// In OP, with SYNC0 half a cycle after the frames.
fn insisting_in_op(fault: Option<u16>) -> Master {
    let mut master = insisting(fault);
    start_sync0_after_frames(&mut master, 500);
    assert_eq!(to_safe_op(&mut master), (4, 0));
    for _ in 0..130 {
        master.cycle(&[0; 38]);
    }
    assert_eq!(master.request(FIRST, 8), (8, 0));
    master
}

#[test]
fn a_drive_that_insists_refuses_safeop_without_sync0() {
    assert_eq!(to_safe_op(&mut insisting(None)), (0x12, 0x0030));
}

#[test]
fn outputs_too_close_to_sync0_keep_an_insisting_drive_from_op() {
    // Before the pulse by less than 100 us; sooner than 50 us after it.
    for after_us in [50, 970] {
        let mut master = insisting(None);
        start_sync0_after_frames(&mut master, after_us);
        assert_eq!(to_safe_op(&mut master), (4, 0));
        for _ in 0..130 {
            master.cycle(&[0; 38]);
        }
        assert_eq!(master.request(FIRST, 8), (4, 0), "it waits");
        for _ in 0..250 {
            master.cycle(&[0; 38]);
        }
        assert_eq!(master.al(FIRST), (0x14, 0x0032), "{after_us}");
    }
}

#[test]
fn frames_that_slide_into_the_pulse_end_op() {
    let mut master = insisting_in_op(None);
    let mut cycles = 0;
    while master.al(FIRST).0 == 8 {
        // A master whose clock is 0.1 % slow.
        master.now += Duration::from_micros(1);
        master.cycle(&[0; 38]);
        cycles += 1;
    }
    // 400 us until the forbidden time, two pulses, and what they did is seen with the next frame.
    assert_eq!(cycles, 403);
    assert_eq!(master.al(FIRST), (0x14, 0x001A));
}

#[test]
fn outputs_that_stay_away_end_op_with_the_fault_that_the_drive_has_for_it() {
    let mut master = insisting_in_op(Some(0xFF06));
    master.now += Duration::from_millis(1);
    master.cycle(&[0; 38]);
    assert_eq!(master.al(FIRST), (8, 0), "one is forgiven");
    for _ in 0..10 {
        master.cycle(&[0; 38]);
    }
    master.now += Duration::from_millis(3);
    assert_eq!(master.al(FIRST), (0x14, 0x0034));
    for axis in master.segment.device(0).unwrap().axes() {
        assert_eq!(axis.get(0x603F, 0), Some(0xFF06));
    }
}

#[test]
fn nobody_counts_with_an_error_limit_of_zero() {
    let mut master = insisting(None);
    assert_eq!(master.download(0x10F1, 2, &[0, 0]), Ok(()));
    start_sync0_after_frames(&mut master, 500);
    assert_eq!(to_safe_op(&mut master), (4, 0));
    for _ in 0..130 {
        master.cycle(&[0; 38]);
    }
    assert_eq!(master.request(FIRST, 8), (8, 0));
    master.now += Duration::from_millis(20);
    assert_eq!(master.al(FIRST), (8, 0));
    assert!(master.segment.device(0).unwrap().sync_mistakes() > 15);
}

#[test]
fn crystals_drift_apart_and_the_reference_time_holds_them_together() {
    let mut master = two();
    let apart = |master: &mut Master| {
        let times = [0, 1].map(|at| {
            let device = master.segment.device(at).unwrap();
            device.system_time(master.now)
        });
        times[1].wrapping_sub(times[0]).cast_signed()
    };
    for (position, drift) in [(0, 40.0), (1, -60.0)] {
        let device = master.segment.device_mut(position).unwrap();
        device.set_clock(1_000, drift);
    }
    let before = apart(&mut master);
    master.now += Duration::from_secs(1);
    let gained = apart(&mut master) - before;
    assert!((-100_010..-99_990).contains(&gained), "{gained}");

    set_offsets(&mut master, 1_000_000_000);
    master.write(SECOND, 0x0928, &500u32.to_le_bytes());
    master.write(SECOND, 0x0930, &[0x00, 0x10]);
    for _ in 0..15_000 {
        master.now += Duration::from_micros(10);
        master.exchange(FRMW, FIRST, 0x0910, &[0; 4]);
    }
    for _ in 0..1_000 {
        master.now += Duration::from_millis(1);
        master.exchange(FRMW, FIRST, 0x0910, &[0; 4]);
        let apart = apart(&mut master);
        assert!(apart.abs() < 200, "{apart}");
    }
    assert!(difference(&mut master, SECOND).abs() < 200);
}

#[test]
fn a_clock_of_32_bits_shows_the_lower_half_and_starts_sync0_there() {
    let drive = Servo::akd2g().clock(Some(ClockWidth::Bits32)).build();
    let mut master = Master::new(Segment::new().with(drive));
    master.now = Duration::from_secs(5);
    master.bring_to_preop();
    assert_eq!(
        u16::from_le_bytes(master.read(FIRST, 0x0008)) & 0x000C,
        0x0004
    );
    assert!(system_time(&mut master, FIRST) <= u32::MAX.into());
    start_sync0(&mut master, 1_000_000, 1_000_000, 3);
    assert_eq!(to_safe_op(&mut master), (4, 0));
    master.cycle(&[0; 38]);
    master.cycle(&[0; 38]);
    assert_eq!(master.request(FIRST, 8), (8, 0));
    let next = u64::from_le_bytes(master.read(FIRST, 0x0990));
    assert!(next <= u32::MAX.into());
}

#[test]
fn a_device_without_a_clock_has_no_such_registers() {
    let drive = Servo::akd2g().clock(None).build();
    let mut master = Master::new(Segment::new().with(drive));
    master.bring_to_preop();
    assert_eq!(u16::from_le_bytes(master.read(FIRST, 0x0008)) & 0x000C, 0);
    assert_eq!(master.exchange(BWR, 0, 0x0900, &[0; 4]).1, 0);
    assert_eq!(master.exchange(FRMW, SECOND, 0x0910, &[0; 4]).1, 0);
    assert_eq!(master.read::<2>(FIRST, 0x0130), [2, 0]);
}
