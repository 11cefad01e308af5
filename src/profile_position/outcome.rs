//! What is reported about a command: events, completions, failures.

use crate::{
    coe::ObjectAddress,
    ds402::{Controlword, Mode, State, Statusword, describe_error_code},
};

use super::BufferMode;

/// Names one command until its last event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CommandId(pub u32);

/// One report about a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Event {
    /// The drive acknowledged the move's set-point; `Done` follows.
    Accepted,
    /// The axis stands halted with this move's set-point kept; `Done` follows.
    Halted,
    /// The last report.
    Done(Result<Completion, Failure>),
}

/// How a command ended well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Completion {
    /// Done; there is no more to say.
    Done,
    /// The move arrived at its target and nothing followed it in motion.
    Reached {
        /// Position actual value 6064h when it was seen.
        position: i32,
    },
    /// The move passed its target without stopping, into the next one.
    Passed {
        /// Position actual value 6064h when it was seen.
        position: i32,
    },
    /// The homing is attained.
    Homed {
        /// Position actual value 6064h when it was seen.
        position: i32,
    },
    /// The axis stands, in this state.
    Stopped {
        /// Where the drive ended: by 605Ah.
        state: State,
    },
    /// Nothing of the last mode is left: 6060h may be written by SDO.
    Prepared {
        /// The mode that may be written.
        mode: Mode,
    },
}

/// How far a set-point came before its command failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Delivery {
    /// It was never sent: the drive has not executed it and will not.
    NotSent,
    /// It was sent and not acknowledged: whether the drive has taken it is unknown.
    Unknown,
    /// The drive acknowledged it.
    Accepted,
}

/// What a deadline was set on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum WaitingFor {
    /// A DS402 state.
    State(State),
    /// Bit 12 to fall before the next set-point.
    AcknowledgeLow,
    /// Bit 12 to rise after bit 4.
    Acknowledge,
    /// The drive to show that it is homing: "in progress" in bits 10, 12 and 13.
    HomingStart,
    /// A homing to end within the time that it was given. It is stopped.
    HomingEnd,
    /// Bit 10 (target reached), of an axis that has stood at its target for [`Deadlines::begin`](crate::axis::Deadlines::begin).
    TargetReached,
    /// The mode in 6061h.
    Mode(Mode),
    /// Standstill: a position that stays within its window for the settle time.
    Standstill(Unrest),
}

/// What a drive showed of an axis that was to stand, in the last settle time or two.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct Unrest {
    /// The least and the greatest position actual value 6064h.
    pub positions: (i32, i32),
    /// The position window within which it had to stay.
    pub window: u32,
    /// For how long, in milliseconds.
    pub settle_ms: u32,
    /// The least and the greatest velocity actual value 606Ch, where that is mapped, and the threshold up to which it says that the axis
    /// stands.
    pub velocities: Option<(i32, i32, u32)>,
}

impl core::fmt::Display for Unrest {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self {
            positions: (least, greatest),
            window,
            settle_ms,
            velocities,
        } = self;
        write!(
            f,
            "6064h showed {least}…{greatest} and is to stay within {window} for {settle_ms} ms"
        )?;
        match velocities {
            Some((least, greatest, threshold)) => write!(
                f,
                "; 606Ch showed {least}…{greatest}, the threshold is {threshold}"
            ),
            None => Ok(()),
        }
    }
}

impl core::fmt::Display for WaitingFor {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::State(state) => write!(f, "the state {state}"),
            Self::AcknowledgeLow => f.write_str("bit 12 (set-point acknowledge) to fall"),
            Self::Acknowledge => f.write_str("bit 12 (set-point acknowledge) to rise"),
            Self::HomingStart => f.write_str("the homing to begin (bits 10, 12 and 13 to fall)"),
            Self::HomingEnd => f.write_str("the homing to end"),
            Self::TargetReached => {
                f.write_str("bit 10 (target reached) of an axis that stands at its target")
            }
            Self::Mode(mode) => write!(f, "mode {} in 6061h", mode.raw()),
            Self::Standstill(seen) => write!(f, "standstill: {seen}"),
        }
    }
}

