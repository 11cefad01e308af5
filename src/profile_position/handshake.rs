//! Bit 4 (new set-point) of the controlword and bit 12 (set-point acknowledge) of the statusword: the handshake of one set-point.
//!
//! Acceptance is the rise of bit 12 after that of bit 4, never its level. Bit 4 stays high until then, and then low until bit 12 is low.
//! Onto a full buffer no rise comes: bit 4 is high for as long as the drive needs to see it, and the fall of bit 12 is the acknowledge
//! (decision 5).

use crate::timer::{Due, Timer, UntilSeen};

use super::{
    CommandId, Cycle, Doubt, Ends, Failure, Parameters, VelocityOverride, pending::Request,
};

/// So many frames later, at the latest, the inputs show what the drive has seen in one: it takes outputs in at one SYNC0, works
/// until the next, and what it has put out then is fetched by the frame after that. Assumed, no document says.
const SHOWN_AFTER: u8 = 3;

/// Where bit 4 is.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) enum Handshake {
    Low(Low),
    High(Raised),
    /// Low again, with a set-point on a full buffer that is not acknowledged.
    Overwriting(Low, Sent),
    /// High, and its set-point was reported as failed: a stop is under way.
    Abandoned,
}

/// Bit 4 is low.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Low {
    seen: UntilSeen,
    /// Bit 12 was high then: its fall proves that the drive has seen it.
    falls: bool,
}

impl Low {
    const fn new() -> Self {
        Self {
            seen: UntilSeen::UNDELIVERED,
            falls: false,
        }
    }

    fn step(&mut self, cycle: &Cycle<'_>) {
        if cycle.delivered && !self.seen.is_delivered() {
            self.falls = cycle.evidence.acknowledge.shows_high();
        }
        let seen = cycle.rules.seen();
        self.seen.update(cycle.delivered, cycle.elapsed, seen);
    }

    /// Whether the drive has surely seen it, by its own cycle.
    const fn is_seen(&self) -> bool {
        self.seen.is_seen()
    }

    /// Whether bit 12 is low and the drive has surely seen the low of bit 4: by the fall of bit 12, or by its own cycle.
    const fn is_answered(&self, cycle: &Cycle<'_>) -> bool {
        !cycle.evidence.acknowledge.shows_high()
            && self.seen.is_delivered()
            && (self.falls || self.is_seen())
    }
}

/// A set-point that was sent, or is in the outputs.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Sent {
    pub request: Request,
    pub ends: Ends,
    /// Where the axis stood before.
    pub place: Option<i32>,
    /// The axis may pass its end and come back.
    pub turns: bool,
    /// The way shows when the one before it is over.
    pub shown_by_way: bool,
    /// From the first frame after it on: until bit 12 has to answer.
    pub answer: Timer,
}

/// Bit 4 is high.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Raised {
    pub sent: Sent,
    pub stage: Stage,
}

/// How far bit 4 came.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) enum Stage {
    /// In the outputs. 607Ah, the parameters and their override were these before, and are so again where it is taken back. `full`: so is the buffer, for
    /// all that is known.
    Unsent {
        target: i32,
        parameters: Parameters,
        applied: VelocityOverride,
        full: bool,
    },
    /// The frame that has brought it shows nothing of it yet.
    Fresh { full: bool },
    /// Bit 12 was low: it will rise. `early`: while it has been high since the frame that brought bit 4, or one of those whose inputs are
    /// missing, until the drive has seen bit 4.
    Awaited { early: Option<UntilSeen> },
    /// Two are held, for all that is known.
    Full(Full),
}

/// What a drive with a full buffer shows of bit 4.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Full {
    seen: UntilSeen,
    /// Frames with inputs since then.
    shown: u8,
    /// While bit 12 is low after all.
    fell: Option<Timer>,
}

impl Full {
    const NEW: Self = Self {
        seen: UntilSeen::UNDELIVERED,
        shown: 0,
        fell: None,
    };
}

/// What a cycle has brought.
pub(super) enum HandshakeStep {
    None,
    Acknowledged(Sent),
    /// With the failure of its move.
    GivenUp(Sent, Failure),
}

impl Handshake {
    /// Low from the next frame on.
    pub const LOW: Self = Self::Low(Low::new());

    pub const fn is_low(&self) -> bool {
        matches!(self, Self::Low(_) | Self::Overwriting(..))
    }

    /// Whether a set-point was sent that is not acknowledged, or bit 4 is high.
    pub const fn is_under_way(&self) -> bool {
        !matches!(
            self,
            Self::Low(_)
                | Self::High(Raised {
                    stage: Stage::Unsent { .. },
                    ..
                })
        )
    }

    /// The set-point that was sent and is not acknowledged.
    pub const fn on_its_way(&self) -> Option<&Sent> {
        match self {
            Self::High(Raised {
                stage: Stage::Unsent { .. },
                ..
            })
            | Self::Low(_)
            | Self::Abandoned => None,
            Self::High(Raised { sent, .. }) | Self::Overwriting(_, sent) => Some(sent),
        }
    }

    /// The move whose bit 4 has risen in the outputs and was not sent.
    pub const fn unsent(&self) -> Option<CommandId> {
        match self {
            Self::High(Raised {
                sent,
                stage: Stage::Unsent { .. },
            }) => Some(sent.request.id),
            _ => None,
        }
    }

