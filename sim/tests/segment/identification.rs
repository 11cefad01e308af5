//! The explicit device identification (ETG.1020): AL control bit 5, AL status bit 5, 0134h; and the station alias of any device.

use servocrab_sim::{AlState, Segment, personality};

use crate::master::{APWR, BRD, BWR, FPRD, Master, frame};

const STATION: u16 = 0x1001;
const ID: u16 = 0x0107;
/// AL control bit 5, and status bit 5.
const WHO: u8 = 0x20;

fn identified() -> Master {
    Master::of(personality::generic().with_identification(ID))
}

fn in_init(master: &mut Master) {
    master.exchange(APWR, 0, 0x0010, &STATION.to_le_bytes());
    master.write(STATION, 0x0500, &[1]);
}

/// Asks who it is in this state: it says so, stays there, and says it no more when it is not asked.
fn is_who_it_is_in(master: &mut Master, state: u8) {
    for _ in 0..2 {
        master.write(STATION, 0x0120, &[state | WHO, 0]);
        assert_eq!(master.al(STATION), ((state | WHO).into(), ID));
        assert_eq!(
            master.segment.device(0).unwrap().al_state() as u8,
            state,
            "the bit changes no state"
        );
    }
    master.write(STATION, 0x0120, &[state, 0]);
    assert_eq!(master.al(STATION), (state.into(), 0));
}

#[test]
fn a_device_says_who_it_is_in_every_state_and_stays_there() {
    let mut master = identified();
    in_init(&mut master);
    is_who_it_is_in(&mut master, 1);
    master.bring_to_preop();
    is_who_it_is_in(&mut master, 2);
    master.bring_to_op(0x24);
    is_who_it_is_in(&mut master, 8);
    assert_eq!(master.request(STATION, 4), (4, 0));
    is_who_it_is_in(&mut master, 4);
}

#[test]
fn in_an_error_0134h_has_the_error_and_not_the_identification() {
    let mut master = identified();
    master.bring_to_preop();
    master.write(STATION, 0x0120, &[2 | WHO, 0]);
    assert_eq!(master.al(STATION), (0x22, ID));
    // OP from PREOP is an invalid change.
    master.write(STATION, 0x0120, &[8 | WHO, 0]);
    assert_eq!(master.al(STATION), (0x12, 0x0011));
    // To ask who it is acknowledges nothing.
    master.write(STATION, 0x0120, &[2 | WHO, 0]);
    assert_eq!(master.al(STATION), (0x12, 0x0011));
    master.write(STATION, 0x0120, &[0x12 | WHO, 0]);
    assert_eq!(master.al(STATION), (0x22, ID));
    // An error of its own takes the place of what it shows.
    let device = master.segment.device_mut(0).unwrap();
    device.fall_to(AlState::Init, 0x8001);
    assert_eq!(device.al_status_code(), 0x8001);
    assert_eq!(master.al(STATION), (0x11, 0x8001));
    master.write(STATION, 0x0120, &[0x11, 0]);
    assert_eq!(master.al(STATION), (1, 0));
}

#[test]
fn a_device_without_an_identification_ignores_the_bit() {
    let mut master = Master::of(personality::generic());
    in_init(&mut master);
    master.write(STATION, 0x0120, &[1 | WHO, 0]);
    assert_eq!(master.al(STATION), (1, 0));
    master.bring_to_preop();
    master.write(STATION, 0x0120, &[2 | WHO, 0]);
    assert_eq!(master.al(STATION), (2, 0));
}

#[test]
fn a_step_up_can_ask_who_it_is_as_well() {
    let mut master =
        Master::new(Segment::new().with(personality::coupler().with_identification(ID)));
    in_init(&mut master);
    master.write(STATION, 0x0120, &[2 | WHO, 0]);
    assert_eq!(master.al(STATION), (0x22, ID));
}

#[test]
fn its_identification_outlives_a_loss_of_power_and_can_be_set_anew() {
    let mut master = Master::new(Segment::new().with(personality::coupler()));
    let now = master.now;
    let device = master.segment.device_mut(0).unwrap();
    device.set_identification(5);
    device.power_off();
    device.power_on(now);
    let ask = |master: &mut Master| {
        let mut bytes = frame(&[(BWR, 0, 0x0120, &[1 | WHO, 0]), (BRD, 0, 0x0130, &[0; 6])]);
        assert!(master.segment.process(&mut bytes, now));
        bytes[40..46].to_vec()
    };
    assert_eq!(ask(&mut master), [0x21, 0, 0, 0, 5, 0]);
    master.segment.device_mut(0).unwrap().set_identification(6);
    assert_eq!(ask(&mut master), [0x21, 0, 0, 0, 6, 0]);
}

#[test]
fn a_word_can_show_an_identification_at_all_times() {
    for address in [0x0F18, 0x1100] {
        let mut master = Master::new(Segment::new().with(personality::coupler()));
        let now = master.now;
        let device = master.segment.device_mut(0).unwrap();
        device.set_identification_word(address, ID);
        for _ in 0..2 {
            assert_eq!(master.exchange(BRD, 0, address, &[0; 2]).0, [0x07, 0x01]);
            let device = master.segment.device_mut(0).unwrap();
            device.power_off();
            device.power_on(now);
        }
    }
}

#[test]
fn any_device_can_be_given_an_alias_which_is_in_its_eeprom() {
    for mut device in [personality::coupler(), personality::akd2g()] {
        device.set_alias(0x0203);
        let mut master = Master::new(Segment::new().with(device));
        for _ in 0..2 {
            assert_eq!(master.exchange(BRD, 0, 0x0012, &[0; 2]).0, [0x03, 0x02]);
            let status = master.exchange(BRD, 0, 0x0502, &[0; 2]).0;
            assert_eq!(status[1] & 0x18, 0, "the checksum is right");
            master.exchange(BWR, 0, 0x0103, &[1]);
            assert_eq!(master.exchange(FPRD, 0x0203, 0x0012, &[0; 2]).1, 1);
            let now = master.now;
            let device = master.segment.device_mut(0).unwrap();
            assert_eq!(device.description().alias, 0x0203);
            device.power_off();
            device.power_on(now);
        }
    }
}
