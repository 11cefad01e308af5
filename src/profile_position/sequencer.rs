//! The handshake of bits 4 and 12.
//!
//! Contract: the axis core calls [`Sequencer::step`] in every cycle with fresh inputs in Operation enabled with mode 1
//! shown, and not otherwise; it puts [`Sequencer::bits`] into the next controlword. Whatever ends the motion is reported by
//! [`Sequencer::fail_all`], after which bit 4 stays as it is until [`Sequencer::lower`].

use core::time::Duration;

use crate::ds402::{ModeBits, Sample};

use super::{
    Bounds, BufferMode, CommandId, Cycle, Delivery, Event, Events, Failure, MoveCommand,
    Parameters, Reference, WaitingFor,
    chain::{Chain, Next, Place, start_bits},
    no_older,
    track::{Bases, Track},
};

/// The sequencing of set-points towards one drive axis.
#[derive(Debug, Clone, Hash)]
pub(crate) struct Sequencer {
    bit4: Bit4,
    bits: ModeBits,
    ahead: Ahead,
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
    bit_9_is_valid: bool,
}

/// Whether the drive has seen the bits 5, 6 and 9 that are out while bit 4 is low.
#[derive(Debug, Clone, Copy, Hash)]
enum Ahead {
    /// They fell with bit 4, and are seen with its low.
    Fell,
    Changed,
    Delivered(Duration),
}

