//! Homing mode: every method on a machine, the bits, and everything that ends a homing early.

use core::time::Duration;

use super::super::{
    AckFault, Axis, Behaviour, Cause, Disturbances, HOMING_METHODS, HomeOffset, HomingError,
    HomingOutcome, LimitSwitches, Machine, SetError, State,
};
use super::Bench;

/// Limit switches at ±50 000, home switch from 10 000 to 12 000, an index pulse every 4000 at 700, from 1000 on.
fn machine() -> Machine {
    Machine {
        start: 1000,
        negative_limit: Some(-50_000),
        positive_limit: Some(50_000),
        home_switch: Some((10_000, 12_000)),
        index_period: 4000,
        index_at: 700,
        ..Machine::default()
    }
}

fn on(machine: Machine) -> Behaviour {
    Behaviour {
        machine,
        ..Behaviour::generic()
    }
}

/// An enabled axis in homing mode.
fn bench(behaviour: Behaviour) -> Bench {
    let mut bench = Bench::new(behaviour);
    bench.set(0x6060, 6);
    for (subindex, speed) in [(1, 20_000), (2, 2_000)] {
        bench
            .axis
            .set(0x6099, subindex, speed)
            .expect("takes a speed");
    }
    bench.set(0x609A, 200_000);
    bench.enable();
    assert_eq!(bench.axis.get(0x6061, 0), Some(6));
    bench
}

/// Bits 13, 12 and 10.
fn bits(bench: &Bench) -> [bool; 3] {
    [bench.bit(13), bench.bit(12), bench.bit(10)]
}

const IN_PROGRESS: [bool; 3] = [false, false, false];
const NOT_STARTED: [bool; 3] = [false, false, true];
const ATTAINED_MOVING: [bool; 3] = [false, true, false];
const COMPLETED: [bool; 3] = [false, true, true];
const ERROR_MOVING: [bool; 3] = [true, false, false];
const ERROR_STANDING: [bool; 3] = [true, false, true];

fn begin(bench: &mut Bench, method: i64) {
    bench.set(0x6098, method);
    bench.word(0x000F);
    bench.word(0x001F);
}

/// Runs until the homing has ended and the axis stands.
fn finish(bench: &mut Bench) -> HomingOutcome {
    for _ in 0..200_000 {
        let outcome = bench.axis.homings().last().expect("was started").outcome;
        if outcome != HomingOutcome::Active && bench.axis.velocity() == 0.0 {
            bench.run(1);
            return outcome;
        }
        bench.run(1);
    }
    panic!("the homing does not end");
}

fn home(bench: &mut Bench, method: i64) -> HomingOutcome {
    begin(bench, method);
    finish(bench)
}

/// Where each method finds home: method, home switch, starts, home without and with an index pulse. The switch is
/// active from 10 000 to 12 000, or from there to an end; pulses lie at 700 + 4000 · n.
#[test]
fn every_method_finds_its_edge_from_wherever_it_starts() {
    let bump = (10_000, 12_000);
    let to_positive = (10_000, i64::MAX);
    let to_negative = (i64::MIN, 12_000);
    let table: [(i64, (i64, i64), i64, i64); 14] = [
        (1, bump, -49_999, -47_300),
        (2, bump, 49_999, 48_700),
        (3, to_positive, 9_999, 8_700),
        (4, to_positive, 10_000, 12_700),
        (5, to_negative, 12_001, 12_700),
        (6, to_negative, 12_000, 8_700),
        (7, bump, 9_999, 8_700),
        (8, bump, 10_000, 12_700),
        (9, bump, 12_000, 8_700),
        (10, bump, 12_001, 12_700),
        (11, bump, 12_001, 12_700),
        (12, bump, 12_000, 8_700),
        (13, bump, 10_000, 12_700),
        (14, bump, 9_999, 8_700),
    ];
    for (method, home_switch, edge, pulse) in table {
        for start in [
            -50_100, -20_000, 9_990, 10_500, 11_999, 12_010, 30_000, 50_100,
        ] {
            for (method, expected) in [(method, pulse), (method + 16, edge)] {
                let mut bench = bench(on(Machine {
                    start,
                    home_switch: Some(home_switch),
                    ..machine()
                }));
                for (subindex, speed) in [(1, 50_000), (2, 20_000)] {
                    bench
                        .axis
                        .set(0x6099, subindex, speed)
                        .expect("takes a speed");
                }
                bench.set(0x609A, 2_000_000);
                let outcome = home(&mut bench, method);
                assert_eq!(
                    outcome,
                    HomingOutcome::Attained,
                    "method {method} from {start}"
                );
                assert_eq!(
                    bench.axis.homings()[0].home,
                    Some(expected),
                    "method {method} from {start}"
                );
                assert_eq!(bits(&bench), COMPLETED);
                assert_eq!(
                    bench.axis.mechanical_position() - bench.axis.position(),
                    expected,
                    "home reads 0"
                );
                assert!(bench.axis.is_referenced());
            }
        }
    }
}

