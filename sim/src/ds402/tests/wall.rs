//! What the axis presses against: a wall, its torque limits, and peaks of friction.

use core::time::Duration;

use super::super::{Axis, Behaviour, Machine, Plant, SetError, State};
use super::Bench;

const MS: Duration = Duration::from_millis(1);

/// Nothing random. The loop asks for 1 ‰ per count at rest: ω² = 10 000/s².
fn soft() -> Plant {
    Plant {
        cycle: Duration::ZERO,
        bandwidth_hz: 100.0 / core::f64::consts::TAU,
        damping: 1.0,
        feed_forward: 0.95,
        dither: 0,
        load_step: 0,
        start_delay: Duration::ZERO,
        rated_acceleration: 10_000_000,
        ..Plant::default()
    }
}

impl Bench {
    fn with(plant: Plant) -> Bench {
        let mut bench = Bench::enabled(Behaviour::generic());
        bench.axis.set_plant(plant);
        bench
    }

    fn get(&self, index: u16) -> i64 {
        self.axis.get(index, 0).unwrap()
    }
}

#[test]
fn a_wall_that_is_not_reached_changes_no_bit() {
    for seed in 0..20 {
        for (target, wall) in [(9_000, 9_100), (-9_000, -9_100), (9_000, -1_000)] {
            let shown = |wall: Option<i64>| {
                let mut bench = Bench::with(Plant::seeded(seed));
                if let Some(wall) = wall {
                    bench.axis.put_wall(wall, 2.0);
                }
                bench.start(0x0F, target);
                let mut shown = Vec::new();
                for _ in 0..2_500 {
                    bench.run(1);
                    let objects = [0x6041, 0x6062, 0x6064, 0x606C, 0x6077, 0x60F4];
                    let shaft = (bench.axis.position(), bench.axis.velocity().to_bits());
                    shown.push((objects.map(|index| bench.get(index)), shaft));
                }
                assert!((bench.axis.position() - target).abs() < 20);
                shown
            };
            assert!(shown(Some(wall)) == shown(None), "{seed} {target}");
        }
    }
}

#[test]
fn pressing_ends_at_max_torque_and_never_reaches_the_target() {
    for plant in [Plant::ideal(), soft()] {
        for way in [1, -1] {
            let mut bench = Bench::with(plant);
            bench.set(0x6072, 300);
            bench.axis.put_wall(way * 2_000, 0.5);
            bench.start(0x0F, way * 10_000);
            let (mut before, mut contact) = (0, false);
            for _ in 0..3_000 {
                bench.run(1);
                let torque = way * bench.get(0x6077);
                contact |= way * bench.axis.position() > 2_000;
                assert!(torque <= 300, "{torque}");
                assert!(!contact || torque >= before, "{torque} after {before}");
                assert!(!bench.bit(10));
                // It stands although the demand goes on.
                assert!(before < 300 || bench.axis.velocity() == 0.0);
                before = if contact { torque } else { 0 };
            }
            assert_eq!(bench.get(0x6077), way * 300);
            assert_eq!(bench.get(0x6064), way * 2_600, "300 ‰ at 0.5 ‰ per count");
            assert_eq!(bench.get(0x606C), 0);
            assert_eq!(bench.get(0x60F4), way * 7_400);
            assert!(bench.axis.stands());
            assert_eq!(bench.axis.state(), State::OperationEnabled);
        }
    }
}

#[test]
fn below_the_limit_the_wall_and_the_loop_balance() {
    // The shaft gives way by the loop's 1 ‰ per count, the wall by 3 ‰ per count: together 0.75 ‰.
    let mut bench = Bench::with(soft());
    bench.axis.put_wall(2_000, 3.0);
    bench.start(0x0F, 2_400);
    bench.run(1_500);
    let shown = [0x6077, 0x6064, 0x60F4].map(|index| bench.get(index));
    assert_eq!(shown, [300, 2_100, 300]);
    // A shaft that is where its demand is presses it all in.
    let mut bench = Bench::with(Plant::ideal());
    bench.axis.put_wall(2_000, 3.0);
    bench.start(0x0F, 2_400);
    bench.run(1_500);
    let shown = [0x6077, 0x6064, 0x60F4].map(|index| bench.get(index));
    assert_eq!(shown, [1_200, 2_400, 0]);
}

