//! What the bus thread notes for the log, and the events that come of it. `at` is when it happened, by the bus's clock: a line may
//! come later.

use std::{sync::Arc, time::Duration};

use tracing::Level;

use crate::{
    axis::{AxisIdentity, StopRequest},
    bus::{
        AlError, AlState, AlStatus, BringUpStep, ClockEvent, Miscounted, NetworkEvent, Recovered,
    },
    coe::{DriveId, MailNote},
    ds402::{Controlword, State, Statusword},
    wakes::WakeStatistics,
};

/// One event to be logged.
#[derive(Debug)]
pub(in crate::bus) enum Note {
    Axis(AxisNote),
    Drive(Arc<DriveId>, DriveChange),
    /// A drive is in OP for the first time.
    BroughtUp(Arc<DriveId>),
    Mail(MailNote),
    /// The program stopped all axes.
    StopOfAll(StopRequest),
    /// The program no longer says that it is alive.
    Unfed,
    /// The cycles are in step with the reference clock, for the first time.
    InStep {
        phase_error_ns: i64,
    },
    /// What happened between them after that.
    Clock(Arc<DriveId>, ClockEvent),
    /// A step of a drive's bring-up is done.
    Step {
        drive: Arc<DriveId>,
        step: BringUpStep,
        done: usize,
        total: usize,
    },
    /// How far the set-up of a device is.
    SetUp(Arc<DriveId>, &'static str),
    /// A device is in OP again because the program asked for it.
    Recovered(Arc<DriveId>, Recovered),
    /// It is not, for this reason, or because nobody waits for it any more.
    NotRecovered(Arc<DriveId>, Option<String>),
    /// A drive has no object 6007h.
    NoAbortConnection {
        axis: String,
    },
    /// The working counter of a datagram stays wrong.
    Miscounted(Arc<Miscounted>),
    /// A waker of the program holds up the others, or has panicked.
    Wakers(WakeStatistics),
    /// At the end, axes still move.
    NotStopped,
    /// At the end, a drive did not go into this state.
    NotOnTheWayDown {
        drive: Arc<DriveId>,
        state: AlState,
        error: AlError,
    },
}

/// What has changed of an axis, and what it shows.
#[derive(Debug)]
pub(in crate::bus) struct AxisNote {
    pub(in crate::bus) axis: Arc<AxisIdentity>,
    pub(in crate::bus) change: AxisChange,
    pub(in crate::bus) from: Option<State>,
    pub(in crate::bus) to: State,
    pub(in crate::bus) statusword: Statusword,
    pub(in crate::bus) controlword: Controlword,
    pub(in crate::bus) position: i32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) enum AxisChange {
    Lost,
    Back,
    Fault,
    State,
    Halted,
    Resumed,
}

/// What has happened to a drive, or to another device.
#[derive(Debug, Clone, Copy)]
pub(in crate::bus) enum DriveChange {
    Lost,
    Back,
    LeftOp(AlStatus),
    InOp,
}

impl DriveChange {
    /// As a program is told it.
    pub(in crate::bus) fn of(self, drive: &DriveId) -> NetworkEvent {
        let drive = drive.clone();
        match self {
            Self::Lost => NetworkEvent::Lost(drive),
            Self::Back => NetworkEvent::Back(drive),
            Self::LeftOp(status) => NetworkEvent::LeftOp { drive, status },
            Self::InOp => NetworkEvent::InOp(drive),
        }
    }
}

impl Note {
    /// The level of the event that [`write`](Self::write) makes of it.
    pub(in crate::bus) fn level(&self) -> Level {
        match self {
            Self::Axis(note) => match note.change {
                AxisChange::Fault => Level::ERROR,
                AxisChange::Lost => Level::WARN,
                AxisChange::Back | AxisChange::State | AxisChange::Halted | AxisChange::Resumed => {
                    Level::INFO
                }
            },
            Self::Drive(_, DriveChange::Lost | DriveChange::LeftOp(_)) => Level::WARN,
            Self::Drive(..)
            | Self::BroughtUp(_)
            | Self::Recovered(..)
            | Self::InStep { .. }
            | Self::Clock(_, ClockEvent::InStep) => Level::INFO,
            Self::Mail(note) => note.level(),
            Self::Step { .. } | Self::SetUp(..) => Level::DEBUG,
            Self::StopOfAll(_)
            | Self::NotRecovered(..)
            | Self::NoAbortConnection { .. }
            | Self::Unfed
            | Self::Clock(..)
            | Self::NotStopped
            | Self::Wakers(_)
            | Self::Miscounted(_)
            | Self::NotOnTheWayDown { .. } => Level::WARN,
        }
    }

