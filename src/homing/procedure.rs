//! Bit 4 of the controlword and bits 10, 12 and 13 of the statusword in homing mode.
//!
//! Contract: the axis core calls [`Procedure::step`] in every cycle with fresh inputs in Operation enabled with mode 6
//! shown, [`Procedure::outside`] in the others, and puts [`Procedure::bits`] into the next controlword. Whatever ends the
//! homing is told by [`Procedure::fail`], after which bit 4 stays as it is until [`Procedure::lower`].
//!
//! What the three bits mean is the table of CiA DSP 402 v2.0, 13.2.2 (statusword in homing mode), as bits 13, 12, 10:
//! 000 in progress, 001 interrupted or not started, 010 attained and not yet at rest, 011 done, 100 error and moving,
//! 101 error at rest.

use core::time::Duration;

use crate::{
    ds402::Controlword,
    profile_position::{
        CommandId, Completion, Cycle, Delivery, Event, Events, Failure, WaitingFor,
    },
};

use super::{HomingCommand, run::Run};

/// Where the homing is.
#[derive(Debug, Clone, Copy, Hash)]
enum Stage {
    /// Bit 4 is low; a homing may be waiting to be started.
    Low {
        /// Since when it is known to have been delivered low in this mode.
        delivered: Option<Duration>,
        waiting: Option<(CommandId, HomingCommand)>,
    },
    High(Run),
    /// Bit 4 is high and its homing has been reported as failed: a stop is under way.
    Abandoned,
    /// Halted: the drive may go on when bit 8 falls, so only a quick stop leads on.
    Halted,
    /// Bit 4 was sent and nothing came of it that can be told from an earlier homing: only a stop makes that known.
    Unknown,
}

const LOW: Stage = Stage::Low {
    delivered: None,
    waiting: None,
};

/// What the axis core must do after a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Nothing.
    GoOn,
    /// The axis knows where it is.
    Attained,
    /// The drive reports an error and does not come to rest: stop it.
    StopIt,
    /// It has not ended in its time: halt it, then stop it.
    EndIt,
}

/// The sequencing of one drive axis' homing.
#[derive(Debug, Clone, Hash)]
pub(crate) struct Procedure {
    stage: Stage,
    /// How long an axis with an error may take to come to rest.
    standstill: Duration,
}

impl Procedure {
    pub(crate) const fn new(standstill: Duration) -> Self {
        Self {
            stage: LOW,
            standstill,
        }
    }

    /// Bit 4 of the next controlword.
    pub(crate) const fn bits(&self) -> Controlword {
        match self.stage {
            Stage::High(_) | Stage::Abandoned => Controlword::HOMING_START,
            Stage::Low { .. } | Stage::Halted | Stage::Unknown => Controlword::empty(),
        }
    }

    /// Whether the drive is homing, or may be, or would go on when bit 8 falls.
    pub(crate) const fn has_motion(&self) -> bool {
        match self.stage {
            Stage::Low { .. } => false,
            Stage::High(Run { sent, .. }) => sent,
            Stage::Abandoned | Stage::Halted | Stage::Unknown => true,
        }
    }

    /// Whether no homing waits or is under way.
    pub(crate) const fn is_idle(&self) -> bool {
        matches!(self.stage, Stage::Low { waiting: None, .. })
    }

    /// Whether a cycle like the last one changes nothing. `in_mode`: the drive is enabled and shows mode 6, if it is to.
    pub(crate) const fn is_calm(&self, in_mode: bool) -> bool {
        match self.stage {
            Stage::Low {
                waiting: None,
                delivered,
            } => delivered.is_some() || !in_mode,
            _ => false,
        }
    }

    /// Whether the homing with this number was sent and has not ended.
    #[cfg(feature = "std")]
    pub(crate) fn is_under_way(&self, id: CommandId) -> bool {
        matches!(self.stage, Stage::High(run) if run.sent && run.id == id)
    }

    /// Whether bit 4 was sent without an answer: only a stop clears that.
    pub(crate) const fn is_unknown(&self) -> bool {
        matches!(self.stage, Stage::Unknown)
    }

    /// Takes a checked homing in; one at a time.
    pub(crate) fn submit(&mut self, id: CommandId, command: HomingCommand, events: &mut Events) {
        match &mut self.stage {
            Stage::Low { waiting, .. } if waiting.is_none() => *waiting = Some((id, command)),
            _ => events.push(id, Event::Done(Err(Failure::Busy))),
        }
    }

    /// Withdraws a homing that has not been sent; whether there was one.
    pub(crate) fn withdraw(
        &mut self,
        id: CommandId,
        failure: Failure,
        events: &mut Events,
    ) -> bool {
        let unsent = self.unsent() == Some(id);
        if unsent {
            self.withdraw_unsent(failure, events);
        }
        unsent
    }

