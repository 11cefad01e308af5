//! The phase error after power-on: cycles against the reference clock.

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
/// What is shown, from the first frame on.
const CYCLES: usize = 300;
/// Where the source address says that a frame is process data.
const TAG: usize = 7;
const CYCLIC: u8 = 0xC5;

const INK: RGBColor = RGBColor(40, 44, 52);
const GRID: RGBColor = RGBColor(225, 228, 232);
const CURVES: [RGBColor; 2] = [RGBColor(0, 92, 175), RGBColor(194, 84, 0)];

/// Draws it for a reference whose crystal is too fast and for one that is too slow.
pub(crate) fn phase_after_power_on() -> Result {
    let runs = [
        (100.0, "reference +100 ppm"),
        (-100.0, "reference -100 ppm"),
    ];
    std::fs::create_dir_all(FOLDER)?;
    let file = Path::new(FOLDER).join("clocks.svg");
    let root = SVGBackend::new(&file, (1000, 360)).into_drawing_area();
    root.fill(&WHITE)?;
    let style = |size: u32| ("sans-serif", size).into_font().color(&INK);
    let title = "Frames against the reference clock after power-on, cycles of 1 ms";
    root.draw(&Text::new(title, (20, 14), style(24)))?;
    let (_, body) = root.split_vertically(50);
    let mut chart = ChartBuilder::on(&body)
        .margin_right(20)
        .set_label_area_size(LabelAreaPosition::Left, 70)
        .set_label_area_size(LabelAreaPosition::Bottom, 40)
        .build_cartesian_2d(0.0..CYCLES as f64, -4.0..12.0)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(GRID)
        .x_desc("cycles")
        .y_desc("phase error, µs (bound: 20)")
        .label_style(style(13))
        .draw()?;
    for (line, ((ppm, name), color)) in (0..).zip(runs.into_iter().zip(CURVES)) {
        let place = (780, 20 + 20 * line);
        body.draw(&Text::new(name, place, style(14).color(&color)))?;
        let errors = run(ppm)?.into_iter().take(CYCLES);
        let points = (0..)
            .zip(errors)
            .map(|(cycle, error)| (f64::from(cycle), error));
        chart.draw_series(LineSeries::new(points, color.stroke_width(2)))?;
    }
    root.present()?;
    drop(chart);
    drop(root);
    println!("{}", file.display());
    Ok(())
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
            .filter(|_| frame.get(TAG) == Some(&CYCLIC))
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