#[test]
fn index_methods_take_the_next_pulse_in_their_direction() {
    for (method, start, expected) in [
        (33, 1000, 700),
        (33, 700, -3300),
        (34, 1000, 4700),
        (34, 4700, 8700),
    ] {
        let mut bench = bench(on(Machine { start, ..machine() }));
        assert_eq!(home(&mut bench, method), HomingOutcome::Attained);
        assert_eq!(bench.axis.homings()[0].home, Some(expected));
    }
}

#[test]
fn the_present_position_becomes_home_without_a_motion() {
    for method in [35, 37] {
        let mut bench = bench(on(machine()));
        bench.set(0x607C, 250);
        begin(&mut bench, method);
        assert_eq!(bits(&bench), IN_PROGRESS);
        bench.run(1);
        assert_eq!(bits(&bench), COMPLETED);
        assert_eq!(bench.axis.get(0x6064, 0), Some(250));
        assert_eq!(bench.axis.get(0x6062, 0), Some(250));
        assert_eq!(bench.axis.get(0x60F4, 0), Some(0));
        assert_eq!(bench.axis.mechanical_position(), 1000);
        assert!(!bench.axis.moved_since(Duration::ZERO));
    }
}

#[test]
fn home_reads_the_offset_or_lies_before_zero_by_it() {
    for (home_offset, reads) in [
        (HomeOffset::HomeReadsOffset, 300),
        (HomeOffset::ZeroBeyondHome, -300),
    ] {
        let mut bench = bench(Behaviour {
            home_offset,
            ..on(machine())
        });
        bench.set(0x607C, 300);
        home(&mut bench, 19);
        bench.set(0x6060, 1);
        bench.word(0x000F);
        bench.start(0x000F, reads);
        bench.settle();
        assert_eq!(bench.axis.mechanical_position(), 9_999);
        assert_eq!(bench.axis.homings()[0].offset, Some(300));
    }
}

#[test]
fn absolute_and_relative_moves_count_from_the_new_zero_after_homing() {
    let mut bench = bench(on(machine()));
    home(&mut bench, 35);
    bench.set(0x6060, 1);
    bench.word(0x000F);
    bench.start(0x004F, 500);
    bench.settle();
    assert_eq!(bench.axis.position(), 500);
    assert_eq!(bench.axis.mechanical_position(), 1500);
}

#[test]
fn the_bits_follow_the_table() {
    let mut bench = bench(on(machine()));
    assert_eq!(bits(&bench), NOT_STARTED);
    begin(&mut bench, 19);
    let mut seen = vec![bits(&bench)];
    while bench.axis.homings()[0].outcome == HomingOutcome::Active || bench.axis.velocity() != 0.0 {
        bench.run(1);
        if seen.last() != Some(&bits(&bench)) {
            seen.push(bits(&bench));
        }
    }
    assert_eq!(seen, [IN_PROGRESS, ATTAINED_MOVING, COMPLETED]);
    // Bit 4 falls after the end: nothing changes.
    bench.word(0x000F);
    assert_eq!(bits(&bench), COMPLETED);
}

