//! The handshake of bits 4 and 12, the set-points that the drive holds, and how each of them ends.
//!
//! Contract: the axis core calls [`Sequencer::step`] in every cycle with fresh inputs in Operation enabled with mode 1
//! shown, and not otherwise; it puts [`Sequencer::bits`] into the next controlword. Whatever ends the motion is reported by
//! [`Sequencer::fail_all`], after which bit 4 stays as it is until [`Sequencer::lower`].

use core::time::Duration;

use crate::ds402::{Controlword, ModeBits, Sample, SetPointBits, Statusword};

use super::{
    Bounds, BufferMode, BufferSignal, CommandId, Completion, Delivery, Event, Events, Failure,
    LastSeen, Limits, MoveCommand, Parameters, Reference, RelativeBase, Standstill, StartBits,
    Traits, WaitingFor, standstill::ShownFor,
};

/// The sequencing of set-points towards one drive axis.
#[derive(Debug, Clone, Hash)]
pub(crate) struct Sequencer {
    bit4: Bit4,
    bits: ModeBits,
    ahead: Ahead,
    target: i32,
    parameters: Parameters,
    pending: PendingMoves,
    drive_buffer: DriveBuffer,
    /// Sent onto a full buffer and not acknowledged; bit 4 is low again. The fall of bit 12 will be its acknowledge.
    unconfirmed: Option<Raised>,
    unknown: bool,
    /// Whether that one would have replaced the others and may end anywhere.
    anywhere: bool,
    armed: Option<CommandId>,
    /// Whether bit 9 (remote) was ever seen high: of a drive that never shows it it says nothing.
    bit_9_is_valid: bool,
}

/// Whether the drive has seen the bits 5, 6 and 9 that are out while bit 4 is low.
#[derive(Debug, Clone, Copy, Hash)]
enum Ahead {
    /// They change in the frame in which bit 4 falls, and are seen with its low.
    Falls,
    /// They have.
    Fell,
    Changed,
    Delivered(Duration),
}

impl Ahead {
    /// They are others from the next frame on.
    const fn change(&mut self) {
        if !matches!(self, Self::Falls) {
            *self = Self::Changed;
        }
    }
}

impl Sequencer {
    pub fn new(parameters: Parameters) -> Self {
        Self {
            bit4: Bit4::LOW,
            bits: ModeBits::NONE,
            ahead: Ahead::Fell,
            target: 0,
            parameters,
            pending: PendingMoves::default(),
            drive_buffer: DriveBuffer::default(),
            unconfirmed: None,
            unknown: false,
            anywhere: false,
            armed: None,
            bit_9_is_valid: false,
        }
    }

    /// Bits 4, 5, 6 and 9 of the next controlword.
    pub const fn bits(&self) -> ModeBits {
        self.bits
    }

    /// Target position 607Ah of the next outputs.
    pub const fn target(&self) -> i32 {
        self.target
    }

    /// Profile parameters of the next outputs.
    pub const fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Whether the drive goes on at an end velocity when the last set-point that it has taken has ended.
    pub const fn has_end_velocity(&self) -> bool {
        self.drive_buffer.ends_in_motion
    }

    /// The target follows the axis while no set-point can be active: whoever looks at it later finds no jump.
    pub const fn follow_position(&mut self, position: i32) {
        self.target = position;
    }

    /// The same in another mode, which may lead the axis anywhere.
    pub const fn follow_other_mode(&mut self, position: i32) {
        self.target = position;
        self.drive_buffer.leave_base();
    }

    /// A cycle in another mode: a low of bit 4 that the drive has seen there counts for nothing here.
    pub const fn outside(&mut self) {
        if let Bit4::Low { delivered, .. } = &mut self.bit4 {
            *delivered = None;
        }
    }

    /// A homing moves the zero of all positions.
    pub const fn zero_moves(&mut self) {
        self.drive_buffer.last_end = None;
    }

    /// Lets go of what makes no difference any more.
    pub fn canonicalize(
        &mut self,
        now: Duration,
        seen: Duration,
        acknowledge: Duration,
        begin: Duration,
        settle: Duration,
    ) {
        self.bit4.canonicalize(now, seen, acknowledge);
        if let Ahead::Delivered(at) = &mut self.ahead {
            no_older(at, now, seen);
        }
        self.pending.canonicalize(now, acknowledge);
        self.drive_buffer.canonicalize(now, begin, settle);
        if let Some(raised) = &mut self.unconfirmed {
            raised.canonicalize(now, acknowledge);
        }
    }

    /// Lets go of what 607Ah and the parameters hold, before bit 4 rises again.
    pub fn canonicalize_target(&mut self) {
        self.target = 0;
        self.parameters = Parameters {
            profile_type: self.parameters.profile_type,
            ..Parameters::default()
        };
    }

    /// Whether the drive has a set-point or may have one.
    pub fn has_set_point(&self) -> bool {
        self.unknown
            || self.unconfirmed.is_some()
            || !self.drive_buffer.is_empty()
            || self.drive_buffer.is_unproven()
            || matches!(self.bit4, Bit4::High { sent: true, .. } | Bit4::Abandoned)
    }

    /// Whether a set-point may have been taken without an acknowledge: only a stop clears that.
    pub const fn is_unknown(&self) -> bool {
        self.unknown
    }

    /// Whether no move waits or is under way.
    pub fn is_idle(&self) -> bool {
        !self.has_set_point() && self.pending.is_empty() && self.bit4.is_low()
    }

    /// Whether a cycle like the last one changes nothing but how far the one set-point has come that the drive may hold.
    /// `in_mode`: the drive is enabled and shows this mode.
    pub fn allows_idle_path(&self, in_mode: bool, statusword: Statusword) -> bool {
        let is_high = statusword.contains(Statusword::SET_POINT_ACKNOWLEDGE);
        let low = match self.bit4 {
            // Bit 12 may be about to fall, or to stay.
            Bit4::Low {
                delivered, stays, ..
            } => !in_mode || (delivered.is_some() && (stays || !is_high)),
            Bit4::High { .. } | Bit4::Abandoned => false,
        };
        low && self.pending.is_empty()
            && self.unconfirmed.is_none()
            && !(self.unknown && self.holds_any())
            && self.armed.is_none()
            && self.drive_buffer.allows_idle_path()
    }

    /// Whether the drive holds a set-point that it has acknowledged.
    pub fn holds_any(&self) -> bool {
        !self.drive_buffer.is_empty()
    }

    /// One cycle of an axis on the idle path with a set-point under way: whether that may have ended. [`Sequencer::end`] reports it then.
    #[inline(always)]
    pub fn follow(&mut self, now: Duration, sample: &Sample, bounds: &Bounds) -> bool {
        self.drive_buffer.note_active(now, sample, bounds)
    }

    /// Whether the set-point under way ends with the cycle that [`Sequencer::follow`] has taken in.
    pub fn end(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        let ended = self
            .drive_buffer
            .end_active(cycle, Unacknowledged::None, false, events);
        if ended {
            self.note_not_begun(events);
        }
        ended
    }

    /// A set-point that the drive has acknowledged and not begun is one that it may begin at any time: nothing more is sent before a
    /// stop.
    fn note_not_begun(&mut self, events: &mut Events) {
        if self.drive_buffer.take_not_begun() {
            self.unknown = true;
            self.withdraw_unsent(Failure::NeedsStop, events);
        }
    }

    /// The motion profile type 6086h of the move that a new one would follow; none where it would follow none.
    pub fn last_profile_type(&self) -> Option<i16> {
        match self.pending.last() {
            Some(request) => request.command.set_point.parameters.profile_type,
            None if self.is_idle() => None,
            None => self.parameters.profile_type,
        }
    }

    /// Takes a checked move in; refuses it when too many wait.
    #[inline]
    pub fn submit(&mut self, id: CommandId, command: MoveCommand, events: &mut Events) {
        if !self.pending.push(id, command) {
            events.push(id, Event::Done(Err(Failure::Busy)));
        } else if command.gated && command.set_point.buffer_mode == BufferMode::Aborting {
            self.supersede_gated(events);
        }
        if self.pending.first().map(|first| first.id) != self.armed {
            // Overtaken: it is not its turn any more.
            self.armed = None;
        }
    }

    /// A move that starts together with others has overtaken those that do so too. They end here and now: on another axis it may wait for
    /// one of theirs, and neither would ever start.
    #[cold]
    fn supersede_gated(&mut self, events: &mut Events) {
        while let Some(id) = self.pending.first_gated_to_queue() {
            self.pending.remove(id);
            events.push(id, Event::Done(Err(Failure::Superseded)));
        }
    }

    /// Withdraws a move that has not been sent; whether there was one.
    pub fn withdraw(&mut self, id: CommandId, failure: Failure, events: &mut Events) -> bool {
        if self.bit4.unsent() == Some(id) {
            self.drop_unsent(failure, events);
            true
        } else if self.pending.remove(id) {
            self.armed = None;
            self.take_start_bits_back();
            events.push(id, Event::Done(Err(failure)));
            true
        } else {
            false
        }
    }

    /// A stop takes over: moves that wait fail, and a rise of bit 4 that is not sent yet does not happen.
    pub fn withdraw_unsent(&mut self, failure: Failure, events: &mut Events) {
        self.armed = None;
        while let Some(request) = self.pending.pop() {
            events.push(request.id, Event::Done(Err(failure)));
        }
        self.take_start_bits_back();
        if self.bit4.unsent().is_some() {
            self.drop_unsent(failure, events);
        }
    }

    /// The outputs composed last have been sent.
    pub fn mark_sent(&mut self, now: Duration) {
        self.bit4.mark_sent(now);
        if let Ahead::Falls = self.ahead {
            self.ahead = Ahead::Fell;
        }
    }

    /// Ends everything with this failure, which says how far each set-point came. Bit 4 stays as it was sent.
    pub fn fail_all(&mut self, failure: Failure, events: &mut Events) {
        self.withdraw_unsent(failure.with_delivery(Delivery::NotSent), events);
        let unknown = failure.with_delivery(Delivery::Unknown);
        if let Bit4::High { raised, .. } = self.bit4 {
            events.push(raised.request.id, Event::Done(Err(unknown)));
            self.bit4 = Bit4::Abandoned;
        }
        if let Some(raised) = self.unconfirmed.take() {
            events.push(raised.request.id, Event::Done(Err(unknown)));
        }
        self.drive_buffer.fail_all(failure, events);
    }

    /// Bit 4 goes low and nothing is held any more: the axis is out of Operation enabled and the drive has dropped
    /// its set-points.
    pub fn lower(&mut self) {
        self.unconfirmed = None;
        self.drive_buffer.forget();
        self.take_start_bits_back();
        if !self.bit4.is_low() {
            self.bit4 = Bit4::LOW;
        }
        self.bits = ModeBits::NONE;
        self.unknown = false;
        self.anywhere = false;
    }

    /// The axis stands halted: reports it for each set-point that the drive keeps.
    pub fn report_halted(&mut self, events: &mut Events) {
        self.drive_buffer.report_halted(events);
    }

    /// Bit 8 falls, and the axis goes on from where it stands, or from its way to standstill.
    pub fn resumed(&mut self, now: Duration, from_rest: bool) {
        self.drive_buffer.resumed(now, from_rest);
    }

    /// Whether this gated move has everything it needs but its release.
    pub fn is_armed(&self, id: CommandId) -> bool {
        self.armed == Some(id)
    }

    /// No gated move may be released on what an earlier cycle showed.
    pub const fn disarm(&mut self) {
        self.armed = None;
    }

    /// Releases a gated, armed move: bit 4 rises.
    pub fn fire(&mut self, id: CommandId, cycle: &Cycle<'_>) {
        if self.armed == Some(id)
            && let Some(&request) = self.pending.first()
        {
            self.raise(request, cycle);
        }
    }

    /// One cycle with fresh inputs in Operation enabled and mode 1. Returns whether a set-point was acknowledged.
    #[inline]
    pub fn step(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        let accepted = self.follow_bit4(cycle, events);
        if !cycle.halted {
            let room = self.bit4.room(cycle);
            let on_its_way = self.bit4.on_its_way().or(self.unconfirmed.as_ref());
            let next = match on_its_way {
                _ if self.unknown => Unacknowledged::Perhaps {
                    anywhere: self.anywhere,
                },
                Some(raised) => Unacknowledged::Comes {
                    replaces: raised.replaces(),
                },
                None => Unacknowledged::None,
            };
            self.drive_buffer.follow(cycle, room, next, events);
            self.note_not_begun(events);
            self.start_next(cycle, events, true);
        } else {
            self.drive_buffer.note_halted(cycle);
        }
        accepted
    }

    #[inline]
    fn follow_bit4(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        self.bit_9_is_valid |= cycle.is_remote();
        let local = self.bit_9_is_valid && !cycle.is_remote();
        self.bit4.note(cycle);
        if let &mut Bit4::High {
            ref mut raised,
            sent: true,
            full,
            shown,
            ..
        } = &mut self.bit4
        {
            // What it has overtaken does not come any more.
            while let Some(overtaken) = self.pending.pop_overtaken() {
                events.push(overtaken.id, Event::Done(Err(Failure::Superseded)));
            }
            if cycle.is_acknowledging() && !full {
                self.drive_buffer.accept(raised, true, cycle, events);
                self.low();
                return true;
            }
            let passed_over = full && shown > SHOWN_AFTER;
            if passed_over && !local && raised.replaces() {
                let raised = *raised;
                self.low();
                self.unconfirmed = Some(raised);
            } else if passed_over || (full && local) || cycle.is_late(raised.since) {
                // One that replaces none finds no place in a full buffer.
                // Under local control the drive follows no edge, and its bit 12 falls all the same when the active one ends.
                let raised = *raised;
                self.low();
                self.give_up(raised, WaitingFor::Acknowledge, cycle, events);
            }
        }
        self.follow_unconfirmed(cycle, events)
    }

