//! Pitfalls 20 to 29: reading the statusword, and the way through the state machine.

use core::time::Duration;

use servocrab::SetPoint;
use servocrab::ds402::{Mode, QuickStopOption, State, Statusword, SupportedModes};
use servocrab::{
    Failure,
    axis::{AxisCore, AxisFields, Command, CommandId, Completion, CoreConfig, Delivery, Inputs},
};
use servocrab_sim::ds402::Behaviour;

use crate::common::Rig;
use crate::{BIT_7, enabled, rises, target};

/// An axis with a lasting fault, in Fault.
fn faulty() -> Rig {
    let mut rig = Rig::enabled();
    rig.drive.inject_lasting_fault(0x3210);
    rig.run_until(1_000, |rig| rig.core.snapshot().state == State::Fault);
    rig
}

#[test]
fn pitfall_20_bit_5_is_not_looked_at_where_it_is_not_defined() {
    let mut rig = enabled(|drive| drive.open_bit_5 = true);
    rig.drive.inject_fault(0x7305);
    rig.run_until(1_000, |rig| rig.core.snapshot().state == State::Fault);
    assert!(rig.statusword().contains(Statusword::QUICK_STOP));
    let reset = rig.send(Command::ResetFault);
    assert!(rig.finish(reset).is_ok());
    for (word, state) in [
        (0x0020, State::NotReadyToSwitchOn),
        (0x0060, State::SwitchOnDisabled),
        (0x002F, State::FaultReactionActive),
        (0x0028, State::Fault),
    ] {
        assert_eq!(Statusword::from_bits_retain(word).state(), state);
    }
}

#[test]
fn pitfall_21_quick_stop_active_is_not_taken_for_operation_enabled() {
    let behaviour = Behaviour {
        quick_stop_option: 6,
        abort_connection_option: 3,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |config| config.quick_stop = QuickStopOption(6));
    rig.enable();
    let id = rig.abs(1_000_000, SetPoint::new());
    rig.wait_accepted(id);
    rig.run(100);
    // The drive stops by itself.
    rig.drive.connection_lost();
    rig.drive.connection_restored();
    rig.run(10);
    assert_eq!(rig.core.snapshot().state, State::QuickStopActive);
    assert_eq!(
        rig.outcome(id),
        Some(Err(Failure::QuickStopped {
            delivery: Delivery::Accepted
        }))
    );
    let refused = rig.abs(0, SetPoint::new());
    assert!(matches!(
        rig.outcome(refused),
        Some(Err(Failure::NotEnabled { .. }))
    ));
}

#[test]
fn pitfall_22_the_upper_bits_of_the_statusword_change_no_state() {
    let mut rig = Rig::new(
        Behaviour {
            manufacturer_bits: 0xC100,
            ..Behaviour::akd2g()
        },
        |_| {},
    );
    rig.drive.set_warning(true);
    rig.enable();
    let id = rig.abs(10_000, SetPoint::new());
    rig.assert_reached(id, 10_000);
    assert_eq!(rig.statusword().bits() & 0xC180, 0xC180);
}

#[test]
fn pitfall_23_a_drive_that_does_not_show_its_voltage_is_enabled() {
    let mut core = AxisCore::new(CoreConfig::new(AxisFields::at(0, 0)));
    let mut outputs = [0; 6];
    core.submit(Duration::ZERO, CommandId(1), Command::Enable, &mut outputs);
    // Bit 4 is 0 in each statusword, as on a drive that does not have it.
    // What it shows first counts when it has shown it for two of its cycles.
    for (cycle, (statusword, controlword)) in (1..).zip([
        (0x0240, 0x0B),
        (0x0240, 0x0B),
        (0x0240, 0x06),
        (0x0221, 0x07),
        (0x0223, 0x0F),
        (0x0227, 0x0F),
    ]) {
        let [low, high] = u16::to_le_bytes(statusword);
        let inputs = [low, high, 0, 0, 0, 0];
        let now = Duration::from_millis(cycle);
        core.step(now, Inputs::Fresh(&inputs), &mut outputs);
        assert_eq!(outputs[0], controlword, "after {statusword:#06x}");
    }
    assert_eq!(core.snapshot().state, State::OperationEnabled);
}

#[test]
fn pitfall_24_bit_7_falls_so_that_a_second_edge_is_possible() {
    let mut rig = faulty();
    let reset = rig.send(Command::ResetFault);
    rig.run(150);
    assert_eq!(rig.outcome(reset), None);
    rig.drive.clear_cause();
    rig.run(1_000);
    assert_eq!(
        rig.outcome(reset),
        Some(Ok(Completion::Stopped {
            state: State::SwitchOnDisabled
        }))
    );
    assert_eq!(rises(&rig.words, BIT_7), 2);
}

