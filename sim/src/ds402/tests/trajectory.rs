//! Properties of the trapezoid.

use proptest::prelude::*;

use super::super::trajectory::{Bounds, Shape, Trajectory};

const DT: f64 = 0.001;

/// Ramps take from a millisecond to ten seconds up to the velocity, so that every plan ends in reasonable time.
fn bounds() -> impl Strategy<Value = Bounds> {
    let ramps = (-1.0..3.0_f64, -1.0..3.0_f64, any::<bool>());
    (10.0..1e6_f64, ramps).prop_map(|(velocity, (up, down, smooth))| Bounds {
        shape: if smooth {
            Shape::SinSquared
        } else {
            Shape::Linear
        },
        velocity,
        end_velocity: 0.0,
        acceleration: velocity * 10_f64.powf(up),
        deceleration: velocity * 10_f64.powf(down),
    })
}

/// Steps until the plan is done; `check` sees (velocity before, trajectory after) each step.
fn run(trajectory: &mut Trajectory, mut check: impl FnMut(f64, f64, &Trajectory)) -> u32 {
    for steps in 0..3_000_000 {
        if trajectory.is_done() {
            return steps;
        }
        let (position, velocity) = (trajectory.position(), trajectory.velocity());
        trajectory.advance(DT);
        check(position, velocity, trajectory);
    }
    panic!("does not arrive");
}

/// A target that is not so far that a slow profile takes for ever.
fn near(bounds: &Bounds, share: f64) -> i64 {
    (bounds.velocity * 20.0 * share) as i64
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// With a speed at which ramps start and end: never slower while it moves, at the target in the end, whatever came
    /// between.
    #[test]
    fn between_standstills_it_is_never_slower_than_its_start_and_stop_speed(
        bounds in bounds(),
        floor in 0.0..1.5_f64,
        moves in prop::collection::vec((-1.0..1.0_f64, 0..500_u32, any::<bool>()), 1..5),
    ) {
        let bounds = Bounds { shape: Shape::Linear, ..bounds };
        let mut trajectory = Trajectory::at(0);
        trajectory.set_floor(floor * bounds.velocity);
        let slowest = bounds.velocity * floor.min(1.0) * (1.0 - 1e-9);
        let check = |trajectory: &Trajectory| {
            let speed = trajectory.velocity().abs();
            assert!(speed == 0.0 || (slowest..=bounds.velocity * (1.0 + 1e-9)).contains(&speed));
        };
        let mut target = 0;
        for (share, steps, halted) in moves {
            target = near(&bounds, share);
            trajectory.run_to(target, bounds);
            for _ in 0..steps {
                trajectory.advance(DT);
                check(&trajectory);
            }
            if halted {
                trajectory.stop(bounds.deceleration, bounds.shape);
                run(&mut trajectory, |_, _, after| check(after));
                prop_assert!(trajectory.stands());
                trajectory.run_to(target, bounds);
            }
        }
        run(&mut trajectory, |_, _, after| check(after));
        prop_assert_eq!(trajectory.counts(), target);
        prop_assert!(trajectory.stands());
    }

    #[test]
    fn from_standstill_it_arrives_exactly_monotonically_and_within_its_bounds(
        bounds in bounds(), share in -1.0..1.0_f64, start in -1_000_000..1_000_000_i64,
    ) {
        let target = start + near(&bounds, share);
        let mut trajectory = Trajectory::at(start);
        trajectory.run_to(target, bounds);
        let direction = (target - start).signum() as f64;
        run(&mut trajectory, |position, velocity, after| {
            let (was, is) = (velocity * direction, after.velocity() * direction);
            assert!((-1e-6..=bounds.velocity * (1.0 + 1e-9)).contains(&is));
            assert!(is - was <= bounds.acceleration * DT * (1.0 + 1e-6) + 1e-6);
            assert!(was - is <= bounds.deceleration * DT * (1.0 + 1e-6) + 1e-6);
            assert!((after.position() - position) * direction >= -1e-6);
        });
        prop_assert_eq!(trajectory.position(), target as f64);
        prop_assert_eq!(trajectory.velocity(), 0.0);
    }

    #[test]
    fn replanned_at_any_moment_it_never_exceeds_a_ramp_and_arrives(
        first in bounds(), second in bounds(), shares in (-1.0..1.0_f64, -1.0..1.0_f64), at in 1..5000_u32,
    ) {
        let mut trajectory = Trajectory::at(0);
        trajectory.run_to(near(&first, shares.0), first);
        for _ in 0..at {
            trajectory.advance(DT);
        }
        let top = trajectory.velocity().abs().max(second.velocity);
        let target = trajectory.counts() + near(&second, shares.1);
        // A slow second profile takes long to brake the first and to come back: bound what is tried.
        let overshoot = trajectory.velocity().powi(2) / (2.0 * second.deceleration);
        prop_assume!(trajectory.velocity().abs() / second.deceleration < 100.0);
        prop_assume!(overshoot / second.velocity < 500.0);
        trajectory.run_to(target, second);
        let steepest = second.acceleration.max(second.deceleration);
        run(&mut trajectory, |_, velocity, after| {
            assert!(after.velocity().abs() <= top * (1.0 + 1e-9));
            assert!((after.velocity() - velocity).abs() <= steepest * DT * (1.0 + 1e-6) + 1e-6);
        });
        prop_assert_eq!(trajectory.position(), target as f64);
        prop_assert_eq!(trajectory.velocity(), 0.0);
    }

    #[test]
    fn a_stop_ends_standing_within_its_way(bounds in bounds(), at in 1..5000_u32) {
        let mut trajectory = Trajectory::at(0);
        trajectory.run_to(near(&bounds, 1.0), bounds);
        for _ in 0..at {
            trajectory.advance(DT);
        }
        let (position, velocity) = (trajectory.position(), trajectory.velocity());
        prop_assume!(velocity / bounds.deceleration < 1000.0);
        trajectory.stop(bounds.deceleration, bounds.shape);
        run(&mut trajectory, |_, _, _| {});
        prop_assert_eq!(trajectory.velocity(), 0.0);
        let way = velocity * velocity / (2.0 * bounds.shape.mean(bounds.deceleration));
        prop_assert!((trajectory.position() - position - way).abs() <= 1e-6 * (1.0 + way));
    }
}

