//! The bus thread's end of an axis: it takes requests to the axis core, and brings reports and snapshots back.
//!
//! It is called twice a cycle, around the exchange. It allocates nothing, frees nothing and waits for nobody: a request is moved from one
//! queue to the table of those that the core has, and from there to the other queue.

use core::{sync::atomic::Ordering, time::Duration};
use std::sync::Arc;

use crate::{
    Failure, Referencing, StopRequest,
    axis::{
        AxisCore, Command, CommandId, Delivery, DriveSettings, Event, Reattach, Snapshot,
        SnapshotChange, Unsupported, WorkingCounter,
    },
    ds402::{Controlword, Mode},
    wakes::stored,
};

use super::{
    queue::REQUESTS,
    request::{AxisRequest, CHANGED},
    shared::Shared,
    status::{Head, differs, motion, pack, silent},
    stops::{LastStop, StopKind},
};

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
    /// The requests that the core has, in the order in which it got them.
    taken: Vec<Taken>,
    manufacturer: Controlword,
    /// The snapshot that was published last; its cycle may be an older one.
    published: Head,
    /// Whether it differs from one before it, and those who wait for that were not woken since.
    changed: bool,
    has_fault: bool,
    /// Why nothing is enabled or moved any more.
    ended: Option<Failure>,
    /// Why it is not known whether the drive's outputs were delivered: a wrong working counter, or with which AL status code the drive has
    /// left OP. None where nobody says.
    doubt: Option<(Option<WorkingCounter>, Option<u16>)>,
    /// The drive is of an optional group that is not in the line.
    is_absent: bool,
}

#[derive(Debug)]
struct Taken {
    request: Arc<AxisRequest>,
    /// As it was asked for when the core got it. A stop that was asked for again since is carried out once more.
    asked: LastStop,
}

impl Taken {
    /// Whether this is a stop that was asked for again, by this one or one before it.
    fn is_due(&self, up_to: LastStop) -> bool {
        let asked = self.request.asked();
        asked != self.asked && asked <= up_to
    }
}

impl AxisPort {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        Self {
            taken: Vec::with_capacity(REQUESTS),
            manufacturer: Controlword::empty(),
            published: pack(&shared.snapshot()),
            changed: false,
            has_fault: false,
            ended: None,
            doubt: None,
            is_absent: false,
            shared,
        }
    }

    /// Whether [`before_send`](Self::before_send) has anything to do.
    #[must_use]
    pub fn is_asked(&self) -> bool {
        self.shared.asked.load(Ordering::Relaxed)
    }

    /// Takes commands and withdrawals in, merges the outputs that the program has set since the last time, and last the stop
    /// lane.
    pub fn before_send(&mut self, core: &mut AxisCore, now: Duration, outputs: &mut [u8]) {
        // First: the next look sees what is stored from here on.
        self.shared.asked.swap(false, Ordering::AcqRel);
        self.shared.setup.groups.signals.note_time(now);
        // Before the commands: a jog that was let go, and what was given up, make room for the next.
        let mut next = NextFrame { core, now, outputs };
        self.follow_jog(&mut next);
        self.withdraw_given_up(&mut next);
        // No more than these: what was set before one of them was asked for is seen from here on.
        let queued = self.shared.queue.out.len();
        self.take_notes(&mut next);
        self.take_commands(queued, &mut next);
        let stop = self.shared.stops.take();
        if !stop.is_empty() {
            // What was queued before the stop was asked for is stopped with the rest, not started after it.
            self.take_commands(self.shared.queue.out.len(), &mut next);
        }
        // The generation is fixed here: a program that asks without end does not keep the bus thread.
        self.take_stops_again(self.shared.stops.last(), &mut next);
        // After the commands: a jog that was let go before it began never leaves 0.
        self.follow_jog(&mut next);
        if !stop.is_empty() {
            next.core.apply_stop(now, stop, next.outputs);
        }
        self.pass_events(next.core);
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
        self.doubt = Some((None, None));
    }

    /// Why it is not known whether the outputs of the last cycle were delivered, where that is so, and with which AL status code the
    /// drive has left OP.
    #[inline]
    pub(crate) const fn note_doubt(
        &mut self,
        counter: Option<WorkingCounter>,
        left_op: Option<u16>,
    ) {
        self.doubt = Some((counter, left_op));
    }

    /// Whether the drive is of an optional group that is not in the line.
    pub(crate) const fn set_absent(&mut self, is_absent: bool) {
        self.is_absent = is_absent;
    }

    pub(crate) const fn is_absent(&self) -> bool {
        self.is_absent
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
        let shared = &self.shared;
        shared.stops.note(StopKind::Lost);
        shared.manufacturer.store(0, Ordering::Release);
        self.manufacturer = Controlword::empty();
        shared.outputs.clear();
        shared.ask();
        if let Reattach::Kept(config) | Reattach::Anew(config) = &again {
            shared.notes.restart(DriveSettings::of(config));
        }
        if let Reattach::Anew(config) = &again
            && config.referencing != Referencing::AbsoluteEncoder
        {
            shared.displaced.store(true, Ordering::Release);
        }
        core.restart(now, again, outputs);
        self.pass_events(core);
    }

    /// Ends it all: every future of this axis resolves with [`Failure::BusLost`](crate::Failure::BusLost), the last snapshot says that the drive
    /// is lost, and new commands are refused.
    ///
    /// A request that is sent at the same time stays without a result, and its future finds that the network has ended.
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
        self.shared.closed.store(true, Ordering::Release);
        self.note_change();
        self.shared.waiters.ring_all(u64::MAX);
        self.shared.setup.groups.signals.hand_over();
    }
}

