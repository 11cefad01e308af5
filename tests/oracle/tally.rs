//! What is counted in scenarios.

use std::collections::BTreeSet;

use crate::habits::Hits;
use crate::scenario::Kind;

#[derive(Debug, Default)]
pub struct Tally {
    pub cycles: u64,
    pub scenarios: u64,
    /// That drives took.
    pub set_points: u64,
    pub hits: Hits,
    pub ends: Ends,
    /// Those of drives without habits.
    pub sound: Ends,
    /// Cycles in which the core had nothing to do, and those of them in which the axis moved.
    pub idle: (u64, u64),
    /// What commands ended how.
    pub seen: BTreeSet<(Kind, &'static str)>,
}

/// What was said of set-points that drives had taken.
#[derive(Debug, Default, Clone, Copy)]
pub struct Ends {
    /// Reached, or passed.
    pub arrived: u64,
    /// Ended by the program or the drive, a limit among that.
    pub ended: u64,
    pub unknown: u64,
    /// Not as the drive's ledger has it. Beyond the model that may be.
    pub wrong: u64,
}

impl Tally {
    pub fn add(&mut self, other: &Self) {
        self.cycles += other.cycles;
        self.scenarios += other.scenarios;
        self.set_points += other.set_points;
        self.hits.add(&other.hits);
        self.ends.add(other.ends);
        self.sound.add(other.sound);
        self.idle.0 += other.idle.0;
        self.idle.1 += other.idle.1;
        self.seen.extend(&other.seen);
    }

    /// Whether the core says too often that it does not know, of more than two moves in a hundred: with that alone no outcome would be
    /// wrong.
    pub const fn doubts_too_much(&self) -> bool {
        self.ends.unknown * 50 > self.ends.all()
    }

    /// Whether more than one outcome in a thousand is wrong.
    pub const fn errs_too_much(&self) -> bool {
        self.ends.wrong * 1_000 > self.ends.all()
    }
}

impl Ends {
    const fn add(&mut self, other: Self) {
        self.arrived += other.arrived;
        self.ended += other.ended;
        self.unknown += other.unknown;
        self.wrong += other.wrong;
    }

    pub const fn all(self) -> u64 {
        self.arrived + self.ended + self.unknown
    }
}
