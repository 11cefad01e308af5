//! What both axes did, as a picture: position, velocity and the bits of the handshake over time, with the commands.

use std::path::Path;

use plotters::{
    coord::{Shift, types::RangedCoordf64},
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

/// One axis after one drive cycle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    pub(crate) time_s: f64,
    pub(crate) position: f64,
    pub(crate) velocity: f64,
    pub(crate) controlword: u16,
    pub(crate) statusword: u16,
}

/// A command at its time.
#[derive(Debug, Clone)]
pub(crate) struct Mark {
    pub(crate) time_s: f64,
    pub(crate) axis: usize,
    pub(crate) text: String,
}

type Result = std::result::Result<(), Box<dyn std::error::Error>>;

const WIDTH: u32 = 1500;
const PANEL: u32 = 560;
const INK: RGBColor = RGBColor(40, 44, 52);
const GRID: RGBColor = RGBColor(225, 228, 232);
const POSITION: RGBColor = RGBColor(0, 92, 175);
const VELOCITY: RGBColor = RGBColor(0, 135, 90);
const ENABLED: RGBColor = RGBColor(233, 245, 236);
const STOPPING: RGBColor = RGBColor(255, 240, 214);
const FAULT: RGBColor = RGBColor(252, 224, 224);

/// Name, bit and whether it is of the controlword; drawn from top to bottom.
const BITS: [(&str, u16, bool); 6] = [
    ("new set-point (6040h bit 4)", 4, true),
    ("acknowledge (6041h bit 12)", 12, false),
    ("target reached (6041h bit 10)", 10, false),
    ("halt (6040h bit 8)", 8, true),
    ("quick stop, active low (6040h bit 2)", 2, true),
    ("fault (6041h bit 3)", 3, false),
];

