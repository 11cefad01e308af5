//! The queue of commands between the handles of an axis and the bus thread, with both its ends.
//!
//! A handle puts a command in and holds it as a [`Pending`]. The [`AxisPort`] takes it to the axis core before the frames are sent. After
//! the step it brings the core's reports and its snapshot back. A stop goes beside the queue. From top to bottom: what the two ends share,
//! the stops that were asked for, the slots of the commands, the program's end, the bus thread's end.

use core::{
    fmt,
    sync::atomic::{AtomicBool, AtomicU8, AtomicU16, AtomicU32, AtomicU64, AtomicUsize, Ordering},
    time::Duration,
};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use crossbeam_queue::ArrayQueue;

use crate::{
    axis::{
        AxisCore, Command, CommandId, Completion, CoreConfig, Delivery, DriveSettings, Event,
        Failure, Reattach, Snapshot, SnapshotChange, StopRequest, WorkingCounter,
    },
    coe::ObjectAddress,
    ds402::{Controlword, Mode, State},
    wakes::{Waiters, stored},
};

use super::{
    AxisError, AxisErrorKind, AxisIdentity, AxisSetup,
    axis::Handles,
    error::{EndedByHalt, HandleUnit},
    output_cells::OutputCells,
    setup::SettingsCell,
    statistics::AxisCounts,
    status::{Head, StatusCell, differs, motion, pack, silent},
};

// What the two ends of an axis share. Only atomics.

/// The channel of futures that wait for a change; those of the commands' slots follow.
const CHANGED: u32 = 0;
/// Set in what is noted once there is something, above its value.
const NOTED: u64 = 1 << 32;

/// A slot gives at most one withdrawal between two cycles, and one that was there before.
const WITHDRAWN_AT_MOST: usize = 2 * SHARED as usize;

/// A command that was given up.
#[derive(Debug, Clone, Copy)]
struct Withdrawn {
    pub id: CommandId,
    /// A homing that was sent is to be stopped.
    pub ends: bool,
}

/// One axis, seen from both sides.
pub(super) struct Shared {
    pub setup: AxisSetup,
    pub identity: Arc<AxisIdentity>,
    pub status: StatusCell,
    /// Futures that wait for a command, or for a change.
    waiters: Arc<Waiters>,
    /// How often a snapshot has shown something new.
    pub changes: AtomicU64,
    /// How often a mode was leased, or given back: odd while one is leased, and then the number of that lease.
    lease: AtomicU64,
    /// How often the drive was brought up, or led back, with what it held at the first start.
    starts: AtomicU64,
    /// Whether anything of what follows was stored since the bus thread looked: all that it has to look at in a cycle.
    asked: AtomicBool,
    /// With the stop that was the last one when each was asked for.
    queue: ArrayQueue<(CommandId, Command, LastStop)>,
    withdrawn: ArrayQueue<Withdrawn>,
    slots: Slots,
    tickets: Tickets,
    stop: AtomicU8,
    stops: StopCount,
    manufacturer: AtomicU16,
    /// 6061h as it was read by SDO.
    noted_mode: Noted,
    /// Home offset 607Ch as the drive has got it.
    noted_home_offset: Noted,
    /// Whether it may have got another one: a write of it was given up.
    home_offset_in_doubt: AtomicBool,
    /// How often what the drive's limits are counted from, or what is known of them, has become another.
    limits_changed: AtomicU64,
    /// Max profile velocity 607Fh as the core checks it; 0 is no limit.
    max_velocity: AtomicU32,
    /// What the drive held when it was attached last.
    settings: SettingsCell,
    closed: AtomicBool,
    outputs: OutputCells,
    pub counts: AxisCounts,
}

impl Shared {
    pub fn new(setup: AxisSetup, core: &AxisCore) -> Self {
        Self {
            identity: Arc::new(setup.identity.clone()),
            status: StatusCell::new(&core.snapshot(), setup.layout.input_bytes()),
            waiters: setup.groups.signals.waiters(),
            changes: AtomicU64::new(0),
            lease: AtomicU64::new(0),
            starts: AtomicU64::new(0),
            asked: AtomicBool::new(false),
            queue: ArrayQueue::new(QUEUED_AT_MOST),
            withdrawn: ArrayQueue::new(WITHDRAWN_AT_MOST),
            slots: Slots::new(),
            tickets: Tickets::new(),
            stop: AtomicU8::new(0),
            stops: StopCount::default(),
            manufacturer: AtomicU16::new(0),
            noted_mode: Noted::default(),
            noted_home_offset: Noted::default(),
            home_offset_in_doubt: AtomicBool::new(false),
            limits_changed: AtomicU64::new(0),
            max_velocity: AtomicU32::new(0),
            settings: SettingsCell::new(core.drive_settings()),
            closed: AtomicBool::new(false),
            outputs: OutputCells::of(&setup.layout),
            counts: AxisCounts::default(),
            setup,
        }
    }

    pub fn error(&self, kind: AxisErrorKind) -> AxisError {
        AxisError::new(Arc::clone(&self.identity), kind)
    }

    /// For the program's side alone: a subscriber may lock and allocate.
    pub fn trace(&self, what: &str) {
        tracing::debug!(
            target: super::LOG,
            axis = self.identity.axis,
            drive = %self.identity.drive,
            "{what}"
        );
    }

    pub fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    /// Leases a mode; false while one is leased.
    pub fn take_lease(&self) -> bool {
        let next = |lease: u64| (!is_leased(lease)).then(|| lease.wrapping_add(1));
        let taken = self
            .lease
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, next);
        taken.is_ok()
    }

    /// The lease is given back.
    pub fn give_lease_back(&self) {
        self.lease.fetch_add(1, Ordering::AcqRel);
    }

    /// The number of the lease, to whoever has it.
    pub fn lease(&self) -> u64 {
        self.lease.load(Ordering::Acquire)
    }

    /// What is asked for by this lease belongs to nobody once it was given back.
    pub fn check_lease(&self, lease: u64) -> Result<(), AxisErrorKind> {
        match self.lease() {
            now if now == lease => Ok(()),
            now if is_leased(now) => Err(AxisErrorKind::ModeInUse),
            _ => Err(AxisErrorKind::NotLeased),
        }
    }

    /// Whether the axis was leased again after this lease.
    pub fn is_leased_again(&self, lease: u64) -> bool {
        self.lease() > lease.wrapping_add(1)
    }

    /// The latest snapshot.
    pub fn snapshot(&self) -> Snapshot {
        self.status
            .snapshot_after(self.setup.groups.signals.cycles())
    }
}

const fn is_leased(lease: u64) -> bool {
    lease % 2 == 1
}

/// What the program has learnt of its drive, for the bus thread: the last one counts.
#[derive(Debug, Default)]
struct Noted(AtomicU64);

