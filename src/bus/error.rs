//! Why a network could not be started, or a device not be led back: which one, which step, what was expected and what came.

use std::{fmt, time::Duration};

use super::{
    AlError, AlState, CableLoad, EepromError, LineMismatch, RealTimeError, ReferenceClock,
    RegisterError, SyncManagerError, TopologyError, WatchdogState,
};
use crate::{
    axis::{AxisIdentity, FieldError},
    coe::{DriveId, SdoError},
    ds402::State,
    link::RawSocketError,
    parameters::StartUpError,
    pdo_map::{MappingError, Step, verify::Differences},
};

/// Why a network could not be started, or a device of it not be led back.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The raw socket could not be opened.
    #[error(transparent)]
    Link(#[from] RawSocketError),
    /// The builder was given no link.
    #[error("no link was given: name an interface, or give a link")]
    NoLink,
    /// The bus thread could not be started, or ended before the network had started.
    #[error("the bus thread could not run: {0}")]
    Thread(String),
    /// The bus thread could not have the real time that was asked for.
    #[error(transparent)]
    RealTime(#[from] RealTimeError),
    /// Frames do not come back.
    #[error("no frame came back: is the cable plugged in, and the first SubDevice powered?")]
    NoAnswer,
    /// Frames come back, but no SubDevice answers.
    #[error("no SubDevice answers on this link")]
    NoSubDevice,
    /// More SubDevices answer than a line can have: a working counter was changed on its way.
    #[error(
        "{got} SubDevices answer, but a line has at most {most}: is another device changing the frames?"
    )]
    TooManySubDevices {
        /// The most that a line can have.
        most: u16,
        /// Those that answered by the working counter.
        got: u16,
    },
    /// All process data together need more frames than a cycle can have.
    #[error(
        "the process data need {got} frames, and a cycle has at most {most}: map less, or divide the line into several networks"
    )]
    TooManyFrames {
        /// The most that a cycle can have.
        most: usize,
        /// What is needed for this line.
        got: usize,
    },
    /// The process data's frames alone take longer than a cycle.
    #[error(
        "a cycle of {cycle:?} cannot be kept: its {} frames ({} bytes) take {:?} on 100 Mbit/s alone, and their cycle is to be {:?} at \
         least: make it longer, map less, or divide the line into several networks",
        load.frames, load.bytes, load.sending, load.shortest_cycle()
    )]
    CycleTooShort {
        /// What was asked for.
        cycle: Duration,
        /// What the frames take.
        load: CableLoad,
    },
    /// The line as a whole could not be reset or addressed.
    #[error("the line could not be reset and addressed: {0}")]
    Line(RegisterError),
    /// Devices are missing, swapped, moved or other ones, or there are more: nothing was configured.
    #[error(transparent)]
    WrongLine(#[from] LineMismatch),
    /// A time that was set cannot be meant.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// Two devices were declared at one place, or one name for two axes, or there is no axis.
    #[error("{0}")]
    Declaration(String),
    /// The wiring of the line cannot be told, so that the delays of its distributed clocks cannot be measured.
    #[error("distributed clocks: {0}")]
    Topology(#[from] TopologyError),
    /// The cycles are not in step with the reference clock.
    #[error(
        "the cycles were not in step with the reference clock within {after:?}: {}",
        WhyNotLocked(*reference, *phase_error_ns, *bound)
    )]
    NotLocked {
        /// What the reference clock does.
        reference: ReferenceClock,
        /// The last cycle's, in nanoseconds.
        phase_error_ns: i64,
        /// What it had to keep to.
        bound: Duration,
        /// How long it was waited for.
        after: Duration,
    },
    /// The network has ended, and these axes were not seen to stand without power: the drives have left OP all the same.
    #[error("the network has ended, and not every axis was seen to stand: {}", ListOf(.0))]
    StillMoving(Vec<MovingAxis>),
    /// A drive could not be configured.
    #[error("{drive:#}: {step}: {error}")]
    Drive {
        /// The drive.
        drive: DriveId,
        /// What was being done.
        step: BringUpStep,
        /// What went wrong.
        error: Box<DriveFault>,
    },
}

/// A time that was set and is too short or too long: nothing was started.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{of}: the {setting} is set to {got:?}: set it to at least {least:?} and at most {most:?}")]
pub struct SettingError {
    /// Whose setting it is: the network's or an axis'.
    pub of: String,
    /// The name of the setting.
    pub setting: &'static str,
    /// What was set.
    pub got: Duration,
    /// The shortest that is allowed.
    pub least: Duration,
    /// The longest that is allowed.
    pub most: Duration,
}

