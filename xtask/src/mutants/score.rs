//! How many of the mutants that `cargo-mutants` thinks of do the tests catch? A random sample of them is put into a copy of
//! the tree, which is built once, and all tests of the workspace run with each.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::{self, File};
use std::io::Write;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use super::REAL_TIME;
use super::build::{self, Built};
use super::judge::{Executable, Judged};
use super::table::{Mutant, Target};
use super::tree::{Place, Sources, Tree};

/// The rooms of motion.
const ROOMS: [&str; 6] = [
    "src/axis/**/*.rs",
    "src/ds402/**/*.rs",
    "src/homing/**/*.rs",
    "src/profile_position/**/*.rs",
    "src/profile_velocity/**/*.rs",
    "src/units/**/*.rs",
];
/// Where the results are kept.
const KEPT: &str = "docs/mutation-score.jsonl";
/// What is no part of what is judged.
const PAGES: [&str; 4] = ["--", ".", ":!docs", ":!*.md"];
/// So many of a hundred viable mutants are to be caught.
const LEAST: f64 = 97.0;
/// What ends no suite in this time, after three times as long as without a mutant, hangs.
const PATIENCE: Duration = Duration::from_secs(20);
/// A mutant that hangs in so many suites is given up.
const HANGS: usize = 3;

/// Draws mutants of the rooms of motion and shows how many of them the tests of the workspace catch.
///
/// cargo-mutants names the mutants (`cargo install --locked cargo-mutants`). Results are kept; called again, it goes on
/// where it was ended.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The seed of the sample; without it that of the results that are kept for this commit, or a new one.
    #[arg(long)]
    seed: Option<u64>,
    /// So many mutants are drawn.
    #[arg(long, default_value = "400")]
    sample: usize,
    /// So many suites run at a time; as many as there are processors by default.
    #[arg(long)]
    jobs: Option<NonZero<usize>>,
    /// Only shows the results that are kept.
    #[arg(long)]
    report: bool,
    /// Tries all mutants with this in their names (a file, a function) in place of a sample, and keeps no results.
    #[arg(long)]
    only: Vec<String>,
    /// With these tests of the library alone, `lib` for its unit tests: what they do not catch, another may.
    #[arg(long, value_delimiter = ',', requires = "only")]
    suites: Vec<String>,
}

/// What the results are of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Drawn {
    commit: String,
    seed: u64,
    sample: usize,
    /// All mutants of the rooms.
    of: usize,
}

/// What came of one mutant.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Outcome {
    mutant: String,
    #[serde(flatten)]
    verdict: Verdict,
    seconds: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "verdict", rename_all = "snake_case")]
enum Verdict {
    /// It does not compile.
    Unviable,
    /// A suite fails with it.
    Caught { by: String },
    /// No suite fails, and some come to no end.
    TimedOut,
    /// All suites pass.
    Survived,
}

/// A mutant as `cargo mutants --list --json` names it.
#[derive(Debug, Deserialize)]
struct Named {
    name: String,
    file: String,
    span: Span,
    replacement: String,
}

#[derive(Debug, Deserialize)]
struct Span {
    start: Corner,
    end: Corner,
}

/// Lines and columns count from 1, columns in characters.
#[derive(Debug, Deserialize)]
struct Corner {
    line: usize,
    column: usize,
}

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    let root = crate::root();
    if !args.only.is_empty() {
        return explore(root, args);
    }
    let file = root.join(KEPT);
    let commit = git(root, &["rev-parse", "HEAD"])?;
    let kept = Kept::read(&file)?;
    if args.report {
        let kept = kept.ok_or("there are no results yet: run cargo xtask mutation-score")?;
        return report(&kept, is_same(root, &kept.drawn.commit));
    }
    if git(root, &[&["diff", "--quiet", "HEAD"], &PAGES[..]].concat()).is_err() {
        return Err("the results are of a commit: commit the changes first".into());
    }
    let named = named(root)?;
    let kept = kept.filter(|kept| {
        is_same(root, &kept.drawn.commit)
            && kept.drawn.sample == args.sample
            && args.seed.is_none_or(|seed| kept.drawn.seed == seed)
    });
    let mut kept = kept.unwrap_or_else(|| Kept {
        drawn: Drawn {
            commit,
            seed: args.seed.unwrap_or_else(new_seed),
            sample: args.sample,
            of: named.len(),
        },
        outcomes: BTreeMap::new(),
    });
    println!(
        "mutation-score: commit {}, seed {}, {} of {} mutants, {} of them judged before",
        kept.drawn.commit,
        kept.drawn.seed,
        args.sample.min(named.len()),
        named.len(),
        kept.outcomes.len()
    );
    let drawn = draw(named, kept.drawn.seed, args.sample);
    let left = drawn
        .iter()
        .filter(|mutant| !kept.outcomes.contains_key(&mutant.name))
        .collect::<Vec<_>>();
    if !left.is_empty() {
        let results = Results::open(&file, &kept)?;
        judge(root, &left, args, &results)?;
        kept = Kept::read(&file)?.ok_or("the results are gone")?;
    }
    report(&kept, true)
}