#[test]
fn each_direction_has_its_own_limit_and_6072h_holds_for_both() {
    let refused = |index, value| {
        let mut axis = Axis::new(Behaviour::generic());
        axis.set(index, 0, value)
    };
    for index in [0x6072, 0x60E0, 0x60E1] {
        assert_eq!(refused(index, 65_536), Err(SetError::OutOfRange));
        assert_eq!(refused(index, -1), Err(SetError::OutOfRange));
        assert_eq!(refused(index, 65_535), Ok(()));
    }
    for (most, positive, negative, expected) in [
        (3_000, 3_000, 3_000, (3_000, -3_000)),
        (300, 3_000, 3_000, (300, -300)),
        (300, 100, 200, (100, -200)),
        (300, 5_000, 200, (300, -200)),
        (65_535, 50, 0, (50, 0)),
    ] {
        let pressed = |way: i64| {
            let mut bench = Bench::with(Plant::ideal());
            bench.set(0x6072, most);
            bench.set(0x60E0, positive);
            bench.set(0x60E1, negative);
            bench.axis.put_wall(way * 100, 10.0);
            bench.start(0x0F, way * 2_000);
            bench.run(2_000);
            bench.get(0x6077)
        };
        assert_eq!((pressed(1), pressed(-1)), expected);
    }
    // DSP 402 v2 has the one limit only.
    let ax2000 = Axis::new(Behaviour::ax2000());
    assert_eq!(ax2000.get(0x6072, 0), Some(3_000));
    assert_eq!(ax2000.get(0x60E0, 0), None);
}

#[test]
fn the_shaft_meets_and_leaves_the_wall_without_a_jump() {
    // 100 counts behind a demand of 10 000 counts/s.
    let lagging = Plant {
        feed_forward: 0.5,
        ..soft()
    };
    for plant in [Plant::ideal(), soft(), lagging] {
        let mut bench = Bench::with(plant);
        bench.set(0x6072, 200);
        bench.axis.put_wall(2_000, 0.5);
        for (target, end) in [(4_000, 2_400), (0, 0)] {
            let mut torque = bench.get(0x6077);
            bench.start(0x0F, target);
            let mut before = bench.axis.position();
            for _ in 0..3_000 {
                bench.run(1);
                // 10 000 counts/s are 10 in a cycle.
                let step = (bench.axis.position() - before).abs();
                assert!(step <= 11, "{step} at {before}");
                before = bench.axis.position();
                if before > 2_000 {
                    let now = bench.get(0x6077);
                    assert!(now >= 0 && (target > 0 || now <= torque));
                    torque = now;
                }
            }
            assert_eq!(before, end);
            assert!(target > 0 || torque <= 5, "{torque}");
            assert_eq!(bench.bit(10), target == end);
        }
    }
}

#[test]
fn a_blocked_shaft_stays_in_the_wall() {
    let mut bench = Bench::with(soft());
    bench.set(0x6072, 200);
    bench.axis.put_wall(2_000, 0.5);
    bench.start(0x0F, 4_000);
    bench.run(2_000);
    bench.axis.disturbances().blocked = true;
    bench.start(0x0F, 2_100);
    bench.run(1_000);
    assert_eq!(bench.axis.position(), 2_400);
    bench.axis.disturbances().blocked = false;
    bench.run(1_000);
    assert!((2_000..2_100).contains(&bench.axis.position()));
}

#[test]
fn a_halt_leaves_the_torque_of_the_demand_at_which_it_stands() {
    let mut bench = Bench::with(soft());
    bench.axis.put_wall(2_000, 1.0);
    // A ramp so steep that the free shaft would run past its end by 100 counts.
    bench.set(0x6084, 1_000_000);
    bench.start(0x0F, 8_000);
    while bench.get(0x6077) < 200 || bench.axis.position() < 2_000 {
        bench.run(1);
    }
    bench.word(0x010F);
    let mut before = 0;
    for _ in 0..1_000 {
        bench.run(1);
        assert!(bench.get(0x6077) >= before, "it only grows");
        before = bench.get(0x6077);
    }
    assert!(bench.bit(10), "halted, it stands");
    let (demand, velocity) = bench.axis.demand();
    assert!(demand < 5_000, "{demand}");
    assert_eq!(velocity, 0.0);
    let torque = bench.get(0x6077);
    assert!((torque - (demand - 2_000) / 2).abs() <= 1, "{torque}");
    for _ in 0..200 {
        bench.run(1);
        assert_eq!(bench.get(0x6077), torque);
        assert_eq!(bench.axis.velocity(), 0.0);
    }
}

