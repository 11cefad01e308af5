//! Bits 4 and 12, the set-point buffer, and the ways in which an acknowledge misbehaves.

use super::super::{
    AckFault, AckPolicy, Behaviour, Bit5, Cause, FullBuffer, Outcome, ReachedPolicy, State,
};
use super::Bench;

use Outcome::{Active, Discarded, Queued, Reached, Replaced};

fn buffer_free() -> Behaviour {
    Behaviour {
        ack: AckPolicy::BufferFree,
        ..Behaviour::akd2g()
    }
}

/// Pitfall 38: a simulated drive that moves on the target's level hides the masters' mistakes.
#[test]
fn only_an_edge_of_bit_4_moves_the_axis_and_raises_bit_12() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    for target in [100, -100, 4000] {
        bench.set(0x607A, target);
        bench.run(50);
    }
    assert!(bench.axis.ledger().is_empty());
    assert!(!bench.bit(12));
    bench.word(0x001F);
    assert!(bench.bit(12));
    bench.settle();
    assert_eq!(bench.axis.position(), 4000);
    for target in [100, -100] {
        bench.set(0x607A, target);
        bench.run(500);
    }
    assert_eq!(
        bench.axis.position(),
        4000,
        "a bit 4 that stays high starts nothing"
    );
    assert_eq!(bench.axis.ledger().len(), 1);
}

#[test]
fn an_edge_outside_operation_enabled_or_profile_position_mode_is_lost() {
    let mut bench = Bench::new(Behaviour::akd2g());
    bench.set(0x607A, 4000);
    for word in [
        0x0006, 0x0016, 0x0006, 0x0007, 0x0017, 0x0007, 0x001F, 0x001F,
    ] {
        bench.word(word);
    }
    assert_eq!(bench.axis.state(), State::OperationEnabled);
    assert!(!bench.bit(12));
    bench.word(0x000F);
    bench.set(0x6060, 8);
    bench.run(1);
    bench.word(0x001F);
    bench.set(0x6060, 1);
    bench.run(100);
    assert_eq!(bench.axis.get(0x6061, 0), Some(1));
    assert!(bench.axis.ledger().is_empty());
    assert!(!bench.axis.moved_since(core::time::Duration::ZERO));
}

#[test]
fn a_drive_with_that_habit_takes_a_high_bit_4_at_the_mode_change_as_an_edge() {
    let behaviour = Behaviour {
        edge_at_mode_change: true,
        ..Behaviour::akd2g()
    };
    let mut bench = Bench::enabled(behaviour);
    bench.set(0x607A, 4000);
    bench.set(0x6060, 8);
    bench.run(1);
    bench.word(0x001F);
    bench.set(0x6060, 1);
    bench.run(1);
    assert_eq!(bench.outcomes(), [Active]);
}

#[test]
fn two_moves_to_the_same_target_are_two_set_points() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    for _ in 0..2 {
        bench.start(0x000F, 500);
        assert!(bench.bit(12));
        bench.settle();
    }
    assert_eq!(bench.outcomes(), [Reached, Reached]);
}

#[test]
fn a_move_of_no_length_is_reached_in_its_own_cycle() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.start(0x000F, 0);
    assert!(bench.bit(12) && bench.bit(10));
    assert_eq!(bench.outcomes(), [Reached]);
}

#[test]
fn a_queued_set_point_starts_from_standstill_at_the_first_target() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.start(0x000F, 1000);
    bench.run(20);
    bench.start(0x000F, 3000);
    assert!(bench.bit(12), "AKD2G: each taken edge is acknowledged");
    assert_eq!(bench.outcomes(), [Active, Queued]);
    bench.word(0x000F);
    assert!(
        !bench.bit(12),
        "AKD2G: falls with bit 4 although the buffer is full"
    );
    while bench.outcomes() != [Reached, Active] {
        assert!(!bench.bit(10));
        bench.run(1);
    }
    assert_eq!(bench.axis.position(), 1000);
    assert_eq!(bench.axis.velocity(), 0.0);
    assert!(!bench.bit(10), "0 until all set-points are processed");
    bench.settle();
    assert_eq!(bench.axis.position(), 3000);
    assert!(bench.bit(10));
}

