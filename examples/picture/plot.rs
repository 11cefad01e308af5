//! Position, velocity and bits over time as SVG, one panel below the other on the same time axis.

use std::path::Path;

use plotters::{
    coord::{Shift, types::RangedCoordf64},
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use super::{Mark, Panel, Row};

/// Where a trace comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Word {
    /// A bit that the master sets.
    Control(u16),
    /// A bit that the drive shows.
    Status(u16),
    /// 607Ah, as its values.
    Target,
}

/// A trace and its name.
pub(crate) type Bit = (&'static str, Word);

/// What a picture shows and how large it is.
pub(crate) struct Picture<'a> {
    pub(crate) title: &'a str,
    /// Pixels.
    pub(crate) width: u32,
    /// From top to bottom.
    pub(crate) bits: &'a [Bit],
    /// Whether position and velocity are drawn.
    pub(crate) curves: bool,
    /// Whether the drive's state is shown behind the traces.
    pub(crate) states: bool,
    /// Lines for commands above each panel.
    pub(crate) command_lines: u32,
    /// Whether time is written in milliseconds.
    pub(crate) milliseconds: bool,
    /// What stands behind the last row, in seconds.
    pub(crate) tail_s: f64,
}

type Result = std::result::Result<(), Box<dyn std::error::Error>>;

// Blue and orange can be distinguished by everybody (after Okabe and Ito); what the drive says is thicker too.
const INK: RGBColor = RGBColor(40, 44, 52);
const GRID: RGBColor = RGBColor(225, 228, 232);
const MASTER: RGBColor = RGBColor(0, 92, 175);
const DRIVE: RGBColor = RGBColor(194, 84, 0);
const ENABLED: RGBColor = RGBColor(233, 245, 236);
const STOPPING: RGBColor = RGBColor(255, 240, 214);
const FAULT: RGBColor = RGBColor(252, 224, 224);

const LEFT: u32 = 250;
const RIGHT: u32 = 20;
const TITLE: u32 = 50;
const COMMAND_HEIGHT: u32 = 17;
const POSITION_HEIGHT: u32 = 170;
const VELOCITY_HEIGHT: u32 = 120;
const TRACE_HEIGHT: u32 = 23;
const TIME_HEIGHT: u32 = 40;
const GAP: u32 = 14;

