//! The invariants of "What never happens", searched for a counter-example: an axis core against a simulated drive in
//! virtual time, judged by the drive's ledger and by the words that went over the wire.
//!
//! Invariants 1 to 9 are here. The tenth (watchdog, liveness) is about the bus and is tested there.
//! `INVARIANT_SEED=n` runs one scenario only, `INVARIANT_CYCLES=n` changes how long is searched,
//! `INVARIANT_FROM=n` with which of the new seeds it begins.
#![allow(missing_docs)]

#[path = "../common/differential.rs"]
mod differential;
mod found;
#[path = "../common/frames.rs"]
mod frames;
mod orders;
mod rarer;
mod reports;
mod scenario;
mod wider;
mod words;
mod world;

use std::collections::BTreeMap;

use rarer::rarer;
use scenario::{Names, OTHER_DRIVES, Scenario, ideal, live};
use wider::wider;

/// Bus cycles for each invariant at least.
const CYCLES: usize = 200_000;

/// Seeds that once failed come first, for every invariant.
const KEPT: &str = include_str!("seeds.txt");

type Check = fn(&Scenario) -> Result<(), String>;

#[test]
fn invariant_1_a_set_point_is_executed_once_or_reported_as_not_executed() {
    search(1, Names::Unique, orders::once_or_not_at_all);
}

#[test]
fn invariant_2_no_motion_without_a_move_or_a_resume_in_words() {
    search(2, Names::Unique, orders::no_motion_unasked);
}

#[test]
fn invariant_3_bit_4_rises_only_with_its_set_point_after_an_acknowledged_low() {
    search(3, Names::Unique, words::bit_4_rises_by_the_rules);
}

#[test]
fn invariant_4_reached_is_never_reported_from_anything_but_an_arrival() {
    search(4, Names::Unique, reports::reached_is_true);
}

#[test]
fn invariant_5_no_bit_outlives_what_set_it() {
    search(5, Names::Unique, words::no_bit_outlives);
}

#[test]
fn invariant_6_two_equal_moves_are_two_moves() {
    search(6, Names::Equal, orders::equal_moves_all_count);
}

#[test]
fn invariant_7_stale_inputs_advance_nothing_until_the_drive_counts_as_lost() {
    search(7, Names::Unique, reports::stale_advances_nothing);
}

#[test]
fn invariant_8_a_stop_request_is_in_the_next_word() {
    search(8, Names::Unique, words::stops_come_first);
}

#[test]
fn invariant_9_every_command_ends_once_and_in_time() {
    search(9, Names::Unique, reports::everything_ends);
}

/// Every scenario is run by a differential test: one core that steps as cheaply as it can, and one that computes each cycle as a whole. They
/// are compared in words, reports and snapshots whenever anything happens. Here it is shown that they do differ in how.
#[test]
fn the_idle_path_comes_to_the_same_as_the_whole_step() {
    let (mut cycles, mut idle, mut moving) = (0, 0, 0);
    // In the wider scenarios something happens all the time, in the rarer ones often nothing moves, on a plant every count is another.
    let plain = |&seed: &u64| ![wider, rarer].iter().any(|other| seed == other(seed));
    for seed in seeds(10).filter(plain).map(ideal) {
        let _name = OnPanic(seed);
        let scenario = live(seed, Names::Unique);
        cycles += scenario.world.frames.len();
        idle += scenario.world.core.idle_cycles;
        moving += scenario.world.core.idle_moving;
        if cycles >= CYCLES {
            break;
        }
    }
    println!("{cycles} cycles, {idle} of them idle, {moving} of those in motion");
    assert!(
        idle > cycles / 5 && moving > cycles / 20,
        "{idle} idle cycles of {cycles}, {moving} in motion"
    );
}

/// What happens in the scenarios that are searched: a search where nothing happens finds nothing.
#[test]
fn the_scenarios_see_every_command_and_every_way_to_end() {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let scenarios = seeds_from(1, 0).take(120);
    for seed in scenarios.flat_map(|seed| [seed, ideal(seed)]) {
        let scenario = live(seed, Names::Unique);
        let mut count = |what: String| *seen.entry(what).or_default() += 1;
        for issued in &scenario.world.issued {
            let name = |text: String| {
                let end = text.find([' ', '(', '{']).unwrap_or(text.len());
                text[..end].to_owned()
            };
            let command = name(format!("{:?}", issued.command));
            match scenario.world.done(issued.id) {
                Some((_, Ok(completion))) => {
                    count(format!("{command}: {}", name(format!("{completion:?}"))));
                }
                Some((_, Err(failure))) => {
                    count(format!("{command}: {}", name(format!("{failure:?}"))));
                }
                None => count(format!("{command}: nothing")),
            }
        }
        for line in scenario.world.ledger() {
            count(format!("ledger: {:?}", line.outcome));
        }
        for frame in &scenario.world.frames {
            count(format!("frame: {:?}", frame.got));
        }
    }
    for (what, times) in &seen {
        println!("{times:7} {what}");
    }
    for what in OUTCOMES {
        assert!(
            seen.contains_key(*what),
            "no scenario saw {what}: {seen:#?}"
        );
    }
}

