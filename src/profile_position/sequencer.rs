//! The handshake of bits 4 and 12.
//!
//! Contract: the axis core calls [`Sequencer::step`] in every cycle with fresh inputs in Operation enabled with mode 1
//! shown, and not otherwise; it puts [`Sequencer::bits`] into the next controlword. Whatever ends the motion is told by
//! [`Sequencer::fail_all`], after which bit 4 stays as it is until [`Sequencer::lower`].

use core::time::Duration;

use crate::{
    axis::Deadlines,
    ds402::{Controlword, Sample},
};

use super::{
    Bounds, CommandId, Cycle, Delivery, Event, Events, Failure, MoveCommand, Parameters,
    WaitingFor,
    bit4::{Bit4, Raised, SHOWN_AFTER},
    chain::{Chain, Next, Place, start_bits},
    track::Track,
    waiting::{Request, Waiting},
};

/// The sequencing of set-points towards one drive axis.
#[derive(Debug, Clone, Hash)]
pub(crate) struct Sequencer {
    bit4: Bit4,
    bits: Controlword,
    target: i32,
    parameters: Parameters,
    waiting: Waiting,
    chain: Chain,
    /// Sent onto a full buffer and not acknowledged; bit 4 is low again. The fall of bit 12 will be its acknowledge.
    unconfirmed: Option<Raised>,
    unknown: bool,
    /// Whether that one would have replaced the others and may end anywhere.
    anywhere: bool,
    armed: Option<CommandId>,
    /// Whether bit 9 (remote) was ever seen high: of a drive that never shows it it says nothing.
    remote_tells: bool,
}

impl Sequencer {
    pub(crate) fn new(parameters: Parameters) -> Self {
        Self {
            bit4: Bit4::LOW,
            bits: Controlword::empty(),
            target: 0,
            parameters,
            waiting: Waiting::default(),
            chain: Chain::default(),
            unconfirmed: None,
            unknown: false,
            anywhere: false,
            armed: None,
            remote_tells: false,
        }
    }

    /// Bits 4, 5, 6 and 9 of the next controlword.
    pub(crate) const fn bits(&self) -> Controlword {
        self.bits
    }

    /// Target position 607Ah of the next outputs.
    pub(crate) const fn target(&self) -> i32 {
        self.target
    }

    /// Profile parameters of the next outputs.
    pub(crate) const fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Whether the last set-point was to end in motion.
    pub(crate) fn has_end_velocity(&self) -> bool {
        self.parameters
            .end_velocity
            .is_some_and(|velocity| velocity != 0)
    }

    /// The target follows the axis while no set-point can be active: whoever looks at it later finds no jump.
    pub(crate) const fn follow_position(&mut self, position: i32) {
        self.target = position;
    }

    /// The same in another mode, which may lead the axis anywhere.
    pub(crate) const fn follow_other_mode(&mut self, position: i32) {
        self.target = position;
        self.chain.leave_base();
    }

    /// Lets go of what makes no difference any more. `arrives`: whether 606Ch tells that the axis has arrived.
    pub(crate) fn let_go(
        &mut self,
        now: Duration,
        seen: Duration,
        deadlines: &Deadlines,
        settle: Duration,
        arrives: bool,
    ) {
        self.bit4.let_go(now, seen, deadlines.acknowledge);
        self.waiting.let_go(now, deadlines.acknowledge);
        self.chain.let_go(now, deadlines.begin, settle, arrives);
        if let Some(raised) = &mut self.unconfirmed {
            raised.let_go(now, deadlines.acknowledge);
        }
    }

    /// Lets go of what 607Ah and the parameters hold, before bit 4 rises again.
    pub(crate) fn let_go_of_target(&mut self) {
        self.target = 0;
        self.parameters = Parameters {
            end_velocity: self.parameters.end_velocity,
            profile_type: self.parameters.profile_type,
            ..Parameters::default()
        };
    }

    /// Whether the drive has a set-point or may have one.
    pub(crate) fn has_set_point(&self) -> bool {
        self.unknown
            || self.unconfirmed.is_some()
            || !self.chain.is_empty()
            || self.chain.is_unproven()
            || matches!(self.bit4, Bit4::High { sent: true, .. } | Bit4::Abandoned)
    }

