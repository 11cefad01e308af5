//! The programs of this suite: made when they are missing or out of date, and kept in the target directory.
//!
//! What cannot be made is said, and its tests pass without having run; when `CI=true` they fail.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

use servocrab_sim::personality;

use crate::{
    namespace::{INSIDE, say},
    python::{self, succeed},
};

/// Where this suite's files are.
pub(crate) fn sources() -> PathBuf {
    root().join("tests/interop")
}

/// What each drive should answer.
pub(crate) fn table() -> PathBuf {
    sources().join("drives.json")
}

/// What a drive's dictionary has: a file of a row for each object and each of its subindices, written from the simulated drive
/// itself, not from its answers.
pub(crate) fn dictionary(drive: &str) -> PathBuf {
    let place = target().join("interop/dictionaries");
    let file = place.join(drive).with_extension("txt");
    if made_already() {
        return file;
    }
    let mut device = match drive {
        "akd2g" => personality::akd2g(),
        "pp2010" => personality::pp2010(),
        "ax2000" => personality::ax2000(),
        "sigma7" => personality::sigma7(),
        "generic" => personality::generic(),
        other => panic!("no drive {other}"),
    };
    let mut rows = String::new();
    for object in device.dictionary() {
        let (index, kind, code) = (object.index, object.data_type, object.code);
        rows += &format!("{index}|{kind}|{code}|{}|{}\n", object.last, object.name);
        for entry in object.entries {
            let (subindex, kind, bits) = (entry.subindex, entry.data_type, entry.bits);
            rows += &format!(
                "{index}:{subindex}|{kind}|{bits}|{}|{}\n",
                entry.access, entry.name
            );
        }
    }
    fs::create_dir_all(&place).expect("the target directory can be written");
    fs::write(&file, rows).expect("the target directory can be written");
    file
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Where this test's build goes: `target/PROFILE`.
fn profile() -> PathBuf {
    let test = env::current_exe().expect("this test has a path");
    test.ancestors()
        .nth(2)
        .expect("target/PROFILE/deps/TEST")
        .to_owned()
}

/// `target`.
fn target() -> PathBuf {
    profile().parent().expect("target/PROFILE").to_owned()
}

/// Inside the namespace there is no network, and all is made already.
fn made_already() -> bool {
    env::var_os(INSIDE).is_some()
}

/// The simulated segment's program, built from the sources as they are now.
pub(crate) fn simulator() -> PathBuf {
    static BUILT: OnceLock<()> = OnceLock::new();
    BUILT.get_or_init(|| {
        if !made_already() {
            build(&root().join("sim/Cargo.toml"), &target())
                .unwrap_or_else(|error| panic!("{error}"));
        }
    });
    profile().join("servocrab-sim")
}

/// The program that runs etherage, with the versions of its own lock file.
pub(crate) fn etherage() -> Option<PathBuf> {
    static MADE: OnceLock<Made> = OnceLock::new();
    let make = || {
        let target = target().join("interop/etherage");
        if !made_already() {
            build(&sources().join("etherage/Cargo.toml"), &target)?;
        }
        let profile = profile();
        let directory = profile.file_name().ok_or("the profile has a name")?;
        Ok(target.join(directory).join("servocrab-interop-etherage"))
    };
    given("etherage", MADE.get_or_init(make))
}

/// A Python that has what `requirements.txt` pins, in an environment of its own.
pub(crate) fn python() -> Option<PathBuf> {
    static MADE: OnceLock<Made> = OnceLock::new();
    given("SOEM", MADE.get_or_init(environment))
}

/// A program, or why it could not be made.
type Made = Result<PathBuf, String>;

fn given(master: &str, made: &Made) -> Option<PathBuf> {
    if let Err(error) = made {
        let message = format!("SKIPPED: {master} cannot be had here: {error}");
        assert_ne!(
            env::var("CI").as_deref(),
            Ok("true"),
            "{message}; in CI that is a failure"
        );
        say(&message);
    }
    made.clone().ok()
}

/// Keeps what a program said, for whoever wants to see the checks by name.
pub(crate) fn report(name: &str, lines: &[String]) {
    let place = target().join("interop/reports");
    fs::create_dir_all(&place).expect("the target directory can be written");
    fs::write(
        place.join(name).with_extension("txt"),
        lines.join("\n") + "\n",
    )
    .expect("the target directory can be written");
}

/// Builds a package with the profile of this test.
fn build(manifest: &Path, target: &Path) -> Result<(), String> {
    let mut cargo = Command::new(env!("CARGO"));
    cargo
        .args(["build", "--quiet", "--locked", "--manifest-path"])
        .arg(manifest)
        .arg("--target-dir")
        .arg(target);
    if profile().ends_with("release") {
        cargo.arg("--release");
    }
    succeed(&mut cargo)
}

fn environment() -> Made {
    let place = target().join("interop/soem");
    if made_already() {
        return Ok(place.join("bin/python"));
    }
    python::environment(&place, &sources().join("soem/requirements.txt"), "pysoem")
}
