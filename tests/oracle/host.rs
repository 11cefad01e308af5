//! The axis core under test, in some scenarios as two that step differently: whatever they write, report or know must be the same.

use core::time::Duration;

use servocrab::axis::{AxisCore, CommandId, CoreConfig, Event, Inputs, Snapshot};

use crate::cable::Told;
use crate::words::{INPUT_BYTES, OUTPUT_BYTES, Outputs};

#[derive(Clone)]
struct Way {
    core: AxisCore,
    outputs: [u8; OUTPUT_BYTES],
    /// Whether it steps on outputs that are kept, and knows which inputs are unchanged.
    kept: bool,
}

pub struct Host {
    way: Way,
    other: Option<Box<Way>>,
    last: [u8; INPUT_BYTES],
    steps: u64,
    /// How both differ.
    pub differs: Option<String>,
    /// Cycles that were stepped as cheaply as can be, and those of them in which the axis moved.
    pub idle: (u64, u64),
}

impl Host {
    pub fn new(config: CoreConfig, kept: bool, both: bool) -> Self {
        let way = Way {
            core: AxisCore::new(config),
            outputs: [0; OUTPUT_BYTES],
            kept,
        };
        Self {
            other: both.then(|| {
                Box::new(Way {
                    kept: !kept,
                    ..way.clone()
                })
            }),
            way,
            last: [0; INPUT_BYTES],
            steps: 0,
            differs: None,
            idle: (0, 0),
        }
    }

    pub fn outputs(&self) -> Outputs {
        Outputs::read(&self.way.outputs)
    }

    pub fn snapshot(&self) -> Snapshot {
        self.way.core.snapshot()
    }

    pub fn step(&mut self, now: Duration, told: Told, image: &[u8; INPUT_BYTES]) {
        let unchanged = told != Told::Stale && self.last == *image;
        let moves = self.last[3..7] != image[3..7];
        if told != Told::Stale {
            self.last = *image;
        }
        let idle = self.way.step(now, told.inputs(image), unchanged);
        self.idle.0 += u64::from(idle);
        self.idle.1 += u64::from(idle && moves);
        if let Some(other) = &mut self.other {
            other.step(now, told.inputs(image), unchanged);
            self.steps += 1;
            if self.way.outputs != other.outputs || self.steps.is_multiple_of(16) {
                self.compare("a step");
            }
        }
    }

    pub fn is_armed(&self, id: CommandId) -> bool {
        self.way.core.is_armed(id)
    }

    pub fn poll_event(&mut self) -> Option<(CommandId, Event)> {
        let event = self.way.core.poll_event();
        if let Some(other) = &mut self.other {
            let reports = other.core.poll_event();
            if reports != event && self.differs.is_none() {
                self.differs = Some(format!("one reports {event:?}, the other {reports:?}"));
            }
        }
        event
    }

    /// Calls the core, or both of them.
    pub fn call<T>(&mut self, mut of: impl FnMut(&mut AxisCore, &mut [u8]) -> T) {
        of(&mut self.way.core, &mut self.way.outputs);
        if let Some(other) = &mut self.other {
            of(&mut other.core, &mut other.outputs);
            self.compare("a call");
        }
    }

    fn compare(&mut self, what: &str) {
        let Some(other) = &self.other else { return };
        let (one, two) = (self.way.core.snapshot(), other.core.snapshot());
        if (self.way.outputs != other.outputs || one != two) && self.differs.is_none() {
            let outputs = Outputs::read(&other.outputs);
            self.differs = Some(format!(
                "after {what} one writes {:?} and knows {one:?}, the other {outputs:?} and {two:?}",
                self.outputs()
            ));
        }
    }
}

impl Way {
    /// Whether it had nothing to do.
    fn step(&mut self, now: Duration, inputs: Inputs<'_>, unchanged: bool) -> bool {
        let (core, outputs) = (&mut self.core, &mut self.outputs);
        if self.kept {
            return !core.step_kept(now, inputs, unchanged, outputs);
        }
        core.step(now, inputs, outputs);
        false
    }
}
