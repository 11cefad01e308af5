//! Profile Velocity: jogging, a velocity for as long as it is held (mode 3; CiA 402-2, "Profile velocity mode").
//!
//! The types and the machine that owns the target velocity 60FFh are pure.

use core::time::Duration;

#[cfg(feature = "std")]
pub use crate::handle::Jog;
use crate::{
    Failure,
    ds402::State,
    profile_position::{
        CommandId, Completion, Cycle, Delivery, Event, Events, ParameterFault, Parameters,
    },
    timer::{Due, Timer, UntilSeen},
    units::{AxisUnit, Counts, Quantity, Scale, ScaleError, Unit},
};

// What one jog asks of a drive.

/// A velocity and the ramps to it in the unit of the axis: whole numbers for [`Counts`], `f64` for others. Ramps that are left out are
/// what the drive holds.
///
/// ```
/// use servocrab::{profile_velocity::JogSetPoint, units::Mm};
/// let backwards: JogSetPoint = JogSetPoint::new(-5_000).acceleration(20_000).deceleration(40_000);
/// assert_eq!(backwards.velocity, -5_000);
/// let in_mm: JogSetPoint<Mm> = JogSetPoint::new(-5.5);
/// assert_eq!(in_mm, (-5.5).into());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct JogSetPoint<U: AxisUnit = Counts> {
    /// Target velocity 60FFh; its sign is the direction, and 0 stands.
    pub velocity: U::Signed,
    /// Profile acceleration 6083h; more than 0.
    pub acceleration: Option<U::Magnitude>,
    /// Profile deceleration 6084h; more than 0.
    pub deceleration: Option<U::Magnitude>,
    /// After so long without a word of its holder ([`Jog::hold`](crate::profile_velocity::Jog::hold) or
    /// [`Jog::set`](crate::profile_velocity::Jog::set)) the owner of the cycle lets the jog go. None: it is held until it is dropped.
    pub dead_man: Option<Duration>,
}

/// Dead-man times that a jog may have.
const LEAST_DEAD_MAN: Duration = Duration::from_millis(1);
const MOST_DEAD_MAN: Duration = Duration::from_secs(10);

impl<U: AxisUnit> JogSetPoint<U> {
    /// This velocity (60FFh), with the ramps that the drive holds.
    #[must_use]
    pub const fn new(velocity: U::Signed) -> Self {
        Self {
            velocity,
            acceleration: None,
            deceleration: None,
            dead_man: None,
        }
    }

    /// Let go by the owner of the cycle once its holder is silent for longer than this: for a holder that may freeze, or whose messages
    /// may be late. The target velocity 60FFh is 0 in the next frame then, and the jog fails as [`Failure::NotHeld`]. A time of less than
    /// a millisecond or more than ten seconds is refused as [`Failure::Parameter`] when the jog is asked for.
    #[must_use]
    pub const fn dead_man(mut self, time: Duration) -> Self {
        self.dead_man = Some(time);
        self
    }

    /// With this profile acceleration (6083h).
    #[must_use]
    pub const fn acceleration(mut self, acceleration: U::Magnitude) -> Self {
        self.acceleration = Some(acceleration);
        self
    }

    /// With this profile deceleration (6084h).
    #[must_use]
    pub const fn deceleration(mut self, deceleration: U::Magnitude) -> Self {
        self.deceleration = Some(deceleration);
        self
    }

    /// Whether its dead-man time is one by which a hand is seen to let go.
    pub(crate) fn check_dead_man(&self) -> Result<(), Failure> {
        match self.dead_man {
            Some(got) if !(LEAST_DEAD_MAN..=MOST_DEAD_MAN).contains(&got) => {
                Err(Failure::Parameter {
                    name: "the dead-man time of a jog",
                    fault: ParameterFault::OutOfRange("at least 1 ms and at most 10 s"),
                })
            }
            _ => Ok(()),
        }
    }

    /// The same in the drive's units.
    ///
    /// # Errors
    /// The first of its numbers that cannot be converted, with its object.
    pub fn in_counts(&self, scale: &Scale) -> Result<JogSetPoint, ScaleError> {
        Ok(JogSetPoint {
            velocity: scale.target_velocity(self.velocity.into())?,
            acceleration: scale.ramp(Quantity::Acceleration, self.acceleration)?,
            deceleration: scale.ramp(Quantity::Deceleration, self.deceleration)?,
            dead_man: self.dead_man,
        })
    }
}

