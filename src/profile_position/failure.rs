//! Why a command did not end well, in types and in words.

use crate::{
    coe::ObjectAddress,
    ds402::{Controlword, Mode, State, Statusword, describe_error_code},
};

use super::BufferMode;

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
    /// The drive to show that it is homing: "in progress" in bits 10, 12 and 13.
    HomingStart,
    /// A homing to end within the time that it was given. It is stopped.
    HomingEnd,
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
}

impl core::fmt::Display for Unrest {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self {
            positions: (least, greatest),
            window,
            settle_ms,
        } = self;
        write!(
            f,
            "6064h showed {least}…{greatest} and is to stay within {window} for {settle_ms} ms"
        )
    }
}

impl core::fmt::Display for WaitingFor {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::State(state) => write!(f, "the state {state}"),
            Self::AcknowledgeLow => f.write_str("bit 12 (set-point acknowledge) to fall"),
            Self::HomingStart => f.write_str("the homing to begin (bits 10, 12 and 13 to fall)"),
            Self::HomingEnd => f.write_str("the homing to end"),
            Self::Mode(mode) => write!(f, "mode {} in 6061h", mode.raw()),
            Self::Standstill(seen) => write!(f, "standstill: {seen}"),
        }
    }
}

/// What kind of failure it is: all that most programs need to look at.
///
/// ```
/// use servocrab::{Failure, FailureClass};
/// let failure = Failure::NotReferenced;
/// assert_eq!(failure.class(), FailureClass::Refused);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum FailureClass {
    /// It was not begun: nothing of it was sent. The text says what is in the way.
    Refused,
    /// A command has ended it: a later move, a halt, a stop, a disable.
    Aborted,
    /// The axis is surely elsewhere than where the move leads.
    Missed,
    /// How it ended is not known ([`Doubt`] says what is).
    Unknown,
    /// The drive has a fault, or does not do what it is told.
    DriveFault,
    /// The drive no longer answers, or does not take its outputs.
    Lost,
    /// A time limit ran out.
    Late,
}

/// Where to look after [`Failure::MissedTarget`].
pub(crate) const WHY_MISSED: &str =
    "look for a limit in the drive, and after a distance compare `Traits::relative_base`";

/// What is not known of a move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum Doubt {
    /// It was sent, and bit 12 did not acknowledge it in time. Or the axis rests, and a later move that was not acknowledged may have led it
    /// there. The axis needs a stop before the next move.
    Unacknowledged,
    /// Bit 10 has stayed high, and the axis at rest, for [`Deadlines::begin`](crate::axis::Deadlines::begin): the drive may begin it at any
    /// time. The axis needs a stop before the next move.
    NotBegun,
    /// The axis rests at its target, and bit 10 has stayed low for [`Deadlines::begin`](crate::axis::Deadlines::begin): the drive may be at
    /// work on it still. The axis needs a stop before the next move.
    StillLow,
    /// It is over, and no sample shows that the axis was at its target: the drive has gone on to the next move.
    Unseen,
    /// It is over, and it was a distance of which the drive's documents do not say what it counts from.
    EndUnknown,
}

impl Doubt {
    /// Whether the drive may still hold the set-point. Then every move is refused until a stop.
    #[must_use]
    pub const fn needs_stop(self) -> bool {
        match self {
            Self::Unacknowledged | Self::NotBegun | Self::StillLow => true,
            Self::Unseen | Self::EndUnknown => false,
        }
    }

    const fn text(self) -> &'static str {
        match self {
            Self::Unacknowledged => {
                "the drive has not acknowledged the move in time (bit 12), and whether it executes it is not known: stop() before the next, and \
                 compare `Traits::buffer_signal`, after a halt `Traits::acknowledges_while_halted`"
            }
            Self::NotBegun => {
                "the drive has acknowledged the move and has not begun it, and may begin at any time: stop() it, and look for a brake or an \
                 input that holds the axis; after a halt, compare `Traits::halt_keeps_set_point`"
            }
            Self::StillLow => {
                "the axis stands at its target and the drive does not report it (bit 10): stop() before the next move, and compare the drive's \
                 position window 6067h"
            }
            Self::Unseen => {
                "the drive has gone on to the next move, and no sample shows the axis at this one's target: look for lost frames and for a limit \
                 in the drive, and compare `Traits::after_current`, `Traits::blend` and `Traits::buffer_signal`"
            }
            Self::EndUnknown => {
                "the drive has ended the distance, and what it counts from is not documented: look for a limit in the drive, \
                 and set `Traits::relative_base` where you know it"
            }
        }
    }
}