    /// Makes an event of it.
    pub(in crate::bus) fn write(self, at: Duration) {
        match self {
            Self::Axis(note) => note.write(at),
            Self::Drive(drive, change) => write_drive(&drive, change, at),
            Self::BroughtUp(drive) => {
                tracing::info!(drive = %format_args!("{drive:#}"), ?at, "in OP");
            }
            Self::Mail(note) => note.write(at),
            Self::StopOfAll(stop) => tracing::warn!(?stop, ?at, "all axes are stopped"),
            Self::Unfed => {
                tracing::warn!(
                    ?at,
                    "the program no longer feeds its liveness: all axes are halted"
                );
            }
            Self::InStep { phase_error_ns } => {
                tracing::info!(phase_error_ns, ?at, "in step with the reference clock");
            }
            Self::Clock(drive, event @ ClockEvent::InStep) => {
                tracing::info!(%drive, ?at, "{event}");
            }
            Self::Clock(drive, event) => tracing::warn!(%drive, ?at, "{event}"),
            Self::Step {
                drive,
                step,
                done,
                total,
            } => tracing::debug!(%drive, %step, done, total, ?at, "bring-up step done"),
            Self::SetUp(drive, what) => tracing::debug!(%drive, ?at, "{what}"),
            Self::Recovered(drive, recovered) => tracing::info!(%drive, ?at, "{recovered}"),
            Self::NotRecovered(drive, Some(reason)) => {
                tracing::warn!(%drive, ?at, "not recovered into OP: {reason}");
            }
            Self::NotRecovered(drive, None) => {
                tracing::warn!(%drive, ?at, "not recovered into OP: no call waits for it any more");
            }
            Self::NoAbortConnection { axis } => {
                tracing::warn!(
                    axis,
                    ?at,
                    "no object 6007h: the drive alone decides what it does when the process data stop"
                );
            }
            Self::Miscounted(miscounted) => tracing::warn!(?at, "{miscounted}"),
            Self::Wakers(WakeStatistics {
                slow,
                longest,
                panicked,
            }) => {
                tracing::warn!(
                    slow,
                    ?longest,
                    panicked,
                    ?at,
                    "a waker of the program blocks or has panicked: no other future is woken while one blocks"
                );
            }
            Self::NotStopped => {
                tracing::warn!(
                    ?at,
                    "axes did not stop in time; their drives now act by 6007h"
                );
            }
            Self::NotOnTheWayDown {
                drive,
                state,
                error,
            } => tracing::warn!(%drive, %state, ?at, "not on the way down: {error}"),
        }
    }
}

impl AxisNote {
    fn write(&self, at: Duration) {
        let AxisIdentity { axis, drive } = &*self.axis;
        // As a macro, because the level of an event is a constant.
        macro_rules! event {
            ($level:ident, $text:literal) => {
                tracing::$level!(
                    axis,
                    %drive,
                    from = self.from.map(tracing::field::debug),
                    to = ?self.to,
                    statusword = %self.statusword,
                    controlword = %self.controlword,
                    position = self.position,
                    ?at,
                    $text
                )
            };
        }
        match self.change {
            AxisChange::Lost => event!(warn, "counts as lost"),
            AxisChange::Back => event!(info, "is there again"),
            AxisChange::Fault => event!(error, "fault"),
            AxisChange::State => event!(info, "state changed"),
            AxisChange::Halted => event!(info, "halted"),
            AxisChange::Resumed => event!(info, "no longer halted"),
        }
    }
}

fn write_drive(drive: &DriveId, change: DriveChange, at: Duration) {
    let event = change.of(drive);
    match change {
        DriveChange::Lost | DriveChange::LeftOp(_) => tracing::warn!(%drive, ?at, "{event}"),
        DriveChange::Back | DriveChange::InOp => tracing::info!(%drive, ?at, "{event}"),
    }
}
