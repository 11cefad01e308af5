//! Profile Position: moves that wait, the one whose bit 4 is on its way, and those that the drive holds.
//!
//! Contract: the axis calls [`Sequencer::step`] in every cycle with inputs in Operation enabled with mode 1 shown, and not otherwise. It
//! puts [`Sequencer::bits`], [`Sequencer::target`] and [`Sequencer::parameters`] into the next outputs. Whatever ends the motion is
//! reported by [`Sequencer::fail_all`], after which bit 4 stays as it is until [`Sequencer::lower`].

use crate::{
    ds402::{ModeBits, SetPointBits},
    timer::{Due, Timer, UntilSeen},
};

use super::{
    Behind, Bit, Bounds, BufferMode, BufferSignal, CommandId, Cycle, Delivery, Ends, Event, Events,
    Failure, HeldSetPoint, Known, MoveCommand, Observer, OnItsWay, Parameters, Quiet, Reference,
    RelativeBase, Rules, StartBits, Traits, Unsupported, VelocityOverride, WaitingFor,
    handshake::{Handshake, HandshakeStep, Raised, Sent, Stage},
    pending::{PendingMoves, Request},
};

/// The Profile Position mode of one axis.
#[derive(Debug, Clone, Hash)]
pub(crate) struct Sequencer {
    pending: PendingMoves,
    handshake: Handshake,
    observer: Observer,
    /// Bits 4, 5, 6 and 9 of the next controlword.
    bits: ModeBits,
    /// Bits 5, 6 and 9 that are out while bit 4 is low. Where they fell with bit 4 they are seen with its low.
    ahead: UntilSeen,
    target: i32,
    parameters: Parameters,
    /// The override that was asked for, and that of the parameters in the outputs.
    wanted: VelocityOverride,
    applied: VelocityOverride,
    /// While bit 12 alone is in the way of the move whose turn it is.
    blocked: Option<Timer>,
    armed: Option<CommandId>,
    /// Of a set-point nobody knows whether the drive holds it. Nothing more is sent until the drive is outside of Operation enabled.
    needs_stop: bool,
}

/// Whether the drive can take a move.
enum Place {
    Free,
    /// Its buffer is full, for all that is known, and the move replaces what is in it.
    Full,
    Later,
    Never(Failure),
}

