//! The two queues between the handles of an axis and the bus thread: a request goes out in one and comes back in the other.

use core::sync::atomic::{
    AtomicU8, AtomicU32,
    Ordering::{AcqRel, Acquire, Relaxed},
};
use std::sync::{Arc, Mutex, PoisonError};

use crossbeam_queue::ArrayQueue;

use crate::axis::{Command, CommandId};

use super::{
    AxisErrorKind,
    request::AxisRequest,
    stops::{LastStop, StopKind, Stops},
};

/// Motions under way at once, of one axis, with the questions whether they would be refused.
const MOTIONS: u8 = 32;
/// Other commands under way at once, stops apart.
const OTHERS: u8 = 16;
/// Kinds of stops of which one each is under way: halt, hold, stop or release, quick stop, disable.
const STOPS: usize = 5;
/// A stop that has failed while it was asked for again is carried out once more, beside its successor. The core holds eight stops at most.
const STOPS_AT_MOST: usize = 4 * STOPS + 8;
/// So many requests are under way at most.
pub(super) const REQUESTS: usize = (MOTIONS + OTHERS) as usize + STOPS_AT_MOST;

#[derive(Debug)]
pub(super) struct Queue {
    /// To the bus thread.
    pub out: ArrayQueue<Arc<AxisRequest>>,
    /// Back from the bus thread, with their results: so that it frees no memory.
    pub back: ArrayQueue<Arc<AxisRequest>>,
    /// The number of the next request.
    next: AtomicU32,
    /// How many more requests of either kind may be under way. A place is free again when its request has come back.
    motions: AtomicU8,
    others: AtomicU8,
    /// The latest stop of each kind. Never locked by the bus thread.
    stops: Mutex<[Option<Arc<AxisRequest>>; STOPS]>,
}

impl Queue {
    pub fn new() -> Self {
        Self {
            out: ArrayQueue::new(REQUESTS),
            back: ArrayQueue::new(REQUESTS),
            next: AtomicU32::new(1),
            motions: AtomicU8::new(MOTIONS),
            others: AtomicU8::new(OTHERS),
            stops: Mutex::default(),
        }
    }

    /// Sends a command to the bus thread. A stop asks again for the one of its kind that is under way: the two are one then.
    pub fn submit(
        &self,
        command: Command,
        lease: u64,
        asked: LastStop,
        stops: &Stops,
    ) -> Result<Arc<AxisRequest>, AxisErrorKind> {
        self.collect();
        let Some(kind) = StopKind::of(&command) else {
            let place = self.places(&command);
            let place = place.fetch_update(AcqRel, Acquire, |free| free.checked_sub(1));
            place.map_err(|_| AxisErrorKind::QueueFull)?;
            return self.send(command, lease, asked);
        };
        let mut latest = self.stops.lock().unwrap_or_else(PoisonError::into_inner);
        let [halt, hold, quick_stop, disable, others] = &mut *latest;
        let latest = match command {
            Command::Halt => halt,
            Command::Hold => hold,
            Command::QuickStop => quick_stop,
            Command::Disable => disable,
            _ => others,
        };
        let stop = stops.note(kind);
        if let Some(request) = latest.as_ref().filter(|request| request.join(stop)) {
            return Ok(Arc::clone(request));
        }
        let request = self.send(command, lease, stop)?;
        *latest = Some(Arc::clone(&request));
        Ok(request)
    }

    fn send(
        &self,
        command: Command,
        lease: u64,
        asked: LastStop,
    ) -> Result<Arc<AxisRequest>, AxisErrorKind> {
        // All but `u32::MAX`, which is the network's own.
        let next = |id: u32| Some(id.wrapping_add(1) % u32::MAX);
        let (Ok(id) | Err(id)) = self.next.fetch_update(Relaxed, Relaxed, next);
        let request = Arc::new(AxisRequest::new(CommandId(id), command, lease, asked));
        // There is room for all that have a place.
        match self.out.push(Arc::clone(&request)) {
            Ok(()) => Ok(request),
            Err(_) => Err(AxisErrorKind::QueueFull),
        }
    }

    /// Drops what has come back.
    fn collect(&self) {
        while let Some(request) = self.back.pop() {
            if !request.is_stop() {
                self.places(&request.command).fetch_add(1, AcqRel);
            }
        }
    }

    fn places(&self, command: &Command) -> &AtomicU8 {
        match command {
            Command::Move(_)
            | Command::Home(_)
            | Command::Jog(_)
            | Command::CheckMove(_)
            | Command::CheckHome
            | Command::CheckJog(_) => &self.motions,
            _ => &self.others,
        }
    }
}