    /// Whether a set-point may have been taken without an acknowledge: only a stop clears that.
    pub(crate) const fn is_unknown(&self) -> bool {
        self.unknown
    }

    /// Whether no move waits or is under way.
    pub(crate) fn is_idle(&self) -> bool {
        !self.has_set_point() && self.waiting.is_empty() && self.bit4.is_low()
    }

    /// Whether a cycle like the last one changes nothing but how far the one set-point has come that the drive may hold.
    /// `in_mode`: the drive is enabled and shows this mode.
    pub(crate) fn is_calm(&self, in_mode: bool) -> bool {
        let low = match self.bit4 {
            Bit4::Low { delivered, .. } => delivered.is_some() || !in_mode,
            Bit4::High { .. } | Bit4::Abandoned => false,
        };
        low && self.waiting.is_empty()
            && self.unconfirmed.is_none()
            && !(self.unknown && self.holds_any())
            && self.armed.is_none()
            && self.chain.is_calm()
    }

    /// Whether the drive holds a set-point that it has acknowledged.
    pub(crate) fn holds_any(&self) -> bool {
        !self.chain.is_empty()
    }

    /// One cycle of a calm axis with a set-point under way: whether that may have ended. [`Sequencer::end`] says so then.
    #[inline(always)]
    pub(crate) fn follow(&mut self, now: Duration, sample: &Sample, bounds: &Bounds) -> bool {
        self.chain.note_active(now, sample, bounds)
    }

    /// Whether the set-point under way ends with the cycle that [`Sequencer::follow`] has taken in.
    pub(crate) fn end(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        let ended = self.chain.end_active(cycle, Next::None, false, events);
        if ended {
            self.note_not_begun(events);
        }
        ended
    }

    /// A set-point that the drive has acknowledged and not begun is one that it may begin at any time: nothing more is sent before a
    /// stop.
    fn note_not_begun(&mut self, events: &mut Events) {
        if self.chain.take_not_begun() {
            self.unknown = true;
            self.withdraw_unsent(Failure::NeedsStop, events);
        }
    }

    /// The motion profile type 6086h of the move that a new one would follow; none where it would follow none.
    pub(crate) fn last_profile_type(&self) -> Option<i16> {
        match self.waiting.last() {
            Some(request) => request.command.set_point.parameters.profile_type,
            None if self.is_idle() => None,
            None => self.parameters.profile_type,
        }
    }

    /// Takes a checked move in; refuses it when too many wait.
    pub(crate) fn submit(&mut self, id: CommandId, command: MoveCommand, events: &mut Events) {
        if !self.waiting.push(id, command) {
            events.push(id, Event::Done(Err(Failure::Busy)));
        }
        if self.waiting.first().map(|first| first.id) != self.armed {
            // Overtaken: it is not its turn any more.
            self.armed = None;
        }
    }

    /// Withdraws a move that has not been sent; whether there was one.
    pub(crate) fn withdraw(
        &mut self,
        id: CommandId,
        failure: Failure,
        events: &mut Events,
    ) -> bool {
        if self.bit4.unsent() == Some(id) {
            self.drop_unsent(failure, events);
            true
        } else if self.waiting.remove(id) {
            self.armed = None;
            events.push(id, Event::Done(Err(failure)));
            true
        } else {
            false
        }
    }

    /// A stop takes over: moves that wait fail, and a rise of bit 4 that is not sent yet does not happen.
    pub(crate) fn withdraw_unsent(&mut self, failure: Failure, events: &mut Events) {
        self.armed = None;
        while let Some(request) = self.waiting.pop() {
            events.push(request.id, Event::Done(Err(failure)));
        }
        if self.bit4.unsent().is_some() {
            self.drop_unsent(failure, events);
        }
    }

    /// The outputs composed last have been sent.
    pub(crate) fn mark_sent(&mut self, now: Duration) {
        self.bit4.mark_sent(now);
    }

