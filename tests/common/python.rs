//! Python environments of tests: made where they are missing or out of date, and kept in the target directory.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// The Python of the environment in `place`, which has what the file `requirements` pins and imports `module`; or why it could not be
/// made.
pub(crate) fn environment(
    place: &Path,
    requirements: &Path,
    module: &str,
) -> Result<PathBuf, String> {
    let python = place.join("bin/python");
    let wanted = fs::read_to_string(requirements).map_err(|error| error.to_string())?;
    // Written last, so that an environment that has it is whole.
    let stamp = place.join("installed.txt");
    let imports =
        |python: &Path| succeed(Command::new(python).args(["-c", &format!("import {module}")]));
    let is_whole = || {
        let installed = fs::read_to_string(&stamp);
        installed.is_ok_and(|installed| installed == wanted) && imports(&python).is_ok()
    };
    if is_whole() {
        return Ok(python);
    }
    if place.exists() {
        fs::remove_dir_all(place).map_err(|error| error.to_string())?;
    }
    // Another test may be making it as well: each makes its own, and the first one that is whole is kept.
    let own = place.with_extension(std::process::id().to_string());
    make(&own, requirements)?;
    imports(&own.join("bin/python"))?;
    fs::write(own.join("installed.txt"), &wanted).map_err(|error| error.to_string())?;
    if let Err(error) = fs::rename(&own, place) {
        fs::remove_dir_all(&own).map_err(|error| error.to_string())?;
        if !is_whole() {
            return Err(format!("{}: {error}", place.display()));
        }
    }
    Ok(python)
}

fn make(place: &Path, requirements: &Path) -> Result<(), String> {
    succeed(Command::new("python3").args(["-m", "venv"]).arg(place))?;
    // What is not pinned is not wanted.
    succeed(
        Command::new(place.join("bin/python"))
            .args(["-m", "pip", "install", "--quiet", "--retries", "2"])
            .args(["--only-binary", ":all:", "--no-deps", "--require-hashes"])
            .arg("-r")
            .arg(requirements),
    )
}

/// Runs a command to its end; what it says when it fails.
pub(crate) fn succeed(command: &mut Command) -> Result<(), String> {
    let output = command
        .output()
        .map_err(|error| format!("{}: {error}", command.get_program().display()))?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr);
    Err(format!("{command:?}: {}: {}", output.status, said.trim()))
}
