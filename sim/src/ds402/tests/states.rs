//! Every state against every controlword, and the statusword of each state.

use super::super::{Behaviour, State};
use super::Bench;

use State::{
    Fault, FaultReactionActive, NotReadyToSwitchOn, OperationEnabled, QuickStopActive,
    ReadyToSwitchOn, SwitchOnDisabled, SwitchedOn,
};

#[derive(Clone, Copy, PartialEq, Debug)]
enum Row {
    Shutdown,
    SwitchOnOrDisableOperation,
    EnableOperation,
    DisableVoltage,
    QuickStop,
}

/// The command table of DSP 402, as mask and value: bits 7, 3, 2, 1, 0.
const WITH_BIT_7: [(u16, u16, Row); 5] = [
    (0x0087, 0x0006, Row::Shutdown),
    (0x008F, 0x0007, Row::SwitchOnOrDisableOperation),
    (0x008F, 0x000F, Row::EnableOperation),
    (0x0082, 0x0000, Row::DisableVoltage),
    (0x0086, 0x0002, Row::QuickStop),
];

/// The command table of the AKD2G, which prints X for bit 7 in every row but fault reset.
const WITHOUT_BIT_7: [(u16, u16, Row); 5] = [
    (0x0007, 0x0006, Row::Shutdown),
    (0x000F, 0x0007, Row::SwitchOnOrDisableOperation),
    (0x000F, 0x000F, Row::EnableOperation),
    (0x0002, 0x0000, Row::DisableVoltage),
    (0x0006, 0x0002, Row::QuickStop),
];

/// Where a command leads within one cycle, for an axis that stands.
fn expected(state: State, row: Row, transition_16: bool) -> State {
    match (state, row) {
        (SwitchOnDisabled, Row::Shutdown) | (SwitchedOn, Row::Shutdown) => ReadyToSwitchOn,
        (ReadyToSwitchOn, Row::SwitchOnOrDisableOperation | Row::EnableOperation) => SwitchedOn,
        (ReadyToSwitchOn | SwitchedOn, Row::DisableVoltage | Row::QuickStop) => SwitchOnDisabled,
        (SwitchedOn, Row::EnableOperation) => OperationEnabled,
        (OperationEnabled, Row::SwitchOnOrDisableOperation) => SwitchedOn,
        (OperationEnabled, Row::Shutdown) => ReadyToSwitchOn,
        (OperationEnabled | QuickStopActive, Row::DisableVoltage) => SwitchOnDisabled,
        (OperationEnabled, Row::QuickStop) => QuickStopActive,
        (QuickStopActive, Row::EnableOperation) if transition_16 => OperationEnabled,
        (unchanged, _) => unchanged,
    }
}

/// An axis that stands in the given state, after a controlword with bits 4 and 7 low.
fn standing_in(state: State, behaviour: Behaviour) -> Bench {
    let mut bench = Bench::new(behaviour);
    let words: &[u16] = match state {
        ReadyToSwitchOn => &[0x0006],
        SwitchedOn => &[0x0006, 0x0007],
        OperationEnabled => &[0x0006, 0x0007, 0x000F],
        QuickStopActive => &[0x0006, 0x0007, 0x000F, 0x000B],
        _ => &[0x0000],
    };
    bench.set(0x605A, 6);
    for &word in words {
        bench.word(word);
    }
    if state == Fault {
        bench.axis.inject_fault(0x3210);
        bench.run(3);
    }
    assert_eq!(bench.axis.state(), state);
    bench
}

fn every_word(behaviour: &Behaviour, table: &[(u16, u16, Row)]) {
    let reachable = [
        SwitchOnDisabled,
        ReadyToSwitchOn,
        SwitchedOn,
        OperationEnabled,
        QuickStopActive,
        Fault,
    ];
    for state in reachable {
        let start = standing_in(state, behaviour.clone());
        for word in 0..=u16::MAX {
            let rows: Vec<Row> = table
                .iter()
                .filter(|(mask, value, _)| word & mask == *value)
                .map(|&(_, _, row)| row)
                .collect();
            assert!(rows.len() <= 1, "{word:04X} is {rows:?}");
            let want = match (state, rows.first()) {
                (Fault, _) if word & 0x0080 != 0 => SwitchOnDisabled,
                (_, Some(&row)) => expected(state, row, behaviour.transition_16),
                (_, None) => state,
            };
            let mut bench = start.clone();
            bench.word(word);
            assert_eq!(bench.axis.state(), want, "{word:04X} in {state:?}");
            assert!(
                !bench.axis.moved_since(start.now),
                "{word:04X} in {state:?} moved"
            );
        }
    }
}

#[test]
fn every_controlword_in_every_state_leads_where_dsp_402_says() {
    every_word(&Behaviour::generic(), &WITH_BIT_7);
}

#[test]
fn every_controlword_in_every_state_leads_where_the_akd2g_says() {
    every_word(&Behaviour::akd2g(), &WITHOUT_BIT_7);
}

