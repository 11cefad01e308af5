//! A command on its way: a handle makes it, the axis core carries it out, and its result is in it when it comes back.
//!
//! The program may give it up, and a stop may be asked for again, while the bus thread has it. Each such pair of a program thread and the
//! bus thread meets in one atomic, by an exchange on both sides. So one of the two comes first, and both know which.

use core::fmt;

use crate::{
    Failure,
    axis::{Command, CommandId, Completion, Delivery},
    sync::{
        AtomicU8, AtomicU32, AtomicU64, OnceLock,
        Ordering::{AcqRel, Acquire, Release},
    },
};

use super::stops::{LastStop, StopKind};

/// The channel of futures that wait for a change of their axis. Those of requests have the other channels.
pub(super) const CHANGED: u32 = 0;

// How far a request has come.

const QUEUED: u8 = 0;
/// The program gave it up before the bus thread took it.
const GIVEN_UP: u8 = 1;
/// The bus thread took it, and may have sent its set-point.
const TAKEN: u8 = 2;
/// The drive has acknowledged its set-point.
const ACCEPTED: u8 = 3;

// Whether a request was given up after the bus thread took it.

const WITHDRAW: u8 = 1;
/// A motion that was sent is to be stopped.
const END: u8 = 2;

/// Set beside the generation of a stop once that stop has ended.
const OVER: u64 = 1 << 63;
/// Set above the velocity of a jog while it is held. Above it is counted how often its holder has said so.
const HELD: u64 = 1 << 32;
const SAID_ONCE: u64 = 1 << 33;

pub(super) struct AxisRequest {
    pub id: CommandId,
    pub command: Command,
    /// The number of the axis' lease when this was made.
    pub lease: u64,
    /// The last stop when this was asked for. In a stop: that stop, as it was asked for last.
    asked: AtomicU64,
    stage: AtomicU8,
    withdrawal: AtomicU8,
    /// How many futures wait for it: several for a stop.
    waiting: AtomicU32,
    /// How often the axis stood halted with this move's set-point kept.
    pub halts: AtomicU32,
    /// Position and torque of the contact that ends a move.
    contact: OnceLock<(i32, i16)>,
    /// Of a jog.
    demand: AtomicU64,
    /// Only the bus thread sets it, and nobody waits in it: that takes no lock.
    result: OnceLock<Result<Completion, Failure>>,
}

impl AxisRequest {
    pub fn new(id: CommandId, command: Command, lease: u64, asked: LastStop) -> Self {
        let velocity = match command {
            Command::Jog(set_point) => set_point.velocity,
            _ => 0,
        };
        Self {
            id,
            command,
            lease,
            asked: AtomicU64::new(asked.0),
            stage: AtomicU8::new(QUEUED),
            withdrawal: AtomicU8::new(0),
            waiting: AtomicU32::new(1),
            halts: AtomicU32::new(0),
            contact: OnceLock::new(),
            demand: AtomicU64::new(HELD | u64::from(velocity.cast_unsigned())),
            result: OnceLock::new(),
        }
    }

    /// Where futures wait for it.
    pub const fn channel(&self) -> u32 {
        CHANGED + 1 + self.id.0 % 32
    }

    pub const fn is_stop(&self) -> bool {
        StopKind::of(&self.command).is_some()
    }

    /// Whether it moves the axis.
    pub const fn is_motion(&self) -> bool {
        matches!(
            self.command,
            Command::Move(_) | Command::Home(_) | Command::Jog(_)
        )
    }

    /// See the field.
    pub fn asked(&self) -> LastStop {
        LastStop(self.asked.load(Acquire) & !OVER)
    }

    pub fn result(&self) -> Option<Result<Completion, Failure>> {
        self.result.get().copied()
    }

    /// Position and torque when the torque was seen that has ended this move.
    pub fn contact(&self) -> Option<(i32, i16)> {
        self.contact.get().copied()
    }

    pub fn is_done(&self) -> bool {
        self.result.get().is_some()
    }

    pub fn is_accepted(&self) -> bool {
        self.stage() == ACCEPTED
    }

    fn stage(&self) -> u8 {
        self.stage.load(Acquire)
    }

    /// How far its set-point has come.
    pub fn delivery(&self) -> Delivery {
        match self.stage() {
            ACCEPTED => Delivery::Accepted,
            TAKEN if self.is_motion() => Delivery::Unknown,
            _ => Delivery::NotSent,
        }
    }
}

/// By its number: the rest of it is of no use to a reader of a log.
impl fmt::Debug for AxisRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.id.fmt(f)
    }
}

// The program's side.

impl AxisRequest {
    /// One more waits for this stop, which is asked for again. False if it has ended: then a new one is to begin.
    ///
    /// The end exchanges the same word. Either it comes before this, or it finds this generation.
    pub fn join(&self, stop: LastStop) -> bool {
        // First: where the end finds this generation it finds who waits as well.
        self.waiting.fetch_add(1, AcqRel);
        let next = |asked: u64| (asked & OVER == 0).then_some(asked.max(stop.0));
        self.asked.fetch_update(AcqRel, Acquire, next).is_ok()
    }

    /// One less waits for it.
    pub fn leave(&self) {
        self.waiting.fetch_sub(1, AcqRel);
    }

