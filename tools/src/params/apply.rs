//! The parameters of one file, written to one drive or to all of its kind.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde_json::json;
use servocrab::{
    coe::{SdoError, SdoHandle},
    parameters::{self, Parameter, ParameterSet, Progress, RestoreFault, WriteFault},
    sii::Identity,
};

use super::{Consent, compared, loaded, of_differences, same_kind};
use crate::{
    line::{DriveArguments, Found},
    output::{Done, Failure, Tool, table},
};

#[derive(Args)]
pub(crate) struct Arguments {
    /// The TOML file
    pub(super) file: PathBuf,
    /// Write to all drives of the line that are of the file's kind
    #[arg(long, conflicts_with = "drive")]
    all: bool,
    /// What a drive and the file must have in common
    #[arg(long = "match", value_enum, default_value_t = Kind::Product)]
    kind: Kind,
    /// Store them in each drive's memory afterwards
    #[arg(long)]
    store: bool,
    #[command(flatten)]
    pub(super) consent: Consent,
}

/// What two drives have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Kind {
    /// Vendor and product code
    Product,
    /// Vendor, product code and revision
    Revision,
}

impl Kind {
    pub(crate) fn is_same(self, one: &Identity, other: &Identity) -> bool {
        let product = (one.vendor, one.product) == (other.vendor, other.product);
        product && (self == Self::Product || one.revision == other.revision)
    }
}

/// False if a drive has refused something.
pub(super) async fn run(
    tool: &Tool,
    arguments: &Arguments,
    drive: &DriveArguments,
    line: &[Found<'_>],
) -> Done {
    let set = loaded(&arguments.file)?;
    let drives = chosen(arguments, drive, line, &set)?;
    // All drives are looked at before the first one is written to.
    let mut plans = Vec::new();
    for sdo in drives {
        let differences = compared(sdo, &set).await?;
        plans.push((sdo, differences));
    }
    let count: usize = plans
        .iter()
        .map(|(_, differences)| differences.0.len())
        .sum();
    if arguments.consent.dry_run {
        let mut text = String::new();
        for (sdo, differences) in &plans {
            text += &format!("{}\n{differences}", sdo.drive());
        }
        text += &format!("nothing is written; {count} would be\n");
        let all: Vec<_> = plans
            .iter()
            .map(|(sdo, differences)| {
                json!({"position": sdo.drive().position, "would_write": of_differences(differences)})
            })
            .collect();
        tool.say(&json!({"dry_run": true, "drives": all}), text)?;
        return Ok(true);
    }
    if count > 0 || arguments.store {
        let question = format!("Write {count} parameters to {} drive(s)?", plans.len());
        tool.agreed_or_shown(arguments.consent.yes, &question)
            .await?;
    }
    let mut results = Vec::new();
    for (sdo, differences) in plans {
        let changes = differences.0.into_iter();
        let changes = changes.map(|difference| difference.parameter).collect();
        let mut result = written(sdo, &set, changes).await?;
        if arguments.store {
            parameters::store(sdo).await?;
            result.stored = true;
        }
        results.push((sdo, result));
    }
    show(tool, &set, &results)?;
    Ok(results.iter().all(|(_, result)| result.refused.is_empty()))
}

/// The drives to write to. Who is of another kind is refused where it is named, and left out of all.
fn chosen<'line>(
    arguments: &Arguments,
    drive: &DriveArguments,
    line: &[Found<'line>],
    set: &ParameterSet,
) -> Result<Vec<&'line SdoHandle>, Failure> {
    if !arguments.all {
        let sdo = drive.of(line)?;
        same_kind(set, sdo, arguments.kind)?;
        return Ok(vec![sdo]);
    }
    if set.identity.is_none() {
        return Err("the file does not name the identity of its drive, so that --all would write it to every device: name one by --drive".into());
    }
    let all = line.iter().filter_map(|device| device.sdo);
    let same: Vec<_> = all
        .filter(|sdo| same_kind(set, sdo, arguments.kind).is_ok())
        .collect();
    if same.is_empty() {
        return Err("no drive of the line is of the file's kind".into());
    }
    Ok(same)
}

/// What became of a drive's parameters.
#[derive(Default)]
struct Applied {
    written: Vec<Parameter>,
    unchanged: usize,
    refused: Vec<(Parameter, String)>,
    stored: bool,
}

/// Each by itself, so that one that is refused does not keep the others back.
async fn written(
    sdo: &SdoHandle,
    set: &ParameterSet,
    changes: Vec<Parameter>,
) -> Result<Applied, Failure> {
    let mut result = Applied {
        unchanged: set.parameters.len() - changes.len(),
        ..Applied::default()
    };
    let one = |parameter: Parameter| ParameterSet {
        parameters: vec![parameter],
        // Vendor and product are checked already, as the file has them.
        ..set.clone()
    };
    for parameter in changes {
        match one(parameter.clone()).restore(sdo, Progress::none()).await {
            // It is known to differ.
            Ok(restored) if restored.written.is_empty() => {
                let text = "it is left as it is: every start sets it".to_owned();
                result.refused.push((parameter, text));
            }
            Ok(_) => result.written.push(parameter),
            Err(error) => match &error.fault {
                RestoreFault::Write {
                    fault:
                        fault @ (WriteFault::Sdo(SdoError::Aborted { .. }) | WriteFault::Differs { .. }),
                    ..
                } => result.refused.push((parameter, fault.to_string())),
                RestoreFault::NoParameter(_) => {
                    result.refused.push((parameter, error.fault.to_string()));
                }
                _ => return Err(error.into()),
            },
        }
    }
    // A later write may have changed what an earlier one had written.
    let written = ParameterSet {
        parameters: std::mem::take(&mut result.written),
        ..set.clone()
    };
    let again = written.compare(sdo, Progress::none()).await?.0;
    for parameter in written.parameters {
        match again
            .iter()
            .find(|difference| difference.parameter == parameter)
        {
            None => result.written.push(parameter),
            Some(changed) => {
                let text = format!(
                    "a later write has changed it to {}: put it behind that",
                    changed.held
                );
                result.refused.push((parameter, text));
            }
        }
    }
    Ok(result)
}

fn show(tool: &Tool, set: &ParameterSet, results: &[(&SdoHandle, Applied)]) -> Result<(), Failure> {
    let all: Vec<_> = results
        .iter()
        .map(|(sdo, result)| {
            let refused: Vec<_> = result
                .refused
                .iter()
                .map(|(parameter, why)| json!({"object": parameter.object.to_string(), "why": why}))
                .collect();
            json!({
                "position": sdo.drive().position,
                "name": sdo.drive().name,
                "written": result.written.iter().map(|p| p.object.to_string()).collect::<Vec<_>>(),
                "unchanged": result.unchanged,
                "refused": refused,
                "stored": result.stored,
            })
        })
        .collect();
    let mut rows = Vec::new();
    for (sdo, result) in results {
        rows.push([
            sdo.drive().position.to_string(),
            sdo.drive().name.clone(),
            result.written.len().to_string(),
            result.unchanged.to_string(),
            result.refused.len().to_string(),
            if result.stored { "yes" } else { "no" }.into(),
        ]);
    }
    let heading = ["#", "drive", "written", "unchanged", "refused", "stored"];
    let mut text = format!("{} parameters\n", set.parameters.len()) + &table(heading, &rows);
    for (sdo, result) in results {
        for (parameter, why) in &result.refused {
            let title = format!("{} {}", parameter.object, parameter.name);
            text += &format!("{}: {}: {why}\n", sdo.drive(), title.trim_end());
        }
    }
    tool.say(&all.into(), text)?;
    Ok(())
}
