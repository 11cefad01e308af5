//! Where set-points lead: blends, reversals, relative bases, limits, and values at the edge of their types.

use super::super::{Behaviour, LimitViolation, LimitsOff, Outcome, RelativeBase, SetError};
use super::Bench;

use Outcome::{Active, Passed, Queued, Reached, Replaced};

#[test]
fn a_blend_keeps_the_first_velocity_through_the_first_target() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.start(0x000F, 4000);
    bench.set(0x6081, 3000);
    bench.start(0x020F, 8000);
    let mut slowest = f64::MAX;
    while bench.axis.position() < 4000 {
        bench.run(1);
        if bench.axis.position() > 1000 {
            slowest = slowest.min(bench.axis.velocity());
        }
        assert!(!bench.bit(10));
    }
    assert!(slowest > 9_900.0, "{slowest}");
    assert_eq!(bench.outcomes(), [Passed, Active]);
    bench.run(300);
    assert_eq!(
        bench.axis.velocity(),
        3000.0,
        "then the second's own velocity"
    );
    bench.settle();
    assert_eq!(bench.axis.position(), 8000);
    let [first, second] = bench.axis.ledger() else {
        panic!("two set-points")
    };
    assert_eq!(first.end_position, Some(4000));
    assert_eq!(second.start_position, Some(4000));
}

#[test]
fn without_bit_9_or_on_a_drive_without_it_the_axis_stops_in_between() {
    for (behaviour, word) in [
        (Behaviour::akd2g(), 0x000F),
        (
            Behaviour {
                bit_9: false,
                ..Behaviour::akd2g()
            },
            0x020F,
        ),
    ] {
        let mut bench = Bench::enabled(behaviour);
        bench.start(0x000F, 2000);
        bench.start(word, 4000);
        bench.settle();
        assert_eq!(bench.outcomes(), [Reached, Reached]);
    }
}

#[test]
fn a_blend_into_the_opposite_direction_stops_at_the_first_target() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.start(0x000F, 4000);
    bench.start(0x020F, 1000);
    let mut furthest = 0;
    while bench.axis.ledger()[1].outcome != Reached {
        bench.run(1);
        furthest = furthest.max(bench.axis.position());
    }
    assert_eq!(furthest, 4000);
    assert_eq!(bench.axis.position(), 1000);
}

#[test]
fn a_blend_with_a_short_second_way_never_runs_past_the_second_target() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.start(0x000F, 4000);
    bench.start(0x020F, 4050);
    while bench.axis.ledger()[1].outcome != Reached {
        bench.run(1);
        assert!(bench.axis.position() <= 4050);
    }
    assert_eq!(bench.outcomes(), [Passed, Reached]);
}

#[test]
fn bit_5_overrides_bit_9() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.start(0x000F, 4000);
    bench.run(50);
    bench.start(0x022F, -100);
    assert_eq!(bench.outcomes(), [Replaced, Active]);
}

#[test]
fn relative_moves_count_from_their_base() {
    for (option, target) in [(0, 5100), (1, 100), (2, 100)] {
        let mut bench = Bench::enabled(Behaviour::generic());
        bench.set(0x60F2, option);
        bench.start(0x000F, 5000);
        bench.start(0x006F, 100);
        let line = &bench.axis.ledger()[1];
        let from = line.start_position.expect("started");
        let expected = if option == 0 { target } else { from + target };
        assert_eq!(line.target, Some(expected), "60F2h = {option}");
        bench.settle();
        assert_eq!(bench.axis.position(), expected);
    }
}

#[test]
fn a_queued_relative_move_counts_from_the_target_before_it() {
    for relative_base in [RelativeBase::PreviousTarget, RelativeBase::Demand] {
        let mut bench = Bench::enabled(Behaviour {
            relative_base,
            ..Behaviour::akd2g()
        });
        bench.start(0x000F, 2000);
        bench.start(0x004F, -700);
        assert_eq!(bench.outcomes(), [Active, Queued]);
        bench.settle();
        assert_eq!(bench.axis.position(), 1300, "{relative_base:?}");
    }
}

