//! The parameters of drives: backed up to a file, compared with it, written from it, stored in the drive's memory, set back to the
//! maker's defaults.

mod apply;
pub(crate) mod replace;

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use serde_json::{Value, json};
use servocrab::{
    coe::{DriveError, ObjectAddress, SdoHandle},
    parameters::{
        self, Backup, Differences, MemorySupport, ParameterObject, ParameterSet, Progress,
        RestoreError,
    },
};

use crate::{
    line::{DriveArguments, Found, LineArguments},
    output::{Done, Failure, Interrupted, Tool, bar, table, told},
};

/// Where a program shows the network of the interface, that program is asked, and refuses what it does not grant. Else the line is reset
/// and its drives are in PREOP: nothing moves.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    line: LineArguments,
    #[command(flatten)]
    drive: DriveArguments,
    #[command(subcommand)]
    work: Work,
}

#[derive(Subcommand)]
enum Work {
    /// Reads all parameters of a drive into a file
    Backup {
        /// The TOML file
        file: PathBuf,
        /// Replace a file that is there without a question
        #[arg(long)]
        yes: bool,
    },
    /// Shows which parameters a drive holds otherwise than a file
    Compare {
        /// The TOML file
        file: PathBuf,
    },
    /// Writes the parameters of a file to one drive or to all of its kind; what a drive refuses is shown, and the rest is written
    Apply(apply::Arguments),
    /// Writes a backup to the drive, in order, and reads each parameter back; ends at the first that the drive refuses
    Restore {
        /// The TOML file
        file: PathBuf,
        /// Store them in the drive's memory afterwards
        #[arg(long)]
        store: bool,
        #[command(flatten)]
        consent: Consent,
    },
    /// Has a drive store its parameters for the next power-up (1010h)
    Store {
        #[command(flatten)]
        consent: Consent,
    },
    /// Has a drive take its maker's defaults at the next power-up (1011h)
    Defaults {
        #[command(flatten)]
        consent: Consent,
    },
}

/// Whether to write to a drive.
#[derive(Args, Clone, Copy)]
pub(crate) struct Consent {
    /// Show what would be written, and write nothing
    #[arg(long, conflicts_with = "yes")]
    dry_run: bool,
    /// Write without a question
    #[arg(long)]
    yes: bool,
}

/// Does it; false if file and drive differ, or a drive has refused something.
pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    if let Some(file) = read_from(&arguments.work) {
        // One that cannot be used takes no line.
        loaded(file)?;
    }
    let line = arguments.line.open(tool).await?;
    let devices = line.devices();
    let done = tool
        .unless_interrupted(work(tool, arguments, &devices))
        .await;
    drop(devices);
    line.close().await;
    done.map_err(|error| match error.is::<Interrupted>() && writes(&arguments.work) {
        true => "interrupted: a part of the parameters may have been written; `params compare` shows which".into(),
        false => error,
    })
}

/// The file that it reads.
fn read_from(work: &Work) -> Option<&PathBuf> {
    match work {
        Work::Compare { file } | Work::Restore { file, .. } => Some(file),
        Work::Apply(arguments) => Some(&arguments.file),
        Work::Backup { .. } | Work::Store { .. } | Work::Defaults { .. } => None,
    }
}

/// Whether this may have written something when it is interrupted.
fn writes(work: &Work) -> bool {
    match work {
        Work::Backup { .. } | Work::Compare { .. } => false,
        Work::Apply(arguments) => !arguments.consent.dry_run,
        Work::Restore { consent, .. } | Work::Store { consent } | Work::Defaults { consent } => {
            !consent.dry_run
        }
    }
}

