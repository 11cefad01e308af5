//! What is reported about a command, and the reports that wait to be taken from an axis core: a ring of fixed size.

use crate::ds402::{Mode, State};

use super::Failure;

/// Names one command until its last event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CommandId(pub u32);

/// One report about a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Event {
    /// The drive acknowledged the move's set-point; `Done` follows.
    Accepted,
    /// The axis stands halted with this move's set-point kept; `Done` follows.
    Halted,
    /// The torque that ends the move was seen; the axis is halted to be held, and `Done` follows.
    Contact {
        /// Position actual value 6064h.
        position: i32,
        /// Torque actual value 6077h, in thousandths of the rated torque.
        torque: i16,
    },
    /// The last report.
    Done(Result<Completion, Failure>),
}

/// How a command ended well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Completion {
    /// Done; there is no more to say.
    Done,
    /// The move arrived at its target: the axis rests there, or goes on with an end velocity.
    Reached {
        /// Position actual value 6064h when it was seen.
        position: i32,
    },
    /// The move passed its target without stopping, into the next one.
    Passed {
        /// Position actual value 6064h when it was seen.
        position: i32,
    },
    /// The homing is attained.
    Homed {
        /// Position actual value 6064h when it was seen.
        position: i32,
    },
    /// The axis stands, in this state.
    Stopped {
        /// Where the drive ended: by 605Ah.
        state: State,
    },
    /// Nothing of the last mode is left: 6060h may be written by SDO.
    Prepared {
        /// The mode that may be written.
        mode: Mode,
    },
}

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
    pub const fn new() -> Self {
        Self {
            ring: [None; CAPACITY],
            first: 0,
            len: 0,
        }
    }

    /// Adds a report. A core whose owner never drains it keeps the oldest ones.
    pub fn push(&mut self, id: CommandId, event: Event) {
        if self.len < CAPACITY {
            let at = (self.first + self.len) % CAPACITY;
            if let Some(place) = self.ring.get_mut(at) {
                *place = Some((id, event));
                self.len += 1;
            }
        } else {
            tracing::error!(
                target: crate::log_target::AXIS,
                ?id,
                ?event,
                "an event was dropped: drain the axis core after each call"
            );
        }
    }

    pub fn pop(&mut self) -> Option<(CommandId, Event)> {
        if self.len == 0 {
            return None;
        }
        let event = self.ring.get_mut(self.first)?.take()?;
        self.first = (self.first + 1) % CAPACITY;
        self.len -= 1;
        Some(event)
    }
}

#[cfg(test)]
mod tests {
    use alloc::{format, vec::Vec};

    use super::*;

    #[test]
    fn the_reports_that_wait_are_shown_in_their_order_round_the_ring() {
        let mut events = Events::new();
        for number in 0..CAPACITY as u32 + 1 {
            events.push(CommandId(number), Event::Accepted);
            if number + 2 < CAPACITY as u32 {
                events.pop();
            }
        }
        let shown = [CAPACITY as u32 - 2, CAPACITY as u32 - 1, CAPACITY as u32]
            .map(|number| (CommandId(number), Event::Accepted));
        assert_eq!(format!("{events:?}"), format!("{shown:?}"));
    }

    #[test]
    fn a_report_without_a_place_takes_that_of_no_other() {
        let mut events = Events::new();
        let numbers = 0..CAPACITY as u32;
        for number in numbers.clone().chain([1_000]) {
            events.push(CommandId(number), Event::Accepted);
        }
        let kept: Vec<_> = core::iter::from_fn(|| events.pop()).collect();
        let expected = numbers.map(|number| (CommandId(number), Event::Accepted));
        assert_eq!(kept, expected.collect::<Vec<_>>());
    }
}