impl Noted {
    pub fn set(&self, value: i32) {
        let noted = NOTED | u64::from(value.cast_unsigned());
        self.0.store(noted, Ordering::Release);
    }

    /// What was noted since this was called last.
    pub fn take(&self) -> Option<i32> {
        if self.0.load(Ordering::Acquire) & NOTED == 0 {
            return None;
        }
        Some(self.0.swap(0, Ordering::AcqRel) as i32)
    }
}

/// By its name: the rest of it is of no use to a reader of a log.
impl fmt::Debug for Shared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.identity.axis)
    }
}

// Which stops were asked for, so that a move does not outlive one that came after it.

/// What kind of stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum StopKind {
    /// Stop, quick stop, release: the set-point is gone.
    Stop,
    Halt,
    Disable,
    /// The drive was lost, or was recovered after it had left OP.
    Lost,
    Fault,
}

/// Names a stop: a number, and below it the kind in three bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct LastStop(u32);

/// Counts the stops that are asked for, from any thread.
#[derive(Debug, Default)]
struct StopCount(AtomicU32);

impl StopKind {
    /// The kind of this command, if it stops.
    pub const fn of(command: Command) -> Option<Self> {
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

    /// The kind of what has stopped the axis without a command.
    const fn of_fall(failure: Failure) -> Self {
        match failure {
            Failure::Fault { .. } => Self::Fault,
            Failure::Disabled { .. } => Self::Disable,
            Failure::BusLost { .. } | Failure::Undelivered { .. } => Self::Lost,
            _ => Self::Stop,
        }
    }
}

impl StopCount {
    pub fn note(&self, kind: StopKind) {
        let next = |last: u32| Some((last >> 3).wrapping_add(1) << 3 | kind as u32);
        let _ = self
            .0
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, next);
    }

    pub fn last(&self) -> LastStop {
        LastStop(self.0.load(Ordering::Acquire))
    }

    /// Why a move is not to be started that was asked for when `asked` was the last stop, of an axis in this state.
    pub fn since(&self, asked: LastStop, state: State) -> Option<Failure> {
        let LastStop(last) = self.last();
        (last != asked.0).then_some(match last & 7 {
            kind if kind == StopKind::Halt as u32 => Failure::HALTED,
            kind if kind == StopKind::Disable as u32 => Failure::Disabled { state },
            kind if kind == StopKind::Lost as u32 => Failure::BusLost {
                delivery: Delivery::NotSent,
            },
            kind if kind == StopKind::Fault as u32 => Failure::Fault { code: None },
            _ => Failure::QUICK_STOPPED,
        })
    }
}

// The commands that are under way, each in a slot from its submission until its result was taken or nobody waits for it any more.

/// Motions under way at once, of one axis, with the questions whether they would be refused.
const MOTIONS: u8 = 32;
/// Other commands under way at once, stops apart.
const OTHERS: u8 = 16;
/// All of these.
const SHARED: u8 = MOTIONS + OTHERS;
/// Stops of one kind share a slot: halts, stops, quick stops, disables.
const STOPS: u8 = 4;
/// How often one stop may be in the queue at a time. Where that is not enough the stop lane asks for it as well.
const ASKED_AT_MOST: u8 = 8;
/// What the queue of commands holds at most: a stop that has just failed may be in it beside its successor.
const QUEUED_AT_MOST: usize = SHARED as usize + 2 * STOPS as usize * ASKED_AT_MOST as usize;
/// Set in the demand of a jog as long as it is held. Above it is counted how often its holder has said so.
const HELD: u64 = 1 << 32;
const SAID_ONCE: u64 = 1 << 33;
/// In place of how often a stop is in the queue: it has its result.
const OVER: u8 = u8::MAX;

/// All slots, and which are free.
#[derive(Debug)]
struct Slots {
    slots: Box<[Slot]>,
    motions: ArrayQueue<u8>,
    others: ArrayQueue<u8>,
}

/// One command under way. It is given back when it is done and its future is gone or has the result; the last of the two gives it
/// back.
#[derive(Debug)]
struct Slot {
    id: AtomicU32,
    pub marks: AtomicU8,
    pub halts: AtomicU32,
    /// What a jog asks for: the velocity, above it whether it is held, and above that how often its holder has said so.
    demand: AtomicU64,
    /// How often a stop is in the queue.
    queued: AtomicU8,
    /// How many wait for a stop.
    waiting: AtomicUsize,
    pub result: ArrayQueue<Result<Completion, Failure>>,
}

mod mark {
    /// The bus thread has taken the command, and may have sent its set-point.
    pub(super) const TAKEN: u8 = 1;
    /// The drive has acknowledged the set-point.
    pub(super) const ACCEPTED: u8 = 2;
    /// The result is there.
    pub(super) const DONE: u8 = 4;
    /// Nobody needs the slot any more.
    pub(super) const LEFT: u8 = 8;
    /// The bus thread has taken it, and the drive takes its parameters with bit 4.
    pub(super) const LATCHES: u8 = 16;
}

/// The place that all stops of this command's kind share, if it is one.
const fn stop_place(command: Command) -> Option<u8> {
    match command {
        Command::Halt => Some(0),
        Command::Stop | Command::Release => Some(1),
        Command::QuickStop => Some(2),
        Command::Disable => Some(3),
        _ => None,
    }
}

/// The number of a stop that nobody waits for: of no slot.
const NOBODY: CommandId = CommandId(u32::MAX);

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
        slot.waiting.store(1, Ordering::Release);
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
enum Joined {
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
            waiting: AtomicUsize::new(0),
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
    pub fn release(&self) {
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

    /// Whether nobody is left who waits for a stop.
    pub fn is_nobodys(&self) -> bool {
        self.waiting.load(Ordering::Acquire) == 0
    }

    /// A stop was taken from the queue once. False where it is over, and the next one may have the slot at any time.
    pub fn take(&self) -> bool {
        self.queued
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, |queued| {
                (queued != OVER).then(|| queued.saturating_sub(1))
            })
            .is_ok()
    }

