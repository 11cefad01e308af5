//! The cycles as CSV by RFC 4180: a line for each.

use std::{
    fs::File,
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

use servocrab::bus::RecordedValues;
use servocrab_attach::WatchedSignal;

use crate::output::Failure;

/// A CSV file that grows by the cycles.
pub(super) struct Table {
    path: PathBuf,
    file: BufWriter<File>,
    columns: usize,
}

impl Table {
    pub(super) fn create(path: &Path, signals: &[WatchedSignal]) -> Result<Self, Failure> {
        let file = File::create(path).map_err(|error| failed(path, &error))?;
        let mut table = Self {
            path: path.to_owned(),
            file: BufWriter::new(file),
            columns: signals.len(),
        };
        table.put(&heading(signals))?;
        Ok(table)
    }

    pub(super) fn write(&mut self, cycle: &RecordedValues) -> Result<(), Failure> {
        self.put(&row(cycle, self.columns))
    }

    pub(super) fn complete(mut self) -> Result<(), Failure> {
        let flushed = self.file.flush();
        flushed.map_err(|error| failed(&self.path, &error))
    }

    fn put(&mut self, line: &str) -> Result<(), Failure> {
        let written = self.file.write_all(line.as_bytes());
        written.map_err(|error| failed(&self.path, &error))
    }
}

fn failed(path: &Path, error: &std::io::Error) -> Failure {
    format!("{}: {error}", path.display()).into()
}

/// A cycle, with its first values.
pub(super) fn row(cycle: &RecordedValues, columns: usize) -> String {
    let values = cycle.values.iter().take(columns);
    let values = values
        .map(|value| value.map_or_else(|| ",".into(), |value| format!(",{}", rounded(value))));
    let values: String = values.collect();
    format!("{},{:.6}{values}\n", cycle.number, cycle.time.as_secs_f64())
}

/// The first line of the CSV: names of axes and of points may have any characters.
pub(super) fn heading(signals: &[WatchedSignal]) -> String {
    let names = signals.iter().map(|known| match known.unit.as_str() {
        "" => quoted(known.signal.clone()),
        unit => quoted(format!("{} [{unit}]", known.signal)),
    });
    let names: String = names.map(|name| format!(",{name}")).collect();
    format!("cycle,time [s]{names}\n")
}

/// A field of a CSV line by RFC 4180, section 2: in quotes where it has a comma, a quote or the end of a line. A spreadsheet would take one that
/// begins like a formula for that.
fn quoted(field: String) -> String {
    let field = match field.starts_with(['=', '+', '-', '@', '\t', '\r']) {
        true => format!("'{field}"),
        false => field,
    };
    match field.contains([',', '"', '\r', '\n']) {
        true => format!("\"{}\"", field.replace('"', "\"\"")),
        false => field,
    }
}

/// To 12 digits, unless it is a whole number: most have 32 bits before they get a unit, and more digits are those of the conversion.
fn rounded(value: f64) -> f64 {
    if value.fract() == 0.0 {
        return value;
    }
    format!("{value:.11e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_a_comma_or_a_quote_is_one_field_of_the_heading() {
        let known = |signal: &str, unit: &str| WatchedSignal {
            signal: signal.into(),
            unit: unit.into(),
        };
        let signals = [
            known("x.position", "mm"),
            known("gantry, left.position", "mm"),
            known("valves.Channel \"1\".Output", ""),
            known("two\nlines.state", ""),
            known("=2+5.state", ""),
        ];
        assert_eq!(
            heading(&signals),
            "cycle,time [s],x.position [mm],\"gantry, left.position [mm]\",\"valves.Channel \"\"1\"\".Output\",\"two\nlines.state\",'=2+5.state\n"
        );
    }

    #[test]
    fn a_value_has_the_digits_that_it_was_measured_with() {
        for (value, text) in [
            (27.895_999_999_999_997, "27.896"),
            (-0.1 - 0.2, "-0.3"),
            (1e-9 / 3.0, "0.000000000333333333333"),
            (4_294_967_295.0, "4294967295"),
            (9_007_199_254_740_991.0, "9007199254740991"),
            (0.0, "0"),
        ] {
            assert_eq!(rounded(value).to_string(), text);
        }
        assert!(rounded(f64::NAN).is_nan());
    }
}