#[test]
fn a_trapezoid_takes_the_time_of_its_three_parts() {
    let mut trajectory = Trajectory::at(0);
    let bounds = Bounds {
        shape: Shape::Linear,
        velocity: 1000.0,
        end_velocity: 0.0,
        acceleration: 1000.0,
        deceleration: 2000.0,
    };
    trajectory.run_to(2000, bounds);
    // 1 s up over 500, 0.5 s down over 250, 1250 at 1000/s.
    assert_eq!(run(&mut trajectory, |_, _, _| {}), 2750);
}

#[test]
fn a_lower_velocity_brakes_down_to_it_first() {
    let mut trajectory = Trajectory::at(0);
    let fast = Bounds {
        shape: Shape::Linear,
        velocity: 1000.0,
        end_velocity: 0.0,
        acceleration: 1000.0,
        deceleration: 1000.0,
    };
    trajectory.run_to(10_000, fast);
    for _ in 0..2000 {
        trajectory.advance(DT);
    }
    trajectory.run_to(
        10_000,
        Bounds {
            velocity: 200.0,
            ..fast
        },
    );
    for _ in 0..801 {
        trajectory.advance(DT);
    }
    assert!((trajectory.velocity() - 200.0).abs() < 1e-9);
}

#[test]
fn a_target_that_cannot_be_met_in_time_is_overshot_and_met_from_beyond() {
    let mut trajectory = Trajectory::at(0);
    let bounds = Bounds {
        shape: Shape::Linear,
        velocity: 1000.0,
        end_velocity: 0.0,
        acceleration: 1000.0,
        deceleration: 1000.0,
    };
    trajectory.run_to(10_000, bounds);
    for _ in 0..2000 {
        trajectory.advance(DT);
    }
    let target = trajectory.counts() + 10;
    trajectory.run_to(target, bounds);
    let mut furthest = f64::MIN;
    run(&mut trajectory, |_, _, after| {
        furthest = furthest.max(after.position());
    });
    assert!((furthest - (target as f64 + 490.0)).abs() < 1.0);
    assert_eq!(trajectory.counts(), target);
}

#[test]
fn coordinates_that_shift_under_way_take_the_target_with_them() {
    let mut trajectory = Trajectory::at(0);
    let bounds = Bounds {
        shape: Shape::Linear,
        velocity: 1000.0,
        end_velocity: 0.0,
        acceleration: 1000.0,
        deceleration: 1000.0,
    };
    trajectory.run_to(3000, bounds);
    for _ in 0..1500 {
        trajectory.advance(DT);
    }
    trajectory.shift(-700);
    let left = run(&mut trajectory, |_, velocity, after| {
        assert!((after.velocity() - velocity).abs() <= 1.0 + 1e-6);
    });
    assert_eq!((left, trajectory.position()), (2500, 2300.0));
}

#[test]
fn a_plan_without_acceleration_is_never_done_and_never_moves() {
    let mut trajectory = Trajectory::at(5);
    let bounds = Bounds {
        shape: Shape::Linear,
        velocity: 10.0,
        end_velocity: 0.0,
        acceleration: 0.0,
        deceleration: 10.0,
    };
    trajectory.run_to(100, bounds);
    assert_eq!(trajectory.advance(1000.0), 1000.0);
    assert!(!trajectory.is_done() && trajectory.stands());
    assert_eq!(trajectory.counts(), 5);
}
