//! The axis core of an earlier commit beside the present one, in all tests that step axis cores.
//!
//! `tests/before/twin.rs` is what steps and compares both; docs/decisions/0030 says why it is made so.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Deserialize;

use super::{cargo, extract, full_name, place};
use crate::files::{listed, remove_others, take_dependencies, write};

/// Since then only the places of things have changed: the core is to do the same. A change of what users call of it, or of what it does, moves
/// this commit.
const COMMIT: &str = "f0806dd8822009a98f9e720bc259ae77dbbad25d";
/// Differences that are meant.
const ACCEPTED: &str = "tests/before/accepted.toml";
/// The crate that the present one is compared with.
const CRATE: &str = "servocrab_before";

/// All suites that step axis cores: alone, behind handles, on whole networks. Not those that count allocations or wait for a real link.
const SUITES: [&str; 30] = [
    "arithmetic",
    "bad_input",
    "bases",
    "bus",
    "chains",
    "conformance",
    "emergencies",
    "enabling",
    "end_of_life",
    "found_moving",
    "halt_ignored",
    "handles",
    "held",
    "lines",
    "matrix",
    "missed_target",
    "model",
    "modes",
    "modulo",
    "motion_table",
    "moves",
    "oracle",
    "pitfalls",
    "plant",
    "quick_stop_ignored",
    "runtime_attacks",
    "scenario",
    "standstill",
    "stopped_at_the_start",
    "wrong_words",
];

/// Runs the tests with the axis core of an earlier commit beside the present one: its bytes, events and snapshots must be the same.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The test targets; all that step axis cores without one.
    suites: Vec<String>,
    /// The earlier commit.
    #[arg(long, default_value = COMMIT)]
    commit: String,
    /// Axis-cycles of the oracle, besides those of every test run.
    #[arg(long, default_value_t = 2_000_000)]
    cycles: u64,
    /// The first seed of these.
    #[arg(long, default_value_t = 1_000_000)]
    seed: u64,
}

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    let suites: Vec<&str> = if args.suites.is_empty() {
        SUITES.to_vec()
    } else {
        args.suites.iter().map(String::as_str).collect()
    };
    if let Some(unknown) = suites.iter().find(|suite| !SUITES.contains(suite)) {
        return Err(format!("{unknown} is none of {}", SUITES.join(", ")).into());
    }
    let accepted = toml::from_str(&fs::read_to_string(crate::root().join(ACCEPTED))?)?;
    let commit = full_name(&args.commit)?;
    let twin = Twin {
        tree: place().join("tree"),
        target: place().join("target"),
        report: place().join("report.txt"),
    };
    make_package(&commit, &place().join("package"))?;
    make_tree(crate::root(), &twin.tree)?;
    take_dependencies(crate::root(), &twin.target)?;
    println!("before: the axis core of {commit} beside the present one");
    twin.build(&suites)?;
    let begun = Instant::now();
    let mut judged = Judged::default();
    for suite in &suites {
        judged.add(suite, &twin.run(suite, args)?, &accepted);
    }
    let whole = suites.len() == SUITES.len();
    judged.over(&accepted, whole)?;
    println!(
        "before: no difference in {:.0} s",
        begun.elapsed().as_secs_f64()
    );
    Ok(())
}

/// The package of that commit, as another crate. What the bus calls of its core is public, nothing else is changed in its sources.
fn make_package(commit: &str, package: &Path) -> crate::Result<()> {
    let sources = place().join("sources");
    extract(commit, &["src", "Cargo.toml"], &sources)?;
    let mut files = BTreeSet::new();
    let mut directories = vec![PathBuf::from("src")];
    while let Some(directory) = directories.pop() {
        for entry in fs::read_dir(sources.join(&directory))? {
            let name = directory.join(entry?.file_name());
            let source = sources.join(&name);
            if source.is_dir() {
                directories.push(name);
                continue;
            }
            let mut content = fs::read(&source)?;
            if name.starts_with("src/axis") {
                let text = String::from_utf8(content)?;
                content = text.replace("pub(crate)", "pub").into_bytes();
            }
            write(&package.join(&name), &content)?;
            files.insert(package.join(name));
        }
    }
    let manifest = fs::read_to_string(sources.join("Cargo.toml"))?;
    write(
        &package.join("Cargo.toml"),
        package_manifest(&manifest)?.as_bytes(),
    )?;
    files.insert(package.join("Cargo.toml"));
    remove_others(package, &files)?;
    Ok(())
}