    /// Whether a stop is over with this result. One that went well, or that a resume has ended, and was asked for again meanwhile is
    /// not: its end is what comes of that. As soon as it is over, the next one may have the slot: its result is there before, and nothing
    /// is stored after.
    pub fn ends(&self, result: Result<Completion, Failure>) -> bool {
        // Its result is there, and perhaps not taken.
        if self.queued.load(Ordering::SeqCst) == OVER {
            return false;
        }
        self.result.force_push(result);
        let goes_on = matches!(result, Ok(_) | Err(Failure::Superseded));
        let over = self
            .queued
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, |queued| {
                (queued == 0 || !goes_on).then_some(OVER)
            })
            .is_ok();
        if !over {
            self.result.pop();
        }
        over
    }

    /// Whether its result is there.
    pub fn is_done(&self) -> bool {
        self.has(mark::DONE) || self.queued.load(Ordering::SeqCst) == OVER
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
struct Kept {
    pub accepted: bool,
    pub result: Option<Result<Completion, Failure>>,
}

/// Who holds what is in the slots.
#[derive(Debug)]
struct Tickets {
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

    fn kept(&self) -> MutexGuard<'_, Kept> {
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

/// Where futures wait for this command.
const fn channel(id: CommandId) -> u32 {
    CHANGED + 1 + (id.0 & 0xFF)
}

// The program's end.

impl Shared {
    /// Asks for a stop: it is in the next frame, whatever is queued.
    pub fn request_stop(&self, stop: StopRequest) {
        let halt = stop == StopRequest::HALT;
        self.stops
            .note(if halt { StopKind::Halt } else { StopKind::Stop });
        self.stop.fetch_or(stop.bits(), Ordering::Release);
        self.ask();
    }

    /// Names the last stop, for a move that is asked for now and submitted later.
    pub fn last_stop(&self) -> LastStop {
        self.stops.last()
    }

    /// Queues a command.
    pub fn submit(&self, command: Command) -> Result<Arc<Ticket>, AxisErrorKind> {
        self.submit_asked(command, self.last_stop())
    }

    /// Queues a command that was asked for when this was the last stop: a move does not outlive a later one.
    pub fn submit_asked(
        &self,
        command: Command,
        asked: LastStop,
    ) -> Result<Arc<Ticket>, AxisErrorKind> {
        if let Some(kind) = StopKind::of(command) {
            self.stops.note(kind);
        }
        if self.is_closed() {
            return Err(AxisErrorKind::Closed);
        }
        match stop_place(command) {
            Some(place) => self.submit_stop(place, command, asked),
            None => self.submit_other(command, asked),
        }
    }

    fn submit_other(
        &self,
        command: Command,
        asked: LastStop,
    ) -> Result<Arc<Ticket>, AxisErrorKind> {
        let opened = self.slots.open(command).or_else(|| {
            // Results that nobody has taken go to those who hold them.
            self.tickets.each(|ticket| {
                if self.is_done(ticket.id) {
                    self.result(ticket);
                }
            });
            self.slots.open(command)
        });
        let (id, slot) = opened.ok_or(AxisErrorKind::QueueFull)?;
        if let Command::Jog(set_point) = command {
            slot.begin_jog(set_point.velocity);
        }
        let ticket = self.tickets.hold(id);
        if self.queue.push((id, command, asked)).is_err() {
            self.slots.give_back(id);
            return Err(AxisErrorKind::QueueFull);
        }
        self.ask();
        Ok(ticket)
    }

    /// Stops of one kind that are under way at once are one.
    fn submit_stop(
        &self,
        place: u8,
        command: Command,
        asked: LastStop,
    ) -> Result<Arc<Ticket>, AxisErrorKind> {
        let ticket = self.tickets.stop(place, |before| {
            if let Some(ticket) = before {
                let joined = self.slots.of(ticket.id).map_or(Joined::Over, |slot| {
                    if slot.is_queued_enough() {
                        // Before it is joined: it is taken in with what is in the queue by now.
                        self.request_stop(lane(command));
                    }
                    // Before it is joined, too: from then on it may be over.
                    slot.waiting.fetch_add(1, Ordering::AcqRel);
                    slot.join()
                });
                match joined {
                    Joined::Queue => return Some((Arc::clone(ticket), true)),
                    Joined::Queued => return Some((Arc::clone(ticket), false)),
                    // Its result is kept for those who have not taken it.
                    Joined::Over => drop(self.result(ticket)),
                }
            }
            let (id, _) = self.slots.open_stop(place)?;
            Some((Ticket::new(id), true))
        });
        let (ticket, is_queued) = ticket.ok_or(AxisErrorKind::QueueFull)?;
        if is_queued && self.queue.push((ticket.id, command, asked)).is_err() {
            self.request_stop(lane(command));
        }
        self.ask();
        Ok(ticket)
    }

    /// A jog is held, at this velocity or at the one that it has.
    pub fn hold_jog(&self, id: CommandId, velocity: Option<i32>) -> Result<(), Failure> {
        let limit = self.max_velocity.load(Ordering::Acquire);
        let speed = velocity.unwrap_or(0).unsigned_abs();
        if limit != 0 && speed > limit {
            return Err(Failure::TooFast {
                limit,
                velocity: speed,
            });
        }
        if let Some(slot) = self.slots.of(id) {
            if !slot.hold(velocity) {
                return Err(Failure::NotHeld);
            }
            self.ask();
        }
        Ok(())
    }

    /// Lets go of a jog: it is in the next frame, whatever is queued.
    pub fn release_jog(&self, id: CommandId) {
        if let Some(slot) = self.slots.of(id) {
            slot.release();
            self.ask();
        }
    }

    /// Lets go of all jogs: none begins at the same time.
    pub fn release_jogs(&self) {
        self.slots.slots.iter().for_each(Slot::release);
        self.ask();
    }

    /// Gives a command up, so far as it was not sent. `ends`: a homing that was sent is stopped.
    pub fn withdraw(&self, id: CommandId, ends: bool) {
        let _ = self.withdrawn.push(Withdrawn { id, ends });
        self.ask();
    }

    /// Nobody waits for this command any more. Where somebody takes its result meanwhile, its slot may already be another command's.
    pub fn leave(&self, ticket: &Ticket) {
        let kept = ticket.kept();
        if kept.result.is_none()
            && let Some(slot) = self.slots.of(ticket.id)
        {
            if Slots::is_stop(ticket.id) {
                slot.waiting.fetch_sub(1, Ordering::AcqRel);
            } else {
                self.slots
                    .mark_last(slot, ticket.id, mark::LEFT, mark::DONE);
            }
        }
    }

    /// Whether nobody waits for this command any more.
    fn is_left(&self, id: CommandId) -> bool {
        self.slots.of(id).is_some_and(|slot| slot.has(mark::LEFT))
    }

    /// Whether the drive has acknowledged this motion's set-point.
    pub fn is_accepted(&self, ticket: &Ticket) -> bool {
        let kept = ticket.kept();
        kept.accepted
            || self
                .slots
                .of(ticket.id)
                .is_some_and(|slot| slot.has(mark::ACCEPTED))
    }

    /// How often the axis stood halted with this move's set-point kept.
    pub fn halts(&self, id: CommandId) -> u32 {
        self.slots
            .of(id)
            .map_or(0, |slot| slot.halts.load(Ordering::Acquire))
    }

    pub fn is_done(&self, id: CommandId) -> bool {
        self.slots.of(id).is_none_or(Slot::is_done)
    }

    /// The result, once it is there. It is kept from then on, and its slot is free.
    pub fn result(&self, ticket: &Ticket) -> Option<Result<Completion, Failure>> {
        let mut kept = ticket.kept();
        if kept.result.is_some() {
            return kept.result;
        }
        // In this order: a command that was done before the end is not lost with the bus.
        let closed = self.is_closed();
        let slot = self.slots.of(ticket.id)?;
        let marks = slot.marks.load(Ordering::Acquire);
        if slot.is_done()
            && let Some(result) = slot.result.pop()
        {
            kept.accepted = marks & mark::ACCEPTED != 0;
            kept.result = Some(result);
            self.slots
                .mark_last(slot, ticket.id, mark::LEFT, mark::DONE);
            return kept.result;
        }
        let delivery = match marks {
            marks if marks & mark::ACCEPTED != 0 => Delivery::Accepted,
            marks if marks & mark::TAKEN != 0 => Delivery::Unknown,
            _ => Delivery::NotSent,
        };
        closed.then_some(Err(Failure::BusLost { delivery }))
    }

    /// Waits until `ready` gives a value: it is asked again whenever there is an event of this command.
    pub async fn until<T>(&self, id: CommandId, ready: impl FnMut() -> Option<T>) -> T {
        self.waiters.until(channel(id), ready).await
    }

    /// Waits for the end of the network.
    pub async fn until_closed(&self) {
        let is_closed = || self.is_closed().then_some(());
        self.waiters.until(CHANGED, is_closed).await;
    }

    /// Waits for the next change; false if there can be none any more. The end is one.
    pub async fn until_changed(&self) -> bool {
        // In this order, as they are stored in the other one: who begins to wait after the end knows of it.
        let before = self.changes.load(Ordering::Acquire);
        let _watch = self.setup.groups.signals.watch();
        self.waiters
            .until(CHANGED, || {
                let is_closed = self.is_closed();
                let is_changed = self.changes.load(Ordering::Acquire) != before;
                (is_changed || is_closed).then_some(is_changed)
            })
            .await
    }

    /// Whether the drive has taken this motion, or it has ended.
    pub fn is_over(&self, ticket: &Ticket) -> bool {
        let is_over = |slot: &Slot| {
            let marks = slot.marks.load(Ordering::Acquire);
            // One that was given up may be sent already, where the bus thread has it: then the drive may take it at any time.
            let given_up = marks & (mark::LEFT | mark::LATCHES) == mark::LEFT;
            given_up || marks & mark::ACCEPTED != 0 || slot.is_done()
        };
        self.slots.of(ticket.id).is_none_or(is_over) || self.is_closed()
    }

    pub fn set_manufacturer(&self, bits: Controlword) {
        let bits = bits.bits() & Controlword::MANUFACTURER.bits();
        self.manufacturer.store(bits, Ordering::Release);
        self.ask();
    }

    pub fn note_mode(&self, raw: i8) {
        self.noted_mode.set(raw.into());
        self.ask();
    }

    /// The drive has got this home offset 607Ch, in this start of the axis. One of before a recovery may be gone, and was read again.
    pub fn note_home_offset(&self, start: u64, offset: i32) {
        if start != self.starts() {
            return;
        }
        self.home_offset_in_doubt.store(false, Ordering::Release);
        self.noted_home_offset.set(offset);
        self.note_limits_changed();
        self.ask();
    }

    /// Limits that were being read are to be read again.
    pub fn note_limits_changed(&self) {
        self.limits_changed.fetch_add(1, Ordering::AcqRel);
    }

    /// For one who reads limits: another number afterwards says that what was read may be of before.
    pub fn limits_changed(&self) -> u64 {
        self.limits_changed.load(Ordering::Acquire)
    }

    /// A write of the home offset 607Ch begins. Until its answer, or until it is read, what the drive has is not known.
    pub fn doubt_home_offset(&self) {
        self.home_offset_in_doubt.store(true, Ordering::Release);
    }

    pub fn is_home_offset_in_doubt(&self) -> bool {
        self.home_offset_in_doubt.load(Ordering::Acquire)
    }

    /// The place among the outputs of an object that is mapped there.
    pub fn output_cell(&self, object: ObjectAddress) -> Option<usize> {
        self.outputs.place_of(object)
    }

    pub fn write_output(&self, cell: usize, raw: u32) {
        if self.outputs.set(cell, raw) {
            self.ask();
        }
    }

    pub fn written_output(&self, cell: usize) -> Option<u32> {
        self.outputs.get(cell)
    }

    /// To be called after everything that the bus thread is to take in was stored.
    pub fn ask(&self) {
        // Exchanged, as below, for the sake of other threads that ask at the same time.
        self.asked.swap(true, Ordering::Release);
        // In this order: who is told that somebody was asked finds who.
        self.setup.groups.signals.ask();
    }
}

/// What the stop lane asks for in place of this command.
const fn lane(command: Command) -> StopRequest {
    match command {
        Command::Halt => StopRequest::HALT,
        Command::QuickStop => StopRequest::QUICK_STOP,
        _ => StopRequest::STOP,
    }
}

/// What becomes of a command when nobody waits for it any more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum OnDrop {
    GoOn,
    /// So far as its drive has seen nothing of it.
    Withdraw,
    /// Withdrawn or, where its drive has seen something of it, stopped.
    End,
}

/// One command under way. Dropped before its drive has seen anything of it, a motion is withdrawn; other commands go on.
pub(super) struct Pending {
    pub handles: Arc<Handles>,
    pub id: CommandId,
    ticket: Arc<Ticket>,
    /// Of the handle.
    pub unit: HandleUnit,
    motion: Option<EndedByHalt>,
    on_drop: OnDrop,
    halts_seen: AtomicU32,
}

impl Pending {
    pub fn submit(
        handles: Arc<Handles>,
        unit: HandleUnit,
        command: Command,
    ) -> Result<Self, AxisError> {
        let ticket = handles.shared.submit(command);
        Self::of(handles, unit, None, ticket, OnDrop::GoOn)
    }

    /// What starts a motion and was asked for when this was the last stop.
    pub fn submit_motion(
        handles: Arc<Handles>,
        unit: HandleUnit,
        command: Command,
        asked: LastStop,
    ) -> Result<Self, AxisError> {
        let motion = EndedByHalt::of(&command);
        let ticket = handles.shared.submit_asked(command, asked);
        Self::of(handles, unit, motion, ticket, OnDrop::Withdraw)
    }

    fn of(
        handles: Arc<Handles>,
        unit: HandleUnit,
        motion: Option<EndedByHalt>,
        ticket: Result<Arc<Ticket>, AxisErrorKind>,
        on_drop: OnDrop,
    ) -> Result<Self, AxisError> {
        let ticket = ticket.map_err(|kind| handles.shared.error(kind))?;
        Ok(Self {
            id: ticket.id,
            ticket,
            unit,
            motion,
            on_drop,
            halts_seen: AtomicU32::new(0),
            handles,
        })
    }

    /// Dropped before its end, the change of mode is given up.
    pub const fn withdraw_on_drop(mut self) -> Self {
        self.on_drop = OnDrop::Withdraw;
        self
    }

    /// Dropped before its end, the homing is stopped.
    pub const fn end_on_drop(&mut self) {
        self.on_drop = OnDrop::End;
    }

    /// Gives it up now, so far as it was not sent: it then fails as [`Failure::Withdrawn`]. From then on dropping this does nothing more.
    pub fn withdraw(&mut self) {
        self.on_drop = OnDrop::GoOn;
        self.handles.withdraw(self.id, false);
    }

    pub fn ticket(&self) -> Arc<Ticket> {
        Arc::clone(&self.ticket)
    }

    /// The result, once it is there.
    pub fn result(&self) -> Option<Result<Completion, Failure>> {
        self.handles.shared.result(&self.ticket)
    }

    /// Waits for the result.
    pub async fn done(&self) -> Result<Completion, AxisError> {
        let result = self.wait(|| self.result()).await;
        self.judge(result).await
    }

    /// Waits for the result, or for the axis standing halted, each halt once.
    pub async fn done_or_halted(&self) -> Result<Completion, AxisError> {
        // Waits that are under way at the same time all hear of the same halt.
        let seen = self.halts_seen.load(Ordering::Acquire);
        let result = self
            .wait(|| {
                self.result().or_else(|| {
                    let halts = self.handles.shared.halts(self.id);
                    self.halts_seen.store(halts, Ordering::Release);
                    let delivery = if self.handles.shared.is_accepted(&self.ticket) {
                        Delivery::Accepted
                    } else {
                        Delivery::Unknown
                    };
                    (seen != halts).then_some(Err(Failure::Halted { delivery }))
                })
            })
            .await;
        self.judge(result).await
    }

    /// Waits for the drive's acknowledge of a move's set-point. From then on dropping this withdraws nothing.
    pub async fn accepted(&mut self) -> Result<(), AxisError> {
        let result = self
            .wait(|| {
                if self.handles.shared.is_accepted(&self.ticket) {
                    return Some(Ok(()));
                }
                self.result().map(|result| result.map(|_| ()))
            })
            .await;
        if self.on_drop == OnDrop::Withdraw {
            self.on_drop = OnDrop::GoOn;
        }
        match result {
            Ok(()) => Ok(()),
            Err(failure) => Err(self.fail(failure).await),
        }
    }

    async fn fail(&self, failure: Failure) -> AxisError {
        let error = self.handles.fail(failure).await;
        error.in_unit(self.unit).of_motion(self.motion)
    }

    /// An error of this command's handle.
    pub fn error(&self, kind: AxisErrorKind) -> AxisError {
        let error = self.handles.shared.error(kind);
        error.in_unit(self.unit).of_motion(self.motion)
    }

    async fn wait<T>(&self, ready: impl FnMut() -> Option<T>) -> T {
        self.handles.shared.until(self.id, ready).await
    }

    async fn judge(&self, result: Result<Completion, Failure>) -> Result<Completion, AxisError> {
        match result {
            Ok(completion) => Ok(completion),
            Err(failure) => Err(self.fail(failure).await),
        }
    }
}

/// For a log, in which it is to fit a line.
impl fmt::Debug for Pending {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pending")
            .field("handles", &self.handles)
            .field("ticket", &self.ticket)
            .field("unit", &self.unit)
            .field("on_drop", &self.on_drop)
            .finish_non_exhaustive()
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        let shared = &self.handles.shared;
        if self.on_drop != OnDrop::GoOn && !shared.is_done(self.id) {
            self.handles.withdraw(self.id, self.on_drop == OnDrop::End);
        }
        shared.leave(&self.ticket);
    }
}

