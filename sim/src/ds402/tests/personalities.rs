//! What the documents say about each drive, on the axis model: one test for each statement.

use super::super::{Behaviour, Bit5, LimitViolation, Machine, Outcome, SetError, WhileMoving};
use super::Bench;

use Outcome::{Active, Passed, Queued, Reached, Replaced};

// --- the drive with 2010h, page "Profile Position Mode" ---

#[test]
fn pp2010_acknowledges_a_set_point_and_withdraws_that_when_it_can_take_another() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.start(0x002F, 4000);
    assert!(bench.bit(12), "received");
    bench.word(0x002F);
    assert!(!bench.bit(12), "ready for more");
}

#[test]
fn pp2010_processes_a_single_set_point_at_once() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.start(0x002F, 40_000);
    bench.run(100);
    bench.start(0x002F, -500);
    assert_eq!(bench.outcomes(), [Replaced, Active]);
    bench.settle();
    assert_eq!(bench.axis.position(), -500);
}

#[test]
fn pp2010_processes_a_set_of_set_points_one_after_the_other_was_reached() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.start(0x000F, 1000);
    bench.start(0x000F, -500);
    assert_eq!(bench.outcomes(), [Active, Queued]);
    while bench.outcomes() != [Reached, Active] {
        bench.run(1);
    }
    assert_eq!(bench.axis.position(), 1000);
    bench.settle();
    assert_eq!(bench.axis.position(), -500);
}

#[test]
fn pp2010_holds_two_set_points_and_keeps_the_acknowledge_while_both_are_busy() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.start(0x000F, 1000);
    bench.word(0x000F);
    assert!(!bench.bit(12));
    bench.start(0x000F, 2000);
    bench.word(0x000F);
    while bench.outcomes() != [Reached, Active] {
        assert!(bench.bit(12), "both busy");
        bench.run(1);
    }
    assert!(!bench.bit(12), "one is free");
}

/// Whether the one that runs is one of the two is inferred; the other reading is a switch.
#[test]
fn pp2010_can_be_read_as_holding_two_behind_the_one_that_runs() {
    let behaviour = Behaviour {
        waiting_set_points: 2,
        ..Behaviour::pp2010()
    };
    let mut bench = Bench::enabled(behaviour);
    for target in [1000, 2000] {
        bench.start(0x000F, target);
        bench.word(0x000F);
        assert!(!bench.bit(12), "there is room behind {target}");
    }
    bench.start(0x000F, 3000);
    bench.word(0x000F);
    assert!(bench.bit(12), "three are busy");
    assert_eq!(bench.outcomes(), [Active, Queued, Queued]);
    bench.settle();
    assert_eq!(bench.outcomes(), [Reached; 3]);
    assert_eq!(bench.axis.position(), 3000);
}

#[test]
fn pp2010_replaces_everything_at_once_when_bit_5_finds_the_buffer_full() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.start(0x000F, 40_000);
    bench.start(0x000F, 80_000);
    bench.word(0x000F);
    assert!(bench.bit(12));
    bench.run(100);
    bench.start(0x002F, -500);
    assert_eq!(bench.outcomes(), [Replaced, Replaced, Active]);
    bench.settle();
    assert_eq!(bench.axis.position(), -500);
}

#[test]
fn pp2010_keeps_target_reached_low_until_all_set_points_are_processed() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.start(0x000F, 1000);
    bench.start(0x000F, 2000);
    while bench.outcomes() != [Reached, Reached] {
        assert!(!bench.bit(10));
        bench.run(1);
    }
    assert!(bench.bit(10));
}

#[test]
fn pp2010_has_linear_ramps_with_their_own_acceleration_and_deceleration() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.start(0x002F, 5000);
    bench.run(50);
    // 100 000 and 50 000 counts/s²: 100 and 50 counts/s more or less in each cycle.
    let mut last = bench.axis.velocity();
    let (mut up, mut down) = (false, false);
    while bench.axis.velocity() > 100.0 {
        bench.run(1);
        let change = bench.axis.velocity() - last;
        last = bench.axis.velocity();
        up |= (change - 100.0).abs() < 1e-6;
        down |= (change + 50.0).abs() < 1e-6;
    }
    assert!(up && down);
    assert_eq!(bench.axis.set(0x6086, 0, 1), Err(SetError::OutOfRange));
    assert_eq!(bench.axis.set(0x6086, 0, 0), Ok(()));
}

