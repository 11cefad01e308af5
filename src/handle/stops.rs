//! The stops of an axis. Any thread asks for one, and no request that was made before it moves the axis after it.
//!
//! Every stop has a generation, a number that only rises. A request keeps the generation of the last stop before it, and the bus thread
//! refuses a motion whose generation is not the latest any more. So nothing depends on where the two stand in a queue.

use crate::{
    Failure, StopRequest,
    axis::{Command, Delivery},
    ds402::State,
    sync::{
        AtomicU8, AtomicU64,
        Ordering::{AcqRel, Acquire, Release},
    },
};

/// What kind of stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum StopKind {
    /// Stop, quick stop, release: the set-point is gone.
    Stop,
    Halt,
    Disable,
    /// The drive was lost, or was recovered after it had left OP.
    Lost,
    Fault,
}

/// The lowest bits of a generation hold the kind of its stop.
const KIND_BITS: u32 = 3;

impl StopKind {
    /// The kind of this command, if it stops.
    pub const fn of(command: &Command) -> Option<Self> {
        match command {
            Command::Halt | Command::Hold => Some(Self::Halt),
            Command::Stop | Command::QuickStop | Command::Release => Some(Self::Stop),
            Command::Disable => Some(Self::Disable),
            _ => None,
        }
    }

    /// The kind of a stop that nobody waits for.
    pub fn of_request(stop: StopRequest) -> Self {
        if stop == StopRequest::HALT {
            Self::Halt
        } else {
            Self::Stop
        }
    }

    /// The kind of what has stopped the axis without a command.
    pub const fn of_fall(failure: Failure) -> Self {
        match failure {
            Failure::Fault { .. } => Self::Fault,
            Failure::Disabled { .. } => Self::Disable,
            Failure::BusLost { .. } | Failure::Undelivered { .. } => Self::Lost,
            _ => Self::Stop,
        }
    }
}

/// The generation of a stop. A later one is greater.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct LastStop(pub u64);

impl LastStop {
    pub const fn is(self, kind: StopKind) -> bool {
        self.0 & ((1 << KIND_BITS) - 1) == kind as u64
    }
}

#[derive(Debug)]
pub(super) struct Stops {
    last: AtomicU64,
    /// The bits of the [`StopRequest`]s that nobody waits for, until the bus thread takes them.
    level: AtomicU8,
}

impl Stops {
    pub fn new() -> Self {
        Self {
            last: AtomicU64::new(0),
            level: AtomicU8::new(0),
        }
    }

    /// Another stop of this kind, and its generation.
    pub fn note(&self, kind: StopKind) -> LastStop {
        let after = |last: u64| ((last >> KIND_BITS) + 1) << KIND_BITS | kind as u64;
        let next = |last| Some(after(last));
        let (Ok(before) | Err(before)) = self.last.fetch_update(AcqRel, Acquire, next);
        LastStop(after(before))
    }

    pub fn last(&self) -> LastStop {
        LastStop(self.last.load(Acquire))
    }

    /// Why a motion is not to start that was asked for when `asked` was the last stop. The axis is in this state.
    pub fn since(&self, asked: LastStop, state: State) -> Option<Failure> {
        let last = self.last();
        if last == asked {
            return None;
        }
        let delivery = Delivery::NotSent;
        Some(match () {
            () if last.is(StopKind::Halt) => Failure::Halted { delivery },
            () if last.is(StopKind::Disable) => Failure::Disabled { state },
            () if last.is(StopKind::Lost) => Failure::BusLost { delivery },
            () if last.is(StopKind::Fault) => Failure::Fault {
                code: None,
                following_error: false,
            },
            () => Failure::QuickStopped { delivery },
        })
    }

    /// Asks for a stop that nobody waits for.
    pub fn raise(&self, stop: StopRequest) {
        self.note(StopKind::of_request(stop));
        self.level.fetch_or(stop.bits(), Release);
    }

    /// What was asked for by [`raise`](Self::raise) since the last call.
    pub fn take(&self) -> StopRequest {
        StopRequest::from_bits_truncate(self.level.swap(0, AcqRel))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_is_stopped_by_what_came_after_it_was_asked_for_and_by_nothing_before() {
        let (stops, state) = (Stops::new(), State::OperationEnabled);
        let before = stops.last();
        assert_eq!(stops.since(before, state), None);
        let delivery = Delivery::NotSent;
        let kinds = [
            (StopKind::Halt, Failure::HALTED),
            (StopKind::Disable, Failure::Disabled { state }),
            (StopKind::Stop, Failure::QUICK_STOPPED),
            (StopKind::Stop, Failure::QUICK_STOPPED),
            (StopKind::Lost, Failure::BusLost { delivery }),
            (
                StopKind::Fault,
                Failure::Fault {
                    code: None,
                    following_error: false,
                },
            ),
        ];
        for (kind, failure) in kinds {
            let asked = stops.last();
            assert_eq!(stops.note(kind), stops.last());
            assert!(asked < stops.last());
            assert_eq!(stops.since(asked, state), Some(failure));
            assert_eq!(stops.since(before, state), Some(failure));
            assert_eq!(stops.since(stops.last(), state), None);
        }
    }
}