// The bus thread's end, called twice a cycle, around the exchange. It allocates nothing and waits for nobody.

impl Shared {
    /// Whether there is anything to take in.
    pub fn is_asked(&self) -> bool {
        self.asked.load(Ordering::Relaxed)
    }

    /// To be called before anything is taken in: what is stored from now on is seen by the next look.
    pub fn answer(&self) {
        self.asked.swap(false, Ordering::AcqRel);
    }

    pub fn take_stop(&self) -> StopRequest {
        StopRequest::from_bits_truncate(self.stop.swap(0, Ordering::AcqRel))
    }

    /// How many commands are queued now.
    pub fn queue_length(&self) -> usize {
        self.queue.len()
    }

    pub fn take_command(&self) -> Option<(CommandId, Command, LastStop)> {
        let (id, command, asked) = self.queue.pop()?;
        let slot = self.slots.of(id);
        if stop_place(command).is_some() {
            // One that is over is carried out once more, and is nobody's.
            let waited_for = slot.is_some_and(Slot::take);
            return Some((if waited_for { id } else { NOBODY }, command, asked));
        }
        let marks = match command {
            Command::Move(_) | Command::Home(_) => mark::TAKEN | mark::LATCHES,
            Command::Jog(_) => mark::TAKEN,
            // Of what has no set-point none was sent, whether it was taken or not.
            _ => 0,
        };
        if let Some(slot) = slot
            && marks != 0
        {
            slot.marks.fetch_or(marks, Ordering::AcqRel);
        }
        Some((id, command, asked))
    }