impl Drop for AxisPort {
    fn drop(&mut self) {
        self.close();
    }
}

// Before sending: what the program asks for.

/// The core, and the outputs that are about to be sent.
struct NextFrame<'a> {
    core: &'a mut AxisCore,
    now: Duration,
    outputs: &'a mut [u8],
}

impl NextFrame<'_> {
    fn submit(&mut self, id: CommandId, command: Command) {
        self.core.submit(self.now, id, command, self.outputs);
    }
}

impl AxisPort {
    /// What the program has set, which is no command.
    fn take_notes(&mut self, next: &mut NextFrame<'_>) {
        let (shared, core) = (&self.shared, &mut *next.core);
        if let Some(raw) = shared.notes.mode.take() {
            core.note_mode(Mode::from_raw(raw as i8));
        }
        if let Some(offset) = shared.notes.home_offset.take() {
            core.note_home_offset(offset);
        }
        let manufacturer = shared.manufacturer.load(Ordering::Acquire);
        let manufacturer = Controlword::from_bits_retain(manufacturer);
        if manufacturer != self.manufacturer {
            self.manufacturer = manufacturer;
            core.set_manufacturer_bits(manufacturer);
        }
        shared.outputs.merge(next.outputs);
    }

    /// Takes back what was given up and not sent, and ends a motion that was sent and is to end.
    fn withdraw_given_up(&mut self, next: &mut NextFrame<'_>) {
        let NextFrame { core, now, outputs } = next;
        let mut any = false;
        for Taken { request, .. } in &self.taken {
            if let Some(ends) = request.take_withdrawal() {
                let withdrawn = core.withdraw(*now, request.id, outputs);
                // It counts as asked for now, like each stop: in the frame that is about to be sent, and by all that was asked for before.
                if !withdrawn
                    && ends
                    && let Some(stop) = core.stop_of(request.id)
                {
                    self.shared.request_stop(stop);
                }
                any = true;
            }
        }
        if any {
            self.pass_events(core);
        }
    }

