//! Profile velocity mode: ramps, bits 10 to 13, halts, exits, and limit switches in every mode.

use super::super::{
    Axis, Behaviour, Cause, LimitSwitches, Machine, Mapping, Outcome, State, VelocityEnd,
    VelocityPhase,
};
use super::Bench;

use VelocityEnd::{Active, Changed, Discarded, Halted};

/// An enabled axis in profile velocity mode that stands.
fn bench(behaviour: Behaviour) -> Bench {
    let mut bench = Bench::new(behaviour);
    bench.set(0x6060, 3);
    bench.set(0x606D, 50);
    bench.set(0x606E, 5);
    bench.set(0x606F, 100);
    bench.enable();
    assert_eq!(bench.axis.get(0x6061, 0), Some(3));
    bench
}

fn target(bench: &mut Bench, velocity: i64) {
    bench.set(0x60FF, velocity);
    bench.run(1);
}

fn phases(bench: &Bench) -> Vec<(i32, VelocityEnd)> {
    let line = |phase: &VelocityPhase| (phase.target, phase.end);
    bench.axis.velocity_phases().iter().map(line).collect()
}

/// Runs as many cycles and demands that the velocity never changes by more than the ramps allow: 100 counts/s in a
/// cycle up, 50 down.
fn run_within_the_ramps(bench: &mut Bench, cycles: u32) {
    for _ in 0..cycles {
        let (before, from) = (bench.axis.velocity(), bench.axis.position());
        bench.run(1);
        let now = bench.axis.velocity();
        let most = if now.abs() > before.abs() {
            100.0
        } else {
            50.0
        };
        assert!(
            (now - before).abs() <= most + 1e-6 || now * before < 0.0,
            "{before} {now}"
        );
        let way = (bench.axis.position() - from) as f64;
        assert!((way - (before + now) * 0.0005).abs() <= 1.0 + 0.1);
    }
}

#[test]
fn the_axis_follows_60ffh_by_6083h_and_6084h() {
    let mut bench = bench(Behaviour::generic());
    target(&mut bench, 10_000);
    run_within_the_ramps(&mut bench, 100);
    assert_eq!(bench.axis.velocity(), 10_000.0);
    assert_eq!(bench.axis.get(0x606B, 0), Some(10_000));
    assert_eq!(bench.axis.get(0x606C, 0), Some(10_000));
    run_within_the_ramps(&mut bench, 1_000);
    target(&mut bench, 4_000);
    run_within_the_ramps(&mut bench, 119);
    assert!(bench.axis.velocity() > 4_000.0);
    run_within_the_ramps(&mut bench, 1);
    assert_eq!(bench.axis.velocity(), 4_000.0);
    target(&mut bench, -6_000);
    run_within_the_ramps(&mut bench, 80 + 60);
    assert_eq!(bench.axis.velocity(), -6_000.0);
    target(&mut bench, 0);
    run_within_the_ramps(&mut bench, 120);
    assert_eq!(bench.axis.velocity(), 0.0);
    assert_eq!(
        phases(&bench),
        [(10_000, Changed), (4_000, Changed), (-6_000, Changed)]
    );
}

#[test]
fn a_long_run_covers_velocity_times_time() {
    let mut bench = bench(Behaviour::generic());
    target(&mut bench, 7_777);
    bench.run(100);
    let from = bench.axis.position();
    bench.run(60_000);
    let way = bench.axis.position() - from;
    assert!((way - 7_777 * 60).abs() <= 1, "{way}");
}

#[test]
fn ramps_that_change_take_effect_at_once() {
    let mut bench = bench(Behaviour::generic());
    target(&mut bench, 10_000);
    bench.run(20);
    let before = bench.axis.velocity();
    bench.set(0x6083, 10_000);
    bench.run(11);
    assert!(bench.axis.velocity() - before <= 100.0 + 10.0 * 10.0 + 1e-6);
    assert_eq!(phases(&bench), [(10_000, Active)]);
}