/// Tries all mutants of some names, and shows which the tests do not catch.
fn explore(root: &Path, args: &Args) -> crate::Result<()> {
    let mut named = named(root)?;
    named.retain(|named| args.only.iter().any(|part| named.name.contains(part)));
    let file = root.join("target/mutation-score-only.jsonl");
    let drawn = Drawn {
        commit: "as it is".to_owned(),
        seed: 0,
        sample: named.len(),
        of: named.len(),
    };
    let none = Kept {
        drawn,
        outcomes: BTreeMap::new(),
    };
    let results = Results::open(&file, &none)?;
    judge(root, &named.iter().collect::<Vec<_>>(), args, &results)?;
    report(&Kept::read(&file)?.ok_or("the results are gone")?, true)
}

/// What git prints.
fn git(root: &Path, arguments: &[&str]) -> crate::Result<String> {
    let output = Command::new("git")
        .args(arguments)
        .current_dir(root)
        .output()?;
    if !output.status.success() {
        let error = String::from_utf8_lossy(&output.stderr);
        return Err(format!("git {}: {error}", arguments.join(" ")).into());
    }
    Ok(String::from_utf8(output.stdout)?.trim().to_owned())
}

/// Whether nothing but pages has changed since this commit.
fn is_same(root: &Path, commit: &str) -> bool {
    git(
        root,
        &[&["diff", "--quiet", commit, "HEAD"], &PAGES[..]].concat(),
    )
    .is_ok()
}

fn new_seed() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(1, |now| now.as_secs())
}

/// All mutants of the rooms of motion.
fn named(root: &Path) -> crate::Result<Vec<Named>> {
    let output = Command::new("cargo")
        .args(["mutants", "--list", "--json", "--colors=never"])
        .args(ROOMS.iter().flat_map(|room| ["--file", room]))
        .current_dir(root)
        .output()?;
    if !output.status.success() {
        let error = String::from_utf8_lossy(&output.stderr);
        return Err(format!(
            "cargo mutants --list: {error}\ncargo install --locked cargo-mutants installs it"
        )
        .into());
    }
    let mut named: Vec<Named> = serde_json::from_slice(&output.stdout)?;
    named.sort_by(|one, other| one.name.cmp(&other.name));
    named.dedup_by(|one, other| one.name == other.name);
    Ok(named)
}

/// A sample without repetition; a larger one of the same seed contains a smaller one.
fn draw(mut all: Vec<Named>, seed: u64, sample: usize) -> Vec<Named> {
    fastrand::Rng::with_seed(seed).shuffle(&mut all);
    all.truncate(sample);
    all
}

