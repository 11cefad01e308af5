//! The axis core against docs/fault-model.md: random drives, cables and programs, each scenario from one seed, judged in every cycle by
//! what the drive really did.
//!
//! A scenario is of one side. Those of even seeds are *inside*: drive, cable and host do what the model lets them do, and no more. There
//! no outcome is wrong. Those of odd seeds are *outside*: besides, something pushes the axis, a state is shown that is not so, a stop is
//! ignored. There the laws of the page's last section hold, and one outcome in a thousand may be wrong.
//!
//! - `habits` names what drives, cables and hosts do, by side. `making` draws a scenario from its seed.
//! - `drive` is the drive, written from the standard; `cable` is what is between; `host` steps the core; `program` asks for things.
//! - `laws` judges. `outcome` is what failures mean to it.
//! - `search` goes through seeds, makes a scenario that breaks a law smaller, and prints it.
//!
//! `ORACLE_SEED=n` runs one scenario and prints it. `ORACLE_SIDE=outside` searches the other side; `ORACLE_CYCLES=n` says for how many
//! cycles, `ORACLE_SECONDS=n` for how long at most, `ORACLE_FROM=n` from which seed on, `ORACLE_THREADS=n` on how many processors,
//! `ORACLE_KEEP=n` after how many violations it ends, and `ORACLE_HITS=n` how often each habit has to show. `ORACLE_PROGRESS=1` prints
//! its progress.
#![allow(missing_docs)]

mod cable;
mod drive;
mod habits;
mod host;
mod laws;
mod making;
mod outcome;
mod program;
mod random;
mod scenario;
mod search;
mod tally;
mod words;

use std::collections::BTreeSet;

use habits::Side;
use search::{Found, Search, number};
use tally::Tally;

/// Seeds that once failed: every run repeats each.
const KEPT: &str = include_str!("seeds.txt");

/// What was found once and mended.
#[test]
fn scenarios_that_once_failed_do_so_no_more() {
    for side in [Side::Inside, Side::Outside] {
        judge(&short(side, 0, kept(side)), side);
    }
}

/// A core that says of every move that nobody knows breaks no law but this.
#[test]
fn a_core_that_doubts_most_moves_fails() {
    let doubts = |arrived, ended, unknown| {
        let mut tally = Tally::default();
        (tally.ends.arrived, tally.ends.ended) = (arrived, ended);
        tally.ends.unknown = unknown;
        tally.doubts_too_much()
    };
    assert!(doubts(47, 50, 3) && doubts(0, 0, 1));
    assert!(!doubts(48, 50, 2));
}

/// The same programs in every run.
#[test]
fn within_the_model_no_outcome_is_wrong() {
    let found = short(Side::Inside, 8_000_000, Vec::new());
    judge(&found, Side::Inside);
    assert!(!found.tally.doubts_too_much(), "{found}");
    // A search in which nothing happens finds nothing.
    let seen = found.tally.seen.iter();
    let seen: BTreeSet<_> = seen.map(|(kind, how)| format!("{kind:?}: {how}")).collect();
    for line in ENDS.lines() {
        let (kind, ends) = line.split_once(": ").expect("a command and its ends");
        for how in ends.split(' ') {
            let end = format!("{kind}: {how}");
            assert!(seen.contains(&end), "no scenario saw {end}: {seen:?}");
        }
    }
    assert!(found.tally.idle.0 > found.tally.cycles / 20, "{found}");
}

#[test]
fn beyond_the_model_stops_and_futures_keep_their_laws() {
    let found = short(Side::Outside, 4_000_000, Vec::new());
    judge(&found, Side::Outside);
}

#[test]
#[ignore = "`cargo xtask prove` runs it"]
fn the_laws_hold() {
    if let Some(seed) = number("ORACLE_SEED") {
        search::print(seed);
        return;
    }
    let outside = std::env::var("ORACLE_SIDE").is_ok_and(|side| side == "outside");
    let side = if outside { Side::Outside } else { Side::Inside };
    let search = Search {
        kept: kept(side),
        side,
        from: number("ORACLE_FROM").unwrap_or(1_000_000),
        cycles: number("ORACLE_CYCLES").unwrap_or(400_000),
        seconds: number("ORACLE_SECONDS").unwrap_or(u64::MAX),
        threads: number("ORACLE_THREADS").unwrap_or(1),
        keep: number("ORACLE_KEEP").unwrap_or(1),
        progress: number("ORACLE_PROGRESS").is_some(),
    };
    let found = search.run();
    println!("{found}");
    let broken = found.violations.len();
    assert!(broken == 0, "{broken} laws broken");
    match side {
        Side::Inside => assert!(!found.tally.doubts_too_much(), "too many unknown outcomes"),
        Side::Outside => assert!(!found.tally.errs_too_much(), "too many wrong outcomes"),
    }
    let rare = found.rare(side, number("ORACLE_HITS").unwrap_or(0));
    assert!(rare.is_empty(), "hit too rarely: {rare:?}");
}

/// How commands end, each of which a short search sees.
const ENDS: &str = "Enable: Done Refused Aborted DriveFault Lost
Disable: Done
Reset: Done
Mode: Done Refused
Home: Done Refused Aborted DriveFault
Jog: Done Aborted
Move: Reached Passed Refused Aborted Missed Unknown DriveFault Lost Late
Halt: Done DriveFault
Hold: Done Refused
Resume: Done Refused
Stop: Done
QuickStop: Done
Release: Done";

fn short(side: Side, cycles: u64, kept: Vec<u64>) -> Found {
    let search = Search {
        kept,
        side,
        from: 0,
        cycles,
        seconds: u64::MAX,
        threads: 2,
        keep: 1,
        progress: false,
    };
    search.run()
}

fn judge(found: &Found, side: Side) {
    assert!(found.violations.is_empty(), "{found}");
    assert!(
        side == Side::Inside || !found.tally.errs_too_much(),
        "{found}"
    );
}

fn kept(side: Side) -> Vec<u64> {
    let seeds = KEPT
        .lines()
        .filter_map(|line| line.split('#').next()?.trim().parse().ok());
    seeds.filter(|seed| Side::of(*seed) == side).collect()
}
