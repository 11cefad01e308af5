//! Puts each defect of `tests/mutants.toml` into a copy of the tree and demands that its tests find it.
//!
//! The copy is built once with all of them: in the rewritten code an environment variable chooses the mutant that is on.

mod build;
mod judge;
mod rewrite;
pub(crate) mod score;
mod source;
mod table;
mod tree;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

use self::build::Built;
use self::judge::Executable;
use self::table::{Fault, Mutant, Target};
use self::tree::{Sources, Tree};

/// So many tests that wait in real time run beside the others: up to half a minute for what a mutant keeps from coming.
const REAL_TIME_JOBS: usize = 2;
const REAL_TIME: [&str; 3] = ["links", "threads", "paused_log"];
/// So many of what took longest are named at the end.
const SLOWEST: usize = 10;

/// Puts each defect of tests/mutants.toml into a copy of the tree and demands that its tests find it.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The ids of the mutants, or how these begin; all of them without one.
    ids: Vec<String>,
    /// Only checks that each row has its place in the code, and a test.
    #[arg(long)]
    check: bool,
    /// Also runs each suite as a whole without a mutant, and not only the tests that rows name.
    #[arg(long)]
    suites: bool,
    /// So many tests run at a time; as many as there are processors by default.
    #[arg(long)]
    jobs: Option<NonZero<usize>>,
}

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    let begun = Instant::now();
    let root = crate::root();
    let (mutants, mut faults) = table::read(root)?;
    let mut sources = Sources::read(root, &mutants, &mut faults);
    faults.extend(tests_missing(root, &mutants));
    for fault in &faults {
        println!("mutants: {fault}");
    }
    if args.check {
        println!("mutants: {} rows, {} faults", mutants.len(), faults.len());
        return over(&faults);
    }
    let chosen = choose(&mutants, &args.ids)?;
    let jobs = args
        .jobs
        .or_else(|| thread::available_parallelism().ok())
        .map_or(1, NonZero::get);
    sources.read_constant_functions()?;
    let work = Work {
        root,
        mutants: &mutants,
        sources: &sources,
        tree: Tree::new(&root.join("target/mutants")),
        jobs,
        whole: args.suites,
        faults: Mutex::new(faults),
        times: Mutex::default(),
    };
    let faults = work.all(&chosen)?;
    println!();
    for fault in &faults {
        println!("mutants: {fault}");
    }
    let of = |mutant: &Mutant| faults.iter().any(|fault| fault.of == mutant.id);
    let caught = chosen.iter().filter(|number| !of(&mutants[**number]));
    let took = begun.elapsed().as_secs_f64();
    println!(
        "mutants: {} of {} caught in {took:.0} s",
        caught.count(),
        chosen.len()
    );
    over(&faults)
}

fn over(faults: &[Fault]) -> crate::Result<()> {
    match faults.len() {
        0 => Ok(()),
        1 => Err("one fault".into()),
        faults => Err(format!("{faults} faults").into()),
    }
}

/// Those whose ids begin as one of these, or all.
fn choose<'a>(mutants: &'a [Mutant], ids: &[String]) -> crate::Result<Vec<usize>> {
    if let Some(unknown) = ids
        .iter()
        .find(|id| !mutants.iter().any(|mutant| mutant.id.starts_with(*id)))
    {
        return Err(format!("no mutant begins with {unknown}").into());
    }
    let chosen =
        |mutant: &'a Mutant| ids.is_empty() || ids.iter().any(|id| mutant.id.starts_with(id));
    Ok((0..mutants.len())
        .filter(|number| chosen(&mutants[*number]))
        .collect())
}

/// The tests that rows name and that are nowhere. A test in a macro is found by its name alone.
fn tests_missing(root: &Path, mutants: &[Mutant]) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut texts: BTreeMap<&Target, String> = BTreeMap::new();
    for mutant in mutants {
        for (target, tests) in &mutant.tests {
            let text = texts.entry(target).or_insert_with(|| {
                target.source(root).map_or_else(String::new, |path| {
                    // With the files of its directory.
                    let one = path
                        .file_name()
                        .is_some_and(|name| name == "main.rs" || name == "lib.rs");
                    let place = if one {
                        path.parent().unwrap_or(&path)
                    } else {
                        &path
                    };
                    tree::text(place)
                })
            });
            for test in tests {
                let name = test.rsplit("::").next().unwrap_or(test);
                if !text.contains(name) {
                    faults.push(Fault::new(
                        &mutant.id,
                        format!("there is no test {target} {test}"),
                    ));
                }
            }
        }
    }
    faults
}

/// What is run at once.
enum Job<'a> {
    /// The tests of a target without a mutant.
    Suite(&'a Target),
    /// Those that a mutant fails.
    Mutant(usize, &'a Target),
}

impl Job<'_> {
    fn is_in_real_time(&self) -> bool {
        let (Self::Suite(target) | Self::Mutant(_, target)) = self;
        REAL_TIME.contains(&target.name.as_str())
    }
}

/// What there is to do, and what came of it.
struct Work<'a> {
    root: &'a Path,
    mutants: &'a [Mutant],
    sources: &'a Sources<'a>,
    tree: Tree,
    jobs: usize,
    /// Each suite passes as a whole without a mutant, not only the tests that are named.
    whole: bool,
    faults: Mutex<Vec<Fault>>,
    /// How long each suite and each row took.
    times: Mutex<Vec<(Duration, String)>>,
}

