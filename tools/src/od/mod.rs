//! The objects of a drive: list, find, read, write by index or name, watch values. A drive without SDO information is listed by the
//! objects that the library knows.

mod catalogue;

use std::time::Duration;

use catalogue::{Catalogue, Item, find};
use clap::{Args, Subcommand};
use serde_json::{Value, json};
use servocrab::coe::{AxisOffset, SdoHandle, obj};

use crate::{
    line::{DriveArguments, Found, LineArguments},
    meaning::{self, Meaning},
    output::{Done, Failure, Tool, put, table},
};

/// Where a program shows the network of the interface, that program is asked. Else the line is reset and its drives are in PREOP: nothing
/// moves.
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
    /// Lists the objects of a drive with their types and access
    List {
        /// Only those whose name or address has this in it
        #[arg(long, default_value = "")]
        filter: String,
        /// Read the values too
        #[arg(long)]
        values: bool,
    },
    /// Finds objects on all drives of the line by a part of their name or address, and reads them
    Find {
        /// A part of a name or of an address
        text: String,
    },
    /// Reads objects
    Read {
        /// Addresses (6041h, 0x6041, 1018h:01) or names
        #[arg(required = true)]
        objects: Vec<String>,
    },
    /// Writes an object and reads it back
    Write {
        /// An address (6081h) or a name
        object: String,
        /// A number (decimal or 0x...), a text, or bytes in hexadecimal, as the object's type has it
        #[arg(allow_negative_numbers = true)]
        value: String,
    },
    /// Reads objects again and again and shows each change
    Watch {
        /// Addresses (6064h) or names
        #[arg(required = true)]
        objects: Vec<String>,
        /// Milliseconds between two looks
        #[arg(long, default_value_t = 100)]
        every: u64,
        /// Looks, then the end; without it, until Ctrl-C
        #[arg(long)]
        count: Option<u64>,
    },
}

pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let line = arguments.line.open(tool).await?;
    let devices = line.devices();
    let done = match &arguments.work {
        // Ctrl-C is how a watch ends.
        Work::Watch {
            objects,
            every,
            count,
        } => {
            let every = Duration::from_millis(*every);
            let watched = async {
                let drive = Drive::of(arguments.drive.of(&devices)?).await;
                watch(tool, &drive, objects, every, *count).await
            };
            smol::future::or(watched, async {
                tool.interrupted().await;
                Ok(())
            })
            .await
        }
        work => {
            tool.unless_interrupted(done(tool, arguments, work, &devices))
                .await
        }
    };
    drop(devices);
    line.close().await;
    done.map(|()| true)
}

async fn done(
    tool: &Tool,
    arguments: &Arguments,
    work: &Work,
    line: &[Found<'_>],
) -> Result<(), Failure> {
    match work {
        Work::List { filter, values } => {
            let drive = Drive::of(arguments.drive.of(line)?).await;
            let shown = listed(tool, &drive, filter, *values).await?;
            tool.say(&json(&shown), text(&shown))?;
        }
        Work::Find { text } => everywhere(tool, arguments.drive.drive, line, text).await?,
        Work::Read { objects } => {
            let drive = Drive::of(arguments.drive.of(line)?).await;
            let mut shown = Vec::new();
            for item in find(drive.sdo, objects).await? {
                shown.push(drive.read(item).await?);
            }
            tool.say(&json(&shown), text(&shown))?;
        }
        Work::Write { object, value } => {
            let drive = Drive::of(arguments.drive.of(line)?).await;
            for item in find(drive.sdo, std::slice::from_ref(object)).await? {
                let bytes = item.data_type.parse(value, item.bits)?;
                let (index, subindex) = (item.address.index, item.address.subindex);
                drive.sdo.write_bytes(index, subindex, bytes).await?;
                let shown = [drive.read(item).await?];
                tool.say(&json(&shown), text(&shown))?;
            }
        }
        // Watched by the caller, who hears Ctrl-C in another way.
        Work::Watch { .. } => {}
    }
    Ok(())
}

/// A device whose objects are read.
struct Drive<'line> {
    sdo: &'line SdoHandle,
    /// It has a statusword: what CiA 402 says of its objects is true of it.
    is_drive: bool,
}

/// An entry, and what was read of it.
struct Shown {
    item: Item,
    bytes: Option<Vec<u8>>,
    meaning: Option<Meaning>,
}

impl<'line> Drive<'line> {
    async fn of(sdo: &'line SdoHandle) -> Self {
        let is_drive = sdo.read(obj::STATUSWORD).await.is_ok();
        Self { sdo, is_drive }
    }

    async fn read(&self, item: Item) -> Result<Shown, Failure> {
        let (index, subindex) = (item.address.index, item.address.subindex);
        let bytes = self.sdo.read_bytes(index, subindex).await?;
        let meaning = self.meaning(&item, &bytes).await;
        Ok(Shown {
            item,
            bytes: Some(bytes),
            meaning,
        })
    }

