//! The programs of this suite: made when they are missing or out of date, and kept in the target directory.
//!
//! What cannot be made is said, and its tests pass without having run; when `CI=true` they fail.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

use servocrab_sim::{Device, personality};

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
    let mut device = device(drive);
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

/// A simulated device by the name that `servocrab-sim --drive` takes.
pub(crate) fn device(name: &str) -> Device {
    match name {
        "akd2g" => personality::akd2g(),
        "pp2010" => personality::pp2010(),
        "ax2000" => personality::ax2000(),
        "sigma7" => personality::sigma7(),
        "generic" => personality::generic(),
        "coupler" => personality::coupler(),
        "io" => personality::io_terminal(),
        other => panic!("no device {other}"),
    }
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

/// The directory of SOEM's own programs: `slaveinfo`, `eepromtool`, `simple_ng`.
pub(crate) fn soem_tools() -> Option<PathBuf> {
    static MADE: OnceLock<Made> = OnceLock::new();
    given("SOEM's tools", MADE.get_or_init(build_soem_tools))
}

/// ethercrab's example of this name.
pub(crate) fn sdo_info() -> Option<PathBuf> {
    static MADE: OnceLock<Made> = OnceLock::new();
    given("ethercrab's sdo-info", MADE.get_or_init(build_sdo_info))
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

/// From the sources that pysoem is made of, in which its authors' programs are.
fn build_soem_tools() -> Made {
    let place = target().join("interop/soem-tools");
    if made_already() {
        return Ok(place);
    }
    let soem = sources().join("soem");
    let requirements = soem.join("requirements.txt");
    let read = |path: &Path| fs::read_to_string(path).map_err(|error| error.to_string());
    // Written last, so that a directory that has it is whole.
    let stamp = place.join("built.txt");
    let wanted = read(&requirements)? + &read(&soem.join("soem_config.h"))?;
    if fs::read_to_string(&stamp).is_ok_and(|built| built == wanted) {
        return Ok(place);
    }
    let python = environment()?;
    if place.exists() {
        fs::remove_dir_all(&place).map_err(|error| error.to_string())?;
    }
    succeed(
        Command::new(&python)
            .args(["-m", "pip", "download", "--quiet", "--retries", "2"])
            .args(["--no-binary", "pysoem", "--no-build-isolation"])
            .args(["--no-deps", "--require-hashes", "--requirement"])
            .arg(&requirements)
            .arg("--dest")
            .arg(&place),
    )?;
    let archives = files(&place, ".tar.gz")?;
    let archive = archives.first().ok_or("there are no sources of pysoem")?;
    succeed(
        Command::new(&python)
            .args(["-m", "tarfile", "--extract"])
            .arg(archive)
            .arg(&place),
    )?;
    let unpacked = archive.to_string_lossy().replace(".tar.gz", "");
    let library = Path::new(&unpacked).join("soem");
    // pysoem has its own context. SOEM's global one lacks two members there, and does not compile without them.
    let main = library.join("soem/ethercatmain.c");
    let context = "    &ec_DCtime, ";
    let text = read(&main)?;
    if text.matches(context).count() != 1 {
        return Err(format!("{} has no global context", main.display()));
    }
    fs::write(&main, text.replace(context, "    0, 0, &ec_DCtime, "))
        .map_err(|error| error.to_string())?;
    let parts = ["soem", "osal/linux", "oshw/linux", "osal"].map(|part| library.join(part));
    for program in [
        "linux/slaveinfo/slaveinfo.c",
        "linux/eepromtool/eepromtool.c",
        "simple_ng/simple_ng.c",
    ] {
        let source = library.join("test").join(program);
        let mut compiler = Command::new("cc");
        compiler
            .args(["-w", "-O1", "-DUSE_SOEM_CONFIG_H", "-o"])
            .arg(place.join(source.file_stem().ok_or("a program has a name")?))
            .arg("-I")
            .arg(&soem);
        for part in &parts {
            compiler.arg("-I").arg(part).args(files(part, ".c")?);
        }
        succeed(compiler.arg(&source).args(["-lpthread", "-lrt"]))?;
    }
    fs::write(&stamp, wanted).map_err(|error| error.to_string())?;
    Ok(place)
}

/// The files of a directory whose names end so.
fn files(directory: &Path, end: &str) -> Result<Vec<PathBuf>, String> {
    let listed = fs::read_dir(directory).map_err(|error| error.to_string())?;
    Ok(listed
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.to_string_lossy().ends_with(end))
        .collect())
}

/// From the example in the package of ethercrab that the library is built with, and the manifest in `ethercrab/`.
fn build_sdo_info() -> Made {
    let place = target().join("interop/ethercrab");
    let directory = profile();
    let directory = directory.file_name().ok_or("the profile has a name")?;
    let program = place.join("target").join(directory).join("sdo-info");
    if made_already() {
        return Ok(program);
    }
    let said = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version=1", "--locked"])
        .arg("--manifest-path")
        .arg(root().join("Cargo.toml"))
        .output()
        .map_err(|error| error.to_string())?;
    let metadata: serde_json::Value =
        serde_json::from_slice(&said.stdout).map_err(|error| error.to_string())?;
    let manifest = metadata["packages"]
        .as_array()
        .and_then(|packages| packages.iter().find(|one| one["name"] == "ethercrab"))
        .and_then(|package| package["manifest_path"].as_str())
        .ok_or("cargo knows no ethercrab")?;
    let example = Path::new(manifest).with_file_name("examples/sdo-info.rs");
    fs::create_dir_all(place.join("src")).map_err(|error| error.to_string())?;
    let ours = sources().join("ethercrab");
    for (from, to) in [
        (ours.join("Cargo.toml"), "Cargo.toml"),
        (ours.join("Cargo.lock"), "Cargo.lock"),
        (example, "src/main.rs"),
    ] {
        fs::copy(&from, place.join(to)).map_err(|error| format!("{}: {error}", from.display()))?;
    }
    build(&place.join("Cargo.toml"), &place.join("target"))?;
    Ok(program)
}