#[test]
fn an_end_velocity_passes_the_target_and_stops_beyond_it() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.set(0x6082, 5000);
    bench.start(0x000F, 2000);
    bench.settle();
    assert_eq!(bench.outcomes(), [Passed]);
    // 5000² / (2 · 50000) counts of braking.
    assert_eq!(bench.axis.position(), 2250);
}

#[test]
fn velocity_and_ramps_stay_within_607fh_60c5h_and_60c6h() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.set(0x607F, 5000);
    bench.set(0x60C5, 10_000);
    bench.set(0x60C6, 20_000);
    bench.start(0x000F, 10_000);
    let mut last = bench.axis.velocity();
    let mut fastest = 0.0_f64;
    while bench.outcomes() != [Reached] {
        bench.run(1);
        let velocity = bench.axis.velocity();
        assert!(velocity - last <= 10.0 + 1e-6);
        assert!(last - velocity <= 20.0 + 1e-6);
        fastest = fastest.max(velocity);
        last = velocity;
    }
    assert_eq!(fastest, 5000.0);
}

#[test]
fn a_profile_without_velocity_or_acceleration_is_taken_and_goes_nowhere() {
    for index in [0x6081, 0x6083] {
        let mut bench = Bench::enabled(Behaviour::akd2g());
        bench.set(index, 0);
        bench.start(0x000F, 1000);
        bench.run(500);
        assert!(bench.bit(12));
        assert!(!bench.bit(10));
        assert_eq!(bench.axis.position(), 0);
        assert_eq!(bench.outcomes(), [Active]);
    }
}

#[test]
fn without_6084h_the_acceleration_brakes() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.set(0x6084, 0);
    bench.start(0x000F, 1000);
    bench.settle();
    assert_eq!(bench.outcomes(), [Reached]);
    assert_eq!(bench.axis.position(), 1000);
}

#[test]
fn limits_less_the_home_offset_hold_a_target_back() {
    let limited = |violation, off| {
        let behaviour = Behaviour {
            limit_violation: violation,
            limits_off: off,
            ..Behaviour::akd2g()
        };
        let mut bench = Bench::enabled(behaviour);
        bench.axis.set(0x607D, 1, -1000).expect("minimum");
        bench.axis.set(0x607D, 2, 1000).expect("maximum");
        bench.set(0x607C, 100);
        bench
    };
    let mut clamps = limited(LimitViolation::Clamp, LimitsOff::BothZero);
    clamps.start(0x000F, 5000);
    clamps.settle();
    assert_eq!(clamps.axis.position(), 900);
    assert!(clamps.bit(11));
    clamps.start(0x000F, 0);
    assert!(!clamps.bit(11));

    let mut refuses = limited(LimitViolation::Refuse, LimitsOff::BothZero);
    refuses.start(0x000F, 5000);
    assert!(refuses.bit(11) && !refuses.bit(12));
    assert!(refuses.axis.ledger().is_empty());

    let mut off = limited(LimitViolation::Refuse, LimitsOff::MinNotBelowMax);
    off.axis.set(0x607D, 1, 1000).expect("minimum");
    off.start(0x000F, 5000);
    assert!(off.bit(12));
}

#[test]
fn limits_that_need_a_reference_are_off_before() {
    let behaviour = Behaviour {
        limits_need_reference: true,
        ..Behaviour::akd2g()
    };
    let mut bench = Bench::enabled(behaviour);
    bench.axis.set(0x607D, 2, 1000).expect("maximum");
    bench.start(0x000F, 1500);
    bench.settle();
    assert_eq!(bench.axis.position(), 1500);
    bench.axis.set_referenced(true);
    bench.start(0x000F, 1600);
    bench.settle();
    assert_eq!(bench.axis.position(), 1000);
}