    /// Gives it up, so far as it was not sent. `ends`: a motion that was sent is stopped.
    pub fn give_up(&self, ends: bool) {
        // The bus thread exchanges the same word to take it. Either it finds it given up and refuses it, or it has it already: then it
        // looks at what is stored here in its next cycle.
        let given_up = self
            .stage
            .compare_exchange(QUEUED, GIVEN_UP, AcqRel, Acquire);
        if given_up.is_err() {
            let withdrawal = if ends { END } else { WITHDRAW };
            self.withdrawal.store(withdrawal, Release);
        }
    }

    /// Whether the drive has taken this motion with its parameters, or will not take it any more.
    pub fn is_over(&self) -> bool {
        match self.stage() {
            GIVEN_UP | ACCEPTED => true,
            // A jog that nobody holds is on its way to 0.
            TAKEN if matches!(self.command, Command::Jog(_)) && !self.is_waited_for() => true,
            _ => self.is_done(),
        }
    }

    /// The holder of a jog says that it holds it, at this velocity or at the one that it has. False once it was let go.
    pub fn hold(&self, velocity: Option<i32>) -> bool {
        let said = |demand: u64| {
            let velocity = velocity.map_or(demand as u32, i32::cast_unsigned);
            let times = demand.wrapping_add(SAID_ONCE) & !u64::from(u32::MAX);
            (demand & HELD != 0).then_some(times | u64::from(velocity))
        };
        self.demand.fetch_update(AcqRel, Acquire, said).is_ok()
    }

    /// A jog is let go.
    pub fn release(&self) {
        self.demand.store(0, Release);
    }
}

// The bus thread's side.

impl AxisRequest {
    /// Takes it. False if it was given up before.
    pub fn take(&self) -> bool {
        let taken = self.stage.compare_exchange(QUEUED, TAKEN, AcqRel, Acquire);
        taken.is_ok()
    }

    /// Whether it was given up after it was taken, which is told once: and then whether a motion that was sent is to be stopped.
    pub fn take_withdrawal(&self) -> Option<bool> {
        let is_given_up = self.withdrawal.load(Acquire) != 0;
        is_given_up.then(|| self.withdrawal.swap(0, AcqRel) == END)
    }

    pub fn note_contact(&self, position: i32, torque: i16) {
        let _ = self.contact.set((position, torque));
    }

    pub fn accept(&self) {
        self.stage.store(ACCEPTED, Release);
    }

    /// The velocity that a jog asks for, and how often its holder has said so. None once it was let go.
    pub fn demand(&self) -> Option<(i32, u32)> {
        let demand = self.demand.load(Acquire);
        (demand & HELD != 0).then_some((demand as u32 as i32, (demand / SAID_ONCE) as u32))
    }

    /// The core has ended what it was given when this was asked for as `taken`. False if it is to be carried out once more, because it is
    /// a stop that was asked for again.
    ///
    /// Then those who wait get what comes of the later stop, unless this one has failed: a failure is theirs at once.
    pub fn end(&self, taken: LastStop, result: Result<Completion, Failure>) -> bool {
        let LastStop(taken) = taken;
        // A halt that an earlier resume has superseded has not failed.
        let goes_on = matches!(result, Ok(_) | Err(Failure::Superseded));
        let before = if goes_on {
            let over = taken | OVER;
            let (Ok(before) | Err(before)) =
                self.asked.compare_exchange(taken, over, AcqRel, Acquire);
            before
        } else {
            self.asked.fetch_or(OVER, AcqRel)
        };
        let is_latest = before & !OVER == taken;
        if is_latest || !goes_on {
            // One that has failed before keeps that.
            let _ = self.result.set(result);
        }
        is_latest
    }

    /// Whether anybody waits for it.
    pub fn is_waited_for(&self) -> bool {
        self.waiting.load(Acquire) != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stop() -> AxisRequest {
        AxisRequest::new(CommandId(1), Command::Stop, 0, LastStop(8))
    }

    #[test]
    fn a_stop_that_was_asked_for_again_ends_with_what_comes_of_that() {
        let stop = stop();
        assert!(stop.join(LastStop(16)));
        assert!(!stop.end(LastStop(8), Ok(Completion::Done)));
        assert_eq!(stop.result(), None);
        assert!(stop.end(LastStop(16), Err(Failure::Busy)));
        assert_eq!(stop.result(), Some(Err(Failure::Busy)));
        assert!(!stop.join(LastStop(24)), "the next one is a new one");
    }

    #[test]
    fn a_stop_that_fails_while_it_is_asked_for_again_is_carried_out_once_more_for_nobody() {
        let stop = stop();
        assert!(stop.join(LastStop(16)));
        assert!(!stop.end(LastStop(8), Err(Failure::HaltIgnored)));
        assert_eq!(stop.result(), Some(Err(Failure::HaltIgnored)));
        assert!(!stop.join(LastStop(24)), "it has its result");
        assert_eq!(stop.asked(), LastStop(16));
        assert!(stop.end(LastStop(16), Ok(Completion::Done)));
        assert_eq!(stop.result(), Some(Err(Failure::HaltIgnored)));
    }
}