    /// Ends everything with this failure, which says how far each set-point came. Bit 4 stays as it was sent.
    pub(crate) fn fail_all(&mut self, failure: Failure, events: &mut Events) {
        self.withdraw_unsent(failure.with_delivery(Delivery::NotSent), events);
        let unknown = failure.with_delivery(Delivery::Unknown);
        if let Bit4::High { raised, .. } = self.bit4 {
            events.push(raised.request.id, Event::Done(Err(unknown)));
            self.bit4 = Bit4::Abandoned;
        }
        if let Some(raised) = self.unconfirmed.take() {
            events.push(raised.request.id, Event::Done(Err(unknown)));
        }
        self.chain.fail_all(failure, events);
    }

    /// Bit 4 goes low and nothing is held any more: the axis is out of Operation enabled and the drive has dropped
    /// its set-points.
    pub(crate) fn lower(&mut self) {
        self.unconfirmed = None;
        self.chain.forget();
        if !self.bit4.is_low() {
            self.bit4 = Bit4::LOW;
        }
        self.bits = Controlword::empty();
        self.unknown = false;
        self.anywhere = false;
    }

    /// The axis stands halted: says so for each set-point that the drive keeps.
    pub(crate) fn report_halted(&mut self, events: &mut Events) {
        self.chain.report_halted(events);
    }

    /// Bit 8 falls, and the axis goes on from where it stands, or from its way to standstill.
    pub(crate) fn resumed(&mut self, now: Duration, from_rest: bool) {
        self.chain.resumed(now, from_rest);
    }

    /// Whether this gated move has everything it needs but its release.
    pub(crate) fn is_armed(&self, id: CommandId) -> bool {
        self.armed == Some(id)
    }

    /// No gated move may be released on what an earlier cycle showed.
    pub(crate) const fn disarm(&mut self) {
        self.armed = None;
    }

    /// Releases a gated, armed move: bit 4 rises.
    pub(crate) fn fire(&mut self, id: CommandId, cycle: &Cycle<'_>, events: &mut Events) {
        if self.armed == Some(id)
            && let Some(request) = self.waiting.first()
        {
            self.raise(request, cycle, events);
        }
    }

    /// One cycle with fresh inputs in Operation enabled and mode 1. Returns whether a set-point was acknowledged.
    pub(crate) fn step(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        let accepted = self.follow_bit4(cycle, events);
        if !cycle.halted {
            let room_shown = self.bit4.is_low_acknowledged(cycle);
            let on_its_way = self.bit4.on_its_way().or(self.unconfirmed.as_ref());
            let next = match on_its_way {
                _ if self.unknown => Next::Perhaps {
                    anywhere: self.anywhere,
                },
                Some(raised) => Next::Comes {
                    replaces: raised.replaces(),
                },
                None => Next::None,
            };
            self.chain.follow(cycle, room_shown, next, events);
            self.note_not_begun(events);
            self.start_next(cycle, events);
        }
        accepted
    }

    fn follow_bit4(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        self.remote_tells |= cycle.is_remote();
        let local = self.remote_tells && !cycle.is_remote();
        self.bit4.note(cycle);
        if let Bit4::High {
            raised,
            sent: true,
            full,
            shown,
            ..
        } = self.bit4
        {
            if cycle.is_acknowledging() && !full {
                self.low();
                self.accept(raised, true, cycle, events);
                return true;
            }
            if full && shown > SHOWN_AFTER && !local {
                self.low();
                self.unconfirmed = Some(raised);
            } else if (full && local) || cycle.is_late(raised.since) {
                // Under local control the drive follows no edge, and its bit 12 falls all the same when the active one ends.
                self.low();
                self.give_up(raised, WaitingFor::Acknowledge, cycle, events);
            }
        }
        self.follow_unconfirmed(cycle, events)
    }

    /// A set-point that was sent onto a full buffer: bit 12 falls when it has replaced all others, and there is room.
    fn follow_unconfirmed(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        let Some(raised) = self.unconfirmed else {
            return false;
        };
        if self.bit4.is_low_acknowledged(cycle) {
            self.unconfirmed = None;
            self.accept(raised, false, cycle, events);
            return true;
        }
        if cycle.is_late(raised.since) {
            self.unconfirmed = None;
            self.give_up(raised, WaitingFor::AcknowledgeLow, cycle, events);
        }
        false
    }

