//! The bus thread's end of an axis' handles: called twice a cycle, around the exchange. It allocates nothing and waits
//! for nobody.

use core::time::Duration;
use std::sync::Arc;

use crate::{
    axis::{
        Again, AxisCore, Command, CoreConfig, Delivery, DriveSettings, Event, Failure, Snapshot,
        SnapshotChange, StopRequest, WorkingCounter,
    },
    ds402::{Controlword, Mode},
    wakes::stored,
};

use super::{
    shared::{Shared, WITHDRAWN_AT_MOST, Withdrawn},
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
        shared.setup.groups.note_time(now);
        if let Some(raw) = shared.take_noted_mode() {
            core.note_mode(Mode::from_raw(raw));
        }
        let manufacturer = shared.manufacturer();
        if manufacturer != self.manufacturer {
            self.manufacturer = manufacturer;
            core.set_manufacturer_bits(manufacturer);
        }
        shared.merge_outputs(outputs);

        // Before the commands: a jog that was let go makes room for the next.
        self.follow_jog(core, now, outputs);
        let not_taken = shared
            .has_withdrawn()
            .then(|| self.withdraw_taken(core, now, outputs));
        self.take_commands(core, now, outputs);
        let stop = shared.take_stop();
        if !stop.is_empty() {
            // What was queued before the stop was asked for is stopped with the rest, not started after it.
            self.take_commands(core, now, outputs);
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

    /// Begins again with its core, which it restarts: whatever handles have asked for or set before does not come into effect
    /// any more.
    pub(crate) fn restart(
        &mut self,
        core: &mut AxisCore,
        now: Duration,
        again: Again,
        outputs: &mut [u8],
    ) {
        let anew = match &again {
            Again::Anew(config) => Some(DriveSettings::of(config)),
            Again::Unknown | Again::Kept => None,
        };
        self.shared.restart(anew);
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
        self.shared.setup.groups.hand_over();
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
        self.shared.setup.groups.hand_over();
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

    /// Submits what is queued. A stop among it is in the frame that is about to be sent, like the stop lane.
    fn take_commands(&self, core: &mut AxisCore, now: Duration, outputs: &mut [u8]) {
        // At most what the queue holds: a program that fills it again at once waits for the next cycle.
        for _ in 0..self.shared.queue_length() {
            let Some((id, command, asked)) = self.shared.take_command() else {
                break;
            };
            match self.refusal(command, asked, core) {
                Some(failure) => self.shared.report(id, Event::Done(Err(failure))),
                None => core.submit(now, id, command, outputs),
            }
            self.pass_events(core);
        }
    }

    /// Why the core is not to see this command.
    fn refusal(&self, command: Command, asked: LastStop, core: &AxisCore) -> Option<Failure> {
        if StopKind::of(command).is_some() {
            return None;
        }
        if self.ended.is_some() {
            return self.ended;
        }
        match command {
            // The core says why.
            _ if core.expired => None,
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
