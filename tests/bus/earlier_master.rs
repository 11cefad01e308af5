//! What devices hold when a bring-up begins, from an earlier program or of their own: the EEPROM, alias addressing, closed ports; and
//! cables that make no line.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use servocrab::{Network, NetworkError, bus::Recovered, drives, link::Wire};
use servocrab_sim::{AlState, Segment, personality};

use crate::rig::{Line, Rig, akd2g, datagrams, unhomed};

/// Registers that a bring-up of a whole line writes, and a recovery does not: alias addressing, ports.
const ALIAS_ADDRESSING: u16 = 0x0103;
const PORTS: u16 = 0x0101;

/// A write to a register: its command (2 by position, 5 by station address, 8 to all), register and first byte; of a command to the
/// EEPROM the word.
type Written = (u8, u16, u16);

/// A wire that notes what is written to 0100h–0103h, 0120h and 0500h–0503h.
fn noting_wire(line: &Line) -> (Wire, Arc<Mutex<Vec<Written>>>) {
    let written = Arc::new(Mutex::new(Vec::new()));
    let noted = Arc::clone(&written);
    let wire = line.spoiled_wire(move |frame| {
        for datagram in datagrams(frame) {
            let register = u16::from_le_bytes([datagram[4], datagram[5]]);
            let is_write = matches!(datagram[0], 2 | 5 | 8);
            if is_write && matches!(register, 0x0100..=0x0103 | 0x0120 | 0x0500..=0x0503) {
                let value = match register {
                    0x0502 => u16::from_le_bytes([datagram[12], datagram[13]]),
                    _ => datagram[10].into(),
                };
                noted.lock().unwrap().push((datagram[0], register, value));
            }
        }
    });
    (wire, written)
}

/// Writes to a register of the device at this position, as another master would before.
fn poke(line: &Line, position: u16, register: u16, value: u8) {
    let [p0, p1] = 0u16.wrapping_sub(position).to_le_bytes();
    let [r0, r1] = register.to_le_bytes();
    let mut frame = vec![0xFF; 6];
    frame.extend([2, 0, 0, 0, 0, 1, 0x88, 0xA4, 13, 0x10]);
    frame.extend([2, 0, p0, p1, r0, r1, 1, 0, 0, 0, value, 0, 0]);
    frame.resize(60, 0);
    assert!(line.segment().process(&mut frame, Duration::ZERO));
    assert_eq!(frame[27], 1, "the device has taken it");
}

fn two_drives(line: &Line) -> Result<Rig, NetworkError> {
    let builder = Network::builder().link(line.wire());
    let second = unhomed(drives::akd2g(), &["z", "w"]);
    Rig::start(builder.drive(0, akd2g()).drive(1, second))
}

/// Two AKD2Gs, the second with this alias.
fn two(alias: u16) -> Line {
    let second = personality::Servo::akd2g().alias(alias).build();
    Line::new(Segment::new().with(personality::akd2g()).with(second))
}

/// That the EEPROM is read before PREOP is asked for, and belongs to the device when it is.
fn eeprom_is_given_away_in_init(written: &[Written]) {
    let pre_op = written.iter().position(|write| *write == (5, 0x0120, 2));
    let (before, behind) = written.split_at(pre_op.unwrap());
    let owner = before.iter().rfind(|write| write.1 == 0x0500).unwrap();
    assert_eq!(owner.2, 1, "it is the device's");
    assert!(before.iter().any(|write| write.1 == 0x0502), "it is read");
    assert!(
        !behind.iter().any(|write| write.1 == 0x0502),
        "nothing is read of it from PREOP on"
    );
}

#[test]
fn the_eeprom_is_the_drives_own_from_init_on_in_a_start() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let (wire, written) = noting_wire(&line);
    let rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    eeprom_is_given_away_in_init(&written.lock().unwrap());
    rig.shutdown();
}

#[test]
fn the_eeprom_is_the_drives_own_from_init_on_in_a_scan() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let (wire, written) = noting_wire(&line);
    let scanned = smol::block_on(Network::builder().link(wire).scan()).unwrap();
    let device = &scanned.devices()[0];
    assert!(device.problem.is_none(), "{:?}", device.problem);
    assert!(device.sdo.is_some());
    eeprom_is_given_away_in_init(&written.lock().unwrap());
    let written = written.lock().unwrap();
    let words = written.iter().filter(|write| write.1 == 0x0502);
    let mut words: Vec<_> = words.map(|write| write.2).collect();
    words.sort_unstable();
    assert!(
        words.windows(2).all(|pair| pair[0] < pair[1]),
        "no word is asked for twice: {words:?}"
    );
}