    /// A set-point that was sent onto a full buffer: bit 12 falls when it has replaced all others, and there is room.
    #[inline]
    fn follow_unconfirmed(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        let Some(mut raised) = self.unconfirmed else {
            return false;
        };
        if self.bit4.is_low_acknowledged(cycle) {
            self.unconfirmed = None;
            self.drive_buffer.accept(&mut raised, false, cycle, events);
            return true;
        }
        if cycle.is_late(raised.since) {
            self.unconfirmed = None;
            self.give_up(raised, WaitingFor::AcknowledgeLow, cycle, events);
        }
        false
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
                .is_none_or(|end| self.drive_buffer.ends_near(end, cycle.bounds));
        self.withdraw_unsent(Failure::NeedsStop, events);
    }

    /// The move whose turn it is starts, if all that it needs is there. `fresh`: the cycle has shown what became of the bits that are out;
    /// else they may have changed since.
    pub fn start_next(&mut self, cycle: &Cycle<'_>, events: &mut Events, fresh: bool) {
        self.armed = None;
        if !self.bit4.is_low() || self.unconfirmed.is_some() {
            return;
        }
        let Some(&request) = self.pending.first() else {
            return;
        };
        let ready = match self.drive_buffer.place_for(&request.command, cycle) {
            // A single word that shows a place may be wrong, and the drive may hold what nobody knows of.
            BufferRoom::Free => self.bit4.room(cycle) == Some(Room::Sure),
            BufferRoom::Full => {
                self.bit4.is_low_acknowledged(cycle) || self.bit4.is_low_seen(cycle)
            }
            BufferRoom::Later => {
                self.pending.first_is_free();
                self.send_start_bits(&request.command, cycle, fresh);
                return;
            }
            BufferRoom::Never(reason) => {
                let buffer_mode = request.command.set_point.buffer_mode;
                self.pending.remove(request.id);
                self.take_start_bits_back();
                events.push(
                    request.id,
                    Event::Done(Err(Failure::Unsupported {
                        buffer_mode,
                        reason,
                    })),
                );
                return;
            }
        };
        if ready
            && cycle.delivered
            && let Err(failure) = self.drive_buffer.check_limits(&request.command, cycle)
        {
            self.pending.remove(request.id);
            self.take_start_bits_back();
            events.push(request.id, Event::Done(Err(failure)));
            return;
        }
        let shown = self.send_start_bits(&request.command, cycle, fresh);
        if ready {
            self.pending.first_is_free();
            if !cycle.delivered || !shown {
                return;
            }
            if request.command.gated {
                self.armed = Some(request.id);
            } else {
                self.raise(request, cycle);
            }
        } else if cycle.is_late(self.pending.first_blocked_since(cycle.now)) {
            self.pending.remove(request.id);
            self.take_start_bits_back();
            let failure = cycle.timeout(WaitingFor::AcknowledgeLow, Delivery::NotSent);
            events.push(request.id, Event::Done(Err(failure)));
        }
    }

    /// Where the drive takes bits 5, 6 and 9 before the edge, puts them out while bit 4 is low. Whether they may come with bit 4, or the
    /// drive has surely seen them.
    fn send_start_bits(&mut self, command: &MoveCommand, cycle: &Cycle<'_>, fresh: bool) -> bool {
        if !cycle.traits.start_bits_first {
            return true;
        }
        let bits = start_bits(command, cycle.traits);
        if self.bits != bits {
            self.bits = bits;
            self.ahead.change();
        } else if let Ahead::Changed = self.ahead
            && fresh
            && cycle.delivered
        {
            self.ahead = Ahead::Delivered(cycle.now);
        }
        match self.ahead {
            Ahead::Falls | Ahead::Fell => true,
            Ahead::Changed => false,
            Ahead::Delivered(at) => cycle.is_seen(at),
        }
    }

    /// The move that they were put out for does not come.
    fn take_start_bits_back(&mut self) {
        if self.bit4.is_low() && !self.bits.is_empty() {
            self.bits = ModeBits::NONE;
            self.ahead.change();
        }
    }

    fn raise(&mut self, request: Request, cycle: &Cycle<'_>) {
        self.pending.take_turn();
        self.bits = start_bits(&request.command, cycle.traits).with_new_set_point();
        let fields_before = (self.target, self.parameters);
        self.target = request.command.target;
        self.parameters = request.command.set_point.parameters;
        self.armed = None;
        self.drive_buffer.note_next(cycle);
        // Only a distance counts from another.
        let is_relative = request.command.reference == Reference::Relative;
        let before = is_relative
            .then(|| self.drive_buffer.before(&request.command))
            .flatten();
        let previous = is_relative
            .then(|| self.drive_buffer.previous_end())
            .flatten();
        let last = is_relative.then(|| self.drive_buffer.last()).flatten();
        self.bit4 = Bit4::High {
            raised: Raised {
                request,
                since: cycle.now,
                begin: self.drive_buffer.begin_of(&request.command, cycle),
                at: cycle.sample.position,
                end: self.drive_buffer.end_of(&request.command, cycle),
                goal: self.drive_buffer.goal_of(&request.command, cycle),
                previous,
                from_rest: self.drive_buffer.begins_at_rest(&request.command, cycle),
                stands: self.drive_buffer.stands(cycle),
                at_base: self.drive_buffer.is_at_base(),
                far_behind: before.is_some() && !cycle.is_reached(),
                behind: last.and_then(|last| last.bases_behind(cycle.bounds)),
                behind_loose: before.is_some_and(SetPointMonitor::may_end_beside),
                early: false,
            },
            fields_before,
            sent: false,
            delivered: None,
            full: cycle.is_acknowledging()
                || (cycle.bit_12_shows_room() && self.drive_buffer.holds_two()),
            fell: None,
            shown: 0,
        };
    }

    fn drop_unsent(&mut self, failure: Failure, events: &mut Events) {
        if let &Bit4::High {
            ref raised,
            fields_before,
            sent: false,
            ..
        } = &self.bit4
        {
            events.push(raised.request.id, Event::Done(Err(failure)));
            (self.target, self.parameters) = fields_before;
            self.pending.keep_overtaken();
            self.low();
        }
    }

    fn low(&mut self) {
        self.bit4 = Bit4::LOW;
        self.bits = ModeBits::NONE;
        self.ahead = Ahead::Falls;
    }
}

// Bit 4 (new set-point) of the controlword: where it is, and what the drive has seen of it.

/// So many frames later, at the latest, the inputs show what the drive has seen in one: it takes outputs in at one SYNC0, works
/// until the next, and what it has put out then is fetched by the frame after that. Assumed, no document says.
const SHOWN_AFTER: u8 = 3;

/// Where bit 4 is.
#[derive(Debug, Clone, Copy, Hash)]
enum Bit4 {
    Low {
        /// Since when it is known to have been delivered low.
        delivered: Option<Duration>,
        /// Whether bit 12 was still high then: its fall proves that the drive has seen the low.
        will_be_seen: bool,
        /// Whether bit 12 may stay high for longer than the drive takes to see the low: for a buffer that is full, for all that is known.
        stays: bool,
        /// Since when it has been low nevertheless.
        room: Option<Duration>,
    },
    High {
        raised: Raised,
        /// 607Ah and the profile parameters as they were before: they are so again where bit 4 is taken back before it is sent.
        fields_before: (i32, Parameters),
        sent: bool,
        /// Since when it is known to have been delivered high.
        delivered: Option<Duration>,
        /// Whether bit 12 has been high all the time, for a buffer that is full: no edge of it will come.
        full: bool,
        /// Since when it has been low nevertheless.
        fell: Option<Duration>,
        /// Frames with inputs since the drive has surely seen it.
        shown: u8,
    },
    /// High, and its set-point has been reported as failed already: a stop is under way.
    Abandoned,
}

/// A place in the drive's buffer, as bit 12 shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Room {
    /// By words of less than two of the drive's cycles: they may be wrong.
    Shown,
    Sure,
}

/// A set-point for which bit 4 has risen.
#[derive(Debug, Clone, Copy, Hash)]
struct Raised {
    pub request: Request,
    /// When it rose, and when it was sent.
    pub since: Duration,
    /// Where the set-point begins and where it ends, judged when it rose.
    pub begin: i32,
    /// Where the axis was.
    pub at: i32,
    pub end: Option<i32>,
    /// Where it leads, also where its end is not known to the count.
    pub goal: Option<i32>,
    /// Of a distance, the end of the set-point before it, where that is known: the drive may count from it.
    pub previous: Option<i32>,
    /// Whether it begins at rest.
    pub from_rest: bool,
    /// Whether the axis stood there when bit 4 rose, with nothing that the drive held.
    pub stands: bool,
    /// Whether it had not moved but by set-points that have ended well, since it was enabled.
    pub at_base: bool,
    /// Whether it is behind another that the drive holds, and that nothing shows to be over before it is acknowledged: bit 10, or where the axis was.
    pub far_behind: bool,
    /// Behind a distance whose end is not known, or in its place: what a distance behind that counts from.
    pub behind: Option<Bases>,
    /// Whether it is behind a distance that may end beside the place that its end was reckoned for.
    pub behind_loose: bool,
    /// Whether the axis was within the window around its end since it was sent: the drive may have been at it already.
    pub early: bool,
}

impl Raised {
    pub fn canonicalize(&mut self, now: Duration, acknowledge: Duration) {
        no_older(&mut self.since, now, acknowledge);
        self.request.blocked_since = None;
    }

    /// Whether it replaces the others.
    pub fn replaces(&self) -> bool {
        self.request.replaces()
    }

    /// How far an axis may be behind a demand that has ended, as fast as it has been since bit 4 rose.
    fn lag(&self, cycle: &Cycle<'_>) -> u32 {
        let way = u128::from(cycle.bounds.distance(self.at, cycle.sample.position));
        let time = cycle.now.saturating_sub(self.since).as_nanos().max(1);
        u32::try_from(way * LAG.as_nanos() / time).unwrap_or(u32::MAX)
    }

    /// Whether it ends in motion.
    pub fn has_end_velocity(&self) -> bool {
        let parameters = &self.request.command.set_point.parameters;
        parameters
            .end_velocity
            .is_some_and(|velocity| velocity != 0)
    }
}

impl Bit4 {
    /// Low from the next frame on.
    pub const LOW: Self = Self::Low {
        delivered: None,
        will_be_seen: false,
        stays: false,
        room: None,
    };

    /// Lets go of what makes no difference any more.
    pub fn canonicalize(&mut self, now: Duration, seen: Duration, acknowledge: Duration) {
        match self {
            Self::Low {
                delivered, room, ..
            } => {
                for at in [delivered, room].into_iter().flatten() {
                    no_older(at, now, seen);
                }
            }
            Self::High {
                raised,
                fields_before,
                sent,
                delivered,
                fell,
                shown,
                ..
            } => {
                raised.canonicalize(now, acknowledge);
                if *sent {
                    *fields_before = (0, Parameters::default());
                }
                for at in [delivered, fell].into_iter().flatten() {
                    no_older(at, now, seen);
                }
                *shown = (*shown).min(SHOWN_AFTER);
            }
            Self::Abandoned => {}
        }
    }

    pub const fn is_low(&self) -> bool {
        matches!(self, Self::Low { .. })
    }

    /// Takes in what a cycle with inputs shows of it.
    #[inline]
    pub fn note(&mut self, cycle: &Cycle<'_>) {
        let (acknowledge, now) = (cycle.is_acknowledging(), cycle.now);
        match self {
            Self::Low {
                delivered,
                will_be_seen,
                stays,
                room,
            } => {
                if cycle.delivered && delivered.is_none() {
                    *delivered = Some(now);
                    *will_be_seen = acknowledge;
                }
                let seen = || delivered.is_some_and(|at| cycle.is_seen(at));
                *stays = *stays || cycle.bit_12_shows_room() || (acknowledge && seen());
                if *stays {
                    *room = (!acknowledge).then(|| room.unwrap_or(now));
                }
            }
            Self::High {
                sent: true,
                raised,
                delivered,
                full,
                fell,
                shown,
                ..
            } => {
                raised.far_behind &= !cycle.is_reached();
                raised.early |= cycle.is_within_window_of(raised.end)
                    && !(raised.stands && cycle.is_within_window_of(Some(raised.at)));
                if cycle.delivered {
                    delivered.get_or_insert(now);
                }
                // What the frame shows that brings bit 4 is from before it, and no answer.
                if acknowledge && now == raised.since {
                    *full = true;
                }
                // A place became free after all before the drive took it: its edge will come. One word may be wrong.
                if *full {
                    *fell = (!acknowledge).then(|| fell.unwrap_or(now));
                    if fell.is_some_and(|at| cycle.is_seen(at)) {
                        (*full, *fell) = (false, None);
                    }
                }
                let seen = delivered.is_some_and(|at| cycle.is_seen(at));
                *shown = shown.saturating_add(u8::from(seen));
            }
            Self::High { .. } | Self::Abandoned => {}
        }
    }

    /// What bit 12 shows of a place in the drive's buffer, once it is low again after a set-point.
    #[inline]
    pub fn room(&self, cycle: &Cycle<'_>) -> Option<Room> {
        if !self.is_low_acknowledged(cycle) {
            return None;
        }
        let in_doubt = match self {
            Self::Low { room, .. } => room.is_some_and(|since| !cycle.is_seen(since)),
            _ => false,
        };
        Some(if in_doubt { Room::Shown } else { Room::Sure })
    }

    /// Whether bit 12 is low and the drive has surely seen bit 4 low: by the fall of bit 12, or by its own cycle.
    #[inline]
    pub fn is_low_acknowledged(&self, cycle: &Cycle<'_>) -> bool {
        let &Self::Low {
            delivered: Some(_),
            will_be_seen,
            ..
        } = self
        else {
            return false;
        };
        !cycle.is_acknowledging() && (will_be_seen || self.is_low_seen(cycle))
    }

    /// Whether the drive has surely seen it low, by its own cycle.
    pub fn is_low_seen(&self, cycle: &Cycle<'_>) -> bool {
        matches!(self, &Self::Low { delivered: Some(at), .. } if cycle.is_seen(at))
    }

    /// The set-point that is on its way: the drive may have taken it already, and its acknowledge is still to come.
    pub const fn on_its_way(&self) -> Option<&Raised> {
        match self {
            Self::High {
                raised, sent: true, ..
            } => Some(raised),
            _ => None,
        }
    }