#[test]
fn pitfall_24_bit_7_does_not_outlive_the_reset() {
    let mut rig = Rig::enabled();
    for _ in 0..3 {
        rig.drive.inject_fault(0x7305);
        rig.run_until(1_000, |rig| rig.core.snapshot().state == State::Fault);
        let reset = rig.send(Command::ResetFault);
        assert!(rig.finish(reset).is_ok());
        assert_eq!(rig.word() & BIT_7, 0);
        rig.enable();
    }
    assert_eq!(rises(&rig.words, BIT_7), 3);
}

#[test]
fn pitfall_25_a_reset_gives_up_after_three_edges() {
    let mut rig = faulty();
    let reset = rig.send(Command::ResetFault);
    rig.run(10_000);
    assert!(
        matches!(rig.outcome(reset), Some(Err(Failure::Fault { .. }))),
        "{:?}",
        rig.outcome(reset)
    );
    assert_eq!(rises(&rig.words, BIT_7), 3);
}

#[test]
fn pitfall_25_no_fault_is_reset_unasked() {
    let mut rig = faulty();
    rig.drive.clear_cause();
    rig.run(10_000);
    assert_eq!(rises(&rig.words, BIT_7), 0);
    let enable = rig.send(Command::Enable);
    assert!(matches!(rig.finish(enable), Err(Failure::Fault { .. })));
    rig.run(1_000);
    assert_eq!(rises(&rig.words, BIT_7), 0);
}

#[test]
fn pitfall_26_each_command_waits_for_the_state_that_it_starts_from() {
    for latency in 0..4 {
        let behaviour = Behaviour {
            start_up_cycles: 20,
            power_on_cycles: 20,
            ..Behaviour::akd2g()
        };
        let mut rig = Rig::new(behaviour, |_| {});
        rig.latency = latency;
        let enable = rig.send(Command::Enable);
        while rig.outcome(enable).is_none() {
            assert!(rig.words.len() < 200, "{:x?}", rig.distinct_words(0));
            rig.cycle();
            let expected = match rig.core.snapshot().state {
                State::SwitchOnDisabled => 0x06,
                State::ReadyToSwitchOn => 0x07,
                State::SwitchedOn | State::OperationEnabled => 0x0F,
                _ => 0x00,
            };
            let known = rig.words.len() > 2 + latency;
            let expected = if known { expected } else { 0x0B };
            assert_eq!(rig.word(), expected, "{:?}", rig.core.snapshot());
        }
        assert_eq!(rig.outcome(enable), Some(Ok(Completion::Done)));
        assert_eq!(rig.distinct_words(0), [0x0B, 0x00, 0x06, 0x07, 0x0F]);
    }
}

#[test]
fn pitfall_27_the_reserved_bit_4_of_6502h_is_counted() {
    let rig = Rig::akd2g();
    let word = rig.drive.get(0x6502, 0).expect("the drive has it");
    let modes = SupportedModes::from_bits_retain(u32::try_from(word).expect("32 bits"));
    let expected = SupportedModes::PROFILE_POSITION
        | SupportedModes::PROFILE_VELOCITY
        | SupportedModes::PROFILE_TORQUE
        | SupportedModes::HOMING
        | SupportedModes::CYCLIC_POSITION
        | SupportedModes::CYCLIC_VELOCITY;
    assert_eq!(modes, expected, "{word:#x}");
    let allowed = |mode: &i8| modes.allows(Mode::from_raw(*mode));
    let allowed: Vec<i8> = (1..=16).filter(allowed).collect();
    assert_eq!(allowed, [1, 3, 4, 6, 8, 9]);
}

#[test]
fn pitfall_29_the_target_is_the_actual_position_before_the_mode_is_active() {
    let behaviour = Behaviour {
        mode_change_cycles: 50,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |config| config.mode = Mode::CyclicPosition);
    rig.drive.place(777_000);
    let enable = rig.send(Command::Enable);
    let mut enabling_words = 0;
    for _ in 0..200 {
        rig.cycle();
        if matches!(rig.word() & 0x000F, 0x06 | 0x07 | 0x0F) {
            let off = (target(&rig) - 777_000).abs();
            assert!(off <= 10, "{:?}", rig.core.snapshot());
            enabling_words += 1;
        }
    }
    assert_eq!(rig.outcome(enable), Some(Ok(Completion::Done)));
    assert!(enabling_words > 100);
    assert_eq!(rig.mode(), Mode::CyclicPosition);
}

#[test]
fn pitfall_29_a_mode_that_follows_the_target_finds_the_actual_position_there() {
    let mut rig = Rig::enabled();
    for distance in [30_000, -1_000] {
        let id = rig.rel(distance, SetPoint::new());
        assert!(rig.finish(id).is_ok());
    }
    let change = rig.send(Command::SelectMode(Mode::CyclicPosition));
    // It waits for the shaft to settle.
    for _ in 0..300 {
        rig.cycle();
        if rig.outputs[2] == 8 {
            let off = (target(&rig) - 29_000).abs();
            assert!(off <= 10, "in a frame with mode 8: off by {off}");
        }
    }
    assert_eq!(rig.outcome(change), Some(Ok(Completion::Done)));
}