#[test]
fn a_drive_on_its_way_back_keeps_its_eeprom_and_the_line_its_ports() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let (wire, written) = noting_wire(&line);
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    rig.loses_power(&line, 0);
    written.lock().unwrap().clear();
    let recovered = rig.recover(0).unwrap();
    assert!(matches!(recovered, Recovered::BroughtUp { .. }));
    let written = written.lock().unwrap().clone();
    eeprom_is_given_away_in_init(&written);
    assert!(!written.iter().any(|(command, ..)| *command == 8));
    let of_the_line = [ALIAS_ADDRESSING, PORTS];
    assert!(
        !written
            .iter()
            .any(|(_, register, _)| of_the_line.contains(register))
    );
    // Who it is, when it is looked for and again in INIT: the rest is known.
    let accesses = line.segment().device(0).unwrap().sii_accesses();
    assert!(accesses <= 4, "{accesses} accesses to the SII");
}

#[test]
fn an_eeprom_that_the_drives_processor_does_not_let_go_is_taken_by_force() {
    let line = Line::new(Segment::new().with(personality::akd2g()));
    line.segment().device_mut(0).unwrap().hold_eeprom();
    let (wire, written) = noting_wire(&line);
    let mut rig = Rig::start(Network::builder().link(wire).drive(0, akd2g())).unwrap();
    let owners: Vec<_> = {
        let written = written.lock().unwrap();
        let owners = written.iter().filter(|write| write.1 == 0x0500);
        owners.map(|write| (write.0, write.2)).collect()
    };
    assert_eq!(owners, [(8, 0), (5, 2), (5, 0), (5, 1)]);
    rig.moves_each(&line, &["x", "y"]);
    rig.shutdown();
}

#[test]
fn an_alias_that_is_the_address_of_another_device_is_no_address_in_a_bring_up() {
    let line = two(0x1000);
    for position in 0..2 {
        poke(&line, position, ALIAS_ADDRESSING, 1);
    }
    let rig = two_drives(&line).unwrap();
    let states = line.segment();
    assert!(
        states
            .devices()
            .iter()
            .all(|device| device.al_state() == AlState::Op)
    );
    drop(states);
    rig.shutdown();
}

#[test]
fn a_port_that_an_earlier_master_has_closed_is_open_again() {
    let line = two(0);
    // Port 1 of the first: the second is behind it.
    poke(&line, 0, PORTS, 0x0C);
    let (wire, written) = noting_wire(&line);
    let second = unhomed(drives::akd2g(), &["z", "w"]);
    let builder = Network::builder().link(wire);
    let rig = Rig::start(builder.drive(0, akd2g()).drive(1, second)).unwrap();
    // In this order, to all, and once more for the one that was behind the port.
    let of_the_line = |(command, register, _): &&Written| {
        *command == 8 && matches!(*register, ALIAS_ADDRESSING | 0x0120 | PORTS)
    };
    let written = written.lock().unwrap();
    let once = [(8, ALIAS_ADDRESSING, 0), (8, 0x0120, 0x11), (8, PORTS, 0)];
    let resets: Vec<_> = written.iter().filter(of_the_line).copied().collect();
    assert_eq!(resets, [once, once].concat());
    drop(written);
    rig.shutdown();
}

#[test]
fn a_line_that_does_not_become_steady_is_refused_with_its_counts() {
    let line = two(0);
    let shared = line.0.clone();
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        let mut segment = shared.lock().unwrap();
        if now.as_millis() / 20 % 2 == 0 {
            segment.unplug(1);
        } else {
            segment.plug();
        }
        segment.process(frame, now)
    });
    let error = Rig::start(Network::builder().link(wire).drive(0, akd2g())).err();
    let error = error.unwrap();
    let NetworkError::UnsteadyLine { before, now } = error else {
        panic!("{error}");
    };
    assert!(before != now && before <= 2 && now <= 2, "{before}, {now}");
}

#[test]
fn a_ring_is_refused_by_name() {
    let line = two(0);
    line.segment().plug_end_into(0, 2);
    let error = two_drives(&line).err().unwrap();
    assert!(
        matches!(
            error,
            NetworkError::Ring {
                position: 1,
                port: 1
            }
        ),
        "{error}"
    );
    let states = line.segment();
    let not_one = |device: &servocrab_sim::Device| device.al_state() == AlState::Init;
    assert!(states.devices().iter().all(not_one));
}