    /// Why a move is not to be started that was asked for when this was the last stop, of an axis in this state.
    pub fn stopped_since(&self, asked: LastStop, state: State) -> Option<Failure> {
        self.stops.since(asked, state)
    }

    /// The velocity that a jog asks for now, and how often its holder has said so: none once it was let go.
    pub fn jog_demand(&self, id: CommandId) -> Option<(i32, u32)> {
        self.slots.of(id)?.held()
    }

    /// Says which limit the velocities of jogs are checked against.
    pub fn note_max_velocity(&self, limit: Option<u32>) {
        self.max_velocity
            .store(limit.unwrap_or(0), Ordering::Release);
    }

    pub fn has_withdrawn(&self) -> bool {
        !self.withdrawn.is_empty()
    }

    fn take_withdrawn(&self) -> Option<Withdrawn> {
        self.withdrawn.pop()
    }

    /// Bits 11 to 15 of the controlword, as last set.
    pub fn manufacturer(&self) -> Controlword {
        Controlword::from_bits_retain(self.manufacturer.load(Ordering::Acquire))
    }

    /// Writes what the program has set since the last time into the drive's outputs.
    pub fn merge_outputs(&self, outputs: &mut [u8]) {
        self.outputs.merge(outputs);
    }

    /// The axis begins again: nothing that was asked for or set before comes into effect any more. `held`: what its
    /// drive holds now, if that was read.
    pub fn restart(&self, held: Option<DriveSettings>) {
        self.stops.note(StopKind::Lost);
        self.manufacturer.store(0, Ordering::Release);
        self.outputs.clear();
        self.ask();
        if let Some(settings) = held {
            self.starts.fetch_add(1, Ordering::AcqRel);
            self.settings.set(settings);
            self.noted_mode.take();
            self.noted_home_offset.take();
            self.note_limits_changed();
            self.home_offset_in_doubt.store(false, Ordering::Release);
        }
    }

