//! The benches of an earlier commit and the present ones in one run, in turns.

use std::collections::BTreeMap;
use std::fs;
use std::num::NonZero;
use std::path::PathBuf;
use std::time::Instant;

use serde_json::Value;

use super::{cargo, extract, full_name, place};

/// The last one before the axis core was rebuilt.
const COMMIT: &str = "5e4be26f0c5ee373c0d31b4710f64def779f44fc";

/// A bench, and what is compared of the rows that it writes.
struct Bench {
    name: &'static str,
    /// What tells rows apart.
    key: &'static [&'static str],
    values: &'static [&'static str],
    /// The column of the master, where only this library's rows are compared.
    master: Option<&'static str>,
}

const BENCHES: [Bench; 3] = [
    Bench {
        name: "step",
        key: &["phase", "axes"],
        values: &["per_cycle"],
        master: None,
    },
    Bench {
        name: "cycle",
        key: &["who", "axes", "mode"],
        values: &["p50_us", "cpu_us"],
        master: Some("who"),
    },
    Bench {
        name: "bring_up",
        key: &["master", "drives", "sii_ms", "mailbox_ms"],
        values: &["median_ms"],
        master: Some("master"),
    },
];

/// Runs the benches of an earlier commit and the present ones in turns, and fails where the present ones are worse.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// step, cycle, bring_up; all of them without one.
    benches: Vec<String>,
    /// The earlier commit.
    #[arg(long, default_value = COMMIT)]
    commit: String,
    /// Rounds of both, in turns: old, new, new, old. `step` counts instructions and has two.
    #[arg(long, default_value = "5")]
    rounds: NonZero<usize>,
    /// What `cycle` is given in each round: masters, numbers of axes and modes.
    #[arg(long, default_value = "servocrab-block servocrab-spin fast 1 64")]
    cycle: String,
}

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    if let Some(unknown) = args
        .benches
        .iter()
        .find(|name| !BENCHES.iter().any(|bench| bench.name == **name))
    {
        return Err(format!("there is no bench {unknown}").into());
    }
    let commit = full_name(&args.commit)?;
    let place = place().join("bench");
    let old = Side {
        name: "old",
        tree: place.join("old/tree"),
        target: place.join("old/target"),
    };
    let new = Side {
        name: "new",
        tree: crate::root().to_owned(),
        target: place.join("new/target"),
    };
    extract(&commit, &[], &old.tree)?;
    let named = |bench: &&Bench| {
        args.benches.is_empty() || args.benches.iter().any(|name| name == bench.name)
    };
    let benches: Vec<&Bench> = BENCHES.iter().filter(named).collect();
    for side in [&old, &new] {
        side.build(&benches)?;
    }
    println!("old: {commit}; new: the present tree");
    let mut worse = Vec::new();
    for bench in benches {
        let arguments: Vec<&str> = match bench.name {
            "cycle" => args.cycle.split_whitespace().collect(),
            _ => Vec::new(),
        };
        let rounds = match bench.name {
            "step" => 2,
            _ => args.rounds.get(),
        };
        let mut measured = Measured::default();
        for round in 0..rounds {
            let turns = if round % 2 == 0 {
                [(&old, 0), (&new, 1)]
            } else {
                [(&new, 1), (&old, 0)]
            };
            for (side, place) in turns {
                let begun = Instant::now();
                measured.add(bench, place, &side.run(bench, &arguments)?);
                println!(
                    "{}, round {} of {rounds}, {}: {:.0} s",
                    bench.name,
                    round + 1,
                    side.name,
                    begun.elapsed().as_secs_f64()
                );
            }
        }
        worse.extend(measured.print(bench));
    }
    println!(
        "A row is worse where the median of new/old is above the largest old value divided by the median of the old ones, in this run."
    );
    if worse.is_empty() {
        println!("None is worse.");
        return Ok(());
    }
    Err(format!("worse than before:\n  {}", worse.join("\n  ")).into())
}

/// One of the two trees.
struct Side {
    name: &'static str,
    tree: PathBuf,
    target: PathBuf,
}

impl Side {
    fn build(&self, benches: &[&Bench]) -> crate::Result<()> {
        println!("building {}", self.name);
        let mut cargo = cargo(&self.tree, &self.target);
        cargo.args(["bench", "--quiet", "--no-run"]);
        cargo.args(benches.iter().flat_map(|bench| ["--bench", bench.name]));
        if cargo.status()?.success() {
            Ok(())
        } else {
            Err(format!("the benches of {} do not build", self.tree.display()).into())
        }
    }

    /// The rows of one run. The bench's own verdict is not asked for.
    fn run(&self, bench: &Bench, arguments: &[&str]) -> crate::Result<Vec<Value>> {
        let written = self.target.join("bench").join(bench.name);
        let written = written.with_extension("json");
        if written.exists() {
            fs::remove_file(&written)?;
        }
        let mut cargo = cargo(&self.tree, &self.target);
        cargo.args(["bench", "--quiet", "--bench", bench.name, "--"]);
        let output = cargo.args(arguments).output()?;
        let Ok(text) = fs::read_to_string(&written) else {
            return Err(format!(
                "{} of {} has measured nothing\n{}{}",
                bench.name,
                self.name,
                String::from_utf8_lossy(&output.stdout),
                String::from_utf8_lossy(&output.stderr)
            )
            .into());
        };
        Ok(serde_json::from_str(&text)?)
    }
}