impl From<i32> for JogSetPoint {
    fn from(velocity: i32) -> Self {
        Self::new(velocity)
    }
}

impl<U: Unit> From<f64> for JogSetPoint<U> {
    fn from(velocity: f64) -> Self {
        Self::new(velocity)
    }
}

// The target velocity 60FFh: what a jog asks for while it is held, and 0 at all other times.
//
// Contract: the axis core puts [`Jogging::velocity`] and [`Jogging::ramps`] into the next outputs, and calls
// [`Jogging::step`] in every cycle with fresh inputs in Operation enabled with mode 3 shown. Mode 3 has no bits of its own
// in the controlword: what is in 60FFh is followed at once, so that nothing but 0 may ever stay there.

/// Where the jog is.
#[derive(Debug, Clone, Copy, Hash)]
enum JogPhase {
    /// No jog: the target velocity is 0.
    Idle,
    /// Held.
    Held {
        id: CommandId,
        velocity: i32,
        sent: bool,
        /// Its first velocity is known to have been delivered.
        accepted: bool,
        holder: Option<Holder>,
    },
    /// Let go: the target velocity is 0, and the axis comes to rest.
    Released(LetGo),
}

/// A jog that was let go.
#[derive(Debug, Clone, Copy, Hash)]
struct LetGo {
    id: CommandId,
    /// Until the axis has to be at rest.
    left: Timer,
    /// The 0.
    seen: UntilSeen,
    sent: bool,
    /// By its dead-man time, and not by its holder.
    by_itself: bool,
}

/// Who holds a jog with a dead-man time.
#[derive(Debug, Clone, Copy, Hash)]
struct Holder {
    dead_man: Duration,
    /// How often it has said that it holds the jog, and when that was first seen.
    said: Option<(u32, Duration)>,
}

impl Holder {
    /// Whether it has been silent for too long.
    fn is_silent(&mut self, now: Duration, times: u32) -> bool {
        match self.said {
            Some((said, since)) if said == times => now.saturating_sub(since) > self.dead_man,
            _ => {
                self.said = Some((times, now));
                false
            }
        }
    }
}

/// The jog of one drive axis.
#[derive(Debug, Clone, Hash)]
pub(crate) struct Jogging {
    stage: JogPhase,
    /// The one that the next takes over from, until that is sent.
    before: Option<LetGo>,
    ramps: Parameters,
    /// What they were before the one that is held, until that is sent: an axis that comes to rest does so by these, should it be given up.
    ramps_before: Option<Parameters>,
}

impl Jogging {
    pub fn new() -> Self {
        Self {
            stage: JogPhase::Idle,
            before: None,
            ramps: Parameters::default(),
            ramps_before: None,
        }
    }

    /// Target velocity 60FFh of the next outputs.
    pub const fn velocity(&self) -> i32 {
        match self.stage {
            JogPhase::Held { velocity, .. } => velocity,
            JogPhase::Idle | JogPhase::Released(_) => 0,
        }
    }

    /// Profile acceleration and deceleration of the next outputs, where a jog has given them.
    pub const fn ramps(&self) -> &Parameters {
        &self.ramps
    }

    /// The jog that is held or coming to rest.
    pub const fn id(&self) -> Option<CommandId> {
        match self.stage {
            JogPhase::Idle => None,
            JogPhase::Held { id, .. } | JogPhase::Released(LetGo { id, .. }) => Some(id),
        }
    }

    /// Whether the drive follows a velocity, or has not come to rest from it.
    pub const fn has_motion(&self) -> bool {
        match self.stage {
            JogPhase::Idle => false,
            JogPhase::Held { sent, .. } => sent || self.before.is_some(),
            JogPhase::Released(_) => true,
        }
    }

    pub const fn is_held(&self) -> bool {
        matches!(self.stage, JogPhase::Held { .. })
    }

    /// Whether its holder must say again and again that it holds the jog.
    pub const fn has_dead_man(&self) -> bool {
        matches!(
            self.stage,
            JogPhase::Held {
                holder: Some(_),
                ..
            }
        )
    }

