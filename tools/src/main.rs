//! `servocrab`, the tool: who is on an EtherCAT line, what its drives hold, and whether the computer keeps their cycles.
//!
//! `servocrab --help` lists the commands; `docs/tool.md` is about each of them.

mod axes;
mod bundle;
mod capture;
mod doctor;
mod eeprom;
mod history;
mod line;
mod machine;
mod meaning;
mod motion;
mod od;
mod output;
mod panel;
mod params;
mod report;
mod scan;
mod watch;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use output::Tool;

/// Looks at an EtherCAT line of servo drives, and works on it.
///
/// The line is on a network interface (`--interface eth0`), or simulated in this process (`--sim akd2g,io`). Ends with 0, with 1
/// if what was looked at is not as it should be, and with 2 if something failed.
#[derive(Parser)]
#[command(version, name = "servocrab")]
struct Arguments {
    /// Print JSON; errors and notes are one JSON object a line on the error output
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Shows who is on the line; whatever it was doing ends
    Scan(scan::Arguments),
    /// Shows and changes the objects of a drive; whatever its line was doing ends
    Od(od::Arguments),
    /// Backs up, compares, writes and stores the parameters of drives; whatever their line was doing ends
    Params(params::Arguments),
    /// Gives a drive that was put in place of another one its station alias and its parameters; whatever its line was doing ends
    Replace(params::replace::Arguments),
    /// Shows what a drive remembers of its errors, and clears it if asked to; whatever its line was doing ends
    History(history::Arguments),
    /// Reads, compares and writes the EEPROM of a device, and its station alias; whatever its line was doing ends
    Eeprom(eeprom::Arguments),
    /// Moves an axis with a velocity for a time
    Jog(motion::Jog),
    /// Has a drive find the home of an axis
    Home(motion::Home),
    /// Moves an axis to a position or by a distance
    Move(motion::Move),
    /// Checks whether this computer can keep the cycles of a line; changes nothing and sends nothing
    Doctor(doctor::Arguments),
    /// Measures how steady the cycles of a line are; the axes stay disabled
    Report(report::Arguments),
    /// Shows a line in a browser: its axes, a scope, its objects; jogs and moves where that is granted
    Panel(panel::Arguments),
    /// Shows signals of every cycle, also of a running program
    Watch(watch::Arguments),
    /// Writes the EtherCAT frames on an interface into a file for Wireshark, also beside a running program; sends nothing
    Capture(capture::Arguments),
    /// Collects what support needs in one file: versions, the computer, the line, its drives
    Bundle(bundle::Arguments),
    /// Writes what is on the line into a file, `machine.toml`, and as Rust; whatever the line was doing ends
    Init(machine::init::Arguments),
    /// Compares a line with its `machine.toml` and measures it at standstill: one page, to be signed at acceptance
    Check(machine::check::Arguments),
    /// Simulates the line of a `machine.toml` on a network interface
    Sim(machine::simulate::Arguments),
}

fn main() -> ExitCode {
    // Before anything is parsed: an error of the arguments is JSON as well.
    let json = std::env::args_os().any(|argument| argument == "--json");
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return output::usage(&error, json),
    };
    let tool = match Tool::new(arguments.json) {
        Ok(tool) => tool,
        Err(error) => return output::end(Err(error), arguments.json),
    };
    let done = match &arguments.command {
        Command::Scan(arguments) => smol::block_on(scan::run(&tool, arguments)),
        Command::Od(arguments) => smol::block_on(od::run(&tool, arguments)),
        Command::Params(arguments) => smol::block_on(params::run(&tool, arguments)),
        Command::Replace(arguments) => smol::block_on(params::replace::run(&tool, arguments)),
        Command::History(arguments) => smol::block_on(history::run(&tool, arguments)),
        Command::Eeprom(arguments) => smol::block_on(eeprom::run(&tool, arguments)),
        Command::Jog(arguments) => smol::block_on(motion::jog(&tool, arguments)),
        Command::Home(arguments) => smol::block_on(motion::home(&tool, arguments)),
        Command::Move(arguments) => smol::block_on(motion::move_axis(&tool, arguments)),
        Command::Panel(arguments) => smol::block_on(panel::run(&tool, arguments)),
        Command::Watch(arguments) => smol::block_on(watch::run(&tool, arguments)),
        Command::Capture(arguments) => smol::block_on(capture::run(&tool, arguments)),
        Command::Bundle(arguments) => smol::block_on(bundle::run(&tool, arguments)),
        Command::Doctor(arguments) => doctor::run(&tool, arguments),
        Command::Init(arguments) => smol::block_on(machine::init::run(&tool, arguments)),
        Command::Check(arguments) => smol::block_on(machine::check::run(&tool, arguments)),
        Command::Sim(arguments) => machine::simulate::run(&tool, arguments),
        Command::Report(arguments) => smol::block_on(report::run(&tool, arguments)),
    };
    output::end(done, arguments.json)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn the_arguments_of_all_commands_agree_with_each_other() {
        super::Arguments::command().debug_assert();
    }
}
