//! The reports that wait to be taken from an axis core: a ring of fixed size.

use super::{CommandId, Event};

/// More than all commands that a core can hold at once can report between two drains.
const CAPACITY: usize = 96;

/// Reports in the order in which they arose.
#[derive(Clone)]
pub(crate) struct Events {
    ring: [Option<(CommandId, Event)>; CAPACITY],
    first: usize,
    len: usize,
}

impl core::fmt::Debug for Events {
    /// Those that wait.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let waiting = (0..self.len).map(|at| self.ring.get((self.first + at) % CAPACITY));
        f.debug_list().entries(waiting.flatten().flatten()).finish()
    }
}

impl Events {
    pub(crate) const fn new() -> Self {
        Self {
            ring: [None; CAPACITY],
            first: 0,
            len: 0,
        }
    }

    /// Adds a report. A core whose owner never drains it keeps the oldest ones.
    pub(crate) fn push(&mut self, id: CommandId, event: Event) {
        if self.len < CAPACITY {
            let at = (self.first + self.len) % CAPACITY;
            if let Some(place) = self.ring.get_mut(at) {
                *place = Some((id, event));
                self.len += 1;
            }
        } else {
            tracing::error!(
                ?id,
                ?event,
                "an event was dropped: drain the axis core after each call"
            );
        }
    }

    pub(crate) fn pop(&mut self) -> Option<(CommandId, Event)> {
        if self.len == 0 {
            return None;
        }
        let event = self.ring.get_mut(self.first)?.take()?;
        self.first = (self.first + 1) % CAPACITY;
        self.len -= 1;
        Some(event)
    }
}
