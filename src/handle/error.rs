//! What an axis handle's operations fail with: which axis, which drive, and why.

use core::{any::TypeId, fmt, time::Duration};
use std::sync::Arc;

use crate::{
    Failure, HomingMethod,
    axis::{Command, Delivery},
    coe::{DriveId, ErrorTexts, ObjectAddress, SdoError, obj},
    ds402::{Controlword, Statusword},
    pdo_map::LayoutError,
    profile_position::WHY_MISSED,
    units::{AxisUnit, Counts, Scale, ScaleError},
};

use super::{PairError, ProbeError};

/// An operation of an axis did not end well.
///
/// The kind is in the drive's units. The text has positions and velocities in the unit of the handle.
#[derive(Clone)]
#[non_exhaustive]
pub struct AxisError {
    /// The axis and its drive.
    pub identity: Arc<AxisIdentity>,
    /// Why.
    pub kind: AxisErrorKind,
    /// None in counts.
    unit: Option<Box<ErrorUnit>>,
    /// None of others than those that a halt ends.
    motion: Option<EndedByHalt>,
    /// What the drive's own table says of its fault.
    maker: Option<Arc<str>>,
}

/// As its text: what a program prints that unwraps it.
impl fmt::Debug for AxisError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "AxisError({self})")
    }
}

/// A motion that is over when the axis is halted: no resume brings it back.
#[derive(Debug, Clone, Copy)]
pub(super) enum EndedByHalt {
    Homing,
    Jog,
}

impl EndedByHalt {
    pub const fn of(command: &Command) -> Option<Self> {
        match command {
            Command::Home(_) => Some(Self::Homing),
            Command::Jog(_) => Some(Self::Jog),
            _ => None,
        }
    }

    /// What an error says of its halt. One that was not sent has not begun: it was refused, as any other motion.
    const fn text(self, kind: &AxisErrorKind) -> Option<&'static str> {
        let AxisErrorKind::Failed(Failure::Halted { delivery }) = kind else {
            return None;
        };
        match (self, delivery) {
            (_, Delivery::NotSent) => None,
            (Self::Homing, _) => Some(
                "the axis was halted, and the homing is over: stop it, enable it and home again",
            ),
            (Self::Jog, _) => Some(
                "the axis was halted, and the jog is over: resume the axis, then begin a new one",
            ),
        }
    }
}

/// The unit of the handle that an error is of.
#[derive(Debug, Clone, Copy)]
struct ErrorUnit {
    scale: Scale,
    name: &'static str,
}

/// The axis, and the error as a text.
#[cfg(feature = "serde")]
impl serde::Serialize for AxisError {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeStruct;
        let mut error = serializer.serialize_struct("AxisError", 2)?;
        error.serialize_field("identity", &*self.identity)?;
        error.serialize_field("error", &format_args!("{self}"))?;
        error.end()
    }
}

impl AxisError {
    pub(super) fn new(
        identity: Arc<AxisIdentity>,
        kind: AxisErrorKind,
        texts: &ErrorTexts,
    ) -> Self {
        let maker = match kind.failure() {
            Some(Failure::Fault {
                code,
                following_error,
            }) => texts.of_fault(code, following_error),
            _ => None,
        };
        Self {
            identity,
            kind,
            unit: None,
            motion: None,
            maker: maker.map(Into::into),
        }
    }

    /// What the drive's maker says of the fault, where the drive's table has a text
    /// ([`DriveDescription::error_texts`](crate::drives::DriveDescription::error_texts)).
    #[must_use]
    pub fn maker_text(&self) -> Option<&str> {
        self.maker.as_deref()
    }

    /// The same of this motion.
    pub(super) const fn of_motion(mut self, motion: Option<EndedByHalt>) -> Self {
        self.motion = motion;
        self
    }

    /// The same of a handle in this unit.
    pub(super) fn in_unit(mut self, unit: HandleUnit) -> Self {
        let HandleUnit { scale, name } = unit;
        self.unit = name.map(|name| Box::new(ErrorUnit { scale, name }));
        self
    }

    /// This error of moves that were to start together and were sent, with the axes whose moves are under way.
    pub(super) fn of_not_all_started(self, started: Arc<[String]>) -> Self {
        let cause = Arc::new(self.kind);
        Self {
            kind: AxisErrorKind::NotAllStarted { cause, started },
            ..self
        }
    }

    /// The axis core's reason, where the axis itself refused or failed.
    #[must_use]
    pub fn failure(&self) -> Option<Failure> {
        self.kind.failure()
    }

