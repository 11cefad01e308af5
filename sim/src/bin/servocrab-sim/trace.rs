//! The trace file: one row for each axis and drive cycle.

use std::io::{self, Write};

use servocrab_sim::CycleRecord;

/// First line of the file; words are decimal, the drive counts from zero, the axis from one.
const HEADER: &str = "time_s,drive,axis,al_state,controlword,statusword,target,position,velocity";

/// Writes rows, and remembers the first failure.
pub(crate) struct Trace<W: Write> {
    output: W,
    failure: Option<io::Error>,
}

impl<W: Write> Trace<W> {
    /// Begins a trace with its header.
    pub(crate) fn new(mut output: W) -> io::Result<Self> {
        writeln!(output, "{HEADER}")?;
        Ok(Self {
            output,
            failure: None,
        })
    }

    /// Writes one row.
    pub(crate) fn record(&mut self, record: &CycleRecord<'_>) {
        let value = |index| record.model.get(index, 0).unwrap_or(0);
        let result = writeln!(
            self.output,
            "{:.6},{},{},{},{},{},{},{},{}",
            record.time.as_secs_f64(),
            record.drive,
            record.axis,
            record.al_state as u8,
            value(0x6040),
            value(0x6041),
            value(0x607A),
            value(0x6064),
            value(0x606C),
        );
        if let Err(error) = result {
            self.failure.get_or_insert(error);
        }
    }

    /// Writes out what is buffered; fails when this or any row before it failed.
    pub(crate) fn flush(&mut self) -> io::Result<()> {
        self.output.flush()?;
        self.failure.take().map_or(Ok(()), Err)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};
    use std::time::Duration;

    use super::*;
    use servocrab_sim::{Segment, personality};

    #[test]
    fn there_is_a_row_for_each_axis_and_cycle_even_without_frames() {
        let trace = Arc::new(Mutex::new(Trace::new(Vec::new()).unwrap()));
        let mut segment = Segment::new()
            .with(personality::coupler())
            .with(personality::akd2g());
        let rows = Arc::clone(&trace);
        segment.observe(move |record| rows.lock().unwrap().record(record));
        segment.advance(Duration::ZERO);
        segment.advance(Duration::from_millis(2));
        let text = String::from_utf8(trace.lock().unwrap().output.clone()).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], HEADER);
        assert_eq!(lines.len(), 1 + 2 * 3);
        assert!(lines[1].starts_with("0.000000,0,1,1,0,"), "{}", lines[1]);
        assert!(lines[6].starts_with("0.002000,0,2,1,0,"), "{}", lines[6]);
    }
}
