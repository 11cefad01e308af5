//! A second oracle: a drive that does anything that CiA 402 permits, and programs that ask for anything, judged by
//! conservation laws alone.
//!
//! Seeds from 4·10¹⁵ on are of all kinds of scenarios, those below of fewer ([`scenario::WIDER`], [`scenario::ALL_HABITS`]).
//!
//! `ORACLE_SEED=n` runs one scenario and prints it; `ORACLE_CYCLES=n` says how many cycles are searched, `ORACLE_FROM=n` with which
//! seed that begins, `ORACLE_THREADS=n` on how many processors, `ORACLE_KEEP=n` after how many violations it
//! ends, `ORACLE_PROGRESS=1` prints its progress. `ORACLE_SHORT=n` says how many cycles each of the short searches has.
#![allow(missing_docs)]

mod drive;
mod habits;
mod random;
mod scenario;
mod search;

use search::{Search, number};

/// Seeds that once failed: every run repeats each.
const KEPT: &str = include_str!("seeds.txt");

/// What was found once and mended.
#[test]
fn scenarios_that_once_failed_do_so_no_more() {
    let search = Search {
        kept: kept(),
        from: 0,
        cycles: 0,
        seconds: u64::MAX,
        threads: 1,
        keep: u64::MAX,
        progress: false,
    };
    let found = search.run();
    assert!(
        found.scenarios > 0 && found.violations.is_empty(),
        "{found}"
    );
}

/// A core that says of every move that nobody knows breaks no law but this.
#[test]
fn a_core_that_doubts_most_moves_fails() {
    let found = |arrived, doubtful| {
        let mut found = search::Found::default();
        found.ends.add(scenario::Ends {
            arrived,
            doubtful,
            ended: 1_000,
        });
        found.doubts_too_much()
    };
    assert!(found(97, 3) && found(0, 1));
    assert!(!found(98, 2));
}

/// The same programs in every run: those in which the first defects were found, and those of all kinds.
#[test]
fn the_laws_hold_in_a_short_search() {
    let cycles = number("ORACLE_SHORT").unwrap_or(4_000_000);
    for from in [1, scenario::WIDER, scenario::HELD, scenario::ALL_HABITS] {
        let search = Search {
            kept: Vec::new(),
            from,
            cycles,
            seconds: u64::MAX,
            threads: 2,
            keep: 1,
            progress: false,
        };
        let found = search.run();
        assert!(
            found.cycles >= cycles && found.violations.is_empty(),
            "{found}"
        );
        assert!(!found.doubts_too_much(), "{found}");
    }
}

#[test]
#[ignore = "`cargo xtask prove` runs it"]
fn the_laws_hold() {
    if let Some(seed) = number("ORACLE_SEED") {
        search::print(seed);
        return;
    }
    let search = Search {
        kept: kept(),
        from: number("ORACLE_FROM").unwrap_or(scenario::ALL_HABITS),
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
    assert!(!found.doubts_too_much(), "too many doubts");
    let rare = found.rare();
    assert!(rare.is_empty(), "hit too rarely: {rare:?}");
}

fn kept() -> Vec<u64> {
    KEPT.lines()
        .filter_map(|line| line.split('#').next()?.trim().parse().ok())
        .collect()
}
