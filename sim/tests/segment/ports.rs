//! Ports: links and loops (0101h, 0110h), cables that are pulled or half in, and who gets a frame that is lost.

use core::time::Duration;

use servocrab_sim::{AlState, Segment, personality};

use crate::master::{APWR, BRD, BWR, Master, frame};

const AUTO_CLOSE: u8 = 0b01;
const OPEN: u8 = 0b10;
const CLOSED: u8 = 0b11;
/// Control of port 1 in 0101h.
const PORT_1: u8 = 2;

/// What DL status says of a port: link, closed, communication.
type Shown = (bool, bool, bool);
const RUNS: Shown = (true, false, true);
const NOTHING: Shown = (false, true, false);
const LINKED_AND_CLOSED: Shown = (true, true, false);

/// Devices in a line at 1001h and so on.
fn line(devices: usize) -> Master {
    let mut segment = Segment::new();
    (0..devices).for_each(|_| segment.push(personality::coupler()));
    addressed(segment)
}

fn addressed(segment: Segment) -> Master {
    let mut master = Master::new(segment);
    for position in 0..master.segment.len() as u16 {
        address(&mut master, position);
    }
    master
}

fn address(master: &mut Master, position: u16) {
    let station = (0x1001 + position).to_le_bytes();
    let at = 0u16.wrapping_sub(position);
    assert_eq!(master.exchange(APWR, at, 0x0010, &station).1, 1);
}

fn answer(master: &mut Master) -> u16 {
    master.exchange(BRD, 0, 0x0000, &[0]).1
}

fn shown(master: &mut Master, station: u16, port: u16) -> Shown {
    let status = u16::from_le_bytes(master.read(station, 0x0110));
    let bit = |bit: u16| status >> bit & 1 != 0;
    (bit(4 + port), bit(8 + 2 * port), bit(9 + 2 * port))
}

fn control_port_1(master: &mut Master, station: u16, control: u8) {
    master.write(station, 0x0101, &[control << PORT_1]);
}

/// Asks all for PREOP in one frame: whether that comes back, and which devices have taken it.
fn asks_for_pre_op(master: &mut Master) -> (bool, Vec<bool>) {
    let mut bytes = frame(&[(BWR, 0, 0x0120, &[2, 0])]);
    let returned = master.segment.process(&mut bytes, master.now);
    let devices = master.segment.devices().iter();
    let taken = devices.map(|device| device.al_state() == AlState::PreOp);
    (returned, taken.collect())
}

#[test]
fn an_automatic_port_follows_its_link() {
    let mut master = line(3);
    assert_eq!(shown(&mut master, 0x1002, 0), RUNS);
    assert_eq!(shown(&mut master, 0x1002, 1), RUNS);
    assert_eq!(shown(&mut master, 0x1002, 2), NOTHING);
    assert_eq!(shown(&mut master, 0x1003, 1), NOTHING);
    master.segment.unplug(2);
    assert_eq!(shown(&mut master, 0x1002, 1), NOTHING);
    assert_eq!(answer(&mut master), 2);
    master.segment.plug_in(2);
    assert_eq!(shown(&mut master, 0x1002, 1), RUNS);
    assert_eq!(answer(&mut master), 3);
}

#[test]
fn a_port_that_closes_by_itself_stays_closed_until_it_is_told_again() {
    let mut master = line(3);
    control_port_1(&mut master, 0x1001, AUTO_CLOSE);
    assert_eq!(shown(&mut master, 0x1001, 1), RUNS);
    master.segment.unplug(1);
    assert_eq!(shown(&mut master, 0x1001, 1), NOTHING);
    // Without a link it is told in vain.
    control_port_1(&mut master, 0x1001, AUTO_CLOSE);
    master.segment.plug_in(1);
    assert_eq!(shown(&mut master, 0x1001, 1), LINKED_AND_CLOSED);
    assert_eq!(answer(&mut master), 1);
    control_port_1(&mut master, 0x1001, AUTO_CLOSE);
    assert_eq!(shown(&mut master, 0x1001, 1), RUNS);
    assert_eq!(answer(&mut master), 3);
    // Also where the link came back between two frames.
    master.segment.unplug(1);
    master.segment.plug();
    assert_eq!(answer(&mut master), 1);
    control_port_1(&mut master, 0x1001, 0);
    assert_eq!(answer(&mut master), 3);
}

