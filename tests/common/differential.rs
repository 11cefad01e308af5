//! One axis as three cores that are given the same inputs: one steps as cheaply as it can, one computes every cycle as a whole, and one lets
//! go of all that makes no difference any more after each. Whatever they write, report or know must be the same.
#![allow(missing_docs)]
#![allow(dead_code, reason = "each test file uses its own part of it")]

use core::time::Duration;

use servocrab::axis::{
    AxisCore, Command, CommandId, CoreConfig, Event, Inputs, Snapshot, StopRequest,
};
use servocrab::ds402::{Controlword, Mode};

pub struct CorePair {
    /// On outputs that are kept; it knows which inputs are unchanged.
    short: AxisCore,
    /// Each call may have changed something, for all it knows.
    whole: AxisCore,
    /// Computes every cycle as a whole, and lets go after it.
    forgetful: AxisCore,
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
            whole: AxisCore::new(config.clone()),
            forgetful: AxisCore::new(config),
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
        self.all(&what, outputs, |core, way, outputs| match way {
            Way::Short => kept = !core.step_kept(now, inputs, unchanged, outputs),
            Way::Whole => core.step(now, inputs, outputs),
            Way::Forgetful => {
                core.step(now, inputs, outputs);
                core.canonicalize(now);
            }
        });
        self.idle_cycles += usize::from(kept);
        self.idle_moving += usize::from(kept && self.short.snapshot().position != before);
    }

    pub fn submit(&mut self, now: Duration, id: CommandId, command: Command, outputs: &mut [u8]) {
        self.all("submit", outputs, |core, _, outputs| {
            core.submit(now, id, command, outputs);
        });
    }

    pub fn apply_stop(&mut self, now: Duration, stop: StopRequest, outputs: &mut [u8]) -> bool {
        self.all("apply_stop", outputs, |core, _, outputs| {
            core.apply_stop(now, stop, outputs)
        })
    }

    pub fn withdraw(&mut self, id: CommandId, outputs: &mut [u8]) -> bool {
        self.all("withdraw", outputs, |core, _, outputs| {
            core.withdraw(id, outputs)
        })
    }

    pub fn fire(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) {
        self.all("fire", outputs, |core, _, outputs| {
            core.fire(now, id, outputs);
        });
    }

    pub fn set_jog(&mut self, id: CommandId, velocity: i32, outputs: &mut [u8]) -> bool {
        self.all("set_jog", outputs, |core, _, outputs| {
            core.set_jog(id, velocity, outputs)
        })
    }

    pub fn release_jog(&mut self, now: Duration, id: CommandId, outputs: &mut [u8]) -> bool {
        self.all("release_jog", outputs, |core, _, outputs| {
            core.release_jog(now, id, outputs)
        })
    }

    pub fn note_mode(&mut self, mode: Mode) {
        self.all("note_mode", &mut [], |core, _, _| core.note_mode(mode));
    }

    pub fn set_manufacturer_bits(&mut self, bits: Controlword) {
        self.manufacturer = bits;
        self.short.set_manufacturer_bits(bits);
    }

    pub fn is_armed(&self, id: CommandId) -> bool {
        let armed = self.short.is_armed(id);
        assert_eq!(armed, self.whole.is_armed(id), "armed");
        assert_eq!(armed, self.forgetful.is_armed(id), "armed");
        armed
    }

    pub fn jog(&self) -> Option<CommandId> {
        self.short.jog()
    }

    pub fn poll_event(&mut self) -> Option<(CommandId, Event)> {
        let event = self.short.poll_event();
        assert_eq!(event, self.whole.poll_event(), "what is reported");
        let forgetful = self.forgetful.poll_event();
        assert_eq!(event, forgetful, "what is reported by one that forgets");
        event
    }

    pub fn snapshot(&self) -> Snapshot {
        self.short.snapshot()
    }

    /// Does the same to all, and compares what it came to.
    fn all<T: PartialEq + core::fmt::Debug>(
        &mut self,
        what: &str,
        outputs: &mut [u8],
        mut of: impl FnMut(&mut AxisCore, Way, &mut [u8]) -> T,
    ) -> T {
        let before = outputs.to_vec();
        let result = of(&mut self.short, Way::Short, outputs);
        for (core, way) in [
            (&mut self.whole, Way::Whole),
            (&mut self.forgetful, Way::Forgetful),
        ] {
            // As far as it knows, something may have changed.
            core.set_manufacturer_bits(self.manufacturer);
            let mut other = before.clone();
            let expected = of(core, way, &mut other);
            assert_eq!(result, expected, "{what}: what it says, {way:?}");
            // Where a set-point leads is written anew with its bit 4.
            let decides = match outputs.first() {
                Some(low) if way == Way::Forgetful && low & 0x10 == 0 => 2,
                _ => outputs.len(),
            };
            assert_eq!(
                outputs[..decides],
                other[..decides],
                "{what}: what it writes, {way:?}"
            );
            let knows = self.short.snapshot();
            let mut other = core.snapshot();
            if way == Way::Forgetful && other.lost {
                // For how long makes no difference.
                other.age = knows.age;
            }
            assert_eq!(knows, other, "{what}: what it knows, {way:?}");
        }
        result
    }
}

/// How a core steps.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Way {
    Short,
    Whole,
    Forgetful,
}
