//! The handshake of bits 4 and 12.
//!
//! Contract: the axis core calls [`Sequencer::step`] in every cycle with fresh inputs in Operation enabled with mode 1
//! shown, and not otherwise; it puts [`Sequencer::bits`] into the next controlword. Whatever ends the motion is told by
//! [`Sequencer::fail_all`], after which bit 4 stays as it is until [`Sequencer::lower`].

use core::time::Duration;

use crate::ds402::{Controlword, Sample, Statusword};

use super::{
    Bounds, CommandId, Delivery, Event, Events, Failure, MoveCommand, Parameters, Standstill,
    Start, Traits, WaitingFor,
    chain::{Chain, Place, start_bits},
    track::Track,
    waiting::{Request, Waiting},
};

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
    /// The word sent with this cycle, for errors.
    pub(crate) controlword: Controlword,
}

/// Where bit 4 is.
#[derive(Debug, Clone, Copy)]
enum Bit4 {
    Low {
        /// Since when it is known to have been delivered low.
        delivered: Option<Duration>,
        /// Whether bit 12 was still high then: its fall proves that the drive has seen the low.
        will_be_seen: bool,
    },
    High {
        request: Request,
        sent: bool,
        since: Duration,
        /// Where the axis was when it rose, and where the set-point ends, judged then.
        position: i32,
        end: Option<i32>,
        /// Whether it begins at rest.
        from_rest: bool,
    },
    /// High, and its set-point has been reported as failed already: a stop is under way.
    Abandoned,
}

const LOW: Bit4 = Bit4::Low {
    delivered: None,
    will_be_seen: false,
};

/// The sequencing of set-points towards one drive axis.
#[derive(Debug)]
pub(crate) struct Sequencer {
    bit4: Bit4,
    bits: Controlword,
    target: i32,
    parameters: Parameters,
    waiting: Waiting,
    chain: Chain,
    unknown: bool,
    armed: Option<CommandId>,
}