    /// Why, without the name of the axis, and with positions in the unit of the handle.
    pub fn reason(&self) -> impl fmt::Display + '_ {
        let over = self.motion.and_then(|motion| motion.text(&self.kind));
        ErrorReason {
            kind: Reason(&self.kind, self.unit.as_deref(), over),
            maker: self.maker_text(),
        }
    }
}

impl core::error::Error for AxisError {}

impl fmt::Display for AxisError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.identity, self.reason())
    }
}

/// The unit and the scale of a handle, whatever type it is of.
#[derive(Clone, Copy)]
pub(super) struct HandleUnit {
    pub scale: Scale,
    /// None in counts.
    pub name: Option<&'static str>,
}

/// By its name: the factors are of no use to a reader of a log.
impl fmt::Debug for HandleUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name.unwrap_or(Counts::NAME))
    }
}

impl HandleUnit {
    /// So many counts, with the unit.
    pub fn position(self, counts: i32) -> String {
        let name = self.name.unwrap_or(Counts::NAME);
        format!("{} {name}", self.scale.position_of(counts))
    }

    pub fn of<U: AxisUnit>(scale: Scale) -> Self {
        let is_counts = TypeId::of::<U>() == TypeId::of::<Counts>();
        Self {
            scale,
            name: (!is_counts).then_some(U::NAME),
        }
    }
}

/// A reason, and behind it what the drive's maker says.
struct ErrorReason<'a> {
    kind: Reason<'a>,
    maker: Option<&'a str>,
}

impl fmt::Display for ErrorReason<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.kind.fmt(f)?;
        match self.maker {
            Some(text) => write!(f, "; the maker says: {text}"),
            None => Ok(()),
        }
    }
}

/// An error's kind in the unit of its handle; or the text in its place.
struct Reason<'a>(&'a AxisErrorKind, Option<&'a ErrorUnit>, Option<&'a str>);

impl fmt::Display for Reason<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(text) = self.2 {
            return f.write_str(text);
        }
        let Self(kind, Some(unit), _) = self else {
            return fmt::Display::fmt(self.0, f);
        };
        match kind {
            AxisErrorKind::Failed(failure) => unit.write(failure, f),
            AxisErrorKind::NotAllStarted { cause, started } => {
                write_not_all_started(&Reason(cause, Some(unit), None), started, f)
            }
            kind => fmt::Display::fmt(kind, f),
        }
    }
}

impl ErrorUnit {
    /// What a failure says, with its positions and velocities in this unit.
    fn write(&self, failure: &Failure, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { scale, name } = self;
        let at = |counts: i64| scale.position_of(counts);
        match *failure {
            Failure::MissedTarget { target, actual } => write!(
                f,
                "the drive reports its target reached but stands at {} {name} instead of {} {name}: {WHY_MISSED}",
                at(actual.into()),
                at(target.into())
            ),
            Failure::AxisSlipped { from, to } => write!(
                f,
                "the axis has slipped from {} to {} {name} although its brake is closed: make the load safe, then look at the brake and its `set` time",
                at(from.into()),
                at(to.into())
            ),
            Failure::Unknown {
                doubt,
                actual,
                statusword,
                controlword,
            } => write!(
                f,
                "{doubt}; the axis was at {} {name} (statusword {statusword}, controlword {controlword})",
                at(actual.into())
            ),
            Failure::BeyondLimit {
                object,
                limit,
                asked,
            } => {
                let (asked, limit, per) = if object == obj::MAX_PROFILE_VELOCITY.address() {
                    let speed =
                        |counts: i64| scale.velocity_of(u32::try_from(counts).unwrap_or(u32::MAX));
                    (speed(asked), speed(limit), "/s")
                } else {
                    (at(asked), at(limit), "")
                };
                write!(
                    f,
                    "{asked} {name}{per} lies beyond the limit {limit} {name}{per} of {object}: stay within it, or change it and read the limits again"
                )
            }
            Failure::TooSlow { asked, least } => write!(
                f,
                "the velocity {} {name}/s is below {} {name}/s, the min profile velocity 2010h: move faster, or change it and read the limits again",
                scale.velocity_of(asked),
                scale.velocity_of(least)
            ),
            failure => fmt::Display::fmt(&failure, f),
        }
    }
}

fn write_not_all_started(
    cause: &dyn fmt::Display,
    started: &[String],
    f: &mut fmt::Formatter<'_>,
) -> fmt::Result {
    write!(
        f,
        "moves that were to start together were sent, and this one was not acknowledged: {cause}; "
    )?;
    if started.is_empty() {
        return f.write_str("no drive has acknowledged its own");
    }
    write!(
        f,
        "acknowledged, and under way, are those of {}",
        started.join(", ")
    )
}

