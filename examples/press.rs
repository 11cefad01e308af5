//! A press fit with a limited torque, by default on an embedded simulated segment: the axis moves fast to the part, slowly until it presses
//! with a third of its rated torque, is held there, and goes back.
//!
//! `--interface eth0 --drive 0` takes a real drive after CiA 402, of which you know that it acknowledges a set-point while it is halted, with
//! 40 mm of free way. Ctrl-C stops the axis, disables it and leaves OP in order.

#[path = "common/interrupt.rs"]
mod interrupt;
#[macro_use]
#[path = "common/say.rs"]
mod say;

use std::{error::Error, process::ExitCode, time::Duration};

use clap::Parser;
use interrupt::Interrupt;
use servocrab::{
    Axis, AxisConfig, AxisError, DriveConfig, Network, Outcome, Referencing, SetPoint,
    coe::obj,
    drives,
    link::Wire,
    units::{Mm, Ratio, Scale},
};
use servocrab_sim::{Segment, personality::Servo};

const COUNTS_PER_MM: u64 = 10_000;
/// Where the part is at the earliest, and how far the press may go, in mm.
const NEAR: f64 = 20.0;
const FURTHEST: f64 = 40.0;
/// In thousandths of the rated torque, and for how long: longer than the peaks of the ramps.
const FORCE: u16 = 333;
const LASTS: Duration = Duration::from_millis(10);

/// Presses a part in, with a limited torque, by a CiA 402 drive.
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
    interrupt::run("press", async |interrupt| run(&arguments, interrupt).await)
}

async fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Box<dyn Error>> {
    let network = match &arguments.interface {
        Some(interface) => Network::builder().interface(interface),
        None => Network::builder().link(wire()?),
    };
    let mut description = drives::generic();
    // No standard says that a drive can do it: this one is known to.
    description.traits.acknowledges_while_halted = true;
    let scale = Scale::counts_per_unit(Ratio::new(COUNTS_PER_MM, 1)?);
    let ram = AxisConfig::new("ram")
        .unit::<Mm>(scale)
        .referencing(Referencing::UnreferencedMovesAllowed)
        .map_input(obj::TORQUE_ACTUAL);
    let start = network
        .cycle(Duration::from_millis(1))
        // Longer than a computer without real time keeps this thread waiting when it is busy.
        .watchdog(Duration::from_millis(500))
        .drive(arguments.drive, DriveConfig::new(description).axis(ram))
        .start();
    let started = interrupt.or(start).await;
    let net = started.ok_or("interrupted: the bring-up has ended")??;
    let ram = net.axis_in::<Mm>("ram")?;
    let done = interrupt.or(press(&ram)).await;
    // Stops the axis by quick stop where it is moving, then disables it.
    let disabled = ram.disable().await;
    let ended = net.shutdown().await;
    done.ok_or("interrupted: stopped and disabled")??;
    disabled?;
    Ok(ended?)
}

/// A part 25 mm in front of the ram: 1 ‰ of the rated torque presses it in by 20 µm.
fn wire() -> Result<Wire, Box<dyn Error>> {
    let mut segment = Segment::new().with(Servo::generic().build());
    let axis = segment.axis_mut(0, 0).ok_or("the drive has no axis")?;
    axis.put_wall(250_000, 0.005);
    Ok(Wire::new(move |frame, now| segment.process(frame, now)))
}

async fn press(ram: &Axis<Mm>) -> Result<(), AxisError> {
    ram.enable().await?;
    let positions = ram.profile_position().await?;
    let fast = SetPoint::new()
        .velocity(200.0)
        .acceleration(2_000.0)
        .deceleration(2_000.0);
    positions.move_abs(NEAR, fast).await?.done().await?;
    let slowly = fast.velocity(20.0).until_torque(FORCE, LASTS);
    let motion = positions.move_abs(FURTHEST, slowly).await?;
    match motion.done().await? {
        Outcome::Contact { position, torque } => {
            say!("pressed with {torque} ‰ of the rated torque at {position:.2} mm");
            let stands = ram.status().position;
            say!("held at {stands:.2} mm, enabled: no stop and no enable is needed");
        }
        outcome => {
            say!("nothing was in the way: {outcome}");
        }
    }
    positions.move_abs(0.0, fast).await?.done().await?;
    say!("back");
    positions.release().await
}
