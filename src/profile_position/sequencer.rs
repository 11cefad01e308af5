//! The handshake of bits 4 and 12 and the chain of set-points behind it.
//!
//! Contract: the axis core calls [`Sequencer::step`] in every cycle with fresh inputs in Operation enabled with mode 1
//! shown, and not otherwise; it puts [`Sequencer::bits`] into the next controlword. Whatever ends the motion is told by
//! [`Sequencer::fail_all`], after which bit 4 stays as it is until [`Sequencer::lower`].

use core::time::Duration;

use crate::ds402::{Controlword, Sample, Statusword};

use super::{
    Bounds, BufferSignal, CommandId, Completion, Delivery, Event, Events, Failure, MoveCommand,
    Parameters, Reference, RelativeBase, Standstill, Start, StartBits, Traits, WaitingFor,
    standstill::distance, track::Track,
};

/// Moves that may wait for their turn; one more is refused as busy.
const WAITING: usize = 4;

/// Set-points that the drive may hold: the active one and one behind it.
const HELD: usize = 2;

/// What the sequencer needs to know of a cycle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cycle<'a> {
    pub(crate) now: Duration,
    pub(crate) sample: &'a Sample,
    pub(crate) standstill: &'a Standstill,
    pub(crate) bounds: &'a Bounds,
    pub(crate) traits: &'a Traits,
    /// Whether the outputs of this cycle are known to have been delivered.
    pub(crate) delivered: bool,
    pub(crate) halted: bool,
    /// Deadline of each wait for bit 12.
    pub(crate) acknowledge: Duration,
    /// The words sent with this cycle, for errors.
    pub(crate) controlword: Controlword,
}

#[derive(Debug, Clone, Copy)]
struct Request {
    id: CommandId,
    command: MoveCommand,
    /// When it became the next in turn with nothing but bit 12 in its way.
    blocked_since: Option<Duration>,
}

/// Where bit 4 is.
#[derive(Debug, Clone, Copy)]
enum Bit4 {
    Low {
        /// Since when it is known to have been delivered low.
        delivered: Option<Duration>,
        /// Whether bit 12 was seen to fall, or to be low before: the drive has seen bit 4 low.
        seen: bool,
    },
    High {
        request: Request,
        sent: bool,
        since: Duration,
        position: i32,
        /// Where the set-point ends, judged when it was sent.
        end: Option<i32>,
    },
    /// High, and its set-point has been reported as failed already: a stop is under way.
    Abandoned,
}

/// The sequencing of set-points towards one drive axis.
#[derive(Debug)]
pub(crate) struct Sequencer {
    bit4: Bit4,
    bits: Controlword,
    target: i32,
    parameters: Parameters,
    waiting: [Option<Request>; WAITING],
    held: [Option<Track>; HELD],
    /// The end of the last set-point, where the axis has arrived.
    last_end: Option<i32>,
    unknown: bool,
    armed: Option<CommandId>,
}

