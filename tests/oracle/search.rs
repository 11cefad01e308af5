//! The search over seeds, and what is told of it.

use core::fmt;
use std::collections::BTreeMap;
use std::sync::{
    Mutex,
    atomic::{AtomicU64, AtomicUsize, Ordering},
};
use std::time::Instant;

use crate::habits::{ALL, Habit, Habits, Hits};
use crate::scenario::{self, Cut, Ends, Told, Violation, live};

pub fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

pub struct Search {
    pub kept: Vec<u64>,
    pub from: u64,
    pub cycles: u64,
    pub threads: u64,
    /// And for at most so many seconds.
    pub seconds: u64,
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
    pub cycles: u64,
    pub scenarios: u64,
    pub set_points: u64,
    pub hits: Hits,
    pub ends: Ends,
    pub seconds: f64,
    pub violations: Vec<(u64, Violation)>,
}

/// Seeds are numbers in order; each is mixed before it is used.
impl Search {
    pub fn run(&self) -> Found {
        let begin = Instant::now();
        let next = AtomicU64::new(self.from);
        let kept = AtomicUsize::new(0);
        let spent = AtomicU64::new(0);
        let found = Mutex::new(Found {
            from: self.from,
            ..Found::default()
        });
        std::thread::scope(|scope| {
            for _ in 0..self.threads.max(1) {
                scope.spawn(|| {
                    let mut mine = Found::default();
                    loop {
                        let place = kept.fetch_add(1, Ordering::Relaxed);
                        let seed = match self.kept.get(place) {
                            Some(&seed) => seed,
                            None if spent.load(Ordering::Relaxed) >= self.cycles
                                || begin.elapsed().as_secs() >= self.seconds =>
                            {
                                break;
                            }
                            None => next.fetch_add(1, Ordering::Relaxed),
                        };
                        let told = {
                            let _living = Living(seed);
                            live(seed, &Cut::default(), false)
                        };
                        let before = spent.fetch_add(told.cycles, Ordering::Relaxed);
                        if self.progress && before / PROGRESS != (before + told.cycles) / PROGRESS {
                            let million = before as f64 / 1e6;
                            let broken = found.lock().expect("no panic in here").violations.len();
                            eprint!("\r{million:.0} million cycles, {broken} violations   ");
                        }
                        mine.cycles += told.cycles;
                        mine.scenarios += 1;
                        mine.set_points += told.set_points;
                        mine.hits.add(&told.hits);
                        mine.ends.add(told.ends);
                        if let Some(violation) = told.violation {
                            let mut found = found.lock().expect("no panic in here");
                            found.violations.push((seed, violation));
                            if found.violations.len() as u64 >= self.keep {
                                spent.store(u64::MAX / 2, Ordering::Relaxed);
                                break;
                            }
                        }
                    }
                    let mut found = found.lock().expect("no panic in here");
                    found.cycles += mine.cycles;
                    found.scenarios += mine.scenarios;
                    found.set_points += mine.set_points;
                    found.hits.add(&mine.hits);
                    found.ends.add(mine.ends);
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
    /// How many of the moves that have ended, by themselves or nobody knows how, may be of the latter kind.
    const DOUBTFUL_PERCENT: u64 = 2;

    /// Whether the core says too often that it does not know: with that alone each of the laws would hold.
    pub const fn doubts_too_much(&self) -> bool {
        let Ends {
            arrived, doubtful, ..
        } = self.ends;
        doubtful * 100 > (arrived + doubtful) * Self::DOUBTFUL_PERCENT
    }

    /// Habits that were hit less than once in a million cycles: what they are to try was hardly tried.
    pub fn rare(&self) -> Vec<Habit> {
        let least = self.cycles / 1_000_000;
        let hits = scenario::habits_of(self.from).iter().copied();
        let rare = hits.zip(self.hits.0).filter(|(_, times)| *times < least);
        rare.map(|(habit, _)| habit).collect()
    }
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "oracle: {} axis-cycles in {} scenarios from seed {} on, {} set-points taken, {} violations, {:.1} s, {:.2} million cycles a second",
            self.cycles,
            self.scenarios,
            self.from,
            self.set_points,
            self.violations.len(),
            self.seconds,
            self.cycles as f64 / self.seconds / 1e6
        )?;
        let Ends {
            arrived,
            ended,
            doubtful,
        } = self.ends;
        writeln!(
            f,
            "of the moves that were taken {arrived} arrived, {ended} were ended by the program or the drive, and of {doubtful} that is not known"
        )?;
        let of = scenario::habits_of(self.from).iter();
        let rarest = of.zip(self.hits.0).min_by_key(|(_, times)| *times);
        if let Some((habit, times)) = rarest {
            writeln!(f, "the rarest habit, {habit:?}, showed {times} times")?;
        }
        for (habit, times) in ALL.iter().zip(self.hits.0) {
            writeln!(f, "{times:12} {habit:?}")?;
        }
        // What is alike is told once: the same law, broken with the same habits.
        let mut alike: BTreeMap<(&str, String), Vec<u64>> = BTreeMap::new();
        for (seed, violation) in &self.violations {
            let cut = shrink(*seed, violation.law);
            let told = live(*seed, &cut, false);
            let habits: Vec<_> = told.habits.iter().collect();
            alike
                .entry((violation.law, format!("{habits:?}")))
                .or_default()
                .push(*seed);
        }
        for ((law, habits), seeds) in &alike {
            writeln!(
                f,
                "BROKEN {law}, with {habits}: seeds {:?}",
                &seeds[..seeds.len().min(8)]
            )?;
        }
        for (seed, violation) in &self.violations {
            if alike
                .iter()
                .any(|((law, _), seeds)| *law == violation.law && seeds.first() == Some(seed))
            {
                writeln!(f, "\n{}", report(*seed, violation))?;
            }
        }
        Ok(())
    }
}

/// Leaves out of a scenario what the same law is broken without.
pub fn shrink(seed: u64, law: &str) -> Cut {
    let breaks = |cut: &Cut| {
        let told = live(seed, cut, false);
        told.violation
            .is_some_and(|violation| violation.law == law)
            .then_some(told.commands)
    };
    let mut cut = Cut::default();
    let Some(mut commands) = breaks(&cut) else {
        return cut;
    };
    for &habit in ALL {
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

fn report(seed: u64, violation: &Violation) -> String {
    let cut = shrink(seed, violation.law);
    let told = live(seed, &cut, true);
    text(seed, &told, &cut)
}

fn text(seed: u64, told: &Told, cut: &Cut) -> String {
    let habits: Vec<_> = Habits(told.habits.0 & !cut.habits.0).iter().collect();
    let mut text = format!(
        "seed {seed}, made smaller: habits {habits:?}, {} of {} commands left\n{}\n",
        told.commands as usize - cut.commands.len().min(told.commands as usize),
        told.commands,
        told.making
    );
    for line in &told.transcript {
        text.push_str(line);
        text.push('\n');
    }
    if let Some(violation) = &told.violation {
        text.push_str(&format!(
            "{}: {} (cycle {})\n",
            violation.law, violation.what, violation.cycle
        ));
    }
    text
}

/// Runs the scenario of a seed for a person to read.
pub fn print(seed: u64) {
    let told = live(seed, &Cut::default(), true);
    match &told.violation {
        Some(violation) => panic!("{}", report(seed, violation)),
        None => println!("{}", text(seed, &told, &Cut::default())),
    }
}