const OUTCOMES: &[&str] = &[
    "Disable: Stopped",
    "Disable: BusLost",
    "Enable: Done",
    "Enable: Busy",
    "Enable: Fault",
    "Enable: QuickStopped",
    "Halt: HaltIgnored",
    "Halt: Stopped",
    "Halt: Superseded",
    "Move: BusLost",
    "Move: Disabled",
    "Move: Fault",
    "Move: Halted",
    "Move: MissedTarget",
    "Move: NeedsStop",
    "Move: Passed",
    "Move: QuickStopIgnored",
    "Move: QuickStopped",
    "Move: Reached",
    "Move: Superseded",
    "Move: Timeout",
    "Move: Unsupported",
    "Move: Withdrawn",
    "Move: WrongMode",
    "QuickStop: QuickStopIgnored",
    "QuickStop: Stopped",
    "Release: Stopped",
    "ResetFault: Stopped",
    "ResetFault: NoFault",
    "Resume: Done",
    "Resume: Moving",
    "Resume: ResumeUnsupported",
    "SelectMode: Done",
    "SelectMode: Halted",
    "Stop: Stopped",
    "frame: Answered",
    "frame: Stale",
    "ledger: Discarded(Fault)",
    "ledger: Discarded(Halt)",
    "ledger: Discarded(QuickStop)",
    "ledger: Passed",
    "ledger: Reached",
    "ledger: Replaced",
];

/// Runs scenarios until enough cycles have passed; the first that fails the check ends it.
fn search(invariant: u64, names: Names, check: Check) {
    let cycles = number("INVARIANT_CYCLES").map_or(CYCLES, |cycles: u64| cycles as usize);
    let seeds: Box<dyn Iterator<Item = u64>> = match number("INVARIANT_SEED") {
        Some(seed) => Box::new(core::iter::once(seed)),
        None => Box::new(seeds(invariant)),
    };
    let (mut lived, mut scenarios, mut executed) = (0, 0, 0);
    for seed in seeds {
        let _name = OnPanic(seed);
        let scenario = live(seed, names);
        if let Err(what) = check(&scenario) {
            panic!("invariant {invariant}: {what}\nrun it alone with INVARIANT_SEED={seed}");
        }
        lived += scenario.world.frames.len();
        executed += scenario.world.ledger().len();
        scenarios += 1;
        if lived >= cycles {
            break;
        }
    }
    println!(
        "invariant {invariant}: {lived} cycles, {scenarios} scenarios, {executed} set-points executed"
    );
}

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

/// The kept ones, then new ones without end.
fn seeds(invariant: u64) -> impl Iterator<Item = u64> {
    seeds_from(invariant, number("INVARIANT_FROM").unwrap_or(0))
}

fn seeds_from(invariant: u64, from: u64) -> impl Iterator<Item = u64> {
    let kept = KEPT.lines().filter_map(|line| {
        line.split('#')
            .next()
            .and_then(|seed| seed.trim().parse().ok())
    });
    // Half of the scenarios with the drives of whose bits 5, 9 and 12 other documents speak; each scenario also as a wider and as a rarer one;
    // all of them on a plant.
    let fresh = (from..).flat_map(move |n| {
        let seed = (n % 4 % 3) << OTHER_DRIVES | invariant << 32 | n;
        [seed, wider(seed), rarer(seed)]
    });
    kept.chain(fresh)
}

/// Says the seed when a scenario ends in a panic.
struct OnPanic(u64);

impl Drop for OnPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("seed {}", self.0);
        }
    }
}

/// `INVARIANT_SEED=n cargo test --test invariants print_a_scenario -- --ignored --nocapture`: for whoever looks into a seed.
#[test]
#[ignore = "prints one scenario for a person to read"]
fn print_a_scenario() {
    let seed = std::env::var("INVARIANT_SEED").expect("a seed");
    let names = if seed.parse::<u64>().expect("a number") >> 32 & 0xFF == 6 {
        Names::Equal
    } else {
        Names::Unique
    };
    let scenario = live(seed.parse().expect("a number"), names);
    let world = &scenario.world;
    println!("{:?}\n{:?}", world.config, world.period);
    let mut last = (0, 0);
    for (at, frame) in world.frames.iter().enumerate() {
        for issued in world.issued.iter().filter(|issued| issued.frame == at) {
            println!("{at:5}   {issued:?}");
        }
        for report in world.reports.iter().filter(|r| r.frame == at) {
            println!("{at:5}   {report:?}");
        }
        let status = frame.sample.map_or(0, |sample| sample.statusword.bits());
        if last != (frame.sent.word, status)
            || frame.got != world::Got::Fresh
            || !frame.lane.is_empty()
        {
            println!(
                "{at:5} {:?} {:04X} -> {status:04X} {:?} delivered {} target {} at {} v {} lane {:?}",
                frame.now,
                frame.sent.word,
                frame.got,
                frame.delivered,
                frame.sent.target,
                frame.position,
                frame.velocity,
                frame.lane
            );
        }
        last = (frame.sent.word, status);
    }
    println!("{:#?}", world.ledger());
}