#[test]
fn target_reached_needs_the_window_for_its_time() {
    let mut bench = bench(Behaviour::generic());
    bench.run(10);
    assert!(bench.bit(10), "0 is reached");
    target(&mut bench, 1_000);
    let mut reached_after = 1;
    while !bench.bit(10) {
        bench.run(1);
        reached_after += 1;
    }
    // The order comes in cycle 1; 10 cycles of ramp, of which the last half lies in the window; 5 cycles of time.
    assert_eq!(reached_after, 1 + 10 + 5);
    target(&mut bench, 0);
    assert!(!bench.bit(10));
}

#[test]
fn speed_zero_is_the_threshold_and_its_time() {
    let mut bench = bench(Behaviour::generic());
    bench.set(0x6070, 8);
    assert!(bench.bit(12));
    target(&mut bench, 1_000);
    let mut cycles = 1;
    while bench.bit(12) {
        bench.run(1);
        cycles += 1;
    }
    // Above 100 counts/s from the third cycle on, for 8 ms.
    assert_eq!(cycles, 3 + 8);
    target(&mut bench, 0);
    bench.run(50);
    assert!(bench.bit(12));
    assert!(!bench.bit(13));
}

#[test]
fn a_moment_above_the_threshold_is_still_zero_and_the_next_one_counts_anew() {
    let mut bench = bench(Behaviour::generic());
    bench.set(0x6070, 8);
    for _ in 0..5 {
        for (velocity, cycles) in [(200, 5), (0, 10)] {
            target(&mut bench, velocity);
            for _ in 0..cycles {
                bench.run(1);
                assert!(bench.bit(12));
            }
        }
    }
}

#[test]
fn beyond_607fh_the_axis_runs_at_607fh_and_bit_11_says_so() {
    for sign in [1, -1] {
        let mut bench = bench(Behaviour::generic());
        bench.set(0x607F, 3_000);
        target(&mut bench, sign * 5_000);
        bench.run(500);
        assert_eq!(bench.axis.velocity(), (sign * 3_000) as f64);
        assert!(bench.bit(11) && !bench.bit(10));
        target(&mut bench, sign * 2_000);
        bench.run(500);
        assert!(!bench.bit(11) && bench.bit(10));
    }
}

#[test]
fn a_halt_stops_and_its_end_takes_the_velocity_up_again() {
    let mut bench = bench(Behaviour::generic());
    target(&mut bench, 5_000);
    bench.run(100);
    bench.word(0x010F);
    assert!(!bench.bit(10), "it still moves");
    bench.run(100);
    assert_eq!(bench.axis.velocity(), 0.0);
    assert!(bench.bit(10), "with halt, bit 10 is standstill");
    // A new target under halt waits.
    target(&mut bench, -2_000);
    bench.run(100);
    assert_eq!(bench.axis.velocity(), 0.0);
    bench.word(0x000F);
    bench.run(100);
    assert_eq!(bench.axis.velocity(), -2_000.0);
    assert_eq!(phases(&bench), [(5_000, Halted), (-2_000, Active)]);
}

#[test]
fn the_same_target_runs_again_after_a_halt_a_quick_stop_and_another_mode() {
    let mut bench = bench(Behaviour::generic());
    target(&mut bench, 5_000);
    bench.run(100);
    for word in [0x010F, 0x0002] {
        bench.word(word);
        bench.run(200);
        assert_eq!(bench.axis.velocity(), 0.0);
        for word in [0x0006, 0x0007, 0x000F] {
            bench.word(word);
        }
        bench.run(200);
        assert_eq!(bench.axis.velocity(), 5_000.0);
    }
    for mode in [1, 3] {
        bench.set(0x6060, mode);
        bench.run(200);
    }
    assert_eq!(bench.axis.velocity(), 5_000.0);
    let discarded = |cause| (5_000, Discarded(cause));
    assert_eq!(
        phases(&bench)[1..],
        [
            discarded(Cause::QuickStop),
            discarded(Cause::ModeChange),
            (5_000, Active)
        ]
    );
}