/// The values of each row, of the old ones and of the new ones, a value for each round.
#[derive(Default)]
struct Measured {
    rows: BTreeMap<(Vec<Key>, &'static str), [Vec<f64>; 2]>,
}

/// Part of what a row is named by. Numbers are in their order.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
enum Key {
    Number(u64),
    Text(String),
}

impl Key {
    fn text(&self) -> String {
        match self {
            Self::Number(number) => number.to_string(),
            Self::Text(text) => text.clone(),
        }
    }
}

impl Measured {
    fn add(&mut self, bench: &Bench, side: usize, rows: &[Value]) {
        for row in rows {
            let master = bench.master.and_then(|master| row[master].as_str());
            if master.is_some_and(|master| !master.starts_with("servocrab")) {
                continue;
            }
            for value in bench.values {
                let key = bench.key.iter().map(|name| match &row[*name] {
                    Value::String(text) => Key::Text(text.clone()),
                    number => Key::Number(number.as_u64().unwrap_or_default()),
                });
                let values = self.rows.entry((key.collect(), value)).or_default();
                values[side].extend(row[*value].as_f64());
            }
        }
    }

    /// Prints the table, and returns the rows that are worse.
    fn print(&self, bench: &Bench) -> Vec<String> {
        println!(
            "\n{:44} {:>11} {:>11} {:>9} {:>17} {:>9}",
            bench.name, "old", "new", "new/old", "lowest, highest", "old/old"
        );
        let mut worse = Vec::new();
        for ((key, value), [old, new]) in &self.rows {
            let name: Vec<_> = key.iter().map(Key::text).collect();
            let name = format!("{} {value}", name.join(" "));
            let Some(compared) = Compared::of(old, new) else {
                println!("{name:44} is not in both");
                continue;
            };
            let Compared {
                ratio,
                lowest,
                highest,
                spread,
            } = compared;
            let verdict = if compared.is_worse() { "  WORSE" } else { "" };
            println!(
                "{name:44} {:>11.1} {:>11.1} {ratio:>9.4} {lowest:>8.4} {highest:>8.4} {spread:>9.4}{verdict}",
                median(old),
                median(new),
            );
            if compared.is_worse() {
                worse.push(format!(
                    "{} {name}: {ratio:.4}, and old is up to {spread:.4} of itself",
                    bench.name
                ));
            }
        }
        println!();
        worse
    }
}

/// A row of both.
struct Compared {
    /// The median of new/old, round by round, and the bounds of these.
    ratio: f64,
    lowest: f64,
    highest: f64,
    /// The largest of the old values, by their median.
    spread: f64,
}

impl Compared {
    /// None where one of them has no such row.
    fn of(old: &[f64], new: &[f64]) -> Option<Self> {
        let ratios: Vec<f64> = old.iter().zip(new).map(|(old, new)| new / old).collect();
        if ratios.is_empty() {
            return None;
        }
        let bound = |of: fn(f64, f64) -> f64, values: &[f64]| values.iter().copied().reduce(of);
        Some(Self {
            ratio: median(&ratios),
            lowest: bound(f64::min, &ratios)?,
            highest: bound(f64::max, &ratios)?,
            spread: bound(f64::max, old)? / median(old),
        })
    }

    fn is_worse(&self) -> bool {
        self.ratio > self.spread
    }
}

fn median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() % 2 {
        1 => values[middle],
        _ if values.is_empty() => f64::NAN,
        _ => f64::midpoint(values[middle - 1], values[middle]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_worse(old: &[f64], new: &[f64]) -> bool {
        Compared::of(old, new).expect("values of both").is_worse()
    }

    #[test]
    fn of_exact_values_any_that_is_worse_counts() {
        assert!(is_worse(&[1630.0, 1630.0], &[1631.0, 1631.0]));
        assert!(!is_worse(&[1630.0, 1630.0], &[1630.0, 1630.0]));
        assert!(!is_worse(&[1630.0, 1630.0], &[1600.0, 1600.0]));
    }

    #[test]
    fn others_are_worse_above_the_spread_of_the_old_ones() {
        let old = [10.0, 10.0, 11.0];
        assert!(!is_worse(&old, &[10.5, 10.9, 11.5]));
        assert!(is_worse(&old, &[11.5, 11.5, 12.5]));
    }

    #[test]
    fn rows_are_found_again_by_their_names_and_other_masters_are_left_out() {
        let rows: Vec<Value> = serde_json::from_str(
            r#"[{"who":"servocrab-block","axes":8,"mode":"fast","p50_us":5.0,"p99_us":7.0,"cpu_us":4.0},
                {"who":"pysoem","axes":8,"mode":"fast","p50_us":9.0,"p99_us":9.0,"cpu_us":9.0}]"#,
        )
        .expect("rows");
        let mut measured = Measured::default();
        measured.add(&BENCHES[1], 0, &rows);
        measured.add(&BENCHES[1], 1, &rows);
        let values: Vec<_> = measured.rows.iter().collect();
        assert_eq!(values.len(), 2);
        assert!(
            values
                .iter()
                .all(|(_, [old, new])| old == new && old.len() == 1)
        );
        assert!(measured.print(&BENCHES[1]).is_empty());
    }
}