#[test]
fn search_is_fast_and_the_home_edge_is_crossed_slowly() {
    // With 6096h, half a count/s is one unit of velocity, and half a count/s² one of acceleration.
    for units_per_count in [1, 2] {
        let mut bench = bench(on(machine()));
        bench
            .axis
            .set(0x6096, 1, units_per_count)
            .expect("takes a factor");
        begin(&mut bench, 20);
        let (mut fastest, mut last, mut steepest) = (0.0_f64, 0.0_f64, 0.0_f64);
        while bench.axis.homings()[0].outcome == HomingOutcome::Active {
            let velocity = bench.axis.velocity();
            fastest = fastest.max(velocity.abs());
            steepest = steepest.max((velocity - last).abs());
            last = velocity;
            bench.run(1);
        }
        let share = units_per_count as f64;
        assert_eq!((fastest, last), (20_000.0 / share, 2_000.0 / share));
        assert!((steepest - 200.0 / share).abs() < 1e-6, "{steepest}");
    }
}

#[test]
fn a_homing_starts_with_an_edge_of_bit_4_only() {
    let mut bench = bench(on(machine()));
    bench.set(0x6098, 35);
    home(&mut bench, 35);
    bench.run(50);
    assert_eq!(bench.axis.homings().len(), 1);
    bench.word(0x000F);
    bench.word(0x001F);
    assert_eq!(bench.axis.homings().len(), 2);
    assert_eq!(
        bits(&bench),
        IN_PROGRESS,
        "the result before is gone at once"
    );
}

#[test]
fn the_old_result_may_be_shown_for_a_while_after_a_start() {
    let mut bench = bench(on(machine()));
    home(&mut bench, 35);
    bench.axis.disturbances().stale_reached_cycles = 3;
    begin(&mut bench, 19);
    for _ in 0..3 {
        assert_eq!(bits(&bench), COMPLETED);
        bench.run(1);
    }
    assert_eq!(bits(&bench), IN_PROGRESS);
}

#[test]
fn bit_4_low_interrupts_and_the_next_edge_starts_anew() {
    let mut bench = bench(on(machine()));
    begin(&mut bench, 19);
    bench.run(100);
    bench.word(0x000F);
    assert_eq!(
        bits(&bench),
        IN_PROGRESS,
        "it still moves, nothing is attained"
    );
    assert_eq!(finish(&mut bench), HomingOutcome::Interrupted);
    assert_eq!(bits(&bench), NOT_STARTED);
    assert!(!bench.axis.is_referenced());
    let stood = bench.axis.position();
    bench.run(100);
    assert_eq!(bench.axis.position(), stood);
    assert_eq!(home(&mut bench, 19), HomingOutcome::Attained);
}

#[test]
fn a_halt_pauses_and_its_end_continues() {
    let mut bench = bench(on(machine()));
    begin(&mut bench, 19);
    bench.run(100);
    bench.word(0x011F);
    assert_eq!(bits(&bench), IN_PROGRESS);
    bench.run(1000);
    assert_eq!(bits(&bench), NOT_STARTED);
    assert_eq!(bench.axis.velocity(), 0.0);
    bench.word(0x001F);
    assert_eq!(bits(&bench), IN_PROGRESS);
    assert_eq!(finish(&mut bench), HomingOutcome::Attained);
    assert_eq!(bench.axis.homings()[0].home, Some(9_999));
    assert_eq!(bench.axis.homings().len(), 1);
}

#[test]
fn a_halt_that_stops_beyond_the_edge_still_finds_it() {
    for halted_at in (0..300).step_by(7) {
        let mut bench = bench(on(Machine {
            start: 9_500,
            ..machine()
        }));
        // Slow enough to run far beyond the edge.
        bench.set(0x6084, 5_000);
        begin(&mut bench, 24);
        bench.run(halted_at);
        bench.word(0x011F);
        for _ in 0..5_000 {
            let before = bench.axis.velocity();
            bench.run(1);
            let change = bench.axis.velocity() - before;
            assert!(change.abs() <= 5.0 + 1e-6, "the halt keeps its ramp");
        }
        assert_eq!(bench.axis.velocity(), 0.0);
        bench.word(0x001F);
        assert_eq!(finish(&mut bench), HomingOutcome::Attained);
        assert_eq!(
            bench.axis.homings()[0].home,
            Some(10_000),
            "halted after {halted_at}"
        );
    }
}