    /// The move whose bit 4 has risen in the outputs and has not been sent.
    pub const fn unsent(&self) -> Option<CommandId> {
        match self {
            Self::High {
                raised,
                sent: false,
                ..
            } => Some(raised.request.id),
            _ => None,
        }
    }

    /// The outputs composed last have been sent.
    pub const fn mark_sent(&mut self, now: Duration) {
        if let Self::High { sent, raised, .. } = self
            && !*sent
        {
            *sent = true;
            raised.since = now;
        }
    }
}

// Moves that wait for their turn, in the order in which they were asked for; one that replaces all others overtakes those
// that would be queued.

/// Moves that may wait; one more is refused as busy.
const PLACES: usize = 4;

/// A move that has not been sent.
#[derive(Debug, Clone, Copy, Hash)]
struct Request {
    pub id: CommandId,
    pub command: MoveCommand,
    /// When it became the next in turn with nothing but bit 12 in its way.
    pub blocked_since: Option<Duration>,
}

impl Request {
    /// Whether it replaces all others.
    fn replaces(&self) -> bool {
        self.command.set_point.buffer_mode == BufferMode::Aborting
    }
}

/// A queue of fixed size.
#[derive(Debug, Clone, Hash, Default)]
struct PendingMoves {
    places: [Option<Request>; PLACES],
    /// So many of them, the oldest, are overtaken by a move whose bit 4 has risen: they are over once that was sent.
    overtaken: usize,
}

impl PendingMoves {
    pub fn is_empty(&self) -> bool {
        self.places[0].is_none()
    }

    /// Adds a move at the end; false when there is no place.
    pub fn push(&mut self, id: CommandId, command: MoveCommand) -> bool {
        match self.places.iter_mut().find(|place| place.is_none()) {
            Some(place) => {
                *place = Some(Request {
                    id,
                    command,
                    blocked_since: None,
                });
                true
            }
            None => false,
        }
    }

    /// The move whose turn it is: the oldest that replaces all others, else the oldest.
    pub fn first(&self) -> Option<&Request> {
        self.places.get(self.turn()).and_then(Option::as_ref)
    }

    /// The one that was asked for last, and is not overtaken.
    pub fn last(&self) -> Option<&Request> {
        self.places.iter().skip(self.overtaken).flatten().last()
    }

    /// The first that starts together with others and replaces none.
    pub fn first_gated_to_queue(&self) -> Option<CommandId> {
        let mut gated = self.places.iter().flatten().filter(|r| r.command.gated);
        gated.find(|r| !r.replaces()).map(|request| request.id)
    }

    /// Since when the move whose turn it is has nothing but bit 12 in its way: since `now`, if it had not before.
    pub fn first_blocked_since(&mut self, now: Duration) -> Duration {
        let turn = self.turn();
        match self.places.get_mut(turn) {
            Some(Some(first)) => *first.blocked_since.get_or_insert(now),
            _ => now,
        }
    }

    /// Bit 12 is not in the way of the move whose turn it is.
    pub fn first_is_free(&mut self) {
        let turn = self.turn();
        if let Some(Some(first)) = self.places.get_mut(turn) {
            first.blocked_since = None;
        }
    }

    /// Lets go of what makes no difference any more.
    pub fn canonicalize(&mut self, now: Duration, acknowledge: Duration) {
        for request in self.places.iter_mut().flatten() {
            if let Some(since) = &mut request.blocked_since {
                no_older(since, now, acknowledge);
            }
        }
    }

    /// Takes the oldest out.
    pub fn pop(&mut self) -> Option<Request> {
        let first = self.places[0].take();
        self.close_up(0);
        self.overtaken = self.overtaken.saturating_sub(1);
        first
    }

    /// Takes the move whose turn it is out: those before it are overtaken.
    pub fn take_turn(&mut self) {
        let turn = self.turn();
        self.places[turn] = None;
        self.close_up(turn);
        self.overtaken = turn;
    }

    /// What has overtaken them does not come: they wait as before.
    pub const fn keep_overtaken(&mut self) {
        self.overtaken = 0;
    }

    /// Those behind the empty place move up.
    fn close_up(&mut self, mut empty: usize) {
        while let Some(Some(next)) = self.places.get_mut(empty + 1).map(Option::take) {
            self.places[empty] = Some(next);
            empty += 1;
        }
    }

    /// Takes out the oldest, if it is overtaken.
    pub fn pop_overtaken(&mut self) -> Option<Request> {
        if self.overtaken == 0 {
            None
        } else {
            self.pop()
        }
    }

    fn turn(&self) -> usize {
        let mut places = self.places.iter().map(Option::as_ref);
        places
            .position(|place| place.is_some_and(Request::replaces))
            .unwrap_or(0)
    }

    /// Removes the move with this id; whether there was one.
    pub fn remove(&mut self, id: CommandId) -> bool {
        let Some(at) = self
            .places
            .iter()
            .position(|place| place.is_some_and(|r| r.id == id))
        else {
            return false;
        };
        self.places[at] = None;
        self.close_up(at);
        self.overtaken -= usize::from(at < self.overtaken);
        true
    }
}

// The set-points that the drive holds: the active one and the one behind it, followed to their ends.

/// Set-points that the drive may hold.
const HELD: usize = 2;

/// Whether the drive can take a move.
enum BufferRoom {
    Free,
    /// Its buffer is full; if bit 12 shows that, whatever is known of the drive, a set-point that replaces everything is
    /// taken without an edge of it.
    Full,
    Later,
    Never(&'static str),
}

/// Whether there may be a set-point that the drive has taken and not acknowledged: what the position shows may be its way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unacknowledged {
    None,
    /// Its acknowledge is still to come. `replaces`: when it comes, the others have been replaced, and what shows before that may be its
    /// way past their ends.
    Comes {
        replaces: bool,
    },
    /// Its acknowledge has not come in time: whether the drive has taken it stays unknown. `anywhere`: it replaces the others, and may
    /// end anywhere, at their ends, too.
    Perhaps {
        anywhere: bool,
    },
}

/// The set-points that the drive has acknowledged and not ended, in order.
#[derive(Debug, Clone, Hash, Default)]
struct DriveBuffer {
    held: [Option<SetPointMonitor>; HELD],
    /// The second of two as the active one, since bit 12 began to show that the first is over.
    takeover: Option<Takeover>,
    /// One that is over by the drive's word, bit 12, and whose end the axis has not been seen at.
    over: Option<Over>,
    /// The end of the last set-point, where the axis has arrived.
    last_end: Option<i32>,
    /// Whether the last one has ended with no way to go, and nothing has shown that the drive had begun it: it may do so yet, before the next.
    unseen: bool,
    /// Whether the last one has ended without a proof of it: the axis came to rest elsewhere than at its end, and what brought it there may
    /// have been something else. The drive may hold that one still, until a later one has led the axis to its end.
    unproven: bool,
    /// Whether the axis is where the last set-point has ended well, or where it was enabled: there a distance counts from, whatever the
    /// drive counts from.
    at_base: bool,
    /// Whether the one that was taken last ends in motion, or has done so.
    ends_in_motion: bool,
    /// When the last one has ended.
    ended: Duration,
    /// Whether the drive has been given up on beginning one that it has acknowledged: it may still do so.
    not_begun: bool,
}

/// A set-point whose turn has come, for all that bit 12 shows: it becomes the first when that is sure.
#[derive(Debug, Clone, Copy, Hash)]
struct Takeover {
    monitor: SetPointMonitor,
    /// Where the axis was when it came, and whether it had been seen at the end of the one before.
    position: i32,
    at_end: bool,
}

impl Takeover {
    fn new(second: &SetPointMonitor, first: &SetPointMonitor, cycle: &Cycle<'_>) -> Self {
        let mut monitor = *second;
        monitor.takes_over(first, true, false, cycle);
        Self {
            monitor,
            position: cycle.sample.position,
            at_end: first.is_seen_at_end(cycle),
        }
    }

    fn note(&mut self, cycle: &Cycle<'_>) {
        self.monitor.note(cycle, true);
        self.monitor.note_limit(cycle.sample.statusword);
    }
}

/// A set-point whose place the next one has taken.
#[derive(Debug, Clone, Hash)]
struct Over {
    monitor: SetPointMonitor,
    /// How the next one was started, and when it was seen to have taken over, from where.
    next: BufferMode,
    since: Duration,
    position: i32,
}

impl DriveBuffer {
    /// Whether one has just ended that the drive may still begin.
    pub const fn take_not_begun(&mut self) -> bool {
        core::mem::replace(&mut self.not_begun, false)
    }

    /// Whether the drive may hold one of which the end was reported already.
    pub const fn is_unproven(&self) -> bool {
        self.unproven
    }

    /// The drive has dropped all of them, out of Operation enabled: when it is enabled again it begins where the axis then is.
    pub const fn forget(&mut self) {
        self.unseen = false;
        self.unproven = false;
        self.ends_in_motion = false;
        self.at_base = true;
    }

    /// Whether it is full, as far as is known.
    pub const fn holds_two(&self) -> bool {
        self.held[1].is_some()
    }

    pub fn is_empty(&self) -> bool {
        self.held.iter().all(Option::is_none)
    }

    /// Whether at most one is held, and nothing is open about a halt or those before it.
    pub fn allows_idle_path(&self) -> bool {
        let [first, rest @ ..] = &self.held;
        self.over.is_none()
            && rest.iter().all(Option::is_none)
            && first.as_ref().is_none_or(SetPointMonitor::allows_idle_path)
    }

    /// The drive has taken this one. `confirmed`: by an edge of bit 12.
    pub fn accept(
        &mut self,
        raised: &mut Raised,
        confirmed: bool,
        cycle: &Cycle<'_>,
        events: &mut Events,
    ) {
        // The one before it may have come to its end meanwhile.
        let before = self.before(&raised.request.command);
        raised.far_behind &= before.is_some_and(|before| !before.may_be_over(cycle));
        let mut monitor = SetPointMonitor::new(raised, confirmed, cycle);
        if raised.replaces() {
            let mut replaced = self.held.iter().flatten();
            monitor.leads_round |= replaced.any(|held| monitor.may_go_round_for(held, cycle));
        }
        events.push(monitor.id, Event::Accepted);
        self.push(monitor, events);
    }

    /// Takes in a set-point that the drive has acknowledged; with `Aborting` it is the only one from now on.
    pub fn push(&mut self, mut monitor: SetPointMonitor, events: &mut Events) {
        self.at_base = false;
        self.ends_in_motion = monitor.ends_in_motion;
        if monitor.buffer_mode == BufferMode::Aborting {
            self.fail_all(Failure::Superseded, events);
            self.unproven = false;
        } else if self.is_empty() && (self.unseen || self.unproven) {
            monitor.comes_after_doubt(self.unproven);
        }
        if let Some(place) = self.held.iter_mut().find(|place| place.is_none()) {
            *place = Some(monitor);
            self.takeover = None;
        }
    }

    /// Ends all of them, with the axis anywhere.
    pub fn fail_all(&mut self, failure: Failure, events: &mut Events) {
        let over = self.over.take().map(|over| over.monitor);
        self.takeover = None;
        let held = self.held.iter_mut().filter_map(Option::take);
        for monitor in over.into_iter().chain(held) {
            let failure = failure.with_delivery(monitor.delivery());
            events.push(monitor.id, Event::Done(Err(failure)));
        }
        self.last_end = None;
        self.unseen = false;
    }

    /// Lets go of what makes no difference any more.
    pub fn canonicalize(&mut self, now: Duration, begin: Duration, settle: Duration) {
        for monitor in self.held.iter_mut().flatten() {
            monitor.canonicalize(now, begin, settle);
        }
        if let Some(takeover) = &mut self.takeover {
            takeover.monitor.canonicalize(now, begin, settle);
        }
        if let Some(over) = &mut self.over {
            over.monitor.canonicalize(now, begin, settle);
            no_older(&mut over.since, now, settle);
        }
        no_older(&mut self.ended, now, settle);
    }

    /// The axis stands halted: reports it for each of them, once for each halt.
    pub fn report_halted(&mut self, events: &mut Events) {
        let over = self.over.as_mut().map(|over| &mut over.monitor);
        for monitor in over
            .into_iter()
            .chain(self.held.iter_mut().flatten())
            .filter(|monitor| !monitor.halt_told)
        {
            monitor.halt_told = true;
            events.push(monitor.id, Event::Halted);
        }
    }

    /// The ramp of a halt may lead past the end of the active one.
    fn note_halted(&mut self, cycle: &Cycle<'_>) {
        if let [Some(active), _] = &mut self.held {
            active.note(cycle, false);
        }
    }

    /// Bit 8 falls.
    pub fn resumed(&mut self, now: Duration, from_rest: bool) {
        for (place, monitor) in self.held.iter_mut().flatten().enumerate() {
            monitor.goes_on(now, from_rest, place == 0);
        }
        // It comes anew where bit 12 still shows it.
        self.takeover = None;
        if let Some(over) = &mut self.over {
            over.since = now;
            over.monitor.halt_told = false;
        }
    }

