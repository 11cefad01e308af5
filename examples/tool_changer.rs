//! A machine whose tools come and go under power, by default on an embedded simulated segment: a spindle joins beside a moving axis, drills,
//! leaves, and joins again.
//!
//! `--interface eth0` takes a real line: drives after CiA 402, of which the first that is there all the time moves, and one with the station
//! alias `--alias` comes and goes. Ctrl-C stops, disables and leaves OP in order.

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
    Axis, AxisConfig, AxisError, DriveConfig, Network, Referencing, SetPoint,
    bus::{CycleClock, DevicePlace, HotConnect},
    drives,
    link::Wire,
};
use servocrab_sim::{Segment, personality, personality::Servo};

/// So far the axis that is there all the time moves to and fro, and so far the spindle turns, in counts.
const WAY: i32 = 20_000;
const HOLE: i32 = 5_000;
/// How long the simulated spindle is in and out.
const IN: Duration = Duration::from_millis(800);
const OUT: Duration = Duration::from_millis(400);

/// Moves an axis, and a tool that comes and goes, by CiA 402 drives.
#[derive(Parser)]
struct Arguments {
    /// The network interface that the drives are on; without it, simulated drives in this process.
    #[arg(long)]
    interface: Option<String>,
    /// Position in the line of the drive that is there all the time, from 0, where the tool is not counted.
    #[arg(long, default_value_t = 1)]
    drive: u16,
    /// Station alias of the tool.
    #[arg(long, default_value_t = 7)]
    alias: u16,
    /// How often the tool is used.
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
        // It turns by so much from where it stands, and needs no reference for that.
        let axis = AxisConfig::new(name).referencing(Referencing::UnreferencedMovesAllowed);
        DriveConfig::new(drives::generic()).axis(axis)
    };
    let tool = DevicePlace::Alias(arguments.alias);
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
    let work = async {
        for _ in 0..arguments.uses {
            use_once(&drill, &spindle).await?;
        }
        Ok(())
    };
    let work = smol::future::or(work, to_and_fro(&x));
    let done = if arguments.interface.is_none() {
        let work = smol::future::or(work, change_tools(&clock, &is_in));
        interrupt.or(work).await
    } else {
        interrupt.or(work).await
    };
    let disabled = x.disable().await;
    while let Some(event) = net.events().try_next() {
        say!("event: {event}");
    }
    let counted = net.drive_statistics();
    if let Some(lasting) = counted.first() {
        say!(
            "{}: silent in {} cycles",
            lasting.drive,
            lasting.stale_cycles
        );
    }
    let ended = net.shutdown().await;
    done.ok_or("interrupted: stopped and disabled")??;
    disabled?;
    Ok(ended?)
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
async fn change_tools(clock: &CycleClock, is_in: &AtomicBool) -> Result<(), Box<dyn Error>> {
    loop {
        is_in.store(true, Ordering::Relaxed);
        clock.sleep(IN).await?;
        is_in.store(false, Ordering::Relaxed);
        clock.sleep(OUT).await?;
    }
}

fn slow() -> SetPoint {
    SetPoint::new()
        .velocity(40_000)
        .acceleration(400_000)
        .deceleration(400_000)
}

async fn to_and_fro(x: &Axis) -> Result<(), Box<dyn Error>> {
    x.enable().await?;
    let mode = x.profile_position().await?;
    loop {
        for way in [WAY, -WAY] {
            mode.move_rel(way, slow()).await?.done().await?;
        }
    }
}

/// The tool comes, turns once, and goes.
async fn use_once(drill: &HotConnect, spindle: &Axis) -> Result<(), Box<dyn Error>> {
    drill.joined().await?;
    say!("`{}` has joined", drill.name());
    match turn(spindle).await {
        Ok(position) => {
            say!("the spindle has turned, and is at {position}");
        }
        // It was taken out meanwhile.
        Err(error) => {
            say!("{error}");
        }
    }
    drill.left().await?;
    say!("`{}` has left", drill.name());
    Ok(())
}

async fn turn(spindle: &Axis) -> Result<i32, AxisError> {
    spindle.enable().await?;
    let mode = spindle.profile_position().await?;
    let turned = mode.move_rel(HOLE, slow()).await?.done().await?;
    spindle.disable().await?;
    Ok(turned.position())
}
