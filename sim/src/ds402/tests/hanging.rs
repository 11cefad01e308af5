//! A load that hangs on the axis, and the brake on 60FEh.

use core::time::Duration;

use super::super::{Behaviour, Machine, MachineBrake, Opener, Plant, State};
use super::Bench;

/// One g at 1000 counts a millimetre.
const GRAVITY: u32 = 9_806_650;
const CLOSES_IN: Duration = Duration::from_millis(50);

/// A lift 200 mm above the floor.
fn lift() -> Behaviour {
    let mut behaviour = Behaviour::generic();
    behaviour.machine = Machine {
        gravity: GRAVITY,
        brake: Some(MachineBrake::new(CLOSES_IN)),
        ends: Some((-200_000, i64::MAX)),
        ..Machine::default()
    };
    behaviour
}

impl Bench {
    /// Writes the physical outputs and their mask.
    fn outputs(&mut self, outputs: i64, mask: i64) {
        self.axis.set(0x60FE, 1, outputs).unwrap();
        self.axis.set(0x60FE, 2, mask).unwrap();
    }

    /// Switches it on, and commands Operation enabled.
    fn asks_for_operation(&mut self) {
        for word in [0x0006, 0x0007, 0x000F] {
            self.word(word);
            self.run(2);
        }
    }
}

#[test]
fn the_brake_is_open_where_the_mask_enables_its_output_and_bit_0_is_low() {
    for (outputs, mask, open) in [
        (0, 0, false),
        (1, 0, false),
        (1, 1, false),
        (0, 1, true),
        (0xFFFF_FFFE, 1, true),
        (0, 0xFFFF_FFFE, false),
    ] {
        let mut bench = Bench::new(lift());
        bench.outputs(outputs, mask);
        bench.run(100);
        assert_eq!(!bench.axis.is_braked(), open, "{outputs:X} {mask:X}");
        assert_eq!(bench.axis.position() < -1_000, open, "{outputs:X} {mask:X}");
    }
}

#[test]
fn a_load_that_nobody_holds_falls_as_far_as_it_can() {
    let mut bench = Bench::new(lift());
    bench.outputs(0, 1);
    bench.run(100);
    // ½ g t².
    assert!((bench.axis.position() + 49_033).abs() < 10);
    assert!((bench.axis.velocity() + 980_665.0).abs() < 1.0);
    bench.run(200);
    assert_eq!(bench.axis.position(), -200_000);
    assert!(bench.axis.stands());
    // The floor carries it.
    bench.run(100);
    assert_eq!(bench.axis.position(), -200_000);
}

#[test]
fn a_brake_takes_its_time_to_close() {
    let mut bench = Bench::new(lift());
    bench.outputs(0, 1);
    bench.run(1);
    bench.outputs(1, 1);
    bench.run(50);
    assert!(!bench.axis.is_braked());
    bench.run(1);
    assert!(bench.axis.is_braked());
    let held = bench.axis.position();
    assert!((held + 12_258).abs() < 1_000, "{held}");
    bench.run(100);
    assert_eq!(bench.axis.position(), held);
    assert!(bench.axis.stands());
}

#[test]
fn an_enabled_axis_carries_its_load_and_lets_it_fall_without_power() {
    for plant in [Plant::ideal(), Plant::default()] {
        let mut bench = Bench::new(lift());
        bench.axis.set_plant(plant);
        bench.enable();
        bench.outputs(0, 1);
        bench.run(500);
        assert!(bench.axis.position().abs() < 10);
        bench.start(0x000F, 5_000);
        bench.run(3_000);
        assert!((bench.axis.position() - 5_000).abs() < 10);
        bench.word(0x0006);
        bench.run(100);
        assert!(bench.axis.position() < -10_000);
    }
}

#[test]
fn an_axis_that_is_driven_against_its_brake_stays_and_has_a_following_error() {
    let mut bench = Bench::new(lift());
    bench.enable();
    bench.outputs(1, 1);
    bench.set(0x6065, 1_000);
    bench.start(0x000F, 50_000);
    bench.run(3_000);
    assert_eq!(bench.axis.position(), 0);
    assert_eq!(bench.axis.state(), State::Fault);
}