#[test]
fn the_halt_ramp_is_605dhs() {
    for (option, way) in [(1, 250), (2, 62), (3, 0)] {
        let mut bench = bench(Behaviour::generic());
        bench.set(0x605D, option);
        target(&mut bench, 5_000);
        bench.run(100);
        let from = bench.axis.position();
        bench.word(0x010F);
        bench.run(500);
        assert!((bench.axis.position() - from - 5 - way).abs() <= 1);
    }
}

#[test]
fn a_target_that_stands_when_operation_is_enabled_moves_the_axis() {
    let mut bench = Bench::new(Behaviour::generic());
    bench.set(0x6060, 3);
    bench.set(0x60FF, 1_000);
    bench.enable();
    bench.run(100);
    assert_eq!(bench.axis.velocity(), 1_000.0);
    assert_eq!(phases(&bench), [(1_000, Active)]);
}

#[test]
fn exits_from_operation_enabled_stop_by_their_option_and_forget() {
    let exits: [(u16, Cause, State); 4] = [
        (0x0002, Cause::QuickStop, State::SwitchOnDisabled),
        (0x0007, Cause::Disabled, State::SwitchedOn),
        (0x0006, Cause::Disabled, State::ReadyToSwitchOn),
        (0x0000, Cause::Disabled, State::SwitchOnDisabled),
    ];
    for (word, cause, state) in exits {
        let mut bench = bench(Behaviour::generic());
        target(&mut bench, 5_000);
        bench.run(100);
        bench.word(word);
        bench.run(200);
        assert_eq!(bench.axis.velocity(), 0.0);
        assert_eq!(bench.axis.state(), state);
        assert_eq!(phases(&bench), [(5_000, Discarded(cause))]);
        bench.run(100);
        assert_eq!(phases(&bench).len(), 1);
    }
}

#[test]
fn a_fault_stops_and_nothing_moves_before_operation_is_enabled_again() {
    let mut bench = bench(Behaviour::generic());
    target(&mut bench, 5_000);
    bench.run(100);
    bench.axis.inject_fault(0x7300);
    bench.run(200);
    assert_eq!(bench.axis.velocity(), 0.0);
    assert_eq!(phases(&bench), [(5_000, Discarded(Cause::Fault))]);
    bench.word(0x0000);
    bench.word(0x0080);
    bench.run(50);
    assert_eq!(phases(&bench).len(), 1);
}

#[test]
fn a_mode_change_stops_a_moving_axis_or_waits_for_its_standstill() {
    let mut stops = bench(Behaviour::generic());
    target(&mut stops, 5_000);
    stops.run(100);
    stops.set(0x6060, 1);
    stops.run(1);
    assert_eq!(stops.axis.get(0x6061, 0), Some(1));
    assert_eq!(phases(&stops), [(5_000, Discarded(Cause::ModeChange))]);
    run_within_the_ramps(&mut stops, 100);
    assert_eq!(stops.axis.velocity(), 0.0);

    let mut waits = bench(Behaviour {
        motion_blocks_mode_change: true,
        ..Behaviour::generic()
    });
    target(&mut waits, 5_000);
    waits.run(100);
    waits.set(0x6060, 1);
    waits.run(100);
    assert_eq!(waits.axis.get(0x6061, 0), Some(3));
    assert_eq!(waits.axis.velocity(), 5_000.0);
    target(&mut waits, 0);
    waits.run(98);
    assert_eq!(waits.axis.get(0x6061, 0), Some(3));
    waits.run(3);
    assert_eq!(waits.axis.get(0x6061, 0), Some(1));
}

#[test]
fn a_drive_may_change_its_mode_outside_operation_only() {
    let mut bench = bench(Behaviour {
        operation_blocks_mode_change: true,
        ..Behaviour::generic()
    });
    bench.set(0x6060, 6);
    bench.run(100);
    assert_eq!(bench.axis.get(0x6061, 0), Some(3));
    bench.word(0x0007);
    bench.run(1);
    assert_eq!(bench.axis.get(0x6061, 0), Some(6));
}

#[test]
fn a_velocity_left_in_60ffh_starts_with_the_mode() {
    let mut bench = Bench::enabled(Behaviour::generic());
    bench.set(0x60FF, 2_000);
    bench.start(0x000F, 1_000);
    bench.settle();
    assert!(phases(&bench).is_empty());
    bench.set(0x6060, 3);
    bench.run(100);
    assert_eq!(bench.axis.velocity(), 2_000.0);
}

