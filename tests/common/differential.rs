//! One axis as two cores that are given the same inputs: one steps as cheaply as it can, one computes every cycle. Whatever they write, report
//! or show must be the same; and in each cycle that
//! both compute, of an axis that answers and is driven, their whole state.
#![allow(missing_docs)]
#![allow(dead_code, reason = "each test file uses its own part of it")]

use core::hash::{Hash, Hasher};
use core::time::Duration;
use std::hash::DefaultHasher;

use servocrab::ds402::{Controlword, Mode, State};
use servocrab::{
    StopRequest,
    axis::{AxisCore, Command, CommandId, CoreConfig, Event, Inputs, Snapshot},
};

pub struct CorePair {
    /// On outputs that are kept; it knows which inputs are unchanged.
    short: AxisCore,
    /// Each call may have changed something, for all it knows.
    whole: AxisCore,
    last_inputs: Vec<u8>,
    manufacturer: Controlword,
    /// Cycles in which the first one has written nothing, and those of them in which the axis was elsewhere than before.
    pub idle_cycles: usize,
    pub idle_moving: usize,
}

impl CorePair {
    pub fn new(config: CoreConfig) -> Self {
        Self {
            short: AxisCore::new(config.clone()),
            whole: AxisCore::new(config),
            last_inputs: Vec::new(),
            manufacturer: Controlword::empty(),
            idle_cycles: 0,
            idle_moving: 0,
        }
    }

    pub fn step(&mut self, now: Duration, inputs: Inputs<'_>, outputs: &mut [u8]) {
        let unchanged = match inputs {
            Inputs::Fresh(bytes) | Inputs::Answered(bytes) => {
                let unchanged = self.last_inputs == bytes;
                self.last_inputs.clear();
                self.last_inputs.extend_from_slice(bytes);
                unchanged
            }
            Inputs::Stale => false,
        };
        let what = format!("a step at {now:?} with {inputs:?}, unchanged: {unchanged}");
        let before = self.short.snapshot().position;
        let mut kept = true;
        self.both(&what, outputs, |core, way, outputs| match way {
            Way::Short => kept = !core.step_kept(now, inputs, unchanged, outputs),
            Way::Whole => core.step(now, inputs, outputs),
        });
        // The set-points of an axis that is on its way out of Operation enabled are dropped there: how old they are counts no more.
        let shown = self.whole.snapshot();
        let is_driven = shown.state == State::OperationEnabled
            && shown.controlword.contains(Controlword::ENABLE_OPERATION);
        if !kept && shown.answered && is_driven {
            let (short, whole) = (fingerprint(&self.short), fingerprint(&self.whole));
            assert_eq!(
                short, whole,
                "{what}: {:#?} beside {:#?}",
                self.short, self.whole
            );
        }
        self.idle_cycles += usize::from(kept);
        self.idle_moving += usize::from(kept && self.short.snapshot().position != before);
    }

    pub fn submit(&mut self, now: Duration, id: CommandId, command: Command, outputs: &mut [u8]) {
        self.both("submit", outputs, |core, _, outputs| {
            core.submit(now, id, command, outputs);
        });
    }

    pub fn apply_stop(&mut self, now: Duration, stop: StopRequest, outputs: &mut [u8]) -> bool {
        self.both("apply_stop", outputs, |core, _, outputs| {
            core.apply_stop(now, stop, outputs)
        })
    }

    pub fn withdraw(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) -> bool {
        self.both("withdraw", outputs, |core, _, outputs| {
            core.withdraw(now, id, outputs)
        })
    }

    pub fn fire(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) {
        self.both("fire", outputs, |core, _, outputs| {
            core.fire(now, id, outputs);
        });
    }

    pub fn set_jog(&mut self, id: CommandId, velocity: i32, outputs: &mut [u8]) -> bool {
        self.both("set_jog", outputs, |core, _, outputs| {
            core.set_jog(id, velocity, outputs)
        })
    }

    pub fn release_jog(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) -> bool {
        self.both("release_jog", outputs, |core, _, outputs| {
            core.release_jog(now, id, outputs)
        })
    }

    pub fn note_mode(&mut self, mode: Mode) {
        self.both("note_mode", &mut [], |core, _, _| core.note_mode(mode));
    }

    pub fn set_manufacturer_bits(&mut self, bits: Controlword) {
        self.manufacturer = bits;
        self.short.set_manufacturer_bits(bits);
    }

    pub fn is_armed(&self, id: CommandId) -> bool {
        let armed = self.short.is_armed(id);
        assert_eq!(armed, self.whole.is_armed(id), "armed");
        armed
    }

    pub fn jog(&self) -> Option<CommandId> {
        self.short.jog()
    }

    pub fn poll_event(&mut self) -> Option<(CommandId, Event)> {
        let event = self.short.poll_event();
        assert_eq!(event, self.whole.poll_event(), "what is reported");
        event
    }

    pub fn snapshot(&self) -> Snapshot {
        self.short.snapshot()
    }

    /// Does the same to both, and compares what it came to.
    fn both<T: PartialEq + core::fmt::Debug>(
        &mut self,
        what: &str,
        outputs: &mut [u8],
        mut of: impl FnMut(&mut AxisCore, Way, &mut [u8]) -> T,
    ) -> T {
        let mut other = outputs.to_vec();
        let result = of(&mut self.short, Way::Short, outputs);
        // As far as it knows, something may have changed.
        self.whole.set_manufacturer_bits(self.manufacturer);
        let expected = of(&mut self.whole, Way::Whole, &mut other);
        assert_eq!(result, expected, "{what}: what it says");
        assert_eq!(outputs, other, "{what}: what it writes");
        let (short, whole) = (self.short.snapshot(), self.whole.snapshot());
        assert_eq!(short, whole, "{what}: what it knows");
        result
    }
}

/// All that a core will ever do depends on, but for the bytes in its outputs.
pub fn fingerprint(core: &AxisCore) -> u64 {
    let mut hasher = DefaultHasher::new();
    core.hash(&mut hasher);
    hasher.finish()
}

/// How a core steps.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Way {
    Short,
    Whole,
}
