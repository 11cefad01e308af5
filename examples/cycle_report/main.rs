//! How steady the cycles of a line are on this machine: a table, JSON and a picture.
//!
//! `sudo cycle_report --interface eth0 --seconds 60` brings the drives of a line into OP, and runs the cycles for that time with
//! all axes disabled. It reports how late the cycles began, how long the frames were away, what was lost, and which cable damages
//! frames. Ctrl-C ends it early, with the report of what was measured until then. Without `--interface` a simulated line is
//! measured, in this process. Nothing moves.
//!
//! With `--clocks` the drives that have distributed clocks follow them, and how far the frames were from their phase at the
//! reference clock is measured too.

mod measure;
mod picture;
mod report;

use std::{error::Error, path::PathBuf, process::ExitCode, time::Duration};

use clap::Parser;
use servocrab::{
    bus::{
        DistributedClock, DriveConfig, LineDevice, Network, NetworkBuilder, RealTime, Scheduling,
    },
    coe::obj,
    drives::{self, DriveDescription},
    link::Wire,
};
use servocrab_sim::{Segment, personality};

#[path = "../common/mod.rs"]
#[allow(dead_code, reason = "the other examples use more of it")]
mod common;

use common::put;

/// SYNC0 alone, what most drives take.
const SYNC0: u16 = 0x0300;

/// Measures how steady the cycles of a line are. The axes stay disabled.
#[derive(Parser)]
struct Arguments {
    /// The network interface that the line is on; without it, a simulated line in this process.
    #[arg(long)]
    interface: Option<String>,
    /// How many two-axis drives the simulated line has.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=32))]
    drives: u16,
    /// Time from one cycle to the next, in microseconds.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(100..=20_000))]
    cycle_us: u32,
    /// How long to measure.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=86_400))]
    seconds: u32,
    /// Synchronise the drives that have a distributed clock by SYNC0. WORD is their assign-activate (registers 0980h and 0981h) in
    /// hexadecimal; without it, what the EEPROM of each names first, or 0300.
    #[arg(long, value_name = "WORD", num_args = 0..=1, require_equals = true, value_parser = word)]
    clocks: Option<Option<u16>>,
    /// Run the bus thread as SCHED_FIFO with this priority, and lock the memory.
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=99))]
    priority: Option<u8>,
    /// Run the bus thread on this processor alone.
    #[arg(long)]
    processor: Option<usize>,
    /// Draw a picture into this file.
    #[arg(long)]
    svg: Option<PathBuf>,
    /// Print JSON in place of a table.
    #[arg(long)]
    json: bool,
}

fn main() -> ExitCode {
    match smol::block_on(run(&Arguments::parse())) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("cycle_report: {error}");
            ExitCode::FAILURE
        }
    }
}

async fn run(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let net = builder(arguments).await?.start().await?;
    let time = Duration::from_secs(arguments.seconds.into());
    let report = measure::measure(&net, time, cycle(arguments)).await;
    net.shutdown().await?;
    let report = report?;
    if arguments.json {
        put(format_args!(
            "{}\n",
            serde_json::to_string_pretty(&report.json())?
        ))?;
    } else {
        report.print()?;
    }
    // Last: a picture that cannot be written costs no report.
    if let Some(file) = &arguments.svg {
        picture::draw(file, &report)?;
    }
    Ok(())
}

fn word(text: &str) -> Result<u16, std::num::ParseIntError> {
    u16::from_str_radix(text.trim_end_matches('h').trim_start_matches("0x"), 16)
}

fn cycle(arguments: &Arguments) -> Duration {
    Duration::from_micros(arguments.cycle_us.into())
}

async fn builder(arguments: &Arguments) -> Result<NetworkBuilder, Box<dyn Error>> {
    let mut real_time = RealTime::new();
    if let Some(priority) = arguments.priority {
        real_time = real_time
            .scheduling(Scheduling::Fifo(priority))
            .lock_memory();
    }
    if let Some(processor) = arguments.processor {
        real_time = real_time.processors([processor]);
    }
    let mut builder = Network::builder()
        .cycle(cycle(arguments))
        .real_time(real_time);
    let Some(interface) = &arguments.interface else {
        let mut segment = Segment::new();
        for position in 0..arguments.drives {
            let mut device = personality::akd2g();
            // No two crystals are alike; these are within 50 ppm, as most are.
            let ppm = f64::from(position * 37 % 101) - 50.0;
            device.set_clock(u64::from(position), ppm);
            segment.push(device);
            let mut drive = named(drives::akd2g(), position);
            if let Some(word) = arguments.clocks {
                drive = drive.dc(DistributedClock::new(word.unwrap_or(SYNC0)));
            }
            builder = builder.drive(position, drive);
        }
        return Ok(builder.link(Wire::new(move |frame, now| segment.process(frame, now))));
    };
    let line = Network::builder().interface(interface).scan().await?;
    let (mut found, mut clocks) = (0, 0);
    for device in line.devices() {
        if let Some(description) = description_of(device).await {
            let position = device.id.position;
            let mut drive = named(description, position);
            if let Some(word) = arguments.clocks
                && let Some(clock) = clock_of(device, word)
            {
                drive = drive.dc(clock);
                clocks += 1;
            }
            builder = builder.drive(position, drive);
            found += 1;
        }
    }
    line.close().await;
    if found == 0 {
        return Err("no drive was found on the line".into());
    }
    if arguments.clocks.is_some() && clocks == 0 {
        return Err(
            "no drive on the line has a distributed clock: measure without --clocks".into(),
        );
    }
    Ok(builder.interface(interface))
}