impl Picture<'_> {
    /// Draws one panel below the other.
    pub(crate) fn draw(&self, file: &Path, panels: &[Panel]) -> Result {
        std::fs::create_dir_all(file.parent().ok_or("a picture needs a folder")?)?;
        let count = u32::try_from(panels.len())?;
        let height = TITLE + 10 + count * self.panel_height();
        let root = SVGBackend::new(file, (self.width, height)).into_drawing_area();
        root.fill(&WHITE)?;
        root.draw(&Text::new(self.title.to_owned(), (20, 14), text(24, INK)))?;
        let (_, body) = root.split_vertically(TITLE);
        let ends = panels.iter().filter_map(|panel| panel.rows.last());
        let end = ends.map(|row| row.time_s).fold(0.0, f64::max) + self.tail_s;
        for (area, panel) in body.split_evenly((panels.len(), 1)).iter().zip(panels) {
            self.panel(&area.margin(0, GAP, 0, 0), panel, end)?;
        }
        root.present()?;
        Ok(())
    }

    fn panel_height(&self) -> u32 {
        let curves = if self.curves {
            POSITION_HEIGHT + VELOCITY_HEIGHT
        } else {
            0
        };
        self.commands_height() + curves + self.bits.len() as u32 * TRACE_HEIGHT + TIME_HEIGHT + GAP
    }

    fn commands_height(&self) -> u32 {
        7 + self.command_lines * COMMAND_HEIGHT
    }

    fn panel(&self, area: &Area<'_>, panel: &Panel, end: f64) -> Result {
        let (names, mut rest) = area.split_vertically(self.commands_height());
        self.commands(&names, panel, end)?;
        if self.curves {
            let (position, below) = rest.split_vertically(POSITION_HEIGHT);
            let (velocity, below) = below.split_vertically(VELOCITY_HEIGHT);
            let curve = |row: &Row| row.position;
            self.curve(&position, "position, counts", panel, end, curve)?;
            let curve = |row: &Row| row.velocity;
            self.curve(&velocity, "velocity, counts/s", panel, end, curve)?;
            rest = below;
        }
        self.logic(&rest, panel, end)
    }

    /// The commands above the curves, each at its time, stepped so that none covers the next.
    fn commands(&self, area: &Area<'_>, panel: &Panel, end: f64) -> Result {
        let bottom = i32::try_from(self.commands_height())?;
        let place = (20, bottom - 26);
        area.draw(&Text::new(panel.name.clone(), place, text(18, INK)))?;
        let width = f64::from(self.width - LEFT - RIGHT);
        let mut ends = vec![f64::MIN; self.command_lines as usize];
        for mark in &panel.marks {
            let x = f64::from(LEFT) + mark.time_s / end * width;
            let level = ends
                .iter()
                .position(|&busy| busy < x)
                .unwrap_or(ends.len() - 1);
            // About six and a half pixels a letter at this size.
            ends[level] = x + 6.5 * mark.text.len() as f64 + 10.0;
            let y = 4 + COMMAND_HEIGHT as i32 * i32::try_from(level)?;
            area.draw(&PathElement::new(
                [(x as i32, y), (x as i32, bottom)],
                INK.mix(0.35),
            ))?;
            area.draw(&Text::new(
                mark.text.clone(),
                (x as i32 + 3, y),
                text(13, INK),
            ))?;
        }
        Ok(())
    }

    fn ticks(&self) -> usize {
        (self.width / 75) as usize
    }

    fn curve(
        &self,
        area: &Area<'_>,
        name: &str,
        panel: &Panel,
        end: f64,
        value: impl Fn(&Row) -> f64,
    ) -> Result {
        let low = panel.rows.iter().map(&value).fold(0.0, f64::min);
        let high = panel.rows.iter().map(&value).fold(1.0, f64::max);
        let margin = (high - low) * 0.08;
        let mut chart = ChartBuilder::on(area)
            .margin_right(RIGHT)
            .set_label_area_size(LabelAreaPosition::Left, LEFT)
            .build_cartesian_2d(0.0..end, low - margin..high + margin)?;
        self.shade(&mut chart, &panel.rows, low - margin, high + margin)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(GRID)
            .y_labels(5)
            .y_label_formatter(&|v| format!("{v:.0}"))
            .x_labels(self.ticks())
            .label_style(text(13, INK))
            .draw()?;
        let middle = i32::try_from(area.dim_in_pixel().1)? / 2;
        area.draw(&Text::new(
            name.to_owned(),
            (20, middle - 8),
            text(13, DRIVE),
        ))?;
        lines(&mut chart, &panel.marks, low - margin, high + margin)?;
        let mut points: Vec<_> = panel
            .rows
            .iter()
            .map(|row| (row.time_s, value(row)))
            .collect();
        points.extend(points.last().map(|last| (end, last.1)));
        // A seventh of a pixel is not seen; coordinates are whole pixels.
        let pixel = (high - low + 2.0 * margin) / f64::from(area.dim_in_pixel().1);
        chart.draw_series(LineSeries::new(
            thinned(&points, 0.15 * pixel),
            DRIVE.stroke_width(2),
        ))?;
        Ok(())
    }

    fn logic(&self, area: &Area<'_>, panel: &Panel, end: f64) -> Result {
        let top = self.bits.len() as f64;
        let mut chart = ChartBuilder::on(area)
            .margin_right(RIGHT)
            .set_label_area_size(LabelAreaPosition::Left, LEFT)
            .set_label_area_size(LabelAreaPosition::Bottom, 36)
            .build_cartesian_2d(0.0..end, 0.0..top)?;
        self.shade(&mut chart, &panel.rows, 0.0, top)?;
        let unit = if self.milliseconds { "ms" } else { "s" };
        let background = if self.states {
            "   (green: Operation enabled, orange: Quick stop active, red: Fault)"
        } else {
            ""
        };
        chart
            .configure_mesh()
            .disable_y_mesh()
            .disable_y_axis()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(GRID)
            .x_desc(format!("time, {unit}{background}"))
            .x_labels(self.ticks())
            .x_label_formatter(&|v| {
                if self.milliseconds {
                    format!("{:.0}", v * 1000.0)
                } else {
                    format!("{v:.1}")
                }
            })
            .label_style(text(13, INK))
            .draw()?;
        lines(&mut chart, &panel.marks, 0.0, top)?;
        for (n, (name, word)) in self.bits.iter().enumerate() {
            let base = top - 1.0 - n as f64 + 0.15;
            match *word {
                Word::Control(bit) => {
                    let steps = levels(&panel.rows, end, base, |row| row.controlword >> bit & 1);
                    chart.draw_series(LineSeries::new(steps, MASTER.stroke_width(1)))?;
                }
                Word::Status(bit) => {
                    let steps = levels(&panel.rows, end, base, |row| row.statusword >> bit & 1);
                    chart.draw_series(LineSeries::new(steps, DRIVE.stroke_width(2)))?;
                }
                Word::Target => values(area, &mut chart, &panel.rows, end, base)?,
            }
            at(area, &chart, (0.0, base + 0.35), (-8, 0), name, HPos::Right)?;
        }
        for step in &panel.steps {
            let middle = top - 0.5 - step.trace as f64;
            let number = format!("({})", step.number);
            at(
                area,
                &chart,
                (step.time_s, middle),
                (-5, 0),
                &number,
                HPos::Right,
            )?;
        }
        Ok(())
    }

    /// The state behind the curves.
    fn shade(&self, chart: &mut Chart<'_, '_>, rows: &[Row], low: f64, high: f64) -> Result {
        let mut begin = 0;
        while let Some(first) = rows.get(begin) {
            let color = color_of(first.statusword).filter(|_| self.states);
            let length = rows[begin..]
                .iter()
                .take_while(|row| color_of(row.statusword) == color_of(first.statusword))
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
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

fn text(size: u32, color: RGBColor) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&color)
}

