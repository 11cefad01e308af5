//! Stops: bit 8, quick stop, and in the end Disable voltage; how far one is, and who waits for it.
//!
//! A stop has until [`Deadlines::standstill`](super::Deadlines::standstill): bit 8 for three quarters of that at most, then quick stop. An axis that
//! was not seen to stand by then loses its power. A drive that ignores either word is found out earlier, by the speed of the axis
//! (decisions 19 and 20).

use crate::{
    Failure,
    ds402::State,
    profile_position::{CommandId, Completion, Delivery, WaitingFor},
    timer::{Due, Elapsed, Timer, UntilSeen, nanoseconds},
};

#[cfg(feature = "std")]
use super::command::StopRequest;
use super::{deceleration::DecelerationMonitor, machines::Step, power::is_down};

/// Commands that can wait for one standstill.
const WAITERS: usize = 8;

/// Between its arrival and its rest an axis without a set-point is within so many position windows: more is a motion, and is
/// stopped.
const SETTLES_WITHIN: u32 = 4;

/// How far a stop is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum StopPhase {
    /// No stop is under way; the axis may be halted.
    None,
    /// Bit 8, with the quick stop to follow at standstill or then. Of an axis that is known to move for nothing, where it was: if it comes
    /// to rest there, there is nothing to abandon.
    Halting { left: Timer, from: Option<i32> },
    /// Bit 2 is low.
    Quick { left: Timer },
    /// The drive stops the axis by itself, or has left it without power.
    Settling { left: Timer },
    /// Voltage is being disabled: after the quick stop, or in place of one that does not stop the axis.
    Off { left: Timer },
}

/// What a waiter waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Wait {
    /// Standstill with bit 8. `holds`: the axis is then to be held there.
    Halt { left: Timer, holds: bool },
    /// The end of the stop.
    Stop,
    /// The standstill of an axis whose stop was overtaken by a fault.
    Faulted(Failure),
}

/// Bit 8.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) struct Halt {
    pub is_on: bool,
    seen: UntilSeen,
    /// Nobody waits for it: liveness, a stop handle.
    pub unwatched: bool,
    /// It is the stop's own, and falls again where there is nothing to abandon.
    pub lent: bool,
    /// It falls when the drive has taken the set-point of this command, which keeps the axis where it stands.
    pub holds: Option<CommandId>,
    /// What it does.
    deceleration: DecelerationMonitor,
}

impl Halt {
    pub const OFF: Self = Self {
        is_on: false,
        seen: UntilSeen::UNDELIVERED,
        unwatched: false,
        lent: false,
        holds: None,
        deceleration: DecelerationMonitor::new(),
    };

    /// Whether the drive has surely seen it.
    pub const fn is_seen(&self) -> bool {
        self.seen.is_seen()
    }
}

/// Bit 2 low.
#[derive(Debug, Clone, Copy, Hash)]
struct QuickStop {
    seen: UntilSeen,
    deceleration: DecelerationMonitor,
}

impl QuickStop {
    const NEW: Self = Self {
        seen: UntilSeen::UNDELIVERED,
        deceleration: DecelerationMonitor::new(),
    };
}

/// The stops of an axis.
#[derive(Debug, Clone, Hash)]
pub(super) struct Stopping {
    pub phase: StopPhase,
    /// The axis is to be disabled at the end.
    pub off: bool,
    pub halt: Halt,
    /// That bit 8 is low (S7).
    released: UntilSeen,
    quick: QuickStop,
    waiters: [Option<(CommandId, Wait)>; WAITERS],
}

/// What a cycle of a stop comes to.
#[derive(Clone, Copy)]
pub(super) enum StopStep {
    Nothing,
    /// The axis stands halted.
    Halted,
    /// The drive has surely seen bit 8 just now.
    HaltSeen,
    /// It is over, and the drive is where it was led.
    Over,
    /// The axis stands where it was: nothing was to be abandoned.
    OverHalted,
    /// Quick stop follows.
    Quick,
    /// The axis stands in Quick stop active, or its drive is off.
    QuickStopped,
    /// The axis was not stopped in time: without voltage the drive at least drives it no further.
    GiveUp(Failure),
    /// Those who wait fail; the drive has no power.
    Fail(Failure),
    /// The axis is driven by somebody else, or moves: it is stopped as well.
    StopAgain,
}