    /// The outputs composed last have been sent.
    pub const fn mark_sent(&mut self) {
        if let Self::High(raised) = self
            && let Stage::Unsent { full, .. } = raised.stage
        {
            raised.stage = Stage::Fresh { full };
        }
    }

    /// A cycle in another mode: a low of bit 4 that the drive has seen there counts for nothing here.
    pub const fn outside(&mut self) {
        if let Self::Low(low) = self {
            *low = Low::new();
        }
    }

    /// Whether the next set-point may follow: bit 4 is low, the drive has surely seen that, and bit 12 is low.
    pub const fn is_free(&self, cycle: &Cycle<'_>) -> bool {
        match self {
            Self::Low(low) => low.is_answered(cycle),
            _ => false,
        }
    }

    /// Whether the drive has surely seen bit 4 low, whatever bit 12 shows.
    pub const fn is_low_seen(&self) -> bool {
        match self {
            Self::Low(low) => low.is_seen(),
            _ => false,
        }
    }

    /// One cycle with inputs.
    pub fn step(&mut self, cycle: &Cycle<'_>) -> HandshakeStep {
        match self {
            Self::Low(low) => {
                low.step(cycle);
                HandshakeStep::None
            }
            Self::High(raised) => {
                let (sent, answer) = (raised.sent, raised.step(cycle));
                match answer {
                    Some(Ok(true)) => self.lower(HandshakeStep::Acknowledged(sent)),
                    Some(Ok(false)) => {
                        *self = Self::Overwriting(Low::new(), sent);
                        HandshakeStep::None
                    }
                    Some(Err(failure)) => self.lower(HandshakeStep::GivenUp(sent, failure)),
                    None => HandshakeStep::None,
                }
            }
            Self::Overwriting(low, sent) => {
                low.step(cycle);
                sent.answer.pass(cycle.elapsed);
                let sent = *sent;
                if low.is_answered(cycle) {
                    // Its low is seen already.
                    *self = Self::Low(*low);
                    HandshakeStep::Acknowledged(sent)
                } else if sent.answer.is_over() {
                    let low = *low;
                    *self = Self::Low(low);
                    HandshakeStep::GivenUp(sent, unacknowledged(cycle))
                } else {
                    HandshakeStep::None
                }
            }
            Self::Abandoned => HandshakeStep::None,
        }
    }

    const fn lower(&mut self, answer: HandshakeStep) -> HandshakeStep {
        *self = Self::LOW;
        answer
    }

    /// When it has something to do without a word of the drive.
    pub const fn due(&self) -> Due {
        match self {
            Self::Low(low) if !low.seen.is_delivered() => Due::NEXT,
            Self::Low(low) => low.seen.due(),
            Self::High(_) | Self::Overwriting(..) => Due::NEXT,
            Self::Abandoned => Due::NEVER,
        }
    }
}

impl Raised {
    /// Whether it is acknowledged, or goes on as one on a full buffer; or why it is given up.
    fn step(&mut self, cycle: &Cycle<'_>) -> Option<Result<bool, Failure>> {
        let high = cycle.evidence.acknowledge.shows_high();
        self.sent.answer.pass(cycle.elapsed);
        match &mut self.stage {
            Stage::Unsent { .. } => return None,
            // What the frame shows that brings bit 4 is from before it, and no answer.
            &mut Stage::Fresh { full } => {
                self.sent.answer = cycle.rules.timer(cycle.rules.acknowledge);
                let early = high.then_some(UntilSeen::UNDELIVERED);
                self.stage = if full {
                    Stage::Full(Full::NEW)
                } else {
                    Stage::Awaited { early }
                };
                return None;
            }
            Stage::Awaited { early } => {
                *early = early.filter(|_| high);
                // D1: what was high that early may be wrong, and so may the low before it.
                if let Some(early) = early {
                    early.update(cycle.delivered, cycle.elapsed, cycle.rules.seen());
                }
                if high && early.is_none_or(UntilSeen::is_seen) {
                    return Some(Ok(true));
                }
            }
            Stage::Full(full) => {
                // A place became free before the drive took it: its edge will come. One word may be wrong.
                full.fell = match full.fell {
                    _ if high => None,
                    None => Some(cycle.rules.seen()),
                    Some(mut fell) => {
                        fell.pass(cycle.elapsed);
                        Some(fell)
                    }
                };
                let seen = cycle.rules.seen();
                full.seen.update(cycle.delivered, cycle.elapsed, seen);
                full.shown += u8::from(full.seen.is_seen());
                if full.fell.is_some_and(Timer::is_over) {
                    self.stage = Stage::Awaited { early: None };
                } else if full.shown > SHOWN_AFTER {
                    // One that replaces none finds no place in a full buffer.
                    return Some(if self.sent.request.replaces() {
                        Ok(false)
                    } else {
                        Err(unacknowledged(cycle))
                    });
                }
            }
        }
        let late = self.sent.answer.is_over();
        late.then(|| Err(unacknowledged(cycle)))
    }
}

/// Bit 12 has not answered in its time.
const fn unacknowledged(cycle: &Cycle<'_>) -> Failure {
    cycle.unknown(Doubt::Unacknowledged)
}