/// The manifest of a package of its own, of the library alone.
fn package_manifest(manifest: &str) -> crate::Result<String> {
    let mut whole: toml::Table = manifest.parse()?;
    let of_workspace = whole
        .get("workspace")
        .and_then(|workspace| workspace.get("package"));
    let edition = of_workspace.and_then(|package| package.get("edition"));
    let edition = edition.ok_or("the workspace names no edition")?.clone();
    let mut package = toml::Table::new();
    package.insert("name".into(), CRATE.into());
    package.insert("version".into(), "0.0.0".into());
    package.insert("edition".into(), edition);
    let mut alone = toml::Table::new();
    alone.insert("package".into(), package.into());
    alone.insert("workspace".into(), toml::Table::new().into());
    // Its tests are not built, and what only they use is not used.
    let lints: toml::Table = "rust.unused = 'allow'".parse()?;
    alone.insert("lints".into(), lints.into());
    for part in ["features", "dependencies"] {
        let part_of = whole.remove(part);
        alone.insert(
            part.into(),
            part_of.ok_or("the manifest is not the package's")?,
        );
    }
    Ok(toml::to_string(&alone)?)
}

/// The present tree, in which everything steps the twin in place of the axis core.
fn make_tree(root: &Path, tree: &Path) -> crate::Result<()> {
    let mut files = BTreeSet::from([tree.join("Cargo.lock")]);
    let twin = fs::read(root.join("tests/before/twin.rs"))?;
    write(&tree.join("src/axis/twin.rs"), &twin)?;
    files.insert(tree.join("src/axis/twin.rs"));
    for name in &listed(root)? {
        let source = root.join(name);
        if !source.is_file() {
            continue;
        }
        let content = match name.as_str() {
            "Cargo.toml" => tree_manifest(&fs::read_to_string(&source)?)?.into_bytes(),
            "src/axis/mod.rs" => with_twin(&fs::read_to_string(&source)?)?.into_bytes(),
            // Cargo adds the other crate to it.
            "Cargo.lock" if tree.join(name).exists() => continue,
            _ => fs::read(&source)?,
        };
        write(&tree.join(name), &content)?;
        files.insert(tree.join(name));
    }
    remove_others(tree, &files)?;
    Ok(())
}

fn with_twin(module: &str) -> crate::Result<String> {
    const CORE: &str = "pub use self::core::AxisCore;";
    if module.matches(CORE).count() != 1 {
        return Err(format!("src/axis/mod.rs has not once `{CORE}`").into());
    }
    Ok(module.replace(CORE, "mod twin;\npub use self::twin::AxisCore;"))
}

fn tree_manifest(manifest: &str) -> crate::Result<String> {
    let mut whole: toml::Table = manifest.parse()?;
    let mut dependency = toml::Table::new();
    dependency.insert("path".into(), "../package".into());
    dependency.insert("default-features".into(), false.into());
    table(&mut whole, &["dependencies"])?.insert(CRATE.into(), dependency.into());
    let std = table(&mut whole, &["features"])?.get_mut("std");
    let std = std.and_then(toml::Value::as_array_mut);
    std.ok_or("the manifest has no feature std")?
        .push(format!("{CRATE}/std").into());
    // What the twin leaves out of the present core is not used.
    table(&mut whole, &["workspace", "lints", "rust"])?.insert("unused".into(), "allow".into());
    // Both cores are built alike.
    let mut profile = toml::Table::new();
    profile.insert("opt-level".into(), 1.into());
    table(&mut whole, &["profile", "dev", "package"])?.insert(CRATE.into(), profile.into());
    Ok(toml::to_string(&whole)?)
}

fn table<'a>(whole: &'a mut toml::Table, path: &[&str]) -> crate::Result<&'a mut toml::Table> {
    path.iter().try_fold(whole, |table, name| {
        let inner = table.get_mut(*name).and_then(toml::Value::as_table_mut);
        inner.ok_or_else(|| format!("the manifest has no [{}]", path.join(".")).into())
    })
}

/// Where the tree is, and where its tests write.
struct Twin {
    tree: PathBuf,
    target: PathBuf,
    report: PathBuf,
}

/// What came of the tests of a suite.
struct Tested {
    passed: bool,
    output: String,
    /// What the twins have written.
    report: String,
    seconds: f64,
}