impl Stopping {
    pub const fn new() -> Self {
        Self {
            phase: StopPhase::None,
            off: false,
            halt: Halt::OFF,
            released: UntilSeen::SEEN,
            quick: QuickStop::NEW,
            waiters: [None; WAITERS],
        }
    }

    pub const fn is_quick(&self) -> bool {
        matches!(self.phase, StopPhase::Quick { .. })
    }

    pub const fn is_switching_off(&self) -> bool {
        matches!(self.phase, StopPhase::Off { .. })
    }

    pub const fn is_active(&self) -> bool {
        !matches!(self.phase, StopPhase::None)
    }

    /// The strongest stop that is under way.
    #[cfg(feature = "std")]
    pub const fn under_way(&self) -> StopRequest {
        match self.phase {
            StopPhase::None if self.halt.is_on => StopRequest::HALT,
            StopPhase::None => StopRequest::empty(),
            StopPhase::Halting { .. } => StopRequest::STOP,
            StopPhase::Quick { .. } | StopPhase::Settling { .. } | StopPhase::Off { .. } => {
                StopRequest::QUICK_STOP
            }
        }
    }

    /// Whether anybody waits for the axis to stand, or a stop is under way.
    pub fn awaits_standstill(&self) -> bool {
        self.is_active() || !self.has_no_waiter()
    }

    /// Bit 8 rises.
    pub const fn begin_halt(&mut self) {
        self.halt = Halt {
            is_on: true,
            ..Halt::OFF
        };
    }

    /// Bit 8 was sent low.
    pub const fn release(&mut self) {
        self.halt = Halt::OFF;
        self.released = UntilSeen::UNDELIVERED;
    }

    /// Whether bit 8 is high, or its low not surely seen.
    pub const fn is_halted(&self) -> bool {
        self.halt.is_on || !self.released.is_seen()
    }

    /// Bit 2 falls, and the axis is to stand by then.
    pub const fn begin_quick(&mut self, left: Timer) {
        self.phase = StopPhase::Quick { left };
        self.quick = QuickStop::NEW;
    }

    /// How long the stop under way may still take; all of its time where there is none.
    pub fn left(&self, step: &Step<'_>) -> Timer {
        match self.phase {
            StopPhase::Quick { left } | StopPhase::Settling { left } => left,
            StopPhase::Halting { left, .. } => left.later(quarter(step)),
            StopPhase::None | StopPhase::Off { .. } => step.deadline(),
        }
    }

    /// One cycle of bit 8 and of who waits for it.
    pub fn step_halt(&mut self, step: &Step<'_>, has_motion: bool) -> StopStep {
        if !self.halt.is_on {
            return StopStep::Nothing;
        }
        let halt = &mut self.halt;
        let was_seen = halt.is_seen();
        let delivered = step.delivered && step.sends_halt();
        halt.seen.update(delivered, step.elapsed, step.seen);
        if !halt.is_seen() {
            return StopStep::Nothing;
        }
        if !was_seen && has_motion {
            // With a set-point that may have set it off just before, rest counts from now on.
            return StopStep::HaltSeen;
        }
        if step.stands() {
            halt.deceleration = DecelerationMonitor::new();
            return StopStep::Halted;
        }
        halt.deceleration
            .update(step.elapsed, step.position(), step.bounds);
        if self.halt.unwatched && self.ignores_halt() {
            return StopStep::Quick;
        }
        StopStep::Nothing
    }

    /// One cycle of bit 8 that was sent low.
    pub fn note_release(&mut self, step: &Step<'_>) {
        let released = step.delivered && !step.sends_halt();
        self.released.update(released, step.elapsed, step.seen);
    }

    /// Whether the axis is as fast with bit 8 as it was.
    pub const fn ignores_halt(&self) -> bool {
        self.halt.deceleration.ignores_stop()
    }