    /// Submits so many of what is queued. A stop among it is in the frame that is about to be sent, like the stop lane.
    fn take_commands(&mut self, many: usize, next: &mut NextFrame<'_>) {
        for _ in 0..many {
            let Some(request) = self.shared.queue.out.pop() else {
                break;
            };
            let (id, command, asked) = (request.id, request.command, request.asked());
            // A program that asks for a stop once more, and then for this, has them carried out in this order.
            self.take_stops_again(asked, next);
            let refusal = self.refusal(&request, next.core);
            self.taken.push(Taken { request, asked });
            match refusal {
                Some(failure) => self.report(id, Event::Done(Err(failure))),
                None => next.submit(id, command),
            }
            self.pass_events(next.core);
        }
    }

    /// Submits the stops that were asked for again, up to this one, in their order.
    #[inline]
    fn take_stops_again(&mut self, up_to: LastStop, next: &mut NextFrame<'_>) {
        if self.taken.iter().any(|taken| taken.is_due(up_to)) {
            self.carry_out_again(up_to, next);
        }
    }

    #[cold]
    fn carry_out_again(&mut self, up_to: LastStop, next: &mut NextFrame<'_>) {
        while self.taken.iter().any(|taken| taken.is_due(up_to)) {
            let due = self.taken.iter_mut().filter(|taken| taken.is_due(up_to));
            if let Some(first) = due.min_by_key(|taken| taken.request.asked()) {
                first.asked = first.request.asked();
                next.submit(first.request.id, first.request.command);
            }
            self.pass_events(next.core);
        }
    }

    /// Why the core is not to see this request.
    fn refusal(&self, request: &AxisRequest, core: &AxisCore) -> Option<Failure> {
        if !request.take() {
            return Some(Failure::Withdrawn);
        }
        if request.is_stop() {
            return None;
        }
        if self.ended.is_some() {
            return self.ended;
        }
        // An expired core says why.
        if core.expired || !request.is_motion() {
            return None;
        }
        self.shared.stops.since(request.asked(), core.state())
    }

    /// The velocity that the holder of a jog asks for, or that there is no holder any more. No queue lies between.
    fn follow_jog(&self, next: &mut NextFrame<'_>) {
        let NextFrame { core, now, outputs } = next;
        let Some(id) = core.jog() else { return };
        self.shared.notes.note_velocities(core.limits());
        let mut requests = self.taken.iter().map(|taken| &taken.request);
        let jog = requests.find(|request| request.id == id);
        let held = jog.filter(|jog| !self.shared.is_leased_again(jog.lease));
        match held.and_then(|jog| Some((jog, jog.demand()?))) {
            None => {
                core.release_jog(*now, id, outputs);
            }
            Some((jog, (_, times))) if !core.hold_jog(*now, id, times, outputs) => {
                // What its holder says from now on comes too late.
                jog.release();
            }
            Some((_, (velocity, _))) => {
                core.set_jog(id, velocity, outputs);
            }
        }
        if core.has_dead_man() {
            // The time of its holder is judged in the next cycle, also where nobody asks for anything.
            self.shared.ask();
        }
    }
}

// After the step: what the core reports.