async fn work(tool: &Tool, arguments: &Arguments, line: &[Found<'_>]) -> Done {
    let drive = || arguments.drive.of(line);
    match &arguments.work {
        Work::Backup { file, yes } => backup(tool, drive()?, file, *yes).await?,
        Work::Compare { file } => {
            let (sdo, set) = (drive()?, loaded(file)?);
            if let Err(other) = same_kind(&set, sdo, apply::Kind::Product) {
                tool.note(other);
            }
            let differences = compared(sdo, &set).await?;
            let text = match differences.0.is_empty() {
                true => "file and drive agree\n".into(),
                false => differences.to_string(),
            };
            tool.say(&of_differences(&differences), text)?;
            return Ok(differences.0.is_empty());
        }
        Work::Apply(apply) => return apply::run(tool, apply, &arguments.drive, line).await,
        Work::Restore {
            file,
            store,
            consent,
        } => {
            let (sdo, set) = (drive()?, loaded(file)?);
            return restore(tool, sdo, &set, *store, *consent).await;
        }
        Work::Store { consent } => {
            let sdo = drive()?;
            let support = parameters::store_support(sdo).await?;
            let question = format!(
                "Store the present parameters of {} in its memory?",
                sdo.drive()
            );
            if memory(tool, "1010h:01", support, *consent, &question).await? {
                parameters::store(sdo).await?;
                tool.say(&json!({"stored": true}), "stored in the drive's memory\n")?;
            }
        }
        Work::Defaults { consent } => {
            let sdo = drive()?;
            let support = parameters::defaults_support(sdo).await?;
            let question = format!(
                "Have {} forget its parameters and take its maker's defaults?",
                sdo.drive()
            );
            if memory(tool, "1011h:01", support, *consent, &question).await? {
                parameters::load_defaults(sdo).await?;
                let text =
                    "the defaults are in force when the drive has been switched off and on\n";
                tool.say(&json!({"defaults": true}), text)?;
            }
        }
    }
    Ok(true)
}

/// Whether the drive is to be told; after `--dry-run`, which shows whether it can do it, it is not.
async fn memory(
    tool: &Tool,
    object: &str,
    support: Option<MemorySupport>,
    consent: Consent,
    question: &str,
) -> Result<bool, Failure> {
    if !consent.dry_run {
        tool.agreed_or_shown(consent.yes, question).await?;
        return Ok(true);
    }
    let (on_command, text) = match support {
        None => (false, "the drive has no such object"),
        Some(MemorySupport {
            on_command: true, ..
        }) => (true, "the drive does it on command"),
        Some(MemorySupport {
            by_itself: true, ..
        }) => (false, "the drive does it by itself alone"),
        Some(_) => (false, "the drive says that it does nothing"),
    };
    let json = json!({"dry_run": true, "object": object, "on_command": on_command});
    tool.say(
        &json,
        format_args!("nothing is written; {object}: {text}\n"),
    )?;
    Ok(false)
}

/// The parameters of a file. One that has none would agree with every drive.
fn loaded(file: &Path) -> Result<ParameterSet, Failure> {
    let set = ParameterSet::load(file)?;
    match set.parameters.is_empty() {
        true => Err(format!("{} has no parameters", file.display()).into()),
        false => Ok(set),
    }
}

/// Whether the file is of this kind of drive; a file without an identity is of any.
fn same_kind(set: &ParameterSet, sdo: &SdoHandle, kind: apply::Kind) -> Result<(), String> {
    let drive = sdo.drive();
    match set.identity {
        Some(expected) if !kind.is_same(&expected, &drive.identity) => Err(format!(
            "the file is of another kind of drive: expected {expected}, and {drive} is {}",
            drive.identity
        )),
        _ => Ok(()),
    }
}

async fn backup(tool: &Tool, sdo: &SdoHandle, file: &Path, yes: bool) -> Result<(), Failure> {
    if file.exists() {
        tool.agreed(
            yes,
            &format!("{} is there already. Replace it?", file.display()),
        )
        .await?;
    }
    let backup = read_all(sdo).await?;
    backup.set.save(file)?;
    let read = backup.set.parameters.len();
    let mut text = format!(
        "{read} parameters of {} in {}\n",
        sdo.drive(),
        file.display()
    );
    for (object, code) in &backup.refused {
        text += &format!("{object} cannot be read, and is not in the backup: {code}\n");
    }
    let refused: Vec<_> = backup
        .refused
        .iter()
        .map(|(object, code)| json!({"object": object.to_string(), "abort": code.0}))
        .collect();
    let json = json!({"parameters": read, "missing": texts(&backup.missing), "refused": refused});
    tool.say(&json, text)?;
    Ok(())
}

/// All parameters of a drive.
pub(crate) async fn read_all(sdo: &SdoHandle) -> Result<Backup, DriveError> {
    let objects = ParameterObject::of(sdo).await?;
    let bar = bar("reading");
    let backup = ParameterSet::backup(sdo, &objects, Progress::of(&mut told(&bar))).await;
    bar.finish_and_clear();
    backup
}

async fn compared(sdo: &SdoHandle, set: &ParameterSet) -> Result<Differences, Failure> {
    let bar = bar("comparing");
    let differences = set.compare(sdo, Progress::of(&mut told(&bar))).await;
    bar.finish_and_clear();
    Ok(differences?)
}

async fn restore(
    tool: &Tool,
    sdo: &SdoHandle,
    set: &ParameterSet,
    store: bool,
    consent: Consent,
) -> Done {
    same_kind(set, sdo, apply::Kind::Product)?;
    let differences = compared(sdo, set).await?;
    if consent.dry_run {
        let count = differences.0.len();
        let text = format!("{differences}nothing is written; {count} would be\n");
        let json = json!({"dry_run": true, "would_write": of_differences(&differences)});
        tool.say(&json, text)?;
        return Ok(true);
    }
    let count = differences.0.len();
    let question = format!(
        "Write {count} of {} parameters to {}?",
        set.parameters.len(),
        sdo.drive()
    );
    if count > 0 || store {
        tool.agreed_or_shown(consent.yes, &question).await?;
    }
    let bar = bar("restoring");
    let restored = set.restore(sdo, Progress::of(&mut told(&bar))).await;
    bar.finish_and_clear();
    let (done, error) = match &restored {
        Ok(done) => (done, None),
        Err(error) => (&error.done, Some(error)),
    };
    let rest: &[ObjectAddress] = error.map_or(&[], |error: &RestoreError| &error.not_written);
    let unconfirmed = error.and_then(|error| error.unconfirmed);
    let mut stored = false;
    if store && restored.is_ok() {
        parameters::store(sdo).await?;
        stored = true;
    }
    let json = json!({
        "written": texts(&done.written),
        "unchanged": done.unchanged.len(),
        "unconfirmed": unconfirmed.map(|object| object.to_string()),
        "not_written": texts(rest),
        "stored": stored,
    });
    let row = |object: &ObjectAddress, what: &str| {
        let mut all = set.parameters.iter();
        let parameter = all.find(|parameter| parameter.object == *object);
        let name = parameter.map_or_else(String::new, |parameter| parameter.name.clone());
        [object.to_string(), name, what.into()]
    };
    let written = done.written.iter().map(|object| row(object, "written"));
    let doubt = unconfirmed
        .iter()
        .map(|object| row(object, "not confirmed"));
    let rest = rest.iter().map(|object| row(object, "not written"));
    let rows: Vec<_> = written.chain(doubt).chain(rest).collect();
    let mut text = match rows.is_empty() {
        true => String::new(),
        false => table(["object", "name", "what"], &rows),
    };
    text += &format!(
        "{} written, {} unchanged\n",
        done.written.len(),
        done.unchanged.len()
    );
    if stored {
        text += "stored in the drive's memory\n";
    }
    tool.say(&json, text)?;
    restored?;
    Ok(true)
}

fn of_differences(differences: &Differences) -> Value {
    let all = differences.0.iter().map(|difference| {
        json!({
            "object": difference.parameter.object.to_string(),
            "name": difference.parameter.name,
            "file": difference.parameter.value.to_string(),
            "drive": difference.held.to_string(),
        })
    });
    all.collect()
}

fn texts(objects: &[ObjectAddress]) -> Vec<String> {
    objects.iter().map(ToString::to_string).collect()
}