/// Puts the mutants into the copy of the tree, builds it, and runs all suites with each of them.
fn judge(root: &Path, left: &[&Named], args: &Args, results: &Results) -> crate::Result<()> {
    let jobs = args.jobs.or_else(|| thread::available_parallelism().ok());
    let jobs = jobs.map_or(1, NonZero::get);
    let mutants: Vec<Mutant> = left
        .iter()
        .map(|named| Mutant::outside_the_table(&named.name))
        .collect();
    let places: Vec<Place<'_>> = left
        .iter()
        .map(|named| Place {
            file: &named.file,
            from: (named.span.start.line, named.span.start.column),
            to: (named.span.end.line, named.span.end.column),
            replace: &named.replacement,
        })
        .collect();
    let (mut sources, faults) = Sources::at(root, &mutants, &places);
    sources.read_constant_functions()?;
    let mut without: BTreeSet<u32> = BTreeSet::new();
    for fault in faults {
        println!("mutation-score: {fault}");
        let mutant = mutants.iter().find(|mutant| mutant.id == fault.of);
        without.extend(mutant.map(Mutant::number));
    }
    // Those that would keep a function from being constant that has to be are built one by one.
    let mut single: BTreeSet<usize> = BTreeSet::new();
    let mut tree = Tree::new(&root.join("target/mutation-score"));
    tree.take_dependencies(root)?;
    let executables = loop {
        let apart = single.iter().map(|place| mutants[*place].number());
        tree.write(&sources, &without.iter().copied().chain(apart).collect())?;
        match build::everything(&tree, &args.suites)? {
            Built::Executables(executables) => break executables,
            Built::Errors {
                text,
                mutants: wrong,
                not_constant,
            } => {
                let before = (without.len(), single.len());
                let numbers = mutants.iter().map(Mutant::number).enumerate();
                single.extend(numbers.clone().filter_map(|(place, number)| {
                    (!without.contains(&number)
                        && sources.keeps_from_constant(number, &not_constant))
                    .then_some(place)
                }));
                without.extend(wrong);
                println!(
                    "mutation-score: {} do not compile, {} are built one by one",
                    without.len(),
                    single.len()
                );
                if (without.len(), single.len()) == before {
                    return Err(format!("{text}\nthe rewritten tree does not compile").into());
                }
            }
        }
    };
    for mutant in &mutants {
        if without.contains(&mutant.number()) {
            results.add(&mutant.id, Verdict::Unviable, Duration::ZERO)?;
        }
    }
    let suites = Suites::measured(&tree, executables)?;
    let queue: Mutex<VecDeque<&Mutant>> = Mutex::new(
        mutants
            .iter()
            .enumerate()
            .filter(|(place, mutant)| {
                !single.contains(place) && !without.contains(&mutant.number())
            })
            .map(|(_, mutant)| mutant)
            .collect(),
    );
    let total = queue.lock().map_or(0, |queue| queue.len());
    let wrong: Mutex<Vec<String>> = Mutex::default();
    let next = || {
        let mut queue = queue.lock().ok()?;
        let mutant = queue.pop_front()?;
        Some((total - queue.len(), mutant))
    };
    thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                while let Some((number, mutant)) = next() {
                    let begun = Instant::now();
                    let judged = suites.judge(mutant, false);
                    let judged = judged.and_then(|verdict| {
                        let took = begun.elapsed();
                        println!(
                            "{number:4}/{total} {:6.1} s  {verdict}  {}",
                            took.as_secs_f64(),
                            mutant.id
                        );
                        results.add(&mutant.id, verdict, took)
                    });
                    if let (Err(error), Ok(mut wrong)) = (judged, wrong.lock()) {
                        wrong.push(format!("{}: {error}", mutant.id));
                    }
                }
            });
        }
    });
    if let Some(wrong) = wrong.into_inner().unwrap_or_default().first() {
        return Err(wrong.clone().into());
    }
    for place in single {
        let (mutant, begun) = (&mutants[place], Instant::now());
        tree.put(&sources, place)?;
        let verdict = match build::everything(&tree, &args.suites)? {
            Built::Executables(_) => suites.judge(mutant, true)?,
            Built::Errors { .. } => Verdict::Unviable,
        };
        tree.take_out(&sources, place)?;
        println!("one by one: {verdict}  {}", mutant.id);
        results.add(&mutant.id, verdict, begun.elapsed())?;
    }
    Ok(())
}

/// All suites of the workspace.
struct Suites<'a> {
    tree: &'a Tree,
    suites: Vec<Suite>,
}

struct Suite {
    target: Target,
    path: PathBuf,
    /// How long it takes without a mutant.
    took: Duration,
    /// The mutants whose code it runs.
    reached: BTreeSet<u32>,
    tried: AtomicU32,
    caught: AtomicU32,
}

impl Suite {
    fn executable<'a>(&'a self, tree: &'a Tree) -> Executable<'a> {
        Executable {
            tree,
            target: &self.target,
            path: &self.path,
        }
    }

    /// The time that it takes for each mutant that it catches. A suite that waits in real time is the last.
    fn cost(&self) -> (bool, Duration) {
        let (tried, caught) = (self.tried.load(Relaxed), self.caught.load(Relaxed));
        let cost = self.took * (tried + 2) / (caught + 1);
        (is_in_real_time(&self.target), cost)
    }
}

impl<'a> Suites<'a> {
    /// Runs each without a mutant, which it has to pass.
    fn measured(tree: &'a Tree, executables: BTreeMap<Target, PathBuf>) -> crate::Result<Self> {
        let mut suites = Vec::new();
        for (target, path) in executables {
            if target.package == "servocrab-sim" {
                // It runs the simulated drives alone, which share nothing with the library.
                continue;
            }
            let mut suite = Suite {
                target,
                path,
                took: Duration::ZERO,
                reached: BTreeSet::new(),
                tried: AtomicU32::new(0),
                caught: AtomicU32::new(0),
            };
            let begun = Instant::now();
            let (judged, reached) = suite.executable(tree).reach(Duration::from_secs(900))?;
            suite.took = begun.elapsed();
            suite.reached = reached;
            let target = &suite.target;
            match judged {
                Judged::Passed => {}
                Judged::Failed { by } => {
                    return Err(format!("{target} fails without a mutant: {by}").into());
                }
                Judged::Hung => return Err(format!("{target} hangs without a mutant").into()),
            }
            println!(
                "{target}: {:.1} s without a mutant, runs the code of {}",
                suite.took.as_secs_f64(),
                suite.reached.len()
            );
            suites.push(suite);
        }
        Ok(Self { tree, suites })
    }