    /// Whether bit 8 has brought the axis to rest.
    pub const fn stands_halted(&self, step: &Step<'_>) -> bool {
        self.halt.is_on && self.halt.is_seen() && step.stands()
    }

    /// One cycle of a stop.
    pub fn step(&mut self, step: &Step<'_>) -> StopStep {
        let stands_halted = self.stands_halted(step);
        let state = step.state;
        let elapsed = step.elapsed;
        match &mut self.phase {
            StopPhase::None => StopStep::Nothing,
            StopPhase::Halting { left, from } => {
                left.pass(elapsed);
                let near = step.bounds.position.saturating_mul(SETTLES_WITHIN);
                *from = from.filter(|&from| step.bounds.distance(from, step.position()) <= near);
                let (is_late, lent) = (left.is_over(), from.is_some());
                if lent && stands_halted {
                    StopStep::OverHalted
                } else if stands_halted || is_late || self.ignores_halt() {
                    // Quick stop has the rest of the time.
                    StopStep::Quick
                } else {
                    StopStep::Nothing
                }
            }
            StopPhase::Quick { left } => {
                left.pass(elapsed);
                let is_late = left.is_over();
                let holds = state == State::QuickStopActive
                    && step.config.quick_stop.stays_in_quick_stop_active();
                let off = matches!(state, State::NotReadyToSwitchOn | State::SwitchOnDisabled);
                if (holds && step.stands()) || (off && step.is_at_rest()) {
                    StopStep::QuickStopped
                } else if self.ignores_quick_stop(step) {
                    StopStep::GiveUp(Failure::QuickStopIgnored)
                } else if !is_late {
                    StopStep::Nothing
                } else if step.stands() && state == State::QuickStopActive {
                    // A drive that stays there although 605Ah said otherwise when it was read is believed in the end.
                    StopStep::QuickStopped
                } else if state == State::OperationEnabled && self.quick.seen.is_delivered() {
                    StopStep::GiveUp(Failure::QuickStopIgnored)
                } else {
                    StopStep::GiveUp(step.timeout(step.standstill(), Delivery::NotSent))
                }
            }
            StopPhase::Settling { left } => {
                left.pass(elapsed);
                let powered = matches!(state, State::OperationEnabled | State::QuickStopActive);
                let has_no_power = is_down(state) || state.is_fault();
                if powered && !step.disables() {
                    StopStep::StopAgain
                } else if step.is_at_rest_for_good() && (!self.off || has_no_power) {
                    StopStep::Over
                } else if left.is_over() {
                    StopStep::Fail(step.timeout(step.standstill(), Delivery::NotSent))
                } else {
                    StopStep::Nothing
                }
            }
            StopPhase::Off { left } => {
                left.pass(elapsed);
                if is_down(state) && step.is_at_rest() {
                    StopStep::Over
                } else if left.is_over() && is_down(state) {
                    StopStep::Fail(step.timeout(step.standstill(), Delivery::NotSent))
                } else if left.is_over() {
                    let waiting_for = WaitingFor::State(State::SwitchOnDisabled);
                    StopStep::Fail(step.timeout(waiting_for, Delivery::NotSent))
                } else {
                    StopStep::Nothing
                }
            }
        }
    }

    /// Whether the drive stays in Operation enabled although it has surely seen the quick stop, and the axis gets no slower.
    fn ignores_quick_stop(&mut self, step: &Step<'_>) -> bool {
        if step.state != State::OperationEnabled {
            self.quick = QuickStop::NEW;
            return false;
        }
        let quick = &mut self.quick;
        let delivered = step.delivered && step.sends_quick_stop();
        quick.seen.update(delivered, step.elapsed, step.seen);
        if step.stands() {
            quick.deceleration = DecelerationMonitor::new();
        } else if quick.seen.is_seen() {
            quick
                .deceleration
                .update(step.elapsed, step.position(), step.bounds);
        }
        quick.deceleration.ignores_stop()
    }

    /// Time passes for those who wait for a halt; the first whose time is over.
    pub fn pass_time_of_waiters(&mut self, step: &Step<'_>) -> Option<CommandId> {
        for (_, wait) in self.waiters.iter_mut().flatten() {
            if let Wait::Halt { left, .. } = wait {
                left.pass(step.elapsed);
            }
        }
        self.take_waiter(|wait| matches!(wait, Wait::Halt { left, .. } if left.is_over()))
    }