#[test]
fn a_homing_that_is_started_under_a_halt_waits_for_its_end() {
    let mut bench = bench(on(machine()));
    bench.set(0x6098, 19);
    bench.word(0x010F);
    bench.word(0x011F);
    bench.run(500);
    assert!(!bench.axis.moved_since(Duration::ZERO));
    assert_eq!(bits(&bench), NOT_STARTED);
    bench.word(0x001F);
    assert_eq!(finish(&mut bench), HomingOutcome::Attained);
}

/// On a drive that stops at limit switches otherwise: homing runs onto them, halted or not.
#[test]
fn homing_onto_a_limit_switch_is_no_stop_even_when_halted_there() {
    let mut bench = bench(Behaviour {
        limit_switches: LimitSwitches::Stop,
        ..on(Machine {
            start: -49_000,
            ..machine()
        })
    });
    begin(&mut bench, 17);
    while bench.axis.mechanical_position() > -50_000 {
        bench.run(1);
    }
    bench.word(0x011F);
    bench.run(500);
    bench.word(0x001F);
    assert_eq!(finish(&mut bench), HomingOutcome::Attained);
    assert_eq!(bench.axis.homings()[0].home, Some(-49_999));
}

#[test]
fn a_halt_ends_the_homing_on_a_drive_that_keeps_nothing() {
    let mut bench = bench(Behaviour {
        halt_keeps: false,
        ..on(machine())
    });
    begin(&mut bench, 19);
    bench.run(100);
    bench.word(0x011F);
    assert_eq!(finish(&mut bench), HomingOutcome::Discarded(Cause::Halt));
    bench.word(0x001F);
    bench.run(100);
    assert_eq!(bench.axis.velocity(), 0.0);
    assert_eq!(bits(&bench), NOT_STARTED);
}

#[test]
fn what_cannot_be_done_ends_in_an_error_and_the_axis_stands() {
    let without_home = Machine {
        home_switch: None,
        ..machine()
    };
    let cases = [
        (machine(), 0, HomingError::Method),
        (machine(), 15, HomingError::Method),
        (machine(), -3, HomingError::Method),
        (without_home.clone(), 19, HomingError::LimitSwitch),
        (without_home.clone(), 22, HomingError::LimitSwitch),
        (without_home.clone(), 23, HomingError::NoHomeSwitch),
        (without_home, 30, HomingError::NoHomeSwitch),
        (
            Machine {
                index_period: 0,
                ..machine()
            },
            34,
            HomingError::LimitSwitch,
        ),
        (
            Machine {
                index_period: 0,
                ..machine()
            },
            3,
            HomingError::LimitSwitch,
        ),
    ];
    for (machine, method, error) in cases {
        let mut bench = bench(on(machine));
        assert_eq!(
            home(&mut bench, method),
            HomingOutcome::Failed(error),
            "method {method}"
        );
        assert_eq!(bits(&bench), ERROR_STANDING);
        assert_eq!(bench.axis.state(), State::OperationEnabled);
        assert!(!bench.axis.is_referenced());
        assert_eq!(bench.axis.homings()[0].home, None);
        bench.run(100);
        assert_eq!(bench.axis.velocity(), 0.0);
        // The next one is not held back by it.
        assert_eq!(home(&mut bench, 35), HomingOutcome::Attained);
        assert_eq!(bits(&bench), COMPLETED);
    }
}

#[test]
fn an_error_in_motion_shows_bit_13_before_bit_10() {
    let mut bench = bench(on(Machine {
        home_switch: None,
        ..machine()
    }));
    begin(&mut bench, 19);
    while bench.axis.homings()[0].outcome == HomingOutcome::Active {
        bench.run(1);
    }
    assert_eq!(bits(&bench), ERROR_MOVING);
    finish(&mut bench);
    assert_eq!(bits(&bench), ERROR_STANDING);
}

