//! The phase error after power-on: cycles against the reference clock, and another clock against it.

use std::{
    path::Path,
    sync::{Arc, Mutex},
    time::Duration,
};

use plotters::prelude::*;
use servocrab::{
    bus::{DistributedClock, DriveConfig, Network},
    drives,
    link::Wire,
};
use servocrab_sim::{Segment, personality};

use crate::{FOLDER, Result, lock, turn_until};

const CYCLE: Duration = Duration::from_millis(1);
/// What is shown, from power-on.
const END_MS: f64 = 600.0;
/// Where the source address says that a frame is process data, and where an FRMW's data lie.
const TAG: usize = 7;
const CYCLIC: u8 = 0xC5;

const INK: RGBColor = RGBColor(40, 44, 52);
const GRID: RGBColor = RGBColor(225, 228, 232);
const CURVES: [RGBColor; 2] = [RGBColor(0, 92, 175), RGBColor(194, 84, 0)];

/// Milliseconds since power-on, and an error.
type Points = Vec<(f64, f64)>;

/// What one run shows.
#[derive(Default)]
struct Run {
    /// Of the frames, in microseconds.
    phase: Points,
    /// Of the second clock against the reference, in nanoseconds.
    clock: Points,
}

/// Draws both, for a reference whose crystal is too fast and for one that is too slow.
pub(crate) fn phase_after_power_on() -> Result {
    let runs = [run(100.0)?, run(-100.0)?];
    let names = [
        "reference +100 ppm, the other clock -100 ppm",
        "reference -100 ppm, the other clock +100 ppm",
    ];
    std::fs::create_dir_all(FOLDER)?;
    let file = Path::new(FOLDER).join("clocks.svg");
    let root = SVGBackend::new(&file, (1000, 560)).into_drawing_area();
    root.fill(&WHITE)?;
    let style = |size: u32| ("sans-serif", size).into_font().color(&INK);
    let title = "Distributed clocks after power-on, cycles of 1 ms";
    root.draw(&Text::new(title, (20, 14), style(24)))?;
    for (line, (name, color)) in (0..).zip(names.iter().zip(CURVES)) {
        let place = (640, 10 + 18 * line);
        root.draw(&Text::new(*name, place, style(14).color(&color)))?;
    }
    let (_, body) = root.split_vertically(50);
    let (upper, lower) = body.split_vertically(255);
    type Curve = fn(&Run) -> &Points;
    let parts: [(_, _, _, Curve); 2] = [
        (
            &upper,
            "frames at the reference clock, µs",
            -4.0..12.0,
            |run| &run.phase,
        ),
        (&lower, "other clock - reference, ns", -60.0..60.0, |run| {
            &run.clock
        }),
    ];
    for (area, name, range, curve) in parts {
        let mut chart = ChartBuilder::on(area)
            .margin_right(20)
            .set_label_area_size(LabelAreaPosition::Left, 70)
            .set_label_area_size(LabelAreaPosition::Bottom, 40)
            .build_cartesian_2d(0.0..END_MS, range)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(GRID)
            .x_desc("time since power-on, ms")
            .y_desc(name)
            .label_style(style(13))
            .draw()?;
        for (run, color) in runs.iter().zip(CURVES) {
            let points = curve(run).iter().copied();
            chart.draw_series(LineSeries::new(points, color.stroke_width(1)))?;
        }
    }
    root.present()?;
    drop(root);
    println!("{}", file.display());
    Ok(())
}

/// Two drives from power-on on, with crystals that differ by 200 ppm.
fn run(reference_ppm: f64) -> Result<Run> {
    let mut segment = Segment::new();
    for (start, ppm) in [(1_000_000_000, reference_ppm), (77, -reference_ppm)] {
        let mut drive = personality::sigma7();
        drive.set_clock(start, ppm);
        segment.push(drive);
    }
    let seen = Arc::new(Mutex::new(Run::default()));
    let recorded = Arc::clone(&seen);
    let mut shown_until = Duration::ZERO;
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame, now| {
        let is_process_data = frame.get(TAG) == Some(&CYCLIC);
        let comes_back = segment.process(frame, now);
        let [reference, other] = [0, 1].map(|position| {
            let device = segment.device(position);
            device.map_or(0, |device| device.system_time(now))
        });
        let at = now.as_secs_f64() * 1_000.0;
        let mut seen = lock(&recorded);
        if is_process_data {
            let cycle = CYCLE.as_nanos() as i64;
            let late = reference.cast_signed().rem_euclid(cycle);
            let error = if late > cycle / 2 { late - cycle } else { late };
            seen.phase.push((at, error as f64 / 1_000.0));
        }
        let apart = other.wrapping_sub(reference).cast_signed();
        // Before its offset is written, it shows any time.
        if now >= shown_until && apart.abs() < 1_000_000 {
            shown_until = now + CYCLE;
            seen.clock.push((at, apart as f64));
        }
        comes_back
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
    while bus.now().as_secs_f64() * 1_000.0 < END_MS && bus.turn() {}
    let mut seen = lock(&seen);
    Ok(std::mem::take(&mut seen))
}
