//! Commands of one axis that are under way, each in a slot from its submission until its result was taken or nobody waits for it
//! any more. Only atomics.

use core::sync::atomic::{AtomicU8, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use crossbeam_queue::ArrayQueue;

use crate::axis::{Command, CommandId, Completion, Failure};

/// Motions under way at once, of one axis, with the questions whether they would be refused.
const MOTIONS: u8 = 32;
/// Other commands under way at once, stops apart.
const OTHERS: u8 = 16;
/// All of these.
pub(super) const SHARED: u8 = MOTIONS + OTHERS;
/// Stops of one kind share a slot: halts, stops, quick stops, disables.
const STOPS: u8 = 4;
/// How often one stop may be in the queue at a time. Where that is not enough the stop lane asks for it as well.
const ASKED_AT_MOST: u8 = 8;
/// What the queue of commands holds at most: a stop that has just failed may be in it beside its successor.
pub(super) const QUEUED_AT_MOST: usize =
    SHARED as usize + 2 * STOPS as usize * ASKED_AT_MOST as usize;
/// Set in the demand of a jog as long as it is held. Above it is counted how often its holder has said so.
const HELD: u64 = 1 << 32;
const SAID_ONCE: u64 = 1 << 33;
/// In place of how often a stop is in the queue: it has its result.
const OVER: u8 = u8::MAX;

/// All slots, and which are free.
#[derive(Debug)]
pub(super) struct Slots {
    slots: Box<[Slot]>,
    motions: ArrayQueue<u8>,
    others: ArrayQueue<u8>,
}

/// One command under way. It is given back when it is done and its future is gone or has the result; the last of the two gives it
/// back.
#[derive(Debug)]
pub(super) struct Slot {
    id: AtomicU32,
    pub marks: AtomicU8,
    pub halts: AtomicU32,
    /// What a jog asks for: the velocity, above it whether it is held, and above that how often its holder has said so.
    demand: AtomicU64,
    /// How often a stop is in the queue.
    queued: AtomicU8,
    pub result: ArrayQueue<Result<Completion, Failure>>,
}

pub(super) mod mark {
    /// The bus thread has taken the command, and may have sent its set-point.
    pub(in super::super) const TAKEN: u8 = 1;
    /// The drive has acknowledged the set-point.
    pub(in super::super) const ACCEPTED: u8 = 2;
    /// The result is there.
    pub(in super::super) const DONE: u8 = 4;
    /// Nobody needs the slot any more.
    pub(in super::super) const LEFT: u8 = 8;
}

/// The place that all stops of this command's kind share, if it is one.
pub(super) const fn stop_place(command: Command) -> Option<u8> {
    match command {
        Command::Halt => Some(0),
        Command::Stop | Command::Release => Some(1),
        Command::QuickStop => Some(2),
        Command::Disable => Some(3),
        _ => None,
    }
}

const fn is_motion(command: Command) -> bool {
    matches!(
        command,
        Command::Move(_)
            | Command::Home(_)
            | Command::Jog(_)
            | Command::CheckMove(_)
            | Command::CheckHome
            | Command::CheckJog(_)
    )
}

impl Slots {
    pub fn new() -> Self {
        let free = |slots: core::ops::Range<u8>| {
            let free = ArrayQueue::new(slots.len());
            for slot in slots {
                // There is room: the queue was made for this many.
                let _ = free.push(slot);
            }
            free
        };
        Self {
            slots: (0..SHARED + STOPS).map(|_| Slot::new()).collect(),
            motions: free(0..MOTIONS),
            others: free(MOTIONS..SHARED),
        }
    }

    /// A slot for a new command that is no stop, and the command's number; none if all are taken.
    pub fn open(&self, command: Command) -> Option<(CommandId, &Slot)> {
        let free = if is_motion(command) {
            &self.motions
        } else {
            &self.others
        };
        self.renew(free.pop()?)
    }

    /// A new number in the slot of a kind of stop, for the first that asks; the stop before must be over.
    pub fn open_stop(&self, place: u8) -> Option<(CommandId, &Slot)> {
        let (id, slot) = self.renew(SHARED + place)?;
        slot.queued.store(1, Ordering::Release);
        Some((id, slot))
    }

    fn renew(&self, index: u8) -> Option<(CommandId, &Slot)> {
        let slot = self.slots.get(usize::from(index))?;
        // The generation above the slot's number distinguishes this command from all that used the slot before.
        let generation = (slot.id.load(Ordering::Relaxed) >> 8).wrapping_add(1);
        let id = CommandId(generation << 8 | u32::from(index));
        slot.reset(id);
        Some((id, slot))
    }

    /// Gives back the slot of a command that is nowhere any more.
    pub fn give_back(&self, id: CommandId) {
        match id.0 as u8 {
            slot @ 0..MOTIONS => drop(self.motions.push(slot)),
            slot @ MOTIONS..SHARED => drop(self.others.push(slot)),
            // A stop's slot stays its own.
            _ => {}
        }
    }

    /// The slot of a command that is still under way or whose result was not taken.
    pub fn of(&self, id: CommandId) -> Option<&Slot> {
        let slot = self.slots.get((id.0 & 0xFF) as usize)?;
        (slot.id.load(Ordering::Acquire) == id.0).then_some(slot)
    }

    /// Whether this command's slot is one that stops share.
    pub const fn is_stop(id: CommandId) -> bool {
        id.0 as u8 >= SHARED
    }

    /// Sets this mark of a command; its slot is given back when the other one was there before.
    pub fn mark_last(&self, slot: &Slot, id: CommandId, mark: u8, other: u8) {
        let before = slot.marks.fetch_or(mark, Ordering::AcqRel);
        if before & other != 0 && before & mark == 0 {
            self.give_back(id);
        }
    }
}

/// How a stop was joined that is under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Joined {
    /// To be queued once more.
    Queue,
    /// It is in the queue often enough.
    Queued,
    /// It is over: a new one begins.
    Over,
}

