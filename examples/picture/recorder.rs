//! Remembers every cycle of simulated axes, and what was asked of them.

use std::sync::{Arc, Mutex};

use servocrab_sim::CycleRecord;

use super::{Mark, Panel, Row, Step, lock};

/// What the axes of one simulated drive did in each of their cycles.
#[derive(Clone)]
pub(crate) struct Recorder {
    inner: Arc<Mutex<Recording>>,
}

struct Recording {
    panels: Vec<Panel>,
    last_s: f64,
}

impl Recorder {
    /// A recorder of one axis for each name.
    pub(crate) fn new(names: &[&str]) -> Self {
        let panels = names.iter().map(|name| Panel::new(name)).collect();
        let recording = Recording {
            panels,
            last_s: 0.0,
        };
        Self {
            inner: Arc::new(Mutex::new(recording)),
        }
    }

    /// What the segment calls after each cycle of a drive.
    pub(crate) fn observer(&self) -> impl FnMut(&CycleRecord<'_>) + Send + 'static {
        let recorder = self.clone();
        move |record| {
            let row = Row::of_model(record.time, record.model);
            recorder.row(record.axis - 1, row);
        }
    }

    /// Remembers what an axis, counted from zero, did.
    pub(crate) fn row(&self, axis: usize, row: Row) {
        let mut recording = lock(&self.inner);
        recording.last_s = row.time_s;
        if let Some(panel) = recording.panels.get_mut(axis) {
            panel.rows.push(row);
        }
    }

    /// Something is asked of an axis, counted from zero, now.
    pub(crate) fn mark(&self, axis: usize, text: &str) {
        let mut recording = lock(&self.inner);
        let time_s = recording.last_s;
        if let Some(panel) = recording.panels.get_mut(axis) {
            let text = text.to_owned();
            panel.marks.push(Mark { time_s, text });
        }
    }

    /// What was recorded from `lead_s` before the first mark on; the times begin there.
    pub(crate) fn panels(&self, lead_s: f64) -> Vec<Panel> {
        let recording = lock(&self.inner);
        let marks = recording.panels.iter().flat_map(|panel| &panel.marks);
        let begin = marks.map(|mark| mark.time_s).fold(f64::MAX, f64::min) - lead_s;
        // Whole microseconds, so that a picture does not depend on when a run began.
        let since = |time_s: f64| ((time_s - begin) * 1e6).round() / 1e6;
        let panels = recording.panels.iter();
        panels
            .map(|panel| Panel {
                name: panel.name.clone(),
                rows: panel
                    .rows
                    .iter()
                    .filter(|row| since(row.time_s) >= 0.0)
                    .map(|row| Row {
                        time_s: since(row.time_s),
                        ..*row
                    })
                    .collect(),
                marks: panel
                    .marks
                    .iter()
                    .map(|mark| Mark {
                        time_s: since(mark.time_s),
                        ..mark.clone()
                    })
                    .collect(),
                steps: panel
                    .steps
                    .iter()
                    .map(|step| Step {
                        time_s: since(step.time_s),
                        ..*step
                    })
                    .collect(),
            })
            .collect()
    }
}
