//! Golden vectors of words and texts, each with its source, in `tests/vectors/`; written from the standards and the drives'
//! documents, not from the code.
//!
//! SDO frames and mapping entries are pinned as bytes beside their codecs (`src/coe/sdo/tests.rs`, `src/pdo_map/`).

use crate::common::Rig;
use servocrab::ds402::{Controlword, Mode, PowerCommand, State, Statusword, describe_error_code};
use servocrab::{BufferMode, SetPoint, profile_position::Reference};
use servocrab::{
    Doubt, Failure,
    axis::{Delivery, Inhibit, WaitingFor},
};

const STATES: &str = include_str!("../vectors/statusword_states.txt");
const COMMANDS: &str = include_str!("../vectors/device_commands.txt");
const STARTS: &str = include_str!("../vectors/start_words.txt");
const ERROR_CODES: &str = include_str!("../vectors/error_codes.txt");
const FAILURES: &str = include_str!("../vectors/failures.txt");

/// The columns of each line that is no comment.
fn rows(table: &str) -> impl Iterator<Item = Vec<&str>> {
    table
        .lines()
        .filter(|line| !line.trim().is_empty() && !line.starts_with('#'))
        .map(|line| line.split('|').map(str::trim).collect())
}

fn hex(text: &str) -> u16 {
    u16::from_str_radix(text.trim_end_matches('h'), 16).expect("a hexadecimal number")
}

/// A pattern of 0, 1 and x from bit 15 down, as a mask and a value.
fn pattern(text: &str) -> (u16, u16) {
    let bits: Vec<char> = text.chars().filter(|c| !c.is_whitespace()).collect();
    assert_eq!(bits.len(), 16, "{text}");
    bits.iter().fold((0, 0), |(mask, value), bit| {
        (
            mask << 1 | u16::from(*bit != 'x'),
            value << 1 | u16::from(*bit == '1'),
        )
    })
}

#[test]
fn all_65536_statuswords_show_the_state_of_the_standards_table() {
    let table: Vec<_> = rows(STATES)
        .map(|row| (pattern(row[0]), row[1].to_owned()))
        .collect();
    assert_eq!(table.len(), 8);
    let mut seen = vec![0; table.len()];
    for word in 0..=u16::MAX {
        let matching: Vec<usize> = (0..table.len())
            .filter(|at| {
                let (mask, value) = table[*at].0;
                word & mask == value
            })
            .collect();
        assert!(matching.len() <= 1, "{word:#06x} is ambiguous in the table");
        let shown = Statusword::from_bits_retain(word).state();
        match matching.first() {
            Some(at) => {
                seen[*at] += 1;
                assert_eq!(shown.to_string(), table[*at].1, "{word:#06x}");
            }
            None => assert_eq!(shown, State::Unknown, "{word:#06x}"),
        }
    }
    // Four patterns leave 10 bits open, four leave 12: bits 0-3 and 6 fixed, or 5 too.
    assert_eq!(seen.iter().sum::<usize>(), 4 * 2_048 + 4 * 1_024);
}

#[test]
fn each_device_command_is_the_word_of_the_command_table() {
    for row in rows(COMMANDS) {
        let (mask, value) = pattern(row[1]);
        let word = hex(row[2]);
        let command = match row[0] {
            "Shutdown" => PowerCommand::Shutdown,
            "Switch on" => PowerCommand::SwitchOn,
            "Enable operation" => PowerCommand::EnableOperation,
            "Disable voltage" => PowerCommand::DisableVoltage,
            "Quick stop" => PowerCommand::QuickStop,
            "Fault reset" => PowerCommand::FaultReset,
            other => panic!("{other}"),
        };
        assert_eq!(command.controlword().bits(), word, "{}", row[0]);
        assert_eq!(word & mask, value, "{} against its pattern", row[0]);
    }
    assert_eq!(rows(COMMANDS).count(), 6);
    assert_eq!(Controlword::ENABLE_OPERATION.bits(), 0x000F);
}

