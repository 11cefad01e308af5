//! Runs tests with a mutant, or without, and says what came of it.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use super::build;
use super::table::{Mutant, Target};
use super::tree::Tree;

/// Longest time for the tests of one mutant: one that hangs is not caught.
const LIMIT: Duration = Duration::from_secs(120);
/// And for a whole suite without a mutant.
const SUITE_LIMIT: Duration = Duration::from_secs(600);
const POLL: Duration = Duration::from_millis(5);

/// What a run of tests printed.
struct Run {
    output: String,
    in_time: bool,
    success: bool,
    /// What the mutants wrote that were come to.
    seen: Vec<u8>,
}

/// What ends a run in time.
#[derive(Clone, Copy, PartialEq)]
enum Until {
    AllEnded,
    FirstFailed,
}

/// What a whole suite says.
pub(crate) enum Judged {
    Passed,
    Failed {
        by: String,
    },
    /// It came to no end.
    Hung,
}

/// The executable of a target.
pub(crate) struct Executable<'a> {
    pub(crate) tree: &'a Tree,
    pub(crate) target: &'a Target,
    pub(crate) path: &'a Path,
}

impl Executable<'_> {
    /// Runs tests without a mutant: the whole suite, or only those that are needed. Else what is wrong and what was printed.
    pub(crate) fn without_mutant(
        &self,
        needed: &BTreeSet<&str>,
        whole: bool,
    ) -> io::Result<Result<(), (Vec<String>, String)>> {
        let mut command = Command::new(self.path);
        if !whole {
            command.arg("--exact").args(needed);
        }
        // That the suites that search find nothing in all of their worlds is shown before.
        command.envs([
            ("INVARIANT_CYCLES", "20000"),
            ("ORACLE_SHORT", "400000"),
            ("ALLOCATION_CYCLES", "10000"),
            ("MODEL_SECONDS", "5"),
        ]);
        let run = self.run(command, "suite", SUITE_LIMIT, Until::AllEnded)?;
        let mut wrong: Vec<_> = failures(&run.output)
            .map(|name| format!("{name} fails without a mutant"))
            .collect();
        if !run.in_time {
            wrong.push("hangs without a mutant".to_owned());
        }
        let missing = needed.iter().filter(|name| !passed(&run.output, name));
        if wrong.is_empty() {
            wrong.extend(missing.map(|name| format!("{name} does not pass without a mutant")));
        }
        Ok(if wrong.is_empty() {
            Ok(())
        } else {
            Err((wrong, run.output))
        })
    }

    /// Nothing where each of these tests fails by an assertion of its own, else what is wrong and what was printed.
    pub(crate) fn judge(
        &self,
        mutant: &Mutant,
        tests: &BTreeSet<String>,
    ) -> io::Result<Result<(), (String, String)>> {
        let mut command = Command::new(self.path);
        command.args(["--exact", "--test-threads=1"]).args(tests);
        command.env("MUTANT", mutant.number().to_string());
        let run = self.run(command, &mutant.id, LIMIT, Until::AllEnded)?;
        let wrong = verdict(&run, self.target, tests);
        Ok(wrong.map_or(Ok(()), |wrong| Err((wrong, run.output))))
    }

    /// Runs the whole suite with a mutant, or without, until a test of it fails.
    pub(crate) fn all(&self, mutant: Option<&Mutant>, limit: Duration) -> io::Result<Judged> {
        let mutant = mutant.map(|mutant| mutant.number().to_string());
        Ok(self.whole(mutant.as_deref(), limit)?.0)
    }

    /// Runs the whole suite without a mutant, and says of which mutants it runs the code.
    pub(crate) fn reach(&self, limit: Duration) -> io::Result<(Judged, BTreeSet<u32>)> {
        let (judged, seen) = self.whole(Some("each"), limit)?;
        let (numbers, _) = seen.as_chunks::<4>();
        let numbers = numbers.iter().map(|bytes| u32::from_le_bytes(*bytes));
        Ok((judged, numbers.collect()))
    }

    /// Runs the suite with this in the environment, and says what was written of the mutants that were come to.
    fn whole(&self, mutant: Option<&str>, limit: Duration) -> io::Result<(Judged, Vec<u8>)> {
        let mut command = Command::new(self.path);
        if let Some(mutant) = mutant {
            command.env("MUTANT", mutant);
        }
        // Another thread may run the same suite.
        let name = format!("{:?}-{}", thread::current().id(), mutant.unwrap_or("none"));
        let run = self.run(command, &name, limit, Until::FirstFailed)?;
        let judged = match failures(&run.output).next() {
            Some(by) => Judged::Failed { by: by.to_owned() },
            None if !run.in_time => Judged::Hung,
            None if !run.success => {
                let by = run.output.lines().last().unwrap_or_default().to_owned();
                Judged::Failed { by }
            }
            None => Judged::Passed,
        };
        Ok((judged, run.seen))
    }

    fn run(
        &self,
        mut command: Command,
        name: &str,
        limit: Duration,
        until: Until,
    ) -> io::Result<Run> {
        let place = self.tree.target.join("mutants");
        fs::create_dir_all(&place)?;
        let name = format!("{}-{}-{name}", self.target.package, self.target.name);
        let (printed, seen) = (place.join(&name), place.join(format!("{name}.seen")));
        let output = File::create(&printed)?;
        File::create(&seen)?;
        let mut child = command
            .current_dir(self.tree.root.join(self.target.directory()))
            .envs(build::environment())
            .env("CARGO_TARGET_DIR", &self.tree.target)
            .env("MUTANT_SEEN", &seen)
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            .process_group(0)
            .spawn()?;
        let begun = Instant::now();
        let (in_time, success) = loop {
            if let Some(status) = child.try_wait()? {
                break (true, status.success());
            }
            let late = begun.elapsed() > limit;
            let has_failed = || -> io::Result<bool> {
                let output = fs::read(&printed)?;
                Ok(failures(&String::from_utf8_lossy(&output)).next().is_some())
            };
            if late || until == Until::FirstFailed && has_failed()? {
                // With all that the test has started.
                let group = format!("-{}", child.id());
                Command::new("kill")
                    .args(["-KILL", "--", &group])
                    .status()?;
                child.wait()?;
                break (!late, false);
            }
            thread::sleep(POLL);
        };
        let run = Run {
            output: String::from_utf8_lossy(&fs::read(&printed)?).into_owned(),
            in_time,
            success,
            seen: fs::read(&seen)?,
        };
        fs::remove_file(&printed)?;
        fs::remove_file(&seen)?;
        Ok(run)
    }
}