    /// A stop takes over: a homing that is not sent does not start.
    pub(crate) fn withdraw_unsent(&mut self, failure: Failure, events: &mut Events) {
        if let Some(id) = self.unsent() {
            self.stage = LOW;
            events.push(id, Event::Done(Err(failure)));
        }
    }

    /// The outputs composed last have been sent. Whether a homing has begun with them.
    pub(crate) fn mark_sent(&mut self, now: Duration) -> bool {
        match &mut self.stage {
            Stage::High(run) if !run.sent => {
                run.sent = true;
                run.since = now;
                true
            }
            _ => false,
        }
    }

    /// Ends it with this failure, which says how far it came. Bit 4 stays as it was sent.
    pub(crate) fn fail(&mut self, failure: Failure, events: &mut Events) {
        self.withdraw_unsent(failure.with_delivery(Delivery::NotSent), events);
        if let Stage::High(run) = self.stage {
            let failure = failure.with_delivery(run.delivery());
            events.push(run.id, Event::Done(Err(failure)));
            self.stage = Stage::Abandoned;
        }
    }

    /// The axis stands halted: the homing is over, and bit 4 falls.
    pub(crate) fn halted(&mut self, events: &mut Events) {
        if let Stage::High(run) = self.stage {
            let failure = Failure::Halted {
                delivery: run.delivery(),
            };
            events.push(run.id, Event::Done(Err(failure)));
        }
        if matches!(self.stage, Stage::High(_) | Stage::Abandoned) {
            self.stage = Stage::Halted;
        }
    }

    /// The axis is out of Operation enabled: bit 4 is low and no homing goes on.
    pub(crate) const fn lower(&mut self) {
        self.stage = LOW;
    }

    /// A cycle in another mode or state: what bit 4 was there counts for nothing here.
    pub(crate) const fn outside(&mut self) {
        if let Stage::Low { delivered, .. } = &mut self.stage {
            *delivered = None;
        }
    }

    /// One cycle with fresh inputs in Operation enabled and mode 6.
    pub(crate) fn step(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> Verdict {
        match &mut self.stage {
            Stage::Low { delivered, waiting } => {
                let low = !cycle.controlword.contains(Controlword::HOMING_START);
                if low && cycle.delivered {
                    delivered.get_or_insert(cycle.now);
                }
                // The drive has surely seen bit 4 low in this mode, and shows the bits of this mode, after two of its cycles.
                let seen = delivered.is_some_and(|since| {
                    cycle.now.saturating_sub(since) >= cycle.traits.surely_seen()
                });
                if let Some((_, command)) = *waiting
                    && command.is_late(cycle.now)
                {
                    let failure = Failure::Timeout {
                        waiting_for: WaitingFor::HomingEnd,
                        statusword: cycle.sample.statusword,
                        controlword: cycle.controlword,
                        delivery: Delivery::NotSent,
                    };
                    self.withdraw_unsent(failure, events);
                } else if let Some((id, command)) = *waiting
                    && seen
                    && cycle.delivered
                    && !cycle.halted
                {
                    self.stage = Stage::High(Run::new(id, command, cycle));
                }
                Verdict::GoOn
            }
            Stage::High(run) if run.sent && !cycle.halted => {
                let was_begun = run.begun;
                let end = run.step(cycle, self.standstill);
                let id = run.id;
                if run.begun && !was_begun {
                    events.push(id, Event::Accepted);
                }
                match end {
                    None => Verdict::GoOn,
                    Some(result) => self.end(id, result, events),
                }
            }
            _ => Verdict::GoOn,
        }
    }

    fn end(
        &mut self,
        id: CommandId,
        result: Result<Completion, Failure>,
        events: &mut Events,
    ) -> Verdict {
        events.push(id, Event::Done(result));
        self.stage = LOW;
        match result {
            Ok(_) => Verdict::Attained,
            Err(Failure::HomingError { moving: true }) => {
                self.stage = Stage::Abandoned;
                Verdict::StopIt
            }
            Err(Failure::Timeout {
                waiting_for: WaitingFor::HomingEnd,
                ..
            }) => {
                self.stage = Stage::Abandoned;
                Verdict::EndIt
            }
            Err(Failure::Timeout { .. }) => {
                self.stage = Stage::Unknown;
                Verdict::GoOn
            }
            Err(_) => Verdict::GoOn,
        }
    }

    const fn unsent(&self) -> Option<CommandId> {
        match self.stage {
            Stage::Low {
                waiting: Some((id, _)),
                ..
            }
            | Stage::High(Run {
                id, sent: false, ..
            }) => Some(id),
            _ => None,
        }
    }
}