impl core::fmt::Display for Doubt {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.text())
    }
}

/// What a drive cannot do, or this library with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, thiserror::Error)]
#[non_exhaustive]
pub enum Unsupported {
    /// Supported drive modes 6502h do not name the mode. 6060h was not written.
    #[error("the drive has no {0}: its supported drive modes 6502h do not name it")]
    Mode(Mode),
    /// A move cannot be started this way.
    #[error("the drive cannot start a move this way ({buffer_mode:?}): {reason}")]
    Start {
        /// What was asked.
        buffer_mode: BufferMode,
        /// Why not.
        reason: &'static str,
    },
    /// A move cannot have this motion profile type 6086h, or not this way.
    #[error("motion profile type {profile_type} (6086h): {reason}")]
    ProfileType {
        /// The profile type 6086h that is in the way.
        profile_type: i16,
        /// Why not.
        reason: &'static str,
    },
    /// Halt option code 605Dh is 0: the drive would let the axis coast at bit 8.
    #[error(
        "halt option code 605Dh is 0, and the axis would coast at halt (bit 8): stop() it, or set 605Dh"
    )]
    Halt,
    /// The axis cannot be stopped and held.
    #[error(
        "the axis cannot be stopped and stay enabled: {reason}; stop() it. With 605Ah = 5 or 6 it stays powered in Quick stop active, until enable()"
    )]
    Hold {
        /// Why not.
        reason: &'static str,
    },
    /// The drive forgets its set-point at halt.
    #[error("this drive does not keep its set-point through a halt: stop, enable and move again")]
    Resume,
    /// A homing that was halted.
    #[error("a halted homing is not continued: stop(), enable and home again")]
    ResumeHoming,
}

/// What is wrong with a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ParameterFault {
    /// It is zero, and the motion would never end.
    Zero,
    /// It is given and not in the process data.
    NotMapped,
    /// It is in the process data, neither given nor known from the drive.
    Missing,
    /// It lies outside of its range, which is this.
    OutOfRange(&'static str),
}

impl core::fmt::Display for ParameterFault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Zero => f.write_str("is zero: the motion would never end"),
            Self::NotMapped => f.write_str(
                "is not in the process data: map it into the drive's outputs (`AxisConfig::map_output`)",
            ),
            Self::Missing => {
                f.write_str("is neither given nor known from the drive: give it with the set-point")
            }
            Self::OutOfRange(range) => write!(f, "must be {range}"),
        }
    }
}

/// What keeps a drive from being enabled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Inhibit {
    /// Bit 9 of the statusword is 0.
    LocalControl,
    /// Bit 4 of the statusword is 0.
    NoVoltage,
    /// The drive does not say: it stays in its state.
    Unnamed,
}

