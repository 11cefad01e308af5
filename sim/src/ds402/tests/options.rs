//! Behaviour switches and objects that drives elsewhere have: 60F2h, 607Bh, 607Eh, 6080h, the factors, what limits do.

use core::time::Duration;

use super::super::{
    Axis, Behaviour, FactorChange, FullBuffer, LimitViolation, Outcome, Plant, RelativeBase,
    SetError, State, WhileMoving,
};
use super::Bench;

use Outcome::{Active, Passed, Queued, Reached, Replaced};

fn shown(bench: &Bench) -> i64 {
    bench.axis.get(0x6064, 0).expect("exists")
}

// --- limits ---

#[test]
fn a_target_beyond_the_limits_can_be_a_fault() {
    let mut bench = Bench::enabled(Behaviour {
        limit_violation: LimitViolation::Fault,
        ..Behaviour::generic()
    });
    bench.axis.set(0x607D, 1, -1000).expect("minimum");
    bench.axis.set(0x607D, 2, 1000).expect("maximum");
    bench.start(0x000F, 1000);
    bench.settle();
    assert_eq!(bench.outcomes(), [Reached]);
    bench.start(0x000F, 1001);
    bench.run(5);
    assert_eq!(bench.axis.state(), State::Fault);
    assert_eq!(bench.axis.get(0x603F, 0), Some(0x8612));
    assert_eq!(bench.axis.ledger().len(), 1, "it was not taken");
}

#[test]
fn the_motor_speed_limits_the_profile() {
    let mut bench = Bench::enabled(Behaviour::generic());
    bench.axis.set(0x6092, 1, 60_000).expect("counts a turn");
    bench.set(0x6080, 3);
    bench.start(0x000F, 10_000);
    bench.run(300);
    assert_eq!(bench.axis.velocity(), 3000.0, "3 turns a minute");
    bench.settle();
    // Two turns of the motor for one of the shaft: half as far for each.
    bench.axis.set(0x6091, 1, 2).expect("motor turns");
    bench.start(0x000F, 20_000);
    bench.run(300);
    assert_eq!(bench.axis.velocity(), 1500.0);
}

// --- factors of velocity and acceleration ---

/// What was written before a factor is another number after it, for the same motion.
#[test]
fn a_drive_that_keeps_its_own_units_shows_other_numbers_once_a_factor_has_changed() {
    let behaviour = Behaviour {
        factor_change: FactorChange::Numbers,
        ..Behaviour::generic()
    };
    let mut axis = Axis::new(behaviour.with_plant(Plant::ideal()));
    axis.place(3 << 20);
    let held = [
        (0x607D, 1, -400_000),
        (0x607D, 2, 1 << 22),
        (0x6081, 0, 1 << 20),
        (0x6084, 0, 1 << 21),
    ];
    for (index, subindex, value) in held {
        axis.set(index, subindex, value).expect("a parameter");
    }
    // 2^20 increments are 2^18 units; then three units of velocity are a unit/s, and five of acceleration one of velocity/s.
    for (index, value) in [(0x6092, 1 << 18), (0x6096, 3), (0x6097, 5)] {
        axis.set(index, 1, value).expect("a factor");
    }
    let shown = held.map(|(index, subindex, _)| axis.get(index, subindex));
    let ramp = (1 << 19) * 3 * 5;
    let expected = [-100_000, 1 << 20, 3 << 18, ramp];
    assert_eq!(shown, expected.map(Some));
    assert_eq!(
        axis.get(0x607F, 0),
        Some(0xFFFF_FFFF),
        "no limit stays none"
    );
    assert_eq!(axis.position(), 3 << 18, "it stands where it stood");
    axis.cycle(core::time::Duration::from_millis(1));
    assert_eq!(axis.get(0x6063, 0), Some(3 << 20));
}

#[test]
fn velocity_and_acceleration_factors_scale_the_profile() {
    let mut bench = Bench::enabled(Behaviour::generic());
    // A unit of velocity is 1/2 count/s, one of acceleration 1/5 of that per second.
    bench.axis.set(0x6096, 1, 2).expect("numerator");
    bench.axis.set(0x6097, 1, 5).expect("numerator");
    bench.start(0x000F, 20_000);
    bench.run(10);
    // 6083h = 100 000 units: 10 000 counts/s².
    assert!((bench.axis.velocity() - 100.0).abs() < 1e-6);
    bench.run(700);
    assert_eq!(bench.axis.velocity(), 5000.0, "6081h = 10 000 units");
    assert_eq!(bench.axis.get(0x606C, 0), Some(10_000));
    assert_eq!(bench.axis.get(0x606B, 0), Some(10_000));
    bench.settle();
    assert_eq!(
        bench.axis.position(),
        20_000,
        "positions have no such factor"
    );
}