    /// Whether one is in the outputs, or its 0, that no frame has brought.
    pub const fn is_unsent(&self) -> bool {
        matches!(
            self.stage,
            JogPhase::Held { sent: false, .. } | JogPhase::Released(LetGo { sent: false, .. })
        )
    }

    pub const fn is_released(&self) -> bool {
        matches!(self.stage, JogPhase::Released(_))
    }

    pub const fn is_idle(&self) -> bool {
        matches!(self.stage, JogPhase::Idle)
    }

    /// When it has something to do without a word of the drive.
    pub const fn due(&self) -> Due {
        let rests = matches!(
            self.stage,
            JogPhase::Idle | JogPhase::Held { accepted: true, .. }
        );
        Due::next_if(!rests)
    }

    /// Takes a checked jog in: its velocity is in the next outputs. It may take over from one that comes to rest, not from one
    /// that is held.
    pub fn submit(&mut self, id: CommandId, set_point: JogSetPoint, events: &mut Events) {
        match self.stage {
            JogPhase::Held { .. } => {
                events.push(id, Event::Done(Err(Failure::Busy)));
                return;
            }
            // One that was not sent took over from nothing.
            JogPhase::Released(let_go) if self.before.is_some() => {
                events.push(let_go.id, Event::Done(Err(Failure::Superseded)));
            }
            JogPhase::Released(let_go) => self.before = Some(let_go),
            JogPhase::Idle => {}
        }
        self.ramps_before.get_or_insert(self.ramps);
        self.ramps = Parameters {
            acceleration: set_point.acceleration,
            deceleration: set_point.deceleration,
            ..Parameters::default()
        };
        self.stage = JogPhase::Held {
            id,
            velocity: set_point.velocity,
            sent: false,
            accepted: false,
            holder: set_point.dead_man.map(|dead_man| Holder {
                dead_man,
                said: None,
            }),
        };
    }

    /// Another velocity, from the next outputs on; false if this jog is not held any more.
    pub fn set(&mut self, of: CommandId, new: i32) -> bool {
        match &mut self.stage {
            JogPhase::Held { id, velocity, .. } if *id == of => {
                *velocity = new;
                true
            }
            _ => false,
        }
    }

    /// Whether the holder of this jog, which has said so many times that it holds it, has been silent for longer than its dead-man time.
    pub fn is_silent(&mut self, now: Duration, of: CommandId, times: u32) -> bool {
        match &mut self.stage {
            JogPhase::Held {
                id,
                holder: Some(holder),
                ..
            } if *id == of => holder.is_silent(now, times),
            _ => false,
        }
    }

    /// Lets go: 0 from the next outputs on, and `left` until the axis has to be at rest. False if this jog is not held any more.
    /// `by_itself`: by its dead-man time.
    pub fn release(&mut self, of: CommandId, left: Timer, by_itself: bool) -> bool {
        match self.stage {
            JogPhase::Held { id, .. } if id == of => {
                self.stage = JogPhase::Released(LetGo {
                    id,
                    left,
                    seen: UntilSeen::UNDELIVERED,
                    sent: false,
                    by_itself,
                });
                true
            }
            _ => false,
        }
    }

    /// Withdraws a jog that has not been sent; whether there was one.
    pub fn withdraw(&mut self, of: CommandId, failure: Failure, events: &mut Events) -> bool {
        let unsent = matches!(self.stage, JogPhase::Held { id, sent: false, .. } if id == of);
        if unsent {
            // What it was to take over from comes to rest as before.
            let before = self.before.take();
            self.end(failure, events);
            self.stage = before.map_or(JogPhase::Idle, JogPhase::Released);
        }
        unsent
    }

    /// The outputs composed last have been sent.
    #[inline(always)]
    pub fn mark_sent(&mut self, events: &mut Events) {
        if !self.is_idle() {
            self.mark_jog_sent(events);
        }
    }

    fn mark_jog_sent(&mut self, events: &mut Events) {
        if let JogPhase::Held { sent, .. } | JogPhase::Released(LetGo { sent, .. }) =
            &mut self.stage
        {
            *sent = true;
        }
        self.ramps_before = None;
        if let Some(before) = self.before.take() {
            events.push(before.id, Event::Done(Err(Failure::Superseded)));
        }
    }

