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
    let imports = || succeed(Command::new(&python).args(["-c", &format!("import {module}")]));
    if fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) && imports().is_ok() {
        return Ok(python);
    }
    if place.exists() {
        fs::remove_dir_all(place).map_err(|error| error.to_string())?;
    }
    succeed(Command::new("python3").args(["-m", "venv"]).arg(place))?;
    // What is not pinned is not wanted.
    succeed(
        Command::new(&python)
            .args(["-m", "pip", "install", "--quiet", "--retries", "2"])
            .args(["--only-binary", ":all:", "--no-deps", "--require-hashes"])
            .arg("-r")
            .arg(requirements),
    )?;
    imports()?;
    fs::write(&stamp, wanted).map_err(|error| error.to_string())?;
    Ok(python)
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