#[test]
fn with_buffer_free_the_acknowledge_shows_a_full_buffer() {
    let mut bench = Bench::enabled(buffer_free());
    bench.start(0x000F, 1000);
    assert!(bench.bit(12));
    bench.word(0x000F);
    assert!(!bench.bit(12), "one slot is free");
    bench.start(0x000F, 3000);
    bench.word(0x000F);
    assert!(bench.bit(12), "both are busy");
    bench.start(0x000F, 9000);
    assert_eq!(
        bench.outcomes(),
        [Active, Queued],
        "an edge on a full buffer is lost"
    );
    bench.word(0x000F);
    while bench.outcomes() != [Reached, Active] {
        assert!(bench.bit(12));
        bench.run(1);
    }
    assert!(!bench.bit(12));
    bench.settle();
    assert_eq!(bench.axis.position(), 3000);
}

#[test]
fn with_a_full_buffer_that_overwrites_the_waiting_one_is_replaced() {
    let behaviour = Behaviour {
        full_buffer: FullBuffer::OverwritePending,
        ..buffer_free()
    };
    let mut bench = Bench::enabled(behaviour);
    for target in [1000, 3000, 2000] {
        bench.start(0x000F, target);
    }
    assert_eq!(bench.outcomes(), [Active, Replaced, Queued]);
    bench.word(0x000F);
    bench.settle();
    assert_eq!(bench.axis.position(), 2000);
}

#[test]
fn on_the_akd2g_an_edge_on_a_full_buffer_is_not_acknowledged() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    for target in [1000, 3000] {
        bench.start(0x000F, target);
        assert!(bench.bit(12));
    }
    bench.start(0x000F, 9000);
    assert!(!bench.bit(12));
    assert_eq!(bench.axis.ledger().len(), 2);
}

#[test]
fn bit_5_replaces_the_active_and_drops_the_waiting_one() {
    for behaviour in [Behaviour::akd2g(), buffer_free()] {
        let mut bench = Bench::enabled(behaviour);
        bench.start(0x000F, 4000);
        bench.start(0x000F, 8000);
        bench.run(100);
        bench.start(0x002F, -500);
        assert!(bench.bit(12));
        assert_eq!(bench.outcomes(), [Replaced, Replaced, Active]);
        bench.word(0x002F);
        assert!(!bench.bit(12));
        bench.settle();
        assert_eq!(bench.axis.position(), -500);
        assert_eq!(bench.outcomes(), [Replaced, Replaced, Reached]);
    }
}

#[test]
fn a_sticky_acknowledge_is_high_at_enabling_until_bit_4_was_pulsed() {
    let behaviour = Behaviour {
        ack: AckPolicy::StickyAtEnable,
        ..Behaviour::akd2g()
    };
    let mut bench = Bench::enabled(behaviour);
    bench.run(50);
    assert!(bench.bit(12));
    bench.start(0x000F, 300);
    assert!(bench.bit(12), "no edge to be seen for the first set-point");
    bench.word(0x000F);
    assert!(!bench.bit(12));
    bench.settle();
    bench.start(0x000F, 600);
    assert!(bench.bit(12));
    bench.settle();
    assert_eq!(bench.outcomes(), [Reached, Reached]);
}

