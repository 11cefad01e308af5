//! Moves that wait for their turn, in the order in which they were asked for. One that replaces all others overtakes those that would be
//! queued.

use super::{CommandId, MoveCommand};

/// Moves that may wait; one more is refused as busy.
const PLACES: usize = 4;

/// A move that has not been sent.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Request {
    pub id: CommandId,
    pub command: MoveCommand,
}

impl Request {
    /// Whether it replaces all others.
    pub fn replaces(&self) -> bool {
        self.command.replaces()
    }
}

/// A queue of fixed size.
#[derive(Debug, Clone, Hash)]
pub(super) struct PendingMoves {
    places: [Option<Request>; PLACES],
    /// So many of them, the oldest, are overtaken by a move whose bit 4 has risen: they are over once that was sent.
    overtaken: usize,
}

impl PendingMoves {
    pub const EMPTY: Self = Self {
        places: [None; PLACES],
        overtaken: 0,
    };

    pub const fn is_empty(&self) -> bool {
        self.places[0].is_none()
    }

    /// Adds a move at the end; false when there is no place.
    pub fn push(&mut self, id: CommandId, command: MoveCommand) -> bool {
        match self.places.iter_mut().find(|place| place.is_none()) {
            Some(place) => {
                *place = Some(Request { id, command });
                true
            }
            None => false,
        }
    }

    /// The move whose turn it is: the oldest that replaces all others, else the oldest.
    pub fn first(&self) -> Option<&Request> {
        self.places.get(self.turn()).and_then(Option::as_ref)
    }

    /// All that wait.
    pub fn iter(&self) -> impl Iterator<Item = &Request> {
        self.places.iter().flatten()
    }

    /// The one that was asked for last, and is not overtaken.
    pub fn last(&self) -> Option<&Request> {
        self.places.iter().skip(self.overtaken).flatten().last()
    }

    /// The first that starts together with others and replaces none.
    pub fn first_gated_to_queue(&self) -> Option<CommandId> {
        let mut gated = self.places.iter().flatten().filter(|r| r.command.gated);
        gated.find(|r| !r.replaces()).map(|request| request.id)
    }

    /// Takes the oldest out.
    pub fn pop(&mut self) -> Option<Request> {
        let first = self.places[0].take();
        self.close_up(0);
        self.overtaken = self.overtaken.saturating_sub(1);
        first
    }

    /// Takes the move whose turn it is out: those before it are overtaken.
    pub fn take_turn(&mut self) {
        let turn = self.turn();
        self.places[turn] = None;
        self.close_up(turn);
        self.overtaken = turn;
    }

    /// What has overtaken them does not come: they wait as before.
    pub const fn keep_overtaken(&mut self) {
        self.overtaken = 0;
    }

    /// Takes out the oldest, if it is overtaken.
    pub fn pop_overtaken(&mut self) -> Option<Request> {
        if self.overtaken == 0 {
            None
        } else {
            self.pop()
        }
    }

    /// Removes the move with this id; whether there was one.
    pub fn remove(&mut self, id: CommandId) -> bool {
        let is_it = |place: &Option<Request>| place.is_some_and(|request| request.id == id);
        let Some(at) = self.places.iter().position(is_it) else {
            return false;
        };
        self.places[at] = None;
        self.close_up(at);
        self.overtaken -= usize::from(at < self.overtaken);
        true
    }

    fn turn(&self) -> usize {
        let mut places = self.places.iter().map(Option::as_ref);
        places
            .position(|place| place.is_some_and(Request::replaces))
            .unwrap_or(0)
    }

    /// Those behind the empty place move up.
    fn close_up(&mut self, mut empty: usize) {
        while let Some(Some(next)) = self.places.get_mut(empty + 1).map(Option::take) {
            self.places[empty] = Some(next);
            empty += 1;
        }
    }
}