/// Why a command did not end well. It never leaves a motion behind that was not asked for.
///
/// Most programs look at its [`class`](Self::class) alone.
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
    /// The mode that the command needs is not active, or the drive has left it by itself.
    #[error("{}{}", ModeText(*.expected, *.shown), SentText(*.delivery))]
    WrongMode {
        /// The mode that the command needs.
        expected: Mode,
        /// The mode display. It may show the mode that is needed, while a change from it to another one has not ended.
        shown: Mode,
        /// How far the set-point came: a drive may leave the mode while it executes one.
        delivery: Delivery,
    },
    /// The caller gave the command up before it was sent.
    #[error("withdrawn before it was sent")]
    Withdrawn,
    /// A jog whose holder was silent for longer than its dead-man time. Its target velocity was 0 in the next frame.
    #[error(
        "the jog was let go: nobody said within its dead-man time that it is held; begin a new one to go on"
    )]
    NotHeld,
    /// The drive says target reached and stands elsewhere: it has limited the move.
    #[error(
        "the drive reports its target reached but stands at {actual} instead of {target}: {WHY_MISSED}"
    )]
    MissedTarget {
        /// The position asked for.
        target: i32,
        /// Position actual value 6064h.
        actual: i32,
    },
    /// How the move ended is not known.
    #[error("{doubt}; the axis was at {actual}{}", Words(*.statusword, *.controlword))]
    Unknown {
        /// What is not known, and whether the axis needs a stop.
        doubt: Doubt,
        /// Position actual value 6064h.
        actual: i32,
        /// The last statusword seen.
        statusword: Statusword,
        /// The last controlword sent.
        controlword: Controlword,
    },
    /// The drive has a fault.
    #[error(
        "the drive has a fault{}: {} ({})",
        if *.following_error { " with following error (statusword bit 13)" } else { "" },
        FaultCode(*.code),
        FaultText(*.code)
    )]
    Fault {
        /// Error code 603Fh, where it is mapped or was read; else none. Of a drive that has no 603Fh the code is in its emergency
        /// (`Network::emergencies`), and in the newest entry of its error history (1003h:1, bits 0 to 15). It is not taken from
        /// there: an emergency does not say of which axis of its drive it is.
        code: Option<u16>,
        /// Whether the drive shows a following error with it: bit 13 of the statusword in Profile Position.
        following_error: bool,
    },
    /// The axis got bit 8 (halt) and does not get slower: its drive ignores the bit, or goes on speeding up for a while. Bit 8
    /// stays set.
    #[error("the axis has a halt (bit 8) and does not get slower: stop or quick_stop it")]
    HaltIgnored,
    /// The axis got a quick stop (bit 2 of the controlword low). Its drive stays in Operation enabled and does not slow it down.
    /// Its voltage is being disabled in place of that: the axis coasts, or a brake stops it.
    #[error(
        "the drive ignores its quick stop (bit 2) and got Disable voltage: the axis may still be moving; find out why the drive takes no quick stop"
    )]
    QuickStopIgnored,
    /// The drive reports a homing error: bit 13 in mode 6.
    #[error(
        "the drive reports a homing error (statusword bit 13) and {}: look at its switches and its error code",
        if *.moving { "was still moving" } else { "stands" }
    )]
    HomingError {
        /// Whether it did not come to rest by itself, and was stopped.
        moving: bool,
    },
    /// The drive does not go on to Operation enabled although the controlword commands it.
    #[error("{}{}", InhibitText(*.by, *.state), Words(*.statusword, *.controlword))]
    EnableRefused {
        /// What keeps it.
        by: Inhibit,
        /// The state in which it stays.
        state: State,
        /// The last statusword seen.
        statusword: Statusword,
        /// The last controlword sent.
        controlword: Controlword,
    },
    /// The brake's feedback has not shown within its release time that it is open. It is closed again, and the axis disabled.
    #[error(
        "the brake was not seen to open within its release time: look at its supply, its feedback, and the mask 60FEh:2"
    )]
    BrakeNotReleased,
    /// The axis has left its position window since its brake was closed and its power gone.
    #[error(
        "the axis has slipped from {from} to {to} although its brake is closed: make the load safe, then look at the brake and its `set` time"
    )]
    AxisSlipped {
        /// Position actual value 6064h where it stood.
        from: i32,
        /// Where it was seen next.
        to: i32,
    },
    /// The drive no longer answers, or the network is gone.
    #[error("the drive no longer answers{}", SentText(*.delivery))]
    BusLost {
        /// How far the set-point came.
        delivery: Delivery,
    },
    /// The drive is of an optional group that is not in the line (`NetworkBuilder::optional`).
    #[error("the drive is not in the line: its group has not joined, or has left")]
    Absent,
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
    /// The target lies beyond a limit that the drive holds, or the velocity is above 607Fh: nothing was sent.
    #[error(
        "{asked} lies beyond the limit {limit} of {object}: stay within it, or change it and read the limits again"
    )]
    BeyondLimit {
        /// The limit's object, as of the drive's first axis: 607Bh, 607Dh or 607Fh.
        object: ObjectAddress,
        /// The limit; of a position as a target, the home offset taken off where the drive does so.
        limit: i64,
        /// What was asked for; of a relative move where it would end, or may end.
        asked: i64,
    },
    /// The profile velocity is below min profile velocity 2010h, of a drive that has it in the same unit: nothing was sent.
    #[error(
        "the velocity {asked} is below {least}, the min profile velocity 2010h: move faster, or change it and read the limits again"
    )]
    TooSlow {
        /// What was asked for, or what the drive holds in 6081h where the move leaves it out. Of a jog without its sign.
        asked: u32,
        /// What the drive holds in 2010h.
        least: u32,
    },
    /// A velocity, a ramp or a time that cannot be sent.
    #[error("{name} {fault}")]
    Parameter {
        /// The parameter and its object.
        name: &'static str,
        /// What is wrong with it.
        fault: ParameterFault,
    },
    /// The drive, or this library with it, cannot do this.
    #[error(transparent)]
    Unsupported(Unsupported),
    /// Moves need Operation enabled.
    #[error("the axis is not enabled (it is in {state}): enable it first")]
    NotEnabled {
        /// The state seen.
        state: State,
    },
    /// The command needs an axis that stands without a set-point.
    #[error("the axis is moving or has a set-point: stop it first")]
    Moving,
    /// The program has not fed its liveness in time, or has dropped it. Every axis was halted. Nothing is enabled, started or
    /// resumed until it is fed or ended.
    #[error(
        "the program does not feed its liveness: every axis stays halted until it is fed or ended, or another takes its place; stops work all the same"
    )]
    LivenessExpired,
    /// An absolute move on an axis that does not know where it is.
    #[error(
        "the axis is not referenced: home it before absolute moves, or say in its settings that it has an absolute encoder or that unreferenced moves are allowed"
    )]
    NotReferenced,
    /// Whether the drive holds an earlier set-point is not known.
    #[error("whether the drive holds an earlier set-point is not known: call stop() first")]
    NeedsStop,
    /// Another command of the kind is still at work.
    #[error(
        "another command is still at work on this axis: wait for its end, or let go of the jog that is held"
    )]
    Busy,
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

    /// What kind of failure it is.
    #[must_use]
    pub const fn class(&self) -> FailureClass {
        match self {
            Self::Superseded
            | Self::Halted { .. }
            | Self::QuickStopped { .. }
            | Self::Disabled { .. }
            | Self::WrongMode { .. }
            | Self::Withdrawn
            | Self::NotHeld => FailureClass::Aborted,
            Self::MissedTarget { .. } => FailureClass::Missed,
            Self::Unknown { .. } => FailureClass::Unknown,
            Self::Fault { .. }
            | Self::HaltIgnored
            | Self::QuickStopIgnored
            | Self::HomingError { .. }
            | Self::EnableRefused { .. }
            | Self::BrakeNotReleased
            | Self::AxisSlipped { .. } => FailureClass::DriveFault,
            Self::BusLost { .. }
            | Self::Absent
            | Self::LeftOp { .. }
            | Self::Undelivered { .. }
            | Self::ClockJumped => FailureClass::Lost,
            Self::Timeout { .. } => FailureClass::Late,
            Self::BeyondLimit { .. }
            | Self::TooSlow { .. }
            | Self::Parameter { .. }
            | Self::Unsupported(_)
            | Self::NotEnabled { .. }
            | Self::Moving
            | Self::LivenessExpired
            | Self::NotReferenced
            | Self::NeedsStop
            | Self::Busy => FailureClass::Refused,
        }
    }

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
            (WaitingFor::AcknowledgeLow, delivery) => {
                write!(f, "; {}", DeliveryText(delivery))
            }
            (_, delivery) => write!(f, "{}", SentText(delivery)),
        }
    }
}

/// What keeps a drive from being enabled, and what to do.
struct InhibitText(Inhibit, State);

impl core::fmt::Display for InhibitText {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            Inhibit::LocalControl => f.write_str(
                "the drive is under local control (statusword bit 9 is 0): give control to the fieldbus",
            ),
            Inhibit::NoVoltage => f.write_str(
                "the power stage has no supply (statusword bit 4 is 0): switch on its supply",
            ),
            Inhibit::Unnamed => write!(
                f,
                "the drive stays in {} although Switch on is sent: look at its enable input, its safe torque off and its supply",
                self.1
            ),
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

#[cfg(test)]
mod tests {
    use alloc::format;

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
}
