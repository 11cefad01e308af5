//! The search over seeds, and what is told of it.

use core::fmt;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{
    Mutex,
    atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
};
use std::time::Instant;

use crate::habits::{BEYOND, Habit, Habits, MODEL, Side, all};
use crate::scenario::{Cut, Lived, Violation, live};
use crate::tally::Tally;

pub fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

pub struct Search {
    /// Of these scenarios, and of new ones of this side from this seed on.
    pub kept: Vec<u64>,
    pub side: Side,
    pub from: u64,
    pub cycles: u64,
    /// And for at most so many seconds.
    pub seconds: u64,
    pub threads: u64,
    /// Ends after so many violations.
    pub keep: u64,
    /// Whether it prints its progress.
    pub progress: bool,
}

/// After so many cycles it does.
const PROGRESS: u64 = 2_000_000;

/// Names the seed of a scenario that ends in a panic.
struct Living(u64);

impl Drop for Living {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("the scenario of seed {} panics", self.0);
        }
    }
}

#[derive(Default)]
pub struct Found {
    pub from: u64,
    pub tally: Tally,
    pub seconds: f64,
    pub violations: Vec<(u64, Violation)>,
    /// The first scenarios in which something was said that is not so.
    wrong: Vec<u64>,
}

impl Search {
    /// Seeds are numbers in order, every other one of a side; each is mixed before it is used.
    pub fn run(&self) -> Found {
        let begin = Instant::now();
        let next = AtomicU64::new((self.from & !1) + u64::from(self.side == Side::Outside));
        let kept = AtomicUsize::new(0);
        let found = Mutex::new(Found {
            from: self.from,
            ..Found::default()
        });
        let done = AtomicBool::new(self.cycles == 0);
        std::thread::scope(|scope| {
            for _ in 0..self.threads.max(1) {
                scope.spawn(|| {
                    loop {
                        let seed = match self.kept.get(kept.fetch_add(1, Ordering::Relaxed)) {
                            Some(&seed) => seed,
                            None if done.load(Ordering::Relaxed) => break,
                            None => next.fetch_add(2, Ordering::Relaxed),
                        };
                        let lived = {
                            let _living = Living(seed);
                            live(seed, &Cut::default(), false)
                        };
                        let mut found = found.lock().expect("no panic in here");
                        found.take(seed, &lived, self.progress);
                        let over = found.tally.cycles >= self.cycles
                            || begin.elapsed().as_secs() >= self.seconds
                            || found.violations.len() as u64 >= self.keep;
                        done.store(over, Ordering::Relaxed);
                    }
                });
            }
        });
        if self.progress {
            eprintln!();
        }
        let mut found = found.into_inner().expect("no panic in there");
        found.seconds = begin.elapsed().as_secs_f64();
        found
    }
}

impl Found {
    fn take(&mut self, seed: u64, lived: &Lived, progress: bool) {
        let before = self.tally.cycles;
        self.tally.add(&lived.tally);
        if lived.tally.ends.wrong > 0 && self.wrong.len() < 8 {
            self.wrong.push(seed);
        }
        let violation = lived.violation.clone();
        self.violations
            .extend(violation.map(|violation| (seed, violation)));
        if progress && before / PROGRESS != self.tally.cycles / PROGRESS {
            let million = before as f64 / 1e6;
            let broken = self.violations.len();
            eprint!("\r{million:.0} million cycles, {broken} violations   ");
        }
    }

    /// Habits of a side that were hit less often than that: what they are to try was hardly tried.
    pub fn rare(&self, side: Side, least: u64) -> Vec<Habit> {
        let of = match side {
            Side::Inside => MODEL,
            Side::Outside => BEYOND,
        };
        let mut rare = of.to_vec();
        rare.retain(|habit| self.tally.hits.of(*habit) < least);
        rare
    }
}

