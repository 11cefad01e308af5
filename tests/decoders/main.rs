//! Every decoder of bytes from the wire or a file, under bytes that nobody meant it to see: no panic, no endless loop, and no
//! more memory than it promises (`targets`). The inputs are the bytes of real dialogues and files (`seeds`), as they are and
//! with anything changed in them. The fuzzer runs the same functions for longer (`fuzz/README.md`).
#![cfg(all(feature = "esi", feature = "files"))]
#![allow(missing_docs, unsafe_code)]

mod seeds;
mod targets;

use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::TestRunner;

/// A change of an input.
#[derive(Debug, Clone)]
enum Edit {
    Put(Vec<u8>),
    Insert(Vec<u8>),
    Remove(usize),
    /// What follows once more, this often.
    Repeat(usize, usize),
    Cut,
}

impl Edit {
    fn any() -> impl Strategy<Value = Self> {
        let bytes = || {
            prop_oneof![
                prop::collection::vec(any::<u8>(), 1..8),
                // What is most, least, or a size of four GiB.
                prop::sample::select(vec![
                    vec![0; 4],
                    vec![0xFF; 4],
                    vec![0x80],
                    vec![0x7F, 0xFF]
                ]),
            ]
        };
        prop_oneof![
            4 => bytes().prop_map(Self::Put),
            2 => bytes().prop_map(Self::Insert),
            2 => (1..40_usize).prop_map(Self::Remove),
            1 => (1..64_usize, 1..20_usize).prop_map(|(length, times)| Self::Repeat(length, times)),
            1 => Just(Self::Cut),
        ]
    }

    fn apply(self, at: Index, input: &mut Vec<u8>) {
        let at = at.index(input.len() + 1);
        let end = |length: usize| (at + length).min(input.len());
        match self {
            Self::Put(bytes) => drop(input.splice(at..end(bytes.len()), bytes)),
            Self::Insert(bytes) => drop(input.splice(at..at, bytes)),
            Self::Remove(length) => drop(input.drain(at..end(length))),
            Self::Repeat(length, times) => {
                let part = input[at..end(length)].repeat(times);
                input.splice(at..at, part);
            }
            Self::Cut => input.truncate(at),
        }
    }
}

/// Runs a target with its seeds, with its seeds changed, and with bytes of no meaning.
fn holds(name: &str, cases: u32) {
    let run = targets::ALL
        .iter()
        .find(|target| target.0 == name)
        .unwrap()
        .1;
    let seeds = seeds::of(name);
    for seed in &seeds {
        run(seed);
    }
    let edits = prop::collection::vec((any::<Index>(), Edit::any()), 1..8);
    let changed = (prop::sample::select(seeds), edits).prop_map(|(mut input, edits)| {
        for (at, edit) in edits {
            edit.apply(at, &mut input);
        }
        input
    });
    let inputs = prop_oneof![
        8 => changed,
        1 => prop::collection::vec(any::<u8>(), 0..300),
    ];
    let config = ProptestConfig {
        cases,
        failure_persistence: None,
        ..ProptestConfig::default()
    };
    let result = TestRunner::new(config).run(&inputs, |input| {
        run(&input);
        Ok(())
    });
    result.unwrap_or_else(|failure| panic!("{failure}"));
}

#[test]
fn messages_and_emergencies_hold() {
    holds("message", 2000);
}

#[test]
fn sdo_transfers_hold() {
    holds("sdo", 2000);
}

#[test]
fn sdo_information_holds() {
    holds("information", 2000);
}

#[test]
fn the_mailbox_client_holds() {
    holds("client", 200);
}

#[test]
fn eeprom_images_hold() {
    holds("sii", 1000);
}

#[test]
fn esi_files_hold() {
    holds("esi", 100);
}

#[test]
fn toml_files_hold() {
    holds("toml", 500);
}

#[test]
fn the_bus_thread_holds() {
    holds("bus", 60);
}

#[test]
fn the_simulated_segment_holds() {
    holds("segment", 200);
}

/// What the targets would overlook if nothing were counted.
#[test]
fn memory_is_counted() {
    let (bytes, peak) = targets::memory::peak_of(|| vec![0u8; 1000]);
    assert_eq!((bytes.len(), peak), (1000, 1000));
    let (_, peak) = targets::memory::peak_of(|| {
        let mut growing = vec![1u8; 1000];
        growing.reserve_exact(1000);
        growing
    });
    assert_eq!(peak, 3000, "the old bytes and the new");
    let refused = std::panic::catch_unwind(|| targets::memory::within(10, || vec![0u8; 11]));
    assert!(refused.is_err());
}
