//! Why a network could not be started, or a device not be recovered: which one, which step, what was expected and what came; with the
//! errors of each access, and the states that they name.

use std::{fmt, time::Duration};

use crate::{
    AxisError,
    axis::{AxisIdentity, FieldError},
    bus::{cable::CableLoad, expected::LineMismatch, real_time::RealTimeError},
    coe::{DriveError, DriveId, LinkRefusal, ObjectAddress, SdoError},
    ds402::{State, SupportedModes},
    link::RawSocketError,
    parameters::{MemoryFault, RestoreFault, StartUpError},
    pdo_map::{ConfigureError, MappingError, MappingWrite, verify::MappingDifferences},
    sii::{Mailbox, SiiError, SiiImageError},
    units::ScaleDifference,
};

/// Why a network could not be started, or a device of it not be recovered.
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
    /// SubDevices come and go while they are counted.
    #[error(
        "the line does not become steady: {before} SubDevices answered, and then {now}. Look for a loose cable, and for a device that \
         starts again and again"
    )]
    UnsteadyLine {
        /// Those that answered first.
        before: u16,
        /// Those that answered after that.
        now: u16,
    },
    /// The last SubDevice is connected to another device behind it, which can only stand before it.
    #[error(
        "the line is a ring: a cable leads from port {port} of the last SubDevice, at position {position}, back into the line. Unplug it \
         there: redundancy by a ring is not supported"
    )]
    Ring {
        /// The last SubDevice.
        position: u16,
        /// Its port at which the cable is plugged in.
        port: u8,
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
    /// The wiring of the line cannot be determined, so that the delays of its distributed clocks cannot be measured.
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
    /// The device is of an optional group that is not in the line.
    #[error("{0}: its group is not in the line, and joins by itself when it is plugged in")]
    Absent(DriveId),
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

/// Axes that were not seen to stand after all of a network were stopped.
#[derive(Debug, Clone, thiserror::Error)]
#[error("not every axis was seen to stand: {}", ListOf(.axes))]
#[non_exhaustive]
pub struct NotStopped {
    /// Of each of them the reason.
    pub axes: Vec<AxisError>,
}

/// A time that was set and is too short or too long: nothing was started with it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{of}: the {setting} is set to {got:?}: set it to at least {least:?} and at most {most:?}")]
#[non_exhaustive]
pub struct SettingError {
    /// Whose setting it is: the network's, a drive's or an axis'.
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
#[non_exhaustive]
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
        write!(f, "{axis} {moved}, at {position} counts, in {state}{seen}")
    }
}

struct ListOf<'a, T>(&'a [T]);

impl<T: fmt::Display> fmt::Display for ListOf<'_, T> {
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
                "it gives no time. Is its device there, and switched on? Then bring it back with `Network::recover`",
            ),
            ReferenceClock::Jumped => f.write_str(
                "it has jumped, and the network follows it no more. Shut the network down and start it again",
            ),
        }
    }
}