#[test]
fn speeds_and_accelerations_of_zero_are_errors_where_the_method_moves() {
    for (index, subindex, method, outcome) in [
        (0x6099, 1, 19, HomingOutcome::Failed(HomingError::SpeedZero)),
        (0x6099, 2, 19, HomingOutcome::Failed(HomingError::SpeedZero)),
        (0x609A, 0, 19, HomingOutcome::Failed(HomingError::SpeedZero)),
        (0x6099, 2, 33, HomingOutcome::Failed(HomingError::SpeedZero)),
        (0x6099, 1, 33, HomingOutcome::Attained),
        (0x6099, 2, 35, HomingOutcome::Attained),
    ] {
        let mut bench = bench(on(machine()));
        bench.axis.set(index, subindex, 0).expect("takes 0");
        assert_eq!(home(&mut bench, method), outcome);
    }
}

#[test]
fn a_method_is_refused_when_written_or_when_started() {
    let behaviour = |homing_method_refused_at_write| Behaviour {
        homing_methods: &[35],
        homing_method_refused_at_write,
        ..on(machine())
    };
    let mut refuses = bench(behaviour(true));
    assert_eq!(refuses.axis.set(0x6098, 0, 19), Err(SetError::OutOfRange));
    assert_eq!(home(&mut refuses, 35), HomingOutcome::Attained);
    let mut fails = bench(behaviour(false));
    assert_eq!(
        home(&mut fails, 19),
        HomingOutcome::Failed(HomingError::Method)
    );
}

#[test]
fn exits_from_operation_enabled_discard_the_homing() {
    let exits: [(u16, Cause); 4] = [
        (0x001B, Cause::QuickStop),
        (0x0017, Cause::Disabled),
        (0x0016, Cause::Disabled),
        (0x0000, Cause::Disabled),
    ];
    for (word, cause) in exits {
        let mut bench = bench(on(machine()));
        begin(&mut bench, 19);
        bench.run(100);
        bench.word(word);
        assert_eq!(finish(&mut bench), HomingOutcome::Discarded(cause));
        bench.run(100);
        assert!(!bench.axis.is_referenced());
        bench.enable();
        bench.run(100);
        assert_eq!(bench.axis.velocity(), 0.0);
        assert_eq!(bits(&bench), NOT_STARTED);
    }
}

#[test]
fn a_fault_ends_the_homing_and_its_reset_does_not_take_it_up() {
    let mut bench = bench(on(machine()));
    begin(&mut bench, 19);
    bench.run(100);
    bench.axis.inject_fault(0x7300);
    assert_eq!(finish(&mut bench), HomingOutcome::Discarded(Cause::Fault));
    bench.run(200);
    bench.word(0x0000);
    bench.word(0x0080);
    bench.enable();
    bench.run(100);
    assert_eq!(bits(&bench), NOT_STARTED);
    assert_eq!(bench.axis.velocity(), 0.0);
    assert!(!bench.axis.is_referenced());
}

#[test]
fn a_mode_change_ends_the_homing_and_stops_the_axis() {
    let mut bench = bench(on(machine()));
    begin(&mut bench, 19);
    bench.run(100);
    bench.set(0x6060, 1);
    bench.run(1);
    assert_eq!(bench.axis.get(0x6061, 0), Some(1));
    assert_eq!(
        finish(&mut bench),
        HomingOutcome::Discarded(Cause::ModeChange)
    );
    bench.run(100);
    assert!(
        bench.axis.ledger().is_empty(),
        "bit 4 is still high and starts nothing"
    );
}

