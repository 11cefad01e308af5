//! The axis core in a small world, every state of it: a search to the fixpoint.
//!
//! A state is the core with its ages, what its drive holds, and what is under way. Ages are saturated at the longest deadline. In
//! each state everything that the program, the cable and the drive may do next is done, until no state is new. The laws are looked
//! at in each step; and from each state a sound drive and a good cable resolve everything and lead to a disabled axis.
//!
//! `MODEL_SECONDS=n` ends each search early, and says so; `MODEL_THREADS=n`; `MODEL_WORLD=n` searches one world alone.
#![allow(missing_docs, unreachable_pub)]

mod fingerprint;
mod search;
mod world;

use search::{Bounds, search};
use world::{Ack, Description, Size};

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

/// Every description of a drive.
fn descriptions() -> Vec<Description> {
    let mut all = Vec::new();
    for (ack, described) in [
        (Ack::Buffer, true),
        (Ack::Buffer, false),
        (Ack::Handshake, true),
        (Ack::Handshake, false),
    ] {
        for halt_keeps in [true, false] {
            for quick_stop in [2, 6] {
                all.push(Description {
                    ack,
                    described,
                    halt_keeps,
                    quick_stop,
                });
            }
        }
    }
    all
}

#[test]
#[ignore = "the faults that it finds are being mended"]
fn every_state_is_sound_and_leads_to_a_disabled_axis() {
    let bounds = Bounds {
        seconds: number("MODEL_SECONDS").unwrap_or(20),
        threads: number("MODEL_THREADS").unwrap_or(1) as usize,
    };
    let size = Size {
        commands: number("MODEL_COMMANDS").unwrap_or(1) as usize,
        deviations: number("MODEL_DEVIATIONS").unwrap_or(1) as usize,
    };
    let only = number("MODEL_WORLD");
    let mut broken = 0;
    for (number, description) in descriptions().into_iter().enumerate() {
        if only.is_some_and(|only| only != number as u64) {
            continue;
        }
        let found = search(description, size, &bounds);
        println!("world {number} {description:?}: {found}");
        broken += usize::from(found.violation.is_some());
    }
    assert_eq!(broken, 0, "worlds with a law broken");
}