/// A step of a drive's bring-up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
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
    /// Writing the station alias of a drive that was replaced.
    Alias,
    /// Writing the parameters of a drive that was replaced.
    Restore,
    /// Storing them in the drive (1010h).
    Store,
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
            Self::Alias => f.write_str("writing its station alias"),
            Self::Restore => f.write_str("restoring its parameters"),
            Self::Store => f.write_str("having it store its parameters"),
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
        step: MappingWrite,
        /// The drive's reason.
        error: SdoError,
    },
    /// The drive holds another mapping than was written.
    #[error(transparent)]
    MappingDiffers(MappingDifferences),
    /// A line of a start-up list could not be written.
    #[error(transparent)]
    StartUp(#[from] StartUpError),
    /// An SDO transfer failed.
    #[error(transparent)]
    Sdo(#[from] SdoError),
    /// It has no CoE mailbox.
    #[error("its SII names no CoE mailbox")]
    NoMailbox,
    /// Another device of its kind was in the line before, whose mailbox lay elsewhere.
    #[error(
        "its SII names another mailbox than that of the device in its place before: {got:?} instead of {expected:?}. Shut the network down \
         and start it again"
    )]
    OtherMailbox {
        /// That one's.
        expected: Mailbox,
        /// This one's.
        got: Mailbox,
    },
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
    /// When it was brought back into OP, it exchanged other process data than at the start.
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
        "605Ah of axis {axis} is 0: it would coast at quick stop; set 605Ah in the start-up list, or accept it with `AxisConfig::coast_at_quick_stop`"
    )]
    QuickStopCoasts {
        /// The axis' name.
        axis: String,
    },
    /// Quick stop does not leave an axis powered that has its brake on an output: the brake could not close before the power goes.
    #[error(
        "605Ah of axis {axis} is {option}: at quick stop it would lose its power before the host has closed its brake; set 605Ah to 5, 6 or 7 in the start-up list"
    )]
    BrakeNeedsPower {
        /// The axis' name.
        axis: String,
        /// Quick stop option code 605Ah, or 2 where the drive has no such object.
        option: i16,
    },
    /// The drive does not let the host set the output that the brake of the axis is on.
    #[error(
        "60FEh:2 of axis {axis} is {mask:08X}h, and its brake is on bit {bit:08X}h: the drive ignores that output; enable it in 60FEh:2 by a line of the start-up list"
    )]
    BrakeMasked {
        /// The axis' name.
        axis: String,
        /// The mask 60FEh:2.
        mask: u32,
        /// The bit of the brake.
        bit: u32,
    },
    /// An object of its outputs cannot be read, and no start-up list says what it is to hold.
    #[error(
        "{object} is mapped into the outputs and cannot be read, so nobody knows what is to go out until the program sets it ({error}): write \
         its value by a line of the start-up list at PREOP-SAFEOP, or do not map it"
    )]
    OutputUnknown {
        /// The object.
        object: ObjectAddress,
        /// The drive's reason.
        error: SdoError,
    },
    /// The drive has no Profile Position (6502h), and the program has not mapped 60FFh to jog only.
    #[error(
        "axis {axis} cannot be moved: its drive has {modes} by 6502h, and moves need profile position mode (1)"
    )]
    NoProfilePosition {
        /// The axis' name.
        axis: String,
        /// Supported drive modes 6502h.
        modes: SupportedModes,
    },
    /// No PDO that the drive offers holds a target position.
    #[error(
        "axis {axis} cannot be moved: moves need {object} target position in an RxPDO, which none holds that this drive offers, and it has \
         {modes} by 6502h"
    )]
    NoTargetPosition {
        /// The axis' name.
        axis: String,
        /// The target position 607Ah of the axis.
        object: ObjectAddress,
        /// Supported drive modes 6502h; empty where the drive does not say.
        modes: SupportedModes,
    },
    /// A modulo axis without a turn: its 607Bh is missing, empty, or the whole range of its type.
    #[error(
        "axis {axis} is to be a modulo axis, but 607Bh holds no turn: set it in the start-up list, or give the turn with the axis"
    )]
    NoTurn {
        /// The axis' name.
        axis: String,
    },
    /// Its drive has a fault before the following error is as high as the program wants to be warned of.
    #[error(
        "axis {axis} is to be warned of at a following error of {warning} counts, but its drive has a fault at {window} (6065h): warn earlier, \
         or raise 6065h in the start-up list"
    )]
    LateWarning {
        /// The axis' name.
        axis: String,
        /// What was declared, in counts.
        warning: u32,
        /// Following error window 6065h.
        window: u32,
    },
    /// The declared scale of an axis and what its drive says of its units contradict each other.
    #[error(
        "the scale of axis {axis} and the drive disagree, {difference}: correct one of them, or choose with `AxisConfig::scale_mismatch` \
         that it is written or only logged"
    )]
    Scale {
        /// The axis' name.
        axis: String,
        /// Which object, what is expected of it, and what the drive says.
        difference: ScaleDifference,
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
    /// The reference clock was without power and is set again. To follow it would move the clock of this drive further than its axis
    /// may bear while it is enabled or moves.
    #[error(
        "the reference clock that comes back would move its clock by {by_ns} ns, and more than {bound:?} is too much while axis {axis} is enabled:          stop and disable that, then ask for the recovery again"
    )]
    ClockStep {
        /// The axis' name.
        axis: String,
        /// By how much its clock would be set back, in nanoseconds.
        by_ns: i64,
        /// What is allowed.
        bound: Duration,
    },
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
    /// It asks for SYNC0, which an earlier program has set, and no distributed clock is used.
    #[error(
        "it refused and is in {status}: {index:04X}h:01 holds {value} (SYNC{}), from an earlier program with distributed clocks, and this \
         one uses none. Write the type that it is to have by a start-up list (0 is free run), or use its clock with `DriveConfig::dc`",
        value.saturating_sub(2)
    )]
    SyncLeft {
        /// What it shows.
        status: AlStatus,
        /// The object's index.
        index: u16,
        /// What it holds.
        value: u16,
    },
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
    /// A drive of an older revision stands in place of one that is replaced.
    #[error(
        "it has the revision {got:08X}h, and a drive of the revision {expected:08X}h is replaced by one of the same or a higher revision \
         alone"
    )]
    OlderRevision {
        /// That of the drive that it replaces.
        expected: u32,
        /// Its own.
        got: u32,
    },
    /// The parameters of the backup were not written to a drive that was replaced.
    #[error(transparent)]
    Restore(#[from] RestoreFault),
    /// A drive that was replaced has not stored its parameters.
    #[error(transparent)]
    Store(#[from] MemoryFault),
    /// The EEPROM of a drive that is to get its alias holds no valid image.
    #[error("its EEPROM holds no valid image ({0}): write one, with `servocrab eeprom write`")]
    NoImage(#[from] SiiImageError),
    /// The EEPROM is written and read back, and the drive has not loaded it as at power-up.
    #[error(
        "its EEPROM with the alias {alias} is written, and not in force yet (0012h is {got}): switch it off and on, and replace it again"
    )]
    NotInForce {
        /// What was written and read back.
        alias: u16,
        /// What the register shows.
        got: u16,
    },
    /// The cyclic exchange did not get going.
    #[error("no complete exchange of process data within {0:?}")]
    NoExchange(Duration),
    /// The frames of process data come back, but after their cycle: what they bring is not used.
    #[error(
        "the frames of process data come back {away:?} after they were sent, and the cycle is {cycle:?}: make the cycle longer, or look for \
         what delays them: the interface's interrupt moderation, a switch or bridge in the path, a busy computer"
    )]
    LateFrames {
        /// The longest that one was away.
        away: Duration,
        /// The network's cycle.
        cycle: Duration,
    },
}

