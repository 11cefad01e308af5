//! The signals over time as a picture, a panel for each unit.
//!
//! However long the watch takes, the picture has as many points as it is wide: the cycles are kept in parts of the time, each with the
//! least and the greatest value of each signal.

use std::{
    fs::File,
    io::Write,
    path::{Path, PathBuf},
};

use plotters::{coord::Shift, prelude::*};
use servocrab::bus::RecordedValues;
use servocrab_attach::WatchedSignal;

use crate::output::Failure;

// They can be distinguished by everybody (after Okabe and Ito).
const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 92, 175),
    RGBColor(194, 84, 0),
    RGBColor(0, 134, 98),
    RGBColor(176, 82, 140),
    RGBColor(110, 110, 110),
    RGBColor(60, 150, 205),
];
const WIDTH: u32 = 1000;
const TITLE: u32 = 30;
const PANEL: u32 = 280;
/// Parts of the time; one more, and each two become one.
const PARTS: usize = 2 * WIDTH as usize;
/// Greater values are drawn as this one: a range of f64 with its margins is to be a number.
const LARGEST: f64 = 1e300;

/// A picture that is drawn at the end.
pub(super) struct Picture {
    path: PathBuf,
    file: File,
    signals: Vec<WatchedSignal>,
    parts: Parts,
}

impl Picture {
    pub(super) fn create(path: &Path, signals: &[WatchedSignal]) -> Result<Self, Failure> {
        // Before the cycles, and not behind them: they would be lost where it cannot be written.
        let file = File::create(path).map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(Self {
            path: path.to_owned(),
            file,
            signals: signals.to_vec(),
            parts: Parts::default(),
        })
    }

    pub(super) fn take(&mut self, cycle: &RecordedValues) {
        let values = cycle.values.iter().take(self.signals.len()).copied();
        self.parts.take(cycle.time.as_secs_f64(), values);
    }

    pub(super) fn complete(mut self) -> Result<(), Failure> {
        let text = drawn(&self.signals, &self.parts)?;
        let written = self.file.write_all(text.as_bytes());
        written.map_err(|error| format!("{}: {error}", self.path.display()).into())
    }
}

/// The least and the greatest value.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Span {
    least: f64,
    most: f64,
}

impl Span {
    fn with(self, other: Self) -> Self {
        Self {
            least: self.least.min(other.least),
            most: self.most.max(other.most),
        }
    }
}

/// A part of the time: its first cycle's, and what each signal was in it.
struct Part {
    seconds: f64,
    spans: Vec<Option<Span>>,
}

impl Part {
    fn take(&mut self, spans: impl Iterator<Item = Option<Span>>) {
        for (span, other) in self.spans.iter_mut().zip(spans) {
            *span = match (*span, other) {
                (Some(span), Some(other)) => Some(span.with(other)),
                (span, other) => span.or(other),
            };
        }
    }
}

/// At most [`PARTS`], of as many cycles each.
#[derive(Default)]
struct Parts {
    parts: Vec<Part>,
    cycles: u64,
    /// Each two parts have become one so many times.
    halved: u32,
}

impl Parts {
    fn take(&mut self, seconds: f64, values: impl Iterator<Item = Option<f64>>) {
        let spans = values.map(|value| {
            let value = value.filter(|value| value.is_finite())?;
            let value = value.clamp(-LARGEST, LARGEST);
            Some(Span {
                least: value,
                most: value,
            })
        });
        let begins = self.cycles.is_multiple_of(1 << self.halved);
        self.cycles += 1;
        match self.parts.last_mut() {
            Some(last) if !begins => last.take(spans),
            _ => self.parts.push(Part {
                seconds,
                spans: spans.collect(),
            }),
        }
        if self.parts.len() > PARTS {
            self.halve();
        }
    }

    fn halve(&mut self) {
        let mut whole = Vec::with_capacity(PARTS);
        let mut parts = std::mem::take(&mut self.parts).into_iter();
        while let Some(mut part) = parts.next() {
            if let Some(next) = parts.next() {
                part.take(next.spans.into_iter());
            }
            whole.push(part);
        }
        self.parts = whole;
        self.halved += 1;
    }
}