#[test]
fn each_kind_of_start_is_the_word_of_the_akd2gs_bit_tables() {
    for row in rows(STARTS) {
        let start = match row[0] {
            "Aborting" => BufferMode::Aborting,
            "Buffered" => BufferMode::Buffered,
            "Blending" => BufferMode::Blending,
            other => panic!("{other}"),
        };
        let reference = match row[1] {
            "absolute" => Reference::Absolute,
            "relative" => Reference::Relative,
            other => panic!("{other}"),
        };
        let (before, word) = (hex(row[2]), hex(row[3]));
        let mut rig = Rig::enabled();
        let first = rig.abs(50_000, SetPoint::new());
        rig.wait_accepted(first);
        rig.run(50);
        let from = rig.words.len();
        let set_point = SetPoint::new().buffer_mode(start);
        let second = match reference {
            Reference::Absolute => rig.abs(60_000, set_point),
            Reference::Relative => rig.rel(60_000, set_point),
        };
        rig.wait_accepted(second);
        rig.run(2);
        // On a ready axis what needs no other bit rises in the next frame.
        let mut words = vec![before, word, 0x000F];
        if before == 0x000F {
            words.remove(0);
        }
        assert_eq!(rig.distinct_words(from), words, "{row:?}");
        let line = &rig.ledger()[1];
        assert_eq!(
            (line.bit_5, line.relative, line.bit_9),
            (
                word & 0x20 != 0,
                reference == Reference::Relative,
                word & 0x200 != 0
            )
        );
    }
    assert_eq!(rows(STARTS).count(), 6);
}

#[test]
fn error_codes_are_the_standards_words() {
    for row in rows(ERROR_CODES) {
        assert_eq!(describe_error_code(hex(row[0])), row[1], "{}", row[0]);
    }
    assert!(rows(ERROR_CODES).count() > 10);
}

#[test]
fn failures_say_what_a_person_at_the_machine_must_know() {
    let statusword = Statusword::from_bits_retain(0x0637);
    let controlword = Controlword::from_bits_retain(0x001F);
    let timeout = |waiting_for, delivery| Failure::Timeout {
        waiting_for,
        statusword,
        controlword,
        delivery,
    };
    let unknown = |doubt| Failure::Unknown {
        doubt,
        actual: 500,
        statusword,
        controlword,
    };
    let refused = |by| Failure::EnableRefused {
        by,
        state: State::ReadyToSwitchOn,
        statusword,
        controlword,
    };
    let failures = [
        Failure::Fault {
            code: Some(0x8611),
            following_error: false,
        },
        Failure::Fault {
            code: Some(0xFF01),
            following_error: true,
        },
        Failure::Fault {
            code: None,
            following_error: true,
        },
        Failure::Fault {
            code: None,
            following_error: false,
        },
        Failure::MissedTarget {
            target: 1000,
            actual: 500,
        },
        unknown(Doubt::Unacknowledged),
        timeout(WaitingFor::AcknowledgeLow, Delivery::NotSent),
        unknown(Doubt::StillLow),
        Failure::BusLost {
            delivery: Delivery::Accepted,
        },
        Failure::NotEnabled {
            state: State::ReadyToSwitchOn,
        },
        Failure::Halted {
            delivery: Delivery::Accepted,
        },
        Failure::Halted {
            delivery: Delivery::NotSent,
        },
        Failure::QuickStopped {
            delivery: Delivery::Unknown,
        },
        Failure::WrongMode {
            expected: Mode::ProfilePosition,
            shown: Mode::Homing,
            delivery: Delivery::Accepted,
        },
        Failure::HaltIgnored,
        Failure::QuickStopIgnored,
        refused(Inhibit::LocalControl),
        refused(Inhibit::Unnamed),
        refused(Inhibit::NoVoltage),
        Failure::NeedsStop,
    ];
    let texts: Vec<&str> = FAILURES
        .lines()
        .filter(|line| !line.starts_with('#'))
        .collect();
    let shown: Vec<String> = failures.iter().map(ToString::to_string).collect();
    assert_eq!(shown, texts);
}
