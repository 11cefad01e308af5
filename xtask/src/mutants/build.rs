//! Builds the tests of the rewritten tree.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use serde::Deserialize;

use super::table::Target;
use super::tree::Tree;

/// The library and its tests are built as fast as can be: they run once for each mutant, and not for long. The simulated
/// drives, through which nearly all that time goes, keep the optimisation of the tests' profile.
const FAST: &str = "--config=profile.test.package.servocrab.opt-level=0";

/// What came of it.
pub(crate) enum Built {
    /// The executable of each target.
    Executables(BTreeMap<Target, PathBuf>),
    /// The errors, and the mutants in whose lines they are.
    Errors {
        text: String,
        mutants: BTreeSet<u32>,
    },
}

/// What cargo says in a line of JSON.
#[derive(Deserialize)]
struct Message {
    reason: String,
    executable: Option<PathBuf>,
    target: Option<Source>,
    profile: Option<Profile>,
    message: Option<Diagnostic>,
}

#[derive(Deserialize)]
struct Source {
    kind: Vec<String>,
    name: String,
}

#[derive(Deserialize)]
struct Profile {
    test: bool,
}

#[derive(Deserialize)]
struct Diagnostic {
    level: String,
    rendered: String,
    spans: Vec<Span>,
}

#[derive(Deserialize)]
struct Span {
    file_name: String,
    line_start: usize,
    is_primary: bool,
}

/// Builds the targets of one package.
pub(crate) fn build(
    tree: &Tree,
    package: &str,
    targets: &BTreeSet<&Target>,
) -> crate::Result<Built> {
    let output = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .args([
            "test",
            "--no-run",
            "--message-format=json",
            "--package",
            package,
        ])
        .arg(FAST)
        .args(targets.iter().flat_map(|target| target.arguments()))
        .current_dir(&tree.root)
        .envs(environment())
        .env("CARGO_TARGET_DIR", &tree.target)
        .stderr(Stdio::piped())
        .output()?;
    let mut executables = BTreeMap::new();
    let mut text = String::new();
    let mut mutants = BTreeSet::new();
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let Ok(message) = serde_json::from_str::<Message>(line) else {
            continue;
        };
        if let Some(error) = message.message.filter(|message| message.level == "error") {
            text.push_str(&error.rendered);
            let places = error.spans.iter().filter(|span| span.is_primary);
            mutants
                .extend(places.filter_map(|span| tree.mutant_at(&span.file_name, span.line_start)));
        }
        if message.reason == "compiler-artifact"
            && message.profile.is_some_and(|profile| profile.test)
            && let (Some(executable), Some(source)) = (message.executable, message.target)
        {
            let target = targets.iter().find(|target| match target.kind {
                "lib" => source.kind.iter().any(|kind| kind == "lib"),
                kind => source.kind.iter().any(|of| of == kind) && source.name == target.name,
            });
            if let Some(target) = target {
                executables.insert((*target).clone(), executable);
            }
        }
    }
    if output.status.success() {
        return Ok(Built::Executables(executables));
    }
    if text.is_empty() {
        text = String::from_utf8_lossy(&output.stderr).into_owned();
    }
    Ok(Built::Errors { text, mutants })
}

/// Of what cargo is run with, and the tests.
pub(crate) fn environment() -> [(&'static str, &'static str); 4] {
    [
        ("CARGO_INCREMENTAL", "1"),
        ("CARGO_PROFILE_DEV_DEBUG", "0"),
        ("CARGO_TERM_COLOR", "never"),
        ("RUST_BACKTRACE", "0"),
    ]
}
