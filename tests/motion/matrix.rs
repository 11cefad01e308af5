//! What ends how: every command in every situation, undisturbed, with a fault of the drive and with the bus lost. The
//! expected outcome of each cell is in `tests/vectors/matrix.txt`; a cell without one fails.

use std::{fmt::Write, thread};

use crate::common::{Link, Rig};
use servocrab::ds402::{Mode, QuickStopOption, State};
use servocrab::{
    BufferMode, SetPoint,
    profile_position::{MoveCommand, Reference},
};
use servocrab::{
    Failure,
    axis::{Command, CommandId, Completion, Event},
};
use servocrab_sim::ds402::{Behaviour, Plant};

const EXPECTED: &str = include_str!("../vectors/matrix.txt");

/// Where the axis is when the command comes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Situation {
    Moving,
    Halted,
    Standing,
    NotEnabled,
    Enabling,
    /// Bit 4 is high and not acknowledged yet.
    Handshaking,
    /// Halting, with the quick stop to follow.
    Stopping,
    /// By quick stop with 605Ah = 6.
    QuickStopActive,
    Fault,
    Lost,
}

const SITUATIONS: [Situation; 10] = [
    Situation::Moving,
    Situation::Halted,
    Situation::Standing,
    Situation::NotEnabled,
    Situation::Enabling,
    Situation::Handshaking,
    Situation::Stopping,
    Situation::QuickStopActive,
    Situation::Fault,
    Situation::Lost,
];

/// What happens 3 ms after the command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Disturbance {
    Nothing,
    DriveFault,
    BusLost,
}

const DISTURBANCES: [Disturbance; 3] = [
    Disturbance::Nothing,
    Disturbance::DriveFault,
    Disturbance::BusLost,
];

/// The rows: their names and commands. The first asks for nothing.
fn commands() -> Vec<(&'static str, Option<Command>)> {
    let to = |start| {
        Command::Move(MoveCommand {
            reference: Reference::Absolute,
            target: -2_000,
            set_point: SetPoint::new().buffer_mode(start),
            gated: false,
        })
    };
    vec![
        ("nothing", None),
        ("move immediately", Some(to(BufferMode::Aborting))),
        ("move after current", Some(to(BufferMode::Buffered))),
        ("move blended", Some(to(BufferMode::Blending))),
        ("halt", Some(Command::Halt)),
        ("resume", Some(Command::Resume)),
        ("stop", Some(Command::Stop)),
        ("quick_stop", Some(Command::QuickStop)),
        ("disable", Some(Command::Disable)),
        ("release", Some(Command::Release)),
        ("enable", Some(Command::Enable)),
        ("reset_fault", Some(Command::ResetFault)),
        (
            "select mode 8",
            Some(Command::SelectMode(Mode::CyclicPosition)),
        ),
    ]
}

#[test]
fn every_command_in_every_situation_ends_as_the_table_says() {
    // What comes 3 ms after a command comes too late for it where the statusword is composed as seldom as that: these compose it in
    // each cycle.
    thread::scope(|scope| {
        for plant in [Plant::default(), Plant::seeded(2), Plant::seeded(8)] {
            assert!(plant.word_cycle.is_zero());
            scope.spawn(move || compare_table_on(plant));
        }
    });
}

fn compare_table_on(plant: Plant) {
    let mut table = String::new();
    for disturbance in DISTURBANCES {
        writeln!(table, "[{disturbance:?}]").expect("a string");
        for situation in SITUATIONS {
            for (name, command) in commands() {
                let outcome = cell(plant, situation, command, disturbance);
                writeln!(table, "{situation:?} | {name} | {outcome}").expect("a string");
            }
        }
    }
    let cells = |text: &str| -> Vec<String> {
        text.lines()
            .filter(|line| !line.trim().is_empty() && !line.starts_with('#'))
            .map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "))
            .collect()
    };
    let (expected, found) = (cells(EXPECTED), cells(&table));
    let wrong: Vec<_> = found
        .iter()
        .filter(|line| !expected.contains(line))
        .collect();
    assert!(
        wrong.is_empty(),
        "not in the table: {wrong:#?}, on {plant:?}"
    );
    assert_eq!(found, expected, "a cell of the table is not there");
    assert_eq!(
        found.len(),
        3 + DISTURBANCES.len() * SITUATIONS.len() * commands().len()
    );
}

