//! A machine whose tool comes and goes under power, by default on an embedded simulated segment: a spindle joins beside a moving axis, turns, is
//! pulled, and joins again.
//!
//! `--interface eth0` takes a real line of drives after CiA 402: the one at position `--drive` is there all the time and moves to and fro, the
//! one with the station alias `--alias` is the tool. Ctrl-C stops both, disables them and leaves OP in order.

#[path = "common/interrupt.rs"]
mod interrupt;
#[macro_use]
#[path = "common/say.rs"]
mod say;

use std::{
    error::Error,
    process::ExitCode,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use clap::Parser;
use interrupt::Interrupt;
use servocrab::{
    Axis, AxisConfig, AxisError, DriveConfig, FailureClass, Network, Referencing, SetPoint,
    bus::{CycleClock, DevicePlace, Expected, HotConnect},
    drives,
    link::Wire,
};
use servocrab_sim::{Segment, personality, personality::Servo};

/// How far the axis that is there all the time moves to and fro, and how far the spindle turns, in counts.
const TRAVEL: i32 = 20_000;
const HOLE: i32 = 5_000;
/// How long the simulated tool stays in after it has joined, and out after it has left.
const IN: Duration = Duration::from_millis(800);
const OUT: Duration = Duration::from_millis(400);

/// Moves an axis, and a tool that comes and goes beside it, by CiA 402 drives.
#[derive(Parser)]
struct Arguments {
    /// The network interface that the drives are on; without it, simulated drives in this process.
    #[arg(long)]
    interface: Option<String>,
    /// Position of the drive that is there all the time, from 0; the tool is not counted.
    #[arg(long, default_value_t = 1, requires = "interface")]
    drive: u16,
    /// Station alias of the tool.
    #[arg(long, default_value_t = 7)]
    alias: u16,
    /// How often the tool is used; it is pulled in between.
    #[arg(long, default_value_t = 2)]
    uses: u32,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    interrupt::run("tool_changer", async |interrupt| {
        run(&arguments, interrupt).await
    })
}

async fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Box<dyn Error>> {
    let is_in = Arc::new(AtomicBool::new(false));
    let network = match &arguments.interface {
        Some(interface) => Network::builder().interface(interface),
        None => Network::builder().link(wire(arguments.alias, &is_in)),
    };
    let drive = |name: &str| {
        // Its moves are relative and need no reference.
        let axis = AxisConfig::new(name).referencing(Referencing::UnreferencedMovesAllowed);
        DriveConfig::new(drives::generic()).axis(axis)
    };
    let tool = DevicePlace::Alias(arguments.alias);
    let couplers = 0..arguments.drive;
    let network = couplers.fold(network, |network, position| {
        network.expect(position, Expected::any())
    });
    let start = network
        .cycle(Duration::from_millis(1))
        // Longer than a computer without real time keeps this thread waiting when it is busy.
        .watchdog(Duration::from_millis(500))
        .drive(arguments.drive, drive("x"))
        .optional("drill", |group| group.drive(tool, drive("spindle")))
        .start();
    let started = interrupt.or(start).await;
    let net = started.ok_or("interrupted: the bring-up has ended")??;
    let (x, spindle) = (net.axis("x")?, net.axis("spindle")?);
    let drill = net.hot_connect("drill")?;
    let clock = net.clock();
    let tools_change = async {
        match arguments.interface {
            // Somebody at the machine does it.
            Some(_) => smol::future::pending().await,
            None => change_tools(&drill, &clock, &is_in).await,
        }
    };
    let work = smol::future::or(use_tool(&drill, &spindle, arguments.uses), to_and_fro(&x));
    let beside = smol::future::or(tell_events(&net), tools_change);
    let done = interrupt.or(smol::future::or(work, beside)).await;
    let disabled = x.disable().await;
    while let Some(event) = net.events().try_next() {
        say!("event: {event}");
    }
    if let Some(lasting) = net.drive_statistics().first() {
        let (drive, silent) = (&lasting.drive, lasting.stale_cycles);
        say!("{drive}: silent in {silent} cycles");
    }
    // Stops and disables the spindle, too.
    let ended = net.shutdown().await;
    done.ok_or("interrupted: stopped and disabled")??;
    disabled?;
    Ok(ended?)
}

/// The tool is used, and is pulled before it is used again.
async fn use_tool(drill: &HotConnect, spindle: &Axis, uses: u32) -> Result<(), Box<dyn Error>> {
    for before in 0..uses {
        if before > 0 {
            drill.left().await?;
        }
        drill.joined().await?;
        match turn(spindle).await {
            Ok(position) => {
                say!("the spindle has turned, and is at {position}");
            }
            Err(error) if is_lost(&error) => {
                say!("the spindle has not turned to its end: {error}");
            }
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

fn is_lost(error: &AxisError) -> bool {
    let failure = error.failure();
    failure.is_some_and(|failure| failure.class() == FailureClass::Lost)
}

/// Disabled at its end, so that it has no torque when it is pulled.
async fn turn(spindle: &Axis) -> Result<i32, AxisError> {
    spindle.enable().await?;
    let mode = spindle.profile_position().await?;
    let turned = mode.move_rel(HOLE, slow()).await?.done().await?;
    spindle.disable().await?;
    Ok(turned.position())
}

async fn to_and_fro(x: &Axis) -> Result<(), Box<dyn Error>> {
    x.enable().await?;
    let mode = x.profile_position().await?;
    loop {
        for way in [TRAVEL, -TRAVEL] {
            mode.move_rel(way, slow()).await?.done().await?;
        }
    }
}

fn slow() -> SetPoint {
    SetPoint::new()
        .velocity(40_000)
        .acceleration(400_000)
        .deceleration(400_000)
}

async fn tell_events(net: &Network) -> Result<(), Box<dyn Error>> {
    while let Some(event) = net.events().next().await {
        say!("event: {event}");
    }
    Ok(())
}

/// A coupler with the tool at its port 3, and the drive that is there all the time behind it.
fn wire(alias: u16, is_in: &Arc<AtomicBool>) -> Wire {
    let mut segment = Segment::new()
        .with(personality::coupler())
        .with(personality::generic());
    let tool = segment.attach(0, 3, Servo::generic().alias(alias).build());
    let is_in = Arc::clone(is_in);
    Wire::new(move |frame, now| {
        match (tool, is_in.load(Ordering::Relaxed)) {
            (Some(tool), true) => segment.plug_in(tool),
            (Some(tool), false) => segment.unplug(tool),
            (None, _) => {}
        }
        segment.process(frame, now)
    })
}

/// Somebody puts the simulated tool in and takes it out.
async fn change_tools(
    drill: &HotConnect,
    clock: &CycleClock,
    is_in: &AtomicBool,
) -> Result<(), Box<dyn Error>> {
    loop {
        is_in.store(true, Ordering::Relaxed);
        drill.joined().await?;
        clock.sleep(IN).await?;
        is_in.store(false, Ordering::Relaxed);
        drill.left().await?;
        clock.sleep(OUT).await?;
    }
}