#[test]
fn without_power_the_spring_holds_the_load() {
    let mut bench = Bench::new(lift());
    bench.enable();
    bench.outputs(0, 1);
    bench.run(100);
    bench.axis = bench.axis.restarted();
    bench.run(200);
    assert!(bench.axis.is_braked());
    assert_eq!(bench.axis.mechanical_position(), 0);
}

/// Where the load was in each cycle, as far below its start.
fn fallen(bench: &mut Bench, cycles: u32) -> i64 {
    let start = bench.axis.mechanical_position();
    let mut deepest = 0;
    for _ in 0..cycles {
        bench.run(1);
        deepest = deepest.max(start - bench.axis.mechanical_position());
    }
    deepest
}

fn managed() -> Behaviour {
    let mut behaviour = lift();
    behaviour.machine.brake = Some(MachineBrake {
        opens_in: Duration::from_millis(30),
        opened_by: Opener::Drive,
        feedback: Some(17),
        ..MachineBrake::new(CLOSES_IN)
    });
    behaviour
}

#[test]
fn a_drive_opens_its_brake_before_it_shows_operation_enabled_and_carries_the_load_until_it_is_closed()
 {
    let mut bench = Bench::new(managed());
    bench.asks_for_operation();
    bench.run(20);
    assert_eq!(bench.axis.state(), State::SwitchedOn);
    assert!(bench.axis.is_braked());
    bench.run(20);
    assert_eq!(bench.axis.state(), State::OperationEnabled);
    assert!(!bench.axis.is_braked());
    assert_eq!(bench.axis.get(0x60FD, 0), Some(1 << 17));
    bench.word(0x0000);
    bench.run(10);
    assert_eq!(bench.axis.state(), State::SwitchOnDisabled);
    assert!(!bench.axis.is_braked());
    assert_eq!(fallen(&mut bench, 200), 0);
    assert!(bench.axis.is_braked());
    assert_eq!(bench.axis.get(0x60FD, 0), Some(0));
}

#[test]
fn without_its_supply_a_drive_carries_nothing_until_the_brake_has_closed() {
    let mut bench = Bench::new(managed());
    bench.asks_for_operation();
    bench.run(100);
    bench.axis.set_inhibited(true);
    let fallen = fallen(&mut bench, 200);
    // ½ g t² of 50 ms, and the cycles around it.
    assert!((11_000..14_000).contains(&fallen), "{fallen}");
}

#[test]
fn a_brake_that_sticks_stays_as_it_is() {
    let mut bench = Bench::new(managed());
    bench.axis.disturbances().brake_sticks = true;
    bench.asks_for_operation();
    bench.run(200);
    assert_eq!(bench.axis.state(), State::SwitchedOn);
    bench.axis.disturbances().brake_sticks = false;
    bench.run(100);
    assert_eq!(bench.axis.state(), State::OperationEnabled);
    bench.axis.disturbances().brake_sticks = true;
    bench.word(0x0000);
    assert!(fallen(&mut bench, 300) > 100_000);
    assert!(!bench.axis.is_braked());
}

#[test]
fn a_brake_on_a_makers_output_opens_by_its_level_and_its_drive_may_close_it() {
    for closed_by_drive in [false, true] {
        let mut behaviour = lift();
        behaviour.machine.brake = Some(MachineBrake {
            opens_in: Duration::from_millis(30),
            opened_by: Opener::Output {
                bit: 16,
                level: true,
                closed_by_drive,
            },
            ..MachineBrake::new(CLOSES_IN)
        });
        let mut bench = Bench::new(behaviour);
        bench.enable();
        bench.outputs(1 << 16, 1 << 16);
        bench.run(29);
        assert!(bench.axis.is_braked());
        bench.run(2);
        assert!(!bench.axis.is_braked());
        bench.axis.inject_fault(0x2310);
        bench.run(200);
        assert_eq!(bench.axis.is_braked(), closed_by_drive);
    }
}
