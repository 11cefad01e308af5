//! Faults, resets, emergencies, following error, and the lost connection.

use super::super::{Behaviour, Cause, Emergency, FollowingError, Outcome, State};
use super::Bench;

fn moving(behaviour: Behaviour) -> Bench {
    let mut bench = Bench::enabled(behaviour);
    bench.start(0x000F, 10_000);
    bench.run(150);
    assert_eq!(bench.axis.velocity(), 10_000.0);
    bench
}

#[test]
fn a_fault_stops_by_605eh_and_reports() {
    for (option, cycles) in [(0, 1), (1, 200), (2, 50)] {
        let mut bench = moving(Behaviour::akd2g());
        bench.set(0x605E, option);
        bench.axis.inject_fault(0x2310);
        assert_eq!(bench.outcomes(), [Outcome::Discarded(Cause::Fault)]);
        assert_eq!(
            bench.axis.take_emergency(),
            Some(Emergency {
                code: 0x2310,
                register: 0x03,
                data: [0; 5]
            })
        );
        assert_eq!(bench.axis.take_emergency(), None);
        let mut reacting = 0;
        loop {
            bench.run(1);
            if bench.axis.state() == State::Fault {
                break;
            }
            assert_eq!(bench.axis.statusword() & 0x004F, 0x000F);
            reacting += 1;
        }
        assert!(
            (cycles - 1..=cycles + 1).contains(&reacting),
            "605Eh = {option}: {reacting}"
        );
        assert_eq!(bench.axis.get(0x603F, 0), Some(0x2310));
        assert_eq!(bench.axis.error_register(), 0x03);
    }
}

#[test]
fn only_a_rising_bit_7_in_fault_resets_it() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.word(0x008F);
    bench.axis.inject_fault(0x3210);
    bench.run(10);
    assert_eq!(bench.axis.state(), State::Fault, "bit 7 was high before");
    bench.word(0x000F);
    bench.word(0x0006);
    assert_eq!(bench.axis.state(), State::Fault);
    bench.axis.take_emergency();
    bench.word(0x0080);
    assert_eq!(bench.axis.state(), State::SwitchOnDisabled);
    assert_eq!(
        bench.axis.take_emergency(),
        Some(Emergency {
            code: 0,
            register: 0,
            data: [0; 5]
        })
    );
    assert_eq!(bench.axis.get(0x603F, 0), Some(0));
    bench.axis.inject_fault(0x3210);
    bench.run(10);
    assert_eq!(
        bench.axis.state(),
        State::Fault,
        "bit 7 held high gives no second edge"
    );
}

#[test]
fn a_lasting_cause_refuses_the_reset() {
    let mut bench = Bench::new(Behaviour::akd2g());
    bench.axis.inject_lasting_fault(0x4210);
    bench.run(3);
    bench.word(0x0080);
    assert_eq!(bench.axis.state(), State::Fault);
    bench.axis.clear_cause();
    bench.run(5);
    assert_eq!(bench.axis.state(), State::Fault, "the edge was before");
    bench.word(0x0000);
    bench.word(0x0080);
    assert_eq!(bench.axis.state(), State::SwitchOnDisabled);
}

#[test]
fn a_reset_word_that_also_enables_only_resets() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.axis.inject_fault(0x3210);
    bench.run(5);
    bench.word(0x009F);
    bench.run(50);
    assert_eq!(bench.axis.state(), State::SwitchOnDisabled);
    assert!(bench.axis.ledger().is_empty());
}

#[test]
fn a_blocked_shaft_ends_in_the_following_error() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.set(0x6065, 500);
    bench.set(0x6066, 20);
    bench.axis.disturbances().blocked = true;
    bench.start(0x000F, 10_000);
    let started = bench.now;
    while bench.axis.state() == State::OperationEnabled {
        bench.run(1);
    }
    let taken = (bench.now - started).as_millis();
    // 500 counts in 100 ms: 50 ms of ramp at 10000 counts/s² · 10, then on at 10000 counts/s; 20 ms of time out.
    assert!((100..=140).contains(&taken), "{taken} ms");
    bench.settle();
    bench.run(200);
    assert_eq!(bench.axis.state(), State::Fault);
    assert!(bench.bit(13));
    assert_eq!(bench.axis.get(0x603F, 0), Some(0x8611));
    assert_eq!(bench.axis.position(), 0);
    assert_eq!(
        bench.axis.get(0x60F4, 0),
        Some(0),
        "without power the demand is where the axis is"
    );
    bench.word(0x0080);
    assert!(!bench.bit(13));
}

#[test]
fn the_following_error_check_can_be_off_or_only_a_bit() {
    let mut off = Bench::enabled(Behaviour::akd2g());
    off.set(0x6065, 0xFFFF_FFFF);
    off.axis.disturbances().blocked = true;
    off.start(0x000F, 4000);
    off.run(2000);
    assert_eq!(off.axis.state(), State::OperationEnabled);
    assert!(!off.bit(13));
    assert!(!off.bit(10), "not within the window");
    assert_eq!(off.axis.get(0x60F4, 0), Some(4000));

    let behaviour = Behaviour {
        following_error: FollowingError::BitOnly,
        ..Behaviour::akd2g()
    };
    let mut bit = Bench::enabled(behaviour);
    bit.set(0x6065, 100);
    bit.axis.disturbances().blocked = true;
    bit.start(0x000F, 4000);
    bit.run(200);
    assert_eq!(bit.axis.state(), State::OperationEnabled);
    assert!(bit.bit(13));
    bit.axis.disturbances().blocked = false;
    bit.run(1);
    assert!(!bit.bit(13));
}