/// Draws one panel per axis.
pub(crate) fn draw(file: &Path, title: &str, axes: &[(&str, Vec<Row>)], marks: &[Mark]) -> Result {
    let panels = u32::try_from(axes.len())?;
    let root = SVGBackend::new(file, (WIDTH, 60 + panels * PANEL)).into_drawing_area();
    root.fill(&WHITE)?;
    let heading = ("sans-serif", 24).into_font().color(&INK);
    root.draw(&Text::new(title.to_owned(), (20, 14), heading))?;
    let (_, body) = root.split_vertically(50);
    let end = axes
        .iter()
        .filter_map(|(_, rows)| rows.last())
        .map(|row| row.time_s)
        .fold(0.1, f64::max)
        + 0.5;
    for (n, (area, (name, rows))) in body
        .split_evenly((axes.len(), 1))
        .iter()
        .zip(axes)
        .enumerate()
    {
        let own: Vec<&Mark> = marks.iter().filter(|mark| mark.axis == n).collect();
        panel(area, name, rows, &own, end)?;
    }
    root.present()?;
    Ok(())
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn panel(area: &Area<'_>, name: &str, rows: &[Row], marks: &[&Mark], end: f64) -> Result {
    let (names, rest) = area.split_vertically(92);
    let (position, rest) = rest.split_vertically(170);
    let (velocity, bits) = rest.split_vertically(120);
    commands(&names, name, marks, end)?;
    curve(
        &position,
        "position, counts",
        rows,
        marks,
        end,
        POSITION,
        |row| row.position,
    )?;
    curve(
        &velocity,
        "velocity, counts/s",
        rows,
        marks,
        end,
        VELOCITY,
        |row| row.velocity,
    )?;
    logic(&bits, rows, marks, end)
}

const LEFT: u32 = 250;

/// The commands above the curves, each at its time, stepped so that none covers the next.
fn commands(area: &Area<'_>, name: &str, marks: &[&Mark], end: f64) -> Result {
    let heading = ("sans-serif", 20).into_font().color(&INK);
    area.draw(&Text::new(name.to_owned(), (20, 66), heading))?;
    let small = ("sans-serif", 13).into_font().color(&INK);
    let width = f64::from(WIDTH - LEFT - 20);
    let mut ends = [f64::MIN; 5];
    for mark in marks {
        let x = f64::from(LEFT) + mark.time_s / end * width;
        let level = ends
            .iter()
            .position(|&busy| busy < x)
            .unwrap_or(ends.len() - 1);
        // About six and a half pixels a letter at this size.
        ends[level] = x + 6.5 * mark.text.len() as f64 + 10.0;
        let y = 4 + 17 * i32::try_from(level)?;
        area.draw(&PathElement::new(
            [(x as i32, y), (x as i32, 92)],
            INK.mix(0.35),
        ))?;
        area.draw(&Text::new(
            mark.text.clone(),
            (x as i32 + 3, y),
            small.clone(),
        ))?;
    }
    Ok(())
}

fn curve(
    area: &Area<'_>,
    name: &str,
    rows: &[Row],
    marks: &[&Mark],
    end: f64,
    color: RGBColor,
    value: impl Fn(&Row) -> f64,
) -> Result {
    let low = rows.iter().map(&value).fold(0.0, f64::min);
    let high = rows.iter().map(&value).fold(1.0, f64::max);
    let margin = (high - low) * 0.08;
    let mut chart = ChartBuilder::on(area)
        .margin_right(20)
        .set_label_area_size(LabelAreaPosition::Left, LEFT)
        .build_cartesian_2d(0.0..end, low - margin..high + margin)?;
    shade(&mut chart, rows, low - margin, high + margin)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(GRID)
        .y_labels(5)
        .y_label_formatter(&|v| format!("{v:.0}"))
        .x_labels(20)
        .label_style(("sans-serif", 13).into_font().color(&INK))
        .draw()?;
    let style = ("sans-serif", 13).into_font().color(&color);
    let middle = i32::try_from(area.dim_in_pixel().1)? / 2;
    area.draw(&Text::new(name.to_owned(), (20, middle - 8), style))?;
    lines(&mut chart, marks, low - margin, high + margin)?;
    chart.draw_series(LineSeries::new(
        rows.iter().map(|row| (row.time_s, value(row))),
        color.stroke_width(2),
    ))?;
    Ok(())
}

fn logic(area: &Area<'_>, rows: &[Row], marks: &[&Mark], end: f64) -> Result {
    let top = BITS.len() as f64;
    let mut chart = ChartBuilder::on(area)
        .margin_right(20)
        .set_label_area_size(LabelAreaPosition::Left, LEFT)
        .set_label_area_size(LabelAreaPosition::Bottom, 36)
        .build_cartesian_2d(0.0..end, 0.0..top)?;
    shade(&mut chart, rows, 0.0, top)?;
    chart
        .configure_mesh()
        .disable_y_mesh()
        .disable_y_axis()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(GRID)
        .x_desc("time, s   (green: Operation enabled, orange: Quick stop active, red: Fault)")
        .x_labels(20)
        .x_label_formatter(&|v| format!("{v:.1}"))
        .label_style(("sans-serif", 13).into_font().color(&INK))
        .draw()?;
    lines(&mut chart, marks, 0.0, top)?;
    let style = ("sans-serif", 13)
        .into_font()
        .color(&INK)
        .pos(Pos::new(HPos::Right, VPos::Center));
    for (n, (name, bit, of_controlword)) in BITS.iter().enumerate() {
        let base = top - 1.0 - n as f64 + 0.15;
        let high = |row: &Row| {
            let word = if *of_controlword {
                row.controlword
            } else {
                row.statusword
            };
            f64::from(word >> bit & 1)
        };
        let color = if *of_controlword { POSITION } else { VELOCITY };
        let mut steps = Vec::new();
        let mut last = f64::NAN;
        for row in rows {
            let level = high(row);
            if level != last {
                steps.push((row.time_s, base + 0.7 * last.max(0.0)));
                steps.push((row.time_s, base + 0.7 * level));
                last = level;
            }
        }
        steps.push((end, base + 0.7 * last.max(0.0)));
        chart.draw_series(LineSeries::new(steps, color.stroke_width(1)))?;
        let (x, y) = chart.backend_coord(&(0.0, base + 0.35));
        let (left, up) = area.get_base_pixel();
        area.draw(&Text::new(
            (*name).to_owned(),
            (x - left - 8, y - up),
            style.clone(),
        ))?;
    }
    Ok(())
}

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The state behind the curves.
fn shade(chart: &mut Chart<'_, '_>, rows: &[Row], low: f64, high: f64) -> Result {
    let mut begin = 0;
    while let Some(first) = rows.get(begin) {
        let color = color_of(first.statusword);
        let length = rows[begin..]
            .iter()
            .take_while(|row| color_of(row.statusword) == color)
            .count();
        let last = rows
            .get(begin + length)
            .unwrap_or(&rows[begin + length - 1]);
        if let Some(color) = color {
            let corners = [(first.time_s, low), (last.time_s, high)];
            chart.draw_series([Rectangle::new(corners, color.filled())])?;
        }
        begin += length;
    }
    Ok(())
}

fn color_of(statusword: u16) -> Option<RGBColor> {
    match (statusword & 0x6F, statusword & 0x4F) {
        (0x27, _) => Some(ENABLED),
        (0x07, _) => Some(STOPPING),
        (_, 0x08 | 0x0F) => Some(FAULT),
        _ => None,
    }
}

fn lines(chart: &mut Chart<'_, '_>, marks: &[&Mark], low: f64, high: f64) -> Result {
    let series = marks
        .iter()
        .map(|mark| PathElement::new([(mark.time_s, low), (mark.time_s, high)], INK.mix(0.35)));
    chart.draw_series(series)?;
    Ok(())
}
