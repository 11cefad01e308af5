//! The axis of a CiA 402 drive without an absolute encoder, by default of a simulated one in this process. It is homed by its limit switch, and
//! its positions mean something from then on. It moves to some of them, and is jogged for as long as a key would be held.
//!
//! `--interface eth0 --drive 0` takes a real CiA 402 drive with one axis, which has a negative limit switch and nothing in its way. Ctrl-C
//! stops the axis, disables it and leaves OP in order.

#[path = "common/interrupt.rs"]
mod interrupt;
#[macro_use]
#[path = "common/say.rs"]
mod say;

use std::{error::Error, process::ExitCode, time::Duration};

use clap::Parser;
use interrupt::Interrupt;
use servocrab::{
    Axis, AxisConfig, AxisError, DriveConfig, Failure, HomingMethod, HomingParameters, Network,
    SetPoint, coe::obj, drives, link::Wire,
};
use servocrab_sim::{Segment, ds402::Machine, personality::Servo};

/// Encoder counts, and counts/s and counts/s² made of them.
const TURN: u32 = 1 << 16;

/// Homes, moves and jogs the one axis of a CiA 402 drive.
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
    interrupt::run("home_and_jog", async |interrupt| {
        run(&arguments, interrupt).await
    })
}

async fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Box<dyn Error>> {
    let network = match &arguments.interface {
        Some(interface) => Network::builder().interface(interface),
        None => Network::builder().link(wire()),
    };
    let start = network
        .cycle(Duration::from_millis(1))
        // Longer than a computer without real time keeps this thread waiting when it is busy.
        .watchdog(Duration::from_millis(500))
        .drive(
            arguments.drive,
            DriveConfig::new(drives::generic())
                .axis(AxisConfig::new("lift").map_output(obj::TARGET_VELOCITY)),
        )
        .start();
    let started = interrupt.or(start).await;
    let net = started.ok_or("interrupted: the bring-up has ended")??;
    let lift = net.axis("lift")?;
    let done = interrupt.or(use_lift(&lift)).await;
    // Stops the axis by quick stop where it is moving, then disables it.
    let disabled = lift.disable().await;
    let ended = net.shutdown().await;
    done.ok_or("interrupted: stopped and disabled")??;
    disabled?;
    Ok(ended?)
}

async fn use_lift(lift: &Axis) -> Result<(), AxisError> {
    lift.enable().await?;
    unreferenced(lift).await?;
    home(lift).await?;
    move_to(lift, 3 * 65_536).await?;
    jog(lift).await?;
    halted_jog(lift).await
}

/// Somewhere above its negative limit switch, two turns away.
fn wire() -> Wire {
    let shaft = Machine {
        start: 5 * i64::from(TURN),
        negative_limit: Some(3 * i64::from(TURN)),
        ..Machine::default()
    };
    let servo = Servo::generic().change(move |drive| drive.machine = shaft.clone());
    let mut segment = Segment::new().with(servo.build());
    Wire::new(move |frame, now| segment.process(frame, now))
}

/// An absolute move before the homing is refused: nobody knows what the position means.
async fn unreferenced(lift: &Axis) -> Result<(), AxisError> {
    let positions = lift.profile_position().await?;
    match positions.move_abs(65_536, SetPoint::new()).await {
        Err(error) if error.failure() == Some(Failure::NotReferenced) => {
            say!("before homing: {}", error.kind);
        }
        Err(error) => return Err(error),
        Ok(_) => {
            say!("before homing: moved, which must not be");
        }
    }
    positions.release().await
}

async fn home(lift: &Axis) -> Result<(), AxisError> {
    let homing = lift.homing().await?;
    let parameters = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
        .speeds(4 * TURN, TURN / 4)
        .acceleration(40 * TURN)
        .offset(0);
    let homed = homing
        .home(parameters)
        // A lift that has not found its switch by then is stopped.
        .within(Duration::from_secs(20))
        .await?;
    say!(
        "homed by the negative limit switch, at {}; referenced: {}",
        homed.position,
        lift.status().referenced
    );
    homing.release().await
}

async fn move_to(lift: &Axis, target: i32) -> Result<(), AxisError> {
    let positions = lift.profile_position().await?;
    let set_point = SetPoint::new()
        .velocity(8 * TURN)
        .acceleration(80 * TURN)
        .deceleration(80 * TURN);
    let outcome = positions.move_abs(target, set_point).await?.done().await?;
    say!("after homing: {outcome:?}");
    positions.release().await
}

/// A velocity while the key is held; dropping the `Jog` would stop the axis as well.
async fn jog(lift: &Axis) -> Result<(), AxisError> {
    let velocities = lift.profile_velocity().await?;
    let before = lift.status().position;
    let held = velocities.jog(2 * 65_536).await?;
    pause(300).await;
    say!("jogging at {} counts/s", lift.status().velocity);
    held.set(-65_536)?;
    pause(300).await;
    say!("and back at {} counts/s", lift.status().velocity);
    held.release().await?;
    let status = lift.status();
    say!(
        "let go: stands at {:+} counts from where it was, velocity {}",
        status.position - before,
        status.velocity
    );
    velocities.release().await
}

/// A halt ends a jog for good: resuming brings no motion back.
async fn halted_jog(lift: &Axis) -> Result<(), AxisError> {
    let velocities = lift.profile_velocity().await?;
    let held = velocities.jog(2 * 65_536).await?;
    pause(200).await;
    lift.halt().await?;
    if let Err(error) = held.set(65_536) {
        say!("halted, the jog says: {}", error.kind);
    }
    lift.resume().await?;
    pause(200).await;
    say!("resumed: velocity {}", lift.status().velocity);
    drop(held);
    velocities.release().await
}

async fn pause(milliseconds: u64) {
    smol::Timer::after(Duration::from_millis(milliseconds)).await;
}