// --- polarity ---

#[test]
fn position_polarity_turns_targets_and_positions_alike() {
    for base in [0x000F, 0x004F] {
        let mut bench = Bench::enabled(Behaviour::generic());
        bench.set(0x607E, 0x80);
        bench.start(base, 500);
        bench.settle();
        assert_eq!(bench.axis.position(), -500);
        assert_eq!(shown(&bench), 500);
        assert_eq!(bench.axis.get(0x6062, 0), Some(500));
        bench.start(base, 100);
        bench.settle();
        let expected = if base == 0x004F { 600 } else { 100 };
        assert_eq!(shown(&bench), expected);
    }
}

#[test]
fn limits_hold_for_positions_as_the_master_counts_them() {
    let mut bench = Bench::enabled(Behaviour::generic());
    bench.set(0x607E, 0x80);
    bench.axis.set(0x607D, 1, -100).expect("minimum");
    bench.axis.set(0x607D, 2, 1000).expect("maximum");
    bench.start(0x000F, 5000);
    bench.settle();
    assert_eq!(shown(&bench), 1000);
    assert_eq!(bench.axis.position(), -1000);
}

#[test]
fn velocity_polarity_turns_velocities() {
    let mut bench = Bench::enabled(Behaviour::generic());
    bench.set(0x607E, 0x40);
    bench.start(0x000F, 5000);
    bench.run(150);
    assert!(bench.axis.velocity() > 0.0);
    assert!(bench.axis.get(0x606C, 0) < Some(0));
    bench.settle();
    bench.set(0x6060, 3);
    bench.set(0x60FF, 2000);
    bench.run(300);
    assert_eq!(bench.axis.velocity(), -2000.0);
    assert_eq!(bench.axis.get(0x606C, 0), Some(2000));
    assert!(bench.bit(10), "the target velocity is reached");
}

// --- modulo axes ---

fn modulo(option: i64) -> Bench {
    let mut bench = Bench::enabled(Behaviour {
        position_range: (0, 3599),
        ..Behaviour::generic()
    });
    bench.set(0x60F2, option);
    bench
}

#[test]
fn positions_wrap_within_607bh() {
    let mut bench = modulo(0);
    bench.start(0x004F, 3700);
    bench.settle();
    assert_eq!(bench.axis.position(), 3700);
    assert_eq!(shown(&bench), 100);
    bench.start(0x004F, -200);
    bench.settle();
    assert_eq!(shown(&bench), 3500);
    assert_eq!(bench.axis.get(0x6062, 0), Some(3500));
}

/// From 3500: straight back to 100; on to it over the end of the range; back without that; the shortest way.
#[test]
fn bits_6_and_7_of_60f2h_choose_the_way_of_a_modulo_axis() {
    for (code, way) in [(0, -3400), (1, -3400), (2, 200), (3, 200)] {
        let mut bench = modulo(code << 6);
        bench.start(0x004F, 3500);
        bench.settle();
        bench.start(0x000F, 100);
        bench.settle();
        assert_eq!(bench.axis.position(), 3500 + way, "code {code}");
        assert_eq!(shown(&bench), 100);
    }
    for (code, way) in [(1, -200), (2, 3400), (3, -200)] {
        let mut bench = modulo(code << 6);
        bench.start(0x004F, 100);
        bench.settle();
        bench.start(0x000F, 3500);
        bench.settle();
        assert_eq!(bench.axis.position(), 100 + way, "code {code}");
    }
}

#[test]
fn a_target_outside_607bh_wraps_and_one_that_is_there_already_needs_no_turn() {
    let mut bench = modulo(2 << 6);
    bench.start(0x000F, 3600 + 250);
    bench.settle();
    assert_eq!(bench.axis.position(), 250);
    for option in [1 << 6, 2 << 6, 3 << 6] {
        bench.set(0x60F2, option);
        bench.start(0x000F, 250);
        bench.settle();
        assert_eq!(bench.axis.position(), 250);
    }
}

#[test]
fn queued_targets_of_a_modulo_axis_count_on_from_each_other() {
    let mut bench = modulo(2 << 6);
    bench.start(0x000F, 3000);
    bench.start(0x000F, 1000);
    bench.settle();
    assert_eq!(bench.axis.position(), 4600);
    assert_eq!(bench.outcomes(), [Reached, Reached]);
}

#[test]
fn limits_of_a_modulo_axis_hold_within_its_range() {
    let mut bench = modulo(0);
    bench.axis.set(0x607D, 1, 500).expect("minimum");
    bench.axis.set(0x607D, 2, 3000).expect("maximum");
    bench.start(0x000F, 3500);
    bench.settle();
    assert_eq!(shown(&bench), 3000);
    assert!(bench.bit(11));
}

