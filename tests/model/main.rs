//! The axis core in a small world, every state of it: a search to the fixpoint.
//!
//! A state is the core, what its drive holds, and what is under way. Commands have no names, and of a state and its mirror image one is
//! looked at. In each state everything that the program, the cable and the drive may do next is done, until no state is new. The laws
//! are looked at in each step; and from each state a sound drive and a good cable resolve everything and lead to a disabled axis.
//!
//! Where every deviation that may come is inside of docs/fault-model.md no outcome is wrong. Else the laws hold that hold outside of it.
//!
//! `MODEL_COMMANDS=n` and `MODEL_DEVIATIONS=n` search every world with so many under way at most, `MODEL_WORLD=n` one world alone;
//! `MODEL_FIRST=n` begins with that one. `MODEL_TOGETHER=n` searches each with every n kinds of deviation by themselves, `MODEL_KINDS=n` with
//! those whose bits are set. `MODEL_EVERY_WORLD=1` searches them all where nothing deviates, and not only one of each kind. `MODEL_SECONDS=n` ends the search early, and says so; with
//! `MODEL_WHOLE=1` that is a failure; `MODEL_THREADS=n`; `MODEL_PROGRESS=1`
//! prints its progress.
#![allow(missing_docs)]

mod differential;
mod fingerprint;
mod kept;
mod search;
mod world;

use std::time::Instant;

use search::{Bounds, search};
use world::{Ack, Description, EVERY_KIND, Size, Starts};

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
        shows_voltage: false,
        bits_first: false,
        begin: 4,
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
    // At the end, so that the numbers of the others stay.
    for ack in [Ack::Buffer, Ack::Handshake] {
        all.push(Description {
            ack,
            bits_first: true,
            ..standard
        });
    }
    all.push(Description {
        shows_voltage: true,
        ..standard
    });
    all.push(Description {
        begin: 6,
        ..standard
    });
    all
}

/// One of each kind: the drive has a buffer or none, is described or not, keeps its set-point in a halt or not, starts at once, coasts, and
/// stays in Quick stop active or not; takes bits first; shows its supply; has time to begin.
const ONE_OF_EACH: [usize; 7] = [0, 9, 17, 18, 21, 22, 23];

/// So many states, and no more, each of these worlds has where one command is under way and nothing deviates.
const COUNTED: [usize; 24] = [
    38_058, 38_394, 38_058, 38_394, 38_058, 38_394, 38_058, 38_394, 35_770, 27_388, //
    37_092, 37_540, 37_092, 37_540, 37_092, 37_540, 37_092, 37_540, 34_965, 20_124, //
    144_078, 144_078, 49_498, 215_709,
];

/// What is looked at: every one of these worlds, with every one of these sets of deviations.
struct Searches {
    worlds: Vec<usize>,
    commands: usize,
    deviations: usize,
    kinds: Vec<u32>,
    /// How many states each of them has at most, by its number.
    counted: Option<[usize; COUNTED.len()]>,
    /// Whether a search that has not come to its fixpoint fails.
    to_the_end: bool,
}

impl Searches {
    fn run(&self) {
        let &Self {
            commands,
            deviations,
            ..
        } = self;
        let processors = || std::thread::available_parallelism().map_or(1, usize::from);
        let bounds = Bounds {
            seconds: number("MODEL_SECONDS").unwrap_or(u64::MAX),
            states: number("MODEL_STATES").unwrap_or(200_000_000) as usize,
            threads: number("MODEL_THREADS").map_or_else(processors, |threads| threads as usize),
            progress: number("MODEL_PROGRESS").is_some(),
        };
        let descriptions = descriptions();
        let all = self.worlds.len() * self.kinds.len();
        let begin = Instant::now();
        let (mut searched, mut whole, mut states, mut way, mut wait) = (0, 0, 0, 0, 0);
        for (&world, &kinds) in self
            .worlds
            .iter()
            .flat_map(|world| self.kinds.iter().map(move |kinds| (world, kinds)))
        {
            let seconds = bounds.seconds.saturating_sub(begin.elapsed().as_secs());
            if seconds == 0 {
                break;
            }
            let bounds = Bounds { seconds, ..bounds };
            let size = Size {
                commands,
                deviations,
                kinds,
            };
            let found = search(descriptions[world], size, &bounds);
            println!(
                "{commands} commands, {deviations} deviations of the kinds {kinds:#b}, world {world}: {found}"
            );
            let broken = found.violation.is_some();
            assert!(!broken, "{:?}: {found}", descriptions[world]);
            if let Some(counted) = self.counted.map(|counted| counted[world]) {
                assert!(
                    found.states <= counted,
                    "world {world} has {} states, and {counted} were counted. Two states that cannot differ later have to be equal: what \
                     the core keeps has to go once it makes no difference. Where a change of the core makes more states on purpose, put the \
                     new number into `COUNTED`",
                    found.states
                );
            }
            // An axis that is never enabled has some hundred.
            let few = found.left == 0 && found.states < 5_000;
            assert!(!few, "world {world} is too small: {found}");
            searched += 1;
            whole += usize::from(found.left == 0);
            states += found.states;
            way = way.max(found.longest_way);
            wait = wait.max(found.longest_wait);
        }
        println!(
            "{commands} commands, {deviations} deviations: {searched} of {all} worlds looked at, {whole} of them to the fixpoint, {states} states; \
             at most {way} cycles to a disabled axis, and {wait} for an answer"
        );
        let left = all - whole;
        assert!(
            !self.to_the_end || left == 0,
            "{left} of {all} worlds were not looked at to the fixpoint"
        );
    }
}

/// Every set of so many kinds of deviation.
fn sets_of(together: u32) -> Vec<u32> {
    (1..=EVERY_KIND)
        .filter(|kinds: &u32| kinds.count_ones() == together)
        .collect()
}

#[test]
fn every_state_is_sound_and_leads_to_a_disabled_axis() {
    let searches = Searches {
        worlds: match number("MODEL_EVERY_WORLD") {
            Some(_) => (0..descriptions().len()).collect(),
            None => ONE_OF_EACH.to_vec(),
        },
        commands: 1,
        deviations: 0,
        kinds: vec![EVERY_KIND],
        counted: Some(COUNTED),
        to_the_end: number("MODEL_SECONDS").is_none(),
    };
    searches.run();
}

#[test]
#[ignore = "`cargo xtask prove` runs it"]
fn every_state_of_the_size_asked_for_is_sound() {
    let all = descriptions().len();
    let first = number("MODEL_FIRST").unwrap_or(0) as usize;
    let deviations = number("MODEL_DEVIATIONS").unwrap_or(0) as usize;
    let together = number("MODEL_TOGETHER").filter(|_| deviations > 0);
    let mut kinds = match (number("MODEL_KINDS"), together) {
        (Some(kinds), _) => vec![kinds as u32],
        (None, Some(together)) => sets_of(together as u32),
        (None, None) => vec![EVERY_KIND],
    };
    let sets = kinds.len();
    kinds.rotate_left(first / all % sets);
    let searches = Searches {
        worlds: match number("MODEL_WORLD") {
            Some(only) => vec![only as usize],
            None => (0..all).map(|world| (world + first) % all).collect(),
        },
        commands: number("MODEL_COMMANDS").unwrap_or(2) as usize,
        deviations,
        kinds,
        counted: None,
        to_the_end: number("MODEL_WHOLE").is_some(),
    };
    searches.run();
}