#[test]
fn pp2010_starts_and_ends_its_ramps_at_2010h() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.set(0x2010, 2000);
    bench.start(0x002F, 5000);
    bench.run(1);
    assert_eq!(bench.axis.velocity(), 2100.0, "the first cycle of the ramp");
    let mut slowest = f64::MAX;
    while bench.outcomes() != [Reached] {
        slowest = slowest.min(bench.axis.velocity());
        bench.run(1);
    }
    assert!((2000.0..2100.0).contains(&slowest), "{slowest}");
    assert_eq!(bench.axis.velocity(), 0.0);
    assert_eq!(bench.axis.position(), 5000);
}

#[test]
fn pp2010_stops_and_turns_by_2010h_too() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.set(0x2010, 2000);
    bench.start(0x002F, 50_000);
    bench.run(200);
    bench.word(0x012F);
    let mut last = bench.axis.velocity();
    while bench.axis.velocity() > 0.0 {
        last = bench.axis.velocity();
        bench.run(1);
    }
    assert!((2000.0..2100.0).contains(&last), "{last}");
    bench.word(0x002F);
    bench.run(100);
    bench.start(0x002F, 0);
    let mut speeds = Vec::new();
    while bench.outcomes() != [Replaced, Reached] {
        speeds.push(bench.axis.velocity().abs());
        bench.run(1);
    }
    assert!(
        speeds.iter().all(|speed| *speed >= 1999.9),
        "never slower than 2010h"
    );
    assert_eq!(bench.axis.position(), 0);
}

#[test]
fn pp2010_runs_without_ramps_below_2010h() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.set(0x2010, 2000);
    bench.set(0x6081, 500);
    bench.start(0x002F, 500);
    bench.run(1);
    assert_eq!(bench.axis.velocity(), 500.0);
    let cycles = bench.settle();
    assert!((995..=1001).contains(&cycles), "{cycles}");
}

#[test]
fn pp2010_takes_16_bits_in_2010h() {
    let mut bench = Bench::new(Behaviour::pp2010());
    assert_eq!(bench.axis.set(0x2010, 0, 0xFFFF), Ok(()));
    assert_eq!(
        bench.axis.set(0x2010, 0, 0x1_0000),
        Err(SetError::OutOfRange)
    );
}

// --- AX2000, CANopen manual, pages 101 and 102 ---

#[test]
fn ax2000_receives_the_next_single_set_point_after_arrival() {
    let mut bench = Bench::enabled(Behaviour::ax2000());
    bench.start(0x000F, 2000);
    assert!(bench.bit(12));
    bench.word(0x000F);
    bench.run(50);
    bench.start(0x000F, 6000);
    while bench.outcomes() == [Active] {
        assert!(!bench.bit(12), "not taken while it moves");
        bench.run(1);
    }
    assert_eq!(bench.outcomes(), [Reached]);
    assert!(bench.bit(10) && !bench.bit(12), "arrival is told first");
    bench.run(1);
    assert_eq!(bench.outcomes(), [Reached, Active]);
    assert!(!bench.bit(10) && bench.bit(12));
    let second = &bench.axis.ledger()[1];
    assert_eq!(
        second.start_position,
        Some(2000),
        "from standstill at the first"
    );
    bench.settle();
    assert_eq!(bench.axis.position(), 6000);
}

#[test]
fn ax2000_loses_a_single_set_point_that_is_withdrawn_before_arrival() {
    let mut bench = Bench::enabled(Behaviour::ax2000());
    bench.start(0x000F, 2000);
    bench.run(50);
    bench.start(0x000F, 6000);
    bench.run(5);
    bench.word(0x000F);
    bench.settle();
    bench.run(50);
    assert_eq!(bench.outcomes(), [Reached]);
    assert_eq!(bench.axis.position(), 2000);
}

#[test]
fn ax2000_signals_arrival_before_the_next_single_set_point() {
    let mut bench = Bench::enabled(Behaviour::ax2000());
    bench.start(0x000F, 2000);
    bench.word(0x000F);
    bench.settle();
    assert!(bench.bit(10) && !bench.bit(12));
    assert_eq!(bench.axis.velocity(), 0.0);
    bench.start(0x000F, 3000);
    bench.settle();
    assert_eq!(bench.outcomes(), [Reached, Reached]);
}

#[test]
fn ax2000_holds_the_velocity_through_the_target_of_a_set_with_linear_ramps() {
    let mut bench = Bench::enabled(Behaviour::ax2000());
    bench.start(0x002F, 3000);
    bench.run(20);
    bench.start(0x002F, 6000);
    assert_eq!(
        bench.outcomes(),
        [Active, Queued],
        "prepared while the first runs"
    );
    let mut slowest = f64::MAX;
    while bench.outcomes() != [Passed, Active] {
        if bench.axis.position() > 1000 {
            slowest = slowest.min(bench.axis.velocity());
        }
        bench.run(1);
    }
    assert!(slowest > 9_900.0, "{slowest}");
    bench.settle();
    assert_eq!(bench.axis.position(), 6000);
}