fn drawn(signals: &[WatchedSignal], parts: &Parts) -> Result<String, Failure> {
    let mut units: Vec<&str> = Vec::new();
    for known in signals {
        if !units.contains(&known.unit.as_str()) {
            units.push(&known.unit);
        }
    }
    let mut text = String::new();
    {
        let size = (WIDTH, TITLE + PANEL * units.len() as u32);
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        root.fill(&WHITE)?;
        let title = format!("{} cycles", parts.cycles);
        let area = root.titled(&title, ("sans-serif", 20))?;
        let panels = area.split_evenly((units.len(), 1));
        for (unit, area) in units.iter().zip(&panels) {
            let shown: Vec<_> = signals
                .iter()
                .enumerate()
                .filter(|(_, known)| known.unit == *unit)
                .map(|(column, known)| (column, known.signal.as_str()))
                .collect();
            panel(area, unit, &shown, &parts.parts)?;
        }
        root.present()?;
    }
    Ok(text)
}

/// The signals of one unit, by their columns and names.
fn panel(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    unit: &str,
    signals: &[(usize, &str)],
    parts: &[Part],
) -> Result<(), Failure> {
    let span_of = |part: &Part, column: usize| part.spans.get(column).copied().flatten();
    let begin = parts.first().map_or(0.0, |part| part.seconds);
    let end = parts.last().map_or(0.0, |part| part.seconds - begin);
    let spans = parts.iter().flat_map(|part| {
        let spans = signals.iter().map(|(column, _)| span_of(part, *column));
        spans.flatten()
    });
    let all = spans.reduce(Span::with).unwrap_or(Span {
        least: 0.0,
        most: 0.0,
    });
    // A line at the edge of its panel is hard to see, and a range that is empty cannot be drawn.
    let magnitude = all.most.abs().max(all.least.abs());
    let margin = ((all.most - all.least) * 0.05)
        .max(magnitude * 1e-9)
        .max(0.05);
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(80)
        .build_cartesian_2d(0.0..end.max(1e-6), all.least - margin..all.most + margin)?;
    chart
        .configure_mesh()
        .x_desc("s")
        .y_desc(unit)
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.1))
        .draw()?;
    for ((column, name), colour) in signals.iter().zip(COLOURS.iter().cycle()) {
        let style = colour.stroke_width(1);
        let points = |part: &Part| {
            let span = span_of(part, *column)?;
            let seconds = part.seconds - begin;
            let count = if span.least == span.most { 1 } else { 2 };
            let points = [(seconds, span.least), (seconds, span.most)];
            Some(points.into_iter().take(count))
        };
        // Where nothing was sent there is no line.
        let runs = parts.split(|part| span_of(part, *column).is_none());
        let mut named = false;
        for run in runs.filter(|run| !run.is_empty()) {
            let line = LineSeries::new(run.iter().filter_map(points).flatten(), style);
            let series = chart.draw_series(line)?;
            if !named {
                named = true;
                series
                    .label(*name)
                    .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], style));
            }
        }
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_watch_has_few_parts_and_no_peak_is_lost() {
        let mut parts = Parts::default();
        let cycles = 100 * PARTS as u64 + 7;
        for cycle in 0..cycles {
            let value = if cycle == 12_345 { 1e6 } else { 0.0 };
            parts.take(cycle as f64, [Some(value), None].into_iter());
        }
        assert!((PARTS / 2..=PARTS).contains(&parts.parts.len()));
        assert_eq!(parts.cycles, cycles);
        let seconds = parts.parts.iter().map(|part| part.seconds);
        assert!(seconds.clone().zip(seconds.skip(1)).all(|(a, b)| a < b));
        let peaks = parts.parts.iter().filter_map(|part| part.spans[0]);
        assert_eq!(peaks.filter(|span| span.most == 1e6).count(), 1);
        assert!(parts.parts.iter().all(|part| part.spans[1].is_none()));
    }

    #[test]
    fn what_has_no_cycles_or_one_value_is_drawn_too() {
        let signal = |signal: &str, unit: &str| WatchedSignal {
            signal: signal.into(),
            unit: unit.into(),
        };
        let signals = [signal("x.position", "mm"), signal("x.state", "")];
        let mut parts = Parts::default();
        drawn(&signals, &parts).unwrap();
        parts.take(1.0, [Some(1e12), None].into_iter());
        parts.take(2.0, [None, Some(f64::MAX)].into_iter());
        parts.take(3.0, [Some(f64::NAN), Some(f64::INFINITY)].into_iter());
        let text = drawn(&signals, &parts).unwrap();
        assert!(
            text.contains("x.position") && text.ends_with("</svg>\n"),
            "{text}"
        );
    }
}
