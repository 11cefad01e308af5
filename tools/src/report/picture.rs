//! The report as a picture: how many cycles were how late, and when.

use std::{
    error::Error,
    fs::File,
    io::Write,
    path::{Path, PathBuf},
    time::Duration,
};

use plotters::{coord::Shift, element::DashedPathElement, prelude::*};
use servocrab::bus::{Durations, Timing};

use super::{
    measure::{Interval, Report},
    table::microseconds,
};

// Blue, orange and bluish green can be distinguished by everybody (after Okabe and Ito).
const LATE: RGBColor = RGBColor(0, 92, 175);
const ROUND_TRIP: RGBColor = RGBColor(194, 84, 0);
const PHASE: RGBColor = RGBColor(0, 134, 98);
const LOST: RGBColor = RGBColor(200, 30, 60);
const WIDTH: u32 = 1000;
const TITLE: u32 = 30;
const PANEL: u32 = 365;

type Result<T = ()> = std::result::Result<T, Box<dyn Error>>;

/// A time of each cycle that is drawn.
struct Drawn {
    name: &'static str,
    colour: RGBColor,
    of: fn(&Timing) -> &Durations,
}

/// What is drawn together. A phase error follows how late its cycle began, and would cover it.
const SETS: [&[Drawn]; 2] = [
    &[
        Drawn {
            name: "late by",
            colour: LATE,
            of: |timing| &timing.lateness,
        },
        Drawn {
            name: "round trip",
            colour: ROUND_TRIP,
            of: |timing| &timing.round_trip,
        },
    ],
    &[Drawn {
        name: "phase error",
        colour: PHASE,
        of: |timing| &timing.phase_error,
    }],
];

/// A picture that is drawn at the end.
pub(super) struct Picture {
    path: PathBuf,
    file: File,
}

impl Picture {
    pub(super) fn create(path: &Path) -> Result<Self> {
        let file = File::create(path).map_err(|error| format!("{}: {error}", path.display()))?;
        let path = path.to_owned();
        Ok(Self { path, file })
    }

    pub(super) fn complete(mut self, report: &Report) -> Result {
        let mut text = String::new();
        draw(&mut text, report)?;
        let written = self.file.write_all(text.as_bytes());
        written.map_err(|error| format!("{}: {error}", self.path.display()).into())
    }
}

/// Draws a histogram and a time line of each set of times.
fn draw(text: &mut String, report: &Report) -> Result {
    // There is no phase without distributed clocks.
    let clocks = report.timing.phase_error.count() > 0;
    let sets = if clocks { &SETS[..] } else { &SETS[..1] };
    let size = (WIDTH, TITLE + PANEL * 2 * sets.len() as u32);
    let root = SVGBackend::with_string(text, size).into_drawing_area();
    root.fill(&WHITE)?;
    let title = format!(
        "{} cycles: how late they began, how long their frames were away{}",
        report.counted.cycles,
        if clocks {
            ", how far from their phase"
        } else {
            ""
        }
    );
    let area = root.titled(&title, ("sans-serif", 20))?;
    let panels = area.split_evenly((2 * sets.len(), 1));
    for (set, panels) in sets.iter().zip(panels.chunks(2)) {
        let longest = set
            .iter()
            .map(|drawn| microseconds((drawn.of)(&report.timing).most()))
            .fold(1.0, f64::max);
        if let [above, below] = panels {
            histogram(above, report, set, longest)?;
            time_line(below, report, set, longest)?;
        }
    }
    root.present()?;
    Ok(())
}

/// How many cycles there were of each time, both axes logarithmic.
fn histogram(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    report: &Report,
    set: &[Drawn],
    longest: f64,
) -> Result {
    let most = report.counted.cycles.max(10) as f64;
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(70)
        .build_cartesian_2d((0.1..longest * 1.2).log_scale(), (0.8..most).log_scale())?;
    chart
        .configure_mesh()
        .x_desc("µs")
        .y_desc("cycles")
        .light_line_style(TRANSPARENT)
        .draw()?;
    for drawn in set {
        let colour = drawn.colour;
        chart
            .draw_series(bars((drawn.of)(&report.timing), colour))?
            .label(drawn.name)
            .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 12, y + 5)], colour.filled()));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    Ok(())
}

fn bars(times: &Durations, colour: RGBColor) -> impl Iterator<Item = Rectangle<(f64, f64)>> + '_ {
    times.buckets().map(move |(range, count)| {
        let from = microseconds(Some(*range.start())).max(0.1);
        // A bucket reaches to where the next one begins.
        let to = microseconds(Some(*range.end() + Duration::from_nanos(1))).max(from * 1.01);
        Rectangle::new([(from, 0.8), (to, count as f64)], colour.mix(0.6).filled())
    })
}

/// The worst and the median of each part of the time.
fn time_line(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    report: &Report,
    set: &[Drawn],
    longest: f64,
) -> Result {
    let end = report
        .intervals
        .last()
        .map_or(1.0, |last| last.until.as_secs_f64());
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(70)
        .build_cartesian_2d(0.0..end, (0.1..longest * 1.2).log_scale())?;
    chart
        .configure_mesh()
        .x_desc("s")
        .y_desc("µs")
        .light_line_style(TRANSPARENT)
        .draw()?;
    type Read = fn(&Durations) -> Option<Duration>;
    let reads: [(&str, u32, Read); 2] = [
        ("worst", 2, Durations::most),
        ("median", 1, |times| times.quantile(0.5)),
    ];
    let lines = set.iter().flat_map(|drawn| reads.map(|read| (drawn, read)));
    for (drawn, (which, width, read)) in lines {
        let style = drawn
            .colour
            .mix(if width == 1 { 0.5 } else { 1.0 })
            .stroke_width(width);
        let point = |part: &Interval| {
            let time = microseconds(Some(read((drawn.of)(&part.timing))?)).max(0.1);
            Some((part.until.as_secs_f64(), time))
        };
        // Where nothing came back there is no line.
        let runs = report.intervals.split(|part| point(part).is_none());
        let mut named = false;
        for run in runs.filter(|run| !run.is_empty()) {
            let series = chart.draw_series(LineSeries::new(run.iter().filter_map(point), style))?;
            if !named {
                named = true;
                series
                    .label(format!("{}, {which}", drawn.name))
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], style));
            }
        }
    }
    if set.iter().any(|drawn| drawn.colour == PHASE)
        && let Some(clock) = report.counted.clock
    {
        let bound = microseconds(Some(clock.bound)).max(0.1);
        let style = PHASE.stroke_width(1);
        chart
            .draw_series(DashedLineSeries::new(
                [(0.0, bound), (end, bound)],
                6,
                4,
                style,
            ))?
            .label("bound")
            .legend(move |(x, y)| DashedPathElement::new([(x, y), (x + 14, y)], 4, 3, style));
    }
    if report.intervals.iter().any(|part| part.lost > 0) {
        let froms = std::iter::once(0.0)
            .chain(report.intervals.iter().map(|part| part.until.as_secs_f64()));
        let parts = froms
            .zip(&report.intervals)
            .filter(|(_, part)| part.lost > 0);
        let marks = parts.map(|(from, part)| {
            let corners = [(from, 0.1), (part.until.as_secs_f64(), 0.13)];
            Rectangle::new(corners, LOST.filled())
        });
        chart
            .draw_series(marks)?
            .label("frames lost or not sent")
            .legend(|(x, y)| Rectangle::new([(x, y - 5), (x + 12, y + 5)], LOST.filled()));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerLeft)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    Ok(())
}
