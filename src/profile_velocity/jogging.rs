//! The target velocity 60FFh: what a jog asks for while it is held, and 0 at all other times.
//!
//! Contract: the axis core puts [`Jogging::velocity`] and [`Jogging::ramps`] into the next outputs, and calls
//! [`Jogging::step`] in every cycle with fresh inputs in Operation enabled with mode 3 shown. Mode 3 has no bits of its own
//! in the controlword: what is in 60FFh is followed at once, so that nothing but 0 may ever stay there.

use core::time::Duration;

use crate::{
    ds402::State,
    profile_position::{
        CommandId, Completion, Cycle, Delivery, Event, Events, Failure, Parameters,
    },
};

use super::JogSetPoint;

/// Where the jog is.
#[derive(Debug, Clone, Copy, Hash)]
enum Stage {
    /// No jog: the target velocity is 0.
    Idle,
    /// Held.
    Held {
        id: CommandId,
        velocity: i32,
        sent: bool,
        /// Its first velocity is known to have been delivered.
        accepted: bool,
    },
    /// Let go: the target velocity is 0, and the axis comes to rest.
    Released {
        id: CommandId,
        until: Duration,
        /// Since when the 0 is known to have been delivered.
        delivered: Option<Duration>,
        sent: bool,
    },
}

/// The jog of one drive axis.
#[derive(Debug, Clone, Hash)]
pub(crate) struct Jogging {
    stage: Stage,
    ramps: Parameters,
}

impl Jogging {
    pub(crate) fn new() -> Self {
        Self {
            stage: Stage::Idle,
            ramps: Parameters::default(),
        }
    }

    /// Target velocity 60FFh of the next outputs.
    pub(crate) const fn velocity(&self) -> i32 {
        match self.stage {
            Stage::Held { velocity, .. } => velocity,
            Stage::Idle | Stage::Released { .. } => 0,
        }
    }

    /// Profile acceleration and deceleration of the next outputs, where a jog has given them.
    pub(crate) const fn ramps(&self) -> &Parameters {
        &self.ramps
    }

    /// The jog that is held or coming to rest.
    pub(crate) const fn id(&self) -> Option<CommandId> {
        match self.stage {
            Stage::Idle => None,
            Stage::Held { id, .. } | Stage::Released { id, .. } => Some(id),
        }
    }

    /// Whether the drive follows a velocity, or has not come to rest from it.
    pub(crate) const fn has_motion(&self) -> bool {
        match self.stage {
            Stage::Idle => false,
            Stage::Held { sent, .. } => sent,
            Stage::Released { .. } => true,
        }
    }

    pub(crate) const fn is_held(&self) -> bool {
        matches!(self.stage, Stage::Held { .. })
    }

    pub(crate) const fn is_released(&self) -> bool {
        matches!(self.stage, Stage::Released { .. })
    }

    pub(crate) const fn is_idle(&self) -> bool {
        matches!(self.stage, Stage::Idle)
    }

    /// Whether a cycle like the last one changes nothing.
    pub(crate) const fn is_calm(&self) -> bool {
        matches!(
            self.stage,
            Stage::Idle
                | Stage::Held {
                    sent: true,
                    accepted: true,
                    ..
                }
        )
    }

    /// Takes a checked jog in: its velocity is in the next outputs. It may take over from one that comes to rest, not from one
    /// that is held.
    pub(crate) fn submit(&mut self, id: CommandId, set_point: JogSetPoint, events: &mut Events) {
        match self.stage {
            Stage::Held { .. } => {
                events.push(id, Event::Done(Err(Failure::Busy)));
                return;
            }
            Stage::Released { id, .. } => {
                events.push(id, Event::Done(Err(Failure::Superseded)));
            }
            Stage::Idle => {}
        }
        self.ramps = Parameters {
            acceleration: set_point.acceleration,
            deceleration: set_point.deceleration,
            ..Parameters::default()
        };
        self.stage = Stage::Held {
            id,
            velocity: set_point.velocity,
            sent: false,
            accepted: false,
        };
    }

    /// Another velocity, from the next outputs on; false if this jog is not held any more.
    pub(crate) fn set(&mut self, of: CommandId, new: i32) -> bool {
        match &mut self.stage {
            Stage::Held { id, velocity, .. } if *id == of => {
                *velocity = new;
                true
            }
            _ => false,
        }
    }

    /// Lets go: 0 from the next outputs on. False if this jog is not held any more.
    pub(crate) fn release(&mut self, of: CommandId, until: Duration) -> bool {
        match self.stage {
            Stage::Held { id, .. } if id == of => {
                self.stage = Stage::Released {
                    id,
                    until,
                    delivered: None,
                    sent: false,
                };
                true
            }
            _ => false,
        }
    }

    /// Withdraws a jog that has not been sent; whether there was one.
    pub(crate) fn withdraw(
        &mut self,
        of: CommandId,
        failure: Failure,
        events: &mut Events,
    ) -> bool {
        let unsent = matches!(self.stage, Stage::Held { id, sent: false, .. } if id == of);
        if unsent {
            self.end(failure, events);
        }
        unsent
    }

    /// The outputs composed last have been sent.
    pub(crate) const fn mark_sent(&mut self) {
        if let Stage::Held { sent, .. } | Stage::Released { sent, .. } = &mut self.stage {
            *sent = true;
        }
    }

    /// Ends it with this failure, which says how far it came; 0 from the next outputs on.
    pub(crate) fn end(&mut self, failure: Failure, events: &mut Events) {
        let (id, delivery) = match self.stage {
            Stage::Idle => return,
            Stage::Held {
                id, sent: false, ..
            } => (id, Delivery::NotSent),
            Stage::Held {
                id,
                accepted: false,
                ..
            } => (id, Delivery::Unknown),
            Stage::Held { id, .. } | Stage::Released { id, .. } => (id, Delivery::Accepted),
        };
        self.stage = Stage::Idle;
        events.push(id, Event::Done(Err(failure.with_delivery(delivery))));
    }

    /// One cycle with fresh inputs in Operation enabled and mode 3.
    pub(crate) fn step(&mut self, cycle: &Cycle<'_>, events: &mut Events) {
        match &mut self.stage {
            Stage::Held {
                id,
                sent: true,
                accepted,
                ..
            } if cycle.delivered && !*accepted => {
                *accepted = true;
                events.push(*id, Event::Accepted);
            }
            Stage::Released {
                id,
                until,
                delivered,
                sent: true,
            } => {
                if cycle.delivered {
                    delivered.get_or_insert(cycle.now);
                }
                let id = *id;
                // What the drive shows before it has taken the 0 in may be the rest from which it is only just starting.
                let at_rest = delivered.is_some_and(|since| {
                    let taken_in = since.saturating_add(cycle.traits.surely_seen());
                    cycle.now >= taken_in
                        && cycle
                            .standstill
                            .stands_since(cycle.now, taken_in, cycle.bounds)
                });
                if at_rest {
                    self.stage = Stage::Idle;
                    let state = State::OperationEnabled;
                    events.push(id, Event::Done(Ok(Completion::Stopped { state })));
                } else if cycle.now >= *until {
                    let failure = Failure::Timeout {
                        waiting_for: cycle.standstill(),
                        statusword: cycle.sample.statusword,
                        controlword: cycle.controlword,
                        delivery: Delivery::Accepted,
                    };
                    self.end(failure, events);
                }
            }
            _ => {}
        }
    }
}