impl Sequencer {
    pub(crate) const fn new(parameters: Parameters) -> Self {
        Self {
            bit4: Bit4::Low {
                delivered: None,
                seen: false,
            },
            bits: Controlword::empty(),
            target: 0,
            parameters,
            waiting: [None; WAITING],
            held: [None; HELD],
            last_end: None,
            unknown: false,
            armed: None,
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

    /// The target follows the axis while no set-point can be active: whoever looks at it later finds no jump.
    pub(crate) const fn follow_position(&mut self, position: i32) {
        self.target = position;
    }

    /// Whether the drive has a set-point or may have one.
    pub(crate) fn has_set_point(&self) -> bool {
        self.unknown
            || self.held.iter().any(Option::is_some)
            || matches!(self.bit4, Bit4::High { sent: true, .. } | Bit4::Abandoned)
    }

    /// Whether a set-point may have been taken without an acknowledge: only a stop clears that.
    pub(crate) const fn is_unknown(&self) -> bool {
        self.unknown
    }

    /// Whether moves wait or are under way.
    pub(crate) fn is_idle(&self) -> bool {
        !self.has_set_point()
            && self.waiting.iter().all(Option::is_none)
            && matches!(self.bit4, Bit4::Low { .. })
    }

    /// Takes a checked move in; refuses it when too many wait.
    pub(crate) fn submit(&mut self, id: CommandId, command: MoveCommand, events: &mut Events) {
        match self.waiting.iter_mut().find(|place| place.is_none()) {
            Some(place) => {
                *place = Some(Request {
                    id,
                    command,
                    blocked_since: None,
                });
            }
            None => events.push(id, Event::Done(Err(Failure::Busy))),
        }
    }

    /// Withdraws a move that has not been sent; whether there was one.
    pub(crate) fn withdraw(
        &mut self,
        id: CommandId,
        failure: Failure,
        events: &mut Events,
    ) -> bool {
        if let Bit4::High {
            request,
            sent: false,
            ..
        } = self.bit4
            && request.id == id
        {
            self.drop_unsent(failure, events);
            return true;
        }
        let Some(at) = self
            .waiting
            .iter()
            .position(|r| r.is_some_and(|r| r.id == id))
        else {
            return false;
        };
        self.remove_waiting(at);
        events.push(id, Event::Done(Err(failure)));
        true
    }

    /// A stop takes over: moves that wait fail, and a rise of bit 4 that is not sent yet does not happen.
    /// Returns whether a rise was withdrawn.
    pub(crate) fn withdraw_unsent(&mut self, failure: Failure, events: &mut Events) -> bool {
        while let Some(request) = self.waiting[0] {
            self.remove_waiting(0);
            events.push(request.id, Event::Done(Err(failure)));
        }
        if matches!(self.bit4, Bit4::High { sent: false, .. }) {
            self.drop_unsent(failure, events);
            return true;
        }
        false
    }

    /// The outputs composed last have been sent.
    pub(crate) fn mark_sent(&mut self, now: Duration) {
        if let Bit4::High { sent, since, .. } = &mut self.bit4
            && !*sent
        {
            *sent = true;
            *since = now;
        }
    }

    /// Ends everything with the failure that `of` gives for how far each set-point came. Bit 4 stays as it is.
    pub(crate) fn fail_all(&mut self, of: impl Fn(Delivery) -> Failure, events: &mut Events) {
        while let Some(request) = self.waiting[0] {
            self.remove_waiting(0);
            events.push(request.id, Event::Done(Err(of(Delivery::NotSent))));
        }
        if let Bit4::High { request, sent, .. } = self.bit4 {
            if sent {
                events.push(request.id, Event::Done(Err(of(Delivery::Unknown))));
                self.bit4 = Bit4::Abandoned;
            } else {
                self.drop_unsent(of(Delivery::NotSent), events);
            }
        }
        for track in self.held.iter_mut().filter_map(Option::take) {
            events.push(track.id, Event::Done(Err(of(Delivery::Accepted))));
        }
        self.last_end = None;
    }

    /// Bit 4 goes low and nothing is held any more: the axis is out of Operation enabled and the drive has dropped
    /// its set-points.
    pub(crate) fn lower(&mut self) {
        if !matches!(self.bit4, Bit4::Low { .. }) {
            self.bit4 = Bit4::Low {
                delivered: None,
                seen: false,
            };
        }
        self.bits = Controlword::empty();
        self.unknown = false;
        self.last_end = None;
    }

    /// The axis stands halted: says so for each set-point that the drive keeps.
    pub(crate) fn report_halted(&self, events: &mut Events) {
        for track in self.held.iter().flatten() {
            events.push(track.id, Event::Halted);
        }
    }

    /// Bit 8 falls: what bit 10 showed while halted is of no meaning any more.
    pub(crate) fn resumed(&mut self, now: Duration, position: i32) {
        if let Some(track) = &mut self.held[0] {
            track.becomes_active(now, position);
        }
    }

    /// Whether this gated move has everything it needs but its release.
    pub(crate) fn is_armed(&self, id: CommandId) -> bool {
        self.armed == Some(id)
    }

    /// Releases a gated, armed move: bit 4 rises.
    pub(crate) fn fire(
        &mut self,
        now: Duration,
        id: CommandId,
        sample: &Sample,
        bounds: &Bounds,
        traits: &Traits,
    ) {
        if self.armed == Some(id)
            && let Some(request) = self.waiting[0]
        {
            self.remove_waiting(0);
            self.raise(now, request, sample, bounds, traits);
        }
    }

    /// One cycle with fresh inputs in Operation enabled and mode 1.
    pub(crate) fn step(&mut self, cycle: &Cycle<'_>, events: &mut Events) {
        self.follow_bit4(cycle, events);
        if !cycle.halted {
            self.follow_chain(cycle, events);
            self.start_next(cycle, events);
        }
    }

    fn follow_bit4(&mut self, cycle: &Cycle<'_>, events: &mut Events) {
        let acknowledge = cycle
            .sample
            .statusword
            .contains(Statusword::SET_POINT_ACKNOWLEDGE);
        match &mut self.bit4 {
            Bit4::Low { delivered, seen } => {
                if cycle.delivered && delivered.is_none() {
                    // Bit 12 still high proves that the drive has not processed the low; its fall will prove that it has.
                    *delivered = Some(cycle.now);
                    *seen = acknowledge;
                }
            }
            Bit4::High {
                request,
                sent: true,
                since,
                position,
                end,
            } => {
                if acknowledge {
                    let (request, position, end) = (*request, *position, *end);
                    self.accept(cycle, request, position, end, events);
                } else if cycle.now.saturating_sub(*since) >= cycle.acknowledge {
                    let failure = timeout(cycle, WaitingFor::Acknowledge, Delivery::Unknown);
                    events.push(request.id, Event::Done(Err(failure)));
                    self.unknown = true;
                    self.low();
                }
            }
            Bit4::High { .. } | Bit4::Abandoned => {}
        }
    }

    fn accept(
        &mut self,
        cycle: &Cycle<'_>,
        request: Request,
        position: i32,
        end: Option<i32>,
        events: &mut Events,
    ) {
        self.low();
        events.push(request.id, Event::Accepted);
        let start = request.command.set_point.start;
        if start == Start::Immediately {
            for track in self.held.iter_mut().filter_map(Option::take) {
                events.push(track.id, Event::Done(Err(Failure::Superseded)));
            }
        }
        // The axis was at `position` when bit 4 rose; by the acknowledge a short move may be over.
        let track = Track::new(request.id, start, end, cycle.now, position);
        if let Some(place) = self.held.iter_mut().find(|place| place.is_none()) {
            *place = Some(track);
        }
        if cycle.halted {
            // It is taken and kept; whoever waits for it learns that the axis is halted.
            events.push(request.id, Event::Halted);
        }
    }

    fn follow_chain(&mut self, cycle: &Cycle<'_>, events: &mut Events) {
        let tolerance = cycle.bounds.position;
        let position = cycle.sample.position;
        if let [Some(first), Some(second)] = &mut self.held {
            first.note(cycle.sample, tolerance);
            let (first, second) = (*first, *second);
            let ended = match cycle.traits.buffer_signal {
                BufferSignal::Acknowledge => self.is_low_acknowledged(cycle),
                BufferSignal::None => first.is_left_behind(position, tolerance),
            } || first.is_over_with(
                &second,
                cycle.now,
                cycle.sample,
                cycle.standstill,
                cycle.bounds,
            );
            if ended {
                let completion = if second.start == Start::Blend {
                    Completion::Passed { position }
                } else {
                    Completion::Reached {
                        position: first.arrived().unwrap_or(position),
                    }
                };
                events.push(first.id, Event::Done(Ok(completion)));
                let mut second = second;
                second.becomes_active(cycle.now, position);
                self.held = [Some(second), None];
                self.last_end = first.end;
            }
            return;
        }
        let Some(track) = &mut self.held[0] else {
            return;
        };
        track.note(cycle.sample, tolerance);
        if let Some(outcome) =
            track.outcome(cycle.now, cycle.sample, cycle.standstill, cycle.bounds)
        {
            self.last_end = if outcome.is_ok() { track.end } else { None };
            events.push(track.id, Event::Done(outcome));
            self.held[0] = None;
        }
    }

    fn start_next(&mut self, cycle: &Cycle<'_>, events: &mut Events) {
        self.armed = None;
        let Some(request) = self.waiting[0] else {
            return;
        };
        if !matches!(self.bit4, Bit4::Low { .. }) {
            return;
        }
        match self.place_for(&request.command, cycle.traits) {
            Place::Free => {}
            Place::Later => return,
            Place::Never(reason) => {
                let start = request.command.set_point.start;
                self.remove_waiting(0);
                events.push(
                    request.id,
                    Event::Done(Err(Failure::Unsupported { start, reason })),
                );
                return;
            }
        }
        if self.is_low_acknowledged(cycle) && cycle.delivered {
            if request.command.gated {
                self.armed = Some(request.id);
            } else {
                self.remove_waiting(0);
                self.raise(cycle.now, request, cycle.sample, cycle.bounds, cycle.traits);
            }
            return;
        }
        let since = *self.waiting[0]
            .get_or_insert(request)
            .blocked_since
            .get_or_insert(cycle.now);
        if cycle.now.saturating_sub(since) >= cycle.acknowledge {
            self.remove_waiting(0);
            let failure = timeout(cycle, WaitingFor::AcknowledgeLow, Delivery::NotSent);
            events.push(request.id, Event::Done(Err(failure)));
        }
    }

    /// Whether bit 12 is low and the drive has surely seen bit 4 low.
    fn is_low_acknowledged(&self, cycle: &Cycle<'_>) -> bool {
        let Bit4::Low {
            delivered: Some(since),
            seen,
        } = self.bit4
        else {
            return false;
        };
        let long_enough = cycle.now.saturating_sub(since) >= 2 * cycle.traits.drive_cycle;
        !cycle
            .sample
            .statusword
            .contains(Statusword::SET_POINT_ACKNOWLEDGE)
            && (seen || long_enough)
    }

    /// Whether the drive can take this move now.
    fn place_for(&self, command: &MoveCommand, traits: &Traits) -> Place {
        let start = command.set_point.start;
        let bits = traits.bits(start);
        if let StartBits::Unsupported(reason) = bits {
            return Place::Never(reason);
        }
        let Some(active) = self.held[0] else {
            return Place::Free;
        };
        let full = self.held[1].is_some();
        match start {
            Start::Immediately if full && traits.buffer_signal == BufferSignal::Acknowledge => {
                Place::Never(
                    "its buffer is full and would not acknowledge: stop, or wait for the active move's end",
                )
            }
            Start::Immediately => Place::Free,
            _ if bits == StartBits::Sequenced || full => Place::Later,
            _ if traits.buffer_signal == BufferSignal::Acknowledge || active.end.is_some() => {
                Place::Free
            }
            Start::AfterCurrent => Place::Later,
            Start::Blend => Place::Never(
                "the end of the active move shows neither in bit 12 nor in the position: use AfterCurrent, or an absolute move before it",
            ),
        }
    }

    fn raise(
        &mut self,
        now: Duration,
        request: Request,
        sample: &Sample,
        bounds: &Bounds,
        traits: &Traits,
    ) {
        let command = &request.command;
        let end = self.end_of(command, sample.position, bounds, traits);
        let start = match traits.bits(command.set_point.start) {
            StartBits::Bits(bits) => bits,
            // Sequenced after arrival: it starts an axis that stands.
            StartBits::Sequenced | StartBits::Unsupported(_) => Controlword::empty(),
        };
        let relative = match command.reference {
            Reference::Absolute => Controlword::empty(),
            Reference::Relative => Controlword::RELATIVE,
        };
        self.bits = Controlword::NEW_SET_POINT | start | relative;
        self.target = command.target;
        self.parameters = command.set_point.parameters;
        self.armed = None;
        self.bit4 = Bit4::High {
            request,
            sent: false,
            since: now,
            position: sample.position,
            end,
        };
    }

    /// Where a move will end, where the documents and the position tell.
    fn end_of(
        &self,
        command: &MoveCommand,
        position: i32,
        bounds: &Bounds,
        traits: &Traits,
    ) -> Option<i32> {
        if command.reference == Reference::Absolute {
            return Some(command.target);
        }
        let queued = self.held.iter().flatten().last();
        let base = match (queued, command.set_point.start) {
            // Whatever the base is, at the end of the move before it they are all the same.
            (Some(before), Start::AfterCurrent | Start::Blend) => before.end,
            (Some(before), Start::Immediately) => match traits.relative_base {
                RelativeBase::PreviousTarget => before.end,
                RelativeBase::Demand | RelativeBase::Actual | RelativeBase::Undocumented => None,
            },
            (None, _) => match traits.relative_base {
                RelativeBase::Actual | RelativeBase::Demand => Some(position),
                RelativeBase::PreviousTarget => self.last_end,
                RelativeBase::Undocumented => self
                    .last_end
                    .filter(|&end| distance(end, position) <= bounds.position),
            },
        };
        base.map(|base| base.wrapping_add(command.target))
    }

    fn low(&mut self) {
        self.bit4 = Bit4::Low {
            delivered: None,
            seen: false,
        };
        self.bits = Controlword::empty();
    }

    fn drop_unsent(&mut self, failure: Failure, events: &mut Events) {
        if let Bit4::High {
            request,
            sent: false,
            ..
        } = self.bit4
        {
            events.push(request.id, Event::Done(Err(failure)));
            self.low();
        }
    }

    fn remove_waiting(&mut self, at: usize) {
        if let Some(tail) = self.waiting.get_mut(at..) {
            tail.rotate_left(1);
        }
        self.waiting[WAITING - 1] = None;
        self.armed = None;
    }
}

/// Whether the drive can take a move.
enum Place {
    Free,
    Later,
    Never(&'static str),
}

fn timeout(cycle: &Cycle<'_>, waiting_for: WaitingFor, delivery: Delivery) -> Failure {
    Failure::Timeout {
        waiting_for,
        statusword: cycle.sample.statusword,
        controlword: cycle.controlword,
        delivery,
    }
}