/// Pitfall 28: bit 4 of homing left high into profile position mode.
#[test]
fn bit_4_left_high_into_profile_position_starts_a_move_where_the_drive_sees_the_level() {
    for edge_at_mode_change in [false, true] {
        let mut bench = bench(Behaviour {
            edge_at_mode_change,
            ..on(machine())
        });
        home(&mut bench, 35);
        bench.set(0x607A, 2000);
        bench.set(0x6060, 1);
        bench.run(500);
        assert_eq!(bench.axis.ledger().len(), usize::from(edge_at_mode_change));
        assert_eq!(bench.axis.position() != 0, edge_at_mode_change);
    }
}

#[test]
fn an_obstacle_at_the_end_of_travel_ends_the_homing_in_a_following_error() {
    let mut bench = bench(on(Machine {
        ends: Some((-3_000, 3_000)),
        ..Machine::default()
    }));
    bench.set(0x6065, 500);
    begin(&mut bench, 19);
    assert_eq!(finish(&mut bench), HomingOutcome::Discarded(Cause::Fault));
    bench.run(1000);
    assert_eq!(bench.axis.state(), State::Fault);
    assert_eq!(bench.axis.mechanical_position(), 3_000);
    assert_eq!(bench.axis.get(0x603F, 0), Some(0x8611));
    assert_eq!(bench.axis.get(0x60F4, 0), Some(0), "it is let go");
}

#[test]
fn switches_are_in_60fdh_and_a_test_can_operate_them_by_hand() {
    let mut bench = bench(on(Machine {
        start: 1000,
        negative_limit: Some(0),
        positive_limit: Some(1000),
        ..Machine::default()
    }));
    assert_eq!(bench.axis.get(0x60FD, 0), Some(0b010));
    bench.axis.set_digital_inputs(0x0001_0004);
    bench.run(1);
    assert_eq!(bench.axis.get(0x60FD, 0), Some(0x0001_0006));

    let mut by_hand = self::bench(on(Machine::default()));
    begin(&mut by_hand, 21);
    by_hand.run(200);
    by_hand.axis.set_digital_inputs(0b100);
    by_hand.run(300);
    by_hand.axis.set_digital_inputs(0);
    assert_eq!(finish(&mut by_hand), HomingOutcome::Attained);
    let found = by_hand.axis.homings()[0].home.expect("found");
    assert!((-4_000..-3_000).contains(&found), "{found}");
}

#[test]
fn lost_power_loses_the_reference_and_the_zero() {
    let mut bench = bench(on(machine()));
    home(&mut bench, 19);
    assert!(bench.axis.is_referenced());
    let stood = bench.axis.mechanical_position();
    bench.axis = bench.axis.restarted();
    bench.run(1);
    assert!(!bench.axis.is_referenced());
    assert_eq!(bench.axis.position(), 0);
    assert_eq!(bench.axis.mechanical_position(), stood);
}

#[test]
fn lost_power_during_homing_leaves_the_axis_where_it_was() {
    for absolute_encoder in [false, true] {
        let mut bench = bench(on(Machine {
            absolute_encoder,
            ..machine()
        }));
        begin(&mut bench, 19);
        bench.run(100);
        let at = bench.axis.mechanical_position();
        bench.axis = bench.axis.restarted();
        bench.run(10);
        bench.set(0x6060, 6);
        bench.enable();
        bench.run(100);
        assert_eq!(bench.axis.mechanical_position(), at);
        assert!(bench.axis.homings().is_empty());
        assert_eq!(bits(&bench), NOT_STARTED);
        assert_eq!(bench.axis.is_referenced(), absolute_encoder);
    }
}

#[test]
fn an_absolute_encoder_knows_its_zero_over_a_loss_of_power() {
    let mut bench = bench(on(Machine {
        absolute_encoder: true,
        ..machine()
    }));
    assert!(bench.axis.is_referenced());
    assert_eq!(bench.axis.position(), 1000);
    bench.set(0x607C, 70);
    home(&mut bench, 20);
    let reported = bench.axis.position();
    bench.axis = bench.axis.restarted();
    bench.run(1);
    assert_eq!(bench.axis.get(0x6064, 0), Some(reported));
    assert!(bench.axis.is_referenced());
    bench.run(10);
    bench.set(0x6060, 1);
    bench.enable();
    bench.start(0x004F, 500);
    bench.settle();
    assert_eq!(bench.axis.position(), reported + 500);
}

