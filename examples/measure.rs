//! A part is measured by a touch probe, by default on an embedded simulated segment. The drive holds the position of each edge while the axis
//! moves on. Then the axis touches the part: it moves until the edge, and stops there.
//!
//! `--interface eth0 --drive 0` takes a real drive after CiA 402 with a part of 10 to 60 mm in front of its touch probe 1. The axis moves
//! 100 mm to and fro. Ctrl-C stops it, disables it and leaves OP in order.

#[path = "common/interrupt.rs"]
mod interrupt;
#[macro_use]
#[path = "common/say.rs"]
mod say;

use std::{error::Error, process::ExitCode, time::Duration};

use clap::Parser;
use interrupt::Interrupt;
use servocrab::{
    Axis, AxisConfig, AxisError, DriveConfig, Move, Network, ProfilePosition, Referencing,
    SetPoint,
    axis::{ArmedProbe, Edge, Probe, Probed},
    coe::obj,
    drives,
    link::Wire,
    units::{Mm, Ratio, Scale},
};
use servocrab_sim::{Segment, ds402::Mark, personality::Servo};

const COUNTS_PER_MM: u64 = 10_000;
/// The axis moves so far in mm, and at so many mm/s.
const TRAVEL: f64 = 100.0;
const SPEED: f64 = 100.0;

/// Measures a part with the touch probe of a CiA 402 drive.
#[derive(Parser)]
struct Arguments {
    /// The network interface that the drive is on; without it, a simulated drive in this process.
    #[arg(long)]
    interface: Option<String>,
    /// Position of the drive in the line, from 0.
    #[arg(long, default_value_t = 0, requires = "interface")]
    drive: u16,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    interrupt::run("measure", async |interrupt| {
        run(&arguments, interrupt).await
    })
}

async fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Box<dyn Error>> {
    let network = match &arguments.interface {
        Some(interface) => Network::builder().interface(interface),
        None => Network::builder().link(wire()),
    };
    let scale = Scale::counts_per_unit(Ratio::new(COUNTS_PER_MM, 1)?);
    // With these three an edge is known in the cycle after it. What is not mapped goes by SDO.
    let probe = AxisConfig::new("feed")
        .unit::<Mm>(scale)
        .referencing(Referencing::UnreferencedMovesAllowed)
        .map_output(obj::TOUCH_PROBE_FUNCTION)
        .map_input(obj::TOUCH_PROBE_STATUS)
        .map_input(obj::TOUCH_PROBE_1_POSITIVE)
        .map_input(obj::TOUCH_PROBE_1_NEGATIVE);
    let start = network
        .cycle(Duration::from_millis(1))
        // Longer than a computer without real time keeps this thread waiting when it is busy.
        .watchdog(Duration::from_millis(500))
        .drive(
            arguments.drive,
            DriveConfig::new(drives::generic()).axis(probe),
        )
        .start();
    let started = interrupt.or(start).await;
    let net = started.ok_or("interrupted: the bring-up has ended")??;
    let feed = net.axis_in::<Mm>("feed")?;
    let done = interrupt.or(use_feed(&feed)).await;
    // Stops the axis by quick stop where it is moving, then disables it.
    let disabled = feed.disable().await;
    let ended = net.shutdown().await;
    done.ok_or("interrupted: stopped and disabled")??;
    disabled?;
    Ok(ended?)
}

/// A part from 20 to 62.345 mm in front of the probe.
fn wire() -> Wire {
    let part = Mark::new(200_000, 623_449);
    let servo = Servo::generic().change(move |drive| drive.machine.probes[0] = Some(part));
    let mut segment = Segment::new().with(servo.build());
    Wire::new(move |frame, now| segment.process(frame, now))
}

fn at(speed: f64) -> SetPoint<Mm> {
    SetPoint::new()
        .velocity(speed)
        .acceleration(1_000.0)
        .deceleration(1_000.0)
}

async fn use_feed(feed: &Axis<Mm>) -> Result<(), AxisError> {
    feed.enable().await?;
    let positions = feed.profile_position().await?;
    measure(feed, &positions).await?;
    touch(feed, &positions).await?;
    positions.release().await
}

/// Both edges of the part, one after the other, beside one move.
async fn measure(feed: &Axis<Mm>, positions: &ProfilePosition<Mm>) -> Result<(), AxisError> {
    let front = feed.probe(Probe::One).edge(Edge::Rising).arm().await?;
    let motion = positions.move_rel(TRAVEL, at(SPEED)).await?;
    let Some(begins) = edge_of(front, &motion).await? else {
        say!("the move has arrived, and there was no part");
        return Ok(());
    };
    say!("the part begins at {begins:.3} mm; the axis moves on");
    let back = feed.probe(Probe::One).edge(Edge::Falling).arm().await?;
    if let Some(ends) = edge_of(back, &motion).await? {
        let length = ends - begins;
        say!("it ends at {ends:.3} mm: it is {length:.3} mm long");
    } else {
        say!("it is longer than the way that is left");
    }
    motion.done().await?;
    Ok(())
}

/// The position of the edge; none where the move has arrived without one. The probe is disarmed then.
async fn edge_of(probe: ArmedProbe<Mm>, motion: &Move<Mm>) -> Result<Option<f64>, AxisError> {
    let edge = async { probe.latched().await.map(Some) };
    let arrived = async { motion.done().await.map(|_| None) };
    smol::future::or(edge, arrived).await
}

/// Back, until the probe meets the part from the other side.
async fn touch(feed: &Axis<Mm>, positions: &ProfilePosition<Mm>) -> Result<(), AxisError> {
    let back = positions.rel(-TRAVEL, at(SPEED / 5.0));
    match positions
        .move_until_probe(back, feed.probe(Probe::One))
        .await?
    {
        Probed::Edge { position } => {
            let behind = position - feed.status().position;
            say!("touched at {position:.3} mm, and stood {behind:.1} mm behind that");
        }
        Probed::NoEdge(outcome) => {
            say!("nothing was touched: {outcome}");
        }
    }
    // The move is over. The axis may be without power.
    feed.enable().await?;
    let away = positions.move_rel(5.0, at(SPEED)).await?;
    away.done().await?;
    Ok(())
}