/// Why a command did not end well. It never leaves a motion behind that was not asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, thiserror::Error)]
#[non_exhaustive]
pub enum Failure {
    /// A later move with [`BufferMode::Aborting`] took this one's place. A move of `start_together` that waits ends so as soon as such a move of
    /// another `start_together` is asked for on its axis: two groups could wait for each other otherwise.
    #[error("superseded by a later move")]
    Superseded,
    /// The axis is halted (bit 8). Resume it, or disable it and enable it again, which gives its set-point up.
    #[error("the axis is halted: resume it, or disable it and enable it again{}", SentText(*.delivery))]
    Halted {
        /// How far the set-point came, for moves, homings and jogs; `NotSent` for others.
        delivery: Delivery,
    },
    /// The axis got bit 8 (halt) and does not get slower: its drive ignores the bit, or goes on speeding up for a while. Bit 8
    /// stays set.
    #[error("the axis has a halt (bit 8) and does not get slower: stop or quick_stop it")]
    HaltIgnored,
    /// Halt option code 605Dh is 0: the drive would let the axis coast at bit 8, which was not sent.
    #[error(
        "halt option code 605Dh is 0: the axis would coast at halt (bit 8), which was not sent; stop() it, or set 605Dh"
    )]
    HaltCoasts,
    /// The axis got a quick stop (bit 2 of the controlword low). Its drive stays in Operation enabled and does not slow it down.
    /// Its voltage is being disabled in place of that: the axis coasts, or a brake stops it.
    #[error(
        "the drive ignores its quick stop (bit 2) and got Disable voltage: the axis may still be moving; find out why the drive takes no quick stop"
    )]
    QuickStopIgnored,
    /// A quick stop or stop ended it; the set-point is gone.
    #[error("ended by a quick stop, no set-point is left{}", SentText(*.delivery))]
    QuickStopped {
        /// How far the set-point came, for moves, homings and jogs; `NotSent` for others.
        delivery: Delivery,
    },
    /// The axis was disabled, or left Operation enabled by itself.
    #[error("the axis was disabled (it is in {state})")]
    Disabled {
        /// The state seen.
        state: State,
    },
    /// The drive has a fault.
    #[error("the drive has a fault: {} ({})", FaultCode(*.code), FaultText(*.code))]
    Fault {
        /// Error code 603Fh, where it is mapped or was read; else none. Of a drive that has no 603Fh the code is in its emergency
        /// (`Network::emergencies`), and in the newest entry of its error history (1003h:1, bits 0 to 15). It is not taken from
        /// there: an emergency does not say of which axis of its drive it is.
        code: Option<u16>,
    },
    /// The drive no longer answers, or the network is gone.
    #[error("the drive no longer answers{}", SentText(*.delivery))]
    BusLost {
        /// How far the set-point came.
        delivery: Delivery,
    },
    /// The drive answers, but has left OP with an AL status code: it takes no outputs, and acts by 6007h. What to do about it:
    /// `Network::recover`.
    #[error("the drive has left OP with AL status code {code:04X}h{}{}", AlCodeText(*.code), SentText(*.delivery))]
    LeftOp {
        /// The AL status code (0134h). 001Bh: its process-data watchdog has expired.
        code: u16,
        /// How far the set-point came.
        delivery: Delivery,
    },
    /// The drive answers, but the working counter of the datagram that it shares stays wrong. Whether its outputs arrive is not
    /// known. It gets a quick stop. Stops are accepted, and end by what it shows. Which device is the cause: see the network's
    /// events (`NetworkEvent::Miscounted`).
    #[error("the drive answers, but whether it receives its outputs is not known{}{}", CounterText(*.counter), SentText(*.delivery))]
    Undelivered {
        /// How far the set-point came.
        delivery: Delivery,
        /// The datagram's working counter, where it is known.
        counter: Option<WorkingCounter>,
    },
    /// The reference clock of the distributed clocks has jumped, and all axes of the network were stopped and disabled. What has
    /// moved it, and what drives that follow it do now, is not known. It holds until the network is started anew.
    #[error(
        "the reference clock of the distributed clocks has jumped, and all axes were stopped and disabled: find out why (the clock's event says by how much), then start the network anew"
    )]
    ClockJumped,
    /// The drive says target reached and stands elsewhere: it has limited the move.
    #[error(
        "the drive reports its target reached but stands at {actual} instead of {target}: look for a limit in the drive"
    )]
    MissedTarget {
        /// The position asked for.
        target: i32,
        /// Position actual value 6064h.
        actual: i32,
    },
    /// The drive went on to the next move, and nothing was seen of the axis when it was, or was not, at this one's target: inputs did
    /// not arrive. Or it was seen there when the drive may have been at another move.
    #[error(
        "the drive has gone on to the next move while nothing was seen of the axis, which is at {actual}: whether it was at {target} is not known"
    )]
    Unseen {
        /// The position asked for.
        target: i32,
        /// Position actual value 6064h.
        actual: i32,
    },
    /// The drive shows target reached after a distance. The axis stands elsewhere than where that could lead from any known place.
    /// The drive counts from another place, or has limited the move. Its documents do not say what distances count from.
    #[error(
        "the drive reports its target reached at {actual}, which is not where the distance leads from where the axis was: it counts from elsewhere or has limited the move; look for a limit in the drive"
    )]
    EndNotKnown {
        /// Position actual value 6064h.
        actual: i32,
    },
    /// The drive has acknowledged the move, and nothing has shown in time that it has begun: bit 10 has stayed high, and the axis
    /// stands where it stood. It counts as held by the drive, which may begin it at any time, until `stop()`.
    #[error(
        "the drive has acknowledged the move and has not begun it, the axis stands at {actual}: it may begin at any time; stop() it, and look for a brake or an input that holds it"
    )]
    NotBegun {
        /// Position actual value 6064h.
        actual: i32,
    },
    /// The move was sent to replace those of a full buffer, where the drive acknowledges nothing, and its motion has not
    /// shown that the drive took it.
    #[error(
        "the drive has not acknowledged the move, its buffer was full, and stands at {actual} instead of {target}: it may not have taken it"
    )]
    Unconfirmed {
        /// The position asked for.
        target: i32,
        /// Position actual value 6064h.
        actual: i32,
    },
    /// The axis stands elsewhere than at this move's end. A later move was sent that the drive has not acknowledged in time. The
    /// drive may have taken that one in this one's place.
    #[error(
        "the axis stands at {actual}, and a later move that the drive has not acknowledged may have taken this one's place: stop() before the next"
    )]
    PerhapsSuperseded {
        /// Position actual value 6064h.
        actual: i32,
    },
    /// The target lies beyond a limit that the drive holds: no set-point was sent.
    #[error(
        "the target {target} lies beyond the limit {limit} of {object}: move within it, or change it and read the limits again"
    )]
    BeyondLimit {
        /// The limit's object, as of the drive's first axis: 607Bh or 607Dh.
        object: ObjectAddress,
        /// The limit as a target position, the home offset taken off where the drive does so.
        limit: i64,
        /// The position asked for; of a relative move where it would end.
        target: i64,
    },
    /// A velocity above max profile velocity 607Fh: nothing was sent.
    #[error(
        "the velocity {velocity} is above max profile velocity 607Fh, {limit}: the drive would not go as fast"
    )]
    TooFast {
        /// What 607Fh holds, velocity units.
        limit: u32,
        /// The velocity asked for, velocity units.
        velocity: u32,
    },
    /// A deadline passed.
    #[error(
        "no answer in time while waiting for {waiting_for} (statusword {statusword}, controlword {controlword}){}",
        TimeoutText(*.waiting_for, *.delivery)
    )]
    Timeout {
        /// What was waited for.
        waiting_for: WaitingFor,
        /// The last statusword seen.
        statusword: Statusword,
        /// The last controlword sent.
        controlword: Controlword,
        /// How far the set-point came, for moves; `NotSent` for others.
        delivery: Delivery,
    },
    /// Moves need Operation enabled.
    #[error("the axis is not enabled (it is in {state}): enable it first")]
    NotEnabled {
        /// The state seen.
        state: State,
    },
    /// Moves need the mode that they belong to.
    #[error("{}{}", ModeText(*.expected, *.shown), SentText(*.delivery))]
    WrongMode {
        /// The mode that the command needs.
        expected: Mode,
        /// The mode display. It may show the mode that is needed, while a change from it to another one has not ended.
        shown: Mode,
        /// How far the set-point came: a drive may leave the mode while it executes one.
        delivery: Delivery,
    },
    /// The drive has no such mode: 6060h was not written.
    #[error("the drive has no {mode}: its supported drive modes 6502h do not name it")]
    ModeNotSupported {
        /// The mode that was to be selected.
        mode: Mode,
    },
    /// The drive cannot do this start.
    #[error("the drive cannot start a move this way ({buffer_mode:?}): {reason}")]
    Unsupported {
        /// What was asked.
        buffer_mode: BufferMode,
        /// Why not.
        reason: &'static str,
    },
    /// The drive cannot do this with this motion profile type.
    #[error("motion profile type {profile_type} (6086h): {reason}")]
    ProfileType {
        /// The profile type 6086h that is in the way.
        profile_type: i16,
        /// Why not.
        reason: &'static str,
    },
    /// A velocity, acceleration or deceleration of zero.
    #[error("{0} is zero: the move would never end")]
    Zero(&'static str),
    /// The set-point names a parameter that is not mapped into the process data.
    #[error(
        "{0} is not in the process data: map it into the drive's outputs (`AxisConfig::map_output`)"
    )]
    NotMapped(&'static str),
    /// The set-point leaves out a parameter that is mapped, and nobody has said what the drive holds.
    #[error("{0} is neither given nor known from the drive: give it with the set-point")]
    Missing(&'static str),
    /// The drive forgets its set-point at halt; stop, enable and move again.
    #[error("this drive does not keep its set-point through a halt: stop, enable and move again")]
    ResumeUnsupported,
    /// Bit 9 of the statusword is 0.
    #[error(
        "the drive is under local control (statusword bit 9 is 0): give control to the fieldbus{}",
        Words(*.statusword, *.controlword)
    )]
    LocalControl {
        /// The last statusword seen.
        statusword: Statusword,
        /// The last controlword sent.
        controlword: Controlword,
    },
    /// The drive does not go on from this state although the controlword commands it: it is inhibited. DS402 has no bit that says
    /// why.
    #[error(
        "the drive stays in {state} although Switch on is sent: look at its enable input, its safe torque off and its supply{}",
        Words(*.statusword, *.controlword)
    )]
    SwitchOnRefused {
        /// The state in which it stays.
        state: State,
        /// The last statusword seen.
        statusword: Statusword,
        /// The last controlword sent.
        controlword: Controlword,
    },
    /// Bit 4 of the statusword is 0.
    #[error(
        "the power stage has no supply (statusword bit 4 is 0): switch on its supply{}",
        Words(*.statusword, *.controlword)
    )]
    NoVoltage {
        /// The last statusword seen.
        statusword: Statusword,
        /// The last controlword sent.
        controlword: Controlword,
    },
    /// The command needs an axis that stands without a set-point.
    #[error("the axis is moving or has a set-point: stop it first")]
    Moving,
    /// There is no fault to reset.
    #[error("there is no fault to reset (the axis is in {state})")]
    NoFault {
        /// The state seen.
        state: State,
    },
    /// The drive reports a homing error: bit 13 in mode 6.
    #[error(
        "the drive reports a homing error (statusword bit 13) and {}: look at its switches and its error code",
        if *.moving { "was still moving" } else { "stands" }
    )]
    HomingError {
        /// Whether it did not come to rest by itself, and was stopped.
        moving: bool,
    },
    /// Resume after the halt of a homing.
    #[error("a halted homing is not continued: stop(), enable and home again")]
    HomingHalted,
    /// The program has not fed its liveness in time, or has dropped it. Every axis was halted. Nothing is enabled, started or
    /// resumed until it is fed or ended.
    #[error(
        "the program does not feed its liveness: every axis stays halted until it is fed or ended, or another takes its place; stops work all the same"
    )]
    LivenessExpired,
    /// A jog whose holder was silent for longer than its dead-man time. Its target velocity was 0 in the next frame.
    #[error(
        "the jog was let go: nobody said within its dead-man time that it is held; begin a new one to go on"
    )]
    NotHeld,
    /// The dead-man time of a jog is none: after so long nobody is stopped in time, or at once everybody is.
    #[error(
        "the dead-man time of a jog is set to {got:?}: set it to at least 1 ms and at most 10 s"
    )]
    DeadManTime {
        /// What was set.
        got: core::time::Duration,
    },
    /// An absolute move on an axis that does not know where it is.
    #[error(
        "the axis is not referenced: home it before absolute moves, or say in its settings that it has an absolute encoder or that unreferenced moves are allowed"
    )]
    NotReferenced,
    /// An earlier set-point may or may not have been taken.
    #[error("an earlier set-point may or may not have been taken by the drive: call stop() first")]
    NeedsStop,
    /// Another command of the kind is still at work.
    #[error(
        "another command is still at work on this axis: wait for its end, or let go of the jog that is held"
    )]
    Busy,
    /// The caller gave the command up before it was sent.
    #[error("withdrawn before it was sent")]
    Withdrawn,
}