    /// Ends it with this failure, which says how far it came; 0 from the next outputs on.
    pub fn end(&mut self, failure: Failure, events: &mut Events) {
        if let Some(ramps) = self.ramps_before.take() {
            self.ramps = ramps;
        }
        if let Some(before) = self.before.take() {
            let failure = failure.with_delivery(Delivery::Accepted);
            events.push(before.id, Event::Done(Err(failure)));
        }
        let (id, delivery) = match self.stage {
            JogPhase::Idle => return,
            JogPhase::Held {
                id, sent: false, ..
            } => (id, Delivery::NotSent),
            JogPhase::Held {
                id,
                accepted: false,
                ..
            } => (id, Delivery::Unknown),
            JogPhase::Held { id, .. } | JogPhase::Released(LetGo { id, .. }) => {
                (id, Delivery::Accepted)
            }
        };
        self.stage = JogPhase::Idle;
        events.push(id, Event::Done(Err(failure.with_delivery(delivery))));
    }

    /// One cycle with inputs in Operation enabled and mode 3.
    pub fn step(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> JogStep {
        match &mut self.stage {
            JogPhase::Held {
                id,
                sent: true,
                accepted,
                ..
            } if cycle.delivered && !*accepted => {
                *accepted = true;
                events.push(*id, Event::Accepted);
            }
            JogPhase::Released(let_go) if let_go.sent => {
                let_go.left.pass(cycle.elapsed);
                let (id, by_itself) = (let_go.id, let_go.by_itself);
                let before = let_go.seen;
                let seen = cycle.rules.seen();
                let_go.seen.update(cycle.delivered, cycle.elapsed, seen);
                if !before.is_delivered() {
                    return self.judge_late(cycle, events);
                }
                let was_seen = before.is_seen();
                if let_go.seen.is_seen() && !was_seen {
                    // What the drive shows before it has taken the 0 in may be the rest from which it is only just starting.
                    return JogStep::Seen;
                }
                if was_seen && cycle.evidence.stands() {
                    self.stage = JogPhase::Idle;
                    let state = State::OperationEnabled;
                    let result = if by_itself {
                        Err(Failure::NotHeld)
                    } else {
                        Ok(Completion::Stopped { state })
                    };
                    events.push(id, Event::Done(result));
                    return JogStep::GoOn;
                }
                return self.judge_late(cycle, events);
            }
            _ => {}
        }
        JogStep::GoOn
    }

    /// Whether the axis has not come to rest in time.
    fn judge_late(&mut self, cycle: &Cycle<'_>, events: &mut Events) -> JogStep {
        let JogPhase::Released(LetGo { left, .. }) = self.stage else {
            return JogStep::GoOn;
        };
        if !left.is_over() {
            return JogStep::GoOn;
        }
        self.end(
            cycle.timeout(cycle.standstill(), Delivery::Accepted),
            events,
        );
        JogStep::RunsOn
    }
}

/// What a cycle of a jog comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum JogStep {
    GoOn,
    /// The drive has surely seen the 0 of one that was let go.
    Seen,
    /// The axis does not come to rest: stop it.
    RunsOn,
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod set_point_tests {
    use super::*;
    use crate::units::{Mm, example as mm};

    #[test]
    fn a_velocity_keeps_its_direction_and_each_ramp_has_the_factor_of_accelerations() {
        let asked = JogSetPoint::<Mm>::new(-1.25)
            .acceleration(10.0)
            .deceleration(14.0);
        let expected = JogSetPoint::new(-13).acceleration(3).deceleration(4);
        assert_eq!(asked.in_counts(&mm()), Ok(expected));
        assert_eq!(
            JogSetPoint::<Mm>::from(1.25).in_counts(&mm()),
            Ok(13.into())
        );
        let ramp = JogSetPoint::<Mm>::new(1.0).deceleration(-10.0);
        assert!(matches!(
            ramp.in_counts(&mm()),
            Err(ScaleError::OutOfRange {
                quantity: Quantity::Deceleration,
                ..
            })
        ));
    }
}