impl Sequencer {
    pub const fn new(parameters: Parameters) -> Self {
        Self {
            pending: PendingMoves::EMPTY,
            handshake: Handshake::LOW,
            observer: Observer::new(),
            bits: ModeBits::NONE,
            ahead: UntilSeen::SEEN,
            target: 0,
            parameters,
            wanted: VelocityOverride::NONE,
            applied: VelocityOverride::NONE,
            blocked: None,
            armed: None,
            needs_stop: false,
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

    /// Profile parameters of the last move, as it was asked for.
    pub const fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Profile parameters of the next outputs.
    pub fn outgoing(&self) -> Parameters {
        self.applied.apply(&self.parameters)
    }

    /// With this override from the beginning.
    #[cfg(feature = "std")]
    pub const fn with_override(mut self, factor: VelocityOverride) -> Self {
        (self.wanted, self.applied) = (factor, factor);
        self
    }

    pub const fn velocity_override(&self) -> VelocityOverride {
        self.wanted
    }

    /// From the next set-point on, and at once where the drive takes that.
    pub const fn set_override(&mut self, factor: VelocityOverride, traits: &Traits) {
        self.wanted = factor;
        self.follow_override(traits);
    }

    /// The parameters of the moves that wait, and of the last one that was sent.
    pub fn open_parameters(&self) -> impl Iterator<Item = &Parameters> {
        let waiting = self.pending.iter();
        let waiting = waiting.map(|request| &request.command.set_point.parameters);
        let sent = Some(&self.parameters).filter(|_| self.has_set_point());
        waiting.chain(sent)
    }

    /// Under a high bit 4 the parameters stay as they are.
    const fn follow_override(&mut self, traits: &Traits) {
        if traits.takes_velocity_at_once && self.handshake.is_low() {
            self.applied = self.wanted;
        }
    }

    /// The target follows the axis while no set-point can be active: whoever looks at it later finds no jump.
    pub const fn follow_position(&mut self, position: i32) {
        self.target = position;
    }

    /// Something else than set-points has moved the axis, or its zero.
    pub const fn forget_place(&mut self) {
        self.observer.forget_place();
    }

    /// A cycle in another mode: a low of bit 4 that the drive has seen there counts for nothing here.
    pub const fn outside(&mut self) {
        self.handshake.outside();
    }

    /// Whether the drive has a set-point or may have one.
    pub fn has_set_point(&self) -> bool {
        self.needs_stop || self.observer.has_way() || self.handshake.is_under_way()
    }

    /// Whether the drive may hold this move, or take it, and its outcome is not reported.
    #[cfg(feature = "std")]
    pub fn is_under_way(&self, id: CommandId) -> bool {
        let sent = self.handshake.on_its_way();
        sent.is_some_and(|sent| sent.request.id == id) || self.observer.is_untold(id)
    }

    /// Whether the drive has acknowledged this move, and its outcome is not reported.
    pub fn is_held(&self, id: CommandId) -> bool {
        self.observer.is_untold(id)
    }

    /// Whether this move waits, is on its way, or is held with its outcome open.
    pub fn knows(&self, id: CommandId) -> bool {
        let waits = self.pending.iter().any(|request| request.id == id);
        let sent = self.handshake.on_its_way();
        waits
            || self.handshake.unsent() == Some(id)
            || sent.is_some_and(|sent| sent.request.id == id)
            || self.is_held(id)
    }

    /// Whether the drive keeps a move that was pressing.
    pub fn has_pressed(&self) -> bool {
        self.observer.has_pressed()
    }

    /// The outcome of this move is told elsewhere.
    pub fn tell(&mut self, id: CommandId) {
        self.observer.tell(id);
    }

    /// Whether only a stop makes known what the drive holds.
    pub const fn needs_stop(&self) -> bool {
        self.needs_stop
    }

    /// Whether no move waits or is under way.
    pub fn is_idle(&self) -> bool {
        !self.has_set_point() && self.pending.is_empty() && self.handshake.is_low()
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
    pub fn submit(&mut self, id: CommandId, command: MoveCommand, events: &mut Events) {
        if !self.pending.push(id, command) {
            events.push(id, Event::Done(Err(Failure::Busy)));
        } else if command.gated && command.set_point.buffer_mode == BufferMode::Aborting {
            // Those of a group that it has overtaken end here and now: on another axis it may wait for one of theirs, and neither would
            // ever start.
            while let Some(id) = self.pending.first_gated_to_queue() {
                self.pending.remove(id);
                events.push(id, Event::Done(Err(Failure::Superseded)));
            }
        }
        if self.pending.first().map(|first| first.id) != self.armed {
            // Overtaken: it is not its turn any more.
            self.armed = None;
        }
    }

    /// Withdraws a move that has not been sent; whether there was one.
    pub fn withdraw(&mut self, id: CommandId, failure: Failure, events: &mut Events) -> bool {
        if self.handshake.unsent() == Some(id) {
            self.drop_unsent(failure, events);
            true
        } else {
            self.end_pending(id, failure, events)
        }
    }

    /// A stop takes over: moves that wait fail, and a rise of bit 4 that is not sent yet does not happen.
    pub fn withdraw_unsent(&mut self, failure: Failure, events: &mut Events) {
        (self.armed, self.blocked) = (None, None);
        while let Some(request) = self.pending.pop() {
            events.push(request.id, Event::Done(Err(failure)));
        }
        self.take_start_bits_back();
        self.drop_unsent(failure, events);
    }

    /// The outputs composed last have been sent.
    pub const fn mark_sent(&mut self) {
        self.handshake.mark_sent();
    }

    /// Ends everything with this failure, which says how far each set-point came. Bit 4 stays as it was sent.
    pub fn fail_all(&mut self, failure: Failure, events: &mut Events) {
        self.withdraw_unsent(failure.with_delivery(Delivery::NotSent), events);
        if let Some(sent) = self.handshake.on_its_way() {
            let unknown = failure.with_delivery(Delivery::Unknown);
            events.push(sent.request.id, Event::Done(Err(unknown)));
        }
        match self.handshake {
            Handshake::High(_) => self.handshake = Handshake::Abandoned,
            Handshake::Overwriting(low, _) => self.handshake = Handshake::Low(low),
            Handshake::Low(_) | Handshake::Abandoned => {}
        }
        self.observer.fail_all(failure, events);
    }

    /// Bit 4 goes low and nothing is held any more: the axis is out of Operation enabled and the drive has dropped its set-points (S6).
    pub fn lower(&mut self) {
        self.take_start_bits_back();
        self.handshake = Handshake::LOW;
        self.bits = ModeBits::NONE;
        self.needs_stop = false;
    }

    /// The axis stands halted: reports it for each set-point that the drive keeps.
    pub fn report_halted(&mut self, events: &mut Events) {
        self.observer.report_halted(events);
    }

    /// Bit 8 falls, and the axis goes on.
    pub fn resumed(&mut self, rules: &Rules<'_>) {
        if let Handshake::High(Raised { sent, .. }) = &mut self.handshake {
            // It may have been under way, without its acknowledge.
            (sent.turns, sent.shown_by_way) = (true, false);
        }
        self.observer.resumed(rules);
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

    /// Whether a torque ends the move that is under way.
    pub const fn awaits_contact(&self) -> bool {
        self.observer.awaits_contact()
    }

    /// The move that has just met the torque that ends it.
    pub fn take_contact(&mut self, cycle: &Cycle<'_>, torque: i16) -> Option<CommandId> {
        self.observer.take_contact(cycle, torque)
    }

    /// One cycle with inputs in Operation enabled and mode 1.
    pub fn step(&mut self, cycle: &Cycle<'_>, events: &mut Events) {
        let was_low = self.handshake.is_low();
        let answer = self.handshake.step(cycle);
        self.follow_override(cycle.rules.traits);
        if !was_low {
            self.fall_of_bit_4();
        }
        match answer {
            HandshakeStep::None => {}
            HandshakeStep::Acknowledged(sent) => self.accept(&sent, cycle, events),
            HandshakeStep::GivenUp(sent, failure) => {
                events.push(sent.request.id, Event::Done(Err(failure)));
                self.doubt(events);
            }
        }
        if self.handshake.on_its_way().is_some() {
            // What it has overtaken does not come any more.
            while let Some(overtaken) = self.pending.pop_overtaken() {
                events.push(overtaken.id, Event::Done(Err(Failure::Superseded)));
            }
        }
        let seen = cycle.rules.seen();
        self.ahead.update(cycle.delivered, cycle.elapsed, seen);
        let known = self.known(cycle);
        if self.observer.step(cycle, known, events) {
            self.doubt(events);
        }
        if let Some(blocked) = &mut self.blocked {
            blocked.pass(cycle.elapsed);
        }
        self.start_next(cycle, events);
    }

    /// The move whose turn it is starts, if all that it needs is there.
    pub fn start_next(&mut self, cycle: &Cycle<'_>, events: &mut Events) {
        self.armed = None;
        if !matches!(self.handshake, Handshake::Low(_)) {
            return;
        }
        let Some(&request) = self.pending.first() else {
            self.blocked = None;
            return;
        };
        if cycle.halted
            && !(request.command.replaces() && cycle.rules.traits.acknowledges_while_halted)
        {
            return;
        }
        let within = self.check_limits(&request.command, cycle);
        let shown = within.is_ok() && self.send_start_bits(&request.command, cycle.rules.traits);
        let ready = match self.place_for(&request.command, &cycle.rules) {
            Place::Free => self.handshake.is_free(cycle),
            Place::Full => self.handshake.is_free(cycle) || self.handshake.is_low_seen(),
            Place::Later => {
                self.blocked = None;
                return;
            }
            Place::Never(failure) => {
                self.end_pending(request.id, failure, events);
                return;
            }
        };
        if ready {
            self.blocked = None;
            if let Err(failure) = within {
                self.end_pending(request.id, failure, events);
            } else if !cycle.delivered || !shown {
                // The next fresh inputs decide.
            } else if request.command.gated {
                self.armed = Some(request.id);
            } else {
                self.raise(request, cycle);
            }
        } else {
            let left = cycle.rules.timer(cycle.rules.acknowledge);
            if self.blocked.get_or_insert(left).is_over() {
                let failure = cycle.timeout(WaitingFor::AcknowledgeLow, Delivery::NotSent);
                self.end_pending(request.id, failure, events);
            }
        }
    }

    /// When it has something to do without a word of the drive. `in_mode`: it is stepped then.
    pub fn due(&self, in_mode: bool) -> Due {
        if !in_mode {
            return Due::NEVER;
        }
        let waits = !self.pending.is_empty() || !self.ahead.is_seen();
        Due::next_if(waits)
            .sooner(self.handshake.due())
            .sooner(self.observer.due())
    }

    /// Where the next position tells nothing, as seen from this one.
    pub fn quiet(&self, position: i32, bounds: &Bounds) -> Quiet {
        self.observer.quiet(position, bounds)
    }

    /// The drive has acknowledged this one.
    fn accept(&mut self, sent: &Sent, cycle: &Cycle<'_>, events: &mut Events) {
        let Sent {
            request: Request { id, command },
            ends,
            ..
        } = *sent;
        let start = command.set_point.buffer_mode;
        let mut entry = HeldSetPoint::new(
            id,
            start,
            command.set_point.parameters.goes_on(),
            ends,
            &cycle.rules,
        );
        entry.turns = sent.turns;
        entry.behind = match command.reference {
            _ if self.observer.count() == 0 || start == BufferMode::Aborting => Behind::Nothing,
            Reference::Absolute => Behind::Position,
            Reference::Relative => Behind::Distance,
        };
        entry.shown_by_way = sent.shown_by_way;
        let (position, bounds) = (cycle.evidence.position, cycle.rules.bounds);
        if self.observer.count() == 0 && ends.are_known(bounds) && ends.contain(position, bounds) {
            entry.meet(position);
        }
        events.push(id, Event::Accepted);
        self.observer.push(entry, sent.place, &cycle.rules, events);
        if start == BufferMode::Aborting {
            let contact = command.set_point.contact;
            self.observer.await_contact(id, contact);
        }
    }

    /// Whether the drive holds it is not known: every move is refused from now on.
    fn doubt(&mut self, events: &mut Events) {
        self.needs_stop = true;
        self.withdraw_unsent(Failure::NeedsStop, events);
    }

    fn known(&self, cycle: &Cycle<'_>) -> Known {
        let on_its_way = match self.handshake.on_its_way() {
            _ if self.needs_stop => OnItsWay::Unknown,
            Some(sent) if sent.request.replaces() => OnItsWay::Instead,
            Some(sent) => OnItsWay::Behind(sent.request.command.set_point.buffer_mode),
            None => OnItsWay::Nothing,
        };
        let shown = self.handshake.is_low_seen() && shows_room(cycle.rules.traits);
        let room: Option<Bit> = shown.then_some(cycle.evidence.acknowledge);
        Known { on_its_way, room }
    }

    /// Whether the drive can take this move now.
    fn place_for(&self, command: &MoveCommand, rules: &Rules<'_>) -> Place {
        let traits = rules.traits;
        let buffer_mode = command.set_point.buffer_mode;
        let two = self.observer.count() == 2;
        match (buffer_mode, traits.bits(buffer_mode)) {
            (BufferMode::Aborting, _) => match (command.reference, traits.buffer_signal) {
                // A bit 12 that is still high is not that of the buffer.
                (_, BufferSignal::None) => Place::Free,
                (Reference::Absolute, _) if two => Place::Full,
                (Reference::Relative, BufferSignal::Acknowledge) if two => {
                    Place::Never(Failure::Unsupported(Unsupported::Start {
                        buffer_mode,
                        reason: "its buffer is full and acknowledges nothing, and where a distance taken once too little or too often \
                                 would end cannot be seen: use an absolute move, or stop",
                    }))
                }
                _ => Place::Free,
            },
            _ if two => Place::Later,
            (_, StartBits::Sequenced) if self.observer.has_untold() => Place::Later,
            // There the position is no evidence of the order.
            _ if rules.bounds.turn.is_some()
                && !shows_room(traits)
                && self.observer.has_untold() =>
            {
                Place::Later
            }
            _ => Place::Free,
        }
    }

    fn raise(&mut self, request: Request, cycle: &Cycle<'_>) {
        let rules = &cycle.rules;
        let command = &request.command;
        let ends = self.ends_of(command, cycle);
        let last = self.observer.last();
        let start = command.set_point.buffer_mode;
        let turns = match start {
            BufferMode::Buffered => last.is_some_and(|last| last.runs_on),
            BufferMode::Aborting => !cycle.evidence.stands() || self.observer.has_untold(),
            BufferMode::Blending => !cycle.evidence.stands() || last.is_some(),
        };
        let shown_by_way = last.is_some_and(|last| {
            let stops = !last.turns && !last.runs_on;
            stops || (start == BufferMode::Blending && !last.was_met())
        });
        let sent = Sent {
            request,
            ends,
            place: cycle.evidence.rest,
            turns,
            shown_by_way,
            answer: Timer::OVER,
        };
        let full = cycle.evidence.acknowledge.shows_high()
            || (shows_room(rules.traits) && self.observer.count() == 2);
        self.handshake = Handshake::High(Raised {
            sent,
            stage: Stage::Unsent {
                target: self.target,
                parameters: self.parameters,
                applied: self.applied,
                full,
            },
        });
        self.pending.take_turn();
        self.armed = None;
        self.bits = start_bits(command, rules.traits).with_new_set_point();
        self.target = command.target;
        self.parameters = command.set_point.parameters;
        self.applied = self.wanted;
    }

    fn drop_unsent(&mut self, failure: Failure, events: &mut Events) {
        if let Handshake::High(Raised {
            sent,
            stage:
                Stage::Unsent {
                    target,
                    parameters,
                    applied,
                    ..
                },
        }) = self.handshake
        {
            events.push(sent.request.id, Event::Done(Err(failure)));
            (self.target, self.parameters, self.applied) = (target, parameters, applied);
            self.pending.keep_overtaken();
            self.handshake = Handshake::LOW;
            self.fall_of_bit_4();
        }
    }

    /// A move that waits ends; whether there was one.
    fn end_pending(&mut self, id: CommandId, failure: Failure, events: &mut Events) -> bool {
        let waited = self.pending.remove(id);
        if waited {
            (self.armed, self.blocked) = (None, None);
            self.take_start_bits_back();
            events.push(id, Event::Done(Err(failure)));
        }
        waited
    }

    const fn fall_of_bit_4(&mut self) {
        if self.handshake.is_low() {
            self.bits = ModeBits::NONE;
            self.ahead = UntilSeen::SEEN;
        }
    }

    /// Where the drive takes bits 5, 6 and 9 before the edge, puts them out while bit 4 is low. Whether they may come with bit 4, or the
    /// drive has surely seen them.
    fn send_start_bits(&mut self, command: &MoveCommand, traits: &Traits) -> bool {
        if !traits.start_bits_first {
            return true;
        }
        let bits = start_bits(command, traits);
        if self.bits != bits {
            self.bits = bits;
            self.ahead = UntilSeen::UNDELIVERED;
        }
        self.ahead.is_seen()
    }

    /// The move that they were put out for does not come.
    fn take_start_bits_back(&mut self) {
        if self.handshake.is_low() && !self.bits.is_empty() {
            self.bits = ModeBits::NONE;
            self.ahead = UntilSeen::UNDELIVERED;
        }
    }

    /// Refuses a relative move whose turn has come and that may end beyond a limit.
    fn check_limits(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Result<(), Failure> {
        let rules = &cycle.rules;
        if command.reference == Reference::Absolute {
            return Ok(());
        }
        let Some(bases) = self.limited_bases(command, cycle) else {
            return Ok(());
        };
        for base in bases.outermost(rules.bounds) {
            let target = match rules.bounds.turn {
                Some(_) => rules.bounds.after(base, command.target).into(),
                None => i64::from(base) + i64::from(command.target),
            };
            let rule = &rules.traits.limits;
            rules.limits.check_target(target, rule, rules.referenced)?;
        }
        Ok(())
    }

    /// Between which positions a distance counts from one, as its end is checked. Where that is not documented it is where the axis is, or the
    /// target before, of an axis that nothing leads on.
    fn limited_bases(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Option<Ends> {
        let base = self.base_of(command, cycle);
        if base != Ends::ANYWHERE {
            return Some(base);
        }
        let at = Ends::at(cycle.evidence.position);
        let previous = self.observer.last_ends();
        let previous = previous.filter(|ends| *ends != Ends::ANYWHERE);
        let from = previous.map_or(at, |ends| at.with(ends, cycle.rules.bounds));
        (!self.has_set_point()).then_some(from)
    }

    /// Where a move will end, as far as the documents and the position show it.
    fn ends_of(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Ends {
        match command.reference {
            Reference::Absolute => Ends::at(command.target),
            Reference::Relative => self
                .base_of(command, cycle)
                .after(command.target, cycle.rules.bounds),
        }
    }

    /// What a distance counts from.
    fn base_of(&self, command: &MoveCommand, cycle: &Cycle<'_>) -> Ends {
        let (rules, position) = (&cycle.rules, cycle.evidence.position);
        let base = rules.traits.relative_base;
        let start = command.set_point.buffer_mode;
        let previous = self.observer.last_ends();
        if base == RelativeBase::PreviousTarget {
            // An axis that was moved since, without power or by hand, counts from nobody knows where.
            let is_there = |ends: &Ends| ends.contain(position, rules.bounds);
            let previous = previous.filter(|ends| self.observer.count() > 0 || is_there(ends));
            return previous.unwrap_or(Ends::ANYWHERE);
        }
        if let Some(before) = self
            .observer
            .last()
            .filter(|_| start != BufferMode::Aborting)
        {
            // At the end of the move before all bases are the same. In motion the axis is behind it by the following error.
            let stands = cycle.evidence.stands() && before.ends.contain(position, rules.bounds);
            let is_there = !before.runs_on
                && (start == BufferMode::Buffered || base == RelativeBase::Demand || stands);
            return if is_there {
                before.ends
            } else {
                Ends::ANYWHERE
            };
        }
        // It counts from where the axis is or was led to. What has not ended may lead it on before the drive takes this one.
        let bounds = rules.bounds;
        let untold = self.observer.untold(bounds);
        let is_there = |ends: &Ends| ends.are_known(bounds) && ends.contain(position, bounds);
        let arrived = previous.filter(is_there).filter(|_| untold.is_none());
        if self.observer.runs_on() || !(cycle.evidence.stands() || arrived.is_some()) {
            return Ends::ANYWHERE;
        }
        let mut from = Ends::at(position);
        for ends in untold.into_iter().chain(arrived) {
            from = from.with(ends, bounds);
        }
        match (base, previous) {
            (RelativeBase::Actual | RelativeBase::Demand, _) => from,
            (_, Some(previous)) => from.with(previous, bounds),
            (_, None) => Ends::ANYWHERE,
        }
    }
}

/// Whether bit 12 of this drive shows its buffer.
const fn shows_room(traits: &Traits) -> bool {
    matches!(traits.buffer_signal, BufferSignal::Acknowledge)
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
    let relative = matches!(command.reference, Reference::Relative);
    ModeBits::of_set_point(SetPointBits {
        change_set_immediately,
        relative,
        change_on_set_point,
    })
}