#[test]
fn the_full_range_of_607bh_wraps_nothing() {
    let mut bench = Bench::enabled(Behaviour::generic());
    bench.start(0x000F, -7);
    bench.settle();
    assert_eq!(shown(&bench), -7);
}

// --- 60F2h ---

#[test]
fn reserved_codes_of_60f2h_are_refused() {
    let mut bench = Bench::new(Behaviour::generic());
    for value in [0x03, 0x0C, 0x30, 0x0100, 0x8000] {
        assert_eq!(
            bench.axis.set(0x60F2, 0, value),
            Err(SetError::OutOfRange),
            "{value:04X}"
        );
    }
    for value in [0x02, 0x08, 0x20, 0xC0, 0xEA] {
        assert_eq!(bench.axis.set(0x60F2, 0, value), Ok(()), "{value:04X}");
    }
}

#[test]
fn bits_2_and_3_of_60f2h_say_what_bit_5_does() {
    for (code, outcomes) in [
        (0, [Replaced, Active]),
        (1, [Active, Queued]),
        (2, [Active, Queued]),
    ] {
        let mut bench = Bench::enabled(Behaviour::generic());
        bench.set(0x60F2, code << 2);
        bench.start(0x000F, 3000);
        bench.run(20);
        bench.start(0x002F, 6000);
        assert_eq!(bench.outcomes(), outcomes, "code {code}");
        bench.settle();
        let first = [Replaced, Passed, Reached][code as usize];
        assert_eq!(bench.outcomes(), [first, Reached], "code {code}");
    }
}

/// The drive resets bit 4 itself; the acknowledge falls with it.
#[test]
fn bits_4_and_5_of_60f2h_let_the_drive_reset_bit_4() {
    let word = |bench: &Bench| bench.axis.controlword() & 0x0010;
    let mut bench = Bench::enabled(Behaviour::generic());
    bench.set(0x60F2, 1 << 4);
    bench.start(0x000F, 3000);
    while bench.outcomes() == [Active] {
        assert_eq!(word(&bench), 0x0010, "until the target is reached");
        bench.run(1);
    }
    bench.run(2);
    assert_eq!(word(&bench), 0);
    assert!(!bench.bit(12));

    let mut bench = Bench::enabled(Behaviour::generic());
    bench.set(0x60F2, 2 << 4);
    bench.start(0x000F, 3000);
    assert_eq!(word(&bench), 0, "another one can be taken");
    bench.run(1);
    assert!(!bench.bit(12));
    bench.start(0x000F, 6000);
    assert_eq!(word(&bench), 0x0010, "both are busy");
    while bench.outcomes() == [Active, Queued] {
        assert!(bench.bit(12));
        bench.run(1);
    }
    bench.run(1);
    assert_eq!(word(&bench), 0);
    bench.settle();
    assert_eq!(bench.axis.position(), 6000);
}

#[test]
fn a_bit_4_that_the_master_writes_back_is_no_edge() {
    let mut bench = Bench::enabled(Behaviour::generic());
    bench.set(0x60F2, 2 << 4);
    bench.start(0x000F, 300);
    for _ in 0..100 {
        bench.word(0x001F);
    }
    assert_eq!(bench.axis.ledger().len(), 1);
}

#[test]
fn relative_targets_count_from_a_fixed_base_where_the_drive_has_one() {
    let fixed = [
        RelativeBase::PreviousTarget,
        RelativeBase::Demand,
        RelativeBase::Actual,
    ];
    let targets = fixed.map(|relative_base| {
        let mut bench = Bench::enabled(Behaviour {
            relative_base,
            actual_lag_cycles: 3,
            ..Behaviour::generic()
        });
        // Another base than the fixed one.
        bench.set(
            0x60F2,
            if relative_base == RelativeBase::Demand {
                0
            } else {
                1
            },
        );
        bench.start(0x000F, 5000);
        bench.run(150);
        let actual = bench.axis.position();
        bench.start(0x006F, 100);
        let second = &bench.axis.ledger()[1];
        let demand = second.start_position.expect("started");
        assert!(demand > actual);
        (second.target.expect("known"), demand + 100)
    });
    let [previous, demand, actual] = targets;
    assert_eq!(previous.0, 5100);
    assert_eq!(demand.0, demand.1);
    // Three cycles behind a demand of 10 000 counts/s.
    assert_eq!(actual.0, actual.1 - 30);
}

// --- the buffer ---

#[test]
fn a_drive_can_hold_many_set_points() {
    let mut bench = Bench::enabled(Behaviour {
        waiting_set_points: 15,
        ..Behaviour::generic()
    });
    for number in 1..=16 {
        bench.word(0x000F);
        assert!(!bench.bit(12));
        bench.start(0x000F, number * 100);
    }
    bench.word(0x000F);
    assert!(bench.bit(12));
    bench.start(0x000F, 9000);
    bench.settle();
    assert_eq!(bench.outcomes(), [Reached; 16]);
    assert_eq!(bench.axis.position(), 1600);
}