impl Failure {
    /// [`Failure::Halted`] of what was not sent.
    pub(crate) const HALTED: Self = Self::Halted {
        delivery: Delivery::NotSent,
    };
    /// [`Failure::QuickStopped`] of what was not sent.
    pub(crate) const QUICK_STOPPED: Self = Self::QuickStopped {
        delivery: Delivery::NotSent,
    };

    /// This failure, of a command whose set-point came as far as this.
    #[must_use]
    pub(crate) fn with_delivery(mut self, came: Delivery) -> Self {
        if let Self::Halted { delivery }
        | Self::QuickStopped { delivery }
        | Self::WrongMode { delivery, .. }
        | Self::BusLost { delivery }
        | Self::LeftOp { delivery, .. }
        | Self::Undelivered { delivery, .. }
        | Self::Timeout { delivery, .. } = &mut self
        {
            *delivery = came;
        }
        self
    }
}

/// A working counter that is wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct WorkingCounter {
    /// The number of the datagram among those of the process data, from 0.
    pub datagram: u16,
    /// What its devices count when all of them exchange their data.
    pub expected: u16,
    /// What they counted.
    pub got: u16,
    /// How many devices share the datagram.
    pub devices: u16,
}

impl core::fmt::Display for WorkingCounter {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self {
            datagram,
            expected,
            got,
            devices,
        } = self;
        write!(
            f,
            "datagram {datagram} of {devices} devices has the working counter {got}, expected {expected}"
        )
    }
}

