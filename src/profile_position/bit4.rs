//! Bit 4 (new set-point) of the controlword: where it is, and what the drive has seen of it.

use core::time::Duration;

use crate::axis::no_older;

use super::{CommandId, Cycle, Start, track::Bases, waiting::Request};

/// So many frames later, at the latest, the inputs show what the drive has seen in one: it takes outputs in at one SYNC0, works
/// until the next, and what it has put out then is fetched by the frame after that. Assumed, no document says.
pub(super) const SHOWN_AFTER: u8 = 3;

/// Where bit 4 is.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) enum Bit4 {
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
    pub(super) request: Request,
    /// When it rose, and when it was sent.
    pub(super) since: Duration,
    /// Where the set-point begins and where it ends, judged when it rose.
    pub(super) begin: i32,
    /// Where the axis was.
    pub(super) at: i32,
    pub(super) end: Option<i32>,
    /// Where it leads, also where its end is not known to the count.
    pub(super) goal: Option<i32>,
    /// Of a distance, the end of the set-point before it, where that is known: the drive may count from it.
    pub(super) previous: Option<i32>,
    /// Whether it begins at rest.
    pub(super) from_rest: bool,
    /// Whether the axis stood there when bit 4 rose, with nothing that the drive held.
    pub(super) stands: bool,
    /// Whether it had not moved but by set-points that have ended well, since it was enabled.
    pub(super) at_base: bool,
    /// Whether it is behind another that the drive holds, and that bit 10 does not show to be over.
    pub(super) far_behind: bool,
    /// Behind a distance whose end is not known, what a distance counts from.
    pub(super) behind: Option<Bases>,
}

impl Raised {
    pub(super) fn let_go(&mut self, now: Duration, acknowledge: Duration) {
        no_older(&mut self.since, now, acknowledge);
        self.request.blocked_since = None;
    }

    /// Whether it replaces the others.
    pub(super) fn replaces(&self) -> bool {
        self.request.command.set_point.start == Start::Immediately
    }
}

impl Bit4 {
    /// Low from the next frame on.
    pub(super) const LOW: Self = Self::Low {
        delivered: None,
        will_be_seen: false,
    };

    /// Lets go of what makes no difference any more.
    pub(super) fn let_go(&mut self, now: Duration, seen: Duration, acknowledge: Duration) {
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
                *shown = (*shown).min(SHOWN_AFTER + 1);
            }
            Self::Abandoned => {}
        }
    }

    pub(super) const fn is_low(&self) -> bool {
        matches!(self, Self::Low { .. })
    }

    /// Takes in what a cycle with inputs shows of it.
    pub(super) fn note(&mut self, cycle: &Cycle<'_>) {
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
                delivered,
                full,
                shown,
                ..
            } => {
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
    pub(super) fn is_low_acknowledged(&self, cycle: &Cycle<'_>) -> bool {
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
    pub(super) fn is_low_seen(&self, cycle: &Cycle<'_>) -> bool {
        matches!(self, &Self::Low { delivered: Some(at), .. } if cycle.is_seen(at))
    }

    /// The set-point that is on its way: the drive may have taken it already, and its acknowledge is still to come.
    pub(super) const fn on_its_way(&self) -> Option<&Raised> {
        match self {
            Self::High {
                raised, sent: true, ..
            } => Some(raised),
            _ => None,
        }
    }

    /// The move whose bit 4 has risen in the outputs and has not been sent.
    pub(super) const fn unsent(&self) -> Option<CommandId> {
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
    pub(super) const fn mark_sent(&mut self, now: Duration) {
        if let Self::High { sent, raised, .. } = self
            && !*sent
        {
            *sent = true;
            raised.since = now;
        }
    }
}