#[test]
fn of_many_set_points_the_last_is_overwritten() {
    let mut bench = Bench::enabled(Behaviour {
        waiting_set_points: 2,
        full_buffer: FullBuffer::OverwritePending,
        ..Behaviour::generic()
    });
    for target in [1000, 2000, 3000, 2500] {
        bench.start(0x000F, target);
    }
    assert_eq!(bench.outcomes(), [Active, Queued, Replaced, Queued]);
    bench.settle();
    assert_eq!(bench.axis.position(), 2500);
}

#[test]
fn a_drive_with_room_for_one_loses_what_comes_while_it_moves() {
    for full_buffer in [FullBuffer::Ignore, FullBuffer::OverwritePending] {
        let mut bench = Bench::enabled(Behaviour {
            waiting_set_points: 0,
            full_buffer,
            ..Behaviour::generic()
        });
        bench.start(0x000F, 1000);
        bench.start(0x000F, 2000);
        assert_eq!(bench.outcomes(), [Active]);
        bench.start(0x002F, 3000);
        assert_eq!(bench.outcomes(), [Replaced, Active]);
        bench.settle();
        assert_eq!(bench.axis.position(), 3000);
    }
}

#[test]
fn single_set_points_wait_for_the_whole_queue_and_for_standstill() {
    let mut bench = Bench::enabled(Behaviour {
        while_moving: WhileMoving::TakenAfterArrival,
        ..Behaviour::generic()
    });
    bench.set(0x6082, 5000);
    bench.start(0x000F, 2000);
    bench.run(10);
    bench.start(0x000F, 0);
    while bench.outcomes() == [Active] {
        bench.run(1);
    }
    assert_eq!(bench.outcomes(), [Passed]);
    assert!(bench.axis.velocity() > 0.0, "it stops beyond the target");
    bench.settle();
    bench.set(0x6082, 0);
    bench.run(5);
    bench.settle();
    assert_eq!(bench.axis.ledger().len(), 2);
}

// --- power ---

#[test]
fn without_voltage_a_drive_waits_in_switch_on_disabled_or_in_ready() {
    for (needs, waits) in [
        (true, State::SwitchOnDisabled),
        (false, State::ReadyToSwitchOn),
    ] {
        let mut bench = Bench::new(Behaviour {
            ready_needs_voltage: needs,
            ..Behaviour::generic()
        });
        bench.axis.set_voltage(false);
        bench.word(0x0006);
        bench.word(0x0007);
        bench.run(20);
        assert_eq!(bench.axis.state(), waits);
        assert!(!bench.bit(4));
        bench.axis.set_voltage(true);
        for word in [0x0006, 0x0007, 0x000F] {
            bench.word(word);
        }
        bench.run(2);
        assert_eq!(bench.axis.state(), State::OperationEnabled);
    }
}

#[test]
fn an_inhibited_drive_does_not_switch_on_and_drops_out() {
    let mut bench = Bench::new(Behaviour::generic());
    bench.axis.set_inhibited(true);
    for word in [0x0006, 0x0007, 0x000F] {
        bench.word(word);
    }
    assert_eq!(bench.axis.state(), State::ReadyToSwitchOn);
    bench.axis.set_inhibited(false);
    bench.enable();
    bench.axis.set_inhibited(true);
    bench.run(1);
    assert_eq!(bench.axis.state(), State::SwitchOnDisabled);
}

#[test]
fn a_drive_without_the_short_cut_ignores_0fh_in_ready() {
    for (short_cut, state) in [
        (true, State::OperationEnabled),
        (false, State::ReadyToSwitchOn),
    ] {
        let mut bench = Bench::new(Behaviour {
            auto_3_4: short_cut,
            ..Behaviour::generic()
        });
        bench.word(0x0006);
        bench.word(0x000F);
        bench.run(3);
        assert_eq!(bench.axis.state(), state);
    }
}

#[test]
fn in_local_control_bit_9_is_0_and_bit_4_starts_nothing() {
    let mut bench = Bench::enabled(Behaviour::generic());
    bench.axis.set_remote(false);
    bench.start(0x000F, 1000);
    bench.run(10);
    assert!(!bench.bit(9));
    assert!(bench.axis.ledger().is_empty());
    bench.word(0x0000);
    assert_eq!(
        bench.axis.state(),
        State::OperationEnabled,
        "nor is it switched off"
    );
    bench.axis.set_remote(true);
    bench.run(1);
    assert_eq!(bench.axis.state(), State::SwitchOnDisabled);
    assert!(!bench.axis.moved_since(Duration::ZERO));
}
