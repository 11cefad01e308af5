//! What happens on the bus thread, on its way to the log.
//!
//! A subscriber may block: a paused terminal, a full pipe, a slow disk. Once cycles run, the bus thread therefore calls none: it
//! puts typed notes into a bounded queue, and a thread of the network's own makes events of them ([`Writer`]). What finds the queue
//! full is counted, and the number logged in its place.
//!
//! Before the first cycle nothing can be late and notes are written where they arise, in order with the other lines of the
//! bring-up and in its spans; so they are in virtual time, which stands still meanwhile.

mod note;
mod writer;

use std::{
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::Thread,
    time::Duration,
};

use crossbeam_queue::ArrayQueue;
use tracing::level_filters::LevelFilter;

pub(super) use note::{AxisChange, AxisNote, DriveChange, Note};
pub(super) use writer::{Subscriber, Writer};

/// Notes that wait for the thread that writes them.
const ROOM: usize = 1024;

/// Where the bus thread notes what is to be logged. Without a [`Writer`] notes are written at once.
#[derive(Debug, Clone, Default)]
pub(super) struct Log(Option<Arc<Queue>>);

/// Filled by one thread, emptied by one other.
#[derive(Debug)]
struct Queue {
    notes: ArrayQueue<(Duration, Note)>,
    /// For how many notes there was no room. As long as it is not 0 nothing is queued, so that the number has its place.
    missed: AtomicU64,
    /// Whether notes go through the queue: cycles run, or have run.
    in_cycles: AtomicBool,
    /// Whether the thread is still to hear of a note.
    is_news: AtomicBool,
    /// Nothing more will be noted.
    over: AtomicBool,
    thread: OnceLock<Thread>,
}

impl Log {
    /// Notes what happened at this time of the bus. It neither blocks nor allocates once cycles run, and does nothing where nobody
    /// listens to events of its level.
    pub(super) fn note(&self, at: Duration, note: Note) {
        if note.level() > LevelFilter::current() {
            return;
        }
        match &self.0 {
            Some(queue) if queue.in_cycles.load(Ordering::Relaxed) => queue.push(at, note),
            _ => note.write(at),
        }
    }

    /// Cycles begin: from now on nothing is written on this thread.
    pub(super) fn begin_cycles(&self) {
        if let Some(queue) = &self.0 {
            queue.in_cycles.store(true, Ordering::Relaxed);
        }
    }

    /// Wakes the thread that writes, if there is something new for it. A system call, and so not for the time in which frames are
    /// away.
    pub(super) fn hand_over(&self) {
        if let Some(queue) = &self.0
            && queue.is_news.load(Ordering::Relaxed)
        {
            queue.is_news.store(false, Ordering::Relaxed);
            queue.wake();
        }
    }
}

impl Queue {
    fn new(room: usize) -> Self {
        Self {
            notes: ArrayQueue::new(room),
            missed: AtomicU64::new(0),
            in_cycles: AtomicBool::new(false),
            is_news: AtomicBool::new(false),
            over: AtomicBool::new(false),
            thread: OnceLock::new(),
        }
    }

    fn push(&self, at: Duration, note: Note) {
        if self.missed.load(Ordering::Acquire) > 0 || self.notes.push((at, note)).is_err() {
            self.missed.fetch_add(1, Ordering::AcqRel);
        }
        self.is_news.store(true, Ordering::Relaxed);
    }

    fn wake(&self) {
        if let Some(thread) = self.thread.get() {
            thread.unpark();
        }
    }

    /// Makes events of all that waits.
    fn write(&self) {
        loop {
            while let Some((at, note)) = self.notes.pop() {
                note.write(at);
            }
            let missed = self.missed.swap(0, Ordering::AcqRel);
            if missed == 0 {
                return;
            }
            tracing::warn!(
                missed,
                "events found no room while the log was behind: they are not logged"
            );
        }
    }
}

#[cfg(test)]
mod tests;
