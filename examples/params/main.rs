//! The parameters of a drive: backed up to a file, compared with it, restored, stored in the drive's memory, set back to its
//! maker's defaults.
//!
//! `sudo params --interface eth0 --drive 1 backup left.toml`, `params compare left.toml`, `params restore left.toml`,
//! `params store`, `params defaults`; without `--interface` on a simulated line, with `--json` for programs. The line is reset
//! and its drives are in PREOP: nothing moves. Ends with 1 if file and drive differ, with 2 if something fails.

use std::{error::Error, path::PathBuf, process::ExitCode};

use clap::{Parser, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use servocrab::{
    bus::Line,
    coe::{ObjectAddress, SdoHandle},
    parameters::{self, Differences, ParameterObject, ParameterSet, Progress, RestoreError},
};

#[path = "../common/mod.rs"]
mod common;
#[path = "../common/drive.rs"]
mod drive;

use common::{LineArguments, put, table};
use drive::DriveArguments;

/// Backs up, compares, restores and stores the parameters of a drive. Whatever its line was doing ends.
#[derive(Parser)]
struct Arguments {
    #[command(flatten)]
    line: LineArguments,
    #[command(flatten)]
    drive: DriveArguments,
    #[command(subcommand)]
    work: Work,
}

#[derive(Subcommand)]
enum Work {
    /// Reads all parameters of the drive into a file.
    Backup {
        /// The TOML file.
        file: PathBuf,
    },
    /// Shows which parameters the drive holds otherwise than a file.
    Compare {
        /// The TOML file.
        file: PathBuf,
    },
    /// Writes the parameters of a file to the drive, and reads each back.
    Restore {
        /// The TOML file.
        file: PathBuf,
        /// Store them in the drive's memory afterwards.
        #[arg(long)]
        store: bool,
    },
    /// Has the drive store its parameters for the next power-up (1010h).
    Store,
    /// Has the drive take its maker's defaults at the next power-up (1011h).
    Defaults,
}

fn main() -> ExitCode {
    match smol::block_on(run(&Arguments::parse())) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            eprintln!("params: {error}");
            ExitCode::from(2)
        }
    }
}

async fn run(arguments: &Arguments) -> Result<bool, Box<dyn Error>> {
    let line = arguments.line.scan().await?;
    let done = work(arguments, &line).await;
    line.close().await;
    done
}

/// Does it; false if file and drive differ.
async fn work(arguments: &Arguments, line: &Line) -> Result<bool, Box<dyn Error>> {
    let sdo = arguments.drive.of(line)?;
    let json = arguments.line.json;
    match &arguments.work {
        Work::Backup { file } => backup(sdo, file, json).await?,
        Work::Compare { file } => {
            let set = ParameterSet::load(file)?;
            let bar = bar("comparing");
            let differences = set.compare(sdo, Progress::of(&mut told(&bar))).await?;
            bar.finish_and_clear();
            show(&differences, json)?;
            return Ok(differences.0.is_empty());
        }
        Work::Restore { file, store } => {
            let set = ParameterSet::load(file)?;
            restore(sdo, &set, json).await?;
            if *store {
                parameters::store(sdo).await?;
                eprintln!("stored in the drive's memory");
            }
        }
        Work::Store => {
            parameters::store(sdo).await?;
            said(json, "stored", "stored in the drive's memory")?;
        }
        Work::Defaults => {
            parameters::load_defaults(sdo).await?;
            let text = "the defaults are in force when the drive has been switched off and on";
            said(json, "defaults", text)?;
        }
    }
    Ok(true)
}

async fn backup(sdo: &SdoHandle, file: &PathBuf, json: bool) -> Result<(), Box<dyn Error>> {
    eprintln!("asking {} for its objects", sdo.drive());
    let objects = ParameterObject::of(sdo).await?;
    let bar = bar("reading");
    let backup = ParameterSet::backup(sdo, &objects, Progress::of(&mut told(&bar))).await?;
    bar.finish_and_clear();
    backup.set.save(file)?;
    let read = backup.set.parameters.len();
    for (object, code) in &backup.refused {
        eprintln!("params: {object} cannot be read, and is not in the backup: {code}");
    }
    if json {
        let refused: Vec<_> = backup
            .refused
            .iter()
            .map(|(object, code)| json!({"object": object.to_string(), "abort": code.0}))
            .collect();
        put(format_args!(
            "{}\n",
            json!({"parameters": read, "missing": texts(&backup.missing), "refused": refused})
        ))?;
    } else {
        put(format_args!(
            "{read} parameters of {} in {}\n",
            sdo.drive(),
            file.display()
        ))?;
    }
    Ok(())
}

async fn restore(sdo: &SdoHandle, set: &ParameterSet, json: bool) -> Result<(), Box<dyn Error>> {
    let bar = bar("restoring");
    let restored = set.restore(sdo, Progress::of(&mut told(&bar))).await;
    bar.finish_and_clear();
    let (done, error) = match &restored {
        Ok(done) => (done, None),
        Err(error) => (&error.done, Some(error)),
    };
    let rest: &[ObjectAddress] = error.map_or(&[], |error: &RestoreError| &error.not_written);
    let in_doubt = error.and_then(|error| error.in_doubt);
    if json {
        let report = json!({
            "written": texts(&done.written),
            "unchanged": done.unchanged.len(),
            "in_doubt": in_doubt.map(|object| object.to_string()),
            "not_written": texts(rest),
        });
        put(format_args!("{report}\n"))?;
    } else {
        let name = |object: &ObjectAddress| {
            let mut all = set.parameters.iter();
            let parameter = all.find(|parameter| parameter.object == *object);
            parameter.map_or_else(String::new, |parameter| parameter.name.clone())
        };
        let row =
            |object: &ObjectAddress, what: &str| [object.to_string(), name(object), what.into()];
        let written = done.written.iter().map(|object| row(object, "written"));
        let doubt = in_doubt.iter().map(|object| row(object, "in doubt"));
        let rest = rest.iter().map(|object| row(object, "not written"));
        let rows: Vec<_> = written.chain(doubt).chain(rest).collect();
        if !rows.is_empty() {
            put(table(["object", "name", "what"], &rows))?;
        }
        put(format_args!(
            "{} written, {} unchanged\n",
            done.written.len(),
            done.unchanged.len()
        ))?;
    }
    restored?;
    Ok(())
}

fn show(differences: &Differences, json: bool) -> Result<(), Box<dyn Error>> {
    if json {
        let all: Vec<_> = differences
            .0
            .iter()
            .map(|difference| {
                json!({
                    "object": difference.parameter.object.to_string(),
                    "name": difference.parameter.name,
                    "file": difference.parameter.value.to_string(),
                    "drive": difference.held.to_string(),
                })
            })
            .collect();
        put(format_args!("{}\n", serde_json::to_string_pretty(&all)?))?;
    } else if differences.0.is_empty() {
        put("file and drive agree\n")?;
    } else {
        put(differences)?;
    }
    Ok(())
}

fn said(json: bool, key: &str, text: &str) -> std::io::Result<()> {
    if json {
        put(format_args!("{}\n", json!({ key: true })))
    } else {
        put(format_args!("{text}\n"))
    }
}

fn texts(objects: &[ObjectAddress]) -> Vec<String> {
    objects.iter().map(ToString::to_string).collect()
}

/// A bar on the terminal's error output; none where that is a file.
fn bar(what: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {bar:40} {pos}/{len}");
    let bar = ProgressBar::new(0).with_message(what);
    match style {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}

fn told(bar: &ProgressBar) -> impl FnMut(usize, usize) {
    |done, of| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    }
}