/// What keeps a command from its mode.
struct ModeText(Mode, Mode);

impl core::fmt::Display for ModeText {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self(expected, shown) = self;
        if shown == expected {
            return write!(
                f,
                "mode {} is shown, but a change of mode is under way: wait until it has ended, at most `Deadlines::mode`",
                shown.raw()
            );
        }
        write!(
            f,
            "mode {} is not active, 6061h shows {}: select it first",
            expected.raw(),
            shown.raw()
        )
    }
}

/// What is the matter with a drive that has left OP with this code (ETG.1020).
struct AlCodeText(u16);

impl core::fmt::Display for AlCodeText {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            0x001B => f.write_str(" (its process-data watchdog has expired)"),
            _ => Ok(()),
        }
    }
}

struct CounterText(Option<WorkingCounter>);

impl core::fmt::Display for CounterText {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        self.0.map_or(Ok(()), |counter| write!(f, ": {counter}"))
    }
}

struct FaultCode(Option<u16>);

impl core::fmt::Display for FaultCode {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            Some(code) => write!(f, "{code:04X}h"),
            None => f.write_str("code not known"),
        }
    }
}

struct FaultText(Option<u16>);

impl core::fmt::Display for FaultText {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.0.map_or(
            "read 603Fh, or see the drive's emergencies",
            describe_error_code,
        ))
    }
}