    /// The drive has taken a set-point. `confirmed`: by an edge of bit 12.
    fn accept(&mut self, raised: Raised, confirmed: bool, cycle: &Cycle<'_>, events: &mut Events) {
        let track = Track::new(&raised, confirmed, cycle);
        events.push(track.id, Event::Accepted);
        self.chain.push(track, events);
    }

    /// A set-point of which it is not known whether the drive has taken it. Nothing more is sent before a stop has made
    /// that known.
    fn give_up(
        &mut self,
        raised: Raised,
        waiting_for: WaitingFor,
        cycle: &Cycle<'_>,
        events: &mut Events,
    ) {
        let failure = cycle.timeout(waiting_for, Delivery::Unknown);
        events.push(raised.request.id, Event::Done(Err(failure)));
        self.unknown = true;
        self.anywhere = raised.replaces()
            && raised
                .end
                .is_none_or(|end| self.chain.ends_near(end, cycle.bounds));
        self.withdraw_unsent(Failure::NeedsStop, events);
    }

    /// The move whose turn it is starts, if all that it needs is there.
    pub(crate) fn start_next(&mut self, cycle: &Cycle<'_>, events: &mut Events) {
        self.armed = None;
        let Some(request) = self.waiting.first() else {
            return;
        };
        if !self.bit4.is_low() || self.unconfirmed.is_some() {
            return;
        }
        let ready = match self.chain.place_for(&request.command, cycle.traits) {
            Place::Free => self.bit4.is_low_acknowledged(cycle),
            Place::Full => self.bit4.is_low_acknowledged(cycle) || self.bit4.is_low_seen(cycle),
            Place::Later => {
                self.waiting.first_is_free();
                return;
            }
            Place::Never(reason) => {
                let start = request.command.set_point.start;
                self.waiting.remove(request.id);
                events.push(
                    request.id,
                    Event::Done(Err(Failure::Unsupported { start, reason })),
                );
                return;
            }
        };
        if ready {
            self.waiting.first_is_free();
            if !cycle.delivered {
                return;
            }
            if let Err(failure) = self.chain.check_limits(&request.command, cycle) {
                self.waiting.remove(request.id);
                events.push(request.id, Event::Done(Err(failure)));
                return;
            }
            if request.command.gated {
                self.armed = Some(request.id);
            } else {
                self.raise(request, cycle, events);
            }
        } else if cycle.is_late(self.waiting.first_blocked_since(cycle.now)) {
            self.waiting.remove(request.id);
            let failure = cycle.timeout(WaitingFor::AcknowledgeLow, Delivery::NotSent);
            events.push(request.id, Event::Done(Err(failure)));
        }
    }

    fn raise(&mut self, request: Request, cycle: &Cycle<'_>, events: &mut Events) {
        while let Some(overtaken) = self.waiting.pop_overtaken() {
            events.push(overtaken.id, Event::Done(Err(Failure::Superseded)));
        }
        self.waiting.pop();
        self.bits = start_bits(&request.command, cycle.traits);
        self.target = request.command.target;
        self.parameters = request.command.set_point.parameters;
        self.armed = None;
        self.bit4 = Bit4::High {
            raised: Raised {
                request,
                since: cycle.now,
                begin: self.chain.begin_of(&request.command, cycle),
                at: cycle.sample.position,
                end: self.chain.end_of(&request.command, cycle),
                goal: self.chain.goal_of(&request.command, cycle),
                previous: self.chain.previous_end(),
                from_rest: self.chain.begins_at_rest(&request.command, cycle),
                stands: self.chain.stands(cycle),
                at_base: self.chain.is_at_base(),
                far_behind: self.chain.queues(&request.command) && !cycle.is_reached(),
                behind: self.chain.bases_behind(&request.command, cycle.bounds),
            },
            sent: false,
            delivered: None,
            full: cycle.is_acknowledging(),
            shown: 0,
        };
    }

    fn drop_unsent(&mut self, failure: Failure, events: &mut Events) {
        if let Some(id) = self.bit4.unsent() {
            events.push(id, Event::Done(Err(failure)));
            self.low();
        }
    }

    fn low(&mut self) {
        self.bit4 = Bit4::LOW;
        self.bits = Controlword::empty();
    }
}
