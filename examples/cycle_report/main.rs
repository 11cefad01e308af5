//! How steady the cycles of a line are on this machine: a table, JSON and a picture.
//!
//! `sudo cycle_report --interface eth0 --seconds 60` brings the drives of a line into OP, runs the cycles for that time with all
//! axes disabled, and tells how late the cycles began, how long the frames were away, what was lost, and which cable damages
//! frames. Without `--interface` a simulated line is measured, in this process. Nothing moves.

mod picture;

use std::{
    error::Error,
    path::PathBuf,
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use servocrab::{
    bus::{
        DevicePorts, DriveConfig, DriveStatistics, Durations, LineDevice, Network, NetworkBuilder,
        RealTime, Scheduling, Statistics, Timing,
    },
    coe::obj,
    drives,
    link::Wire,
};
use servocrab_sim::{Segment, personality};

#[path = "../common/mod.rs"]
#[allow(dead_code, reason = "the other examples use more of it")]
mod common;

use common::{put, table};

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

/// What was measured.
struct Report {
    counted: Statistics,
    timing: Timing,
    drives: Vec<DriveStatistics>,
    /// What the ports counted during the measurement.
    ports: Vec<DevicePorts>,
    intervals: Vec<Interval>,
}

/// A part of the time.
struct Interval {
    /// When it ended, since the begin of the measurement.
    until: Duration,
    timing: Timing,
}

async fn run(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let net = builder(arguments).await?.start().await?;
    let report = measure(arguments, &net).await;
    net.shutdown().await;
    let report = report?;
    if let Some(file) = &arguments.svg {
        picture::draw(file, &report)?;
    }
    if arguments.json {
        put(format_args!(
            "{}\n",
            serde_json::to_string_pretty(&report.json())?
        ))?;
    } else {
        report.print()?;
    }
    Ok(())
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
        .cycle(Duration::from_micros(arguments.cycle_us.into()))
        .real_time(real_time);
    let Some(interface) = &arguments.interface else {
        let mut segment = Segment::new();
        for position in 0..arguments.drives {
            segment.push(personality::akd2g());
            builder = builder.drive(position, named(drives::akd2g(), position));
        }
        return Ok(builder.link(Wire::new(move |frame, now| segment.process(frame, now))));
    };
    let line = Network::builder().interface(interface).scan().await?;
    let mut found = 0;
    for device in line.devices() {
        if let Some(drive) = drive_of(device).await {
            builder = builder.drive(device.id.position, drive);
            found += 1;
        }
    }
    line.close().await;
    if found == 0 {
        return Err("no drive was found on the line".into());
    }
    Ok(builder.interface(interface))
}

/// How a device is driven: by its maker's description, or by the profile's objects; `None` if it is no drive.
async fn drive_of(device: &LineDevice) -> Option<DriveConfig> {
    let known = [
        drives::akd2g(),
        drives::pp2010(),
        drives::ax2000(),
        drives::sigma7(),
    ];
    let position = device.id.position;
    let made = known
        .into_iter()
        .find(|description| description.matches(&device.id.identity));
    if let Some(description) = made {
        return Some(named(description, position));
    }
    let is_drive = device.sdo.as_ref()?.read(obj::STATUSWORD).await.is_ok();
    is_drive.then(|| named(drives::generic(), position))
}

/// A drive with names for its axes.
fn named(description: drives::DriveDescription, position: u16) -> DriveConfig {
    let axes = description.axes.len();
    (1..=axes).fold(DriveConfig::new(description), |drive, axis| {
        drive.axis(&format!("{position}.{axis}"))
    })
}

async fn measure(arguments: &Arguments, net: &Network) -> Result<Report, Box<dyn Error>> {
    let time = Duration::from_secs(arguments.seconds.into());
    let every = (time / 200).max(Duration::from_millis(20));
    let bar = ProgressBar::new(time.as_millis().try_into()?).with_style(
        ProgressStyle::with_template("measuring {bar:40} {eta}  {msg}")?,
    );
    let ports = net.port_errors().await?;
    let drives = net.drive_statistics();
    let (counted, start) = (net.statistics(), net.timing());
    let (mut before, begun) = (start.clone(), Instant::now());
    let mut intervals = Vec::new();
    while begun.elapsed() < time {
        smol::Timer::after(every).await;
        let now = net.timing();
        let timing = since(&now, &before);
        before = now;
        bar.set_position(begun.elapsed().as_millis().try_into()?);
        bar.set_message(format!("{} cycles", before.lateness.count()));
        intervals.push(Interval {
            until: begun.elapsed(),
            timing,
        });
    }
    bar.finish_and_clear();
    Ok(Report {
        counted: counted_since(&net.statistics(), &counted),
        timing: since(&before, &start),
        drives: net
            .drive_statistics()
            .into_iter()
            .zip(drives)
            .map(|(now, before)| DriveStatistics {
                stale_cycles: now.stale_cycles - before.stale_cycles,
                undelivered_cycles: now.undelivered_cycles - before.undelivered_cycles,
                ..now
            })
            .collect(),
        ports: net
            .port_errors()
            .await?
            .into_iter()
            .zip(ports)
            .map(|(now, before)| ports_since(now, &before))
            .collect(),
        intervals,
    })
}

fn since(now: &Timing, before: &Timing) -> Timing {
    Timing {
        lateness: now.lateness.since(&before.lateness),
        round_trip: now.round_trip.since(&before.round_trip),
        phase_error: now.phase_error.since(&before.phase_error),
    }
}

fn counted_since(now: &Statistics, before: &Statistics) -> Statistics {
    Statistics {
        cycles: now.cycles - before.cycles,
        lost: now.lost - before.lost,
        late: now.late - before.late,
        damaged: now.damaged - before.damaged,
        foreign: now.foreign - before.foreign,
        wrong_working_counters: now.wrong_working_counters - before.wrong_working_counters,
        late_cycles: now.late_cycles - before.late_cycles,
        overruns: now.overruns - before.overruns,
        not_sent: now.not_sent - before.not_sent,
        acyclic_in_cycle: now.acyclic_in_cycle - before.acyclic_in_cycle,
        clock: now.clock,
    }
}

fn ports_since(mut now: DevicePorts, before: &DevicePorts) -> DevicePorts {
    for (now, before) in now.ports.iter_mut().zip(&before.ports) {
        // A device that was switched off and on begins anew.
        now.invalid_frames = now.invalid_frames.saturating_sub(before.invalid_frames);
        now.physical = now.physical.saturating_sub(before.physical);
        now.forwarded = now.forwarded.saturating_sub(before.forwarded);
        now.lost_links = now.lost_links.saturating_sub(before.lost_links);
    }
    now
}

/// The shares of the cycles that are told.
const SHARES: [(&str, f64); 3] = [("50 %", 0.5), ("99 %", 0.99), ("99.9 %", 0.999)];

fn microseconds(time: Option<Duration>) -> f64 {
    time.map_or(0.0, |time| time.as_nanos() as f64 / 1e3)
}

impl Report {
    /// What was counted, with its name.
    fn counts(&self) -> [(&'static str, u64); 10] {
        let counted = &self.counted;
        [
            ("cycles", counted.cycles),
            ("late cycles", counted.late_cycles),
            ("overruns", counted.overruns),
            ("lost frames", counted.lost),
            ("late frames", counted.late),
            ("damaged frames", counted.damaged),
            ("foreign frames", counted.foreign),
            ("wrong working counters", counted.wrong_working_counters),
            ("frames not sent", counted.not_sent),
            ("acyclic frames in a cycle", counted.acyclic_in_cycle),
        ]
    }

    fn histograms(&self) -> impl Iterator<Item = (&'static str, &Durations)> {
        let timing = &self.timing;
        [
            ("late by", &timing.lateness),
            ("round trip", &timing.round_trip),
            ("phase error", &timing.phase_error),
        ]
        .into_iter()
        // There is no phase without distributed clocks.
        .filter(|(_, times)| times.count() > 0)
    }

    fn print(&self) -> Result<(), Box<dyn Error>> {
        let counts = self.counts();
        let rows: Vec<_> = counts
            .iter()
            .map(|(name, count)| [(*name).to_owned(), count.to_string()])
            .collect();
        put(table(["counted", ""], &rows))?;
        let rows: Vec<_> = self
            .histograms()
            .map(|(name, times)| {
                let [half, most, nearly] =
                    SHARES.map(|(_, share)| format!("{:.1}", microseconds(times.quantile(share))));
                [
                    name.to_owned(),
                    format!("{:.1}", microseconds(times.least())),
                    half,
                    most,
                    nearly,
                    format!("{:.1}", microseconds(times.most())),
                ]
            })
            .collect();
        let [half, most, nearly] = SHARES.map(|(name, _)| name);
        put("\n")?;
        put(table(["µs", "least", half, most, nearly, "most"], &rows))?;
        let rows: Vec<_> = self
            .drives
            .iter()
            .map(|drive| {
                [
                    drive.drive.to_string(),
                    drive.stale_cycles.to_string(),
                    drive.undelivered_cycles.to_string(),
                ]
            })
            .collect();
        put("\n")?;
        put(table(["drive", "silent cycles", "doubtful cycles"], &rows))?;
        for device in &self.ports {
            for (port, errors) in device.ports.iter().enumerate() {
                if errors.physical > 0 || errors.lost_links > 0 {
                    put(format_args!(
                        "\ndevice {}, port {port}: {} damaged symbols, link lost {} times: look at that cable and its plugs\n",
                        device.position, errors.physical, errors.lost_links
                    ))?;
                }
            }
        }
        Ok(())
    }

    fn json(&self) -> Value {
        let counts: serde_json::Map<String, Value> = self
            .counts()
            .into_iter()
            .map(|(name, count)| (name.replace(' ', "_"), count.into()))
            .collect();
        let times: serde_json::Map<String, Value> = self
            .histograms()
            .map(|(name, times)| {
                let [p50, p99, p999] = SHARES.map(|(_, share)| microseconds(times.quantile(share)));
                let buckets: Vec<_> = times
                    .buckets()
                    .map(|(range, count)| json!([microseconds(Some(*range.end())), count]))
                    .collect();
                let told = json!({
                    "least_us": microseconds(times.least()),
                    "p50_us": p50,
                    "p99_us": p99,
                    "p999_us": p999,
                    "most_us": microseconds(times.most()),
                    "buckets_us": buckets,
                });
                (name.replace(' ', "_"), told)
            })
            .collect();
        let drives: Vec<_> = self
            .drives
            .iter()
            .map(|drive| {
                json!({
                    "position": drive.drive.position,
                    "name": drive.drive.name,
                    "silent_cycles": drive.stale_cycles,
                    "doubtful_cycles": drive.undelivered_cycles,
                })
            })
            .collect();
        let ports: Vec<_> = self
            .ports
            .iter()
            .map(|device| {
                let ports = device.ports.map(|port| {
                    json!({
                        "invalid_frames": port.invalid_frames,
                        "physical": port.physical,
                        "forwarded": port.forwarded,
                        "lost_links": port.lost_links,
                    })
                });
                json!({ "position": device.position, "ports": ports })
            })
            .collect();
        json!({ "counts": counts, "times": times, "drives": drives, "ports": ports })
    }
}