impl AxisPort {
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
        match core.take_change() {
            SnapshotChange::Silence if inputs.is_none() => self.publish_silence(core),
            SnapshotChange::Silence | SnapshotChange::Anything => {
                return Some(self.publish_anew(core, inputs));
            }
            SnapshotChange::Nothing if inputs.is_none() => self.shared.status.tick(core.cycle()),
            SnapshotChange::Nothing | SnapshotChange::Motion => self.publish_motion(core, inputs),
        }
        None
    }

    /// Publishes what it was, with another motion.
    #[inline(always)]
    fn publish_motion(&mut self, core: &AxisCore, inputs: Option<&[u8]>) {
        let (position, velocity) = core.motion();
        let [_, flags, words, before] = self.published;
        let motion = motion(position, velocity);
        let head = [core.cycle(), flags, words, motion];
        self.shared.status.publish(head, inputs);
        if motion != before {
            self.published[3] = motion;
            self.note_change();
        }
    }

    /// Publishes what it was, one cycle without inputs older.
    #[inline(never)]
    fn publish_silence(&mut self, core: &AxisCore) {
        let [_, flags, words, motion] = self.published;
        self.publish(
            [core.cycle(), silent(flags, core.age()), words, motion],
            None,
        );
    }

    #[inline(never)]
    fn publish_anew(&mut self, core: &mut AxisCore, inputs: Option<&[u8]>) -> Snapshot {
        let snapshot = core.snapshot();
        // Before anybody knows: who asks for a motion after that asks for another one.
        if let Some(failure) = core.take_fall() {
            self.shared.stops.note(StopKind::of_fall(failure));
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
        // No other thread counts.
        let changes = self.shared.changes.load(Ordering::Relaxed);
        let changes = changes.wrapping_add(1);
        self.shared.changes.store(changes, Ordering::Release);
        self.changed = true;
    }

    /// Wakes those who wait for a change of this axis, if there was one since the last time; to be called after [`stored`].
    #[inline]
    pub(crate) fn wake(&mut self) {
        if core::mem::take(&mut self.changed) {
            self.shared.waiters.ring(CHANGED);
        }
    }

    fn pass_events(&mut self, core: &mut AxisCore) {
        while let Some((id, event)) = core.poll_event() {
            let event = match (self.ended, event) {
                (
                    Some(cause @ Failure::ClockJumped),
                    Event::Done(Err(Failure::Disabled { .. })),
                ) => Event::Done(Err(cause)),
                (_, Event::Done(Err(Failure::Undelivered { delivery, .. }))) => {
                    let (counter, left_op) = self.doubt.unwrap_or_default();
                    Event::Done(Err(match left_op {
                        Some(code) if counter.is_none() => Failure::LeftOp { code, delivery },
                        None if self.doubt == Some((None, None)) => Failure::BusLost { delivery },
                        _ => Failure::Undelivered { delivery, counter },
                    }))
                }
                _ => event,
            };
            self.report(id, event);
        }
    }

    /// Passes an event to the futures that wait for it. One of the network's own commands is nobody's.
    #[inline]
    fn report(&mut self, id: CommandId, event: Event) {
        let mut places = self.taken.iter().enumerate();
        let Some((place, Taken { request, asked })) =
            places.find(|(_, taken)| taken.request.id == id)
        else {
            return;
        };
        let channel = request.channel();
        let unsent = Failure::BusLost {
            delivery: Delivery::NotSent,
        };
        let event = match event {
            Event::Done(Err(failure)) if failure == unsent && self.is_absent => {
                Event::Done(Err(Failure::Absent))
            }
            // Somebody halts an axis that was to be held: it stays halted.
            Event::Halted if request.command == Command::Hold => {
                let delivery = Delivery::Accepted;
                Event::Done(Err(Failure::Halted { delivery }))
            }
            event => event,
        };
        match event {
            Event::Accepted => request.accept(),
            Event::Contact { position, torque } => request.note_contact(position, torque),
            Event::Halted => {
                request.halts.fetch_add(1, Ordering::AcqRel);
            }
            Event::Done(result) => {
                let is_new = !request.is_done();
                let is_over = request.end(*asked, result);
                if is_new && request.is_done() {
                    if request.is_motion() {
                        self.shared.counts.ended(&result);
                    }
                    if matches!(
                        result,
                        Err(Failure::HaltIgnored | Failure::Unsupported(Unsupported::Halt))
                    ) && !request.is_waited_for()
                    {
                        // As of every halt that nobody waits for: it goes on to the quick stop.
                        self.shared.request_stop(StopRequest::HALT);
                    }
                }
                if is_over {
                    let Taken { request, .. } = self.taken.remove(place);
                    // There is room for all that are under way, and the program drops it.
                    let _ = self.shared.queue.back.push(request);
                }
            }
        }
        self.shared.waiters.announce(channel);
    }
}
