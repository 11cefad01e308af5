//! The shortest cycle against the number of axes, by the formula of docs/scaling.md.

use std::path::Path;

use plotters::prelude::*;

use crate::{FOLDER, Result, cable::Cable};

const MOST_AXES: usize = 256;
const INK: RGBColor = RGBColor(40, 44, 52);
const GRID: RGBColor = RGBColor(225, 228, 232);
/// Bytes of an axis, outputs and inputs, axes of a drive, what that is, and its colour.
const CURVES: [(usize, usize, &str, RGBColor); 4] = [
    (
        60,
        1,
        "60 bytes an axis, one axis a drive",
        RGBColor(150, 30, 90),
    ),
    (
        30,
        1,
        "30 bytes (default mapping), one axis a drive",
        RGBColor(194, 84, 0),
    ),
    (
        30,
        2,
        "30 bytes (default mapping), two axes a drive",
        RGBColor(0, 92, 175),
    ),
    (
        14,
        2,
        "14 bytes (words, modes, positions), two axes a drive",
        RGBColor(60, 130, 60),
    ),
];

pub(crate) fn shortest_cycle() -> Result {
    std::fs::create_dir_all(FOLDER)?;
    let file = Path::new(FOLDER).join("scaling.svg");
    let root = SVGBackend::new(&file, (1000, 480)).into_drawing_area();
    root.fill(&WHITE)?;
    let style = |size: u32| ("sans-serif", size).into_font().color(&INK);
    let title = "Shortest cycle on 100 Mbit/s: 4/3 of the frames' time on the cable";
    root.draw(&Text::new(title, (20, 14), style(24)))?;
    let (_, body) = root.split_vertically(50);
    let mut chart = ChartBuilder::on(&body)
        .margin_right(20)
        .set_label_area_size(LabelAreaPosition::Left, 70)
        .set_label_area_size(LabelAreaPosition::Bottom, 40)
        .build_cartesian_2d(0..MOST_AXES, 0.0..2_200.0)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(GRID)
        .x_desc("axes")
        .y_desc("cycle, µs")
        .label_style(style(13))
        .draw()?;
    for (line, (bytes, in_a_drive, name, color)) in (0..).zip(CURVES) {
        let points = (1..=MOST_AXES / in_a_drive).map(|drives| {
            let cable = Cable {
                drives,
                bytes: bytes * in_a_drive,
                clock: true,
                metres: 2 * drives,
            };
            let cycle = cable.nanoseconds() as f64 / 1e3 * 4.0 / 3.0;
            (drives * in_a_drive, cycle)
        });
        chart.draw_series(LineSeries::new(points, color.stroke_width(2)))?;
        let place = (100, 60 + 20 * line);
        root.draw(&Text::new(name, place, style(14).color(&color)))?;
    }
    root.present()?;
    drop(root);
    println!("{}", file.display());
    Ok(())
}