#[test]
fn a_closed_port_shows_its_link_and_frames_turn_round_there() {
    let mut master = line(3);
    control_port_1(&mut master, 0x1002, CLOSED);
    assert_eq!(shown(&mut master, 0x1002, 1), LINKED_AND_CLOSED);
    assert_eq!(answer(&mut master), 2);
    // The frames do not reach the third, and nobody has lost a link.
    assert_eq!(master.read::<4>(0x1002, 0x0310), [0; 4]);
    master.segment.unplug(2);
    assert_eq!(shown(&mut master, 0x1002, 1), NOTHING);
    assert_eq!(master.read::<4>(0x1002, 0x0310), [0, 1, 0, 0]);
    control_port_1(&mut master, 0x1002, 0);
    master.segment.plug();
    // At port 0 of the third the link was lost, too.
    assert_eq!(master.read::<4>(0x1003, 0x0310), [1, 0, 0, 0]);
}

#[test]
fn a_port_that_is_held_open_loses_frames_when_it_has_no_link() {
    let mut master = line(3);
    control_port_1(&mut master, 0x1002, OPEN);
    assert_eq!(answer(&mut master), 3);
    master.segment.unplug(2);
    assert_eq!(
        asks_for_pre_op(&mut master),
        (false, vec![true, true, false])
    );
    master.segment.plug();
    assert_eq!(shown(&mut master, 0x1002, 1), RUNS);
    control_port_1(&mut master, 0x1003, OPEN);
    assert!(!asks_for_pre_op(&mut master).0, "the end of the line");
}

#[test]
fn port_0_shows_what_it_is_told_and_loses_no_frame() {
    let mut master = line(2);
    for (control, expected) in [
        (AUTO_CLOSE, RUNS),
        (OPEN, RUNS),
        (CLOSED, LINKED_AND_CLOSED),
    ] {
        master.write(0x1002, 0x0101, &[control]);
        assert_eq!(shown(&mut master, 0x1002, 0), expected);
        master.segment.unplug(1);
        assert_eq!(answer(&mut master), 1);
        master.segment.plug();
        assert_eq!(shown(&mut master, 0x1002, 0), expected);
    }
}

#[test]
fn several_cables_are_out_at_once_and_come_back_one_by_one() {
    let mut master = line(4);
    master.segment.unplug(3);
    master.segment.unplug(1);
    assert_eq!(answer(&mut master), 1);
    master.segment.plug_in(1);
    assert_eq!(answer(&mut master), 3);
    master.segment.unplug(1);
    master.segment.plug_in(3);
    assert_eq!(answer(&mut master), 1);
    master.segment.unplug(3);
    master.segment.plug();
    assert_eq!(answer(&mut master), 4);
}

#[test]
fn a_connector_that_is_half_in_has_a_link_and_loses_the_frames_that_go_out_there() {
    let mut master = line(3);
    master.segment.half_plug(1);
    assert_eq!(
        asks_for_pre_op(&mut master),
        (false, vec![true, false, false])
    );
    for put_right in [
        Segment::plug_in,
        Segment::unplug,
        |segment: &mut Segment, _| {
            segment.plug();
        },
    ] {
        master.segment.half_plug(1);
        put_right(&mut master.segment, 1);
        assert!(answer(&mut master) >= 1);
    }
    // With its port closed nothing is lost, and the link is seen.
    control_port_1(&mut master, 0x1001, CLOSED);
    master.segment.half_plug(1);
    assert_eq!(shown(&mut master, 0x1001, 1), LINKED_AND_CLOSED);
    assert!(asks_for_pre_op(&mut master).0);
    assert_eq!(answer(&mut master), 1);
    // A cable that is put in half, and then whole, gives a port that closes by itself no reason to open.
    master.segment.unplug(1);
    control_port_1(&mut master, 0x1001, AUTO_CLOSE);
    master.segment.half_plug(1);
    assert_eq!(answer(&mut master), 1);
    master.segment.plug_in(1);
    assert_eq!(answer(&mut master), 1);
}