impl Work<'_> {
    /// Judges these mutants. What is wrong with them, a line each.
    fn all(mut self, chosen: &[usize]) -> crate::Result<Vec<Fault>> {
        self.tree.take_dependencies(self.root)?;
        let targets: BTreeSet<&Target> = chosen
            .iter()
            .flat_map(|mutant| self.mutants[*mutant].tests.keys())
            .collect();
        let (executables, without) = self.build(&targets)?;
        let suites = targets.iter().map(|target| Job::Suite(target));
        let built = chosen
            .iter()
            .filter(|mutant| !without.contains(&self.mutants[**mutant].number()));
        let mutants = built.flat_map(|number| {
            let targets = self.mutants[*number].tests.keys();
            targets.map(|target| Job::Mutant(*number, target))
        });
        let (real_time, others) = suites.chain(mutants).partition(Job::is_in_real_time);
        self.share(
            [(self.jobs, others), (REAL_TIME_JOBS, real_time)],
            |job| match job {
                Job::Suite(target) => self.suite(target, &executables[target], chosen),
                Job::Mutant(mutant, target) => self.judge(mutant, target, &executables[target]),
            },
        );
        self.print_slowest();
        Ok(self.faults.into_inner().unwrap_or_default())
    }

    fn took(&self, begun: Instant, what: String) {
        if let Ok(mut times) = self.times.lock() {
            times.push((begun.elapsed(), what));
        }
    }

    fn print_slowest(&self) {
        let Ok(mut times) = self.times.lock() else {
            return;
        };
        times.sort_unstable_by(|one, other| other.cmp(one));
        println!("\nmutants: the slowest");
        for (time, what) in times.iter().take(SLOWEST) {
            println!("{:6.1} s  {what}", time.as_secs_f64());
        }
    }

    /// Builds the tree with all mutants but those that do not compile, which are faults.
    fn build(
        &mut self,
        targets: &BTreeSet<&Target>,
    ) -> crate::Result<(BTreeMap<Target, PathBuf>, BTreeSet<u32>)> {
        // Those that have no place.
        let broken = |mutant: &&Mutant| self.is_at_fault(&mutant.id);
        let broken = self.mutants.iter().filter(broken);
        let mut without: BTreeSet<_> = broken.map(Mutant::number).collect();
        loop {
            let begun = Instant::now();
            self.tree.write(self.sources, &without)?;
            match build::build(&self.tree, targets)? {
                Built::Executables(executables) => {
                    println!(
                        "mutants: {} targets built in {:.0} s",
                        targets.len(),
                        begun.elapsed().as_secs_f64()
                    );
                    if let Some(missing) = targets
                        .iter()
                        .find(|target| !executables.contains_key(target))
                    {
                        return Err(format!("cargo has built no {missing}").into());
                    }
                    return Ok((executables, without));
                }
                Built::Errors { text, mutants, .. } => {
                    println!("{text}");
                    if mutants.is_subset(&without) {
                        return Err("the rewritten tree does not compile".into());
                    }
                    for mutant in self
                        .mutants
                        .iter()
                        .filter(|mutant| mutants.contains(&mutant.number()))
                    {
                        self.fault(&mutant.id, "does not compile");
                    }
                    without.extend(mutants);
                }
            }
        }
    }

    /// Does what there is to do, so many of each queue at a time.
    fn share<'a>(
        &self,
        queues: [(usize, VecDeque<Job<'a>>); 2],
        action: impl Fn(Job<'a>) -> crate::Result<()> + Sync,
    ) {
        let queues = queues.map(|(workers, queue)| (workers, Mutex::new(queue)));
        let next = |queue: &Mutex<VecDeque<Job<'a>>>| queue.lock().ok()?.pop_front();
        thread::scope(|scope| {
            for (workers, queue) in &queues {
                for _ in 0..*workers {
                    scope.spawn(|| {
                        while let Some(job) = next(queue) {
                            if let Err(error) = action(job) {
                                self.fault(&"a test", error.to_string());
                            }
                        }
                    });
                }
            }
        });
    }

    fn suite(&self, target: &Target, path: &Path, chosen: &[usize]) -> crate::Result<()> {
        let begun = Instant::now();
        let of = chosen
            .iter()
            .filter_map(|mutant| self.mutants[*mutant].tests.get(target));
        let needed = of.flatten().map(String::as_str).collect();
        let executable = Executable {
            tree: &self.tree,
            target,
            path,
        };
        let passed = executable.without_mutant(&needed, self.whole)?;
        self.took(begun, format!("{target} without a mutant"));
        match passed {
            Ok(()) => println!(
                "{target}: passes without a mutant ({:.0} s)",
                begun.elapsed().as_secs_f64()
            ),
            Err((faults, output)) => {
                println!("{output}");
                for fault in faults {
                    self.fault(target, fault);
                }
            }
        }
        Ok(())
    }

    fn judge(&self, mutant: usize, target: &Target, path: &Path) -> crate::Result<()> {
        let Mutant { id, tests, .. } = &self.mutants[mutant];
        let begun = Instant::now();
        let executable = Executable {
            tree: &self.tree,
            target,
            path,
        };
        let judged = executable.judge(&self.mutants[mutant], &tests[target])?;
        let took = begun.elapsed().as_secs_f64();
        self.took(begun, format!("{id} by {target}"));
        match judged {
            Ok(()) => println!(
                "{id:60} {took:5.1} s  caught by {target} ({})",
                tests[target].len()
            ),
            Err((wrong, output)) => {
                println!("{id:60} {took:5.1} s  {wrong}\n{output}");
                self.fault(id, format!("{target} {wrong}"));
            }
        }
        Ok(())
    }

    fn fault(&self, of: &dyn std::fmt::Display, what: impl Into<String>) {
        if let Ok(mut faults) = self.faults.lock() {
            faults.push(Fault::new(of, what));
        }
    }

    fn is_at_fault(&self, id: &str) -> bool {
        let faults = self.faults.lock();
        faults.is_ok_and(|faults| faults.iter().any(|fault| fault.of == id))
    }
}
