//! The searches that are longer than a run of all tests may be: the oracle within its fault model and beyond, the model check.

use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

/// Searches with new seeds for what breaks a law: the oracle, the model check.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Two minutes in all; without it the oracle lives through 10⁹ axis-cycles within its model, and a tenth of that beyond.
    #[arg(long)]
    quick: bool,
    /// The first seed; without it a new one, which is printed.
    #[arg(long)]
    seed: Option<u64>,
    /// Takes a first seed that belongs to this text, such as the name of a commit.
    #[arg(long, conflicts_with = "seed")]
    seed_of: Option<String>,
    /// Axis-cycles of the oracle within its model.
    #[arg(long)]
    cycles: Option<u64>,
}

/// One test target, and what its environment says.
struct Part {
    target: &'static str,
    /// Tests with this in their names.
    tests: &'static str,
    environment: Vec<(&'static str, String)>,
}

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    let seed = match (args.seed, &args.seed_of) {
        (Some(seed), _) => seed,
        (None, Some(text)) => apart(
            text.bytes()
                .fold(0, |number, byte| (number * 257 + u64::from(byte)) % APART),
        ),
        (None, None) => apart(milliseconds()),
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    println!("seed {seed}, {threads} processors");
    let mut parts = Vec::new();
    for (side, part, seconds) in [("inside", 1, 40), ("outside", 10, 10)] {
        let cycles = args.cycles.unwrap_or(FULL) / part;
        let mut environment = vec![
            ("ORACLE_SIDE", side.to_owned()),
            ("ORACLE_FROM", seed.to_string()),
            ("ORACLE_CYCLES", cycles.to_string()),
            ("ORACLE_THREADS", threads.to_string()),
            ("ORACLE_KEEP", "20".to_owned()),
            ("ORACLE_PROGRESS", "1".to_owned()),
        ];
        if args.cycles.is_none() && args.quick {
            environment.push(("ORACLE_SECONDS", seconds.to_string()));
        } else if cycles >= FULL {
            environment.push(("ORACLE_HITS", "1000".to_owned()));
        }
        parts.push(Part {
            target: "oracle",
            tests: "the_laws_hold",
            environment,
        });
    }
    // The sizes whose numbers of states are counted.
    parts.push(Part {
        target: "model",
        tests: "every_state_is_sound",
        environment: vec![("MODEL_EVERY_WORLD", "1".to_owned())],
    });
    // Commands and deviations under way at most, of so many kinds, and the seconds that all worlds of this size may take.
    let sizes: &[(u32, u32, u32, u32)] = if args.quick {
        &[(1, 2, 1, 30)]
    } else {
        &[(2, 0, 1, 7200), (1, 2, 1, 7200), (1, 2, 2, 7200)]
    };
    for (commands, deviations, kinds, seconds) in sizes {
        let mut environment = vec![
            ("MODEL_COMMANDS", commands.to_string()),
            ("MODEL_DEVIATIONS", deviations.to_string()),
            ("MODEL_TOGETHER", kinds.to_string()),
            ("MODEL_SECONDS", seconds.to_string()),
            ("MODEL_FIRST", (seed / 1_000_000).to_string()),
            ("MODEL_THREADS", threads.to_string()),
            ("MODEL_PROGRESS", "1".to_owned()),
        ];
        if !args.quick {
            environment.push(("MODEL_WHOLE", "1".to_owned()));
        }
        parts.push(Part {
            target: "model",
            tests: "every_state_of_the_size",
            environment,
        });
    }
    let mut failed = Vec::new();
    for part in &parts {
        println!("\n=== {} {}", part.target, part.tests);
        if !test(part)? {
            failed.push(part.target);
        }
    }
    if failed.is_empty() {
        Ok(())
    } else {
        Err(format!("{} failed; --seed {seed} repeats it", failed.join(", ")).into())
    }
}

fn test(part: &Part) -> crate::Result<bool> {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(crate::root()).args([
        "test",
        "--quiet",
        "--release",
        "--test",
        part.target,
        part.tests,
        "--",
        "--include-ignored",
        "--nocapture",
    ]);
    cargo.envs(part.environment.iter().map(|(name, value)| (name, value)));
    Ok(cargo.status()?.success())
}

/// Axis-cycles of a full run within the model, of which each habit has to show a thousand times.
const FULL: u64 = 1_000_000_000;

/// First seeds that can be told apart: their scenarios do not overlap.
const APART: u64 = 1_000_000_000;

/// The first seed with this number, behind those of every test run.
const fn apart(number: u64) -> u64 {
    (1 + number % APART) * 1_000_000
}

/// The time, of which each run has its own.
fn milliseconds() -> u64 {
    let now = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    now.as_millis() as u64
}