/// An axis that was not seen to stand without power at the end of its network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MovingAxis {
    /// Which one.
    pub axis: AxisIdentity,
    /// The state that it showed last.
    pub state: State,
    /// Position actual value 6064h, as it was shown last.
    pub position: i32,
    /// Whether it stood then.
    pub stands: bool,
    /// Whether its drive answers.
    pub answers: bool,
}

impl fmt::Display for MovingAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            axis,
            state,
            position,
            stands,
            answers,
        } = self;
        let moved = if *stands { "stands" } else { "moves" };
        let seen = if *answers {
            ""
        } else {
            ", as last seen: its drive does not answer"
        };
        write!(f, "{axis} {moved} at {position} in {state}{seen}")
    }
}

struct ListOf<'a>(&'a [MovingAxis]);

impl fmt::Display for ListOf<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, axis) in self.0.iter().enumerate() {
            let before = if place == 0 { "" } else { "; " };
            write!(f, "{before}{axis}")?;
        }
        Ok(())
    }
}

/// Why cycles are not in step, and what to do.
struct WhyNotLocked(ReferenceClock, i64, Duration);

impl fmt::Display for WhyNotLocked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(reference, phase_error_ns, bound) = self;
        match reference {
            ReferenceClock::Heard => write!(
                f,
                "the phase error is {phase_error_ns} ns, and more than {bound:?} is too much. Is another program keeping this thread \
                 from waking in time?"
            ),
            ReferenceClock::Silent => f.write_str(
                "it gives no time. Is its device switched off, or was it? Then shut the network down and start it again",
            ),
            ReferenceClock::Jumped => f.write_str(
                "it has jumped, and the network follows it no more. Shut the network down and start it again",
            ),
        }
    }
}

/// A step of a drive's bring-up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BringUpStep {
    /// Comparing the line with the expected one.
    Identity,
    /// Reading the SII.
    Sii,
    /// Start-up list.
    StartUpList,
    /// Writing and reading back of the PDO mapping.
    Mapping,
    /// Reading the axes' parameters.
    Parameters,
    /// 6007h, what an axis does when the process data stop.
    AbortConnection,
    /// Sync managers and FMMUs.
    ProcessData,
    /// The process-data watchdog.
    Watchdog,
    /// The distributed clock.
    Clock,
    /// A change of the AL state.
    State(AlState),
}

impl fmt::Display for BringUpStep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Identity => f.write_str("checking its identity"),
            Self::Sii => f.write_str("reading its SII"),
            Self::StartUpList => f.write_str("writing its start-up list"),
            Self::Mapping => f.write_str("mapping its PDOs"),
            Self::Parameters => f.write_str("reading its parameters"),
            Self::AbortConnection => f.write_str("setting what it does when the process data stop"),
            Self::ProcessData => f.write_str("setting up its process data"),
            Self::Watchdog => f.write_str("arming its process-data watchdog"),
            Self::Clock => f.write_str("setting its distributed clock"),
            Self::State(state) => write!(f, "bringing it into {state}"),
        }
    }
}