/// The tests that failed.
fn failures(output: &str) -> impl Iterator<Item = &str> {
    output.lines().filter_map(|line| {
        let name = line.strip_prefix("test ")?;
        name.strip_suffix(" ... FAILED")
    })
}

fn passed(output: &str, test: &str) -> bool {
    output.contains(&format!("test {test} ... ok\n"))
}

/// What is wrong with a run in which each of these tests should have failed by an assertion of its own.
fn verdict(run: &Run, target: &Target, tests: &BTreeSet<String>) -> Option<String> {
    if !run.in_time {
        return Some("hangs".to_owned());
    }
    if run.seen.is_empty() {
        return Some("is never evaluated".to_owned());
    }
    for test in tests {
        if passed(&run.output, test) {
            return Some(format!("NOT CAUGHT by {test}"));
        }
        if !fails_by_itself(&run.output, target, test) {
            return Some(format!("{test} fails by no assertion of the test"));
        }
    }
    None
}

/// Whether the test's thread panicked in the test's source.
fn fails_by_itself(output: &str, target: &Target, test: &str) -> bool {
    let sources = match target.kind {
        "lib" => "src",
        "test" => "tests",
        _ => "examples",
    };
    let directory = Path::new(target.directory()).join(sources);
    let thread = format!("thread '{test}' ");
    let place = format!("panicked at {}/", directory.display());
    output
        .lines()
        .any(|line| line.starts_with(&thread) && line.contains(&place))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(output: &str, in_time: bool, evaluated: bool) -> Option<String> {
        let run = Run {
            output: output.to_owned(),
            in_time,
            success: false,
            seen: vec![b'x'; usize::from(evaluated)],
        };
        let target = Target {
            package: "servocrab".to_owned(),
            kind: "test",
            name: "moves".to_owned(),
        };
        verdict(&run, &target, &BTreeSet::from(["a::b".to_owned()]))
    }

    #[test]
    fn caught_is_what_fails_by_an_assertion_of_its_test() {
        let assertion =
            "thread 'a::b' (12) panicked at tests/moves.rs:1:2:\nfalse\ntest a::b ... FAILED\n";
        assert_eq!(judged(assertion, true, true), None);
        let inside =
            "thread 'a::b' (12) panicked at src/axis.rs:1:2:\nfalse\ntest a::b ... FAILED\n";
        assert_eq!(
            judged(inside, true, true).as_deref(),
            Some("a::b fails by no assertion of the test")
        );
        let other =
            "thread 'a::c' (12) panicked at tests/moves.rs:1:2:\nfalse\ntest a::b ... FAILED\n";
        assert!(judged(other, true, true).is_some());
        assert_eq!(
            judged("test a::b ... ok\n", true, true).as_deref(),
            Some("NOT CAUGHT by a::b")
        );
    }

    #[test]
    fn a_test_that_hangs_or_never_comes_to_the_mutant_has_not_caught_it() {
        let assertion =
            "thread 'a::b' (12) panicked at tests/moves.rs:1:2:\nfalse\ntest a::b ... FAILED\n";
        assert_eq!(judged(assertion, false, true).as_deref(), Some("hangs"));
        assert_eq!(
            judged(assertion, true, false).as_deref(),
            Some("is never evaluated")
        );
    }
}
