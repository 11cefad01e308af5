//! Homing and profile velocity over the wire, on every drive that has them.

use servocrab_sim::ds402::{HomingOutcome, Machine, State, VelocityEnd};
use servocrab_sim::personality::Servo;

use crate::master::Master;

/// What the test maps: outputs, and inputs; index and bits.
const OUTPUTS: [(u16, u8); 4] = [(0x6040, 16), (0x6060, 8), (0x6098, 8), (0x607A, 32)];
const DRIVING: [(u16, u8); 3] = [(0x6040, 16), (0x6060, 8), (0x60FF, 32)];
const INPUTS: [(u16, u8); 4] = [(0x6041, 16), (0x6061, 8), (0x6064, 32), (0x60FD, 32)];

fn machine() -> Machine {
    Machine {
        start: 2_000,
        negative_limit: Some(-1_000),
        positive_limit: Some(90_000),
        ..Machine::default()
    }
}

/// A drive in OP with this mapping in its first PDOs.
fn drive(servo: Servo, outputs: &[(u16, u8)]) -> Master {
    let mut master = Master::of(
        servo
            .change(|behaviour| behaviour.machine = machine())
            .build(),
    );
    master.bring_to_preop();
    map(&mut master, 0x1C12, 0x1600, outputs);
    map(&mut master, 0x1C13, 0x1A00, &INPUTS);
    let bytes = |list: &[(u16, u8)]| list.iter().map(|(_, bits)| u16::from(bits / 8)).sum();
    master.lengths = (bytes(outputs), bytes(&INPUTS));
    master
}

fn map(master: &mut Master, assignment: u16, pdo: u16, objects: &[(u16, u8)]) {
    assert_eq!(master.download(assignment, 0, &[0]), Ok(()));
    assert_eq!(master.download(pdo, 0, &[0]), Ok(()));
    for (subindex, (index, bits)) in (1..).zip(objects) {
        let entry = u32::from(*index) << 16 | u32::from(*bits);
        assert_eq!(
            master.download(pdo, subindex, &entry.to_le_bytes()),
            Ok(()),
            "{index:04X}h"
        );
    }
    assert_eq!(master.download(pdo, 0, &[objects.len() as u8]), Ok(()));
    assert_eq!(master.download(assignment, 1, &pdo.to_le_bytes()), Ok(()));
    assert_eq!(master.download(assignment, 0, &[1]), Ok(()));
}

/// Statusword, mode, position and digital inputs.
fn read(inputs: &[u8]) -> (u16, u8, i32, u32) {
    let word = |at: usize| u32::from_le_bytes(inputs[at..at + 4].try_into().unwrap());
    let statusword = u16::from_le_bytes([inputs[0], inputs[1]]);
    (statusword, inputs[2], word(3).cast_signed(), word(7))
}

fn speeds(master: &mut Master) {
    for (index, subindex, value) in [
        (0x6099, 1, 50_000_u32),
        (0x6099, 2, 5_000),
        (0x609A, 0, 1_000_000),
        (0x607C, 0, 700),
    ] {
        assert_eq!(
            master.download(index, subindex, &value.to_le_bytes()),
            Ok(())
        );
    }
}

#[test]
fn every_drive_homes_at_its_limit_switch_and_forgets_it_without_power() {
    // What the home position reads with 700 in 607Ch.
    for (servo, reads) in [
        (Servo::pp2010(), 700),
        (Servo::ax2000(), 700),
        (Servo::sigma7(), -700),
        (Servo::generic(), 700),
    ] {
        let mut master = drive(servo, &OUTPUTS);
        speeds(&mut master);
        master.bring_to_op(0x24);
        let outputs = |word: u8| [word, 0, 6, 17, 0, 0, 0, 0];
        for word in [0x06, 0x07, 0x0F] {
            for _ in 0..5 {
                master.cycle(&outputs(word));
            }
        }
        let mut switched = false;
        let mut last = (0, 0, 0, 0);
        for _ in 0..1_000 {
            last = read(&master.cycle(&outputs(0x1F)));
            switched |= last.3 == 1;
            if last.0 & 0x3400 == 0x1400 {
                break;
            }
        }
        assert!(switched, "bit 0 of 60FDh was seen");
        assert_eq!(last.0 & 0x3400, 0x1400, "attained, standing");
        assert_eq!(last.1, 6);
        let axis = master.segment.axis(0, 0).expect("an axis");
        let [homing] = axis.homings() else {
            panic!("one homing")
        };
        assert_eq!(homing.outcome, HomingOutcome::Attained);
        assert_eq!(homing.home, Some(-999));
        assert!(axis.is_referenced());
        let shift = axis.mechanical_position() - i64::from(last.2);
        assert_eq!(shift, -999 - reads);

        let (now, stood) = (master.now, axis.mechanical_position());
        let device = master.segment.device_mut(0).expect("a drive");
        device.power_off();
        device.power_on(now);
        let axis = master.segment.axis(0, 0).expect("an axis");
        assert!(!axis.is_referenced());
        assert_eq!((axis.position(), axis.mechanical_position()), (0, stood));
    }
}

#[test]
fn a_velocity_runs_until_the_watchdog_stops_it() {
    for servo in [Servo::ax2000(), Servo::sigma7(), Servo::generic()] {
        let mut master = drive(servo, &DRIVING);
        master.bring_to_op(0x64);
        let outputs = |word: u8, velocity: i32| {
            let mut bytes = vec![word, 0, 3];
            bytes.extend(velocity.to_le_bytes());
            bytes
        };
        for word in [0x06, 0x07, 0x0F] {
            for _ in 0..5 {
                master.cycle(&outputs(word, 0));
            }
        }
        for _ in 0..200 {
            master.cycle(&outputs(0x0F, -20_000));
        }
        let axis = master.segment.axis(0, 0).expect("an axis");
        assert_eq!(axis.velocity(), -20_000.0);
        assert_eq!(axis.get(0x6061, 0), Some(3));
        // Nobody sends: the process-data watchdog ends OP, and 6007h stops the axis.
        let silent = master.now + core::time::Duration::from_secs(2);
        master.segment.advance(silent);
        let axis = master.segment.axis(0, 0).expect("an axis");
        assert_eq!((axis.velocity(), axis.state()), (0.0, State::Fault));
        let [phase] = axis.velocity_phases() else {
            panic!("one velocity")
        };
        assert_eq!(phase.target, -20_000);
        assert!(matches!(phase.end, VelocityEnd::Discarded(_)));
    }
}