    /// Which start of the axis this is.
    pub fn starts(&self) -> u64 {
        self.starts.load(Ordering::Acquire)
    }

    /// What the drive holds, read after the axis was made.
    pub fn know(&self, settings: DriveSettings) {
        self.settings.set(settings);
    }

    /// The axis has stopped being driven without a command.
    pub fn note_fall(&self, failure: Failure) {
        self.stops.note(StopKind::of_fall(failure));
    }

    /// What the drive held when it was attached last.
    pub fn drive_settings(&self) -> DriveSettings {
        self.settings.get()
    }

    /// Passes an event to the command's future.
    pub fn report(&self, id: CommandId, event: Event) {
        let Some(slot) = self.slots.of(id) else {
            return;
        };
        match event {
            Event::Accepted => {
                slot.marks.fetch_or(mark::ACCEPTED, Ordering::AcqRel);
            }
            Event::Halted => {
                slot.halts.fetch_add(1, Ordering::AcqRel);
            }
            Event::Done(result) => {
                let taken = slot.has(mark::TAKEN);
                if !Slots::is_stop(id) {
                    slot.result.force_push(result);
                    self.slots.mark_last(slot, id, mark::DONE, mark::LEFT);
                } else {
                    let is_told = !slot.is_nobodys();
                    if !slot.ends(result) {
                        return;
                    }
                    if !is_told && matches!(result, Err(Failure::HaltIgnored | Failure::HaltCoasts))
                    {
                        // As of every halt that nobody waits for: it goes on to the quick stop.
                        self.request_stop(StopRequest::HALT);
                    }
                }
                if taken {
                    self.counts.ended(&result);
                }
            }
        }
        self.waiters.announce(channel(id));
    }

    /// Another snapshot shows something new. Only one thread may do this.
    #[inline]
    pub fn note_change(&self) {
        let changes = self.changes.load(Ordering::Relaxed);
        self.changes
            .store(changes.wrapping_add(1), Ordering::Release);
    }

    /// Wakes those who wait for a change; to be called after [`stored`](crate::wakes::stored).
    #[inline]
    pub fn ring_changed(&self) {
        self.waiters.ring(CHANGED);
    }

    /// The bus is gone: every future resolves, none is left waiting.
    pub fn close(&self) {
        self.closed.store(true, Ordering::Release);
        self.note_change();
        self.waiters.ring_all(u64::MAX);
    }
}

/// Carries commands from the handles to the axis core, and its reports and snapshots back. Order of a cycle:
///
/// 1. [`before_send`](Self::before_send) for every axis,
/// 2. [`Groups::advance`](super::Groups::advance), which raises bit 4 of the axes that start together,
/// 3. sending and receiving,
/// 4. [`AxisCore::step`] and [`after_step`](Self::after_step) for every axis.
///
/// When it is dropped, even by a panic, everything that waits for this axis resolves.
#[derive(Debug)]
pub struct AxisPort {
    shared: Arc<Shared>,
    manufacturer: Controlword,
    /// The snapshot that was published last; its cycle may be an older one.
    published: Head,
    /// Whether it differs from one before it, and those who wait for that were not woken since.
    changed: bool,
    has_fault: bool,
    /// Why nothing is enabled or moved any more.
    ended: Option<Failure>,
    /// Why it is not known whether the drive's outputs were delivered.
    miscounted: Option<WorkingCounter>,
    /// With which AL status code the drive has left OP.
    left_op: Option<u16>,
    /// Whether the network reports that: without a wrong counter, a drive whose outputs are not delivered has left OP.
    knows_counters: bool,
}