#[test]
fn ax2000_stops_at_the_target_of_a_set_with_sin2_ramps() {
    let mut bench = Bench::enabled(Behaviour::ax2000());
    bench.set(0x6086, 1);
    bench.start(0x002F, 3000);
    bench.start(0x002F, 6000);
    bench.settle();
    assert_eq!(bench.outcomes(), [Reached, Reached]);
}

/// The acceleration of a sin² ramp begins and ends at 0 and is never more than 6083h.
#[test]
fn ax2000_ramps_are_sin2_with_6086h_at_1() {
    let mut bench = Bench::enabled(Behaviour::ax2000());
    bench.set(0x6086, 1);
    bench.start(0x000F, 20_000);
    let mut changes = Vec::new();
    let mut last = bench.axis.velocity();
    while bench.axis.velocity() < 10_000.0 {
        bench.run(1);
        changes.push(bench.axis.velocity() - last);
        last = bench.axis.velocity();
    }
    let steepest = changes.iter().copied().fold(0.0, f64::max);
    assert!((95.0..=100.0 + 1e-6).contains(&steepest), "{steepest}");
    assert!(changes[0] < 5.0 && changes[changes.len() - 1] < 5.0);
}

#[test]
fn ax2000_has_no_bit_9_and_no_replacing() {
    let mut bench = Bench::enabled(Behaviour::ax2000());
    bench.start(0x002F, 3000);
    bench.run(20);
    bench.start(0x022F, -1000);
    assert_eq!(bench.outcomes(), [Active, Queued]);
    bench.settle();
    assert_eq!(
        bench.outcomes(),
        [Reached, Reached],
        "a reversal stops at the first"
    );
    let mut bench = Bench::enabled(Behaviour::ax2000());
    bench.start(0x020F, 2000);
    bench.run(20);
    bench.start(0x020F, 4000);
    bench.settle();
    bench.run(1);
    bench.settle();
    assert_eq!(bench.outcomes(), [Reached, Reached], "bit 9 blends nothing");
}

#[test]
fn ax2000_full_of_a_set_keeps_the_acknowledge_and_loses_the_third() {
    let mut bench = Bench::enabled(Behaviour::ax2000());
    bench.start(0x002F, 3000);
    bench.start(0x002F, 6000);
    bench.word(0x002F);
    assert!(bench.bit(12));
    bench.start(0x002F, 9000);
    assert_eq!(bench.outcomes(), [Active, Queued]);
}

#[test]
fn ax2000_factors_lead_from_units_to_increments() {
    let mut bench = Bench::enabled(Behaviour::ax2000());
    bench.axis.set(0x6093, 1, 10).expect("10 increments a unit");
    bench
        .axis
        .set(0x6094, 1, 20)
        .expect("20 increments/s a unit");
    bench
        .axis
        .set(0x6097, 1, 10)
        .expect("10 increments/s² a unit");
    bench.start(0x000F, 40_000);
    bench.run(10);
    let velocity = bench.axis.velocity();
    assert!((velocity - 1000.0).abs() < 1e-6, "6083h = 100 000 units");
    bench.run(300);
    assert_eq!(bench.axis.velocity(), 20_000.0, "6081h = 10 000 units");
    assert_eq!(bench.axis.get(0x606C, 0), Some(10_000));
    bench.settle();
    assert_eq!(bench.axis.get(0x6064, 0), Some(40_000));
    assert_eq!(bench.axis.get(0x6063, 0), Some(400_000));
}

// --- Sigma-7, page on 607Ah, 607Dh and 607Fh ---

fn sigma7(min: i64, max: i64, offset: i64) -> Bench {
    let mut bench = Bench::enabled(Behaviour::sigma7());
    bench.axis.set(0x607D, 1, min).expect("minimum");
    bench.axis.set(0x607D, 2, max).expect("maximum");
    bench.set(0x607C, offset);
    bench
}

fn reached(bench: &mut Bench, target: i64) -> i64 {
    bench.start(0x002F, target);
    bench.settle();
    bench.axis.position()
}

#[test]
fn sigma7_takes_targets_as_absolute_or_relative_by_bit_6() {
    let mut bench = Bench::enabled(Behaviour::sigma7());
    assert_eq!(reached(&mut bench, 500), 500);
    bench.start(0x006F, 500);
    bench.settle();
    assert_eq!(bench.axis.position(), 1000);
}

