//! One move of an AKD2G in Profile Position mode, on a real link.
//!
//! `sudo pp_move --interface eth0 --to 10000` moves the first axis of the first drive, an AKD2G, to 10 000 counts and exits with 0 when it
//! is there. Ctrl-C stops the axis, disables it and leaves OP in order.
//!
//! Without a drive: make a veth pair, run `servocrab-sim --interface a --drive akd2g` on one end and this on the other.

#[path = "common/interrupt.rs"]
mod interrupt;
#[macro_use]
#[path = "common/say.rs"]
mod say;

use std::{error::Error, process::ExitCode, time::Duration};

use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use interrupt::Interrupt;
use servocrab::{
    Axis, AxisConfig, AxisError, DriveConfig, Network, Outcome, Referencing, SetPoint, drives,
};
use smol::future;

/// The target is a count of the drive, wherever that began: this program does not home.
const UNREFERENCED: Referencing = Referencing::UnreferencedMovesAllowed;

/// One move of one axis of an AKD2G, over a network interface.
#[derive(Parser)]
struct Arguments {
    /// The network interface that the drives are on.
    #[arg(long)]
    interface: String,
    /// Position of the drive in the line, from 0.
    #[arg(long, default_value_t = 0)]
    drive: u16,
    /// Number of the axis in the drive, from 1.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=2))]
    axis: u8,
    /// Move to this position, in counts.
    #[arg(
        long,
        allow_negative_numbers = true,
        required_unless_present = "by",
        conflicts_with = "by"
    )]
    to: Option<i32>,
    /// Move by this distance, in counts.
    #[arg(long, allow_negative_numbers = true)]
    by: Option<i32>,
    /// Profile velocity 6081h, in counts/s.
    #[arg(long, default_value_t = 10_000)]
    velocity: u32,
    /// Profile acceleration and deceleration 6083h and 6084h, in counts/s².
    #[arg(long, default_value_t = 100_000)]
    acceleration: u32,
    /// Time from one cycle to the next, in microseconds.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u64).range(100..=20_000))]
    cycle_us: u64,
    /// After this time without process data the drive stops by itself, in milliseconds; without it: twenty cycles, at least 100 ms.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=6553))]
    watchdog_ms: Option<u64>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    interrupt::run("pp_move", async |interrupt| {
        run(&arguments, interrupt).await
    })
}

async fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Box<dyn Error>> {
    let bar = ProgressBar::new(0).with_style(ProgressStyle::with_template(
        "{wide_bar} {pos}/{len} {msg}",
    )?);
    let shown = bar.clone();
    let mut builder = Network::builder();
    if let Some(time) = arguments.watchdog_ms {
        builder = builder.watchdog(Duration::from_millis(time));
    }
    let start = builder
        .on_progress(move |at| {
            shown.set_length(at.total as u64);
            shown.set_position(at.done as u64);
            shown.set_message(format!("{}", at.step));
        })
        .interface(&arguments.interface)
        .cycle(Duration::from_micros(arguments.cycle_us))
        .drive(
            arguments.drive,
            DriveConfig::new(drives::akd2g())
                .axis(AxisConfig::new("1").referencing(UNREFERENCED))
                .axis(AxisConfig::new("2").referencing(UNREFERENCED)),
        )
        .start();
    let started = interrupt.or(start).await;
    bar.finish_and_clear();
    let net = started.ok_or("interrupted: the bring-up has ended")??;
    let axis = net.axis(&arguments.axis.to_string())?;
    say!("in OP; the axis is at {}", axis.status().position);

    let emergencies = net.all_emergencies();
    let told = async {
        while let Some(report) = emergencies.next().await {
            eprintln!("{report}");
        }
        future::pending().await
    };
    let moved = future::or(told, interrupt.or(one_move(arguments, &axis))).await;
    if let Some(Ok(outcome)) = &moved {
        say!("{outcome:?}");
    }
    // Stops the axis by quick stop where it is moving, then disables it. What became of the move is said first: after a loss neither
    // goes well, and the move's error tells more.
    let disabled = axis.disable().await;
    if disabled.is_ok() {
        say!("disabled at {}", axis.status().position);
    }
    while let Some(report) = emergencies.try_next() {
        eprintln!("{report}");
    }
    let ended = net.shutdown().await;
    if let Some(Err(error)) = moved {
        return Err(error.into());
    }
    disabled?;
    ended?;
    match moved {
        Some(_) => Ok(()),
        None => Err("interrupted: stopped and disabled".into()),
    }
}

async fn one_move(arguments: &Arguments, axis: &Axis) -> Result<Outcome, AxisError> {
    axis.enable().await?;
    say!("enabled");
    let profile_position = axis.profile_position().await?;
    let set_point = SetPoint::new()
        .velocity(arguments.velocity)
        .acceleration(arguments.acceleration)
        .deceleration(arguments.acceleration);
    let motion = match (arguments.to, arguments.by) {
        (Some(target), _) => profile_position.move_abs(target, set_point).await?,
        (None, distance) => {
            profile_position
                .move_rel(distance.unwrap_or(0), set_point)
                .await?
        }
    };
    say!("moving");
    motion.done().await
}