/// How far a set-point came, where there may have been one.
struct TimeoutText(WaitingFor, Delivery);

impl core::fmt::Display for TimeoutText {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match (self.0, self.1) {
            (WaitingFor::HomingEnd, Delivery::NotSent) => f.write_str("; it was not started"),
            (WaitingFor::HomingEnd, _) => f.write_str("; the axis is being stopped"),
            (WaitingFor::AcknowledgeLow | WaitingFor::Acknowledge, delivery) => {
                write!(f, "; {}", DeliveryText(delivery))
            }
            (_, delivery) => write!(f, "{}", SentText(delivery)),
        }
    }
}

/// The last words, in brackets.
struct Words(Statusword, Controlword);

impl core::fmt::Display for Words {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self(statusword, controlword) = self;
        write!(f, " (statusword {statusword}, controlword {controlword})")
    }
}

/// How far a set-point came, if one was sent. Of a command that sent none, nothing is said: it need not have one, and a set-point
/// before it may have moved the axis.
struct SentText(Delivery);

impl core::fmt::Display for SentText {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            Delivery::NotSent => Ok(()),
            delivery => write!(f, "; {}", DeliveryText(delivery)),
        }
    }
}

struct DeliveryText(Delivery);

impl core::fmt::Display for DeliveryText {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self.0 {
            Delivery::NotSent => "no set-point was sent",
            Delivery::Unknown => "the set-point was sent, and whether the drive took it is unknown",
            Delivery::Accepted => "the drive had accepted the set-point",
        })
    }
}