/// The name of an axis and what its drive is.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct AxisIdentity {
    /// The axis' name in the program.
    pub axis: String,
    /// The drive.
    pub drive: DriveId,
}

impl fmt::Display for AxisIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "axis {} ({})", self.axis, self.drive)
    }
}

/// Why an operation of an axis did not end well.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum AxisErrorKind {
    /// The axis refused or failed.
    #[error("{0}")]
    Failed(Failure),
    /// A number or a factor cannot be converted between the program's units and the drive's; nothing was sent.
    #[error("{0}")]
    Scale(ScaleError),
    /// The mode is leased already, or the move or the jog is of an earlier lease. Release the other lease first, and move with your own.
    #[error("a mode of this axis is in use: release it first")]
    ModeInUse,
    /// The handle that this move was made with has been released or dropped since. Lease the mode again, and make the move anew.
    #[error("the mode that this move belongs to was given back: lease it again")]
    NotLeased,
    /// More commands at once than there are places for.
    #[error("too many commands are waiting")]
    QueueFull,
    /// The network was closed, or its thread has ended.
    #[error("the network is closed")]
    Closed,
    /// The object is not in the drive's process data in this direction, or with another length than its type has.
    #[error("{0}")]
    Field(LayoutError),
    /// The object is written by the axis itself.
    #[error("{object} is written by the axis itself: use its operations")]
    OwnedByAxis {
        /// The object, as the drive numbers it for this axis.
        object: ObjectAddress,
    },
    /// A digital input or output with a number above 31.
    #[error("60FDh and 60FEh have the bits 0 to 31: no input or output has another number")]
    NoBit,
    /// An object could not be read or written by SDO.
    #[error("{0}")]
    Sdo(Arc<SdoError>),
    /// The drive does not list this homing method in 60E3h. Choose one of those that it lists.
    #[error("the drive does not have homing method {}: by 60E3h it has {}", .method.0, Methods(.methods))]
    HomingMethod {
        /// The one that was asked for.
        method: HomingMethod,
        /// Those that it lists.
        methods: Vec<HomingMethod>,
    },
    /// A touch probe cannot be used as it was asked for, or its drive does not do what it was told.
    #[error("{0}")]
    Probe(ProbeError),
    /// Two axes cannot be a pair, or their pair cannot go on.
    #[error("{0}")]
    Pair(Box<PairError>),
    /// The caller waited no longer; nothing was stopped by that.
    #[error(
        "no outcome within {within:?} (statusword {statusword}, controlword {controlword}); it goes on, unless it is stopped"
    )]
    Late {
        /// The deadline.
        within: Duration,
        /// The last statusword seen.
        statusword: Statusword,
        /// The controlword in the outputs.
        controlword: Controlword,
    },
    /// A path has moves of another axis: nothing of such a move was sent.
    #[error(
        "this move is one of axis {axis}: a path moves one axis, use `start_together` for several"
    )]
    OtherAxis {
        /// The axis that it is of.
        axis: String,
    },
    /// Moves are started together on the axes of one network, each axis once.
    #[error("moves that start together need axes of one network, each of them once")]
    NotTogether,
    /// The bits 4 of moves that start together had risen, and one drive has not acknowledged its own. With any other kind no bit 4 has
    /// risen; parameters that go by SDO may have been written.
    #[error("{}", NotAllStarted(.cause, .started))]
    NotAllStarted {
        /// The first reason, of the axis that the error names.
        cause: Arc<AxisErrorKind>,
        /// The axes whose drives have acknowledged their moves. These are under way until somebody stops them. Others may be.
        started: Arc<[String]>,
    },
    /// The axis was declared in another unit than the handle that was asked for.
    #[error(
        "the axis was declared in {declared}, not in {asked}: ask for it in that, or in counts"
    )]
    WrongUnit {
        /// The unit of its declaration.
        declared: &'static str,
        /// The one that was asked for.
        asked: &'static str,
    },
}

impl AxisErrorKind {
    fn failure(&self) -> Option<Failure> {
        match self {
            Self::Failed(failure) => Some(*failure),
            Self::NotAllStarted { cause, .. } => cause.failure(),
            _ => None,
        }
    }
}

/// Their numbers.
struct Methods<'a>(&'a [HomingMethod]);

impl fmt::Display for Methods<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, method) in self.0.iter().enumerate() {
            let comma = if place == 0 { "" } else { ", " };
            write!(f, "{comma}{}", method.0)?;
        }
        Ok(())
    }
}

/// As text.
struct NotAllStarted<'a>(&'a AxisErrorKind, &'a [String]);

impl fmt::Display for NotAllStarted<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_not_all_started(self.0, self.1, f)
    }
}
