//! The panel in a real browser.

use std::{path::PathBuf, process::Command};

/// Opens the panel of a simulated machine in a Chromium: what it shows, and how each way of losing the browser ends a jog.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Where its pictures go.
    #[arg(long, default_value = "target/panel")]
    pictures: PathBuf,
}

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    let pictures = crate::root().join(&args.pictures);
    let status = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .current_dir(crate::root())
        .args([
            "test",
            "--quiet",
            // With the features that `cargo test --workspace` has built it with.
            "--workspace",
            "--test",
            "panel",
            "--",
            "--run",
        ])
        .arg(pictures)
        .status()?;
    if !status.success() {
        return Err("the panel does not do what it should".into());
    }
    Ok(())
}
