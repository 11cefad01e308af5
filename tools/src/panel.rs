//! The panel in a browser: of the network that a program shows, or, where no program has the interface, of the drives of the line.

use std::time::Duration;

use clap::Args;
use serde_json::json;
use servocrab::{AxisConfig, DriveConfig, Referencing, bus::NetworkBuilder, coe::obj};
use servocrab_attach::{Attach, Grant, forward, serve, socket_of};

use crate::{
    line::LineArguments,
    output::{Done, Failure, Tool},
    report::description_of,
};

/// Where a program shows the network of the interface, its network is shown, with what it grants. Else the drives of the line are
/// brought into OP here, their axes disabled; the panel may move them then. Ctrl-C ends it.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    line: LineArguments,
    /// Port of the loopback interface; 0 for one that is free
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Time from one cycle to the next, in microseconds
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(100..=20_000))]
    cycle_us: u32,
    /// The greatest velocity of a jog, in the drives' units
    #[arg(long, default_value_t = 100_000.0)]
    max_velocity: f64,
    /// Show only: nothing is written or moved
    #[arg(long)]
    read_only: bool,
}

pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    if let Some(interface) = arguments.line.interface()
        && arguments.line.program()?.is_some()
    {
        // A port that is taken is said, and is no reason to open the line.
        let shown = forward(&socket_of(interface), arguments.port);
        let shown = shown.map_err(|error| Failure::from(error.to_string()))?;
        tool.note("a program has this network: what it grants holds");
        say(tool, shown.panel())?;
        tool.interrupted().await;
        return Ok(true);
    }
    let cycle = Duration::from_micros(arguments.cycle_us.into());
    let all = all_drives(tool, &arguments.line, cycle).await?;
    let AllDrives {
        builder,
        axes,
        jogged,
    } = all;
    let start = async { Ok(builder.start().await?) };
    let net = tool.unless_interrupted(start).await?;
    let name = arguments.line.interface();
    let own = format!("panel-{}", std::process::id());
    let mut attach = Attach::new(name.unwrap_or(&own)).loopback(arguments.port);
    if !arguments.read_only {
        let max_velocity = arguments.max_velocity;
        attach = attach
            .grant(Grant::Parameters)
            .grant(Grant::Jog {
                axes: jogged,
                max_velocity,
            })
            .grant(Grant::Motion { axes });
    }
    let shown = serve(&net, attach);
    let said = match &shown {
        Ok(attached) => say(tool, attached.panel().unwrap_or_default()),
        Err(error) => Err(error.to_string().into()),
    };
    if said.is_ok() {
        tool.interrupted().await;
    }
    // The axes first: what ends the server must not keep them from their stop.
    let left = net.shutdown().await;
    drop(shown);
    left?;
    said.map(|()| true)
}

fn say(tool: &Tool, panel: &str) -> Result<(), Failure> {
    let text = format!(
        "{panel}\nOpen this address in a browser of this computer. Who has it may do what is granted. Ctrl-C ends the panel.\n"
    );
    Ok(tool.say(&json!({"panel": panel}), text)?)
}

/// All drives of a line, each by its own description.
pub(crate) struct AllDrives {
    pub(crate) builder: NetworkBuilder,
    /// The names of their axes.
    axes: Vec<String>,
    /// Those that have a target velocity.
    jogged: Vec<String>,
}

pub(crate) async fn all_drives(
    tool: &Tool,
    line: &LineArguments,
    cycle: Duration,
) -> Result<AllDrives, Failure> {
    let mut builder = line.network()?.cycle(cycle);
    let line = line.scan(tool).await?;
    let (mut axes, mut jogged) = (Vec::new(), Vec::new());
    for device in line.devices() {
        let (Some(description), Some(sdo)) = (description_of(device).await, &device.sdo) else {
            continue;
        };
        let position = device.id.position;
        let offsets: Vec<_> = description.axes.iter().map(|axis| axis.offset).collect();
        let mut drive = DriveConfig::new(description);
        for (number, offset) in (1..).zip(offsets) {
            let name = format!("{position}-{number}");
            let mut axis =
                AxisConfig::new(&name).referencing(Referencing::UnreferencedMovesAllowed);
            // Not every drive has the mode of a jog.
            if sdo.read(obj::TARGET_VELOCITY.offset(offset)).await.is_ok() {
                axis = axis.map_output(obj::TARGET_VELOCITY);
                jogged.push(name.clone());
            }
            axes.push(name);
            drive = drive.axis(axis);
        }
        builder = builder.drive(position, drive);
    }
    line.close().await;
    if axes.is_empty() {
        return Err("no drive was found on the line".into());
    }
    Ok(AllDrives {
        builder,
        axes,
        jogged,
    })
}
