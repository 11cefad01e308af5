//! A gantry of two axes, by default on an embedded simulated segment: both home to their own switches, move to and fro together, and stop
//! together when one of them jams.
//!
//! `--interface eth0 --drives 0 1` takes two real drives after CiA 402, whose negative limit switches are square to each other, with 60 mm of
//! free way from there. Nothing jams then. Ctrl-C stops both axes, disables them and leaves OP in order.

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
    AxisConfig, AxisError, DriveConfig, HomingMethod, HomingParameters, Network, SetPoint,
    axis::{AxisErrorKind, Pair, PairError},
    drives,
    link::Wire,
    units::{Mm, Ratio, Scale},
};
use servocrab_sim::{Segment, personality::Servo};

const COUNTS_PER_MM: u64 = 10_000;
/// The skew is warned of, and both are stopped, in mm.
const WARN: f64 = 0.2;
const STOP: f64 = 1.0;
/// While they home, before they know where they are.
const SQUARING: f64 = 5.0;
const FAR: f64 = 60.0;
/// So far is how the simulated gantry stands askew, in counts.
const ASKEW: i64 = 20_000;

/// Moves a gantry of two axes, by CiA 402 drives.
#[derive(Parser)]
struct Arguments {
    /// The network interface that the drives are on; without it, simulated drives in this process.
    #[arg(long)]
    interface: Option<String>,
    /// Positions of both drives in the line, from 0.
    #[arg(long, num_args = 2, default_values_t = [0, 1], requires = "interface")]
    drives: Vec<u16>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    interrupt::run("gantry", async |interrupt| run(&arguments, interrupt).await)
}

async fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Box<dyn Error>> {
    let jam = Arc::new(AtomicBool::new(false));
    let network = match &arguments.interface {
        Some(interface) => Network::builder().interface(interface),
        None => Network::builder().link(wire(&jam)),
    };
    let scale = Scale::counts_per_unit(Ratio::new(COUNTS_PER_MM, 1)?);
    let side = |name: &str| {
        let axis = AxisConfig::new(name).unit::<Mm>(scale);
        DriveConfig::new(drives::generic()).axis(axis)
    };
    let [one, other] = arguments.drives[..] else {
        return Err("a gantry has two drives".into());
    };
    let start = network
        .cycle(Duration::from_millis(1))
        // Longer than a computer without real time keeps this thread waiting when it is busy.
        .watchdog(Duration::from_millis(500))
        .drive(one, side("x1"))
        .drive(other, side("x2"))
        .start();
    let started = interrupt.or(start).await;
    let net = started.ok_or("interrupted: the bring-up has ended")??;
    let gantry = net.pair_in::<Mm>("x1", "x2")?.skew(WARN, STOP)?;
    let moved = async {
        square_and_move(&gantry).await?;
        if arguments.interface.is_none() {
            run_into_a_jam(&gantry, &jam).await?;
        }
        Ok::<(), AxisError>(())
    };
    let done = interrupt.or(moved).await;
    // Stops both by quick stop where they are moving, then disables them.
    let disabled = gantry.disable().await;
    while let Some(event) = net.events().try_next() {
        say!("event: {event}");
    }
    let ended = net.shutdown().await;
    done.ok_or("interrupted: stopped and disabled")??;
    disabled?;
    Ok(ended?)
}

/// Both sides some 30 mm before their switches, one of them 2 mm further. The second one jams when it is told to.
fn wire(jam: &Arc<AtomicBool>) -> Wire {
    let side = |start: i64| {
        Servo::generic().change(move |drive| {
            drive.machine.start = start;
            drive.machine.negative_limit = Some(-300_000);
        })
    };
    let mut segment = Segment::new()
        .with(side(0).build())
        .with(side(ASKEW).build());
    let jam = Arc::clone(jam);
    Wire::new(move |frame, now| {
        if let Some(axis) = segment.axis_mut(1, 0) {
            axis.disturbances().blocked = jam.load(Ordering::Relaxed);
        }
        segment.process(frame, now)
    })
}

fn fast() -> SetPoint<Mm> {
    SetPoint::new()
        .velocity(100.0)
        .acceleration(500.0)
        .deceleration(500.0)
}

async fn square_and_move(gantry: &Pair<Mm>) -> Result<(), AxisError> {
    gantry.enable().await?;
    let homing = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
        .speeds(20.0, 2.0)
        .acceleration(200.0);
    let askew = gantry.square([homing; 2], SQUARING).await?;
    say!("both are home, {askew:.2} mm askew");
    for target in [FAR, 10.0] {
        let motion = gantry.move_abs(target, fast()).await?;
        let [one, other] = motion.done().await?.map(|side| side.position());
        say!("at {one:.2} mm and {other:.2} mm");
    }
    Ok(())
}

fn is_skew(error: &AxisError) -> bool {
    matches!(&error.kind, AxisErrorKind::Pair(error) if matches!(**error, PairError::Skew { .. }))
}

/// The second side jams in the middle of a move: both are stopped.
async fn run_into_a_jam(gantry: &Pair<Mm>, jam: &AtomicBool) -> Result<(), AxisError> {
    let motion = gantry.move_abs(FAR, fast()).await?;
    while gantry.status()[1].position < 30.0 {
        smol::future::yield_now().await;
    }
    jam.store(true, Ordering::Relaxed);
    match motion.done().await {
        Err(error) if is_skew(&error) => {
            say!("jammed, and stopped: {}", error.reason());
            let [one, other] = gantry.status().map(|side| side.position);
            say!("they stand at {one:.2} mm and {other:.2} mm");
            Ok(())
        }
        done => done.map(|_| {
            say!("arrived in spite of the jam");
        }),
    }
}
