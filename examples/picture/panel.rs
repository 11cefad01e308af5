//! What is drawn.

use std::time::Duration;

use servocrab_sim::ds402::Axis;

/// One axis in one cycle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    pub(crate) time_s: f64,
    pub(crate) position: f64,
    pub(crate) velocity: f64,
    /// 607Ah.
    pub(crate) target: i64,
    pub(crate) controlword: u16,
    pub(crate) statusword: u16,
}

impl Row {
    /// An axis as its simulated drive sees it.
    pub(crate) fn of_model(time: Duration, model: &Axis) -> Self {
        Self {
            time_s: time.as_secs_f64(),
            position: model.position() as f64,
            velocity: model.velocity(),
            target: model.get(0x607A, 0).unwrap_or(0),
            controlword: model.controlword(),
            statusword: model.statusword(),
        }
    }
}

/// A command at its time.
#[derive(Debug, Clone)]
pub(crate) struct Mark {
    pub(crate) time_s: f64,
    pub(crate) text: String,
}

/// A number beside the trace with the place `trace`, counted from the top.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step {
    pub(crate) time_s: f64,
    pub(crate) trace: usize,
    pub(crate) number: u32,
}

/// One axis with what was asked of it.
#[derive(Debug, Clone)]
pub(crate) struct Panel {
    pub(crate) name: String,
    pub(crate) rows: Vec<Row>,
    pub(crate) marks: Vec<Mark>,
    pub(crate) steps: Vec<Step>,
}

impl Panel {
    pub(crate) fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            rows: Vec::new(),
            marks: Vec::new(),
            steps: Vec::new(),
        }
    }
}
