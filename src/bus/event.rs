//! What happens to a running network and its devices: the events that a program receives.

use std::{fmt, sync::Arc};

use crate::{
    axis::{AxisIdentity, SkewReport, WorkingCounter},
    bus::{
        cycle::black_box::BlackBox,
        error::{AlStatus, RegisterError},
        expected::Present,
    },
    coe::DriveId,
};

/// Something that happened to a drive of a running network.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum NetworkEvent {
    /// It no longer answers; its axes count as lost.
    Lost(DriveId),
    /// It answers again.
    Back(DriveId),
    /// It left OP: its axes no longer act on their outputs.
    LeftOp {
        /// The drive.
        drive: DriveId,
        /// The state it is in, and why.
        status: AlStatus,
    },
    /// It is in OP again.
    InOp(DriveId),
    /// One of its axes has a fault, or counts as lost: with what its last cycles were. It comes some milliseconds later, so that
    /// they hold what came of it.
    AxisIncident(Arc<BlackBox>),
    /// The working counter of a datagram stays wrong although its devices answer: whose outputs are delivered is not known, and their axes
    /// count as lost. With what the registers of each device show.
    Miscounted(Arc<Miscounted>),
    /// The following error of an axis (60F4h) is beyond its declared level
    /// ([`AxisConfig::following_error_warning`](crate::AxisConfig::following_error_warning)). It comes again once it was below half of that.
    FollowingErrorHigh {
        /// The axis.
        axis: Arc<AxisIdentity>,
        /// In the unit of the axis.
        following_error: f64,
        /// The level, in that unit.
        level: f64,
        /// That unit.
        unit: &'static str,
    },
    /// The skew of a pair is beyond one of its limits ([`Pairing::skew`](crate::axis::Pairing::skew)). A warning comes again once the skew was
    /// below half of it.
    Skew(Arc<SkewReport>),
    /// An optional group has joined: its devices are in OP, its axes disabled and not referenced.
    Joined {
        /// The group's name.
        group: String,
        /// Its first drive.
        drive: DriveId,
    },
    /// An optional group cannot join: a wrong device has its number, two have it, or a step failed. Its devices stay in INIT. It is told once,
    /// and tried again.
    NotJoined {
        /// The group's name.
        group: String,
        /// Its first drive.
        drive: DriveId,
        /// Why, as a [`NetworkError`](crate::NetworkError) says it.
        why: String,
    },
    /// An optional group has left: one of its devices no longer answers. What is left of it goes to INIT.
    Left {
        /// The group's name.
        group: String,
        /// Its first drive.
        drive: DriveId,
    },
    /// A device was plugged in that is not declared. It stays in INIT.
    Stranger(Arc<Present>),
    /// Frames do not come back from a port, or a device of another line takes part in them there. The port was closed again. It is tried
    /// again after 5 s, and then more and more seldom; at once when its link has been away.
    HalfPlugged {
        /// The device with the port.
        device: DriveId,
        /// The port, from 1 to 3.
        port: u8,
    },
    /// The cycles and the reference clock of the distributed clocks.
    Clock {
        /// The SubDevice whose clock is the reference.
        reference: DriveId,
        /// What happened.
        event: ClockEvent,
    },
}

impl NetworkEvent {
    /// The drive, or other device, that it happened to.
    #[must_use]
    pub fn drive(&self) -> &DriveId {
        match self {
            Self::Lost(drive) | Self::Back(drive) | Self::InOp(drive) => drive,
            Self::LeftOp { drive, .. } => drive,
            Self::AxisIncident(black_box) => &black_box.axis.drive,
            Self::FollowingErrorHigh { axis, .. } => &axis.drive,
            Self::Skew(report) => &report.axes[0].drive,
            Self::Miscounted(miscounted) => miscounted.suspect(),
            Self::Joined { drive, .. }
            | Self::NotJoined { drive, .. }
            | Self::Left { drive, .. } => drive,
            Self::Stranger(present) => &present.id,
            Self::HalfPlugged { device, .. } => device,
            Self::Clock { reference, .. } => reference,
        }
    }
}

impl fmt::Display for NetworkEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lost(drive) => write!(f, "{drive} no longer answers"),
            Self::Back(drive) => write!(f, "{drive} answers again"),
            Self::LeftOp { drive, status } => write!(f, "{drive} has left OP: it is in {status}"),
            Self::InOp(drive) => write!(f, "{drive} is in OP again"),
            Self::AxisIncident(black_box) => write!(f, "{black_box}"),
            Self::FollowingErrorHigh {
                axis,
                following_error,
                level,
                unit,
            } => write!(
                f,
                "{axis}: its following error is {following_error} {unit}, beyond {level} {unit}"
            ),
            Self::Skew(report) => write!(f, "{report}"),
            Self::Miscounted(miscounted) => write!(f, "{miscounted}"),
            Self::Joined { group, drive } => write!(f, "group `{group}` has joined, with {drive}"),
            Self::NotJoined { group, why, .. } => write!(f, "group `{group}` cannot join: {why}"),
            Self::Left { group, drive } => write!(f, "group `{group}` has left, with {drive}"),
            Self::Stranger(present) => {
                let position = present.id.position;
                write!(
                    f,
                    "a device that is not declared was plugged in at position {position}, and stays in INIT: {present}"
                )?;
                let mut unnumbered = present.numbers.iter().filter(|number| number.is_nobodys());
                unnumbered.try_for_each(|number| {
                    write!(f, "; its {number} is that of devices without one")
                })
            }
            Self::HalfPlugged { device, port } => write!(
                f,
                "what is plugged into port {port} of {device} disturbs the line, and the port is closed: look whether the connector is in all the \
                 way, and switch a device off and on that comes from another line"
            ),
            Self::Clock { reference, event } => write!(f, "{reference}: {event}"),
        }
    }
}

