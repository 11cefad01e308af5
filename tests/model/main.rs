//! The axis core in a small world, every state of it: a search to the fixpoint.
//!
//! A state is the core with its ages, what its drive holds, and what is under way. Ages are saturated at what they are compared
//! with, commands have no names, and of a state and its mirror image one is looked at. In each state everything that the program,
//! the cable and the drive may do next is done, until no state is new. The laws are looked at in each step; and from each state a
//! sound drive and a good cable resolve everything and lead to a disabled axis.
//!
//! `MODEL_COMMANDS=n` and `MODEL_DEVIATIONS=n` search every world with so many under way at most, `MODEL_WORLD=n` one world alone;
//! `MODEL_FIRST=n` begins with that one. `MODEL_SECONDS=n` ends the search early, and says so; `MODEL_THREADS=n`; `MODEL_PROGRESS=1`
//! tells how far it is.
#![allow(missing_docs, unreachable_pub)]

mod fingerprint;
mod kept;
mod search;
mod twins;
mod world;

use std::time::Instant;

use search::{Bounds, search};
use world::{Ack, Description, Size, Starts};

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

/// Every description of a drive.
fn descriptions() -> Vec<Description> {
    let standard = Description {
        ack: Ack::Buffer,
        described: true,
        starts: Starts::Standard,
        halt_keeps: true,
        halt_coasts: false,
        quick_stop: 2,
    };
    let mut all = Vec::new();
    for quick_stop in [2, 6] {
        for (ack, described) in [
            (Ack::Buffer, true),
            (Ack::Buffer, false),
            (Ack::Handshake, true),
            (Ack::Handshake, false),
        ] {
            for halt_keeps in [true, false] {
                all.push(Description {
                    ack,
                    described,
                    halt_keeps,
                    quick_stop,
                    ..standard
                });
            }
        }
        all.push(Description {
            starts: Starts::Never,
            quick_stop,
            ..standard
        });
        all.push(Description {
            ack: Ack::Handshake,
            halt_coasts: true,
            quick_stop,
            ..standard
        });
    }
    all
}

fn look_at(worlds: impl Iterator<Item = usize>, commands: usize, deviations: usize) {
    let bounds = Bounds {
        seconds: number("MODEL_SECONDS").unwrap_or(u64::MAX),
        states: number("MODEL_STATES").unwrap_or(200_000_000) as usize,
        threads: number("MODEL_THREADS").unwrap_or(1) as usize,
        progress: number("MODEL_PROGRESS").is_some(),
    };
    let size = Size {
        commands,
        deviations,
    };
    let descriptions = descriptions();
    let begin = Instant::now();
    let mut left = Vec::new();
    for world in worlds {
        let description = descriptions[world];
        let seconds = bounds.seconds.saturating_sub(begin.elapsed().as_secs());
        if seconds == 0 {
            left.push(world);
            continue;
        }
        let bounds = Bounds { seconds, ..bounds };
        let found = search(description, size, &bounds);
        println!(
            "{commands} commands, {deviations} deviations, world {world} {description:?}: {found}"
        );
        assert!(found.violation.is_none(), "{found}");
    }
    if !left.is_empty() {
        println!("{commands} commands, {deviations} deviations: no time for the worlds {left:?}");
    }
}

#[test]
fn every_state_is_sound_and_leads_to_a_disabled_axis() {
    look_at(0..descriptions().len(), 1, 0);
}

#[test]
#[ignore = "`cargo xtask prove` runs it"]
fn every_state_of_the_size_asked_for_is_sound() {
    let all = descriptions().len();
    let first = number("MODEL_FIRST").unwrap_or(0) as usize % all;
    let only = number("MODEL_WORLD").map(|only| only as usize);
    let worlds = (0..all).map(|world| (world + first) % all);
    let worlds = worlds.filter(|world| only.is_none_or(|only| only == *world));
    look_at(
        worlds,
        number("MODEL_COMMANDS").unwrap_or(2) as usize,
        number("MODEL_DEVIATIONS").unwrap_or(0) as usize,
    );
}
