//! Moves that wait for their turn, in the order in which they were asked for; one that replaces all others overtakes those
//! that would be queued.

use core::time::Duration;

use crate::axis::no_older;

use super::{CommandId, MoveCommand, Start};

/// Moves that may wait; one more is refused as busy.
const PLACES: usize = 4;

/// A move that has not been sent.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Request {
    pub(super) id: CommandId,
    pub(super) command: MoveCommand,
    /// When it became the next in turn with nothing but bit 12 in its way.
    pub(super) blocked_since: Option<Duration>,
}

/// A queue of fixed size.
#[derive(Debug, Clone, Hash, Default)]
pub(super) struct Waiting {
    places: [Option<Request>; PLACES],
}

impl Waiting {
    pub(super) fn is_empty(&self) -> bool {
        self.places[0].is_none()
    }

    /// Adds a move at the end; false when there is no place.
    pub(super) fn push(&mut self, id: CommandId, command: MoveCommand) -> bool {
        match self.places.iter_mut().find(|place| place.is_none()) {
            Some(place) => {
                *place = Some(Request {
                    id,
                    command,
                    blocked_since: None,
                });
                true
            }
            None => false,
        }
    }

    /// The move whose turn it is: the oldest that replaces all others, else the oldest.
    pub(super) fn first(&self) -> Option<Request> {
        self.places.get(self.turn()).copied().flatten()
    }

    pub(super) fn last(&self) -> Option<&Request> {
        self.places.iter().flatten().last()
    }

    /// Since when the move whose turn it is has nothing but bit 12 in its way: since `now`, if it had not before.
    pub(super) fn first_blocked_since(&mut self, now: Duration) -> Duration {
        let turn = self.turn();
        match self.places.get_mut(turn) {
            Some(Some(first)) => *first.blocked_since.get_or_insert(now),
            _ => now,
        }
    }

    /// Bit 12 is not in the way of the move whose turn it is.
    pub(super) fn first_is_free(&mut self) {
        let turn = self.turn();
        if let Some(Some(first)) = self.places.get_mut(turn) {
            first.blocked_since = None;
        }
    }

    /// Lets go of what makes no difference any more.
    pub(super) fn let_go(&mut self, now: Duration, acknowledge: Duration) {
        for request in self.places.iter_mut().flatten() {
            if let Some(since) = &mut request.blocked_since {
                no_older(since, now, acknowledge);
            }
        }
    }

    /// Takes the oldest out.
    pub(super) fn pop(&mut self) -> Option<Request> {
        let first = self.places[0].take();
        self.places.rotate_left(1);
        first
    }

    /// Takes out the oldest, if it comes before the move whose turn it is.
    pub(super) fn pop_overtaken(&mut self) -> Option<Request> {
        if self.turn() == 0 { None } else { self.pop() }
    }

    fn turn(&self) -> usize {
        let replaces = |place: &Option<Request>| {
            place.is_some_and(|r| r.command.set_point.start == Start::Immediately)
        };
        self.places.iter().position(replaces).unwrap_or(0)
    }

    /// Removes the move with this id; whether there was one.
    pub(super) fn remove(&mut self, id: CommandId) -> bool {
        let Some(at) = self
            .places
            .iter()
            .position(|place| place.is_some_and(|r| r.id == id))
        else {
            return false;
        };
        if let Some(tail) = self.places.get_mut(at..) {
            tail.rotate_left(1);
        }
        self.places[PLACES - 1] = None;
        true
    }
}