    /// Runs the suites that run the mutant's code; first those that take the least time for each mutant that they catch.
    /// Of a mutant that is built `alone` no suite has said whether it runs its code: all are run.
    fn judge(&self, mutant: &Mutant, alone: bool) -> crate::Result<Verdict> {
        let mut suites: Vec<&Suite> = self
            .suites
            .iter()
            .filter(|suite| alone || suite.reached.contains(&mutant.number()))
            .collect();
        suites.sort_by_key(|suite| suite.cost());
        let mut hung = 0;
        for suite in suites {
            let executable = suite.executable(self.tree);
            let limit = suite.took * 3 + PATIENCE;
            suite.tried.fetch_add(1, Relaxed);
            match executable.all(Some(mutant), limit)? {
                Judged::Passed => {}
                Judged::Failed { by } => {
                    // A suite that waits in real time may fail by the load of the computer.
                    let surely = !is_in_real_time(&suite.target)
                        || matches!(executable.all(Some(mutant), limit)?, Judged::Failed { .. })
                            && matches!(executable.all(None, limit)?, Judged::Passed);
                    if surely {
                        suite.caught.fetch_add(1, Relaxed);
                        let by = format!("{} {by}", suite.target);
                        return Ok(Verdict::Caught { by });
                    }
                }
                Judged::Hung => hung += 1,
            }
            if hung == HANGS {
                break;
            }
        }
        Ok(if hung > 0 {
            Verdict::TimedOut
        } else {
            Verdict::Survived
        })
    }
}

fn is_in_real_time(target: &Target) -> bool {
    target.package != "servocrab" || REAL_TIME.contains(&target.name.as_str())
}

/// The results in their file: what they are of, then a line for each mutant.
struct Kept {
    drawn: Drawn,
    outcomes: BTreeMap<String, Outcome>,
}

impl Kept {
    fn read(path: &Path) -> crate::Result<Option<Self>> {
        let Ok(text) = fs::read_to_string(path) else {
            return Ok(None);
        };
        let mut lines = text.lines();
        let Some(first) = lines.next() else {
            return Ok(None);
        };
        let drawn = serde_json::from_str(first)?;
        // The last line may have been cut off.
        let outcomes = lines.filter_map(|line| serde_json::from_str::<Outcome>(line).ok());
        Ok(Some(Self {
            drawn,
            outcomes: outcomes
                .map(|outcome| (outcome.mutant.clone(), outcome))
                .collect(),
        }))
    }
}

/// The file to which results are added.
struct Results(Mutex<File>);

impl Results {
    /// Writes what was kept, and is ready for more.
    fn open(path: &Path, kept: &Kept) -> crate::Result<Self> {
        fs::create_dir_all(path.parent().unwrap_or(path))?;
        let mut file = File::create(path)?;
        writeln!(file, "{}", serde_json::to_string(&kept.drawn)?)?;
        for outcome in kept.outcomes.values() {
            writeln!(file, "{}", serde_json::to_string(outcome)?)?;
        }
        Ok(Self(Mutex::new(file)))
    }

    fn add(&self, mutant: &str, verdict: Verdict, took: Duration) -> crate::Result<()> {
        let outcome = Outcome {
            mutant: mutant.to_owned(),
            verdict,
            seconds: took.as_secs(),
        };
        let line = serde_json::to_string(&outcome)?;
        let mut file = self.0.lock().map_err(|_| "the file of the results")?;
        writeln!(file, "{line}")?;
        Ok(())
    }
}

