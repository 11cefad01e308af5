//! Whole lines, from INIT to INIT, on a cable and with devices that do whatever a bad cable and bad devices can: searched by
//! random scenarios in virtual time for anything that hangs, panics, moves unasked, is taken for something else, or stays broken.
//!
//! `LINE_SEED=n` runs one scenario only, `LINE_LIVES=n` changes how many are run, `LINE_FROM=n` with which of the new seeds it
//! begins. `LINE_LOG=1` shows all that the library logs.
#![cfg(feature = "std")]
#![allow(missing_docs)]

mod cable;
mod clerks;
mod faults_of_line;
mod judge;
mod line;
mod messages;
mod program;
mod random;
mod scenario;
mod tasks;

use std::{collections::BTreeMap, sync::Mutex, thread};

/// New scenarios of each run.
const LIVES: u64 = 30;

/// Seeds that once failed come first.
const KEPT: &str = include_str!("seeds.txt");

#[test]
fn whatever_happens_on_the_line_nothing_hangs_moves_unasked_or_stays_broken() {
    let only = number("LINE_SEED");
    if std::env::var("LINE_LOG").is_ok() {
        let all = tracing_subscriber::fmt().with_max_level(tracing::Level::TRACE);
        all.without_time()
            .with_ansi(false)
            .with_writer(std::io::stderr)
            .init();
    }
    let (from, scenarios) = (
        number("LINE_FROM").unwrap_or(0),
        number("LINE_LIVES").unwrap_or(LIVES),
    );
    let kept = KEPT
        .lines()
        .filter_map(|line| line.split('#').next()?.trim().parse().ok());
    let seeds: Vec<u64> = match only {
        Some(seed) => vec![seed],
        None => kept.chain(from..from + scenarios).collect(),
    };
    let story: Mutex<BTreeMap<String, u64>> = Mutex::default();
    let half = seeds.len().div_ceil(2);
    thread::scope(|scope| {
        for seeds in seeds.chunks(half) {
            scope.spawn(|| live_all(seeds, &story));
        }
    });
    for (what, times) in story.lock().unwrap().iter() {
        println!("{times:9} {what}");
    }
}

fn live_all(seeds: &[u64], story: &Mutex<BTreeMap<String, u64>>) {
    for seed in seeds {
        let _name = OnPanic(*seed);
        match scenario::live(*seed) {
            Ok(lived) => {
                let mut story = story.lock().unwrap();
                for (what, times) in lived {
                    *story.entry(what).or_default() += times;
                }
            }
            Err(what) => panic!("{what}\nrun it alone with LINE_SEED={seed}"),
        }
    }
}

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

/// Says the seed when a scenario ends in a panic.
struct OnPanic(u64);

impl Drop for OnPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("LINE_SEED={}", self.0);
        }
    }
}