impl AxisPort {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        Self {
            manufacturer: Controlword::empty(),
            published: pack(&shared.snapshot()),
            changed: false,
            has_fault: false,
            ended: None,
            miscounted: None,
            left_op: None,
            knows_counters: false,
            shared,
        }
    }

    /// Whether [`before_send`](Self::before_send) has anything to do.
    #[must_use]
    pub fn is_asked(&self) -> bool {
        self.shared.is_asked()
    }

    /// Takes commands and withdrawals in, merges the outputs that the program has set since the last time, and last the stop
    /// lane.
    pub fn before_send(&mut self, core: &mut AxisCore, now: Duration, outputs: &mut [u8]) {
        let shared = &self.shared;
        shared.answer();
        shared.setup.groups.signals.note_time(now);
        // Before the commands: a jog that was let go makes room for the next.
        self.follow_jog(core, now, outputs);
        let not_taken = shared
            .has_withdrawn()
            .then(|| self.withdraw_taken(core, now, outputs));
        // No more than these: what was set before one of them was asked for is seen from here on.
        let queued = shared.queue_length();
        if let Some(raw) = shared.noted_mode.take() {
            core.note_mode(Mode::from_raw(raw as i8));
        }
        if let Some(offset) = shared.noted_home_offset.take() {
            core.note_home_offset(offset);
        }
        let manufacturer = shared.manufacturer();
        if manufacturer != self.manufacturer {
            self.manufacturer = manufacturer;
            core.set_manufacturer_bits(manufacturer);
        }
        shared.merge_outputs(outputs);
        self.take_commands(queued, core, now, outputs);
        let stop = shared.take_stop();
        if !stop.is_empty() {
            // What was queued before the stop was asked for is stopped with the rest, not started after it.
            self.take_commands(shared.queue_length(), core, now, outputs);
        }
        // A command is queued before it is withdrawn: who was not found before was in the queue.
        for withdrawn in not_taken.into_iter().flatten().flatten() {
            withdraw(core, now, withdrawn, outputs);
        }
        // And after them: one that was let go before it began never leaves 0.
        self.follow_jog(core, now, outputs);
        if !stop.is_empty() {
            core.apply_stop(now, stop, outputs);
        }
        self.pass_events(core);
    }

    /// A stop for this axis from the owner of the cycle, as by a [`StopHandle`](super::StopHandle). The next
    /// [`before_send`](Self::before_send) merges it.
    pub fn request_stop(&self, stop: StopRequest) {
        self.shared.request_stop(stop);
    }

    /// What a [`LivenessWatch`](super::LivenessWatch) says, before [`before_send`](Self::before_send). Where it has just expired the axis
    /// halts, and as long as it has, what would set the axis going fails as [`Failure::LivenessExpired`].
    pub fn obey(&self, core: &mut AxisCore, expired: bool) {
        if expired && !core.expired {
            self.request_stop(StopRequest::HALT);
        }
        core.set_expired(expired);
    }

    /// From now on only what stops is taken from the handles: nothing is enabled or moved any more.
    pub const fn end(&mut self) {
        self.end_because(Failure::BusLost {
            delivery: Delivery::NotSent,
        });
    }

    /// As [`end`](Self::end), with what is said of what is refused, and of what ends because the axis is disabled.
    pub(crate) const fn end_because(&mut self, cause: Failure) {
        self.ended = Some(cause);
    }

    /// From now on [`note_doubt`](Self::note_doubt) says why.
    pub(crate) const fn know_counters(&mut self) {
        self.knows_counters = true;
    }

    /// Why it is not known whether the outputs of the last cycle were delivered, where that is so, and with which AL status code the
    /// drive has left OP.
    #[inline]
    pub(crate) const fn note_doubt(
        &mut self,
        counter: Option<WorkingCounter>,
        left_op: Option<u16>,
    ) {
        self.miscounted = counter;
        self.left_op = left_op;
    }

    /// What was read of the axis' drive, before there is a handle of it.
    pub(crate) fn know(&mut self, core: &mut AxisCore, config: CoreConfig) {
        self.shared.know(DriveSettings::of(&config));
        core.know(config);
    }

    /// What the drive holds in an object that is mapped into its outputs: it goes out until a handle sets it.
    pub(crate) fn hold(&self, object: ObjectAddress, raw: u32) {
        self.shared.outputs.hold(object, raw);
        self.shared.ask();
    }

    /// Begins again with its core, which it restarts: whatever handles have asked for or set before does not come into effect
    /// any more.
    pub(crate) fn restart(
        &mut self,
        core: &mut AxisCore,
        now: Duration,
        again: Reattach,
        outputs: &mut [u8],
    ) {
        let held = match &again {
            Reattach::Kept(config) | Reattach::Anew(config) => Some(DriveSettings::of(config)),
            Reattach::Unknown => None,
        };
        self.shared.restart(held);
        self.manufacturer = Controlword::empty();
        core.restart(now, again, outputs);
        self.pass_events(core);
    }

    /// Passes the core's reports to the futures that wait for them and publishes the snapshot.
    ///
    /// `inputs` are the drive's, or none if none came in this cycle, or the same as in the one before.
    pub fn after_step(&mut self, core: &mut AxisCore, inputs: Option<&[u8]>) {
        self.pass(core, inputs);
        stored();
        self.wake();
        self.shared.setup.groups.signals.hand_over();
    }

    /// As [`after_step`](Self::after_step), without waking those who wait for a change; gives the snapshot where more in it
    /// is new than the motion.
    #[inline(always)]
    pub(crate) fn pass(&mut self, core: &mut AxisCore, inputs: Option<&[u8]>) -> Option<Snapshot> {
        let change = core.take_change();
        if matches!(change, SnapshotChange::Silence | SnapshotChange::Anything) {
            return self.publish_change(core, change, inputs);
        }
        if change == SnapshotChange::Motion || inputs.is_some() {
            let (position, velocity) = core.motion();
            self.publish_motion(core.cycle, motion(position, velocity), inputs);
        } else {
            self.shared.status.tick(core.cycle);
        }
        None
    }

    /// Publishes what it was, with another motion.
    #[inline(always)]
    fn publish_motion(&mut self, cycle: u64, motion: u64, inputs: Option<&[u8]>) {
        let [_, flags, words, before] = self.published;
        let head = [cycle, flags, words, motion];
        self.shared.status.publish(head, inputs);
        if motion != before {
            self.published[3] = motion;
            self.note_change();
        }
    }

    /// Publishes what is more than a motion; a silence where it is that alone.
    #[inline(never)]
    fn publish_change(
        &mut self,
        core: &mut AxisCore,
        change: SnapshotChange,
        inputs: Option<&[u8]>,
    ) -> Option<Snapshot> {
        if change == SnapshotChange::Silence && inputs.is_none() {
            self.publish_silence(core.cycle, core.age());
            None
        } else {
            Some(self.publish_anew(core, inputs))
        }
    }

    /// Publishes what it was, one cycle without inputs older.
    fn publish_silence(&mut self, cycle: u64, age: u32) {
        let [_, flags, words, motion] = self.published;
        self.publish([cycle, silent(flags, age), words, motion], None);
    }

    fn publish_anew(&mut self, core: &mut AxisCore, inputs: Option<&[u8]>) -> Snapshot {
        let snapshot = core.snapshot();
        // Before anybody knows: who asks for a motion after that asks for another one.
        if let Some(failure) = core.take_fall() {
            self.shared.note_fall(failure);
        }
        if snapshot.state.is_fault() && !self.has_fault {
            self.shared.counts.fault(core.error_code());
        }
        self.has_fault = snapshot.state.is_fault();
        // First the snapshot: a future that is woken by its result reads the status that belongs to it.
        self.publish(pack(&snapshot), inputs);
        self.pass_events(core);
        snapshot
    }

    #[inline]
    fn publish(&mut self, head: Head, inputs: Option<&[u8]>) {
        self.shared.status.publish(head, inputs);
        if differs(&self.published, &head) {
            self.note_change();
        }
        self.published = head;
    }

    /// What was published differs from the one before.
    #[inline]
    fn note_change(&mut self) {
        self.shared.note_change();
        self.changed = true;
    }

    /// Wakes those who wait for a change of this axis, if there was one since the last time; to be called after [`stored`].
    #[inline]
    pub(crate) fn wake(&mut self) {
        if core::mem::take(&mut self.changed) {
            self.shared.ring_changed();
        }
    }

    /// Ends it all: every future of this axis resolves with [`Failure::BusLost`](crate::axis::Failure::BusLost), the last snapshot says that the drive
    /// is lost, and new commands are refused.
    pub fn close(&mut self) {
        if self.shared.is_closed() {
            return;
        }
        let lost = Snapshot {
            answered: false,
            lost: true,
            ..self.shared.snapshot()
        };
        self.shared.status.publish(pack(&lost), None);
        self.shared.close();
        self.shared.setup.groups.signals.hand_over();
    }

    /// What the program has given up makes room for the commands that are queued. Gives those that may be among these.
    #[cold]
    fn withdraw_taken(
        &self,
        core: &mut AxisCore,
        now: Duration,
        outputs: &mut [u8],
    ) -> [Option<Withdrawn>; WITHDRAWN_AT_MOST] {
        let mut not_found = [None; WITHDRAWN_AT_MOST];
        for place in &mut not_found {
            let Some(withdrawn) = self.shared.take_withdrawn() else {
                break;
            };
            if !withdraw(core, now, withdrawn, outputs) {
                *place = Some(withdrawn);
            }
        }
        self.pass_events(core);
        not_found
    }

    /// Submits so many of what is queued. A stop among it is in the frame that is about to be sent, like the stop lane.
    fn take_commands(&self, many: usize, core: &mut AxisCore, now: Duration, outputs: &mut [u8]) {
        for _ in 0..many {
            let Some((id, command, asked)) = self.shared.take_command() else {
                break;
            };
            match self.refusal(id, command, asked, core) {
                Some(failure) => self.shared.report(id, Event::Done(Err(failure))),
                None => core.submit(now, id, command, outputs),
            }
            self.pass_events(core);
        }
    }

    /// Why the core is not to see this command.
    fn refusal(
        &self,
        id: CommandId,
        command: Command,
        asked: LastStop,
        core: &AxisCore,
    ) -> Option<Failure> {
        if StopKind::of(command).is_some() {
            return None;
        }
        if self.ended.is_some() {
            return self.ended;
        }
        match command {
            // The core says why.
            _ if core.expired => None,
            // Dropped since the withdrawals were taken: the parameters of the next may be written already.
            Command::Move(_) | Command::Home(_) if self.shared.is_left(id) => {
                Some(Failure::Withdrawn)
            }
            Command::Move(_) | Command::Home(_) | Command::Jog(_) => {
                self.shared.stopped_since(asked, core.state())
            }
            _ => None,
        }
    }

    /// The velocity that the holder of a jog asks for, or that there is no holder any more. No queue lies between.
    fn follow_jog(&self, core: &mut AxisCore, now: Duration, outputs: &mut [u8]) {
        if let Some(id) = core.jog() {
            self.shared.note_max_velocity(core.max_velocity());
            match self.shared.jog_demand(id) {
                None => {
                    core.release_jog(now, id, outputs);
                }
                Some((_, times)) if !core.hold_jog(now, id, times, outputs) => {
                    // What its holder says from now on comes too late.
                    self.shared.release_jog(id);
                }
                Some((velocity, _)) => {
                    core.set_jog(id, velocity, outputs);
                }
            }
            if core.has_dead_man() {
                // The time of its holder is judged in the next cycle, also where nobody asks for anything.
                self.shared.ask();
            }
        }
    }

    fn pass_events(&self, core: &mut AxisCore) {
        while let Some((id, event)) = core.poll_event() {
            let event = match (self.ended, event) {
                (
                    Some(cause @ Failure::ClockJumped),
                    Event::Done(Err(Failure::Disabled { .. })),
                ) => Event::Done(Err(cause)),
                (_, Event::Done(Err(Failure::Undelivered { delivery, .. }))) => {
                    Event::Done(Err(match (self.miscounted, self.left_op) {
                        (None, Some(code)) => Failure::LeftOp { code, delivery },
                        (None, None) if self.knows_counters => Failure::BusLost { delivery },
                        (counter, _) => Failure::Undelivered { delivery, counter },
                    }))
                }
                _ => event,
            };
            self.shared.report(id, event);
        }
    }
}

