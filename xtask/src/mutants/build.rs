//! Builds the tests of the rewritten tree.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde::Deserialize;

use super::table::Target;
use super::tree::Tree;

/// The library and its tests are built as fast as can be: they run once for each mutant, and not for long. The simulated
/// drives, through which nearly all that time goes, keep the optimisation of the tests' profile.
const FAST: &str = "--config=profile.dev.package.servocrab.opt-level=0";

/// Of a panic the place is looked at, which is known without the lines of the code.
const WITHOUT_LINES: &str = "--config=profile.dev.debug=false";

/// The crate that says which mutant is on: it has no tests.
const WITHOUT_SWITCH: [&str; 2] = ["--exclude", "mutants"];

/// What came of it.
pub(crate) enum Built {
    /// The executable of each target.
    Executables(BTreeMap<Target, PathBuf>),
    Errors {
        text: String,
        /// The mutants in whose lines they are.
        mutants: BTreeSet<u32>,
        /// Functions that are called where only a constant one can be.
        not_constant: BTreeSet<String>,
    },
}

/// What cargo says in a line of JSON.
#[derive(Deserialize)]
struct Message {
    reason: String,
    executable: Option<PathBuf>,
    manifest_path: Option<PathBuf>,
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
    message: String,
    code: Option<Code>,
    rendered: String,
    spans: Vec<Span>,
}

#[derive(Deserialize)]
struct Code {
    code: String,
}

#[derive(Deserialize)]
struct Span {
    file_name: String,
    line_start: usize,
    is_primary: bool,
}

/// Builds these targets, all with the features that `cargo test --workspace` builds them with: what it has built is taken.
pub(crate) fn build(tree: &Tree, targets: &BTreeSet<&Target>) -> crate::Result<Built> {
    let mut command = cargo(tree);
    let arguments: BTreeSet<_> = targets.iter().map(|target| target.arguments()).collect();
    command
        .args(["--workspace", FAST, WITHOUT_LINES])
        .args(WITHOUT_SWITCH)
        .args(arguments.iter().flatten());
    let mut built = run(tree, &mut command)?;
    if let Built::Executables(executables) = &mut built {
        executables.retain(|target, _| targets.contains(target));
    }
    Ok(built)
}

/// Builds all tests of the workspace but the project's own commands, or only the named ones of the library.
pub(crate) fn everything(tree: &Tree, only: &[String]) -> crate::Result<Built> {
    let mut command = cargo(tree);
    if only.is_empty() {
        command
            .args(["--workspace", "--exclude", "xtask"])
            .args(WITHOUT_SWITCH);
    } else {
        command.args(["--package", "servocrab"]);
        for suite in only {
            match suite.as_str() {
                "lib" => command.arg("--lib"),
                suite => command.args(["--test", suite]),
            };
        }
    }
    run(tree, &mut command)
}

fn cargo(tree: &Tree) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command
        .args(["test", "--no-run", "--message-format=json"])
        .current_dir(&tree.root)
        .envs(environment())
        .env("CARGO_TARGET_DIR", &tree.target)
        .stderr(Stdio::piped());
    command
}

fn run(tree: &Tree, command: &mut Command) -> crate::Result<Built> {
    let output = command.output()?;
    let mut executables = BTreeMap::new();
    let (mut text, mut mutants, mut not_constant) =
        (String::new(), BTreeSet::new(), BTreeSet::new());
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let Ok(message) = serde_json::from_str::<Message>(line) else {
            continue;
        };
        if let Some(error) = message.message.filter(|message| message.level == "error") {
            text.push_str(&error.rendered);
            let places = error.spans.iter().filter(|span| span.is_primary);
            mutants
                .extend(places.filter_map(|span| tree.mutant_at(&span.file_name, span.line_start)));
            if error.code.is_some_and(|code| code.code == "E0015") {
                not_constant.extend(called(&error.message));
            }
        }
        if message.reason == "compiler-artifact"
            && message.profile.is_some_and(|profile| profile.test)
            && let (Some(executable), Some(source), Some(manifest)) =
                (message.executable, message.target, message.manifest_path)
        {
            let kind = ["lib", "test", "example", "bin"]
                .into_iter()
                .find(|kind| source.kind.iter().any(|of| of == kind))
                .unwrap_or("test");
            let target = Target {
                package: package(&manifest),
                kind,
                // A package has one library.
                name: if kind == "lib" {
                    String::new()
                } else {
                    source.name
                },
            };
            executables.insert(target, executable);
        }
    }
    if output.status.success() {
        return Ok(Built::Executables(executables));
    }
    if text.is_empty() {
        text = String::from_utf8_lossy(&output.stderr).into_owned();
    }
    Ok(Built::Errors {
        text,
        mutants,
        not_constant,
    })
}

/// The name of the function in "cannot call non-const associated function `Words::<u8>::of::<u8>` in constants".
fn called(message: &str) -> Option<String> {
    let path = message.split('`').nth(1)?;
    let mut depth = 0;
    let mut plain = path.to_owned();
    plain.retain(|letter| {
        depth += i32::from(letter == '<');
        let is_outside = depth == 0;
        depth -= i32::from(letter == '>');
        is_outside
    });
    plain
        .rsplit("::")
        .find(|part| !part.is_empty())
        .map(str::to_owned)
}

/// The package of a manifest of the workspace, by its directory.
fn package(manifest: &Path) -> String {
    let directory = manifest.parent().and_then(Path::file_name);
    let of = match directory.and_then(|name| name.to_str()) {
        Some("sim") => "servocrab-sim",
        Some("attach") => "servocrab-attach",
        Some("tools") => "servocrab-cli",
        _ => "servocrab",
    };
    of.to_owned()
}

/// Of what cargo is run with, and the tests.
pub(crate) fn environment() -> [(&'static str, &'static str); 2] {
    [("CARGO_TERM_COLOR", "never"), ("RUST_BACKTRACE", "0")]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_function_that_is_called_is_named_without_its_types() {
        for path in [
            "of",
            "Words::of",
            "Words::<u8>::of",
            "Words::of::<a::B<u8>>",
        ] {
            let message = format!("cannot call non-const method `{path}` in constants");
            assert_eq!(called(&message).as_deref(), Some("of"), "{path}");
        }
    }
}
