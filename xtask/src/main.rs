//! The project's own commands. `cargo xtask --help` lists them.

mod files;
mod hostile;
mod house;
mod motion_table;
mod mutants;
mod panel_e2e;
mod prove;
mod wire_diff;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The project's own commands.
#[derive(Parser)]
#[command(name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Hostile(hostile::Args),
    House(house::Args),
    MotionTable(motion_table::Args),
    Mutants(mutants::Args),
    MutationScore(mutants::score::Args),
    PanelE2e(panel_e2e::Args),
    Prove(prove::Args),
    WireDiff(wire_diff::Args),
}

fn main() -> ExitCode {
    let done = match Arguments::parse().command {
        Command::Hostile(args) => hostile::run(&args),
        Command::House(args) => house::run(&args),
        Command::MotionTable(args) => motion_table::run(&args),
        Command::Mutants(args) => mutants::run(&args),
        Command::MutationScore(args) => mutants::score::run(&args),
        Command::PanelE2e(args) => panel_e2e::run(&args),
        Command::Prove(args) => prove::run(&args),
        Command::WireDiff(args) => wire_diff::run(&args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("xtask: {failure}");
            ExitCode::FAILURE
        }
    }
}

/// The repository's root, in which the commands work whatever directory they are called from.
fn root() -> &'static std::path::Path {
    let package = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    package.parent().unwrap_or(package)
}

/// What ends a command: a text for whoever called it.
type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;