impl Sequencer {
    pub fn new(parameters: Parameters) -> Self {
        Self {
            bit4: Bit4::LOW,
            bits: ModeBits::NONE,
            ahead: Ahead::Fell,
            target: 0,
            parameters,
            waiting: Waiting::default(),
            chain: Chain::default(),
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

    /// Whether the last set-point was to end in motion.
    pub fn has_end_velocity(&self) -> bool {
        self.parameters
            .end_velocity
            .is_some_and(|velocity| velocity != 0)
    }

    /// The target follows the axis while no set-point can be active: whoever looks at it later finds no jump.
    pub const fn follow_position(&mut self, position: i32) {
        self.target = position;
    }

    /// The same in another mode, which may lead the axis anywhere.
    pub const fn follow_other_mode(&mut self, position: i32) {
        self.target = position;
        self.chain.leave_base();
    }

    /// Lets go of what makes no difference any more.
    pub fn let_go(
        &mut self,
        now: Duration,
        seen: Duration,
        acknowledge: Duration,
        begin: Duration,
        settle: Duration,
    ) {
        self.bit4.let_go(now, seen, acknowledge);
        if let Ahead::Delivered(at) = &mut self.ahead {
            no_older(at, now, seen);
        }
        self.waiting.let_go(now, acknowledge);
        self.chain.let_go(now, begin, settle);
        if let Some(raised) = &mut self.unconfirmed {
            raised.let_go(now, acknowledge);
        }
    }

    /// Lets go of what 607Ah and the parameters hold, before bit 4 rises again.
    pub fn let_go_of_target(&mut self) {
        self.target = 0;
        self.parameters = Parameters {
            end_velocity: self.parameters.end_velocity,
            profile_type: self.parameters.profile_type,
            ..Parameters::default()
        };
    }

    /// Whether the drive has a set-point or may have one.
    pub fn has_set_point(&self) -> bool {
        self.unknown
            || self.unconfirmed.is_some()
            || !self.chain.is_empty()
            || self.chain.is_unproven()
            || matches!(self.bit4, Bit4::High { sent: true, .. } | Bit4::Abandoned)
    }

    /// Whether a set-point may have been taken without an acknowledge: only a stop clears that.
    pub const fn is_unknown(&self) -> bool {
        self.unknown
    }

    /// Whether no move waits or is under way.
    pub fn is_idle(&self) -> bool {
        !self.has_set_point() && self.waiting.is_empty() && self.bit4.is_low()
    }

    /// Whether a cycle like the last one changes nothing but how far the one set-point has come that the drive may hold.
    /// `in_mode`: the drive is enabled and shows this mode.
    pub fn allows_idle_path(&self, in_mode: bool) -> bool {
        let low = match self.bit4 {
            Bit4::Low { delivered, .. } => delivered.is_some() || !in_mode,
            Bit4::High { .. } | Bit4::Abandoned => false,
        };
        low && self.waiting.is_empty()
            && self.unconfirmed.is_none()
            && !(self.unknown && self.holds_any())
            && self.armed.is_none()
            && self.chain.allows_idle_path()
    }

    /// Whether the drive holds a set-point that it has acknowledged.
    pub fn holds_any(&self) -> bool {
        !self.chain.is_empty()
    }

    /// One cycle of an axis on the idle path with a set-point under way: whether that may have ended. [`Sequencer::end`] reports it then.
    #[inline(always)]
    pub fn follow(&mut self, now: Duration, sample: &Sample, bounds: &Bounds) -> bool {
        self.chain.note_active(now, sample, bounds)
    }

    /// Whether the set-point under way ends with the cycle that [`Sequencer::follow`] has taken in.
    pub fn end(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
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
    pub fn last_profile_type(&self) -> Option<i16> {
        match self.waiting.last() {
            Some(request) => request.command.set_point.parameters.profile_type,
            None if self.is_idle() => None,
            None => self.parameters.profile_type,
        }
    }

    /// Takes a checked move in; refuses it when too many wait.
    pub fn submit(&mut self, id: CommandId, command: MoveCommand, events: &mut Events) {
        if !self.waiting.push(id, command) {
            events.push(id, Event::Done(Err(Failure::Busy)));
        }
        if self.waiting.first().map(|first| first.id) != self.armed {
            // Overtaken: it is not its turn any more.
            self.armed = None;
        }
    }

    /// Withdraws a move that has not been sent; whether there was one.
    pub fn withdraw(&mut self, id: CommandId, failure: Failure, events: &mut Events) -> bool {
        if self.bit4.unsent() == Some(id) {
            self.drop_unsent(failure, events);
            true
        } else if self.waiting.remove(id) {
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
        while let Some(request) = self.waiting.pop() {
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
        self.chain.fail_all(failure, events);
    }

    /// Bit 4 goes low and nothing is held any more: the axis is out of Operation enabled and the drive has dropped
    /// its set-points.
    pub fn lower(&mut self) {
        self.unconfirmed = None;
        self.chain.forget();
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
        self.chain.report_halted(events);
    }

    /// Bit 8 falls, and the axis goes on from where it stands, or from its way to standstill.
    pub fn resumed(&mut self, now: Duration, from_rest: bool) {
        self.chain.resumed(now, from_rest);
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
    pub fn fire(&mut self, id: CommandId, cycle: &Cycle<'_>, events: &mut Events) {
        if self.armed == Some(id)
            && let Some(request) = self.waiting.first()
        {
            self.raise(request, cycle, events);
        }
    }

    /// One cycle with fresh inputs in Operation enabled and mode 1. Returns whether a set-point was acknowledged.
    pub fn step(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
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
        self.bit_9_is_valid |= cycle.is_remote();
        let local = self.bit_9_is_valid && !cycle.is_remote();
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
    fn accept(
        &mut self,
        mut raised: Raised,
        confirmed: bool,
        cycle: &Cycle<'_>,
        events: &mut Events,
    ) {
        // The one before it may have come to its end meanwhile.
        let before = self.chain.before(&raised.request.command);
        raised.far_behind &= before.is_some_and(|before| !before.may_be_over(cycle));
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
    pub fn start_next(&mut self, cycle: &Cycle<'_>, events: &mut Events) {
        self.armed = None;
        let Some(request) = self.waiting.first() else {
            return;
        };
        if !self.bit4.is_low() || self.unconfirmed.is_some() {
            return;
        }
        let ready = match self.chain.place_for(&request.command, cycle) {
            Place::Free => self.bit4.is_low_acknowledged(cycle),
            Place::Full => self.bit4.is_low_acknowledged(cycle) || self.bit4.is_low_seen(cycle),
            Place::Later => {
                self.waiting.first_is_free();
                return;
            }
            Place::Never(reason) => {
                let buffer_mode = request.command.set_point.buffer_mode;
                self.waiting.remove(request.id);
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
        let shown = self.send_start_bits(&request.command, cycle);
        if ready {
            self.waiting.first_is_free();
            if !cycle.delivered || !shown {
                return;
            }
            if let Err(failure) = self.chain.check_limits(&request.command, cycle) {
                self.waiting.remove(request.id);
                self.take_start_bits_back();
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
            self.take_start_bits_back();
            let failure = cycle.timeout(WaitingFor::AcknowledgeLow, Delivery::NotSent);
            events.push(request.id, Event::Done(Err(failure)));
        }
    }

    /// Where the drive takes bits 5, 6 and 9 before the edge, puts them out while bit 4 is low. Whether they may come with bit 4, or the
    /// drive has surely seen them.
    fn send_start_bits(&mut self, command: &MoveCommand, cycle: &Cycle<'_>) -> bool {
        if !cycle.traits.start_bits_first {
            return true;
        }
        let bits = start_bits(command, cycle.traits);
        if self.bits != bits {
            self.bits = bits;
            self.ahead = Ahead::Changed;
            return false;
        }
        if let Ahead::Changed = self.ahead
            && cycle.delivered
        {
            self.ahead = Ahead::Delivered(cycle.now);
        }
        match self.ahead {
            Ahead::Fell => true,
            Ahead::Changed => false,
            Ahead::Delivered(at) => cycle.is_seen(at),
        }
    }

    /// The move that they were put out for does not come.
    fn take_start_bits_back(&mut self) {
        if self.bit4.is_low() && !self.bits.is_empty() {
            self.bits = ModeBits::NONE;
            self.ahead = Ahead::Changed;
        }
    }

    fn raise(&mut self, request: Request, cycle: &Cycle<'_>, events: &mut Events) {
        while let Some(overtaken) = self.waiting.pop_overtaken() {
            events.push(overtaken.id, Event::Done(Err(Failure::Superseded)));
        }
        self.waiting.pop();
        self.bits = start_bits(&request.command, cycle.traits).with_new_set_point();
        self.target = request.command.target;
        self.parameters = request.command.set_point.parameters;
        self.armed = None;
        // Only a distance counts from another.
        let is_relative = request.command.reference == Reference::Relative;
        let before = is_relative
            .then(|| self.chain.before(&request.command))
            .flatten();
        let previous = is_relative.then(|| self.chain.previous_end()).flatten();
        self.bit4 = Bit4::High {
            raised: Raised {
                request,
                since: cycle.now,
                begin: self.chain.begin_of(&request.command, cycle),
                at: cycle.sample.position,
                end: self.chain.end_of(&request.command, cycle),
                goal: self.chain.goal_of(&request.command, cycle),
                previous,
                from_rest: self.chain.begins_at_rest(&request.command, cycle),
                stands: self.chain.stands(cycle),
                at_base: self.chain.is_at_base(),
                far_behind: before.is_some() && !cycle.is_reached(),
                behind: before.and_then(|before| before.bases_behind(cycle.bounds)),
                behind_loose: before.is_some_and(Track::may_end_beside),
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
        self.bits = ModeBits::NONE;
        self.ahead = Ahead::Fell;
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
    },
    High {
        raised: Raised,
        sent: bool,
        /// Since when it is known to have been delivered high.
        delivered: Option<Duration>,
        /// Whether bit 12 has been high all the time, for a buffer that is full: no edge of it will come.
        full: bool,
        /// Frames with inputs since the drive has surely seen it.
        shown: u8,
    },
    /// High, and its set-point has been reported as failed already: a stop is under way.
    Abandoned,
}

/// A set-point for which bit 4 has risen.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Raised {
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
    /// Behind a distance whose end is not known, what a distance counts from.
    pub behind: Option<Bases>,
    /// Whether it is behind a distance that may end beside the place that its end was reckoned for.
    pub behind_loose: bool,
}

impl Raised {
    pub fn let_go(&mut self, now: Duration, acknowledge: Duration) {
        no_older(&mut self.since, now, acknowledge);
        self.request.blocked_since = None;
    }

    /// Whether it replaces the others.
    pub fn replaces(&self) -> bool {
        self.request.command.set_point.buffer_mode == BufferMode::Aborting
    }
}

impl Bit4 {
    /// Low from the next frame on.
    pub const LOW: Self = Self::Low {
        delivered: None,
        will_be_seen: false,
    };

    /// Lets go of what makes no difference any more.
    pub fn let_go(&mut self, now: Duration, seen: Duration, acknowledge: Duration) {
        match self {
            Self::Low { delivered, .. } => {
                if let Some(at) = delivered {
                    no_older(at, now, seen);
                }
            }
            Self::High {
                raised,
                delivered,
                shown,
                ..
            } => {
                raised.let_go(now, acknowledge);
                if let Some(at) = delivered {
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
    pub fn note(&mut self, cycle: &Cycle<'_>) {
        let (acknowledge, now) = (cycle.is_acknowledging(), cycle.now);
        match self {
            Self::Low {
                delivered,
                will_be_seen,
            } => {
                if cycle.delivered && delivered.is_none() {
                    *delivered = Some(now);
                    *will_be_seen = acknowledge;
                }
            }
            Self::High {
                sent: true,
                raised,
                delivered,
                full,
                shown,
            } => {
                raised.far_behind &= !cycle.is_reached();
                if cycle.delivered {
                    delivered.get_or_insert(now);
                }
                // A place became free after all before the drive took it: its edge will come.
                *full &= acknowledge;
                let seen = delivered.is_some_and(|at| cycle.is_seen(at));
                *shown = shown.saturating_add(u8::from(seen));
            }
            Self::High { .. } | Self::Abandoned => {}
        }
    }

    /// Whether bit 12 is low and the drive has surely seen bit 4 low: by the fall of bit 12, or by its own cycle.
    pub fn is_low_acknowledged(&self, cycle: &Cycle<'_>) -> bool {
        let &Self::Low {
            delivered: Some(_),
            will_be_seen,
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
pub(super) struct Request {
    pub id: CommandId,
    pub command: MoveCommand,
    /// When it became the next in turn with nothing but bit 12 in its way.
    pub blocked_since: Option<Duration>,
}

/// A queue of fixed size.
#[derive(Debug, Clone, Hash, Default)]
struct Waiting {
    places: [Option<Request>; PLACES],
}

impl Waiting {
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
    pub fn first(&self) -> Option<Request> {
        self.places.get(self.turn()).copied().flatten()
    }

    pub fn last(&self) -> Option<&Request> {
        self.places.iter().flatten().last()
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
    pub fn let_go(&mut self, now: Duration, acknowledge: Duration) {
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
        first
    }

    /// Those behind the empty place move up.
    fn close_up(&mut self, mut empty: usize) {
        while let Some(Some(next)) = self.places.get_mut(empty + 1).map(Option::take) {
            self.places[empty] = Some(next);
            empty += 1;
        }
    }

    /// Takes out the oldest, if it comes before the move whose turn it is.
    pub fn pop_overtaken(&mut self) -> Option<Request> {
        if self.turn() == 0 { None } else { self.pop() }
    }

    fn turn(&self) -> usize {
        let replaces = |place: &Option<Request>| {
            place.is_some_and(|r| r.command.set_point.buffer_mode == BufferMode::Aborting)
        };
        self.places.iter().position(replaces).unwrap_or(0)
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
        true
    }
}

#[cfg(test)]
#[path = "sequencer_tests.rs"]
mod tests;