#[test]
fn an_acknowledge_can_come_late_never_or_always() {
    let mut late = Bench::enabled(Behaviour::akd2g());
    late.axis.disturbances().ack_delay_cycles = 3;
    late.start(0x000F, 300);
    let mut seen = vec![late.bit(12)];
    for _ in 0..4 {
        late.run(1);
        seen.push(late.bit(12));
    }
    assert_eq!(seen, [false, false, true, true, true]);
    late.word(0x000F);
    assert!(!late.bit(12));
    late.start(0x000F, 600);
    late.word(0x000F);
    late.run(20);
    assert!(!late.bit(12), "bit 4 fell before the acknowledge rose");

    let mut never = Bench::enabled(Behaviour::akd2g());
    never.axis.disturbances().ack = AckFault::Never;
    never.start(0x000F, 300);
    never.settle();
    assert!(!never.bit(12));
    assert_eq!(never.outcomes(), [Reached], "taken all the same");

    let mut always = Bench::enabled(Behaviour::akd2g());
    always.axis.disturbances().ack = AckFault::StuckHigh;
    always.run(2);
    assert!(always.bit(12));
    assert!(always.axis.ledger().is_empty());
}

/// Pitfall 2: slow drives miss a bit 4 that is high for one cycle.
#[test]
fn a_slow_drive_misses_a_short_pulse_of_bit_4() {
    let mut bench = Bench::enabled(Behaviour {
        bit_4_filter_cycles: 3,
        ..Behaviour::akd2g()
    });
    bench.start(0x000F, 300);
    bench.word(0x000F);
    bench.run(20);
    assert!(bench.axis.ledger().is_empty());
    bench.start(0x000F, 300);
    bench.run(2);
    assert!(!bench.bit(12));
    bench.run(1);
    assert!(bench.bit(12));
    assert_eq!(bench.outcomes(), [Active]);
}

/// Pitfall 7: bit 10 is still that of the move before.
#[test]
fn target_reached_can_be_stale_after_the_acknowledge() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.start(0x000F, 300);
    bench.settle();
    bench.axis.disturbances().stale_reached_cycles = 4;
    bench.start(0x000F, 5000);
    let mut seen = vec![bench.bit(10)];
    for _ in 0..5 {
        bench.run(1);
        seen.push(bench.bit(10));
    }
    assert_eq!(seen, [true, true, true, true, false, false]);
    assert!(bench.bit(12));
}

#[test]
fn an_edge_during_halt_is_stored_and_starts_on_release() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.start(0x000F, 4000);
    bench.run(100);
    bench.start(0x012F, -1000);
    assert!(bench.bit(12));
    assert_eq!(bench.outcomes(), [Replaced, Queued]);
    bench.run(500);
    let paused = bench.now;
    bench.run(100);
    assert!(!bench.axis.moved_since(paused));
    bench.word(0x002F);
    bench.settle();
    assert_eq!(bench.axis.position(), -1000);
    assert_eq!(bench.outcomes(), [Replaced, Reached]);
}

#[test]
fn a_drive_that_forgets_on_halt_stays_where_it_stopped() {
    let mut bench = Bench::enabled(Behaviour {
        halt_keeps: false,
        ..Behaviour::akd2g()
    });
    bench.start(0x000F, 4000);
    bench.run(100);
    bench.word(0x011F);
    assert_eq!(bench.outcomes(), [Discarded(Cause::Halt)]);
    bench.run(500);
    let stopped = bench.now;
    bench.word(0x001F);
    bench.run(100);
    assert!(!bench.axis.moved_since(stopped));
}

#[test]
fn leaving_operation_enabled_or_the_mode_discards() {
    for (word, cause) in [
        (0x0007, Cause::Disabled),
        (0x0006, Cause::Disabled),
        (0x0000, Cause::Disabled),
        (0x000B, Cause::QuickStop),
    ] {
        let mut bench = Bench::enabled(Behaviour::akd2g());
        bench.start(0x000F, 4000);
        bench.start(0x000F, 8000);
        bench.run(100);
        bench.word(word);
        assert_eq!(bench.outcomes(), [Discarded(cause); 2], "{word:04X}");
        bench.settle();
        let stopped = bench.now;
        bench.enable();
        bench.run(100);
        assert!(!bench.axis.moved_since(stopped), "{word:04X}");
    }
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.start(0x000F, 4000);
    bench.run(100);
    bench.set(0x6060, 8);
    bench.run(1);
    assert_eq!(bench.outcomes(), [Discarded(Cause::ModeChange)]);
    bench.settle();
    bench.set(0x6060, 1);
    bench.run(100);
    assert_eq!(bench.axis.ledger().len(), 1);
    assert!(bench.axis.position() < 4000);
}