    /// Adds a waiter; false when there is no room. One that waits already waits on.
    pub fn wait(&mut self, id: CommandId, wait: Wait) -> bool {
        let mut waiting = self.waiters.iter().flatten();
        if waiting.any(|(waiter, _)| *waiter == id) {
            return true;
        }
        match self.waiters.iter_mut().find(|place| place.is_none()) {
            Some(place) => {
                *place = Some((id, wait));
                true
            }
            None => false,
        }
    }

    /// A fault overtakes every stop: whoever waits for one waits for the standstill, and hears of the fault then.
    pub fn fault(&mut self, failure: Failure, step: &Step<'_>) {
        let mut waits = false;
        for (_, wait) in self.waiters.iter_mut().flatten() {
            if *wait == Wait::Stop {
                *wait = Wait::Faulted(failure);
            }
            waits |= matches!(wait, Wait::Faulted(_));
        }
        let left = self.left(step);
        self.off = false;
        self.phase = if waits {
            StopPhase::Settling { left }
        } else {
            StopPhase::None
        };
    }

    /// Whoever waits for a halt waits for the standstill alone. Whether there is anybody.
    pub fn halts_become_stops(&mut self) -> bool {
        let mut waits = false;
        for (_, wait) in self.waiters.iter_mut().flatten() {
            if matches!(wait, Wait::Halt { .. }) {
                *wait = Wait::Stop;
                waits = true;
            }
        }
        waits
    }

    /// Whether the axis is to be held where it is halted.
    pub fn is_to_hold(&self) -> bool {
        let mut waiting = self.waiters.iter().flatten();
        self.halt.holds.is_some()
            || waiting.any(|(_, wait)| matches!(wait, Wait::Halt { holds: true, .. }))
    }

    /// Whether that is so for this command.
    pub fn is_to_hold_for(&self, id: CommandId) -> bool {
        let mut waiting = self.waiters.iter().flatten();
        self.halt.holds == Some(id) || waiting.any(|(waiter, _)| *waiter == id)
    }

    /// Takes the one that waits to hold the axis where it is halted.
    pub fn take_hold(&mut self) -> Option<CommandId> {
        self.take_waiter(|wait| matches!(wait, Wait::Halt { holds: true, .. }))
    }

    /// Takes one waiter, and the answer that it is to get in place of the end of its stop.
    pub fn next_waiter(&mut self) -> Option<(CommandId, Option<Failure>)> {
        let (id, wait) = self.take(|_| true)?;
        let failure = match wait {
            Wait::Faulted(failure) => Some(failure),
            Wait::Stop | Wait::Halt { .. } => None,
        };
        Some((id, failure))
    }

    pub fn has_no_waiter(&self) -> bool {
        self.waiters.iter().all(Option::is_none)
    }

    /// Takes one waiter for which `which` holds.
    pub fn take_waiter(&mut self, which: impl Fn(Wait) -> bool) -> Option<CommandId> {
        self.take(which).map(|(id, _)| id)
    }

    fn take(&mut self, which: impl Fn(Wait) -> bool) -> Option<(CommandId, Wait)> {
        let mut places = self.waiters.iter_mut();
        let place = places.find(|place| place.is_some_and(|(_, wait)| which(wait)))?;
        place.take()
    }

    /// When it has something to do without a word of the drive.
    pub fn due(&self) -> Due {
        let waits = self.is_active() || self.halt.is_on || !self.has_no_waiter();
        Due::next_if(waits || !self.released.is_delivered()).sooner(self.released.due())
    }
}

/// What a stop that has ended well says.
pub(super) const fn stopped(state: State) -> Result<Completion, Failure> {
    Ok(Completion::Stopped { state })
}

/// A quarter of the time that a stop has: bit 8 leaves it for quick stop.
pub(super) const fn quarter(step: &Step<'_>) -> Elapsed {
    Elapsed(nanoseconds(step.config.deadlines.standstill) / 4)
}
