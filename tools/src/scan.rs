//! Who is on the line: a table of the SubDevices with their identity, alias, state, clock, PDOs and axes.

use clap::Args;
use serde_json::{Value, json};
use servocrab::{
    bus::{Line, LineDevice},
    coe::{DriveError, SdoError, SdoHandle, obj},
    pdo_map,
};

use crate::{
    line::LineArguments,
    output::{Done, Failure, Tool, table},
};

/// Nothing is configured; the SubDevices are in INIT afterwards.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    line: LineArguments,
}

/// Shows the line; false if something is wrong with a device of it.
pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    let line = arguments.line.scan(tool).await?;
    let shown = tool.unless_interrupted(show(tool, &line)).await;
    line.close().await;
    shown
}

async fn show(tool: &Tool, line: &Line) -> Result<bool, Failure> {
    let found = seen(line).await;
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
    seen(line).await.iter().map(Seen::json).collect()
}

async fn seen(line: &Line) -> Vec<Seen<'_>> {
    let mut found = Vec::new();
    for device in line.devices() {
        found.push(Seen::of(device).await);
    }
    found
}

/// A SubDevice with what its objects say.
struct Seen<'a> {
    device: &'a LineDevice,
    /// The PDOs that are exchanged, by CoE or else by the SII: of the outputs, of the inputs.
    pdos: [Vec<u16>; 2],
    axes: usize,
    problems: Vec<String>,
}

impl<'a> Seen<'a> {
    async fn of(device: &'a LineDevice) -> Self {
        let mut problems: Vec<_> = device.problem.iter().map(ToString::to_string).collect();
        let mut pdos = [Vec::new(), Vec::new()];
        if let Some(sii) = &device.sii {
            pdos = [&sii.rx_pdos, &sii.tx_pdos].map(|list| {
                let assigned = list.iter().filter(|pdo| pdo.sync_manager.is_some());
                assigned.map(|pdo| pdo.index).collect()
            });
        }
        let mut axes = 0;
        if let Some(sdo) = &device.sdo {
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
            device,
            pdos,
            axes,
            problems,
        }
    }

    fn row(&self) -> [String; 12] {
        let device = self.device;
        let identity = device.id.identity;
        let number = |number: u32| format!("{number:08X}h");
        let clock = device.clock_bits;
        let [outputs, inputs] = self.pdos.each_ref().map(|list| {
            let shown: Vec<_> = list.iter().map(|index| format!("{index:04X}h")).collect();
            shown.join(" ")
        });
        [
            device.id.position.to_string(),
            device.id.name.clone(),
            number(identity.vendor),
            number(identity.product),
            number(identity.revision),
            number(identity.serial),
            device.alias.to_string(),
            device.found_in.to_string(),
            clock.map_or("none".into(), |bits| format!("{bits} bits")),
            outputs,
            inputs,
            self.axes.to_string(),
        ]
    }

    fn json(&self) -> Value {
        let device = self.device;
        let identity = device.id.identity;
        let [outputs, inputs] = &self.pdos;
        json!({
            "position": device.id.position,
            "name": device.id.name,
            "vendor": identity.vendor,
            "product": identity.product,
            "revision": identity.revision,
            "serial": identity.serial,
            "alias": device.alias,
            "found_in": device.found_in.to_string(),
            "clock_bits": device.clock_bits,
            "coe": device.sdo.is_some(),
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