// The reports that wait to be taken from an axis core: a ring of fixed size.

/// More than all commands that a core can hold at once can report between two drains.
const CAPACITY: usize = 96;

/// Reports in the order in which they arose.
#[derive(Clone)]
pub(crate) struct Events {
    ring: [Option<(CommandId, Event)>; CAPACITY],
    first: usize,
    len: usize,
}

impl core::fmt::Debug for Events {
    /// Those that wait.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let waiting = (0..self.len).map(|at| self.ring.get((self.first + at) % CAPACITY));
        f.debug_list().entries(waiting.flatten().flatten()).finish()
    }
}

impl Events {
    pub const fn new() -> Self {
        Self {
            ring: [None; CAPACITY],
            first: 0,
            len: 0,
        }
    }

    /// Adds a report. A core whose owner never drains it keeps the oldest ones.
    pub fn push(&mut self, id: CommandId, event: Event) {
        if self.len < CAPACITY {
            let at = (self.first + self.len) % CAPACITY;
            if let Some(place) = self.ring.get_mut(at) {
                *place = Some((id, event));
                self.len += 1;
            }
        } else {
            tracing::error!(
                target: crate::log_target::AXIS,
                ?id,
                ?event,
                "an event was dropped: drain the axis core after each call"
            );
        }
    }

    pub fn pop(&mut self) -> Option<(CommandId, Event)> {
        if self.len == 0 {
            return None;
        }
        let event = self.ring.get_mut(self.first)?.take()?;
        self.first = (self.first + 1) % CAPACITY;
        self.len -= 1;
        Some(event)
    }
}

#[cfg(test)]
mod tests {
    use alloc::{format, vec::Vec};

    use super::*;

    /// The drive has not left the mode yet, or has been told to come back to it.
    #[test]
    fn a_command_behind_a_change_of_mode_is_told_to_wait_for_that() {
        let text = |shown| {
            let expected = Mode::ProfilePosition;
            let delivery = Delivery::NotSent;
            let failure = Failure::WrongMode {
                expected,
                shown,
                delivery,
            };
            format!("{failure}")
        };
        let other = "mode 1 is not active, 6061h shows 6: select it first";
        assert_eq!(text(Mode::Homing), other);
        let same = text(Mode::ProfilePosition);
        assert!(same.contains("a change of mode is under way"), "{same}");
    }

    #[test]
    fn the_reports_that_wait_are_shown_in_their_order_round_the_ring() {
        let mut events = Events::new();
        for number in 0..CAPACITY as u32 + 1 {
            events.push(CommandId(number), Event::Accepted);
            if number + 2 < CAPACITY as u32 {
                events.pop();
            }
        }
        let shown = [CAPACITY as u32 - 2, CAPACITY as u32 - 1, CAPACITY as u32]
            .map(|number| (CommandId(number), Event::Accepted));
        assert_eq!(format!("{events:?}"), format!("{shown:?}"));
    }

    #[test]
    fn a_report_without_a_place_takes_that_of_no_other() {
        let mut events = Events::new();
        let numbers = 0..CAPACITY as u32;
        for number in numbers.clone().chain([1_000]) {
            events.push(CommandId(number), Event::Accepted);
        }
        let kept: Vec<_> = core::iter::from_fn(|| events.pop()).collect();
        let expected = numbers.map(|number| (CommandId(number), Event::Accepted));
        assert_eq!(kept, expected.collect::<Vec<_>>());
    }
}
