//! What a drive remembers of its errors: 1003h and 10F3h, shown, and cleared when asked for.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};
use servocrab::{
    coe::{DriveHistory, ErrorTexts, HistoryRecord},
    drives,
};

use crate::{
    line::{DriveArguments, Found, LineArguments},
    output::{Done, Tool, table},
};

/// Where a program shows the network of the interface, that program is asked, and refuses what it does not grant. Else the line is reset
/// and its drives are in PREOP: nothing moves.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    line: LineArguments,
    #[command(flatten)]
    drive: DriveArguments,
    /// A TOML file of what the drive's error codes mean: FF01h = "brake resistor missing"
    #[arg(long, value_name = "FILE")]
    alarms: Option<PathBuf>,
    /// Clear both histories once they are shown
    #[arg(long)]
    clear: bool,
    /// Clear them without a question
    #[arg(long, requires = "clear")]
    yes: bool,
}

pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let alarms = match &arguments.alarms {
        // One that cannot be used takes no line.
        Some(file) => ErrorTexts::load(file)?,
        None => ErrorTexts::default(),
    };
    let line = arguments.line.open(tool).await?;
    let devices = line.devices();
    let work = show(tool, arguments, &devices, alarms);
    let done = tool.unless_interrupted(work).await;
    drop(devices);
    line.close().await;
    done
}

async fn show(tool: &Tool, arguments: &Arguments, line: &[Found<'_>], alarms: ErrorTexts) -> Done {
    let sdo = arguments.drive.of(line)?;
    let known = drives::for_identity(&sdo.drive().identity);
    let mut texts = known.map_or_else(ErrorTexts::default, |drive| drive.error_texts);
    texts.extend(alarms);
    let history = DriveHistory::new(sdo.clone(), texts);
    let record = history.read().await?;
    tool.say(&as_json(&record), as_text(&record))?;
    if arguments.clear {
        let question = format!("Clear the histories of {}?", sdo.drive());
        tool.agreed(arguments.yes, &question).await?;
        history.clear().await?;
        tool.note("cleared");
    }
    Ok(true)
}

fn as_text(record: &HistoryRecord) -> String {
    let errors = record.errors.iter().flatten();
    let errors = errors.map(|error| ["1003h".into(), String::new(), error.to_string()]);
    let messages = record.diagnosis.iter().flat_map(|all| &all.messages);
    let messages = messages.map(|message| {
        let clock = if message.is_local_time {
            "drive"
        } else {
            "bus"
        };
        let seconds = message.time_ns as f64 / 1e9;
        let time = format!("{seconds:.3} s ({clock})");
        ["10F3h".into(), time, message.to_string()]
    });
    let rows: Vec<_> = errors.chain(messages).collect();
    if rows.is_empty() {
        return "no errors\n".into();
    }
    let mut text = table(["history", "time", "the newest first"], &rows);
    if record.diagnosis.as_ref().is_some_and(|all| all.has_lost) {
        text += "10F3h: messages were lost before they were acknowledged\n";
    }
    text
}

fn as_json(record: &HistoryRecord) -> Value {
    let errors = record.errors.as_ref().map(|errors| {
        let each = errors.iter().map(
            |error| json!({"code": error.code, "additional": error.additional, "text": error.text}),
        );
        each.collect::<Vec<_>>()
    });
    let diagnosis = record.diagnosis.as_ref().map(|all| {
        let each = all.messages.iter().map(|message| {
            json!({
                "subindex": message.subindex,
                "code": message.code,
                "severity": message.severity.to_string(),
                "time_ns": message.time_ns,
                "local_time": message.is_local_time,
                "text_id": message.text_id,
                "text": message.to_string(),
            })
        });
        json!({
            "messages": each.collect::<Vec<_>>(),
            "acknowledged": all.acknowledged,
            "new": all.has_new,
            "lost": all.has_lost,
        })
    });
    json!({"errors": errors, "diagnosis": diagnosis})
}
