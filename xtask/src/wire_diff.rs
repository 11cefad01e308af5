//! What the library sends on the wire, beside recordings of another master.

use std::{path::PathBuf, process::Command};

/// Compares what the library sends up to PREOP with what another master sent to a real drive.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// The directory with the recordings, `.pcap` and `.pcapng`.
    recordings: PathBuf,
}

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    let recordings = std::path::absolute(&args.recordings)?;
    let status = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .current_dir(crate::root())
        .args([
            "test",
            "--quiet",
            "--workspace",
            "--test",
            "wire_diff",
            "--",
        ])
        .arg(recordings)
        .status()?;
    if !status.success() {
        return Err("the library sends what tests/interop/WIRE.md does not list".into());
    }
    Ok(())
}