#[test]
fn the_first_cable_half_in_reaches_nobody() {
    let mut master = line(2);
    master.segment.half_plug(0);
    assert_eq!(asks_for_pre_op(&mut master), (false, vec![false; 2]));
    master.segment.plug();
    assert_eq!(answer(&mut master), 2);
}

/// The first has a branch at its port 3 (1), the line at its port 1 (2, 3), and another branch at its port 2 (4).
#[test]
fn in_a_tree_the_devices_behind_the_bad_connector_in_the_order_of_the_frame_get_nothing() {
    for (half, taken) in [(1, 1), (2, 2), (3, 3), (4, 4)] {
        let mut segment = Segment::new();
        (0..3).for_each(|_| segment.push(personality::coupler()));
        assert_eq!(segment.attach(0, 3, personality::coupler()), Some(1));
        assert_eq!(segment.attach(0, 2, personality::coupler()), Some(4));
        let mut master = addressed(segment);
        master.segment.half_plug(half);
        let expected = (0..5).map(|position| position < taken).collect();
        assert_eq!(asks_for_pre_op(&mut master), (false, expected));
    }
}

#[test]
fn a_device_without_power_has_no_link_and_begins_with_its_ports_automatic() {
    let mut master = line(3);
    control_port_1(&mut master, 0x1001, AUTO_CLOSE);
    control_port_1(&mut master, 0x1002, CLOSED);
    master.segment.device_mut(1).unwrap().power_off();
    assert_eq!(shown(&mut master, 0x1001, 1), NOTHING);
    let now = master.now;
    master.segment.device_mut(1).unwrap().power_on(now);
    assert_eq!(shown(&mut master, 0x1001, 1), LINKED_AND_CLOSED);
    assert_eq!(answer(&mut master), 1);
    control_port_1(&mut master, 0x1001, AUTO_CLOSE);
    assert_eq!(answer(&mut master), 3);
    assert_eq!(master.exchange(BRD, 0, 0x0010, &[0; 2]).1, 3);
    let mut registers = |position: u16, register: u16| {
        let at = 0u16.wrapping_sub(position);
        let (data, counter) = master.exchange(1, at, register, &[0; 2]);
        assert_eq!(counter, 1);
        u16::from_le_bytes([data[0], data[1]])
    };
    assert_eq!(registers(1, 0x0010), 0);
    assert_eq!(registers(1, 0x0101) & 0xFF, 0);
    assert_eq!(registers(2, 0x0010), 0x1003, "the others keep their power");
}

#[test]
fn a_loss_of_power_between_two_frames_closes_the_port_in_front_as_well() {
    let mut master = line(2);
    control_port_1(&mut master, 0x1001, AUTO_CLOSE);
    let now = master.now;
    let device = master.segment.device_mut(1).unwrap();
    device.power_off();
    device.power_on(now);
    assert_eq!(answer(&mut master), 1);
    assert_eq!(shown(&mut master, 0x1001, 1), LINKED_AND_CLOSED);
    assert_eq!(master.read::<2>(0x1001, 0x0310), [0, 1]);
}

#[test]
fn the_receive_time_of_a_closed_port_is_0() {
    let mut master = line(2);
    master.now = Duration::from_millis(5);
    let port_1 = |master: &mut Master| {
        master.exchange(BWR, 0, 0x0900, &[0; 4]);
        let times: [u8; 8] = master.read(0x1001, 0x0900);
        times[4..] != [0; 4]
    };
    assert!(port_1(&mut master));
    control_port_1(&mut master, 0x1001, CLOSED);
    assert!(!port_1(&mut master));
}
