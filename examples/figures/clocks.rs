//! The phase error after power-on: cycles against the reference clock.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use plotters::prelude::RGBColor;
use servocrab::{DriveConfig, Network, bus::DistributedClock, drives, link::Wire};
use servocrab_sim::{Segment, personality};

use crate::{
    Result,
    chart::{self, Frame},
    lock, turn_until,
};

const CYCLE: Duration = Duration::from_millis(1);
/// What is shown, from the first frame on.
const CYCLES: usize = 300;
/// Where a frame's first datagram has its index, and which one says that it is no process data.
const TAG: usize = 17;
const ACYCLIC: u8 = 0xFF;

const CURVES: [(f64, &str, RGBColor); 2] = [
    (100.0, "reference +100 ppm", RGBColor(0, 92, 175)),
    (-100.0, "reference -100 ppm", RGBColor(194, 84, 0)),
];

/// Draws it for a reference whose crystal is too fast and for one that is too slow.
pub(crate) fn phase_after_power_on() -> Result {
    let mut curves = Vec::new();
    for (ppm, name, color) in CURVES {
        let errors = run(ppm)?.into_iter().take(CYCLES);
        let points = (0..).map(f64::from).zip(errors);
        curves.push((name, color, points.collect()));
    }
    let frame = Frame {
        file: "clocks.svg",
        height: 360,
        title: "Frames against the reference clock after power-on, cycles of 1 ms",
        x: ("cycles", CYCLES as f64),
        y: ("phase error, µs (bound: 20)", -4.0..12.0),
        names: (780, 20),
    };
    chart::draw(&frame, curves)
}

/// The phase error of each cycle from power-on on, in microseconds, of two drives whose crystals differ by 200 ppm.
fn run(reference_ppm: f64) -> Result<Vec<f64>> {
    let mut segment = Segment::new();
    for (start, ppm) in [(1_000_000_000, reference_ppm), (77, -reference_ppm)] {
        let mut drive = personality::sigma7();
        drive.set_clock(start, ppm);
        segment.push(drive);
    }
    let seen = Arc::new(Mutex::new(Vec::new()));
    let recorded = Arc::clone(&seen);
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame, now| {
        if let Some(reference) = segment
            .device(0)
            .filter(|_| frame.get(TAG).is_some_and(|tag| *tag != ACYCLIC))
        {
            let time = reference.system_time(now).cast_signed();
            let cycle = CYCLE.as_nanos() as i64;
            let late = (time + cycle / 2).rem_euclid(cycle) - cycle / 2;
            lock(&recorded).push(late as f64 / 1_000.0);
        }
        segment.process(frame, now)
    });
    let drive = |axis| {
        let clock = DistributedClock::new(0x0300);
        DriveConfig::new(drives::sigma7()).axis(axis).dc(clock)
    };
    let builder = Network::builder()
        .link(wire)
        .cycle(CYCLE)
        .drive(0, drive("x"))
        .drive(1, drive("y"));
    let (starting, mut bus) = builder.split()?;
    let _net = turn_until(&mut bus, starting.network())?;
    while lock(&seen).len() < CYCLES && bus.turn() {}
    let mut seen = lock(&seen);
    Ok(std::mem::take(&mut seen))
}