/// What happened between the cycles and the reference clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ClockEvent {
    /// The phase error is beyond its bound again and again. Drives that cannot live with that say so themselves.
    OutOfStep {
        /// The last cycle's, in nanoseconds.
        phase_error_ns: i64,
    },
    /// The cycles are in step again.
    InStep,
    /// The clock no longer gives its time. The cycles go on at the speed that it had, and all other clocks follow them. It may
    /// be lost, or have been switched off and on: then [`Network::recover`](crate::Network::recover) of its device, or of one that follows
    /// it, sets it to the time of the cycles.
    Silent,
    /// The clock shows a time that it cannot have. All clocks follow the cycles from now on, which go on at the speed that they
    /// had, and all axes were stopped and disabled, as at the network's end; it is to be started anew.
    Jumped {
        /// By how much it jumped, less multiples of 2^32, in nanoseconds.
        by_ns: i64,
    },
}

impl fmt::Display for ClockEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OutOfStep { phase_error_ns } => write!(
                f,
                "the cycles are out of step with the reference clock: the phase error is {phase_error_ns} ns"
            ),
            Self::InStep => f.write_str("the cycles are in step with the reference clock"),
            Self::Silent => {
                f.write_str("the reference clock gives no time: the cycles go on by themselves")
            }
            Self::Jumped { by_ns } => write!(
                f,
                "the reference clock has jumped by {by_ns} ns: all axes stop and are disabled"
            ),
        }
    }
}

/// How a device has come back into OP.
///
/// ```
/// use servocrab::bus::{AlState, AlStatus, Recovered};
/// let from = AlStatus { state: AlState::SafeOp, error: Some(0x001B) };
/// let text = Recovered::FromSafeOp { from }.to_string();
/// assert!(text.starts_with("back in OP from SAFEOP with AL status code 001Bh"), "{text}");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Recovered {
    /// It was in OP, and nothing was done.
    WasInOp,
    /// It had left OP and kept its power: the error was acknowledged, and it is in OP again. It holds what it held, all
    /// parameters and modes, and where it has been homed.
    FromSafeOp {
        /// What it was found in.
        from: AlStatus,
    },
    /// It had lost its power or was set back, or had left SAFEOP: it was brought up as at the start. What was written to it since
    /// then and not stored in it is gone: parameters, the mode, where it had been homed. What its start-up lists write
    /// it has again.
    BroughtUp {
        /// Where in the line it is now: not where it was at the start if devices before it are missing.
        position: u16,
        /// The AL state that it was found in, if it had kept its station address; else it has been without power.
        from: Option<AlStatus>,
    },
}

impl fmt::Display for Recovered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WasInOp => f.write_str("in OP: nothing was done"),
            Self::FromSafeOp { from } => write!(f, "back in OP from {from}"),
            Self::BroughtUp { position, from } => {
                write!(f, "brought up anew into OP at position {position}, ")?;
                match from {
                    Some(from) => write!(f, "from {from}"),
                    None => f.write_str("after it was without power"),
                }
            }
        }
    }
}

/// A datagram of the process data whose working counter stays wrong, and what the registers of its devices show.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Miscounted {
    /// Which datagram, what it was to count and what it counts.
    pub counter: WorkingCounter,
    /// All devices that share it.
    pub devices: Vec<DeviceFinding>,
}

impl Miscounted {
    /// The first device that shows something, or the first of all.
    fn suspect(&self) -> &DriveId {
        let shows = self.devices.iter().find(|one| !one.findings.is_empty());
        // There are no datagrams without devices.
        let first = shows.or(self.devices.first());
        first.map_or(&NOBODY, |one| &one.device)
    }
}

static NOBODY: DriveId = DriveId {
    position: 0,
    name: String::new(),
    identity: crate::sii::Identity {
        vendor: 0,
        product: 0,
        revision: 0,
        serial: 0,
    },
};

impl fmt::Display for Miscounted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, shared by ", self.counter)?;
        for (place, one) in self.devices.iter().enumerate() {
            let before = if place == 0 { "" } else { ", " };
            write!(f, "{before}{}", one.device)?;
        }
        let mut nothing = true;
        for one in &self.devices {
            for finding in &one.findings {
                nothing = false;
                write!(f, "; {}: {finding}", one.device)?;
            }
        }
        if nothing {
            f.write_str(
                "; the registers of none show why: replace one after the other, or change the place of each in the line",
            )?;
        }
        Ok(())
    }
}

/// What the registers of a device show.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct DeviceFinding {
    /// The device.
    pub device: DriveId,
    /// What is not as it was set; nothing where all is.
    pub findings: Vec<Finding>,
}

/// What is not as it was set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Finding {
    /// Its registers cannot be read.
    Register(RegisterError),
    /// It is not in OP, or has an error.
    State(AlStatus),
    /// This sync manager of its process data is off, or is set to something else.
    SyncManager(u8),
    /// This FMMU of its process data is off, or is set to something else.
    Fmmu(u8),
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Register(error) => write!(f, "its registers cannot be read: {error}"),
            Self::State(status) => write!(f, "it is in {status}"),
            Self::SyncManager(number) => {
                write!(f, "sync manager {number} is off or not as it was set")
            }
            Self::Fmmu(number) => write!(f, "FMMU {number} is off or not as it was set"),
        }
    }
}