#[test]
fn a_lost_connection_does_what_6007h_says() {
    let mut nothing = moving(Behaviour::akd2g());
    nothing.set(0x6007, 0);
    nothing.axis.connection_lost();
    nothing.settle();
    assert_eq!(nothing.axis.position(), 10_000);

    let mut fault = moving(Behaviour::akd2g());
    fault.set(0x6007, 1);
    fault.axis.connection_lost();
    fault.run(60);
    assert_eq!(fault.axis.state(), State::Fault);
    fault.word(0x0080);
    assert_eq!(
        fault.axis.state(),
        State::Fault,
        "the connection is still gone"
    );
    fault.axis.connection_restored();
    fault.word(0x0000);
    fault.word(0x0080);
    assert_eq!(fault.axis.state(), State::SwitchOnDisabled);

    let mut voltage = moving(Behaviour::akd2g());
    voltage.set(0x6007, 2);
    voltage.axis.connection_lost();
    assert_eq!(voltage.axis.state(), State::SwitchOnDisabled);
    assert_eq!(voltage.outcomes(), [Outcome::Discarded(Cause::Disabled)]);

    let mut quick_stop = moving(Behaviour::generic());
    quick_stop.set(0x6007, 3);
    quick_stop.set(0x605A, 6);
    quick_stop.axis.connection_lost();
    quick_stop.run(200);
    assert_eq!(
        quick_stop.axis.state(),
        State::QuickStopActive,
        "not enabled again by 000Fh"
    );
    assert_eq!(
        quick_stop.outcomes(),
        [Outcome::Discarded(Cause::QuickStop)]
    );
    let stood = quick_stop.now;
    quick_stop.axis.connection_restored();
    quick_stop.run(200);
    assert!(!quick_stop.axis.moved_since(stood));
}

#[test]
fn lost_voltage_faults_a_powered_axis_and_the_reset_needs_it_back() {
    let mut bench = moving(Behaviour::akd2g());
    bench.axis.set_voltage(false);
    bench.run(100);
    assert_eq!(bench.axis.state(), State::Fault);
    assert!(!bench.bit(4));
    assert_eq!(bench.axis.get(0x603F, 0), Some(0x3220));
    bench.word(0x0080);
    assert_eq!(bench.axis.state(), State::Fault);
    bench.axis.set_voltage(true);
    bench.word(0x0000);
    bench.word(0x0080);
    assert_eq!(bench.axis.state(), State::SwitchOnDisabled);
}

#[test]
fn a_ramp_of_605bh_and_605ch_is_run_to_its_end_before_the_state_changes() {
    for (word, option, end) in [
        (0x0007, 0x605C, State::SwitchedOn),
        (0x0006, 0x605B, State::ReadyToSwitchOn),
    ] {
        let mut bench = moving(Behaviour::akd2g());
        bench.set(option, 1);
        bench.word(word);
        bench.run(100);
        assert_eq!(bench.axis.state(), State::OperationEnabled);
        bench.run(101);
        assert_eq!(bench.axis.state(), end);
        assert_eq!(bench.axis.velocity(), 0.0);

        let mut bench = moving(Behaviour::akd2g());
        bench.set(option, 0);
        bench.word(word);
        assert_eq!(bench.axis.state(), end);
    }
}

#[test]
fn quick_stop_takes_the_ramp_of_605ah() {
    for (option, cycles) in [(1, 200), (2, 50), (5, 200), (6, 50)] {
        let mut bench = moving(Behaviour::generic());
        bench.set(0x605A, option);
        bench.word(0x000B);
        // 000Fh would lead back (transition 16), but not before the axis stands.
        bench.word(0x000F);
        let mut left = cycles - 1;
        while bench.axis.velocity() > 0.0 {
            assert_eq!(
                bench.axis.state(),
                State::QuickStopActive,
                "605Ah = {option}"
            );
            bench.run(1);
            left -= 1;
        }
        assert_eq!(left, 0, "605Ah = {option}");
        let end = if option < 5 {
            State::SwitchOnDisabled
        } else {
            State::OperationEnabled
        };
        assert_eq!(bench.axis.state(), end, "605Ah = {option}");
    }
}

#[test]
fn a_shaft_that_was_blocked_stays_where_it_is_when_it_comes_free_without_power() {
    let mut bench = Bench::enabled(Behaviour {
        actual_lag_cycles: 3,
        ..Behaviour::akd2g()
    });
    bench.axis.disturbances().blocked = true;
    bench.start(0x000F, 10_000);
    bench.run(200);
    bench.word(0x0000);
    bench.axis.disturbances().blocked = false;
    bench.run(10);
    assert_eq!(bench.axis.position(), 0);
    assert!(!bench.axis.moved_since(core::time::Duration::ZERO));
}