    /// One cycle that is not halted: of a halted axis nothing is claimed. `room`: bit 12 is low again after a set-point.
    // Kept out of `Sequencer::step`, which is then small enough to be part of the core's step.
    #[inline(never)]
    pub fn follow(
        &mut self,
        cycle: &Cycle<'_>,
        room: Option<Room>,
        next: Unacknowledged,
        events: &mut Events,
    ) {
        // A single set-point, with nothing behind it, ends where the axis stands, whatever was not seen of its way.
        let alone = self.over.is_none() && self.held[1].is_none() && next == Unacknowledged::None;
        let stalled;
        let cycle = if alone {
            cycle
        } else {
            stalled = cycle.with_stall();
            &stalled
        };
        let undecided = self.follow_over(cycle, events);
        if let Unacknowledged::Perhaps { anywhere } = next
            && !undecided
        {
            self.follow_doubtful(anywhere, cycle, events);
            return;
        }
        match &mut self.held {
            [Some(first), Some(second)] => {
                let room = room.filter(|_| cycle.bit_12_shows_room());
                let shown = room == Some(Room::Sure);
                let actual = cycle.sample.position;
                second.note_behind(first, cycle);
                first.note(cycle, false);
                match &mut self.takeover {
                    takeover if room.is_none() => *takeover = None,
                    Some(takeover) => takeover.note(cycle),
                    takeover => *takeover = Some(Takeover::new(second, first, cycle)),
                }
                // When bit 12 has fallen, the next one has taken over, and bit 11 is of that.
                if cycle.is_acknowledging() {
                    first.note_limit(cycle.sample.statusword);
                }
                let ran_on = second.ends_in_motion && first.has_run_on(second, cycle);
                let behind = first.is_left_behind(second, cycle);
                let left = (behind || ran_on) && !cycle.bit_12_shows_room();
                let rest = if room.is_some() || left {
                    None
                } else {
                    first.rests_with(second, cycle)
                };
                let over = shown || left || rest.is_some();
                if over && next == Unacknowledged::None && !undecided {
                    if let Some(Rest::Unreached) = rest {
                        events.push(first.id, Event::Done(Err(first.unreached(cycle))));
                        events.push(second.id, Event::Done(Err(second.unreached(cycle))));
                        self.held = [None; HELD];
                        self.last_end = None;
                        self.not_begun = true;
                        return;
                    }
                    if let Some(Rest::NextNotBegun | Rest::NoneBegun) = rest {
                        let not_begun = Err(Failure::NotBegun { actual });
                        let outcome = match rest {
                            Some(Rest::NextNotBegun) => first.ended_into(second.buffer_mode, cycle),
                            _ => not_begun,
                        };
                        events.push(first.id, Event::Done(outcome));
                        events.push(second.id, Event::Done(not_begun));
                        self.held = [None; HELD];
                        self.last_end = None;
                        self.not_begun = true;
                        return;
                    }
                    let mut failed = false;
                    let takeover = self.takeover.take().filter(|_| shown);
                    let position = takeover.map_or(actual, |takeover| takeover.position);
                    if shown && !first.is_seen_at_end(cycle) {
                        self.over = Some(Over {
                            monitor: *first,
                            next: second.buffer_mode,
                            since: cycle.now,
                            position,
                        });
                    } else {
                        let sample = Sample {
                            position,
                            ..*cycle.sample
                        };
                        let at_change = Cycle {
                            sample: &sample,
                            ..*cycle
                        };
                        let outcome = first.ended_into(second.buffer_mode, &at_change);
                        failed = outcome.is_err();
                        // At rest nothing shows that the next one has taken over.
                        if rest.is_some() && outcome.is_err() {
                            self.unproven = true;
                            second.comes_after_doubt(true);
                        }
                        events.push(first.id, Event::Done(outcome));
                    }
                    match takeover {
                        Some(mut takeover) => {
                            if !takeover.at_end {
                                takeover.monitor.came_to_end_of(first, cycle);
                            }
                            *second = takeover.monitor;
                        }
                        None => second.takes_over(first, false, rest.is_some(), cycle),
                    }
                    if ran_on && left {
                        second.ran_on();
                    }
                    if failed {
                        second.comes_after_error();
                    }
                    self.last_end = first.end;
                    self.held[0] = self.held[1].take();
                }
            }
            [Some(_), None] => {
                self.follow_active(cycle, next, undecided, events);
            }
            [None, _] => {}
        }
    }

    /// Takes in one cycle of the only one that is held, where no cycle before it was without inputs. Whether it may end with it.
    #[inline(always)]
    pub fn note_active(&mut self, now: Duration, sample: &Sample, bounds: &Bounds) -> bool {
        let [Some(monitor), _] = &mut self.held else {
            return false;
        };
        monitor.note_limit(sample.statusword);
        monitor.follow(now, sample, 0, true, bounds)
            || sample.statusword.contains(Statusword::TARGET_REACHED)
    }

    /// One cycle of the only one that is held. Whether it has ended.
    fn follow_active(
        &mut self,
        cycle: &Cycle<'_>,
        next: Unacknowledged,
        undecided: bool,
        events: &mut Events,
    ) -> bool {
        let [Some(monitor), _] = &mut self.held else {
            return false;
        };
        monitor.note(cycle, true);
        monitor.note_limit(cycle.sample.statusword);
        self.end_active(cycle, next, undecided, events)
    }

    /// Ends the only one that is held, if what was taken in of this cycle shows its end. Whether it has ended.
    pub fn end_active(
        &mut self,
        cycle: &Cycle<'_>,
        next: Unacknowledged,
        undecided: bool,
        events: &mut Events,
    ) -> bool {
        let [Some(monitor), _] = &mut self.held else {
            return false;
        };
        // What one shows that is taken and not acknowledged yet is not the end of this one; its own end, where that is
        // known, is, unless the other has replaced it.
        let known = monitor.end.is_some() && next != (Unacknowledged::Comes { replaces: true });
        let outcome = monitor
            .outcome(cycle)
            .filter(|outcome| next == Unacknowledged::None || (known && outcome.is_ok()));
        match outcome {
            Some(outcome) if !undecided => {
                self.last_end = if outcome.is_ok() { monitor.end } else { None };
                let begun = monitor.has_begun(cycle);
                self.unseen = outcome.is_ok() && !begun;
                let proven = begun && monitor.end.is_some();
                self.unproven = outcome.is_err() || (self.unproven && !proven);
                self.at_base = outcome.is_ok() && !self.ends_in_motion;
                self.ended = cycle.now;
                // Behind one that the drive may hold, it may be the second of two.
                let both_held = monitor.doubted && matches!(outcome, Err(Failure::Timeout { .. }));
                self.not_begun |= both_held || matches!(outcome, Err(Failure::NotBegun { .. }));
                events.push(monitor.id, Event::Done(outcome));
                self.held[0] = None;
                true
            }
            _ => false,
        }
    }

    /// A later set-point may have replaced them: what the axis passes says nothing of them. Where it stands at the end of the last of
    /// them that one has arrived; where it stands otherwise, none of them is known to be what has led it there.
    fn follow_doubtful(&mut self, anywhere: bool, cycle: &Cycle<'_>, events: &mut Events) {
        let actual = cycle.sample.position;
        let last = self.held.iter().flatten().count();
        for (place, held) in self.held.iter_mut().enumerate() {
            let Some(monitor) = held else { continue };
            monitor.note(cycle, false);
            let at_rest = monitor.is_at_rest(cycle);
            // One that ends in motion does not come to rest at its end.
            let known = monitor.end.is_some() && !monitor.ends_in_motion;
            let may_arrive = known && !anywhere && place + 1 == last && at_rest;
            let outcome = match monitor.outcome(cycle) {
                Some(Ok(completion)) if may_arrive => Ok(completion),
                Some(Err(Failure::Timeout { .. })) => Err(Failure::PerhapsSuperseded { actual }),
                _ if at_rest => Err(Failure::PerhapsSuperseded { actual }),
                _ => continue,
            };
            events.push(monitor.id, Event::Done(outcome));
            *held = None;
        }
        if self.held[0].is_none() {
            self.held[0] = self.held[1].take();
        }
        self.last_end = None;
    }

    /// The drive's word alone does not say that the axis was at the end: it may have limited the move. The actual position may
    /// also be behind the demand; it has the settle time to show itself at the end. Whether that is still open.
    fn follow_over(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        let Some(over) = &mut self.over else {
            return false;
        };
        over.monitor.note(cycle, false);
        let waited = cycle.now.saturating_sub(over.since) >= cycle.bounds.settle;
        if !waited && !over.monitor.is_seen_at_end(cycle) {
            return true;
        }
        if let Some(next) = &mut self.held[0] {
            next.came_to_end_of(&over.monitor, cycle);
        }
        let outcome = match over.monitor.ended_into(over.next, cycle) {
            Err(Failure::MissedTarget { target, .. }) => Err(Failure::MissedTarget {
                target,
                actual: over.position,
            }),
            Err(Failure::Unseen { target, .. }) => Err(Failure::Unseen {
                target,
                actual: over.position,
            }),
            outcome => outcome,
        };
        if let Some(next) = &mut self.held[0]
            && outcome.is_err()
        {
            next.comes_after_error();
        }
        events.push(over.monitor.id, Event::Done(outcome));
        self.over = None;
        false
    }

    /// Another goes to the drive.
    pub fn note_next(&mut self, cycle: &Cycle<'_>) {
        if let Some(last) = self.held.iter_mut().flatten().last() {
            last.gave_way = last.gives_way(cycle);
        }
    }