#[test]
fn limits_that_need_a_reference_come_into_force_by_homing() {
    let mut bench = bench(Behaviour {
        limits_need_reference: true,
        ..on(machine())
    });
    bench.axis.set(0x607D, 2, 800).expect("maximum");
    home(&mut bench, 35);
    bench.set(0x6060, 1);
    bench.word(0x000F);
    bench.start(0x000F, 2000);
    bench.settle();
    assert_eq!(bench.axis.position(), 800);
}

#[test]
fn a_drive_deaf_to_bit_4_does_not_home() {
    let mut bench = bench(on(machine()));
    *bench.axis.disturbances() = Disturbances {
        deaf_to_bit_4: true,
        ack: AckFault::None,
        ..Disturbances::default()
    };
    begin(&mut bench, 35);
    bench.run(10);
    assert!(bench.axis.homings().is_empty());
}

#[test]
fn an_axis_whose_actual_position_lags_finds_the_same_edge() {
    let mut bench = bench(Behaviour {
        actual_lag_cycles: 5,
        ..on(machine())
    });
    begin(&mut bench, 26);
    while bench.axis.homings()[0].outcome == HomingOutcome::Active || bench.axis.velocity() != 0.0 {
        let before = bench.axis.mechanical_position();
        bench.run(1);
        // 20 000 counts/s at most.
        assert!((bench.axis.mechanical_position() - before).abs() <= 21);
    }
    assert_eq!(bench.axis.homings()[0].home, Some(12_001));
    bench.run(10);
    assert_eq!(
        bench.axis.get(0x6062, 0),
        bench.axis.get(0x6064, 0),
        "both were shifted"
    );
}

#[test]
fn every_drive_that_shows_mode_6_homes_by_bit_4() {
    for behaviour in [
        Behaviour::akd2g(),
        Behaviour::pp2010(),
        Behaviour::ax2000(),
        Behaviour::sigma7(),
    ] {
        let mut bench = bench(Behaviour {
            machine: machine(),
            ..behaviour
        });
        assert_eq!(home(&mut bench, 19), HomingOutcome::Attained);
        assert_eq!(bits(&bench), COMPLETED);
    }
}

#[test]
fn the_drive_knows_the_methods_that_it_lists() {
    for method in i8::MIN..=i8::MAX {
        let known = super::super::homing_method::Method::of(method).is_some();
        assert_eq!(known, HOMING_METHODS.contains(&method), "{method}");
    }
    let bench = bench(Behaviour {
        homing_methods: &[35, 17],
        ..Behaviour::generic()
    });
    let listed = [0, 1, 2, 3].map(|subindex| bench.axis.get(0x60E3, subindex));
    assert_eq!(listed, [Some(2), Some(35), Some(17), None]);
    let without = Behaviour {
        supported_modes: 1,
        ..Behaviour::generic()
    };
    assert_eq!(Axis::new(without).get(0x60E3, 0), None);
}

/// The fast search stops far beyond a short switch; what counts is the edge that is crossed slowly and on purpose.
#[test]
fn a_switch_that_the_search_runs_over_is_found_again() {
    for (method, start, expected) in [
        (23, 0, 9_999),
        (24, 0, 10_000),
        (25, 0, 10_100),
        (26, 30_000, 10_101),
        (27, 30_000, 10_101),
        (28, 30_000, 10_100),
        (29, 30_000, 10_000),
        (30, 0, 9_999),
    ] {
        let mut bench = bench(on(Machine {
            start,
            home_switch: Some((10_000, 10_100)),
            ..machine()
        }));
        // 1000 counts of way to stop from 20 000 counts/s.
        bench.set(0x609A, 200_000);
        assert_eq!(home(&mut bench, method), HomingOutcome::Attained);
        assert_eq!(
            bench.axis.homings()[0].home,
            Some(expected),
            "method {method}"
        );
    }
}