#[test]
fn at_the_torque_limit_the_following_error_grows_until_the_drive_faults() {
    let mut bench = Bench::with(soft());
    bench.set(0x6065, 1_000);
    bench.set(0x6066, 20);
    bench.set(0x6072, 100);
    bench.axis.put_wall(2_000, 1.0);
    bench.start(0x0F, 20_000);
    while bench.get(0x60F4) <= 1_000 {
        bench.run(1);
        assert_eq!(bench.axis.state(), State::OperationEnabled);
    }
    assert_eq!(bench.axis.position(), 2_100);
    bench.run(25);
    assert_eq!(bench.axis.state(), State::FaultReactionActive);
    bench.run(500);
    assert_eq!(bench.axis.state(), State::Fault);
    assert_eq!(bench.get(0x603F), 0x8611);
    // The wall pushes a shaft without power back to its face.
    assert_eq!((bench.axis.position(), bench.get(0x6077)), (2_000, 0));
    assert!(bench.axis.stands());
}

#[test]
fn an_axis_without_power_gets_as_far_as_the_wall() {
    for plant in [Plant::ideal(), soft()] {
        let mut bench = Bench::with(plant);
        bench.axis.put_wall(2_000, 1.0);
        bench.start(0x0F, 9_000);
        bench.run(300);
        bench.word(0x0000);
        bench.run(10);
        assert_eq!(bench.axis.position(), 2_000);
        // Enabled again it starts from there.
        bench.enable();
        assert_eq!((bench.axis.demand(), bench.get(0x6077)), ((2_000, 0.0), 0));
    }
    let mut behaviour = Behaviour::generic();
    behaviour.machine = Machine {
        gravity: 9_806_650,
        ..Machine::default()
    };
    let mut bench = Bench::new(behaviour);
    bench.axis.put_wall(bench.axis.position() - 3_000, 1.0);
    let floor = bench.axis.position() - 3_000;
    bench.run(500);
    assert_eq!(bench.axis.position(), floor);
}

#[test]
fn a_wall_stays_where_it_is_until_it_is_taken_away() {
    let mut behaviour = Behaviour::generic();
    behaviour.machine.start = 500;
    let mut bench = Bench::with(Plant::ideal());
    bench.axis = Axis::new(behaviour.with_plant(Plant::ideal()));
    bench.axis.put_wall(1_000, 1.0);
    let mut restarted = bench.axis.restarted();
    // A homing on the spot counts positions from elsewhere.
    for axis in [&mut bench.axis, &mut restarted] {
        assert_eq!(axis.mechanical_position(), 500);
        axis.shift_coordinates(200);
        assert_eq!(axis.position(), 300);
    }
    for axis in [bench.axis.clone(), restarted] {
        let mut bench = Bench {
            axis,
            now: Duration::ZERO,
        };
        bench.run(5);
        for (index, value) in [(0x6060, 1), (0x6081, 10_000), (0x6072, 100)] {
            bench.set(index, value);
        }
        bench.enable();
        bench.start(0x0F, 5_000);
        bench.run(2_000);
        // 1000 + 500 of the machine, less 200, and 100 into the wall.
        assert_eq!((bench.axis.position(), bench.get(0x6077)), (1_400, 100));
        bench.axis.take_wall_away();
        bench.run(1);
        assert_eq!((bench.axis.position(), bench.get(0x6077)), (5_000, 0));
    }
}

#[test]
fn a_friction_peak_is_seen_for_its_time_and_moves_nothing() {
    for plant in [Plant::ideal(), soft()] {
        for moving in [false, true] {
            let run = |peak: i16| {
                let mut bench = Bench::with(plant);
                if moving {
                    bench.start(0x0F, 20_000);
                }
                bench.run(500);
                bench.axis.inject_torque_peak(peak, 40 * MS);
                let mut seen = Vec::new();
                for _ in 0..100 {
                    bench.run(1);
                    seen.push((bench.get(0x6077), bench.get(0x6064)));
                }
                seen
            };
            let (without, with) = (run(0), run(-150));
            for (cycle, (a, b)) in without.iter().zip(&with).enumerate() {
                let extra = if cycle < 40 { -150 } else { 0 };
                assert_eq!((a.0 + extra, a.1), *b, "cycle {cycle}");
            }
        }
    }
    let mut bench = Bench::with(Plant::ideal());
    bench.set(0x60E0, 120);
    bench.axis.inject_torque_peak(500, 10 * MS);
    bench.run(1);
    assert_eq!(bench.get(0x6077), 120, "no more than the motor may give");
    bench.word(0x0000);
    bench.run(1);
    assert_eq!(bench.get(0x6077), 0, "without power there is none");
}