#[test]
fn on_an_ax2000_bit_5_passes_through_instead_of_replacing() {
    let behaviour = Behaviour {
        bit_5: Bit5::Blends,
        ..buffer_free()
    };
    let mut bench = Bench::enabled(behaviour);
    bench.start(0x002F, 2000);
    bench.run(50);
    bench.start(0x002F, 6000);
    assert_eq!(bench.outcomes(), [Active, Queued]);
    bench.settle();
    assert_eq!(bench.outcomes(), [Outcome::Passed, Reached]);
}

#[test]
fn target_reached_waits_for_the_window_time() {
    let mut bench = Bench::enabled(Behaviour {
        actual_lag_cycles: 2,
        ..Behaviour::akd2g()
    });
    bench.set(0x6068, 20);
    bench.start(0x000F, 300);
    while bench.axis.ledger()[0].outcome != Reached {
        bench.run(1);
    }
    let ended = bench.now;
    while !bench.bit(10) {
        bench.run(1);
    }
    let waited = (bench.now - ended).as_millis();
    assert!((20..=23).contains(&waited), "{waited} ms");

    let behaviour = Behaviour {
        reached: ReachedPolicy::Window,
        ..Behaviour::akd2g()
    };
    let mut early = Bench::enabled(behaviour);
    early.set(0x6067, 200);
    early.start(0x000F, 4000);
    while !early.bit(10) {
        early.run(1);
    }
    assert!(
        (3800..4000).contains(&early.axis.position()),
        "{}",
        early.axis.position()
    );
}

#[test]
fn an_edge_while_a_disabling_ramp_runs_is_lost() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.start(0x000F, 4000);
    bench.run(150);
    bench.word(0x0007);
    bench.start(0x000F, 8000);
    assert_eq!(
        bench.axis.state(),
        State::OperationEnabled,
        "the ramp still runs"
    );
    bench.run(300);
    assert_eq!(bench.outcomes(), [Discarded(Cause::Disabled)]);
}

#[test]
fn the_preset_pp2010_holds_two_set_points_and_knows_no_blend() {
    let mut bench = Bench::enabled(Behaviour::pp2010());
    bench.start(0x000F, 1000);
    bench.start(0x020F, 2000);
    bench.word(0x000F);
    assert!(bench.bit(12), "both are busy");
    bench.settle();
    assert_eq!(bench.outcomes(), [Reached, Reached]);
}

#[test]
fn the_ax2000_preset_blends_by_bit_5_with_linear_ramps_only() {
    for (profile_type, first) in [(0, Outcome::Passed), (1, Reached)] {
        let mut bench = Bench::enabled(Behaviour::ax2000());
        bench.set(0x6086, profile_type);
        bench.start(0x002F, 2000);
        bench.start(0x002F, 6000);
        assert_eq!(bench.outcomes(), [Active, Queued]);
        bench.settle();
        assert_eq!(bench.outcomes(), [first, Reached], "6086h = {profile_type}");
    }
}

#[test]
fn the_acknowledge_falls_when_operation_ends() {
    for word in [0x001B, 0x0017, 0x0010] {
        let mut bench = Bench::enabled(Behaviour::akd2g());
        bench.start(0x000F, 4000);
        assert!(bench.bit(12));
        bench.word(word);
        assert!(!bench.bit(12), "{word:04X}");
    }
}