#[test]
fn without_acceleration_nothing_moves() {
    let mut bench = bench(Behaviour::generic());
    bench.set(0x6083, 0);
    target(&mut bench, 5_000);
    bench.run(100);
    assert_eq!(bench.axis.velocity(), 0.0);
    assert!(!bench.bit(10));
}

#[test]
fn bit_4_means_nothing_here() {
    let mut bench = bench(Behaviour::generic());
    bench.set(0x607A, 1_000);
    bench.word(0x001F);
    bench.run(100);
    assert_eq!(bench.axis.position(), 0);
    assert!(bench.axis.ledger().is_empty() && bench.axis.homings().is_empty());
}

fn before_a_switch(limit_switches: LimitSwitches) -> Behaviour {
    Behaviour {
        limit_switches,
        machine: Machine {
            negative_limit: Some(-5_000),
            positive_limit: Some(5_000),
            ..Machine::default()
        },
        ..Behaviour::generic()
    }
}

#[test]
fn at_a_limit_switch_a_velocity_stops_and_only_leads_away_again() {
    let mut bench = bench(before_a_switch(LimitSwitches::Stop));
    target(&mut bench, 4_000);
    bench.run(5_000);
    assert_eq!(bench.axis.velocity(), 0.0);
    // 4000² / (2 · 200 000) counts of braking.
    assert!((5_040..=5_046).contains(&bench.axis.position()));
    assert!(bench.bit(11) && !bench.bit(10));
    assert_eq!(phases(&bench), [(4_000, Discarded(Cause::LimitSwitch))]);
    target(&mut bench, -1_000);
    bench.run(500);
    assert_eq!(bench.axis.velocity(), -1_000.0);
    assert!(!bench.bit(11));
}

#[test]
fn at_a_limit_switch_a_set_point_is_dropped() {
    let mut bench = Bench::enabled(before_a_switch(LimitSwitches::Stop));
    bench.start(0x000F, -9_000);
    bench.settle();
    assert_eq!(bench.outcomes(), [Outcome::Discarded(Cause::LimitSwitch)]);
    let stood = bench.axis.position();
    assert!((-5_300..=-5_000).contains(&stood), "{stood}");
    bench.start(0x000F, -9_000);
    bench.settle();
    assert!((bench.axis.position() - stood).abs() <= 1, "no further");
    bench.start(0x000F, 0);
    bench.settle();
    assert_eq!(bench.axis.position(), 0);
}

#[test]
fn a_limit_switch_that_is_only_shown_stops_nothing() {
    let mut bench = Bench::enabled(before_a_switch(LimitSwitches::Shown));
    bench.start(0x000F, 9_000);
    bench.settle();
    assert_eq!(bench.outcomes(), [Outcome::Reached]);
    assert_eq!(bench.axis.get(0x60FD, 0), Some(0b010));
    assert!(!bench.bit(11));
}

#[test]
fn what_a_program_may_want_to_change_while_it_runs_can_be_mapped() {
    for behaviour in [
        Behaviour::generic(),
        Behaviour::akd2g(),
        Behaviour::ax2000(),
    ] {
        let axis = Axis::new(behaviour);
        for address in [
            (0x60FF, 0),
            (0x6098, 0),
            (0x6099, 1),
            (0x6099, 2),
            (0x609A, 0),
        ] {
            let entry = axis
                .entries()
                .iter()
                .find(|entry| (entry.index, entry.subindex) == address)
                .expect("exists");
            assert_eq!(entry.mapping, Mapping::Rx);
        }
        let modes = axis.get(0x6502, 0).expect("exists");
        assert_eq!(modes & 0b10_0101, 0b10_0101);
    }
}

#[test]
fn a_drive_without_this_mode_does_not_show_it() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.set(0x6060, 3);
    bench.run(5);
    assert_eq!(bench.axis.get(0x6061, 0), Some(1));
    assert_eq!(bench.axis.get(0x60FF, 0), None);
}
