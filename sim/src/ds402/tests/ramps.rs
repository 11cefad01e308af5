//! Ramps of 6086h = 1: sin² in shape, and exact in all that holds for linear ones.

use core::f64::consts::FRAC_PI_2;

use proptest::prelude::*;

use super::super::{Behaviour, Outcome};
use super::Bench;

const BOTH: &[i16] = &[0, 1];

fn smooth() -> Behaviour {
    Behaviour {
        profile_types: BOTH,
        ..Behaviour::generic()
    }
}

/// An axis in profile position mode with sin² ramps.
fn bench() -> Bench {
    let mut bench = Bench::enabled(smooth());
    bench.set(0x6086, 1);
    bench
}

/// Runs one cycle and demands the ramps: at most 100 counts/s in a cycle up, 50 down.
fn step(bench: &mut Bench) {
    let before = bench.axis.velocity();
    bench.run(1);
    let now = bench.axis.velocity();
    let most = if now.abs() > before.abs() {
        100.0
    } else {
        50.0
    };
    assert!((now - before).abs() <= most + 1e-6, "{before} to {now}");
}

#[test]
fn the_velocity_is_the_square_of_a_sine_and_the_steepest_point_has_6083h() {
    let mut bench = bench();
    bench.start(0x000F, 10_000);
    // 10 000 counts/s by 100 000 counts/s² at the steepest: π/2 · 100 ms.
    let time = FRAC_PI_2 * 100.0;
    let mut steepest = 0.0_f64;
    for cycle in 1..=158 {
        let before = bench.axis.velocity();
        step(&mut bench);
        let expected = 10_000.0 * (FRAC_PI_2 * f64::from(cycle) / time).sin().powi(2);
        let velocity = bench.axis.velocity();
        if f64::from(cycle) < time {
            assert!((velocity - expected).abs() < 1e-3, "{velocity} {expected}");
        }
        steepest = steepest.max(velocity - before);
    }
    assert_eq!(bench.axis.velocity(), 10_000.0);
    assert!((99.9..=100.0).contains(&steepest), "{steepest}");
    bench.settle();
    assert_eq!(bench.axis.position(), 10_000);
    assert_eq!(bench.outcomes(), [Outcome::Reached]);
}

#[test]
fn a_linear_ramp_of_the_same_drive_stays_linear() {
    let mut bench = Bench::enabled(smooth());
    bench.start(0x000F, 10_000);
    bench.run(100);
    assert_eq!(bench.axis.velocity(), 10_000.0);
}

#[test]
fn profile_velocity_has_sin_squared_ramps_too() {
    let mut bench = bench();
    bench.set(0x6060, 3);
    bench.set(0x60FF, 10_000);
    bench.run(1);
    bench.run(79);
    // Half of π/2 · 100 ms, half of the velocity.
    assert!((bench.axis.velocity() - 5_000.0).abs() < 200.0);
    for _ in 0..100 {
        step(&mut bench);
    }
    assert_eq!(bench.axis.velocity(), 10_000.0);
}

#[test]
fn a_halt_takes_the_way_of_its_ramp() {
    let mut bench = bench();
    bench.start(0x000F, 100_000);
    bench.run(300);
    let from = bench.axis.position();
    bench.word(0x010F);
    for _ in 0..400 {
        step(&mut bench);
    }
    assert_eq!(bench.axis.velocity(), 0.0);
    // v² / (2 · 2/π · 6084h), and 10 counts of the cycle in which the halt came.
    let way = 10_000.0_f64.powi(2) / (2.0 * 50_000.0 / FRAC_PI_2) + 10.0;
    assert!(((bench.axis.position() - from) as f64 - way).abs() <= 1.0);
}

/// A halt, whenever it comes, stops before the target or on it, and the move arrives when it is over.
#[test]
fn a_halt_at_any_moment_never_leads_beyond_the_target() {
    for (halted_at, released_after) in (0..700).step_by(5).flat_map(|at| [(at, 20), (at, 400)]) {
        let mut bench = bench();
        bench.start(0x000F, 4_000);
        for _ in 0..halted_at {
            step(&mut bench);
        }
        bench.word(0x010F);
        for _ in 0..released_after {
            step(&mut bench);
            assert!(bench.axis.position() <= 4_000, "halted after {halted_at}");
        }
        bench.word(0x000F);
        while bench.outcomes() != [Outcome::Reached] {
            step(&mut bench);
            assert!(bench.axis.position() <= 4_000, "halted after {halted_at}");
        }
        assert_eq!(bench.axis.position(), 4_000);
    }
}

#[test]
fn a_blend_is_planned_for_the_sin_squared_ramp_that_follows() {
    let mut bench = bench();
    bench.start(0x000F, 4_000);
    bench.start(0x020F, 4_200);
    while bench.outcomes()[0] == Outcome::Active {
        step(&mut bench);
    }
    // Slowing down begins gently: the first target is passed no faster than a sin² ramp can lose by the second.
    let before = bench.axis.velocity();
    step(&mut bench);
    let lost = before - bench.axis.velocity();
    assert!((0.0..10.0).contains(&lost), "{lost} from {before}");
}

#[test]
fn a_blend_passes_the_first_target_and_arrives_at_the_second() {
    for second in [8_000, 4_010] {
        let mut bench = bench();
        bench.start(0x000F, 4_000);
        bench.start(0x020F, second);
        while bench.outcomes() != [Outcome::Passed, Outcome::Reached] {
            step(&mut bench);
            assert!(bench.axis.position() <= second);
        }
        assert_eq!(bench.axis.position(), second);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Replaced, blended and queued at any moment: within the ramps, and at the last target in the end.
    #[test]
    fn whatever_follows_whenever_the_ramps_hold(
        moves in prop::collection::vec((-9_000..9_000_i64, 0..500_u32, 0..3_usize), 1..5),
    ) {
        let mut bench = bench();
        let mut last = 0;
        for (target, wait, kind) in moves {
            let base = [0x000F, 0x002F, 0x020F][kind];
            let taken = bench.axis.ledger().len();
            bench.start(base, target);
            if bench.axis.ledger().len() > taken {
                last = target;
            }
            for _ in 0..wait {
                step(&mut bench);
            }
            bench.word(base);
        }
        bench.settle();
        prop_assert_eq!(bench.axis.position(), last);
    }
}
