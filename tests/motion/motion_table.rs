//! When stops resolve: halt, stop, quick stop and disable of every simulated drive, at rest and in motion, against the time at which the
//! plant stands by the drive's own account. `cargo xtask motion-table` writes the table into `docs/motion.md`.

use core::time::Duration;
use std::fmt::Write;

use crate::common::{CYCLE, Rig};
use servocrab::axis::{Command, Completion};
use servocrab::drives::{self, DriveDescription};
use servocrab::ds402::QuickStopOption;
use servocrab::{BufferMode, SetPoint};
use servocrab_sim::ds402::{Behaviour, Plant};

/// How many plants each cell is tried with; the longest time is told.
const PLANTS: u64 = 8;
/// Wider than what loads, the encoder and the overshoot of each plant make of an axis that comes to rest.
const WIDE: u32 = 200;
/// Cycles beyond the settle time in which a stop resolves.
const MORE: u32 = 4;

type Drive = (&'static str, fn() -> DriveDescription, fn() -> Behaviour);

const DRIVES: [Drive; 5] = [
    ("AKD2G", drives::akd2g, Behaviour::akd2g),
    ("AX2000", drives::ax2000, Behaviour::ax2000),
    ("Sigma-7", drives::sigma7, Behaviour::sigma7),
    ("drive with 2010h", drives::pp2010, Behaviour::pp2010),
    ("plain CiA 402", drives::generic, Behaviour::generic),
];

const COMMANDS: [(&str, Command); 4] = [
    ("halt", Command::Halt),
    ("stop", Command::Stop),
    ("quick_stop", Command::QuickStop),
    ("disable", Command::Disable),
];

/// One stop of one drive.
struct Cell {
    /// From the command to the first cycle of the rest that lasts.
    stands: Duration,
    /// From the command to its report.
    resolves: Duration,
    settle: Duration,
    end: String,
}

impl Cell {
    /// For how long it had stood when that was reported.
    fn after(&self) -> Duration {
        self.resolves.saturating_sub(self.stands)
    }
}

fn stop(
    drive: &Drive,
    seed: u64,
    window: u32,
    option: i16,
    command: Command,
    moving: bool,
) -> Cell {
    let &(name, description, behaviour) = drive;
    let plant = match seed {
        0 => Plant::default(),
        seed => Plant::seeded(seed),
    };
    let behaviour = Behaviour {
        quick_stop_option: option,
        ..behaviour()
    };
    let mut settle = Duration::ZERO;
    let mut rig = Rig::of(description(), behaviour, |config| {
        config.quick_stop = QuickStopOption(option);
        config.tolerances.position = window;
        settle = config.tolerances.settle;
    })
    .on_plant(plant);
    rig.enable();
    rig.run(300);
    if moving {
        let id = rig.abs(
            200_000,
            SetPoint::new()
                .velocity(50_000)
                .buffer_mode(BufferMode::Buffered),
        );
        rig.run(20);
        assert!(
            rig.accepted(id),
            "{name}, plant {seed}: {:?}",
            rig.reports(id)
        );
        rig.run(500);
        assert!(
            rig.drive.velocity().abs() > 1_000.0,
            "{name} is not under way"
        );
    }
    let asked = rig.now;
    let id = rig.send(command);
    let result = rig.finish(id);
    let resolved = rig.now;
    let Ok(Completion::Stopped { state }) = result else {
        panic!("{name}, {command:?}, moving: {moving}, plant {seed}: {result:?}");
    };
    // The rest lasts: what the drive says of it afterwards is of the same.
    rig.run(300);
    let stands = rig
        .drive
        .stands_since()
        .unwrap_or_else(|| panic!("{name}, {command:?}, plant {seed}: it does not stand"));
    Cell {
        stands: stands.saturating_sub(asked),
        resolves: resolved.saturating_sub(asked),
        settle,
        end: state.to_string(),
    }
}

/// The times of one stop of one drive: the longest of its plants.
fn row(
    drive: &Drive,
    option: i16,
    name: &str,
    command: Command,
    faults: &mut Vec<String>,
) -> String {
    let [moving, rest] = [true, false].map(|moving| {
        let cells: Vec<_> = (0..PLANTS)
            .map(|seed| stop(drive, seed, WIDE, option, command, moving))
            .collect();
        for (seed, cell) in cells.iter().enumerate() {
            let late = cell.after() > cell.settle + MORE * CYCLE;
            if cell.resolves < cell.stands || late {
                faults.push(format!(
                    "{}, 605Ah {option}, {name}, moving {moving}, plant {seed}: stands after {:?}, resolves after {:?}",
                    drive.0, cell.stands, cell.resolves
                ));
            }
        }
        let longest = cells.into_iter().max_by_key(Cell::after);
        longest.expect("each cell has its plants")
    });
    let ms = |time: Duration| format!("{} ms", time.as_millis());
    format!(
        "{} | {} | {} | {} | {}",
        ms(rest.resolves),
        ms(moving.stands),
        ms(moving.resolves),
        ms(moving.after()),
        moving.end
    )
}

#[test]
fn each_stop_resolves_when_the_plant_stands_and_soon_after() {
    let mut table = String::from(
        "| drives | 605Ah | | at rest: resolves | in motion: the plant stands | resolves | after that | in |\n|---|---|---|---|---|---|---|---|\n",
    );
    let mut faults = Vec::new();
    for option in [2, 6] {
        for (name, command) in COMMANDS {
            // What is alike is told once.
            let mut rows: Vec<(String, Vec<&str>)> = Vec::new();
            for drive in &DRIVES {
                let row = row(drive, option, name, command, &mut faults);
                match rows.iter_mut().find(|(other, _)| *other == row) {
                    Some((_, drives)) => drives.push(drive.0),
                    None => rows.push((row, vec![drive.0])),
                }
            }
            for (row, drives) in rows {
                let drives = if drives.len() == DRIVES.len() {
                    "all".to_owned()
                } else {
                    drives.join(", ")
                };
                let _ = writeln!(table, "| {drives} | {option} | `{name}` | {row} |");
            }
        }
    }
    println!("TABLE\n{table}END");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// The drives' own position window 6067h. A drive takes its axis as standing below a velocity, and some of these plants creep further than this
/// window after that: at most one settle time more.
const OWN: u32 = 10;

#[test]
fn within_the_drives_own_window_stops_resolve_no_earlier_and_at_most_two_settle_times_later() {
    for seed in 0..PLANTS {
        for drive in &DRIVES {
            for option in [2, 6] {
                for (name, command) in COMMANDS {
                    for moving in [true, false] {
                        let cell = stop(drive, seed, OWN, option, command, moving);
                        let what = format!(
                            "{}, 605Ah {option}, {name}, moving {moving}, plant {seed}: stands after {:?}, resolves after {:?}",
                            drive.0, cell.stands, cell.resolves
                        );
                        assert!(cell.resolves >= cell.stands, "{what}");
                        assert!(cell.after() <= 2 * cell.settle + MORE * CYCLE, "{what}");
                    }
                }
            }
        }
    }
}
