//! The present library beside an earlier commit of it: what its axis cores do, and what its benches measure.

mod bench;
mod twin;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Compares the present library with an earlier commit of it: what its axis cores do, and what its benches measure.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    part: Part,
}

#[derive(clap::Subcommand)]
enum Part {
    Twin(twin::Args),
    Bench(bench::Args),
}

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    match &args.part {
        Part::Twin(args) => twin::run(args),
        Part::Bench(args) => bench::run(args),
    }
}

/// Where both parts work.
fn place() -> PathBuf {
    crate::root().join("target/before")
}

/// The full name of a commit of this repository.
fn full_name(revision: &str) -> crate::Result<String> {
    let output = Command::new("git")
        .args(["rev-parse", "--verify", "--quiet", "--end-of-options"])
        .arg(format!("{revision}^{{commit}}"))
        .current_dir(crate::root())
        .output()?;
    if output.status.success() {
        return Ok(String::from_utf8(output.stdout)?.trim().to_owned());
    }
    Err(format!(
        "there is no commit {revision} here. In a shallow clone `git fetch --unshallow` brings the whole history"
    )
    .into())
}

/// Makes this directory the tree of a commit, or these paths of it. What is there of that commit already stays.
fn extract(commit: &str, paths: &[&str], to: &Path) -> crate::Result<()> {
    let name = to.with_extension("commit");
    if to.is_dir() && fs::read_to_string(&name).is_ok_and(|there| there == commit) {
        return Ok(());
    }
    if to.exists() {
        fs::remove_dir_all(to)?;
    }
    fs::create_dir_all(to)?;
    let mut archive = Command::new("git")
        .args(["archive", commit])
        .args(paths)
        .current_dir(crate::root())
        .stdout(Stdio::piped())
        .spawn()?;
    let packed = archive.stdout.take().ok_or("git has no output")?;
    // Files are as old as this moment: cargo compares them with what it has built of another commit.
    let unpacked = Command::new("tar")
        .args(["-x", "-m", "-C"])
        .arg(to)
        .stdin(packed)
        .status()?;
    if !(archive.wait()?.success() && unpacked.success()) {
        return Err(format!("commit {commit} cannot be extracted").into());
    }
    fs::write(name, commit)?;
    Ok(())
}

/// Cargo as a user runs it: with nothing in the environment that changes what it builds.
fn cargo(tree: &Path, target: &Path) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    for (name, _) in std::env::vars_os() {
        let text = name.to_string_lossy();
        if text.starts_with("CARGO_PROFILE_")
            || text.starts_with("CARGO_BUILD_")
            || ["CARGO_INCREMENTAL", "RUSTFLAGS", "CARGO_ENCODED_RUSTFLAGS"].contains(&&*text)
        {
            command.env_remove(&name);
        }
    }
    command.current_dir(tree).env("CARGO_TARGET_DIR", target);
    command
}
