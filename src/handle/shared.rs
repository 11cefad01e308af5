//! What the handles of an axis and the bus thread share: commands in slots, the stop lane, the snapshot. Only atomics.

use core::{
    fmt,
    sync::atomic::{AtomicBool, AtomicI16, AtomicU8, AtomicU16, AtomicU32, AtomicU64, Ordering},
};
use std::sync::Arc;

use crossbeam_queue::ArrayQueue;

use crate::{
    axis::{
        AxisCore, Command, CommandId, Completion, Delivery, DriveSettings, Event, Failure,
        Snapshot, StopRequest,
    },
    coe::ObjectAddress,
    ds402::{Controlword, State},
    wakes::Waiters,
};

use super::{
    AxisError, AxisErrorKind, AxisIdentity, AxisSetup,
    commands::{Joined, QUEUED_AT_MOST, SHARED, Slots, Ticket, Tickets, mark, stop_place},
    output_cells::OutputCells,
    setup::SettingsCell,
    statistics::AxisCounts,
    status::StatusCell,
    stops::{LastStop, StopCount, StopKind},
};

/// The channel of futures that wait for a change; those of the commands' slots follow.
const CHANGED: u32 = 0;
/// Set in the noted mode once one was noted.
const NOTED: i16 = 1 << 8;

/// A slot gives at most one withdrawal between two cycles, and one that was there before.
pub(super) const WITHDRAWN_AT_MOST: usize = 2 * SHARED as usize;

/// A command that was given up.
#[derive(Debug, Clone, Copy)]
pub(super) struct Withdrawn {
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
    /// Whether a mode is leased.
    pub leased: AtomicBool,
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
    noted_mode: AtomicI16,
    /// Max profile velocity 607Fh as the core checks it; 0 is no limit.
    max_velocity: AtomicU32,
    /// What the drive held when it was attached last.
    settings: SettingsCell,
    closed: AtomicBool,
    /// How often the drive was attached anew since its axis was made: what was known of it before is not true any more.
    attached: AtomicU32,
    outputs: OutputCells,
    pub counts: AxisCounts,
}

impl Shared {
    pub fn new(setup: AxisSetup, core: &AxisCore) -> Self {
        Self {
            identity: Arc::new(setup.identity.clone()),
            status: StatusCell::new(&core.snapshot(), setup.layout.input_bytes()),
            waiters: setup.groups.waiters(),
            changes: AtomicU64::new(0),
            leased: AtomicBool::new(false),
            asked: AtomicBool::new(false),
            queue: ArrayQueue::new(QUEUED_AT_MOST),
            withdrawn: ArrayQueue::new(WITHDRAWN_AT_MOST),
            slots: Slots::new(),
            tickets: Tickets::new(),
            stop: AtomicU8::new(0),
            stops: StopCount::default(),
            manufacturer: AtomicU16::new(0),
            noted_mode: AtomicI16::new(0),
            max_velocity: AtomicU32::new(0),
            settings: SettingsCell::new(core.drive_settings()),
            closed: AtomicBool::new(false),
            attached: AtomicU32::new(0),
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

    // The handles' side.

    /// The latest snapshot.
    pub fn snapshot(&self) -> Snapshot {
        self.status.snapshot_after(self.setup.groups.cycles())
    }

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
            slot.let_go();
            self.ask();
        }
    }

    /// Gives a command up, so far as it was not sent. `ends`: a homing that was sent is stopped.
    pub fn withdraw(&self, id: CommandId, ends: bool) {
        let _ = self.withdrawn.push(Withdrawn { id, ends });
        self.ask();
    }