/// What went wrong with a drive.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DriveFault {
    /// The declared mapping is impossible.
    #[error(transparent)]
    Declaration(#[from] MappingError),
    /// The declared mapping lacks an object that the axis needs.
    #[error(transparent)]
    Fields(#[from] FieldError),
    /// The drive refused a step of the mapping.
    #[error("{step}: {error}")]
    MappingRefused {
        /// The step: which entry of which PDO.
        step: Step,
        /// The drive's reason.
        error: SdoError,
    },
    /// The drive holds another mapping than was written.
    #[error(transparent)]
    MappingDiffers(Differences),
    /// A line of a start-up list could not be written.
    #[error(transparent)]
    StartUp(#[from] StartUpError),
    /// An SDO transfer failed.
    #[error(transparent)]
    Sdo(#[from] SdoError),
    /// It has no CoE mailbox.
    #[error("its SII names no CoE mailbox")]
    NoMailbox,
    /// Its SII could not be read.
    #[error(transparent)]
    Sii(#[from] EepromError),
    /// Its registers could not be reached.
    #[error(transparent)]
    Register(#[from] RegisterError),
    /// Its process data do not fit its sync managers.
    #[error(transparent)]
    SyncManager(#[from] SyncManagerError),
    /// Its process data do not fit into a frame.
    #[error("{outputs} bytes of outputs and {inputs} of inputs do not fit into one frame")]
    TooLong {
        /// Bytes of outputs.
        outputs: usize,
        /// Bytes of inputs.
        inputs: usize,
    },
    /// The watchdog time has no room in its register.
    #[error("a watchdog time of {0:?} cannot be set: it must be more than 0 and at most 6.5535 s")]
    WatchdogTime(Duration),
    /// The watchdog is not armed, so that the axes would go on moving when the program dies.
    #[error(
        "it is not armed (triggered by the outputs: {}, divider {}, {} ticks where {expected} were set): the axes would go on \
         moving when this program dies. To accept that, say why in without_watchdog(\"...\")",
        .got.triggered, .got.divider, .got.ticks
    )]
    WatchdogUnarmed {
        /// Ticks of 100 µs that were set.
        expected: u16,
        /// What the drive holds.
        got: WatchdogState,
    },
    /// The watchdog of a device that is no drive is not armed.
    #[error(
        "it is not armed (triggered by the outputs: {}, divider {}, {} ticks where {expected} were set): the outputs would stay \
         as they are when this program dies. To accept that, say why in without_watchdog(\"...\")",
        .got.triggered, .got.divider, .got.ticks
    )]
    OutputsUnwatched {
        /// Ticks of 100 µs that were set.
        expected: u16,
        /// What the device holds.
        got: WatchdogState,
    },
    /// Led back, it exchanges other process data than at the start.
    #[error(
        "it exchanges other process data than at the start: {got:?} bytes of outputs and inputs in place of {expected:?}, or \
         others of the same length. Shut the network down and start it again"
    )]
    OtherProcessData {
        /// Bytes of outputs and of inputs at the start.
        expected: (usize, usize),
        /// Now.
        got: (usize, usize),
    },
    /// It has neither inputs nor outputs.
    #[error("it has neither inputs nor outputs: expect it in the line instead of using it")]
    NoProcessData,
    /// 6007h holds a value that does not stop the axis.
    #[error(
        "6007h of axis {axis} is {value}, which does not stop it, and no stopping value was accepted"
    )]
    DoesNotStop {
        /// The axis' name.
        axis: String,
        /// The value read back.
        value: i16,
    },
    /// Quick stop option code 605Ah is 0: at quick stop the drive switches off, and the axis coasts.
    #[error(
        "605Ah of axis {axis} is 0: it would coast at quick stop; set 605Ah in the start-up list, or accept it with `DriveConfig::coast_at_quick_stop`"
    )]
    QuickStopCoasts {
        /// The axis' name.
        axis: String,
    },
    /// A modulo axis without a turn: its 607Bh is missing, empty, or the whole range of its type.
    #[error(
        "axis {axis} is to be a modulo axis, but 607Bh holds no turn: set it in the start-up list, or give the turn with the axis"
    )]
    NoTurn {
        /// The axis' name.
        axis: String,
    },
    /// It did not change its AL state.
    #[error(transparent)]
    Al(#[from] AlError),
    /// It is to be synchronised by a distributed clock, but has none.
    #[error("its ESC has no distributed clock (register 0008h, bit 2)")]
    NoClock,
    /// It follows its distributed clock, and a frame takes another time to it than at the start.
    #[error(
        "it follows its distributed clock, and others that stood before it in the line at the start are missing: the delay of its clock \
         cannot be measured while the network runs. Put them back, or shut the network down and start it again"
    )]
    ClockOfRunningLine,
    /// It was without power, and the clocks of the others follow its own, which would jump.
    #[error(
        "its clock is the reference of the others and has begun anew: shut the network down and start it again"
    )]
    ReferenceOfRunningLine,
    /// Its SYNC unit is not on as it was switched on.
    #[error("its SYNC unit is on with {got:02X}h in register 0981h instead of {expected:02X}h")]
    SyncUnit {
        /// What was written.
        expected: u8,
        /// What it holds.
        got: u8,
    },
    /// SYNC0's start had always passed before the unit was on.
    #[error("the start of SYNC0 had passed before its SYNC unit was on: frames take too long")]
    Sync0Passed,
    /// 1C32h:1 or 1C33h:1 does not keep the synchronisation with SYNC0.
    #[error("{index:04X}h:01 is {value} where 2 (SYNC0) was written")]
    SyncType {
        /// The object's index.
        index: u16,
        /// The value read back.
        value: u16,
    },
    /// 1C32h:2 or 1C33h:2 does not keep the cycle time.
    #[error("{index:04X}h:02 is {value} ns where {expected} ns were written")]
    SyncCycle {
        /// The object's index.
        index: u16,
        /// What was written, in nanoseconds.
        expected: u32,
        /// The value read back, in nanoseconds.
        value: u32,
    },
    /// The reference clock that it is to follow does not run.
    #[error("the reference clock, that of {0}, stands still")]
    ReferenceStands(DriveId),
    /// Its clock does not follow the reference clock.
    #[error(
        "its clock is {apart:?} away from the reference clock, and more than {bound:?} is too much"
    )]
    ClockApart {
        /// The difference that it shows (register 092Ch).
        apart: Duration,
        /// What it had to keep to.
        bound: Duration,
    },
    /// The cyclic exchange did not get going.
    #[error("no complete exchange of process data within {0:?}")]
    NoExchange(Duration),
}
