//! The report as a picture: how many cycles were how late, and when.

use std::{error::Error, path::Path, time::Duration};

use plotters::{coord::Shift, prelude::*};
use servocrab::bus::Durations;

use crate::{
    measure::{Interval, Report},
    report::microseconds,
};

// Blue and orange can be told apart by everybody (after Okabe and Ito).
const LATE: RGBColor = RGBColor(0, 92, 175);
const ROUND_TRIP: RGBColor = RGBColor(194, 84, 0);
const LOST: RGBColor = RGBColor(200, 30, 60);
const SIZE: (u32, u32) = (1000, 760);

type Result<T = ()> = std::result::Result<T, Box<dyn Error>>;

/// Draws both panels.
pub(crate) fn draw(file: &Path, report: &Report) -> Result {
    let root = SVGBackend::new(file, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let title = format!(
        "{} cycles: how late they began, how long their frames were away",
        report.counted.cycles
    );
    let area = root.titled(&title, ("sans-serif", 20))?;
    let (above, below) = area.split_vertically(SIZE.1 / 2);
    let longest = [&report.timing.lateness, &report.timing.round_trip]
        .into_iter()
        .map(|times| microseconds(times.most()))
        .fold(1.0, f64::max);
    histogram(&above, report, longest)?;
    time_line(&below, report, longest)?;
    root.present()?;
    Ok(())
}

/// How many cycles there were of each time, both axes logarithmic.
fn histogram(area: &DrawingArea<SVGBackend<'_>, Shift>, report: &Report, longest: f64) -> Result {
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
    let sets = [
        ("late by", &report.timing.lateness, LATE),
        ("round trip", &report.timing.round_trip, ROUND_TRIP),
    ];
    for (name, times, colour) in sets {
        chart
            .draw_series(bars(times, colour))?
            .label(name)
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
fn time_line(area: &DrawingArea<SVGBackend<'_>, Shift>, report: &Report, longest: f64) -> Result {
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
    type Read = fn(&Interval) -> Option<Duration>;
    let lines: [(&str, RGBColor, u32, Read); 4] = [
        ("late by, worst", LATE, 2, |part| {
            part.timing.lateness.most()
        }),
        ("late by, median", LATE, 1, |part| {
            part.timing.lateness.quantile(0.5)
        }),
        ("round trip, worst", ROUND_TRIP, 2, |part| {
            part.timing.round_trip.most()
        }),
        ("round trip, median", ROUND_TRIP, 1, |part| {
            part.timing.round_trip.quantile(0.5)
        }),
    ];
    for (name, colour, width, read) in lines {
        let style = colour
            .mix(if width == 1 { 0.5 } else { 1.0 })
            .stroke_width(width);
        let point = |part: &Interval| {
            let time = microseconds(Some(read(part)?)).max(0.1);
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
                    .label(name)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], style));
            }
        }
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