fn percent(part: u64, of: u64) -> f64 {
    part as f64 * 100.0 / of.max(1) as f64
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tally = &self.tally;
        let (ends, sound) = (tally.ends, tally.sound);
        writeln!(
            f,
            "oracle: {} axis-cycles in {} scenarios from seed {} on, {} set-points taken, {} violations, {:.1} s, {:.2} million cycles a second",
            tally.cycles,
            tally.scenarios,
            self.from,
            tally.set_points,
            self.violations.len(),
            self.seconds,
            tally.cycles as f64 / self.seconds / 1e6
        )?;
        writeln!(
            f,
            "of the moves that were taken {} arrived, {} were ended by the program or the drive, and {} ({:.2} %) are unknown; of drives without \
             habits {} of {} ({:.3} %)",
            ends.arrived,
            ends.ended,
            ends.unknown,
            percent(ends.unknown, ends.all()),
            sound.unknown,
            sound.all(),
            percent(sound.unknown, sound.all())
        )?;
        writeln!(
            f,
            "of {} what was said is not so ({:.3} %), as in the scenarios {:?}; the core had nothing to do in {:.0} % of the cycles, and in {:.0} % \
             while the axis moved",
            ends.wrong,
            percent(ends.wrong, ends.all()),
            self.wrong,
            percent(tally.idle.0, tally.cycles),
            percent(tally.idle.1, tally.cycles)
        )?;
        for habit in all() {
            writeln!(f, "{:12} {habit:?}", tally.hits.of(habit))?;
        }
        // What is alike is told once: the same law, broken with the same habits.
        let mut alike: BTreeMap<(&str, String), Vec<u64>> = BTreeMap::new();
        let mut told = BTreeSet::new();
        for (seed, violation) in &self.violations {
            let cut = shrink(*seed, violation.law);
            let lived = live(*seed, &cut, true);
            let habits: Vec<_> = lived.habits.iter().collect();
            let kind = (violation.law, format!("{habits:?}"));
            if told.insert(kind.clone()) {
                writeln!(f, "\n{}", text(*seed, &lived, &cut))?;
            }
            alike.entry(kind).or_default().push(*seed);
        }
        for ((law, habits), seeds) in &alike {
            let some = &seeds[..seeds.len().min(8)];
            writeln!(
                f,
                "BROKEN {law}, with {habits}: {} seeds, {some:?}",
                seeds.len()
            )?;
        }
        Ok(())
    }
}

/// Leaves out of a scenario what the same law is broken without.
fn shrink(seed: u64, law: &str) -> Cut {
    let breaks = |cut: &Cut| {
        let lived = live(seed, cut, false);
        lived
            .violation
            .is_some_and(|violation| violation.law == law)
            .then_some(lived.commands)
    };
    let mut cut = Cut::default();
    let Some(mut commands) = breaks(&cut) else {
        return cut;
    };
    for habit in all() {
        let mut less = cut.clone();
        less.habits = less.habits.with(habit);
        if breaks(&less).is_some() {
            cut = less;
        }
    }
    let mut part = commands.div_ceil(2).max(1);
    loop {
        let mut from = 0;
        while from < commands {
            let mut less = cut.clone();
            less.commands.extend(from..(from + part).min(commands));
            less.commands.sort_unstable();
            less.commands.dedup();
            if less.commands.len() > cut.commands.len()
                && let Some(left) = breaks(&less)
            {
                cut = less;
                commands = left;
            }
            from += part;
        }
        if part == 1 {
            break;
        }
        part = part.div_ceil(2);
    }
    cut
}

fn text(seed: u64, lived: &Lived, cut: &Cut) -> String {
    let habits: Vec<_> = Habits(lived.habits.0 & !cut.habits.0).iter().collect();
    let mut text = format!(
        "seed {seed}: habits {habits:?}, {} of {} commands left\n{}\n",
        lived.commands as usize - cut.commands.len().min(lived.commands as usize),
        lived.commands,
        lived.making
    );
    for line in &lived.transcript {
        text.push_str(line);
        text.push('\n');
    }
    if let Some(violation) = &lived.violation {
        text.push_str(&format!(
            "{}: {} (cycle {})\n",
            violation.law, violation.what, violation.cycle
        ));
    }
    text
}

/// Runs the scenario of a seed for a person to read, made smaller if it breaks a law.
pub fn print(seed: u64) {
    let lived = live(seed, &Cut::default(), true);
    let Some(violation) = &lived.violation else {
        println!("{}", text(seed, &lived, &Cut::default()));
        return;
    };
    let cut = shrink(seed, violation.law);
    panic!("{}", text(seed, &live(seed, &cut, true), &cut));
}
