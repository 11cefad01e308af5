//! Which stop of an axis was the last one. It distinguishes the moves that were asked for before it from those asked for after it.
//! A move whose parameters are still being written by SDO is in no queue, and must not outlive a stop either.

use core::sync::atomic::{AtomicU32, Ordering};

use super::{Command, Delivery, Failure};
use crate::ds402::State;

/// What kind of stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum StopKind {
    /// Stop, quick stop, release: the set-point is gone.
    Stop,
    Halt,
    Disable,
    /// The drive was recovered after it had left OP.
    Restart,
}

/// Names a stop: a number, and below it the kind in two bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct LastStop(u32);

/// Counts the stops that are asked for, from any thread.
#[derive(Debug, Default)]
pub(super) struct StopCount(AtomicU32);

impl StopKind {
    /// The kind of this command, if it stops.
    pub(super) const fn of(command: Command) -> Option<Self> {
        match command {
            Command::Halt => Some(Self::Halt),
            Command::Stop | Command::QuickStop | Command::Release => Some(Self::Stop),
            Command::Disable => Some(Self::Disable),
            Command::Enable
            | Command::ResetFault
            | Command::SelectMode(_)
            | Command::PrepareMode(_)
            | Command::Home(_)
            | Command::Jog(_)
            | Command::Move(_)
            | Command::CheckMove(_)
            | Command::CheckHome
            | Command::CheckJog(_)
            | Command::SetLimits(_)
            | Command::Resume => None,
        }
    }
}

impl StopCount {
    pub(super) fn note(&self, kind: StopKind) {
        let next = |last: u32| Some((last >> 2).wrapping_add(1) << 2 | kind as u32);
        let _ = self
            .0
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, next);
    }

    pub(super) fn last(&self) -> LastStop {
        LastStop(self.0.load(Ordering::Acquire))
    }

    /// Why a move is not to be started that was asked for when `asked` was the last stop, of an axis in this state.
    pub(super) fn since(&self, asked: LastStop, state: State) -> Option<Failure> {
        let LastStop(last) = self.last();
        (last != asked.0).then_some(match last & 3 {
            kind if kind == StopKind::Halt as u32 => Failure::HALTED,
            kind if kind == StopKind::Disable as u32 => Failure::Disabled { state },
            kind if kind == StopKind::Restart as u32 => Failure::BusLost {
                delivery: Delivery::NotSent,
            },
            _ => Failure::QUICK_STOPPED,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_is_stopped_by_what_came_after_it_was_asked_for_and_by_nothing_before() {
        let (stops, state) = (StopCount::default(), State::OperationEnabled);
        let before = stops.last();
        assert_eq!(stops.since(before, state), None);
        let kinds = [
            (StopKind::Halt, Failure::HALTED),
            (StopKind::Disable, Failure::Disabled { state }),
            (StopKind::Stop, Failure::QUICK_STOPPED),
            (StopKind::Stop, Failure::QUICK_STOPPED),
            (
                StopKind::Restart,
                Failure::BusLost {
                    delivery: Delivery::NotSent,
                },
            ),
        ];
        for (kind, failure) in kinds {
            let asked = stops.last();
            stops.note(kind);
            assert_eq!(stops.since(asked, state), Some(failure));
            assert_eq!(stops.since(before, state), Some(failure));
            assert_eq!(stops.since(stops.last(), state), None);
        }
    }
}