    /// Whether the drive can take this move now.
    pub fn place_for(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> BufferRoom {
        let traits = cycle.traits;
        let buffer_mode = command.set_point.buffer_mode;
        let bits = traits.bits(buffer_mode);
        let [Some(active), next] = &self.held else {
            // One whose end was reported leads the axis, and another may be behind it.
            let is_led = self.unproven && !cycle.is_reached() && !cycle.standstill.is_standing();
            return match buffer_mode {
                BufferMode::Buffered | BufferMode::Blending if is_led => BufferRoom::Later,
                _ => BufferRoom::Free,
            };
        };
        let full = next.is_some() || (self.unproven && buffer_mode != BufferMode::Aborting);
        let shown_by_bit_12 = cycle.bit_12_shows_room();
        match buffer_mode {
            BufferMode::Aborting if full => match (command.reference, traits.buffer_signal) {
                // A bit 12 that is still high is not that of the buffer.
                (_, BufferSignal::None) => BufferRoom::Free,
                (Reference::Absolute, _) => BufferRoom::Full,
                (Reference::Relative, BufferSignal::Acknowledge) => BufferRoom::Never(
                    "its buffer is full and acknowledges nothing, and where a distance taken once too little or too often \
                     would end cannot be seen: use an absolute move, or stop",
                ),
                (Reference::Relative, BufferSignal::Unknown) => BufferRoom::Free,
            },
            BufferMode::Aborting => BufferRoom::Free,
            _ if bits == StartBits::Sequenced || full => BufferRoom::Later,
            _ if shown_by_bit_12 => BufferRoom::Free,
            // Before it the drive may hold another one yet.
            _ if !active.is_surely_first(cycle) => BufferRoom::Later,
            BufferMode::Buffered if active.shows_its_stop() => BufferRoom::Free,
            BufferMode::Blending if active.shows_its_passing() => BufferRoom::Free,
            BufferMode::Blending if active.end.is_none() || active.turns => BufferRoom::Never(
                "the end of the active move shows neither in bit 12 nor in the position: \
                 use Buffered, or an absolute move before it",
            ),
            // Sent when the axis is on its way to the end, or has arrived there.
            BufferMode::Buffered | BufferMode::Blending => BufferRoom::Later,
        }
    }

    /// Whether a move would begin at rest.
    pub fn begins_at_rest(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> bool {
        match command.set_point.buffer_mode {
            BufferMode::Buffered => !self.ends_in_motion || self.stands(cycle),
            BufferMode::Blending | BufferMode::Aborting => self.stands(cycle),
        }
    }

    /// Whether the axis stands, with no set-point that the drive holds.
    pub fn stands(&self, cycle: &Cycle<'_>) -> bool {
        let stands = || {
            let standstill = cycle.standstill;
            standstill.stands_since(cycle.now, self.ended, cycle.bounds)
        };
        self.is_empty() && (stands() || self.has_arrived(cycle))
    }

    /// Whether whatever a distance may count from is where the axis has last come to rest.
    pub const fn is_at_base(&self) -> bool {
        self.at_base
    }

    /// Another mode may lead the axis anywhere.
    pub const fn leave_base(&mut self) {
        self.at_base = false;
    }

    /// Whether the axis is where the last set-point ended, and 606Ch says that it stands there.
    fn has_arrived(&self, cycle: &Cycle<'_>) -> bool {
        let (position, bounds) = (cycle.sample.position, cycle.bounds);
        let slow = |velocity: i32| velocity.unsigned_abs() <= bounds.velocity;
        cycle.sample.velocity.is_some_and(slow)
            && self
                .last_end
                .is_some_and(|end| bounds.is_within_window(end, position))
    }

    /// Where a move begins: behind another at the end of that, where it is known; else where the axis is.
    pub fn begin_of(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> i32 {
        self.before(command)
            .and_then(|before| before.end)
            .unwrap_or(cycle.sample.position)
    }

    /// The one that a move is to follow.
    pub fn before(&self, command: &MoveCommand) -> Option<&SetPointMonitor> {
        let queues = command.set_point.buffer_mode != BufferMode::Aborting;
        self.last().filter(|_| queues)
    }

    /// The last one.
    pub fn last(&self) -> Option<&SetPointMonitor> {
        self.held.iter().flatten().last()
    }

    /// Whether one of them ends so near to a position that an axis there may have been led by either.
    pub fn ends_near(&self, position: i32, bounds: &Bounds) -> bool {
        let near = |end| bounds.distance(end, position) <= bounds.position.saturating_mul(3);
        self.held
            .iter()
            .flatten()
            .any(|monitor| monitor.end.is_some_and(near) || monitor.may_end_at(position, bounds))
    }

    /// Where a move will end, where the documents and the position show it.
    pub fn end_of(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Option<i32> {
        match command.reference {
            // A drive that counts from the actual position takes it on the way, behind the end of the move before by the
            // following error.
            Reference::Relative
                if command.set_point.buffer_mode == BufferMode::Blending
                    && !self.is_empty()
                    && cycle.traits.relative_base == RelativeBase::Actual =>
            {
                None
            }
            Reference::Absolute | Reference::Relative => self.goal_of(command, cycle),
        }
    }

    /// The end of the last set-point, held or arrived at, where it is known.
    pub fn previous_end(&self) -> Option<i32> {
        match self.held.iter().flatten().last() {
            Some(before) => before.end,
            None => self.last_end,
        }
    }

    /// Where a move leads, also where its end is not known to the count.
    pub fn goal_of(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Option<i32> {
        match command.reference {
            Reference::Absolute => Some(command.target),
            Reference::Relative => {
                let base = self.base_of(command, cycle);
                base.map(|base| cycle.bounds.after(base, command.target))
            }
        }
    }

    /// Refuses a relative move whose turn has come and that would end beyond a limit, where its end is known.
    pub fn check_limits(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Result<(), Failure> {
        if command.reference == Reference::Relative
            && let Some(base) = self.base_of(command, cycle)
        {
            let target = match cycle.bounds.turn {
                Some(_) => cycle.bounds.after(base, command.target).into(),
                None => i64::from(base) + i64::from(command.target),
            };
            let rule = &cycle.traits.limits;
            return cycle.limits.check_target(target, rule, cycle.referenced);
        }
        Ok(())
    }

    /// What a relative move would count from, where the documents and the position show it.
    fn base_of(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Option<i32> {
        let (position, traits) = (cycle.sample.position, cycle.traits);
        if self.is_empty() && self.unproven && command.set_point.buffer_mode != BufferMode::Aborting
        {
            // Behind one that the drive may hold.
            return None;
        }
        let queues = command.set_point.buffer_mode != BufferMode::Aborting;
        match self.held.iter().flatten().last() {
            // An axis in motion is elsewhere when the drive takes it.
            _ if self.ends_in_motion || !(queues || self.is_empty()) => {
                match traits.relative_base {
                    RelativeBase::PreviousTarget => self.previous_end(),
                    RelativeBase::Demand
                    | RelativeBase::Actual
                    | RelativeBase::PositioningOption
                    | RelativeBase::Undocumented => None,
                }
            }
            // At the end of the move before it all bases are the same, or nearly so: see `end_of`.
            Some(before) => before.end,
            None => match traits.relative_base {
                RelativeBase::Actual | RelativeBase::Demand => Some(position),
                // An axis that is not there any more has been homed, jogged or moved by hand since: what the drive takes for
                // its previous target then, no document says.
                RelativeBase::PreviousTarget
                | RelativeBase::Undocumented
                | RelativeBase::PositioningOption => self
                    .last_end
                    .filter(|&end| cycle.bounds.is_within_window(end, position)),
            },
        }
    }
}

/// Bits 5, 6 and 9 that start a move.
const fn start_bits(command: &MoveCommand, traits: &Traits) -> ModeBits {
    let (change_set_immediately, change_on_set_point) =
        match traits.bits(command.set_point.buffer_mode) {
            StartBits::Bits {
                change_set_immediately,
                change_on_set_point,
            } => (change_set_immediately, change_on_set_point),
            // Sequenced after arrival: it starts an axis that stands.
            StartBits::Sequenced | StartBits::Unsupported(_) => (false, false),
        };
    let relative = match command.reference {
        Reference::Absolute => false,
        Reference::Relative => true,
    };
    ModeBits::of_set_point(SetPointBits {
        change_set_immediately,
        relative,
        change_on_set_point,
    })
}

// One set-point that the drive has acknowledged, followed to its end.

/// So many cycles at least have to show an axis away from an end before it counts as left.
const AWAY_CYCLES: u8 = 3;

/// Bit 12 that falls within so many times the time in which the drive has surely seen a word, after an acknowledge, falls with that.
const AT_ONCE: u32 = 4;

/// What was seen of an axis at the end of a set-point that another has followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum EndSeen {
    There,
    /// It may have been there in cycles that brought no inputs.
    Unseen,
    Elsewhere,
}

/// What an axis at rest with two set-points held means for them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rest {
    BothOver,
    /// The first is over, and the second has not begun in time.
    NextNotBegun,
    NoneBegun,
    /// The axis stands at the end of one of them, and bit 10 stays low: which of them the drive has not ended is not known.
    Unreached,
}

/// The bounds of an axis that does not keep within its window, span by span: in two spans within the same bounds it is at rest.
#[derive(Debug, Clone, Copy, Hash, Default)]
struct Lingering {
    span: ShownFor,
    /// Where the axis was last, and how far it had come.
    at: Option<(i32, i64)>,
    bounds: Option<(i64, i64)>,
    before: Option<(i64, i64)>,
    rests: bool,
}

impl Lingering {
    /// Takes in a cycle with bit 10 high. Whether the axis is at rest.
    fn update(&mut self, cycle: &Cycle<'_>) -> bool {
        let position = cycle.sample.position;
        let (last, come) = self.at.unwrap_or((position, 0));
        let come = come + cycle.bounds.way(last, position);
        self.at = Some((position, come));
        let (low, high) = self.bounds.unwrap_or((come, come));
        let (low, high) = (low.min(come), high.max(come));
        self.bounds = Some((low, high));
        if self.span.update(cycle.now, true, cycle.begin) {
            let same = |a: i64, b: i64| a.abs_diff(b) <= cycle.bounds.position.into();
            self.rests = self
                .before
                .is_some_and(|before| same(before.0, low) && same(before.1, high));
            self.before = Some((low, high));
            self.span = ShownFor::default();
            self.bounds = None;
        }
        self.rests
    }

    /// How far apart its bounds are.
    fn width(&self) -> u32 {
        let width = self.before.map_or(0, |(low, high)| low.abs_diff(high));
        u32::try_from(width).unwrap_or(u32::MAX)
    }
}

/// What a distance may count from, where the drive's documents do not say, or the position does not show it. That is the end before it, or
/// where the axis, or its demand, was when the drive took it.
#[derive(Debug, Clone, Copy, Hash)]
struct Bases {
    previous: Option<i32>,
    /// How far the drive's base may be from that end: 0 where it is known.
    beside: u32,
    position: i32,
    /// How far the drive's base may be from that position.
    slack: u32,
    /// Whether the position is that of the axis when the drive took it.
    is_own: bool,
}

impl Bases {
    /// `replaced`: those behind a distance which this one replaces, and whose end is not known. The drive may count from where that would
    /// have ended.
    fn of(
        begin: i32,
        previous: Option<i32>,
        replaced: Option<Self>,
        from_rest: bool,
        cycle: &Cycle<'_>,
    ) -> Self {
        // In motion the drive took it between these two cycles, and its demand may be ahead of the axis by several times that way. What
        // an axis that stands has gone is noise.
        let way = if from_rest || cycle.standstill.is_standing() {
            0
        } else {
            cycle.bounds.distance(begin, cycle.sample.position)
        };
        let (previous, beside) = match (previous, replaced) {
            (None, Some(behind)) if behind.previous.is_some() => (behind.previous, behind.beside),
            (None, Some(behind)) => (Some(behind.position), behind.slack),
            _ => (previous, 0),
        };
        Self {
            previous,
            beside,
            position: begin,
            slack: way.saturating_mul(8).saturating_add(cycle.bounds.position),
            is_own: true,
        }
    }

    /// The same at the end of a distance from them.
    fn after(self, distance: i32, bounds: &Bounds) -> Self {
        Self {
            previous: self.previous.map(|end| bounds.after(end, distance)),
            beside: self.beside,
            position: bounds.after(self.position, distance),
            slack: self.slack.saturating_add(bounds.position),
            is_own: false,
        }
    }

    /// Whether the axis was no further than this from the end before it.
    fn are_near(&self, lag: u32, bounds: &Bounds) -> bool {
        let lag = lag.max(bounds.position.saturating_mul(3));
        self.previous
            .is_none_or(|end| bounds.distance(end, self.position) <= lag)
    }

    /// Whether a distance may end at this position.
    fn lead_to(&self, position: i32, distance: i32, bounds: &Bounds) -> bool {
        let near = |base: i32, slack: u32| {
            let end = bounds.after(base, distance);
            bounds.distance(end, position) <= bounds.position.saturating_add(slack)
        };
        // An axis that is where it was has gone no distance, however vague the base is, but for whole turns.
        let far = bounds.distance(bounds.after(self.position, distance), self.position);
        let stays = self.is_own
            && bounds.is_within_window(self.position, position)
            && far > bounds.position.saturating_mul(2);
        if stays {
            return false;
        }
        let from_end = |end| near(end, self.beside);
        near(self.position, self.slack) || self.previous.is_some_and(from_end)
    }

    /// Whether a distance ends at this position from wherever it counts: from anywhere between these places.
    fn all_lead_to(&self, position: i32, distance: i32, bounds: &Bounds) -> bool {
        let window = bounds.position;
        let beside = self.slack.saturating_sub(window);
        let near = |base: i32, beside: u32| {
            let away = bounds.distance(bounds.after(base, distance), position);
            away.saturating_add(beside) <= window
        };
        near(self.position, beside) && self.previous.is_none_or(|end| near(end, self.beside))
    }
}

/// Whether a distance leads out of the window around where it begins, and of that around its end.
const fn is_far(distance: i32, bounds: &Bounds) -> bool {
    distance.unsigned_abs() > bounds.position.saturating_mul(2)
}

/// An axis lags behind its demand by no more than what it goes in this time: that of a position loop of 25 1/s, and few are slower. Assumed,
/// no document says.
const LAG: Duration = Duration::from_millis(40);

/// How far an axis may lag behind its demand at the end of a way before this one.
const fn lag_of(way: i32) -> u32 {
    way.unsigned_abs() / 4
}

/// A set-point that the drive has acknowledged.
#[derive(Debug, Clone, Copy, Hash)]
struct SetPointMonitor {
    pub id: CommandId,
    /// How it was started: the end of the set-point before it is `Reached` or `Passed` by this.
    pub buffer_mode: BufferMode,
    /// Where it ends, where that is known.
    pub end: Option<i32>,
    /// Where it leads, also where its end is not known to the count.
    goal: Option<i32>,
    /// Of a distance, how far it leads, and what is known of where it counts from.
    distance: Option<i32>,
    bases: Bases,
    /// Whether the axis stood where every base of a distance is.
    at_base: bool,
    /// Whether the axis stood when it was sent, with nothing that the drive held. Else it may swing on its way.
    stood_before: bool,
    swings: bool,
    /// Whether a distance may count from a place beside the one that its end was reckoned from.
    is_loose: bool,
    /// Whether its end was reckoned from that of one which may end beside it.
    is_vague: bool,
    /// Whether the one before it may have ended beside its end, so that it is not known where the axis was when this one became active.
    begins_beside: bool,
    /// Whether it begins at rest: then the axis goes to its end without passing it before.
    pub from_rest: bool,
    /// Whether it was begun by a drive in motion, which may be too fast to stop at its end, and come back to it.
    overshoots: bool,
    /// Whether it is one of a modulo axis: the position alone does not say which way round it goes to its end, and how often.
    pub turns: bool,
    absolute: bool,
    /// Whether the drive passes its end, with its end velocity, and goes on.
    pub ends_in_motion: bool,
    /// Whether the way to an absolute target is longer than half the circle of 32 bits: then the position does not say which
    /// way the drive goes there.
    far: bool,
    /// Whether its end was near when it became active: then what is left of the motion before, within the window, looks like
    /// leaving or passing it.
    short: bool,
    /// Whether bit 11 (internal limit active) was seen low since it became active, and whether it was high in the last cycle that is surely
    /// of this one. A drive that shows it all the time
    /// may have limited the move, and the axis may pass the end that was asked for on its way to another.
    unlimited: bool,
    limited: bool,
    /// Whether an edge of bit 12 has acknowledged it; else its own motion has to show that the drive has taken it.
    confirmed: bool,
    /// Whether it was reported that the axis stands halted.
    pub halt_told: bool,
    /// When it became the active one, or was resumed.
    since: Duration,
    /// Whether bit 10 was seen low since then: only then a high one is news. And when it was last.
    left_target: bool,
    low: Duration,
    /// When it rose after that, and whether the axis went further than its window in that cycle.
    rose: Duration,
    passing: bool,
    /// Resumed: until the drive has surely seen bit 8 low, bit 10 may still be that of the halt. No time is known before that was delivered.
    halt_seen_over: Option<Duration>,
    /// Whether it became active behind another, or behind one that was over with no way to go and may begin yet. A low bit 10 may be of
    /// that one still.
    follows: bool,
    /// Whether bit 12 alone has shown that it became active: the axis may have been on its way to the end of the one before.
    by_room: bool,
    /// Whether it was sent after one that was over with no way to go.
    after_unseen: bool,
    /// Whether the drive may have to execute another before it: then that one may have moved the axis.
    doubted: bool,
    /// Where the axis stood when it became active. None where it did not stand: then where it has come to rest without a word of bit 10.
    stood: Option<i32>,
    /// Where the axis was when it became active, or was resumed.
    begun_at: i32,
    /// Whether bit 10 was high again when the next one went to the drive, and the axis where it had stood. The drive may have been done with this
    /// one there, and what then leads through its end is of the next.
    gave_way: bool,
    /// With bit 10 high: since when the axis has left that place. On its way from there it is not at rest, however slowly it sets off.
    left_place: Option<Duration>,
    /// What bounds an axis that does not come to rest within its window, with bit 10 high.
    lingering: Lingering,
    /// With another behind it, or one in doubt before it: since when it is at rest with bit 10.
    resting: Option<Duration>,
    /// With bit 10 low: the axis stands at its end.
    unreached: ShownFor,
    /// With one behind it that ends in motion: bit 10 is high, and the axis goes on beyond both ends.
    runs_on: ShownFor,
    /// From where on.
    runs_from: Option<i32>,
    /// The last position within the window around its end.
    arrived: Option<i32>,
    /// On which side of its end the axis was when it became active: the sign of end − position.
    side: i64,
    /// Of a modulo axis, whether the demand may have been past its end when the drive took it: that then lies a turn ahead, and the axis
    /// passes it before.
    may_lead_round: bool,
    /// Of a distance on a modulo axis, whether it leads round should it end where the axis was when it became active: the axis has not left
    /// that place yet.
    leads_round: bool,
    /// The way to its end in the last cycle, and whether that has changed its sign there.
    way: i64,
    crossed: bool,
    /// How far the end was in the last cycle, and whether the axis has come nearer since it became active.
    remaining: u32,
    approaching: bool,
    /// Where the axis was in the last cycle, and the longest way that it has gone in one.
    before: i32,
    fastest: u32,
    /// Whether it has come so near between two cycles that it was at the end.
    near: bool,
    /// How fast the axis would have had to be, in counts a cycle, to have been at the end while nothing was seen of it.
    unseen: u32,
    /// Whether the axis was seen at the end, or beyond it, whatever it has done since.
    seen_there: bool,
    /// Whether it was there before it was known to be the active one, when the drive may have been at this one already.
    early: bool,

    /// With another behind it, `was_there`: the axis was at the end or beyond, and has not come back to it. `rested`: it has stood there.
    /// `astray`: how far it was on the far side of the end, seen from where the next leads. `away`: since when it has been away on the way
    /// there, in so many cycles.
    was_there: bool,
    rested: bool,
    astray: i64,
    away: Option<(Duration, u8)>,
    farthest: i64,
    /// How long its way was when it became active.
    length: u32,
    /// Whether its side and its way have to be taken anew, from where the axis goes on.
    resumed: bool,
}

impl SetPointMonitor {
    pub fn new(raised: &Raised, confirmed: bool, cycle: &Cycle<'_>) -> Self {
        let &Raised {
            request: Request { id, command, .. },
            since: _,
            begin,
            at,
            end,
            goal,
            previous,
            from_rest,
            stands,
            at_base,
            far_behind,
            behind,
            behind_loose,
            early,
        } = raised;
        let mut monitor = Self {
            id,
            buffer_mode: command.set_point.buffer_mode,
            end,
            goal,
            distance: match command.reference {
                Reference::Absolute => None,
                Reference::Relative => Some(command.target),
            },
            at_base: stands && at_base,
            is_loose: false,
            begins_beside: false,
            is_vague: behind_loose && command.reference == Reference::Relative,
            stood_before: stands,
            swings: !stands,
            // Only a distance counts from them.
            bases: match behind {
                Some(behind) if command.set_point.buffer_mode != BufferMode::Aborting => behind,
                replaced => {
                    let is_absolute = command.reference == Reference::Absolute;
                    Bases::of(at, previous, replaced, from_rest || is_absolute, cycle)
                }
            },
            from_rest,
            overshoots: !from_rest && command.set_point.buffer_mode != BufferMode::Blending,
            confirmed,
            halt_told: false,
            turns: cycle.bounds.turn_length().is_some(),
            absolute: command.reference == Reference::Absolute,
            ends_in_motion: raised.has_end_velocity(),
            far: false,
            short: false,
            unlimited: false,
            limited: false,
            since: cycle.now,
            left_target: false,
            low: cycle.now,
            rose: cycle.now,
            passing: false,
            halt_seen_over: None,
            follows: false,
            by_room: false,
            after_unseen: false,
            doubted: false,
            stood: None,
            begun_at: begin,
            gave_way: false,
            left_place: None,
            lingering: Lingering::default(),
            resting: None,
            unreached: ShownFor::NOT,
            runs_on: ShownFor::NOT,
            runs_from: None,
            arrived: None,
            side: 0,
            may_lead_round: false,
            leads_round: false,
            way: 0,
            crossed: false,
            remaining: 0,
            approaching: false,
            before: begin,
            fastest: 0,
            near: false,
            unseen: u32::MAX,
            seen_there: false,
            early,
            was_there: false,
            rested: false,
            astray: 0,
            away: None,
            farthest: 0,
            length: 0,
            resumed: false,
        };
        let lag = far_behind.then(|| raised.lag(cycle));
        monitor.is_loose = monitor.is_loose_on(lag, cycle);
        monitor.becomes_active(cycle, begin, stands);
        // The way since bit 4 rose is not that of one cycle.
        monitor.before = cycle.sample.position;
        monitor.may_lead_round =
            monitor.turns && monitor.swings && monitor.remaining <= raised.lag(cycle);
        // On a modulo axis, and where it began beside its end, a place beyond that does not show that it was there.
        monitor.early |= monitor.ends_in_motion
            && (monitor.turns || monitor.short)
            && !cycle.is_within_window_of(Some(begin));
        monitor
    }

    /// Whether what is known of where it counts from may be beside that. Behind another, only where that is over already, for all that
    /// is known: further from its end than it may lag it is not. `lag`: that, behind one that nothing shows to be over.
    fn is_loose_on(&self, lag: Option<u32>, cycle: &Cycle<'_>) -> bool {
        let Some(way) = self.distance else {
            return false;
        };
        let known = cycle.traits.relative_base == RelativeBase::PreviousTarget
            || lag.is_some_and(|lag| !self.bases.are_near(lag.max(lag_of(way)), cycle.bounds));
        self.end.is_none() || !known
    }

    /// Whether it may end beside the place that its end was reckoned for.
    pub const fn may_end_beside(&self) -> bool {
        self.is_loose || self.is_vague
    }

    /// Of a distance whose end is not known, what one behind it counts from.
    pub fn bases_behind(&self, bounds: &Bounds) -> Option<Bases> {
        let distance = self.distance.filter(|_| self.end.is_none())?;
        Some(self.bases.after(distance, bounds))
    }

    /// Whether this distance may have to go round for one that it replaces: that led round, or was an absolute one of a modulo axis, and
    /// has not moved the axis yet.
    fn may_go_round_for(&self, replaced: &Self, cycle: &Cycle<'_>) -> bool {
        let goes = replaced.absolute && !cycle.is_within_window_of(replaced.end);
        let waits = goes && cycle.is_within_window_of(Some(replaced.begun_at));
        self.turns && self.distance.is_some() && (replaced.leads_round || waits)
    }

    /// How far it came, should it not end well.
    pub const fn delivery(&self) -> Delivery {
        if self.confirmed {
            Delivery::Accepted
        } else {
            Delivery::Unknown
        }
    }

    /// It is the active one from now on.
    fn becomes_active(&mut self, cycle: &Cycle<'_>, position: i32, stands: bool) {
        self.since = cycle.now;
        self.left_target = false;
        self.low = cycle.now;
        self.rose = cycle.now;
        self.passing = false;
        self.arrived = None;
        self.unlimited = false;
        self.limited = false;
        self.near = false;
        self.unseen = u32::MAX;
        self.seen_there = false;
        self.fastest = 0;
        self.before = position;
        self.begun_at = position;
        self.stood = (self.from_rest && stands).then_some(position);
        self.left_place = None;
        self.lingering = Lingering::default();
        self.resting = None;
        self.unreached = ShownFor::NOT;
        (self.runs_on, self.runs_from) = (ShownFor::NOT, None);
        self.turn(position, cycle.bounds);
        let far = |way: i32| is_far(way, cycle.bounds);
        self.leads_round = self.turns && self.distance.is_some_and(far);
    }

    /// It is the active one from now on, in place of `before`. Where that was seen at its end, this one's way began there, however far
    /// the axis has come on it meanwhile. `by_room`: by bit 12 alone. `rests`: the axis
    /// stands, and may not have come on it at all.
    pub fn takes_over(&mut self, before: &Self, by_room: bool, rests: bool, cycle: &Cycle<'_>) {
        let position = cycle.sample.position;
        let unseen = self.unseen;
        let (near, arrived) = (self.near, self.arrived);
        if self.early {
            // Bit 12 that stays high for longer shows when the drive goes on.
            let at_once = cycle.now.saturating_sub(self.since)
                <= cycle.traits.surely_seen().saturating_mul(AT_ONCE);
            // One that ends in motion has gone on since.
            self.early = by_room && (at_once || self.ends_in_motion);
        }
        self.becomes_active(cycle, position, cycle.standstill.is_standing());
        // Elsewhere than at the end of the one before the axis has been led on.
        self.leads_round &= cycle.is_within_window_of(before.end);
        let from_rest = self.from_rest || rests;
        if rests {
            self.stood = Some(position);
        }
        // What was not seen may have been its whole way, and as fast as the one before.
        self.unseen = unseen;
        self.fastest = before.fastest;
        (self.near, self.arrived) = (near, arrived);
        if before.end_seen(cycle) == EndSeen::There {
            self.begins_at_end_of(before, from_rest, cycle);
        }
        self.follows = true;
        self.by_room = by_room;
        self.swings = false;
        // What is left of a way whose end is not known is no motion of this one.
        self.doubted |= by_room && before.end.is_none() && self.end.is_some();
    }

    /// Its way began at the end of `before`, where the axis was seen.
    fn begins_at_end_of(&mut self, before: &Self, from_rest: bool, cycle: &Cycle<'_>) {
        let Some(begin) = before.end else { return };
        self.begins_beside = before.may_end_beside();
        // What is left of the way to where that has ended is no motion of this one.
        if !self.begins_beside {
            self.stood = from_rest.then_some(begin);
        }
        self.left_place = None;
        self.turn(begin, cycle.bounds);
        self.remaining = self
            .end
            .map_or(0, |end| cycle.bounds.distance(end, cycle.sample.position));
    }

    /// The axis has come to the end of the one before only now: the way there was not this one's.
    pub fn came_to_end_of(&mut self, before: &Self, cycle: &Cycle<'_>) {
        if before.end_seen(cycle) == EndSeen::There && self.stood.is_some() {
            self.begins_at_end_of(before, true, cycle);
        }
    }

    /// The one before it has ended, and nothing has shown that the drive had begun it. `unproven`: nor that it has ended.
    pub const fn comes_after_doubt(&mut self, unproven: bool) {
        self.follows = true;
        self.after_unseen = true;
        self.doubted = unproven;
    }

    /// The one before it has ended elsewhere than at its end: where a distance of which nobody knows the base began is not known.
    fn comes_after_error(&mut self) {
        self.begins_beside |= self.distance.is_some() && self.end.is_none();
    }

    /// Whether the drive holds none before it: where nothing has shown that it had begun the one before, this one has led the axis on.
    pub fn is_surely_first(&self, cycle: &Cycle<'_>) -> bool {
        !self.after_unseen || self.has_begun(cycle)
    }

    /// Whether anything but the position of its end has shown that the drive has begun it: it has moved the axis, or bit 10 was low for it.
    pub fn has_begun(&self, cycle: &Cycle<'_>) -> bool {
        let gone = |stood| cycle.bounds.distance(stood, cycle.sample.position);
        let moved = match self.stood {
            Some(stood) => gone(stood) > cycle.bounds.position,
            // Begun at rest, with an axis that was not there yet, its motion may be of the one before. So may that on a short way where bit 12
            // alone has shown that its turn has come, and any behind one that the drive may hold.
            // So may that of one that has replaced another close to its end, and now stands.
            None => {
                let rests = !self.follows && cycle.standstill.is_standing();
                let short = self.short && (self.by_room || rests);
                !(self.from_rest || self.doubted || short)
            }
        };
        moved || (self.left_target && !self.follows)
    }

    /// It goes on after a halt: what bit 10 showed before is of no meaning for it.
    pub fn goes_on(&mut self, now: Duration, from_rest: bool, active: bool) {
        self.since = now;
        self.left_target = false;
        self.low = now;
        self.rose = now;
        self.halt_seen_over = Some(Duration::MAX);
        self.halt_told = false;
        // How one behind it begins does not change.
        if active {
            self.from_rest = from_rest;
            self.overshoots = !from_rest;
        }
        self.left_place = None;
        self.lingering = Lingering::default();
        self.resting = None;
        self.unreached = ShownFor::NOT;
        (self.runs_on, self.runs_from) = (ShownFor::NOT, None);
        // The halt may have carried the axis past the end, to which the drive goes back.
        self.arrived = None;
        self.resumed |= active;
    }

    /// Lets go of what makes no difference any more.
    pub fn canonicalize(&mut self, now: Duration, begin: Duration, settle: Duration) {
        no_older(&mut self.since, now, begin.max(settle));
        no_older(&mut self.low, now, settle);
        no_older(&mut self.rose, now, settle);
        self.passing &= now.saturating_sub(self.rose) < settle;
        self.lingering.span.canonicalize(now, begin);
        self.unreached.canonicalize(now, begin);
        self.runs_on.canonicalize(now, begin.max(settle));
        if let Some(since) = &mut self.resting {
            no_older(since, now, begin);
        }
        if let Some(since) = &mut self.left_place {
            no_older(since, now, settle);
        }
        if let Some((since, cycles)) = &mut self.away {
            no_older(since, now, settle);
            *cycles = (*cycles).min(AWAY_CYCLES);
        }
    }

    /// Takes in bit 11 of a cycle in which it is surely the active one.
    #[inline(always)]
    pub fn note_limit(&mut self, statusword: Statusword) {
        let limited = statusword.contains(Statusword::INTERNAL_LIMIT);
        self.unlimited |= !limited;
        self.limited = limited;
    }

    /// Takes in one fresh cycle. `alone`: no other set-point can have taken over.
    pub fn note(&mut self, cycle: &Cycle<'_>, alone: bool) {
        self.follow(cycle.now, cycle.sample, cycle.blind, alone, cycle.bounds);
        if self.halt_seen_over.is_some() {
            self.note_end_of_halt(cycle);
        }
    }

    /// Whether [`follow`](Self::follow) is all of [`note`](Self::note).
    pub const fn allows_idle_path(&self) -> bool {
        self.halt_seen_over.is_none()
    }

    /// As [`note`](Self::note), with nothing but what every cycle needs: `blind` cycles without inputs were before it. Whether the axis is
    /// within the window around its end.
    #[inline(always)]
    pub fn follow(
        &mut self,
        now: Duration,
        sample: &Sample,
        blind: u32,
        alone: bool,
        bounds: &Bounds,
    ) -> bool {
        if !sample.statusword.contains(Statusword::TARGET_REACHED) {
            self.left_target |= self.halt_seen_over.is_none();
            self.low = now;
        } else if self.rose < self.low {
            self.note_rise(now, sample.position, bounds);
        }
        let position = sample.position;
        let resumed = core::mem::take(&mut self.resumed);
        if resumed {
            self.before = position;
            self.begun_at = position;
            self.stood = self.from_rest.then_some(position);
        }
        let Some(end) = self.end else {
            self.before = position;
            return false;
        };
        if resumed || (self.far && !self.is_far(position, bounds)) {
            self.turn(position, bounds);
        }
        let remaining = bounds.distance(end, position);
        self.look_between(position, remaining, blind, bounds);
        if self.turns {
            self.look_for_crossing(end, position, bounds);
        }
        self.approaching |= remaining < self.remaining;
        let before = core::mem::replace(&mut self.remaining, remaining);
        if remaining <= bounds.position {
            if alone && before > bounds.position {
                self.unreached = ShownFor::NOT;
            }
            self.note_arrival(end, position, remaining, bounds);
            return true;
        }
        if alone && !self.from_rest && (self.passed(position) || self.arrived.is_some()) {
            // It was replaced too fast to stop at its end: it has overshot, and comes back.
            self.arrived = None;
            self.turn(position, bounds);
            self.seen_there = true;
        }
        false
    }

    /// Bit 10 has risen, with the axis at this position.
    #[inline(never)]
    fn note_rise(&mut self, now: Duration, position: i32, bounds: &Bounds) {
        self.rose = now;
        self.passing = bounds.distance(self.before, position) > bounds.position;
    }

    /// The nearest that was seen: a later position may be on the way to the next end already.
    #[inline(always)]
    fn note_arrival(&mut self, end: i32, position: i32, remaining: u32, bounds: &Bounds) {
        let nearer = self
            .arrived
            .is_none_or(|before| bounds.distance(end, before) >= remaining);
        self.arrived = if nearer { Some(position) } else { self.arrived };
    }

    /// Bit 8 has fallen: from when on bit 10 is that of the set-point.
    fn note_end_of_halt(&mut self, cycle: &Cycle<'_>) {
        self.halt_seen_over = match self.halt_seen_over {
            Some(Duration::MAX) if cycle.delivered => {
                Some(cycle.now.saturating_add(cycle.traits.surely_seen()))
            }
            Some(over) if cycle.now >= over => None,
            waits => waits,
        };
    }

    /// Whether the way since the last cycle is long enough to have led to the end. After cycles without inputs it also says how fast the
    /// axis would have had to be to have been there.
    #[inline(always)]
    fn look_between(&mut self, position: i32, remaining: u32, blind: u32, bounds: &Bounds) {
        let way = bounds.distance(self.before, position);
        self.before = position;
        if blind == 0 {
            self.fastest = self.fastest.max(way);
            self.note_near(way, remaining, bounds);
        } else {
            self.note_unseen(self.remaining, remaining, blind);
        }
    }

    /// Takes in the way of one cycle.
    #[inline(always)]
    const fn note_near(&mut self, way: u32, remaining: u32, bounds: &Bounds) {
        // What goes no further than the window in a cycle is seen in it, if it comes there.
        let far = if way > bounds.position { way } else { 0 };
        self.near |= remaining <= far.saturating_add(bounds.position);
    }

    /// Of a modulo axis, whether it has crossed its end since the last cycle.
    #[inline(never)]
    fn look_for_crossing(&mut self, end: i32, position: i32, bounds: &Bounds) {
        let Some(turn) = bounds.turn_length() else {
            return;
        };
        self.leads_round &= bounds.is_within_window(self.begun_at, position);
        // The way changes its sign on the far side as well; only near the end that is a crossing of it.
        let way = bounds.way(position, end);
        let near = way.abs() < turn / 4 && self.way.abs() < turn / 4;
        self.crossed |= near && way.signum() == -self.way.signum() && way != 0;
        self.way = way;
    }

    fn note_unseen(&mut self, before: u32, after: u32, blind: u32) {
        let there_and_back = before.saturating_add(after);
        self.unseen = self.unseen.min(there_and_back / blind.saturating_add(1));
    }

    /// Takes in a cycle as the one behind `first`, before that does: what was not seen may be of this one, too.
    pub fn note_behind(&mut self, first: &Self, cycle: &Cycle<'_>) {
        let Some(end) = self.end else { return };
        let remaining = |position| cycle.bounds.distance(end, position);
        let after = remaining(cycle.sample.position);
        if cycle.blind != 0 {
            self.note_unseen(remaining(first.before), after, cycle.blind);
        }
        if after <= cycle.bounds.position {
            self.early = true;
        } else if self.ends_in_motion {
            // At its end velocity it is nowhere for long.
            let way = cycle.bounds.distance(first.before, cycle.sample.position);
            self.early |= after <= way;
        }
    }

    /// What was seen of the axis at the end.
    pub fn end_seen(&self, cycle: &Cycle<'_>) -> EndSeen {
        let position = cycle.sample.position;
        let Some(end) = self.end else {
            return EndSeen::There;
        };
        let shown = if self.unlimited || !cycle.bit_11_is_valid {
            self.came_to_end(position)
        } else {
            cycle.bounds.is_within_window(end, position)
        };
        // The fastest that was seen need not be the fastest that there was.
        let fastest = self.fastest.max(cycle.bounds.position).saturating_mul(4);
        let blind = self.unseen <= fastest;
        // Of neither, no cycle is known to have been its own.
        let limit_unseen = cycle.bit_11_is_valid && !self.unlimited && !self.limited;
        match shown {
            true if self.gave_way => EndSeen::Unseen,
            true => EndSeen::There,
            false if blind || limit_unseen || self.early => EndSeen::Unseen,
            false => EndSeen::Elsewhere,
        }
    }

    /// Whether the drive may be at the one behind it already: the axis was seen at its end, however far it has swung from there since.
    pub fn may_be_over(&self, cycle: &Cycle<'_>) -> bool {
        self.end.is_none() || self.came_to_end(cycle.sample.position)
    }

    /// Whether the drive shows itself done with it, by a bit 10 that was low for it, and the axis has not left where it stood.
    fn gives_way(&self, cycle: &Cycle<'_>) -> bool {
        let own = self.left_target && !self.follows;
        own && cycle.is_reached()
            && cycle.is_within_window_of(self.stood)
            && !cycle.is_within_window_of(self.end)
    }

    fn came_to_end(&self, position: i32) -> bool {
        self.near || self.arrived.is_some() || self.seen_there || self.passed(position)
    }

    /// Whether the axis was seen at the end; of a distance whose end is not known, whether it has gone at all.
    pub fn is_seen_at_end(&self, cycle: &Cycle<'_>) -> bool {
        self.end_seen(cycle) == EndSeen::There && !self.has_not_left(cycle)
    }

    /// Whether a distance whose end is not known has not led the axis away from where it stood, or was. A short one need not, unless the one
    /// before it has ended in an error.
    fn has_not_left(&self, cycle: &Cycle<'_>) -> bool {
        let far = |way: i32| is_far(way, cycle.bounds);
        self.end.is_none()
            && (self.begins_beside || self.distance.is_some_and(far))
            && (cycle.is_within_window_of(self.stood)
                || cycle.is_within_window_of(Some(self.begun_at)))
    }

    /// Whether a set-point that stops at this one's end may be queued behind it: the position will show without doubt
    /// when that has taken over.
    pub const fn shows_its_stop(&self) -> bool {
        self.shows_its_end() && self.from_rest
    }

    /// Whether a set-point may be blended onto this one: the position will show when the end is passed.
    pub const fn shows_its_passing(&self) -> bool {
        self.shows_its_end() && (self.from_rest || self.approaching)
    }

    /// Whether a position beyond its end means that the axis was there.
    const fn shows_its_end(&self) -> bool {
        self.end.is_some() && !self.turns && !self.far && !self.short && self.unlimited
    }

    /// Whether the position shows that it has ended and `next` is under way. Neither being at the end is enough, for the drive may
    /// still be finishing this one, nor being past it, for the axis may be ahead of its demand and come back. It has to be well on
    /// the way to the next end: half of that, and half as far as this one's own way was, or away from the window for the settle time.
    /// Or it has to leave after it has stood. One that may come back to its end is not over beyond it.
    pub fn is_left_behind(&mut self, next: &Self, cycle: &Cycle<'_>) -> bool {
        let (Some(end), Some(goal)) = (self.end, next.goal) else {
            return false;
        };
        let position = cycle.sample.position;
        let window = i64::from(cycle.bounds.position);
        // A way of more than half the number circle does not show its direction.
        let Some(way) = goal.checked_sub(end).map(i64::from) else {
            return false;
        };
        if self.short || self.turns || self.far || way.abs() <= 3 * window {
            return false;
        }
        let passed = self.passed(position);
        self.was_there |= passed || self.arrived.is_some();
        self.seen_there |= self.was_there;
        let beyond = i64::from(position.wrapping_sub(end));
        let gone = if way.is_negative() { -beyond } else { beyond };
        if gone <= window {
            self.rested |= gone >= -window && self.is_steady(cycle);
            self.astray = if self.was_there {
                self.astray.max(-gone)
            } else {
                0
            };
            self.away = None;
            return false;
        }
        let (since, cycles) = self.away.unwrap_or((cycle.now, 0));
        let cycles = cycles.saturating_add(1);
        self.away = Some((since, cycles));
        // With one behind it that it is not blended into, a drive may take back the end velocity too late to stop there, and come back.
        let stops_late = self.ends_in_motion && next.buffer_mode != BufferMode::Blending;
        if !self.was_there || ((self.overshoots || stops_late) && passed) {
            return false;
        }
        // One that comes back is not on its way.
        let goes_on = gone >= self.farthest;
        self.farthest = self.farthest.max(gone);
        let half = way.abs() / 2;
        // One that stands there may have been stopped on its way back.
        let stayed = cycle.now.saturating_sub(since) >= cycle.bounds.settle
            && cycles >= AWAY_CYCLES
            && !cycle.standstill.is_standing();
        // One that swung when it set off may swing as far.
        let goes = gone >= i64::from(self.length / 2) && !self.swings;
        let far = gone >= half && (goes || stayed);
        let leaves = self.rested && gone >= half.min(3 * window);
        // Beyond the next end, too, it may have been stopped by an input of the drive before it comes to either.
        let before_next = gone <= way.abs() + window;
        (far || leaves) && goes_on && gone > self.astray && before_next
    }

    /// Whether both this one and `next`, which ends in motion, are over with the axis in motion: bit 10 has risen, and the axis goes on
    /// away from both ends for the settle time.
    #[inline(never)]
    pub fn has_run_on(&mut self, next: &Self, cycle: &Cycle<'_>) -> bool {
        let position = cycle.sample.position;
        let far = cycle.bounds.position.saturating_mul(3);
        let away = |end: i32| cycle.bounds.distance(end, position) > far;
        let beyond = self.end.is_some_and(away) && next.goal.is_none_or(away);
        let runs = cycle.is_reached() && beyond;
        let from = runs.then(|| self.runs_from.unwrap_or(position));
        self.runs_from = from;
        let gone = from.map_or(0, |from| cycle.bounds.distance(from, position));
        // One that was not seen at this end may lag behind its demand, which rests there. A bit 10 that was not low may be from before.
        let time = if self.left_target && self.came_to_end(position) {
            cycle.bounds.settle
        } else {
            cycle.begin
        };
        self.runs_on.update(cycle.now, runs, time) && gone > cycle.bounds.position
    }

    /// The axis has gone through its end, and through that of the one before it.
    pub const fn ran_on(&mut self) {
        self.left_target = true;
        self.seen_there = true;
    }

    /// Whether both this one and `next` are over, with the axis at rest. It has been under way, or had no way to go, and has stood with
    /// bit 10 for the settle time at the end of the next one. Elsewhere it has to stand for as long as that may take to begin.
    pub fn rests_with(&mut self, next: &Self, cycle: &Cycle<'_>) -> Option<Rest> {
        let reached = cycle.is_reached();
        if reached {
            self.note_place(cycle);
        }
        let steady = || {
            let standstill = cycle.standstill;
            standstill.steady_since(cycle.now, next.since.max(self.low), cycle.bounds)
        };
        if !(reached && (steady() || self.lingering.update(cycle))) {
            self.resting = None;
            let unreached = !reached && self.stands_unreached(next.end, cycle);
            return unreached.then_some(Rest::Unreached);
        }
        let resting = *self.resting.get_or_insert(cycle.now);
        let position = cycle.sample.position;
        let left = self.left_target && !self.after_unseen;
        let moved = self.has_left_place(cycle)
            && self.rests_away(cycle)
            && (!self.after_unseen
                || self
                    .stood
                    .is_some_and(|stood| self.leads_from(stood, cycle)));
        // What is left of the motion before leads there as well, on a short way or where the axis had not come to that end.
        let own = !self.by_room || (!self.short && self.stood.is_some());
        let was_there = own && self.end.is_some() && self.end_seen(cycle) == EndSeen::There;
        let gone = (moved || was_there) && !self.doubted;
        let proven = left || gone;
        let begun = proven || self.has_no_way(cycle);
        // A distance from nobody knows where seems to end wherever the axis waits for the one before it.
        let over = cycle.is_within_window_of(next.end)
            || (proven && !cycle.is_limited() && next.may_end_at(position, cycle.bounds));
        // Where bit 12 shows a full buffer, the drive holds both.
        let holds_both = cycle.bit_12_shows_room() && cycle.is_acknowledging();
        if begun && over && !holds_both {
            return Some(Rest::BothOver);
        }
        let begun = begun && (self.end.is_some() || self.may_end_at(position, cycle.bounds));
        let late = cycle.now.saturating_sub(resting) >= cycle.begin;
        late.then_some(if begun {
            Rest::NextNotBegun
        } else {
            Rest::NoneBegun
        })
    }

    /// Whether the axis has stood with bit 10 for the settle time: nothing that the drive holds is under way.
    pub fn is_at_rest(&mut self, cycle: &Cycle<'_>) -> bool {
        cycle.is_reached() && (self.is_settled(cycle) || self.lingering.update(cycle))
    }

    /// Whether the axis has stood since bit 10 was low last. Before that it may have been about to set off.
    fn is_settled(&self, cycle: &Cycle<'_>) -> bool {
        let since = self.since.max(self.low);
        cycle
            .standstill
            .steady_since(cycle.now, since, cycle.bounds)
    }

    /// Takes in where the axis is, with bit 10 high.
    fn note_place(&mut self, cycle: &Cycle<'_>) {
        if self.left_place.is_none() && self.has_left_place(cycle) {
            self.left_place = Some(cycle.now);
        }
    }

    fn has_left_place(&self, cycle: &Cycle<'_>) -> bool {
        self.stood.is_some() && !cycle.is_within_window_of(self.stood)
    }

    /// Whether it may have led the axis from `stood` to where that is: away from an absolute target leads a load alone, or one before it.
    fn leads_from(&self, stood: i32, cycle: &Cycle<'_>) -> bool {
        let apart = |from| self.end.map(|end| cycle.bounds.distance(end, from));
        self.distance.is_some() || apart(cycle.sample.position) < apart(stood)
    }

    /// Whether the axis has come to rest since it left the place where it stood: what stayed around it before was still that.
    fn rests_away(&self, cycle: &Cycle<'_>) -> bool {
        let standstill = cycle.standstill;
        self.left_place
            .is_some_and(|left| standstill.steady_since(cycle.now, left, cycle.bounds))
    }

    fn is_steady(&self, cycle: &Cycle<'_>) -> bool {
        cycle
            .standstill
            .steady_since(cycle.now, self.since, cycle.bounds)
    }

    /// Whether the drive has shown a limit in the last cycle in which it was surely at this distance, at a place to which that does not lead.
    fn is_stopped_short(&self, cycle: &Cycle<'_>) -> bool {
        let limited = self.limited && cycle.bit_11_is_valid;
        limited && !self.may_end_at(cycle.sample.position, cycle.bounds)
    }

    /// How it ended, with one that was started as `next` taking over.
    pub fn ended_into(&self, next: BufferMode, cycle: &Cycle<'_>) -> Result<Completion, Failure> {
        let position = cycle.sample.position;
        match (self.end, self.end_seen(cycle)) {
            (Some(target), EndSeen::Elsewhere) => Err(self.missed(target, position)),
            (Some(target), EndSeen::Unseen) => Err(Failure::Unseen {
                target,
                actual: position,
            }),
            (None, _) if self.has_not_left(cycle) || self.is_stopped_short(cycle) => {
                Err(Failure::EndNotKnown { actual: position })
            }
            _ if next == BufferMode::Blending => Ok(Completion::Passed { position }),
            // Between two cycles it was at its end; the nearest that was seen is the better word.
            _ => Ok(Completion::Reached {
                position: self.arrived.unwrap_or(position),
            }),
        }
    }

    /// With bit 10 low: whether the axis has stood for so long at its end, or at the end of the one behind it, that the drive will hardly
    /// show that. A drive that has paused the move elsewhere may go on at any time.
    #[inline]
    fn stands_unreached(&mut self, behind: Option<i32>, cycle: &Cycle<'_>) -> bool {
        if cycle.standstill.is_standing() {
            return self.rests_unreached(behind, cycle);
        }
        self.unreached = ShownFor::NOT;
        false
    }

    #[inline(never)]
    fn rests_unreached(&mut self, behind: Option<i32>, cycle: &Cycle<'_>) -> bool {
        let at_end = cycle.is_within_window_of(self.end) || cycle.is_within_window_of(behind);
        self.unreached.update(cycle.now, at_end, cycle.begin)
    }

    /// What is said of it then. The drive may hold it still.
    pub fn unreached(&self, cycle: &Cycle<'_>) -> Failure {
        cycle.timeout(WaitingFor::TargetReached, self.delivery())
    }

    /// When and how it ended, as the last set-point.
    #[inline(always)]
    pub fn outcome(&mut self, cycle: &Cycle<'_>) -> Option<Result<Completion, Failure>> {
        if !cycle.is_reached() {
            if self.doubted {
                self.resting = None;
            }
            self.runs_on = ShownFor::NOT;
            let unreached = self.stands_unreached(None, cycle);
            return unreached.then(|| Err(self.unreached(cycle)));
        }
        self.end_shown(cycle)
    }

    /// With bit 10 high: a bit 10 that was never seen low since then may be that of the set-point or halt before. Then the axis has to
    /// have come to rest elsewhere than where it stood, or it has no way to go; else the set-point has not begun.
    #[inline(never)]
    fn end_shown(&mut self, cycle: &Cycle<'_>) -> Option<Result<Completion, Failure>> {
        let position = cycle.sample.position;
        let window = cycle.bounds.position;
        self.note_place(cycle);
        // It may be wrong for one of the drive's cycles. When that shows, an axis at speed is elsewhere.
        if (self.passing || self.may_lead_round) && !cycle.is_seen(self.rose) {
            return None;
        }
        let reached = Some(Ok(Completion::Reached { position }));
        let within = cycle.is_within_window_of(self.end);
        let may_end_here = !cycle.is_limited() && self.may_end_at(position, cycle.bounds);
        // Where the one before it has led, or leads, a distance seems to end, too.
        let certain = self.end.is_some() || !self.doubted;
        if self.left_target && (within || (may_end_here && certain)) {
            return reached;
        }
        if self.ends_in_motion && self.has_passed_end(cycle) {
            let position = self.arrived.unwrap_or(position);
            return Some(match self.end {
                Some(_) => Ok(Completion::Reached { position }),
                None => Err(Failure::EndNotKnown { actual: position }),
            });
        }
        // It goes on at its end velocity, and was at no end that is known.
        if self.ends_in_motion {
            let runs = !cycle.standstill.is_standing();
            if self.runs_on.update(cycle.now, runs, cycle.begin) {
                let actual = position;
                return Some(Err(match self.end {
                    Some(target) => Failure::Unseen { target, actual },
                    None => Failure::EndNotKnown { actual },
                }));
            }
        }
        let steady = self.is_settled(cycle);
        let lingers = !steady && self.lingering.update(cycle);
        if !(steady || lingers) {
            self.resting = None;
            return None;
        }
        let over = within && self.surely_ends_at(position, cycle.bounds);
        if over || (self.end.is_none() && certain && self.has_no_way(cycle)) {
            return reached;
        }
        let stood = *self.stood.get_or_insert(position);
        let slack = if lingers { self.lingering.width() } else { 0 };
        let gone = cycle.bounds.distance(stood, position);
        let since = if self.doubted {
            *self.resting.get_or_insert(cycle.now)
        } else {
            self.since
        };
        let late = cycle.now.saturating_sub(since) >= cycle.begin;
        let rests = lingers || self.rests_away(cycle);
        let leads = self.leads_from(stood, cycle);
        let moved =
            gone > window.saturating_add(slack) && leads && rests && (!self.doubted || late);
        if moved || (self.left_target && !self.follows) {
            return match self.end {
                _ if may_end_here => reached,
                Some(target) => Some(Err(self.missed(target, position))),
                None => Some(Err(Failure::EndNotKnown { actual: position })),
            };
        }
        late.then_some(Err(match self.end {
            // So long after bit 10 was low, it was low for this one.
            Some(target) if self.begins_beside && self.left_target => self.missed(target, position),
            _ => Failure::NotBegun { actual: position },
        }))
    }

    /// With bit 10 high for it: whether the axis has been at its end, from where it goes on. A bit 10 that is never low is that of the
    /// end at last: the way there took no cycle.
    fn has_passed_end(&self, cycle: &Cycle<'_>) -> bool {
        let late = cycle.now.saturating_sub(self.since) >= cycle.begin;
        let moved = self.stood.is_some() && self.has_begun(cycle);
        let begun = self.left_target || late || (moved && !self.may_overshoot(cycle));
        let there = match self.end {
            Some(_) => self.came_to_end(cycle.sample.position),
            None => !self.doubted,
        };
        begun && there
    }

    /// Whether the axis may be past this end by its overshoot from the one before alone. Then it comes back.
    fn may_overshoot(&self, cycle: &Cycle<'_>) -> bool {
        let since = cycle.now.saturating_sub(self.since);
        self.by_room && (since < cycle.bounds.settle || !self.passed(cycle.sample.position))
    }

    /// Whether this distance may lead to this position, from a place beside the one that its end was reckoned from, or where that is not
    /// known.
    pub fn may_end_at(&self, position: i32, bounds: &Bounds) -> bool {
        let Some(way) = self.distance.filter(|_| self.is_loose) else {
            return false;
        };
        match (self.end, self.goal) {
            // It goes on from beside the end before it, by no more than what the axis lags behind.
            (None, Some(goal)) => bounds.distance(goal, position) <= lag_of(way),
            _ => self.bases.lead_to(position, way, bounds),
        }
    }

    /// Whether it ends at this position, near which its end is, wherever a distance counts from. With a drive that may count from elsewhere it
    /// may have its way still to go.
    fn surely_ends_at(&self, position: i32, bounds: &Bounds) -> bool {
        let way = self.distance.filter(|_| self.is_loose);
        // Of an axis that swung when it was sent, its place alone does not say where the demand was.
        let known = self.stood_before || self.bases.previous.is_some();
        // What the one before has led beside its end is no way of a distance behind it.
        let from_there = self.begins_beside && self.distance.is_some();
        !from_there
            && !self.leads_round
            && way.is_none_or(|way| known && self.bases.all_lead_to(position, way, bounds))
    }

    /// Whether it had no way to go when it was begun. A distance of which nobody knows from where it counts has none only where the last
    /// set-point has ended, or the axis was enabled. What it has replaced, a jog or a target that was missed may have left its base
    /// anywhere.
    fn has_no_way(&self, cycle: &Cycle<'_>) -> bool {
        let window = cycle.bounds.position;
        let short = |way: i32| way.unsigned_abs() <= window;
        match self.end {
            Some(_) => {
                self.remaining <= window && self.surely_ends_at(cycle.sample.position, cycle.bounds)
            }
            None => self.at_base && self.distance.is_some_and(short),
        }
    }

    /// It is over, and the axis is elsewhere.
    const fn missed(&self, target: i32, actual: i32) -> Failure {
        if self.is_vague || (self.is_loose && !self.stood_before) {
            Failure::EndNotKnown { actual }
        } else if self.early && self.ends_in_motion {
            Failure::Unseen { target, actual }
        } else if self.confirmed {
            Failure::MissedTarget { target, actual }
        } else {
            Failure::Unconfirmed { target, actual }
        }
    }

    fn turn(&mut self, position: i32, bounds: &Bounds) {
        (self.way, self.remaining) = match self.end {
            Some(end) => (bounds.way(position, end), bounds.distance(end, position)),
            None => (0, 0),
        };
        self.side = self.way.signum();
        self.crossed = false;
        self.approaching = false;
        self.length = self.remaining;
        self.was_there = false;
        self.rested = false;
        self.astray = 0;
        self.away = None;
        self.farthest = 0;
        self.far = self.is_far(position, bounds);
        self.short = self.remaining <= bounds.position.saturating_mul(3);
    }

    fn is_far(&self, position: i32, bounds: &Bounds) -> bool {
        let linear = |end: i32| i64::from(end) - i64::from(position);
        self.absolute
            && !self.turns
            && self
                .end
                .is_some_and(|end| bounds.way(position, end) != linear(end))
    }

    #[inline]
    fn passed(&self, position: i32) -> bool {
        if self.turns {
            return self.crossed;
        }
        if self.far {
            return false;
        }
        let way = |end: i32| i64::from(end.wrapping_sub(position));
        self.side != 0 && self.end.is_some_and(|end| way(end).signum() == -self.side)
    }
}

// One cycle as the machines of the modes see it.

/// What the sequencer needs to know of a cycle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cycle<'a> {
    pub now: Duration,
    pub sample: &'a Sample,
    pub standstill: &'a Standstill,
    pub bounds: &'a Bounds,
    pub last_seen: &'a LastSeen,
    pub traits: &'a Traits,
    pub limits: &'a Limits,
    pub referenced: bool,
    /// Whether the outputs of this cycle are known to have been delivered.
    pub delivered: bool,
    pub halted: bool,
    /// How many cycles before this one brought no inputs.
    pub blind: u32,
    /// How many cycles, by the clock, the host has stood still before this one.
    pub stalled: u32,
    /// Whether bit 11 (internal limit active) was ever seen low in Operation enabled: of a drive that shows it always it says
    /// nothing.
    pub bit_11_is_valid: bool,
    /// Deadline of each wait for bit 12.
    pub acknowledge: Duration,
    /// How long a set-point may take to show that it has begun.
    pub begin: Duration,
    /// The word sent with this cycle, for errors.
    pub controlword: Controlword,
}

impl Cycle<'_> {
    /// The same, blind for as long as the host has stood still too.
    fn with_stall(&self) -> Self {
        Self {
            blind: self.blind.max(self.stalled),
            ..*self
        }
    }

    /// A wait for standstill, with what was seen instead.
    pub fn standstill(&self) -> WaitingFor {
        WaitingFor::Standstill(self.last_seen.unrest(self.bounds))
    }

    /// Whether the axis is within the window around this place, where it is known.
    fn is_within_window_of(&self, place: Option<i32>) -> bool {
        let position = self.sample.position;
        place.is_some_and(|place| self.bounds.is_within_window(place, position))
    }

    /// Bit 12.
    fn is_acknowledging(&self) -> bool {
        let statusword = self.sample.statusword;
        statusword.contains(Statusword::SET_POINT_ACKNOWLEDGE)
    }

    /// Bit 10.
    fn is_reached(&self) -> bool {
        self.sample.statusword.contains(Statusword::TARGET_REACHED)
    }

    /// Bit 11, of a drive that was seen without it.
    fn is_limited(&self) -> bool {
        self.bit_11_is_valid && (self.sample.statusword).contains(Statusword::INTERNAL_LIMIT)
    }

    /// Bit 9.
    fn is_remote(&self) -> bool {
        self.sample.statusword.contains(Statusword::REMOTE)
    }

    /// Whether bit 12 shows that the drive's buffer is full.
    fn bit_12_shows_room(&self) -> bool {
        self.traits.buffer_signal == BufferSignal::Acknowledge
    }

    /// Whether the drive has surely seen what was delivered at that time, and has shown more than one word since.
    #[inline]
    pub fn is_seen(&self, delivered: Duration) -> bool {
        self.now.saturating_sub(delivered) >= self.traits.surely_seen()
    }

    /// Whether the time for each wait for bit 12 is over.
    fn is_late(&self, since: Duration) -> bool {
        self.now.saturating_sub(since) >= self.acknowledge
    }

    const fn timeout(&self, waiting_for: WaitingFor, delivery: Delivery) -> Failure {
        Failure::Timeout {
            waiting_for,
            statusword: self.sample.statusword,
            controlword: self.controlword,
            delivery,
        }
    }
}

/// A time in the past, as one that lies back no farther than this: what lies further back makes no difference any more.
pub(crate) fn no_older(at: &mut Duration, now: Duration, than: Duration) {
    *at = (*at).max(now.saturating_sub(than));
}

#[cfg(test)]
#[path = "drive_buffer_tests.rs"]
mod drive_buffer_tests;
#[cfg(test)]
#[path = "monitor_tests.rs"]
mod monitor_tests;
#[cfg(test)]
#[path = "sequencer_tests.rs"]
mod tests;