/// Takes back what was not sent, and ends a homing that was and is to end. False if there was neither.
fn withdraw(core: &mut AxisCore, now: Duration, withdrawn: Withdrawn, outputs: &mut [u8]) -> bool {
    core.withdraw(withdrawn.id, outputs)
        || (withdrawn.ends && core.end_homing(now, withdrawn.id, outputs))
}

impl Drop for AxisPort {
    fn drop(&mut self) {
        self.close();
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
                StopKind::Lost,
                Failure::BusLost {
                    delivery: Delivery::NotSent,
                },
            ),
            (StopKind::Fault, Failure::Fault { code: None }),
        ];
        for (kind, failure) in kinds {
            let asked = stops.last();
            stops.note(kind);
            assert_eq!(stops.since(asked, state), Some(failure));
            assert_eq!(stops.since(before, state), Some(failure));
            assert_eq!(stops.since(stops.last(), state), None);
        }
    }

    /// Nothing is stored in its slot after that, which may be the next one's by then.
    #[test]
    fn a_stop_that_is_over_has_its_result() {
        let done = Ok(Completion::Done);
        let slot = Slot::new();
        slot.queued.store(1, Ordering::Relaxed);
        assert!(!slot.ends(done), "it was asked for once more");
        assert!(!slot.is_done() && slot.result.is_empty());
        slot.take();
        assert!(slot.ends(done) && slot.is_done());
        assert_eq!(slot.join(), Joined::Over);
        // It was in the queue twice.
        assert!(!slot.take() && !slot.ends(Err(Failure::Busy)));
        assert_eq!(slot.result.pop(), Some(done));
    }

    /// It is dropped while the bus thread takes commands in, and its withdrawal is in the next cycle.
    #[test]
    fn a_move_that_is_dropped_before_it_is_taken_is_not_started() {
        use crate::{
            axis::{AxisFields, AxisIdentity, AxisSetup, CoreConfig, GroupQueue, NoParameters},
            coe::{AxisOffset, DriveId},
            drives,
            profile_position::{MoveCommand, Reference, SetPoint},
            units::AxisScale,
        };

        let layout = drives::generic().default_mapping().unwrap().layout();
        let fields = AxisFields::from_layout(&layout, AxisOffset::default()).unwrap();
        let mut core = AxisCore::new(CoreConfig::new(fields));
        let drive = DriveId {
            position: 0,
            name: "lift".into(),
            identity: Default::default(),
        };
        let setup = AxisSetup {
            identity: AxisIdentity {
                axis: "z".into(),
                drive,
            },
            offset: AxisOffset::default(),
            fields,
            scale: AxisScale::COUNTS,
            layout,
            parameters: Arc::new(NoParameters),
            groups: GroupQueue::in_virtual_time(),
            index: 0,
        };
        let (_, mut port) = setup.open(&core);
        let command = Command::Move(MoveCommand {
            reference: Reference::Absolute,
            target: 1_000,
            set_point: SetPoint::new(),
            gated: false,
        });
        let asked = port.shared.last_stop();
        let kept = port.shared.submit_asked(command, asked).unwrap();
        let dropped = port.shared.submit_asked(command, asked).unwrap();
        port.shared.leave(&dropped);
        port.before_send(&mut core, Duration::from_millis(1), &mut [0; 19]);
        let result_of = |ticket: &Ticket| {
            port.shared
                .slots
                .of(ticket.id)
                .unwrap()
                .result
                .pop()
                .unwrap()
        };
        assert_eq!(result_of(&dropped), Err(Failure::Withdrawn));
        assert_ne!(result_of(&kept), Err(Failure::Withdrawn));
    }
}