/// How a drive follows its distributed clock; `None` if it has none. By this word, or by the first of its EEPROM's modes that
/// has SYNC0.
fn clock_of(device: &LineDevice, word: Option<u16>) -> Option<DistributedClock> {
    device.clock_bits?;
    let modes = device.sii.iter().flat_map(|sii| &sii.clock_modes);
    let word = word.unwrap_or_else(|| with_sync0(modes.map(|mode| mode.assign_activate)));
    Some(DistributedClock::new(word))
}

fn with_sync0(mut words: impl Iterator<Item = u16>) -> u16 {
    words.find(|word| word & SYNC0 == SYNC0).unwrap_or(SYNC0)
}

/// How a device is driven: by its maker's description, or by the profile's objects; `None` if it is no drive.
async fn description_of(device: &LineDevice) -> Option<DriveDescription> {
    // A drive answers for its statusword, whoever made it; couplers and terminals of the same maker do not.
    let sdo = device.sdo.as_ref()?;
    sdo.read(obj::STATUSWORD).await.ok()?;
    let known = [drives::akd2g(), drives::ax2000(), drives::sigma7()];
    let made = known
        .into_iter()
        .find(|description| description.matches(&device.id.identity));
    if made.is_some() {
        return made;
    }
    // Of the profile's objects a drive need not have all.
    let mut generic = drives::generic();
    for axis in &mut generic.axes {
        for objects in [&mut axis.outputs, &mut axis.inputs] {
            let mut there = Vec::new();
            for object in std::mem::take(objects) {
                let read = sdo.read_bytes(object.index, object.subindex);
                if read.await.is_ok() {
                    there.push(object);
                }
            }
            *objects = there;
        }
    }
    Some(generic)
}

/// A drive with names for its axes.
fn named(description: DriveDescription, position: u16) -> DriveConfig {
    let axes = description.axes.len();
    (1..=axes).fold(DriveConfig::new(description), |drive, axis| {
        drive.axis(&format!("{position}.{axis}"))
    })
}

#[cfg(test)]
mod tests {
    use servocrab::{bus::Network, link::Wire};
    use servocrab_sim::{
        Segment,
        personality::{self, Servo},
    };

    use super::{
        DistributedClock, DriveDescription, clock_of, description_of, drives, obj, with_sync0, word,
    };

    #[test]
    fn a_clock_is_used_where_there_is_one_by_the_first_mode_that_has_sync0() {
        let mut segment = Segment::new()
            .with(personality::akd2g())
            .with(Servo::generic().clock(None).build());
        let link = Wire::new(move |frame: &mut [u8], now| segment.process(frame, now));
        smol::block_on(async {
            let line = Network::builder().link(link).scan().await.unwrap();
            let clocks =
                |word| [0, 1].map(|position: usize| clock_of(&line.devices()[position], word));
            let clock = DistributedClock::new;
            assert_eq!(clocks(None), [Some(clock(0x0300)), None]);
            assert_eq!(clocks(Some(0x0700)), [Some(clock(0x0700)), None]);
            line.close().await;
        });
        assert_eq!(with_sync0([0x0000, 0x0100, 0x0730].into_iter()), 0x0730);
        assert_eq!(with_sync0([0x0000].into_iter()), 0x0300);
        assert_eq!(["0x0700", "0730h"].map(word), [Ok(0x0700), Ok(0x0730)]);
        assert!(word("SYNC0").is_err());
    }

    #[test]
    fn of_a_mixed_line_the_drives_are_measured_each_by_its_own_description() {
        let mut segment = Segment::new()
            .with(personality::coupler())
            .with(personality::pp2010())
            .with(personality::akd2g())
            .with(personality::io_terminal())
            .with(personality::ax2000())
            .with(personality::sigma7())
            .with(personality::generic());
        let link = Wire::new(move |frame: &mut [u8], now| segment.process(frame, now));
        let names = smol::block_on(async {
            let line = Network::builder().link(link).scan().await.unwrap();
            let mut names = Vec::new();
            for device in line.devices() {
                let description = description_of(device).await;
                names.push(description.map(|description| {
                    let objects = &description.axes[0].inputs;
                    (
                        description.name.to_string(),
                        objects.contains(&obj::VELOCITY_ACTUAL.into()),
                    )
                }));
            }
            line.close().await;
            names
        });
        let name = |description: DriveDescription| description.name.to_string();
        assert_eq!(
            names,
            [
                None,
                // It has no 606Ch.
                Some((name(drives::generic()), false)),
                Some((name(drives::akd2g()), true)),
                None,
                Some((name(drives::ax2000()), true)),
                Some((name(drives::sigma7()), true)),
                Some((name(drives::generic()), true)),
            ]
        );
    }
}