#[test]
fn sigma7_checks_targets_against_limits_less_the_home_offset() {
    let mut bench = sigma7(-1000, 1000, 100);
    bench.axis.set_referenced(true);
    assert_eq!(reached(&mut bench, 5000), 900);
    assert!(bench.bit(11));
    assert_eq!(reached(&mut bench, -5000), -1100);
    assert_eq!(reached(&mut bench, 900), 900);
    assert!(!bench.bit(11));
    bench.set(0x607C, -50);
    assert_eq!(reached(&mut bench, 5000), 1050, "corrected anew");
}

#[test]
fn sigma7_limits_wait_for_homing() {
    let mut bench = sigma7(-1000, 1000, 0);
    assert_eq!(reached(&mut bench, 3000), 3000);
    // Method 37: the present position is home.
    bench.set(0x6098, 37);
    bench.set(0x6060, 6);
    bench.run(2);
    bench.word(0x000F);
    bench.word(0x001F);
    bench.run(5);
    assert!(bench.axis.is_referenced());
    bench.word(0x000F);
    bench.set(0x6060, 1);
    bench.run(2);
    assert_eq!(reached(&mut bench, 3000), 1000);
}

#[test]
fn sigma7_limits_are_in_force_with_an_absolute_encoder() {
    let machine = Machine {
        absolute_encoder: true,
        ..Machine::default()
    };
    let mut bench = Bench::enabled(Behaviour {
        machine,
        ..Behaviour::sigma7()
    });
    bench.axis.set(0x607D, 2, 1000).expect("maximum");
    assert_eq!(reached(&mut bench, 3000), 1000);
}

#[test]
fn sigma7_limits_are_off_where_the_minimum_is_not_below_the_maximum() {
    for (min, max) in [(0, 0), (1000, 1000), (1000, -1000)] {
        let mut bench = sigma7(min, max, 0);
        bench.axis.set_referenced(true);
        assert_eq!(reached(&mut bench, 3000), 3000, "{min} and {max}");
    }
}

#[test]
fn sigma7_keeps_607fh_as_the_highest_speed_of_a_profile() {
    let mut bench = Bench::enabled(Behaviour::sigma7());
    assert_eq!(bench.axis.get(0x607F, 0), Some(2_147_483_647));
    bench.set(0x607F, 4000);
    bench.start(0x002F, 5000);
    let mut fastest = 0.0_f64;
    while bench.outcomes() != [Reached] {
        bench.run(1);
        fastest = fastest.max(bench.axis.velocity());
    }
    assert_eq!(fastest, 4000.0);
    // Profile velocity is a profile mode too.
    bench.set(0x6060, 3);
    bench.set(0x60FF, 9000);
    bench.run(300);
    assert_eq!(bench.axis.velocity(), 4000.0);
}

#[test]
fn sigma7_saves_607dh_and_607fh_and_not_607ah() {
    let mut bench = sigma7(-1000, 1000, 0);
    bench.set(0x607F, 4000);
    bench.set(0x607A, 77);
    let unsaved = bench.axis.restarted();
    assert_eq!(unsaved.get(0x607F, 0), Some(2_147_483_647));
    assert_eq!(unsaved.get(0x607D, 2), Some(0));
    bench.axis.save();
    bench.set(0x607F, 5000);
    let saved = bench.axis.restarted().restarted();
    assert_eq!(saved.get(0x607F, 0), Some(4000), "as it was when saved");
    assert_eq!(saved.get(0x607D, 1), Some(-1000));
    assert_eq!(saved.get(0x607D, 2), Some(1000));
    assert_eq!(saved.get(0x607A, 0), Some(0));
}

#[test]
fn ax2000_saves_6086h() {
    let mut bench = Bench::new(Behaviour::ax2000());
    bench.set(0x6086, 1);
    bench.axis.save();
    assert_eq!(bench.axis.restarted().get(0x6086, 0), Some(1));
}

// --- the presets as data ---

#[test]
fn presets_differ_where_their_documents_do() {
    let starts = |behaviour: Behaviour| {
        (
            behaviour.bit_5,
            behaviour.bit_9,
            behaviour.while_moving,
            behaviour.profile_types,
        )
    };
    let linear: &[i16] = &[0];
    let queues = WhileMoving::Queues;
    assert_eq!(
        starts(Behaviour::generic()),
        (Bit5::Replaces, true, queues, linear)
    );
    assert_eq!(
        starts(Behaviour::akd2g()),
        (Bit5::Replaces, true, queues, linear)
    );
    assert_eq!(
        starts(Behaviour::pp2010()),
        (Bit5::Replaces, false, queues, linear)
    );
    assert_eq!(
        starts(Behaviour::ax2000()),
        (
            Bit5::Blends,
            false,
            WhileMoving::TakenAfterArrival,
            &[0, 1][..]
        )
    );
    assert_eq!(Behaviour::sigma7().limit_violation, LimitViolation::Clamp);
}