#[test]
fn the_ends_of_the_position_range_are_reached_and_6064h_wraps_beyond() {
    for target in [i32::MAX, i32::MIN] {
        let mut bench = Bench::enabled(Behaviour::akd2g());
        for index in [0x6081, 0x6083, 0x6084] {
            bench.set(index, u32::MAX.into());
        }
        bench.start(0x000F, target.into());
        bench.settle();
        assert_eq!(bench.axis.position(), target.into());
        assert_eq!(bench.axis.get(0x6064, 0), Some(target.into()));
        bench.start(0x004F, target.signum().into());
        bench.settle();
        assert_eq!(
            bench.axis.position(),
            i64::from(target) + i64::from(target.signum())
        );
        let wrapped = target.wrapping_add(target.signum());
        assert_eq!(bench.axis.get(0x6064, 0), Some(wrapped.into()));
    }
}

#[test]
fn objects_refuse_what_they_cannot_hold() {
    let mut bench = Bench::new(Behaviour::akd2g());
    let mut set = |index, sub, value| bench.axis.set(index, sub, value);
    assert_eq!(set(0x6041, 0, 0), Err(SetError::ReadOnly));
    assert_eq!(set(0x6040, 1, 0), Err(SetError::Unknown));
    assert_eq!(set(0x2010, 0, 0), Err(SetError::Unknown));
    assert_eq!(set(0x6040, 0, 0x1_0000), Err(SetError::OutOfRange));
    assert_eq!(set(0x607A, 0, 1 << 31), Err(SetError::OutOfRange));
    assert_eq!(set(0x605A, 0, 9), Err(SetError::OutOfRange));
    assert_eq!(set(0x6086, 0, 1), Err(SetError::OutOfRange));
    assert_eq!(set(0x607D, 0, 2), Err(SetError::ReadOnly));
}

#[test]
fn entries_are_sorted_and_every_record_counts_its_entries() {
    let bench = Bench::new(Behaviour::akd2g());
    let entries = bench.axis.entries();
    for pair in entries.windows(2) {
        assert!((pair[0].index, pair[0].subindex) < (pair[1].index, pair[1].subindex));
    }
    for entry in entries {
        let value = bench
            .axis
            .get(entry.index, entry.subindex)
            .expect("has a value");
        let highest = entries
            .iter()
            .filter(|other| other.index == entry.index)
            .map(|e| e.subindex)
            .max();
        if entry.subindex == 0 && highest > Some(0) {
            assert_eq!(Some(value), highest.map(i64::from), "{:04X}", entry.index);
        }
    }
}

#[test]
fn a_mode_without_support_is_echoed_and_not_displayed() {
    let mut bench = Bench::new(Behaviour::akd2g());
    bench.set(0x6060, 2);
    bench.run(5);
    assert_eq!(bench.axis.get(0x6060, 0), Some(2));
    assert_eq!(bench.axis.get(0x6061, 0), Some(1));
}

/// Pitfalls 16 and 33: a mode change under halt is refused, and a 0 in 6060h clears the mode, where drives do so.
#[test]
fn mode_changes_under_halt_and_to_zero_are_the_drives_choice() {
    let behaviour = Behaviour {
        halt_blocks_mode_change: true,
        mode_change_cycles: 3,
        ..Behaviour::generic()
    };
    let mut bench = Bench::enabled(behaviour);
    bench.word(0x010F);
    bench.set(0x6060, 8);
    bench.run(10);
    assert_eq!(bench.axis.get(0x6061, 0), Some(1));
    bench.word(0x000F);
    bench.run(2);
    assert_eq!(bench.axis.get(0x6061, 0), Some(1));
    bench.run(1);
    assert_eq!(bench.axis.get(0x6061, 0), Some(8));
    bench.set(0x6060, 0);
    bench.run(10);
    assert_eq!(bench.axis.get(0x6061, 0), Some(0));

    let mut keeps = Bench::enabled(Behaviour::akd2g());
    keeps.set(0x6060, 0);
    keeps.run(10);
    assert_eq!(keeps.axis.get(0x6061, 0), Some(1));
}

#[test]
fn a_blend_works_in_the_negative_direction_too() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.start(0x000F, -4000);
    bench.start(0x020F, -8000);
    bench.settle();
    assert_eq!(bench.outcomes(), [Passed, Reached]);
    assert_eq!(bench.axis.position(), -8000);
}
