//! In this process only, on a simulated line: a coupler, an AKD2G found by its alias, a terminal with buttons and one with
//! valves. Everything in it is declared, so that a line that was wired otherwise is refused before anything is configured.
//!
//! On a real link, `.interface("eth0")` takes the place of `.link(…)`; the rest stays.

#[macro_use]
#[path = "common/say.rs"]
mod say;

use std::{
    error::Error,
    process::ExitCode,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use clap::Parser;
use servocrab::{
    AxisConfig, DriveConfig, Network, Referencing, SetPoint,
    bus::{DevicePlace, Expected, IoConfig, NetworkBuilder},
    drives,
    link::Wire,
};
use servocrab_sim::{
    Segment,
    personality::{Servo, coupler, digital_inputs, digital_outputs},
};

/// Vendor and product codes of the simulated devices.
const COUPLER: Expected = Expected::new(0, 0x434F_5550);
const INPUTS: Expected = Expected::new(0, 0x4449_3038);
const OUTPUTS: Expected = Expected::new(0, 0x444F_3038);
/// The drive's station alias, as its switches set it.
const LIFT: DevicePlace = DevicePlace::Alias(7);

/// Runs in this process only, on a simulated AKD2G with a coupler and two terminals, and takes no arguments.
#[derive(Parser)]
struct Arguments {}

fn main() -> ExitCode {
    Arguments::parse();
    match smol::block_on(run()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("line_io: {error}");
            ExitCode::FAILURE
        }
    }
}

async fn run() -> Result<(), Box<dyn Error>> {
    // Somebody has exchanged the two terminals.
    let swapped = Segment::new()
        .with(coupler())
        .with(lift())
        .with(digital_outputs())
        .with(digital_inputs());
    let refused = machine(&Line::new(Mutex::new(swapped))).start().await;
    if let Err(error) = refused {
        say!("{error}");
    }

    let segment = Segment::new()
        .with(coupler())
        .with(lift())
        .with(digital_inputs())
        .with(digital_outputs());
    let line = Line::new(Mutex::new(segment));
    let net = machine(&line).start().await?;
    for io in [net.io("buttons")?, net.io("valves")?] {
        let first = io.points().first().map(ToString::to_string);
        say!("{}: {}", io.name(), first.unwrap_or_default());
    }
    let start = net.io("buttons")?.input::<bool>("Channel 1.Input")?;
    let gripper = net.io("valves")?.output::<bool>("Channel 3.Output")?;

    press(&line, 0b0000_0001);
    // Inputs that the last cycle did not bring are an error: no button counts as pressed by them.
    let clock = net.clock();
    while start.get() != Ok(true) {
        clock.next_cycle().await?;
    }
    say!("the start button is pressed");
    gripper.set(true);

    let axis = net.axis("lift")?;
    axis.enable().await?;
    let positions = axis.profile_position().await?;
    let set_point = SetPoint::new()
        .velocity(500_000)
        .acceleration(5_000_000)
        .deceleration(5_000_000);
    let moved = positions.move_abs(50_000, set_point).await?.done().await?;
    say!("lift: {moved:?}");
    say!("valves: {:08b}", outputs(&line));
    axis.disable().await?;
    net.shutdown().await?;
    say!("valves at the end: {:08b}", outputs(&line));
    Ok(())
}

/// What the machine has, wherever it is wired.
fn machine(line: &Line) -> NetworkBuilder {
    let drive = DriveConfig::new(drives::akd2g())
        .axis(AxisConfig::new("lift").referencing(Referencing::AbsoluteEncoder));
    let segment = Arc::clone(line);
    Network::builder()
        .link(Wire::new(move |frame, now| {
            let mut segment = segment.lock().unwrap_or_else(PoisonError::into_inner);
            segment.process(frame, now)
        }))
        .cycle(Duration::from_millis(1))
        .expect(0, COUPLER.named("coupler"))
        .drive(LIFT, drive)
        .io(2, IoConfig::new("buttons", INPUTS.named("8 inputs")))
        .io(3, IoConfig::new("valves", OUTPUTS.named("8 outputs")))
        .complete()
}

/// The simulated segment, of which this program is the wiring as well.
type Line = Arc<Mutex<Segment>>;

fn lift() -> servocrab_sim::Device {
    Servo::akd2g().alias(7).absolute_encoder().build()
}

fn press(line: &Line, buttons: u8) {
    let mut segment = line.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(terminal) = segment.device_mut(2) {
        terminal.set_inputs(&[buttons]);
    }
}

fn outputs(line: &Line) -> u8 {
    let segment = line.lock().unwrap_or_else(PoisonError::into_inner);
    segment.last_outputs(3).first().copied().unwrap_or_default()
}