/// A text at a point of the chart, moved by some pixels.
fn at(
    area: &Area<'_>,
    chart: &Chart<'_, '_>,
    point: (f64, f64),
    moved: (i32, i32),
    what: &str,
    side: HPos,
) -> Result {
    let (x, y) = chart.backend_coord(&point);
    let (left, up) = area.get_base_pixel();
    let style = text(13, INK).pos(Pos::new(side, VPos::Center));
    let place = (x - left + moved.0, y - up + moved.1);
    area.draw(&Text::new(what.to_owned(), place, style))?;
    Ok(())
}

/// The corners of a bit's trace.
fn levels(rows: &[Row], end: f64, base: f64, bit: impl Fn(&Row) -> u16) -> Vec<(f64, f64)> {
    let height = |level: u16| base + 0.7 * f64::from(level);
    let mut corners: Vec<(f64, f64)> = Vec::new();
    let mut last = None;
    for row in rows {
        let level = bit(row);
        if last != Some(level) {
            corners.extend(last.map(|before| (row.time_s, height(before))));
            corners.push((row.time_s, height(level)));
            last = Some(level);
        }
    }
    corners.extend(last.map(|level| (end, height(level))));
    corners
}

/// 607Ah as boxes with its value, which meet where it changes.
fn values(area: &Area<'_>, chart: &mut Chart<'_, '_>, rows: &[Row], end: f64, base: f64) -> Result {
    let mut rest = rows;
    while let Some(first) = rest.first() {
        let length = rest
            .iter()
            .take_while(|row| row.target == first.target)
            .count();
        rest = rest.get(length..).unwrap_or_default();
        let until = rest.first().map_or(end, |row| row.time_s);
        let corners = [(first.time_s, base), (until, base + 0.7)];
        chart.draw_series([Rectangle::new(corners, MASTER.stroke_width(1))])?;
        let value = first.target.to_string();
        let middle = (first.time_s.midpoint(until), base + 0.35);
        at(area, chart, middle, (0, 0), &value, HPos::Center)?;
    }
    Ok(())
}

/// The points without those that lie on the way between others, up to `tolerance`.
fn thinned(points: &[(f64, f64)], tolerance: f64) -> Vec<(f64, f64)> {
    let mut kept: Vec<(f64, f64)> = points.first().copied().into_iter().collect();
    let mut from = 0;
    for to in 2..points.len() {
        let (start, stop) = (points[from], points[to]);
        let slope = (stop.1 - start.1) / (stop.0 - start.0);
        let on_the_way = points[from + 1..to]
            .iter()
            .all(|point| (start.1 + slope * (point.0 - start.0) - point.1).abs() <= tolerance);
        if !on_the_way {
            from = to - 1;
            kept.push(points[from]);
        }
    }
    kept.extend(points.last().filter(|_| points.len() > 1));
    kept
}

fn color_of(statusword: u16) -> Option<RGBColor> {
    match (statusword & 0x6F, statusword & 0x4F) {
        (0x27, _) => Some(ENABLED),
        (0x07, _) => Some(STOPPING),
        (_, 0x08 | 0x0F) => Some(FAULT),
        _ => None,
    }
}

fn lines(chart: &mut Chart<'_, '_>, marks: &[Mark], low: f64, high: f64) -> Result {
    let series = marks
        .iter()
        .map(|mark| PathElement::new([(mark.time_s, low), (mark.time_s, high)], INK.mix(0.35)));
    chart.draw_series(series)?;
    Ok(())
}
