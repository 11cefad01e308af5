//! Copies of the repository's tree, of which only what differs is written, so that cargo builds only what differs.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The files of the repository, and those that are new in it.
pub(crate) fn listed(root: &Path) -> crate::Result<Vec<String>> {
    let listed = Command::new("git")
        .args([
            "ls-files",
            "-z",
            "--cached",
            "--others",
            "--exclude-standard",
        ])
        .current_dir(root)
        .output()?;
    let listed = String::from_utf8(listed.stdout)?;
    Ok(listed
        .split('\0')
        .filter(|name| !name.is_empty())
        .map(str::to_owned)
        .collect())
}

/// Copies a file or a directory, with the times by which cargo knows what is up to date.
pub(crate) fn copy(from: &Path, to: &Path) -> io::Result<()> {
    if from.is_dir() {
        for entry in fs::read_dir(from)? {
            let name = entry?.file_name();
            copy(&from.join(&name), &to.join(&name))?;
        }
        return Ok(());
    }
    fs::create_dir_all(to.parent().unwrap_or(to))?;
    fs::copy(from, to)?;
    let modified = fs::metadata(from)?.modified()?;
    fs::File::options()
        .write(true)
        .open(to)?
        .set_modified(modified)
}

/// Writes a file where it differs.
pub(crate) fn write(path: &Path, content: &[u8]) -> io::Result<()> {
    if fs::read(path).is_ok_and(|there| there == content) {
        return Ok(());
    }
    fs::create_dir_all(path.parent().unwrap_or(path))?;
    fs::write(path, content)
}

/// Removes what is not among these files.
pub(crate) fn remove_others(directory: &Path, files: &BTreeSet<PathBuf>) -> io::Result<()> {
    for entry in fs::read_dir(directory)? {
        let path = entry?.path();
        if path.is_dir() {
            remove_others(&path, files)?;
        } else if !files.contains(&path) {
            fs::remove_file(&path)?;
        }
    }
    Ok(())
}

/// Takes over what other steps have built of other packages; cargo builds what it cannot use of it.
pub(crate) fn take_dependencies(root: &Path, to: &Path) -> io::Result<()> {
    if to.exists() {
        return Ok(());
    }
    let target = std::env::var_os("CARGO_TARGET_DIR");
    let target = target.map_or_else(|| root.join("target"), PathBuf::from);
    // The other masters of tests/interop.
    for master in ["interop/soem", "interop/etherage"] {
        if target.join(master).is_dir() {
            copy(&target.join(master), &to.join(master))?;
        }
    }
    let built = target.join("debug");
    for part in [".fingerprint", "build", "deps"] {
        let part_built = built.join(part);
        if !part_built.is_dir() {
            continue;
        }
        for entry in fs::read_dir(&part_built)? {
            let name = entry?.file_name().to_string_lossy().into_owned();
            let other = !name.contains("servocrab") && !name.starts_with("xtask");
            let dependency = part != "deps" || name.starts_with("lib") || name.ends_with(".d");
            if other && dependency {
                copy(
                    &part_built.join(&name),
                    &to.join("debug").join(part).join(&name),
                )?;
            }
        }
    }
    Ok(())
}
