//! In this process only, on two simulated CiA 402 drives: one loses its power while the machine runs. The other axis goes on moving, and the
//! program gets an event. When its operator says so the drive is taken back into the running line.
//!
//! On a real link, `.interface("eth0")` takes the place of `.link(…)`; the rest stays.

#[macro_use]
#[path = "common/say.rs"]
mod say;

use std::{
    error::Error,
    process::ExitCode,
    sync::{Arc, Mutex},
    time::Duration,
};

use clap::Parser;
use servocrab::{
    Axis, DriveConfig, HomingMethod, HomingParameters, Network, SetPoint, bus::NetworkEvent,
    drives, link::Wire,
};
use servocrab_sim::{Segment, personality};

/// Runs in this process only, on two simulated CiA 402 drives, and takes no arguments.
#[derive(Parser)]
struct Arguments {}

fn main() -> ExitCode {
    Arguments::parse();
    match smol::block_on(run()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("recover: {error}");
            ExitCode::FAILURE
        }
    }
}

async fn run() -> Result<(), Box<dyn Error>> {
    let segment = Segment::new()
        .with(personality::generic())
        .with(personality::generic());
    let line = Arc::new(Mutex::new((segment, Duration::ZERO)));
    let net = Network::builder()
        .link(wire(&line))
        .cycle(Duration::from_millis(1))
        // Longer than a computer without real time keeps this thread waiting when it is busy.
        .watchdog(Duration::from_millis(500))
        .drive(0, DriveConfig::new(drives::generic()).axis("belt"))
        .drive(1, DriveConfig::new(drives::generic()).axis("lift"))
        .start()
        .await?;
    let (belt, lift) = (net.axis("belt")?, net.axis("lift")?);
    home(&lift).await?;
    say!("lift: referenced: {}", lift.status().referenced);

    belt.enable().await?;
    let belts = belt.profile_position().await?;
    let far = belts.move_rel(300_000, set_point()).await?;
    let lifts = lift.profile_position().await?;
    let up = lifts.move_abs(500_000, set_point()).await?;

    switch(&line, false);
    match up.done().await {
        Err(error) => {
            say!("lift: {}", error.kind);
        }
        Ok(outcome) => {
            say!("lift: {outcome:?}, which must not be");
        }
    }
    let lost = loop {
        match net.events().next().await {
            Some(NetworkEvent::Lost(drive)) => break drive,
            Some(_) => {}
            None => return Err("the network is gone".into()),
        }
    };
    say!(
        "{lost} is lost; the belt moves on: {}",
        belt.status().velocity > 0
    );

    // Somebody has looked what was the matter, and says that the drive may be taken back.
    switch(&line, true);
    let recovered = net.recover(&lost).await?;
    say!("lift: {recovered}");
    let status = lift.status();
    say!(
        "lift: {:?}, referenced: {}",
        status.state,
        status.referenced
    );
    drop(lifts);
    home(&lift).await?;
    let lifts = lift.profile_position().await?;
    let moved = lifts.move_abs(20_000, set_point()).await?.done().await?;
    say!("lift: {moved:?}");

    say!("belt: {:?}", far.done().await?);
    drop((belts, lifts));
    belt.disable().await?;
    lift.disable().await?;
    net.shutdown().await?;
    Ok(())
}

/// A simulated line, and the time of its last frame.
type Line = Arc<Mutex<(Segment, Duration)>>;

fn wire(line: &Line) -> Wire {
    let line = Arc::clone(line);
    Wire::new(move |frame: &mut [u8], now| {
        line.lock().is_ok_and(|mut line| {
            line.1 = now;
            line.0.process(frame, now)
        })
    })
}

/// Switches the lift's drive on or off.
fn switch(line: &Line, on: bool) {
    let Ok(mut line) = line.lock() else { return };
    let now = line.1;
    match line.0.device_mut(1) {
        Some(drive) if on => drive.power_on(now),
        Some(drive) => drive.power_off(),
        None => {}
    }
}

/// Here is zero.
async fn home(lift: &Axis) -> Result<(), Box<dyn Error>> {
    lift.enable().await?;
    let homing = lift.homing().await?;
    homing
        .home(HomingParameters::new(HomingMethod::CURRENT_POSITION))
        .await?;
    Ok(homing.release().await?)
}

fn set_point() -> SetPoint {
    SetPoint::new()
        .velocity(100_000)
        .acceleration(1_000_000)
        .deceleration(1_000_000)
}