impl Sequencer {
    pub(crate) fn new(parameters: Parameters) -> Self {
        Self {
            bit4: LOW,
            bits: Controlword::empty(),
            target: 0,
            parameters,
            waiting: Waiting::default(),
            chain: Chain::default(),
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
            || !self.chain.is_empty()
            || matches!(self.bit4, Bit4::High { sent: true, .. } | Bit4::Abandoned)
    }

    /// Whether a set-point may have been taken without an acknowledge: only a stop clears that.
    pub(crate) const fn is_unknown(&self) -> bool {
        self.unknown
    }

    /// Whether no move waits or is under way.
    pub(crate) fn is_idle(&self) -> bool {
        !self.has_set_point() && self.waiting.is_empty() && matches!(self.bit4, Bit4::Low { .. })
    }

    /// Takes a checked move in; refuses it when too many wait.
    pub(crate) fn submit(&mut self, id: CommandId, command: MoveCommand, events: &mut Events) {
        if !self.waiting.push(id, command) {
            events.push(id, Event::Done(Err(Failure::Busy)));
        }
    }

    /// Withdraws a move that has not been sent; whether there was one.
    pub(crate) fn withdraw(
        &mut self,
        id: CommandId,
        failure: Failure,
        events: &mut Events,
    ) -> bool {
        if self.unsent() == Some(id) {
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
        if self.unsent().is_some() {
            self.drop_unsent(failure, events);
        }
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

    /// Ends everything with the failure that `of` gives for how far each set-point came. Bit 4 stays as it was sent.
    pub(crate) fn fail_all(&mut self, of: impl Fn(Delivery) -> Failure, events: &mut Events) {
        self.withdraw_unsent(of(Delivery::NotSent), events);
        if let Bit4::High { request, .. } = self.bit4 {
            events.push(request.id, Event::Done(Err(of(Delivery::Unknown))));
            self.bit4 = Bit4::Abandoned;
        }
        self.chain.fail_all(of(Delivery::Accepted), events);
    }

    /// Bit 4 goes low and nothing is held any more: the axis is out of Operation enabled and the drive has dropped
    /// its set-points.
    pub(crate) fn lower(&mut self) {
        if !matches!(self.bit4, Bit4::Low { .. }) {
            self.bit4 = LOW;
        }
        self.bits = Controlword::empty();
        self.unknown = false;
    }

    /// The axis stands halted: says so for each set-point that the drive keeps.
    pub(crate) fn report_halted(&mut self, events: &mut Events) {
        self.chain.report_halted(events);
    }

    /// Bit 8 falls.
    pub(crate) fn resumed(&mut self, now: Duration) {
        self.chain.resumed(now);
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
    pub(crate) fn fire(&mut self, id: CommandId, cycle: &Cycle<'_>) {
        if self.armed == Some(id)
            && let Some(request) = self.waiting.pop()
        {
            self.raise(request, cycle);
        }
    }

    /// One cycle with fresh inputs in Operation enabled and mode 1. Returns whether a set-point was acknowledged.
    pub(crate) fn step(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        let accepted = self.follow_bit4(cycle, events);
        if !cycle.halted {
            let room_shown = self.is_low_acknowledged(cycle);
            let replacing = self.is_replacing();
            self.chain.follow(cycle, room_shown, replacing, events);
            self.start_next(cycle, events);
        }
        accepted
    }

    fn follow_bit4(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> bool {
        let acknowledge = cycle
            .sample
            .statusword
            .contains(Statusword::SET_POINT_ACKNOWLEDGE);
        match &mut self.bit4 {
            Bit4::Low {
                delivered,
                will_be_seen,
            } => {
                if cycle.delivered && delivered.is_none() {
                    *delivered = Some(cycle.now);
                    *will_be_seen = acknowledge;
                }
            }
            Bit4::High {
                request,
                sent: true,
                since,
                position,
                end,
                from_rest,
            } => {
                if acknowledge {
                    let start = request.command.set_point.start;
                    let track =
                        Track::new(request.id, start, *end, *from_rest, *position, cycle.now);
                    self.low();
                    events.push(track.id, Event::Accepted);
                    self.chain.push(track, events);
                    return true;
                } else if cycle.now.saturating_sub(*since) >= cycle.acknowledge {
                    let failure = timeout(cycle, WaitingFor::Acknowledge, Delivery::Unknown);
                    events.push(request.id, Event::Done(Err(failure)));
                    self.unknown = true;
                    self.low();
                    // What the drive holds is not known: nothing more is sent before a stop has made it known.
                    self.withdraw_unsent(Failure::NeedsStop, events);
                }
            }
            Bit4::High { .. } | Bit4::Abandoned => {}
        }
        false
    }

    fn start_next(&mut self, cycle: &Cycle<'_>, events: &mut Events) {
        self.armed = None;
        let Some(request) = self.waiting.first() else {
            return;
        };
        if !matches!(self.bit4, Bit4::Low { .. }) {
            return;
        }
        match self.chain.place_for(&request.command, cycle.traits) {
            Place::Free => {}
            Place::Later => return,
            Place::Never(reason) => {
                let start = request.command.set_point.start;
                self.waiting.pop();
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
                self.waiting.pop();
                self.raise(request, cycle);
            }
        } else if cycle
            .now
            .saturating_sub(self.waiting.first_blocked_since(cycle.now))
            >= cycle.acknowledge
        {
            self.waiting.pop();
            let failure = timeout(cycle, WaitingFor::AcknowledgeLow, Delivery::NotSent);
            events.push(request.id, Event::Done(Err(failure)));
        }
    }

    /// Whether bit 12 is low and the drive has surely seen bit 4 low: by the fall of bit 12, or by its own cycle.
    fn is_low_acknowledged(&self, cycle: &Cycle<'_>) -> bool {
        let Bit4::Low {
            delivered: Some(since),
            will_be_seen,
        } = self.bit4
        else {
            return false;
        };
        let long_enough = cycle.now.saturating_sub(since) >= 2 * cycle.traits.drive_cycle;
        !cycle
            .sample
            .statusword
            .contains(Statusword::SET_POINT_ACKNOWLEDGE)
            && (will_be_seen || long_enough)
    }

    fn raise(&mut self, request: Request, cycle: &Cycle<'_>) {
        self.bits = start_bits(&request.command, cycle.traits);
        self.target = request.command.target;
        self.parameters = request.command.set_point.parameters;
        self.armed = None;
        self.bit4 = Bit4::High {
            request,
            sent: false,
            since: cycle.now,
            position: cycle.sample.position,
            end: self.chain.end_of(&request.command, cycle),
            from_rest: self.chain.begins_at_rest(&request.command, cycle),
        };
    }

    /// Whether a set-point is on its way that will replace all others.
    fn is_replacing(&self) -> bool {
        match self.bit4 {
            Bit4::High {
                request,
                sent: true,
                ..
            } => request.command.set_point.start == Start::Immediately,
            _ => false,
        }
    }

    /// The move whose bit 4 has risen in the outputs and has not been sent.
    const fn unsent(&self) -> Option<CommandId> {
        match self.bit4 {
            Bit4::High {
                request,
                sent: false,
                ..
            } => Some(request.id),
            _ => None,
        }
    }

    fn drop_unsent(&mut self, failure: Failure, events: &mut Events) {
        if let Some(id) = self.unsent() {
            events.push(id, Event::Done(Err(failure)));
            self.low();
        }
    }

    fn low(&mut self) {
        self.bit4 = LOW;
        self.bits = Controlword::empty();
    }
}

fn timeout(cycle: &Cycle<'_>, waiting_for: WaitingFor, delivery: Delivery) -> Failure {
    Failure::Timeout {
        waiting_for,
        statusword: cycle.sample.statusword,
        controlword: cycle.controlword,
        delivery,
    }
}
