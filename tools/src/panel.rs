//! The panel in a browser: of the network that a program shows, or, where no program has the interface, of the drives of the line.

use clap::Args;
use serde_json::json;
use servocrab::{AxisConfig, Referencing, coe::obj};
use servocrab_attach::{Attach, Grant, forward, serve, socket_of};

use crate::{
    axes::{Drives, DrivesArguments, FoundAxis},
    output::{Done, Failure, Tool},
};

/// Where a program shows the network of the interface, its network is shown, with what it grants. Else the drives of the line are
/// brought into OP here, their axes disabled; the panel may move them then. Ctrl-C ends it.
#[derive(Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    drives: DrivesArguments,
    /// Port of the loopback interface; 0 for one that is free
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// The greatest velocity of a jog, in the axis' unit a second
    #[arg(long, default_value_t = 100_000.0)]
    max_velocity: f64,
    /// Leave the devices that are no drives as they are: their inputs and outputs are not shown
    #[arg(long)]
    drives_only: bool,
    /// Show only: nothing is written or moved
    #[arg(long)]
    read_only: bool,
}

pub(crate) async fn run(tool: &Tool, arguments: &Arguments) -> Done {
    if let Some(interface) = arguments.drives.line.interface()
        && arguments.drives.line.program()?.is_some()
    {
        // A port that is taken is said, and is no reason to open the line.
        let shown = forward(&socket_of(interface), arguments.port);
        let shown = shown.map_err(|error| Failure::from(error.to_string()))?;
        tool.note("a program has this network: what it grants holds");
        say(tool, shown.panel())?;
        tool.interrupted().await;
        return Ok(true);
    }
    let mut found = all_drives(tool, &arguments.drives).await?;
    if arguments.drives_only {
        found = found.without_ios();
    }
    let axes = |is: fn(&FoundAxis) -> bool| {
        let axes = found.axes.iter().filter(|axis| is(axis));
        axes.map(|axis| axis.name.clone()).collect()
    };
    let (axes, jogged) = (axes(|_| true), axes(|axis| axis.jogs));
    let builder = arguments.drives.network(found)?;
    let start = arguments.drives.described.start(builder);
    let net = tool.unless_interrupted(start).await?;
    let name = arguments.drives.line.interface();
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

/// All drives of the line; whoever watches them sees their axes move from wherever they are.
pub(crate) async fn all_drives(tool: &Tool, drives: &DrivesArguments) -> Result<Drives, Failure> {
    let settings = |found: &FoundAxis, axis: AxisConfig| {
        let axis = axis.referencing(Referencing::UnreferencedMovesAllowed);
        match found.jogs {
            true => axis.map_output(obj::TARGET_VELOCITY),
            false => axis,
        }
    };
    drives.find(tool, settings).await
}