impl Twin {
    fn build(&self, suites: &[&str]) -> crate::Result<()> {
        let begun = Instant::now();
        let mut cargo = cargo(&self.tree, &self.target);
        cargo.env("CARGO_PROFILE_DEV_DEBUG", "0");
        cargo.args(["test", "--quiet", "--no-run"]);
        cargo.args(suites.iter().flat_map(|suite| ["--test", suite]));
        if !cargo.status()?.success() {
            return Err(
                "the tree does not build: tests/before/twin.rs has to fit both commits".into(),
            );
        }
        println!(
            "before: {} suites built in {:.0} s\n",
            suites.len(),
            begun.elapsed().as_secs_f64()
        );
        Ok(())
    }

    fn run(&self, suite: &str, args: &Args) -> crate::Result<Tested> {
        if self.report.exists() {
            fs::remove_file(&self.report)?;
        }
        let mut cargo = cargo(&self.tree, &self.target);
        cargo.env("CARGO_PROFILE_DEV_DEBUG", "0");
        cargo.args(["test", "--quiet", "--test", suite]);
        if suite == "oracle" {
            cargo.args(["--", "--include-ignored"]);
            cargo.env("ORACLE_FROM", args.seed.to_string());
            cargo.env("ORACLE_CYCLES", args.cycles.to_string());
        }
        let begun = Instant::now();
        let output = cargo.env("SERVOCRAB_BEFORE", &self.report).output()?;
        let text = [output.stdout, output.stderr].concat();
        Ok(Tested {
            passed: output.status.success(),
            output: String::from_utf8_lossy(&text).into_owned(),
            report: fs::read_to_string(&self.report).unwrap_or_default(),
            seconds: begun.elapsed().as_secs_f64(),
        })
    }
}

/// Differences that are meant, and why.
#[derive(Deserialize, Default)]
struct Accepted {
    #[serde(default)]
    accepted: Vec<Row>,
}

/// One kind of them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    /// How the suite and the test begin: `oracle`, or `handles stops::a_stop`.
    test: String,
    /// How the first line of the difference begins.
    difference: String,
    #[expect(dead_code, reason = "for who reads the file")]
    reason: String,
}

impl Row {
    fn covers(&self, difference: &Difference<'_>) -> bool {
        let test = format!("{} {}", difference.suite, difference.thread);
        test.starts_with(&self.test) && difference.kind().starts_with(&self.difference)
    }
}

/// The first difference of a core.
struct Difference<'a> {
    suite: &'a str,
    /// The test, where it stepped the core itself.
    thread: &'a str,
    text: &'a str,
}

impl Difference<'_> {
    /// Its first line: what differs, without what it carries.
    fn kind(&self) -> &str {
        self.text.split("\\n").next().unwrap_or(self.text)
    }
}

impl fmt::Display for Difference<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.suite, self.thread)?;
        for line in self.text.split("\\n") {
            write!(f, "\n  {line}")?;
        }
        Ok(())
    }
}

/// What has been compared, and what came of it.
#[derive(Default)]
struct Judged {
    faults: Vec<String>,
    /// The rows that were needed.
    used: BTreeSet<usize>,
}