/// Without the drive, which the error around it names.
impl From<DriveError> for DriveFault {
    fn from(DriveError { error, .. }: DriveError) -> Self {
        Self::Sdo(error)
    }
}

/// Without the drive, which the error around it names.
impl From<ConfigureError> for DriveFault {
    fn from(error: ConfigureError) -> Self {
        match error {
            ConfigureError::Refused { step, error } => Self::MappingRefused {
                step,
                error: error.error,
            },
            ConfigureError::Unreadable(error) => Self::Sdo(error.error),
            ConfigureError::Differs(error) => Self::MappingDiffers(error.error),
        }
    }
}

/// A step of one device that failed, and how. The error around it names the device.
#[derive(Debug)]
pub(in crate::bus) struct StepError(
    pub(in crate::bus) BringUpStep,
    pub(in crate::bus) Box<DriveFault>,
);

/// Names the step in which something failed.
pub(in crate::bus) trait AtStep<T> {
    fn at(self, step: BringUpStep) -> Result<T, StepError>;
}

impl<T, E: Into<DriveFault>> AtStep<T> for Result<T, E> {
    fn at(self, step: BringUpStep) -> Result<T, StepError> {
        self.map_err(|error| StepError(step, Box::new(error.into())))
    }
}

/// Names the device of which a step failed.
pub(in crate::bus) trait OfDevice<T> {
    fn of(self, device: &DriveId) -> Result<T, NetworkError>;
}