#[test]
fn each_state_shows_its_pattern() {
    let patterns = [
        (SwitchOnDisabled, 0x004F, 0x0040),
        (ReadyToSwitchOn, 0x006F, 0x0021),
        (SwitchedOn, 0x006F, 0x0023),
        (OperationEnabled, 0x006F, 0x0027),
        (QuickStopActive, 0x006F, 0x0007),
        (Fault, 0x004F, 0x0008),
    ];
    for (state, mask, value) in patterns {
        for open_bit_5 in [false, true] {
            let behaviour = Behaviour {
                open_bit_5,
                manufacturer_bits: 0xFFFF,
                ..Behaviour::akd2g()
            };
            let mut bench = standing_in(state, behaviour);
            bench.run(1);
            let statusword = bench.axis.statusword();
            assert_eq!(statusword & mask, value, "{state:?}");
            assert_eq!(
                statusword & 0xC310,
                0xC310,
                "bits 4, 8, 9, 14, 15 in {state:?}"
            );
            let undefined = matches!(state, SwitchOnDisabled | Fault);
            if undefined {
                assert_eq!(bench.bit(5), open_bit_5, "{state:?}");
            }
        }
    }
}

#[test]
fn start_up_and_fault_reaction_are_seen() {
    let mut axis = super::super::Axis::new(Behaviour {
        start_up_cycles: 3,
        ..Behaviour::akd2g()
    });
    let mut seen = Vec::new();
    for cycle in 1..=5 {
        axis.cycle(core::time::Duration::from_millis(cycle));
        seen.push(axis.statusword() & 0x004F);
    }
    assert_eq!(seen, [0x00, 0x00, 0x00, 0x40, 0x40]);
    assert_eq!(NotReadyToSwitchOn.pattern(), 0);

    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.axis.inject_fault(0x3210);
    bench.run(1);
    assert_eq!(bench.axis.state(), FaultReactionActive);
    assert_eq!(bench.axis.statusword() & 0x004F, 0x000F);
    bench.run(1);
    assert_eq!(bench.axis.statusword() & 0x004F, 0x0008);
}

#[test]
fn enable_operation_from_ready_passes_switched_on_where_the_drive_does_that() {
    let mut bench = Bench::new(Behaviour::akd2g());
    bench.word(0x0006);
    bench.word(0x000F);
    assert_eq!(bench.axis.state(), SwitchedOn);
    bench.word(0x000F);
    assert_eq!(bench.axis.state(), OperationEnabled);

    let mut strict = Bench::new(Behaviour {
        auto_3_4: false,
        ..Behaviour::generic()
    });
    strict.word(0x0006);
    strict.word(0x000F);
    strict.run(10);
    assert_eq!(strict.axis.state(), ReadyToSwitchOn);
}

#[test]
fn operation_is_enabled_only_when_the_power_section_is_ready() {
    let mut bench = Bench::new(Behaviour {
        power_on_cycles: 5,
        ..Behaviour::akd2g()
    });
    bench.word(0x0006);
    bench.word(0x0007);
    bench.set(0x6040, 0x000F);
    bench.run(5);
    assert_eq!(bench.axis.state(), SwitchedOn);
    bench.run(1);
    assert_eq!(bench.axis.state(), OperationEnabled);
}

#[test]
fn a_standing_quick_stop_leaves_by_605ah() {
    for (option, leaves) in [
        (0, true),
        (1, true),
        (2, true),
        (3, true),
        (5, false),
        (8, false),
    ] {
        let mut bench = Bench::enabled(Behaviour::akd2g());
        bench.set(0x605A, option);
        bench.word(0x000B);
        assert_eq!(bench.axis.state(), QuickStopActive, "605Ah = {option}");
        assert!(bench.bit(10), "standing");
        bench.run(3);
        let want = if leaves {
            SwitchOnDisabled
        } else {
            QuickStopActive
        };
        assert_eq!(bench.axis.state(), want, "605Ah = {option}");
    }
}

#[test]
fn without_voltage_the_axis_cannot_be_switched_on() {
    let mut bench = Bench::new(Behaviour::akd2g());
    bench.axis.set_voltage(false);
    bench.word(0x0006);
    assert_eq!(bench.axis.statusword() & 0x007F, 0x0021);
    bench.word(0x0007);
    bench.run(20);
    assert_eq!(bench.axis.state(), ReadyToSwitchOn);
    bench.axis.set_voltage(true);
    bench.run(1);
    assert_eq!(bench.axis.state(), SwitchedOn);

    let behaviour = Behaviour {
        ready_needs_voltage: true,
        ..Behaviour::akd2g()
    };
    let mut bench = Bench::new(behaviour);
    bench.axis.set_voltage(false);
    bench.word(0x0006);
    assert_eq!(bench.axis.state(), SwitchOnDisabled);
}

#[test]
fn in_local_control_the_controlword_is_ignored() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.axis.set_remote(false);
    for word in [0x0000, 0x0006, 0x001F, 0x000B] {
        bench.word(word);
        assert_eq!(bench.axis.state(), OperationEnabled);
        assert!(!bench.bit(9));
    }
    assert!(bench.axis.ledger().is_empty());
}

#[test]
fn an_inhibited_drive_refuses_to_switch_on_and_a_powered_one_lets_go() {
    let mut bench = Bench::enabled(Behaviour::akd2g());
    bench.axis.set_inhibited(true);
    bench.run(1);
    assert_eq!(bench.axis.state(), SwitchOnDisabled);
    for word in [0x0006, 0x0007, 0x000F, 0x000F] {
        bench.word(word);
    }
    assert_eq!(bench.axis.state(), ReadyToSwitchOn);
}
