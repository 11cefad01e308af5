//! Commands of one axis that are under way, each in a slot from its submission until it is done and nobody waits for it any
//! more. Only atomics.

use core::sync::atomic::{AtomicU8, AtomicU32, AtomicU64, Ordering};

use crossbeam_queue::ArrayQueue;

use super::{CommandId, Completion, Failure, waiters::Waiters};

/// Commands under way at once, of one axis.
pub(super) const SLOTS: u8 = 32;
/// Futures that wait for one command before they must poll.
const WAITERS_PER_COMMAND: usize = 4;
/// Set in the demand of a jog as long as it is held.
const HELD: u64 = 1 << 32;

/// All slots, and which are free.
#[derive(Debug)]
pub(super) struct Slots {
    slots: Box<[Slot]>,
    free: ArrayQueue<u8>,
}

/// One command under way. It is given back when it is done and its future is gone, by whoever comes last.
#[derive(Debug)]
pub(super) struct Slot {
    id: AtomicU32,
    pub(super) marks: AtomicU8,
    pub(super) halts: AtomicU32,
    /// What a jog asks for: the velocity, and above it whether it is held.
    demand: AtomicU64,
    pub(super) result: ArrayQueue<Result<Completion, Failure>>,
    pub(super) waiters: Waiters,
}

pub(super) mod mark {
    /// The bus thread has taken the command.
    pub(in super::super) const TAKEN: u8 = 1;
    /// The drive has acknowledged the set-point.
    pub(in super::super) const ACCEPTED: u8 = 2;
    /// The result is there.
    pub(in super::super) const DONE: u8 = 4;
    /// Nobody waits any more.
    pub(in super::super) const LEFT: u8 = 8;
}

impl Slots {
    pub(super) fn new() -> Self {
        let free = ArrayQueue::new(SLOTS.into());
        for slot in 0..SLOTS {
            // There is room: the queue was made for this many.
            let _ = free.push(slot);
        }
        Self {
            slots: (0..SLOTS).map(|_| Slot::new()).collect(),
            free,
        }
    }

    /// A slot for a new command, and the command's number; none if all are taken.
    pub(super) fn open(&self) -> Option<(CommandId, &Slot)> {
        let index = self.free.pop()?;
        let slot = self.slots.get(usize::from(index))?;
        // The generation above the slot's number tells this command from all that used the slot before.
        let generation = (slot.id.load(Ordering::Relaxed) >> 8).wrapping_add(1);
        let id = CommandId(generation << 8 | u32::from(index));
        slot.reset(id);
        Some((id, slot))
    }

    /// Gives back the slot of a command that is nowhere any more.
    pub(super) fn give_back(&self, id: CommandId) {
        let _ = self.free.push(id.0 as u8);
    }

    /// The slot of a command that is still under way or whose future still waits.
    pub(super) fn of(&self, id: CommandId) -> Option<&Slot> {
        let slot = self.slots.get((id.0 & 0xFF) as usize)?;
        (slot.id.load(Ordering::Acquire) == id.0).then_some(slot)
    }

    /// Sets this mark of a command; its slot is given back when the other one was there before.
    pub(super) fn mark_last(&self, slot: &Slot, id: CommandId, mark: u8, other: u8) {
        let before = slot.marks.fetch_or(mark, Ordering::AcqRel);
        if before & other != 0 && before & mark == 0 {
            self.give_back(id);
        }
    }

    pub(super) fn wake_all(&self) {
        for slot in &self.slots {
            slot.waiters.wake_all();
        }
    }
}

impl Slot {
    fn new() -> Self {
        Self {
            id: AtomicU32::new(0),
            marks: AtomicU8::new(0),
            halts: AtomicU32::new(0),
            demand: AtomicU64::new(0),
            result: ArrayQueue::new(1),
            waiters: Waiters::new(WAITERS_PER_COMMAND),
        }
    }

    fn reset(&self, id: CommandId) {
        self.result.pop();
        self.halts.store(0, Ordering::Relaxed);
        self.marks.store(0, Ordering::Relaxed);
        self.id.store(id.0, Ordering::Release);
    }

    pub(super) fn has(&self, mark: u8) -> bool {
        self.marks.load(Ordering::Acquire) & mark != 0
    }

    /// A jog is held at this velocity.
    pub(super) fn hold(&self, velocity: i32) {
        let demand = HELD | u64::from(velocity.cast_unsigned());
        self.demand.store(demand, Ordering::Release);
    }

    /// A jog is let go.
    pub(super) fn let_go(&self) {
        self.demand.store(0, Ordering::Release);
    }

    /// The velocity of a jog that is held.
    pub(super) fn held(&self) -> Option<i32> {
        let demand = self.demand.load(Ordering::Acquire);
        (demand & HELD != 0).then_some(demand as u32 as i32)
    }
}