impl Slot {
    fn new() -> Self {
        Self {
            id: AtomicU32::new(0),
            marks: AtomicU8::new(0),
            halts: AtomicU32::new(0),
            demand: AtomicU64::new(0),
            queued: AtomicU8::new(0),
            result: ArrayQueue::new(1),
        }
    }

    fn reset(&self, id: CommandId) {
        self.result.pop();
        self.halts.store(0, Ordering::Relaxed);
        self.marks.store(0, Ordering::Relaxed);
        self.id.store(id.0, Ordering::Release);
    }

    pub fn has(&self, mark: u8) -> bool {
        self.marks.load(Ordering::Acquire) & mark != 0
    }

    /// A jog begins, with this velocity.
    pub fn begin_jog(&self, velocity: i32) {
        let demand = HELD | u64::from(velocity.cast_unsigned());
        self.demand.store(demand, Ordering::Release);
    }

    /// Its holder says that it holds the jog, at this velocity, or at the one that it has. False once it was let go.
    pub fn hold(&self, velocity: Option<i32>) -> bool {
        let said = |demand: u64| {
            let velocity = velocity.map_or(demand as u32, i32::cast_unsigned);
            let times = demand.wrapping_add(SAID_ONCE) & !u64::from(u32::MAX);
            (demand & HELD != 0).then_some(times | u64::from(velocity))
        };
        let held = self
            .demand
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, said);
        held.is_ok()
    }

    /// A jog is let go.
    pub fn let_go(&self) {
        self.demand.store(0, Ordering::Release);
    }

    /// The velocity of a jog that is held, and how often its holder has said that it holds it.
    pub fn held(&self) -> Option<(i32, u32)> {
        let demand = self.demand.load(Ordering::Acquire);
        (demand & HELD != 0).then_some((demand as u32 as i32, (demand / SAID_ONCE) as u32))
    }

    /// Whether a stop is in the queue as often as it may be.
    pub fn is_queued_enough(&self) -> bool {
        (ASKED_AT_MOST..OVER).contains(&self.queued.load(Ordering::SeqCst))
    }

    /// One more asks for this stop. As long as it waits in the queue it is not over.
    pub fn join(&self) -> Joined {
        let joined = self
            .queued
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, |queued| match queued {
                OVER => None,
                ASKED_AT_MOST.. => Some(queued),
                _ => Some(queued + 1),
            });
        match joined {
            Ok(ASKED_AT_MOST..) => Joined::Queued,
            Ok(_) => Joined::Queue,
            Err(_) => Joined::Over,
        }
    }

    /// A stop was taken from the queue once.
    pub fn take(&self) {
        let _ = self
            .queued
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, |queued| {
                (queued != OVER).then(|| queued.saturating_sub(1))
            });
    }

    /// Whether a stop is over with this result. One that went well and was asked for again meanwhile is not: its end is what
    /// comes of that.
    pub fn ends(&self, result: Result<Completion, Failure>) -> bool {
        self.queued
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, |queued| {
                (queued == 0 || (result.is_err() && queued != OVER)).then_some(OVER)
            })
            .is_ok()
    }
}

/// A command that was queued.
#[derive(Debug)]
pub(super) struct Ticket {
    pub id: CommandId,
    kept: Mutex<Kept>,
}

/// What its slot said at its end.
#[derive(Debug, Default)]
pub(super) struct Kept {
    pub accepted: bool,
    pub result: Option<Result<Completion, Failure>>,
}

/// Who holds what is in the slots.
#[derive(Debug)]
pub(super) struct Tickets {
    held: Mutex<Vec<Weak<Ticket>>>,
    stops: Mutex<[Option<Arc<Ticket>>; STOPS as usize]>,
}

impl Ticket {
    pub fn new(id: CommandId) -> Arc<Self> {
        Arc::new(Self {
            id,
            kept: Mutex::default(),
        })
    }

    pub fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Tickets {
    pub fn new() -> Self {
        Self {
            held: Mutex::new((0..SHARED).map(|_| Weak::new()).collect()),
            stops: Mutex::default(),
        }
    }

    /// A ticket for a command in a slot of its own.
    pub fn hold(&self, id: CommandId) -> Arc<Ticket> {
        let ticket = Ticket::new(id);
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(place) = held.get_mut((id.0 & 0xFF) as usize) {
            *place = Arc::downgrade(&ticket);
        }
        ticket
    }

    /// Calls this with each that is held.
    pub fn each(&self, mut call: impl FnMut(&Ticket)) {
        let held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        for ticket in held.iter().filter_map(Weak::upgrade) {
            call(&ticket);
        }
    }

    /// The ticket of a kind of stop: from the last one `next` makes the one that holds from now on.
    pub fn stop<T>(
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
