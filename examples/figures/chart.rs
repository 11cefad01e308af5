//! A chart with its title, as the figures have it.

use std::{ops::Range, path::PathBuf};

use plotters::{
    coord::{Shift, types::RangedCoordf64},
    prelude::*,
};

use crate::{FOLDER, Result};

const WIDTH: u32 = 1000;
/// What the title takes of the height.
const TITLE: u32 = 50;
const INK: RGBColor = RGBColor(40, 44, 52);
const GRID: RGBColor = RGBColor(225, 228, 232);
const MOMENT: RGBColor = RGBColor(130, 135, 142);
/// A line of text, as a part of the chart's height.
const SHORTER: f64 = 0.055;

/// What stands around the curves.
pub(crate) struct Frame {
    pub(crate) file: &'static str,
    pub(crate) height: u32,
    pub(crate) title: &'static str,
    /// What is drawn to the right, and how far.
    pub(crate) x: (&'static str, f64),
    /// What is drawn upwards, from where to where.
    pub(crate) y: (&'static str, Range<f64>),
    /// Where the names of the curves stand, in pixels below the title.
    pub(crate) names: (i32, i32),
}

/// A curve: its name, its colour, its points.
pub(crate) type Curve = (&'static str, RGBColor, Vec<(f64, f64)>);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Moments, in their order, each a line upwards with its name at the top.
#[derive(Default)]
pub(crate) struct Moments {
    /// How far up the lines go. Every other one is shorter by a line of text, so that it does not cross the name before it.
    pub(crate) height: f64,
    /// Where each is to the right, and its name.
    pub(crate) named: Vec<(f64, &'static str)>,
}

/// Draws the curves into the frame's file and says where that is.
pub(crate) fn draw(frame: &Frame, curves: impl IntoIterator<Item = Curve>) -> Result {
    draw_with(frame, &Moments::default(), curves)
}

/// The same with these moments. A curve without a name goes on with the one before it.
pub(crate) fn draw_with(
    frame: &Frame,
    moments: &Moments,
    curves: impl IntoIterator<Item = Curve>,
) -> Result {
    std::fs::create_dir_all(FOLDER)?;
    let file = PathBuf::from(FOLDER).join(frame.file);
    let root = SVGBackend::new(&file, (WIDTH, frame.height)).into_drawing_area();
    root.fill(&WHITE)?;
    let style = |size: u32| ("sans-serif", size).into_font().color(&INK);
    root.draw(&Text::new(frame.title, (20, 14), style(24)))?;
    let (_, body): (Area<'_>, Area<'_>) = root.split_vertically(TITLE);
    let mut chart: Chart<'_> = ChartBuilder::on(&body)
        .margin_right(20)
        .set_label_area_size(LabelAreaPosition::Left, 70)
        .set_label_area_size(LabelAreaPosition::Bottom, 40)
        .build_cartesian_2d(0.0..frame.x.1, frame.y.1.clone())?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(GRID)
        .x_desc(frame.x.0)
        .x_label_formatter(&|x| format!("{x:.0}"))
        .y_desc(frame.y.0)
        .y_label_formatter(&|y| format!("{y:.0}"))
        .label_style(style(13))
        .draw()?;
    for (number, &(at, name)) in moments.named.iter().enumerate() {
        let Range { start, end } = frame.y.1;
        let shorter = (number % 2) as f64 * SHORTER * (end - start);
        let top = moments.height - shorter;
        chart.draw_series(LineSeries::new([(at, start), (at, top)], MOMENT))?;
        let (x, y) = chart.backend_coord(&(at, top));
        root.draw(&Text::new(name, (x + 5, y - 1), style(13)))?;
    }
    let mut line = 0;
    for (name, color, points) in curves {
        if !name.is_empty() {
            let place = (frame.names.0, frame.names.1 + 20 * line);
            body.draw(&Text::new(name, place, style(14).color(&color)))?;
            line += 1;
        }
        chart.draw_series(LineSeries::new(points, color.stroke_width(2)))?;
    }
    root.present()?;
    drop(chart);
    drop(body);
    drop(root);
    println!("{}", file.display());
    Ok(())
}
