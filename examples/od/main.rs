//! The objects of a drive: browse, read, write by index or name, watch values.
//!
//! `sudo od --interface eth0 --drive 1 list --filter position`, `od read 6041h "Profile velocity"`, `od write 6081h 50000`,
//! `od watch 6064h 606Ch`; without `--interface` on a simulated line, with `--json` for programs. The line is reset and its
//! drives are in PREOP: nothing moves. A drive without SDO information is browsed by the objects that the library knows.

use std::{error::Error, process::ExitCode, time::Duration};

use clap::{Parser, Subcommand};
use serde_json::{Value, json};
use servocrab::{bus::Line, coe::SdoHandle};

mod catalogue;
#[path = "../common/mod.rs"]
mod common;
#[path = "../common/drive.rs"]
mod drive;

use catalogue::{Catalogue, Item, find};
use common::{LineArguments, put, table};
use drive::DriveArguments;

/// Shows and changes the objects of a drive. Whatever its line was doing ends.
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
    /// Lists the objects with their types and access.
    List {
        /// Only those whose name or address has this in it.
        #[arg(long, default_value = "")]
        filter: String,
        /// Read the values too.
        #[arg(long)]
        values: bool,
    },
    /// Reads objects.
    Read {
        /// Addresses (6041h, 1018h:01) or names.
        #[arg(required = true)]
        objects: Vec<String>,
    },
    /// Writes an object and reads it back.
    Write {
        /// An address (6081h) or a name.
        object: String,
        /// A number (decimal or 0x...), a text, or bytes in hexadecimal, as the object's type has it.
        #[arg(allow_negative_numbers = true)]
        value: String,
    },
    /// Reads objects again and again and shows each change.
    Watch {
        /// Addresses (6064h) or names.
        #[arg(required = true)]
        objects: Vec<String>,
        /// Milliseconds between two looks.
        #[arg(long, default_value_t = 100)]
        every: u64,
        /// Looks, then the end; without it, until Ctrl-C.
        #[arg(long)]
        count: Option<u64>,
    },
}

fn main() -> ExitCode {
    match smol::block_on(run(&Arguments::parse())) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("od: {error}");
            ExitCode::FAILURE
        }
    }
}

async fn run(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let line = arguments.line.scan().await?;
    let done = work(arguments, &line).await;
    line.close().await;
    done
}

async fn work(arguments: &Arguments, line: &Line) -> Result<(), Box<dyn Error>> {
    let sdo = arguments.drive.of(line)?;
    match &arguments.work {
        Work::List { filter, values } => list(arguments, sdo, filter, *values).await?,
        Work::Read { objects } => {
            let mut shown = Vec::new();
            for item in find(sdo, objects).await? {
                let value = sdo.read_bytes(item.address.index, item.address.subindex);
                shown.push((item, Some(value.await?)));
            }
            show(arguments, &shown)?;
        }
        Work::Write { object, value } => {
            for item in find(sdo, std::slice::from_ref(object)).await? {
                let (index, subindex) = (item.address.index, item.address.subindex);
                let bytes = item.data_type.parse(value, item.bits)?;
                sdo.write_bytes(index, subindex, bytes).await?;
                let now = sdo.read_bytes(index, subindex).await?;
                show(arguments, &[(item, Some(now))])?;
            }
        }
        Work::Watch {
            objects,
            every,
            count,
        } => {
            let items = find(sdo, objects).await?;
            let every = Duration::from_millis(*every);
            watch(arguments.line.json, sdo, &items, every, *count).await?;
        }
    }
    Ok(())
}

async fn list(
    arguments: &Arguments,
    sdo: &SdoHandle,
    filter: &str,
    values: bool,
) -> Result<(), Box<dyn Error>> {
    let catalogue = Catalogue::of(sdo).await?;
    if let Some(reason) = catalogue.reason() {
        eprintln!(
            "od: {reason}; of the objects that the library knows those are shown that it has"
        );
    }
    let mut shown = Vec::new();
    for item in catalogue.items().iter().filter(|item| item.has(filter)) {
        // An entry that cannot be read now is shown without a value.
        let value = match values {
            true => {
                let read = sdo.read_bytes(item.address.index, item.address.subindex);
                read.await.ok()
            }
            false => None,
        };
        shown.push((item.clone(), value));
    }
    show(arguments, &shown)
}

fn show(arguments: &Arguments, items: &[(Item, Option<Vec<u8>>)]) -> Result<(), Box<dyn Error>> {
    let value = |(item, bytes): &(Item, Option<Vec<u8>>)| {
        bytes.as_ref().map(|bytes| item.data_type.show(bytes))
    };
    if arguments.line.json {
        let all: Vec<Value> = items
            .iter()
            .map(|both| {
                json!({
                    "index": both.0.address.index,
                    "subindex": both.0.address.subindex,
                    "name": both.0.name,
                    "type": both.0.data_type.to_string(),
                    "bits": both.0.bits,
                    "access": both.0.access,
                    "value": value(both),
                    "bytes": both.1,
                })
            })
            .collect();
        put(format_args!("{}\n", serde_json::to_string_pretty(&all)?))?;
        return Ok(());
    }
    let rows: Vec<_> = items
        .iter()
        .map(|both| {
            let item = &both.0;
            [
                item.address.to_string(),
                item.name.clone(),
                item.data_type.to_string(),
                item.bits.to_string(),
                item.access.clone(),
                value(both).unwrap_or_default(),
            ]
        })
        .collect();
    let heading = ["object", "name", "type", "bits", "access", "value"];
    put(table(heading, &rows))?;
    Ok(())
}

async fn watch(
    json: bool,
    sdo: &SdoHandle,
    items: &[Item],
    every: Duration,
    count: Option<u64>,
) -> Result<(), Box<dyn Error>> {
    let started = std::time::Instant::now();
    let mut before: Vec<Option<Vec<u8>>> = vec![None; items.len()];
    let mut looks = 0;
    while count.is_none_or(|count| looks < count) {
        if looks > 0 {
            smol::Timer::after(every).await;
        }
        looks += 1;
        for (item, before) in items.iter().zip(&mut before) {
            let (index, subindex) = (item.address.index, item.address.subindex);
            let bytes = sdo.read_bytes(index, subindex).await?;
            if before.as_ref() == Some(&bytes) {
                continue;
            }
            let (at, value) = (started.elapsed(), item.data_type.show(&bytes));
            if json {
                let change = json!({
                    "ms": at.as_millis() as u64, "index": index, "subindex": subindex, "value": value
                });
                put(format_args!("{change}\n"))?;
            } else {
                put(format_args!(
                    "{:9.3} s  {} {} = {value}\n",
                    at.as_secs_f64(),
                    item.address,
                    item.name
                ))?;
            }
            *before = Some(bytes);
        }
    }
    Ok(())
}
