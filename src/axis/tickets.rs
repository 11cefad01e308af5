//! Commands as the program's side holds them. The result of one that is over is kept here, so that its slot is free for the next
//! however long it is held. The bus thread never comes here.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use super::{
    CommandId, Completion, Failure,
    slots::{SHARED, STOPS},
};

/// A command that was queued.
#[derive(Debug)]
pub(crate) struct Ticket {
    pub(crate) id: CommandId,
    kept: Mutex<Kept>,
}

/// What its slot said at its end.
#[derive(Debug, Default)]
pub(super) struct Kept {
    pub(super) accepted: bool,
    pub(super) result: Option<Result<Completion, Failure>>,
}

/// Who holds what is in the slots.
#[derive(Debug)]
pub(super) struct Tickets {
    held: Mutex<Vec<Weak<Ticket>>>,
    stops: Mutex<[Option<Arc<Ticket>>; STOPS as usize]>,
}

impl Ticket {
    pub(super) fn new(id: CommandId) -> Arc<Self> {
        Arc::new(Self {
            id,
            kept: Mutex::default(),
        })
    }

    pub(super) fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Tickets {
    pub(super) fn new() -> Self {
        Self {
            held: Mutex::new((0..SHARED).map(|_| Weak::new()).collect()),
            stops: Mutex::default(),
        }
    }

    /// A ticket for a command in a slot of its own.
    pub(super) fn hold(&self, id: CommandId) -> Arc<Ticket> {
        let ticket = Ticket::new(id);
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(place) = held.get_mut((id.0 & 0xFF) as usize) {
            *place = Arc::downgrade(&ticket);
        }
        ticket
    }

    /// Calls this with each that is held.
    pub(super) fn each(&self, mut call: impl FnMut(&Ticket)) {
        let held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        for ticket in held.iter().filter_map(Weak::upgrade) {
            call(&ticket);
        }
    }

    /// The ticket of a kind of stop: from the last one `next` makes the one that holds from now on.
    pub(super) fn stop<T>(
        &self,
        place: u8,
        next: impl FnOnce(Option<&Arc<Ticket>>) -> Option<(Arc<Ticket>, T)>,
    ) -> Option<(Arc<Ticket>, T)> {
        let mut stops = self.stops.lock().unwrap_or_else(PoisonError::into_inner);
        let last = stops.get_mut(usize::from(place))?;
        let (ticket, more) = next(last.as_ref())?;
        *last = Some(Arc::clone(&ticket));
        Some((ticket, more))
    }
}