impl<T> OfDevice<T> for Result<T, StepError> {
    fn of(self, device: &DriveId) -> Result<T, NetworkError> {
        self.map_err(|StepError(step, error)| NetworkError::Drive {
            drive: device.clone(),
            step,
            error,
        })
    }
}

/// The state in the AL status, register 0130h.
const STATE: u8 = 0x0F;

/// A state of a SubDevice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum AlState {
    /// Nothing but registers.
    Init,
    /// Mailbox.
    PreOp,
    /// Firmware update.
    Bootstrap,
    /// Mailbox and inputs.
    SafeOp,
    /// Mailbox, inputs and outputs.
    Op,
    /// Any other number.
    Other(u8),
}

impl AlState {
    pub(super) const fn from_bits(bits: u8) -> Self {
        match bits & STATE {
            1 => Self::Init,
            2 => Self::PreOp,
            3 => Self::Bootstrap,
            4 => Self::SafeOp,
            8 => Self::Op,
            other => Self::Other(other),
        }
    }

    pub(super) const fn bits(self) -> u8 {
        match self {
            Self::Init => 1,
            Self::PreOp => 2,
            Self::Bootstrap => 3,
            Self::SafeOp => 4,
            Self::Op => 8,
            Self::Other(other) => other,
        }
    }
}

impl fmt::Display for AlState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Init => f.write_str("INIT"),
            Self::PreOp => f.write_str("PREOP"),
            Self::Bootstrap => f.write_str("BOOT"),
            Self::SafeOp => f.write_str("SAFEOP"),
            Self::Op => f.write_str("OP"),
            Self::Other(n) => write!(f, "state {n}"),
        }
    }
}

/// The AL status of a SubDevice: its state, and why it is not in another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct AlStatus {
    /// The state it is in.
    pub state: AlState,
    /// The AL status code, where the SubDevice indicates an error.
    pub error: Option<u16>,
}

impl fmt::Display for AlStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.error {
            None => write!(f, "{}", self.state),
            Some(code) => {
                // The text begins with the code in another notation.
                let text = ethercrab::AlStatusCode::from(code).to_string();
                let meaning = text.split_once(": ").map_or(text.as_str(), |parts| parts.1);
                write!(
                    f,
                    "{} with AL status code {code:04X}h ({meaning})",
                    self.state
                )
            }
        }
    }
}

/// Why a SubDevice did not change its state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AlError {
    /// It refused, or fell back.
    #[error("it refused and is in {0}")]
    Refused(AlStatus),
    /// It neither changed nor refused.
    #[error("nothing happened within {after:?}: it is in {status}")]
    Timeout {
        /// How long it was given.
        after: Duration,
        /// What it shows.
        status: AlStatus,
    },
    /// Its registers could not be reached.
    #[error(transparent)]
    Register(#[from] RegisterError),
}

/// Why an access to a register failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RegisterError {
    /// No frame came back, though it was sent several times.
    #[error("no frame came back")]
    NoFrame,
    /// The frame came back, but the SubDevice did not act on it (working counter 0).
    #[error("the SubDevice did not answer")]
    NotAnswered,
    /// ethercrab refused the request.
    #[error("ethercrab: {0}")]
    Refused(LinkRefusal),
}

