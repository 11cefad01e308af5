//! Hostile clients against the server of a moving machine.

use std::{
    process::Command,
    time::{SystemTime, UNIX_EPOCH},
};

/// Lets hostile clients loose on the server of a simulated machine that moves: the machine goes on, and the server answers afterwards.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// How long.
    #[arg(long, default_value_t = 1.0)]
    minutes: f64,
    /// What the clients do follows from it; without it a new one, which is printed.
    #[arg(long)]
    seed: Option<u64>,
}

pub(crate) fn run(args: &Args) -> crate::Result<()> {
    let seed = match args.seed {
        Some(seed) => seed,
        None => SystemTime::now().duration_since(UNIX_EPOCH)?.as_secs(),
    };
    let status = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .current_dir(crate::root())
        .args([
            "test",
            "--quiet",
            // With the features that `cargo test --workspace` has built it with.
            "--workspace",
            "--test",
            "hostile",
            "--",
            "--run",
        ])
        .args([args.minutes.to_string(), seed.to_string()])
        .status()?;
    if !status.success() {
        return Err("the server or its machine has suffered".into());
    }
    Ok(())
}