impl Judged {
    fn add(&mut self, suite: &str, tested: &Tested, accepted: &Accepted) {
        let (mut compared, mut differences) = ([0_u64; 3], Vec::new());
        for line in tested.report.lines() {
            match line.split('\t').collect::<Vec<_>>()[..] {
                ["compared", _, _, cores, calls, events] => {
                    for (sum, more) in compared.iter_mut().zip([cores, calls, events]) {
                        *sum += more.parse::<u64>().unwrap_or(0);
                    }
                }
                ["differs", suite, thread, text] => differences.push(Difference {
                    suite,
                    thread,
                    text,
                }),
                _ => self
                    .faults
                    .push(format!("{suite}: no line of a report: {line}")),
            }
        }
        let [cores, calls, events] = compared;
        println!(
            "{suite:22} {cores:>8} cores {calls:>11} calls {events:>9} events {:>6} differences {:>6.1} s",
            differences.len(),
            tested.seconds
        );
        if calls == 0 {
            self.faults.push(format!("{suite} compares nothing"));
        }
        if !tested.passed {
            println!("{}", tested.output);
            self.faults.push(format!("{suite}: tests fail"));
        }
        // Of those that are alike the first one is told.
        let mut alike: BTreeMap<(&str, &str), (usize, &Difference<'_>)> = BTreeMap::new();
        for difference in &differences {
            let rows = accepted.accepted.iter().enumerate();
            let covering = rows.filter(|(_, row)| row.covers(difference));
            let covering: Vec<_> = covering.map(|(number, _)| number).collect();
            if covering.is_empty() {
                let key = (difference.thread, difference.kind());
                alike.entry(key).or_insert((0, difference)).0 += 1;
            }
            self.used.extend(covering);
        }
        for (times, difference) in alike.values() {
            println!("{difference}\n  {times} cores in all\n");
            self.faults.push(format!(
                "{suite} {}: {}",
                difference.thread,
                difference.kind()
            ));
        }
    }

    /// `whole`: all suites have run, so that each row must have been needed.
    fn over(&self, accepted: &Accepted, whole: bool) -> crate::Result<()> {
        let mut faults = self.faults.clone();
        for (number, row) in accepted.accepted.iter().enumerate() {
            if whole && !self.used.contains(&number) {
                let Row {
                    test, difference, ..
                } = row;
                faults.push(format!(
                    "{ACCEPTED}: no difference is `{test}`, `{difference}` any more"
                ));
            }
        }
        println!();
        for fault in &faults {
            println!("before: {fault}");
        }
        match faults.len() {
            0 => Ok(()),
            1 => Err("one fault".into()),
            faults => Err(format!("{faults} faults").into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_twin_takes_the_place_of_the_core_in_the_tree_as_it_is() {
        let module = std::fs::read_to_string(crate::root().join("src/axis/mod.rs")).unwrap();
        let module = with_twin(&module).unwrap();
        assert!(module.contains("mod twin;") && !module.contains("core::AxisCore;"));
    }

    const COMPARED: &str = "compared\tmoves\ta_move\t1\t20\t2\n";
    const DIFFERS: &str =
        "differs\tmoves\ta_move\tevent Done(Ok(Reached)), before none\\nfirst difference\n";

    fn tested(report: &str, passed: bool) -> Tested {
        Tested {
            passed,
            output: String::new(),
            report: report.to_owned(),
            seconds: 0.0,
        }
    }

    fn judge(tested: &Tested, accepted: &str, whole: bool) -> std::result::Result<(), String> {
        let accepted = toml::from_str(accepted).expect("a table");
        let mut judged = Judged::default();
        judged.add("moves", tested, &accepted);
        let over = judged.over(&accepted, whole);
        over.map_err(|_| judged.faults.join("; "))
    }

    fn row(test: &str, difference: &str) -> String {
        format!("[[accepted]]\ntest = '{test}'\ndifference = '{difference}'\nreason = 'meant'\n")
    }

    #[test]
    fn cores_that_do_the_same_are_no_fault() {
        assert_eq!(judge(&tested(COMPARED, true), "", true), Ok(()));
    }

    #[test]
    fn a_difference_is_a_fault_and_names_its_test() {
        let report = format!("{DIFFERS}{COMPARED}");
        let fault = judge(&tested(&report, true), "", true).expect_err("a fault");
        assert_eq!(fault, "moves a_move: event Done(Ok(Reached)), before none");
    }

    #[test]
    fn an_accepted_difference_is_none() {
        let report = format!("{DIFFERS}{COMPARED}");
        for test in ["moves", "moves a_"] {
            let row = row(test, "event Done(Ok(Reached)), before none");
            assert_eq!(judge(&tested(&report, true), &row, true), Ok(()), "{test}");
        }
        for (test, difference) in [
            ("chains", "event"),
            ("moves b", "event"),
            ("moves", "outputs"),
        ] {
            let row = row(test, difference);
            assert!(judge(&tested(&report, true), &row, false).is_err(), "{row}");
        }
    }

    #[test]
    fn an_accepted_difference_that_there_is_no_more_is_a_fault() {
        let row = row("moves", "event");
        assert!(judge(&tested(COMPARED, true), &row, true).is_err());
        // With some suites alone it may be in another.
        assert_eq!(judge(&tested(COMPARED, true), &row, false), Ok(()));
    }

    #[test]
    fn a_suite_that_fails_or_compares_nothing_is_a_fault() {
        assert!(judge(&tested(COMPARED, false), "", true).is_err());
        assert!(judge(&tested("", true), "", true).is_err());
    }
}