    async fn meaning(&self, item: &Item, bytes: &[u8]) -> Option<Meaning> {
        if !self.is_drive && item.address.index >= 0x6000 {
            return None;
        }
        let mut mode = None;
        if meaning::depends_on_mode(item.address) {
            let (_, axis) = meaning::of_first_axis(item.address.index);
            let display = obj::MODE_OF_OPERATION_DISPLAY.offset(AxisOffset::of_axis(axis));
            mode = self.sdo.read(display).await.ok();
        }
        meaning::of(item.address, bytes, mode)
    }
}

async fn listed(
    tool: &Tool,
    drive: &Drive<'_>,
    filter: &str,
    values: bool,
) -> Result<Vec<Shown>, Failure> {
    let catalogue = Catalogue::of(drive.sdo).await?;
    if let Some(reason) = catalogue.reason() {
        tool.note(format_args!(
            "{reason}; of the objects that the library knows those are shown that it has"
        ));
    }
    let mut shown = Vec::new();
    for item in catalogue.items().iter().filter(|item| item.has(filter)) {
        let unread = || Shown {
            item: item.clone(),
            bytes: None,
            meaning: None,
        };
        shown.push(match values {
            // An entry that cannot be read now is shown without a value.
            true => drive.read(item.clone()).await.unwrap_or_else(|_| unread()),
            false => unread(),
        });
    }
    Ok(shown)
}

/// What has this text in it on all drives, or on the one that is named.
async fn everywhere(
    tool: &Tool,
    position: Option<u16>,
    line: &[Found<'_>],
    filter: &str,
) -> Result<(), Failure> {
    let (mut all, mut texts) = (Vec::new(), String::new());
    let asked = |place: u16| position.is_none_or(|position| position == place);
    for device in line.iter().filter(|device| asked(device.id.position)) {
        let Some(sdo) = device.sdo else { continue };
        let shown = listed(tool, &Drive::of(sdo).await, filter, true).await?;
        if !shown.is_empty() {
            texts += &format!("{}\n{}", device.id, text(&shown));
        }
        all.push(json!({
            "position": device.id.position,
            "name": device.id.name,
            "objects": json(&shown),
        }));
    }
    if texts.is_empty() {
        texts = format!("no object has `{filter}` in its name or address\n");
    }
    tool.say(&all.into(), texts)?;
    Ok(())
}

fn json(shown: &[Shown]) -> Value {
    let all = shown.iter().map(
        |Shown {
             item,
             bytes,
             meaning,
         }| {
            json!({
                "index": item.address.index,
                "subindex": item.address.subindex,
                "name": item.name,
                "type": item.data_type.to_string(),
                "bits": item.bits,
                "access": item.access,
                "value": bytes.as_ref().map(|bytes| item.data_type.show(bytes)),
                "bytes": bytes,
                "meaning": meaning.as_ref().map(Meaning::json),
            })
        },
    );
    all.collect()
}

fn text(shown: &[Shown]) -> String {
    let rows: Vec<_> = shown
        .iter()
        .map(
            |Shown {
                 item,
                 bytes,
                 meaning,
             }| {
                let value = bytes.as_ref().map(|bytes| item.data_type.show(bytes));
                [
                    item.address.to_string(),
                    item.name.clone(),
                    item.data_type.to_string(),
                    item.bits.to_string(),
                    item.access.clone(),
                    value.unwrap_or_default(),
                    meaning.as_ref().map_or_else(String::new, Meaning::line),
                ]
            },
        )
        .collect();
    let heading = [
        "object", "name", "type", "bits", "access", "value", "meaning",
    ];
    table(heading, &rows)
}

async fn watch(
    tool: &Tool,
    drive: &Drive<'_>,
    objects: &[String],
    every: Duration,
    count: Option<u64>,
) -> Result<(), Failure> {
    let items = find(drive.sdo, objects).await?;
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
            let bytes = drive.sdo.read_bytes(index, subindex).await?;
            if before.as_ref() == Some(&bytes) {
                continue;
            }
            let (at, value) = (started.elapsed(), item.data_type.show(&bytes));
            let meaning = drive.meaning(item, &bytes).await;
            if tool.json {
                let change = json!({
                    "ms": at.as_millis() as u64, "index": index, "subindex": subindex, "value": value,
                    "meaning": meaning.as_ref().map(Meaning::json),
                });
                put(format_args!("{change}\n"))?;
            } else {
                let meaning =
                    meaning.map_or_else(String::new, |meaning| format!("  {}", meaning.line()));
                put(format_args!(
                    "{:9.3} s  {} {} = {value}{meaning}\n",
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
