//! Who is on the line: a table of the SubDevices with their identity, alias, state, clock, PDOs and axes.

use clap::Args;
use serde_json::{Value, json};
use servocrab::{
    bus::{Line, LineDevice},
    coe::{DriveError, SdoError, SdoHandle, obj},
    pdo_map,
};

use crate::{
    line::{Found, LineArguments, OpenLine, found},
    output::{Done, Failure, Tool, bar, table, told},
};

/// Where a program shows the network of the interface, its drives are shown as it has declared them. Else the line is reset; nothing is
/// configured, and the SubDevices are in INIT afterwards.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    line: LineArguments,
}

/// Shows the line; false if something is wrong with a device of it.
pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let line = arguments.line.open(tool).await?;
    let shown = tool.unless_interrupted(show(tool, &line)).await;
    line.close().await;
    shown
}

async fn show(tool: &Tool, line: &OpenLine) -> Result<bool, Failure> {
    let progress = bar("reading");
    let found = seen(line.devices(), told(&progress)).await;
    progress.finish_and_clear();
    let heading = [
        "#", "name", "vendor", "product", "revision", "serial", "alias", "found in", "clock",
        "RxPDOs", "TxPDOs", "axes",
    ];
    let rows: Vec<_> = found.iter().map(Seen::row).collect();
    let mut text = table(heading, &rows);
    for problem in found.iter().flat_map(|seen| &seen.problems) {
        text += &format!("{problem}\n");
    }
    tool.say(&found.iter().map(Seen::json).collect(), text)?;
    Ok(found.iter().all(|seen| seen.problems.is_empty()))
}

/// What `scan --json` says of the line.
pub(crate) async fn json(line: &Line) -> Value {
    let seen = seen(found(line), |_, _| {}).await;
    seen.iter().map(Seen::json).collect()
}

/// All at once: each device has its own mailbox. `told` hears how many of how many are read.
async fn seen<'a>(line: Vec<Found<'a>>, mut told: impl FnMut(usize, usize)) -> Vec<Seen<'a>> {
    let executor = smol::LocalExecutor::new();
    let count = line.len();
    let tasks: Vec<_> = line
        .into_iter()
        .map(|found| executor.spawn(Seen::of(found)))
        .collect();
    let all = async {
        let mut seen = Vec::new();
        for task in tasks {
            seen.push(task.await);
            told(seen.len(), count);
        }
        seen
    };
    executor.run(all).await
}

/// A SubDevice with what its objects say.
struct Seen<'a> {
    found: Found<'a>,
    /// The PDOs that are exchanged, by CoE or else by the SII: of the outputs, of the inputs.
    pdos: [Vec<u16>; 2],
    axes: usize,
    problems: Vec<String>,
}

impl<'a> Seen<'a> {
    async fn of(found: Found<'a>) -> Self {
        let problem = found.device.and_then(|device| device.problem.as_ref());
        let mut problems: Vec<_> = problem.iter().map(ToString::to_string).collect();
        let mut pdos = [Vec::new(), Vec::new()];
        if let Some(sii) = found.device.and_then(|device| device.sii.as_ref()) {
            pdos = [&sii.rx_pdos, &sii.tx_pdos].map(|list| {
                let assigned = list.iter().filter(|pdo| pdo.sync_manager.is_some());
                assigned.map(|pdo| pdo.index).collect()
            });
        }
        let mut axes = 0;
        if let Some(sdo) = found.sdo {
            match count_axes(sdo).await {
                Ok(count) => axes = count,
                Err(error) => problems.push(error.to_string()),
            }
            match pdo_map::read_back(sdo).await {
                Ok(mapping) => {
                    pdos = [mapping.outputs(), mapping.inputs()]
                        .map(|list| list.iter().map(|pdo| pdo.index).collect());
                }
                Err(error) => problems.push(error.to_string()),
            }
        }
        Self {
            found,
            pdos,
            axes,
            problems,
        }
    }

    fn row(&self) -> [String; 12] {
        let Found { id, device, .. } = self.found;
        let identity = id.identity;
        let number = |number: u32| format!("{number:08X}h");
        let clock = |device: &LineDevice| {
            let bits = device.clock_bits;
            bits.map_or("none".into(), |bits| format!("{bits} bits"))
        };
        // A program's line was not scanned.
        let scanned = |shown: &dyn Fn(&LineDevice) -> String| device.map_or("-".into(), shown);
        let [outputs, inputs] = self.pdos.each_ref().map(|list| {
            let shown: Vec<_> = list.iter().map(|index| format!("{index:04X}h")).collect();
            shown.join(" ")
        });
        [
            id.position.to_string(),
            id.name.clone(),
            number(identity.vendor),
            number(identity.product),
            number(identity.revision),
            number(identity.serial),
            scanned(&|device| device.alias.to_string()),
            scanned(&|device| device.found_in.to_string()),
            scanned(&clock),
            outputs,
            inputs,
            self.axes.to_string(),
        ]
    }

    fn json(&self) -> Value {
        let Found { id, sdo, device } = self.found;
        let identity = id.identity;
        let [outputs, inputs] = &self.pdos;
        json!({
            "position": id.position,
            "name": id.name,
            "vendor": identity.vendor,
            "product": identity.product,
            "revision": identity.revision,
            "serial": identity.serial,
            "alias": device.map(|device| device.alias),
            "found_in": device.map(|device| device.found_in.to_string()),
            "clock_bits": device.and_then(|device| device.clock_bits),
            "coe": sdo.is_some(),
            "rx_pdos": outputs,
            "tx_pdos": inputs,
            "axes": self.axes,
            "problems": self.problems,
        })
    }
}

/// The axes of a drive, by their statuswords: 6041h, 6841h and so on.
pub(crate) async fn count_axes(sdo: &SdoHandle) -> Result<usize, DriveError> {
    let mut count = 0;
    for axis in 1..=8 {
        match sdo.read(obj::STATUSWORD.axis(axis)).await {
            Ok(_) => count += 1,
            Err(DriveError {
                error: SdoError::Aborted { .. },
                ..
            }) => break,
            Err(error) => return Err(error),
        }
    }
    Ok(count)
}