/// Brings an axis into the situation, gives the command, and tells in words what became of it, of what was under way
/// before, and of the drive.
fn cell(
    plant: Plant,
    situation: Situation,
    command: Option<Command>,
    disturbance: Disturbance,
) -> String {
    let (mut rig, before) = arrange(plant, situation);
    let frames = rig.words.len();
    let id = command.map(|command| rig.send(command));
    let lost = situation == Situation::Lost;
    let link = if lost { Link::RequestLost } else { Link::Good };
    for _ in 0..3 {
        rig.cycle_over(link);
    }
    match disturbance {
        Disturbance::Nothing => {}
        Disturbance::DriveFault => rig.drive.inject_fault(0x7305),
        Disturbance::BusLost => {
            for _ in 0..40 {
                rig.cycle_over(Link::RequestLost);
            }
        }
    }
    for _ in 0..20 {
        rig.cycle_over(link);
    }
    rig.run(1_500);
    let stood = rig.drive.position();
    rig.run(200);
    // Loads push the shaft by less than that.
    let moved = (rig.drive.position() - stood).abs();
    assert!(moved <= 10, "{situation:?} {command:?}: {moved}");
    let of = |id: Option<CommandId>| id.map_or_else(|| "-".to_owned(), |id| in_words(&rig, id));
    let halted = rig.words.last().is_some_and(|word| word & 0x100 != 0);
    let edges = rig.words[frames - 1..]
        .windows(2)
        .filter(|pair| pair[0] & 0x10 == 0 && pair[1] & 0x10 != 0)
        .count();
    format!(
        "{}; before: {}; {:?}{}, {edges} edges",
        of(id),
        of(before),
        rig.drive.state(),
        if halted { " with bit 8" } else { "" },
    )
}

/// An axis in this situation, and what is under way on it.
fn arrange(plant: Plant, situation: Situation) -> (Rig, Option<CommandId>) {
    let option = if situation == Situation::QuickStopActive {
        6
    } else {
        2
    };
    let behaviour = Behaviour {
        quick_stop_option: option,
        power_on_cycles: 50,
        ..Behaviour::akd2g()
    };
    let mut rig = Rig::new(behaviour, |config| {
        config.quick_stop = QuickStopOption(option);
    })
    .on_plant(plant);
    rig.run(5);
    if situation == Situation::NotEnabled {
        return (rig, None);
    }
    if situation == Situation::Enabling {
        let enable = rig.send(Command::Enable);
        rig.run(10);
        assert!(rig.outcome(enable).is_none());
        return (rig, Some(enable));
    }
    rig.enable();
    if situation == Situation::Standing {
        return (rig, None);
    }
    if situation == Situation::Handshaking {
        rig.drive.disturbances().ack_delay_cycles = 400;
    }
    let id = rig.abs(20_000, SetPoint::new());
    if situation == Situation::Handshaking {
        rig.run(20);
    } else {
        // It begins after the start delay of its drive.
        rig.run_until(300, |rig| rig.drive.velocity() > 40_000.0);
    }
    match situation {
        Situation::Moving => assert!(rig.drive.velocity() > 0.0),
        Situation::Handshaking => assert!(!rig.accepted(id) && rig.word() & 0x10 != 0),
        Situation::Halted => {
            let halt = rig.send(Command::Halt);
            assert!(rig.finish(halt).is_ok());
        }
        Situation::Stopping => {
            rig.send(Command::Stop);
            rig.run(20);
            assert_eq!(rig.core.snapshot().state, State::OperationEnabled);
        }
        Situation::QuickStopActive => {
            let stop = rig.send(Command::QuickStop);
            assert!(rig.finish(stop).is_ok());
        }
        Situation::Fault => {
            rig.drive.inject_fault(0x7305);
            rig.run(500);
            assert_eq!(rig.core.snapshot().state, State::Fault);
        }
        Situation::Lost => {
            for _ in 0..20 {
                rig.cycle_over(Link::RequestLost);
            }
            assert!(rig.core.snapshot().lost);
        }
        Situation::Standing | Situation::NotEnabled | Situation::Enabling => {}
    }
    (rig, Some(id))
}

/// All reports about a command.
fn in_words(rig: &Rig, id: CommandId) -> String {
    let words: Vec<String> = rig
        .reports(id)
        .iter()
        .map(|event| match event {
            Event::Accepted => "accepted".to_owned(),
            Event::Halted => "halted".to_owned(),
            Event::Done(Ok(Completion::Done)) => "done".to_owned(),
            // Within the tolerance: to the nearest hundred.
            Event::Done(Ok(Completion::Reached { position })) => {
                format!("reached {}", (position + 50).div_euclid(100) * 100)
            }
            Event::Done(Ok(Completion::Passed { .. })) => "passed".to_owned(),
            Event::Done(Ok(Completion::Homed { position })) => format!("homed {position}"),
            Event::Done(Ok(Completion::Stopped { state })) => format!("stopped in {state:?}"),
            Event::Done(Ok(Completion::Prepared { mode })) => format!("prepared {mode:?}"),
            Event::Done(Ok(_)) => panic!("no words for {event:?}"),
            Event::Done(Err(failure)) => match failure {
                Failure::Timeout { waiting_for, .. } => format!("Timeout {waiting_for:?}"),
                Failure::BusLost { delivery } => format!("BusLost {delivery:?}"),
                Failure::Disabled { state } => format!("Disabled {state:?}"),
                other => {
                    let text = format!("{other:?}");
                    text.split([' ', '(']).next().unwrap_or_default().to_owned()
                }
            },
            other => panic!("no words for {other:?}"),
        })
        .collect();
    if words.is_empty() {
        "open".to_owned()
    } else {
        words.join(", ")
    }
}