    /// Nobody waits for this command any more.
    pub fn leave(&self, id: CommandId) {
        if let Some(slot) = self.slots.of(id) {
            self.slots.mark_last(slot, id, mark::LEFT, mark::DONE);
        }
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
        self.slots.of(id).is_none_or(|slot| slot.has(mark::DONE))
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
        if marks & mark::DONE != 0 {
            kept.accepted = marks & mark::ACCEPTED != 0;
            kept.result = slot.result.pop();
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

    /// Waits for the next change; false if there can be none any more. The end is one.
    pub async fn until_changed(&self) -> bool {
        // In this order, as they are stored in the other one: who begins to wait after the end knows of it.
        let before = self.changes.load(Ordering::Acquire);
        let _watch = self.setup.groups.watch();
        self.waiters
            .until(CHANGED, || {
                let is_closed = self.is_closed();
                let is_changed = self.changes.load(Ordering::Acquire) != before;
                (is_changed || is_closed).then_some(is_changed)
            })
            .await
    }

    /// Whether the drive has taken this motion, or it has ended or was given up.
    pub fn is_over(&self, ticket: &Ticket) -> bool {
        let over = mark::ACCEPTED | mark::DONE | mark::LEFT;
        self.slots
            .of(ticket.id)
            .is_none_or(|slot| slot.marks.load(Ordering::Acquire) & over != 0)
            || self.is_closed()
    }

    pub fn set_manufacturer(&self, bits: Controlword) {
        let bits = bits.bits() & Controlword::MANUFACTURER.bits();
        self.manufacturer.store(bits, Ordering::Release);
        self.ask();
    }

    pub fn note_mode(&self, raw: i8) {
        let noted = NOTED | i16::from(raw.cast_unsigned());
        self.noted_mode.store(noted, Ordering::Release);
        self.ask();
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
        self.setup.groups.ask();
    }

    // The bus thread's side.

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
        if let Some(slot) = self.slots.of(id) {
            use Command::{Home, Jog, Move};
            match command {
                Move(_) | Home(_) | Jog(_) => {
                    slot.marks.fetch_or(mark::TAKEN, Ordering::AcqRel);
                }
                // Of what has no set-point none was sent, whether it was taken or not.
                other if stop_place(other).is_some() => slot.take(),
                _ => {}
            }
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

    pub fn take_withdrawn(&self) -> Option<Withdrawn> {
        self.withdrawn.pop()
    }

    /// Bits 11 to 15 of the controlword, as last set.
    pub fn manufacturer(&self) -> Controlword {
        Controlword::from_bits_retain(self.manufacturer.load(Ordering::Acquire))
    }

    pub fn take_noted_mode(&self) -> Option<i8> {
        let noted = self.noted_mode.load(Ordering::Acquire);
        if noted & NOTED == 0 {
            return None;
        }
        Some(self.noted_mode.swap(0, Ordering::AcqRel) as i8)
    }

    /// Writes what the program has set since the last time into the drive's outputs.
    pub fn merge_outputs(&self, outputs: &mut [u8]) {
        self.outputs.merge(outputs);
    }

    /// The axis begins again: nothing that was asked for or set before comes into effect any more. `anew`: its drive has
    /// forgotten what was written to it.
    pub fn restart(&self, anew: Option<DriveSettings>) {
        self.stops.note(StopKind::Restart);
        self.manufacturer.store(0, Ordering::Release);
        self.outputs.clear();
        if let Some(settings) = anew {
            self.settings.set(settings);
            self.noted_mode.store(0, Ordering::Release);
            self.attached.fetch_add(1, Ordering::AcqRel);
        }
    }

    /// What the drive holds, read after the axis was made.
    pub fn know(&self, settings: DriveSettings) {
        self.settings.set(settings);
    }

    /// What the drive held when it was attached last.
    pub fn drive_settings(&self) -> DriveSettings {
        self.settings.get()
    }

    /// How often the drive was attached anew.
    pub fn attached(&self) -> u32 {
        self.attached.load(Ordering::Acquire)
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
                if Slots::is_stop(id) && !slot.ends(result) {
                    return;
                }
                if slot.marks.load(Ordering::Acquire) & mark::TAKEN != 0 {
                    self.counts.ended(&result);
                }
                slot.result.force_push(result);
                self.slots.mark_last(slot, id, mark::DONE, mark::LEFT);
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

/// What the stop lane asks for in place of this command.
const fn lane(command: Command) -> StopRequest {
    match command {
        Command::Halt => StopRequest::HALT,
        Command::QuickStop => StopRequest::QUICK_STOP,
        _ => StopRequest::STOP,
    }
}

/// Where futures wait for this command.
const fn channel(id: CommandId) -> u32 {
    CHANGED + 1 + (id.0 & 0xFF)
}

/// By its name: the rest of it is of no use to a reader of a log.
impl fmt::Debug for Shared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.identity.axis)
    }
}