/// Why the SII could not be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EepromError {
    /// The registers could not be reached.
    #[error(transparent)]
    Register(#[from] RegisterError),
    /// The SubDevice reports an error.
    #[error("the SII interface reports an error at word {word:04X}h (0502h is {control:04X}h)")]
    Refused {
        /// The word asked for.
        word: usize,
        /// Register 0502h.
        control: u16,
    },
    /// The EEPROM stayed busy.
    #[error("the SII interface stayed busy at word {word:04X}h")]
    Busy {
        /// The word asked for.
        word: usize,
    },
    /// What was read is no SII image.
    #[error(transparent)]
    Image(#[from] SiiError),
    /// A word was written and holds something else.
    #[error(
        "word {word:04X}h of the EEPROM holds {got:04X}h where {expected:04X}h was written: is it write-protected?"
    )]
    NotKept {
        /// The word.
        word: usize,
        /// What was written.
        expected: u16,
        /// What was read back.
        got: u16,
    },
    /// The EEPROM was to be loaded again, and its checksum is wrong for the SubDevice.
    #[error("the SubDevice has not loaded its EEPROM again (0502h is {control:04X}h)")]
    NotLoaded {
        /// Register 0502h.
        control: u16,
    },
}

/// Why the sync managers cannot hold the process data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SyncManagerError {
    /// The SII names no sync manager for these data.
    #[error("its SII names no sync manager for the {0}")]
    Missing(&'static str),
    /// Three buffers run into the next sync manager's memory.
    #[error(
        "three buffers of {length} bytes from {start:04X}h for the {what} run into the sync manager at {next:04X}h"
    )]
    Overlap {
        /// Outputs or inputs.
        what: &'static str,
        /// Its first byte in the SubDevice's memory.
        start: u16,
        /// Bytes of one buffer.
        length: u16,
        /// First byte of the next sync manager.
        next: u16,
    },
    /// More bytes than a sync manager has.
    #[error("{0} bytes of process data are too many")]
    TooLong(usize),
}

/// What was found of the watchdog after it was set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct WatchdogState {
    /// Whether the outputs' sync manager triggers it.
    pub triggered: bool,
    /// Divider, register 0400h.
    pub divider: u16,
    /// Time in ticks, register 0420h; 0 switches it off.
    pub ticks: u16,
}

/// Why the wiring cannot be determined. Positions count from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TopologyError {
    /// Nothing is plugged into a port 0.
    #[error(
        "the SubDevice at position {position} is not connected by its port 0: are its IN and OUT cables swapped?"
    )]
    EntryClosed {
        /// The SubDevice.
        position: usize,
    },
    /// Another port than 0 gets the frames first.
    #[error(
        "frames reach the SubDevice at position {position} by port {port} before port 0: are its IN and OUT cables swapped?"
    )]
    WrongEntry {
        /// The SubDevice.
        position: usize,
        /// The port that gets them first.
        port: usize,
    },
    /// A port is open, but no SubDevice answers behind it.
    #[error(
        "port {port} of the SubDevice at position {position} is open, but nothing answers behind it"
    )]
    NobodyBehind {
        /// The SubDevice.
        position: usize,
        /// Its port.
        port: usize,
    },
    /// No open port is left for a SubDevice.
    #[error("the SubDevice at position {position} answers, but no open port leads to it")]
    NoWay {
        /// The SubDevice.
        position: usize,
    },
    /// A branch begins at a SubDevice that has no receive times, so that the way through it cannot be measured.
    #[error(
        "a branch begins at the SubDevice at position {position}, which has no distributed clock: the delays behind it cannot be \
         measured"
    )]
    BranchWithoutClock {
        /// The SubDevice.
        position: usize,
    },
}

/// What the reference clock does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[non_exhaustive]
pub enum ReferenceClock {
    /// It gives its time.
    #[default]
    Heard,
    /// It has not given its time for 64 cycles: these go on at the speed that it had, and all other clocks follow them.
    Silent,
    /// It has shown a time that it cannot have: all clocks follow the cycles from then on, and all axes are stopped and disabled.
    Jumped,
}