/// Prints what the results say, and fails where they are of another commit, or too few are caught.
fn report(kept: &Kept, is_same: bool) -> crate::Result<()> {
    let Kept { drawn, outcomes } = kept;
    let count = |wanted: fn(&Verdict) -> bool| {
        let verdicts = outcomes.values().map(|outcome| &outcome.verdict);
        verdicts.filter(|verdict| wanted(verdict)).count()
    };
    let unviable = count(|verdict| *verdict == Verdict::Unviable);
    let caught = count(|verdict| matches!(verdict, Verdict::Caught { .. }));
    let timed_out = count(|verdict| *verdict == Verdict::TimedOut);
    let viable = outcomes.len() - unviable;
    for outcome in outcomes.values() {
        if matches!(outcome.verdict, Verdict::Survived | Verdict::TimedOut) {
            println!("{}: {}", outcome.verdict, outcome.mutant);
        }
    }
    let score = 100.0 * caught as f64 / viable.max(1) as f64;
    println!(
        "mutation-score: commit {}, seed {}: {} of {} drawn of {}; {viable} viable, {caught} caught, {timed_out} timed out: {score:.1} %",
        drawn.commit,
        drawn.seed,
        outcomes.len(),
        drawn.sample,
        drawn.of,
    );
    if !is_same {
        return Err("the code has changed since that commit: the results are of another".into());
    }
    if outcomes.len() < drawn.sample.min(drawn.of) {
        return Err("not all of the sample is judged: call it again, and it goes on".into());
    }
    if score < LEAST {
        return Err(format!("less than {LEAST} % of the viable mutants are caught").into());
    }
    Ok(())
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Unviable => f.write_str("does not compile"),
            Self::Caught { by } => write!(f, "caught by {by}"),
            Self::TimedOut => f.write_str("TIMED OUT"),
            Self::Survived => f.write_str("SURVIVED"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(count: usize) -> Vec<Named> {
        let corner = || Corner { line: 1, column: 1 };
        let one = |number: usize| Named {
            name: format!("{number:04}"),
            file: String::new(),
            span: Span {
                start: corner(),
                end: corner(),
            },
            replacement: String::new(),
        };
        (0..count).map(one).collect()
    }

    fn names(drawn: &[Named]) -> Vec<&str> {
        drawn.iter().map(|named| named.name.as_str()).collect()
    }

    fn kept(verdicts: &[Verdict]) -> Kept {
        let outcomes = verdicts.iter().enumerate().map(|(number, verdict)| {
            let outcome = Outcome {
                mutant: number.to_string(),
                verdict: verdict.clone(),
                seconds: 0,
            };
            (number.to_string(), outcome)
        });
        Kept {
            drawn: Drawn {
                commit: "a".to_owned(),
                seed: 1,
                sample: verdicts.len(),
                of: verdicts.len(),
            },
            outcomes: outcomes.collect(),
        }
    }

    #[test]
    fn a_seed_draws_the_same_sample_and_another_seed_another() {
        let (one, again, other) = (
            draw(named(1000), 7, 10),
            draw(named(1000), 7, 20),
            draw(named(1000), 8, 10),
        );
        assert_eq!(names(&one), names(&again)[..10]);
        assert_ne!(names(&one), names(&other));
    }

    #[test]
    fn a_mutant_that_hangs_is_not_caught_and_one_that_does_not_compile_does_not_count() {
        let caught = || Verdict::Caught { by: String::new() };
        let mut verdicts = vec![caught(); 97];
        verdicts.push(Verdict::Unviable);
        verdicts.extend([Verdict::Survived, Verdict::TimedOut, Verdict::Survived]);
        assert!(report(&kept(&verdicts), true).is_ok());
        verdicts.push(Verdict::TimedOut);
        assert!(report(&kept(&verdicts), true).is_err());
    }

    #[test]
    fn results_of_another_commit_or_of_a_part_of_the_sample_are_refused() {
        let caught = [Verdict::Caught { by: String::new() }];
        assert!(report(&kept(&caught), true).is_ok());
        assert!(report(&kept(&caught), false).is_err());
        let mut part = kept(&caught);
        part.drawn.sample = 2;
        part.drawn.of = 2;
        assert!(report(&part, true).is_err());
    }

    #[test]
    fn results_are_read_as_they_were_written_but_for_a_line_that_was_cut_off() {
        let directory = std::env::temp_dir().join(format!("score-{}", std::process::id()));
        let path = directory.join("results.jsonl");
        let before = kept(&[Verdict::TimedOut, Verdict::Survived]);
        let results = Results::open(&path, &before).expect("a file");
        let by = "--lib a".to_owned();
        results
            .add("2", Verdict::Caught { by }, Duration::from_secs(3))
            .expect("a line");
        let mut text = fs::read_to_string(&path).expect("the file");
        text.push_str("{\"mutant\":\"3\",\"verd");
        fs::write(&path, text).expect("the file");
        let after = Kept::read(&path).expect("results").expect("a sample");
        fs::remove_dir_all(directory).expect("the directory");
        assert_eq!(after.drawn, before.drawn);
        assert_eq!(after.outcomes.len(), 3);
        let by = "--lib a".to_owned();
        assert_eq!(after.outcomes["2"].verdict, Verdict::Caught { by });
    }
}
